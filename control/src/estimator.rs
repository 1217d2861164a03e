//! The estimator: an extended Kalman filter for position, heading, steering
//! angle and the biases of both angle measurements.
//!
//! The states are those of thesis Figure 7.11, with the cross-track distance
//! replaced by north and east. So the filter also works far off the line,
//! facing away from it, and in headland turns. Linearised about a line, it is
//! the filter of Figure 7.11.
//!
//! * The heading is observed through the velocity vector and the movement of
//!   the position. The receiver's baseline heading is not used: it points from
//!   the base station to the rover.
//! * "Heading" means the direction of travel of the rear axle. On a side slope
//!   the body points uphill of it by the crab angle. A single antenna cannot
//!   observe that angle, and holding a line does not require it.
//! * GPS data have a known age. Their measurement equations are written for the
//!   pose at the time of measurement.
//! * The antenna may be ahead of the rear axle, behind it or beside the centre
//!   line. Position and velocity are corrected for this lever arm, the velocity
//!   with the yaw rate.
//! * On a slope a high antenna is beside that place. Whoever measures roll and
//!   pitch says where it is ([`Estimator::set_lever`], [`crate::tilt`]).
//! * At standstill the biases are not observable (thesis 7.2.5 with V = 0).
//!   They are frozen: value and variance stay.
//! * What the description has wrong is found while the vehicle turns: the wheelbase
//!   that acts, and the age of GPS data ([`Expected`]).
//! * Without GPS data the filter continues by dead reckoning from steering
//!   angle and speed, and its variance grows with slip and steering noise.

use crate::angle::{Direction, Wheels, is_near};
use crate::covariance::{
    Beginning, Covariance, EAST, HEADING, HEADING_BIAS, NORTH, STATES, STEERING, STEERING_BIAS,
    Transition,
};
use crate::habits::{Course, Expected, Habits, Shown};
use crate::model::{Antenna, Geometry, GeometryError};
use crate::position::{Position, Velocity};
use crate::safety::Command;
use crate::scalar::{Scalar, clamp_symmetric, wrap_angle};
use nalgebra::SMatrix;

/// Noise of the sensors and of the model. All values are standard deviations
/// and positive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise<T> {
    /// GPS position, per axis, m.
    pub position: T,
    /// GPS velocity, per axis, m/s.
    pub velocity: T,
    /// Potentiometer, rad.
    pub steering: T,
    /// Drift of the position by wheel slip, m per square root of a second.
    pub slip: T,
    /// Drift of the heading that the steering does not explain, rad per square
    /// root of a second.
    pub heading: T,
    /// Drift of the steering angle that the command does not explain, rad per
    /// square root of a second.
    pub actuator: T,
    /// Error of the actuator's rate as a share of the commanded rate.
    pub actuator_share: T,
    /// Drift of the heading bias, rad per square root of a second.
    pub heading_bias: T,
    /// Drift of the steering bias, rad per square root of a second.
    pub steering_bias: T,
    /// Expected size of the heading bias at the start, rad.
    pub first_heading_bias: T,
    /// Expected size of the steering bias at the start, rad.
    pub first_steering_bias: T,
}

/// All settings of the estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EstimatorSettings<T> {
    /// Axles and the antenna's place along the vehicle.
    pub geometry: Geometry<T>,
    /// The antenna's place beside the centre line.
    pub antenna: Antenna<T>,
    /// Noise of sensors and model.
    pub noise: Noise<T>,
    /// Age of GPS data at the step that uses them, s, not negative.
    pub gps_delay: T,
    /// Time constant from commanded to real speed, s, positive.
    pub drive_lag: T,
    /// Slip angle of the rear tyres per lateral acceleration, rad per m/s^2, not
    /// negative (linear tyre: J. Y. Wong, Theory of Ground Vehicles, 1.4). In a
    /// turn the rear axle's direction of travel points towards the outside by
    /// this angle; it returns when the wheels straighten.
    pub rear_slip: T,
    /// Speed up to which the vehicle counts as standing, m/s, positive. There
    /// the velocity vector is too noisy to give a heading.
    pub standstill: T,
    /// How far the wheelbase and the age of GPS data may be from the values above.
    pub expected: Expected<T>,
}

/// The setting of the estimator that is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EstimatorError {
    /// The geometry or the antenna's place.
    Geometry(GeometryError),
    /// A noise level is not a positive number.
    Noise,
    /// The GPS delay is negative or not a number.
    Delay,
    /// The drive's time constant or the standstill speed is not a positive
    /// number.
    Drive,
    /// The tyres' slip is negative or not a number.
    Slip,
    /// The expected deviation of wheelbase or age is negative or not a number.
    Expected,
}

impl core::fmt::Display for EstimatorError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Geometry(error) => error.fmt(f),
            Self::Noise => f.write_str("a noise level of the estimator is not a positive number"),
            Self::Delay => f.write_str("the GPS delay is negative or not a number"),
            Self::Drive => {
                f.write_str("the drive's lag or the standstill speed is not a positive number")
            }
            Self::Slip => f.write_str("the tyres' slip is negative or not a number"),
            Self::Expected => f.write_str(
                "the expected deviation of wheelbase or age is negative or not a number",
            ),
        }
    }
}

impl core::error::Error for EstimatorError {}

impl<T: Scalar> EstimatorSettings<T> {
    /// Checks that every setting is usable.
    ///
    /// # Errors
    /// [`EstimatorError`] names the group at fault.
    pub fn check(&self) -> Result<(), EstimatorError> {
        self.geometry.check().map_err(EstimatorError::Geometry)?;
        if !(self.antenna.right.is_finite() && self.antenna.height.is_finite()) {
            return Err(EstimatorError::Geometry(GeometryError::NotFinite));
        }
        let positive = |value: T| value.is_finite() && value > T::zero();
        let noise = &self.noise;
        let levels = [
            noise.position,
            noise.velocity,
            noise.steering,
            noise.slip,
            noise.heading,
            noise.actuator,
            noise.actuator_share,
            noise.heading_bias,
            noise.steering_bias,
            noise.first_heading_bias,
            noise.first_steering_bias,
        ];
        if !levels.into_iter().all(positive) {
            return Err(EstimatorError::Noise);
        }
        if !is_age(self.gps_delay) {
            return Err(EstimatorError::Delay);
        }
        if !(positive(self.drive_lag) && positive(self.standstill)) {
            return Err(EstimatorError::Drive);
        }
        let not_negative = |value: T| value.is_finite() && value >= T::zero();
        if !not_negative(self.rear_slip) {
            return Err(EstimatorError::Slip);
        }
        if not_negative(self.expected.curvature) && not_negative(self.expected.age) {
            Ok(())
        } else {
            Err(EstimatorError::Expected)
        }
    }
}

/// The estimated state of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate<T> {
    /// Rear axle, m north of the frame's origin.
    pub north: T,
    /// Rear axle, m east of the frame's origin.
    pub east: T,
    /// Direction of travel of the rear axle, rad clockwise from north, in
    /// (-pi, pi].
    pub heading: T,
    /// Steering angle without its bias, rad, positive to the right.
    pub steering_angle: T,
    /// Error of the measured course, rad, positive if it reads too far clockwise.
    pub heading_bias: T,
    /// Error of the measured steering angle, rad, positive if it reads too far to
    /// the right.
    pub steering_bias: T,
    /// Speed of the rear axle, m/s, negative in reverse.
    pub speed: T,
}

/// Inputs of an estimator step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation<T> {
    /// The antenna's position, `gps_delay` old, if one arrived.
    pub position: Option<Position>,
    /// The antenna's velocity, `gps_delay` old, if one arrived.
    pub velocity: Option<Velocity>,
    /// The measured steering angle, rad, if one arrived.
    pub steering_angle: Option<T>,
    /// The steering rate commanded since the last step, rad/s.
    pub steering_rate: T,
    /// The speed commanded since the last step, m/s.
    pub speed: T,
    /// Time since the last step, s, positive.
    pub dt: T,
}

impl<T: Scalar> Observation<T> {
    fn is_usable(&self) -> bool {
        is_period(self.dt)
            && is_sane(self.steering_rate)
            && is_sane(self.speed)
            && self.steering_angle.is_none_or(is_sane)
    }
}

/// Whether a command or reading is a number, and none whose square or product is beyond the type's range.
fn is_sane<T: Scalar>(value: T) -> bool {
    value.abs() <= T::lit(HUGE)
}

/// Whether GPS data can have this age, s: up to a second. (The motion of a quarter of it is kept.)
fn is_age<T: Scalar>(age: T) -> bool {
    age >= T::zero() && age <= T::one()
}

fn is_period<T: Scalar>(dt: T) -> bool {
    dt > T::zero() && dt <= T::lit(HUGE)
}

/// How an estimator step used its inputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Update {
    /// The heading is not known yet: the vehicle has not moved with GPS data.
    NoHeading,
    /// GPS data corrected the estimate.
    Corrected,
    /// There were no GPS data, or they were rejected as outliers. The estimate
    /// was advanced by dead reckoning.
    DeadReckoned,
    /// The GPS data contradicted the estimate for several steps. It was started
    /// again from them.
    Restarted,
    /// An input was not finite or the period not positive, or an update had no prediction. Nothing
    /// was changed.
    BadInput,
}

/// A GPS position is an outlier if its squared innovation exceeds this many
/// variances (5 standard deviations).
const GATE: f64 = 25.0;
/// After this many outliers in a row the estimate, not the data, is taken to be
/// wrong.
const PATIENCE: u8 = 5;
/// Largest estimate of a bias, rad (20 degrees).
const LARGEST_BIAS: f64 = 0.35;
/// Steps of which the motion is kept: as many as the largest age of the data, 250 ms, is long with the shortest
/// period, 50 ms.
const PAST: usize = 5;
/// Standard deviation of the real speed about what the drive's gain explains, m/s: uneven ground and the drive's
/// own regulation.
const UNEVEN_SPEED: f64 = 0.05;
/// Deviation of the drive's gain from one that noise explains: two standard deviations at 1 m/s.
const IGNORED_GAIN: f64 = 0.02;
/// How long a commanded speed must have lasted before the real one tells the drive's gain: a time constant, in lags of the
/// drive, and s. A drive that starts is behind its lag, too: its motor driver limits the acceleration, and its command
/// comes late.
const STEADY: (f64, f64) = (3.0, 0.5);
/// Standard deviation of the real speed about what the gain explains, as a share of the difference between the commanded
/// speed and what of it has lasted.
const UNSTEADY: f64 = 2.0;

/// Variances of [`Estimator::effectiveness`] and [`Estimator::drive`] before anything was measured.
const FIRST_VARIANCES: [f64; 2] = [0.09, 0.04];
/// Change of the speed from one measurement to the next that no vehicle makes, m/s.
const LEAP: f64 = 3.0;
/// Speed of the rear axle that no vehicle of this kind has, m/s.
const FASTEST: f64 = 50.0;
/// Size of a command (m/s, rad/s) or of a reading (rad) that none has.
const HUGE: f64 = 1e3;

/// What follows from the settings, computed once.
#[derive(Clone, Copy, Debug)]
struct Derived<T> {
    /// One over the described wheelbase, 1/m.
    per_wheelbase: T,
    /// Change of the antenna's speed, as a share, by a steering bias of five times the expected size and by noise.
    explained: T,
    /// Difference between a measured and an expected speed that noise explains, m/s.
    speed_noise: T,
    /// Time constant of [`STEADY`], s.
    steady: T,
    /// Square of the speed up to which the vehicle counts as standing.
    standstill: T,
    /// Variance of a position, per axis, m^2.
    position: T,
    /// Variance of a velocity, per axis, m^2/s^2.
    velocity: T,
    /// Variance of a measured speed about what the drive's gain explains, m^2/s^2.
    speed: T,
    /// Variance of a steering angle, rad^2.
    steering: T,
    /// Variances that the states gain in a second while the vehicle moves.
    drift: [T; STATES],
}

impl<T: Scalar> Derived<T> {
    fn of(settings: &EstimatorSettings<T>) -> Self {
        let square = |value: T| value * value;
        let noise = &settings.noise;
        let wheelbase = settings.geometry.wheelbase();
        let mut drift = [T::zero(); STATES];
        drift[NORTH] = square(noise.slip);
        drift[EAST] = square(noise.slip);
        drift[HEADING] = square(noise.heading);
        drift[STEERING] = square(noise.actuator);
        drift[HEADING_BIAS] = square(noise.heading_bias);
        drift[STEERING_BIAS] = square(noise.steering_bias);
        Self {
            per_wheelbase: T::one() / wheelbase,
            explained: settings.antenna.right.abs() / wheelbase
                * noise.first_steering_bias
                * T::lit(5.0)
                + T::lit(IGNORED_GAIN),
            speed_noise: T::lit(2.0) * noise.velocity + T::lit(UNEVEN_SPEED),
            steady: T::lit(STEADY.0) * settings.drive_lag + T::lit(STEADY.1),
            standstill: square(settings.standstill),
            position: square(noise.position),
            velocity: square(noise.velocity),
            speed: square(noise.velocity) + T::lit(UNEVEN_SPEED * UNEVEN_SPEED),
            steering: square(noise.steering),
            drift,
        }
    }
}

/// The filter: estimate and covariance.
#[derive(Clone, Copy, Debug)]
pub struct Estimator<T> {
    settings: EstimatorSettings<T>,
    derived: Derived<T>,
    origin: Position,
    state: [T; STATES],
    covariance: Covariance<T>,
    speed: T,
    /// Real steering rate as a share of the commanded one, with its variance.
    effectiveness: T,
    effectiveness_variance: T,
    /// Real speed as a share of the commanded one, with its variance.
    drive_found: T,
    drive_variance: T,
    /// What of it is acted upon.
    drive: T,
    /// The real speed that an update showed, and the commanded one, m/s. The next prediction uses it.
    measured: Option<[T; 2]>,
    /// The commanded speed behind the drive's lag, m/s.
    driven: T,
    /// What noise does not explain of the difference between the last measured speed and the expected one, m/s.
    stray_speed: T,
    /// The speed of the rear axle that the last velocity told, m/s, plausible or not.
    last_size: T,
    /// What has lasted of the commanded speed, m/s: behind a lag of [`STEADY`].
    lasting: T,
    /// The wheelbase that acts, m, and one over it, 1/m.
    wheelbase: T,
    per_wheelbase: T,
    /// Age of GPS data, s, and one over it, 1/s; 0 if they have none.
    delay: T,
    per_delay: T,
    /// Estimates both.
    habits: Habits<T>,
    /// What the measurements of an update tell about them. The next prediction uses it.
    shown: Shown<T>,
    /// What the last steps predicted, the newest first.
    past: [Moved<T>; PAST],
    /// How the vehicle has moved since GPS data that arrive now were measured.
    back: Back<T>,
    heading_known: bool,
    outliers: u8,
    /// Angles of the prediction that no update has used yet.
    predicted: Option<Angles<T>>,
    /// What the last measurement of an update tells about the covariance. No other measurement of that
    /// update depends on it, so the next prediction carries it out.
    pending: Option<Correction<T>>,
    /// [`Estimator::antenna_variance`] without what wheelbase and age of the data add.
    antenna: T,
}

impl<T: Scalar> Estimator<T> {
    /// A filter without an estimate. `origin` is the origin of its frame. Keep
    /// it within 16 km of the field: farther away single precision loses
    /// millimetres.
    ///
    /// # Errors
    /// [`EstimatorError`] names the setting that is unusable.
    pub fn new(settings: EstimatorSettings<T>, origin: Position) -> Result<Self, EstimatorError> {
        settings.check()?;
        let mut filter = Self {
            settings,
            derived: Derived::of(&settings),
            origin,
            state: [T::zero(); STATES],
            covariance: Covariance::zero(),
            speed: T::zero(),
            effectiveness: T::one(),
            effectiveness_variance: T::lit(FIRST_VARIANCES[0]),
            drive_found: T::one(),
            drive_variance: T::lit(FIRST_VARIANCES[1]),
            drive: T::one(),
            measured: None,
            driven: T::zero(),
            stray_speed: T::zero(),
            last_size: T::zero(),
            lasting: T::zero(),
            wheelbase: T::zero(),
            per_wheelbase: T::zero(),
            delay: T::zero(),
            per_delay: T::zero(),
            habits: Habits::new(settings.expected),
            shown: Shown::nothing(),
            past: [Moved::none(); PAST],
            back: Back::none(),
            heading_known: false,
            outliers: 0,
            predicted: Some(Angles::zero()),
            pending: None,
            antenna: T::zero(),
        };
        filter.forget_angles();
        filter.set_curvature(T::one());
        filter.set_delay(settings.gps_delay);
        Ok(filter)
    }

    /// True if position and heading are known.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.heading_known
    }

    /// The origin of the frame.
    #[must_use]
    pub fn origin(&self) -> Position {
        self.origin
    }

    /// Sets the measured age of GPS data at their arrival, s, from the next prediction on. A value that is
    /// negative, above a second or not a number is ignored.
    pub fn set_gps_delay(&mut self, delay: T) {
        if is_age(delay) {
            self.settings.gps_delay = delay;
        }
    }

    /// Sets where the antenna was over the ground when the next GPS data were measured, relative to the rear axle: `ahead` of it
    /// and to the `right` of the centre line, m. Until the first call these are the values of the settings. Values that are
    /// not finite are ignored.
    ///
    /// Position and velocity count as those of an antenna that stays at this place of the vehicle.
    pub fn set_lever(&mut self, ahead: T, right: T) {
        if ahead.is_finite() && right.is_finite() {
            self.settings.geometry.l1 = ahead;
            self.settings.antenna.right = right;
            self.derived.explained = right.abs()
                * self.derived.per_wheelbase
                * self.settings.noise.first_steering_bias
                * T::lit(5.0)
                + T::lit(IGNORED_GAIN);
        }
    }

    fn set_delay(&mut self, delay: T) {
        self.delay = delay;
        self.per_delay = if delay > T::zero() {
            T::one() / delay
        } else {
            T::zero()
        };
    }

    fn set_curvature(&mut self, share: T) {
        self.per_wheelbase = self.derived.per_wheelbase * share;
        self.wheelbase = T::one() / self.per_wheelbase;
    }

    /// The wheelbase that acts, m, as estimated: that of the settings if [`Expected::curvature`] is zero.
    #[must_use]
    pub fn wheelbase(&self) -> T {
        self.wheelbase
    }

    /// Age of GPS data, s, as set or estimated.
    #[must_use]
    pub fn gps_delay(&self) -> T {
        self.delay
    }

    /// Moves the origin of the frame. The vehicle keeps its place on the ground.
    pub fn rebase(&mut self, origin: Position) {
        let (north, east) = self.origin.metres_from::<T>(origin);
        self.state[NORTH] += north;
        self.state[EAST] += east;
        self.origin = origin;
    }

    /// The current estimate. Position and heading are valid only if
    /// [`Self::is_ready`].
    #[must_use]
    pub fn estimate(&self) -> Estimate<T> {
        let x = &self.state;
        Estimate {
            north: x[NORTH],
            east: x[EAST],
            heading: x[HEADING],
            steering_angle: x[STEERING],
            heading_bias: x[HEADING_BIAS],
            steering_bias: x[STEERING_BIAS],
            speed: self.speed,
        }
    }

    /// Standard deviations of the first six fields of [`Estimate`], in their
    /// units.
    #[must_use]
    pub fn deviations(&self) -> [T; STATES] {
        let mut variances = self.settled().variances();
        for (variance, added) in variances.iter_mut().zip(self.habits.variances()) {
            *variance += added;
        }
        variances.map(Scalar::root)
    }

    /// Real steering rate as a share of the commanded one, in [0.3, 1.5],
    /// estimated while the steering moves. A loaded or worn actuator is slower
    /// than its calibration.
    #[must_use]
    pub fn effectiveness(&self) -> T {
        self.effectiveness
    }

    /// Real speed over ground as a share of the commanded one, in [0.3, 1.5], estimated while the
    /// vehicle moves. Wheels slip, and a loaded motor is slower than its calibration.
    #[must_use]
    pub fn drive(&self) -> T {
        self.drive
    }

    /// The covariance of north, east, heading, steering angle, heading bias
    /// and steering bias.
    #[must_use]
    pub fn covariance(&self) -> SMatrix<T, STATES, STATES> {
        self.settled().matrix()
    }

    /// Variance of the position, north plus east, m^2.
    #[must_use]
    pub fn position_variance(&self) -> T {
        let variances = self.settled().variances();
        let added = self.habits.variances();
        variances[NORTH] + variances[EAST] + added[NORTH] + added[EAST]
    }

    /// The same before the last course has lowered it, which takes less time.
    #[must_use]
    pub fn largest_position_variance(&self) -> T {
        let variances = self.covariance.variances();
        variances[NORTH] + variances[EAST] + self.habits.place_variance()
    }

    /// Variance of the antenna's place before the last position corrected it, north plus east, m^2. While positions arrive
    /// it is known, even if the heading is not, on which the place of the rear axle depends.
    #[must_use]
    pub fn antenna_variance(&self) -> T {
        self.antenna + self.habits.place_variance()
    }

    /// The covariance with all that is known.
    fn settled(&self) -> Covariance<T> {
        let mut covariance = self.covariance;
        if let Some(last) = &self.pending {
            covariance.correct(&last.cross, last.inverse, last.biases);
        }
        covariance
    }

    /// One step: [`Self::predict`] over `dt`, then [`Self::update`] with the measurements that
    /// arrived.
    pub fn step(&mut self, seen: &Observation<T>) -> Update {
        if !seen.is_usable() {
            return Update::BadInput;
        }
        let command = Command {
            steering_rate: seen.steering_rate,
            speed: seen.speed,
        };
        self.predicted = Some(self.advance(command, seen.dt));
        self.update(seen)
    }

    /// The time update: moves the estimate on by `dt` (s) under `command`. It needs no measurement,
    /// so it may run as soon as the command is known. The measurements of that time then have less to
    /// wait for. Call it once before each [`Self::update`]. Does nothing if an argument is not finite or
    /// `dt` not positive.
    pub fn predict(&mut self, command: Command<T>, dt: T) {
        if is_sane(command.steering_rate) && is_sane(command.speed) && is_period(dt) {
            self.predicted = Some(self.advance(command, dt));
        }
    }

    /// The measurement update: corrects the predicted estimate with the measurements that arrived.
    /// Command and period of `seen` are those of the prediction. A new filter needs none for its first
    /// update; any other one without a prediction changes nothing.
    pub fn update(&mut self, seen: &Observation<T>) -> Update {
        if !seen.is_usable() {
            return Update::BadInput;
        }
        let Some(mut angles) = self.predicted.take() else {
            return Update::BadInput;
        };
        if let Some(angle) = seen.steering_angle {
            self.see_steering(angle, seen.steering_rate * seen.dt);
        }
        let update = self.see_gps(seen, &mut angles);
        let [.., heading, _, heading_bias, steering_bias] = self.state;
        if !self.is_finite() {
            self.heading_known = false;
            self.state = [T::zero(); STATES];
            (self.effectiveness, self.effectiveness_variance) =
                (T::one(), T::lit(FIRST_VARIANCES[0]));
            (self.drive_found, self.drive_variance) = (T::one(), T::lit(FIRST_VARIANCES[1]));
            self.drive = T::one();
            self.antenna = T::zero();
            self.speed = T::zero();
            self.driven = T::zero();
            self.lasting = T::zero();
            self.stray_speed = T::zero();
            self.measured = None;
            self.past = [Moved::none(); PAST];
            self.back = Back::none();
            self.habits = Habits::new(self.settings.expected);
            self.shown = Shown::nothing();
            self.set_curvature(T::one());
            self.set_delay(self.settings.gps_delay);
            self.covariance = Covariance::zero();
            self.pending = None;
            self.forget_angles();
            return Update::NoHeading;
        }
        let largest = T::lit(LARGEST_BIAS);
        self.state[HEADING] = wrap_angle(heading);
        self.state[HEADING_BIAS] = clamp_symmetric(heading_bias, largest);
        self.state[STEERING_BIAS] = clamp_symmetric(steering_bias, largest);
        update
    }

    /// True if the estimate is usable. A covariance that is not finite comes from a product with a
    /// number whose square makes a variance so, too.
    fn is_finite(&self) -> bool {
        let states = self.state.into_iter();
        let all = states.chain(self.covariance.variances());
        let sum = all.fold(T::zero(), |sum, value| sum + value);
        let found = self.drive_variance + self.effectiveness_variance;
        (sum + found * (self.speed + self.habits.place_variance())).is_finite()
    }

    fn forget_angles(&mut self) {
        let noise = &self.settings.noise;
        let square = |value: T| value * value;
        // Any steering angle is possible before the first measurement.
        self.covariance.set_angles(
            T::lit(0.25),
            square(noise.first_heading_bias),
            square(noise.first_steering_bias),
        );
    }

    fn is_moving(&self) -> bool {
        self.speed.abs() > self.settings.standstill
    }

    /// Advances the estimate. Returns heading and steering angle in the middle of the step.
    fn advance(&mut self, command: Command<T>, dt: T) -> Angles<T> {
        if let Some(last) = self.pending.take() {
            self.covariance
                .correct(&last.cross, last.inverse, last.biases);
        }
        self.learn_habits();
        if let Some([measured, commanded]) = self.measured.take() {
            self.learn_drive(measured, commanded);
        }
        let half = T::lit(0.5);

        let share = dt / (dt + self.settings.drive_lag);
        let before = self.speed;
        self.speed += (command.speed * self.drive() - self.speed) * share;
        self.driven += (command.speed - self.driven) * share;
        self.lasting += (command.speed - self.lasting) * dt / (dt + self.derived.steady);
        let way = (before + self.speed) * half * dt;

        let turned = command.steering_rate * self.effectiveness * dt;
        let gained = self.speed - before;
        let [one, two, three, four, _] = self.past;
        self.past = [Moved { turned, gained }, one, two, three, four];
        // Here and not in the update, so that measurements have less to wait for.
        self.back = self.look_back(dt);
        let wheels = Wheels::at(self.state[STEERING] + turned * half);
        let (turn, gain) = self.curve(way, turned).arc(&wheels);
        let heading = Direction::of(self.state[HEADING] + turn * half);
        let (north, east) = (way * heading.cosine, way * heading.sine);
        self.state[NORTH] += north;
        self.state[EAST] += east;
        self.state[HEADING] += turn;
        self.state[STEERING] += turned;

        let moving = if self.is_moving() { dt } else { T::zero() };
        let mut drift = self.derived.drift.map(|variance| variance * moving);
        let stray = self.settings.noise.actuator_share * turned;
        drift[STEERING] = self.derived.drift[STEERING] * dt + stray * stray;
        // An error of the speed moves the place along the way, and the data by their age too.
        let astray = self.stray_speed * (moving + self.delay);
        let along = [astray * heading.cosine, astray * heading.sine];
        drift[NORTH] += along[0] * along[0];
        drift[EAST] += along[1] * along[1];
        let derivatives = Transition {
            north: -east,
            east: north,
            turn: gain,
        };
        self.covariance
            .advance(&derivatives, &drift, along[0] * along[1]);
        self.habits.advance(&derivatives, turn);
        Angles { heading, wheels }
    }

    /// Corrects what the description may have wrong by what the last update showed.
    fn learn_habits(&mut self) {
        let shown = core::mem::replace(&mut self.shown, Shown::nothing());
        let told = self.settings.gps_delay;
        if self.habits.are_estimated() {
            self.habits.learn(&shown, &mut self.state, told);
        }
        let (curvature, delay) = self.habits.found(told);
        self.set_curvature(curvature);
        self.set_delay(delay);
    }

    /// Computes `angles` anew if a correction has moved the estimate far away from them.
    fn follow(&self, angles: &mut Angles<T>) {
        let (heading, steering) = (self.state[HEADING], self.state[STEERING]);
        if !(is_near(angles.heading.angle, heading) && is_near(angles.wheels.angle, steering)) {
            *angles = Angles::of(heading, steering);
        }
    }

    /// A way (m) on which the steering turns by `turned` (rad).
    fn curve(&self, way: T, turned: T) -> Curve<T> {
        let scale = self.per_wheelbase;
        Curve {
            bends: way * scale,
            // The rear axle's slip angle follows the curvature.
            slips: self.settings.rear_slip * self.speed * self.speed.abs() * turned * scale,
        }
    }

    /// Updates the effectiveness from the `innovation` (rad) of the measured
    /// steering angle after a commanded movement of `asked` (rad).
    fn learn_effectiveness(&mut self, innovation: T, asked: T) {
        // A small movement does not exceed the noise of two readings.
        if !(asked.abs() > T::lit(5.0) * self.settings.noise.steering) {
            return;
        }
        let spread =
            asked * asked * self.effectiveness_variance + T::lit(8.0) * self.derived.steering;
        let gain = asked * self.effectiveness_variance / spread;
        self.effectiveness += gain * innovation;
        self.effectiveness_variance *= T::one() - gain * asked;
        // The effectiveness may change by some percent per second.
        self.effectiveness_variance += T::lit(4e-4);
        let (least, most) = (T::lit(0.3), T::lit(1.5));
        if !(self.effectiveness > least) {
            self.effectiveness = least;
        } else if self.effectiveness > most {
            self.effectiveness = most;
        }
    }

    fn see_steering(&mut self, angle: T, asked: T) {
        let innovation = angle - self.state[STEERING] - self.state[STEERING_BIAS];
        self.learn_effectiveness(innovation, asked);
        let [_, _, _, steering, _, bias] = self.covariance.columns();
        let cross = combined(&bias, T::one(), &steering);
        let spread = cross[STEERING] + cross[STEERING_BIAS] + self.derived.steering;
        self.correct(&cross, spread, innovation);
    }

    fn see_gps(&mut self, seen: &Observation<T>, angles: &mut Angles<T>) -> Update {
        self.follow(angles);
        let back = self.back;
        let course = seen
            .velocity
            .and_then(|velocity| self.see_speed(velocity, seen, &back, &angles.wheels));
        let since = self.since(&back);
        if !self.heading_known {
            return self.start_from(seen, &since, angles, course, Update::Corrected);
        }
        let fits = match seen.position {
            Some(position) => self.see_position(position, &since, angles),
            None => {
                self.reckon(angles);
                false
            }
        };
        if seen.position.is_some() && !fits {
            self.outliers = self.outliers.saturating_add(1);
            if self.outliers >= PATIENCE {
                self.heading_known = false;
                self.outliers = 0;
                return self.start_from(seen, &since, angles, course, Update::Restarted);
            }
        } else if fits {
            self.outliers = 0;
        }
        if let Some(course) = course {
            // The angles are not computed anew: their series are off by less than 3e-5 rad a whole radian away, which is
            // farther than a position turns the heading.
            self.see_course(course, &since, angles);
        }
        if fits || course.is_some() {
            Update::Corrected
        } else {
            Update::DeadReckoned
        }
    }

    /// Variance of the antenna's place without a position.
    #[cold]
    #[inline(never)]
    fn reckon(&mut self, angles: &Angles<T>) {
        let Direction { sine, cosine, .. } = angles.heading.near(self.state[HEADING]);
        let l1 = self.settings.geometry.l1;
        let right = self.settings.antenna.right;
        self.antenna = self
            .covariance
            .place(l1 * cosine - right * sine, l1 * sine + right * cosine);
    }

    /// Starts the estimate if position and course arrived; then the update was a `started` one.
    #[cold]
    #[inline(never)]
    fn start_from(
        &mut self,
        seen: &Observation<T>,
        since: &Since<T>,
        angles: &Angles<T>,
        course: Option<(T, T)>,
        started: Update,
    ) -> Update {
        match (seen.position, course) {
            (Some(position), Some(course)) => {
                self.start(position, course, since, angles);
                started
            }
            _ => Update::NoHeading,
        }
    }

    /// Corrects the speed. Returns the antenna's velocity (m/s north and east), turned round if
    /// the vehicle is in reverse, if it is fast enough to have a course.
    fn see_speed(
        &mut self,
        velocity: Velocity,
        seen: &Observation<T>,
        back: &Back<T>,
        wheels: &Wheels<T>,
    ) -> Option<(T, T)> {
        let (north, east) = velocity.metres_per_second::<T>();
        let square = north * north + east * east;
        // The rear axle's speed is size cos(lead) L / (L - w right / V). Both the cosine and the
        // divisor follow from the lever, so the angle itself is not needed.
        let then = self.state[STEERING] - back.turned.sum;
        let (forward, sideways) = self.lever(&wheels.near(then));
        let ratio = square / (forward * forward + sideways * sideways);
        let size = self.wheelbase * ratio.root();
        if !self.is_plausible(size) {
            return None;
        }
        let backward = self.is_backward();
        let measured = if backward { -size } else { size };
        let expected = self.speed - back.gained.sum;
        self.measured = Some([measured + back.gained.sum, seen.speed]);
        let error = measured - expected;
        let beyond = error - clamp_symmetric(error, self.derived.speed_noise);
        self.speed += error * T::lit(0.4) + beyond * T::lit(0.5);
        self.stray_speed = beyond;
        if !(square > self.derived.standstill && self.is_moving()) {
            None
        } else if backward {
            Some((-north, -east))
        } else {
            Some((north, east))
        }
    }

    /// Whether the rear axle may have this speed (m/s, not negative): no vehicle gains [`LEAP`] between two measurements. A
    /// speed that comes twice is one.
    fn is_plausible(&mut self, size: T) -> bool {
        let is_near = |other: T| (size - other.abs()).abs() <= T::lit(LEAP);
        let leaps = !(is_near(self.speed) || is_near(self.last_size));
        self.last_size = size;
        !leaps && size <= T::lit(FASTEST)
    }

    /// Whether the vehicle drives backwards. The velocity vector does not tell it; the drive does, and what it was told for
    /// a while is not doubted.
    fn is_backward(&self) -> bool {
        let surely = T::lit(2.0) * self.settings.standstill;
        if self.driven > surely && self.lasting > surely {
            false
        } else if self.driven < -surely && self.lasting < -surely {
            true
        } else {
            self.speed < T::zero()
        }
    }

    /// Velocity of the antenna along and across the rear axle's, as multiples of the rear axle's
    /// speed over the wheelbase.
    ///
    /// With the yaw rate w = V tan(angle) / L, the antenna moves forward at
    /// V - w right and sideways at w l1. On the inside of a turn it is slower than the rear axle,
    /// and its course leads by the angle of this vector.
    fn lever(&self, wheels: &Wheels<T>) -> (T, T) {
        let tangent = wheels.tangent;
        (
            self.wheelbase - self.settings.antenna.right * tangent,
            self.settings.geometry.l1 * tangent,
        )
    }

    /// Updates the drive's gain from the speed that was `measured` (m/s), with what it has gained since, under the
    /// speed that was commanded since the last step.
    fn learn_drive(&mut self, measured: T, commanded: T) {
        let driven = self.driven;
        if !(driven.abs() > self.settings.standstill) {
            return;
        }
        let square = |value: T| value * value;
        // While the speed changes, what the model of the drive lacks looks like an error of the gain.
        let changing = square((commanded - self.lasting) * T::lit(UNSTEADY));
        let noise = self.derived.speed + changing;
        let share = driven * self.drive_variance;
        let gain = share / (driven * share + noise);
        self.drive_found += gain * (measured - self.drive_found * driven);
        self.drive_variance *= T::one() - gain * driven;
        // The ground may change by two percent in a second of ten measurements.
        self.drive_variance += T::lit(2e-5);
        let (least, most) = (T::lit(0.3), T::lit(1.5));
        if !(self.drive_found > least) {
            self.drive_found = least;
        } else if self.drive_found > most {
            self.drive_found = most;
        }
        // What noise or a steering bias may explain does not count: an antenna beside the centre line is faster or
        // slower with the yaw rate, so such a bias looks like a gain. Twice as much counts in full.
        let found = self.drive_found - T::one();
        let explained = self.derived.explained;
        let beyond = found - clamp_symmetric(found, explained);
        self.drive = T::one() + beyond + clamp_symmetric(beyond, explained);
    }

    /// By how much steering angle and speed have changed since the GPS data were measured, by the predictions of the
    /// steps since then, of `dt` (s) each.
    #[inline(never)]
    fn look_back(&self, dt: T) -> Back<T> {
        let half = T::lit(0.5);
        let per_step = T::one() / dt;
        let mut left = self.delay;
        let mut back = Back::none();
        // loop-bound: 5
        for moved in &self.past {
            let time = if left > dt { dt } else { left };
            left -= time;
            let share = time * per_step;
            let turned = moved.turned * share;
            let gained = moved.gained * share;
            back.turned.moment += (back.turned.sum + turned * half) * time;
            back.gained.moment += (back.gained.sum + gained * half) * time;
            back.turned.sum += turned;
            back.gained.sum += gained;
        }
        back
    }

    /// How the vehicle has moved since the GPS data were measured. Corrections of position and angles
    /// change none of it.
    fn since(&self, back: &Back<T>) -> Since<T> {
        let way = self.speed * self.delay - back.gained.moment;
        Since {
            way,
            turned: back.turned.sum,
            middle: back.turned.moment * self.per_delay,
            curve: self.curve(way, back.turned.sum),
        }
    }

    /// The pose at the time when the GPS data were measured, computed back from
    /// the current state.
    fn delayed(&self, since: &Since<T>, wheels: &Wheels<T>) -> Delayed<T> {
        let middle = wheels.near(self.state[STEERING] - since.middle);
        let (turn, gain) = since.curve.arc(&middle);
        let heading = self.state[HEADING] - turn;
        Delayed {
            gain,
            heading,
            middle: heading + turn * T::lit(0.5),
            steering_angle: self.state[STEERING] - since.turned,
        }
    }

    fn start(&mut self, position: Position, course: (T, T), since: &Since<T>, angles: &Angles<T>) {
        let then = self.delayed(since, &angles.wheels);
        let turn = self.state[HEADING] - then.heading;
        let (forward, sideways) = self.lever(&angles.wheels.near(then.steering_angle));
        let lead = sideways.angle_of(forward);
        let (course_north, course_east) = course;
        let heading = course_east.angle_of(course_north) - lead - self.state[HEADING_BIAS];
        let (sine, cosine) = heading.sine_cosine();
        let (sine_way, cosine_way) = (heading + turn * T::lit(0.5)).sine_cosine();
        let (north, east) = position.metres_from::<T>(self.origin);
        let l1 = self.settings.geometry.l1;
        let right = self.settings.antenna.right;
        let lever = [l1 * cosine - right * sine, l1 * sine + right * cosine];
        let way = [since.way * cosine_way, since.way * sine_way];
        self.state[NORTH] = north - lever[0] + way[0];
        self.state[EAST] = east - lever[1] + way[1];
        self.state[HEADING] = heading + turn;

        let [north, east] = rows(lever, way, then.gain);
        let position = self.derived.position;
        self.antenna = position + position;
        self.covariance.restart(&Beginning {
            position,
            course: self.course_variance(course),
            lead: l1 * self.per_wheelbase - then.gain,
            north,
            east,
            lever: l1 * l1 + right * right,
        });
        self.heading_known = true;
        self.outliers = 0;
        self.habits.restart();
        self.shown = Shown::nothing();
    }

    /// Variance of the direction of the velocity `north`, `east` (m/s), rad^2.
    fn course_variance(&self, (north, east): (T, T)) -> T {
        self.derived.velocity / (north * north + east * east)
    }

    /// Corrects the estimate by an antenna position. Returns false if the
    /// position is an outlier; the estimate is then unchanged.
    fn see_position(&mut self, position: Position, since: &Since<T>, angles: &Angles<T>) -> bool {
        let (north, east) = position.metres_from::<T>(self.origin);
        let variance = self.derived.position;
        let l1 = self.settings.geometry.l1;
        let right = self.settings.antenna.right;

        let then = self.delayed(since, &angles.wheels);
        let Direction { sine, cosine, .. } = angles.heading.near(then.heading);
        let lever_north = l1 * cosine - right * sine;
        let lever_east = l1 * sine + right * cosine;
        let back = angles.heading.near(then.middle);
        let (way_north, way_east) = (since.way * back.cosine, since.way * back.sine);
        let [north_row, east_row] =
            rows([lever_north, lever_east], [way_north, way_east], then.gain);
        let north_innovation = north - (self.state[NORTH] - way_north + lever_north);
        let east_innovation = east - (self.state[EAST] - way_east + lever_east);

        let columns = self.covariance.columns();
        let north_cross = shown(&columns[NORTH], north_row, &columns);
        let north_spread = seen_by(&north_cross, NORTH, north_row) + variance;
        let east_cross = shown(&columns[EAST], east_row, &columns);
        let east_spread = seen_by(&east_cross, EAST, east_row) + variance;
        self.antenna = north_spread + east_spread - T::lit(2.0) * variance;
        // Test both axes before using either.
        let gate = T::lit(GATE);
        if !(north_innovation * north_innovation <= gate * north_spread
            && east_innovation * east_innovation <= gate * east_spread)
        {
            return false;
        }
        let (inverse, change) = self.correct(&north_cross, north_spread, north_innovation);
        self.shown.north = Some((north_cross, inverse, north_row));
        // The first correction changes what the second one sees. All of that follows from the
        // covariance of the two measurements, without the corrected matrix.
        let both = seen_by(&north_cross, EAST, east_row);
        let share = both * inverse;
        let east_cross = combined(&east_cross, -share, &north_cross);
        let east_spread = east_spread - share * both;
        let (inverse, _) = self.correct(&east_cross, east_spread, east_innovation - both * change);
        self.shown.east = Some((east_cross, inverse, east_row));
        true
    }

    /// Corrects the estimate by the direction of the antenna's velocity `north`, `east` (m/s),
    /// unless it is an outlier.
    fn see_course(&mut self, (north, east): (T, T), since: &Since<T>, angles: &Angles<T>) {
        let then = self.delayed(since, &angles.wheels);
        let (forward, sideways) = self.lever(&angles.wheels.near(then.steering_angle));
        // Turned back by the expected heading and by the lead of the antenna, the velocity shows
        // the bias and the error of both.
        let Direction { sine, cosine, .. } = angles.heading.near(then.heading);
        let along = north * cosine + east * sine;
        let across = east * cosine - north * sine;
        let error =
            (across * forward - along * sideways).angle_of(along * forward + across * sideways);
        let innovation = wrap_angle(error - self.state[HEADING_BIAS]);

        let arm = self.settings.geometry.l1 * self.per_wheelbase;
        let steering_gain = arm - then.gain;
        let [_, _, heading, steering, bias, _] = self.covariance.columns();
        let sum = combined(&heading, T::one(), &bias);
        let cross = combined(&sum, steering_gain, &steering);
        let spread = cross[HEADING]
            + cross[HEADING_BIAS]
            + steering_gain * cross[STEERING]
            + self.course_variance((north, east));
        if innovation * innovation <= T::lit(GATE) * spread {
            self.pending = self.shift(&cross, spread, innovation).map(|(it, _)| it);
            if let Some(last) = &self.pending {
                let tangent = angles.wheels.near(then.steering_angle).tangent;
                self.shown.course = Some(Course {
                    cross,
                    inverse: last.inverse,
                    innovation,
                    steering: steering_gain,
                    lead: arm * tangent,
                    // The course turns with the heading and with the lead of the antenna.
                    turning: self.speed * self.per_wheelbase * tangent
                        + arm * since.turned * self.per_delay,
                });
            }
        }
    }

    /// Measurement update for one scalar measurement. `cross` are the covariances of the states
    /// with what it shows, `spread` is the variance of the `innovation`. Returns one over the variance,
    /// and by how much each state changes per covariance.
    #[inline(never)]
    fn correct(&mut self, cross: &[T; STATES], spread: T, innovation: T) -> (T, T) {
        let Some((correction, change)) = self.shift(cross, spread, innovation) else {
            return (T::zero(), T::zero());
        };
        self.covariance
            .correct(cross, correction.inverse, correction.biases);
        (correction.inverse, change)
    }

    /// The part of such an update that corrects the states. Returns that of the covariance, and by how
    /// much each state changes per covariance. At standstill the biases
    /// are frozen by a Schmidt-Kalman update: their gain is zero, but their
    /// uncertainty still counts.
    #[inline(always)]
    fn shift(
        &mut self,
        cross: &[T; STATES],
        spread: T,
        innovation: T,
    ) -> Option<(Correction<T>, T)> {
        if !(spread > T::zero()) {
            return None;
        }
        let inverse = T::one() / spread;
        let change = inverse * innovation;
        let biases = self.is_moving();
        self.state[NORTH] += cross[NORTH] * change;
        self.state[EAST] += cross[EAST] * change;
        self.state[HEADING] += cross[HEADING] * change;
        self.state[STEERING] += cross[STEERING] * change;
        if biases {
            self.state[HEADING_BIAS] += cross[HEADING_BIAS] * change;
            self.state[STEERING_BIAS] += cross[STEERING_BIAS] * change;
        }
        let correction = Correction {
            cross: *cross,
            inverse,
            biases,
        };
        Some((correction, change))
    }
}

/// A correction of the covariance.
#[derive(Clone, Copy, Debug)]
struct Correction<T> {
    /// Covariances of the states with what a measurement shows.
    cross: [T; STATES],
    /// One over the variance of its innovation.
    inverse: T,
    /// Whether it corrects the biases, too.
    biases: bool,
}

/// `first` + `factor` `second`.
#[inline(always)]
fn combined<T: Scalar>(first: &[T; STATES], factor: T, second: &[T; STATES]) -> [T; STATES] {
    core::array::from_fn(|state| first[state] + factor * second[state])
}

/// Derivatives of the antenna's northing and easting when they were measured with respect to heading and steering angle
/// now, with the `lever` from the rear axle to it and the `way` since then, m north and east.
#[inline(always)]
fn rows<T: Scalar>(lever: [T; 2], way: [T; 2], gain: T) -> [[T; 2]; 2] {
    let half = T::lit(0.5);
    let ([lever_north, lever_east], [way_north, way_east]) = (lever, way);
    [
        [way_east - lever_east, (lever_east - way_east * half) * gain],
        [
            lever_north - way_north,
            (way_north * half - lever_north) * gain,
        ],
    ]
}

/// Covariances of the states with a measurement of the state whose column is `own`, which depends
/// on heading and steering angle, too, with the derivatives `row`.
#[inline(always)]
fn shown<T: Scalar>(
    own: &[T; STATES],
    [heading, steering]: [T; 2],
    columns: &[[T; STATES]; STATES],
) -> [T; STATES] {
    let with_heading = combined(own, heading, &columns[HEADING]);
    combined(&with_heading, steering, &columns[STEERING])
}

/// What a measurement of the state `own` sees of the covariances `cross`. It depends on heading
/// and steering angle, too, with the derivatives `row`.
#[inline(always)]
fn seen_by<T: Scalar>(cross: &[T; STATES], own: usize, [heading, steering]: [T; 2]) -> T {
    cross[own] + heading * cross[HEADING] + steering * cross[STEERING]
}

/// Angles close to the estimated heading and steering angle.
#[derive(Clone, Copy, Debug)]
struct Angles<T> {
    heading: Direction<T>,
    wheels: Wheels<T>,
}

impl<T: Scalar> Angles<T> {
    /// A heading of north, and straight wheels.
    fn zero() -> Self {
        let zero = T::zero();
        Self {
            heading: Direction::north(),
            wheels: Wheels {
                angle: zero,
                tangent: zero,
            },
        }
    }

    #[cold]
    #[inline(never)]
    fn of(heading: T, steering: T) -> Self {
        Self {
            heading: Direction::of(heading),
            wheels: Wheels::at(steering),
        }
    }
}

/// A way on which the steering turns.
struct Curve<T> {
    /// Its length over the wheelbase.
    bends: T,
    /// The turn by which the rear axle's slip angle changes on it, over the square of the cosine of
    /// the steering angle, rad.
    slips: T,
}

impl<T: Scalar> Curve<T> {
    /// The turn (rad) on it with `wheels` at its middle, and its derivative with respect to the
    /// steering angle.
    #[inline(always)]
    fn arc(&self, wheels: &Wheels<T>) -> (T, T) {
        let tangent = wheels.tangent;
        let derivative = T::one() + tangent * tangent;
        (
            self.bends * tangent - self.slips * derivative,
            self.bends * derivative,
        )
    }
}

/// What a prediction changed.
#[derive(Clone, Copy, Debug)]
struct Moved<T> {
    /// The steering angle, rad.
    turned: T,
    /// The speed, m/s.
    gained: T,
}

impl<T: Scalar> Moved<T> {
    fn none() -> Self {
        Self {
            turned: T::zero(),
            gained: T::zero(),
        }
    }
}

/// How a quantity has changed since the GPS data were measured.
#[derive(Clone, Copy, Debug)]
struct Change<T> {
    /// By how much.
    sum: T,
    /// The integral over that time of what was still to come, in its unit times seconds.
    moment: T,
}

/// The changes since the GPS data were measured.
#[derive(Clone, Copy, Debug)]
struct Back<T> {
    /// Of the steering angle, rad.
    turned: Change<T>,
    /// Of the speed, m/s.
    gained: Change<T>,
}

impl<T: Scalar> Back<T> {
    fn none() -> Self {
        let none = Change {
            sum: T::zero(),
            moment: T::zero(),
        };
        Self {
            turned: none,
            gained: none,
        }
    }
}

/// The motion since the GPS data were measured.
struct Since<T> {
    /// Distance driven, m.
    way: T,
    /// The angle by which the steering turned, rad.
    turned: T,
    /// The angle by which it has turned since on average over that time, rad.
    middle: T,
    curve: Curve<T>,
}

/// The pose at the time when the GPS data were measured.
struct Delayed<T> {
    /// Derivative of the turn since then with respect to the steering angle.
    gain: T,
    /// Heading then, rad.
    heading: T,
    /// Heading halfway between then and now, rad.
    middle: T,
    /// Steering angle then, rad.
    steering_angle: T,
}
