//! Bytes of variables that are known while `PRIMASK` keeps every other task from running.
//!
//! A logger, for one, masks all interrupts in one function, notes in a variable whether they were masked before, and
//! looks there in another function to unmask them. Nothing but DMA can change such a byte meanwhile; a
//! variable that is lent to a peripheral is left out ([`Memory::trusts_lent`](crate::lasting::Memory)).

use std::rc::Rc;

use crate::extent::Extent;
use crate::layout::RAM;
use crate::mask::ExceptionMask;
use crate::value::Value;

use super::step::Step;

impl Step<'_, '_> {
    /// Notes a store of the low `size` bytes of `value` to one of the addresses `reached`.
    pub(super) fn hold(&mut self, reached: Extent, address: &Value, size: u32, value: &Value) {
        if self.state.primask != ExceptionMask::Set {
            return;
        }
        self.forget_held(reached);
        let exact = address.as_constant() == Some(reached.first) && RAM.contains(reached.first);
        if let Some(word) = value.as_constant().filter(|_| exact && !value.stack) {
            let bytes = (0..size).map(|at| (reached.first + at, (word >> (8 * at)) & 0xff));
            Rc::make_mut(&mut self.state.held).extend(bytes);
        }
    }

    /// Forgets what was stored in these bytes.
    pub(super) fn forget_held(&mut self, bytes: Extent) {
        let touched = |at: &u32| bytes.contains(*at);
        if self.state.held.keys().any(touched) {
            Rc::make_mut(&mut self.state.held).retain(|at, _| !touched(at));
        }
    }

    /// The word of `size` bytes at an address, if it is known while interrupts are masked.
    pub(super) fn held(&mut self, address: u32, size: u32) -> Option<u32> {
        if self.state.held.is_empty() || !self.machine.memory.holds {
            return None;
        }
        let last = address.checked_add(size - 1)?;
        let bytes = (address..=last).map(|at| self.state.held.get(&at));
        let bytes: Option<Vec<&u32>> = bytes.collect();
        let word = bytes?.iter().rev().fold(0, |word, byte| word << 8 | **byte);
        let trusted = &mut self.machine.memory.trusted;
        trusted.insert(Extent::new(address, last));
        Some(word)
    }
}
