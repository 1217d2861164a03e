//! How many releases of a time table a window may hold, without a look at each job.
//!
//! A job may be released in a turn of the cycle if its latest release is not before the window, and its
//! earliest one is before the window's end. No job's earliest release is behind its latest one. So the
//! jobs of all turns that are possible before the end, less those that are over before the begin, are
//! those in the window, and each of the two numbers needs only the instants in order.

use crate::arrivals::{Job, Timetable};

/// Instants of a cycle, in order.
struct Instants {
    cycle: i64,
    /// Sum of the whole cycles in the instants.
    turns: i64,
    /// What is left of each of them.
    rests: Vec<i64>,
}

impl Instants {
    fn new(cycle: i64, instants: impl Iterator<Item = u64>) -> Self {
        let mut turns = 0;
        let mut rests: Vec<i64> = instants
            .map(|at| {
                turns += at.cast_signed().div_euclid(cycle);
                at.cast_signed().rem_euclid(cycle)
            })
            .collect();
        rests.sort_unstable();
        Self {
            cycle,
            turns,
            rests,
        }
    }

    /// The sum, over all instants, of the whole cycles from the instant to `at`.
    fn until(&self, at: i64) -> i64 {
        let whole = at.div_euclid(self.cycle);
        let rest = at.rem_euclid(self.cycle);
        let later = self.rests.len() - self.rests.partition_point(|own| *own <= rest);
        self.rests.len() as i64 * whole - self.turns - later as i64
    }
}

/// A time table whose releases are counted.
pub(super) struct Counted<'a> {
    pub(super) table: &'a Timetable,
    earliest: Instants,
    latest: Instants,
}

impl<'a> Counted<'a> {
    pub(super) fn new(table: &'a Timetable) -> Self {
        let cycle = table.cycle.max(1).cast_signed();
        let jobs = || table.jobs.iter();
        Self {
            table,
            earliest: Instants::new(cycle, jobs().map(|job| job.earliest)),
            latest: Instants::new(cycle, jobs().map(|job| job.latest)),
        }
    }

    /// The most releases in the `window` from the instant `begin` of the cycle on, each up to
    /// `jitter` late. The jobs of `absent` do not count in the turn `turn` of the cycle.
    /// `besides` releases in the window are known that do not count either: they take part in the
    /// spacing.
    pub(super) fn most(
        &self,
        begin: u64,
        window: u64,
        jitter: u64,
        besides: u64,
        (absent, turn): (&[&Job], i64),
    ) -> u64 {
        let at = begin.cast_signed();
        let mut most = self.all(at, window, jitter);
        for job in absent {
            let turns = self.table.turns(job, jitter, at, window);
            most -= u64::from(window > 0 && turns.contains(&turn));
        }
        let spaced = self.table.spaced(window.saturating_add(jitter));
        most.min(spaced.saturating_sub(besides))
    }

    fn all(&self, begin: i64, window: u64, jitter: u64) -> u64 {
        if window == 0 {
            return 0;
        }
        let end = begin.saturating_add_unsigned(window);
        let possible = self.earliest.until(end - 1);
        // Rounded up in place of down.
        let over = self
            .latest
            .until(begin - jitter.cast_signed() + self.latest.cycle - 1);
        let count = self.table.jobs.len() as i64;
        u64::try_from(count + possible - over).unwrap_or(0)
    }
}

#[cfg(test)]
mod tests {
    use super::Counted;
    use crate::arrivals::{Job, Kind, Timetable};
    use proptest::prelude::*;

    fn job((earliest, length): (u64, u64)) -> Job {
        Job {
            id: None,
            cause: None,
            label: String::new(),
            earliest,
            latest: earliest + length,
            deadline: None,
            transmits: false,
        }
    }

    proptest! {
        /// As when each job is looked at.
        #[test]
        fn the_count_is_that_of_all_jobs(
            cycle in 1_u64..50,
            jobs in proptest::collection::vec((0_u64..120, 0_u64..80), 0..12),
            begin in 0_u64..100,
            window in 0_u64..200,
            jitter in 0_u64..60,
            spacing in 0_u64..5,
            besides in 0_u64..3,
            absent in 0_usize..12,
            turn in -3_i64..6,
        ) {
            let table = Timetable {
                cycle,
                spacing,
                burst: 1,
                kind: Kind::Any,
                cost: None,
                jobs: jobs.into_iter().map(job).collect(),
            };
            let without: Vec<&Job> = table.jobs.iter().skip(absent).take(2).collect();
            let of_job = |job: &Job| -> u64 {
                let turns = table.turns(job, jitter, begin.cast_signed(), window);
                let is_absent = without.iter().any(|other| std::ptr::eq(*other, job));
                turns.filter(|at| !is_absent || *at != turn).count() as u64
            };
            let all: u64 = match window {
                0 => 0,
                _ => table.jobs.iter().map(of_job).sum(),
            };
            let spaced = match spacing {
                0 => u64::MAX,
                _ => (window + jitter).div_ceil(spacing) + table.burst,
            };
            let expected = all.min(spaced.saturating_sub(besides));
            let found = Counted::new(&table).most(begin, window, jitter, besides, (&without, turn));
            prop_assert_eq!(found, expected);
        }
    }
}
