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

/// One task as the analysis sees it. All times in one unit.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Task {
    /// Name used in reports.
    pub name: String,
    /// Static priority; a larger number is more urgent, as in RTIC.
    pub priority: u32,
    /// Worst-case execution time of one job, entry and return included.
    pub cost: u64,
    /// Minimum time between two releases (before jitter). Must not be zero.
    pub period: u64,
    /// Deadline relative to the release; may exceed the period.
    pub deadline: u64,
    /// How much later than its nominal arrival a job may be released.
    pub jitter: u64,
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
}

/// Utilisation of the tasks in thousandths of the processor, rounded up.
///
/// Preemption costs count, a zero period does not.
#[must_use]
pub fn utilisation_permille(tasks: &[Task]) -> u64 {
    let sum: f64 = tasks
        .iter()
        .filter(|task| task.period > 0)
        .map(|task| (task.cost as f64 + task.preemption as f64) / task.period as f64)
        .sum();
    (sum * 1000.0 - 1e-9).ceil().max(0.0) as u64
}

/// Worst response time of `tasks[index]` (Joseph and Pandya 1986, Lehoczky
/// 1990 for deadlines beyond the period, Tindell 1994 for jitter, Baker 1991
/// for the blocking term).
///
/// # Errors
/// [`Unbounded`] when the busy period never ends or a period is zero.
pub fn response(tasks: &[Task], index: usize) -> Result<Response, Unbounded> {
    let task = &tasks[index];
    let interfering: Vec<&Task> = tasks
        .iter()
        .enumerate()
        .filter(|(other, t)| *other != index && t.priority >= task.priority)
        .map(|(_, t)| t)
        .collect();
    if task.period == 0 || interfering.iter().any(|t| t.period == 0) {
        return Err(Unbounded::ZeroPeriod);
    }
    let mut demand: Vec<Task> = interfering.iter().map(|t| (*t).clone()).collect();
    demand.push(Task {
        preemption: 0,
        ..task.clone()
    });
    let permille = utilisation_permille(&demand);
    if permille > 1000 {
        return Err(Unbounded::Overload { permille });
    }

    let mut jobs = Vec::new();
    let mut worst = 0;
    for job in 0u64.. {
        let own = (job + 1)
            .checked_mul(task.cost)
            .and_then(|own| own.checked_add(task.blocking))
            .ok_or(Unbounded::Diverges)?;
        let finish = least_fixed_point(own, |window| {
            interfering.iter().try_fold(own, |sum, t| {
                let releases = arrivals(window, t.jitter, t.period)?;
                sum.checked_add(releases.checked_mul(t.cost.checked_add(t.preemption)?)?)
            })
        })
        .ok_or(Unbounded::Diverges)?;
        let arrival = job.checked_mul(task.period).ok_or(Unbounded::Diverges)?;
        // Measured from the nominal arrival of a first job that came as late
        // as its jitter allows.
        let response = (finish + task.jitter).saturating_sub(arrival);
        jobs.push(response);
        worst = worst.max(response);
        if finish + task.jitter <= arrival + task.period {
            return Ok(Response { worst, jobs });
        }
        if jobs.len() > MAX_JOBS {
            return Err(Unbounded::Diverges);
        }
    }
    Err(Unbounded::Diverges)
}

/// Jobs of one busy period beyond which the analysis gives up.
const MAX_JOBS: usize = 100_000;
/// Steps of one fixed-point search beyond which the analysis gives up.
const MAX_STEPS: usize = 1_000_000;

/// Releases of a task within a window that opens with its latest release.
fn arrivals(window: u64, jitter: u64, period: u64) -> Option<u64> {
    Some(window.checked_add(jitter)?.div_ceil(period))
}

fn least_fixed_point(start: u64, next: impl Fn(u64) -> Option<u64>) -> Option<u64> {
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
    sections
        .iter()
        .filter(|section| section.holder < priority && section.ceiling >= priority)
        .map(|section| section.length)
        .max()
        .unwrap_or(0)
}

/// How much longer one job of `tasks[index]` may take before any task of the
/// set, itself included, misses its deadline. `None` when one misses already.
#[must_use]
pub fn slack(tasks: &[Task], index: usize) -> Option<u64> {
    let fits = |extra: u64| {
        let mut longer = tasks.to_vec();
        longer[index].cost = longer[index].cost.saturating_add(extra);
        (0..longer.len()).all(|task| meets(&longer, task))
    };
    if !fits(0) {
        return None;
    }
    let mut low = 0;
    let mut high = tasks[index].deadline.max(1);
    if fits(high) {
        return Some(high);
    }
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if fits(middle) {
            low = middle;
        } else {
            high = middle;
        }
    }
    Some(low)
}

/// Whether `tasks[index]` meets its deadline in the worst case.
#[must_use]
pub fn meets(tasks: &[Task], index: usize) -> bool {
    response(tasks, index).is_ok_and(|response| response.worst <= tasks[index].deadline)
}
