//! Counters of everything that happens.

use crate::features::COUNTERS;

/// Adds to a counter, unless the crate is built without them.
pub(super) fn bump(counter: &mut u32, by: u32) {
    if COUNTERS {
        *counter = counter.wrapping_add(by);
    }
}

/// One counter for each way in which a frame was lost or a rule broken, and for
/// each kind of success. They wrap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Counters {
    /// References taken, own ones included.
    pub references: u32,
    /// References that did not come in time.
    pub missed_references: u32,
    /// References sent again because an error destroyed them.
    pub repeated_references: u32,
    /// References without the fields they need.
    pub malformed_references: u32,
    /// References of a rank that nobody has, or of this node's own.
    pub unknown_masters: u32,
    /// References in the middle of another master's basic cycle.
    pub untimely_references: u32,
    /// References whose cycle count does not follow the one before.
    pub cycle_count_errors: u32,
    /// References by another master than the one before.
    pub master_changes: u32,
    /// Scheduled messages received in their windows.
    pub scheduled: u32,
    /// Exclusive windows of others that stayed empty.
    pub missed_messages: u32,
    /// Event and late messages received.
    pub events: u32,
    /// Known messages out of place.
    pub misplaced: u32,
    /// Messages of identifiers that the network does not have.
    pub foreign: u32,
    /// Messages of the wrong length.
    pub wrong_length: u32,
    /// Frames while no schedule was kept.
    pub not_in_schedule: u32,
    /// Stamps that preceded the one before.
    pub stamps_backwards: u32,
    /// Frames that the controller lost because its receive buffer was full.
    pub overruns: u32,
    /// Scheduled messages sent.
    pub sent: u32,
    /// Own windows that the application left empty.
    pub left_empty: u32,
    /// Own windows passed because the node was asked too late, or the
    /// controller was still busy.
    pub skipped: u32,
    /// Own windows passed because of the error level.
    pub suppressed: u32,
    /// Own windows passed because the rate of the own clock was not known well
    /// enough to tell when they begin.
    pub unmeasured: u32,
    /// Own transmissions that lost arbitration.
    pub arbitration_lost: u32,
    /// Own transmissions that an error destroyed.
    pub transmit_errors: u32,
    /// Own transmissions that did not begin within the transmit enable window.
    pub aborted: u32,
    /// Event and late messages sent.
    pub events_sent: u32,
    /// Event and late messages dropped because they were not sent in time.
    pub events_expired: u32,
    /// Event and late messages refused because the queue was full.
    pub events_refused: u32,
    /// Reports of transmissions that this node had not asked for.
    pub stray_reports: u32,
    /// Matrices with more transmissions than scheduled.
    pub transmit_overflows: u32,
    /// Matrices with fewer transmissions than scheduled.
    pub transmit_underflows: u32,
    /// Leaps of global time, announced or not.
    pub time_steps: u32,
    /// Corrections of global time refused by the drift limit.
    pub drift_refused: u32,
}
