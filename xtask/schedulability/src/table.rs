//! The task table: facts about tasks that the sources do not contain.
//!
//! One file for all nodes of a vehicle, `tasks.toml` in its folder. It gives the releases and the
//! deadline of each task. It also lists the chains of tasks and messages that have an end-to-end
//! deadline.

use std::collections::{BTreeMap, BTreeSet};
use std::num::NonZeroU32;

use network_model::Network;
use serde::Deserialize;

use crate::arrivals::Sporadic;
use crate::board::Board;
use crate::can::{ErrorRate, LONGEST_INTERVAL_MS, MOST_ERRORS};
use crate::transfers::Transfers;
use crate::units::{MICROSECOND, Picoseconds};

/// The task table.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Nodes by the names of their images.
    pub node: BTreeMap<String, NodeEntry>,
    /// Chains across nodes.
    #[serde(default)]
    pub chain: Vec<Chain>,
    /// Disturbed frames that the analysis allows for.
    #[serde(default)]
    pub bus: BusTable,
    /// Loops in sources that are not the vehicle's, by their places as messages have them, or by their functions.
    #[serde(default)]
    pub bounds: BTreeMap<String, LoopBound>,
    /// Messages whose absence their receivers supervise: those of [`Delay::Overdue`], known after
    /// [`Table::resolve`].
    #[serde(skip)]
    pub supervised: BTreeSet<String>,
    /// Nodes and chains that are not proven yet. The command fails because of them;
    /// continuous integration does not.
    #[serde(default)]
    pub unproven: Vec<String>,
}

/// What is wrong with the task table, and where.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}{}: {fault}", .line.map_or_else(String::new, |line| format!(":{line}")))]
pub struct TableError {
    /// The file.
    pub file: String,
    /// Line, if it is known.
    pub line: Option<usize>,
    /// What is wrong.
    pub fault: TableFault,
}

/// What can be wrong with the task table.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TableFault {
    /// It does not have the expected form; the parser's message.
    #[error("{0}")]
    Toml(String),
    /// The entry of a task is wrong.
    #[error("task {task} of {node} {fault}")]
    Task {
        /// The task.
        task: String,
        /// Its node.
        node: String,
        /// What is wrong.
        fault: Box<TaskFault>,
    },
    /// `unproven` names something unknown.
    #[error("`unproven` names {0}, which is neither a node nor a chain")]
    Unproven(String),
    /// `at` names a message that depends on no other one, or no message.
    #[error("`at` names {0}, which is no message that has the attribute After in the network file")]
    At(String),
    /// `delay` names no message.
    #[error("`delay` names {0}, which is no message of the network file")]
    Overdue(String),
    /// The bound of a loop is wrong.
    #[error("the bound of {place} has {fault}")]
    Bound {
        /// The loop.
        place: String,
        /// What is wrong.
        fault: String,
    },
    /// A number of the bus errors or of a chain is out of range.
    #[error("{of} has {number}")]
    Number {
        /// Where it is.
        of: String,
        /// The number.
        number: Box<OutOfRange>,
    },
    /// A step of a chain names none or several of the three.
    #[error("each step of chain `{0}` is either a `task`, a `message` or `other`")]
    Step(String),
    /// A step of a chain names something that does not exist.
    #[error("chain `{chain}`, step {step}: {fault}")]
    Chain {
        /// The chain.
        chain: String,
        /// The number of the step, from 1.
        step: usize,
        /// What is wrong with it.
        fault: Box<StepFault>,
    },
}

/// What a step of a chain can name that does not exist.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StepFault {
    /// Its task has no node.
    #[error("`task` is {0:?}: the form NODE.TASK is accepted")]
    Form(String),
    /// There is no such node.
    #[error("`task` is {task:?}: the nodes are {}", .known.join(", "))]
    Node {
        /// The task.
        task: String,
        /// The nodes of the table.
        known: Vec<String>,
    },
    /// There is no such task.
    #[error("`task` is {task:?}: the tasks of {node} are {}", .known.join(", "))]
    Task {
        /// The task.
        task: String,
        /// Its node.
        node: String,
        /// The tasks of the node.
        known: Vec<String>,
    },
    /// There is no such message.
    #[error("`message` is {message:?}: the messages of the network file are {}", .known.join(", "))]
    Message {
        /// The message.
        message: String,
        /// The messages of the network file.
        known: Vec<String>,
    },
}

/// Longest time that the table accepts, in microseconds: one hour. Sums of such times in
/// picoseconds are far below 2^62.
pub const LONGEST_US: u64 = 3_600_000_000;

/// Most events of one kind that the table accepts.
pub const MOST: u64 = 10_000;

/// A number that is not accepted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{field}` = {value}: {least} to {most} is accepted")]
pub struct OutOfRange {
    /// Its key.
    pub field: &'static str,
    /// The number.
    pub value: u64,
    /// The least that is accepted.
    pub least: u64,
    /// The most that is accepted.
    pub most: u64,
}

impl OutOfRange {
    /// Refuses `value` outside `least` to `most`.
    ///
    /// # Errors
    /// It is outside.
    pub fn check(field: &'static str, value: u64, least: u64, most: u64) -> Result<(), Box<Self>> {
        if (least..=most).contains(&value) {
            return Ok(());
        }
        Err(Box::new(Self {
            field,
            value,
            least,
            most,
        }))
    }
}

/// What can be wrong with the entry of a task; each message follows the task's name.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum TaskFault {
    /// Nothing releases it.
    #[error(
        "does not say what releases it: `every_us` above zero, `every`, `on`, `receives`, `at` or `at_us`"
    )]
    NoRelease,
    /// One of its numbers is out of range.
    #[error("has {0}")]
    Number(Box<OutOfRange>),
    /// It has bursts of a receiver, but the vehicle has no receiver.
    #[error("has a `receiver-burst`, but vehicle.toml has no [receiver]")]
    NoReceiver,
    /// `every` names no task with releases of its own.
    #[error("has `every` with a task that is not in its node or has itself such an `every`")]
    EveryTask,
    /// A pender runs more than once, or has no jobs.
    #[error(
        "is pended by {0} {1:?}, but \"each\" is for other tasks and \"once\" for init: write {{ every_us = N, because = \"...\" }}"
    )]
    Run(String, &'static str),
    /// The bound of its pends has no reason.
    #[error("is pended by {0}, but `because` gives no reason")]
    NoReason(String),
    /// It has no deadline or two.
    #[error("needs either `deadline_us` or `by`")]
    Deadline,
    /// Its deadline counts from an instant of the cycle that is not given.
    #[error("has a deadline by a message but no instant of the basic cycle: `at` or `at_us`")]
    NoInstant,
    /// Only the schedule releases it, or gives it a deadline, and there is none.
    #[error(
        "depends on the schedule of a time-triggered bus: `event` says what releases it without one, and its deadline"
    )]
    Scheduled,
    /// An entry for the event-triggered bus has another one in it.
    #[error("has an `event` in its `event`")]
    Nested,
}

/// The bound of a loop in a source in which there is no place for an annotation.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LoopBound {
    /// The most turns that it takes each time it is entered.
    pub turns: u64,
    /// Why it takes no more, for the report.
    pub because: String,
}

/// Most turns of such a loop that are accepted.
const MOST_TURNS: u64 = 999_999_999;

impl LoopBound {
    /// Checks that it has a number in range and a reason.
    ///
    /// # Errors
    /// What is wrong, as the end of a sentence.
    pub fn check(&self) -> Result<(), String> {
        OutOfRange::check("turns", self.turns, 1, MOST_TURNS)
            .map_err(|number| number.to_string())?;
        if self.because.trim().is_empty() {
            return Err("a `because` that gives no reason".to_owned());
        }
        Ok(())
    }

    /// The reason, without a stop.
    #[must_use]
    pub fn reason(&self) -> String {
        self.because.trim().trim_end_matches('.').to_owned()
    }

    /// The numbers of these bounds, by their names.
    #[must_use]
    pub fn turns(bounds: &BTreeMap<String, Self>) -> BTreeMap<String, u64> {
        let each = bounds.iter();
        each.map(|(name, bound)| (name.clone(), bound.turns))
            .collect()
    }
}

/// The sentence about a name in `[bounds]` of a task table that no loop has.
#[must_use]
pub fn unused_bound(file: &str, name: &str) -> String {
    format!(
        "{file}: [bounds] has \"{name}\", but no task reaches a loop of that name: \
         accepted are places as the report has them (file and line), and names of functions"
    )
}

/// Rate of disturbed frames on the bus: [`ErrorRate::USUAL`] where the table says nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BusTable {
    /// Frames that may be disturbed in any `error_interval_ms`, also back to back; zero for none.
    pub error_burst: u64,
    /// Length of that interval, in milliseconds; above zero with an `error_burst` above zero.
    pub error_interval_ms: u64,
}

impl Default for BusTable {
    fn default() -> Self {
        Self {
            error_burst: ErrorRate::USUAL.burst,
            error_interval_ms: ErrorRate::USUAL.interval / 1_000_000,
        }
    }
}

impl BusTable {
    /// The rate.
    #[must_use]
    pub const fn errors(self) -> ErrorRate {
        ErrorRate::every(self.error_burst, self.error_interval_ms)
    }
}

/// One node.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NodeEntry {
    /// The clocks that the program runs on.
    #[serde(default)]
    pub clocks: Clocks,
    /// Tasks by name; `SysTick` for the timer of the software tasks.
    pub task: BTreeMap<String, TaskTable>,
    /// Transfers by DMA.
    #[serde(default)]
    pub dma: Transfers,
}

impl NodeEntry {
    /// The node on its board.
    #[must_use]
    pub fn on(&self, board: impl Into<Board>) -> NodeTable {
        NodeTable {
            board: board.into(),
            clocks: self.clocks,
            task: self.task.clone(),
            dma: self.dma.clone(),
        }
    }
}

impl NodeEntry {
    /// Derives the releases of `every` and `pended_by` for all tasks, but for those that follow
    /// from other tasks' arrivals ([`Run::Each`]).
    ///
    /// # Errors
    /// The name of the task at fault, and what is wrong with it.
    fn derive(
        &mut self,
        network: &Network,
        receiver_period_us: Option<u64>,
    ) -> Result<(), (String, TaskFault)> {
        // All releases of a task that refers to no other one.
        let alone = |task: &TaskTable| -> Result<Vec<Sporadic>, TaskFault> {
            let mut streams: Vec<Sporadic> = task.periodic().collect();
            let mut causes = task.every.as_slice().to_vec();
            for pended in task.pended_by.values() {
                match pended {
                    PendedBy::Run(Run::Each) => return Err(TaskFault::EveryTask),
                    PendedBy::Run(Run::Once) => streams.push(Sporadic::every(ONCE)),
                    PendedBy::Bounded(bounded) => {
                        streams.extend(periodic(&bounded.every_us));
                        causes.extend_from_slice(bounded.every.as_slice());
                    }
                }
            }
            for every in causes {
                streams.push(every.alone(network, receiver_period_us)?);
            }
            Ok(streams)
        };
        let of_causes = |causes: &[Every]| -> Result<Vec<Sporadic>, TaskFault> {
            let mut streams = Vec::new();
            for every in causes {
                match every {
                    Every::BusOff | Every::ReceiverBurst(_) | Every::TimerHz(_) => {
                        streams.push(every.alone(network, receiver_period_us)?);
                    }
                    Every::Task(name) => {
                        let other = self.task.get(name).ok_or(TaskFault::EveryTask)?;
                        streams.extend(alone(other)?);
                    }
                }
            }
            Ok(streams)
        };
        let derived = |task: &TaskTable| -> Result<Vec<Sporadic>, TaskFault> {
            let mut streams = of_causes(task.every.as_slice())?;
            for pended in task.pended_by.values() {
                match pended {
                    PendedBy::Run(Run::Each) => {}
                    PendedBy::Run(Run::Once) => streams.push(Sporadic::every(ONCE)),
                    PendedBy::Bounded(bounded) => {
                        streams.extend(periodic(&bounded.every_us));
                        streams.extend(of_causes(bounded.every.as_slice())?);
                    }
                }
            }
            Ok(streams)
        };
        let mut all = Vec::new();
        for (name, task) in &self.task {
            all.push(derived(task).map_err(|fault| (name.clone(), fault))?);
        }
        for (task, derived) in self.task.values_mut().zip(all) {
            task.every = Several::default();
            task.derived = derived;
        }
        Ok(())
    }
}

impl Every {
    /// The releases of a cause that refers to no other task.
    fn alone(
        &self,
        network: &Network,
        receiver_period_us: Option<u64>,
    ) -> Result<Sporadic, TaskFault> {
        match self {
            Self::BusOff => {
                // Rounded down: this is the least distance.
                let bit_rate = u64::from(network.bit_rate.max(1));
                Ok(Sporadic::every(
                    BUS_OFF_BITS * 1_000_000 * MICROSECOND / bit_rate,
                ))
            }
            Self::ReceiverBurst(burst) => {
                let period = receiver_period_us.ok_or(TaskFault::NoReceiver)?;
                Ok(Sporadic {
                    period: burst.apart_us * MICROSECOND,
                    jitter: 0,
                    limit: Some((burst.jobs, period * MICROSECOND)),
                })
            }
            // Rounded down, too.
            Self::TimerHz(hz) => Ok(Sporadic::every(
                1_000_000 * MICROSECOND / u64::from(hz.get()),
            )),
            Self::Task(_) => Err(TaskFault::EveryTask),
        }
    }
}

/// A node on its board.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeTable {
    /// The board.
    pub board: Board,
    /// The clocks that the program runs on.
    pub clocks: Clocks,
    /// Tasks by name; `SysTick` for the timer of the software tasks.
    pub task: BTreeMap<String, TaskTable>,
    /// Transfers by DMA.
    pub dma: Transfers,
}

/// The clocks that a program runs on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Clocks {
    /// Those that the board makes from its external clock.
    #[default]
    External,
    /// The internal oscillator of the part, as after a reset: the program starts no other clock.
    Reset,
}

impl NodeTable {
    /// Core clock, Hz.
    pub const fn core_hz(&self) -> u64 {
        match self.clocks {
            Clocks::External => self.board.part.core_hz as u64,
            Clocks::Reset => self.board.reset_hz as u64,
        }
    }
}

/// One task.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskTable {
    /// Least time between two releases, in microseconds; one value for each independent
    /// cause.
    #[serde(default)]
    pub every_us: Several<u64>,
    /// Releases whose distance follows from other files of the vehicle's folder. Empty after
    /// [`Table::resolve`].
    #[serde(default)]
    pub every: Several<Every>,
    /// The releases of `every`, as [`Table::resolve`] derives them.
    #[serde(skip)]
    pub derived: Vec<Sporadic>,
    /// Bus events that release it.
    #[serde(default)]
    pub on: Several<BusEvent>,
    /// Messages of other nodes whose reception releases it.
    #[serde(default)]
    pub receives: Several<String>,
    /// Delay from the handling of these messages to its release ([`Table::resolve`]).
    pub delay: Option<Delay>,
    /// Instants of the basic cycle at which it is released, in microseconds.
    #[serde(default)]
    pub at_us: Several<u64>,
    /// A message of this node that depends on others (attribute `After`). The task is released at
    /// the instant of the basic cycle at which these have arrived ([`Table::resolve`]).
    pub at: Option<String>,
    /// The task that releases this one. Its response time is this one's release jitter.
    pub after: Option<String>,
    /// Who else makes it pending, by name: tasks of the node, this one included, [`INIT`] or
    /// [`IDLE`]. Their pends are releases in addition to those above.
    #[serde(default)]
    pub pended_by: BTreeMap<String, PendedBy>,
    /// True if it is released only while the node is off the bus.
    #[serde(default)]
    pub off_bus: bool,
    /// Messages that its jobs put, each at most once in a job and in this order. An event-triggered
    /// bus needs it for every cyclic message.
    #[serde(default)]
    pub sends: Several<String>,
    /// The entry in place of this one when the bus is event-triggered.
    pub event: Option<Box<TaskTable>>,
    /// Least time between any two of its releases, whatever causes them, in microseconds; before the
    /// jitter.
    pub apart_us: Option<u64>,
    /// Deadline after the release, in microseconds. Either this or `by` is given; or both, and this
    /// one is for the releases at any time, `by` for those at instants of the basic cycle.
    pub deadline_us: Option<u64>,
    /// Deadline that follows from the network file.
    pub by: Option<By>,
    /// Release jitter: how much later than its nominal instant it may be released, in
    /// microseconds.
    #[serde(default)]
    pub jitter_us: u64,
    /// Priority of a handler that no task of the source is bound to; 1 is the lowest, and 16, which
    /// a handler has after a reset, the highest. The row is named like the handler's symbol.
    pub priority: Option<u32>,
}

/// Name of the start-up code under `pended_by`.
pub const INIT: &str = "init";

/// Name of the idle code under `pended_by`.
pub const IDLE: &str = "idle";

/// Period that stands for a release that comes only once, in picoseconds.
pub const ONCE: u64 = 1 << 60;

/// How often a task is made pending by another one, or by itself.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(
    untagged,
    expecting = "`pended_by` takes \"each\", \"once\" or { every_us = N, because = \"...\" }"
)]
pub enum PendedBy {
    /// As often as that one runs.
    Run(Run),
    /// Less often than that one runs, for a reason.
    Bounded(Bounded),
}

/// How often code runs that makes a task pending.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Run {
    /// Each job may make it pending: all releases of that task count, each until that task's
    /// deadline.
    Each,
    /// Once: the start-up code.
    Once,
}

/// A bound of pends that follows from what the program does.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Bounded {
    /// Least time between two pends, in microseconds; one value for each independent cause.
    #[serde(default)]
    pub every_us: Several<u64>,
    /// Pends whose distance follows from other files. Without this and `every_us`, the pends are
    /// among the other releases of the task.
    #[serde(default)]
    pub every: Several<Every>,
    /// Why. It stands among the assumptions of the report.
    pub because: String,
}

/// A delay after a message.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Delay {
    /// In microseconds.
    Us(u64),
    /// Until the second frame after the last one of this message is overdue.
    Overdue(String),
}

/// Releases whose distance follows from other files of the vehicle's folder.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Every {
    /// The node's bus-off. It lasts [`BUS_OFF_BITS`] or longer at the network's bit rate.
    BusOff,
    /// Frames of the satellite receiver, which sends one burst of them in each of its periods.
    ReceiverBurst(Burst),
    /// Each overflow of a timer with this frequency.
    TimerHz(NonZeroU32),
    /// The sporadic releases of another task of the same node.
    Task(String),
}

/// The frames of a burst.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Burst {
    /// The most of them.
    pub jobs: u64,
    /// Least time between two of them, in microseconds.
    pub apart_us: u64,
}

/// Shortest bus-off, in bit times: 128 times eleven recessive bits (ISO 11898-1).
pub const BUS_OFF_BITS: u64 = 128 * 11;

/// One value or a list.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(untagged, expecting = "one value or a list of them is accepted")]
pub enum Several<T> {
    /// One.
    One(T),
    /// Any number.
    Many(Vec<T>),
}

impl<T> Default for Several<T> {
    fn default() -> Self {
        Self::Many(Vec::new())
    }
}

impl<T> Several<T> {
    /// As a slice.
    pub fn as_slice(&self) -> &[T] {
        match self {
            Self::One(one) => std::slice::from_ref(one),
            Self::Many(many) => many,
        }
    }
}

/// A bus event that releases a task. The network file says when it may occur.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BusEvent {
    /// The end of every frame of another node.
    FrameReceived,
    /// The end of every frame of this node.
    FrameSent,
    /// Every begin and end of a window, and the end of the transmit enable window in this
    /// node's windows.
    WindowEdge,
    /// Every event message that this node enqueues.
    EventQueued,
}

/// A deadline that follows from the network file.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// The end of the window in which the frame ended, or the overrun of the three-deep
    /// receive FIFO (the end of the fourth frame), whichever is earlier.
    WindowEnd,
    /// At a window edge: the end of the next frame that another node may send. Where one of
    /// this node's windows begins: the end of the transmit enable window. Otherwise: the
    /// overrun of the receive FIFO.
    Window,
    /// The begin of this message's window, counted from the task's release in the basic
    /// cycle.
    Message(String),
}

/// A chain of tasks and messages with an end-to-end deadline.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chain {
    /// Name in reports.
    pub name: String,
    /// Deadline from the first event to the last effect, in microseconds.
    pub deadline_us: u64,
    /// The same if a burst of errors destroys frames of the chain in their exclusive windows;
    /// `deadline_us` if it is left out.
    pub lost_deadline_us: Option<u64>,
    /// Instant of the basic cycle at which the first event occurs, in microseconds. Without it the
    /// first event may occur at any time.
    pub from_us: Option<u64>,
    /// Steps in order.
    pub steps: Vec<Step>,
}

/// One step of a chain.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Step {
    /// A task, as `node.task`.
    pub task: Option<String>,
    /// A message of the network file.
    pub message: Option<String>,
    /// Something outside the analysis (a byte on a wire, a poll).
    pub other: Option<String>,
    /// The task is released at this instant of the basic cycle, in microseconds.
    pub at_us: Option<u64>,
    /// The message whose inputs release the task, as in [`TaskTable::at`].
    pub at: Option<String>,
    /// The protocol of the bus with which the step is part of the chain; with both if left out.
    pub only: Option<Protocol>,
    /// Longest wait before the step that the analysis does not cover (a poll, a filter, a
    /// byte on a wire), in microseconds.
    #[serde(default)]
    pub wait_us: u64,
}

/// A protocol of the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Protocol {
    /// By the schedule of the network file.
    TimeTriggered,
    /// Each message at once.
    EventTriggered,
}

impl Table {
    /// Reads the table.
    ///
    /// # Errors
    /// The text is no TOML, or says something impossible.
    pub fn parse(file: &str, text: &str) -> Result<Self, TableError> {
        Self::checked(text).map_err(|(line, fault)| TableError {
            file: file.to_owned(),
            line,
            fault,
        })
    }

    /// Puts in the times that follow from other files: those of the messages that `at` and
    /// `delay` name, and the distances of the releases in `every`. `receiver_period_us` is the
    /// time between two bursts of the satellite receiver; `None` if the vehicle has no receiver.
    ///
    /// # Errors
    /// `at` names a message that depends on no other one, `delay` one that is not there,
    /// `every` a task or a receiver that is not there, or a step of a chain a task or a message
    /// that is not there.
    pub fn resolve(
        mut self,
        file: &str,
        network: &Network,
        receiver_period_us: Option<u64>,
    ) -> Result<Self, TableError> {
        let release = |name: &String| {
            let mut messages = network.messages.iter();
            messages
                .find(|message| message.name == *name)
                .and_then(|message| network.release_us(message))
                .map(u64::from)
                .ok_or_else(|| TableError {
                    file: file.to_owned(),
                    line: None,
                    fault: TableFault::At(name.clone()),
                })
        };
        let overdue = |name: &String| {
            let mut messages = network.messages.iter();
            let message = messages.find(|message| message.name == *name);
            let us = message.map(|message| u64::from(network.overdue_us(message)));
            us.ok_or_else(|| TableError {
                file: file.to_owned(),
                line: None,
                fault: TableFault::Overdue(name.clone()),
            })
        };
        for (node, of_node) in &mut self.node {
            of_node
                .derive(network, receiver_period_us)
                .map_err(|(task, fault)| TableError {
                    file: file.to_owned(),
                    line: None,
                    fault: TableFault::Task {
                        task,
                        node: node.clone(),
                        fault: Box::new(fault),
                    },
                })?;
        }
        let nodes = self.node.values_mut();
        for task in nodes.flat_map(|node| node.task.values_mut()) {
            if let Some(name) = &task.at {
                let mut instants = task.at_us.as_slice().to_vec();
                instants.push(release(name)?);
                task.at_us = Several::Many(instants);
            }
            if let Some(Delay::Overdue(name)) = &task.delay {
                self.supervised.insert(name.clone());
                task.delay = Some(Delay::Us(overdue(name)?));
            }
        }
        self.steps(network).map_err(|fault| TableError {
            file: file.to_owned(),
            line: None,
            fault,
        })?;
        for step in self.chain.iter_mut().flat_map(|chain| &mut chain.steps) {
            if let Some(name) = &step.at {
                step.at_us = Some(release(name)?);
            }
        }
        Ok(self)
    }

    /// The table for this protocol of the bus. Call this before [`Table::resolve`].
    ///
    /// # Errors
    /// On an event-triggered bus, only the schedule releases a task or gives it a deadline.
    pub fn with_protocol(mut self, file: &str, protocol: Protocol) -> Result<Self, TableError> {
        for chain in &mut self.chain {
            let part = |step: &Step| step.only.is_none_or(|only| only == protocol);
            chain.steps.retain(part);
        }
        match protocol {
            Protocol::TimeTriggered => Ok(self),
            Protocol::EventTriggered => self.event_triggered(file),
        }
    }

    /// The table for an event-triggered bus: an entry `event` replaces the one that it is in, and
    /// instants of the basic cycle mean nothing.
    ///
    /// # Errors
    /// Only the schedule releases a task or gives it a deadline.
    fn event_triggered(mut self, file: &str) -> Result<Self, TableError> {
        for (node, of_node) in &mut self.node {
            for (name, task) in &mut of_node.task {
                if let Some(event) = task.event.take() {
                    let priority = task.priority;
                    *task = *event;
                    task.priority = task.priority.or(priority);
                }
                task.at = None;
                task.at_us = Several::default();
                let by_window = matches!(task.by, Some(By::Message(_)));
                if by_window || task.check().is_err() {
                    return Err(TableError {
                        file: file.to_owned(),
                        line: None,
                        fault: TableFault::Task {
                            task: name.clone(),
                            node: node.clone(),
                            fault: Box::new(TaskFault::Scheduled),
                        },
                    });
                }
            }
        }
        for chain in &mut self.chain {
            for step in &mut chain.steps {
                (step.at, step.at_us) = (None, None);
            }
        }
        Ok(self)
    }

    /// Checks that all tasks and messages exist that the steps of the chains name.
    fn steps(&self, network: &Network) -> Result<(), TableFault> {
        for chain in &self.chain {
            for (index, step) in chain.steps.iter().enumerate() {
                self.step(step, network)
                    .map_err(|fault| TableFault::Chain {
                        chain: chain.name.clone(),
                        step: index + 1,
                        fault: Box::new(fault),
                    })?;
            }
        }
        Ok(())
    }

    fn step(&self, step: &Step, network: &Network) -> Result<(), StepFault> {
        if let Some(task) = &step.task {
            let (node, name) = task
                .split_once('.')
                .ok_or_else(|| StepFault::Form(task.clone()))?;
            let of_node = self.node.get(node).ok_or_else(|| StepFault::Node {
                task: task.clone(),
                known: self.node.keys().cloned().collect(),
            })?;
            if !of_node.task.contains_key(name) {
                return Err(StepFault::Task {
                    task: task.clone(),
                    node: node.to_owned(),
                    known: of_node.task.keys().cloned().collect(),
                });
            }
        }
        let names = || network.messages.iter().map(|message| &message.name);
        match &step.message {
            Some(message) if !names().any(|name| name == message) => Err(StepFault::Message {
                message: message.clone(),
                known: names().cloned().collect(),
            }),
            _ => Ok(()),
        }
    }

    fn checked(text: &str) -> Result<Self, (Option<usize>, TableFault)> {
        let table: Self = toml::from_str(text).map_err(|error| {
            let line = error
                .span()
                .map(|span| 1 + text[..span.start].matches('\n').count());
            (line, TableFault::Toml(one_line(&error)))
        })?;
        table.check().map_err(|fault| (None, fault))?;
        Ok(table)
    }

    fn check(&self) -> Result<(), TableFault> {
        for (node, of_node) in &self.node {
            for (unit, rate) in &of_node.dma {
                rate.check().map_err(|number| TableFault::Number {
                    of: format!("{unit} of {node}"),
                    number,
                })?;
            }
            for (name, task) in &of_node.task {
                task.check().map_err(|fault| TableFault::Task {
                    task: name.clone(),
                    node: node.clone(),
                    fault: Box::new(fault),
                })?;
            }
        }
        for (place, bound) in &self.bounds {
            bound.check().map_err(|fault| TableFault::Bound {
                place: place.clone(),
                fault,
            })?;
        }
        let is_known = |name: &String| {
            self.node.contains_key(name) || self.chain.iter().any(|chain| chain.name == *name)
        };
        if let Some(unknown) = self.unproven.iter().find(|name| !is_known(name)) {
            return Err(TableFault::Unproven(unknown.clone()));
        }
        let within = |of: String, field, value: u64, least: u64, most: u64| {
            let checked = OutOfRange::check(field, value, least, most);
            checked.map_err(|number| TableFault::Number { of, number })
        };
        let accept = |of: String, field, value: u64, most: u64| within(of, field, value, 0, most);
        let bus = || "[bus]".to_owned();
        let BusTable {
            error_burst,
            error_interval_ms: interval,
        } = self.bus;
        accept(bus(), "error_burst", error_burst, MOST_ERRORS)?;
        let least = error_burst.min(1);
        within(
            bus(),
            "error_interval_ms",
            interval,
            least,
            LONGEST_INTERVAL_MS,
        )?;
        for chain in &self.chain {
            let of = || format!("chain `{}`", chain.name);
            accept(of(), "deadline_us", chain.deadline_us, LONGEST_US)?;
            let lost = chain.lost_deadline_us.unwrap_or(0);
            accept(of(), "lost_deadline_us", lost, LONGEST_US)?;
            accept(of(), "from_us", chain.from_us.unwrap_or(0), LONGEST_US)?;
            for step in &chain.steps {
                accept(of(), "wait_us", step.wait_us, LONGEST_US)?;
                accept(of(), "at_us", step.at_us.unwrap_or(0), LONGEST_US)?;
                let kinds = [&step.task, &step.message, &step.other];
                if kinds.into_iter().flatten().count() != 1 {
                    return Err(TableFault::Step(chain.name.clone()));
                }
            }
        }
        Ok(())
    }
}

impl TaskTable {
    /// The releases of `every_us`.
    fn periodic(&self) -> impl Iterator<Item = Sporadic> {
        periodic(&self.every_us)
    }

    /// All its sporadic releases; `None` before [`Table::resolve`].
    #[must_use]
    pub fn sporadic(&self) -> Option<Vec<Sporadic>> {
        let resolved = self.every.as_slice().is_empty();
        resolved.then(|| {
            self.periodic()
                .chain(self.derived.iter().copied())
                .collect()
        })
    }

    /// Least time between any two of its releases; zero if the table does not say it.
    #[must_use]
    pub fn apart(&self) -> Picoseconds {
        self.apart_us.unwrap_or(0) * MICROSECOND
    }

    /// Checks that its numbers are in range.
    fn numbers(&self) -> Result<(), TaskFault> {
        let accept = |field, value: u64, least: u64, most: u64| {
            OutOfRange::check(field, value, least, most).map_err(TaskFault::Number)
        };
        let stated = self.pended_by.values().map(PendedBy::distances);
        let stated = stated.chain([(self.every_us.as_slice(), self.every.as_slice())]);
        for (every_us, every) in stated {
            for every in every_us {
                accept("every_us", *every, 1, LONGEST_US)?;
            }
            for every in every {
                if let Every::ReceiverBurst(burst) = every {
                    accept("jobs", burst.jobs, 1, MOST)?;
                    accept("apart_us", burst.apart_us, 1, LONGEST_US)?;
                }
            }
        }
        for at in self.at_us.as_slice() {
            accept("at_us", *at, 0, LONGEST_US)?;
        }
        accept("priority", u64::from(self.priority.unwrap_or(1)), 1, 16)?;
        accept("jitter_us", self.jitter_us, 0, LONGEST_US)?;
        accept("apart_us", self.apart_us.unwrap_or(1), 1, LONGEST_US)?;
        accept("deadline_us", self.deadline_us.unwrap_or(0), 0, LONGEST_US)?;
        if let Some(Delay::Us(us)) = self.delay {
            accept("delay", us, 0, LONGEST_US)?;
        }
        Ok(())
    }

    fn check(&self) -> Result<(), TaskFault> {
        let releases = self.every_us.as_slice().len()
            + self.every.as_slice().len()
            + self.on.as_slice().len()
            + self.receives.as_slice().len()
            + self.at_us.as_slice().len()
            + self.pended_by.values().filter(|one| one.adds()).count()
            + usize::from(self.at.is_some());
        if releases == 0 || self.every_us.as_slice().contains(&0) {
            return Err(TaskFault::NoRelease);
        }
        self.numbers()?;
        for (pender, pended) in &self.pended_by {
            pended.check(pender)?;
        }
        if let Some(event) = &self.event {
            if event.event.is_some() {
                return Err(TaskFault::Nested);
            }
            event.check()?;
        }
        let instants = self.at_us.as_slice().len() + usize::from(self.at.is_some());
        let at_any_time = self.every_us.as_slice().len() + self.every.as_slice().len();
        let accepted = match (self.deadline_us, &self.by) {
            (None, None) => false,
            (Some(_), Some(by)) => matches!(by, By::Message(_)) && instants > 0 && at_any_time > 0,
            _ => true,
        };
        if !accepted {
            return Err(TaskFault::Deadline);
        }
        if matches!(self.by, Some(By::Message(_))) && instants == 0 {
            return Err(TaskFault::NoInstant);
        }
        Ok(())
    }
}

/// Releases with these least distances, in microseconds.
fn periodic(every_us: &Several<u64>) -> impl Iterator<Item = Sporadic> {
    let every = every_us.as_slice().iter();
    every.map(|us| Sporadic::every(us * MICROSECOND))
}

impl Bounded {
    /// How often, for sentences.
    #[must_use]
    pub fn often(&self) -> String {
        let periods = self.every_us.as_slice().iter();
        let causes = self.every.as_slice().iter().map(|every| match every {
            Every::BusOff => "once in a bus-off".to_owned(),
            Every::ReceiverBurst(burst) => {
                format!("{} times in a burst of the receiver", burst.jobs)
            }
            Every::TimerHz(hz) => format!("{hz} times a second"),
            Every::Task(task) => format!("once for a release of {task}"),
        });
        let all: Vec<String> = periods
            .map(|us| format!("once in {us} us"))
            .chain(causes)
            .collect();
        match all.as_slice() {
            [] => "only where the task table has a release of it anyway".to_owned(),
            all => format!("at most {}", all.join(" and ")),
        }
    }
}

impl PendedBy {
    /// Whether it adds releases to those of the pended task.
    fn adds(&self) -> bool {
        let (every_us, every) = self.distances();
        matches!(self, Self::Run(_)) || !every_us.is_empty() || !every.is_empty()
    }

    /// Checks what the table says of `pender`.
    ///
    /// # Errors
    /// `pender` runs more than once or has no jobs, or the bound has no reason.
    pub fn check(&self, pender: &str) -> Result<(), TaskFault> {
        let wrong = |run| Err(TaskFault::Run(pender.to_owned(), run));
        match self {
            Self::Run(Run::Each) if [INIT, IDLE].contains(&pender) => wrong("each"),
            Self::Run(Run::Once) if pender != INIT => wrong("once"),
            Self::Bounded(bounded) if bounded.because.trim().is_empty() => {
                Err(TaskFault::NoReason(pender.to_owned()))
            }
            Self::Run(_) | Self::Bounded(_) => Ok(()),
        }
    }

    /// The distances that it states.
    fn distances(&self) -> (&[u64], &[Every]) {
        match self {
            Self::Run(_) => (&[], &[]),
            Self::Bounded(bounded) => (bounded.every_us.as_slice(), bounded.every.as_slice()),
        }
    }
}

fn one_line(error: &toml::de::Error) -> String {
    error.message().lines().collect::<Vec<_>>().join(" ")
}
