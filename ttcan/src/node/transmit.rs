//! Own messages in exclusive windows, and the ends of all transmissions.

use super::agenda::Order;
use super::counters::bump;
use super::position::CurrentWindow;
use super::transmission::{OwnMessage, Pending};
use super::{Action, Grant, Node, SyncState, TransmitOutcome};
use crate::features::{EVENTS, MASTER};
use crate::queue::Item;
use crate::schedule::Entry;
use crate::supervision::ErrorLevel;
use crate::time::Stamp;

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    /// The transmission that was requested last has ended. `stamp` was taken at
    /// its end; it does not matter for [`TransmitOutcome::Empty`] and
    /// [`TransmitOutcome::Aborted`]. Call [`Node::poll`] afterwards.
    pub fn handle_transmit(&mut self, outcome: TransmitOutcome, stamp: Stamp) {
        let pending = core::mem::replace(&mut self.transmission.pending, Pending::None);
        if pending != Pending::None {
            self.agenda.withdrawal = None;
        }
        self.count_failure(outcome);
        match pending {
            // An abort may come too late to withdraw anything.
            Pending::None if outcome == TransmitOutcome::Aborted => {}
            Pending::None => {
                bump(&mut self.counters.stray_reports, 1);
            }
            Pending::Abandoned => {}
            Pending::Reference(own) => {
                if MASTER {
                    self.end_reference(outcome, stamp, &own);
                }
            }
            Pending::Window(own) => match outcome {
                TransmitOutcome::Sent => {
                    bump(&mut self.counters.sent, 1);
                    self.supervision.note(own.window, true, true);
                }
                TransmitOutcome::Empty => {
                    bump(&mut self.counters.left_empty, 1);
                }
                TransmitOutcome::ArbitrationLost
                | TransmitOutcome::Error
                | TransmitOutcome::Aborted => self.fail_own(&own, stamp),
            },
            Pending::Event { .. } if !EVENTS => {}
            Pending::Event { place } => match outcome {
                TransmitOutcome::Sent => {
                    bump(&mut self.counters.events_sent, 1);
                    self.transmission.queue.remove(place);
                }
                // A late message that its owner does not want to send any more.
                TransmitOutcome::Empty => self.transmission.queue.remove(place),
                TransmitOutcome::ArbitrationLost | TransmitOutcome::Error => {}
                TransmitOutcome::Aborted => {
                    if self.position.window == CurrentWindow::Arbitrating {
                        self.position.window = CurrentWindow::ArbitratingHeld;
                    }
                }
            },
        }
        self.schedule_event();
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

    /// Begins an own window, whose time mark was at `start`.
    pub(super) fn open_own(
        &mut self,
        entry: &Entry,
        own: OwnMessage,
        start: Stamp,
        now: Stamp,
    ) -> Option<Action> {
        if self.sync != SyncState::InSchedule {
            return None;
        }
        if self.supervision.level() >= ErrorLevel::Error {
            bump(&mut self.counters.suppressed, 1);
            return None;
        }
        if self.rate_error(entry.start) > self.setup.network().uncertainty {
            self.supervision.skip();
            bump(&mut self.counters.unmeasured, 1);
            return None;
        }
        let enabled = self.clock.ticks(self.setup.network().transmit_enable);
        let withdraw = start.after(enabled);
        if !self.transmission.is_idle() || now.reached(withdraw) {
            bump(&mut self.counters.skipped, 1);
            self.fail_own(&own, now);
            return None;
        }
        let scheduled = self.setup.schedule.windows_of(self.setup.config.node);
        if !self.supervision.spend(scheduled) {
            bump(&mut self.counters.transmit_overflows, 1);
            return None;
        }
        self.transmission.pending = Pending::Window(own);
        self.agenda.withdrawal = Some(withdraw);
        Some(Action::Transmit(Grant {
            window: own.window,
            id: own.id,
            len: own.len,
            late: false,
        }))
    }

    /// Notes that an own message was not sent in its window.
    fn fail_own(&mut self, own: &OwnMessage, now: Stamp) {
        self.supervision.note(own.window, true, false);
        if EVENTS && own.retry_late {
            let item = Item::late(own.window, own.id, own.len);
            // Worth sending until its next window at the most.
            let lifetime = self.clock.ticks(self.setup.network().basic_cycle);
            self.enqueue(item, now.after(lifetime), now);
        }
    }

    /// Gives up the pending transmission: the owner is to withdraw it.
    pub(super) fn give_up_pending(&mut self) {
        self.transmission.pending = Pending::None;
        self.agenda.withdrawal = None;
        self.agenda.order = Order::Abort;
    }
}
