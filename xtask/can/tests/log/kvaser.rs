//! Kvaser's formats, written as the sources of Kvaser's canlib write them.

use can_bus::Frame;
use can_bus::log::{Direction, Format, Skip};
use embedded_can::Id;
use proptest::prelude::*;

use crate::common::{entries, format, kinds};
use crate::frames::any_frame;

/// A frame and when it came: microseconds, channel, whether it was sent.
type Logged = (u64, u8, bool, Frame);

fn any_log() -> impl Strategy<Value = Vec<Logged>> {
    let logged = (0..10_000_000_000_u64, 1..5_u8, any::<bool>(), any_frame());
    prop::collection::vec(logged, 1..12)
}

fn raw(frame: &Frame) -> (u32, bool) {
    match frame.id() {
        Id::Standard(id) => (u32::from(id.as_raw()), false),
        Id::Extended(id) => (id.as_raw(), true),
    }
}

fn stamp(us: u64) -> String {
    format!("{}.{:06}", us / 1_000_000, us % 1_000_000)
}

/// A number in one of the two bases, with so many digits at least.
fn number(value: u32, hex: bool, digits: usize) -> String {
    match hex {
        true => format!("{value:0digits$X}"),
        false => format!("{value}"),
    }
}

fn bytes(frame: &Frame, hex: bool) -> Vec<String> {
    let data = frame.data().iter();
    data.map(|byte| number(u32::from(*byte), hex, 2)).collect()
}

fn canking(log: &[Logged], hex: bool) -> String {
    let mut text = String::from(
        "Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n",
    );
    for (us, channel, sent, frame) in log {
        let (id, extended) = raw(frame);
        let mut flags = String::new();
        if extended {
            flags.push('X');
        }
        if frame.is_remote() {
            flags.push('R');
        }
        text += &format!(
            " {channel}    {} {flags:<3}   {}  {}  {} {}\n",
            number(id, hex, 8),
            frame.dlc(),
            bytes(frame, hex).join("  "),
            stamp(*us),
            if *sent { 'T' } else { 'R' }
        );
    }
    text + "Logging stopped.\n"
}

fn base(hex: bool) -> &'static str {
    if hex { "HEX" } else { "DEC" }
}

fn memorator(log: &[Logged], hex: bool) -> String {
    let mut text = format!(
        "                              Kvaser Memorator Log\n                              ====================\n\n\
         Memorator Binary logfile created at: 2018-05-24 12:00:00\n\n\nSettings:\n   Format of data field: {}\n   \
         Format of id field:   {}\n   Timestamp Offset:     0.000000000        s\n   CAN channel:          1 2\n\n        \
         Time Chan   Identifier Flags        DLC  Data                               Counter\n{}\n",
        base(hex),
        base(hex),
        "=".repeat(90)
    );
    for (count, (us, channel, sent, frame)) in log.iter().enumerate() {
        let (id, extended) = raw(frame);
        text += &format!(
            "{:>12}  {channel}  {:>10}{}   {:<5}    {}   {:>3}  {:<24} {count:>12}\n",
            stamp(*us),
            number(id, hex, 1),
            if extended { 'x' } else { ' ' },
            if *sent { "Tx" } else { "Rx" },
            if frame.is_remote() { 'R' } else { ' ' },
            frame.dlc(),
            if frame.is_remote() {
                "RTR".to_owned()
            } else {
                bytes(frame, hex).join(" ")
            }
        );
    }
    text
}

fn csv(log: &[Logged], hex: bool, separator: char) -> String {
    let s = separator;
    let mut text = format!(
        "CSV CAN data\nConverted from Kvaser Memorator at{s}2018-05-24 12:00:00\n      \nFormat of data field{s}{}\n\
         Format of id field{s}{}\nTimestamp Offset{s}            0.000000{s}seconds\nLogging started at{s}2018-05-24 \
         12:00:00\nTime{s}Channel{s}id{s}Flags{s}DLC{s}Data0{s}Data1{s}Data2{s}Data3{s}Data4{s}Data5{s}Data6{s}Data7{s}Counter\n",
        base(hex),
        base(hex)
    );
    for (count, (us, channel, sent, frame)) in log.iter().enumerate() {
        let (id, extended) = raw(frame);
        let flags = if extended { 4 } else { 2 }
            + if frame.is_remote() { 1 } else { 0 }
            + if *sent { 0x40 } else { 0 };
        let mut data = bytes(frame, hex);
        data.resize(8, String::new());
        // With a decimal comma the fields are separated by semicolons.
        let time = stamp(*us).replace('.', if s == ';' { "," } else { "." });
        text += &format!(
            "{time}{s}{channel}{s}{}{s}{flags}{s}{}{s}{}{s}{count}\n",
            number(id, hex, 1).to_lowercase(),
            frame.dlc(),
            data.join(&s.to_string())
        );
    }
    text
}

fn check(log: &[Logged], text: &str, expected: Format) {
    let read = entries(text.as_bytes());
    assert_eq!(read.len(), log.len(), "{text}");
    for ((name, entry), (us, channel, sent, frame)) in read.iter().zip(log) {
        assert_eq!(*name, channel.to_string());
        assert_eq!(entry.at.as_ticks(), us * 1000);
        assert_eq!(entry.frame, *frame, "{text}");
        let direction = if *sent {
            Direction::Sent
        } else {
            Direction::Received
        };
        assert_eq!(entry.direction, Some(direction));
    }
    assert_eq!(kinds(text.as_bytes()), [], "{text}");
    assert_eq!(format(text.as_bytes()), Some(expected));
}

proptest! {
    /// Decimal identifiers of eight digits cannot be told from hexadecimal ones.
    #[test]
    fn canking_is_read_back_as_written(log in any_log(), hex in any::<bool>()) {
        let told = |(_, _, _, frame): &Logged| hex || raw(frame).0.to_string().len() != 8;
        let log: Vec<Logged> = log.into_iter().filter(told).collect();
        if !log.is_empty() {
            check(&log, &canking(&log, hex), Format::CanKing);
        }
    }

    #[test]
    fn memorator_text_is_read_back_as_written(log in any_log(), hex in any::<bool>()) {
        check(&log, &memorator(&log, hex), Format::Memorator);
    }

    #[test]
    fn csv_is_read_back_as_written(log in any_log(), hex in any::<bool>(), semicolon in any::<bool>()) {
        let separator = if semicolon { ';' } else { ',' };
        check(&log, &csv(&log, hex, separator), Format::KvaserCsv);
    }
}

#[test]
fn lines_of_canking_are_read() {
    // From the CanKing logs that other readers of the format quote.
    let log = "\
        Chn Identifier Flg   DLC  D0...1...2...3...4...5...6..D7       Time     Dir\n \
        0    0000014B         1  00                                1675.570498 T\n \
        0    00002102 X       8  60  00  00  5F  60  60  E2  F2   46055.090598 R\n \
        0    00000000            ErrorFrame                          29.095270 R\n\
        Logging stopped.\n";
    let read = entries(log.as_bytes());
    let [one, two] = &read[..] else {
        panic!("{read:?}");
    };
    assert_eq!(Some(one.1.frame), Frame::standard(0x14B, &[0]));
    let data = [0x60, 0, 0, 0x5F, 0x60, 0x60, 0xE2, 0xF2];
    assert_eq!(Some(two.1.frame), Frame::extended(0x2102, &data));
    assert_eq!(two.1.at.as_ticks(), 46_055_090_598_000);
    assert_eq!(kinds(log.as_bytes()), [(Skip::ErrorFrame, 1)]);
}

#[test]
fn what_is_no_frame_is_counted_by_its_kind() {
    let frame = Frame::standard(100, &[1, 2]).expect("a frame");
    let text = memorator(&[(1_000_000, 1, false, frame)], true)
        + "    1.100000  1  ErrorFrame    Rx                 ERROR FRAME             2\n    \
           1.200000  Trigger (type=0x1, active=0x00, pre-trigger=0, post-trigger=-1)\n    \
           1.300000  1          64    Rx    FB     9  00 01 02 03 04 05 06 07 08 09 0A 0B    3\n    \
           1.400000  1          64    TxRq         2  00 01             4\n    \
           1.500000  1         ZZZ    Rx           2  00 01             4\n\
           DateTime: 2018-05-24 12:00:00\n\
           some words\n";
    let expected = [
        (Skip::FdFrame, 1),
        (Skip::ErrorFrame, 1),
        (Skip::Event, 2),
        (Skip::Unreadable, 2),
    ];
    assert_eq!(kinds(text.as_bytes()), expected);
    let text = csv(&[(1_000_000, 1, false, frame)], false, ',')
        + "1.1,1,,34,,,,,,,,,,2\n1.2,1,100,65538,9,0,1,2,3,4,5,6,7,3\n1.3,1,100,130,2,0,1,,,,,,,4\n\
           1.4,1,100,2,2,0,256,,,,,,,5\n-0.5,1,100,2,2,0,1,,,,,,,6\n";
    let expected = [
        (Skip::FdFrame, 1),
        (Skip::ErrorFrame, 1),
        (Skip::Event, 1),
        (Skip::Unreadable, 2),
    ];
    assert_eq!(kinds(text.as_bytes()), expected);
}

#[test]
fn parameter_group_numbers_are_no_identifiers() {
    let text = "CSV CAN data\nTime,Channel,PGN,Flags,DLC,Data0,Counter\n1.0,1,100,2,1,0,1\n";
    assert_eq!(format(text.as_bytes()), None);
}
