//! What the response-time analysis takes: one task.

use crate::arrivals::Arrivals;

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
    /// What each job of this task costs the job it preempts, beyond `cost`: a restarted
    /// divide, a lost flash line, a stacked FPU context.
    pub preemption: u64,
}

/// Utilisation of the tasks in thousandths of the processor, rounded up.
///
/// Preemption costs count. A stream with a period of zero is left out.
#[must_use]
pub fn utilisation_permille(tasks: &[Task]) -> u64 {
    let sum: f64 = tasks
        .iter()
        .flat_map(|task| {
            let cost = (task.cost as f64) + (task.preemption as f64);
            let rates = task.arrivals.rates().filter(|(_, period)| *period > 0);
            rates.map(move |(jobs, period)| cost * jobs as f64 / period as f64)
        })
        .sum();
    (sum * 1000.0 - 1e-9).ceil().max(0.0) as u64
}
