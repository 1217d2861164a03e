//! What a node has to do next, and by when: its table of deadlines.

use crate::features::{EVENTS, MASTER};
use crate::time::Stamp;

/// What the owner must do before anything else.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Order {
    Nothing,
    /// Withdraw the frame that was requested last.
    Abort,
    /// Silence the controller.
    Silence,
}

/// What is due. If several things are due, the first one of this list is done
/// first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Due {
    Silence,
    Abort,
    /// The application did not feed its watchdog.
    Watchdog,
    /// The time to begin the pending transmission is over.
    Withdrawal,
    /// A window begins or ends.
    TimeMark,
    /// The node's own reference is to be sent.
    Reference,
    /// The next reference counts as missing.
    MissingReference,
    /// An event message may be sent.
    Event,
}

/// Orders to the owner and deadlines.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Agenda {
    pub(super) order: Order,
    /// Whether an event message may be sent now.
    pub(super) event: bool,
    /// When the owner last asked what is due. An order or an event message is due at
    /// once, and this stamp is its deadline.
    pub(super) polled: Stamp,
    /// See [`Due`] for what each deadline is for.
    pub(super) watchdog: Option<Stamp>,
    pub(super) withdrawal: Option<Stamp>,
    pub(super) time_mark: Option<Stamp>,
    /// Waits for a free mailbox, too.
    pub(super) reference: Option<Stamp>,
    pub(super) missing_reference: Option<Stamp>,
}

impl Agenda {
    /// Nothing to do.
    pub(super) const fn new(now: Stamp) -> Self {
        Self {
            order: Order::Nothing,
            event: false,
            polled: now,
            watchdog: None,
            withdrawal: None,
            time_mark: None,
            reference: None,
            missing_reference: None,
        }
    }

    /// What is due at `now`. `mailbox_free` tells whether no transmission is
    /// pending.
    pub(super) fn due(&self, now: Stamp, mailbox_free: bool) -> Option<Due> {
        if self.order != Order::Nothing {
            Some(if self.order == Order::Silence {
                Due::Silence
            } else {
                Due::Abort
            })
        } else if is_due(self.watchdog, now) {
            Some(Due::Watchdog)
        } else if is_due(self.withdrawal, now) {
            Some(Due::Withdrawal)
        } else if is_due(self.time_mark, now) {
            Some(Due::TimeMark)
        } else if MASTER && mailbox_free && is_due(self.reference, now) {
            Some(Due::Reference)
        } else if is_due(self.missing_reference, now) {
            Some(Due::MissingReference)
        } else if EVENTS && self.event {
            Some(Due::Event)
        } else {
            None
        }
    }

    /// When something is due next; it may be in the past.
    pub(super) fn earliest(&self, mailbox_free: bool) -> Option<Stamp> {
        if self.order != Order::Nothing || (EVENTS && self.event) {
            return Some(self.polled);
        }
        let reference = self.reference.filter(|_| MASTER && mailbox_free);
        let first = earlier(self.time_mark, reference);
        let first = earlier(first, self.missing_reference);
        let first = earlier(first, self.withdrawal);
        earlier(first, self.watchdog)
    }
}

/// Whether there is a deadline that is not in the future.
pub(super) fn is_due(deadline: Option<Stamp>, now: Stamp) -> bool {
    deadline.is_some_and(|deadline| now.reached(deadline))
}

fn earlier(one: Option<Stamp>, other: Option<Stamp>) -> Option<Stamp> {
    match (one, other) {
        (Some(one), Some(other)) if one.reached(other) => Some(other),
        (None, other) => other,
        (one, _) => one,
    }
}
