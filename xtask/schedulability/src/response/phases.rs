//! Response times by where in the bus's cycle the busy period begins.
//!
//! A busy period of a priority begins with a release, at an instant at which no job of that
//! priority or above is pending. Every job that delays a given job was released in the same
//! busy period. So only jobs count that the time table allows between the begin of the busy
//! period and the given job's end; jobs that the table keeps apart never share a busy
//! period, however long it is.
//!
//! Once a job has started, only higher priorities delay it. A job of equal priority counts
//! only if it may be released before the given job starts.
//!
//! A job cannot be delayed by jobs that only exist because it ran ([`Job::cause`]), except by
//! those of a higher priority, which preempt it.
//!
//! It suffices to examine the busy periods that begin with the latest release of a job of
//! the table. Take a busy period that begins at another instant, and the next such latest
//! release after it: no job of the table has its latest release in between, so every table
//! job that may be released in the first busy period may also be released in the second. A
//! given job that is released equally long after the begin of either takes as long.
//!
//! # The job in its busy period
//!
//! The job is released some time `x` after the begin. The releases of its own task may keep a
//! distance from each other: of the most that a window can hold, one is the job itself, but only
//! if the window reaches to `x`. So there are two demands of the other jobs until an instant `t`:
//! `beside(t)` if the job is released by then, and `before(t)`, which may be one release more, if
//! it is not.
//!
//! - The busy period lasts until `x`: `before(t) > t` for each `t < x`.
//! - At `x` too there is or was work for all the time from the begin on. So `beside(x) >= x`.
//! - The job starts at the first `t` from `x` on for which `beside(t) <= t`.
//!
//! All instants `x` from one that fulfils these conditions to the start of the job lead to the same
//! start. The earliest of them gives the longest response.

use std::cmp::Reverse;

use crate::arrivals::{Job, Timetable};

use super::bound::{Critical, Delay};
use super::counted::Counted;
use super::fixed_point::{HORIZON, settle};
use super::task::Task;

/// Steps of the demand in one busy period after which the analysis gives up.
const MAX_STEPS: usize = 10_000;

/// Turns of the cycle to which a job of one busy period may belong, after which it gives up.
const MAX_TURNS: i64 = 100;

/// A busy period to examine.
#[derive(Clone, Copy)]
struct Period {
    /// Its begin in the bus's cycle.
    begin: u64,
    /// Turn of the cycle in which the job is released, if it is one of the time table. The busy
    /// period begins in turn 0.
    turn: i64,
}

/// A job in its busy period. Times count from the begin of the period.
#[derive(Clone, Copy)]
struct Busy {
    period: Period,
    /// Longest response time, measured from the nominal release time.
    response: u64,
    /// When the job starts.
    starts: u64,
    /// When the job has completed.
    ends: u64,
}

/// Whether the job under analysis is released in a window.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Own {
    Released,
    NotYet,
}

/// A task of equal or higher priority than the one under analysis, or that task itself.
struct Delaying<'a> {
    index: usize,
    task: &'a Task,
    tables: Vec<Counted<'a>>,
}

/// A task under analysis, and the task set that may delay it.
pub(super) struct Phases<'a> {
    index: usize,
    task: &'a Task,
    delaying: Vec<Delaying<'a>>,
    /// The cycle that all tables share.
    cycle: i64,
    /// Where the busy periods begin that have to be examined; see the module. With each, the begin
    /// before it, which may be in the turn before.
    begins: Vec<(u64, i64)>,
}

/// A job under analysis.
struct Look<'p, 'a> {
    phases: &'p Phases<'a>,
    /// Its worst-case execution time.
    cost: u64,
    /// The job and its part of the time table; `None` for a job that may be released at any
    /// time.
    job: Option<(&'a Timetable, &'a Job)>,
    /// For each table of each delaying task: the jobs that do not delay the job in its own turn of
    /// the cycle, as they are that job or only exist because it has started.
    absent: Vec<Vec<Vec<&'a Job>>>,
}

impl<'a> Phases<'a> {
    /// `None` if the tables have no common cycle.
    pub(super) fn new(tasks: &'a [Task], index: usize) -> Option<Self> {
        let cycle = common_cycle(tasks)?.cast_signed();
        let task = &tasks[index];
        let all = tasks.iter().enumerate();
        let delaying = all.filter(|(_, other)| other.priority >= task.priority);
        let delaying = delaying.map(|(index, task)| Delaying {
            index,
            task,
            tables: task.arrivals.timed.iter().map(Counted::new).collect(),
        });
        let delaying: Vec<Delaying<'_>> = delaying.collect();
        Some(Self {
            index,
            task,
            begins: begins(&delaying, cycle),
            delaying,
            cycle,
        })
    }

    /// Bound of one job of a table of the task; `None` if a busy period does not end.
    pub(super) fn of_job(&self, table: &'a Timetable, job: &'a Job) -> Option<Critical> {
        let look = Look {
            phases: self,
            cost: table.cost.unwrap_or(self.task.cost),
            job: Some((table, job)),
            absent: self
                .delaying
                .iter()
                .map(|of| self.absent(of, job))
                .collect(),
        };
        let cycle = self.cycle;
        let latest = (job.latest + self.task.jitter).cast_signed();
        let mut worst: Option<Busy> = None;
        for &(begin, before) in &self.begins {
            let first = (begin.cast_signed() - latest + cycle - 1).div_euclid(cycle);
            for turn in first.. {
                let period = Period { begin, turn };
                // The first and the last instant at which the job may be released.
                let release = u64::try_from(look.nominal(period)?).unwrap_or(0);
                if turn - first > MAX_TURNS {
                    return None;
                }
                let idle = look.idle(period)?;
                if release > idle {
                    // Later turns are not in the busy period either.
                    break;
                }
                // The busy period in question begins later than the one examined before this one.
                let last = u64::try_from(latest + turn * cycle - before - 1).unwrap_or(0);
                look.examine(period, release, idle.min(last), &mut worst)?;
            }
        }
        Some(look.critical(worst?))
    }

    /// Bound of a job that may be released at any time.
    pub(super) fn of_any(&self) -> Option<Critical> {
        let none = |of: &Delaying<'a>| of.tables.iter().map(|_| Vec::new()).collect();
        let look = Look {
            phases: self,
            cost: self.task.cost,
            job: None,
            absent: self.delaying.iter().map(none).collect(),
        };
        let mut worst: Option<Busy> = None;
        for &(begin, _) in &self.begins {
            let period = Period { begin, turn: 0 };
            look.examine(period, 0, look.idle(period)?, &mut worst)?;
        }
        Some(look.critical(worst?))
    }

    /// The jobs of a task that are the job under analysis or caused by it, by table. One of a higher
    /// priority that it causes preempts it.
    fn absent(&self, of: &Delaying<'a>, job: &Job) -> Vec<Vec<&'a Job>> {
        let is_absent = |other: &Job| {
            let caused = other.cause.is_some() && other.cause == job.id;
            std::ptr::eq(other, job) || (caused && of.task.priority <= self.task.priority)
        };
        let tables = of.tables.iter();
        let of_table = |counted: &Counted<'a>| {
            let jobs = counted.table.jobs.iter();
            jobs.filter(|other| is_absent(other)).collect()
        };
        tables.map(of_table).collect()
    }
}

/// Where the busy periods begin; see [`Phases::begins`].
fn begins(delaying: &[Delaying<'_>], cycle: i64) -> Vec<(u64, i64)> {
    let mut begins: Vec<u64> = delaying
        .iter()
        .flat_map(|of| {
            let jobs = of.tables.iter().flat_map(|counted| &counted.table.jobs);
            jobs.map(|job| (job.latest + of.task.jitter) % cycle.cast_unsigned())
        })
        .collect();
    begins.sort_unstable();
    begins.dedup();
    let last = begins.last().map(|last| last.cast_signed() - cycle);
    let before = begins.iter().map(|begin| begin.cast_signed());
    let before: Vec<i64> = last.into_iter().chain(before).collect();
    begins.into_iter().zip(before).collect()
}

/// The cycle that all tables share, if they do.
fn common_cycle(tasks: &[Task]) -> Option<u64> {
    let mut cycles = tasks
        .iter()
        .flat_map(|task| &task.arrivals.timed)
        .map(|table| table.cycle);
    let first = cycles.next()?;
    (first > 0 && cycles.all(|cycle| cycle == first)).then_some(first)
}

impl<'a> Look<'_, 'a> {
    const fn task(&self) -> &'a Task {
        self.phases.task
    }

    /// Tasks of equal or higher priority, the task itself included, and the jobs of their tables that do
    /// not delay the job in its own turn.
    fn delaying(&self) -> impl Iterator<Item = (&Delaying<'a>, &[Vec<&'a Job>])> {
        let absent = self.absent.iter().map(Vec::as_slice);
        self.phases.delaying.iter().zip(absent)
    }

    /// Earliest nominal release of a job of the table, from the begin of the period.
    fn nominal(&self, period: Period) -> Option<i64> {
        let (table, job) = self.job?;
        let turn = period.turn.checked_mul(table.cycle.cast_signed())?;
        let release = job.earliest.cast_signed().checked_add(turn)?;
        release.checked_sub(period.begin.cast_signed())
    }

    /// The most releases of a task that may delay the job in a window from the begin of the
    /// period: calls `each` with those of each part of the time table, and their cost if they have one of
    /// their own, and returns those that may be at any time. If the distance between any two of them leaves
    /// room for fewer, the longest ones count.
    fn releases(
        &self,
        period: Period,
        (of, absent): (&Delaying<'a>, &[Vec<&'a Job>]),
        window: u64,
        own: Own,
        mut each: impl FnMut(Option<u64>, u64),
    ) -> u64 {
        let other = of.task;
        let besides = u64::from(own == Own::Released && of.index == self.phases.index);
        let own_table = self.job.map(|(table, _)| std::ptr::from_ref(table));
        let mut sporadic = other
            .arrivals
            .count_sporadic(window.saturating_add(other.jitter));
        if own_table.is_none() {
            sporadic = sporadic.saturating_sub(besides);
        }
        let of_table = |(counted, absent): (&Counted<'a>, &Vec<&'a Job>)| {
            let besides = match own_table {
                Some(own) if std::ptr::eq(own, counted.table) => besides,
                _ => 0,
            };
            let absent = (absent.as_slice(), period.turn);
            let jobs = counted.most(period.begin, window, other.jitter, besides, absent);
            (counted.table.cost, jobs)
        };
        let timed = of.tables.iter().zip(absent).map(of_table);
        if other.arrivals.apart == 0 {
            for (cost, jobs) in timed {
                each(cost, jobs);
            }
            return sporadic;
        }
        let most = other.arrivals.most(window.saturating_add(other.jitter));
        let mut room = most.saturating_sub(besides);
        // No job of the table takes longer than one that may be released at any time.
        sporadic = sporadic.min(room);
        room -= sporadic;
        let mut timed: Vec<_> = timed.collect();
        timed.sort_by_key(|(cost, _)| Reverse(cost.unwrap_or(other.cost)));
        for (cost, jobs) in timed {
            let jobs = room.min(jobs);
            room -= jobs;
            each(cost, jobs);
        }
        sporadic
    }

    /// Time that the delaying jobs take, plus the blocking. Those of equal priority count that are
    /// released in the window `equal` from the begin of the period, the others in `higher`.
    fn demand(&self, period: Period, equal: u64, higher: u64, own: Own) -> Option<u64> {
        let mut sum = self.task().blocking;
        for (of, absent) in self.delaying() {
            let other = of.task;
            let (window, preemption) = if other.priority > self.task().priority {
                (higher, other.preemption.at(self.task().priority))
            } else {
                (equal, 0)
            };
            let mut timed = Some(0_u64);
            let sporadic = self.releases(period, (of, absent), window, own, |cost, jobs| {
                let one = cost.unwrap_or(other.cost).checked_add(preemption);
                let all = one.and_then(|one| one.checked_mul(jobs));
                timed = timed.and_then(|timed| timed.checked_add(all?));
            });
            let each = other.cost.checked_add(preemption)?;
            sum = sum.checked_add(sporadic.checked_mul(each)?)?;
            sum = sum.checked_add(timed?)?;
        }
        Some(sum).filter(|sum| *sum < HORIZON)
    }

    /// The demand of the other jobs until `at`, if the job is released by then. A release at the
    /// very instant at which the job would start still counts.
    fn beside(&self, period: Period, at: u64) -> Option<u64> {
        self.demand(period, at + 1, at + 1, Own::Released)
    }

    /// When the busy period has ended if the job is not released before.
    fn idle(&self, period: Period) -> Option<u64> {
        settle(0, |at| self.demand(period, at + 1, at + 1, Own::NotYet))
    }

    /// Keeps the longest response in `worst`, if the job is released from `first` to `last` in this
    /// period. `None` if the period does not end.
    fn examine(
        &self,
        period: Period,
        first: u64,
        last: u64,
        worst: &mut Option<Busy>,
    ) -> Option<()> {
        let mut next = if first == 0 || self.beside(period, first)? >= first {
            Some(first)
        } else {
            self.next(period, first, last)?
        };
        let jitter = self.task().jitter.cast_signed();
        while let Some(released) = next {
            let starts = settle(released, |at| self.beside(period, at))?;
            let ends = settle(starts + self.cost, |at| {
                let others = self.demand(period, starts + 1, at, Own::Released)?;
                others.checked_add(self.cost)
            })?;
            let nominal = released.cast_signed() - jitter;
            let nominal = self.nominal(period).unwrap_or(nominal).max(nominal);
            let response = ends.checked_add_signed(-nominal)?;
            if worst.is_none_or(|worst| response > worst.response) {
                *worst = Some(Busy {
                    period,
                    response,
                    starts,
                    ends,
                });
            }
            next = self.next(period, starts, last)?;
        }
        Some(())
    }

    /// The first instant after `after`, up to `last`, at which the job may be released while the
    /// busy period goes on. `None` if the demand takes too many steps. At `after` itself, the period is
    /// over.
    ///
    /// The demand only grows. So where it is `d` at an instant behind `d`, the period is over at every
    /// instant between the two; and it cannot go on before the first instant at which the demand exceeds
    /// `after`.
    fn next(&self, period: Period, after: u64, last: u64) -> Option<Option<u64>> {
        let (mut after, mut last) = (after, last);
        for _ in 0..MAX_STEPS {
            if after >= last {
                return Some(None);
            }
            let demand = self.beside(period, last)?;
            if demand < last {
                last = demand;
                continue;
            }
            // That instant is in low + 1..=high.
            let (mut low, mut high) = (after, last);
            while high - low > 1 {
                let middle = low + (high - low) / 2;
                if self.beside(period, middle)? > after {
                    high = middle;
                } else {
                    low = middle;
                }
            }
            if self.beside(period, high)? >= high {
                return Some(Some(high));
            }
            after = high;
        }
        None
    }

    /// The answer for the job in its worst period.
    fn critical(&self, busy: Busy) -> Critical {
        let task = self.task();
        let delay = |(of, absent): (&Delaying<'a>, &[Vec<&'a Job>])| {
            let other = of.task;
            let (window, preemption) = if other.priority > task.priority {
                (busy.ends, other.preemption.at(task.priority))
            } else {
                (busy.starts + 1, 0)
            };
            let mut sum = Delay {
                task: of.index,
                jobs: 0,
                time: 0,
            };
            let mut add = |cost: Option<u64>, jobs: u64| {
                sum.jobs += jobs;
                sum.time += jobs * (cost.unwrap_or(other.cost) + preemption);
            };
            let own = Own::Released;
            let sporadic = self.releases(busy.period, (of, absent), window, own, &mut add);
            add(None, sporadic);
            sum
        };
        Critical {
            job: self.job.map(|(_, job)| job.label.clone()),
            response: busy.response,
            deadline: self
                .job
                .and_then(|(_, job)| job.deadline)
                .unwrap_or(task.deadline),
            cost: self.cost,
            jitter: task.jitter,
            delayed_by: self
                .delaying()
                .map(delay)
                .filter(|delay| delay.jobs > 0)
                .collect(),
        }
    }
}
