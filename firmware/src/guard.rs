//! What a bus guardian tells.

use ttcan::guardian::Trip;

/// The trips of `NODES` guarded nodes that were told.
#[derive(Clone, Copy, Debug)]
pub struct Trips<const NODES: usize>([u16; NODES]);

impl<const NODES: usize> Trips<NODES> {
    /// No trip so far.
    pub const fn new() -> Self {
        Self([0; NODES])
    }

    /// Writes to the log of a debug probe that a node was cut, if its `trips` have changed. `node` is its
    /// number in the network.
    pub fn tell(&mut self, node: usize, (trips, reason): (u16, Option<Trip>)) {
        if let Some(told) = self.0.get_mut(node)
            && *told != trips
        {
            *told = trips;
            if let Some(reason) = reason {
                defmt::warn!("node {=usize} was cut: {}", node, reason);
            }
        }
    }
}

impl<const NODES: usize> Default for Trips<NODES> {
    fn default() -> Self {
        Self::new()
    }
}
