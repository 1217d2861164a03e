//! A simulated vehicle for closed-loop tests: a kinematic bicycle on a slope,
//! its actuators with limits and dead bands, and a late, noisy receiver.

#![allow(dead_code, reason = "each test uses its part")]

use control::calibration::{Actuator, Direction};
use control::position::{Position, Velocity};
use control::safety::Command;
use std::collections::VecDeque;

/// SplitMix64 and Box-Muller: small, seeded, the same everywhere.
pub struct Noise {
    state: u64,
}

impl Noise {
    pub fn new(seed: u64) -> Self {
        Self {
            state: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) ^ 0x1234_5678_9ABC_DEF0,
        }
    }

    fn next(&mut self) -> u64 {
        self.state = self.state.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.state;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Uniform in (0, 1).
    pub fn uniform(&mut self) -> f64 {
        ((self.next() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// Normal with mean zero and unit variance.
    pub fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// What distinguishes one run from another.
#[derive(Clone, Copy, Debug)]
pub struct Conditions {
    /// Antenna to the right of the line at the start, m.
    pub offset: f64,
    /// Heading at the start, rad.
    pub heading: f64,
    /// Speed at the start, m/s.
    pub speed: f64,
    /// Slope of the ground, falling to the right of the line, rad.
    pub slope: f64,
    /// Potentiometer reads this much too far right, rad.
    pub steering_bias: f64,
    /// Velocity vector reads this much too far clockwise, rad.
    pub heading_bias: f64,
    /// Actuator's rate as a share of the calibrated one.
    pub actuator: f64,
    /// Standard deviation of the receiver's position, m.
    pub position_noise: f64,
    /// Standard deviation of the receiver's velocity, m/s.
    pub velocity_noise: f64,
    /// Age of GPS data on arrival, s.
    pub delay: f64,
}

impl Default for Conditions {
    fn default() -> Self {
        Self {
            offset: 1.0,
            heading: 0.0,
            speed: 0.0,
            slope: 0.0,
            steering_bias: 0.0,
            heading_bias: 0.0,
            actuator: 1.0,
            position_noise: 0.01,
            velocity_noise: 0.02,
            delay: 0.055,
        }
    }
}

impl Conditions {
    /// Filled sprayer on a slope of 3 degrees, sensors misaligned: slower
    /// actuator, 2 degrees of steering bias, 1 degree of heading bias.
    pub fn loaded() -> Self {
        Self {
            slope: 3.0_f64.to_radians(),
            steering_bias: 2.0_f64.to_radians(),
            heading_bias: 1.0_f64.to_radians(),
            actuator: 0.7,
            ..Self::default()
        }
    }
}

pub const WHEELBASE: f64 = 1.1;
pub const L1: f64 = 0.255;
pub const LIMIT: f64 = 25.0 * std::f64::consts::PI / 180.0;
/// Radius of the tightest turn, m.
pub fn tightest() -> f64 {
    WHEELBASE / LIMIT.tan()
}

/// The actuator's calibration as the steering node has it.
pub fn actuator() -> Actuator<f64> {
    Actuator {
        positive: Direction {
            dead_band: 0.10,
            full_rate: LIMIT,
        },
        negative: Direction {
            dead_band: 0.12,
            full_rate: LIMIT,
        },
    }
}

/// The vehicle itself.
pub struct Plant {
    pub conditions: Conditions,
    pub time: f64,
    /// Rear axle, m.
    pub north: f64,
    pub east: f64,
    pub heading: f64,
    pub steering: f64,
    pub speed: f64,
    /// Course less heading, rad.
    pub crab: f64,
    noise: Noise,
    history: VecDeque<(f64, [f64; 4])>,
}

/// What the nodes hear in one cycle.
pub struct Heard {
    pub position: Position,
    pub velocity: Velocity,
    pub steering_angle: f64,
}

const STEP: f64 = 0.001;
const GRAVITY: f64 = 9.81;
/// Slip angle of a tyre for a lateral force of the weight it carries, rad: a
/// cornering coefficient of 4 (Wong, Theory of Ground Vehicles).
const SLIP: f64 = 0.25;

impl Plant {
    pub fn new(conditions: Conditions, seed: u64) -> Self {
        Self {
            conditions,
            time: 0.0,
            north: -L1 * conditions.heading.cos(),
            east: conditions.offset - L1 * conditions.heading.sin(),
            heading: conditions.heading,
            steering: 0.0,
            speed: conditions.speed,
            crab: 0.0,
            noise: Noise::new(seed),
            history: VecDeque::new(),
        }
    }

    /// The antenna, m north and east.
    pub fn antenna(&self) -> (f64, f64) {
        self.point(L1)
    }

    /// A point `ahead` metres ahead of the rear axle.
    pub fn point(&self, ahead: f64) -> (f64, f64) {
        (
            self.north + ahead * self.heading.cos(),
            self.east + ahead * self.heading.sin(),
        )
    }

    /// Drives for `seconds` under `command`.
    pub fn drive(&mut self, command: Command<f64>, seconds: f64) {
        // The driver takes one byte.
        let effort = (actuator().effort(command.steering_rate) * 127.0).round() / 127.0;
        let rate = actuator().rate(effort) * self.conditions.actuator;
        for _ in 0..(seconds / STEP).round() as usize {
            self.steering = (self.steering + rate * STEP).clamp(-LIMIT, LIMIT);
            self.speed += (command.speed - self.speed) * STEP / 0.3;
            // Both axles slip alike: by the force they carry, which turns the
            // course but, in the first order, not the vehicle.
            let turn = self.speed * self.steering.tan() / WHEELBASE;
            let downhill = GRAVITY * self.conditions.slope.sin() * self.heading.cos();
            self.crab = SLIP * (downhill - self.speed * turn) / GRAVITY;
            let course = self.heading + self.crab;
            let (north, east) = (self.speed * course.cos(), self.speed * course.sin());
            let velocity = (
                north - L1 * turn * self.heading.sin(),
                east + L1 * turn * self.heading.cos(),
            );
            self.north += north * STEP;
            self.east += east * STEP;
            self.heading += turn * STEP;
            self.time += STEP;
            let (north, east) = self.antenna();
            self.history
                .push_back((self.time, [north, east, velocity.0, velocity.1]));
        }
        while self
            .history
            .front()
            .is_some_and(|(time, _)| *time < self.time - 0.5)
        {
            self.history.pop_front();
        }
    }

    /// What the sensors say now.
    pub fn hear(&mut self) -> Heard {
        let then = self.time - self.conditions.delay;
        let (north, east) = self.antenna();
        let seen = self
            .history
            .iter()
            .rev()
            .find(|(time, _)| *time <= then + STEP / 2.0)
            .or(self.history.front())
            .map_or([north, east, 0.0, 0.0], |(_, seen)| *seen);
        let [north, east, vn, ve] = seen;
        let mut noisy = |value: f64, deviation: f64| value + deviation * self.noise.normal();
        let millimetres = |value: f64| (value * 1e3).round() as i32;
        let bias = self.conditions.heading_bias;
        let (vn, ve) = (
            vn * bias.cos() - ve * bias.sin(),
            vn * bias.sin() + ve * bias.cos(),
        );
        let position = Position::new(
            millimetres(noisy(north, self.conditions.position_noise)),
            millimetres(noisy(east, self.conditions.position_noise)),
        );
        let velocity = Velocity::new(
            millimetres(noisy(vn, self.conditions.velocity_noise)),
            millimetres(noisy(ve, self.conditions.velocity_noise)),
        );
        let counts = 40.0 * (self.steering + self.conditions.steering_bias).to_degrees();
        let counts = noisy(counts, 1.0).round();
        Heard {
            position,
            velocity,
            steering_angle: (counts / 40.0).to_radians(),
        }
    }
}

/// Figures of one run.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Cross-track error of the antenna each 0.1 s, m.
    pub errors: Vec<f64>,
    /// Steering rate commands, rad/s.
    pub commands: Vec<f64>,
    /// Steering angle, rad.
    pub steering: Vec<f64>,
}

impl Run {
    /// Time from which the error stays within 5 cm, s.
    pub fn settled(&self) -> f64 {
        let last = self.errors.iter().rposition(|error| error.abs() > 0.05);
        last.map_or(0.0, |last| (last + 1) as f64 * 0.1)
    }

    /// Mean and standard deviation of the error from `after` seconds on, m.
    pub fn error(&self, after: f64) -> (f64, f64) {
        let steady = &self.errors[(after * 10.0) as usize..];
        let count = steady.len() as f64;
        let mean = steady.iter().sum::<f64>() / count;
        let square = steady.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / count;
        (mean, square.sqrt())
    }

    /// Changes of the command's sign for each second from `after` seconds on;
    /// zeros between are passed over.
    pub fn sign_changes(&self, after: f64) -> f64 {
        let steady = &self.commands[(after * 10.0) as usize..];
        let mut last = 0.0;
        let mut changes = 0;
        for &command in steady.iter().filter(|command| **command != 0.0) {
            if command * last < 0.0 {
                changes += 1;
            }
            last = command;
        }
        f64::from(changes) / (steady.len() as f64 * 0.1)
    }
}

/// Runs `law` in closed loop for `seconds`.
pub fn run(
    conditions: Conditions,
    seed: u64,
    seconds: f64,
    mut law: impl FnMut(&Heard, Command<f64>) -> Command<f64>,
) -> Run {
    let mut plant = Plant::new(conditions, seed);
    let mut command = Command {
        steering_rate: 0.0,
        speed: conditions.speed,
    };
    let mut run = Run::default();
    for _ in 0..(seconds * 10.0).round() as usize {
        let heard = plant.hear();
        command = law(&heard, command);
        // Message 300 carries hundredths of a degree a second.
        command.steering_rate = (command.steering_rate.to_degrees() * 100.0).round() / 100.0;
        command.steering_rate = command.steering_rate.to_radians();
        run.errors.push(plant.antenna().1);
        run.commands.push(command.steering_rate);
        run.steering.push(plant.steering);
        plant.drive(command, 0.1);
    }
    run
}
