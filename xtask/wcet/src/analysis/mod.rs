//! Bounds by running all paths of a task at once on the abstract machine.
//!
//! Calls are followed in place, so every call is analysed with its own arguments. Outside loops,
//! and within one turn of a loop, paths that meet are joined. Different turns of a loop are not
//! joined: a counter keeps its exact value, and an inner loop that runs up to an outer counter
//! is charged its real cost in each turn. The clock of a joined path is the longer of the two,
//! so the clock at the return bounds the execution time.

mod calls;
mod copies;
mod learn;
mod leave;
mod loops;
mod run;
mod walk;

use std::collections::HashMap;
use std::rc::Rc;

use run::Run;

use super::annotation::Annotations;
use super::bound::{Bound, Entry};
use super::cycles::Cycles;
use super::facts::BlockId;
use super::graph::Graph;
use super::image::Image;
use super::ipet::{self, Longest};
use super::lasting::{Choices, Memory, SystemWrites, Words, Written};
use super::part::Part;
use super::program::Program;
use super::reading::Reading;
use super::register::Register;
use super::timing::Timings;

/// Analyses tasks of one image.
#[derive(Debug)]
pub struct Analysis<'a> {
    program: Program<'a>,
    part: Part,
    timings: Timings,
    /// Words that keep the address which start-up wrote to them.
    lasting: Rc<Words>,
    /// Words that handlers set to one of a few addresses.
    choices: Rc<Choices>,
    /// Whether no exception interrupts start-up and returns.
    starts_alone: bool,
    /// What the program and its handlers write to the system control space, as far as they were
    /// analysed.
    system: SystemWrites,
    /// Bytes that DMA may write, and those that were taken as known while `PRIMASK` was set, as far as the
    /// program was analysed.
    lent: Written,
    trusted: Written,
    /// Whether bytes are known that were written while `PRIMASK` was set.
    holds: bool,
    /// Bounds that were found while `lasting` was.
    known: HashMap<(u32, Entry), Bound>,
}

impl<'a> Analysis<'a> {
    /// Prepares the analysis of `image` on this part.
    #[must_use]
    pub fn new(image: &'a Image, annotations: &'a Annotations, part: &Part) -> Self {
        Self {
            program: Program::new(image, annotations),
            part: *part,
            timings: Timings::of(part),
            lasting: Rc::default(),
            choices: Rc::default(),
            starts_alone: false,
            system: SystemWrites::default(),
            lent: Written::new(),
            trusted: Written::new(),
            holds: true,
            known: HashMap::new(),
        }
    }

    /// Bounds the code at `entry`.
    pub fn run(&mut self, entry: u32, kind: Entry) -> Bound {
        match self.known.get(&(entry, kind)) {
            Some(bound) => bound.clone(),
            None => self.run_with(entry, kind, &[]),
        }
    }

    /// Bounds the handler at `entry`, for the activations that read this from a device.
    pub fn run_reading(&mut self, entry: u32, reading: Reading) -> Bound {
        self.explore_in((entry, Entry::Handler), &[], Some(reading), false)
            .0
    }

    /// Bounds the code at `entry`, entered with these words in core registers.
    pub fn run_with(&mut self, entry: u32, kind: Entry, registers: &[(Register, u32)]) -> Bound {
        self.explore(entry, kind, registers).0
    }

    /// What the program and its handlers write to the system control space, as far as they were
    /// analysed.
    #[must_use]
    pub fn system_writes(&self) -> &SystemWrites {
        &self.system
    }

    /// The longest path to this bound of the code at `entry`; `None` if the bound has problems
    /// or the solver fails.
    pub fn longest_path(&mut self, bound: &Bound, entry: u32) -> Option<Longest> {
        ipet::solve(&mut self.program, bound, entry)
    }

    fn explore(
        &mut self,
        entry: u32,
        kind: Entry,
        registers: &[(Register, u32)],
    ) -> (Bound, Memory) {
        self.explore_in((entry, kind), registers, None, false)
    }

    /// Bounds the code at `entry`, or only the part before a task can run, and collects the facts about memory.
    ///
    /// Targets of jump tables are found on the way. The control flow is then built anew with
    /// them, until there are no new ones.
    fn explore_in(
        &mut self,
        (entry, kind): (u32, Entry),
        registers: &[(Register, u32)],
        reading: Option<Reading>,
        until_start: bool,
    ) -> (Bound, Memory) {
        loop {
            let lasting = self.lasting.clone();
            let on = (self.part, self.timings);
            let known = Memory {
                lasting,
                choices: self.choices.clone(),
                starts_alone: self.starts_alone,
                holds: self.holds,
                ..Memory::default()
            };
            let mut run = Run::new(&mut self.program, on, kind, known);
            run.executor.reading = reading;
            run.until_start = until_start;
            let outcome = run.whole(entry, registers);
            if outcome.found.is_empty() {
                self.system.extend(&outcome.memory.system);
                self.lent.extend(&outcome.memory.lent);
                self.trusted.extend(&outcome.memory.trusted);
                return (self.tightened(outcome.bound, entry, kind), outcome.memory);
            }
            self.program.add_targets(outcome.found);
        }
    }

    /// Applies annotations of how often one activation runs a statement. Only the integer
    /// program can use them.
    fn tightened(&mut self, mut bound: Bound, entry: u32, kind: Entry) -> Bound {
        if kind == Entry::Program || !bound.problems.is_empty() {
            return bound;
        }
        let blocks: Vec<BlockId> = bound.facts.visits.keys().copied().collect();
        for block in blocks {
            let Some(graph) = self.program.graph(block.function) else {
                continue;
            };
            let Program {
                image, annotations, ..
            } = self.program;
            if let Some((place, most)) = annotations.at_most(image, &graph, block.block) {
                bound.facts.most.insert(block, most);
                let name = format!("{place}, in all");
                bound.annotated.insert(name, most);
            }
        }
        if bound.facts.most.is_empty() {
            return bound;
        }
        if let Some(longest) = self.longest_path(&bound, entry) {
            let around = match kind {
                Entry::Handler => self.timings.around_handler(bound.uses_fpu),
                Entry::Function | Entry::Fault | Entry::Program => Cycles::ZERO,
            };
            bound.cycles = bound.cycles.min(longest.cycles + around);
            // A critical section of the activation is no longer than the whole activation.
            for section in &mut bound.sections {
                section.cycles = section.cycles.min(bound.cycles);
            }
        }
        bound
    }

    /// The control flow of the function at `entry`, as far as it is known.
    pub fn graph(&mut self, entry: u32) -> Option<Rc<Graph>> {
        self.program.graph(entry)
    }

    /// The annotated bound of loop `number` of `graph`, and the place of the loop.
    #[must_use]
    pub fn annotation(&self, graph: &Graph, number: usize) -> Option<(String, u64)> {
        self.program.annotation(graph, number)
    }

    /// The image under analysis.
    #[must_use]
    pub fn image(&self) -> &'a Image {
        self.program.image
    }
}
