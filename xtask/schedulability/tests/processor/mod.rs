//! A processor under static priorities, from event to event. It shares no code with the analysis:
//! it only reads the task set, and releases what its documentation permits.
//!
//! A started job is on a stack, as with nested interrupts. The most urgent pending job starts if its
//! priority is above that of the job on top, or above the ceiling of the section that this one is
//! in. Jobs of one task start in the order of their nominal releases, those of equal priority in
//! any order.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::Rng;
use schedulability::arrivals::JobId;
use schedulability::response::Task;

/// A number below `end`, which is not zero.
pub(crate) fn below(random: &mut ChaCha8Rng, end: u64) -> u64 {
    random.next_u64() % end
}

/// True once in `times`.
pub(crate) fn once_in(random: &mut ChaCha8Rng, times: u64) -> bool {
    below(random, times) == 0
}

/// A stretch of a job's execution with its resource locked, in ticks from the job's start.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Locked {
    pub(crate) from: u64,
    pub(crate) to: u64,
    pub(crate) ceiling: u32,
}

/// What the set does not say.
#[derive(Debug, Clone, Default)]
pub(crate) struct Behaviour {
    /// The sections of the jobs of each task, and behind them those of the idle code.
    pub(crate) locks: Vec<Vec<Locked>>,
    /// For each task, which of its releases follow from which of another task.
    pub(crate) links: Vec<Vec<Link>>,
    /// What each task costs each other one that it preempts, and the idle code behind them.
    pub(crate) lost: Vec<Vec<u64>>,
    /// Whether the node is off the bus.
    pub(crate) off_bus: bool,
    pub(crate) horizon: u64,
}

/// A release of a task that follows from one of its cause.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Link {
    pub(crate) own: Origin,
    pub(crate) cause: usize,
    pub(crate) of: Origin,
}

/// Where a release comes from, within its task.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Origin {
    /// A stream.
    Stream(usize),
    /// A stream of a group that keeps a distance.
    Spaced(usize, usize),
    /// A job of a table.
    Timed(usize, usize),
    /// Any of them.
    Any,
}

/// A release that may occur.
#[derive(Debug, Clone, Copy)]
struct Candidate {
    task: usize,
    origin: Origin,
    turn: u64,
    /// Its latest instant.
    latest: u64,
}

/// A nominal release that a job serves.
#[derive(Debug, Clone, Copy)]
struct Served {
    origin: Origin,
    turn: u64,
    arrival: u64,
}

/// A job, pending or on the stack.
#[derive(Debug, Clone)]
struct Run {
    task: usize,
    /// Several, if releases have merged.
    served: Vec<Served>,
    cost: u64,
    done: u64,
    /// What the last preemptions cost it, as far as it is still to be done.
    extra: u64,
    /// When it releases the tasks behind it, in ticks from its start.
    pends: u64,
}

#[derive(Debug, Clone)]
enum Event {
    Arrival(Candidate),
    Release(usize, Served),
}

/// The order in which the pending jobs of equal priority start.
#[derive(Debug, Clone, Copy)]
enum Order {
    OldestFirst,
    YoungestFirst,
    Any,
}

/// A completed job: its task, origin, and the time from its nominal release to its end.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Completed {
    pub(crate) task: usize,
    pub(crate) origin: Origin,
    pub(crate) response: u64,
}

pub(crate) struct Processor<'a> {
    tasks: &'a [Task],
    behaviour: &'a Behaviour,
    random: &'a mut ChaCha8Rng,
    /// Instants, one in each turn, at which as much as possible is released.
    rushes: Vec<u64>,
    order: Order,
    now: u64,
    events: BinaryHeap<Reverse<(u64, usize)>>,
    what: Vec<Event>,
    /// Past arrivals of each stream, group and table of each task.
    past: Vec<(Origin, usize, Vec<u64>)>,
    /// Numbered jobs that have started, with their turn.
    started: Vec<(JobId, u64)>,
    /// Candidates whose cause has not started.
    waiting: Vec<(JobId, Candidate)>,
    pending: Vec<Run>,
    stack: Vec<Run>,
    completed: Vec<Completed>,
}

/// Runs the set with random legal releases, mostly as dense as possible about some instants.
pub(crate) fn run(
    tasks: &[Task],
    behaviour: &Behaviour,
    random: &mut ChaCha8Rng,
) -> Vec<Completed> {
    let cycle = cycle(tasks);
    let turns = behaviour.horizon / cycle + 2;
    let rush = rush(tasks, cycle, random);
    let rushes = (0..turns).map(|turn| turn * cycle + rush + below(random, 8) / 6);
    let rushes = rushes.collect();
    let order = match below(random, 3) {
        0 => Order::OldestFirst,
        1 => Order::YoungestFirst,
        _ => Order::Any,
    };
    let mut processor = Processor {
        tasks,
        behaviour,
        random,
        rushes,
        order,
        now: 0,
        events: BinaryHeap::new(),
        what: Vec::new(),
        past: Vec::new(),
        started: Vec::new(),
        waiting: Vec::new(),
        pending: Vec::new(),
        stack: Vec::new(),
        completed: Vec::new(),
    };
    processor.draw();
    processor.go();
    processor.completed
}

/// The longest cycle of the tables.
fn cycle(tasks: &[Task]) -> u64 {
    let tables = tasks.iter().flat_map(|task| &task.arrivals.timed);
    tables.map(|table| table.cycle).max().unwrap_or(200)
}

/// An instant of the cycle about which to crowd the releases: mostly an end of a job's interval.
fn rush(tasks: &[Task], cycle: u64, random: &mut ChaCha8Rng) -> u64 {
    let tables = tasks.iter().flat_map(|task| &task.arrivals.timed);
    let jobs = tables.flat_map(|table| &table.jobs);
    let mut ends: Vec<u64> = jobs.flat_map(|job| [job.earliest, job.latest]).collect();
    ends.push(below(random, cycle));
    ends[below(random, ends.len() as u64) as usize] % cycle
}

impl Processor<'_> {
    fn push(&mut self, at: u64, event: Event) {
        self.events.push(Reverse((at, self.what.len())));
        self.what.push(event);
    }

    /// An instant from `first` to `last`: mostly as close to a rush as possible.
    fn instant(&mut self, first: u64, last: u64) -> u64 {
        let rush = self.rushes.iter().find(|&&rush| rush >= first);
        let rush = rush.copied().unwrap_or(last);
        match below(self.random, 8) {
            0 => first,
            1 => last,
            2 => first + below(self.random, last - first + 1),
            _ => rush.clamp(first, last),
        }
    }

    /// Draws everything that may be released, but for what tasks release.
    fn draw(&mut self) {
        for (index, task) in self.tasks.iter().enumerate() {
            if task.off_bus && !self.behaviour.off_bus {
                continue;
            }
            let arrivals = &task.arrivals;
            let alone = (0..arrivals.sporadic.len()).map(Origin::Stream);
            let spaced = arrivals.spaced.iter().enumerate();
            let spaced = spaced.flat_map(|(group, spaced)| {
                (0..spaced.streams.len()).map(move |at| Origin::Spaced(group, at))
            });
            let timed = arrivals.timed.iter().enumerate();
            let timed = timed.flat_map(|(table, timed)| {
                (0..timed.jobs.len()).map(move |at| Origin::Timed(table, at))
            });
            for origin in alone.chain(spaced).chain(timed) {
                let links = &self.behaviour.links[index];
                if !links.iter().any(|link| link.own == origin) {
                    self.draw_one(index, origin);
                }
            }
        }
    }

    fn draw_one(&mut self, index: usize, origin: Origin) {
        let arrivals = &self.tasks[index].arrivals;
        let rare = once_in(self.random, 4);
        let stream = match origin {
            Origin::Stream(at) => arrivals.sporadic[at],
            Origin::Spaced(group, at) => arrivals.spaced[group].streams[at],
            Origin::Timed(table, at) => {
                let table = &arrivals.timed[table];
                let job = &table.jobs[at];
                for turn in 0..self.behaviour.horizon / table.cycle + 1 {
                    if rare && once_in(self.random, 3) {
                        continue;
                    }
                    let begin = turn * table.cycle;
                    let at = self.instant(begin + job.earliest, begin + job.latest);
                    let latest = begin + job.latest;
                    self.candidate(at, index, origin, turn, latest);
                }
                return;
            }
            Origin::Any => return,
        };
        // A nominal instant at or shortly before a rush, so that the others follow it densely.
        let first = self.rushes[0];
        let early = if once_in(self.random, 2) {
            stream.jitter
        } else {
            0
        };
        let mut nominal = first.saturating_sub(early) % stream.period;
        while nominal < self.behaviour.horizon {
            let at = self.instant(nominal, nominal + stream.jitter);
            self.candidate(at, index, origin, 0, nominal + stream.jitter);
            let more = if once_in(self.random, 4) { 4 } else { 1 };
            nominal += stream.period + below(self.random, more);
        }
    }

    fn candidate(&mut self, at: u64, task: usize, origin: Origin, turn: u64, latest: u64) {
        let candidate = Candidate {
            task,
            origin,
            turn,
            latest,
        };
        self.push(at, Event::Arrival(candidate));
    }

    /// The past arrivals of a stream, group or table.
    fn past(&mut self, task: usize, of: Origin) -> &mut Vec<u64> {
        let mut known = self.past.iter();
        let at = known.position(|(origin, index, _)| (*origin, *index) == (of, task));
        let at = at.unwrap_or_else(|| {
            self.past.push((of, task, Vec::new()));
            self.past.len() - 1
        });
        &mut self.past[at].2
    }

    /// The earliest instant at which a release may follow those in `past`: any window holds as
    /// many as the distance allows, and `burst` more.
    fn after(past: &[u64], apart: u64, burst: u64) -> u64 {
        let before = past.iter().rev().skip(burst as usize).zip(1..);
        let next = before.map(|(at, distance)| at + distance * apart);
        next.max().unwrap_or(0)
    }

    /// A release may occur: it does if its stream or table permits it, else later if it may.
    fn arrive(&mut self, one: Candidate) {
        if let Origin::Timed(table, at) = one.origin
            && let Some(cause) = self.tasks[one.task].arrivals.timed[table].jobs[at].cause
            && !self.started.contains(&(cause, one.turn))
        {
            self.waiting.push((cause, one));
            return;
        }
        let earliest = self.permitted(one);
        if earliest > self.now {
            if earliest <= one.latest {
                self.push(earliest, Event::Arrival(one));
            }
            return;
        }
        let now = self.now;
        self.past(one.task, one.origin).push(now);
        if let Some((group, ..)) = self.group(one) {
            self.past(one.task, group).push(now);
        }
        self.past(one.task, Origin::Any).push(now);
        let served = Served {
            origin: one.origin,
            turn: one.turn,
            arrival: now,
        };
        self.late(one.task, served);
    }

    /// The group or table of a release, with its distance and burst.
    fn group(&self, one: Candidate) -> Option<(Origin, u64, u64)> {
        let arrivals = &self.tasks[one.task].arrivals;
        match one.origin {
            Origin::Stream(_) | Origin::Any => None,
            Origin::Spaced(group, _) => {
                let spaced = &arrivals.spaced[group];
                let whole = Origin::Spaced(group, usize::MAX);
                Some((whole, spaced.apart, spaced.burst))
            }
            Origin::Timed(table, _) => {
                let timed = &arrivals.timed[table];
                let whole = Origin::Timed(table, usize::MAX);
                Some((whole, timed.spacing, timed.burst))
            }
        }
    }

    /// From when on the distances permit a release.
    fn permitted(&mut self, one: Candidate) -> u64 {
        let arrivals = &self.tasks[one.task].arrivals;
        let limit = match one.origin {
            Origin::Stream(at) => arrivals.sporadic[at].limit,
            Origin::Spaced(group, at) => arrivals.spaced[group].streams[at].limit,
            Origin::Timed(..) | Origin::Any => None,
        };
        let apart = arrivals.apart;
        let mut earliest = match self.past(one.task, Origin::Any).last() {
            Some(last) if apart > 0 => last + apart,
            _ => 0,
        };
        if let Some((jobs, span)) = limit {
            let past = self.past(one.task, one.origin);
            let first = past.len().checked_sub(jobs as usize);
            earliest = earliest.max(first.map_or(0, |first| past[first] + span));
        }
        if let Some((group, apart, burst)) = self.group(one).filter(|(_, apart, _)| *apart > 0) {
            earliest = earliest.max(Self::after(self.past(one.task, group), apart, burst));
        }
        earliest
    }

    /// Releases a job as late as its task's jitter permits.
    fn late(&mut self, task: usize, served: Served) {
        let jitter = self.tasks[task].jitter;
        let at = self.instant(self.now, self.now + jitter);
        self.push(at, Event::Release(task, served));
    }

    fn release(&mut self, index: usize, served: Served) {
        let task = &self.tasks[index];
        let cost = match served.origin {
            Origin::Timed(table, _) => task.arrivals.timed[table].cost.unwrap_or(task.cost),
            _ => task.cost,
        };
        let cost = if once_in(self.random, 8) {
            1 + below(self.random, cost)
        } else {
            cost
        };
        let pends = match below(self.random, 3) {
            0 => 1 + below(self.random, cost),
            _ => cost,
        };
        let merged = self.pending.iter_mut().find(|run| run.task == index);
        if let Some(run) = merged.filter(|_| task.coalesces) {
            run.served.push(served);
            if cost > run.cost {
                (run.cost, run.pends) = (cost, pends);
            }
            return;
        }
        self.pending.push(Run {
            task: index,
            served: vec![served],
            cost,
            done: 0,
            extra: 0,
            pends,
        });
    }

    /// The ceiling of the section that a job is in, or its priority.
    fn level(&self, run: &Run) -> u32 {
        let locks = &self.behaviour.locks[run.task];
        let held = locks.iter().filter(|lock| {
            (lock.from..lock.to).contains(&run.done) && lock.to <= run.cost && run.done < run.cost
        });
        let own = self.tasks.get(run.task).map_or(0, |task| task.priority);
        held.map(|lock| lock.ceiling).max().unwrap_or(0).max(own)
    }

    /// Ticks until the job on top ends or leaves or enters a section.
    fn ticks(&self, run: &Run) -> u64 {
        if run.extra > 0 {
            return run.extra;
        }
        let locks = self.behaviour.locks[run.task].iter();
        let edges = locks.flat_map(|lock| [lock.from, lock.to]);
        let edges = edges.chain([run.pends, run.cost]);
        let next = edges.filter(|edge| *edge > run.done).min();
        next.unwrap_or(run.cost) - run.done
    }

    /// Starts the most urgent pending job, if it is above the job on top.
    fn start(&mut self) -> bool {
        let level = self.stack.last().map_or(0, |top| self.level(top));
        let priority = |run: &Run| self.tasks[run.task].priority;
        let most = self.pending.iter().map(priority).max();
        let Some(most) = most.filter(|most| *most > level) else {
            return false;
        };
        let arrival = |run: &Run| run.served.iter().map(|served| served.arrival).min();
        let urgent = (0..self.pending.len()).filter(|&at| priority(&self.pending[at]) == most);
        let mut urgent: Vec<usize> = urgent.collect();
        urgent.sort_by_key(|&at| arrival(&self.pending[at]));
        let chosen = match self.order {
            Order::OldestFirst => urgent[0],
            Order::YoungestFirst => urgent[urgent.len() - 1],
            Order::Any => urgent[below(self.random, urgent.len() as u64) as usize],
        };
        // Of its task, the oldest.
        let of_task = |at: &&usize| self.pending[**at].task == self.pending[chosen].task;
        let chosen = *urgent.iter().find(of_task).unwrap_or(&chosen);
        let run = self.pending.remove(chosen);
        let task = &self.tasks[run.task];
        if let Some(top) = self.stack.last_mut().filter(|top| top.done > 0) {
            // What the job has to do again; it cannot lose the same twice.
            let of = self.behaviour.lost.get(run.task);
            let lost = of.and_then(|of| of.get(top.task)).copied().unwrap_or(0);
            let lost = below(self.random, 4).min(1) * lost;
            top.extra = top.extra.max(lost);
        }
        for served in &run.served {
            if let Origin::Timed(table, at) = served.origin
                && let Some(id) = task.arrivals.timed[table].jobs[at].id
            {
                self.started.push((id, served.turn));
            }
        }
        self.stack.push(run);
        self.wake();
        true
    }

    /// Lets the candidates go on whose cause has started.
    fn wake(&mut self) {
        let waiting = std::mem::take(&mut self.waiting);
        for (cause, one) in waiting {
            if !self.started.contains(&(cause, one.turn)) {
                self.waiting.push((cause, one));
            } else if self.now <= one.latest {
                self.push(self.now, Event::Arrival(one));
            }
        }
    }

    /// Releases what follows from a job.
    fn pend(&mut self, run: &Run) {
        let behaviour = self.behaviour;
        for (index, links) in behaviour.links.iter().enumerate() {
            if self.tasks[index].off_bus && !behaviour.off_bus {
                continue;
            }
            for served in &run.served {
                let mut from = links.iter();
                let link = from.find(|link| link.cause == run.task && link.of == served.origin);
                if let Some(link) = link.filter(|_| !once_in(self.random, 8)) {
                    let served = Served {
                        origin: link.own,
                        ..*served
                    };
                    self.late(index, served);
                }
            }
        }
    }

    /// Runs the job on top for so many ticks, no longer than to its next edge.
    fn work(&mut self, ticks: u64) {
        self.now += ticks;
        let Some(mut run) = self.stack.pop() else {
            return;
        };
        if run.extra > 0 {
            run.extra -= ticks;
            self.stack.push(run);
            return;
        }
        run.done += ticks;
        if run.done == run.pends && ticks > 0 {
            self.pend(&run);
        }
        if run.done < run.cost {
            self.stack.push(run);
            return;
        }
        for served in run.served {
            self.completed.push(Completed {
                task: run.task,
                origin: served.origin,
                response: self.now - served.arrival,
            });
        }
    }

    fn go(&mut self) {
        // The idle code, which never ends.
        self.stack.push(Run {
            task: self.tasks.len(),
            served: Vec::new(),
            cost: u64::MAX,
            done: 0,
            extra: 0,
            pends: u64::MAX,
        });
        while self.now < self.behaviour.horizon {
            while let Some(Reverse((at, what))) = self.events.peek().copied() {
                if at > self.now {
                    break;
                }
                self.events.pop();
                match self.what[what].clone() {
                    Event::Arrival(one) => self.arrive(one),
                    Event::Release(task, served) => self.release(task, served),
                }
            }
            if self.start() {
                continue;
            }
            let until = self.events.peek().map(|Reverse((at, _))| at - self.now);
            let top = self.stack.last().map_or(1, |top| self.ticks(top));
            let rest = self.behaviour.horizon - self.now;
            self.work(top.min(until.unwrap_or(rest)));
        }
    }
}
