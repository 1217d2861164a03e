//! From the receiver's serial line to the bus: packets of libsbp go to the emulated USART of the
//! release gps image. Their contents must appear in its windows as the `sbp` crate decodes them.

use can_bus::{Frame, Record, RecordKind, SimDuration, Tester};
use embedded_can::Id;
use furrow_tests::images;
use furrow_tests::nodes;
use network::Message;
use sbp::Sbp;
use serde::Deserialize;
use std::sync::Arc;
use twin::Options;
use twin::image::Image;
use twin::mcu::Board;
use twin::network::Network;
use twin::part::Part;
use uagv::messages::{Latitude, Longitude, Position, Velocity};
use world::Scenario;
use world::time::{from_seconds, seconds};

const MS: u64 = 1_000_000_000;

#[derive(Deserialize)]
struct Packet {
    hex: String,
}

fn packets() -> Vec<Vec<u8>> {
    let text = include_str!("../../firmware/tests/data/sbp_packets.json");
    let packets: Vec<Packet> = serde_json::from_str(text).expect("the data file parses");
    let byte = |pair: &str| u8::from_str_radix(pair, 16).expect("hexadecimal digits");
    packets
        .iter()
        .map(|packet| {
            (0..packet.hex.len())
                .step_by(2)
                .map(|at| byte(&packet.hex[at..at + 2]))
                .collect()
        })
        .collect()
}

/// The gps node, and a tester that acknowledges its frames.
struct Bench {
    network: Network,
    records: Vec<Record>,
}

impl Bench {
    fn new() -> Self {
        let image =
            Image::from_elf(Part::F446, images().of(nodes::GPS)).expect("a program for the F446");
        let mut network = Network::new();
        network.add(Arc::new(image), &Board::default());
        network.bus().add_tester(Tester::new());
        let mut bench = Self {
            network,
            records: Vec::new(),
        };
        bench.run(1000);
        bench
    }

    fn run(&mut self, milliseconds: u64) {
        let end = self.network.now() + SimDuration::from_ticks(milliseconds * MS);
        self.network.run_until(end);
        let records = self.network.bus().drain_records();
        self.records.extend(records);
    }

    /// Sends a packet on the receiver's line and runs for two basic cycles.
    fn feed(&mut self, packet: &[u8]) {
        self.records.clear();
        let start = self.network.now() + SimDuration::from_ticks(MS);
        self.network
            .node_mut(0)
            .feed_uart(1, packet, start, 1_000_000);
        self.run(250);
    }

    /// The last frame of a message since the last packet.
    fn last<M: Message>(&self) -> Option<Frame> {
        self.records
            .iter()
            .rev()
            .find_map(|record| match record.kind {
                RecordKind::FrameEnd { frame, .. } if is(frame.id(), M::ID) => Some(frame),
                _ => None,
            })
    }
}

fn is(id: Id, number: u16) -> bool {
    matches!(id, Id::Standard(id) if id.as_raw() == number)
}

fn decode<M: Message>(frame: Option<Frame>) -> Option<M> {
    frame.map(|frame| M::decode(frame.data()).expect("the node's own frame decodes"))
}

#[test]
fn packets_come_out_on_the_bus_as_the_sbp_crate_decodes_them() {
    let mut bench = Bench::new();
    let (mut velocities, mut positions, mut angles) = (0, 0, 0);
    for packet in packets() {
        let message = sbp::iter_messages(&packet[..])
            .next()
            .expect("one message")
            .expect("that decodes");
        bench.feed(&packet);
        let velocity = |bench: &Bench, north: i32, east: i32| {
            let seen: Velocity = decode(bench.last::<Velocity>()).expect("a frame 201");
            assert_eq!((seen.north.0, seen.east.0), (north, east));
        };
        let position = |bench: &Bench, fixed: bool, north: i32, east: i32| {
            let seen: Option<Position> = decode(bench.last::<Position>());
            assert_eq!(
                seen.map(|seen| (seen.north.0, seen.east.0)),
                fixed.then_some((north, east))
            );
        };
        let geodetic = |bench: &Bench, lat: f64, lon: f64| {
            let degrees = |angle: i64| angle as f64 * 1e-10;
            let seen: Latitude = decode(bench.last::<Latitude>()).expect("a frame 401");
            assert!((degrees(seen.angle()) - lat).abs() < 1e-10);
            let seen: Longitude = decode(bench.last::<Longitude>()).expect("a frame 402");
            assert!((degrees(seen.angle()) - lon).abs() < 1e-10);
        };
        match message {
            Sbp::MsgVelNed(m) if m.flags & 7 != 0 => {
                velocity(&bench, m.n, m.e);
                velocities += 1;
            }
            Sbp::MsgVelNedDepA(m) => {
                velocity(&bench, m.n, m.e);
                velocities += 1;
            }
            Sbp::MsgBaselineNed(m) => {
                position(&bench, m.flags & 7 == 4, m.n, m.e);
                positions += 1;
            }
            Sbp::MsgBaselineNedDepA(m) => {
                position(&bench, m.flags & 7 == 1, m.n, m.e);
                positions += 1;
            }
            Sbp::MsgPosLlh(m) if m.flags & 7 != 0 => {
                geodetic(&bench, m.lat, m.lon);
                angles += 1;
            }
            Sbp::MsgPosLlhDepA(m) => {
                geodetic(&bench, m.lat, m.lon);
                angles += 1;
            }
            _ => {}
        }
    }
    // The five velocities of type 0x020E are marked invalid and stay off the bus.
    assert_eq!((velocities, positions, angles), (11, 16, 16));
    assert_eq!(bench.network.node(0).resets().len(), 1);
}

#[test]
fn a_damaged_packet_changes_nothing_and_the_next_one_counts() {
    let mut bench = Bench::new();
    let packet = packets()
        .into_iter()
        .find(|packet| packet[1..3] == [0x05, 0x02])
        .expect("a velocity");
    let mut damaged = packet.clone();
    damaged[10] ^= 0x40;
    bench.feed(&damaged);
    assert_eq!(bench.last::<Velocity>(), None);
    bench.feed(&packet[..packet.len() - 3]);
    assert_eq!(bench.last::<Velocity>(), None);
    bench.feed(&packet);
    assert!(bench.last::<Velocity>().is_some());
}

/// North and east components of measurements, mm or mm/s.
type Measurements = Vec<(i32, i32)>;

/// Every velocity and position with a valid checksum in a stream, at any offset.
fn spoken(stream: &[u8]) -> (Measurements, Measurements) {
    let (mut velocities, mut positions) = (Vec::new(), Vec::new());
    for begin in (0..stream.len()).filter(|&at| stream[at] == 0x55) {
        let rest = &stream[begin..];
        let whole = rest
            .get(5)
            .and_then(|&length| rest.get(..usize::from(length) + 8));
        let Some(Ok(message)) = whole.and_then(|whole| sbp::iter_messages(whole).next()) else {
            continue;
        };
        match message {
            Sbp::MsgVelNed(m) => velocities.push((m.n, m.e)),
            Sbp::MsgVelNedDepA(m) => velocities.push((m.n, m.e)),
            Sbp::MsgBaselineNed(m) => positions.push((m.n, m.e)),
            Sbp::MsgBaselineNedDepA(m) => positions.push((m.n, m.e)),
            _ => {}
        }
    }
    (velocities, positions)
}

#[test]
fn no_stream_of_the_corpus_disturbs_the_schedule_or_invents_a_measurement() {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../firmware/tests/data/corpus");
    let mut files: Vec<_> = std::fs::read_dir(folder)
        .expect("the corpus is there")
        .map(|file| file.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|end| end == "bin"))
        .collect();
    files.sort();
    assert_eq!(files.len(), 12);
    let mut bench = Bench::new();
    let good = packets()
        .into_iter()
        .find(|packet| packet[1..3] == [0x05, 0x02])
        .expect("a velocity");
    for file in files {
        let name = file.display();
        let stream = std::fs::read(&file).expect("it can be read");
        let (velocities, positions) = spoken(&stream);
        bench.feed(&stream);
        let ends: Vec<Frame> = bench
            .records
            .iter()
            .filter_map(|record| match record.kind {
                RecordKind::FrameEnd { frame, .. } => Some(frame),
                _ => None,
            })
            .collect();
        for frame in ends.iter().filter(|frame| is(frame.id(), Velocity::ID)) {
            let seen: Velocity = decode(Some(*frame)).expect("a frame 201");
            let seen = (seen.north.0, seen.east.0);
            assert!(velocities.contains(&seen), "{name}: velocity {seen:?}");
        }
        for frame in ends.iter().filter(|frame| is(frame.id(), Position::ID)) {
            let seen: Position = decode(Some(*frame)).expect("a frame 200");
            let seen = (seen.north.0, seen.east.0);
            assert!(positions.contains(&seen), "{name}: position {seen:?}");
        }
        for frame in ends.iter().filter(|frame| is(frame.id(), Latitude::ID)) {
            let _: Option<Latitude> = decode(Some(*frame));
        }
        for frame in ends.iter().filter(|frame| is(frame.id(), Longitude::ID)) {
            let _: Option<Longitude> = decode(Some(*frame));
        }
        // 251 ms were simulated.
        let references = ends.iter().filter(|frame| is(frame.id(), 100)).count();
        assert!((2..=3).contains(&references), "{name}: {references}");
        // A wrong length makes the decoder skip the bytes that follow. After that the line works
        // again.
        bench.feed(&[0; 263]);
        bench.feed(&good);
        assert!(bench.last::<Velocity>().is_some(), "{name}");
    }
    let node = bench.network.node(0);
    assert_eq!(node.resets().len(), 1);
    assert!(!node.is_locked_up());
}

/// Thumb code that loops for `loops` turns, executes `nops` NOPs and goes on at `target`.
fn detour(loops: u16, nops: usize, target: u32) -> Vec<u8> {
    let wide = |opcode: u16, register: u16, half: u16| {
        [
            opcode | (half >> 11 & 1) << 10 | half >> 12,
            (half >> 8 & 7) << 12 | register << 8 | half & 0xFF,
        ]
    };
    let mut code = Vec::new();
    // MOVW r0, #loops; loop: SUBS r0, #1; BNE loop; NOPs; MOVW and MOVT r1, #target; BX r1
    code.extend(wide(0xF240, 0, loops));
    code.extend([0x3801, 0xD1FD]);
    code.extend(std::iter::repeat_n(0xBF00, nops));
    code.extend(wide(0xF240, 1, target as u16 | 1));
    code.extend(wide(0xF2C0, 1, (target >> 16) as u16));
    code.push(0x4708);
    code.into_iter().flat_map(u16::to_le_bytes).collect()
}

/// The line is idle in the middle of a packet, and the node looks at it while the next byte ends: in
/// each cycle of that time once.
#[test]
fn no_byte_is_lost_while_the_node_looks_at_the_line() {
    /// Turns of four cycles that leave most of a byte of 1710 cycles behind.
    const TURNS: u16 = 390;
    let mut bench = Bench::new();
    let packet = packets().into_iter().find(|packet| {
        let message = sbp::iter_messages(&packet[..]).next().and_then(Result::ok);
        matches!(message, Some(Sbp::MsgVelNedDepA(_)))
    });
    let packet = packet.expect("a velocity");
    let (first, second) = packet.split_at(8);
    // The interrupt of TIM4, and RAM that no program reaches.
    let handler = bench.network.node(0).image().handler(16 + 30);
    let handler = handler.expect("a handler").0;
    let spare = Part::F446.ram[0].base;
    let mut lost = Vec::new();
    for nops in 0..140 {
        bench.records.clear();
        let start = bench.network.now() + SimDuration::from_ticks(MS);
        let mcu = bench.network.node_mut(0);
        mcu.feed_uart(1, first, start, 1_000_000);
        // Eight bytes and one of silence, 10 us each, less 2 us.
        let idle = start + SimDuration::from_ticks(88 * MS / 1000);
        bench.network.run_until(idle);
        let mcu = bench.network.node_mut(0);
        assert!(mcu.run_to(handler, 100_000), "the node looks at the line");
        assert!(mcu.set_memory(spare, &detour(TURNS, nops, handler)));
        mcu.set_register(15, spare);
        let now = mcu.now();
        mcu.feed_uart(1, second, now, 1_000_000);
        bench.run(250);
        if bench.last::<Velocity>().is_none() {
            lost.push(nops);
        }
    }
    println!("lost in {} of 140 cycles: {lost:?}", lost.len());
    assert!(lost.is_empty(), "{lost:?}");
}

/// A receiver that measures once in a second, a metre beside the line: between two measurements, the vehicle drives by its
/// own steering and speed.
#[test]
fn with_a_receiver_of_one_hertz_the_vehicle_keeps_to_its_line() {
    let (vehicle, images) = furrow_tests::with("receiver.period=1 s");
    let text = "[start]\neast = \"1 m\"\n[receiver]\nnoise = \"1 cm\"\n\
                [[press]]\nat = \"1 s\"\nbutton = \"C\"\n[[press]]\nat = \"2 s\"\nbutton = \"C\"\n";
    let scenario = Scenario::parse(&vehicle, "test", "the test's scenario", text)
        .unwrap_or_else(|error| panic!("{error}"));
    let options = Options {
        duration: Some(from_seconds(40.0)),
        ..Options::default()
    };
    let outcome = twin::run(&vehicle, &scenario, &images, &options, |_| {})
        .unwrap_or_else(|error| panic!("{error}"));
    let states = outcome.world.states();
    let last = states.last().expect("a drive has states");
    assert!(last.north > 30.0, "it came {:.1} m north", last.north);
    let settled = states.iter().filter(|state| seconds(state.at) > 20.0);
    let largest = settled.map(|state| state.east.abs()).fold(0.0, f64::max);
    assert!(largest < 0.05, "{largest:.3} m beside the line");
}
