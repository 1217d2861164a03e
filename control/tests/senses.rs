//! A vehicle whose speed, wheelbase or receiver is not as its description says still comes onto its line.

mod common;

use common::{Conditions, Plant, example, wide};
use control::controller::{Controller, Settings};
use control::line::Line;
use control::position::Position;
use control::safety::Command;
use control::vehicle::Description;

/// What a run showed.
#[derive(Debug, Default)]
struct Figures {
    /// Time from which the error stays within 5 cm, s, and of several runs its median.
    settled: f64,
    median: f64,
    /// Mean and standard deviation of the error in the last half minute, m.
    mean: f64,
    deviation: f64,
    /// Changes of the command's sign per second then.
    reversals: f64,
    /// Real and estimated speed at the end, m/s.
    speed: (f64, f64),
    /// Estimated wheelbase, m, and age of the receiver's data, s, at the end: those of the last seed.
    wheelbase: f64,
    age: f64,
}

/// Lets a vehicle drive from 1 m off its line for a minute.
fn drive(vehicle: Description, conditions: Conditions, seed: u64) -> Figures {
    let settings = Settings::<f32>::for_vehicle(&vehicle).unwrap();
    let line = Line::new(Position::new(0, 0), Position::new(5_000_000, 0)).unwrap();
    let mut controller = Controller::new(settings, line).unwrap();
    let mut plant = Plant::of(vehicle, conditions, seed);
    let mut run = common::Run {
        period: vehicle.period,
        ..common::Run::default()
    };
    let mut applied = Command::still();
    for _ in 0..(60.0 / vehicle.period) as usize {
        let heard = plant.hear();
        let outcome = controller.step(&heard.sample(applied, vehicle.period as f32));
        applied = outcome.command;
        let command = wide(applied);
        run.errors.push(plant.controlled().1);
        run.commands.push(command.steering_rate);
        plant.drive(command, vehicle.period);
    }
    let (mean, deviation) = run.error(30.0);
    Figures {
        settled: run.settled(),
        median: run.settled(),
        mean,
        deviation,
        reversals: run.sign_changes(30.0),
        speed: (
            plant.speed,
            f64::from(controller.estimator().estimate().speed),
        ),
        wheelbase: f64::from(controller.estimator().wheelbase()),
        age: f64::from(controller.estimator().gps_delay()),
    }
}

/// The worst of twenty seeds. The estimator was written while others were tried.
fn worst(vehicle: Description, conditions: Conditions) -> Figures {
    let runs = (7001..=7020).map(|seed| drive(vehicle, conditions, seed));
    let mut worst = Figures::default();
    let mut settled = Vec::new();
    for run in runs {
        let error = (run.speed.0 - run.speed.1).abs();
        if error >= (worst.speed.0 - worst.speed.1).abs() {
            worst.speed = run.speed;
        }
        settled.push(run.settled);
        worst.settled = worst.settled.max(run.settled);
        worst.mean = worst.mean.max(run.mean.abs());
        worst.deviation = worst.deviation.max(run.deviation);
        (worst.wheelbase, worst.age) = (run.wheelbase, run.age);
        worst.reversals = worst.reversals.max(run.reversals);
    }
    settled.sort_by(f64::total_cmp);
    worst.median = settled[settled.len() / 2];
    println!("{worst:.3?}");
    worst
}

/// Before the gain of the drive was estimated, a vehicle of 0.40 m/s was believed to have 0.60, settled in 7.8 s (the worst
/// of a hundred in 10.2 s), and reversed its steering 1.9 times a second.
#[test]
fn a_drive_of_another_gain_is_known_and_held_at_its_speed() {
    for drive in [0.4, 0.7, 1.3] {
        let conditions = Conditions {
            drive,
            ..Conditions::default()
        };
        let found = worst(example::VEHICLE, conditions);
        let (real, believed) = found.speed;
        assert!((real - believed).abs() < 0.03, "{drive}: {:?}", found.speed);
        // The command is at most 2 m/s.
        let wanted = (2.0 * drive).min(1.0);
        assert!((real - wanted).abs() < 0.06, "{drive}: {real} m/s");
        assert!(
            found.settled <= 6.0 && found.reversals < 0.5 && found.deviation < 0.01,
            "{drive}: {found:?}"
        );
    }
}

/// Positions that are 250 ms old, told: as good as those of 55 ms.
#[test]
fn an_age_that_is_told_costs_nothing() {
    for age in [0.1, 0.15, 0.2, 0.25] {
        for conditions in [Conditions::default(), Conditions::loaded()] {
            let mut vehicle = example::VEHICLE;
            vehicle.sensors.age = age;
            let found = worst(
                vehicle,
                Conditions {
                    delay: age,
                    ..conditions
                },
            );
            assert!(
                found.settled <= 5.0 && found.deviation < 0.01 && found.mean < 0.01,
                "{age} s: {found:?}"
            );
        }
    }
}

/// Before, a receiver of 1 Hz never came onto the line: the command was too old after half a second.
#[test]
fn receivers_of_five_and_one_hertz_hold_the_line() {
    for (every, settled, deviation) in [(2, 6.5, 0.01), (10, 11.0, 0.02)] {
        for conditions in [Conditions::default(), Conditions::loaded()] {
            let mut vehicle = example::VEHICLE;
            vehicle.sensors.interval = f64::from(every) * vehicle.period;
            let found = worst(
                vehicle,
                Conditions {
                    every,
                    ..conditions
                },
            );
            assert!(
                found.settled <= settled && found.deviation < deviation && found.mean < 0.01,
                "each {every}: {found:?}"
            );
        }
    }
}

/// Before the wheelbase was estimated, the worst of a hundred settled in 10.7 s and 11.0 s.
#[test]
fn a_wheelbase_that_is_wrong_by_a_fifth_is_found() {
    for wheelbase in [0.8, 1.2] {
        let found = worst(
            example::VEHICLE,
            Conditions {
                wheelbase,
                ..Conditions::default()
            },
        );
        assert!(
            found.settled <= 6.5
                && found.median <= 6.0
                && found.deviation < 0.01
                && found.mean < 0.01,
            "{wheelbase}: {found:?}"
        );
        let real = 1.1 * wheelbase;
        assert!(
            (found.wheelbase - real).abs() < 0.07,
            "{wheelbase}: {found:?}"
        );
    }
}

/// A drive that starts is not taken for one that is slow: that would make the law ask for too much speed, and sections
/// switch late. Before the law kept to the drive's acceleration, a drive of 1 m/s^2 was taken for one of 94 %.
#[test]
fn a_drive_that_starts_is_not_slow() {
    for (acceleration, cruise) in [(2.0, 1.0), (1.0, 2.0), (0.5, 2.0)] {
        let vehicle = Description {
            acceleration,
            cruise,
            ..example::VEHICLE
        };
        let settings = Settings::<f32>::for_vehicle(&vehicle).unwrap();
        let line = Line::new(Position::new(0, 0), Position::new(5_000_000, 0)).unwrap();
        let mut controller = Controller::new(settings, line).unwrap();
        let mut plant = Plant::of(vehicle, Conditions::default(), 1);
        let mut applied = Command::still();
        for _ in 0..100 {
            let heard = plant.hear();
            applied = controller.step(&heard.sample(applied, 0.1)).command;
            let drive = controller.drive();
            assert!((drive - 1.0).abs() < 0.05, "{acceleration} m/s^2: {drive}");
            plant.drive(wide(applied), 0.1);
        }
    }
}

/// Of data that are older or younger than told, more than half of the difference is found in the first turns. Before, data of
/// 200 ms settled in 7.1 s and those of 250 ms in 12.7 s, the worst of a hundred in 12.0 s and 18.1 s, when the drive
/// accelerated at once.
#[test]
fn an_age_that_is_not_told_is_found() {
    for (age, median, settled) in [
        (0.0, 4.0, 6.0),
        (0.1, 4.0, 6.5),
        (0.15, 6.7, 7.0),
        (0.2, 7.2, 11.5),
        (0.25, 12.0, 13.0),
    ] {
        let found = worst(
            example::VEHICLE,
            Conditions {
                delay: age,
                ..Conditions::default()
            },
        );
        assert!(
            found.settled <= settled
                && found.median <= median
                && found.deviation < 0.01
                && found.mean < 0.01,
            "{age} s: {found:?}"
        );
        assert!((found.age - age).abs() < 0.1, "{age} s: {found:?}");
    }
}
