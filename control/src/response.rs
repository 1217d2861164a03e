//! Whether the vehicle does what it is told.
//!
//! The law of an autonomous run believes its sensors and its actuators. A motor that turns the other way, a
//! potentiometer whose ends are interchanged or that is frozen, or a drive that is dead makes it steer away from its
//! path, at full lock if need be. A [`ResponseWatch`] compares what was commanded with what was measured, and
//! ends the run ([`Departure`]).
//!
//! Each comparison takes both sides through the same low-pass filter, so that a delay of some steps between them
//! does not matter, and judges only when enough was commanded:
//!
//! | compared | over | judged from | fails below, or above | for |
//! | --- | --- | --- | --- | --- |
//! | way of the potentiometer with that of the steering's commands | 1 s | 5 deg | a fifth | 0.5 s |
//! | turn of the course with what the steering angle makes at this speed | 2 s, or 1.5 wheelbases | 15 deg, or six times the noise of the course | a fifth | 0.5 s |
//! | speed over ground with the commanded one | 1 s | 0.3 m/s | a quarter, or half as much again and 0.5 m/s | 1 s |
//! | speed over ground, while the command is standstill | 1 s | | above 0.25 m/s, or 1.5 times `standstill` | 2 s |
//! | distance from the path, once it was below 0.3 m for 3 s | | | above 1 m | 0.5 s |
//! | the same before that, with the least so far | | | [`ResponseSettings::reach`] more | 0.5 s |
//! | way along a piece of the path, once it was near | | | 1 m less than before | 0.5 s |
//! | way to the path | | | 60 m and ten times distance and `reach` | |
//! | way of the positions with that of the velocities | 2 s, or 2 m | 1 m | a fifth | 0.5 s |
//! | way or time without a speed that tells a heading | | | 3 m, or [`ResponseSettings::patience`]: 3 s as a rule | |
//!
//! Half a second, because a steering that follows two steps late may be behind for up to four when the command
//! reverses. A fifth and a quarter are far from what a sound vehicle shows: 70 % of the steering's rate when
//! loaded, 70 % of the speed with 30 % of slip. A receiver that measures less often than the law steps is judged when
//! its velocities arrive, by what was commanded since the one before, and never by one velocity alone.
//!
//! # Bounds
//!
//! What is asked for at a rate a (per second) has filled a filter of time constant c up to a c (1 - exp(-t / c)) after
//! a time t; in steps of dt it does so sooner. So it is judged, from the threshold j on, after at most
//!
//! t = -c ln(1 - j / (a c)) + dt,
//!
//! and never if a c is not above j. What does not follow at all ends the run after t and the time of the last column:
//!
//! * A steering that does not follow a command of r: -ln(1 - 5 deg / r) + dt + 0.5 s. At 25 deg/s and steps of 100 ms
//!   these are 0.83 s (the seventh step, for 2.5, 4.75 and 6.8 deg are asked for in three steps); at 10 deg/s 1.3 s. If
//!   it had followed at this rate before, the way that it has moved must first be forgotten to a fifth:
//!   -ln(0.2) + dt + 0.5 s = 2.2 s.
//! * A drive that does not move under a command of v: -ln(1 - 0.3 / v) + dt + 1 s, at 1 m/s 1.46 s. If it had moved,
//!   its filtered speed must fall to a quarter, behind the drive's own lag, the age of the data and the time until the next
//!   velocity: -ln(0.25) + 1.4 lag + age + interval + dt + 1 s. (With a lag of m the filtered speed is
//!   (exp(-t) - m exp(-t / m)) / (1 - m), which for m from 0 to 1 has fallen to a quarter before -ln(0.25) + 1.4 m.)
//! * A course that does not turn while the wheels should turn the vehicle by w: -2 ln(1 - 15 deg / (2 w)) + dt + 0.5 s,
//!   at 10 deg/s 3.4 s, and as for the drive age and interval of the data. The memory of slow vehicles is longer, since
//!   their wheels turn them over a way: over 1.5 wheelbases an angle of 10 deg turns them by 15 deg.
//! * A drive that does not stop: the command falls to rest at the path's deceleration, whatever the vehicle does. From there
//!   on, -ln(0.1 / v) + dt + 2 s and the next velocity: until the filter has forgotten what was asked for before.
//! * Positions that do not move while the velocities are those of a speed v: -2 ln(1 - 1 m / (2 v)) + dt + 0.5 s, at 1 m/s 2.0 s,
//!   and if they moved before, these ways are first forgotten to a fifth: -2 ln(0.2) + dt + 0.5 s = 3.8 s.
//! * A heading that is not known: 3 s (`patience`) or 3 m, and a step. A vehicle that stops shows a heading until it stands.
//!
//! A fault that asks for less than the thresholds does harm only by leading away from the path. That ends the run
//! whatever its cause: a vehicle at speed v that was on its path is at most 1 m + v (0.5 s + dt) away from it, and one
//! that was not is at most `reach` + v (0.5 s + dt) farther away than it was at best. (To both comes the error of the
//! estimated place.) `tests/bounds.rs` checks each of these over random vehicles and faults. It holds for receivers of 10 and 5 Hz,
//! vehicles that are more than twice as fast over ground as `standstill`, and antennas at most 0.4 wheelbases behind
//! the rear axle, 1.2 ahead of it and 0.2 beside the centre line. Of slower vehicles whose drive turns the other way
//! one in a hundred was not stopped within two minutes; with a receiver of 1 Hz, or an antenna farther out, one sound vehicle
//! in a hundred was stopped, against one of 2100 within these limits.

use crate::controller::{Outcome, Sample, Settings};
use crate::feedback::Limits;
use crate::position::{Position, Velocity};
use crate::safety::Command;
use crate::scalar::{Scalar, wrap_angle};

/// How the vehicle departs from what it is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Departure {
    /// The potentiometer does not follow the commands to the steering: the motor is dead or turns the other way, or
    /// the potentiometer is frozen or reversed.
    Steering,
    /// The speed over ground is not the commanded one: the drive is dead, slips, or runs away.
    Speed,
    /// The course does not turn as the steering angle says: the vehicle drives the other way than it is told, or the
    /// potentiometer shows another angle than the wheels have.
    Course,
    /// The vehicle was on its path and has left it, goes back on it, or does not get onto it; or its positions do not move
    /// as it does.
    Path,
    /// The heading is not known: there is no velocity, or none that is fast enough.
    Heading,
}

/// What a [`ResponseWatch`] must know of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResponseSettings<T> {
    /// Limits of the commands.
    pub limits: Limits<T>,
    /// Distance of the axles, m, positive.
    pub wheelbase: T,
    /// Distance of the antenna ahead of the rear axle, m.
    pub antenna_ahead: T,
    /// Distance of the antenna to the right of the centre line, m.
    pub antenna_right: T,
    /// Speed up to which a velocity does not tell a heading, m/s, positive.
    pub standstill: T,
    /// How long a command may have no speed that tells a heading, s, positive: the vehicle has to gather speed.
    pub patience: T,
    /// How much farther from its path the vehicle may go before it comes onto it, m, positive: it may have to turn
    /// round.
    pub reach: T,
}

impl<T: Scalar> ResponseSettings<T> {
    /// What the settings of the law say of the vehicle.
    #[must_use]
    pub fn of(settings: &Settings<T>) -> Self {
        Self {
            limits: settings.limits,
            wheelbase: settings.estimator.geometry.wheelbase(),
            antenna_ahead: settings.estimator.geometry.l1,
            antenna_right: settings.estimator.antenna.right,
            standstill: settings.estimator.standstill,
            patience: patience(settings),
            reach: reach(settings),
        }
    }
}

/// How long a vehicle takes to a speed that tells its heading: half as long again as its acceleration says, its lag, and the age of
/// the data. At least 3 s, and a second and a half for the time between velocities and their noise.
fn patience<T: Scalar>(settings: &Settings<T>) -> T {
    let estimator = &settings.estimator;
    let gathers = T::lit(1.5) * estimator.standstill / settings.slew.speed;
    let behind = T::lit(1.4) * estimator.drive_lag + estimator.gps_delay;
    T::lit(3.0).max(T::lit(1.5) + gathers + behind)
}

/// How far a vehicle goes away from its path that it faces away from: until the heading is known and the steering has
/// travelled it drives on, and then it turns with the radius of a swing. Half of radius and travel are added, for a slow
/// steering and a longer wheelbase.
fn reach<T: Scalar>(settings: &Settings<T>) -> T {
    let guidance = &settings.guidance;
    let swing = guidance.swing * guidance.limits.steering_angle;
    let radius = guidance.wheelbase / swing.tangent();
    let travel = swing / guidance.limits.steering_rate;
    let (half_more, ready) = (T::lit(1.5), T::lit(2.0) + settings.stale_after);
    let ahead = settings.estimator.geometry.l1.abs();
    half_more * radius + settings.cruise * (half_more * travel + ready) + ahead
}

/// What was commanded and measured in a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response<T> {
    /// The command that was applied since the step before.
    pub applied: Command<T>,
    /// The steering angle that the potentiometer shows, rad, positive to the right; `None` without a reading.
    pub steering_angle: Option<T>,
    /// The antenna's velocity, if one arrived.
    pub velocity: Option<Velocity>,
    /// Distance from the path, m; `None` if something else than the path guides the vehicle. Then the heading
    /// is not needed either.
    pub cross_track: Option<T>,
    /// The piece of the path, and the distance along it, m.
    pub segment: usize,
    /// See `segment`.
    pub along: T,
    /// Direction of travel relative to the path, rad.
    pub heading_error: T,
    /// The antenna's position, if one arrived.
    pub position: Option<Position>,
    /// Time since the step before, s.
    pub dt: T,
}

impl<T: Scalar> Response<T> {
    /// That of a step of the controller on its path.
    #[must_use]
    pub fn of(sample: &Sample<T>, outcome: &Outcome<T>) -> Self {
        let tracking = &outcome.tracking;
        Self {
            applied: sample.applied,
            steering_angle: sample.steering_angle,
            velocity: sample.velocity,
            cross_track: Some(tracking.cross_track),
            segment: tracking.segment,
            along: tracking.along,
            heading_error: tracking.heading_error,
            position: sample.position,
            dt: sample.dt,
        }
    }
}

/// The motion that the sensors of a step tell.
#[derive(Clone, Copy, Debug)]
struct Moved<T> {
    /// Speed of the rear axle (m/s) and course of the antenna (rad, clockwise from north), if a velocity arrived.
    measured: Option<(T, T)>,
    /// The bend that the steering angle means, 1/m, once there is an angle.
    bend: Option<T>,
}

/// Noise of a velocity, as a share of [`ResponseSettings::standstill`].
const NOISE: f64 = 0.15;

/// Two quantities through the same low-pass filter: what was asked for, and what came.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Pair<T> {
    asked: T,
    came: T,
}

impl<T: Scalar> Pair<T> {
    fn new() -> Self {
        Self {
            asked: T::zero(),
            came: T::zero(),
        }
    }

    /// Forgets with a time constant (s), and adds.
    fn add(&mut self, asked: T, came: T, dt: T, constant: T) {
        let kept = (T::one() - dt / constant).max(T::zero());
        self.asked = self.asked * kept + asked;
        self.came = self.came * kept + came;
    }

    /// Whether at least `least` was asked for, and less than this share of it came.
    fn falls_short(&self, least: T, share: T) -> bool {
        let (asked, came) = if self.asked < T::zero() {
            (-self.asked, -self.came)
        } else {
            (self.asked, self.came)
        };
        asked >= least && came < asked * share
    }
}

/// For how long something has been wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Streak<T> {
    time: T,
    /// Judgements in a row.
    count: u8,
}

impl<T: Scalar> Streak<T> {
    fn new() -> Self {
        Self {
            time: T::zero(),
            count: 0,
        }
    }

    /// Counts a judgement, `dt` (s) after the one before. Returns whether it is not the first wrong one, and
    /// something has been wrong for `limit` (s).
    fn count(&mut self, wrong: bool, dt: T, limit: T) -> bool {
        if !wrong {
            *self = Self::new();
            return false;
        }
        self.time += dt;
        self.count = self.count.saturating_add(1);
        // Half a step less, so that sums of steps are whole.
        self.count > 1 && self.time > limit - dt * T::lit(0.5)
    }
}

/// What was commanded since the last velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Since<T> {
    /// Way or angle.
    asked: T,
    time: T,
}

impl<T: Scalar> Since<T> {
    fn new() -> Self {
        Self {
            asked: T::zero(),
            time: T::zero(),
        }
    }

    fn add(&mut self, asked: T, dt: T) {
        self.asked += asked;
        self.time += dt;
    }
}

/// Compares commands with what is measured, in each step of an autonomous run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResponseWatch<T> {
    settings: ResponseSettings<T>,
    steering: Pair<T>,
    turn: Pair<T>,
    speed: Pair<T>,
    /// The last steering angle and the last course that were measured, rad, and the speed of that course, m/s.
    angle: Option<T>,
    course: Option<T>,
    over_ground: T,
    /// Commanded way and turn since the last velocity.
    way_since: Since<T>,
    turn_since: Since<T>,
    /// True if the last command was to drive backwards.
    reverse: bool,
    steering_wrong: Streak<T>,
    course_wrong: Streak<T>,
    speed_wrong: Streak<T>,
    rolling: Streak<T>,
    path_wrong: Streak<T>,
    /// Way of the velocities and of the positions.
    moved: Pair<T>,
    moved_wrong: Streak<T>,
    /// The last position, the way of the velocities since then, m north and east, and the times since it and since the last
    /// velocity, s.
    position: Option<Position>,
    gone: [T; 2],
    since_position: T,
    since_velocity: T,
    /// Whether a heading was known in this run, and with it the place.
    placed: bool,
    /// Time near the path, s, up to what counts as captured, and the least distance so far, m.
    near: T,
    least: T,
    /// Whether the path guided the vehicle in the step before, from a known place.
    led: bool,
    /// The piece of the path, and the largest distance along it so far, m.
    segment: usize,
    farthest: T,
    /// Way that was commanded on the way to the path, and the distance at its beginning, m.
    search: T,
    first: T,
    /// Way and time since the heading was known.
    blind_way: T,
    blind_time: T,
}

impl<T: Scalar> ResponseWatch<T> {
    /// A watch that has seen nothing.
    #[must_use]
    pub fn new(settings: ResponseSettings<T>) -> Self {
        Self {
            settings,
            steering: Pair::new(),
            turn: Pair::new(),
            speed: Pair::new(),
            angle: None,
            course: None,
            over_ground: T::zero(),
            way_since: Since::new(),
            turn_since: Since::new(),
            reverse: false,
            steering_wrong: Streak::new(),
            course_wrong: Streak::new(),
            speed_wrong: Streak::new(),
            rolling: Streak::new(),
            path_wrong: Streak::new(),
            moved: Pair::new(),
            moved_wrong: Streak::new(),
            position: None,
            gone: [T::zero(); 2],
            since_position: T::zero(),
            since_velocity: T::zero(),
            placed: false,
            near: T::zero(),
            least: T::zero(),
            led: false,
            segment: 0,
            farthest: T::zero(),
            search: T::zero(),
            first: T::zero(),
            blind_way: T::zero(),
            blind_time: T::zero(),
        }
    }

    /// A run begins: nothing of before counts.
    pub fn reset(&mut self) {
        *self = Self::new(self.settings);
    }

    /// One step of the run. Returns how the vehicle departs from what it is told, if it does.
    pub fn step(&mut self, seen: &Response<T>) -> Option<Departure> {
        let steering = self.steering(seen);
        let bend = self
            .angle
            .map(|angle| angle.tangent() / self.settings.wheelbase);
        let measured = seen.velocity.map(|velocity| {
            let (north, east) = velocity.metres_per_second::<T>();
            let square = (north * north + east * east) / self.lever(bend);
            (square.root(), east.angle_of(north))
        });
        let moved = Moved { measured, bend };
        // Each is followed in each step, whatever the others say.
        let found = [
            (steering, Departure::Steering),
            (self.speed(seen, &moved), Departure::Speed),
            (self.course(seen, &moved), Departure::Course),
            (self.path(seen), Departure::Path),
            (self.place(seen), Departure::Path),
            (self.heading(seen), Departure::Heading),
        ];
        let mut found = found.into_iter();
        found.find(|(wrong, _)| *wrong).map(|(_, what)| what)
    }

    fn steering(&mut self, seen: &Response<T>) -> bool {
        let Some(angle) = seen.steering_angle else {
            return false;
        };
        let moved = self.angle.map_or(T::zero(), |before| angle - before);
        self.angle = Some(angle);
        let rate = seen.applied.steering_rate;
        // At its stop the steering cannot follow. What it did on the way there does not count either, or the way
        // back would be held against it.
        let stop = self.settings.limits.steering_angle * T::lit(0.85);
        if (rate > T::zero() && angle > stop) || (rate < T::zero() && angle < -stop) {
            self.steering = Pair::new();
            self.steering_wrong = Streak::new();
            return false;
        }
        self.steering.add(rate * seen.dt, moved, seen.dt, T::one());
        let wrong = self
            .steering
            .falls_short(T::lit(5.0_f64.to_radians()), T::lit(0.2));
        self.steering_wrong.count(wrong, seen.dt, T::lit(0.5))
    }

    fn tells_heading(&self, velocity: Velocity) -> bool {
        let (north, east) = velocity.metres_per_second::<T>();
        let standstill = self.settings.standstill;
        north * north + east * east > standstill * standstill
    }

    fn speed(&mut self, seen: &Response<T>, moved: &Moved<T>) -> bool {
        self.way_since
            .add(seen.applied.speed.abs() * seen.dt, seen.dt);
        let Some((speed, _)) = moved.measured else {
            return false;
        };
        let Since { asked, time } = core::mem::replace(&mut self.way_since, Since::new());
        self.speed.add(asked, speed * time, time, T::one());
        let least = T::lit(0.3);
        let slow = self.speed.falls_short(least, T::lit(0.25));
        let fast = self.speed.came > self.speed.asked * T::lit(1.5) + T::lit(0.5);
        // The filter has forgotten the commands of before.
        let stands = self.speed.asked < T::lit(0.1);
        let slowest = T::lit(0.25).max(T::lit(1.5) * self.settings.standstill);
        let rolls = stands && self.speed.came > slowest;
        let rolls = self.rolling.count(rolls, time, T::lit(2.0));
        self.speed_wrong.count(slow || fast, time, T::one()) || rolls
    }

    /// Velocity of the antenna while the rear axle drives a bend (1/m) at 1 m/s: to the right of that, and along it.
    fn antenna(&self, bend: T) -> [T; 2] {
        [
            bend * self.settings.antenna_ahead,
            T::one() - bend * self.settings.antenna_right,
        ]
    }

    /// Square of the antenna's speed over that of the rear axle in a bend (1/m).
    fn lever(&self, bend: Option<T>) -> T {
        let Some(bend) = bend else {
            return T::one();
        };
        let [aside, along] = self.antenna(bend);
        // An antenna above the turning point would not move at all.
        T::lit(0.01).max(aside * aside + along * along)
    }

    fn course(&mut self, seen: &Response<T>, moved: &Moved<T>) -> bool {
        let reverse = seen.applied.speed < T::zero();
        if reverse != self.reverse {
            // The course is that of the other end of the vehicle now.
            self.reverse = reverse;
            self.course = None;
            self.turn = Pair::new();
            self.course_wrong = Streak::new();
        }
        let Some(bend) = moved.bend else {
            return false;
        };
        let measured = moved.measured;
        if let Some((speed, _)) = measured {
            self.over_ground = speed;
        }
        let forward = self.over_ground * bend * seen.dt;
        self.turn_since
            .add(if reverse { -forward } else { forward }, seen.dt);
        let Some((speed, course)) = measured else {
            return false;
        };
        // Slowly the course is noise: the next one is compared with the one before.
        if speed < T::lit(0.3).max(self.settings.standstill) {
            return false;
        }
        let Since { asked, time } = core::mem::replace(&mut self.turn_since, Since::new());
        // The velocity is that of the antenna, which also moves to the side to which the wheels turn: its course leads
        // that of the rear axle.
        let [aside, along] = self.antenna(bend);
        let course = course - aside.angle_of(along);
        // After a long time it may be round the other way.
        let before = self.course.replace(course);
        let Some(before) = before.filter(|_| time < T::lit(1.5)) else {
            return false;
        };
        let turned = wrap_angle(course - before);
        // A slow vehicle turns over a longer time, and its course is noisier.
        let memory = T::lit(2.0).max(T::lit(1.5) * self.settings.wheelbase / speed);
        self.turn.add(asked, turned, time, memory);
        let noise = T::lit(6.0 * NOISE) * self.settings.standstill / speed;
        let least = T::lit(15.0_f64.to_radians()).max(noise);
        let wrong = self.turn.falls_short(least, T::lit(0.2));
        self.course_wrong.count(wrong, time, T::lit(0.5))
    }

    fn path(&mut self, seen: &Response<T>) -> bool {
        self.placed |= seen
            .velocity
            .is_some_and(|velocity| self.tells_heading(velocity));
        let distance = seen.cross_track.filter(|_| self.placed);
        let Some(distance) = distance.map(|distance| distance.abs()) else {
            self.led = false;
            return self.path_wrong.count(false, seen.dt, T::zero());
        };
        let captured = self.near >= T::lit(3.0);
        if distance < T::lit(0.3) {
            self.near += seen.dt;
        } else if !captured {
            self.near = T::zero();
        }
        let led = core::mem::replace(&mut self.led, true);
        let back = self.goes_back(seen, led) && captured;
        if !distance.is_finite() {
            return self.path_wrong.count(true, seen.dt, T::lit(0.5));
        }
        // Where the estimate of the place begins anew, the distance jumps. The vehicle has not moved, so that does not
        // begin another count: an estimate that is wrong again and again would never end the run.
        self.least = if led {
            self.least.min(distance)
        } else {
            distance
        };
        if captured {
            self.search = T::zero();
            return self
                .path_wrong
                .count(distance > T::one() || back, seen.dt, T::lit(0.5));
        }
        if !(self.search > T::zero()) {
            self.first = distance;
        }
        self.search += seen.applied.speed.abs() * seen.dt;
        let reach = self.settings.reach;
        let longest = T::lit(60.0) + T::lit(10.0) * (self.first + reach);
        let away = distance > self.least + reach;
        self.path_wrong.count(away, seen.dt, T::lit(0.5)) || self.search > longest
    }

    /// Whether the vehicle is a metre farther back on its piece of the path than it has been, or beyond the end of the piece
    /// before, where it was to change its direction.
    fn goes_back(&mut self, seen: &Response<T>, led: bool) -> bool {
        // A vehicle that faces away has not begun to drive along its path.
        let aligned = seen.heading_error.abs() < T::pi() * T::lit(0.5);
        if !led || !aligned || seen.segment != self.segment {
            self.segment = seen.segment;
            self.farthest = seen.along;
        }
        self.farthest = self.farthest.max(seen.along);
        seen.along < self.farthest - T::one()
    }

    /// Whether the positions do not move as the velocities say.
    fn place(&mut self, seen: &Response<T>) -> bool {
        self.since_velocity += seen.dt;
        if let Some(velocity) = seen.velocity {
            let time = core::mem::replace(&mut self.since_velocity, T::zero());
            let (north, east) = velocity.metres_per_second::<T>();
            self.gone = [self.gone[0] + north * time, self.gone[1] + east * time];
        }
        self.since_position += seen.dt;
        let Some(position) = seen.position.filter(|_| seen.cross_track.is_some()) else {
            return false;
        };
        let time = core::mem::replace(&mut self.since_position, T::zero());
        let [north, east] = core::mem::replace(&mut self.gone, [T::zero(); 2]);
        let before = self.position.replace(position);
        let way = (north * north + east * east).root();
        // Across a gap velocities may be missing, too.
        let Some(before) = before.filter(|_| time < T::lit(1.5) && way > T::zero()) else {
            return false;
        };
        let (to_north, to_east) = position.metres_from::<T>(before);
        let came = (to_north * north + to_east * east) / way;
        let memory = T::lit(2.0).max(T::lit(2.0) * time / way);
        self.moved.add(way, came, time, memory);
        let wrong = self.moved.falls_short(T::one(), T::lit(0.2));
        self.moved_wrong.count(wrong, time, T::lit(0.5))
    }

    fn heading(&mut self, seen: &Response<T>) -> bool {
        let moving = seen
            .velocity
            .is_some_and(|velocity| self.tells_heading(velocity));
        let asked = seen.applied.speed.abs();
        if moving || seen.cross_track.is_none() {
            self.blind_way = T::zero();
            self.blind_time = T::zero();
        } else if asked > T::zero() {
            self.blind_way += asked * seen.dt;
            self.blind_time += seen.dt;
        }
        self.blind_way >= T::lit(3.0) || self.blind_time >= self.settings.patience
    }
}
