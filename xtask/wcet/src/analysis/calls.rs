//! Calls: functions are entered in place, with the arguments of the call.

use std::rc::Rc;

use crate::bound::{End, Entry, PanicSite, Problem};
use crate::facts::{BlockId, To};
use crate::graph::{Graph, is_end, is_panic};
use crate::instruction::Instruction;
use crate::state::State;

use super::run::{Exits, Frame, Run};

impl Run<'_, '_> {
    /// Calls each of `targets` and joins the states in which they return.
    pub(super) fn call(
        &mut self,
        graph: &Rc<Graph>,
        id: BlockId,
        state: State,
        targets: &[u32],
        last: &Instruction,
        exits: &mut Exits,
    ) {
        let straight = graph.block_at(last.next()).map(To::Block);
        let mut returned = None;
        for &target in targets {
            let mut state = state.clone();
            let before = state.cycles;
            self.refill(&mut state, Some(target));
            let refill = state.cycles - before;
            self.note_edge(id, straight.unwrap_or(To::End), refill);
            if let Some(state) = self.enter(id, last.address, target, last.next(), state) {
                self.join(&mut returned, state);
            }
        }
        match (returned, straight) {
            (Some(state), Some(next)) => exits.push((next, state)),
            (Some(_), None) => self.report(Problem::NotCode, last.next()),
            (None, _) => {
                let cost = straight.and_then(|next| self.facts.edge_costs.get(&(id, next)));
                let cost = cost.copied().unwrap_or_default();
                self.note_edge(id, To::End, cost);
            }
        }
    }

    /// Enters the function at `target` from the instruction at `from`. `None` if it never
    /// returns.
    pub(super) fn enter(
        &mut self,
        id: BlockId,
        from: u32,
        target: u32,
        back: u32,
        state: State,
    ) -> Option<State> {
        let name = self.program.image.name(target);
        if is_end(&name) && self.kind != Entry::Fault {
            self.end_path(state.cycles);
            return None;
        }
        if is_panic(&name) {
            self.ends.insert(End::Panic(self.describe(from)));
            self.panics.insert(PanicSite {
                at: from,
                callee: name,
            });
            self.end_path(state.cycles);
            return None;
        }
        *self.facts.calls.entry((id, target)).or_default() += 1;
        self.function(target, back, state)
    }

    /// Runs the function at `entry` until it returns to `back`.
    pub(super) fn function(&mut self, entry: u32, back: u32, state: State) -> Option<State> {
        let mut frames = self.frames.iter();
        if let Some(first) = frames.position(|frame| frame.function == entry) {
            self.report_recursion(first, entry);
            return None;
        }
        let Some(graph) = self.program.graph(entry) else {
            self.report(Problem::NotCode, entry);
            return None;
        };
        let bytes = self.most_bytes(entry, &state);
        let before = state.registers;
        let copy = self.begin_copy(entry, &state);
        self.frames.push(Frame {
            function: entry,
            back,
            bytes,
        });
        let (exits, _) = self.region(&graph, None, 0, state);
        self.frames.pop();
        let mut returned = None;
        for (to, state) in exits {
            if to == To::Return {
                self.join(&mut returned, state);
            }
        }
        self.end_copy(copy, returned.as_mut());
        if let Some(state) = &mut returned {
            // Stores through unknown pointers may have made the saved words unknown. The program did not
            // change them: by the calling convention the caller finds what it left.
            for register in graph.saved.iter() {
                let found = state.registers[register];
                if found.base.is_none() || found.base != before[register].base {
                    state.registers[register] = before[register];
                }
            }
        }
        returned
    }

    /// Reports that the function at `entry`, which is number `first` on the call stack, calls
    /// itself. Of several circles that have a function in common the first one is reported.
    fn report_recursion(&mut self, first: usize, entry: u32) {
        let on_stack = self.frames[first..].iter().map(|frame| frame.function);
        let is_known = on_stack
            .clone()
            .any(|function| self.recursive.contains(&function));
        self.recursive.extend(on_stack.clone());
        if is_known {
            return;
        }
        let names: Vec<String> = on_stack
            .chain([entry])
            .map(|function| self.program.image.name(function))
            .collect();
        self.problems
            .insert(Problem::Recursion(names.join(" calls ")));
    }
}
