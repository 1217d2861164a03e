//! The four release images drive the virtual vehicle.

use can_bus::{Frame, RecordKind, SimDuration, SimTime};
use embedded_can::Id;
use furrow_tests::images;
use furrow_tests::nodes;
use std::collections::BTreeMap;
use twin::{Options, Outcome, Twin};
use vehicle_model::NodeIndex;
use world::Scenario;

const MS: u64 = 1_000_000_000;
const US: u64 = 1_000_000;

/// Windows of the system matrix (thesis figure 6.13, and the drive's own): identifier, sender,
/// start in ms after the reference mark.
const WINDOWS: [(u16, NodeIndex, u64); 13] = [
    (100, nodes::GPS, 0),
    (401, nodes::GPS, 1),
    (402, nodes::GPS, 2),
    (200, nodes::GPS, 3),
    (201, nodes::GPS, 4),
    (202, nodes::GPS, 5),
    (206, nodes::STEERING, 6),
    (300, nodes::CONTROLLER, 7),
    (450, nodes::CONTROLLER, 8),
    (451, nodes::CONTROLLER, 9),
    (452, nodes::CONTROLLER, 10),
    (453, nodes::CONTROLLER, 11),
    (208, nodes::DRIVE, 88),
];

/// Events of the arbitrating windows.
const EVENTS: std::ops::RangeInclusive<u16> = 500..=599;

fn number(frame: &Frame) -> u16 {
    match frame.id() {
        Id::Standard(id) => id.as_raw(),
        Id::Extended(id) => panic!("an extended frame {:x}", id.as_raw()),
    }
}

fn simulate(scenario: &str, seed: u64, milliseconds: u64) -> Outcome {
    let scenario = Scenario::find(furrow_tests::vehicle(), scenario).expect("a built-in scenario");
    let options = Options {
        seed,
        duration: Some(SimDuration::from_ticks(milliseconds * MS)),
        ..Options::default()
    };
    twin::run(
        furrow_tests::vehicle(),
        &scenario,
        images(),
        &options,
        |_| {},
    )
    .expect("images of the four nodes")
}

/// Complete frames: sender, frame, start, end.
fn frames(outcome: &Outcome) -> Vec<(NodeIndex, Frame, SimTime, SimTime)> {
    let frames = outcome.records.iter().filter_map(|record| {
        let RecordKind::FrameEnd { frame, start, .. } = record.kind else {
            return None;
        };
        Some((outcome.node_at(record.node)?, frame, start, record.at))
    });
    frames.collect()
}

fn seen_in(outcome: &Outcome, id: u16, from: u64, until: u64) -> usize {
    frames(outcome)
        .iter()
        .filter(|(_, frame, start, _)| {
            number(frame) == id && (from * MS..until * MS).contains(&start.as_ticks())
        })
        .count()
}

#[test]
fn every_message_starts_in_its_own_window_and_nobody_disturbs_another() {
    let outcome = simulate("straight-line", 1, 8_000);
    let mut reference = None;
    let mut counts: BTreeMap<u16, usize> = BTreeMap::new();
    for (sender, frame, start, _) in frames(&outcome) {
        let id = number(&frame);
        *counts.entry(id).or_default() += 1;
        if id == 100 {
            reference = Some(start);
        }
        let Some(mark) = reference else {
            panic!("{id} before the first reference");
        };
        let after = start.as_ticks() - mark.as_ticks();
        if let Some((_, owner, window)) = WINDOWS.iter().find(|(w, ..)| *w == id) {
            assert_eq!(sender, *owner, "{id}");
            let late = after as i64 - (window * MS) as i64;
            // In the first cycle a node does not know yet by how much its crystal differs from the
            // master's: 100 ppm at most.
            let early = 4 * US + window * MS / 10_000;
            assert!(
                (-(early as i64)..=40 * US as i64).contains(&late),
                "{id} starts {} us after its window",
                late as f64 / US as f64
            );
        } else {
            assert!(EVENTS.contains(&id), "{id} is in no window");
            // The nodes' times agree to about a microsecond; a start one bit early still counts as
            // on time.
            let window = 12 * MS - 4 * US..16 * MS;
            assert!(window.contains(&after), "{id} starts at {after} ps");
        }
    }
    for (id, ..) in WINDOWS {
        assert!(counts.get(&id).is_some_and(|&n| n > 20), "{id}: {counts:?}");
    }
    let wrong = outcome.records.iter().find(|record| match &record.kind {
        RecordKind::FrameStart { .. } | RecordKind::FrameEnd { .. } => false,
        // Event messages share their windows by priority.
        RecordKind::ArbitrationLost { frame, .. } => !EVENTS.contains(&number(frame)),
        _ => true,
    });
    assert_eq!(
        wrong, None,
        "no error, no lost arbitration in a node's own window"
    );
    for node in &outcome.nodes {
        assert_eq!(node.resets.len(), 1, "{:?}", node.node);
        assert!(!node.locked_up);
        assert!(node.unmodelled.is_empty(), "{:x?}", node.unmodelled);
        assert!(node.load.utilisation() < 0.1);
    }
}

#[test]
fn one_seed_gives_one_run_and_another_seed_another() {
    let fingerprint = |outcome: &Outcome| {
        let states = outcome.world.states().to_vec();
        let nodes = outcome.nodes.iter().cloned();
        let of_nodes: Vec<_> = nodes.map(|node| (node.load, node.console)).collect();
        (outcome.records.clone(), format!("{states:?}"), of_nodes)
    };
    let (a, b) = (
        simulate("straight-line", 7, 2_500),
        simulate("straight-line", 7, 2_500),
    );
    assert!(fingerprint(&a) == fingerprint(&b));
    let other = simulate("straight-line", 8, 2_500);
    let data = |outcome: &Outcome| -> Vec<_> {
        frames(outcome)
            .iter()
            .map(|(_, frame, ..)| *frame)
            .collect()
    };
    assert!(data(&a) != data(&other), "other noise");
}

#[test]
fn slices_do_not_change_a_run() {
    let scenario =
        Scenario::find(furrow_tests::vehicle(), "straight-line").expect("a built-in scenario");
    let mut vehicle = Twin::new(furrow_tests::vehicle(), &scenario, 7, images()).expect("images");
    let mut t = 0;
    while t < 1_500 {
        t += 100;
        vehicle
            .run_until(SimTime::from_ticks(t * MS))
            .expect("programs that the parts allow");
    }
    let whole = simulate("straight-line", 7, 1_500);
    assert_eq!(vehicle.records(), whole.records);
}

#[test]
fn a_lost_fix_empties_its_windows_and_stops_the_vehicle() {
    // The fix is lost at 20 s.
    let outcome = simulate("gps-lost", 1, 22_500);
    assert!(seen_in(&outcome, 200, 18_000, 20_000) >= 19);
    assert!(seen_in(&outcome, 202, 18_000, 20_000) >= 19);
    assert_eq!(seen_in(&outcome, 200, 20_300, 21_500), 0);
    assert_eq!(seen_in(&outcome, 202, 20_300, 21_500), 0);
    assert!(seen_in(&outcome, 100, 20_300, 21_500) >= 11);
    assert_eq!(outcome.world.effort(nodes::DRIVE), 0.0);
    let running = outcome
        .world
        .efforts()
        .iter()
        .rev()
        .find(|change| change.node == nodes::DRIVE)
        .expect("the drive motor was driven");
    // A second is bridged.
    assert!((21_000 * MS..21_500 * MS).contains(&running.at.as_ticks()));
}

#[test]
fn without_its_master_both_motors_stop_within_two_basic_periods() {
    // The gps node is held in reset from 20 s on.
    let outcome = simulate("master-dead", 1, 21_000);
    for node in [nodes::STEERING, nodes::DRIVE] {
        let last = outcome
            .world
            .efforts()
            .iter()
            .rfind(|change| change.node == node)
            .expect("the motor was driven");
        assert_eq!(last.effort, 0.0, "{node:?}");
        let at = last.at.as_ticks();
        assert!(at < 20_200 * MS, "{node:?} stopped at {} ms", at / MS);
        if node == nodes::DRIVE {
            assert!(at > 20_000 * MS);
        }
    }
}
