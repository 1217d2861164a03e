//! What `boards/GETTING_STARTED.md` promises of two boards: their consoles, their LEDs, the
//! frames on the bus and the figures to measure, compared with the virtual vehicle and the code.

use std::{collections::BTreeSet, fs, sync::OnceLock};

use campaign::traffic::Traffic;
use firmware::{
    console::{BusView, Line},
    e2e::Proof,
    housekeeping::{Housekeeping, ResetCause, Start},
    link,
    selftest::{self, Check, Outcome, Report},
};
use parts::Sled;
use sled_common::{
    can::ErrorState,
    clock::{Clocks, Oscillator},
    selftest::Findings,
};
use ttcan::{ClockState, ErrorLevel, MasterState, Status, SyncState};
use twin::{Options, Twin, part::Pin};
use vehicle_model::{NodeIndex, Vehicle};
use world::{Scenario, SimTime};
use xtask::{Workspace, build, vehicle};

/// What the guide does with the boards: it turns the knob to one end, resets the master, and takes
/// the motor's board away.
const SCENARIO: &str = r#"
summary = "the guide"
duration = "4 s"
knob = [{ node = "motor", at = "1 s", position = "100 %" }]
reset = [
    { node = "master", at = "2 s", until = "2.5 s" },
    { node = "motor", at = "3.2 s" },
]
"#;

const GUIDE: &str = "boards/GETTING_STARTED.md";

fn workspace() -> Workspace {
    Workspace::find().unwrap()
}

fn guide() -> String {
    fs::read_to_string(workspace().root().join(GUIDE)).unwrap()
}

fn two_boards() -> Vehicle {
    vehicle::find(&workspace(), "two-boards").unwrap()
}

/// What is to be seen of a run.
struct Seen {
    /// The console of each node.
    consoles: Vec<String>,
    /// Identifiers and lengths of the frames on the bus.
    frames: BTreeSet<(u16, usize)>,
}

/// The two boards of the guide.
fn seen() -> &'static Seen {
    static SEEN: OnceLock<Seen> = OnceLock::new();
    SEEN.get_or_init(|| {
        let vehicle = two_boards();
        let nodes: Vec<_> = vehicle.nodes().collect();
        let images = build::images(&workspace(), &vehicle, &nodes).unwrap();
        let images = build::read(&images).unwrap();
        let scenario = Scenario::parse(&vehicle, "guide", GUIDE, SCENARIO).unwrap();
        let options = Options::default();
        let outcome = twin::run(&vehicle, &scenario, &images, &options, |_| {}).unwrap();
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let frames = Traffic::of(&outcome).frames;
        Seen {
            consoles: outcome
                .nodes
                .iter()
                .map(|node| text(&node.console))
                .collect(),
            frames: frames
                .iter()
                .map(|frame| (frame.id, frame.data.len()))
                .collect(),
        }
    })
}

/// When the relay of the motor's board closes or opens in a run of these events, in milliseconds. The
/// relay is open at first.
fn relay_changes(events: &str, end: u32) -> Vec<u32> {
    const RELAY: Pin = Pin::new('A', 8);
    const MOTOR: NodeIndex = NodeIndex(1);
    let vehicle = two_boards();
    let nodes: Vec<_> = vehicle.nodes().collect();
    assert_eq!(vehicle.node(MOTOR).name, "motor");
    let images = build::images(&workspace(), &vehicle, &nodes).unwrap();
    let images = build::read(&images).unwrap();
    let text = format!("summary = \"the relay\"\n{events}");
    let scenario = Scenario::parse(&vehicle, "relay", "relay", &text).unwrap();
    let mut twin = Twin::new(&vehicle, &scenario, 1, &images).unwrap();
    let mut closed = false;
    let mut changes = Vec::new();
    for ms in 1..=end {
        twin.run_until(SimTime::from_ticks(u64::from(ms) * 1_000_000_000))
            .unwrap();
        let now = twin.node(MOTOR).pin(RELAY);
        if now != closed {
            changes.push(ms);
            closed = now;
        }
    }
    changes
}

/// An event: the knob is turned to this position.
fn turn(ms: u32, percent: u32) -> String {
    format!("[[knob]]\nnode = \"motor\"\nat = \"{ms} ms\"\nposition = \"{percent} %\"\n")
}

/// The time from the knob to the motor: `cargo xtask schedulability` bounds it by 50 ms.
const DELAY: u32 = 50;

#[test]
fn the_relay_opens_half_a_second_after_the_motor_is_stopped() {
    let changes = relay_changes(&(turn(1_000, 100) + &turn(1_500, 50)), 2_500);
    let [closed, opened] = changes[..] else {
        panic!("{changes:?}")
    };
    assert!((1_000..1_000 + DELAY).contains(&closed), "{changes:?}");
    assert!((1_980..2_000 + DELAY).contains(&opened), "{changes:?}");
}

/// Each position lasts longer than a command.
#[test]
fn a_knob_that_trembles_at_its_middle_does_not_make_the_relay_rattle() {
    let mut events = String::new();
    for k in 0..20 {
        events += &turn(1_000 + 100 * k, 55);
        events += &turn(1_050 + 100 * k, 50);
    }
    let changes = relay_changes(&events, 3_700);
    let [_, opened] = changes[..] else {
        panic!("{} changes: {changes:?}", changes.len())
    };
    assert!((3_430..3_450 + DELAY).contains(&opened), "{changes:?}");
}

#[test]
fn the_relay_opens_at_once_when_there_is_no_valid_command() {
    // The commands stop while the knob is at its end, and after it was turned back.
    for middle in [2_000, 1_400] {
        let events = turn(1_000, 100)
            + &turn(middle, 50)
            + "[[reset]]\nnode = \"master\"\nat = \"1.5 s\"\nuntil = \"2.5 s\"\n";
        let changes = relay_changes(&events, 2_400);
        let [_, opened] = changes[..] else {
            panic!("{changes:?}")
        };
        assert!((1_500..1_550).contains(&opened), "{changes:?}");
    }
}

/// The lines of the code blocks that begin with this word.
fn quoted(block: &str) -> Vec<String> {
    let guide = guide();
    let opening = format!("```text {block}\n");
    let blocks = guide.split(&opening).skip(1);
    let lines: Vec<String> = blocks
        .flat_map(|rest| rest.split("```").next().unwrap_or_default().lines())
        .map(String::from)
        .collect();
    assert!(!lines.is_empty(), "{GUIDE} has no block {block}");
    lines
}

/// A line without its numbers. Zeros stay, because many numbers count what went wrong, and so do
/// error levels.
fn shape(line: &str) -> String {
    let numbers = line.split_inclusive(|c: char| !c.is_ascii_digit());
    let mut shape = String::new();
    for piece in numbers {
        let rest = piece.trim_start_matches(|c: char| c.is_ascii_digit());
        let number = &piece[..piece.len() - rest.len()];
        let kept = matches!(number, "" | "0") || shape.ends_with('S');
        shape.push_str(if kept { number } else { "#" });
        shape.push_str(rest);
    }
    shape
}

#[test]
fn the_consoles_show_what_the_guide_quotes() {
    let vehicle = two_boards();
    for node in vehicle.nodes() {
        let name = &vehicle.node(node).name;
        let shown: BTreeSet<String> = seen().consoles[node.0].lines().map(shape).collect();
        for line in quoted(name) {
            assert!(shown.contains(&shape(&line)), "{name}: {line:?} {shown:#?}");
        }
    }
}

/// A line such as ` (1.000000)  can0  064   [8]  00 00`: its identifier and its length.
fn identifier_and_length(line: &str) -> (u16, usize) {
    let mut words = line.split_whitespace().skip(2);
    let id = u16::from_str_radix(words.next().unwrap(), 16).unwrap();
    let length = words
        .next()
        .unwrap()
        .trim_matches(['[', ']'])
        .parse()
        .unwrap();
    assert_eq!(words.count(), length, "{line}");
    (id, length)
}

#[test]
fn the_bus_carries_the_frames_that_the_guide_quotes() {
    let sent = &seen().frames;
    for line in quoted("candump") {
        assert!(
            sent.contains(&identifier_and_length(&line)),
            "{line} {sent:?}"
        );
    }
}

/// A node's view of its bus.
fn view(sync: SyncState, error_level: ErrorLevel) -> BusView {
    BusView {
        status: Status {
            sync,
            master: MasterState::Follower,
            error_level,
            missed_references: 0,
            cycle: 0,
            master_rank: None,
            initial_watch: false,
            clock: ClockState::Locked,
            reference_offset: 0,
        },
        missed_references: 0,
        missed_messages: 0,
        missed_windows: 0,
        misplaced: 0,
        errors: ErrorState::default(),
        link: link::Counters::default(),
        silence: None,
        trim: None,
        quiet: None,
        rank: None,
        time: Proof::Unasked,
        forged: 0,
    }
}

/// A self-test in which one check failed.
fn failed(check: Check) -> Report {
    Report {
        round: 0,
        outcomes: Check::ALL.map(|other| {
            if other == check {
                Outcome::Failed
            } else {
                Outcome::Passed
            }
        }),
        clock_error: 5,
        supply: 3300,
        stack_free: 3308,
    }
}

#[test]
fn the_self_test_is_told_as_the_guide_says() {
    let guide = guide();
    for check in Check::ALL {
        let motor = if failed(check).is_fit() {
            "obeys"
        } else {
            "stays off"
        };
        let row = format!("| {} | `{}` | {motor} |", check as u32, check.name());
        assert!(guide.contains(&row), "{row}");
    }
    // Two flashes, and the pause up to the next code.
    let steps: Vec<bool> = (0..215)
        .map(|step| selftest::code(Check::Memory, step))
        .collect();
    let lengths: Vec<usize> = steps.chunk_by(PartialEq::eq).map(<[bool]>::len).collect();
    let [on, off, _, dark, _] = lengths[..] else {
        panic!("{lengths:?}")
    };
    let code = format!(
        "{} ms on and {} ms off, then pauses for {:.1} s",
        10 * on,
        10 * off,
        (dark - off) as f64 / 100.0
    );
    assert!(guide.contains(&code), "{code}");
    let mut line = Line::new();
    selftest::show(&mut line, &failed(Check::Relay));
    let line = String::from_utf8(line.as_bytes().into()).unwrap();
    assert_eq!(quoted("failed"), [line.trim_end()]);
}

/// The LED's pattern, from its first light on: milliseconds on and off.
fn pattern(view: &BusView) -> (usize, usize) {
    let start = Start {
        cause: ResetCause::Power,
        record: None,
        clocks: Clocks::of(Sled::F446, Oscillator::External),
        secret: firmware::e2e::Secret::None,
    };
    let findings = Findings {
        memory_defect: None,
        program: None,
        clock_error: Some(0),
        loop_back: Some(true),
        reference: None,
    };
    let mut keeping = Housekeeping::new(&start, &findings);
    let steps: Vec<bool> = (0..400).map(|step| keeping.step(view, step).led).collect();
    let dark = steps.iter().position(|led| !led).unwrap();
    let steps = &steps[dark..];
    let run = |from: usize, led: bool| steps[from..].iter().take_while(|&&is| is == led).count();
    let off = run(0, false);
    (10 * run(off, true), 10 * off)
}

#[test]
fn the_led_blinks_as_the_guide_says() {
    let guide = guide();
    for (view, meaning) in [
        (
            view(SyncState::InSchedule, ErrorLevel::None),
            "in the schedule",
        ),
        (
            view(SyncState::Synchronising, ErrorLevel::None),
            "looking for the schedule",
        ),
        (
            view(SyncState::InSchedule, ErrorLevel::Error),
            "off the bus",
        ),
        (
            BusView {
                silence: Some(link::Silence::NoReference),
                ..view(SyncState::Off, ErrorLevel::None)
            },
            "on the internal oscillator: listens",
        ),
    ] {
        let (on, off) = pattern(&view);
        let row = format!("| {on} ms on, {off} ms off | {meaning}");
        assert!(guide.contains(&row), "{row}");
    }
}

#[test]
fn the_figures_to_measure_are_those_of_the_code() {
    let guide = guide();
    for sled in Sled::ALL {
        let row = format!(
            "| {} | {} ticks | {} ticks |",
            sled.title, sled.stamp_ticks, sled.transmit_lead_ticks
        );
        assert!(guide.contains(&row), "{row}");
    }
}
