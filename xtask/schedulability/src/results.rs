//! The answers: bounds, and whether they meet the deadlines.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::{self, Write as _};

use wcet::bound::{Problem, Problems};
use wcet::cycles::{Cycles, Model};
use wcet::ipet::Line;

use crate::can::{ErrorRate, MOST_ERRORS};
use crate::outside::Outside;
use crate::units::{Picoseconds, picoseconds, time};

/// The answer for one task.
#[derive(Debug, Clone, PartialEq)]
pub struct TaskReport {
    /// Its name.
    pub name: String,
    /// Interrupt that runs it.
    pub interrupt: String,
    /// Its priority.
    pub priority: u32,
    /// Bound, with exception entry and return.
    pub cycles: Cycles,
    /// Exception entry and return, which the bound includes.
    pub overhead: Cycles,
    /// Longest observed time, without exception entry and return.
    pub observed: Option<Cycles>,
    /// Activations that were followed instruction by instruction.
    pub followed: u64,
    /// Contradictions between these activations and the analysis, one sentence each.
    pub refuted: BTreeSet<String>,
    /// Worst-case execution time: the bound as flashed.
    pub cost: Picoseconds,
    /// Least time between two releases; the greatest number if there is no second one.
    pub period: Picoseconds,
    /// The most releases at one instant.
    pub at_once: u64,
    /// Its releases in the time table, for one cycle: earliest and latest.
    pub releases: Vec<(Picoseconds, Picoseconds)>,
    /// Longest blocking by a critical section of a lower priority.
    pub blocking: Picoseconds,
    /// The task that holds this section, and its place.
    pub blocked_by: Option<String>,
    /// Release jitter, which the response includes.
    pub jitter: Picoseconds,
    /// The job with the least slack, if the time table names it.
    pub job: Option<String>,
    /// Its deadline.
    pub deadline: Picoseconds,
    /// Its worst-case response time, if there is a bound.
    pub response: Option<Picoseconds>,
    /// Those of its jobs of arbitrating windows; `None` if it has none, or no bound.
    pub in_windows: Option<InWindows>,
    /// How long the job with the least slack takes itself: [`TaskReport::cost`], or less if the job has a
    /// bound of its own.
    pub itself: Picoseconds,
    /// Interference in that response, but for what passes before the release: task, number of its
    /// jobs, time.
    pub delayed_by: Vec<(String, u64, Picoseconds)>,
    /// By how much the execution time may grow before a task on the node misses a deadline.
    pub sensitivity: Option<Picoseconds>,
    /// Why there is no response time although the execution time is bounded.
    pub unbounded: Option<String>,
    /// Why there is no bound.
    pub problems: Problems,
    /// Panics that are not proven impossible.
    pub panics: Vec<String>,
    /// Loop bounds that were taken from annotations.
    pub annotated: BTreeMap<String, u64>,
    /// Bounds of loops of libraries and of atomic operations that the tool knows, by what they are.
    pub summarised: BTreeMap<String, u64>,
    /// The longest path by source line, the costliest first.
    pub path: Vec<Line>,
    /// Bound of the integer program.
    pub program: Option<Cycles>,
}

/// The longest response times of a task's jobs of arbitrating windows, while the node is on the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct InWindows {
    /// That of the job at the begin of a window.
    pub opening: Picoseconds,
    /// That of any of them.
    pub any: Picoseconds,
}

impl TaskReport {
    /// Whether its execution time has a bound.
    #[must_use]
    pub fn is_bounded(&self) -> bool {
        self.problems.is_empty()
    }

    /// Whether its deadline is proven to hold.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.is_bounded()
            && self.refuted.is_empty()
            && self.unsound().is_none()
            && self.response.is_some_and(|r| r <= self.deadline)
    }

    /// The time from the end of the worst response to the deadline.
    #[must_use]
    pub fn slack(&self) -> Option<Picoseconds> {
        self.deadline.checked_sub(self.response?)
    }

    /// Bound over longest observed time, both without exception entry and return.
    #[must_use]
    pub fn ratio(&self, model: Model) -> Option<f64> {
        let seen = self.observed?[model];
        let bound = self.cycles.saturating_sub(self.overhead)[model];
        (self.is_bounded() && seen > 0).then(|| bound as f64 / seen as f64)
    }

    /// The observation that exceeds the bound, if there is one: its timing model, the bound and
    /// the observed cycles, both without exception entry and return.
    #[must_use]
    pub fn unsound(&self) -> Option<(Model, u64, u64)> {
        let seen = self.observed?;
        let bound = self.cycles.saturating_sub(self.overhead);
        let exceeded = |model: &Model| self.is_bounded() && seen[*model] > bound[*model];
        let model = Model::ALL.into_iter().find(exceeded)?;
        Some((model, bound[model], seen[model]))
    }

    /// Why the deadline does not hold, in one sentence.
    #[must_use]
    pub fn miss(&self, node: &str) -> Option<String> {
        let task = format!("{node}.{}", self.name);
        if let Some(problem) = self.problems.first() {
            return Some(format!("{task} has no bound: {problem}"));
        }
        if let Some(refuted) = self.refuted.first() {
            return Some(format!(
                "{task} does not behave as analysed, so it has no bound: {refuted}"
            ));
        }
        if let Some((model, bound, seen)) = self.unsound() {
            return Some(format!(
                "{task} took {seen} cycles {}, more than its bound of {bound}: the bound is unsound",
                model.name()
            ));
        }
        let Some(response) = self.response else {
            let why = self.unbounded.as_deref().unwrap_or("it has no bound");
            return Some(format!("{task} has no worst response time: {why}"));
        };
        let over = response
            .checked_sub(self.deadline)
            .filter(|over| *over > 0)?;
        let job = match &self.job {
            Some(job) => format!(" ({job})"),
            None => String::new(),
        };
        Some(format!(
            "{task}{job} misses its deadline of {} by {}: {}",
            time(self.deadline),
            time(over),
            self.composition()
        ))
    }

    /// The part of its own time and of what delays it that has passed when it is released: the response
    /// is the rest. `None` if the parts do not make up the response, or there is none.
    #[must_use]
    pub fn before_release(&self) -> Option<Picoseconds> {
        let others = self.delayed_by.iter().map(|(.., delay)| delay);
        let all = self.itself + self.jitter + self.blocking + others.sum::<Picoseconds>();
        all.checked_sub(self.response?)
    }

    /// The composition of the worst-case response, as a clause.
    #[must_use]
    pub fn composition(&self) -> String {
        let mut parts = vec![format!("it takes {} itself", time(self.itself))];
        if self.jitter > 0 {
            parts.push(format!("is released up to {} late", time(self.jitter)));
        }
        if self.blocking > 0 {
            let who = self.blocked_by.as_deref().unwrap_or("a lower priority");
            parts.push(format!("is blocked {} by {who}", time(self.blocking)));
        }
        let mut others: Vec<_> = self.delayed_by.iter().filter(|d| d.2 > 0).collect();
        others.sort_by_key(|(.., delay)| std::cmp::Reverse(*delay));
        for (task, jobs, delay) in others {
            let times = if *jobs > 1 {
                format!(" ({jobs} times)")
            } else {
                String::new()
            };
            parts.push(format!("waits {} for {task}{times}", time(*delay)));
        }
        let last = parts.pop().unwrap_or_default();
        let mut clause = match parts.as_slice() {
            [] => last,
            parts => format!("{} and {last}", parts.join(", ")),
        };
        if let Some(before) = self.before_release().filter(|before| *before > 0) {
            let _ = write!(
                clause,
                ", of which {} pass before its release",
                time(before)
            );
        }
        clause
    }
}

/// The answer for one node.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeReport {
    /// Its name.
    pub name: String,
    /// Rate of its core in Hz.
    pub core_hz: u64,
    /// Tasks, most urgent first.
    pub tasks: Vec<TaskReport>,
    /// Deepest stack with all preemptions, in bytes.
    pub stack: u32,
    /// Bytes reserved for the stack.
    pub stack_size: u32,
    /// What the stack figure does not include.
    pub stack_unknown: BTreeSet<String>,
    /// Utilisation of the processor, in thousandths.
    pub utilisation_permille: u64,
    /// Why the critical sections of the start-up and idle code are not known.
    pub idle_problems: Problems,
    /// Loop bounds in these sections that were taken from annotations.
    pub idle_annotated: BTreeMap<String, u64>,
    /// Those that the tool knows of loops in them.
    pub idle_summarised: BTreeMap<String, u64>,
    /// Handlers that are no task and do not return.
    pub outside: Vec<Outside>,
}

impl NodeReport {
    /// How long `cycles` of its core take.
    #[must_use]
    pub fn time(&self, cycles: u64) -> Picoseconds {
        picoseconds(cycles, self.core_hz)
    }

    /// Whether code of it has no bound.
    #[must_use]
    pub fn is_unbounded(&self) -> bool {
        !self.idle_problems.is_empty() || !self.tasks.iter().all(TaskReport::is_bounded)
    }

    /// The first problem of the report, in one sentence. Code without a bound comes before the
    /// deadlines that are missed, for it may be the cause.
    #[must_use]
    pub fn first_miss(&self) -> Option<String> {
        let name = &self.name;
        if let Some(problem) = self.idle_problems.first() {
            return Some(format!(
                "the start-up and idle code of {name} may mask interrupts for an unknown time: {problem}"
            ));
        }
        let unbounded = self.tasks.iter().filter(|task| !task.problems.is_empty());
        let mut tasks = unbounded.chain(&self.tasks);
        if let Some(miss) = tasks.find_map(|task| task.miss(name)) {
            return Some(miss);
        }
        (self.stack > self.stack_size).then(|| {
            format!(
                "the stack of {name} may take {} bytes of {}",
                self.stack, self.stack_size
            )
        })
    }
}

/// What disturbed frames do to a message.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Tolerance {
    /// Its frame is sent again. It meets its deadline with bursts of up to this many disturbed frames in
    /// the interval of the stated rate; `None` if it misses it without any.
    Repeated(Option<u64>),
    /// It has an exclusive window, in which nothing is sent again (ISO 11898-4): a disturbed frame is
    /// lost.
    Lost {
        /// Time until its next frame.
        next: Picoseconds,
        /// Losses in a row at which its receivers stop, if they supervise it.
        acted_on: Option<u64>,
    },
    /// A reference message: the time master repeats it at once, and the basic cycle begins with the one
    /// that arrives. Each disturbed frame delays that by up to this, and the time of the master to load
    /// its mailbox.
    Reference(Picoseconds),
}

impl fmt::Display for Tolerance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::Repeated(None) => f.write_str("none"),
            Self::Repeated(Some(1)) => f.write_str("1 error"),
            Self::Repeated(Some(most @ MOST_ERRORS)) => write!(f, "{most} errors or more"),
            Self::Repeated(Some(most)) => write!(f, "{most} errors"),
            Self::Lost { next, acted_on } => {
                write!(f, "lost, next in {} ms", next as f64 / 1e9)?;
                match acted_on {
                    Some(losses) => write!(f, "; receivers stop after {losses} in a row"),
                    None => Ok(()),
                }
            }
            Self::Reference(delay) => write!(f, "repeated, cycle later by {} each", time(delay)),
        }
    }
}

/// The answer for one message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MessageReport {
    /// Its name.
    pub name: String,
    /// Its identifier.
    pub id: u16,
    /// Time that the window must hold: the longest frame with its latest start and the clock
    /// difference. For an event, its worst-case response time; `None` if the event messages
    /// overload the bus. Without a schedule, the longest time from its put to the end of its frame.
    pub need: Option<Picoseconds>,
    /// The time that is available: the length of the window, or the deadline of an event. Without a
    /// schedule, the time until its next frame may be put.
    pub room: Picoseconds,
    /// Start of its window in the basic cycle; `None` without a schedule.
    pub start: Option<Picoseconds>,
    /// True for an event message, which shares its window with others.
    pub arbitrating: bool,
    /// What disturbed frames do to it.
    pub tolerance: Tolerance,
}

impl MessageReport {
    /// Whether it fits.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.need.is_some_and(|need| need <= self.room)
    }

    /// Why it does not fit; `None` if it does.
    #[must_use]
    pub fn miss(&self) -> Option<String> {
        match self.need {
            None => Some(format!(
                "message {} has no worst response time: the messages above it fill the bus",
                self.name
            )),
            Some(need) if need > self.room => Some(format!(
                "message {} needs {} and has {}",
                self.name,
                time(need),
                time(self.room)
            )),
            Some(_) => None,
        }
    }
}

/// A kernel: a small program by which the analysis itself is judged.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct KernelReport {
    /// Its name.
    pub name: String,
    /// Its bound.
    pub bound: Cycles,
    /// The longest of many emulated runs.
    pub seen: Cycles,
}

impl KernelReport {
    /// Bound over longest observed time.
    #[must_use]
    pub fn ratio(&self, model: Model) -> f64 {
        self.bound[model] as f64 / self.seen[model].max(1) as f64
    }
}

/// The end of one step of a chain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StepReport {
    /// Name of the task or message, or of another step.
    pub name: String,
    /// Longest time from the chain's first event to the end of the step; `None` without a bound.
    pub done: Option<Picoseconds>,
    /// Latest instant of the basic cycle at which it ends; known from the first window or time
    /// mark on.
    pub phase: Option<Picoseconds>,
}

/// The answer for one chain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChainReport {
    /// Its name.
    pub name: String,
    /// Its steps, and as the last one what late cycles add, so that it is done after `latency`.
    pub steps: Vec<StepReport>,
    /// Longest end-to-end time; `None` if a step has no bound. It is that of data whose frames arrive:
    /// errors make them late, but destroy none of them in an exclusive window.
    pub latency: Option<Picoseconds>,
    /// Deadline.
    pub deadline: Picoseconds,
    /// The same where a burst of errors destroys frames of the chain; `None` if it can destroy none.
    pub lost: Option<LostReport>,
}

/// The end-to-end time of a chain of which a burst of errors destroys frames. The data of the next cycle
/// take the place of those that are lost.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct LostReport {
    /// The messages of the chain with an exclusive window, in which a disturbed frame is lost.
    pub messages: Vec<String>,
    /// How many of their frames one burst can destroy, one after the other.
    pub frames: u64,
    /// Longest end-to-end time then; `None` if a step has no bound.
    pub latency: Option<Picoseconds>,
    /// Deadline.
    pub deadline: Picoseconds,
}

impl LostReport {
    /// Which frames are lost, as a clause.
    #[must_use]
    pub fn clause(&self) -> String {
        let names = self.messages.join(" or ");
        match self.frames {
            1 => format!("with a frame of {names} lost"),
            frames => format!("with {frames} frames of {names} lost to a burst"),
        }
    }
}

impl ChainReport {
    /// Whether its deadlines hold.
    #[must_use]
    pub fn meets(&self) -> bool {
        let within = |latency: Option<Picoseconds>, deadline| {
            latency.is_some_and(|latency| latency <= deadline)
        };
        let mut lost = self.lost.iter();
        within(self.latency, self.deadline) && lost.all(|lost| within(lost.latency, lost.deadline))
    }

    fn miss(&self) -> Option<String> {
        if self.latency.is_none() {
            let step = self.steps.iter().find(|step| step.done.is_none());
            return Some(match step {
                Some(step) => format!(
                    "chain `{}` has no bound: its step {} has none",
                    self.name, step.name
                ),
                None => format!(
                    "chain `{}` has no bound: errors delay its cycles faster than they pass",
                    self.name
                ),
            });
        }
        let late = |latency: Option<Picoseconds>, deadline, clause: String| {
            latency
                .filter(|latency| *latency > deadline)
                .map(|latency| {
                    format!(
                        "chain `{}` takes up to {}{clause}, its deadline is {}",
                        self.name,
                        time(latency),
                        time(deadline)
                    )
                })
        };
        late(self.latency, self.deadline, String::new()).or_else(|| {
            let lost = self.lost.as_ref()?;
            let clause = format!(" {}", lost.clause());
            late(lost.latency, lost.deadline, clause)
        })
    }
}

/// Why code of these nodes has no bound: by function, each problem with the tasks that it keeps from a
/// bound.
#[must_use]
pub fn unbounded(nodes: &[NodeReport]) -> BTreeMap<&str, BTreeMap<&Problem, Vec<String>>> {
    let mut unbounded: BTreeMap<_, BTreeMap<_, Vec<_>>> = BTreeMap::new();
    for node in nodes {
        let tasks = node
            .tasks
            .iter()
            .map(|task| (task.name.as_str(), &task.problems));
        let idle = ("start-up and idle", &node.idle_problems);
        for (task, problems) in tasks.chain([idle]) {
            for problem in problems {
                let of_function = unbounded.entry(problem.function()).or_default();
                let whose = of_function.entry(problem).or_default();
                whose.push(format!("{}.{task}", node.name));
            }
        }
    }
    unbounded
}

/// All answers.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// By node.
    pub nodes: Vec<NodeReport>,
    /// By message, in the order of their windows.
    pub messages: Vec<MessageReport>,
    /// The messages of arbitrating windows that are not among them: they wait for frames of nodes that are not
    /// analysed.
    pub left_out: Vec<String>,
    /// By chain; a chain through a node that is not analysed is left out.
    pub chains: Vec<ChainReport>,
    /// By kernel, where they were measured.
    pub kernels: Vec<KernelReport>,
    /// Length of the basic cycle.
    pub basic_cycle: Picoseconds,
    /// Assumptions on which the answers rest, one sentence or a few for each.
    pub assumptions: Vec<String>,
    /// The rate of disturbed frames for which they hold.
    pub errors: ErrorRate,
}

impl Report {
    /// Whether everything holds.
    #[must_use]
    pub fn schedulable(&self) -> bool {
        self.first_miss().is_none()
    }

    /// Everything that does not hold, one sentence each, without the nodes and chains that
    /// `unproven` names. A bound that an observation exceeds or contradicts is always
    /// included.
    #[must_use]
    pub fn regressions(&self, unproven: &[String]) -> Vec<String> {
        let accepted = |name: &str| unproven.iter().any(|known| known == name);
        let mut all: Vec<String> = Vec::new();
        for node in &self.nodes {
            let unsound = |task: &&TaskReport| task.unsound().is_some() || !task.refuted.is_empty();
            all.extend(
                node.tasks
                    .iter()
                    .filter(unsound)
                    .filter_map(|task| task.miss(&node.name)),
            );
            if !accepted(&node.name) && all.is_empty() {
                all.extend(node.first_miss());
            }
        }
        all.extend(self.messages.iter().filter_map(MessageReport::miss));
        let chains = self.chains.iter().filter(|chain| !accepted(&chain.name));
        all.extend(chains.filter_map(ChainReport::miss));
        all
    }

    /// Why code has no bound: by function, each problem with the tasks that it keeps from a bound.
    #[must_use]
    pub fn unbounded(&self) -> BTreeMap<&str, BTreeMap<&Problem, Vec<String>>> {
        unbounded(&self.nodes)
    }

    /// The first problem of the report, in one sentence. Code without a bound comes before any deadline
    /// that is missed, on whichever node.
    #[must_use]
    pub fn first_miss(&self) -> Option<String> {
        let mut unbounded = self.nodes.iter().filter(|node| node.is_unbounded());
        let nodes = unbounded
            .find_map(NodeReport::first_miss)
            .or_else(|| self.nodes.iter().find_map(NodeReport::first_miss));
        nodes
            .or_else(|| self.messages.iter().find_map(MessageReport::miss))
            .or_else(|| self.chains.iter().find_map(ChainReport::miss))
    }
}
