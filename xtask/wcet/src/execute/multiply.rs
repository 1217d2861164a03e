//! Multiplication and division.

use rsemu::cpu::arm::v7m::isa::{DualMulOp, HalfMulOp, Insn};

use crate::range::Range;
use crate::symbols::{Definition, Symbols};
use crate::value::Value;

use super::step::Step;

impl Step<'_, '_> {
    pub(super) fn multiply(&mut self) {
        let Insn::Mul {
            rd,
            rn,
            rm,
            ra,
            sub,
            s,
        } = self.instruction.insn
        else {
            return;
        };
        let (a, b) = (self.read(rn), self.read(rm));
        let product = Value::with_range(a.range.multiply(b.range), &[&a, &b]);
        let result = match ra {
            None => self.defined(product, Definition::Product(a, b)),
            Some(ra) if sub => {
                let dividend = self.read(ra);
                let remainder = remainder(self.symbols(), &dividend, &a, &b);
                remainder.unwrap_or_else(|| dividend.subtract(&product))
            }
            Some(ra) => self.read(ra).add(&product),
        };
        if s {
            self.state.flags = self.state.flags.result(result, false);
        }
        self.set(rd, result);
    }

    pub(super) fn multiply_long(&mut self) {
        let Insn::MulLong {
            signed,
            accumulate,
            rdlo,
            rdhi,
            rn,
            rm,
            umaal,
        } = self.instruction.insn
        else {
            return;
        };
        let (a, b) = (self.read(rn), self.read(rm));
        let (low, high) = match (a.as_constant(), b.as_constant()) {
            _ if accumulate || umaal => (Value::ANY, Value::ANY),
            (Some(x), Some(y)) => {
                let product = if signed {
                    (i64::from(x as i32) * i64::from(y as i32)) as u64
                } else {
                    u64::from(x) * u64::from(y)
                };
                let high = Value::constant((product >> 32) as u32);
                (Value::constant(product as u32), high)
            }
            _ if signed => (Value::ANY, Value::ANY),
            _ => self.unsigned_product(&a, &b),
        };
        self.set(rdlo, low);
        self.set(rdhi, high);
    }

    /// Both halves of an unsigned product of which a factor is unknown.
    fn unsigned_product(&mut self, a: &Value, b: &Value) -> (Value, Value) {
        let top = u64::from(a.range.unsigned().1) * u64::from(b.range.unsigned().1);
        let low = match u32::try_from(top) {
            Ok(top) => Value::within(Range::between(0, top)),
            Err(_) => Value::ANY,
        };
        let mut high = Value::within(Range::between(0, (top >> 32) as u32));
        let scaled = match (a.as_constant(), b.as_constant()) {
            (None, Some(factor)) => Some((self.named(*a), factor)),
            (Some(factor), None) => Some((self.named(*b), factor)),
            _ => None,
        };
        if let Some((of, factor)) = scaled {
            let symbol = self.symbols().define(Definition::Scaled {
                of,
                factor,
                shift: 32,
            });
            high.base = Some((symbol, Range::constant(0)));
        }
        (low, high)
    }

    pub(super) fn divide(&mut self) {
        let Insn::Div { signed, rd, rn, rm } = self.instruction.insn else {
            return;
        };
        let (a, b) = (self.read(rn), self.read(rm));
        let range = match (a.as_constant(), b.as_constant()) {
            (Some(x), Some(y)) if signed => Range::constant(if y == 0 {
                0
            } else {
                (x as i32).wrapping_div(y as i32) as u32
            }),
            _ if signed && (a.range.signed().0 < 0 || b.range.signed().0 < 0) => Range::ALL,
            _ => a.range.divide(b.range),
        };
        let quotient = Value::within(range);
        let quotient = if signed {
            quotient
        } else {
            self.defined(quotient, Definition::Quotient { of: a, by: b })
        };
        self.set(rd, quotient);
    }

    /// Products of halfwords, whose value is not followed.
    pub(super) fn multiply_halfwords(&mut self) {
        let (rd, accumulator) = match self.instruction.insn {
            Insn::HalfMul { rd, ra, op, .. } => (rd, (op == HalfMulOp::Smlal).then_some(ra)),
            Insn::DualMul { rd, ra, op, .. } => {
                let long = matches!(op, DualMulOp::Smlald | DualMulOp::Smlsld);
                (rd, long.then_some(ra))
            }
            _ => return,
        };
        self.forget(rd);
        if let Some(ra) = accumulator {
            self.forget(ra);
        }
    }
}

/// `dividend - a * b`, if one factor is the quotient of the dividend by the other: then it is
/// the remainder, which is below the divisor.
pub(super) fn remainder(
    symbols: &Symbols,
    dividend: &Value,
    a: &Value,
    b: &Value,
) -> Option<Value> {
    let same = |of: &Value| of.base.is_some() && of.base == dividend.base;
    let below = |divisor: u32| {
        let (_, high) = dividend.range.unsigned();
        Value::within(Range::between(0, high.min(divisor.max(1) - 1)))
    };
    for (quotient, divisor) in [(a, b), (b, a)] {
        match symbols.definition(quotient) {
            Some(Definition::Quotient { of, by }) if same(of) => {
                let equal = by.base.is_some() && by.base == divisor.base
                    || by.as_constant().is_some() && by.as_constant() == divisor.as_constant();
                // The core divides by zero to zero, and the remainder is the dividend.
                if equal && !by.range.contains(0) {
                    return Some(below(by.range.unsigned().1));
                }
            }
            Some(Definition::Scaled { of, factor, shift }) if same(of) => {
                let divisor = divisor.as_constant()?;
                if divides(divisor, *factor, *shift) {
                    return Some(below(divisor));
                }
            }
            _ => {}
        }
    }
    None
}

/// Whether `(n * factor) >> shift` is `n / divisor` for every 32-bit `n`
/// (Granlund and Montgomery 1994, theorem 4.2).
fn divides(divisor: u32, factor: u32, shift: u32) -> bool {
    if divisor == 0 || !(32..64).contains(&shift) {
        return false;
    }
    let power = 1u128 << shift;
    let product = u128::from(divisor) * u128::from(factor);
    product >= power && product - power <= 1 << (shift - 32)
}
