//! The steering law between two rows: from the estimate to wheel speeds.

use super::estimator::{RowEstimate, WheelSpeeds};
use crate::scalar::{Scalar, clamp_symmetric};

/// Settings of the law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowLawSettings<T> {
    /// Speed with a good estimate, m/s, positive.
    pub cruise: T,
    /// Share of the cruise speed with a poor estimate, in (0, 1].
    pub slow: T,
    /// Deviation of the estimate up to which it is good, m.
    pub good: T,
    /// Deviation from which on it is poor, m, above `good`. Corrections are then
    /// half as strong.
    pub poor: T,
    /// Way in which an offset decays to about a third, m.
    pub settling: T,
    /// Damping ratio with which it decays, in [0.5, 2].
    pub damping: T,
    /// How far ahead in time the heading is taken that the turn rate leads to, s, at least
    /// 0: about half the lag of the wheels.
    pub lead: T,
    /// Largest heading towards the middle, rad, in (0, 0.6].
    pub approach: T,
    /// Largest turn rate, rad/s, positive.
    pub turn_rate: T,
    /// Largest speed of a wheel, m/s, at least the cruise speed.
    pub wheel_speed: T,
    /// Distance between the wheels that makes the turn rate of the difference of
    /// their speeds, m.
    pub track: T,
}

/// The setting of the law that is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowLawError {
    /// The cruise speed is not positive.
    Cruise,
    /// The slow speed is not a share of the cruise speed.
    Slow,
    /// The deviations of a good and a poor estimate are not positive and in this
    /// order.
    Deviations,
    /// The settling way is not positive.
    Settling,
    /// The damping ratio is outside [0.5, 2].
    Damping,
    /// The largest heading is outside (0, 0.6].
    Approach,
    /// The largest turn rate is not positive.
    TurnRate,
    /// The wheels' speed is below the cruise speed.
    WheelSpeed,
    /// The track is not positive.
    Track,
    /// The lead is not a number of at least 0.
    Lead,
}

impl core::fmt::Display for RowLawError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Cruise => "the cruise speed between rows is not a positive number",
            Self::Slow => "the slow speed between rows is not a share of the cruise speed",
            Self::Deviations => {
                "the deviations of a good and a poor estimate are not positive and in this order"
            }
            Self::Settling => "the settling way between rows is not a positive number",
            Self::Damping => "the damping ratio is not between 0.5 and 2",
            Self::Approach => "the largest heading towards the middle is not between 0 and 0.6 rad",
            Self::TurnRate => "the largest turn rate is not a positive number",
            Self::WheelSpeed => "the largest wheel speed is below the cruise speed",
            Self::Track => "the track between the wheels is not a positive number",
            Self::Lead => "the lead of the heading is not a number of at least 0",
        })
    }
}

impl core::error::Error for RowLawError {}

impl<T: Scalar> RowLawSettings<T> {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`RowLawError`] names the setting that is unusable.
    pub fn check(&self) -> Result<(), RowLawError> {
        let positive = |value: T| value.is_finite() && value > T::zero();
        if !positive(self.cruise) {
            return Err(RowLawError::Cruise);
        }
        if !(positive(self.slow) && self.slow <= T::one()) {
            return Err(RowLawError::Slow);
        }
        if !(positive(self.good) && self.poor.is_finite() && self.good < self.poor) {
            return Err(RowLawError::Deviations);
        }
        if !positive(self.settling) {
            return Err(RowLawError::Settling);
        }
        if !(self.damping >= T::lit(0.5) && self.damping <= T::lit(2.0)) {
            return Err(RowLawError::Damping);
        }
        if !(positive(self.approach) && self.approach <= T::lit(0.6)) {
            return Err(RowLawError::Approach);
        }
        if !positive(self.turn_rate) {
            return Err(RowLawError::TurnRate);
        }
        if !(self.wheel_speed.is_finite() && self.wheel_speed >= self.cruise) {
            return Err(RowLawError::WheelSpeed);
        }
        if !positive(self.track) {
            return Err(RowLawError::Track);
        }
        if !(self.lead.is_finite() && self.lead >= T::zero()) {
            return Err(RowLawError::Lead);
        }
        Ok(())
    }

    /// Wheel speeds for an estimate.
    ///
    /// The heading error and the offset decay over the way driven as a
    /// second-order system with the length `settling` and the ratio `damping`,
    /// at any speed. The estimated curvature is fed forward, so that unequal
    /// motors and bent rows leave no offset. If the turn would ask too much of a
    /// wheel, the robot drives slower and keeps the turn.
    #[must_use]
    pub fn wheels(&self, estimate: &RowEstimate<T>) -> WheelSpeeds<T> {
        let two = T::lit(2.0);
        let pose = &estimate.pose;
        let poor = (estimate.deviation - self.good) / (self.poor - self.good);
        let poor = if poor < T::zero() {
            T::zero()
        } else if poor < T::one() {
            poor
        } else {
            T::one()
        };
        let speed = self.cruise * (T::one() - (T::one() - self.slow) * poor);
        let wanted = clamp_symmetric(
            -pose.offset / (two * self.damping * self.settling),
            self.approach,
        );
        let heading = pose.heading + estimate.turn * self.lead;
        let bend = (wanted - heading) * two * self.damping / self.settling;
        // A correction by a doubtful estimate would more often harm than help.
        let unsure = estimate.deviation / self.poor;
        let bend = bend / (T::one() + unsure * unsure);
        let turn = clamp_symmetric(speed * (bend - estimate.curvature), self.turn_rate);
        let half = clamp_symmetric(turn * self.track / two, self.wheel_speed);
        let room = self.wheel_speed - half.abs();
        let speed = if speed < room { speed } else { room };
        if !(speed.is_finite() && half.is_finite()) {
            return WheelSpeeds {
                left: T::zero(),
                right: T::zero(),
            };
        }
        WheelSpeeds {
            left: speed + half,
            right: speed - half,
        }
    }
}
