//! System registers: the interrupt masks and the flags.

use std::rc::Rc;

use rsemu::cpu::arm::v7m::isa::Insn;

use crate::cycles::Cycles;
use crate::flags::Flags;
use crate::mask::{ExceptionMask, Level, Masked};
use crate::range::Range;
use crate::value::Value;

use super::step::Step;

/// Numbers of the system registers in `MRS` and `MSR` (DDI 0403, B5.1.1).
mod number {
    pub(super) const LAST_APSR: u8 = 3;
    pub(super) const PRIMASK: u8 = 16;
    pub(super) const BASEPRI: u8 = 17;
    pub(super) const BASEPRI_MAX: u8 = 18;
    pub(super) const FAULTMASK: u8 = 19;
}

/// What `MRS` reads from a register of one bit.
fn word(mask: ExceptionMask) -> Value {
    match mask {
        ExceptionMask::Set => Value::constant(1),
        ExceptionMask::Clear => Value::constant(0),
        ExceptionMask::Unknown => Value::within(Range::between(0, 1)),
    }
}

/// What `MSR` makes of a register of one bit.
fn mask(value: &Value) -> ExceptionMask {
    value.as_constant().map_or(ExceptionMask::Unknown, |word| {
        ExceptionMask::known(word & 1 != 0)
    })
}

impl Step<'_, '_> {
    pub(super) fn system(&mut self) {
        match self.instruction.insn {
            Insn::Mrs { rd, sysm } => {
                let value = match sysm {
                    number::PRIMASK => self.found(word(self.state.primask)),
                    number::FAULTMASK => word(self.state.faultmask),
                    number::BASEPRI | number::BASEPRI_MAX => self.state.basepri,
                    _ => Value::ANY,
                };
                self.set(rd, value);
            }
            Insn::Msr { rn, sysm, .. } => {
                let value = self.read(rn);
                match sysm {
                    0..=number::LAST_APSR => self.state.flags = Flags::ANY,
                    number::PRIMASK => self.set_exception_mask(Level::All, mask(&value)),
                    number::FAULTMASK => self.set_exception_mask(Level::Faults, mask(&value)),
                    number::BASEPRI => self.set_basepri(&value, false),
                    number::BASEPRI_MAX => self.set_basepri(&value, true),
                    _ => {}
                }
            }
            Insn::Cps { enable, i, f } => {
                let mask = ExceptionMask::known(!enable);
                if i {
                    self.set_exception_mask(Level::All, mask);
                }
                if f {
                    self.set_exception_mask(Level::Faults, mask);
                }
            }
            _ => {}
        }
    }

    /// A word that was read from `PRIMASK`, with the symbol by which it stays known on the stack.
    fn found(&self, word: Value) -> Value {
        let bit = word.as_constant().map(|word| word as usize);
        let symbol = bit.and_then(|bit| self.machine.found_primask.get(bit));
        Value {
            base: symbol.map(|symbol| (*symbol, Range::constant(0))),
            ..word
        }
    }

    /// Sets `PRIMASK` or `FAULTMASK`, as `level` says.
    fn set_exception_mask(&mut self, level: Level, mask: ExceptionMask) {
        match mask {
            ExceptionMask::Set => self.mask_by(level, |running| running == level),
            ExceptionMask::Clear => self.end_sections(|of| of.level == level),
            ExceptionMask::Unknown => self.effects.unknown_mask = true,
        }
        match level {
            Level::Faults => self.state.faultmask = mask,
            _ => {
                self.state.primask = mask;
                if mask != ExceptionMask::Set {
                    self.state.held = Rc::default();
                }
            }
        }
        self.note_start();
    }

    /// The start ends when a task can run for the first time: on any path to this point, and as far
    /// as is known.
    fn note_start(&mut self) {
        let basepri = self.state.basepri.as_constant();
        let written = basepri.map(|word| self.implemented(word));
        let masks_tasks = written.is_some() && written == self.machine.part.start_mask;
        let masks_all = [self.state.primask, self.state.faultmask].contains(&ExceptionMask::Set);
        self.state.started |= !masks_all && !masks_tasks;
    }

    /// The bits of a word that `BASEPRI` keeps.
    fn implemented(&self, word: u32) -> u8 {
        word as u8 & self.machine.part.priority_mask()
    }

    /// Writes `BASEPRI`; with `only_raise` the write has no effect unless it masks more.
    fn set_basepri(&mut self, value: &Value, only_raise: bool) {
        if only_raise {
            self.raise_basepri(value);
        } else if let Some(word) = value.as_constant() {
            let new = self.implemented(word);
            self.hand_over(|of| matches!(of.level, Level::From(old) if new == 0 || old < new));
            self.mask_from(new);
            self.settle_sections();
            self.state.basepri = *value;
        } else if self.is_as_found(value) {
            // This task runs, so the word that it found masks no priority at which the task
            // could be, and every section ends here.
            self.end_sections(|of| of.level.is_basepri());
            self.state.basepri = *value;
        } else {
            self.effects.unknown_mask = true;
            self.state.basepri = *value;
        }
        self.note_start();
    }

    /// Writes `BASEPRI_MAX`: the register keeps its word unless the new one masks more.
    fn raise_basepri(&mut self, value: &Value) {
        let old = self.state.basepri;
        let Some(new) = value.as_constant().map(|word| self.implemented(word)) else {
            self.effects.unknown_mask = true;
            self.state.basepri = self.symbols().unknown();
            return;
        };
        let old_word = old.as_constant().map(|word| self.implemented(word));
        match old_word {
            _ if new == 0 => return,
            Some(old) if old != 0 && old <= new => return,
            // The word that the task found masks no priority at which the task could be, and
            // nor does the new one if it masks less.
            Some(_) => {}
            None if self.is_as_found(&old) => {}
            None => self.effects.unknown_mask = true,
        }
        self.mask_from(new);
        self.state.basepri = Value::constant(u32::from(new));
    }

    /// Whether `value` is the word that the task found in `BASEPRI` when it began.
    fn is_as_found(&self, value: &Value) -> bool {
        value.base == Some((self.machine.found_basepri, Range::constant(0)))
    }

    /// Begins a section that masks the priority values from `new` on, unless one is running that
    /// masks them too.
    fn mask_from(&mut self, new: u8) {
        if new != 0 {
            let masks_it = |level| matches!(level, Level::From(old) if old <= new);
            self.mask_by(Level::From(new), masks_it);
        }
    }

    /// Begins a section, unless one of those that mask the same by themselves is running.
    fn mask_by(&mut self, level: Level, masks_it: impl Fn(Level) -> bool) {
        let running = &mut self.state.masked;
        let mut own = running.iter().filter(|section| !section.handed);
        if own.any(|section| masks_it(section.level)) {
            return;
        }
        match running.iter_mut().find(|section| section.level == level) {
            Some(again) => again.handed = false,
            None => self.begin_section(level),
        }
    }

    pub(super) fn begin_section(&mut self, level: Level) {
        let since = self.symbols().fresh();
        self.state.masked.push(Masked {
            level,
            cycles: Cycles::ZERO,
            at: self.instruction.address,
            since,
            handed: false,
        });
    }

    /// Ends these running sections, but for those whose interrupts another one masks: such a section
    /// goes on.
    pub(super) fn end_sections(&mut self, ends: impl Fn(&Masked) -> bool) {
        self.hand_over(ends);
        self.settle_sections();
    }

    /// What caused these running sections masks nothing any more.
    fn hand_over(&mut self, ends: impl Fn(&Masked) -> bool) {
        let running = self.state.masked.iter_mut();
        for section in running.filter(|section| ends(section)) {
            section.handed = true;
        }
    }

    /// Ends the sections whose interrupts nothing masks any more. What is still masked of them has been so since they
    /// began.
    fn settle_sections(&mut self) {
        let running = &mut self.state.masked;
        let own: Vec<Level> = running
            .iter()
            .filter(|section| !section.handed)
            .map(|section| section.level)
            .collect();
        let is_over = |section: &Masked| {
            section.handed && !own.iter().any(|level| level.covers(section.level))
        };
        let over: Vec<Masked> = running.iter().copied().filter(is_over).collect();
        running.retain(|section| !is_over(section));
        for section in running {
            for before in over
                .iter()
                .filter(|before| before.level.covers(section.level))
            {
                if section.cycles.flashed < before.cycles.flashed {
                    section.at = before.at;
                }
                section.cycles = section.cycles.max(before.cycles);
            }
        }
        self.effects.unmasked.extend(over);
    }
}
