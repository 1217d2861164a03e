//! Trims an RC oscillator by the reference messages, before the node sends anything.
//!
//! An RC oscillator may be off by 5 % over all temperatures (data sheets of both parts). CAN at
//! this bit timing allows a fifth of that, and a node outside it destroys the frames of all others
//! by its error flags. So a node that has no external clock first only listens. References come at
//! the pace of the time master's crystal: their distance on the node's own time base is the error
//! of its oscillator. If it cannot read the traffic at all, it tries one trim after the other.

/// A step of the trim, ppm (RM0316 9.4.1: about 40 kHz of 8 MHz). A real step differs from it; the
/// distance of the next two references shows by how much.
const STEP_PPM: i32 = 5_000;

/// An error that the best step leaves, ppm: half a step, and as much again for steps that are not
/// equal.
const GOOD_PPM: i32 = 3_500;

/// After this many corrections, the error that is good enough, ppm.
const FAIR_PPM: i32 = 6_000;
const CORRECTIONS: u8 = 4;

/// Trims to try, in steps: from the factory's setting outwards, 1 % apart, up to 6 %. At the best
/// one the error is half a per cent at the most, at which frames are read.
const SWEEP: [i8; 13] = [0, 2, -2, 4, -4, 6, -6, 8, -8, 10, -10, 12, -12];

/// What the owner is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tuning {
    /// Go on listening.
    Listen,
    /// Trim the oscillator by this many steps from the factory's setting.
    Trim(i8),
    /// The oscillator is good enough: join the bus.
    Tuned,
}

/// The search for the trim of a node's oscillator.
#[derive(Clone, Copy, Debug)]
pub struct Tuner {
    /// Ticks of the time base in a basic cycle.
    cycle: u32,
    place: u8,
    trim: i8,
    corrections: u8,
    /// When the present trim was set.
    since: Option<u32>,
    /// Stamp of the last reference since then.
    reference: Option<u32>,
    /// Ticks between the last two references since then.
    interval: Option<u32>,
    /// Traffic that could not be read since then.
    disturbed: bool,
    /// When the bus was last busy, as far as this node can tell.
    busy: Option<u32>,
}

impl Tuner {
    /// A search that begins at the factory's setting. `cycle` is the length of a basic cycle in
    /// ticks of the time base.
    pub const fn new(cycle: u32) -> Self {
        Self {
            cycle,
            place: 0,
            trim: 0,
            corrections: 0,
            since: None,
            reference: None,
            interval: None,
            disturbed: false,
            busy: None,
        }
    }

    /// The present trim, in steps.
    pub const fn trim(&self) -> i8 {
        self.trim
    }

    /// Whether a reference has been read at the present trim.
    pub const fn hears(&self) -> bool {
        self.reference.is_some()
    }

    /// Ticks since the bus was last busy; `None` before the first step.
    pub fn quiet(&self, now: u32) -> Option<u32> {
        self.busy.map(|busy| now.wrapping_sub(busy))
    }

    /// The node listens again, at the trim that it has.
    pub fn resume(&mut self) {
        self.corrections = 0;
        self.busy = None;
        self.begin();
    }

    fn begin(&mut self) {
        self.since = None;
        self.reference = None;
        self.interval = None;
        self.disturbed = false;
    }

    /// A reference message was received; `stamp` was taken at its end.
    pub fn reference(&mut self, stamp: u32) {
        self.busy = Some(stamp);
        if let Some(last) = self.reference.replace(stamp) {
            let ticks = stamp.wrapping_sub(last);
            // Farther off than any trim reaches: a reference between them was missed.
            let near = ticks.abs_diff(self.cycle) < self.cycle / 12;
            self.interval = near.then_some(ticks);
        }
    }

    /// To be called every few milliseconds. `disturbed` tells whether the controller has seen an
    /// error on the bus since the last call.
    pub fn step(&mut self, now: u32, disturbed: bool) -> Tuning {
        let since = *self.since.get_or_insert(now);
        if disturbed || self.busy.is_none() {
            self.busy = Some(now);
        }
        self.disturbed |= disturbed;
        if let Some(interval) = self.interval {
            return self.judge(interval);
        }
        let cycles = |count: u32| self.cycle.saturating_mul(count);
        // A reference comes in every cycle; two of them are needed.
        let patience = if self.hears() {
            cycles(4)
        } else {
            cycles(3) / 2
        };
        if now.wrapping_sub(since) < patience {
            return Tuning::Listen;
        }
        if !self.disturbed {
            // Nobody sends, or all that was sent could be read.
            self.since = Some(now);
            return Tuning::Listen;
        }
        self.place = match self.place.checked_add(1) {
            Some(next) if usize::from(next) < SWEEP.len() => next,
            _ => 0,
        };
        self.corrections = 0;
        self.set(SWEEP.get(usize::from(self.place)).copied().unwrap_or(0))
    }

    fn set(&mut self, trim: i8) -> Tuning {
        self.trim = trim.clamp(-16, 15);
        self.begin();
        Tuning::Trim(self.trim)
    }

    /// The oscillator's error shows in the distance of two references.
    fn judge(&mut self, interval: u32) -> Tuning {
        // At most a twelfth of a cycle, so that its thousandfold fits.
        let excess = interval.wrapping_sub(self.cycle).cast_signed();
        let ppm = excess
            .saturating_mul(1_000)
            .checked_div((self.cycle / 1_000).cast_signed())
            .unwrap_or(0);
        let steps = (ppm.abs() + STEP_PPM / 2) / STEP_PPM;
        let steps = if ppm > 0 { -steps } else { steps } as i8;
        let corrected = self.corrections >= CORRECTIONS && ppm.abs() <= FAIR_PPM;
        let target = self.trim.saturating_add(steps).clamp(-16, 15);
        if ppm.abs() <= GOOD_PPM || corrected || target == self.trim && ppm.abs() <= FAIR_PPM {
            return Tuning::Tuned;
        }
        self.corrections = self.corrections.saturating_add(1);
        self.set(target)
    }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::*;
    use proptest::prelude::*;

    /// 100 ms at 16 ticks per microsecond.
    const CYCLE: u32 = 1_600_000;

    /// A node whose oscillator is off by `error` ppm, with trim steps of `step` ppm, on a bus whose
    /// first reference comes after `wait` cycles. It reads frames within 12 000 ppm. Returns the
    /// error that is left, and the cycles it took.
    fn tune(error: i32, step: i32, wait: u32) -> Option<(i32, u32)> {
        let mut tuner = Tuner::new(CYCLE);
        let mut now = u32::MAX - 3 * CYCLE;
        for turn in 0..1000_u32 {
            // Ten steps in a cycle of the master.
            let off = error + i32::from(tuner.trim()) * step;
            now = now.wrapping_add(
                (i64::from(CYCLE / 10) * i64::from(1_000_000 + off) / 1_000_000) as u32,
            );
            let sent = turn % 10 == 0 && turn / 10 >= wait;
            let read = off.abs() <= 12_000;
            if sent && read {
                tuner.reference(now);
            }
            if tuner.step(now, sent && !read) == Tuning::Tuned {
                return Some((off, turn / 10));
            }
        }
        None
    }

    #[test]
    fn an_accurate_oscillator_is_ready_after_two_references() {
        assert_eq!(tune(1_000, 5_000, 0), Some((1_000, 1)));
        // It does not go astray while nobody sends.
        assert_eq!(tune(-2_000, 5_000, 30), Some((-2_000, 31)));
    }

    #[test]
    fn without_traffic_it_stays_where_it_is() {
        assert_eq!(tune(40_000, 5_000, 1_000), None);
    }

    proptest! {
        /// Within 5 %, whatever a step really is, a node ends well inside of what the bit timing
        /// allows, within four seconds.
        #[test]
        fn every_oscillator_is_found(
            error in -50_000..50_000, step in 4_000..6_000, wait in 0_u32..20,
        ) {
            let (left, cycles) = tune(error, step, wait).expect("it is tuned");
            prop_assert!(left.abs() <= FAIR_PPM, "{left} ppm");
            prop_assert!(cycles - wait <= 40, "{cycles} cycles");
        }

        #[test]
        fn no_input_upsets_it(events in prop::collection::vec((any::<u32>(), any::<bool>(), any::<bool>()), 0..200)) {
            let mut tuner = Tuner::new(CYCLE);
            for (at, reference, disturbed) in events {
                if reference {
                    tuner.reference(at);
                }
                tuner.step(at, disturbed);
                prop_assert!((-16..=15).contains(&tuner.trim()));
            }
        }
    }
}
