//! A run in which a debugger goes forwards and backwards.
//!
//! A run depends on nothing but its images, its scenario and its seed. So an earlier place is reached again by
//! copying an earlier state of the whole vehicle and running that one. A state is kept every [`SPACING`]; what
//! the node passed between two of them is noted, so that a search for a breakpoint runs only the spans in which
//! it may be met.
//!
//! A place in a run is named by the number of steps that the debugged node has carried out.

use crate::mcu::Mcu;
use crate::stops::{Footprint, Stop, Stops};
use crate::twin::{Twin, TwinError};
use can_bus::{Record, SimDuration, SimTime};
use vehicle_model::NodeIndex;

/// Time between two states that are kept.
pub const SPACING: SimDuration = SimDuration::from_ticks(200_000_000_000);
/// So many of the latest states are kept, and about as many older ones: each [`THINNED`]th at first.
const LATEST: usize = 150;
const THINNED: u64 = 10;
/// A state is kept so many steps before a place to which one has gone back: the next one is often just before.
const NEAR: u64 = 2000;

/// Something that accompanies the run and sees the same whenever the run passes a place.
pub trait Companion: Clone {
    /// The vehicle has run by a step. `fresh` tells whether it is here for the first time.
    fn accompany(&mut self, twin: &mut Twin, fresh: bool);

    /// What goes on from here when one has gone back.
    #[must_use]
    fn keep(&self) -> Self {
        self.clone()
    }
}

impl Companion for () {
    fn accompany(&mut self, _: &mut Twin, _: bool) {}
}

/// Why the run stands still.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Halt {
    /// The node is where it was to stop.
    Stop(Stop),
    /// The caller wanted it.
    Interrupted,
    /// The run begins here.
    Beginning,
    /// The run ends here.
    End,
    /// The run cannot go on: a program did what its microcontroller does not allow.
    Failed(String),
}

/// A state of the run.
struct Mark<C> {
    twin: Twin,
    companion: C,
    steps: u64,
    /// Number of records of the bus until then.
    records: usize,
    /// What the node passes from here to the next state.
    footprint: Footprint,
    /// A debugger has changed the state, so it cannot be reached from an earlier one.
    changed: bool,
}

impl<C: Companion> Mark<C> {
    fn at(&self) -> SimTime {
        self.twin.now()
    }
}

/// A run with its history.
pub struct Replay<C> {
    twin: Twin,
    companion: C,
    node: NodeIndex,
    end: SimTime,
    /// The run is cut into spans of this length, as other runs are with which it shall agree.
    span: SimDuration,
    /// The states that are kept, in the order of the run.
    marks: Vec<Mark<C>>,
    /// Index of the last mark before the present place.
    passed: usize,
    near: Option<Mark<C>>,
    /// The records of the bus as far as the run has got, and how many of them there are at the present place.
    records: Vec<Record>,
    recorded: usize,
    /// The time up to which everything has been seen.
    seen: SimTime,
    failed: Option<String>,
}

impl<C: Companion> Replay<C> {
    /// A vehicle at time zero that will run until `end`, in spans of `span`. It is at the first instruction of
    /// a node.
    ///
    /// # Errors
    /// As [`Twin::run_until`].
    pub fn new(
        mut twin: Twin,
        companion: C,
        node: NodeIndex,
        end: SimTime,
        span: SimDuration,
    ) -> Result<Self, TwinError> {
        twin.node_mut(node).attach_probe();
        // The first step of a core loads stack pointer and program counter.
        twin.node_mut(node).stop_at(at_step(1));
        let mut replay = Self {
            twin,
            companion,
            node,
            end,
            span,
            marks: Vec::new(),
            passed: 0,
            near: None,
            records: Vec::new(),
            recorded: 0,
            seen: SimTime::from_ticks(0),
            failed: None,
        };
        while replay.twin.now() < end && replay.twin.run_step(replay.span_end())? {}
        let mark = replay.mark(false);
        replay.marks.push(mark);
        Ok(replay)
    }

    /// The vehicle.
    #[must_use]
    pub fn twin(&self) -> &Twin {
        &self.twin
    }

    /// The debugged node.
    #[must_use]
    pub fn mcu(&self) -> &Mcu {
        self.twin.node(self.node)
    }

    /// The place: steps that the node has carried out.
    #[must_use]
    pub fn steps(&self) -> u64 {
        self.mcu().steps()
    }

    /// Number of states that are kept.
    #[must_use]
    pub fn states(&self) -> usize {
        self.marks.len()
    }

    /// When the run ends.
    #[must_use]
    pub fn end(&self) -> SimTime {
        self.end
    }

    /// The records of the bus until now.
    #[must_use]
    pub fn records(&self) -> &[Record] {
        &self.records[..self.recorded]
    }

    /// The companion of the run.
    #[must_use]
    pub fn companion(&self) -> &C {
        &self.companion
    }

    /// The companion of the run.
    pub fn companion_mut(&mut self) -> &mut C {
        &mut self.companion
    }

    /// Changes the state of the node. What has been seen of the future is void; going back undoes the change.
    pub fn change<R>(&mut self, act: impl FnOnce(&mut Mcu) -> R) -> R {
        let mcu = self.twin.node_mut(self.node);
        let result = act(mcu);
        let footprint = mcu.take_footprint().unwrap_or_default();
        self.forget_from(self.passed + 1, self.recorded);
        self.seen = self.seen.min(self.twin.now());
        let mark = self.mark(true);
        let last = &mut self.marks[self.passed];
        if last.changed && (last.steps, last.at()) == (mark.steps, mark.at()) {
            // Registers are changed one after the other.
            *last = mark;
        } else {
            last.footprint = footprint;
            self.marks.push(mark);
            self.passed += 1;
        }
        result
    }

    /// Runs on until the node stops, the run ends, or `interrupted` says so. It is asked at least once in a
    /// millisecond of the run.
    pub fn forwards(&mut self, stops: Stops, interrupted: &mut dyn FnMut(&Self) -> bool) -> Halt {
        // Changes that have been made later on are undone.
        let ahead = self.passed + 1;
        if let Some(changed) = self.marks[ahead..].iter().position(|mark| mark.changed) {
            let records = self.marks[ahead + changed].records;
            self.forget_from(ahead + changed, records);
        }
        if self.leap(&stops) && interrupted(self) {
            return Halt::Interrupted;
        }
        self.run(stops, interrupted)
    }

    /// Goes back to the last place before this one at which the node met a breakpoint, or to the place just
    /// behind its last access to a watched range.
    pub fn backwards(&mut self, stops: &Stops, interrupted: &mut dyn FnMut(&Self) -> bool) -> Halt {
        let (present, passed) = (self.mark(false), self.passed);
        let (here, now) = (present.steps, present.at());
        for number in (0..=passed).rev() {
            let limit = match self.marks.get(number + 1) {
                Some(next) if number < passed => {
                    if !self.marks[number].footprint.may_meet(stops) {
                        continue;
                    }
                    next.steps
                }
                _ => here,
            };
            match self.last_stop(number, limit, now, stops, interrupted) {
                Ok(None) => {}
                Ok(Some((steps, stop))) => {
                    self.back_to(steps, now);
                    return Halt::Stop(stop);
                }
                Err(halt) => {
                    self.restore(&present);
                    self.passed = passed;
                    return halt;
                }
            }
        }
        self.load(0);
        Halt::Beginning
    }

    /// Goes back by a step.
    pub fn step_back(&mut self) -> Halt {
        let steps = self.steps();
        if steps <= self.marks[0].steps {
            return Halt::Beginning;
        }
        self.back_to(steps - 1, self.twin.now());
        Halt::Stop(Stop::Step)
    }

    /// Goes to the first step of the node at this time or later, in whichever direction it lies. A node that
    /// sleeps is left where the time is, a millisecond later at most.
    pub fn go_to(&mut self, time: SimTime, interrupted: &mut dyn FnMut(&Self) -> bool) -> Halt {
        if time < self.mcu().now() {
            let before = self.marks.partition_point(|mark| mark.at() <= time);
            self.load(before.saturating_sub(1));
        }
        let stops = Stops {
            time: Some(time),
            ..Stops::default()
        };
        let mut wanted = false;
        let mut interrupted_or_due = |replay: &Self| {
            wanted = interrupted(replay);
            wanted || replay.twin.now() >= time
        };
        match self.forwards(stops, &mut interrupted_or_due) {
            Halt::Interrupted if !wanted => Halt::Stop(Stop::Time),
            halt => halt,
        }
    }

    /// Ends the debugger's part in the run. Returns the vehicle at the end of the present span.
    ///
    /// # Errors
    /// As [`Twin::run_until`].
    pub fn into_twin(mut self) -> Result<Twin, TwinError> {
        self.twin.node_mut(self.node).detach_probe();
        let end = self.span_end();
        self.twin.run_until(end)?;
        self.records.truncate(self.recorded);
        self.twin.restore_records(self.records);
        Ok(self.twin)
    }

    /// The last stop between a mark and a place, but not behind a time, as [`Replay::backwards`] reports it.
    fn last_stop(
        &mut self,
        number: usize,
        limit: u64,
        latest: SimTime,
        stops: &Stops,
        interrupted: &mut dyn FnMut(&Self) -> bool,
    ) -> Result<Option<(u64, Stop)>, Halt> {
        self.load(number);
        let stops = Stops {
            step: Some(limit),
            time: None,
            ..stops.clone()
        };
        let mut last = None;
        loop {
            let mut wanted = false;
            let mut interrupted_or_over = |replay: &Self| {
                wanted = interrupted(replay);
                wanted || replay.twin.now() > latest
            };
            match self.run(stops.clone(), &mut interrupted_or_over) {
                Halt::Stop(Stop::Step) => return Ok(last),
                Halt::Stop(stop @ Stop::Access(_)) => last = Some((self.steps() + 1, stop)),
                Halt::Stop(stop) => last = Some((self.steps(), stop)),
                Halt::Interrupted if wanted => return Err(Halt::Interrupted),
                Halt::Interrupted | Halt::Beginning | Halt::End | Halt::Failed(_) => {
                    return Ok(last);
                }
            }
        }
    }

    /// Goes back to a place, but not behind a time: the node may sleep before the place.
    fn back_to(&mut self, steps: u64, latest: SimTime) {
        let mut over = |replay: &Self| replay.twin.now() > latest;
        let before = self.marks.partition_point(|mark| mark.steps <= steps);
        let number = before.saturating_sub(1);
        let from = self.marks[number].steps;
        let fits = |near: &mut Mark<C>| from < near.steps && near.steps <= steps;
        match self.near.take_if(fits) {
            Some(near) => {
                self.restore(&near);
                self.passed = number;
                self.near = Some(near);
            }
            None => self.load(number),
        }
        if steps > self.steps() + 2 * NEAR {
            self.run(at_step(steps - NEAR), &mut over);
            self.near = Some(self.mark(false));
        }
        if self.steps() < steps || self.mcu().stopped().is_none() {
            self.run(at_step(steps), &mut over);
        }
    }

    /// Leaps forwards over spans that the run has gone through before, and in which the node stops nowhere. True if
    /// there are some.
    fn leap(&mut self, stops: &Stops) -> bool {
        let mut to = self.passed;
        while let Some(next) = self.marks.get(to + 1) {
            let before = stops.time.is_none_or(|time| next.at() <= time)
                && stops.step.is_none_or(|step| next.steps <= step);
            if !before || self.marks[to].footprint.may_meet(stops) {
                break;
            }
            to += 1;
        }
        let leaps = to > self.passed;
        if leaps {
            self.load(to);
        }
        leaps
    }

    /// Forgets marks and records from these on: the run will be another one.
    fn forget_from(&mut self, mark: usize, records: usize) {
        self.marks.truncate(mark);
        self.records.truncate(records);
        self.near = None;
    }

    /// Goes to a mark.
    fn load(&mut self, number: usize) {
        let mark = self.marks.swap_remove(number);
        self.restore(&mark);
        self.marks.push(mark);
        let last = self.marks.len() - 1;
        self.marks.swap(number, last);
        self.passed = number;
    }

    fn restore(&mut self, mark: &Mark<C>) {
        self.twin = mark.twin.copy();
        self.companion = mark.companion.clone();
        self.recorded = mark.records;
        self.failed = None;
    }

    fn mark(&self, changed: bool) -> Mark<C> {
        Mark {
            twin: self.twin.copy(),
            companion: self.companion.keep(),
            steps: self.steps(),
            records: self.recorded,
            footprint: Footprint::default(),
            changed,
        }
    }

    /// The end of the present span.
    fn span_end(&self) -> SimTime {
        let span = self.span.as_ticks().max(1);
        let next = (self.twin.now().as_ticks() / span + 1) * span;
        SimTime::from_ticks(next).min(self.end)
    }

    fn run(&mut self, stops: Stops, interrupted: &mut dyn FnMut(&Self) -> bool) -> Halt {
        self.twin.node_mut(self.node).stop_at(stops);
        loop {
            if let Some(why) = &self.failed {
                return Halt::Failed(why.clone());
            }
            if self.twin.now() >= self.end && self.mcu().stopped().is_none() {
                return Halt::End;
            }
            match self.twin.run_step(self.span_end()) {
                Ok(true) => self.note(),
                Ok(false) => return Halt::Stop(self.mcu().stopped().unwrap_or(Stop::Step)),
                Err(error) => {
                    self.note();
                    self.failed = Some(error.to_string());
                    continue;
                }
            }
            if interrupted(self) {
                return Halt::Interrupted;
            }
        }
    }

    /// Notes what a step of the vehicle has brought.
    fn note(&mut self) {
        let now = self.twin.now();
        self.companion.accompany(&mut self.twin, now > self.seen);
        self.seen = self.seen.max(now);
        let records = self.twin.take_records_so_far();
        if self.recorded == self.records.len() {
            self.records.extend_from_slice(&records);
        }
        self.recorded += records.len();
        let next = self.passed + 1;
        match self.marks.get(next).map(|mark| (mark.at(), mark.changed)) {
            Some((at, false)) if at <= now => {
                self.twin.node_mut(self.node).take_footprint();
                self.passed = next;
            }
            Some(_) => {}
            None if now >= self.marks[self.passed].at() + SPACING => {
                let footprint = self.twin.node_mut(self.node).take_footprint();
                self.marks[self.passed].footprint = footprint.unwrap_or_default();
                let mark = self.mark(false);
                self.marks.push(mark);
                self.passed = next;
                self.thin();
            }
            None => {}
        }
    }

    /// Forgets most of the older states, and always more of them the longer the run is: each holds all that has
    /// been recorded until then.
    fn thin(&mut self) {
        let number = self.marks.len().saturating_sub(LATEST);
        let turn = self.marks[number].at().as_ticks() / SPACING.as_ticks();
        if !turn.is_multiple_of(THINNED) {
            self.forget(number);
        }
        if self.marks.len() > 2 * LATEST {
            for number in (1..LATEST).rev().step_by(2) {
                self.forget(number);
            }
        }
    }

    /// Forgets a state that can be reached from the one before.
    fn forget(&mut self, number: usize) {
        if number > 0 && !self.marks[number].changed {
            let mark = self.marks.remove(number);
            self.marks[number - 1].footprint.join(&mark.footprint);
            self.passed -= 1;
        }
    }
}

fn at_step(steps: u64) -> Stops {
    Stops {
        step: Some(steps),
        ..Stops::default()
    }
}
