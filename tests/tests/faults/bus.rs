//! Disturbances of the bus: foreign nodes, destroyed frames, a bus held dominant.

use can_bus::{Disturbance, ErrorState, Frame, Level, RecordKind, Tester};
use furrow_tests::Journey;
use furrow_tests::nodes;
use furrow_tests::time::{at, seconds, span};
use vehicle_model::NodeIndex;
use world::SimTime;

use crate::{assert_never_reset, assert_steady, last_before, mode, next_cycle, running};

/// Upper bound for rejoining, s: the reference is sent as soon as the bus is free, then the nodes
/// need two of them.
const REJOIN: f64 = 0.3;

/// The times at which a node entered an error state.
fn entered(journey: &Journey, node: NodeIndex, state: ErrorState) -> Vec<SimTime> {
    let id = journey.vehicle.node(node).node();
    let records = journey.vehicle.records().iter();
    records
        .filter(|record| Some(record.node) == id)
        .filter(|record| matches!(record.kind, RecordKind::StateChange { state: s } if s == state))
        .map(|record| record.at)
        .collect()
}

/// A foreign node sends frames with this identifier without a pause for 0.7 s.
fn babble(id: u16) {
    let mut journey = running("");
    let tester = journey.vehicle.network().bus().add_tester(Tester::new());
    let frame = Frame::standard(id, &[0x55; 8]).expect("a frame");
    journey
        .vehicle
        .network()
        .bus()
        .babble(tester, frame, at(3.05), at(3.75));
    journey.to(3.75);
    let last = last_before(&journey, 300, at(3.75));
    let stopped = journey.stopped(at(3.05)).expect("the motors stop");
    assert!(
        stopped <= (last.start + span(0.201)).max(at(3.05)),
        "{} s",
        seconds(stopped)
    );
    journey.to(5.2);
    assert!(journey.last_moved(nodes::DRIVE) < Some(stopped.max(at(3.05))));
    assert_steady(
        &journey,
        &[100, 206, 300, 450, 453],
        3.75 + 2.0 * REJOIN,
        5.2,
    );
    assert_ne!(journey.mode(), Some(mode::RUN));
    assert_never_reset(&journey);
    journey.assert_in_place();
}

#[test]
fn a_babbling_node_of_the_highest_priority_stops_the_vehicle_and_no_more() {
    babble(0);
}

#[test]
fn a_babbling_node_of_the_lowest_priority_pushes_no_frame_out_of_its_window() {
    let mut journey = running("");
    let tester = journey.vehicle.network().bus().add_tester(Tester::new());
    let frame = Frame::standard(0x7FF, &[0x55; 8]).expect("a frame");
    journey
        .vehicle
        .network()
        .bus()
        .babble(tester, frame, at(3.05), at(3.75));
    journey.to(5.0);
    journey.assert_in_place();
    assert_never_reset(&journey);
    assert_steady(
        &journey,
        &[100, 206, 300, 450, 453],
        3.75 + 2.0 * REJOIN,
        5.0,
    );
}

#[test]
fn foreign_frames_in_exclusive_windows_are_counted_and_survived() {
    let mut journey = running(
        r#"
        [[bus]]
        what = "frame"
        at = "3.1 s"
        id = 206
        data = [0, 8]
        every = "1.7 ms"
        until = "3.6 s"
        [[bus]]
        what = "frame"
        at = "3.1 s"
        id = 2
        every = "3.1 ms"
        until = "3.6 s"
        "#,
    );
    journey.to(4.8);
    assert_never_reset(&journey);
    assert_steady(
        &journey,
        &[100, 206, 300, 450, 453],
        3.6 + 2.0 * REJOIN,
        4.8,
    );
    journey.assert_in_place();
}

#[test]
fn a_node_driven_into_bus_off_comes_back_by_itself() {
    let mut journey = running("");
    let begin = next_cycle(&mut journey);
    // The bus is held dominant in the middle of the steering node's frame. After the node's error
    // flag it reads dominant bits only, and every eight of them add eight to its error count (ISO
    // 11898-1).
    let from = begin + span(0.006_1);
    let until = from + span(0.003);
    journey.vehicle.network().bus().disturb(Disturbance::Stuck {
        level: Level::Dominant,
        from,
        until,
    });
    let start = seconds(begin);
    journey.to(start + 1.5);
    let off = entered(&journey, nodes::STEERING, ErrorState::BusOff);
    assert_eq!(off.len(), 1, "{off:?}");
    assert!(off[0] < until);
    // The other nodes continue; the drive stops because the potentiometer's message is missing.
    assert_steady(&journey, &[100, 300], 1.0, start);
    assert_steady(&journey, &[100, 300], start + 0.1, start + 1.5);
    let back = crate::first_after(&journey, 206, off[0]);
    // The node stays off the bus for two basic cycles, waits for 128 times eleven recessive bits
    // (5.6 ms) and needs two references.
    assert!(
        back.start < off[0] + span(0.2 + 0.3),
        "{} s",
        seconds(back.start) - seconds(off[0])
    );
    assert_steady(&journey, &[206], seconds(back.start), start + 1.5);
    let active = entered(&journey, nodes::STEERING, ErrorState::Active);
    assert!(active.iter().any(|&when| when > off[0]));
    assert_never_reset(&journey);
    journey.assert_in_place();
}

#[test]
fn a_bus_held_dominant_stops_the_vehicle_and_is_left_behind() {
    let mut journey = running("bus = [{ what = \"dominant\", at = \"3.2 s\", hold = \"300 ms\" }]");
    journey.to(5.5);
    let last = last_before(&journey, 300, at(3.2));
    let stopped = journey.stopped(at(3.2)).expect("the motors stop");
    assert!(
        stopped <= last.start + span(0.201),
        "{} s",
        seconds(stopped)
    );
    assert!(journey.last_moved(nodes::DRIVE) < Some(stopped));
    assert_steady(&journey, &[206, 300, 450, 453], 4.5, 5.5);
    assert_never_reset(&journey);
    journey.assert_in_place();
}

#[test]
fn destroyed_references_and_commands_stop_the_vehicle_only_when_two_in_a_row_are_missing() {
    let one = running("bus = [{ what = \"corrupt\", at = \"3.01 s\", id = 300 }]");
    let mut journey = one;
    journey.to(4.0);
    assert_eq!(journey.mode(), Some(mode::RUN));
    let drive = |journey: &Journey, from, until| {
        let changes = journey.vehicle.world().efforts().iter();
        changes
            .filter(|change| change.node == nodes::DRIVE && change.effort == 0.0)
            .any(|change| (at(from)..at(until)).contains(&change.at))
    };
    assert!(!drive(&journey, 3.0, 4.0), "one lost command stops nothing");

    let mut journey =
        running("bus = [{ what = \"corrupt\", at = \"3.01 s\", id = 300, count = 2 }]");
    journey.to(4.0);
    let last = last_before(&journey, 300, at(3.1));
    let stopped = journey.stopped(at(3.1)).expect("the motors stop");
    assert!(
        stopped <= last.start + span(0.201),
        "{} s",
        seconds(stopped)
    );
    journey.assert_in_place();
}

/// Requests that were pending when the nodes left a bus that was held dominant do not go out when
/// they join it again: their contents are of long ago.
#[test]
fn no_frame_of_before_goes_out_when_the_bus_is_free_again() {
    let mut journey = running("bus = [{ what = \"dominant\", at = \"3.2 s\", hold = \"800 ms\" }]");
    journey.to(5.5);
    let traffic = journey.traffic();
    let stale: Vec<_> = traffic
        .frames
        .iter()
        .filter(|frame| frame.start > at(3.21) && [100, 101].contains(&frame.id))
        .filter_map(|frame| {
            let [_, a, b, c, d, ..] = frame.bytes();
            let time = f64::from(u32::from_be_bytes([a, b, c, d])) / 1000.0;
            let first = last_before(&journey, 100, at(3.2));
            let [_, a, b, c, d, ..] = first.bytes();
            let base = f64::from(u32::from_be_bytes([a, b, c, d])) / 1000.0;
            let wrong = time - base - (seconds(frame.start) - seconds(first.start));
            (wrong.abs() > 0.01).then_some((frame.id, seconds(frame.start), wrong))
        })
        .collect();
    assert!(
        stale.is_empty(),
        "(identifier, at, time is wrong by, s): {stale:?}"
    );
    assert_steady(&journey, &[206, 300, 450, 453], 4.8, 5.5);
    assert_never_reset(&journey);
    journey.assert_in_place();
}
