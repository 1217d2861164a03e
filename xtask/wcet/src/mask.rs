//! Interrupt masks.

use super::cycles::Cycles;
use super::value::Symbol;

/// `PRIMASK` or `FAULTMASK` on all paths that reach a point.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ExceptionMask {
    /// Set: no interrupt is taken.
    Set,
    /// Clear.
    Clear,
    /// Set on some paths, clear on others.
    Unknown,
}

impl ExceptionMask {
    /// The mask in this known state.
    #[must_use]
    pub const fn known(set: bool) -> Self {
        if set { Self::Set } else { Self::Clear }
    }

    /// The mask where two paths meet.
    #[must_use]
    pub fn join(self, other: Self) -> Self {
        if self == other { self } else { Self::Unknown }
    }
}

/// Which interrupts are masked.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Level {
    /// All, by `PRIMASK`.
    All,
    /// All and the faults, by `FAULTMASK`.
    Faults,
    /// Those whose priority value is at least this one, by `BASEPRI`; not zero.
    From(u8),
    /// Those of the first 32 interrupts whose bit is set, in the interrupt controller.
    Interrupts(u32),
}

impl Level {
    /// Whether all that the `other` masks is masked.
    #[must_use]
    pub const fn covers(self, other: Self) -> bool {
        match (self, other) {
            (Self::Faults, _) | (Self::All, Self::All | Self::From(_) | Self::Interrupts(_)) => {
                true
            }
            (Self::From(own), Self::From(others)) => own <= others,
            (Self::Interrupts(own), Self::Interrupts(others)) => others & !own == 0,
            _ => false,
        }
    }

    /// Whether `BASEPRI` causes it.
    #[must_use]
    pub const fn is_basepri(self) -> bool {
        matches!(self, Self::From(_))
    }
}

/// A critical section that is still running: a stretch of the path with interrupts masked.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Masked {
    /// Which interrupts are masked.
    pub level: Level,
    /// Longest time since they were masked.
    pub cycles: Cycles,
    /// Address of the instruction that masked them.
    pub at: u32,
    /// A symbol that is newer than what was read before, and older than what was read since.
    pub since: Symbol,
    /// What caused it masks nothing any more, and another section masks the same interrupts until its own end.
    pub handed: bool,
}
