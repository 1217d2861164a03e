//! The whole vehicle: four images, the bus between them, and the world around them.

use crate::image::{Image, ImageError};
use crate::mcu::{Board, FlashTiming, Mcu};
use crate::network::Network;
use crate::part::{Part, Pin};
use crate::peripheral::{ResetCause, UartByte};
use crate::statistics::Load;
use can_bus::{
    Disturbance, Frame, FrameSelect, Level, NodeId, Record, RecordKind, Retry, SeenBy, SimDuration,
    SimTime, Tester,
};
use embedded_can::StandardId;
use std::collections::VecDeque;
use std::sync::Arc;
use world::time::Span as _;
use world::{Analog, Effect, Input, Node, Output, Port, Scenario, World};

/// The ELF files of the four nodes.
#[derive(Clone, Debug)]
pub struct Images {
    /// Time master with the satellite receiver (F446).
    pub gps: Vec<u8>,
    /// Control law, operator's inputs and display (F446).
    pub controller: Vec<u8>,
    /// Steering actuator (F303).
    pub steering: Vec<u8>,
    /// Drive motor (F303).
    pub drive: Vec<u8>,
}

impl Images {
    fn get(&self, node: Node) -> &[u8] {
        match node {
            Node::Gps => &self.gps,
            Node::Controller => &self.controller,
            Node::Steering => &self.steering,
            Node::Drive => &self.drive,
        }
    }
}

/// The microcontroller on a node's sled.
#[must_use]
pub const fn part_of(node: Node) -> &'static Part {
    match node {
        Node::Gps | Node::Controller => Part::F446,
        Node::Steering | Node::Drive => Part::F303,
    }
}

/// Why a vehicle cannot be built.
#[derive(Debug, thiserror::Error)]
#[error("the image of node {}: {error}", node.name())]
pub struct VehicleError {
    /// The node.
    pub node: Node,
    /// What is wrong with its image.
    #[source]
    pub error: ImageError,
}

/// The USART (1..) that a line of the world is wired to.
const fn usart_of(port: Port) -> u8 {
    match port {
        Port::Receiver | Port::Motor => 1,
        Port::Lcd => 3,
    }
}

/// USART of the console on every node.
const CONSOLE: u8 = 2;

/// Pin of an actuator node that closes the relay in its motor's lead, high = closed.
const RELAY: Pin = Pin::new('A', 8);

/// The line behind a USART of a node.
const fn port_of(node: Node, usart: u8) -> Option<Port> {
    match (node, usart) {
        (Node::Gps, 1) => Some(Port::Receiver),
        (Node::Controller, 3) => Some(Port::Lcd),
        (Node::Steering | Node::Drive, 1) => Some(Port::Motor),
        _ => None,
    }
}

/// The controller's pin for an input.
const fn pin_of(input: Input) -> Pin {
    let number = match input {
        Input::RemoteA => 0,
        Input::RemoteB => 1,
        Input::RemoteC => 2,
        Input::RemoteD => 3,
        Input::JoystickSwitch => 4,
        Input::StopLoop => 5,
    };
    Pin::new('C', number)
}

/// Node and ADC channel of an analogue signal.
const fn channel_of(analog: Analog) -> (Node, usize) {
    match analog {
        Analog::JoystickX => (Node::Controller, 0),
        Analog::JoystickY => (Node::Controller, 1),
        // PA0 is channel 1 of the F303's ADC1.
        Analog::SteeringPot => (Node::Steering, 1),
    }
}

/// The analogue inputs follow the world in steps of this; the nodes sample every 5 ms.
const STEP: SimDuration = SimDuration::from_ticks(1_000_000_000);

/// How far ahead of the nodes the world is asked for bytes: more than a byte lasts on any
/// of its lines, so that each is known before its start bit.
const LOOK_AHEAD: SimDuration = SimDuration::from_ticks(300_000_000);

/// Bit of a frame that a scenario's corruption inverts: in the data field, or in the
/// checksum of a frame without data.
const CORRUPTED_BIT: u16 = 25;

/// A running vehicle.
pub struct Vehicle {
    network: Network,
    world: World,
    foreign: NodeId,
    /// Outputs of the world that lie ahead of the nodes.
    ahead: VecDeque<Output>,
    records: Vec<Record>,
    /// Starts of frame so far; several nodes may start one.
    starts: u64,
    last_start: Option<SimTime>,
    consoles: [Vec<u8>; 4],
}

const fn index(node: Node) -> usize {
    match node {
        Node::Gps => 0,
        Node::Controller => 1,
        Node::Steering => 2,
        Node::Drive => 3,
    }
}

/// Parts in 10^9 from parts in 10^6.
fn ppb(ppm: f64) -> i32 {
    (ppm * 1000.0).round() as i32
}

impl Vehicle {
    /// Puts the vehicle together; nothing has run yet.
    ///
    /// # Errors
    /// When an image is no program for its node's microcontroller.
    pub fn new(scenario: &Scenario, seed: u64, images: &Images) -> Result<Self, VehicleError> {
        Self::with_flash(scenario, seed, images, FlashTiming::default())
    }

    /// The same with a choice of what reading the flash costs.
    ///
    /// # Errors
    /// As [`Vehicle::new`].
    pub fn with_flash(
        scenario: &Scenario,
        seed: u64,
        images: &Images,
        flash: FlashTiming,
    ) -> Result<Self, VehicleError> {
        let world = World::new(scenario, seed);
        let mut network = Network::new();
        for node in Node::ALL {
            let image = Image::from_elf(part_of(node), images.get(node))
                .map_err(|error| VehicleError { node, error })?;
            let board = Board {
                external_clock: world.external_clock(node).then_some(8_000_000),
                crystal_ppb: ppb(world.crystal_ppm(node)),
                rc_ppb: ppb(world.internal_ppm(node)),
                flash,
                ..Board::default()
            };
            network.add(Arc::new(image), &board);
        }
        let foreign = network.bus().add_tester(Tester::new());
        let mut vehicle = Self {
            network,
            world,
            foreign,
            ahead: VecDeque::new(),
            records: Vec::new(),
            starts: 0,
            last_start: None,
            consoles: std::array::from_fn(|_| Vec::new()),
        };
        for input in Input::ALL {
            let level = vehicle.world.level(input);
            vehicle
                .node_mut(Node::Controller)
                .drive_pin(pin_of(input), Some(level));
        }
        Ok(vehicle)
    }

    /// How far it has run.
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.network.now()
    }

    /// A node.
    #[must_use]
    pub fn node(&self, node: Node) -> &Mcu {
        self.network.node(index(node))
    }

    /// A node.
    pub fn node_mut(&mut self, node: Node) -> &mut Mcu {
        self.network.node_mut(index(node))
    }

    /// The node that has a place on the bus, `None` for testers.
    #[must_use]
    pub fn node_at(&self, id: NodeId) -> Option<Node> {
        Node::ALL
            .into_iter()
            .find(|&node| self.node(node).node() == Some(id))
    }

    /// Nodes and bus.
    pub fn network(&mut self) -> &mut Network {
        &mut self.network
    }

    /// What surrounds the nodes.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// What went over the bus so far.
    #[must_use]
    pub fn records(&self) -> &[Record] {
        &self.records
    }

    /// What a node wrote on its console so far.
    #[must_use]
    pub fn console(&self, node: Node) -> &[u8] {
        &self.consoles[index(node)]
    }

    /// Runs up to `end`.
    pub fn run_until(&mut self, end: SimTime) {
        while self.now() < end {
            let now = self.now();
            let mut coupling = self.world.next_coupling();
            if coupling <= now {
                self.world.advance_to(now);
                coupling = self.world.next_coupling();
            }
            let step = end.min(now + STEP).min(coupling);
            // Not up to the coupling itself: the bytes that the nodes send until then
            // have to reach the world first.
            let before = SimTime::from_ticks(coupling.as_ticks() - 1);
            self.world.advance_to(before.min(step + LOOK_AHEAD));
            self.collect();
            for analog in [Analog::JoystickX, Analog::JoystickY, Analog::SteeringPot] {
                let (node, channel) = channel_of(analog);
                let count = self.world.adc(analog, now);
                self.node_mut(node).set_analog(channel, count);
            }
            while let Some(output) = self.ahead.pop_front_if(|output| output.at <= step) {
                self.network.run_until(output.at);
                self.apply(&output);
            }
            self.network.run_until(step);
            self.deliver();
        }
    }

    /// Runs from power-on for `duration`, and tells how far it has come after each stretch of
    /// `every`.
    pub fn run_telling(
        &mut self,
        duration: SimDuration,
        every: SimDuration,
        progress: &mut dyn FnMut(Progress),
    ) {
        let end = SimTime::from_ticks(0) + duration;
        while self.now() < end {
            self.run_until(end.min(self.now() + every));
            progress(Progress {
                now: self.now(),
                end,
            });
        }
    }

    /// Takes the world's outputs: bytes go onto their lines at once, the rest waits.
    fn collect(&mut self) {
        while let Some(output) = self.world.poll() {
            if let Effect::Byte {
                node,
                port,
                byte,
                bit_time,
            } = output.what
            {
                let bit = bit_time.as_ticks().max(1);
                let start = SimTime::from_ticks(output.at.as_ticks().saturating_sub(10 * bit));
                let baud = u32::try_from(1_000_000_000_000 / bit).unwrap_or(u32::MAX);
                self.node_mut(node)
                    .feed_uart(usart_of(port), &[byte], start, baud);
            } else {
                self.ahead.push_back(output);
            }
        }
    }

    fn apply(&mut self, output: &Output) {
        match &output.what {
            Effect::Byte { .. } => {}
            Effect::Level { input, high } => self
                .node_mut(Node::Controller)
                .drive_pin(pin_of(*input), Some(*high)),
            Effect::Reset { node, held: true } => self.node_mut(*node).hold_reset(),
            Effect::Reset { node, held: false } => self.node_mut(*node).release_reset(),
            Effect::Bus(disturbance) => self.disturb(disturbance, output.at),
        }
    }

    fn disturb(&mut self, disturbance: &world::Disturbance, at: SimTime) {
        self.take_records();
        let mut bus = self.network.bus();
        match *disturbance {
            world::Disturbance::Frame { id, data, dlc } => {
                if let Some(frame) = Frame::standard(id, &data[..usize::from(dlc.min(8))]) {
                    bus.send_at(self.foreign, at, frame, Retry::UntilSent);
                }
            }
            world::Disturbance::CorruptNext { id, count } => {
                for k in 0..u64::from(count) {
                    let frame = match id.and_then(StandardId::new) {
                        Some(id) => FrameSelect::Id {
                            id: id.into(),
                            occurrence: k,
                        },
                        None => FrameSelect::Number(self.starts + k),
                    };
                    bus.disturb(Disturbance::Flip {
                        frame,
                        bit: CORRUPTED_BIT,
                        seen_by: SeenBy::All,
                    });
                }
            }
            world::Disturbance::Dominant { hold } => bus.disturb(Disturbance::Stuck {
                level: Level::Dominant,
                from: at,
                until: at + hold,
            }),
        }
    }

    fn take_records(&mut self) {
        let records = self.network.bus().drain_records();
        for record in &records {
            if matches!(record.kind, RecordKind::FrameStart { .. })
                && self.last_start != Some(record.at)
            {
                self.last_start = Some(record.at);
                self.starts += 1;
            }
        }
        self.records.extend(records);
    }

    /// Hands what the nodes sent to the world, in the order of time.
    fn deliver(&mut self) {
        self.take_records();
        let mut sent = Vec::new();
        for node in Node::ALL {
            for byte in self.node_mut(node).drain_uart() {
                if byte.usart == CONSOLE {
                    self.consoles[index(node)].push(byte.byte);
                } else {
                    sent.push((byte.end, node, Sent::Byte(byte)));
                }
            }
            for change in self.node_mut(node).drain_pins() {
                if change.pin == RELAY {
                    sent.push((change.at, node, Sent::Relay(change.high)));
                }
            }
        }
        sent.sort_by_key(|(at, ..)| *at);
        for (at, node, what) in sent {
            match what {
                Sent::Relay(closed) => self.world.relay(node, closed, at),
                Sent::Byte(byte) => {
                    if let Some(port) = port_of(node, byte.usart) {
                        self.world
                            .serial(node, port, byte.byte, byte.start, byte.end);
                    }
                }
            }
        }
    }

    /// Ends the run.
    #[must_use]
    pub fn finish(self) -> Outcome {
        let nodes = Node::ALL.map(|node| {
            let mcu = self.node(node);
            NodeOutcome {
                node,
                id: mcu.node(),
                core_hz: mcu.core_hz(),
                load: mcu.load(),
                console: self.consoles[index(node)].clone(),
                resets: mcu.resets().to_vec(),
                locked_up: mcu.is_locked_up(),
                unmodelled: mcu.unmodelled(),
            }
        });
        Outcome {
            duration: self.network.now(),
            records: self.records,
            nodes,
            world: self.world,
        }
    }
}

/// What leaves a node for the world.
enum Sent {
    Byte(UartByte),
    Relay(bool),
}

/// What became of a node in a run.
#[derive(Clone, Debug)]
pub struct NodeOutcome {
    /// The node.
    pub node: Node,
    /// Its place on the bus, as the records name it.
    pub id: Option<NodeId>,
    /// Rate of its core clock at the end, Hz.
    pub core_hz: u64,
    /// Where its cycles went, per task.
    pub load: Load,
    /// What it wrote on its console.
    pub console: Vec<u8>,
    /// Its resets, power-on first.
    pub resets: Vec<(SimTime, ResetCause)>,
    /// Whether it ended in a fault that it could not handle.
    pub locked_up: bool,
    /// Peripheral registers that it used and that are not modelled.
    pub unmodelled: Vec<u32>,
}

/// What a run brought.
#[derive(Debug)]
pub struct Outcome {
    /// Simulated time.
    pub duration: SimTime,
    /// What went over the bus, in the order of time.
    pub records: Vec<Record>,
    /// The nodes, in the order of [`Node::ALL`].
    pub nodes: [NodeOutcome; 4],
    /// The world at the end, with its recordings.
    pub world: World,
}

impl Outcome {
    /// The node that has a place on the bus, `None` for testers.
    #[must_use]
    pub fn node_at(&self, id: NodeId) -> Option<Node> {
        self.nodes
            .iter()
            .find(|outcome| outcome.id == Some(id))
            .map(|outcome| outcome.node)
    }
}

/// How far a run has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Simulated so far.
    pub now: SimTime,
    /// To be simulated.
    pub end: SimTime,
}

/// Settings of a run that are not the scenario's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Seed of everything that is left to chance.
    pub seed: u64,
    /// How long to simulate; the scenario's own duration without it.
    pub duration: Option<SimDuration>,
    /// Simulated time between two calls of the progress function.
    pub progress_every: SimDuration,
    /// What reading the flash costs.
    pub flash: FlashTiming,
}

impl Default for Options {
    /// Seed 1, the scenario's duration, progress every simulated second, flash without wait
    /// states.
    fn default() -> Self {
        Self {
            seed: 1,
            duration: None,
            progress_every: SimDuration::from_ticks(1_000_000_000_000),
            flash: FlashTiming::default(),
        }
    }
}

/// Runs a scenario from power-on to its end.
///
/// # Errors
/// When an image is no program for its node's microcontroller.
pub fn run(
    scenario: &Scenario,
    images: &Images,
    options: &Options,
    mut progress: impl FnMut(Progress),
) -> Result<Outcome, VehicleError> {
    let mut vehicle = Vehicle::with_flash(scenario, options.seed, images, options.flash)?;
    let duration = options.duration.unwrap_or_else(|| scenario.duration.span());
    vehicle.run_telling(duration, options.progress_every, &mut progress);
    Ok(vehicle.finish())
}
