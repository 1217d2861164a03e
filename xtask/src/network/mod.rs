//! What a vehicle's network file says of frames: the windows in which they are due, their signals, and
//! how long they are.

pub(crate) mod decode;
pub(crate) mod length;
pub(crate) mod matrix;
