//! The antenna's height on slopes: where roll and pitch are measured, a vehicle drives there as on level ground.

mod common;

use common::{Conditions, Ground, Noise, Plant, Run, random, run_plant};
use control::controller::{Controller, Settings};
use control::line::Line;
use control::model::{Antenna, Geometry};
use control::position::Position;
use control::safety::Command;
use control::tilt::{Tilt, TiltWatch};
use control::vehicle::{Description, degrees};
use proptest::prelude::*;

/// Number of random vehicles.
const VEHICLES: u64 = 60;

/// What the vehicle knows of its roll and pitch.
#[derive(Clone, Copy, Debug)]
enum Sensor {
    /// There is none.
    Absent,
    /// Both angles with noise of 0.2 degrees and a constant error of 0.3 degrees, until so many seconds have passed.
    Until(f64),
}

const ALWAYS: Sensor = Sensor::Until(f64::INFINITY);

/// Constant error of a measured angle, rad.
const ERROR: f64 = degrees(0.3);

fn single(command: Command<f64>) -> Command<f32> {
    Command {
        steering_rate: command.steering_rate as f32,
        speed: command.speed as f32,
    }
}

fn line() -> Line<f32> {
    Line::new(Position::new(0, 0), Position::new(5_000_000, 0)).unwrap()
}

/// Drives for 90 s from 1 m off the line.
fn drive(vehicle: Description, conditions: Conditions, sensor: Sensor, seed: u64) -> Run {
    let settings = Settings::<f32>::for_vehicle(&vehicle).unwrap();
    let mut controller = Controller::new(settings, line()).unwrap();
    let mut watch = TiltWatch::new(0.3);
    let mut noise = Noise::new(seed + 90_001);
    let mut time = 0.0;
    let dt = vehicle.period as f32;
    run_plant(
        Plant::of(vehicle, conditions, seed),
        90.0,
        |heard, applied| {
            let mut sample = heard.sample(single(applied), dt);
            if let Sensor::Until(end) = sensor {
                let mut seen = |angle: f64| (angle + ERROR + degrees(0.2) * noise.normal()) as f32;
                let tilt = Tilt {
                    roll: seen(heard.tilt.roll),
                    pitch: seen(heard.tilt.pitch),
                };
                let tilt = Some(tilt).filter(|_| heard.arrived && time < end);
                sample.velocity = watch.step(&mut controller, tilt, sample.velocity, dt);
            }
            time += vehicle.period;
            common::wide(controller.step(&sample).command)
        },
    )
}

/// A random vehicle with an antenna at 1 to 3 m, and a slope of 5 to 10 degrees, to the side or along or between.
fn on_a_slope(seed: u64) -> (Description, Ground) {
    let mut noise = Noise::new(seed + 1);
    let mut vehicle = random(&mut noise);
    let mut between = |least: f64, most: f64| least + (most - least) * noise.uniform();
    vehicle.antenna.height = between(1.0, 3.0);
    let size = degrees(between(5.0, 10.0));
    let way = between(0.0, std::f64::consts::TAU);
    let ground = Ground {
        side: size * way.cos(),
        climb: size * way.sin(),
        ..Ground::default()
    };
    (vehicle, ground)
}

/// Mean of the cross-track error, its standard deviation and its largest size after 40 s, m.
fn figures(run: &Run) -> [f64; 3] {
    let (mean, deviation) = run.error(40.0);
    let steady = &run.errors[(40.0 / run.period) as usize..];
    let largest = steady
        .iter()
        .fold(0.0_f64, |most, error| most.max(error.abs()));
    [mean, deviation, largest]
}

/// Any vehicle on `waves` (slope of their flanks, rad, and length, m) and a slope. Returns the worst figures.
fn any_vehicle_holds_its_line(waves: (f64, f64)) -> [f64; 3] {
    let mut worst = [0.0_f64; 3];
    for seed in 0..VEHICLES {
        let (vehicle, ground) = on_a_slope(seed);
        let level = Conditions {
            slope: ground.side,
            ..Conditions::default()
        };
        let rolling = Conditions {
            ground: Ground { waves, ..ground },
            ..level
        };
        let [usual, usual_deviation, _] = figures(&drive(vehicle, level, Sensor::Absent, seed));
        let [mean, deviation, largest] = figures(&drive(vehicle, rolling, ALWAYS, seed));
        // What the sensor's constant error explains.
        let explained = vehicle.antenna.height * ERROR.sin();
        assert!(
            mean.abs() < usual.abs() + explained + 0.01
                && deviation < usual_deviation + 0.015
                && largest < 0.08,
            "seed {seed}: mean {mean:.3} m ({usual:.3} m on level ground), deviation {deviation:.3} m \
             ({usual_deviation:.3} m), largest {largest:.3} m, {vehicle:?}"
        );
        for (worst, figure) in worst.iter_mut().zip([mean.abs(), deviation, largest]) {
            *worst = worst.max(figure);
        }
    }
    println!("{waves:?}: mean, deviation, largest {worst:.3?}");
    worst
}

/// Up to 42 cm beside the line without the sensor, less than 3 cm with it.
#[test]
fn on_a_slope_a_measured_tilt_puts_the_vehicle_on_its_line() {
    let mut worst = 0.0_f64;
    for seed in 0..VEHICLES {
        let (vehicle, ground) = on_a_slope(seed);
        let conditions = Conditions {
            slope: ground.side,
            ground,
            ..Conditions::default()
        };
        // The antenna is on the line, and the vehicle uphill of it.
        let [mean, ..] = figures(&drive(vehicle, conditions, Sensor::Absent, seed));
        let aside = vehicle.antenna.height * ground.side.sin();
        assert!(
            (mean + aside).abs() < 0.05,
            "seed {seed}: {mean} m, {aside} m"
        );
        worst = worst.max(mean.abs());
    }
    println!("without tilt: {worst:.3} m");
    assert!(worst > 0.35);
    assert!(any_vehicle_holds_its_line((0.0, 1.0))[0] < 0.03);
}

/// Waves that swing the antenna by up to half a metre a second. Without taking that out of the velocity, the worst vehicle was
/// 1.3 m off.
#[test]
fn on_rolling_ground_a_measured_tilt_puts_the_vehicle_on_its_line() {
    for waves in [
        (degrees(3.0), 3.0),
        (degrees(5.0), 5.0),
        (degrees(5.0), 10.0),
    ] {
        any_vehicle_holds_its_line(waves);
    }
}

/// When the sensor falls silent, the vehicle drives as without one, and nothing else happens to it.
#[test]
fn without_its_sensor_a_vehicle_drives_as_without_tilt() {
    for seed in 0..VEHICLES / 2 {
        let (vehicle, ground) = on_a_slope(seed);
        let conditions = Conditions {
            slope: ground.side,
            ground,
            ..Conditions::default()
        };
        let run = drive(vehicle, conditions, Sensor::Until(30.0), seed);
        let [mean, _, largest] = figures(&run);
        let aside = vehicle.antenna.height * ground.side.sin();
        assert!(
            (mean + aside).abs() < 0.06 && largest < aside.abs() + 0.3,
            "seed {seed}: {mean} m, {aside} m, {largest} m"
        );
    }
}

/// Each position and velocity of the receiver with a tilt of zero gives what it gives without a tilt.
#[test]
fn on_level_ground_a_tilt_changes_nothing() {
    let vehicle = Description {
        antenna: Antenna {
            right: 0.3,
            height: 2.0,
        },
        ..common::example::VEHICLE
    };
    let settings = Settings::<f32>::for_vehicle(&vehicle).unwrap();
    let mut one = Controller::new(settings, line()).unwrap();
    let (mut other, mut watch) = (one, TiltWatch::new(0.3));
    let mut plant = Plant::of(vehicle, Conditions::loaded(), 3);
    let mut applied = Command::still();
    for step in 0..600 {
        let sample = plant.hear().sample(applied, 0.1);
        let tilt = (step % 5 != 0).then_some(Tilt::default());
        let mut level = sample;
        level.velocity = watch.step(&mut other, tilt, sample.velocity, 0.1);
        let outcome = one.step(&sample);
        assert_eq!(outcome, other.step(&level), "step {step}");
        applied = outcome.command;
        plant.drive(common::wide(applied), 0.1);
    }
}

#[test]
fn a_tilt_counts_for_its_longest_age() {
    let settings = common::example::settings::<f32>();
    let mut controller = Controller::new(settings, line()).unwrap();
    let mut watch = TiltWatch::new(0.3);
    let tilt = Tilt {
        roll: 0.1,
        pitch: 0.0,
    };
    let odd = [
        Tilt {
            roll: f32::NAN,
            ..tilt
        },
        Tilt {
            pitch: -0.6,
            ..tilt
        },
    ];
    assert!(!watch.is_measured());
    for _ in 0..2 {
        let _ = watch.step(&mut controller, Some(tilt), None, 0.1);
        assert!(watch.is_measured());
        for (step, missing) in [None, Some(odd[0]), Some(odd[1]), None]
            .into_iter()
            .enumerate()
        {
            let _ = watch.step(&mut controller, missing, None, 0.1);
            assert_eq!(watch.is_measured(), step < 3, "step {step}");
        }
    }
}

proptest! {
    /// The place is that of the antenna turned by the matrices of roll and pitch.
    #[test]
    fn the_place_is_that_of_the_turned_body(
        l1 in -4.0..8.0_f64,
        right in -2.0..2.0_f64,
        height in 0.0..5.0_f64,
        roll in -0.5..0.5_f64,
        pitch in -0.5..0.5_f64,
    ) {
        use control::nalgebra::{Rotation3, Vector3};
        // Axes forward, right and down.
        let turned = Rotation3::from_euler_angles(roll, pitch, 0.0) * Vector3::new(l1, right, -height);
        let geometry = Geometry { l1, l2: 1.0 };
        let antenna = Antenna { right, height };
        let (ahead, across) = Tilt { roll, pitch }.place(&geometry, &antenna);
        let error = (ahead - turned.x).hypot(across - turned.y);
        prop_assert!(error < 4e-6 * turned.norm(), "{error}");
        let narrow = Tilt { roll: roll as f32, pitch: pitch as f32 }.place(
            &Geometry { l1: l1 as f32, l2: 1.0 },
            &Antenna { right: right as f32, height: height as f32 },
        );
        prop_assert!((f64::from(narrow.0) - ahead).abs() < 1e-5);
        prop_assert!((f64::from(narrow.1) - across).abs() < 1e-5);
    }
}
