//! How fast the vehicle may become faster, slower, or drive round a bend.

use crate::scalar::Scalar;

/// Accelerations of a mission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace<T> {
    /// Acceleration, m/s^2, positive.
    pub acceleration: T,
    /// Deceleration ahead of slower parts and stops, m/s^2, positive.
    pub deceleration: T,
    /// Largest lateral acceleration, m/s^2, positive.
    pub lateral: T,
    /// Time constant of the drive, s, positive. A deceleration begins so much earlier.
    pub reaction: T,
    /// Speed at which the last centimetres before a stop are driven, m/s, positive.
    pub creep: T,
}

impl<T: Scalar> Pace<T> {
    /// Gentle accelerations for a drive with this lag (s).
    #[must_use]
    pub fn of_drive(lag: T) -> Self {
        Self {
            acceleration: T::lit(0.5),
            deceleration: T::lit(0.5),
            lateral: T::lit(1.5),
            reaction: lag,
            creep: T::lit(0.1),
        }
    }

    /// True if every number is usable.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        let positive = |value: T| value.is_finite() && value > T::zero();
        positive(self.acceleration)
            && positive(self.deceleration)
            && positive(self.lateral)
            && positive(self.creep)
            && positive(self.reaction)
    }

    /// The largest speed (m/s) at which the vehicle, now at `speed`, still slows down to `limit`
    /// within `distance` metres.
    #[must_use]
    pub fn before(&self, limit: T, distance: T, speed: T) -> T {
        let left = distance - speed.abs() * self.reaction;
        if left > T::zero() {
            (limit * limit + T::lit(2.0) * self.deceleration * left).root()
        } else {
            limit
        }
    }
}
