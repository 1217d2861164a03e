//! Vector's ASC.

use can_bus::Frame;
use can_bus::log::{Direction, Format, Skip};
use embedded_can::Id;
use proptest::prelude::*;

use crate::common::{entries, format, kinds};
use crate::frames::any_frame;

/// How a log is written.
#[derive(Clone, Copy, Debug)]
struct Style {
    decimal: bool,
    relative: bool,
}

fn any_style() -> impl Strategy<Value = Style> {
    (any::<bool>(), any::<bool>()).prop_map(|(decimal, relative)| Style { decimal, relative })
}

/// A log as CANalyzer writes it. Times are microseconds.
fn write(frames: &[(u64, u8, bool, Frame)], style: Style) -> String {
    let (base, times) = (
        if style.decimal { "dec" } else { "hex" },
        if style.relative {
            "relative"
        } else {
            "absolute"
        },
    );
    let mut log = format!(
        "date Mit Mär 5 10:21:00 am 2025\nbase {base}  timestamps {times}\nno internal events logged\n\
         // version 8.0.0\nBegin Triggerblock Mit Mär 5 10:21:00 am 2025\n   0.000000 Start of measurement\n"
    );
    let mut before = 0;
    for (at, channel, sent, frame) in frames {
        let stamp = if style.relative { at - before } else { *at };
        before = *at;
        let number = |value: u32| match style.decimal {
            true => format!("{value}"),
            false => format!("{value:X}"),
        };
        let id = match frame.id() {
            Id::Standard(id) => number(u32::from(id.as_raw())),
            Id::Extended(id) => number(id.as_raw()) + "x",
        };
        let kind = if frame.is_remote() { "r" } else { "d" };
        let bytes = frame.data().iter();
        let bytes: String = bytes
            .map(|byte| match style.decimal {
                true => format!(" {byte:03}"),
                false => format!(" {byte:02X}"),
            })
            .collect();
        let direction = if *sent { "Tx" } else { "Rx" };
        log += &format!(
            "   {}.{:06} {channel}  {id:<15} {direction}   {kind} {}{bytes}  Length = 0 BitCount = 64 ID = {id}\n",
            stamp / 1_000_000,
            stamp % 1_000_000,
            frame.dlc()
        );
    }
    log + "End TriggerBlock\n"
}

proptest! {
    #[test]
    fn a_log_is_read_back_as_written(
        frames in prop::collection::vec((0..10_000_000_u64, 1..9_u8, any::<bool>(), any_frame()), 1..20),
        style in any_style(),
    ) {
        let mut at = 0;
        let frames: Vec<_> = frames
            .into_iter()
            .map(|(since, channel, sent, frame)| {
                at += since;
                (at, channel, sent, frame)
            })
            .collect();
        let log = write(&frames, style);
        let read = entries(log.as_bytes());
        prop_assert_eq!(read.len(), frames.len(), "{}", log);
        for ((name, entry), (at, channel, sent, frame)) in read.iter().zip(&frames) {
            prop_assert_eq!(name, &channel.to_string());
            prop_assert_eq!(entry.at.as_ticks(), at * 1000);
            prop_assert_eq!(entry.frame, *frame);
            let direction = if *sent { Direction::Sent } else { Direction::Received };
            prop_assert_eq!(entry.direction, Some(direction));
        }
        prop_assert_eq!(kinds(log.as_bytes()), [(Skip::Event, 1)]);
        prop_assert_eq!(format(log.as_bytes()), Some(Format::Asc));
    }
}

#[test]
fn what_is_no_frame_is_counted_by_its_kind() {
    // Lines as CANoe and CANalyzer write them beside frames.
    let log = "\
        base hex  timestamps absolute\n\
        0.000000 CAN 1 Status:chip status error active\n\
        0.100000 1  64              Rx   d 2 01 02  Length = 270000 BitCount = 140 ID = 100\n\
        0.100500 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.02%\n\
        0.101000 1  ErrorFrame\n\
        0.102000 1  ErrorFrame Flags = 0xe CodeExt = 0x20a2 Code = 0x82 ID = 0 DLC = 0 Position = 5 Length = 11300\n\
        0.103000 1  65              TxRq d 2 01 02\n\
        0.104000 CANFD   1 Rx        11e  EngineData  1 0 f 64 00 01 02\n\
        0.105000 CANFD   1 Rx        11e                                   1 0 4  4 00 01 02 03   130000  130     3000 0 0 0 0 0\n\
        0.106000 CANFD   1 Rx        11e                                   0 0 4  4 00 01 02 03   130000  130        0 0 0 0 0 0\n\
        0.107000 CANFD   1 Rx ErrorFrame   Code = 0x82\n\
        0.108000 1  EngineData      Rx   d 2 01 02\n\
        0.109000 1  64              Rx   d 3 01 02\n\
        0.110000 1  64              Rx   d 9 01 02 03 04 05 06 07 08\n";
    let read = entries(log.as_bytes());
    let frames: Vec<(u8, &[u8])> = read
        .iter()
        .map(|(_, entry)| (entry.frame.dlc(), entry.frame.data()))
        .collect();
    assert_eq!(
        frames,
        [
            (2, &[1, 2][..]),
            (4, &[0, 1, 2, 3]),
            (9, &[1, 2, 3, 4, 5, 6, 7, 8])
        ]
    );
    assert_eq!(
        kinds(log.as_bytes()),
        [
            (Skip::FdFrame, 2),
            (Skip::ErrorFrame, 3),
            (Skip::Event, 3),
            (Skip::Unreadable, 2)
        ]
    );
}

#[test]
fn times_between_lines_add_up_over_all_events() {
    let log = "\
        base dec  timestamps relative\n\
        0.500000 Start of measurement\n\
        0.250000 1  100             Rx   d 1 255\n\
        0.250000 1  Statistic: D 1 R 0 XD 0 XR 0 E 0 O 0 B 0.02%\n\
        0.125000 2  206x            Tx   d 0\n";
    let read = entries(log.as_bytes());
    let times: Vec<u64> = read.iter().map(|(_, entry)| entry.at.as_ticks()).collect();
    assert_eq!(times, [750_000_000, 1_125_000_000]);
    assert_eq!(Some(read[0].1.frame), Frame::standard(100, &[255]));
    assert_eq!(Some(read[1].1.frame), Frame::extended(206, &[]));
}
