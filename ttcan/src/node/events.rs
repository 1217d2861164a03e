//! Event messages and late messages, sent in arbitrating windows.

use super::counters::bump;
use super::position::CurrentWindow;
use super::transmission::Pending;
use super::{Action, Grant, Node, SyncState};
#[cfg(feature = "events")]
use super::{QueueError, setup::LONGEST_TICKS};
use crate::features::EVENTS;
#[cfg(feature = "events")]
use crate::frame::Frame;
#[cfg(feature = "events")]
use crate::id::Id;
use crate::queue::{Item, Kind};
use crate::supervision::ErrorLevel;
#[cfg(feature = "events")]
use crate::time::Micros;
use crate::time::Stamp;

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    /// Enqueues an event message for the next arbitrating window of its basic cycles. It is
    /// dropped if it is not sent within `lifetime`. The message with the lowest
    /// identifier is sent first. Call [`Node::poll`] afterwards.
    ///
    /// # Errors
    /// See [`QueueError`].
    #[cfg(feature = "events")]
    pub fn queue_event(
        &mut self,
        frame: Frame,
        now: Stamp,
        lifetime: Micros,
    ) -> Result<(), QueueError> {
        let expires = self.expiry(&frame, now, lifetime)?;
        if self.enqueue(Item::event(frame), expires, now) {
            self.schedule_event();
            Ok(())
        } else {
            Err(QueueError::Full)
        }
    }

    /// Puts an event message in the place of an older one of its identifier that waits, for
    /// messages of which only the newest is of use. The older one is not sent. If several wait,
    /// one of them is replaced, so enqueue such a message only while none waits
    /// ([`Self::has_event`]). It is dropped if it is not sent within `lifetime` from `now`.
    ///
    /// # Errors
    /// See [`QueueError`]; [`QueueError::NoneWaits`] if there is none to replace, or its
    /// transmission is pending. Nothing is enqueued then.
    #[cfg(feature = "events")]
    pub fn replace_event(
        &mut self,
        frame: Frame,
        now: Stamp,
        lifetime: Micros,
    ) -> Result<(), QueueError> {
        let expires = self.expiry(&frame, now, lifetime)?;
        let kept = self.transmission.place();
        let replaced = self
            .transmission
            .queue
            .replace(Item::event(frame), expires, kept);
        if replaced {
            Ok(())
        } else {
            Err(QueueError::NoneWaits)
        }
    }

    /// Whether an event message with this identifier waits, or its transmission is pending. A
    /// sender that must keep a least time between two frames on the bus (the inhibit time of
    /// CiA 301) begins to count it when this is false: a message may wait for long before it is
    /// sent.
    #[cfg(feature = "events")]
    pub fn has_event(&self, id: Id) -> bool {
        self.transmission.queue.has(id)
    }

    /// When an event message of this node expires.
    #[cfg(feature = "events")]
    fn expiry(&self, frame: &Frame, now: Stamp, lifetime: Micros) -> Result<Stamp, QueueError> {
        let config = &self.setup.config;
        let ours = self.setup.schedule.known(frame.id()).is_some_and(|known| {
            known.is_event && known.sender == config.node && frame.len() <= known.len
        });
        if !ours {
            return Err(QueueError::NotAnEvent);
        }
        let ticks = lifetime.ticks().saturating_mul(config.ticks_per_us);
        if ticks > LONGEST_TICKS {
            return Err(QueueError::Lifetime);
        }
        Ok(now.after(ticks))
    }

    /// Number of messages that wait for an arbitrating window.
    #[cfg(feature = "events")]
    pub fn queued(&self) -> usize {
        self.transmission.queue.len()
    }

    /// Enqueues a message; `false` if there is no room.
    pub(super) fn enqueue(&mut self, item: Item, expires: Stamp, now: Stamp) -> bool {
        let kept = self.transmission.place();
        let expired = self.transmission.queue.insert(item, expires, now, kept);
        match expired {
            Some(expired) => bump(&mut self.counters.events_expired, expired),
            None => bump(&mut self.counters.events_refused, 1),
        }
        expired.is_some()
    }

    /// Makes an event message due if one waits and the window is for it.
    pub(super) fn schedule_event(&mut self) {
        if EVENTS {
            self.agenda.event =
                self.position.in_arbitrating_window() && !self.transmission.queue.is_empty();
        }
    }

    /// The most urgent event message, if it may be sent now.
    // Not inlined: that makes images smaller.
    #[inline(never)]
    pub(super) fn transmit_event(&mut self, now: Stamp) -> Option<Action> {
        if self.position.window != CurrentWindow::Arbitrating
            || !self.transmission.is_idle()
            || self.sync != SyncState::InSchedule
            || self.supervision.level() >= ErrorLevel::Error
        {
            return None;
        }
        let entry = self.entry()?;
        if self.rate_error(entry.end) > self.setup.network().uncertainty {
            return None;
        }
        let (place, expired) = self.transmission.queue.first(now)?;
        if expired {
            // The next message has its turn in a step of its own.
            bump(&mut self.counters.events_expired, 1);
            self.transmission.queue.remove(place);
            self.schedule_event();
            return None;
        }
        let first = self.transmission.queue.get(place)?;
        let (id, len) = (first.frame.id(), first.frame.len());
        let latest = self.latest_start(entry, id, len);
        if now.reached(latest) {
            return None;
        }
        self.transmission.pending = Pending::Event { place };
        self.agenda.withdrawal = Some(latest);
        Some(match first.kind {
            Kind::Event => Action::TransmitEvent(first.frame),
            Kind::Late => Action::Transmit(Grant {
                window: first.window,
                id,
                len,
                late: true,
            }),
        })
    }
}
