//! The starts of the nodes that obey commands, and the session that follows from them.
//!
//! Both tell their starts in each basic cycle, long before the next command is sealed. So after a start all who seal or
//! judge commands change to the new session in the same cycle.

use firmware::e2e::{self, Secret};
use firmware::link::{Link, Port, WindowTimer, padded};
use firmware::starts::{self, Units};
use network::Message;

use crate::matrix::window;
use crate::messages::{DriveStart, SteeringStart};

/// Those that obey commands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Actuator {
    /// The steering node.
    Steering,
    /// The drive node.
    Drive,
}

/// A session that is not used yet; `None` inside of it if not all starts are known any more.
pub type News = Option<Option<Secret>>;

/// What a node knows of the session.
pub struct Session {
    session: e2e::Session<2>,
    /// What this node is, if it obeys commands, and the number of its start, 0 if it has none.
    own: Option<(Actuator, u32)>,
}

impl Session {
    /// That of an actuator. Its start is counted in `units` if there is a key. If it cannot be counted, the node obeys
    /// no command.
    pub fn of(actuator: Actuator, secret: Secret, units: &mut impl Units) -> Self {
        let counted = match secret {
            Secret::Key(_) => starts::count(units).unwrap_or(0),
            Secret::None | Secret::Damaged => 0,
        };
        let mut session = e2e::Session::new(secret);
        session.hear(actuator as usize, counted);
        Self {
            session,
            own: Some((actuator, counted)),
        }
    }

    /// That of a node that only seals commands.
    pub const fn of_sender(secret: Secret) -> Self {
        Self {
            session: e2e::Session::new(secret),
            own: None,
        }
    }

    /// The secret of the session, if there is one.
    pub fn secret(&self) -> Option<Secret> {
        self.session.secret()
    }

    /// A step of the housekeeping: sends the number of this node's start, and takes those of the others. Returns whether
    /// the session has changed; its [`secret`](Self::secret) takes too long for a lock of the bus.
    pub fn step<P: Port, T: WindowTimer, const WINDOWS: usize, const NODES: usize>(
        &mut self,
        link: &mut Link<P, T, WINDOWS, NODES>,
    ) -> bool {
        let own = self.own.map(|(actuator, _)| actuator);
        match self.own {
            Some((Actuator::Steering, number)) => {
                link.put(
                    window::STEERING_START,
                    padded(SteeringStart { number }.encode()),
                );
            }
            Some((Actuator::Drive, number)) => {
                link.put(window::DRIVE_START, padded(DriveStart { number }.encode()));
            }
            None => {}
        }
        let mut changed = false;
        // A node never takes its own number from the bus.
        if own != Some(Actuator::Steering)
            && let Some(frame) = link.take(window::STEERING_START)
            && let Ok(told) = SteeringStart::decode(frame.data())
        {
            changed |= self.session.hear(Actuator::Steering as usize, told.number);
        }
        if own != Some(Actuator::Drive)
            && let Some(frame) = link.take(window::DRIVE_START)
            && let Ok(told) = DriveStart::decode(frame.data())
        {
            changed |= self.session.hear(Actuator::Drive as usize, told.number);
        }
        changed
    }
}

/// Whether a command can be sealed.
pub const fn can_seal(sender: &e2e::Sender) -> bool {
    sender.can_seal()
}

/// Seals commands in the session that has come.
pub fn change(sender: &mut e2e::Sender, news: &mut News) {
    if let Some(secret) = news.take() {
        sender.set_secret(secret);
    }
}
