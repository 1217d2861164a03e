//! Values of the abstract machine: the knowledge about one register or stack word.

use super::range::Range;

/// An unknown quantity that the analysis recognises again.
///
/// Two values with the same symbol differ by the difference of their offsets, whatever the
/// symbol stands for. So a pointer and the end of its slice stay related although neither
/// address is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Symbol(pub u32);

/// A set of possible words, and how it relates to a [`Symbol`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Value {
    /// Every word it may be.
    pub range: Range,
    /// `Some((symbol, offset))`: the word is the symbol plus an element of `offset`.
    pub base: Option<(Symbol, Range)>,
    /// Whether it may have been computed from an address on the stack.
    pub stack: bool,
}

impl Value {
    /// Nothing is known.
    pub const ANY: Self = Self {
        range: Range::ALL,
        base: None,
        stack: false,
    };

    /// Nothing is known, and it may be an address on the stack.
    pub const MAYBE_STACK: Self = Self {
        stack: true,
        ..Self::ANY
    };

    /// The one word `value`.
    #[must_use]
    pub const fn constant(value: u32) -> Self {
        Self {
            range: Range::constant(value),
            base: None,
            stack: false,
        }
    }

    /// Any element of `range`.
    #[must_use]
    pub const fn within(range: Range) -> Self {
        Self {
            range,
            base: None,
            stack: false,
        }
    }

    /// The word, if there is only one that it can be.
    #[must_use]
    pub const fn as_constant(&self) -> Option<u32> {
        self.range.as_constant()
    }

    /// The sum. The symbol of the operand with the wider range is kept.
    #[must_use]
    pub fn add(&self, other: &Self) -> Self {
        let (anchor, distance) = if self.range.span() >= other.range.span() {
            (self, other)
        } else {
            (other, self)
        };
        let base = match (anchor.base, distance.base) {
            (Some((symbol, offset)), _) => Some((symbol, offset.add(distance.range))),
            (None, Some((symbol, offset))) => Some((symbol, offset.add(anchor.range))),
            (None, None) => None,
        };
        Self {
            range: self.range.add(other.range),
            base: useful(base),
            stack: self.stack || other.stack,
        }
    }

    /// The difference; exact for two values with the same symbol.
    #[must_use]
    pub fn subtract(&self, other: &Self) -> Self {
        if let (Some((a, offset)), Some((b, other_offset))) = (self.base, other.base)
            && a == b
        {
            let exact = offset.subtract(other_offset);
            let range = self.range.subtract(other.range);
            return Self::within(exact.meet(range).unwrap_or(exact));
        }
        Self {
            range: self.range.subtract(other.range),
            base: useful(
                self.base
                    .map(|(symbol, offset)| (symbol, offset.subtract(other.range))),
            ),
            stack: self.stack || other.stack,
        }
    }

    /// A word in `range` that was computed from these values: it may be an address on the
    /// stack if one of them may.
    #[must_use]
    pub fn with_range(range: Range, from: &[&Self]) -> Self {
        Self {
            range,
            base: None,
            stack: from.iter().any(|value| value.stack),
        }
    }
}

/// The symbol and offset, unless the offset may be anything and so relates to nothing.
fn useful(base: Option<(Symbol, Range)>) -> Option<(Symbol, Range)> {
    base.filter(|(_, offset)| !offset.is_all())
}
