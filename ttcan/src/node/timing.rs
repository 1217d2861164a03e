//! What is due when: time marks of the schedule and missing references.

use super::agenda::{Due, Order, is_due};
use super::counters::bump;
use super::position::{CurrentWindow, Position};
use super::setup::LONGEST_BITS;
use super::transmission::{OwnMessage, Pending};
use super::{Action, Node, SyncState};
use crate::features::{EVENTS, MASTER};
use crate::schedule::{Entry, Role};
use crate::supervision::{Missing, Severe};
use crate::time::Stamp;

/// Windows in a row in which a message was missed, from which on its sender may have followed another
/// master with another time before it is seen again. One lost frame does not count.
const RETURNED: u8 = 2;

impl<'s, const W: usize, const P: usize, const Q: usize> Node<'s, W, P, Q> {
    /// What is to be done at `now`. Call it again until it returns `None`.
    ///
    /// A call that comes late does what can still be done: a message whose
    /// transmit enable window has passed is not sent any more. Late calls catch
    /// up window by window; otherwise the cost is constant.
    #[must_use]
    pub fn poll(&mut self, now: Stamp) -> Option<Action> {
        loop {
            let due = self.due(now)?;
            let action = self.carry_out(due, now);
            if action.is_some() {
                return action;
            }
        }
    }

    /// One step of [`Node::poll`], for owners who must bound the time of each of
    /// their interrupts: it has no loop, and does at most one thing that is due.
    /// [`Node::next_deadline`] then tells whether more is due. With a timer that
    /// fires at once when its deadline has passed, every step is an interrupt of
    /// its own.
    #[must_use]
    // Not inlined, because the analysis looks for its cost; the smallest images have no room
    // for that.
    #[cfg_attr(feature = "global-time", inline(never))]
    pub fn advance(&mut self, now: Stamp) -> Option<Action> {
        let due = self.due(now)?;
        self.carry_out(due, now)
    }

    fn due(&mut self, now: Stamp) -> Option<Due> {
        self.agenda.polled = now;
        self.agenda.due(now, self.transmission.is_idle())
    }

    // Not inlined: it would be twice in images that call both of the above. The smallest images have
    // no room for that.
    #[cfg_attr(feature = "global-time", inline(never))]
    fn carry_out(&mut self, due: Due, now: Stamp) -> Option<Action> {
        match due {
            Due::Silence => {
                self.agenda.order = Order::Nothing;
                Some(Action::Silence)
            }
            Due::Abort => {
                self.agenda.order = Order::Nothing;
                Some(Action::Abort)
            }
            Due::Watchdog => {
                self.stop(Severe::ApplicationWatchdog);
                None
            }
            Due::Withdrawal => {
                self.agenda.withdrawal = None;
                if MASTER {
                    self.lose_withdrawn_reference();
                }
                Some(Action::Abort)
            }
            Due::TimeMark => self.step(now),
            // Never due without a master, which the compiler cannot see from here.
            Due::Reference => MASTER.then(|| self.transmit_reference(now)),
            Due::MissingReference => {
                self.miss_reference(now);
                None
            }
            Due::Event => {
                self.agenda.event = false;
                self.transmit_event(now)
            }
        }
    }

    /// Whether [`Node::poll`] has something to do at `now`.
    pub fn is_due(&self, now: Stamp) -> bool {
        is_due(self.next_deadline(), now)
    }

    /// When [`Node::poll`] has something to do at the latest, if nothing happens
    /// before. It may be in the past; `None` while the node is off.
    pub fn next_deadline(&self) -> Option<Stamp> {
        self.agenda.earliest(self.transmission.is_idle())
    }

    /// Waits for the first window of the current basic cycle.
    pub(super) fn begin_entries(&mut self) {
        let (first, end) = self.setup.schedule.entries_of(self.cycle.number);
        let events = self.setup.may_send_events(self.cycle.number);
        self.position = Position::new(first, end, events);
        self.await_entry();
    }

    /// Waits for the window at the cursor, if the basic cycle has one more, and returns it.
    fn await_entry(&mut self) -> Option<&'s Entry> {
        let entry = if self.position.cursor < self.position.end {
            self.entry()
        } else {
            None
        };
        self.agenda.time_mark = entry.map(|entry| self.instant(entry.start));
        entry
    }

    /// Passes one time mark: the end of a window, with the beginning of the next
    /// one if that is due too, or the beginning of a window.
    #[inline(never)]
    fn step(&mut self, now: Stamp) -> Option<Action> {
        let entry = if self.position.in_window() {
            let missed = self.entry().is_some_and(|entry| self.close(entry));
            self.position.leave(missed);
            let next = self.await_entry();
            if !is_due(self.agenda.time_mark, now) {
                return None;
            }
            next
        } else {
            self.entry()
        };
        let Some(entry) = entry else {
            self.agenda.time_mark = None;
            return None;
        };
        let start = self.agenda.time_mark.replace(self.instant(entry.end));
        match entry.role {
            Role::Exclusive {
                id,
                len,
                sender,
                retry_late,
            } => {
                self.position.window = CurrentWindow::Exclusive;
                if sender != self.setup.config.node {
                    return None;
                }
                let own = OwnMessage {
                    window: entry.window,
                    id,
                    len,
                    retry_late,
                };
                self.open_own(entry, own, start.unwrap_or(now), now)
            }
            Role::Arbitrating => {
                self.position.window = self.position.arbitrating;
                if EVENTS && !self.transmission.queue.is_empty() {
                    self.transmit_event(now)
                } else {
                    None
                }
            }
        }
    }

    /// Notes whether the message of another node was seen in the window that
    /// ends, and returns whether it was missed.
    fn close(&mut self, entry: &Entry) -> bool {
        let Role::Exclusive { sender, .. } = entry.role else {
            return false;
        };
        if sender == self.setup.config.node {
            return false;
        }
        let seen = self.position.window == CurrentWindow::ExclusiveSeen;
        if self.sync != SyncState::InSchedule {
            return !seen;
        }
        if MASTER && seen {
            let before = self.supervision.window(entry.window).unwrap_or_default();
            if before.missed >= RETURNED {
                self.announce_again();
            }
        }
        self.supervision.note(entry.window, false, seen);
        if !seen {
            bump(&mut self.counters.missed_messages, 1);
            if let Some(peer) = self.supervision.peer(sender) {
                peer.missing();
            }
        }
        !seen
    }

    fn miss_reference(&mut self, now: Stamp) {
        if self.cycle.has_begun() {
            bump(&mut self.counters.missed_references, 1);
            let missed = match self.supervision.missing {
                Missing::InRow(missed) => missed.saturating_add(1),
                Missing::Initial => 1,
            };
            self.supervision.missing = Missing::InRow(missed);
            if missed >= self.setup.config.watch {
                self.stop(Severe::Watch);
                return;
            }
        } else {
            self.supervision.missing = Missing::Initial;
        }
        let cycle = self.clock.ticks(self.setup.network().basic_cycle);
        self.agenda.missing_reference = Some(now.after(cycle));
        self.give_up_stuck(now);
    }

    /// Gives up a transmission whose report was lost: a message of the basic
    /// cycle that is over, or a reference that was already pending when the
    /// reference before was missed.
    fn give_up_stuck(&mut self, now: Stamp) {
        if MASTER {
            self.repeat_lost_reference(now);
        }
        let attempt = &mut self.master.attempt;
        let stuck = match self.transmission.pending {
            Pending::None | Pending::Abandoned => false,
            Pending::Reference(_) => MASTER && attempt.missed_while_pending,
            Pending::Window(_) | Pending::Event { .. } => true,
        };
        if MASTER {
            attempt.missed_while_pending =
                !stuck && matches!(self.transmission.pending, Pending::Reference(_));
        }
        if stuck {
            self.give_up_pending();
            if self.setup.rank().is_some() && self.agenda.reference.is_none() {
                self.agenda.reference = Some(now);
            }
        }
    }

    /// Passes the time marks before `start`, the instant at which a received
    /// frame began: the timer was late.
    pub(super) fn catch_up(&mut self, start: Stamp) {
        // loop-bound: 1. One turn for each time mark.
        while is_due(self.agenda.time_mark, start) {
            // at-most: 0. The timer's deadline lies before the end of any frame.
            self.pass_late(start);
        }
    }

    // Not inlined, so that the analysis finds the bound above; the smallest images have no
    // room for that.
    #[cfg_attr(feature = "global-time", inline(never))]
    fn pass_late(&mut self, start: Stamp) {
        // Late by more than the longest frame: nothing can be sent any more.
        let late = start.after(self.setup.bits(LONGEST_BITS));
        if self.step(late).is_some() {
            self.transmission.pending = Pending::None;
            self.agenda.withdrawal = None;
        }
    }
}
