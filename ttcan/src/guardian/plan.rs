//! What the guardian knows of the time of the network, and which frame may begin when.

use super::config::{FLAG_BITS, Times};
use super::sender::{Permit, Sender};
use super::watch::{Slot, Window};
use crate::length;
use crate::reference::Fields;
use crate::schedule::{Entry, Role, ScheduleView};
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

/// Where in the schedule the search for the next windows is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub(super) struct Cursor {
    /// Basic cycles behind the one that is known.
    passed: u8,
    at: u16,
}

/// The schedule, and where in it the network is.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Plan<'s> {
    pub(super) schedule: ScheduleView<'s>,
    pub(super) times: Times,
    pub(super) known: Option<Known>,
}

impl<'s> Plan<'s> {
    /// The schedule without a time.
    pub(super) fn new(schedule: ScheduleView<'s>, times: Times) -> Self {
        Self {
            schedule,
            times,
            known: None,
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
            let phase = self.times.reference_phase.cast_signed();
            known.consecutive && (0..phase).contains(&elapsed)
        })
    }

    /// What a message tells about references.
    pub(super) fn note_message(&mut self, start: Stamp) {
        if let Some(known) = &mut self.known {
            let elapsed = start.ticks_since(known.mark);
            known.missed |= elapsed >= self.times.reference_phase.cast_signed();
        }
    }

    /// Forgets the time if no reference came for so long. Returns whether it did.
    pub(super) fn lose(&mut self, now: Stamp) -> bool {
        // A reference cannot lie ahead: nothing was asked for half of the counter's range.
        let ahead = self.known.is_some_and(|known| {
            now.ticks_since(known.mark) < self.times.cycle.cast_signed().wrapping_neg()
        });
        let lost = ahead || self.lost_at().is_some_and(|lost| now.reached(lost));
        if lost {
            self.known = None;
        }
        lost
    }

    /// The last reference was not one that its sender may send. Nodes follow a reference in another master's
    /// name, too. The next one tells which is right.
    pub(super) fn doubt(&mut self) {
        if let Some(known) = &mut self.known {
            known.consecutive = false;
        }
    }

    /// Judges a reference as a node does, so that both follow the same one. Returns whether it begins
    /// a basic cycle in its time, and whether it is followed.
    pub(super) fn take_reference(
        &mut self,
        fields: &Fields,
        rank: u8,
        start: Stamp,
    ) -> (bool, bool) {
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
                return (false, false);
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
            consecutive,
            missed: false,
        });
        (timely, true)
    }

    /// Until when a reference is beside its time, if it can be.
    pub(super) fn untimely_until(&self) -> Option<Stamp> {
        let known = self.known.filter(|known| known.consecutive)?;
        Some(known.mark.after(self.times.reference_phase))
    }

    /// The start of the search for windows in the basic cycle that is known.
    pub(super) fn begin(&self) -> Cursor {
        let first = self
            .known
            .map(|known| self.schedule.entries_of(known.number).0);
        Cursor {
            passed: 0,
            at: first.unwrap_or(0),
        }
    }

    /// Whether there are no more windows until the next reference.
    pub(super) fn is_over(&self, cursor: Cursor) -> bool {
        self.known.is_none_or(|known| {
            cursor.passed > self.times.config.lost || (cursor.passed > 0 && known.next_is_gap)
        })
    }

    /// The basic cycle of the cursor.
    fn cycle(&self, known: Known, cursor: Cursor) -> u8 {
        let cycles = self.schedule.network.cycles;
        known.number.wrapping_add(cursor.passed) & cycles.wrapping_sub(1)
    }

    /// Goes on to the next window, or to the next basic cycle.
    pub(super) fn advance(&self, cursor: &mut Cursor) {
        let Some(known) = self.known else { return };
        cursor.at = cursor.at.wrapping_add(1);
        let (_, end) = self.schedule.entries_of(self.cycle(known, *cursor));
        if cursor.at >= end {
            cursor.passed = cursor.passed.wrapping_add(1);
            let next = self.schedule.entries_of(self.cycle(known, *cursor));
            cursor.at = next.0;
        }
    }

    /// The window at the cursor, and when a frame may begin in it. If the reference of its basic cycle was not
    /// received, that may have begun early by the reference trigger offset, or late by that and
    /// repetitions.
    pub(super) fn window(&self, cursor: Cursor) -> Option<Place<'s>> {
        let known = self.known?;
        let cycle = self.cycle(known, cursor);
        let (_, end) = self.schedule.entries_of(cycle);
        let entry = self.schedule.entry(cursor.at).filter(|_| cursor.at < end)?;
        let times = &self.times;
        let is_due = cursor.passed > 0;
        // Up to 100 basic cycles, which `new` has found to be less than 2^30 ticks.
        let base = u32::from(cursor.passed).wrapping_mul(times.cycle);
        let start = base.wrapping_add(times.ticks(entry.start));
        let last = match entry.role {
            Role::Exclusive { .. } => start.wrapping_add(times.enable),
            Role::Arbitrating => base.wrapping_add(times.ticks(entry.end)),
        };
        let margin = times.margin(last);
        let (early, late) = if is_due {
            (times.offset_limit, times.late)
        } else {
            (0, 0)
        };
        Some(Place {
            entry,
            number: cursor.at,
            cycle,
            is_due,
            mark: known.mark,
            opens: start.saturating_sub(early.wrapping_add(margin)),
            closes: last.wrapping_add(late.wrapping_add(margin)),
            // From there on, the next reference is due.
            phase: base.wrapping_add(times.reference_phase),
        })
    }

    /// When a sender may begin a frame in this window, and how long that may be.
    pub(super) fn slot(&self, place: &Place<'_>, sender: &Sender) -> Option<Slot> {
        if !place.is_for(sender) {
            return None;
        }
        let times = &self.times;
        // A frame has at most 157 bits.
        let (bits, least) = match place.entry.role {
            Role::Exclusive { id, len, .. } => (length::worst_case_bits(id, len), 0),
            Role::Arbitrating => {
                let (shortest, longest) = sender.events?;
                (u32::from(longest), u32::from(shortest))
            }
        };
        let closes = place.closes.checked_sub(times.bits(least))?;
        let closes = closes.min(place.phase.wrapping_sub(1));
        let longest = if place.is_due || sender.rank.is_some() {
            // It may be a reference beside its time, which is counted when it was received.
            bits.max(times.reference_bits)
        } else {
            bits
        };
        (place.opens <= closes).then(|| Slot {
            opens: place.mark.after(place.opens),
            closes: place.mark.after(closes),
            length: times.bits(longest.wrapping_add(FLAG_BITS)),
            window: Window::new(place.number, place.is_due),
        })
    }

    /// What a spell may be that began in this window, or in none.
    pub(super) fn permit(&self, window: Window, sender: &Sender, untimely: bool) -> Permit {
        let Some(entry) = window.entry() else {
            // A master that the guardian does not follow may have the right time.
            return if sender.rank.is_some() {
                Permit::Reference { untimely }
            } else {
                Permit::Short
            };
        };
        if window.is_due() {
            return Permit::Own;
        }
        match self.schedule.entry(entry).map(|entry| entry.role) {
            Some(Role::Exclusive { id, .. }) => Permit::Window(id),
            Some(Role::Arbitrating) => Permit::Arbitrating,
            None => Permit::Short,
        }
    }
}

/// A window of a basic cycle, with times in ticks since the last reference.
pub(super) struct Place<'s> {
    entry: &'s Entry,
    /// Its place in the schedule.
    number: u16,
    cycle: u8,
    is_due: bool,
    mark: Stamp,
    opens: u32,
    closes: u32,
    phase: u32,
}

impl Place<'_> {
    /// Whether a sender may begin a frame in it.
    pub(super) fn is_for(&self, sender: &Sender) -> bool {
        match self.entry.role {
            Role::Exclusive { sender: owner, .. } => owner == sender.node,
            Role::Arbitrating => {
                let (mask, offset) = sender.event_cycles;
                sender.events.is_some() && self.cycle & mask == offset
            }
        }
    }
}
