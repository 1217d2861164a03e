//! 72 MHz from an external 8 MHz clock, 64 MHz without one (RM0316 9.2).
//!
//! With the clock: 8 MHz x 9 = 72 MHz, APB1 / 2 = 36 MHz, APB2 72 MHz. Without: HSI /
//! 2 x 16 = 64 MHz, APB1 32 MHz, APB2 64 MHz. Two flash wait states for both.
//! The Nucleo-F303K8 gets the debugger's clock only if its solder bridges are set so. The
//! program therefore detects the clock at run time and needs no build option.

use super::{gate, ratio};
use crate::pac;
use parts::SLED_F303;
use sled_common::clock::{Clocks, Oscillator, ResetCause};
use sled_common::selftest::is_plausible;

/// With the external clock.
pub const EXTERNAL: Clocks = Clocks::of(&SLED_F303, Oscillator::External);

/// With the RC oscillator.
pub const INTERNAL: Clocks = Clocks::of(&SLED_F303, Oscillator::Internal);

/// Multipliers of the PLL: of the external clock, and of half the RC oscillator.
const TIMES_EXTERNAL: u32 = 9;
const TIMES_INTERNAL: u32 = 16;
/// Dividers of the peripheral buses.
const APB1_DIVIDER: u32 = 2;
const APB2_DIVIDER: u32 = 1;

const fn is_made_here(clocks: &Clocks, core: u32) -> bool {
    clocks.core == core
        && clocks.apb1 == core / APB1_DIVIDER
        && clocks.apb2 == core / APB2_DIVIDER
        && wait_states(core) == wait_states(EXTERNAL.core)
}
const _: () = assert!(
    is_made_here(&EXTERNAL, SLED_F303.external_hz * TIMES_EXTERNAL)
        && is_made_here(&INTERNAL, SLED_F303.part.hsi.hz / 2 * TIMES_INTERNAL),
    "multipliers and dividers below make the clocks of the crate parts"
);

/// Wait states of the flash at a core clock.
const fn wait_states(core: u32) -> u8 {
    match SLED_F303.part.flash_access.wait_states(core) {
        Some(states) => states,
        None => panic!("the core is faster than its flash"),
    }
}

/// How often the external clock is polled before the node starts without it. A poll takes about 10
/// cycles of the 8 MHz HSI, so this is 10 ms.
const HSE_POLLS: u32 = 8_000;

/// The same for the PLL, which locks within 200 us (data sheet), and the switch to it.
const PLL_POLLS: u32 = 8_000;

/// Multiplier code of CFGR.PLLMUL: code = factor - 2 (RM0316 9.4.2).
const fn pllmul(factor: u32) -> u8 {
    (factor - 2) as u8
}

/// Starts the clock tree and reports which one it became, and the error of the external clock
/// against the RC oscillator in tenths of a per cent, if it could be measured. `None` if the PLL
/// does not lock.
///
/// Without the external clock its oscillator stays on, so that [`external_is_ready`] shows when
/// the clock comes: that of a debugger on a board with a supply of its own comes later than that
/// of the board, or never.
pub fn start(
    rcc: &pac::RCC,
    flash: &pac::FLASH,
    timer: &pac::TIM16,
) -> Option<(Clocks, Option<i16>)> {
    rcc.cr.modify(|_, w| w.hsebyp().set_bit());
    rcc.cr.modify(|_, w| w.hseon().set_bit());
    let started = (0..HSE_POLLS).any(|_| rcc.cr.read().hserdy().bit_is_set());
    let error = started.then(|| {
        gate::open_ratio(rcc);
        let error = ratio::external_error(timer);
        rcc.apb2enr.modify(|_, w| w.tim16en().clear_bit());
        error
    });
    let error = error.flatten();
    // The node also uses a clock that gave no edges to the timer. The part has found this clock stable
    // (HSERDY, RM0316 9.2.1), so the way to the timer is in doubt and not the clock. The self-test
    // reports that the clock was not measured.
    let external = started && error.is_none_or(is_plausible);
    if started && !external {
        // On this clock the node would disturb every frame on the bus.
        rcc.cr.modify(|_, w| w.hseon().clear_bit());
    }
    if external {
        // If the clock stops later, the non-maskable interrupt ends the program (RM0316 9.2.7).
        rcc.cr.modify(|_, w| w.csson().set_bit());
    }

    flash.acr.modify(|_, w| {
        w.prftbe().set_bit();
        // SAFETY: wait states that the part has (RM0316 4.5.1), 0..=7.
        unsafe { w.latency().bits(const { wait_states(EXTERNAL.core) }) }
    });

    rcc.cfgr.modify(|_, w| {
        w.hpre().div1();
        w.ppre1().div2();
        w.ppre2().div1();
        if external {
            w.pllsrc().hse_div_prediv();
            w.pllmul().bits(const { pllmul(TIMES_EXTERNAL) })
        } else {
            w.pllsrc().hsi_div2();
            w.pllmul().bits(const { pllmul(TIMES_INTERNAL) })
        }
    });
    rcc.cr.modify(|_, w| w.pllon().set_bit());
    (0..PLL_POLLS)
        .any(|_| rcc.cr.read().pllrdy().bit_is_set())
        .then_some(())?;
    rcc.cfgr.modify(|_, w| w.sw().pll());
    (0..PLL_POLLS)
        .any(|_| rcc.cfgr.read().sws().is_pll())
        .then_some(())?;
    // USART1 on the system clock: its default differs between variants of the part.
    rcc.cfgr3.modify(|_, w| w.usart1sw().sysclk());

    Some((if external { EXTERNAL } else { INTERNAL }, error))
}

/// Whether the external clock is there, on a node that started without it.
pub fn external_is_ready() -> bool {
    // SAFETY: reads a flag.
    unsafe { (*pac::RCC::ptr()).cr.read().hserdy().bit_is_set() }
}

/// Trims the RC oscillator by `steps` from its factory setting, -16 to 15; a step is about 0.5 %
/// (RM0316 9.4.1), positive is faster.
pub fn trim(steps: i8) {
    let code = steps.clamp(-16, 15).wrapping_add(16).cast_unsigned();
    // SAFETY: only the housekeeping changes this register after the start. The field has five
    // bits, and every code is a setting.
    unsafe { (*pac::RCC::ptr()).cr.modify(|_, w| w.hsitrim().bits(code)) };
}

/// Reads why the microcontroller started, and clears the flags for the next time.
pub fn reset_cause(rcc: &pac::RCC) -> ResetCause {
    let flags = rcc.csr.read().bits();
    rcc.csr.modify(|_, w| w.rmvf().set_bit());
    ResetCause::from_csr(flags)
}
