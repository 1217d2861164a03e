//! `calibrate`: the steering's calibration from a recorded drive (thesis 5.2.6).

mod fit;
mod recording;

use std::{
    fmt::Write as _,
    fs,
    io::Write as _,
    path::{Path, PathBuf},
    process,
};

use crate::{Failure, cli::Calibrate};
pub use fit::{Calibration, Circle, Movement, Side};

use recording::Recording;

/// Runs the command.
///
/// # Errors
///
/// [`Failure::Usage`] when the log cannot be read or does not hold what a calibration
/// needs, or the vehicle file cannot be written.
pub fn run(options: &Calibrate) -> Result<(), Failure> {
    let usage = |path: &Path, what: String| Failure::Usage(format!("{}: {what}", path.display()));
    let text = fs::read_to_string(&options.log)
        .map_err(|error| usage(&options.log, format!("it cannot be read: {error}")))?;
    let found = calibrate(&text).map_err(|what| usage(&options.log, what))?;
    let vehicle = vehicle_file(&found);
    if let Some(path) = &options.out {
        write(path, &vehicle)
            .map_err(|error| usage(path, format!("it cannot be written: {error}")))?;
    }
    if options.json {
        let json = serde_json::to_string_pretty(&found).unwrap_or_default();
        println!("{json}");
    } else {
        print!("{}", report(&found));
        match &options.out {
            Some(path) => println!("\nWrote {}.", path.display()),
            None => print!("\n{vehicle}"),
        }
    }
    Ok(())
}

/// The calibration in a candump log.
///
/// # Errors
///
/// A sentence that says what is wrong with the log.
pub fn calibrate(log: &str) -> Result<Calibration, String> {
    fit::fit(&Recording::read(log)?)
}

/// The numbers of the calibration, as TOML.
fn vehicle_file(found: &Calibration) -> String {
    let side = |name: &str, side: &Side| {
        format!(
            "\n[steering.{name}]\n# Share of the full effort that moves nothing.\n\
             dead_band = {:.4}\n# Degrees a second at full effort.\nfull_rate = {:.3}\n",
            side.dead_band, side.full_rate
        )
    };
    format!(
        "# The numbers of one machine, as `cargo xtask calibrate` found them in a drive.\n\n\
         # Steering potentiometer: linear (thesis Figure 5.18).\n\
         [potentiometer]\n# Counts with the wheels straight.\ncentre = {:.2}\n\
         # Counts for a degree to the right; negative when it runs the other way.\n\
         counts_per_degree = {:.3}\n\n\
         # Steering actuator on its motor driver: linear beyond a dead band, one line for\n\
         # each direction (thesis 5.2.6, Figure 5.20).{}{}",
        found.centre,
        found.counts_per_degree,
        side("right", &found.right),
        side("left", &found.left)
    )
}

/// Writes a file at once or not at all.
fn write(path: &Path, text: &str) -> std::io::Result<()> {
    let mut beside = path.as_os_str().to_owned();
    beside.push(format!(".{}", process::id()));
    let beside = PathBuf::from(beside);
    let written = fs::File::create_new(&beside)
        .and_then(|mut file| {
            file.write_all(text.as_bytes())?;
            file.sync_all()
        })
        .and_then(|()| fs::rename(&beside, path));
    if written.is_err() {
        // What was wrong is told; a file that was never made cannot be removed.
        let _ = fs::remove_file(&beside);
    }
    written
}

/// The report for people.
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
