//! Servo pulses for two motor drivers (Victor SP): PA7 left, PA10 right, made by TIM1 with a
//! resolution of 1 us.
//!
//! Both pulses begin together, and again after each [`PulsePeriod`]. [`Servos::fire`] begins them at
//! once, for a command that has just arrived, if 3 ms have passed since the last ones began; else
//! the new widths come with the next pulses. A pulse that has begun keeps its width.
//!
//! No pulses are made until [`Servos::begin`]. An RC oscillator that nothing has trimmed is off by up
//! to 5 %, and its neutral pulse would be an effort of 15 %; without pulses the motor drivers stand
//! still. So the node begins as soon as its clock is known to be right.
//!
//! So that every command is fired at once, the period is longer than the time between two commands,
//! and that is 3 ms or more.
//!
//! # When the node fails
//!
//! - The external clock stops: the pulses end at once, in hardware. A pulse that runs is cut, and is
//!   never too long.
//! - The program ends by a fault: [`end`] lets the pulses end first.
//! - A reset by the pin or the watchdog, or a lost supply: the pins float, a resistor pulls them low,
//!   and a pulse that runs is cut.
//!
//! Then no pulses follow, and the motor drivers stop. A cut pulse is shorter than it was to be: one
//! of less than 1 ms is none, a longer one counts as another command until the driver misses the
//! pulses.

use crate::pac;
use crate::registers::pulse;
use sled_common::pulse::{PulsePeriod, PulseWidth};

/// The two servo outputs.
pub struct Servos {
    timer: pac::TIM1,
    period: PulsePeriod,
    /// Widths that were set last.
    widths: (PulseWidth, PulseWidth),
    /// Whether the pulses have begun.
    begun: bool,
}

/// Starts the timer; its outputs are low. `clock` is that of the timer in hertz. The clock gate of
/// TIM1 is open, and the pins are not connected yet.
pub(crate) fn start(timer: pac::TIM1, clock: u32, period: PulsePeriod) -> Servos {
    pulse::start(&timer, clock, period);
    Servos {
        timer,
        period,
        widths: (PulseWidth::NEUTRAL, PulseWidth::NEUTRAL),
        begun: false,
    }
}

impl Servos {
    /// Lets pulses out from the next one on, neutral ones unless other widths have been set. True if
    /// that was done, now or before; a lost clock ends them for good. False in the first 2 ms of each
    /// period, in which the first pulse would be cut: call it again then.
    #[inline]
    pub fn begin(&mut self) -> bool {
        if !self.begun {
            self.begun = cortex_m::interrupt::free(|_| pulse::begin(&self.timer));
        }
        self.begun
    }

    /// Makes no more pulses until [`Servos::begin`]. False if a pulse may run, which is not cut: call it
    /// again then.
    ///
    /// For a node on its RC oscillator that has lost the references to trim it by.
    pub fn pause(&mut self) -> bool {
        if self.begun && cortex_m::interrupt::free(|_| pulse::pause(&self.timer)) {
            self.begun = false;
        }
        !self.begun
    }

    /// Sets the widths of the next pulses and of all that follow. Both change together.
    #[inline]
    pub fn set(&mut self, left: PulseWidth, right: PulseWidth) {
        self.widths = (left, right);
        pulse::set(&self.timer, left, right);
    }

    /// Sets the widths and begins pulses with them at once. False if the last pulses began less than
    /// 3 ms ago, or the next ones begin within 2 us anyway: then the widths come with these. False, too,
    /// before [`Servos::begin`].
    ///
    /// Interrupts are masked for the time of some instructions, so that no pulse of the timer's own
    /// comes in between and is lengthened.
    #[inline]
    pub fn fire(&mut self, left: PulseWidth, right: PulseWidth) -> bool {
        self.widths = (left, right);
        cortex_m::interrupt::free(|_| {
            pulse::set(&self.timer, left, right);
            self.begun && pulse::fire(&self.timer, self.period)
        })
    }

    /// Neutral from the next pulses on.
    #[inline]
    pub fn stop(&mut self) {
        self.set(PulseWidth::NEUTRAL, PulseWidth::NEUTRAL);
    }

    /// The widths that were set last, left and right.
    pub fn widths(&self) -> (PulseWidth, PulseWidth) {
        self.widths
    }

    /// Whether both widths are neutral.
    pub fn is_neutral(&self) -> bool {
        self.widths == (PulseWidth::NEUTRAL, PulseWidth::NEUTRAL)
    }

    /// Whether pulses are made: they have begun. A lost clock ends them; only a new start of the node
    /// makes them again.
    pub fn is_on(&self) -> bool {
        pulse::is_on(&self.timer)
    }
}

/// Lets the present pulses end and keeps the outputs low from then on. Uses no state, and does
/// nothing on a node without servo outputs. Waits for 2 ms at most.
///
/// For the end of the program.
pub fn end() {
    pulse::end();
}
