//! 180 MHz from the 8 MHz clock of the debugger (RM0390 6.2, 5.1.4).
//!
//! 8 MHz / 4 = 2 MHz, x 180 = 360 MHz, / 2 = 180 MHz; APB1 / 4 = 45 MHz, APB2 / 2 =
//! 90 MHz. Voltage scale 1 with over-drive, five flash wait states (2.7-3.6 V).

use super::{gate, ratio, supply};
use crate::pac;
use parts::{SLED_F446, Sled};
use sled_common::clock::{Clocks, Oscillator, ResetCause};
use sled_common::selftest::is_plausible;

/// Core clock, Hz.
pub const CORE_HZ: u32 = SLED_F446.external.core;
/// APB1 clock, Hz: CAN, USART2, USART3.
pub const APB1_HZ: u32 = SLED_F446.external.apb1;
/// APB2 clock, Hz: USART1, ADC.
pub const APB2_HZ: u32 = SLED_F446.external.apb2;
/// Clock of the timers on APB1, Hz.
pub const APB1_TIMER_HZ: u32 = SLED_F446.external.apb1_timers();

/// Input frequency of the PLL: 2 MHz, as RM0390 6.3.2 recommends to limit jitter.
const PLL_INPUT_HZ: u32 = 2_000_000;
/// Multiplier and output divider of the PLL, dividers of the peripheral buses.
const PLL_N: u16 = 180;
const PLL_P: u32 = 2;
const APB1_DIVIDER: u32 = 4;
const APB2_DIVIDER: u32 = 2;
/// Dividers of the PLL's input for the two oscillators.
const PLL_M_EXTERNAL: u8 = (SLED_F446.external_hz / PLL_INPUT_HZ) as u8;
const PLL_M_INTERNAL: u8 = (SLED_F446.part.hsi.hz / PLL_INPUT_HZ) as u8;

const fn is_made_here(sled: &Sled) -> bool {
    let core = PLL_INPUT_HZ * PLL_N as u32 / PLL_P;
    sled.external.core == core
        && sled.internal.core == core
        && sled.external.apb1 == core / APB1_DIVIDER
        && sled.external.apb2 == core / APB2_DIVIDER
        && sled.internal.apb1 == sled.external.apb1
        && sled.internal.apb2 == sled.external.apb2
        && PLL_M_EXTERNAL as u32 * PLL_INPUT_HZ == sled.external_hz
        && PLL_M_INTERNAL as u32 * PLL_INPUT_HZ == sled.part.hsi.hz
}
const _: () = assert!(
    is_made_here(&SLED_F446),
    "dividers below make the clocks of the crate parts"
);

/// Wait states of the flash at the core's clock.
const WAIT_STATES: u8 = match SLED_F446.part.flash_access.wait_states(CORE_HZ) {
    Some(states) => states,
    None => panic!("the core is faster than its flash"),
};

/// How often the external clock is polled before the node starts without it. A poll takes about 10
/// cycles of the 16 MHz HSI, so this is 10 ms.
const HSE_POLLS: u32 = 16_000;

/// The same for the PLL, which locks within 200 us, the over-drive, which takes 45 us (data sheet),
/// and the switches to them.
const READY_POLLS: u32 = 16_000;

/// Starts the clock tree and reports it. The clock of the power control must be enabled.
///
/// Without the external clock the same frequencies are made from the HSI. The external oscillator
/// stays on then, so that [`external_is_ready`] shows when its clock comes: that of a debugger on a
/// board with a supply of its own comes later than that of the board, or never.
///
/// Also reports the error of the external clock against the RC oscillator in tenths of a per cent,
/// if it could be measured.
///
/// `None` if the PLL or the voltage regulator does not get ready, or the supply has fallen.
pub fn start(
    rcc: &pac::RCC,
    pwr: &pac::PWR,
    flash: &pac::FLASH,
    timer: &pac::TIM11,
) -> Option<(Clocks, Option<i16>)> {
    pwr.cr().modify(|_, w| w.vos().scale1());

    rcc.cr().modify(|_, w| w.hsebyp().set_bit());
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    let started = (0..HSE_POLLS).any(|_| rcc.cr().read().hserdy().bit_is_set());
    let error = started.then(|| {
        rcc.cfgr().modify(|_, w| w.rtcpre().set(ratio::DIVIDER));
        gate::open_ratio(rcc);
        let error = ratio::external_error(timer);
        rcc.apb2enr().modify(|_, w| w.tim11en().clear_bit());
        error
    });
    let error = error.flatten();
    // The node also uses a clock that gave no edges to the timer. The part has found this clock stable
    // (HSERDY, RM0390 6.2.1), so the way to the timer is in doubt and not the clock. The self-test
    // reports that the clock was not measured.
    let external = started && error.is_none_or(is_plausible);
    if started && !external {
        // On this clock the node would disturb every frame on the bus.
        rcc.cr().modify(|_, w| w.hseon().clear_bit());
    }
    if external {
        // If the clock stops later, the non-maskable interrupt ends the program (RM0390 6.2.7).
        rcc.cr().modify(|_, w| w.csson().set_bit());
    }

    let input_divider = if external {
        PLL_M_EXTERNAL
    } else {
        PLL_M_INTERNAL
    };
    rcc.pllcfgr().write(|w| {
        w.pllsrc().bit(external);
        w.pllp().div2();
        // SAFETY: M, N, Q and R within the ranges of RM0390 6.3.2 (2..63, 50..432,
        // 2..15, 2..7); Q and R feed nothing that is used.
        unsafe {
            w.pllm().bits(input_divider);
            w.plln().bits(PLL_N);
            w.pllq().bits(8);
            w.pllr().bits(2)
        }
    });
    // Before the system clock is switched: a prescaler may take 16 AHB cycles to take effect
    // (RM0390 6.3.3), and until then the buses would be too fast.
    rcc.cfgr().modify(|_, w| {
        w.hpre().div1();
        w.ppre1().div4();
        w.ppre2().div2()
    });
    rcc.cr().modify(|_, w| w.pllon().set_bit());

    // Over-drive is switched on while the PLL locks (RM0390 5.1.4).
    pwr.cr().modify(|_, w| w.oden().set_bit());
    wait(|| pwr.csr().read().odrdy().bit_is_set())?;
    pwr.cr().modify(|_, w| w.odswen().set_bit());
    wait(|| pwr.csr().read().odswrdy().bit_is_set())?;

    flash.acr().write(|w| {
        // SAFETY: wait states that the part has (RM0390 3.4.1), 0..=15.
        unsafe { w.latency().bits(WAIT_STATES) };
        w.prften().set_bit();
        w.icen().set_bit();
        w.dcen().set_bit()
    });
    wait(|| flash.acr().read().latency().bits() == WAIT_STATES)?;

    wait(|| rcc.cr().read().pllrdy().bit_is_set())?;
    if !supply::is_good(pwr) {
        return None;
    }
    rcc.cfgr().modify(|_, w| w.sw().pll());
    wait(|| rcc.cfgr().read().sws().is_pll())?;

    let oscillator = if external {
        Oscillator::External
    } else {
        Oscillator::Internal
    };
    Some((Clocks::of(&SLED_F446, oscillator), error))
}

/// Waits for a flag, for a bounded time.
fn wait(is_set: impl Fn() -> bool) -> Option<()> {
    (0..READY_POLLS).any(|_| is_set()).then_some(())
}

/// Whether the external clock is there, on a node that started without it.
pub fn external_is_ready() -> bool {
    // SAFETY: reads a flag.
    unsafe { (*pac::RCC::ptr()).cr().read().hserdy().bit_is_set() }
}

/// Trims the RC oscillator by `steps` from its factory setting, -16 to 15; a step is at most 1 %
/// (data sheet, table of HSI characteristics), positive is faster.
pub fn trim(steps: i8) {
    let code = steps.clamp(-16, 15).wrapping_add(16).cast_unsigned();
    // SAFETY: only the housekeeping changes this register after the start. The field has five
    // bits, and every code is a setting.
    unsafe {
        (*pac::RCC::ptr())
            .cr()
            .modify(|_, w| w.hsitrim().bits(code))
    };
}

/// Reads why the microcontroller started, and clears the flags for the next time.
pub fn reset_cause(rcc: &pac::RCC) -> ResetCause {
    let flags = rcc.csr().read().bits();
    rcc.csr().modify(|_, w| w.rmvf().set_bit());
    ResetCause::from_csr(flags)
}
