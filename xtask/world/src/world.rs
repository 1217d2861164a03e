//! Everything around the nodes, as one value that a simulation of the nodes drives.
//!
//! The caller advances the world with [`World::advance_to`], passes on the bytes that the nodes
//! send with [`World::serial`], reads voltages with [`World::adc`] and fetches events at the nodes'
//! pins with [`World::poll`]. The outputs depend only on the scenario, the seed and the time stamps
//! of the bytes passed in. They do not depend on how often the caller asks or in which steps it
//! advances.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use vehicle_model::{Device, NodeIndex, Remote};

use crate::crop::Crop;
use crate::lcd::{self, Answer, Display, Lk204};
use crate::line::{Heard, Wave};
use crate::operator;
use crate::random::{Purpose, Stream};
use crate::receiver::{Fix, Receiver};
use crate::record::{
    Character, Counters, EffortChange, Garble, RelayChange, ScreenChange, StateSample,
};
use crate::rover::Side;
use crate::row_drive::{RowDrive, Setting};
use crate::scenario::{BusEvent, Clock, LARGEST_ERROR, Scenario};
use crate::signal::{Analog, Input};
use crate::syren::{STOP, Syren};
use crate::time::Span as _;
use crate::time::{PER_SECOND, START, SimDuration, SimTime, after, at, from_seconds, seconds};
use crate::units::Quantity;
use crate::vehicle::{Motor, Parameters, State, Vehicle};
use crate::victor;

/// Time between two recorded states.
pub const RECORD_PERIOD: SimDuration = SimDuration::from_ticks(PER_SECOND / 100);

/// Full scale of the nodes' converters.
const FULL_SCALE: f64 = 4095.0;

/// Converter reading of a centred joystick.
const CENTRE: f64 = 2048.0;

/// Standard deviation of the noise on the joystick's voltages, counts.
const JOYSTICK_NOISE: f64 = 2.0;

/// Supply and reference of the nodes' converters, volts.
const SUPPLY: f64 = 3.3;

/// Standard deviation of the noise on the line of a distance sensor, counts.
const DISTANCE_NOISE: f64 = 1.0;

/// Standard deviation of the noise on a knob's voltage, counts.
const KNOB_NOISE: f64 = 1.0;

/// Largest error of a motor driver's own clock, a share of one. The maker gives none; this is that
/// of a microcontroller on a trimmed RC oscillator.
const DRIVER_CLOCK: f64 = 0.01;

/// No sender takes longer for a character: at 8 MHz, the divider of 72 MHz makes 2.3 ms of it.
const LONGEST_CHARACTER: SimDuration = SimDuration::from_ticks(3 * PER_SECOND / 1000);

/// A disturbance that the bus model must apply.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Disturbance {
    /// A foreign node queues a data frame.
    Frame {
        /// Standard identifier.
        id: u16,
        /// Data; only the first `dlc` bytes count.
        data: [u8; 8],
        /// Number of bytes, 0 to 8.
        dlc: u8,
    },
    /// The next frames get a wrong bit.
    CorruptNext {
        /// Only frames with this identifier, or any.
        id: Option<u16>,
        /// How many.
        count: u32,
    },
    /// The bus is held dominant.
    Dominant {
        /// From the middle of the next frame with this identifier on; at once if there is none.
        id: Option<u16>,
        /// How long.
        hold: SimDuration,
    },
}

/// An effect on the nodes or on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Effect {
    /// A byte has arrived at a node's serial input: its stop bit ends now.
    Byte {
        /// The node.
        node: NodeIndex,
        /// The device that sent it.
        device: Device,
        /// The byte.
        byte: u8,
        /// Length of one bit.
        bit_time: SimDuration,
    },
    /// A logic level changes.
    Level {
        /// The node that the input is wired to.
        node: NodeIndex,
        /// The input.
        input: Input,
        /// Its level from now on.
        high: bool,
    },
    /// A node's supply changes.
    Supply {
        /// The node.
        node: NodeIndex,
        /// What it is from now on, mV.
        millivolts: u16,
    },
    /// Noise on the line to a node's motor driver reads as a byte.
    WireNoise {
        /// The node.
        node: NodeIndex,
        /// The byte.
        byte: u8,
    },
    /// The relay in the lead of a node's motor sticks: it conducts from now on.
    RelayStuck {
        /// The node.
        node: NodeIndex,
    },
    /// A node's 8 MHz clock stops or comes.
    ExternalClock {
        /// The node.
        node: NodeIndex,
        /// Whether it is there from now on.
        present: bool,
    },
    /// The error of a node's internal oscillator changes, parts in 10^9.
    InternalClock {
        /// The node.
        node: NodeIndex,
        /// The error from now on.
        ppb: i32,
    },
    /// A node's reset line is pulled low or released.
    Reset {
        /// The node.
        node: NodeIndex,
        /// True from the moment it is pulled low.
        held: bool,
    },
    /// Something foreign happens on the bus.
    Bus(Disturbance),
}

/// An effect with its instant.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Output {
    /// When.
    pub at: SimTime,
    /// What.
    pub what: Effect,
}

/// When the start bit of a byte begins whose stop bit ends at `end`.
#[must_use]
pub fn start_bit(end: SimTime, bit_time: SimDuration) -> SimTime {
    SimTime::from_ticks(end.as_ticks().saturating_sub(10 * bit_time.as_ticks()))
}

/// A queued output. `order` preserves the order in which outputs of the same time were made.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Queued {
    at: SimTime,
    order: u64,
    what: Effect,
}

impl Ord for Queued {
    fn cmp(&self, other: &Self) -> core::cmp::Ordering {
        (self.at, self.order).cmp(&(other.at, other.order))
    }
}

impl PartialOrd for Queued {
    fn partial_cmp(&self, other: &Self) -> Option<core::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

/// A foreign frame that is sent periodically.
#[derive(Clone, Debug)]
struct Repeat {
    next: SimTime,
    every: SimDuration,
    until: SimTime,
    what: Disturbance,
}

/// A motor driver at a node.
#[derive(Clone, Debug)]
struct Driver {
    node: NodeIndex,
    device: Device,
    syren: Syren,
}

/// Errors of a node's clocks in parts per million, positive fast.
#[derive(Clone, Copy, Debug)]
struct Clocks {
    crystal: f64,
    internal: f64,
    /// Change of the internal oscillator's error, ppm/s.
    drift: f64,
    /// True if the node has its 8 MHz clock.
    external: bool,
}

/// The display and its serial line.
struct Screen {
    node: Option<NodeIndex>,
    display: Box<dyn Display + Send>,
    line_free: SimTime,
    /// It has got a byte since it was last looked at.
    touched: bool,
    changes: Vec<ScreenChange>,
}

impl Screen {
    /// Records the text if it has changed since the last call.
    fn record(&mut self, now: SimTime) {
        if !core::mem::take(&mut self.touched) {
            return;
        }
        let text = self.display.text();
        if self.changes.last().is_none_or(|last| last.text != text) {
            self.changes.push(ScreenChange { at: now, text });
        }
    }
}

impl Clone for Screen {
    fn clone(&self) -> Self {
        Self {
            display: self.display.copy(),
            changes: self.changes.clone(),
            ..*self
        }
    }
}

/// Everything around the nodes.
#[derive(Clone)]
pub struct World {
    scenario: Scenario,
    now: SimTime,
    machine: Option<Vehicle>,
    receiver: Option<(NodeIndex, Receiver)>,
    fixes: Vec<(SimTime, Fix)>,
    motors: Vec<Driver>,
    screen: Screen,
    /// Characters on the lines of devices, if they are kept.
    characters: Option<Vec<Character>>,
    analogs: Vec<(NodeIndex, Analog)>,
    /// The nodes to which the operator's inputs are wired.
    inputs: [Option<NodeIndex>; Input::ALL.len()],
    levels: [bool; Input::ALL.len()],
    queue: BinaryHeap<Reverse<Queued>>,
    order: u64,
    repeats: Vec<Repeat>,
    ready: VecDeque<Output>,
    next_record: SimTime,
    states: Vec<StateSample>,
    efforts: Vec<EffortChange>,
    relays: Vec<RelayChange>,
    garbles: Vec<Garble>,
    counters: Counters,
    analog_noise: Stream,
    knob_noise: Stream,
    distance_noise: Stream,
    drive: Option<RowDrive>,
    crop: Option<Crop>,
    clocks: Vec<Clocks>,
}

impl core::fmt::Debug for World {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("World")
            .field("scenario", &self.scenario.name)
            .field("now", &self.now)
            .finish_non_exhaustive()
    }
}

impl World {
    /// The world around a vehicle in one of its scenarios, at the start of the run.
    #[must_use]
    pub fn new(vehicle: &vehicle_model::Vehicle, scenario: &Scenario, seed: u64) -> Self {
        let parameters = scenario.vehicle.as_ref();
        let machine = parameters.map(|parameters| {
            Vehicle::new(
                parameters.clone(),
                scenario.ground.clone(),
                start(scenario, parameters),
            )
        });
        let receiver = scenario
            .receiver
            .as_ref()
            .zip(vehicle.node_of(Device::SatelliteReceiver));
        let receiver = receiver.map(|(receiver, node)| {
            let receiver = Receiver::new(receiver.clone(), scenario.stream.clone(), seed)
                .with_inertial(&scenario.inertial);
            (node, receiver)
        });
        let display = Lk204::new(scenario.lcd.acknowledges, scenario.lcd.delay.span());
        let mut world = Self {
            now: START,
            crop: scenario
                .crop
                .as_ref()
                .zip(machine.as_ref())
                .map(|(crop, machine)| Crop::new(crop, &scenario.distance_fault, machine, seed)),
            machine,
            receiver,
            fixes: fixes(scenario),
            motors: motors(vehicle, parameters, seed),
            characters: None,
            screen: Screen {
                node: vehicle.node_of(Device::Display),
                display: Box::new(display),
                line_free: START,
                touched: false,
                changes: Vec::new(),
            },
            analogs: analogs(vehicle),
            inputs: Input::ALL.map(|input| vehicle.node_of(input.device())),
            levels: Input::ALL.map(Input::idle),
            queue: BinaryHeap::new(),
            order: 0,
            repeats: Vec::new(),
            ready: VecDeque::new(),
            next_record: START,
            states: Vec::new(),
            efforts: Vec::new(),
            relays: Vec::new(),
            garbles: Vec::new(),
            counters: Counters::default(),
            analog_noise: Stream::new(seed, Purpose::Analog),
            knob_noise: Stream::new(seed, Purpose::Knobs),
            distance_noise: Stream::new(seed, Purpose::DistanceLines),
            drive: drive(scenario, seed),
            clocks: clocks(scenario, seed),
            scenario: scenario.clone(),
        };
        world.script(vehicle.manifest().operator.remote);
        world
    }

    /// Puts a display in place of the one that the scenario describes.
    #[must_use]
    pub fn with_display(mut self, display: Box<dyn Display + Send>) -> Self {
        self.screen.display = display;
        self
    }

    /// Puts the nodes on a robot that drives along a row.
    #[must_use]
    pub fn with_drive(mut self, drive: RowDrive) -> Self {
        self.drive = Some(drive);
        self
    }

    /// Queues the events of the scenario.
    fn script(&mut self, remote: Remote) {
        for change in operator::level_changes(&self.scenario, remote) {
            if let Some(node) = self.input_node(change.input) {
                let what = Effect::Level {
                    node,
                    input: change.input,
                    high: change.high,
                };
                self.push(change.at, what);
            }
        }
        for reset in self.scenario.reset.clone() {
            let node = reset.node;
            self.push(at(reset.at.span()), Effect::Reset { node, held: true });
            if let Some(until) = reset.until {
                self.push(at(until.span()), Effect::Reset { node, held: false });
            }
        }
        for change in self.scenario.clock.clone() {
            let what = Effect::ExternalClock {
                node: change.node,
                present: change.present,
            };
            self.push(at(change.at.span()), what);
        }
        for dip in self.scenario.brownout.clone() {
            for (after, millivolts) in dip.course() {
                let node = dip.node;
                self.push(at(after), Effect::Supply { node, millivolts });
            }
        }
        for noise in self.scenario.wire.clone() {
            let what = Effect::WireNoise {
                node: noise.node,
                byte: noise.byte,
            };
            self.push(at(noise.at.span()), what);
        }
        for fault in self.scenario.relay.clone() {
            let what = Effect::RelayStuck { node: fault.node };
            self.push(at(fault.at.span()), what);
        }
        for event in self.scenario.bus.clone() {
            self.script_bus(event);
        }
    }

    /// Queues the disturbances of the bus.
    fn script_bus(&mut self, event: BusEvent) {
        match event {
            BusEvent::Frame {
                at: when,
                id,
                data,
                every,
                until,
            } => {
                let mut bytes = [0; 8];
                for (to, from) in bytes.iter_mut().zip(&data) {
                    *to = *from;
                }
                let what = Disturbance::Frame {
                    id,
                    data: bytes,
                    dlc: data.len().min(8) as u8,
                };
                let when = at(when.span());
                match every {
                    None => self.push(when, Effect::Bus(what)),
                    Some(every) => self.repeats.push(Repeat {
                        next: when,
                        every: every.span(),
                        until: until
                            .map_or(SimTime::from_ticks(u64::MAX), |until| at(until.span())),
                        what,
                    }),
                }
            }
            BusEvent::Corrupt {
                at: when,
                id,
                count,
            } => {
                let what = Disturbance::CorruptNext { id, count };
                self.push(at(when.span()), Effect::Bus(what));
            }
            BusEvent::Dominant { at: when, id, hold } => {
                let hold = hold.span();
                let what = Disturbance::Dominant { id, hold };
                self.push(at(when.span()), Effect::Bus(what));
            }
        }
    }

    fn push(&mut self, at: SimTime, what: Effect) {
        if let Effect::Byte {
            node, device, byte, ..
        } = what
        {
            self.note(at, node, device, byte, false);
        }
        self.order += 1;
        self.queue.push(Reverse(Queued {
            at,
            order: self.order,
            what,
        }));
    }

    /// Error of a node's 8 MHz clock, parts per million, positive fast.
    #[must_use]
    pub fn crystal_ppm(&self, node: NodeIndex) -> f64 {
        self.clocks[node.0].crystal
    }

    /// Error of a node's internal oscillator, parts per million, positive fast.
    #[must_use]
    pub fn internal_ppm(&self, node: NodeIndex) -> f64 {
        self.clocks[node.0].internal
    }

    /// Whether a node has its 8 MHz clock.
    #[must_use]
    pub fn external_clock(&self, node: NodeIndex) -> bool {
        self.clocks[node.0].external
    }

    /// The instant up to which the world has been moved.
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.now
    }

    /// A time no later than the next event at the nodes. It may be the time of a measurement, whose
    /// bytes follow later, so that nothing happens at this time itself.
    #[must_use]
    pub fn next_event(&self) -> Option<SimTime> {
        let ready = self.ready.front().map(|output| output.at);
        let queued = self.queue.peek().map(|Reverse(queued)| queued.at);
        let repeated = self.repeats.iter().map(|repeat| repeat.next).min();
        [ready, queued, repeated, self.next_epoch()]
            .into_iter()
            .flatten()
            .min()
    }

    /// The next time at which the world reads the state of the vehicle. A byte that a node sends
    /// before then may be passed on late, as long as the world has not yet been advanced to that
    /// time.
    #[must_use]
    pub fn next_coupling(&self) -> SimTime {
        let others = [self.next_epoch(), self.next_drive(), self.next_crop()];
        others
            .into_iter()
            .flatten()
            .fold(self.next_record, SimTime::min)
    }

    /// When something reads the state of the robot that drives along a row, if there is one.
    fn next_drive(&self) -> Option<SimTime> {
        self.drive.as_ref().map(RowDrive::next_coupling)
    }

    /// When something reads the machine's place in its rows, if there are any.
    fn next_crop(&self) -> Option<SimTime> {
        self.crop.as_ref().map(Crop::next_coupling)
    }

    /// When the receiver, if there is one, takes its next measurement.
    fn next_epoch(&self) -> Option<SimTime> {
        self.receiver
            .as_ref()
            .map(|(_, receiver)| receiver.next_epoch())
    }

    /// Processes all events up to and including `to`. An earlier time than the current one has no
    /// effect.
    pub fn advance_to(&mut self, to: SimTime) {
        loop {
            let queued = self.queue.peek().map(|Reverse(queued)| queued.at);
            let repeated = self.repeats.iter().map(|repeat| repeat.next).min();
            let drive = self.next_drive();
            let crop = self.next_crop();
            let next = [
                Some(self.next_record),
                self.next_epoch(),
                queued,
                repeated,
                drive,
                crop,
            ]
            .into_iter()
            .flatten()
            .min()
            .unwrap_or(to);
            if next > to {
                break;
            }
            // The order of events at the same time is fixed: robot or machine in its row, record,
            // measure, then effects on the nodes.
            if drive == Some(next)
                && let Some(drive) = &mut self.drive
            {
                drive.advance_to(next);
            } else if crop == Some(next)
                && let Some((crop, machine)) = self.crop.as_mut().zip(self.machine.as_mut())
            {
                crop.advance_to(next, machine);
            } else if self.next_record == next {
                self.record(next);
            } else if self.next_epoch() == Some(next) {
                self.measure(next);
            } else if repeated == Some(next) {
                self.repeat(next);
            } else if let Some(Reverse(queued)) = self.queue.pop() {
                self.deliver(queued);
            }
        }
        self.settle_lines(to);
        self.now = self.now.max(to);
    }

    /// The next output, in order of time.
    pub fn poll(&mut self) -> Option<Output> {
        self.ready.pop_front()
    }

    /// The bytes whose start bits begin up to `until`, in the order in which they end; they may end
    /// after the time that the world has been advanced to. The vehicle cannot change them any more.
    pub fn bytes(&mut self, until: SimTime) -> Vec<Output> {
        let mut bytes = Vec::new();
        let mut rest = BinaryHeap::new();
        for Reverse(queued) in std::mem::take(&mut self.queue).into_vec() {
            match queued.what {
                Effect::Byte { bit_time, .. } if start_bit(queued.at, bit_time) <= until => {
                    bytes.push(queued);
                }
                _ => rest.push(Reverse(queued)),
            }
        }
        self.queue = rest;
        bytes.sort_unstable();
        let output = |Queued { at, what, .. }| Output { at, what };
        bytes.into_iter().map(output).collect()
    }

    fn deliver(&mut self, queued: Queued) {
        if let Effect::Level { input, high, .. } = queued.what {
            let level = &mut self.levels[input.index()];
            if *level == high {
                return;
            }
            *level = high;
        }
        if let Effect::WireNoise { node, byte } = queued.what {
            if let Some(index) = self.motors.iter().position(|motor| motor.node == node) {
                let noise = Heard {
                    byte: Some(byte),
                    end: queued.at,
                    genuine: true,
                };
                self.obey(index, &[noise]);
            }
            return;
        }
        if let Effect::RelayStuck { node } = queued.what {
            self.switch(node, queued.at, Syren::stick_relay);
        }
        self.ready.push_back(Output {
            at: queued.at,
            what: queued.what,
        });
    }

    fn repeat(&mut self, now: SimTime) {
        for repeat in self.repeats.iter_mut().filter(|repeat| repeat.next == now) {
            self.ready.push_back(Output {
                at: now,
                what: Effect::Bus(repeat.what.clone()),
            });
            repeat.next = after(repeat.next, repeat.every);
        }
        self.repeats.retain(|repeat| repeat.next < repeat.until);
    }

    fn measure(&mut self, now: SimTime) {
        let fix = self.fix(now);
        let (Some((node, receiver)), Some(machine)) = (&mut self.receiver, &mut self.machine)
        else {
            return;
        };
        machine.advance_to(now);
        let node = *node;
        let bit_time = receiver.bit_time();
        for byte in receiver.measure(&machine.antenna(), fix) {
            self.counters.receiver_bytes += 1;
            let what = Effect::Byte {
                node,
                device: Device::SatelliteReceiver,
                byte: byte.byte,
                bit_time,
            };
            self.push(byte.at, what);
        }
    }

    /// Tells the internal oscillators that drift of their errors.
    fn drift(&mut self, now: SimTime) {
        for (node, clock) in self.clocks.iter().enumerate() {
            if clock.drift == 0.0 {
                continue;
            }
            let error = clock.internal + clock.drift * seconds(now);
            let ppb = (error.clamp(-LARGEST_ERROR, LARGEST_ERROR) * 1000.0) as i32;
            self.ready.push_back(Output {
                at: now,
                what: Effect::InternalClock {
                    node: NodeIndex(node),
                    ppb,
                },
            });
        }
    }

    fn record(&mut self, now: SimTime) {
        self.next_record = after(now, RECORD_PERIOD);
        self.drift(now);
        self.screen.record(now);
        let fix = self.fix(now);
        let effort = |device| {
            let mut motors = self.motors.iter();
            let motor = motors.find(|motor| motor.device == device);
            motor.map_or(0.0, |motor| motor.syren.effort())
        };
        let steering_effort = effort(Device::SteeringMotor);
        let drive_effort = effort(Device::DriveMotor);
        let Some(machine) = &mut self.machine else {
            return;
        };
        machine.advance_to(now);
        let state = machine.state();
        let place = machine.beside_antenna();
        self.states.push(StateSample {
            at: now,
            north: place.north,
            east: place.east,
            heading: state.heading,
            steering: state.steering,
            speed: state.speed,
            steering_effort,
            drive_effort,
            fix,
        });
    }

    /// Quality of the solution at `when`.
    #[must_use]
    pub fn fix(&self, when: SimTime) -> Fix {
        let later = self.fixes.partition_point(|(from, _)| *from <= when);
        let fix = self.fixes.get(later.max(1) - 1);
        fix.map_or(Fix::None, |(_, fix)| *fix)
    }

    /// The level of an input now.
    #[must_use]
    pub fn level(&self, input: Input) -> bool {
        self.levels[input.index()]
    }

    /// The inputs with voltages, and the nodes that convert them.
    #[must_use]
    pub fn analogs(&self) -> &[(NodeIndex, Analog)] {
        &self.analogs
    }

    /// The node that an input is wired to.
    #[must_use]
    pub fn input_node(&self, input: Input) -> Option<NodeIndex> {
        self.inputs[input.index()]
    }

    /// Passes on a byte that a node sent to a device. `start` is the falling edge of its start bit,
    /// `end` the end of its stop bit.
    pub fn serial(
        &mut self,
        node: NodeIndex,
        device: Device,
        byte: u8,
        start: SimTime,
        end: SimTime,
    ) {
        self.wave(node, device, &Wave::steady(byte, start, end));
    }

    /// A node sent a character to one of its devices.
    pub fn wave(&mut self, node: NodeIndex, device: Device, wave: &Wave) {
        self.note(wave.end(), node, device, wave.byte, true);
        if device.has_relay() {
            self.motor(node, wave);
        } else if device == Device::Display && self.screen.node == Some(node) {
            self.show(node, wave.byte, wave.start(), wave.end());
        } else {
            self.counters.unheard_bytes += 1;
        }
    }

    /// Keeps the characters on the lines of all devices from now on.
    pub fn note_characters(&mut self) {
        self.characters.get_or_insert_default();
    }

    /// The characters that were kept, in the order in which they were known.
    #[must_use]
    pub fn characters(&self) -> &[Character] {
        self.characters.as_deref().unwrap_or_default()
    }

    fn note(&mut self, at: SimTime, node: NodeIndex, device: Device, byte: u8, from_node: bool) {
        if let Some(characters) = &mut self.characters {
            characters.push(Character {
                at,
                node,
                device,
                byte,
                from_node,
            });
        }
    }

    fn motor(&mut self, node: NodeIndex, wave: &Wave) {
        let Some(index) = self.motors.iter().position(|motor| motor.node == node) else {
            self.counters.unheard_bytes += 1;
            return;
        };
        let heard = self.motors[index].syren.receive(wave);
        self.obey(index, &heard);
    }

    /// The motor drivers read what is left of their lines.
    fn settle_lines(&mut self, now: SimTime) {
        let known = now.as_ticks().saturating_sub(LONGEST_CHARACTER.as_ticks());
        for index in 0..self.motors.len() {
            let heard = self.motors[index].syren.settle(SimTime::from_ticks(known));
            self.obey(index, &heard);
        }
    }

    /// A motor driver takes what it has read.
    fn obey(&mut self, index: usize, heard: &[Heard]) {
        for heard in heard {
            let Some(motor) = self.motors.get_mut(index) else {
                return;
            };
            let node = motor.node;
            let before = (motor.syren.byte(), motor.syren.effort());
            if !heard.genuine {
                self.counters.motor_garbled += 1;
                self.garbles.push(Garble {
                    at: heard.end,
                    node,
                    byte: heard.byte,
                    closed: motor.syren.is_closed(),
                });
            }
            if let Some(byte) = heard.byte {
                self.counters.motor_bytes += 1;
                motor.syren.obey(byte);
                self.effort_may_change(node, before, heard.end);
            }
        }
    }

    /// A node closes or opens the relay in its motor's lead.
    pub fn relay(&mut self, node: NodeIndex, closed: bool, at: SimTime) {
        self.relays.push(RelayChange { at, node, closed });
        self.switch(node, at, |syren| syren.set_relay(closed));
    }

    fn switch(&mut self, node: NodeIndex, at: SimTime, change: impl FnOnce(&mut Syren)) {
        if let Some(motor) = self.motors.iter_mut().find(|motor| motor.node == node) {
            let before = (motor.syren.byte(), motor.syren.effort());
            change(&mut motor.syren);
            self.effort_may_change(node, before, at);
        }
    }

    /// Level of the line that reads the relay of a node's motor back: low while it conducts.
    /// That holds while the motor driver is stopped; the nodes read it only then.
    #[must_use]
    pub fn relay_sense(&self, node: NodeIndex) -> bool {
        let motor = self.motors.iter().find(|motor| motor.node == node);
        motor.is_none_or(|motor| !motor.syren.is_closed())
    }

    /// Records and applies a change of a driver's last byte or effort since `before`.
    fn effort_may_change(&mut self, node: NodeIndex, before: (Option<u8>, f64), at: SimTime) {
        let Some(motor) = self.motors.iter().find(|motor| motor.node == node) else {
            return;
        };
        let (byte, effort) = (motor.syren.byte(), motor.syren.effort());
        if before == (byte, effort) {
            return;
        }
        let moves = match motor.device {
            Device::SteeringMotor => Some(Motor::Steering),
            Device::DriveMotor => Some(Motor::Drive),
            _ => None,
        };
        if let Some((machine, moves)) = self.machine.as_mut().zip(moves) {
            machine.set_effort(at, moves, effort);
        }
        self.efforts.push(EffortChange {
            at,
            node,
            byte: byte.unwrap_or(STOP),
            effort,
        });
    }

    fn show(&mut self, node: NodeIndex, byte: u8, start: SimTime, end: SimTime) {
        if !lcd::readable(start, end) {
            self.counters.lcd_wrong_baud += 1;
            return;
        }
        self.screen.touched = true;
        let answer = self.screen.display.receive(byte, end);
        self.counters.lcd_commands = self.screen.display.executed();
        self.counters.lcd_refused = self.screen.display.refused();
        if let Some(Answer { at: begin, byte }) = answer {
            let bit_time = from_seconds(1.0 / f64::from(lcd::BAUD));
            let done = after(begin.max(self.screen.line_free), bit_time * 10);
            self.screen.line_free = done;
            let what = Effect::Byte {
                node,
                device: Device::Display,
                byte,
                bit_time,
            };
            self.push(done, what);
        }
    }

    /// Reading of a 12-bit converter that samples a voltage at `when`. The noise is a function of
    /// the channel and the microsecond, so a repeated call returns the same reading.
    pub fn adc(&mut self, channel: Analog, when: SimTime) -> u16 {
        let us = when.as_ticks() / 1_000_000;
        let joystick = |share: f64| CENTRE + share * (FULL_SCALE - CENTRE);
        let (counts, deviation, place) = match channel {
            Analog::JoystickX => {
                let (right, _) = operator::joystick(&self.scenario, when);
                (joystick(right), JOYSTICK_NOISE, us * 3)
            }
            Analog::JoystickY => {
                let (_, forward) = operator::joystick(&self.scenario, when);
                (joystick(forward), JOYSTICK_NOISE, us * 3 + 1)
            }
            Analog::SteeringPot => {
                let Some(machine) = &self.machine else {
                    return 0;
                };
                let noise = machine.parameters().pot_noise.get();
                (machine.pot_at(when), noise, us * 3 + 2)
            }
            Analog::Knob(node) => {
                let way = operator::knob(&self.scenario, node, when);
                (
                    way * FULL_SCALE,
                    KNOB_NOISE,
                    us * self.clocks.len() as u64 + node.0 as u64,
                )
            }
            Analog::Distance(side) => {
                let volts = match (&self.drive, &self.crop, &self.machine) {
                    (Some(drive), ..) => drive.volts(side, when),
                    (_, Some(crop), Some(machine)) => crop.volts(side, when, machine),
                    // There is no sensor.
                    _ => return 0,
                };
                let counts = volts / SUPPLY * FULL_SCALE;
                (counts, DISTANCE_NOISE, 2 * us + side as u64)
            }
        };
        let noise = match channel {
            Analog::Knob(_) => &mut self.knob_noise,
            Analog::Distance(_) => &mut self.distance_noise,
            _ => &mut self.analog_noise,
        };
        noise.seek(place);
        let noisy = counts + deviation * noise.normal();
        noisy.round().clamp(0.0, FULL_SCALE) as u16
    }

    /// The line of a side's motor driver with servo pulses changes to `high` at `at`. It may be passed
    /// on late, like the bytes before [`World::next_coupling`]. Without a robot in a row it has no
    /// effect.
    pub fn servo_edge(&mut self, side: Side, at: SimTime, high: bool) {
        if let Some(drive) = &mut self.drive {
            drive.pulse_edge(side, at, high);
        }
    }

    /// The robot that drives along a row, if there is one.
    #[must_use]
    pub fn drive(&self) -> Option<&RowDrive> {
        self.drive.as_ref()
    }

    /// The rows beside the line of a machine, if there are any.
    #[must_use]
    pub fn crop(&self) -> Option<&Crop> {
        self.crop.as_ref()
    }

    /// The robot that drives along a row, to let its sensors fail.
    pub fn drive_mut(&mut self) -> Option<&mut RowDrive> {
        self.drive.as_mut()
    }

    /// Effort of the motor driver at a node, -1 to 1; 0 for nodes without one.
    #[must_use]
    pub fn effort(&self, node: NodeIndex) -> f64 {
        let motor = self.motors.iter().find(|motor| motor.node == node);
        motor.map_or(0.0, |motor| motor.syren.effort())
    }

    /// The machine, if the vehicle has one.
    #[must_use]
    pub fn machine(&self) -> Option<&Vehicle> {
        self.machine.as_ref()
    }

    /// The text on the display.
    #[must_use]
    pub fn lcd_text(&self) -> String {
        self.screen.display.text()
    }

    /// States recorded so far, every [`RECORD_PERIOD`].
    #[must_use]
    pub fn states(&self) -> &[StateSample] {
        &self.states
    }

    /// Changes of the motor drivers' efforts so far.
    #[must_use]
    pub fn efforts(&self) -> &[EffortChange] {
        &self.efforts
    }

    /// Changes of the relays in the leads of the motors so far, in order of time.
    #[must_use]
    pub fn relays(&self) -> &[RelayChange] {
        &self.relays
    }

    /// What the display showed so far, looked at every [`RECORD_PERIOD`].
    #[must_use]
    pub fn screens(&self) -> &[ScreenChange] {
        &self.screen.changes
    }

    /// What the motor drivers read so far that was not sent to them.
    #[must_use]
    pub fn garbles(&self) -> &[Garble] {
        &self.garbles
    }

    /// Traffic so far.
    #[must_use]
    pub fn counters(&self) -> Counters {
        self.counters
    }

    /// The scenario.
    #[must_use]
    pub fn scenario(&self) -> &Scenario {
        &self.scenario
    }
}

/// Quality of the receiver's solution from each time on; empty without a receiver.
fn fixes(scenario: &Scenario) -> Vec<(SimTime, Fix)> {
    let Some(receiver) = &scenario.receiver else {
        return Vec::new();
    };
    let changes = scenario.fix.iter();
    let mut fixes = vec![(START, receiver.fix)];
    fixes.extend(changes.map(|change| (at(change.at.span()), change.state)));
    fixes.sort_by_key(|(when, _)| *when);
    fixes
}

/// The clocks of all nodes. Errors that the scenario does not set are random.
fn clocks(scenario: &Scenario, seed: u64) -> Vec<Clocks> {
    let mut errors = Stream::new(seed, Purpose::Clocks);
    let draw = |clock: &Clock| {
        let crystal = errors.symmetric(50.0);
        let internal = errors.symmetric(10_000.0);
        Clocks {
            crystal: clock.crystal.map_or(crystal, Quantity::get),
            internal: clock.internal.map_or(internal, Quantity::get),
            drift: clock.drift.get(),
            external: clock.external,
        }
    };
    scenario.nodes.iter().map(draw).collect()
}

/// The rover in its row, if the vehicle has one.
fn drive(scenario: &Scenario, seed: u64) -> Option<RowDrive> {
    let setting = scenario.row.as_ref()?;
    let setting = Setting {
        row: &setting.row,
        rover: setting.rover.clone(),
        mount: setting.mount,
        terrain: setting.terrain.clone(),
        distance: setting.distance.clone(),
        driver_clocks: victor::clocks(seed),
    };
    let mut drive = RowDrive::new(&setting, seed);
    // Ends before begins: one fault may begin when another one ends.
    for fault in &scenario.distance_fault {
        if let Some(until) = fault.until {
            for side in fault.sides() {
                drive.plan_fault(at(until.span()), side, None);
            }
        }
    }
    for fault in &scenario.distance_fault {
        for side in fault.sides() {
            drive.plan_fault(at(fault.at.span()), side, Some(fault.fault));
        }
    }
    Some(drive)
}

/// The motor drivers that are wired, in the order of their nodes.
fn motors(
    vehicle: &vehicle_model::Vehicle,
    machine: Option<&Parameters>,
    seed: u64,
) -> Vec<Driver> {
    let mut errors = Stream::new(seed, Purpose::DeviceClocks);
    let wired = vehicle.nodes().flat_map(|index| {
        let devices = vehicle.node(index).wiring.values();
        let motors = devices.filter(|device| device.has_relay());
        motors.map(move |&device| (index, device))
    });
    let driver = |(node, device)| {
        let reversed = match device {
            Device::SteeringMotor => machine.is_some_and(|machine| machine.steering_reversed),
            Device::DriveMotor => machine.is_some_and(|machine| machine.drive_reversed),
            _ => false,
        };
        Driver {
            node,
            device,
            syren: Syren::new(reversed, errors.symmetric(DRIVER_CLOCK)),
        }
    };
    wired.map(driver).collect()
}

/// The voltages that are wired to nodes.
fn analogs(vehicle: &vehicle_model::Vehicle) -> Vec<(NodeIndex, Analog)> {
    let mut analogs = Vec::new();
    for index in vehicle.nodes() {
        for device in vehicle.node(index).wiring.values() {
            match device {
                Device::Joystick => {
                    analogs.extend([(index, Analog::JoystickX), (index, Analog::JoystickY)]);
                }
                Device::SteeringPotentiometer => analogs.push((index, Analog::SteeringPot)),
                Device::Knob => analogs.push((index, Analog::Knob(index))),
                Device::DistanceSensors => {
                    let sensors = [Side::Left, Side::Right].map(Analog::Distance);
                    analogs.extend(sensors.map(|sensor| (index, sensor)));
                }
                _ => {}
            }
        }
    }
    analogs
}

/// Converts the scenario's start pose to the state of the vehicle. The pose is that of the point on
/// the centre line beside the antenna; the state is that of the rear axle.
fn start(scenario: &Scenario, machine: &Parameters) -> State {
    let pose = &scenario.start;
    let ahead = machine.rear_to_antenna.get();
    let heading = pose.heading.get();
    State {
        north: pose.north.get() - ahead * libm::cos(heading),
        east: pose.east.get() - ahead * libm::sin(heading),
        heading,
        steering: pose.steering.get(),
        speed: pose.speed.get(),
    }
}
