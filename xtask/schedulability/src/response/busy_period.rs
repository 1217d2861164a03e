//! Response times without the time table: any release may coincide with any other.

use super::bound::{Critical, Delay, Response, Unbounded};
use super::fixed_point::least_fixed_point;
use super::task::{Task, permille};

/// Jobs of one busy period after which the analysis gives up.
const MAX_JOBS: usize = 100_000;

/// Worst response time of `tasks[index]` (Joseph and Pandya 1986; Lehoczky 1990 for
/// deadlines beyond the period; Tindell 1994 for jitter; Baker 1991 for the blocking term).
///
/// The time table's instants and [`Task::after`] are ignored, so the bound holds whatever
/// they say.
///
/// # Errors
/// [`Unbounded`] when the busy period never ends or a period is zero.
pub fn response(tasks: &[Task], index: usize) -> Result<Response, Unbounded> {
    let task = &tasks[index];
    let interfering = interfering(tasks, index)?;
    // A single stream is measured from the nominal release of a first job that is released as
    // late as its jitter allows. Otherwise time counts from the release itself, and the
    // jitter is added: so too if a job may be so late that a later one is released before it.
    let single = task.arrivals.single();
    let single = single.filter(|period| task.jitter <= *period);
    let nominal = |job: u64| match single {
        Some(period) => job.checked_mul(period).ok_or(Unbounded::Diverges),
        None => Ok(task.arrivals.distance(job, task.jitter)),
    };
    let mut jobs = Vec::new();
    let mut worst: Option<Critical> = None;
    for job in 0u64.. {
        let finish = finish(task, &interfering, job).ok_or(Unbounded::Diverges)?;
        let response = (finish + task.jitter).saturating_sub(nominal(job)?);
        jobs.push(response);
        if worst.as_ref().is_none_or(|worst| worst.response < response) {
            worst = Some(Critical {
                job: None,
                response,
                deadline: task.deadline,
                jitter: task.jitter,
                cost: task.cost,
                delayed_by: interfering
                    .iter()
                    .map(|(other, t)| {
                        (
                            *other,
                            t.arrivals.count(finish, t.jitter),
                            t.preemption.at(task.priority),
                        )
                    })
                    .chain((job > 0).then_some((index, job, 0)))
                    .map(|(task, jobs, preemption)| Delay {
                        task,
                        jobs,
                        time: jobs * (tasks[task].cost + preemption),
                    })
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

/// The other tasks that may delay `tasks[index]`, with their indices.
///
/// # Errors
/// A period is zero, or together they overload the processor.
fn interfering(tasks: &[Task], index: usize) -> Result<Vec<(usize, &Task)>, Unbounded> {
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
    let others = interfering.iter();
    let others = others.map(|(_, other)| (*other, other.preemption.at(task.priority)));
    match permille(others.chain([(task, 0)])) {
        permille if permille > 1000 => Err(Unbounded::Overload { permille }),
        _ => Ok(interfering),
    }
}

/// When the busy period has completed job number `job` of `task`, from its begin.
fn finish(task: &Task, interfering: &[(usize, &Task)], job: u64) -> Option<u64> {
    let own = (job + 1)
        .checked_mul(task.cost)?
        .checked_add(task.blocking)?;
    least_fixed_point(own, |window| {
        interfering.iter().try_fold(own, |sum, (_, t)| {
            let releases = t.arrivals.count(window, t.jitter);
            let each = t.cost.checked_add(t.preemption.at(task.priority))?;
            sum.checked_add(releases.checked_mul(each)?)
        })
    })
}

/// Whether `tasks[index]` meets its deadline in the worst case, the time table ignored.
#[must_use]
pub fn meets(tasks: &[Task], index: usize) -> bool {
    response(tasks, index).is_ok_and(|response| response.critical.meets())
}
