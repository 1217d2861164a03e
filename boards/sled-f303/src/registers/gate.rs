//! Clock gates. A peripheral can be used as soon as one of these functions has returned.
//!
//! The F4 loses accesses to a peripheral whose clock was enabled too recently: its errata sheet
//! (ES0298, "Delay after an RCC peripheral clock enabling") asks for 2 cycles before the first
//! access to a peripheral on AHB, and for 1 + (AHB/APB prescaler) cycles on APB. The documents of
//! the F303 give no number; the clock control is of the same kind, so the same delay is kept here.

use crate::clocks::{EXTERNAL, INTERNAL};
use crate::pac;
use sled_common::clock::Clocks;
use stm32f3xx_hal::rcc::{Enable, RccBus};

/// NOPs that suffice on every bus.
const NOPS: u32 = 3;
const fn suffices(clocks: &Clocks) -> bool {
    NOPS > clocks.core / clocks.apb1 && NOPS > clocks.core / clocks.apb2 && NOPS >= 2
}
const _: () = assert!(suffices(&EXTERNAL) && suffices(&INTERNAL));

/// Enables the clock of a peripheral.
#[inline(always)]
pub(crate) fn open<P: Enable>(bus: &mut <P as RccBus>::Bus) {
    P::enable(bus);
    // The enable register is read back first, so that the delay begins after the write.
    let _ = P::is_enabled();
    wait();
}

/// Enables the clock of TIM16, before the HAL has the clock control.
pub(crate) fn open_ratio(rcc: &pac::RCC) {
    rcc.apb2enr.modify(|_, w| w.tim16en().set_bit());
    let _ = rcc.apb2enr.read();
    wait();
}

#[inline(always)]
fn wait() {
    cortex_m::asm::dsb();
    // One for each of `NOPS`.
    cortex_m::asm::nop();
    cortex_m::asm::nop();
    cortex_m::asm::nop();
}
