//! Closed-loop tests with random vehicles: with the settings derived from its
//! description, each one comes onto its line and stays there.

mod common;

use common::{Conditions, Noise, Plant, Run, random, run_plant};
use control::controller::{Controller, Sample, Settings};
use control::dubins::{Pose, shortest_to_line};
use control::line::Line;
use control::position::Position;
use control::safety::Command;
use control::scalar::Scalar;
use control::vehicle::{Description, Sensors, Weights, degrees, source};

/// Number of random vehicles.
const VEHICLES: u64 = 400;

fn line() -> Line<f32> {
    Line::new(Position::new(0, 0), Position::new(5_000_000, 0)).unwrap()
}

fn cast<T: Scalar, U: Scalar>(command: Command<T>) -> Command<U> {
    Command {
        steering_rate: U::lit(command.steering_rate.as_f64()),
        speed: U::lit(command.speed.as_f64()),
    }
}

/// Random sensors. Age, velocity and steering cover the accepted ranges. The noise of positions
/// is 5 to 12 mm: 5 cm off the line are at least four standard deviations then. With less than
/// 5 mm, two of 400 vehicles lose the line: both drive at more than 2 m/s with the antenna two
/// wheelbases ahead of the rear axle. These tests do not cover them.
fn random_sensors(noise: &mut Noise) -> Sensors {
    let mut between = |least: f64, most: f64| least + (most - least) * noise.uniform();
    Sensors {
        position: between(0.005, 0.012),
        velocity: between(0.005, 0.04),
        steering: degrees(between(0.01, 0.2)),
        age: between(0.0, 0.1),
        interval: 0.1,
    }
}

/// A run in which the receiver is as the vehicle's description says.
fn described(vehicle: &Description) -> Conditions {
    Conditions {
        position_noise: vehicle.sensors.position,
        velocity_noise: vehicle.sensors.velocity,
        delay: vehicle.sensors.age,
        ..Conditions::default()
    }
}

fn drive(vehicle: Description, conditions: Conditions, seed: u64, seconds: f64) -> Run {
    let settings = Settings::<f32>::for_vehicle(&vehicle).unwrap();
    let mut controller = Controller::new(settings, line()).unwrap();
    let plant = Plant::of(vehicle, conditions, seed);
    run_plant(plant, seconds, |heard, applied| {
        cast(
            controller
                .step(&Sample {
                    position: heard.arrived.then_some(heard.position),
                    velocity: heard.arrived.then_some(heard.velocity),
                    steering_angle: Some(heard.steering_angle as f32),
                    applied: cast(applied),
                    engaged: true,
                    dt: vehicle.period as f32,
                })
                .command,
        )
    })
}

/// Time within which a vehicle must come from 1 m off within 5 cm of the line, s.
///
/// The allowed time is twice the time that the geometry requires, plus 8 s in
/// which the estimator finds heading and biases. The geometry requires the
/// shortest path onto the line at the radius of a swing, and the travel of the
/// steering to one side, to the other, and back.
fn allowed(vehicle: &Description, offset: f64, heading: f64) -> f64 {
    let settings = Settings::<f64>::for_vehicle(vehicle).unwrap();
    let swing = settings.guidance.swing * settings.guidance.limits.steering_angle;
    let start = Pose {
        north: -vehicle.geometry.l1 * heading.cos(),
        east: offset - vehicle.geometry.l1 * heading.sin(),
        heading,
    };
    let radius = vehicle.geometry.wheelbase() / swing.tan();
    let way = shortest_to_line(start, radius).unwrap().length();
    let travel = 4.0 * swing / vehicle.limits.steering_rate;
    2.0 * (way / vehicle.cruise + travel) + 8.0
}

/// From 1 m off, any vehicle comes within 5 cm of the line and stays there. Varied are
/// geometry, antenna, limits, cruise speed, period, drive lag, cornering and expected
/// misalignment; the weights are derived; the sensors are those of the example.
#[test]
fn any_sound_vehicle_settles() {
    for seed in 0..VEHICLES {
        let vehicle = random(&mut Noise::new(seed + 1));
        let allowed = allowed(&vehicle, 1.0, 0.0);
        let run = drive(vehicle, Conditions::default(), seed, allowed + 60.0);
        let settled = run.settled();
        assert!(
            settled <= allowed,
            "seed {seed}: {settled} s of {allowed} s, {vehicle:?}"
        );
        // No limit cycle in the minute after that: the error stays within 5 cm,
        // its standard deviation within half of that, and the steering reverses
        // less than once a second.
        let (mean, deviation) = run.error(allowed);
        assert!(
            mean.abs() < 0.02 && deviation < 0.025,
            "seed {seed}: mean {mean} m, deviation {deviation} m, {vehicle:?}"
        );
        let changes = run.sign_changes(allowed);
        assert!(
            changes < 1.0,
            "seed {seed}: {changes} reversals a second, {vehicle:?}"
        );
    }
}

/// The same from 1 m off with other sensors too. A noisy receiver moves the steering more often,
/// so the reversals are not counted.
#[test]
fn any_sound_sensors_keep_the_line() {
    for seed in 0..VEHICLES {
        let mut noise = Noise::new(seed + 2001);
        let vehicle = Description {
            sensors: random_sensors(&mut noise),
            ..random(&mut noise)
        };
        let allowed = allowed(&vehicle, 1.0, 0.0);
        keeps_the_line(seed, &vehicle, described(&vehicle), allowed, 0.05);
    }
}

/// The same with positions that are 0.1 to 0.25 s old, and with receivers of 10, 5 and 1 Hz; that of 1 Hz at up to
/// 2 m/s, and within 9 cm.
#[test]
fn any_slow_receiver_keeps_the_line() {
    for interval in [0.1, 0.2, 1.0] {
        for seed in 0..VEHICLES / 2 {
            let mut noise = Noise::new(seed + 3001);
            let mut vehicle = Description {
                sensors: random_sensors(&mut noise),
                ..random(&mut noise)
            };
            vehicle.sensors.age = 0.1 + 0.15 * noise.uniform();
            vehicle.sensors.interval = interval;
            let slowest = interval > 0.5;
            if slowest && vehicle.cruise > 2.0 {
                let settings = Settings::<f32>::for_vehicle(&vehicle);
                assert!(settings.is_err(), "seed {seed}: accepted");
                continue;
            }
            let conditions = Conditions {
                every: (interval / vehicle.period).round() as u32,
                ..described(&vehicle)
            };
            // As long again for heading and biases, and eight positions.
            let allowed = allowed(&vehicle, 1.0, 0.0) + 8.0 + 8.0 * interval;
            let limit = if slowest { 0.09 } else { 0.05 };
            keeps_the_line(seed, &vehicle, conditions, allowed, limit);
        }
    }
}

/// The vehicle is within `limit` (m) of its line in the allowed time, and stays there for a minute.
fn keeps_the_line(
    seed: u64,
    vehicle: &Description,
    conditions: Conditions,
    allowed: f64,
    limit: f64,
) {
    let run = drive(*vehicle, conditions, seed, allowed + 60.0);
    let settled = run.settled_within(limit);
    let (mean, deviation) = run.error(allowed);
    assert!(
        settled <= allowed && mean.abs() < 0.02 && deviation < 0.025,
        "seed {seed}: {settled} s of {allowed} s, mean {mean} m, deviation {deviation} m, \
         {vehicle:?}"
    );
}

/// The same from 5 m off, facing 135 degrees away.
#[test]
fn any_sound_vehicle_turns_around() {
    for seed in 0..VEHICLES / 4 {
        let mut noise = Noise::new(seed + 1001);
        let vehicle = Description {
            sensors: random_sensors(&mut noise),
            ..random(&mut noise)
        };
        let heading = degrees(135.0);
        let allowed = allowed(&vehicle, 5.0, heading);
        let conditions = Conditions {
            offset: 5.0,
            heading,
            ..described(&vehicle)
        };
        let settled = drive(vehicle, conditions, seed, allowed + 20.0).settled();
        assert!(
            settled <= allowed,
            "seed {seed}: {settled} s of {allowed} s, {vehicle:?}"
        );
    }
}

/// A number out of range is named, with its value and the accepted range.
#[test]
fn unsound_vehicles_are_refused() {
    type Change = fn(&mut Description);
    let refusal = |change: Change| {
        let mut vehicle = common::example::VEHICLE;
        change(&mut vehicle);
        Settings::<f32>::for_vehicle(&vehicle)
            .err()
            .map(|refusal| refusal.to_string())
    };
    assert_eq!(refusal(|_| ()), None);
    let cases: [(Change, &str); 10] = [
        (
            |v| v.geometry.l2 = 9.0,
            "the wheelbase L1 + L2 is 9.255 m: 0.4 to 4 m is accepted",
        ),
        (
            |v| v.geometry.l1 = f64::NAN,
            "the wheelbase L1 + L2 is NaN m: 0.4 to 4 m is accepted",
        ),
        (
            |v| (v.geometry.l1, v.geometry.l2) = (-0.5, 1.5),
            "the antenna's distance L1 ahead of the rear axle is -0.5 m: \
             -0.4 to 2 m is accepted",
        ),
        (
            |v| v.antenna.right = -2.0,
            "the antenna's distance right of the centre line is -2 m: \
             -1.179479 to 1.179479 m is accepted",
        ),
        (
            |v| v.limits.steering_angle = degrees(60.0),
            "the steering angle limit is 60 degrees: 15 to 45 degrees is accepted",
        ),
        (
            |v| v.limits.steering_rate = 0.0,
            "the steering rate limit is 0 degrees/s: 10 to 60 degrees/s is accepted",
        ),
        (
            |v| v.cruise = 3.5,
            "the cruise speed is 3.5 m/s: 0.3 to 3 m/s is accepted",
        ),
        (
            |v| v.limits.speed = 0.5,
            "the top speed is 0.5 m/s: 1 to 10 m/s is accepted",
        ),
        (
            |v| v.sensors.age = -0.01,
            "the receiver's age is -0.01 s: 0 to 0.25 s is accepted",
        ),
        (
            |v| v.weights.as_mut().unwrap().firm.cross_track = -1.0,
            "the regulators' weights: at 0.25 m/s: the state weight Q is not \
             symmetric and positive semidefinite",
        ),
    ];
    for (change, sentence) in cases {
        assert_eq!(refusal(change).as_deref(), Some(sentence));
    }
}

/// For the example, the derived weights equal those found by a search within 1 %.
#[test]
fn derived_weights_are_those_found_by_search() {
    let vehicle = common::example::VEHICLE;
    let derived = Weights::for_vehicle(&vehicle);
    let found = vehicle.weights.unwrap();
    for (derived, found) in [(derived.firm, found.firm), (derived.gentle, found.gentle)] {
        let pairs = [
            (derived.integral, found.integral),
            (derived.cross_track, found.cross_track),
            (derived.heading, found.heading),
            (derived.steering_angle, found.steering_angle),
        ];
        for (derived, found) in pairs {
            assert!((derived / found - 1.0).abs() < 0.01, "{derived}, {found}");
        }
    }
}

/// The source that a build script writes restores the settings exactly.
#[test]
fn the_source_restores_every_number() {
    const SETTINGS: Settings<f32> = include!("fixtures/settings.rs");
    let settings = common::example::settings::<f32>();
    assert_eq!(
        source(&settings).to_string() + "\n",
        include_str!("fixtures/settings.rs"),
        "the example's settings, formatted by `control::vehicle::source`"
    );
    assert_eq!(SETTINGS, settings);
}
