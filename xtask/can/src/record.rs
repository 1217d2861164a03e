//! What an ideal analyser on the bus writes down.

use crate::Frame;
use crate::confinement::{ErrorKind, ErrorState};
use crate::node_id::NodeId;
use crate::time::SimTime;

/// Something that happened on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    /// When.
    pub at: SimTime,
    /// The node it happened to; for frames, their sender.
    pub node: NodeId,
    /// What.
    pub kind: RecordKind,
}

/// The kinds of [`Record`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordKind {
    /// The node has begun to send: the edge of start of frame, one record for each of several
    /// simultaneous senders.
    FrameStart {
        /// The frame.
        frame: Frame,
    },
    /// A frame has been sent: the end of the last bit of end of frame, where a logger on the bus
    /// sets its time stamp.
    FrameEnd {
        /// The frame.
        frame: Frame,
        /// Its start of frame.
        start: SimTime,
        /// Bits from start of frame to end of frame, stuff bits included, intermission not.
        bits: u16,
    },
    /// The node's frame has lost arbitration.
    ArbitrationLost {
        /// The frame.
        frame: Frame,
        /// The bit, counted from start of frame as 0.
        bit: u16,
    },
    /// The node has detected an error.
    Error {
        /// Its kind.
        kind: ErrorKind,
        /// The bit, counted from start of frame as 0; 0 outside frames.
        bit: u16,
        /// Whether the node was sending the frame.
        transmitter: bool,
    },
    /// The node's error state is another one now.
    StateChange {
        /// The new state.
        state: ErrorState,
    },
}
