//! The steering law of the thesis (7.3), for comparison: u = -K x with states
//! taken directly from the sensors, and limits. It has no estimator and no
//! integrator.

use crate::controller::{Outcome, Sample, Settings, SettingsError, Tracking};
use crate::estimator::Update;
use crate::feedback::state_feedback;
use crate::line::Line;
use crate::safety::{Command, SafetyFilter};
use crate::scalar::Scalar;

/// Gains on cross-track error (1/(m s)), heading error (1/s) and steering
/// angle (1/s): the linear quadratic regulator with unit weights for the
/// thesis's vehicle at 1 m/s and 10 Hz. The thesis says that `dlqr` computed its
/// gains (7.3), but not which gains drove.
pub const GAINS: [f64; 3] = [
    0.888_975_001_406_838,
    2.040_969_866_222_82,
    2.198_962_922_897_8,
];

/// Speed up to which the velocity vector is too noisy to give a heading, m/s.
const HEADING_SPEED: f64 = 0.2;

/// Oldest position by which the law drives, s. It has no dead reckoning, so it cannot go on without positions for as long as
/// the settings let an estimator.
const OLDEST: f64 = 0.5;

/// The law and its state.
///
/// It can replace [`crate::controller::Controller`] in a node. Of the settings it
/// uses only the antenna's offset, the limits, the cruise speed and those of the
/// safety filter.
#[derive(Clone, Copy, Debug)]
pub struct PlainController<T> {
    gains: [T; 3],
    settings: Settings<T>,
    line: Line<T>,
    safety: SafetyFilter<T>,
    tracking: Tracking<T>,
    position_age: T,
}

impl<T: Scalar> PlainController<T> {
    /// A law with these gains that follows `line` and stops the vehicle at its end. The units of the
    /// gains, and those of the thesis's vehicle: [`GAINS`].
    ///
    /// # Errors
    /// [`SettingsError`] names the setting that is unusable.
    pub fn new(gains: [T; 3], settings: Settings<T>, line: Line<T>) -> Result<Self, SettingsError> {
        settings.check()?;
        let oldest = settings.stale_after.min(T::lit(OLDEST));
        Ok(Self {
            gains,
            settings,
            line,
            safety: SafetyFilter::new(settings.limits, settings.slew, oldest),
            tracking: Tracking::default(),
            position_age: oldest + T::one(),
        })
    }

    /// Slews commands from `last` on, which something else has sent to the actuators.
    pub fn resume(&mut self, last: Command<T>) {
        self.safety.resume(last);
    }

    /// One control step, like [`crate::controller::Controller::step`].
    pub fn step(&mut self, sample: &Sample<T>) -> Outcome<T> {
        match sample.position {
            Some(position) => {
                let place = self.line.locate(position);
                self.tracking.along = place.along;
                // While the vehicle points along the line, the antenna is this
                // far to the right of the centre line.
                let right = self.settings.estimator.antenna.right;
                self.tracking.cross_track = place.cross_track - right;
                self.position_age = T::zero();
            }
            None => self.position_age += sample.dt,
        }
        if let Some(velocity) = sample.velocity {
            let (north, east) = velocity.metres_per_second::<T>();
            self.tracking.speed = (north * north + east * east).root();
            if self.tracking.speed > T::lit(HEADING_SPEED) {
                self.tracking.heading = east.angle_of(north);
                self.tracking.heading_error = self.line.heading_error(self.tracking.heading);
            }
        }
        if let Some(angle) = sample.steering_angle {
            self.tracking.steering_angle = angle;
        }
        let tracking = self.tracking;
        let finished = tracking.along > self.line.length();
        let proposed = sample.engaged.then(|| {
            if finished {
                return Command::still();
            }
            let state = [
                tracking.cross_track,
                tracking.heading_error,
                tracking.steering_angle,
            ];
            Command {
                steering_rate: state_feedback(&self.gains, &state),
                speed: self.settings.cruise,
            }
        });
        let (command, verdict) = self.safety.step(
            proposed,
            self.position_age,
            sample.steering_angle,
            sample.dt,
        );
        Outcome {
            proposed,
            command,
            tracking,
            finished,
            update: if sample.position.is_some() {
                Update::Corrected
            } else {
                Update::DeadReckoned
            },
            verdict,
        }
    }
}
