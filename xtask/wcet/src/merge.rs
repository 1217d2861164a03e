//! Values where two paths meet.

use std::collections::HashMap;

use super::range::Range;
use super::slots::{Slot, Slots};
use super::symbols::{Definition, MAX_ELEMENTS, Symbols};
use super::value::{Symbol, Value};

/// The symbols of a value on two paths (`None` for a constant), and the distance between the
/// offsets. Two values with the same pair differ by the same amount on both paths.
type Pair = (Option<Symbol>, Option<Symbol>, u32);

/// Joins the values of two paths and keeps the relations between values that hold on both.
pub(crate) struct Merge<'a> {
    symbols: &'a mut Symbols,
    /// The common symbol of a pair, and the offset on the first path that it stands for.
    pairs: HashMap<Pair, (Symbol, u32)>,
}

impl<'a> Merge<'a> {
    /// For the join of two paths.
    pub(crate) fn new(symbols: &'a mut Symbols) -> Self {
        Self {
            symbols,
            pairs: HashMap::new(),
        }
    }

    /// A value that is `a` on one path and `b` on the other.
    pub(crate) fn value(&mut self, a: &Value, b: &Value) -> Value {
        if a == b {
            return *a;
        }
        let range = a.range.join(b.range);
        let stack = a.stack || b.stack;
        if let (Some((s, x)), Some((t, y))) = (a.base, b.base)
            && s == t
        {
            let base = Some((s, x.join(y))).filter(|(_, offset)| !offset.is_all());
            return Value { range, base, stack };
        }
        let anchored = |value: &Value| match value.base {
            Some((symbol, offset)) => offset.as_constant().map(|offset| (Some(symbol), offset)),
            None => value.as_constant().map(|constant| (None, constant)),
        };
        let base = match (anchored(a), anchored(b)) {
            (Some((s, x)), Some((t, y))) => {
                let key = (s, t, x.wrapping_sub(y));
                let symbols = &mut *self.symbols;
                let (symbol, origin) = *self.pairs.entry(key).or_insert_with(|| {
                    let words = symbols.elements(a).zip(symbols.elements(b));
                    match words {
                        Some((mut ours, theirs)) if ours.len() + theirs.len() <= MAX_ELEMENTS => {
                            ours.extend(theirs);
                            ours.sort_unstable();
                            ours.dedup();
                            (symbols.define(Definition::OneOf(ours)), x)
                        }
                        _ => (symbols.fresh_within(&[a, b]), x),
                    }
                });
                Some((symbol, Range::constant(x.wrapping_sub(origin))))
            }
            _ => Some((self.symbols.fresh_within(&[a, b]), Range::constant(0))),
        };
        Value { range, base, stack }
    }

    /// The stack where the two paths meet.
    ///
    /// A stack slot known on only one path becomes unknown; if it held a stack address, a
    /// slot stays behind that says that it may hold one.
    pub(crate) fn stack(&mut self, a: &Slots, b: &Slots) -> Slots {
        if a.shares(b) {
            return a.clone();
        }
        let (mut a, mut b) = (a.as_slice(), b.as_slice());
        let mut joined: Vec<Slot> = Vec::with_capacity(a.len().max(b.len()));
        loop {
            match (a, b) {
                ([x, rest @ ..], [y, others @ ..]) if x.same_place(y) => {
                    joined.push(Slot {
                        value: self.value(&x.value, &y.value),
                        ..*x
                    });
                    (a, b) = (rest, others);
                }
                ([x, ..], [y, others @ ..]) if y.address < x.address => {
                    only_one(&mut joined, y);
                    b = others;
                }
                ([x, rest @ ..], _) => {
                    only_one(&mut joined, x);
                    a = rest;
                }
                ([], [y, others @ ..]) => {
                    only_one(&mut joined, y);
                    b = others;
                }
                ([], []) => return Slots::from_sorted(joined),
            }
        }
    }
}

/// Adds a slot that only one path knows, if it may hold a stack address and does not overlap
/// the slot before.
fn only_one(joined: &mut Vec<Slot>, slot: &Slot) {
    if slot.value.stack && joined.last().is_none_or(|last| last.end() <= slot.address) {
        joined.push(Slot {
            value: Value::MAYBE_STACK,
            ..*slot
        });
    }
}
