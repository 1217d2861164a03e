//! One control step of the vehicle: what the buses and sensors say in, what
//! the actuators are told out.

use crate::feedback::{LimitError, Limits, state_feedback};
use crate::line::Line;
use crate::model::{Geometry, GeometryError};
use crate::position::{Position, Velocity};
use crate::safety::{Command, SafetyFilter, Slew, Verdict};
use crate::scalar::{Scalar, wrap_angle};
use crate::schedule::GainSchedule;

/// Gains on the integral of the cross-track error (1/(m s^2)), the cross-track
/// error (1/(m s)), the heading error (1/s) and the steering angle (1/s), at
/// nine speeds.
pub type SteeringGains<T> = GainSchedule<T, 4, 9>;

/// Everything about a vehicle that the controller needs to know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings<T> {
    /// Axles and antenna.
    pub geometry: Geometry<T>,
    /// Actuator limits.
    pub limits: Limits<T>,
    /// How fast commands may change.
    pub slew: Slew<T>,
    /// Steering gains over speed.
    pub gains: SteeringGains<T>,
    /// Speed of an autonomous run, m/s.
    pub cruise: T,
    /// Age at which a position is no longer used to drive, s.
    pub stale_after: T,
}

/// Which setting is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingsError {
    /// The geometry.
    Geometry(GeometryError),
    /// A limit.
    Limit(LimitError),
    /// A gain, the schedule's spacing, a slew, the cruise speed or the age is
    /// not a usable number.
    Number,
}

impl core::fmt::Display for SettingsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Geometry(error) => error.fmt(f),
            Self::Limit(error) => error.fmt(f),
            Self::Number => f.write_str("a gain, slew, speed or age is not a usable number"),
        }
    }
}

impl core::error::Error for SettingsError {}

impl<T: Scalar> Settings<T> {
    /// The UAGV with a regulator for Q = I, R = 1 at 10 Hz.
    #[must_use]
    pub fn uagv() -> Self {
        let row = [
            T::zero(),
            T::lit(0.888_975_001_406_838),
            T::lit(2.040_969_866_222_82),
            T::lit(2.198_962_922_897_80),
        ];
        Self {
            geometry: Geometry::uagv(),
            limits: Limits::uagv(),
            slew: Slew {
                steering: T::lit(25.0),
                speed: T::lit(2.0),
            },
            gains: GainSchedule {
                spacing: T::lit(0.25),
                gains: [row; 9],
            },
            cruise: T::one(),
            stale_after: T::lit(0.25),
        }
    }
}

/// What is known at the beginning of a control step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<T> {
    /// The antenna's position, when one arrived in this cycle with an
    /// RTK-fixed solution.
    pub position: Option<Position>,
    /// The antenna's velocity, when one arrived in this cycle.
    pub velocity: Option<Velocity>,
    /// The steering angle from the potentiometer, rad, when a plausible
    /// reading arrived in this cycle.
    pub steering_angle: Option<T>,
    /// What the actuators have been told since the last step, by the law or
    /// by the joystick.
    pub applied: Command<T>,
    /// Whether the law commands the actuators (autonomous run).
    pub engaged: bool,
    /// Time since the last step, s.
    pub dt: T,
}

/// Where the vehicle stands relative to its line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tracking<T> {
    /// Distance along the line, m.
    pub along: T,
    /// Cross-track error of the antenna, m, positive right of the line.
    pub cross_track: T,
    /// Heading, rad clockwise from north, in (-pi, pi].
    pub heading: T,
    /// Heading relative to the line, rad, in (-pi, pi].
    pub heading_error: T,
    /// Steering angle, rad, positive to the right.
    pub steering_angle: T,
    /// Speed over ground, m/s.
    pub speed: T,
}

/// The outcome of a control step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome<T> {
    /// For the actuators, when the law commands them; still otherwise.
    pub command: Command<T>,
    /// Where the vehicle is, for displays and logs; the last known when
    /// nothing new arrived.
    pub tracking: Tracking<T>,
    /// What the safety filter did.
    pub verdict: Verdict,
}

/// The control law of a vehicle with its memory.
#[derive(Clone, Copy, Debug)]
pub struct Controller<T> {
    settings: Settings<T>,
    line: Line<T>,
    safety: SafetyFilter<T>,
    tracking: Tracking<T>,
    position_age: T,
}

impl<T: Scalar> Controller<T> {
    /// A controller that follows `line`.
    ///
    /// # Errors
    /// [`SettingsError`] names the setting that is unusable.
    pub fn new(settings: Settings<T>, line: Line<T>) -> Result<Self, SettingsError> {
        settings.geometry.check().map_err(SettingsError::Geometry)?;
        settings.limits.check().map_err(SettingsError::Limit)?;
        let positive = |value: T| value.is_finite() && value > T::zero();
        let usable = positive(settings.gains.spacing)
            && positive(settings.slew.speed)
            && positive(settings.slew.steering)
            && positive(settings.stale_after)
            && settings.cruise.is_finite()
            && settings
                .gains
                .gains
                .iter()
                .flatten()
                .all(|gain| gain.is_finite());
        if !usable {
            return Err(SettingsError::Number);
        }
        Ok(Self {
            settings,
            line,
            safety: SafetyFilter::new(settings.limits, settings.slew, settings.stale_after),
            tracking: Tracking {
                along: T::zero(),
                cross_track: T::zero(),
                heading: line.bearing(),
                heading_error: T::zero(),
                steering_angle: T::zero(),
                speed: T::zero(),
            },
            position_age: settings.stale_after + T::one(),
        })
    }

    /// The line being followed.
    #[must_use]
    pub fn line(&self) -> &Line<T> {
        &self.line
    }

    /// One control step; call it once in each basic cycle.
    pub fn step(&mut self, sample: &Sample<T>) -> Outcome<T> {
        self.observe(sample);
        let proposed = sample.engaged.then(|| self.law());
        let (command, verdict) = self.safety.step(
            proposed,
            self.position_age,
            sample.steering_angle,
            sample.dt,
        );
        Outcome {
            command,
            tracking: self.tracking,
            verdict,
        }
    }

    fn observe(&mut self, sample: &Sample<T>) {
        let tracking = &mut self.tracking;
        if let Some(angle) = sample.steering_angle {
            tracking.steering_angle = angle;
        }
        if let Some(velocity) = sample.velocity {
            let (north, east) = velocity.metres_per_second::<T>();
            let speed = (north * north + east * east).root();
            tracking.speed = speed;
            if speed > T::lit(0.2) {
                // The antenna is ahead of the rear axle, so in a turn its
                // course leads the heading.
                let lead = (self.settings.geometry.l1 * tracking.steering_angle.tangent())
                    .angle_of(self.settings.geometry.wheelbase());
                tracking.heading = wrap_angle(east.angle_of(north) - lead);
                tracking.heading_error = self.line.heading_error(tracking.heading);
            }
        }
        match sample.position {
            Some(position) => {
                let place = self.line.locate(position);
                tracking.along = place.along;
                tracking.cross_track = place.cross_track;
                self.position_age = T::zero();
            }
            None => self.position_age += sample.dt,
        }
    }

    fn law(&self) -> Command<T> {
        let [_, gains @ ..] = self.settings.gains.at(self.tracking.speed);
        let state = [
            self.tracking.cross_track,
            self.tracking.heading_error,
            self.tracking.steering_angle,
        ];
        Command {
            steering_rate: state_feedback(&gains, &state),
            speed: self.settings.cruise,
        }
    }
}
