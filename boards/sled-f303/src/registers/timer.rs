//! A timer that raises its trigger output at a fixed rate (RM0316 chapter 21).

use crate::pac;

/// Starts TIM3, which runs at `clock` hertz, to raise TRGO `HZ` times a second. Its clock gate
/// is open.
pub(crate) fn start<const HZ: u32>(timer: &pac::TIM3, clock: u32) {
    // 72 or 64 MHz to 1 MHz.
    let prescaler = clock / 1_000_000;
    let period = const { 1_000_000 / HZ - 1 } as u16;
    timer
        .psc
        .write(|w| w.psc().bits(prescaler.wrapping_sub(1) as u16));
    timer.arr.write(|w| w.arr().bits(period));
    timer.egr.write(|w| w.ug().set_bit());
    timer.cr2.write(|w| w.mms().update());
    timer.cr1.write(|w| w.cen().set_bit());
}
