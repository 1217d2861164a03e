//! Response times on one processor under static priorities.
//!
//! The model is that of RTIC: jobs run to completion at a static priority,
//! a lock raises the priority to the ceiling of its resource (Stack Resource
//! Policy, Baker 1991), so a job is blocked at most once, before it starts.
//!
//! Jobs of equal priority do not preempt one another but may be served in any
//! order; they are counted as interference, which is an upper bound for both.
//!
//! Time here is any whole number of one unit shared by all tasks (the command
//! uses picoseconds); the recurrences do not care which.

use crate::arrivals::{Arrivals, Job};
use crate::phases;

/// One task as the analysis sees it. All times in one unit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Task {
    /// Name used in reports.
    pub name: String,
    /// Static priority; a larger number is more urgent, as in RTIC.
    pub priority: u32,
    /// Worst-case execution time of one job, entry and return included.
    pub cost: u64,
    /// When it may be released (before jitter).
    pub arrivals: Arrivals,
    /// Deadline relative to the release; may exceed the period.
    pub deadline: u64,
    /// How much later than its nominal arrival a job may be released.
    pub jitter: u64,
    /// The task that releases it: that one's response adds to the jitter.
    pub after: Option<usize>,
    /// Whether a release is no job of its own while another one is pending: an
    /// interrupt has one pending bit, and its handler serves all there is.
    pub coalesces: bool,
    /// Whether it is released only while the node is off the bus: it does not
    /// delay the node's transmissions then ([`Job::transmits`]).
    pub off_bus: bool,
    /// Longest critical section that can hold this task off ([`blocking`]).
    pub blocking: u64,
    /// What each job of this task costs the job it preempts, beyond `cost`:
    /// a restarted divide, a lost flash line, a stacked FPU context.
    pub preemption: u64,
}

/// Result of the analysis of one task.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Response {
    /// Worst response time measured from the nominal arrival, jitter included.
    pub worst: u64,
    /// Response times of the jobs of the longest busy period, in order.
    pub jobs: Vec<u64>,
    /// The job with the least room.
    pub critical: Critical,
    /// Of each job of the time table: earliest and latest release, worst response.
    pub by_job: Vec<(u64, u64, u64)>,
}

impl Response {
    /// Worst response of the jobs that may release one of `caused`: those that
    /// stand where it stands in the table, or all where none does.
    fn of_cause(&self, caused: &Arrivals) -> u64 {
        let jobs = || caused.timed.iter().flat_map(|table| &table.jobs);
        let causes = |&&(earliest, latest, _): &&(u64, u64, u64)| {
            jobs().any(|job| job.earliest <= latest && earliest <= job.latest)
        };
        let matched = self.by_job.iter().filter(causes);
        matched
            .map(|(.., response)| *response)
            .max()
            .unwrap_or(self.worst)
    }
}

/// The job of a task that comes closest to its deadline, or misses it most.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Critical {
    /// What releases it, where the time table says so.
    pub job: Option<String>,
    /// Its worst response.
    pub response: u64,
    /// Its deadline.
    pub deadline: u64,
    /// Jitter in its response.
    pub jitter: u64,
    /// What else is in it: jobs of which task, and how many.
    pub delayed_by: Vec<(usize, u64)>,
}

impl Critical {
    /// Whether every deadline of the task holds.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.response <= self.deadline
    }

    fn has_less_room_than(&self, other: &Self) -> bool {
        let room = |c: &Self| i128::from(c.deadline) - i128::from(c.response);
        room(self) < room(other)
    }
}

/// Why no response time exists.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Unbounded {
    /// The task and everything above it ask for more than the processor has.
    #[error("the processor is overloaded: {permille} per mille are asked for at this priority")]
    Overload {
        /// Demand in thousandths of the processor, rounded up.
        permille: u64,
    },
    /// The busy period did not end within the representable range.
    #[error("the busy period does not end within the range of the analysis")]
    Diverges,
    /// A task of the set has a period of zero.
    #[error("a task has a minimum inter-arrival time of zero")]
    ZeroPeriod,
    /// What releases the task has no bound itself.
    #[error("the task that releases it has no response time")]
    Cause,
}

/// Utilisation of the tasks in thousandths of the processor, rounded up.
///
/// Preemption costs count, a zero period does not.
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

/// Worst response time of `tasks[index]` (Joseph and Pandya 1986, Lehoczky
/// 1990 for deadlines beyond the period, Tindell 1994 for jitter, Baker 1991
/// for the blocking term), without regard to where in the cycle its jobs stand
/// and to which task releases it.
///
/// # Errors
/// [`Unbounded`] when the busy period never ends or a period is zero.
pub fn response(tasks: &[Task], index: usize) -> Result<Response, Unbounded> {
    let task = &tasks[index];
    let interfering: Vec<(usize, &Task)> = tasks
        .iter()
        .enumerate()
        .filter(|(other, t)| *other != index && t.priority >= task.priority)
        .collect();
    let zero = |t: &Task| t.arrivals.has_zero_period();
    if zero(task) || interfering.iter().any(|(_, t)| zero(t)) {
        return Err(Unbounded::ZeroPeriod);
    }
    let mut demand: Vec<Task> = interfering.iter().map(|(_, t)| (*t).clone()).collect();
    demand.push(Task {
        preemption: 0,
        ..task.clone()
    });
    let permille = utilisation_permille(&demand);
    if permille > 1000 {
        return Err(Unbounded::Overload { permille });
    }

    let single = task.arrivals.single();
    let mut jobs = Vec::new();
    let mut worst: Option<Critical> = None;
    for job in 0u64.. {
        let own = (job + 1)
            .checked_mul(task.cost)
            .and_then(|own| own.checked_add(task.blocking))
            .ok_or(Unbounded::Diverges)?;
        let finish = least_fixed_point(own, |window| {
            interfering.iter().try_fold(own, |sum, (_, t)| {
                let releases = t.arrivals.count(window, t.jitter);
                sum.checked_add(releases.checked_mul(t.cost.checked_add(t.preemption)?)?)
            })
        })
        .ok_or(Unbounded::Diverges)?;
        // With one stream, measured from the nominal arrival of a first job
        // that came as late as its jitter allows; else from the release, with
        // the jitter on top.
        let nominal = |job: u64| match single {
            Some(period) => job.checked_mul(period).ok_or(Unbounded::Diverges),
            None => Ok(task.arrivals.distance(job, task.jitter)),
        };
        let response = (finish + task.jitter).saturating_sub(nominal(job)?);
        jobs.push(response);
        if worst.as_ref().is_none_or(|worst| worst.response < response) {
            worst = Some(Critical {
                job: None,
                response,
                deadline: task.deadline,
                jitter: task.jitter,
                delayed_by: interfering
                    .iter()
                    .map(|(other, t)| (*other, t.arrivals.count(finish, t.jitter)))
                    .chain((job > 0).then_some((index, job)))
                    .collect(),
            });
        }
        let next = match single {
            Some(_) => nominal(job + 1)?.saturating_sub(task.jitter),
            None => nominal(job + 1)?,
        };
        if finish <= next {
            break;
        }
        if jobs.len() > MAX_JOBS {
            return Err(Unbounded::Diverges);
        }
    }
    let critical = worst.ok_or(Unbounded::Diverges)?;
    Ok(Response {
        worst: critical.response,
        jobs,
        critical,
        by_job: Vec::new(),
    })
}

/// Responses of all tasks, with regard to the time table: what is surely over
/// before a job is released, or surely not yet released when it is done, does
/// not delay it.
///
/// The first pass takes every bound without the table. Each further pass uses
/// the bounds of the pass before, which hold, to tell what is over; its own
/// bounds are therefore no larger and hold too.
///
/// # Errors
/// For each task, see [`Unbounded`].
#[must_use]
pub fn analyse(tasks: &[Task]) -> Vec<Result<Response, Unbounded>> {
    let mut set = tasks.to_vec();
    let mut results: Vec<Result<Response, Unbounded>> = vec![Err(Unbounded::Cause); set.len()];
    let mut levels: Vec<u32> = set.iter().map(|task| task.priority).collect();
    levels.sort_unstable_by(|a, b| b.cmp(a));
    levels.dedup();
    for level in levels {
        // A task of the level may be released by another of it.
        for _ in 0..set.len() {
            let before = set.clone();
            for index in 0..set.len() {
                if set[index].priority != level {
                    continue;
                }
                // A less urgent cause is analysed later: its deadline stands for
                // its response until then, and its own answer says if it misses.
                let late = match set[index].after {
                    None => Ok(0),
                    Some(cause) if set[cause].priority < level => Ok(set[cause].deadline),
                    Some(cause) => match &results[cause] {
                        Ok(cause) => Ok(cause.of_cause(&set[index].arrivals)),
                        Err(_) => Err(Unbounded::Cause),
                    },
                };
                results[index] = late.and_then(|late| {
                    set[index].jitter = tasks[index].jitter + late;
                    response(&set, index)
                });
            }
            refine(&set, level, &mut results);
            if set == before {
                break;
            }
        }
    }
    results
}

/// Passes over the tasks of one level until their bounds stand.
fn refine(set: &[Task], level: u32, results: &mut [Result<Response, Unbounded>]) {
    for _ in 0..MAX_PASSES {
        let known: Vec<Option<u64>> = results
            .iter()
            .map(|result| result.as_ref().ok().map(|response| response.worst))
            .collect();
        let mut changed = false;
        for index in (0..set.len()).filter(|index| set[*index].priority == level) {
            if let Ok(result) = &mut results[index]
                && let Some(better) = with_table(set, index, &known, result)
            {
                changed |= better.worst < result.worst;
                *result = better;
            }
        }
        if !changed {
            return;
        }
    }
}

const MAX_PASSES: usize = 20;

/// Bounds of the jobs of `tasks[index]` one by one, given the bounds of all
/// that may delay them and one that holds for all its jobs; `None` if one of
/// these is missing or nothing is timed.
fn with_table(
    tasks: &[Task],
    index: usize,
    known: &[Option<u64>],
    whole: &Response,
) -> Option<Response> {
    let task = &tasks[index];
    let mut all: Vec<Critical> = Vec::new();
    let mut by_job = Vec::new();
    if !task.arrivals.sporadic.is_empty() {
        let any = response(tasks, index).ok()?.critical;
        all.push(
            phases::of_any(tasks, index)
                .filter(|better| better.response < any.response)
                .unwrap_or(any),
        );
    }
    let tables = task.arrivals.timed.iter();
    for (table, job) in tables.flat_map(|table| table.jobs.iter().map(move |job| (table, job))) {
        let critical = of_job(tasks, index, job, known)?;
        let critical = phases::of_job(tasks, index, table, job)
            .filter(|better| better.response < critical.response)
            .unwrap_or(critical);
        let critical = if critical.response <= whole.worst {
            critical
        } else {
            Critical {
                response: whole.worst,
                delayed_by: whole.critical.delayed_by.clone(),
                ..critical
            }
        };
        by_job.push((job.earliest, job.latest, critical.response));
        all.push(critical);
    }
    let worst = all.iter().map(|critical| critical.response).max()?;
    let critical = all
        .into_iter()
        .reduce(|a, b| if b.has_less_room_than(&a) { b } else { a })?;
    Some(Response {
        worst,
        jobs: vec![worst],
        critical,
        by_job,
    })
}

/// Bound of one job of the table. Counted as delaying it is what may be
/// released between the longest response of its task before the job's release
/// and the job's end: anything earlier is over.
fn of_job(tasks: &[Task], index: usize, job: &Job, known: &[Option<u64>]) -> Option<Critical> {
    let task = &tasks[index];
    let delaying: Vec<(usize, &Task, u64)> = tasks
        .iter()
        .enumerate()
        .filter(|(_, t)| t.priority >= task.priority && !(t.off_bus && job.transmits))
        .map(|(other, t)| Some((other, t, known[other]?)))
        .collect::<Option<_>>()?;
    let count = |other: usize, t: &Task, bound: u64, window: u64| {
        // A bound holds from the nominal arrival: the jitter is in it.
        let sporadic: u64 = t
            .arrivals
            .sporadic
            .iter()
            .map(|stream| stream.count(window + bound))
            .sum();
        let timed: u64 = t
            .arrivals
            .timed
            .iter()
            .map(|table| table.around(job, task.jitter, bound, window))
            .sum();
        match sporadic + timed {
            // One may be running; whatever comes then is served by this job.
            own if other == index && task.coalesces => own.min(1),
            jobs => jobs,
        }
    };
    let own = task.cost.checked_add(task.blocking)?;
    let finish = least_fixed_point(own, |window| {
        delaying
            .iter()
            .try_fold(own, |sum, (other, t, bound)| {
                let each = if *other == index {
                    t.cost
                } else {
                    t.cost.checked_add(t.preemption)?
                };
                sum.checked_add(count(*other, t, *bound, window).checked_mul(each)?)
            })
            .filter(|window| *window < HORIZON)
    })?;
    Some(Critical {
        job: Some(job.label.clone()),
        response: finish + task.jitter,
        deadline: job.deadline.unwrap_or(task.deadline),
        jitter: task.jitter,
        delayed_by: delaying
            .iter()
            .map(|(other, t, bound)| (*other, count(*other, t, *bound, finish)))
            .filter(|(_, jobs)| *jobs > 0)
            .collect(),
    })
}

/// Jobs of one busy period beyond which the analysis gives up.
const MAX_JOBS: usize = 100_000;
/// Steps of one fixed-point search beyond which the analysis gives up.
const MAX_STEPS: usize = 1_000_000;
/// Responses beyond this (in picoseconds a quarter of an hour) count as none.
pub(crate) const HORIZON: u64 = 1_000_000_000_000_000;

pub(crate) fn least_fixed_point(start: u64, next: impl Fn(u64) -> Option<u64>) -> Option<u64> {
    let mut window = start.max(1);
    for _ in 0..MAX_STEPS {
        let wider = next(window)?;
        if wider <= window {
            return Some(wider.max(start));
        }
        window = wider;
    }
    None
}

/// A stretch of a task that runs with its resource locked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CriticalSection {
    /// Priority of the task that holds the lock.
    pub holder: u32,
    /// Ceiling: the priority the lock raises to.
    pub ceiling: u32,
    /// Longest time the lock is held.
    pub length: u64,
}

/// Longest blocking of a task at `priority` under the Stack Resource Policy:
/// the longest section held by a lower priority with a ceiling at least as
/// high. It comes at most once for each job.
#[must_use]
pub fn blocking(sections: &[CriticalSection], priority: u32) -> u64 {
    blocker(sections, priority).map_or(0, |at| sections[at].length)
}

/// Which section that is.
#[must_use]
pub fn blocker(sections: &[CriticalSection], priority: u32) -> Option<usize> {
    sections
        .iter()
        .enumerate()
        .filter(|(_, section)| section.holder < priority && section.ceiling >= priority)
        .max_by_key(|(_, section)| section.length)
        .map(|(at, _)| at)
}

/// Whether `tasks[index]` meets its deadline in the worst case, without regard
/// to the time table.
#[must_use]
pub fn meets(tasks: &[Task], index: usize) -> bool {
    response(tasks, index).is_ok_and(|response| response.critical.meets())
}
