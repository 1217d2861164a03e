//! A node's state without its history.

use super::{Counters, Node, Pending};
use crate::{GlobalTime, Stamp};

/// From here on, more messages missed in a row change nothing.
const MANY: u8 = 7;

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    /// The same node with all its stamps moved so that `now` is stamp 0, its
    /// counters at 0, its global time at 0, and runs of missed messages cut off
    /// at 7: it goes on as before, but equals every other node that does. A
    /// model checker needs this to see that it has been in a state before.
    #[must_use]
    pub fn normalised(&self, now: Stamp) -> Self {
        let mut node = self.clone();
        let moved = |stamp: Stamp| Stamp(stamp.0.wrapping_sub(now.0));
        for deadline in [
            &mut node.entry_due,
            &mut node.reference_due,
            &mut node.missed_due,
            &mut node.withdraw_due,
            &mut node.watchdog_due,
        ] {
            *deadline = deadline.map(moved);
        }
        node.mark = if self.marked {
            moved(self.mark)
        } else {
            Stamp(0)
        };
        // Only later stamps than the next one would matter.
        node.last_receive = if now.reached(self.last_receive) {
            Stamp(0)
        } else {
            moved(self.last_receive)
        };
        node.advanced = Stamp(0);
        if let Pending::Reference { asked, .. } = &mut node.pending {
            *asked = moved(*asked);
        }
        node.asked = node.asked.map(moved);
        let place = match node.pending {
            Pending::Event { place } => place,
            _ => 0,
        };
        let moved = node.queue.shift(now, place);
        if let Pending::Event { place } = &mut node.pending {
            *place = moved;
        }
        if node.clock.at(now).is_some() {
            node.clock.restart(now, GlobalTime::default());
        }
        node.repeats_at_miss = self
            .repeats_at_miss
            .map(|repeats| repeats.wrapping_sub(self.counters.repeated_references));
        node.counters = Counters::default();
        node.counts.cut(MANY);
        node.cycles_seen = 0;
        for (index, peer) in node.peers.iter_mut().enumerate() {
            let limit = self.windows_in_two_cycles(crate::NodeId(index as u16));
            peer.normalise(self.cycles_seen, limit);
        }
        node
    }
}
