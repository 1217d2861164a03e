//! An in-memory CAN bus. Each node has an oscillator of its own.
//!
//! The simulation is event-driven, in nanoseconds of true time. Frames have their
//! exact stuffed length, nodes contend by arbitration, interrupts are served with a
//! random latency, and frames can be destroyed or missed. The same seed gives the
//! same run.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::vec::Vec;

use crate::{
    Action, Frame, Grant, INTERFRAME_BITS, Id, Node, Reception, Stamp, TransmitOutcome, frame_bits,
};

/// True time in nanoseconds.
pub type SimTime = fugit::TimerInstantU64<1_000_000_000>;

const NANOS_PER_MICRO: u64 = 1000;
/// Bits of an error frame: a flag of at least six bits, another node's flag that
/// overlaps it, and a delimiter of eight bits.
const ERROR_BITS: u64 = 17;
/// Bits of a frame behind its acknowledge slot.
const BEHIND_ACKNOWLEDGE: u64 = 8;

/// A node's oscillator and interrupt latency.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crystal {
    /// Nominal ticks per microsecond.
    pub ticks_per_us: u32,
    /// Deviation from the nominal rate in parts per billion.
    pub ppb: i32,
    /// Counter at time 0.
    pub phase: u32,
    /// Shortest and longest time from an interrupt's cause to its stamp, in
    /// nanoseconds.
    pub interrupt: (u32, u32),
}

impl Crystal {
    /// A perfect oscillator, and interrupts served at once.
    pub const fn perfect(ticks_per_us: u32) -> Self {
        Self {
            ticks_per_us,
            ppb: 0,
            phase: 0,
            interrupt: (0, 0),
        }
    }

    /// Ticks in 10^9 us, rate included.
    fn rate(&self) -> u128 {
        u128::from(self.ticks_per_us) * (1_000_000_000 + i128::from(self.ppb)).unsigned_abs()
    }

    /// The counter at `now`.
    pub fn stamp(&self, now: SimTime) -> Stamp {
        let ticks = u128::from(now.ticks()) * self.rate() / 1_000_000_000_000;
        Stamp(self.phase.wrapping_add(ticks as u32))
    }

    /// The time at which the counter reaches `stamp`; `now` if it has already.
    fn time_of(&self, stamp: Stamp, now: SimTime) -> SimTime {
        let ticks = stamp.ticks_since(self.stamp(now)).max(0).unsigned_abs();
        let nanos = (u128::from(ticks) * 1_000_000_000_000).div_ceil(self.rate());
        SimTime::from_ticks(now.ticks() + nanos as u64)
    }
}

/// What happens to a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fate {
    /// All nodes receive it.
    Delivered,
    /// An error frame destroys it for all.
    Destroyed,
    /// No node is there to acknowledge it: its sender destroys it behind the acknowledge slot.
    NotAcknowledged,
    /// All nodes but this one receive it, by its index.
    MissedBy(usize),
}

impl Fate {
    /// Whether no node receives it.
    pub const fn is_error(self) -> bool {
        matches!(self, Self::Destroyed | Self::NotAcknowledged)
    }
}

/// A frame on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Traffic {
    /// Index of the sender.
    pub sender: usize,
    /// The frame.
    pub frame: Frame,
    /// Start of its start-of-frame bit.
    pub start: SimTime,
    /// End of its last bit.
    pub end: SimTime,
    /// What happened to it.
    pub fate: Fate,
}

/// The applications of the nodes, as the bus calls them.
pub trait Application {
    /// The data for a granted window, `None` to leave it empty. Zeros by default.
    fn payload(&mut self, _node: usize, _grant: &Grant) -> Option<[u8; 8]> {
        Some([0; 8])
    }

    /// A frame was received.
    fn received(&mut self, _node: usize, _frame: &Frame, _reception: Reception, _now: SimTime) {}

    /// A node has silenced its controller: it does not even acknowledge, until it starts again.
    fn silenced(&mut self, _node: usize, _now: SimTime) {}

    /// Decides what happens to a frame that begins now.
    fn fate(&mut self, _sender: usize, _frame: &Frame, _now: SimTime) -> Fate {
        Fate::Delivered
    }

    /// A frame begins together with the one of which [`fate`](Application::fate) decides next, and has its identifier.
    fn contends(&mut self, _sender: usize, _frame: &Frame) {}

    /// The bit, counted from the start of the frame of which [`fate`](Application::fate) just said that it is destroyed,
    /// behind which its error frame begins. By chance if it does not say.
    fn destroyed_at(&mut self) -> Option<u32> {
        None
    }
}

/// Sends zeros in every window, without faults.
#[derive(Clone, Copy, Debug, Default)]
pub struct Quiet;

impl Application for Quiet {}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Event {
    /// The receive interrupt of a node in this life; see [`Station::life`].
    Receive(usize, u32),
    /// The transmit interrupt of a node in this life.
    Report(usize, u32, Report),
    /// The timer interrupt of a node, unless the timer was set again since.
    Timer(usize, u32),
    /// The bus may be idle, so that a frame can begin.
    Start,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Report {
    Sent,
    Lost,
    Error,
    Aborted,
}

#[derive(Debug)]
struct Station<'s, const W: usize, const P: usize, const Q: usize> {
    node: Node<'s, W, P, Q>,
    crystal: Crystal,
    mailbox: Option<(Frame, SimTime)>,
    transmitting: bool,
    powered: bool,
    silent: bool,
    /// Number of starts, so that no event from before a start takes effect.
    life: u32,
    /// Number of times the timer was set.
    timer: u32,
}

/// A bus with its nodes.
#[derive(Debug)]
pub struct Bus<'s, A, const W: usize, const P: usize, const Q: usize> {
    stations: Vec<Station<'s, W, P, Q>>,
    /// The applications of all nodes.
    pub application: A,
    bit: u64,
    now: SimTime,
    idle_at: SimTime,
    queue: BinaryHeap<Reverse<(SimTime, u64, Event)>>,
    sequence: u64,
    frames: Vec<(Frame, SimTime)>,
    random: u64,
    /// Every frame on the bus so far.
    pub traffic: Vec<Traffic>,
}

impl<'s, A: Application, const W: usize, const P: usize, const Q: usize> Bus<'s, A, W, P, Q> {
    /// A bus of `bit_rate` bit/s without nodes.
    pub fn new(bit_rate: u32, application: A, seed: u64) -> Self {
        Self {
            stations: Vec::new(),
            application,
            bit: 1_000_000 * NANOS_PER_MICRO / u64::from(bit_rate.max(1)),
            now: SimTime::from_ticks(0),
            idle_at: SimTime::from_ticks(0),
            queue: BinaryHeap::new(),
            sequence: 0,
            frames: Vec::new(),
            random: seed,
            traffic: Vec::new(),
        }
    }

    /// Adds a node without power. Returns its index.
    pub fn add(&mut self, node: Node<'s, W, P, Q>, crystal: Crystal) -> usize {
        self.stations.push(Station {
            node,
            crystal,
            mailbox: None,
            transmitting: false,
            powered: false,
            silent: false,
            life: 0,
            timer: 0,
        });
        self.stations.len() - 1
    }

    /// True time.
    pub fn now(&self) -> SimTime {
        self.now
    }

    /// The node of this index.
    ///
    /// # Panics
    /// There is no such node.
    pub fn node(&self, index: usize) -> &Node<'s, W, P, Q> {
        &self.stations[index].node
    }

    /// Whether a node has power.
    pub fn is_powered(&self, index: usize) -> bool {
        self.stations[index].powered
    }

    /// A node's counter now.
    pub fn stamp(&self, index: usize) -> Stamp {
        self.stations[index].crystal.stamp(self.now)
    }

    /// Changes a node's rate from now on. Its counter continues without a step.
    pub fn drift(&mut self, index: usize, ppb: i32) {
        let now = self.now;
        let station = &mut self.stations[index];
        let before = station.crystal.stamp(now);
        station.crystal.ppb = ppb;
        let after = station.crystal.stamp(now);
        station.crystal.phase = station
            .crystal
            .phase
            .wrapping_add(before.0.wrapping_sub(after.0));
        self.arm(index);
    }

    /// Switches a node on and calls [`Node::start`], also after S3.
    pub fn start(&mut self, index: usize) {
        let station = &mut self.stations[index];
        station.powered = true;
        station.silent = false;
        station.life += 1;
        station.mailbox = None;
        station.node.start(station.crystal.stamp(self.now));
        self.serve(index);
    }

    /// Switches a node off, at any time. `node` is its state after the next start.
    pub fn crash(&mut self, index: usize, node: Node<'s, W, P, Q>) {
        let station = &mut self.stations[index];
        station.powered = false;
        station.transmitting = false;
        station.mailbox = None;
        station.life += 1;
        station.timer += 1;
        station.node = node;
    }

    /// Lets the application use the node, and then serves the node.
    pub fn with<R>(
        &mut self,
        index: usize,
        act: impl FnOnce(&mut Node<'s, W, P, Q>, Stamp) -> R,
    ) -> R {
        let station = &mut self.stations[index];
        let result = act(&mut station.node, station.crystal.stamp(self.now));
        self.serve(index);
        result
    }

    /// Sends a frame without the node's knowledge, as a defective node would.
    pub fn inject(&mut self, index: usize, frame: Frame) {
        self.stations[index].mailbox = Some((frame, self.now));
        self.push(self.now, Event::Start);
    }

    /// Runs until `end`.
    pub fn run_until(&mut self, end: SimTime) {
        while let Some(Reverse((time, _, _))) = self.queue.peek() {
            if *time > end {
                break;
            }
            let Some(Reverse((time, _, event))) = self.queue.pop() else {
                break;
            };
            self.now = time;
            self.handle(event);
        }
        self.now = self.now.max(end);
    }

    /// Runs for `millis` milliseconds.
    pub fn run_millis(&mut self, millis: u64) {
        let nanos = millis * 1000 * NANOS_PER_MICRO;
        self.run_until(SimTime::from_ticks(self.now.ticks() + nanos));
    }

    fn handle(&mut self, event: Event) {
        match event {
            Event::Start => self.arbitrate(),
            Event::Timer(index, timer) => {
                if self.stations[index].timer == timer {
                    self.serve(index);
                }
            }
            Event::Receive(index, life) => {
                let at = self.frames.iter().rposition(|(_, end)| *end <= self.now);
                let Some(&(frame, _)) = at.and_then(|at| self.frames.get(at)) else {
                    return;
                };
                let now = self.now;
                let station = &mut self.stations[index];
                if station.life != life || station.silent {
                    return;
                }
                let stamp = station.crystal.stamp(now);
                let reception = station.node.handle_receive(&frame, stamp);
                self.application.received(index, &frame, reception, now);
                self.serve(index);
            }
            Event::Report(index, life, report) => {
                let now = self.now;
                let station = &mut self.stations[index];
                if station.life != life {
                    return;
                }
                let outcome = match report {
                    Report::Sent => TransmitOutcome::Sent,
                    Report::Lost => TransmitOutcome::ArbitrationLost,
                    Report::Error => TransmitOutcome::Error,
                    Report::Aborted => TransmitOutcome::Aborted,
                };
                station.transmitting = false;
                let stamp = station.crystal.stamp(now);
                station.node.handle_transmit(outcome, stamp);
                self.serve(index);
            }
        }
    }

    /// Carries out the actions of a node and sets its timer.
    fn serve(&mut self, index: usize) {
        let now = self.now;
        let stamp = self.stations[index].crystal.stamp(now);
        if !self.stations[index].powered {
            return;
        }
        while let Some(action) = self.stations[index].node.poll(stamp) {
            match action {
                Action::TransmitReference(frame) | Action::TransmitEvent(frame) => {
                    self.request(index, frame);
                }
                Action::Transmit(grant) => match self.application.payload(index, &grant) {
                    Some(data) => {
                        self.request(index, Frame::from_parts(grant.id, grant.len, data));
                    }
                    None => self.stations[index]
                        .node
                        .handle_transmit(TransmitOutcome::Empty, stamp),
                },
                Action::Abort => {
                    if self.stations[index].mailbox.take().is_some() {
                        self.report(index, Report::Aborted, now);
                    }
                }
                Action::Silence => {
                    self.stations[index].mailbox = None;
                    self.stations[index].silent = true;
                    self.application.silenced(index, now);
                }
            }
        }
        self.arm(index);
    }

    /// Requests a transmission. The controller is ready at the next boundary of its
    /// own bits.
    fn request(&mut self, index: usize, frame: Frame) {
        let ready = self.now.ticks() + self.below(self.bit);
        let ready = SimTime::from_ticks(ready);
        self.stations[index].mailbox = Some((frame, ready));
        self.push(ready, Event::Start);
    }

    fn arm(&mut self, index: usize) {
        let station = &mut self.stations[index];
        station.timer += 1;
        let timer = station.timer;
        if let Some(deadline) = station.node.next_deadline() {
            let due = station.crystal.time_of(deadline, self.now);
            let served = self.interrupt(index, due);
            self.push(served, Event::Timer(index, timer));
        }
    }

    fn interrupt(&mut self, index: usize, cause: SimTime) -> SimTime {
        let (shortest, longest) = self.stations[index].crystal.interrupt;
        let spread = u64::from(longest.saturating_sub(shortest));
        let latency = u64::from(shortest) + self.below(spread + 1);
        SimTime::from_ticks(cause.ticks() + latency)
    }

    fn report(&mut self, index: usize, report: Report, cause: SimTime) {
        let served = self.interrupt(index, cause);
        let life = self.stations[index].life;
        self.push(served, Event::Report(index, life, report));
    }

    /// Lets the nodes that are ready to send contend for the bus, if it is idle.
    fn arbitrate(&mut self) {
        let now = self.now;
        if now < self.idle_at {
            // `occupy` has put a start in the queue for that instant. Another one for each of these
            // would stay there as long as the bus does not rest.
            return;
        }
        let contenders = self.contenders();
        let Some(&(sender, frame)) = contenders.iter().min_by_key(|(_, frame)| frame.id()) else {
            return;
        };
        let collides = |other: &Frame| other.id() == frame.id() && *other != frame;
        for (index, other) in &contenders {
            if *index != sender && other.id() == frame.id() {
                self.application.contends(*index, other);
            }
        }
        let mut fate = self.application.fate(sender, &frame, now);
        let mut heard = false;
        for (index, station) in self.stations.iter().enumerate() {
            heard |= index != sender && station.powered && !station.silent;
        }
        if contenders.iter().any(|(_, other)| collides(other)) {
            // A bit error.
            fate = Fate::Destroyed;
        } else if !heard && fate != Fate::Destroyed {
            fate = Fate::NotAcknowledged;
        }
        let mut winners = Vec::new();
        for &(index, other) in &contenders {
            self.stations[index].mailbox = None;
            if other.id() == frame.id() {
                self.stations[index].transmitting = true;
                winners.push(index);
            } else {
                let decided = SimTime::from_ticks(now.ticks() + 13 * self.bit);
                self.report(index, Report::Lost, decided);
            }
        }
        let sent = self.occupy(sender, frame, fate);
        let report = if fate.is_error() {
            Report::Error
        } else {
            Report::Sent
        };
        for index in winners {
            self.report(index, report, sent.end);
        }
        self.traffic.push(sent);
        if !fate.is_error() {
            self.deliver(&sent);
        }
    }

    /// The nodes that are ready to send, and their frames.
    fn contenders(&self) -> Vec<(usize, Frame)> {
        let ready = |station: &Station<W, P, Q>| match station.mailbox {
            Some((frame, ready)) if ready <= self.now && station.powered && !station.silent => {
                Some(frame)
            }
            _ => None,
        };
        self.stations
            .iter()
            .enumerate()
            .filter_map(|(index, station)| Some((index, ready(station)?)))
            .collect()
    }

    /// Occupies the bus with a frame that begins now.
    fn occupy(&mut self, sender: usize, frame: Frame, fate: Fate) -> Traffic {
        let start = self.now;
        let bits = u64::from(frame_bits(&frame));
        let taken = match fate {
            Fate::Destroyed => {
                let by_chance = 14 + self.below(bits - 14);
                let said = self.application.destroyed_at().map(u64::from);
                said.unwrap_or(by_chance) + ERROR_BITS
            }
            Fate::NotAcknowledged => bits - BEHIND_ACKNOWLEDGE + ERROR_BITS,
            Fate::Delivered | Fate::MissedBy(_) => bits,
        };
        let end = SimTime::from_ticks(start.ticks() + taken * self.bit);
        self.idle_at = SimTime::from_ticks(end.ticks() + u64::from(INTERFRAME_BITS) * self.bit);
        self.push(self.idle_at, Event::Start);
        Traffic {
            sender,
            frame,
            start,
            end,
            fate,
        }
    }

    /// Raises the receive interrupts of a frame.
    fn deliver(&mut self, sent: &Traffic) {
        // A frame is valid for its receivers one bit before its end.
        let valid = SimTime::from_ticks(sent.end.ticks() - self.bit);
        self.frames.push((sent.frame, valid));
        if self.frames.len() > 8 {
            self.frames.remove(0);
        }
        for index in 0..self.stations.len() {
            let station = &self.stations[index];
            if index == sent.sender
                || station.transmitting
                || !station.powered
                || station.silent
                || sent.fate == Fate::MissedBy(index)
            {
                continue;
            }
            let life = station.life;
            let served = self.interrupt(index, valid);
            self.push(served, Event::Receive(index, life));
        }
    }

    fn push(&mut self, time: SimTime, event: Event) {
        self.sequence += 1;
        self.queue.push(Reverse((time, self.sequence, event)));
    }

    /// A number below `end`, 0 for 0 (SplitMix64, Steele et al. 2014).
    fn below(&mut self, end: u64) -> u64 {
        self.random = self.random.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut mixed = self.random;
        mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        mixed ^= mixed >> 31;
        if end == 0 { 0 } else { mixed % end }
    }
}

/// The frames with this identifier that were not destroyed.
pub fn delivered(traffic: &[Traffic], id: Id) -> impl Iterator<Item = &Traffic> {
    traffic
        .iter()
        .filter(move |sent| sent.frame.id() == id && !sent.fate.is_error())
}
