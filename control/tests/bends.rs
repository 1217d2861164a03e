//! A vehicle that drives a path at its cruise speed slows down where it bends.

mod common;

use common::{Conditions, Plant, example, wide};
use control::controller::{Controller, Settings};
use control::path::Path;
use control::position::Position;
use control::safety::Command;

/// The largest distance from the path, m, and the least and largest speed, of two passes with a turn of 2.6 m between
/// them.
fn turn(cruise: f64, apart: i32, seed: u64) -> (f64, f64, f64) {
    let vehicle = control::vehicle::Description {
        cruise,
        weights: None,
        ..example::VEHICLE
    };
    let settings = Settings::<f32>::for_vehicle(&vehicle).unwrap();
    let passes = [
        (Position::new(0, 0), Position::new(40_000, 0)),
        (Position::new(40_000, apart), Position::new(0, apart)),
    ];
    let path = Path::passes(&passes, 2.6).unwrap();
    let mut controller = Controller::new(
        settings,
        control::line::Line::new(passes[0].0, passes[0].1).unwrap(),
    )
    .unwrap();
    controller.follow(path);
    let conditions = Conditions {
        offset: 0.1,
        ..Conditions::default()
    };
    let mut plant = Plant::of(vehicle, conditions, seed);
    let mut applied = Command::<f32>::still();
    let (mut largest, mut slowest, mut fastest) = (0.0_f64, f64::MAX, 0.0_f64);
    for _ in 0..2000 {
        let heard = plant.hear();
        let outcome = controller.step(&heard.sample(applied, 0.1));
        applied = outcome.command;
        if outcome.finished {
            return (largest, slowest, fastest);
        }
        if plant.time > 10.0 {
            largest = largest.max(f64::from(outcome.tracking.cross_track.abs()));
            slowest = slowest.min(plant.speed);
            fastest = fastest.max(plant.speed);
        }
        let command = wide(applied);
        plant.drive(command, 0.1);
    }
    panic!("the end is not reached");
}

/// Before, the turn was driven at 2 m/s, and the vehicle was up to 144 cm away.
#[test]
fn turns_are_driven_slower() {
    for (cruise, apart) in [(1.0, 5_200), (2.0, 5_200), (2.0, 8_000), (2.0, -5_200)] {
        for seed in 1..=3 {
            let (largest, slowest, fastest) = turn(cruise, apart, seed);
            let name = format!("{cruise} m/s, {apart} mm apart: {largest} m, {slowest} m/s");
            assert!(largest < 0.06, "{name}");
            assert!(
                (0.95..1.05).contains(&slowest) && fastest > 0.98 * cruise,
                "{name}"
            );
        }
    }
}
