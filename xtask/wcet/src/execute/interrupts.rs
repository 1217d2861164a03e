//! Masking by the interrupt controller, as on cores without `BASEPRI`.
//!
//! RTIC's lock on such a core reads which interrupts are enabled (`ISER`), disables those up to the
//! ceiling (`ICER`), and enables those again that it had found enabled. Between the two it is a critical
//! section for the tasks of these interrupts. It ends where the program enables what it found
//! before the section began: what was disabled then, was so by somebody else, whose section it is.

use crate::extent::Extent;
use crate::mask::Level;
use crate::symbols::Definition;
use crate::value::{Symbol, Value};

use super::step::Step;

/// Set-enable register of the first 32 interrupts, and the only one of these cores (Armv6-M Architecture
/// Reference Manual B3.4.3). Reading gives the enabled ones.
const ISER: u32 = 0xe000_e100;
/// Clear-enable register of the same.
const ICER: u32 = 0xe000_e180;
/// The registers that disable interrupts (DDI 0403 B3.4.5).
const DISABLE: Extent = Extent::new(0xe000_e180, 0xe000_e1bf);
/// The registers that enable interrupts.
const ENABLE: Extent = Extent::new(0xe000_e100, 0xe000_e13f);

impl Step<'_, '_> {
    /// Whether a section may mask single interrupts.
    fn masks_interrupts(&self) -> bool {
        !self.machine.part.core.has_basepri()
    }

    /// What a load of a word from this address gives if it is that of the enabled interrupts.
    pub(super) fn enabled_interrupts(&mut self, address: &Value, size: u32) -> Option<Value> {
        let is_read = self.masks_interrupts() && size == 4 && address.as_constant() == Some(ISER);
        is_read.then(|| {
            let read = self.symbols().fresh();
            let all = Definition::Enabled {
                read,
                mask: u32::MAX,
            };
            self.defined(Value::ANY, all)
        })
    }

    /// `result`, the conjunction of two words, with a definition if one of them is a set of enabled
    /// interrupts and the other one is known.
    pub(super) fn some_enabled(&mut self, first: &Value, second: &Value, result: Value) -> Value {
        let symbols = &self.machine.symbols;
        let of = |set: &Value, with: &Value| match (symbols.definition(set), with.as_constant()) {
            (Some(&Definition::Enabled { read, mask }), Some(with)) => Some((read, mask & with)),
            _ => None,
        };
        match of(first, second).or_else(|| of(second, first)) {
            Some((read, mask)) => self.defined(result, Definition::Enabled { read, mask }),
            None => result,
        }
    }

    /// Notes a store to the registers that enable and disable interrupts, once tasks can run.
    pub(super) fn note_enables(&mut self, reached: Extent, size: u32, value: &Value) {
        if !self.state.started {
            return;
        }
        let exactly = |at| reached == Extent::new(at, at + 3) && size == 4;
        if DISABLE.meet(reached).is_some() {
            match value.as_constant() {
                Some(mask) if self.masks_interrupts() && exactly(ICER) => {
                    self.mask_interrupts(mask);
                }
                _ => self.effects.disables_interrupt = true,
            }
        } else if ENABLE.meet(reached).is_some() {
            let is_running = |level| matches!(level, Level::Interrupts(_));
            let mut running = self.state.masked.iter();
            if running.any(|section| is_running(section.level)) {
                self.unmask_interrupts(exactly(ISER), value);
            }
        }
    }

    /// Begins a section that masks these interrupts, unless one is running that masks them too.
    fn mask_interrupts(&mut self, mask: u32) {
        let masks_them = |level| matches!(level, Level::Interrupts(old) if old & mask == mask);
        let mut running = self.state.masked.iter();
        if mask != 0 && !running.any(|section| masks_them(section.level)) {
            self.begin_section(Level::Interrupts(mask));
        }
    }

    /// Ends the sections whose interrupts a store enables; `exact` says whether it goes to `ISER`. A
    /// section that the store only shortens goes on.
    fn unmask_interrupts(&mut self, exact: bool, value: &Value) {
        let found = match self.machine.symbols.definition(value) {
            Some(&Definition::Enabled { read, mask }) => Some((Some(read), mask)),
            _ => value.as_constant().map(|word| (None, word)),
        };
        let Some((read, enabled)) = found.filter(|_| exact) else {
            self.effects.unknown_mask = true;
            return;
        };
        let was_before = |since: Symbol| read.is_none_or(|read| read < since);
        self.end_sections(|section| {
            matches!(section.level, Level::Interrupts(mask) if mask & !enabled == 0)
                && was_before(section.since)
        });
    }
}
