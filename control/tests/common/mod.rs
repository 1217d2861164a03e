//! A simulated vehicle for closed-loop tests: a kinematic bicycle model on a slope,
//! actuators with limits and dead bands, and a noisy receiver with a delay.

#![allow(dead_code, reason = "each test uses some of it")]

pub(crate) mod example;
pub(crate) mod field;

use control::calibration::{Actuator, Direction};
use control::controller::Sample;
use control::feedback::Limits;
use control::model::{Antenna, Geometry};
use control::position::{Position, Velocity};
use control::safety::Command;
use control::tilt::Tilt;
use control::vehicle::{Description, Misalignment, degrees};
use std::collections::VecDeque;

/// Seeded random numbers, the same on every machine: SplitMix64 and Box-Muller.
pub(crate) struct Noise {
    state: u64,
}

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
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
    pub(crate) fn uniform(&mut self) -> f64 {
        ((self.next() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64
    }

    /// Normal with mean zero and unit variance.
    pub(crate) fn normal(&mut self) -> f64 {
        (-2.0 * self.uniform().ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }
}

/// A random vehicle within the accepted ranges.
pub(crate) fn random(noise: &mut Noise) -> Description {
    let mut between = |least: f64, most: f64| least + (most - least) * noise.uniform();
    // Wheelbase and speed are distributed evenly over their logarithm.
    let wheelbase = 0.4 * 10.0_f64.powf(between(0.0, 1.0));
    let cruise = 0.3 * 10.0_f64.powf(between(0.0, 1.0));
    let steering_angle = degrees(between(15.0, 45.0));
    let l1 = wheelbase * between(-0.4, 2.0);
    let beside = 0.5 * wheelbase / steering_angle.tan();
    Description {
        geometry: Geometry {
            l1,
            l2: wheelbase - l1,
        },
        antenna: Antenna {
            right: between(-beside, beside),
            height: 2.0,
        },
        limits: Limits {
            steering_angle,
            steering_rate: degrees(between(10.0, 60.0)),
            speed: cruise * between(1.0, 2.0),
        },
        cruise,
        period: [0.1, 0.05][usize::from(between(0.0, 1.0) > 0.7)],
        drive_lag: between(0.1, 0.6),
        acceleration: 0.7 * cruise,
        cornering: between(2.0, 20.0),
        misalignment: Misalignment {
            heading: degrees(between(0.1, 5.0)),
            steering: degrees(between(0.1, 5.0)),
        },
        weights: None,
        ..example::VEHICLE
    }
}

/// Conditions of a run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Conditions {
    /// Antenna to the right of the line at the start, m.
    pub(crate) offset: f64,
    /// Heading at the start, rad.
    pub(crate) heading: f64,
    /// Speed at the start, m/s.
    pub(crate) speed: f64,
    /// Slope of the ground, rad, positive if it falls to the right of the line.
    pub(crate) slope: f64,
    /// Error of the potentiometer, rad, positive if it reads too far to the right.
    pub(crate) steering_bias: f64,
    /// Error of the measured course, rad, positive if it reads too far clockwise.
    pub(crate) heading_bias: f64,
    /// Rate of the actuator as a share of the calibrated one.
    pub(crate) actuator: f64,
    /// Standard deviation of the receiver's position, m.
    pub(crate) position_noise: f64,
    /// Standard deviation of the receiver's velocity, m/s.
    pub(crate) velocity_noise: f64,
    /// Age of GPS data on arrival, s.
    pub(crate) delay: f64,
    /// Speed over ground as a share of the commanded one.
    pub(crate) drive: f64,
    /// Distance of the axles as a share of the described one.
    pub(crate) wheelbase: f64,
    /// Steps from one measurement of the receiver to the next.
    pub(crate) every: u32,
    /// The ground that rolls and pitches the vehicle.
    pub(crate) ground: Ground,
}

/// The shape of the ground. It moves the antenna; that a slope turns the course is [`Conditions::slope`].
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Ground {
    /// Fall to the east and rise to the north, rad.
    pub(crate) side: f64,
    pub(crate) climb: f64,
    /// Waves that run north-east: the slope of their flanks, rad, and their length, m. A slope of zero means none.
    pub(crate) waves: (f64, f64),
}

impl Ground {
    /// Roll and pitch of a vehicle there.
    fn tilt(&self, north: f64, east: f64, heading: f64) -> Tilt<f64> {
        let (slope, length) = self.waves;
        let wave = if slope == 0.0 {
            0.0
        } else {
            let along = (north + east) * std::f64::consts::FRAC_1_SQRT_2;
            slope.tan() * (std::f64::consts::TAU * along / length).cos()
        };
        let rise = wave * std::f64::consts::FRAC_1_SQRT_2;
        let (to_north, to_east) = (self.climb.tan() + rise, rise - self.side.tan());
        let (sine, cosine) = heading.sin_cos();
        let ahead = to_north * cosine + to_east * sine;
        let fall = to_north * sine - to_east * cosine;
        let pitch = ahead.atan();
        Tilt {
            roll: (fall * pitch.cos()).atan(),
            pitch,
        }
    }
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
            drive: 1.0,
            wheelbase: 1.0,
            every: 1,
            ground: Ground::default(),
        }
    }
}

impl Conditions {
    /// A filled sprayer on a slope of 3 degrees with misaligned sensors: a slower
    /// actuator, 2 degrees of steering bias, 1 degree of heading bias.
    pub(crate) fn loaded() -> Self {
        Self {
            slope: 3.0_f64.to_radians(),
            steering_bias: 2.0_f64.to_radians(),
            heading_bias: 1.0_f64.to_radians(),
            actuator: 0.7,
            ..Self::default()
        }
    }
}

/// The example's distance from the rear axle to the antenna, m.
pub(crate) const L1: f64 = example::VEHICLE.geometry.l1;
/// The example's largest steering angle, rad.
pub(crate) const LIMIT: f64 = example::VEHICLE.limits.steering_angle;
/// Radius of the example's tightest turn, m.
pub(crate) fn tightest() -> f64 {
    (L1 + example::VEHICLE.geometry.l2) / LIMIT.tan()
}

/// The actuator's calibration as the steering node of `vehicle` has it.
pub(crate) fn actuator(vehicle: &Description) -> Actuator<f64> {
    let full_rate = vehicle.limits.steering_rate;
    Actuator {
        positive: Direction {
            dead_band: 0.10,
            full_rate,
        },
        negative: Direction {
            dead_band: 0.12,
            full_rate,
        },
    }
}

/// The simulated vehicle.
pub(crate) struct Plant {
    pub(crate) vehicle: Description,
    pub(crate) conditions: Conditions,
    pub(crate) time: f64,
    /// Rear axle, m.
    pub(crate) north: f64,
    pub(crate) east: f64,
    pub(crate) heading: f64,
    pub(crate) steering: f64,
    pub(crate) speed: f64,
    /// Commanded speed behind the limit of the acceleration, m/s.
    driven: f64,
    /// Course minus heading, rad.
    pub(crate) crab: f64,
    noise: Noise,
    history: VecDeque<(f64, [f64; 6])>,
    /// Cycles so far.
    cycles: u32,
}

/// Measurements of one cycle.
pub(crate) struct Heard {
    /// Whether position and velocity arrived in this cycle.
    pub(crate) arrived: bool,
    pub(crate) position: Position,
    pub(crate) velocity: Velocity,
    /// Roll and pitch when these were measured, exactly.
    pub(crate) tilt: Tilt<f64>,
    pub(crate) steering_angle: f64,
}

impl Heard {
    /// The sample of a control step in an autonomous run, `dt` (s) after the last one, under the command `applied`.
    pub(crate) fn sample(&self, applied: Command<f32>, dt: f32) -> Sample<f32> {
        Sample {
            position: self.arrived.then_some(self.position),
            velocity: self.arrived.then_some(self.velocity),
            steering_angle: Some(self.steering_angle as f32),
            applied,
            engaged: true,
            dt,
        }
    }
}

/// A command of the law as the simulated vehicle takes it.
pub(crate) fn wide(command: Command<f32>) -> Command<f64> {
    Command {
        steering_rate: command.steering_rate.into(),
        speed: command.speed.into(),
    }
}

const STEP: f64 = 0.001;
const GRAVITY: f64 = 9.81;

impl Plant {
    /// The example vehicle.
    pub(crate) fn new(conditions: Conditions, seed: u64) -> Self {
        Self::of(example::VEHICLE, conditions, seed)
    }

    /// Any vehicle. It starts with the point of its centre line beside the
    /// antenna at the origin, moved by the offset.
    pub(crate) fn of(vehicle: Description, conditions: Conditions, seed: u64) -> Self {
        let l1 = vehicle.geometry.l1;
        Self {
            vehicle,
            conditions,
            time: 0.0,
            north: -l1 * conditions.heading.cos(),
            east: conditions.offset - l1 * conditions.heading.sin(),
            heading: conditions.heading,
            steering: 0.0,
            speed: conditions.speed,
            driven: conditions.speed,
            crab: 0.0,
            noise: Noise::new(seed),
            history: VecDeque::new(),
            cycles: 0,
        }
    }

    /// The antenna, m north and east.
    pub(crate) fn antenna(&self) -> (f64, f64) {
        let (ahead, right) = self.lever();
        let (north, east) = self.point(ahead);
        (
            north - right * self.heading.sin(),
            east + right * self.heading.cos(),
        )
    }

    /// Roll and pitch.
    pub(crate) fn tilt(&self) -> Tilt<f64> {
        let ground = &self.conditions.ground;
        ground.tilt(self.north, self.east, self.heading)
    }

    /// The antenna over the ground, m ahead of the rear axle and right of the centre line: its place in the body, turned by
    /// roll and pitch.
    fn lever(&self) -> (f64, f64) {
        let Tilt { roll, pitch } = self.tilt();
        let Antenna { right, height } = self.vehicle.antenna;
        let (across, above) = (
            right * roll.cos() + height * roll.sin(),
            height * roll.cos() - right * roll.sin(),
        );
        let ahead = self.vehicle.geometry.l1;
        (ahead * pitch.cos() - above * pitch.sin(), across)
    }

    /// The point held on the line, m north and east: beside the antenna, or
    /// the rear axle when the antenna is behind it.
    pub(crate) fn controlled(&self) -> (f64, f64) {
        self.point(self.vehicle.geometry.l1.max(0.0))
    }

    /// A point `ahead` metres ahead of the rear axle.
    pub(crate) fn point(&self, ahead: f64) -> (f64, f64) {
        (
            self.north + ahead * self.heading.cos(),
            self.east + ahead * self.heading.sin(),
        )
    }

    /// Drives for `seconds` under `command`.
    pub(crate) fn drive(&mut self, command: Command<f64>, seconds: f64) {
        // The motor driver takes its command in one byte.
        let actuator = actuator(&self.vehicle);
        let effort = (actuator.effort(command.steering_rate) * 127.0).round() / 127.0;
        let rate = actuator.rate(effort) * self.conditions.actuator;
        let limit = self.vehicle.limits.steering_angle;
        let wheelbase = self.vehicle.geometry.wheelbase() * self.conditions.wheelbase;
        let mut before = self.lever();
        for _ in 0..(seconds / STEP).round() as usize {
            self.steering = (self.steering + rate * STEP).clamp(-limit, limit);
            // The drive node limits the acceleration.
            let forth = self.driven * command.speed >= 0.0;
            let from = if forth { self.driven.abs() } else { 0.0 };
            let largest = from + self.vehicle.acceleration * STEP;
            self.driven = command.speed.clamp(-largest, largest);
            let wanted = self.driven * self.conditions.drive;
            self.speed += (wanted - self.speed) * STEP / self.vehicle.drive_lag;
            // Both axles have the same slip angle, for they carry the same force
            // per load. That turns the course, but to first order not the
            // vehicle.
            let turn = self.speed * self.steering.tan() / wheelbase;
            let downhill = GRAVITY * self.conditions.slope.sin() * self.heading.cos();
            // The tyres slip to the side of the force, whichever way they roll.
            let way = if self.speed < 0.0 { -1.0 } else { 1.0 };
            self.crab = way * (downhill - self.speed * turn) / (GRAVITY * self.vehicle.cornering);
            let course = self.heading + self.crab;
            let (north, east) = (self.speed * course.cos(), self.speed * course.sin());
            let (ahead, right) = self.lever();
            // How fast roll and pitch swing the antenna ahead and to the right.
            let swing = ((ahead - before.0) / STEP, (right - before.1) / STEP);
            before = (ahead, right);
            let (sine, cosine) = self.heading.sin_cos();
            let velocity = (
                north - turn * (ahead * sine + right * cosine) + swing.0 * cosine - swing.1 * sine,
                east + turn * (ahead * cosine - right * sine) + swing.0 * sine + swing.1 * cosine,
            );
            self.north += north * STEP;
            self.east += east * STEP;
            self.heading += turn * STEP;
            self.time += STEP;
            let (north, east) = self.antenna();
            let Tilt { roll, pitch } = self.tilt();
            self.history.push_back((
                self.time,
                [north, east, velocity.0, velocity.1, roll, pitch],
            ));
        }
        while self
            .history
            .front()
            .is_some_and(|(time, _)| *time < self.time - 0.5)
        {
            self.history.pop_front();
        }
    }

    /// The measurements of the sensors now.
    pub(crate) fn hear(&mut self) -> Heard {
        let then = self.time - self.conditions.delay;
        let (north, east) = self.antenna();
        let Tilt { roll, pitch } = self.tilt();
        let seen = self
            .history
            .iter()
            .rev()
            .find(|(time, _)| *time <= then + STEP / 2.0)
            .or(self.history.front())
            .map_or([north, east, 0.0, 0.0, roll, pitch], |(_, seen)| *seen);
        let [north, east, vn, ve, roll, pitch] = seen;
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
        let arrived = self.cycles.is_multiple_of(self.conditions.every);
        self.cycles += 1;
        Heard {
            arrived,
            position,
            velocity,
            tilt: Tilt { roll, pitch },
            steering_angle: (counts / 40.0).to_radians(),
        }
    }
}

/// Record of a run.
#[derive(Clone, Debug, Default)]
pub(crate) struct Run {
    /// Cross-track error of the controlled point in each period (of 0.1 s in
    /// the example), m.
    pub(crate) errors: Vec<f64>,
    /// Steering rate commands, rad/s.
    pub(crate) commands: Vec<f64>,
    /// Steering angle, rad.
    pub(crate) steering: Vec<f64>,
    /// Time between two of these, s.
    pub(crate) period: f64,
}

impl Run {
    /// Time from which the error stays within 5 cm, s.
    pub(crate) fn settled(&self) -> f64 {
        self.settled_within(0.05)
    }

    /// Time from which the error stays within a limit (m), s.
    pub(crate) fn settled_within(&self, limit: f64) -> f64 {
        let last = self.errors.iter().rposition(|error| error.abs() > limit);
        last.map_or(0.0, |last| (last + 1) as f64 * self.period)
    }

    /// Mean and standard deviation of the error from `after` seconds on, m.
    pub(crate) fn error(&self, after: f64) -> (f64, f64) {
        let steady = &self.errors[(after / self.period) as usize..];
        let count = steady.len() as f64;
        let mean = steady.iter().sum::<f64>() / count;
        let square = steady.iter().map(|e| (e - mean).powi(2)).sum::<f64>() / count;
        (mean, square.sqrt())
    }

    /// Changes of the command's sign per second from `after` seconds on. Zeros are
    /// ignored.
    pub(crate) fn sign_changes(&self, after: f64) -> f64 {
        let steady = &self.commands[(after / self.period) as usize..];
        let mut last = 0.0;
        let mut changes = 0;
        for &command in steady.iter().filter(|command| **command != 0.0) {
            if command * last < 0.0 {
                changes += 1;
            }
            last = command;
        }
        f64::from(changes) / (steady.len() as f64 * self.period)
    }
}

/// Runs the example vehicle under `law` for `seconds`.
pub(crate) fn run(
    conditions: Conditions,
    seed: u64,
    seconds: f64,
    law: impl FnMut(&Heard, Command<f64>) -> Command<f64>,
) -> Run {
    run_plant(Plant::new(conditions, seed), seconds, law)
}

/// Runs `plant` under `law` for `seconds`.
pub(crate) fn run_plant(
    mut plant: Plant,
    seconds: f64,
    mut law: impl FnMut(&Heard, Command<f64>) -> Command<f64>,
) -> Run {
    let conditions = plant.conditions;
    let period = plant.vehicle.period;
    let mut command = Command {
        steering_rate: 0.0,
        speed: conditions.speed,
    };
    let mut run = Run {
        period,
        ..Run::default()
    };
    for _ in 0..(seconds / period).round() as usize {
        let heard = plant.hear();
        command = law(&heard, command);
        // Message 300 carries hundredths of a degree a second.
        command.steering_rate = (command.steering_rate.to_degrees() * 100.0).round() / 100.0;
        command.steering_rate = command.steering_rate.to_radians();
        run.errors.push(plant.controlled().1);
        run.commands.push(command.steering_rate);
        run.steering.push(plant.steering);
        plant.drive(command, period);
    }
    run
}
