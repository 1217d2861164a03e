//! The faults of a run, drawn from a seed.

use network_model::{Message, WindowKind};
use vehicle_model::{Device, NodeIndex, Remote, Vehicle};
use world::Scenario;
use world::distance::Fault;
use world::random::{Purpose, Stream};
use world::receiver::{Fix, FixChange, StreamFault, StreamFaultKind};
use world::scenario::{
    BrownOut, BusEvent, Button, ButtonPress, Clock, ClockChange, DistanceFault, JoystickMove,
    RelayFault, ResetEvent, Side, StopLoopChange, SupplyChange, WireNoise,
};
use world::units::{Angle, Drift, Length, Ppm, Ratio, Time, Voltage};

use crate::attack::{self, Attack};

/// How much further the wheels could turn than they may, degrees, so that the limit which holds
/// is that of the steering's node.
const BEYOND: f64 = 7.0;

/// Distance from the line at the start, metres.
const BESIDE: f64 = 0.5;

/// How far an RC oscillator may be off, ppm, and how much that may change, ppm/s. Two nodes may drift
/// apart by twice this figure, and stay on the bus: their clocks follow (`ttcan/tests/drift.rs`).
const INTERNAL: f64 = 30_000.0;
const DRIFT: f64 = 300.0;

/// Faults begin from this time on, s: the vehicle is driving then.
const FIRST: f64 = 1.9;
/// No fault begins later, s.
const LAST: f64 = 3.2;
/// Faults with an end have ended by this time, s. A node that its watchdog reset runs again.
pub(crate) const OVER: f64 = 4.2;
/// From here on everybody keeps the schedule again, s.
pub(crate) const SETTLED: f64 = 5.7;
/// End of the run, s.
pub(crate) const END: f64 = 6.5;

/// A node's core stops in the middle of an interrupt of its own, as a latched-up program would:
/// nothing of the same or a lower priority runs again until the watchdog bites.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Upset {
    /// The node whose core stalls.
    pub node: NodeIndex,
    /// From when on its next interrupt is its last, s.
    pub at: f64,
}

/// A node's external clock stops for good.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ClockLoss {
    /// The node whose clock stops.
    pub node: NodeIndex,
    /// From when on, s.
    pub at: f64,
}

/// A sequence of faults.
#[derive(Clone, Debug, PartialEq)]
pub struct Sequence {
    /// The seed that it was drawn from, also of everything else that is left to chance.
    pub seed: u64,
    /// Everything around the nodes.
    pub scenario: Scenario,
    /// Cores that stall.
    pub upsets: Vec<Upset>,
    /// Clocks that stop.
    pub clock_losses: Vec<ClockLoss>,
    /// Number of faults, attacks not included.
    pub faults: usize,
    /// Attacks on the bus.
    pub attacks: Vec<Attack>,
    /// The events, one sentence each.
    pub story: Vec<String>,
}

impl Sequence {
    /// Draws the sequence of a seed for a vehicle.
    #[must_use]
    pub fn draw(vehicle: &Vehicle, seed: u64) -> Self {
        let mut drawing = Drawing::new(vehicle, seed);
        drawing.operator();
        for _ in 0..1 + drawing.stream.below(4) {
            drawing.fault();
        }
        drawing.sequence
    }

    /// Draws the sequence of a seed for a vehicle that is attacked: what the operator does, attacks, and
    /// in one case of four a fault beside them. `key` tells whether the nodes have a key.
    #[must_use]
    pub fn attacked(vehicle: &Vehicle, seed: u64, key: bool) -> Self {
        let mut drawing = Drawing::new(vehicle, seed);
        drawing.operator();
        if drawing.stream.below(4) == 0 {
            drawing.fault();
        }
        let mut sequence = drawing.sequence;
        sequence.scenario.key = key;
        let times = (FIRST, LAST, OVER);
        sequence.attacks = attack::draw(vehicle, seed, times, &mut sequence.story);
        sequence
    }

    /// Spans in which a node's core is stalled and its watchdog has not bitten yet, s.
    #[must_use]
    pub fn stalled(&self, node: NodeIndex) -> Vec<(f64, f64)> {
        /// The next interrupt of the core, which is to stall it, comes within 30 ms; the
        /// watchdog of an actuator node bites 67 ms after its last meal at the latest.
        const LONGEST: f64 = 0.1;
        let upsets = self.upsets.iter().filter(|upset| upset.node == node);
        upsets.map(|upset| (upset.at, upset.at + LONGEST)).collect()
    }

    /// Spans in which a fault of a node may have ended its servo pulses, s. Their drivers keep the last
    /// effort for 100 ms after the last pulse.
    #[must_use]
    pub fn silences(&self, node: NodeIndex) -> Vec<(f64, f64)> {
        const HELD: f64 = 0.11;
        let stalled = self.stalled(node).into_iter();
        let losses = self.clock_losses.iter();
        let losses = losses.filter(|loss| loss.node == node);
        let resets = self.scenario.reset.iter();
        let resets = resets.filter(|reset| reset.node == node);
        let dips = self.scenario.brownout.iter();
        let dips = dips.filter(|dip| dip.node == node);
        stalled
            .chain(losses.map(|loss| (loss.at, loss.at)))
            .chain(resets.map(|reset| (reset.at.get(), reset.at.get())))
            .chain(dips.map(|dip| (dip.at.get(), dip.until.get())))
            .map(|(from, until)| (from, until + HELD))
            .collect()
    }

    /// Whether a node can be time master at the end: it is there, and on its crystal.
    #[must_use]
    pub fn can_lead(&self, node: NodeIndex) -> bool {
        let stopped = self.clock_losses.iter().any(|loss| loss.node == node);
        let clock = self.scenario.nodes[node.0].external || self.is_late(node);
        !self.is_lost(node) && !stopped && clock
    }

    /// Whether a node's external clock comes after its power.
    #[must_use]
    pub fn is_late(&self, node: NodeIndex) -> bool {
        self.scenario.clock.iter().any(|change| change.node == node)
    }

    /// Whether a node is held in reset to the end.
    #[must_use]
    pub fn is_lost(&self, node: NodeIndex) -> bool {
        let mut resets = self.scenario.reset.iter();
        resets.any(|reset| reset.node == node && reset.until.is_none())
    }
}

/// The first events of every sequence.
fn scenario(vehicle: &Vehicle, name: &str) -> Scenario {
    let mut scenario = Scenario::uneventful(vehicle, name);
    scenario.duration = Time::new(END);
    if let Some(machine) = &mut scenario.vehicle {
        let limit = machine.steering_limit.get();
        machine.steering_limit = Angle::new(limit + Angle::degrees(BEYOND).get());
        let start = &mut scenario.start;
        let (sin, cos) = start.heading.get().sin_cos();
        start.north = Length::new(start.north.get() - BESIDE * sin);
        start.east = Length::new(start.east.get() + BESIDE * cos);
    }
    scenario
}

struct Drawing<'a> {
    vehicle: &'a Vehicle,
    stream: Stream,
    sequence: Sequence,
    /// A fault that stops a node or disturbs its motor's line has been drawn.
    hurt: bool,
}

impl<'a> Drawing<'a> {
    fn new(vehicle: &'a Vehicle, seed: u64) -> Self {
        Self {
            vehicle,
            stream: Stream::new(seed, Purpose::Faults),
            sequence: Sequence {
                seed,
                scenario: scenario(vehicle, &format!("faults-{seed}")),
                upsets: Vec::new(),
                clock_losses: Vec::new(),
                faults: 0,
                attacks: Vec::new(),
                story: Vec::new(),
            },
            hurt: false,
        }
    }
}

impl Drawing<'_> {
    fn has(&self, device: Device) -> bool {
        self.vehicle.node_of(device).is_some()
    }

    /// A node and its name.
    fn node(&mut self) -> (NodeIndex, String) {
        let node = NodeIndex(self.stream.below(self.vehicle.nodes().len()));
        (node, self.vehicle.node(node).name.clone())
    }

    /// Identifiers of the network's messages, in the order of the file.
    fn identifiers(&self, kind: impl Fn(&Message) -> bool) -> Vec<u16> {
        let messages = self.vehicle.network().messages.iter();
        let mut ids: Vec<u16> = messages.filter(|m| kind(m)).map(|m| m.id).collect();
        ids.sort_unstable();
        ids
    }

    /// Identifiers of the messages that command motors.
    fn commands(&self) -> Vec<u16> {
        let command = self.vehicle.manifest().command.as_ref();
        self.identifiers(|message| command.is_some_and(|c| c.message == message.name))
    }

    fn within(&mut self, from: f64, to: f64) -> f64 {
        // Whole microseconds, so that the story shows the exact time.
        ((from + (to - from) * self.stream.uniform()) * 1e6).round() * 1e-6
    }

    fn one<T: Copy>(&mut self, of: &[T]) -> T {
        of[self.stream.below(of.len())]
    }

    fn tell(&mut self, sentence: String) {
        self.sequence.story.push(sentence);
    }

    fn press(&mut self, at: f64, button: Button) {
        self.sequence.scenario.press.push(ButtonPress {
            at: Time::new(at),
            button,
            hold: Time::new(0.12),
            bounce: Time::new(0.003),
        });
    }

    /// What the vehicle does when the first fault occurs.
    fn operator(&mut self) {
        let turn = self.stream.below(8);
        if self.has(Device::PinRemote) {
            if turn == 0 {
                return self.tell("it stands still".into());
            }
            self.press(1.0, Button::Run);
            return self.tell("it follows its row".into());
        }
        if !self.has(Device::OperatorSwitches) {
            return;
        }
        match turn {
            0 => self.tell("it stands still".into()),
            1 | 2 if self.has(Device::Joystick) => {
                self.press(1.0, Button::B);
                let forward = self.stream.symmetric(1.0);
                let right = self.stream.symmetric(1.0);
                self.sequence.scenario.joystick.push(JoystickMove {
                    at: Time::new(1.2),
                    right: Ratio::new(right),
                    forward: Ratio::new(forward),
                });
                self.tell(format!(
                    "the joystick drives it, {:.0} % forward and {:.0} % to the right",
                    forward * 100.0,
                    right * 100.0
                ));
            }
            _ => {
                self.press(1.0, Button::C);
                self.press(1.4, Button::C);
                self.tell("it runs along its line".into());
            }
        }
    }

    fn fault(&mut self) {
        self.sequence.faults += 1;
        let at = self.within(FIRST, LAST);
        let kind = self.stream.below(19);
        let of_bus_or_operator = (3..=11).contains(&kind);
        if !of_bus_or_operator && !self.sequence.scenario.relay.is_empty() {
            return self.corrupt(at);
        }
        self.hurt |= !of_bus_or_operator && kind != 18;
        match kind {
            0..=2 => self.hold(at),
            3 => self.foreign(at),
            4 => self.babble(at),
            5 | 6 => self.corrupt(at),
            7 => self.dominant(at),
            8 if self.has(Device::SatelliteReceiver) => self.stream(at),
            9 if self.has(Device::SatelliteReceiver) => self.fix(at),
            8..=10 if self.has(Device::DistanceSensors) => self.distances(at),
            10 if self.has(Device::OperatorSwitches) => self.switches(at),
            11 if self.has(Device::PinRemote) => self.pin_remote(at),
            11 if self.has(Device::OperatorSwitches) => self.stop_loop(at),
            8..=11 => self.corrupt(at),
            12 => self.board(),
            13 => self.clock_loss(at),
            14 => self.late_clock(),
            15 => self.wire(at),
            16 => self.brownout(at),
            18 if !self.hurt => self.relay(at),
            18 => self.corrupt(at),
            _ => self.upset(at),
        }
    }

    fn hold(&mut self, at: f64) {
        let (node, name) = self.node();
        let for_ever = self.stream.below(5) == 0;
        let until = (!for_ever).then(|| self.within(at + 0.001, OVER - 0.1));
        self.sequence.scenario.reset.push(ResetEvent {
            node,
            at: Time::new(at),
            until: until.map(Time::new),
        });
        self.tell(match until {
            Some(until) => format!("{name} is held in reset from {at:.6} s to {until:.6} s"),
            None => format!("{name} is held in reset from {at:.6} s on"),
        });
    }

    /// An identifier that is not a time master's: the protocol has no means to tell a foreign
    /// reference message from a genuine one.
    fn identifier(&mut self) -> u16 {
        // The references of the eight possible masters follow each other.
        let references = self.identifiers(|message| message.window.kind == WindowKind::Reference);
        let is_reference = |id: u16| references.iter().any(|reference| id / 8 == reference / 8);
        let others = self.identifiers(|message| message.window.kind != WindowKind::Reference);
        loop {
            let id = match self.stream.below(2) {
                0 => self.one(&others),
                _ => self.stream.below(0x800) as u16,
            };
            if !is_reference(id) {
                return id;
            }
        }
    }

    fn foreign(&mut self, at: f64) {
        let id = self.identifier();
        let data: Vec<u8> = (0..self.stream.below(9))
            .map(|_| self.stream.byte())
            .collect();
        let every = self.within(0.001, 0.12);
        let until = self.within(at, OVER);
        self.tell(format!(
            "a foreign node sends {id} with {data:02X?} every {every:.6} s from {at:.6} s to {until:.6} s"
        ));
        self.sequence.scenario.bus.push(BusEvent::Frame {
            at: Time::new(at),
            id,
            data,
            every: Some(Time::new(every)),
            until: Some(Time::new(until)),
        });
    }

    fn babble(&mut self, at: f64) {
        let mut ids = self.commands();
        ids.extend([0, 1, 1023, 2047]);
        let id = self.one(&ids);
        let until = self.within(at, at + 0.5);
        self.tell(format!(
            "a foreign node fills the bus with {id} from {at:.6} s to {until:.6} s"
        ));
        // The longest frame takes 540 us.
        self.sequence.scenario.bus.push(BusEvent::Frame {
            at: Time::new(at),
            id,
            data: vec![0x55; 8],
            every: Some(Time::new(550e-6)),
            until: Some(Time::new(until)),
        });
    }

    fn corrupt(&mut self, at: f64) {
        // References and commands twice as often as others.
        let mut ids = self.identifiers(|message| message.window.kind == WindowKind::Reference);
        ids.extend(self.commands());
        ids.extend(self.identifiers(|message| message.window.kind != WindowKind::Arbitrating));
        let id = match self.stream.below(3) {
            0 => None,
            _ => Some(self.one(&ids)),
        };
        let count = 1 + self.stream.below(8) as u32;
        let which = id.map_or("any".to_owned(), |id| format!("identifier {id}"));
        self.tell(format!(
            "from {at:.6} s on the next {count} frames of {which} are destroyed"
        ));
        self.sequence.scenario.bus.push(BusEvent::Corrupt {
            at: Time::new(at),
            id,
            count,
        });
    }

    fn dominant(&mut self, at: f64) {
        // From a glitch to half a second, each size as often as any other.
        let exponent = self.within(-5.0, -0.4);
        let hold = 10_f64.powf(exponent);
        self.tell(format!(
            "the bus is held dominant for {hold:.6} s from {at:.6} s on"
        ));
        self.sequence.scenario.bus.push(BusEvent::Dominant {
            id: None,
            at: Time::new(at),
            hold: Time::new(hold),
        });
    }

    fn stream(&mut self, at: f64) {
        let fault = self.one(&[
            StreamFaultKind::Flip,
            StreamFaultKind::Truncate,
            StreamFaultKind::Length,
            StreamFaultKind::Flood,
            StreamFaultKind::Silence,
        ]);
        let rate = self.within(0.0, 0.3);
        let until = self.within(at, OVER);
        self.tell(format!(
            "the receiver's bytes suffer {fault:?} at {:.1} % from {at:.6} s to {until:.6} s",
            rate * 100.0
        ));
        self.sequence.scenario.stream.push(StreamFault {
            from: Time::new(at),
            until: Some(Time::new(until)),
            fault,
            rate: Ratio::new(rate),
        });
    }

    fn fix(&mut self, at: f64) {
        let state = self.one(&[Fix::None, Fix::Single, Fix::Float]);
        let until = self.within(at, OVER);
        self.tell(format!(
            "the fix is {state:?} from {at:.6} s to {until:.6} s"
        ));
        for (at, state) in [(at, state), (until, Fix::Fixed)] {
            self.sequence.scenario.fix.push(FixChange {
                at: Time::new(at),
                state,
            });
        }
    }

    /// The operator's switches at a time: a press, a receiver of another type than the controller
    /// expects, whose button D is pressed twice, or a receiver without supply.
    /// A distance sensor or its lead fails.
    fn distances(&mut self, at: f64) {
        let side = self.one(&[Side::Left, Side::Right, Side::Both]);
        let fault = self.one(&[
            Fault::Open,
            Fault::ShortedToGround,
            Fault::ShortedToSupply,
            Fault::Frozen,
            Fault::Blind,
        ]);
        let until = self.within(at, OVER);
        self.tell(format!(
            "the distance sensor ({side:?}) is {fault:?} from {at:.6} s to {until:.6} s"
        ));
        self.sequence.scenario.distance_fault.push(DistanceFault {
            side,
            fault,
            at: Time::new(at),
            until: Some(Time::new(until)),
        });
    }

    /// The remote control of a rover: a press of stop, or a receiver without supply.
    fn pin_remote(&mut self, at: f64) {
        if self.stream.below(2) == 0 {
            self.tell(format!("stop is pressed at {at:.6} s"));
            return self.press(at, Button::Stop);
        }
        self.tell(format!(
            "the receiver of the remote has no supply from {at:.6} s on"
        ));
        let at = Time::new(at);
        self.sequence
            .scenario
            .supply
            .push(SupplyChange { at, on: false });
    }

    fn switches(&mut self, at: f64) {
        match self.stream.below(4) {
            0 => {
                let remote = self.one(&[Remote::Toggle, Remote::Latched]);
                self.sequence.scenario.remote.kind = Some(remote);
                self.tell(format!("the receiver of the remote is of type {remote:?}"));
                for at in [at, self.within(at + 0.3, OVER)] {
                    self.tell(format!("button D is pressed at {at:.6} s"));
                    self.press(at, Button::D);
                }
            }
            1 => {
                let until = self.within(at, OVER);
                self.tell(format!(
                    "the receiver of the remote has no supply from {at:.6} s to {until:.6} s"
                ));
                for (at, on) in [(at, false), (until, true)] {
                    let at = Time::new(at);
                    self.sequence.scenario.supply.push(SupplyChange { at, on });
                }
            }
            _ => self.button(at),
        }
    }

    fn button(&mut self, at: f64) {
        let button = self.one(&[Button::A, Button::B, Button::C, Button::D, Button::J]);
        self.tell(format!("button {button:?} is pressed at {at:.6} s"));
        self.press(at, button);
    }

    fn stop_loop(&mut self, at: f64) {
        let until = self.within(at, OVER);
        self.tell(format!(
            "the stop loop is open from {at:.6} s to {until:.6} s"
        ));
        for (at, open) in [(at, true), (until, false)] {
            self.sequence.scenario.stop_loop.push(StopLoopChange {
                at: Time::new(at),
                open,
            });
        }
    }

    /// Faults that are present from the start.
    fn board(&mut self) {
        let internal = self.internal();
        let nodes = self.vehicle.nodes().len();
        let which = self.stream.below(nodes + 1);
        if which == nodes {
            self.sequence.scenario.lcd.acknowledges = false;
            self.tell("the display never answers".into());
            return;
        }
        let node = NodeIndex(which);
        let name = self.vehicle.node(node).name.clone();
        let drift = self.stream.symmetric(DRIFT).round();
        let clock = self.clock(node);
        clock.external = false;
        clock.internal = Some(Ppm::new(internal));
        clock.drift = Drift::new(drift);
        self.tell(format!(
            "{name} has no external clock, its own is off by {internal:.0} ppm and {drift:.0} ppm more each second"
        ));
    }

    /// How far an RC oscillator is off, ppm.
    fn internal(&mut self) -> f64 {
        self.stream.symmetric(INTERNAL).round()
    }

    /// A node's clock comes after its power, before the vehicle drives.
    fn late_clock(&mut self) {
        let internal = self.internal();
        let at = self.within(0.02, 0.6);
        let (node, name) = self.node();
        let clock = self.clock(node);
        clock.external = false;
        clock.internal = Some(clock.internal.unwrap_or(Ppm::new(internal)));
        self.sequence.scenario.clock.push(ClockChange {
            node,
            at: Time::new(at),
            present: true,
        });
        self.tell(format!("the external clock of {name} comes at {at:.6} s"));
    }

    /// A node's supply dips, half of the times so far that the node loses its memory.
    fn brownout(&mut self, at: f64) {
        let (node, name) = self.node();
        let until = self.within(at + 0.000_1, at + 0.3);
        let lowest = if self.stream.below(2) == 0 {
            0.0
        } else {
            self.within(1.6, 3.2)
        };
        let mut dips = self.sequence.scenario.brownout.iter();
        if dips.any(|dip| dip.node == node && dip.overlaps(at, until)) {
            return;
        }
        self.tell(format!(
            "the supply of {name} dips to {lowest:.3} V from {at:.6} s to {until:.6} s"
        ));
        self.sequence.scenario.brownout.push(BrownOut {
            node,
            at: Time::new(at),
            until: Time::new(until),
            lowest: Voltage::new(lowest),
        });
    }

    /// A node with a motor.
    fn motor(&mut self) -> Option<NodeIndex> {
        let motors: Vec<NodeIndex> = self
            .vehicle
            .nodes()
            .filter(|node| {
                let mut devices = self.vehicle.node(*node).wiring.values();
                devices.any(|device| device.has_relay())
            })
            .collect();
        motors.get(self.stream.below(motors.len())).copied()
    }

    /// The relay of a motor sticks. The relay is the remedy against a node that stands still and
    /// against noise on the driver's line, so these faults are not drawn in the same sequence.
    fn relay(&mut self, at: f64) {
        let Some(node) = self.motor() else {
            return self.corrupt(at);
        };
        let name = self.vehicle.node(node).name.clone();
        self.tell(format!("the relay of {name} sticks at {at:.6} s"));
        self.sequence.scenario.relay.push(RelayFault {
            node,
            at: Time::new(at),
        });
    }

    /// Noise on the line to a motor driver.
    fn wire(&mut self, at: f64) {
        let Some(node) = self.motor() else {
            return self.hold(at);
        };
        let byte = self.stream.byte();
        let name = self.vehicle.node(node).name.clone();
        self.tell(format!(
            "noise on the motor's line of {name} reads as {byte:#04X} at {at:.6} s"
        ));
        self.sequence.scenario.wire.push(WireNoise {
            node,
            at: Time::new(at),
            byte,
        });
    }

    fn clock(&mut self, node: NodeIndex) -> &mut Clock {
        &mut self.sequence.scenario.nodes[node.0]
    }

    fn clock_loss(&mut self, at: f64) {
        let (node, name) = self.node();
        let internal = self.internal();
        let clock = self.clock(node);
        clock.internal = Some(clock.internal.unwrap_or(Ppm::new(internal)));
        self.tell(format!("the external clock of {name} stops at {at:.6} s"));
        self.sequence.clock_losses.push(ClockLoss { node, at });
    }

    fn upset(&mut self, at: f64) {
        let (node, name) = self.node();
        self.tell(format!("the core of {name} stalls at {at:.6} s"));
        self.sequence.upsets.push(Upset { node, at });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::uagv;

    #[test]
    fn a_seed_tells_one_story_and_all_stories_end_in_time() {
        assert_eq!(Sequence::draw(&uagv(), 5), Sequence::draw(&uagv(), 5));
        let vehicle = uagv();
        let mut stories = std::collections::BTreeSet::new();
        for seed in 0..500 {
            let sequence = Sequence::draw(&vehicle, seed);
            stories.insert(sequence.story.join("; "));
            for reset in &sequence.scenario.reset {
                assert!(reset.until.is_none_or(|until| until.get() > reset.at.get()));
                assert!(reset.until.is_none_or(|until| until.get() < OVER));
            }
            for upset in &sequence.upsets {
                assert!(upset.at <= LAST);
            }
        }
        assert!(stories.len() > 490);
    }

    #[test]
    fn every_kind_of_fault_is_drawn() {
        let vehicle = uagv();
        let stories: Vec<String> = (0..300)
            .flat_map(|seed| Sequence::draw(&vehicle, seed).story)
            .collect();
        for word in [
            "held in reset",
            "on",
            "foreign node sends",
            "fills the bus",
            "destroyed",
            "dominant",
            "suffer",
            "the fix is",
            "button",
            "of type Toggle",
            "of type Latched",
            "no supply",
            "stop loop",
            "never answers",
            "has no external clock",
            "comes at",
            "noise",
            "sticks",
            "the supply",
            "clock of",
            "stalls",
            "joystick",
            "stands still",
            "along its line",
        ] {
            assert!(stories.iter().any(|story| story.contains(word)), "{word}");
        }
    }
}
