//! Execution times of a node's tasks: for each exception its number of activations, its longest
//! execution time and its longest response time.

use crate::clock::Cycles;
use crate::image::Image;
use can_bus::SimTime;
use std::collections::BTreeMap;
use std::mem;

/// Figures of one exception handler, in core cycles.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TaskTimes {
    /// Exception number: 15 is SysTick, 16 the first interrupt.
    pub exception: u16,
    /// Symbol of the handler, which for interrupts is the vector's name.
    pub name: String,
    /// How often it ran.
    pub activations: u64,
    /// Longest execution time of an activation: from its first instruction to its return, without
    /// preemption by higher priorities and without exception entry and return.
    pub longest: Cycles,
    /// The same of the activations that were preempted so often.
    pub by_preemptions: BTreeMap<u32, Cycles>,
    /// Longest response time: from the exception entry (stacking included) to the return.
    pub longest_response: Cycles,
    /// Sum of the execution times of all activations.
    pub total: Cycles,
}

/// A core begins to execute something else.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TaskSwitch {
    /// When.
    pub at: SimTime,
    /// Exception number of what it executes from then on; 0 for what no exception interrupts.
    pub exception: u16,
}

/// How a node spent its cycles.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Tasks in the order of their exception number.
    pub tasks: Vec<TaskTimes>,
    /// Cycles in thread mode, awake.
    pub thread: Cycles,
    /// Cycles asleep.
    pub asleep: Cycles,
    /// Cycles of exception entries and returns.
    pub switching: Cycles,
}

impl Load {
    /// Share of the time that the core was awake, 0..=1.
    #[must_use]
    pub fn utilisation(&self) -> f64 {
        let tasks: Cycles = self.tasks.iter().map(|task| task.total).sum();
        let awake = tasks + self.thread + self.switching;
        let all = awake + self.asleep;
        if all == 0 {
            0.0
        } else {
            awake as f64 / all as f64
        }
    }
}

#[derive(Clone, Debug)]
struct Activation {
    exception: u16,
    entered: Cycles,
    own: Cycles,
    preemptions: u32,
}

/// Follows the nesting of a core's exceptions.
#[derive(Clone, Debug, Default)]
pub(crate) struct Observer {
    stack: Vec<Activation>,
    tasks: BTreeMap<u16, TaskTimes>,
    pub(crate) thread: Cycles,
    pub(crate) asleep: Cycles,
    switching: Cycles,
    /// What the core began to execute, and when; `None` while nobody wants to know.
    switches: Option<Vec<(Cycles, u16)>>,
}

/// What a step of the core did to the active exception.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Switch {
    /// The active exception did not change.
    None,
    /// An exception preempted the active one or thread mode.
    Enter(u16),
    /// The handler ended and another one followed without unstacking (tail-chaining).
    Chain(u16),
    /// The handler ended and the code that it had preempted continues.
    Return,
}

impl Observer {
    /// The active exception; 0 in thread mode.
    pub(crate) fn current(&self) -> u16 {
        self.stack.last().map_or(0, |top| top.exception)
    }

    /// The exception that the active one has preempted.
    pub(crate) fn below(&self) -> u16 {
        match self.stack.len() {
            0 | 1 => 0,
            n => self.stack[n - 2].exception,
        }
    }

    /// Accounts for a step of the core that ends at `now`: `own` cycles for the exception that was
    /// active before it, `overhead` cycles for switching.
    pub(crate) fn step(&mut self, now: Cycles, own: Cycles, overhead: Cycles, switch: Switch) {
        self.switching += overhead;
        match self.stack.last_mut() {
            Some(top) => top.own += own,
            None => self.thread += own,
        }
        match switch {
            Switch::None => return,
            Switch::Enter(exception) => self.enter(exception, now - overhead),
            Switch::Chain(exception) => {
                self.leave(now);
                self.enter(exception, now - overhead);
            }
            Switch::Return => self.leave(now),
        }
        self.note(now);
    }

    /// Notes from now on what the core executes.
    pub(crate) fn note_switches(&mut self) {
        self.switches.get_or_insert_default();
    }

    /// What the core began to execute since the last call.
    pub(crate) fn take_switches(&mut self) -> Vec<(Cycles, u16)> {
        self.switches.as_mut().map_or_else(Vec::new, mem::take)
    }

    fn note(&mut self, now: Cycles) {
        let current = self.current();
        if let Some(switches) = &mut self.switches {
            switches.push((now, current));
        }
    }

    fn enter(&mut self, exception: u16, at: Cycles) {
        if let Some(preempted) = self.stack.last_mut() {
            preempted.preemptions += 1;
        }
        self.stack.push(Activation {
            exception,
            entered: at,
            own: 0,
            preemptions: 0,
        });
    }

    fn leave(&mut self, now: Cycles) {
        if let Some(done) = self.stack.pop() {
            let task = self.tasks.entry(done.exception).or_default();
            task.activations += 1;
            task.total += done.own;
            task.longest = task.longest.max(done.own);
            let longest = task.by_preemptions.entry(done.preemptions).or_default();
            *longest = (*longest).max(done.own);
            task.longest_response = task.longest_response.max(now - done.entered);
        }
    }

    /// A reset discards all active exceptions.
    pub(crate) fn abandon(&mut self, now: Cycles) {
        self.stack.clear();
        self.note(now);
    }

    pub(crate) fn report(&self, image: &Image) -> Load {
        let tasks = self.tasks.iter().map(|(&exception, times)| TaskTimes {
            exception,
            name: image.handler(exception).map_or_else(String::new, |h| h.1),
            ..times.clone()
        });
        Load {
            tasks: tasks.collect(),
            thread: self.thread,
            asleep: self.asleep,
            switching: self.switching,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Observer, Switch};
    use crate::image::Image;
    use crate::part::Part;

    #[test]
    fn preemption_is_nobodys_own_time_but_everybodys_response() {
        let mut observer = Observer::default();
        observer.note_switches();
        observer.step(12, 0, 12, Switch::Enter(20));
        observer.step(22, 10, 0, Switch::None);
        observer.step(34, 0, 12, Switch::Enter(44));
        observer.step(64, 30, 0, Switch::None);
        observer.step(75, 1, 10, Switch::Return);
        assert_eq!(observer.current(), 20);
        observer.step(80, 5, 0, Switch::None);
        observer.step(87, 1, 6, Switch::Chain(21));
        observer.step(90, 3, 0, Switch::None);
        observer.step(101, 1, 10, Switch::Return);
        let load = observer.report(&Image::from_code(Part::F446, &[]).unwrap());
        let of = |n: u16| {
            let t = load.tasks.iter().find(|t| t.exception == n).unwrap();
            let alone = t.by_preemptions.get(&0).copied();
            (t.longest, alone, t.longest_response)
        };
        assert_eq!(of(20), (16, None, 87));
        assert_eq!(of(44), (31, Some(31), 53));
        assert_eq!(of(21), (4, Some(4), 20));
        assert_eq!(load.switching, 12 + 12 + 10 + 6 + 10);
        let switches = [(12, 20), (34, 44), (75, 20), (87, 21), (101, 0)];
        assert_eq!(observer.take_switches(), switches);
        observer.step(120, 0, 12, Switch::Enter(20));
        observer.abandon(130);
        assert_eq!(observer.take_switches(), [(120, 20), (130, 0)]);
    }
}
