//! When sections of an implement are switched, as a message tells it.
//!
//! A message tells of the basic cycle after its own: the state of each section at the beginning of that cycle, and the time within
//! it after which the state changes. So a switch is as exact as the prediction, and not as coarse as the basic cycle.

use control::mission::{Section, Switching};

/// The time of a section that does not change within the cycle.
pub const NEVER: u8 = 127;

/// What is told of a section.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Told {
    /// Whether it is on when the cycle begins.
    pub on: bool,
    /// Time within the cycle after which it changes, ms; [`NEVER`] if it does not.
    pub after: u8,
}

/// A section whose command takes effect in the cycle after that of the control step, which is released at the cycle time
/// `release` (s) of a cycle of `period` (s): the time from the step to the beginning of the next cycle is a delay of its own.
#[must_use]
pub fn lead(section: &Section<f32>, period: f32, release: f32) -> Section<f32> {
    let lead = period - release;
    Section {
        on_delay: section.on_delay + lead,
        off_delay: section.off_delay + lead,
        ..*section
    }
}

/// What is told of all sections.
#[must_use]
pub fn told(switching: &Switching<f32>) -> [Told; 8] {
    let mut all = [Told::default(); 8];
    // loop-bound: 8
    for (bit, (told, later)) in all.iter_mut().zip(&switching.later).enumerate() {
        told.on = switching.now & 1 << bit != 0;
        // The conversion takes what is too large for the largest number, and none of them is below zero.
        told.after = later.map_or(NEVER, |time| {
            let milliseconds = (time * 1e3 + 0.5) as u8;
            milliseconds.min(NEVER - 1)
        });
    }
    all
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Whatever is decided, the state told and its change are those decided, to half a millisecond.
        #[test]
        fn what_is_decided_is_told(now: u8, times in prop::array::uniform8(prop::option::of(0.0..0.126_f32))) {
            let told = told(&Switching { now, later: times });
            for (bit, (told, time)) in told.iter().zip(times).enumerate() {
                prop_assert_eq!(told.on, now >> bit & 1 != 0);
                match time {
                    None => prop_assert_eq!(told.after, NEVER),
                    Some(time) => {
                        prop_assert!(told.after < NEVER);
                        prop_assert!((f32::from(told.after) * 1e-3 - time).abs() <= 0.000_501);
                    }
                }
            }
        }
    }

    #[test]
    fn a_change_at_the_end_of_a_long_cycle_is_no_missing_one() {
        let told = told(&Switching {
            now: 0,
            later: [Some(0.4); 8],
        });
        assert!(told.iter().all(|told| told.after == NEVER - 1));
    }

    #[test]
    fn the_next_cycle_is_a_delay() {
        let section = Section {
            on_delay: 0.6,
            off_delay: 0.2,
            ahead: -1.0,
        };
        let led = lead(&section, 0.1, 0.006);
        assert!((led.on_delay - 0.694).abs() < 1e-6);
        assert!((led.off_delay - 0.294).abs() < 1e-6);
        assert_eq!(led.ahead, -1.0);
    }
}
