//! The bus: its nodes, the level that results from them, and the times at which each node samples
//! it.

mod bits;
mod horizon;
mod node;
mod schedule;
mod segment;

use std::collections::VecDeque;

use crate::bxcan::{BxCan, FilterBanks, IrqLines, LineStatus, WireStatus};
use crate::confinement::{ErrorCounters, ErrorState};
use crate::disturbance::{Active, Disturbance};
use crate::mac::{Event, Mac};
use crate::node_id::NodeId;
use crate::record::Record;
use crate::tester::{Retry, Tester};
use crate::time::{BitTime, ClockRate, Ps, SimTime, instant};
use crate::wire::Level;
use crate::{Frame, Part};
use node::{Action, Device, Node};
use segment::Segment;

/// Bit time of a bus on which no node has a clock.
const DEFAULT_BIT: Ps = 4_000_000;

/// A CAN bus with its nodes.
#[derive(Clone, Debug, Default)]
pub struct Bus {
    now: Ps,
    nodes: Vec<Node>,
    filters: Vec<FilterBanks>,
    /// The bus itself, followed by one private segment per node.
    segments: Vec<Segment>,
    disturbances: Vec<Active>,
    frames_started: u64,
    records: Vec<Record>,
    events: Vec<Event>,
}

impl Bus {
    /// A bus without nodes, at time zero.
    #[must_use]
    pub fn new() -> Self {
        Self {
            segments: vec![Segment::new()],
            ..Self::default()
        }
    }

    // Building.

    fn add(&mut self, device: Device, clock: ClockRate, time: BitTime) -> NodeId {
        self.nodes.push(Node {
            device,
            mac: Mac::new(),
            clock,
            time,
            connected: true,
            held: false,
            gate_closed: false,
            transmit: Level::Recessive,
            wired_to: None,
            segment: 0,
            actions: VecDeque::new(),
            anchor: self.now,
            waited: 0,
            lag: 0,
            sample_at: None,
            out_of_step: false,
            flipped: false,
            last_level: Level::Recessive,
            reported: ErrorState::Active,
        });
        self.segments.push(Segment::new());
        NodeId(self.nodes.len() - 1)
    }

    fn add_controller(&mut self, second: bool, filters: usize, clock: ClockRate) -> NodeId {
        let can = Box::new(BxCan::new(second));
        let time = BitTime::new(clock, can.segments());
        self.add(Device::Controller { can, filters }, clock, time)
    }

    /// Adds the only controller of an F303 or CAN1 of an F446, in its reset state. `clock` is its
    /// APB1 clock.
    pub fn add_bxcan(&mut self, part: &Part, clock: ClockRate) -> NodeId {
        self.filters
            .push(FilterBanks::new(part.can_controllers > 1));
        self.add_controller(false, self.filters.len() - 1, clock)
    }

    /// Adds CAN1 and CAN2 of an F446, which share the filter banks, in their reset state.
    pub fn add_bxcan_pair(&mut self, clock: ClockRate) -> (NodeId, NodeId) {
        let first = self.add_bxcan(Part::F446, clock);
        let second = self.add_controller(true, self.filters.len() - 1, clock);
        (first, second)
    }

    /// Adds a foreign node. It joins the bus at once and participates after eleven recessive bits.
    pub fn add_tester(&mut self, tester: Tester) -> NodeId {
        let clock = tester.clock;
        let time = BitTime::new(clock, tester.segments);
        let silent = tester.silent;
        let id = self.add(Device::Tester(Box::new(tester)), clock, time);
        let mac = &mut self.nodes[id.0].mac;
        mac.silent = silent;
        mac.automatic_recovery = true;
        mac.attach();
        id
    }

    /// Adds a tester that drives the transmit pin of another node, whose controller or program is broken: it
    /// is behind the same gate.
    pub fn add_tester_at(&mut self, node: NodeId, tester: Tester) -> NodeId {
        let id = self.add_tester(tester);
        self.nodes[id.0].wired_to = Some(node.0);
        self.nodes[id.0].gate_closed = self.nodes[node.0].gate_closed;
        id
    }

    // Controllers.

    /// Reads a register of a controller, `offset` bytes from its base address. The value includes
    /// all writes of this node so far and all events on the bus up to [`Self::now`]. Zero for
    /// testers and for offsets without a register.
    #[must_use]
    pub fn read(&self, node: NodeId, offset: u32) -> u32 {
        let node = &self.nodes[node.0];
        let Device::Controller { can, filters } = &node.device else {
            return 0;
        };
        let level = self.segments[node.segment]
            .bit
            .map_or(Level::Recessive, |bit| bit.level);
        let line = LineStatus {
            transmitting: node.mac.sending().is_some(),
            receiving: node.mac.is_receiving(),
            last_sample: node.last_level.is_recessive(),
            level: level.is_recessive(),
        };
        can.read(offset, line, &self.filters[*filters])
    }

    /// Writes a register of a controller at time `at`, which may be later than [`Self::now`]; an
    /// earlier time counts as now. Writes of one node must be in order of time. Ignored for
    /// testers.
    ///
    /// Mailboxes, FIFOs and flags change in the registers at once. A change of mode is visible
    /// after [`Self::advance_to`] has passed `at`, except between sleep and initialisation, where
    /// it is visible at once. An abort is visible at once if, according to the requests known so
    /// far, the frame cannot have started before `at`.
    pub fn write(&mut self, node: NodeId, offset: u32, value: u32, at: SimTime) {
        let at = at.as_ticks().max(self.now);
        let index = node.0;
        let wire = WireStatus {
            sending: self.nodes[index].mac.sending().map(|(slot, ..)| slot),
            may_have_started: self.may_have_started(index, at),
        };
        let Device::Controller { can, filters } = &mut self.nodes[index].device else {
            return;
        };
        let effects = can.write(offset, value, at, wire, &mut self.filters[*filters]);
        if effects.reset {
            self.act(index, at, Action::Reset);
        }
        if effects.mode {
            self.act(index, at, Action::Mode);
        }
        for slot in (0..8).filter(|slot| effects.aborts >> slot & 1 == 1) {
            self.act(index, at, Action::Abort(slot));
        }
    }

    /// Levels of a controller's interrupt lines; all are low for testers.
    #[must_use]
    pub fn irq(&self, node: NodeId) -> IrqLines {
        match &self.nodes[node.0].device {
            Device::Controller { can, .. } => can.irq(),
            Device::Tester(_) => IrqLines::default(),
        }
    }

    /// Resets a controller as a system reset does. Its registers and filters are reset at once; it
    /// leaves the bus at `at`.
    pub fn reset(&mut self, node: NodeId, at: SimTime) {
        let at = at.as_ticks().max(self.now);
        if let Device::Controller { can, filters } = &mut self.nodes[node.0].device {
            can.reset();
            let banks = &mut self.filters[*filters];
            *banks = banks.after_reset();
            self.act(node.0, at, Action::Reset);
        }
    }

    /// Changes the clock of a node's controller from `at` on.
    pub fn set_clock(&mut self, node: NodeId, clock: ClockRate, at: SimTime) {
        let at = at.as_ticks().max(self.now);
        self.act(node.0, at, Action::Clock(clock));
    }

    /// Disconnects a node from the bus at `at`, or reconnects it. A disconnected node still
    /// receives itself.
    pub fn set_connected(&mut self, node: NodeId, connected: bool, at: SimTime) {
        let at = at.as_ticks().max(self.now);
        self.act(node.0, at, Action::Connect(connected));
    }

    /// From `at` on, a node's receive pin reads dominant whatever is on the bus, or no longer does.
    /// Only a node that waits for recessive bits to join the bus, or to recover from bus-off, is
    /// affected: it waits on.
    pub fn hold_receive_pin(&mut self, node: NodeId, dominant: bool, at: SimTime) {
        let at = at.as_ticks().max(self.now);
        self.act(node.0, at, Action::Hold(dominant));
    }

    /// Closes or opens the gate between a node's transmit pin and the bus at `at`, as a bus guardian does.
    /// It acts from the next bit on. Behind a closed gate the bus is recessive for all that the node
    /// drives. The node knows nothing of it: where it drives a dominant bit and nobody else does, it finds a
    /// bit error. Starts of frame behind a closed gate are not recorded.
    ///
    /// A gate that closes changes the frame that is being sent, which the horizon does not foresee. So
    /// where there are gates, [`Self::next_step_at`] says how far the bus may run.
    pub fn close_gate(&mut self, node: NodeId, closed: bool, at: SimTime) {
        let at = at.as_ticks().max(self.now);
        for index in 0..self.nodes.len() {
            if index == node.0 || self.nodes[index].wired_to == Some(node.0) {
                self.act(index, at, Action::Gate(closed));
            }
        }
    }

    /// The level at a node's transmit pin now, in front of its gate: recessive while it waits, listens only,
    /// loops back or is disconnected.
    #[must_use]
    pub fn transmit_level(&self, node: NodeId) -> Level {
        if self.segments[0].bit.is_none() {
            return Level::Recessive;
        }
        let mut level = Level::Recessive;
        for (index, other) in self.members(0) {
            if index == node.0 || other.wired_to == Some(node.0) {
                level = level.and(other.transmit);
            }
        }
        level
    }

    /// The time of the next step of the simulation, such as the begin of a bit; `None` while the bus stays
    /// idle. No level on the bus or at a transmit pin changes before it, unless a node writes a register.
    #[must_use]
    pub fn next_step_at(&self) -> Option<SimTime> {
        self.next_step().map(|(at, _)| instant(at))
    }

    /// From now on a controller inverts these bits of the first data word of each frame that it
    /// receives: it is broken.
    pub fn corrupt_reception(&mut self, node: NodeId, mask: u32) {
        if let Device::Controller { can, .. } = &mut self.nodes[node.0].device {
            can.corrupt(mask);
        }
    }

    /// From now on a controller does not leave the bus when the program asks it to initialise or to
    /// sleep: it is broken. Only a reset takes it off the bus. With `unlocked` it also takes a bit
    /// timing over while it is on the bus.
    pub fn jam(&mut self, node: NodeId, unlocked: bool) {
        if let Device::Controller { can, .. } = &mut self.nodes[node.0].device {
            can.jam(unlocked);
        }
    }

    /// The error counters of a node.
    #[must_use]
    pub fn error_counters(&self, node: NodeId) -> ErrorCounters {
        self.nodes[node.0].mac.counters()
    }

    // Testers.

    /// A foreign node; `None` for controllers.
    #[must_use]
    pub fn tester(&self, node: NodeId) -> Option<&Tester> {
        match &self.nodes[node.0].device {
            Device::Tester(tester) => Some(tester),
            Device::Controller { .. } => None,
        }
    }

    fn with_tester(&mut self, node: NodeId, action: impl FnOnce(&mut Tester, Ps)) {
        let now = self.now;
        if let Device::Tester(tester) = &mut self.nodes[node.0].device {
            action(tester, now);
        }
    }

    /// Makes a tester send a frame as soon as possible from `at` on. Frames of one tester are sent
    /// in the order of their times. Ignored for controllers and listeners.
    pub fn send_at(&mut self, node: NodeId, at: SimTime, frame: Frame, retry: Retry) {
        self.with_tester(node, |tester, now| {
            tester.schedule(at.as_ticks().max(now), frame, retry);
        });
    }

    /// Makes a tester send a frame again and again without a pause, like a babbling idiot.
    pub fn babble(&mut self, node: NodeId, frame: Frame, from: SimTime, until: SimTime) {
        self.with_tester(node, |tester, _| {
            tester.babble(from.as_ticks(), until.as_ticks(), frame);
        });
    }

    /// Makes a tester drive bits from `at` on, whatever else is on the bus. On a busy bus they
    /// begin at the next bit boundary.
    pub fn play_raw(&mut self, node: NodeId, at: SimTime, levels: Vec<Level>) {
        if levels.is_empty() {
            return;
        }
        self.with_tester(node, |tester, now| {
            tester.play(at.as_ticks().max(now), levels);
        });
    }

    /// Adds a disturbance.
    pub fn disturb(&mut self, disturbance: Disturbance) {
        self.disturbances.push(Active::new(disturbance));
    }

    // Time.

    /// The time up to which the bus has been simulated.
    #[must_use]
    pub fn now(&self) -> SimTime {
        instant(self.now)
    }

    /// Simulates everything up to and including `t`.
    pub fn advance_to(&mut self, t: SimTime) {
        let t = t.as_ticks();
        while let Some((at, step)) = self.next_step().filter(|(at, _)| *at <= t) {
            self.now = at.max(self.now);
            self.perform(step);
        }
        self.now = self.now.max(t);
    }

    /// Returns the records since the last call, in order of time.
    pub fn drain_records(&mut self) -> Vec<Record> {
        std::mem::take(&mut self.records)
    }

    fn testers(&self) -> impl Iterator<Item = &Tester> {
        self.nodes.iter().filter_map(|node| match &node.device {
            Device::Tester(tester) => Some(&**tester),
            Device::Controller { .. } => None,
        })
    }

    fn members(&self, segment: usize) -> impl Iterator<Item = (usize, &Node)> {
        self.nodes
            .iter()
            .enumerate()
            .filter(move |(_, node)| node.segment == segment)
    }
}
