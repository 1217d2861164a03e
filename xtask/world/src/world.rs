//! Everything around the nodes, as one value that a simulation of the nodes drives.
//!
//! The caller moves the world with [`World::advance_to`], hands over the bytes that the nodes
//! send with [`World::serial`], reads voltages with [`World::adc`] and fetches what happens at
//! the nodes' pins with [`World::poll`]. What comes out depends only on scenario, seed and the
//! stamps of the bytes that went in, never on how often or in which steps the caller asks.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use crate::lcd::{self, ACKNOWLEDGE, Display, RowDisplay};
use crate::node::{Analog, Input, Node, Port};
use crate::operator;
use crate::random::{Purpose, Stream};
use crate::receiver::{Fix, Receiver};
use crate::record::{Counters, EffortChange, StateSample};
use crate::scenario::{BusEvent, Scenario};
use crate::syren::{Reception, STOP, Syren};
use crate::time::Span as _;
use crate::time::{PER_SECOND, START, SimDuration, SimTime, after, at, from_seconds};
use crate::units::Quantity;
use crate::vehicle::{Motor, State, Vehicle};

/// Time between two recorded states.
pub const RECORD_PERIOD: SimDuration = SimDuration::from_ticks(PER_SECOND / 100);

/// Full scale of the nodes' converters.
const FULL_SCALE: f64 = 4095.0;

/// Converter reading of a centred joystick.
const CENTRE: f64 = 2048.0;

/// Standard deviation of the noise on the joystick's voltages, counts.
const JOYSTICK_NOISE: f64 = 2.0;

/// What a simulation of the bus is asked to do.
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
        /// How long.
        hold: SimDuration,
    },
}

/// What happens at the nodes or on the bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Effect {
    /// A byte has arrived at a node's serial input: its stop bit ends now.
    Byte {
        /// The node.
        node: Node,
        /// The line.
        port: Port,
        /// The byte.
        byte: u8,
        /// Length of one bit.
        bit_time: SimDuration,
    },
    /// A logic level at the controller changes.
    Level {
        /// The input.
        input: Input,
        /// Its level from now on.
        high: bool,
    },
    /// A node's reset line is pulled low or released.
    Reset {
        /// The node.
        node: Node,
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

/// An output in the queue; `order` keeps those of one instant in the order they were made.
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

/// A foreign frame that is sent again and again.
#[derive(Clone, Debug)]
struct Repeat {
    next: SimTime,
    every: SimDuration,
    until: SimTime,
    what: Disturbance,
}

/// Everything around the nodes.
pub struct World {
    scenario: Scenario,
    now: SimTime,
    vehicle: Vehicle,
    receiver: Receiver,
    fixes: Vec<(SimTime, Fix)>,
    steering: Syren,
    drive: Syren,
    display: Box<dyn Display + Send>,
    lcd_line_free: SimTime,
    levels: [bool; Input::ALL.len()],
    queue: BinaryHeap<Reverse<Queued>>,
    order: u64,
    repeats: Vec<Repeat>,
    ready: VecDeque<Output>,
    next_record: SimTime,
    states: Vec<StateSample>,
    efforts: Vec<EffortChange>,
    counters: Counters,
    analog_noise: Stream,
    clocks: [(f64, f64, bool); Node::ALL.len()],
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
    /// The world of a scenario at the start of its run.
    #[must_use]
    pub fn new(scenario: &Scenario, seed: u64) -> Self {
        let mut clock_errors = Stream::new(seed, Purpose::Clocks);
        let clocks = Node::ALL.map(|node| {
            let clock = scenario.nodes.get(node);
            let crystal = clock_errors.symmetric(50.0);
            let internal = clock_errors.symmetric(10_000.0);
            (
                clock.crystal.map_or(crystal, Quantity::get),
                clock.internal.map_or(internal, Quantity::get),
                clock.external,
            )
        });
        let mut fixes = vec![(START, scenario.receiver.fix)];
        fixes.extend(
            scenario
                .fix
                .iter()
                .map(|change| (at(change.at.span()), change.state)),
        );
        fixes.sort_by_key(|(when, _)| *when);

        let mut world = Self {
            now: START,
            vehicle: Vehicle::new(
                scenario.vehicle.clone(),
                scenario.ground.clone(),
                start(scenario),
            ),
            receiver: Receiver::new(scenario.receiver.clone(), scenario.stream.clone(), seed),
            fixes,
            steering: Syren::new(scenario.vehicle.steering_reversed),
            drive: Syren::new(scenario.vehicle.drive_reversed),
            display: Box::new(RowDisplay::new(
                scenario.lcd.acknowledges,
                scenario.lcd.delay.span(),
            )),
            lcd_line_free: START,
            levels: Input::ALL.map(Input::idle),
            queue: BinaryHeap::new(),
            order: 0,
            repeats: Vec::new(),
            ready: VecDeque::new(),
            next_record: START,
            states: Vec::new(),
            efforts: Vec::new(),
            counters: Counters::default(),
            analog_noise: Stream::new(seed, Purpose::Analog),
            clocks,
            scenario: scenario.clone(),
        };
        world.script();
        world
    }

    /// Puts a display in place of the one that the scenario describes.
    #[must_use]
    pub fn with_display(mut self, display: Box<dyn Display + Send>) -> Self {
        self.display = display;
        self
    }

    /// Queues what the scenario fixes beforehand.
    fn script(&mut self) {
        for change in operator::level_changes(&self.scenario) {
            let what = Effect::Level {
                input: change.input,
                high: change.high,
            };
            self.push(change.at, what);
        }
        for reset in self.scenario.reset.clone() {
            let node = reset.node;
            self.push(at(reset.at.span()), Effect::Reset { node, held: true });
            if let Some(until) = reset.until {
                self.push(at(until.span()), Effect::Reset { node, held: false });
            }
        }
        for event in self.scenario.bus.clone() {
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
                BusEvent::Dominant { at: when, hold } => {
                    let what = Disturbance::Dominant { hold: hold.span() };
                    self.push(at(when.span()), Effect::Bus(what));
                }
            }
        }
    }

    fn push(&mut self, at: SimTime, what: Effect) {
        self.order += 1;
        self.queue.push(Reverse(Queued {
            at,
            order: self.order,
            what,
        }));
    }

    /// Error of a node's 8 MHz clock, parts per million, positive fast.
    #[must_use]
    pub fn crystal_ppm(&self, node: Node) -> f64 {
        self.clocks[node.index()].0
    }

    /// Error of a node's internal oscillator, parts per million, positive fast.
    #[must_use]
    pub fn internal_ppm(&self, node: Node) -> f64 {
        self.clocks[node.index()].1
    }

    /// Whether a node has its 8 MHz clock.
    #[must_use]
    pub fn external_clock(&self, node: Node) -> bool {
        self.clocks[node.index()].2
    }

    /// The instant up to which the world has been moved.
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.now
    }

    /// Not later than the next instant at which something happens at the nodes; it may come to
    /// nothing, because a measurement that has not been taken yet has no bytes yet.
    #[must_use]
    pub fn next_event(&self) -> Option<SimTime> {
        let ready = self.ready.front().map(|output| output.at);
        let queued = self.queue.peek().map(|Reverse(queued)| queued.at);
        let repeated = self.repeats.iter().map(|repeat| repeat.next).min();
        [ready, queued, repeated, Some(self.receiver.next_epoch())]
            .into_iter()
            .flatten()
            .min()
    }

    /// The next instant at which the world looks at the vehicle. A byte that a node sends
    /// earlier may be handed over late, as long as the world has not been moved that far.
    #[must_use]
    pub fn next_coupling(&self) -> SimTime {
        self.receiver.next_epoch().min(self.next_record)
    }

    /// Lets everything happen up to and including `to`. Going back does nothing.
    pub fn advance_to(&mut self, to: SimTime) {
        loop {
            let queued = self.queue.peek().map(|Reverse(queued)| queued.at);
            let repeated = self.repeats.iter().map(|repeat| repeat.next).min();
            let next = [
                Some(self.next_record),
                Some(self.receiver.next_epoch()),
                queued,
                repeated,
            ]
            .into_iter()
            .flatten()
            .min()
            .unwrap_or(to);
            if next > to {
                break;
            }
            // A fixed order within an instant: record, measure, then what reaches the nodes.
            if self.next_record == next {
                self.record(next);
            } else if self.receiver.next_epoch() == next {
                self.measure(next);
            } else if repeated == Some(next) {
                self.repeat(next);
            } else if let Some(Reverse(queued)) = self.queue.pop() {
                self.deliver(queued);
            }
        }
        self.now = self.now.max(to);
    }

    /// The next thing that has happened, in order of time.
    pub fn poll(&mut self) -> Option<Output> {
        self.ready.pop_front()
    }

    fn deliver(&mut self, queued: Queued) {
        if let Effect::Level { input, high } = queued.what {
            let level = &mut self.levels[input.index()];
            if *level == high {
                return;
            }
            *level = high;
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
        self.vehicle.advance_to(now);
        let antenna = self.vehicle.antenna();
        let fix = self.fix(now);
        let bit_time = self.receiver.bit_time();
        for byte in self.receiver.measure(&antenna, fix) {
            self.counters.receiver_bytes += 1;
            let what = Effect::Byte {
                node: Node::Gps,
                port: Port::Receiver,
                byte: byte.byte,
                bit_time,
            };
            self.push(byte.at, what);
        }
    }

    fn record(&mut self, now: SimTime) {
        self.vehicle.advance_to(now);
        let state = self.vehicle.state();
        let antenna = self.vehicle.antenna();
        self.states.push(StateSample {
            at: now,
            north: antenna.north,
            east: antenna.east,
            heading: state.heading,
            steering: state.steering,
            speed: state.speed,
            steering_effort: self.steering.effort(),
            drive_effort: self.drive.effort(),
            fix: self.fix(now),
        });
        self.next_record = after(now, RECORD_PERIOD);
    }

    /// Quality of the solution at `when`.
    #[must_use]
    pub fn fix(&self, when: SimTime) -> Fix {
        let later = self.fixes.partition_point(|(from, _)| *from <= when);
        self.fixes[later.max(1) - 1].1
    }

    /// The level of an input now.
    #[must_use]
    pub fn level(&self, input: Input) -> bool {
        self.levels[input.index()]
    }

    /// A node sent a byte: `start` is the falling edge of its start bit, `end` the end of its
    /// stop bit.
    pub fn serial(&mut self, node: Node, port: Port, byte: u8, start: SimTime, end: SimTime) {
        match (node, port) {
            (Node::Steering, Port::Motor) => self.motor(node, byte, start, end),
            (Node::Drive, Port::Motor) => self.motor(node, byte, start, end),
            (Node::Controller, Port::Lcd) => self.show(byte, start, end),
            _ => self.counters.unheard_bytes += 1,
        }
    }

    fn motor(&mut self, node: Node, byte: u8, start: SimTime, end: SimTime) {
        let driver = self.driver(node);
        let before = (driver.byte(), driver.effort());
        match driver.receive(byte, start, end) {
            Reception::WrongBaud => self.counters.motor_wrong_baud += 1,
            Reception::Accepted => {
                self.counters.motor_bytes += 1;
                self.effort_may_change(node, before, end);
            }
        }
    }

    /// An actuator node closes or opens the relay in its motor's lead.
    pub fn relay(&mut self, node: Node, closed: bool, at: SimTime) {
        if matches!(node, Node::Steering | Node::Drive) {
            let driver = self.driver(node);
            let before = (driver.byte(), driver.effort());
            driver.set_relay(closed);
            self.effort_may_change(node, before, at);
        }
    }

    fn driver(&mut self, node: Node) -> &mut Syren {
        if node == Node::Steering {
            &mut self.steering
        } else {
            &mut self.drive
        }
    }

    /// Records and applies what has become of a driver's last byte and effort.
    fn effort_may_change(&mut self, node: Node, before: (Option<u8>, f64), at: SimTime) {
        let driver = self.driver(node);
        let (byte, effort) = (driver.byte(), driver.effort());
        if before == (byte, effort) {
            return;
        }
        let motor = match node {
            Node::Steering => Motor::Steering,
            _ => Motor::Drive,
        };
        self.vehicle.set_effort(at, motor, effort);
        self.efforts.push(EffortChange {
            at,
            node,
            byte: byte.unwrap_or(STOP),
            effort,
        });
    }

    fn show(&mut self, byte: u8, start: SimTime, end: SimTime) {
        if !lcd::readable(start, end) {
            self.counters.lcd_wrong_baud += 1;
            return;
        }
        let answer = self.display.receive(byte, end);
        self.counters.lcd_commands = self.display.executed();
        self.counters.lcd_refused = self.display.refused();
        if let Some(begin) = answer {
            let bit_time = from_seconds(1.0 / f64::from(lcd::BAUD));
            let done = after(begin.max(self.lcd_line_free), bit_time * 10);
            self.lcd_line_free = done;
            let what = Effect::Byte {
                node: Node::Controller,
                port: Port::Lcd,
                byte: ACKNOWLEDGE,
                bit_time,
            };
            self.push(done, what);
        }
    }

    /// Reading of a 12-bit converter that samples a voltage at `when`. The noise belongs to the
    /// channel and the microsecond, so that asking again gives the same answer.
    pub fn adc(&mut self, channel: Analog, when: SimTime) -> u16 {
        let (volts, deviation) = match channel {
            Analog::SteeringPot => (
                self.vehicle.pot_at(when),
                self.vehicle.parameters().pot_noise.get(),
            ),
            Analog::JoystickX => {
                let (right, _) = operator::joystick(&self.scenario, when);
                (CENTRE + right * (FULL_SCALE - CENTRE), JOYSTICK_NOISE)
            }
            Analog::JoystickY => {
                let (_, forward) = operator::joystick(&self.scenario, when);
                (CENTRE + forward * (FULL_SCALE - CENTRE), JOYSTICK_NOISE)
            }
        };
        self.analog_noise
            .seek(when.as_ticks() / 1_000_000 * 3 + channel as u64);
        let noisy = volts + deviation * self.analog_noise.normal();
        noisy.round().clamp(0.0, FULL_SCALE) as u16
    }

    /// Effort of the motor driver at a node, -1 to 1; 0 for nodes without one.
    #[must_use]
    pub fn effort(&self, node: Node) -> f64 {
        match node {
            Node::Steering => self.steering.effort(),
            Node::Drive => self.drive.effort(),
            Node::Gps | Node::Controller => 0.0,
        }
    }

    /// The vehicle.
    #[must_use]
    pub fn vehicle(&self) -> &Vehicle {
        &self.vehicle
    }

    /// What the display shows.
    #[must_use]
    pub fn lcd_text(&self) -> String {
        self.display.text()
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

/// The scenario's start pose, which places the antenna, as the rear axle's.
fn start(scenario: &Scenario) -> State {
    let pose = &scenario.start;
    let ahead = scenario.vehicle.rear_to_antenna.get();
    let heading = pose.heading.get();
    State {
        north: pose.north.get() - ahead * libm::cos(heading),
        east: pose.east.get() - ahead * libm::sin(heading),
        heading,
        steering: pose.steering.get(),
        speed: pose.speed.get(),
    }
}
