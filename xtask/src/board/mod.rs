//! `test --board`: the tests of a node's board, on the board where a debug probe is connected,
//! otherwise on the virtual microcontroller. The image is the same: `boards/tests`.

mod image;
mod on_board;
mod on_twin;
mod report;

use std::{io, path::PathBuf};

use parts::Sled;

use crate::{Failure, Workspace, cli::Test, probe, progress::Display, vehicle};

pub use image::{BoardTest, TestImage};
pub use on_twin::{Surroundings, run as run_on_twin, sound};

/// Why the tests of a board do not pass or cannot be run.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Tests failed, as shown on the screen.
    #[error("{failed} of {of} tests of the board failed")]
    Failed {
        /// How many failed.
        failed: usize,
        /// How many there are.
        of: usize,
    },
    /// The compiler refused them.
    #[error("the tests of board {board} did not build")]
    NotBuilt {
        /// The board.
        board: &'static str,
    },
    /// The image cannot be put in its folder.
    #[error("the tests cannot be put in {}: {error}", folder.display())]
    NotKept {
        /// The folder.
        folder: PathBuf,
        /// Why not.
        #[source]
        error: io::Error,
    },
    /// The image does not say which tests it has.
    #[error("{} has no tests: {why}", path.display())]
    NoList {
        /// The image.
        path: PathBuf,
        /// What is wrong with it.
        why: String,
    },
    /// The image is none for the part.
    #[error(transparent)]
    Image(twin::image::ImageError),
    /// probe-rs cannot be run.
    #[error("probe-rs cannot be run: {0}")]
    ProbeRs(#[source] io::Error),
    /// probe-rs ended before any test had.
    #[error("probe-rs has run no test: see what it says above")]
    NoOutcome,
}

/// How a test ended.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Outcome {
    /// It passed.
    Passed,
    /// It did not, and why.
    Failed(String),
}

/// A test that has run.
#[derive(Debug, Clone, PartialEq)]
pub struct Verdict {
    /// The test.
    pub test: BoardTest,
    /// How it ended.
    pub outcome: Outcome,
    /// How long it took on the virtual microcontroller, in simulated seconds.
    pub seconds: Option<f64>,
    /// What it logged on the virtual microcontroller. A board's log is shown while it runs.
    pub log: Vec<String>,
}

/// Where tests run.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Place {
    Twin,
    Board { probe: Option<String> },
}

/// Runs the command: the tests of the board of `node`.
///
/// # Errors
///
/// There is no such node or probe, or more than one and none is named (exit code 2). The tests do
/// not build, or one of them fails.
pub fn run(workspace: &Workspace, node: &str, options: &Test) -> Result<(), Failure> {
    let set = options.set.iter().cloned().collect();
    let (vehicle, index) = vehicle::with_node(workspace, node, options.vehicle.as_deref(), &set)?;
    let sled = vehicle::board(&vehicle, index);
    // A missing probe is reported before a build that takes time.
    let place = place(workspace, node, options)?;
    let image = TestImage::build(workspace, sled)?;
    let verdicts = match &place {
        Place::Twin => {
            let title = sled.part.title;
            eprintln!("{} tests run on the virtual {title}.", image.tests.len());
            on_twin(&image)?
        }
        Place::Board { probe } => on_board::run(workspace, &image, probe.as_deref())?,
    };
    let title = match place {
        Place::Twin => "twin",
        Place::Board { .. } => "board",
    };
    if options.json {
        println!(
            "{}",
            report::json(node, vehicle.name(), sled, title, &verdicts)
        );
    } else {
        print!("{}", report::table(sled, title, &verdicts));
    }
    let failed = verdicts.iter().filter(|verdict| !passed(verdict)).count();
    match failed {
        0 => Ok(()),
        failed => {
            let of = verdicts.len();
            Err(Error::Failed { failed, of }.into())
        }
    }
}

fn passed(verdict: &Verdict) -> bool {
    verdict.outcome == Outcome::Passed
}

/// Where the tests run, and why, on standard error.
fn place(workspace: &Workspace, node: &str, options: &Test) -> Result<Place, probe::Error> {
    if options.twin {
        return Ok(Place::Twin);
    }
    let wanted = options.probe.as_deref();
    match probe::find(workspace, node, wanted) {
        Ok(probe) => Ok(Place::Board { probe }),
        Err(error @ (probe::Error::NotInstalled | probe::Error::NoProbe { .. }))
            if wanted.is_none() =>
        {
            eprintln!("No board: {error}.");
            Ok(Place::Twin)
        }
        Err(error) => Err(error),
    }
}

/// Runs all tests of an image on a sound board of the virtual microcontroller. Each that fails
/// shows its log.
fn on_twin(image: &TestImage) -> Result<Vec<Verdict>, Failure> {
    let mut display = Display::new();
    let count = image.tests.len();
    let mut verdicts = Vec::new();
    for (number, test) in (1..).zip(&image.tests) {
        display.show(|_| format!("{number}/{count} {}: {}", test.subject, test.sentence()));
        let verdict = run_on_twin(image, test, &sound(image.sled), &mut |_| {})?;
        if let Outcome::Failed(why) = &verdict.outcome {
            display.end();
            eprintln!("{}: {}: {why}", test.subject, test.sentence());
            for line in &verdict.log {
                eprintln!("    {line}");
            }
        }
        verdicts.push(verdict);
    }
    display.end();
    Ok(verdicts)
}

/// The tests of a board that fail on the virtual microcontroller, a sentence each.
///
/// # Errors
///
/// The tests do not build.
pub(crate) fn failures_on_twin(
    workspace: &Workspace,
    sled: &'static Sled,
) -> Result<Vec<String>, Failure> {
    let image = TestImage::build(workspace, sled)?;
    let verdicts = on_twin(&image)?;
    eprint!("{}", report::table(sled, "twin", &verdicts));
    let failures = verdicts.into_iter().filter_map(|verdict| {
        let Outcome::Failed(why) = verdict.outcome else {
            return None;
        };
        let test = verdict.test;
        Some(format!("{}: {}: {why}", test.subject, test.sentence()))
    });
    Ok(failures.collect())
}
