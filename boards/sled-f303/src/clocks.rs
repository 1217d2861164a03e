//! 72 MHz from an external 8 MHz clock, 64 MHz without one (RM0316 9.2).
//!
//! With the clock: 8 MHz x 9 = 72 MHz, APB1 / 2 = 36 MHz, APB2 72 MHz. Without: HSI /
//! 2 x 16 = 64 MHz, APB1 32 MHz, APB2 64 MHz. Two flash wait states for both.
//! The Nucleo-F303K8 gets the debugger's clock only when its solder bridges say so, so
//! the program asks the hardware and not the builder.

use crate::pac;
use sled_common::clock::{Clocks, Oscillator, ResetCause};

/// With the external clock.
pub const EXTERNAL: Clocks = Clocks {
    oscillator: Oscillator::External,
    core: 72_000_000,
    apb1: 36_000_000,
    apb2: 72_000_000,
    ticks_per_us: 18,
};

/// With the RC oscillator.
pub const INTERNAL: Clocks = Clocks {
    oscillator: Oscillator::Internal,
    core: 64_000_000,
    apb1: 32_000_000,
    apb2: 64_000_000,
    ticks_per_us: 16,
};

/// Polls that the external clock is given, about 10 cycles of the 8 MHz HSI each: 25 ms.
/// The debugger's clock is there before the reset line is released.
const HSE_POLLS: u32 = 20_000;

/// Multiplier code of CFGR.PLLMUL: code = factor - 2 (RM0316 9.4.2).
const PLL_TIMES_9: u8 = 9 - 2;
const PLL_TIMES_16: u8 = 16 - 2;

/// Starts the clock tree and reports which one it became.
pub fn start(rcc: &pac::RCC, flash: &pac::FLASH) -> Clocks {
    rcc.cr.modify(|_, w| w.hsebyp().set_bit());
    rcc.cr.modify(|_, w| w.hseon().set_bit());
    let external = (0..HSE_POLLS).any(|_| rcc.cr.read().hserdy().bit_is_set());
    if external {
        // Should it stop, the non-maskable interrupt ends the program (RM0316 9.2.7).
        rcc.cr.modify(|_, w| w.csson().set_bit());
    } else {
        rcc.cr.modify(|_, w| w.hseon().clear_bit());
    }

    flash
        .acr
        .modify(|_, w| w.prftbe().set_bit().latency().ws2());

    rcc.cfgr.modify(|_, w| {
        w.hpre().div1();
        w.ppre1().div2();
        w.ppre2().div1();
        if external {
            w.pllsrc().hse_div_prediv();
            w.pllmul().bits(PLL_TIMES_9)
        } else {
            w.pllsrc().hsi_div2();
            w.pllmul().bits(PLL_TIMES_16)
        }
    });
    rcc.cr.modify(|_, w| w.pllon().set_bit());
    while rcc.cr.read().pllrdy().bit_is_clear() {}
    rcc.cfgr.modify(|_, w| w.sw().pll());
    while !rcc.cfgr.read().sws().is_pll() {}

    if external { EXTERNAL } else { INTERNAL }
}

/// Reads why the microcontroller started, and clears the flags for the next time.
pub fn reset_cause(rcc: &pac::RCC) -> ResetCause {
    let flags = rcc.csr.read().bits();
    rcc.csr.modify(|_, w| w.rmvf().set_bit());
    ResetCause::from_csr(flags)
}
