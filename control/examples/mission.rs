//! A mission of two passes: it is checked, and the pieces of its path are listed.
//!
//! ```sh
//! cargo run -p control --example mission
//! ```

use control::controller::Controller;
use control::fence::{Footprint, Point};
use control::mission::{End, Join, Leg, Legs, Mission, MissionSettings, Planner, Stretch, check};
use control::position::Position;

#[path = "../tests/common/example.rs"]
mod example;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let settings = example::settings::<f32>();
    // From the origin 100 m to the north at 1 m/s with section 0 on, and back 3 m beside.
    let out = Leg {
        length: 100.0,
        speed: 1.0,
        outputs: 1,
        join: Join::Turn,
        ..Leg::default()
    };
    let mut back = out;
    back.start.north = 100.0;
    back.start.east = 3.0;
    back.start.heading = core::f32::consts::PI;
    let corners = [(-9.0, -9.0), (109.0, -9.0), (109.0, 12.0), (-9.0, 12.0)];
    let mission = Legs {
        origin: Position::new(0, 0),
        legs: &[out, back],
        fence: &corners.map(|(north, east)| Point { north, east }),
        obstacles: &[],
        end: End::Stop,
    };

    // Turns at 1 m/s leave a fifth of the steering's angle and rate for corrections.
    let footprint = Footprint {
        half_width: 1.5,
        ..Footprint::default()
    };
    let wanted = MissionSettings::for_controller(&settings, footprint, 1.0, 0.2);
    let summary = check(&mission, &wanted)?;
    println!(
        "{} legs and {} turns, {:.1} m, at least {:.0} s",
        summary.legs, summary.turns, summary.length, summary.time
    );

    // On a target a task of low priority does this, some steps between two control steps.
    let mut planner = Planner::new(wanted);
    let stretch = Stretch::new(mission.origin(), wanted.pace);
    let mut controller = Controller::following(settings, stretch)?;
    let current = controller.progress().segment;
    while planner.feed(&mission, controller.route_mut(), current) {}
    println!("piece     m  curvature (1/m)    m/s");
    for number in controller.route().numbers() {
        let Some(piece) = controller.route().piece(number) else {
            break;
        };
        let segment = &piece.segment;
        println!(
            "{number:5} {:5.1} {:7.3} to {:6.3} {:6.2}  {:?}{}",
            segment.length,
            segment.curvature,
            segment.curvature_at(segment.length),
            piece.speed,
            piece.purpose,
            if piece.reverse { ", in reverse" } else { "" },
        );
    }
    Ok(())
}
