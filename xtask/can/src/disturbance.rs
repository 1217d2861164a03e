//! Disturbances of the medium: flipped bits, a bit error rate, a stuck bus.

use embedded_can::Id;

use crate::node_id::NodeId;
use crate::time::{Ps, SimDuration, SimTime};
use crate::wire::Level;

/// Selects an attempt to send a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FrameSelect {
    /// The n-th start of frame on the bus, counted from 0 since the bus was created.
    Number(u64),
    /// The n-th attempt (from 0, counted from the call of [`crate::Bus::disturb`]) to send a
    /// frame with this identifier.
    Id {
        /// The identifier.
        id: Id,
        /// Attempts to skip.
        occurrence: u64,
    },
}

/// The nodes that read a disturbed bit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeenBy {
    /// Every node: the bus itself has the wrong level.
    All,
    /// One node only, as with a bad contact at its plug.
    Node(NodeId),
}

/// A disturbance. It affects the bits of frames, error frames and intermissions. Only
/// [`Disturbance::Stuck`] affects an idle bus.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Disturbance {
    /// One bit is inverted.
    Flip {
        /// The frame.
        frame: FrameSelect,
        /// The bit, counted from start of frame as 0, stuff bits included.
        bit: u16,
        /// The nodes that read it inverted.
        seen_by: SeenBy,
    },
    /// Bits are inverted at random, independently of each other.
    ErrorRate {
        /// Probability for each bit, 0 to 1.
        per_bit: f64,
        /// Seed of the random sequence.
        seed: u64,
        /// The nodes that read them inverted.
        seen_by: SeenBy,
        /// First instant.
        from: SimTime,
        /// The disturbance ends before this time.
        until: SimTime,
    },
    /// A foreign node that reads along destroys each frame with one identifier, or each frame: it drives
    /// six dominant bits from one bit of the frame on, as an error flag does. The sender counts an
    /// error each time, until it is off the bus.
    Suppress {
        /// The identifier; any one if `None`.
        id: Option<Id>,
        /// The first dominant bit, counted from start of frame as 0, stuff bits included. From 13 on the
        /// identifier is known: the bits before it decide who sends.
        bit: u16,
        /// The node that does it: its own frames are left alone.
        spared: Option<NodeId>,
        /// First instant.
        from: SimTime,
        /// Frames that begin from this time on are left alone.
        until: SimTime,
    },
    /// The bus is held dominant from behind one bit of a frame on, so that it is the frame's sender that finds
    /// the errors.
    Hold {
        /// The frame.
        frame: FrameSelect,
        /// The last bit that is left alone, counted from start of frame as 0, stuff bits included.
        bit: u16,
        /// How long.
        hold: SimDuration,
    },
    /// The bus is held at one level whatever the nodes drive.
    Stuck {
        /// The level.
        level: Level,
        /// First instant.
        from: SimTime,
        /// The disturbance ends before this time.
        until: SimTime,
    },
}

/// Number of dominant bits of an error flag (ISO 11898-1, clause 10.4.4).
const FLAG_BITS: u16 = 6;

/// A disturbance with the state it needs.
#[derive(Clone, Debug)]
pub(crate) struct Active {
    what: Disturbance,
    /// Attempts with the selected identifier so far, or bits until the next error.
    count: u64,
    /// True if the current frame is a selected one.
    armed: bool,
    /// True if the flip is done, or its frame has ended without that bit.
    spent: bool,
    random: SplitMix,
}

impl Active {
    pub(crate) fn new(what: Disturbance) -> Self {
        let seed = match what {
            Disturbance::ErrorRate { seed, .. } => seed,
            _ => 0,
        };
        let mut active = Self {
            what,
            count: 0,
            armed: false,
            spent: false,
            random: SplitMix(seed),
        };
        if let Disturbance::ErrorRate { per_bit, .. } = what {
            active.count = active.random.gap(per_bit);
        }
        active
    }

    /// A frame starts at `now`: its number and its senders with their identifiers.
    pub(crate) fn frame_started(&mut self, now: Ps, number: u64, senders: &[(Id, NodeId)]) {
        match self.what {
            Disturbance::Flip { frame, .. } | Disturbance::Hold { frame, .. } => {
                self.spent |= self.armed;
                self.armed = match frame {
                    FrameSelect::Number(wanted) => {
                        self.spent |= number > wanted;
                        number == wanted
                    }
                    FrameSelect::Id { id, occurrence } => {
                        let named = senders.iter().any(|(own, _)| *own == id);
                        self.count += u64::from(named);
                        named && self.count == occurrence + 1
                    }
                };
            }
            Disturbance::Suppress {
                id,
                spared,
                from,
                until,
                ..
            } => {
                // The least identifier is the one that remains after the arbitration.
                let winner = senders.iter().min();
                let is_meant = winner.is_some_and(|(winner, node)| {
                    id.is_none_or(|id| id == *winner) && spared != Some(*node)
                });
                self.armed = is_meant && from.as_ticks() <= now && now < until.as_ticks();
            }
            Disturbance::ErrorRate { .. } | Disturbance::Stuck { .. } => {}
        }
    }

    /// The nodes that read the bit at `now` inverted; `in_frame` is its index if it belongs to a
    /// frame. Call this exactly once per bit.
    pub(crate) fn flips(&mut self, now: Ps, in_frame: Option<u16>) -> Option<SeenBy> {
        match self.what {
            Disturbance::Flip { bit, seen_by, .. } => {
                (self.armed && in_frame == Some(bit)).then(|| {
                    self.armed = false;
                    self.spent = true;
                    seen_by
                })
            }
            Disturbance::Hold { bit, hold, .. } => {
                if self.armed && in_frame == Some(bit) {
                    let from = SimTime::from_ticks(now);
                    self.what = Disturbance::Stuck {
                        level: Level::Dominant,
                        from,
                        until: from + hold,
                    };
                }
                None
            }
            Disturbance::ErrorRate {
                per_bit,
                seen_by,
                from,
                until,
                ..
            } => {
                if now < from.as_ticks() || now >= until.as_ticks() {
                    return None;
                }
                if self.count > 0 {
                    self.count -= 1;
                    return None;
                }
                self.count = self.random.gap(per_bit);
                Some(seen_by)
            }
            Disturbance::Suppress { .. } | Disturbance::Stuck { .. } => None,
        }
    }

    /// The level that the bus is forced to; `in_frame` as for [`Active::flips`].
    pub(crate) fn stuck(&self, now: Ps, in_frame: Option<u16>) -> Option<Level> {
        match self.what {
            Disturbance::Suppress { bit, .. } if self.armed => {
                let flag = bit..bit.saturating_add(FLAG_BITS);
                let hit = in_frame.is_some_and(|position| flag.contains(&position));
                hit.then_some(Level::Dominant)
            }
            Disturbance::Stuck { level, from, until }
                if now >= from.as_ticks() && now < until.as_ticks() =>
            {
                Some(level)
            }
            _ => None,
        }
    }

    /// The time at which the disturbance ends the idle state of the bus.
    pub(crate) fn wakes(&self, now: Ps) -> Option<Ps> {
        match self.what {
            Disturbance::Stuck {
                level: Level::Dominant,
                from,
                until,
            } if now < until.as_ticks() => Some(from.as_ticks().max(now)),
            _ => None,
        }
    }

    /// True if the disturbance can have no further effect.
    pub(crate) fn is_over(&self, now: Ps) -> bool {
        match self.what {
            Disturbance::Flip { .. } | Disturbance::Hold { .. } => self.spent,
            Disturbance::ErrorRate { until, .. } | Disturbance::Stuck { until, .. } => {
                now >= until.as_ticks()
            }
            Disturbance::Suppress { until, .. } => now >= until.as_ticks() && !self.armed,
        }
    }

    /// The earliest time at which it may change a bit of the frame that started at `start`. `bit`
    /// is the bit time. `None` if it cannot affect this frame.
    pub(crate) fn earliest_in_frame(&self, start: Ps, now: Ps, bit: Ps) -> Option<Ps> {
        match self.what {
            Disturbance::Flip { bit: index, .. }
            | Disturbance::Hold { bit: index, .. }
            | Disturbance::Suppress { bit: index, .. } => {
                self.armed.then(|| start + u64::from(index) * bit)
            }
            Disturbance::ErrorRate { from, until, .. } => (now < until.as_ticks())
                .then(|| from.as_ticks().max(now + self.count.saturating_mul(bit))),
            Disturbance::Stuck { from, until, .. } => {
                (now < until.as_ticks()).then(|| from.as_ticks().max(now))
            }
        }
    }

    /// The earliest time at which it may affect a frame that has not started yet; `None` if it
    /// cannot any more.
    pub(crate) fn earliest_in_future(&self, now: Ps) -> Option<Ps> {
        match self.what {
            Disturbance::Flip { .. } | Disturbance::Hold { .. } => Some(now),
            Disturbance::ErrorRate { from, until, .. }
            | Disturbance::Suppress { from, until, .. }
            | Disturbance::Stuck { from, until, .. } => {
                (now < until.as_ticks()).then(|| from.as_ticks().max(now))
            }
        }
    }
}

/// Steele, Lea and Flood's SplitMix64 (OOPSLA 2014): reproducible everywhere from its seed.
#[derive(Clone, Debug)]
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    /// Number of bits before the next error, geometrically distributed.
    fn gap(&mut self, per_bit: f64) -> u64 {
        let uniform = ((self.next() >> 11) as f64 + 0.5) / (1_u64 << 53) as f64;
        if per_bit >= 1.0 {
            return 0;
        }
        if per_bit <= 0.0 {
            return u64::MAX;
        }
        let gap = uniform.ln() / (1.0 - per_bit).ln();
        if gap >= u64::MAX as f64 {
            u64::MAX
        } else {
            gap as u64
        }
    }
}
