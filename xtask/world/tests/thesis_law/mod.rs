//! The thesis's law on a PC: what its three nodes do together, without a bus.
//!
//! 200 Hz, whole centimetres up to 150 cm, conditional hold, scalar Kalman filter, P or PI law with both
//! saturations, servo pulses (thesis 2.2.4 to 2.2.6). Gains, thresholds and variances are not in its
//! text: [`Law`] has those that are fitted to its figures.

#![allow(dead_code)]

use control::row::{
    ConditionalHold, IntegralState, ProportionalIntegral, ScalarKalman, differential,
};
use world::distance::{self, metres};
use world::rover::{self, Mount, Side, Terrain};
use world::row_drive::{RowDrive, Setting, pulse};
use world::scenario::Row;
use world::time::{at, from_seconds};

/// Smooth barriers with a step in their width (2.2.6.1). The robot begins beside the middle.
pub(crate) const STEP: &str = r#"
start = { station = "30 cm", right = "10 cm" }
[[section]]
kind = "barriers"
length = "4 m"
width = "100 cm"
[[section]]
kind = "barriers"
length = "9 m"
width = "130 cm"
"#;

/// Poles between smooth barriers (2.2.7, 2.3).
pub(crate) const POLES: &str = r#"
start.station = "30 cm"
[[section]]
kind = "barriers"
length = "2 m"
[[section]]
kind = "poles"
length = "4.572 m"
[[section]]
kind = "barriers"
length = "2 m"
"#;

/// A field row (2.2.7, 2.3). Leaves are fitted to a mean way of 15.6 m until a contact: 39 s at 0.4 m/s.
pub(crate) const FIELD: &str = r#"
start.station = "30 cm"
[[section]]
kind = "stalks"
length = "22.86 m"
missing = "5 %"
[[leaves]]
from = "0 m"
to = "22.86 m"
density = "0.5 /m"
[[leaves]]
side = "left"
from = "9 m"
to = "13 m"
density = "6 /m"
[[weeds]]
from = "3 m"
to = "22.86 m"
density = "0.02 /m"
diameter = "10 cm"
"#;

/// [`POLES`] with leaves over most of its length. Density and reach are fitted to one failure in five at
/// 0.4 m/s and none at 0.8 m/s (2.3).
pub(crate) fn leaves(side: &str) -> String {
    format!(
        r#"{POLES}
[[leaves]]
side = "{side}"
from = "2.5 m"
to = "6.2 m"
density = "6 /m"
reach = "30 cm"
length = "20 cm"
"#
    )
}

/// Period of the law, seconds.
const PERIOD: f64 = 0.005;

/// Longest drive, seconds.
const LONGEST: f64 = 36_000.0;

/// Constants of the law, for distances in centimetres.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Law {
    /// Least and largest distance that counts, cm.
    pub(crate) plausible: (f64, f64),
    /// Variance that the distance gains in a step, as a share of that of a sample.
    pub(crate) process: f64,
    /// Effort for a difference, 1/cm.
    pub(crate) proportional: f64,
    /// Effort for its integral, 1/(cm s).
    pub(crate) integral: f64,
    /// Limit of the difference, cm.
    pub(crate) input: f64,
    /// Limit of the effort.
    pub(crate) output: f64,
}

impl Default for Law {
    fn default() -> Self {
        Self {
            plausible: (50.0, 120.0),
            process: 0.005,
            proportional: 0.0012,
            integral: 0.0,
            input: 40.0,
            output: 0.1,
        }
    }
}

/// What a drive came to. Means are over the stations that the caller asks for.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Outcome {
    /// Mean of filtered right minus filtered left distance, cm.
    pub(crate) difference: f64,
    /// Mean of its magnitude, cm.
    pub(crate) magnitude: f64,
    /// Mean distance from the middle of the row, cm.
    pub(crate) offset: f64,
    /// The largest such distance, cm.
    pub(crate) largest: f64,
    /// Whether the robot touched something.
    pub(crate) touched: bool,
}

/// Drives along the row until a metre before its end, or until a contact.
pub(crate) fn drive(
    row: &Row,
    terrain: &Terrain,
    law: &Law,
    speed: f64,
    seed: u64,
    (from, to): (f64, f64),
) -> (RowDrive, Outcome) {
    let rover = rover::Parameters::default();
    let forward = rover.friction + (1.0 - rover.friction) * speed / rover.top_speed;
    let setting = Setting {
        row,
        rover,
        mount: Mount::right(),
        terrain: terrain.clone(),
        distance: distance::Parameters::default(),
        driver_clocks: [0.0; 2],
    };
    let mut drive = RowDrive::new(&setting, seed);
    let hold = ConditionalHold::new(law.plausible.0, law.plausible.1).unwrap();
    let filter = ScalarKalman::new(law.process, 1.0).unwrap();
    let mut chains = [(hold, filter); 2];
    let controller = ProportionalIntegral {
        proportional: law.proportional,
        integral: law.integral,
        input_limit: law.input,
        output_limit: law.output,
    };
    let mut integral = IntegralState::new();
    let (mut outcome, mut count) = (Outcome::default(), 0.0);
    for step in 1..=(LONGEST / PERIOD) as u32 {
        let now = at(from_seconds(f64::from(step) * PERIOD));
        drive.advance_to(now);
        let Some(&sample) = drive.samples().last() else {
            continue;
        };
        if drive.contact().is_some() || sample.station > drive.rows().length() - 1.0 {
            break;
        }
        let filtered = [Side::Left, Side::Right].map(|side| {
            let (hold, filter) = &mut chains[side as usize];
            let counts = (drive.mean_volts(side, now) / 3.3 * 4095.0)
                .round()
                .min(4095.0);
            let distance = metres(counts / 4095.0 * 3.3) * 100.0;
            filter.step(hold.pass(distance.round().min(150.0)))
        });
        // The sensor on the left measures the right row.
        let error = filtered[0] - filtered[1];
        let turn = controller.step(&mut integral, error, PERIOD);
        let sides = differential(forward, turn);
        for (side, effort) in [(Side::Left, sides.left), (Side::Right, sides.right)] {
            pulse(&mut drive, side, now, 1.5e-3 + effort * 0.5e-3);
        }
        if (from..to).contains(&sample.station) {
            count += 1.0;
            outcome.difference += error;
            outcome.magnitude += error.abs();
            outcome.offset += 100.0 * sample.right.abs();
            outcome.largest = outcome.largest.max(100.0 * sample.right.abs());
        }
    }
    outcome.touched = drive.contact().is_some();
    for sum in [
        &mut outcome.difference,
        &mut outcome.magnitude,
        &mut outcome.offset,
    ] {
        *sum /= f64::max(count, 1.0);
    }
    (drive, outcome)
}
