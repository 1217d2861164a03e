//! `calibrate`: the steering's calibration from a recorded drive (thesis 5.2.6).

mod fit;
mod manifest;
mod recording;

use std::{fmt::Write as _, fs};

use serde::Serialize;
use vehicle_model::Vehicle;

use crate::{Failure, Workspace, cli::Calibrate, file, vehicle};
pub use fit::{Calibration, Circle, Movement, Side};

use manifest::{Change, Edited};
use recording::{Recording, Signals};

/// What `--json` prints.
#[derive(Serialize)]
struct Report<'c> {
    #[serde(flatten)]
    found: &'c Calibration,
    changes: &'c [Change],
    /// Whether the manifest already has the result of this log.
    repeated: bool,
    written: bool,
}

/// Why a log is of no use any more.
const REPEATED: &str = "the manifest has the potentiometer of this very log, so the log was \
                        written to it before: the images of the drive had other values, with \
                        which those of the actuator would now drift";

/// Runs the command.
///
/// # Errors
///
/// [`Failure::Usage`] when the vehicle has nothing to calibrate, when the log cannot be read or
/// lacks data, or when the manifest rejects the result or cannot be written.
pub fn run(workspace: &Workspace, options: &Calibrate) -> Result<(), Failure> {
    let vehicle = vehicle::find(workspace, &options.vehicle)?;
    let usage = |what: String| Failure::Usage(format!("{}: {what}", options.log.display()));
    let text = fs::read_to_string(&options.log)
        .map_err(|error| usage(format!("it cannot be read: {error}")))?;
    let found = calibrate(&vehicle, &text).map_err(usage)?;
    let Edited { text, changes } = manifest::edit(&vehicle, &found).map_err(usage)?;
    let path = vehicle.manifest_file();
    let repeated = manifest::is_repeated(&changes);
    if options.write && repeated {
        return Err(usage(format!("{REPEATED}; nothing was written")));
    }
    // Written before anything is printed: whoever reads the output may stop reading.
    if options.write {
        file::replace(&path, &text)?;
    }
    if options.json {
        let report = Report {
            found: &found,
            changes: &changes,
            repeated,
            written: options.write,
        };
        let json = serde_json::to_string_pretty(&report).unwrap_or_default();
        println!("{json}");
        return Ok(());
    }
    println!("{}", report(&found));
    for Change { field, from, to } in &changes {
        println!("  {field:<35}{from:>16}  ->  {to}");
    }
    let shown = path.strip_prefix(workspace.root()).unwrap_or(&path);
    let shown = shown.display();
    if options.write {
        println!(
            "\nThe values were written to {shown}. This log is now used up: the next one must be \
             of a drive with images that have these values."
        );
    } else if repeated {
        println!("\nNothing of this should be written to {shown}: {REPEATED}.");
    } else {
        println!("\nThese would be the changes of {shown}; --write makes them.");
    }
    Ok(())
}

/// Computes the calibration from a candump log of a vehicle.
///
/// # Errors
///
/// A sentence that says what is wrong with the log, or that the vehicle has nothing to calibrate.
pub fn calibrate(vehicle: &Vehicle, log: &str) -> Result<Calibration, String> {
    let parts = Signals::of(vehicle).zip(fit::Machine::of(vehicle));
    let (signals, machine) = parts.ok_or_else(|| {
        format!(
            "vehicle {:?} has nothing to calibrate: its manifest has no [calibration]",
            vehicle.name()
        )
    })?;
    fit::fit(&machine, &Recording::read(&signals, log)?)
}

/// The report as text.
fn report(found: &Calibration) -> String {
    let mut text = format!(
        "Potentiometer: {:.1} counts straight ahead, {:.2} counts/deg; {:.2} deg remain (rms)\n\n  \
         {:>8}{:>11}{:>10}{:>9}{:>10}\n",
        found.centre,
        found.counts_per_degree,
        found.angle_residual,
        "from (s)",
        "radius (m)",
        "angle",
        "counts",
        "remains"
    );
    for circle in &found.circles {
        let read = (circle.counts - found.centre) / found.counts_per_degree;
        let _ = writeln!(
            text,
            "  {:>8.1}{:>11.2}{:>10.2}{:>9.1}{:>10.2}",
            circle.from,
            circle.radius,
            circle.angle,
            circle.counts,
            read - circle.angle
        );
    }
    if found.skipped > 0 {
        let _ = writeln!(
            text,
            "\nSkipped {} error frames and CAN FD frames of the log.",
            found.skipped
        );
    }
    text.push('\n');
    for (name, side) in [("right", &found.right), ("left", &found.left)] {
        let _ = writeln!(
            text,
            "Actuator to the {name}: dead band {:.1} %, {:.2} deg/s at full effort; {:.2} deg/s \
             remain (rms of {} movements)",
            side.dead_band * 100.0,
            side.full_rate,
            side.residual,
            side.movements
        );
    }
    let _ = writeln!(
        text,
        "\n  {:>8}{:>10}{:>14}",
        "from (s)", "effort", "rate (deg/s)"
    );
    for movement in &found.movements {
        let _ = writeln!(
            text,
            "  {:>8.1}{:>10.3}{:>14.2}",
            movement.from, movement.effort, movement.rate
        );
    }
    text
}
