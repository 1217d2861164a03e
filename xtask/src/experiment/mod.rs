//! `sim --experiment`: scenarios over many seeds, under Furrow's law and under
//! the thesis's, judged by aims.

pub mod aggregate;
pub mod case;
mod event_or_time;
pub mod field;
mod kept;
pub mod measure;
pub mod quick;
mod report;
pub mod row_limits;
mod thesis_2;

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    num::NonZero,
    path::PathBuf,
    sync::{
        Arc, Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Duration,
};

use control::{
    controller::SettingsError, dubins::DubinsError, line::LineError, row::RowSettingsError,
    vehicle::Refusal,
};
use serde::{Serialize, de::DeserializeOwned};
use twin::{Images, Options, TwinError};
use vehicle_model::{Overrides, Vehicle, manifest::Law};
use world::{Scenario, ScenarioError, report::FolderError};

use crate::{
    Failure, Workspace,
    cli::Sim,
    network::matrix::Matrix,
    progress::Display,
    sim::{self, bus::Log, choice},
    vehicle,
};
use case::Experiment;
use kept::{Kept, Place};
use measure::{Figures, SteeringRate};
use quick::Numbers;
use report::{CaseReport, Report};

/// Why an experiment fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no experiment of that name.
    #[error("there is no experiment {name:?}: {} are accepted", known())]
    Unknown {
        /// The name.
        name: String,
    },
    /// The vehicle lacks something that it needs to drive by itself, or that an experiment
    /// reads.
    #[error(
        "the manifest of vehicle {vehicle:?} has no {what}, which this experiment needs; --vehicle \
         names another vehicle"
    )]
    Lacks {
        /// The vehicle.
        vehicle: String,
        /// Table, field or device of the manifest.
        what: &'static str,
    },
    /// The experiment drives under Furrow's law, and the vehicle has the thesis's.
    #[error(
        "rover.law of vehicle {vehicle:?} is \"thesis\", and row-limits shows the limits of \"furrow\": use --set \
         rover.law=furrow, or compare both laws by --experiment thesis-2"
    )]
    ThesisLaw {
        /// The vehicle.
        vehicle: String,
    },
    /// No law can be made of a rover's numbers.
    #[error("the rover: {0}")]
    Rover(#[from] RowSettingsError),
    /// A case's scenario is wrong.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The output folder is wrong.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// An experiment was interrupted, and another one is not to take its place by mistake.
    #[error(
        "{} has what an unfinished experiment has done: --resume goes on with it, or delete the file to begin again",
        journal.display()
    )]
    Unfinished {
        /// The file.
        journal: PathBuf,
    },
    /// The file of the runs that are done cannot be used.
    #[error("{} cannot be used: {why}", journal.display())]
    Journal {
        /// The file.
        journal: PathBuf,
        /// Why.
        #[source]
        why: campaign::JournalError,
    },
    /// What is to go on has a report, but not the runs that it is made of.
    #[error(
        "{} is the report of an experiment whose runs were not kept, as with --quick: name another folder, or leave out \
         --resume to replace it",
        report.display()
    )]
    NoRuns {
        /// The file.
        report: PathBuf,
    },
    /// The waypoints make no line.
    #[error(transparent)]
    Line(#[from] LineError),
    /// No control law can be designed for the machine.
    #[error(transparent)]
    Design(#[from] Refusal),
    /// A setting of the law is unusable.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The vehicle cannot drive.
    #[error("{scenario}: the vehicle has no machine")]
    NoMachine {
        /// The scenario.
        scenario: String,
    },
    /// No path leads onto the line.
    #[error("{scenario}: {error}")]
    NoPath {
        /// The scenario.
        scenario: String,
        /// Why there is none.
        #[source]
        error: DubinsError,
    },
    /// A run failed.
    #[error("{scenario}, seed {seed}, {law}: {why}")]
    Run {
        /// The scenario.
        scenario: String,
        /// The seed.
        seed: u64,
        /// The law.
        law: &'static str,
        /// Why it failed.
        #[source]
        why: RunError,
    },
    /// Aims are missed.
    #[error("aims missed: {}", .0.join(", "))]
    Missed(Vec<String>),
}

impl Error {
    /// The vehicle's manifest has no such thing.
    fn lacks(vehicle: &Vehicle, what: &'static str) -> Self {
        Self::Lacks {
            vehicle: vehicle.name().into(),
            what,
        }
    }

    /// Whether the command line or an input file is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::Unknown { .. }
                | Self::Lacks { .. }
                | Self::ThesisLaw { .. }
                | Self::Scenario(_)
                | Self::Folder(_)
                | Self::Unfinished { .. }
                | Self::Journal { .. }
                | Self::NoRuns { .. }
        )
    }
}

/// Why a run fails.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The virtual vehicle cannot be built.
    #[error(transparent)]
    Twin(#[from] TwinError),
    /// A program ended in a fault that it could not handle.
    #[error("the program of {node} ended in a fault")]
    Fault {
        /// Its node.
        node: String,
    },
    /// There is nothing to judge.
    #[error("the vehicle never drove by itself")]
    NeverDrove,
}

/// How an experiment is run.
type Runner = fn(&Workspace, &Sim) -> Result<(), Failure>;

/// The experiments that have a runner of their own.
const OTHERS: [(&str, Runner); 3] = [
    (event_or_time::NAME, event_or_time::run),
    (thesis_2::NAME, thesis_2::run),
    (field::NAME, field::run),
];

/// The names of the experiments.
fn known() -> String {
    let tracks = case::ALL.iter().map(|experiment| experiment.name);
    let names = tracks.chain(OTHERS.map(|(name, _)| name));
    let names: Vec<&str> = names.chain([row_limits::NAME]).collect();
    names.join(", ")
}

/// Something that an experiment needs from a vehicle's manifest, when it is there.
fn needed<T>(vehicle: &Vehicle, what: &'static str, found: Option<T>) -> Result<T, Error> {
    found.ok_or_else(|| Error::lacks(vehicle, what))
}

/// Runs the experiment of that name.
///
/// # Errors
///
/// There is no such vehicle or experiment, or the output folder is wrong (exit code 2); an
/// image does not build or run, or an aim is missed.
pub fn run(workspace: &Workspace, name: &str, options: &Sim) -> Result<(), Failure> {
    if let Some((_, run)) = OTHERS.iter().find(|(other, _)| *other == name) {
        return run(workspace, options);
    }
    let own = options.changes.overrides();
    let vehicle = &vehicle::with(workspace, &options.vehicle, &own)?;
    if name == row_limits::NAME {
        return row_limits::run(vehicle, options);
    }
    let experiment = Experiment::find(name)?;
    if own
        .shared_key(&Overrides::parse(LAW_KEY).map_err(Failure::Usage)?)
        .is_some()
    {
        return Err(Failure::Usage(format!(
            "{name} drives under both laws: machine.law is not accepted in --set"
        )));
    }
    let place = Place::of(options)?;
    let ready = ready(workspace, vehicle, experiment, options.quick)?;
    let jobs = jobs(&ready, options);
    let kept = match &place {
        Some(place) => {
            let laws = || ready.iter().flatten();
            let scenarios: Vec<_> = laws().map(|of| &of.scenario).collect();
            let images = laws().filter_map(|of| Some((&of.vehicle, of.images.as_deref()?)));
            place.kept(
                experiment.name,
                options,
                &scenarios,
                &images.collect::<Vec<_>>(),
            )?
        }
        None => None,
    };
    let figures = run_all(&jobs, &Job::name, kept, &Job::run)?;

    let of = |case: usize, law: usize| -> Vec<Figures> {
        let both = jobs.iter().zip(&figures);
        both.filter(|(job, _)| job.case == case && job.law == law)
            .map(|(_, figures)| figures.clone())
            .collect()
    };
    let cases = experiment.cases.iter().zip(&ready).enumerate();
    let cases = cases
        .map(|(number, (case, [ready, _]))| {
            let scenario = &ready.scenario;
            let shortest = case::shortest_seconds(&ready.vehicle, scenario)?;
            let (furrow, plain) = (of(number, 0), of(number, 1));
            Ok(CaseReport::new(
                case,
                &scenario.summary,
                shortest,
                &furrow,
                &plain,
            ))
        })
        .collect::<Result<Vec<_>, Error>>()?;
    let report = Report {
        experiment: experiment.name,
        first_seed: options.seed,
        seeds: options.seeds,
        cases,
    };

    if let Some(place) = place {
        let runs = runs_csv(&jobs, &figures);
        place.finish(&[("experiment.json", &report.json()), ("runs.csv", &runs)])?;
    }
    if options.json {
        print!("{}", report.json());
    } else {
        print!("{}", report.text());
    }
    match report.missed().as_slice() {
        [] => Ok(()),
        missed => Err(Error::Missed(missed.to_vec()).into()),
    }
}

/// The key that the experiments set themselves.
const LAW_KEY: &str = "machine.law=furrow";

/// A case under one law, ready to run.
struct Ready {
    law: Law,
    vehicle: Vehicle,
    scenario: Scenario,
    numbers: Numbers,
    /// `None` in quick mode.
    images: Option<Arc<Images>>,
}

impl Ready {
    /// The case without its images.
    fn new(
        workspace: &Workspace,
        vehicle: &Vehicle,
        law: Law,
        scenario: &str,
    ) -> Result<Self, Failure> {
        let (vehicle, scenario) = choice::under(workspace, vehicle, law, scenario)?;
        Ok(Self {
            law,
            numbers: Numbers::of(&vehicle)?,
            vehicle,
            scenario,
            images: None,
        })
    }
}

/// Every case of an experiment under each of [`Law::ALL`].
fn ready(
    workspace: &Workspace,
    vehicle: &Vehicle,
    experiment: &Experiment,
    quick: bool,
) -> Result<Vec<[Ready; 2]>, Failure> {
    let mut all = Vec::new();
    for case in experiment.cases {
        let path = case.path(experiment.name);
        let of = |law| Ready::new(workspace, vehicle, law, &path);
        all.push([of(Law::ALL[0])?, of(Law::ALL[1])?]);
    }
    if !quick {
        let mut built = BuiltImages::for_all(all.iter().flatten().map(|of| &of.vehicle));
        for of in all.iter_mut().flatten() {
            of.images = Some(built.of(workspace, &of.vehicle)?);
        }
    }
    Ok(all)
}

/// The images of several vehicles, those with the same values built once.
pub(crate) struct BuiltImages {
    sets: Vec<(String, Overrides, Arc<Images>)>,
    /// How many sets there will be.
    all: usize,
}

impl BuiltImages {
    /// Those of these vehicles, none of which is built yet.
    pub(crate) fn for_all<'v>(vehicles: impl Iterator<Item = &'v Vehicle>) -> Self {
        let mut different: Vec<(&str, &Overrides)> = Vec::new();
        for vehicle in vehicles {
            let one = (vehicle.name(), vehicle.overrides());
            if !different.contains(&one) {
                different.push(one);
            }
        }
        Self {
            sets: Vec::new(),
            all: different.len(),
        }
    }

    /// The images of this vehicle.
    ///
    /// # Errors
    ///
    /// One does not build.
    pub(crate) fn of(
        &mut self,
        workspace: &Workspace,
        vehicle: &Vehicle,
    ) -> Result<Arc<Images>, Failure> {
        let (name, set) = (vehicle.name(), vehicle.overrides());
        let mut built = self.sets.iter();
        if let Some((.., images)) = built.find(|(of, with, _)| of == name && with == set) {
            return Ok(Arc::clone(images));
        }
        if self.all > 1 {
            eprintln!(
                "Building image set {} of {}.",
                self.sets.len() + 1,
                self.all
            );
        }
        let images = Arc::new(sim::images(workspace, vehicle)?);
        let own = Arc::clone(&images);
        self.sets.push((name.to_owned(), set.clone(), own));
        Ok(images)
    }
}

/// Every case with every seed and both laws.
fn jobs<'a>(ready: &'a [[Ready; 2]], options: &Sim) -> Vec<Job<'a>> {
    let seeds = (0..options.seeds).map(|k| options.seed.wrapping_add(k));
    let jobs = seeds.flat_map(|seed| {
        let cases = ready.iter().enumerate();
        cases.flat_map(move |(case, laws)| {
            let laws = laws.iter().enumerate();
            laws.map(move |(law, of)| Job {
                case,
                law,
                of,
                seed,
            })
        })
    });
    jobs.collect()
}

/// Names of the laws in files.
const LAWS: [&str; 2] = ["furrow", "plain"];

/// A run that is to be done.
struct Job<'a> {
    case: usize,
    /// Index into [`LAWS`].
    law: usize,
    of: &'a Ready,
    seed: u64,
}

impl Job<'_> {
    fn name(&self) -> String {
        format!("{} with seed {}", self.of.scenario.name, self.seed)
    }

    fn failed(&self, why: RunError) -> Error {
        Error::Run {
            scenario: self.of.scenario.name.clone(),
            seed: self.seed,
            law: LAWS[self.law],
            why,
        }
    }

    fn run(&self) -> Result<Figures, Error> {
        match &self.of.images {
            Some(images) => self.drive(images),
            None => self.drive_quickly(),
        }
    }

    /// The run with the law alone, without images and bus.
    fn drive_quickly(&self) -> Result<Figures, Error> {
        let Ready {
            law,
            vehicle,
            scenario,
            numbers,
            ..
        } = self.of;
        let mut law = numbers.law(*law)?;
        quick::drive(
            vehicle,
            numbers,
            scenario,
            self.seed,
            &mut *law,
            |_, _, _| (),
        )
        .figures()
        .ok_or_else(|| self.failed(RunError::NeverDrove))
    }

    fn drive(&self, images: &Images) -> Result<Figures, Error> {
        let Ready {
            vehicle, scenario, ..
        } = self.of;
        let rate = SteeringRate::of(vehicle)?;
        let matrix = Matrix::new(vehicle);
        let options = Options {
            seed: self.seed,
            ..Options::default()
        };
        let outcome = twin::run(vehicle, scenario, images, &options, |_| {})
            .map_err(|error| self.failed(error.into()))?;
        if let Some(node) = outcome.nodes.iter().find(|node| node.locked_up) {
            return Err(self.failed(RunError::Fault {
                node: node.name.clone(),
            }));
        }
        let log = Log::new(&outcome.records, matrix.bit_time());
        let modes = matrix.modes(&log.frames);
        let nodes = vehicle::node_names(vehicle);
        let run = matrix.run(scenario, &nodes, self.seed, &outcome, (&log, &modes));
        Figures::of(&run, rate.of_frames(&log.frames))
            .ok_or_else(|| self.failed(RunError::NeverDrove))
    }
}

/// Does all runs, as many at a time as there are processors, and shows how far they are: `name` says
/// which one is done. The result of a run depends on its job alone, not on the thread or the order. Runs that
/// are `kept` from before are not done again, and the others are kept as they end.
fn run_all<J: Sync, T: Send + Serialize + DeserializeOwned + PartialEq>(
    jobs: &[J],
    name: &(dyn Fn(&J) -> String + Sync),
    mut kept: Option<Kept<T>>,
    make: &(dyn Fn(&J) -> Result<T, Error> + Sync),
) -> Result<Vec<T>, Error> {
    let earlier = kept.as_mut().map(|kept| std::mem::take(&mut kept.earlier));
    let mut keep = |number, result: &T| match &mut kept {
        Some(kept) => kept.add(number, result),
        None => Ok(()),
    };
    run_each(jobs, name, earlier.unwrap_or_default(), &mut keep, make)
}

/// The same for results that cannot be kept in a file: those of `earlier` runs are known by their numbers,
/// and `keep` is told each of the others.
pub(crate) fn run_each<'j, J: Sync, T: Send, E: Send>(
    jobs: &'j [J],
    name: &(dyn Fn(&J) -> String + Sync),
    mut earlier: BTreeMap<usize, T>,
    keep: &mut (dyn FnMut(usize, &T) -> Result<(), E> + Send),
    make: &(dyn Fn(&'j J) -> Result<T, E> + Sync),
) -> Result<Vec<T>, E> {
    earlier.retain(|number, _| *number < jobs.len());
    let numbers = 0..jobs.len();
    let left: Vec<usize> = numbers.filter(|run| !earlier.contains_key(run)).collect();
    let next = AtomicUsize::new(0);
    let results = earlier.into_iter().map(|(run, result)| (run, Ok(result)));
    let done = Mutex::new((results.collect::<Vec<_>>(), Display::new(), keep));
    let work = || {
        while let Some((number, job)) = {
            let number = left.get(next.fetch_add(1, Ordering::Relaxed));
            number.and_then(|&number| Some((number, jobs.get(number)?)))
        } {
            let mut figures = make(job);
            let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
            let (done, display, keep) = &mut *done;
            if let Ok(result) = &figures
                && let Err(error) = keep(number, result)
            {
                figures = Err(error);
            }
            let failed = figures.is_err();
            done.push((number, figures));
            let (own, before) = (
                done.len() + left.len() - jobs.len(),
                jobs.len() - left.len(),
            );
            display.show(|wall| progress(&name(job), (before, own), jobs.len(), wall));
            if failed {
                // After a failure, the remaining runs are of no use.
                next.store(left.len(), Ordering::Relaxed);
            }
        }
    };
    if !left.is_empty() {
        // The first run may take minutes.
        eprintln!("{} of {} runs done.", jobs.len() - left.len(), jobs.len());
    }
    let workers = thread::available_parallelism().map_or(1, NonZero::get);
    thread::scope(|scope| {
        for _ in 0..workers.min(left.len()) {
            scope.spawn(work);
        }
    });
    let (mut done, mut display, _) = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    display.end();
    done.sort_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, figures)| figures).collect()
}

/// How far the runs are after `wall`; `last` is the one that was done last. Those that were done before took no
/// time.
fn progress(last: &str, (before, own): (usize, usize), all: usize, wall: Duration) -> String {
    let done = before + own;
    let left = wall.as_secs_f64() / own as f64 * (all - done) as f64 / 60.0;
    format!("{done} of {all} runs, {last} last, {left:.0} min left")
}

/// One line for each run.
fn runs_csv(jobs: &[Job], figures: &[Figures]) -> String {
    let mut text = String::from(
        "case,law,seed,settling_s,mean_cm,deviation_cm,overshoot_cm,swings,sign_changes_per_s,complete\n",
    );
    for (job, figures) in jobs.iter().zip(figures) {
        let one = aggregate::Aggregate::of(std::slice::from_ref(figures));
        let settling = figures.settling.map(|time| format!("{time:.2}"));
        let _ = writeln!(
            text,
            "{},{},{},{},{:.3},{:.3},{:.3},{},{:.3},{}",
            job.of.scenario.name,
            LAWS[job.law],
            job.seed,
            settling.unwrap_or_default(),
            one.mean_cm,
            one.deviation_cm,
            figures.overshoot,
            figures.swings,
            one.sign_changes_per_second,
            figures.complete
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use std::{ffi::OsString, fs};

    use super::*;
    use crate::cli;

    fn uagv() -> Vehicle {
        vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap()
    }

    /// The vehicle with other names for all that an experiment looks for, and with each
    /// `(from, to)` replaced in its network file.
    pub(super) fn renamed(changes: &[(&str, &str)]) -> Vehicle {
        let uagv = uagv();
        let read = |name| fs::read_to_string(uagv.folder().join(name)).unwrap();
        let words = [
            ("controller", "helm"),
            ("SteeringRate", "RateToTurn"),
            ("\"Command\"", "\"Order\""),
            ("\"Command.", "\"Order."),
            (" Command:", " Order:"),
            (" 300 ", " 310 "),
            ("SteeringPot.Count", "Angle.Count"),
            (" SteeringPot:", " Angle:"),
            ("Velocity SteeringPot\"", "Velocity Angle\""),
        ];
        let rename = |text: String| {
            let renamed = words.iter();
            renamed.fold(text, |text, (from, to)| text.replace(from, to))
        };
        let manifest = rename(read("vehicle.toml"));
        let mut network = rename(read("network.dbc"));
        for (from, to) in changes {
            assert!(network.contains(from), "{from}");
            network = network.replacen(from, to, 1);
        }
        Vehicle::parse("copy", uagv.folder(), &manifest, &network).unwrap()
    }

    /// Figures of a few runs of each case, without bus and images.
    fn quick(vehicle: &Vehicle, seeds: u64) -> Vec<(&'static case::Case, CaseReport)> {
        let numbers = Numbers::of(vehicle).unwrap();
        let experiment = Experiment::find("thesis-7").unwrap();
        let report = |case: &'static case::Case| {
            let scenario = Scenario::find(vehicle, &case.path(experiment.name)).unwrap();
            let runs = |law| -> Vec<Figures> {
                let drive = |seed| {
                    let mut law = numbers.law(law).unwrap();
                    quick::drive(vehicle, &numbers, &scenario, seed, &mut *law, |_, _, _| ())
                };
                (1..=seeds)
                    .map(|seed| drive(seed).figures().unwrap())
                    .collect()
            };
            let shortest = case::shortest_seconds(vehicle, &scenario).unwrap();
            let (furrow, plain) = (runs(Law::Furrow), runs(Law::Thesis));
            let report = CaseReport::new(case, &scenario.summary, shortest, &furrow, &plain);
            (case, report)
        };
        experiment.cases.iter().map(report).collect()
    }

    #[test]
    fn a_vehicle_that_an_experiment_cannot_drive_is_refused() {
        let workspace = Workspace::find().unwrap();
        let bench = vehicle::find(&workspace, "two-boards").unwrap();
        let error = Numbers::of(&bench).unwrap_err();
        assert!(error.is_usage());
        assert!(error.to_string().contains("has no [machine]"), "{error}");

        let uagv = uagv();
        let read = |name| fs::read_to_string(uagv.folder().join(name)).unwrap();
        let (manifest, network) = (read("vehicle.toml"), read("network.dbc"));
        let (before, calibration) = manifest.split_once("[calibration]").unwrap();
        let (_, after) = calibration.split_once("[operator]").unwrap();
        let manifest = format!("{before}[operator]{after}");
        let copy = Vehicle::parse("copy", uagv.folder(), &manifest, &network).unwrap();
        let error = Numbers::of(&copy).unwrap_err();
        assert_eq!(
            error.to_string(),
            "the manifest of vehicle \"copy\" has no calibration.steering_rate, which this experiment \
             needs; --vehicle names another vehicle"
        );

        // The bus of a machine is no reason: nobody asked for another one.
        for name in ["thesis-2", "event-or-time", "row-limits"] {
            let words = ["xtask", "sim", "--experiment", name].map(OsString::from);
            let Ok(cli::Request::Run(cli::Command::Sim(options))) = cli::parse(words) else {
                panic!("not read");
            };
            let failure = run(&workspace, name, &options).unwrap_err();
            assert_eq!(failure.exit_code(), 2);
            assert!(failure.to_string().contains("has no [rover]"), "{failure}");
        }
    }

    /// Without bus and images, a few seeds: the law and its settings meet the aims by themselves.
    #[test]
    fn the_law_meets_every_aim() {
        for (_, report) in quick(&uagv(), 3) {
            assert!(report.aims.iter().all(|aim| aim.met), "{report:?}");
            assert!(report.furrow.overshoot_worst_cm < 3.5, "{report:?}");
            assert!(
                report.furrow.deviation_cm < report.plain.deviation_cm,
                "{report:?}"
            );
        }
    }

    /// Without bus and images, a few seeds: on the machine that is fitted to the thesis's, its law has the
    /// thesis's figures, and Furrow's law meets the aims.
    #[test]
    fn the_fitted_machine_has_the_figures_of_the_thesis() {
        let workspace = Workspace::find().unwrap();
        let experiment = Experiment::find("thesis-machine").unwrap();
        let ready = ready(&workspace, &uagv(), experiment, true).unwrap();
        for (case, laws) in experiment.cases.iter().zip(&ready) {
            let runs = |law: usize| -> Vec<Figures> {
                let of = &laws[law];
                let job = |seed| Job {
                    case: 0,
                    law,
                    of,
                    seed,
                };
                (1..=3).map(|seed| job(seed).run().unwrap()).collect()
            };
            let (furrow, plain) = (runs(0), runs(1));
            let report = CaseReport::new(case, "", 10.0, &furrow, &plain);
            let fit = report.aims.iter().filter(|aim| aim.plain).count();
            assert_eq!(fit, 1 + usize::from(case.thesis_settling_seconds.is_some()));
            assert!(report.aims.iter().all(|aim| aim.met), "{report:?}");
        }
    }

    /// No name and no identifier of the first vehicle is needed.
    #[test]
    fn names_and_identifiers_change_no_figure() {
        let both = quick(&uagv(), 1).into_iter().zip(quick(&renamed(&[]), 1));
        for ((case, one), (_, other)) in both {
            assert_eq!(one.furrow, other.furrow, "{}", case.name);
            assert_eq!(one.plain, other.plain, "{}", case.name);
        }
    }
}
