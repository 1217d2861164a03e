//! Bytes and halfwords in 32-bit words.

use rsemu::cpu::arm::v7m::isa::ExtendOp;

use crate::range::Range;
use crate::value::Value;

/// A loaded word of which only the size is known.
pub(super) fn unknown(size: u32, signed: bool) -> Value {
    Value::within(match (size, signed) {
        (1, false) => Range::between(0, 0xff),
        (1, true) => Range::arc(0xffff_ff80, 0xff, 1),
        (2, false) => Range::between(0, 0xffff),
        (2, true) => Range::arc(0xffff_8000, 0xffff, 1),
        _ => Range::ALL,
    })
}

/// `word`, which has `size` bytes, as a register holds it after a load.
pub(super) fn adjust(word: u32, size: u32, signed: bool) -> u32 {
    match (size, signed) {
        (1, true) => i32::from(word as u8 as i8) as u32,
        (2, true) => i32::from(word as u16 as i16) as u32,
        _ => word,
    }
}

/// The low `size` bytes of a value, extended to a word.
pub(super) fn low_bytes(value: &Value, size: u32, signed: bool) -> Value {
    match (size, signed) {
        (1, false) => extend(ExtendOp::Uxtb, value),
        (1, true) => extend(ExtendOp::Sxtb, value),
        (2, false) => extend(ExtendOp::Uxth, value),
        (2, true) => extend(ExtendOp::Sxth, value),
        _ => *value,
    }
}

/// The result of an extension.
pub(super) fn extend(op: ExtendOp, value: &Value) -> Value {
    let (_, high) = value.range.unsigned();
    let (least, most) = value.range.signed();
    let (fits, size, signed) = match op {
        ExtendOp::Uxtb => (high <= 0xff, 1, false),
        ExtendOp::Uxth => (high <= 0xffff, 2, false),
        ExtendOp::Sxtb => (least >= -0x80 && most <= 0x7f, 1, true),
        ExtendOp::Sxth => (least >= -0x8000 && most <= 0x7fff, 2, true),
        ExtendOp::Sxtb16 | ExtendOp::Uxtb16 => return Value::ANY,
    };
    if fits {
        return *value;
    }
    if let Some(word) = value.as_constant() {
        let mask = if size == 1 { 0xff } else { 0xffff };
        return Value::constant(adjust(word & mask, size, signed));
    }
    unknown(size, signed)
}
