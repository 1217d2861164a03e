//! Which node gets the bus, when, and whose clock determines the bit time.

mod common;

use can_bus::wire::WireFrame;
use can_bus::{Bus, ClockRate, Frame, NodeId, Part, Record, RecordKind, Retry, SimTime, Tester};
use common::*;
use embedded_can::{ExtendedId, Id, StandardId};
use proptest::prelude::*;

/// The bits with which a frame competes, as text.
fn arbitration_bits(frame: &Frame) -> String {
    let rtr = u8::from(frame.is_remote());
    match frame.id() {
        Id::Standard(id) => format!("{:011b}{rtr}0", id.as_raw()),
        Id::Extended(id) => {
            let id = format!("{:029b}", id.as_raw());
            format!("{}11{}{rtr}", &id[..11], &id[11..])
        }
    }
}

fn ends(records: &[Record]) -> Vec<(NodeId, Frame, SimTime, u16)> {
    records
        .iter()
        .filter_map(|record| match record.kind {
            RecordKind::FrameEnd { frame, start, bits } => Some((record.node, frame, start, bits)),
            _ => None,
        })
        .collect()
}

fn any_frame() -> impl Strategy<Value = Frame> {
    // Few base identifiers, so that standard and extended, data and remote frames often meet.
    let base = 0..4_u32;
    (base, any::<Option<u8>>(), any::<bool>()).prop_map(|(base, extension, remote)| {
        let id = match extension {
            None => StandardId::new(base as u16).map(Id::Standard),
            Some(low) => ExtendedId::new(base << 18 | u32::from(low)).map(Id::Extended),
        }
        .expect("in range");
        if remote {
            Frame::new_remote(id, 0).expect("valid")
        } else {
            Frame::new_data(id, &[]).expect("valid")
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(128))]

    #[test]
    fn simultaneous_frames_go_out_in_the_order_of_their_arbitration_bits(
        frames in prop::collection::vec(any_frame(), 2..6),
    ) {
        let mut unique = frames;
        unique.sort_by_key(arbitration_bits);
        unique.dedup_by_key(|frame| arbitration_bits(frame));
        let mut bus = Bus::new();
        let nodes: Vec<NodeId> = unique.iter().map(|_| bus.add_bxcan(Part::F446, f446())).collect();
        for node in &nodes {
            configure(&mut bus, *node, 0, BTR_250K_F446);
        }
        normal_node(&mut bus, 0);
        let now = bus.now();
        // The nodes request in the reverse order of priority.
        for (node, frame) in nodes.iter().zip(&unique).rev() {
            request(&mut bus, *node, 0, frame, now);
        }
        bus.advance_to(now + bits(200 * unique.len() as u64));
        let records = bus.drain_records();
        let sent: Vec<(NodeId, Frame)> =
            ends(&records).iter().map(|(node, frame, ..)| (*node, *frame)).collect();
        let expected: Vec<(NodeId, Frame)> = nodes.iter().copied().zip(unique).collect();
        prop_assert_eq!(sent, expected);
        let errors = records.iter().any(|record| matches!(record.kind, RecordKind::Error { .. }));
        prop_assert!(!errors, "arbitration is no error");
    }

    #[test]
    fn single_shot_losers_are_not_sent(ids in prop::collection::btree_set(0..0x7F0_u16, 2..6)) {
        let mut bus = Bus::new();
        let nodes: Vec<(NodeId, u16)> =
            ids.iter().map(|id| (normal_node(&mut bus, NART), *id)).collect();
        let now = bus.now();
        for (node, id) in &nodes {
            request(&mut bus, *node, 0, &frame(*id, &[1, 2]), now);
        }
        bus.advance_to(now + bits(1000));
        let sent = ends(&bus.drain_records());
        prop_assert_eq!(sent.len(), 1);
        prop_assert_eq!(sent[0].0, nodes[0].0);
        for (node, _) in &nodes[1..] {
            prop_assert_eq!(bus.read(*node, TSR) & 0xFF, 0b0101, "RQCP and ALST");
            prop_assert_eq!(bus.read(*node, ESR), 0);
        }
    }

    #[test]
    fn every_frame_arrives_once_and_whole_whatever_the_moments_of_request(
        requests in prop::collection::vec((0..4_usize, 0..4_000_u64, any::<u8>()), 1..20),
    ) {
        let mut bus = Bus::new();
        let offsets = [-50_000, 0, 20_000, 50_000];
        let nodes: Vec<NodeId> = offsets
            .iter()
            .map(|ppb| {
                let tester = Tester::new().with_timing(
                    f446().with_offset_ppb(*ppb),
                    can_bus::BitSegments::fifteen_quanta(12),
                );
                bus.add_tester(tester)
            })
            .collect();
        let logger = bus.add_tester(Tester::listener());
        bus.advance_to(at_us(100));
        for (serial, (node, at, byte)) in requests.iter().enumerate() {
            // One identifier for each sender and frame.
            let id = (serial * 4 + node) as u16;
            let at = at_us(100 + at);
            bus.send_at(nodes[*node], at, frame(id, &[*byte]), Retry::UntilSent);
        }
        bus.advance_to(at_us(20_000));
        let records = bus.drain_records();
        let sent = ends(&records);
        prop_assert_eq!(sent.len(), requests.len());
        let seen = bus.tester(logger).expect("a tester").received();
        let logged: Vec<Frame> = seen.iter().map(|reception| reception.frame).collect();
        let frames: Vec<Frame> = sent.iter().map(|(_, frame, ..)| *frame).collect();
        prop_assert_eq!(logged, frames);
        for (node, frame, start, bits) in &sent {
            let wire = WireFrame::encode(frame);
            prop_assert_eq!(usize::from(*bits), wire.bits());
            let end = records
                .iter()
                .find(|record| record.node == *node
                    && matches!(record.kind, RecordKind::FrameEnd { frame: f, .. } if f == *frame))
                .expect("just found")
                .at;
            // The sender's clock determines the bit time. Before it has won, another node's clock
            // may.
            let nominal = wire.bits() as u64 * BIT;
            let length = end.as_ticks() - start.as_ticks();
            prop_assert!(length.abs_diff(nominal) <= nominal / 10_000, "{} ps", length);
        }
    }

    #[test]
    fn stepping_by_next_event_changes_nothing(
        requests in prop::collection::vec((0..3_usize, 0..3_000_u64, 0..0x7FF_u16), 1..12),
        seed in any::<u64>(),
    ) {
        let build = || {
            let mut bus = Bus::new();
            let nodes: Vec<NodeId> = (0..3).map(|_| bus.add_tester(Tester::new())).collect();
            bus.disturb(can_bus::Disturbance::ErrorRate {
                per_bit: 0.002,
                seed,
                seen_by: can_bus::SeenBy::Node(nodes[1]),
                from: at_us(0),
                until: at_us(10_000),
            });
            for (node, at, id) in &requests {
                bus.send_at(nodes[*node], at_us(100 + at), frame(*id, &[0x55]), Retry::UntilSent);
            }
            bus
        };
        let end = at_us(10_000);
        let mut whole = build();
        whole.advance_to(end);
        let mut stepped = build();
        let mut steps = 0;
        while let Some(next) = stepped.next_event().filter(|next| *next <= end) {
            prop_assert!(next >= stepped.now());
            stepped.advance_to(next);
            steps += 1;
            prop_assert!(steps < 1_000_000);
        }
        stepped.advance_to(end);
        let records = whole.drain_records();
        prop_assert!(records.is_sorted_by_key(|record| record.at), "in order of time");
        prop_assert_eq!(records, stepped.drain_records());
    }

    /// The guarantee of the horizon: whatever the other nodes request from now on, a node's
    /// registers do not change before its horizon.
    #[test]
    fn nothing_shows_before_the_horizon(
        requests in prop::collection::vec((0..3_usize, 0..1_500_u64, 0..0x40_u16, any::<u8>()), 1..10),
        options in prop::sample::select(vec![0, NART]),
        trouble in 0..6_u32,
        seed in any::<u64>(),
    ) {
        let mut bus = Bus::new();
        let nodes: Vec<NodeId> = (0..3)
            .map(|index| {
                // In one case the last node's clock is far off.
                let ppb = if trouble == 4 && index == 2 { 40_000_000 } else { 20_000 * index };
                bus.add_bxcan(Part::F446, f446().with_offset_ppb(ppb))
            })
            .collect();
        for node in &nodes {
            configure(&mut bus, *node, options, BTR_250K_F446);
            bus.write(*node, IER, 0x8F7F, bus.now());
        }
        let origin = bus.now();
        let noise = |seen_by| can_bus::Disturbance::ErrorRate {
            per_bit: 0.01,
            seed,
            seen_by,
            from: origin,
            until: origin + common::bits(500),
        };
        match trouble {
            1 => bus.disturb(noise(can_bus::SeenBy::All)),
            2 => bus.disturb(noise(can_bus::SeenBy::Node(nodes[1]))),
            3 => bus.disturb(can_bus::Disturbance::Stuck {
                level: can_bus::Level::from_bit(seed % 2 == 0),
                from: origin + common::bits(seed % 300),
                until: origin + common::bits(seed % 300 + 20),
            }),
            5 => bus.disturb(can_bus::Disturbance::Suppress {
                id: None,
                bit: 13 + (seed % 40) as u16,
                spared: (seed % 3 == 0).then_some(nodes[1]),
                from: origin + common::bits(seed % 300),
                until: origin + common::bits(seed % 300 + 400),
            }),
            _ => {}
        }
        let mut requests = requests;
        requests.sort_by_key(|(_, at, ..)| *at);
        let shown = |bus: &Bus| -> Vec<_> {
            nodes
                .iter()
                .map(|node| (bus.irq(*node), bus.read(*node, TSR), bus.read(*node, RF0R), bus.read(*node, ESR)))
                .collect()
        };
        // Ask for a new horizon when the last one has been reached or the node has written.
        let mut promised: Vec<SimTime> = nodes.iter().map(|node| bus.horizon_of(*node)).collect();
        let last = requests.len() - 1;
        for (serial, (node, at, id, byte)) in requests.iter().enumerate() {
            let at = origin + can_bus::SimDuration::from_ticks(at * 1_000_000);
            let until = if serial == last { at + common::bits(400) } else { at };
            let mailbox = serial as u32 % 3;
            let mut requested = false;
            while bus.now() < until {
                if bus.now() >= at && !requested {
                    requested = true;
                    request(&mut bus, nodes[*node], mailbox, &frame(*id, &[*byte]), at);
                    promised[*node] = bus.horizon_of(nodes[*node]);
                }
                let before = shown(&bus);
                let step = bus.now() + can_bus::SimDuration::from_ticks(BIT / 3);
                let to = if bus.now() < at { step.min(at) } else { step.min(until) };
                bus.advance_to(to);
                let after = shown(&bus);
                for (index, promise) in promised.iter_mut().enumerate() {
                    if before[index] != after[index] {
                        prop_assert!(*promise <= to, "node {} at {:?} promise {:?}: {:?} {:?}", index, to, promise, before[index], after[index]);
                    }
                    if *promise <= to {
                        *promise = bus.horizon_of(nodes[index]);
                    }
                }
            }
            if !requested {
                request(&mut bus, nodes[*node], mailbox, &frame(*id, &[*byte]), at);
                promised[*node] = bus.horizon_of(nodes[*node]);
            }
        }
    }
}

#[test]
fn a_request_waits_for_the_next_bit_boundary_of_its_own_grid() {
    let mut bus = Bus::new();
    let tester = bus.add_tester(Tester::new());
    bus.add_tester(Tester::new());
    bus.advance_to(at_us(100));
    // The tester's grid began at time 0.
    for (asked, start) in [(1_001, 1_004), (2_000, 2_000), (3_003, 3_004)] {
        bus.send_at(tester, at_us(asked), frame(1, &[]), Retry::UntilSent);
        bus.advance_to(at_us(asked + 500));
        let records = bus.drain_records();
        let (_, _, began, bits) = ends(&records)[0];
        if asked == 1_001 {
            assert_eq!(began, at_us(start));
        } else {
            // The end of the previous frame has restarted the grid, on the same boundaries.
            assert_eq!(began.as_ticks() % BIT, 0);
            assert!(began >= at_us(asked) && began < at_us(asked) + common::bits(1));
        }
        assert!(bits > 40);
    }
}

#[test]
fn a_pending_frame_joins_the_start_of_another() {
    let mut bus = Bus::new();
    let first = bus.add_tester(Tester::new());
    bus.advance_to(at_us(100));
    bus.advance_to(ps(101_000_000));
    // The second tester's grid is one microsecond later than the first one's.
    let second = bus.add_tester(Tester::new());
    bus.advance_to(at_us(200));
    // The first tester starts at 400 us. The second one has a request by then too, but could start
    // only at 401 us.
    bus.send_at(first, ps(398_000_000), frame(0x200, &[]), Retry::UntilSent);
    bus.send_at(second, ps(399_000_000), frame(0x100, &[]), Retry::UntilSent);
    bus.advance_to(at_us(1_500));
    let records = bus.drain_records();
    let starts: Vec<(NodeId, SimTime)> = records
        .iter()
        .filter(|record| matches!(record.kind, RecordKind::FrameStart { .. }))
        .map(|record| (record.node, record.at))
        .collect();
    assert_eq!(starts[..2], [(first, at_us(400)), (second, at_us(400))]);
    let sent: Vec<NodeId> = ends(&records).iter().map(|(node, ..)| *node).collect();
    assert_eq!(sent, [second, first]);
}

#[test]
fn frames_follow_each_other_after_three_bits() {
    let mut bus = Bus::new();
    let tester = bus.add_tester(Tester::new());
    bus.add_tester(Tester::new());
    bus.advance_to(at_us(100));
    for byte in 0..3 {
        bus.send_at(tester, at_us(100), same_id(1, byte), Retry::UntilSent);
    }
    bus.advance_to(at_us(2_000));
    let records = bus.drain_records();
    let sent = ends(&records);
    assert_eq!(sent.len(), 3);
    for pair in sent.windows(2) {
        let (_, _, start, bits) = pair[0];
        assert_eq!(pair[1].2, start + common::bits(u64::from(bits) + 3));
    }
}

#[test]
fn the_senders_crystal_sets_the_length() {
    for ppb in [-100_000, 0, 100_000] {
        let mut bus = Bus::new();
        let node = bus.add_bxcan(Part::F303, ClockRate::new(36_000_000).with_offset_ppb(ppb));
        configure(&mut bus, node, 0, BTR_250K_F303);
        let receiver = normal_node(&mut bus, 0);
        let sent = frame(0x2AA, &[0x55; 8]);
        let now = bus.now();
        request(&mut bus, node, 0, &sent, now);
        bus.advance_to(now + bits(200));
        assert_eq!(bus.read(receiver, RF0R), 1);
        let records = bus.drain_records();
        let (_, _, start, bits) = ends(&records)[0];
        let end = records.last().expect("its end").at;
        let length = end.as_ticks() - start.as_ticks();
        let exact = f64::from(bits) * 4e6 / (1.0 + f64::from(ppb) * 1e-9);
        assert!(
            (length as f64 - exact).abs() < f64::from(bits),
            "{length} ps"
        );
    }
}

#[test]
fn receivers_follow_a_crystal_half_a_percent_off() {
    // Over a whole frame this is more than half a bit: only resynchronisation keeps the nodes in
    // step.
    for ppb in [-5_000_000, 5_000_000] {
        let mut bus = Bus::new();
        let node = bus.add_bxcan(Part::F446, f446().with_offset_ppb(ppb));
        configure(&mut bus, node, NART, BTR_250K_F446);
        let receiver = normal_node(&mut bus, NART);
        let now = bus.now();
        request(&mut bus, node, 0, &frame(0x2AA, &[0x55; 8]), now);
        bus.advance_to(now + bits(200));
        request(&mut bus, receiver, 0, &frame(0x2AA, &[0x55; 8]), now);
        bus.advance_to(now + bits(400));
        assert_eq!((bus.read(receiver, RF0R), bus.read(node, RF0R)), (1, 1));
        assert_eq!((bus.read(receiver, ESR), bus.read(node, ESR)), (0, 0));
    }
}

#[test]
fn a_wrong_bit_rate_disturbs_the_bus_until_its_node_gives_up() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, 0);
    let receiver = normal_node(&mut bus, 0);
    let wrong = bus.add_bxcan(Part::F446, f446());
    // 500 kbit/s on a bus of 250 kbit/s.
    configure(&mut bus, wrong, 0, 3 << 20 | 9 << 16 | 5);
    let now = bus.now();
    request(&mut bus, sender, 0, &frame(0x123, &[0x55; 8]), now);
    bus.advance_to(now + bits(100));
    assert_eq!(bus.read(receiver, RF0R), 0);
    assert!(rec(&bus, wrong) > 0);
    bus.advance_to(now + bits(20_000));
    assert_eq!(
        bus.read(receiver, RF0R),
        1,
        "an error-passive node disturbs no more"
    );
    assert_eq!(bus.read(wrong, ESR) & 2, 2);
}

#[test]
fn a_cut_off_node_hears_nobody_and_comes_back() {
    let mut bus = Bus::new();
    let node = normal_node(&mut bus, NART);
    let other = normal_node(&mut bus, NART);
    let third = normal_node(&mut bus, NART);
    let now = bus.now();
    bus.set_connected(other, false, now);
    request(&mut bus, node, 0, &frame(0x123, &[]), now);
    request(&mut bus, other, 0, &frame(0x123, &[9]), now);
    bus.advance_to(now + bits(100));
    assert_eq!(bus.read(node, TSR) & 0xF, 0b0011, "sent to the third");
    assert_eq!(bus.read(other, TSR) & 0xF, 0b1001, "no acknowledge");
    assert_eq!((bus.read(third, RF0R), bus.read(other, RF0R)), (1, 0));
    let now = bus.now();
    bus.set_connected(other, true, now);
    request(&mut bus, other, 0, &frame(0x123, &[9]), now);
    bus.advance_to(now + bits(100));
    assert_eq!(bus.read(other, TSR) & 0xF, 0b0011);
    assert_eq!(bus.read(third, RF0R), 2);
}

#[test]
fn testers_of_one_bit_rate_hear_each_other_in_its_time() {
    for (rate, bit) in [
        (125_000, 8_000_000),
        (250_000, 4_000_000),
        (500_000, 2_000_000),
    ] {
        let mut bus = Bus::new();
        let sender = bus.add_tester(Tester::new().at_bit_rate(rate));
        bus.add_tester(Tester::new().at_bit_rate(rate));
        let frame = Frame::standard(0x123, &[1, 2, 3]).unwrap();
        bus.send_at(
            sender,
            SimTime::from_ticks(1_000_000_000),
            frame,
            Retry::UntilSent,
        );
        bus.advance_to(SimTime::from_ticks(5_000_000_000));
        let records = bus.drain_records();
        let [(node, sent, start, bits)] = ends(&records)[..] else {
            panic!("{records:?}");
        };
        assert_eq!((node, sent), (sender, frame));
        let end = records
            .iter()
            .find(|record| matches!(record.kind, RecordKind::FrameEnd { .. }));
        let lasted = end.unwrap().at.as_ticks() - start.as_ticks();
        // The record is made at the sample point of the last bit but one.
        let expected = u64::from(bits) * bit;
        assert!(lasted.abs_diff(expected) <= 2 * bit, "{lasted} {expected}");
    }
}
