//! `sim --faults`: random fault sequences against the images, judged by rules.

use std::{
    io::{IsTerminal, Write},
    time::{Duration, Instant},
};

use campaign::{Options, Progress, Report, Shard};
use vehicle_model::Vehicle;
use world::report::OutputFolder;

use crate::{Failure, Workspace, cli::Sim};

/// Runs so many sequences, or this shard's part of them.
///
/// # Errors
///
/// The output folder is wrong ([`Failure::Usage`]), an image does not build, or a
/// sequence broke a rule.
pub(super) fn run(
    workspace: &Workspace,
    vehicle: &Vehicle,
    options: &Sim,
    sequences: u64,
) -> Result<(), Failure> {
    let usage = |error: String| Failure::Usage(error);
    let folder = match &options.out {
        Some(path) => Some(OutputFolder::create(path).map_err(|error| usage(error.to_string()))?),
        None => None,
    };
    let campaign = Options {
        sequences,
        seed: options.seed,
        shard: options.shard.unwrap_or_default(),
        threads: None,
    };
    let report = judged(workspace, vehicle, &campaign)?;
    if let Some(mut folder) = folder {
        let path = folder
            .write("faults.json", report.json().as_bytes())
            .and_then(|()| folder.finish())
            .map_err(|error| usage(error.to_string()))?;
        eprintln!("Wrote faults.json to {}.", path.display());
    }
    if options.json {
        println!("{}", report.json().trim_end());
    } else {
        print!("{report}");
    }
    if report.failures.is_empty() {
        Ok(())
    } else {
        Err(Failure::Shown)
    }
}

/// Runs the first `sequences` sequences and says which of them broke a rule, with what
/// repeats them.
///
/// # Errors
///
/// An image does not build, or is none for its node.
pub(crate) fn first(
    workspace: &Workspace,
    vehicle: &Vehicle,
    sequences: u64,
) -> Result<Vec<String>, Failure> {
    let campaign = Options {
        sequences,
        seed: 1,
        shard: Shard::default(),
        threads: None,
    };
    let report = judged(workspace, vehicle, &campaign)?;
    eprint!("{report}");
    let broken = report.failures.iter().map(|failure| {
        let seed = failure.seed;
        format!("fault sequence {seed} broke a rule: cargo xtask sim --faults 1 --seed {seed}")
    });
    Ok(broken.collect())
}

fn judged(workspace: &Workspace, vehicle: &Vehicle, campaign: &Options) -> Result<Report, Failure> {
    let images = super::images(workspace, vehicle)?;
    let mut display = Display::new();
    let report = campaign::run(vehicle, &images, campaign, |progress| {
        display.show(progress)
    });
    display.end();
    report.map_err(|error| Failure::Failed(error.to_string()))
}

/// Progress on the terminal: one line that is written over, or, into a file, a line now and
/// then.
struct Display {
    start: Instant,
    last: Option<Instant>,
    terminal: bool,
}

impl Display {
    fn new() -> Self {
        Self {
            start: Instant::now(),
            last: None,
            terminal: std::io::stderr().is_terminal(),
        }
    }

    fn show(&mut self, progress: Progress) {
        let pause = Duration::from_millis(if self.terminal { 200 } else { 5000 });
        let now = Instant::now();
        if self.last.is_some_and(|last| now - last < pause) {
            return;
        }
        self.last = Some(now);
        let Progress { done, all, failed } = progress;
        let pace = done as f64 / (now - self.start).as_secs_f64().max(1e-9);
        let line =
            format!("{done} of {all} fault sequences, {failed} broke a rule, {pace:.2} a second");
        let mut stderr = std::io::stderr();
        // Progress that cannot be shown is no reason to stop.
        let _ = if self.terminal {
            write!(stderr, "\r{line}\x1b[K").and_then(|()| stderr.flush())
        } else {
            writeln!(stderr, "{line}")
        };
    }

    fn end(&mut self) {
        if self.terminal && self.last.is_some() {
            eprint!("\r\x1b[K");
        }
    }
}
