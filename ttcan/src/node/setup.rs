//! What a node is made from. It never changes.

use super::config::{ConfigError, NodeConfig};
use crate::features::{EVENTS, GAPS, GLOBAL_TIME, MASTER};
use crate::schedule::{Network, ScheduleView};

/// Largest distance of a deadline from now, in ticks. Stamps compare correctly
/// up to 2^31 ticks; half of that leaves room for late calls.
pub(super) const LONGEST_TICKS: u32 = 1 << 30;

/// More bit times than any frame with its interframe space takes.
pub(super) const LONGEST_BITS: u32 = 255;

/// Default difference of the reference trigger offsets of two ranks, in microseconds.
const OFFSET_OF_A_RANK: u8 = 16;

/// What a node is made from.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
// In this order, so that short instructions reach what is used most; see `Node`.
#[repr(C)]
pub(super) struct Setup<'s> {
    pub(super) schedule: ScheduleView<'s>,
    /// Length of a bit in 1/256 tick.
    bit: u32,
    /// Rank among the potential masters.
    rank: Option<u8>,
    /// Reference trigger offset of a backup behind better-ranked masters, in microseconds.
    pub(super) initial_offset: i8,
    /// Reference trigger offset of a potential master that does not have the time of the network: one
    /// step behind the last rank, in microseconds.
    pub(super) untimed_offset: i8,
    pub(super) config: NodeConfig,
    /// Basic cycles of this node's event messages: their number ends in these bits (the first number is
    /// the mask).
    event_cycles: (u8, u8),
}

impl<'s> Setup<'s> {
    /// Checks the configuration against the schedule.
    pub(super) fn new(schedule: ScheduleView<'s>, config: NodeConfig) -> Result<Self, ConfigError> {
        let network = schedule.network;
        if config.ticks_per_us == 0 || config.ticks_per_us > 1000 {
            return Err(ConfigError::Ticks);
        }
        let ticks = |micros: u32| micros.saturating_mul(config.ticks_per_us);
        let cycle = ticks(network.basic_cycle);
        let watchdog = config.application_watchdog.map_or(0, |time| time.ticks());
        let watch = cycle.saturating_mul(u32::from(config.watch) + 2);
        let longest = watch.max(ticks(network.longest_gap)).max(ticks(watchdog));
        if longest > LONGEST_TICKS {
            return Err(ConfigError::TooLong);
        }
        let latency = config.latency;
        let longest = latency
            .receive
            .unsigned_abs()
            .max(latency.transmit.unsigned_abs())
            .max(config.transmit_lead);
        if longest > cycle / 2 {
            return Err(ConfigError::Latency);
        }
        if MASTER && config.reference_offset.is_some_and(|offset| offset > 127) {
            return Err(ConfigError::ReferenceOffset);
        }
        if config.watch == 0 {
            return Err(ConfigError::Watch);
        }
        let rank = schedule.rank_of(config.node).filter(|_| config.may_lead);
        if rank.is_some() && !MASTER {
            return Err(ConfigError::Master);
        }
        if GLOBAL_TIME && config.drift_limit_ppm > 10_000 {
            return Err(ConfigError::Drift);
        }
        let bit = (u64::from(network.bit) * u64::from(config.ticks_per_us)) >> 8;
        // So that `bits` does not overflow for any frame.
        if bit >> 24 != 0 {
            return Err(ConfigError::Ticks);
        }
        let (repeat, offset) = if EVENTS {
            schedule.event_cycles(config.node)
        } else {
            (1, 0)
        };
        let of_rank = |rank: u8| rank.saturating_mul(OFFSET_OF_A_RANK);
        let by_rank = of_rank(rank.unwrap_or(0));
        let initial = config.reference_offset.unwrap_or(by_rank);
        let own = config.reference_offset.unwrap_or(0);
        let untimed = of_rank(network.master_count).max(own);
        Ok(Self {
            schedule,
            config,
            rank,
            initial_offset: initial.min(127) as i8,
            untimed_offset: untimed.min(127) as i8,
            bit: bit as u32,
            event_cycles: (repeat.wrapping_sub(1), offset),
        })
    }

    /// Whether this node may send its event messages in the basic cycle with this number.
    pub(super) fn may_send_events(&self, cycle: u8) -> bool {
        let (mask, offset) = self.event_cycles;
        EVENTS && cycle & mask == offset
    }

    pub(super) fn network(&self) -> &'s Network {
        self.schedule.network
    }

    /// Rank of this node as a potential master.
    pub(super) fn rank(&self) -> Option<u8> {
        if MASTER { self.rank } else { None }
    }

    /// Whether a reference may announce a gap.
    pub(super) fn has_gaps(&self) -> bool {
        GAPS && self.network().longest_gap > 0
    }

    /// Ticks that up to [`LONGEST_BITS`] bit times take.
    pub(super) fn bits(&self, bits: u32) -> u32 {
        self.bit.wrapping_mul(bits) >> 8
    }

    /// Cycle count of the basic cycle after number `cycle`.
    pub(super) fn cycle_after(&self, cycle: u8) -> u8 {
        cycle.wrapping_add(1) & self.network().cycles.wrapping_sub(1)
    }
}
