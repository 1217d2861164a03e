//! The effect of one instruction on the abstract machine.

mod bits;
mod branch;
mod data;
mod executor;
mod fpu;
mod held;
mod interrupts;
mod memory;
mod multiply;
mod narrow;
mod step;
mod system;
mod transfer;

use std::rc::Rc;

use rsemu::cpu::arm::v7m::isa::Insn;

pub(crate) use executor::{Access, Effects, Executor};
use step::Step;

use super::instruction::{Instruction, SEMIHOSTING};
use super::pend::SUPERVISOR_CALL;
use super::state::State;

impl Executor<'_> {
    /// Executes `instruction`; its condition is taken to hold.
    pub(crate) fn execute(&mut self, state: &mut State, instruction: &Instruction) -> Effects {
        let started = state.started;
        let mut step = Step {
            machine: self,
            state,
            instruction,
            effects: Effects::default(),
        };
        step.run();
        let effects = step.effects;
        if !started && state.started {
            self.memory.enabled(&state.memory);
            state.memory = Rc::default();
            let touched = std::mem::take(&mut state.touched);
            self.memory.touched.extend(touched.iter());
        }
        if !started && effects.unknown_mask {
            self.memory.lost = true;
        }
        effects
    }
}

impl Step<'_, '_> {
    fn run(&mut self) {
        match self.instruction.insn {
            Insn::DataProc { .. } => self.data_processing(),
            Insn::ShiftReg { .. } => self.shift_by_register(),
            Insn::Adr { .. } | Insn::MovImm16 { .. } => self.load_constant(),
            Insn::BranchLink { .. } | Insn::Blx { .. } | Insn::Bx { .. } => self.branch(),
            Insn::TableBranch { .. } => self.table_branch(),
            Insn::LoadStore { .. } => self.load_or_store(),
            Insn::LoadLiteral { .. } => self.load_literal(),
            Insn::LoadStoreDual { .. } => self.load_or_store_dual(),
            Insn::LoadStoreExclusive { .. } => self.load_or_store_exclusive(),
            Insn::LoadStoreMultiple { .. } => self.load_or_store_multiple(),
            Insn::Mul { .. } => self.multiply(),
            Insn::MulLong { .. } => self.multiply_long(),
            Insn::Div { .. } => self.divide(),
            Insn::HalfMul { .. } | Insn::DualMul { .. } => self.multiply_halfwords(),
            Insn::Sat { .. } => self.saturate(),
            Insn::Extend { .. } => self.extend(),
            Insn::Misc { .. } => self.reverse_or_count(),
            Insn::Bitfield { .. } => self.bit_field(),
            Insn::SatQ { rd, .. }
            | Insn::Simd { rd, .. }
            | Insn::Sel { rd, .. }
            | Insn::Usad { rd, .. }
            | Insn::Pkh { rd, .. } => self.forget(rd),
            Insn::Mrs { .. } | Insn::Msr { .. } | Insn::Cps { .. } => self.system(),
            Insn::Fp(insn) => self.floating_point(insn),
            // The debugger's answer.
            Insn::Bkpt { imm: SEMIHOSTING } => self.forget(0),
            Insn::ClearExclusive => self.state.reserved = None,
            Insn::Svc { .. } => self.note_pend(SUPERVISOR_CALL, true),
            // The other instructions move neither data nor control, or the targets do not
            // have them. Registers keep their values, or the path ends.
            _ => {}
        }
    }
}
