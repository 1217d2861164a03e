//! Response times of a whole task set, with the time table.

use super::bound::{Critical, JobResponse, Response, Unbounded};
use super::busy_period::response;
use super::task::Task;
use super::{carry_in, phases};

/// Passes over one priority level after which no further improvement is looked for.
const MAX_PASSES: usize = 20;

/// Response times of all tasks, with the time table: a job does not delay another one if it
/// has certainly completed before that one is released, or is certainly released after that
/// one has completed.
///
/// The first pass bounds every task without the table. Each later pass uses the bounds of
/// the pass before to decide which jobs have completed. Those bounds are valid, so the
/// decision is right and the new bounds are valid too; they are never larger.
///
/// # Errors
/// For each task, see [`Unbounded`].
#[must_use]
pub fn analyse(tasks: &[Task]) -> Vec<Result<Response, Unbounded>> {
    by_level(tasks, |_, _| true)
}

/// Whether every task meets its deadline. Stops at the first priority at which one does not.
#[must_use]
pub fn all_meet(tasks: &[Task]) -> bool {
    let mut meet = true;
    by_level(tasks, |level, results| {
        let mut of_level = tasks.iter().zip(results);
        meet = of_level.all(|(task, result)| {
            task.priority != level || result.as_ref().is_ok_and(|one| one.critical.meets())
        });
        meet
    });
    meet
}

/// Analyses one priority after another, from the highest; the answers of a priority are final
/// before the next one begins. Ends early when `go_on`, called with the priority and all
/// answers so far, says no.
fn by_level(
    tasks: &[Task],
    mut go_on: impl FnMut(u32, &[Result<Response, Unbounded>]) -> bool,
) -> Vec<Result<Response, Unbounded>> {
    let mut set = tasks.to_vec();
    let mut results: Vec<Result<Response, Unbounded>> = vec![Err(Unbounded::Cause); set.len()];
    let mut levels: Vec<u32> = set.iter().map(|task| task.priority).collect();
    levels.sort_unstable_by(|a, b| b.cmp(a));
    levels.dedup();
    for level in levels {
        // A task of the level may be released by another one of the same level.
        for _ in 0..set.len() {
            let before = set.clone();
            for index in 0..set.len() {
                if set[index].priority != level {
                    continue;
                }
                results[index] = cause_response(&set, index, &results).and_then(|late| {
                    set[index].jitter = tasks[index].jitter + late;
                    response(&set, index)
                });
            }
            refine(&set, level, &mut results);
            if set == before {
                break;
            }
        }
        if !go_on(level, &results) {
            break;
        }
    }
    results
}

/// Worst response time of the task that releases `set[index]`; zero if no task does.
fn cause_response(
    set: &[Task],
    index: usize,
    results: &[Result<Response, Unbounded>],
) -> Result<u64, Unbounded> {
    let task = &set[index];
    match task.after {
        None => Ok(0),
        // A cause of lower priority is analysed later. Its deadline stands for its response
        // until then: if it misses that deadline, its own answer says so.
        Some(cause) if set[cause].priority < task.priority => Ok(set[cause].deadline),
        Some(cause) => match &results[cause] {
            Ok(cause) => Ok(cause.of_cause(&task.arrivals)),
            Err(_) => Err(Unbounded::Cause),
        },
    }
}

/// Improves the bounds of one level until a pass changes none of them.
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

/// Bounds of the jobs of `tasks[index]` one by one. `known` holds the bounds of all tasks
/// that may delay them, and `whole` holds for every job of the task. `None` if a bound is
/// missing or the task has no job.
fn with_table(
    tasks: &[Task],
    index: usize,
    known: &[Option<u64>],
    whole: &Response,
) -> Option<Response> {
    let task = &tasks[index];
    let mut all: Vec<Critical> = Vec::new();
    let mut by_job = Vec::new();
    if task.arrivals.has_sporadic() {
        let any = response(tasks, index).ok()?.critical;
        all.push(
            phases::of_any(tasks, index)
                .filter(|better| better.response < any.response)
                .unwrap_or(any),
        );
    }
    let tables = task.arrivals.timed.iter();
    for (table, job) in tables.flat_map(|table| table.jobs.iter().map(move |job| (table, job))) {
        let critical = carry_in::of_job(tasks, index, job, known)?;
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
        by_job.push(JobResponse {
            earliest: job.earliest,
            latest: job.latest,
            response: critical.response,
        });
        all.push(critical);
    }
    let worst = all.iter().map(|critical| critical.response).max()?;
    let critical = all
        .into_iter()
        .reduce(|a, b| if b.has_less_slack_than(&a) { b } else { a })?;
    Some(Response {
        worst,
        jobs: vec![worst],
        critical,
        by_job,
    })
}
