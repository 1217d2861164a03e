//! The readers against python-can, whose writers wrote the same messages in two formats.
//!
//! `python_can/logs.py` wrote the files.

use can_bus::Frame;
use can_bus::log::{Format, Item, Skip};
use embedded_can::{ExtendedId, Id, StandardId};

use crate::common::{entries, format, read};

/// A line of `python-can.txt`.
struct Message {
    us: u64,
    channel: u8,
    kind: &'static str,
    frame: Option<Frame>,
}

fn messages() -> Vec<Message> {
    let lines = include_str!("../data/python-can.txt").lines();
    lines
        .map(|line| {
            let words: Vec<&str> = line.split_whitespace().collect();
            let [us, channel, kind, id, dlc, data] = words[..] else {
                panic!("{line}");
            };
            let id = match id.strip_suffix('x') {
                Some(raw) => Id::Extended(ExtendedId::new(raw.parse().unwrap()).unwrap()),
                None => Id::Standard(StandardId::new(id.parse().unwrap()).unwrap()),
            };
            let data: Vec<u8> = match data {
                "-" => Vec::new(),
                hex => (0..hex.len())
                    .step_by(2)
                    .map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap())
                    .collect(),
            };
            Message {
                us: us.parse().unwrap(),
                channel: channel.parse().unwrap(),
                kind,
                frame: match kind {
                    "data" => Frame::new_data(id, &data),
                    "remote" => Frame::new_remote(id, dlc.parse().unwrap()),
                    _ => None,
                },
            }
        })
        .collect()
}

fn count(log: &str, kind: Skip) -> usize {
    let items = read(log.as_bytes());
    let skipped = items.iter().filter(|item| **item == Item::Skipped(kind));
    skipped.count()
}

/// The logs have the same frames at the same times; `channel` is the name that the format gives a
/// channel, `start` the time that it leaves out, and `written` the frame that its writer makes of one.
fn compare(
    log: &str,
    start: u64,
    channel: impl Fn(u8) -> String,
    written: impl Fn(Frame) -> Frame,
) {
    let expected = messages();
    let frames: Vec<&Message> = expected.iter().filter(|one| one.frame.is_some()).collect();
    let read = entries(log.as_bytes());
    assert_eq!(read.len(), frames.len());
    for ((name, entry), message) in read.iter().zip(frames) {
        assert_eq!(entry.at.as_ticks(), (message.us - start) * 1000);
        assert_eq!(*name, channel(message.channel));
        assert_eq!(Some(entry.frame), message.frame.map(&written));
    }
    let of_kind = |kind| expected.iter().filter(|one| one.kind == kind).count();
    assert_eq!(count(log, Skip::FdFrame), of_kind("fd"));
    assert_eq!(count(log, Skip::ErrorFrame), of_kind("error"));
    assert!(of_kind("fd") > 10 && of_kind("error") > 10 && of_kind("remote") > 10);
    assert_eq!(count(log, Skip::Unreadable), 0);
}

#[test]
fn the_asc_log_of_python_can_is_read() {
    let log = include_str!("../data/python-can.asc");
    assert_eq!(format(log.as_bytes()), Some(Format::Asc));
    // Times count from the first message, channels from 1.
    let start = messages()[0].us;
    compare(
        log,
        start,
        |channel| (channel + 1).to_string(),
        |frame| frame,
    );
}

#[test]
fn the_candump_log_of_python_can_is_read() {
    let log = include_str!("../data/python-can.log");
    assert_eq!(format(log.as_bytes()), Some(Format::Candump));
    // It leaves out the length of a remote frame.
    let written = |frame: Frame| match frame.is_remote() {
        true => Frame::new_remote(frame.id(), 0).unwrap(),
        false => frame,
    };
    compare(log, 0, |channel| format!("can{channel}"), written);
}
