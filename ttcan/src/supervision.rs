//! What a node learns from comparing the bus with the schedule.

/// Error level of a node (ISO 11898-4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ErrorLevel {
    /// S0: no error.
    None,
    /// S1, warning: message status counts more than 2 apart, a receive count of
    /// 7, or fewer transmissions in a matrix than scheduled.
    Warning,
    /// S2, error: a transmit count of 7, or more transmissions in a matrix than
    /// scheduled. Only references are sent.
    Error,
    /// S3, severe error: nothing at all is sent, no acknowledgement either.
    Severe(Severe),
}

/// What brought a node to S3.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Severe {
    /// The watch trigger: references ceased.
    Watch,
    /// The controller went bus-off.
    BusOff,
    /// The application did not feed its watchdog in time.
    ApplicationWatchdog,
}

/// State of one window.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub struct WindowStatus {
    /// ISO's message status count, 0 to 7: up by one for each time that the
    /// message was not seen (or not sent) in its exclusive window, down by one
    /// for each time that it was.
    pub status_count: u8,
    /// How often in a row the message was not seen (or not sent).
    pub missed: u8,
}

/// A peer's failure class (thesis 4.3.7), judged from the schedule alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Health {
    /// Not one of its messages has been seen since this node is in schedule.
    #[default]
    Unknown,
    /// Its messages come in their windows.
    Healthy,
    /// All its windows of two basic cycles stayed empty.
    Dead,
    /// Its messages come, but outside their windows.
    Lost,
    /// More of its messages come outside their windows in one basic cycle than
    /// it has windows in two.
    Babbling,
}

/// Highest message status count.
const FULL: u8 = 7;

/// Message status counts of all windows, with what the error levels ask of
/// them kept up to date, so that no check looks at all windows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Counts<const W: usize> {
    windows: [WindowStatus; W],
    /// Exclusive windows at each count, and a bit for each count that has any.
    at: [u16; FULL as usize + 1],
    present: u8,
    own_full: u16,
    others_full: u16,
}

impl<const W: usize> Counts<W> {
    pub const fn new(exclusive: u16) -> Self {
        Self {
            windows: [WindowStatus {
                status_count: 0,
                missed: 0,
            }; W],
            at: [exclusive, 0, 0, 0, 0, 0, 0, 0],
            present: 1,
            own_full: 0,
            others_full: 0,
        }
    }

    pub fn get(&self, window: u16) -> Option<WindowStatus> {
        self.windows.get(usize::from(window)).copied()
    }

    /// Notes whether the message of a window was there.
    // In every place that calls it, it would be a tenth of a small image.
    #[inline(never)]
    pub fn note(&mut self, window: u16, own: bool, seen: bool) {
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

    /// Takes back that the message of a window was noted as missing.
    pub fn take_back(&mut self, window: u16) {
        // Once for the miss, and once for having been there.
        self.note(window, false, true);
        self.note(window, false, true);
    }

    /// Cuts runs of missed messages off at `many`.
    #[cfg(feature = "std")]
    pub fn cut(&mut self, many: u8) {
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
    pub fn warns(&self) -> bool {
        // From the lowest to the highest count that a window has.
        let span = self.present >> (self.present.trailing_zeros() & 7);
        span > 0b111 || self.others_full > 0
    }

    /// Whether a transmit count is full.
    pub fn fails(&self) -> bool {
        self.own_full > 0
    }
}

/// What is known of a peer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub(crate) struct Peer {
    heard: bool,
    /// Empty windows of the peer in a row.
    empty: u16,
    /// Up by two for each message out of place, down by one for each in place.
    astray: u8,
    /// Messages out of place in the basic cycle numbered `cycle`.
    in_cycle: u16,
    cycle: u32,
}

/// From this on a peer counts as lost: two messages out of place without one
/// in place between.
const LOST: u8 = 4;
const MOST_ASTRAY: u8 = 16;
/// Frames out of place in a basic cycle that are never babbling.
const FORGIVEN: u16 = 4;

impl Peer {
    pub fn seen(&mut self) {
        self.heard = true;
        self.empty = 0;
        self.astray = self.astray.saturating_sub(1);
    }

    pub fn missing(&mut self) {
        self.empty = self.empty.saturating_add(1);
    }

    pub fn astray(&mut self, cycle: u32) {
        if self.cycle != cycle {
            self.cycle = cycle;
            self.in_cycle = 0;
        }
        self.heard = true;
        self.in_cycle = self.in_cycle.saturating_add(1);
        self.astray = (self.astray + 2).min(MOST_ASTRAY);
    }

    /// Makes the basic cycle numbered `cycle` number 0, and forgets what has
    /// no influence any more.
    #[cfg(feature = "std")]
    pub fn normalise(&mut self, cycle: u32, in_two_cycles: u16) {
        self.empty = self.empty.min(in_two_cycles.max(2));
        let age = cycle.wrapping_sub(self.cycle);
        if age > 1 || self.in_cycle == 0 {
            self.in_cycle = 0;
            self.cycle = 0;
        } else {
            self.in_cycle = self.in_cycle.min(in_two_cycles.max(FORGIVEN) + 1);
            self.cycle = age.wrapping_neg();
        }
    }

    /// `cycle` is the running number of the basic cycle, `in_two_cycles` the
    /// number of windows that the peer has in two of them.
    pub fn health(&self, cycle: u32, in_two_cycles: u16) -> Health {
        let recent = self.cycle == cycle || self.cycle.wrapping_add(1) == cycle;
        if !self.heard && self.empty == 0 {
            Health::Unknown
        } else if recent && self.in_cycle > in_two_cycles.max(FORGIVEN) {
            Health::Babbling
        } else if self.astray >= LOST {
            Health::Lost
        } else if self.empty >= in_two_cycles.max(2) {
            Health::Dead
        } else if self.heard {
            Health::Healthy
        } else {
            Health::Unknown
        }
    }
}
