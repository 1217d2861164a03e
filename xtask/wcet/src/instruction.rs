//! Instructions as the emulator decodes them, with what the analysis asks.

use rsemu::cpu::arm::v7m::fpisa::FpInsn;
use rsemu::cpu::arm::v7m::isa::{self, Cond, DpOp, Insn, MemOffset, Operand};

use super::image::Image;

/// One instruction of the image.
#[derive(Debug, Clone, Copy)]
pub struct Instruction {
    /// Where it stands.
    pub address: u32,
    /// Two or four bytes.
    pub size: u32,
    /// What it does. Inside an `IT` block the narrow forms keep the flags.
    pub insn: Insn,
    /// Its condition inside an `IT` block.
    pub condition: Option<Cond>,
}

/// Where control goes after an instruction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    /// On to the next instruction.
    Next,
    /// To `target` if the condition holds, else on.
    Branch {
        /// Taken when it holds; `None` for `CBZ` and `CBNZ`.
        condition: Option<Cond>,
        /// Where to.
        target: u32,
    },
    /// To `target`.
    Jump {
        /// Where to.
        target: u32,
    },
    /// Calls the function at `target` and goes on after it.
    Call {
        /// The callee.
        target: u32,
    },
    /// Calls the function a register points to and goes on after it.
    CallRegister {
        /// The register.
        register: u8,
    },
    /// Wherever a register, a table or a loaded word says, `LR` returning.
    Indirect,
    /// Never on: a permanently undefined instruction or a breakpoint.
    Stop,
}

/// No instruction can be decoded at this address.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NotCode(pub u32);

/// Decodes the instruction at `address`; `it` is the `IT` state before it.
///
/// # Errors
/// When the image holds no instruction there.
pub fn decode(image: &Image, address: u32, it: u8) -> Result<Instruction, NotCode> {
    let first = image.halfword(address).ok_or(NotCode(address))?;
    let wide = isa::is_32bit(first);
    let second = if wide {
        image.halfword(address + 2).ok_or(NotCode(address))?
    } else {
        0
    };
    let mut insn = isa::decode(first, second);
    if it != 0 && !wide {
        insn = keep_flags(insn);
    }
    if matches!(insn, Insn::Undefined) {
        return Err(NotCode(address));
    }
    Ok(Instruction {
        address,
        size: if wide { 4 } else { 2 },
        insn,
        condition: (it != 0).then_some(Cond(it >> 4)),
    })
}

/// `ITSTATE` after an instruction (DDI 0403 A7.3.2).
#[must_use]
pub fn advance_it(it: u8) -> u8 {
    if it & 0b111 == 0 {
        0
    } else {
        (it & 0b1110_0000) | ((it << 1) & 0b1_1111)
    }
}

/// The narrow data-processing forms set the flags only outside an `IT` block.
fn keep_flags(insn: Insn) -> Insn {
    match insn {
        Insn::DataProc {
            op,
            rd,
            rn,
            operand,
            ..
        } if !op.is_test() => Insn::DataProc {
            op,
            s: false,
            rd,
            rn,
            operand,
        },
        Insn::ShiftReg { ty, rd, rn, rm, .. } => Insn::ShiftReg {
            ty,
            s: false,
            rd,
            rn,
            rm,
        },
        Insn::Mul {
            rd,
            rn,
            rm,
            ra,
            sub,
            ..
        } => Insn::Mul {
            rd,
            rn,
            rm,
            ra,
            sub,
            s: false,
        },
        other => other,
    }
}

impl Instruction {
    /// Address of the instruction after it.
    #[must_use]
    pub fn next(&self) -> u32 {
        self.address + self.size
    }

    /// Where control goes when its `IT` condition, if any, holds.
    #[must_use]
    pub fn flow(&self) -> Flow {
        let relative = |offset: i32| self.address.wrapping_add(4).wrapping_add_signed(offset);
        match self.insn {
            Insn::Branch {
                cond: Some(cond),
                offset,
            } => Flow::Branch {
                condition: Some(cond),
                target: relative(offset),
            },
            Insn::Branch { cond: None, offset } => Flow::Jump {
                target: relative(offset),
            },
            Insn::Cbz { offset, .. } => Flow::Branch {
                condition: None,
                target: self.address + 4 + offset,
            },
            Insn::BranchLink { offset } => Flow::Call {
                target: relative(offset),
            },
            Insn::Blx { rm } => Flow::CallRegister { register: rm },
            Insn::Bx { .. } | Insn::TableBranch { .. } => Flow::Indirect,
            Insn::Udf { .. } | Insn::Bkpt { .. } => Flow::Stop,
            Insn::DataProc { op, rd: 15, .. } if !op.is_test() => Flow::Indirect,
            Insn::LoadStore {
                load: true, rt: 15, ..
            }
            | Insn::LoadLiteral { rt: 15, .. } => Flow::Indirect,
            Insn::LoadStoreMultiple {
                load: true, list, ..
            } if list & 0x8000 != 0 => Flow::Indirect,
            _ => Flow::Next,
        }
    }

    /// Whether it goes to another function through a register or a loaded word, and neither
    /// back to the caller nor through a table of its own function.
    #[must_use]
    pub fn calls_through_pointer(&self) -> bool {
        match (self.flow(), self.insn) {
            (Flow::CallRegister { .. }, _) => true,
            (Flow::Indirect, Insn::Bx { rm }) => rm != 14,
            (Flow::Indirect, Insn::TableBranch { .. } | Insn::LoadStoreMultiple { .. }) => false,
            // `pop {pc}` with one register.
            (Flow::Indirect, Insn::LoadStore { rn: 13, .. }) => false,
            (flow, _) => flow == Flow::Indirect,
        }
    }

    /// Core registers that the address of its memory access is made of.
    #[must_use]
    pub fn address_registers(&self) -> u16 {
        let bit = |register: u8| 1u16 << register;
        match self.insn {
            Insn::LoadStore { rn, offset, .. } => {
                bit(rn)
                    | match offset {
                        MemOffset::Reg { rm, .. } => bit(rm),
                        MemOffset::Imm(_) => 0,
                    }
            }
            Insn::LoadStoreDual { rn, .. }
            | Insn::LoadStoreExclusive { rn, .. }
            | Insn::LoadStoreMultiple { rn, .. } => bit(rn),
            Insn::TableBranch { rn, rm, .. } => bit(rn) | bit(rm),
            Insn::Fp(FpInsn::Mem { rn, .. } | FpInsn::Multi { rn, .. }) => bit(rn),
            _ => 0,
        }
    }

    /// Core registers it may write, the program counter excluded.
    #[must_use]
    pub fn written(&self) -> u16 {
        let bit = |register: u8| if register < 15 { 1u16 << register } else { 0 };
        match self.insn {
            Insn::DataProc { op, rd, .. } => {
                if op.is_test() {
                    0
                } else {
                    bit(rd)
                }
            }
            Insn::ShiftReg { rd, .. }
            | Insn::Adr { rd, .. }
            | Insn::MovImm16 { rd, .. }
            | Insn::Mul { rd, .. }
            | Insn::Div { rd, .. }
            | Insn::Sat { rd, .. }
            | Insn::SatQ { rd, .. }
            | Insn::Simd { rd, .. }
            | Insn::Sel { rd, .. }
            | Insn::Usad { rd, .. }
            | Insn::Pkh { rd, .. }
            | Insn::Extend { rd, .. }
            | Insn::Misc { rd, .. }
            | Insn::Bitfield { rd, .. }
            | Insn::Mrs { rd, .. } => bit(rd),
            Insn::HalfMul { rd, ra, .. } | Insn::DualMul { rd, ra, .. } => bit(rd) | bit(ra),
            Insn::MulLong { rdlo, rdhi, .. } => bit(rdlo) | bit(rdhi),
            Insn::LoadStore {
                load,
                rt,
                rn,
                wback,
                ..
            } => (if load { bit(rt) } else { 0 }) | (if wback { bit(rn) } else { 0 }),
            Insn::LoadLiteral { rt, .. } => bit(rt),
            Insn::LoadStoreDual {
                load,
                rt,
                rt2,
                rn,
                wback,
                ..
            } => (if load { bit(rt) | bit(rt2) } else { 0 }) | (if wback { bit(rn) } else { 0 }),
            Insn::LoadStoreExclusive { load, rd, rt, .. } => {
                if load {
                    bit(rt)
                } else {
                    bit(rd)
                }
            }
            Insn::LoadStoreMultiple {
                load,
                rn,
                list,
                wback,
                ..
            } => (if load { list & 0x7fff } else { 0 }) | (if wback { bit(rn) } else { 0 }),
            Insn::BranchLink { .. } | Insn::Blx { .. } => bit(14),
            Insn::Fp(FpInsn::MovCore {
                to_fp: false, rt, ..
            }) => bit(rt),
            Insn::Fp(FpInsn::MovCore2 {
                to_fp: false,
                rt,
                rt2,
                ..
            }) => bit(rt) | bit(rt2),
            Insn::Fp(FpInsn::Sys {
                to_core: true, rt, ..
            }) => bit(rt),
            Insn::Fp(FpInsn::Multi {
                rn,
                writeback: true,
                ..
            }) => bit(rn),
            _ => 0,
        }
    }

    /// Whether it uses the floating-point unit.
    #[must_use]
    pub fn uses_fpu(&self) -> bool {
        matches!(self.insn, Insn::Fp(_))
    }

    /// The destination of a plain register move.
    #[must_use]
    pub fn is_move_to_pc(&self) -> Option<Operand> {
        match self.insn {
            Insn::DataProc {
                op: DpOp::Mov,
                rd: 15,
                operand,
                ..
            } => Some(operand),
            _ => None,
        }
    }
}
