//! The condition flags: which combinations are possible, and the values that set them.

use rsemu::cpu::arm::v7m::isa::Cond;

use super::range::Range;
use super::value::Value;

/// The values from which the flags were computed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Source {
    /// The difference of two values, as `CMP` and `SUBS` do.
    Difference(Value, Value),
    /// A result; N and Z are its sign and whether it is zero.
    Result(Value),
}

/// The four condition flags.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Flags {
    /// One bit for each combination of N, Z, C, V read as a binary number.
    pub possible: u16,
    /// The values that set them, if a condition can restrict these values.
    pub source: Option<Source>,
}

const N: u32 = 8;
const Z: u32 = 4;
const C: u32 = 2;
const V: u32 = 1;

/// Combinations of the flags that pass `condition`.
#[must_use]
pub(crate) fn passing(condition: Cond) -> u16 {
    (0..16u32)
        .filter(|combination| condition.passes(combination << 28))
        .fold(0, |set, combination| set | 1 << combination)
}

/// The set of combinations that `keep` accepts.
fn select(keep: impl Fn(u32) -> bool) -> u16 {
    (0..16u32)
        .filter(|combination| keep(*combination))
        .fold(0, |set, combination| set | 1 << combination)
}

impl Flags {
    /// Nothing is known.
    pub(crate) const ANY: Self = Self {
        possible: u16::MAX,
        source: None,
    };

    /// After `a - b`.
    #[must_use]
    pub(crate) fn difference(a: Value, b: Value) -> Self {
        let source = Some(Source::Difference(a, b));
        if let (Some(x), Some(y)) = (a.as_constant(), b.as_constant()) {
            let (result, borrow) = x.overflowing_sub(y);
            let (_, overflow) = (x as i32).overflowing_sub(y as i32);
            return Self {
                possible: 1 << exact(result, !borrow, overflow),
                source,
            };
        }
        let result = a.subtract(&b).range;
        let equal = result.contains(0) && a.range.meet(b.range).is_some();
        let (a_low, a_high) = a.range.unsigned();
        let (b_low, b_high) = b.range.unsigned();
        let (a_least, a_most) = a.range.signed();
        let (b_least, b_most) = b.range.signed();
        let differ = result.as_constant() != Some(0);
        let (negative, positive) = signs(result);
        let possible = select(|flags| {
            let carry = flags & C != 0;
            if flags & Z != 0 {
                return equal && carry && flags & (N | V) == 0;
            }
            let less = (flags & N != 0) != (flags & V != 0);
            differ
                && (if carry {
                    a_high > b_low
                } else {
                    a_low < b_high
                })
                && (if less {
                    a_least < b_most
                } else {
                    a_most > b_least
                })
                && (if flags & N != 0 { negative } else { positive })
        });
        Self { possible, source }
    }

    /// After `a + b`.
    #[must_use]
    pub(crate) fn sum(a: Value, b: Value) -> Self {
        // Adding a constant is the same as subtracting its negative, flags included, except for
        // the two numbers that are their own negatives.
        if let Some(constant) = b.as_constant()
            && constant != 0
            && constant != 0x8000_0000
        {
            return Self::difference(a, Value::constant(constant.wrapping_neg()));
        }
        let result = a.add(&b);
        let (negative, positive) = signs(result.range);
        let zero = result.range.contains(0);
        Self {
            possible: select(|flags| sign_fits(flags, negative, positive, zero)),
            source: Some(Source::Result(result)),
        }
    }

    /// After an operation that sets N and Z by `result`. V stays as it was, and C does too unless
    /// `carry_lost`.
    #[must_use]
    pub(crate) fn result(self, result: Value, carry_lost: bool) -> Self {
        let (negative, positive) = signs(result.range);
        let zero = result.range.contains(0);
        let old = self.possible;
        let kept = |flags: u32| {
            (0..16u32).any(|before| {
                old & (1 << before) != 0
                    && before & V == flags & V
                    && (carry_lost || before & C == flags & C)
            })
        };
        Self {
            possible: select(|flags| sign_fits(flags, negative, positive, zero) && kept(flags)),
            source: Some(Source::Result(result)),
        }
    }

    /// The carry, if it is known.
    #[must_use]
    pub(crate) fn carry(&self) -> Option<bool> {
        let set = select(|flags| flags & C != 0) & self.possible != 0;
        let clear = select(|flags| flags & C == 0) & self.possible != 0;
        match (set, clear) {
            (true, false) => Some(true),
            (false, true) => Some(false),
            _ => None,
        }
    }
}

/// The combination of flags for this result.
fn exact(result: u32, carry: bool, overflow: bool) -> u32 {
    let negative = if result >> 31 != 0 { N } else { 0 };
    let zero = if result == 0 { Z } else { 0 };
    negative | zero | if carry { C } else { 0 } | u32::from(overflow)
}

/// Whether the range has negative elements, and whether it has positive ones.
fn signs(range: Range) -> (bool, bool) {
    let (low, high) = range.signed();
    (low < 0, high > 0)
}

/// Whether N and Z fit to a result that may be negative, positive or zero.
fn sign_fits(flags: u32, negative: bool, positive: bool, zero: bool) -> bool {
    match (flags & N != 0, flags & Z != 0) {
        (true, true) => false,
        (true, false) => negative,
        (false, true) => zero,
        (false, false) => positive,
    }
}

/// Restrictions that a condition puts on the values which set the flags: each value, and the set in
/// which it must lie.
#[must_use]
pub(crate) fn consequences(source: &Source, condition: Cond) -> Vec<(Value, Range)> {
    match *source {
        Source::Difference(a, b) => {
            let (a_low, a_high) = a.range.unsigned();
            let (b_low, b_high) = b.range.unsigned();
            let (a_least, a_most) = a.range.signed();
            let (b_least, b_most) = b.range.signed();
            match condition.0 {
                // EQ, NE
                0 => vec![(a, b.range), (b, a.range)],
                1 => without(a, b).into_iter().chain(without(b, a)).collect(),
                // CS, CC: unsigned not below, below
                2 => vec![(a, from(b_low)), (b, up_to(a_high))],
                3 => vec![
                    (a, up_to(b_high.saturating_sub(1))),
                    (b, from(a_low.saturating_add(1))),
                ],
                // HI, LS
                8 => vec![
                    (a, from(b_low.saturating_add(1))),
                    (b, up_to(a_high.saturating_sub(1))),
                ],
                9 => vec![(a, up_to(b_high)), (b, from(a_low))],
                // GE, LT
                10 => vec![(a, signed_from(b_least)), (b, signed_up_to(a_most))],
                11 => vec![
                    (a, signed_up_to(b_most.saturating_sub(1))),
                    (b, signed_from(a_least.saturating_add(1))),
                ],
                // GT, LE
                12 => vec![
                    (a, signed_from(b_least.saturating_add(1))),
                    (b, signed_up_to(a_most.saturating_sub(1))),
                ],
                13 => vec![(a, signed_up_to(b_most)), (b, signed_from(a_least))],
                // MI, PL: the sign of the difference, which is useful if zero is subtracted.
                4 if b.as_constant() == Some(0) => vec![(a, signed_up_to(-1))],
                5 if b.as_constant() == Some(0) => vec![(a, signed_from(0))],
                _ => Vec::new(),
            }
        }
        Source::Result(value) => match condition.0 {
            0 => vec![(value, Range::constant(0))],
            1 => without(value, Value::constant(0)),
            4 => vec![(value, signed_up_to(-1))],
            5 => vec![(value, signed_from(0))],
            _ => Vec::new(),
        },
    }
}

fn from(low: u32) -> Range {
    Range::between(low, u32::MAX)
}

fn up_to(high: u32) -> Range {
    Range::between(0, high)
}

fn signed_from(low: i32) -> Range {
    Range::arc(low as u32, i32::MAX.wrapping_sub(low) as u32, 1)
}

fn signed_up_to(high: i32) -> Range {
    Range::arc(i32::MIN as u32, high.wrapping_sub(i32::MIN) as u32, 1)
}

/// `a` without the only element of `b`, if that is the first or last element of `a`.
fn without(a: Value, b: Value) -> Vec<(Value, Range)> {
    let Some(value) = b.as_constant() else {
        return Vec::new();
    };
    let range = a.range;
    let step = if range.count() > 1 {
        range.span() / (range.count() - 1) as u32
    } else {
        return Vec::new();
    };
    if range.start() == value {
        vec![(
            a,
            Range::arc(value.wrapping_add(step), range.span() - step, step),
        )]
    } else if range.start().wrapping_add(range.span()) == value {
        vec![(a, Range::arc(range.start(), range.span() - step, step))]
    } else {
        Vec::new()
    }
}
