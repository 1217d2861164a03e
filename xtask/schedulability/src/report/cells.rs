//! The table of tasks, cell by cell, as both the terminal and the page show it.

use crate::results::{NodeReport, TaskReport};
use crate::units::{Picoseconds, time};
use wcet::cycles::Model;

use super::columns::Align::{self, Left, Right};

/// A time, or a dash if there is none.
pub(super) fn or_dash(value: Option<Picoseconds>) -> String {
    value.map_or_else(|| "-".to_owned(), time)
}

/// Headings of the table of tasks.
pub(super) const HEADINGS: [(&str, Align); 13] = [
    ("task", Left),
    ("prio", Right),
    ("interrupt", Left),
    ("every", Right),
    ("bound", Right),
    ("seen", Right),
    ("ratio", Right),
    ("ratio 0ws", Right),
    ("blocked", Right),
    ("response", Right),
    ("deadline", Right),
    ("slack", Right),
    ("may grow", Right),
];

/// What the columns mean.
pub(super) const LEGEND: &str = "every: least time between two releases, how many may come at once, or the number of releases in the bus's time table; \
    bound: WCET as flashed; seen: longest time observed on the emulator, with the slowest core that its manual allows; \
    ratio: bound over seen, as flashed and by the model of the emulator, which has no wait states; \
    blocked: longest critical section of a lower priority; \
    response: worst-case response time of the job with the least slack; \
    may grow: by how much the WCET may grow before a task on the node misses its deadline.";

/// The row of one task.
pub(super) fn row(node: &NodeReport, task: &TaskReport) -> [String; 13] {
    let ratio = |model: Model| {
        let ratio = task.ratio(model);
        ratio.map_or_else(|| "-".to_owned(), |ratio| format!("{ratio:.2}"))
    };
    let bounded = |value: Picoseconds| or_dash(task.is_bounded().then_some(value));
    [
        task.name.clone(),
        task.priority.to_string(),
        task.interrupt.clone(),
        every(task),
        bounded(task.cost),
        or_dash(task.observed.map(|seen| node.time(seen.flashed))),
        ratio(Model::Flashed),
        ratio(Model::ZeroWait),
        time(task.blocking),
        or_dash(task.response),
        time(task.deadline),
        or_dash(task.slack()),
        or_dash(task.sensitivity),
    ]
}

/// A time that is written as zero otherwise.
const NEXT_TO_NONE: Picoseconds = 5_000;

/// How often it may be released: its releases in the time table, or the least distance.
fn every(task: &TaskReport) -> String {
    match (task.releases.len(), task.period) {
        (0, 0) => format!("{} at once", task.at_once),
        (0, u64::MAX) => "once".to_owned(),
        (0, 1..NEXT_TO_NONE) => "< 0.01 us".to_owned(),
        (0, period) => time(period),
        (releases, _) => format!("{releases} a cycle"),
    }
}
