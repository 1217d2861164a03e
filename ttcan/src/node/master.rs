//! A potential time master: its references, and what its application asks.

#[cfg(feature = "master")]
use super::NotInCharge;
use super::counters::bump;
use super::master_role::{ANNOUNCEMENTS, Attempt, Progress};
use super::transmission::{OwnReference, Pending};
use super::{Action, MasterState, Node, SyncState, TransmitOutcome};
use crate::features::GLOBAL_TIME;
use crate::length;
use crate::reference::{Fields, from_coarse, mark_of};
use crate::time::{GlobalTime, Stamp};

#[cfg(feature = "master")]
impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    /// Largest change of a basic cycle by [`Node::trim_cycle`], in microseconds:
    /// half of the default reference trigger offset between two ranks.
    pub const LARGEST_TRIM: i8 = 8;

    /// Sets the bytes that the application sends in front of its references, from
    /// the next one on. Bytes beyond those that the format leaves to the
    /// application are ignored.
    pub fn set_reference_payload(&mut self, bytes: &[u8]) {
        let room = usize::from(self.setup.network().reference_format.application());
        for (to, from) in self.master.payload.iter_mut().take(room).zip(bytes) {
            *to = *from;
        }
    }

    /// Makes the next reference announce a gap (Next_is_Gap). The schedule then
    /// stops at the end of that basic cycle until [`Node::end_gap`].
    ///
    /// # Errors
    /// This node is not the current time master, or the network has no gaps
    /// ([`MatrixConfig::longest_gap`](crate::MatrixConfig::longest_gap)).
    #[cfg(feature = "gaps")]
    pub fn request_gap(&mut self) -> Result<(), NotInCharge> {
        self.in_charge()?;
        if !self.setup.has_gaps() {
            return Err(NotInCharge);
        }
        self.master.gap_wanted = true;
        Ok(())
    }

    /// The event that ends a gap: the reference is sent at once, or as soon as
    /// the basic cycle before the gap is over. Also cancels a requested gap that
    /// is not announced yet.
    ///
    /// # Errors
    /// This node is not the current time master.
    #[cfg(feature = "gaps")]
    pub fn end_gap(&mut self, now: Stamp) -> Result<(), NotInCharge> {
        self.in_charge()?;
        self.master.gap_wanted = false;
        if self.cycle.next_is_gap() && self.transmission.is_idle() {
            let earliest = self.reference_instant(0);
            let due = if now.reached(earliest) { now } else { earliest };
            self.agenda.reference = Some(due);
        }
        Ok(())
    }

    /// Makes the basic cycle after the current one longer by `micros`, or shorter
    /// if negative. The current time master can thereby follow an event that
    /// recurs at the rate of its basic cycles, such as the measurements of a
    /// satellite receiver. Global time is not affected.
    ///
    /// The change is limited to [`Node::LARGEST_TRIM`] either way, so that no
    /// backup takes over and no windows overlap.
    ///
    /// # Errors
    /// This node is not the current time master.
    pub fn trim_cycle(&mut self, micros: i8) -> Result<(), NotInCharge> {
        self.in_charge()?;
        self.master.trim = micros.clamp(-Self::LARGEST_TRIM, Self::LARGEST_TRIM);
        Ok(())
    }

    /// Sets the global time of the instant `stamp`. The next three references announce
    /// a discontinuity to all nodes. A potential master may do this before the
    /// first reference, too; if that comes from another master, the node takes
    /// the other master's time instead.
    ///
    /// # Errors
    /// Another node is the time master.
    #[cfg(feature = "global-time")]
    pub fn set_global_time(&mut self, stamp: Stamp, time: GlobalTime) -> Result<(), NotInCharge> {
        let no_master = !self.cycle.has_begun() && self.setup.rank().is_some();
        if !no_master {
            self.in_charge()?;
        }
        self.clock.set(stamp, time);
        self.master.discontinuity = ANNOUNCEMENTS;
        Ok(())
    }

    fn in_charge(&self) -> Result<(), NotInCharge> {
        if self.master.state == MasterState::Current {
            Ok(())
        } else {
            Err(NotInCharge)
        }
    }
}

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    // Not inlined: that makes images smaller.
    #[inline(never)]
    pub(super) fn transmit_reference(&mut self, now: Stamp) -> Action {
        self.agenda.reference = None;
        let network = self.setup.network();
        if GLOBAL_TIME && self.clock.sent_at(now).is_none() {
            self.assume_time(now);
        }
        let start = now.after(self.setup.config.transmit_lead);
        let begun = self.cycle.has_begun();
        let fields = Fields {
            next_is_gap: self.master.gap_wanted,
            discontinuity: self.announces(),
            cycle: if begun {
                self.setup.cycle_after(self.cycle.number)
            } else {
                0
            },
            coarse: self.clock.sent_at(start).map(|time| time.as_millis()),
            mark: if begun {
                self.clock.sent_at(self.cycle.mark).map(mark_of)
            } else {
                None
            },
        };
        let rank = self.setup.rank().unwrap_or(0);
        if rank > 0 || self.master.state != MasterState::Current {
            // If another master's reference is on the bus already, this one would follow it
            // three bits after its end, which is sooner than it can be read.
            self.agenda.withdrawal = Some(now.after(self.clock.ticks(network.transmit_enable)));
        }
        let id = network.reference.of_rank(rank);
        let frame = fields.encode(&network.reference_format, id, &self.master.payload);
        self.transmission.pending = Pending::Reference(OwnReference {
            frame,
            cycle: fields.cycle,
            next_is_gap: fields.next_is_gap,
            discontinuity: fields.discontinuity,
            requested: self.master.attempt.progress.requested().unwrap_or(now),
        });
        Action::TransmitReference(frame)
    }

    /// Whether this node's next reference announces a discontinuity of global time.
    fn announces(&self) -> bool {
        GLOBAL_TIME
            && self.setup.network().tells_time
            && (self.master.discontinuity > 0 || !self.clock.is_agreed())
    }

    /// Announces this node's time in its next references, if it leads: other nodes may have
    /// another time.
    pub(super) fn announce_again(&mut self) {
        if GLOBAL_TIME && self.master.state == MasterState::Current {
            self.master.discontinuity = ANNOUNCEMENTS;
        }
    }

    /// Sets a time before this node must lead without one. Of the last reference, only the time at
    /// which it was planned is known: it started up to 1 ms and a frame later. The latest start is
    /// assumed, so that the time of the other nodes does not go back. Without a reference, the time
    /// begins with 0.
    fn assume_time(&mut self, now: Stamp) {
        match self.cycle.coarse {
            Some(coarse) => {
                let late = i64::from(1000 + self.setup.network().reference_length);
                let time = from_coarse(coarse, None).offset(late << GlobalTime::FRACTION_BITS);
                self.clock.assume(self.cycle.mark, time);
            }
            None => self.clock.assume(now, GlobalTime::default()),
        }
    }

    // Not inlined: that makes images smaller.
    #[inline(never)]
    pub(super) fn end_reference(
        &mut self,
        outcome: TransmitOutcome,
        stamp: Stamp,
        own: &OwnReference,
    ) {
        match outcome {
            TransmitOutcome::Sent => {
                let length = self
                    .setup
                    .bits(length::frame_bits(&own.frame))
                    .cast_signed();
                let latency = self.setup.config.latency.transmit;
                let start = stamp.offset(length.wrapping_add(latency).wrapping_neg());
                if own.discontinuity {
                    let left = if self.clock.is_agreed() {
                        self.master.discontinuity
                    } else {
                        ANNOUNCEMENTS
                    };
                    self.master.discontinuity = left.saturating_sub(1);
                }
                if own.next_is_gap {
                    self.master.gap_wanted = false;
                }
                self.lead(start, own);
            }
            TransmitOutcome::ArbitrationLost => {
                self.master.attempt.progress = Progress::Lost(own.requested);
            }
            TransmitOutcome::Aborted
                if matches!(self.master.attempt.progress, Progress::Lost(_)) => {}
            TransmitOutcome::Error | TransmitOutcome::Aborted | TransmitOutcome::Empty => {
                bump(&mut self.counters.repeated_references, 1);
                self.master.attempt.missed_while_pending = false;
                // Again at once, unless the controller did not even take it.
                self.agenda.reference = Some(match outcome {
                    TransmitOutcome::Error => stamp,
                    _ => stamp.after(self.clock.ticks(self.setup.network().transmit_enable)),
                });
                // If the error came earlier than the shortest reference ends,
                // the destroyed frame was this one and had begun on time. No
                // other master's reference was on the bus then.
                let id = self.setup.network().reference;
                let shortest = self.setup.bits(length::shortest_bits(id, 1));
                let on_time = outcome == TransmitOutcome::Error
                    && stamp.ticks_since(own.requested) < shortest.cast_signed();
                self.master.attempt.progress = if on_time {
                    Progress::None
                } else {
                    Progress::Repeated(own.requested)
                };
            }
        }
    }

    /// Begins the basic cycle of this node's reference, whose start of frame was
    /// at `start`.
    fn lead(&mut self, start: Stamp, own: &OwnReference) {
        // The other nodes disagree on where the basic cycle is. This node yields
        // for some basic cycles, and finds the schedule anew from references.
        let disputed = self.master.is_disputed(self.setup.config.watch);
        let consecutive = self.is_consecutive(start, own.cycle) && !disputed;
        self.clock.lead(start);
        // A late start means that the bus was taken when it should have been
        // idle, perhaps by the reference of another master that only this node
        // did not receive. The other nodes are then in another basic cycle. The
        // next reference tells.
        let enabled = self.clock.ticks(self.setup.network().transmit_enable);
        let lead = self.setup.config.transmit_lead;
        let latest = own.requested.after(lead).after(enabled);
        let late = start.reached(latest);
        if late {
            self.sync = SyncState::Synchronising;
        }
        let rank = self.setup.rank().unwrap_or(0);
        self.begin_cycle(
            start,
            own.cycle,
            own.next_is_gap,
            rank,
            consecutive && !late,
        );
    }

    /// Takes the master state and the time of the next own reference from the
    /// reference of the current basic cycle. `before` is the master of the one
    /// before.
    pub(super) fn choose_role(&mut self, before: Option<u8>) {
        let (Some(own), Some(sender)) = (self.setup.rank(), self.cycle.master) else {
            self.agenda.reference = None;
            return;
        };
        let initial = self.setup.initial_offset;
        self.master.follow(own, sender, before, initial);
        if self.must_wait_for_time() {
            self.master.offset = self.setup.untimed_offset;
        }
        let network = self.setup.network();
        let mut due = network.basic_cycle;
        // A better-ranked master does not wait for the end of a gap.
        if self.cycle.next_is_gap() && sender <= own {
            due = network.longest_gap;
        } else {
            let error = self.rate_error(due);
            if error > network.uncertainty {
                // Not before the master's reference, even if this node's
                // counter is as fast as the drift limit allows.
                due = due.wrapping_add(error);
            }
        }
        let offset = i32::from(self.master.offset);
        self.agenda.reference = Some(self.instant(due.wrapping_add_signed(offset)));
    }

    /// Whether this node does not have the time of the master that it hears. It then waits behind
    /// all other potential masters, which may have it: if this node led, it would have to set the
    /// time of all nodes.
    fn must_wait_for_time(&self) -> bool {
        GLOBAL_TIME
            && self.setup.network().tells_time
            && self.master.state == MasterState::Backup
            && !self.clock.is_agreed()
    }

    /// Notes that a pending reference is being withdrawn: another frame was on the bus when
    /// it was due.
    pub(super) fn lose_withdrawn_reference(&mut self) {
        if let Pending::Reference(own) = &self.transmission.pending {
            self.master.attempt.progress = Progress::Lost(own.requested);
        }
    }

    /// Makes this node's reference due again at `now` if it lost arbitration and no
    /// reference was received since.
    pub(super) fn repeat_lost_reference(&mut self, now: Stamp) {
        if let Progress::Lost(requested) = self.master.attempt.progress {
            self.master.attempt.progress = Progress::Repeated(requested);
            self.agenda.reference = Some(now);
        }
    }

    /// Forgets the attempts of the basic cycle before.
    pub(super) fn forget_attempt(&mut self) {
        self.master.attempt = Attempt::NONE;
    }
}
