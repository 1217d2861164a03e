//! What a potential time master knows beyond what every node does.

use super::status::MasterState;
use crate::features::MASTER;
use crate::time::Stamp;

/// How much earlier a better-ranked backup tries in each basic cycle, in
/// microseconds: two bits at 250 kbit/s, enough for its reference to begin
/// first.
const EARLIER: i8 = 8;

/// References in a row that announce a discontinuity of global time. A node that misses two in a row
/// is told by the third one; after two, actuators stop anyway.
pub(super) const ANNOUNCEMENTS: u8 = 3;

/// The role of a potential time master.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct MasterRole {
    pub(super) state: MasterState,
    /// Reference trigger offset in microseconds.
    pub(super) offset: i8,
    /// Change of the length of the basic cycle after the current one, in
    /// microseconds.
    pub(super) trim: i8,
    /// The next reference announces a gap.
    pub(super) gap_wanted: bool,
    /// So many of the next references announce a discontinuity of global time.
    pub(super) discontinuity: u8,
    /// The application's bytes in front of each reference.
    pub(super) payload: [u8; 8],
    pub(super) attempt: Attempt,
    /// Basic cycles of this master in a row that other nodes contradicted.
    disputed: u8,
}

/// The attempts of this node to send a reference since the last one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Attempt {
    pub(super) progress: Progress,
    /// A reference was missed while this node's own was pending.
    pub(super) missed_while_pending: bool,
    /// Other nodes sent messages that do not fit the basic cycle that this node
    /// began with a late reference.
    pub(super) contradicted: bool,
}

/// How far this node's own reference got.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Progress {
    /// It was not requested, or its start of frame was on time: the next attempt is
    /// like the first.
    None,
    /// It was first requested at this stamp, when another frame may have been on the
    /// bus.
    Repeated(Stamp),
    /// As `Repeated`, and it lost arbitration to a frame that was not received yet, or was
    /// withdrawn behind one.
    Lost(Stamp),
}

impl Attempt {
    pub(super) const NONE: Self = Self {
        progress: Progress::None,
        missed_while_pending: false,
        contradicted: false,
    };
}

impl Progress {
    /// When the reference was first requested.
    pub(super) const fn requested(self) -> Option<Stamp> {
        match self {
            Self::None => None,
            Self::Repeated(requested) | Self::Lost(requested) => Some(requested),
        }
    }
}

impl MasterRole {
    pub(super) const fn new() -> Self {
        Self {
            state: MasterState::Off,
            offset: 0,
            trim: 0,
            gap_wanted: false,
            discontinuity: 0,
            payload: [0; 8],
            attempt: Attempt::NONE,
            disputed: 0,
        }
    }

    /// Begins anew with this reference trigger offset. The application's bytes
    /// and a discontinuity that is not announced yet stay.
    pub(super) fn restart(&mut self, offset: i8) {
        self.state = MasterState::Follower;
        if MASTER {
            self.offset = offset;
            self.trim = 0;
            self.gap_wanted = false;
            self.attempt = Attempt::NONE;
            self.disputed = 0;
        }
    }

    /// Takes the role that a reference of the master of rank `sender` gives to
    /// this node of rank `own`. `before` is the master of the basic cycle
    /// before, `initial` the offset of a backup behind better-ranked masters.
    pub(super) fn follow(&mut self, own: u8, sender: u8, before: Option<u8>, initial: i8) {
        let trim = core::mem::take(&mut self.trim);
        if own == sender {
            self.state = MasterState::Current;
            self.offset = trim;
            return;
        }
        self.state = MasterState::Backup;
        self.offset = if sender < own {
            initial
        } else if before == Some(sender) {
            // Earlier in each basic cycle until this node's reference begins
            // first.
            self.offset.min(0).saturating_sub(EARLIER).max(-127)
        } else {
            0
        };
    }

    /// Whether other nodes contradict the basic cycle that this master just
    /// began. After `limit` such basic cycles in a row it no longer yields.
    pub(super) fn is_disputed(&mut self, limit: u8) -> bool {
        self.disputed = if self.attempt.contradicted {
            self.disputed.saturating_add(1)
        } else {
            0
        };
        (1..=limit).contains(&self.disputed)
    }
}
