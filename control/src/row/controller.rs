//! The whole control step between two rows: estimator, law, the row's end, and
//! the efforts of the motors.

use super::beams::MountingError;
use super::estimator::{RowDistances, RowEstimate, RowEstimator, WheelSpeeds};
use super::health::SideHealth;
use super::law::{RowLawError, RowLawSettings};
use super::settings::{RowEstimatorError, RowEstimatorSettings};
use super::thesis::Sides;
use crate::calibration::{Actuator, Direction};
use crate::scalar::Scalar;

/// Settings of the whole control step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowSettings<T> {
    /// The estimator.
    pub estimator: RowEstimatorSettings<T>,
    /// The law.
    pub law: RowLawSettings<T>,
    /// Way without any plant at both sides after which the row has ended, m:
    /// more than the longest gap.
    pub end_way: T,
    /// Way without a stalk at both sides, be it for leaves, after which the
    /// robot is lost, m: at least `end_way`.
    pub lost_way: T,
    /// Motors of both sides: speed of the wheels over ground (m/s) by effort.
    pub motors: Sides<Actuator<T>>,
}

/// `settings` as a Rust block expression, for the output of a build script. The block imports the types
/// that it names, and restores each number exactly.
#[must_use]
pub fn source(settings: &RowSettings<f32>) -> impl core::fmt::Display + '_ {
    Source(settings)
}

/// Displays settings by their derived `Debug`, which is a valid Rust expression.
struct Source<'a>(&'a RowSettings<f32>);

impl core::fmt::Display for Source<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(
            "{\n\
             use ::control::calibration::{Actuator, Direction};\n\
             use ::control::row::{\n\
             Beams, Motion, Mounting, Odds, Readings, RowEstimatorSettings, RowLawSettings, RowSettings,\n\
             Rows, Sides,\n\
             };\n",
        )?;
        write!(f, "{:#?}\n}}", self.0)
    }
}

/// The setting of the control step that is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowSettingsError {
    /// Where the sensors are mounted.
    Mounting(MountingError),
    /// A setting of the estimator.
    Estimator(RowEstimatorError),
    /// A setting of the law.
    Law(RowLawError),
    /// The way after which the row has ended is not positive.
    EndWay,
    /// The way after which the robot is lost is below that of the row's end.
    LostWay,
    /// A motor's dead band is outside [0, 1), or its full speed is not positive.
    Motor,
}

impl core::fmt::Display for RowSettingsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Mounting(error) => error.fmt(f),
            Self::Estimator(error) => error.fmt(f),
            Self::Law(error) => error.fmt(f),
            Self::EndWay => {
                f.write_str("the way after which the row has ended is not a positive number")
            }
            Self::LostWay => f.write_str(
                "the way after which the robot is lost is below that after which the row has ended",
            ),
            Self::Motor => f.write_str(
                "a motor's dead band is not in [0, 1) or its full speed is not positive",
            ),
        }
    }
}

impl core::error::Error for RowSettingsError {}

impl<T: Scalar> RowSettings<T> {
    /// Checks the settings.
    ///
    /// # Errors
    /// [`RowSettingsError`] names the setting that is unusable.
    pub fn check(&self) -> Result<(), RowSettingsError> {
        self.estimator
            .check()
            .map_err(RowSettingsError::Estimator)?;
        self.law.check().map_err(RowSettingsError::Law)?;
        if !(self.end_way.is_finite() && self.end_way > T::zero()) {
            return Err(RowSettingsError::EndWay);
        }
        if !(self.lost_way.is_finite() && self.lost_way >= self.end_way) {
            return Err(RowSettingsError::LostWay);
        }
        let sound = |direction: &Direction<T>| {
            direction.dead_band >= T::zero()
                && direction.dead_band < T::one()
                && direction.full_rate.is_finite()
                && direction.full_rate > T::zero()
        };
        let motors = [&self.motors.left, &self.motors.right];
        if !motors
            .into_iter()
            .all(|motor| sound(&motor.positive) && sound(&motor.negative))
        {
            return Err(RowSettingsError::Motor);
        }
        Ok(())
    }
}

/// What the robot does between its rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RowState {
    /// Stands because it is not engaged.
    Idle,
    /// Follows the rows.
    Following,
    /// Stands at the row's end, until it is engaged anew.
    End,
    /// Stands because it has seen no stalk for too long, or because both sensors
    /// are faulty, until it is engaged anew.
    Lost,
}

/// Result of a control step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RowOutcome<T> {
    /// Efforts of the motors, each in [-1, 1].
    pub efforts: Sides<T>,
    /// The same as wheel speeds, m/s.
    pub wheels: WheelSpeeds<T>,
    /// What the robot does.
    pub state: RowState,
    /// The estimate.
    pub estimate: RowEstimate<T>,
}

/// The controller.
#[derive(Clone, Copy, Debug)]
pub struct RowController<T> {
    settings: RowSettings<T>,
    estimator: RowEstimator<T>,
    wheels: WheelSpeeds<T>,
    state: RowState,
}

impl<T: Scalar> RowController<T> {
    /// A controller that stands until it is engaged.
    ///
    /// # Errors
    /// [`RowSettingsError`] names the setting that is unusable.
    pub fn new(settings: RowSettings<T>) -> Result<Self, RowSettingsError> {
        settings.check()?;
        Ok(Self::of(settings))
    }

    /// The same, with settings that were checked before: a program that has them as a constant
    /// ([`source`]) need not carry the check.
    #[must_use]
    pub fn of(settings: RowSettings<T>) -> Self {
        Self {
            settings,
            estimator: RowEstimator::of(settings.estimator),
            wheels: still(),
            state: RowState::Idle,
        }
    }

    /// One step, `dt` seconds after the last one, with the distances measured
    /// now: [`RowController::command`], and then [`RowController::correct`].
    pub fn step(&mut self, distances: &RowDistances<T>, engaged: bool, dt: T) -> RowOutcome<T> {
        let outcome = self.command(distances, engaged, dt);
        self.correct();
        outcome
    }

    /// The larger part of a step, which no command waits for: corrects the estimate
    /// by what [`RowController::command`] has seen. It is due before the next
    /// command.
    pub fn correct(&mut self) {
        self.estimator.correct();
    }

    /// The part of a step that the motors wait for, `dt` seconds after the last one,
    /// with the distances measured now. The robot drives while it is `engaged`. It
    /// starts with an empty estimate whenever that becomes true, and from the row's
    /// end only so.
    pub fn command(&mut self, distances: &RowDistances<T>, engaged: bool, dt: T) -> RowOutcome<T> {
        if !engaged {
            self.state = RowState::Idle;
        } else if self.state == RowState::Idle {
            self.state = RowState::Following;
            self.estimator.restart();
            self.wheels = still();
        }
        let estimate = self.estimator.observe(distances, &self.wheels, dt);
        if self.state == RowState::Following {
            self.state = self.judge(&estimate);
        }
        self.wheels = if self.state == RowState::Following {
            self.settings.law.wheels(&estimate)
        } else {
            still()
        };
        let motors = &self.settings.motors;
        RowOutcome {
            efforts: Sides {
                left: motors.left.effort(self.wheels.left),
                right: motors.right.effort(self.wheels.right),
            },
            wheels: self.wheels,
            state: self.state,
            estimate,
        }
    }

    fn judge(&self, estimate: &RowEstimate<T>) -> RowState {
        let faulty =
            |side: SideHealth| matches!(side, SideHealth::Frozen | SideHealth::Implausible);
        if faulty(estimate.left) && faulty(estimate.right) {
            RowState::Lost
        } else if estimate.open_way >= self.settings.end_way {
            RowState::End
        } else if estimate.blind_way >= self.settings.lost_way {
            RowState::Lost
        } else {
            RowState::Following
        }
    }
}

fn still<T: Scalar>() -> WheelSpeeds<T> {
    WheelSpeeds {
        left: T::zero(),
        right: T::zero(),
    }
}
