//! Bit fields, extension, saturation and reversal.

use rsemu::cpu::arm::v7m::isa::{BitfieldOp, ExtendOp, Insn, MiscOp};

use crate::range::Range;
use crate::register::Register;
use crate::value::Value;

use super::narrow::extend;
use super::step::Step;

impl Step<'_, '_> {
    pub(super) fn saturate(&mut self) {
        let Insn::Sat {
            unsigned,
            halves,
            rd,
            imm,
            ..
        } = self.instruction.insn
        else {
            return;
        };
        let range = match (unsigned, halves) {
            (_, true) => Range::ALL,
            (true, false) => Range::between(0, ((1u64 << imm) - 1) as u32),
            (false, false) => {
                let half = 1u64 << (imm - 1);
                Range::arc((half as u32).wrapping_neg(), (2 * half - 1) as u32, 1)
            }
        };
        self.set(rd, Value::within(range));
    }

    pub(super) fn extend(&mut self) {
        let Insn::Extend {
            op,
            rd,
            rn,
            rm,
            rotate,
        } = self.instruction.insn
        else {
            return;
        };
        let source = self.read(rm);
        let extended = match source.as_constant() {
            _ if rotate == 0 => self.extended(op, &source),
            Some(word) => extend(op, &Value::constant(word.rotate_right(u32::from(rotate)))),
            None => extend(op, &Value::ANY),
        };
        let result = if Register::new(rn) == Register::PC {
            extended
        } else if matches!(op, ExtendOp::Sxtb16 | ExtendOp::Uxtb16) {
            Value::ANY
        } else {
            self.read(rn).add(&extended)
        };
        self.set(rd, result);
    }

    /// The extension of `source`: the same word whenever the same one is extended. A compiler may extend
    /// an index once for its check and once more for its use, and what the check showed still holds.
    fn extended(&mut self, op: ExtendOp, source: &Value) -> Value {
        let mut value = extend(op, source);
        let Some((symbol, offset)) = source.base else {
            return value;
        };
        if value.base.is_some() || value.as_constant().is_some() || value == Value::ANY {
            return value;
        }
        let Some(offset) = offset.as_constant() else {
            return value;
        };
        let base = Some((
            self.symbols().extension(op, symbol, offset),
            Range::constant(0),
        ));
        let known = self.state.registers.iter().map(|(_, known)| known);
        for known in known.filter(|known| known.base == base) {
            value.range = value.range.meet(known.range).unwrap_or(value.range);
        }
        value.base = base;
        value
    }

    /// Reversals of bits or bytes, and the number of leading zeros.
    pub(super) fn reverse_or_count(&mut self) {
        let Insn::Misc { op, rd, rm } = self.instruction.insn else {
            return;
        };
        let value = self.read(rm);
        let range = match (op, value.as_constant()) {
            (MiscOp::Clz, Some(x)) => Range::constant(x.leading_zeros()),
            (MiscOp::Clz, None) => {
                let (low, high) = value.range.unsigned();
                Range::between(high.leading_zeros(), low.leading_zeros())
            }
            (MiscOp::Rbit, Some(x)) => Range::constant(x.reverse_bits()),
            (MiscOp::Rev, Some(x)) => Range::constant(x.swap_bytes()),
            (MiscOp::Rev16, Some(x)) => {
                Range::constant(((x >> 8) & 0x00ff_00ff) | ((x << 8) & 0xff00_ff00))
            }
            _ => Range::ALL,
        };
        self.set(rd, Value::within(range));
    }

    pub(super) fn bit_field(&mut self) {
        let Insn::Bitfield {
            op,
            rd,
            rn,
            lsb,
            width,
        } = self.instruction.insn
        else {
            return;
        };
        let result = match op {
            BitfieldOp::Ubfx => field(&self.read(rn), lsb, width),
            BitfieldOp::Sbfx => {
                let left = 32 - u32::from(lsb) - u32::from(width);
                let source = self.read(rn).range;
                let range = source.shift_left(left);
                Value::within(range.shift_right_signed(left + u32::from(lsb)))
            }
            BitfieldOp::Bfi | BitfieldOp::Bfc => {
                let mask = (((1u64 << width) - 1) << lsb) as u32;
                let kept = self.read(rd).range.and(Range::constant(!mask));
                let new = if op == BitfieldOp::Bfc {
                    Range::constant(0)
                } else {
                    let low = field(&self.read(rn), 0, width).range;
                    low.shift_left(u32::from(lsb))
                };
                Value::within(match (kept.as_constant(), new.as_constant()) {
                    (Some(a), Some(b)) => Range::constant(a | b),
                    _ => kept.or(new),
                })
            }
        };
        self.set(rd, result);
    }
}

/// `width` bits of a value from bit `lsb` on.
fn field(value: &Value, lsb: u8, width: u8) -> Value {
    let shifted = value.range.shift_right(u32::from(lsb));
    let mask = ((1u64 << width) - 1) as u32;
    if lsb == 0 && value.range.unsigned().1 <= mask {
        return *value;
    }
    Value::within(shifted.and(Range::constant(mask)))
}
