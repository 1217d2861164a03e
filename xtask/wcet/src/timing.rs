//! Costs of instructions in core cycles.
//!
//! There are two models. [`Timing::zero_wait`] charges what the emulator charges, so a bound can
//! be compared with an observation cycle by cycle. The other one charges the worst case of the
//! Cortex-M4 manual (Arm 100166, "Instruction set summary"), with the part's flash at its clock
//! and without any benefit of caches or prefetch.

use parts::Sled;
use rsemu::cpu::arm::v7m::fpisa::{DataOp, FpInsn, UnaryOp};
use rsemu::cpu::arm::v7m::isa::{BarrierOp, Insn};

use super::cycles::Cycles;
use super::execute::Access;
use super::instruction::Instruction;
use super::layout::STACK;
use super::range::Range;
use super::register::RegisterSet;

/// Wait states of one kind of memory, in core cycles beyond the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Waits {
    /// A flash line of code or constants.
    pub flash: u64,
    /// RAM while a DMA transfer uses it.
    pub ram: u64,
    /// A peripheral on the slower bus, with the synchronisation of the bridge.
    pub slow_peripheral: u64,
    /// A peripheral on the faster bus or on AHB.
    pub fast_peripheral: u64,
}

/// Timing of a core with its memories.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timing {
    /// `None`: as the emulator charges.
    waits: Option<Waits>,
    /// Bytes fetched from flash at once.
    line: u32,
}

/// Costs of exceptions, in cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exceptions {
    /// From the request to the handler's first instruction.
    pub entry: u64,
    /// From the handler's last instruction to the interrupted one.
    pub exit: u64,
    /// From one handler to the next, without unstacking.
    pub tail_chain: u64,
    /// Added to the first floating-point instruction of a handler that interrupted
    /// floating-point code (lazy stacking of 17 words).
    pub lazy_stacking: u64,
    /// Added when an interrupted instruction is restarted (a divide).
    pub restart: u64,
}

/// The timing of a core under both models.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Timings {
    /// As the emulator charges.
    pub zero_wait: Timing,
    /// As flashed.
    pub flashed: Timing,
}

impl Timings {
    /// Both models of a part.
    #[must_use]
    pub const fn of(part: Timing) -> Self {
        Self {
            zero_wait: Timing::zero_wait(),
            flashed: part,
        }
    }

    /// Computes a cost under each model.
    pub fn cycles(&self, mut cost: impl FnMut(&Timing) -> u64) -> Cycles {
        Cycles {
            zero_wait: cost(&self.zero_wait),
            flashed: cost(&self.flashed),
        }
    }

    /// Cycles from the request of an exception to its handler's first instruction.
    #[must_use]
    pub fn exception_entry(&self) -> Cycles {
        self.cycles(|timing| timing.exceptions().entry)
    }

    /// Cycles from the handler's last instruction to the interrupted one.
    #[must_use]
    pub fn exception_exit(&self) -> Cycles {
        self.cycles(|timing| timing.exceptions().exit)
    }
}

impl Timing {
    /// The emulator's charges: no wait states, divides at their fastest.
    #[must_use]
    pub const fn zero_wait() -> Self {
        Self {
            waits: None,
            line: 4,
        }
    }

    /// A board on its external clock: flash wait states and line length of its part at
    /// the core's clock. A peripheral access takes at most three periods of its bus: two of
    /// the transfer, one of synchronisation. RAM waits one cycle for a DMA transfer.
    #[must_use]
    pub const fn flashed(sled: &Sled) -> Self {
        let (flash, clocks) = (&sled.part.flash_access, &sled.external);
        let waits = match flash.wait_states(clocks.core) {
            Some(states) => states as u64,
            None => unreachable!(),
        };
        Self {
            waits: Some(Waits {
                flash: waits,
                ram: 1,
                slow_peripheral: 3 * (clocks.core / clocks.apb1) as u64,
                fast_peripheral: 3 * (clocks.core / clocks.apb2) as u64,
            }),
            line: flash.line_bytes,
        }
    }

    /// Whether this is the emulator's model.
    #[must_use]
    pub const fn is_zero_wait(&self) -> bool {
        self.waits.is_none()
    }

    /// Exception costs under this model. Vector fetch, first code line and
    /// the eight stacked words pay the wait states of their memories.
    #[must_use]
    pub fn exceptions(&self) -> Exceptions {
        match self.waits {
            None => Exceptions {
                entry: 12,
                exit: 10,
                tail_chain: 6,
                lazy_stacking: 17,
                restart: 0,
            },
            Some(waits) => Exceptions {
                // Stacking and the vector fetch overlap; their sum is an upper bound.
                entry: 12 + 8 * waits.ram + 2 * waits.flash,
                exit: 10 + 8 * waits.ram + waits.flash,
                tail_chain: 6 + 2 * waits.flash,
                lazy_stacking: 17 + 17 * waits.ram,
                restart: 12,
            },
        }
    }

    /// Cycles of one executed instruction, without the fetch of its flash line and without
    /// the pipeline refill of a taken branch. `previous` are the registers that the
    /// instruction before may have written.
    #[must_use]
    pub fn instruction(
        &self,
        instruction: &Instruction,
        access: Option<&Access>,
        previous: RegisterSet,
    ) -> u64 {
        match self.waits {
            None => emulated(instruction, access),
            Some(waits) => {
                let stall = u64::from(instruction.address_registers().meets(previous));
                let memory = access.map_or(0, |access| {
                    let unaligned = if aligned(access) {
                        0
                    } else {
                        u64::from(access.size / 2)
                    };
                    (u64::from(access.count) + unaligned) * (1 + self.wait(waits, access))
                });
                worst_case(instruction, waits) + stall + memory
            }
        }
    }

    /// Wait states of an access. Memory that is not known counts as the slowest.
    fn wait(&self, waits: Waits, access: &Access) -> u64 {
        let (low, high) = access.address.unsigned();
        let within = |first: u32, last: u32| low >= first && high <= last;
        if access.address.meet(STACK) == Some(access.address)
            || within(0x2000_0000, 0x3fff_ffff)
            || within(0x1000_0000, 0x1fff_ffff)
            || within(0xe000_0000, 0xffff_ffff)
        {
            waits.ram
        } else if within(0x0000_0000, 0x0fff_ffff) {
            waits.flash
        } else if within(0x4001_0000, 0x5fff_ffff) {
            waits.fast_peripheral
        } else {
            waits.slow_peripheral.max(waits.flash)
        }
    }

    /// Whether the access may read flash, so that the line in the fetch buffer is lost.
    #[must_use]
    pub fn reads_flash(&self, access: &Access) -> bool {
        let (low, high) = access.address.unsigned();
        self.waits.is_some()
            && (low < 0x1000_0000 || high < low)
            && access.address.meet(STACK) != Some(access.address)
    }

    /// Cycles of an instruction whose `IT` condition does not hold.
    #[must_use]
    pub const fn skipped(&self) -> u64 {
        1
    }

    /// Cycles of a taken branch beyond the instruction: the pipeline refill, the current fetch,
    /// which cannot be cancelled, and the line at the target.
    #[must_use]
    pub const fn taken(&self) -> u64 {
        match self.waits {
            None => 2,
            Some(waits) => 3 + 2 * waits.flash,
        }
    }

    /// Cycles to fetch the flash lines of an instruction at `address`, if `held` is the line
    /// that was fetched last; and the line that is held afterwards.
    #[must_use]
    pub fn fetch(&self, address: u32, size: u32, held: Option<u32>) -> (u64, Option<u32>) {
        let Some(waits) = self.waits else {
            return (0, None);
        };
        if !(0x0000_0000..0x1000_0000).contains(&address) {
            return (0, None);
        }
        let first = address / self.line;
        let last = (address + size - 1) / self.line;
        let lines = u64::from(held != Some(first)) + u64::from(last != first);
        (lines * waits.flash, Some(last))
    }

    /// The line that is held after a taken branch to `address`.
    #[must_use]
    pub fn line_at(&self, address: u32) -> Option<u32> {
        self.waits.map(|_| address / self.line)
    }
}

/// Cycles that the emulator charges for an instruction.
fn emulated(instruction: &Instruction, access: Option<&Access>) -> u64 {
    let transfers = access.map_or(0, |access| u64::from(access.count));
    let extra = match instruction.insn {
        Insn::Div { .. } => 2,
        Insn::MulLong { .. } | Insn::HalfMul { .. } | Insn::DualMul { .. } => 1,
        Insn::Fp(insn) => match insn {
            FpInsn::Data { op, .. } => multiply_accumulate(op, 2, 13),
            FpInsn::Unary {
                op: UnaryOp::Sqrt, ..
            } => 13,
            FpInsn::MovCore2 { .. } => 1,
            _ => 0,
        },
        _ => 0,
    };
    // A bit-band store reads and writes.
    let alias = access.is_some_and(|access| !access.load && bit_band(access.address));
    1 + transfers + extra + u64::from(alias)
}

/// Most cycles of an instruction by the manual, its memory accesses left out.
fn worst_case(instruction: &Instruction, waits: Waits) -> u64 {
    match instruction.insn {
        Insn::Div { .. } => 12,
        Insn::Mrs { .. } | Insn::Msr { .. } | Insn::Cps { .. } => 2,
        Insn::Barrier { op, .. } => match op {
            // Waits for the write buffer: one store to the slowest memory.
            BarrierOp::Dsb | BarrierOp::Dmb => 3 + waits.slow_peripheral,
            BarrierOp::Isb => 4 + 2 * waits.flash,
        },
        Insn::LoadStoreExclusive { .. } => 2,
        Insn::TableBranch { .. } => 3,
        Insn::Fp(insn) => match insn {
            FpInsn::Data { op, .. } => 2 + multiply_accumulate(op, 2, 13),
            FpInsn::Unary {
                op: UnaryOp::Sqrt, ..
            } => 15,
            FpInsn::Mem { .. } | FpInsn::Multi { .. } => 1,
            FpInsn::MovCore2 { .. } => 3,
            _ => 2,
        },
        _ => 1,
    }
}

/// Cycles of a floating-point operation beyond the first: `accumulate` for one that multiplies
/// and accumulates, `divide` for a division.
fn multiply_accumulate(op: DataOp, accumulate: u64, divide: u64) -> u64 {
    match op {
        DataOp::Div => divide,
        DataOp::Mla
        | DataOp::Mls
        | DataOp::Nmla
        | DataOp::Nmls
        | DataOp::Fma
        | DataOp::Fms
        | DataOp::Fnma
        | DataOp::Fnms => accumulate,
        _ => 0,
    }
}

/// Whether the access is certainly aligned to its size.
fn aligned(access: &Access) -> bool {
    access.size == 1
        || access
            .address
            .and(Range::constant(access.size - 1))
            .as_constant()
            == Some(0)
        || access.count > 1
}

/// Whether the address is certainly in a bit-band alias.
fn bit_band(address: Range) -> bool {
    let (low, high) = address.unsigned();
    (low >= 0x2200_0000 && high < 0x2400_0000) || (low >= 0x4200_0000 && high < 0x4400_0000)
}
