//! The drive motor and the mass of the vehicle.

use super::Parameters;

/// Converts effort to speed: a dead band, then linear, with a first-order lag.
#[derive(Copy, Clone, Debug)]
pub struct Drive {
    /// Effort of the motor driver, -1 to 1.
    pub effort: f64,
    top_speed: f64,
    band: f64,
    lag: f64,
}

impl Drive {
    /// A drive with zero effort.
    #[must_use]
    pub fn new(parameters: &Parameters) -> Self {
        Self {
            effort: 0.0,
            top_speed: parameters.top_speed.get(),
            band: parameters.drive_dead_band.get(),
            lag: parameters.drive_lag.get(),
        }
    }

    /// Steady-state speed for the effort, metres per second.
    #[must_use]
    pub fn target(&self) -> f64 {
        let beyond = ((self.effort.abs() - self.band) / (1.0 - self.band)).max(0.0);
        (self.top_speed * beyond).copysign(self.effort)
    }

    /// The speed `span` seconds after `speed`.
    #[must_use]
    pub fn after(&self, speed: f64, span: f64) -> f64 {
        let target = self.target();
        if self.lag > 0.0 {
            target + (speed - target) * libm::exp(-span / self.lag)
        } else {
            target
        }
    }
}
