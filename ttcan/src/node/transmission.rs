//! The pending transmission, and the messages that wait for one.

use crate::frame::Frame;
use crate::id::Id;
use crate::queue::{Place, Queue};
use crate::time::Stamp;

/// Own transmissions.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct Transmission<const Q: usize> {
    pub(super) pending: Pending,
    /// Event and late messages for arbitrating windows.
    pub(super) queue: Queue<Q>,
}

/// The transmission that was requested and whose end is not reported yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Pending {
    None,
    Reference(OwnReference),
    Window(OwnMessage),
    Event {
        /// Place of the message in the queue.
        place: Place,
    },
    /// The node stopped before the end was reported. The controller may hold the frame still.
    Abandoned,
}

/// A reference message of this node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct OwnReference {
    pub(super) frame: Frame,
    pub(super) cycle: u8,
    pub(super) next_is_gap: bool,
    pub(super) discontinuity: bool,
    /// When it was first requested.
    pub(super) requested: Stamp,
}

/// A message of this node in its exclusive window.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct OwnMessage {
    /// Index of the window in the matrix.
    pub(super) window: u16,
    pub(super) id: Id,
    pub(super) len: u8,
    pub(super) retry_late: bool,
}

impl<const Q: usize> Transmission<Q> {
    pub(super) const fn new() -> Self {
        Self {
            pending: Pending::None,
            queue: Queue::EMPTY,
        }
    }

    /// Place in the queue of the message whose transmission is pending.
    pub(super) fn place(&self) -> Option<Place> {
        match self.pending {
            Pending::Event { place } => Some(place),
            _ => None,
        }
    }

    /// Whether no transmission is pending.
    pub(super) fn is_idle(&self) -> bool {
        self.pending == Pending::None
    }
}
