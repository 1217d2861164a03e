//! The abstract machine: registers, flags and the stack of one task.

use std::collections::HashMap;
use std::rc::Rc;

use rsemu::cpu::arm::v7m::isa::Cond;

use super::flags::{self, Flags, Source};
use super::image::Variables;
use super::lasting::Words;
use super::range::Range;
use super::value::{Symbol, Value};

/// Where the analysis pretends the stack to be: an address that no part of
/// the targets maps, so that stack and static data are never confused. Only
/// the low three bits are meaningful (the stack is 8-byte aligned on entry).
pub const STACK_TOP: u32 = 0xa010_0000;
/// Lowest address taken for the stack.
pub const STACK_LIMIT: u32 = 0xa000_0000;
/// Everything taken for the stack, the caller's frames above included.
pub const STACK: Range = Range::arc(STACK_LIMIT, 0x0020_0000, 1);

/// Core cycles under each timing model: as the emulator charges them, and as
/// the part runs from its flash.
pub type Cycles = [u64; 2];

/// The longer of two times under each model.
#[must_use]
pub fn longer(a: Cycles, b: Cycles) -> Cycles {
    [a[0].max(b[0]), a[1].max(b[1])]
}

/// What a symbol is known to stand for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Definition {
    /// One of these words, in order.
    OneOf(Vec<u32>),
    /// `(of * factor) >> shift`, computed without loss, of a dividend below
    /// 2^32: the way compilers divide by a constant.
    Scaled {
        /// The dividend.
        of: Value,
        /// The factor.
        factor: u32,
        /// The shift, 32 or more.
        shift: u32,
    },
    /// The quotient of a division.
    Quotient {
        /// The dividend.
        of: Value,
        /// The divisor.
        by: Value,
    },
    /// A product of two words.
    Product(Value, Value),
}

/// What a word was computed from, as far as it may be an address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum From {
    /// The address of a static variable, by its first and last byte.
    Variable((u32, u32)),
    /// A distance to or from a variable: with an address added to it, it is
    /// not that address's variable that the sum lies in.
    Difference,
    /// Neither, as far as is known.
    Elsewhere,
}

/// Words that a set may hold before it becomes a mere range.
const MAX_ELEMENTS: usize = 256;

/// Source of fresh symbols, and what is known of them.
#[derive(Debug, Default)]
pub struct Symbols {
    last: u32,
    definitions: HashMap<Symbol, Definition>,
    /// The static variables of the image.
    variables: Variables,
    /// Sums of a symbol and the address of an element of a variable: the offset
    /// from the symbol, and that address.
    indices: HashMap<Symbol, Vec<(u32, u32)>>,
    /// What symbols were computed from, except those from elsewhere.
    sources: HashMap<Symbol, From>,
    /// Paths met of which one had enabled interrupts and one had not.
    pub mixed: bool,
}

impl Symbols {
    /// No symbol yet, for an image with these variables.
    #[must_use]
    pub fn of(variables: &Variables) -> Self {
        Self {
            variables: variables.clone(),
            ..Self::default()
        }
    }

    /// A symbol that was never used before.
    pub fn fresh(&mut self) -> Symbol {
        self.last += 1;
        Symbol(self.last)
    }

    /// A fresh symbol that stands for this.
    pub fn define(&mut self, definition: Definition) -> Symbol {
        let symbol = self.fresh();
        self.definitions.insert(symbol, definition);
        symbol
    }

    /// The static variable, by its first and last byte, from whose address
    /// `value` was computed, if that is known.
    #[must_use]
    pub fn origin(&self, value: &Value) -> Option<(u32, u32)> {
        match self.source(value) {
            From::Variable(variable) => Some(variable),
            From::Difference | From::Elsewhere => None,
        }
    }

    /// First and last byte that an access with an unknown index reaches, where
    /// `value` is that index and the address of an element known from the code:
    /// the array. An element further on may be that of another array whose
    /// index has a constant part: there are some bytes to both sides of it.
    #[must_use]
    pub fn indexed(&self, value: &Value) -> Option<(u32, u32)> {
        const PART: u32 = 32;
        let (symbol, offset) = value.base?;
        if self.sources.contains_key(&symbol) {
            return None;
        }
        let mut elements = self.elements_at(symbol, offset);
        let (element, None) = (elements.next()?, elements.next()) else {
            return None;
        };
        let variable = self.variables.around(element)?;
        let (first, last) = self.variables.array(element).unwrap_or(variable);
        if element - first < PART {
            return Some((first, last));
        }
        Some((first.min(element - PART), last.max(element + PART)))
    }

    /// The elements that a symbol and `offset` may lie with in one array: by
    /// the addresses in the code to which the symbol was added, moved by as
    /// much as the sums differ.
    fn elements_at(&self, symbol: Symbol, offset: Range) -> impl Iterator<Item = u32> {
        let sums = self.indices.get(&symbol).into_iter().flatten();
        sums.filter_map(move |&(sum, element)| {
            let (first, last) = self.variables.around(element)?;
            let (low, high) = offset.subtract(Range::constant(sum)).signed();
            let size = i64::from(last - first);
            let near = i64::from(low).abs().max(i64::from(high).abs()) <= size;
            near.then(|| element.wrapping_add_signed(low).clamp(first, last))
        })
    }

    fn source(&self, value: &Value) -> From {
        let around = |range: Range| {
            let first = self.variables.around(range.start())?;
            let last = range.start().checked_add(range.span())?;
            (last <= first.1).then_some(From::Variable(first))
        };
        let named = |(symbol, offset): (Symbol, Range)| match self.sources.get(&symbol) {
            Some(&From::Variable((first, last))) => {
                // Further than the variable is long: a distance was added that
                // leads to another.
                let (low, high) = offset.signed();
                let size = i64::from(last - first);
                (i64::from(low).abs().max(i64::from(high).abs()) <= size)
                    .then_some(From::Variable((first, last)))
            }
            Some(other) => Some(*other),
            None => {
                let mut elements = self.elements_at(symbol, offset);
                let first = self.variables.around(elements.next()?)?;
                elements
                    .all(|at| self.variables.around(at) == Some(first))
                    .then_some(From::Variable(first))
            }
        };
        around(value.range)
            .or_else(|| value.base.and_then(named))
            .unwrap_or(From::Elsewhere)
    }

    /// A fresh symbol for a value computed from each of these: where all lie
    /// within one variable it does too.
    pub fn fresh_within(&mut self, from: &[&Value]) -> Symbol {
        let mut sources = from.iter().map(|value| self.source(value));
        let source = sources.next().unwrap_or(From::Elsewhere);
        let source = sources.fold(source, |a, b| match (a, b) {
            _ if a == b => a,
            (From::Difference, _) | (_, From::Difference) => From::Difference,
            _ => From::Elsewhere,
        });
        self.fresh_from(source)
    }

    fn fresh_from(&mut self, source: From) -> Symbol {
        let symbol = self.fresh();
        if source != From::Elsewhere {
            self.sources.insert(symbol, source);
        }
        symbol
    }

    /// `result` is the sum of a place within a variable and a distance, and so
    /// within the variable too, or it is an address that was aligned.
    pub fn moved(&mut self, result: Value, from: &Value, by: &Value) -> Value {
        let source = match (self.source(from), self.source(by)) {
            (From::Difference, _) | (_, From::Difference) => From::Difference,
            (variable, From::Elsewhere) | (From::Elsewhere, variable) => variable,
            _ => From::Elsewhere,
        };
        let element = [from, by].map(|value| value.as_constant());
        if let (From::Variable(_), [Some(element), None] | [None, Some(element)]) =
            (source, element)
            && let Some((symbol, offset)) = result.base
        {
            let sums = self.indices.entry(symbol).or_default();
            let sum = (offset.start(), element);
            if !sums.contains(&sum) {
                sums.push(sum);
            }
        }
        self.from(result, source)
    }

    /// The same of `from` less `by`.
    pub fn moved_down(&mut self, result: Value, from: &Value, by: &Value) -> Value {
        let source = match (self.source(from), self.source(by)) {
            (source, From::Elsewhere) => source,
            _ => From::Difference,
        };
        self.from(result, source)
    }

    fn from(&mut self, mut result: Value, source: From) -> Value {
        if result.as_constant().is_none() && result.base.is_none() && source != From::Elsewhere {
            result.base = Some((self.fresh_from(source), Range::constant(0)));
        }
        result
    }

    /// What `value` is by definition, if its symbol has one and the value is
    /// the symbol itself.
    #[must_use]
    pub fn definition(&self, value: &Value) -> Option<&Definition> {
        match value.base {
            Some((symbol, offset)) if offset.as_constant() == Some(0) => {
                self.definitions.get(&symbol)
            }
            _ => None,
        }
    }

    /// Every word that `value` may be, if they are known one by one.
    #[must_use]
    pub fn elements(&self, value: &Value) -> Option<Vec<u32>> {
        if let Some(word) = value.as_constant() {
            return Some(vec![word]);
        }
        let (symbol, offset) = value.base?;
        let offset = offset.as_constant()?;
        match self.definitions.get(&symbol)? {
            Definition::OneOf(words) => Some(
                words
                    .iter()
                    .map(|word| word.wrapping_add(offset))
                    .filter(|word| value.range.contains(*word))
                    .collect(),
            ),
            _ => None,
        }
    }

    /// A value that is one of `words`.
    pub fn one_of(&mut self, mut words: Vec<u32>) -> Option<Value> {
        words.sort_unstable();
        words.dedup();
        let range = words
            .iter()
            .map(|word| Range::constant(*word))
            .reduce(Range::join)?;
        let base = if words.len() > 1 && words.len() <= MAX_ELEMENTS {
            Some((self.define(Definition::OneOf(words)), Range::constant(0)))
        } else {
            None
        };
        Some(Value {
            range,
            base,
            stack: false,
        })
    }
}

/// A stretch of the path with interrupts masked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Masked {
    /// Value of `BASEPRI`, zero for `PRIMASK`: everything at or below it waits.
    pub level: u8,
    /// Longest time since it was raised.
    pub cycles: Cycles,
    /// Address of the instruction that raised it.
    pub at: u32,
}

/// One entry of the abstract stack: address, bytes, value.
pub type Slot = (u32, u32, Value);

/// What holds at one point of a path, for every execution that gets there.
#[derive(Debug, Clone)]
pub struct State {
    /// `r0`-`r12`, the stack pointer and the link register.
    pub registers: [Value; 15],
    /// The single-precision registers, as words.
    pub floats: Rc<[Value; 32]>,
    /// Known words of the stack, by address.
    pub stack: Rc<Vec<Slot>>,
    /// Addresses that memory elsewhere holds, until interrupts are enabled.
    pub memory: Rc<Words>,
    /// Condition flags.
    pub flags: Flags,
    /// `BASEPRI`.
    pub basepri: Value,
    /// `PRIMASK`, if known.
    pub primask: Option<bool>,
    /// Whether an address on the stack was stored where it is not tracked.
    pub escaped: bool,
    /// Longest time since the task began.
    pub cycles: Cycles,
    /// The flash line fetched last, under each timing model that has lines.
    pub line: Option<u32>,
    /// Registers that the instruction before may have written.
    pub written: u16,
    /// Masks in force.
    pub masked: Vec<Masked>,
    /// Whether interrupts have been enabled since reset (start-up code).
    pub started: bool,
}

impl State {
    /// At the entry of a function called with nothing known.
    #[must_use]
    pub fn entry(symbols: &mut Symbols) -> Self {
        let unknown = |symbols: &mut Symbols| Value {
            base: Some((symbols.fresh(), Range::constant(0))),
            ..Value::ANY
        };
        let mut registers = [Value::ANY; 15];
        for register in &mut registers {
            *register = unknown(symbols);
        }
        registers[13] = Value {
            range: Range::constant(STACK_TOP),
            base: None,
            stack: true,
        };
        Self {
            registers,
            floats: Rc::new([Value::ANY; 32]),
            stack: Rc::new(Vec::new()),
            memory: Rc::default(),
            flags: Flags::ANY,
            basepri: unknown(symbols),
            primask: Some(false),
            escaped: false,
            cycles: [0; 2],
            line: None,
            written: u16::MAX,
            masked: Vec::new(),
            started: true,
        }
    }

    /// The stack pointer, if it is known.
    #[must_use]
    pub fn stack_pointer(&self) -> Option<u32> {
        self.registers[13].as_constant()
    }

    /// Adds `cycles` to every clock of this path.
    pub fn spend(&mut self, cycles: Cycles) {
        let clocks = self.masked.iter_mut().map(|mask| &mut mask.cycles);
        for clock in clocks.chain([&mut self.cycles]) {
            clock[0] += cycles[0];
            clock[1] += cycles[1];
        }
    }

    /// Reads `size` bytes of the stack at a known address.
    #[must_use]
    pub fn load_stack(&self, address: u32, size: u32) -> Option<Value> {
        let index = self
            .stack
            .partition_point(|&(at, bytes, _)| at + bytes <= address);
        let &(at, bytes, value) = self.stack.get(index)?;
        if at == address && bytes == size {
            return Some(value);
        }
        if at <= address && address + size <= at + bytes {
            let word = value.as_constant()? >> (8 * (address - at));
            return Some(Value::constant(if size == 4 {
                word
            } else {
                word & ((1 << (8 * size)) - 1)
            }));
        }
        // A word put together from known parts.
        let mut word = 0;
        let mut covered = 0;
        for &(at, bytes, value) in self.stack[index..].iter() {
            if at != address + covered || covered + bytes > size {
                return None;
            }
            word |= value.as_constant()? << (8 * covered);
            covered += bytes;
            if covered == size {
                return Some(Value::constant(word));
            }
        }
        None
    }

    /// Forgets what the stack holds within `size` bytes from every address
    /// of `addresses`.
    pub fn forget_stack(&mut self, addresses: Range, size: u32) {
        let first = addresses.start();
        let reach = u64::from(addresses.span()) + u64::from(size);
        let touched = |at: u32, bytes: u32| {
            u64::from(at.wrapping_sub(first)) < reach || first.wrapping_sub(at) < bytes
        };
        if self.stack.iter().any(|&(at, bytes, _)| touched(at, bytes)) {
            Rc::make_mut(&mut self.stack).retain(|&(at, bytes, _)| !touched(at, bytes));
        }
    }

    /// Takes account of a write of `size` bytes to an unknown one of
    /// `addresses`: what may have been overwritten becomes unknown. `pointer`
    /// says whether an address on the stack was written.
    pub fn weaken_stack(&mut self, addresses: Range, size: u32, pointer: bool) {
        let first = addresses.start();
        let reach = u64::from(addresses.span()) + u64::from(size);
        let touched = |at: u32, bytes: u32| {
            u64::from(at.wrapping_sub(first)) < reach || first.wrapping_sub(at) < bytes
        };
        if self.stack.iter().any(|&(at, bytes, _)| touched(at, bytes)) {
            for (at, bytes, value) in Rc::make_mut(&mut self.stack) {
                if touched(*at, *bytes) {
                    *value = Value {
                        stack: value.stack || pointer,
                        ..Value::ANY
                    };
                }
            }
        }
        if !pointer {
            return;
        }
        // Words that were not tracked may hold the pointer now.
        if reach > 0x400 {
            self.escaped = true;
            return;
        }
        for at in (0..reach as u32).step_by(4) {
            let at = (first & !3).wrapping_add(at);
            let index = self.stack.partition_point(|&(a, b, _)| a + b <= at);
            let free = self.stack.get(index).is_none_or(|slot| slot.0 >= at + 4);
            if free {
                let value = Value {
                    stack: true,
                    ..Value::ANY
                };
                Rc::make_mut(&mut self.stack).insert(index, (at, 4, value));
            }
        }
    }

    /// Writes `size` bytes of the stack at a known address.
    pub fn store_stack(&mut self, address: u32, size: u32, value: Value) {
        // A constant that covers more than this write keeps its other bytes.
        let index = self
            .stack
            .partition_point(|&(at, bytes, _)| at + bytes <= address);
        if let Some(&(at, bytes, old)) = self.stack.get(index)
            && (at, bytes) != (address, size)
            && at <= address
            && address + size <= at + bytes
            && let (Some(old), Some(new)) = (old.as_constant(), value.as_constant())
        {
            let shift = 8 * (address - at);
            let mask = (((1u64 << (8 * size)) - 1) << shift) as u32;
            let word = (old & !mask) | ((new << shift) & mask);
            Rc::make_mut(&mut self.stack)[index].2 = Value::constant(word);
            return;
        }
        self.forget_stack(Range::constant(address), size);
        let stack = Rc::make_mut(&mut self.stack);
        let index = stack.partition_point(|&(at, _, _)| at < address);
        stack.insert(index, (address, size, value));
    }

    /// Forgets everything below the stack pointer.
    pub fn drop_below(&mut self, pointer: u32) {
        if self.stack.first().is_some_and(|&(at, _, _)| at < pointer) {
            Rc::make_mut(&mut self.stack).retain(|&(at, _, _)| at >= pointer);
        }
    }

    /// Restricts the path to executions on which `value` lies in `range`.
    /// False when there are none.
    #[must_use]
    pub fn assume(&mut self, value: &Value, range: Range) -> bool {
        let Some(kept) = value.range.meet(range) else {
            return false;
        };
        if kept == value.range {
            return true;
        }
        let Some((symbol, offset)) = value.base else {
            return true;
        };
        let refine = |other: &Value| -> Option<Value> {
            match other.base {
                Some((s, other_offset)) if s == symbol => {
                    let moved = kept.add(other_offset.subtract(offset));
                    let range = other.range.meet(moved)?;
                    Some(Value { range, ..*other })
                }
                _ => Some(*other),
            }
        };
        for register in &mut self.registers {
            match refine(register) {
                Some(refined) => *register = refined,
                None => return false,
            }
        }
        let related = |value: &Value| matches!(value.base, Some((s, _)) if s == symbol);
        if self.stack.iter().any(|(_, _, value)| related(value)) {
            for (_, _, value) in Rc::make_mut(&mut self.stack) {
                match refine(value) {
                    Some(refined) => *value = refined,
                    None => return false,
                }
            }
        }
        if let Some(source) = &mut self.flags.source {
            let refined = match source {
                Source::Difference(a, b) => refine(a)
                    .zip(refine(b))
                    .map(|(a, b)| Source::Difference(a, b)),
                Source::Result(value) => refine(value).map(Source::Result),
            };
            match refined {
                Some(refined) => *source = refined,
                None => return false,
            }
        }
        true
    }

    /// The executions of this path on which `condition` holds, if any.
    #[must_use]
    pub fn given(&self, condition: Cond) -> Option<Self> {
        let possible = self.flags.possible & flags::passing(condition);
        if possible == 0 {
            return None;
        }
        let mut state = self.clone();
        state.flags.possible = possible;
        if possible != self.flags.possible
            && let Some(source) = self.flags.source
        {
            for (value, range) in flags::consequences(&source, condition) {
                if !state.assume(&value, range) {
                    return None;
                }
            }
        }
        Some(state)
    }

    /// What holds on either path; clocks keep the longer time.
    #[must_use]
    pub fn join(&self, other: &Self, symbols: &mut Symbols) -> Self {
        let mut merge = Merge {
            symbols,
            pairs: HashMap::new(),
        };
        let mut registers = self.registers;
        for (register, theirs) in registers.iter_mut().zip(&other.registers) {
            *register = merge.value(register, theirs);
        }
        let floats = if Rc::ptr_eq(&self.floats, &other.floats) {
            self.floats.clone()
        } else {
            let mut floats = *self.floats;
            for (float, theirs) in floats.iter_mut().zip(other.floats.iter()) {
                *float = merge.value(float, theirs);
            }
            Rc::new(floats)
        };
        let stack = if Rc::ptr_eq(&self.stack, &other.stack) {
            self.stack.clone()
        } else {
            Rc::new(merge.stack(&self.stack, &other.stack))
        };
        let source = match (self.flags.source, other.flags.source) {
            (Some(Source::Difference(a, b)), Some(Source::Difference(c, d))) => {
                Some(Source::Difference(merge.value(&a, &c), merge.value(&b, &d)))
            }
            (Some(Source::Result(a)), Some(Source::Result(b))) => {
                Some(Source::Result(merge.value(&a, &b)))
            }
            _ => None,
        };
        let basepri = merge.value(&self.basepri, &other.basepri);
        let mut masked = self.masked.clone();
        for theirs in &other.masked {
            match masked.iter_mut().find(|ours| ours.level == theirs.level) {
                Some(ours) => {
                    if ours.cycles[1] < theirs.cycles[1] {
                        ours.at = theirs.at;
                    }
                    ours.cycles = longer(ours.cycles, theirs.cycles);
                }
                None => masked.push(*theirs),
            }
        }
        let memory = common(&self.memory, &other.memory);
        symbols.mixed |= self.started != other.started;
        Self {
            registers,
            floats,
            stack,
            memory,
            flags: Flags {
                possible: self.flags.possible | other.flags.possible,
                source,
            },
            basepri,
            primask: if self.primask == other.primask {
                self.primask
            } else {
                None
            },
            escaped: self.escaped || other.escaped,
            cycles: longer(self.cycles, other.cycles),
            line: self.line.filter(|_| self.line == other.line),
            written: self.written | other.written,
            masked,
            started: self.started || other.started,
        }
    }

    /// Whether the machine of `other` is the same but for the names of
    /// symbols: then running on from either gives the same.
    #[must_use]
    pub fn same_machine(&self, other: &Self) -> bool {
        if self.flags.possible != other.flags.possible
            || self.primask != other.primask
            || self.escaped != other.escaped
            || self.stack.len() != other.stack.len()
        {
            return false;
        }
        let mut names = HashMap::new();
        let mut same = |a: &Value, b: &Value| {
            if a.range != b.range || a.stack != b.stack {
                return false;
            }
            match (a.base, b.base) {
                (None, None) => true,
                (Some((s, a_offset)), Some((t, b_offset))) => {
                    let shift = a_offset.start().wrapping_sub(b_offset.start());
                    a_offset.span() == b_offset.span()
                        && *names.entry(s).or_insert((t, shift)) == (t, shift)
                        && (s != t || shift == 0)
                }
                _ => a.range.as_constant().is_some(),
            }
        };
        self.registers
            .iter()
            .zip(&other.registers)
            .all(|(a, b)| same(a, b))
            && self
                .stack
                .iter()
                .zip(other.stack.iter())
                .all(|(a, b)| (a.0, a.1) == (b.0, b.1) && same(&a.2, &b.2))
            && same(&self.basepri, &other.basepri)
    }

    /// A state that holds this one and `next`, reached in few steps: what
    /// differs becomes unknown.
    #[must_use]
    pub fn widen(&self, next: &Self, symbols: &mut Symbols) -> Self {
        let mut wide = self.join(next, symbols);
        let unknown = |symbols: &mut Symbols, stack: bool| Value {
            base: Some((symbols.fresh(), Range::constant(0))),
            stack,
            ..Value::ANY
        };
        for (index, register) in wide.registers.iter_mut().enumerate() {
            if register.range != self.registers[index].range {
                *register = unknown(symbols, register.stack);
            }
        }
        let old = self.stack.clone();
        Rc::make_mut(&mut wide.stack).retain(|slot| {
            old.iter().any(|before| {
                (before.0, before.1) == (slot.0, slot.1) && before.2.range == slot.2.range
            })
        });
        wide.floats = Rc::new([Value::ANY; 32]);
        wide.flags = Flags::ANY;
        wide
    }
}

/// The words that both hold.
#[must_use]
pub fn common(a: &Rc<Words>, b: &Rc<Words>) -> Rc<Words> {
    if Rc::ptr_eq(a, b) || a == b {
        return a.clone();
    }
    let kept = a.iter().filter(|(at, word)| b.get(at) == Some(word));
    Rc::new(kept.map(|(at, word)| (*at, *word)).collect())
}

/// The symbols of a value on two paths, and how far its offsets lie apart.
type Pair = (Option<Symbol>, Option<Symbol>, u32);

/// Joins the values of two paths and keeps the relations that hold on both.
struct Merge<'a> {
    symbols: &'a mut Symbols,
    /// Symbol pair and distance between the offsets, to the common symbol and
    /// the offset on the first path where it stands for zero.
    pairs: HashMap<Pair, (Symbol, u32)>,
}

impl Merge<'_> {
    fn value(&mut self, a: &Value, b: &Value) -> Value {
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

    /// Slots of one path only are dropped, except that an address on the
    /// stack leaves behind that there may be one.
    fn stack(&mut self, a: &[Slot], b: &[Slot]) -> Vec<Slot> {
        let mut joined: Vec<Slot> = Vec::with_capacity(a.len().max(b.len()));
        let alone = |joined: &mut Vec<Slot>, slot: &Slot| {
            if slot.2.stack && joined.last().is_none_or(|last| last.0 + last.1 <= slot.0) {
                let value = Value {
                    stack: true,
                    ..Value::ANY
                };
                joined.push((slot.0, slot.1, value));
            }
        };
        let (mut i, mut j) = (0, 0);
        while i < a.len() || j < b.len() {
            match (a.get(i), b.get(j)) {
                (Some(x), Some(y)) if (x.0, x.1) == (y.0, y.1) => {
                    joined.push((x.0, x.1, self.value(&x.2, &y.2)));
                    i += 1;
                    j += 1;
                }
                (Some(x), Some(y)) if x.0 <= y.0 => {
                    alone(&mut joined, x);
                    i += 1;
                }
                (Some(x), None) => {
                    alone(&mut joined, x);
                    i += 1;
                }
                (_, Some(y)) => {
                    alone(&mut joined, y);
                    j += 1;
                }
                (None, None) => break,
            }
        }
        joined
    }
}
