//! What the nodes say and do in a run, beside the bus and the world: their logs and which task their
//! cores execute when.

pub(super) mod files;
pub(super) mod happened;
pub(super) mod mcap;
pub(super) mod replay;

use twin::{Images, TaskSwitch, Twin};
use world::{SimDuration, SimTime};

use super::{Error, live::Live};
use crate::log::{self, Log};

/// How often the logs are fetched. A program's buffer for its log holds several lines.
pub(super) const STEP: SimDuration = SimDuration::from_ticks(1_000_000_000);

/// A line of a node's log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct LogLine {
    /// When it was fetched, up to a millisecond after it was written.
    pub at: SimTime,
    /// Its level and its text: `INFO clock: External`.
    pub text: String,
}

impl LogLine {
    /// Its level and the text behind it; no level if the line has none.
    pub(crate) fn parts(&self) -> (&str, &str) {
        log::parts(&self.text)
    }
}

/// A task of a core, or a part of it between two preemptions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Segment {
    /// When it began.
    pub from: SimTime,
    /// When something else began.
    pub until: SimTime,
    /// Exception number of the task.
    pub exception: u16,
}

/// What a node did.
#[derive(Clone, Debug, Default)]
pub(crate) struct NodeRecording {
    /// Its log.
    pub log: Vec<LogLine>,
    /// What its core executed, in order of time, without what no exception interrupts.
    pub segments: Vec<Segment>,
    /// What it executes at present.
    open: Option<TaskSwitch>,
}

impl NodeRecording {
    fn switch(&mut self, switch: TaskSwitch) {
        if let Some(open) = self.open.replace(switch)
            && open.exception != 0
            && open.at < switch.at
        {
            self.segments.push(Segment {
                from: open.at,
                until: switch.at,
                exception: open.exception,
            });
        }
    }
}

/// Records a run as it goes on.
pub(crate) struct Recorder {
    logs: Vec<Log>,
    nodes: Vec<NodeRecording>,
    /// Whether somebody wants to know what the cores execute.
    tasks: bool,
}

impl Recorder {
    /// Records from now on; `tasks` says whether what the cores execute is wanted, which takes some
    /// megabytes for each minute.
    pub(crate) fn new(twin: &mut Twin, images: &Images, tasks: bool) -> Self {
        let nodes: Vec<_> = twin.nodes().collect();
        for &node in nodes.iter().filter(|_| tasks) {
            twin.node_mut(node).note_switches();
        }
        Self {
            logs: nodes.iter().map(|&node| Log::of(images.of(node))).collect(),
            nodes: vec![NodeRecording::default(); nodes.len()],
            tasks,
        }
    }

    /// Lets the vehicle run up to `end`, at the pace of `live` if there is one.
    ///
    /// # Errors
    /// As [`Twin::run_until`] and [`Live::keep_up`].
    pub(crate) fn run_until(
        &mut self,
        twin: &mut Twin,
        end: SimTime,
        mut live: Option<&mut Live>,
    ) -> Result<(), Error> {
        while twin.now() < end {
            twin.run_until(end.min(twin.now() + STEP))?;
            self.fetch(twin);
            if let Some(live) = &mut live {
                live.keep_up(twin, &self.nodes)?;
                if live.is_stopped() {
                    break;
                }
            }
        }
        Ok(())
    }

    fn fetch(&mut self, twin: &mut Twin) {
        let at = twin.now();
        let nodes = twin.nodes();
        for ((node, log), recording) in nodes.zip(&mut self.logs).zip(&mut self.nodes) {
            let lines = log.take(twin.node_mut(node)).into_iter();
            let lines = lines.map(|text| LogLine { at, text });
            recording.log.extend(lines);
            if self.tasks {
                for switch in twin.node_mut(node).drain_switches() {
                    recording.switch(switch);
                }
            }
        }
    }

    /// What has been recorded so far, in the order of the nodes.
    #[cfg(test)]
    pub(crate) fn nodes(&self) -> &[NodeRecording] {
        &self.nodes
    }

    /// What was recorded, in the order of the nodes.
    pub(crate) fn finish(self) -> Vec<NodeRecording> {
        self.nodes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_preempted_task_has_two_segments() {
        let mut node = NodeRecording::default();
        for (at, exception) in [(10, 20), (34, 44), (75, 20), (87, 21), (101, 0), (200, 20)] {
            let at = SimTime::from_ticks(at);
            node.switch(TaskSwitch { at, exception });
        }
        let seen: Vec<_> = node
            .segments
            .iter()
            .map(|one| (one.from.as_ticks(), one.until.as_ticks(), one.exception))
            .collect();
        let expected = [(10, 34, 20), (34, 75, 44), (75, 87, 20), (87, 101, 21)];
        assert_eq!(seen, expected);
    }

    #[test]
    fn the_level_of_a_line_is_known() {
        let line = |text: &str| LogLine {
            at: SimTime::from_ticks(0),
            text: text.into(),
        };
        assert_eq!(line("WARN bus: off").parts(), ("WARN", "bus: off"));
        assert_eq!(line("hello you").parts(), ("", "hello you"));
    }
}
