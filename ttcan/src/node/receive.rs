//! Received frames.

use super::{Fault, MasterState, Node, Pending, Reception, SyncState, bump};
use crate::clock::Correction;
use crate::parts::{GAPS, GLOBAL_TIME, MASTER, PEERS};
use crate::reference::{Fields, from_coarse, nearest};
use crate::schedule::{Entry, Known, Role};
use crate::{ClockState, Frame, GlobalTime, Stamp, length};

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    /// A data frame of another node was received; `stamp` was taken at its end.
    /// Call [`Node::poll`] afterwards.
    #[must_use]
    pub fn handle_receive(&mut self, frame: &Frame, stamp: Stamp) -> Reception {
        let reception = self.take(frame, stamp);
        if let Reception::Fault(fault) = reception {
            self.count_fault(fault);
        }
        reception
    }

    fn take(&mut self, frame: &Frame, stamp: Stamp) -> Reception {
        if self.sync == SyncState::Off {
            return Reception::Fault(Fault::NotInSchedule);
        }
        // The next frame is believed again, whichever of the two was wrong.
        let backwards = !stamp.reached(self.last_receive);
        self.last_receive = stamp;
        if backwards {
            return Reception::Fault(Fault::StampBackwards);
        }
        let end = stamp.offset(self.config.latency.receive.wrapping_neg());
        match self.schedule.reference_rank(frame.id()) {
            Some(Some(rank)) if Some(rank) != self.rank() => self.take_reference(frame, rank, end),
            Some(_) => Reception::Fault(Fault::UnknownMaster),
            None => {
                if MASTER && self.reference_lost {
                    // What won against the reference was no reference.
                    self.reference_lost = false;
                    self.reference_due = Some(stamp);
                }
                if MASTER && !self.marked && !self.initial_watch && self.reference_due.is_some() {
                    // Somebody keeps a schedule, so a reference will come.
                    self.reference_due = Some(stamp.after(self.quiet()));
                }
                self.take_message(frame, end)
            }
        }
    }

    fn count_fault(&mut self, fault: Fault) {
        let counters = &mut self.counters;
        let counter = match fault {
            Fault::NotInSchedule => &mut counters.not_in_schedule,
            Fault::Misplaced => &mut counters.misplaced,
            Fault::Foreign => &mut counters.foreign,
            Fault::Length => &mut counters.wrong_length,
            Fault::MalformedReference => &mut counters.malformed_references,
            Fault::UnknownMaster => &mut counters.unknown_masters,
            Fault::UntimelyReference => &mut counters.untimely_references,
            Fault::StampBackwards => &mut counters.stamps_backwards,
        };
        bump(counter, 1);
    }

    // A function of its own in the image: the bound of a message is without it. In the
    // smallest ones it is better off in its caller.
    #[cfg_attr(feature = "global-time", inline(never))]
    fn take_reference(&mut self, frame: &Frame, rank: u8, end: Stamp) -> Reception {
        let network = self.schedule.network;
        let format = &network.reference_format;
        let Some(fields) = Fields::decode(format, frame, network.cycles) else {
            return Reception::Fault(Fault::MalformedReference);
        };
        let start = Stamp(end.0.wrapping_sub(self.bits(length::frame_bits(frame))));
        let Some(continued) = self.judge_reference(rank, fields.cycle, start) else {
            return Reception::Fault(Fault::UntimelyReference);
        };
        let consecutive = continued && self.is_consecutive(start, fields.cycle);
        if GLOBAL_TIME {
            self.take_time(&fields, start, consecutive);
        }
        if !continued {
            self.sync = SyncState::Synchronising;
        }
        if self.leader.is_some_and(|leader| leader != rank) {
            bump(&mut self.counters.master_changes, 1);
        }
        self.begin_cycle(
            start,
            fields.cycle,
            fields.next_is_gap,
            Some(rank),
            consecutive,
        );
        if PEERS
            && let Some(master) = network.masters.get(usize::from(rank)).copied().flatten()
            && let Some(peer) = self.peers.get_mut(usize::from(master.0))
        {
            peer.seen();
        }
        Reception::Reference {
            cycle: fields.cycle,
            rank,
        }
    }

    /// Whether a reference is believed (`Some`), and whether the schedule goes
    /// on with it (`true`) or has to be found anew.
    fn judge_reference(&self, rank: u8, cycle: u8, start: Stamp) -> Option<bool> {
        let Some(leader) = self.leader.filter(|_| self.marked) else {
            return Some(true);
        };
        let network = self.schedule.network;
        let elapsed = start.ticks_since(self.mark);
        let early = self.clock.ticks(
            network
                .basic_cycle
                .saturating_sub(self.schedule.reference_early()),
        );
        if elapsed >= early.cast_signed() {
            return Some(true);
        }
        if rank > leader {
            // The better-ranked master is in charge, and the other one will
            // hear it within a basic cycle.
            return None;
        }
        // The master saw an error in a reference that this node took, and sent
        // it again.
        let soon = self.clock.ticks(4 * network.reference_length);
        let repeated = rank == leader && cycle == self.cycle;
        Some(repeated && (0..soon.cast_signed()).contains(&elapsed))
    }

    /// Whether a reference directly follows the last one.
    pub(super) fn is_consecutive(&self, start: Stamp, cycle: u8) -> bool {
        let elapsed = start.ticks_since(self.mark);
        let basic_cycle = self.clock.ticks(self.schedule.network.basic_cycle);
        let expected = (basic_cycle / 2).cast_signed()..(basic_cycle / 2 * 3).cast_signed();
        self.marked
            && cycle == self.next_cycle()
            && (self.gap_follows() || expected.contains(&elapsed))
    }

    /// Global time from a reference's coarse time and its mark of the reference
    /// before.
    fn take_time(&mut self, fields: &Fields, start: Stamp, consecutive: bool) {
        let (Some(coarse), Some(mark), true) = (fields.coarse, fields.mark, consecutive) else {
            // Time runs on.
            self.clock.carry(self.mark);
            return;
        };
        let previous = self.mark;
        let between = self.clock.duration(start.ticks_since(previous));
        // The coarse time is rounded down and the reference may have waited for
        // the bus: between them the start lies up to 1 ms and a frame later.
        let known = match self.clock.state() {
            ClockState::Own => None,
            _ => self.clock.at(start),
        };
        let planned = from_coarse(coarse, known).offset(250 << GlobalTime::FRACTION_BITS);
        let time = nearest(planned.offset(-between), mark);
        let step = self.clock.correct(previous, time, fields.discontinuity);
        match step {
            Correction::Applied => {}
            Correction::Stepped => {
                bump(&mut self.counters.time_steps, 1);
            }
            Correction::Suspended => {
                bump(&mut self.counters.drift_refused, 1);
            }
        }
    }

    /// Begins the basic cycle of an accepted reference.
    pub(super) fn begin_cycle(
        &mut self,
        mark: Stamp,
        cycle: u8,
        next_is_gap: bool,
        leader: Option<u8>,
        consecutive: bool,
    ) {
        bump(&mut self.counters.references, 1);
        if self.marked && cycle != self.next_cycle() {
            bump(&mut self.counters.cycle_count_errors, 1);
        }
        if self.pending != Pending::None {
            self.pending = Pending::None;
            self.withdraw_due = None;
            self.abort_due = true;
        }
        if self.sync == SyncState::Synchronising && consecutive {
            self.sync = SyncState::InSchedule;
        }
        self.mark = mark;
        self.marked = true;
        self.cycle = cycle;
        self.cycles_seen = self.cycles_seen.wrapping_add(1);
        let next_is_gap = GAPS && next_is_gap;
        self.gap_follows = next_is_gap;
        self.initial_watch = false;
        self.missed_references = 0;
        if MASTER {
            self.forget_reference();
        }
        if cycle == 0 {
            self.begin_matrix();
        }
        self.begin_entries();
        self.choose_role(leader);
        let wait = if next_is_gap {
            let gap = self.config.longest_gap.ticks();
            self.clock.ticks(gap).wrapping_add(self.missed_after(0))
        } else {
            self.missed_after(1)
        };
        self.missed_due = Some(mark.after(wait));
    }

    /// Checks the budget of the matrix that is over.
    fn begin_matrix(&mut self) {
        let budget = self.schedule.windows_of(self.config.node);
        self.underflow = self.whole_matrix && self.served < budget;
        if self.underflow {
            bump(&mut self.counters.transmit_underflows, 1);
        }
        self.overflow = false;
        self.served = 0;
        self.whole_matrix = self.sync == SyncState::InSchedule;
        self.assess();
    }

    /// Master state and the time of the own reference, after `leader` has sent
    /// one.
    fn choose_role(&mut self, leader: Option<u8>) {
        let before = core::mem::replace(&mut self.leader, leader);
        let (Some(rank), Some(leader)) = (self.rank(), leader) else {
            self.reference_due = None;
            return;
        };
        if rank == leader {
            self.master = MasterState::Current;
            self.reference_offset = core::mem::take(&mut self.trim);
        } else {
            self.trim = 0;
            self.master = MasterState::Backup;
            self.reference_offset = if leader < rank {
                self.initial_offset()
            } else if before == Some(leader) {
                // Earlier each time until this reference begins first.
                self.reference_offset
                    .min(0)
                    .saturating_sub(EARLIER)
                    .max(-127)
            } else {
                0
            };
        }
        self.reference_due = Some(if self.gap_follows() {
            let gap = self.config.longest_gap.ticks();
            let offset = i32::from(self.reference_offset);
            self.instant(gap.wrapping_add_signed(offset))
        } else {
            let instant = self.reference_instant(self.reference_offset);
            let network = self.schedule.network;
            match self.doubt(network.basic_cycle) {
                doubt if doubt <= network.uncertainty => instant,
                // Not before the master's, however fast the own counter.
                doubt => instant.after(self.clock.ticks(doubt)),
            }
        });
    }

    fn take_message(&mut self, frame: &Frame, end: Stamp) -> Reception {
        if self.sync != SyncState::InSchedule {
            if MASTER && self.marked && self.master == MasterState::Current {
                self.doubtful |= !self.fits(frame, end);
            }
            return Reception::Fault(Fault::NotInSchedule);
        }
        if self.is_overdue(end) {
            // The frame may well be in place in a cycle that this node missed.
            return Reception::Fault(Fault::NotInSchedule);
        }
        let (start, entry) = self.locate(frame, end);
        if let Some(entry) = entry {
            return self.take_in_entry(frame, &entry);
        }
        if let Some(last) = self.last
            && last.id == frame.id()
            && !last.seen
            && !self.started_after_last(start)
        {
            // The window was closed before this frame was reported.
            return self.take_from_last(frame, last);
        }
        self.astray(frame)
    }

    /// The latest instant at which a frame can have begun, and the entry of the
    /// schedule that it then lies in. Up to 24 stuff bits may have made it
    /// earlier; to know them costs more than they tell.
    fn locate(&mut self, frame: &Frame, end: Stamp) -> (Stamp, Option<Entry>) {
        let shortest = self.bits(length::shortest_bits(frame.id(), frame.len()));
        let start = Stamp(end.0.wrapping_sub(shortest));
        self.catch_up(start);
        let entry = self.entry().filter(|_| self.inside).copied();
        let uncertainty = self.schedule.network.uncertainty;
        let entry = entry
            .filter(|entry| start.reached(self.instant(entry.start.saturating_sub(uncertainty))));
        (start, entry)
    }

    /// Whether a frame is where the basic cycle of this master has it.
    fn fits(&mut self, frame: &Frame, end: Stamp) -> bool {
        let (_, entry) = self.locate(frame, end);
        entry.is_some_and(|entry| match entry.role {
            Role::Exclusive { id, .. } => id == frame.id(),
            Role::Arbitrating => true,
        })
    }

    /// Whether the next reference should have come before `end`, at which a
    /// frame ended.
    fn is_overdue(&self, end: Stamp) -> bool {
        if self.entry_due.is_some() || self.gap_follows() {
            return false;
        }
        let cycle = self.schedule.network.basic_cycle;
        let expected = self
            .clock
            .ticks(cycle.saturating_sub(self.schedule.reference_early()));
        end.ticks_since(self.mark) > expected.cast_signed()
    }

    /// Whether a frame began after the entry before the cursor's was over.
    fn started_after_last(&self, start: Stamp) -> bool {
        self.schedule
            .entry(self.cursor.wrapping_sub(1))
            .is_none_or(|entry| start.reached(self.instant(entry.end)))
    }

    fn take_in_entry(&mut self, frame: &Frame, entry: &Entry) -> Reception {
        match entry.role {
            Role::Exclusive {
                id, len, sender, ..
            } => {
                if frame.id() != id || sender == self.config.node || self.seen {
                    return self.astray(frame);
                }
                if frame.len() != len {
                    return Reception::Fault(Fault::Length);
                }
                self.seen = true;
                self.hear(sender);
                Reception::Scheduled {
                    window: entry.window,
                }
            }
            Role::Arbitrating => self.take_arbitrated(frame),
        }
    }

    fn take_arbitrated(&mut self, frame: &Frame) -> Reception {
        let Some(known) = self.schedule.known(frame.id()).copied() else {
            return Reception::Fault(Fault::Foreign);
        };
        if known.sender == self.config.node || !(known.is_event || known.retry_late) {
            return self.stray(&known);
        }
        if frame.len() > known.len || (!known.is_event && frame.len() != known.len) {
            return Reception::Fault(Fault::Length);
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

    fn take_from_last(&mut self, frame: &Frame, last: super::Last) -> Reception {
        if frame.len() != last.len {
            return Reception::Fault(Fault::Length);
        }
        self.last = None;
        self.counts.take_back(last.window);
        self.counters.missed_messages = self.counters.missed_messages.wrapping_sub(1);
        self.hear(last.sender);
        self.assess();
        Reception::Scheduled {
            window: last.window,
        }
    }

    fn hear(&mut self, sender: crate::NodeId) {
        bump(&mut self.counters.scheduled, 1);
        if PEERS && let Some(peer) = self.peers.get_mut(usize::from(sender.0)) {
            peer.seen();
        }
    }

    /// A frame that should not be where it is.
    fn astray(&mut self, frame: &Frame) -> Reception {
        let Some(known) = self.schedule.known(frame.id()).copied() else {
            return Reception::Fault(Fault::Foreign);
        };
        self.stray(&known)
    }

    fn stray(&mut self, known: &Known) -> Reception {
        let cycle = self.cycles_seen;
        if PEERS && let Some(peer) = self.peers.get_mut(usize::from(known.sender.0)) {
            peer.astray(cycle);
        }
        Reception::Fault(Fault::Misplaced)
    }
}

/// How much earlier a better-ranked backup tries each time, in microseconds:
/// two bits at 250 kbit/s, enough to begin first.
const EARLIER: i8 = 8;
