//! No missions: the controller follows the line between the waypoints.

use ttcan::Frame;

/// Nothing to plan.
pub type Plan = ();

/// Nothing to show.
pub type Shown = ();

/// Nothing to receive.
#[derive(Debug)]
pub struct Words;

impl Words {
    /// No words.
    #[allow(
        clippy::new_without_default,
        reason = "it is made where the program is compiled"
    )]
    pub const fn new() -> Self {
        Self
    }
}

/// No requests.
#[derive(Debug)]
pub struct Requests;

impl Requests {
    /// No requests.
    #[allow(clippy::new_without_default, reason = "as the one of missions is")]
    pub const fn new() -> Self {
        Self
    }

    /// Forgets a frame.
    #[inline(always)]
    pub const fn push(&mut self, _: &Frame) {}
}
