//! Loop invariants: facts that hold at the first block of a loop in every turn.
//!
//! The last turn that was run gives a guess. A word that it did not change stays the same. A
//! word that it moved by a constant keeps moving: after `k` of at most `n` more turns it has
//! moved `k` times. One more turn from the guessed state confirms the guess or shows which
//! words behave otherwise. Less is then assumed of those, until a turn confirms every
//! assumption that is left. By induction these assumptions hold in every turn.

use std::collections::HashMap;

use super::extent::Extent;
use super::flags::Flags;
use super::flash::Reads;
use super::range::Range;
use super::register::Register;
use super::slots::Slot;
use super::state::{State, common, union};
use super::symbols::Symbols;
use super::value::{Symbol, Value};

/// The assumption about one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    /// The same word in every turn.
    Same,
    /// Moved by this distance in every turn; the symbol is the word before the turn.
    Moves(Symbol, u32),
    /// In the range that the state holds.
    Within,
    /// Anything.
    Any,
}

/// The place of a word in the state.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Cell {
    Register(Register),
    Float(usize),
    Stack { address: u32, size: u32 },
    Basepri,
}

/// The guessed state and assumptions; see the module.
#[derive(Debug)]
pub(crate) struct Invariant {
    state: State,
    rules: HashMap<Cell, Rule>,
    /// The variable in which a word of the state is assumed to lie, where one is. It is not asked for after a
    /// turn: the turn may add to what is known of a symbol, and that is no assumption about the next turn.
    variables: HashMap<Cell, Extent>,
}

/// All words of a state.
fn cells(state: &State) -> Vec<(Cell, Value)> {
    let registers = state.registers.iter();
    let floats = state.floats.iter().enumerate();
    let stack = state.stack.as_slice().iter();
    let of_slot = |slot: &Slot| Cell::Stack {
        address: slot.address,
        size: slot.size,
    };
    registers
        .map(|(n, value)| (Cell::Register(n), *value))
        .chain(floats.map(|(n, value)| (Cell::Float(n), *value)))
        .chain(stack.map(|slot| (of_slot(slot), slot.value)))
        .chain([(Cell::Basepri, state.basepri)])
        .collect()
}

/// Sets a word of a state.
fn put(state: &mut State, cell: Cell, value: Value) {
    match cell {
        Cell::Register(n) => state.registers[n] = value,
        Cell::Float(n) => state.set_float(n, value),
        Cell::Stack { address, size } => state.stack.put(Slot {
            address,
            size,
            value,
        }),
        Cell::Basepri => state.basepri = value,
    }
}

/// The distance from `before` to `after`, if it is the same on every path.
fn distance(before: &Value, after: &Value) -> Option<u32> {
    if let (Some(a), Some(b)) = (before.as_constant(), after.as_constant()) {
        return Some(b.wrapping_sub(a));
    }
    match (before.base, after.base) {
        (Some((a, x)), Some((b, y))) if a == b => {
            Some(y.as_constant()?.wrapping_sub(x.as_constant()?))
        }
        _ => None,
    }
}

/// Every word that is reached from `range` by at most `turns` steps of `step`.
fn swept(range: Range, step: u32, turns: u64) -> Range {
    let down = step >> 31 != 0;
    let reach = u64::from(if down { step.wrapping_neg() } else { step }).checked_mul(turns);
    let Some(reach) = reach.and_then(|reach| u32::try_from(reach).ok()) else {
        return Range::ALL;
    };
    range.add(if down {
        Range::arc(reach.wrapping_neg(), reach, step.wrapping_neg())
    } else {
        Range::arc(0, reach, step)
    })
}

/// Whether every element of `inner` is one of `outer`.
fn within(inner: Range, outer: Range) -> bool {
    outer.is_all() || outer.join(inner) == outer
}

impl Invariant {
    /// Guesses from a turn that led from `before` to `next`. At most `turns` more follow.
    #[must_use]
    pub(crate) fn guess(before: &State, next: State, turns: u64, symbols: &mut Symbols) -> Self {
        let earlier: HashMap<Cell, Value> = cells(before).into_iter().collect();
        let mut state = next;
        state.flags = Flags::ANY;
        state.memory = common(&before.memory, &state.memory);
        state.reserved = None;
        state.touched = union(&before.touched, &state.touched);
        state.held = common(&before.held, &state.held);
        state.flash = state.flash.steady(&before.flash);
        state.left |= before.left;
        let mut rules = HashMap::new();
        let mut variables = HashMap::new();
        for (cell, value) in cells(&state) {
            let step = earlier.get(&cell).and_then(|old| distance(old, &value));
            let (rule, value) = match (earlier.get(&cell), step) {
                (Some(old), _) if *old == value => (Rule::Same, value),
                (Some(_), Some(step))
                    if step != 0
                        && matches!(cell, Cell::Register(_) | Cell::Stack { size: 4, .. }) =>
                {
                    let symbol = symbols.fresh_within(&[&value]);
                    let value = Value {
                        range: swept(value.range, step, turns),
                        base: Some((symbol, Range::constant(0))),
                        stack: value.stack,
                    };
                    (Rule::Moves(symbol, step), value)
                }
                (Some(old), _) => {
                    let value = Value {
                        range: old.range.join(value.range),
                        base: Some((symbols.fresh_within(&[old, &value]), Range::constant(0))),
                        stack: old.stack || value.stack,
                    };
                    (Rule::Within, value)
                }
                (None, _) => (Rule::Any, unknown(symbols, value.stack)),
            };
            put(&mut state, cell, value);
            rules.insert(cell, rule);
            variables.extend(symbols.origin(&value).map(|variable| (cell, variable)));
        }
        Self {
            state,
            rules,
            variables,
        }
    }

    /// The state that is assumed at the first block of every turn.
    #[must_use]
    pub(crate) fn state(&self) -> &State {
        &self.state
    }

    /// Whether a turn from [`Self::state`] that led to `after`, on a part that `reads` its flash so,
    /// confirms it. If not, less is assumed from now on.
    #[must_use]
    pub(crate) fn holds(
        &mut self,
        after: &State,
        reads: Option<Reads>,
        symbols: &mut Symbols,
    ) -> bool {
        let found: HashMap<Cell, Value> = cells(after).into_iter().collect();
        let mut confirmed = true;
        for (cell, value) in cells(&self.state) {
            // A word that was partly overwritten, or is not known on every path, is missing.
            let new = found.get(&cell).copied().unwrap_or(Value::ANY);
            confirmed &= self.word_holds(cell, &value, &new, symbols);
        }
        confirmed &= self.stack_holds(&found, symbols);
        confirmed & self.rest_holds(after, reads, symbols)
    }

    /// Whether the word at `cell`, assumed to be `value`, is as assumed where a turn made it
    /// `new`. If not, the assumption becomes weaker.
    fn word_holds(
        &mut self,
        cell: Cell,
        value: &Value,
        new: &Value,
        symbols: &mut Symbols,
    ) -> bool {
        let rule = self.rules.get(&cell).copied().unwrap_or(Rule::Any);
        let stack = value.stack || new.stack;
        let variable = self.variables.get(&cell).copied();
        let in_variable = || variable.is_none() || symbols.origin(new) == variable;
        let kept = match rule {
            Rule::Same => new == value,
            Rule::Moves(symbol, step) => {
                new.base == Some((symbol, Range::constant(step))) && value.stack == stack
            }
            Rule::Within => within(new.range, value.range) && value.stack == stack && in_variable(),
            Rule::Any => value.stack == stack && in_variable(),
        };
        if kept {
            return true;
        }
        let (rule, range) = match rule {
            Rule::Same => (Rule::Within, value.range.join(new.range)),
            _ => (Rule::Any, Range::ALL),
        };
        let weaker = Value {
            range,
            base: Some((symbols.fresh_within(&[value, new]), Range::constant(0))),
            stack,
        };
        self.rules.insert(cell, rule);
        self.variables.remove(&cell);
        let variable = symbols.origin(&weaker);
        self.variables
            .extend(variable.map(|variable| (cell, variable)));
        put(&mut self.state, cell, weaker);
        false
    }

    /// Whether the turn left no stack address in a slot about which nothing was assumed. If it
    /// did, the state now allows for it.
    fn stack_holds(&mut self, found: &HashMap<Cell, Value>, symbols: &mut Symbols) -> bool {
        let mut confirmed = true;
        for (cell, value) in found {
            let Cell::Stack { address, size } = *cell else {
                continue;
            };
            if !value.stack || self.rules.contains_key(cell) {
                continue;
            }
            confirmed = false;
            let overlaps = |slot: &Slot| slot.address < address + size && address < slot.end();
            if self.state.stack.as_slice().iter().any(overlaps) {
                self.state.escaped = true;
            } else {
                put(&mut self.state, *cell, unknown(symbols, true));
            }
            self.rules.insert(*cell, Rule::Any);
        }
        confirmed
    }

    /// Whether the parts of the state that are no words are as assumed. If not, the state
    /// becomes weaker.
    fn rest_holds(&mut self, after: &State, reads: Option<Reads>, symbols: &mut Symbols) -> bool {
        let state = &mut self.state;
        let mut confirmed = true;
        let primask = state.primask.join(after.primask);
        if state.primask != primask {
            state.primask = primask;
            confirmed = false;
        }
        let faultmask = state.faultmask.join(after.faultmask);
        if state.faultmask != faultmask {
            state.faultmask = faultmask;
            confirmed = false;
        }
        if state.resetting && !after.resetting {
            state.resetting = false;
            confirmed = false;
        }
        if after.escaped && !state.escaped {
            state.escaped = true;
            confirmed = false;
        }
        if after.moved_up && !state.moved_up {
            state.moved_up = true;
            confirmed = false;
        }
        if after.started && !state.started {
            state.started = true;
            symbols.mixed = true;
            confirmed = false;
        }
        let memory = common(&state.memory, &after.memory);
        if memory != state.memory {
            state.memory = memory;
            confirmed = false;
        }
        let touched = union(&state.touched, &after.touched);
        if touched.len() > state.touched.len() {
            state.touched = touched;
            confirmed = false;
        }
        let held = common(&state.held, &after.held);
        if held != state.held {
            state.held = held;
            confirmed = false;
        }
        for section in &after.masked {
            let mut running = state.masked.iter();
            if running.all(|known| known.level != section.level) {
                state.masked.push(*section);
                confirmed = false;
            }
        }
        confirmed &= state.flash.holds(&after.flash, reads);
        if !state.left.holds(after.left) {
            state.left |= after.left;
            confirmed = false;
        }
        confirmed
    }
}

/// An unknown word; `stack` if it may be an address on the stack.
fn unknown(symbols: &mut Symbols, stack: bool) -> Value {
    Value {
        stack,
        ..symbols.unknown()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::image::Variables;

    /// In each turn a register is taken to be an address in a variable, but holds anything behind it.
    #[test]
    fn a_word_of_any_value_is_confirmed() {
        let variable = 0x2000_0000;
        let mut symbols = Symbols::new(&Variables::of_sizes(&[(variable, 64)]));
        let basepri = symbols.fresh();
        let before = State::entry(&mut symbols, basepri);
        let register = Register::new(4);
        let mut next = before.clone();
        next.registers[register] = symbols.unknown();
        let mut invariant = Invariant::guess(&before, next, 10, &mut symbols);
        let confirmed = (0..10).position(|_| {
            let mut after = invariant.state().clone();
            let found = after.registers[register];
            let (down, up) = (Value::constant(variable), Value::constant(variable));
            let index = found.subtract(&down);
            let element = symbols.moved(index.add(&up), &index, &up);
            assert!(symbols.origin(&element).is_some());
            after.registers[register] = symbols.unknown();
            invariant.holds(&after, None, &mut symbols)
        });
        assert_eq!(confirmed, Some(0));
    }
}
