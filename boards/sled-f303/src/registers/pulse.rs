//! TIM1 makes two servo pulses (RM0316 chapter 20): its complementary channel 1 and its channel 3,
//! which begin together when the counter wraps and end at their compare values.
//!
//! The compare values are preloaded: a new one counts from the beginning of a pulse. When the clock
//! security system finds the external clock missing, the break input drives both outputs low in
//! hardware, before any instruction runs.

use crate::pac::{self, tim1::RegisterBlock};
use sled_common::pulse::{PulsePeriod, PulseWidth};

/// PWM mode 1 (high until the compare value) with preload, for the first channel of a register
/// (RM0316 20.4.7).
const PWM: u32 = 0b110 << 4 | 1 << 3;
/// The complementary output of channel 1 and the output of channel 3 (RM0316 20.4.9).
const OUTPUTS: u32 = 1 << 2 | 1 << 8;
/// The outputs are on; the break input is on and active high, so that an open pin is no break; the
/// idle level is driven (RM0316 20.4.18).
const ENABLED: u32 = 1 << 15 | 1 << 13 | 1 << 12 | 1 << 10;
/// The outputs have their idle level, low.
const IDLE: u32 = ENABLED & !(1 << 15);
/// CR1: count; no update events.
const COUNT: u32 = 1;
const NO_UPDATE: u32 = 1 << 1;

/// Time from the start of the counter to its first wrap, us. Outputs that are switched on in it begin
/// with that.
const FIRST: u16 = 100;

/// From so many microseconds before the counter wraps it is left to itself: between a look at the
/// counter and what is done about it lies less.
const MARGIN: u16 = 2;

/// Starts the counter, with the widths of neutral pulses. The outputs are off, their lines driven
/// low. `clock` is the timer's clock in hertz. The clock gate is open.
pub(crate) fn start(timer: &pac::TIM1, clock: u32, period: PulsePeriod) {
    let prescaler = clock / 1_000_000;
    timer
        .psc
        .write(|w| w.psc().bits(prescaler.wrapping_sub(1) as u16));
    timer.arr.write(|w| w.arr().bits(period.us() - 1));
    load(timer, PulseWidth::NEUTRAL, PulseWidth::NEUTRAL);
    // SAFETY: values of the registers, as above. The break input takes its polarity a cycle after it
    // is written, so it is on long before the outputs are.
    unsafe {
        timer.ccmr1_output().write(|w| w.bits(PWM));
        timer.ccmr2_output().write(|w| w.bits(PWM));
        timer.bdtr.write(|w| w.bits(IDLE));
        timer.ccer.write(|w| w.bits(OUTPUTS));
    }
    timer.egr.write(|w| w.ug().set_bit());
    timer.cnt.write(|w| w.cnt().bits(period.us() - FIRST));
    timer.cr1.write(|w| w.cen().set_bit());
}

/// Switches the outputs on, unless the counter is where a pulse would be: the rest of one is not let
/// out. True if it did.
pub(crate) fn begin(timer: &pac::TIM1) -> bool {
    let between = timer.cnt.read().cnt().bits() >= PulseWidth::LONGEST.us();
    if between {
        // SAFETY: a value of the register, as above.
        timer.bdtr.write(|w| unsafe { w.bits(ENABLED) });
    }
    between
}

/// Switches the outputs off, unless a pulse may run. True if it did.
pub(crate) fn pause(timer: &pac::TIM1) -> bool {
    let between = timer.cnt.read().cnt().bits() >= PulseWidth::LONGEST.us();
    if between {
        // SAFETY: a value of the register, as above.
        timer.bdtr.write(|w| unsafe { w.bits(IDLE) });
    }
    between
}

#[inline(always)]
fn load(timer: &pac::TIM1, left: PulseWidth, right: PulseWidth) {
    timer.ccr1().write(|w| w.ccr().bits(left.us()));
    timer.ccr3().write(|w| w.ccr().bits(right.us()));
}

/// Sets both widths from the next pulses on.
#[inline(always)]
pub(crate) fn set(timer: &pac::TIM1, left: PulseWidth, right: PulseWidth) {
    // Without update events in between no pair is half old and half new. If the counter wraps
    // meanwhile, its pulses are the old pair.
    // SAFETY: two bits of the register; the others stay zero.
    unsafe {
        timer.cr1.write(|w| w.bits(COUNT | NO_UPDATE));
        load(timer, left, right);
        timer.cr1.write(|w| w.bits(COUNT));
    }
}

/// Begins pulses now, unless the last ones began less than [`PulsePeriod::SHORTEST`] ago or the next
/// ones begin by themselves within some microseconds. True if it did. Nothing may interrupt it.
#[inline(always)]
pub(crate) fn fire(timer: &pac::TIM1, period: PulsePeriod) -> bool {
    let count = timer.cnt.read().cnt().bits();
    let free = count >= PulsePeriod::SHORTEST.us() && count < period.us() - MARGIN;
    if free {
        timer.egr.write(|w| w.ug().set_bit());
    }
    free
}

/// Whether the outputs are on. The break input switches them off.
pub(crate) fn is_on(timer: &RegisterBlock) -> bool {
    timer.bdtr.read().moe().bit_is_set()
}

/// Lets the present pulses end and keeps the outputs low from then on. Uses no state.
///
/// For the end of the program: a reset in the middle of a pulse would cut it, and the motor driver
/// would take it for another command. Waits for 2 ms at most: the counter counts as long as the
/// outputs are on, because a lost clock switches them off. All images of this board have this
/// function, so it is short.
pub(crate) fn end() {
    // SAFETY: nothing else runs any more; a timer without its clock reads as zero.
    let timer = unsafe { &*pac::TIM1::ptr() };
    let longest = u32::from(PulseWidth::LONGEST.us());
    while is_on(timer) {
        if timer.cnt.read().bits() >= longest {
            // SAFETY: a value of the register, as above.
            timer.bdtr.write(|w| unsafe { w.bits(IDLE) });
        }
    }
}
