//! Gates between the transmit pins of nodes and the bus, as a bus guardian has them.

mod common;

use can_bus::wire::WireFrame;
use can_bus::{Bus, ErrorState, Level, NodeId, RecordKind, Retry, Tester};
use common::*;

/// The frames that were sent completely, by their senders.
fn sent(bus: &mut Bus) -> Vec<NodeId> {
    let records = bus.drain_records();
    let ends = records.iter().filter_map(|record| match record.kind {
        RecordKind::FrameEnd { .. } => Some(record.node),
        _ => None,
    });
    ends.collect()
}

#[test]
fn a_closed_gate_keeps_all_of_a_node_off_the_bus_and_the_node_does_not_know() {
    let mut bus = Bus::new();
    let gated = normal_node(&mut bus, 0);
    let (one, other) = (normal_node(&mut bus, 0), normal_node(&mut bus, 0));
    let now = bus.now();
    bus.close_gate(gated, true, now);
    request(&mut bus, gated, 0, &frame(0x123, &[0x55; 4]), now);
    // Start of frame: the node drives, the bus does not follow, and the node finds a bit error.
    bus.advance_to(now + bits(2));
    assert_eq!(bus.transmit_level(gated), Level::Dominant);
    bus.advance_to(now + bits(4000));
    let counters = bus.error_counters(gated);
    assert_eq!(counters.state(), ErrorState::BusOff, "{counters:?}");
    assert_eq!(bus.transmit_level(gated), Level::Recessive);
    for node in [one, other] {
        let counters = bus.error_counters(node);
        assert_eq!((counters.transmit(), counters.receive()), (0, 0));
    }
    assert_eq!(sent(&mut bus), []);
    // The bus is free for the others.
    let now = bus.now();
    request(&mut bus, one, 0, &frame(0x124, &[1]), now);
    bus.advance_to(now + bits(200));
    assert_eq!(sent(&mut bus), [one]);
}

#[test]
fn a_gate_also_blocks_the_acknowledge_bit() {
    let mut bus = Bus::new();
    let (sender, only) = (normal_node(&mut bus, NART), normal_node(&mut bus, NART));
    let now = bus.now();
    bus.close_gate(only, true, now);
    request(&mut bus, sender, 0, &frame(0x123, &[1]), now);
    bus.advance_to(now + bits(300));
    assert_eq!(sent(&mut bus), []);
    let now = bus.now();
    bus.close_gate(only, false, now);
    request(&mut bus, sender, 0, &frame(0x123, &[1]), now);
    bus.advance_to(now + bits(300));
    assert_eq!(sent(&mut bus), [sender]);
}

#[test]
fn a_gate_that_closes_in_a_frame_ends_it_there() {
    let mut bus = Bus::new();
    let gated = normal_node(&mut bus, NART);
    let (one, other) = (normal_node(&mut bus, 0), normal_node(&mut bus, 0));
    let now = bus.now();
    // Frames of two nodes: the others see six equal bits, send their flags, and are ready for the second.
    request(&mut bus, gated, 0, &frame(0x123, &[0x55; 8]), now);
    bus.close_gate(gated, true, now + bits(22));
    request(&mut bus, one, 0, &frame(0x124, &[1]), now + bits(30));
    bus.advance_to(now + bits(50));
    let receive = bus.error_counters(other).receive();
    assert!((1..=9).contains(&receive), "{receive}");
    bus.advance_to(now + bits(400));
    assert_eq!(sent(&mut bus), [one]);
}

#[test]
fn what_drives_the_pin_of_a_node_is_behind_its_gate() {
    let mut bus = Bus::new();
    let (gated, one) = (normal_node(&mut bus, 0), normal_node(&mut bus, 0));
    normal_node(&mut bus, 0);
    let babbler = bus.add_tester_at(gated, Tester::new());
    let now = bus.now() + bits(20);
    bus.advance_to(now);
    let wanted = frame(0x7F, &[1]);
    bus.send_at(babbler, now, wanted, Retry::Once);
    bus.advance_to(now + bits(2));
    assert_eq!(bus.transmit_level(gated), Level::Dominant);
    assert_eq!(bus.transmit_level(one), Level::Recessive);
    let length = WireFrame::encode(&wanted).bits() as u64;
    bus.advance_to(now + bits(length + 20));
    assert_eq!(sent(&mut bus), [babbler]);
    let now = bus.now();
    bus.close_gate(gated, true, now);
    bus.play_raw(babbler, now, vec![Level::Dominant; 500]);
    request(&mut bus, one, 0, &frame(0x124, &[1]), now);
    bus.advance_to(now + bits(200));
    assert_eq!(bus.transmit_level(gated), Level::Dominant);
    assert_eq!(sent(&mut bus), [one]);
}
