//! Response times of single jobs of the time table, by what can still be running when they
//! are released.

use crate::arrivals::{Job, Timetable};

use super::blocking::lost;
use super::bound::{Critical, Delay};
use super::fixed_point::{HORIZON, least_fixed_point};
use super::task::Task;

/// A task that may delay the job under analysis.
struct Delaying<'a> {
    index: usize,
    task: &'a Task,
    /// Its worst response time, as known so far.
    response: u64,
}

/// Bound of one job of `own`, a part of the time table of `tasks[index]`.
///
/// A job of another task delays this one only if it is released within the other task's
/// worst response time before this job's release, or between this job's release and its
/// end: any job released earlier has completed by then.
///
/// `known` holds a valid response bound for each task; `None` if one is missing that is
/// needed here, or if the response does not end.
pub(super) fn of_job(
    tasks: &[Task],
    index: usize,
    own: &Timetable,
    job: &Job,
    known: &[Option<u64>],
) -> Option<Critical> {
    let task = &tasks[index];
    let delaying: Vec<Delaying<'_>> = tasks
        .iter()
        .enumerate()
        .filter(|(_, t)| t.priority >= task.priority)
        .map(|(index, task)| {
            Some(Delaying {
                index,
                task,
                response: known[index]?,
            })
        })
        .collect::<Option<_>>()?;
    let count = |other: &Delaying<'_>, window: u64| {
        // The bound counts from the nominal release, so jitter is already in it.
        let sporadic = other.task.arrivals.count_sporadic(window + other.response);
        let tables = other.task.arrivals.timed.iter();
        let timed: u64 = tables
            .map(|table| {
                if own.cycle.is_multiple_of(table.cycle) {
                    table.around(job, task.jitter, other.response, window)
                } else {
                    // The two cycles meet in any way.
                    table.count(window + other.response, 0)
                }
            })
            .sum();
        let span = window.saturating_add(other.response);
        match sporadic + timed {
            // Their distance leaves no room for more.
            jobs if other.index != index => jobs.min(other.task.arrivals.most(span)),
            // One job may be running. Releases merge, so this job serves all later ones.
            own if other.index == index && task.coalesces => own.min(1),
            jobs => jobs,
        }
    };
    let delay = |other: &Delaying<'_>, window: u64| {
        let each = if other.index == index {
            other.task.cost
        } else {
            other
                .task
                .cost
                .checked_add(other.task.preemption.at(task.priority))?
        };
        let jobs = count(other, window);
        // One of them may be running, and have been preempted by a job that has completed.
        let again = jobs.min(1) * lost(tasks, other.task.priority);
        Some(Delay {
            task: other.index,
            jobs,
            time: jobs.checked_mul(each)?.checked_add(again)?,
        })
    };
    let own = task.cost.checked_add(task.blocking)?;
    let finish = least_fixed_point(own, |window| {
        delaying
            .iter()
            .try_fold(own, |sum, other| {
                sum.checked_add(delay(other, window)?.time)
            })
            .filter(|window| *window < HORIZON)
    })?;
    Some(Critical {
        job: Some(job.label.clone()),
        response: finish + task.jitter,
        deadline: job.deadline.unwrap_or(task.deadline),
        jitter: task.jitter,
        cost: task.cost,
        delayed_by: delaying
            .iter()
            .filter_map(|other| delay(other, finish))
            .filter(|delay| delay.jobs > 0)
            .collect(),
    })
}
