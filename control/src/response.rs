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
//! | turn of the course with what the steering angle makes at this speed | 2 s | 15 deg | a fifth | 0.5 s |
//! | speed over ground with the commanded one | 1 s | 0.3 m/s | a quarter, or half as much again and 0.5 m/s | 1 s |
//! | distance from the path, once it was below 0.3 m for 3 s | | | above 1 m | 0.5 s |
//! | way or time without a speed that tells a heading | | | 3 m or 3 s | |
//!
//! With a step of 100 ms, a steering that does not follow a command of 25 deg/s is noticed after 0.7 s: 2.5, 4.75 and
//! 6.8 deg are asked for in three steps, and four more steps make five wrong ones. A drive that does not follow a
//! command of 1 m/s is noticed after 1.3 s: 0.1, 0.19, 0.27 and 0.34 m/s in four steps, and nine more.
//!
//! Five steps, because a steering that follows two steps late may be behind for up to four when the command reverses.
//! A fifth and a quarter are far from what a sound vehicle shows: 70 % of the steering's rate when
//! loaded, 70 % of the speed with 30 % of slip.

use crate::controller::Settings;
use crate::feedback::Limits;
use crate::position::Velocity;
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
    /// The vehicle was on its path and has left it.
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
    /// Speed up to which a velocity does not tell a heading, m/s, positive.
    pub standstill: T,
}

impl<T: Scalar> ResponseSettings<T> {
    /// What the settings of the law say of the vehicle.
    #[must_use]
    pub fn of(settings: &Settings<T>) -> Self {
        Self {
            limits: settings.limits,
            wheelbase: settings.estimator.geometry.wheelbase(),
            antenna_ahead: settings.estimator.geometry.l1,
            standstill: settings.estimator.standstill,
        }
    }
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
    /// Time since the step before, s.
    pub dt: T,
}

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

/// Steps in a row in which something is wrong.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Streak(u8);

impl Streak {
    /// Counts a step. Returns whether it is the `limit`-th wrong one in a row or a later one.
    fn count(&mut self, wrong: bool, limit: u8) -> bool {
        self.0 = if wrong { self.0.saturating_add(1) } else { 0 };
        self.0 >= limit
    }
}

/// Compares commands with what is measured, in each step of an autonomous run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ResponseWatch<T> {
    settings: ResponseSettings<T>,
    steering: Pair<T>,
    turn: Pair<T>,
    speed: Pair<T>,
    /// The last steering angle and the last course that were measured, rad.
    angle: Option<T>,
    course: Option<T>,
    /// True if the last command was to drive backwards.
    reverse: bool,
    steering_wrong: Streak,
    course_wrong: Streak,
    speed_wrong: Streak,
    path_wrong: Streak,
    /// Time near the path, s, up to what counts as captured.
    near: T,
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
            reverse: false,
            steering_wrong: Streak::default(),
            course_wrong: Streak::default(),
            speed_wrong: Streak::default(),
            path_wrong: Streak::default(),
            near: T::zero(),
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
        // Each is followed in each step, whatever the others say.
        let found = [
            (self.steering(seen), Departure::Steering),
            (self.speed(seen), Departure::Speed),
            (self.course(seen), Departure::Course),
            (self.path(seen), Departure::Path),
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
            self.steering_wrong = Streak::default();
            return false;
        }
        self.steering.add(rate * seen.dt, moved, seen.dt, T::one());
        let wrong = self
            .steering
            .falls_short(T::lit(5.0_f64.to_radians()), T::lit(0.2));
        self.steering_wrong.count(wrong, 5)
    }

    /// Speed over ground, m/s, and course, rad clockwise from north.
    fn over_ground(velocity: Velocity) -> (T, T) {
        let (north, east) = velocity.metres_per_second::<T>();
        ((north * north + east * east).root(), east.angle_of(north))
    }

    fn speed(&mut self, seen: &Response<T>) -> bool {
        let Some(velocity) = seen.velocity else {
            return false;
        };
        let (speed, _) = Self::over_ground(velocity);
        let dt = seen.dt;
        let asked = seen.applied.speed.abs();
        self.speed.add(asked * dt, speed * dt, dt, T::one());
        let least = T::lit(0.3);
        let slow = self.speed.falls_short(least, T::lit(0.25));
        let fast = self.speed.came > self.speed.asked * T::lit(1.5) + T::lit(0.5);
        self.speed_wrong.count(slow || fast, 10)
    }

    fn course(&mut self, seen: &Response<T>) -> bool {
        let (Some(velocity), Some(angle)) = (seen.velocity, self.angle) else {
            self.course = None;
            return false;
        };
        let reverse = seen.applied.speed < T::zero();
        if reverse != self.reverse {
            // The course is that of the other end of the vehicle now.
            self.reverse = reverse;
            self.course = None;
            self.turn = Pair::new();
            self.course_wrong = Streak::default();
        }
        let (speed, course) = Self::over_ground(velocity);
        // Slowly the course is noise.
        if speed < T::lit(0.3).max(self.settings.standstill) {
            self.course = None;
            return false;
        }
        // The velocity is that of the antenna, which also moves to the side to which the wheels turn: its course leads
        // that of the rear axle.
        let bend = angle.tangent() / self.settings.wheelbase;
        let course = course - (bend * self.settings.antenna_ahead).angle_of(T::one());
        let Some(before) = self.course.replace(course) else {
            return false;
        };
        let turned = wrap_angle(course - before);
        let forward = speed * bend * seen.dt;
        let turn = if reverse { -forward } else { forward };
        self.turn.add(turn, turned, seen.dt, T::lit(2.0));
        let wrong = self
            .turn
            .falls_short(T::lit(15.0_f64.to_radians()), T::lit(0.2));
        self.course_wrong.count(wrong, 5)
    }

    fn path(&mut self, seen: &Response<T>) -> bool {
        let Some(distance) = seen.cross_track.map(|distance| distance.abs()) else {
            return self.path_wrong.count(false, 5);
        };
        let captured = self.near >= T::lit(3.0);
        if distance < T::lit(0.3) {
            self.near += seen.dt;
        } else if !captured {
            self.near = T::zero();
        }
        self.path_wrong.count(captured && distance > T::one(), 5)
    }

    fn heading(&mut self, seen: &Response<T>) -> bool {
        let moving = seen.velocity.is_some_and(|velocity| {
            let (speed, _) = Self::over_ground(velocity);
            speed > self.settings.standstill
        });
        let asked = seen.applied.speed.abs();
        if moving || seen.cross_track.is_none() {
            self.blind_way = T::zero();
            self.blind_time = T::zero();
        } else if asked > T::zero() {
            self.blind_way += asked * seen.dt;
            self.blind_time += seen.dt;
        }
        let limit = T::lit(3.0);
        self.blind_way >= limit || self.blind_time >= limit
    }
}
