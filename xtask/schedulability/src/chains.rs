//! Times from end to end, across tasks and messages.
//!
//! A chain is followed with two clocks: how long ago its first event was, and
//! where in the basic cycle the last step ends at the latest. The second is
//! known from the first window or time mark on; before that, a step that must
//! wait for the cycle may have just missed it.

use crate::results::{
    ChainReport, MICROSECOND, MessageReport, NodeReport, Picoseconds, StepReport,
};
use crate::system::InputError;
use crate::table::{Chain, Step};

/// Follows a chain; `None` when one of its nodes is not among `nodes`.
///
/// # Errors
/// A step names a task or a message that is nowhere.
pub fn follow(
    chain: &Chain,
    nodes: &[NodeReport],
    messages: &[MessageReport],
    cycle: Picoseconds,
) -> Result<Option<ChainReport>, InputError> {
    let mut clock = Clock {
        cycle,
        total: Some(0),
        phase: None,
    };
    let mut steps = Vec::new();
    for step in &chain.steps {
        let wrong = |what: String| InputError(format!("chain `{}`: {what}", chain.name));
        clock.pass(step.wait_us * MICROSECOND);
        let name = if let Some(task) = &step.task {
            let (node, name) = task
                .split_once('.')
                .ok_or_else(|| wrong(format!("`{task}` is not of the form node.task")))?;
            let Some(node) = nodes.iter().find(|n| n.name == node) else {
                return Ok(None);
            };
            let task_report = node
                .tasks
                .iter()
                .find(|t| t.name == name)
                .ok_or_else(|| wrong(format!("there is no task {task}")))?;
            clock.task(
                step,
                task_report.response.filter(|_| task_report.is_bounded()),
            );
            task.clone()
        } else if let Some(message) = &step.message {
            let report = messages
                .iter()
                .find(|m| m.name == *message)
                .ok_or_else(|| wrong(format!("there is no message {message}")))?;
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

struct Clock {
    cycle: Picoseconds,
    /// Since the first event.
    total: Option<Picoseconds>,
    /// In the basic cycle.
    phase: Option<Picoseconds>,
}

impl Clock {
    fn pass(&mut self, time: Picoseconds) {
        self.total = self.total.map(|total| total + time);
        self.phase = self.phase.map(|phase| phase + time);
    }

    /// Waits for this instant of the basic cycle.
    fn until(&mut self, at: Picoseconds) {
        let wait = match self.phase {
            // Both lie in the cycle: the next one may be a cycle away.
            Some(phase) => (at + self.cycle - phase % self.cycle) % self.cycle,
            // Just missed.
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
            // Its window may have just begun without it.
            self.phase = None;
        }
        self.until(message.start);
        match message.need {
            Some(need) => self.pass(need),
            None => self.total = None,
        }
    }
}
