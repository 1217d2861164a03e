//! CAN identifiers.

/// A CAN identifier: 11 bits (base format) or 29 bits (extended format).
///
/// `Ord` is the order of arbitration: the smaller identifier wins the bus. A base
/// identifier wins against an extended one with the same 11 leading bits, because
/// its dominant RTR bit meets the recessive SRR bit of the extended one
/// (ISO 11898-1).
#[derive(Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Id(u32);

/// Marks an extended identifier in bit 0, below the 29 identifier bits, so that the
/// derived order is the order of arbitration.
const EXTENDED: u32 = 1;

impl Id {
    /// Largest 11-bit identifier.
    pub const MAX_STANDARD: u16 = 0x7FF;
    /// Largest 29-bit identifier.
    pub const MAX_EXTENDED: u32 = 0x1FFF_FFFF;

    /// An 11-bit identifier, `None` above [`Id::MAX_STANDARD`].
    pub const fn standard(raw: u16) -> Option<Self> {
        if raw > Self::MAX_STANDARD {
            None
        } else {
            Some(Self((raw as u32) << 19))
        }
    }

    /// A 29-bit identifier, `None` above [`Id::MAX_EXTENDED`].
    pub const fn extended(raw: u32) -> Option<Self> {
        if raw > Self::MAX_EXTENDED {
            None
        } else {
            Some(Self(raw << 1 | EXTENDED))
        }
    }

    /// An 11-bit identifier as a constant. The build fails above
    /// [`Id::MAX_STANDARD`].
    ///
    /// ```
    /// const REFERENCE: ttcan::Id = ttcan::Id::constant::<100>();
    /// assert_eq!(REFERENCE.raw(), 100);
    /// ```
    pub const fn constant<const RAW: u16>() -> Self {
        const {
            match Self::standard(RAW) {
                Some(id) => id,
                None => panic!("an 11-bit CAN identifier is at most 0x7FF"),
            }
        }
    }

    /// The 11-bit identifier of the lowest bits of `raw`.
    #[cfg(feature = "embedded-can")]
    pub(crate) const fn of_standard_bits(raw: u16) -> Self {
        Self(((raw & Self::MAX_STANDARD) as u32) << 19)
    }

    /// The 29-bit identifier of the lowest bits of `raw`.
    #[cfg(feature = "embedded-can")]
    pub(crate) const fn of_extended_bits(raw: u32) -> Self {
        Self((raw & Self::MAX_EXTENDED) << 1 | EXTENDED)
    }

    /// The identifier's number, the same for both formats.
    pub const fn raw(self) -> u32 {
        self.0 >> self.place()
    }

    /// Whether this is a 29-bit identifier.
    pub const fn is_extended(self) -> bool {
        self.0 & EXTENDED != 0
    }

    /// The identifier of the same format `steps` above this one, `None` past the
    /// largest one.
    pub const fn offset(self, steps: u8) -> Option<Self> {
        let raw = self.raw() + steps as u32;
        if self.is_extended() {
            Self::extended(raw)
        } else if raw > Self::MAX_STANDARD as u32 {
            None
        } else {
            Self::standard(raw as u16)
        }
    }

    /// The identifier of the reference of the master of this rank, from that of rank 0. The matrix has
    /// no rank for which there is none.
    pub(crate) const fn of_rank(self, rank: u8) -> Self {
        Self(self.0.wrapping_add((rank as u32) << self.place()))
    }

    /// The rank that a reference with this identifier has, from the identifier of rank 0.
    pub(crate) const fn rank(self, first: Self) -> u32 {
        self.0.wrapping_sub(first.0) >> self.place()
    }

    /// Where the lowest bit of the identifier is.
    const fn place(self) -> u32 {
        if self.is_extended() { 1 } else { 19 }
    }

    /// Mask of all bits but the three lowest of the identifier, in which references carry their rank.
    pub(crate) const fn all_but_rank(self) -> u32 {
        !(0b111 << self.place())
    }

    /// Whether both are equal where a mask such as [`Id::all_but_rank`] is set.
    pub(crate) const fn agrees_in(self, other: Self, mask: u32) -> bool {
        (self.0 ^ other.0) & mask == 0
    }

    /// All bits of an identifier of this format.
    pub(crate) const fn all_bits(self) -> u32 {
        if self.is_extended() {
            Self::MAX_EXTENDED
        } else {
            Self::MAX_STANDARD as u32
        }
    }

    /// Whether both have the same format and the same bits where `mask` is set. It is of the
    /// identifier's number, within [`Id::all_bits`].
    pub(crate) const fn agrees(self, other: Self, mask: u32) -> bool {
        (self.0 ^ other.0) & (mask << self.place() | EXTENDED) == 0
    }

    pub(crate) const fn equals(self, other: Self) -> bool {
        self.0 == other.0
    }

    /// Order of arbitration as a number, for `const` comparisons.
    pub(crate) const fn priority(self) -> u32 {
        self.0
    }
}

impl core::fmt::Debug for Id {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "Id({self})")
    }
}

/// Hexadecimal, three digits for a base identifier and eight for an extended
/// one, as candump prints them.
impl core::fmt::Display for Id {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        if self.is_extended() {
            write!(f, "{:08X}", self.raw())
        } else {
            write!(f, "{:03X}", self.raw())
        }
    }
}
