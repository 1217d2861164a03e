//! The frames of a run, in the forms that the report and other tools read.

use std::{collections::BTreeMap, fmt::Write};

use can_bus::candump::{ErrorLine, Line};
use can_bus::{ErrorKind, Frame, NodeId, Record, RecordKind, SimDuration, SimTime};
use embedded_can::Id;
use world::report::FrameRecord;

/// Bits of an error frame after the bit in which the error was found: six of the
/// flag, eight of the delimiter (ISO 11898-1, clause 10.4.4).
const ERROR_FRAME_BITS: u32 = 14;

/// The frames of a run.
pub(crate) struct Log {
    /// Every frame that began and did not lose arbitration, in order of time.
    pub frames: Vec<FrameRecord>,
    /// Who sent each of them.
    pub senders: Vec<NodeId>,
    /// The error frames, in order of time: what was found first.
    pub errors: Vec<ErrorLine>,
    lines: Vec<Line>,
}

/// Errors that follow each other by less belong to one error frame: six bits of each flag, and the
/// delimiter (ISO 11898-1, clause 10.4.4).
const ONE_ERROR_BITS: u32 = 6 + 6 + 8;

impl Log {
    /// Reconstructs the frames from the records of the bus model.
    pub(crate) fn new(records: &[Record], bit_time: SimDuration) -> Self {
        let mut log = Self {
            frames: Vec::new(),
            senders: Vec::new(),
            errors: Vec::new(),
            lines: Vec::new(),
        };
        let mut sent: Vec<(FrameRecord, NodeId)> = Vec::new();
        // Starts of frame that have not ended yet, by sender.
        let mut begun: BTreeMap<NodeId, SimTime> = BTreeMap::new();
        for record in records {
            match record.kind {
                RecordKind::FrameStart { .. } => {
                    begun.insert(record.node, record.at);
                }
                RecordKind::ArbitrationLost { .. } => {
                    begun.remove(&record.node);
                }
                RecordKind::FrameEnd { frame, start, .. } => {
                    begun.remove(&record.node);
                    let frame_record = recorded(frame, start, record.at, true);
                    sent.extend(frame_record.map(|frame| (frame, record.node)));
                    log.lines.push(Line {
                        at: record.at,
                        interface: "can0".into(),
                        frame,
                    });
                }
                RecordKind::Error {
                    kind, transmitter, ..
                } => {
                    log.error(record.at, kind, transmitter, bit_time);
                    if transmitter
                        && let Some(frame) = sent_by(records, record)
                        && let Some(start) = begun.remove(&record.node)
                    {
                        let end = record.at + bit_time * ERROR_FRAME_BITS;
                        let frame_record = recorded(frame, start, end, false);
                        sent.extend(frame_record.map(|frame| (frame, record.node)));
                    }
                }
                RecordKind::StateChange { .. } => {}
            }
        }
        sent.sort_by_key(|(frame, _)| frame.start);
        (log.frames, log.senders) = sent.into_iter().unzip();
        log
    }

    /// A node has found an error: it begins an error frame, unless one has just begun. Of nodes that
    /// find it in the same bit the sender counts.
    fn error(&mut self, at: SimTime, kind: ErrorKind, transmitter: bool, bit_time: SimDuration) {
        let found = ErrorLine {
            at,
            interface: "can0".into(),
            kind,
            transmitter,
        };
        match self.errors.last_mut() {
            Some(last) if at < last.at + bit_time => {
                if transmitter {
                    *last = found;
                }
            }
            Some(last) if at < last.at + bit_time * ONE_ERROR_BITS => {}
            _ => self.errors.push(found),
        }
    }

    /// The complete frames, stamped at end of frame, and the error frames, in the format of
    /// `candump -l`.
    pub(crate) fn candump(&self) -> String {
        let mut text = String::new();
        let mut errors = self.errors.iter().peekable();
        for line in &self.lines {
            while let Some(error) = errors.next_if(|error| error.at <= line.at) {
                // Writing to a string cannot fail.
                let _ = writeln!(text, "{error}");
            }
            let _ = writeln!(text, "{line}");
        }
        for error in errors {
            let _ = writeln!(text, "{error}");
        }
        text
    }
}

/// A frame in the form of the report, which handles 11-bit identifiers only, like the network.
fn recorded(frame: Frame, start: SimTime, end: SimTime, complete: bool) -> Option<FrameRecord> {
    let Id::Standard(id) = frame.id() else {
        return None;
    };
    let mut data = [0; 8];
    for (byte, value) in data.iter_mut().zip(frame.data()) {
        *byte = *value;
    }
    Some(FrameRecord {
        id: id.as_raw(),
        dlc: frame.dlc().min(8),
        data,
        start,
        end,
        complete,
        remote: frame.is_remote(),
    })
}

/// The frame that was destroyed by an error: the last one that its sender had begun.
fn sent_by(records: &[Record], error: &Record) -> Option<Frame> {
    let before = records.partition_point(|record| record.at <= error.at);
    records
        .iter()
        .take(before)
        .rev()
        .find_map(|record| match record.kind {
            RecordKind::FrameStart { frame } if record.node == error.node => Some(frame),
            _ => None,
        })
}

#[cfg(test)]
mod tests {
    use can_bus::candump::ParseError;
    use can_bus::{Bus, Disturbance, FrameSelect, Retry, SeenBy, Tester};

    use super::*;

    const BIT: SimDuration = SimDuration::from_ticks(4_000_000);

    fn micros(us: u64) -> SimTime {
        SimTime::from_ticks(us * 1_000_000)
    }

    #[test]
    fn a_bus_is_written_down() {
        let mut bus = Bus::new();
        let first = bus.add_tester(Tester::new());
        let second = bus.add_tester(Tester::new());
        let low = Frame::standard(0x0C8, &[1, 2, 3]).unwrap();
        let high = Frame::standard(0x1C2, &[4]).unwrap();
        // Both at once: the lower identifier wins and the other one follows.
        bus.send_at(first, micros(1000), low, Retry::UntilSent);
        bus.send_at(second, micros(1000), high, Retry::UntilSent);
        // A further frame is destroyed and sent again.
        bus.send_at(first, micros(3000), low, Retry::UntilSent);
        bus.disturb(Disturbance::Flip {
            frame: FrameSelect::Id {
                id: low.id(),
                occurrence: 1,
            },
            bit: 25,
            seen_by: SeenBy::All,
        });
        bus.advance_to(micros(6000));
        let log = Log::new(&bus.drain_records(), BIT);

        let seen: Vec<(u16, bool)> = log.frames.iter().map(|f| (f.id, f.complete)).collect();
        assert_eq!(
            seen,
            [(0x0C8, true), (0x1C2, true), (0x0C8, false), (0x0C8, true)]
        );
        for pair in log.frames.windows(2) {
            assert!(pair[0].end <= pair[1].start, "{pair:?}");
        }
        assert_eq!(log.frames[0].data, [1, 2, 3, 0, 0, 0, 0, 0]);

        assert_eq!(log.senders, [first, second, first, first]);

        // A recessive bit of the data reads dominant.
        let text = log.candump();
        let error = text.lines().nth(2).unwrap();
        assert!(
            error.ends_with(" can0 20000088#0000900000000000"),
            "{error}"
        );
        assert_eq!(error.parse::<Line>(), Err(ParseError::ErrorFrame));
        assert_eq!(log.errors.len(), 1, "all nodes found it");
        let lines: Vec<Line> = text.lines().filter_map(|l| l.parse().ok()).collect();
        assert_eq!(lines.len(), 3);
        assert_eq!(lines[1].frame, high);
        // The stamp is the end of frame, cut to whole microseconds.
        let end = log.frames[1].end.as_ticks();
        assert_eq!(lines[1].at.as_ticks(), end - end % 1_000_000);
    }
}
