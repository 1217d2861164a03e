//! Stretches of memory.

/// Adjacent bytes of memory.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Extent {
    /// Address of the first byte.
    pub first: u32,
    /// Address of the last byte; not below the first.
    pub last: u32,
}

impl Extent {
    /// All of memory.
    pub const EVERYWHERE: Self = Self::new(0, u32::MAX);

    /// The bytes from `first` to `last`.
    #[must_use]
    pub const fn new(first: u32, last: u32) -> Self {
        Self { first, last }
    }

    /// Whether `address` is one of the bytes.
    #[must_use]
    pub const fn contains(self, address: u32) -> bool {
        self.first <= address && address <= self.last
    }

    /// Distance from the first byte to the last.
    #[must_use]
    pub const fn span(self) -> u32 {
        self.last - self.first
    }

    /// The smallest stretch that holds both.
    #[must_use]
    pub fn hull(self, other: Self) -> Self {
        Self::new(self.first.min(other.first), self.last.max(other.last))
    }

    /// The bytes that are in both, if there are any.
    #[must_use]
    pub fn meet(self, other: Self) -> Option<Self> {
        let both = Self::new(self.first.max(other.first), self.last.min(other.last));
        (both.first <= both.last).then_some(both)
    }
}
