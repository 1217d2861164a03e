//! The commands of `cargo xtask`, one module each.
//!
//! The binary only passes its arguments to [`run`], so that tests reach everything else. A
//! command that fails returns a [`Failure`], which displays as one sentence. The exit code is 2
//! when the command line or an input file is wrong, else 1.

// Its macros are for all that follow.
#[macro_use]
mod output;

pub mod analyse;
pub mod audit;
pub mod bench;
pub mod board;
pub mod build;
pub mod calibrate;
pub mod campaigns;
pub mod cli;
pub mod experiment;
pub mod figures;
pub mod interrupt;
pub mod keys;
pub mod mission;
pub mod monitor;
pub mod new;
pub mod probe;
pub mod schedulability;
pub mod schedule;
pub mod selftest;
pub mod sim;
pub mod size;
pub mod target;
pub mod test;
pub mod vehicle;

mod failure;
mod file;
mod log;
mod network;
mod page;
mod progress;
mod seal;
mod workspace;

pub use failure::{Failure, ReadError};
pub use file::Error as FileError;
pub use workspace::{Error as WorkspaceError, Workspace};

use std::{ffi::OsString, process::ExitCode};

/// Runs the command that the arguments (the program's name first) ask for.
pub fn run(arguments: impl IntoIterator<Item = OsString>) -> ExitCode {
    let done = cli::parse(arguments)
        .map_err(Failure::from)
        .and_then(execute);
    match output::end(done) {
        Ok(()) => ExitCode::SUCCESS,
        Err(Failure::Shown) => ExitCode::FAILURE,
        Err(failure) => {
            eprintln!("error: {}", output::plain(&failure.to_string()));
            ExitCode::from(failure.exit_code())
        }
    }
}

fn execute(request: cli::Request) -> Result<(), Failure> {
    let command = match request {
        cli::Request::Show(text) => {
            print!("{text}");
            return Ok(());
        }
        cli::Request::Run(command) => command,
    };
    let workspace = Workspace::find()?;
    match command {
        cli::Command::Build(options) => build::run(&workspace, &options),
        cli::Command::Analyse(options) => analyse::run(&workspace, &options),
        cli::Command::Figures(options) => figures::run(&workspace, &options),
        cli::Command::Campaign(options) => campaigns::run(&workspace, &options),
        cli::Command::Mission(command) => mission::run(&workspace, &command),
        cli::Command::Calibrate(options) => calibrate::run(&workspace, &options),
        cli::Command::Bench(options) => bench::run(&workspace, &options),
        cli::Command::Flash(options) => {
            probe::run(&workspace, probe::Action::Flash, &options.board)
        }
        cli::Command::Attach(options) => {
            probe::run(&workspace, probe::Action::Attach, &options.board)
        }
        cli::Command::Run(options) => probe::run(&workspace, probe::Action::Run, &options.board),
        cli::Command::Keys(options) => keys::run(&workspace, &options),
        cli::Command::Monitor(options) => monitor::run(&workspace, &options),
        cli::Command::New(options) => new::run(&workspace, &options),
        cli::Command::Schedule(options) => schedule::run(&workspace, &options),
        cli::Command::Schedulability(options) => schedulability::run(&workspace, &options),
        cli::Command::Priorities(options) => schedulability::run_priorities(&workspace, &options),
        cli::Command::Selftest(options) => selftest::run(&workspace, &options),
        cli::Command::Sim(options) => match &options.experiment {
            Some(name) => experiment::run(&workspace, name, &options),
            None => sim::run(&workspace, &options),
        },
        cli::Command::Test(options) => match &options.board {
            Some(node) => board::run(&workspace, node, &options),
            None => test::run(&workspace, &options),
        },
    }
}
