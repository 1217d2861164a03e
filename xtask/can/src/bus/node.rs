//! A node: its kind, its clock, and its state on its cable segment.

use std::collections::VecDeque;

use crate::Frame;
use crate::bxcan::BxCan;
use crate::confinement::ErrorState;
use crate::mac::Mac;
use crate::tester::Tester;
use crate::time::{BitTime, ClockRate, Ps};
use crate::wire::Level;

/// Largest number of bits between two edges from recessive to dominant where bits are stuffed.
const LONGEST_WITHOUT_EDGE: u64 = 10;

#[derive(Clone, Debug)]
pub(super) enum Device {
    Controller { can: Box<BxCan>, filters: usize },
    Tester(Box<Tester>),
}

/// A request to a node, for a time that the bus has not reached yet.
#[derive(Clone, Copy, Debug)]
pub(super) enum Action {
    /// INRQ, SLEEP or ABOM may request another mode.
    Mode,
    /// Decide on the abort of this mailbox.
    Abort(u8),
    Reset,
    Clock(ClockRate),
    Connect(bool),
    /// The receive pin reads dominant, or no longer does.
    Hold(bool),
    /// The gate behind the transmit pin is closed, or open again.
    Gate(bool),
}

#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) device: Device,
    pub(super) mac: Mac,
    pub(super) clock: ClockRate,
    pub(super) time: BitTime,
    pub(super) connected: bool,
    /// The receive pin reads dominant whatever is on the bus.
    pub(super) held: bool,
    /// The gate between the transmit pin and the bus is closed: the bus gets nothing of what it drives.
    pub(super) gate_closed: bool,
    /// What it drives at its transmit pin in the current bit, in front of the gate.
    pub(super) transmit: Level,
    /// The node at whose transmit pin this tester drives as well, behind the same gate.
    pub(super) wired_to: Option<usize>,
    /// Index of the segment that the node is connected to. 0 is the bus; others belong to one node.
    pub(super) segment: usize,
    pub(super) actions: VecDeque<(Ps, Action)>,
    /// Origin of the node's own bit grid while its segment is idle.
    pub(super) anchor: Ps,
    /// Number of bits of that grid that the state machine has processed.
    pub(super) waited: u64,
    /// Delay of the node's bit after the segment's bit, in picoseconds.
    pub(super) lag: i64,
    /// Sample point of the current bit; `None` once it was sampled.
    pub(super) sample_at: Option<Ps>,
    pub(super) out_of_step: bool,
    /// True if the node reads the current bit inverted.
    pub(super) flipped: bool,
    pub(super) last_level: Level,
    pub(super) reported: ErrorState,
}

impl Node {
    pub(super) fn pending(&self, now: Ps) -> Option<(u8, Frame)> {
        match &self.device {
            Device::Controller { can, .. } => can.pending(now, self.time.bit),
            Device::Tester(tester) => tester.pending(now),
        }
    }

    pub(super) fn earliest_request(&self, now: Ps) -> Option<Ps> {
        match &self.device {
            Device::Controller { can, .. } => can.earliest_request(now),
            Device::Tester(tester) => tester.earliest_request(now),
        }
    }

    /// First boundary of the node's own grid at or after `t`.
    pub(super) fn boundary(&self, t: Ps) -> Ps {
        let since = t.saturating_sub(self.anchor);
        self.anchor + since.div_ceil(self.time.bit) * self.time.bit
    }

    /// The time at which the node starts to send while it is idle on an idle segment.
    pub(super) fn start_at(&self, now: Ps) -> Option<Ps> {
        if !self.mac.is_idle() {
            return None;
        }
        self.earliest_request(now)
            .map(|at| self.boundary(at.max(now)))
    }

    /// The time at which recessive bits on an idle segment change the node's state.
    pub(super) fn waited_out_at(&self) -> Option<Ps> {
        let patience = self.mac.patience().filter(|_| !self.held)?;
        let bits = self.waited + patience;
        Some(self.anchor + (bits - 1) * self.time.bit + self.time.sample)
    }

    /// True if the node stays synchronised with bits of this length: the drift over the longest
    /// time without an edge is smaller than the distance of the sample point from either end of the
    /// bit.
    pub(super) fn keeps_step_with(&self, bit: Ps) -> bool {
        let drift = self.time.bit.abs_diff(bit) * LONGEST_WITHOUT_EDGE;
        let slack = self
            .time
            .sample
            .min(self.time.bit.saturating_sub(self.time.sample));
        drift + self.time.quantum < slack && drift <= self.time.jump
    }

    pub(super) fn resynchronise(&mut self, hard: bool) {
        let quantum = self.time.quantum.cast_signed();
        let jump = self.time.jump.cast_signed();
        if hard {
            self.lag = -(-self.lag).rem_euclid(quantum);
        } else if self.lag > 0 {
            let late = (self.lag + quantum - 1) / quantum * quantum;
            self.lag -= late.min(jump);
        } else if self.lag <= -quantum {
            let early = -self.lag / quantum * quantum;
            self.lag += early.min(jump);
        }
    }
}
