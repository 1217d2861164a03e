//! The number of a node on a bus.

/// A node on a [`Bus`](crate::Bus).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct NodeId(pub(crate) usize);

impl NodeId {
    /// The number of the node: 0 for the first one added to its bus.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0
    }
}
