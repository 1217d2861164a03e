//! `test`: everything that must hold before a change is kept.

use std::{
    process::Command,
    time::{Duration, Instant},
};

use world::{
    Scenario,
    report::{self, Summary},
    time::from_seconds,
};

use parts::Sled;

use crate::{
    Failure, Workspace, build,
    cli::Test,
    schedulability, sim, size, target, vehicle,
    workspace::{succeed, typed},
};

/// Runs the command: every step, even after one failed.
///
/// # Errors
///
/// Any step failed; which ones is on the screen.
pub fn run(workspace: &Workspace, options: &Test) -> Result<(), Failure> {
    if !options.list {
        target::ensure(workspace)?;
    }
    let steps = steps(workspace, options.random);
    if options.list {
        for step in &steps {
            println!("{}", step.name);
            match &step.work {
                Work::Commands(commands) => {
                    for command in commands {
                        println!("    {}", typed(command));
                    }
                }
                Work::Faults => println!("    cargo xtask sim --faults {FAULTS}"),
                Work::Images => println!("    cargo xtask build"),
                Work::Drive => println!("    cargo xtask sim {DRIVE} --seconds {DRIVE_SECONDS}"),
                Work::Schedulability => println!("    cargo xtask schedulability"),
            }
        }
        return Ok(());
    }

    let count = steps.len();
    let mut finished = Vec::new();
    for (index, step) in steps.into_iter().enumerate() {
        let name = step.name;
        eprintln!("\n[{}/{count}] {name}", index + 1);
        let start = Instant::now();
        let outcome = step.run(workspace);
        let step = Finished {
            name,
            took: start.elapsed(),
            outcome,
        };
        eprintln!("[{}/{count}] {}", index + 1, step.line());
        finished.push(step);
    }
    summary(&finished)
}

/// One step of the test.
struct Step {
    name: &'static str,
    work: Work,
}

enum Work {
    /// Commands that must succeed, all of them run.
    Commands(Vec<Command>),
    /// Random fault sequences against the images.
    Faults,
    /// The images: that they build, are within their budgets and do not panic.
    Images,
    /// A short run of the images on the twin.
    Drive,
    /// Whether the deadlines hold.
    Schedulability,
}

/// How a step ended.
enum Outcome {
    Passed,
    Failed(Vec<String>),
}

impl Step {
    fn commands(name: &'static str, commands: Vec<Command>) -> Self {
        Self {
            name,
            work: Work::Commands(commands),
        }
    }

    fn run(self, workspace: &Workspace) -> Outcome {
        let failures = match self.work {
            Work::Faults => vehicle::find(workspace, vehicle::DEFAULT)
                .and_then(|vehicle| sim::first_faults(workspace, &vehicle, FAULTS))
                .unwrap_or_else(|failure| vec![failure.to_string()]),
            Work::Images => match images(workspace) {
                Ok(()) => Vec::new(),
                Err(failure) => vec![failure.to_string()],
            },
            Work::Schedulability => schedulability::regressions(workspace)
                .unwrap_or_else(|failure| vec![failure.to_string()]),
            Work::Drive => drive(workspace).unwrap_or_else(|failure| vec![failure.to_string()]),
            Work::Commands(commands) => {
                let run = |mut command: Command| {
                    let what = format!("`{}`", typed(&command));
                    eprintln!("{what}");
                    succeed(&mut command, &what).err()
                };
                let failures = commands.into_iter().filter_map(run);
                failures.map(|failure| failure.to_string()).collect()
            }
        };
        if failures.is_empty() {
            Outcome::Passed
        } else {
            Outcome::Failed(failures)
        }
    }
}

/// Crates that exist for a microcontroller only: the host leaves them out.
const BOARDS: [&str; 2] = ["sled-f446", "sled-f303"];

/// Where the property tests begin unless they are told to try something new: a change is
/// judged by the same inputs as the one before it.
const PROPERTY_SEED: (&str, &str) = ("PROPTEST_RNG_SEED", "2017");

fn steps(workspace: &Workspace, random: bool) -> Vec<Step> {
    let host = |command: &str, rest: &[&str]| {
        let mut cargo = workspace.cargo();
        cargo.args([command, "--workspace"]);
        cargo.args(BOARDS.iter().flat_map(|board| ["--exclude", board]));
        cargo.args(rest);
        cargo
    };
    let mut tests = host("test", &["--no-fail-fast"]);
    if !random {
        tests.env(PROPERTY_SEED.0, PROPERTY_SEED.1);
    }
    let mut format = workspace.cargo();
    format.args(["fmt", "--all", "--check"]);
    let strict = ["--", "--deny", "warnings"];
    let lints = host("clippy", &[&["--all-targets"], strict.as_slice()].concat());
    let mut documentation = host("doc", &["--no-deps"]);
    documentation.env("RUSTDOCFLAGS", "--deny warnings");

    let on_target = |command: &str, rest: &[&str]| -> Vec<Command> {
        let boards = Sled::ALL.into_iter();
        let command = |board: &Sled| {
            let mut cargo = target::cargo(workspace, command);
            cargo.args(["--package", "firmware", "--package", "uagv"]);
            cargo.args(["--features", board.name, "--package", board.package]);
            cargo.args(rest);
            cargo.env("RUSTDOCFLAGS", "--deny warnings");
            cargo
        };
        boards.map(command).collect()
    };
    vec![
        Step::commands("format", vec![format]),
        Step::commands("lints, host", vec![lints]),
        Step::commands("lints, images", on_target("clippy", &strict)),
        Step::commands("tests, host", vec![tests]),
        Step {
            name: "images",
            work: Work::Images,
        },
        Step {
            name: "twin",
            work: Work::Drive,
        },
        Step {
            name: "schedulability",
            work: Work::Schedulability,
        },
        Step::commands("documentation, host", vec![documentation]),
        Step::commands("documentation, images", on_target("doc", &["--no-deps"])),
        Step {
            name: "random faults",
            work: Work::Faults,
        },
    ]
}

/// Fault sequences of the step: what two cores do in some five minutes. A night's worth is
/// `cargo xtask sim --faults` with its own number.
pub(crate) const FAULTS: u64 = 200;

fn images(workspace: &Workspace) -> Result<(), Failure> {
    let vehicle = vehicle::find(workspace, vehicle::DEFAULT)?;
    let nodes: Vec<_> = vehicle.nodes().collect();
    let images = build::images(workspace, &vehicle, &nodes)?;
    let build::Checked { sizes, complaints } = build::check(&vehicle, &images)?;
    eprint!("{}", size::table(&sizes));
    match complaints.as_slice() {
        [] => Ok(()),
        complaints => Err(Failure::Failed(complaints.join("; "))),
    }
}

/// The scenario of the twin's step, and how much of it: start-up, both presses
/// of the operator's button and some metres down the line.
const DRIVE: &str = "straight-line";
const DRIVE_SECONDS: f64 = 6.0;

/// Latest start of frame after its window's beginning that is accepted; the
/// thesis's bus shows 378 us (Figure 6.33).
const LATEST_START_US: f64 = 40.0;

/// Drives and says what was wrong with it.
fn drive(workspace: &Workspace) -> Result<Vec<String>, Failure> {
    let vehicle = vehicle::find(workspace, vehicle::DEFAULT)?;
    let scenario =
        Scenario::find(&vehicle, DRIVE).map_err(|error| Failure::Failed(error.to_string()))?;
    let length = from_seconds(DRIVE_SECONDS);
    let finished = sim::simulate(workspace, &vehicle, &scenario, 1, Some(length))?;
    let summary = Summary::of(&finished.run());
    eprint!("{}", report::terminal(&summary, Some(finished.wall())));
    let mut wrong = judge(&summary);
    for node in finished.locked_up() {
        wrong.push(format!("the program of {node} ended in a fault"));
    }
    Ok(wrong)
}

/// What is wrong with the figures of an undisturbed run.
fn judge(summary: &Summary) -> Vec<String> {
    let bus = &summary.bus;
    let mut wrong = Vec::new();
    for window in &bus.windows {
        if window.frames == 0 {
            wrong.push(format!(
                "message {} never was in its window",
                window.message
            ));
        }
    }
    match bus.latest_start_us {
        Some(us) if us <= LATEST_START_US => {}
        Some(us) => wrong.push(format!(
            "a frame started {us} us after its window's beginning, {LATEST_START_US} us are accepted"
        )),
        None => wrong.push("no frame was on the bus".into()),
    }
    for (count, what) in [
        (bus.missed_windows, "missed windows"),
        (
            bus.frames_outside_their_window,
            "frames outside their window",
        ),
        (bus.error_frames, "error frames"),
        (bus.foreign_frames, "foreign frames"),
    ] {
        if count > 0 {
            wrong.push(format!("{count} {what}"));
        }
    }
    if summary.autonomous_runs.is_empty() {
        wrong.push("the vehicle never drove by itself".into());
    }
    wrong
}

/// A finished step.
struct Finished {
    name: &'static str,
    took: Duration,
    outcome: Outcome,
}

impl Finished {
    fn line(&self) -> String {
        let outcome = match &self.outcome {
            Outcome::Passed => "passed".into(),
            Outcome::Failed(failures) => format!("FAILED: {}", failures.join("; ")),
        };
        let seconds = self.took.as_secs_f64();
        format!("{:<24}{seconds:>7.1} s  {outcome}", self.name)
    }
}

/// One line for each step on standard output.
fn summary(steps: &[Finished]) -> Result<(), Failure> {
    eprintln!();
    for step in steps {
        println!("{}", step.line());
    }
    let failed = steps
        .iter()
        .filter(|step| matches!(step.outcome, Outcome::Failed(_)))
        .count();
    match failed {
        0 => Ok(()),
        _ => Err(Failure::Failed(format!(
            "{failed} of {} steps failed",
            steps.len()
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scenario() -> Scenario {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, vehicle::DEFAULT).unwrap();
        Scenario::find(&vehicle, DRIVE).unwrap()
    }

    #[test]
    fn every_command_of_a_step_runs_and_every_failure_is_kept() {
        let workspace = Workspace::find().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let mut touch = Command::new("touch");
        touch.arg(folder.path().join("ran"));
        let step = Step::commands(
            "two failures",
            vec![
                Command::new("false"),
                touch,
                Command::new("no-such-program"),
            ],
        );
        let Outcome::Failed(failures) = step.run(&workspace) else {
            panic!("it passed");
        };
        assert_eq!(failures.len(), 2, "{failures:?}");
        assert!(folder.path().join("ran").exists());
    }

    #[test]
    fn a_failed_step_fails_the_whole() {
        let finished = |outcome| Finished {
            name: "step",
            took: Duration::from_millis(1500),
            outcome,
        };
        assert_eq!(summary(&[finished(Outcome::Passed)]), Ok(()));
        let failure = summary(&[
            finished(Outcome::Passed),
            finished(Outcome::Failed(vec!["why".into()])),
        ]);
        assert_eq!(failure, Err(Failure::Failed("1 of 2 steps failed".into())));
        let passed = finished(Outcome::Passed).line();
        assert!(passed.contains("1.5 s  passed"), "{passed}");
    }

    #[test]
    fn a_silent_bus_is_no_drive() {
        let scenario = scenario();
        let silent = report::Run {
            scenario: &scenario,
            nodes: &[],
            seed: 1,
            duration: from_seconds(1.0),
            states: &[],
            efforts: &[],
            frames: &[],
            windows: &[],
            basic_cycle: from_seconds(0.1),
            bit_time: from_seconds(4e-6),
            modes: &[],
            tasks: &[],
        };
        let wrong = judge(&Summary::of(&silent)).join("; ");
        assert!(wrong.contains("no frame was on the bus"), "{wrong}");
        assert!(wrong.contains("never drove"), "{wrong}");
    }

    #[test]
    fn late_frames_and_missed_windows_are_wrong() {
        let scenario = scenario();
        let us = |us: u64| world::SimDuration::from_ticks(us * 1_000_000);
        let window = |id, kind, start| report::Window {
            id,
            message: format!("message{id}"),
            sender: "gps".into(),
            start: us(start),
            length: us(1000),
            kind,
            due: report::Due::Always,
        };
        let frame = |id, start| report::FrameRecord {
            id,
            dlc: 0,
            data: [0; 8],
            start: world::time::at(us(start)),
            end: world::time::at(us(start + 200)),
            complete: true,
        };
        let windows = [
            window(100, report::WindowKind::Reference, 0),
            window(200, report::WindowKind::Exclusive, 1000),
        ];
        let frames = [
            frame(100, 0),
            frame(200, 1041),
            frame(100, 100_000),
            frame(100, 200_000),
        ];
        let run = report::Run {
            scenario: &scenario,
            nodes: &[],
            seed: 1,
            duration: us(250_000),
            states: &[],
            efforts: &[],
            frames: &frames,
            windows: &windows,
            basic_cycle: us(100_000),
            bit_time: us(4),
            modes: &[],
            tasks: &[],
        };
        let wrong = judge(&Summary::of(&run)).join("; ");
        assert!(wrong.contains("started 41 us after"), "{wrong}");
        assert!(wrong.contains("2 missed windows"), "{wrong}");
        assert!(!wrong.contains("never was in its window"), "{wrong}");
    }

    #[test]
    fn the_boards_are_left_to_the_target() {
        let workspace = Workspace::find().unwrap();
        let steps = steps(&workspace, false);
        let Some(Work::Commands(commands)) = steps
            .iter()
            .find(|step| step.name == "tests, host")
            .map(|step| &step.work)
        else {
            panic!("no host tests");
        };
        let typed = typed(&commands[0]);
        assert!(typed.contains("--exclude sled-f303"), "{typed}");
    }
}
