//! A node's own time: converts between cycles of its core and picoseconds of the simulation.

/// Cycles of the core clock (HCLK) since the node's power came up.
pub(crate) type Cycles = u64;
/// Picoseconds since the start of the simulation.
pub(crate) type Ps = u64;
/// No event is due.
pub(crate) const NEVER: u64 = u64::MAX;

/// Picoseconds in a second, times the 10^9 of a part per billion.
const SCALE: u128 = 1_000_000_000_000 * 1_000_000_000;

/// Converts between the cycles of a clock that may change its rate and simulation time.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalClock {
    origin_cycle: Cycles,
    origin: Ps,
    hertz: u64,
    fastest: u64,
    ppb: i64,
}

impl LocalClock {
    /// A clock of `hertz` that runs fast by `ppb` parts in 10^9. Its cycle 0 begins at `origin`.
    pub(crate) fn new(hertz: u64, ppb: i64, origin: Ps) -> Self {
        Self {
            origin_cycle: 0,
            origin,
            hertz,
            fastest: hertz,
            ppb,
        }
    }

    fn rate(&self) -> u128 {
        let billion = 1_000_000_000_i64 + self.ppb.clamp(-500_000_000, 500_000_000);
        u128::from(self.hertz) * billion.unsigned_abs() as u128
    }

    /// Time at which `cycle` begins.
    pub(crate) fn time(&self, cycle: Cycles) -> Ps {
        let cycles = cycle.saturating_sub(self.origin_cycle);
        let span = u128::from(cycles) * SCALE / self.rate();
        self.origin
            .saturating_add(u64::try_from(span).unwrap_or(NEVER))
    }

    /// First cycle that begins at `time` or later.
    pub(crate) fn cycle_from(&self, time: Ps) -> Cycles {
        if time == NEVER {
            return NEVER;
        }
        let span = u128::from(time.saturating_sub(self.origin));
        let cycles = (span * self.rate()).div_ceil(SCALE);
        self.origin_cycle
            .saturating_add(u64::try_from(cycles).unwrap_or(NEVER))
    }

    /// Cycles that a span of `ps` lasts, rounded up.
    pub(crate) fn cycles_of(&self, ps: Ps) -> Cycles {
        let cycles = (u128::from(ps) * self.rate()).div_ceil(SCALE);
        u64::try_from(cycles).unwrap_or(NEVER)
    }

    /// Changes the rate from `cycle` on.
    pub(crate) fn set_rate(&mut self, cycle: Cycles, hertz: u64, ppb: i64) {
        self.origin = self.time(cycle);
        self.origin_cycle = cycle;
        self.hertz = hertz;
        self.fastest = self.fastest.max(hertz);
        self.ppb = ppb;
    }

    pub(crate) fn hertz(&self) -> u64 {
        self.hertz
    }

    /// The highest rate so far.
    pub(crate) fn fastest(&self) -> u64 {
        self.fastest
    }

    pub(crate) fn ppb(&self) -> i64 {
        self.ppb
    }
}

#[cfg(test)]
mod tests {
    use super::LocalClock;
    use proptest::prelude::*;

    #[test]
    fn a_crystal_20_ppm_fast_gains_20_microseconds_in_a_second() {
        let clock = LocalClock::new(180_000_000, 20_000, 0);
        let at = clock.time(180_000_000);
        assert_eq!(1_000_000_000_000 - at, 19_999_601);
    }

    #[test]
    fn a_change_of_rate_leaves_the_past_alone() {
        let mut clock = LocalClock::new(16_000_000, 0, 0);
        clock.set_rate(16_000, 180_000_000, 0);
        assert_eq!(clock.time(16_000), 1_000_000_000);
        assert_eq!(clock.time(16_000 + 180_000), 2_000_000_000);
        assert_eq!(clock.cycle_from(2_000_000_000), 16_000 + 180_000);
        // In reset it falls back; the tasks ran at the rate before.
        clock.set_rate(200_000, 16_000_000, 0);
        assert_eq!((clock.hertz(), clock.fastest()), (16_000_000, 180_000_000));
    }

    proptest! {
        #[test]
        fn the_cycle_from_a_time_is_the_first_at_or_after_it(
            ppb in -100_000_i64..100_000, time in 0_u64..100_000_000_000_000,
        ) {
            let clock = LocalClock::new(72_000_000, ppb, 0);
            let cycle = clock.cycle_from(time);
            prop_assert!(clock.time(cycle) >= time || clock.time(cycle) + 1 >= time);
            prop_assert!(cycle == 0 || clock.time(cycle - 1) < time);
        }
    }
}
