//! Two boards with the image of `boards/can-node` on one bus: what `ttcan` needs of a driver is there,
//! and `firmware` is not needed.

use std::ops::RangeInclusive;
use std::sync::{Arc, OnceLock};

use can_bus::{Disturbance, ErrorState, Frame, RecordKind, Retry, SimDuration, SimTime, Tester};
use embedded_can::{Id, StandardId};
use serde_json::Value;
use twin::image::Image;
use twin::mcu::{Board, FlashTiming};
use twin::network::Network;
use twin::part::{Part, Pin};
use xtask::{Workspace, target};

/// Picoseconds in a microsecond and in a millisecond.
const US: u64 = 1_000_000;
const MS: u64 = 1000 * US;
const CYCLE: u64 = 10 * MS;

const REFERENCE: u16 = 0x100;
/// Messages, the begin of their windows, and their sender.
const NUMBER: (u16, u64) = (0x180, MS);
const ECHO: (u16, u64) = (0x200, 3 * MS);
/// A bit at 250 kbit/s.
const BIT: u64 = 4 * US;

/// How late a frame may begin, ps: up to the next bit of its controller, and 1 us for crystals of 50 ppm
/// and clocks that agree only so well. The matrix allows 64 us.
const ON_TIME: RangeInclusive<i64> = -(US as i64)..=(BIT + US) as i64;

/// The same for a task of embassy: its clock has ticks of 1 us, and it begins by some microseconds sooner or later, which makes a bit.
const ON_TIME_WITH_EMBASSY: RangeInclusive<i64> = -(US as i64)..=(2 * BIT + US) as i64;

/// Builds the image, once for all tests.
fn image() -> Arc<Image> {
    static IMAGE: OnceLock<Arc<Image>> = OnceLock::new();
    Arc::clone(IMAGE.get_or_init(|| build(&["--package", "can-node"])))
}

/// The same for the one with embassy, which is a workspace of its own.
fn image_with_embassy() -> Arc<Image> {
    static IMAGE: OnceLock<Arc<Image>> = OnceLock::new();
    let built = || {
        build(&[
            "--locked",
            "--manifest-path",
            "boards/can-node/embassy/Cargo.toml",
            "--target-dir",
            concat!(env!("CARGO_TARGET_TMPDIR"), "/embassy"),
        ])
    };
    Arc::clone(IMAGE.get_or_init(built))
}

fn build(program: &[&str]) -> Arc<Image> {
    let workspace = Workspace::find().unwrap_or_else(|failure| panic!("{failure}"));
    let mut cargo = target::cargo(&workspace, "build");
    cargo.arg("--release").args(program);
    cargo.args(["--message-format", "json-render-diagnostics"]);
    let output = cargo.output().expect("cargo starts");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let messages = String::from_utf8(output.stdout).expect("cargo writes UTF-8");
    let executable = messages
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .find_map(|message| message["executable"].as_str().map(str::to_owned));
    let elf = std::fs::read(executable.expect("there is one")).expect("it can be read");
    Arc::new(Image::from_elf(Part::F446, &elf).expect("it is for the F446"))
}

/// Index of the node that sends the references, and of the other one.
const MASTER_BOARD: usize = 0;
const ECHO_BOARD: usize = 1;

/// Two boards with crystals that differ by 100 ppm.
fn network() -> Network {
    network_of([image(), image()])
}

/// The same with these images.
fn network_of(images: [Arc<Image>; 2]) -> Network {
    let mut network = Network::new();
    for (image, crystal_ppb) in images.into_iter().zip([50_000, -50_000]) {
        let board = Board {
            crystal_ppb,
            flash: FlashTiming::WaitStates,
            ..Board::default()
        };
        network.add(image, &board);
    }
    let strap = Pin::new('C', 0);
    network.node_mut(ECHO_BOARD).drive_pin(strap, Some(false));
    network
}

fn run(network: &mut Network, until: u64) {
    network.run_until(SimTime::from_ticks(0) + SimDuration::from_ticks(until));
    for node in [MASTER_BOARD, ECHO_BOARD] {
        let node = network.node(node);
        // The time driver of `embassy-stm32` clears a flag by ones in all other bits, those that are reserved, too.
        let mut violations = node.violations();
        violations.retain(|it| it.register != "TIM3_SR");
        assert_eq!(violations, []);
        assert!(!node.is_locked_up());
        // Power-on alone.
        assert_eq!(node.resets().len(), 1);
        assert_eq!(node.bus_faults().0, 0);
    }
}

/// A frame on the bus: its start in picoseconds, identifier and data.
type Sent = (u64, u16, Vec<u8>);

fn sent(frame: &Frame, start: SimTime) -> Sent {
    let Id::Standard(id) = frame.id() else {
        panic!("{frame:?}");
    };
    (start.as_ticks(), id.as_raw(), frame.data().to_vec())
}

/// The frames since the last call, and how many errors there were.
fn drain(network: &Network) -> (Vec<Sent>, usize) {
    let records = network.bus().drain_records();
    let errors = records
        .iter()
        .filter(|record| matches!(record.kind, RecordKind::Error { .. }));
    let errors = errors.count();
    let frames = records.iter().filter_map(|record| match &record.kind {
        RecordKind::FrameEnd { frame, start, .. } => Some(sent(frame, *start)),
        _ => None,
    });
    (frames.collect(), errors)
}

/// Judges basic cycles in which both messages are in their windows, and the echo is that of the same
/// basic cycle's number. Returns how many there are, one after the other; frames before the first
/// reference and behind the last one do not count.
fn judge(frames: &[Sent]) -> usize {
    judge_within(frames, ON_TIME)
}

/// The same with another idea of what is on time.
fn judge_within(frames: &[Sent], on_time: RangeInclusive<i64>) -> usize {
    let begins: Vec<usize> = (0..frames.len())
        .filter(|at| frames[*at].1 == REFERENCE)
        .collect();
    let mut last = None;
    for pair in begins.windows(2) {
        let (begin, inside) = (frames[pair[0]].0, &frames[pair[0] + 1..pair[1]]);
        let next = frames[pair[1]].0;
        let late = (next - begin) as i64 - CYCLE as i64;
        assert!(on_time.contains(&late), "reference: {late} ps");
        let [number, echo] = inside else {
            panic!("two messages: {inside:?}");
        };
        for ((id, window), frame) in [(NUMBER, number), (ECHO, echo)] {
            assert_eq!(frame.1, id);
            let late = (frame.0 - begin) as i64 - window as i64;
            assert!(on_time.contains(&late), "{id:#X}: {late} ps");
        }
        assert_eq!(number.2, echo.2);
        let value = u32::from_le_bytes(number.2[..].try_into().expect("four bytes"));
        assert_eq!(last.map_or(value, |last: u32| last + 1), value);
        last = Some(value);
    }
    begins.len().saturating_sub(1)
}

#[test]
fn two_boards_exchange_messages_in_their_windows_for_a_hundred_basic_cycles() {
    let mut network = network();
    // The clocks start, the master waits for a basic cycle of silence, and the nodes measure their
    // rates.
    run(&mut network, 100 * MS);
    let (begin, _) = drain(&network);
    assert!(begin.iter().any(|frame| frame.1 == ECHO.0), "{begin:?}");
    run(&mut network, 100 * MS + 101 * CYCLE + 5 * MS);
    let (frames, errors) = drain(&network);
    let cycles = judge(&frames);
    assert!(cycles >= 100, "{cycles}");
    assert_eq!(errors, 0);
}

#[test]
fn boards_that_were_driven_off_the_bus_come_back() {
    let mut network = network();
    run(&mut network, 100 * MS);
    let at = |time| SimTime::from_ticks(0) + SimDuration::from_ticks(time);
    // Behind the identifier, so that each attempt is an error of its sender.
    network.bus().disturb(Disturbance::Suppress {
        id: None,
        bit: 20,
        spared: None,
        from: at(100 * MS),
        until: at(300 * MS),
    });
    run(&mut network, 1000 * MS);
    let records = network.bus().drain_records();
    let off = records.iter().filter(|record| {
        matches!(
            record.kind,
            RecordKind::StateChange {
                state: ErrorState::BusOff
            }
        )
    });
    assert!(off.count() >= 1, "the master is off the bus");
    let frames = records.iter().filter(|record| {
        record.at > at(300 * MS) && matches!(record.kind, RecordKind::FrameEnd { .. })
    });
    assert_eq!(frames.count(), 0, "nodes in S3 are silent");
    // They pause for a second.
    run(&mut network, 1700 * MS);
    drain(&network);
    run(&mut network, 1700 * MS + 21 * CYCLE);
    let (frames, errors) = drain(&network);
    let cycles = judge(&frames);
    assert!(cycles >= 20 && errors == 0, "{cycles} {errors}");
}

#[test]
fn frames_that_no_node_sends_disturb_nobody() {
    let mut network = network();
    let tester = network.bus().add_tester(Tester::new());
    run(&mut network, 200 * MS);
    let (frames, _) = drain(&network);
    let begun = frames.iter().rfind(|frame| frame.1 == REFERENCE);
    let begun = begun.expect("the master leads").0;
    let id = Id::Standard(StandardId::new(0x300).expect("11 bits"));
    let lengths = [9, 15].map(|dlc| Frame::from_parts(id, false, dlc, &[0xAA; 8]));
    let remote = Frame::new_remote(id, 8);
    for (cycle, frame) in lengths.into_iter().chain([remote]).enumerate() {
        // Behind the windows of the next basic cycles.
        let at = begun + CYCLE * (cycle as u64 + 1) + 6 * MS;
        let at = SimTime::from_ticks(0) + SimDuration::from_ticks(at);
        let frame = frame.expect("a frame that a controller can send");
        network.bus().send_at(tester, at, frame, Retry::Once);
    }
    run(&mut network, 200 * MS + 30 * CYCLE);
    let (mut frames, errors) = drain(&network);
    let before = frames.len();
    frames.retain(|frame| frame.1 != 0x300);
    assert_eq!((before - frames.len(), errors), (3, 0));
    assert!(judge(&frames) >= 28);
}

#[test]
#[ignore = "builds the crates of embassy"]
fn a_board_with_embassy_keeps_the_schedule_with_another_one_and_with_rtic() {
    for (name, images) in [
        ("both", [image_with_embassy(), image_with_embassy()]),
        ("the master", [image_with_embassy(), image()]),
        ("the echo", [image(), image_with_embassy()]),
    ] {
        let mut network = network_of(images);
        run(&mut network, 100 * MS);
        let (begin, _) = drain(&network);
        assert!(begin.iter().any(|it| it.1 == ECHO.0), "{name}: {begin:?}");
        run(&mut network, 100 * MS + 101 * CYCLE + 5 * MS);
        let (frames, errors) = drain(&network);
        let cycles = judge_within(&frames, ON_TIME_WITH_EMBASSY);
        assert!(cycles >= 100 && errors == 0, "{name}: {cycles} {errors}");
    }
}
