//! Runs all paths of a task at once on the abstract machine.
//!
//! Calls are followed in place, so every call is analysed with the arguments
//! it has. Within one turn of a loop (and outside loops) paths that meet are
//! joined; turns are not, so a counter keeps its exact value and an inner
//! loop that runs to an outer counter is charged what each turn really costs.
//! The clock of a joined path is the longer of the two, which makes the clock
//! at the return a bound of the execution time.

use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::rc::Rc;

use rsemu::cpu::arm::v7m::isa::{Cond, Insn};

use super::annotation::Annotations;
use super::execute::Executor;
use super::graph::{Block, Graph, Returning, Targets, conditional, is_panic, leaves};
use super::image::{Image, Place};
use super::instruction::{Flow, Instruction};
use super::invariant::Invariant;
use super::ipet;
use super::lasting::{
    EVERYWHERE, Memory, Strangers, Words, Written, give_up, leads_to_memory, reach,
};
use super::range::Range;
use super::runtime;
use super::software;
use super::state::{Cycles, Masked, STACK_TOP, State, Symbols, longer};
use super::timing::Timing;
use super::value::Value;

/// Turns of one loop without an annotation before the analysis gives up.
const MAX_TURNS: u64 = 2_048;
/// Instructions that one analysis may run on the abstract machine.
const MAX_STEPS: u64 = 5_000_000;
/// The same once something else keeps a bound from being given.
const MAX_STEPS_IN_VAIN: u64 = 2_000_000;
/// Instructions after which the turns of a loop with a given bound are no
/// longer run one by one.
const STEPS_OF_LOOP: u64 = 6_000;
/// Instructions after which a loop without a given bound counts as unbounded.
const STEPS_OF_COUNTED_LOOP: u64 = 400_000;
/// Instructions of the whole analysis after which they never are.
const STEPS_TURN_BY_TURN: u64 = 600_000;
/// Targets of one indirect jump before it counts as unresolved.
const MAX_TARGETS: u64 = 1024;
/// Bytes of one copy that count as a bound of its loops.
const MAX_COPY: u64 = 4096;
/// Return address of a task: no code is there.
const RETURN: u32 = 0xffff_fff9;

/// How the analysed code is entered and left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Entry {
    /// As an exception handler: entry and return are charged.
    Handler,
    /// As a function: only its instructions are charged.
    Function,
    /// The program's start: loops are not required to end, and stretches with
    /// interrupts masked count from the first time they are enabled.
    Program,
}

/// What keeps a bound from being given.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Problem {
    /// No bound was found for a loop.
    #[error(
        "the loop at {0} has no bound: write `// loop-bound: N` on the line above it, N the most turns it takes"
    )]
    LoopWithoutBound(String),
    /// A function calls itself, directly or not.
    #[error("recursion: {0}; its depth, and so its time and stack, has no bound")]
    Recursion(String),
    /// A call or jump whose target is not known.
    #[error(
        "the call through a pointer at {0} may go anywhere: call the function by name, or choose it from a constant table"
    )]
    UnboundedPointer(String),
    /// Control reaches something that is no instruction.
    #[error("control reaches {0}, which is no instruction of this core")]
    NotCode(String),
    /// The interrupt mask was set to something unknown.
    #[error("the interrupt mask is set to an unknown level at {0}")]
    UnknownMask(String),
    /// The stack pointer was set to something unknown.
    #[error("the stack pointer is unknown after {0}")]
    UnknownStack(String),
    /// The analysis ran out of its budget.
    #[error("{0} takes too many steps to analyse: bound its loops by annotations")]
    TooLong(String),
    /// No such function.
    #[error("the image has no function {0}")]
    Missing(String),
}

/// A place from which control goes to the panic handler and never returns.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct PanicSite {
    /// Address of the call.
    pub at: u32,
    /// What it calls.
    pub callee: String,
}

/// Where an edge of the control flow leads.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum To {
    /// A block of the same function.
    Block(usize),
    /// Back to the caller.
    Return,
    /// Nowhere: the path ends.
    End,
}

/// A block of a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Node {
    /// The function's address.
    pub function: u32,
    /// The block's number in its graph.
    pub block: usize,
}

/// What the paths have in common, for the integer program and for checks.
#[derive(Debug, Default, Clone)]
pub struct Facts {
    /// Most executions of each block that was reached.
    pub visits: BTreeMap<Node, u64>,
    /// Most cycles of one execution of a block, its callees excluded.
    pub costs: BTreeMap<Node, Cycles>,
    /// Most traversals of each edge.
    pub edges: BTreeMap<(Node, To), u64>,
    /// Cycles of an edge beyond its block.
    pub edge_costs: BTreeMap<(Node, To), Cycles>,
    /// Most calls of each callee from each block.
    pub calls: BTreeMap<(Node, u32), u64>,
    /// Most turns of a loop for one entry, by its header.
    pub turns: BTreeMap<Node, u64>,
    /// Most executions of a block in one activation, by annotations.
    pub most: BTreeMap<Node, u64>,
}

impl Facts {
    /// Takes in what was learnt of a stretch that runs `times` times.
    fn add(&mut self, other: Self, times: u64) {
        for (node, visits) in other.visits {
            *self.visits.entry(node).or_default() += visits * times;
        }
        for (edge, count) in other.edges {
            *self.edges.entry(edge).or_default() += count * times;
        }
        for (call, count) in other.calls {
            *self.calls.entry(call).or_default() += count * times;
        }
        for (node, cost) in other.costs {
            let most = self.costs.entry(node).or_default();
            *most = longer(*most, cost);
        }
        for (edge, cost) in other.edge_costs {
            let most = self.edge_costs.entry(edge).or_default();
            *most = longer(*most, cost);
        }
        for (node, turns) in other.turns {
            let most = self.turns.entry(node).or_default();
            *most = turns.max(*most);
        }
    }
}

/// The longest stretch with interrupts masked from one place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Section {
    /// `BASEPRI` while it lasts, zero for `PRIMASK`.
    pub level: u8,
    /// Longest time.
    pub cycles: Cycles,
    /// Address of the instruction that masks.
    pub at: u32,
}

/// The result for one task.
#[derive(Debug, Clone)]
pub struct Bound {
    /// Longest time of one execution.
    pub cycles: Cycles,
    /// Deepest stack below its value on entry, in bytes; exception frames
    /// and panic paths not included.
    pub stack: u32,
    /// Whether a floating-point instruction may be executed.
    pub uses_fpu: bool,
    /// Stretches with interrupts masked.
    pub sections: Vec<Section>,
    /// Panics that the image does not prove impossible.
    pub panics: BTreeSet<PanicSite>,
    /// Flow facts.
    pub facts: Facts,
    /// Bounds taken from annotations, by the loop's first line.
    pub annotated: BTreeMap<String, u64>,
    /// Why the figures above are no bound; empty when they are.
    pub problems: BTreeSet<Problem>,
}

/// Analyses tasks of one image.
#[derive(Debug)]
pub struct Analysis<'a> {
    image: &'a Image,
    annotations: &'a Annotations,
    timings: [Timing; 2],
    targets: Targets,
    returning: Returning,
    graphs: HashMap<u32, Rc<Graph>>,
    /// Functions that are not entered.
    never: BTreeSet<u32>,
    lasting: Rc<Words>,
    known: HashMap<(u32, Entry), Bound>,
}

impl<'a> Analysis<'a> {
    /// Prepares the analysis of `image` with the flash of `part`.
    #[must_use]
    pub fn new(image: &'a Image, annotations: &'a Annotations, part: Timing) -> Self {
        Self {
            image,
            annotations,
            timings: [Timing::zero_wait(), part],
            targets: Targets::new(),
            returning: Returning::default(),
            graphs: HashMap::new(),
            never: BTreeSet::new(),
            lasting: Rc::default(),
            known: HashMap::new(),
        }
    }

    /// Finds the words that start-up from `main` leaves in memory for good,
    /// which are taken for granted from then on. `handlers` are all there are.
    ///
    /// Where that proves nothing of any word, stores through pointers of which
    /// nothing is known are counted as [`Strangers`] says.
    pub fn learn(&mut self, main: u32, handlers: &[u32], strangers: Strangers) -> &Words {
        let unfollowed = |bound: &Bound| {
            let mut problems = bound.problems.iter();
            problems.any(|problem| !matches!(problem, Problem::LoopWithoutBound(_)))
        };
        let (program, memory) = self.explore(main, Entry::Program, &[]);
        let lost = memory.lost || unfollowed(&program);
        self.known.insert((main, Entry::Program), program);
        let mut words = match memory.left {
            Some(words) if !lost => words,
            _ => return &self.lasting,
        };
        give_up(&mut words, &memory.written);
        let mut spared = (strangers == Strangers::Spare).then(|| words.clone());
        let mut sparing = false;
        loop {
            self.lasting = Rc::new(words.clone());
            let mut written = Written::new();
            let mut lost = false;
            for &handler in handlers {
                let (bound, memory) = self.explore(handler, Entry::Handler, &[]);
                lost |= unfollowed(&bound);
                written.extend(memory.written);
                self.known.insert((handler, Entry::Handler), bound);
            }
            if sparing {
                written.remove(&EVERYWHERE);
            }
            if lost {
                written.insert(EVERYWHERE);
            }
            let fewer = give_up(&mut words, &written);
            match spared.take_if(|_| fewer && words.is_empty() && !lost) {
                Some(all) => (words, sparing) = (all, true),
                None if fewer => {}
                None => return &self.lasting,
            }
        }
    }

    /// Bounds the code at `entry`.
    pub fn run(&mut self, entry: u32, kind: Entry) -> Bound {
        match self.known.get(&(entry, kind)) {
            Some(bound) => bound.clone(),
            None => self.run_with(entry, kind, &[]),
        }
    }

    /// Bounds the code at `entry` for executions that never enter any of these
    /// functions.
    pub fn run_without(&mut self, entry: u32, kind: Entry, never: &BTreeSet<u32>) -> Bound {
        self.never.clone_from(never);
        let bound = self.run_with(entry, kind, &[]);
        self.never.clear();
        bound
    }

    /// Bounds the code at `entry` when it is entered with these words in core
    /// registers (0..=12).
    pub fn run_with(&mut self, entry: u32, kind: Entry, registers: &[(u8, u32)]) -> Bound {
        self.explore(entry, kind, registers).0
    }

    /// Bounds the code at `entry` and says what it did to memory.
    fn explore(&mut self, entry: u32, kind: Entry, registers: &[(u8, u32)]) -> (Bound, Memory) {
        // Jump tables are found on the way; the flow is rebuilt with their
        // targets until there are no new ones.
        loop {
            let mut run = Run {
                analysis: self,
                executor: None,
                kind,
                frames: Vec::new(),
                steps: 0,
                found: Targets::new(),
                endless: BTreeSet::new(),
                lowest: STACK_TOP,
                uses_fpu: false,
                sections: BTreeMap::new(),
                panics: BTreeSet::new(),
                ended: [0; 2],
                facts: Facts::default(),
                annotated: BTreeMap::new(),
                problems: BTreeSet::new(),
            };
            let result = run.whole(entry, registers);
            let found = std::mem::take(&mut run.found);
            let ended = run.ended;
            let memory = run
                .executor
                .take()
                .map(Executor::into_memory)
                .unwrap_or_default();
            let bound = Bound {
                cycles: longer(result.unwrap_or([0; 2]), ended),
                stack: STACK_TOP - run.lowest,
                uses_fpu: run.uses_fpu,
                sections: run
                    .sections
                    .iter()
                    .map(|(&(level, at), &cycles)| Section { level, cycles, at })
                    .collect(),
                panics: std::mem::take(&mut run.panics),
                facts: std::mem::take(&mut run.facts),
                annotated: std::mem::take(&mut run.annotated),
                problems: std::mem::take(&mut run.problems),
            };
            if found.is_empty() {
                return (self.tightened(bound, entry, kind), memory);
            }
            for (jump, targets) in found {
                self.targets.entry(jump).or_default().extend(targets);
            }
            self.graphs.clear();
        }
    }

    /// Takes account of what is annotated for a whole activation, which only
    /// the integer program knows how to use.
    fn tightened(&mut self, mut bound: Bound, entry: u32, kind: Entry) -> Bound {
        if kind == Entry::Program || !bound.problems.is_empty() {
            return bound;
        }
        let nodes: Vec<Node> = bound.facts.visits.keys().copied().collect();
        for node in nodes {
            let Some(graph) = self.graph(node.function) else {
                continue;
            };
            let found = self.annotations.at_most(self.image, &graph, node.block);
            if let Some((place, most)) = found {
                bound.facts.most.insert(node, most);
                let name = format!("{place}, in all");
                bound.annotated.insert(name, most);
            }
        }
        if bound.facts.most.is_empty() {
            return bound;
        }
        if let Some(longest) = ipet::solve(self, &bound, entry) {
            for model in 0..2 {
                let exceptions = self.timings[model].exceptions();
                let around = match kind {
                    Entry::Handler => exceptions.entry + exceptions.exit,
                    Entry::Function | Entry::Program => 0,
                };
                let whole = longest.cycles[model] + around;
                bound.cycles[model] = bound.cycles[model].min(whole);
                // A stretch of the activation is no longer than the whole.
                for section in &mut bound.sections {
                    section.cycles[model] = section.cycles[model].min(bound.cycles[model]);
                }
            }
        }
        bound
    }

    /// The control flow of the function at `entry`, as far as it is known.
    pub fn graph(&mut self, entry: u32) -> Option<Rc<Graph>> {
        if let Some(graph) = self.graphs.get(&entry) {
            return Some(graph.clone());
        }
        let graph =
            Rc::new(Graph::build(self.image, entry, &self.targets, &mut self.returning).ok()?);
        self.graphs.insert(entry, graph.clone());
        Some(graph)
    }

    /// The annotated bound of loop `number` of `graph`, with the loop's place.
    #[must_use]
    pub fn annotation(&self, graph: &Graph, number: usize) -> Option<(Place, u64)> {
        self.annotations.bound(self.image, graph, number)
    }

    /// The image under analysis.
    #[must_use]
    pub fn image(&self) -> &'a Image {
        self.image
    }

    /// Exception costs under each timing model.
    #[must_use]
    pub fn timings(&self) -> &[Timing; 2] {
        &self.timings
    }
}

struct Run<'r, 'a> {
    analysis: &'r mut Analysis<'a>,
    executor: Option<Executor<'a>>,
    kind: Entry,
    /// Functions being executed, the address each returns to, and how many
    /// bytes it writes if it copies or fills memory.
    frames: Vec<(u32, u32, Option<u64>)>,
    steps: u64,
    found: Targets,
    endless: BTreeSet<u32>,
    lowest: u32,
    uses_fpu: bool,
    sections: BTreeMap<(u8, u32), Cycles>,
    panics: BTreeSet<PanicSite>,
    ended: Cycles,
    facts: Facts,
    annotated: BTreeMap<String, u64>,
    problems: BTreeSet<Problem>,
}

/// Ways out of a region: states by where they go.
type Exits = Vec<(To, State)>;

impl<'a> Run<'_, 'a> {
    fn whole(&mut self, entry: u32, registers: &[(u8, u32)]) -> Option<Cycles> {
        let mut symbols = Symbols::of(self.analysis.image.variables());
        let mut state = State::entry(&mut symbols);
        state.registers[14] = Value::constant(RETURN);
        for &(register, word) in registers {
            state.registers[usize::from(register)] = Value::constant(word);
        }
        if self.kind == Entry::Program {
            state.started = false;
            let words = self.analysis.image.initial_words();
            state.memory = Rc::new(words.filter(|(_, word)| leads_to_memory(*word)).collect());
        }
        if self.kind == Entry::Handler {
            let costs = self
                .analysis
                .timings
                .map(|timing| timing.exceptions().entry);
            state.spend(costs);
        }
        self.executor = Some(Executor {
            image: self.analysis.image,
            symbols,
            memory: Memory {
                lasting: self.analysis.lasting.clone(),
                ..Memory::default()
            },
        });
        let mut last = self.function(entry, RETURN & !1, state)?;
        if self.kind == Entry::Handler {
            let costs = self.analysis.timings.map(|timing| timing.exceptions().exit);
            last.spend(costs);
        }
        Some(last.cycles)
    }

    fn executor(&mut self) -> &mut Executor<'a> {
        // Set before anything is executed.
        self.executor.as_mut().expect("an executor is in place")
    }

    fn exhausted(&self) -> bool {
        self.steps > MAX_STEPS || self.steps > MAX_STEPS_IN_VAIN && !self.problems.is_empty()
    }

    fn describe(&self, address: u32) -> String {
        self.analysis.image.describe(address)
    }

    fn join(&mut self, into: &mut Option<State>, state: State) {
        *into = Some(match into.take() {
            None => state,
            Some(before) => before.join(&state, &mut self.executor().symbols),
        });
    }

    /// Runs the function at `entry` to its return.
    fn function(&mut self, entry: u32, back: u32, state: State) -> Option<State> {
        if self.frames.iter().any(|(function, ..)| *function == entry) {
            let from = self
                .frames
                .iter()
                .position(|(f, ..)| *f == entry)
                .unwrap_or(0);
            let names: Vec<String> = self.frames[from..]
                .iter()
                .map(|(f, ..)| self.analysis.image.name(*f))
                .chain([self.analysis.image.name(entry)])
                .collect();
            self.problems
                .insert(Problem::Recursion(names.join(" calls ")));
            return None;
        }
        let Some(graph) = self.analysis.graph(entry) else {
            self.problems.insert(Problem::NotCode(self.describe(entry)));
            return None;
        };
        let bytes = runtime::length_register(&self.analysis.image.name(entry))
            .map(|register| u64::from(state.registers[register].range.unsigned().1))
            .map(|bytes| match self.frames.last() {
                // One that hands over to another leaves it no more.
                Some((.., Some(outer))) => bytes.min(*outer),
                Some((caller, ..)) => {
                    let most = runtime::most_copied(&self.analysis.image.name(*caller));
                    most.map_or(bytes, |most| bytes.min(most))
                }
                None => bytes,
            })
            .filter(|bytes| *bytes <= MAX_COPY);
        let outer = self.executor().memory.target;
        let length = runtime::writes_from_first(&self.analysis.image.name(entry));
        if let (None, Some(length)) = (outer, length) {
            // It writes what it is told to and nothing else.
            let most = state.registers[length].range.unsigned().1.max(1);
            let executor = self.executor();
            let to = reach(&executor.symbols, &state.registers[0], most);
            executor.memory.target = Some(to);
        }
        let saved = length.map(|_| state.registers);
        self.frames.push((entry, back, bytes));
        let (exits, _) = self.region(&graph, None, 0, state);
        self.frames.pop();
        self.executor().memory.target = outer;
        let mut returned = None;
        for (to, state) in exits {
            if to == To::Return {
                self.join(&mut returned, state);
            }
        }
        // What writes through pointers of its own gives back what it saved.
        if let (Some(state), Some(saved)) = (&mut returned, saved) {
            state.registers[4..12].copy_from_slice(&saved[4..12]);
        }
        returned
    }

    /// Runs one turn of a loop, or the whole function, from `start`. Returns
    /// the ways out and the state that comes back to the first block.
    fn region(
        &mut self,
        graph: &Rc<Graph>,
        region: Option<usize>,
        start: usize,
        state: State,
    ) -> (Exits, Option<State>) {
        let header = region.map_or(0, |number| graph.loops[number].header);
        let inside =
            |block: usize| region.is_none_or(|number| graph.loops[number].blocks.contains(&block));
        let mut waiting: BTreeMap<usize, State> = BTreeMap::from([(start, state)]);
        let mut exits = Exits::new();
        let mut back = None;
        while let Some((block, state)) = waiting.pop_first() {
            let leaving = match graph.child_loop(region, block) {
                Some(child) if Some(child) != region => self.turns(graph, child, block, state),
                _ => self.block(graph, block, state),
            };
            for (to, state) in leaving {
                match to {
                    To::Block(next) if next == header && region.is_some() => {
                        self.join(&mut back, state);
                    }
                    To::Block(next) if inside(next) => {
                        let mut slot = waiting.remove(&next);
                        self.join(&mut slot, state);
                        waiting.extend(slot.map(|state| (next, state)));
                    }
                    _ => match exits.iter().position(|(other, _)| *other == to) {
                        Some(position) => {
                            let mut slot = Some(exits.swap_remove(position).1);
                            self.join(&mut slot, state);
                            exits.extend(slot.map(|state| (to, state)));
                        }
                        None => exits.push((to, state)),
                    },
                }
            }
        }
        (exits, back)
    }

    /// The bound of a loop that is known without running it, and where from.
    fn given_bound(&mut self, graph: &Graph, number: usize) -> Option<u64> {
        let image = self.analysis.image;
        let (place, bound) = self
            .analysis
            .annotations
            .bound(image, graph, number)
            .map(|(place, bound)| (place.to_string(), bound))
            .or_else(|| {
                runtime::bound(image, graph, number)
                    .or_else(|| software::bound(image, graph, number))
                    .map(|(what, bound)| (what.to_owned(), bound))
            })
            .or_else(|| {
                let bytes = self.frames.last().and_then(|(.., bytes)| *bytes)?;
                let what = format!("{}, by its length", image.name(graph.entry));
                Some((what, runtime::copying(graph, number, bytes)))
            })?;
        let most = self.annotated.entry(place).or_default();
        *most = (*most).max(bound);
        Some(bound)
    }

    /// Runs a loop that is entered at `start` turn by turn until nothing
    /// stays inside; where its bound is given and that takes long, the turns
    /// that remain are charged at the cost of the worst of them.
    fn turns(&mut self, graph: &Rc<Graph>, number: usize, start: usize, state: State) -> Exits {
        let header = graph.loops[number].header;
        let node = Node {
            function: graph.entry,
            block: header,
        };
        let at = graph.blocks[header].start();
        let image = self.analysis.image;
        let bound = self.given_bound(graph, number);
        let begin = self.steps;
        let limit = begin
            + if self.steps > STEPS_TURN_BY_TURN {
                0
            } else {
                STEPS_OF_LOOP
            };
        let mut all = Exits::new();
        let mut first = state;
        let mut start = start;
        let mut turns = 0;
        loop {
            let (exits, back) = self.region(graph, Some(number), start, first.clone());
            self.merge(&mut all, exits);
            let Some(next) = back else { break };
            let entered = start == header;
            start = header;
            turns += 1;
            if bound.is_some_and(|bound| turns > bound) {
                break;
            }
            let mut given = match bound {
                Some(bound) => Some(bound - turns),
                // What the start-up code waits for is not counted.
                None if self.kind == Entry::Program => Some(0),
                None => None,
            };
            if bound.is_none() && self.kind != Entry::Program {
                let stuck = entered && first.same_machine(&next);
                let most = if self.problems.is_empty() {
                    STEPS_OF_COUNTED_LOOP
                } else {
                    STEPS_OF_LOOP
                };
                let long = turns > MAX_TURNS || self.steps - begin > most;
                if stuck || long || self.endless.contains(&at) {
                    self.endless.insert(at);
                    let source = self.analysis.annotations.source_loop(image, graph, number);
                    self.problems
                        .insert(Problem::LoopWithoutBound(match source {
                            Some(place) => format!("{place} ({})", image.name(at)),
                            None => self.describe(at),
                        }));
                    // Go on, to find what else is wrong.
                    given = Some(0);
                }
            }
            if let Some(remaining) = given
                && entered
                && (self.steps > limit || bound.is_none())
            {
                let exits = self.remaining_turns(graph, number, &first, next, remaining, bound);
                self.merge(&mut all, exits);
                turns += remaining;
                break;
            }
            first = next;
        }
        let most = self.facts.turns.entry(node).or_default();
        *most = turns.max(*most);
        all
    }

    fn merge(&mut self, all: &mut Exits, exits: Exits) {
        for (to, state) in exits {
            match all.iter().position(|(other, _)| *other == to) {
                Some(position) => {
                    let mut slot = Some(all.swap_remove(position).1);
                    self.join(&mut slot, state);
                    all.extend(slot.map(|state| (to, state)));
                }
                None => all.push((to, state)),
            }
        }
    }

    /// Runs one turn that stands for every further turn of a loop whose last
    /// turn led from `before` to `next`, and charges `remaining` of them.
    fn remaining_turns(
        &mut self,
        graph: &Rc<Graph>,
        number: usize,
        before: &State,
        next: State,
        remaining: u64,
        bound: Option<u64>,
    ) -> Exits {
        let header = graph.loops[number].header;
        // Without a bound there may be any number of turns, though none of them
        // is charged.
        let reach = bound.map_or(u64::MAX, |_| remaining);
        let mut invariant = Invariant::guess(before, next, reach, &mut self.executor().symbols);
        loop {
            let first = invariant.state().clone();
            let facts = std::mem::take(&mut self.facts);
            let sections = std::mem::take(&mut self.sections);
            let ended = std::mem::take(&mut self.ended);
            let (exits, back) = self.region(graph, Some(number), header, first.clone());
            let inner_facts = std::mem::replace(&mut self.facts, facts);
            let inner_sections = std::mem::replace(&mut self.sections, sections);
            let inner_ended = std::mem::replace(&mut self.ended, ended);
            if let Some(back) = &back
                && !self.exhausted()
                && !invariant.holds(back, &mut self.executor().symbols)
            {
                continue;
            }
            let turn = back.map_or([0; 2], |back| difference(back.cycles, first.cycles));
            let extra = turn.map(|cycles| cycles * remaining);
            self.facts.add(inner_facts, remaining + 1);
            let held = |level: u8| first.masked.iter().any(|mask| mask.level == level);
            for ((level, at), cycles) in inner_sections {
                let most = self.sections.entry((level, at)).or_default();
                let cycles = if held(level) {
                    sum(cycles, extra)
                } else {
                    cycles
                };
                *most = longer(*most, cycles);
            }
            if inner_ended != [0; 2] {
                self.ended = longer(self.ended, sum(inner_ended, extra));
            }
            return exits
                .into_iter()
                .map(|(to, mut state)| {
                    state.cycles = sum(state.cycles, extra);
                    for mask in state.masked.iter_mut().filter(|mask| held(mask.level)) {
                        mask.cycles = sum(mask.cycles, extra);
                    }
                    (to, state)
                })
                .collect();
        }
    }

    /// Runs one block and what it calls.
    fn block(&mut self, graph: &Rc<Graph>, number: usize, state: State) -> Exits {
        let block = &graph.blocks[number];
        let node = Node {
            function: graph.entry,
            block: number,
        };
        *self.facts.visits.entry(node).or_default() += 1;
        if self.exhausted() {
            if !self
                .problems
                .iter()
                .any(|problem| matches!(problem, Problem::TooLong(_)))
            {
                self.problems
                    .insert(Problem::TooLong(self.describe(block.start())));
            }
            return Exits::new();
        }
        let before = state.cycles;
        let mut skipping: Option<State> = None;
        let mut states = vec![state];
        let (body, last) = block.instructions.split_at(block.instructions.len() - 1);
        let last = &last[0];
        for instruction in body {
            states = self.step(states, instruction);
        }
        let flow = last.flow();
        let plain = flow == Flow::Next;
        if plain {
            states = self.step(states, last);
        } else if conditional(last) {
            let mut taken = Vec::new();
            for state in states {
                let (yes, no) = split(&state, last.condition);
                taken.extend(yes);
                if let Some(mut no) = no {
                    self.fetch(&mut no, last, true);
                    self.join(&mut skipping, no);
                }
            }
            states = taken;
        }
        // A branch goes on with what each of the conditions before it left.
        if !matches!(flow, Flow::Branch { .. }) {
            let mut joined = None;
            for state in states {
                self.join(&mut joined, state);
            }
            states = joined.into_iter().collect();
        }
        let mut exits = Exits::new();
        let mut cost = [0; 2];
        if let Some(state) = &skipping {
            cost = longer(cost, difference(state.cycles, before));
        }
        let straight = graph.block_at(last.next());
        if let Some(state) = skipping
            && let Some(next) = straight
        {
            exits.push((To::Block(next), state));
        }
        for mut state in states {
            if !plain {
                let target = self.charge(&mut state, last);
                cost = longer(cost, difference(state.cycles, before));
                self.leave(graph, node, block, state, target, &mut exits);
            } else {
                cost = longer(cost, difference(state.cycles, before));
                if let Some(next) = straight {
                    exits.push((To::Block(next), state));
                }
            }
        }
        let most = self.facts.costs.entry(node).or_default();
        *most = longer(*most, cost);
        let ways: BTreeSet<To> = exits.iter().map(|(to, _)| *to).collect();
        for to in ways {
            *self.facts.edges.entry((node, to)).or_default() += 1;
            self.facts.edge_costs.entry((node, to)).or_default();
        }
        exits
    }

    /// Executes an instruction that control leaves straight.
    fn step(&mut self, mut states: Vec<State>, instruction: &Instruction) -> Vec<State> {
        if instruction.condition.is_none() && states.len() > 1 {
            let mut joined = None;
            for state in states {
                self.join(&mut joined, state);
            }
            states = joined.into_iter().collect();
        }
        let mut after = Vec::with_capacity(states.len());
        for state in states {
            if conditional(instruction) {
                let (yes, no) = split(&state, instruction.condition);
                if let Some(mut yes) = yes {
                    self.charge(&mut yes, instruction);
                    after.push(yes);
                }
                if let Some(mut no) = no {
                    self.fetch(&mut no, instruction, true);
                    after.push(no);
                }
            } else {
                let mut state = state;
                self.charge(&mut state, instruction);
                after.push(state);
            }
        }
        after
    }

    /// Charges the fetch of an instruction, and its one cycle if skipped.
    fn fetch(&mut self, state: &mut State, instruction: &Instruction, skipped: bool) {
        let mut cycles = [0; 2];
        for (timing, cycles) in self.analysis.timings.iter().zip(&mut cycles) {
            let (fetch, line) = timing.fetch(instruction.address, instruction.size, state.line);
            *cycles = fetch + if skipped { timing.skipped() } else { 0 };
            if !timing.is_zero_wait() {
                state.line = line;
            }
        }
        if skipped {
            state.written = 0;
        }
        state.spend(cycles);
    }

    /// Executes and charges one instruction; the words it may write to the
    /// program counter are returned.
    fn charge(&mut self, state: &mut State, instruction: &Instruction) -> Option<Value> {
        self.steps += 1;
        self.fetch(state, instruction, false);
        // What ends with the first enabling began with the reset.
        let started = state.started;
        let effects = self.executor().execute(state, instruction);
        let mut cycles = [0; 2];
        for (timing, cycles) in self.analysis.timings.iter().zip(&mut cycles) {
            *cycles = timing.instruction(instruction, effects.access.as_ref(), state.written);
            if effects
                .access
                .as_ref()
                .is_some_and(|access| timing.reads_flash(access))
            {
                state.line = None;
            }
        }
        state.spend(cycles);
        state.written = instruction.written();
        for mask in effects.unmasked {
            let ended = Masked {
                cycles: [mask.cycles[0] + cycles[0], mask.cycles[1] + cycles[1]],
                ..mask
            };
            if started {
                let most = self.sections.entry((ended.level, ended.at)).or_default();
                *most = longer(*most, ended.cycles);
            }
        }
        if effects.unknown_mask {
            self.problems
                .insert(Problem::UnknownMask(self.describe(instruction.address)));
        }
        self.uses_fpu |= instruction.uses_fpu();
        match state.stack_pointer() {
            Some(pointer) => self.lowest = self.lowest.min(pointer),
            None => {
                let range = state.registers[13].range;
                if range.span() < 0x1_0000 {
                    // Aligned down by an unknown amount: the lowest counts.
                    self.lowest = self.lowest.min(range.start());
                } else {
                    self.problems
                        .insert(Problem::UnknownStack(self.describe(instruction.address)));
                }
            }
        }
        effects.target
    }

    fn refill(&mut self, state: &mut State, target: Option<u32>) {
        let cycles = self.analysis.timings.map(|timing| timing.taken());
        state.spend(cycles);
        state.written = u16::MAX;
        state.line = target.and_then(|target| self.analysis.timings[1].line_at(target));
    }

    /// Follows the last instruction of a block to wherever it may lead.
    fn leave(
        &mut self,
        graph: &Rc<Graph>,
        node: Node,
        block: &Block,
        state: State,
        written: Option<Value>,
        exits: &mut Exits,
    ) {
        let last = block.last();
        let straight = graph.block_at(last.next());
        match last.flow() {
            Flow::Next => {}
            Flow::Branch { condition, target } => {
                let (yes, no) = match (condition, last.insn) {
                    (Some(_), _) => split(&state, condition),
                    (None, Insn::Cbz { nonzero, rn, .. }) => {
                        let (zero, other) = compare_zero(&state, rn);
                        if nonzero {
                            (other, zero)
                        } else {
                            (zero, other)
                        }
                    }
                    _ => (Some(state.clone()), Some(state)),
                };
                if let (Some(no), Some(next)) = (no, straight) {
                    exits.push((To::Block(next), no));
                }
                if let Some(yes) = yes {
                    self.jump(graph, node, yes, target, last.address, exits);
                }
            }
            Flow::Jump { target } => self.jump(graph, node, state, target, last.address, exits),
            Flow::Call { target } => {
                self.call(graph, node, state, &[target], last, straight, exits);
            }
            Flow::CallRegister { .. } => {
                let targets = written
                    .and_then(|value| enumerate(&self.executor().symbols, &value))
                    .or_else(|| self.pointees(graph.entry));
                match targets {
                    Some(targets) if targets.iter().all(|t| self.analysis.image.is_code(*t)) => {
                        self.call(graph, node, state, &targets, last, straight, exits);
                    }
                    _ => {
                        self.problems
                            .insert(Problem::UnboundedPointer(self.describe(last.address)));
                        // Go on as if it had returned, to find what else is
                        // wrong.
                        if let Some(next) = straight {
                            let mut state = state;
                            self.forget_scratch(&mut state);
                            exits.push((To::Block(next), state));
                        }
                    }
                }
            }
            Flow::Indirect => self.indirect(graph, node, state, written, last, exits),
            Flow::Stop => {
                self.panics.insert(PanicSite {
                    at: last.address,
                    callee: "an undefined instruction".to_owned(),
                });
                self.ended = longer(self.ended, state.cycles);
            }
        }
    }

    /// Where a call in the function at `entry` may go through a pointer that nothing is
    /// known of.
    fn pointees(&self, entry: u32) -> Option<Vec<u32>> {
        let targets = software::targets(self.analysis.image, entry)?;
        Some(targets.into_iter().collect())
    }

    fn forget_scratch(&mut self, state: &mut State) {
        for register in [0, 1, 2, 3, 12, 14] {
            state.registers[register] = Value {
                base: Some((self.executor().symbols.fresh(), Range::constant(0))),
                ..Value::ANY
            };
        }
    }

    /// A direct jump, within the function or to another one.
    fn jump(
        &mut self,
        graph: &Rc<Graph>,
        node: Node,
        mut state: State,
        target: u32,
        from: u32,
        exits: &mut Exits,
    ) {
        let before = state.cycles;
        self.refill(&mut state, Some(target));
        let refill = difference(state.cycles, before);
        if leaves(self.analysis.image, graph.entry, target) {
            let back = self.frames.last().map_or(RETURN & !1, |(_, back, _)| *back);
            if let Some(state) = self.enter(node, from, target, back, state) {
                self.note(node, To::Return, refill);
                exits.push((To::Return, state));
            } else {
                self.note(node, To::End, refill);
            }
            return;
        }
        match graph.block_at(target) {
            Some(next) => {
                self.note(node, To::Block(next), refill);
                exits.push((To::Block(next), state));
            }
            None => {
                self.problems
                    .insert(Problem::NotCode(self.describe(target)));
            }
        }
    }

    fn note(&mut self, node: Node, to: To, cycles: Cycles) {
        let cost = self.facts.edge_costs.entry((node, to)).or_default();
        *cost = longer(*cost, cycles);
        if to == To::End {
            *self.facts.edges.entry((node, to)).or_default() += 1;
        }
    }

    #[allow(clippy::too_many_arguments)]
    fn call(
        &mut self,
        _graph: &Rc<Graph>,
        node: Node,
        state: State,
        targets: &[u32],
        last: &Instruction,
        straight: Option<usize>,
        exits: &mut Exits,
    ) {
        let mut returned = None;
        for &target in targets {
            let mut state = state.clone();
            let before = state.cycles;
            self.refill(&mut state, Some(target));
            let refill = difference(state.cycles, before);
            match straight {
                Some(next) => self.note(node, To::Block(next), refill),
                None => self.note(node, To::End, refill),
            }
            if let Some(state) = self.enter(node, last.address, target, last.next(), state) {
                self.join(&mut returned, state);
            }
        }
        match (returned, straight) {
            (Some(state), Some(next)) => exits.push((To::Block(next), state)),
            (Some(_), None) => {
                self.problems
                    .insert(Problem::NotCode(self.describe(last.next())));
            }
            (None, _) => {
                let cost = straight.map_or([0; 2], |next| {
                    self.facts
                        .edge_costs
                        .get(&(node, To::Block(next)))
                        .copied()
                        .unwrap_or_default()
                });
                self.note(node, To::End, cost);
            }
        }
    }

    /// Enters a function from `from`; `None` if it never returns.
    fn enter(
        &mut self,
        node: Node,
        from: u32,
        target: u32,
        back: u32,
        state: State,
    ) -> Option<State> {
        if self.analysis.never.contains(&target) {
            return None;
        }
        let name = self.analysis.image.name(target);
        if is_panic(&name) {
            self.panics.insert(PanicSite {
                at: from,
                callee: name,
            });
            self.ended = longer(self.ended, state.cycles);
            return None;
        }
        *self.facts.calls.entry((node, target)).or_default() += 1;
        self.function(target, back, state)
    }

    /// A return, a jump table or a tail call through a register.
    fn indirect(
        &mut self,
        graph: &Rc<Graph>,
        node: Node,
        mut state: State,
        written: Option<Value>,
        last: &Instruction,
        exits: &mut Exits,
    ) {
        let back = self.frames.last().map_or(RETURN & !1, |(_, back, _)| *back);
        let target = written.unwrap_or(Value::ANY);
        let before = state.cycles;
        let by_convention = match last.insn {
            Insn::Bx { rm } => rm == 14,
            Insn::LoadStoreMultiple { rn, .. } | Insn::LoadStore { rn, .. } => rn == 13,
            _ => false,
        };
        let returns = match target.as_constant() {
            Some(address) => address & !1 == back,
            None => by_convention,
        };
        if returns {
            // The return of a handler is an exception return: it is charged
            // as such, not as a branch.
            if !(self.frames.len() == 1 && self.kind == Entry::Handler) {
                self.refill(&mut state, Some(back));
            }
            self.note(node, To::Return, difference(state.cycles, before));
            exits.push((To::Return, state));
            return;
        }
        let targets = enumerate(&self.executor().symbols, &target);
        let Some(targets) = targets.or_else(|| self.pointees(graph.entry)) else {
            self.problems
                .insert(Problem::UnboundedPointer(self.describe(last.address)));
            return;
        };
        for target in targets {
            if !self.analysis.image.is_code(target) {
                self.problems
                    .insert(Problem::UnboundedPointer(self.describe(last.address)));
                continue;
            }
            let known = leaves(self.analysis.image, graph.entry, target)
                || graph
                    .block_at(target)
                    .is_some_and(|block| graph.blocks[node.block].successors.contains(&block));
            let tried = self
                .analysis
                .targets
                .get(&last.address)
                .is_some_and(|known| known.contains(&target));
            if known {
                self.jump(graph, node, state.clone(), target, last.address, exits);
            } else if tried {
                // It does not begin a block: no compiler jumps there.
                self.problems
                    .insert(Problem::UnboundedPointer(self.describe(last.address)));
            } else {
                self.found.entry(last.address).or_default().insert(target);
            }
        }
    }
}

fn sum(a: Cycles, b: Cycles) -> Cycles {
    [a[0] + b[0], a[1] + b[1]]
}

fn difference(after: Cycles, before: Cycles) -> Cycles {
    [after[0] - before[0], after[1] - before[1]]
}

/// The executions on which the condition holds, and the others.
fn split(state: &State, condition: Option<Cond>) -> (Option<State>, Option<State>) {
    match condition {
        Some(condition) if condition.0 < 14 => {
            (state.given(condition), state.given(Cond(condition.0 ^ 1)))
        }
        _ => (Some(state.clone()), None),
    }
}

fn compare_zero(state: &State, register: u8) -> (Option<State>, Option<State>) {
    let value = state.registers[usize::from(register)];
    let zero = {
        let mut state = state.clone();
        state.assume(&value, Range::constant(0)).then_some(state)
    };
    let other = if value.as_constant() == Some(0) {
        None
    } else {
        let mut state = state.clone();
        let rest = Range::between(1, u32::MAX);
        state.assume(&value, rest).then_some(state)
    };
    (zero, other)
}

/// Every address a word may name, the Thumb bit cleared.
fn enumerate(symbols: &Symbols, value: &Value) -> Option<Vec<u32>> {
    let words = match symbols.elements(value) {
        Some(words) => words,
        None if value.range.count() <= MAX_TARGETS => value.range.iter().collect(),
        None => return None,
    };
    let mut targets: Vec<u32> = words.into_iter().map(|word| word & !1).collect();
    targets.sort_unstable();
    targets.dedup();
    Some(targets)
}
