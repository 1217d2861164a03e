//! Counters of everything that happens.

use crate::features::COUNTERS;

/// Adds to a counter, unless the crate is built without them.
pub(super) fn bump(counter: &mut u32, by: u32) {
    if COUNTERS {
        *counter = counter.wrapping_add(by);
    }
}

/// One counter for each way in which a frame is lost or a rule is broken, and for
/// each kind of success. They wrap.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct Counters {
    /// References accepted, own ones included.
    pub references: u32,
    /// Missing references.
    pub missed_references: u32,
    /// Own references requested again after an error or an abort.
    pub repeated_references: u32,
    /// References without the required fields.
    pub malformed_references: u32,
    /// References with a rank that no master has.
    pub unknown_masters: u32,
    /// Frames of other nodes with identifiers that only this node sends.
    pub impostors: u32,
    /// References in the middle of a better-ranked master's basic cycle.
    pub untimely_references: u32,
    /// References whose cycle count does not follow that of the one before.
    pub cycle_count_errors: u32,
    /// References of another master than the one before.
    pub master_changes: u32,
    /// Scheduled messages received in their windows.
    pub scheduled: u32,
    /// Exclusive windows of others that stayed empty.
    pub missed_messages: u32,
    /// Event and late messages received.
    pub events: u32,
    /// Known messages outside their windows.
    pub misplaced: u32,
    /// Messages with identifiers that the network does not have.
    pub foreign: u32,
    /// Messages of the wrong length.
    pub wrong_length: u32,
    /// Frames received while not in schedule.
    pub not_in_schedule: u32,
    /// Received frames whose stamp was before that of the last one.
    pub stamps_backwards: u32,
    /// Frames that the controller lost because its receive buffer was full.
    pub overruns: u32,
    /// Scheduled messages sent.
    pub sent: u32,
    /// Own windows that the application left empty.
    pub left_empty: u32,
    /// Own windows skipped because the owner asked too late, or another
    /// transmission was still pending.
    pub skipped: u32,
    /// Own windows skipped because of the error level.
    pub suppressed: u32,
    /// Own windows skipped because the rate of the node's clock was not measured
    /// yet, so that their beginning was uncertain.
    pub unmeasured: u32,
    /// Own transmissions that lost arbitration.
    pub arbitration_lost: u32,
    /// Own transmissions that an error destroyed.
    pub transmit_errors: u32,
    /// Own transmissions that were withdrawn, usually because they did not begin
    /// within the transmit enable window (Tx_Enable_Window).
    pub aborted: u32,
    /// Event and late messages sent.
    pub events_sent: u32,
    /// Event and late messages dropped because they expired.
    pub events_expired: u32,
    /// Event and late messages refused because the queue was full.
    pub events_refused: u32,
    /// Reports of transmissions that this node did not request.
    pub stray_reports: u32,
    /// Matrices with more transmissions than scheduled.
    pub transmit_overflows: u32,
    /// Matrices with fewer transmissions than scheduled.
    pub transmit_underflows: u32,
    /// Steps of global time, announced or not.
    pub time_steps: u32,
    /// Corrections of global time refused because of the drift limit.
    pub drift_refused: u32,
}

impl Counters {
    /// Nothing has happened. A constant, because the default value is built on the stack first.
    pub(super) const NONE: Self = Self {
        references: 0,
        missed_references: 0,
        repeated_references: 0,
        malformed_references: 0,
        unknown_masters: 0,
        impostors: 0,
        untimely_references: 0,
        cycle_count_errors: 0,
        master_changes: 0,
        scheduled: 0,
        missed_messages: 0,
        events: 0,
        misplaced: 0,
        foreign: 0,
        wrong_length: 0,
        not_in_schedule: 0,
        stamps_backwards: 0,
        overruns: 0,
        sent: 0,
        left_empty: 0,
        skipped: 0,
        suppressed: 0,
        unmeasured: 0,
        arbitration_lost: 0,
        transmit_errors: 0,
        aborted: 0,
        events_sent: 0,
        events_expired: 0,
        events_refused: 0,
        stray_reports: 0,
        transmit_overflows: 0,
        transmit_underflows: 0,
        time_steps: 0,
        drift_refused: 0,
    };
}
