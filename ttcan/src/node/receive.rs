//! Received frames, and messages of other nodes.

use super::counters::bump;
use super::master_role::Progress;
use super::position::CurrentWindow;
use super::{Fault, MasterState, Node, Reception, SyncState};
use crate::features::{MASTER, PEERS};
use crate::frame::Frame;
use crate::length;
use crate::matrix::NodeId;
use crate::schedule::{Entry, Known, Role};
use crate::supervision::Missing;
use crate::time::Stamp;

impl<'s, const W: usize, const P: usize, const Q: usize> Node<'s, W, P, Q> {
    /// A data frame of another node was received; `stamp` was taken at its end.
    /// Call [`Node::poll`] afterwards.
    #[must_use]
    pub fn handle_receive(&mut self, frame: &Frame, stamp: Stamp) -> Reception {
        if self.sync == SyncState::Off {
            return self.refuse(Fault::NotInSchedule);
        }
        // One of the two stamps is wrong. The next frame is judged by this one.
        let backwards = !stamp.reached(self.last_received);
        self.last_received = stamp;
        if backwards {
            return self.refuse(Fault::StampBackwards);
        }
        let end = stamp.offset(self.setup.config.latency.receive.wrapping_neg());
        match self.setup.schedule.reference_rank(frame.id()) {
            Some((_, None)) => self.refuse(Fault::UnknownMaster),
            // References with its own rank are for this node to send, although it may not lead.
            Some((_, Some(master))) if MASTER && master == self.setup.config.node => {
                self.refuse(Fault::Impostor)
            }
            Some((rank, _)) => self.take_reference(frame, rank, end),
            None => {
                if MASTER {
                    self.note_message(stamp);
                }
                self.take_message(frame, end)
            }
        }
    }

    /// What a message tells a potential master about references.
    fn note_message(&mut self, stamp: Stamp) {
        // No reference won against this node's own, so that one is due again. Other masters may have waited for the
        // same frame, and would begin together with it. If this node does not have the time, it lets them go first.
        let lost = matches!(self.master.attempt.progress, Progress::Lost(_));
        if lost && self.master.offset != self.setup.untimed_offset {
            self.repeat_lost_reference(stamp);
        }
        let initial = self.supervision.missing == Missing::Initial;
        if !self.cycle.has_begun() && !initial && self.agenda.reference.is_some() {
            // Another node keeps a schedule, so a reference will come.
            self.agenda.reference = Some(stamp.after(self.quiet()));
        }
    }

    /// Counts a frame that is not used.
    #[inline(never)]
    pub(super) fn refuse(&mut self, fault: Fault) -> Reception {
        let counters = &mut self.counters;
        let counter = match fault {
            Fault::NotInSchedule => &mut counters.not_in_schedule,
            Fault::Misplaced => &mut counters.misplaced,
            Fault::Foreign => &mut counters.foreign,
            Fault::Length => &mut counters.wrong_length,
            Fault::MalformedReference => &mut counters.malformed_references,
            Fault::UnknownMaster => &mut counters.unknown_masters,
            Fault::Impostor => &mut counters.impostors,
            Fault::UntimelyReference => &mut counters.untimely_references,
            Fault::StampBackwards => &mut counters.stamps_backwards,
        };
        bump(counter, 1);
        Reception::Fault(fault)
    }

    fn take_message(&mut self, frame: &Frame, end: Stamp) -> Reception {
        if self.sync != SyncState::InSchedule {
            if MASTER && self.cycle.has_begun() && self.master.state == MasterState::Current {
                self.master.attempt.contradicted |= !self.fits(frame, end);
            }
            return self.take_unscheduled(frame);
        }
        if self.is_overdue(end) {
            // The next reference was missed. The frame may be in its window of
            // the basic cycle that this node does not know.
            return self.take_unscheduled(frame);
        }
        let (start, entry) = self.locate(frame, end);
        if let Some(entry) = entry {
            return self.take_in_entry(frame, entry);
        }
        if let Some(entry) = self.missed_entry()
            && let Role::Exclusive {
                id, len, sender, ..
            } = entry.role
            && id == frame.id()
            && !self.started_after_last(start)
        {
            // The window was closed before this frame was reported.
            if frame.len() != len {
                return self.refuse(Fault::Length);
            }
            return self.take_back(entry.window, sender);
        }
        self.take_misplaced(frame)
    }

    /// The latest instant at which a frame can have begun, and the entry of the
    /// schedule in which it lies then. Up to 24 stuff bits may have made the frame
    /// longer, so that it began earlier. They are not counted, because they are
    /// not needed to tell windows apart.
    fn locate(&mut self, frame: &Frame, end: Stamp) -> (Stamp, Option<&'s Entry>) {
        let shortest = self
            .setup
            .bits(length::shortest_bits(frame.id(), frame.len()));
        let start = end.before(shortest);
        self.catch_up(start);
        let entry = self.entry().filter(|_| self.position.in_window());
        let uncertainty = self.setup.network().uncertainty;
        let entry = entry
            .filter(|entry| start.reached(self.instant(entry.start.saturating_sub(uncertainty))));
        (start, entry)
    }

    /// Whether a frame is in a window that the basic cycle of this master has for
    /// it.
    fn fits(&mut self, frame: &Frame, end: Stamp) -> bool {
        let (_, entry) = self.locate(frame, end);
        entry.is_some_and(|entry| match entry.role {
            Role::Exclusive { id, .. } => id == frame.id(),
            Role::Arbitrating => true,
        })
    }

    /// Whether the next reference should have come before `end`, at which a frame
    /// ended.
    fn is_overdue(&self, end: Stamp) -> bool {
        if self.agenda.time_mark.is_some() || self.cycle.next_is_gap() {
            return false;
        }
        let expected = self.clock.ticks(self.setup.network().reference_early);
        end.ticks_since(self.cycle.mark) > expected.cast_signed()
    }

    /// The last entry that ended, if it was for a message of another node that was not seen.
    fn missed_entry(&self) -> Option<&'s Entry> {
        let last = self.position.cursor.wrapping_sub(1);
        let entry = self.setup.schedule.entry(last);
        entry.filter(|_| self.position.missed)
    }

    /// Whether a frame began after the end of the last window.
    fn started_after_last(&self, start: Stamp) -> bool {
        self.setup
            .schedule
            .entry(self.position.cursor.wrapping_sub(1))
            .is_none_or(|entry| start.reached(self.instant(entry.end)))
    }

    fn take_in_entry(&mut self, frame: &Frame, entry: &Entry) -> Reception {
        match entry.role {
            Role::Exclusive {
                id, len, sender, ..
            } => {
                let seen = self.position.window == CurrentWindow::ExclusiveSeen;
                if frame.id() != id || sender == self.setup.config.node || seen {
                    return self.take_misplaced(frame);
                }
                if frame.len() != len {
                    return self.refuse(Fault::Length);
                }
                self.position.window = CurrentWindow::ExclusiveSeen;
                self.hear(sender);
                Reception::Scheduled {
                    window: entry.window,
                }
            }
            Role::Arbitrating => self.take_arbitrated(frame),
        }
    }

    fn take_arbitrated(&mut self, frame: &Frame) -> Reception {
        let Some(known) = self.setup.schedule.known(frame.id()).copied() else {
            return self.refuse(Fault::Foreign);
        };
        if self.is_own(&known) || !(known.is_event || known.retry_late) {
            return self.misplaced(&known);
        }
        if frame.len() > known.len || (!known.is_event && frame.len() != known.len) {
            return self.refuse(Fault::Length);
        }
        bump(&mut self.counters.events, 1);
        if known.is_event {
            Reception::Event
        } else {
            Reception::Late {
                window: known.window,
            }
        }
    }

    /// Takes a message whose window was closed and noted as missed.
    fn take_back(&mut self, window: u16, sender: NodeId) -> Reception {
        self.position.missed = false;
        self.supervision.take_back(window);
        self.counters.missed_messages = self.counters.missed_messages.wrapping_sub(1);
        self.hear(sender);
        Reception::Scheduled { window }
    }

    fn hear(&mut self, sender: NodeId) {
        bump(&mut self.counters.scheduled, 1);
        if let Some(peer) = self.supervision.peer(sender) {
            peer.seen();
        }
    }

    /// A frame while this node is not in schedule.
    fn take_unscheduled(&mut self, frame: &Frame) -> Reception {
        let known = PEERS.then(|| self.setup.schedule.known(frame.id()));
        let fault = match known.flatten() {
            Some(known) if self.is_own(known) => Fault::Impostor,
            _ => Fault::NotInSchedule,
        };
        self.refuse(fault)
    }

    /// Whether only this node sends a message.
    fn is_own(&self, known: &Known) -> bool {
        known.sender == self.setup.config.node
    }

    /// A frame that is not in a window of its own.
    fn take_misplaced(&mut self, frame: &Frame) -> Reception {
        let Some(known) = self.setup.schedule.known(frame.id()).copied() else {
            return self.refuse(Fault::Foreign);
        };
        self.misplaced(&known)
    }

    fn misplaced(&mut self, known: &Known) -> Reception {
        if PEERS && self.is_own(known) {
            return self.refuse(Fault::Impostor);
        }
        let cycle = self.cycle.count;
        if let Some(peer) = self.supervision.peer(known.sender) {
            peer.misplaced(cycle);
        }
        self.refuse(Fault::Misplaced)
    }
}
