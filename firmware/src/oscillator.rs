//! Trims an RC oscillator by the reference messages, before the node sends anything.
//!
//! An RC oscillator may be off by 5 % over all temperatures (data sheets of both parts). CAN at
//! this bit timing allows a fifth of that, and a node outside it destroys the frames of all others
//! by its error flags. So a node that has no external clock first only listens. References come at
//! the pace of the time master's crystal: their distance on the node's own time base is the error
//! of its oscillator. If it cannot read the traffic at all, it tries one trim after the other.
//!
//! A stamp is taken at the end of a reference. So its stuff bits disturb it, by up to 8 us at 500
//! kbit/s, and the first reference of a master is two bytes shorter, which are 32 us. In a basic cycle of
//! 5 ms that would be 0.6 %. So the distance is measured over as many cycles as make a tenth of a second.

use ttcan::Micros;

/// Time over which the distance of references is measured, unless the basic cycle is longer.
const SPAN: Micros = Micros::millis(100);

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

/// Basic cycles over which a [`Tuner`] measures, for basic cycles of this length: 1 to 100.
pub const fn measured_cycles(basic_cycle: Micros) -> u8 {
    match SPAN.ticks().checked_div(basic_cycle.ticks()) {
        Some(cycles @ 1..=100) => cycles as u8,
        Some(0) => 1,
        _ => 100,
    }
}

/// The search for the trim of a node's oscillator.
#[derive(Clone, Copy, Debug)]
pub struct Tuner {
    /// Ticks of the time base in a basic cycle.
    cycle: u32,
    /// Basic cycles of a measurement.
    cycles: u8,
    place: u8,
    trim: i8,
    corrections: u8,
    /// When the present trim was set.
    since: Option<u32>,
    /// Stamp of the last reference since then.
    reference: Option<u32>,
    /// Intervals of about a basic cycle in a row, until the last reference.
    run: u8,
    /// Stamp of the reference with which the present measurement began.
    first: u32,
    /// Ticks of the last measurement since then.
    interval: Option<u32>,
    /// Traffic that could not be read since then.
    disturbed: bool,
    /// When the bus was last busy, as far as this node can tell.
    busy: Option<u32>,
}

impl Tuner {
    /// A search that begins at the factory's setting. `cycle` is the length of a basic cycle in
    /// ticks of the time base, `cycles` over how many of them it measures: see [`measured_cycles`].
    pub const fn new(cycle: u32, cycles: u8) -> Self {
        Self {
            cycle,
            cycles,
            place: 0,
            trim: 0,
            corrections: 0,
            since: None,
            reference: None,
            run: 0,
            first: 0,
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
        self.run = 0;
        self.interval = None;
        self.disturbed = false;
    }

    /// Intervals before a measurement begins. The node's first stamp may be late, because the interrupts
    /// are masked while it starts. A measurement of one cycle would take twice as long that way: it
    /// begins at once, and a wrong one is repeated when the node has drifted off the schedule.
    const fn lead(&self) -> u8 {
        (self.cycles > 1) as u8
    }

    /// A reference message was received; `stamp` was taken at its end.
    pub fn reference(&mut self, stamp: u32) {
        self.busy = Some(stamp);
        // Farther off than any trim reaches: a reference between them was missed.
        let near = self
            .reference
            .replace(stamp)
            .is_some_and(|last| stamp.wrapping_sub(last).abs_diff(self.cycle) < self.cycle / 12);
        self.run = if near { self.run.saturating_add(1) } else { 0 };
        if !near {
            self.interval = None;
        }
        if self.run >= self.lead().saturating_add(self.cycles) {
            self.interval = Some(stamp.wrapping_sub(self.first));
            self.run = self.lead();
        }
        if self.run == self.lead() {
            self.first = stamp;
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
        // A reference comes in every cycle.
        let patience = if self.hears() {
            cycles(u32::from(self.lead()) + u32::from(self.cycles) + 3)
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

    /// The oscillator's error shows in the length of a measurement.
    fn judge(&mut self, interval: u32) -> Tuning {
        let nominal = self.cycle.saturating_mul(u32::from(self.cycles));
        // At most a twelfth of that, so that its thousandfold fits.
        let excess = interval.wrapping_sub(nominal).cast_signed();
        let ppm = excess
            .saturating_mul(1_000)
            .checked_div((nominal / 1_000).cast_signed())
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

    /// Ticks of a microsecond.
    const US: u32 = 16;

    /// A node whose oscillator is off by `error` ppm, with trim steps of `step` ppm, on a bus whose
    /// first reference comes after `wait` cycles. It reads frames within 12 000 ppm. Returns the
    /// error that is left, and the cycles it took.
    fn tune(error: i32, step: i32, wait: u32) -> Option<(i32, u32)> {
        let mut tuner = Tuner::new(CYCLE, 1);
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

    #[test]
    fn a_measurement_takes_a_tenth_of_a_second_or_one_cycle() {
        for (ms, cycles) in [(1, 100), (5, 20), (20, 5), (60, 1), (100, 1), (1000, 1)] {
            assert_eq!(measured_cycles(Micros::millis(ms)), cycles, "{ms} ms");
        }
        assert_eq!(measured_cycles(Micros::micros(500)), 100);
        assert_eq!(measured_cycles(Micros::micros(0)), 100);
    }

    /// A node on a bus with a basic cycle of 5 ms, of which every second one lets it step. `late` is by
    /// how much its first stamp comes after the frame, and `noise` by how much each frame is longer than
    /// the first one, us; of which it hears no more than `heard`. Returns the error that is left, ppm.
    fn tune_fast(error: i32, late: u32, heard: u32, noise: &[u32]) -> Option<i32> {
        const FAST: u32 = CYCLE / 20;
        let mut tuner = Tuner::new(FAST, measured_cycles(Micros::millis(5)));
        let mut now = 0_u32;
        for (turn, noise) in (0..heard).zip(noise.iter().cycle()) {
            let off = error + i32::from(tuner.trim()) * STEP_PPM;
            now =
                now.wrapping_add((i64::from(FAST) * i64::from(1_000_000 + off) / 1_000_000) as u32);
            let read = off.abs() <= 12_000;
            if read {
                let late = if turn == 0 { late } else { *noise };
                tuner.reference(now.wrapping_add(late * US));
            }
            if turn % 2 == 1 && tuner.step(now.wrapping_add(1000 * US), !read) == Tuning::Tuned {
                return Some(off);
            }
        }
        None
    }

    /// The first stamp hides the error of the oscillator.
    #[test]
    fn a_late_first_stamp_tunes_no_oscillator() {
        assert_eq!(tune_fast(11_212, 56, 2, &[0]), None);
        assert_eq!(tune_fast(11_212, 56, 200, &[0]), Some(1_212));
    }

    proptest! {
        /// In a short basic cycle, too, with stamps as they come from the ends of frames.
        #[test]
        fn every_oscillator_is_found_in_a_short_cycle(
            error in -50_000..50_000, late in 0_u32..400,
            noise in prop::collection::vec(32_u32..40, 7),
        ) {
            let left = tune_fast(error, late, 600, &noise).expect("it is tuned");
            prop_assert!(left.abs() <= GOOD_PPM + 100, "{left} ppm");
        }

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
            let mut tuner = Tuner::new(CYCLE, 1);
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
