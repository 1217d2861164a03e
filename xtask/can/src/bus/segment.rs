//! Cable segments and the current bit on each.

use crate::Frame;
use crate::time::Ps;
use crate::wire::Level;

#[derive(Clone, Copy, Debug)]
pub(super) struct Bit {
    pub(super) start: Ps,
    pub(super) end: Ps,
    pub(super) level: Level,
}

/// A cable segment: the bus, or the private segment of a disconnected node.
#[derive(Clone, Debug)]
pub(super) struct Segment {
    /// The current bit; `None` while the segment is idle.
    pub(super) bit: Option<Bit>,
    /// Level of the previous bit.
    pub(super) previous: Level,
    /// The node whose clock determines the bit time.
    pub(super) pace: usize,
    /// Index of the current bit, counted from the latest start of frame.
    pub(super) position: u16,
    pub(super) frame_start: Ps,
    /// True if a disturbance has affected the current frame.
    pub(super) disturbed: bool,
    /// Frames whose last bit is the current one.
    pub(super) finished: Vec<(usize, Frame)>,
}

impl Segment {
    pub(super) const fn new() -> Self {
        Self {
            bit: None,
            previous: Level::Recessive,
            pace: 0,
            position: 0,
            frame_start: 0,
            disturbed: false,
            finished: Vec::new(),
        }
    }
}
