//! Times of the schedule on the node's own counter.

use super::{MasterState, Node};
use crate::clock::Flags;
use crate::features::GLOBAL_TIME;
use crate::id::Id;
use crate::length;
use crate::schedule::Entry;
use crate::time::Stamp;

impl<const W: usize, const P: usize, const Q: usize> Node<'_, W, P, Q> {
    /// When to request a transmission that is to begin at this cycle time.
    // In every place that calls it, it would be a fortieth of an image, a tenth of the smallest ones.
    #[inline(never)]
    pub(super) fn instant(&self, cycle_time: u32) -> Stamp {
        let mark = self.cycle.mark.after(self.clock.ticks(cycle_time));
        mark.before(self.setup.config.transmit_lead)
    }

    /// When to request this node's reference at the end of the current basic cycle,
    /// with a reference trigger offset in microseconds.
    pub(super) fn reference_instant(&self, offset: i8) -> Stamp {
        let cycle = self.setup.network().basic_cycle;
        self.instant(cycle.wrapping_add_signed(i32::from(offset)))
    }

    /// Ticks of silence after which a potential master that has seen no
    /// reference sends one. A frame that is on the bus at the start ends
    /// earlier than that.
    // Two places call it.
    #[inline(never)]
    pub(super) fn quiet(&self) -> u32 {
        let network = self.setup.network();
        let offset = u32::from(self.master.offset.unsigned_abs());
        self.clock
            .ticks(network.basic_cycle + 2 * network.reference_length + offset)
    }

    /// Ticks after the reference mark (or the start) at which a reference that is to come
    /// `micros` later counts as missing.
    pub(super) fn missing_after(&self, micros: u32) -> u32 {
        // `Setup::new` checked the whole against the counter's range.
        let late = self.setup.network().reference_late;
        self.clock.ticks(micros.wrapping_add(late))
    }

    /// Last instant to request a frame that must end within the entry.
    pub(super) fn latest_start(&self, entry: &Entry, id: Id, len: u8) -> Stamp {
        let longest = self
            .setup
            .bits(length::worst_case_bits(id, len) + length::INTERFRAME_BITS);
        let uncertainty = self.clock.ticks(self.setup.network().uncertainty);
        self.instant(entry.end).before(longest).before(uncertainty)
    }

    /// Largest error of a cycle time on this node while its rate against the
    /// master is not measured, in microseconds. It comes on top of the
    /// uncertainty of the matrix.
    pub(super) fn rate_error(&self, cycle_time: u32) -> u32 {
        // The master's own clock is right by definition.
        let follows = GLOBAL_TIME
            && !self.clock.has(Flags::RATED)
            && self.setup.network().tells_time
            && self.master.state != MasterState::Current;
        if follows {
            self.clock.rate_error(cycle_time)
        } else {
            0
        }
    }
}
