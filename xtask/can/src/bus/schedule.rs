//! The next event on the bus, and requests to the nodes from outside.

use super::Bus;
use super::node::{Action, Device};
use super::segment::Segment;
use crate::confinement::ErrorState;
use crate::tester::Tester;
use crate::time::{BitTime, Ps};

/// The kinds of event. At equal times the first kind in this order comes first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Step {
    Sample(usize),
    WaitedOut(usize),
    Action(usize),
    BitEnd(usize),
    Start(usize),
}

impl Bus {
    pub(super) fn act(&mut self, index: usize, at: Ps, action: Action) {
        let actions = &mut self.nodes[index].actions;
        let place = actions.partition_point(|(other, _)| *other <= at);
        actions.insert(place, (at, action));
    }

    pub(super) fn next_step(&self) -> Option<(Ps, Step)> {
        let actions = self
            .nodes
            .iter()
            .enumerate()
            .filter_map(|(index, node)| Some((node.actions.front()?.0, Step::Action(index))));
        let segments = (0..self.segments.len()).filter_map(|segment| self.next_in_segment(segment));
        actions.chain(segments).min()
    }

    pub(super) fn next_in_segment(&self, segment: usize) -> Option<(Ps, Step)> {
        if let Some(bit) = self.segments[segment].bit {
            return self
                .members(segment)
                .filter_map(|(index, node)| Some((node.sample_at?, Step::Sample(index))))
                .min()
                .or(Some((bit.end, Step::BitEnd(segment))));
        }
        if segment > 0 && self.nodes[segment - 1].segment != segment {
            return None;
        }
        let waits = self
            .members(segment)
            .filter_map(|(index, node)| Some((node.waited_out_at()?, Step::WaitedOut(index))))
            .min();
        let start = self
            .start_of_segment(segment)
            .map(|at| (at, Step::Start(segment)));
        waits.into_iter().chain(start).min()
    }

    /// The time at which a node next drives an idle segment.
    pub(super) fn start_of_segment(&self, segment: usize) -> Option<Ps> {
        let own = self.members(segment).filter_map(|(_, node)| {
            if node.mac.can_wait() {
                node.start_at(self.now)
            } else {
                Some(node.anchor.max(self.now))
            }
        });
        let foreign = self
            .testers_on(segment)
            .filter_map(Tester::earliest_raw)
            .map(|at| at.max(self.now));
        let stuck = self
            .disturbances
            .iter()
            .filter(|_| segment == 0)
            .filter_map(|active| active.wakes(self.now));
        own.chain(foreign).chain(stuck).min()
    }

    pub(super) fn testers_on(&self, segment: usize) -> impl Iterator<Item = &Tester> {
        self.members(segment)
            .filter_map(|(_, node)| match &node.device {
                Device::Tester(tester) => Some(&**tester),
                Device::Controller { .. } => None,
            })
    }

    pub(super) fn perform(&mut self, step: Step) {
        match step {
            Step::Sample(index) => self.sample(index),
            Step::WaitedOut(index) => {
                let node = &mut self.nodes[index];
                let bits = node.mac.patience().unwrap_or(0);
                node.waited += bits;
                node.mac.wait(bits, &mut self.events);
                self.digest(index);
            }
            Step::Action(index) => {
                if let Some((_, action)) = self.nodes[index].actions.pop_front() {
                    self.perform_action(index, action);
                }
            }
            Step::BitEnd(segment) => self.end_bit(segment),
            Step::Start(segment) => self.wake(segment),
        }
    }

    fn perform_action(&mut self, index: usize, action: Action) {
        let now = self.now;
        let node = &mut self.nodes[index];
        match action {
            Action::Mode => self.settle_mode(index),
            Action::Abort(slot) => {
                let sending = node.mac.sending().map(|(slot, ..)| slot);
                if let Device::Controller { can, .. } = &mut node.device {
                    can.decide_abort(slot, sending);
                }
            }
            Action::Reset => {
                node.mac.reset();
                node.sample_at = None;
                node.reported = ErrorState::Active;
                if let Device::Controller { can, .. } = &node.device {
                    node.time = BitTime::new(node.clock, can.segments());
                }
                // Writes between the reset and now may already request another mode.
                self.settle_mode(index);
            }
            Action::Clock(clock) => {
                node.clock = clock;
                let segments = match &node.device {
                    Device::Controller { can, .. } => can.segments(),
                    Device::Tester(tester) => tester.segments,
                };
                self.catch_up(index, now);
                let node = &mut self.nodes[index];
                node.time = BitTime::new(clock, segments);
                node.anchor = now;
                node.waited = 0;
            }
            Action::Connect(connected) => {
                node.connected = connected;
                self.choose_segment(index);
            }
            Action::Hold(held) => {
                self.catch_up(index, now);
                self.nodes[index].held = held;
            }
            Action::Gate(closed) => {
                self.nodes[index].gate_closed = closed;
                // The outlook for the current frame did not know.
                self.segments[0].disturbed = true;
            }
        }
    }

    /// Applies a controller's INRQ, SLEEP and ABOM.
    pub(super) fn settle_mode(&mut self, index: usize) {
        let now = self.now;
        let node = &mut self.nodes[index];
        let Device::Controller { can, .. } = &mut node.device else {
            return;
        };
        node.mac.automatic_recovery = can.automatic_recovery();
        if can.wants_to_detach(now) && node.mac.is_quiescent() {
            node.mac.detach();
            node.sample_at = None;
            can.detached();
        } else if can.wants_to_attach(now) {
            can.attached(now);
            node.mac.loop_back = can.loop_back();
            node.mac.silent = can.silent() && !can.loop_back();
            node.time = BitTime::new(node.clock, can.segments());
            node.mac.attach();
            node.anchor = now;
            node.waited = 0;
            node.lag = 0;
            node.sample_at = None;
            self.choose_segment(index);
        }
    }

    /// Connects a node to the bus, or to its private segment if it is disconnected or in loop back.
    /// A controller that joins is on the bus even in loop back, because it waits for recessive bits
    /// at its pin.
    pub(super) fn choose_segment(&mut self, index: usize) {
        let now = self.now;
        let node = &self.nodes[index];
        let joins = matches!(&node.device, Device::Controller { can, .. } if can.joins());
        let alone = !node.connected || (node.mac.loop_back && !joins);
        let wanted = if alone { index + 1 } else { 0 };
        let old = node.segment;
        if wanted == old {
            return;
        }
        match self.segments[old].bit {
            // The current bit ends for the node at the same time as for the others.
            Some(bit) => {
                let node = &mut self.nodes[index];
                node.anchor = bit.end;
                node.waited = 0;
            }
            None => self.catch_up(index, now),
        }
        let node = &mut self.nodes[index];
        node.segment = wanted;
        node.sample_at = None;
        node.lag = 0;
        if alone {
            self.segments[wanted] = Segment {
                pace: index,
                ..Segment::new()
            };
        } else {
            // The outlook for the current frame did not include this node.
            self.segments[wanted].disturbed = true;
        }
    }
}
