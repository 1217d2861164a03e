//! Nothing but the path guides a run: what the controller does for another guide is nothing.

use firmware::e2e::Secret;
use firmware::link::{Link, Port, WindowTimer};

use crate::Pilot;
use crate::peers::Peers;

/// No message.
pub const fn take<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    _: &mut Link<P, T, WINDOWS, NODES>,
) {
}

/// Nothing to believe.
pub const fn set_secret(_: &mut Pilot, _: Option<Secret>) {}

/// Nothing to see.
pub const fn see(_: &mut Pilot, (): (), _: u32) {}

/// No message.
pub const fn log(_: &Pilot) {}

/// Nothing to put.
pub const fn put<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
    _: &mut Link<P, T, WINDOWS, NODES>,
    (): (),
    _: &Peers,
) {
}
