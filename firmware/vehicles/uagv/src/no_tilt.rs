//! The ground counts as level: what nodes do for roll and pitch is nothing.

use firmware::link::{Link, Port, WindowTimer};
use firmware::pilot::Inputs;

use crate::Pilot;

/// No message.
pub const fn take<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    _: &mut Link<P, T, WINDOWS, NODES>,
) {
}

/// Nothing to know.
#[derive(Clone, Copy, Debug, Default)]
pub struct Watch;

impl Watch {
    /// Nothing.
    #[must_use]
    pub const fn new() -> Self {
        Self
    }

    /// Nothing to tell.
    #[inline(always)]
    pub const fn step(&mut self, _: &mut Pilot, _: &mut Inputs, (): ()) {}

    /// No message.
    pub const fn state(&self) {}

    /// Nothing to put.
    pub const fn put<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
        _: &mut Link<P, T, WINDOWS, NODES>,
        (): (),
    ) {
    }
}
