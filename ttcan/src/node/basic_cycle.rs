//! The current basic cycle.

use crate::features::{GAPS, GLOBAL_TIME};
use crate::time::Stamp;

/// The current basic cycle, as its reference message began it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct BasicCycle {
    /// Reference mark (Ref_Mark); the stamp of the start before the first
    /// reference.
    pub(super) mark: Stamp,
    /// Rank of the master that sent the reference; `None` before the first
    /// reference and in S3.
    pub(super) master: Option<u8>,
    /// Cycle count in the reference.
    pub(super) number: u8,
    /// Basic cycles since the start.
    pub(super) count: u32,
    /// Coarse time in the reference of another master, ms.
    pub(super) coarse: Option<u32>,
    next_is_gap: bool,
}

impl BasicCycle {
    /// No basic cycle yet: the node was started at `now`.
    pub(super) const fn new(now: Stamp) -> Self {
        Self {
            mark: now,
            master: None,
            number: 0,
            count: 0,
            coarse: None,
            next_is_gap: false,
        }
    }

    /// Begins the basic cycle of a reference. Returns the rank of the master of
    /// the basic cycle before.
    pub(super) fn begin(
        &mut self,
        mark: Stamp,
        master: u8,
        number: u8,
        next_is_gap: bool,
    ) -> Option<u8> {
        self.mark = mark;
        self.number = number;
        self.count = self.count.wrapping_add(1);
        if GLOBAL_TIME {
            self.coarse = None;
        }
        self.next_is_gap = next_is_gap;
        self.master.replace(master)
    }

    /// Whether a reference began it, so that [`Self::mark`] is a reference mark.
    pub(super) const fn has_begun(&self) -> bool {
        self.master.is_some()
    }

    /// Whether its reference announced a gap (Next_is_Gap).
    pub(super) const fn next_is_gap(&self) -> bool {
        GAPS && self.next_is_gap
    }
}
