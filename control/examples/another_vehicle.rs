//! Derives the controller of a tractor from its description and prints the
//! settings as a build script would write them. Run it with
//! `cargo run -p control --example another_vehicle`.

use control::controller::{Controller, Settings};
use control::feedback::Limits;
use control::line::Line;
use control::model::{Antenna, Geometry};
use control::position::Position;
use control::vehicle::{Description, Misalignment, Sensors, degrees, source};

const TRACTOR: Description = Description {
    geometry: Geometry { l1: 0.9, l2: 1.5 },
    antenna: Antenna {
        right: 0.2,
        height: 2.6,
    },
    limits: Limits {
        steering_angle: degrees(35.0),
        steering_rate: degrees(20.0),
        speed: 4.0,
    },
    cruise: 3.0,
    period: 0.1,
    sensors: Sensors {
        position: 0.01,
        velocity: 0.03,
        steering: degrees(0.1),
        age: 0.055,
        interval: 0.1,
    },
    drive_lag: 0.5,
    acceleration: 1.0,
    cornering: 5.0,
    misalignment: Misalignment {
        heading: degrees(1.0),
        steering: degrees(2.0),
    },
    weights: None,
};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let settings = Settings::<f32>::for_vehicle(&TRACTOR)?;
    let line = Line::new(Position::new(0, 0), Position::new(400_000, 0))?;
    let controller = Controller::new(settings, line)?;
    println!("to {:.1?}; for a build script:", controller.path().end());
    println!("{}", source(&settings));
    Ok(())
}
