//! Own transmissions and their ends.

use super::{Node, Pending, SyncState, TransmitOutcome, bump};
use crate::parts::{EVENTS, GLOBAL_TIME, MASTER};
use crate::{ClockState, Frame, Stamp, length};

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    /// The transmission that the node asked for last has ended; `stamp` was
    /// taken at its end (of no importance for [`TransmitOutcome::Empty`] and
    /// [`TransmitOutcome::Aborted`]). Call [`Node::poll`] afterwards.
    pub fn handle_transmit(&mut self, outcome: TransmitOutcome, stamp: Stamp) {
        let pending = core::mem::replace(&mut self.pending, Pending::None);
        if pending != Pending::None {
            self.withdraw_due = None;
        }
        self.count_failure(outcome);
        match pending {
            // An abort may come too late to withdraw anything.
            Pending::None if outcome == TransmitOutcome::Aborted => {}
            Pending::None => {
                bump(&mut self.counters.stray_reports, 1);
            }
            Pending::Reference {
                frame,
                cycle,
                next_is_gap,
                discontinuity,
                asked,
            } => {
                if MASTER {
                    self.end_reference(
                        outcome,
                        stamp,
                        (&frame, cycle, next_is_gap, discontinuity, asked),
                    );
                }
            }
            Pending::Window {
                window,
                id,
                len,
                retry_late,
            } => match outcome {
                TransmitOutcome::Sent => {
                    bump(&mut self.counters.sent, 1);
                    self.counts.note(window, true, true);
                    self.assess();
                }
                TransmitOutcome::Empty => {
                    bump(&mut self.counters.left_empty, 1);
                }
                TransmitOutcome::ArbitrationLost
                | TransmitOutcome::Error
                | TransmitOutcome::Aborted => self.fail_own(window, id, len, retry_late, stamp),
            },
            Pending::Event { .. } if !EVENTS => {}
            Pending::Event { place } => match outcome {
                TransmitOutcome::Sent => {
                    bump(&mut self.counters.events_sent, 1);
                    self.queue.remove(place);
                }
                // A late message that its owner does not want to send any more.
                TransmitOutcome::Empty => self.queue.remove(place),
                TransmitOutcome::ArbitrationLost | TransmitOutcome::Error => {}
                TransmitOutcome::Aborted => self.events_held = true,
            },
        }
        self.attend_events();
    }

    // A function of its own in the image: the bound of a message is without it.
    #[inline(never)]
    fn end_reference(
        &mut self,
        outcome: TransmitOutcome,
        stamp: Stamp,
        (frame, cycle, next_is_gap, discontinuity, asked): (&Frame, u8, bool, bool, Stamp),
    ) {
        match outcome {
            TransmitOutcome::Sent => {
                let length = self.bits(length::frame_bits(frame)).cast_signed();
                let latency = self.config.latency.transmit;
                let start = stamp.offset(length.wrapping_add(latency).wrapping_neg());
                if discontinuity {
                    self.leap = false;
                }
                if next_is_gap {
                    self.gap_wanted = false;
                }
                self.lead(start, asked, cycle, next_is_gap);
            }
            TransmitOutcome::ArbitrationLost => {
                self.reference_lost = true;
                self.asked = Some(asked);
            }
            TransmitOutcome::Error | TransmitOutcome::Aborted | TransmitOutcome::Empty => {
                self.counters.repeated_references =
                    self.counters.repeated_references.wrapping_add(1);
                // At once, unless the controller did not even take it.
                self.reference_due = Some(match outcome {
                    TransmitOutcome::Error => stamp,
                    _ => stamp.after(self.clock.ticks(self.schedule.network.transmit_enable)),
                });
                // An error this early destroyed a frame that began on time:
                // no other reference was on the bus.
                let id = self.schedule.network.reference;
                let shortest = self.bits(length::shortest_bits(id, 1));
                let on_time = outcome == TransmitOutcome::Error
                    && stamp.ticks_since(asked) < shortest.cast_signed();
                self.asked = if on_time { None } else { Some(asked) };
            }
        }
    }

    fn count_failure(&mut self, outcome: TransmitOutcome) {
        let counter = match outcome {
            TransmitOutcome::Sent | TransmitOutcome::Empty => return,
            TransmitOutcome::ArbitrationLost => &mut self.counters.arbitration_lost,
            TransmitOutcome::Error => &mut self.counters.transmit_errors,
            TransmitOutcome::Aborted => &mut self.counters.aborted,
        };
        bump(counter, 1);
    }

    /// The own reference was sent, with its start of frame at `start` after it
    /// was asked for at `asked`.
    fn lead(&mut self, start: Stamp, asked: Stamp, cycle: u8, next_is_gap: bool) {
        // Others disagree on where the basic cycle is; believe them for a while.
        self.doubts = if self.doubtful {
            self.doubts.saturating_add(1)
        } else {
            0
        };
        let disputed = (1..=self.config.watch).contains(&self.doubts);
        let consecutive = self.is_consecutive(start, cycle) && !disputed;
        if GLOBAL_TIME && matches!(self.clock.state(), ClockState::Unset) {
            self.clock.set(start, Default::default());
        } else {
            self.clock.carry(start);
        }
        // The bus was taken when it should have been idle: perhaps by another
        // master's reference that this node alone did not receive, and this is
        // not the basic cycle that the others are in. The next reference tells.
        let enabled = self.clock.ticks(self.schedule.network.transmit_enable);
        let expected = asked.after(self.config.transmit_lead).after(enabled);
        if start.reached(expected) {
            self.sync = SyncState::Synchronising;
            self.begin_cycle(start, cycle, next_is_gap, self.rank(), false);
        } else {
            self.begin_cycle(start, cycle, next_is_gap, self.rank(), consecutive);
        }
    }
}
