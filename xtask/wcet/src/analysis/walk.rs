//! Walks through blocks and regions: executes instructions, charges them and joins paths.

use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use rsemu::cpu::arm::v7m::isa::{Cond, HintOp, Insn};

use crate::bound::{Entry, Problem};
use crate::cycles::Cycles;
use crate::execute::Effects;
use crate::facts::{BlockId, To};
use crate::flash::Reused;
use crate::graph::{Block, Graph, conditional};
use crate::instruction::{Flow, Instruction, SEMIHOSTING};
use crate::layout::STACK;
use crate::mask::{Level, Masked};
use crate::register::{Register, Results};
use crate::stack::sets_main_stack;
use crate::state::State;
use crate::value::Value;

use super::run::{Exits, Run};

/// A stack pointer that may vary by this much or more counts as unknown.
const MAX_STACK_SPAN: u32 = 0x1_0000;

impl Run<'_, '_> {
    /// Runs one turn of a loop (`region`), or the whole function, from block `start` on.
    /// Returns the ways out, and the state that comes back to the loop's header.
    pub(super) fn region(
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
                    _ => self.add_exit(&mut exits, to, state),
                }
            }
        }
        (exits, back)
    }

    /// Runs one block and the functions that it calls.
    fn block(&mut self, graph: &Rc<Graph>, number: usize, state: State) -> Exits {
        let block = &graph.blocks[number];
        let id = BlockId {
            function: graph.entry,
            block: number,
        };
        if self.until_start && state.started {
            return Exits::new();
        }
        *self.facts.visits.entry(id).or_default() += 1;
        if self.exhausted() {
            let mut problems = self.problems.iter();
            if !problems.any(|problem| matches!(problem, Problem::TooLong(_))) {
                self.report(Problem::TooLong, block.start());
            }
            return Exits::new();
        }
        let before = state.cycles;
        let mut states = vec![state];
        let (last, body) = block.split_last();
        for instruction in body {
            states = self.step(states, instruction);
        }
        let (states, skipping) = self.before_last(states, last);
        let exits = self.leave_block(graph, id, block, states, skipping, before);
        let ways: BTreeSet<To> = exits.iter().map(|(to, _)| *to).collect();
        for to in ways {
            *self.facts.edges.entry((id, to)).or_default() += 1;
            self.facts.edge_costs.entry((id, to)).or_default();
        }
        exits
    }

    /// The states that execute the last instruction of a block, and the one that skips it.
    fn before_last(
        &mut self,
        mut states: Vec<State>,
        last: &Instruction,
    ) -> (Vec<State>, Option<State>) {
        let flow = last.flow();
        let mut skipping = None;
        if flow == Flow::Next {
            states = self.step(states, last);
        } else if conditional(last) {
            let mut executing = Vec::new();
            for state in states {
                let (yes, no) = split(&state, last.condition);
                executing.extend(yes);
                if let Some(mut no) = no {
                    self.fetch(&mut no, last, true);
                    self.join(&mut skipping, no);
                }
            }
            states = executing;
        }
        // Before a branch the states stay apart: each of the earlier conditions may decide it.
        if !matches!(flow, Flow::Branch { .. }) {
            states = self.join_all(states).into_iter().collect();
        }
        (states, skipping)
    }

    /// Leaves a block by its last instruction, and notes what the block cost since `before`.
    fn leave_block(
        &mut self,
        graph: &Rc<Graph>,
        id: BlockId,
        block: &Block,
        states: Vec<State>,
        skipping: Option<State>,
        before: Cycles,
    ) -> Exits {
        let last = block.last();
        let straight = graph.block_at(last.next());
        let mut exits = Exits::new();
        let mut cost = Cycles::ZERO;
        if let Some(state) = skipping {
            cost = cost.max(state.cycles - before);
            exits.extend(straight.map(|next| self.straight_on(id, next, last, state)));
        }
        for mut state in states {
            if last.flow() == Flow::Next {
                cost = cost.max(state.cycles - before);
                exits.extend(straight.map(|next| self.straight_on(id, next, last, state)));
            } else {
                let target = self.charge(&mut state, last);
                cost = cost.max(state.cycles - before);
                self.leave(graph, id, last, state, target, &mut exits);
            }
        }
        self.facts.add_cost(id, cost);
        exits
    }

    /// The way from a block to `next`, which begins behind its `last` instruction. The line is fetched
    /// before this path meets others, so that all have the same one.
    pub(super) fn straight_on(
        &mut self,
        id: BlockId,
        next: usize,
        last: &Instruction,
        mut state: State,
    ) -> (To, State) {
        let before = state.cycles;
        self.run_on(&mut state, last.next());
        self.note_edge(id, To::Block(next), state.cycles - before);
        (To::Block(next), state)
    }

    /// Executes an instruction after which control goes to the next one.
    fn step(&mut self, mut states: Vec<State>, instruction: &Instruction) -> Vec<State> {
        if instruction.condition.is_none() && states.len() > 1 {
            states = self.join_all(states).into_iter().collect();
        }
        let mut after = Vec::with_capacity(states.len());
        for mut state in states {
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
                self.charge(&mut state, instruction);
                after.push(state);
            }
        }
        after
    }

    /// Charges the fetch of an instruction, and its one cycle if it is skipped.
    fn fetch(&mut self, state: &mut State, instruction: &Instruction, skipped: bool) {
        self.run_on(state, instruction.address);
        self.run_on(state, instruction.address + instruction.size - 1);
        if skipped {
            state.left = Results::NONE;
            state.spend(self.timings.cycles(|timing| timing.skipped()));
        }
    }

    /// Charges the wait for the line of `address`, to which control goes on without a jump.
    fn run_on(&mut self, state: &mut State, address: u32) {
        let Some(reads) = self.timings.flashed.reads() else {
            return;
        };
        let mut reused = Reused::default();
        let flashed = state.flash.follow(reads, address, &mut reused);
        self.note_reused(state, &reused);
        state.wait(Cycles {
            zero_wait: 0,
            flashed,
        });
    }

    /// Executes and charges one instruction. Returns the word that it writes to the program
    /// counter, if it writes one.
    pub(super) fn charge(&mut self, state: &mut State, instruction: &Instruction) -> Option<Value> {
        self.steps += 1;
        if !instruction.is_of(self.executor.part.core) {
            self.report(Problem::NotCode, instruction.address);
        }
        self.fetch(state, instruction, false);
        let started = state.started;
        let effects = self.executor.execute(state, instruction);
        let cycles = self.cost(state, instruction, &effects);
        state.left = instruction.results();
        // Interrupts are masked from reset until start-up lets the first task run. That stretch
        // delays no task, so it is not recorded as a critical section.
        if started {
            for section in effects.unmasked {
                self.add_section(&section, cycles);
            }
        }
        if effects.unknown_mask {
            self.report(Problem::UnknownMask, instruction.address);
        }
        if effects.disables_interrupt && self.kind != Entry::Fault {
            self.report(Problem::DisabledInterrupt, instruction.address);
        }
        let asks = matches!(instruction.insn, Insn::Bkpt { imm: SEMIHOSTING });
        let delays = match self.kind {
            Entry::Handler | Entry::Function => true,
            Entry::Program => state.outermost_section().is_some(),
            Entry::Fault => false,
        };
        if asks && delays {
            self.report(Problem::Semihosting, instruction.address);
        }
        if self.oversleeps(state, instruction) {
            self.report(Problem::Sleep, instruction.address);
        }
        self.uses_fpu |= instruction.uses_fpu();
        self.note_stack(state, instruction);
        effects.target
    }

    /// Whether an instruction may make a task wait for an interrupt. `WFI` also wakes by one that
    /// `PRIMASK` masks, but by none that `BASEPRI` or `FAULTMASK` does; and `WFE` by none that is
    /// masked (DDI 0403 B1.5.18, B1.5.19).
    fn oversleeps(&self, state: &State, instruction: &Instruction) -> bool {
        let Insn::Hint { op, .. } = instruction.insn else {
            return false;
        };
        let mut masked = state.masked.iter().filter(|_| state.started);
        match (self.kind, op) {
            (Entry::Program, HintOp::Wfi) => masked.any(|section| section.level != Level::All),
            (Entry::Program, HintOp::Wfe) => masked.next().is_some(),
            (Entry::Handler | Entry::Function, HintOp::Wfi | HintOp::Wfe) => true,
            _ => false,
        }
    }

    /// Charges an instruction that has been executed, its fetch left out. Returns its cost.
    fn cost(&mut self, state: &mut State, instruction: &Instruction, effects: &Effects) -> Cycles {
        let access = effects.access.as_ref();
        let mut cycles = self
            .timings
            .cycles(|timing| timing.instruction(instruction, access, state.left));
        let reads = self.timings.flashed.reads();
        let read = access.filter(|access| access.load).zip(reads);
        let settled = read.and_then(|(access, reads)| {
            let words = (access.size, access.count);
            let mut reused = Reused::default();
            let flash = &mut state.flash;
            let (wait, settled) = flash.read(reads, access.address, words, &mut reused);
            self.note_reused(state, &reused);
            cycles.flashed += wait;
            settled
        });
        state.spend(cycles);
        if let Some(ahead) = settled {
            state.flash.settle(ahead);
        }
        cycles
    }

    /// Notes lines that the bound takes to be at hand, for the job and for each critical section that it is in.
    fn note_reused(&mut self, state: &State, reused: &Reused) {
        if reused.is_empty() {
            return;
        }
        self.reused.extend(reused);
        for section in &state.masked {
            let of = self.reused_in.entry((section.level, section.at));
            of.or_default().extend(reused);
        }
    }

    /// Records a critical section that ends with an instruction of this cost.
    fn add_section(&mut self, section: &Masked, cycles: Cycles) {
        let most = self
            .sections
            .entry((section.level, section.at))
            .or_default();
        *most = most.max(section.cycles + cycles);
    }

    /// Notes how deep the stack is after an instruction.
    fn note_stack(&mut self, state: &State, instruction: &Instruction) {
        let pointer = state.registers[Register::SP].range;
        if pointer.span() < MAX_STACK_SPAN && pointer.meet(STACK) == Some(pointer) {
            // If it was aligned down by an unknown amount, the lowest address counts.
            self.lowest = self.lowest.min(pointer.start());
        } else {
            // It is unknown behind that, too.
            let mut known = self.problems.iter();
            if !known.any(|problem| matches!(problem, Problem::UnknownStack(_))) {
                self.report(Problem::UnknownStack, instruction.address);
            }
        }
        if sets_main_stack(instruction) && self.kind != Entry::Fault {
            self.report(Problem::UnknownStack, instruction.address);
        }
    }

    /// Charges the pipeline refill of a taken branch, to `target` if that is known, and the wait for
    /// its line.
    pub(super) fn refill(&mut self, state: &mut State, target: Option<u32>) {
        let mut cycles = self.timings.cycles(|timing| timing.taken());
        if let Some(reads) = self.timings.flashed.reads() {
            let mut reused = Reused::default();
            cycles.flashed += state.flash.jump(reads, target, &mut reused);
            self.note_reused(state, &reused);
        }
        // The line may come before the pipeline is filled or behind it: what is read ahead has no part
        // of that time for certain.
        state.wait(cycles);
    }
}

/// The executions on which the condition holds, and the others.
pub(super) fn split(state: &State, condition: Option<Cond>) -> (Option<State>, Option<State>) {
    match condition {
        Some(condition) if condition.0 < 14 => {
            (state.given(condition), state.given(Cond(condition.0 ^ 1)))
        }
        _ => (Some(state.clone()), None),
    }
}
