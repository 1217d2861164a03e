//! Clock gates. A peripheral can be used as soon as one of these functions has returned.
//!
//! The part loses accesses to a peripheral whose clock was enabled too recently. The errata sheet
//! (ES0298, "Delay after an RCC peripheral clock enabling") asks for 2 cycles before the first
//! access to a peripheral on AHB, and for 1 + (AHB/APB prescaler) cycles on APB. The HAL only
//! waits until its store has ended.

use crate::clocks::{APB1_HZ, APB2_HZ, CORE_HZ};
use crate::pac;
use stm32f4xx_hal::rcc::Enable;

/// NOPs that suffice on every bus.
const NOPS: u32 = 5;
const _: () = assert!(NOPS > CORE_HZ / APB1_HZ && NOPS > CORE_HZ / APB2_HZ && NOPS >= 2);

/// Enables the clock of a peripheral.
#[inline(always)]
pub(crate) fn open<P: Enable>(rcc: &mut pac::RCC) {
    P::enable(rcc);
    // The enable register is read back first, so that the delay begins after the write.
    let _ = P::is_enabled();
    wait();
}

/// Enables the clock of the power control.
#[inline(always)]
pub(crate) fn open_power(rcc: &pac::RCC) {
    rcc.apb1enr().modify(|_, w| w.pwren().set_bit());
    let _ = rcc.apb1enr().read();
    wait();
}

/// Enables the clock of TIM11, before the HAL has the clock control.
pub(crate) fn open_ratio(rcc: &pac::RCC) {
    rcc.apb2enr().modify(|_, w| w.tim11en().set_bit());
    let _ = rcc.apb2enr().read();
    wait();
}

#[inline(always)]
fn wait() {
    cortex_m::asm::dsb();
    // One for each of `NOPS`.
    cortex_m::asm::nop();
    cortex_m::asm::nop();
    cortex_m::asm::nop();
    cortex_m::asm::nop();
    cortex_m::asm::nop();
}
