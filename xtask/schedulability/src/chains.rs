//! End-to-end times across tasks and messages.
//!
//! Two clocks follow a chain: the time since its first event, and the phase, which is the
//! latest instant of the basic cycle at which the last step ends. The phase is known from the
//! begin of a chain that begins at an instant of the cycle, else from the first window or time mark
//! on. Before that, a step that waits for an instant of the cycle may have just missed it and is
//! charged a whole cycle. Without a schedule nothing waits for an instant, and a chain takes the sum
//! of its steps.

use crate::results::{ChainReport, MessageReport, NodeReport, StepReport};
use crate::table::{Chain, Step};
use crate::units::{MICROSECOND, Picoseconds};

/// The end-to-end time of a chain of a resolved table ([`crate::table::Table::resolve`]); `None`
/// if one of its nodes is not among `nodes`.
#[must_use]
pub fn follow(
    chain: &Chain,
    nodes: &[NodeReport],
    messages: &[MessageReport],
    cycle: Picoseconds,
) -> Option<ChainReport> {
    let mut clock = Clock {
        cycle,
        total: Some(0),
        phase: chain.from_us.map(|from| from * MICROSECOND),
    };
    let mut steps = Vec::new();
    for step in &chain.steps {
        clock.pass(step.wait_us * MICROSECOND);
        let name = if let Some(task) = &step.task {
            let (node, name) = task.split_once('.')?;
            let report = nodes.iter().find(|report| report.name == node)?;
            let report = report.tasks.iter().find(|task| task.name == name)?;
            clock.task(step, report.response.filter(|_| report.is_bounded()));
            task.clone()
        } else if let Some(message) = &step.message {
            let report = messages.iter().find(|m| m.name == *message)?;
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
    Some(ChainReport {
        name: chain.name.clone(),
        steps,
        latency: clock.total,
        deadline: chain.deadline_us * MICROSECOND,
    })
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
        if let Some(start) = message.start {
            self.until(start);
        }
        match message.need {
            Some(need) => self.pass(need),
            None => self.total = None,
        }
    }
}
