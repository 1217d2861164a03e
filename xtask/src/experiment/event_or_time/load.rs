//! Foreign nodes that load a bus.

use std::collections::VecDeque;

use can_bus::{Frame, NodeId, RecordKind, Retry, SimDuration, SimTime, Tester};
use embedded_can::Id;
use network_model::{Network, WindowKind};
use schedulability::foreign::{self, Foreign};
use twin::{Twin, TwinError};
use world::random::{Purpose, Stream};

/// How foreign nodes use the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Manner {
    /// Each sends a frame as soon as it is put, and repeats it until it is sent.
    AtOnce,
    /// They send in windows of their own, in each the frame that has waited longest; a newer frame of a
    /// message replaces one that still waits.
    BySchedule,
}

/// Their identifiers: the first is more urgent than every message of the row follower but the
/// reference, the second and the third lie between its distances and its command and between that and
/// its log, the last is less urgent than all.
pub(super) const IDS: [u16; 4] = [150, 250, 350, 600];
/// Data bytes of their frames.
const LENGTH: u8 = 8;
/// Mean number of bits of such a frame with random data: 111 without stuffing, interframe space
/// included, and the stuff bits.
const MEAN_BITS: f64 = 114.0;
/// Their frames are put up to this share of their period late.
const JITTER: f64 = 0.5;

/// The messages that together take this share of a bus.
pub(super) fn messages(percent: u32, bit_rate: u32) -> Vec<Foreign> {
    if percent == 0 {
        return Vec::new();
    }
    let frame_us = MEAN_BITS * 1e6 / f64::from(bit_rate);
    let period = frame_us * IDS.len() as f64 * 100.0 / f64::from(percent);
    let of = |id| Foreign {
        id,
        length: LENGTH,
        period_us: period as u32,
        jitter_us: (period * JITTER) as u32,
    };
    IDS.map(of).to_vec()
}

/// A frame that a foreign node puts.
#[derive(Clone, Copy, Debug)]
struct Put {
    at: SimTime,
    frame: Frame,
}

/// The frames of one message.
#[derive(Debug)]
struct Source {
    puts: VecDeque<Put>,
    /// The frame that waits for a window.
    waiting: Option<Put>,
    /// The node that sends them.
    node: NodeId,
}

/// The foreign nodes on the bus of a run.
#[derive(Debug)]
pub(super) struct Load {
    manner: Manner,
    sources: Vec<Source>,
    /// The identifier of the reference message.
    reference: Option<u16>,
    /// When the windows of the foreign nodes begin in a basic cycle.
    windows: Vec<SimDuration>,
    /// Records of the bus that have been looked at.
    seen: usize,
    /// Frames that were put.
    pub(super) offered: usize,
}

const fn micros(us: u64) -> SimDuration {
    SimDuration::from_ticks(us * 1_000_000)
}

impl Load {
    /// Foreign nodes that put these messages from `from` to `until`. The instants come from the seed:
    /// a random phase, and a random lateness of each frame.
    pub(super) fn new(
        twin: &mut Twin,
        network: &Network,
        manner: Manner,
        messages: &[Foreign],
        (from, until): (SimTime, SimTime),
        seed: u64,
    ) -> Self {
        let mut random = Stream::new(seed, Purpose::ForeignFrames);
        let mut offered = 0;
        let mut sources = Vec::new();
        for message in messages {
            let tester = Tester::new().at_bit_rate(network.bit_rate);
            let bus = &mut twin.network().bus();
            let node = bus.add_tester(tester);
            let mut puts = VecDeque::new();
            let period = u64::from(message.period_us) * 1_000_000;
            let mut nominal = from.as_ticks() + (random.uniform() * period as f64) as u64;
            while nominal < until.as_ticks() {
                let late = random.uniform() * f64::from(message.jitter_us) * 1e6;
                let mut data = random.bits().to_le_bytes();
                data[0] = random.byte();
                if let Some(frame) =
                    Frame::standard(message.id, &data[..usize::from(message.length)])
                {
                    let at = SimTime::from_ticks(nominal + late as u64);
                    puts.push_back(Put { at, frame });
                }
                nominal += period;
            }
            offered += puts.len();
            if manner == Manner::AtOnce {
                for put in puts.drain(..) {
                    bus.send_at(node, put.at, put.frame, Retry::UntilSent);
                }
            }
            sources.push(Source {
                puts,
                waiting: None,
                node,
            });
        }
        let mut all = network.messages.iter();
        let reference = all.find(|message| message.window.kind == WindowKind::Reference);
        let windows = foreign::windows(network, LENGTH);
        let begins = windows.iter().map(|window| micros(window.start_us.into()));
        Self {
            manner,
            sources,
            reference: reference.map(|message| message.id),
            windows: begins.collect(),
            seen: 0,
            offered,
        }
    }

    /// The foreign nodes.
    pub(super) fn nodes(&self) -> Vec<NodeId> {
        self.sources.iter().map(|source| source.node).collect()
    }

    /// Runs the vehicle and its foreign nodes up to `end`.
    ///
    /// # Errors
    /// As [`Twin::run_until`].
    pub(super) fn run(&mut self, twin: &mut Twin, end: SimTime) -> Result<(), TwinError> {
        while twin.now() < end {
            // The first of the windows begins more than a millisecond behind the reference.
            let next = end.min(twin.now() + micros(1000));
            twin.run_until(next)?;
            if self.manner == Manner::BySchedule {
                self.fill(twin);
            }
        }
        Ok(())
    }

    /// Sends in the windows of each basic cycle whose reference has come.
    fn fill(&mut self, twin: &mut Twin) {
        let mut begins = Vec::new();
        for record in twin.records().iter().skip(self.seen) {
            if let RecordKind::FrameEnd { frame, start, .. } = record.kind
                && let Id::Standard(id) = frame.id()
                && Some(id.as_raw()) == self.reference
            {
                begins.push(start);
            }
        }
        self.seen = twin.records().len();
        for begin in begins {
            for window in self.windows.clone() {
                let at = begin + window;
                if let Some((node, frame)) = self.next(at) {
                    let mut bus = twin.network().bus();
                    bus.send_at(node, at, frame, Retry::Once);
                }
            }
        }
    }

    /// The frame that has waited longest at this instant, and its node.
    fn next(&mut self, at: SimTime) -> Option<(NodeId, Frame)> {
        for source in &mut self.sources {
            let due = source.puts.partition_point(|put| put.at <= at);
            let newest = source.puts.drain(..due).next_back();
            source.waiting = newest.or(source.waiting);
        }
        let waiting = self.sources.iter_mut();
        let waiting = waiting.filter(|source| source.waiting.is_some());
        let first = waiting.min_by_key(|source| source.waiting.map(|put| put.at))?;
        let put = first.waiting.take()?;
        Some((first.node, put.frame))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_messages_take_their_share_of_the_bus() {
        for (percent, bit_rate) in [(20, 500_000), (80, 500_000), (60, 250_000)] {
            let all = messages(percent, bit_rate);
            assert_eq!(all.len(), IDS.len());
            let frame_us = MEAN_BITS * 1e6 / f64::from(bit_rate);
            let share = |one: &Foreign| 100.0 * frame_us / f64::from(one.period_us);
            let all: f64 = all.iter().map(share).sum();
            assert!((all - f64::from(percent)).abs() < 0.1, "{all}");
        }
        assert!(messages(0, 500_000).is_empty());
    }
}
