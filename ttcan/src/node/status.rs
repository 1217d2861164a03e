//! What a node tells its application.

use crate::parts::COUNTERS;
use crate::supervision::ErrorLevel;
use crate::{ClockState, Frame, Id};

/// Synchronisation state (ISO 11898-4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SyncState {
    /// Not started, or stopped by S3.
    Off,
    /// Waiting for the second of two consecutive references.
    Synchronising,
    /// Keeping the schedule.
    InSchedule,
    /// Keeping the schedule, which is suspended until an event.
    InGap,
}

/// Master state (ISO 11898-4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MasterState {
    /// Not started, or stopped by S3.
    Off,
    /// No potential master, or none that has seen a reference yet.
    Follower,
    /// A potential master while another one is in charge.
    Backup,
    /// The time master in charge.
    Current,
}

/// State of a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Status {
    /// Synchronisation state.
    pub sync: SyncState,
    /// Master state.
    pub master: MasterState,
    /// Error level.
    pub error_level: ErrorLevel,
    /// References missing in a row.
    pub missed_references: u8,
    /// The basic cycle under way.
    pub cycle: u8,
    /// Rank of the master whose reference began it.
    pub master_rank: Option<u8>,
    /// Whether the initial watch trigger has passed: no reference was ever
    /// seen.
    pub initial_watch: bool,
    /// How far the global time can be relied on.
    pub clock: ClockState,
    /// Actual reference trigger offset in microseconds, -127 to 127.
    pub reference_offset: i8,
}

/// What became of a received frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reception {
    /// A reference; a basic cycle has begun.
    Reference {
        /// Its number.
        cycle: u8,
        /// The rank of the master.
        rank: u8,
    },
    /// A message in its exclusive window.
    Scheduled {
        /// Index of the window in the matrix.
        window: u16,
    },
    /// An event message in an arbitrating window.
    Event,
    /// A scheduled message that missed its window, in an arbitrating window.
    Late {
        /// Index of one of its windows in the matrix.
        window: u16,
    },
    /// Anything else; do not use the frame's data.
    Fault(Fault),
}

/// Why a received frame is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// This node keeps no schedule (yet).
    NotInSchedule,
    /// The identifier is known, but its place is elsewhere.
    Misplaced,
    /// No node of the network sends this identifier.
    Foreign,
    /// The length is not the one of the message.
    Length,
    /// A reference without the fields it needs, or of a cycle that does not
    /// exist.
    MalformedReference,
    /// A reference with a rank that nobody or this node itself has.
    UnknownMaster,
    /// A reference in the middle of a basic cycle of a better or equal master.
    UntimelyReference,
    /// The stamp precedes the one before.
    StampBackwards,
}

/// Leave to send a scheduled message now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grant {
    /// Index of the window in the matrix.
    pub window: u16,
    /// Identifier to send with.
    pub id: Id,
    /// Number of data bytes to send.
    pub len: u8,
    /// Whether this is an arbitrating window in which the message may be sent
    /// late.
    pub late: bool,
}

/// What the node's owner is to do now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Send this reference message, once.
    TransmitReference(Frame),
    /// Send the message of this window, once, or report
    /// [`TransmitOutcome::Empty`].
    Transmit(Grant),
    /// Send this event message, once.
    TransmitEvent(Frame),
    /// Withdraw the frame last asked for unless it is on the bus already.
    Abort,
    /// Withdraw everything and put the controller where it sends no dominant
    /// bit, not even acknowledgements, until the node is started again.
    Silence,
}

/// How a transmission ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TransmitOutcome {
    /// The frame was sent and acknowledged.
    Sent,
    /// Another frame won the bus.
    ArbitrationLost,
    /// An error destroyed the frame.
    Error,
    /// It was withdrawn before it began.
    Aborted,
    /// The application had nothing to send in its window, which is no error.
    Empty,
}

/// An event message was not queued.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QueueError {
    /// The queue is full.
    Full,
    /// This node sends no event message of this identifier and length.
    NotAnEvent,
    /// The lifetime is too long for the counter: it must not exceed 2^30 ticks.
    Lifetime,
}

impl core::fmt::Display for QueueError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Full => "the event queue is full",
            Self::NotAnEvent => "the matrix names no such event message of this node",
            Self::Lifetime => "the lifetime is too long for the counter",
        })
    }
}

impl core::error::Error for QueueError {}

/// Only the current time master may do this.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotInCharge;

impl core::fmt::Display for NotInCharge {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("only the current time master may do this")
    }
}

impl core::error::Error for NotInCharge {}

/// Counts something up.
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
