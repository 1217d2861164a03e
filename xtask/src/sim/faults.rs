//! `sim --faults`: random fault sequences and attacks against the images, judged by rules.

pub(crate) use campaign::Trouble;
use campaign::{Options, Progress, Report, Shard};
use vehicle_model::Vehicle;
use world::report::OutputFolder;

use super::Error;
use crate::{Failure, Workspace, cli::Sim, progress::Display};

/// Runs `sequences` sequences, or this shard's part of them.
///
/// # Errors
///
/// The output folder is wrong (exit code 2), an image does not build, or a
/// sequence broke a rule.
pub(super) fn run(
    workspace: &Workspace,
    vehicle: &Vehicle,
    options: &Sim,
    sequences: u64,
) -> Result<(), Failure> {
    let folder = match &options.out {
        Some(path) => Some(OutputFolder::create(path).map_err(Error::from)?),
        None => None,
    };
    let campaign = Options {
        trouble: if options.attacker {
            Trouble::Attacks { key: true }
        } else {
            Trouble::Faults
        },
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
            .map_err(Error::from)?;
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

/// Runs the first `sequences` sequences. Returns a sentence for each that broke a rule, with the
/// command that repeats it.
///
/// # Errors
///
/// An image does not build, or is none for its node.
pub(crate) fn first(
    workspace: &Workspace,
    vehicle: &Vehicle,
    sequences: u64,
    trouble: Trouble,
) -> Result<Vec<String>, Failure> {
    let campaign = Options {
        trouble,
        sequences,
        seed: 1,
        shard: Shard::default(),
        threads: None,
    };
    let report = judged(workspace, vehicle, &campaign)?;
    eprint!("{report}");
    let broken = report.failures.iter().map(|failure| {
        let seed = failure.seed;
        let (kind, option) = match trouble {
            Trouble::Faults => ("fault", ""),
            Trouble::Attacks { .. } => ("attack", " --attacker"),
        };
        format!(
            "{kind} sequence {seed} broke a rule: cargo xtask sim --faults 1{option} --seed {seed}"
        )
    });
    Ok(broken.collect())
}

fn judged(workspace: &Workspace, vehicle: &Vehicle, campaign: &Options) -> Result<Report, Failure> {
    let images = super::images(workspace, vehicle)?;
    let mut display = Display::new();
    let report = campaign::run(vehicle, &images, campaign, |progress| {
        let Progress { done, all, failed } = progress;
        display.show(|wall| {
            let pace = done as f64 / wall.as_secs_f64().max(1e-9);
            format!("{done} of {all} sequences, {failed} broke a rule, {pace:.2} a second")
        });
    });
    display.end();
    Ok(report.map_err(Error::from)?)
}
