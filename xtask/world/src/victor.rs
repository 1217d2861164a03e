//! Victor SP motor driver: the width of the pulses on its line sets the motor's effort.
//!
//! Facts of thesis 2.2.4.3 and the maker's user guide: 1 ms is full reverse, 1.5 ms neutral, 2 ms
//! full forward, linear between; within 4 % of neutral the motor is off; pulses begin 2.9 to
//! 100 ms apart. The following is inferred:
//!
//! - Without a valid pulse for 100 ms the motor is off.
//! - A pulse counts at its falling edge, if the one before began 2.9 to 100 ms earlier. So the first
//!   pulse after a silence sets nothing: its period is unknown.
//! - A pulse shorter than 0.5 ms or longer than 2.5 ms is noise and does not count. From there to 1 and
//!   2 ms the effort is full.
//! - Efforts begin with 4 % at the edge of the dead band.

use crate::random::{Purpose, Stream};
use crate::time::{SimDuration, SimTime, after, since, span_seconds};

/// Width of a pulse for no effort, seconds.
pub const NEUTRAL: f64 = 1.5e-3;

/// Difference from [`NEUTRAL`] at full effort, seconds.
pub const FULL: f64 = 0.5e-3;

/// Largest effort that does not turn the motor.
pub const DEAD_BAND: f64 = 0.04;

/// Shortest time between the beginnings of two pulses.
pub const SHORTEST_PERIOD: SimDuration = SimDuration::from_ticks(2_900_000_000);

/// Longest time between the beginnings of two pulses, and from the end of a valid pulse until the
/// motor is off.
pub const LONGEST_PERIOD: SimDuration = SimDuration::from_ticks(100_000_000_000);

/// Widths of what counts as a pulse, seconds.
const WIDTHS: core::ops::RangeInclusive<f64> = 0.5e-3..=2.5e-3;

/// The clocks of sender and driver differ, and so do the periods that they measure: 2 %.
const TOLERANCE: u64 = 50;

/// Largest error of a driver's own clock, a share of one. The maker gives none; this is that of a
/// microcontroller on a trimmed RC oscillator.
const CLOCK: f64 = 0.01;

/// Errors of the clocks of the drivers on the left and on the right, shares of one. Up to 1 % of a pulse of
/// 1.5 ms is an effort of 3 %, more or less.
#[must_use]
pub fn clocks(seed: u64) -> [f64; 2] {
    let mut errors = Stream::new(seed, Purpose::ServoClocks);
    [(); 2].map(|()| errors.symmetric(CLOCK))
}

/// One motor driver.
#[derive(Clone, Debug)]
pub struct Victor {
    /// Error of its own clock, a share of one.
    clock_error: f64,
    high: bool,
    /// Beginning of the pulse before the current one.
    before: Option<SimTime>,
    /// Beginning of the last pulse.
    rise: Option<SimTime>,
    /// End of the last valid pulse, and its width in seconds.
    valid: Option<(SimTime, f64)>,
    counts: PulseCounts,
}

/// How many pulses a driver has seen.
#[derive(Copy, Clone, Debug, Default, PartialEq, Eq)]
pub struct PulseCounts {
    /// Pulses that set the effort.
    pub valid: u64,
    /// Pulses too short or too long.
    pub odd: u64,
    /// Pulses of a good width, too early or too late after the one before.
    pub untimely: u64,
}

impl Victor {
    /// A driver that has seen no pulse; its line is low. `clock_error` is that of its own clock, a
    /// share of one.
    #[must_use]
    pub fn new(clock_error: f64) -> Self {
        Self {
            clock_error,
            high: false,
            before: None,
            rise: None,
            valid: None,
            counts: PulseCounts::default(),
        }
    }

    /// Error of its own clock, a share of one.
    #[must_use]
    pub fn clock_error(&self) -> f64 {
        self.clock_error
    }

    /// Its line changes to `high` at `at`. Instants must not decrease; a level that it has
    /// already is no change.
    pub fn edge(&mut self, at: SimTime, high: bool) {
        if high == self.high {
            return;
        }
        self.high = high;
        if high {
            self.before = self.rise.replace(at);
            return;
        }
        let Some(rise) = self.rise else { return };
        let width = span_seconds(since(at, rise)) * (1.0 + self.clock_error);
        if !WIDTHS.contains(&width) {
            // Noise does not begin a period either.
            self.rise = self.before;
            self.counts.odd += 1;
            return;
        }
        let timely = self.before.is_some_and(|before| {
            let period = since(rise, before).as_ticks();
            let (least, most) = (SHORTEST_PERIOD.as_ticks(), LONGEST_PERIOD.as_ticks());
            (least - least / TOLERANCE..=most + most / TOLERANCE).contains(&period)
        });
        if timely {
            self.valid = Some((at, width));
            self.counts.valid += 1;
        } else {
            self.counts.untimely += 1;
        }
    }

    /// Effort of the motor at `now`, -1 to 1; not before the last edge.
    #[must_use]
    pub fn effort(&self, now: SimTime) -> f64 {
        match self.valid {
            Some((_, width)) if self.off_at().is_none_or(|off| now < off) => effort_of(width),
            _ => 0.0,
        }
    }

    /// When the motor is switched off unless another pulse comes; `None` before the first valid
    /// pulse.
    #[must_use]
    pub fn off_at(&self) -> Option<SimTime> {
        self.valid.map(|(end, _)| after(end, LONGEST_PERIOD))
    }

    /// Width of the last valid pulse by its own clock, seconds; `None` before the first one.
    #[must_use]
    pub fn width(&self) -> Option<f64> {
        self.valid.map(|(_, width)| width)
    }

    /// What it has seen by now.
    #[must_use]
    pub fn counts(&self) -> PulseCounts {
        self.counts
    }
}

/// Effort for a pulse of `width` seconds: -1 at 1 ms and below, 1 at 2 ms and above, 0 within 4 %
/// of neutral.
#[must_use]
pub fn effort_of(width: f64) -> f64 {
    let effort = ((width - NEUTRAL) / FULL).clamp(-1.0, 1.0);
    // The edge of the band belongs to it, whatever the rounding.
    if effort.abs() <= DEAD_BAND + 1e-9 {
        0.0
    } else {
        effort
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::time::{at, from_seconds};

    /// Sends pulses of `width` ms that begin at `begins` ms, and returns the effort at `now` ms.
    fn effort(begins: &[f64], width: f64, now: f64) -> f64 {
        let mut driver = Victor::new(0.0);
        let time = |ms: f64| at(from_seconds(ms * 1e-3));
        for begin in begins {
            for (edge, high) in [(*begin, true), (begin + width, false)] {
                if edge <= now {
                    driver.edge(time(edge), high);
                }
            }
        }
        driver.effort(time(now))
    }

    #[test]
    fn width_sets_the_effort_linearly_outside_of_the_dead_band() {
        for (width, expected) in [
            (1.0, -1.0),
            (1.25, -0.5),
            (1.479, -0.042),
            (1.48, 0.0),
            (1.5, 0.0),
            (1.52, 0.0),
            (1.521, 0.042),
            (1.75, 0.5),
            (2.0, 1.0),
            (2.4, 1.0),
            (0.6, -1.0),
        ] {
            let found = effort(&[0.0, 5.0], width, 8.0);
            assert!((found - expected).abs() < 1e-9, "{width}: {found}");
        }
    }

    #[test]
    fn the_last_effort_lasts_for_a_tenth_of_a_second() {
        assert_eq!(effort(&[0.0, 5.0], 2.0, 106.9), 1.0);
        assert_eq!(effort(&[0.0, 5.0], 2.0, 107.0), 0.0);
    }

    #[test]
    fn a_pulse_counts_at_its_end_and_if_its_period_is_known_and_accepted() {
        assert_eq!(effort(&[0.0], 2.0, 3.0), 0.0);
        assert_eq!(effort(&[0.0, 5.0], 2.0, 6.9), 0.0);
        assert_eq!(effort(&[0.0, 2.7], 2.0, 5.0), 0.0);
        assert_eq!(effort(&[0.0, 2.9], 2.0, 5.0), 1.0);
        assert_eq!(effort(&[0.0, 100.0], 2.0, 103.0), 1.0);
        assert_eq!(effort(&[0.0, 103.0], 2.0, 106.0), 0.0);
    }

    #[test]
    fn noise_changes_nothing() {
        let mut driver = Victor::new(0.0);
        let time = |us: u64| SimTime::from_ticks(us * 1_000_000);
        let mut pulse = |from: u64, width: u64| {
            driver.edge(time(from), true);
            driver.edge(time(from + width), false);
            driver.effort(time(from + width))
        };
        pulse(0, 1_750);
        assert_eq!(pulse(5_000, 1_750), 0.5);
        assert_eq!(pulse(7_000, 20), 0.5);
        assert_eq!(pulse(8_000, 2_000), 1.0);
        assert_eq!(pulse(13_000, 2_600), 1.0);
        assert_eq!(pulse(18_000, 1_250), -0.5);
        let counts = PulseCounts {
            valid: 3,
            odd: 2,
            untimely: 1,
        };
        assert_eq!(driver.counts(), counts);
    }

    #[test]
    fn its_own_clock_measures_the_width() {
        let mut driver = Victor::new(0.01);
        for begin in [0, 5_000] {
            driver.edge(SimTime::from_ticks(begin * 1_000_000), true);
            driver.edge(SimTime::from_ticks((begin + 1_750) * 1_000_000), false);
        }
        let found = driver.effort(SimTime::from_ticks(6_750_000_000));
        assert!((found - 0.535).abs() < 1e-9, "{found}");
        let width = driver.width().unwrap();
        assert!((width - 1.7675e-3).abs() < 1e-12, "{width}");
    }

    proptest! {
        #[test]
        fn no_edges_give_more_than_full_effort_or_effort_after_a_silence(
            gaps in prop::collection::vec((0_u64..120_000, any::<bool>()), 0..60),
        ) {
            let mut driver = Victor::new(0.0);
            let mut now = 0;
            for (gap, high) in gaps {
                now += gap * 1_000_000;
                driver.edge(SimTime::from_ticks(now), high);
                prop_assert!(driver.effort(SimTime::from_ticks(now)).abs() <= 1.0);
            }
            let later = after(SimTime::from_ticks(now), LONGEST_PERIOD);
            prop_assert_eq!(driver.effort(later), 0.0);
        }
    }
}
