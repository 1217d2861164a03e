//! The bounds of `control::response`, over random vehicles and faults: how far a vehicle goes that does not do what it
//! is told, and how soon its run ends. And that a sound vehicle's run does not end.

mod common;

use common::example::VEHICLE;
use common::{Conditions, Noise, Plant, random};
use control::controller::{Controller, Sample, Settings};
use control::line::Line;
use control::mission::slowest;
use control::position::Position;
use control::response::{Departure, Response, ResponseSettings, ResponseWatch};
use control::safety::Command;
use control::vehicle::Description;

/// Random vehicles of each test.
const VEHICLES: u64 = 300;
/// Seed of the first one. The checks were written while others were tried.
const FIRST_SEED: u64 = 65_001;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    SteeringDead,
    SteeringReversed,
    PotentiometerFrozen,
    PotentiometerReversed,
    DriveDead,
    DriveReversed,
    NoVelocity,
}

const FAULTS: [Fault; 7] = [
    Fault::SteeringDead,
    Fault::SteeringReversed,
    Fault::PotentiometerFrozen,
    Fault::PotentiometerReversed,
    Fault::DriveDead,
    Fault::DriveReversed,
    Fault::NoVelocity,
];

/// How a run went after its fault.
#[derive(Debug, Default)]
struct Course {
    /// Time from the fault until the run ended, s, and why.
    ended: Option<(f64, Departure)>,
    /// Longest time for which the steering was told at least nine tenths of its rate, in one direction, s.
    saturated: f64,
    /// Largest distance from the line beyond what the bound takes as its base, m: 0 for a run that was on its line,
    /// or the least distance so far.
    farthest: f64,
    captured: bool,
    speed: f64,
}

/// What the watch knows of the distance: time near the line, s, and the least distance, m.
#[derive(Default)]
struct Place {
    near: f64,
    least: f64,
}

impl Place {
    fn see(&mut self, distance: f64, period: f64) {
        if distance < 0.3 {
            self.near += period;
        } else if self.near < 3.0 {
            self.near = 0.0;
        }
        self.least = self.least.min(distance);
    }
}

impl Fault {
    /// What the motors make of a command.
    fn obeyed(self, command: Command<f64>) -> Command<f64> {
        let Command {
            steering_rate,
            speed,
        } = command;
        let (steering_rate, speed) = match self {
            Self::SteeringDead => (0.0, speed),
            Self::SteeringReversed => (-steering_rate, speed),
            Self::DriveDead => (steering_rate, 0.0),
            Self::DriveReversed => (steering_rate, -speed),
            _ => (steering_rate, speed),
        };
        Command {
            steering_rate,
            speed,
        }
    }
}

/// Drives for at most `seconds`; the fault comes after `after` seconds.
fn drive(
    vehicle: Description,
    conditions: Conditions,
    seed: u64,
    fault: Fault,
    after: f64,
    seconds: f64,
) -> Course {
    let settings = Settings::<f32>::for_vehicle(&vehicle).unwrap();
    drive_by(settings, vehicle, conditions, seed, fault, after, seconds)
}

/// The same with other settings of the law.
fn drive_by(
    settings: Settings<f32>,
    vehicle: Description,
    conditions: Conditions,
    seed: u64,
    fault: Fault,
    after: f64,
    seconds: f64,
) -> Course {
    let line = Line::new(Position::new(0, 0), Position::new(5_000_000, 0)).unwrap();
    let mut controller = Controller::new(settings, line).unwrap();
    let mut watch = ResponseWatch::new(ResponseSettings::of(&settings));
    let mut plant = Plant::of(vehicle, conditions, seed);
    let mut applied = Command::<f32>::still();
    let (mut course, mut place) = (Course::default(), Place::default());
    let (mut saturated, mut frozen) = (0.0_f64, None);
    for _ in 0..(seconds / vehicle.period) as usize {
        let heard = plant.hear();
        let faulty = plant.time >= after;
        let now = if faulty { fault } else { Fault::None };
        let angle = match now {
            Fault::PotentiometerFrozen => *frozen.get_or_insert(heard.steering_angle),
            Fault::PotentiometerReversed => -heard.steering_angle,
            _ => heard.steering_angle,
        };
        let velocity = (heard.arrived && now != Fault::NoVelocity).then_some(heard.velocity);
        let sample = Sample {
            position: heard.arrived.then_some(heard.position),
            velocity,
            steering_angle: Some(angle as f32),
            applied,
            engaged: true,
            dt: vehicle.period as f32,
        };
        let outcome = controller.step(&sample);
        let departure = watch.step(&Response::of(&sample, &outcome));
        let real = plant.controlled().1.abs();
        if controller.estimator().is_ready() {
            let distance = f64::from(outcome.tracking.cross_track).abs();
            place.see(distance, vehicle.period);
        } else {
            place.least = real;
        }
        course.captured = place.near >= 3.0;
        let base = if course.captured { 0.0 } else { place.least };
        if faulty {
            course.farthest = course.farthest.max(real - base);
            course.speed = course.speed.max(plant.speed.abs());
        }
        if let Some(what) = departure {
            course.ended = Some((plant.time - after, what));
            return course;
        }
        let command = Command {
            steering_rate: f64::from(outcome.command.steering_rate),
            speed: f64::from(outcome.command.speed),
        };
        let limit = vehicle.limits.steering_rate;
        let full = faulty && command.steering_rate.abs() >= 0.9 * limit;
        // At its stop the steering has nothing to follow.
        let outwards = angle * command.steering_rate > 0.0;
        let full = full && !(outwards && angle.abs() > 0.85 * vehicle.limits.steering_angle);
        let same = command.steering_rate * f64::from(applied.steering_rate) >= 0.0;
        saturated = if full && same {
            saturated + vehicle.period
        } else {
            0.0
        };
        course.saturated = course.saturated.max(saturated);
        applied = outcome.command;
        let obeyed = now.obeyed(command);
        plant.drive(obeyed, vehicle.period);
    }
    course
}

/// Whether velocities of 3 cm/s of noise tell the course of a vehicle with 70 % of its speed, and the antenna is not so
/// far from the wheels that its place hides the vehicle's.
fn is_told(vehicle: &Description) -> bool {
    let length = vehicle.geometry.wheelbase();
    let ahead = vehicle.geometry.l1 / length;
    let beside = vehicle.antenna.right / length;
    vehicle.cruise >= 0.65 && (-0.4..=1.2).contains(&ahead) && beside.abs() <= 0.2
}

/// A random vehicle with a random receiver, on random ground.
fn drawn(seed: u64) -> (Description, Conditions, Noise) {
    let mut noise = Noise::new(seed + FIRST_SEED);
    let mut vehicle = loop {
        let vehicle = random(&mut noise);
        if is_told(&vehicle) {
            break vehicle;
        }
    };
    vehicle.sensors.age = 0.25 * noise.uniform();
    let every = if noise.uniform() < 0.5 { 1 } else { 2 };
    vehicle.sensors.interval = f64::from(every) * vehicle.period;
    let sign = if noise.uniform() < 0.5 { -1.0 } else { 1.0 };
    let conditions = Conditions {
        offset: sign * (0.8 + 4.2 * noise.uniform()),
        heading: sign * 2.4 * noise.uniform(),
        delay: vehicle.sensors.age,
        every,
        slope: 0.1 * (noise.uniform() - 0.5),
        drive: 0.7 + 0.3 * noise.uniform(),
        actuator: 0.7 + 0.3 * noise.uniform(),
        velocity_noise: 0.03,
        ..Conditions::default()
    };
    (vehicle, conditions, noise)
}

/// The time after which what is asked for at a rate has filled a filter to a threshold, s.
fn judged(rate: f64, threshold: f64, constant: f64) -> f64 {
    let share = threshold / (rate * constant);
    if share < 1.0 {
        -constant * (1.0 - share).ln()
    } else {
        f64::INFINITY
    }
}

/// Over slopes, with 30 % of slip, a slow actuator and receivers of 10 and 5 Hz: two minutes of each vehicle.
#[test]
fn a_sound_vehicle_goes_on() {
    for seed in 0..VEHICLES {
        let (vehicle, conditions, _) = drawn(seed);
        let course = drive(vehicle, conditions, seed, Fault::None, 0.0, 120.0);
        assert_eq!(
            course.ended, None,
            "seed {seed}, {conditions:?}, {vehicle:?}"
        );
    }
}

/// With 30 % of slip the vehicle follows a leg of the smallest speed that a mission may have. Half of that leaves it
/// without a heading, which ends the run.
#[test]
fn the_slowest_leg_is_driven() {
    let settings = Settings::<f32>::for_vehicle(&VEHICLE).unwrap();
    let slowest = slowest(settings.estimator.standstill);
    for seed in 0..40 {
        let conditions = Conditions {
            offset: 0.3,
            drive: 0.7,
            velocity_noise: VEHICLE.sensors.velocity,
            ..Conditions::default()
        };
        let at = |cruise: f32| {
            let settings = Settings { cruise, ..settings };
            drive_by(settings, VEHICLE, conditions, seed, Fault::None, 0.0, 60.0).ended
        };
        assert_eq!(at(slowest), None, "seed {seed}");
        let ended = at(0.5 * slowest).map(|(_, why)| why);
        assert_eq!(ended, Some(Departure::Heading), "seed {seed}");
    }
}

/// Every fault, from the beginning or at any time of a run, ends the run, and within the bounds.
#[test]
fn each_fault_ends_the_run_within_its_bounds() {
    for fault in FAULTS {
        let mut latest = 0.0_f64;
        for seed in 0..VEHICLES {
            let (vehicle, conditions, mut noise) = drawn(seed);
            let after = if seed % 2 == 0 {
                0.0
            } else {
                60.0 * noise.uniform()
            };
            let course = drive(vehicle, conditions, seed, fault, after, after + 120.0);
            let name = format!("{fault:?} after {after:.1} s, seed {seed}: {course:?}");
            let (time, what) = course.ended.unwrap_or_else(|| panic!("{name}"));
            assert!(time >= 0.0, "before its fault: {name}");
            latest = latest.max(time);
            judge_distance(&name, &vehicle, fault, &course);
            judge_time(&name, &vehicle, fault, &course);
            let own = match fault {
                Fault::DriveReversed => vec![Departure::Course, Departure::Path],
                Fault::DriveDead => vec![Departure::Speed, Departure::Heading],
                Fault::NoVelocity => vec![Departure::Heading],
                _ => vec![Departure::Steering, Departure::Path, Departure::Course],
            };
            // A vehicle that stands or turns on the spot does not tell its heading.
            assert!(own.contains(&what) || what == Departure::Heading, "{name}");
        }
        println!("{fault:?}: at the latest after {latest:.1} s");
    }
}

/// However slowly a fault shows, the vehicle does not go farther away than this.
fn judge_distance(name: &str, vehicle: &Description, fault: Fault, course: &Course) {
    let settings = ResponseSettings::of(&Settings::<f64>::for_vehicle(vehicle).unwrap());
    let sensors = &vehicle.sensors;
    let way = course.speed * (0.5 + vehicle.period + sensors.age + sensors.interval);
    // The antenna of a vehicle that drives the other way is thought to be on its other side.
    let place = match fault {
        Fault::DriveReversed => {
            2.0 * (vehicle.geometry.l1.abs() + vehicle.antenna.right.abs()) + 0.3
        }
        _ => 0.3,
    };
    let most = if course.captured { 1.0 } else { settings.reach };
    assert!(course.farthest <= most + way + place, "{most} m: {name}");
}

/// A fault that is asked for much shows at once.
fn judge_time(name: &str, vehicle: &Description, fault: Fault, course: &Course) {
    let sensors = &vehicle.sensors;
    let step = vehicle.period;
    let (time, most) = match fault {
        Fault::SteeringDead => {
            let judged = judged(
                0.9 * vehicle.limits.steering_rate,
                5.0_f64.to_radians(),
                1.0,
            );
            (course.saturated, judged.max(5.0_f64.ln()) + step + 0.5)
        }
        Fault::DriveDead => {
            // The law asks for more as the vehicle is slower, so that the threshold is reached at any speed.
            let begin = judged(vehicle.cruise.max(0.31), 0.3, 1.0).min(3.0);
            let fall = 4.0_f64.ln() + 1.4 * vehicle.drive_lag + sensors.age + sensors.interval;
            let found = begin.max(fall) + step + 1.0 + sensors.interval;
            (
                course.ended.map_or(f64::INFINITY, |it| it.0),
                found.max(3.0 + fall - 4.0_f64.ln()),
            )
        }
        Fault::NoVelocity => (
            course.ended.map_or(f64::INFINITY, |it| it.0),
            3.0 + 2.0 * step,
        ),
        _ => return,
    };
    assert!(time <= most + step, "{most} s: {name}");
}
