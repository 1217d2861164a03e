//! Register-level tests of the bxCAN model: one for each behaviour that RM0390 describes.

mod common;

use can_bus::wire::WireFrame;
use can_bus::{Bus, Frame, NodeId, Part, RecordKind, Retry, Tester};
use common::*;
use proptest::prelude::*;

const RQCP0: u32 = 1;
const TXOK0: u32 = 1 << 1;
const ALST0: u32 = 1 << 2;
const TERR0: u32 = 1 << 3;
const ABRQ0: u32 = 1 << 7;

#[test]
fn registers_have_their_reset_values() {
    let mut bus = Bus::new();
    for part in [Part::F303, Part::F446] {
        let node = bus.add_bxcan(part, f446());
        for (offset, value) in [
            (MCR, 0x0001_0002),
            (MSR, 0x0000_0C02),
            (TSR, 0x1C00_0000),
            (RF0R, 0),
            (RF1R, 0),
            (IER, 0),
            (ESR, 0),
            (BTR, 0x0123_0000),
            (FMR, 0x2A1C_0E01),
            (FM1R, 0),
            (FS1R, 0),
            (FFA1R, 0),
            (FA1R, 0),
        ] {
            assert_eq!(bus.read(node, offset), value, "offset {offset:#x}");
        }
    }
}

#[test]
fn a_frame_goes_from_mailbox_to_fifo() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, NART);
    let receiver = normal_node(&mut bus, NART);
    let sent = frame(0x123, &[1, 2, 3, 4, 5, 6, 7, 8]);
    let start = bus.now();
    request(&mut bus, sender, 0, &sent, start);
    assert_eq!(bus.read(sender, TSR) >> 26 & 7, 0b110, "mailbox 0 is taken");
    bus.advance_to(start + bits(150));

    assert_eq!(bus.read(sender, TSR), 0x1C00_0003, "RQCP, TXOK, all empty");
    assert_eq!(bus.read(receiver, RF0R), 1);
    let (rir, rdtr, data) = take(&mut bus, receiver).expect("a message");
    assert_eq!(rir, 0x123 << 21);
    assert_eq!(rdtr, 8, "DLC 8, filter 0, no stamp");
    assert_eq!(data, [0x0403_0201, 0x0807_0605]);
    assert_eq!(bus.read(receiver, RF0R), 0);
    assert_eq!(
        bus.read(sender, RF0R),
        0,
        "a sender does not receive itself"
    );
}

#[test]
fn remote_and_extended_frames_keep_their_identifier_bits() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, NART);
    let receiver = normal_node(&mut bus, NART);
    let extended = Frame::extended(0x1234_5678 & 0x1FFF_FFFF, &[9]).expect("valid");
    let remote = Frame::new_remote(extended.id(), 5).expect("valid");
    let now = bus.now();
    request(&mut bus, sender, 0, &extended, now);
    request(&mut bus, sender, 1, &remote, now);
    bus.advance_to(now + bits(400));
    let (rir, rdtr, data) = take(&mut bus, receiver).expect("data frame first");
    assert_eq!(
        (rir, rdtr & 0xF, data[0]),
        ((0x1234_5678 & 0x1FFF_FFFF) << 3 | 0b100, 1, 9)
    );
    let (rir, rdtr, _) = take(&mut bus, receiver).expect("remote frame second");
    assert_eq!(
        (rir, rdtr & 0xF),
        ((0x1234_5678 & 0x1FFF_FFFF) << 3 | 0b110, 5)
    );
}

#[test]
fn sleep_to_initialisation_is_acknowledged_at_once() {
    let mut bus = Bus::new();
    let node = bus.add_bxcan(Part::F446, f446());
    // The order of HAL_CAN_Init in STM32CubeF4: INRQ, wait for INAK, clear SLEEP.
    bus.write(node, MCR, INRQ | SLEEP, at_us(1));
    assert_eq!(bus.read(node, MSR) & 3, 1, "INRQ alone decides");
    bus.write(node, MCR, INRQ, at_us(2));
    assert_eq!(bus.read(node, MSR) & 3, 1);
    bus.write(node, MCR, SLEEP, at_us(3));
    assert_eq!(bus.read(node, MSR) & 3, 2);
}

#[test]
fn leaving_initialisation_takes_eleven_recessive_bits() {
    let mut bus = Bus::new();
    let node = bus.add_bxcan(Part::F446, f446());
    bus.write(node, MCR, INRQ, at_us(0));
    bus.write(node, BTR, BTR_250K_F446, at_us(0));
    bus.write(node, MCR, 0, at_us(10));
    // The eleventh sample point: 10 bits and 11 of 15 quanta.
    let ready = 10_000_000 + 10 * BIT + BIT * 11 / 15;
    bus.advance_to(ps(ready - 10));
    assert_eq!(bus.read(node, MSR) & 3, 1);
    bus.advance_to(ps(ready + 10));
    assert_eq!(bus.read(node, MSR) & 3, 0);
}

#[test]
fn traffic_delays_the_end_of_initialisation_to_the_end_of_intermission() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, 0);
    let _listener = normal_node(&mut bus, 0);
    let late = bus.add_bxcan(Part::F446, f446());
    let start = bus.now();
    bus.write(late, MCR, INRQ, start);
    bus.write(late, BTR, BTR_250K_F446, start);
    let sent = frame(0x123, &[0xA5; 8]);
    request(&mut bus, sender, 0, &sent, start);
    bus.write(late, MCR, 0, start + bits(20));
    // The ACK delimiter, the end of frame and the intermission are the eleven bits.
    let end = start + bits(WireFrame::encode(&sent).bits() as u64 + 3);
    bus.advance_to(end - bits(1));
    assert_eq!(bus.read(late, MSR) & 3, 1);
    bus.advance_to(end + bits(1));
    assert_eq!(bus.read(late, MSR) & 3, 0);
    assert_eq!(bus.read(late, RF0R), 0, "nothing of the frame was received");
    assert_eq!(rec(&bus, late), 0);
}

#[test]
fn initialisation_waits_for_the_frame_in_progress() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, 0);
    let receiver = normal_node(&mut bus, 0);
    let start = bus.now();
    let sent = frame(0x123, &[0xA5; 8]);
    request(&mut bus, sender, 0, &sent, start);
    bus.advance_to(start + bits(30));
    bus.write(receiver, MCR, INRQ, start + bits(30));
    let length = WireFrame::encode(&sent).bits() as u64;
    bus.advance_to(start + bits(length - 1));
    assert_eq!(bus.read(receiver, MSR) & 1, 0);
    bus.advance_to(start + bits(length));
    assert_eq!(bus.read(receiver, MSR) & 1, 1);
    assert_eq!(bus.read(receiver, RF0R), 1, "the frame was received");
}

#[test]
fn bit_timing_is_locked_outside_initialisation() {
    let mut bus = Bus::new();
    let node = bus.add_bxcan(Part::F446, f446());
    bus.write(node, BTR, BTR_250K_F446, at_us(0));
    assert_eq!(bus.read(node, BTR), 0x0123_0000);
    bus.write(node, MCR, INRQ, at_us(0));
    bus.write(node, BTR, u32::MAX, at_us(0));
    assert_eq!(bus.read(node, BTR), 0xC37F_03FF, "reserved bits stay clear");
    bus.write(node, MCR, 0, at_us(0));
    bus.advance_to(at_us(1));
    bus.write(node, BTR, BTR_250K_F446, at_us(1));
    assert_eq!(bus.read(node, BTR), 0xC37F_03FF);
}

#[test]
fn a_pending_mailbox_is_write_protected() {
    let mut bus = Bus::new();
    let node = normal_node(&mut bus, 0);
    let now = bus.now();
    request(&mut bus, node, 1, &frame(0x100, &[1, 2]), now);
    let base = TI0R + 0x10;
    let before: Vec<u32> = (0..4).map(|word| bus.read(node, base + 4 * word)).collect();
    for word in 0..4 {
        bus.write(node, base + 4 * word, 0xFFFF_FFFF, now);
    }
    let after: Vec<u32> = (0..4).map(|word| bus.read(node, base + 4 * word)).collect();
    assert_eq!(before, after);
}

/// Identifiers in the order in which they were sent.
fn sent_ids(bus: &mut Bus) -> Vec<u16> {
    bus.drain_records()
        .into_iter()
        .filter_map(|record| match record.kind {
            RecordKind::FrameEnd { frame, .. } => match frame.id() {
                embedded_can::Id::Standard(id) => Some(id.as_raw()),
                embedded_can::Id::Extended(_) => None,
            },
            _ => None,
        })
        .collect()
}

fn send_three(options: u32) -> Vec<u16> {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, options);
    normal_node(&mut bus, 0);
    let now = bus.now();
    for (mailbox, id) in [(1, 0x300), (2, 0x100), (0, 0x200)] {
        request(&mut bus, sender, mailbox, &frame(id, &[]), now);
    }
    bus.advance_to(now + bits(600));
    sent_ids(&mut bus)
}

#[test]
fn mailboxes_go_by_identifier_or_by_order_of_request() {
    assert_eq!(send_three(0), [0x100, 0x200, 0x300]);
    assert_eq!(send_three(TXFP), [0x300, 0x100, 0x200]);
}

#[test]
fn equal_identifiers_go_by_mailbox_number() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, 0);
    let receiver = normal_node(&mut bus, 0);
    let now = bus.now();
    for mailbox in [2, 0, 1] {
        request(
            &mut bus,
            sender,
            mailbox,
            &same_id(0x77, mailbox as u8),
            now,
        );
    }
    bus.advance_to(now + bits(600));
    let order: Vec<u32> = std::iter::from_fn(|| take(&mut bus, receiver))
        .map(|(_, _, data)| data[0])
        .collect();
    assert_eq!(order, [0, 1, 2]);
}

#[test]
fn transmit_status_names_the_free_and_the_least_urgent_mailbox() {
    let mut bus = Bus::new();
    let node = normal_node(&mut bus, 0);
    let now = bus.now();
    assert_eq!(bus.read(node, TSR) >> 24, 0b0001_1100);
    request(&mut bus, node, 0, &frame(0x300, &[]), now);
    assert_eq!(bus.read(node, TSR) >> 24, 0b0001_1001, "no LOW with one");
    request(&mut bus, node, 1, &frame(0x100, &[]), now);
    assert_eq!(bus.read(node, TSR) >> 24, 0b0011_0010, "LOW0, next free 2");
    request(&mut bus, node, 2, &frame(0x400, &[]), now);
    assert_eq!(bus.read(node, TSR) >> 24, 0b1000_0010, "LOW2, code 2");
}

fn lose_arbitration(options: u32) -> (u32, Vec<u16>) {
    let mut bus = Bus::new();
    let winner = normal_node(&mut bus, NART);
    let loser = normal_node(&mut bus, options);
    let now = bus.now();
    request(&mut bus, winner, 0, &frame(0x100, &[1]), now);
    request(&mut bus, loser, 0, &frame(0x101, &[2]), now);
    bus.advance_to(now + bits(250));
    (bus.read(loser, TSR), sent_ids(&mut bus))
}

#[test]
fn lost_arbitration_ends_a_single_shot() {
    let (tsr, ids) = lose_arbitration(NART);
    assert_eq!(tsr & 0xFF, RQCP0 | ALST0);
    assert_eq!(ids, [0x100]);
}

#[test]
fn lost_arbitration_is_retried_otherwise() {
    let (tsr, ids) = lose_arbitration(0);
    assert_eq!(tsr & 0xFF, RQCP0 | TXOK0);
    assert_eq!(ids, [0x100, 0x101]);
}

#[test]
fn lost_arbitration_shows_at_the_bit_that_lost_it() {
    let mut bus = Bus::new();
    let winner = normal_node(&mut bus, NART);
    let loser = normal_node(&mut bus, NART);
    bus.write(loser, IER, 1, bus.now());
    let now = bus.now();
    // The bits so far are 0 0001 111, then 0 or 1. There is no stuff bit before the eighth bit of
    // the identifier, whose index is 8.
    request(&mut bus, winner, 0, &frame(0x0F0, &[]), now);
    request(&mut bus, loser, 0, &frame(0x0F8, &[]), now);
    bus.advance_to(now + bits(12));
    let records = bus.drain_records();
    let begin = records[0].at;
    let lost = records
        .iter()
        .find_map(|record| match record.kind {
            RecordKind::ArbitrationLost { bit, .. } => Some((record.at, bit)),
            _ => None,
        })
        .expect("one loses");
    assert_eq!(lost.1, 8);
    let since = lost.0.as_ticks() - begin.as_ticks();
    assert!(
        (8 * BIT..9 * BIT).contains(&since),
        "flagged {since} ps after start of frame"
    );
    assert!(bus.irq(loser).tx);
}

#[test]
fn a_waiting_mailbox_is_aborted_at_once() {
    let mut bus = Bus::new();
    let blocker = normal_node(&mut bus, 0);
    let node = normal_node(&mut bus, 0);
    let now = bus.now();
    request(&mut bus, blocker, 0, &frame(0x100, &[1; 8]), now);
    bus.advance_to(now + bits(20));
    let later = now + bits(30);
    request(&mut bus, node, 0, &frame(0x200, &[]), later);
    bus.write(node, TSR, ABRQ0, later + bits(1));
    assert_eq!(
        bus.read(node, TSR),
        0x1C00_0000 | RQCP0,
        "empty, not sent, no abort pending"
    );
    bus.advance_to(now + bits(400));
    assert_eq!(sent_ids(&mut bus), [0x100]);
}

#[test]
fn an_abort_in_the_midst_of_the_frame_lets_it_end() {
    let mut bus = Bus::new();
    let node = normal_node(&mut bus, 0);
    normal_node(&mut bus, 0);
    let now = bus.now();
    request(&mut bus, node, 0, &frame(0x200, &[]), now);
    bus.advance_to(now + bits(20));
    bus.write(node, TSR, ABRQ0, now + bits(20));
    assert_eq!(bus.read(node, TSR) & 0xFF, ABRQ0);
    bus.advance_to(now + bits(100));
    assert_eq!(bus.read(node, TSR), 0x1C00_0000 | RQCP0 | TXOK0);
}

#[test]
fn an_abort_written_ahead_of_the_bus_meets_the_frame_on_the_wire() {
    let mut bus = Bus::new();
    let node = normal_node(&mut bus, 0);
    normal_node(&mut bus, 0);
    let now = bus.now();
    request(&mut bus, node, 0, &frame(0x200, &[]), now);
    // The bus is at `now`; ten bits later the frame is being sent.
    bus.write(node, TSR, ABRQ0, now + bits(10));
    assert_eq!(bus.read(node, TSR) & 0xFF, ABRQ0);
    bus.advance_to(now + bits(100));
    assert_eq!(bus.read(node, TSR), 0x1C00_0000 | RQCP0 | TXOK0);
    assert_eq!(sent_ids(&mut bus), [0x200]);
}

#[test]
fn an_abort_stops_retries() {
    let mut bus = Bus::new();
    let winner = normal_node(&mut bus, 0);
    let loser = normal_node(&mut bus, 0);
    let now = bus.now();
    request(&mut bus, winner, 0, &frame(0x100, &[1]), now);
    request(&mut bus, loser, 0, &frame(0x101, &[2]), now);
    bus.advance_to(now + bits(3));
    bus.write(loser, TSR, ABRQ0, now + bits(3));
    bus.advance_to(now + bits(300));
    assert_eq!(bus.read(loser, TSR), 0x1C00_0000 | RQCP0 | ALST0);
    assert_eq!(sent_ids(&mut bus), [0x100]);
}

#[test]
fn status_bits_are_cleared_by_ones_and_by_the_next_request() {
    let mut bus = Bus::new();
    let node = normal_node(&mut bus, 0);
    normal_node(&mut bus, 0);
    let now = bus.now();
    for mailbox in 0..2 {
        request(&mut bus, node, mailbox, &frame(0x200, &[]), now);
    }
    bus.advance_to(now + bits(200));
    let now = bus.now();
    assert_eq!(bus.read(node, TSR), 0x1C00_0303);
    bus.write(node, TSR, 1, now);
    assert_eq!(bus.read(node, TSR), 0x1C00_0300);
    request(&mut bus, node, 1, &frame(0x200, &[]), now);
    assert_eq!(bus.read(node, TSR) & 0xFFFF, 0);
}

/// First data bytes in the FIFO after five frames 0..5, and its status before they were taken.
fn overrun(options: u32) -> (Vec<u32>, u32) {
    let mut bus = Bus::new();
    let tester = bus.add_tester(Tester::new());
    let node = normal_node(&mut bus, options);
    let now = bus.now();
    for byte in 0..5 {
        bus.send_at(tester, now, same_id(0x10, byte), Retry::UntilSent);
    }
    bus.advance_to(now + bits(600));
    let status = bus.read(node, RF0R);
    let taken = std::iter::from_fn(|| take(&mut bus, node))
        .map(|(_, _, data)| data[0])
        .collect();
    (taken, status)
}

#[test]
fn a_full_fifo_overwrites_its_newest_message_or_drops_the_next() {
    assert_eq!(overrun(0), (vec![0, 1, 4], 0b1_1011));
    assert_eq!(overrun(RFLM), (vec![0, 1, 2], 0b1_1011));
}

#[test]
fn fifo_flags_are_cleared_by_ones() {
    let mut bus = Bus::new();
    let tester = bus.add_tester(Tester::new());
    let node = normal_node(&mut bus, 0);
    let now = bus.now();
    for byte in 0..4 {
        bus.send_at(tester, now, same_id(0x10, byte), Retry::UntilSent);
    }
    bus.advance_to(now + bits(600));
    let now = bus.now();
    bus.write(node, RF0R, 1 << 4, now);
    assert_eq!(bus.read(node, RF0R), 0b0_1011);
    bus.write(node, RF0R, 1 << 3, now);
    assert_eq!(bus.read(node, RF0R), 0b0_0011);
    bus.write(node, RF1R, 1 << 5, now);
    assert_eq!(
        bus.read(node, RF1R),
        0,
        "releasing an empty FIFO does nothing"
    );
}

#[test]
fn interrupt_lines_follow_flags_and_enables() {
    let mut bus = Bus::new();
    let node = normal_node(&mut bus, 0);
    let other = normal_node(&mut bus, 0);
    let now = bus.now();
    request(&mut bus, node, 0, &frame(0x200, &[]), now);
    bus.advance_to(now + bits(100));
    for byte in 0..4 {
        let now = bus.now();
        request(&mut bus, other, 0, &same_id(0x10, byte), now);
        bus.advance_to(bus.now() + bits(100));
    }
    // FIFO 0 of `node` is full and overrun, its mailbox 0 complete.
    let now = bus.now();
    assert_eq!(bus.irq(node), can_bus::IrqLines::default());
    for (enable, tx, rx0) in [
        (1, true, false),
        (1 << 1, false, true),
        (1 << 2, false, true),
        (1 << 3, false, true),
        (0b111_0000, false, false),
    ] {
        bus.write(node, IER, enable, now);
        let irq = bus.irq(node);
        assert_eq!(
            (irq.tx, irq.rx0, irq.rx1),
            (tx, rx0, false),
            "IER {enable:#x}"
        );
    }
    bus.write(node, IER, 0b1111, now);
    bus.write(node, TSR, RQCP0, now);
    assert!(!bus.irq(node).tx);
    bus.write(node, RF0R, 0b1_1000, now);
    assert!(bus.irq(node).rx0, "messages still pending");
    while take(&mut bus, node).is_some() {}
    assert!(!bus.irq(node).rx0);
}

#[test]
fn interrupts_come_at_their_bits_of_end_of_frame() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, 0);
    let receiver = normal_node(&mut bus, 0);
    bus.write(sender, IER, 1, bus.now());
    bus.write(receiver, IER, 2, bus.now());
    bus.advance_to(bus.now() + bits(1));
    let sent = frame(0x123, &[0x55, 0, 0, 0, 0xFF]);
    let now = bus.now();
    request(&mut bus, sender, 0, &sent, now);
    let (mut received_at, mut transmitted_at) = (None, None);
    while transmitted_at.is_none() {
        let next = bus.next_event().expect("the frame goes on");
        bus.advance_to(next);
        if bus.irq(receiver).rx0 {
            received_at.get_or_insert(next);
        }
        if bus.irq(sender).tx {
            transmitted_at = Some(next);
        }
    }
    let start = bus
        .drain_records()
        .into_iter()
        .find(|record| matches!(record.kind, RecordKind::FrameStart { .. }))
        .expect("a start")
        .at;
    let length = WireFrame::encode(&sent).bits() as u64;
    let sample = BIT * 11 / 15;
    let since = |at: Option<can_bus::SimTime>| at.expect("seen").as_ticks() - start.as_ticks();
    assert_eq!(since(transmitted_at), (length - 1) * BIT + sample);
    // The receiver samples up to a quantum earlier, depending on the phase of its own clock.
    let early = (length - 2) * BIT + sample - since(received_at);
    assert!(early < BIT / 15, "{early} ps");
}

// Filters.

/// Receives frames with the given filter registers; returns FIFO and filter match index of each.
fn filtered(
    setup: impl Fn(&mut Bus, can_bus::NodeId),
    frames: &[Frame],
) -> Vec<Option<(usize, u32)>> {
    let mut bus = Bus::new();
    let tester = bus.add_tester(Tester::new());
    let node = bus.add_bxcan(Part::F446, f446());
    bus.write(node, MCR, INRQ, at_us(0));
    bus.write(node, BTR, BTR_250K_F446, at_us(0));
    bus.write(node, FMR, 1 | 28 << 8, at_us(0));
    setup(&mut bus, node);
    bus.write(node, FMR, 28 << 8, at_us(0));
    bus.write(node, MCR, 0, at_us(0));
    bus.advance_to(at_us(200));
    frames
        .iter()
        .map(|frame| {
            let now = bus.now();
            bus.send_at(tester, now, *frame, Retry::UntilSent);
            bus.advance_to(now + bits(200));
            [RF0R, RF1R].iter().enumerate().find_map(|(fifo, status)| {
                (bus.read(node, *status) & 3 == 1).then(|| {
                    let index = bus.read(node, RI0R + 0x10 * fifo as u32 + 4) >> 8 & 0xFF;
                    bus.write(node, *status, 1 << 5, now + bits(200));
                    (fifo, index)
                })
            })
        })
        .collect()
}

#[test]
fn without_an_active_filter_nothing_is_stored() {
    assert_eq!(filtered(|_, _| {}, &[frame(0x123, &[])]), [None]);
}

#[test]
fn a_wide_mask_compares_the_bits_it_names() {
    let found = filtered(
        |bus, node| {
            bus.write(node, FS1R, 1, at_us(0));
            bus.write(node, F0R1, 0x120 << 21, at_us(0));
            // Identifier but for its lowest four bits, IDE and RTR.
            bus.write(node, F0R1 + 4, 0x7F0 << 21 | 0b110, at_us(0));
            bus.write(node, FA1R, 1, at_us(0));
        },
        &[
            frame(0x12F, &[]),
            frame(0x130, &[]),
            Frame::new_remote(frame(0x12F, &[]).id(), 0).expect("valid"),
            Frame::extended(0x120 << 18, &[]).expect("valid"),
        ],
    );
    assert_eq!(found, [Some((0, 0)), None, None, None]);
}

#[test]
fn a_wide_list_holds_two_identifiers() {
    let found = filtered(
        |bus, node| {
            bus.write(node, FS1R, 1, at_us(0));
            bus.write(node, FM1R, 1, at_us(0));
            bus.write(node, F0R1, 0x123 << 21, at_us(0));
            bus.write(node, F0R1 + 4, 0x0ABC_DEF1 << 3 | 0b100, at_us(0));
            bus.write(node, FFA1R, 1, at_us(0));
            bus.write(node, FA1R, 1, at_us(0));
        },
        &[
            frame(0x123, &[]),
            Frame::extended(0x0ABC_DEF1, &[]).expect("valid"),
            frame(0x124, &[]),
        ],
    );
    assert_eq!(found, [Some((1, 0)), Some((1, 1)), None]);
}

#[test]
fn narrow_filters_hold_two_masks_or_four_identifiers() {
    let narrow = |id: u32| id << 5;
    let found = filtered(
        |bus, node| {
            bus.write(node, FM1R, 0b10, at_us(0));
            // Bank 0: two masks. Low half identifier, high half mask.
            bus.write(node, F0R1, narrow(0x100) | narrow(0x700) << 16, at_us(0));
            bus.write(node, F0R1 + 4, narrow(0x555) | 0xFFE0 << 16, at_us(0));
            // Bank 1: a list of four.
            bus.write(
                node,
                F0R1 + 8,
                narrow(0x201) | narrow(0x202) << 16,
                at_us(0),
            );
            bus.write(
                node,
                F0R1 + 12,
                narrow(0x203) | narrow(0x204) << 16,
                at_us(0),
            );
            bus.write(node, FA1R, 0b11, at_us(0));
        },
        &[
            frame(0x1FF, &[]),
            frame(0x555, &[]),
            frame(0x201, &[]),
            frame(0x202, &[]),
            frame(0x203, &[]),
            frame(0x204, &[]),
            frame(0x205, &[]),
        ],
    );
    let numbers: Vec<_> = found.iter().map(|f| f.map(|(_, index)| index)).collect();
    assert_eq!(
        numbers,
        [Some(0), Some(1), Some(2), Some(3), Some(4), Some(5), None]
    );
}

#[test]
fn narrow_filters_see_rtr_ide_and_three_bits_of_the_extension() {
    let bits = 0x123 << 5 | 1 << 4 | 1 << 3 | 0b101;
    let id = |low: u32| 0x123 << 18 | 0b101 << 15 | low;
    let remote = |raw: u32| {
        let id = embedded_can::ExtendedId::new(raw).expect("valid");
        Frame::new_remote(id, 0).expect("valid")
    };
    let found = filtered(
        |bus, node| {
            bus.write(node, FM1R, 1, at_us(0));
            bus.write(node, F0R1, bits, at_us(0));
            bus.write(node, FA1R, 1, at_us(0));
        },
        &[
            remote(id(0)),
            remote(id(0x7FFF)),
            remote(id(0) ^ 1 << 15),
            Frame::extended(id(0), &[]).expect("valid"),
        ],
    );
    assert_eq!(found, [Some((0, 0)), Some((0, 0)), None, None]);
}

#[test]
fn filter_numbers_run_for_each_fifo_and_over_inactive_banks() {
    // Bank 0 (FIFO 0): two narrow masks, inactive. Bank 1 (FIFO 1): wide list. Bank 2 (FIFO 0):
    // wide mask. Bank 3 (FIFO 1): wide mask.
    let found = filtered(
        |bus, node| {
            bus.write(node, FS1R, 0b1110, at_us(0));
            bus.write(node, FM1R, 0b0010, at_us(0));
            bus.write(node, FFA1R, 0b1010, at_us(0));
            bus.write(node, F0R1 + 8, 0x111 << 21, at_us(0));
            bus.write(node, F0R1 + 12, 0x112 << 21, at_us(0));
            bus.write(node, F0R1 + 16, 0x222 << 21, at_us(0));
            bus.write(node, F0R1 + 20, 0x7FF << 21, at_us(0));
            bus.write(node, F0R1 + 24, 0x333 << 21, at_us(0));
            bus.write(node, F0R1 + 28, 0x7FF << 21, at_us(0));
            bus.write(node, FA1R, 0b1110, at_us(0));
        },
        &[frame(0x112, &[]), frame(0x222, &[]), frame(0x333, &[])],
    );
    assert_eq!(found, [Some((1, 1)), Some((0, 2)), Some((1, 2))]);
}

#[test]
fn wide_beats_narrow_and_a_list_beats_a_mask() {
    let narrow = 0x123 << 5;
    let found = filtered(
        |bus, node| {
            bus.write(node, FM1R, 0b1001, at_us(0));
            bus.write(node, FS1R, 0b1100, at_us(0));
            // 0: narrow list, 1: narrow mask, 2: wide mask, 3: wide list; all accept 0x123.
            bus.write(node, F0R1, narrow, at_us(0));
            bus.write(node, F0R1 + 8, narrow | 0xFFE0 << 16, at_us(0));
            bus.write(node, F0R1 + 16, 0, at_us(0));
            bus.write(node, F0R1 + 20, 0, at_us(0));
            bus.write(node, F0R1 + 24, 0x123 << 21, at_us(0));
            bus.write(node, FA1R, 0b1111, at_us(0));
        },
        &[frame(0x123, &[]), frame(0x124, &[])],
    );
    // Numbers: 0..4 bank 0, 4..6 bank 1, 6 bank 2, 7 and 8 bank 3.
    assert_eq!(found, [Some((0, 7)), Some((0, 6))]);
}

#[test]
fn among_equals_the_lower_filter_number_wins() {
    let found = filtered(
        |bus, node| {
            // Two wide masks that accept everything.
            bus.write(node, FS1R, 0b110, at_us(0));
            bus.write(node, FA1R, 0b110, at_us(0));
        },
        &[frame(0x123, &[])],
    );
    assert_eq!(
        found,
        [Some((0, 2))],
        "behind the two narrow ones of bank 0"
    );
}

#[test]
fn filter_registers_are_protected() {
    let mut bus = Bus::new();
    let node = bus.add_bxcan(Part::F303, f303());
    bus.write(node, FA1R, u32::MAX, at_us(0));
    assert_eq!(bus.read(node, FA1R), 0x3FFF, "14 banks");
    bus.write(node, F0R1, 7, at_us(0));
    bus.write(node, FMR, 0, at_us(0));
    assert_eq!(bus.read(node, FMR), 0x2A1C_0E00, "no CAN2SB on this part");
    bus.write(node, F0R1, 8, at_us(0));
    for register in [FM1R, FS1R, FFA1R] {
        bus.write(node, register, 1, at_us(0));
        assert_eq!(bus.read(node, register), 0);
    }
    assert_eq!(bus.read(node, F0R1), 7, "the bank is active");
    bus.write(node, FA1R, 0, at_us(0));
    bus.write(node, F0R1, 8, at_us(0));
    assert_eq!(bus.read(node, F0R1), 8);
}

#[test]
fn a_pair_divides_the_banks() {
    let mut bus = Bus::new();
    let tester = bus.add_tester(Tester::new());
    let (first, second) = bus.add_bxcan_pair(f446());
    bus.write(first, FMR, 1 | 2 << 8, at_us(0));
    bus.write(first, FS1R, 0b11, at_us(0));
    bus.write(first, FS1R, 0b111, at_us(0));
    // Bank 2 is the second controller's first one.
    bus.write(first, F0R1 + 16, 0x123 << 21, at_us(0));
    bus.write(first, F0R1 + 20, 0x7FF << 21, at_us(0));
    bus.write(first, FA1R, 0b101, at_us(0));
    bus.write(first, F0R1, 0x321 << 21, at_us(0));
    bus.write(first, F0R1 + 4, 0x7FF << 21, at_us(0));
    bus.write(first, FMR, 2 << 8, at_us(0));
    assert_eq!(bus.read(second, FA1R), 0, "CAN2 has no filter registers");
    for node in [first, second] {
        bus.write(node, MCR, INRQ, at_us(0));
        bus.write(node, BTR, BTR_250K_F446, at_us(0));
        bus.write(node, MCR, 0, at_us(0));
    }
    bus.advance_to(at_us(100));
    bus.send_at(tester, at_us(100), frame(0x123, &[]), Retry::UntilSent);
    bus.advance_to(at_us(400));
    assert_eq!((bus.read(first, RF0R), bus.read(second, RF0R)), (0, 1));
    assert_eq!(bus.read(second, RI0R + 4) >> 8 & 0xFF, 0);
}

// Modes.

#[test]
fn a_sleeping_controller_notices_a_frame_and_wakes_if_told_to() {
    for automatic in [false, true] {
        let mut bus = Bus::new();
        let tester = bus.add_tester(Tester::new());
        let _other = bus.add_tester(Tester::new());
        let node = normal_node(&mut bus, 0);
        let now = bus.now();
        bus.write(node, IER, 1 << 16 | 1 << 17, now);
        let awum = if automatic { AWUM } else { 0 };
        bus.write(node, MCR, SLEEP | awum, now);
        bus.advance_to(now);
        assert_eq!(bus.read(node, MSR) & 0x13, 0x12, "SLAK and SLAKI");
        assert!(bus.irq(node).sce);
        bus.write(node, MSR, 1 << 4, now);
        assert!(!bus.irq(node).sce);
        bus.send_at(tester, now, frame(0x123, &[]), Retry::UntilSent);
        bus.advance_to(now + bits(10));
        assert_eq!(bus.read(node, MSR) & 0b1000, 0b1000, "WKUI");
        assert!(bus.irq(node).sce);
        assert_eq!(bus.read(node, MCR) & SLEEP != 0, !automatic);
        bus.advance_to(now + bits(100));
        assert_eq!(bus.read(node, MSR) & 2 != 0, !automatic, "SLAK");
        assert_eq!(bus.read(node, RF0R), 0, "the waking frame is lost");
        if !automatic {
            bus.write(node, MCR, 0, bus.now());
            bus.advance_to(bus.now() + bits(12));
            assert_eq!(bus.read(node, MSR) & 2, 0);
        }
    }
}

#[test]
fn no_sleep_interrupt_flag_without_its_enable() {
    let mut bus = Bus::new();
    let node = normal_node(&mut bus, 0);
    let now = bus.now();
    bus.write(node, MCR, SLEEP, now);
    bus.advance_to(now);
    assert_eq!(bus.read(node, MSR) & 0x1F, 0x02);
}

#[test]
fn silent_mode_listens_without_a_trace() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, NART);
    let silent = bus.add_bxcan(Part::F446, f446());
    configure(&mut bus, silent, 0, BTR_250K_F446 | 1 << 31);
    let now = bus.now();
    request(&mut bus, silent, 0, &frame(0x001, &[]), now);
    request(&mut bus, sender, 0, &frame(0x123, &[]), now);
    bus.advance_to(now + bits(100));
    assert_eq!(
        bus.read(sender, TSR) & 0xFF,
        RQCP0 | TERR0,
        "no acknowledge"
    );
    assert_eq!(bus.read(silent, TSR) >> 26 & 7, 0b110, "cannot send");

    let third = normal_node(&mut bus, 0);
    let now = bus.now();
    request(&mut bus, sender, 0, &frame(0x123, &[]), now);
    bus.advance_to(now + bits(100));
    assert_eq!(bus.read(sender, TSR) & 0xFF, RQCP0 | TXOK0);
    assert_eq!((bus.read(third, RF0R), bus.read(silent, RF0R)), (1, 1));
}

#[test]
fn loop_back_receives_its_own_frames_alone() {
    for silent in [0, 1 << 31] {
        let mut bus = Bus::new();
        let other = normal_node(&mut bus, 0);
        let node = bus.add_bxcan(Part::F446, f446());
        configure(&mut bus, node, 0, BTR_250K_F446 | 1 << 30 | silent);
        let now = bus.now();
        request(&mut bus, node, 0, &frame(0x123, &[7]), now);
        bus.advance_to(now + bits(100));
        assert_eq!(bus.read(node, TSR) & 0xFF, RQCP0 | TXOK0);
        let (rir, _, data) = take(&mut bus, node).expect("its own frame");
        assert_eq!((rir, data[0]), (0x123 << 21, 7));
        assert_eq!(bus.read(node, ESR), 0);
        assert_eq!(bus.read(other, RF0R), 0);
        let seen = bus.drain_records();
        assert!(seen.is_empty(), "nobody on the bus sees it: {seen:?}");
    }
}

/// Asks for normal mode with loop back and silence, and returns the node in initialisation.
fn looping_node(bus: &mut Bus) -> NodeId {
    let node = bus.add_bxcan(Part::F446, f446());
    let now = bus.now();
    bus.write(node, MCR, INRQ, now);
    bus.advance_to(now);
    bus.write(node, BTR, BTR_250K_F446 | 3 << 30, now);
    bus.write(node, MCR, 0, now);
    node
}

#[test]
fn loop_back_begins_after_eleven_recessive_bits_at_the_pin() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, 0);
    let _other = normal_node(&mut bus, 0);
    // A frame without data has 44 bits and some of stuff, the last ten of them recessive.
    let now = bus.now();
    request(&mut bus, sender, 0, &frame(0x123, &[]), now);
    bus.advance_to(now + bits(2));
    let node = looping_node(&mut bus);
    bus.advance_to(now + bits(30));
    assert_eq!(bus.read(node, MSR) & 1, 1, "the bus is busy");
    bus.advance_to(now + bits(70));
    assert_eq!(bus.read(node, MSR) & 1, 0);

    let node = looping_node(&mut bus);
    let now = bus.now();
    bus.hold_receive_pin(node, true, now);
    bus.advance_to(now + bits(1000));
    assert_eq!(bus.read(node, MSR) & 1, 1, "the pin is dominant");
    let now = bus.now();
    bus.hold_receive_pin(node, false, now);
    bus.advance_to(now + bits(9));
    assert_eq!(bus.read(node, MSR) & 1, 1, "not yet eleven bits");
    bus.advance_to(now + bits(12));
    assert_eq!(bus.read(node, MSR) & 1, 0);
}

#[test]
fn time_triggered_mode_stamps_start_of_frame() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, TTCM | NART);
    let receiver = normal_node(&mut bus, TTCM | NART);
    let first = bus.now();
    let mut stamps = Vec::new();
    for n in 0..2 {
        let now = first + bits(1000 * n);
        bus.advance_to(now);
        let base = TI0R;
        bus.write(sender, base + 4, 8 | 1 << 8, now);
        bus.write(sender, base + 8, 0x4433_2211, now);
        bus.write(sender, base + 12, 0x8877_6655, now);
        bus.write(sender, base, 0x123 << 21 | 1, now);
        bus.advance_to(now + bits(200));
        let sent = bus.read(sender, base + 4) >> 16;
        let (_, rdtr, data) = take(&mut bus, receiver).expect("a frame");
        assert_eq!(data[1] & 0xFFFF, 0x6655, "bytes 4 and 5 as written");
        assert_eq!((data[1] >> 16).swap_bytes() >> 16, sent, "bytes 6 and 7");
        stamps.push((sent, rdtr >> 16));
    }
    assert_eq!(stamps[1].0 - stamps[0].0, 1000);
    assert_eq!(stamps[1].1 - stamps[0].1, 1000);
}

#[test]
fn a_stale_global_time_bit_does_nothing_outside_time_triggered_mode() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, 0);
    let receiver = normal_node(&mut bus, 0);
    let now = bus.now();
    bus.write(sender, TI0R + 4, 8 | 1 << 8, now);
    bus.write(sender, TI0R + 8, 0, now);
    bus.write(sender, TI0R + 12, 0x8877_6655, now);
    bus.write(sender, TI0R, 0x123 << 21 | 1, now);
    bus.advance_to(now + bits(200));
    let (_, rdtr, data) = take(&mut bus, receiver).expect("a frame");
    assert_eq!((rdtr >> 16, data[1]), (0, 0x8877_6655));
}

#[test]
fn master_reset_returns_to_sleep() {
    let mut bus = Bus::new();
    let tester = bus.add_tester(Tester::new());
    let node = normal_node(&mut bus, ABOM);
    let now = bus.now();
    bus.send_at(tester, now, frame(0x123, &[]), Retry::UntilSent);
    bus.advance_to(now + bits(100));
    assert_eq!(bus.read(node, RF0R), 1);
    bus.write(node, MCR, 1 << 15, bus.now());
    assert_eq!(bus.read(node, MCR), 0x0001_0002);
    assert_eq!(bus.read(node, RF0R), 0);
    bus.advance_to(bus.now() + bits(20));
    assert_eq!(bus.read(node, MSR) & 3, 2);
    assert_eq!(bus.read(node, BTR), BTR_250K_F446, "other registers stay");
}

#[test]
fn a_system_reset_takes_the_node_off_the_bus_in_the_midst_of_its_frame() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, 0);
    let receiver = normal_node(&mut bus, 0);
    let now = bus.now();
    request(&mut bus, sender, 0, &frame(0x123, &[0x55; 8]), now);
    bus.advance_to(now + bits(40));
    bus.reset(sender, now + bits(40));
    assert_eq!(bus.read(sender, MCR), 0x0001_0002);
    assert_eq!(bus.read(sender, FMR), 0x2A1C_0E01);
    bus.advance_to(now + bits(200));
    assert_eq!(bus.read(receiver, RF0R), 0);
    assert_eq!(
        (rec(&bus, receiver), lec(&bus, receiver)),
        (1, 1),
        "a stuff error"
    );
    configure(&mut bus, sender, 0, BTR_250K_F446);
    let now = bus.now();
    request(&mut bus, sender, 0, &frame(0x123, &[]), now);
    bus.advance_to(now + bits(100));
    assert_eq!(bus.read(receiver, RF0R), 1);
}

#[test]
fn the_status_register_shows_who_sends() {
    let mut bus = Bus::new();
    let sender = normal_node(&mut bus, 0);
    let receiver = normal_node(&mut bus, 0);
    let now = bus.now();
    request(&mut bus, sender, 0, &frame(0, &[]), now);
    // Within the first bits, which are all dominant.
    bus.advance_to(now + bits(3));
    assert_eq!(bus.read(sender, MSR) >> 8, 0b0001, "TXM, RX dominant");
    assert_eq!(bus.read(receiver, MSR) >> 8, 0b0010, "RXM");
    bus.advance_to(now + bits(100));
    assert_eq!(bus.read(sender, MSR) >> 8, 0b1100);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever a program writes, the model continues and its status stays consistent.
    #[test]
    fn no_sequence_of_writes_upsets_the_model(
        writes in prop::collection::vec(
            (
                0..2_usize,
                prop_oneof![
                    // The control registers, MCR above all, then mailboxes, filters, anything.
                    3 => Just(MCR),
                    3 => (0..8_u32).prop_map(|word| 4 * word),
                    3 => (0..12_u32).prop_map(|word| TI0R + 4 * word),
                    1 => (0..80_u32).prop_map(|word| FMR + 4 * word),
                    1 => 0..0x400_u32,
                ],
                prop_oneof![any::<u32>(), 0..256_u32, (0..32_u32).prop_map(|bit| 1 << bit)],
                0..400_u64,
            ),
            1..120,
        ),
    ) {
        let mut bus = Bus::new();
        let tester = bus.add_tester(Tester::new());
        let nodes = [normal_node(&mut bus, 0), normal_node(&mut bus, NART)];
        for (serial, (node, offset, value, us)) in writes.into_iter().enumerate() {
            let at = bus.now() + can_bus::SimDuration::from_ticks(us * 1_000_000);
            // Every other write is at the time of the bus, the rest are ahead of it.
            if serial % 2 == 0 {
                bus.advance_to(at);
            }
            bus.write(nodes[node], offset, value, at);
            bus.send_at(tester, at, frame(serial as u16, &[]), Retry::Once);
            bus.advance_to(at);
            for node in nodes {
                let msr = bus.read(node, MSR);
                prop_assert_ne!(msr & 3, 3, "asleep and in initialisation");
                let tsr = bus.read(node, TSR);
                for mailbox in 0..3 {
                    let empty = tsr >> (26 + mailbox) & 1 == 1;
                    let requested = bus.read(node, TI0R + 0x10 * mailbox) & 1 == 1;
                    prop_assert_eq!(empty, !requested, "TME and TXRQ of {}", mailbox);
                    let aborting = tsr >> (8 * mailbox + 7) & 1 == 1;
                    prop_assert!(!(empty && aborting));
                }
                let esr = bus.read(node, ESR);
                let state = bus.error_counters(node).state();
                prop_assert_eq!(esr & 4 != 0, state == can_bus::ErrorState::BusOff);
                prop_assert!(bus.horizon_of(node) >= bus.now());
            }
            prop_assert!(bus.next_event().is_none_or(|next| next >= bus.now()));
        }
    }
}
