//! Few, deliberate movements of an actuator with a dead band.
//!
//! A steering actuator that holds its angle by itself need not answer every
//! small wish. Compensating its dead band turns noise into full-blooded
//! commands of alternating sign (thesis Figure 7.26); so small wishes are left
//! alone, and a movement once begun goes on until it has arrived.

use crate::scalar::Scalar;

/// When to move and when to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HoldSettings<T> {
    /// Difference of wish and angle at which a movement begins, rad.
    pub begin: T,
    /// Difference at which it ends, rad; less than `begin`.
    pub end: T,
    /// Slowest rate worth commanding, rad/s.
    pub slowest: T,
}

/// Rests or moves; the one bit of memory that makes the hysteresis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Hold {
    /// Sign of the movement under way; zero at rest.
    direction: i8,
}

impl Hold {
    /// An actuator at rest.
    #[must_use]
    pub const fn new() -> Self {
        Self { direction: 0 }
    }

    /// Whether the actuator rests.
    #[must_use]
    pub const fn rests(&self) -> bool {
        self.direction == 0
    }

    /// The rate (rad/s) to command when `error` (rad) is still to go and
    /// `follow` (1/s) is the regulator's gain: zero at rest. `dt` (s) is the
    /// time for which the command will hold; the movement is not commanded
    /// beyond its end.
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
            // A wish far on the other side starts a movement at once.
            if !(size > settings.begin) {
                return T::zero();
            }
            self.direction = sign;
        }
        let mut rate = size * follow;
        if rate < settings.slowest {
            rate = settings.slowest;
        }
        let arrive = size / dt;
        if rate > arrive {
            rate = arrive;
        }
        if forward { rate } else { -rate }
    }
}
