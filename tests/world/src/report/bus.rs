//! What happened on the bus, judged by the system matrix.
//!
//! A basic cycle begins with the start of frame of its reference message and lasts until the next
//! one, at most one and a half basic cycles: without a reference no window exists.

use std::collections::BTreeMap;

use super::summary::{BusFigures, IdFigures, WindowFigures, micros_between, rounded};
use super::{Due, FrameRecord, Run, Window, WindowKind};
use crate::time::{SimTime, after, at, since, span_seconds};

/// Bits of the intermission after a frame (ISO 11898-1).
const INTERMISSION: u32 = 3;

/// A basic cycle: its reference and the frames up to the next one.
struct Cycle<'a> {
    reference: &'a FrameRecord,
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
        .filter(|(_, frame)| frame.complete && reference_ids.contains(&frame.id))
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
                frames: &run.frames[*begin..after_last.max(*begin)],
                end,
            }
        })
        .collect()
}

/// Starts of frame of one window's message, microseconds after the window's begin.
#[derive(Default)]
struct Tally {
    starts: Vec<f64>,
    missed: u64,
    outside: u64,
}

fn tally(window: &Window, cycles: &[Cycle]) -> Tally {
    let mut tally = Tally::default();
    for cycle in cycles {
        let begin = after(cycle.reference.start, window.start);
        let mine = cycle
            .frames
            .iter()
            .filter(|frame| frame.complete && frame.id == window.id);
        let mut seen = false;
        for frame in mine {
            let offset = micros_between(begin, frame.start);
            // A start early by up to half a window is an early frame, not another window's.
            let length = span_seconds(window.length) * 1e6;
            if offset >= -length / 2.0 && offset < length {
                tally.starts.push(offset);
                seen = true;
            } else {
                tally.outside += 1;
            }
        }
        let fixed = cycle.reference.dlc > 0 && cycle.reference.data[0] & 1 == 1;
        let due = match window.due {
            Due::Always => true,
            Due::WhileFixed => fixed,
            Due::Sometimes => false,
        };
        let over = after(begin, window.length) <= cycle.end;
        if due && over && !seen && !tally.starts.is_empty() {
            tally.missed += 1;
        }
    }
    tally
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

    let mut counts = BTreeMap::<u16, u64>::new();
    for frame in complete() {
        *counts.entry(frame.id).or_default() += 1;
    }
    let known = |id: u16| run.windows.iter().find(|window| window.id == id);

    let mut exclusive: Vec<&Window> = run
        .windows
        .iter()
        .filter(|window| window.kind == WindowKind::Exclusive)
        .collect();
    exclusive.sort_by_key(|window| window.start);
    let mut windows = Vec::new();
    let mut extremes: Vec<(f64, f64, u16)> = Vec::new();
    let (mut missed, mut outside) = (0, 0);
    for window in exclusive {
        let tally = tally(window, &cycles);
        missed += tally.missed;
        outside += tally.outside;
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
    // Frames of exclusive windows between two cycles, when the reference is missing.
    let in_cycles: u64 = cycles
        .iter()
        .flat_map(|cycle| cycle.frames)
        .filter(|frame| frame.complete && is_exclusive(run, frame.id))
        .count() as u64;
    let all = complete()
        .filter(|frame| is_exclusive(run, frame.id))
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
        frames_per_id: counts
            .into_iter()
            .map(|(id, frames)| IdFigures {
                id,
                message: known(id).map_or(String::new(), |window| window.message.clone()),
                frames,
            })
            .collect(),
        latest_start_us: latest.map(|(_, latest, _)| rounded(latest, 3)),
        latest_start_id: latest.map(|(_, _, id)| id),
        earliest_start_us: earliest.map(|us| rounded(us, 3)),
        missed_windows: missed,
        frames_outside_their_window: outside,
        foreign_frames: complete().filter(|frame| known(frame.id).is_none()).count() as u64,
        windows,
    }
}

fn is_exclusive(run: &Run, id: u16) -> bool {
    run.windows
        .iter()
        .any(|window| window.id == id && window.kind == WindowKind::Exclusive)
}
