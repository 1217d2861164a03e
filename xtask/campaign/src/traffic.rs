//! The frames that the nodes sent, and whether each was in its window.

use can_bus::wire::WireFrame;
use can_bus::{NodeId, Record, RecordKind, SimDuration, SimTime};
use embedded_can::Id;
use network_model::{Message, Network, Window, WindowKind};
use twin::{Outcome, Twin};
use vehicle_model::{NodeIndex, Vehicle};

/// A frame on the bus, from its start to its end or to the error that ended it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sent {
    /// The node of the vehicle that sent it; `None` for foreign nodes.
    pub node: Option<NodeIndex>,
    /// Identifier, 11 bits.
    pub id: u16,
    /// Data bytes.
    pub data: Vec<u8>,
    /// Start of frame.
    pub start: SimTime,
    /// End of the last bit of end of frame; the instant of the error of a frame that was
    /// destroyed.
    pub end: SimTime,
    /// Whether it was sent to its end, as far as its receivers see it.
    pub complete: bool,
}

impl Sent {
    /// Its data as those of an 8-byte message, missing bytes zero.
    #[must_use]
    pub fn bytes(&self) -> [u8; 8] {
        let mut bytes = [0; 8];
        for (to, from) in bytes.iter_mut().zip(&self.data) {
            *to = *from;
        }
        bytes
    }
}

/// A frame of which the end is not known yet.
struct Begun {
    node: NodeId,
    /// Its place among the frames.
    index: usize,
    /// Its length.
    bits: usize,
}

/// The frames of a run in order of their starts. Frames that lost arbitration are left out.
#[derive(Clone, Debug, Default)]
pub struct Traffic {
    /// The frames.
    pub frames: Vec<Sent>,
}

impl Traffic {
    /// The frames of a finished run.
    #[must_use]
    pub fn of(outcome: &Outcome) -> Self {
        Self::new(&outcome.records, |id| outcome.node_at(id))
    }

    /// The frames of a running vehicle so far.
    #[must_use]
    pub fn so_far(twin: &Twin) -> Self {
        Self::new(twin.records(), |id| twin.node_at(id))
    }

    /// The frames in `records`; `node_at` names the nodes of the vehicle. Frames with extended
    /// identifiers are left out: the network has none.
    ///
    /// Receivers take a frame before its last bit, its sender behind it (CAN specification 2.0,
    /// "Message validation"). An error that the sender finds in that bit is none to them, and they have
    /// the frame.
    ///
    /// A sender that a reset stops within the end of its frame, all of whose bits are recessive, leaves
    /// a frame that the receivers take. Its end is not recorded, and is its start here.
    #[must_use]
    pub fn new(records: &[Record], node_at: impl Fn(NodeId) -> Option<NodeIndex>) -> Self {
        let mut frames: Vec<Sent> = Vec::new();
        let mut begun: Vec<Begun> = Vec::new();
        // From this time on nobody has found an error.
        let mut sound = SimTime::from_ticks(0);
        for record in records {
            if let RecordKind::FrameStart { .. } = record.kind {
                begun.retain(|begun| {
                    let frame = &mut frames[begun.index];
                    let simultaneous = frame.start == record.at;
                    frame.complete = !simultaneous && frame.start >= sound;
                    simultaneous
                });
            }
            let open = begun.iter().position(|begun| begun.node == record.node);
            match record.kind {
                RecordKind::FrameStart { frame } => {
                    let Id::Standard(id) = frame.id() else {
                        continue;
                    };
                    begun.push(Begun {
                        node: record.node,
                        index: frames.len(),
                        bits: WireFrame::encode(&frame).bits(),
                    });
                    frames.push(Sent {
                        node: node_at(record.node),
                        id: id.as_raw(),
                        data: frame.data().to_vec(),
                        start: record.at,
                        end: record.at,
                        complete: false,
                    });
                }
                RecordKind::FrameEnd { .. } => {
                    if let Some(open) = open {
                        let Begun { index, .. } = begun.swap_remove(open);
                        frames[index].end = record.at;
                        frames[index].complete = true;
                    }
                }
                RecordKind::ArbitrationLost { .. } => {
                    if let Some(open) = open {
                        let Begun { index, .. } = begun.swap_remove(open);
                        // Length zero marks it for removal; removing it now would shift the indices.
                        frames[index].data.clear();
                        frames[index].id = u16::MAX;
                    }
                }
                RecordKind::Error {
                    transmitter, bit, ..
                } => {
                    sound = record.at;
                    if let Some(open) = open.filter(|_| transmitter) {
                        let Begun { index, bits, .. } = begun.swap_remove(open);
                        frames[index].end = record.at;
                        frames[index].complete = usize::from(bit) + 1 >= bits;
                    }
                }
                RecordKind::StateChange { .. } => {}
            }
        }
        frames.retain(|frame| frame.id != u16::MAX);
        Self { frames }
    }

    /// Complete frames of this identifier that nodes of the vehicle sent.
    pub fn genuine(&self, id: u16) -> impl Iterator<Item = &Sent> {
        self.frames
            .iter()
            .filter(move |frame| frame.complete && frame.id == id && frame.node.is_some())
    }

    /// [`Traffic::genuine`] with starts from `from` (included) to `until`.
    pub fn between(&self, id: u16, from: SimTime, until: SimTime) -> impl Iterator<Item = &Sent> {
        self.genuine(id)
            .filter(move |frame| (from..until).contains(&frame.start))
    }
}

/// The system matrix of the network file.
#[derive(Clone, Debug)]
pub struct Matrix {
    network: Network,
    /// Names of the vehicle's nodes, by their places.
    nodes: Vec<String>,
    /// Their internal oscillators, if those are known.
    oscillators: Vec<Option<Oscillator>>,
}

/// The error of an internal oscillator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Oscillator {
    /// At the instant `at`, parts per million; positive when it is fast.
    pub ppm: f64,
    /// The instant.
    pub at: SimTime,
    /// How the error changes, parts per million each second.
    pub drift: f64,
}

impl Oscillator {
    /// How much of its own time passes in a unit of true time.
    fn rate(&self, at: SimTime) -> f64 {
        let later = (at.as_ticks() as f64 - self.at.as_ticks() as f64) * 1e-12;
        1.0 + (self.ppm + self.drift * later) * 1e-6
    }
}

/// The begin of a basic cycle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Begin {
    /// Start of frame of its reference message.
    pub start: SimTime,
    /// How much of the time master's time passes in a unit of true time.
    pub rate: f64,
}

impl Begin {
    /// Time from this begin to an instant, picoseconds: the least and the most of what nodes may
    /// count. A node counts in the master's time when it has measured its rate, and in its own, nearly
    /// true time before that.
    fn until(&self, at: SimTime) -> (i64, i64) {
        let own = at.as_ticks() as i64 - self.start.as_ticks() as i64;
        let masters = (own as f64 * self.rate).round() as i64;
        (own.min(masters), own.max(masters))
    }
}

/// Signal of a reference message: its sender has no external clock, and leads as the last resort.
const INTERNAL_CLOCK: &str = "InternalClock";

/// Longest time between two frames, in bits, of which the second one waited for the first: the
/// intermission, and a bit for the senders' clocks.
const WAITED: u64 = 4;

/// A frame outside of its window.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misplaced {
    /// The frame.
    pub frame: Sent,
    /// The node that sent it.
    pub node: String,
    /// Its start after the start of the reference message before it, microseconds; `None`
    /// when there was no reference before it.
    pub offset_us: Option<i64>,
}

impl std::fmt::Display for Misplaced {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let node = &self.node;
        let at = self.frame.start.as_ticks() as f64 / 1e9;
        write!(f, "{node} began frame {} at {at:.3} ms, ", self.frame.id)?;
        match self.offset_us {
            Some(offset) => write!(f, "{offset} us after the reference"),
            None => f.write_str("before any reference"),
        }
    }
}

impl Matrix {
    /// The matrix of a vehicle.
    #[must_use]
    pub fn new(vehicle: &Vehicle) -> Self {
        let nodes = vehicle.manifest().nodes.iter();
        Self {
            network: vehicle.network().clone(),
            oscillators: vec![None; nodes.len()],
            nodes: nodes.map(|node| node.name.clone()).collect(),
        }
    }

    /// Tells the internal oscillator of a node. In basic cycles that it begins as the last resort, all
    /// nodes follow the time of that oscillator.
    pub fn set_oscillator(&mut self, node: NodeIndex, oscillator: Oscillator) {
        self.oscillators[node.0] = Some(oscillator);
    }

    /// Name of the node that sent a frame.
    fn name(&self, frame: &Sent) -> Option<&str> {
        Some(self.nodes.get(frame.node?.0)?.as_str())
    }

    /// The place of the node that sends a message.
    #[must_use]
    pub fn sender(&self, message: &Message) -> Option<NodeIndex> {
        let mut nodes = self.nodes.iter();
        nodes
            .position(|name| *name == message.sender)
            .map(NodeIndex)
    }

    /// Length of the basic cycle.
    #[must_use]
    pub fn basic_cycle(&self) -> SimDuration {
        micros(self.network.basic_cycle_us)
    }

    /// All messages, in the order of their windows.
    #[must_use]
    pub fn messages(&self) -> &[Message] {
        &self.network.messages
    }

    /// Whether frames with this identifier are reference messages.
    #[must_use]
    pub fn is_reference(&self, id: u16) -> bool {
        self.kind(id) == Some(WindowKind::Reference)
    }

    fn kind(&self, id: u16) -> Option<WindowKind> {
        self.network.message(id).map(|message| message.window.kind)
    }

    /// The basic cycles that the vehicle's masters began by complete reference messages.
    ///
    /// A reference directly behind that of a better master is left out: no node follows it. It
    /// waited in its controller until the other one was sent, and the intermission is too short for
    /// a node to take it back.
    #[must_use]
    pub fn references(&self, traffic: &Traffic) -> Vec<Begin> {
        let ours = traffic.frames.iter().filter(|frame| frame.node.is_some());
        let mut begins = Vec::new();
        let mut before: Option<&Sent> = None;
        for frame in ours.filter(|frame| frame.complete && self.is_reference(frame.id)) {
            let waited = before.is_some_and(|before| {
                let idle = frame.start.as_ticks().saturating_sub(before.end.as_ticks());
                frame.id > before.id && idle <= self.bits(WAITED).as_ticks()
            });
            if !waited {
                begins.push(Begin {
                    start: frame.start,
                    rate: self.rate(frame),
                });
                before = Some(frame);
            }
        }
        begins
    }

    /// The rate of the master that sent a reference.
    fn rate(&self, reference: &Sent) -> f64 {
        let oscillator = reference.node.and_then(|node| self.oscillators[node.0]);
        let oscillator = oscillator.filter(|_| self.says(reference, INTERNAL_CLOCK));
        oscillator.map_or(1.0, |oscillator| oscillator.rate(reference.start))
    }

    /// Whether a frame has a signal of one bit, and that is set.
    fn says(&self, frame: &Sent, signal: &str) -> bool {
        let message = self.network.message(frame.id);
        let mut signals = message.iter().flat_map(|message| &message.signals);
        let signal = signals.find(|one| one.name == signal);
        signal.is_some_and(|signal| signal.extract(&frame.bytes()) == 1)
    }

    /// How long this number of bits takes.
    fn bits(&self, count: u64) -> SimDuration {
        SimDuration::from_ticks(count * 1_000_000_000_000 / u64::from(self.network.bit_rate))
    }

    /// How long after the beginning of its window a frame started, in picoseconds, negative
    /// when early; by the last of `references` before it. `None` before the first reference.
    #[must_use]
    pub fn lateness(&self, frame: &Sent, references: &[Begin]) -> Option<i64> {
        let (_, offset) = offset(frame.start, references)?;
        let message = self.network.message(frame.id)?;
        Some(offset - micros(message.window.start_us).as_ticks() as i64)
    }

    /// Frames of the vehicle's own nodes that began outside of their window, ended behind it,
    /// or that the matrix does not know. References have no window but make them.
    #[must_use]
    pub fn misplaced(&self, traffic: &Traffic) -> Vec<Misplaced> {
        let references = self.references(traffic);
        let ours = traffic.frames.iter().filter(|frame| frame.node.is_some());
        ours.filter(|frame| !self.in_place(frame, &references))
            .map(|frame| Misplaced {
                node: self.name(frame).unwrap_or("a foreign node").to_owned(),
                frame: frame.clone(),
                offset_us: offset(frame.start, &references).map(|(_, ps)| ps / 1_000_000),
            })
            .collect()
    }

    pub(crate) fn in_place(&self, frame: &Sent, references: &[Begin]) -> bool {
        let Some(message) = self.network.message(frame.id) else {
            return false;
        };
        if self.name(frame) != Some(message.sender.as_str()) {
            return false;
        }
        if message.window.kind == WindowKind::Reference {
            return true;
        }
        let Some((least, most)) = offset(frame.start, references) else {
            return false;
        };
        let length = frame.end.as_ticks() - frame.start.as_ticks();
        let tick = |us: u32| i64::from(us) * 1_000_000;
        // The matrix grants each node the clock error that it was laid out for.
        let fits = |window: &Window| {
            most >= tick(window.start_us) - tick(self.network.sync_uncertainty_us)
                && least + length as i64 <= tick(window.end_us())
        };
        let late = || {
            let windows = self.network.windows();
            let mut windows = windows.iter();
            windows.any(|window| window.kind == WindowKind::Arbitrating && fits(window))
        };
        fits(&message.window) || (message.retry_late && late())
    }
}

/// From the last reference before `start`, as [`Begin::until`].
fn offset(start: SimTime, references: &[Begin]) -> Option<(i64, i64)> {
    let before = references.partition_point(|reference| reference.start <= start);
    let last = references.get(before.checked_sub(1)?)?;
    Some(last.until(start))
}

fn micros(us: u32) -> SimDuration {
    SimDuration::from_ticks(u64::from(us) * 1_000_000)
}

#[cfg(test)]
mod tests {
    use super::*;

    const GPS: NodeIndex = NodeIndex(0);
    const CONTROLLER: NodeIndex = NodeIndex(1);
    const DRIVE: NodeIndex = NodeIndex(3);

    fn frame(node: NodeIndex, id: u16, us: u64) -> Sent {
        Sent {
            node: Some(node),
            id,
            data: vec![0; 8],
            start: SimTime::from_ticks(us * 1_000_000),
            end: SimTime::from_ticks((us + 500) * 1_000_000),
            complete: true,
        }
    }

    /// A reset within the end of frame, which the receivers do not notice, and one before it, which they
    /// do.
    #[test]
    fn a_frame_whose_sender_is_reset_is_complete_if_nobody_finds_an_error() {
        let mut bus = can_bus::Bus::new();
        let nodes = [(); 2].map(|()| bus.add_tester(can_bus::Tester::new()));
        let id = |id| embedded_can::StandardId::new(id).unwrap();
        let start = |node: usize, id_raw, us: u64| Record {
            at: SimTime::from_ticks(us * 1_000_000),
            node: nodes[node],
            kind: RecordKind::FrameStart {
                frame: can_bus::Frame::new_data(id(id_raw), &[]).unwrap(),
            },
        };
        let error = Record {
            at: SimTime::from_ticks(80 * 1_000_000),
            node: nodes[1],
            kind: RecordKind::Error {
                kind: can_bus::ErrorKind::Stuff,
                bit: 40,
                transmitter: false,
            },
        };
        let complete = |records: &[Record]| {
            let frames = Traffic::new(records, |_| Some(GPS)).frames;
            frames
                .iter()
                .map(|frame| frame.complete)
                .collect::<Vec<_>>()
        };
        // Both begin at 300 us; neither has ended.
        let behind = [start(1, 200, 300), start(0, 201, 300)];
        let unnoticed = [&[start(0, 100, 50)], &behind[..]].concat();
        assert_eq!(complete(&unnoticed), [true, false, false]);
        let noticed = [&[start(0, 100, 50), error], &behind[..]].concat();
        assert_eq!(complete(&noticed), [false, false, false]);
    }

    /// Error flags that reach the sender in the bit before the last one, and in the last one.
    #[test]
    fn a_frame_is_complete_for_its_receivers_before_its_last_bit() {
        let mut bus = can_bus::Bus::new();
        let sender = bus.add_tester(can_bus::Tester::new());
        let id = embedded_can::StandardId::new(100).unwrap();
        let frame = can_bus::Frame::new_data(id, &[2, 0, 0, 5, 137, 2, 218, 26]).unwrap();
        // The emulated nodes took this one, of 116 bits.
        let complete = |bit| {
            let record = |us: u64, kind| Record {
                at: SimTime::from_ticks(us * 1_000_000),
                node: sender,
                kind,
            };
            let error = RecordKind::Error {
                kind: can_bus::ErrorKind::BitRecessive,
                bit,
                transmitter: true,
            };
            let records = [
                record(100, RecordKind::FrameStart { frame }),
                record(330, error),
            ];
            let frames = Traffic::new(&records, |_| Some(GPS)).frames;
            (frames[0].complete, frames[0].end)
        };
        let end = SimTime::from_ticks(330_000_000);
        assert_eq!(complete(114), (false, end));
        assert_eq!(complete(115), (true, end));
    }

    #[test]
    fn a_frame_is_judged_by_the_reference_before_it() {
        let place = |frame| {
            let frames = vec![self::frame(GPS, 100, 50_000), frame];
            Matrix::new(&crate::uagv()).misplaced(&Traffic { frames })
        };
        assert_eq!(place(frame(CONTROLLER, 300, 57_004)), []);
        assert_eq!(place(frame(CONTROLLER, 300, 56_990)), []);
        for wrong in [
            frame(CONTROLLER, 300, 56_970),
            frame(CONTROLLER, 300, 57_501),
            frame(CONTROLLER, 300, 157_000),
            frame(DRIVE, 300, 57_004),
            frame(CONTROLLER, 299, 57_004),
            frame(CONTROLLER, 300, 40_000),
        ] {
            let found = place(wrong.clone());
            assert_eq!(found.len(), 1, "{wrong:?}");
            assert_eq!(found[0].frame, wrong);
        }
    }

    /// Both masters had a reference in their controllers while the bus was disturbed.
    #[test]
    fn a_reference_that_waited_for_a_better_one_begins_no_cycle() {
        let begun = |frames: Vec<Sent>| {
            let begins = Matrix::new(&crate::uagv()).references(&Traffic { frames });
            begins
                .iter()
                .map(|begin| begin.start.as_ticks() / 1_000_000)
                .collect::<Vec<_>>()
        };
        let backup = |us| frame(CONTROLLER, 101, us);
        assert_eq!(
            begun(vec![frame(GPS, 100, 50_000), backup(50_512)]),
            [50_000]
        );
        let later = vec![frame(GPS, 100, 50_000), backup(50_520)];
        assert_eq!(begun(later), [50_000, 50_520]);
        let better = vec![backup(50_000), frame(GPS, 100, 50_512)];
        assert_eq!(begun(better), [50_000, 50_512]);
    }

    /// The last window is 88 ms behind the reference, and may be used 20 us too early.
    #[test]
    fn a_node_that_measured_another_rate_is_in_its_window_by_that() {
        let matrix = Matrix::new(&crate::uagv());
        let in_place = |us: u64, rate: f64| {
            let start = SimTime::from_ticks(50_000 * 1_000_000);
            matrix.in_place(&frame(DRIVE, 208, 50_000 + us), &[Begin { start, rate }])
        };
        assert!(!in_place(87_979, 1.0));
        assert!(in_place(87_979, 1.0 + 200e-6));
        assert!(!in_place(87_979, 1.0 - 200e-6));
        assert!(!in_place(87_961, 1.0 + 200e-6));
    }

    /// A last resort whose oscillator is 2 % fast sends its second window 40 us early, and so do the
    /// nodes that have measured its rate; the others send in true time.
    #[test]
    fn the_windows_of_a_last_resort_are_in_its_own_time() {
        let misplaced = |ppm, flags, node, id, us| {
            let mut matrix = Matrix::new(&crate::uagv());
            let at = SimTime::from_ticks(0);
            let drift = 0.0;
            matrix.set_oscillator(GPS, Oscillator { ppm, at, drift });
            let mut reference = frame(GPS, 100, 50_000);
            reference.data[0] = flags;
            let frames = vec![reference, frame(node, id, us)];
            !matrix.misplaced(&Traffic { frames }).is_empty()
        };
        let last_resort = 2;
        assert!(!misplaced(20_000.0, last_resort, GPS, 402, 51_961));
        assert!(misplaced(20_000.0, last_resort, GPS, 402, 51_900));
        // With its external clock it has no such excuse.
        assert!(misplaced(20_000.0, 0, GPS, 402, 51_961));
        assert!(!misplaced(-16_000.0, last_resort, CONTROLLER, 300, 57_002));
        assert!(!misplaced(-16_000.0, last_resort, CONTROLLER, 300, 57_114));
        assert!(misplaced(-16_000.0, last_resort, CONTROLLER, 300, 56_960));
    }
}
