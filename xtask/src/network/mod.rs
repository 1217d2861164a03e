//! What a vehicle's network file says of frames: the windows in which they are due, and their signals.

pub(crate) mod decode;
pub(crate) mod matrix;
