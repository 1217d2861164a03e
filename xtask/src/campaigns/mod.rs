//! `campaign`: a campaign of random faults or attacks on many machines.

mod batch;

use std::{
    fs,
    io::Read,
    path::{Path, PathBuf},
};

use ::campaign::{MergeError, Report, merge};

use crate::{
    Failure, Workspace,
    cli::{Batch, Campaign, Merge},
    file, sim, vehicle,
};

/// Why the command fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A file is no part of a campaign.
    #[error("{} is no part of a campaign: {why}; a file faults-I-of-N.json of sim --faults --shard is accepted", path.display())]
    NoPart {
        /// The file.
        path: PathBuf,
        /// Why.
        why: String,
    },
    /// The parts make no whole.
    #[error(transparent)]
    Merge(#[from] MergeError),
    /// More parts than sequences.
    #[error(
        "--shards: of {shards} parts of {sequences} sequences some would be empty; up to {sequences} parts are accepted"
    )]
    TooMany {
        /// Parts.
        shards: u64,
        /// Sequences.
        sequences: u64,
    },
    /// The engine runs containers, and nobody says which.
    #[error(
        "--engine kubernetes needs --image, the container with this checkout and Rust, and --claim, the volume claim for the results"
    )]
    NoImage,
    /// Where the volume is mounted must be the same place everywhere.
    #[error(
        "--dir {dir}: Kubernetes mounts the results there, so an absolute path without a colon is accepted"
    )]
    Relative {
        /// The folder.
        dir: String,
    },
    /// The report would replace a part.
    #[error("--out {} is one of the parts: name another file", path.display())]
    Part {
        /// The file.
        path: PathBuf,
    },
    /// A text that would end its place in the file.
    #[error(
        "{option}: {text:?} has other characters than letters, digits and -_./:=@+, which would end its place in the file"
    )]
    Odd {
        /// The option.
        option: &'static str,
        /// The text.
        text: String,
    },
}

/// Runs the command.
///
/// # Errors
///
/// The files are no parts of one campaign (exit code 2), or a sequence broke a rule.
pub fn run(workspace: &Workspace, options: &Campaign) -> Result<(), Failure> {
    match options {
        Campaign::Merge(options) => merge_files(options),
        Campaign::Batch(options) => write_batch(workspace, options),
    }
}

fn merge_files(options: &Merge) -> Result<(), Failure> {
    let canonical = |path: &Path| path.canonicalize().ok();
    let out = options
        .out
        .as_deref()
        .filter(|out| canonical(out).is_some());
    if let Some(out) = out
        && options
            .files
            .iter()
            .any(|part| canonical(part) == canonical(out))
    {
        return Err(Error::Part { path: out.into() }.into());
    }
    let mut parts = Vec::new();
    for path in &options.files {
        parts.push((path.display().to_string(), part(path)?));
    }
    let report = merge(parts).map_err(Error::from)?;
    if let Some(path) = &options.out {
        file::put(path, &report.json())?;
        eprintln!("Wrote {}.", path.display());
    }
    show(&report, options.json)
}

/// Prints a report.
///
/// # Errors
///
/// A sequence broke a rule.
pub(crate) fn show(report: &Report, json: bool) -> Result<(), Failure> {
    if json {
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

/// Largest size of a part, bytes. A part with tens of thousands of failures is smaller.
const LARGEST: u64 = 64 << 20;

/// Reads the report of a part.
fn part(path: &Path) -> Result<Report, Error> {
    let fail = |why: String| Error::NoPart {
        path: path.to_owned(),
        why,
    };
    let unreadable = |error: std::io::Error| fail(error.to_string());
    let file = fs::File::open(path).map_err(unreadable)?;
    let mut text = Vec::new();
    // A device may go on for ever.
    let read = file.take(LARGEST + 1).read_to_end(&mut text);
    read.map_err(unreadable)?;
    if text.len() as u64 > LARGEST {
        return Err(fail(format!("it is larger than {} MiB", LARGEST >> 20)));
    }
    serde_json::from_slice(&text).map_err(|error| fail(error.to_string()))
}

fn write_batch(workspace: &Workspace, options: &Batch) -> Result<(), Failure> {
    // A vehicle that is not there would be found on all machines at once.
    let vehicle = vehicle::with(workspace, &options.vehicle, &options.changes.overrides())?;
    sim::check_campaign(&vehicle, options.attacker)?;
    let text = batch::text(options)?;
    match &options.out {
        Some(path) => {
            file::put(path, &text)?;
            eprintln!("Wrote {}.", path.display());
        }
        None => print!("{text}"),
    }
    Ok(())
}
