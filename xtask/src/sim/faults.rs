//! `sim --faults`: random fault sequences and attacks against the images, judged by rules.

pub(crate) use campaign::Trouble;
use std::{
    fs,
    ops::ControlFlow,
    path::{Path, PathBuf},
};

use campaign::{Campaign, Journal, JournalError, Options, Progress, Report, Shard, Verdict};
use twin::Images;
use vehicle_model::Vehicle;

use super::Error;
use crate::{Failure, Workspace, campaigns, cli::Sim, file, progress::Display};

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
    let place = options
        .out
        .as_deref()
        .map(|folder| Place::new(folder, campaign.shard));
    if let Some(place) = &place {
        place.reserve(options.resume)?;
    }
    let images = super::images(workspace, vehicle)?;
    let identity = Campaign::new(vehicle, &images, &campaign);
    let report = match place {
        Some(place) => kept(
            &place,
            vehicle,
            &images,
            &identity,
            &campaign,
            options.resume,
        )?,
        None => judged(vehicle, &images, &campaign, Vec::new(), go_on)?,
    };
    match campaigns::show(&report, options.json) {
        // The whole judges what its parts have found.
        Err(Failure::Shown) if options.collect => Ok(()),
        shown => shown,
    }
}

/// Runs a part whose journal and report are kept in files.
fn kept(
    place: &Place,
    vehicle: &Vehicle,
    images: &Images,
    identity: &Campaign,
    campaign: &Options,
    resume: bool,
) -> Result<Report, Failure> {
    if resume && let Some(report) = place.finished(identity, campaign.shard)? {
        eprintln!("{} is complete.", place.report.display());
        return Ok(report);
    }
    let (mut journal, earlier) = place.journal(identity, campaign.shard)?;
    if !earlier.is_empty() {
        eprintln!("{} sequences were done before.", earlier.len());
    }
    let mut unwritten = None;
    let report = judged(vehicle, images, campaign, earlier, |verdict| {
        match journal.add(verdict) {
            Ok(()) => ControlFlow::Continue(()),
            Err(error) => {
                // What follows could not be kept, either.
                unwritten.get_or_insert(error);
                ControlFlow::Break(())
            }
        }
    })?;
    let kept = match unwritten {
        None => place.finish(&report),
        Some(error) => Err(place.broken(&JournalError::File(error))),
    };
    if kept.is_err() {
        // What took hours is not lost for want of a file.
        print!("{report}");
    }
    kept.map(|()| report)
}

/// The files of a part of a campaign.
struct Place {
    folder: PathBuf,
    report: PathBuf,
    journal: PathBuf,
}

impl Place {
    fn new(folder: &Path, shard: Shard) -> Self {
        let name = match shard == Shard::default() {
            true => "faults".to_owned(),
            false => format!("faults-{}", shard.to_string().replace('/', "-of-")),
        };
        Self {
            folder: folder.to_owned(),
            report: folder.join(format!("{name}.json")),
            journal: folder.join(format!("{name}.journal")),
        }
    }

    /// Makes the folder. An unfinished campaign in it is lost by nobody's mistake.
    fn reserve(&self, resume: bool) -> Result<(), Failure> {
        fs::create_dir_all(&self.folder).map_err(|error| {
            let folder = self.folder.display();
            Failure::Usage(format!(
                "output folder {folder} cannot be written: {error}; name a folder that can be created or written to"
            ))
        })?;
        if !resume && self.journal.exists() {
            return Err(Failure::Usage(format!(
                "{} has what an unfinished campaign has done: --resume goes on with it, or delete the file to begin \
                 again",
                self.journal.display()
            )));
        }
        Ok(())
    }

    /// The report, if there is one and nothing is left to do.
    ///
    /// # Errors
    /// It is that of another campaign.
    fn finished(&self, campaign: &Campaign, shard: Shard) -> Result<Option<Report>, Failure> {
        let Ok(text) = fs::read(&self.report) else {
            return Ok(None);
        };
        match serde_json::from_slice::<Report>(&text) {
            _ if self.journal.exists() => Ok(None),
            Ok(report) if report.campaign == *campaign && report.shard == shard => Ok(Some(report)),
            _ => Err(Failure::Usage(format!(
                "{} is the report of another campaign, or of other images: name another folder, or delete the file",
                self.report.display()
            ))),
        }
    }

    fn journal(
        &self,
        campaign: &Campaign,
        shard: Shard,
    ) -> Result<(Journal, Vec<Verdict>), Failure> {
        Journal::open(&self.journal, campaign, shard).map_err(|error| self.broken(&error))
    }

    fn broken(&self, error: &JournalError) -> Failure {
        let journal = self.journal.display();
        Failure::Usage(format!("{journal} cannot be used: {error}"))
    }

    /// Writes the report in place of the journal.
    fn finish(&self, report: &Report) -> Result<(), Failure> {
        file::put(&self.report, &report.json())?;
        // A journal that stays is refused the next time, in a sentence.
        let _ = fs::remove_file(&self.journal);
        eprintln!("Wrote {}.", self.report.display());
        Ok(())
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
    let images = super::images(workspace, vehicle)?;
    let report = judged(vehicle, &images, &campaign, Vec::new(), go_on)?;
    eprint!("{report}");
    let broken = report.failures.iter().map(|failure| {
        let seed = failure.seed;
        let kind = match trouble {
            Trouble::Faults => "fault",
            Trouble::Attacks { .. } => "attack",
        };
        let replay = report.campaign.replay(seed);
        format!("{kind} sequence {seed} broke a rule: {replay}")
    });
    Ok(broken.collect())
}

/// Nothing is done with a verdict by itself.
fn go_on(_: &Verdict) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn judged(
    vehicle: &Vehicle,
    images: &Images,
    campaign: &Options,
    earlier: Vec<Verdict>,
    mut each: impl FnMut(&Verdict) -> ControlFlow<()>,
) -> Result<Report, Failure> {
    let mut display = Display::new();
    let before = earlier.len() as u64;
    let report = campaign::run(vehicle, images, campaign, earlier, |verdict, progress| {
        let go_on = each(verdict);
        let Progress { done, all, failed } = progress;
        display.show(|wall| {
            let pace = (done - before) as f64 / wall.as_secs_f64().max(1e-9);
            format!("{done} of {all} sequences, {failed} broke a rule, {pace:.2} a second")
        });
        go_on
    });
    display.end();
    Ok(report.map_err(Error::from)?)
}
