//! Global time on a node: offset and rate against its own counter.
//!
//! Each reference message carries the global time of the reference before (see
//! [`ReferenceFormat`](crate::ReferenceFormat)). A node therefore has a pair of
//! local stamp and global time for every basic cycle. The first pair sets the
//! offset. The second sets the rate (ISO 11898-4: change of the master's mark
//! over change of the local mark). After that an alpha-beta filter corrects both,
//! because stamps that are taken in an interrupt carry its latency as noise.
//! Between references, and when they cease, time runs on at the last rate
//! (holdover).

use crate::features::GLOBAL_TIME;
use crate::time::{GlobalTime, Stamp};

/// How far a node's global time can be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ClockState {
    /// No global time is known.
    Unset,
    /// The time is this node's own; it has received none.
    Own,
    /// The offset is known, the rate not yet.
    Offset,
    /// Offset and rate follow the master.
    Locked,
    /// The last correction required more drift than the limit. It was not made,
    /// and time runs on at the rate before.
    Suspended,
}

/// Result of a correction by a pair of stamp and global time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Correction {
    /// The time was set.
    Stepped,
    /// Offset and rate were corrected.
    Applied,
    /// It required more drift than the limit and was not made.
    Suspended,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Clock {
    ticks_per_us: u32,
    /// Nominal length of a tick in 2^-16 us, with 15 fractional bits (a
    /// resolution of 7e-9 at 16 ticks per microsecond).
    nominal: u32,
    /// The same, corrected by the rate.
    gain: u32,
    /// Rate of global time against the counter less 1, in 2^-32.
    rate: i32,
    /// Largest rate, in 2^-32.
    limit: i32,
    /// A recent stamp, and the global time at it.
    anchor: Stamp,
    global: GlobalTime,
    state: ClockState,
    /// Corrections refused in a row.
    refused: u8,
    /// How long the filter has followed without a large error; see [`GAINS`].
    settled: u8,
}

/// Fractional bits of the gain. Its product with 32 bits of ticks fits in 64.
const GAIN_BITS: u32 = 15;
/// Largest correction in one cycle: 2 us in 2^-16 us. A larger error is not the
/// noise of an interrupt.
const LARGEST_STEP: i64 = 2 << GlobalTime::FRACTION_BITS;
/// Gains of the filter: the number of good corrections from which they apply, and
/// the shifts for offset and rate. It is fast at first and then averages over more
/// and more stamps.
const GAINS: [(u8, u32, u32); 3] = [(0, 1, 3), (6, 2, 5), (16, 3, 7)];
/// Largest count of good corrections, and how many of them a bad one undoes.
const SETTLED: u8 = 24;
const UNSETTLED: u8 = 4;
/// After this many refused corrections in a row the time of the master is taken:
/// another master may have another time.
const REFUSALS: u8 = 3;

/// A rate of `ppm`, up to 10 000, in 2^-32.
fn limit_of(ppm: u16) -> i32 {
    // 2^32 / 10^6, rounded.
    i32::from(ppm.min(10_000) as i16) * 4295
}

impl Clock {
    /// `ticks_per_us` from 1 to 1000; `limit_ppm` up to 10 000.
    pub(crate) fn new(ticks_per_us: u32, limit_ppm: u16) -> Self {
        let ticks_per_us = ticks_per_us.max(1);
        let nominal = (1 << (GlobalTime::FRACTION_BITS + GAIN_BITS)) / ticks_per_us;
        Self {
            ticks_per_us,
            nominal,
            gain: nominal,
            rate: 0,
            limit: limit_of(limit_ppm),
            anchor: Stamp(0),
            global: GlobalTime::default(),
            state: ClockState::Unset,
            refused: 0,
            settled: 0,
        }
    }

    /// Changes the largest rate, ppm.
    pub(crate) fn set_limit(&mut self, ppm: u16) {
        self.limit = limit_of(ppm);
    }

    /// The rate is unknown again. The time stays.
    pub(crate) fn forget_rate(&mut self) {
        self.rate = 0;
        self.gain = self.nominal;
        self.settled = 0;
        self.refused = 0;
        if self.state != ClockState::Unset {
            self.state = ClockState::Own;
        }
    }

    pub(crate) fn state(&self) -> ClockState {
        self.state
    }

    /// Rate against the counter less 1, in 2^-32.
    pub(crate) fn rate(&self) -> i32 {
        self.rate
    }

    pub(crate) fn at(&self, stamp: Stamp) -> Option<GlobalTime> {
        match self.state {
            _ if !GLOBAL_TIME => None,
            ClockState::Unset => None,
            _ => Some(self.extrapolate(stamp)),
        }
    }

    fn extrapolate(&self, stamp: Stamp) -> GlobalTime {
        self.global
            .offset(self.duration(stamp.ticks_since(self.anchor)))
    }

    /// Ticks in 2^-16 us of global time.
    pub(crate) fn duration(&self, ticks: i32) -> i64 {
        let gain = if GLOBAL_TIME { self.gain } else { self.nominal };
        (i64::from(ticks) * i64::from(gain)) >> GAIN_BITS
    }

    /// Ticks that a time of the schedule takes on this node's counter.
    pub(crate) fn ticks(&self, micros: u32) -> u32 {
        let nominal = micros.wrapping_mul(self.ticks_per_us);
        if !GLOBAL_TIME {
            return nominal;
        }
        let correction = (i64::from(nominal) * i64::from(self.rate)) >> 32;
        nominal.wrapping_sub(correction as u32)
    }

    /// Largest error of a time of the schedule on this node's counter, in
    /// microseconds: what the drift limit allows until the rate is measured.
    pub(crate) fn rate_error(&self, micros: u32) -> u32 {
        match self.state {
            ClockState::Locked | ClockState::Suspended => 0,
            _ => ((u64::from(micros) * u64::from(self.limit.unsigned_abs())) >> 32) as u32,
        }
    }

    /// Ticks in whole microseconds of global time; 0 for negative ticks.
    pub(crate) fn micros(&self, ticks: i32) -> u32 {
        (self.duration(ticks).max(0) >> GlobalTime::FRACTION_BITS) as u32
    }

    /// Moves the anchor to `stamp` without changing the time. The counter must not
    /// run half its range away from the anchor.
    pub(crate) fn carry(&mut self, stamp: Stamp) {
        if !GLOBAL_TIME {
            return;
        }
        self.global = self.extrapolate(stamp);
        self.anchor = stamp;
    }

    /// Renumbers stamps so that `stamp` becomes 0, and sets the time at it.
    #[cfg(feature = "std")]
    pub(crate) fn restart(&mut self, stamp: Stamp, global: GlobalTime) {
        self.carry(stamp);
        self.anchor = Stamp(0);
        self.global = global;
    }

    /// Sets the time at `stamp`.
    pub(crate) fn set(&mut self, stamp: Stamp, global: GlobalTime) {
        self.anchor = stamp;
        self.global = global;
        self.state = ClockState::Own;
        self.refused = 0;
    }

    /// Corrects the clock: the master's time was `global` at `stamp`.
    /// `discontinuity` tells that the master's time was set.
    pub(crate) fn correct(
        &mut self,
        stamp: Stamp,
        global: GlobalTime,
        discontinuity: bool,
    ) -> Correction {
        let elapsed = stamp.ticks_since(self.anchor);
        let span = self.duration(elapsed);
        let error = global.since(self.extrapolate(stamp));
        let first = matches!(self.state, ClockState::Unset | ClockState::Own);
        if first || discontinuity {
            self.leap(stamp, global, first);
            return Correction::Stepped;
        }
        if elapsed <= 0 {
            // This node sent the reference itself, so the pair has no rate.
            if error.abs() <= LARGEST_STEP {
                return Correction::Applied;
            }
            self.leap(stamp, global, true);
            return Correction::Stepped;
        }
        // 2 us for the noise of two stamps, and the drift limit times the time
        // between them.
        let allowed = (((span >> 8) * i64::from(self.limit)) >> 24) + LARGEST_STEP;
        if error.abs() > allowed {
            self.refused = self.refused.saturating_add(1);
            if self.refused >= REFUSALS {
                self.leap(stamp, global, true);
                return Correction::Stepped;
            }
            self.state = ClockState::Suspended;
            self.carry(stamp);
            return Correction::Suspended;
        }
        if self.state == ClockState::Offset {
            self.set_rate(self.rate.saturating_add(rate_of(error, span)));
            self.global = global;
        } else {
            // A large error means that a crystal's rate or the master changed.
            self.settled = if error.abs() < LARGEST_STEP {
                (self.settled + 1).min(SETTLED)
            } else {
                self.settled.saturating_sub(UNSETTLED)
            };
            let error = error.clamp(-LARGEST_STEP, LARGEST_STEP);
            let (mut offset, mut rate) = (0, 0);
            for (from, offset_shift, rate_shift) in GAINS {
                if self.settled >= from {
                    (offset, rate) = (offset_shift, rate_shift);
                }
            }
            self.global = self.extrapolate(stamp).offset(error >> offset);
            self.set_rate(self.rate.saturating_add(rate_of(error, span) >> rate));
        }
        self.anchor = stamp;
        self.state = ClockState::Locked;
        self.refused = 0;
        Correction::Applied
    }

    fn leap(&mut self, stamp: Stamp, global: GlobalTime, forget_rate: bool) {
        self.anchor = stamp;
        self.global = global;
        self.refused = 0;
        if forget_rate {
            self.settled = 0;
            self.state = ClockState::Offset;
        }
    }

    fn set_rate(&mut self, rate: i32) {
        // Not `clamp`, which panics if its limits are out of order.
        self.rate = rate.min(self.limit).max(self.limit.wrapping_neg());
        let correction = (i64::from(self.nominal) * i64::from(self.rate)) >> 32;
        self.gain = self.nominal.wrapping_add_signed(correction as i32);
    }
}

/// `error` over `span` in 2^-32, both in 2^-16 us, by long division in steps of
/// 32 bits. Larger errors count as 32 ms.
#[inline(never)]
fn rate_of(error: i64, span: i64) -> i32 {
    let span = (span >> GlobalTime::FRACTION_BITS).clamp(1, 1 << 27) as u32;
    let mut rest = error.unsigned_abs().min(i32::MAX as u64) as u32;
    let mut rate = rest / span;
    rest %= span;
    for _ in 0..4 {
        rest <<= 4;
        rate = (rate << 4).wrapping_add(rest / span);
        rest %= span;
    }
    let rate = rate.min(i32::MAX as u32).cast_signed();
    if error < 0 { -rate } else { rate }
}

#[cfg(test)]
mod tests {
    use super::rate_of;

    #[test]
    fn rates_are_quotients() {
        for (error, span) in [
            (0, 1 << 33),
            (655, 100_000 << 16),
            (-655_360, 100_000 << 16),
            (1_310_720, 100_000 << 16),
            (131_072, 500 << 16),
            (6_553_600, 10_000_000 << 16),
        ] {
            let exact = (i128::from(error) << 32) / i128::from(span);
            assert_eq!(i128::from(rate_of(error, span)), exact, "{error} / {span}");
        }
    }
}
