//! Servo pulses of the right width, although an RC oscillator makes them.
//!
//! A Victor SP takes a pulse for neutral that differs from 1500 us by 20 us at most, 4 % of 500 us. Its
//! own clock may be off by 1 %, which are 15 us. So 5 us or 0.33 % are left for the clock of the node.
//! The references trim an RC oscillator to 0.35 % at best (see [`oscillator`](crate::oscillator)), and it
//! may drift by up to [`TOLERANCE_PPM`](crate::link::TOLERANCE_PPM) until it is trimmed again. But the
//! node measures its rate against the master's clock in every basic cycle. [`PulseScale`] makes the
//! widths right by it, and [`PulseClock`] says whether it is known.

use sled_common::clock::Oscillator;
use sled_common::pulse::PulseWidth;

use crate::rows::pulse;

/// Steps in a row in which the rate must be known before the node makes pulses: 100 ms. A rate that was
/// measured against another oscillator of the master is corrected within three references.
const SETTLED: u8 = 10;

/// Steps without a command after which an RC oscillator makes no pulses any more. By then the neutral
/// ones have stopped the motors.
const PAUSE: u8 = 3;

/// By how much the widths of pulses are changed, because the clock that makes them is fast or slow.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PulseScale {
    /// Rate of true time against the clock less 1, in 2^-32.
    rate: i32,
}

impl PulseScale {
    /// The widths as they are: the clock is right.
    pub const NOMINAL: Self = Self { rate: 0 };

    /// For a clock against which true time has this rate less 1, in 2^-32; see
    /// [`Link::true_rate`](crate::link::Link::true_rate).
    pub const fn of(rate: i32) -> Self {
        Self { rate }
    }

    /// The pulse for an effort in 1/500, in microseconds of the clock. Within 1 %, the most that a
    /// rate can be, it is right to 0.7 us; pulses of nearly full effort end at 1000 and 2000 us of the
    /// clock.
    #[inline]
    pub const fn pulse(self, effort: i16) -> PulseWidth {
        let us = pulse(effort).us();
        let excess = (us as i64 * self.rate as i64 + (1 << 31)) >> 32;
        PulseWidth::clamped((us as i32 - excess as i32) as u16)
    }
}

/// Whether the clock of a node is known well enough for servo pulses. One step with each step of the
/// housekeeping, 100 times a second.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PulseClock {
    internal: bool,
    scale: PulseScale,
    /// Steps in a row in which the rate was known.
    known: u8,
    /// Steps in a row without a command.
    idle: u8,
}

impl PulseClock {
    /// The clock of a node on this oscillator. The external clock is known from the start.
    pub const fn new(oscillator: Oscillator) -> Self {
        let internal = matches!(oscillator, Oscillator::Internal);
        Self {
            internal,
            scale: PulseScale::NOMINAL,
            known: if internal { 0 } else { SETTLED },
            idle: 0,
        }
    }

    /// A step. `rate` is [`Link::true_rate`](crate::link::Link::true_rate); `commanded` tells whether
    /// a command is in force.
    pub fn step(&mut self, rate: Option<i32>, commanded: bool) {
        match rate {
            Some(rate) => {
                self.scale = PulseScale::of(rate);
                self.known = self.known.saturating_add(1);
            }
            // The last neutral pulses are made with the last rate that was known.
            None => self.known = 0,
        }
        self.idle = if commanded && self.is_known() {
            0
        } else {
            self.idle.saturating_add(1)
        };
    }

    /// Whether commands may be obeyed.
    pub const fn is_known(&self) -> bool {
        self.known >= SETTLED
    }

    /// Whether the node is to make no pulses: it is on its RC oscillator, and no command has been in
    /// force, or its clock has not been known, for some steps.
    pub const fn is_paused(&self) -> bool {
        self.internal && self.idle >= PAUSE
    }

    /// By how much widths are changed.
    pub const fn scale(&self) -> PulseScale {
        self.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::TOLERANCE_PPM;
    use proptest::prelude::*;

    /// The rate of true time against a clock that is fast by `ppm`, as the protocol stack measures it.
    fn rate(ppm: f64) -> i32 {
        ((1.0 / (1.0 + ppm * 1e-6) - 1.0) * 4_294_967_296.0) as i32
    }

    /// How long a pulse for `effort` really is, us.
    fn width(effort: i16, ppm: f64, measured: f64) -> f64 {
        let scale = PulseScale::of(rate(measured));
        f64::from(scale.pulse(effort).us()) / (1.0 + ppm * 1e-6)
    }

    /// A Victor SP's dead band, us, and the largest error of its own clock.
    const DEAD_BAND: f64 = 20.0;
    const DRIVER_CLOCK: f64 = 0.01;

    #[test]
    fn the_external_clock_is_known_and_never_pauses() {
        let mut clock = PulseClock::new(Oscillator::External);
        assert!(clock.is_known());
        for _ in 0..300 {
            clock.step(Some(0), false);
            assert!(clock.is_known() && !clock.is_paused());
        }
        assert_eq!(clock.scale(), PulseScale::NOMINAL);
    }

    #[test]
    fn an_rc_oscillator_is_known_after_a_tenth_of_a_second() {
        let mut clock = PulseClock::new(Oscillator::Internal);
        for step in 1..=20 {
            clock.step(Some(rate(5_000.0)), true);
            assert_eq!(clock.is_known(), step >= 10, "{step}");
            assert_eq!(clock.is_paused(), (3..10).contains(&step), "{step}");
        }
        // Neutral pulses follow a lost clock for some steps, with the rate that it had.
        for step in 1..=20 {
            clock.step(None, true);
            assert!(!clock.is_known());
            assert_eq!(clock.is_paused(), step >= 3, "{step}");
            assert_eq!(clock.scale(), PulseScale::of(rate(5_000.0)));
        }
        for step in 1..=9 {
            clock.step(Some(0), true);
            assert!(!clock.is_known(), "{step}");
        }
        clock.step(Some(0), false);
        assert!(clock.is_known() && clock.is_paused());
        clock.step(Some(0), true);
        assert!(!clock.is_paused());
        for step in 1..=5 {
            clock.step(Some(0), false);
            assert_eq!(clock.is_paused(), step >= 3, "{step}");
        }
    }

    #[test]
    fn a_right_clock_makes_the_widths_as_they_are() {
        for effort in i16::MIN..=i16::MAX {
            assert_eq!(PulseScale::NOMINAL.pulse(effort), pulse(effort));
        }
    }

    proptest! {
        /// However far an oscillator is off that takes part in the traffic, and whatever the clock of the
        /// motor driver, a neutral pulse is neutral. The rate is measured to 500 ppm: 2 us in a cycle of
        /// 5 ms, and what a drift adds.
        #[test]
        fn a_neutral_pulse_is_neutral_for_every_driver(
            share in -1.0..1.0_f64, driver in -DRIVER_CLOCK..DRIVER_CLOCK, noise in -500.0..500.0_f64,
        ) {
            let ppm = share * f64::from(TOLERANCE_PPM);
            let read = width(0, ppm, ppm + noise) * (1.0 + driver);
            prop_assert!((read - 1500.0).abs() < DEAD_BAND - 3.0, "{read} us");
        }

        #[test]
        fn every_width_is_right(share in -1.0..1.0_f64, effort in -480..480_i16) {
            let ppm = share * f64::from(TOLERANCE_PPM);
            let width = width(effort, ppm, ppm);
            prop_assert!((width - 1500.0 - f64::from(effort)).abs() < 0.7, "{width} us");
        }

        #[test]
        fn no_rate_makes_a_pulse_out_of_range(rate: i32, effort: i16) {
            let us = PulseScale::of(rate).pulse(effort).us();
            prop_assert!((1000..=2000).contains(&us));
        }
    }
}
