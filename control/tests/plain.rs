//! The steering law of the thesis.

#[path = "common/example.rs"]
mod example;

use control::controller::Sample;
use control::line::Line;
use control::lqr::dlqr;
use control::plain::{GAINS, PlainController};
use control::position::{Position, Velocity};
use control::safety::Command;
use nalgebra::SMatrix;

#[test]
fn gains_are_the_regulator_with_unit_weights() {
    let model = example::VEHICLE.geometry.steering_model_sampled(1.0, 0.1);
    let one = SMatrix::<f64, 1, 1>::new(1.0);
    let regulator = dlqr(&model, &SMatrix::identity(), &one).unwrap();
    for (designed, known) in regulator.gain.iter().zip(GAINS) {
        assert!((designed - known).abs() < 1e-9, "{designed} {known}");
    }
}

/// The vehicle is 0.1 m to the right of a northward line, points 0.05 rad to the
/// right and steers 0.02 rad to the left: u = -(0.1 K1 + 0.05 K2 - 0.02 K3).
#[test]
fn the_command_is_the_states_times_the_gains() {
    let line = Line::new(Position::new(0, 0), Position::new(100_000, 0)).unwrap();
    let mut law = PlainController::<f64>::new(GAINS, example::settings(), line).unwrap();
    let mut sample = Sample {
        position: Some(Position::new(1_000, 100)),
        velocity: Some(Velocity::new(1_000, 50)),
        steering_angle: Some(-0.02),
        applied: Command::still(),
        engaged: false,
        dt: 0.1,
    };
    assert_eq!(law.step(&sample).command, Command::still());
    sample.engaged = true;
    let outcome = law.step(&sample);
    let heading = 0.05_f64.atan2(1.0);
    let rate = -(0.1 * GAINS[0] + heading * GAINS[1] - 0.02 * GAINS[2]);
    assert!((outcome.command.steering_rate - rate).abs() < 1e-12);
    // The drive's acceleration for a tenth of a second.
    assert!((outcome.command.speed - 0.2).abs() < 1e-12);
    assert!((outcome.tracking.cross_track - 0.1).abs() < 1e-12);

    sample.position = Some(Position::new(100_100, 0));
    let outcome = law.step(&sample);
    assert!(outcome.finished);
    assert!(outcome.command.speed == 0.0);
}

/// Without positions the law commands standstill once the last one is too old.
#[test]
fn it_does_not_drive_on_an_old_position() {
    let line = Line::new(Position::new(0, 0), Position::new(100_000, 0)).unwrap();
    let mut law = PlainController::<f64>::new(GAINS, example::settings(), line).unwrap();
    let mut sample = Sample {
        position: Some(Position::new(0, 0)),
        velocity: None,
        steering_angle: Some(0.0),
        applied: Command::still(),
        engaged: true,
        dt: 0.1,
    };
    assert!(law.step(&sample).command.speed > 0.0);
    sample.position = None;
    let moving = (0..10)
        .filter(|_| law.step(&sample).command.speed > 0.0)
        .count();
    assert!((4..=5).contains(&moving), "{moving}");
}
