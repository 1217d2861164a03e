//! Response times of a node: its model and what its image says put together.

use std::collections::{BTreeMap, BTreeSet};

use crate::arrivals::Arrivals;
use crate::execution::{Execution, Handler};
use crate::model::{NodeModel, TaskModel};
use crate::response::{self, CriticalSection, Task};
use crate::results::{NodeReport, TaskReport};
use crate::sensitivity::slack;
use crate::table::NodeTable;
use crate::units::{MICROSECOND, Picoseconds, picoseconds};

/// What was seen of a node's handlers, by interrupt.
pub type Observed = BTreeMap<String, Seen>;

/// What was seen of a handler.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Seen {
    /// Longest time: cycles without entry and return at zero wait states and as
    /// flashed.
    pub longest: [u64; 2],
    /// Activations that were followed instruction by instruction.
    pub followed: u64,
    /// What of the analysis they refute, one sentence each.
    pub refuted: BTreeSet<String>,
}

/// To within this the sensitivity is found.
const STEP: Picoseconds = MICROSECOND / 50;

/// The releases of a task, each kind of job with its own bound.
fn with_costs(task: &TaskModel, bound: &Handler, time: impl Fn(u64) -> u64) -> Arrivals {
    let mut arrivals = task.arrivals.clone();
    for table in &mut arrivals.timed {
        table.cost = bound
            .kinds
            .get(&table.kind)
            .map(|cycles| time(cycles[1].min(bound.cycles[1])));
    }
    arrivals
}

/// Schedules the node.
#[must_use]
pub fn schedule(
    model: &NodeModel,
    table: &NodeTable,
    execution: &Execution,
    observed: Option<&Observed>,
) -> NodeReport {
    let time = |cycles: u64| picoseconds(cycles, table.core_hz());
    let sections: Vec<CriticalSection> = execution
        .sections
        .iter()
        .map(|section| CriticalSection {
            holder: section.priority,
            ceiling: section.ceiling,
            length: time(section.cycles),
        })
        .collect();
    let nothing = Handler::default();
    let handler = |interrupt: &str| execution.handlers.get(interrupt).unwrap_or(&nothing);

    // Software tasks of one priority share a dispatcher. Its bound holds all of
    // them, so that it counts once, released whenever any of them is.
    let mut set: Vec<Task> = Vec::new();
    let mut interrupts: Vec<&str> = Vec::new();
    for task in &model.tasks {
        let bound = handler(&task.interrupt);
        if let Some(at) = interrupts.iter().position(|known| *known == task.interrupt) {
            let shared = &mut set[at];
            shared.arrivals = shared.arrivals.clone().merged(&task.arrivals);
            shared.deadline = shared.deadline.min(task.deadline);
            shared.jitter = shared.jitter.max(task.jitter);
            continue;
        }
        interrupts.push(&task.interrupt);
        set.push(Task {
            name: task.name.clone(),
            priority: task.priority,
            cost: time(bound.cycles[1]),
            arrivals: with_costs(task, bound, time),
            deadline: task.deadline,
            jitter: task.jitter,
            after: None,
            coalesces: task.coalesces,
            off_bus: task.off_bus,
            blocking: response::blocking(&sections, task.priority),
            preemption: time(bound.preemption),
        });
    }
    let place = |interrupt: &str| interrupts.iter().position(|known| *known == interrupt);
    for task in &model.tasks {
        let cause = task.after.as_ref().and_then(|after| {
            let cause = model.tasks.iter().find(|other| other.name == *after)?;
            place(&cause.interrupt)
        });
        if let Some(at) = place(&task.interrupt) {
            set[at].after = set[at].after.or(cause);
        }
    }

    // A task without a bound leaves those that it may delay without one.
    let bounded: Vec<bool> = interrupts
        .iter()
        .map(|interrupt| handler(interrupt).problems.is_empty())
        .collect();
    let all_bounded = bounded.iter().all(|bounded| *bounded);
    let results = response::analyse(&set);
    let holders: BTreeMap<&str, &str> = model
        .tasks
        .iter()
        .map(|task| (task.interrupt.as_str(), task.name.as_str()))
        .collect();

    let mut tasks = Vec::new();
    for task in &model.tasks {
        let Some(at) = place(&task.interrupt) else {
            continue;
        };
        let bound = handler(&task.interrupt);
        let seen = observed.and_then(|seen| seen.get(&task.interrupt));
        let model = &set[at];
        let delayed_by_unbounded = set
            .iter()
            .zip(&bounded)
            .find(|(other, bounded)| other.priority >= model.priority && !**bounded)
            .map(|(other, _)| other.name.clone());
        let (critical, unbounded) = match (&results[at], delayed_by_unbounded) {
            (_, Some(other)) => (None, Some(format!("{other} may delay it and has no bound"))),
            (Err(why), None) => (None, Some(why.to_string())),
            (Ok(response), None) => (Some(&response.critical), None),
        };
        let blocker = response::blocker(&sections, task.priority).map(|at| {
            let section = &execution.sections[at];
            let holder = holders
                .get(section.holder.as_str())
                .copied()
                .unwrap_or(section.holder.as_str());
            format!("{holder} at {}", section.place)
        });
        tasks.push(TaskReport {
            name: task.name.clone(),
            interrupt: task.interrupt.clone(),
            priority: task.priority,
            cycles: bound.cycles,
            overhead: bound.overhead,
            observed: seen.map(|seen| seen.longest),
            followed: seen.map_or(0, |seen| seen.followed),
            refuted: seen.map_or_else(BTreeSet::new, |seen| seen.refuted.clone()),
            cost: model.cost,
            period: task.arrivals.distance(1, task.jitter),
            releases: task
                .arrivals
                .timed
                .iter()
                .flat_map(|table| &table.jobs)
                .map(|job| (job.earliest, job.latest))
                .collect(),
            blocking: model.blocking,
            blocked_by: blocker,
            jitter: critical.map_or(model.jitter, |critical| critical.jitter),
            job: critical.and_then(|critical| critical.job.clone()),
            deadline: critical.map_or(task.deadline, |critical| critical.deadline),
            response: critical.map(|critical| critical.response),
            delayed_by: critical
                .iter()
                .flat_map(|critical| &critical.delayed_by)
                .map(|(other, jobs)| {
                    let other = &set[*other];
                    let each = other.cost + other.preemption;
                    (other.name.clone(), *jobs, jobs * each)
                })
                .collect(),
            sensitivity: all_bounded.then(|| slack(&set, at, STEP)).flatten(),
            unbounded,
            problems: bound.problems.clone(),
            panics: bound.panics.clone(),
            annotated: bound.annotated.clone(),
            path: bound.path.clone(),
            program: bound.program,
        });
    }
    NodeReport {
        name: model.name.clone(),
        core_hz: table.core_hz(),
        tasks,
        stack: execution.stack,
        stack_size: table.board.stack.size,
        stack_unknown: execution.stack_unknown.clone(),
        utilisation_permille: response::utilisation_permille(&set),
        idle_problems: execution.idle_problems.clone(),
    }
}
