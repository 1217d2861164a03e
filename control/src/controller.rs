//! The controller: one step turns measurements into actuator commands.
//!
//! A step runs the estimator, locates the vehicle on the path, and applies
//! steering law, hold and safety filter, in this order. Its loops have fixed
//! bounds and it cannot panic.

use crate::estimator::{
    Estimate, Estimator, EstimatorError, EstimatorSettings, Noise, Observation, Update,
};
use crate::feedback::{LimitError, Limits};
use crate::guidance::{Brake, Deviation, Guidance, GuidanceError, GuidanceSettings, blended};
use crate::habits::Expected;
use crate::hold::{Hold, HoldSettings};
use crate::line::Line;
use crate::model::{Antenna, Geometry};
use crate::path::{Path, Place, Progress};
use crate::position::{Position, Velocity};
use crate::route::{Bend, Route};
use crate::safety::{Command, SafetyFilter, Slew, Verdict};
use crate::scalar::{Scalar, wrap_angle};
use crate::schedule::GainSchedule;
use crate::tilt::Tilt;

/// Steering gains at nine speeds; each row is a [`crate::guidance::Gains`].
pub type SteeringGains<T> = GainSchedule<T, 4, 9>;

/// All settings of the controller.
/// `Settings::for_vehicle` derives it from a [`crate::vehicle::Description`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings<T> {
    /// Settings of the estimator: geometry, sensors and noise.
    pub estimator: EstimatorSettings<T>,
    /// Actuator limits.
    pub limits: Limits<T>,
    /// How fast commands may change.
    pub slew: Slew<T>,
    /// Gains of the firm regulator, which brings the vehicle onto the path.
    pub firm: SteeringGains<T>,
    /// Gains of the gentle regulator, which keeps it there.
    pub gentle: SteeringGains<T>,
    /// Settings of the steering law.
    pub guidance: GuidanceSettings<T>,
    /// Settings of the hold, which avoids small steering movements.
    pub hold: HoldSettings<T>,
    /// Speed of an autonomous run, m/s, not negative.
    pub cruise: T,
    /// Standard deviation of the estimated position above which the law does
    /// not drive, m.
    pub lost: T,
    /// Age of the last position above which the law does not drive, s.
    pub stale_after: T,
    /// The point of the centre line that is held on the path, as its distance
    /// ahead of the rear axle, m. L1 holds the antenna's place, a negative value
    /// a hitch (thesis Figure 7.2).
    pub controlled_point: T,
}

/// Which setting is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingsError {
    /// A setting of the estimator.
    Estimator(EstimatorError),
    /// A limit.
    Limit(LimitError),
    /// A setting of the steering law.
    Guidance(GuidanceError),
    /// A gain is not finite, a gain on cross-track error, heading or steering
    /// angle is not positive, a gain on the integral is negative, or the speed
    /// spacing of a schedule is not positive.
    Gains,
    /// The hold's angles are not positive, `begin` is not above `end`, or the
    /// slowest rate is negative.
    Hold,
    /// A slew rate, an age, a deviation or the cruise speed is not finite or not
    /// positive.
    Number,
}

impl core::fmt::Display for SettingsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Estimator(error) => error.fmt(f),
            Self::Limit(error) => error.fmt(f),
            Self::Guidance(error) => error.fmt(f),
            Self::Gains => {
                f.write_str("a steering gain or the speed spacing of a schedule is out of range")
            }
            Self::Hold => f.write_str("the hold's angles or its slowest rate are out of range"),
            Self::Number => f.write_str("a slew rate, age, deviation or speed is out of range"),
        }
    }
}

impl core::error::Error for SettingsError {}

impl<T: Scalar> Settings<T> {
    /// The same settings in another precision.
    #[must_use]
    pub fn cast<U: Scalar>(&self) -> Settings<U> {
        let lit = |value: T| U::lit(value.as_f64());
        let limits = |limits: &Limits<T>| Limits {
            steering_angle: lit(limits.steering_angle),
            steering_rate: lit(limits.steering_rate),
            speed: lit(limits.speed),
        };
        let (estimator, noise) = (&self.estimator, &self.estimator.noise);
        let guidance = &self.guidance;
        Settings {
            estimator: EstimatorSettings {
                geometry: Geometry {
                    l1: lit(estimator.geometry.l1),
                    l2: lit(estimator.geometry.l2),
                },
                antenna: Antenna {
                    right: lit(estimator.antenna.right),
                    height: lit(estimator.antenna.height),
                },
                noise: Noise {
                    position: lit(noise.position),
                    velocity: lit(noise.velocity),
                    steering: lit(noise.steering),
                    slip: lit(noise.slip),
                    heading: lit(noise.heading),
                    actuator: lit(noise.actuator),
                    actuator_share: lit(noise.actuator_share),
                    heading_bias: lit(noise.heading_bias),
                    steering_bias: lit(noise.steering_bias),
                    first_heading_bias: lit(noise.first_heading_bias),
                    first_steering_bias: lit(noise.first_steering_bias),
                },
                gps_delay: lit(estimator.gps_delay),
                drive_lag: lit(estimator.drive_lag),
                rear_slip: lit(estimator.rear_slip),
                standstill: lit(estimator.standstill),
                expected: Expected {
                    curvature: lit(estimator.expected.curvature),
                    age: lit(estimator.expected.age),
                },
            },
            limits: limits(&self.limits),
            slew: Slew {
                steering: lit(self.slew.steering),
                speed: lit(self.slew.speed),
            },
            firm: self.firm.cast(),
            gentle: self.gentle.cast(),
            guidance: GuidanceSettings {
                wheelbase: lit(guidance.wheelbase),
                limits: limits(&guidance.limits),
                swing: lit(guidance.swing),
                lead: lit(guidance.lead),
                foresight: lit(guidance.foresight),
                brake: Brake {
                    regulating: lit(guidance.brake.regulating),
                    approaching: lit(guidance.brake.approaching),
                },
                near: lit(guidance.near),
                aligned: lit(guidance.aligned),
                integral_limit: lit(guidance.integral_limit),
                integral_zone: lit(guidance.integral_zone),
            },
            hold: HoldSettings {
                begin: lit(self.hold.begin),
                end: lit(self.hold.end),
                slowest: lit(self.hold.slowest),
            },
            cruise: lit(self.cruise),
            lost: lit(self.lost),
            stale_after: lit(self.stale_after),
            controlled_point: lit(self.controlled_point),
        }
    }

    /// Checks that every setting is usable.
    ///
    /// # Errors
    /// [`SettingsError`] names the group at fault.
    pub fn check(&self) -> Result<(), SettingsError> {
        self.estimator.check().map_err(SettingsError::Estimator)?;
        self.limits.check().map_err(SettingsError::Limit)?;
        self.guidance.check().map_err(SettingsError::Guidance)?;
        let positive = |value: T| value.is_finite() && value > T::zero();
        let usable = |schedule: &SteeringGains<T>| {
            schedule.is_usable()
                && schedule.gains.iter().all(|[integral, others @ ..]| {
                    *integral >= T::zero() && others.iter().all(|&gain| gain > T::zero())
                })
        };
        if !(usable(&self.firm) && usable(&self.gentle)) {
            return Err(SettingsError::Gains);
        }
        let hold = &self.hold;
        let hold_usable = positive(hold.begin)
            && positive(hold.end)
            && hold.begin > hold.end
            && hold.slowest.is_finite()
            && hold.slowest >= T::zero();
        if !hold_usable {
            return Err(SettingsError::Hold);
        }
        let numbers = positive(self.slew.speed)
            && positive(self.slew.steering)
            && positive(self.stale_after)
            && positive(self.lost)
            && self.controlled_point.is_finite()
            && self.cruise.is_finite()
            && self.cruise >= T::zero();
        if numbers {
            Ok(())
        } else {
            Err(SettingsError::Number)
        }
    }
}

/// Inputs of a control step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample<T> {
    /// The antenna's position, if one with an RTK-fixed solution arrived in this
    /// cycle.
    pub position: Option<Position>,
    /// The antenna's velocity, if one arrived in this cycle.
    pub velocity: Option<Velocity>,
    /// The steering angle measured by the potentiometer, rad, if a plausible
    /// reading arrived in this cycle.
    pub steering_angle: Option<T>,
    /// The command that has been applied to the actuators since the last step,
    /// from the law or the joystick.
    pub applied: Command<T>,
    /// True if the law commands the actuators (autonomous run).
    pub engaged: bool,
    /// Time since the last step, s.
    pub dt: T,
}

/// State of the vehicle relative to its path. The default is at rest at the
/// path's beginning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracking<T> {
    /// The segment of the path being followed, counted from zero.
    pub segment: usize,
    /// Distance along it, m.
    pub along: T,
    /// Cross-track error of the controlled point, m, positive to the right of
    /// the path, seen in the direction of travel.
    pub cross_track: T,
    /// Heading, rad clockwise from north, in (-pi, pi].
    pub heading: T,
    /// Direction of travel relative to the path, rad, in (-pi, pi]: in reverse, that of the
    /// vehicle's rear.
    pub heading_error: T,
    /// Steering angle, corrected by its estimated bias, rad, positive to the
    /// right.
    pub steering_angle: T,
    /// Speed of the rear axle, m/s, negative in reverse.
    pub speed: T,
}

impl<T: Scalar> Default for Tracking<T> {
    fn default() -> Self {
        Self {
            segment: 0,
            along: T::zero(),
            cross_track: T::zero(),
            heading: T::zero(),
            heading_error: T::zero(),
            steering_angle: T::zero(),
            speed: T::zero(),
        }
    }
}

/// Results of a control step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Outcome<T> {
    /// Output of the law itself, before the safety filter and its limits. `None` unless the law
    /// commands the actuators, or if it does not know where the vehicle is.
    pub proposed: Option<Command<T>>,
    /// Command for the actuators. Standstill unless the law commands them.
    pub command: Command<T>,
    /// State relative to the path, for displays and logs; from dead reckoning if
    /// nothing new arrived.
    pub tracking: Tracking<T>,
    /// True once the end of the path has been passed. The law then commands
    /// standstill.
    pub finished: bool,
    /// How the estimator used the sample.
    pub update: Update,
    /// What the safety filter did to the command.
    pub verdict: Verdict,
}

/// Speed below which a vehicle whose route lets it wait counts as standing, m/s.
const STANDING: f64 = 0.05;

/// Largest turn (rad) in a bend while the steering travels to its angle. It leaves the vehicle within a decimetre of the
/// arc; a swing may take [`crate::vehicle`]'s larger one.
const SLOWNESS: f64 = 0.35;
/// Largest lateral acceleration in a bend, m/s^2.
const LATERAL: f64 = 2.0;

/// The controller and its state. R is the kind of route that it follows.
#[derive(Clone, Copy, Debug)]
pub struct Controller<T, R = Path<T>> {
    settings: Settings<T>,
    route: R,
    progress: Progress<T>,
    estimator: Estimator<T>,
    guidance: Guidance<T>,
    hold: Hold,
    safety: SafetyFilter<T>,
    position_age: T,
    /// Sine and cosine of the crab angle.
    crab: (T, T),
    /// True if the law drives backwards.
    reverse: bool,
}

impl<T: Scalar> Controller<T> {
    /// A controller that follows `line` and stops the vehicle at its end. It can follow paths of
    /// several segments later; [`Self::following`] a line needs less time and memory.
    ///
    /// # Errors
    /// [`SettingsError`] names the setting that is unusable.
    pub fn new(settings: Settings<T>, line: Line<T>) -> Result<Self, SettingsError> {
        Self::following(settings, Path::line(&line))
    }

    /// The path being followed.
    #[must_use]
    pub fn path(&self) -> &Path<T> {
        &self.route
    }
}

fn observation<T: Scalar>(sample: &Sample<T>) -> Observation<T> {
    Observation {
        position: sample.position,
        velocity: sample.velocity,
        steering_angle: sample.steering_angle,
        steering_rate: sample.applied.steering_rate,
        speed: sample.applied.speed,
        dt: sample.dt,
    }
}

impl<T: Scalar, R: Route<T>> Controller<T, R> {
    /// A controller that follows `route` and stops the vehicle at its end.
    ///
    /// # Errors
    /// [`SettingsError`] names the setting that is unusable.
    pub fn following(settings: Settings<T>, route: R) -> Result<Self, SettingsError> {
        settings.check()?;
        Ok(Self {
            settings,
            progress: Progress::start(),
            estimator: Estimator::new(settings.estimator, route.origin())
                .map_err(SettingsError::Estimator)?,
            route,
            guidance: Guidance::new(settings.guidance).map_err(SettingsError::Guidance)?,
            hold: Hold::new(),
            safety: SafetyFilter::new(settings.limits, settings.slew, settings.stale_after),
            position_age: settings.stale_after + T::one(),
            crab: (T::zero(), T::one()),
            reverse: false,
        })
    }

    /// Follows `route` from now on, starting at its beginning.
    pub fn follow(&mut self, route: R) {
        self.estimator.rebase(route.origin());
        self.route = route;
        self.progress = Progress::start();
        self.guidance.reset();
    }

    /// The route being followed.
    #[must_use]
    pub fn route(&self) -> &R {
        &self.route
    }

    /// The route, to add to it while it is followed.
    pub fn route_mut(&mut self) -> &mut R {
        &mut self.route
    }

    /// Progress along the route.
    #[must_use]
    pub fn progress(&self) -> &Progress<T> {
        &self.progress
    }

    /// True once the vehicle's place is known. Until then it makes no progress on the route, wherever it stands.
    #[must_use]
    pub fn is_located(&self) -> bool {
        self.estimator.is_ready()
    }

    /// Sets the crab angle (rad) by which the body points to the right of its
    /// course when it drives forward, as on a side slope. A single antenna cannot measure it. It
    /// matters only if the controlled point is not beside the antenna.
    pub fn set_crab(&mut self, crab: T) {
        if crab.is_finite() {
            self.crab = crab.sine_cosine();
        }
    }

    /// Sets roll and pitch at the time of the next GPS data, if an inertial sensor has measured them, and returns where the
    /// antenna then is: m ahead of the rear axle and to the right of the centre line. Without them, or if they are not
    /// plausible, this is its place on level ground.
    ///
    /// The value counts until the next call. That the antenna swings while roll and pitch change, is for
    /// [`crate::tilt::TiltWatch`], which calls this.
    pub fn set_tilt(&mut self, tilt: Option<Tilt<T>>) -> (T, T) {
        let EstimatorSettings {
            geometry, antenna, ..
        } = &self.settings.estimator;
        let (ahead, right) = match tilt {
            Some(tilt) if tilt.is_plausible() => tilt.place(geometry, antenna),
            _ => (geometry.l1, antenna.right),
        };
        self.estimator.set_lever(ahead, right);
        (ahead, right)
    }

    /// Sets the measured age of GPS data at their arrival, s. A value that is
    /// negative or not finite is ignored.
    pub fn set_gps_delay(&mut self, delay: T) {
        self.estimator.set_gps_delay(delay);
    }

    /// The real steering rate as a share of the commanded one, as estimated.
    #[must_use]
    pub fn effectiveness(&self) -> T {
        self.estimator.effectiveness()
    }

    /// The real speed as a share of the commanded one, as estimated, but at least a half: a vehicle that is stuck, and then
    /// free, is not to rush. Commands of the law are larger by it.
    #[must_use]
    pub fn drive(&self) -> T {
        self.estimator.drive().max(T::lit(0.5))
    }

    /// Whether the place is known so well that a moment without positions does no harm: the deviation is below a third of
    /// that at which the law stops, ten times the noise of a position.
    #[must_use]
    pub fn is_placed(&self) -> bool {
        let most = self.settings.lost * T::lit(1.0 / 3.0);
        self.estimator.is_ready() && self.estimator.antenna_variance() <= most * most
    }

    /// Slews commands from `last` on, which something else has sent to the actuators.
    pub fn resume(&mut self, last: Command<T>) {
        self.safety.resume(last);
    }

    /// The estimator.
    #[must_use]
    pub fn estimator(&self) -> &Estimator<T> {
        &self.estimator
    }

    /// The steering law.
    #[must_use]
    pub fn guidance(&self) -> &Guidance<T> {
        &self.guidance
    }

    /// One control step. Call it once in each basic cycle and in every mode, so
    /// that the estimator keeps running while the operator drives.
    pub fn step(&mut self, sample: &Sample<T>) -> Outcome<T> {
        let update = self.estimator.step(&observation(sample));
        self.respond(sample, update)
    }

    /// The part of a step that needs no measurement: predicts the vehicle's motion under the command
    /// `applied`, over `dt` (s). To answer measurements sooner, call this once between two steps, as
    /// soon as the command has left, and [`Self::update`] in place of [`Self::step`].
    pub fn predict(&mut self, applied: Command<T>, dt: T) {
        self.estimator.predict(applied, dt);
    }

    /// The rest of a step after [`Self::predict`]. A position without a prediction does not count as
    /// one: the vehicle stops as without positions.
    pub fn update(&mut self, sample: &Sample<T>) -> Outcome<T> {
        let update = self.estimator.update(&observation(sample));
        self.respond(sample, update)
    }

    fn respond(&mut self, sample: &Sample<T>, update: Update) -> Outcome<T> {
        if sample.position.is_some() && update != Update::BadInput {
            self.position_age = T::zero();
        } else {
            self.position_age += sample.dt;
        }
        let estimate = self.estimator.estimate();
        let mut progress = self.progress;
        let place = self
            .route
            .advance(&mut progress, estimate.north, estimate.east);
        // Before the vehicle's place is known, it makes no progress.
        if self.estimator.is_ready() {
            self.progress = progress;
        }
        let reverse = self.route.reverse(&self.progress);
        if reverse != self.reverse {
            // The integral and a movement of the steering are those of the other direction.
            self.reverse = reverse;
            self.guidance.reset();
            self.hold = Hold::new();
        }
        let (tracking, sine) = self.locate(&estimate, &place);
        let proposed = if sample.engaged {
            self.law(&tracking, sine, sample.applied.speed, sample.dt)
        } else {
            self.guidance.reset();
            self.hold = Hold::new();
            None
        };
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
            finished: self.progress.finished,
            update,
            verdict,
        }
    }

    /// The vehicle at `place`, and the sine of its heading error.
    ///
    /// In reverse, everything is that of a vehicle that travels forward with its points ahead and
    /// to the right behind and to the left.
    fn locate(&self, estimate: &Estimate<T>, place: &Place<T>) -> (Tracking<T>, T) {
        let heading_error = if self.route.reverse(&self.progress) {
            wrap_angle(estimate.heading + T::pi() - place.bearing)
        } else {
            wrap_angle(estimate.heading - place.bearing)
        };
        let ahead = self.travelled(self.settings.controlled_point);
        let (course, along_course) = heading_error.sine_cosine();
        let (crab, along_crab) = (self.travelled(self.crab.0), self.crab.1);
        let body = course * along_crab + along_course * crab;
        let along_body = along_course * along_crab - course * crab;
        // The estimator assumes that the body points along the course. The
        // crab angle turns the antenna's lever, which shifts the rear axle.
        let l1 = self.travelled(self.settings.estimator.geometry.l1);
        let right = self.travelled(self.settings.estimator.antenna.right);
        let shift = l1 * (course - body) + right * (along_course - along_body);
        let tracking = Tracking {
            segment: self.progress.segment,
            along: place.along,
            cross_track: place.cross_track + shift + ahead * body,
            heading: estimate.heading,
            heading_error,
            steering_angle: estimate.steering_angle,
            speed: estimate.speed,
        };
        (tracking, course)
    }

    /// A length, angle or speed of the vehicle as that of its travel.
    ///
    /// The rear axle of a vehicle that drives backwards moves as that of one that drives
    /// forward with its wheels to the other side: if the direction of travel is c = heading + pi
    /// and its speed u = -V, then dc/dt = V tan(a) / L = u tan(-a) / L. So the law and its gains,
    /// which are those of the rear axle, hold for u and -a.
    fn travelled(&self, value: T) -> T {
        // Asked of the route, which for most kinds is a constant.
        if self.route.reverse(&self.progress) {
            -value
        } else {
            value
        }
    }

    fn law(&mut self, tracking: &Tracking<T>, sine: T, applied: T, dt: T) -> Option<Command<T>> {
        let travel = self.travelled(tracking.speed);
        let cruise = self.settings.cruise;
        let mut planned = self.route.speed(&self.progress, travel);
        // The ramp starts from the last command. From the measured speed it would never fall if the drive does not slow down.
        if let Some(most) = self
            .route
            .stopping(self.travelled(applied) * self.drive(), dt)
        {
            planned = planned.map(|planned| if most < planned { most } else { planned });
        }
        if !self.estimator.is_ready() {
            // Drive straight: the heading is observable only in motion. How far the next stop is,
            // is not known either.
            let usual = self.route.usual_speed(&self.progress).unwrap_or(cruise);
            let speed = if usual < cruise { usual } else { cruise };
            let waits = planned.is_some_and(|planned| !(planned > T::zero()));
            return Some(Command {
                steering_rate: T::zero(),
                speed: if waits {
                    T::zero()
                } else {
                    self.travelled(speed)
                },
            });
        }
        let lost = self.settings.lost;
        if !(self.estimator.antenna_variance() <= lost * lost) {
            return None;
        }
        if self.progress.finished || !self.route.is_ready(&self.progress) {
            return Some(Command::still());
        }
        let speed = match planned {
            Some(speed) => speed,
            None => self.speed_in_bends(travel),
        };
        if planned.is_some() && !(speed > T::zero()) && travel.abs() < T::lit(STANDING) {
            // A vehicle that waits does not turn its wheels.
            return Some(Command::still());
        }
        let effectiveness = self.estimator.effectiveness();
        let deviation = self.deviation(tracking, sine, effectiveness);
        let share = self.guidance.firm_share(&deviation);
        let (firm, gentle) = (&self.settings.firm, &self.settings.gentle);
        // The gains of a slower vehicle are larger: near a stop they would ask for steering angles
        // that cannot be taken back when it drives on.
        let driven = match self.route.usual_speed(&self.progress) {
            Some(usual) if usual > tracking.speed.abs() => usual,
            _ => tracking.speed,
        };
        // As a rule one regulator acts alone, and only its gains are looked up.
        let gains = if share >= T::one() {
            firm.at(driven)
        } else if share > T::zero() {
            blended(&firm.at(driven), &gentle.at(driven), share)
        } else {
            gentle.at(driven)
        };
        let target = self.guidance.steer(&deviation, share, &gains, dt);
        let error = target.angle - deviation.steering_angle;
        let rate = self
            .hold
            .rate(&self.settings.hold, error, target.follow, dt);
        let rate = rate + self.feed_forward(&deviation, dt);
        // A vehicle that still rolls the other way is stopped first.
        let speed = if planned.is_some() && travel < -T::lit(STANDING) {
            T::zero()
        } else {
            speed
        };
        Some(Command {
            steering_rate: self.travelled(rate / effectiveness),
            // A drive that is slower than its commands is commanded more.
            speed: self.travelled(speed / self.drive()),
        })
    }

    /// The cruise speed, or less before and in a bend of a route that does not plan its speed (m/s): while the steering
    /// travels to the bend's angle, the vehicle turns by at most [`SLOWNESS`], and the lateral acceleration is at most
    /// [`LATERAL`]. So it enters an arc, whose curvature comes at once, within a decimetre.
    fn speed_in_bends(&self, travel: T) -> T {
        let cruise = self.settings.cruise;
        // The drive slows down within about three of its time constants.
        let time = T::lit(3.0) * self.settings.estimator.drive_lag + T::lit(0.5);
        let curvature = self.route.tightest(&self.progress, travel.abs() * time);
        if !(curvature > T::zero()) {
            return cruise;
        }
        let angle = self.guidance.angle_for(curvature);
        let rate = self.settings.limits.steering_rate * self.estimator.effectiveness();
        let slow = T::lit(SLOWNESS) * rate / (angle * curvature);
        let lateral = (T::lit(LATERAL) / curvature).root();
        cruise.min(slow).min(lateral)
    }

    /// Steering rate (rad/s) with which the wheels follow the curvature of the route over the
    /// next `dt` (s), if they can.
    fn feed_forward(&self, at: &Deviation<T>, dt: T) -> T {
        match self.route.next_curvature(&self.progress, at.speed * dt) {
            Some(next) if next != at.curvature => {
                (self.guidance.angle_for(next) - self.guidance.angle_for(at.curvature)) / dt
            }
            _ => T::zero(),
        }
    }

    fn deviation(&self, tracking: &Tracking<T>, sine: T, effectiveness: T) -> Deviation<T> {
        let travel = self.travelled(tracking.speed);
        let forward = if travel > T::zero() {
            travel
        } else {
            T::zero()
        };
        let way = self.guidance.steering_way(forward, effectiveness) + T::lit(0.01);
        // The steering angle lags behind its target.
        let ahead = forward * T::lit(0.25);
        let Bend {
            turn,
            curvature,
            curvature_ahead,
        } = self.route.bend(&self.progress, ahead, way);
        Deviation {
            cross_track: tracking.cross_track
                - self.travelled(self.settings.controlled_point) * sine,
            // On a straight route there is nothing to wrap.
            heading: if turn == T::zero() {
                tracking.heading_error
            } else {
                wrap_angle(tracking.heading_error - turn)
            },
            steering_angle: self.travelled(tracking.steering_angle),
            speed: forward,
            curvature,
            curvature_ahead,
            effectiveness,
        }
    }
}
