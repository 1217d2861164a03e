//! The linear actuator that steers the front wheels.

use super::Parameters;

/// Converts effort to steering rate: a dead band for each sign, then linear (thesis 5.2.6, Figure
/// 5.20), limited by two mechanical end stops.
#[derive(Copy, Clone, Debug)]
pub struct SteeringActuator {
    /// Effort of the motor driver, -1 to 1.
    pub effort: f64,
    limit: f64,
    right_rate: f64,
    left_rate: f64,
    right_band: f64,
    left_band: f64,
}

impl SteeringActuator {
    /// An actuator with zero effort.
    #[must_use]
    pub fn new(parameters: &Parameters) -> Self {
        Self {
            effort: 0.0,
            limit: parameters.steering_limit.get(),
            right_rate: parameters.rate_right.get() * parameters.actuator_gain.get(),
            left_rate: parameters.rate_left.get() * parameters.actuator_gain.get(),
            right_band: parameters.dead_band_right.get(),
            left_band: parameters.dead_band_left.get(),
        }
    }

    /// Rate without the end stops, radians per second.
    #[must_use]
    pub fn rate(&self) -> f64 {
        let beyond = |effort: f64, band: f64| ((effort - band) / (1.0 - band)).max(0.0);
        if self.effort >= 0.0 {
            self.right_rate * beyond(self.effort, self.right_band)
        } else {
            -self.left_rate * beyond(-self.effort, self.left_band)
        }
    }

    /// The angle `span` seconds after `angle`.
    #[must_use]
    pub fn after(&self, angle: f64, span: f64) -> f64 {
        (angle + self.rate() * span).clamp(-self.limit, self.limit)
    }
}
