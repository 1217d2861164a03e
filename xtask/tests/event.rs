//! The images of two boards that send at once, without a schedule, on the virtual vehicle.

use std::fs;
use std::sync::OnceLock;

use campaign::traffic::{Sent, Traffic};
use twin::{Images, Twin, part::Pin};
use vehicle_model::{NodeIndex, Overrides, Protocol, Vehicle};
use world::{Scenario, SimTime};
use xtask::{Workspace, build, vehicle};

const MASTER: NodeIndex = NodeIndex(0);
const MOTOR: NodeIndex = NodeIndex(1);
const KNOB: u16 = 200;
const COMMAND: u16 = 300;
/// The motor's relay.
const RELAY: Pin = Pin::new('A', 8);

fn two_boards(protocol: Protocol) -> Vehicle {
    let workspace = Workspace::find().unwrap();
    let overrides = Overrides::default().on(protocol);
    vehicle::with(&workspace, "two-boards", &overrides).unwrap()
}

fn built(vehicle: &Vehicle) -> Vec<build::Image> {
    let nodes: Vec<_> = vehicle.nodes().collect();
    build::images(&Workspace::find().unwrap(), vehicle, &nodes).unwrap()
}

fn images() -> &'static Images {
    static IMAGES: OnceLock<Images> = OnceLock::new();
    IMAGES.get_or_init(|| build::read(&built(&two_boards(Protocol::EventTriggered))).unwrap())
}

const fn ms(ms: u64) -> SimTime {
    SimTime::from_ticks(ms * 1_000_000_000)
}

/// The boards in a scenario of these events.
fn boards(events: &str) -> Twin {
    let vehicle = two_boards(Protocol::EventTriggered);
    let text = format!("summary = \"events\"\n{events}");
    let scenario = Scenario::parse(&vehicle, "events", "events", &text).unwrap();
    Twin::new(&vehicle, &scenario, 1, images()).unwrap()
}

/// The complete frames of a message in this time.
fn frames(twin: &Twin, id: u16, time: std::ops::Range<u64>) -> Vec<Sent> {
    let all = Traffic::so_far(twin).frames.into_iter();
    let wanted = |frame: &Sent| frame.complete && frame.id == id && frame.node.is_some();
    all.filter(wanted)
        .filter(|frame| (ms(time.start)..ms(time.end)).contains(&frame.end))
        .collect()
}

/// An event: the knob is turned to this position.
fn turn(ms: u32, percent: u32) -> String {
    format!("[[knob]]\nnode = \"motor\"\nat = \"{ms} ms\"\nposition = \"{percent} %\"\n")
}

#[test]
fn a_turn_of_the_knob_reaches_the_motor_within_a_sample_and_a_millisecond() {
    let mut twin = boards(&turn(1000, 100));
    twin.run_until(ms(1000)).unwrap();
    assert!(!twin.node(MOTOR).pin(RELAY));
    twin.run_until(ms(1007)).unwrap();
    assert!(twin.node(MOTOR).pin(RELAY));
    // 200 samples in a second, and a command for each of them.
    let (samples, commands) = (
        frames(&twin, KNOB, 0..1000),
        frames(&twin, COMMAND, 0..1000),
    );
    assert!(samples.len() > 195, "{}", samples.len());
    assert!(commands.len().abs_diff(samples.len()) <= 2);
    let references = Traffic::so_far(&twin).frames;
    assert!(references.iter().all(|frame| frame.id != 100));
}

#[test]
fn the_motor_stops_when_the_commands_cease_and_obeys_again_when_they_are_back() {
    let silent = "[[reset]]\nnode = \"master\"\nat = \"500 ms\"\nuntil = \"600 ms\"\n";
    let mut twin = boards(&(turn(200, 100) + silent));
    twin.run_until(ms(500)).unwrap();
    assert!(twin.node(MOTOR).pin(RELAY));
    // Two periods of 20 ms, as the network file says, and what one may be late.
    twin.run_until(ms(545)).unwrap();
    assert!(!twin.node(MOTOR).pin(RELAY));
    twin.run_until(ms(900)).unwrap();
    assert!(twin.node(MOTOR).pin(RELAY));
}

#[test]
fn every_message_is_sent_although_a_foreign_node_takes_most_of_the_bus() {
    // Eight bytes in 250 kbit/s take 0.5 ms.
    let foreign = "[[bus]]\nwhat = \"frame\"\nat = \"200 ms\"\nuntil = \"1200 ms\"\n\
                   every = \"650 us\"\ndata = [1, 2, 3, 4, 5, 6, 7, 8]\nid = ";
    for id in [1, 2000] {
        let mut twin = boards(&format!("{foreign}{id}\n"));
        twin.run_until(ms(1200)).unwrap();
        let all = Traffic::so_far(&twin).frames;
        let strangers = all.iter().filter(|frame| frame.complete && frame.id == id);
        assert!(strangers.count() > 1400);
        for message in [KNOB, COMMAND] {
            let sent = frames(&twin, message, 200..1200).len();
            assert!((199..=201).contains(&sent), "{message}: {sent}");
        }
    }
}

#[test]
fn a_frame_that_an_error_destroys_is_repeated_at_once() {
    let corrupt = "[[bus]]\nwhat = \"corrupt\"\nat = \"500 ms\"\nid = 300\ncount = 2\n";
    let mut twin = boards(corrupt);
    twin.run_until(ms(600)).unwrap();
    let all = Traffic::so_far(&twin).frames;
    let destroyed = all
        .iter()
        .filter(|frame| !frame.complete && frame.id == COMMAND);
    assert_eq!(destroyed.count(), 2);
    let commands = frames(&twin, COMMAND, 400..600);
    for pair in commands.windows(2) {
        let apart = (pair[1].end.as_ticks() - pair[0].end.as_ticks()) / 1_000_000;
        assert!((3_500..6_500).contains(&apart), "{apart} us");
    }
}

#[test]
fn a_node_without_its_external_clock_sends_nothing() {
    let clock = "[[clock]]\nnode = \"master\"\nat = \"0 s\"\npresent = false\n";
    let mut twin = boards(clock);
    twin.run_until(ms(8000)).unwrap();
    let all = Traffic::so_far(&twin).frames;
    assert!(all.iter().all(|frame| frame.node != Some(MASTER)));
}

#[test]
fn the_images_of_the_two_protocols_are_kept_apart() {
    let event = built(&two_boards(Protocol::EventTriggered));
    let before: Vec<_> = event.iter().map(|i| fs::read(&i.path).unwrap()).collect();
    let time = built(&two_boards(Protocol::TimeTriggered));
    for ((event, time), before) in event.iter().zip(&time).zip(before) {
        assert_ne!(event.path, time.path);
        assert_eq!(fs::read(&event.path).unwrap(), before);
        assert_ne!(fs::read(&time.path).unwrap(), before);
    }
}
