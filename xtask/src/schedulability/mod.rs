//! `schedulability` shows whether every deadline holds; `priorities` proposes task priorities.

pub mod observe;

use std::{collections::BTreeMap, io, path::PathBuf, sync::Mutex};

use schedulability::{
    can::ErrorRate,
    foreign::Foreign,
    models::{Files, InputError, Models, Supplements},
    priorities, report,
    results::{NodeReport, Report, TaskReport},
    system::{Inputs, Program, Programs},
};

use twin::TwinError;
use vehicle_model::{NodeIndex, Vehicle};
use wcet::image::ImageError;
use world::ScenarioError;

use crate::{
    Failure, Workspace, bench,
    build::{self, Image},
    cli::{Priorities, Schedulability},
    file,
    progress::Display,
    vehicle,
};

/// Why an analysis fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The table, the network file or a source is wrong.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The scenario of the observed run is wrong.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// The scenarios of the observed runs cannot be listed.
    #[error("{} cannot be read: {error}", path.display())]
    Stress {
        /// Their folder.
        path: PathBuf,
        /// Why not.
        #[source]
        error: io::Error,
    },
    /// There is no such task.
    #[error(
        "there is no task {task} among the nodes analysed: {} are accepted",
        known.join(", ")
    )]
    NoTask {
        /// The name.
        task: String,
        /// The tasks that there are.
        known: Vec<String>,
    },
    /// The virtual vehicle cannot be built.
    #[error(transparent)]
    Twin(#[from] TwinError),
    /// An image cannot be read.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// A thread of the simulation panicked.
    #[error("the simulation broke down")]
    BrokenDown,
    /// A store of a run reached what the analysis takes for constant after start-up.
    #[error("{node} is not as analysed: {sentence}")]
    Stray {
        /// The node.
        node: String,
        /// Who stored, and where.
        sentence: String,
    },
    /// A deadline does not hold, or is not proven to.
    #[error("not schedulable: {0}")]
    Unschedulable(String),
}

impl Error {
    /// Whether the command line or an input file is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::Input(_) | Self::Scenario(_) | Self::Stress { .. } | Self::NoTask { .. }
        )
    }
}

/// Runs `schedulability`.
///
/// # Errors
///
/// Something on the command line, in the table, in the network file or in a
/// source is wrong (exit code 2), an image does not build, or a deadline
/// does not hold.
pub fn run(workspace: &Workspace, options: &Schedulability) -> Result<(), Failure> {
    let vehicle = vehicle::with(workspace, &options.vehicle, &options.changes.overrides())?;
    let nodes = vehicle::nodes(&vehicle, &options.nodes)?;
    // Wrong input is reported before a build that takes time.
    let models = models(
        workspace,
        &vehicle,
        &nodes,
        (&options.foreign, options.errors),
    )?;
    let explained = match &options.explain {
        Some(task) => Some(explained(&models, task)?),
        None => None,
    };
    if let Some(path) = &options.html {
        file::check(path)?;
    }
    let load = (options.foreign.as_slice(), options.errors);
    // A path needs no observed run.
    let observed = explained.is_none() || options.json || options.html.is_some();
    let report = analyse(workspace, &vehicle, &nodes, load, observed)?;
    if let Some(path) = &options.html {
        file::put(path, &report::html(&report))?;
        eprintln!("Wrote {}.", path.display());
    }
    if options.json {
        println!("{:#}", report::json(&report));
    } else if let Some((node, task)) = explained.and_then(|(node, task)| find(&report, node, task))
    {
        print!("{}", report::explain(node, task));
    } else {
        print!("{}", report::table(&report));
        // The verdict is its last line.
        return judge(&report).map_err(|_| Failure::Shown);
    }
    Ok(judge(&report)?)
}

/// Runs `priorities`. Where a source differs from the proposal, the image of that node is
/// analysed to see whether the priorities in the source also meet every deadline.
///
/// # Errors
///
/// Something in the table, in the network file or in a source is wrong, or the
/// image of a node that differs does not build.
pub fn run_priorities(workspace: &Workspace, options: &Priorities) -> Result<(), Failure> {
    let vehicle = vehicle::with(workspace, &options.vehicle, &options.changes.overrides())?;
    let all: Vec<NodeIndex> = vehicle.nodes().collect();
    let models = models(workspace, &vehicle, &all, (&[], None))?;
    let differ: Vec<NodeIndex> = all
        .into_iter()
        .filter(|&of| {
            let name = &vehicle.node(of).name;
            let mut nodes = models.nodes.iter().map(|(node, _)| node);
            nodes.any(|node| node.name == *name && !priorities::inversions(node).is_empty())
        })
        .collect();
    let answers = if differ.is_empty() {
        Vec::new()
    } else {
        let images = build::images(workspace, &vehicle, &differ)?;
        let display = Mutex::new(Display::new());
        let show = shown_on(&display);
        let report = Programs::read(&inputs(workspace, &vehicle, &images, (&[], None)), &show)
            .and_then(|programs| programs.report(&BTreeMap::new(), &show));
        end(&display);
        report.map_err(Error::from)?.nodes
    };
    let nodes = models.nodes.iter().map(|(node, _)| {
        let answer = answers.iter().find(|answer| answer.name == node.name);
        (node, answer)
    });
    if options.json {
        println!("{:#}", priorities::json(nodes));
    } else {
        print!("{}", priorities::show(nodes));
    }
    Ok(())
}

/// What switched-on nodes add to the vehicle's files.
fn supplements(vehicle: &Vehicle) -> Supplements {
    Supplements {
        tables: vehicle.task_supplements(),
        networks: vehicle.network_supplements(),
    }
}

/// What is on the bus beside the vehicle's own messages: those of foreign nodes, and disturbed frames, at
/// the rate of the task table if none is given.
pub(crate) type Load<'a> = (&'a [Foreign], Option<ErrorRate>);

/// The inputs of an analysis of these images, with this load on the bus.
pub(crate) fn inputs(
    workspace: &Workspace,
    vehicle: &Vehicle,
    images: &[Image],
    (foreign, errors): Load<'_>,
) -> Inputs {
    let root = workspace.root().to_path_buf();
    Inputs {
        table: vehicle.task_table(),
        network: vehicle.network_file(),
        supplements: supplements(vehicle),
        receiver_period_us: vehicle.receiver_period_us(),
        event_triggered: vehicle.is_event_triggered(),
        foreign: foreign.to_vec(),
        errors,
        nodes: images
            .iter()
            .map(|image| {
                let program = Program {
                    board: image.board,
                    source: vehicle.source(image.node),
                    image: image.path.clone(),
                };
                (image.name.clone(), program)
            })
            .collect(),
        root,
    }
}

/// Shows the current activity; callable from any thread.
fn shown_on(display: &Mutex<Display>) -> impl Fn(&str) + Sync {
    |what| {
        if let Ok(mut display) = display.lock() {
            display.show(|wall| format!("{:4} s  {what}", wall.as_secs()));
        }
    }
}

fn end(display: &Mutex<Display>) {
    if let Ok(mut display) = display.lock() {
        display.end();
    }
}

/// Builds the images, bounds their tasks, runs them to check the assumptions of the analysis if they are to
/// be `observed`, and reports on these nodes. The run has no foreign messages.
///
/// # Errors
///
/// As [`run`], except that a missed deadline is no error.
pub(crate) fn analyse(
    workspace: &Workspace,
    vehicle: &Vehicle,
    nodes: &[NodeIndex],
    load: Load<'_>,
    observed: bool,
) -> Result<Report, Failure> {
    // All nodes: without the others, a node has no bus traffic to handle.
    let all: Vec<NodeIndex> = vehicle.nodes().collect();
    let images = build::images(workspace, vehicle, &all)?;
    // Without a schedule, each node may make the messages of the others late.
    let event_triggered = vehicle.is_event_triggered();
    let wanted: Vec<Image> = images
        .iter()
        .filter(|image| event_triggered || nodes.contains(&image.node))
        .cloned()
        .collect();
    let display = Mutex::new(Display::new());
    let show = shown_on(&display);
    let report = Programs::read(&inputs(workspace, vehicle, &wanted, load), &show)
        .map_err(|error| Error::from(error).into())
        .and_then(|programs| {
            let runs = if observed {
                observe::observe(vehicle, &images, &programs, &mut |what| show(what))?
            } else {
                BTreeMap::new()
            };
            let mut report = programs.report(&runs, &show).map_err(Error::from)?;
            let wanted = |name: &str| nodes.iter().any(|&node| vehicle.node(node).name == name);
            report.nodes.retain(|node| wanted(&node.name));
            if observed {
                show("kernels");
                report.kernels = bench::kernels::measure(&bench::Builder::new(workspace)?)?;
            }
            Ok(report)
        });
    end(&display);
    report
}

/// Findings that continuous integration refuses: a deadline that does not hold and is not listed as unproven, and,
/// if runs are to be `observed`, a time in them above its bound.
///
/// # Errors
///
/// As [`analyse`].
pub(crate) fn regressions(
    workspace: &Workspace,
    vehicle: &Vehicle,
    observed: bool,
) -> Result<Vec<String>, Failure> {
    let nodes: Vec<NodeIndex> = vehicle.nodes().collect();
    let unproven = models(workspace, vehicle, &nodes, (&[], None))?
        .table
        .unproven;
    let report = analyse(workspace, vehicle, &nodes, (&[], None), observed)?;
    eprint!("{}", report::table(&report));
    Ok(report.regressions(&unproven))
}

/// The first missed deadline as an error, which makes the exit code 1.
fn judge(report: &Report) -> Result<(), Error> {
    match report.first_miss() {
        None => Ok(()),
        Some(miss) => Err(Error::Unschedulable(miss)),
    }
}

fn models(
    workspace: &Workspace,
    vehicle: &Vehicle,
    nodes: &[NodeIndex],
    (foreign, errors): Load<'_>,
) -> Result<Models, Error> {
    let programs: BTreeMap<&str, _> = nodes
        .iter()
        .map(|&node| {
            let name = vehicle.node(node).name.as_str();
            (name, (vehicle.board(node), vehicle.source(node)))
        })
        .collect();
    let programs = programs
        .iter()
        .map(|(name, (board, source))| (*name, *board, source.as_path()));
    Ok(Models::read(
        &Files {
            root: workspace.root(),
            table: &vehicle.task_table(),
            network: &vehicle.network_file(),
            supplements: &supplements(vehicle),
        },
        vehicle.receiver_period_us(),
        vehicle.is_event_triggered(),
        foreign,
        errors,
        programs,
    )?)
}

/// The task that `--explain` names, as node and task.
fn explained<'a>(models: &Models, task: &'a str) -> Result<(&'a str, &'a str), Error> {
    let all = models.nodes.iter().flat_map(|(node, _)| {
        let name = &node.name;
        node.tasks.iter().map(move |task| (name, &task.name))
    });
    let named = task
        .split_once('.')
        .filter(|(n, t)| all.clone().any(|(node, task)| node == n && task == t));
    named.ok_or_else(|| {
        let known = all.map(|(node, task)| format!("{node}.{task}")).collect();
        Error::NoTask {
            task: task.into(),
            known,
        }
    })
}

fn find<'a>(
    report: &'a Report,
    node: &str,
    task: &str,
) -> Option<(&'a NodeReport, &'a TaskReport)> {
    let node = report.nodes.iter().find(|n| n.name == node)?;
    Some((node, node.tasks.iter().find(|t| t.name == task)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use schedulability::results::{ChainReport, StepReport};

    fn report(latency: Option<u64>) -> Report {
        Report {
            nodes: Vec::new(),
            messages: Vec::new(),
            left_out: Vec::new(),
            chains: vec![ChainReport {
                name: "button to motor".into(),
                steps: vec![StepReport {
                    name: "panel.scan".into(),
                    done: latency,
                    phase: None,
                }],
                latency,
                deadline: 5_000_000,
                lost: None,
            }],
            kernels: Vec::new(),
            basic_cycle: 100_000_000_000,
            assumptions: Vec::new(),
            errors: ErrorRate::NONE,
        }
    }

    #[test]
    fn the_exit_code_says_whether_it_holds() {
        assert!(judge(&report(Some(5_000_000))).is_ok());
        let late = judge(&report(Some(6_000_000))).unwrap_err();
        assert_eq!(
            late.to_string(),
            "not schedulable: chain `button to motor` takes up to 6.00 us, its deadline is 5.00 us"
        );
        assert_eq!(Failure::from(late).exit_code(), 1);
        let unknown = judge(&report(None)).unwrap_err();
        assert!(unknown.to_string().contains("panel.scan"), "{unknown}");
        assert_eq!(Failure::from(unknown).exit_code(), 1);
    }

    #[test]
    fn a_task_that_is_nowhere_is_wrong_input() {
        let workspace = Workspace::find().unwrap();
        let vehicle = vehicle::find(&workspace, "uagv").unwrap();
        let drive = vehicle.find_node("drive").unwrap();
        let models = models(&workspace, &vehicle, &[drive], (&[], None)).unwrap();
        assert_eq!(
            explained(&models, "drive.actuate").unwrap(),
            ("drive", "actuate")
        );
        for wrong in ["drive", "drive.rudder", "gps.ring"] {
            let failure = explained(&models, wrong).unwrap_err();
            assert!(failure.to_string().contains("drive.actuate"), "{failure}");
            assert_eq!(Failure::from(failure).exit_code(), 2);
        }
    }
}
