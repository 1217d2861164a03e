//! The answers.

use std::collections::{BTreeMap, BTreeSet};

use wcet::analysis::Problem;

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
    /// Bound in cycles, exception entry and return included: zero wait states,
    /// then as flashed.
    pub cycles: [u64; 2],
    /// Cycles of entry and return in these bounds.
    pub overhead: [u64; 2],
    /// Longest time seen in cycles, without entry and return; as above.
    pub observed: Option<[u64; 2]>,
    /// Activations that were followed instruction by instruction.
    pub followed: u64,
    /// What of the analysis they refute, one sentence each.
    pub refuted: BTreeSet<String>,
    /// Bound as flashed.
    pub cost: Picoseconds,
    /// Least time between two releases.
    pub period: Picoseconds,
    /// Releases of the bus's time table in a cycle: earliest, latest.
    pub releases: Vec<(Picoseconds, Picoseconds)>,
    /// Blocking.
    pub blocking: Picoseconds,
    /// Who blocks and where.
    pub blocked_by: Option<String>,
    /// Jitter in the response.
    pub jitter: Picoseconds,
    /// The release with the least room, where the time table names it.
    pub job: Option<String>,
    /// Its deadline.
    pub deadline: Picoseconds,
    /// Its worst response, if there is one.
    pub response: Option<Picoseconds>,
    /// Jobs of other tasks in that response: task, jobs, time.
    pub delayed_by: Vec<(String, u64, Picoseconds)>,
    /// How much longer one job may take before something misses.
    pub sensitivity: Option<Picoseconds>,
    /// Why there is no response although the bound is known.
    pub unbounded: Option<String>,
    /// Why the bound is none.
    pub problems: BTreeSet<Problem>,
    /// Panics not proven impossible.
    pub panics: Vec<String>,
    /// Loop bounds taken from annotations.
    pub annotated: BTreeMap<String, u64>,
    /// Worst path by source line: cycles as flashed, times executed, place.
    pub path: Vec<(u64, u64, String)>,
    /// Bound of the integer program, cycles as above.
    pub program: Option<[u64; 2]>,
}

impl TaskReport {
    /// Whether there is a bound of its execution time.
    #[must_use]
    pub fn is_bounded(&self) -> bool {
        self.problems.is_empty()
    }

    /// Whether its deadline holds.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.is_bounded()
            && self.refuted.is_empty()
            && self.unsound().is_none()
            && self.response.is_some_and(|r| r <= self.deadline)
    }

    /// What is left to the deadline.
    #[must_use]
    pub fn slack(&self) -> Option<Picoseconds> {
        self.deadline.checked_sub(self.response?)
    }

    /// Bound over the longest time seen, entry and return in neither.
    #[must_use]
    pub fn ratio(&self, model: usize) -> Option<f64> {
        let seen = self.observed?[model];
        let bound = self.cycles[model].saturating_sub(self.overhead[model]);
        (self.is_bounded() && seen > 0).then(|| bound as f64 / seen as f64)
    }

    /// The timing model under which more was seen than the bound allows: bound
    /// and longest time, entry and return in neither.
    #[must_use]
    pub fn unsound(&self) -> Option<(&'static str, u64, u64)> {
        let seen = self.observed?;
        ["at zero wait states", "as flashed"]
            .into_iter()
            .enumerate()
            .map(|(model, how)| {
                let bound = self.cycles[model].saturating_sub(self.overhead[model]);
                (how, bound, seen[model])
            })
            .find(|(_, bound, seen)| self.is_bounded() && seen > bound)
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
                "{task} is not as analysed: {refuted}; its bound is none"
            ));
        }
        if let Some((how, bound, seen)) = self.unsound() {
            return Some(format!(
                "{task} took {seen} cycles {how}, more than its bound of {bound}: the bound is unsound"
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

    /// What the response consists of.
    #[must_use]
    pub fn composition(&self) -> String {
        let mut parts = vec![format!("it takes {} itself", time(self.cost))];
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
        match parts.len() {
            1 => parts.remove(0),
            _ => {
                let last = parts.pop().unwrap_or_default();
                format!("{} and {last}", parts.join(", "))
            }
        }
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
    /// Bytes set aside.
    pub stack_size: u32,
    /// What the stack figure does not hold.
    pub stack_unknown: BTreeSet<String>,
    /// Share of the processor that is asked for, in thousandths.
    pub utilisation_permille: u64,
    /// Where the start-up and idle code could not be followed.
    pub idle_problems: BTreeSet<Problem>,
}

impl NodeReport {
    /// How long `cycles` of its core take.
    #[must_use]
    pub fn time(&self, cycles: u64) -> Picoseconds {
        picoseconds(cycles, self.core_hz)
    }

    /// The first thing that does not hold, in one sentence.
    #[must_use]
    pub fn first_miss(&self) -> Option<String> {
        let name = &self.name;
        if let Some(miss) = self.tasks.iter().find_map(|task| task.miss(name)) {
            return Some(miss);
        }
        if let Some(problem) = self.idle_problems.first() {
            return Some(format!(
                "the start-up and idle code of {name} is not followed to its end, so its critical sections are not all known: {problem}"
            ));
        }
        (self.stack > self.stack_size).then(|| {
            format!(
                "the stack of {name} may take {} bytes of {}",
                self.stack, self.stack_size
            )
        })
    }
}

/// The answer for one message.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct MessageReport {
    /// Its name.
    pub name: String,
    /// Its identifier.
    pub id: u16,
    /// Longest frame on the wire with what the window must also hold; `None`
    /// if the arbitrating messages ask for more than the bus has.
    pub need: Option<Picoseconds>,
    /// The window, or the deadline of an event.
    pub room: Picoseconds,
    /// Start of its window in the basic cycle.
    pub start: Picoseconds,
    /// Whether it shares its window.
    pub arbitrating: bool,
}

impl MessageReport {
    /// Whether it fits.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.need.is_some_and(|need| need <= self.room)
    }

    fn miss(&self) -> Option<String> {
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
    /// Bound in cycles: zero wait states, as flashed.
    pub bound: [u64; 2],
    /// Longest time of many emulated runs; as above.
    pub seen: [u64; 2],
}

impl KernelReport {
    /// Bound over the longest time seen.
    #[must_use]
    pub fn ratio(&self, model: usize) -> f64 {
        self.bound[model] as f64 / self.seen[model].max(1) as f64
    }
}

/// The end of one step of a chain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct StepReport {
    /// The task, the message or what else it is.
    pub name: String,
    /// How long after the chain's first event it is over; `None` without bound.
    pub done: Option<Picoseconds>,
    /// Where in the basic cycle that is at the latest, once a window or a mark
    /// has fixed it.
    pub phase: Option<Picoseconds>,
}

/// The answer for one chain.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ChainReport {
    /// Its name.
    pub name: String,
    /// Its steps.
    pub steps: Vec<StepReport>,
    /// Longest time from end to end; `None` if a step has no bound.
    pub latency: Option<Picoseconds>,
    /// Deadline.
    pub deadline: Picoseconds,
}

impl ChainReport {
    /// Whether its deadline holds.
    #[must_use]
    pub fn meets(&self) -> bool {
        self.latency.is_some_and(|latency| latency <= self.deadline)
    }

    fn miss(&self) -> Option<String> {
        match self.latency {
            Some(latency) if latency > self.deadline => Some(format!(
                "chain `{}` takes up to {}, its deadline is {}",
                self.name,
                time(latency),
                time(self.deadline)
            )),
            Some(_) => None,
            None => {
                let step = self.steps.iter().find(|step| step.done.is_none());
                Some(format!(
                    "chain `{}` has no bound: its step {} has none",
                    self.name,
                    step.map_or("", |step| step.name.as_str())
                ))
            }
        }
    }
}

/// All answers.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// By node.
    pub nodes: Vec<NodeReport>,
    /// By message, in order of the cycle.
    pub messages: Vec<MessageReport>,
    /// By chain; a chain through a node that is not analysed is left out.
    pub chains: Vec<ChainReport>,
    /// By kernel, where they were measured.
    pub kernels: Vec<KernelReport>,
    /// Length of the basic cycle.
    pub basic_cycle: Picoseconds,
    /// What the answers rest on, one sentence each.
    pub assumptions: Vec<String>,
}

impl Report {
    /// Whether everything holds.
    #[must_use]
    pub fn schedulable(&self) -> bool {
        self.first_miss().is_none()
    }

    /// What does not hold although it is not among `unproven`: names of nodes
    /// and chains. A bound below what was seen is never accepted, nor is one
    /// that a run refutes.
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

    /// The first thing that does not hold, in one sentence.
    #[must_use]
    pub fn first_miss(&self) -> Option<String> {
        let nodes = self.nodes.iter().find_map(NodeReport::first_miss);
        nodes
            .or_else(|| self.messages.iter().find_map(MessageReport::miss))
            .or_else(|| self.chains.iter().find_map(ChainReport::miss))
    }
}
