//! Places messages in the time of a whole matrix.

use std::vec;
use std::vec::Vec;

use super::{Infeasible, Message, PlannedWindow, Wishes};
use crate::matrix::{REFERENCE_OFFSET_LIMIT, bits_to_micros, needed_micros};
use crate::{INTERFRAME_BITS, Id, MatrixConfig, Micros, worst_case_bits};

/// The empty matrix. Times are in microseconds.
pub(super) struct Frame {
    pub basic_cycle: u32,
    pub cycles: u32,
    grain: u32,
    /// First and last cycle time for windows.
    first: u32,
    last: u32,
}

/// A window that was placed. Times count from the beginning of the matrix.
#[derive(Clone, Copy)]
struct Taken {
    start: u32,
    end: u32,
    message: usize,
}

/// The windows of all messages, and the jitter of each.
pub(super) struct Placed {
    /// Sorted by start.
    taken: Vec<Taken>,
    pub jitter: Vec<u32>,
}

impl Frame {
    pub(super) fn new(
        network: &MatrixConfig,
        wishes: &Wishes,
        basic_cycle: u32,
        cycles: u32,
    ) -> Self {
        let grain = wishes.grain.ticks().max(1);
        let bits = worst_case_bits(network.reference, network.reference_format.longest());
        let reference = bits_to_micros(bits + INTERFRAME_BITS, network.bit_rate);
        let uncertainty = network.sync_uncertainty.ticks();
        let early = if network.masters.len() > 1 {
            REFERENCE_OFFSET_LIMIT
        } else {
            0
        };
        Self {
            basic_cycle,
            cycles,
            grain,
            first: reference.saturating_add(uncertainty).div_ceil(grain) * grain,
            last: basic_cycle.saturating_sub(uncertainty + early) / grain * grain,
        }
    }

    fn matrix(&self) -> u32 {
        self.basic_cycle.saturating_mul(self.cycles)
    }

    /// Share of time for references and the margins around them, in thousandths.
    pub(super) fn reserved_per_mille(&self) -> u32 {
        let usable = self.last.saturating_sub(self.first);
        (u64::from(self.basic_cycle.saturating_sub(usable)) * 1000
            / u64::from(self.basic_cycle.max(1))) as u32
    }

    /// The earliest possible start of a window of `length` from `time` on, at most
    /// `slack` later and before the end of the matrix. In each basic cycle it follows the
    /// windows of the messages that `message` needs.
    fn earliest(
        &self,
        taken: &[Taken],
        message: &Message,
        time: u32,
        length: u32,
        slack: u32,
    ) -> Option<u32> {
        let mut start = time;
        loop {
            if start >= self.matrix() || start - time > slack {
                return None;
            }
            let cycle = start / self.basic_cycle * self.basic_cycle;
            start = start.max(cycle + self.first);
            let next = cycle + self.basic_cycle;
            let preceding = taken.iter().filter(|other| {
                message.after.contains(&other.message) && (cycle..next).contains(&other.start)
            });
            let gap = self.gap(message);
            start = preceding.fold(start, |start, other| start.max(other.end + gap));
            if start + length > cycle + self.last {
                start = cycle + self.basic_cycle;
                continue;
            }
            let following = taken.partition_point(|other| other.end <= start);
            match taken.get(following) {
                Some(other) if other.start < start + length => start = other.end,
                _ => return (start - time <= slack).then_some(start),
            }
        }
    }

    /// Least time between a message and those that it needs, a multiple of the grain.
    fn gap(&self, message: &Message) -> u32 {
        message.gap.ticks().div_ceil(self.grain) * self.grain
    }

    /// Arbitrating windows for the required share of time: first where all basic
    /// cycles have room, then in single basic cycles.
    pub(super) fn arbitrating(
        &self,
        placed: &Placed,
        wishes: &Wishes,
        network: &MatrixConfig,
    ) -> Result<Vec<PlannedWindow>, Infeasible> {
        let all = u64::from(self.matrix());
        let wanted = all * u64::from(wishes.arbitrating_per_mille);
        let bits = worst_case_bits(Id::constant::<0>(), 8)
            + INTERFRAME_BITS
            + u32::from(network.transmit_enable_bits);
        let useful = needed_micros(bits, network.bit_rate, network.sync_uncertainty);
        let mut windows = Vec::new();
        let mut got = 0u64;
        let cycles: Vec<Vec<(u32, u32)>> = (0..self.cycles)
            .map(|cycle| self.busy(placed, cycle))
            .collect();
        let everywhere = merge(cycles.iter().flatten().copied().collect());
        let mut add = |busy: &[(u32, u32)], repeat: u32, offset: u32, got: &mut u64| {
            for (start, end) in self.gaps(busy) {
                let times = u64::from(self.cycles / repeat);
                let missing = wanted.saturating_sub(*got * 1000);
                if missing == 0 || end - start < useful {
                    continue;
                }
                let enough = missing.div_ceil(1000 * times).min(u64::from(end - start)) as u32;
                let length = enough.max(useful).div_ceil(self.grain) * self.grain;
                let length = length.min(end - start);
                *got += u64::from(length) * times;
                windows.push(PlannedWindow {
                    message: None,
                    start: Micros::from_ticks(start),
                    length: Micros::from_ticks(length),
                    repeat: repeat as u8,
                    offset: offset as u8,
                });
            }
        };
        add(&everywhere, 1, 0, &mut got);
        let common: Vec<(u32, u32)> = everywhere;
        if got * 1000 < wanted && self.cycles > 1 {
            // The common windows are taken in each basic cycle, too.
            let shared: Vec<(u32, u32)> = self
                .gaps(&common)
                .into_iter()
                .filter(|(start, end)| end - start >= useful)
                .collect();
            for (cycle, busy) in cycles.iter().enumerate() {
                let busy = merge(busy.iter().chain(&shared).copied().collect());
                add(&busy, self.cycles, cycle as u32, &mut got);
            }
        }
        if got * 1000 < wanted {
            return Err(Infeasible::Arbitrating {
                left_per_mille: (got * 1000 / all.max(1)) as u32,
            });
        }
        Ok(windows)
    }

    /// Cycle times of the windows in one basic cycle.
    fn busy(&self, placed: &Placed, cycle: u32) -> Vec<(u32, u32)> {
        let from = cycle * self.basic_cycle;
        placed
            .taken
            .iter()
            .filter(|taken| taken.start / self.basic_cycle == cycle)
            .map(|taken| (taken.start - from, taken.end - from))
            .collect()
    }

    /// The free times between sorted windows.
    fn gaps(&self, busy: &[(u32, u32)]) -> Vec<(u32, u32)> {
        let mut gaps = Vec::new();
        let mut from = self.first;
        for (start, end) in busy.iter().copied().chain([(self.last, self.last)]) {
            if start > from {
                gaps.push((from, start.min(self.last)));
            }
            from = from.max(end);
        }
        gaps
    }
}

impl Placed {
    /// The windows of all messages, as few as repeat factors allow.
    pub(super) fn windows(&self, frame: &Frame) -> Vec<PlannedWindow> {
        let mut windows = Vec::new();
        let mut left: Vec<(usize, u32, u32, u32)> = self
            .taken
            .iter()
            .map(|taken| {
                let cycle = taken.start / frame.basic_cycle;
                let start = taken.start - cycle * frame.basic_cycle;
                (taken.message, start, taken.end - taken.start, cycle)
            })
            .collect();
        left.sort_unstable();
        for group in left.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
            let Some(&(message, start, length, _)) = group.first() else {
                continue;
            };
            let mut open = vec![false; frame.cycles as usize];
            for (_, _, _, cycle) in group {
                open[*cycle as usize] = true;
            }
            let mut repeat = 1;
            while repeat <= frame.cycles {
                for offset in 0..repeat {
                    let mut cycles = (offset..frame.cycles).step_by(repeat as usize);
                    if !cycles.clone().all(|cycle| open[cycle as usize]) {
                        continue;
                    }
                    cycles
                        .by_ref()
                        .for_each(|cycle| open[cycle as usize] = false);
                    windows.push(PlannedWindow {
                        message: Some(message),
                        start: Micros::from_ticks(start),
                        length: Micros::from_ticks(length),
                        repeat: repeat as u8,
                        offset: offset as u8,
                    });
                }
                repeat *= 2;
            }
        }
        windows
    }
}

/// Order of placing: short periods first, and long windows first among equal
/// periods. These are the hardest to place.
pub(super) fn by_period(periods: &[u32], lengths: &[u32]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..periods.len()).collect();
    order.sort_by_key(|index| (periods[*index], core::cmp::Reverse(lengths[*index])));
    order
}

/// The order with each message behind those that its windows must follow.
pub(super) fn in_sequence(order: &[usize], messages: &[Message]) -> Result<Vec<usize>, Infeasible> {
    let mut sequence: Vec<usize> = Vec::new();
    while let Some(&first) = order.iter().find(|index| !sequence.contains(index)) {
        let free = order.iter().find(|&&index| {
            let mut after = messages[index].after.iter();
            !sequence.contains(&index) && after.all(|other| sequence.contains(other))
        });
        let Some(&free) = free else {
            let message = messages[first].name.clone();
            return Err(Infeasible::Sequence { message });
        };
        sequence.push(free);
    }
    Ok(sequence)
}

/// Places all messages in the given order. With `with_jitter`, a window may begin later
/// than a regular period requires, as far as the deadline allows.
pub(super) fn place(
    frame: &Frame,
    messages: &[Message],
    periods: &[u32],
    lengths: &[u32],
    order: &[usize],
    with_jitter: bool,
) -> Result<Placed, Infeasible> {
    let mut taken: Vec<Taken> = Vec::new();
    let mut jitter = vec![0; messages.len()];
    for &index in order {
        let (period, length) = (periods[index], lengths[index]);
        let slack = if with_jitter {
            messages[index].deadline.ticks().min(period) - length
        } else {
            0
        };
        let Some((starts, deviation)) =
            best_phase(frame, &taken, &messages[index], period, length, slack)
        else {
            let message = messages[index].name.clone();
            return Err(Infeasible::NoRoom { message });
        };
        jitter[index] = deviation;
        taken.extend(starts.into_iter().map(|start| Taken {
            start,
            end: start + length,
            message: index,
        }));
        taken.sort_by_key(|taken| taken.start);
    }
    Ok(Placed { taken, jitter })
}

/// The starts of a message with the least jitter, and that jitter; the earliest
/// phase wins among equals. It is enough to try the phases at which a window
/// follows directly after another one or a reference, or after the gap that it needs.
fn best_phase(
    frame: &Frame,
    taken: &[Taken],
    message: &Message,
    period: u32,
    length: u32,
    slack: u32,
) -> Option<(Vec<u32>, u32)> {
    let mut phases: Vec<u32> = (0..frame.cycles)
        .map(|cycle| cycle * frame.basic_cycle + frame.first)
        .chain(taken.iter().map(|taken| taken.end))
        .chain(taken.iter().map(|taken| taken.end + frame.gap(message)))
        .chain([0])
        .map(|time| time % period)
        .collect();
    phases.sort_unstable();
    phases.dedup();
    let mut best: Option<(Vec<u32>, u32)> = None;
    for phase in phases {
        let mut starts = Vec::new();
        let (mut least, mut most) = (u32::MAX, 0);
        let mut time = phase;
        while time < frame.matrix() {
            let Some(start) = frame.earliest(taken, message, time, length, slack) else {
                break;
            };
            least = least.min(start - time);
            most = most.max(start - time);
            starts.push(start);
            time += period;
        }
        if time < frame.matrix() || starts.is_empty() {
            continue;
        }
        let jitter = most - least;
        if best.as_ref().is_none_or(|(_, least)| jitter < *least) {
            best = Some((starts, jitter));
        }
        if jitter == 0 {
            break;
        }
    }
    best
}

/// Joins overlapping intervals.
fn merge(mut intervals: Vec<(u32, u32)>) -> Vec<(u32, u32)> {
    intervals.sort_unstable();
    let mut merged: Vec<(u32, u32)> = Vec::new();
    for (start, end) in intervals {
        match merged.last_mut() {
            Some(last) if last.1 >= start => last.1 = last.1.max(end),
            _ => merged.push((start, end)),
        }
    }
    merged
}
