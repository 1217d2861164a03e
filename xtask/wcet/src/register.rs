//! Core registers by number, and sets of them.

use std::ops::{BitAnd, BitOr, BitOrAssign};

/// A core register, `r0` to `r15`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Register(u8);

impl Register {
    /// The first argument and the result of a function.
    pub const R0: Self = Self(0);
    /// The frame pointer of functions that have one.
    pub const R7: Self = Self(7);
    /// The stack pointer.
    pub const SP: Self = Self(13);
    /// The link register.
    pub const LR: Self = Self(14);
    /// The program counter.
    pub const PC: Self = Self(15);

    /// The register with this number; only its low four bits count, as in an instruction.
    #[must_use]
    pub const fn new(number: u8) -> Self {
        Self(number & 15)
    }

    /// Its number, as instructions hold it.
    #[must_use]
    pub const fn number(self) -> u8 {
        self.0
    }

    /// Its number, as an index.
    #[must_use]
    pub const fn index(self) -> usize {
        self.0 as usize
    }
}

/// A set of core registers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct RegisterSet(u16);

impl RegisterSet {
    /// No register.
    pub const NONE: Self = Self(0);
    /// Every register.
    pub const ALL: Self = Self(u16::MAX);
    /// Registers that a function may leave changed (AAPCS32): `r0` to `r3`, `r12` and `lr`.
    pub const SCRATCH: Self = Self(0b0101_0000_0000_1111);
    /// Registers that a function preserves (AAPCS32): `r4` to `r11`.
    pub const PRESERVED: Self = Self(0b0000_1111_1111_0000);

    /// The set whose members are the one bits of `bits`, as in the list of a load or store
    /// multiple.
    #[must_use]
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// The set of this one register.
    #[must_use]
    pub const fn of(register: Register) -> Self {
        Self(1 << register.0)
    }

    /// Whether `register` is a member.
    #[must_use]
    pub const fn contains(self, register: Register) -> bool {
        self.0 & (1 << register.0) != 0
    }

    /// Whether the two sets have a member in common.
    #[must_use]
    pub const fn meets(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Whether every member of `other` is one of this set.
    #[must_use]
    pub const fn holds(self, other: Self) -> bool {
        other.0 & !self.0 == 0
    }

    /// The set without `register`.
    #[must_use]
    pub const fn without(self, register: Register) -> Self {
        Self(self.0 & !(1 << register.0))
    }

    /// Number of members.
    #[must_use]
    pub const fn len(self) -> u32 {
        self.0.count_ones()
    }

    /// Whether there is no member.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// The members in ascending order.
    pub fn iter(self) -> impl Iterator<Item = Register> {
        (0..16)
            .map(Register)
            .filter(move |register| self.contains(*register))
    }
}

impl BitOr for RegisterSet {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

impl BitAnd for RegisterSet {
    type Output = Self;

    fn bitand(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }
}

impl BitOrAssign for RegisterSet {
    fn bitor_assign(&mut self, other: Self) {
        *self = *self | other;
    }
}

/// A set of floating-point registers by their numbers in single precision, and of the status register of
/// the unit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct FloatSet(u64);

impl FloatSet {
    /// No register.
    pub const NONE: Self = Self(0);
    /// The status register, `FPSCR`.
    pub const STATUS: Self = Self(1 << 32);
    /// Every register, and the status.
    pub const ALL: Self = Self((1 << 33) - 1);

    /// The set of this one register, `s0` to `s31`; only the low five bits of the number count.
    #[must_use]
    pub const fn of(single: u8) -> Self {
        Self(1 << (single & 31))
    }

    /// The set of `count` registers from this one on.
    #[must_use]
    pub fn from(first: u8, count: u8) -> Self {
        let all = (0..count).map(|next| Self::of(first.saturating_add(next)));
        all.fold(Self::NONE, |all, one| all | one)
    }

    /// Whether the two sets have a member in common.
    #[must_use]
    pub const fn meets(self, other: Self) -> bool {
        self.0 & other.0 != 0
    }

    /// Whether every member of `other` is one of this set.
    #[must_use]
    pub const fn holds(self, other: Self) -> bool {
        other.0 & !self.0 == 0
    }
}

impl BitOr for FloatSet {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }
}

/// What an instruction may leave to the next one that makes it wait.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct Results {
    /// Core registers that it may have written.
    pub registers: RegisterSet,
    /// Floating-point registers that it may have computed.
    pub floats: FloatSet,
}

impl Results {
    /// Nothing.
    pub const NONE: Self = Self {
        registers: RegisterSet::NONE,
        floats: FloatSet::NONE,
    };
    /// Every register: the instruction is not known.
    pub const ALL: Self = Self {
        registers: RegisterSet::ALL,
        floats: FloatSet::ALL,
    };

    /// Whether everything in `other` is in this one.
    #[must_use]
    pub const fn holds(self, other: Self) -> bool {
        self.registers.holds(other.registers) && self.floats.holds(other.floats)
    }
}

impl BitOr for Results {
    type Output = Self;

    fn bitor(self, other: Self) -> Self {
        Self {
            registers: self.registers | other.registers,
            floats: self.floats | other.floats,
        }
    }
}

impl BitOrAssign for Results {
    fn bitor_assign(&mut self, other: Self) {
        *self = *self | other;
    }
}
