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
//! * At standstill the biases are not observable (thesis 7.2.5 with V = 0).
//!   They are frozen: value and variance stay.
//! * Without GPS data the filter continues by dead reckoning from steering
//!   angle and speed, and its variance grows with slip and steering noise.

use crate::linear::is_finite;
use crate::model::{Antenna, Geometry, GeometryError};
use crate::position::{Position, Velocity};
use crate::scalar::{Scalar, clamp_symmetric, wrap_angle};
use nalgebra::{SMatrix, SVector};

/// Number of states: north, east, heading, steering angle, heading bias,
/// steering bias.
const STATES: usize = 6;
const NORTH: usize = 0;
const EAST: usize = 1;
const HEADING: usize = 2;
const STEERING: usize = 3;
const HEADING_BIAS: usize = 4;
const STEERING_BIAS: usize = 5;

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
        if !(self.gps_delay.is_finite() && self.gps_delay >= T::zero()) {
            return Err(EstimatorError::Delay);
        }
        if !(positive(self.drive_lag) && positive(self.standstill)) {
            return Err(EstimatorError::Drive);
        }
        if self.rear_slip.is_finite() && self.rear_slip >= T::zero() {
            Ok(())
        } else {
            Err(EstimatorError::Slip)
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
    /// An input was not finite or the period not positive. Nothing was changed.
    BadInput,
}

/// A GPS position is an outlier if its squared innovation exceeds this many
/// variances (5 standard deviations).
const GATE: f64 = 25.0;
/// After this many outliers in a row the estimate, not the data, is taken to be
/// wrong.
const PATIENCE: u8 = 5;

/// The filter: estimate and covariance.
#[derive(Clone, Copy, Debug)]
pub struct Estimator<T> {
    settings: EstimatorSettings<T>,
    origin: Position,
    state: SVector<T, STATES>,
    covariance: SMatrix<T, STATES, STATES>,
    speed: T,
    /// Real steering rate as a share of the commanded one, with its variance.
    effectiveness: T,
    effectiveness_variance: T,
    heading_known: bool,
    outliers: u8,
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
            origin,
            state: SVector::zeros(),
            covariance: SMatrix::zeros(),
            speed: T::zero(),
            effectiveness: T::one(),
            effectiveness_variance: T::lit(0.09),
            heading_known: false,
            outliers: 0,
        };
        filter.forget_angles();
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

    /// Sets the measured age of GPS data at their arrival, s. A value that is
    /// negative or not finite is ignored.
    pub fn set_gps_delay(&mut self, delay: T) {
        if delay.is_finite() && delay >= T::zero() {
            self.settings.gps_delay = delay;
        }
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
        let p = &self.covariance;
        [
            p[(0, 0)].root(),
            p[(1, 1)].root(),
            p[(2, 2)].root(),
            p[(3, 3)].root(),
            p[(4, 4)].root(),
            p[(5, 5)].root(),
        ]
    }

    /// Real steering rate as a share of the commanded one, in [0.3, 1.5],
    /// estimated while the steering moves. A loaded or worn actuator is slower
    /// than its calibration.
    #[must_use]
    pub fn effectiveness(&self) -> T {
        self.effectiveness
    }

    /// The covariance of north, east, heading, steering angle, heading bias
    /// and steering bias.
    #[must_use]
    pub fn covariance(&self) -> &SMatrix<T, STATES, STATES> {
        &self.covariance
    }

    /// Variance of the position, north plus east, m^2.
    #[must_use]
    pub fn position_variance(&self) -> T {
        self.covariance[(NORTH, NORTH)] + self.covariance[(EAST, EAST)]
    }

    /// One step: advances the estimate by `dt`, then corrects it with the
    /// measurements that arrived.
    pub fn step(&mut self, seen: &Observation<T>) -> Update {
        let finite = seen.dt.is_finite()
            && seen.dt > T::zero()
            && seen.steering_rate.is_finite()
            && seen.speed.is_finite()
            && seen.steering_angle.is_none_or(|angle| angle.is_finite());
        if !finite {
            return Update::BadInput;
        }
        self.predict(seen);
        if let Some(angle) = seen.steering_angle {
            self.see_steering(angle, seen.steering_rate * seen.dt);
        }
        let update = self.see_gps(seen);
        if !(is_finite(&self.state) && is_finite(&self.covariance)) {
            self.heading_known = false;
            self.state = SVector::zeros();
            self.speed = T::zero();
            self.covariance = SMatrix::zeros();
            self.forget_angles();
            return Update::NoHeading;
        }
        update
    }

    fn forget_angles(&mut self) {
        let noise = self.settings.noise;
        let square = |value: T| value * value;
        // Any steering angle is possible before the first measurement.
        self.covariance[(STEERING, STEERING)] = T::lit(0.25);
        self.covariance[(HEADING_BIAS, HEADING_BIAS)] = square(noise.first_heading_bias);
        self.covariance[(STEERING_BIAS, STEERING_BIAS)] = square(noise.first_steering_bias);
    }

    fn is_moving(&self) -> bool {
        self.speed.abs() > self.settings.standstill
    }

    fn predict(&mut self, seen: &Observation<T>) {
        let dt = seen.dt;
        let half = T::lit(0.5);
        let noise = self.settings.noise;

        let share = dt / (dt + self.settings.drive_lag);
        let before = self.speed;
        self.speed += (seen.speed - self.speed) * share;
        let way = (before + self.speed) * half * dt;

        let length = self.settings.geometry.wheelbase();
        let turned = seen.steering_rate * self.effectiveness * dt;
        let tangent = (self.state[STEERING] + turned * half).tangent();
        let turn = way * tangent / length - self.slip_change(tangent, turned);
        // Derivative of the turn with respect to the steering angle.
        let gain = way * (T::one() + tangent * tangent) / length;
        let (sine, cosine) = (self.state[HEADING] + turn * half).sine_cosine();
        self.state[NORTH] += way * cosine;
        self.state[EAST] += way * sine;
        self.state[HEADING] = wrap_angle(self.state[HEADING] + turn);
        self.state[STEERING] += turned;

        // P <- F P F', where F is the identity except for these entries.
        let north_heading = -way * sine;
        let east_heading = way * cosine;
        let north_steering = north_heading * gain * half;
        let east_steering = east_heading * gain * half;
        let p = &mut self.covariance;
        for k in 0..STATES {
            let (heading, steering) = (p[(HEADING, k)], p[(STEERING, k)]);
            p[(NORTH, k)] += north_heading * heading + north_steering * steering;
            p[(EAST, k)] += east_heading * heading + east_steering * steering;
            p[(HEADING, k)] += gain * steering;
        }
        for k in 0..STATES {
            let (heading, steering) = (p[(k, HEADING)], p[(k, STEERING)]);
            p[(k, NORTH)] += north_heading * heading + north_steering * steering;
            p[(k, EAST)] += east_heading * heading + east_steering * steering;
            p[(k, HEADING)] += gain * steering;
        }
        let square = |value: T| value * value;
        let stray = noise.actuator_share * turned;
        p[(STEERING, STEERING)] += square(noise.actuator) * dt + square(stray);
        if self.is_moving() {
            let p = &mut self.covariance;
            p[(NORTH, NORTH)] += square(noise.slip) * dt;
            p[(EAST, EAST)] += square(noise.slip) * dt;
            p[(HEADING, HEADING)] += square(noise.heading) * dt;
            p[(HEADING_BIAS, HEADING_BIAS)] += square(noise.heading_bias) * dt;
            p[(STEERING_BIAS, STEERING_BIAS)] += square(noise.steering_bias) * dt;
        }
    }

    /// Updates the effectiveness from the `innovation` (rad) of the measured
    /// steering angle after a commanded movement of `asked` (rad).
    fn learn_effectiveness(&mut self, innovation: T, asked: T) {
        let noise = self.settings.noise.steering;
        // A small movement does not exceed the noise of two readings.
        if !(asked.abs() > T::lit(5.0) * noise) {
            return;
        }
        let spread = asked * asked * self.effectiveness_variance + T::lit(8.0) * noise * noise;
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
        let mut row = SVector::<T, STATES>::zeros();
        row[STEERING] = T::one();
        row[STEERING_BIAS] = T::one();
        let innovation = angle - self.state[STEERING] - self.state[STEERING_BIAS];
        self.learn_effectiveness(innovation, asked);
        let noise = self.settings.noise.steering;
        self.correct(&row, innovation, noise * noise);
    }

    fn see_gps(&mut self, seen: &Observation<T>) -> Update {
        let velocity = seen
            .velocity
            .map(|velocity| velocity.metres_per_second::<T>());
        let course = velocity.and_then(|(north, east)| self.see_speed(north, east, seen));
        if !self.heading_known {
            return match (seen.position, course) {
                (Some(position), Some((course, variance))) => {
                    self.start(position, course, variance, seen);
                    Update::Corrected
                }
                _ => Update::NoHeading,
            };
        }
        let fits = match seen.position {
            Some(position) => self.see_position(position, seen),
            None => false,
        };
        if seen.position.is_some() && !fits {
            self.outliers = self.outliers.saturating_add(1);
            if self.outliers >= PATIENCE {
                self.heading_known = false;
                self.outliers = 0;
                return match (seen.position, course) {
                    (Some(position), Some((course, variance))) => {
                        self.start(position, course, variance, seen);
                        Update::Restarted
                    }
                    _ => Update::NoHeading,
                };
            }
        } else if fits {
            self.outliers = 0;
        }
        if let Some((course, variance)) = course {
            self.see_course(course, variance, seen);
        }
        if fits || course.is_some() {
            Update::Corrected
        } else {
            Update::DeadReckoned
        }
    }

    /// Corrects the speed. Returns the antenna's course with its variance if the
    /// vehicle is fast enough to have one.
    fn see_speed(&mut self, north: T, east: T, seen: &Observation<T>) -> Option<(T, T)> {
        let size = (north * north + east * east).root();
        // The velocity vector does not tell forward from reverse; the drive
        // does.
        let backward = self.speed < T::zero();
        let lead = self.antenna_lead(self.state[STEERING]);
        let (_, cosine) = lead.sine_cosine();
        let forward = if backward { -size } else { size } * cosine;
        // On the inside of a turn the antenna is slower than the rear axle.
        let measured = forward * self.forward_ratio(self.state[STEERING]);
        let late = self.settings.gps_delay / (self.settings.drive_lag + self.settings.gps_delay);
        let expected = self.speed - (seen.speed - self.speed) * late;
        self.speed += (measured - expected) * T::lit(0.4);
        if size > self.settings.standstill && self.is_moving() {
            let course = if backward {
                (-east).angle_of(-north)
            } else {
                east.angle_of(north)
            };
            let deviation = self.settings.noise.velocity / size;
            Some((course, deviation * deviation))
        } else {
            None
        }
    }

    /// Angle by which the antenna's course leads the rear axle's in a turn.
    ///
    /// With the yaw rate w = V tan(angle) / L, the antenna moves forward at
    /// V - w right and sideways at w l1.
    fn antenna_lead(&self, steering_angle: T) -> T {
        let geometry = &self.settings.geometry;
        let tangent = steering_angle.tangent();
        let forward = geometry.wheelbase() - self.settings.antenna.right * tangent;
        (geometry.l1 * tangent).angle_of(forward)
    }

    /// Forward speed of the rear axle as a multiple of the antenna's.
    fn forward_ratio(&self, steering_angle: T) -> T {
        let length = self.settings.geometry.wheelbase();
        length / (length - self.settings.antenna.right * steering_angle.tangent())
    }

    /// Change of the rear axle's slip angle while the steering turns by `turned`
    /// (rad) about an angle with this `tangent`.
    fn slip_change(&self, tangent: T, turned: T) -> T {
        let geometry = &self.settings.geometry;
        let curvature = (T::one() + tangent * tangent) * turned / geometry.wheelbase();
        self.settings.rear_slip * self.speed * self.speed.abs() * curvature
    }

    /// The pose at the time when the GPS data were measured, computed back from
    /// the current state.
    fn delayed(&self, seen: &Observation<T>) -> Delayed<T> {
        let half = T::lit(0.5);
        let delay = self.settings.gps_delay;
        let way = self.speed * delay;
        let length = self.settings.geometry.wheelbase();
        let turned = seen.steering_rate * self.effectiveness * delay;
        let tangent = (self.state[STEERING] - turned * half).tangent();
        let gain = way * (T::one() + tangent * tangent) / length;
        let turn = way * tangent / length - self.slip_change(tangent, turned);
        let heading = self.state[HEADING] - turn;
        Delayed {
            way,
            gain,
            heading,
            middle: heading + turn * half,
            steering_angle: self.state[STEERING] - turned,
        }
    }

    fn start(&mut self, position: Position, course: T, variance: T, seen: &Observation<T>) {
        let then = self.delayed(seen);
        let turn = self.state[HEADING] - then.heading;
        let lead = self.antenna_lead(then.steering_angle);
        let heading = course - lead - self.state[HEADING_BIAS];
        let (sine, cosine) = heading.sine_cosine();
        let (sine_way, cosine_way) = (heading + turn * T::lit(0.5)).sine_cosine();
        let (north, east) = position.metres_from::<T>(self.origin);
        let l1 = self.settings.geometry.l1;
        let right = self.settings.antenna.right;
        self.state[NORTH] = north - (l1 * cosine - right * sine) + then.way * cosine_way;
        self.state[EAST] = east - (l1 * sine + right * cosine) + then.way * sine_way;
        self.state[HEADING] = wrap_angle(heading + turn);

        let noise = self.settings.noise;
        let p = &mut self.covariance;
        for k in 0..STATES {
            for axis in [NORTH, EAST, HEADING] {
                p[(axis, k)] = T::zero();
                p[(k, axis)] = T::zero();
            }
        }
        let bias = p[(HEADING_BIAS, HEADING_BIAS)];
        let heading_variance = variance + bias;
        let lever = l1.abs() + right.abs() + then.way.abs();
        let position_variance = noise.position * noise.position + lever * lever * heading_variance;
        p[(NORTH, NORTH)] = position_variance;
        p[(EAST, EAST)] = position_variance;
        p[(HEADING, HEADING)] = heading_variance;
        p[(HEADING, HEADING_BIAS)] = -bias;
        p[(HEADING_BIAS, HEADING)] = -bias;
        self.heading_known = true;
        self.outliers = 0;
    }

    /// Corrects the estimate by an antenna position. Returns false if the
    /// position is an outlier; the estimate is then unchanged.
    fn see_position(&mut self, position: Position, seen: &Observation<T>) -> bool {
        let (north, east) = position.metres_from::<T>(self.origin);
        let noise = self.settings.noise.position;
        let variance = noise * noise;
        let l1 = self.settings.geometry.l1;
        let right = self.settings.antenna.right;
        let gate = T::lit(GATE);

        let (rows, innovations) = {
            let then = self.delayed(seen);
            let (sine, cosine) = then.heading.sine_cosine();
            let lever_north = l1 * cosine - right * sine;
            let lever_east = l1 * sine + right * cosine;
            let (sine_way, cosine_way) = then.middle.sine_cosine();
            let half = T::lit(0.5);
            let mut rows = [SVector::<T, STATES>::zeros(), SVector::zeros()];
            let [row_north, row_east] = &mut rows;
            row_north[NORTH] = T::one();
            row_north[HEADING] = then.way * sine_way - lever_east;
            row_north[STEERING] = (lever_east - then.way * sine_way * half) * then.gain;
            row_east[EAST] = T::one();
            row_east[HEADING] = lever_north - then.way * cosine_way;
            row_east[STEERING] = (then.way * cosine_way * half - lever_north) * then.gain;
            let innovations = [
                north - (self.state[NORTH] - then.way * cosine_way + lever_north),
                east - (self.state[EAST] - then.way * sine_way + lever_east),
            ];
            (rows, innovations)
        };
        // Test both axes before using either.
        for (row, &innovation) in rows.iter().zip(&innovations) {
            let spread = row.dot(&(self.covariance * row)) + variance;
            if !(innovation * innovation <= gate * spread) {
                return false;
            }
        }
        let [row_north, row_east] = rows;
        let [innovation_north, innovation_east] = innovations;
        let before = self.state;
        self.correct(&row_north, innovation_north, variance);
        let mut change = self.state - before;
        // Near south the correction may have wrapped the heading.
        change[HEADING] = wrap_angle(change[HEADING]);
        let moved = row_east.dot(&change);
        self.correct(&row_east, innovation_east - moved, variance);
        true
    }

    fn see_course(&mut self, course: T, variance: T, seen: &Observation<T>) {
        let then = self.delayed(seen);
        let lead = self.antenna_lead(then.steering_angle);
        let expected = then.heading + lead + self.state[HEADING_BIAS];
        let geometry = &self.settings.geometry;
        let mut row = SVector::<T, STATES>::zeros();
        row[HEADING] = T::one();
        row[HEADING_BIAS] = T::one();
        row[STEERING] = geometry.l1 / geometry.wheelbase() - then.gain;
        let innovation = wrap_angle(course - expected);
        let spread = row.dot(&(self.covariance * row)) + variance;
        if innovation * innovation <= T::lit(GATE) * spread {
            self.correct(&row, innovation, variance);
        }
    }

    /// Measurement update for one scalar measurement. At standstill the biases
    /// are frozen by a Schmidt-Kalman update: their gain is zero, but their
    /// uncertainty still counts.
    fn correct(&mut self, row: &SVector<T, STATES>, innovation: T, variance: T) {
        let spread_by_row = self.covariance * row;
        let spread = row.dot(&spread_by_row) + variance;
        if !(spread > T::zero()) {
            return;
        }
        let inverse = T::one() / spread;
        let mut gain = spread_by_row * inverse;
        if self.is_moving() {
            self.state += gain * innovation;
            for i in 0..STATES {
                for j in 0..STATES {
                    self.covariance[(i, j)] -= spread_by_row[i] * spread_by_row[j] * inverse;
                }
            }
        } else {
            gain[HEADING_BIAS] = T::zero();
            gain[STEERING_BIAS] = T::zero();
            self.state += gain * innovation;
            for i in 0..STATES {
                for j in 0..STATES {
                    self.covariance[(i, j)] += gain[i] * gain[j] * spread
                        - (gain[i] * spread_by_row[j] + spread_by_row[i] * gain[j]);
                }
            }
        }
        self.state[HEADING] = wrap_angle(self.state[HEADING]);
        self.state[HEADING_BIAS] = clamp_symmetric(self.state[HEADING_BIAS], T::lit(0.35));
        self.state[STEERING_BIAS] = clamp_symmetric(self.state[STEERING_BIAS], T::lit(0.35));
    }
}

/// The pose at the time when the GPS data were measured.
struct Delayed<T> {
    /// Distance driven since then, m.
    way: T,
    /// Derivative of the turn since then with respect to the steering angle.
    gain: T,
    /// Heading then, rad.
    heading: T,
    /// Heading halfway between then and now, rad.
    middle: T,
    /// Steering angle then, rad.
    steering_angle: T,
}
