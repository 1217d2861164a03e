//! The vehicle: a kinematic bicycle with a slow, limited steering actuator and a drive with a lag.
//!
//! Geometry and signs (thesis 7.2.4 after O'Connor, Figure 7.7): north-east-down frame, heading
//! clockwise from north, positive steering turns right. The antenna is mounted `L1` ahead of the
//! rear axle, and the front axle is `L2` ahead of the antenna. The linear model `y' = V psi + V
//! L1/L delta` and `psi' = V/L delta` is the small-angle limit of the equations integrated here.
//!
//! Tyres slip in proportion to their lateral force (linear tyre, J. Y. Wong, Theory of Ground
//! Vehicles, 5.2). That force is the centripetal force of the turn minus the downhill component of
//! the weight.
//!
//! Where the ground leans ([`Ground::leans`]), the antenna is where roll and pitch turn it about the rear axle's middle. The
//! motion of that middle stays the one in the horizontal plane.

mod actuator;
mod drive;
mod parameters;

use std::collections::VecDeque;

use libm::{asin, atan, atan2, cos, sin, tan};

pub use actuator::SteeringActuator;
pub use drive::Drive;
pub(crate) use parameters::Changes;
pub use parameters::{Ground, Parameters};

use crate::time::{SimTime, at, from_seconds, seconds, since, span_seconds};

/// Longest integration step, picoseconds: 1 ms, in which the vehicle moves 2 mm at 2 m/s.
const STEP: u64 = 1_000_000_000;

/// Gravity in metres per second squared (conventional value, ISO 80000-3).
const GRAVITY: f64 = 9.806_65;

/// Which motor an effort drives.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub enum Motor {
    /// The steering actuator.
    Steering,
    /// The drive motor.
    Drive,
}

/// Position and motion of the vehicle.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct State {
    /// Northing of the middle of the rear axle, metres.
    pub north: f64,
    /// Easting of the middle of the rear axle, metres.
    pub east: f64,
    /// Heading of the body, radians clockwise from north, not wrapped.
    pub heading: f64,
    /// Angle of the steering actuator as its potentiometer sees it, radians, positive right.
    pub steering: f64,
    /// Rolling speed of the rear wheels, metres per second, negative in reverse.
    pub speed: f64,
}

/// How the body stands: yaw, then pitch, then roll, about the axes down, right and forward of the body.
#[derive(Copy, Clone, Debug, Default, PartialEq)]
pub struct Attitude {
    /// Radians, positive if the right side is lower.
    pub roll: f64,
    /// Radians, positive if the front is higher.
    pub pitch: f64,
    /// Radians clockwise from north, not wrapped.
    pub yaw: f64,
}

/// Place of a point in the vehicle, seen from above: metres ahead of the rear axle and right of the centre line, and their
/// derivatives by the heading.
#[derive(Copy, Clone)]
struct Lever {
    ahead: f64,
    right: f64,
    ahead_by_heading: f64,
    right_by_heading: f64,
}

/// Position and velocity of a point of the vehicle relative to the ground, and how the vehicle stands.
#[derive(Copy, Clone, Debug, Default, PartialEq)]
pub struct Motion {
    /// Northing, metres.
    pub north: f64,
    /// Easting, metres.
    pub east: f64,
    /// Height above the middle of the rear axle on the ground, metres.
    pub height: f64,
    /// Speed towards north, metres per second.
    pub north_speed: f64,
    /// Speed towards east, metres per second.
    pub east_speed: f64,
    /// How the vehicle stands.
    pub attitude: Attitude,
}

/// Derivative of the pose.
#[derive(Copy, Clone)]
struct Pose {
    north: f64,
    east: f64,
    heading: f64,
}

/// The moving vehicle: its state, its actuators and the efforts that take effect later.
#[derive(Clone, Debug)]
pub struct Vehicle {
    parameters: Parameters,
    ground: Ground,
    now: SimTime,
    state: State,
    actuator: SteeringActuator,
    drive: Drive,
    pending: VecDeque<(SimTime, Motor, f64)>,
}

impl Vehicle {
    /// A vehicle with zero efforts and the given pose at the start of the run.
    #[must_use]
    pub fn new(parameters: Parameters, ground: Ground, state: State) -> Self {
        Self {
            actuator: SteeringActuator::new(&parameters),
            drive: Drive::new(&parameters),
            parameters,
            ground,
            now: SimTime::from_ticks(0),
            state,
            pending: VecDeque::new(),
        }
    }

    /// Sets the effort of a motor, -1 to 1, from time `from` on. A time in the past counts as now.
    pub fn set_effort(&mut self, from: SimTime, motor: Motor, effort: f64) {
        let from = from.max(self.now);
        let place = self.pending.partition_point(|(when, _, _)| *when <= from);
        self.pending
            .insert(place, (from, motor, effort.clamp(-1.0, 1.0)));
    }

    /// Moves the vehicle to time `to`; an earlier time has no effect.
    pub fn advance_to(&mut self, to: SimTime) {
        while self.now < to {
            while let Some(&(when, motor, effort)) = self.pending.front()
                && when <= self.now
            {
                match motor {
                    Motor::Steering => self.actuator.effort = effort,
                    Motor::Drive => self.drive.effort = effort,
                }
                self.pending.pop_front();
            }
            let grid = (self.now.as_ticks() / STEP + 1) * STEP;
            let change = self
                .pending
                .front()
                .map_or(u64::MAX, |(when, _, _)| when.as_ticks());
            let end = SimTime::from_ticks(grid.min(change).min(to.as_ticks()));
            self.step(span_seconds(since(end, self.now)));
            self.now = end;
        }
    }

    /// Predicts the state at `when` from the efforts known so far, without moving the vehicle.
    #[must_use]
    pub fn state_at(&self, when: SimTime) -> State {
        if when <= self.now {
            return self.state;
        }
        let mut ahead = self.clone();
        ahead.advance_to(when);
        ahead.state
    }

    /// The time of [`Vehicle::state`].
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.now
    }

    /// The state at [`Vehicle::now`].
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// Position and velocity of the antenna.
    #[must_use]
    pub fn antenna(&self) -> Motion {
        let ahead = self.parameters.rear_to_antenna.get();
        let right = self.parameters.antenna_right.get();
        let height = self.parameters.antenna_height.get();
        if !self.ground.leans {
            return Motion {
                height,
                ..self.point(ahead, right)
            };
        }
        // Body axes forward, right and down, turned by roll and then by pitch.
        let Attitude { roll, pitch, .. } = self.attitude();
        let (sr, cr, sp, cp) = (sin(roll), cos(roll), sin(pitch), cos(pitch));
        let (across, above) = (right * cr + height * sr, height * cr - right * sr);
        // Derivatives of roll and pitch by the heading.
        let slope = self.ground.slope.get();
        let falls = self.ground.downhill.get() - self.state.heading;
        let roll_by_heading = -sin(slope) * cos(falls) / cr;
        let pitch_by_heading = -tan(slope) * sin(falls) * cp * cp;
        let lever = Lever {
            ahead: ahead * cp - above * sp,
            right: across,
            ahead_by_heading: across * sp * roll_by_heading
                - (ahead * sp + above * cp) * pitch_by_heading,
            right_by_heading: above * roll_by_heading,
        };
        Motion {
            height: ahead * sp + above * cp,
            ..self.at_lever(&lever)
        }
    }

    /// How the vehicle stands: level, unless the ground leans.
    #[must_use]
    pub fn attitude(&self) -> Attitude {
        let yaw = self.state.heading;
        let falls = self.ground.downhill.get() - yaw;
        let slope = if self.ground.leans {
            self.ground.slope.get()
        } else {
            0.0
        };
        Attitude {
            roll: asin(sin(slope) * sin(falls)),
            pitch: -atan(tan(slope) * cos(falls)),
            yaw,
        }
    }

    /// The point on the centre line beside the antenna. The report gives its cross-track error.
    #[must_use]
    pub fn beside_antenna(&self) -> Motion {
        self.point(self.parameters.rear_to_antenna.get(), 0.0)
    }

    /// Position and velocity of the point on the ground `ahead` metres before the rear axle
    /// (negative: behind it, such as a hitch) and `right` metres beside the centre line.
    #[must_use]
    pub fn point(&self, ahead: f64, right: f64) -> Motion {
        self.at_lever(&Lever {
            ahead,
            right,
            ahead_by_heading: 0.0,
            right_by_heading: 0.0,
        })
    }

    fn at_lever(&self, lever: &Lever) -> Motion {
        let Lever { ahead, right, .. } = *lever;
        let rate = self.pose_rate(self.state.heading, self.state.steering, self.state.speed);
        let (s, c) = (sin(self.state.heading), cos(self.state.heading));
        // On a slope a turn changes roll and pitch, which swings a high point.
        let swing_ahead = lever.ahead_by_heading * rate.heading;
        let swing_right = lever.right_by_heading * rate.heading;
        let (swing_north, swing_east) = (
            swing_ahead * c - swing_right * s,
            swing_ahead * s + swing_right * c,
        );
        Motion {
            north: self.state.north + ahead * c - right * s,
            east: self.state.east + ahead * s + right * c,
            height: 0.0,
            north_speed: rate.north - (ahead * s + right * c) * rate.heading + swing_north,
            east_speed: rate.east + (ahead * c - right * s) * rate.heading + swing_east,
            attitude: self.attitude(),
        }
    }

    /// Predicts the steering angle at `when` from the efforts known so far. It is much cheaper than
    /// [`Vehicle::state_at`], because every converter reading needs it.
    #[must_use]
    pub fn steering_at(&self, when: SimTime) -> f64 {
        let mut actuator = self.actuator;
        let mut angle = self.state.steering;
        let mut now = self.now;
        let changes = self
            .pending
            .iter()
            .filter(|(_, motor, _)| *motor == Motor::Steering);
        for &(from, _, effort) in changes.take_while(|(from, ..)| *from <= when) {
            angle = actuator.after(angle, span_seconds(since(from, now)));
            actuator.effort = effort;
            now = from;
        }
        actuator.after(angle, span_seconds(since(when, now)))
    }

    /// Voltage of the steering potentiometer at `when` as a converter reading, before noise and
    /// rounding.
    #[must_use]
    pub fn pot_at(&self, when: SimTime) -> f64 {
        self.parameters.pot_centre.get() + self.parameters.pot_slope.get() * self.steering_at(when)
    }

    /// The vehicle's constants.
    #[must_use]
    pub fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// One classical Runge-Kutta step for the pose. Steering and speed are exact, because their
    /// inputs are constant over the step.
    fn step(&mut self, step: f64) {
        let steering = self.state.steering;
        // A drive without lag has its new speed from the beginning of the step.
        let speed = self.drive.after(self.state.speed, 0.0);
        let half = (
            self.actuator.after(steering, step / 2.0),
            self.drive.after(speed, step / 2.0),
        );
        let full = (
            self.actuator.after(steering, step),
            self.drive.after(speed, step),
        );
        let heading = self.state.heading;
        let k1 = self.pose_rate(heading, steering, speed);
        let k2 = self.pose_rate(heading + step / 2.0 * k1.heading, half.0, half.1);
        let k3 = self.pose_rate(heading + step / 2.0 * k2.heading, half.0, half.1);
        let k4 = self.pose_rate(heading + step * k3.heading, full.0, full.1);
        let mean = |part: fn(&Pose) -> f64| {
            step / 6.0 * (part(&k1) + 2.0 * part(&k2) + 2.0 * part(&k3) + part(&k4))
        };
        self.state = State {
            north: self.state.north + mean(|k| k.north),
            east: self.state.east + mean(|k| k.east),
            heading: heading + mean(|k| k.heading),
            steering: full.0,
            speed: full.1,
        };
    }

    fn pose_rate(&self, heading: f64, steering: f64, speed: f64) -> Pose {
        let length = self.parameters.wheelbase();
        let wheels = steering + self.parameters.steering_bias.get();
        let ahead = speed * (1.0 - self.ground.wheel_slip.get());

        let centripetal = ahead * ahead * tan(wheels) / length;
        let downhill =
            GRAVITY * sin(self.ground.slope.get()) * sin(self.ground.downhill.get() - heading);
        let load = (centripetal - downhill) / GRAVITY;
        let front = self.ground.front_slip.get() * load;
        let rear = self.ground.rear_slip.get() * load;

        // Slip turns each axle's direction of travel away from the lateral force on its tyres, both
        // forwards and in reverse.
        let way = if ahead < 0.0 { -1.0 } else { 1.0 };
        let sideways = -ahead * tan(way * rear);
        let turn = (ahead * tan(wheels - way * front) - sideways) / length;
        Pose {
            north: ahead * cos(heading) - sideways * sin(heading),
            east: ahead * sin(heading) + sideways * cos(heading),
            heading: turn,
        }
    }
}

/// `angle` wrapped to -pi to pi.
#[must_use]
pub fn wrap(angle: f64) -> f64 {
    atan2(sin(angle), cos(angle))
}

/// Moves a vehicle for `span` seconds with constant efforts; for tests and examples.
pub fn drive_for(vehicle: &mut Vehicle, span: f64, steering: f64, drive: f64) {
    let now = vehicle.now();
    vehicle.set_effort(now, Motor::Steering, steering);
    vehicle.set_effort(now, Motor::Drive, drive);
    vehicle.advance_to(at(from_seconds(seconds(now) + span)));
}
