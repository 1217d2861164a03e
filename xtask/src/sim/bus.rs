//! The frames of a run, in the forms that the report and other tools read.

use std::{collections::BTreeMap, fmt::Write};

use can_bus::{Frame, NodeId, Record, RecordKind, SimDuration, SimTime, candump::Line};
use embedded_can::Id;
use world::report::FrameRecord;

/// Bits of an error frame after the bit in which the error was found: six of the
/// flag, eight of the delimiter (ISO 11898-1, clause 10.4.4).
const ERROR_FRAME_BITS: u32 = 14;

/// The frames of a run.
pub(crate) struct Log {
    /// Every frame that began and did not lose arbitration, in order of time.
    pub frames: Vec<FrameRecord>,
    lines: Vec<Line>,
}

impl Log {
    /// Reconstructs the frames from the records of the bus model.
    pub(crate) fn new(records: &[Record], bit_time: SimDuration) -> Self {
        let mut log = Self {
            frames: Vec::new(),
            lines: Vec::new(),
        };
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
                    log.end(frame, start, record.at, true);
                    log.lines.push(Line {
                        at: record.at,
                        interface: "can0".into(),
                        frame,
                    });
                }
                RecordKind::Error {
                    transmitter: true, ..
                } => {
                    let frame = sent_by(records, record);
                    if let (Some(start), Some(frame)) = (begun.remove(&record.node), frame) {
                        let end = record.at + bit_time * ERROR_FRAME_BITS;
                        log.end(frame, start, end, false);
                    }
                }
                RecordKind::Error { .. } | RecordKind::StateChange { .. } => {}
            }
        }
        log.frames.sort_by_key(|frame| frame.start);
        log
    }

    /// The report handles frames with 11-bit identifiers only, like the network.
    fn end(&mut self, frame: Frame, start: SimTime, end: SimTime, complete: bool) {
        let Id::Standard(id) = frame.id() else {
            return;
        };
        let mut data = [0; 8];
        for (byte, value) in data.iter_mut().zip(frame.data()) {
            *byte = *value;
        }
        self.frames.push(FrameRecord {
            id: id.as_raw(),
            dlc: frame.dlc().min(8),
            data,
            start,
            end,
            complete,
        });
    }

    /// The complete frames in the format of `candump -l`, stamped at end of frame.
    pub(crate) fn candump(&self) -> String {
        let mut text = String::new();
        for line in &self.lines {
            // Writing to a string cannot fail.
            let _ = writeln!(text, "{line}");
        }
        text
    }
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

        let lines: Vec<Line> = log.candump().lines().map(|l| l.parse().unwrap()).collect();
        assert_eq!(lines.len(), 3);
        assert_eq!(lines[1].frame, high);
        // The stamp is the end of frame, cut to whole microseconds.
        let end = log.frames[1].end.as_ticks();
        assert_eq!(lines[1].at.as_ticks(), end - end % 1_000_000);
    }
}
