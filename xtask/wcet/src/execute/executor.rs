//! What executing an instruction needs and gives.

use std::collections::BTreeSet;
use std::rc::Rc;

use crate::image::Image;
use crate::lasting::Memory;
use crate::mask::Masked;
use crate::part::Part;
use crate::range::Range;
use crate::reading::Reading;
use crate::symbols::Symbols;
use crate::value::{Symbol, Value};

/// The memory access of an instruction, for its timing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Access {
    /// Every address that the first byte may have.
    pub address: Range,
    /// True for a load, false for a store.
    pub load: bool,
    /// Bytes of one transfer: 1, 2 or 4.
    pub size: u32,
    /// Number of transfers.
    pub count: u32,
}

/// Effects of an instruction outside the state.
#[derive(Debug, Clone, Default)]
pub(crate) struct Effects {
    /// Its memory access.
    pub access: Option<Access>,
    /// Critical sections that end with it.
    pub unmasked: Vec<Masked>,
    /// The word that it writes to the program counter, if it does.
    pub target: Option<Value>,
    /// True if it set an interrupt mask to an unknown level.
    pub unknown_mask: bool,
    /// True if it may have disabled an interrupt in the interrupt controller after a task could
    /// run.
    pub disables_interrupt: bool,
}

/// Executes instructions of one image.
#[derive(Debug)]
pub(crate) struct Executor<'a> {
    /// The image, which holds the constants.
    pub image: &'a Image,
    /// The part that runs it.
    pub part: Part,
    /// The addresses of loads that find zero.
    pub zeros: Rc<BTreeSet<u32>>,
    /// Names of unknown words.
    pub symbols: Symbols,
    /// The word that stood in `BASEPRI` when the code began.
    pub found_basepri: Symbol,
    /// What is read from `PRIMASK`, by the bit there.
    pub found_primask: [Symbol; 2],
    /// What a register of a device gives.
    pub reading: Option<Reading>,
    /// Facts about memory outside the stack.
    pub memory: Memory,
}

impl Executor<'_> {
    /// The facts about memory at the end.
    #[must_use]
    pub(crate) fn into_memory(self) -> Memory {
        Memory {
            lost: self.memory.lost || self.symbols.mixed,
            ..self.memory
        }
    }
}
