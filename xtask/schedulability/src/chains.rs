//! End-to-end times across tasks and messages.
//!
//! Two clocks follow a chain: the time since its first event, and the phase, which is the
//! latest instant of the basic cycle at which the last step ends. The phase is known from the
//! first window or time mark on. Before that, a step that waits for an instant of the cycle
//! may have just missed it and is charged a whole cycle.

use crate::results::{ChainReport, MessageReport, NodeReport, StepReport};
use crate::table::{Chain, Step};
use crate::units::{MICROSECOND, Picoseconds};

/// A chain names something that does not exist.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("chain `{chain}`: {fault}")]
pub struct ChainError {
    /// The chain.
    pub chain: String,
    /// What is wrong with one of its steps.
    pub fault: StepFault,
}

/// What can be wrong with a step of a chain.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum StepFault {
    /// Its task has no node.
    #[error("`{0}` is not of the form node.task")]
    Form(String),
    /// There is no such task.
    #[error("there is no task {0}")]
    NoTask(String),
    /// There is no such message.
    #[error("there is no message {0}")]
    NoMessage(String),
}

/// The end-to-end time of a chain; `None` if one of its nodes is not among `nodes`.
///
/// # Errors
/// A step names a task or a message that does not exist.
pub fn follow(
    chain: &Chain,
    nodes: &[NodeReport],
    messages: &[MessageReport],
    cycle: Picoseconds,
) -> Result<Option<ChainReport>, ChainError> {
    let mut clock = Clock {
        cycle,
        total: Some(0),
        phase: None,
    };
    let mut steps = Vec::new();
    for step in &chain.steps {
        let wrong = |fault: StepFault| ChainError {
            chain: chain.name.clone(),
            fault,
        };
        clock.pass(step.wait_us * MICROSECOND);
        let name = if let Some(task) = &step.task {
            let (node, name) = task
                .split_once('.')
                .ok_or_else(|| wrong(StepFault::Form(task.clone())))?;
            let Some(node) = nodes.iter().find(|n| n.name == node) else {
                return Ok(None);
            };
            let task_report = node
                .tasks
                .iter()
                .find(|t| t.name == name)
                .ok_or_else(|| wrong(StepFault::NoTask(task.clone())))?;
            clock.task(
                step,
                task_report.response.filter(|_| task_report.is_bounded()),
            );
            task.clone()
        } else if let Some(message) = &step.message {
            let report = messages
                .iter()
                .find(|m| m.name == *message)
                .ok_or_else(|| wrong(StepFault::NoMessage(message.clone())))?;
            clock.message(report);
            message.clone()
        } else {
            step.other.clone().unwrap_or_default()
        };
        steps.push(StepReport {
            name,
            done: clock.total,
            phase: clock.phase.map(|phase| phase % cycle.max(1)),
        });
    }
    Ok(Some(ChainReport {
        name: chain.name.clone(),
        steps,
        latency: clock.total,
        deadline: chain.deadline_us * MICROSECOND,
    }))
}

/// The two clocks; see the module.
struct Clock {
    /// Length of the basic cycle.
    cycle: Picoseconds,
    /// Longest time since the first event; `None` once a step has no bound.
    total: Option<Picoseconds>,
    /// Latest instant of the basic cycle, if it is known.
    phase: Option<Picoseconds>,
}

impl Clock {
    fn pass(&mut self, time: Picoseconds) {
        self.total = self.total.map(|total| total + time);
        self.phase = self.phase.map(|phase| phase + time);
    }

    /// Waits for the instant `at` of the basic cycle.
    fn until(&mut self, at: Picoseconds) {
        let wait = match self.phase {
            // The next such instant, which may be up to a cycle away.
            Some(phase) => (at + self.cycle - phase % self.cycle) % self.cycle,
            // The phase is unknown, so the instant may have just passed.
            None => self.cycle,
        };
        self.pass(wait);
        self.phase = Some(at);
    }

    fn task(&mut self, step: &Step, response: Option<Picoseconds>) {
        if let Some(at) = step.at_us {
            self.until(at * MICROSECOND);
        }
        match response {
            Some(response) => self.pass(response),
            None => self.total = None,
        }
    }

    fn message(&mut self, message: &MessageReport) {
        if message.arbitrating {
            // An event message may be enqueued just after its window has begun, and then
            // waits for the next one.
            self.phase = None;
        }
        self.until(message.start);
        match message.need {
            Some(need) => self.pass(need),
            None => self.total = None,
        }
    }
}
