//! The abstract machine: registers, flags and the stack of one task.

use std::collections::HashMap;
use std::ops::{Index, IndexMut};
use std::rc::Rc;

use rsemu::cpu::arm::v7m::isa::Cond;

use super::cycles::Cycles;
use super::flags::{self, Flags, Source};
use super::flash::Accelerator;
use super::lasting::{Words, Written};
use super::layout::STACK_TOP;
use super::mask::{ExceptionMask, Masked};
use super::merge::Merge;
use super::range::Range;
use super::register::{Register, Results};
use super::slots::Slots;
use super::symbols::Symbols;
use super::value::{Symbol, Value};

/// The core registers `r0` to `r14`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Registers([Value; 15]);

impl Registers {
    /// The registers in ascending order.
    pub(crate) fn iter(&self) -> impl Iterator<Item = (Register, &Value)> {
        (0..).map(Register::new).zip(&self.0)
    }

    /// The values, to change them.
    pub(crate) fn values_mut(&mut self) -> impl Iterator<Item = &mut Value> {
        self.0.iter_mut()
    }
}

impl Index<Register> for Registers {
    type Output = Value;

    fn index(&self, register: Register) -> &Value {
        &self.0[register.index()]
    }
}

impl IndexMut<Register> for Registers {
    fn index_mut(&mut self, register: Register) -> &mut Value {
        &mut self.0[register.index()]
    }
}

/// Everything that holds at one point of a path, for every execution that reaches it.
#[derive(Debug, Clone)]
pub(crate) struct State {
    /// `r0` to `r12`, the stack pointer and the link register.
    pub registers: Registers,
    /// The single-precision registers, as words.
    pub floats: Rc<[Value; 32]>,
    /// Known words of the stack.
    pub stack: Slots,
    /// Words outside the stack that hold addresses; kept until a task can run.
    pub memory: Rc<Words>,
    /// Bytes of variables that began as zeros to which something else may have been written; kept until a task
    /// can run.
    pub touched: Rc<Written>,
    /// The address for which the last load-exclusive has reserved a store.
    pub reserved: Option<u32>,
    /// Bytes outside the stack that were written since `PRIMASK` was set, each by its address.
    pub held: Rc<Words>,
    /// Condition flags.
    pub flags: Flags,
    /// `BASEPRI`.
    pub basepri: Value,
    /// `PRIMASK`.
    pub primask: ExceptionMask,
    /// `FAULTMASK`.
    pub faultmask: ExceptionMask,
    /// True if an address on the stack was stored where words are not tracked, so any load
    /// may give it.
    pub escaped: bool,
    /// Longest time since the task began.
    pub cycles: Cycles,
    /// The flash memory and its caches, as flashed.
    pub flash: Accelerator,
    /// What the previous instruction may have left.
    pub left: Results,
    /// Critical sections that are still running.
    pub masked: Vec<Masked>,
    /// True if a task could run since reset. False only in start-up code.
    pub started: bool,
    /// True if a reset of the part was requested.
    pub resetting: bool,
    /// True if the register of which the word is known ([`crate::reading::Reading`]) may give another.
    pub moved_up: bool,
}

impl State {
    /// At the entry of a function with unknown arguments, which finds `basepri` in `BASEPRI`.
    #[must_use]
    pub(crate) fn entry(symbols: &mut Symbols, basepri: Symbol) -> Self {
        let mut registers = Registers([Value::ANY; 15]);
        for register in registers.values_mut() {
            *register = symbols.unknown();
        }
        registers[Register::SP] = Value {
            range: Range::constant(STACK_TOP),
            base: None,
            stack: true,
        };
        Self {
            registers,
            floats: Rc::new([Value::ANY; 32]),
            stack: Slots::default(),
            memory: Rc::default(),
            touched: Rc::default(),
            reserved: None,
            held: Rc::default(),
            flags: Flags::ANY,
            // The register has eight bits (DDI 0403 B1.4.3).
            basepri: Value {
                base: Some((basepri, Range::constant(0))),
                ..Value::within(Range::between(0, 0xff))
            },
            primask: ExceptionMask::Clear,
            faultmask: ExceptionMask::Clear,
            escaped: false,
            cycles: Cycles::ZERO,
            flash: Accelerator::unknown(None),
            left: Results::ALL,
            masked: Vec::new(),
            started: true,
            resetting: false,
            moved_up: false,
        }
    }

    /// The stack pointer, if it is known.
    #[must_use]
    pub(crate) fn stack_pointer(&self) -> Option<u32> {
        self.registers[Register::SP].as_constant()
    }

    /// The critical section that has been running for the longest time, if a task can be masked
    /// by one: none can before the first task could run.
    #[must_use]
    pub(crate) fn outermost_section(&self) -> Option<&Masked> {
        self.masked.first().filter(|_| self.started)
    }

    /// Adds `cycles` to every clock of this path. Meanwhile the flash goes on.
    pub(crate) fn spend(&mut self, cycles: Cycles) {
        self.flash.pass(cycles.flashed);
        self.wait(cycles);
    }

    /// Adds `cycles` of which the state of the flash knows already.
    pub(crate) fn wait(&mut self, cycles: Cycles) {
        self.cycles += cycles;
        for section in &mut self.masked {
            section.cycles += cycles;
        }
    }

    /// Sets a floating-point register.
    pub(crate) fn set_float(&mut self, index: usize, value: Value) {
        if self.floats[index] != value {
            Rc::make_mut(&mut self.floats)[index] = value;
        }
    }

    /// Restricts the path to executions on which `value` lies in `range`. False if there are
    /// none.
    #[must_use]
    pub(crate) fn assume(&mut self, value: &Value, range: Range) -> bool {
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
        for register in self.registers.values_mut() {
            match refine(register) {
                Some(refined) => *register = refined,
                None => return false,
            }
        }
        let related = |value: &Value| matches!(value.base, Some((s, _)) if s == symbol);
        let slots = self.stack.as_slice();
        if slots.iter().any(|slot| related(&slot.value)) {
            let mut possible = true;
            self.stack.update(|value| match refine(value) {
                Some(refined) => *value = refined,
                None => possible = false,
            });
            if !possible {
                return false;
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
    pub(crate) fn given(&self, condition: Cond) -> Option<Self> {
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

    /// Everything that holds on both paths. Clocks keep the longer time.
    #[must_use]
    pub(crate) fn join(&self, other: &Self, symbols: &mut Symbols) -> Self {
        let mut merge = Merge::new(symbols);
        let mut registers = self.registers;
        for (register, (_, theirs)) in registers.values_mut().zip(other.registers.iter()) {
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
        let stack = merge.stack(&self.stack, &other.stack);
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
        let memory = common(&self.memory, &other.memory);
        let primask = self.primask.join(other.primask);
        let held = match primask {
            ExceptionMask::Set => common(&self.held, &other.held),
            _ => Rc::default(),
        };
        symbols.mixed |= self.started != other.started;
        let touched = union(&self.touched, &other.touched);
        Self {
            registers,
            floats,
            stack,
            memory,
            touched,
            reserved: self.reserved.filter(|_| self.reserved == other.reserved),
            held,
            flags: Flags {
                possible: self.flags.possible | other.flags.possible,
                source,
            },
            basepri,
            primask,
            faultmask: self.faultmask.join(other.faultmask),
            escaped: self.escaped || other.escaped,
            cycles: self.cycles.max(other.cycles),
            flash: self.flash.join(&other.flash),
            left: self.left | other.left,
            masked: join_sections(&self.masked, &other.masked),
            started: self.started || other.started,
            resetting: self.resetting && other.resetting,
            moved_up: self.moved_up || other.moved_up,
        }
    }

    /// Whether `other` differs only in the names of symbols and in clocks, so that running on
    /// from either one gives the same result.
    #[must_use]
    pub(crate) fn same_machine(&self, other: &Self) -> bool {
        if self.flags.possible != other.flags.possible
            || self.primask != other.primask
            || self.faultmask != other.faultmask
            || self.escaped != other.escaped
            || self.moved_up != other.moved_up
            || self.stack.as_slice().len() != other.stack.as_slice().len()
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
        let mut registers = self.registers.iter().zip(other.registers.iter());
        let slots = self.stack.as_slice().iter();
        let mut slots = slots.zip(other.stack.as_slice());
        registers.all(|((_, a), (_, b))| same(a, b))
            && slots.all(|(a, b)| a.same_place(b) && same(&a.value, &b.value))
            && same(&self.basepri, &other.basepri)
    }
}

/// The running critical sections where two paths meet: those of either path, with the longer
/// time for one that both have.
fn join_sections(ours: &[Masked], theirs: &[Masked]) -> Vec<Masked> {
    let mut joined = ours.to_vec();
    for other in theirs {
        match joined.iter_mut().find(|known| known.level == other.level) {
            Some(known) => {
                if known.cycles.flashed < other.cycles.flashed {
                    known.at = other.at;
                }
                known.cycles = known.cycles.max(other.cycles);
                known.since = known.since.min(other.since);
                known.handed &= other.handed;
            }
            None => joined.push(*other),
        }
    }
    joined
}

/// The bytes of both.
#[must_use]
pub(crate) fn union(a: &Rc<Written>, b: &Rc<Written>) -> Rc<Written> {
    if Rc::ptr_eq(a, b) || b.is_subset(a) {
        return a.clone();
    }
    Rc::new(a.union(b).copied().collect())
}

/// The words that are the same in both.
#[must_use]
pub(crate) fn common(a: &Rc<Words>, b: &Rc<Words>) -> Rc<Words> {
    if Rc::ptr_eq(a, b) || a == b {
        return a.clone();
    }
    let kept = a.iter().filter(|(at, word)| b.get(at) == Some(word));
    Rc::new(kept.map(|(at, word)| (*at, *word)).collect())
}
