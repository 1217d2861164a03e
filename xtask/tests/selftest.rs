//! `selftest`: when the request is sent and which answers count, on a bus without images, on the
//! virtual vehicle, and through a serial adapter that stands before it.

#![cfg(unix)]

use std::{
    collections::VecDeque,
    fs, io,
    os::fd::{AsFd, AsRawFd},
    process::{Command, Output},
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use can_bus::{
    Frame, Record, RecordKind,
    slcan::{Answer, Decoder, encode},
    wire::WireFrame,
};
use embedded_can::Id;
use serial2::SerialPort;
use vehicle_model::{NodeIndex, Vehicle};
use world::Scenario;
use xtask::{
    Workspace, build,
    selftest::{
        Answers, Line, Messages, OnTwin, Outcome, Port, Question, Received, Results, Slcan, Told,
        Transport, TransportError, Unsent, ask,
    },
    vehicle,
};

/// Identifier of the reference message and of the request, in all vehicles of the house.
const REFERENCE: u16 = 100;
const REQUEST: u16 = 530;

fn find(name: &str) -> Vehicle {
    vehicle::find(&Workspace::find().unwrap(), name).unwrap()
}

fn two_boards() -> Vehicle {
    find("two-boards")
}

fn millis(ms: u64) -> Duration {
    Duration::from_millis(ms)
}

/// How long a frame takes at 250 kbit/s.
fn length(frame: &Frame) -> Duration {
    Duration::from_micros(4 * WireFrame::encode(frame).bits() as u64)
}

/// A reference message.
fn reference() -> Frame {
    Frame::standard(REFERENCE, &[0; 8]).unwrap()
}

/// The report of a node: everything passed, except for these signals.
fn report(vehicle: &Vehicle, node: usize, round: u8, others: &[(&str, i128)]) -> Frame {
    let manifest = vehicle.manifest();
    let names = &manifest.self_test.as_ref().unwrap().report;
    let name = &names[&manifest.nodes[node].name];
    let mut messages = vehicle.network().messages.iter();
    let message = messages.find(|message| message.name == *name).unwrap();
    let mut data = [0; 8];
    for signal in &message.signals {
        let others = others.iter().find(|(name, _)| *name == signal.name);
        let raw = match (signal.name.as_str(), others) {
            (_, Some((_, raw))) => *raw,
            ("Round", _) => i128::from(round),
            ("ClockError", _) => -3,
            ("SupplyVoltage", _) => 165,
            ("StackFree", _) => 900,
            _ => 1,
        };
        signal.insert(&mut data, raw);
    }
    Frame::standard(message.id, &data).unwrap()
}

/// Round of a request, and whether it asks for a start.
fn asked(request: &Frame) -> (u8, bool) {
    assert_eq!(request.id(), Frame::standard(REQUEST, &[]).unwrap().id());
    let &[round, flags, 0, 0, b'T', b'E', b'S', b'T'] = request.data() else {
        panic!("{request:?}");
    };
    (round, flags == 1)
}

/// What the nodes send when they are asked, and how much later.
type Respond<'a> = dyn FnMut(&Frame) -> Vec<(Duration, Frame)> + 'a;

/// A bus without images: frames that come at their times, and nodes that answer.
struct Paper<'a> {
    now: Duration,
    frames: VecDeque<Received>,
    requests: Vec<(Duration, Frame)>,
    respond: Box<Respond<'a>>,
}

impl<'a> Paper<'a> {
    fn new(
        frames: impl IntoIterator<Item = (Duration, Frame)>,
        respond: impl FnMut(&Frame) -> Vec<(Duration, Frame)> + 'a,
    ) -> Self {
        let mut paper = Self {
            now: Duration::ZERO,
            frames: VecDeque::new(),
            requests: Vec::new(),
            respond: Box::new(respond),
        };
        for (at, frame) in frames {
            paper.add(at, frame);
        }
        paper
    }

    fn add(&mut self, at: Duration, frame: Frame) {
        let place = self.frames.partition_point(|other| other.at <= at);
        self.frames.insert(place, Received { at, frame });
    }

    /// With a reference message every 20 ms for a minute.
    fn led(respond: impl FnMut(&Frame) -> Vec<(Duration, Frame)> + 'a) -> Self {
        Self::new(references(|_| Duration::ZERO), respond)
    }
}

/// A reference message every 20 ms for a minute, each later by some latency.
fn references(latency: impl Fn(u64) -> Duration) -> impl Iterator<Item = (Duration, Frame)> {
    (1..3000).map(move |cycle| {
        let end = millis(20 * cycle) + length(&reference());
        (end + latency(cycle), reference())
    })
}

impl Transport for Paper<'_> {
    fn now(&self) -> Duration {
        self.now
    }

    fn send(&mut self, frame: &Frame) -> Result<(), TransportError> {
        self.requests.push((self.now, *frame));
        for (later, frame) in (self.respond)(frame) {
            self.add(self.now + later, frame);
        }
        Ok(())
    }

    fn receive(&mut self, until: Duration) -> Result<Option<Received>, TransportError> {
        let next = self.frames.pop_front_if(|received| received.at <= until);
        self.now = self.now.max(next.map_or(until, |received| received.at));
        Ok(next)
    }
}

/// Asks all nodes of a vehicle.
fn asks(transport: &mut dyn Transport, vehicle: &Vehicle, start_again: bool) -> Answers {
    asks_and_notes(transport, vehicle, start_again).0
}

/// Asks all nodes of a vehicle, and returns what the user is told meanwhile, too.
fn asks_and_notes(
    transport: &mut dyn Transport,
    vehicle: &Vehicle,
    start_again: bool,
) -> (Answers, Vec<String>) {
    let messages = Messages::of(vehicle).unwrap();
    let names = vehicle::node_names(vehicle);
    let wanted: Vec<usize> = (0..names.len()).collect();
    let question = Question {
        messages: &messages,
        names: &names,
        wanted: &wanted,
        start_again,
    };
    let mut notes = Vec::new();
    let tell = &mut |told| {
        if let Told::Note(note) = told {
            eprintln!("{note}");
            notes.push(note);
        }
    };
    let answers = ask(transport, &question, tell).unwrap();
    (answers, notes)
}

/// The rounds of the reports; `None` for a silent node.
fn rounds(answers: &Answers) -> Vec<Option<u8>> {
    let reports = answers.reports.iter();
    reports
        .map(|report| report.as_ref().map(|(_, report)| report.round))
        .collect()
}

#[test]
fn the_nodes_start_again_and_report() {
    let vehicle = two_boards();
    let mut bus = Paper::led(|request| {
        assert_eq!(asked(request), (1, true));
        let of = |node| report(&vehicle, node, 0, &[]);
        vec![(millis(400), of(0)), (millis(3400), of(1))]
    });
    let answers = asks(&mut bus, &vehicle, true);
    assert_eq!(rounds(&answers), [Some(0), Some(0)]);
    // The window is that from 6 ms to 10 ms.
    let [(at, after)] = answers.requests[..] else {
        panic!("{answers:?}");
    };
    assert_eq!(after, Duration::from_micros(6020));
    assert_eq!(at, millis(40) + after, "after two references");
    let (_, report) = answers.reports[1].as_ref().unwrap();
    assert_eq!(report.checks.len(), 10);
    assert_eq!(report.failed().count(), 0);
    let values: Vec<(&str, f64, &str)> = report
        .values
        .iter()
        .map(|value| (value.name.as_str(), value.value, value.unit.as_str()))
        .collect();
    assert_eq!(
        values[1..],
        [
            ("SupplyVoltage", 3300.0, "mV"),
            ("StackFree", 900.0, "byte")
        ]
    );
    assert!((values[0].1 + 0.3).abs() < 1e-9, "{values:?}");
}

/// A node with a key answers the request to start again as a running one.
#[test]
fn a_node_that_does_not_start_again_is_named() {
    let vehicle = two_boards();
    let mut bus = Paper::led(|_| {
        let of = |node, round| report(&vehicle, node, round, &[]);
        vec![(millis(20), of(1, 1)), (millis(3400), of(0, 0))]
    });
    let (answers, notes) = asks_and_notes(&mut bus, &vehicle, true);
    assert_eq!(rounds(&answers), [Some(0), Some(1)]);
    let last = notes.last().unwrap();
    assert!(last.starts_with("Not started again: motor. "), "{last}");
    assert!(last.contains("with a key"), "{last}");
}

#[test]
fn running_nodes_report_with_the_round() {
    let vehicle = two_boards();
    let mut bus = Paper::led(|request| {
        let (round, start_again) = asked(request);
        assert!(!start_again);
        let of = |node| report(&vehicle, node, round, &[("Relay", 0)]);
        vec![(millis(20), of(0)), (millis(40), of(1))]
    });
    let answers = asks(&mut bus, &vehicle, false);
    assert_eq!(rounds(&answers), [Some(1), Some(1)]);
    let (_, report) = answers.reports[1].as_ref().unwrap();
    let relay = report.checks.iter().find(|check| check.name == "Relay");
    assert_eq!(relay.unwrap().result, Outcome::NotDone);
}

#[test]
fn a_failed_check_and_an_unknown_result_are_found() {
    let vehicle = two_boards();
    let mut bus = Paper::led(|_| {
        vec![
            (millis(20), report(&vehicle, 0, 0, &[("Supply", 2)])),
            (millis(40), report(&vehicle, 1, 0, &[("Stack", 3)])),
        ]
    });
    let answers = asks(&mut bus, &vehicle, true);
    let failed: Vec<Vec<&str>> = answers
        .reports
        .iter()
        .map(|report| {
            let (_, report) = report.as_ref().unwrap();
            report.failed().map(|check| check.name.as_str()).collect()
        })
        .collect();
    assert_eq!(failed, [["Supply"], ["Stack"]]);
}

/// A node that never answers is asked three times; the others start only once.
#[test]
fn a_silent_node_is_asked_again() {
    let vehicle = two_boards();
    let mut bus = Paper::led(|request| {
        let (round, start_again) = asked(request);
        let round = if start_again { 0 } else { round };
        vec![(millis(30), report(&vehicle, 1, round, &[]))]
    });
    let answers = asks(&mut bus, &vehicle, true);
    assert_eq!(rounds(&answers), [None, Some(3)]);
    let sent: Vec<_> = bus.requests.iter().map(|(_, frame)| asked(frame)).collect();
    assert_eq!(sent, [(1, true), (2, false), (3, false)]);

    let mut bus = Paper::led(|_| Vec::new());
    let answers = asks(&mut bus, &vehicle, true);
    assert_eq!(rounds(&answers), [None, None]);
    let sent: Vec<_> = bus.requests.iter().map(|(_, frame)| asked(frame)).collect();
    assert_eq!(sent, [(1, true), (2, true), (3, false)]);
    assert!(bus.now < Duration::from_secs(25), "{:?}", bus.now);
}

#[test]
fn without_a_time_master_nothing_is_sent() {
    let vehicle = two_boards();
    let by_itself = report(&vehicle, 1, 0, &[]);
    let mut bus = Paper::new([(millis(7000), by_itself)], |_| unreachable!());
    let answers = asks(&mut bus, &vehicle, true);
    assert_eq!(answers.unsent, Some(Unsent::NoReference));
    assert_eq!(rounds(&answers), [None, Some(0)]);
    assert_eq!(bus.now, millis(9000));
}

#[test]
fn after_irregular_references_nothing_is_sent() {
    let vehicle = two_boards();
    // Each second one is 4 ms late.
    let frames = references(|cycle| millis(4 * (cycle % 2)));
    let mut bus = Paper::new(frames, |_| unreachable!());
    let answers = asks(&mut bus, &vehicle, true);
    assert_eq!(answers.unsent, Some(Unsent::Irregular));
    assert!(bus.now < Duration::from_secs(16), "{:?}", bus.now);
}

#[test]
fn references_of_another_vehicle_are_told_by_their_period() {
    let uagv = find("uagv");
    let asked_of = |vehicle: &Vehicle, frames: Vec<(Duration, Frame)>| {
        let mut bus = Paper::new(frames, |_| unreachable!());
        asks(&mut bus, vehicle, true).unsent
    };
    let seen = |ms| Some(Unsent::OtherCycle { seen: millis(ms) });
    // Every 20 ms, with one missing now and then.
    let every_20_ms = || references(|_| Duration::ZERO).collect::<Vec<_>>();
    assert_eq!(asked_of(&uagv, every_20_ms()), seen(20));
    let mut gaps = every_20_ms();
    gaps.retain(|(at, _)| at.as_millis() / 20 % 10 != 3);
    assert_eq!(asked_of(&uagv, gaps), seen(20));
    let every_100_ms = every_20_ms().into_iter().step_by(5).collect();
    assert_eq!(asked_of(&two_boards(), every_100_ms), seen(100));
    // Two of them are no period.
    let irregular = references(|cycle| millis(4 * (cycle % 2))).collect();
    assert_eq!(asked_of(&uagv, irregular), Some(Unsent::Irregular));
}

#[test]
fn answers_to_another_program_do_not_count() {
    let vehicle = two_boards();
    let before = (millis(30), report(&vehicle, 0, 0, &[]));
    let mut bus = Paper::led(|request| {
        let (round, _) = asked(request);
        vec![
            (millis(20), report(&vehicle, 0, 77, &[])),
            (millis(40), report(&vehicle, 1, round, &[])),
        ]
    });
    bus.add(before.0, before.1);
    let answers = asks(&mut bus, &vehicle, false);
    assert_eq!(rounds(&answers), [None, Some(3)]);
}

/// Whatever latency up to 3 ms the references have, the request is inside its window.
#[test]
fn the_request_is_in_its_window_at_any_latency() {
    let vehicle = two_boards();
    let mut random = 2017_u32;
    for _ in 0..300 {
        let mut micros = || {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            u64::from(random >> 8) % 3000
        };
        let latencies: Vec<u64> = (0..40).map(|_| micros()).collect();
        let latency = |cycle: u64| latencies[cycle as usize % latencies.len()];
        let frames = references(|cycle| Duration::from_micros(latency(cycle)));
        let mut bus = Paper::new(frames, |request| {
            let (round, _) = asked(request);
            let of = |node| (millis(20), report(&vehicle, node, round, &[]));
            vec![of(0), of(1)]
        });
        let answers = asks(&mut bus, &vehicle, false);
        assert_eq!(answers.unsent, None, "{latencies:?}");
        let [(at, request)] = bus.requests[..] else {
            panic!("{latencies:?}");
        };
        let start = at.as_micros() % 20_000;
        let end = start + length(&request).as_micros();
        assert!(
            start >= 6000 && end <= 10_000,
            "{start} us to {end} us, {latencies:?}"
        );
    }
}

/// The images of a vehicle.
fn images(vehicle: &Vehicle) -> twin::Images {
    let nodes: Vec<NodeIndex> = vehicle.nodes().collect();
    let images = build::images(&Workspace::find().unwrap(), vehicle, &nodes).unwrap();
    build::read(&images).unwrap()
}

/// The requests on the bus: microseconds from the start of the reference before it to its own
/// start and to its end.
fn requests_in_cycle(records: &[Record]) -> Vec<(u64, u64)> {
    let mut begin = 0;
    let mut requests = Vec::new();
    for record in records {
        if let RecordKind::FrameEnd { frame, start, .. } = record.kind {
            let micros = |ticks: u64| (ticks - begin) / 1_000_000;
            match frame.id() {
                Id::Standard(id) if id.as_raw() == REFERENCE => begin = start.as_ticks(),
                Id::Standard(id) if id.as_raw() == REQUEST => {
                    requests.push((micros(start.as_ticks()), micros(record.at.as_ticks())));
                }
                _ => {}
            }
        }
    }
    requests
}

/// All requests are in their window.
fn in_window(vehicle: &Vehicle, records: &[Record]) {
    let window = vehicle.network().message(REQUEST).unwrap().window;
    let requests = requests_in_cycle(records);
    assert!(!requests.is_empty());
    for (start, end) in requests {
        let (from, until) = (u64::from(window.start_us), u64::from(window.end_us()));
        assert!(from <= start && end <= until, "{start} us to {end} us");
        assert!(
            start < from + 300,
            "{start} us is not near the window's begin"
        );
    }
}

/// The nodes' images report, and nothing has failed.
fn all_passed(vehicle: &Vehicle, answers: &Answers) {
    for (node, report) in answers.reports.iter().enumerate() {
        let name = &vehicle::node_names(vehicle)[node];
        let Some((_, report)) = report else {
            panic!("{name} has not reported: {answers:?}");
        };
        assert_eq!(report.failed().count(), 0, "{name}: {report:?}");
        let done = report
            .checks
            .iter()
            .filter(|check| check.result == Outcome::Passed);
        assert!(done.count() >= 9, "{name}: {report:?}");
    }
}

#[test]
fn the_images_of_two_boards_report_on_the_virtual_bus() {
    let vehicle = two_boards();
    let images = images(&vehicle);
    let run = |start_again| {
        let mut bus = OnTwin::new(&vehicle, &images).unwrap();
        let answers = asks(&mut bus, &vehicle, start_again);
        in_window(&vehicle, bus.twin().records());
        all_passed(&vehicle, &answers);
        assert_eq!(answers.requests.len(), 1, "{answers:?}");
        answers
    };
    // The knob is in its middle, so that the motor stands still.
    let answers = run(true);
    assert_eq!(rounds(&answers), [Some(0), Some(0)]);
    // Nothing depends on the clock of the system.
    assert_eq!(run(true), answers);
    assert_eq!(rounds(&run(false)), [Some(1), Some(1)]);
}

/// Neither of two boards starts again while the knob turns the motor.
#[test]
fn the_images_of_two_boards_report_while_the_motor_turns() {
    let vehicle = two_boards();
    let text = "summary = \"the knob is at its end\"\n\
        [[knob]]\nnode = \"motor\"\nat = \"0 s\"\nposition = \"100 %\"\n";
    let scenario = Scenario::parse(&vehicle, "knob", "knob", text).unwrap();
    let mut bus = OnTwin::within(&vehicle, &scenario, &images(&vehicle)).unwrap();
    let answers = asks(&mut bus, &vehicle, true);
    assert_eq!(rounds(&answers), [Some(1), Some(1)]);
    let (_, report) = answers.reports[1].as_ref().unwrap();
    let relay = report.checks.iter().find(|check| check.name == "Relay");
    assert_eq!(relay.unwrap().result, Outcome::NotDone);
}

#[test]
fn the_images_of_the_uagv_report_on_the_virtual_bus() {
    let vehicle = find("uagv");
    let mut bus = OnTwin::new(&vehicle, &images(&vehicle)).unwrap();
    let answers = asks(&mut bus, &vehicle, true);
    in_window(&vehicle, bus.twin().records());
    all_passed(&vehicle, &answers);
    assert_eq!(rounds(&answers), [Some(0); 4]);
}

/// The board of the motor has no clock: its node trims its oscillator, and reports what is wrong.
#[test]
fn a_node_without_its_clock_is_found() {
    let vehicle = two_boards();
    let text = "summary = \"no clock\"\n[nodes.motor]\nexternal = false\n";
    let scenario = Scenario::parse(&vehicle, "no-clock", "no-clock", text).unwrap();
    let mut bus = OnTwin::within(&vehicle, &scenario, &images(&vehicle)).unwrap();
    let answers = asks(&mut bus, &vehicle, true);
    let failed = |node: usize| {
        let (_, report) = answers.reports[node].as_ref().unwrap();
        let failed = report.failed().map(|check| check.name.clone());
        failed.collect::<Vec<_>>()
    };
    assert_eq!(failed(0), Vec::<String>::new());
    assert!(failed(1).contains(&"Oscillators".into()), "{:?}", failed(1));
}

/// An adapter that speaks slcan, without a bus.
#[derive(Default)]
struct Adapter {
    decoder: Decoder,
    open: bool,
}

impl Adapter {
    /// Takes a byte from the host: the answer, and the frame to send.
    fn take(&mut self, byte: u8) -> (Vec<u8>, Option<Frame>) {
        match self.decoder.push(byte) {
            None => (Vec::new(), None),
            Some(Answer::Frame { frame, .. }) if self.open => (b"z\r".to_vec(), Some(frame)),
            Some(Answer::Other(line)) => match (line.as_slice(), self.open) {
                (b"S5", false) => (b"\r".to_vec(), None),
                (b"O", false) => {
                    self.open = true;
                    (b"\r".to_vec(), None)
                }
                (b"C", true) => {
                    self.open = false;
                    (b"\r".to_vec(), None)
                }
                _ => (vec![7], None),
            },
            Some(Answer::Done) => (b"\r".to_vec(), None),
            Some(_) => (vec![7], None),
        }
    }
}

/// Both ends of a serial line that passes all bytes as they are.
fn serial_line() -> (SerialPort, SerialPort) {
    let (mut one, mut other) = SerialPort::pair().unwrap();
    for port in [&mut one, &mut other] {
        let mut settings = port.get_configuration().unwrap();
        settings.set_raw();
        port.set_configuration(&settings).unwrap();
    }
    (one, other)
}

/// A serial port whose other end has an adapter on the bus of the virtual vehicle. Its clock is
/// that of the virtual vehicle; each byte is waited for, so that the outcome does not depend on
/// the system.
struct Paced {
    port: Port,
    other_end: SerialPort,
    adapter: Adapter,
    bus: OnTwin,
    /// Bytes that the adapter has written and nobody has read.
    written: usize,
}

impl Paced {
    fn new(bus: OnTwin) -> Self {
        let (port, mut other_end) = serial_line();
        other_end.set_read_timeout(Duration::from_secs(10)).unwrap();
        Self {
            port: Port::new(port),
            other_end,
            adapter: Adapter::default(),
            bus,
            written: 0,
        }
    }

    fn say(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.written += bytes.len();
        self.other_end.write_all(bytes)
    }
}

impl Line for Paced {
    fn now(&self) -> Duration {
        self.bus.now()
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.port.write(bytes)?;
        let mut arrived = vec![0; bytes.len()];
        self.other_end.read_exact(&mut arrived)?;
        for byte in arrived {
            let (answer, frame) = self.adapter.take(byte);
            self.say(&answer)?;
            if let Some(frame) = frame {
                self.bus.send(&frame).unwrap();
            }
        }
        Ok(())
    }

    fn read(&mut self, bytes: &mut [u8], until: Duration) -> io::Result<usize> {
        while self.written == 0 {
            let Some(received) = self.bus.receive(until).unwrap() else {
                return Ok(0);
            };
            if self.adapter.open {
                self.say(encode(&received.frame).as_bytes())?;
            }
        }
        let end = self.port.now() + Duration::from_secs(10);
        let count = self.port.read(bytes, end)?;
        self.written -= count;
        Ok(count)
    }
}

/// The whole way of a serial adapter, with the images of the nodes behind it.
#[test]
fn the_images_of_two_boards_report_through_a_serial_adapter() {
    let vehicle = two_boards();
    let bus = OnTwin::new(&vehicle, &images(&vehicle)).unwrap();
    let mut adapter = Slcan::open(Paced::new(bus), "a port", 250_000).unwrap();
    let answers = asks(&mut adapter, &vehicle, true);
    in_window(&vehicle, adapter.line().bus.twin().records());
    all_passed(&vehicle, &answers);
}

#[test]
fn an_adapter_that_refuses_is_named() {
    let refused = |answer: &[u8], bit_rate| {
        let adapter = Slcan::open(Deaf::answering(answer), "/dev/ttyACM0", bit_rate);
        adapter.err().map(|error| error.to_string())
    };
    assert_eq!(
        refused(b"\x07", 250_000).as_deref(),
        Some("the adapter at /dev/ttyACM0 refuses the bit rate")
    );
    // One that never answers may work all the same.
    assert_eq!(refused(b"", 250_000), None);
    // So may one that answers by other lines of slcan, or with a line feed.
    assert_eq!(refused(b"V1013\r", 250_000), None);
    assert_eq!(refused(b"\r\n", 250_000), None);
    assert_eq!(refused(b"t0642AB01\rz\r", 250_000), None);
    let text = refused(b"0 off 0\r\nbus run master S0\r\n\r\n", 250_000).unwrap();
    assert!(
        text.starts_with(
            "/dev/ttyACM0 does not speak slcan, it sends \"bus run master S0\": name the port of \
             the adapter, not that of a board's console"
        ),
        "{text}"
    );
    // Another baud rate.
    let noise = refused(b"\xFE\x80", 250_000).unwrap();
    assert!(noise.contains(r#"it sends "\xfe\x80""#), "{noise}");
    assert_eq!(
        refused(b"", 83_333).as_deref(),
        Some("/dev/ttyACM0 cannot have 83333 bit/s: an slcan adapter has a table of bit rates")
    );
}

/// An adapter with one answer to each bit rate, and none to anything else. Its time stands still.
struct Deaf(Vec<u8>, Vec<u8>);

impl Deaf {
    fn answering(answer: &[u8]) -> Self {
        Self(answer.to_vec(), Vec::new())
    }
}

impl Line for Deaf {
    fn now(&self) -> Duration {
        Duration::ZERO
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        if bytes == b"S5\r" {
            self.1.clone_from(&self.0);
        }
        Ok(())
    }

    fn read(&mut self, bytes: &mut [u8], _until: Duration) -> io::Result<usize> {
        let answer = std::mem::take(&mut self.1);
        bytes[..answer.len()].copy_from_slice(&answer);
        Ok(answer.len())
    }
}

/// A serial port for another process. No outcome depends on how fast the two run.
struct Bench {
    path: String,
    end: Arc<AtomicBool>,
    runs: Option<JoinHandle<()>>,
    /// The port stays open between two programs.
    _port: SerialPort,
}

impl Bench {
    /// With an adapter through which these frames come again and again.
    fn adapter(frames: Vec<Frame>) -> Self {
        Self::with(move |mut port, ends| {
            let mut adapter = Adapter::default();
            let mut bytes = [0; 64];
            port.set_read_timeout(millis(50)).unwrap();
            while !ends.load(Ordering::Relaxed) {
                let count = port.read(&mut bytes).unwrap_or(0);
                for &byte in &bytes[..count] {
                    let (answer, _) = adapter.take(byte);
                    port.write_all(&answer).unwrap();
                }
                if adapter.open {
                    for frame in &frames {
                        port.write_all(encode(frame).as_bytes()).unwrap();
                    }
                }
            }
        })
    }

    /// With the console of a board, which writes a line every so often and reads nothing.
    fn console(every: Duration) -> Self {
        Self::with(move |port, ends| {
            let mut next = Instant::now();
            while !ends.load(Ordering::Relaxed) {
                if Instant::now() >= next {
                    next += every;
                    let line =
                        b"bus run master S0 ref-0 msg-0 own-0 odd 0 tec 0 rec 0 ovr 0 off 0\r\n";
                    port.write_all(line).unwrap();
                }
                thread::sleep(millis(10));
            }
        })
    }

    /// With a program behind the port, which runs until the flag is set.
    fn with(program: impl FnOnce(SerialPort, &AtomicBool) + Send + 'static) -> Self {
        let (one, other) = serial_line();
        let path = |port: &SerialPort| {
            let number = port.as_fd().as_raw_fd();
            let link = fs::read_link(format!("/proc/self/fd/{number}")).unwrap();
            link.to_string_lossy().into_owned()
        };
        let (port, other) = match path(&one).starts_with("/dev/pts/") {
            true => (other, one),
            false => (one, other),
        };
        let end = Arc::new(AtomicBool::new(false));
        let ends = Arc::clone(&end);
        let runs = thread::spawn(move || program(port, &ends));
        Self {
            path: path(&other),
            end,
            runs: Some(runs),
            _port: other,
        }
    }
}

impl Drop for Bench {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
        let ended = self.runs.take().map(JoinHandle::join);
        assert!(thread::panicking() || ended.unwrap().is_ok());
    }
}

/// Runs `cargo xtask selftest`.
fn selftest(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_xtask"))
        .arg("selftest")
        .args(arguments)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Without a time master the nodes report by themselves.
#[test]
fn the_command_shows_what_came_through_a_serial_port() {
    let vehicle = two_boards();
    let not_done = [("Program", 0), ("Oscillators", 0), ("Relay", 0)];
    let bench = Bench::adapter(vec![
        report(&vehicle, 0, 0, &[("LoopBack", 0)]),
        report(&vehicle, 1, 0, &not_done),
    ]);
    let bus = format!("slcan:{}", bench.path);
    let output = selftest(&["--vehicle", "two-boards", "--bus", &bus]);
    let shown = text(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{output:?}");
    let lines: Vec<&str> = shown.lines().collect();
    assert_eq!(lines[0], format!("Self-test of two-boards on {bus}"));
    for line in [
        "               master         motor",
        "reported       after a start  after a start",
        "Relay          passed         not done",
        "ClockError     -0.3 %         -0.3 %",
        "SupplyVoltage  3300 mV        3300 mV",
        "StackFree      900 byte       900 byte",
        "master: LoopBack not done: the receive pin of the controller was dominant at the start: \
         transceiver, its supply and wires, and any node that holds the bus dominant",
        "motor: Program not done: the image in flash carries no check value; `cargo xtask flash \
         motor --vehicle two-boards` writes it",
        "motor: Oscillators not done: the node runs on the external clock, but no edge of it came \
         to the timer that measures it",
        "motor: Relay not done: the node has no motor, or its motor may have turned",
        "2 nodes reported. No check failed, 4 not done.",
    ] {
        assert!(lines.contains(&line), "{line}\n{shown}");
    }
    let told = text(&output.stderr);
    assert!(
        told.contains("Nothing can be asked: there is no reference message on the bus"),
        "{told}"
    );
}

/// Two Nucleo boards and an adapter are three serial ports.
#[test]
fn the_console_of_a_board_is_not_taken_for_an_adapter() {
    // The second one is silent while the command opens the channel.
    for every in [millis(100), millis(1500)] {
        let console = Bench::console(every);
        let bus = format!("slcan:{}", console.path);
        let output = selftest(&["--vehicle", "two-boards", "--bus", &bus]);
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{error}");
        let expected = format!(
            "error: {} does not speak slcan, it sends \"bus run master S0 ref-0 ",
            console.path
        );
        let last = error.lines().last().unwrap();
        assert!(last.starts_with(&expected), "{error}");
    }
}

/// Some adapters acknowledge nothing. An empty bus behind one looks like a port without one.
#[test]
fn a_silent_port_is_no_wrong_input() {
    let bench = Bench::with(|port, ends| {
        while !ends.load(Ordering::Relaxed) {
            thread::sleep(millis(10));
        }
        drop(port);
    });
    let bus = format!("slcan:{}", bench.path);
    let output = selftest(&["--vehicle", "two-boards", "--bus", &bus]);
    let told = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{told}");
    let note = format!("Nothing has answered at {}.", bench.path);
    assert!(told.contains(&note), "{told}");
}

#[test]
fn a_failure_says_what_to_look_at_first() {
    let vehicle = two_boards();
    let mut bus = Paper::led(|request| {
        let (round, _) = asked(request);
        let others = [("Program", 2), ("Relay", 0)];
        vec![(millis(20), report(&vehicle, 1, round, &others))]
    });
    let answers = asks(&mut bus, &vehicle, false);
    let results = |nodes| Results {
        vehicle: &vehicle,
        bus: "slcan:COM3".into(),
        nodes,
        answers: &answers,
    };
    let both = results(&[0, 1]);
    assert_eq!(
        both.outcome().unwrap_err().to_string(),
        "the self-test failed: master: no report; motor: Program failed"
    );
    let shown = both.text();
    for line in [
        "motor: Program failed",
        "    passes when  The flash holds the image that was written to it; not done if the image \
         carries no check value.",
        "    look first   the image in flash has changed; `cargo xtask flash motor --vehicle \
         two-boards` writes it",
        "master: no report",
    ] {
        assert!(shown.lines().any(|shown| shown == line), "{line}\n{shown}");
    }

    let json = results(&[1]).json();
    assert_eq!(json["passed"], false);
    assert_eq!(json["nodes"].as_array().unwrap().len(), 1);
    let motor = &json["nodes"][0];
    assert_eq!(motor["checks"]["Program"], "failed");
    assert_eq!(motor["checks"]["Memory"], "passed");
    assert_eq!(motor["values"]["ClockError"]["value"], -0.3);
    assert_eq!(json["findings"][0]["what"], "motor: Program failed");
    assert_eq!(motor["checks"]["Relay"], "not done");
    assert_eq!(json["not_done"][0]["what"], "motor: Relay not done");
}

#[test]
fn the_vehicle_of_a_real_bus_is_asked_for() {
    let output = selftest(&["--bus", "slcan:/dev/ttyACM7"]);
    let error = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{error}");
    assert_eq!(
        error.trim_end(),
        "error: more than one vehicle may be on slcan:/dev/ttyACM7: which one, --vehicle \
         row-follower or --vehicle sentry or --vehicle tractor or --vehicle two-boards or --vehicle uagv?"
    );
}

/// A computer that is busy with other work takes most frames late, some by 15 ms.
#[test]
fn a_bus_of_another_vehicle_is_told_by_its_basic_cycle() {
    let uagv = find("uagv");
    let late = |cycle: u64| match cycle % 16 {
        rest @ (0 | 5) => millis(5 + 2 * rest),
        rest => Duration::from_micros(rest * 2017 % 2500),
    };
    let mut bus = Paper::new(references(late), |_| unreachable!());
    let answers = asks(&mut bus, &uagv, true);
    let results = Results {
        vehicle: &uagv,
        bus: "slcan:COM3".into(),
        nodes: &[0, 1, 2, 3],
        answers: &answers,
    };
    assert!(results.outcome().is_err());
    let shown = results.text();
    let told = "the reference messages come every 20 ms, but the basic cycle of uagv has 100 ms: \
        if another vehicle is on the bus, --vehicle names it";
    assert!(shown.contains(told), "{shown}");
    assert!(!shown.contains("cargo xtask flash"), "{shown}");
}

#[test]
fn wrong_input_is_refused_in_one_sentence() {
    let socketcan = if cfg!(target_os = "linux") {
        "there is no CAN interface nocan7: `ip -brief link` lists the interfaces that there are"
    } else {
        "only Linux has SocketCAN: use an adapter on a serial port, slcan:PORT"
    };
    for (arguments, sentence) in [
        (
            &["--vehicle", "plough"][..],
            "there is no vehicle \"plough\"",
        ),
        (
            &["--node", "rudder"],
            "vehicle uagv has no node rudder, but gps, controller, steering, drive",
        ),
        (
            &["--bus", "can0"],
            "twin, socketcan:INTERFACE or slcan:PORT[@BAUD] is accepted",
        ),
        (
            &["--bus", "socketcan:nocan7", "--vehicle", "uagv"],
            socketcan,
        ),
        (
            &["--bus", "slcan:/dev/nothing", "--vehicle", "uagv"],
            "there is no serial port /dev/nothing: connect the adapter",
        ),
        (
            &["--bus", "slcan:/dev/null", "--vehicle", "uagv"],
            "/dev/null cannot be opened: ",
        ),
    ] {
        let output = selftest(arguments);
        let error = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{error}");
        assert_eq!(error.lines().count(), 1, "{error}");
        assert!(error.contains(sentence), "{error}");
    }
}
