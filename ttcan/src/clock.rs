//! Global time on a node: offset and rate against its own counter.
//!
//! Each reference message carries the global time of the reference before (see
//! [`ReferenceFormat`](crate::ReferenceFormat)). A node therefore has a pair of
//! local stamp and global time for every basic cycle. The first pair sets the
//! offset. The second sets the rate (ISO 11898-4: change of the master's mark
//! over change of the local mark). After that an alpha-beta filter corrects both,
//! because stamps that are taken in an interrupt carry its latency as noise.
//! An error beyond that noise is corrected as soon as two references in a row agree
//! on it: the offset by what they have in common, and the rate by what the errors of two
//! basic cycles in a row have in common. So a step of the rate is gone within five basic
//! cycles, the clock follows an RC oscillator whose frequency drifts while the part
//! warms up, and a single disturbed stamp hardly moves it.
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
    /// The same, and it was announced for the first time.
    Postponed,
}

/// Facts about a clock, a bit for each: as `bool`s they would take more room.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) struct Flags(u8);

impl Flags {
    /// The rate was measured. Without that it is 0.
    pub(crate) const RATED: u8 = 1;
    /// The time was only assumed for the first reference of this node, which was not sent yet. The
    /// application does not see it.
    pub(crate) const ASSUMED: u8 = 2;
    /// The time is that of the network: taken from references since the start, or sent in references
    /// of this node.
    pub(crate) const AGREED: u8 = 4;
    /// A reference announced a discontinuity, and the time was not corrected since: the next reference
    /// is believed.
    pub(crate) const ANNOUNCED: u8 = 8;
    /// The last reference announced a discontinuity.
    pub(crate) const LAST_ANNOUNCES: u8 = 16;

    const fn has(self, flag: u8) -> bool {
        self.0 & flag != 0
    }

    const fn put(&mut self, flag: u8, on: bool) {
        self.0 = if on { self.0 | flag } else { self.0 & !flag };
    }
}

/// A stamp, and the master's time at the same instant.
struct Pair {
    stamp: Stamp,
    global: GlobalTime,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
// In this order, so that short instructions reach what is used most; see `Node`.
#[repr(C)]
pub(crate) struct Clock {
    state: ClockState,
    flags: Flags,
    /// Corrections refused in a row.
    refused: u8,
    /// How long the filter has followed without a large error; see [`gains`].
    settled: u8,
    ticks_per_us: u32,
    /// A recent stamp, and the global time at it.
    anchor: Stamp,
    /// Rate of global time against the counter less 1, in 2^-32.
    rate: i32,
    global: GlobalTime,
    /// Nominal length of a tick in 2^-16 us, with 15 fractional bits (a
    /// resolution of 7e-9 at 16 ticks per microsecond).
    nominal: u32,
    /// The same, corrected by the rate.
    gain: u32,
    /// Largest rate either way, in 2^-32.
    limit: u32,
    /// Ticks from the last correction to the anchor.
    since: i32,
    /// What the last correction left of the error, in 2^-16 us.
    rest: i32,
    /// The part of the last error that arose since the correction before, in 2^-16 us.
    arisen: i32,
}

/// Fractional bits of the gain. Its product with 32 bits of ticks fits in 64.
const GAIN_BITS: u32 = 15;
/// Largest error that can be the noise of an interrupt: 2 us in 2^-16 us. What
/// exceeds it is corrected once the next reference shows it, too, because a single
/// stamp may be disturbed by more.
const LARGEST_STEP: i32 = 2 << GlobalTime::FRACTION_BITS;
/// Gains of the filter for offset and rate, in 2^-10, after so many good corrections. They are those of
/// the least squares line through all stamps so far, so that noise of the first two stamps is soon
/// forgotten, and stay what they are when there are enough of them: 2 (2n - 1) / (n (n + 1)) and
/// 6 / (n (n + 1)) with n stamps (Brookner, Tracking and Kalman Filtering Made Easy, 1.2.10).
fn gains(settled: u8) -> (i32, i32) {
    // Two stamps made the first rate.
    let stamps = u32::from(settled) + 2;
    let pairs = stamps * (stamps + 1);
    let offset = ((2 * (2 * stamps - 1)) << GAIN_SHIFT) / pairs;
    let rate = (6 << GAIN_SHIFT) / pairs;
    (offset.cast_signed(), rate.cast_signed())
}
const GAIN_SHIFT: u32 = 10;
/// Largest count of good corrections, how many of them a bad one undoes, and the count below which it
/// undoes none: the first gains are for a clock that has nothing but two stamps.
const SETTLED: u8 = 24;
const UNSETTLED: u8 = 4;
const UNSURE: u8 = 4;
/// The count after an error that two references agreed on: the line through the stamps begins anew.
const RESTARTED: u8 = 1;
/// After this many refused corrections in a row the time of the master is taken:
/// another master may have another time.
const REFUSALS: u8 = 3;

/// A rate of `ppm`, up to 10 000, in 2^-32.
fn limit_of(ppm: u16) -> u32 {
    // 2^32 / 10^6, rounded.
    u32::from(ppm.min(10_000)) * 4295
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
            limit: if GLOBAL_TIME { limit_of(limit_ppm) } else { 0 },
            anchor: Stamp(0),
            global: GlobalTime::default(),
            state: ClockState::Unset,
            flags: Flags(0),
            since: 0,
            refused: 0,
            settled: 0,
            rest: 0,
            arisen: 0,
        }
    }

    /// Changes the largest rate, ppm. A larger one was measured against another oscillator of the
    /// master, and is unknown again.
    pub(crate) fn set_limit(&mut self, ppm: u16) {
        self.limit = limit_of(ppm);
        if self.rate.unsigned_abs() > self.limit {
            self.unrate();
            if matches!(self.state, ClockState::Locked | ClockState::Suspended) {
                self.state = ClockState::Offset;
            }
        }
    }

    /// The rate is unknown. It counts as 0.
    fn unrate(&mut self) {
        self.set_rate(0);
        self.flags.put(Flags::RATED, false);
        self.settled = 0;
        self.exact();
    }

    /// The rate is unknown again. The time stays.
    pub(crate) fn forget_rate(&mut self) {
        if !GLOBAL_TIME {
            return;
        }
        self.unrate();
        self.refused = 0;
        if self.state != ClockState::Unset {
            self.state = ClockState::Own;
        }
    }

    pub(crate) fn state(&self) -> ClockState {
        if self.has(Flags::ASSUMED) {
            ClockState::Unset
        } else {
            self.state
        }
    }

    /// Whether a flag is set.
    pub(crate) fn has(&self, flag: u8) -> bool {
        self.flags.has(flag)
    }

    /// Sets a flag, or takes it back.
    pub(crate) fn put(&mut self, flag: u8, on: bool) {
        self.flags.put(flag, on);
    }

    /// Whether the time is that of the network. A master that leads with another time must announce
    /// it.
    pub(crate) fn is_agreed(&self) -> bool {
        self.has(Flags::AGREED)
    }

    /// Rate against the counter less 1, in 2^-32.
    pub(crate) fn rate(&self) -> i32 {
        self.rate
    }

    /// Global time for the application.
    pub(crate) fn at(&self, stamp: Stamp) -> Option<GlobalTime> {
        self.sent_at(stamp).filter(|_| !self.has(Flags::ASSUMED))
    }

    /// Global time for references of this node.
    pub(crate) fn sent_at(&self, stamp: Stamp) -> Option<GlobalTime> {
        match self.state {
            _ if !GLOBAL_TIME => None,
            ClockState::Unset => None,
            _ => Some(self.extrapolate(stamp)),
        }
    }

    #[inline(never)]
    fn extrapolate(&self, stamp: Stamp) -> GlobalTime {
        self.global
            .offset(self.duration(stamp.ticks_since(self.anchor)))
    }

    /// Ticks in 2^-16 us of global time.
    pub(crate) fn duration(&self, ticks: i32) -> i64 {
        let gain = if GLOBAL_TIME { self.gain } else { self.nominal };
        (i64::from(ticks) * i64::from(gain)) >> GAIN_BITS
    }

    /// Ticks that a time of the schedule takes on this node's counter: less than 2^31.
    pub(crate) fn ticks(&self, micros: u32) -> u32 {
        let nominal = micros.wrapping_mul(self.ticks_per_us);
        if !GLOBAL_TIME {
            return nominal;
        }
        // With both signed, it is one instruction.
        let correction = (i64::from(nominal.cast_signed()) * i64::from(self.rate)) >> 32;
        nominal.wrapping_sub(correction as u32)
    }

    /// Largest error of a time of the schedule on this node's counter, in
    /// microseconds: what the drift limit allows until the rate is measured.
    pub(crate) fn rate_error(&self, micros: u32) -> u32 {
        if self.has(Flags::RATED) {
            return 0;
        }
        ((u64::from(micros) * u64::from(self.limit)) >> 32) as u32
    }

    /// Ticks in whole microseconds of global time; 0 for negative ticks.
    pub(crate) fn micros(&self, ticks: i32) -> u32 {
        let gain = if GLOBAL_TIME { self.gain } else { self.nominal };
        let ticks = ticks.max(0).unsigned_abs();
        ((u64::from(ticks) * u64::from(gain)) >> (GlobalTime::FRACTION_BITS + GAIN_BITS)) as u32
    }

    /// Moves the anchor to `stamp` without changing the time. The counter must not
    /// run half its range away from the anchor.
    pub(crate) fn carry(&mut self, stamp: Stamp) {
        if !GLOBAL_TIME {
            return;
        }
        self.global = self.extrapolate(stamp);
        if self.state != ClockState::Unset {
            let elapsed = stamp.ticks_since(self.anchor);
            self.since = self.since.saturating_add(elapsed.max(0));
        }
        self.anchor = stamp;
    }

    /// The node starts again. Its time and rate stay, but its counter may have wrapped meanwhile, and
    /// the time of the network may have been set.
    pub(crate) fn resume(&mut self, stamp: Stamp) {
        if !GLOBAL_TIME {
            return;
        }
        if self.has(Flags::ASSUMED) {
            self.state = ClockState::Unset;
        }
        self.flags = Flags(self.flags.0 & Flags::RATED);
        if self.at(stamp).is_some() {
            self.carry(stamp);
            self.state = ClockState::Own;
        }
    }

    /// Moves the anchor to a reference of this node's own. It leads by its time, which is right.
    pub(crate) fn lead(&mut self, stamp: Stamp) {
        self.flags = Flags(self.flags.0 & Flags::RATED | Flags::AGREED);
        self.carry(stamp);
        self.since = 0;
        self.exact();
    }

    /// Renumbers stamps so that `stamp` becomes 0. The time stays.
    #[cfg(feature = "std")]
    pub(crate) fn renumber(&mut self, stamp: Stamp) {
        self.anchor = Stamp(self.anchor.0.wrapping_sub(stamp.0));
    }

    /// Renumbers stamps so that `stamp` becomes 0, and sets the time at it.
    #[cfg(feature = "std")]
    pub(crate) fn restart(&mut self, stamp: Stamp, global: GlobalTime) {
        self.carry(stamp);
        self.anchor = Stamp(0);
        self.since = 0;
        self.global = global;
    }

    /// Assumes this time at `stamp` until a reference is sent or received.
    pub(crate) fn assume(&mut self, stamp: Stamp, global: GlobalTime) {
        self.set(stamp, global);
        self.flags.put(Flags::ASSUMED, true);
    }

    /// Sets the time at `stamp`.
    pub(crate) fn set(&mut self, stamp: Stamp, global: GlobalTime) {
        self.anchor = stamp;
        self.since = 0;
        self.global = global;
        self.flags.put(Flags::RATED, false);
        self.state = ClockState::Own;
        self.refused = 0;
        self.flags.put(Flags::ASSUMED, false);
    }

    /// Corrects the clock: the master's time was `global` at `stamp`.
    /// `announced` tells whether a reference before announced that the master's time was set, and
    /// whether this one does. A master announces a step in several references: a single one may
    /// be from another node that sends under its name.
    pub(crate) fn correct(
        &mut self,
        stamp: Stamp,
        global: GlobalTime,
        announced: (bool, bool),
    ) -> Correction {
        let correction = self.approach(&Pair { stamp, global }, announced);
        let agreed = match correction {
            Correction::Applied => true,
            // Without the rate, the time is soon wrong again.
            Correction::Stepped => self.has(Flags::RATED),
            // The time of an oscillator beyond the limit was set, which is all that can be done.
            Correction::Suspended => !self.has(Flags::RATED),
            Correction::Postponed => self.is_agreed(),
        };
        self.flags.put(Flags::ASSUMED, false);
        self.flags.put(Flags::AGREED, agreed);
        correction
    }

    // Not inlined: on its own, it takes less code for its fields than as a part of a node.
    #[inline(never)]
    fn approach(&mut self, pair: &Pair, announced: (bool, bool)) -> Correction {
        let (discontinuity, announced) = announced;
        let stamp = pair.stamp;
        let elapsed = stamp.ticks_since(self.anchor);
        // The error arose since the last correction. References without a correction moved the
        // anchor meanwhile.
        let span = self.since.saturating_add(elapsed.max(0));
        let error = saturated(pair.global.since(self.extrapolate(stamp)));
        let size = error.unsigned_abs();
        // Other nodes have the time of a master, too.
        let own = self.state == ClockState::Own;
        let first = self.state == ClockState::Unset || (own && !self.has(Flags::AGREED));
        let error_limit = self.error_limit(span);
        // A master announces a step to all nodes, also to those that have its time already.
        if first || (discontinuity && size > error_limit) {
            self.leap(pair, !self.has(Flags::RATED));
            if self.has(Flags::RATED) {
                self.state = ClockState::Locked;
            }
            return Correction::Stepped;
        }
        if elapsed <= 0 {
            // This node sent the reference itself, so the pair has no rate.
            if size <= LARGEST_STEP.unsigned_abs() {
                self.since = 0;
                self.exact();
                return Correction::Applied;
            }
            let one_second = self.ticks_per_us.wrapping_mul(1_000_000).cast_signed();
            if size <= self.error_limit(one_second) {
                self.leap(pair, true);
                return Correction::Stepped;
            }
        }
        // An error that was seen before waits for a second reference that agrees, and counts once.
        let arisen = error.saturating_sub(self.rest).unsigned_abs();
        if arisen > error_limit {
            if announced && (self.has(Flags::RATED) || own) {
                self.carry(stamp);
                return Correction::Postponed;
            }
            let refused = self.refused.saturating_add(1);
            self.refused = refused;
            if !self.has(Flags::RATED) && !own {
                // One of the two pairs is wrong, and without a rate this node cannot tell which.
                self.leap(pair, true);
                self.refused = refused;
                if refused < REFUSALS {
                    return Correction::Stepped;
                }
                self.state = ClockState::Suspended;
                return Correction::Suspended;
            }
            if refused >= REFUSALS {
                self.leap(pair, true);
                return Correction::Stepped;
            }
            if self.has(Flags::RATED) {
                self.state = ClockState::Suspended;
            }
            self.carry(stamp);
            self.since = 0;
            self.exact();
            return Correction::Suspended;
        }
        if !self.has(Flags::RATED) {
            self.set_rate(rate_of(error, self.micros(span)));
            self.global = pair.global;
        } else if self.since > 0 && arisen > self.error_limit(elapsed) {
            // It added up while references were lost.
            self.leap(pair, false);
        } else {
            self.filter(stamp, error, self.micros(span));
        }
        self.anchor = stamp;
        self.since = 0;
        self.flags.put(Flags::RATED, true);
        self.state = ClockState::Locked;
        self.refused = 0;
        Correction::Applied
    }

    /// Corrects offset and rate by a part of the error, which arose in this span of time.
    fn filter(&mut self, stamp: Stamp, error: i32, span: u32) {
        let arisen = error.saturating_sub(self.rest);
        // What is left is compared, not the error before, so that no offset is corrected twice.
        let offset = beyond_noise(common(self.rest, error));
        // The error of a wrong rate arises in each basic cycle, and that of an old offset does not. A
        // rate that is wrong by little does not stand out in one of them, but the offset that it
        // leaves does.
        let rate = common(self.arisen, arisen);
        let rate = if offset == 0 {
            beyond_noise(rate)
        } else {
            rate
        };
        self.settled = if offset != 0 || rate != 0 {
            RESTARTED
        } else if within_noise(error) == error {
            (self.settled + 1).min(SETTLED)
        } else {
            self.settled
                .saturating_sub(UNSETTLED)
                .max(self.settled.min(UNSURE))
        };
        let (alpha, beta) = gains(self.settled);
        let step = within_noise(error.saturating_sub(offset));
        let offset = offset.saturating_add((step * alpha) >> GAIN_SHIFT);
        let rate = if rate == 0 {
            (step * beta) >> GAIN_SHIFT
        } else {
            rate
        };
        self.global = self.extrapolate(stamp).offset(i64::from(offset));
        self.rest = error.saturating_sub(offset);
        self.arisen = arisen;
        self.set_rate(self.rate.saturating_add(rate_of(rate, span)));
    }

    /// Largest error that the drift limit allows for a number of ticks between two stamps, in
    /// 2^-16 us, and 2 us for their noise. It is less than what [`saturated`] leaves of
    /// an error beyond 32 ms: such an error tells no rate.
    // In every place that calls it, it would be in an image three times.
    #[inline(never)]
    fn error_limit(&self, ticks: i32) -> u32 {
        let allowed = u64::from(self.micros(ticks)) * u64::from(self.limit);
        let most = (i32::MAX - 1 - LARGEST_STEP).unsigned_abs();
        let allowed = (allowed >> GlobalTime::FRACTION_BITS).min(u64::from(most));
        allowed as u32 + LARGEST_STEP.unsigned_abs()
    }

    /// The time has no known error.
    fn exact(&mut self) {
        self.rest = 0;
        self.arisen = 0;
    }

    #[inline(never)]
    fn leap(&mut self, pair: &Pair, forget_rate: bool) {
        self.anchor = pair.stamp;
        self.since = 0;
        self.global = pair.global;
        self.exact();
        self.refused = 0;
        if forget_rate {
            self.unrate();
            self.state = ClockState::Offset;
        }
    }

    #[inline(never)]
    fn set_rate(&mut self, rate: i32) {
        // Not `clamp`, which panics if its limits are out of order.
        let limit = self.limit.cast_signed();
        self.rate = rate.min(limit).max(limit.wrapping_neg());
        let correction = (i64::from(self.nominal) * i64::from(self.rate)) >> 32;
        self.gain = self.nominal.wrapping_add_signed(correction as i32);
    }
}

/// `error`, or the largest that can be noise.
fn within_noise(error: i32) -> i32 {
    error.clamp(-LARGEST_STEP, LARGEST_STEP)
}

/// Saturates at 32 ms, in 2^-16 us.
fn saturated(time: i64) -> i32 {
    let low = time as i32;
    if i64::from(low) == time {
        low
    } else if time < 0 {
        i32::MIN
    } else {
        i32::MAX
    }
}

/// What two errors in a row have in common: the smaller one, or 0 if their signs differ.
fn common(before: i32, error: i32) -> i32 {
    if error >= 0 {
        before.min(error).max(0)
    } else {
        before.max(error).min(0)
    }
}

/// `error`, or 0 if it can be noise.
fn beyond_noise(error: i32) -> i32 {
    if within_noise(error) == error {
        0
    } else {
        error
    }
}

/// `error` over `span` in 2^-32, in 2^-16 us and in us up to 2^28, by long division in steps of 8 bits.
fn rate_of(error: i32, span: u32) -> i32 {
    // Eight bits more must fit behind a rest. Spans above 16 s are cut off by less than a millionth.
    let (size, span) = if span >> 24 == 0 {
        (error.unsigned_abs(), span.max(1))
    } else {
        (error.unsigned_abs() >> 4, (span >> 4).min((1 << 24) - 1))
    };
    // At most 1/2, which is above each limit.
    let mut rate = (size / span).min(0x7FFF);
    let mut rest = size % span;
    for _ in 0..2 {
        rest <<= 8;
        rate = (rate << 8) | (rest / span);
        rest %= span;
    }
    let rate = rate.cast_signed();
    if error < 0 { -rate } else { rate }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use super::{Clock, ClockState, LARGEST_STEP, rate_of};
    use crate::time::{GlobalTime, Stamp};
    use proptest::prelude::*;
    use std::vec::Vec;

    #[test]
    fn rates_are_quotients() {
        for (error, span) in [
            (0, 1 << 17),
            (655, 100_000),
            (-655_360, 100_000),
            (1_310_720, 100_000),
            (131_072, 500),
            (6_553_600, 10_000_000),
            (65_536_000, (1 << 24) - 1),
        ] {
            let exact = (i64::from(error) << 16) / i64::from(span);
            assert_eq!(i64::from(rate_of(error, span)), exact, "{error} / {span}");
        }
    }

    const TICKS_PER_US: u32 = 16;
    const REFERENCES: usize = 200;
    /// No reference announces a discontinuity.
    const NOT_SET: (bool, bool) = (false, false);

    /// The errors of a clock, us: what it makes of the second reference after each one. Its
    /// oscillator drifts by `slope` ppm/s after the first 50 references, which come every 100 ms.
    /// `noise` is on the stamps, us.
    fn errors(slope: f64, noise: &[f64]) -> Vec<f64> {
        let mut clock = Clock::new(TICKS_PER_US, 10_000);
        let ticks = |k: usize| {
            let time = k as f64 * 1e5;
            let drifting = (time - 50.0 * 1e5).max(0.0);
            let gained = slope * drifting * drifting / 2e12;
            (time + gained) * f64::from(TICKS_PER_US)
        };
        // The counter wraps soon.
        let stamp = |ticks: f64| Stamp(0xffff_0000_u32.wrapping_add(ticks as i64 as u32));
        let time = |k: usize| GlobalTime::from_micros(k as u64 * 100_000);
        let stamps = noise.iter().enumerate().map(|(k, noise)| {
            clock.correct(
                stamp(ticks(k) + noise * f64::from(TICKS_PER_US)),
                time(k),
                NOT_SET,
            );
            let seen = clock.at(stamp(ticks(k + 2))).expect("it has a time");
            seen.since(time(k + 2)) as f64 / 65536.0
        });
        stamps.collect()
    }

    fn noises() -> impl Strategy<Value = Vec<f64>> {
        prop::collection::vec(0.0..1.0, REFERENCES)
    }

    fn worst(errors: impl IntoIterator<Item = f64>) -> f64 {
        errors
            .into_iter()
            .fold(0.0, |worst, error| worst.max(error.abs()))
    }

    /// The stamps are 400 us later from one reference on, as after a change of the master.
    #[test]
    fn an_offset_is_worked_off_without_a_wrong_rate() {
        let mut noise = [0.0; REFERENCES];
        noise[100..].fill(400.0);
        let errors = errors(0.0, &noise);
        let beyond = worst(errors.iter().map(|error| (error + 400.0).min(0.0)));
        assert!(beyond < 5.0, "{beyond} us");
        assert!(worst(errors[112..].iter().map(|error| error + 400.0)) < 5.0);
    }

    /// The errors of a clock after each of its references, us: the larger of those at that reference and
    /// right before the next one. References come every 100 ms. The oscillator of this node changes its
    /// rate from `before` to `after` ppm at reference `at`, which may be a fraction. `noise` is on the
    /// stamps, us.
    fn errors_of_a_step(before: f64, after: f64, at: f64, limit: u16, noise: &[f64]) -> Vec<f64> {
        let mut clock = Clock::new(TICKS_PER_US, limit);
        let ticks = |k: f64| {
            let rated = k + k.min(at) * before / 1e6 + (k - at).max(0.0) * after / 1e6;
            rated * 1e5 * f64::from(TICKS_PER_US)
        };
        let stamp = |ticks: f64| Stamp(0xffff_0000_u32.wrapping_add(ticks.round() as i64 as u32));
        let errors = noise.iter().enumerate().map(|(k, noise)| {
            let now = ticks(k as f64);
            let time = |k: usize| GlobalTime::from_micros(k as u64 * 100_000);
            let noisy = stamp(now + noise * f64::from(TICKS_PER_US));
            clock.correct(noisy, time(k), NOT_SET);
            let error = |ticks: f64, k: usize| {
                let seen = clock.at(stamp(ticks)).expect("it has a time");
                (seen.since(time(k)) as f64 / 65536.0).abs()
            };
            error(now, k).max(error(ticks((k + 1) as f64), k + 1))
        });
        errors.collect()
    }

    /// The largest error of a clock from five basic cycles after a step of the rate on, us. A step at
    /// reference 40.3 is 4.7 basic cycles old at reference 45.
    fn after_five_cycles(errors: &[f64], at: f64) -> f64 {
        worst(errors[(at + 5.0) as usize..].iter().copied())
    }

    #[test]
    fn a_step_of_the_rate_is_gone_within_five_basic_cycles() {
        let mut bad = Vec::new();
        for ppm in [
            20.0, 50.0, 100.0, 200.0, 500.0, -20.0, -50.0, -100.0, -200.0, -500.0,
        ] {
            // Before and behind the time at which the filter has settled.
            for settled in [3.0, 5.0, 10.0, 100.0] {
                for fraction in [0.0, 0.1, 0.3, 0.5, 0.7, 0.9] {
                    for (before, after) in [(0.0, ppm), (ppm, 0.0), (-ppm / 2.0, ppm / 2.0)] {
                        let at = settled + fraction;
                        let errors = errors_of_a_step(before, after, at, 600, &[0.0; REFERENCES]);
                        let worst = after_five_cycles(&errors, at);
                        if worst > 2.0 {
                            bad.push((before, after, at, worst));
                        }
                    }
                }
            }
        }
        let most = worst(bad.iter().map(|bad| bad.3));
        assert!(
            bad.is_empty(),
            "{} bad, up to {most} us: {:?}",
            bad.len(),
            bad[0]
        );
    }

    /// The rate that the first two stamps make is wrong by 15 ppm.
    #[test]
    fn a_late_first_stamp_is_soon_forgotten() {
        let mut noise = [0.0; REFERENCES];
        noise[0] = 1.5;
        let errors = errors(0.0, &noise);
        assert!(errors[1] > 2.9, "the rate is disturbed: {} us", errors[1]);
        assert!(worst(errors[2..].iter().copied()) < 2.0);
        assert!(worst(errors[5..].iter().copied()) < 0.8);
        assert!(worst(errors[20..].iter().copied()) < 0.25);
    }

    /// Lets a clock hear references. They come every 100 ms by the master's time, which began `epoch`
    /// microseconds before; a second takes `tick` seconds by the node's own counter.
    fn follow(clock: &mut Clock, tick: f64, references: core::ops::Range<u64>, epoch: u64) {
        for k in references {
            let ticks = k as f64 * 1e5 * f64::from(TICKS_PER_US) * tick;
            let time = GlobalTime::from_micros(epoch + k * 100_000);
            clock.correct(Stamp(ticks as u64 as u32), time, NOT_SET);
        }
    }

    /// A master leads on its RC oscillator, and starts again with a crystal and another time.
    #[test]
    fn a_rate_beyond_a_narrower_limit_is_measured_anew() {
        let mut clock = Clock::new(TICKS_PER_US, 10_000);
        follow(&mut clock, 0.996, 1..40, 0);
        assert_eq!(clock.state(), ClockState::Locked);
        clock.set_limit(200);
        assert_eq!((clock.state(), clock.rate()), (ClockState::Offset, 0));
        assert!(clock.rate_error(10_000) > 0);
        follow(&mut clock, 1.0, 40..43, 50_000_000);
        assert_eq!(clock.state(), ClockState::Locked);
        assert!(clock.rate().abs() < 4295, "{}", clock.rate());
    }

    /// A narrow limit that the rate keeps changes nothing.
    #[test]
    fn a_rate_within_a_narrower_limit_stays() {
        let mut clock = Clock::new(TICKS_PER_US, 10_000);
        follow(&mut clock, 0.999_95, 1..40, 0);
        let rate = clock.rate();
        clock.set_limit(200);
        assert_eq!((clock.state(), clock.rate()), (ClockState::Locked, rate));
    }

    /// A node that never measures its rate within the limit says so.
    #[test]
    fn an_oscillator_beyond_the_limit_is_suspended() {
        let mut clock = Clock::new(TICKS_PER_US, 200);
        follow(&mut clock, 1.001, 1..3, 0);
        assert_eq!(clock.state(), ClockState::Offset);
        follow(&mut clock, 1.001, 3..6, 0);
        assert_eq!(clock.state(), ClockState::Suspended);
        assert!(clock.rate_error(10_000) > 0);
    }

    /// The node hears two references in a row, then a single one, and so on. The clock is carried to
    /// the single one, and the error of all five cycles arose since the last correction.
    #[test]
    fn lost_references_do_not_wind_up_the_rate() {
        for offset_ppm in [-3000.0, -100.0, 0.0, 100.0, 3000.0] {
            let tick = 1.0 + offset_ppm / 1e6;
            let mut clock = Clock::new(TICKS_PER_US, 10_000);
            let mut heard = 0;
            for k in (1..400_u64).filter(|k| ![2, 4].contains(&(k % 5))) {
                let ticks = heard as f64 * 1e5 * f64::from(TICKS_PER_US) * tick;
                let stamp = Stamp(ticks as u64 as u32);
                if k == heard + 1 {
                    clock.correct(stamp, GlobalTime::from_micros(heard * 100_000), NOT_SET);
                } else {
                    clock.carry(stamp);
                }
                heard = k;
                if k > 20 {
                    let rate = f64::from(clock.rate()) / 4_294.967_296;
                    let exact = (1.0 / tick - 1.0) * 1e6;
                    assert!((rate - exact).abs() < 20.0, "{offset_ppm}: {rate}");
                    assert_eq!(clock.state(), ClockState::Locked);
                }
            }
        }
    }

    /// So fast a drift soon exceeds what the bit timing allows. A node leaves the bus by its rate, so
    /// that must not lag far behind.
    #[test]
    fn a_drift_beyond_any_data_sheet_is_seen() {
        let errors = errors(2000.0, &[0.0; REFERENCES]);
        // The oscillator is off by the limit 50 references after the drift began.
        assert!(worst(errors[..95].iter().copied()) < 150.0);
        assert!(worst(errors[70..95].iter().copied()) < 90.0);
    }

    /// Calls a clock with everything at and beside the ends of its range: no sum, product or shift
    /// overflows, and the rate keeps its limit.
    #[test]
    fn no_stamp_time_or_rate_overflows() {
        let edges =
            |bits: u32| (0..bits).flat_map(|bit| [(1_u64 << bit) - 1, 1 << bit, (1 << bit) + 1]);
        let stamps: Vec<u32> = edges(32)
            .map(|edge| edge as u32)
            .chain([u32::MAX])
            .collect();
        let times: Vec<u64> = edges(64).chain([u64::MAX, u64::MAX - 1]).collect();
        for ticks_per_us in [1, 2, 3, 18, 180, 999, 1000] {
            for ppm in [0, 1, 200, 9999, 10_000, u16::MAX] {
                let mut clock = Clock::new(ticks_per_us, ppm);
                let mut random = 1_u32;
                let mut draw = |below: usize| {
                    random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                    (random >> 8) as usize % below
                };
                for _ in 0..20_000 {
                    let step = stamps[draw(stamps.len())];
                    let stamp = clock.anchor.after(step);
                    let near = clock.extrapolate(stamp);
                    let time = times[draw(times.len())];
                    let time = match draw(4) {
                        // Also within the drift limit, above and below.
                        0 | 1 => near.offset((time >> 40) as i64 * [1, -1][draw(2)]),
                        2 => near.offset(time as i64),
                        _ => GlobalTime::from_raw(time),
                    };
                    match draw(13) {
                        0 => clock.carry(stamp),
                        1 => clock.lead(stamp),
                        2 => clock.set(stamp, time),
                        3 => clock.resume(stamp),
                        4 => clock.forget_rate(),
                        5 => clock.set_limit(step as u16),
                        other => {
                            clock.correct(stamp, time, (other == 6, other == 7));
                        }
                    }
                    assert!(clock.rate.unsigned_abs() <= clock.limit);
                    let _ = clock.at(stamp);
                    let _ = clock.ticks(step).wrapping_add(clock.rate_error(step));
                    let _ = clock.micros(step.cast_signed());
                }
            }
        }
    }

    proptest! {
        /// From 30 ppm on, a step stands out from interrupt latency that varies by 1 us. A smaller one
        /// takes longer, and moves the time by less meanwhile.
        #[test]
        fn a_step_of_the_rate_is_gone_in_spite_of_noise(
            before in -300.0..300.0,
            step in -500.0..500.0_f64,
            at in 3.0..100.0,
            amplitude in 0.0..2.0,
            noise in noises(),
        ) {
            // Centred, because a clock follows the mean latency.
            let noise: Vec<f64> = noise.iter().map(|noise| (2.0 * noise - 1.0) * amplitude).collect();
            let errors = errors_of_a_step(before, before + step, at, 1000, &noise);
            let left = after_five_cycles(&errors, at);
            let most = if amplitude > 0.5 || step.abs() < 30.0 {
                3.0 + 3.0 * amplitude
            } else {
                2.3
            };
            prop_assert!(left <= most, "{left} us");
            let late = worst(errors[at as usize + 30..].iter().copied());
            prop_assert!(late <= 1.0 + 2.0 * amplitude, "{late} us");
        }

        #[test]
        fn an_oscillator_that_drifts_is_followed(slope in -500.0..500.0, noise in noises()) {
            let errors = errors(slope, &noise);
            prop_assert!(worst(errors.iter().copied().skip(20)) < 8.0 + 0.1 * slope.abs());
            prop_assert!(worst(errors.iter().copied().skip(100)) < 8.0 + 0.06 * slope.abs());
        }

        /// The filter moves by less than a third of [`LARGEST_STEP`], however much a stamp is disturbed.
        #[test]
        fn one_disturbed_stamp_does_not_move_a_clock_that_has_settled(
            noise in noises(),
            at in 70..150_usize,
            disturbance in -900.0..900.0,
        ) {
            let good = errors(0.0, &noise);
            let mut noise = noise;
            noise[at] += disturbance;
            let bad = errors(0.0, &noise);
            let moved = worst(good.iter().zip(&bad).map(|(good, bad)| good - bad));
            let step = f64::from(LARGEST_STEP) / 65536.0;
            prop_assert!(moved <= 0.3 * step, "{moved} us");
        }

        #[test]
        fn one_disturbed_stamp_does_not_lose_an_oscillator_that_drifts(
            slope in -500.0..500.0,
            noise in noises(),
            at in 40..190_usize,
            disturbance in -900.0..900.0,
        ) {
            let mut noise = noise;
            noise[at] += disturbance;
            let errors = errors(slope, &noise);
            prop_assert!(worst(errors.iter().copied().skip(20)) < 12.0 + 0.25 * slope.abs());
            // 20 references after the disturbance it follows as before.
            let later = errors.iter().copied().skip(100.max(at + 20));
            prop_assert!(worst(later) < 8.0 + 0.06 * slope.abs());
        }
    }
}
