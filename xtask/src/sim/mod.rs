//! `sim`: runs the release images on the virtual vehicle and reports the result.

pub(crate) mod bus;
pub(crate) mod choice;
pub(crate) mod distances;
mod faults;
mod gdb;
mod live;
mod recording;
mod sense;
mod tasks;
mod view;

pub use gdb::Place;
pub use view::{NoSpeed, SPEEDS, Speed};

pub(crate) use faults::{Trouble, first as first_faults};
pub use live::{Can, Error as LiveError};

use std::{
    collections::BTreeMap,
    fs, io,
    path::PathBuf,
    time::{Duration, Instant},
};
use world::time::Span as _;

use campaign::agreement::{self, Agreement};
use serde_json::json;
use twin::{Images, NodeOutcome, Outcome, Twin, TwinError};
use vehicle_model::{NodeIndex, Vehicle};
use world::{
    EffortChange, Scenario, ScenarioError, SimDuration, SimTime,
    report::{
        self, CropRun, DistancePair, FolderError, GateFigures, GlobalTimeFigures, Judgement,
        ModeChange, OutputFolder, RoverRun, Run, Summary, TaskTime,
    },
    scenario::{Button, Listed},
    time,
};

use crate::{
    Failure, Workspace, build, cli::Sim, mission, network::matrix::Matrix, progress::Display,
    vehicle,
};
use bus::Log;
use live::Live;
use recording::{NodeRecording, Recorder};
use view::Subject;

/// Why a simulation fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The scenario is wrong.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// Some of the listed scenarios are wrong.
    #[error("{wrong} of {of} scenarios cannot be read; the list says why")]
    Listed {
        /// How many are.
        wrong: usize,
        /// How many there are.
        of: usize,
    },
    /// The rules of the fault sequences do not fit.
    #[error(
        "--faults needs a time-triggered bus: its rules are those of the schedule, and the nodes are event-triggered"
    )]
    NoRules,
    /// The nodes would refuse every command with a key.
    #[error(
        "--attacker needs a time-triggered bus: event-triggered nodes have no system time, so with a key they would \
         obey no command"
    )]
    NoKey,
    /// The manifest of a vehicle names no command that an attacker could forge.
    #[error(
        "--attacker needs a vehicle whose vehicle.toml has the table [command]: without it nobody knows which \
         message moves the motors of {vehicle:?}"
    )]
    NoCommand {
        /// The vehicle.
        vehicle: String,
    },
    /// The vehicle has no scenario and none is named.
    #[error("vehicle {vehicle:?} has no scenario: name a file")]
    NoScenario {
        /// The vehicle.
        vehicle: String,
    },
    /// Nobody lets the rover of a scenario go.
    #[error(
        "scenario {scenario}, press: nobody lets the robot go, so it would stand: a [[press]] with at = \"500 \
         ms\" and button = \"run\" is needed"
    )]
    NeverOn {
        /// The scenario.
        scenario: String,
    },
    /// The output folder is wrong.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// Other programs cannot take part.
    #[error(transparent)]
    Live(#[from] live::Error),
    /// The recording cannot be made.
    #[error("run.mcap cannot be made: {0}")]
    Recording(#[source] ::mcap::McapError),
    /// The page cannot be made.
    #[error("run.html cannot be made: {0}")]
    Page(#[source] io::Error),
    /// The virtual vehicle cannot be built.
    #[error(transparent)]
    Twin(#[from] TwinError),
    /// `--gdb`: the port cannot be taken.
    #[error(
        "port {port} of localhost cannot be used ({error}): --gdb NODE:PORT takes another one, NODE:0 any free one"
    )]
    Port {
        /// The port.
        port: u16,
        /// Why not.
        #[source]
        error: io::Error,
    },
    /// `--until`: neither a time nor an event of this vehicle.
    #[error("--until: {why}")]
    Until {
        /// What is wrong, and what is accepted.
        why: String,
    },
    /// `--gdb`: nobody can connect.
    #[error("gdb cannot connect: {0}")]
    Connection(#[source] io::Error),
    /// The source of a node cannot be read.
    #[error("{}: {error}", path.display())]
    Source {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        #[source]
        error: SourceError,
    },
    /// Programs ended in a fault that they could not handle.
    #[error("the program of {} ended in a fault", nodes.join(", "))]
    Fault {
        /// The nodes.
        nodes: Vec<String>,
    },
    /// The run does not show what its scenario expects.
    #[error("{failed} of {of} expectations of the scenario failed: {first}")]
    Unexpected {
        /// How many failed.
        failed: usize,
        /// How many there are.
        of: usize,
        /// The first that failed, and what was seen.
        first: String,
    },
    /// A motor never turned while the vehicle drove by itself.
    #[error(
        "the vehicle drove by itself, but node {node} never turned its motor: the law never asked for it, or the \
         node refuses every command"
    )]
    IdleMotor {
        /// The node with the motor.
        node: String,
    },
}

impl Error {
    /// Whether the command line or an input file is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::Scenario(_)
                | Self::Listed { .. }
                | Self::NoRules
                | Self::NoKey
                | Self::NoCommand { .. }
                | Self::NoScenario { .. }
                | Self::NeverOn { .. }
                | Self::Port { .. }
                | Self::Until { .. }
                | Self::Folder(_)
                | Self::Live(_)
        )
    }
}

/// What is wrong with the source of a node.
#[derive(Debug, thiserror::Error)]
pub enum SourceError {
    /// It cannot be read.
    #[error(transparent)]
    Read(#[from] io::Error),
    /// It is not Rust.
    #[error(transparent)]
    Syntax(#[from] syn::Error),
}

/// Runs the command.
///
/// # Errors
///
/// The scenario or the output folder is wrong (exit code 2), or an image
/// does not build or run.
pub fn run(workspace: &Workspace, options: &Sim) -> Result<(), Failure> {
    if options.faults.is_some() || options.list {
        let vehicle = vehicle::with(workspace, &options.vehicle, &options.changes.overrides())?;
        let Some(sequences) = options.faults else {
            return list(&vehicle, options.json).map_err(Failure::from);
        };
        check_campaign(&vehicle, options.attacker)?;
        return faults::run(workspace, &vehicle, options, sequences);
    }
    // Wrong input is reported before a build that takes time.
    let (vehicle, mut scenario) = choice::choose(workspace, options)?;
    switched_on(&vehicle, &scenario)?;
    let debugger = options.gdb.as_ref().map(|place| {
        let until = options.until.as_deref();
        gdb::Session::new(&vehicle, place, until)
    });
    let debugger = debugger.transpose()?;
    if let Some(note) = options.seconds.and_then(|end| cut_off(&scenario, end)) {
        eprintln!("{note}");
    }
    let folder = match &options.out {
        Some(path) => Some(OutputFolder::create(path).map_err(Error::from)?),
        None => None,
    };

    let mission = match &options.mission {
        None => None,
        Some(path) => {
            let loaded = mission::load(&vehicle, path)?;
            mission::settle(&mut scenario, loaded.origin)?;
            // A scenario that the user names says itself where the vehicle stands.
            if options.scenario.is_none() {
                loaded.begin(&mut scenario);
            }
            Some(loaded)
        }
    };
    let live = live(&vehicle, options).map_err(Error::from)?;
    let wish = Wish {
        seed: options.seed,
        length: options.seconds,
        tasks: folder.is_some(),
        live,
        mission,
        ..Wish::default()
    };
    let finished = match debugger {
        None => simulate(workspace, &vehicle, &scenario, wish)?,
        Some(session) => match session.run(workspace, &vehicle, &scenario, &wish)? {
            Some((twin, images)) => finish(&vehicle, &scenario, &images, twin, None, wish)?,
            None => return Ok(()),
        },
    };
    finished.warn();
    let run = finished.run();
    let summary = finished.judged(&vehicle);
    if let Some(folder) = folder {
        let (files, path) = finished.write(&summary, folder)?;
        eprintln!("Wrote {} to {}.", files.join(", "), path.display());
    }
    if options.json {
        println!("{}", summary.json().trim_end());
    } else {
        print!("{}", report::terminal(&summary, Some(finished.wall)));
    }
    let faulty = finished.locked_up();
    if !faulty.is_empty() {
        let nodes = faulty.into_iter().map(String::from).collect();
        return Err(Error::Fault { nodes }.into());
    }
    unexpected(&summary)?;
    // A scenario that says what it expects has been judged already; the notes have the motor.
    let unjudged = scenario.expect.is_empty();
    match idle_motor(&vehicle, &run, &summary).filter(|_| unjudged) {
        None => Ok(()),
        Some(node) => Err(Error::IdleMotor { node: node.into() }.into()),
    }
}

/// The pace of the run, and the way of other programs to its bus; `None` if it runs as fast as it can.
fn live(vehicle: &Vehicle, options: &Sim) -> Result<Option<Live>, live::Error> {
    let watched = options.watch.is_some();
    let wanted = options.can.is_some() || options.real_time.is_some() || watched;
    let open = || {
        let speed = match options.watch {
            Some(Speed(speed)) => speed,
            None => Some(options.real_time.unwrap_or(1.0)),
        };
        let can = options.can.as_ref();
        Live::open(can, speed, watched, vehicle.network().bit_rate)
    };
    wanted.then(open).transpose()
}

/// Fails with the first expectation that the run does not show.
fn unexpected(summary: &Summary) -> Result<(), Error> {
    let all = summary.expectations.iter();
    let failed: Vec<_> = all
        .filter(|one| one.judgement == Judgement::Failed)
        .collect();
    failed.first().map_or(Ok(()), |first| {
        Err(Error::Unexpected {
            failed: failed.len(),
            of: summary.expectations.len(),
            first: first.to_string(),
        })
    })
}

/// Checks that the rules of random faults or attacks fit a vehicle.
///
/// # Errors
/// They do not.
pub(crate) fn check_campaign(vehicle: &Vehicle, attacker: bool) -> Result<(), Error> {
    if attacker {
        attackable(vehicle)?;
    }
    if vehicle.is_event_triggered() {
        return Err(Error::NoRules);
    }
    Ok(())
}

/// Checks that the nodes of a vehicle can have a key, and that it is known what moves its motors.
fn attackable(vehicle: &Vehicle) -> Result<(), Error> {
    if vehicle.is_event_triggered() {
        return Err(Error::NoKey);
    }
    match campaign::attack::command(vehicle) {
        Some(_) => Ok(()),
        None => Err(Error::NoCommand {
            vehicle: vehicle.name().to_owned(),
        }),
    }
}

/// Checks that the operator lets a rover go.
fn switched_on(vehicle: &Vehicle, scenario: &Scenario) -> Result<(), Error> {
    let mut presses = scenario.press.iter();
    if vehicle.manifest().rover.is_none() || presses.any(|press| press.button == Button::Run) {
        return Ok(());
    }
    Err(Error::NeverOn {
        scenario: scenario.name.clone(),
    })
}

/// What a run that ends at `end` leaves out of its scenario, in a line.
fn cut_off(scenario: &Scenario, end: SimDuration) -> Option<String> {
    let left_out: Vec<String> = scenario
        .beginnings()
        .into_iter()
        .filter(|(_, at)| at.span() >= end)
        .map(|(table, at)| format!("{table} at {at}"))
        .collect();
    (!left_out.is_empty()).then(|| {
        format!(
            "note: the run ends before {} of the scenario",
            left_out.join(", ")
        )
    })
}

/// An autonomous run of at least this length must turn every motor, s.
const LONG_ENOUGH: f64 = 3.0;

/// A node whose motor never turned although the vehicle drove by itself.
fn idle_motor<'v>(vehicle: &'v Vehicle, run: &Run, summary: &Summary) -> Option<&'v str> {
    let mut runs = summary.autonomous_runs.iter();
    let drove = runs.any(|run| run.until_seconds - run.from_seconds >= LONG_ENOUGH);
    never_turned(vehicle, run.efforts).filter(|_| drove)
}

/// A node whose motor can be commanded and never turned.
fn never_turned<'v>(vehicle: &'v Vehicle, efforts: &[EffortChange]) -> Option<&'v str> {
    let command = vehicle.manifest().command.as_ref()?;
    let turned = |node| {
        let mut changes = efforts.iter();
        changes.any(|change| change.node == node && change.effort != 0.0)
    };
    let motors = command.enable.keys();
    let mut nodes = motors.filter_map(|&motor| vehicle.node_of(motor));
    let idle = nodes.find(|&node| !turned(node))?;
    Some(&vehicle.node(idle).name)
}

/// The scenario that is run when none is named.
const USUAL: &str = "straight-line";

/// The usual scenario if the vehicle has it, or else its first one.
fn first_scenario(vehicle: &Vehicle) -> Result<String, Error> {
    let listed = Scenario::list(vehicle);
    let usual = listed.iter().find(|listed| listed.name == USUAL);
    let first = usual.or(listed.first());
    first
        .map(|listed| listed.name.clone())
        .ok_or_else(|| Error::NoScenario {
            vehicle: vehicle.name().into(),
        })
}

/// Reads the [`first_scenario`] of a vehicle.
///
/// # Errors
///
/// The vehicle has none, or its file is wrong.
pub(crate) fn usual_scenario(vehicle: &Vehicle) -> Result<Scenario, Error> {
    let name = first_scenario(vehicle)?;
    Ok(Scenario::find(vehicle, &name)?)
}

/// Prints the vehicle's scenarios.
///
/// # Errors
///
/// Some of them are wrong; all are printed.
fn list(vehicle: &Vehicle, json: bool) -> Result<(), Error> {
    let listed = Scenario::list(vehicle);
    if json {
        println!("{:#}", json_list(&listed));
    } else {
        print!("{}", text_list(&listed));
    }
    let wrong = listed.iter().filter(|one| one.summary.is_err()).count();
    match wrong {
        0 => Ok(()),
        wrong => Err(Error::Listed {
            wrong,
            of: listed.len(),
        }),
    }
}

/// Scenarios, one a line.
fn text_list(listed: &[Listed]) -> String {
    let width = listed.iter().map(|l| l.name.len()).max().unwrap_or(0);
    let line = |Listed { name, summary }: &Listed| match summary {
        Ok(summary) => format!("{name:<width$}  {summary}\n"),
        Err(error) => format!("{name:<width$}  error: {error}\n"),
    };
    listed.iter().map(line).collect()
}

/// Scenarios as JSON.
fn json_list(listed: &[Listed]) -> serde_json::Value {
    let object = |Listed { name, summary }: &Listed| match summary {
        Ok(summary) => json!({ "name": name, "summary": summary }),
        Err(error) => json!({ "name": name, "error": error.to_string() }),
    };
    listed.iter().map(object).collect()
}

/// A finished simulation with everything that a report needs.
pub(crate) struct Finished<'s> {
    vehicle: &'s Vehicle,
    scenario: &'s Scenario,
    nodes: Vec<String>,
    seed: u64,
    matrix: Matrix,
    outcome: Outcome,
    log: Log,
    distances: Vec<DistancePair>,
    /// Pulses of a rover's motors, and the time from the last samples of its distances to them.
    latencies: Vec<(SimTime, SimDuration)>,
    modes: Vec<ModeChange>,
    guides: Vec<ModeChange>,
    tasks: Vec<TaskTime>,
    /// Of each node, the tasks by the names of their handlers.
    task_names: Vec<BTreeMap<String, String>>,
    recordings: Vec<NodeRecording>,
    agreement: Option<agreement::Figures>,
    mission: Option<mission::Driven>,
    wall: Duration,
}

/// The sender of a frame that no node has sent.
const FOREIGN: &str = "foreign";

/// How a scenario is run.
#[derive(Default)]
pub(crate) struct Wish {
    /// Seed of all random numbers.
    pub seed: u64,
    /// How long to simulate; `None` takes the scenario's duration.
    pub length: Option<SimDuration>,
    /// Whether to keep what the cores execute.
    pub tasks: bool,
    /// Whether to keep the characters on the lines between nodes and devices.
    pub characters: bool,
    /// Whether to show no progress, because others do.
    pub quiet: bool,
    /// The pace, and the way of other programs to the bus.
    pub live: Option<Live>,
    /// A mission, which the controller's board has in its flash.
    pub mission: Option<mission::Loaded>,
}

impl Wish {
    /// When the run ends.
    fn end(&self, scenario: &Scenario) -> SimTime {
        time::at(self.length.unwrap_or_else(|| scenario.duration.span()))
    }
}

/// Builds the images and runs a scenario.
///
/// # Errors
///
/// An image does not build or is no program for its node, or a program did what its
/// microcontroller does not allow.
pub(crate) fn simulate<'s>(
    workspace: &Workspace,
    vehicle: &'s Vehicle,
    scenario: &'s Scenario,
    wish: Wish,
) -> Result<Finished<'s>, Failure> {
    let mut images = images(workspace, vehicle)?;
    if let Some(loaded) = &wish.mission {
        images = loaded.with_images(images, vehicle);
    }
    simulate_with(&images, vehicle, scenario, wish)
}

/// Runs a scenario with images that are built.
///
/// # Errors
///
/// An image is no program for its node, or a program did what its microcontroller does not allow.
pub(crate) fn simulate_with<'s>(
    images: &Images,
    vehicle: &'s Vehicle,
    scenario: &'s Scenario,
    wish: Wish,
) -> Result<Finished<'s>, Failure> {
    let twin = Twin::new(vehicle, scenario, wish.seed, images).map_err(Error::from)?;
    let agreement = Agreement::new(images);
    finish(vehicle, scenario, images, twin, agreement, wish)
}

/// How a run goes on to its end.
struct Progress {
    end: SimTime,
    /// Whether to show no progress, because others do.
    quiet: bool,
}

impl Progress {
    /// Lets the vehicle run. Comes back with the time at which the user has ended the run, if so.
    fn run(
        &mut self,
        twin: &mut Twin,
        recorder: &mut Recorder,
        mut agreement: Option<&mut Agreement>,
        mut live: Option<&mut Live>,
    ) -> Result<Option<SimTime>, Error> {
        let mut display = Display::new();
        let quiet = self.quiet || live.as_ref().is_some_and(|live| live.is_shown());
        let span = agreement::SPAN.as_ticks();
        while twin.now() < self.end {
            let next = SimTime::from_ticks((twin.now().as_ticks() / span + 1) * span);
            recorder.run_until(twin, self.end.min(next), live.as_deref_mut())?;
            if live.as_ref().is_some_and(|live| live.is_stopped()) {
                display.end();
                return Ok(Some(twin.now()));
            }
            if let Some(late) = live.as_mut().and_then(|live| live.falls_behind()) {
                display.end();
                eprintln!(
                    "note: the simulation is {} ms behind the time, so what others send comes late",
                    late.as_millis()
                );
            }
            if let Some(agreement) = &mut agreement {
                agreement.compare(twin);
            }
            let (done, all) = (time::seconds(twin.now()), time::seconds(self.end));
            let progress = |wall: Duration| {
                let pace = done / wall.as_secs_f64().max(1e-9);
                format!("{done:5.0} of {all:.0} s simulated, {pace:.2} seconds per second")
            };
            if !quiet {
                display.show(progress);
            }
        }
        display.end();
        Ok(None)
    }
}

/// Gives the terminal back, and says how the run kept up with others and whether the user has ended it.
fn tell(mut live: Option<Live>, stopped: Option<SimTime>) {
    if let Some(live) = &mut live {
        live.hide();
    }
    if let Some(late) = live.as_ref().and_then(Live::late) {
        eprintln!(
            "note: the simulation fell up to {} ms behind the time, so what others send came that late",
            late.as_millis()
        );
    }
    if let Some(at) = stopped {
        let at = time::seconds(at);
        eprintln!("note: the run was ended by hand at {at:.1} s");
    }
}

/// Lets a vehicle run on to the end.
fn finish<'s>(
    vehicle: &'s Vehicle,
    scenario: &'s Scenario,
    images: &Images,
    mut twin: Twin,
    mut agreement: Option<Agreement>,
    wish: Wish,
) -> Result<Finished<'s>, Failure> {
    let end = wish.end(scenario);
    let Wish {
        seed,
        tasks: record_tasks,
        characters,
        quiet,
        mut live,
        mission,
        ..
    } = wish;
    if characters {
        twin.note_characters();
    }
    let matrix = Matrix::new(vehicle);
    let start = Instant::now();
    let mut recorder = Recorder::new(&mut twin, images, record_tasks);
    if let Some(live) = &mut live {
        live.announce().map_err(Error::from)?;
        live.show(Subject::new(vehicle, scenario, seed, end))
            .map_err(Error::from)?;
    }
    let mut way = Progress { end, quiet };
    let stopped = way.run(&mut twin, &mut recorder, agreement.as_mut(), live.as_mut())?;
    let outcome = twin.finish();
    tell(live, stopped);
    let wall = start.elapsed();

    let log = Log::new(&outcome.records, matrix.bit_time());
    let modes = matrix.modes(&log.frames);
    let guides = matrix.guides(&log.frames);
    let task_names = task_names(vehicle, &outcome)?;
    let tasks = tasks(&outcome, &task_names);
    let mission = mission.map(|loaded| {
        let states = outcome.world.states();
        loaded.course.driven(vehicle, states, &modes, &log.frames)
    });
    Ok(Finished {
        vehicle,
        scenario,
        nodes: vehicle::node_names(vehicle),
        seed,
        matrix,
        latencies: outcome
            .chain
            .latencies()
            .map(|one| (one.pulse, one.since_sample))
            .collect(),
        outcome,
        distances: distances::pairs(vehicle, &log.frames),
        log,
        modes,
        guides,
        tasks,
        task_names,
        recordings: recorder.finish(),
        agreement: agreement.and_then(|agreement| agreement.figures()),
        mission,
        wall,
    })
}

impl Finished<'_> {
    /// The recordings in the form that the report needs.
    pub(crate) fn run(&self) -> Run<'_> {
        let of = (&self.log, &self.modes[..]);
        let run = self
            .matrix
            .run(self.scenario, &self.nodes, self.seed, &self.outcome, of);
        Run {
            tasks: &self.tasks,
            rover: self.outcome.world.drive().map(|drive| RoverRun {
                drive,
                distances: &self.distances,
                latencies: &self.latencies,
            }),
            crop: self.outcome.world.crop().map(|crop| CropRun {
                crop,
                guides: &self.guides,
            }),
            mission: self.mission.as_ref().map(mission::Driven::run),
            ..run
        }
    }

    /// Writes all that is known of the run. Returns the names of the files and the folder.
    ///
    /// # Errors
    /// A file cannot be written.
    fn write(
        &self,
        summary: &Summary,
        mut folder: OutputFolder,
    ) -> Result<(Vec<String>, PathBuf), Error> {
        folder.replace_older(recording::files::is_of_run);
        let states = recording::files::states(self);
        let mut names = vec!["bus.log".to_owned()];
        folder.write("bus.log", self.log.candump().as_bytes())?;
        let written = report::write(&self.run(), summary, states.as_ref(), &mut folder)?;
        names.extend(written.into_iter().map(str::to_owned));
        if let (Some(driven), Some(figures)) = (&self.mission, &summary.mission) {
            let picture = driven.svg(self.outcome.world.states(), &figures.line());
            folder.write("field.svg", picture.as_bytes())?;
            names.push("field.svg".to_owned());
        }
        for (name, text) in recording::files::texts(self) {
            folder.write(&name, text.as_bytes())?;
            names.push(name);
        }
        let recorded =
            recording::mcap::mcap(self, summary, states.as_ref()).map_err(Error::Recording)?;
        folder.write("run.mcap", &recorded)?;
        let page = recording::replay::page(self, summary, states.as_ref()).map_err(Error::Page)?;
        folder.write("run.html", page.as_bytes())?;
        names.extend(["run.mcap", "run.html"].map(str::to_owned));
        Ok((names, folder.finish()?))
    }

    /// The vehicle.
    pub(crate) fn vehicle(&self) -> &Vehicle {
        self.vehicle
    }

    /// The messages and windows of its bus.
    pub(crate) fn matrix(&self) -> &Matrix {
        &self.matrix
    }

    /// What went over the bus, as a candump log.
    pub(crate) fn candump(&self) -> String {
        self.log.candump()
    }

    /// The characters on the lines of the devices, if they were kept.
    pub(crate) fn characters(&self) -> &[world::Character] {
        self.outcome.world.characters()
    }

    /// What the core of a node executed, if it was kept: begin, end, and the name of the task.
    pub(crate) fn executed(&self, node: &str) -> Vec<(SimTime, SimTime, &str)> {
        let mut nodes = self.outcome.nodes.iter().zip(&self.recordings);
        let Some((node, recording)) = nodes.find(|(one, _)| one.name == node) else {
            return Vec::new();
        };
        let handler = |exception| {
            let mut tasks = node.load.tasks.iter();
            tasks.find(|task| task.exception == exception)
        };
        let segments = recording.segments.iter();
        let named = segments.filter_map(|one| {
            let task = handler(one.exception)?;
            Some((one.from, one.until, self.task_name(node.node, &task.name)))
        });
        named.collect()
    }

    /// The name of a node.
    fn node_name(&self, node: NodeIndex) -> &str {
        self.nodes.get(node.0).map_or("", String::as_str)
    }

    /// Who sent the frame of that index.
    pub(crate) fn sender(&self, index: usize) -> &str {
        let node = self.log.senders.get(index);
        let node = node.and_then(|&node| self.outcome.line_of(node));
        let name = node.and_then(|node| self.nodes.get(node.0));
        name.map_or(FOREIGN, String::as_str)
    }

    /// The task of a node whose handler has that name; an exception that is no task keeps its own.
    fn task_name<'n>(&'n self, node: NodeIndex, handler: &'n str) -> &'n str {
        let names = self.task_names.get(node.0);
        names
            .and_then(|names| names.get(handler))
            .map_or(handler, String::as_str)
    }

    /// The figures, including those that are not in the recordings.
    pub(crate) fn summary(&self) -> Summary {
        let mut summary = Summary::of(&self.run());
        summary.set = self.vehicle.overrides().environment();
        summary.bus.global_time = self.agreement.map(|figures| {
            GlobalTimeFigures::new(figures.instants, figures.largest_us, figures.p99_us)
        });
        summary.bus.gates = self.gates();
        // Where no frame was on the bus, an error frame destroys none, and the frames alone do not show it.
        summary.bus.error_frames = self.log.errors.len() as u64;
        summary
    }

    /// What the bus guardian did, for each node whose gate it closed.
    fn gates(&self) -> Vec<GateFigures> {
        let changes = &self.outcome.gates;
        let of_node = |node: &NodeOutcome| {
            let changes = || changes.iter().filter(|change| change.node == node.node);
            let first = changes().find(|change| change.closed)?;
            let last = changes().next_back().filter(|change| !change.closed);
            Some(GateFigures {
                node: node.name.clone(),
                closings: changes().filter(|change| change.closed).count(),
                first_closed_seconds: time::seconds(first.at),
                open_again_seconds: last.map(|change| time::seconds(change.at)),
            })
        };
        self.outcome.nodes.iter().filter_map(of_node).collect()
    }

    /// The figures with the scenario's expectations, and what makes the run questionable.
    pub(crate) fn judged(&self, vehicle: &Vehicle) -> Summary {
        let run = self.run();
        let mut summary = self.summary();
        let decode = |frame: &report::FrameRecord, signal: &str| self.matrix.named(frame, signal);
        summary.expectations = report::expectations(&run, &summary, &decode);
        summary.notes = sense::notes(vehicle, &self.matrix, &run, &summary);
        summary
    }

    /// How long the simulation took.
    pub(crate) fn wall(&self) -> Duration {
        self.wall
    }

    /// The nodes whose core stopped in a fault that it could not handle.
    pub(crate) fn locked_up(&self) -> Vec<&str> {
        let nodes = self.outcome.nodes.iter();
        nodes
            .filter(|node| node.locked_up)
            .map(|node| node.name.as_str())
            .collect()
    }

    /// Warns of registers that the simulation does not model.
    fn warn(&self) {
        for node in &self.outcome.nodes {
            if !node.unmodelled.is_empty() {
                let registers: Vec<String> = node
                    .unmodelled
                    .iter()
                    .map(|address| format!("{address:#010x}"))
                    .collect();
                eprintln!(
                    "warning: {} used registers that are not modelled: {}",
                    node.name,
                    registers.join(", ")
                );
            }
        }
    }
}

/// Builds the images of all nodes and reads them.
///
/// # Errors
///
/// One of them does not build.
pub(crate) fn images(workspace: &Workspace, vehicle: &Vehicle) -> Result<Images, Failure> {
    let nodes: Vec<_> = vehicle.nodes().collect();
    build::read(&build::images(workspace, vehicle, &nodes)?)
}

/// Of each node, the tasks of its source by the names of their handlers.
fn task_names(
    vehicle: &Vehicle,
    outcome: &Outcome,
) -> Result<Vec<BTreeMap<String, String>>, Error> {
    let mut all = Vec::new();
    for node in &outcome.nodes {
        let file = vehicle.source(node.node);
        let unreadable = |error| Error::Source {
            path: file.clone(),
            error,
        };
        let source = fs::read_to_string(&file).map_err(|error| unreadable(error.into()))?;
        all.push(tasks::names(&source).map_err(|error| unreadable(error.into()))?);
    }
    Ok(all)
}

/// The tasks with their names. An exception that is no task keeps its own name.
fn tasks(outcome: &Outcome, names: &[BTreeMap<String, String>]) -> Vec<TaskTime> {
    let mut times = Vec::new();
    for (node, names) in outcome.nodes.iter().zip(names) {
        for task in &node.load.tasks {
            times.push(TaskTime {
                node: node.name.clone(),
                task: names.get(&task.name).unwrap_or(&task.name).clone(),
                runs: task.activations,
                longest_cycles: task.longest,
                core_hz: node.core_hz,
            });
        }
    }
    times
}

#[cfg(test)]
mod tests {
    use super::*;
    use vehicle_model::Override;
    use world::time::from_seconds;

    #[test]
    fn an_attacker_needs_a_key_and_a_command() {
        let workspace = Workspace::find().unwrap();
        for name in ["uagv", "row-follower"] {
            let vehicle = vehicle::find(&workspace, name).unwrap();
            assert!(attackable(&vehicle).is_ok(), "{name}");
        }
        let bench = vehicle::find(&workspace, "two-boards").unwrap();
        let protocol = Override::parse("bus.protocol=event-triggered").into_iter();
        let events = vehicle::with(&workspace, "two-boards", &protocol.collect()).unwrap();
        for (vehicle, what) in [(bench, "[command]"), (events, "event-triggered")] {
            let error = attackable(&vehicle).unwrap_err();
            assert!(error.is_usage());
            assert!(error.to_string().contains(what), "{error}");
        }
    }

    #[test]
    fn a_robot_that_nobody_lets_go_is_refused() {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, "row-follower").unwrap();
        let read = |press: &str| {
            let text = format!("[[row.section]]\nkind = \"poles\"\nlength = \"5 m\"\n{press}");
            Scenario::parse(&vehicle, "row", "row.toml", &text).unwrap()
        };
        let stop = read("[[press]]\nat = \"1 s\"\nbutton = \"stop\"\n");
        for scenario in [read(""), stop] {
            let error = switched_on(&vehicle, &scenario).unwrap_err();
            assert!(error.is_usage());
            assert!(
                error.to_string().contains("nobody lets the robot go"),
                "{error}"
            );
        }
        let run = read("[[press]]\nat = \"1 s\"\nbutton = \"run\"\n");
        assert!(switched_on(&vehicle, &run).is_ok());
        // Other vehicles may stand.
        let uagv = vehicle::find(&workspace, vehicle::DEFAULT).unwrap();
        let still = Scenario::uneventful(&uagv, "still");
        assert!(switched_on(&uagv, &still).is_ok());
        assert_eq!(cut_off(&run, from_seconds(2.0)), None);
        let note = cut_off(&run, from_seconds(0.5)).unwrap();
        assert_eq!(
            note,
            "note: the run ends before press[0] at 1 s of the scenario"
        );
    }

    #[test]
    fn a_motor_that_never_turned_is_named() {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, vehicle::DEFAULT).unwrap();
        let effort = |name: &str, effort| EffortChange {
            at: SimTime::from_ticks(1),
            node: vehicle.find_node(name).unwrap(),
            byte: 127,
            effort,
        };
        let idle = |efforts: &[EffortChange]| never_turned(&vehicle, efforts).map(str::to_owned);
        let drive = effort("drive", 0.5);
        assert_eq!(
            idle(&[drive, effort("steering", 0.0)]).as_deref(),
            Some("steering")
        );
        assert_eq!(idle(&[drive, effort("steering", -0.2)]), None);
    }

    #[test]
    fn a_wrong_scenario_does_not_hide_the_others() {
        let workspace = Workspace::find().unwrap();
        let own = vehicle::find(&workspace, vehicle::DEFAULT).unwrap();
        let read = |file| fs::read_to_string(file).unwrap();
        let (manifest, network) = (read(own.manifest_file()), read(own.network_file()));
        let folder = tempfile::tempdir().unwrap();
        let vehicle = Vehicle::parse("copy", folder.path(), &manifest, &network).unwrap();
        let scenarios = folder.path().join("scenarios");
        fs::create_dir(&scenarios).unwrap();
        fs::write(scenarios.join("broken.toml"), "summary = 1 m\n").unwrap();
        fs::write(scenarios.join("sound.toml"), "summary = \"it drives\"\n").unwrap();

        let listed = Scenario::list(&vehicle);
        let text = text_list(&listed);
        assert!(
            text.starts_with("broken  error: scenario broken, line 1"),
            "{text}"
        );
        assert!(text.ends_with("\nsound   it drives\n"), "{text}");
        let json = json_list(&listed);
        assert_eq!(json[1], json!({ "name": "sound", "summary": "it drives" }));
        assert!(json[0]["error"].is_string());
        let error = list(&vehicle, false).unwrap_err();
        assert!(error.is_usage());
        assert!(error.to_string().starts_with("1 of 2 scenarios"), "{error}");
    }

    #[test]
    fn every_vehicle_has_a_scenario_to_begin_with() {
        let workspace = Workspace::find().unwrap();
        for name in Vehicle::names(&workspace.vehicles()).unwrap() {
            let vehicle = vehicle::find(&workspace, &name).unwrap();
            let scenario = first_scenario(&vehicle).unwrap();
            let listed = text_list(&Scenario::list(&vehicle));
            assert!(listed.contains(&scenario), "{name}");
            assert!(list(&vehicle, true).is_ok());
            Scenario::find(&vehicle, &scenario).unwrap();
        }
    }
}
