//! The task table: what the sources cannot say.
//!
//! One file for all nodes, `firmware/vehicles/uagv/tasks.toml`: for each task what releases it
//! and by when it must be done, and the chains of tasks and messages that have a
//! deadline of their own.

use std::collections::BTreeMap;

use serde::Deserialize;

use crate::arrivals::Kind;

/// The task table.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Table {
    /// Nodes by the names of their images.
    pub node: BTreeMap<String, NodeTable>,
    /// Chains across nodes.
    #[serde(default)]
    pub chain: Vec<Chain>,
    /// Errors on the bus that the analysis allows for.
    #[serde(default)]
    pub bus: BusTable,
    /// Nodes and chains that are not proven yet: they make the command fail, but
    /// not continuous integration.
    #[serde(default)]
    pub unproven: Vec<String>,
}

/// Rate of errors on the bus.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BusTable {
    /// Errors that may come at once.
    #[serde(default)]
    pub error_burst: u64,
    /// Least time between further errors, in milliseconds; zero for none.
    #[serde(default)]
    pub error_interval_ms: u64,
}

/// One node.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NodeTable {
    /// The part and its flash.
    pub part: Part,
    /// Lowest rate at which the core runs, in Hz.
    pub core_hz: u64,
    /// Bytes set aside for the stack.
    pub stack: u32,
    /// How long before its mark the node begins a transmission, microseconds.
    pub transmit_lead_us: u64,
    /// Tasks by name; `SysTick` for the timer of the software tasks.
    pub task: BTreeMap<String, TaskTable>,
}

/// Parts that the flash timing is known of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// STM32F446 at 180 MHz.
    F446,
    /// STM32F303x8 at 72 MHz.
    F303,
}

/// One task.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskTable {
    /// Least time between two releases, in microseconds; several when there are
    /// several causes.
    #[serde(default)]
    pub every_us: Several<u64>,
    /// Fewer in a longer time than `every_us` alone would allow.
    pub at_most: Option<AtMost>,
    /// What on the bus releases it.
    #[serde(default)]
    pub on: Several<BusEvent>,
    /// Messages of other nodes whose arrival releases it.
    #[serde(default)]
    pub receives: Several<String>,
    /// How long after these messages were taken it is released.
    #[serde(default)]
    pub delay_us: u64,
    /// Functions that its jobs of a kind never call: their bound is another.
    #[serde(default)]
    pub never: BTreeMap<Kind, Vec<String>>,
    /// Times of the basic cycle at which it is released, in microseconds.
    #[serde(default)]
    pub at_us: Several<u64>,
    /// The task that releases it: its response is this one's jitter.
    pub after: Option<String>,
    /// Whether it is released only while the node is off the bus.
    #[serde(default)]
    pub off_bus: bool,
    /// Deadline after the release, in microseconds; or `by`.
    pub deadline_us: Option<u64>,
    /// Deadline that the network file gives.
    pub by: Option<By>,
    /// How much later than its nominal instant it may be released.
    #[serde(default)]
    pub jitter_us: u64,
}

/// A limit to the releases in a longer time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AtMost {
    /// So many releases.
    pub jobs: u64,
    /// In any window of so many microseconds.
    pub in_us: u64,
}

/// One or a list.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
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

/// What on the bus releases a task; when that may be follows from the network
/// file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BusEvent {
    /// Every frame of another node.
    FrameReceived,
    /// Every frame of the node's own.
    FrameSent,
    /// Every begin and end of a window, and the end of the transmit enable
    /// window of the node's own.
    WindowEdge,
    /// Every event message that the node itself puts in line.
    EventQueued,
}

/// A deadline that the network file gives.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum By {
    /// Before the window is closed in which the frame ended, and before the
    /// three-deep receive FIFO overruns: the fourth frame ends.
    WindowEnd,
    /// At an edge of a window, before the end of the next frame that another node
    /// may begin; where a window of the node's own begins, before the transmit
    /// enable window ends; else before the receive FIFO overruns.
    Window,
    /// Before the window of this message begins, counted from the task's time
    /// of the basic cycle.
    Message(String),
}

/// A chain of tasks and messages with a deadline from end to end.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chain {
    /// Name in reports.
    pub name: String,
    /// Deadline from the first event to the last effect, in microseconds.
    pub deadline_us: u64,
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
    /// Something that the analysis does not know (a byte on a wire, a poll).
    pub other: Option<String>,
    /// The task is released at this time of the basic cycle.
    pub at_us: Option<u64>,
    /// Longest wait before the step, beyond what the analysis knows (a poll,
    /// a filter, a byte on a wire), in microseconds.
    #[serde(default)]
    pub wait_us: u64,
}

impl Table {
    /// Reads the table.
    ///
    /// # Errors
    /// One sentence that says where and what.
    pub fn parse(file: &str, text: &str) -> Result<Self, String> {
        let table: Self = toml::from_str(text).map_err(|error| {
            let line = error
                .span()
                .map(|span| 1 + text[..span.start].matches('\n').count());
            match line {
                Some(line) => format!("{file}:{line}: {}", one_line(&error)),
                None => format!("{file}: {}", one_line(&error)),
            }
        })?;
        for (node, of_node) in &table.node {
            if of_node.core_hz == 0 {
                return Err(format!("{file}: core_hz of {node} is zero"));
            }
            for (name, task) in &of_node.task {
                task.check()
                    .map_err(|what| format!("{file}: task {name} of {node} {what}"))?;
            }
        }
        if let Some(unknown) = table.unproven.iter().find(|name| {
            !table.node.contains_key(*name) && !table.chain.iter().any(|c| c.name == **name)
        }) {
            return Err(format!(
                "{file}: `unproven` names {unknown}, which is neither a node nor a chain"
            ));
        }
        for chain in &table.chain {
            for step in &chain.steps {
                let kinds = [&step.task, &step.message, &step.other];
                if kinds.into_iter().flatten().count() != 1 {
                    return Err(format!(
                        "{file}: each step of chain `{}` is either a `task`, a `message` or `other`",
                        chain.name
                    ));
                }
            }
        }
        Ok(table)
    }
}

impl TaskTable {
    fn check(&self) -> Result<(), &'static str> {
        let releases = self.every_us.as_slice().len()
            + self.on.as_slice().len()
            + self.receives.as_slice().len()
            + self.at_us.as_slice().len();
        if releases == 0 || self.every_us.as_slice().contains(&0) {
            return Err(
                "does not say what releases it: `every_us` above zero, `on`, `receives` or `at_us`",
            );
        }
        if self
            .at_most
            .is_some_and(|most| most.jobs == 0 || most.in_us == 0)
        {
            return Err("has `at_most` with a zero");
        }
        if self.deadline_us.is_some() == self.by.is_some() {
            return Err("needs either `deadline_us` or `by`");
        }
        if matches!(self.by, Some(By::Message(_))) && self.at_us.as_slice().is_empty() {
            return Err("has a deadline by a message but no time of the basic cycle: `at_us`");
        }
        Ok(())
    }
}

fn one_line(error: &toml::de::Error) -> String {
    error.message().lines().collect::<Vec<_>>().join(" ")
}
