//! The frames against the schedule: when each message came in its window, which windows stayed
//! empty, and which frames were in a window of somebody else.
//!
//! A basic cycle begins with the start of frame of its reference message and lasts until the next
//! one, but at most one and a half basic cycles, as in the report of a simulated run
//! (`world::report`). A log may have lost a reference that the nodes have heard: frames behind it are
//! placed from where it was due. Nothing is judged until two references are as far apart as the schedule
//! says: what waited in a queue of the adapter is stamped when it is read. Loggers stamp the end of a frame; its start is that less its length in bits.

use std::collections::BTreeMap;

use can_bus::Frame;
use embedded_can::Id;
use vehicle_model::Vehicle;
use world::report::{Due, Window, WindowKind};

use super::{
    figures::{ForeignFigures, ScheduleFigures, WindowFigures, rounded},
    series::Spread,
};
use crate::network::decode::Decoder;
use crate::network::matrix::{Matrix, are_in_order};

/// An identifier of 11 or 29 bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Identifier {
    extended: bool,
    raw: u32,
}

impl Identifier {
    fn of(frame: &Frame) -> Self {
        match frame.id() {
            Id::Standard(id) => Self {
                extended: false,
                raw: u32::from(id.as_raw()),
            },
            Id::Extended(id) => Self {
                extended: true,
                raw: id.as_raw(),
            },
        }
    }

    /// Whether it is the one of 11 bits.
    fn is(self, id: u16) -> bool {
        !self.extended && self.raw == u32::from(id)
    }
}

/// A window and the statistics of its frames.
struct Slot {
    window: Window,
    /// Beginning and length, ns.
    start: i64,
    length: i64,
    /// How far beside its window a frame may begin by its stamp, ns.
    tolerance: i64,
    /// Starts of frame after its beginning, ns.
    starts: Spread,
    /// Basic cycles in which it stayed empty although its message was due and had come before.
    missed: u64,
    /// Since when it stays empty, ns, and for how many of these cycles.
    empty: Option<(i64, u64)>,
    /// How many were empty in a row and may be.
    spared: u16,
}

impl Slot {
    fn new(window: Window, tolerance: i64) -> Self {
        let ns = |span: world::SimDuration| (span.as_ticks() / 1000) as i64;
        Self {
            start: ns(window.start),
            length: ns(window.length),
            tolerance,
            window,
            starts: Spread::default(),
            missed: 0,
            empty: None,
            spared: 0,
        }
    }

    /// Whether it comes in the basic cycle of that number.
    fn comes(&self, count: u8) -> bool {
        count % self.window.repeat.max(1) == self.window.offset
    }

    /// How long after its beginning a start of frame is, if the frame belongs to it; one that is
    /// early by up to half the window is an early frame of it.
    fn own(&self, count: u8, id: Identifier, offset: i64) -> Option<i64> {
        let after = offset - self.start;
        let early = (self.length / 2).max(self.tolerance);
        let inside = after >= -early && after < self.length + self.tolerance;
        (id.is(self.window.id) && inside && self.comes(count)).then_some(after)
    }

    /// Whether an instant of the basic cycle is in it.
    fn holds(&self, count: u8, offset: i64) -> bool {
        self.comes(count) && (self.start..self.start + self.length).contains(&offset)
    }
}

/// A basic cycle so far.
struct Cycle {
    /// Start of frame of its reference, or where it was due.
    start: i64,
    /// Whether its reference is not in the log.
    lost: bool,
    count: u8,
    fixed: bool,
    /// Starts of frame of the others, ns after the reference's.
    frames: Vec<(i64, Identifier)>,
}

impl Cycle {
    /// How long it lasts at the longest.
    fn longest(&self, basic_cycle: i64) -> i64 {
        if self.lost {
            basic_cycle
        } else {
            longest(basic_cycle)
        }
    }
}

/// A deviation of the references from the schedule.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Irregularity {
    /// References are missing: when the last one came, and how many.
    MissingReferences(i64, u64),
    /// Another master leads: when its first reference came, and the identifier.
    Master(i64, u16),
    /// The windows of a message stayed empty: since when, its identifier, and how many.
    Empty(i64, u16, u64),
    /// The first frame in a window of another message: when it began, its identifier, whether that has 29 bits,
    /// and the message of the window.
    Misplaced(i64, u32, bool, Option<String>),
}

/// Most irregularities that are kept; a bus in trouble may have millions.
const MOST: usize = 100_000;

/// Where a frame was that was in none of its windows: its identifier, and the beginning of the
/// window it was in, if it was in one.
type Place = (Identifier, Option<i64>);

/// Compares the frames with the schedule.
pub(super) struct Timing {
    slots: Vec<Slot>,
    tolerance: i64,
    references: Vec<u16>,
    count_byte: usize,
    basic_cycle: i64,
    cycle: Option<Cycle>,
    /// Start of the last reference.
    reference: Option<i64>,
    /// References since the log began or was interrupted, and whether two of them were in order.
    references_so_far: u64,
    in_order: bool,
    /// Basic cycles that are judged as soon as the references are in order, with their ends.
    held: Vec<(Cycle, i64)>,
    master: Option<u16>,
    cycles: u64,
    missing: u64,
    /// Between two references without a missing one, ns.
    periods: Spread,
    misplaced: BTreeMap<Place, u64>,
    without_reference: u64,
    irregularities: Vec<Irregularity>,
}

impl Timing {
    /// The schedule of a vehicle; `None` if its nodes send at once.
    /// Stamps may be beside the truth by the tolerance, ns.
    pub(super) fn new(vehicle: &Vehicle, tolerance: i64) -> Option<Self> {
        let matrix = Matrix::new(vehicle);
        let of_kind = |kind| {
            matrix
                .windows
                .iter()
                .filter(move |window| window.kind == kind)
        };
        let references: Vec<u16> = of_kind(WindowKind::Reference)
            .map(|window| window.id)
            .collect();
        if references.is_empty() {
            return None;
        }
        let network = vehicle.network();
        let others = matrix
            .windows
            .iter()
            .filter(|one| one.kind != WindowKind::Reference);
        let mut slots: Vec<Slot> = others
            .cloned()
            .map(|window| Slot::new(window, tolerance))
            .collect();
        slots.sort_by_key(|slot| (slot.start, slot.window.offset, slot.window.id));
        Some(Self {
            slots,
            tolerance,
            references,
            count_byte: matrix.cycle_count_byte(),
            basic_cycle: i64::from(network.basic_cycle_us) * 1000,
            cycle: None,
            reference: None,
            references_so_far: 0,
            in_order: false,
            held: Vec::new(),
            master: None,
            cycles: 0,
            missing: 0,
            periods: Spread::default(),
            misplaced: BTreeMap::new(),
            without_reference: 0,
            irregularities: Vec::new(),
        })
    }

    /// Takes the next data frame, which begins at `start`.
    pub(super) fn take(&mut self, start: i64, frame: &Frame) {
        let id = Identifier::of(frame);
        let mut references = self.references.iter();
        if let Some(&reference) = references.find(|one| id.is(**one)) {
            self.begin(start, reference, frame);
            return;
        }
        self.go_on_without(start);
        match &mut self.cycle {
            Some(cycle)
                if (0..cycle.longest(self.basic_cycle)).contains(&(start - cycle.start)) =>
            {
                cycle.frames.push((start - cycle.start, id));
            }
            _ => self.without_reference += 1,
        }
    }

    /// A frame behind the end of a basic cycle begins: the reference of the next one, which comes first, is
    /// not in the log. The schedule goes on for one cycle; if there is none behind it either, nobody
    /// leads.
    fn go_on_without(&mut self, start: i64) {
        let Some(cycle) = self.cycle.as_ref().filter(|cycle| !cycle.lost) else {
            return;
        };
        let due = cycle.start.saturating_add(self.basic_cycle);
        if !(due..due.saturating_add(self.basic_cycle)).contains(&start) {
            return;
        }
        let (count, fixed) = (cycle.count.wrapping_add(1) & 0x3F, cycle.fixed);
        self.close(due);
        self.cycle = Some(Cycle {
            start: due,
            lost: true,
            count,
            fixed,
            frames: Vec::new(),
        });
    }

    /// A basic cycle begins.
    fn begin(&mut self, start: i64, id: u16, frame: &Frame) {
        self.references_so_far += 1;
        if let Some(before) = self.reference
            && self.order(start - before)
        {
            let period = start - before;
            if period < longest(self.basic_cycle) {
                self.periods.add(period as f64);
            } else {
                let missing = (period + self.basic_cycle / 2) / self.basic_cycle - 1;
                let missing = u64::try_from(missing).unwrap_or(0);
                self.missing += missing;
                self.note(Irregularity::MissingReferences(before, missing));
            }
        }
        self.reference = Some(start);
        self.close(start);
        if self.master.is_some_and(|master| master != id) {
            self.note(Irregularity::Master(start, id));
        }
        self.master = Some(id);
        self.cycles += 1;
        let data = frame.data();
        let count = data.get(self.count_byte).map_or(0, |byte| byte & 0x3F);
        let fixed = data.first().is_some_and(|byte| byte & 1 == 1);
        let mut frames = self
            .cycle
            .take()
            .map_or_else(Vec::new, |cycle| cycle.frames);
        frames.clear();
        self.cycle = Some(Cycle {
            start,
            lost: false,
            count,
            fixed,
            frames,
        });
    }

    fn note(&mut self, what: Irregularity) {
        if self.irregularities.len() < MOST {
            self.irregularities.push(what);
        }
    }

    /// Notes the windows that have stayed empty, of those that are `over`.
    fn note_empty(&mut self, over: impl Fn(&Slot) -> bool) {
        for at in 0..self.slots.len() {
            let slot = &mut self.slots[at];
            if over(slot)
                && let Some((since, windows)) = slot.empty.take()
            {
                let id = slot.window.id;
                self.note(Irregularity::Empty(since, id, windows));
            }
        }
    }

    /// Whether the references are in order, of which the last two are that far apart. What came before
    /// the first two that are is not judged.
    fn order(&mut self, apart: i64) -> bool {
        if self.in_order {
            return true;
        }
        self.in_order = are_in_order(apart, self.basic_cycle, self.tolerance);
        if self.in_order {
            self.judge_held();
        } else {
            self.drop_held();
            let cycle = self.cycle.take();
            self.without_reference += cycle.map_or(0, |cycle| cycle.frames.len() as u64);
        }
        self.in_order
    }

    fn judge_held(&mut self) {
        for (cycle, end) in std::mem::take(&mut self.held) {
            self.evaluate(&cycle, end);
        }
    }

    fn drop_held(&mut self) {
        let held = self.held.drain(..);
        let frames: usize = held.map(|(cycle, _)| cycle.frames.len()).sum();
        self.without_reference += frames as u64;
    }

    /// Evaluates the current basic cycle, which lasts until `end` at the longest, unless it has to wait.
    fn close(&mut self, end: i64) {
        let Some(cycle) = self.cycle.take() else {
            return;
        };
        if self.in_order {
            self.evaluate(&cycle, end);
            self.cycle = Some(cycle);
        } else {
            self.held.push((cycle, end));
        }
    }

    fn evaluate(&mut self, cycle: &Cycle, end: i64) {
        let lasts = (end - cycle.start).min(longest(self.basic_cycle));
        for &(offset, id) in &cycle.frames {
            let mut own = false;
            for slot in &mut self.slots {
                if let Some(after) = slot.own(cycle.count, id, offset) {
                    own = true;
                    // Where a lost reference was due is not known as well as where one was.
                    if !cycle.lost {
                        slot.starts.add(after as f64);
                    }
                }
            }
            if !own {
                let mut slots = self.slots.iter();
                let other = slots.find(|slot| slot.holds(cycle.count, offset));
                let place = (id, other.map(|slot| slot.start));
                let message = other.map(|slot| slot.window.message.clone());
                let count = self.misplaced.entry(place).or_default();
                *count += 1;
                if *count == 1 {
                    let at = cycle.start + offset;
                    self.note(Irregularity::Misplaced(at, id.raw, id.extended, message));
                }
            }
        }
        for slot in &mut self.slots {
            let due = match slot.window.due {
                Due::Always | Due::OneOf(_) => true,
                Due::WhileFixed(_) => cycle.fixed,
                Due::Sometimes => false,
            };
            let ended = slot.start + slot.length <= lasts;
            if cycle.lost || !due || !ended || !slot.comes(cycle.count) || slot.starts.count() == 0
            {
                continue;
            }
            let mut frames = cycle.frames.iter();
            if frames.any(|&(offset, id)| slot.own(cycle.count, id, offset).is_some()) {
                slot.spared = 0;
            } else if slot.spared < slot.window.due.spared() {
                slot.spared += 1;
            } else {
                slot.spared = 0;
                slot.missed += 1;
                let (_, windows) = slot.empty.get_or_insert((cycle.start + slot.start, 0));
                *windows += 1;
            }
        }
        let came = |slot: &Slot| {
            let mut frames = cycle.frames.iter();
            frames.any(|&(offset, id)| slot.own(cycle.count, id, offset).is_some())
        };
        self.note_empty(came);
    }

    /// The log ends at `end`, or what happened from then on is not known.
    pub(super) fn finish(&mut self, end: i64) {
        self.close(end);
        // A single reference may be all that there is, and is believed then.
        if self.references_so_far == 1 {
            self.judge_held();
        }
        self.drop_held();
        self.in_order = false;
        self.references_so_far = 0;
        self.cycle = None;
        self.reference = None;
        self.note_empty(|_| true);
    }

    /// Missing references and changes of the time master, in order of time.
    pub(super) fn irregularities(&self) -> &[Irregularity] {
        &self.irregularities
    }

    /// The figures.
    pub(super) fn figures(&self, decoder: &Decoder) -> ScheduleFigures {
        let us = |ns: Option<f64>| ns.map(|ns| rounded(ns * 1e-3, 3));
        let shown = self
            .slots
            .iter()
            .filter(|slot| slot.window.kind == WindowKind::Exclusive || slot.starts.count() > 0);
        let windows = shown.map(|slot| {
            let jitter = slot.starts.greatest().zip(slot.starts.least());
            WindowFigures {
                id: slot.window.id,
                message: slot.window.message.clone(),
                sender: slot.window.sender.clone(),
                arbitrating: slot.window.kind == WindowKind::Arbitrating,
                window_start_us: rounded(slot.start as f64 * 1e-3, 3),
                frames: slot.starts.count(),
                missed: slot.missed,
                earliest_start_us: us(slot.starts.least()),
                mean_start_us: us(slot.starts.mean()),
                latest_start_us: us(slot.starts.greatest()),
                jitter_us: us(jitter.map(|(greatest, least)| greatest - least)),
                deviation_us: us(slot.starts.deviation()),
            }
        });
        let foreign = self.misplaced.iter().map(|(&(id, window), &frames)| {
            let owners = self
                .slots
                .iter()
                .filter(|slot| window == Some(slot.start))
                .map(|slot| slot.window.message.clone());
            let standard = u16::try_from(id.raw).ok().filter(|_| !id.extended);
            let known = standard.and_then(|id| decoder.message(id));
            ForeignFigures {
                id: id.raw,
                extended: id.extended,
                message: known.map(|known| known.name.clone()),
                window_start_us: window.map(|ns| rounded(ns as f64 * 1e-3, 3)),
                window_of: owners.collect(),
                frames,
            }
        });
        ScheduleFigures {
            basic_cycles: self.cycles,
            tolerance_us: rounded(self.tolerance as f64 * 1e-3, 3),
            missing_references: self.missing,
            mean_cycle_us: us(self.periods.mean()),
            shortest_cycle_us: us(self.periods.least()),
            longest_cycle_us: us(self.periods.greatest()),
            missed_windows: self.slots.iter().map(|slot| slot.missed).sum(),
            frames_outside_their_window: self.misplaced.values().sum(),
            frames_without_reference: self.without_reference,
            windows: windows.collect(),
            foreign: foreign.collect(),
        }
    }
}

/// Longest time that a basic cycle lasts without a next one.
const fn longest(basic_cycle: i64) -> i64 {
    basic_cycle + basic_cycle / 2
}

#[cfg(test)]
mod tests {
    use crate::network::length::frame_bits;
    use world::report::{FrameRecord, Run, Summary};
    use world::{Scenario, SimDuration, SimTime};

    use super::*;

    /// Marsaglia's xorshift.
    struct Random(u64);

    impl Random {
        fn below(&mut self, limit: u64) -> u64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            self.0 % limit
        }
    }

    fn uagv() -> Vehicle {
        let workspace = crate::Workspace::find().unwrap();
        crate::vehicle::find(&workspace, "uagv").unwrap()
    }

    /// Traffic with jitter, empty windows, misplaced frames, missing references and unknown
    /// identifiers: start of frame in ns, and the frame.
    fn traffic(windows: &[Window], seed: u64) -> Vec<(i64, Frame)> {
        let mut random = Random(seed);
        let mut frames = Vec::new();
        for cycle in 1..300_u64 {
            let begin = cycle * 100_000_000 + random.below(20_000);
            if random.below(12) > 0 {
                let mut data = [0; 8];
                data[0] = random.below(2) as u8;
                data[5] = (cycle % 64) as u8;
                let master = if cycle < 200 { 100 } else { 101 };
                frames.push((begin, Frame::standard(master, &data).unwrap()));
            }
            for window in windows {
                let start = begin + window.start.as_ticks() / 1000;
                let at = match random.below(12) {
                    0 => continue,
                    1 => begin + 50_000_000 + random.below(30_000_000),
                    2 => start.saturating_sub(random.below(400_000)),
                    _ => start + random.below(60_000),
                };
                let frame = Frame::standard(window.id, &[random.below(256) as u8; 4]).unwrap();
                frames.push((at, frame));
            }
            if random.below(5) == 0 {
                let at = begin + random.below(90_000_000);
                frames.push((at, Frame::standard(0x7F0, &[]).unwrap()));
            }
        }
        frames.sort_by_key(|(at, _)| *at);
        frames
            .into_iter()
            .map(|(at, frame)| (at as i64, frame))
            .collect()
    }

    fn length(frame: &Frame) -> i64 {
        i64::from(frame_bits(frame)) * 4000
    }

    fn record(at: i64, frame: &Frame) -> FrameRecord {
        let Id::Standard(id) = frame.id() else {
            panic!("{frame:?}");
        };
        let ps = |ns: i64| SimTime::from_ticks(ns as u64 * 1000);
        let mut data = [0; 8];
        data[..frame.data().len()].copy_from_slice(frame.data());
        FrameRecord {
            id: id.as_raw(),
            dlc: frame.dlc(),
            data,
            start: ps(at),
            end: ps(at + length(frame)),
            complete: true,
            remote: false,
        }
    }

    /// The report of a simulated run is computed from the bus itself, by other code.
    #[test]
    fn the_figures_are_those_of_the_report_of_a_run() {
        let vehicle = uagv();
        let matrix = Matrix::new(&vehicle);
        let of_kind = |kind: WindowKind| {
            let mut all = matrix.windows.clone();
            all.retain(|window| window.kind == kind);
            all
        };
        let exclusive = of_kind(WindowKind::Exclusive);
        let scenario = Scenario::uneventful(&vehicle, "still");
        let mut outside = 0;
        for seed in 1..=8 {
            let frames = traffic(&exclusive, seed);
            let records: Vec<FrameRecord> = frames
                .iter()
                .map(|(at, frame)| record(*at, frame))
                .collect();
            let end = records.iter().map(|one| one.end).max().unwrap();
            let run = Run {
                scenario: &scenario,
                nodes: &[],
                seed,
                duration: SimDuration::from_ticks(end.as_ticks()),
                states: &[],
                efforts: &[],
                frames: &records,
                windows: &matrix.windows,
                cycle_count_byte: matrix.cycle_count_byte(),
                basic_cycle: matrix.basic_cycle(),
                bit_time: matrix.bit_time(),
                modes: &[],
                tasks: &[],
                rover: None,
                crop: None,
                mission: None,
            };
            let expected = Summary::of(&run).bus;

            let mut timing = Timing::new(&vehicle, 0).unwrap();
            for (at, frame) in &frames {
                timing.take(*at, frame);
            }
            timing.finish((end.as_ticks() / 1000) as i64);
            let found = timing.figures(&Decoder::new(vehicle.network()));

            assert_eq!(found.basic_cycles, expected.basic_cycles);
            assert_eq!(found.missed_windows, expected.missed_windows);
            assert!(found.missing_references > 10);
            for (found, expected) in found
                .windows
                .iter()
                .filter(|window| !window.arbitrating)
                .zip(&expected.windows)
            {
                assert_eq!(found.id, expected.id);
                assert_eq!(found.frames, expected.frames, "{found:?}");
                assert_eq!(found.missed, expected.missed, "{found:?}");
                let pairs = [
                    (found.earliest_start_us, expected.earliest_start_us),
                    (found.mean_start_us, expected.mean_start_us),
                    (found.latest_start_us, expected.latest_start_us),
                ];
                for (found, expected) in pairs {
                    let (found, expected) = (found.unwrap(), expected.unwrap());
                    assert!((found - expected).abs() < 2e-3, "{found} {expected}");
                }
            }
            // The report counts only frames of exclusive messages, without a reference, too.
            let unknown = found.foreign.iter().filter(|one| one.message.is_none());
            let unknown: u64 = unknown.map(|one| one.frames).sum();
            assert!(unknown > 0);
            let known = found.frames_outside_their_window - unknown;
            let late = records.iter().filter(|one| one.id != 0x7F0).count() as u64
                - found.basic_cycles
                - found.windows.iter().map(|one| one.frames).sum::<u64>();
            assert_eq!(expected.frames_outside_their_window, late);
            assert!(known <= late);
            outside += known;
        }
        assert!(outside > 100, "{outside}");
    }

    #[test]
    fn a_frame_in_the_window_of_another_message_is_named_with_it() {
        let vehicle = uagv();
        let mut timing = Timing::new(&vehicle, 0).unwrap();
        let mut take = |at: i64, id: u16, data: &[u8]| {
            let frame = Frame::standard(id, data).unwrap();
            timing.take(at, &frame);
            if id == 206 {
                // A frame with 29 bits has the windows of nobody.
                let frame = Frame::extended(0x18FF_0102, &[]).unwrap();
                timing.take(at + 2_000_000, &frame);
            }
        };
        take(0, 100, &[0; 8]);
        // 300 in the window of 206, an unknown one in free time, and 206 where it belongs.
        take(6_000_000, 300, &[0; 8]);
        take(50_000_000, 0x7F0, &[]);
        take(6_600_000, 206, &[0; 2]);
        take(100_000_000, 100, &[0; 8]);
        take(350_000_000, 100, &[0; 8]);
        timing.finish(350_000_000);
        let found = timing.figures(&Decoder::new(vehicle.network()));
        let foreign: Vec<_> = found
            .foreign
            .iter()
            .map(|one| {
                (
                    one.id,
                    one.window_start_us,
                    one.window_of.join(" "),
                    one.frames,
                )
            })
            .collect();
        assert_eq!(
            foreign,
            [
                (300, Some(6000.0), "SteeringPot".to_owned(), 1),
                (0x7F0, None, String::new(), 1),
                (0x18FF_0102, Some(8000.0), "LogPosition".to_owned(), 1)
            ]
        );
        assert_eq!((found.basic_cycles, found.missing_references), (3, 2));
        assert_eq!(
            timing.irregularities(),
            [
                Irregularity::Misplaced(6_000_000, 300, false, Some("SteeringPot".to_owned())),
                Irregularity::Misplaced(50_000_000, 2032, false, None),
                Irregularity::Misplaced(
                    8_600_000,
                    419_365_122,
                    true,
                    Some("LogPosition".to_owned())
                ),
                Irregularity::MissingReferences(100_000_000, 2),
                Irregularity::Empty(106_000_000, 206, 1),
            ]
        );
    }
}
