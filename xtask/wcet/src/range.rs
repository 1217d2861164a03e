//! Sets of 32-bit words as arcs of the number circle.
//!
//! A range is `start, start + stride, .. start + span`, modulo 2^32, after J. Navas et al.,
//! "Signedness-agnostic program analysis: precise integer bounds for low-level code" (APLAS 2012).
//! One representation serves signed and unsigned comparisons, because most machine instructions do
//! not distinguish them.

/// A non-empty set of 32-bit words; see the module.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Range {
    start: u32,
    /// Distance from the first element to the last; a multiple of `stride`.
    span: u32,
    /// Distance between neighbours; zero if and only if there is one element.
    stride: u32,
}

fn gcd(a: u32, b: u32) -> u32 {
    if b == 0 { a } else { gcd(b, a % b) }
}

impl Range {
    /// Every word.
    pub const ALL: Self = Self {
        start: 0,
        span: u32::MAX,
        stride: 1,
    };

    /// The one word `value`.
    #[must_use]
    pub const fn constant(value: u32) -> Self {
        Self {
            start: value,
            span: 0,
            stride: 0,
        }
    }

    /// `start..=start + span` in steps of `stride`; the span is rounded down to a multiple of it.
    #[must_use]
    pub const fn arc(start: u32, span: u32, stride: u32) -> Self {
        let stride = if stride == 0 { 1 } else { stride };
        let span = span - span % stride;
        Self {
            start,
            span,
            stride: if span == 0 { 0 } else { stride },
        }
    }

    /// The words `low..=high` as unsigned numbers; all words if `low > high`.
    #[must_use]
    pub const fn between(low: u32, high: u32) -> Self {
        if low > high {
            Self::ALL
        } else {
            Self::arc(low, high - low, 1)
        }
    }

    /// The element, if there is only one.
    #[must_use]
    pub const fn as_constant(self) -> Option<u32> {
        if self.span == 0 {
            Some(self.start)
        } else {
            None
        }
    }

    /// The first element on the arc.
    #[must_use]
    pub const fn start(self) -> u32 {
        self.start
    }

    /// Distance from the first element to the last.
    #[must_use]
    pub const fn span(self) -> u32 {
        self.span
    }

    /// Whether every word is an element.
    #[must_use]
    pub const fn is_all(self) -> bool {
        self.span == u32::MAX && self.stride == 1
    }

    /// Number of elements.
    #[must_use]
    pub fn count(self) -> u64 {
        self.span
            .checked_div(self.stride)
            .map_or(1, |steps| u64::from(steps) + 1)
    }

    /// The elements in order along the arc.
    pub fn iter(self) -> impl Iterator<Item = u32> {
        let count = self.count();
        (0..count).map(move |n| {
            self.start
                .wrapping_add((n as u32).wrapping_mul(self.stride))
        })
    }

    /// Least and greatest element as unsigned numbers.
    #[must_use]
    pub fn unsigned(self) -> (u32, u32) {
        match self.start.checked_add(self.span) {
            Some(end) => (self.start, end),
            None => (0, u32::MAX),
        }
    }

    /// Least and greatest element as signed numbers.
    #[must_use]
    pub fn signed(self) -> (i32, i32) {
        let start = self.start as i32;
        match i64::from(start) + i64::from(self.span) {
            end if end <= i64::from(i32::MAX) => (start, end as i32),
            _ => (i32::MIN, i32::MAX),
        }
    }

    /// Whether `value` is an element.
    #[must_use]
    pub fn contains(self, value: u32) -> bool {
        let distance = value.wrapping_sub(self.start);
        distance <= self.span && (self.stride == 0 || distance.is_multiple_of(self.stride))
    }

    /// An arc that holds both sets, the smallest of those that begin with one of them.
    #[must_use]
    pub fn join(self, other: Self) -> Self {
        if self == other {
            return self;
        }
        let hull = |a: Self, b: Self| -> Option<(u32, u32)> {
            let shift = u64::from(b.start.wrapping_sub(a.start));
            let end = u64::from(a.span).max(shift + u64::from(b.span));
            u32::try_from(end).ok().map(|span| (a.start, span))
        };
        let candidates = [hull(self, other), hull(other, self)];
        let Some((start, span)) = candidates
            .into_iter()
            .flatten()
            .min_by_key(|&(start, span)| (span, start.checked_add(span).is_none()))
        else {
            return Self::ALL;
        };
        // One of the two distances is zero, as the arc begins with one of the sets.
        let shift = self.start.wrapping_sub(start) | other.start.wrapping_sub(start);
        let stride = gcd(gcd(self.stride, other.stride), shift);
        Self::arc(start, span, stride)
    }

    /// A set that holds every common element of both; `None` if there is none.
    #[must_use]
    pub fn meet(self, other: Self) -> Option<Self> {
        if other.is_all() {
            return Some(self);
        }
        if self.is_all() {
            return Some(other);
        }
        if let Some(value) = other.as_constant() {
            return self.contains(value).then_some(other);
        }
        if let Some(value) = self.as_constant() {
            return other.contains(value).then_some(self);
        }
        // In distances from the begin of `other`.
        let offset = u64::from(self.start.wrapping_sub(other.start));
        let end = offset + u64::from(self.span);
        let stride = u64::from(self.stride);
        let limit = u64::from(other.span);
        let wrapped = end >> 32 != 0;
        let (first, last) = if offset <= limit {
            if wrapped {
                // Both ends of `self` may be in `other`: the smaller set is kept.
                return Some(if self.span <= other.span { self } else { other });
            }
            (offset, end.min(limit))
        } else if wrapped {
            let skipped = ((1u64 << 32) - offset).div_ceil(stride);
            let first = offset + skipped * stride - (1u64 << 32);
            (first, (end - (1u64 << 32)).min(limit))
        } else {
            return None;
        };
        if first > last {
            return None;
        }
        Some(Self::arc(
            other.start.wrapping_add(first as u32),
            (last - first) as u32,
            self.stride,
        ))
    }

    /// All sums of an element of each.
    #[must_use]
    pub fn add(self, other: Self) -> Self {
        match self.span.checked_add(other.span) {
            Some(span) => Self::arc(
                self.start.wrapping_add(other.start),
                span,
                gcd(self.stride, other.stride),
            ),
            None => Self::ALL,
        }
    }

    /// All negated elements.
    #[must_use]
    pub fn negate(self) -> Self {
        Self {
            start: self.start.wrapping_add(self.span).wrapping_neg(),
            ..self
        }
    }

    /// All differences of an element of `self` and one of `other`.
    #[must_use]
    pub fn subtract(self, other: Self) -> Self {
        self.add(other.negate())
    }

    /// All elements shifted left by `amount` (0..=31).
    #[must_use]
    pub fn shift_left(self, amount: u32) -> Self {
        let (low, high) = self.unsigned();
        if amount == 0 {
            self
        } else if let Some(value) = self.as_constant() {
            Self::constant(value << amount)
        } else if high.leading_zeros() >= amount {
            Self::arc(low << amount, (high - low) << amount, self.step() << amount)
        } else {
            Self::arc(0, u32::MAX << amount, 1 << amount)
        }
    }

    /// The distance between elements as unsigned numbers.
    fn step(self) -> u32 {
        if self.unsigned() == (0, u32::MAX) && self.start != 0 {
            // The arc wraps around: only the power of two in the stride remains valid.
            1 << self.stride.trailing_zeros().min(31)
        } else {
            self.stride.max(1)
        }
    }

    /// All elements shifted right by `amount` (0..=31), filled with zeros.
    #[must_use]
    pub fn shift_right(self, amount: u32) -> Self {
        if amount == 0 {
            return self;
        }
        let (low, high) = self.unsigned();
        let step = self.stride;
        let exact = low.trailing_zeros() >= amount && step.trailing_zeros() >= amount;
        let wraps = self.start.checked_add(self.span).is_none();
        Self::arc(
            low >> amount,
            (high >> amount) - (low >> amount),
            if exact && !wraps { step >> amount } else { 1 },
        )
    }

    /// All elements shifted right by `amount` (0..=31), filled with the sign.
    #[must_use]
    pub fn shift_right_signed(self, amount: u32) -> Self {
        if amount == 0 {
            return self;
        }
        let (low, high) = self.signed();
        let (low, high) = (low >> amount, high >> amount);
        Self::arc(low as u32, high.wrapping_sub(low) as u32, 1)
    }

    /// All products of an element of each.
    #[must_use]
    pub fn multiply(self, other: Self) -> Self {
        if let (Some(a), Some(b)) = (self.as_constant(), other.as_constant()) {
            return Self::constant(a.wrapping_mul(b));
        }
        let scaled = |range: Self, by: u32| -> Option<Self> {
            let (low, high) = range.unsigned();
            high.checked_mul(by)?;
            Some(Self::arc(low * by, (high - low) * by, range.step() * by))
        };
        let result = match (self.as_constant(), other.as_constant()) {
            (Some(0), _) | (_, Some(0)) => Some(Self::constant(0)),
            (Some(by), _) => scaled(other, by),
            (_, Some(by)) => scaled(self, by),
            _ => None,
        };
        result.unwrap_or_else(|| {
            let (low, high) = self.unsigned();
            let (other_low, other_high) = other.unsigned();
            match high.checked_mul(other_high) {
                Some(top) => Self::between(low.wrapping_mul(other_low), top),
                None => Self::ALL,
            }
        })
    }

    /// All bitwise ANDs of an element of each.
    #[must_use]
    pub fn and(self, other: Self) -> Self {
        match (self.as_constant(), other.as_constant()) {
            (Some(a), Some(b)) => Self::constant(a & b),
            (Some(mask), None) => other.mask(mask),
            (None, Some(mask)) => self.mask(mask),
            (None, None) => Self::between(0, self.unsigned().1.min(other.unsigned().1)),
        }
    }

    /// All bitwise ANDs with a constant.
    fn mask(self, mask: u32) -> Self {
        if mask == 0 {
            return Self::constant(0);
        }
        let (low, high) = self.unsigned();
        let kept_low = mask.trailing_zeros();
        if mask == u32::MAX {
            return self;
        }
        // A mask of low bits that covers every element changes nothing.
        if mask & mask.wrapping_add(1) == 0 && high <= mask {
            return self;
        }
        // A mask that only clears low bits is monotonic.
        if mask == u32::MAX << kept_low {
            return Self::arc(low & mask, (high & mask) - (low & mask), 1 << kept_low);
        }
        Self::arc(0, high.min(mask), 1 << kept_low)
    }

    /// All bitwise ORs of an element of each.
    #[must_use]
    pub fn or(self, other: Self) -> Self {
        if let (Some(a), Some(b)) = (self.as_constant(), other.as_constant()) {
            return Self::constant(a | b);
        }
        let (low, high) = self.unsigned();
        let (other_low, other_high) = other.unsigned();
        // An OR is no more than the sum.
        let most = below_power_of_two(high | other_high).min(high.saturating_add(other_high));
        Self::between(low.max(other_low), most)
    }

    /// All bitwise XORs of an element of each.
    #[must_use]
    pub fn xor(self, other: Self) -> Self {
        if let (Some(a), Some(b)) = (self.as_constant(), other.as_constant()) {
            return Self::constant(a ^ b);
        }
        Self::between(
            0,
            below_power_of_two(self.unsigned().1 | other.unsigned().1),
        )
    }

    /// All unsigned quotients; division by zero gives zero, as on the core.
    #[must_use]
    pub fn divide(self, other: Self) -> Self {
        let (low, high) = self.unsigned();
        let (least, greatest) = other.unsigned();
        let bottom = if least == 0 { 0 } else { low / greatest };
        Self::between(bottom, high / least.max(1))
    }
}

/// The least number of the form `2^n - 1` that is not below `value`.
fn below_power_of_two(value: u32) -> u32 {
    match value.leading_zeros() {
        0 => u32::MAX,
        zeros => (1 << (32 - zeros)) - 1,
    }
}

#[cfg(test)]
mod tests {
    use super::Range;
    use rand_chacha::ChaCha8Rng;
    use rand_chacha::rand_core::{Rng, SeedableRng};

    fn word(random: &mut ChaCha8Rng) -> u32 {
        let value = random.next_u32();
        match random.next_u32() % 4 {
            0 => value % 16,
            1 => (value % 16).wrapping_neg(),
            2 => 0x8000_0000u32.wrapping_add(value % 16).wrapping_sub(8),
            _ => value,
        }
    }

    fn range(random: &mut ChaCha8Rng) -> Range {
        let stride = 1 + random.next_u32() % 5;
        Range::arc(word(random), random.next_u32() % 20 * stride, stride)
    }

    /// Every element of the operands gives an element of the result.
    #[test]
    fn operations_are_sound() {
        type Operation = (fn(Range, Range) -> Range, fn(u32, u32) -> u32);
        let operations: [Operation; 9] = [
            (Range::add, u32::wrapping_add),
            (Range::subtract, u32::wrapping_sub),
            (Range::multiply, u32::wrapping_mul),
            (Range::and, |a, b| a & b),
            (Range::or, |a, b| a | b),
            (Range::xor, |a, b| a ^ b),
            (Range::divide, |a, b| a.checked_div(b).unwrap_or(0)),
            (Range::join, |a, _| a),
            (Range::join, |_, b| b),
        ];
        let mut random = ChaCha8Rng::seed_from_u64(3);
        for _ in 0..2000 {
            let (a, b) = (range(&mut random), range(&mut random));
            for (index, (abstracted, concrete)) in operations.iter().enumerate() {
                let result = abstracted(a, b);
                for x in a.iter() {
                    for y in b.iter() {
                        let value = concrete(x, y);
                        assert!(result.contains(value), "{index}: {a:?} {b:?} {x} {y}");
                    }
                }
            }
            for amount in [0, 1, 4, 31] {
                for x in a.iter() {
                    assert!(a.shift_left(amount).contains(x << amount));
                    assert!(a.shift_right(amount).contains(x >> amount));
                    assert!(
                        a.shift_right_signed(amount)
                            .contains(((x as i32) >> amount) as u32)
                    );
                }
            }
        }
    }

    #[test]
    fn meet_keeps_the_common_elements() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        for _ in 0..20_000 {
            let (a, b) = (range(&mut random), range(&mut random));
            let both = a.meet(b);
            for x in a.iter().filter(|x| b.contains(*x)) {
                assert!(both.is_some_and(|m| m.contains(x)), "{a:?} {b:?} {x}");
            }
        }
    }

    #[test]
    fn bounds_hold_every_element() {
        let mut random = ChaCha8Rng::seed_from_u64(5);
        for _ in 0..2000 {
            let a = range(&mut random);
            for x in a.iter() {
                assert!(a.unsigned().0 <= x && x <= a.unsigned().1);
                assert!(a.signed().0 <= x as i32 && x as i32 <= a.signed().1);
            }
            assert_eq!(a.iter().count() as u64, a.count());
        }
    }

    #[test]
    fn a_counter_keeps_its_stride() {
        let even = Range::constant(4)
            .join(Range::constant(8))
            .join(Range::constant(16));
        assert_eq!(even, Range::arc(4, 12, 4));
        assert_eq!(even.shift_right(2), Range::arc(1, 3, 1));
        assert_eq!(even.meet(Range::between(5, 12)), Some(Range::arc(8, 4, 4)));
    }
}
