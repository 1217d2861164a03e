//! All runs have the key of the network: what nodes do for sessions is nothing.

use firmware::e2e::{self, Secret};
use firmware::link::{Link, Port, WindowTimer};

/// Those that obey commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actuator {
    /// The steering node.
    Steering,
    /// The drive node.
    Drive,
}

/// No session comes.
pub type News = Option<Option<Secret>>;

/// Nothing.
pub struct Session(Secret);

impl Session {
    /// Counts nothing.
    pub const fn of<U>(_: Actuator, secret: Secret, _: &mut U) -> Self {
        Self(secret)
    }

    /// Waits for nothing.
    pub const fn of_sender(secret: Secret) -> Self {
        Self(secret)
    }

    /// That of the node.
    pub const fn secret(&self) -> Option<Secret> {
        Some(self.0)
    }

    /// Nothing to tell or to hear.
    pub const fn step<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
        &mut self,
        _: &mut Link<P, T, WINDOWS, NODES>,
    ) -> bool {
        false
    }
}

/// Commands can be sealed from the beginning.
pub const fn can_seal(_: &e2e::Sender) -> bool {
    true
}

/// Nothing changes.
pub const fn change(_: &mut e2e::Sender, _: &mut News) {}
