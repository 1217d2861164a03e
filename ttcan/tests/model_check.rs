//! Explores every behaviour of three nodes, two of them potential masters, on a bus
//! that loses frames, with nodes that crash and start again and counters that drift.
//!
//! Time is discrete. One step is 1 us, which is one bit at 1 Mbit/s and one tick of
//! the counters. The model chooses freely
//!
//! * the fate of each frame that begins: delivered, destroyed for all, or missed by
//!   one receiver only (the acknowledgement of CAN does not show that);
//! * crashes, at any event, and starts, at any event or quarter of a basic cycle;
//! * the drift of each node against true time, up to the synchronisation uncertainty
//!   in a basic cycle.
//!
//! Everything else is determined. The numbers of losses and crashes are bounded.
//! One check begins with all nodes off, and starts them in any order.

use std::io::Write;
use std::time::Instant;

use stateright::{Checker, Expectation, Model, Property};
use ttcan::guardian::{Guardian, GuardianConfig, Lines};
use ttcan::{
    Action, ClockState, Fault, Frame, INTERFRAME_BITS, Id, MasterState, MatrixConfig, Micros, Node,
    NodeConfig, NodeId, Reception, ReferenceFormat, Stamp, SyncState, SystemMatrix,
    TransmitOutcome, Window, WindowKind, frame_bits,
};

const CYCLE: u32 = 1000;
const UNCERTAINTY: u32 = 10;
/// Drift of a node in a basic cycle. Two nodes differ by up to twice as much.
const DRIFT: i32 = 5;
/// Bits of an error frame: superposed flags and delimiter.
const ERROR_BITS: u32 = 17;
/// Bits of a frame before an error destroys it.
const BROKEN_AFTER: u32 = 30;

/// Basic cycles after the last fault within which all powered nodes are in schedule
/// under the best-ranked master. This includes a start, the second reference, and
/// the time until the better-ranked master has taken over.
const RECOVERY: u32 = 4;

/// Changes of a node's global time that corrections never make, in microseconds.
const STEP: i64 = 100;
/// The bit of the control byte that announces a discontinuity of global time.
const DISCONTINUITY: u8 = 0x40;

const fn micros(at: u32) -> Micros {
    Micros::micros(at)
}

const fn window(name: &'static str, at: u32, id: Id, node: u16) -> Window<'static> {
    Window::exclusive(name, micros(at), micros(90), id, 0, NodeId(node))
}

/// The windows of three nodes, of which the first one begins at this cycle time.
const fn windows(first: u32) -> [Window<'static>; 4] {
    [
        window("a", first, Id::constant::<16>(), 0),
        window("b", first + 90, Id::constant::<17>(), 1),
        window("c", first + 180, Id::constant::<18>(), 2),
        window("c again", 700, Id::constant::<18>(), 2).every(2, 1),
    ]
}

const fn matrix<'a>(
    reference_format: ReferenceFormat,
    windows: &'a [Window<'a>],
) -> SystemMatrix<'a> {
    SystemMatrix::constant(MatrixConfig {
        bit_rate: 1_000_000,
        basic_cycle: micros(CYCLE),
        cycles: 2,
        reference: Id::constant::<0>(),
        reference_format,
        masters: &[NodeId(0), NodeId(1)],
        transmit_enable_bits: 16,
        sync_uncertainty: micros(UNCERTAINTY),
        longest_gap: micros(0),
        windows,
        events: &[],
    })
}

const MATRIX: SystemMatrix = matrix(ReferenceFormat::LEVEL_1, &windows(100));
/// The same with global time, whose reference messages are longer.
const TIMED: SystemMatrix = matrix(ReferenceFormat::LEVEL_2, &windows(150));

ttcan::schedule!(static SCHEDULE = MATRIX);
ttcan::schedule!(static TIMED_SCHEDULE = TIMED);

type Stack = Node<'static, { MATRIX.window_count() }, { MATRIX.node_count() }, 1>;

fn stack(node: u16, timed: bool) -> Stack {
    let config = NodeConfig::new(NodeId(node), 1);
    let schedule = if timed {
        TIMED_SCHEDULE.view()
    } else {
        SCHEDULE.view()
    };
    Stack::new(schedule, config).expect("the configuration is sound")
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Station {
    node: Stack,
    powered: bool,
    mailbox: Option<Frame>,
    drift: i32,
    /// Whether it was started again with a time of its own, and has no other one yet.
    restarted: bool,
}

/// Level of a TX line.
#[derive(Clone, Copy, Debug)]
enum Level {
    Dominant,
    Recessive,
}

/// Who watches the lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Watchers {
    Nobody,
    /// A guardian of all nodes, with each bit's look.
    Central,
    /// A guardian for each node, which sees its own line only and sleeps while that is at rest.
    Own,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
enum Guardians {
    Central(Box<Guardian<'static, 3>>),
    Own(Vec<Guardian<'static, 1>>),
}

impl Guardians {
    fn new(watchers: Watchers) -> Option<Self> {
        let config = GuardianConfig {
            jitter: micros(0),
            // Two nodes at the ends of the drift that the model chooses.
            drift_ppm: 10_000,
            // A babbler can use them up twice, at the end of a period and in the next one, and a basic
            // cycle has only 1000 bits here.
            attempts: 4,
            strikes: 0,
            untimely: 3,
            // Each bit has its look.
            ..GuardianConfig::new(1, micros(0))
        };
        let nodes = [NodeId(0), NodeId(1), NodeId(2)];
        let sound = "the configuration is sound";
        match watchers {
            Watchers::Nobody => None,
            Watchers::Central => {
                let guardian = Guardian::new(SCHEDULE.view(), config, nodes, Stamp(0));
                Some(Self::Central(Box::new(guardian.expect(sound))))
            }
            Watchers::Own => {
                let own =
                    |node| Guardian::new(SCHEDULE.view(), config, [node], Stamp(0)).expect(sound);
                Some(Self::Own(nodes.map(own).into()))
            }
        }
    }

    /// Lets the guardians look. `open` has the gates that are open, bit by bit.
    fn look(&mut self, lines: Lines, now: Stamp, open: &mut u32) {
        match self {
            Self::Central(guardian) => *open = guardian.look(lines, now).bits(),
            Self::Own(guardians) => {
                for (node, guardian) in guardians.iter_mut().enumerate() {
                    let own = Lines {
                        dominant: lines.dominant >> node & 1,
                        fell: lines.fell >> node & 1,
                    };
                    if own != Lines::default() || !guardian.is_at_rest() {
                        let bits = guardian.look(own, now).bits();
                        *open = *open & !(1 << node) | bits << node;
                    }
                }
            }
        }
    }

    /// When a look changes something. Guardians that sleep need none.
    fn due(&self) -> Option<Stamp> {
        let earlier = |one: Stamp, other: Stamp| if other.reached(one) { one } else { other };
        match self {
            Self::Central(guardian) => Some(guardian.due()),
            Self::Own(guardians) => {
                let awake = guardians.iter().filter(|guardian| !guardian.is_at_rest());
                awake.map(Guardian::due).reduce(earlier)
            }
        }
    }

    fn handle_frame(&mut self, frame: &Frame, stamp: Stamp, open: &mut u32) {
        match self {
            Self::Central(guardian) => *open = guardian.handle_frame(frame, stamp).bits(),
            Self::Own(guardians) => {
                for (node, guardian) in guardians.iter_mut().enumerate() {
                    let bits = guardian.handle_frame(frame, stamp).bits();
                    *open = *open & !(1 << node) | bits << node;
                }
            }
        }
    }

    /// How often a node was cut.
    fn trips(&self, node: usize) -> u16 {
        match self {
            Self::Central(guardian) => guardian.trips(node).0,
            Self::Own(guardians) => guardians[node].trips(0).0,
        }
    }

    fn renumbered(self, now: Stamp) -> Self {
        match self {
            Self::Central(guardian) => Self::Central(Box::new(guardian.renumbered(now))),
            Self::Own(guardians) => {
                let guardians = guardians.into_iter();
                Self::Own(guardians.map(|guardian| guardian.renumbered(now)).collect())
            }
        }
    }
}

/// Guardians of the three nodes, and a node that babbles.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Guard {
    guardians: Guardians,
    /// The gates that are open.
    open: u32,
    /// The lines that are dominant.
    dominant: u32,
    babbler: Option<(usize, Frame)>,
}

impl Guard {
    fn new(guardians: Guardians) -> Self {
        let mut guard = Self {
            guardians,
            open: 0b111,
            dominant: 0,
            babbler: None,
        };
        guard.poll();
        guard
    }

    fn is_open(&self, node: usize) -> bool {
        self.open >> node & 1 == 1
    }

    fn poll(&mut self) {
        self.look(0, Stamp(0));
    }

    fn look(&mut self, fell: u32, now: Stamp) {
        let lines = Lines {
            dominant: self.dominant,
            fell,
        };
        self.guardians.look(lines, now, &mut self.open);
    }

    /// Ticks until a look changes something.
    fn due(&self) -> Option<u32> {
        let due = self.guardians.due()?;
        Some(due.ticks_since(Stamp(0)).max(0).unsigned_abs())
    }

    /// An edge so many bits ago.
    fn edge(&mut self, node: usize, level: Level, ago: u32) {
        let (bit, now) = (1 << node, Stamp(0).before(ago));
        // The looks up to the edge.
        self.look(0, now);
        match level {
            Level::Dominant => {
                self.dominant |= bit;
                self.look(bit, now);
            }
            Level::Recessive => {
                self.dominant &= !bit;
                self.look(0, now);
            }
        }
    }

    fn is_babbler(&self, node: usize) -> bool {
        self.babbler.is_some_and(|(babbler, _)| babbler == node)
    }

    /// Whether a node that does not babble was cut.
    fn is_wrong(&self) -> bool {
        (0..3).any(|node| {
            !self.is_babbler(node) && !self.is_imitated(node) && self.guardians.trips(node) > 0
        })
    }

    /// Whether the babbler destroys the references of this potential master with its identifier. A guardian of
    /// one node sees that they fail, and not why: it may cut the master for that.
    fn is_imitated(&self, node: usize) -> bool {
        let config = MATRIX.config();
        let reference = config.reference.offset(node as u8);
        matches!(self.guardians, Guardians::Own(_))
            && node < config.masters.len()
            && self
                .babbler
                .is_some_and(|(_, frame)| Some(frame.id()) == reference)
    }
}

/// What a babbling node sends, by number.
fn babble(node: usize, class: u8) -> Frame {
    let node = node as u16;
    let raw = match class {
        // References of either master, its own message, another one's, and the weakest.
        0 | 1 => u16::from(class),
        2 => 16 + node,
        3 => 16 + (node + 1) % 3,
        _ => 0x7FF,
    };
    let id = Id::standard(raw).expect("small");
    Frame::from_parts(id, u8::from(class < 2), [0; 8])
}

const CLASSES: u8 = 5;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Fate {
    Delivered,
    Destroyed,
    MissedBy(usize),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct OnBus {
    sender: usize,
    frame: Frame,
    fate: Fate,
    left: u32,
    /// Bits since the start of frame.
    age: u32,
}

/// A state that must never be reached.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Violation {
    /// A message outside its windows, by the reference that the nodes in schedule
    /// follow.
    Misplaced,
    /// Two messages at once.
    Contention,
    /// A node in schedule calls a frame of a healthy node misplaced.
    Suspected,
    /// Global time stepped on a node, and no reference announced it.
    Stepped,
    /// The guardian cut a node that does not babble.
    Cut,
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct State {
    stations: [Station; 3],
    on_bus: Option<OnBus>,
    interframe: u32,
    /// Time since the last valid reference began, while a node follows it.
    cycle_time: Option<u32>,
    cycle: u8,
    losses: u8,
    crashes: u8,
    /// Time since the last fault, up to the time of recovery.
    calm: u32,
    violation: Option<Violation>,
    /// Whether the references carry global time.
    timed: bool,
    /// Time since a reference announced a discontinuity of global time, if it was lately.
    announced: Option<u32>,
    guard: Option<Guard>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    /// Time passes up to the next event. A frame that begins there has this fate.
    Next(Fate),
    Crash(usize),
    Start(usize),
    /// A node sends one frame of this class after the other from now on.
    Babble(usize, u8),
}

struct Network {
    losses: u8,
    crashes: u8,
    drifts: Vec<[i32; 3]>,
    /// Whether all nodes are in schedule at the beginning, or without power.
    settled: bool,
    /// Whether the references carry global time. The clocks have no drift then, and the search ends
    /// when no fault was for the time of recovery.
    timed: bool,
    /// With guardians, the search ends when no fault was for the time of recovery.
    guarded: Watchers,
    /// Whether a node begins to babble.
    babble: bool,
}

impl State {
    /// The state as one line of a counterexample.
    fn print(&self, step: Option<&Step>) {
        print!("{:?} cycle {} ", self.cycle_time, self.cycle);
        for station in &self.stations {
            let status = station.node.status();
            let (sync, master, rank) = (status.sync, status.master, status.master_rank);
            match station.powered {
                true => print!("| {sync:?} {master:?} {rank:?} {} ", status.cycle),
                false => print!("| off "),
            }
            if let Some(frame) = station.mailbox {
                print!("sends {} ", frame.id());
            }
        }
        if let Some(on_bus) = self.on_bus {
            print!(
                "| {} of {} {:?}",
                on_bus.frame.id(),
                on_bus.sender,
                on_bus.fate
            );
        }
        println!(" {:?}, then {step:?}", self.violation);
    }

    fn serve(&mut self, index: usize) {
        let station = &mut self.stations[index];
        while let Some(action) = station.node.poll(Stamp(0)) {
            match action {
                Action::TransmitReference(frame) | Action::TransmitEvent(frame) => {
                    station.mailbox = Some(frame);
                }
                Action::Transmit(grant) => {
                    station.mailbox = Some(Frame::from_parts(grant.id, grant.len, [0; 8]));
                }
                Action::Abort => {
                    if station.mailbox.take().is_some() {
                        station
                            .node
                            .handle_transmit(TransmitOutcome::Aborted, Stamp(0));
                    }
                }
                // The application restarts its node after every severe error.
                Action::Silence => {
                    station.mailbox = None;
                    station.node.start(Stamp(0));
                    station.restarted = true;
                }
            }
        }
    }

    /// The global times of the nodes, in microseconds.
    fn times(&self) -> [Option<i64>; 3] {
        [0, 1, 2].map(|index| {
            let station = &self.stations[index];
            let time = station.node.global_time(Stamp(0))?;
            station.powered.then_some(time.as_micros() as i64)
        })
    }

    /// Compares the global times with those of `passed` microseconds before.
    fn check_times(&mut self, before: [Option<i64>; 3], passed: u32) {
        for (index, (before, now)) in before.into_iter().zip(self.times()).enumerate() {
            let station = &mut self.stations[index];
            if station.restarted {
                station.restarted = station.node.status().clock == ClockState::Own;
                continue;
            }
            if let (Some(before), Some(now)) = (before, now)
                && (now - before - i64::from(passed)).abs() > STEP
                && self.announced.is_none()
            {
                self.violation.get_or_insert(Violation::Stepped);
            }
        }
    }

    /// Lets `time` pass, which is not longer than until the next event.
    fn pass(&mut self, time: u32) {
        for station in self.stations.iter_mut().filter(|station| station.powered) {
            station.node = if self.timed {
                station.node.renumbered(Stamp(time))
            } else {
                station.node.normalised(Stamp(time))
            };
        }
        if let Some(guard) = &mut self.guard {
            guard.guardians = guard.guardians.clone().renumbered(Stamp(time));
            guard.poll();
        }
        self.announced = self
            .announced
            .map(|announced| announced + time)
            .filter(|announced| *announced < 3 * CYCLE + 200);
        if let Some(on_bus) = &mut self.on_bus {
            on_bus.left -= time;
            on_bus.age += time;
        }
        self.interframe = self.interframe.saturating_sub(time);
        self.cycle_time = self
            .cycle_time
            .map(|cycle_time| cycle_time + time)
            .filter(|cycle_time| *cycle_time < 2 * CYCLE);
        self.calm = (self.calm + time).min(RECOVERY * CYCLE);
    }

    /// Time to the next event.
    fn next_event(&self) -> Option<u32> {
        let timers = self
            .stations
            .iter()
            .filter(|station| station.powered)
            .filter_map(|station| station.node.next_deadline())
            .map(|deadline| deadline.ticks_since(Stamp(0)).max(0).unsigned_abs());
        let bus = self.on_bus.map(|on_bus| on_bus.left);
        let waiting = self
            .stations
            .iter()
            .any(|station| station.mailbox.is_some());
        let babbles = self
            .guard
            .as_ref()
            .is_some_and(|guard| guard.babbler.is_some_and(|(node, _)| guard.is_open(node)));
        let waiting = waiting || babbles;
        let idle = (self.on_bus.is_none() && waiting).then_some(self.interframe);
        let asked = self.guard.as_ref().and_then(Guard::due);
        // A start can happen in any quarter of a basic cycle, and at three instants in two basic
        // cycles where the states are many.
        let off = self.stations.iter().any(|station| !station.powered) && !self.babbles();
        let quarter = off.then_some(if self.timed { CYCLE * 2 / 3 } else { CYCLE / 4 });
        timers
            .chain(bus)
            .chain(idle)
            .chain(quarter)
            .chain(asked)
            .min()
    }

    fn end_frame(&mut self) {
        let Some(ended) = self.on_bus.filter(|on_bus| on_bus.left == 0) else {
            return;
        };
        self.on_bus = None;
        self.interframe = INTERFRAME_BITS;
        self.guard_end(&ended);
        let delivered = ended.fate != Fate::Destroyed;
        let due = self
            .cycle_time
            .is_none_or(|cycle_time| cycle_time - ended.age > CYCLE - 210);
        let control = if self.timed { 4 } else { 0 };
        if delivered
            && is_reference(&ended.frame)
            && ended.frame.data()[control] & DISCONTINUITY != 0
        {
            self.announced = Some(0);
        }
        let mut begins_cycle = delivered && is_reference(&ended.frame) && due;
        for index in 0..3 {
            if !self.stations[index].powered {
                continue;
            }
            if index == ended.sender {
                let outcome = if delivered {
                    TransmitOutcome::Sent
                } else {
                    TransmitOutcome::Error
                };
                let station = &mut self.stations[index];
                station.node.handle_transmit(outcome, Stamp(0));
            } else if delivered && ended.fate != Fate::MissedBy(index) {
                let station = &mut self.stations[index];
                let reception = station.node.handle_receive(&ended.frame, Stamp(0));
                match reception {
                    Reception::Reference { .. } => {
                        let sync = station.node.status().sync;
                        begins_cycle |= sync == SyncState::InSchedule;
                    }
                    Reception::Fault(Fault::Misplaced) if !self.babbles() => {
                        self.violation.get_or_insert(Violation::Suspected);
                    }
                    _ => {}
                }
            }
        }
        // A master that is not synchronised may send a reference in the middle of a
        // basic cycle. If no node in schedule accepts it, the basic cycle goes on.
        if begins_cycle {
            self.cycle_time = Some(ended.age);
            self.cycle = ended.frame.data()[control] & 0x3F;
        }
    }

    fn begin_frame(&mut self, fate: Fate) -> bool {
        if self.on_bus.is_some() || self.interframe > 0 {
            return false;
        }
        let mut contenders: Vec<(usize, Frame)> = (0..3)
            .filter_map(|index| Some((index, self.stations[index].mailbox?)))
            .collect();
        if let Some(guard) = &self.guard
            && let Some(babbler) = guard.babbler
            && guard.is_open(babbler.0)
        {
            contenders.push(babbler);
        }
        let Some(&(sender, frame)) = contenders.iter().min_by_key(|(_, frame)| frame.id()) else {
            return false;
        };
        let messages = contenders.iter().filter(|(_, frame)| !is_reference(frame));
        if messages.count() > 1 && !self.babbles() {
            self.violation.get_or_insert(Violation::Contention);
        }
        let acknowledged = (0..3).any(|index| index != sender && self.stations[index].powered);
        let fate = if acknowledged { fate } else { Fate::Destroyed };
        let fate = self.guard_begin(sender, &contenders, fate);
        for &(index, other) in &contenders {
            self.stations[index].mailbox = None;
            if index != sender && other.id() != frame.id() {
                let node = &mut self.stations[index].node;
                node.handle_transmit(TransmitOutcome::ArbitrationLost, Stamp(0));
            }
        }
        if !is_reference(&frame) && !self.babbles() {
            self.check_place(&frame);
        }
        self.on_bus = Some(OnBus {
            sender,
            frame,
            fate,
            left: if fate == Fate::Destroyed {
                BROKEN_AFTER + ERROR_BITS
            } else {
                frame_bits(&frame)
            },
            age: 0,
        });
        true
    }

    fn babbles(&self) -> bool {
        self.guard
            .as_ref()
            .is_some_and(|guard| guard.babbler.is_some())
    }

    /// Shows the beginning of a frame to the guardian. Two frames of one identifier destroy each other.
    fn guard_begin(&mut self, sender: usize, contenders: &[(usize, Frame)], fate: Fate) -> Fate {
        let Some(guard) = &mut self.guard else {
            return fate;
        };
        let won = contenders.iter().find(|(index, _)| *index == sender);
        let mut collides = false;
        for &(index, other) in contenders {
            guard.edge(index, Level::Dominant, 0);
            let equal = won.is_some_and(|(_, frame)| frame.id() == other.id());
            if !equal {
                // It loses arbitration after some bits, of which one is enough here.
                guard.edge(index, Level::Recessive, 0);
            }
            collides |= equal && index != sender;
        }
        guard.poll();
        if !guard.is_open(sender) || collides {
            Fate::Destroyed
        } else {
            fate
        }
    }

    /// Destroys the frame on the bus if the gate of its sender is closed.
    fn guard_cut(&mut self) {
        let Some(guard) = &mut self.guard else {
            return;
        };
        if guard.is_wrong() {
            self.violation.get_or_insert(Violation::Cut);
        }
        if let Some(on_bus) = &mut self.on_bus
            && !guard.is_open(on_bus.sender)
            && on_bus.fate != Fate::Destroyed
        {
            on_bus.fate = Fate::Destroyed;
            on_bus.left = on_bus.left.min(ERROR_BITS + 6);
        }
    }

    /// Shows the end of a frame to the guardian: the sender's last bit, acknowledge bits and flags.
    fn guard_end(&mut self, ended: &OnBus) {
        let Some(guard) = &mut self.guard else {
            return;
        };
        let destroyed = ended.fate == Fate::Destroyed;
        for index in 0..3 {
            guard.edge(index, Level::Recessive, if destroyed { 17 } else { 10 });
        }
        for index in 0..3 {
            let missed = ended.fate == Fate::MissedBy(index);
            if index != ended.sender && self.stations[index].powered && !missed {
                let (from, until) = if destroyed { (16, 10) } else { (9, 8) };
                guard.edge(index, Level::Dominant, from);
                guard.edge(index, Level::Recessive, until);
            }
        }
        if !destroyed {
            let Guard {
                guardians, open, ..
            } = guard;
            guardians.handle_frame(&ended.frame, Stamp(0), open);
        }
        guard.poll();
    }

    /// Whether the babbler was cut, and each message of another node was in its last window.
    fn is_rid_of_babbler(&self) -> bool {
        let Some(guard) = &self.guard else {
            return true;
        };
        let Some((babbler, _)) = guard.babbler else {
            return true;
        };
        let windows = MATRIX.config().windows.iter().enumerate();
        let complete = windows
            .filter_map(|(at, window)| match window.kind {
                WindowKind::Exclusive { sender, .. } => Some((at as u16, usize::from(sender.0))),
                _ => None,
            })
            .filter(|(_, sender)| *sender != babbler)
            .all(|(at, sender)| {
                self.powered().all(|station| {
                    let status = station.node.window(at).unwrap_or_default();
                    usize::from(station.node.id().0) == sender || status.missed == 0
                })
            });
        guard.guardians.trips(babbler) > 0 && complete
    }

    /// Checks that a message that begins now is in one of its windows.
    fn check_place(&mut self, frame: &Frame) {
        let in_place = self.cycle_time.is_some_and(|from| {
            let until = from + frame_bits(frame);
            let matrix = if self.timed { &TIMED } else { &MATRIX };
            matrix.config().windows.iter().any(|window| {
                let WindowKind::Exclusive { id, .. } = window.kind else {
                    return false;
                };
                let start = window.start.ticks();
                let end = start + window.length.ticks();
                id == frame.id()
                    && window.is_in(self.cycle)
                    && from + UNCERTAINTY >= start
                    && until <= end + UNCERTAINTY
            })
        });
        if !in_place {
            self.violation.get_or_insert(Violation::Misplaced);
        }
    }

    /// Applies the drift of a basic cycle to nodes for which one has begun or
    /// passed.
    fn drift(&mut self) {
        for station in self.stations.iter_mut().filter(|station| station.powered) {
            let counters = station.node.counters();
            let passed = counters.references > 0 || counters.missed_references > 0;
            let now = if passed { station.drift } else { 0 };
            if !self.timed {
                station.node = station.node.normalised(Stamp(0).offset(now));
            }
        }
    }

    /// A node loses power, or its software goes astray.
    fn crash(&mut self, index: usize) {
        let station = &mut self.stations[index];
        station.powered = false;
        station.mailbox = None;
        station.node = stack(index as u16, self.timed);
        if let Some(on_bus) = &mut self.on_bus
            && on_bus.sender == index
        {
            on_bus.fate = Fate::Destroyed;
            on_bus.left = ERROR_BITS;
            if let Some(guard) = &mut self.guard {
                guard.edge(index, Level::Recessive, 0);
            }
        }
    }

    fn powered(&self) -> impl Iterator<Item = &Station> {
        self.stations.iter().filter(|station| station.powered)
    }

    fn masters(&self) -> usize {
        self.powered()
            .filter(|station| station.node.status().master == MasterState::Current)
            .count()
    }

    /// Whether all powered nodes are in schedule under the best-ranked master. Always
    /// true for a single node, and for nodes without a master.
    fn is_settled(&self) -> bool {
        let Some(best) = (0..2).find(|index| self.stations[*index].powered) else {
            return true;
        };
        if self.powered().count() < 2 {
            return true;
        }
        self.masters() == 1
            && self.powered().all(|station| {
                let status = station.node.status();
                status.sync == SyncState::InSchedule && status.master_rank == Some(best as u8)
            })
    }
}

fn is_reference(frame: &Frame) -> bool {
    frame.id().raw() < 8
}

impl Model for Network {
    type State = State;
    type Action = Step;

    fn init_states(&self) -> Vec<State> {
        let station = |node: u16, drift| Station {
            node: stack(node, self.timed),
            powered: false,
            mailbox: None,
            drift,
            restarted: false,
        };
        let off = self.drifts.iter().map(|drift| State {
            stations: [0, 1, 2].map(|node| station(node, drift[usize::from(node)])),
            on_bus: None,
            interframe: 0,
            cycle_time: None,
            cycle: 0,
            losses: self.losses,
            crashes: self.crashes,
            calm: 0,
            violation: None,
            timed: self.timed,
            announced: None,
            guard: Guardians::new(self.guarded).map(Guard::new),
        });
        if !self.settled {
            return off.collect();
        }
        off.map(|mut state| {
            for index in 0..3 {
                state = self
                    .next_state(&state, Step::Start(index))
                    .expect("it starts");
            }
            while state.calm < RECOVERY * CYCLE {
                let next = self.next_state(&state, Step::Next(Fate::Delivered));
                state = next.expect("something is always due");
            }
            if self.timed || self.guarded != Watchers::Nobody {
                state.calm = 0;
            }
            state
        })
        .collect()
    }

    fn actions(&self, state: &State, actions: &mut Vec<Step>) {
        actions.push(Step::Next(Fate::Delivered));
        if state.losses > 0 {
            actions.push(Step::Next(Fate::Destroyed));
            actions.extend((0..3).map(|index| Step::Next(Fate::MissedBy(index))));
        }
        for (index, station) in state.stations.iter().enumerate() {
            let babbles = state
                .guard
                .as_ref()
                .is_some_and(|guard| guard.is_babbler(index));
            if !station.powered {
                if !babbles {
                    actions.push(Step::Start(index));
                }
            // Of global time, a crash of the third node changes nothing.
            } else if state.crashes > 0 && !(self.timed && index == 2) {
                actions.push(Step::Crash(index));
            }
        }
        if self.babble && !state.babbles() {
            for node in 0..3 {
                actions.extend((0..CLASSES).map(|class| Step::Babble(node, class)));
            }
        }
    }

    fn next_state(&self, last: &State, step: Step) -> Option<State> {
        let mut state = last.clone();
        let mut passed = 0;
        match step {
            Step::Next(fate) => {
                let time = state.next_event()?;
                passed = time;
                state.pass(time);
                state.guard_cut();
                state.end_frame();
                for index in 0..3 {
                    if state.stations[index].powered {
                        state.serve(index);
                    }
                }
                let begun = state.begin_frame(fate);
                if fate != Fate::Delivered {
                    let sender = state.on_bus.map(|on_bus| on_bus.sender);
                    let idle =
                        |index: usize| sender == Some(index) || !state.stations[index].powered;
                    if !begun || matches!(fate, Fate::MissedBy(index) if idle(index)) {
                        return None;
                    }
                    state.losses -= 1;
                    state.calm = 0;
                }
            }
            Step::Crash(index) => {
                state.crashes -= 1;
                state.calm = 0;
                state.crash(index);
            }
            Step::Babble(index, class) => {
                state.calm = 0;
                state.crash(index);
                let guard = state.guard.as_mut()?;
                guard.babbler = Some((index, babble(index, class)));
            }
            Step::Start(index) => {
                state.calm = 0;
                state.stations[index].powered = true;
                state.stations[index].node.start(Stamp(0));
                state.serve(index);
            }
        }
        state.drift();
        if self.timed {
            state.check_times(last.times(), passed);
        }
        Some(state)
    }

    fn within_boundary(&self, state: &State) -> bool {
        !(self.timed || self.guarded != Watchers::Nobody) || state.calm < RECOVERY * CYCLE
    }

    fn properties(&self) -> Vec<Property<Self>> {
        let mut properties = vec![
            Property::always("no frame in another node's window", |_, state: &State| {
                state.violation.is_none()
            }),
            // A master that returns takes the time over before it leads again.
            Property::always("synchronised again", |_, state: &State| {
                let calm = state.calm < RECOVERY * CYCLE;
                state.timed || calm || (state.is_settled() && state.is_rid_of_babbler())
            }),
            Property::always(
                "a babbler is cut within a basic cycle",
                |_, state: &State| {
                    let Some(guard) = &state.guard else {
                        return true;
                    };
                    let cut = |(babbler, _)| guard.guardians.trips(babbler) > 0;
                    state.calm < CYCLE || guard.babbler.is_none_or(cut)
                },
            ),
            Property::always("one master", |_, state: &State| {
                state.calm < CYCLE + 200 || state.masters() <= 1
            }),
            Property::sometimes("in schedule", |_, state: &State| {
                state.powered().count() == 3 && state.is_settled()
            }),
        ];
        if !self.timed && self.guarded == Watchers::Nobody && (self.crashes > 0 || !self.settled) {
            properties.push(Property::sometimes("failover", |_, state: &State| {
                let [best, backup, follower] = &state.stations;
                !best.powered
                    && backup.node.status().master == MasterState::Current
                    && follower.node.is_alive()
                    && state.calm >= RECOVERY * CYCLE
            }));
        }
        properties
    }
}

impl Network {
    const PLAIN: Self = Self {
        losses: 0,
        crashes: 0,
        drifts: Vec::new(),
        settled: true,
        timed: false,
        guarded: Watchers::Nobody,
        babble: false,
    };
}

fn check(name: &str, model: Network) {
    let begun = Instant::now();
    let checker = model.checker().threads(2).spawn_bfs().join();
    // Not through the test harness, which hides the output of tests that pass.
    let _ = writeln!(
        std::io::stderr(),
        "{name}: {} states, {} of them different, depth {}, {:.1} s",
        checker.state_count(),
        checker.unique_state_count(),
        checker.max_depth(),
        begun.elapsed().as_secs_f64()
    );
    for (name, path) in checker.discoveries() {
        let property = checker.model().property(name);
        if property.expectation == Expectation::Always {
            let path = path.into_vec();
            let broken = path.iter().position(|(state, _)| state.violation.is_some());
            let end = broken.map_or(path.len(), |at| at + 1);
            for (state, step) in &path[end.saturating_sub(60)..end] {
                state.print(step.as_ref());
            }
            panic!("{name} is broken");
        }
    }
    checker.assert_properties();
}

const FAST_AND_SLOW: [i32; 3] = [DRIFT, -DRIFT, DRIFT];

#[test]
fn starts_in_any_order() {
    check(
        "starts",
        Network {
            losses: 0,
            crashes: 0,
            drifts: vec![FAST_AND_SLOW],
            settled: false,
            timed: false,
            ..Network::PLAIN
        },
    );
}

#[test]
fn a_crash_and_a_loss() {
    check(
        "crash and loss",
        Network {
            losses: 1,
            crashes: 1,
            drifts: vec![FAST_AND_SLOW, FAST_AND_SLOW.map(|drift| -drift)],
            settled: true,
            timed: false,
            ..Network::PLAIN
        },
    );
}

/// Two losses. In the worst case only a backup misses two references in a row. (It
/// would then act as the only master if no messages of a third node told it that
/// the schedule goes on.)
#[test]
fn losses() {
    check(
        "losses",
        Network {
            losses: 2,
            crashes: 0,
            drifts: vec![FAST_AND_SLOW],
            settled: true,
            timed: false,
            ..Network::PLAIN
        },
    );
}

/// Global time over crashes, starts and losses: it runs on, or references announce the step.
#[test]
fn global_time() {
    for (losses, crashes) in [(2, 0), (1, 1)] {
        check(
            "global time",
            Network {
                losses,
                crashes,
                drifts: vec![[0; 3]],
                settled: true,
                timed: true,
                ..Network::PLAIN
            },
        );
    }
}

/// With a guardian: a crash, or two losses, and no node is ever cut.
#[test]
fn a_guardian_cuts_no_good_node() {
    for (losses, crashes) in [(0, 1), (2, 0)] {
        for watchers in [Watchers::Central, Watchers::Own] {
            check("guarded", guarded(watchers, losses, crashes, true));
        }
    }
}

/// `cargo test -p ttcan --test model_check -- --ignored`
#[test]
#[ignore = "seven million states"]
fn a_guardian_cuts_no_good_node_at_the_start_or_after_a_crash_with_a_loss() {
    for watchers in [Watchers::Central, Watchers::Own] {
        check("guarded", guarded(watchers, 1, 1, true));
        check("guarded starts", guarded(watchers, 0, 0, false));
    }
}

fn guarded(watchers: Watchers, losses: u8, crashes: u8, settled: bool) -> Network {
    Network {
        losses,
        crashes,
        drifts: vec![FAST_AND_SLOW],
        settled,
        guarded: watchers,
        ..Network::PLAIN
    }
}

/// Any node begins to babble at any event: it is cut within a basic cycle, no other one is, and
/// within the time of recovery each message of the others is in its windows again.
#[test]
fn a_guardian_cuts_a_babbler() {
    for watchers in [Watchers::Central, Watchers::Own] {
        let network = Network {
            babble: true,
            ..guarded(watchers, 0, 0, true)
        };
        check("babbler", network);
    }
}
