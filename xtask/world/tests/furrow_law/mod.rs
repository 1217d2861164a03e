//! Furrow's row controller on a PC: what its three nodes do together, without a bus.
//!
//! 200 Hz, whole centimetres up to 250 cm, single precision, servo pulses that begin 2 ms after the
//! sample.

#![allow(dead_code)]

use std::path::Path;

use control::row::{RowController, RowDistances, RowSettings, RowState, Sides};
use vehicle_model::{Vehicle, manifest::Rover, robot, units::Speed};
use world::distance;
use world::rover::{self, Mount, Terrain};
use world::row_drive::{Chain, Followed, RowDrive, Setting, follow};
use world::scenario::{Limits, Row};
use world::victor;

/// Period of the control step, seconds.
const PERIOD: f64 = 0.005;

/// From the sample to the beginning of the pulse, seconds.
const LATENCY: f64 = 0.002;

/// What a field row has.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Field {
    /// Gaps of 1 m: in the left row, in the right row, and in both at once.
    pub(crate) gaps: bool,
    /// Leaves over 3.5 m of the right row, then of the left one, for a metre.
    pub(crate) leaves: f64,
    /// Direction in which the row bends with a radius of 30 m; empty for a straight row.
    pub(crate) turn: &'static str,
}

impl Field {
    /// Everything that the row of 75 feet is asked to have, straight.
    pub(crate) const FULL: Self = Self {
        gaps: true,
        leaves: 6.0,
        turn: "",
    };

    /// The row of the thesis (2.2.7) with this on it, and leaves here and there. Nothing grows between
    /// the rows: the robot cannot drive around it.
    pub(crate) fn row(&self) -> Row {
        let mut text = String::from(
            r#"
start.station = "30 cm"
[[section]]
kind = "stalks"
length = "22.86 m"
missing = "5 %"
[[leaves]]
from = "0 m"
to = "22.86 m"
density = "0.5 /m"
"#,
        );
        for (side, from, to) in [("right", 3.0, 6.5), ("left", 13.0, 16.5)] {
            text += &format!(
                "[[leaves]]\nside = \"{side}\"\nfrom = \"{from} m\"\nto = \"{to} m\"\ndensity = \"{} /m\"\n",
                self.leaves
            );
        }
        if self.gaps {
            for (side, from) in [("left", 8.0), ("right", 10.0), ("both", 18.5)] {
                text += &format!(
                    "[[gap]]\nside = \"{side}\"\nfrom = \"{from} m\"\nto = \"{} m\"\n",
                    from + 1.0
                );
            }
        }
        if !self.turn.is_empty() {
            text += &format!(
                "[[bend]]\nfrom = \"2 m\"\nto = \"22.86 m\"\nradius = \"30 m\"\nturn = \"{}\"\n",
                self.turn
            );
        }
        let row: Row = toml::from_str(&text).expect("the row is right");
        let limits = Limits::of(&rover::Parameters::default(), &Mount::right());
        row.check(&limits).expect("the row is right");
        row
    }
}

/// The vehicle's rover, at this speed (m/s).
fn rover(speed: f64) -> Rover {
    let folder = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../../firmware/vehicles/row-follower"
    );
    let vehicle = Vehicle::read(Path::new(folder)).expect("the vehicle is right");
    let rover = vehicle.manifest().rover.expect("the vehicle is a rover");
    Rover {
        cruise: Speed::new(speed),
        ..rover
    }
}

/// Drives along the row at `speed` (m/s).
pub(crate) fn drive(row: &Row, speed: f64, seed: u64) -> Followed {
    let rover = rover(speed);
    let setting = Setting {
        row,
        rover: rover::Parameters::of(&rover),
        mount: Mount::of(&rover),
        terrain: Terrain::field(),
        distance: distance::Parameters::default(),
        driver_clocks: victor::clocks(seed),
    };
    let settings = RowSettings::<f32>::for_robot(&robot(&rover)).expect("the robot is right");
    let mut controller = RowController::new(settings).expect("the settings are right");
    let chain = Chain {
        period: PERIOD,
        latency: LATENCY,
        // Four times as long as at full speed.
        longest: 4.0 * row.length() / speed,
    };
    follow(&mut RowDrive::new(&setting, seed), &chain, |distances| {
        let [left, right] = distances.map(|distance| f32::from(distance) / 100.0);
        let distances = RowDistances { left, right };
        let step = controller.step(&distances, true, PERIOD as f32);
        let Sides { left, right } = step.efforts;
        (step.state == RowState::Following).then(|| [left, right].map(f64::from))
    })
}
