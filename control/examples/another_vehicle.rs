//! Designs a controller for another vehicle: a tractor of 2.4 m wheelbase with
//! the antenna 0.9 m ahead of the rear axle, 35 degrees of steering at 20
//! degrees a second, at 3 m/s. Run it with
//! `cargo run -p control --example another_vehicle`.

use control::controller::{Controller, Settings};
use control::design::{SteeringWeights, steering_gains};
use control::feedback::Limits;
use control::line::Line;
use control::model::Geometry;
use control::position::Position;

#[rustfmt::skip]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let tractor = Geometry { l1: 0.9, l2: 1.5 };
    let rear = Geometry { l1: 0.0, l2: tractor.wheelbase() };
    let weights = |cross_track: f64, steering_angle| SteeringWeights {
        integral: cross_track / 50.0, cross_track, heading: cross_track,
        steering_angle, steering_rate: 1.0,
    };
    let gains = |weights| steering_gains(&rear, &weights, 0.1, 0.5, 0.5);
    let (angle, rate) = (35_f64.to_radians(), 20_f64.to_radians());
    let limits = Limits { steering_angle: angle, steering_rate: rate, speed: 4.0 };
    let mut settings = Settings { limits, cruise: 3.0, ..Settings::<f64>::uagv() };
    settings.firm = gains(weights(10.0, 0.2))?;
    settings.gentle = gains(weights(0.3, 3.0))?;
    (settings.guidance.limits, settings.guidance.wheelbase) = (limits, rear.l2);
    (settings.estimator.geometry, settings.controlled_point) = (tractor, tractor.l1);
    let line = Line::new(Position::new(0, 0), Position::new(400_000, 0))?;
    let controller = Controller::new(settings, line)?;
    println!("to {:.1?}; for a build script:\n{}", controller.path().end(), settings.firm);
    Ok(())
}
