//! What the guardian knows of the time of the network, and which frame may begin when.

use super::config::{FLAG_BITS, Times};
use super::sender::{Permit, Sender};
use crate::length;
use crate::reference::Fields;
use crate::schedule::{Role, ScheduleView};
use crate::time::Stamp;

/// The basic cycle that the guardian knows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Known {
    /// Start of frame of the reference.
    pub(super) mark: Stamp,
    pub(super) number: u8,
    master: u8,
    next_is_gap: bool,
    /// Whether it followed from the one before.
    pub(super) consecutive: bool,
    /// A message was received when the next reference was due: that one was missed, and its basic
    /// cycle runs.
    missed: bool,
}

/// An instant in the schedule, and the windows in which a frame may begin then.
pub(super) struct Moment {
    cycle: u8,
    /// Time since the basic cycle began, in ticks, and how much later than that its windows may end.
    elapsed: u32,
    late: u32,
    /// First window, and one past the last.
    first: u16,
    end: u16,
    /// Whether the next reference is due, and may have been missed.
    is_due: bool,
    /// Whether a reference is beside its time.
    untimely: bool,
}

/// The schedule, and where in it the network is.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Plan<'s> {
    pub(super) schedule: ScheduleView<'s>,
    pub(super) times: Times,
    pub(super) known: Option<Known>,
    /// First entry of the basic cycle that has not passed, and one past the last one.
    cursor: (u16, u16),
}

impl<'s> Plan<'s> {
    /// The schedule without a time.
    pub(super) fn new(schedule: ScheduleView<'s>, times: Times) -> Self {
        Self {
            schedule,
            times,
            known: None,
            cursor: (0, 0),
        }
    }

    /// When the time is lost unless a reference comes.
    pub(super) fn lost_at(&self) -> Option<Stamp> {
        self.known.map(|known| {
            let gap = if known.next_is_gap { self.times.gap } else { 0 };
            known.mark.after(self.times.lost.wrapping_add(gap))
        })
    }

    /// Whether the guardian is sure of the windows at `now`: the current basic cycle followed from
    /// the one before, and the next reference is not due yet.
    pub(super) fn is_trusted(&self, now: Stamp) -> bool {
        self.known.is_some_and(|known| {
            let elapsed = now.ticks_since(known.mark);
            known.consecutive && elapsed < self.times.reference_phase.cast_signed()
        })
    }

    /// What a message tells about references.
    pub(super) fn note_message(&mut self, start: Stamp) {
        if let Some(known) = &mut self.known {
            let elapsed = start.ticks_since(known.mark);
            known.missed |= elapsed >= self.times.reference_phase.cast_signed();
        }
    }

    /// Judges a reference as a node does, so that both follow the same one. Returns whether it begins
    /// a basic cycle in its time.
    pub(super) fn take_reference(
        &mut self,
        fields: &Fields,
        rank: u8,
        start: Stamp,
        genuine: bool,
    ) -> bool {
        let mut consecutive = false;
        let mut timely = true;
        if let Some(known) = self.known {
            let elapsed = start.ticks_since(known.mark);
            let next = known.number.wrapping_add(1) & self.schedule.network.cycles.wrapping_sub(1);
            // The nodes follow the reference that the guardian missed, and refuse one of a master that
            // missed it, too: a backup, or the master before.
            let earliest = if known.missed && rank >= known.master {
                self.times.earliest.wrapping_add(self.times.cycle)
            } else {
                self.times.earliest
            };
            if elapsed >= earliest.cast_signed() {
                // A worse-ranked master that begins later than behind a frame may have missed a
                // reference together with the guardian, and the nodes do not follow it.
                let allowance = if rank > known.master {
                    self.times.takeover
                } else {
                    self.times.late
                };
                let late = self.times.cycle.wrapping_add(allowance);
                let in_time = elapsed <= late.cast_signed() || known.next_is_gap;
                consecutive = in_time && fields.cycle == next;
            } else if rank > known.master {
                return false;
            } else {
                let soon = self.times.repeated.cast_signed();
                let repeated = rank == known.master && fields.cycle == known.number;
                let repeated = repeated && (0..soon).contains(&elapsed);
                consecutive = repeated && known.consecutive;
                timely = false;
            }
        }
        self.known = Some(Known {
            mark: start,
            number: fields.cycle,
            master: rank,
            next_is_gap: fields.next_is_gap,
            // Nodes follow a reference in another master's name, too. The next one tells which is right.
            consecutive: consecutive && genuine,
            missed: false,
        });
        self.cursor = self.schedule.entries_of(fields.cycle);
        timely
    }

    /// Where in the schedule `began` is.
    pub(super) fn moment(&mut self, began: Stamp) -> Moment {
        let mut moment = Moment {
            cycle: 0,
            elapsed: 0,
            late: 0,
            first: 0,
            end: 0,
            is_due: false,
            untimely: false,
        };
        let Some(known) = self.known else {
            return moment;
        };
        let times = &self.times;
        let elapsed = began.ticks_since(known.mark).max(0).cast_unsigned();
        let margin = times.margin(elapsed);
        moment.is_due = elapsed >= times.reference_phase;
        if moment.is_due && known.next_is_gap {
            return moment;
        }
        let (early, (first, last)) = if moment.is_due {
            // The windows of the basic cycle whose reference the guardian did not receive. It may have
            // begun early by the reference trigger offset, or late by that and repetitions.
            let early = times.offset_limit.wrapping_add(margin);
            let passed = elapsed.wrapping_add(early) / times.cycle.max(1);
            let number = known.number.wrapping_add(passed as u8);
            moment.cycle = number & self.schedule.network.cycles.wrapping_sub(1);
            let elapsed = elapsed.wrapping_sub(passed.wrapping_mul(times.cycle));
            // The basic cycle begins when this is 0, and the search some time before.
            moment.elapsed = elapsed.cast_signed().max(0).cast_unsigned();
            moment.late = times.late.wrapping_add(margin);
            (early, self.schedule.entries_of(moment.cycle))
        } else {
            moment.cycle = known.number;
            moment.elapsed = elapsed;
            moment.late = margin;
            moment.untimely = known.consecutive;
            (margin, self.cursor)
        };
        let mut at = first;
        // loop-bound: windows=64. One turn for each window that has passed since the last spell, or, while a
        // reference is due, since the basic cycle began.
        while at < last
            && let Some(entry) = self.schedule.entry(at)
            && times.ticks(entry.end).wrapping_add(moment.late) < moment.elapsed
        {
            at = at.wrapping_add(1);
        }
        moment.first = at;
        if !moment.is_due {
            self.cursor.0 = at;
        }
        let latest = moment.elapsed.wrapping_add(early);
        // loop-bound: overlapping=64. One turn for each window that may have begun: two that touch overlap by the
        // margin.
        while at < last
            && let Some(entry) = self.schedule.entry(at)
            && self.times.ticks(entry.start) <= latest
        {
            at = at.wrapping_add(1);
        }
        moment.end = at;
        moment
    }

    /// What a spell that a sender has begun at this moment may be, and until when the sender may drive
    /// if a look found it at `now`.
    pub(super) fn permit(&self, moment: &Moment, sender: &Sender, now: Stamp) -> (Permit, Stamp) {
        let times = &self.times;
        let spell = u32::from(times.config.spell_bits);
        let is_master = sender.rank.is_some();
        let (permit, bits) = match self.window_permit(moment, sender) {
            // A master that the guardian does not follow may have the right time.
            None if is_master => {
                let untimely = moment.untimely;
                (Permit::Reference { untimely }, spell)
            }
            None => (Permit::Short, spell),
            Some((permit, bits)) => {
                let longest = if moment.is_due || is_master {
                    // It may be a reference beside its time, which is counted when it was received.
                    bits.max(times.reference_bits)
                } else {
                    bits
                };
                let permit = if moment.is_due { Permit::Own } else { permit };
                (permit, longest.wrapping_add(FLAG_BITS))
            }
        };
        (permit, now.after(times.bits(bits)))
    }

    /// The frame that a sender may begin in a window of a moment, and its longest length in bits, at most
    /// 157.
    fn window_permit(&self, moment: &Moment, sender: &Sender) -> Option<(Permit, u32)> {
        let times = &self.times;
        let mut at = moment.first;
        // loop-bound: overlapping=64. The same windows.
        while at < moment.end {
            let entry = self.schedule.entry(at)?;
            match entry.role {
                Role::Exclusive {
                    id,
                    len,
                    sender: owner,
                    ..
                } if owner == sender.node => {
                    let latest = times.ticks(entry.start).wrapping_add(times.enable);
                    if moment.elapsed <= latest.wrapping_add(moment.late) {
                        return Some((Permit::Window(id), length::worst_case_bits(id, len)));
                    }
                }
                Role::Exclusive { .. } => {}
                Role::Arbitrating => {
                    let (mask, offset) = sender.event_cycles;
                    if let Some((shortest, longest)) = sender.events
                        && moment.cycle & mask == offset
                    {
                        let shortest = times.bits(u32::from(shortest));
                        let end = times.ticks(entry.end).wrapping_add(moment.late);
                        if moment.elapsed.wrapping_add(shortest) <= end {
                            return Some((Permit::Arbitrating, u32::from(longest)));
                        }
                    }
                }
            }
            at = at.wrapping_add(1);
        }
        None
    }
}
