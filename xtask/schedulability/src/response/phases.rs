//! Response times by where in the bus's cycle the busy period begins.
//!
//! A busy period of a priority begins with a release, at an instant at which no job of that
//! priority or above is pending. Every job that delays a given job was released in the same
//! busy period. So only jobs count that the time table allows between the begin of the busy
//! period and the given job's end; jobs that the table keeps apart never share a busy
//! period, however long it is.
//!
//! Once a job has started, only higher priorities delay it. A job of equal priority counts
//! only if it may be released before the given job starts.
//!
//! A job cannot be delayed by jobs that only exist because it ran.
//!
//! It suffices to examine the busy periods that begin with the latest release of a job of
//! the table. Take a busy period that begins at another instant, and the next such latest
//! release after it: no job of the table has its latest release in between, so every table
//! job that may be released in the first busy period may also be released in the second.

use crate::arrivals::{Job, Timetable};

use super::bound::Critical;
use super::fixed_point::{HORIZON, least_fixed_point};
use super::task::Task;

/// A job in its busy period. `starts` and `ends` count from `begin`.
#[derive(Clone, Copy)]
struct Busy {
    /// Begin of the busy period in the bus's cycle.
    begin: u64,
    /// When the job starts.
    starts: u64,
    /// When the job has completed.
    ends: u64,
}

/// The job under analysis, and the task set that may delay it.
struct Look<'a> {
    tasks: &'a [Task],
    index: usize,
    /// Its worst-case execution time.
    cost: u64,
    /// The job and its part of the time table; `None` for a job that may be released at any
    /// time.
    job: Option<(&'a Timetable, &'a Job)>,
}

/// Bound of one job of the table; `None` if the tables have no common cycle or a busy
/// period does not end.
pub(super) fn of_job(
    tasks: &[Task],
    index: usize,
    table: &Timetable,
    job: &Job,
) -> Option<Critical> {
    let cycle = common_cycle(tasks)?.cast_signed();
    let task = &tasks[index];
    let look = Look {
        tasks,
        index,
        cost: table.cost.unwrap_or(task.cost),
        job: Some((table, job)),
    };
    let jitter = task.jitter.cast_signed();
    let (earliest, latest) = (job.earliest.cast_signed(), job.latest.cast_signed());
    let mut worst: Option<(u64, Busy)> = None;
    for begin in look.begins() {
        let busy = look.busy(begin)?;
        // Repetitions of the job, one in each cycle, that may be released between the begin
        // of the busy period and the start of the job.
        let begin = begin.cast_signed();
        let starts = begin.checked_add_unsigned(busy.starts)?;
        let ends = begin.checked_add_unsigned(busy.ends)?;
        let first = (begin - latest - jitter + cycle - 1).div_euclid(cycle);
        let last = (starts - earliest).div_euclid(cycle);
        for turn in first..=last {
            let nominal = (earliest + turn * cycle).max(begin - jitter);
            let response = u64::try_from(ends - nominal).ok()?;
            if worst.is_none_or(|(most, _)| response > most) {
                worst = Some((response, busy));
            }
        }
    }
    let (response, busy) = worst?;
    Some(look.critical(response, busy))
}

/// Bound of a job that may be released at any time.
pub(super) fn of_any(tasks: &[Task], index: usize) -> Option<Critical> {
    common_cycle(tasks)?;
    let task = &tasks[index];
    let look = Look {
        tasks,
        index,
        cost: task.cost,
        job: None,
    };
    let mut longest: Option<Busy> = None;
    for begin in look.begins() {
        let busy = look.busy(begin)?;
        if longest.is_none_or(|longest| busy.ends > longest.ends) {
            longest = Some(busy);
        }
    }
    let busy = longest?;
    let response = busy.ends.checked_add(task.jitter)?;
    Some(look.critical(response, busy))
}

/// The cycle that all tables share, if they do.
fn common_cycle(tasks: &[Task]) -> Option<u64> {
    let mut cycles = tasks
        .iter()
        .flat_map(|task| &task.arrivals.timed)
        .map(|table| table.cycle);
    let first = cycles.next()?;
    (first > 0 && cycles.all(|cycle| cycle == first)).then_some(first)
}

impl<'a> Look<'a> {
    fn task(&self) -> &'a Task {
        &self.tasks[self.index]
    }

    /// Tasks of equal or higher priority, the task itself included.
    fn delaying(&self) -> impl Iterator<Item = (usize, &'a Task)> {
        let urgent = self.task().priority;
        let transmits = self.job.is_some_and(|(_, job)| job.transmits);
        self.tasks
            .iter()
            .enumerate()
            .filter(move |(_, t)| t.priority >= urgent && !(t.off_bus && transmits))
    }

    /// The parts of a task's time table whose jobs may delay the job: not those that the job
    /// itself releases.
    fn tables(&self, of: &'a Task) -> impl Iterator<Item = &'a Timetable> {
        let job = self.job;
        of.arrivals
            .timed
            .iter()
            .filter(move |table| job.is_none_or(|(_, job)| !table.begun_at.contains(&job.earliest)))
    }

    /// Where the busy periods begin that have to be examined; see the module.
    fn begins(&self) -> Vec<u64> {
        let mut begins: Vec<u64> = self
            .delaying()
            .flat_map(|(_, task)| {
                let jobs = self.tables(task).flat_map(|table| &table.jobs);
                jobs.map(|job| job.latest + task.jitter)
            })
            .collect();
        begins.sort_unstable();
        begins.dedup();
        begins
    }

    /// The window from the begin of the busy period in which a release of `other` may still
    /// delay the job.
    fn window(&self, other: &Task, busy: Busy) -> u64 {
        if other.priority > self.task().priority {
            busy.ends
        } else {
            // A release at the very instant at which the job starts still counts.
            busy.starts + 1
        }
    }

    /// Time that the delaying jobs take, plus the blocking.
    fn demand(&self, busy: Busy) -> Option<u64> {
        let mut sum = self.task().blocking;
        for (_, other) in self.delaying() {
            let window = self.window(other, busy);
            let preemption = if other.priority > self.task().priority {
                other.preemption
            } else {
                0
            };
            let jobs = other.arrivals.count_sporadic(window + other.jitter);
            sum = sum.checked_add(jobs.checked_mul(other.cost.checked_add(preemption)?)?)?;
            for table in self.tables(other) {
                let jobs = table.from(busy.begin, window, other.jitter);
                let each = table.cost.unwrap_or(other.cost).checked_add(preemption)?;
                sum = sum.checked_add(jobs.checked_mul(each)?)?;
            }
        }
        let own = if self.is_among(busy) { self.cost } else { 0 };
        Some(sum.saturating_sub(own))
    }

    /// Whether the window also holds a release of the job itself, which is no interference.
    fn is_among(&self, busy: Busy) -> bool {
        self.job.is_none_or(|(table, job)| {
            let task = self.task();
            table.holds(job, busy.begin, self.window(task, busy), task.jitter)
        })
    }

    /// The job's busy period that begins at `begin`; `None` if it does not end.
    fn busy(&self, begin: u64) -> Option<Busy> {
        let starts = least_fixed_point(self.task().blocking, |at| {
            self.demand(Busy {
                begin,
                starts: at,
                ends: at + 1,
            })
            .filter(|at| *at < HORIZON)
        })?;
        let ends = least_fixed_point(starts + self.cost, |at| {
            let busy = Busy {
                begin,
                starts,
                ends: at,
            };
            Some(self.demand(busy)?.checked_add(self.cost)?).filter(|at| *at < HORIZON)
        })?;
        Some(Busy {
            begin,
            starts,
            ends,
        })
    }

    /// The answer for a response found in `busy`.
    fn critical(&self, response: u64, busy: Busy) -> Critical {
        let task = self.task();
        let jobs = |index: usize, other: &'a Task| {
            let window = self.window(other, busy);
            let sporadic = other.arrivals.count_sporadic(window + other.jitter);
            let timed = self.tables(other);
            let timed = timed.map(|table| table.from(busy.begin, window, other.jitter));
            let jobs = sporadic + timed.sum::<u64>();
            if index == self.index && self.is_among(busy) {
                jobs.saturating_sub(1)
            } else {
                jobs
            }
        };
        Critical {
            job: self.job.map(|(_, job)| job.label.clone()),
            response,
            deadline: self
                .job
                .and_then(|(_, job)| job.deadline)
                .unwrap_or(task.deadline),
            jitter: task.jitter,
            delayed_by: self
                .delaying()
                .map(|(index, other)| (index, jobs(index, other)))
                .filter(|(_, jobs)| *jobs > 0)
                .collect(),
        }
    }
}
