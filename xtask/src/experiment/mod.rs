//! `sim --experiment`: scenarios over many seeds, under Furrow's law and under
//! the thesis's, judged by aims.

pub mod aggregate;
pub mod case;
pub mod measure;
pub mod quick;
mod report;

use std::{
    fmt::Write as _,
    fs,
    num::NonZero,
    sync::{
        Mutex, PoisonError,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
    time::Duration,
};

use control::{controller::SettingsError, dubins::DubinsError, line::LineError};
use twin::{Images, Options, TwinError};
use vehicle_model::{NodeIndex, Vehicle};
use world::{
    Scenario, ScenarioError, SimDuration,
    report::{FolderError, OutputFolder, Run},
};

use crate::{
    Failure, ReadError, Workspace, build,
    cli::Sim,
    progress::Display,
    sim::{self, bus::Log, matrix::Matrix},
    target,
    vehicle::{self, DEFAULT},
};
use case::Experiment;
use measure::Figures;
use report::{CaseReport, Report};

/// Why an experiment fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// There is no experiment of that name.
    #[error("there is no experiment {name:?}: {} is accepted", known())]
    Unknown {
        /// The name.
        name: String,
    },
    /// The vehicle has nothing that an experiment could drive.
    #[error("vehicle {vehicle:?} has no [machine]: an experiment needs a vehicle that drives")]
    Stands {
        /// The vehicle.
        vehicle: String,
    },
    /// The law without images exists for one vehicle only.
    #[error(
        "--quick drives with the control law of {DEFAULT}, and the vehicle is {vehicle:?}: leave --quick out"
    )]
    Quick {
        /// The vehicle.
        vehicle: String,
    },
    /// A case's scenario is wrong.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The output folder is wrong.
    #[error(transparent)]
    Folder(#[from] FolderError),
    /// The build left no image with the thesis's law.
    #[error("cargo built no image")]
    NoImage,
    /// The waypoints make no line.
    #[error(transparent)]
    Line(#[from] LineError),
    /// A setting of the law is unusable.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// The vehicle lacks a motor that the law needs.
    #[error("the vehicle has no such motor")]
    NoMotor,
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
    /// Whether the command line or an input file is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::Unknown { .. }
                | Self::Stands { .. }
                | Self::Quick { .. }
                | Self::Scenario(_)
                | Self::Folder(_)
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

/// The names of the experiments.
fn known() -> String {
    let names: Vec<&str> = case::ALL.iter().map(|experiment| experiment.name).collect();
    names.join(", ")
}

/// Whether an experiment can be made with this vehicle.
fn suits(vehicle: &Vehicle, quick: bool) -> Result<(), Error> {
    let name = || vehicle.name().to_owned();
    if vehicle.manifest().machine.is_none() {
        return Err(Error::Stands { vehicle: name() });
    }
    if quick && vehicle.name() != DEFAULT {
        return Err(Error::Quick { vehicle: name() });
    }
    Ok(())
}

/// Runs the experiment of that name.
///
/// # Errors
///
/// There is no such vehicle or experiment, or the output folder is wrong (exit code 2); an
/// image does not build or run, or an aim is missed.
pub fn run(workspace: &Workspace, name: &str, options: &Sim) -> Result<(), Failure> {
    let vehicle = &vehicle::find(workspace, &options.vehicle)?;
    let experiment = Experiment::find(name)?;
    suits(vehicle, options.quick)?;
    let folder = match &options.out {
        Some(path) => Some(OutputFolder::create(path).map_err(Error::from)?),
        None => None,
    };
    let scenarios = experiment
        .cases
        .iter()
        .map(|case| case.scenario(vehicle, experiment.name))
        .collect::<Result<Vec<_>, _>>()?;
    let jobs = jobs(vehicle, &scenarios, options);
    let figures = if options.quick {
        run_all(&jobs, &Job::run_quickly)?
    } else {
        let matrix = Matrix::new(vehicle);
        // The plain image first: the one built last stays in the target folder and is the one to
        // flash.
        let (controller, plain) = plain_controller(workspace, vehicle)?;
        let furrow = sim::images(workspace, vehicle)?;
        let plain = furrow.clone().with(controller, plain);
        let images = [furrow, plain];
        run_all(&jobs, &|job: &Job| job.run(&images[job.law], &matrix))?
    };

    let of = |case: usize, law: usize| -> Vec<Figures> {
        let both = jobs.iter().zip(&figures);
        both.filter(|(job, _)| job.case == case && job.law == law)
            .map(|(_, figures)| figures.clone())
            .collect()
    };
    let cases = experiment.cases.iter().enumerate().zip(&scenarios);
    let cases = cases
        .map(|((number, case), scenario)| {
            let shortest = case::shortest_seconds(scenario)?;
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

    if let Some(mut folder) = folder {
        let path = folder
            .write("experiment.json", report.json().as_bytes())
            .and_then(|()| folder.write("runs.csv", runs_csv(&jobs, &figures).as_bytes()))
            .and_then(|()| folder.finish())
            .map_err(Error::from)?;
        eprintln!("Wrote experiment.json and runs.csv to {}.", path.display());
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

/// Every case with every seed and both laws.
fn jobs<'a>(vehicle: &'a Vehicle, scenarios: &'a [Scenario], options: &Sim) -> Vec<Job<'a>> {
    let seeds = (0..options.seeds).map(|k| options.seed.wrapping_add(k));
    let jobs = seeds.flat_map(|seed| {
        let scenarios = scenarios.iter().enumerate();
        scenarios.flat_map(move |(case, scenario)| {
            [0, 1].map(|law| Job {
                case,
                vehicle,
                scenario,
                law,
                seed,
            })
        })
    });
    jobs.collect()
}

/// The controller node, and its image with the thesis's law.
fn plain_controller(
    workspace: &Workspace,
    vehicle: &Vehicle,
) -> Result<(NodeIndex, Vec<u8>), Failure> {
    target::ensure(workspace)?;
    let nodes = vehicle::nodes(vehicle, &["controller".into()])?;
    let mut cargo = build::command(workspace, vehicle, &nodes)?;
    cargo.args(["--features", "thesis-law"]);
    let images = build::finish(cargo, vehicle, &nodes)?;
    let image = images.first().ok_or(Error::NoImage)?;
    let bytes = fs::read(&image.path).map_err(ReadError::of(&image.path))?;
    Ok((image.node, bytes))
}

/// Names of the laws in files.
const LAWS: [&str; 2] = ["furrow", "plain"];

/// A run that is to be done.
struct Job<'a> {
    case: usize,
    vehicle: &'a Vehicle,
    scenario: &'a Scenario,
    /// Index into [`LAWS`].
    law: usize,
    seed: u64,
}

impl Job<'_> {
    fn failed(&self, why: RunError) -> Error {
        Error::Run {
            scenario: self.scenario.name.clone(),
            seed: self.seed,
            law: LAWS[self.law],
            why,
        }
    }

    /// The run with the law alone, without images and bus.
    fn run_quickly(&self) -> Result<Figures, Error> {
        let mut law = quick::law(&quick::settings(), self.law == 1)?;
        quick::drive(
            self.vehicle,
            self.scenario,
            self.seed,
            &mut *law,
            |_, _, _| (),
        )?
        .figures()
        .ok_or_else(|| self.failed(RunError::NeverDrove))
    }

    fn run(&self, images: &Images, matrix: &Matrix) -> Result<Figures, Error> {
        let options = Options {
            seed: self.seed,
            ..Options::default()
        };
        let outcome = twin::run(self.vehicle, self.scenario, images, &options, |_| {})
            .map_err(|error| self.failed(error.into()))?;
        if let Some(node) = outcome.nodes.iter().find(|node| node.locked_up) {
            return Err(self.failed(RunError::Fault {
                node: node.name.clone(),
            }));
        }
        let log = Log::new(&outcome.records, matrix.bit_time());
        let modes = matrix.modes(&log.frames);
        Figures::of(&Run {
            scenario: self.scenario,
            nodes: &vehicle::node_names(self.vehicle),
            seed: self.seed,
            duration: SimDuration::from_ticks(outcome.duration.as_ticks()),
            states: outcome.world.states(),
            efforts: outcome.world.efforts(),
            frames: &log.frames,
            windows: &matrix.windows,
            basic_cycle: matrix.basic_cycle(),
            bit_time: matrix.bit_time(),
            modes: &modes,
            tasks: &[],
        })
        .ok_or_else(|| self.failed(RunError::NeverDrove))
    }
}

/// Does all runs, as many at a time as there are processors. The result of a run depends on its
/// job alone, not on the thread or the order.
fn run_all<'a>(
    jobs: &[Job<'a>],
    make: &(dyn Fn(&Job<'a>) -> Result<Figures, Error> + Sync),
) -> Result<Vec<Figures>, Error> {
    let next = AtomicUsize::new(0);
    let done = Mutex::new((Vec::new(), Display::new()));
    let work = || {
        while let Some((number, job)) = {
            let number = next.fetch_add(1, Ordering::Relaxed);
            jobs.get(number).map(|job| (number, job))
        } {
            let figures = make(job);
            let failed = figures.is_err();
            let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
            let (done, display) = &mut *done;
            done.push((number, figures));
            display.show(|wall| progress(job, done.len(), jobs.len(), wall));
            if failed {
                // After a failure, the remaining runs are of no use.
                next.store(jobs.len(), Ordering::Relaxed);
            }
        }
    };
    let workers = thread::available_parallelism().map_or(1, NonZero::get);
    thread::scope(|scope| {
        for _ in 0..workers.min(jobs.len()) {
            scope.spawn(work);
        }
    });
    let (mut done, mut display) = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    display.end();
    done.sort_by_key(|(number, _)| *number);
    done.into_iter().map(|(_, figures)| figures).collect()
}

/// How far the runs are after `wall`.
fn progress(job: &Job, done: usize, all: usize, wall: Duration) -> String {
    let left = wall.as_secs_f64() / done as f64 * (all - done) as f64 / 60.0;
    format!(
        "{done} of {all} runs, {} with seed {} last, {left:.0} min left",
        job.scenario.name, job.seed
    )
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
            job.scenario.name,
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
    use super::*;

    #[test]
    fn a_vehicle_that_an_experiment_cannot_drive_is_refused() {
        let workspace = Workspace::find().unwrap();
        let uagv = vehicle::find(&workspace, DEFAULT).unwrap();
        assert!(suits(&uagv, true).is_ok());
        let bench = vehicle::find(&workspace, "two-boards").unwrap();
        let error = suits(&bench, false).unwrap_err();
        assert!(error.is_usage());
        assert!(error.to_string().contains("has no [machine]"), "{error}");
        let read = |name| fs::read_to_string(uagv.folder().join(name)).unwrap();
        let (manifest, network) = (read("vehicle.toml"), read("network.dbc"));
        let copy = Vehicle::parse("copy", uagv.folder(), &manifest, &network).unwrap();
        assert!(suits(&copy, false).is_ok());
        let error = suits(&copy, true).unwrap_err();
        assert!(error.to_string().contains("leave --quick out"), "{error}");
    }

    /// Without bus and images, a few seeds: the law and its settings meet the aims by themselves.
    #[test]
    fn the_law_meets_every_aim() {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, "uagv").unwrap();
        let [experiment] = case::ALL else {
            panic!("one experiment");
        };
        for case in experiment.cases {
            let scenario = case.scenario(&vehicle, experiment.name).unwrap();
            let runs = |law| -> Vec<Figures> {
                let job = |seed| Job {
                    case: 0,
                    vehicle: &vehicle,
                    scenario: &scenario,
                    law,
                    seed,
                };
                (1..=3)
                    .map(|seed| job(seed).run_quickly().unwrap())
                    .collect()
            };
            let shortest = case::shortest_seconds(&scenario).unwrap();
            let (furrow, plain) = (runs(0), runs(1));
            let report = CaseReport::new(case, &scenario.summary, shortest, &furrow, &plain);
            assert!(report.aims.iter().all(|aim| aim.met), "{report:?}");
            assert!(report.furrow.overshoot_worst_cm < 3.5, "{report:?}");
            assert!(
                report.furrow.deviation_cm < report.plain.deviation_cm,
                "{report:?}"
            );
        }
    }
}
