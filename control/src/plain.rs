//! The thesis's own steering law (7.3), for comparison: states straight from
//! the sensors, u = -K x, limits. No estimator, no integrator.

use crate::controller::{Outcome, Sample, Settings, SettingsError, Tracking};
use crate::estimator::Update;
use crate::feedback::state_feedback;
use crate::line::Line;
use crate::safety::{Command, SafetyFilter};
use crate::scalar::Scalar;

/// Gains on cross-track error (1/(m s)), heading error (1/s) and steering
/// angle (1/s): the regulator with unit weights for the steering model at
/// 1 m/s and 10 Hz. The thesis says how its gains were made (`dlqr`, 7.3) but
/// not which ones drove.
pub const GAINS: [f64; 3] = [
    0.888_975_001_406_838,
    2.040_969_866_222_82,
    2.198_962_922_897_8,
];

/// Speed below which the velocity shows no heading, m/s.
const HEADING_SPEED: f64 = 0.2;

/// The law with what it must remember between samples.
///
/// It takes the place of [`crate::controller::Controller`] without any other
/// change to the node; of its settings only the limits, the cruise speed and
/// the bounds of the safety filter count.
#[derive(Clone, Copy, Debug)]
pub struct PlainController<T> {
    settings: Settings<T>,
    line: Line<T>,
    safety: SafetyFilter<T>,
    tracking: Tracking<T>,
    position_age: T,
}

impl<T: Scalar> PlainController<T> {
    /// A law that follows `line` and stops at its end.
    ///
    /// # Errors
    /// [`SettingsError`] names the setting that is unusable.
    pub fn new(settings: Settings<T>, line: Line<T>) -> Result<Self, SettingsError> {
        settings.check()?;
        Ok(Self {
            settings,
            line,
            safety: SafetyFilter::new(settings.limits, settings.slew, settings.stale_after),
            tracking: Tracking::default(),
            position_age: settings.stale_after + T::one(),
        })
    }

    /// One control step: like [`crate::controller::Controller::step`].
    pub fn step(&mut self, sample: &Sample<T>) -> Outcome<T> {
        match sample.position {
            Some(position) => {
                let place = self.line.locate(position);
                self.tracking.along = place.along;
                self.tracking.cross_track = place.cross_track;
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
                steering_rate: state_feedback(&GAINS.map(T::lit), &state),
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lqr::dlqr;
    use crate::model::Geometry;
    use crate::position::{Position, Velocity};
    use nalgebra::SMatrix;

    #[test]
    fn gains_are_the_regulator_with_unit_weights() {
        let model = Geometry::<f64>::uagv().steering_model_sampled(1.0, 0.1);
        let one = SMatrix::<f64, 1, 1>::new(1.0);
        let regulator = dlqr(&model, &SMatrix::identity(), &one).unwrap();
        for (designed, known) in regulator.gain.iter().zip(GAINS) {
            assert!((designed - known).abs() < 1e-9, "{designed} {known}");
        }
    }

    /// A vehicle 0.1 m right of a northward line, 0.05 rad to the right of it,
    /// wheels 0.02 rad to the left: u = -(0.1 K1 + 0.05 K2 - 0.02 K3).
    #[test]
    fn the_command_is_the_states_times_the_gains() {
        let line = Line::new(Position::new(0, 0), Position::new(100_000, 0)).unwrap();
        let mut law = PlainController::<f64>::new(Settings::uagv(), line).unwrap();
        let mut sample = Sample {
            position: Some(Position::new(1_000, 100)),
            velocity: Some(Velocity::new(1_000, 50)),
            steering_angle: Some(-0.02),
            applied: Command::still(),
            engaged: false,
            dt: 0.1,
        };
        assert_eq!(law.step(&sample).command, Command::still());
        sample.engaged = true;
        let outcome = law.step(&sample);
        let heading = 0.05_f64.atan2(1.0);
        let rate = -(0.1 * GAINS[0] + heading * GAINS[1] - 0.02 * GAINS[2]);
        assert!((outcome.command.steering_rate - rate).abs() < 1e-12);
        assert!((outcome.command.speed - 1.0).abs() < 1e-12);
        assert!((outcome.tracking.cross_track - 0.1).abs() < 1e-12);

        sample.position = Some(Position::new(100_100, 0));
        let outcome = law.step(&sample);
        assert!(outcome.finished);
        assert!(outcome.command.speed == 0.0);
    }

    /// Without positions the law stands still as soon as the last is stale.
    #[test]
    fn it_does_not_drive_on_an_old_position() {
        let line = Line::new(Position::new(0, 0), Position::new(100_000, 0)).unwrap();
        let mut law = PlainController::<f64>::new(Settings::uagv(), line).unwrap();
        let mut sample = Sample {
            position: Some(Position::new(0, 0)),
            velocity: None,
            steering_angle: Some(0.0),
            applied: Command::still(),
            engaged: true,
            dt: 0.1,
        };
        assert!(law.step(&sample).command.speed > 0.0);
        sample.position = None;
        let moving = (0..10)
            .filter(|_| law.step(&sample).command.speed > 0.0)
            .count();
        assert!((4..=5).contains(&moving), "{moving}");
    }
}
