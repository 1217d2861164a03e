//! 180 MHz from the 8 MHz clock of the debugger (RM0390 6.2, 5.1.4).
//!
//! 8 MHz / 4 = 2 MHz, x 180 = 360 MHz, / 2 = 180 MHz; APB1 / 4 = 45 MHz, APB2 / 2 =
//! 90 MHz. Voltage scale 1 with over-drive, five flash wait states (2.7-3.6 V).

use crate::pac;
use sled_common::clock::{Clocks, Oscillator, ResetCause};

/// Core clock, Hz.
pub const CORE_HZ: u32 = 180_000_000;
/// APB1 clock, Hz: CAN, USART2, USART3.
pub const APB1_HZ: u32 = 45_000_000;
/// APB2 clock, Hz: USART1, ADC.
pub const APB2_HZ: u32 = 90_000_000;
/// Timers on APB1 run at twice its clock when it is divided (RM0390 6.2).
pub const APB1_TIMER_HZ: u32 = 2 * APB1_HZ;

/// Polls that the external clock is given, about 10 cycles of the 16 MHz HSI each:
/// 25 ms. The debugger's clock is there before the reset line is released.
const HSE_POLLS: u32 = 40_000;

/// Starts the clock tree and reports it.
///
/// Without the external clock the same frequencies are made from the HSI.
pub fn start(rcc: &pac::RCC, pwr: &pac::PWR, flash: &pac::FLASH) -> Clocks {
    rcc.apb1enr().modify(|_, w| w.pwren().set_bit());
    pwr.cr().modify(|_, w| w.vos().scale1());

    rcc.cr().modify(|_, w| w.hsebyp().set_bit());
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    let external = (0..HSE_POLLS).any(|_| rcc.cr().read().hserdy().bit_is_set());
    if external {
        // Should it stop, the non-maskable interrupt ends the program (RM0390 6.2.7).
        rcc.cr().modify(|_, w| w.csson().set_bit());
    } else {
        rcc.cr().modify(|_, w| w.hseon().clear_bit());
    }

    let input_divider = if external { 4 } else { 8 };
    rcc.pllcfgr().write(|w| {
        w.pllsrc().bit(external);
        w.pllp().div2();
        // SAFETY: M, N, Q and R within the ranges of RM0390 6.3.2 (2..63, 50..432,
        // 2..15, 2..7); Q and R feed nothing that is used.
        unsafe {
            w.pllm().bits(input_divider);
            w.plln().bits(180);
            w.pllq().bits(8);
            w.pllr().bits(2)
        }
    });
    rcc.cr().modify(|_, w| w.pllon().set_bit());

    // Over-drive is switched on while the PLL locks (RM0390 5.1.4).
    pwr.cr().modify(|_, w| w.oden().set_bit());
    while pwr.csr().read().odrdy().bit_is_clear() {}
    pwr.cr().modify(|_, w| w.odswen().set_bit());
    while pwr.csr().read().odswrdy().bit_is_clear() {}

    flash.acr().write(|w| {
        w.latency().ws5();
        w.prften().set_bit();
        w.icen().set_bit();
        w.dcen().set_bit()
    });
    while !flash.acr().read().latency().is_ws5() {}

    while rcc.cr().read().pllrdy().bit_is_clear() {}
    rcc.cfgr().modify(|_, w| {
        w.hpre().div1();
        w.ppre1().div4();
        w.ppre2().div2();
        w.sw().pll()
    });
    while !rcc.cfgr().read().sws().is_pll() {}

    Clocks {
        oscillator: if external {
            Oscillator::External
        } else {
            Oscillator::Internal
        },
        core: CORE_HZ,
        apb1: APB1_HZ,
        apb2: APB2_HZ,
        ticks_per_us: crate::time::TICKS_PER_US,
    }
}

/// Reads why the microcontroller started, and clears the flags for the next time.
pub fn reset_cause(rcc: &pac::RCC) -> ResetCause {
    let flags = rcc.csr().read().bits();
    rcc.csr().modify(|_, w| w.rmvf().set_bit());
    ResetCause::from_csr(flags)
}
