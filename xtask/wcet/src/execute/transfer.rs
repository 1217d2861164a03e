//! Loads and stores of core registers.

use rsemu::cpu::arm::v7m::isa::{Insn, MemOffset};

use crate::range::Range;
use crate::register::{Register, RegisterSet};
use crate::value::Value;

use super::data::shifted_left;
use super::step::Step;

impl Step<'_, '_> {
    /// `base` plus or minus a constant.
    pub(super) fn displaced(base: &Value, by: u32, add: bool) -> Value {
        let by = Value::constant(by);
        if add {
            base.add(&by)
        } else {
            base.subtract(&by)
        }
    }

    /// The program counter as the base of a load.
    pub(super) fn literal_base(&self) -> Value {
        Value::constant(self.pc() & !3)
    }

    pub(super) fn load_or_store(&mut self) {
        let Insn::LoadStore {
            load,
            size,
            signed,
            rt,
            rn,
            offset,
            index,
            add,
            wback,
            ..
        } = self.instruction.insn
        else {
            return;
        };
        let base = self.read(rn);
        let delta = match offset {
            MemOffset::Imm(value) => Value::constant(value),
            MemOffset::Reg { rm, lsl } => {
                let delta = shifted_left(&self.read(rm), lsl);
                self.named(delta)
            }
        };
        let moved = self.moved(&base, &delta, add);
        let address = if index { moved } else { base };
        self.access(&address, load, size.bytes(), 1);
        if load {
            let value = match self.machine.zeros.contains(&self.instruction.address) {
                true => Value::constant(0),
                false => self.load(&address, size.bytes(), signed),
            };
            if wback {
                self.set(rn, moved);
            }
            self.write(rt, value);
        } else {
            let value = self.read(rt);
            self.store(&address, size.bytes(), &value);
            if wback {
                self.set(rn, moved);
            }
        }
    }

    pub(super) fn load_literal(&mut self) {
        let Insn::LoadLiteral {
            size,
            signed,
            rt,
            imm,
            add,
        } = self.instruction.insn
        else {
            return;
        };
        let address = Self::displaced(&self.literal_base(), imm, add);
        self.access(&address, true, size.bytes(), 1);
        let value = self.load(&address, size.bytes(), signed);
        self.write(rt, value);
    }

    pub(super) fn load_or_store_dual(&mut self) {
        let Insn::LoadStoreDual {
            load,
            rt,
            rt2,
            rn,
            imm,
            index,
            add,
            wback,
        } = self.instruction.insn
        else {
            return;
        };
        let literal = Register::new(rn) == Register::PC;
        let base = if literal {
            self.literal_base()
        } else {
            self.read(rn)
        };
        let moved = Self::displaced(&base, imm, add);
        let address = if index { moved } else { base };
        let second = address.add(&Value::constant(4));
        self.access(&address, load, 4, 2);
        if load {
            let (a, b) = (self.load(&address, 4, false), self.load(&second, 4, false));
            self.set(rt, a);
            self.set(rt2, b);
        } else {
            let (a, b) = (self.read(rt), self.read(rt2));
            self.store(&address, 4, &a);
            self.store(&second, 4, &b);
        }
        if wback && !literal {
            self.set(rn, moved);
        }
    }

    pub(super) fn load_or_store_exclusive(&mut self) {
        let Insn::LoadStoreExclusive {
            load,
            size,
            rd,
            rt,
            rn,
            imm,
        } = self.instruction.insn
        else {
            return;
        };
        let address = self.read(rn).add(&Value::constant(imm));
        self.access(&address, load, size.bytes(), 1);
        if load {
            let value = self.load(&address, size.bytes(), false);
            self.set(rt, value);
            self.state.reserved = address.as_constant();
        } else if self.certainly_stores(&address) {
            let value = self.read(rt);
            self.store(&address, size.bytes(), &value);
            self.set(rd, Value::constant(0));
        } else {
            // The store may fail, so the bytes hold the old value or the new one.
            self.store(&address, size.bytes(), &Value::ANY);
            self.set(rd, Value::within(Range::between(0, 1)));
        }
    }

    /// Whether a store-exclusive certainly succeeds: only an exception could come between it and the load-exclusive of
    /// the same word (DDI 0403 A3.4.1), and in start-up none does from which the program comes back.
    fn certainly_stores(&mut self, address: &Value) -> bool {
        let reserved = self.state.reserved.take();
        reserved.is_some()
            && reserved == address.as_constant()
            && !self.state.started
            && self.machine.memory.starts_alone
    }

    pub(super) fn load_or_store_multiple(&mut self) {
        let Insn::LoadStoreMultiple {
            load,
            rn,
            list,
            wback,
            before,
        } = self.instruction.insn
        else {
            return;
        };
        let list = RegisterSet::from_bits(list);
        let base = self.read(rn);
        let bytes = Value::constant(4 * list.len());
        let (start, end) = if before {
            let start = base.subtract(&bytes);
            (start, start)
        } else {
            (base, base.add(&bytes))
        };
        self.access(&start, load, 4, list.len());
        let places = (0..)
            .step_by(4)
            .map(|offset| start.add(&Value::constant(offset)));
        let words = list.iter().map(Register::number).zip(places);
        if load {
            let values: Vec<(u8, Value)> = words
                .map(|(register, at)| (register, self.load(&at, 4, false)))
                .collect();
            if wback {
                self.set(rn, end);
            }
            for (register, value) in values {
                self.write(register, value);
            }
        } else {
            for (register, at) in words {
                let value = self.read(register);
                self.store(&at, 4, &value);
            }
            if wback {
                self.set(rn, end);
            }
        }
    }
}
