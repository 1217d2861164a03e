//! The lines of CAN adapters on a serial port. The fuzz target with random bytes is here too.

#[path = "common/frames.rs"]
mod frames;
#[path = "../fuzz/src/lib.rs"]
#[expect(unreachable_pub, dead_code, reason = "a library of its own in `fuzz/`")]
mod fuzz;

use can_bus::Frame;
use can_bus::slcan::{Answer, BIT_RATES, bit_rate, encode};
use embedded_can::StandardId;
use frames::any_frame;
use fuzz::slcan;
use proptest::prelude::*;

proptest! {
    #[test]
    fn a_frame_is_read_back_as_written(
        frame in any_frame(),
        stamp in prop::option::of(any::<u16>()),
        before in prop::collection::vec(any::<u8>(), 0..60),
    ) {
        let mut line = encode(&frame);
        if let Some(stamp) = stamp {
            line.insert_str(line.len() - 1, &format!("{stamp:04x}"));
        }
        // A line that was read from its middle ends with the next carriage return.
        let bytes = [&before[..], b"\r", line.as_bytes()].concat();
        prop_assert_eq!(slcan(&bytes).pop(), Some(Answer::Frame { frame, stamp }));
    }

    #[test]
    fn any_bytes_are_read(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        slcan(&bytes);
    }

    #[test]
    fn any_bytes_of_the_alphabet_are_read(text in "[tTrRzZ0-9a-fA-F\r\n\x07]{0,200}") {
        slcan(text.as_bytes());
    }
}

#[test]
fn the_examples_of_the_manual_are_read() {
    let read = |text: &str| slcan(text.as_bytes());
    let frame = |frame: Option<Frame>, stamp| Answer::Frame {
        frame: frame.expect("a frame"),
        stamp,
    };
    assert_eq!(
        read("t10021133\r"),
        [frame(Frame::standard(0x100, &[0x11, 0x33]), None)]
    );
    assert_eq!(
        read("T0000010021133\r"),
        [frame(Frame::extended(0x100, &[0x11, 0x33]), None)]
    );
    assert_eq!(
        read("T00000100211331234\r"),
        [frame(Frame::extended(0x100, &[0x11, 0x33]), Some(0x1234))]
    );
    let remote = Frame::new_remote(StandardId::new(0x100).expect("in range"), 2);
    assert_eq!(read("r1002\r"), [frame(remote, None)]);
    assert_eq!(
        read("\rz\rZ\r\x07V1013\r"),
        [
            Answer::Done,
            Answer::Taken,
            Answer::Taken,
            Answer::Refused,
            Answer::Other(b"V1013".to_vec())
        ]
    );
}

#[test]
fn what_is_no_frame_is_none() {
    for line in [
        "t8000",
        "t1009",
        "t1001",
        "t100212",
        "t1002113",
        "t10021133123",
        "tx000",
        "T200000000",
        "r100A",
        "t+000",
    ] {
        let answers = slcan(format!("{line}\r").as_bytes());
        assert_eq!(answers, [Answer::Other(line.into())], "{line}");
    }
    // A line without end does not fill the memory, and the next one is read.
    let long = "t".repeat(100_000) + "\rt1000\r";
    assert!(matches!(slcan(long.as_bytes())[..], [Answer::Frame { .. }]));
}

#[test]
fn each_bit_rate_has_its_number() {
    assert_eq!(bit_rate(250_000).as_deref(), Some("S5\r"));
    assert_eq!(bit_rate(1_000_000).as_deref(), Some("S8\r"));
    assert_eq!(bit_rate(83_333), None);
    assert!(BIT_RATES.is_sorted());
}
