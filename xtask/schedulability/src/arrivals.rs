//! When the jobs of a task may be released.
//!
//! There are two kinds of releases. Of sporadic ones only the least distance is known. Those of
//! the bus's time table lie each between two known instants of the cycle. A task may have both.

use std::ops::RangeInclusive;

/// Sporadic releases, of which only the least distance is known, or that of their nominal instants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Sporadic {
    /// Least time between the nominal instants of two releases. Must not be zero.
    pub period: u64,
    /// How much later than its nominal instant a release may be.
    pub jitter: u64,
    /// A limit to the releases in a longer window, if there is one: their number and the length
    /// of the window.
    pub limit: Option<(u64, u64)>,
}

impl Sporadic {
    /// Sporadic releases without such a limit.
    #[must_use]
    pub const fn every(period: u64) -> Self {
        Self {
            period,
            jitter: 0,
            limit: None,
        }
    }

    /// The same, each up to `jitter` late, but `apart` from each other.
    #[must_use]
    pub const fn late(period: u64, jitter: u64, apart: u64) -> Self {
        Self {
            period,
            jitter,
            limit: Some((1, apart)),
        }
    }

    /// The most releases in any half-open window of this length.
    #[must_use]
    pub fn count(self, window: u64) -> u64 {
        if window == 0 {
            return 0;
        }
        let most = window.saturating_add(self.jitter).div_ceil(self.period);
        match self.limit {
            Some((jobs, span)) => most.min(window.div_ceil(span.max(1)).saturating_mul(jobs)),
            None => most,
        }
    }
}

/// Sporadic streams that keep a distance from each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Spaced {
    /// The streams.
    pub streams: Vec<Sporadic>,
    /// Least time between two releases of any of them. Must not be zero.
    pub apart: u64,
    /// Releases that any window may hold in addition to those that the distance allows.
    pub burst: u64,
}

impl Spaced {
    /// The most releases in any half-open window of this length.
    #[must_use]
    pub fn count(&self, window: u64) -> u64 {
        let streams = self.streams.iter().map(|stream| stream.count(window));
        let all = streams.fold(0, u64::saturating_add);
        all.min(window.div_ceil(self.apart) + self.burst)
    }
}

/// Number of a job of the time table, by which other jobs name it as their cause. No two jobs of
/// the tasks of one processor have the same number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct JobId(pub u32);

/// One job of the time table. It may be released once in each turn of the cycle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Job {
    /// Its number, if it is the cause of others.
    pub id: Option<JobId>,
    /// The job that brings this one about: in each turn of the cycle, this one is not released
    /// before that one has started. `None` if it needs no other job, or any of several.
    pub cause: Option<JobId>,
    /// Name of the event that releases it.
    pub label: String,
    /// Earliest release, from the begin of the cycle.
    pub earliest: u64,
    /// Latest release; it may be after the end of the cycle.
    pub latest: u64,
    /// Its deadline after the release, if it is not the task's.
    pub deadline: Option<u64>,
    /// Whether it starts a transmission of this node, or makes room for the next one. A node that is off the
    /// bus sends nothing, so its deadline holds only on the bus.
    pub transmits: bool,
}

/// What a job of the bus handles.
#[derive(
    Debug,
    Clone,
    Copy,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    Default,
    serde::Deserialize,
    serde::Serialize,
)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Unknown.
    #[default]
    Any,
    /// A reference message.
    Reference,
    /// A message in an exclusive window, or such a window.
    Exclusive,
    /// An event message, or an arbitrating window.
    Arbitrating,
}

impl Kind {
    /// Its name in sentences.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Any => "anything",
            Self::Reference => "a reference message",
            Self::Exclusive => "an exclusive window",
            Self::Arbitrating => "an arbitrating window",
        }
    }
}

/// Jobs that may be released once in every cycle.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Timetable {
    /// Length of the cycle.
    pub cycle: u64,
    /// Least time between any two of the releases; zero if none is known.
    pub spacing: u64,
    /// Releases that any window may hold in addition to those that the spacing allows.
    pub burst: u64,
    /// What the jobs handle.
    pub kind: Kind,
    /// Worst-case execution time of one job, if it is less than the task's.
    pub cost: Option<u64>,
    /// The jobs of one cycle.
    pub jobs: Vec<Job>,
}

impl Timetable {
    /// The most releases in any `window`, each up to `jitter` late.
    #[must_use]
    pub fn count(&self, window: u64, jitter: u64) -> u64 {
        // The window with the most releases begins with one that is as late as possible.
        let most = self
            .jobs
            .iter()
            .map(|first| self.within(first.latest + jitter, window, jitter))
            .max()
            .unwrap_or(0);
        most.min(self.spaced(window + jitter))
    }

    /// The most releases in a window by their spacing alone.
    pub(crate) fn spaced(&self, window: u64) -> u64 {
        match self.spacing {
            0 => u64::MAX,
            spacing => window.div_ceil(spacing).saturating_add(self.burst),
        }
    }

    /// The releases that may be in the window of this length from `begin` on.
    fn within(&self, begin: u64, length: u64, jitter: u64) -> u64 {
        let begin = begin.cast_signed();
        let jobs = self.jobs.iter();
        jobs.map(|job| self.repeats(job, jitter, begin, length))
            .sum()
    }

    /// Whether the release intervals of two jobs of this cycle have an instant in common.
    #[must_use]
    pub fn may_coincide(&self, one: &Job, other: &Job) -> bool {
        let length = one.latest - one.earliest + 1;
        self.repeats(other, 0, one.earliest.cast_signed(), length) > 0
    }

    /// The turns of the cycle in which `job` may be released in `begin..begin + length`, up to
    /// `jitter` late. Times are below 2^62, which is 53 days in picoseconds.
    pub(crate) fn turns(
        &self,
        job: &Job,
        jitter: u64,
        begin: i64,
        length: u64,
    ) -> RangeInclusive<i64> {
        let cycle = self.cycle.max(1).cast_signed();
        let latest = (job.latest + jitter).cast_signed();
        let end = begin.saturating_add_unsigned(length);
        // The first turn whose latest release is not before `begin`, and the last one whose
        // earliest release is before `end`.
        let first = (begin - latest + cycle - 1).div_euclid(cycle);
        let last = (end - 1 - job.earliest.cast_signed()).div_euclid(cycle);
        first..=last
    }

    /// The number of these turns.
    fn repeats(&self, job: &Job, jitter: u64, begin: i64, length: u64) -> u64 {
        if length == 0 {
            return 0;
        }
        let turns = self.turns(job, jitter, begin, length);
        u64::try_from(turns.end() - turns.start() + 1).unwrap_or(0)
    }

    /// The most releases from `carry` before the release of `job`, which is up to `late` late,
    /// until `window` after it. The release of `job` itself does not count.
    #[must_use]
    pub fn around(&self, job: &Job, late: u64, carry: u64, window: u64) -> u64 {
        let begin = job.earliest.cast_signed() - carry.cast_signed() + 1;
        let length = (job.latest - job.earliest + late + carry + window).saturating_sub(1);
        let met: u64 = self
            .jobs
            .iter()
            .map(|other| {
                let all = self.repeats(other, 0, begin, length);
                all - u64::from(std::ptr::eq(other, job) && all > 0)
            })
            .sum();
        met.min(self.spaced(carry + window))
    }
}

/// All releases of a task.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Arrivals {
    /// Sporadic streams.
    pub sporadic: Vec<Sporadic>,
    /// Sporadic streams that keep a distance from each other.
    pub spaced: Vec<Spaced>,
    /// Parts of the time table; the spacing of each part is its own.
    pub timed: Vec<Timetable>,
    /// Least time between the nominal instants of any two releases, whatever causes them; zero if none
    /// is known.
    pub apart: u64,
}

impl From<Sporadic> for Arrivals {
    fn from(stream: Sporadic) -> Self {
        Self {
            sporadic: vec![stream],
            ..Self::default()
        }
    }
}

impl Arrivals {
    /// One sporadic stream.
    #[must_use]
    pub fn every(period: u64) -> Self {
        Sporadic::every(period).into()
    }

    /// The releases of both, for two tasks that share a handler. Those of one keep no distance from those
    /// of the other.
    #[must_use]
    pub fn merged(mut self, other: &Self) -> Self {
        self.apart = 0;
        self.sporadic.extend(&other.sporadic);
        self.spaced.extend(other.spaced.iter().cloned());
        self.timed.extend(other.timed.iter().cloned());
        self
    }

    /// The same releases, each up to `late` later, or the deadline of its own job where that is
    /// longer. Distances between them are lost.
    #[must_use]
    pub fn delayed(&self, late: u64) -> Self {
        let sporadic = self.all_sporadic().map(|stream| Sporadic {
            period: stream.period,
            jitter: stream.jitter.saturating_add(late),
            limit: None,
        });
        let timed = self.timed.iter().map(|table| {
            let jobs = table.jobs.iter().map(|job| Job {
                id: None,
                cause: None,
                latest: job.latest + job.deadline.unwrap_or(0).max(late),
                deadline: None,
                transmits: false,
                ..job.clone()
            });
            Timetable {
                cycle: table.cycle,
                spacing: 0,
                burst: 0,
                kind: Kind::Any,
                cost: None,
                jobs: jobs.collect(),
            }
        });
        Self {
            sporadic: sporadic.collect(),
            spaced: Vec::new(),
            timed: timed.collect(),
            apart: 0,
        }
    }

    /// The most releases in any half-open window of this length by [`Arrivals::apart`] alone.
    #[must_use]
    pub fn most(&self, window: u64) -> u64 {
        match self.apart {
            0 => u64::MAX,
            apart => window.div_ceil(apart),
        }
    }

    /// All sporadic streams, whether they keep a distance from others or not.
    fn all_sporadic(&self) -> impl Iterator<Item = &Sporadic> {
        let spaced = self.spaced.iter().flat_map(|spaced| &spaced.streams);
        self.sporadic.iter().chain(spaced)
    }

    /// Whether there are sporadic releases.
    #[must_use]
    pub fn has_sporadic(&self) -> bool {
        self.all_sporadic().next().is_some()
    }

    /// The most sporadic releases in any half-open window of this length.
    #[must_use]
    pub fn count_sporadic(&self, window: u64) -> u64 {
        let alone = self.sporadic.iter().map(|stream| stream.count(window));
        let spaced = self.spaced.iter().map(|spaced| spaced.count(window));
        alone.chain(spaced).fold(0, u64::saturating_add)
    }

    /// Whether a stream has a period of zero.
    #[must_use]
    pub fn has_zero_period(&self) -> bool {
        self.all_sporadic().any(|stream| stream.period == 0)
    }

    /// The most releases in any half-open window of this length, each up to `jitter` later than
    /// its nominal instant.
    #[must_use]
    pub fn count(&self, window: u64, jitter: u64) -> u64 {
        let sporadic = self.count_sporadic(window.saturating_add(jitter));
        let timed = self.timed.iter().map(|table| table.count(window, jitter));
        let all = timed.fold(sporadic, u64::saturating_add);
        all.min(self.most(window.saturating_add(jitter)))
    }

    /// Long-term rates: a number of releases, and the time in which they occur.
    pub fn rates(&self) -> impl Iterator<Item = (u64, u64)> {
        let sporadic = self.all_sporadic().map(|stream| match stream.limit {
            Some((jobs, span)) if jobs.saturating_mul(stream.period) < span => (jobs, span),
            _ => (1, stream.period),
        });
        let timed = self
            .timed
            .iter()
            .map(|table| (table.jobs.len() as u64, table.cycle));
        sporadic.chain(timed)
    }

    /// The period, if the releases are one sporadic stream without a limit.
    #[must_use]
    pub fn single(&self) -> Option<u64> {
        match (
            self.sporadic.as_slice(),
            self.spaced.as_slice(),
            self.timed.as_slice(),
        ) {
            ([stream], [], []) if stream.limit.is_none() && stream.jitter == 0 => {
                Some(stream.period)
            }
            _ => None,
        }
    }

    /// Least time from a release to the one `further` releases after it.
    #[must_use]
    pub fn distance(&self, further: u64, jitter: u64) -> u64 {
        if further == 0 {
            return 0;
        }
        let holds = |window: u64| self.count(window, jitter) > further;
        let mut high = 1u64;
        while !holds(high) {
            if high > 1 << 58 {
                return u64::MAX;
            }
            high *= 2;
        }
        let mut low = high / 2;
        while high - low > 1 {
            let middle = low + (high - low) / 2;
            if holds(middle) {
                high = middle;
            } else {
                low = middle;
            }
        }
        // The window is half open.
        high - 1
    }
}

#[cfg(test)]
mod tests {
    use super::{Arrivals, Job, Spaced, Sporadic, Timetable};

    fn job(earliest: u64, latest: u64) -> Job {
        Job {
            id: None,
            cause: None,
            label: String::new(),
            earliest,
            latest,
            deadline: None,
            transmits: false,
        }
    }

    fn table(spacing: u64, jobs: &[(u64, u64)]) -> Timetable {
        Timetable {
            cycle: 100,
            spacing,
            burst: 0,
            kind: super::Kind::Any,
            cost: None,
            jobs: jobs.iter().map(|&(a, b)| job(a, b)).collect(),
        }
    }

    #[test]
    fn a_sporadic_stream() {
        let stream = Arrivals::every(10);
        assert_eq!(
            [0, 1, 10, 11, 100].map(|w| stream.count(w, 0)),
            [0, 1, 1, 2, 10]
        );
        assert_eq!(stream.count(10, 1), 2);
        assert_eq!([0, 1, 2].map(|n| stream.distance(n, 0)), [0, 10, 20]);
        assert_eq!(stream.distance(1, 4), 6);
    }

    #[test]
    fn a_burst_is_limited() {
        let stream = Sporadic {
            period: 10,
            jitter: 0,
            limit: Some((3, 100)),
        };
        assert_eq!(
            [1, 11, 21, 31, 100, 101, 131].map(|w| stream.count(w)),
            [1, 2, 3, 3, 3, 6, 6]
        );
    }

    #[test]
    fn a_late_release_may_follow_the_one_before_at_once_but_not_closer_than_they_are_apart() {
        let stream = Sporadic::late(100, 30, 5);
        assert_eq!(
            [0, 1, 5, 70, 71, 170, 171].map(|w| stream.count(w)),
            [0, 1, 1, 1, 2, 2, 3]
        );
        let later_than_a_period = Sporadic::late(100, 250, 5);
        assert_eq!(
            [1, 5, 6, 10, 11, 50, 51].map(|w| later_than_a_period.count(w)),
            [1, 1, 2, 2, 3, 3, 4]
        );
        let mut two = Arrivals {
            spaced: vec![Spaced {
                streams: vec![stream, stream],
                apart: 5,
                burst: 0,
            }],
            ..Arrivals::default()
        };
        assert_eq!([1, 5, 6, 70, 71].map(|w| two.count(w, 0)), [1, 1, 2, 2, 4]);
        assert_eq!(two.count(1, 4), 1);
        two.spaced[0].burst = 1;
        assert_eq!([0, 1, 5, 6].map(|w| two.count(w, 0)), [0, 2, 2, 2]);
        two.sporadic.push(Sporadic::every(1000));
        assert_eq!(two.clone().merged(&two).count(1, 0), 6);
    }

    #[test]
    fn a_table_counts_the_densest_stretch_and_wraps() {
        let table = table(0, &[(10, 10), (12, 12), (40, 40), (95, 95)]);
        assert_eq!(
            [1, 2, 3, 15, 16, 18, 100, 101].map(|w| table.count(w, 0)),
            [1, 1, 2, 2, 2, 3, 4, 5]
        );
        let mut arrivals = Arrivals {
            timed: vec![table],
            ..Arrivals::default()
        };
        assert_eq!([1, 2, 4].map(|n| arrivals.distance(n, 0)), [2, 17, 100]);
        // The same beside a stream, and all of them 10 apart.
        arrivals.sporadic = vec![Sporadic::every(100)];
        assert_eq!([1, 10, 11].map(|w| arrivals.count(w, 0)), [2, 3, 3]);
        arrivals.apart = 10;
        let count = |window, jitter| arrivals.count(window, jitter);
        assert_eq!([1, 10, 11, 100].map(|w| count(w, 0)), [1, 1, 2, 5]);
        assert_eq!(count(10, 1), 2);
    }

    #[test]
    fn uncertain_releases_may_coincide_but_keep_their_spacing() {
        assert_eq!(table(0, &[(10, 30), (20, 40)]).count(1, 0), 2);
        assert_eq!(table(5, &[(10, 30), (20, 40)]).count(5, 0), 1);
        assert_eq!(table(5, &[(10, 30), (20, 40)]).count(6, 0), 2);
        // Late by more than the distance between them.
        assert_eq!(table(0, &[(10, 10), (13, 13)]).count(1, 3), 2);
    }

    #[test]
    fn a_burst_comes_once_in_any_window() {
        let mut table = table(20, &[(0, 90), (0, 90), (0, 90), (0, 90), (0, 90)]);
        assert_eq!([1, 20, 21, 41].map(|w| table.count(w, 0)), [1, 1, 2, 3]);
        table.burst = 1;
        assert_eq!([1, 20, 21, 41].map(|w| table.count(w, 0)), [2, 2, 3, 4]);
    }

    #[test]
    fn a_job_that_has_completed_does_not_interfere() {
        let table = table(0, &[(10, 20), (50, 50), (98, 99)]);
        let around = |carry, window| table.around(&table.jobs[1], 0, carry, window);
        assert_eq!(around(30, 1), 0);
        assert_eq!(around(31, 1), 1);
        assert_eq!(around(1, 48), 0);
        assert_eq!(around(1, 49), 1);
        // Its own repetition a cycle later counts.
        assert_eq!(around(1, 101), 3);
    }

    #[test]
    fn the_rate_of_the_longest_burst_is_known() {
        let hour = 3_600_000_000 * crate::units::MICROSECOND;
        let burst = Sporadic {
            period: hour,
            jitter: 0,
            limit: Some((10_000, hour)),
        };
        let rates: Vec<_> = Arrivals::from(burst).rates().collect();
        assert_eq!(rates, [(1, hour)]);
    }
}
