//! `test`: everything that must hold before a change is kept.

mod binaries;
mod oldest;

use std::{
    process::Command,
    time::{Duration, Instant},
};

use world::{
    report::{self, Summary},
    time::from_seconds,
};

use parts::Sled;
use vehicle_model::{Device, NodeIndex, Override, Overrides, Protocol, Vehicle};

use crate::{
    Failure, Workspace, board, build,
    cli::Test,
    schedulability, sim, size, target, vehicle,
    workspace::{succeed, typed},
};

/// Steps failed, as shown on the screen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("{failed} of {of} steps failed")]
pub struct Error {
    failed: usize,
    of: usize,
}

/// Runs the command: every step, even after one failed.
///
/// # Errors
///
/// Any step failed; which ones is on the screen.
pub fn run(workspace: &Workspace, options: &Test) -> Result<(), Failure> {
    if !options.list {
        target::ensure(workspace)?;
        target::ensure_small(workspace)?;
    }
    let steps = steps(workspace, options)?;
    if options.list {
        list(&steps);
        return Ok(());
    }

    let count = steps.len();
    let mut finished = Vec::new();
    for (index, step) in steps.into_iter().enumerate() {
        let name = step.name.clone();
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
    Ok(summary(&finished)?)
}

/// Prints what each step runs.
fn list(steps: &[Step]) {
    for step in steps {
        println!("{}", step.name);
        match &step.work {
            Work::Commands(commands) => {
                for command in commands {
                    println!("    {}", typed(command));
                }
            }
            Work::Tests { cargo, long } => {
                let slow = if *long { " -- --include-ignored" } else { "" };
                println!("    {}{slow}", typed(cargo));
            }
            Work::Faults(count) => println!("    cargo xtask sim --faults {count}"),
            Work::Attacks(count) => {
                println!("    cargo xtask sim --faults {count} --attacker");
            }
            Work::Board { node, vehicle, .. } => {
                println!("    cargo xtask test --board {node} --vehicle {vehicle} --twin");
            }
            Work::Images(vehicle) => println!("    cargo xtask build --vehicle {vehicle}"),
            Work::Drive(vehicle) => {
                println!("    cargo xtask sim --vehicle {vehicle} --seconds {DRIVE_SECONDS}");
            }
            Work::Schedulability(vehicle) => {
                println!("    cargo xtask schedulability --vehicle {vehicle}");
            }
            Work::EventTriggered { vehicle, observed } => println!(
                "    cargo xtask schedulability --vehicle {vehicle} --bus event-triggered{}",
                runs(*observed)
            ),
            Work::SwitchedOn {
                vehicle,
                sets,
                observed,
            } => {
                let sets: Vec<String> = sets.iter().map(|set| format!("--set {set}")).collect();
                let sets = sets.join(" ");
                let runs = runs(*observed);
                println!("    cargo xtask schedulability --vehicle {vehicle} {sets}{runs}");
            }
        }
    }
}

/// One step of the test.
struct Step {
    name: String,
    work: Work,
}

enum Work {
    /// Commands that must succeed, all of them run.
    Commands(Vec<Command>),
    /// The tests that this command of cargo builds, with or without the slow ones.
    Tests { cargo: Command, long: bool },
    /// So many random fault sequences against the images.
    Faults(u64),
    /// Sequences of `sim --faults --attacker`.
    Attacks(u64),
    /// The tests of a board, on the twin.
    Board {
        sled: &'static Sled,
        /// A node that has the board, and its vehicle.
        node: String,
        vehicle: String,
    },
    /// The images of a vehicle: that they build, are within their budgets and do not panic.
    Images(String),
    /// A short run of a vehicle's images on the twin.
    Drive(String),
    /// Whether the deadlines of a vehicle hold.
    Schedulability(String),
    /// Whether they hold when its nodes send at once, without the schedule.
    EventTriggered { vehicle: String, observed: bool },
    /// Whether they hold with nodes that are off in the manifest, and the values that switch them on.
    SwitchedOn {
        vehicle: String,
        sets: Vec<&'static str>,
        observed: bool,
    },
}

/// What the list of steps says behind an analysis. Its runs take a minute and more, and those of the vehicles as they
/// are in their manifests have the same programs in them.
fn runs(observed: bool) -> &'static str {
    if observed { "" } else { "  (without its runs)" }
}

/// How a step ended.
enum Outcome {
    Passed,
    Failed(Vec<String>),
}

impl Step {
    fn new(name: impl Into<String>, work: Work) -> Self {
        Self {
            name: name.into(),
            work,
        }
    }

    fn run(self, workspace: &Workspace) -> Outcome {
        let found = |name: &str| vehicle::find(workspace, name).map_err(Failure::from);
        let failed = |failure: Failure| vec![failure.to_string()];
        let failures = match self.work {
            Work::Faults(count) => found(vehicle::DEFAULT)
                .and_then(|vehicle| {
                    sim::first_faults(workspace, &vehicle, count, sim::Trouble::Faults)
                })
                .unwrap_or_else(failed),
            Work::Attacks(count) => found(vehicle::DEFAULT)
                .and_then(|vehicle| {
                    let attacks = sim::Trouble::Attacks { key: true };
                    sim::first_faults(workspace, &vehicle, count, attacks)
                })
                .unwrap_or_else(failed),
            Work::Board { sled, .. } => {
                board::failures_on_twin(workspace, sled).unwrap_or_else(failed)
            }
            Work::Images(name) => found(&name)
                .and_then(|vehicle| images(workspace, &vehicle))
                .unwrap_or_else(failed),
            Work::Drive(name) => found(&name)
                .and_then(|vehicle| drive(workspace, &vehicle))
                .unwrap_or_else(failed),
            Work::Schedulability(name) => found(&name)
                .and_then(|vehicle| schedulability::regressions(workspace, &vehicle, true))
                .unwrap_or_else(failed),
            Work::EventTriggered { vehicle, observed } => event_triggered(workspace, &vehicle)
                .and_then(|vehicle| schedulability::regressions(workspace, &vehicle, observed))
                .unwrap_or_else(failed),
            Work::SwitchedOn {
                vehicle,
                sets,
                observed,
            } => with_values(workspace, &vehicle, &sets)
                .and_then(|vehicle| schedulability::regressions(workspace, &vehicle, observed))
                .unwrap_or_else(failed),
            Work::Tests { cargo, long } => {
                let slow: &[&str] = if long { &["--include-ignored"] } else { &[] };
                binaries::run(cargo, slow)
            }
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
const BOARDS: [&str; 4] = ["sled-f446", "sled-f303", "board-tests", "can-node"];

/// Where the property tests begin unless they are told to try something new: a change is
/// judged by the same inputs as the one before it.
const PROPERTY_SEED: (&str, &str) = ("PROPTEST_RNG_SEED", "2017");

/// The vehicle of that name without the schedule. A vehicle with a steering has no such way.
fn event_triggered(workspace: &Workspace, name: &str) -> Result<Vehicle, Failure> {
    let overrides = Overrides::default().on(Protocol::EventTriggered);
    Ok(vehicle::with(workspace, name, &overrides)?)
}

fn steps(workspace: &Workspace, options: &Test) -> Result<Vec<Step>, Failure> {
    let names = vehicle::names(workspace)?;
    let mut steps = vec![
        Step::new("format", Work::Commands(vec![format(workspace)])),
        Step::new("lints, host", Work::Commands(vec![lints(workspace)])),
        Step::new(
            "lints, images",
            Work::Commands(on_target(workspace, &names, "clippy", &DENIED)?),
        ),
        Step::new(
            "tests, host",
            Work::Tests {
                cargo: tests(workspace, options),
                long: options.long,
            },
        ),
        Step::new(
            "examples in texts",
            Work::Commands(vec![examples(workspace)]),
        ),
    ];
    steps.extend(board_tests(workspace)?);
    for name in &names {
        let step = |what: &str, work: fn(String) -> Work| {
            Step::new(format!("{what}, {name}"), work(name.clone()))
        };
        let vehicle = vehicle::find(workspace, name)?;
        steps.push(step("images", Work::Images));
        steps.push(step("twin", Work::Drive));
        steps.extend(analyses(workspace, &vehicle, options.long));
    }
    let uagv = vehicle::find(workspace, vehicle::DEFAULT)?;
    if options.long {
        // All at once: the control step has the most to do then.
        let work = Work::SwitchedOn {
            vehicle: uagv.name().to_owned(),
            sets: additions(&uagv),
            observed: true,
        };
        steps.push(Step::new("planner, missions and others, uagv", work));
        steps.push(Step::new(
            "roll and pitch, uagv",
            Work::Commands(vec![tests_of_tilt(workspace)]),
        ));
        steps.push(Step::new(
            "oldest compiler, ttcan",
            Work::Commands(oldest::checks(workspace)),
        ));
    }
    steps.extend([
        Step::new(
            "documentation, host",
            Work::Commands(vec![documentation(workspace)]),
        ),
        Step::new(
            "documentation, images",
            Work::Commands(on_target(workspace, &names, "doc", &["--no-deps"])?),
        ),
        Step::new(
            "random faults",
            Work::Faults(if options.long { LONG_FAULTS } else { FAULTS }),
        ),
        Step::new(
            "attacks",
            Work::Attacks(if options.long { LONG_ATTACKS } else { ATTACKS }),
        ),
    ]);
    Ok(steps)
}

/// The analyses of a vehicle: as it is, without the schedule, and with all its nodes.
fn analyses(workspace: &Workspace, vehicle: &Vehicle, long: bool) -> Vec<Step> {
    let name = vehicle.name();
    let mut steps = Vec::new();
    let mut add = |what: &str, work| steps.push(Step::new(format!("{what}, {name}"), work));
    // The tasks of a variant are those of the other vehicle, with other numbers, but for a guardian's.
    let varied = vehicle.variant_of().is_some();
    if !varied || long || vehicle.guardian().is_some() {
        add("schedulability", Work::Schedulability(name.to_owned()));
    }
    if varied {
        return steps;
    }
    if event_triggered(workspace, name).is_ok() {
        let work = Work::EventTriggered {
            vehicle: name.to_owned(),
            observed: long,
        };
        add("event-triggered", work);
    }
    // All of them at once: a node that is on has more to do, and delays the others more.
    let (what, sets): (Vec<_>, Vec<_>) = switches(vehicle)
        .into_iter()
        .map(|Switch { what, set }| (what, set))
        .unzip();
    if !sets.is_empty() {
        let work = Work::SwitchedOn {
            vehicle: name.to_owned(),
            sets,
            observed: long,
        };
        add(&what.join(" and "), work);
    }
    steps
}

/// The tests of each board that the usual vehicle has.
fn board_tests(workspace: &Workspace) -> Result<Vec<Step>, Failure> {
    let vehicle = vehicle::find(workspace, vehicle::DEFAULT)?;
    let tests = Sled::ALL.into_iter().filter_map(|sled| {
        let node = vehicle
            .nodes()
            .find(|&node| vehicle::board(&vehicle, node) == sled)?;
        let work = Work::Board {
            sled,
            node: vehicle.node(node).name.clone(),
            vehicle: vehicle.name().to_owned(),
        };
        Some(Step::new(format!("board tests, {}", sled.name), work))
    });
    Ok(tests.collect())
}

/// What makes a warning of clippy an error.
const DENIED: [&str; 3] = ["--", "--deny", "warnings"];

fn format(workspace: &Workspace) -> Command {
    let mut cargo = workspace.cargo();
    cargo.args(["fmt", "--all", "--check"]);
    cargo
}

/// A command of cargo on all crates of the host.
fn on_host(workspace: &Workspace, command: &str) -> Command {
    let mut cargo = workspace.cargo();
    cargo.args([command, "--workspace"]);
    cargo.args(BOARDS.iter().flat_map(|board| ["--exclude", board]));
    cargo
}

fn lints(workspace: &Workspace) -> Command {
    let mut cargo = on_host(workspace, "clippy");
    cargo.arg("--all-targets").args(DENIED);
    cargo
}

fn tests(workspace: &Workspace, options: &Test) -> Command {
    let mut cargo = on_host(workspace, "test");
    if !options.random {
        cargo.env(PROPERTY_SEED.0, PROPERTY_SEED.1);
    }
    cargo
}

/// The tests of what the UAGV's nodes do for roll and pitch, which are off in its manifest.
fn tests_of_tilt(workspace: &Workspace) -> Command {
    let mut cargo = workspace.cargo();
    cargo.args(["test", "--package", "uagv", "--test", "tilt"]);
    cargo.env(vehicle_model::build::OVERRIDES, "tilt.enabled=true");
    cargo
}

/// The examples in the documentation of the crates.
fn examples(workspace: &Workspace) -> Command {
    let mut cargo = on_host(workspace, "test");
    cargo.args(["--doc", "--no-fail-fast"]);
    cargo
}

fn documentation(workspace: &Workspace) -> Command {
    let mut cargo = on_host(workspace, "doc");
    cargo.arg("--no-deps");
    cargo.env("RUSTDOCFLAGS", "--deny warnings");
    cargo
}

/// A command of cargo on what each board's images are made of: the board's own crate, what
/// nodes share, and the vehicles that have a node with this board.
fn on_target(
    workspace: &Workspace,
    names: &[String],
    command: &str,
    rest: &[&str],
) -> Result<Vec<Command>, Failure> {
    let vehicles = names.iter().map(|name| vehicle::find(workspace, name));
    let mut vehicles = vehicles.collect::<Result<Vec<_>, _>>()?;
    // A variant has no crate of its own.
    vehicles.retain(|vehicle| vehicle.variant_of().is_none());
    let mut commands = Vec::new();
    for board in Sled::ALL {
        let mut cargo = target::cargo(workspace, command);
        cargo.args(["--features", board.name, "--package", board.package]);
        cargo.args(["--package", "firmware", "--package", "board-tests"]);
        if board == Sled::F446 {
            cargo.args(["--package", "can-node"]);
        }
        for vehicle in &vehicles {
            let mut nodes = vehicle.nodes();
            if nodes.any(|node| vehicle::board(vehicle, node) == board) {
                cargo.args(["--package", &vehicle::package(vehicle)?]);
            }
        }
        cargo.args(rest);
        cargo.env("RUSTDOCFLAGS", "--deny warnings");
        commands.push(cargo);
    }
    for vehicle in &vehicles {
        commands.extend(switched_on(workspace, vehicle, command, rest)?);
    }
    Ok(commands)
}

/// The same for nodes that are off in a vehicle's manifest: the other commands do not see them.
fn switched_on(
    workspace: &Workspace,
    vehicle: &Vehicle,
    command: &str,
    rest: &[&str],
) -> Result<Vec<Command>, Failure> {
    let mut commands = Vec::new();
    for Switch { set, .. } in switches(vehicle) {
        let on = with_values(workspace, vehicle.name(), &[set])?;
        // The node that the value adds is the last one.
        commands.extend(with_node(workspace, &on, on.nodes().last(), command, rest)?);
    }
    for set in additions(vehicle) {
        // It adds no node: the one that the operator commands has it.
        let on = with_values(workspace, vehicle.name(), &[set])?;
        let node = on.node_of(Device::OperatorSwitches);
        commands.extend(with_node(workspace, &on, node, command, rest)?);
        // Those that obey commands have sessions, too.
        if on.manifest().has_sessions() {
            let other = on.nodes().find(|other| {
                node.is_some_and(|node| vehicle::board(&on, *other) != vehicle::board(&on, node))
            });
            commands.extend(with_node(workspace, &on, other, command, rest)?);
        }
    }
    Ok(commands)
}

/// A command of cargo on what has the board of a node of a vehicle.
fn with_node(
    workspace: &Workspace,
    vehicle: &Vehicle,
    node: Option<NodeIndex>,
    command: &str,
    rest: &[&str],
) -> Result<Option<Command>, Failure> {
    let Some(node) = node else {
        return Ok(None);
    };
    let mut cargo = build::with_features(target::cargo(workspace, command), vehicle, node)?;
    cargo.args(rest);
    cargo.env("RUSTDOCFLAGS", "--deny warnings");
    Ok(Some(cargo))
}

/// The values that switch on what is off in a vehicle's manifest and adds no node.
fn additions(vehicle: &Vehicle) -> Vec<&'static str> {
    let manifest = vehicle.manifest();
    let planner = manifest.planner.as_ref().map(|planner| planner.enabled);
    let mission = manifest.mission.as_ref().map(|mission| mission.enabled);
    let sessions = manifest.sessions.as_ref().map(|sessions| sessions.enabled);
    let tilt = manifest.tilt.as_ref().map(|tilt| tilt.enabled);
    let off = [
        (planner, "planner.enabled=true"),
        (mission, "mission.enabled=true"),
        (sessions, "sessions.enabled=true"),
        (tilt, "tilt.enabled=true"),
    ];
    let off = off.into_iter().filter(|(on, _)| *on == Some(false));
    off.map(|(_, set)| set).collect()
}

/// A node that is off in a vehicle's manifest.
struct Switch {
    /// What it is, for the name of the step that tests the vehicle with it.
    what: &'static str,
    /// The value that switches it on.
    set: &'static str,
}

/// The nodes that are off in a vehicle's manifest.
fn switches(vehicle: &Vehicle) -> Vec<Switch> {
    let manifest = vehicle.manifest();
    let rows = manifest.row_guidance.as_ref().map(|rows| rows.enabled);
    let guardian = manifest.guardian.as_ref();
    let guardian = guardian.map(|guardian| guardian.enabled);
    let rows = (rows == Some(false)).then_some(Switch {
        what: "row guidance",
        set: "row_guidance.enabled=true",
    });
    let guardian = (guardian == Some(false)).then_some(Switch {
        what: "guardian",
        set: "guardian.enabled=true",
    });
    rows.into_iter().chain(guardian).collect()
}

/// The vehicle of that name with these values in place of its manifest's.
fn with_values(workspace: &Workspace, name: &str, sets: &[&str]) -> Result<Vehicle, Failure> {
    let on = sets.iter().filter_map(|set| Override::parse(set).ok());
    Ok(vehicle::with(workspace, name, &on.collect())?)
}

/// Fault sequences of the step: what two cores do in about a minute. A night's worth is
/// `cargo xtask sim --faults` with its own number.
pub(crate) const FAULTS: u64 = 30;

/// The same with `--long`.
const LONG_FAULTS: u64 = 1000;

/// Sequences of the step with an attacker: some 10 000 forged and replayed frames.
const ATTACKS: u64 = 40;

/// The same with `--long`.
const LONG_ATTACKS: u64 = 1000;

fn images(workspace: &Workspace, vehicle: &Vehicle) -> Result<Vec<String>, Failure> {
    let nodes: Vec<_> = vehicle.nodes().collect();
    let images = build::images(workspace, vehicle, &nodes)?;
    let build::Checked { sizes, complaints } = build::check(vehicle, &images)?;
    eprint!("{}", size::table(&sizes));
    Ok(complaints)
}

/// How much of a vehicle's usual scenario the twin's step runs: for the UAGV start-up, both
/// presses of the operator's button and some metres down the line.
const DRIVE_SECONDS: f64 = 6.0;

/// Latest start of frame after its window's beginning that is accepted; the
/// thesis's bus shows 378 us (Figure 6.33).
const LATEST_START_US: f64 = 40.0;

/// Drives and says what was wrong with it.
fn drive(workspace: &Workspace, vehicle: &Vehicle) -> Result<Vec<String>, Failure> {
    let scenario = sim::usual_scenario(vehicle)?;
    let wish = sim::Wish {
        seed: 1,
        length: Some(from_seconds(DRIVE_SECONDS)),
        ..sim::Wish::default()
    };
    let finished = sim::simulate(workspace, vehicle, &scenario, wish)?;
    let summary = Summary::of(&finished.run());
    eprint!("{}", report::terminal(&summary, Some(finished.wall())));
    let mut wrong = judge(&summary);
    for node in finished.locked_up() {
        wrong.push(format!("the program of {node} ended in a fault"));
    }
    let drives_itself = scenario.vehicle.is_some();
    if drives_itself && summary.autonomous_runs.is_empty() {
        wrong.push("the vehicle never drove by itself".into());
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
    wrong
}

/// A finished step.
struct Finished {
    name: String,
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
fn summary(steps: &[Finished]) -> Result<(), Error> {
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
        _ => Err(Error {
            failed,
            of: steps.len(),
        }),
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use super::*;

    const USUAL: Test = Test {
        set: Vec::new(),
        list: false,
        long: false,
        random: false,
        board: None,
        vehicle: None,
        probe: None,
        twin: false,
        json: false,
    };

    fn scenario() -> world::Scenario {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, vehicle::DEFAULT).unwrap();
        sim::usual_scenario(&vehicle).unwrap()
    }

    #[test]
    fn every_command_of_a_step_runs_and_every_failure_is_kept() {
        let workspace = Workspace::find().unwrap();
        let folder = tempfile::tempdir().unwrap();
        let mut touch = Command::new("touch");
        touch.arg(folder.path().join("ran"));
        let commands = vec![
            Command::new("false"),
            touch,
            Command::new("no-such-program"),
        ];
        let step = Step::new("two failures", Work::Commands(commands));
        let Outcome::Failed(failures) = step.run(&workspace) else {
            panic!("it passed");
        };
        assert_eq!(failures.len(), 2, "{failures:?}");
        assert!(folder.path().join("ran").exists());
    }

    #[test]
    fn a_failed_step_fails_the_whole() {
        let finished = |outcome| Finished {
            name: "step".into(),
            took: Duration::from_millis(1500),
            outcome,
        };
        assert_eq!(summary(&[finished(Outcome::Passed)]), Ok(()));
        let failure = summary(&[
            finished(Outcome::Passed),
            finished(Outcome::Failed(vec!["why".into()])),
        ]);
        assert_eq!(failure.unwrap_err().to_string(), "1 of 2 steps failed");
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
            cycle_count_byte: 0,
            basic_cycle: from_seconds(0.1),
            bit_time: from_seconds(4e-6),
            modes: &[],
            tasks: &[],
            rover: None,
            crop: None,
            mission: None,
        };
        let wrong = judge(&Summary::of(&silent)).join("; ");
        assert!(wrong.contains("no frame was on the bus"), "{wrong}");
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
            repeat: 1,
            offset: 0,
            kind,
            due: report::Due::Always,
        };
        let frame = |id, start| report::FrameRecord {
            remote: false,
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
            cycle_count_byte: 0,
            basic_cycle: us(100_000),
            bit_time: us(4),
            modes: &[],
            tasks: &[],
            rover: None,
            crop: None,
            mission: None,
        };
        let wrong = judge(&Summary::of(&run)).join("; ");
        assert!(wrong.contains("started 41 us after"), "{wrong}");
        assert!(wrong.contains("2 missed windows"), "{wrong}");
        assert!(!wrong.contains("never was in its window"), "{wrong}");
    }

    /// Crates and their features, as `cargo tree` tells them.
    fn crates(workspace: &Workspace, arguments: &[&str]) -> BTreeSet<(String, String)> {
        let mut cargo = workspace.cargo();
        cargo.args(["tree", "--prefix", "none", "--no-dedupe"]);
        cargo.args(["--format", "{p}|{f}"]).args(arguments);
        let text = crate::workspace::output(&mut cargo).unwrap();
        let crates = text.lines().map(|line| line.trim_end_matches(" (*)"));
        let crates = crates.filter_map(|line| line.split_once('|'));
        let owned = crates.map(|(name, features)| (name.to_owned(), features.to_owned()));
        owned.collect()
    }

    /// Else all that depends on one of them is built twice.
    #[test]
    fn tests_use_the_libraries_that_the_command_was_built_with() {
        let workspace = Workspace::find().unwrap();
        let command = crates(
            &workspace,
            &["--package", "xtask", "--edges", "normal,build"],
        );
        assert!(command.len() > 100, "{command:?}");
        let mut all = vec!["--workspace", "--edges", "normal,build,dev"];
        all.extend(BOARDS.iter().flat_map(|board| ["--exclude", board]));
        let others = crates(&workspace, &all).into_iter().filter(|one| {
            let (name, _) = one;
            command.iter().any(|(known, _)| known == name) && !command.contains(one)
        });
        let others: Vec<_> = others.collect();
        assert!(
            others.is_empty(),
            "xtask/Cargo.toml must ask for these features, too: {others:?}"
        );
    }

    #[test]
    fn the_boards_are_left_to_the_target() {
        let workspace = Workspace::find().unwrap();
        let usual = typed(&tests(&workspace, &USUAL));
        assert!(usual.contains("--exclude sled-f303"), "{usual}");
    }

    #[test]
    fn every_boards_tests_run_on_the_twin() {
        let workspace = Workspace::find().unwrap();
        let steps = steps(&workspace, &USUAL).unwrap();
        for sled in Sled::ALL {
            let runs =
                |step: &&Step| matches!(step.work, Work::Board { sled: of, .. } if of == sled);
            assert_eq!(steps.iter().filter(runs).count(), 1, "{}", sled.name);
        }
    }

    #[test]
    fn slow_tests_wait_for_the_long_run() {
        let workspace = Workspace::find().unwrap();
        let of = |options: &Test| {
            let steps = steps(&workspace, options).unwrap();
            steps
                .iter()
                .any(|step| matches!(step.work, Work::Tests { long: true, .. }))
        };
        assert!(!of(&USUAL));
        assert!(of(&Test {
            long: true,
            ..USUAL
        }));
    }

    #[test]
    fn every_analysis_has_its_runs_in_the_long_test() {
        let workspace = Workspace::find().unwrap();
        let without = |options: &Test| {
            let steps = steps(&workspace, options).unwrap();
            let without = |step: &&Step| {
                matches!(
                    step.work,
                    Work::EventTriggered {
                        observed: false,
                        ..
                    } | Work::SwitchedOn {
                        observed: false,
                        ..
                    }
                )
            };
            steps.iter().filter(without).count()
        };
        assert_eq!(without(&USUAL), 3);
        let long = Test {
            long: true,
            ..USUAL
        };
        assert_eq!(without(&long), 0);
    }

    #[test]
    fn every_vehicle_is_checked_for_the_boards_that_it_has() {
        let workspace = Workspace::find().unwrap();
        let names = vehicle::names(&workspace).unwrap();
        let commands = on_target(&workspace, &names, "clippy", &DENIED).unwrap();
        let (boards, switched_on) = commands.split_at(Sled::ALL.len());
        let [rows, guardian, ..] = switched_on else {
            panic!("{switched_on:?}");
        };
        let line = typed(rows);
        assert!(
            line.starts_with("FURROW_SET=row_guidance.enabled=true cargo clippy"),
            "{line}"
        );
        assert!(
            line.contains("--package uagv --features f303 --features row-guidance"),
            "{line}"
        );
        let line = typed(guardian);
        assert!(
            line.contains("FURROW_SET=guardian.enabled=true")
                && line.contains("--package uagv --features f446 --features guardian"),
            "{line}"
        );
        for command in boards {
            let typed = typed(command);
            for package in ["firmware", "uagv", "two-boards"] {
                assert!(typed.contains(&format!("--package {package}")), "{typed}");
            }
        }
        let steps = steps(&workspace, &USUAL).unwrap();
        let has = |steps: &[Step], what: &str, name: &str| {
            let step = format!("{what}, {name}");
            steps.iter().any(|one| one.name == step)
        };
        for name in &names {
            for what in ["images", "twin"] {
                assert!(has(&steps, what, name), "{what}, {name}");
            }
            let vehicle = vehicle::find(&workspace, name).unwrap();
            let analysed = vehicle.variant_of().is_none() || vehicle.guardian().is_some();
            assert_eq!(has(&steps, "schedulability", name), analysed, "{name}");
        }
        let long = Test {
            long: true,
            ..USUAL
        };
        let long = super::steps(&workspace, &long).unwrap();
        assert!(has(&long, "schedulability", "tractor"));
        let both_ways = |name: &str| {
            let step = format!("event-triggered, {name}");
            steps.iter().any(|one| one.name == step)
        };
        assert!(both_ways("row-follower") && both_ways("two-boards") && !both_ways("uagv"));
        assert!(
            steps
                .iter()
                .any(|one| one.name == "row guidance and guardian, uagv")
        );
    }
}
