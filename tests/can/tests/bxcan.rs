//! Register-level tests of the bxCAN model, a test for each behaviour of RM0390 section 30.

mod common;

use can_bus::{Bus, RecordKind};
use common::*;

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

    assert_eq!(
        bus.read(sender, TSR),
        0x1C00_0003,
        "RQCP and TXOK, all empty"
    );
    assert_eq!(bus.read(receiver, RF0R), 1);
    let (rir, rdtr, data) = take(&mut bus, receiver, start + bits(150)).expect("a message");
    assert_eq!(rir, 0x123 << 21);
    assert_eq!(rdtr, 8, "DLC 8, filter 0, no stamp");
    assert_eq!(data, [0x0403_0201, 0x0807_0605]);
    assert_eq!(bus.read(receiver, RF0R), 0);
    assert_eq!(
        bus.read(sender, RF0R),
        0,
        "a sender does not receive itself"
    );

    let records = bus.drain_records();
    let kinds: Vec<_> = records
        .iter()
        .map(|record| (record.node, record.kind))
        .collect();
    let [
        (first, RecordKind::FrameStart { .. }),
        (second, RecordKind::FrameEnd { frame, start, bits }),
    ] = kinds[..]
    else {
        panic!("unexpected records {records:?}");
    };
    assert_eq!((first, second, frame), (sender, sender, sent));
    assert_eq!(
        records[1].at.as_ticks() - start.as_ticks(),
        u64::from(bits) * BIT
    );
}
