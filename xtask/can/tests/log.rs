//! The readers of logs: written frames are read back, and all other lines are counted by their kind.
//! The fuzz target with random bytes is here too.

#[path = "log/asc.rs"]
mod asc;
#[path = "log/candump.rs"]
mod candump;
#[path = "log/common.rs"]
mod common;
#[path = "common/frames.rs"]
mod frames;
#[path = "../fuzz/src/lib.rs"]
#[expect(unreachable_pub, dead_code, reason = "a library of its own in `fuzz/`")]
mod fuzz;
#[path = "log/kvaser.rs"]
mod kvaser;
#[path = "log/mcap.rs"]
mod mcap;
#[path = "log/python_can.rs"]
mod python_can;

use can_bus::log::{Item, LONGEST_LINE, Skip};
use common::{kinds, read};
use proptest::prelude::*;

proptest! {
    #[test]
    fn any_bytes_are_read(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        fuzz::log(&bytes);
    }

    #[test]
    fn any_bytes_of_the_formats_are_read(
        text in "([ (),.:/#_\\[\\]0-9a-fA-FRTxd\r\n]|can0|Rx|Tx|ErrorFrame|CANFD|base dec\n|Kvaser Memorator Log\n|Time,Channel,id,Flags,DLC,Data0\n|DEC|HEX){0,120}",
    ) {
        fuzz::log(text.as_bytes());
    }
}

/// Logs of all formats, whole.
const LOGS: [&str; 4] = [
    include_str!("data/python-can.asc"),
    include_str!("data/python-can.log"),
    "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n \
     0    0000014B         1  00                                1675.570498 T\n \
     0    00002102 X       8  60  00  00  5F  60  60  E2  F2   46055.090598 R\n",
    "CSV CAN data\nFormat of id field;HEX\nTime;Channel;id;Flags;DLC;Data0;Counter\n1,5;1;64;2;1;ff;1\n",
];

proptest! {
    /// Damage of a few bytes costs at most the lines that it touches, and every line is counted.
    #[test]
    fn a_damaged_log_is_read_beside_the_damage(
        log in prop::sample::select(&LOGS[..2]),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        let count = |items: &[Item]| {
            let frames = items.iter().filter(|item| matches!(item, Item::Frame(_)));
            frames.count()
        };
        // The heading says how numbers are meant: it stays whole here.
        let heading = log.find("measurement").unwrap_or(0);
        let mut bytes = log.as_bytes().to_vec();
        for (at, byte) in &damage {
            let at = heading + at.index(bytes.len() - heading);
            bytes[at] = *byte;
        }
        let (whole, damaged) = (read(log.as_bytes()), fuzz::log(&bytes));
        prop_assert!(count(&damaged) + 2 * damage.len() >= count(&whole));
        let ends = bytes.iter().filter(|byte| **byte == b'\n').count();
        let last = usize::from(bytes.last() != Some(&b'\n'));
        prop_assert_eq!(damaged.len(), ends + last);
    }

    #[test]
    fn any_damage_is_read(
        log in prop::sample::select(&LOGS[..]),
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..60),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut bytes = log.as_bytes().to_vec();
        for (at, byte) in &damage {
            let at = at.index(bytes.len());
            bytes[at] = *byte;
        }
        fuzz::log(&bytes[..cut.index(bytes.len())]);
    }
}

const FRAME: &str = "(1194.396200) can0 064#00004ABB82";

#[test]
fn a_byte_order_mark_and_the_ends_of_lines_do_not_count() {
    let lines = format!("\u{FEFF}{FRAME}\r\n\r\n  {FRAME}  \n");
    let items = read(lines.as_bytes());
    assert!(matches!(
        items[..],
        [Item::Frame(_), Item::Nothing, Item::Frame(_)]
    ));
    // In any other line it is an error.
    let later = format!("{FRAME}\n\u{FEFF}{FRAME}\n");
    assert_eq!(kinds(later.as_bytes()), [(Skip::Unreadable, 1)]);
}

#[test]
fn what_is_not_text_is_counted() {
    let mut log = format!("{FRAME}\n").into_bytes();
    log.extend_from_slice(b"(1194.4) can0 \xFF\xFE#00\n(1194.4) can0 064#\xE4\n");
    assert_eq!(kinds(&log), [(Skip::NotText, 2)]);
}

#[test]
fn a_last_line_without_an_end_is_cut() {
    let cut = format!("{FRAME}\n(1194.397260) can0 19");
    assert_eq!(kinds(cut.as_bytes()), [(Skip::Cut, 1)]);
    // It may look like a frame: its last byte may have had another digit, or one more behind it.
    for left in 0..2 {
        let cut = format!("{FRAME}\n{}", &FRAME[..FRAME.len() - left]);
        assert_eq!(kinds(cut.as_bytes()), [(Skip::Cut, 1)]);
    }
}

#[test]
fn of_an_endless_line_only_the_beginning_is_kept() {
    let mut log = vec![b'x'; 3 * LONGEST_LINE];
    log.extend_from_slice(format!("\n{FRAME}{}\n{FRAME}\n", " ".repeat(LONGEST_LINE)).as_bytes());
    let items = read(&log);
    assert_eq!(items[0], Item::Skipped(Skip::Unreadable));
    assert!(matches!(items[1..], [Item::Frame(_), Item::Frame(_)]));
}

#[test]
fn a_log_of_nothing_has_no_format() {
    for log in ["", "\n", "hello\nworld\n", "1 2 3\n", "date Mon\n"] {
        assert_eq!(common::format(log.as_bytes()), None, "{log:?}");
    }
}
