//! One run of the abstract machine over a task.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use crate::bound::{Bound, End, Entry, PanicSite, Problem, Problems, Section};
use crate::cycles::Cycles;
use crate::execute::Executor;
use crate::facts::{Facts, To};
use crate::flash::{Accelerator, Reused};
use crate::graph::Targets;
use crate::lasting::{Memory, Words, reset_priorities};
use crate::layout::{STACK_TOP, leads_to_memory};
use crate::mask::Level;
use crate::part::Part;
use crate::program::Program;
use crate::register::Register;
use crate::state::State;
use crate::symbols::Symbols;
use crate::timing::Timings;
use crate::value::Value;

/// Return address of a task. There is no code at this address.
const RETURN: u32 = 0xffff_fff9;

/// Instructions that one analysis may run on the abstract machine.
const MAX_STEPS: u64 = 5_000_000;
/// The same, once there is a problem and so no bound any more.
const MAX_STEPS_WITH_PROBLEM: u64 = 2_000_000;

/// A function that is being executed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Frame {
    /// Its address.
    pub(super) function: u32,
    /// The address to which it returns, without the Thumb bit.
    pub(super) back: u32,
    /// The most bytes that it writes, if it copies, fills or encodes memory.
    pub(super) bytes: Option<u64>,
}

/// Ways out of a stretch of code: the state on each edge that leaves it.
pub(super) type Exits = Vec<(To, State)>;

/// Longest critical sections, by level and the address at which they begin.
pub(super) type Sections = BTreeMap<(Level, u32), Cycles>;

/// The results of a run.
#[derive(Debug)]
pub(super) struct Outcome {
    pub(super) bound: Bound,
    pub(super) memory: Memory,
    /// New targets of indirect jumps. If there are any, the bound does not count yet.
    pub(super) found: Targets,
}

/// A run in progress.
pub(super) struct Run<'r, 'a> {
    pub(super) program: &'r mut Program<'a>,
    pub(super) timings: Timings,
    pub(super) kind: Entry,
    pub(super) executor: Executor<'a>,
    /// Whether paths end where the first task can run.
    pub(super) until_start: bool,
    /// The call stack.
    pub(super) frames: Vec<Frame>,
    /// Instructions executed so far.
    pub(super) steps: u64,
    pub(super) found: Targets,
    /// Headers of loops for which no bound was found.
    pub(super) endless: BTreeSet<u32>,
    /// Lines that are taken to be at hand, and those of them in each critical section.
    pub(super) reused: Reused,
    pub(super) reused_in: BTreeMap<(Level, u32), Reused>,
    /// Lowest stack pointer.
    pub(super) lowest: u32,
    pub(super) uses_fpu: bool,
    pub(super) sections: Sections,
    pub(super) panics: BTreeSet<PanicSite>,
    /// Longest time of the paths that end without a return.
    pub(super) ended: Cycles,
    pub(super) facts: Facts,
    pub(super) annotated: BTreeMap<String, u64>,
    pub(super) summarised: BTreeMap<String, u64>,
    /// Most cycles of a turn that repeats a store-exclusive, as flashed.
    pub(super) retry: u64,
    /// Functions that call themselves, directly or not.
    pub(super) recursive: BTreeSet<u32>,
    /// How the paths end that do not return.
    pub(super) ends: BTreeSet<End>,
    pub(super) problems: Problems,
}

impl<'r, 'a> Run<'r, 'a> {
    pub(super) fn new(
        program: &'r mut Program<'a>,
        (part, timings): (Part, Timings),
        kind: Entry,
        memory: Memory,
    ) -> Self {
        let mut symbols = Symbols::new(program.image.variables());
        let executor = Executor {
            image: program.image,
            part,
            zeros: program.zeros.clone(),
            found_basepri: symbols.fresh(),
            found_primask: [symbols.fresh(), symbols.fresh()],
            symbols,
            reading: None,
            memory,
        };
        Self {
            program,
            timings,
            kind,
            executor,
            until_start: false,
            frames: Vec::new(),
            steps: 0,
            found: Targets::new(),
            endless: BTreeSet::new(),
            reused: Reused::default(),
            reused_in: BTreeMap::new(),
            lowest: STACK_TOP,
            uses_fpu: false,
            sections: Sections::new(),
            panics: BTreeSet::new(),
            ended: Cycles::ZERO,
            facts: Facts::default(),
            annotated: BTreeMap::new(),
            summarised: BTreeMap::new(),
            retry: 0,
            recursive: BTreeSet::new(),
            ends: BTreeSet::new(),
            problems: Problems::default(),
        }
    }

    /// Runs the code at `entry`, entered with these words in core registers.
    pub(super) fn whole(mut self, entry: u32, registers: &[(Register, u32)]) -> Outcome {
        let state = self.initial(registers);
        let last = self.function(entry, RETURN & !1, state);
        let returns = last.is_some();
        let returned = last.map_or(Cycles::ZERO, |mut last| {
            if self.kind == Entry::Handler {
                // The entry has been charged.
                let around = self.timings.around_handler(self.uses_fpu);
                last.spend(around - self.timings.exception_entry());
                self.end_handler(&last);
            }
            last.cycles
        });
        let ends = returns || self.ended != Cycles::ZERO || !self.problems.is_empty();
        if !ends && self.kind == Entry::Handler {
            self.report(Problem::Nowhere, entry);
        }
        let saved = match self.kind {
            Entry::Handler if self.uses_fpu => self.timings.save_floats(),
            _ => Cycles::ZERO,
        };
        let reads = self.timings.flashed.reads();
        let reload =
            |reused: Option<&Reused>| reads.zip(reused).map_or(0, |(reads, of)| reads.reload(of));
        let sections = self.sections.iter().map(|(&(level, at), &cycles)| Section {
            level,
            cycles: cycles + saved,
            reload: reload(self.reused_in.get(&(level, at))),
            at,
        });
        let memory = self.executor.into_memory();
        Outcome {
            bound: Bound {
                cycles: returned.max(self.ended),
                reload: reload(Some(&self.reused)),
                retry: self.retry,
                stack: STACK_TOP - self.lowest,
                uses_fpu: self.uses_fpu,
                sections: sections.collect(),
                panics: self.panics,
                pends: memory.pends.clone(),
                facts: self.facts,
                annotated: self.annotated,
                summarised: self.summarised,
                returns,
                ends: self.ends,
                problems: self.problems,
            },
            memory,
            found: self.found,
        }
    }

    /// Ends the critical sections that the return from a handler ends, and reports the others.
    fn end_handler(&mut self, last: &State) {
        for section in &last.masked {
            if section.level == Level::Faults {
                // The return clears `FAULTMASK` (DDI 0403 B1.4.3).
                let most = self.sections.entry((section.level, section.at));
                let most = most.or_default();
                *most = most.max(section.cycles);
            } else {
                self.report(Problem::StaysMasked, section.at);
            }
        }
    }

    /// The state at the first instruction.
    fn initial(&mut self, registers: &[(Register, u32)]) -> State {
        let mut state = State::entry(&mut self.executor.symbols, self.executor.found_basepri);
        state.flash = Accelerator::unknown(self.timings.flashed.reads());
        state.registers[Register::LR] = Value::constant(RETURN);
        for &(register, word) in registers {
            state.registers[register] = Value::constant(word);
        }
        match self.kind {
            Entry::Program => {
                state.started = false;
                state.basepri = Value::constant(0);
                let words = self.program.image.initial_words();
                let part = &self.executor.part;
                let words = words.filter(|(_, word)| leads_to_memory(part, *word));
                let mut words: Words = words.collect();
                if !part.core.has_basepri() {
                    words.extend(reset_priorities());
                }
                state.memory = Rc::new(words);
            }
            Entry::Handler | Entry::Fault => state.spend(self.timings.exception_entry()),
            Entry::Function => {}
        }
        state
    }

    /// Whether the limit of steps is reached.
    pub(super) fn exhausted(&self) -> bool {
        let most = if self.problems.is_empty() {
            MAX_STEPS
        } else {
            MAX_STEPS_WITH_PROBLEM
        };
        self.steps > most
    }

    /// The address to which the current function returns.
    pub(super) fn back(&self) -> u32 {
        self.frames.last().map_or(RETURN & !1, |frame| frame.back)
    }

    pub(super) fn describe(&self, address: u32) -> String {
        self.program.image.describe(address)
    }

    /// Adds a problem at `address`.
    pub(super) fn report(&mut self, problem: fn(String) -> Problem, address: u32) {
        let place = self.describe(address);
        self.problems.insert(problem(place));
    }

    /// Notes that the path with this clock ends without a return.
    pub(super) fn end_path(&mut self, cycles: Cycles) {
        self.ended = self.ended.max(cycles);
    }

    /// Joins a path with the one that arrived before it, if any.
    pub(super) fn join(&mut self, into: &mut Option<State>, state: State) {
        *into = Some(match into.take() {
            None => state,
            Some(before) => before.join(&state, &mut self.executor.symbols),
        });
    }

    /// Joins all paths.
    pub(super) fn join_all(&mut self, states: Vec<State>) -> Option<State> {
        let mut joined = None;
        for state in states {
            self.join(&mut joined, state);
        }
        joined
    }

    /// Adds a way out, joined with an earlier one along the same edge.
    pub(super) fn add_exit(&mut self, exits: &mut Exits, to: To, state: State) {
        match exits.iter().position(|(other, _)| *other == to) {
            Some(position) => {
                let mut slot = Some(exits.swap_remove(position).1);
                self.join(&mut slot, state);
                exits.extend(slot.map(|state| (to, state)));
            }
            None => exits.push((to, state)),
        }
    }
}
