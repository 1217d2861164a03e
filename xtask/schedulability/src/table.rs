//! The task table: what the sources cannot say.
//!
//! One file for all nodes, `firmware/tasks.toml`: for each task how often it
//! may be released and by when it must be done, and the chains of tasks and
//! messages that have a deadline of their own.

use std::collections::BTreeMap;

use serde::Deserialize;

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
    /// Minimum time between releases, in microseconds; or `on`.
    pub every_us: Option<u64>,
    /// What on the bus releases it.
    pub on: Option<BusEvent>,
    /// Deadline after the release, in microseconds.
    pub deadline_us: u64,
    /// How much later than its nominal instant it may be released.
    #[serde(default)]
    pub jitter_us: u64,
}

/// What on the bus releases a task; its rate follows from the network file.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum BusEvent {
    /// Every frame of another node.
    FrameReceived,
    /// Every frame of the node's own.
    FrameSent,
    /// Every begin and end of a window.
    WindowEdge,
    /// Once in each basic cycle.
    BasicCycle,
}

/// A chain of tasks and messages with a deadline from end to end.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Chain {
    /// Name in reports.
    pub name: String,
    /// Deadline from the first event to the last effect, in microseconds.
    pub deadline_us: u64,
    /// Steps in order: `node.task`, or the name of a message.
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
        let table: Self =
            toml::from_str(text).map_err(|error| format!("{file}: {}", one_line(&error)))?;
        for (node, of_node) in &table.node {
            for (task, of_task) in &of_node.task {
                if of_task.every_us.is_some() == of_task.on.is_some() || of_task.every_us == Some(0)
                {
                    return Err(format!(
                        "{file}: task {task} of {node} needs either `every_us` above zero or `on`"
                    ));
                }
            }
        }
        for chain in &table.chain {
            for step in &chain.steps {
                if step.task.is_some() == step.message.is_some() {
                    return Err(format!(
                        "{file}: each step of chain `{}` is either a `task` or a `message`",
                        chain.name
                    ));
                }
            }
        }
        Ok(table)
    }
}

fn one_line(error: &toml::de::Error) -> String {
    error.message().lines().collect::<Vec<_>>().join(" ")
}
