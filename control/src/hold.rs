//! The hold: few movements of an actuator with a dead band.
//!
//! A steering actuator that keeps its angle by itself need not follow every
//! small change of its target. With the dead band compensated, noise becomes
//! large commands of alternating sign (thesis Figure 7.26). So the hold ignores
//! small errors, and once a movement has begun, it continues to the target.

use crate::scalar::Scalar;

/// Thresholds of the hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoldSettings<T> {
    /// Difference of target and angle at which a movement begins, rad.
    pub begin: T,
    /// Difference at which a movement ends, rad; less than `begin`.
    pub end: T,
    /// Slowest rate to command, rad/s.
    pub slowest: T,
}

/// The state of the hysteresis: at rest or moving.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hold {
    /// Sign of the current movement; zero at rest.
    direction: i8,
}

impl Hold {
    /// An actuator at rest.
    #[must_use]
    pub const fn new() -> Self {
        Self { direction: 0 }
    }

    /// True if the actuator rests.
    #[must_use]
    pub const fn rests(&self) -> bool {
        self.direction == 0
    }

    /// The rate (rad/s) to command, zero at rest. `error` (rad) is the remaining
    /// angle, `follow` (1/s) the regulator's gain, and `dt` (s) the time for
    /// which the command applies. The rate does not move beyond the target within
    /// that time.
    pub fn rate<T: Scalar>(&mut self, settings: &HoldSettings<T>, error: T, follow: T, dt: T) -> T {
        let forward = error > T::zero();
        let sign: i8 = if forward { 1 } else { -1 };
        let size = error.abs();
        if self.direction == 0 {
            if !(size > settings.begin) {
                return T::zero();
            }
            self.direction = sign;
        } else if !(size > settings.end) || self.direction != sign {
            self.direction = 0;
            // A target far on the other side starts a new movement at once.
            if !(size > settings.begin) {
                return T::zero();
            }
            self.direction = sign;
        }
        let mut rate = size * follow;
        if rate < settings.slowest {
            rate = settings.slowest;
        }
        if rate * dt > size {
            rate = size / dt;
        }
        if forward { rate } else { -rate }
    }
}
