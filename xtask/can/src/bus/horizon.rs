//! How far nodes may run ahead of the bus.

use super::node::Device;
use super::{Bus, DEFAULT_BIT};
use crate::node_id::NodeId;
use crate::tester::Tester;
use crate::time::{Ps, SimTime, instant};
use crate::wire::{INTERMISSION_BITS, TAIL_BITS};

/// Least number of bits from a start of frame that the bus does not know yet to its first effect on
/// a receiver: two senders with equal identifiers differ only after the arbitration field.
const UNKNOWN_START_BITS: u64 = 13;

/// The next visible events of the current frame if nothing disturbs it.
#[derive(Clone, Copy, Debug)]
struct Outlook {
    receivers: Ps,
    transmitter: Ps,
    /// End of the intermission that follows.
    idle: Ps,
}

impl Bus {
    /// A lower bound of the time at which any node's state next changes if no node writes a
    /// register until then. It equals [`Self::now`] if an event is due now and is later otherwise.
    /// `None` if the bus stays idle.
    #[must_use]
    pub fn next_event(&self) -> Option<SimTime> {
        let actions = self
            .nodes
            .iter()
            .filter_map(|node| node.actions.front().map(|(at, _)| *at));
        let segments = (0..self.segments.len()).filter_map(|segment| {
            let (step, _) = self.next_in_segment(segment)?;
            Some(match self.outlook(segment) {
                Some(outlook) => outlook.receivers.min(outlook.transmitter).max(step),
                None => step,
            })
        });
        actions.chain(segments).min().map(instant)
    }

    /// The time up to which every node may run without missing an event, whatever the nodes write:
    /// the earliest [`Self::horizon_of`].
    #[must_use]
    pub fn horizon(&self) -> SimTime {
        (0..self.nodes.len())
            .map(|node| self.horizon_of(NodeId(node)))
            .min()
            .unwrap_or(SimTime::from_ticks(Ps::MAX))
    }

    /// The time before which a node's registers and interrupt lines can change only by its own
    /// writes, whatever the other nodes write from [`Self::now`] on. After a write of the node
    /// itself the horizon may be earlier, so call this again.
    ///
    /// Two changes are not covered: those of the bits TXM, RXM, SAMP and RX of MSR, and those
    /// caused by another node that is reset or disconnected in the middle of its frame.
    #[must_use]
    pub fn horizon_of(&self, node: NodeId) -> SimTime {
        let index = node.0;
        let node = &self.nodes[index];
        let action = node.actions.front().map_or(Ps::MAX, |(at, _)| *at);
        let bus = self.horizon_on_segment(index);
        instant(action.min(bus))
    }

    fn horizon_on_segment(&self, index: usize) -> Ps {
        let node = &self.nodes[index];
        let segment = node.segment;
        let bit = self.shortest_bit(segment);
        if node.mac.is_detached() {
            return match &node.device {
                Device::Controller { can, .. } if can.minds_start_of_frame() => self.now + bit,
                _ => Ps::MAX,
            };
        }
        if self.segments[segment].bit.is_some() {
            let step = self.next_in_segment(segment).map_or(Ps::MAX, |(at, _)| at);
            return match (self.outlook(segment), node.mac.sending().is_some()) {
                (Some(outlook), true) => outlook.transmitter.max(step),
                (Some(outlook), false) => outlook.receivers.max(step),
                (None, _) => step,
            };
        }
        let unknown = if node.earliest_request(self.now).is_some() || !self.in_tune(segment) {
            self.now + bit
        } else {
            self.now + UNKNOWN_START_BITS * bit
        };
        let disturbed = self
            .disturbances
            .iter()
            .filter_map(|active| active.earliest_in_future(self.now))
            .map(|at| at.max(self.now + bit))
            .min()
            .unwrap_or(Ps::MAX);
        let raw = self
            .testers()
            .filter_map(Tester::earliest_raw)
            .map(|at| at.max(self.now + bit))
            .min()
            .unwrap_or(Ps::MAX);
        let own = node.waited_out_at().unwrap_or(Ps::MAX);
        unknown.min(disturbed).min(raw).min(own)
    }

    fn shortest_bit(&self, segment: usize) -> Ps {
        self.members(segment)
            .filter(|(_, node)| !node.mac.is_detached())
            .map(|(_, node)| node.time.bit)
            .min()
            .unwrap_or(DEFAULT_BIT)
    }

    fn in_tune(&self, segment: usize) -> bool {
        let active = || {
            self.members(segment)
                .filter(|(_, node)| !node.mac.is_detached())
                .map(|(_, node)| node)
        };
        active().all(|node| active().all(|other| node.keeps_step_with(other.time.bit)))
    }

    /// The outlook for the current frame, if it has a single sender and no disturbance.
    fn outlook(&self, segment: usize) -> Option<Outlook> {
        let state = &self.segments[segment];
        let bit = state.bit?;
        if state.disturbed {
            return None;
        }
        let mut sender = None;
        let mut acknowledged = false;
        for (index, node) in self.members(segment) {
            if node.gate_closed {
                return None;
            }
            if node.mac.sending().is_some() {
                if sender.replace(index).is_some() {
                    return None;
                }
            } else if let Some(position) = node.mac.position() {
                // A node that has counted other bits has seen another start of frame.
                let ahead = position.saturating_add(u16::from(node.sample_at.is_some()));
                if ahead != state.position.saturating_add(1) {
                    return None;
                }
                acknowledged |= node.mac.acknowledges();
            } else if !node.mac.can_wait() || (node.mac.is_idle() && state.position > 0) {
                return None;
            } else {
                // An idle node receives the frame from the sample point of its first bit on.
                acknowledged |= node.mac.is_idle() && !node.mac.silent;
            }
        }
        let sender = &self.nodes[sender?];
        let (_, _, wire) = sender.mac.sending()?;
        if self
            .members(segment)
            .any(|(_, node)| !node.mac.is_detached() && !node.keeps_step_with(sender.time.bit))
        {
            return None;
        }
        let limit = |bits: usize| {
            let left = bits.checked_sub(usize::from(state.position))?;
            Some(bit.start + left as u64 * sender.time.bit)
        };
        let body = wire.bits() - TAIL_BITS;
        let valid = limit(body + 8)?;
        let sent = if sender.mac.loop_back {
            valid
        } else if acknowledged {
            limit(body + 9)?
        } else {
            limit(body + 1)?
        };
        let receivers = if acknowledged {
            valid
        } else {
            // The sender's error flag reaches the other nodes in the bit after the acknowledge
            // slot.
            sent
        };
        let disturbed = self
            .disturbances
            .iter()
            .filter_map(|active| {
                active.earliest_in_frame(state.frame_start, self.now, sender.time.bit)
            })
            .chain(self.testers().filter_map(Tester::earliest_raw))
            .min()
            .unwrap_or(Ps::MAX);
        Some(Outlook {
            receivers: receivers.min(disturbed),
            transmitter: sent.min(disturbed),
            idle: limit(wire.bits() + INTERMISSION_BITS as usize)?.min(disturbed),
        })
    }

    /// True if a frame of the node may start before `at` but after the time that the bus has
    /// processed.
    pub(super) fn may_have_started(&self, index: usize, at: Ps) -> bool {
        let node = &self.nodes[index];
        if node.mac.is_detached() {
            return false;
        }
        let segment = node.segment;
        let Some(bit) = self.segments[segment].bit else {
            return self
                .start_of_segment(segment)
                .is_some_and(|start| start <= at)
                || node.waited_out_at().is_some_and(|ready| ready <= at);
        };
        match self.outlook(segment) {
            Some(outlook) => outlook.idle <= at,
            None => bit.end <= at,
        }
    }
}
