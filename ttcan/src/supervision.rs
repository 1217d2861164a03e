//! What a node learns from comparing the bus with the schedule.

use crate::features::PEERS;
use crate::matrix::NodeId;

/// Error level of a node (ISO 11898-4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ErrorLevel {
    /// S0: no error.
    None,
    /// S1, warning: message status counts more than 2 apart, a receive count of
    /// 7, or fewer transmissions in a matrix than scheduled.
    Warning,
    /// S2, error: a transmit count of 7, or more transmissions in a matrix than
    /// scheduled. Only references are sent.
    Error,
    /// S3, severe error: the controller sends no dominant bit, not even an
    /// acknowledgement.
    Severe(Severe),
}

/// Cause of S3. The numbers leave those below for the other error levels, so that levels are compared
/// as numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Severe {
    /// The watch trigger (Watch_Trigger): references ceased.
    Watch = 3,
    /// The controller went bus-off.
    BusOff,
    /// The application did not feed its watchdog in time.
    ApplicationWatchdog,
    /// The application took the node off the bus.
    Withdrawn,
}

/// State of one window.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct WindowStatus {
    /// Message status count (ISO 11898-4), 0 to 7. It goes up by one each time the
    /// message was not seen (or not sent, in an own window), and down by one each
    /// time it was.
    pub status_count: u8,
    /// Windows in a row in which the message was not seen (or not sent).
    pub missed: u8,
}

/// Failure class of another node (thesis 4.3.7), judged by the schedule alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Health {
    /// None of its messages was seen since the start.
    #[default]
    Unknown,
    /// Its messages are in their windows.
    Healthy,
    /// All its windows of two basic cycles stayed empty.
    Dead,
    /// Its messages are outside their windows, and its last window was empty.
    Lost,
    /// Its last window was empty, and in the current basic cycle or the one before,
    /// more of its messages were outside their windows than it has windows in two.
    Babbling,
    /// Its message came in its last window, but others with its identifiers are
    /// outside. It babbles, or another node sends under its name (masquerade, ISO
    /// 26262-6 annex D). Only the node itself can tell:
    /// [`Fault::Impostor`](crate::Fault::Impostor).
    Masquerade,
}

/// Highest message status count.
const FULL: u8 = 7;

/// Message status counts of all windows. What the error levels depend on is kept up
/// to date with each change, so that no check loops over all windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Counts<const W: usize> {
    windows: [WindowStatus; W],
    /// Number of exclusive windows at each count.
    at: [u16; FULL as usize + 1],
    /// A bit for each count that a window has.
    present: u8,
    /// Own windows at the highest count.
    own_full: u16,
    /// Windows of other nodes at the highest count.
    others_full: u16,
}

impl<const W: usize> Counts<W> {
    /// No window.
    const NEW: Self = Self {
        windows: [WindowStatus {
            status_count: 0,
            missed: 0,
        }; W],
        at: [0; FULL as usize + 1],
        present: 0,
        own_full: 0,
        others_full: 0,
    };

    /// `exclusive` windows, all with a count of 0.
    fn restart(&mut self, exclusive: u16) {
        *self = Self::NEW;
        let [at_none, ..] = &mut self.at;
        *at_none = exclusive;
        self.present = 1;
    }

    pub(crate) fn get(&self, window: u16) -> Option<WindowStatus> {
        self.windows.get(usize::from(window)).copied()
    }

    /// Changes the count of a window whose message was seen, or not.
    fn note(&mut self, window: u16, own: bool, seen: bool) {
        let Some(status) = self.windows.get_mut(usize::from(window)) else {
            return;
        };
        let before = status.status_count;
        if seen {
            status.missed = 0;
            status.status_count = before.saturating_sub(1);
        } else {
            status.missed = status.missed.saturating_add(1);
            status.status_count = (before + 1).min(FULL);
        }
        let after = status.status_count;
        self.moved(before, after, own);
    }

    /// Limits runs of missed messages to `many`.
    #[cfg(feature = "std")]
    pub(crate) fn cut(&mut self, many: u8) {
        for window in &mut self.windows {
            window.missed = window.missed.min(many);
        }
    }

    fn moved(&mut self, before: u8, after: u8, own: bool) {
        if let Some(count) = self.at.get_mut(usize::from(before)) {
            *count = count.saturating_sub(1);
            if *count == 0 {
                self.present &= !(1 << before);
            }
        }
        if let Some(count) = self.at.get_mut(usize::from(after)) {
            *count = count.saturating_add(1);
            self.present |= 1 << after;
        }
        let full = if own {
            &mut self.own_full
        } else {
            &mut self.others_full
        };
        match (before == FULL, after == FULL) {
            (false, true) => *full = full.saturating_add(1),
            (true, false) => *full = full.saturating_sub(1),
            _ => {}
        }
    }

    /// Whether counts are more than 2 apart or a receive count is full.
    pub(crate) fn warns(&self) -> bool {
        // From the lowest to the highest count that a window has.
        let span = self.present >> (self.present.trailing_zeros() & 7);
        span > 0b111 || self.others_full > 0
    }

    /// Whether a transmit count is full.
    pub(crate) fn fails(&self) -> bool {
        self.own_full > 0
    }
}

/// Which messages of a node were received since the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Heard {
    Nothing,
    /// Only messages outside their windows.
    Outside,
    /// A message in its window, or a reference.
    InWindow,
}

/// What a node knows about another one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Peer {
    heard: Heard,
    /// Empty windows of the node in a row.
    empty: u16,
    /// Goes up by two for each message outside its window, down by one for each
    /// message in its window.
    misplaced: u8,
    /// Messages outside their windows in basic cycle `cycle`.
    in_cycle: u16,
    /// The same of the basic cycle before that.
    in_last: u16,
    /// Running number of the basic cycle with the last such message.
    cycle: u32,
}

/// Value of `Peer::misplaced` from which a node counts as lost: two messages outside
/// their windows without one in its window between them.
const LOST: u8 = 4;
/// Highest value of `Peer::misplaced`.
const MOST_MISPLACED: u8 = 16;
/// So many messages outside their windows in a basic cycle are never babbling.
const FORGIVEN: u16 = 4;

impl Peer {
    /// Nothing is known.
    const NEW: Self = Self {
        heard: Heard::Nothing,
        empty: 0,
        misplaced: 0,
        in_cycle: 0,
        in_last: 0,
        cycle: 0,
    };

    pub(crate) fn seen(&mut self) {
        self.heard = Heard::InWindow;
        self.empty = 0;
        self.misplaced = self.misplaced.saturating_sub(1);
    }

    pub(crate) fn missing(&mut self) {
        self.empty = self.empty.saturating_add(1);
    }

    pub(crate) fn misplaced(&mut self, cycle: u32) {
        if self.cycle != cycle {
            let next = self.cycle.wrapping_add(1) == cycle;
            self.in_last = if next { self.in_cycle } else { 0 };
            self.cycle = cycle;
            self.in_cycle = 0;
        }
        if self.heard == Heard::Nothing {
            self.heard = Heard::Outside;
        }
        self.in_cycle = self.in_cycle.saturating_add(1);
        self.misplaced = (self.misplaced + 2).min(MOST_MISPLACED);
    }

    /// Renumbers basic cycles so that `cycle` becomes 0, and forgets what has no
    /// influence any more.
    #[cfg(feature = "std")]
    pub(crate) fn normalise(&mut self, cycle: u32, in_two_cycles: u16) {
        self.empty = self.empty.min(in_two_cycles.max(2));
        let age = cycle.wrapping_sub(self.cycle);
        let most = in_two_cycles.max(FORGIVEN).saturating_add(1);
        self.in_last = if age == 0 { self.in_last.min(most) } else { 0 };
        if age > 1 || self.in_cycle == 0 {
            self.in_cycle = 0;
            self.cycle = 0;
        } else {
            self.in_cycle = self.in_cycle.min(most);
            self.cycle = age.wrapping_neg();
        }
    }

    /// `cycle` is the running number of the current basic cycle, `in_two_cycles`
    /// the number of windows that the node has in two of them.
    pub(crate) fn health(&self, cycle: u32, in_two_cycles: u16) -> Health {
        // A current basic cycle is not over, so the one before counts, too.
        let outside = if self.cycle == cycle {
            self.in_cycle.max(self.in_last)
        } else if self.cycle.wrapping_add(1) == cycle {
            self.in_cycle
        } else {
            0
        };
        let babbles = outside > in_two_cycles.max(FORGIVEN);
        if self.heard == Heard::Nothing && self.empty == 0 {
            Health::Unknown
        } else if (babbles || self.misplaced >= LOST)
            && self.empty == 0
            && self.heard == Heard::InWindow
        {
            Health::Masquerade
        } else if babbles {
            Health::Babbling
        } else if self.misplaced >= LOST {
            Health::Lost
        } else if self.empty >= in_two_cycles.max(2) {
            Health::Dead
        } else if self.heard != Heard::Nothing {
            Health::Healthy
        } else {
            Health::Unknown
        }
    }
}

/// References that did not come.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum Missing {
    /// So many in a row since the last reference, or since the start.
    InRow(u8),
    /// The initial watch trigger has passed: there was none since the start.
    Initial,
}

/// How the transmissions of this node compare with the schedule of a whole
/// matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Balance {
    Even,
    /// Fewer than scheduled in the matrix before.
    Underflow,
    /// More than scheduled in the current matrix.
    Overflow,
}

/// Transmissions of this node in the current matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Budget {
    /// Own windows that were used.
    served: u16,
    /// Whether the node was in schedule from the beginning of the matrix.
    whole: bool,
    balance: Balance,
}

impl Budget {
    const NEW: Self = Self {
        served: 0,
        whole: false,
        balance: Balance::Even,
    };
}

/// What a node learns about the network and itself, and its error level.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
// What is used most is in front of the arrays, where short instructions reach it.
#[repr(C)]
pub(crate) struct Supervision<const W: usize, const P: usize> {
    pub(crate) missing: Missing,
    level: ErrorLevel,
    budget: Budget,
    counts: Counts<W>,
    peers: [Peer; P],
}

impl<const W: usize, const P: usize> Supervision<W, P> {
    /// Nothing known, before the first [`Self::reset`]. A constant, because a value that is made at run
    /// time is built on the stack first.
    pub(crate) const NEW: Self = Self {
        missing: Missing::InRow(0),
        level: ErrorLevel::None,
        budget: Budget::NEW,
        counts: Counts::NEW,
        peers: [Peer::NEW; P],
    };

    /// Begins everything anew.
    pub(crate) fn reset(&mut self, exclusive: u16) {
        // Part by part: as a whole it would take its size on the stack once more.
        self.peers = [Peer::NEW; P];
        self.missing = Missing::InRow(0);
        self.level = ErrorLevel::None;
        self.clear(exclusive);
    }

    /// Begins status counts and budget anew. S3 stays.
    pub(crate) fn clear(&mut self, exclusive: u16) {
        self.counts.restart(exclusive);
        self.budget = Budget::NEW;
        self.assess();
    }

    /// Enters S3.
    pub(crate) fn stop(&mut self, cause: Severe) {
        self.level = ErrorLevel::Severe(cause);
    }

    pub(crate) const fn level(&self) -> ErrorLevel {
        self.level
    }

    pub(crate) fn window(&self, window: u16) -> Option<WindowStatus> {
        self.counts.get(window)
    }

    pub(crate) fn peer(&mut self, node: NodeId) -> Option<&mut Peer> {
        if PEERS {
            self.peers.get_mut(usize::from(node.0))
        } else {
            None
        }
    }

    /// Health of a node; see [`Peer::health`].
    #[cfg(feature = "peers")]
    pub(crate) fn health(&self, node: NodeId, cycle: u32, in_two_cycles: u16) -> Health {
        self.peers
            .get(usize::from(node.0))
            .map_or(Health::Unknown, |peer| peer.health(cycle, in_two_cycles))
    }

    /// Notes whether the message of an exclusive window was seen (or sent, if
    /// the window is this node's own).
    // In every place that calls it, it would be a tenth of a small image.
    #[inline(never)]
    pub(crate) fn note(&mut self, window: u16, own: bool, seen: bool) {
        self.counts.note(window, own, seen);
        self.assess();
    }

    /// Takes back that the message of another node's window was noted as
    /// missing: once for the miss, and once because it was seen.
    // The smallest images have no room for it in the place that calls it.
    #[cfg_attr(not(feature = "global-time"), inline(never))]
    pub(crate) fn take_back(&mut self, window: u16) {
        self.note(window, false, true);
        self.note(window, false, true);
    }

    /// Begins a matrix, with `scheduled` own windows in each. `false` if fewer
    /// than that were used in the whole of the matrix before.
    pub(crate) fn begin_matrix(&mut self, scheduled: u16, in_schedule: bool) -> bool {
        let short = self.budget.whole && self.budget.served < scheduled;
        self.budget = Budget {
            served: 0,
            whole: in_schedule,
            balance: if short {
                Balance::Underflow
            } else {
                Balance::Even
            },
        };
        self.assess();
        !short
    }

    /// Counts a transmission in an own window. `false` if it exceeds the
    /// `scheduled` ones of a matrix.
    pub(crate) fn spend(&mut self, scheduled: u16) -> bool {
        self.skip();
        if self.budget.served > scheduled {
            self.budget.balance = Balance::Overflow;
            self.assess();
            return false;
        }
        true
    }

    /// Counts an own window that is left empty on purpose as used.
    pub(crate) fn skip(&mut self) {
        self.budget.served = self.budget.served.saturating_add(1);
    }

    /// Finds the error level from what is known. S3 stays.
    fn assess(&mut self) {
        if let ErrorLevel::Severe(_) = self.level {
            return;
        }
        self.level = if self.budget.balance == Balance::Overflow || self.counts.fails() {
            ErrorLevel::Error
        } else if self.budget.balance == Balance::Underflow || self.counts.warns() {
            ErrorLevel::Warning
        } else {
            ErrorLevel::None
        };
    }

    /// Forgets what has no influence any more, and numbers the basic cycle
    /// `cycle` 0. `missed` cuts off runs of missed messages; `in_two_cycles`
    /// tells how many windows a node has in two basic cycles.
    #[cfg(feature = "std")]
    pub(crate) fn normalise(
        &mut self,
        missed: u8,
        cycle: u32,
        in_two_cycles: impl Fn(NodeId) -> u16,
    ) {
        self.counts.cut(missed);
        for (index, peer) in self.peers.iter_mut().enumerate() {
            peer.normalise(cycle, in_two_cycles(NodeId(index as u16)));
        }
    }
}
