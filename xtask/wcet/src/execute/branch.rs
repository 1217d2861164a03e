//! Branches through registers and tables, and calls.

use rsemu::cpu::arm::v7m::isa::Insn;

use crate::range::Range;
use crate::register::Register;
use crate::value::Value;

use super::data::shifted_left;
use super::memory::MAX_LOADS;
use super::step::Step;

impl Step<'_, '_> {
    /// Calls, and branches to a register.
    pub(super) fn branch(&mut self) {
        if let Insn::Bx { rm } | Insn::Blx { rm } = self.instruction.insn {
            self.effects.target = Some(self.read(rm));
        }
        if !matches!(self.instruction.insn, Insn::Bx { .. }) {
            let back = self.instruction.next() | 1;
            self.state.registers[Register::LR] = Value::constant(back);
        }
    }

    pub(super) fn table_branch(&mut self) {
        let Insn::TableBranch { rn, rm, half } = self.instruction.insn else {
            return;
        };
        let base = self.read(rn);
        let size = if half { 2 } else { 1 };
        let index = self.table_index(&base, &self.read(rm), size);
        let at = base.add(&shifted_left(&index, u8::from(half)));
        self.access(&at, true, size, 1);
        let pc = self.pc();
        let image = self.machine.image;
        let targets: Option<Vec<u32>> = (at.range.count() <= MAX_LOADS).then(|| {
            let entries = at.range.iter().filter_map(|at| image.constant(at, size));
            let targets = entries.map(|entry| pc.wrapping_add(2 * entry));
            // A padding entry leads into the table itself and is never used.
            targets.filter(|at| image.is_code(*at)).collect()
        });
        let targets = targets.and_then(|targets| self.symbols().one_of(targets));
        self.effects.target = Some(targets.unwrap_or(Value::ANY));
    }

    /// The index into the table at `base`, restricted to the entries that the table has.
    ///
    /// The linker's marks of data among code say where the table ends. That no index lies
    /// beyond is the compiler's promise: it made the table for the variants of an enumeration
    /// or the values that its own comparison lets through.
    fn table_index(&self, base: &Value, index: &Value, size: u32) -> Value {
        let table = base.as_constant();
        let Some((start, end)) = table.and_then(|at| self.machine.image.table_end(at)) else {
            return *index;
        };
        let entries = Range::between(0, (end - start) / size - 1);
        Value {
            range: index.range.meet(entries).unwrap_or(entries),
            ..*index
        }
    }
}
