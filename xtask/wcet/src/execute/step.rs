//! One instruction during its execution.

use crate::instruction::Instruction;
use crate::lasting::{FAR, reach};
use crate::layout::STACK;
use crate::range::Range;
use crate::register::Register;
use crate::state::State;
use crate::symbols::{Definition, Symbols};
use crate::value::Value;

use super::executor::{Access, Effects, Executor};

/// One instruction, the state that it changes and its other effects so far.
pub(super) struct Step<'s, 'a> {
    pub(super) machine: &'s mut Executor<'a>,
    pub(super) state: &'s mut State,
    pub(super) instruction: &'s Instruction,
    pub(super) effects: Effects,
}

impl Step<'_, '_> {
    pub(super) fn symbols(&mut self) -> &mut Symbols {
        &mut self.machine.symbols
    }

    /// The program counter as the instruction reads it.
    pub(super) fn pc(&self) -> u32 {
        self.instruction.address.wrapping_add(4)
    }

    /// The value of a core register.
    pub(super) fn read(&self, register: u8) -> Value {
        match Register::new(register) {
            Register::PC => Value::constant(self.pc()),
            register => self.state.registers[register],
        }
    }

    /// Writes a core register; the program counter keeps its value ([`Self::write`]).
    pub(super) fn set(&mut self, register: u8, value: Value) {
        let value = self.named(value);
        let register = Register::new(register);
        if register == Register::PC {
            return;
        }
        if register == Register::SP
            && let (Some(old), Some(new)) = (self.state.stack_pointer(), value.as_constant())
            && new > old
        {
            self.state.stack.drop_below(new);
        }
        self.state.registers[register] = value;
    }

    /// Writes a core register; a write to the program counter is a branch.
    pub(super) fn write(&mut self, register: u8, value: Value) {
        if Register::new(register) == Register::PC {
            self.effects.target = Some(value);
        } else {
            self.set(register, value);
        }
    }

    /// Makes a core register unknown.
    pub(super) fn forget(&mut self, register: u8) {
        self.set(register, Value::ANY);
    }

    /// Gives an unknown value a symbol, so that it can be recognised.
    pub(super) fn named(&mut self, mut value: Value) -> Value {
        if value.base.is_none() && value.as_constant().is_none() {
            value.base = Some((self.symbols().fresh(), Range::constant(0)));
        }
        value
    }

    /// The value with a symbol that is defined so, unless it is a constant.
    pub(super) fn defined(&mut self, value: Value, definition: Definition) -> Value {
        if value.as_constant().is_some() {
            return value;
        }
        Value {
            base: Some((self.symbols().define(definition), Range::constant(0))),
            ..value
        }
    }

    /// `base` plus or minus `delta`, with its source noted.
    pub(super) fn moved(&mut self, base: &Value, delta: &Value, add: bool) -> Value {
        if add {
            let moved = base.add(delta);
            self.symbols().moved(moved, base, delta)
        } else {
            let moved = base.subtract(delta);
            self.symbols().moved_down(moved, base, delta)
        }
    }

    /// Notes the memory access: `count` transfers of `size` bytes.
    pub(super) fn access(&mut self, address: &Value, load: bool, size: u32, count: u32) {
        self.effects.access = Some(Access {
            address: self.accessed(address, size),
            load,
            size,
            count,
        });
    }

    /// Where an access certainly goes, as narrowly as that is known: an address that may be anything is still
    /// in the variable that it was computed from.
    fn accessed(&self, address: &Value, size: u32) -> Range {
        if address.range.span() < FAR {
            return address.range;
        }
        let stretch = reach(&self.machine.symbols, address, size);
        let within = stretch.map_or(STACK, |to| Range::between(to.first, to.last));
        address.range.meet(within).unwrap_or(within)
    }
}
