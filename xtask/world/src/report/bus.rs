//! Figures of the bus: the frames of a run compared with the system matrix.
//!
//! A basic cycle begins with the start of frame of its reference message and lasts until the next
//! one, but at most one and a half basic cycles, because there are no windows without a reference.

use std::collections::BTreeMap;

use super::figures::{
    BusFigures, IdFigures, TakeoverFigures, WindowFigures, micros_between, rounded,
};
use super::{Due, FrameRecord, Run, Window, WindowKind};
use crate::time::Span as _;
use crate::time::{SimTime, after, at, since, span_seconds};

/// Bits of the intermission after a frame (ISO 11898-1).
const INTERMISSION: u32 = 3;

/// A basic cycle: its reference and the frames up to the next one.
struct Cycle<'a> {
    reference: &'a FrameRecord,
    /// What its reference counts it as.
    count: u8,
    frames: &'a [FrameRecord],
    end: SimTime,
}

fn cycles<'a>(run: &Run<'a>) -> Vec<Cycle<'a>> {
    let reference_ids: Vec<u16> = run
        .windows
        .iter()
        .filter(|window| window.kind == WindowKind::Reference)
        .map(|window| window.id)
        .collect();
    let begins: Vec<usize> = run
        .frames
        .iter()
        .enumerate()
        .filter(|(_, frame)| frame.is_message() && reference_ids.contains(&frame.id))
        .map(|(i, _)| i)
        .collect();
    begins
        .iter()
        .enumerate()
        .map(|(i, begin)| {
            let reference = &run.frames[*begin];
            let longest = after(reference.start, run.basic_cycle + run.basic_cycle / 2);
            let next = begins.get(i + 1).map(|next| run.frames[*next].start);
            let end = next.unwrap_or(longest).min(longest).min(at(run.duration));
            let after_last = run.frames.partition_point(|frame| frame.start < end);
            Cycle {
                reference,
                count: reference
                    .data
                    .get(run.cycle_count_byte)
                    .map_or(0, |byte| byte & 0x3F),
                frames: &run.frames[*begin..after_last.max(*begin)],
                end,
            }
        })
        .collect()
}

impl Cycle<'_> {
    /// Whether a window comes in this basic cycle.
    fn has(&self, window: &Window) -> bool {
        self.count % window.repeat.max(1) == window.offset
    }

    /// How long after the start of a window a frame starts, in microseconds, if it belongs to
    /// it. A frame that starts early by up to half a window is an early frame of this window.
    fn start_in(&self, window: &Window, frame: &FrameRecord) -> Option<f64> {
        let begin = after(self.reference.start, window.start);
        let offset = micros_between(begin, frame.start);
        let length = span_seconds(window.length) * 1e6;
        let inside = offset >= -length / 2.0 && offset < length;
        (inside && window.id == frame.id && self.has(window)).then_some(offset)
    }

    /// When the complete frames in a window start, microseconds after its begin.
    fn starts(&self, window: &Window) -> impl Iterator<Item = f64> {
        let messages = self.frames.iter().filter(|frame| frame.is_message());
        messages.filter_map(|frame| self.start_in(window, frame))
    }

    /// Whether a window stayed empty although its message was due and had come before.
    fn lacks(&self, window: &Window, came_before: bool) -> bool {
        came_before && self.expects(window) && self.starts(window).next().is_none()
    }

    /// Whether a window's message is due, and the basic cycle did not end before.
    fn expects(&self, window: &Window) -> bool {
        let due = match window.due {
            Due::Always | Due::OneOf(_) => true,
            Due::WhileFixed(_) => self.reference.dlc > 0 && self.reference.data[0] & 1 == 1,
            Due::Sometimes => false,
        };
        due && after(self.reference.start, window.start + window.length) <= self.end
    }

    /// Whether a window comes in this basic cycle; of the references, the one that began it.
    fn comes_with(&self, window: &Window) -> bool {
        match window.kind {
            WindowKind::Reference => window.id == self.reference.id,
            WindowKind::Exclusive | WindowKind::Arbitrating => self.has(window),
        }
    }

    /// What a window has brought. `came_before` says whether its message had come in a former cycle.
    fn content(&self, window: &Window, came_before: bool) -> WindowContent {
        let destroyed = || {
            let mut frames = self.frames.iter().filter(|frame| !frame.complete);
            frames.any(|frame| self.start_in(window, frame).is_some())
        };
        match self.starts(window).next() {
            _ if window.kind == WindowKind::Reference => WindowContent::Frame(0.0),
            Some(start) => WindowContent::Frame(start),
            None if destroyed() => WindowContent::Destroyed,
            None if window.due.spared() == 0 && self.lacks(window, came_before) => {
                WindowContent::Missed
            }
            None => WindowContent::Empty,
        }
    }

    /// Whether a frame starts in an arbitrating window, no earlier than its sender's clock may be ahead.
    fn starts_in_arbitrating(&self, window: &Window, frame: &FrameRecord) -> bool {
        let begin = after(self.reference.start, window.start);
        let length = span_seconds(window.length) * 1e6;
        let offset = micros_between(begin, frame.start);
        self.has(window) && (-UNCERTAINTY..length).contains(&offset)
    }

    /// The complete frames of messages with a window that are in none of theirs. What goes into an arbitrating window may
    /// be tried again in any other one.
    fn misplaced(&self, run: &Run) -> usize {
        let placed = |frame: &&FrameRecord| {
            let arbitrating = is_of(run, frame.id, WindowKind::Arbitrating);
            let mut windows = run.windows.iter();
            windows.any(|window| match window.kind {
                WindowKind::Reference => false,
                WindowKind::Exclusive => self.start_in(window, frame).is_some(),
                WindowKind::Arbitrating => arbitrating && self.starts_in_arbitrating(window, frame),
            })
        };
        let frames = self.frames.iter();
        let known = frames.filter(|frame| frame.is_message() && has_window(run, frame.id));
        known.filter(|frame| !placed(frame)).count()
    }
}

/// Start times of one window's message, microseconds after the start of the window.
#[derive(Default)]
struct Tally {
    starts: Vec<f64>,
    missed: u64,
}

fn tally(window: &Window, cycles: &[Cycle]) -> Tally {
    let mut tally = Tally::default();
    // So many in a row were empty.
    let mut empty = 0;
    for cycle in cycles.iter().filter(|cycle| cycle.has(window)) {
        if cycle.lacks(window, !tally.starts.is_empty()) {
            empty += 1;
        } else if cycle.starts(window).next().is_some() {
            empty = 0;
        }
        if empty > window.due.spared() {
            tally.missed += 1;
            empty = 0;
        }
        tally.starts.extend(cycle.starts(window));
    }
    tally
}

/// What a window of a basic cycle has brought.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WindowContent {
    /// A frame that began so many microseconds after the window did.
    Frame(f64),
    /// A destroyed frame.
    Destroyed,
    /// Nothing, although the message was due and had come before.
    Missed,
    /// Nothing, which is as it should be.
    Empty,
}

/// The last basic cycle that is over.
#[derive(Clone, Debug, PartialEq)]
pub struct LastCycle {
    /// What its reference counts it as.
    pub count: u8,
    /// Start of its reference.
    pub begin: SimTime,
    /// The windows that come in it, in order of time, with their places in [`Run::windows`].
    pub windows: Vec<(usize, WindowContent)>,
}

/// The last basic cycle of a run that is over; `None` without a reference. The run may be a part of another one:
/// `came` says whether the message of a window had come in it before.
#[must_use]
pub fn last_cycle(run: &Run, came: &dyn Fn(&Window) -> bool) -> Option<LastCycle> {
    let cycles = cycles(run);
    let cycle = cycles
        .iter()
        .rev()
        .find(|cycle| cycle.end < at(run.duration))?;
    let windows = run.windows.iter().enumerate();
    let mut windows: Vec<_> = windows
        .filter(|(_, window)| cycle.comes_with(window))
        .map(|(place, window)| (place, cycle.content(window, came(window))))
        .collect();
    windows.sort_by_key(|&(place, _)| run.windows[place].start);
    Some(LastCycle {
        count: cycle.count,
        begin: cycle.reference.start,
        windows,
    })
}

fn least(values: &[f64]) -> Option<f64> {
    values.iter().copied().reduce(f64::min)
}

fn most(values: &[f64]) -> Option<f64> {
    values.iter().copied().reduce(f64::max)
}

pub(super) fn figures(run: &Run) -> BusFigures {
    let cycles = cycles(run);
    let busy: f64 = run
        .frames
        .iter()
        .map(|frame| span_seconds(since(frame.end, frame.start) + run.bit_time * INTERMISSION))
        .sum();
    let complete = || run.frames.iter().filter(|frame| frame.complete);

    let known = |id: u16| run.windows.iter().find(|window| window.id == id);

    let mut exclusive: Vec<&Window> = run
        .windows
        .iter()
        .filter(|window| window.kind == WindowKind::Exclusive)
        .collect();
    exclusive.sort_by_key(|window| window.start);
    let misplaced: usize = cycles.iter().map(|cycle| cycle.misplaced(run)).sum();
    let mut outside = misplaced as u64;
    let mut windows = Vec::new();
    let mut extremes: Vec<(f64, f64, u16)> = Vec::new();
    let mut missed = 0;
    for window in exclusive {
        let tally = tally(window, &cycles);
        missed += tally.missed;
        let count = tally.starts.len();
        let mean = tally.starts.iter().sum::<f64>() / count as f64;
        let (earliest, latest) = (least(&tally.starts), most(&tally.starts));
        if let (Some(earliest), Some(latest)) = (earliest, latest) {
            extremes.push((earliest, latest, window.id));
        }
        windows.push(WindowFigures {
            id: window.id,
            message: window.message.clone(),
            sender: window.sender.clone(),
            window_start_us: rounded(span_seconds(window.start) * 1e6, 3),
            frames: count as u64,
            missed: tally.missed,
            earliest_start_us: earliest.map(|us| rounded(us, 3)),
            mean_start_us: (count > 0).then(|| rounded(mean, 3)),
            latest_start_us: latest.map(|us| rounded(us, 3)),
        });
    }
    // Frames outside all cycles, when the reference is missing.
    let in_cycles: u64 = cycles
        .iter()
        .flat_map(|cycle| cycle.frames)
        .filter(|frame| frame.is_message() && has_window(run, frame.id))
        .count() as u64;
    let all = complete()
        .filter(|frame| !frame.remote && has_window(run, frame.id))
        .count() as u64;
    outside += all - in_cycles;

    let latest = extremes
        .iter()
        .copied()
        .reduce(|a, b| if b.1 > a.1 { b } else { a });
    let earliest = extremes
        .iter()
        .map(|(earliest, _, _)| *earliest)
        .reduce(f64::min);
    BusFigures {
        load_percent: rounded(busy / span_seconds(run.duration) * 100.0, 3),
        frames: complete().count() as u64,
        error_frames: (run.frames.len() - complete().count()) as u64,
        basic_cycles: cycles.len() as u64,
        frames_per_id: frames_per_id(run),
        latest_start_us: latest.map(|(_, latest, _)| rounded(latest, 3)),
        latest_start_id: latest.map(|(_, _, id)| id),
        earliest_start_us: earliest.map(|us| rounded(us, 3)),
        missed_windows: missed,
        frames_outside_their_window: outside,
        foreign_frames: complete().filter(|frame| known(frame.id).is_none()).count() as u64,
        global_time: None,
        gates: Vec::new(),
        takeovers: takeovers(run, &cycles),
        windows,
    }
}

fn frames_per_id(run: &Run) -> Vec<IdFigures> {
    let mut counts = BTreeMap::<u16, u64>::new();
    for frame in run.frames.iter().filter(|frame| frame.is_message()) {
        *counts.entry(frame.id).or_default() += 1;
    }
    let message = |id: u16| {
        let window = run.windows.iter().find(|window| window.id == id);
        window.map_or(String::new(), |window| window.message.clone())
    };
    let figures = counts.into_iter().map(|(id, frames)| IdFigures {
        id,
        message: message(id),
        frames,
    });
    figures.collect()
}

/// Time by which each backup master waits longer than the master of the next better rank, and the
/// largest difference between the nodes' clocks after a basic cycle, both in microseconds.
const BACKUP_OFFSET: f64 = 16.0;
const UNCERTAINTY: f64 = 20.0;

/// Takeovers: the node that had sent the last reference was held in reset.
fn takeovers(run: &Run, cycles: &[Cycle]) -> Vec<TakeoverFigures> {
    let mut references: Vec<&Window> = run
        .windows
        .iter()
        .filter(|window| window.kind == WindowKind::Reference)
        .collect();
    references.sort_by_key(|window| window.id);
    let rank = |id: u16| references.iter().position(|window| window.id == id);
    let mut takeovers = Vec::new();
    for reset in &run.scenario.reset {
        let died = at(reset.at.span());
        let after = cycles.partition_point(|cycle| cycle.reference.start < died);
        let last = after.checked_sub(1).and_then(|last| cycles.get(last));
        let Some((index, last)) = after.checked_sub(1).zip(last) else {
            continue;
        };
        let sender = rank(last.reference.id).map(|rank| references[rank].sender.as_str());
        let master = run.nodes[reset.node.0].as_str();
        if sender != Some(master) || died > last.end || died > at(run.duration) {
            continue;
        }
        let next = cycles.get(index + 1);
        let next = next.filter(|next| next.reference.id != last.reference.id);
        let ranks = next.map_or(1, |next| {
            rank(next.reference.id)
                .zip(rank(last.reference.id))
                .map_or(1, |(next, last)| next.saturating_sub(last))
        });
        let others = run
            .windows
            .iter()
            .filter(|window| window.kind == WindowKind::Exclusive && window.sender != master);
        let near = cycles
            .get(index..cycles.len().min(index + 2))
            .unwrap_or_default();
        let windows_lost = others.map(|window| missed(window, near, run)).sum();
        takeovers.push(TakeoverFigures {
            master: master.to_owned(),
            at_seconds: rounded(crate::time::seconds(died), 6),
            next_reference_after_us: next.map(|next| {
                rounded(
                    micros_between(last.reference.start, next.reference.start),
                    3,
                )
            }),
            bound_us: rounded(
                span_seconds(run.basic_cycle) * 1e6 + BACKUP_OFFSET * ranks as f64 + UNCERTAINTY,
                3,
            ),
            windows_lost,
        });
    }
    takeovers
}

/// The number of these basic cycles in which a message that is always due is missing.
fn missed(window: &Window, cycles: &[Cycle], run: &Run) -> u64 {
    let ended = |cycle: &&Cycle| {
        let end = after(cycle.reference.start, window.start + window.length);
        end <= cycle.end && end <= at(run.duration)
    };
    let seen = |cycle: &&Cycle| {
        let mut frames = cycle.frames.iter();
        frames.any(|frame| frame.is_message() && frame.id == window.id)
    };
    match window.due {
        Due::Always => cycles
            .iter()
            .filter(|cycle| cycle.has(window))
            .filter(ended)
            .filter(|cycle| !seen(cycle))
            .count() as u64,
        Due::OneOf(_) | Due::WhileFixed(_) | Due::Sometimes => 0,
    }
}

fn is_of(run: &Run, id: u16, kind: WindowKind) -> bool {
    let mut windows = run.windows.iter();
    windows.any(|window| window.id == id && window.kind == kind)
}

/// Whether a message must keep to a window. On a bus without references none must.
fn has_window(run: &Run, id: u16) -> bool {
    let mut windows = run.windows.iter();
    is_of(run, id, WindowKind::Exclusive)
        || is_of(run, id, WindowKind::Arbitrating)
            && windows.any(|window| window.kind == WindowKind::Reference)
}
