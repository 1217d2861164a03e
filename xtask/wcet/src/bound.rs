//! The result of the analysis of one task.

use std::collections::{BTreeMap, BTreeSet};

use super::cycles::Cycles;
use super::facts::Facts;
use super::mask::Level;
use super::pend::Pend;

/// How the analysed code is entered and left.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Entry {
    /// As an exception handler: exception entry and return are charged.
    Handler,
    /// As a function: only its instructions are charged.
    Function,
    /// As the program's start: loops need not have a bound, and critical sections count from
    /// the first time that a task can run.
    Program,
}

/// Why there is no bound.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
pub enum Problem {
    /// No bound was found for a loop.
    #[error(
        "the loop at {0} has no bound: write `// loop-bound: N` on the line above it, where N is the most turns that it takes"
    )]
    LoopWithoutBound(String),
    /// A function calls itself, directly or not.
    #[error("recursion: {0}; its depth, and so its time and stack, has no bound")]
    Recursion(String),
    /// The target of a call or jump is unknown.
    #[error(
        "the call through a pointer at {0} may go anywhere: call the function by name, or take the pointer from a constant table"
    )]
    UnboundedPointer(String),
    /// Control reaches an address without an instruction.
    #[error("control reaches {0}, where there is no instruction of this core")]
    NotCode(String),
    /// An interrupt mask was set to an unknown level.
    #[error("the interrupt mask is set to an unknown level at {0}")]
    UnknownMask(String),
    /// The stack pointer was set to an unknown address.
    #[error("the stack pointer is unknown after {0}")]
    UnknownStack(String),
    /// The analysis exceeded its limit of steps.
    #[error("{0} takes too many steps to analyse: bound its loops by annotations")]
    TooLong(String),
}

/// A place from which control goes to the panic handler and never returns.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct PanicSite {
    /// Address of the call.
    pub at: u32,
    /// The function that it calls.
    pub callee: String,
}

/// The longest critical section that begins at one place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Section {
    /// The interrupts that are masked.
    pub level: Level,
    /// Its longest time.
    pub cycles: Cycles,
    /// Address of the instruction that masks them.
    pub at: u32,
}

/// The result of the analysis of one task.
#[derive(Debug, Clone)]
pub struct Bound {
    /// Longest time of one activation.
    pub cycles: Cycles,
    /// Deepest stack below the stack pointer on entry, in bytes, without exception frames and
    /// panic paths.
    pub stack: u32,
    /// Whether a floating-point instruction may be executed.
    pub uses_fpu: bool,
    /// Critical sections.
    pub sections: Vec<Section>,
    /// Panics that the analysis does not prove impossible.
    pub panics: BTreeSet<PanicSite>,
    /// Exceptions that it may make pending.
    pub pends: BTreeSet<Pend>,
    /// Flow facts.
    pub facts: Facts,
    /// Bounds that were taken from annotations, by the first line of the loop.
    pub annotated: BTreeMap<String, u64>,
    /// Why the figures above are no bounds; empty if they are.
    pub problems: BTreeSet<Problem>,
}
