//! Derives every setting of the controller from the description of a vehicle.
//!
//! A [`Description`] holds what can be measured or read in data sheets:
//! lengths, limits, speeds and noise. [`Settings::for_vehicle`] derives all
//! settings from it in double precision. It solves Riccati equations, so it
//! runs on the host: a build script writes the result as a constant with
//! [`source`], and the target carries only numbers.
//!
//! ```
//! use control::controller::Settings;
//! use control::feedback::Limits;
//! use control::model::{Antenna, Geometry};
//! use control::vehicle::{Description, Misalignment, Sensors, degrees, source};
//!
//! let vehicle = Description {
//!     geometry: Geometry { l1: 0.9, l2: 1.5 },
//!     antenna: Antenna { right: 0.2, height: 2.6 },
//!     limits: Limits {
//!         steering_angle: degrees(35.0),
//!         steering_rate: degrees(20.0),
//!         speed: 4.0,
//!     },
//!     cruise: 3.0,
//!     period: 0.1,
//!     sensors: Sensors {
//!         position: 0.01,
//!         velocity: 0.03,
//!         steering: degrees(0.1),
//!         age: 0.055,
//!         interval: 0.1,
//!     },
//!     drive_lag: 0.5,
//!     acceleration: 1.0,
//!     cornering: 5.0,
//!     misalignment: Misalignment {
//!         heading: degrees(1.0),
//!         steering: degrees(2.0),
//!     },
//!     weights: None,
//! };
//! let settings = Settings::<f32>::for_vehicle(&vehicle)?;
//! let text = format!("const SETTINGS: Settings<f32> = {};", source(&settings));
//! # assert!(text.contains("l1: 0.9"));
//! # Ok::<(), control::vehicle::Refusal>(())
//! ```

use crate::controller::{Settings, SteeringGains};
use crate::design::{DesignError, SteeringWeights, steering_gains};
use crate::estimator::{EstimatorSettings, Noise};
use crate::feedback::Limits;
use crate::guidance::{Brake, GuidanceSettings};
use crate::habits::Expected;
use crate::hold::HoldSettings;
use crate::model::{Antenna, Geometry};
use crate::safety::Slew;
use crate::scalar::Scalar;

/// Standard gravity, m/s^2.
const GRAVITY: f64 = 9.81;

/// `value` degrees in radians.
#[must_use]
pub const fn degrees(value: f64) -> f64 {
    value * core::f64::consts::PI / 180.0
}

/// The facts of a vehicle from which all settings are derived.
///
/// The ranges in brackets are those that [`Description::check`] accepts. A
/// closed-loop test with random vehicles covers them (`tests/vehicles.rs`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// Axles and the antenna's place along the vehicle. The wheelbase is
    /// L1 + L2 (0.4 to 4 m); the antenna is at most 0.4 wheelbases behind
    /// and two ahead of the rear axle.
    pub geometry: Geometry<f64>,
    /// The antenna's place beside the centre line (to either side, at most half
    /// the radius of the tightest turn) and its height (0 to 5 m).
    pub antenna: Antenna<f64>,
    /// Mechanical limits: steering angle (15 to 45 degrees), steering rate (10
    /// to 60 degrees/s), top speed (`cruise` to 10 m/s).
    pub limits: Limits<f64>,
    /// Speed of an autonomous run, m/s (0.3 to 3; to 2 if more than 0.2 s are
    /// between two positions).
    pub cruise: f64,
    /// Period of the control step, s (0.05 to 0.1).
    pub period: f64,
    /// Noise and age of the measurements.
    pub sensors: Sensors,
    /// Time constant from commanded to real speed, s (0.05 to 1).
    pub drive_lag: f64,
    /// Largest acceleration of the drive, m/s^2 (0.1 to 20). No command asks for more, so a drive that starts is not
    /// taken for one that is slow. Slowing down is not limited.
    pub acceleration: f64,
    /// Cornering coefficient of the tyres, 1/rad (2 to 20): lateral force as a
    /// share of the load for each radian of slip (J. Y. Wong, Theory of Ground
    /// Vehicles, 1.4).
    pub cornering: f64,
    /// Expected alignment errors of the sensors.
    pub misalignment: Misalignment,
    /// Weights of the regulators. `None` takes [`Weights::for_vehicle`].
    pub weights: Option<Weights>,
}

/// Standard deviations and age of measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sensors {
    /// Position, per axis, m (0.002 to 0.03).
    pub position: f64,
    /// Velocity, per axis, m/s (0.005 to 0.04).
    pub velocity: f64,
    /// Steering angle, rad (0.01 to 0.2 degrees).
    pub steering: f64,
    /// Age of position and velocity when the control step uses them, s (0 to
    /// 0.25).
    pub age: f64,
    /// Time from one position and velocity to the next, s (0.05 to 1). Between
    /// them the law drives by dead reckoning.
    pub interval: f64,
}

/// Expected size of constant angle errors after mounting and calibration. The
/// estimator finds their true values while the vehicle drives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Misalignment {
    /// Error of the measured course, rad (0.1 to 5 degrees).
    pub heading: f64,
    /// Error of the measured steering angle, rad (0.1 to 5 degrees).
    pub steering: f64,
}

/// Weights of the two regulators of [`crate::guidance`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Weights of the firm regulator, which brings the vehicle onto the path.
    pub firm: SteeringWeights<f64>,
    /// Weights of the gentle regulator, which keeps it there.
    pub gentle: SteeringWeights<f64>,
}

/// A number of a description.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// L1 + L2, m.
    Wheelbase,
    /// L1, m.
    AntennaAhead,
    /// [`Antenna::right`], m.
    AntennaRight,
    /// [`Antenna::height`], m.
    AntennaHeight,
    /// [`Limits::steering_angle`], rad.
    SteeringAngle,
    /// [`Limits::steering_rate`], rad/s.
    SteeringRate,
    /// [`Description::cruise`], m/s.
    Cruise,
    /// [`Limits::speed`], m/s.
    TopSpeed,
    /// [`Description::period`], s.
    Period,
    /// [`Sensors::position`], m.
    PositionNoise,
    /// [`Sensors::velocity`], m/s.
    VelocityNoise,
    /// [`Sensors::steering`], rad.
    SteeringNoise,
    /// [`Sensors::age`], s.
    Age,
    /// [`Sensors::interval`], s.
    Interval,
    /// [`Description::drive_lag`], s.
    DriveLag,
    /// [`Description::acceleration`], m/s^2.
    Acceleration,
    /// [`Description::cornering`], 1/rad.
    Cornering,
    /// [`Misalignment::heading`], rad.
    HeadingMisalignment,
    /// [`Misalignment::steering`], rad.
    SteeringMisalignment,
}

impl Quantity {
    /// Name, unit for display, and number of such units in the SI unit.
    const fn words(self) -> (&'static str, &'static str, f64) {
        const DEGREES: f64 = 180.0 / core::f64::consts::PI;
        match self {
            Self::Wheelbase => ("wheelbase L1 + L2", "m", 1.0),
            Self::AntennaAhead => ("antenna's distance L1 ahead of the rear axle", "m", 1.0),
            Self::AntennaRight => ("antenna's distance right of the centre line", "m", 1.0),
            Self::AntennaHeight => ("antenna's height", "m", 1.0),
            Self::SteeringAngle => ("steering angle limit", "degrees", DEGREES),
            Self::SteeringRate => ("steering rate limit", "degrees/s", DEGREES),
            Self::Cruise => ("cruise speed", "m/s", 1.0),
            Self::TopSpeed => ("top speed", "m/s", 1.0),
            Self::Period => ("control period", "s", 1.0),
            Self::PositionNoise => ("position noise", "m", 1.0),
            Self::VelocityNoise => ("velocity noise", "m/s", 1.0),
            Self::SteeringNoise => ("steering angle noise", "degrees", DEGREES),
            Self::Age => ("receiver's age", "s", 1.0),
            Self::Interval => ("time between two positions", "s", 1.0),
            Self::DriveLag => ("drive's time constant", "s", 1.0),
            Self::Acceleration => ("drive's acceleration", "m/s^2", 1.0),
            Self::Cornering => ("cornering coefficient", "1/rad", 1.0),
            Self::HeadingMisalignment => ("heading misalignment", "degrees", DEGREES),
            Self::SteeringMisalignment => ("steering misalignment", "degrees", DEGREES),
        }
    }
}

/// Why a description is refused.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Refusal {
    /// A number is outside the accepted range. All three are in the SI unit.
    Number {
        /// The number.
        what: Quantity,
        /// Its value.
        value: f64,
        /// The least that is accepted.
        least: f64,
        /// The most that is accepted.
        most: f64,
    },
    /// No regulator exists for the given weights.
    Design(DesignError<f64>),
}

impl core::fmt::Display for Refusal {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Number {
                what,
                value,
                least,
                most,
            } => {
                let (name, unit, factor) = what.words();
                // Rounded to six decimal places, without trailing zeros.
                let shown = |value: f64| libm::round(value * factor * 1e6) / 1e6;
                write!(
                    f,
                    "the {name} is {} {unit}: {} to {} {unit} is accepted",
                    shown(*value),
                    shown(*least),
                    shown(*most)
                )
            }
            Self::Design(error) => write!(f, "the regulators' weights: {error}"),
        }
    }
}

impl core::error::Error for Refusal {}

impl Description {
    /// Checks that every number is within the range for which the controller is
    /// tested.
    ///
    /// # Errors
    /// [`Refusal`] names the number and the accepted range.
    pub fn check(&self) -> Result<(), Refusal> {
        let accept = |what, value: f64, least: f64, most: f64| {
            // The slack of a few parts in 10^10 allows for rounding errors of
            // unit conversions.
            let slack = 5e-10 * (least.abs() + most.abs());
            if value >= least - slack && value <= most + slack {
                Ok(())
            } else {
                Err(Refusal::Number {
                    what,
                    value,
                    least,
                    most,
                })
            }
        };
        let length = self.geometry.wheelbase();
        let limits = &self.limits;
        let sensors = &self.sensors;
        accept(Quantity::Wheelbase, length, 0.4, 4.0)?;
        accept(
            Quantity::AntennaAhead,
            self.geometry.l1,
            -0.4 * length,
            2.0 * length,
        )?;
        accept(
            Quantity::SteeringAngle,
            limits.steering_angle,
            degrees(15.0),
            degrees(45.0),
        )?;
        accept(
            Quantity::SteeringRate,
            limits.steering_rate,
            degrees(10.0),
            degrees(60.0),
        )?;
        let beside = 0.5 * length / libm::tan(limits.steering_angle);
        accept(Quantity::AntennaRight, self.antenna.right, -beside, beside)?;
        accept(Quantity::AntennaHeight, self.antenna.height, 0.0, 5.0)?;
        // Farther apart, the positions do not hold a fast vehicle on its path.
        let fastest = if sensors.interval > 0.2 { 2.0 } else { 3.0 };
        accept(Quantity::Cruise, self.cruise, 0.3, fastest)?;
        accept(Quantity::TopSpeed, limits.speed, self.cruise, 10.0)?;
        accept(Quantity::Period, self.period, 0.05, 0.1)?;
        accept(Quantity::PositionNoise, sensors.position, 0.002, 0.03)?;
        accept(Quantity::VelocityNoise, sensors.velocity, 0.005, 0.04)?;
        accept(
            Quantity::SteeringNoise,
            sensors.steering,
            degrees(0.01),
            degrees(0.2),
        )?;
        accept(Quantity::Age, sensors.age, 0.0, 0.25)?;
        accept(Quantity::Interval, sensors.interval, 0.05, 1.0)?;
        accept(Quantity::DriveLag, self.drive_lag, 0.05, 1.0)?;
        accept(Quantity::Acceleration, self.acceleration, 0.1, 20.0)?;
        accept(Quantity::Cornering, self.cornering, 2.0, 20.0)?;
        let (least, most) = (degrees(0.1), degrees(5.0));
        accept(
            Quantity::HeadingMisalignment,
            self.misalignment.heading,
            least,
            most,
        )?;
        accept(
            Quantity::SteeringMisalignment,
            self.misalignment.steering,
            least,
            most,
        )
    }

    /// Largest steering angle that the law uses, rad: the mechanical limit, or
    /// less for a vehicle that is fast for its steering.
    ///
    /// Two conditions bound it. First, the distance that the vehicle drives while
    /// the steering travels to a swing's angle, times the curvature of the swing,
    /// is at most [`SLOWNESS`]: beyond that the vehicle's track no longer
    /// resembles the arcs that the law plans. Second, the lateral acceleration in
    /// a swing is at most [`LATERAL`]: up to there the slip of the tyres grows
    /// linearly with the force, as the estimator assumes.
    fn planned_angle(&self) -> f64 {
        let length = self.geometry.wheelbase();
        let sound = |angle: f64| {
            let swing = SWING * angle;
            let curvature = libm::tan(swing) / length;
            let way = self.cruise * swing / self.limits.steering_rate;
            way * curvature <= SLOWNESS && self.cruise * self.cruise * curvature <= LATERAL
        };
        let (mut least, mut most) = (0.0, self.limits.steering_angle);
        if sound(most) {
            return most;
        }
        // 50 halvings reach the precision of the numbers.
        for _ in 0..50 {
            let middle = 0.5 * (least + most);
            if sound(middle) {
                least = middle;
            } else {
                most = middle;
            }
        }
        least
    }

    fn guidance(&self) -> GuidanceSettings<f64> {
        let angle = self.planned_angle();
        GuidanceSettings {
            wheelbase: self.geometry.wheelbase(),
            limits: Limits {
                steering_angle: angle,
                ..self.limits
            },
            swing: SWING,
            // A steering angle that grows at a constant rate turns the vehicle
            // as much as the full angle from half of the time on. To that half
            // comes the dead time of the sampled loop: on average half a period
            // until a command acts, and about a third of one because the
            // steering approaches its target exponentially.
            lead: SWING * angle / self.limits.steering_rate / 2.0 + 0.85 * self.period,
            foresight: 1.0,
            brake: Brake {
                regulating: 1.0,
                approaching: 0.73,
            },
            // While a deviation may be noise, the gentle regulator steers: up
            // to 1.55 standard deviations of a position, and 1.43 of a course.
            near: 1.55 * self.sensors.position,
            aligned: 43.0 / 30.0 * self.sensors.velocity / self.cruise,
            // The integral removes the small constant error that the gentle
            // regulator leaves. A larger error belongs to an approach and must
            // not be integrated.
            integral_limit: 5.0 * self.sensors.position,
            integral_zone: 7.0 * self.sensors.position,
        }
    }

    fn noise(&self) -> Noise<f64> {
        let way = libm::sqrt(self.cruise);
        Noise {
            position: self.sensors.position,
            velocity: self.sensors.velocity,
            steering: self.sensors.steering,
            // Slip and uneven ground act over the distance driven: 2 mm and 0.1
            // degrees over the first metre. A random walk grows with the root
            // of the distance, so per root of time with the root of the speed.
            slip: 0.002 * way,
            heading: degrees(0.1) * way,
            // Play and dead band of the linkage: 1.2 % of the travel in a
            // second. The calibration of the rate is good to a fifth.
            actuator: 0.012 * self.limits.steering_rate,
            actuator_share: 0.2,
            // A misalignment drifts by a hundredth of its size in a second.
            heading_bias: 0.01 * self.misalignment.heading,
            steering_bias: 0.01 * self.misalignment.steering,
            first_heading_bias: self.misalignment.heading,
            first_steering_bias: self.misalignment.steering,
        }
    }

    /// How far wheelbase and age may be from this description.
    fn expected(&self) -> Expected<f64> {
        // With an antenna far from the rear axle a steering bias looks like a wrong wheelbase: of random vehicles
        // beyond these limits one in a hundred loses its line when both are estimated, within them none of those of `tests/bounds.rs`.
        let length = self.geometry.wheelbase();
        let ahead = self.geometry.l1 / length;
        let beside = self.antenna.right / length;
        if (-0.25..=0.5).contains(&ahead) && beside.abs() <= 0.1 {
            Expected {
                curvature: 0.15,
                age: 0.03,
            }
        } else {
            Expected {
                curvature: 0.0,
                age: 0.0,
            }
        }
    }

    /// When the steering moves under the `gentle` regulator.
    fn hold(&self, gentle: &SteeringWeights<f64>) -> HoldSettings<f64> {
        // A steering angle error that the hold ignores moves the vehicle until
        // the regulator reacts. With the natural frequency w of the loop that
        // takes about 1 / w and gives V^2 / (L w^2) metres per radian. The error
        // may cost at most 1.5 standard deviations of a position.
        let chain = self.cruise * self.cruise / self.geometry.wheelbase();
        let gain = libm::sqrt(gentle.cross_track / gentle.steering_rate);
        let natural = libm::cbrt(gain * chain);
        let largest = 1.5 * self.sensors.position * natural * natural / chain;
        // Noise alone must not begin a movement: the threshold is three standard
        // deviations. A movement ends at two.
        let unit = self.sensors.steering.min(largest / 3.0);
        HoldSettings {
            begin: 3.0 * unit,
            end: 2.0 * unit,
            // A slower movement would not exceed the noise within a period.
            slowest: self.sensors.steering / self.period,
        }
    }

    /// Gains at the rear axle for `weights`.
    fn gains(&self, weights: &SteeringWeights<f64>) -> Result<SteeringGains<f64>, Refusal> {
        let rear = Geometry {
            l1: 0.0,
            l2: self.geometry.wheelbase(),
        };
        // The nine rows reach from standstill to top speed.
        let spacing = self.limits.speed / 8.0;
        let mut schedule = steering_gains(&rear, weights, self.period, spacing, spacing)
            .map_err(Refusal::Design)?;
        for gain in schedule.gains.iter_mut().flatten() {
            *gain = nine_digits(*gain);
        }
        Ok(schedule)
    }

    fn settings(&self) -> Result<Settings<f64>, Refusal> {
        self.check()?;
        let weights = match self.weights {
            Some(weights) => weights,
            None => Weights::for_vehicle(self),
        };
        Ok(Settings {
            estimator: EstimatorSettings {
                geometry: self.geometry,
                antenna: self.antenna,
                noise: self.noise(),
                gps_delay: self.sensors.age,
                drive_lag: self.drive_lag,
                // The slip angle is the lateral force, as a share of the load,
                // divided by the cornering coefficient. That share is the
                // lateral acceleration divided by gravity.
                rear_slip: 1.0 / self.cornering / GRAVITY,
                standstill: standstill(self.sensors.velocity),
                expected: self.expected(),
            },
            limits: self.limits,
            slew: Slew {
                // From full rate in one direction to the other in a period.
                steering: 2.0 * self.limits.steering_rate / self.period,
                speed: self.acceleration,
            },
            firm: self.gains(&weights.firm)?,
            gentle: self.gains(&weights.gentle)?,
            guidance: self.guidance(),
            hold: self.hold(&weights.gentle),
            cruise: self.cruise,
            // At thirty times the noise of a measured position, dead reckoning
            // has become useless.
            lost: 30.0 * self.sensors.position,
            // A second by dead reckoning, or two positions that a slow receiver misses. The deviation of the place
            // may end it sooner.
            stale_after: (1.0 + 2.0 * self.period).max(2.5 * self.sensors.interval),
            // A point behind the rear axle swings out when the vehicle steers.
            // If the antenna is there, the axle itself is held on the path.
            controlled_point: self.geometry.l1.max(0.0),
        })
    }
}

/// The speed up to which a velocity tells no heading, m/s, if its components have a standard deviation of `noise` (m/s):
/// of a slower vehicle, the noise turns the velocity by more than 0.15 rad.
#[must_use]
pub fn standstill(noise: f64) -> f64 {
    noise / 0.15
}

/// `value` rounded to nine significant digits, enough for single precision. So
/// the last bits of an iterative solution do not reach an image.
fn nine_digits(value: f64) -> f64 {
    if value == 0.0 {
        return value;
    }
    let scale = libm::pow(10.0, 8.0 - libm::floor(libm::log10(value.abs())));
    libm::round(value * scale) / scale
}

/// Share of [`Description::planned_angle`] that a swing onto the path uses.
const SWING: f64 = 0.80;
/// Largest product of the distance driven while the steering travels to a
/// swing's angle, and the swing's curvature, rad.
const SLOWNESS: f64 = 0.5;
/// Largest lateral acceleration of a swing, m/s^2: a quarter of gravity.
const LATERAL: f64 = 0.25 * GRAVITY;

/// The tuning of a regulator in dimensionless numbers, valid for any vehicle.
struct Shape {
    /// Cross-track error that weighs as much as the full steering rate, in
    /// standard deviations of a position.
    error: f64,
    /// Largest product of the loop's natural frequency and its delay (control
    /// period plus age of the data), rad.
    fastest: f64,
    /// Weight of the integral relative to that of the cross-track error, both in
    /// the units of [`Self::weights`].
    integral: f64,
    /// The same of the heading.
    heading: f64,
    /// The same of the steering angle.
    steering_angle: f64,
}

/// The firm regulator. A search over simulated runs (1 m off, and 5 m off facing
/// 45, 90 and 135 degrees away; unloaded and loaded) found these numbers to give
/// the shortest settling time.
const FIRM: Shape = Shape {
    error: 4.76,
    fastest: 0.4,
    integral: 0.0173,
    heading: 1.23,
    steering_angle: 0.0319,
};

/// The gentle regulator: the same search, for few steering movements on the path.
const GENTLE: Shape = Shape {
    error: 63.6,
    fastest: 0.3,
    integral: 0.0277,
    heading: 1.99,
    steering_angle: 4.58,
};

impl Shape {
    /// The weights for a vehicle.
    ///
    /// The steering model is a chain of three integrators with the total gain
    /// V^2 / L. Let a cross-track error y weigh as much as the full steering rate
    /// r, and let nothing else have weight. Then the optimal poles lie on a circle
    /// of radius w, the cube root of (r / y) (V^2 / L) (Butterworth pattern).
    ///
    /// Measured in units of 1 / w for time, y for the cross-track error, y w / V
    /// for the heading and y w^2 L / V^2 for the steering angle, the closed loop
    /// no longer depends on V, L, r and y. So weights in these units are the same
    /// for every vehicle.
    fn weights(&self, vehicle: &Description) -> SteeringWeights<f64> {
        let (speed, length) = (vehicle.cruise, vehicle.geometry.wheelbase());
        let chain = speed * speed / length;
        let asked = vehicle.limits.steering_rate / (self.error * vehicle.sensors.position);
        // The model has no delay, so the loop must be slow against the delay.
        let fastest = self.fastest / (vehicle.period + vehicle.sensors.age);
        let natural = libm::cbrt(asked * chain);
        let natural = natural.min(fastest);
        let gain = natural * natural * natural / chain;
        let cross_track = gain * gain;
        let square = |value: f64| value * value;
        SteeringWeights {
            integral: self.integral * cross_track * square(natural),
            cross_track,
            heading: self.heading * cross_track * square(speed / natural),
            steering_angle: self.steering_angle * cross_track * square(chain / square(natural)),
            steering_rate: 1.0,
        }
    }
}

impl Weights {
    /// Weights for a vehicle at its cruise speed.
    ///
    /// A cross-track error of 4.8 standard deviations of a position weighs as much
    /// as the full steering rate in the firm regulator, and one of 64 in the
    /// gentle one. Both loops are slow against their delay.
    #[must_use]
    pub fn for_vehicle(vehicle: &Description) -> Self {
        Self {
            firm: FIRM.weights(vehicle),
            gentle: GENTLE.weights(vehicle),
        }
    }
}

impl<T: Scalar> Settings<T> {
    /// Every setting of the controller of `vehicle`, derived in double
    /// precision.
    ///
    /// # Errors
    /// [`Refusal`] names the number that is out of range, and the accepted range.
    pub fn for_vehicle(vehicle: &Description) -> Result<Self, Refusal> {
        vehicle.settings().map(|settings| settings.cast())
    }
}

/// `settings` as a Rust block expression, for the output of a build script. The
/// block imports the types that it names, and restores each number exactly.
#[must_use]
pub fn source(settings: &Settings<f32>) -> impl core::fmt::Display + '_ {
    Source(settings)
}

/// Displays settings by their derived `Debug`, which is a valid Rust expression.
struct Source<'a>(&'a Settings<f32>);

impl core::fmt::Display for Source<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(
            "{\n\
             use ::control::{\n\
             controller::Settings, estimator::{EstimatorSettings, Noise}, feedback::Limits,\n\
             guidance::{Brake, GuidanceSettings}, habits::Expected, hold::HoldSettings,\n\
             model::{Antenna, Geometry}, safety::Slew, schedule::GainSchedule,\n\
             };\n",
        )?;
        write!(f, "{:#?}\n}}", self.0)
    }
}
