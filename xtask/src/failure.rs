//! Why a command ends without success.

use std::{io, path::PathBuf};

use crate::{
    audit, bench, board, build, campaigns, cli, experiment, figures, file, keys, mission, monitor,
    new, probe, schedulability, selftest, sim, size, target, test, vehicle, workspace,
};

/// Why a command ends without success; displays as one sentence.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// `analyse`, `calibrate` and `schedule`: an input file is wrong. Any command: what it prints cannot be
    /// written.
    #[error("{0}")]
    Usage(String),
    /// `analyse`: the output folder.
    #[error(transparent)]
    Folder(#[from] world::report::FolderError),
    /// An image's audit.
    #[error(transparent)]
    Audit(#[from] audit::Error),
    /// `bench`.
    #[error(transparent)]
    Bench(#[from] bench::Error),
    /// `test --board`.
    #[error(transparent)]
    Board(#[from] board::Error),
    /// `campaign`.
    #[error(transparent)]
    Campaign(#[from] campaigns::Error),
    /// The command line.
    #[error(transparent)]
    Cli(#[from] cli::Error),
    /// A file of a vehicle.
    #[error(transparent)]
    File(#[from] file::Error),
    /// `keys`.
    #[error(transparent)]
    Keys(#[from] keys::Error),
    /// `mission upload` and the others on a bus.
    #[error(transparent)]
    Mission(#[from] mission::Error),
    /// `monitor`.
    #[error(transparent)]
    Monitor(#[from] monitor::Error),
    /// `new`.
    #[error(transparent)]
    New(#[from] new::Error),
    /// `build`.
    #[error(transparent)]
    Build(#[from] build::Error),
    /// `sim --experiment`.
    #[error(transparent)]
    Experiment(#[from] experiment::Error),
    /// `figures`.
    #[error(transparent)]
    Figures(#[from] figures::Error),
    /// `flash`, `attach` and `run`.
    #[error(transparent)]
    Probe(#[from] probe::Error),
    /// `schedulability` and `priorities`.
    #[error(transparent)]
    Schedulability(#[from] schedulability::Error),
    /// `selftest`.
    #[error(transparent)]
    Selftest(#[from] selftest::Error),
    /// `sim`.
    #[error(transparent)]
    Sim(#[from] sim::Error),
    /// An image's size.
    #[error(transparent)]
    Size(#[from] size::Error),
    /// The compilation target.
    #[error(transparent)]
    Target(#[from] target::Missing),
    /// `test`.
    #[error(transparent)]
    Test(#[from] test::Error),
    /// The vehicle or a node.
    #[error(transparent)]
    Vehicle(#[from] vehicle::Error),
    /// The workspace and the programs that run in it.
    #[error(transparent)]
    Workspace(#[from] workspace::Error),
    /// A file cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// What was wrong is on the screen already.
    #[error("failed as shown above")]
    Shown,
}

impl Failure {
    /// The exit code of the program: 2 when the command line or an input file is wrong, else 1.
    pub fn exit_code(&self) -> u8 {
        let usage = match self {
            Failure::Usage(_) | Failure::Folder(_) | Failure::Campaign(_) => true,
            Failure::Figures(_) => true,
            Failure::Cli(_) | Failure::File(_) | Failure::Vehicle(_) => true,
            Failure::Bench(error) => error.is_usage(),
            Failure::Keys(error) => error.is_usage(),
            Failure::Mission(error) => error.is_usage(),
            Failure::Monitor(error) => error.is_usage(),
            Failure::New(error) => error.is_usage(),
            Failure::Experiment(error) => error.is_usage(),
            Failure::Probe(error) => error.is_usage(),
            Failure::Schedulability(error) => error.is_usage(),
            Failure::Selftest(error) => error.is_usage(),
            Failure::Sim(error) => error.is_usage(),
            _ => false,
        };
        if usage { 2 } else { 1 }
    }
}

/// A file cannot be read.
#[derive(Debug, thiserror::Error)]
#[error("{} cannot be read: {error}", path.display())]
pub struct ReadError {
    path: PathBuf,
    #[source]
    error: io::Error,
}

impl ReadError {
    /// Makes the error of reading `path` from the cause.
    pub(crate) fn of(path: impl Into<PathBuf>) -> impl FnOnce(io::Error) -> Self {
        let path = path.into();
        |error| Self { path, error }
    }
}
