//! Compares the external clock with the RC oscillator, on which the core runs after a reset.
//!
//! TIM11 counts the core's clock, and its channel 1 captures the external clock behind the
//! divider of the real-time clock (TI1_RMP = 10, RM0390 20.6.11).

use crate::pac;
use parts::SLED_F446;

/// Divider of the external clock for the real-time clock, which is not used.
pub(crate) const DIVIDER: u8 = 8;
/// Edges of the divided clock from one capture to the next.
const EDGES: u32 = 8;
/// Captures that are counted over: 0.5 ms.
const CAPTURES: u32 = 64;
/// How often the flag of a capture is polled: with 10 cycles a poll, a quarter of the external
/// clock's frequency is still captured.
const POLLS: u32 = 100;

/// Counts over all captures when both clocks are right.
const EXPECTED: u32 = (SLED_F446.part.hsi.hz as u64 * (DIVIDER as u32 * EDGES * CAPTURES) as u64
    / SLED_F446.external_hz as u64) as u32;
const _: () = assert!(4 * EXPECTED < u16::MAX as u32, "the counter does not wrap");

/// Error of the external clock by the RC oscillator, in tenths of a per cent. `None` if it gives
/// no edges. The clock gate of TIM11 is open, APB2 is not divided, and
/// the real-time clock's divider is [`DIVIDER`].
pub(crate) fn external_error(timer: &pac::TIM11) -> Option<i16> {
    // SAFETY: the input of the divided external clock.
    timer.or().write(|w| unsafe { w.rmp().bits(2) });
    timer.arr().write(|w| w.arr().set(u16::MAX));
    // SAFETY: channel 1 captures its own input (01), every eighth edge (11).
    timer
        .ccmr1_input()
        .write(|w| unsafe { w.bits(0b11 << 2 | 0b01) });
    timer.ccer().write(|w| w.cc1e().set_bit());
    timer.cr1().write(|w| w.cen().set_bit());
    let counts = count(timer);
    timer.cr1().reset();
    timer.ccer().reset();
    let counts = i32::from(counts?);
    // A fast clock has short distances between its edges.
    let error = (1000 * EXPECTED.cast_signed()).checked_div(counts)? - 1000;
    i16::try_from(error).ok()
}

/// Counts from the first to the last capture.
fn count(timer: &pac::TIM11) -> Option<u16> {
    let first = capture(timer)?;
    let mut last = first;
    for _ in 0..CAPTURES {
        last = capture(timer)?;
    }
    Some(last.wrapping_sub(first))
}

/// Waits for the next capture, for a bounded time.
fn capture(timer: &pac::TIM11) -> Option<u16> {
    (0..POLLS)
        .any(|_| timer.sr().read().cc1if().bit_is_set())
        .then(|| timer.ccr1().read().bits() as u16)
}
