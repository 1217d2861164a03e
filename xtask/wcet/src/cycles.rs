//! Core cycles under both timing models at once.
//!
//! Every analysis computes two figures side by side: at zero wait states, as the emulator
//! charges them, so that a bound can be compared with an observation cycle by cycle; and as
//! flashed, which is the bound for the part with its flash.

use std::iter::Sum;
use std::ops::{Add, AddAssign, Index, IndexMut, Mul, Sub};

/// One of the two timing models.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Model {
    /// As the emulator charges: no wait states.
    ZeroWait,
    /// As the part runs from its flash.
    Flashed,
}

impl Model {
    /// Both models.
    pub const ALL: [Self; 2] = [Self::ZeroWait, Self::Flashed];

    /// How the figure is named in sentences.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::ZeroWait => "by the emulator's model",
            Self::Flashed => "as flashed",
        }
    }
}

/// A number of core cycles under each timing model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct Cycles {
    /// At zero wait states.
    pub zero_wait: u64,
    /// As flashed.
    pub flashed: u64,
}

impl Cycles {
    /// No time.
    pub const ZERO: Self = Self::both(0);

    /// The same number under both models.
    #[must_use]
    pub const fn both(cycles: u64) -> Self {
        Self {
            zero_wait: cycles,
            flashed: cycles,
        }
    }

    /// Both figures, that at zero wait states first.
    #[must_use]
    pub const fn to_array(self) -> [u64; 2] {
        [self.zero_wait, self.flashed]
    }

    /// Computes the figure of each model.
    #[must_use]
    pub fn each(mut cycles: impl FnMut(Model) -> u64) -> Self {
        Self {
            zero_wait: cycles(Model::ZeroWait),
            flashed: cycles(Model::Flashed),
        }
    }

    /// The longer time under each model.
    #[must_use]
    pub fn max(self, other: Self) -> Self {
        Self::each(|model| self[model].max(other[model]))
    }

    /// The shorter time under each model.
    #[must_use]
    pub fn min(self, other: Self) -> Self {
        Self::each(|model| self[model].min(other[model]))
    }

    /// The difference under each model, zero where `other` is longer.
    #[must_use]
    pub fn saturating_sub(self, other: Self) -> Self {
        Self::each(|model| self[model].saturating_sub(other[model]))
    }
}

impl Index<Model> for Cycles {
    type Output = u64;

    fn index(&self, model: Model) -> &u64 {
        match model {
            Model::ZeroWait => &self.zero_wait,
            Model::Flashed => &self.flashed,
        }
    }
}

impl IndexMut<Model> for Cycles {
    fn index_mut(&mut self, model: Model) -> &mut u64 {
        match model {
            Model::ZeroWait => &mut self.zero_wait,
            Model::Flashed => &mut self.flashed,
        }
    }
}

impl Add for Cycles {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::each(|model| self[model] + other[model])
    }
}

impl AddAssign for Cycles {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Cycles {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self::each(|model| self[model] - other[model])
    }
}

impl Mul<u64> for Cycles {
    type Output = Self;

    fn mul(self, times: u64) -> Self {
        Self::each(|model| self[model] * times)
    }
}

impl Sum for Cycles {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(Self::ZERO, Add::add)
    }
}
