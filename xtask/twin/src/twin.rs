//! A whole vehicle: its nodes with their images, the bus, and the simulated world.

use crate::chain::{Chain, OnWire};
use crate::image::{Image, ImageError};
use crate::mcu::{Board, FlashTiming, Mcu};
use crate::network::Network;
use crate::part::Part;
use crate::peripheral::{ResetCause, UartByte};
use crate::silicon::Violation;
use crate::statistics::Load;
use crate::wiring::{Wiring, WiringError};
use can_bus::{
    Disturbance, Frame, FrameSelect, Level, NodeId, Record, RecordKind, Retry, SeenBy, SimDuration,
    SimTime, Tester,
};
use embedded_can::{Id, StandardId};
use firmware::e2e::Key;
use parts::Sled;
use std::collections::VecDeque;
use std::sync::Arc;
use vehicle_model::{NodeIndex, Override, Vehicle};
use world::line::Wave;
use world::rover::Side;
use world::scenario::Babble;
use world::time::{Span as _, at};
use world::{Analog, Effect, Input, Output, Scenario, World, start_bit};

/// The ELF files of a vehicle's nodes, in the order of its manifest.
#[derive(Clone, Debug, Default)]
pub struct Images {
    files: Vec<Vec<u8>>,
    data: Vec<(NodeIndex, u32, Vec<u8>)>,
}

impl Images {
    /// Takes the contents of the files, in the order of the manifest's nodes.
    #[must_use]
    pub fn new(files: Vec<Vec<u8>>) -> Self {
        Self {
            files,
            data: Vec::new(),
        }
    }

    /// The image of a node; empty if there is none.
    #[must_use]
    pub fn of(&self, node: NodeIndex) -> &[u8] {
        self.files.get(node.0).map_or(&[], Vec::as_slice)
    }

    /// The same images, except that one node's is replaced.
    #[must_use]
    pub fn with(mut self, node: NodeIndex, file: Vec<u8>) -> Self {
        if let Some(image) = self.files.get_mut(node.0) {
            *image = file;
        }
        self
    }

    /// The same images, and bytes at an address of a node's flash, as a debug probe writes them beside its image.
    #[must_use]
    pub fn with_data(mut self, node: NodeIndex, address: u32, bytes: Vec<u8>) -> Self {
        self.data.push((node, address, bytes));
        self
    }

    /// What is beside a node's image in its flash.
    fn data(&self, node: NodeIndex) -> impl Iterator<Item = (u32, &[u8])> {
        let own = self.data.iter().filter(move |data| data.0 == node);
        own.map(|(_, address, bytes)| (*address, bytes.as_slice()))
    }

    /// All nodes and their images.
    pub fn iter(&self) -> impl Iterator<Item = (NodeIndex, &[u8])> {
        let files = self.files.iter().enumerate();
        files.map(|(index, file)| (NodeIndex(index), file.as_slice()))
    }
}

/// Why a vehicle cannot be built, or cannot run on.
#[derive(Debug, thiserror::Error)]
pub enum TwinError {
    /// The scenario is one of a vehicle with other values than this one.
    #[error(
        "scenario {scenario} is one of a vehicle with {missing}, which this one was not built with"
    )]
    Other {
        /// The scenario.
        scenario: String,
        /// The first of its values that the vehicle was built without.
        missing: Box<Override>,
    },
    /// An image does not fit its node's microcontroller.
    #[error("the image of node {node}: {error}")]
    Image {
        /// Name of the node.
        node: String,
        /// What is wrong with its image.
        #[source]
        error: ImageError,
    },
    /// The manifest uses a connection that the board does not have.
    #[error("node {node}: {error}")]
    Wiring {
        /// Name of the node.
        node: String,
        /// What is missing.
        #[source]
        error: WiringError,
    },
    /// A program did what its microcontroller's documents do not allow. What a real part would do
    /// from then on is unknown.
    #[error("node {node} did what its microcontroller does not allow: {violation}")]
    Violation {
        /// Name of the node.
        node: String,
        /// What the program did.
        #[source]
        violation: Box<Violation>,
    },
}

/// Interval at which the analogue inputs follow the world. The nodes sample every 5 ms.
const STEP: SimDuration = SimDuration::from_ticks(1_000_000_000);

/// How far beyond a step the nodes are told what begins on their lines. A core may execute an
/// instruction more than the step.
const LOOK_AHEAD: SimDuration = SimDuration::from_ticks(10_000_000);

/// Index of the frame bit that a scenario's corruption inverts. It is in the data field, or in the
/// checksum of a frame without data.
const CORRUPTED_BIT: u16 = 25;

/// A running vehicle.
pub struct Twin {
    network: Network,
    world: World,
    nodes: Vec<Node>,
    foreign: NodeId,
    /// Outputs of the world that are in the future for the nodes.
    ahead: VecDeque<Output>,
    /// The end of the step in which a node was stopped.
    stopped: Option<SimTime>,
    records: Vec<Record>,
    /// Number of starts of frame so far; nodes that start together count as one.
    starts: u64,
    last_start: Option<SimTime>,
    chain: Chain,
    /// The identifier of the command, and those of the messages that it needs first.
    steps: (Option<u16>, Vec<u16>),
    guardian: Option<NodeIndex>,
    guarded: Vec<NodeIndex>,
    gates: Vec<GateChange>,
    /// Foreign senders that drive the transmit line of a node.
    babblers: Vec<(NodeId, NodeIndex)>,
    /// Bit rate of the bus, bit/s.
    bit_rate: u32,
}

/// The bus guardian closed the gate of a node, or opened it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GateChange {
    /// When.
    pub at: SimTime,
    /// The node behind the gate.
    pub node: NodeIndex,
    /// Whether the gate is closed from then on.
    pub closed: bool,
}

/// A node of the vehicle.
#[derive(Clone)]
struct Node {
    name: String,
    wiring: Wiring,
    console: Vec<u8>,
    /// When each byte on the console ended.
    console_times: Vec<SimTime>,
}

/// Converts parts in 10^6 to parts in 10^9.
fn ppb(ppm: f64) -> i32 {
    (ppm * 1000.0).round() as i32
}

/// Frequency of a node's watchdog oscillator, drawn from the range of its data sheet. The same seed
/// and node give the same one.
fn watchdog_hz(part: &Part, seed: u64, node: NodeIndex) -> u32 {
    // A step of SplitMix64 (Steele, Lea, Flood 2014).
    let mut bits = seed
        .wrapping_mul(0x9E37_79B9_7F4A_7C15)
        .wrapping_add(node.0 as u64 + 1)
        .wrapping_mul(0xBF58_476D_1CE4_E5B9);
    bits = (bits ^ bits >> 27).wrapping_mul(0x94D0_49BB_1331_11EB);
    let span = u64::from(part.lsi.max_hz - part.lsi.min_hz) + 1;
    part.lsi.min_hz + ((bits >> 32) % span) as u32
}

/// The identifier of a vehicle's command, and those of the messages that it needs first.
fn steps(vehicle: &Vehicle) -> (Option<u16>, Vec<u16>) {
    let messages = &vehicle.network().messages;
    let named = |name: &String| messages.iter().find(|message| message.name == *name);
    let command = vehicle.manifest().command.as_ref();
    let Some(command) = command.and_then(|command| named(&command.message)) else {
        return (None, Vec::new());
    };
    let first = command.after.iter().filter_map(named);
    (Some(command.id), first.map(|message| message.id).collect())
}

/// The record of a key that is made from a seed. It protects nothing but a simulation.
fn secret(seed: u64) -> Vec<u8> {
    let mut bytes = *b"simulated \0\0\0\0\0\0";
    bytes[8..].copy_from_slice(&seed.to_le_bytes());
    let record = Key::new(bytes).record();
    record.into_iter().flat_map(u32::to_le_bytes).collect()
}

/// The flash of a node: its image, what is written beside it, and its key with the key's place.
fn flashed(
    part: &'static Part,
    images: &Images,
    node: NodeIndex,
    key: Option<(u32, Vec<u8>)>,
) -> Result<Image, ImageError> {
    let mut image = Image::from_elf(part, images.of(node))?;
    for (address, bytes) in images.data(node) {
        image.program(address, bytes)?;
    }
    if let Some((place, record)) = key {
        image.program(place, &record)?;
    }
    Ok(image)
}

impl Twin {
    /// Builds the vehicle at time zero.
    ///
    /// # Errors
    /// When an image does not fit its node's microcontroller, or the manifest uses a connection
    /// that a board does not have.
    pub fn new(
        vehicle: &Vehicle,
        scenario: &Scenario,
        seed: u64,
        images: &Images,
    ) -> Result<Self, TwinError> {
        Self::with_flash(vehicle, scenario, seed, images, FlashTiming::default())
    }

    /// Like [`Twin::new`], with a choice of the flash timing.
    ///
    /// # Errors
    /// As [`Twin::new`].
    pub fn with_flash(
        vehicle: &Vehicle,
        scenario: &Scenario,
        seed: u64,
        images: &Images,
        flash: FlashTiming,
    ) -> Result<Self, TwinError> {
        if let Some(missing) = scenario.set.missing_in(vehicle.overrides()) {
            return Err(TwinError::Other {
                scenario: scenario.name.clone(),
                missing: Box::new(missing),
            });
        }
        let world = World::new(vehicle, scenario, seed);
        let mut network = Network::new();
        let mut nodes = Vec::new();
        for index in vehicle.nodes() {
            let node = vehicle.node(index);
            let name = node.name.clone();
            let miswired = |error| TwinError::Wiring {
                node: name.clone(),
                error,
            };
            let wiring = Wiring::new(vehicle, index).map_err(miswired)?;
            let part = wiring.sled().part;
            let unfit = |error| TwinError::Image {
                node: name.clone(),
                error,
            };
            let key = scenario
                .key
                .then(|| (wiring.sled().secret.base, secret(seed)));
            let image = flashed(part, images, index, key).map_err(unfit)?;
            let external = world.external_clock(index);
            let board = Board {
                external_clock: external.then_some(wiring.sled().external_hz),
                crystal_ppb: ppb(world.crystal_ppm(index)),
                rc_ppb: ppb(world.internal_ppm(index)),
                watchdog_hz: Some(watchdog_hz(part, seed, index)),
                flash,
                ..Board::default()
            };
            network.add(Arc::new(image), &board);
            nodes.push(Node {
                name,
                wiring,
                console: Vec::new(),
                console_times: Vec::new(),
            });
        }
        if let Some(guardian) = vehicle.guardian() {
            let taps = vehicle.board(guardian).taps.iter();
            let guarded = vehicle.guarded().into_iter().zip(taps);
            let taps = guarded.map(|(node, tap)| (node.0, tap.line, tap.gate));
            network.guard(guardian.0, taps);
        }
        let rate = vehicle.network().bit_rate;
        let foreign = network.bus().add_tester(Tester::new().at_bit_rate(rate));
        let mut twin = Self {
            network,
            world,
            nodes,
            foreign,
            ahead: VecDeque::new(),
            stopped: None,
            records: Vec::new(),
            starts: 0,
            last_start: None,
            chain: Chain::default(),
            steps: steps(vehicle),
            guardian: vehicle.guardian(),
            guarded: vehicle.guarded(),
            gates: Vec::new(),
            babblers: Vec::new(),
            bit_rate: rate,
        };
        for input in Input::ALL {
            if let Some(node) = twin.world.input_node(input) {
                let level = twin.world.level(input);
                twin.drive_input(node, input, level);
            }
        }
        for babble in &scenario.babble {
            twin.babble(babble);
        }
        Ok(twin)
    }

    /// The same vehicle in the same state, as [`Mcu::copy`] makes its nodes. Both run on alike.
    #[must_use]
    pub fn copy(&self) -> Self {
        Self {
            network: self.network.copy(),
            world: self.world.clone(),
            nodes: self.nodes.clone(),
            ahead: self.ahead.clone(),
            records: self.records.clone(),
            chain: self.chain.clone(),
            steps: self.steps.clone(),
            guarded: self.guarded.clone(),
            gates: self.gates.clone(),
            babblers: self.babblers.clone(),
            ..*self
        }
    }

    /// Lets a node babble.
    fn babble(&mut self, babble: &Babble) {
        let Some(babbler) = self.add_babbler(babble.node) else {
            return;
        };
        let (from, until) = (at(babble.at.span()), at(babble.until.span()));
        let bit = 1_000_000_000_000 / u64::from(self.bit_rate.max(1));
        let mut bus = self.network.bus();
        match babble.id.and_then(|id| Frame::standard(id, &[0; 8])) {
            Some(frame) => bus.babble(babbler, frame, from, until),
            None => {
                let bits = (until - from).as_ticks() / bit;
                let levels = vec![Level::Dominant; usize::try_from(bits).unwrap_or(usize::MAX)];
                bus.play_raw(babbler, from, levels);
            }
        }
    }

    /// Puts a level on the pin of an input.
    fn drive_input(&mut self, node: NodeIndex, input: Input, high: bool) {
        if let Some(pin) = self.nodes[node.0].wiring.input(input) {
            self.node_mut(node).drive_pin(pin, Some(high));
        }
    }

    /// The indices of the nodes, in order.
    pub fn nodes(&self) -> impl ExactSizeIterator<Item = NodeIndex> + use<> {
        (0..self.nodes.len()).map(NodeIndex)
    }

    /// Name of a node.
    #[must_use]
    pub fn name(&self, node: NodeIndex) -> &str {
        &self.nodes[node.0].name
    }

    /// The board of a node.
    #[must_use]
    pub fn sled(&self, node: NodeIndex) -> &'static Sled {
        self.nodes[node.0].wiring.sled()
    }

    /// The time up to which it has run.
    #[must_use]
    pub fn now(&self) -> SimTime {
        self.network.now()
    }

    /// A node.
    #[must_use]
    pub fn node(&self, node: NodeIndex) -> &Mcu {
        self.network.node(node.0)
    }

    /// A node.
    pub fn node_mut(&mut self, node: NodeIndex) -> &mut Mcu {
        self.network.node_mut(node.0)
    }

    /// The node with this number on the bus, `None` for testers.
    #[must_use]
    pub fn node_at(&self, id: NodeId) -> Option<NodeIndex> {
        self.nodes()
            .find(|&node| self.node(node).node() == Some(id))
    }

    /// Nodes and bus.
    pub fn network(&mut self) -> &mut Network {
        &mut self.network
    }

    /// The simulated world.
    #[must_use]
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Keeps the characters on the lines between nodes and devices from now on.
    pub fn note_characters(&mut self) {
        self.world.note_characters();
    }

    /// The recorded bus traffic so far.
    #[must_use]
    pub fn records(&self) -> &[Record] {
        &self.records
    }

    /// Moves the recorded traffic out, so that copies of the vehicle need not carry it.
    #[must_use]
    pub fn take_records_so_far(&mut self) -> Vec<Record> {
        std::mem::take(&mut self.records)
    }

    /// Puts the traffic back that was moved out.
    pub fn restore_records(&mut self, mut records: Vec<Record>) {
        records.append(&mut self.records);
        self.records = records;
    }

    /// The bytes that a node has written to its console so far.
    #[must_use]
    pub fn console(&self, node: NodeIndex) -> &[u8] {
        &self.nodes[node.0].console
    }

    /// Samples of the distance sensors and pulses of the motors so far.
    #[must_use]
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// Runs up to `end`, past all stops of probes.
    ///
    /// # Errors
    /// [`TwinError::Violation`] when a program did what its microcontroller's documents do not
    /// allow. The run has then stopped within a millisecond after it.
    pub fn run_until(&mut self, end: SimTime) -> Result<(), TwinError> {
        while self.stopped.is_some() || self.now() < end {
            self.run_step(end)?;
        }
        Ok(())
    }

    /// Runs by a step of a millisecond at most towards `end`, or until a probe stops a node ([`Mcu::stop_at`]);
    /// then the result is false. The next call goes on where this one left: with the same ends, stops
    /// change nothing.
    ///
    /// # Errors
    /// As [`Twin::run_until`].
    pub fn run_step(&mut self, end: SimTime) -> Result<bool, TwinError> {
        let step = self.stopped.take().unwrap_or_else(|| self.begin_step(end));
        if !self.reach(step) {
            self.stopped = Some(step);
            return Ok(false);
        }
        self.deliver();
        self.check()?;
        Ok(true)
    }

    /// Lets the world act for the next step. Returns the step's end.
    fn begin_step(&mut self, end: SimTime) -> SimTime {
        let now = self.now();
        let mut coupling = self.world.next_coupling();
        if coupling <= now {
            self.world.advance_to(now);
            coupling = self.world.next_coupling();
        }
        let step = end.min(now + STEP).min(coupling);
        self.collect();
        for output in self.world.bytes(step + LOOK_AHEAD) {
            self.send(&output);
        }
        // Stop just before the coupling: the bytes that the nodes send until then must reach
        // the world first.
        let before = SimTime::from_ticks(coupling.as_ticks() - 1);
        self.world.advance_to(before.min(step));
        self.collect();
        self.convert(now);
        step
    }

    /// Lets nodes and bus reach the end of a step. False if a probe stops a node.
    fn reach(&mut self, step: SimTime) -> bool {
        while let Some(at) = self.ahead.front().map(|output| output.at)
            && at <= step
        {
            if !self.network.run_to_stop(at) {
                return false;
            }
            if let Some(output) = self.ahead.pop_front() {
                self.apply(&output);
            }
        }
        self.network.run_to_stop(step)
    }

    /// The first violation of any node is an error.
    fn check(&self) -> Result<(), TwinError> {
        for node in self.nodes() {
            if let Some(violation) = self.node(node).first_violation() {
                return Err(TwinError::Violation {
                    node: self.name(node).to_owned(),
                    violation: Box::new(violation),
                });
            }
        }
        Ok(())
    }

    /// Runs from power-on for `duration` and reports the progress after each interval of `every`.
    ///
    /// # Errors
    /// As [`Twin::run_until`].
    pub fn run_telling(
        &mut self,
        duration: SimDuration,
        every: SimDuration,
        progress: &mut dyn FnMut(Progress),
    ) -> Result<(), TwinError> {
        let end = SimTime::from_ticks(0) + duration;
        while self.now() < end {
            self.run_until(end.min(self.now() + every))?;
            progress(Progress {
                now: self.now(),
                end,
            });
        }
        Ok(())
    }

    /// Sets the nodes' analogue inputs to the world's voltages at `now`.
    fn convert(&mut self, now: SimTime) {
        let analogs: Vec<(NodeIndex, Analog)> = self.world.analogs().to_vec();
        for (node, analog) in analogs {
            if let Some(channel) = self.nodes[node.0].wiring.channel(analog) {
                let count = self.world.adc(analog, now);
                self.node_mut(node).set_analog(channel, count);
            }
        }
    }

    /// Fetches the world's outputs. Bytes are sent to their lines at once; the others are queued.
    fn collect(&mut self) {
        while let Some(output) = self.world.poll() {
            if !self.send(&output) {
                self.ahead.push_back(output);
            }
        }
    }

    /// Sends a byte to its line. False for anything else.
    fn send(&mut self, output: &Output) -> bool {
        let Effect::Byte {
            node,
            device,
            byte,
            bit_time,
        } = output.what
        else {
            return false;
        };
        let start = start_bit(output.at, bit_time);
        let bit = bit_time.as_ticks().max(1);
        let baud = u32::try_from(1_000_000_000_000 / bit).unwrap_or(u32::MAX);
        if let Some(usart) = self.nodes[node.0].wiring.usart_of(device) {
            self.node_mut(node).feed_uart(usart, &[byte], start, baud);
        }
        true
    }

    fn apply(&mut self, output: &Output) {
        match &output.what {
            Effect::Byte { .. } | Effect::WireNoise { .. } => {}
            Effect::RelayStuck { node } => self.sense_relay(*node),
            Effect::Level { node, input, high } => self.drive_input(*node, *input, *high),
            Effect::ExternalClock {
                node,
                present: false,
            } => {
                self.node_mut(*node).lose_external_clock();
            }
            Effect::ExternalClock {
                node,
                present: true,
            } => {
                let hertz = self.sled(*node).external_hz;
                self.node_mut(*node).find_external_clock(hertz);
            }
            Effect::InternalClock { node, ppb } => self.node_mut(*node).set_internal_error(*ppb),
            Effect::Supply { node, millivolts } => self.node_mut(*node).set_supply(*millivolts),
            Effect::Reset { node, held: true } => self.node_mut(*node).hold_reset(),
            Effect::Reset { node, held: false } => self.node_mut(*node).release_reset(),
            Effect::Bus(disturbance) => self.disturb(disturbance, output.at),
        }
    }

    /// Sets the line that reads a motor's relay back.
    fn sense_relay(&mut self, node: NodeIndex) {
        let high = self.world.relay_sense(node);
        if let Some(pin) = self.nodes[node.0].wiring.sense {
            self.node_mut(node).drive_pin(pin, Some(high));
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
            world::Disturbance::Dominant { id, hold } => {
                bus.disturb(match id.and_then(StandardId::new) {
                    Some(id) => Disturbance::Hold {
                        frame: FrameSelect::Id {
                            id: id.into(),
                            occurrence: 0,
                        },
                        bit: CORRUPTED_BIT,
                        hold,
                    },
                    None => Disturbance::Stuck {
                        level: Level::Dominant,
                        from: at,
                        until: at + hold,
                    },
                });
            }
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
            if let RecordKind::FrameEnd { frame, start, .. } = record.kind
                && let Id::Standard(id) = frame.id()
            {
                let (id, end) = (id.as_raw(), record.at);
                if self.steps.0 == Some(id) {
                    self.chain.commands.push(OnWire { start, end });
                } else if self.steps.1.contains(&id) {
                    self.chain.distances.push(OnWire { start, end });
                }
            }
        }
        self.records.extend(records);
    }

    /// Passes the nodes' outputs to the world, in order of time.
    fn deliver(&mut self) {
        self.take_records();
        let mut sent = Vec::new();
        for node in self.nodes() {
            let console = self.nodes[node.0].wiring.console();
            for byte in self.node_mut(node).drain_uart() {
                if Some(byte.usart) == console {
                    self.nodes[node.0].console.push(byte.byte);
                    self.nodes[node.0].console_times.push(byte.end);
                } else {
                    let end = byte.cut.unwrap_or(byte.end);
                    sent.push((end, node, Sent::Byte(byte)));
                }
            }
            for change in self.node_mut(node).drain_pins() {
                if self.guardian == Some(node)
                    && let Some(guarded) = self.behind(change.pin)
                {
                    self.gates.push(GateChange {
                        at: change.at,
                        node: guarded,
                        closed: change.high,
                    });
                    continue;
                }
                let wiring = &self.nodes[node.0].wiring;
                if Some(change.pin) == wiring.relay {
                    sent.push((change.at, node, Sent::Relay(change.high)));
                } else if let Some(side) = wiring.servo(change.pin) {
                    sent.push((change.at, node, Sent::Servo(side, change.high)));
                }
            }
            let bursts = self.node_mut(node).drain_bursts();
            let wiring = &self.nodes[node.0].wiring;
            let samples = bursts.iter().filter(|burst| wiring.samples(burst.channel));
            self.chain.samples.extend(samples.map(|burst| burst.at));
        }
        sent.sort_by_key(|(at, ..)| *at);
        for (at, node, what) in sent {
            match what {
                Sent::Relay(closed) => {
                    self.world.relay(node, closed, at);
                    self.sense_relay(node);
                }
                Sent::Servo(side, high) => {
                    self.world.servo_edge(side, at, high);
                    if high {
                        self.chain.pulses.push((at, side));
                    }
                }
                Sent::Byte(byte) => {
                    if let Some(device) = self.nodes[node.0].wiring.device_at(byte.usart) {
                        let wave = Wave {
                            byte: byte.byte,
                            edges: byte.edges,
                            cut: byte.cut,
                        };
                        self.world.wave(node, device, &wave);
                    }
                }
            }
        }
    }

    /// The node behind the gate that a pin of the guardian closes.
    fn behind(&self, pin: parts::Pin) -> Option<NodeIndex> {
        let mut taps = self.sled(self.guardian?).taps.iter();
        self.guarded
            .get(taps.position(|tap| tap.gate == pin)?)
            .copied()
    }

    /// Adds a foreign sender that drives the transmit line of a node, in front of the gate that a guardian may
    /// close: what the node sends if its controller or its program is broken.
    pub fn add_babbler(&mut self, node: NodeIndex) -> Option<NodeId> {
        let id = self.node(node).node()?;
        let tester = Tester::new().at_bit_rate(self.bit_rate);
        let babbler = self.network.bus().add_tester_at(id, tester);
        self.babblers.push((babbler, node));
        Some(babbler)
    }

    /// When the bus guardian closed or opened gates, in order of time for each node.
    #[must_use]
    pub fn gates(&self) -> &[GateChange] {
        &self.gates
    }

    /// Ends the run and returns its results.
    #[must_use]
    pub fn finish(self) -> Outcome {
        let outcome = |node: NodeIndex| {
            let mcu = self.node(node);
            NodeOutcome {
                node,
                name: self.name(node).to_owned(),
                id: mcu.node(),
                core_hz: mcu.operating_hz(),
                load: mcu.load(),
                console: self.console(node).to_vec(),
                console_times: self.nodes[node.0].console_times.clone(),
                resets: mcu.resets().to_vec(),
                locked_up: mcu.is_locked_up(),
                unmodelled: mcu.unmodelled(),
            }
        };
        let nodes = self.nodes().map(outcome).collect();
        Outcome {
            duration: self.network.now(),
            records: self.records,
            nodes,
            world: self.world,
            chain: self.chain,
            gates: self.gates,
            babblers: self.babblers,
        }
    }
}

/// An output of a node to the world.
enum Sent {
    Byte(UartByte),
    Relay(bool),
    Servo(Side, bool),
}

/// The results of one node.
#[derive(Clone, Debug)]
pub struct NodeOutcome {
    /// The node.
    pub node: NodeIndex,
    /// Its name.
    pub name: String,
    /// Its number on the bus, which the records use.
    pub id: Option<NodeId>,
    /// Rate of its core clock in operation, Hz. At the end it may be in reset, with a slower one.
    pub core_hz: u64,
    /// How its cycles were spent, per task.
    pub load: Load,
    /// The bytes that it wrote to its console.
    pub console: Vec<u8>,
    /// When each of them ended.
    pub console_times: Vec<SimTime>,
    /// Its resets, power-on first.
    pub resets: Vec<(SimTime, ResetCause)>,
    /// True if it was in lockup at the end.
    pub locked_up: bool,
    /// Peripheral registers that it accessed but the model lacks.
    pub unmodelled: Vec<u32>,
}

/// The results of a run.
#[derive(Debug)]
pub struct Outcome {
    /// Simulated time.
    pub duration: SimTime,
    /// The recorded bus traffic, in order of time.
    pub records: Vec<Record>,
    /// The nodes, in the order of the manifest.
    pub nodes: Vec<NodeOutcome>,
    /// The world at the end, with its recordings.
    pub world: World,
    /// Samples of the distance sensors and pulses of the motors.
    pub chain: Chain,
    /// When the bus guardian closed or opened gates.
    pub gates: Vec<GateChange>,
    /// Foreign senders that drove the transmit line of a node, with this node.
    pub babblers: Vec<(NodeId, NodeIndex)>,
}

impl Outcome {
    /// The node on whose transmit line this sender is: the node itself or one that babbles in its place;
    /// `None` for testers.
    #[must_use]
    pub fn line_of(&self, id: NodeId) -> Option<NodeIndex> {
        let mut babblers = self.babblers.iter();
        let babbler = babblers.find(|(babbler, _)| *babbler == id);
        babbler.map_or_else(|| self.node_at(id), |(_, node)| Some(*node))
    }

    /// The node with this number on the bus, `None` for testers.
    #[must_use]
    pub fn node_at(&self, id: NodeId) -> Option<NodeIndex> {
        self.nodes
            .iter()
            .find(|outcome| outcome.id == Some(id))
            .map(|outcome| outcome.node)
    }
}

/// Progress of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Time simulated so far.
    pub now: SimTime,
    /// Time at which the run ends.
    pub end: SimTime,
}

/// Settings of a run that the scenario does not contain.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// Seed of all random numbers.
    pub seed: u64,
    /// How long to simulate; `None` takes the scenario's duration.
    pub duration: Option<SimDuration>,
    /// Simulated time between two calls of the progress function.
    pub progress_every: SimDuration,
    /// How long reading the flash takes.
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

/// Runs a scenario of a vehicle from power-on to its end.
///
/// # Errors
/// As [`Twin::new`] and [`Twin::run_until`].
pub fn run(
    vehicle: &Vehicle,
    scenario: &Scenario,
    images: &Images,
    options: &Options,
    mut progress: impl FnMut(Progress),
) -> Result<Outcome, TwinError> {
    let mut twin = Twin::with_flash(vehicle, scenario, options.seed, images, options.flash)?;
    let duration = options.duration.unwrap_or_else(|| scenario.duration.span());
    twin.run_telling(duration, options.progress_every, &mut progress)?;
    Ok(twin.finish())
}
