//! References of other masters, and the beginning of a basic cycle.

use super::counters::bump;
use super::master_role::ANNOUNCEMENTS;
use super::{Fault, Node, Reception, SyncState};
use crate::clock::{ClockState, Correction, Flags};
use crate::features::{GAPS, GLOBAL_TIME, MASTER};
use crate::frame::Frame;
use crate::length;
use crate::reference::{Fields, from_coarse, nearest};
use crate::supervision::Missing;
use crate::time::{GlobalTime, Stamp};

/// Error of a basic cycle's length up to which the time of its beginning is found from the coarse
/// time at its end, in microseconds. With the rounding of the coarse time it stays below the 1024 us
/// of [`nearest`].
const LARGEST_RATE_ERROR: u32 = 200;

/// What a node does with a reference of another master.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Judgement {
    /// It begins the next basic cycle.
    Next,
    /// It begins a basic cycle, and the schedule must be found anew from it.
    Restart,
    Refused,
}

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    // Not inlined: that makes images smaller.
    #[cfg_attr(feature = "global-time", inline(never))]
    pub(super) fn take_reference(&mut self, frame: &Frame, rank: u8, end: Stamp) -> Reception {
        let network = self.setup.network();
        let format = &network.reference_format;
        let Some(fields) = Fields::decode(format, frame, network.cycles) else {
            return self.refuse(Fault::MalformedReference);
        };
        if GAPS && fields.next_is_gap && !self.setup.has_gaps() {
            return self.refuse(Fault::MalformedReference);
        }
        let start = end.before(self.setup.bits(length::frame_bits(frame)));
        let judgement = self.judge_reference(rank, fields.cycle, start);
        if judgement == Judgement::Refused {
            if MASTER {
                // Its sender may lead nodes that do not hear this master yet.
                self.announce_again();
            }
            return self.refuse(Fault::UntimelyReference);
        }
        if judgement == Judgement::Restart {
            self.sync = SyncState::Synchronising;
            if MASTER && GLOBAL_TIME {
                // If this node leads again before it has the other master's time, it announces its
                // own.
                self.master.discontinuity = ANNOUNCEMENTS;
            }
        }
        let consecutive = judgement == Judgement::Next && self.is_consecutive(start, fields.cycle);
        if GLOBAL_TIME {
            let same = self.cycle.master == Some(rank);
            // The mark is that of the reference before on the sender. For a node that is not in
            // schedule, another master's may have been another one.
            let paired = consecutive && (same || self.sync == SyncState::InSchedule);
            self.take_time(&fields, start, paired, same);
        }
        if self.cycle.master.is_some_and(|master| master != rank) {
            bump(&mut self.counters.master_changes, 1);
        }
        self.begin_cycle(start, fields.cycle, fields.next_is_gap, rank, consecutive);
        if GLOBAL_TIME {
            self.cycle.coarse = fields.coarse;
            self.clock.put(Flags::LAST_ANNOUNCES, fields.discontinuity);
        }
        if let Some(master) = network.masters.get(usize::from(rank)).copied().flatten()
            && let Some(peer) = self.supervision.peer(master)
        {
            peer.seen();
        }
        Reception::Reference {
            cycle: fields.cycle,
            rank,
        }
    }

    /// Judges a reference of the master of this rank, whose start of frame was at
    /// `start`.
    fn judge_reference(&self, rank: u8, cycle: u8, start: Stamp) -> Judgement {
        let Some(master) = self.cycle.master else {
            return Judgement::Next;
        };
        let network = self.setup.network();
        let elapsed = start.ticks_since(self.cycle.mark);
        if elapsed >= self.clock.ticks(network.reference_early).cast_signed() {
            return Judgement::Next;
        }
        if rank > master {
            // The better-ranked master is in charge. The other one will receive
            // its reference within a basic cycle, and follow it.
            return Judgement::Refused;
        }
        // The same master repeats its reference: it saw an error in one that this
        // node received.
        let soon = self.clock.ticks(4 * network.reference_length);
        let repeated =
            rank == master && cycle == self.cycle.number && elapsed.cast_unsigned() < soon;
        if repeated {
            Judgement::Next
        } else {
            Judgement::Restart
        }
    }

    /// Whether a reference directly follows the last one.
    pub(super) fn is_consecutive(&self, start: Stamp, cycle: u8) -> bool {
        let elapsed = start.ticks_since(self.cycle.mark);
        let basic_cycle = self.clock.ticks(self.setup.network().basic_cycle);
        let early = elapsed.wrapping_sub(basic_cycle.cast_signed());
        self.cycle.has_begun()
            && cycle == self.setup.cycle_after(self.cycle.number)
            && (self.cycle.next_is_gap() || early.unsigned_abs() < basic_cycle / 2)
    }

    /// Takes global time from the coarse time of a reference, and its mark of the
    /// reference before. `paired` tells that this node received the one before, `same` that it
    /// came from the same master.
    fn take_time(&mut self, fields: &Fields, start: Stamp, paired: bool, same: bool) {
        let previous = self.cycle.mark;
        // A node that has not measured its rate does not know how long it was since the reference
        // before, and takes the coarse time that this one carried. Another master, or a time that
        // was set since, has nothing to do with that one.
        let network = self.setup.network();
        let (coarse, since) = if self.clock.rate_error(network.basic_cycle) <= LARGEST_RATE_ERROR {
            (fields.coarse, start.ticks_since(previous))
        } else if same && (!fields.discontinuity || self.clock.has(Flags::LAST_ANNOUNCES)) {
            (self.cycle.coarse, 0)
        } else {
            if self.clock.state() != ClockState::Unset {
                self.clock.forget_rate();
            }
            (None, 0)
        };
        let (Some(coarse), Some(mark), true) = (coarse, fields.mark, paired) else {
            // Time runs on at the last rate.
            self.clock.carry(previous);
            if fields.discontinuity && self.sync == SyncState::InSchedule {
                self.clock.put(Flags::ANNOUNCED, true);
            }
            return;
        };
        let known = match self.clock.state() {
            ClockState::Own if !self.clock.is_agreed() => None,
            _ => self.clock.at(start),
        };
        // The coarse time is rounded down to 1 ms, and the reference may have waited for the bus: it
        // started up to 1 ms and a frame later than the coarse time says. The middle of that leaves
        // the most for the error of `since`.
        let middle = i64::from((1000 + network.reference_length) / 2);
        let planned = from_coarse(coarse, known).offset(middle << GlobalTime::FRACTION_BITS);
        let time = nearest(planned.offset(-self.clock.duration(since)), mark);
        let before = self.clock.has(Flags::ANNOUNCED);
        self.clock.put(Flags::ANNOUNCED, false);
        let announced = (before, fields.discontinuity);
        // If this node leads next, it repeats the announcement for nodes that did not receive it,
        // or announces that its time is not that of the master before.
        let discontinuity = &mut self.master.discontinuity;
        *discontinuity = ANNOUNCEMENTS;
        match self.clock.correct(previous, time, announced) {
            Correction::Applied => *discontinuity = 0,
            Correction::Stepped => {
                bump(&mut self.counters.time_steps, 1);
            }
            Correction::Postponed => self.clock.put(Flags::ANNOUNCED, true),
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
        master: u8,
        consecutive: bool,
    ) {
        bump(&mut self.counters.references, 1);
        if self.cycle.has_begun() && cycle != self.setup.cycle_after(self.cycle.number) {
            bump(&mut self.counters.cycle_count_errors, 1);
        }
        if !self.transmission.is_idle() {
            self.give_up_pending();
        }
        if self.sync == SyncState::Synchronising && consecutive {
            self.sync = SyncState::InSchedule;
        }
        let before = self.cycle.begin(mark, master, cycle, next_is_gap);
        self.supervision.missing = Missing::InRow(0);
        if MASTER {
            self.forget_attempt();
        }
        if cycle == 0 {
            self.begin_matrix();
        }
        self.begin_entries();
        self.choose_role(before);
        let network = self.setup.network();
        let next = if GAPS && next_is_gap {
            network.longest_gap
        } else {
            network.basic_cycle
        };
        self.agenda.missing_reference = Some(mark.after(self.missing_after(next)));
    }

    /// Checks the transmission budget of the matrix that is over.
    fn begin_matrix(&mut self) {
        let scheduled = self.setup.schedule.windows_of(self.setup.config.node);
        let in_schedule = self.sync == SyncState::InSchedule;
        if !self.supervision.begin_matrix(scheduled, in_schedule) {
            bump(&mut self.counters.transmit_underflows, 1);
        }
    }
}
