//! The robot of the row follower: six wheels, steered by a difference of both sides' speeds (Dagu
//! Wild Thumper, thesis 2.2.1 and 2.2.2).
//!
//! The three motors of a side are wired in parallel to one driver, and each turns at a speed of its
//! own. The middle axle is mounted lower, so the chassis stands either on the front four wheels or on
//! the rear four and tips between them at random. That moves the centre of rotation, and it decides
//! which motors drive.
//!
//! Tyres slip in proportion to the force on them (linear tyre, J. Y. Wong, Theory of Ground
//! Vehicles, 5.2), and the robot is so light that all forces are always in balance. Four wheels stand
//! at `c +- a/2` along the chassis and `+-b` across it, each with the same share of the weight. With
//! `u` for the speed of a wheel, `V` for the mean of all |u|, `L` for the part of the weight
//! that pulls to the right, `C` for the slip of a tyre along and across, the balances of lateral
//! force and of moments are
//!
//! ```text
//! v + c w = V C_across L
//! w (b^2/C_along + a^2/(4 C_across)) = b (u_left - u_right)/(2 C_along) - V c L
//! ```
//!
//! for the lateral speed `v` of the chassis' middle, where the centre of mass is, and its yaw rate
//! `w`. So four wheels turn the chassis less than their speeds alone would say, and where the
//! effective track is wider than the real one (Mandow et al., IROS 2007).

mod parameters;
mod terrain;

use std::collections::VecDeque;

use libm::{cos, exp, sin};

pub use parameters::{Mount, Parameters, Terrain};
use terrain::Surface;

use crate::random::{Purpose, Stream};
use crate::rows::Footprint;
use crate::time::{SimDuration, SimTime, after, since, span_seconds};

/// Length of an integration step, in which the robot moves 1 mm at 1 m/s. Steps begin at multiples of
/// it, whenever the caller looks.
const STEP: SimDuration = SimDuration::from_ticks(1_000_000_000);

/// One of the two groups of three wheels.
#[derive(Copy, Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Side {
    /// The left wheels.
    Left,
    /// The right wheels.
    Right,
}

/// The axles that the chassis stands on.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub enum Axles {
    /// Front and middle axle.
    Front,
    /// Middle and rear axle.
    Rear,
}

/// Position and motion of the robot.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct State {
    /// `x` of the chassis' middle, metres.
    pub x: f64,
    /// `y` of the chassis' middle, metres.
    pub y: f64,
    /// Heading of the body, radians from `x` to `y`: positive to the right, not wrapped.
    pub heading: f64,
    /// Speed of the middle along the heading, metres per second.
    pub speed: f64,
    /// Speed of the middle to the right, metres per second.
    pub sideways: f64,
    /// Yaw rate, radians per second, positive to the right.
    pub turn: f64,
    /// Way of the middle along the heading, forwards or back, metres.
    pub way: f64,
}

/// Speeds of the wheels, metres per second: left and right side, each from front to rear.
type Wheels = [[f64; 3]; 2];

/// What changes from step to step.
#[derive(Copy, Clone, Debug)]
struct Motion {
    x: f64,
    y: f64,
    heading: f64,
    way: f64,
    wheels: Wheels,
    efforts: [f64; 2],
}

/// Speeds of the chassis' middle: along and across the heading, and yaw rate.
struct Twist {
    speed: f64,
    sideways: f64,
    turn: f64,
}

/// The moving robot.
#[derive(Clone, Debug)]
pub struct Rover {
    parameters: Parameters,
    terrain: Terrain,
    /// Speed of each wheel at full effort, metres per second.
    full: Wheels,
    surface: Surface,
    /// The start of the current step.
    begun: SimTime,
    now: SimTime,
    /// The motion at `begun`.
    motion: Motion,
    pending: VecDeque<(SimTime, Side, f64)>,
}

impl Rover {
    /// A robot at rest at time zero, with its middle at (`x`, `y`). Motors that `parameters` leaves
    /// open, and everything that happens along the way, follow from `seed`.
    #[must_use]
    pub fn new(
        parameters: Parameters,
        terrain: Terrain,
        (x, y, heading): (f64, f64, f64),
        seed: u64,
    ) -> Self {
        let mut stream = Stream::new(seed, Purpose::Motors);
        let drawn = [[(); 3]; 2].map(|side| {
            side.map(|()| (1.0 + parameters.motor_spread * stream.normal()).clamp(0.2, 1.8))
        });
        let motors = parameters.motors.unwrap_or(drawn);
        Self {
            full: motors.map(|side| side.map(|motor| motor * parameters.top_speed)),
            parameters,
            surface: Surface::new(&terrain, seed),
            terrain,
            begun: SimTime::from_ticks(0),
            now: SimTime::from_ticks(0),
            motion: Motion {
                x,
                y,
                heading,
                way: 0.0,
                wheels: [[0.0; 3]; 2],
                efforts: [0.0; 2],
            },
            pending: VecDeque::new(),
        }
    }

    /// Sets the effort of a side, -1 to 1, from time `from` on. A time in the past counts as now.
    pub fn set_effort(&mut self, from: SimTime, side: Side, effort: f64) {
        let from = from.max(self.now);
        let place = self.pending.partition_point(|(when, ..)| *when <= from);
        self.pending
            .insert(place, (from, side, effort.clamp(-1.0, 1.0)));
    }

    /// Moves the robot to time `to`; an earlier time has no effect. The motion does not depend on
    /// the times at which this is called: only whole steps are kept.
    pub fn advance_to(&mut self, to: SimTime) {
        self.now = self.now.max(to);
        loop {
            let end = after(self.begun, STEP);
            // An effort that is set later in this step would be missing.
            if end > self.now {
                return;
            }
            self.motion = self.within(end);
            while self.pending.front().is_some_and(|(when, ..)| *when <= end) {
                self.pending.pop_front();
            }
            let kick = self.surface.advance_to(self.motion.way);
            self.motion.heading += kick.heading;
            self.motion.x -= kick.right * sin(self.motion.heading);
            self.motion.y += kick.right * cos(self.motion.heading);
            self.begun = end;
        }
    }

    /// The state at [`Rover::now`].
    #[must_use]
    pub fn state(&self) -> State {
        self.state_of(&self.within(self.now))
    }

    /// Predicts the state at `when` from the efforts known so far, without moving the robot.
    #[must_use]
    pub fn state_at(&self, when: SimTime) -> State {
        if when < after(self.begun, STEP) {
            return self.state_of(&self.within(when.max(self.now)));
        }
        let mut ahead = self.clone();
        ahead.advance_to(when);
        ahead.state()
    }

    /// The time of [`Rover::state`].
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.now
    }

    /// Mean speed of a side's three wheels at the end of the last whole step, metres per second.
    #[must_use]
    pub fn wheel_speed(&self, side: Side) -> f64 {
        self.motion.wheels[side as usize].iter().sum::<f64>() / 3.0
    }

    /// Speed of each motor's wheel at full effort, metres per second: left and right side, each from
    /// front to rear.
    #[must_use]
    pub fn full_speeds(&self) -> [[f64; 3]; 2] {
        self.full
    }

    /// The axles that the chassis stands on.
    #[must_use]
    pub fn axles(&self) -> Axles {
        self.surface.axles()
    }

    /// Clods that it has hit by now.
    #[must_use]
    pub fn clods(&self) -> u64 {
        self.surface.clods()
    }

    /// The area that the chassis covers in a state.
    #[must_use]
    pub fn footprint(&self, state: &State) -> Footprint {
        Footprint {
            x: state.x,
            y: state.y,
            heading: state.heading,
            half_length: self.parameters.length / 2.0,
            half_width: self.parameters.width / 2.0,
        }
    }

    /// The robot's constants.
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The motion at `end`, at most a step after the last whole one. Efforts change within it.
    fn within(&self, end: SimTime) -> Motion {
        let mut motion = self.motion;
        let mut now = self.begun;
        let changes = self.pending.iter().take_while(|(when, ..)| *when <= end);
        for &(when, side, effort) in changes {
            self.pass(&mut motion, span_seconds(since(when, now)));
            motion.efforts[side as usize] = effort;
            now = when.max(now);
        }
        self.pass(&mut motion, span_seconds(since(end, now)));
        motion
    }

    /// Integrates the motion over `span` seconds of constant efforts by the midpoint rule; the speeds
    /// of the wheels are exact.
    fn pass(&self, motion: &mut Motion, span: f64) {
        if span == 0.0 {
            return;
        }
        let half = Motion {
            wheels: self.wheels(motion, span / 2.0),
            ..*motion
        };
        let first = self.twist(&half);
        let middle = Motion {
            heading: motion.heading + first.turn * span / 2.0,
            ..half
        };
        let twist = self.twist(&middle);
        let (s, c) = (sin(middle.heading), cos(middle.heading));
        motion.x += span * (twist.speed * c - twist.sideways * s);
        motion.y += span * (twist.speed * s + twist.sideways * c);
        motion.heading += span * twist.turn;
        motion.way += span * twist.speed.abs();
        motion.wheels = self.wheels(motion, span);
    }

    /// Speeds of the wheels `span` seconds later.
    fn wheels(&self, motion: &Motion, span: f64) -> Wheels {
        let rest = if self.parameters.lag > 0.0 {
            exp(-span / self.parameters.lag)
        } else {
            0.0
        };
        let mut wheels = motion.wheels;
        for (side, speeds) in wheels.iter_mut().enumerate() {
            let effort = self.moving(motion.efforts[side]);
            for (speed, full) in speeds.iter_mut().zip(self.full[side]) {
                let target = full * effort;
                *speed = target + (*speed - target) * rest;
            }
        }
        wheels
    }

    /// The share of an effort that turns a motor against its friction.
    fn moving(&self, effort: f64) -> f64 {
        let lost = self.parameters.friction;
        ((effort.abs() - lost).max(0.0) / (1.0 - lost)).copysign(effort)
    }

    /// The balance of forces that the module's text describes.
    fn twist(&self, motion: &Motion) -> Twist {
        let p = &self.parameters;
        let (first, centre) = match self.surface.axles() {
            Axles::Front => (0, p.axle_spacing / 2.0),
            Axles::Rear => (1, -p.axle_spacing / 2.0),
        };
        let mut sides = [0.0; 2];
        let mut swiftness = 0.0;
        for (side, wheels) in motion.wheels.iter().enumerate() {
            for wheel in &wheels[first..first + 2] {
                sides[side] += wheel * (1.0 - self.surface.slip()[side]) / 2.0;
                swiftness += wheel.abs() / 4.0;
            }
        }
        let slope = sin(self.terrain.slope.get());
        let falls = self.terrain.downhill.get() - motion.heading;
        let (ahead, right) = (slope * cos(falls), slope * sin(falls));
        let half_track = p.track / 2.0;
        let resistance = half_track * half_track / p.slip_along
            + p.axle_spacing * p.axle_spacing / (4.0 * p.slip_across);
        let drive = half_track * (sides[0] - sides[1]) / (2.0 * p.slip_along);
        let turn = (drive - swiftness * centre * right) / resistance;
        Twist {
            speed: f64::midpoint(sides[0], sides[1]) + swiftness * p.slip_along * ahead,
            sideways: swiftness * p.slip_across * right - centre * turn,
            turn,
        }
    }

    fn state_of(&self, motion: &Motion) -> State {
        let twist = self.twist(motion);
        State {
            x: motion.x,
            y: motion.y,
            heading: motion.heading,
            speed: twist.speed,
            sideways: twist.sideways,
            turn: twist.turn,
            way: motion.way,
        }
    }
}
