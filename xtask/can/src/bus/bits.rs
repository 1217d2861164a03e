//! Simulates a single bit: which nodes start a frame, which level results, when each node samples
//! it and what follows.

use embedded_can::Id;

use super::node::{Device, Node};
use super::segment::Bit;
use super::{Bus, DEFAULT_BIT};
use crate::disturbance::SeenBy;
use crate::mac::Event;
use crate::node_id::NodeId;
use crate::record::{Record, RecordKind};
use crate::tester::Tester;
use crate::time::{Ps, instant};
use crate::wire::Level;

/// The nodes that start a frame in a bit.
struct Started {
    senders: Vec<(Id, NodeId)>,
    first_sender: Option<usize>,
    /// True if no node is sending or receiving.
    all_waiting: bool,
    some_idle: bool,
}

impl Started {
    fn starting(&self) -> bool {
        !self.senders.is_empty()
    }
}

impl Bus {
    /// Passes the bits of an idle segment to a node, on that node's own bit grid.
    pub(super) fn catch_up(&mut self, index: usize, now: Ps) {
        let node = &mut self.nodes[index];
        if self.segments[node.segment].bit.is_some() {
            return;
        }
        let sampled = match now.checked_sub(node.anchor + node.time.sample) {
            Some(since) => since / node.time.bit + 1,
            None => 0,
        };
        let missed = sampled.saturating_sub(node.waited);
        node.waited += missed;
        if node.held && missed > 0 {
            node.mac.wait_in_vain();
        } else {
            node.mac.wait(missed, &mut self.events);
        }
        self.digest(index);
    }

    /// Begins the first bit after an idle period.
    pub(super) fn wake(&mut self, segment: usize) {
        let now = self.now;
        let mut first = None;
        for index in 0..self.nodes.len() {
            if self.nodes[index].segment != segment {
                continue;
            }
            self.catch_up(index, now);
            let node = &mut self.nodes[index];
            if first.is_none() && node.start_at(now) == Some(now) {
                first = Some(index);
            }
            let since = now.saturating_sub(node.anchor);
            node.lag = -(since % node.time.quantum).cast_signed();
        }
        if let Some(first) = first {
            self.segments[segment].pace = first;
        }
        self.segments[segment].previous = Level::Recessive;
        self.begin_bit(segment);
    }

    /// Begins a bit now.
    fn begin_bit(&mut self, segment: usize) {
        let members: Vec<usize> = self.members(segment).map(|(index, _)| index).collect();
        let started = self.start_frames(&members);
        let level = self.driven_level(segment, &members);
        self.count_position(segment, &started, level);
        let level = if segment == 0 {
            self.disturbed_level(&members, level)
        } else {
            level
        };
        self.choose_pace(segment, &members, started.first_sender);
        self.plan_samples(segment, &members, &started, level);
    }

    /// Starts the pending frames of the idle nodes.
    fn start_frames(&mut self, members: &[usize]) -> Started {
        let now = self.now;
        let mut senders: Vec<(Id, NodeId)> = Vec::new();
        let mut first_sender = None;
        let mut all_waiting = true;
        let mut some_idle = false;
        for &index in members {
            let node = &mut self.nodes[index];
            all_waiting &= node.mac.can_wait();
            if !node.mac.is_idle() {
                continue;
            }
            some_idle = true;
            if let Some((slot, frame)) = node.pending(now) {
                node.mac.start(slot, frame);
                if let Device::Controller { can, .. } = &mut node.device {
                    can.frame_started(now, node.time.bit, Some(slot));
                }
                if node.gate_closed {
                    continue;
                }
                senders.push((frame.id(), NodeId(index)));
                first_sender.get_or_insert(index);
                if !node.mac.loop_back {
                    self.records.push(Record {
                        at: instant(now),
                        node: NodeId(index),
                        kind: RecordKind::FrameStart { frame },
                    });
                }
            }
        }
        Started {
            senders,
            first_sender,
            all_waiting,
            some_idle,
        }
    }

    /// The level that results from all nodes.
    fn driven_level(&mut self, segment: usize, members: &[usize]) -> Level {
        let now = self.now;
        let mut level = Level::Recessive;
        for &index in members {
            let node = &mut self.nodes[index];
            let mut driven = Level::Recessive;
            if !node.mac.silent {
                driven = node.mac.drive();
            }
            if let Device::Tester(tester) = &mut node.device
                && let Some(raw) = tester.raw_level(now)
            {
                driven = driven.and(raw);
                self.segments[segment].disturbed = true;
            }
            node.transmit = driven;
            if !node.gate_closed {
                level = level.and(driven);
            }
        }
        level
    }

    /// Counts the bits since the start of frame.
    fn count_position(&mut self, segment: usize, started: &Started, level: Level) {
        let now = self.now;
        let state = &mut self.segments[segment];
        let starting = started.starting();
        if starting || started.all_waiting {
            state.position = 0;
            state.frame_start = now;
            state.disturbed = !starting;
            // An idle node takes another node's dominant bit for a start of frame.
            let counts = starting || (started.some_idle && level == Level::Dominant);
            if segment == 0 && counts {
                for active in &mut self.disturbances {
                    active.frame_started(now, self.frames_started, &started.senders);
                }
                self.frames_started += 1;
            }
        } else {
            state.position = state.position.saturating_add(1);
        }
    }

    /// The level of the first segment, after applying the disturbances.
    fn disturbed_level(&mut self, members: &[usize], mut level: Level) -> Level {
        let now = self.now;
        let state = &mut self.segments[0];
        let in_frame = members
            .iter()
            .any(|index| self.nodes[*index].mac.is_in_frame())
            .then_some(state.position);
        for active in &mut self.disturbances {
            if let Some(stuck) = active.stuck(now, in_frame) {
                state.disturbed |= stuck != level;
                level = stuck;
            }
            match active.flips(now, in_frame) {
                Some(SeenBy::All) => {
                    level = level.inverted();
                    state.disturbed = true;
                }
                Some(SeenBy::Node(NodeId(index))) => {
                    state.disturbed = true;
                    if let Some(node) = self.nodes.get_mut(index)
                        && node.segment == 0
                        && !node.mac.is_detached()
                    {
                        node.flipped = true;
                    }
                }
                None => {}
            }
        }
        self.disturbances.retain(|active| !active.is_over(now));
        level
    }

    /// Selects the node whose bit time the segment follows: the first sender, while it sends.
    fn choose_pace(&mut self, segment: usize, members: &[usize], first_sender: Option<usize>) {
        let state = &mut self.segments[segment];
        let pace_is_sender = self
            .nodes
            .get(state.pace)
            .is_some_and(|node| node.segment == segment && node.mac.sending().is_some());
        if let (Some(first), false) = (first_sender, pace_is_sender) {
            state.pace = first;
        }
        let pace_is_here = self
            .nodes
            .get(state.pace)
            .is_some_and(|node| node.segment == segment && !node.mac.is_detached());
        if !pace_is_here {
            state.pace = members
                .iter()
                .copied()
                .find(|index| !self.nodes[*index].mac.is_detached())
                .unwrap_or(usize::MAX);
        }
    }

    /// Stores the bit and the time at which each node samples it.
    fn plan_samples(&mut self, segment: usize, members: &[usize], started: &Started, level: Level) {
        let now = self.now;
        let starting = started.starting();
        let state = &mut self.segments[segment];
        let bit = self
            .nodes
            .get(state.pace)
            .map_or(DEFAULT_BIT, |node| node.time.bit);
        let end = now + bit;
        let edge = state.previous == Level::Recessive && level == Level::Dominant;
        state.bit = Some(Bit {
            start: now,
            end,
            level,
        });
        let pace = state.pace;

        for &index in members {
            let node = &mut self.nodes[index];
            if node.mac.is_detached() {
                if edge
                    && starting
                    && let Device::Controller { can, .. } = &mut node.device
                    && can.start_while_asleep(now)
                {
                    self.settle_mode(index);
                }
                continue;
            }
            if index == pace {
                node.lag = 0;
            } else if edge {
                node.resynchronise(starting || started.all_waiting);
            }
            let sample = now.cast_signed() + node.lag + node.time.sample.cast_signed();
            let inside = now.cast_signed() <= sample && sample < end.cast_signed();
            node.out_of_step = !inside;
            node.sample_at = Some(if inside {
                sample.cast_unsigned()
            } else {
                node.lag = 0;
                now + node.time.sample.min(bit - 1)
            });
        }
    }

    pub(super) fn sample(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        node.sample_at = None;
        let Some(bit) = self.segments[node.segment].bit else {
            return;
        };
        let level = if node.held && node.mac.patience().is_some() {
            Level::Dominant
        } else if std::mem::take(&mut node.flipped) {
            bit.level.inverted()
        } else {
            bit.level
        };
        node.last_level = level;
        if node.out_of_step {
            node.mac.sample_out_of_step(level, &mut self.events);
        } else {
            node.mac.sample(level, &mut self.events);
        }
        self.digest(index);
    }

    /// Handles the events that a node's state machine reports.
    pub(super) fn digest(&mut self, index: usize) {
        if !self.events.is_empty() {
            let mut events = std::mem::take(&mut self.events);
            for event in events.drain(..) {
                self.digest_event(index, event);
            }
            self.events = events;
        }
        let node = &mut self.nodes[index];
        let counters = node.mac.counters();
        let state = counters.state();
        if state != node.reported {
            node.reported = state;
            self.records.push(Record {
                at: instant(self.now),
                node: NodeId(index),
                kind: RecordKind::StateChange { state },
            });
        }
        if let Device::Controller { can, .. } = &mut node.device {
            can.set_counters(counters);
            if can.wants_to_detach(self.now) && node.mac.is_quiescent() {
                self.settle_mode(index);
            }
        }
    }

    fn digest_event(&mut self, index: usize, event: Event) {
        let now = self.now;
        let node = &mut self.nodes[index];
        let segment = &mut self.segments[node.segment];
        let kind = match event {
            Event::Synchronised => {
                if let Device::Controller { can, .. } = &mut node.device {
                    can.synchronised();
                }
                self.choose_segment(index);
                return;
            }
            Event::Recovered => return,
            Event::StartSeen { may_join } => {
                let bit_start = segment.bit.map_or(now, |bit| bit.start);
                let joining = if may_join {
                    node.pending(bit_start)
                } else {
                    None
                };
                if let Device::Controller { can, .. } = &mut node.device {
                    let slot = joining.map(|(slot, _)| slot);
                    can.frame_started(bit_start, node.time.bit, slot);
                }
                let Some((slot, frame)) = joining else {
                    return;
                };
                node.mac.join(slot, frame);
                RecordKind::FrameStart { frame }
            }
            Event::ArbitrationLost { slot, frame, bit } => {
                match &mut node.device {
                    Device::Controller { can, .. } => can.arbitration_lost(slot),
                    Device::Tester(tester) => tester.attempted(slot, false),
                }
                RecordKind::ArbitrationLost { frame, bit }
            }
            Event::Transmitted { slot, frame } => {
                match &mut node.device {
                    Device::Controller { can, .. } => can.transmitted(slot),
                    Device::Tester(tester) => tester.attempted(slot, true),
                }
                // In loop-back nobody else sees the frame.
                if !node.mac.loop_back {
                    segment.finished.push((index, frame));
                }
                return;
            }
            Event::Received { frame } => {
                match &mut node.device {
                    Device::Controller { can, filters } => {
                        can.received(&frame, &self.filters[*filters]);
                    }
                    Device::Tester(tester) => tester.store(now, frame),
                }
                return;
            }
            Event::Error { kind, slot, bit } => {
                match &mut node.device {
                    Device::Controller { can, .. } => can.error(kind, slot),
                    Device::Tester(tester) => {
                        if let Some(slot) = slot {
                            tester.attempted(slot, false);
                        }
                    }
                }
                RecordKind::Error {
                    kind,
                    bit,
                    transmitter: slot.is_some(),
                }
            }
        };
        self.records.push(Record {
            at: instant(now),
            node: NodeId(index),
            kind,
        });
    }

    pub(super) fn end_bit(&mut self, segment: usize) {
        let state = &mut self.segments[segment];
        let Some(bit) = state.bit.take() else {
            return;
        };
        state.previous = bit.level;
        let bits = state.position.saturating_add(1);
        let start = instant(state.frame_start);
        for (index, frame) in state.finished.drain(..) {
            self.records.push(Record {
                at: instant(bit.end),
                node: NodeId(index),
                kind: RecordKind::FrameEnd { frame, start, bits },
            });
        }

        // Each node's own bit ends a little earlier or later than the bit of the pace-setting node.
        let pace = state.pace;
        let length = bit.end - bit.start;
        for (index, node) in self.nodes.iter_mut().enumerate() {
            if node.segment == segment && index != pace {
                node.lag += node.time.bit.cast_signed() - length.cast_signed();
            }
        }

        let rests = self.members(segment).all(|(_, node)| node.mac.can_wait());
        if rests && !self.is_driven(segment) {
            for node in &mut self.nodes {
                if node.segment == segment && !node.mac.is_detached() {
                    node.anchor = bit.end.saturating_add_signed(node.lag);
                    node.waited = 0;
                }
            }
            return;
        }
        self.hand_over_pace(segment);
        self.begin_bit(segment);
    }

    /// True if, while all nodes wait, one of them or a disturbance drives the segment in the bit
    /// that begins now.
    fn is_driven(&self, segment: usize) -> bool {
        let now = self.now;
        self.members(segment)
            .any(|(_, node)| node.mac.is_idle() && node.pending(now).is_some())
            || self
                .testers_on(segment)
                .filter_map(Tester::earliest_raw)
                .any(|at| at <= now)
            || (segment == 0
                && self
                    .disturbances
                    .iter()
                    .any(|active| active.stuck(now, None) == Some(Level::Dominant)))
    }

    /// After a lost arbitration a node that still sends determines the bit time. Its bit grid may
    /// differ from the previous one by up to a quantum, which the model neglects.
    fn hand_over_pace(&mut self, segment: usize) {
        let pace = self.segments[segment].pace;
        let sends = |node: &Node| node.mac.sending().is_some();
        if self.nodes.get(pace).is_some_and(sends) {
            return;
        }
        let next = self
            .members(segment)
            .find(|(_, node)| sends(node))
            .map(|(index, _)| index);
        if let Some(next) = next {
            self.segments[segment].pace = next;
        }
    }
}
