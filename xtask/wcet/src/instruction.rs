//! Instructions as the emulator decodes them, and the properties that the analysis needs.

use rsemu::cpu::arm::v7m::fpisa::{DataOp, FpInsn};
use rsemu::cpu::arm::v7m::isa::{self, Cond, Insn, MemOffset};

use super::image::Image;
use super::part::Core;
use super::register::{FloatSet, Register, RegisterSet, Results};

/// One instruction of the image.
#[derive(Debug, Clone, Copy)]
pub struct Instruction {
    /// Its address.
    pub address: u32,
    /// Its size: two or four bytes.
    pub size: u32,
    /// The decoded instruction. Inside an `IT` block the narrow forms keep the flags.
    pub insn: Insn,
    /// Its condition inside an `IT` block.
    pub condition: Option<Cond>,
}

/// Where control goes after an instruction whose condition holds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    /// To the next instruction.
    Next,
    /// To `target` if the condition holds, else to the next instruction.
    Branch {
        /// The condition; `None` for `CBZ` and `CBNZ`.
        condition: Option<Cond>,
        /// The address.
        target: u32,
    },
    /// To `target`.
    Jump {
        /// The address.
        target: u32,
    },
    /// To the function at `target`, and after its return to the next instruction.
    Call {
        /// The callee.
        target: u32,
    },
    /// To the function that a register points to, and after its return to the next
    /// instruction.
    CallRegister {
        /// The register.
        register: u8,
    },
    /// To the address in a register, a table or a loaded word; a return is one of these.
    Indirect,
    /// Nowhere: a permanently undefined instruction or a breakpoint.
    Stop,
}

/// The number of a breakpoint that asks the debugger for a service and goes on with its answer in `r0`
/// (Arm, Semihosting for AArch32 and AArch64, 3).
pub(crate) const SEMIHOSTING: u8 = 0xab;

/// There is no instruction at this address.
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
        Some(image.halfword(address + 2).ok_or(NotCode(address))?)
    } else {
        None
    };
    let mut instruction = of(address, first, second).ok_or(NotCode(address))?;
    if it != 0 {
        instruction.condition = Some(Cond(it >> 4));
        if !wide {
            instruction.insn = keep_flags(instruction.insn);
        }
    }
    Ok(instruction)
}

/// The instruction of these halfwords outside an `IT` block; `None` if they are none. A narrow one leaves the
/// second out.
pub(crate) fn of(address: u32, first: u16, second: Option<u16>) -> Option<Instruction> {
    let wide = isa::is_32bit(first);
    let insn = isa::decode(first, if wide { second? } else { 0 });
    (!matches!(insn, Insn::Undefined)).then_some(Instruction {
        address,
        size: if wide { 4 } else { 2 },
        insn,
        condition: None,
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
            Insn::Bkpt { imm: SEMIHOSTING } => Flow::Next,
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

    /// Whether it goes to another function through a register or a loaded word: not a return,
    /// nor a jump through a table of its own function.
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

    /// Core registers from which the address of its memory access is computed.
    #[must_use]
    pub fn address_registers(&self) -> RegisterSet {
        match self.insn {
            Insn::LoadStore { rn, offset, .. } => {
                bit(rn)
                    | match offset {
                        MemOffset::Reg { rm, .. } => bit(rm),
                        MemOffset::Imm(_) => RegisterSet::NONE,
                    }
            }
            Insn::LoadStoreDual { rn, .. }
            | Insn::LoadStoreExclusive { rn, .. }
            | Insn::LoadStoreMultiple { rn, .. } => bit(rn),
            Insn::TableBranch { rn, rm, .. } => bit(rn) | bit(rm),
            Insn::Fp(FpInsn::Mem { rn, .. } | FpInsn::Multi { rn, .. }) => bit(rn),
            _ => RegisterSet::NONE,
        }
    }

    /// Core registers that it may write, without the program counter.
    #[must_use]
    pub fn written(&self) -> RegisterSet {
        self.destinations().without(Register::PC)
    }

    fn destinations(&self) -> RegisterSet {
        match self.insn {
            Insn::DataProc { op, rd, .. } => when(!op.is_test(), bit(rd)),
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
            } => when(load, bit(rt)) | when(wback, bit(rn)),
            Insn::LoadLiteral { rt, .. } => bit(rt),
            Insn::LoadStoreDual {
                load,
                rt,
                rt2,
                rn,
                wback,
                ..
            } => when(load, bit(rt) | bit(rt2)) | when(wback, bit(rn)),
            Insn::LoadStoreExclusive { load, rd, rt, .. } => bit(if load { rt } else { rd }),
            Insn::LoadStoreMultiple {
                load,
                rn,
                list,
                wback,
                ..
            } => when(load, RegisterSet::from_bits(list)) | when(wback, bit(rn)),
            Insn::BranchLink { .. } | Insn::Blx { .. } => RegisterSet::of(Register::LR),
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
            _ => RegisterSet::NONE,
        }
    }

    /// What it may leave to the next instruction that makes it wait.
    #[must_use]
    pub fn results(&self) -> Results {
        Results {
            registers: self.written(),
            floats: self.float_results(),
        }
    }

    /// Cycles that it waits for what the instruction before may have left: an address, and a value that the
    /// floating-point unit computes.
    #[must_use]
    pub fn stall(&self, before: Results) -> u64 {
        let addressed = self.address_registers().meets(before.registers);
        let computed = self.float_sources().meets(before.floats);
        u64::from(addressed) + u64::from(computed)
    }

    /// Floating-point registers whose value it computes, the status among them. The manual (Arm 100166
    /// 7.3.1) names arithmetic and all conversions; what only moves a value, but for one register to
    /// another, is none of these.
    fn float_results(&self) -> FloatSet {
        match self.insn {
            Insn::Fp(FpInsn::Cmp { .. }) => FloatSet::STATUS,
            Insn::Fp(insn) => computed(insn).map_or(FloatSet::NONE, |computed| {
                FloatSet::of(computed) | FloatSet::STATUS
            }),
            _ => FloatSet::NONE,
        }
    }

    /// Floating-point registers that it reads, the status among them.
    fn float_sources(&self) -> FloatSet {
        let Insn::Fp(insn) = self.insn else {
            return FloatSet::NONE;
        };
        let one = FloatSet::of;
        match insn {
            FpInsn::Data { op, d, n, m } => {
                let reads = one(n) | one(m);
                if accumulates(op) {
                    reads | one(d)
                } else {
                    reads
                }
            }
            FpInsn::Unary { m, .. }
            | FpInsn::CvtInt { m, .. }
            | FpInsn::CvtMode { m, .. }
            | FpInsn::RintMode { m, .. } => one(m),
            FpInsn::CvtFixed { d, .. } => one(d),
            // A half of the destination stays.
            FpInsn::CvtHalf { d, m, .. } => one(d) | one(m),
            FpInsn::Cmp {
                d, m, with_zero, ..
            } => one(d) | if with_zero { FloatSet::NONE } else { one(m) },
            FpInsn::Sel { n, m, .. } => one(n) | one(m),
            FpInsn::MovCore {
                to_fp: false, n, ..
            } => one(n),
            FpInsn::MovCore2 {
                to_fp: false, m, ..
            } => FloatSet::from(m, 2),
            FpInsn::Sys { to_core: true, .. } => FloatSet::STATUS,
            FpInsn::Mem {
                load: false,
                d,
                double,
                ..
            } => FloatSet::from(d, if double { 2 } else { 1 }),
            FpInsn::Multi {
                load: false,
                d,
                count,
                ..
            } => FloatSet::from(d, count),
            FpInsn::MovImm { .. }
            | FpInsn::MovCore { to_fp: true, .. }
            | FpInsn::MovCore2 { to_fp: true, .. }
            | FpInsn::Sys { to_core: false, .. }
            | FpInsn::Mem { load: true, .. }
            | FpInsn::Multi { load: true, .. } => FloatSet::NONE,
        }
    }

    /// Whether `core` has it (Armv6-M Architecture Reference Manual A5; Arm DDI 0403 A1.3 for what Armv7-M
    /// has without the extensions for signal processing and floating point).
    #[must_use]
    pub fn is_of(&self, core: Core) -> bool {
        match core {
            Core::CortexM4 => true,
            Core::CortexM3 => !matches!(
                self.insn,
                Insn::Fp(_)
                    | Insn::HalfMul { .. }
                    | Insn::DualMul { .. }
                    | Insn::Simd { .. }
                    | Insn::Sel { .. }
                    | Insn::Usad { .. }
                    | Insn::Pkh { .. }
                    | Insn::SatQ { .. }
            ),
            Core::CortexM0 | Core::CortexM0Plus => match self.insn {
                Insn::BranchLink { .. } | Insn::Mrs { .. } | Insn::Msr { .. } => true,
                Insn::Barrier { .. } | Insn::Udf { .. } => true,
                Insn::Cbz { .. } | Insn::It { .. } => false,
                _ => self.size == 2 && self.condition.is_none(),
            },
        }
    }

    /// Whether it uses the floating-point unit.
    #[must_use]
    pub fn uses_fpu(&self) -> bool {
        matches!(self.insn, Insn::Fp(_))
    }
}

/// The floating-point register whose value an instruction computes from others.
pub(crate) fn computed(insn: FpInsn) -> Option<u8> {
    match insn {
        FpInsn::Data { d, .. }
        | FpInsn::Unary { d, .. }
        | FpInsn::CvtInt { d, .. }
        | FpInsn::CvtMode { d, .. }
        | FpInsn::RintMode { d, .. }
        | FpInsn::CvtFixed { d, .. }
        | FpInsn::CvtHalf { d, .. }
        | FpInsn::Sel { d, .. } => Some(d),
        FpInsn::MovImm { .. }
        | FpInsn::Cmp { .. }
        | FpInsn::MovCore { .. }
        | FpInsn::MovCore2 { .. }
        | FpInsn::Sys { .. }
        | FpInsn::Mem { .. }
        | FpInsn::Multi { .. } => None,
    }
}

/// Whether the operation adds to its destination or subtracts from it.
pub(crate) fn accumulates(op: DataOp) -> bool {
    match op {
        DataOp::Mla
        | DataOp::Mls
        | DataOp::Nmla
        | DataOp::Nmls
        | DataOp::Fma
        | DataOp::Fms
        | DataOp::Fnma
        | DataOp::Fnms => true,
        DataOp::Mul
        | DataOp::Nmul
        | DataOp::Add
        | DataOp::Sub
        | DataOp::Div
        | DataOp::Maxnm
        | DataOp::Minnm => false,
    }
}

/// The set of one register.
fn bit(register: u8) -> RegisterSet {
    RegisterSet::of(Register::new(register))
}

/// The set if the condition holds, else none.
fn when(condition: bool, set: RegisterSet) -> RegisterSet {
    if condition { set } else { RegisterSet::NONE }
}
