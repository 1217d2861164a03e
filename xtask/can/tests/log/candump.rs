//! The lines of `candump`.

use can_bus::candump::Line;
use can_bus::log::{Direction, Format, LogTime, Skip};
use can_bus::{Frame, SimTime};
use embedded_can::Id;
use proptest::prelude::*;

use crate::common::{entries, format, kinds};
use crate::frames::any_frame;

fn us(us: u64) -> LogTime {
    LogTime::from_ticks(us * 1000)
}

/// A line of candump's screen, after the format strings of `candump.c` and `lib.c` of can-utils.
fn screen(us: u64, interface: &str, frame: &Frame, extra: bool) -> String {
    let id = match frame.id() {
        Id::Standard(id) => format!("{:>8}", format!("{:03X}", id.as_raw())),
        Id::Extended(id) => format!("{:08X}", id.as_raw()),
    };
    let flags = if extra { " RX - - " } else { "" };
    let data = if frame.is_remote() {
        "  remote request".to_owned()
    } else {
        let bytes = frame.data().iter();
        bytes.map(|byte| format!(" {byte:02X}")).collect()
    };
    format!(
        " ({:010}.{:06})  {interface} {flags} {id}   [{}] {data}\n",
        us / 1_000_000,
        us % 1_000_000,
        frame.dlc()
    )
}

proptest! {
    #[test]
    fn a_line_of_a_log_is_read_back_as_written(
        frame in any_frame(),
        at in 0..17_000_000_000_000_u64,
        interface in "[a-z]{1,6}[0-9]",
        direction in prop::option::of(prop_oneof![Just("R"), Just("T")]),
    ) {
        let line = Line {
            at: SimTime::from_ticks(at * 1_000_000),
            interface: interface.clone(),
            frame,
        };
        let flag = direction.map_or_else(String::new, |flag| format!(" {flag}"));
        let read = entries(format!("{line}{flag}\n").as_bytes());
        let [(name, entry)] = &read[..] else {
            panic!("{line}: {read:?}");
        };
        prop_assert_eq!((name, entry.at, entry.frame), (&interface, us(at), frame));
        let expected = direction.map(|flag| match flag {
            "R" => Direction::Received,
            _ => Direction::Sent,
        });
        prop_assert_eq!(entry.direction, expected);
    }

    #[test]
    fn a_line_of_the_screen_is_read_back_as_written(
        frame in any_frame(),
        at in 0..17_000_000_000_000_u64,
        extra in any::<bool>(),
    ) {
        let line = screen(at, "vcan1", &frame, extra);
        let read = entries(line.as_bytes());
        let [(name, entry)] = &read[..] else {
            panic!("{line}: {read:?}");
        };
        prop_assert_eq!((&name[..], entry.at, entry.frame), ("vcan1", us(at), frame));
        prop_assert_eq!(entry.direction, extra.then_some(Direction::Received));
    }

    /// The reader for one line refuses and accepts the same, apart from shorter stamps.
    #[test]
    fn both_readers_of_the_crate_agree(text in "\\(1\\.000000\\) can0 [0-9A-F]{2,9}#[#R0-9A-FG]{0,17}") {
        let line = text.parse::<Line>();
        let read = entries(text.as_bytes());
        prop_assert_eq!(
            line.ok().map(|line| line.frame),
            read.first().map(|(_, entry)| entry.frame)
        );
    }
}

#[test]
fn lines_of_real_tools_are_read() {
    // The manual of can-utils, candump(1), and lines with a code above 8 (`-8`), a time of
    // nanoseconds (`--timestamp` with hardware stamps) and ASCII (`-a`).
    let log = "\
        (1436509052.249713) vcan0 044#2A366C2BBA\n\
        (1436509052.449847) vcan0 0F6#7ADFE07BD2_9\n\
        (1436509052.650004123) can1 12345678#\n \
        (000.000000)  vcan0  1F334455   [3]  11 22 33   '.\"3'\n \
        (000.000099)  can0  123   [0]  remote request\n";
    let read = entries(log.as_bytes());
    let names: Vec<&str> = read.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["vcan0", "can1", "vcan0", "can0"]);
    assert_eq!(read[1].1.at.as_ticks(), 1_436_509_052_650_004_123);
    assert_eq!(read[2].1.frame.data(), [0x11, 0x22, 0x33]);
    assert!(read[3].1.frame.is_remote());
    assert_eq!(format(log.as_bytes()), Some(Format::Candump));
    // A frame with a code above 8 has eight bytes.
    assert_eq!(kinds(log.as_bytes()), [(Skip::Unreadable, 1)]);
    let long = entries(b"(1.0) can0 0F6#7ADFE07BD2000000_9\n");
    assert_eq!(long[0].1.frame.dlc(), 9);
}

#[test]
fn dates_are_read() {
    // Seconds since 1970 as GNU date gives them: `date -u -d "2015-07-10 06:17:32" +%s`.
    for (stamp, seconds) in [
        ("1970-01-01 00:00:00", 0),
        ("1972-02-29 00:00:01", 68_169_601),
        ("2000-03-01 12:00:00", 951_912_000),
        ("2015-07-10 06:17:32", 1_436_509_052),
        ("2026-11-27 23:59:59", 1_795_823_999),
        ("2100-12-31 00:00:00", 4_133_894_400),
    ] {
        let log = format!(" ({stamp}.249713)  vcan0  123   [1]  11\n");
        let read = entries(log.as_bytes());
        assert_eq!(
            read[0].1.at.as_ticks(),
            seconds * 1_000_000_000 + 249_713_000,
            "{stamp}"
        );
    }
    for stamp in [
        "1969-12-31 23:59:59.0",
        "2015-13-01 00:00:00.0",
        "2015-01-01 24:00:00.0",
        "2015-01-01 00:00",
    ] {
        let log = format!("({stamp}) vcan0 123 [1] 11\n");
        assert_eq!(kinds(log.as_bytes()), [(Skip::Unreadable, 1)], "{stamp}");
    }
}

#[test]
fn what_is_no_frame_is_counted_by_its_kind() {
    let log = "\
        (1.000000) can0 064#00\n\
        (1.000000) can0 20000004#0004000000000000\n\
        (1.000000) can0 20000080#0000000000000000\n\
        (1.000000) can0 064##100112233445566778899AABB\n\
        (1.000000) can0 064##0\n \
        (1.000000)  can0  064   [12]  00 11 22 33 44 55 66 77 88 99 AA BB\n \
        (1.000000)  can0  20000004   [8]  00 04 00 00 00 00 00 00   ERRORFRAME\n\
        (1.000000) can0 064#0\n\
        (1.000000) can0 064#00 X\n\
        (1.000000) can0 64#00\n\
        (1.000000) can0 064##\n\
        (1.0x) can0 064#00\n\
        interface = can0, family = 29, type = 3, proto = 1\n";
    assert_eq!(
        kinds(log.as_bytes()),
        [
            (Skip::FdFrame, 3),
            (Skip::ErrorFrame, 3),
            (Skip::Unreadable, 6)
        ]
    );
    assert_eq!(entries(log.as_bytes()).len(), 1);
}
