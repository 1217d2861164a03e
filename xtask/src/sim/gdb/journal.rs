//! What the debugged node says while it runs: its log, and its resets.

use twin::{Twin, replay::Companion};
use vehicle_model::NodeIndex;
use world::{SimTime, time};

use crate::log::Log;

/// Lines that are kept for `monitor log`.
const KEPT: usize = 500;

/// The log of a node, read at each step of the run, as a debug probe reads it.
#[derive(Debug, Clone)]
pub(super) struct Journal {
    node: NodeIndex,
    log: Log,
    resets: usize,
    past: Vec<String>,
    /// Lines that are not shown yet.
    fresh: Vec<String>,
}

impl Journal {
    /// Of a node with this image.
    pub(super) fn new(node: NodeIndex, elf: &[u8]) -> Self {
        Self {
            node,
            log: Log::of(elf),
            resets: 1,
            past: Vec::new(),
            fresh: Vec::new(),
        }
    }

    /// The last lines until now.
    pub(super) fn last(&self, count: usize) -> &[String] {
        &self.past[self.past.len().saturating_sub(count)..]
    }

    /// Whether there are lines that are not shown yet.
    pub(super) fn has_fresh(&self) -> bool {
        !self.fresh.is_empty()
    }

    /// Takes the lines that are not shown yet.
    pub(super) fn take_fresh(&mut self) -> Vec<String> {
        std::mem::take(&mut self.fresh)
    }
}

/// A line with the time at which it was read.
fn stamped(now: SimTime, line: &str) -> String {
    format!("[{:10.6} s] {line}", time::seconds(now))
}

impl Companion for Journal {
    /// Lines that are shown once are not shown again when one has gone back.
    fn keep(&self) -> Self {
        Self {
            fresh: Vec::new(),
            ..self.clone()
        }
    }

    fn accompany(&mut self, twin: &mut Twin, fresh: bool) {
        let now = twin.now();
        let mcu = twin.node_mut(self.node);
        let mut lines = self.log.take(mcu);
        for (at, cause) in mcu.resets().iter().skip(self.resets) {
            let seconds = time::seconds(*at);
            lines.push(format!("the node was reset at {seconds:.6} s: {cause:?}"));
        }
        self.resets = mcu.resets().len();
        let lines = lines.iter().map(|line| stamped(now, line));
        let before = self.past.len();
        self.past.extend(lines);
        if fresh {
            self.fresh.extend_from_slice(&self.past[before..]);
        }
        let old = self.past.len().saturating_sub(KEPT);
        self.past.drain(..old);
    }
}
