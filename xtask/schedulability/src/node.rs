//! Response times of a node, from its model and its execution times.

use std::collections::{BTreeMap, BTreeSet};

use crate::activations;
use crate::arrivals::{Arrivals, Kind};
use crate::execution::{Execution, Handler};
use crate::model::{NodeModel, TaskModel};
use crate::response::{
    self, Critical, CriticalSection, Delay, Preemption, Response, Task, Unbounded,
};
use crate::results::{InWindows, NodeReport, TaskReport};
use crate::sensitivity::slack;
use crate::table::{BusEvent, NodeTable};
use crate::transfers;
use crate::units::{MICROSECOND, Picoseconds, picoseconds, time};
use wcet::cycles::Cycles;
use wcet::timing::Timing;

/// Observations of a node's handlers, by interrupt.
pub type Observed = BTreeMap<String, Seen>;

/// Observations of one handler.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Seen {
    /// Longest observed time, without exception entry and return: as flashed, of the jobs that nothing
    /// preempted.
    pub longest: Cycles,
    /// As flashed, that of the jobs that were preempted so often.
    pub preempted: BTreeMap<u32, u64>,
    /// Activations that were followed instruction by instruction.
    pub followed: u64,
    /// When it was entered, for each start of the node in each run.
    pub entered: Vec<Entered>,
    /// Contradictions between these activations and the analysis, one sentence each.
    pub refuted: BTreeSet<String>,
}

impl Seen {
    /// The longest time, less what preemptions may have cost: each at most `preemption` cycles as flashed.
    fn without_preemptions(&self, preemption: u64) -> Cycles {
        let preempted = self.preempted.iter();
        let less = preempted.map(|(times, cycles)| {
            cycles.saturating_sub(preemption.saturating_mul(u64::from(*times)))
        });
        Cycles {
            flashed: less.fold(self.longest.flashed, u64::max),
            ..self.longest
        }
    }
}

/// The times at which a handler was entered in a part of a run.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Entered {
    /// The scenario of the run.
    pub scenario: String,
    /// The times since power-on, in order.
    pub at: Vec<Picoseconds>,
}

/// Length at which a section that other tasks make ever longer counts as one without an end.
const LONGEST_SECTION: Picoseconds = 10_000_000 * MICROSECOND;

/// Resolution of the search for the sensitivity.
const STEP: Picoseconds = MICROSECOND / 50;

/// Bounds the response times of the node's tasks.
#[must_use]
pub fn schedule(
    model: &NodeModel,
    table: &NodeTable,
    execution: &Execution,
    observed: Option<&Observed>,
) -> NodeReport {
    let scheduled = Scheduled::new(model, table, execution, observed);
    let tasks = model.tasks.iter();
    NodeReport {
        name: model.name.clone(),
        core_hz: table.core_hz(),
        tasks: tasks.filter_map(|task| scheduled.report(task)).collect(),
        stack: execution.stack,
        stack_size: table.board.stack_bytes,
        stack_unknown: execution.stack_unknown.clone(),
        utilisation_permille: response::utilisation_permille(&scheduled.set),
        idle_problems: execution.idle_problems.clone(),
        idle_annotated: execution.idle_annotated.clone(),
        idle_summarised: execution.idle_summarised.clone(),
        outside: execution.outside.clone(),
    }
}

/// A node as the response-time analysis sees it: one task for each handler.
///
/// Software tasks of one priority share a dispatcher. The bound of the dispatcher includes all of
/// them, so it is one task that is released whenever one of them is.
struct Scheduled<'a> {
    model: &'a NodeModel,
    execution: &'a Execution,
    observed: Option<&'a Observed>,
    /// Interrupts of the handlers, in the order of `set`.
    interrupts: Vec<&'a str>,
    set: Vec<Task>,
    sections: Vec<CriticalSection>,
    results: Vec<Result<Response, Unbounded>>,
    no_handler: Handler,
}

impl<'a> Scheduled<'a> {
    fn new(
        model: &'a NodeModel,
        table: &NodeTable,
        execution: &'a Execution,
        observed: Option<&'a Observed>,
    ) -> Self {
        let time = |cycles: u64| picoseconds(cycles, table.core_hz());
        let mut scheduled = Self {
            model,
            execution,
            observed,
            interrupts: Vec::new(),
            set: Vec::new(),
            sections: Vec::new(),
            results: Vec::new(),
            no_handler: Handler::default(),
        };
        for task in &model.tasks {
            scheduled.add(task, time);
        }
        scheduled.add_transfers(table, time);
        scheduled.add_causes();
        scheduled.add_sections(time);
        scheduled.add_blocking();
        scheduled.results = response::analyse(&scheduled.set);
        if model.event_triggered {
            scheduled.leave_out(table);
        }
        scheduled
    }

    /// Bounds each handler anew without those that cannot delay it. The time table tells the same of
    /// a node with a schedule.
    fn leave_out(&mut self, table: &NodeTable) {
        let all = std::mem::take(&mut self.results);
        let results = (0..self.set.len()).map(|at| {
            let idle: Vec<usize> = (0..self.set.len())
                .filter(|&other| self.is_off_bus(at, other, table) || self.follows(other, at, &all))
                .collect();
            if idle.is_empty() {
                return all[at].clone();
            }
            let mut set = self.set.clone();
            for other in idle {
                set[other].cost = 0;
                set[other].preemption = 0.into();
            }
            response::analyse(&set).swap_remove(at)
        });
        self.results = results.collect();
    }

    /// Whether handler `at` puts messages or reports attempts to send, and the other one runs only
    /// while the node is off the bus. Then nothing is sent any more.
    fn is_off_bus(&self, at: usize, other: usize, table: &NodeTable) -> bool {
        let mut tasks = self.model.tasks.iter();
        let task = tasks.find(|task| task.interrupt == self.interrupts[at]);
        let entry = task.and_then(|task| table.task.get(&task.name));
        let sends = entry.is_some_and(|entry| {
            !entry.sends.as_slice().is_empty() || entry.on.as_slice().contains(&BusEvent::FrameSent)
        });
        sends && self.set[other].off_bus
    }

    /// Whether the jobs of handler `other` are released by those of handler `at`, one by each, and
    /// each has ended before the next one of `at` is released. Then none delays one of `at`.
    ///
    /// That needs the two to have the same priority, and all further tasks that may delay `at` a
    /// higher one. A job of a higher priority would preempt the one of `at` that releases it. And
    /// when a job of `other` ends, no job of a higher priority is pending that it has delayed, and
    /// that could delay the next one of `at` in turn.
    fn follows(&self, other: usize, at: usize, results: &[Result<Response, Unbounded>]) -> bool {
        let priority = self.set[at].priority;
        let beside = |task: usize| self.set[task].priority == priority;
        let mut others = (0..self.set.len()).filter(|&task| task != at && beside(task));
        if others.next() != Some(other) || others.next().is_some() {
            return false;
        }
        let released_by = |task: usize| match self.set[task].after.as_slice() {
            [cause] => Some(*cause),
            _ => None,
        };
        let mut cause = released_by(other);
        // The chain of causes is no longer than there are tasks.
        for _ in 0..self.set.len() {
            match cause {
                Some(before) if before != at => cause = released_by(before),
                _ => break,
            }
        }
        let (one, same) = (&self.set[at].arrivals, &self.set[other].arrivals);
        // One release for each error in addition, if there are any: they follow the same frames.
        if !one.timed.is_empty() || !same.timed.is_empty() || one.spaced != same.spaced {
            return false;
        }
        let apart = one.spaced.iter().map(|group| group.apart).min();
        match (
            one.sporadic.as_slice(),
            same.sporadic.as_slice(),
            &results[other],
        ) {
            ([stream], [copy], Ok(response)) if cause == Some(at) => {
                other != at
                    && stream == copy
                    && response.worst + stream.jitter <= stream.period
                    && apart.is_none_or(|apart| response.worst <= apart)
            }
            _ => false,
        }
    }

    /// Adds a task, to that of its handler if there is one already.
    fn add(&mut self, task: &'a TaskModel, time: impl Fn(u64) -> u64) {
        if let Some(at) = self.index(&task.interrupt) {
            let shared = &mut self.set[at];
            shared.arrivals = shared.arrivals.clone().merged(&task.arrivals);
            shared.deadline = shared.deadline.min(task.deadline);
            shared.jitter = shared.jitter.max(task.jitter);
            shared.off_bus &= task.off_bus;
            return;
        }
        let bound = self.handler(&task.interrupt);
        let new = Task {
            name: task.name.clone(),
            priority: task.priority,
            cost: time(bound.cycles.flashed),
            arrivals: with_costs(task, bound, &time),
            deadline: task.deadline,
            jitter: task.jitter,
            after: Vec::new(),
            coalesces: task.coalesces,
            off_bus: task.off_bus,
            blocking: 0,
            preemption: Preemption::by_level(
                (bound.preemption.iter())
                    .map(|(level, cycles)| (*level, time(*cycles)))
                    .collect(),
            ),
        };
        self.interrupts.push(&task.interrupt);
        self.set.push(new);
    }

    /// Adds the transfers by DMA, which come before all tasks.
    fn add_transfers(&mut self, table: &NodeTable, time: impl Fn(u64) -> u64) {
        let cost = time(Timing::flashed(&table.board.part).transfer());
        for rate in table.dma.values() {
            self.interrupts.push(transfers::NAME);
            self.set.push(transfers::task(rate, cost));
        }
    }

    /// Notes the critical sections. One in which other tasks run lasts longer by all that these may take
    /// meanwhile.
    fn add_sections(&mut self, time: impl Fn(u64) -> u64) {
        let sections = self.execution.sections.iter().map(|section| {
            let own = time(section.cycles);
            let open = section.open.iter().filter_map(|one| self.index(one));
            let open: Vec<&Task> = open.map(|at| &self.set[at]).collect();
            let with_open = |length: u64| {
                let taken = open.iter().map(|task| {
                    // One more may be released before, and be late. How late another task makes it is
                    // not known yet.
                    let jobs = match task.after.as_slice() {
                        [] => task.arrivals.count(length, task.jitter).saturating_add(1),
                        _ => u64::MAX,
                    };
                    jobs.saturating_mul(task.cost + task.preemption.most())
                });
                taken.fold(own, u64::saturating_add)
            };
            let mut length = own;
            while length < LONGEST_SECTION && with_open(length) > length {
                length = with_open(length);
            }
            CriticalSection {
                holder: section.priority,
                ceiling: section.ceiling,
                length: length.min(LONGEST_SECTION.max(own)),
            }
        });
        self.sections = sections.collect();
    }

    /// Notes how long each task may be blocked.
    fn add_blocking(&mut self) {
        let of = |task: &Task| response::blocked(&self.set, &self.sections, task.priority);
        let blocked: Vec<Picoseconds> = self.set.iter().map(of).collect();
        for (task, blocked) in self.set.iter_mut().zip(blocked) {
            task.blocking = blocked;
        }
    }

    /// Notes which task releases which.
    fn add_causes(&mut self) {
        for task in &self.model.tasks {
            let cause = task.after.as_ref().and_then(|after| {
                let mut tasks = self.model.tasks.iter();
                let cause = tasks.find(|other| other.name == *after)?;
                self.index(&cause.interrupt)
            });
            if let Some(at) = self.index(&task.interrupt) {
                self.set[at].after.extend(cause);
            }
        }
    }

    /// Index of the handler of an interrupt.
    fn index(&self, interrupt: &str) -> Option<usize> {
        let mut interrupts = self.interrupts.iter();
        interrupts.position(|known| *known == interrupt)
    }

    fn handler(&self, interrupt: &str) -> &Handler {
        let handler = self.execution.handlers.get(interrupt);
        handler.unwrap_or(&self.no_handler)
    }

    fn is_bounded(&self, index: usize) -> bool {
        self.handler(self.interrupts[index]).problems.is_empty()
    }

    /// A task without a bound that may delay handler `index`, or is it itself.
    fn unbounded_above(&self, index: usize) -> Option<&Task> {
        let priority = self.set[index].priority;
        let mut tasks = (0..).zip(&self.set);
        let found = tasks.find(|(at, task)| task.priority >= priority && !self.is_bounded(*at));
        found.map(|(_, task)| task)
    }

    /// The answer for handler `index`, or the reason why there is none.
    fn critical(&self, index: usize) -> Result<&Critical, String> {
        if !self.execution.idle_problems.is_empty() {
            return Err("start-up and idle may mask it for an unknown time".to_owned());
        }
        if let Some(other) = self.unbounded_above(index) {
            return Err(format!("{} may delay it and has no bound", other.name));
        }
        match &self.results[index] {
            Ok(response) => Ok(&response.critical),
            Err(why) => Err(why.to_string()),
        }
    }

    /// The holder and place of the longest section that blocks a priority.
    fn blocked_by(&self, priority: u32) -> Option<String> {
        let at = response::blocker(&self.sections, priority)?;
        let section = &self.execution.sections[at];
        let tasks = self.model.tasks.iter().rev();
        let mut holders = tasks.filter(|task| task.interrupt == section.holder);
        let holder = holders.next().map_or(&section.holder, |task| &task.name);
        Some(format!("{holder} at {}", section.place))
    }

    /// The interference in a response: task, number of jobs, time.
    fn delays(&self, critical: &Critical) -> Vec<(String, u64, Picoseconds)> {
        let delay = |delay: &Delay| {
            let other = &self.set[delay.task];
            (other.name.clone(), delay.jobs, delay.time)
        };
        critical.delayed_by.iter().map(delay).collect()
    }

    /// What the activations seen contradict: the analysis of their paths, or the releases that are
    /// counted.
    fn refuted(&self, at: usize, seen: &Seen) -> BTreeSet<String> {
        let mut refuted = seen.refuted.clone();
        let Ok(response) = &self.results[at] else {
            return refuted;
        };
        let arrivals = &self.set[at].arrivals;
        let runs = seen.entered.iter();
        let excess = runs.filter_map(|run| {
            let excess = activations::excess(arrivals, response.worst, &run.at)?;
            Some((&run.scenario, excess))
        });
        refuted.extend(excess.map(|(scenario, excess)| {
            format!(
                "it was released {} times within {}, {} after power-on in {scenario}, and the task table allows {}",
                excess.seen,
                time(excess.span),
                time(excess.begin),
                excess.most
            )
        }));
        refuted
    }

    /// The longest response times of the jobs of arbitrating windows.
    fn in_windows(&self, at: usize) -> Option<InWindows> {
        let tables = self.set[at].arrivals.timed.iter();
        let jobs = tables.flat_map(|table| table.jobs.iter().map(|job| (table.kind, job)));
        let response = self.results[at].as_ref().ok()?;
        // Without a bound for each job, that of the task holds.
        let of_jobs = response.by_job.iter().map(|of_job| of_job.on_bus);
        let of_jobs = of_jobs.chain(std::iter::repeat(response.worst));
        let mut found: Option<InWindows> = None;
        for ((_, job), worst) in jobs
            .zip(of_jobs)
            .filter(|((kind, _), _)| *kind == Kind::Arbitrating)
        {
            let found = found.get_or_insert_default();
            found.any = found.any.max(worst);
            if job.id.is_some() {
                found.opening = found.opening.max(worst);
            }
        }
        found
    }

    /// The answer for a task of the source.
    fn report(&self, task: &TaskModel) -> Option<TaskReport> {
        let at = self.index(&task.interrupt)?;
        let shared = &self.set[at];
        let bound = self.handler(&task.interrupt);
        let seen = self.observed.and_then(|seen| seen.get(&task.interrupt));
        let (critical, unbounded) = match self.critical(at) {
            Ok(critical) => (Some(critical), None),
            Err(why) => (None, Some(why)),
        };
        let all_bounded = (0..self.set.len()).all(|at| self.is_bounded(at));
        let tables = task.arrivals.timed.iter();
        Some(TaskReport {
            name: task.name.clone(),
            interrupt: task.interrupt.clone(),
            priority: task.priority,
            cycles: bound.cycles,
            overhead: bound.overhead,
            observed: seen.map(|seen| seen.without_preemptions(bound.lost)),
            followed: seen.map_or(0, |seen| seen.followed),
            refuted: seen.map_or_else(BTreeSet::new, |seen| self.refuted(at, seen)),
            cost: shared.cost,
            period: task.arrivals.distance(1, task.jitter),
            at_once: task.arrivals.count(1, task.jitter),
            releases: tables
                .flat_map(|table| &table.jobs)
                .map(|job| (job.earliest, job.latest))
                .collect(),
            blocking: shared.blocking,
            blocked_by: self.blocked_by(task.priority),
            jitter: critical.map_or(shared.jitter, |critical| critical.jitter),
            job: critical.and_then(|critical| critical.job.clone()),
            deadline: critical.map_or(task.deadline, |critical| critical.deadline),
            response: critical.map(|critical| critical.response),
            in_windows: critical.and_then(|_| self.in_windows(at)),
            itself: critical.map_or(shared.cost, |critical| critical.cost),
            delayed_by: critical.map_or_else(Vec::new, |critical| self.delays(critical)),
            sensitivity: all_bounded.then(|| slack(&self.set, at, STEP)).flatten(),
            unbounded,
            problems: bound.problems.clone(),
            panics: bound.panics.clone(),
            annotated: bound.annotated.clone(),
            summarised: bound.summarised.clone(),
            path: bound.path.clone(),
            program: bound.program,
        })
    }
}

/// The releases of a task, with a bound of its own for each kind of job that has one.
fn with_costs(task: &TaskModel, bound: &Handler, time: impl Fn(u64) -> u64) -> Arrivals {
    let mut arrivals = task.arrivals.clone();
    for table in &mut arrivals.timed {
        let of_kind = bound.kinds.get(&table.kind);
        table.cost = of_kind.map(|cycles| time(cycles.min(bound.cycles).flashed));
    }
    arrivals
}
