//! State feedback and the limits of the actuators.

use crate::scalar::{Scalar, clamp_symmetric};

/// Limits of the vehicle's actuators (thesis 5.3). All are positive and apply
/// to both directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits<T> {
    /// Largest steering angle, rad.
    pub steering_angle: T,
    /// Largest steering rate, rad/s.
    pub steering_rate: T,
    /// Largest speed, m/s.
    pub speed: T,
}

/// The limit that is not a positive number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum LimitError {
    /// The steering angle limit.
    SteeringAngle,
    /// The steering rate limit.
    SteeringRate,
    /// The speed limit.
    Speed,
}

impl core::fmt::Display for LimitError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let name = match self {
            Self::SteeringAngle => "steering angle",
            Self::SteeringRate => "steering rate",
            Self::Speed => "speed",
        };
        write!(f, "the {name} limit is not a positive number")
    }
}

impl core::error::Error for LimitError {}

impl<T: Scalar> Limits<T> {
    /// Checks that every limit is a positive number.
    ///
    /// # Errors
    /// [`LimitError`] names the limit that is not.
    pub fn check(&self) -> Result<(), LimitError> {
        let positive = |value: T| value.is_finite() && value > T::zero();
        if !positive(self.steering_angle) {
            Err(LimitError::SteeringAngle)
        } else if !positive(self.steering_rate) {
            Err(LimitError::SteeringRate)
        } else if !positive(self.speed) {
            Err(LimitError::Speed)
        } else {
            Ok(())
        }
    }

    /// The steering rate nearest to `rate` (rad/s) that respects the rate limit
    /// and keeps the steering angle within its limit over the next `period` (s,
    /// positive). `angle` is the current angle (rad).
    ///
    /// If the angle is beyond its limit, only rates towards the centre are
    /// allowed.
    #[must_use]
    pub fn steering_rate(&self, rate: T, angle: T, period: T) -> T {
        let rate = clamp_symmetric(rate, self.steering_rate);
        // Only the limit that the steering turns towards can act.
        let right = rate > T::zero();
        let outward = if right { angle } else { -angle };
        let room = (self.steering_angle - outward) / period;
        let largest = if room > T::zero() { room } else { T::zero() };
        if right && rate > largest {
            largest
        } else if rate < -largest {
            -largest
        } else {
            rate
        }
    }
}

/// State feedback u = -K x for one input and N states, without limits.
#[must_use]
pub fn state_feedback<T: Scalar, const N: usize>(gain: &[T; N], state: &[T; N]) -> T {
    gain.iter()
        .zip(state)
        .fold(T::zero(), |sum, (&k, &x)| sum - k * x)
}
