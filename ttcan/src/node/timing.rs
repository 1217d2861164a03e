//! What is due when.

use super::{Action, Grant, Last, MasterState, Node, Pending, SyncState, bump};
use crate::events::Item;
use crate::parts::{EVENTS, GLOBAL_TIME, MASTER, PEERS};
use crate::reference::{Fields, mark_of};
use crate::schedule::{Entry, Role};
use crate::supervision::{ErrorLevel, Severe};
use crate::{Stamp, length};

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    /// What is to be done at `now`. Call it again until it returns `None`.
    ///
    /// A call that comes late does what can still be done: a message whose
    /// transmit enable window has passed is not sent any more. Late calls catch
    /// up window by window; otherwise the cost is constant.
    #[must_use]
    pub fn poll(&mut self, now: Stamp) -> Option<Action> {
        loop {
            let action = self.advance(now);
            if action.is_some() || !due(self.next_deadline(), now) {
                return action;
            }
        }
    }

    /// One step of [`Node::poll`], for owners who must answer for the time that
    /// each of their interrupts takes: there is no loop in it, and no more than
    /// one thing that is due is done. More may be due afterwards, which
    /// [`Node::next_deadline`] tells: with a timer that fires at once when its
    /// deadline has passed, every step is an interrupt of its own.
    #[must_use]
    // Apart from its caller in the image, where its cost is looked for; the smallest images
    // have no room for that.
    #[cfg_attr(feature = "global-time", inline(never))]
    pub fn advance(&mut self, now: Stamp) -> Option<Action> {
        self.advanced = now;
        if self.silence_due {
            self.silence_due = false;
            return Some(Action::Silence);
        }
        if self.abort_due {
            self.abort_due = false;
            return Some(Action::Abort);
        }
        if self.sync == SyncState::Off {
            return None;
        }
        if due(self.watchdog_due, now) {
            self.stop(Severe::ApplicationWatchdog);
            return None;
        }
        if due(self.withdraw_due, now) {
            self.withdraw_due = None;
            return Some(Action::Abort);
        }
        if due(self.entry_due, now) {
            return self.step(now);
        }
        if MASTER && due(self.reference_due, now) && self.pending == Pending::None {
            return Some(self.transmit_reference(now));
        }
        if due(self.missed_due, now) {
            self.miss_reference(now);
            return None;
        }
        if EVENTS && self.events_due {
            self.events_due = false;
            return self.transmit_event(now);
        }
        None
    }

    /// Whether [`Node::poll`] has something to do at `now`.
    pub fn is_due(&self, now: Stamp) -> bool {
        self.is_prompt() || due(self.next_deadline(), now)
    }

    /// Whether something is to be done that does not wait for an instant.
    fn is_prompt(&self) -> bool {
        self.silence_due || self.abort_due || (EVENTS && self.events_due)
    }

    /// When [`Node::poll`] has something to do at the latest, if nothing
    /// happens before. May have passed already; `None` while the node is off.
    pub fn next_deadline(&self) -> Option<Stamp> {
        if self.is_prompt() {
            return Some(self.advanced);
        }
        if self.sync == SyncState::Off {
            return None;
        }
        // A reference that waits for a mailbox is asked for when that is free.
        let reference = self
            .reference_due
            .filter(|_| MASTER && self.pending == Pending::None);
        let first = earlier(self.entry_due, reference);
        let first = earlier(first, self.missed_due);
        let first = earlier(first, self.withdraw_due);
        earlier(first, self.watchdog_due)
    }

    /// Begins the first entry of a basic cycle.
    pub(super) fn begin_entries(&mut self) {
        let (first, end) = self.schedule.entries_of(self.cycle);
        self.cursor = first;
        self.cursor_end = end;
        self.inside = false;
        self.last = None;
        self.await_entry();
    }

    /// Waits for the entry at the cursor, if the cycle has one.
    fn await_entry(&mut self) {
        self.entry_due = if self.cursor < self.cursor_end {
            self.entry().map(|entry| self.instant(entry.start))
        } else {
            None
        };
    }

    /// Passes one boundary: the end of an entry, with the beginning of the next
    /// one if that is due too, or the beginning of one.
    #[inline(never)]
    fn step(&mut self, now: Stamp) -> Option<Action> {
        if self.inside {
            if let Some(entry) = self.entry() {
                self.close(entry);
            }
            self.inside = false;
            self.cursor = self.cursor.wrapping_add(1);
            self.await_entry();
            if !due(self.entry_due, now) {
                return None;
            }
        }
        let Some(entry) = self.entry() else {
            self.entry_due = None;
            return None;
        };
        self.inside = true;
        self.seen = false;
        if EVENTS {
            self.events_held = false;
            self.arbitrating = matches!(entry.role, Role::Arbitrating);
        }
        let start = self.entry_due.replace(self.instant(entry.end));
        match entry.role {
            Role::Exclusive {
                id,
                len,
                sender,
                retry_late,
            } if sender == self.config.node => {
                self.open_own(entry, (id, len, retry_late), start.unwrap_or(now), now)
            }
            Role::Exclusive { .. } => None,
            Role::Arbitrating if EVENTS && !self.queue.is_empty() => self.transmit_event(now),
            Role::Arbitrating => None,
        }
    }

    /// Notes whether another node's message was there.
    fn close(&mut self, entry: &Entry) {
        let Role::Exclusive {
            id, len, sender, ..
        } = entry.role
        else {
            return;
        };
        if sender == self.config.node {
            return;
        }
        self.last = Some(Last {
            window: entry.window,
            id,
            len,
            sender,
            seen: self.seen,
        });
        if self.sync != SyncState::InSchedule {
            return;
        }
        self.counts.note(entry.window, false, self.seen);
        if !self.seen {
            bump(&mut self.counters.missed_messages, 1);
            if PEERS && let Some(peer) = self.peers.get_mut(usize::from(sender.0)) {
                peer.missing();
            }
        }
        self.assess();
    }

    fn open_own(
        &mut self,
        entry: &Entry,
        (id, len, retry_late): (crate::Id, u8, bool),
        start: Stamp,
        now: Stamp,
    ) -> Option<Action> {
        if self.sync != SyncState::InSchedule {
            return None;
        }
        if self.error_level >= ErrorLevel::Error {
            bump(&mut self.counters.suppressed, 1);
            return None;
        }
        if self.doubt(entry.start) > self.schedule.network.uncertainty {
            self.served = self.served.saturating_add(1);
            bump(&mut self.counters.unmeasured, 1);
            return None;
        }
        let enabled = self.clock.ticks(self.schedule.network.transmit_enable);
        let withdraw = start.after(enabled);
        if self.pending != Pending::None || now.reached(withdraw) {
            bump(&mut self.counters.skipped, 1);
            self.fail_own(entry.window, id, len, retry_late, now);
            return None;
        }
        self.served = self.served.saturating_add(1);
        if self.served > self.schedule.windows_of(self.config.node) {
            bump(&mut self.counters.transmit_overflows, 1);
            self.overflow = true;
            self.assess();
            return None;
        }
        self.pending = Pending::Window {
            window: entry.window,
            id,
            len,
            retry_late,
        };
        self.withdraw_due = Some(withdraw);
        Some(Action::Transmit(Grant {
            window: entry.window,
            id,
            len,
            late: false,
        }))
    }

    /// Notes that an own message was not sent in its window.
    pub(super) fn fail_own(
        &mut self,
        window: u16,
        id: crate::Id,
        len: u8,
        retry_late: bool,
        now: Stamp,
    ) {
        self.counts.note(window, true, false);
        if EVENTS && retry_late {
            // Worth sending until its next turn.
            let lifetime = self.clock.ticks(self.schedule.network.basic_cycle);
            self.enqueue(Item::Late { window, id, len }, now.after(lifetime), now);
        }
        self.assess();
    }

    // A function of its own in the image: the bound of a window is without it.
    #[inline(never)]
    fn transmit_reference(&mut self, now: Stamp) -> Action {
        self.reference_due = None;
        let network = self.schedule.network;
        if GLOBAL_TIME && self.clock.at(now).is_none() {
            self.clock.set(now, Default::default());
        }
        let start = now.after(self.config.transmit_lead);
        let fields = Fields {
            next_is_gap: self.gap_wanted,
            discontinuity: self.leap,
            cycle: if self.marked { self.next_cycle() } else { 0 },
            coarse: self.clock.at(start).map(|time| time.as_millis()),
            mark: if self.marked {
                self.clock.at(self.mark).map(mark_of)
            } else {
                None
            },
        };
        let rank = self.rank().unwrap_or(0);
        let id = network.reference.offset(rank).unwrap_or(network.reference);
        let frame = fields.encode(&network.reference_format, id, &self.application);
        self.pending = Pending::Reference {
            frame,
            cycle: fields.cycle,
            next_is_gap: fields.next_is_gap,
            discontinuity: fields.discontinuity,
            asked: self.asked.unwrap_or(now),
        };
        Action::TransmitReference(frame)
    }

    /// The cycle after the one under way.
    pub(super) fn next_cycle(&self) -> u8 {
        self.cycle.wrapping_add(1) & self.schedule.network.cycles.wrapping_sub(1)
    }

    fn miss_reference(&mut self, now: Stamp) {
        let again = now.after(self.clock.ticks(self.schedule.network.basic_cycle));
        if !self.marked {
            self.initial_watch = true;
            self.missed_due = Some(again);
            self.give_up_stuck(now);
            return;
        }
        bump(&mut self.counters.missed_references, 1);
        self.missed_references = self.missed_references.saturating_add(1);
        if self.missed_references >= self.config.watch {
            self.stop(Severe::Watch);
            return;
        }
        self.missed_due = Some(again);
        self.give_up_stuck(now);
    }

    /// Gives up a transmission whose report was lost: a message from the basic
    /// cycle that is over, or a reference that has neither been sent nor
    /// repeated since the last one that was missing.
    fn give_up_stuck(&mut self, now: Stamp) {
        if MASTER && self.reference_lost {
            self.reference_lost = false;
            self.reference_due = Some(now);
        }
        let repeats = self.counters.repeated_references;
        let stuck = match self.pending {
            Pending::None => false,
            Pending::Reference { .. } => MASTER && self.repeats_at_miss == Some(repeats),
            Pending::Window { .. } | Pending::Event { .. } => true,
        };
        self.repeats_at_miss = match self.pending {
            Pending::Reference { .. } if MASTER => Some(repeats),
            _ => None,
        };
        if stuck {
            self.pending = Pending::None;
            self.repeats_at_miss = None;
            self.withdraw_due = None;
            self.abort_due = true;
            if self.rank().is_some() && self.reference_due.is_none() {
                self.reference_due = Some(now);
            }
        }
    }

    /// Puts a message in line; `false` when there is no room.
    pub(super) fn enqueue(&mut self, item: Item, expires: Stamp, now: Stamp) -> bool {
        let kept = match self.pending {
            Pending::Event { place } => Some(place),
            _ => None,
        };
        let expired = self.queue.insert(item, expires, now, kept);
        match expired {
            Some(expired) => bump(&mut self.counters.events_expired, expired),
            None => bump(&mut self.counters.events_refused, 1),
        }
        expired.is_some()
    }

    /// Notes that an event message may go now, if one waits.
    pub(super) fn attend_events(&mut self) {
        if EVENTS {
            self.events_due = self.inside && self.arbitrating && !self.queue.is_empty();
        }
    }

    /// The most urgent event message, if this is the time for it.
    // A function of its own in the image: the bound of other windows is without it.
    #[inline(never)]
    fn transmit_event(&mut self, now: Stamp) -> Option<Action> {
        if !self.inside
            || self.events_held
            || self.pending != Pending::None
            || self.sync != SyncState::InSchedule
            || self.error_level >= ErrorLevel::Error
        {
            return None;
        }
        let entry = self.entry()?;
        if entry.role != Role::Arbitrating {
            return None;
        }
        if self.doubt(entry.end) > self.schedule.network.uncertainty {
            return None;
        }
        let (place, expired) = self.queue.first(now)?;
        if expired {
            // The next one has its turn in a step of its own.
            bump(&mut self.counters.events_expired, 1);
            self.queue.remove(place);
            self.attend_events();
            return None;
        }
        let first = *self.queue.get(place)?;
        let latest = self.latest_start(entry, first.id(), first.len());
        if now.reached(latest) {
            return None;
        }
        self.pending = Pending::Event { place };
        self.withdraw_due = Some(latest);
        Some(match first {
            Item::Event(frame) => Action::TransmitEvent(frame),
            Item::Late { window, id, len } => Action::Transmit(Grant {
                window,
                id,
                len,
                late: true,
            }),
        })
    }

    /// How far off a cycle time may be on this node, besides the uncertainty of
    /// a node that follows the references' rate, in microseconds.
    pub(super) fn doubt(&self, cycle_time: u32) -> u32 {
        let network = self.schedule.network;
        // The master's own time is right whatever its rate.
        let follows = GLOBAL_TIME
            && network.reference_format.tells_time()
            && self.master != MasterState::Current;
        if follows {
            self.clock.doubt(cycle_time)
        } else {
            0
        }
    }

    /// Until when a frame may begin so that it ends within the entry.
    fn latest_start(&self, entry: &Entry, id: crate::Id, len: u8) -> Stamp {
        let longest = self.bits(length::worst_case_bits(id, len) + length::INTERFRAME_BITS);
        let uncertainty = self.clock.ticks(self.schedule.network.uncertainty);
        Stamp(
            self.instant(entry.end)
                .0
                .wrapping_sub(longest)
                .wrapping_sub(uncertainty),
        )
    }

    /// Passes the boundaries that lie before `start`, the instant at which a
    /// received frame began: the timer was late.
    pub(super) fn catch_up(&mut self, start: Stamp) {
        // loop-bound: 1 once for each boundary
        while due(self.entry_due, start) {
            // at-most: 0 the timer's deadline lies before the end of any frame
            self.pass_late(start);
        }
    }

    // Apart from its caller in the image, so that the bound above finds it; the smallest
    // images have no room for that.
    #[cfg_attr(feature = "global-time", inline(never))]
    fn pass_late(&mut self, start: Stamp) {
        // What could be sent then is past by a frame's length now.
        let late = start.after(self.bits(u32::from(u8::MAX)));
        if self.step(late).is_some() {
            self.pending = Pending::None;
            self.withdraw_due = None;
        }
    }
}

fn due(deadline: Option<Stamp>, now: Stamp) -> bool {
    deadline.is_some_and(|deadline| now.reached(deadline))
}

fn earlier(one: Option<Stamp>, other: Option<Stamp>) -> Option<Stamp> {
    match (one, other) {
        (Some(one), Some(other)) if one.reached(other) => Some(other),
        (None, other) => other,
        (one, _) => one,
    }
}
