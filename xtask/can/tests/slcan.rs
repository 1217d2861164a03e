//! The lines of CAN adapters on a serial port. The fuzz target with random bytes is here too.

#[path = "common/frames.rs"]
mod frames;
#[path = "../fuzz/src/lib.rs"]
#[expect(unreachable_pub, dead_code, reason = "a library of its own in `fuzz/`")]
mod fuzz;

use can_bus::Frame;
use can_bus::slcan::{Adapter, Answer, BIT_RATES, bit_rate, encode};
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
    assert!(matches!(
        slcan(long.as_bytes())[..],
        [Answer::TooLong, Answer::Frame { .. }]
    ));
}

#[test]
fn each_bit_rate_has_its_number() {
    assert_eq!(bit_rate(250_000).as_deref(), Some("S5\r"));
    assert_eq!(bit_rate(1_000_000).as_deref(), Some("S8\r"));
    assert_eq!(bit_rate(83_333), None);
    assert!(BIT_RATES.is_sorted());
}

/// What an adapter answers to a text, and the frames that it sends.
fn answers(adapter: &mut Adapter, text: &str) -> (String, Vec<Frame>) {
    let mut said = String::new();
    let mut frames = Vec::new();
    for byte in text.bytes() {
        let reaction = adapter.take(byte);
        said += reaction.answer;
        frames.extend(reaction.frame);
    }
    (said, frames)
}

/// The commands of the CAN232 manual, and what `slcand` and `python-can` send at their start.
#[test]
fn an_adapter_answers_as_the_manual_says() {
    let mut adapter = Adapter::new();
    let frame = Frame::standard(0x12C, &[0x7F, 1]).unwrap();
    let mut says = |text: &str| answers(&mut adapter, text).0;
    assert_eq!(
        says("\r\rC\rS5\r"),
        "\r\r\x07\r",
        "a closed channel cannot be closed"
    );
    assert_eq!(
        says("t12C27F01\r"),
        "\x07",
        "nothing is sent through a closed channel"
    );
    assert_eq!(says("V\rN\rO\r"), "V1013\rNF001\r\r");
    assert_eq!(says("O\rS5\rX1\rt12C\r"), "\x07\x07\x07\x07");
    assert_eq!(answers(&mut adapter, "t12C27F01\rT0000012C0\r").0, "z\rZ\r");
    assert_eq!(answers(&mut adapter, "t12C27F01\r").1, [frame]);
    assert_eq!(adapter.received(&frame, 61_005).unwrap(), "t12C27F01\r");
    answers(&mut adapter, "Z1\r");
    assert_eq!(adapter.received(&frame, 61_005).unwrap(), "t12C27F0103ED\r");
    answers(&mut adapter, "C\r");
    assert_eq!(adapter.received(&frame, 61_005), None);
}

proptest! {
    #[test]
    fn any_bytes_are_answered(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let mut adapter = Adapter::new();
        let ends = bytes.iter().filter(|byte| matches!(byte, b'\r' | 7)).count();
        let said: usize = bytes.iter().filter(|byte| !adapter.take(**byte).answer.is_empty()).count();
        prop_assert!(said <= ends);
    }

    #[test]
    fn what_an_adapter_takes_is_what_was_sent(frame in any_frame()) {
        let mut adapter = Adapter::new();
        answers(&mut adapter, "O\r");
        let (_, sent) = answers(&mut adapter, &encode(&frame));
        prop_assert_eq!(sent, [frame]);
    }
}
