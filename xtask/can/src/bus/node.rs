//! A node: what it is, its clock, and where it stands on its piece of cable.

use std::collections::VecDeque;

use crate::Frame;
use crate::bxcan::BxCan;
use crate::confinement::ErrorState;
use crate::mac::Mac;
use crate::tester::Tester;
use crate::time::{BitTime, ClockRate, Ps};
use crate::wire::Level;

/// Bits between two edges from recessive to dominant, at most, where bits are stuffed.
const LONGEST_WITHOUT_EDGE: u64 = 10;

#[derive(Clone, Debug)]
pub(super) enum Device {
    Controller { can: Box<BxCan>, filters: usize },
    Tester(Box<Tester>),
}

/// Something asked of a node at an instant that the bus has not reached yet.
#[derive(Clone, Copy, Debug)]
pub(super) enum Action {
    /// INRQ, SLEEP or ABOM may ask for another mode.
    Mode,
    /// A mailbox's abort is to be decided.
    Abort(u8),
    Reset,
    Clock(ClockRate),
    Connect(bool),
}

#[derive(Clone, Debug)]
pub(super) struct Node {
    pub(super) device: Device,
    pub(super) mac: Mac,
    pub(super) clock: ClockRate,
    pub(super) time: BitTime,
    pub(super) connected: bool,
    /// Index of the segment that the node hears: 0 is the bus, others are the node's own.
    pub(super) segment: usize,
    pub(super) actions: VecDeque<(Ps, Action)>,
    /// Start of the node's own grid of bits while its segment rests.
    pub(super) anchor: Ps,
    /// Bits of that grid that the state machine has been told of.
    pub(super) waited: u64,
    /// How far the node's bit begins behind the segment's bit, in picoseconds.
    pub(super) lag: i64,
    /// Sample point of the bit in progress, unless it has been taken.
    pub(super) sample_at: Option<Ps>,
    pub(super) out_of_step: bool,
    /// The node reads the bit in progress inverted.
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

    /// When the node, idle on a resting segment, starts to send.
    pub(super) fn start_at(&self, now: Ps) -> Option<Ps> {
        if !self.mac.is_idle() {
            return None;
        }
        self.earliest_request(now)
            .map(|at| self.boundary(at.max(now)))
    }

    /// When waiting on a resting segment changes the node's state.
    pub(super) fn waited_out_at(&self) -> Option<Ps> {
        let bits = self.waited + self.mac.patience()?;
        Some(self.anchor + (bits - 1) * self.time.bit + self.time.sample)
    }

    /// Whether the node keeps in step with another's bits of this length: the drift over the
    /// longest stretch without an edge stays within both sides of the sample point.
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
