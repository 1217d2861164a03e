//! Data processing: moves, sums, logic and shifts.

use rsemu::cpu::arm::v7m::isa::{DpOp, Insn, Operand, Shift, ShiftType};

use crate::flags::{Flags, Source};
use crate::layout::STACK;
use crate::range::Range;
use crate::register::Register;
use crate::symbols::Definition;
use crate::value::Value;

use super::multiply::remainder;
use super::step::Step;

impl Step<'_, '_> {
    pub(super) fn data_processing(&mut self) {
        let Insn::DataProc {
            op,
            s,
            rd,
            rn,
            operand,
        } = self.instruction.insn
        else {
            return;
        };
        let (second, carry_lost) = self.operand(operand);
        let first = self.read(rn);
        let result = self.result(op, &first, &second);
        let result = match operand {
            Operand::Reg { rm, shift } if op == DpOp::Add && rm == rn => {
                self.reduced_product(&first, shift, result)
            }
            _ => result,
        };
        if s {
            self.set_flags(op, first, second, result, carry_lost);
        }
        if op.is_test() {
            return;
        }
        self.write(rd, result);
        // A flag-setting logic instruction and its result are one value: a branch on the flags
        // restricts the register too.
        let arithmetic = matches!(
            op,
            DpOp::Sub | DpOp::Rsb | DpOp::Add | DpOp::Adc | DpOp::Sbc
        );
        if s && !arithmetic && Register::new(rd) != Register::PC {
            self.state.flags.source = Some(Source::Result(self.read(rd)));
        }
    }

    /// The second operand, and whether it changes the carry.
    fn operand(&mut self, operand: Operand) -> (Value, bool) {
        match operand {
            Operand::Imm { value, carry } => (Value::constant(value), carry.is_some()),
            Operand::Reg { rm, shift } => {
                let value = self.read(rm);
                let result = match self.doubled_elements(&value, shift) {
                    Some(elements) => elements,
                    None => self.scaled(&value, shift, shifted(&value, shift)),
                };
                (self.named(result), !shift.is_none())
            }
        }
    }

    /// A word that is known to be one of several, shifted left. An entry of a table of jumps is half the distance to
    /// its target, where the core has no instruction for that.
    fn doubled_elements(&mut self, value: &Value, shift: Shift) -> Option<Value> {
        if shift.ty != ShiftType::Lsl || shift.is_none() || value.as_constant().is_some() {
            return None;
        }
        let symbols = &mut self.machine.symbols;
        let elements = symbols.elements(value)?;
        symbols.one_of(elements.iter().map(|word| word << shift.amount).collect())
    }

    fn result(&mut self, op: DpOp, first: &Value, second: &Value) -> Value {
        let symbols = &mut self.machine.symbols;
        let remainder = match (op, symbols.definition(second)) {
            (DpOp::Sub, Some(Definition::Product(a, b))) => remainder(symbols, first, a, b),
            _ => None,
        };
        let carry = self.state.flags.carry();
        let result = remainder.unwrap_or_else(|| data_processing(op, first, second, carry));
        if op == DpOp::And {
            let some = self.some_enabled(first, second, result);
            return self.machine.symbols.moved(some, first, second);
        }
        let symbols = &mut self.machine.symbols;
        match op {
            DpOp::Add | DpOp::Bic => symbols.moved(result, first, second),
            DpOp::Sub => symbols.moved_down(result, first, second),
            DpOp::Rsb => symbols.moved_down(result, second, first),
            _ => result,
        }
    }

    /// The sum of a word and the same word shifted left. The compiler multiplies by a constant
    /// this way, so the sum is defined as that product.
    fn reduced_product(&mut self, word: &Value, shift: Shift, sum: Value) -> Value {
        let is_product = shift.ty == ShiftType::Lsl
            && !shift.is_none()
            && self.machine.symbols.definition(word).is_some();
        if !is_product {
            return sum;
        }
        let factor = Value::constant(1 + (1 << shift.amount));
        self.defined(sum, Definition::Product(*word, factor))
    }

    /// `shifted`, which is `value` shifted right, with its definition if `value` is a product
    /// that was computed to divide by a constant.
    fn scaled(&mut self, value: &Value, by: Shift, shifted: Value) -> Value {
        if by.ty != ShiftType::Lsr {
            return shifted;
        }
        match self.machine.symbols.definition(value) {
            Some(&Definition::Scaled { of, factor, shift }) => {
                let shift = shift + u32::from(by.amount);
                self.defined(shifted, Definition::Scaled { of, factor, shift })
            }
            _ => shifted,
        }
    }

    fn set_flags(
        &mut self,
        op: DpOp,
        first: Value,
        second: Value,
        result: Value,
        carry_lost: bool,
    ) {
        let old = self.state.flags;
        self.state.flags = match op {
            DpOp::Cmp | DpOp::Sub => Flags::difference(first, second),
            DpOp::Rsb => Flags::difference(second, first),
            DpOp::Cmn | DpOp::Add => Flags::sum(first, second),
            DpOp::Adc | DpOp::Sbc => {
                let mut flags = Flags::ANY.result(result, true);
                if let (Some(a), Some(b), Some(carry)) =
                    (first.as_constant(), second.as_constant(), old.carry())
                {
                    flags.possible = 1 << flags_with_carry(op, a, b, carry);
                }
                flags
            }
            _ => old.result(result, carry_lost),
        };
    }

    pub(super) fn shift_by_register(&mut self) {
        let Insn::ShiftReg { ty, s, rd, rn, rm } = self.instruction.insn else {
            return;
        };
        let value = self.read(rn);
        let result = match self.read(rm).as_constant().map(|amount| amount & 0xff) {
            Some(0) => value,
            Some(amount @ 1..=31) => shifted(
                &value,
                Shift {
                    ty,
                    amount: amount as u8,
                },
            ),
            Some(_) if matches!(ty, ShiftType::Lsl | ShiftType::Lsr) => Value::constant(0),
            _ if ty == ShiftType::Lsr => {
                Value::with_range(Range::between(0, value.range.unsigned().1), &[&value])
            }
            _ => Value::with_range(Range::ALL, &[&value]),
        };
        if s {
            self.state.flags = self.state.flags.result(result, true);
        }
        self.set(rd, result);
    }

    /// An address relative to the program counter, or half of a constant.
    pub(super) fn load_constant(&mut self) {
        match self.instruction.insn {
            Insn::Adr { rd, imm, add } => {
                let base = self.pc() & !3;
                let address = if add {
                    base.wrapping_add(imm)
                } else {
                    base.wrapping_sub(imm)
                };
                self.set(rd, Value::constant(address));
            }
            Insn::MovImm16 { top, rd, imm } => {
                let value = if top {
                    let low = self.read(rd).range.and(Range::constant(0xffff));
                    Value::within(low.add(Range::constant(u32::from(imm) << 16)))
                } else {
                    Value::constant(u32::from(imm))
                };
                self.set(rd, value);
            }
            _ => {}
        }
    }
}

/// A value shifted left by a constant.
pub(super) fn shifted_left(value: &Value, amount: u8) -> Value {
    shifted(
        value,
        Shift {
            ty: ShiftType::Lsl,
            amount,
        },
    )
}

/// A value shifted by a constant.
fn shifted(value: &Value, shift: Shift) -> Value {
    if shift.is_none() {
        return *value;
    }
    let amount = u32::from(shift.amount);
    let range = match shift.ty {
        ShiftType::Lsl => value.range.shift_left(amount),
        ShiftType::Lsr if amount >= 32 => Range::constant(0),
        ShiftType::Lsr => value.range.shift_right(amount),
        ShiftType::Asr => value.range.shift_right_signed(amount.min(31)),
        ShiftType::Ror => match value.as_constant() {
            Some(word) => Range::constant(word.rotate_right(amount)),
            None => Range::ALL,
        },
        ShiftType::Rrx => Range::ALL,
    };
    Value::with_range(range, &[value])
}

/// The result of an operation without regard to symbols.
fn data_processing(op: DpOp, first: &Value, second: &Value, carry: Option<bool>) -> Value {
    let bitwise = |range: Range| Value::with_range(range, &[first, second]);
    match op {
        DpOp::Mov => *second,
        DpOp::Mvn => Value::within(match second.as_constant() {
            Some(word) => Range::constant(!word),
            // Not x is -x - 1.
            None => second.range.negate().subtract(Range::constant(1)),
        }),
        DpOp::Add | DpOp::Cmn => first.add(second),
        DpOp::Sub | DpOp::Cmp => first.subtract(second),
        DpOp::Rsb => second.subtract(first),
        DpOp::Adc => {
            let carry = carry.map_or(Range::between(0, 1), |c| Range::constant(u32::from(c)));
            first.add(second).add(&Value::within(carry))
        }
        DpOp::Sbc => {
            let borrow = carry.map_or(Range::between(0, 1), |c| Range::constant(u32::from(!c)));
            first.subtract(second).subtract(&Value::within(borrow))
        }
        DpOp::And | DpOp::Tst => {
            let range = first.range.and(second.range);
            if range == first.range && second.as_constant().is_some() {
                *first
            } else {
                aligned_stack(first, second, bitwise(range))
            }
        }
        DpOp::Bic => match second.as_constant() {
            Some(mask) => {
                let kept = Value::constant(!mask);
                aligned_stack(first, &kept, bitwise(first.range.and(kept.range)))
            }
            None => bitwise(Range::between(0, first.range.unsigned().1)),
        },
        DpOp::Orr => {
            if second.as_constant() == Some(0) {
                *first
            } else {
                bitwise(first.range.or(second.range))
            }
        }
        DpOp::Orn => match (first.as_constant(), second.as_constant()) {
            (Some(a), Some(b)) => Value::constant(a | !b),
            _ => bitwise(Range::ALL),
        },
        DpOp::Eor | DpOp::Teq => bitwise(first.range.xor(second.range)),
    }
}

/// The result of masking an address on the stack.
///
/// The real stack has only its alignment to eight bytes in common with the pretended one. So a
/// mask that clears higher bits gives an address that is lower by an unknown amount, not the
/// pretended address with these bits cleared.
fn aligned_stack(first: &Value, mask: &Value, result: Value) -> Value {
    let stack = first.stack && first.range.meet(STACK).is_some();
    match mask.as_constant() {
        Some(mask) if stack && mask & !7 != !7 && mask & !7 != 0 => {
            let cleared = !mask;
            match first.as_constant() {
                // Aligned down: the address moves by less than the alignment.
                Some(address) if cleared & cleared.wrapping_add(1) == 0 && cleared < 0x1_0000 => {
                    Value {
                        range: Range::arc(
                            (address & !7).wrapping_sub(cleared & !7),
                            cleared & !7,
                            8,
                        ),
                        base: None,
                        stack: true,
                    }
                }
                _ => Value::MAYBE_STACK,
            }
        }
        _ => result,
    }
}

/// The condition flags, N in bit 3 to V in bit 0, after an addition or subtraction with carry.
fn flags_with_carry(op: DpOp, a: u32, b: u32, carry: bool) -> u32 {
    let b = if op == DpOp::Sbc { !b } else { b };
    let unsigned = u64::from(a) + u64::from(b) + u64::from(carry);
    let signed = i64::from(a as i32) + i64::from(b as i32) + i64::from(carry);
    let result = unsigned as u32;
    let mut flags = 0;
    if result >> 31 != 0 {
        flags |= 8;
    }
    if result == 0 {
        flags |= 4;
    }
    if unsigned >> 32 != 0 {
        flags |= 2;
    }
    if signed != i64::from(result as i32) {
        flags |= 1;
    }
    flags
}
