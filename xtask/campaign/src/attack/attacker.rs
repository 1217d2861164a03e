//! The attacker at work: it listens, and decides every few milliseconds what to send next.

use std::collections::BTreeMap;

use can_bus::wire::WireFrame;
use can_bus::{Disturbance, Frame, NodeId, Retry, Tester};
use embedded_can::{Id, StandardId};
use firmware::e2e::{self, CHECK, COUNTER};
use network_model::{Message, Reference, Signal, Window};
use twin::Twin;
use vehicle_model::Vehicle;
use world::random::{Purpose, Stream};
use world::{SimDuration, SimTime};

use super::{Attack, Kind, Role, command};

/// How far ahead it decides, ps.
const STEP: u64 = 25_000_000_000;

/// Where a frame is sent from the beginning of the true frame's window on, us: least and most. The first
/// place takes the bus before the true frame, which may then miss its window; the second one begins
/// with it; the third one is behind it.
const PLACES: [(f64, f64); 3] = [(-600.0, -10.0), (-30.0, 30.0), (400.0, 900.0)];

/// A reference that it received.
#[derive(Clone, Copy, Debug)]
struct Heard {
    /// Start of frame.
    start: SimTime,
    data: [u8; 8],
}

/// A frame that it has decided to send.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Planned {
    pub(crate) at: SimTime,
    pub(crate) frame: Frame,
    /// The attack that it belongs to.
    pub(crate) attack: usize,
}

/// The attacker of a run.
pub(crate) struct Attacker<'a> {
    vehicle: &'a Vehicle,
    attacks: &'a [Attack],
    stream: Stream,
    /// The node that listens and sends single frames, and the one that floods.
    nodes: [NodeId; 2],
    /// Number of frames of the first node that were looked at.
    read: usize,
    reference: Option<Heard>,
    /// Data of the frames received so far, by identifier, and when each was valid.
    recorded: BTreeMap<u16, Vec<(SimTime, Vec<u8>)>>,
    /// Start of the next reference of a drift, by attack.
    next: BTreeMap<usize, SimTime>,
    /// The counter of the last command that it made up.
    counter: u8,
    planned: Vec<Planned>,
}

impl<'a> Attacker<'a> {
    /// Puts it on the bus of a vehicle. Floods and suppressions are prepared to their ends.
    pub(crate) fn join(
        vehicle: &'a Vehicle,
        attacks: &'a [Attack],
        seed: u64,
        twin: &mut Twin,
    ) -> Self {
        let rate = vehicle.network().bit_rate;
        let mut bus = twin.network().bus();
        let nodes = [(); 2].map(|()| bus.add_tester(Tester::new().at_bit_rate(rate)));
        for attack in attacks {
            let (from, until) = (instant(attack.from), instant(attack.until));
            let suppress = |id: Option<u16>, bit| Disturbance::Suppress {
                id: id.and_then(StandardId::new).map(Id::Standard),
                bit,
                spared: Some(nodes[0]),
                from,
                until,
            };
            match &attack.kind {
                Kind::Flood { id } => {
                    if let Some(frame) = Frame::standard(*id, &[0x55; 8]) {
                        bus.babble(nodes[1], frame, from, until);
                    }
                }
                Kind::Suppress { id, bit } => bus.disturb(suppress(*id, *bit)),
                Kind::BusOff { ids, bit, .. } => {
                    for id in ids {
                        bus.disturb(suppress(Some(*id), *bit));
                    }
                }
                _ => {}
            }
        }
        drop(bus);
        Self {
            vehicle,
            attacks,
            stream: Stream::new(seed, Purpose::Attacker),
            nodes,
            read: 0,
            reference: None,
            recorded: BTreeMap::new(),
            next: BTreeMap::new(),
            counter: 0,
            planned: Vec::new(),
        }
    }

    /// Its nodes on the bus, and what it has decided to send, in order of time.
    pub(crate) fn finish(self) -> ([NodeId; 2], Vec<Planned>) {
        (self.nodes, self.planned)
    }

    /// When it decides, s, in order.
    pub(crate) fn steps(attacks: &[Attack]) -> Vec<f64> {
        let from = attacks.iter().map(|attack| attack.from);
        let until = attacks.iter().map(|attack| attack.until);
        let (from, until) = (from.fold(f64::MAX, f64::min), until.fold(0.0, f64::max));
        let step = STEP as f64 * 1e-12;
        let count = ((until - from) / step).ceil() as u32;
        (0..count).map(|k| from + f64::from(k) * step).collect()
    }

    /// Listens, and decides what it sends until its next decision.
    pub(crate) fn decide(&mut self, twin: &mut Twin) {
        self.listen(twin);
        let now = twin.now();
        let end = now + SimDuration::from_ticks(STEP);
        let mut planned = Vec::new();
        for (index, attack) in self.attacks.iter().enumerate() {
            let from = instant(attack.from).max(now);
            let until = instant(attack.until).min(end);
            if from >= until {
                continue;
            }
            let frames = match &attack.kind {
                Kind::Forge { role, id, rate } => self.pose((from, until), *id, *rate, Some(*role)),
                Kind::Replay { id, rate, .. } => self.pose((from, until), *id, *rate, None),
                Kind::RandomFlood { rate } => self.flood((from, until), *rate),
                Kind::Drift { id, step_us } => self.drift(index, (from, until), *id, *step_us),
                Kind::Flood { .. } | Kind::Suppress { .. } | Kind::BusOff { .. } => Vec::new(),
            };
            let frames = frames.into_iter();
            planned.extend(frames.map(|(at, frame)| Planned {
                at,
                frame,
                attack: index,
            }));
        }
        planned.sort_by_key(|planned| planned.at);
        let mut bus = twin.network().bus();
        for planned in &planned {
            bus.send_at(self.nodes[0], planned.at, planned.frame, Retry::Once);
        }
        self.planned.extend(planned);
    }

    fn listen(&mut self, twin: &mut Twin) {
        let bus = twin.network().bus();
        let received = bus.tester(self.nodes[0]).map_or(&[][..], Tester::received);
        let network = self.vehicle.network();
        let bit = 1_000_000_000_000 / u64::from(network.bit_rate);
        for reception in received.iter().skip(self.read) {
            let Id::Standard(id) = reception.frame.id() else {
                continue;
            };
            let id = id.as_raw();
            let Some(message) = network.message(id) else {
                continue;
            };
            let data = reception.frame.data();
            let valid = reception.valid_at;
            if Reference::of(message).is_some() && message.window.start_us == 0 {
                // Valid in the last but one bit, at about three quarters of it.
                let bits = WireFrame::encode(&reception.frame).bits() as u64 - 2;
                let since = SimDuration::from_ticks(bits * bit + bit * 3 / 4);
                self.reference = Some(Heard {
                    start: valid - since,
                    data: bytes(data),
                });
            }
            let of = self.recorded.entry(id).or_default();
            of.push((valid, data.to_vec()));
        }
        self.read = received.len();
    }

    /// Beginnings of the basic cycles with an instant in a span or directly behind it, by the last
    /// reference, and how many cycles each is behind it.
    fn cycles(&self, (from, until): (SimTime, SimTime)) -> Vec<(SimTime, u32)> {
        let Some(reference) = &self.reference else {
            return Vec::new();
        };
        let cycle = u64::from(self.vehicle.network().basic_cycle_us) * 1_000_000;
        let since = from.as_ticks().saturating_sub(reference.start.as_ticks());
        let first = since / cycle;
        let begins = (first..).map(|k| {
            let begin = reference.start + SimDuration::from_ticks(k * cycle);
            (begin, k as u32)
        });
        let ahead = SimDuration::from_ticks(-PLACES[0].0 as u64 * 1_000_000);
        begins
            .take_while(|(begin, _)| *begin < until + ahead)
            .collect()
    }

    /// Frames in the name of another node: one or two at each window of the message within the span, and
    /// `rate` a second at any time. They are replayed if `forged` is `None`.
    fn pose(
        &mut self,
        span: (SimTime, SimTime),
        id: u16,
        rate: f64,
        forged: Option<Role>,
    ) -> Vec<(SimTime, Frame)> {
        let Some(message) = self.vehicle.network().message(id) else {
            return Vec::new();
        };
        let (from, until) = span;
        let mut times = Vec::new();
        for (begin, k) in self.cycles(span) {
            for window in message.windows() {
                if !self.is_in(window, k) {
                    continue;
                }
                for _ in 0..1 + self.stream.below(2) {
                    let (least, most) = PLACES[self.stream.below(PLACES.len())];
                    let offset = least + (most - least) * self.stream.uniform();
                    let us = f64::from(window.start_us) + offset;
                    let at = begin.as_ticks() as i64 + (us * 1e6) as i64;
                    times.push(SimTime::from_ticks(at.max(0) as u64));
                }
            }
        }
        let length = (until - from).as_ticks() as f64;
        let count = rate * length * 1e-12 + self.stream.uniform();
        for _ in 0..count as usize {
            times.push(from + SimDuration::from_ticks((length * self.stream.uniform()) as u64));
        }
        times.retain(|at| (from..until).contains(at));
        times.sort_unstable();
        let frames = times.into_iter().filter_map(|at| {
            let frame = match forged {
                Some(role) => self.forge(message, role, at),
                None => self.replay(id),
            };
            Some((at, frame?))
        });
        frames.collect()
    }

    /// Whether a window is in the basic cycle that is `k` cycles behind the last reference.
    fn is_in(&self, window: Window, k: u32) -> bool {
        let cycles = u32::from(self.vehicle.network().basic_cycles.max(1));
        let count = self
            .layout()
            .zip(self.reference)
            .map_or(0, |(layout, heard)| {
                u32::from(heard.data[usize::from(layout.control)] & 0x3F)
            });
        (count + k) % cycles % u32::from(window.repeat.max(1)) == u32::from(window.offset)
    }

    /// The layout of the reference messages.
    fn layout(&self) -> Option<Reference> {
        let mut messages = self.vehicle.network().messages.iter();
        messages.find_map(Reference::of)
    }

    fn replay(&mut self, id: u16) -> Option<Frame> {
        let recorded = self.recorded.get(&id)?;
        // Often one of the last ones.
        let count = if self.stream.below(2) == 0 {
            recorded.len()
        } else {
            recorded.len().min(3)
        };
        let place = recorded.len() - 1 - self.stream.below(count);
        Frame::standard(id, &recorded[place].1)
    }

    fn forge(&mut self, message: &Message, role: Role, at: SimTime) -> Option<Frame> {
        let (data, length) = match role {
            Role::Command => (self.forged_command(message, at), message.length),
            Role::Reference => (self.forged_reference(message, at)?, message.length),
            Role::Measurement => (self.forged_measurement(message), message.length),
        };
        let length = match self.stream.below(16) {
            0 => self.stream.below(9),
            _ => usize::from(length),
        };
        Frame::standard(message.id, data.get(..length)?)
    }

    /// The last data of a message, or those of a recorded one that `fits`.
    fn base(&mut self, id: u16, fits: impl Fn(&[u8]) -> bool) -> Option<[u8; 8]> {
        let recorded = self.recorded.get(&id)?;
        let fitting = recorded.iter().rev().find(|(_, data)| fits(data));
        fitting.or(recorded.last()).map(|(_, data)| bytes(data))
    }

    fn flip(&mut self, data: &mut [u8; 8]) {
        for _ in 0..1 + self.stream.below(3) {
            data[self.stream.below(8)] ^= 1 << self.stream.below(8);
        }
    }

    /// A number of a signal: each size as often as any other, within the range of the file.
    fn number(&mut self, signal: &Signal) -> i128 {
        let (least, most) = signal.raw_range();
        let size = 1_i128 << self.stream.below(usize::from(signal.size));
        let value = (size as f64 * (1.0 + self.stream.uniform())) as i128;
        let value = if self.stream.below(2) == 0 {
            value
        } else {
            -value
        };
        let (low, high) = signal.count_range().unwrap_or((least, most));
        value.clamp(low.max(least), high.min(most))
    }

    /// A command that lets all motors turn, with the right check value, or an altered one.
    fn forged_command(&mut self, message: &Message, at: SimTime) -> [u8; 8] {
        let enables: Vec<String> = self.enables();
        let enabling = |data: &[u8]| {
            let mut signals = message.signals.iter();
            signals.any(|signal| enables.contains(&signal.name) && signal.extract(data) == 1)
        };
        let kind = self.stream.below(4);
        if kind == 0 {
            let mut data = self.base(message.id, |_| true).unwrap_or_default();
            self.flip(&mut data);
            return data;
        }
        let base = self.base(message.id, enabling);
        let drives = base.is_some_and(|data| enabling(&data));
        let mut data = base.unwrap_or_default();
        for signal in &message.signals {
            let value = match signal.size {
                1 => i128::from(enables.contains(&signal.name)),
                // The code of a mode: that of a recorded command that lets motors turn.
                2..=3 if drives => continue,
                2..=3 => self.stream.below(1 << signal.size) as i128,
                _ => self.number(signal),
            };
            signal.insert(&mut data, value);
        }
        if kind == 1 {
            // A guess of the authentication code.
            (data[COUNTER], data[CHECK]) = (self.stream.byte(), self.stream.byte());
            return data;
        }
        self.seal(message.id, &mut data, at);
        data
    }

    /// Names of the signals that let motors turn.
    fn enables(&self) -> Vec<String> {
        let command = self.vehicle.manifest().command.as_ref();
        let enables = command.map(|command| command.enable.values().cloned().collect());
        enables.unwrap_or_default()
    }

    /// Seals a command as a node without a key does: it continues the counter of the last command, or
    /// its own one, and the check value is that of its basic cycle.
    fn seal(&mut self, id: u16, data: &mut [u8; 8], at: SimTime) {
        let last = self.recorded.get(&id).and_then(|recorded| recorded.last());
        let period = command(self.vehicle).and_then(period).unwrap_or(1);
        self.counter = match last {
            Some((valid, last)) if self.stream.below(2) == 0 => {
                let since = at.as_ticks().saturating_sub(valid.as_ticks());
                let later = ((since + period / 2) / period).max(1);
                bytes(last)[COUNTER].wrapping_add(later as u8)
            }
            _ => self.counter.wrapping_add(1),
        };
        data[COUNTER] = self.counter;
        data[CHECK] = e2e::check_value(id, self.system_time(at), data);
    }

    /// System time of the basic cycle at an instant, ms.
    fn system_time(&self, at: SimTime) -> u32 {
        let (Some(reference), Some(layout)) = (self.reference, self.layout()) else {
            return 0;
        };
        let cycle = u64::from(self.vehicle.network().basic_cycle_us);
        let since = at.as_ticks().saturating_sub(reference.start.as_ticks());
        let later = since / (cycle * 1_000_000) * cycle / 1000;
        coarse(&reference.data, layout).wrapping_add(later as u32)
    }

    /// A reference for the time `at` that continues the last one, or one with another time, a gap, a
    /// discontinuity or random fields.
    fn forged_reference(&mut self, message: &Message, at: SimTime) -> Option<[u8; 8]> {
        let layout = Reference::of(message)?;
        let mut data = self.continued(layout, at)?;
        let control = usize::from(layout.control);
        let shift = |data: &mut [u8; 8], by: i32| {
            let time = coarse(data, layout).wrapping_add_signed(by);
            put_coarse(data, layout, time);
        };
        match self.stream.below(7) {
            0 | 1 => {}
            2 => shift(&mut data, self.stream.below(41) as i32 - 20),
            3 => put_coarse(&mut data, layout, self.stream.bits() as u32),
            4 => data[control] |= 0x80,
            5 => {
                data[control] |= 0x40;
                shift(&mut data, -(self.stream.below(100_000) as i32));
            }
            _ => self.flip(&mut data),
        }
        Some(data)
    }

    /// The reference at the time `at` that follows the last one received.
    fn continued(&self, layout: Reference, at: SimTime) -> Option<[u8; 8]> {
        let reference = self.reference?;
        let network = self.vehicle.network();
        let cycle = u64::from(network.basic_cycle_us);
        let since = at.as_ticks().saturating_sub(reference.start.as_ticks());
        let cycles = (since + cycle * 500_000) / (cycle * 1_000_000);
        let mut data = reference.data;
        let time = coarse(&data, layout).wrapping_add((cycles * cycle / 1000) as u32);
        put_coarse(&mut data, layout, time);
        let control = usize::from(layout.control);
        let count = (u64::from(data[control] & 0x3F) + cycles) % u64::from(network.basic_cycles);
        data[control] = count as u8;
        if let Some(mark) = layout.mark.map(usize::from) {
            let last = u16::from_be_bytes([data[mark], data[mark + 1]]);
            // In 1/32 us.
            let mark_now = last.wrapping_add((cycles * cycle * 32) as u16);
            data[mark..mark + 2].copy_from_slice(&mark_now.to_be_bytes());
        }
        Some(data)
    }

    fn forged_measurement(&mut self, message: &Message) -> [u8; 8] {
        let mut data = self.base(message.id, |_| true).unwrap_or_default();
        if self.stream.below(3) == 0 {
            self.flip(&mut data);
            return data;
        }
        for signal in &message.signals {
            let value = self.number(signal);
            signal.insert(&mut data, value);
        }
        data
    }

    fn flood(&mut self, (from, until): (SimTime, SimTime), rate: f64) -> Vec<(SimTime, Frame)> {
        let mut frames = Vec::new();
        let mut at = from;
        loop {
            let gap = -(1.0 - self.stream.uniform()).ln() / rate;
            at += SimDuration::from_ticks((gap * 1e12) as u64);
            if at >= until {
                return frames;
            }
            let id = [0, 0x7FF][self.stream.below(2)];
            let data: Vec<u8> = (0..self.stream.below(9))
                .map(|_| self.stream.byte())
                .collect();
            frames.extend(Frame::standard(id, &data).map(|frame| (at, frame)));
        }
    }

    /// References whose period is longer than the basic cycle by `step_us`, from a true one on.
    fn drift(
        &mut self,
        index: usize,
        (from, until): (SimTime, SimTime),
        id: u16,
        step_us: f64,
    ) -> Vec<(SimTime, Frame)> {
        let network = self.vehicle.network();
        let Some(layout) = network.message(id).and_then(Reference::of) else {
            return Vec::new();
        };
        let cycle = u64::from(network.basic_cycle_us) * 1_000_000;
        let period = (cycle as i64 + (step_us * 1e6) as i64).max(1) as u64;
        let period = SimDuration::from_ticks(period);
        let start = self.reference.map(|reference| reference.start);
        let Some(mut next) = self.next.get(&index).copied().or(start) else {
            return Vec::new();
        };
        while next < from {
            next += period;
        }
        let mut frames = Vec::new();
        while next < until {
            let data = self.continued(layout, next);
            let frame = data.and_then(|data| Frame::standard(id, &data));
            frames.extend(frame.map(|frame| (next, frame)));
            next += period;
        }
        self.next.insert(index, next);
        frames
    }
}

/// Period of a cyclic message, ps.
fn period(message: &Message) -> Option<u64> {
    match message.send_type {
        network_model::SendType::Cyclic { period_ms } => Some(u64::from(period_ms) * 1_000_000_000),
        _ => None,
    }
}

fn coarse(data: &[u8; 8], layout: Reference) -> u32 {
    let at = layout.coarse.map_or(0, usize::from);
    let field = data.get(at..at + 4).and_then(|bytes| bytes.try_into().ok());
    field.map_or(0, u32::from_be_bytes)
}

fn put_coarse(data: &mut [u8; 8], layout: Reference, time: u32) {
    let at = layout.coarse.map_or(0, usize::from);
    if let Some(field) = data.get_mut(at..at + 4) {
        field.copy_from_slice(&time.to_be_bytes());
    }
}

/// Data as those of an 8-byte message, missing bytes zero.
fn bytes(data: &[u8]) -> [u8; 8] {
    let mut bytes = [0; 8];
    for (to, from) in bytes.iter_mut().zip(data) {
        *to = *from;
    }
    bytes
}

fn instant(seconds: f64) -> SimTime {
    SimTime::from_ticks((seconds * 1e12).round() as u64)
}
