//! The records of an ideal bus analyser.

use crate::Frame;
use crate::confinement::{ErrorKind, ErrorState};
use crate::node_id::NodeId;
use crate::time::SimTime;

/// An event on the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Record {
    /// When.
    pub at: SimTime,
    /// The node that it concerns; for frames, their sender.
    pub node: NodeId,
    /// What.
    pub kind: RecordKind,
}

/// The kinds of [`Record`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RecordKind {
    /// The node has started to send: the edge of start of frame. Simultaneous senders give one
    /// record each.
    FrameStart {
        /// The frame.
        frame: Frame,
    },
    /// A frame has been sent. The time is the end of the last bit of end of frame, where a logger
    /// on the bus puts its time stamp.
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
        /// True if the node was sending the frame.
        transmitter: bool,
    },
    /// The node's error state has changed.
    StateChange {
        /// The new state.
        state: ErrorState,
    },
}
