//! The floating-point unit. Moves are followed; results of arithmetic are unknown words.

use rsemu::cpu::arm::v7m::fpisa::{FpInsn, UnaryOp};

use crate::flags::Flags;
use crate::instruction::computed;
use crate::register::Register;
use crate::value::Value;

use super::step::Step;

/// Number of single-precision registers.
const FLOATS: usize = 32;

/// Index of a single-precision register.
fn index(register: u8) -> usize {
    usize::from(register) % FLOATS
}

impl Step<'_, '_> {
    pub(super) fn floating_point(&mut self, insn: FpInsn) {
        match insn {
            FpInsn::MovCore { to_fp, rt, n } => self.move_core(to_fp, rt, n),
            FpInsn::MovCore2 {
                to_fp, rt, rt2, m, ..
            } => {
                self.move_core(to_fp, rt, m);
                self.move_core(to_fp, rt2, m + 1);
            }
            FpInsn::MovImm { d, imm } => self.state.set_float(index(d), Value::constant(imm)),
            FpInsn::Unary {
                op: UnaryOp::Mov,
                d,
                m,
            } => {
                let value = self.state.floats[index(m)];
                self.state.set_float(index(d), value);
            }
            FpInsn::Sys { to_core, rt, .. } => {
                if to_core && Register::new(rt) == Register::PC {
                    self.state.flags = Flags::ANY;
                } else if to_core {
                    self.forget(rt);
                }
            }
            FpInsn::Mem { .. } | FpInsn::Multi { .. } => self.transfer_floats(insn),
            computes => {
                if let Some(d) = computed(computes) {
                    self.state.set_float(index(d), Value::ANY);
                }
            }
        }
    }

    /// Moves a word between a core register and a floating-point register.
    fn move_core(&mut self, to_float: bool, core: u8, float: u8) {
        if to_float {
            let value = self.read(core);
            self.state.set_float(index(float), value);
        } else {
            let value = self.state.floats[index(float)];
            self.set(core, value);
        }
    }

    /// Loads and stores.
    fn transfer_floats(&mut self, insn: FpInsn) {
        match insn {
            FpInsn::Mem {
                load,
                d,
                rn,
                imm,
                add,
                double,
            } => {
                let base = if Register::new(rn) == Register::PC {
                    self.literal_base()
                } else {
                    self.read(rn)
                };
                let address = Self::displaced(&base, imm, add);
                self.move_floats(load, d, &address, if double { 2 } else { 1 });
            }
            FpInsn::Multi {
                load,
                d,
                rn,
                count,
                add,
                writeback,
                ..
            } => {
                let base = self.read(rn);
                let count = u32::from(count);
                let end = Self::displaced(&base, 4 * count, add);
                let start = if add { base } else { end };
                self.move_floats(load, d, &start, count);
                if writeback {
                    self.set(rn, end);
                }
            }
            _ => {}
        }
    }

    fn move_floats(&mut self, load: bool, first: u8, address: &Value, count: u32) {
        self.access(address, load, 4, count);
        let registers = usize::from(first)..FLOATS;
        for (position, register) in (0..count).zip(registers) {
            let at = address.add(&Value::constant(4 * position));
            if load {
                let value = self.load(&at, 4, false);
                let value = self.named(value);
                self.state.set_float(register, value);
            } else {
                let value = self.state.floats[register];
                self.store(&at, 4, &value);
            }
        }
    }
}
