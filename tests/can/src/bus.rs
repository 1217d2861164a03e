//! The bus: nodes, the level they make together, and the time at which each reads it.

use std::collections::VecDeque;

use embedded_can::Id;

use crate::Frame;
use crate::bxcan::{BxCan, FilterBanks, IrqLines, LineStatus, WireStatus};
use crate::confinement::{ErrorCounters, ErrorState};
use crate::disturbance::{Active, Disturbance, SeenBy};
use crate::mac::{Event, Mac};
use crate::record::{Record, RecordKind};
use crate::tester::{Retry, Tester};
use crate::time::{BitTime, ClockRate, Ps, SimTime, instant};
use crate::wire::{INTERMISSION_BITS, Level, TAIL_BITS};

/// A node on a [`Bus`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(usize);

impl NodeId {
    /// The number of the node: 0 for the first one added to its bus.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0
    }
}

/// A part with bxCAN.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// STM32F303: one controller, 14 filter banks.
    F303,
    /// STM32F446: CAN1 of a pair, 28 filter banks divided by CAN2SB.
    F446,
}

/// Bits that pass at least between the start of frame of a node that is unknown yet and the first
/// thing that a receiver can notice: two senders with equal identifiers disagree no earlier than
/// behind the arbitration field.
const UNKNOWN_START_BITS: u64 = 13;

/// Bits between two edges from recessive to dominant, at most, where bits are stuffed.
const LONGEST_WITHOUT_EDGE: u64 = 10;

/// Bit time of a bus on which no node has a clock.
const DEFAULT_BIT: Ps = 4_000_000;

#[derive(Clone, Debug)]
enum Device {
    Controller { can: Box<BxCan>, filters: usize },
    Tester(Box<Tester>),
}

/// Something asked of a node at an instant that the bus has not reached yet.
#[derive(Clone, Copy, Debug)]
enum Action {
    /// INRQ, SLEEP or ABOM may ask for another mode.
    Mode,
    /// A mailbox's abort is to be decided.
    Abort(u8),
    Reset,
    Clock(ClockRate),
    Connect(bool),
}

#[derive(Clone, Debug)]
struct Node {
    device: Device,
    mac: Mac,
    clock: ClockRate,
    time: BitTime,
    connected: bool,
    /// Index of the segment that the node hears: 0 is the bus, others are the node's own.
    segment: usize,
    actions: VecDeque<(Ps, Action)>,
    /// Start of the node's own grid of bits while its segment rests.
    anchor: Ps,
    /// Bits of that grid that the state machine has been told of.
    waited: u64,
    /// How far the node's bit begins behind the segment's bit, in picoseconds.
    lag: i64,
    /// Sample point of the bit in progress, unless it has been taken.
    sample_at: Option<Ps>,
    out_of_step: bool,
    /// The node reads the bit in progress inverted.
    flipped: bool,
    last_level: Level,
    reported: ErrorState,
}

impl Node {
    fn pending(&self, now: Ps) -> Option<(u8, Frame)> {
        match &self.device {
            Device::Controller { can, .. } => can.pending(now, self.time.bit),
            Device::Tester(tester) => tester.pending(now),
        }
    }

    fn earliest_request(&self, now: Ps) -> Option<Ps> {
        match &self.device {
            Device::Controller { can, .. } => can.earliest_request(now),
            Device::Tester(tester) => tester.earliest_request(now),
        }
    }

    /// First boundary of the node's own grid at or after `t`.
    fn boundary(&self, t: Ps) -> Ps {
        let since = t.saturating_sub(self.anchor);
        self.anchor + since.div_ceil(self.time.bit) * self.time.bit
    }

    /// When the node, idle on a resting segment, starts to send.
    fn start_at(&self, now: Ps) -> Option<Ps> {
        if !self.mac.is_idle() {
            return None;
        }
        self.earliest_request(now)
            .map(|at| self.boundary(at.max(now)))
    }

    /// When waiting on a resting segment changes the node's state.
    fn waited_out_at(&self) -> Option<Ps> {
        let bits = self.waited + self.mac.patience()?;
        Some(self.anchor + (bits - 1) * self.time.bit + self.time.sample)
    }

    /// Whether the node keeps in step with another's bits of this length: the drift over the
    /// longest stretch without an edge stays within both sides of the sample point.
    fn keeps_step_with(&self, bit: Ps) -> bool {
        let drift = self.time.bit.abs_diff(bit) * LONGEST_WITHOUT_EDGE;
        let slack = self
            .time
            .sample
            .min(self.time.bit.saturating_sub(self.time.sample));
        drift + self.time.quantum < slack && drift <= self.time.jump
    }

    fn resynchronise(&mut self, hard: bool) {
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

#[derive(Clone, Copy, Debug)]
struct Bit {
    start: Ps,
    end: Ps,
    level: Level,
}

/// A piece of cable: the bus, or what a cut-off node hears.
#[derive(Clone, Debug)]
struct Segment {
    /// The bit in progress; none while the segment rests.
    bit: Option<Bit>,
    /// Level of the bit before.
    previous: Level,
    /// The node whose clock sets the pace.
    pace: usize,
    /// Number of the bit in progress, counted from the latest start of frame.
    position: u16,
    frame_start: Ps,
    /// A disturbance has touched the frame in progress.
    disturbed: bool,
    /// Frames whose last bit is in progress.
    finished: Vec<(usize, Frame)>,
}

impl Segment {
    const fn new() -> Self {
        Self {
            bit: None,
            previous: Level::Recessive,
            pace: 0,
            position: 0,
            frame_start: 0,
            disturbed: false,
            finished: Vec::new(),
        }
    }
}

/// What happens next, in the order of precedence at equal times.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Step {
    Sample(usize),
    WaitedOut(usize),
    Action(usize),
    BitEnd(usize),
    Start(usize),
}

/// When an undisturbed frame in progress can be noticed next.
#[derive(Clone, Copy, Debug)]
struct Outlook {
    receivers: Ps,
    transmitter: Ps,
    /// End of the intermission that follows.
    idle: Ps,
}

/// A CAN bus with its nodes.
#[derive(Clone, Debug, Default)]
pub struct Bus {
    now: Ps,
    nodes: Vec<Node>,
    filters: Vec<FilterBanks>,
    /// The bus first, then one for each node.
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

    /// Adds the only controller of an F303 or CAN1 of an F446, in reset state; `clock` is its
    /// APB1 clock.
    pub fn add_bxcan(&mut self, part: Part, clock: ClockRate) -> NodeId {
        self.filters.push(FilterBanks::new(part == Part::F446));
        self.add_controller(false, self.filters.len() - 1, clock)
    }

    /// Adds CAN1 and CAN2 of an F446, which share the filter banks, in reset state.
    pub fn add_bxcan_pair(&mut self, clock: ClockRate) -> (NodeId, NodeId) {
        let first = self.add_bxcan(Part::F446, clock);
        let second = self.add_controller(true, self.filters.len() - 1, clock);
        (first, second)
    }

    /// Adds a foreign node. It joins the bus at once and takes part after eleven recessive bits.
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

    // Controllers.

    /// Reads a register of a controller, `offset` bytes from its base address, as its own writes
    /// so far and everything on the bus up to [`Self::now`] have left it. Zero for testers and
    /// for what is not a register.
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

    /// Writes a register of a controller at instant `at`, which may lie ahead of
    /// [`Self::now`]; an earlier one counts as now. Writes of one node must come in order of
    /// time. Nothing happens for testers.
    ///
    /// Mailboxes, FIFOs and flags change in the registers at once. A change of mode shows after
    /// [`Self::advance_to`] has passed `at`, except between sleep and initialisation. An abort
    /// shows at once if the frame cannot have started before `at`, as far as the bus knows the
    /// other nodes' requests.
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

    /// Levels of a controller's interrupt lines; all low for testers.
    #[must_use]
    pub fn irq(&self, node: NodeId) -> IrqLines {
        match &self.nodes[node.0].device {
            Device::Controller { can, .. } => can.irq(),
            Device::Tester(_) => IrqLines::default(),
        }
    }

    /// Resets a controller as a system reset does: registers and filters at once, off the bus
    /// from `at` on.
    pub fn reset(&mut self, node: NodeId, at: SimTime) {
        let at = at.as_ticks().max(self.now);
        if let Device::Controller { can, filters } = &mut self.nodes[node.0].device {
            can.reset();
            let banks = &mut self.filters[*filters];
            *banks = banks.after_reset();
            self.act(node.0, at, Action::Reset);
        }
    }

    /// Gives a node's controller another clock from `at` on.
    pub fn set_clock(&mut self, node: NodeId, clock: ClockRate, at: SimTime) {
        let at = at.as_ticks().max(self.now);
        self.act(node.0, at, Action::Clock(clock));
    }

    /// Cuts a node off the bus at `at`, or joins it again. A node that is cut off hears itself.
    pub fn set_connected(&mut self, node: NodeId, connected: bool, at: SimTime) {
        let at = at.as_ticks().max(self.now);
        self.act(node.0, at, Action::Connect(connected));
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

    /// Has a tester send a frame at the first chance from `at` on. Frames of one tester go out
    /// in the order of their instants. Nothing happens for controllers and listeners.
    pub fn send_at(&mut self, node: NodeId, at: SimTime, frame: Frame, retry: Retry) {
        self.with_tester(node, |tester, now| {
            tester.schedule(at.as_ticks().max(now), frame, retry);
        });
    }

    /// Has a tester send a frame again and again without a pause, as a babbling idiot does.
    pub fn babble(&mut self, node: NodeId, frame: Frame, from: SimTime, until: SimTime) {
        self.with_tester(node, |tester, _| {
            tester.babble(from.as_ticks(), until.as_ticks(), frame);
        });
    }

    /// Has a tester drive bits from `at` on (from the next boundary if the bus is not at rest)
    /// without regard to what is on the bus.
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

    /// How far the bus has been processed.
    #[must_use]
    pub fn now(&self) -> SimTime {
        instant(self.now)
    }

    /// Processes everything up to and including `t`.
    pub fn advance_to(&mut self, t: SimTime) {
        let t = t.as_ticks();
        while let Some((at, step)) = self.next_step().filter(|(at, _)| *at <= t) {
            self.now = at.max(self.now);
            self.perform(step);
        }
        self.now = self.now.max(t);
    }

    /// Takes the records since the last call, in order of time.
    pub fn drain_records(&mut self) -> Vec<Record> {
        std::mem::take(&mut self.records)
    }

    /// The earliest instant at which anything can change for any node if no node writes a
    /// register until then, or an earlier one; later than [`Self::now`] or equal to it if
    /// something is due. `None` if the bus rests and stays so.
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

    /// How far every node may run without missing anything, whatever the nodes do: the earliest
    /// of [`Self::horizon_of`].
    #[must_use]
    pub fn horizon(&self) -> SimTime {
        (0..self.nodes.len())
            .map(|node| self.horizon_of(NodeId(node)))
            .min()
            .unwrap_or(SimTime::from_ticks(Ps::MAX))
    }

    /// Up to which instant nothing can change in a node's registers and interrupt lines but by
    /// its own writes, whatever the other nodes write from [`Self::now`] on. A write of the node
    /// itself changes it: ask again after it.
    ///
    /// Two things are left out: the bits TXM, RXM, SAMP and RX of MSR, and the reset or cut of
    /// another node in the midst of its frame.
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

    /// The prospect of the frame in progress, if it has one sender and nothing has disturbed it.
    fn outlook(&self, segment: usize) -> Option<Outlook> {
        let state = &self.segments[segment];
        let bit = state.bit?;
        if state.disturbed {
            return None;
        }
        let mut sender = None;
        let mut acknowledged = false;
        for (index, node) in self.members(segment) {
            if node.mac.sending().is_some() {
                if sender.replace(index).is_some() {
                    return None;
                }
            } else if let Some(position) = node.mac.position() {
                // Whoever has counted other bits has seen another start of frame.
                let ahead = position + u16::from(node.sample_at.is_some());
                if ahead != state.position + 1 {
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
            // The sender's error flag reaches the others in the bit behind the acknowledge slot.
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

    /// Whether a frame of the node may start after what the bus has processed but before `at`.
    fn may_have_started(&self, index: usize, at: Ps) -> bool {
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

    // Scheduling.

    fn act(&mut self, index: usize, at: Ps, action: Action) {
        let actions = &mut self.nodes[index].actions;
        let place = actions.partition_point(|(other, _)| *other <= at);
        actions.insert(place, (at, action));
    }

    fn next_step(&self) -> Option<(Ps, Step)> {
        let actions = self
            .nodes
            .iter()
            .enumerate()
            .filter_map(|(index, node)| Some((node.actions.front()?.0, Step::Action(index))));
        let segments = (0..self.segments.len()).filter_map(|segment| self.next_in_segment(segment));
        actions.chain(segments).min()
    }

    fn next_in_segment(&self, segment: usize) -> Option<(Ps, Step)> {
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

    /// When a resting segment is driven next.
    fn start_of_segment(&self, segment: usize) -> Option<Ps> {
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

    fn testers_on(&self, segment: usize) -> impl Iterator<Item = &Tester> {
        self.members(segment)
            .filter_map(|(_, node)| match &node.device {
                Device::Tester(tester) => Some(&**tester),
                Device::Controller { .. } => None,
            })
    }

    fn perform(&mut self, step: Step) {
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
                // Writes between the reset and now may already ask for more.
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
        }
    }

    /// Follows a controller's INRQ, SLEEP and ABOM.
    fn settle_mode(&mut self, index: usize) {
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

    /// Puts a node on the bus, or on a segment of its own if it is cut off or loops back.
    fn choose_segment(&mut self, index: usize) {
        let now = self.now;
        let node = &self.nodes[index];
        let alone = !node.connected || node.mac.loop_back;
        let wanted = if alone { index + 1 } else { 0 };
        let old = node.segment;
        if wanted == old {
            return;
        }
        match self.segments[old].bit {
            // The bit in progress ends for the node where it ends for the others.
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
            // What the newcomer brings along was not foreseen.
            self.segments[wanted].disturbed = true;
        }
    }

    // Bits.

    /// Tells a node on a resting segment of the bits that have passed on its own grid.
    fn catch_up(&mut self, index: usize, now: Ps) {
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
        node.mac.wait(missed, &mut self.events);
        self.digest(index);
    }

    /// Begins the first bit after a rest.
    fn wake(&mut self, segment: usize) {
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
        let now = self.now;
        let members: Vec<usize> = self.members(segment).map(|(index, _)| index).collect();

        let mut ids: Vec<Id> = Vec::new();
        let mut first_sender = None;
        let mut all_waiting = true;
        let mut some_idle = false;
        for &index in &members {
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
                ids.push(frame.id());
                first_sender.get_or_insert(index);
                self.records.push(Record {
                    at: instant(now),
                    node: NodeId(index),
                    kind: RecordKind::FrameStart { frame },
                });
            }
        }

        let mut level = Level::Recessive;
        for &index in &members {
            let node = &mut self.nodes[index];
            if !node.mac.silent {
                level = level.and(node.mac.drive());
            }
            if let Device::Tester(tester) = &mut node.device
                && let Some(raw) = tester.raw_level(now)
            {
                level = level.and(raw);
                self.segments[segment].disturbed = true;
            }
        }

        let state = &mut self.segments[segment];
        let starting = !ids.is_empty();
        if starting || all_waiting {
            state.position = 0;
            state.frame_start = now;
            state.disturbed = !starting;
            // A foreign dominant bit is a start of frame for whoever was idle.
            let counts = starting || (some_idle && level == Level::Dominant);
            if segment == 0 && counts {
                for active in &mut self.disturbances {
                    active.frame_started(self.frames_started, &ids);
                }
                self.frames_started += 1;
            }
        } else {
            state.position = state.position.saturating_add(1);
        }

        if segment == 0 {
            let in_frame = members
                .iter()
                .any(|index| self.nodes[*index].mac.is_in_frame())
                .then_some(state.position);
            for active in &mut self.disturbances {
                if let Some(stuck) = active.stuck(now) {
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
                            && node.segment == segment
                            && !node.mac.is_detached()
                        {
                            node.flipped = true;
                        }
                    }
                    None => {}
                }
            }
            self.disturbances.retain(|active| !active.is_over(now));
        }

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

        for &index in &members {
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
                node.resynchronise(starting || all_waiting);
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

    fn sample(&mut self, index: usize) {
        let node = &mut self.nodes[index];
        node.sample_at = None;
        let Some(bit) = self.segments[node.segment].bit else {
            return;
        };
        let level = if std::mem::take(&mut node.flipped) {
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

    /// Passes on what a node's state machine reports.
    fn digest(&mut self, index: usize) {
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
                segment.finished.push((index, frame));
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

    fn end_bit(&mut self, segment: usize) {
        let state = &mut self.segments[segment];
        let Some(bit) = state.bit.take() else {
            return;
        };
        state.previous = bit.level;
        let bits = state.position + 1;
        let start = instant(state.frame_start);
        for (index, frame) in state.finished.drain(..) {
            self.records.push(Record {
                at: instant(bit.end),
                node: NodeId(index),
                kind: RecordKind::FrameEnd { frame, start, bits },
            });
        }

        // Each node's own bit ends a little before or after the bit of the pace.
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

    /// Whether a segment on which every node waits is driven in the bit that starts now.
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
                    .any(|active| active.stuck(now) == Some(Level::Dominant)))
    }

    /// After a lost arbitration the pace goes over to a node that still sends. Its own grid may
    /// lie up to a quantum before the one so far; the difference is left out.
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
