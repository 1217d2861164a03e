//! What a node reports to its owner, and what it asks of it.

use crate::clock::ClockState;
use crate::frame::Frame;
use crate::id::Id;
use crate::supervision::ErrorLevel;

/// Synchronisation state (ISO 11898-4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum SyncState {
    /// Not started, or stopped by S3.
    Off,
    /// Waiting for the second of two consecutive references.
    Synchronising,
    /// Following the schedule.
    InSchedule,
    /// Following the schedule, which is suspended until an event.
    InGap,
}

/// Master state (ISO 11898-4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum MasterState {
    /// Not started, or stopped by S3.
    Off,
    /// Not a potential master, or no reference was seen yet.
    Follower,
    /// A potential master; another one sends the references.
    Backup,
    /// The time master that sends the references.
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
    /// Cycle count of the current basic cycle, 0 before the first one.
    pub cycle: u8,
    /// Rank of the master whose reference began it.
    pub master_rank: Option<u8>,
    /// Whether the initial watch trigger (Init_Watch_Trigger) has passed: no
    /// reference was seen since the start.
    pub initial_watch: bool,
    /// How reliable the global time is.
    pub clock: ClockState,
    /// Current reference trigger offset in microseconds, -127 to 127.
    pub reference_offset: i8,
}

/// How a received frame was taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reception {
    /// A reference; a basic cycle has begun.
    Reference {
        /// Its cycle count.
        cycle: u8,
        /// Rank of the master.
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
    /// Any other frame; do not use its data.
    Fault(Fault),
}

/// Why a received frame is not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// This node is not in schedule.
    NotInSchedule,
    /// The identifier is known, but the frame is not in its window.
    Misplaced,
    /// No node of the network sends this identifier.
    Foreign,
    /// The message has another length in the matrix.
    Length,
    /// A reference without the required fields, or with a cycle count or a gap that the
    /// matrix does not have.
    MalformedReference,
    /// A reference with a rank that no master has.
    UnknownMaster,
    /// A frame with an identifier that only this node sends: another node sends under its
    /// name. Messages are found so with the feature `peers` of the crate.
    Impostor,
    /// A reference in the middle of a basic cycle of a better-ranked master.
    UntimelyReference,
    /// The stamp is before that of the last received frame.
    StampBackwards,
}

/// Permission to send a scheduled message now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Grant {
    /// Index of the window in the matrix.
    pub window: u16,
    /// Identifier to send with.
    pub id: Id,
    /// Number of data bytes to send.
    pub len: u8,
    /// Whether the message is late, and sent in an arbitrating window.
    pub late: bool,
}

/// What the owner of the node is to do now.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Send this reference message once, without automatic retransmission.
    TransmitReference(Frame),
    /// Send the message of this window, once, or report
    /// [`TransmitOutcome::Empty`].
    Transmit(Grant),
    /// Send this event message, once.
    TransmitEvent(Frame),
    /// Withdraw the frame that was requested last, unless it is on the bus already.
    Abort,
    /// Withdraw everything. The controller must send no dominant bit, not even
    /// acknowledgements, until the node is started again.
    Silence,
}

/// How a transmission ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TransmitOutcome {
    /// The frame was sent and acknowledged.
    Sent,
    /// It lost arbitration to another frame.
    ArbitrationLost,
    /// An error destroyed the frame.
    Error,
    /// The frame was withdrawn before it began.
    Aborted,
    /// The application had nothing to send in its window. This is not an error.
    Empty,
}

/// Why an event message was not enqueued.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QueueError {
    /// The queue is full.
    Full,
    /// This node sends no event message of this identifier and length.
    NotAnEvent,
    /// The lifetime is too long for the counter: it must not exceed 2^30 ticks.
    Lifetime,
    /// No message of this identifier waits that could be replaced.
    NoneWaits,
}

impl core::fmt::Display for QueueError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Full => "the event queue is full",
            Self::NotAnEvent => "the matrix names no such event message of this node",
            Self::Lifetime => "the lifetime is too long for the counter",
            Self::NoneWaits => "no event message of this identifier waits",
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
