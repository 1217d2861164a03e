//! What a node tells its application.

use crate::clock::ClockState;
use crate::frame::Frame;
use crate::id::Id;
use crate::supervision::ErrorLevel;

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
