//! The supply, watched by the voltage detector (RM0390 5.2.3).
//!
//! The part runs down to 1.7 V: its brown-out reset is off when it leaves the factory (RM0390
//! 3.6.2, BOR_LEV). At 180 MHz with five wait states its flash is read right from 2.7 V on only
//! (RM0390 3.4.1, table 5). Below that the core may execute something else than the program. So
//! the part starts its fast clock only with a good supply, and starts anew when the supply falls.
//!
//! RTIC starts the program with interrupts off. [`Watch`] lets this one through.

use crate::pac;
#[cfg(target_os = "none")]
use sled_common::fault::{self, Fault};

/// Level of the detector (PLS): it reports a supply that falls below 2.85 to 2.99 V, until it rises
/// above 2.96 to 3.10 V (data sheet DS10693, 6.3.5). Nucleo boards have 3.3 V.
const LEVEL: u8 = 6;
const _: () = assert!(
    crate::FACTS.part.supply.detector_mv[LEVEL as usize].0
        > crate::FACTS.part.flash_access.rated_mv
);

/// The line of the detector at EXTI (RM0390 10.2.5).
const LINE: u8 = 16;

/// The highest priority that a task of a node has, as the processor counts: 16 levels in the upper four
/// bits, where 0 is the highest (PM0214 2.3.5). RTIC could give a task 0 too, which it calls 16. No node
/// does so.
#[cfg(target_os = "none")]
const HIGHEST_TASK: u8 = 0x10;

/// Time that the detector has to settle after it was switched on, in cycles of the 16 MHz HSI: 100 us.
/// Until then its output says nothing about the supply. The data sheet gives no bound.
const SETTLING: u32 = 1_600;

/// Reads in a row that must find the supply good. They take 15 us.
const STEADY: u32 = 16;

/// How often the detector is polled before the start fails. A poll takes about 15 cycles of the HSI,
/// so this is 5 ms.
const POLLS: u32 = 5_000;

/// Waits for a good supply, for a bounded time. From then on a low supply starts the part anew.
///
/// The clock of the power control must be enabled. `None` if the supply stays low.
pub(crate) fn watch(pwr: &pac::PWR, exti: &pac::EXTI) -> Option<()> {
    // SAFETY: a level that the part has (RM0390 5.4.1), 0..=7.
    pwr.cr().modify(|_, w| unsafe { w.pls().bits(LEVEL) });
    pwr.cr().modify(|_, w| w.pvde().set_bit());
    exti.rtsr().modify(|_, w| w.tr(LINE).set_bit());
    cortex_m::asm::delay(SETTLING);
    let mut steady = 0;
    (0..POLLS).find(|_| {
        steady = if is_good(pwr) { steady + 1 } else { 0 };
        steady == STEADY
    })?;
    exti.pr().write(|w| w.pr(LINE).clear_bit_by_one());
    exti.imr().modify(|_, w| w.mr(LINE).set_bit());
    // It may have fallen before its edge was cleared.
    if !is_good(pwr) {
        return None;
    }
    // SAFETY: the handler of this interrupt shares nothing with the program.
    unsafe { cortex_m::peripheral::NVIC::unmask(pac::Interrupt::PVD) };
    Some(())
}

/// Whether the supply is good. The detector must have settled.
pub(crate) fn is_good(pwr: &pac::PWR) -> bool {
    pwr.csr().read().pvdo().bit_is_clear()
}

/// While it lives, the interrupt of the detector is the only one that is served, also where the program
/// starts with interrupts off. After it they are as they were.
pub(crate) struct Watch {
    #[cfg(target_os = "none")]
    before: cortex_m::register::primask::Primask,
}

impl Watch {
    pub(crate) fn begin() -> Self {
        #[cfg(target_os = "none")]
        {
            let before = cortex_m::register::primask::read();
            // SAFETY: from here on only priority 0 is served, and only the detector has it. Its handler
            // shares nothing with the program and does not return, so that no code can see that it
            // was interrupted.
            unsafe {
                cortex_m::register::basepri::write(HIGHEST_TASK);
                cortex_m::interrupt::enable();
            }
            Self { before }
        }
        #[cfg(not(target_os = "none"))]
        Self {}
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        #[cfg(target_os = "none")]
        // SAFETY: interrupts are off while the mask of the priorities is taken away, and come back
        // only where they were on.
        unsafe {
            cortex_m::interrupt::disable();
            cortex_m::register::basepri::write(0);
            if self.before.is_active() {
                cortex_m::interrupt::enable();
            }
        }
    }
}

/// The interrupt of the voltage detector. Its priority is above that of all tasks, because nothing
/// sets it.
// SAFETY: the name is the one that the vector table asks for.
#[cfg(target_os = "none")]
#[unsafe(export_name = "PVD")]
extern "C" fn supply_is_low() -> ! {
    crate::stop_actuator();
    fault::reset(Fault::Supply)
}
