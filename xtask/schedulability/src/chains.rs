//! End-to-end times across tasks and messages.
//!
//! Two clocks follow a chain: the time since its first event, and the phase, which is the
//! latest instant of the basic cycle at which the last step ends. The phase is known from the
//! begin of a chain that begins at an instant of the cycle, else from the first window or time mark
//! on. Before that, a step that waits for an instant of the cycle may have just missed it and is
//! charged a whole cycle. Without a schedule nothing waits for an instant, and a chain takes the sum
//! of its steps.
//!
//! # Disturbed frames
//! Each error may make one basic cycle begin later by the time to repeat its reference, and a chain that
//! waits for an instant of a cycle waits that much longer ([`Errors::late`]): the last step of its report. Response times and messages
//! have their errors in them.
//!
//! A frame that is destroyed in an exclusive window is not late but absent: its data never arrive, and those
//! of the next cycle take their place. Each error of a burst costs one period of the message at most, because
//! it destroys one frame. Where errors hit the chain again and again, no end-to-end time bounds it; its
//! receivers notice that ([`network_model::MISSED_PERIODS`]).

use crate::can::ErrorRate;
use crate::results::{ChainReport, LostReport, MessageReport, NodeReport, StepReport, Tolerance};
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
    errors: Errors,
) -> Option<ChainReport> {
    let mut exclusive: Vec<(&str, Picoseconds)> = Vec::new();
    let mut clock = Clock {
        cycle,
        total: Some(0),
        phase: chain.from_us.map(|from| from * MICROSECOND),
        waited: false,
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
            if let Tolerance::Lost { next, .. } = report.tolerance {
                exclusive.push((message, next));
            }
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
    let latency = clock.total.and_then(|total| errors.delayed(total, &clock));
    if let (Some(total), Some(latency)) = (clock.total, latency)
        && latency > total
    {
        steps.push(StepReport {
            name: errors.name(latency - total),
            done: Some(latency),
            // Each instant of a cycle that begins late is late with it.
            phase: clock.phase.map(|phase| phase % cycle.max(1)),
        });
    }
    let longest = exclusive.iter().map(|(_, period)| *period).max();
    let frames = errors.rate.burst;
    let lost = longest.filter(|_| frames > 0).map(|period| LostReport {
        messages: exclusive
            .iter()
            .map(|(name, _)| (*name).to_owned())
            .collect(),
        frames,
        latency: latency.map(|latency| latency + frames * period),
        deadline: chain.lost_deadline_us.unwrap_or(chain.deadline_us) * MICROSECOND,
    });
    Some(ChainReport {
        name: chain.name.clone(),
        steps,
        latency,
        deadline: chain.deadline_us * MICROSECOND,
        lost,
    })
}

/// Disturbed frames on the bus of a chain.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Errors {
    /// Their rate.
    pub rate: ErrorRate,
    /// How much later a basic cycle may begin by the errors of one burst; zero without a schedule.
    pub late: Picoseconds,
}

impl Errors {
    /// No frame is disturbed.
    pub const NONE: Self = Self {
        rate: ErrorRate::NONE,
        late: 0,
    };

    /// The name of the time that late cycles add to a chain, as a step of it.
    fn name(self, added: Picoseconds) -> String {
        let cycles = match added / self.late.max(1) {
            1 => "a basic cycle".to_owned(),
            cycles => format!("{cycles} basic cycles"),
        };
        format!("late begin of {cycles} (disturbed references)")
    }

    /// The end-to-end time `total` with the basic cycles on its way that begin late; `None` without a bound.
    /// A chain that waits for no instant of a later cycle is as long as without errors.
    fn delayed(self, total: Picoseconds, clock: &Clock) -> Option<Picoseconds> {
        if self.late == 0 || !clock.waited {
            return Some(total);
        }
        let mut delayed = total;
        loop {
            let errors = self.rate.errors(delayed.div_ceil(1000));
            let bursts = errors.div_ceil(self.rate.burst.max(1));
            let longer = total + bursts * self.late;
            if longer <= delayed {
                return Some(delayed);
            }
            // Bursts that follow each other faster than one delays.
            if longer > MANY * total {
                return None;
            }
            delayed = longer;
        }
    }
}

/// How many times as long as without errors a chain may be: a longer one counts as without bound.
const MANY: u64 = 1000;

/// The two clocks; see the module.
struct Clock {
    /// Length of the basic cycle.
    cycle: Picoseconds,
    /// Longest time since the first event; `None` once a step has no bound.
    total: Option<Picoseconds>,
    /// Latest instant of the basic cycle, if it is known.
    phase: Option<Picoseconds>,
    /// It has waited for an instant of a later basic cycle.
    waited: bool,
}

impl Clock {
    fn pass(&mut self, time: Picoseconds) {
        self.total = self.total.map(|total| total + time);
        self.phase = self.phase.map(|phase| phase + time);
    }

    /// Waits for the instant `at` of the basic cycle.
    fn until(&mut self, at: Picoseconds) {
        self.waited |= self
            .phase
            .is_none_or(|phase| phase % self.cycle > at % self.cycle);
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
