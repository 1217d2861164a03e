//! Pieces of cable and the bit in progress on each.

use crate::Frame;
use crate::time::Ps;
use crate::wire::Level;

#[derive(Clone, Copy, Debug)]
pub(super) struct Bit {
    pub(super) start: Ps,
    pub(super) end: Ps,
    pub(super) level: Level,
}

/// A piece of cable: the bus, or what a cut-off node hears.
#[derive(Clone, Debug)]
pub(super) struct Segment {
    /// The bit in progress; none while the segment rests.
    pub(super) bit: Option<Bit>,
    /// Level of the bit before.
    pub(super) previous: Level,
    /// The node whose clock sets the pace.
    pub(super) pace: usize,
    /// Number of the bit in progress, counted from the latest start of frame.
    pub(super) position: u16,
    pub(super) frame_start: Ps,
    /// A disturbance has touched the frame in progress.
    pub(super) disturbed: bool,
    /// Frames whose last bit is in progress.
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
