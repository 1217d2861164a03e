//! What a vehicle's network file says of frames: the windows in which they are due, their signals, and
//! how long they are.

pub(crate) mod decode;
pub(crate) mod length;
pub(crate) mod matrix;

/// Time within which a change of the mode and the event that tells it belong together, s.
pub(crate) const SAME_CHANGE: f64 = 0.5;
