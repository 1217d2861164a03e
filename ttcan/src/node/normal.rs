//! A node's state without its history.

use super::Node;
use super::counters::Counters;
use super::master_role::Progress;
use super::transmission::Pending;
use crate::time::{GlobalTime, Stamp};

/// More messages than this missed in a row make no difference.
const MOST_MISSED: u8 = 7;

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    /// The same node with all stamps moved so that `now` is stamp 0, with its
    /// counters and its global time at 0, and runs of missed messages cut off at
    /// 7. It behaves as before, and equals every other node that behaves so. Only the
    /// coarse time of the last reference is forgotten: a node of level 2 that has not
    /// measured its rate takes a reference more. A model checker needs this to
    /// recognise a state.
    #[must_use]
    pub fn normalised(&self, now: Stamp) -> Self {
        let mut node = self.renumbered(now);
        if node.clock.sent_at(Stamp(0)).is_some() {
            node.clock.restart(Stamp(0), GlobalTime::default());
        }
        node.cycle.coarse = None;
        node
    }

    /// As [`Node::normalised`], but with its global time. It behaves as before in every respect.
    #[must_use]
    pub fn renumbered(&self, now: Stamp) -> Self {
        let mut node = self.clone();
        let moved = |stamp: Stamp| Stamp(stamp.0.wrapping_sub(now.0));
        let agenda = &mut node.agenda;
        for deadline in [
            &mut agenda.watchdog,
            &mut agenda.withdrawal,
            &mut agenda.time_mark,
            &mut agenda.reference,
            &mut agenda.missing_reference,
        ] {
            *deadline = deadline.map(moved);
        }
        agenda.polled = Stamp(0);
        node.cycle.mark = if self.cycle.has_begun() {
            moved(self.cycle.mark)
        } else {
            Stamp(0)
        };
        // Only a stamp after `now` could make the next one go backwards.
        node.last_received = if now.reached(self.last_received) {
            Stamp(0)
        } else {
            moved(self.last_received)
        };
        let attempt = &mut node.master.attempt;
        if let Progress::Repeated(requested) | Progress::Lost(requested) = &mut attempt.progress {
            *requested = moved(*requested);
        }
        if let Pending::Reference(own) = &mut node.transmission.pending {
            own.requested = moved(own.requested);
        }
        let place = node.transmission.place();
        let place_now = node.transmission.queue.shift(now, place);
        if let (Pending::Event { place }, Some(moved)) = (&mut node.transmission.pending, place_now)
        {
            *place = moved;
        }
        if node.clock.sent_at(now).is_some() {
            node.clock.renumber(now);
        }
        node.counters = Counters::default();
        node.cycle.count = 0;
        node.supervision
            .normalise(MOST_MISSED, self.cycle.count, |node| {
                self.setup.schedule.windows_in_two_cycles(node)
            });
        node
    }
}
