//! The ways out of a block: branches, jumps, returns and calls.

use std::rc::Rc;

use rsemu::cpu::arm::v7m::isa::{Cond, Insn};

use crate::bound::{End, Entry, PanicSite, Problem};
use crate::cycles::Cycles;
use crate::facts::{BlockId, To};
use crate::graph::{Graph, leaves};
use crate::instruction::{Flow, Instruction};
use crate::range::Range;
use crate::register::{Register, RegisterSet};
use crate::software;
use crate::state::State;
use crate::symbols::Symbols;
use crate::value::Value;

use super::run::{Exits, Run};
use super::walk::split;

/// Targets of one indirect jump above which it counts as unresolved.
const MAX_TARGETS: u64 = 1024;

impl Run<'_, '_> {
    /// Follows the last instruction of a block along every way that it may take. `written` is
    /// the word that it wrote to the program counter, if it wrote one.
    pub(super) fn leave(
        &mut self,
        graph: &Rc<Graph>,
        id: BlockId,
        last: &Instruction,
        state: State,
        written: Option<Value>,
        exits: &mut Exits,
    ) {
        match last.flow() {
            Flow::Next => {}
            Flow::Branch { condition, target } => {
                let (yes, no) = branch(state, last, condition);
                if let (Some(no), Some(next)) = (no, graph.block_at(last.next())) {
                    exits.push(self.straight_on(id, next, last, no));
                }
                if let Some(yes) = yes {
                    self.jump(graph, id, yes, target, last.address, exits);
                }
            }
            Flow::Jump { target } => self.jump(graph, id, state, target, last.address, exits),
            Flow::Call { target } => self.call(graph, id, state, &[target], last, exits),
            Flow::CallRegister { .. } => {
                self.call_register(graph, id, state, written, last, exits);
            }
            Flow::Indirect => self.indirect(graph, id, state, written, last, exits),
            Flow::Stop => {
                self.ends.insert(End::Stop(self.describe(last.address)));
                self.panics.insert(PanicSite {
                    at: last.address,
                    callee: "an undefined instruction".to_owned(),
                });
                self.end_path(state.cycles);
            }
        }
    }

    /// A call of the function that a register points to.
    fn call_register(
        &mut self,
        graph: &Rc<Graph>,
        id: BlockId,
        mut state: State,
        written: Option<Value>,
        last: &Instruction,
        exits: &mut Exits,
    ) {
        let targets = written
            .and_then(|value| enumerate(&self.executor.symbols, &value))
            .or_else(|| self.pointees(graph.entry, last.address));
        let image = self.program.image;
        let known = targets.filter(|targets| targets.iter().all(|target| image.is_code(*target)));
        if let Some(targets) = known {
            self.call(graph, id, state, &targets, last, exits);
            return;
        }
        self.report(Problem::UnboundedPointer, last.address);
        // Continue as if the call had returned, to find further problems.
        if let Some(next) = graph.block_at(last.next()) {
            for register in RegisterSet::SCRATCH.iter() {
                state.registers[register] = self.executor.symbols.unknown();
            }
            exits.push((To::Block(next), state));
        }
    }

    /// The functions that the call at `call` through an unknown pointer in the function at `entry` may
    /// reach, if that is known.
    fn pointees(&self, entry: u32, call: u32) -> Option<Vec<u32>> {
        let targets = software::targets(self.program.image, entry, call)?;
        Some(targets.into_iter().collect())
    }

    /// A direct jump, within the function or to another one (a tail call).
    fn jump(
        &mut self,
        graph: &Rc<Graph>,
        id: BlockId,
        mut state: State,
        target: u32,
        from: u32,
        exits: &mut Exits,
    ) {
        let before = state.cycles;
        self.refill(&mut state, Some(target));
        let refill = state.cycles - before;
        if leaves(self.program.image, graph.entry, target) {
            let back = self.back();
            if let Some(state) = self.enter(id, from, target, back, state) {
                self.note_edge(id, To::Return, refill);
                exits.push((To::Return, state));
            } else {
                self.note_edge(id, To::End, refill);
            }
            return;
        }
        match graph.block_at(target) {
            Some(next) => {
                self.note_edge(id, To::Block(next), refill);
                exits.push((To::Block(next), state));
            }
            None => self.report(Problem::NotCode, target),
        }
    }

    /// Notes the cost of an edge beyond its block, and counts an edge at which the path ends.
    pub(super) fn note_edge(&mut self, id: BlockId, to: To, cycles: Cycles) {
        self.facts.add_edge_cost((id, to), cycles);
        if to == To::End {
            *self.facts.edges.entry((id, to)).or_default() += 1;
        }
    }

    /// A return, a jump table or a tail call through a register.
    fn indirect(
        &mut self,
        graph: &Rc<Graph>,
        id: BlockId,
        mut state: State,
        written: Option<Value>,
        last: &Instruction,
        exits: &mut Exits,
    ) {
        let target = written.unwrap_or(Value::ANY);
        if self.returns(&target, last) {
            let before = state.cycles;
            // The return of a handler is an exception return, which is charged elsewhere.
            if !(self.frames.len() == 1 && self.kind == Entry::Handler) {
                let back = self.back();
                self.refill(&mut state, Some(back));
            }
            self.note_edge(id, To::Return, state.cycles - before);
            exits.push((To::Return, state));
            return;
        }
        let targets = enumerate(&self.executor.symbols, &target);
        let Some(targets) = targets.or_else(|| self.pointees(graph.entry, last.address)) else {
            self.report(Problem::UnboundedPointer, last.address);
            return;
        };
        let image = self.program.image;
        for target in targets {
            if !image.is_code(target) {
                self.report(Problem::UnboundedPointer, last.address);
                continue;
            }
            let known = leaves(image, graph.entry, target)
                || graph
                    .block_at(target)
                    .is_some_and(|block| graph.blocks[id.block].successors.contains(&block));
            if known {
                self.jump(graph, id, state.clone(), target, last.address, exits);
            } else if self.program.has_target(last.address, target) {
                // The graph was built with this target, but it does not begin a block. No
                // compiler jumps there, so the target is wrong.
                self.report(Problem::UnboundedPointer, last.address);
            } else {
                self.found.entry(last.address).or_default().insert(target);
            }
        }
    }

    /// Whether a write of `target` to the program counter returns to the caller. An unknown
    /// word does if the instruction is one by which compilers return.
    fn returns(&self, target: &Value, last: &Instruction) -> bool {
        match target.as_constant() {
            Some(address) => address & !1 == self.back(),
            None => match last.insn {
                Insn::Bx { rm } => Register::new(rm) == Register::LR,
                Insn::LoadStoreMultiple { rn, .. } | Insn::LoadStore { rn, .. } => {
                    Register::new(rn) == Register::SP
                }
                _ => false,
            },
        }
    }
}

/// The executions on which a conditional branch is taken, and the others.
fn branch(
    state: State,
    last: &Instruction,
    condition: Option<Cond>,
) -> (Option<State>, Option<State>) {
    match (condition, last.insn) {
        (Some(_), _) => split(&state, condition),
        (None, Insn::Cbz { nonzero, rn, .. }) => {
            let (zero, other) = compare_zero(&state, Register::new(rn));
            if nonzero {
                (other, zero)
            } else {
                (zero, other)
            }
        }
        _ => (Some(state.clone()), Some(state)),
    }
}

/// The executions on which a register is zero, and the others.
fn compare_zero(state: &State, register: Register) -> (Option<State>, Option<State>) {
    let value = state.registers[register];
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

/// Every address to which a word may point, with the Thumb bit cleared; `None` if there are too
/// many.
fn enumerate(symbols: &Symbols, value: &Value) -> Option<Vec<u32>> {
    let words = match symbols.targets(value) {
        Some(words) => words,
        None if value.range.count() <= MAX_TARGETS => value.range.iter().collect(),
        None => return None,
    };
    let mut targets: Vec<u32> = words.into_iter().map(|word| word & !1).collect();
    targets.sort_unstable();
    targets.dedup();
    Some(targets)
}
