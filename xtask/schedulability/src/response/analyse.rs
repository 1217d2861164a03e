//! Response times of a whole task set, with the time table.

use super::bound::{Critical, JobResponse, Response, Unbounded};
use super::busy_period::response;
use super::carry_in;
use super::phases::Phases;
use super::task::Task;
use crate::arrivals::{Arrivals, Job, Timetable};

/// Passes over one priority level after which no further improvement is looked for.
const MAX_PASSES: usize = 20;
/// Rounds after which tasks of one priority that release each other have no bound.
const MAX_ROUNDS: usize = 20;
/// Lateness after which they have none either, in longest deadlines of the set: each round may double it.
const MAX_LATE: u64 = 4;

/// Response times of all tasks, with the time table: a job does not delay another one if it
/// has certainly completed before that one is released, or is certainly released after that
/// one has completed.
///
/// The first pass bounds every task without the table. Each later pass uses the bounds of
/// the pass before to decide which jobs have completed. Those bounds are valid, so the
/// decision is right and the new bounds are valid too; they are never larger.
///
/// A job that starts a transmission has a deadline only while the node is on the bus. So its bound
/// is that of the set without the tasks that run off the bus ([`Task::off_bus`]).
///
/// # Errors
/// For each task, see [`Unbounded`].
#[must_use]
pub fn analyse(tasks: &[Task]) -> Vec<Result<Response, Unbounded>> {
    let mut all = by_level(tasks, |_, _| true);
    let mut of_jobs: Vec<Option<Vec<u64>>> = vec![None; tasks.len()];
    if let Some(set) = on_bus(tasks) {
        let on_bus = by_level(&set, |_, _| true);
        for (index, on_bus) in on_bus.into_iter().enumerate() {
            if let (Ok(bounds), Ok(on_bus)) = (&mut all[index], on_bus)
                && !stays(tasks, index)
            {
                of_jobs[index] = Some(on_bus.of_jobs().collect());
                bounds.take_transmissions(&tasks[index], on_bus);
            }
        }
    }
    let each = tasks.iter().zip(all).zip(of_jobs);
    each.map(|((task, bounds), of_jobs)| bounds.map(|bounds| bounds.answer(task, of_jobs)))
        .collect()
}

/// Whether every task meets its deadline. Stops at the first priority at which one does not.
#[must_use]
pub fn all_meet(tasks: &[Task]) -> bool {
    let of_level = |level: u32| (0..tasks.len()).filter(move |&at| tasks[at].priority == level);
    // The tasks whose transmissions have a bound in the set without those that run off the bus.
    let mut judged = vec![false; tasks.len()];
    let mut meet = true;
    if let Some(set) = on_bus(tasks) {
        by_level(&set, |level, results| {
            for index in of_level(level).filter(|&index| !stays(tasks, index)) {
                if let Ok(bounds) = &results[index] {
                    judged[index] = true;
                    meet &= bounds.timed_meet(&tasks[index], |job| job.transmits);
                }
            }
            meet
        });
    }
    if !meet {
        return false;
    }
    by_level(tasks, |level, results| {
        meet = of_level(level).all(|index| {
            let left = |job: &Job| !(job.transmits && judged[index]);
            let bounds = results[index].as_ref();
            bounds
                .is_ok_and(|bounds| bounds.timed_meet(&tasks[index], left) && bounds.others_meet())
        });
        meet
    });
    meet
}

/// Whether the transmissions of a task have the bounds of the whole set. They do if it releases one
/// of a higher priority: the analysis of that one takes for granted that it meets its deadlines, on
/// the bus or not. And so do those of a task that only runs off the bus.
fn stays(tasks: &[Task], index: usize) -> bool {
    let mut caused = tasks.iter().filter(|task| task.after.contains(&index));
    tasks[index].off_bus || caused.any(|task| task.priority > tasks[index].priority)
}

/// The set without the releases of the tasks that run off the bus; `None` if that makes no
/// difference to a transmission.
fn on_bus(tasks: &[Task]) -> Option<Vec<Task>> {
    let mut tables = tasks.iter().flat_map(|task| &task.arrivals.timed);
    let transmits = tables.any(|table| table.jobs.iter().any(|job| job.transmits));
    if !transmits || !tasks.iter().any(|task| task.off_bus) {
        return None;
    }
    let mut set = tasks.to_vec();
    for task in set.iter_mut().filter(|task| task.off_bus) {
        task.arrivals = Arrivals::default();
        task.cost = 0;
        task.preemption = 0.into();
    }
    Some(set)
}

/// Bounds of all jobs of one task.
#[derive(Debug, Clone, PartialEq, Eq)]
struct Bounds {
    /// A bound of every job.
    whole: Critical,
    /// That of the jobs that may be released at any time, if there are any.
    any: Option<Critical>,
    /// Those of the jobs of the time table, in its order.
    timed: Vec<Critical>,
}

impl Bounds {
    /// The same bound for all jobs of `task`.
    fn new(task: &Task, whole: Critical) -> Self {
        let timed = jobs(task).map(|(_, job)| Critical {
            job: Some(job.label.clone()),
            deadline: job.deadline.unwrap_or(task.deadline),
            ..whole.clone()
        });
        Self {
            any: task.arrivals.has_sporadic().then(|| whole.clone()),
            timed: timed.collect(),
            whole,
        }
    }

    /// The bounds of all jobs; that of the task, if it is never released.
    fn all(&self) -> impl Iterator<Item = &Critical> {
        let none = self.any.is_none() && self.timed.is_empty();
        let whole = none.then_some(&self.whole);
        self.any.iter().chain(&self.timed).chain(whole)
    }

    fn worst(&self) -> u64 {
        let each = self.all().map(|critical| critical.response);
        each.max().unwrap_or(self.whole.response)
    }

    /// Takes the bounds of the jobs of `task` that start a transmission from `other`.
    fn take_transmissions(&mut self, task: &Task, other: Self) {
        let each = self.timed.iter_mut().zip(other.timed);
        for ((bound, other), (_, job)) in each.zip(jobs(task)) {
            if job.transmits {
                *bound = other;
            }
        }
    }

    /// Whether all jobs of the table that are `judged` meet their deadlines.
    fn timed_meet(&self, task: &Task, judged: impl Fn(&Job) -> bool) -> bool {
        let mut timed = self.timed.iter().zip(jobs(task));
        timed.all(|(bound, (_, job))| bound.meets() || !judged(job))
    }

    /// Whether the jobs meet their deadlines that are not of the table, and that of the task, if it
    /// is never released.
    fn others_meet(&self) -> bool {
        let mut others = self.all().filter(|bound| bound.job.is_none());
        others.all(Critical::meets)
    }

    /// Worst response of those jobs of `task` that may release one of `caused`. A job of the table
    /// is released by those of the same instants, else by those that may have their nominal release with it;
    /// if there is none, by any job of the task.
    fn of_causes(&self, task: &Task, caused: &Arrivals) -> u64 {
        let mut late = 0;
        if caused.has_sporadic() {
            late = self.any.as_ref().map_or(0, |any| any.response);
        }
        for table in &caused.timed {
            for job in &table.jobs {
                let of_cycle = || {
                    let all = jobs(task).zip(&self.timed);
                    all.filter(|((of, _), _)| of.cycle == table.cycle)
                };
                let worst = |is_cause: &dyn Fn(&Job) -> bool| {
                    let causes = of_cycle().filter(|((_, cause), _)| is_cause(cause));
                    causes.map(|(_, bound)| bound.response).max()
                };
                // The same event releases jobs at the same instants.
                let same =
                    |cause: &Job| (cause.earliest, cause.latest) == (job.earliest, job.latest);
                let together =
                    worst(&same).or_else(|| worst(&|cause| table.may_coincide(job, cause)));
                late = late.max(together.unwrap_or_else(|| self.worst()));
            }
        }
        if late == 0 { self.worst() } else { late }
    }

    /// The bounds of the jobs of the time table, in its order.
    fn of_jobs(&self) -> impl Iterator<Item = u64> {
        self.timed.iter().map(|bound| bound.response)
    }

    /// The answer; `on_bus` has the bounds of the jobs of the time table without the tasks that run off the
    /// bus, where they are others.
    fn answer(self, task: &Task, on_bus: Option<Vec<u64>>) -> Response {
        let worst = self.worst();
        let critical = self
            .all()
            .reduce(|a, b| if b.has_less_slack_than(a) { b } else { a });
        let critical = critical.unwrap_or(&self.whole).clone();
        let on_bus = on_bus.unwrap_or_else(|| self.of_jobs().collect());
        let by_job = jobs(task).zip(self.of_jobs()).zip(on_bus);
        let by_job = by_job.map(|(((_, job), response), on_bus)| JobResponse {
            earliest: job.earliest,
            latest: job.latest,
            response,
            on_bus,
        });
        Response {
            worst,
            jobs: vec![worst],
            by_job: by_job.collect(),
            critical,
        }
    }
}

/// The jobs of a task in its time table.
fn jobs(task: &Task) -> impl Iterator<Item = (&Timetable, &Job)> {
    let tables = task.arrivals.timed.iter();
    tables.flat_map(|table| table.jobs.iter().map(move |job| (table, job)))
}

/// Analyses one priority after another, from the highest; the answers of a priority are final
/// before the next one begins. Ends early when `go_on`, called with the priority and all
/// answers so far, says no.
fn by_level(
    tasks: &[Task],
    mut go_on: impl FnMut(u32, &[Result<Bounds, Unbounded>]) -> bool,
) -> Vec<Result<Bounds, Unbounded>> {
    let mut set = tasks.to_vec();
    let mut results: Vec<Result<Bounds, Unbounded>> = vec![Err(Unbounded::Cause); set.len()];
    let mut levels: Vec<u32> = set.iter().map(|task| task.priority).collect();
    levels.sort_unstable_by(|a, b| b.cmp(a));
    levels.dedup();
    let mut settled = true;
    for level in levels {
        settled = settled && bound_level(tasks, &mut set, level, &mut results);
        if !settled {
            let of_level = set.iter().zip(&mut results);
            for (_, result) in of_level.filter(|(task, _)| task.priority == level) {
                *result = Err(Unbounded::Diverges);
            }
        }
        if !go_on(level, &results) {
            break;
        }
    }
    results
}

/// Bounds the tasks of one priority. A task may be released by another one of the same priority,
/// whose response time it may delay. So the bounds begin with tasks that are never late, and end
/// when no task is later than the bounds say: then no job can be the first to exceed its bound.
/// Says whether they have come to an end.
fn bound_level(
    tasks: &[Task],
    set: &mut [Task],
    level: u32,
    results: &mut [Result<Bounds, Unbounded>],
) -> bool {
    let of_level: Vec<usize> = (0..set.len())
        .filter(|&index| set[index].priority == level)
        .collect();
    let deadlines = tasks.iter().map(|task| task.deadline);
    let most = deadlines.max().unwrap_or(0).saturating_mul(MAX_LATE);
    let mut settled = true;
    for round in 0..MAX_ROUNDS {
        settled = true;
        for &index in &of_level {
            // In the first round there is nothing known of this priority.
            let from = |cause: usize| round > 0 || tasks[cause].priority != level;
            let late = lateness(set, index, results, from).unwrap_or(0);
            let jitter = tasks[index].jitter.saturating_add(late);
            if jitter > set[index].jitter {
                set[index].jitter = jitter;
                settled = false;
            }
        }
        let late = |&index: &usize| set[index].jitter > most.max(tasks[index].jitter);
        if round > 0 && (settled || of_level.iter().any(late)) {
            break;
        }
        for &index in &of_level {
            let bound = response(set, index);
            results[index] = bound.map(|response| Bounds::new(&set[index], response.critical));
        }
        refine(set, &of_level, results);
    }
    // Behind a cause without a bound there is none either.
    for _ in 0..of_level.len() {
        for &index in &of_level {
            if let Err(why) = lateness(set, index, results, |_| true) {
                results[index] = Err(why);
            }
        }
    }
    settled
}

/// Longest of the worst response times of those causes of `set[index]` that `from` accepts; zero if
/// there is none.
fn lateness(
    set: &[Task],
    index: usize,
    results: &[Result<Bounds, Unbounded>],
    from: impl Fn(usize) -> bool,
) -> Result<u64, Unbounded> {
    let task = &set[index];
    let mut late = 0;
    for &cause in task.after.iter().filter(|&&cause| from(cause)) {
        let of_cause = if set[cause].priority < task.priority {
            // It is analysed later. Its deadlines stand for its response until then: if it misses
            // one, its own answer says so.
            let of_jobs = jobs(&set[cause]).filter_map(|(_, job)| job.deadline);
            of_jobs.fold(set[cause].deadline, u64::max)
        } else {
            let bounds = results[cause].as_ref().map_err(|_| Unbounded::Cause)?;
            bounds.of_causes(&set[cause], &task.arrivals)
        };
        late = late.max(of_cause);
    }
    Ok(late)
}

/// Improves the bounds of one level until a pass changes none of them.
fn refine(set: &[Task], of_level: &[usize], results: &mut [Result<Bounds, Unbounded>]) {
    for &index in of_level {
        if let Ok(bounds) = &mut results[index] {
            by_phases(set, index, bounds);
        }
    }
    for _ in 0..MAX_PASSES {
        let known: Vec<Option<u64>> = results
            .iter()
            .map(|result| result.as_ref().ok().map(Bounds::worst))
            .collect();
        let mut changed = false;
        for &index in of_level {
            if let Ok(bounds) = &mut results[index] {
                changed |= by_completion(set, index, &known, bounds);
            }
        }
        if !changed {
            return;
        }
    }
}

/// Improves the bounds of the jobs of `tasks[index]` by where in the cycle their busy periods begin.
fn by_phases(tasks: &[Task], index: usize, bounds: &mut Bounds) {
    let Some(phases) = Phases::new(tasks, index) else {
        return;
    };
    if let Some(any) = &mut bounds.any {
        improve(any, phases.of_any());
    }
    improve_timed(&tasks[index], &mut bounds.timed, |table, job| {
        phases.of_job(table, job)
    });
}

/// Takes the better bound for each job of the time table. Jobs of one table that only differ by their names
/// have the same.
fn improve_timed<'a>(
    task: &'a Task,
    timed: &mut [Critical],
    bound: impl Fn(&'a Timetable, &'a Job) -> Option<Critical>,
) {
    let mut known: Vec<(&Timetable, &Job, Option<Critical>)> = Vec::new();
    for ((table, job), of_job) in jobs(task).zip(timed) {
        let mut alike = known
            .iter()
            .filter(|(of, other, _)| std::ptr::eq(*of, table) && alike(other, job));
        let found = if let Some((.., found)) = alike.next() {
            found.clone().map(|found| Critical {
                job: Some(job.label.clone()),
                ..found
            })
        } else {
            let found = bound(table, job);
            known.push((table, job, found.clone()));
            found
        };
        improve(of_job, found);
    }
}

/// Whether two jobs of one table have the same releases, causes and deadline.
fn alike(one: &Job, other: &Job) -> bool {
    let of = |job: &Job| {
        let Job {
            id: _,
            cause,
            label: _,
            earliest,
            latest,
            deadline,
            transmits,
        } = *job;
        (cause, earliest, latest, deadline, transmits)
    };
    one.id.is_none() && other.id.is_none() && of(one) == of(other)
}

/// Improves them by which jobs have completed before. `known` holds the bounds of all tasks
/// that may delay them. Says whether the largest one has changed.
fn by_completion(tasks: &[Task], index: usize, known: &[Option<u64>], bounds: &mut Bounds) -> bool {
    let before = bounds.worst();
    improve_timed(&tasks[index], &mut bounds.timed, |table, job| {
        carry_in::of_job(tasks, index, table, job, known)
    });
    bounds.worst() < before
}

/// Takes the better one of two bounds.
fn improve(bound: &mut Critical, other: Option<Critical>) {
    if let Some(other) = other.filter(|other| other.response <= bound.response) {
        *bound = other;
    }
}
