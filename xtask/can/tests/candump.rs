//! The candump log format, compared with the reader of the `socketcan` crate.

#[path = "common/frames.rs"]
mod frames;

use can_bus::candump::{Line, ParseError};
use can_bus::{Frame, SimTime};
use frames::any_frame;
use proptest::prelude::*;

const SHIPPED: &str = "(1194.396200) can0 064#00004ABB82";

fn any_line() -> impl Strategy<Value = Line> {
    // Whole microseconds up to about 200 days.
    (any_frame(), 0..17_000_000_000_000_u64, "[a-z]{1,6}[0-9]").prop_map(
        |(frame, us, interface)| Line {
            at: SimTime::from_ticks(us * 1_000_000),
            interface,
            frame,
        },
    )
}

proptest! {
    #[test]
    fn a_line_is_read_back_as_written(line in any_line()) {
        prop_assert_eq!(line.to_string().parse::<Line>(), Ok(line));
    }

    #[test]
    fn any_text_is_read_or_refused(text in "\\PC{0,60}") {
        if let Ok(line) = text.parse::<Line>() {
            prop_assert_eq!(line.to_string().parse::<Line>(), Ok(line));
        }
    }
}

#[test]
fn a_line_of_the_thesis_is_read() {
    let line: Line = SHIPPED.parse().expect("a candump line");
    assert_eq!(line.at.as_ticks(), 1_194_396_200_000_000);
    assert_eq!(line.interface, "can0");
    assert_eq!(
        Some(line.frame),
        Frame::standard(0x064, &[0x00, 0x00, 0x4A, 0xBB, 0x82])
    );
    assert_eq!(
        line.to_string(),
        "(0000001194.396200) can0 064#00004ABB82",
        "candump -l pads the seconds to ten digits"
    );
}

#[test]
fn the_direction_of_a_frame_is_read_over() {
    let line: Line = SHIPPED.parse().expect("a candump line");
    for flag in ["R", "T"] {
        assert_eq!(format!("{SHIPPED} {flag}").parse().as_ref(), Ok(&line));
    }
}

#[test]
fn what_is_wrong_is_named() {
    for (line, error) in [
        ("", ParseError::Fields),
        ("(1.000000) can0", ParseError::Fields),
        ("(1.000000) can0 064#00 R x", ParseError::Fields),
        ("(1.000000) can0 064", ParseError::Fields),
        ("1.000000 can0 064#00", ParseError::Stamp),
        ("(1.0000) can0 064#00", ParseError::Stamp),
        ("(-1.000000) can0 064#00", ParseError::Stamp),
        ("(99999999999999.000000) can0 064#00", ParseError::Stamp),
        ("(1.000000) can0 64#00", ParseError::Identifier),
        ("(1.000000) can0 800#00", ParseError::Identifier),
        ("(1.000000) can0 40000000#00", ParseError::Identifier),
        (
            "(1.000000) can0 20000004#0004000000000000",
            ParseError::ErrorFrame,
        ),
        ("(1.000000) can0 +64#00", ParseError::Identifier),
        ("(1.000000) can0 064#0", ParseError::Data),
        ("(1.000000) can0 064#0G", ParseError::Data),
        ("(1.000000) can0 064#000000000000000000", ParseError::Data),
        ("(1.000000) can0 064#R9", ParseError::Data),
        ("(1.000000) can0 064##100", ParseError::Fd),
        ("(1.000000) can0 064#00 X", ParseError::Fields),
    ] {
        assert_eq!(line.parse::<Line>(), Err(error), "{line}");
    }
}

/// The crate also uses Linux sockets and therefore builds only on Linux.
#[cfg(target_os = "linux")]
mod oracle {
    use super::*;
    use embedded_can::Frame as _;
    use socketcan::CanAnyFrame;
    use socketcan::dump::Reader;

    proptest! {
        #[test]
        fn another_reader_understands_a_line(line in any_line()) {
            let text = line.to_string();
            let record = Reader::from_reader(text.as_bytes())
                .next_record()
                .expect("a candump line")
                .expect("a record");
            prop_assert_eq!(record.t_us, line.at.as_ticks() / 1_000_000);
            prop_assert_eq!(&record.device, &line.interface);
            // The reverse: our parser reads what the crate writes.
            prop_assert_eq!(record.to_string().parse::<Line>(), Ok(line.clone()));
            match record.frame {
                CanAnyFrame::Normal(data) => {
                    prop_assert!(!line.frame.is_remote());
                    prop_assert_eq!(data.id(), line.frame.id());
                    prop_assert_eq!(data.data(), line.frame.data());
                }
                CanAnyFrame::Remote(remote) => {
                    prop_assert!(line.frame.is_remote());
                    prop_assert_eq!(remote.id(), line.frame.id());
                    prop_assert_eq!(remote.dlc(), usize::from(line.frame.dlc()));
                }
                other => prop_assert!(false, "{:?}", other),
            }
        }
    }
}
