//! What the response-time analysis takes: one task.

use std::collections::BTreeMap;

use crate::arrivals::Arrivals;

/// What a preemption costs the preempted job: a restarted divide, lost flash lines, a stacked FPU context. It
/// depends on who can be preempted in the response time under analysis: only jobs of that task's
/// priority and above, and the section that blocks it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Preemption {
    /// The cost in the response times of the tasks of each priority.
    by_level: BTreeMap<u32, u64>,
    /// That of priorities not listed.
    any: u64,
}

impl Preemption {
    /// The costs in the response times of the tasks of each priority. One that is not listed has the largest.
    #[must_use]
    pub fn by_level(by_level: BTreeMap<u32, u64>) -> Self {
        let any = by_level.values().copied().max().unwrap_or(0);
        Self { by_level, any }
    }

    /// The cost in the response time of a task of priority `level`.
    #[must_use]
    pub fn at(&self, level: u32) -> u64 {
        self.by_level.get(&level).copied().unwrap_or(self.any)
    }

    /// The largest cost.
    #[must_use]
    pub fn most(&self) -> u64 {
        self.any
    }
}

impl From<u64> for Preemption {
    /// The same cost for all.
    fn from(any: u64) -> Self {
        Self {
            by_level: BTreeMap::new(),
            any,
        }
    }
}

/// One task. All times in one unit, which the caller chooses.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Task {
    /// Name used in reports.
    pub name: String,
    /// Static priority; a larger number is more urgent, as in RTIC.
    pub priority: u32,
    /// Worst-case execution time of one job, exception entry and return included.
    pub cost: u64,
    /// When its jobs may be released (before jitter).
    pub arrivals: Arrivals,
    /// Deadline relative to the release; may exceed the period.
    pub deadline: u64,
    /// How much later than its nominal release time a job may be released.
    pub jitter: u64,
    /// Indices of the tasks that release this one: the longest of their response times adds to
    /// the jitter of this one.
    ///
    /// A release of the time table follows from a job that may have its nominal release at the
    /// same instant; if there is none, from any job of that task. A release at any time follows
    /// from a job that may come at any time. If both have releases in the table and only this one
    /// has others, these come from elsewhere.
    pub after: Vec<usize>,
    /// True if releases merge: the interrupt has one pending bit, so a release while one is
    /// pending adds no job.
    pub coalesces: bool,
    /// True if its jobs are released only while the node is off the bus. The node transmits
    /// nothing then, so these jobs cannot make a transmission late
    /// ([`Job::transmits`](crate::arrivals::Job::transmits)).
    pub off_bus: bool,
    /// Longest time for which a critical section of a lower priority can block this task
    /// ([`blocked`](super::blocking::blocked)).
    pub blocking: u64,
    /// What each job of this task costs the job it preempts, beyond `cost`.
    pub preemption: Preemption,
}

/// Utilisation of the tasks in thousandths of the processor, rounded up.
///
/// Preemption costs count, each the largest. A stream with a period of zero is left out.
#[must_use]
pub fn utilisation_permille(tasks: &[Task]) -> u64 {
    permille(tasks.iter().map(|task| (task, task.preemption.most())))
}

/// Utilisation of tasks whose jobs cost those that they preempt so much.
pub(super) fn permille<'a>(tasks: impl Iterator<Item = (&'a Task, u64)>) -> u64 {
    let sum: f64 = tasks
        .flat_map(|(task, preemption)| {
            let cost = (task.cost as f64) + (preemption as f64);
            let rates = task.arrivals.rates().filter(|(_, period)| *period > 0);
            rates.map(move |(jobs, period)| cost * jobs as f64 / period as f64)
        })
        .sum();
    (sum * 1000.0 - 1e-9).ceil().max(0.0) as u64
}
