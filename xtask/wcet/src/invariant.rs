//! What holds at the first block of a loop in every turn.
//!
//! The last turn run gives a guess: words that it left alone stay as they
//! are, words that it moved by a constant go on moving, so that after `k` of
//! at most `n` more turns they have moved `k` times. One more turn from the
//! guessed state confirms it or shows which words behave otherwise; of those
//! less is assumed until a turn confirms all that is left, which is then true
//! of every turn by induction.

use std::collections::HashMap;
use std::rc::Rc;

use super::flags::Flags;
use super::range::Range;
use super::state::{State, Symbols, common};
use super::value::{Symbol, Value};

/// What is assumed of one word.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Rule {
    /// The same word in every turn.
    Same,
    /// Moved by this in every turn; the symbol is the word before the turn.
    Moves(Symbol, u32),
    /// Any element of the range the state holds.
    Within,
    /// Anything.
    Any,
}

/// Where a word lies.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
enum Cell {
    Register(usize),
    Float(usize),
    Stack(u32, u32),
    Mask,
}

/// The guess; see the module.
#[derive(Debug)]
pub struct Invariant {
    state: State,
    rules: HashMap<Cell, Rule>,
}

fn cells(state: &State) -> Vec<(Cell, Value)> {
    let registers = state.registers.iter().enumerate();
    let floats = state.floats.iter().enumerate();
    let stack = state.stack.iter();
    registers
        .map(|(n, value)| (Cell::Register(n), *value))
        .chain(floats.map(|(n, value)| (Cell::Float(n), *value)))
        .chain(stack.map(|&(at, size, value)| (Cell::Stack(at, size), value)))
        .chain([(Cell::Mask, state.basepri)])
        .collect()
}

fn put(state: &mut State, cell: Cell, value: Value) {
    match cell {
        Cell::Register(n) => state.registers[n] = value,
        Cell::Float(n) => {
            if state.floats[n] != value {
                Rc::make_mut(&mut state.floats)[n] = value;
            }
        }
        Cell::Stack(at, size) => {
            let index = state.stack.partition_point(|slot| slot.0 < at);
            match state.stack.get(index) {
                Some(slot) if (slot.0, slot.1) == (at, size) => {
                    Rc::make_mut(&mut state.stack)[index].2 = value;
                }
                _ => Rc::make_mut(&mut state.stack).insert(index, (at, size, value)),
            }
        }
        Cell::Mask => state.basepri = value,
    }
}

/// How far `after` lies from `before`, if that is one distance.
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

/// Every word on the way from an element of `range` in at most `turns` steps.
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

fn within(inner: Range, outer: Range) -> bool {
    outer.is_all() || outer.join(inner) == outer
}

impl Invariant {
    /// Guesses from a turn that led from `before` to `next`; at most `turns`
    /// more follow.
    #[must_use]
    pub fn guess(before: &State, next: State, turns: u64, symbols: &mut Symbols) -> Self {
        let earlier: HashMap<Cell, Value> = cells(before).into_iter().collect();
        let mut state = next;
        state.flags = Flags::ANY;
        state.memory = common(&before.memory, &state.memory);
        state.line = state.line.filter(|_| state.line == before.line);
        state.written |= before.written;
        let mut rules = HashMap::new();
        for (cell, value) in cells(&state) {
            let step = earlier.get(&cell).and_then(|old| distance(old, &value));
            let (rule, value) = match (earlier.get(&cell), step) {
                (Some(old), _) if *old == value => (Rule::Same, value),
                (Some(_), Some(step))
                    if step != 0 && matches!(cell, Cell::Register(_) | Cell::Stack(_, 4)) =>
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
        }
        Self { state, rules }
    }

    /// What is taken to hold.
    #[must_use]
    pub fn state(&self) -> &State {
        &self.state
    }

    /// Whether a turn from [`Self::state`] that led to `after` confirms it; if
    /// not, less is taken to hold from now on.
    #[must_use]
    pub fn holds(&mut self, after: &State, symbols: &mut Symbols) -> bool {
        let found: HashMap<Cell, Value> = cells(after).into_iter().collect();
        let mut confirmed = true;
        for (cell, value) in cells(&self.state) {
            let rule = self.rules.get(&cell).copied().unwrap_or(Rule::Any);
            let new = match found.get(&cell) {
                Some(new) => *new,
                // A word that was overwritten in part or is not known on
                // every path.
                None => Value::ANY,
            };
            let stack = value.stack || new.stack;
            let place = symbols.origin(&value);
            let in_place =
                |symbols: &Symbols, new: &Value| place.is_none() || symbols.origin(new) == place;
            let kept = match rule {
                Rule::Same => new == value,
                Rule::Moves(symbol, step) => {
                    new.base == Some((symbol, Range::constant(step))) && value.stack == stack
                }
                Rule::Within => {
                    within(new.range, value.range)
                        && value.stack == stack
                        && in_place(symbols, &new)
                }
                Rule::Any => value.stack == stack && in_place(symbols, &new),
            };
            if kept {
                continue;
            }
            confirmed = false;
            let (rule, value) = match rule {
                Rule::Same => (
                    Rule::Within,
                    Value {
                        range: value.range.join(new.range),
                        base: Some((symbols.fresh_within(&[&value, &new]), Range::constant(0))),
                        stack,
                    },
                ),
                _ => (
                    Rule::Any,
                    Value {
                        base: Some((symbols.fresh_within(&[&value, &new]), Range::constant(0))),
                        stack,
                        ..Value::ANY
                    },
                ),
            };
            self.rules.insert(cell, rule);
            put(&mut self.state, cell, value);
        }
        // A stack address may now lie where nothing was known of.
        for (cell, value) in &found {
            if let Cell::Stack(..) = cell
                && value.stack
                && !self.rules.contains_key(cell)
            {
                confirmed = false;
                let overlaps = |slot: &(u32, u32, Value)| match *cell {
                    Cell::Stack(at, size) => slot.0 < at + size && at < slot.0 + slot.1,
                    _ => false,
                };
                if self.state.stack.iter().any(overlaps) {
                    self.state.escaped = true;
                } else {
                    put(&mut self.state, *cell, unknown(symbols, true));
                }
                self.rules.insert(*cell, Rule::Any);
            }
        }
        let state = &mut self.state;
        if state.primask.is_some() && state.primask != after.primask {
            state.primask = None;
            confirmed = false;
        }
        if after.escaped && !state.escaped {
            state.escaped = true;
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
        for mask in &after.masked {
            if !state.masked.iter().any(|known| known.level == mask.level) {
                state.masked.push(*mask);
                confirmed = false;
            }
        }
        if state.line.is_some() && state.line != after.line {
            state.line = None;
            confirmed = false;
        }
        if after.written & !state.written != 0 {
            state.written |= after.written;
            confirmed = false;
        }
        confirmed
    }
}

fn unknown(symbols: &mut Symbols, stack: bool) -> Value {
    Value {
        base: Some((symbols.fresh(), Range::constant(0))),
        stack,
        ..Value::ANY
    }
}
