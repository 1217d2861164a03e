//! Costs of instructions in core cycles.
//!
//! There are two models. [`Timing::zero_wait`] charges what the emulator charges, so a bound can
//! be compared with an observation cycle by cycle. The other one charges the worst case of the
//! core's manual ([`Core`]). What the part's flash adds at its clock, [`flash`](super::flash) says.

use rsemu::cpu::arm::v7m::fpisa::{DataOp, FpInsn, UnaryOp};
use rsemu::cpu::arm::v7m::isa::{BarrierOp, Insn};

use super::cycles::Cycles;
use super::execute::Access;
use super::flash::Reads;
use super::instruction::{Instruction, accumulates};
use super::layout::STACK;
use super::part::{Areas, Core, Part};
use super::range::Range;
use super::register::Results;

/// Wait states of one kind of memory, in core cycles beyond the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Waits {
    /// The flash, with its lines and caches.
    pub flash: Reads,
    /// RAM.
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
    core: Core,
    /// Cycles of a multiplication of a core without a fixed number.
    multiply: u64,
    flash: Areas,
    ram: Areas,
    fast: Areas,
}

/// Costs of exceptions, in cycles.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exceptions {
    /// From the request to the handler's first instruction.
    pub entry: u64,
    /// From the handler's last instruction to the interrupted one.
    pub exit: u64,
    /// Added to the first floating-point instruction of a handler that interrupted floating-point
    /// code: 17 words are saved then (lazy stacking, Arm 100166 and DDI 0403 B1.5.7).
    pub save_floats: u64,
    /// Added to the return that restores them: that of the handler itself, or of one that it
    /// preempted.
    pub restore_floats: u64,
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
    pub const fn of(part: &Part) -> Self {
        Self {
            zero_wait: Timing::zero_wait(),
            flashed: Timing::flashed(part),
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

    /// Cycles around the instructions of a handler: entry and return, and what is saved and restored
    /// if it `uses_floats`.
    #[must_use]
    pub fn around_handler(&self, uses_floats: bool) -> Cycles {
        self.cycles(|timing| {
            let exceptions = timing.exceptions();
            let floats = exceptions.save_floats + exceptions.restore_floats;
            exceptions.entry + exceptions.exit + if uses_floats { floats } else { 0 }
        })
    }

    /// Cycles that a handler which uses floating-point instructions may take for the first of them, as
    /// it saves the registers of the interrupted code.
    #[must_use]
    pub fn save_floats(&self) -> Cycles {
        self.cycles(|timing| timing.exceptions().save_floats)
    }
}

impl Timing {
    /// The emulator's charges: no wait states, divides at their fastest.
    #[must_use]
    pub const fn zero_wait() -> Self {
        Self {
            waits: None,
            core: Core::CortexM4,
            multiply: 1,
            flash: Areas::NONE,
            ram: Areas::NONE,
            fast: Areas::NONE,
        }
    }

    /// The charges of a part that runs from its flash. What DMA adds is counted for each of its
    /// transfers ([`Timing::transfer`]).
    #[must_use]
    pub const fn flashed(part: &Part) -> Self {
        Self {
            waits: Some(Waits {
                flash: Reads {
                    flash: part.flash,
                    line_bytes: part.line_bytes,
                    waits: part.flash_waits as u64,
                    ram_waits: part.ram_waits as u64,
                    reads_ahead: part.reads_ahead,
                    instruction_lines: part.instruction_lines,
                    constant_lines: part.constant_lines,
                },
                ram: part.ram_waits as u64,
                slow_peripheral: part.peripheral_waits as u64,
                fast_peripheral: part.fast_waits as u64,
            }),
            core: part.core,
            multiply: part.multiply_cycles as u64,
            flash: part.flash,
            ram: part.ram,
            fast: part.fast_peripherals,
        }
    }

    /// Most cycles for which one transfer by DMA between RAM and a peripheral keeps the core from
    /// both: one access to the RAM and one to the peripheral, each with the cycle in which the bus
    /// matrix changes its master (RM0390 2.1, AN4031).
    #[must_use]
    pub const fn transfer(&self) -> u64 {
        match self.waits {
            Some(waits) => 2 + 2 + waits.ram + waits.slow_peripheral,
            None => 0,
        }
    }

    /// How the part reads its flash; `None` by the emulator's model.
    #[must_use]
    pub const fn reads(&self) -> Option<Reads> {
        match self.waits {
            Some(waits) => Some(waits.flash),
            None => None,
        }
    }

    /// Whether this is the emulator's model.
    #[must_use]
    pub const fn is_zero_wait(&self) -> bool {
        self.waits.is_none()
    }

    /// Exception costs under this model. The vector fetch, the eight stacked words and the line to which
    /// the handler returns pay the wait states of their memories.
    #[must_use]
    pub fn exceptions(&self) -> Exceptions {
        match self.waits {
            None => Exceptions {
                entry: 12,
                exit: 10,
                // The emulator has handlers of its own count for these.
                save_floats: 0,
                restore_floats: 0,
                restart: 0,
            },
            Some(waits) => {
                let (entry, exit) = latency(self.core);
                Exceptions {
                    // Stacking and the vector fetch overlap; their sum is an upper bound. The vector
                    // waits for a read that has begun.
                    entry: entry + 8 * waits.ram + 2 * waits.flash.waits,
                    // The line of the interrupted code waits for a read that has begun, and the one
                    // behind it is read ahead anew.
                    exit: exit
                        + 8 * waits.ram
                        + 3 * waits.flash.waits
                        + if waits.flash.waits > 0 { 1 } else { 0 },
                    save_floats: 17 + 17 * waits.ram,
                    restore_floats: 17 + 17 * waits.ram,
                    // A divide begins anew. On the smaller cores a multiplication or a transfer of
                    // several words does.
                    restart: match self.core {
                        Core::CortexM3 | Core::CortexM4 => 12,
                        Core::CortexM0 | Core::CortexM0Plus => (9
                            * (1 + waits.slow_peripheral.max(waits.flash.waits)))
                        .max(self.multiply),
                    },
                }
            }
        }
    }

    /// Cycles of one executed instruction, without what it waits for the flash and without
    /// the pipeline refill of a taken branch. `previous` is what the instruction before may have left: an
    /// address that it has written, or a value that it has computed in the floating-point unit, comes a cycle
    /// later.
    #[must_use]
    pub fn instruction(
        &self,
        instruction: &Instruction,
        access: Option<&Access>,
        previous: Results,
    ) -> u64 {
        match self.waits {
            None => emulated(instruction, access),
            Some(waits) => {
                let stall = instruction.stall(previous);
                let memory = access.map_or(0, |access| {
                    let unaligned = if aligned(access) {
                        0
                    } else {
                        u64::from(access.size / 2)
                    };
                    // A store to the alias of a bit reads the word and writes it; it is aligned.
                    let read = u64::from(!access.load && may_be_bit(access.address));
                    let transfers = u64::from(access.count) + unaligned.max(read);
                    transfers * (1 + self.wait(waits, access))
                });
                let own = match self.core {
                    Core::CortexM4 => worst_case(instruction, waits),
                    Core::CortexM3 => long_multiply(instruction) + worst_case(instruction, waits),
                    Core::CortexM0 | Core::CortexM0Plus => {
                        small(self.core, self.multiply, instruction, waits)
                    }
                };
                own + stall + memory
            }
        }
    }

    /// Wait states of an access. Memory that is not known counts as the slowest. The wait states of what
    /// certainly lies in flash are counted by [`flash`](super::flash).
    fn wait(&self, waits: Waits, access: &Access) -> u64 {
        let (low, high) = access.address.unsigned();
        let within = |first: u32, last: u32| low >= first && high <= last;
        if access.load && waits.flash.reached(access.address).1 {
            0
        } else if access.address.meet(STACK) == Some(access.address)
            || within(0x2000_0000, 0x3fff_ffff)
            || self.ram.within(low, high)
            || within(0xe000_0000, 0xffff_ffff)
        {
            waits.ram
        } else if self.flash.within(low, high) {
            waits.flash.waits
        } else if self.fast.within(low, high) {
            waits.fast_peripheral
        } else {
            // The aliases of bits, from 0x4200_0000 on, are of peripherals on either bus.
            waits.slow_peripheral.max(waits.flash.waits)
        }
    }

    /// Cycles of an instruction whose `IT` condition does not hold.
    #[must_use]
    pub const fn skipped(&self) -> u64 {
        1
    }

    /// Cycles of a taken branch beyond the instruction: the pipeline refill. The wait for the line at the
    /// target comes in addition.
    #[must_use]
    pub const fn taken(&self) -> u64 {
        match self.waits {
            None => 2,
            Some(_) => refill(self.core),
        }
    }
}

/// Cycles of an exception's entry and return without wait states: from the request to the first
/// instruction of the handler (Arm DDI 0432C 3.7, DDI 0484C 3.7, DDI 0337I 5.9, Arm 100166 3.9). The manuals
/// of the smaller cores do not say how long the return takes: it transfers the eight words of the entry
/// and refills the pipeline, so the entry's figure holds for it.
const fn latency(core: Core) -> (u64, u64) {
    match core {
        Core::CortexM0 => (16, 16),
        Core::CortexM0Plus => (15, 15),
        Core::CortexM3 => (12, 12),
        Core::CortexM4 => (12, 10),
    }
}

/// Most cycles of a pipeline refill: those of a taken branch beyond the first.
const fn refill(core: Core) -> u64 {
    match core {
        Core::CortexM0 => 2,
        Core::CortexM0Plus => 1,
        Core::CortexM3 | Core::CortexM4 => 3,
    }
}

/// Cycles of a multiplication on a Cortex-M3 beyond those on a Cortex-M4 (Arm DDI 0337I table 3-1).
fn long_multiply(instruction: &Instruction) -> u64 {
    match instruction.insn {
        // 4 to 7 with an accumulator, 3 to 5 without one.
        Insn::MulLong { .. } => 6,
        Insn::Mul { .. } => 1,
        _ => 0,
    }
}

/// Most cycles of an instruction on a Cortex-M0 or Cortex-M0+ (Arm DDI 0432C and DDI 0484C, tables 3-1), its
/// memory accesses left out. What these cores do not have is charged by the Cortex-M4's manual; such an
/// instruction ends the analysis.
fn small(core: Core, multiply: u64, instruction: &Instruction, waits: Waits) -> u64 {
    let is_plus = core == Core::CortexM0Plus;
    match instruction.insn {
        Insn::Mul { .. } => multiply,
        Insn::Mrs { .. } | Insn::Msr { .. } => 4 - u64::from(is_plus),
        Insn::Cps { .. } => 1,
        Insn::Barrier { op, .. } => {
            let most = worst_case(instruction, waits);
            match op {
                BarrierOp::Dsb | BarrierOp::Dmb => most + 1,
                BarrierOp::Isb => most,
            }
        }
        // 4 with the refill of the M0, 3 with that of the M0+.
        Insn::BranchLink { .. } => 2,
        // POP with the program counter: 4 + N and 3 + N.
        Insn::LoadStoreMultiple {
            load: true, list, ..
        } if list & 0x8000 != 0 => 2,
        _ => worst_case(instruction, waits),
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
        // One by the manual, two on the emulated core.
        Insn::MulLong { .. } | Insn::HalfMul { .. } | Insn::DualMul { .. } => 2,
        Insn::Mrs { .. } | Insn::Msr { .. } | Insn::Cps { .. } => 2,
        Insn::Barrier { op, .. } => match op {
            // Waits for the write buffer: one store to the slowest memory.
            BarrierOp::Dsb | BarrierOp::Dmb => 3 + waits.slow_peripheral,
            BarrierOp::Isb => 4 + 2 * waits.flash.waits,
        },
        Insn::LoadStoreExclusive { .. } => 2,
        Insn::TableBranch { .. } => 3,
        Insn::Fp(insn) => match insn {
            FpInsn::Data { op, .. } => 1 + multiply_accumulate(op, 2, 13),
            FpInsn::Unary {
                op: UnaryOp::Sqrt, ..
            } => 14,
            FpInsn::MovCore2 { .. } => 2,
            _ => 1,
        },
        _ => 1,
    }
}

/// Cycles of a floating-point operation beyond the first: `accumulate` for one that multiplies
/// and accumulates, `divide` for a division.
fn multiply_accumulate(op: DataOp, accumulate: u64, divide: u64) -> u64 {
    match op {
        DataOp::Div => divide,
        _ if accumulates(op) => accumulate,
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

/// Whether the address may be in a bit-band alias.
fn may_be_bit(address: Range) -> bool {
    let (low, high) = address.unsigned();
    let meets = |first: u32, last: u32| low <= last && high >= first;
    meets(0x2200_0000, 0x23ff_ffff) || meets(0x4200_0000, 0x43ff_ffff)
}

/// Whether the address is certainly in a bit-band alias.
fn bit_band(address: Range) -> bool {
    let (low, high) = address.unsigned();
    (low >= 0x2200_0000 && high < 0x2400_0000) || (low >= 0x4200_0000 && high < 0x4400_0000)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::{Timing, Timings};
    use crate::execute::Access;
    use crate::instruction::Instruction;
    use crate::part::{Areas, Core, Part, STM32_FAST};
    use crate::range::Range;
    use crate::register::{FloatSet, Results};
    use rsemu::cpu::arm::v7m::isa;

    /// Flash takes 5 cycles more, RAM 1, peripherals 12 and 6.
    pub(crate) const SLOW_PART: Part = Part {
        core: Core::CortexM4,
        core_hz: 180_000_000,
        priority_bits: 4,
        start_mask: None,
        multiply_cycles: 1,
        flash: Areas::new(&[(0, 0x0fff_ffff), (0x1fff_0000, 0x1fff_ffff)]),
        flash_waits: 5,
        line_bytes: 16,
        reads_ahead: true,
        instruction_lines: 64,
        constant_lines: 8,
        ram: Areas::new(&[(0x1000_0000, 0x1000_ffff), (0x2000_0000, 0x2002_ffff)]),
        ram_waits: 1,
        peripheral_waits: 12,
        fast_peripherals: STM32_FAST,
        fast_waits: 6,
        inert: None,
    };
    const SLOW: Timing = Timing::flashed(&SLOW_PART);
    const NO_WAITS: Timing = on(Core::CortexM4, 1);

    /// A core with memories that have no wait states.
    const fn on(core: Core, multiply_cycles: u8) -> Timing {
        Timing::flashed(&Part {
            core,
            multiply_cycles,
            flash_waits: 0,
            ram_waits: 0,
            peripheral_waits: 0,
            fast_waits: 0,
            ..SLOW_PART
        })
    }

    /// `str r0, [r1]`
    const STORE: [u16; 2] = [0x6008, 0];
    /// `ldr r0, [r1]`
    const LOAD: [u16; 2] = [0x6808, 0];

    fn decoded(code: [u16; 2]) -> Instruction {
        let insn = isa::decode(code[0], code[1]);
        assert!(!matches!(insn, isa::Insn::Undefined), "{code:x?}");
        Instruction {
            address: 0x0800_0000,
            size: if isa::is_32bit(code[0]) { 4 } else { 2 },
            insn,
            condition: None,
        }
    }

    fn cost(timing: &Timing, code: [u16; 2], address: Range, count: u32) -> u64 {
        let access = Access {
            address,
            load: code[0] & 0x0800 != 0,
            size: 4,
            count,
        };
        let access = (count > 0).then_some(access);
        let instruction = decoded(code);
        timing.instruction(&instruction, access.as_ref(), Results::NONE)
    }

    /// The most cycles in the tables of the manual (Arm 100166, 3.3.1 and 7.3.1) without wait states,
    /// with the words that an instruction transfers.
    #[test]
    fn no_cost_is_below_the_manual() {
        for (name, code, words, most) in [
            ("adds", [0x1888, 0], 0, 1),
            ("mul", [0xfb01, 0xf002], 0, 1),
            ("mla", [0xfb01, 0x3002], 0, 1),
            ("umull", [0xfba2, 0x0103], 0, 1),
            ("smlal", [0xfbc2, 0x0103], 0, 1),
            ("sdiv", [0xfb91, 0xf0f2], 0, 12),
            ("udiv", [0xfbb1, 0xf0f2], 0, 12),
            ("ssat", [0xf301, 0x0007], 0, 1),
            ("ubfx", [0xf3c1, 0x00c4], 0, 1),
            ("ldr", LOAD, 1, 2),
            ("str", STORE, 1, 2),
            ("ldrd", [0xe9d2, 0x0100], 2, 3),
            ("strd", [0xe9c2, 0x0100], 2, 3),
            ("ldm of 4", [0xe890, 0x001e], 4, 5),
            ("push of 5", [0xb5f0, 0], 5, 6),
            ("ldrex", [0xe851, 0x0f00], 1, 2),
            ("strex", [0xe842, 0x1000], 1, 2),
            ("mrs", [0xf3ef, 0x8011], 0, 2),
            ("msr", [0xf380, 0x8811], 0, 2),
            ("cpsid", [0xb672, 0], 0, 2),
            ("isb", [0xf3bf, 0x8f6f], 0, 4),
            ("nop", [0xbf00, 0], 0, 1),
            ("vadd", [0xee30, 0x0a81], 0, 1),
            ("vmul", [0xee20, 0x0a81], 0, 1),
            ("vfma", [0xeea0, 0x0a81], 0, 3),
            ("vmla", [0xee00, 0x0a81], 0, 3),
            ("vdiv", [0xee80, 0x0a81], 0, 14),
            ("vsqrt", [0xeeb1, 0x0ae0], 0, 14),
            ("vcmp", [0xeeb4, 0x0a60], 0, 1),
            ("vcvt", [0xeebd, 0x0ae0], 0, 1),
            ("vldr", [0xed90, 0x0a00], 1, 2),
            ("vstr", [0xed80, 0x0a00], 1, 2),
            ("vldm of 4", [0xec90, 0x0a04], 4, 5),
            ("vmov of 2", [0xec51, 0x0a10], 0, 2),
            ("vmrs", [0xeef1, 0xfa10], 0, 1),
        ] {
            let charged = cost(&NO_WAITS, code, Range::constant(0x2000_0000), words);
            assert!(charged >= most, "{name}: {charged}, the manual has {most}");
        }
        // P is 3 at most.
        assert!(NO_WAITS.taken() >= 3);
        assert!(NO_WAITS.exceptions().entry >= 12 && NO_WAITS.exceptions().exit >= 10);
    }

    /// A result of floating-point arithmetic that the next instruction uses comes a cycle later (Arm
    /// 100166 7.3.1), as does an address.
    #[test]
    fn what_the_instruction_before_has_computed_comes_a_cycle_later() {
        // Pairs as LLVM assembles them.
        for (first, then, waits) in [
            // vadd.f32 s0, s1, s2: vmul.f32 s3, s0, s4; s3, s4, s0; s0, s3, s4; vmul.f32 s3, s4, s5
            ([0xee30, 0x0a81], [0xee60, 0x1a02], true),
            ([0xee30, 0x0a81], [0xee62, 0x1a00], true),
            ([0xee30, 0x0a81], [0xee21, 0x0a82], false),
            ([0xee30, 0x0a81], [0xee62, 0x1a22], false),
            // vfma.f32 s0, s1, s2 reads its destination, vmla.f32 too, here behind vsqrt.f32 s0, s1
            ([0xee30, 0x0a81], [0xeea0, 0x0a81], true),
            ([0xeeb1, 0x0ae0], [0xee00, 0x0a81], true),
            // vcvt.s32.f32 s0, s1: vmov r0, s0; vmov r0, r1, s0, s1; vstr s0, [r1]
            ([0xeebd, 0x0ae0], [0xee10, 0x0a10], true),
            ([0xeebd, 0x0ae0], [0xec51, 0x0a10], true),
            ([0xeebd, 0x0ae0], [0xed81, 0x0a00], true),
            // vcmp.f32 s0, s1: vmrs; vadd of what it compared
            ([0xeeb4, 0x0a60], [0xeef1, 0xfa10], true),
            ([0xeeb4, 0x0a60], [0xee30, 0x0a81], false),
            // Moved, not computed: vldr s1, [r1]; vmov s1, r0: vadd.f32 s0, s1, s2
            ([0xedd1, 0x0a00], [0xee30, 0x0a81], false),
            ([0xee00, 0x0a90], [0xee30, 0x0a81], false),
            // vpush {s0-s3} behind vadd.f32 s0, s1, s2
            ([0xee30, 0x0a81], [0xed2d, 0x0a04], true),
            // adds r1, r1, r2: ldr r0, [r1]
            ([0x1889, 0], LOAD, true),
            // ldr r0, [r1]: str r0, [r1], whose address is older
            (LOAD, STORE, false),
        ] {
            let (first, then) = (decoded(first), decoded(then));
            let of = |previous| NO_WAITS.instruction(&then, None, previous);
            let late = of(first.results()) - of(Results::NONE);
            assert_eq!(late, u64::from(waits), "{} {}", first.insn, then.insn);
            assert!(of(Results::ALL) >= of(first.results()));
            assert!(Results::ALL.holds(first.results()));
        }
        assert_eq!(FloatSet::from(30, 2), FloatSet::of(30) | FloatSet::of(31));
    }

    /// The same for the other cores, taken branches with their refill: Arm DDI 0337I table 3-1, DDI 0432C and
    /// DDI 0484C table 3-1.
    #[test]
    fn no_cost_of_another_core_is_below_its_manual() {
        let at = Range::constant(0x2000_0000);
        let rows = |core, multiply: u8, rows: &[(&str, [u16; 2], u32, bool, u64)]| {
            let timing = on(core, multiply);
            for &(name, code, words, jumps, most) in rows {
                let jump = if jumps { timing.taken() } else { 0 };
                let charged = cost(&timing, code, at, words) + jump;
                assert!(charged >= most, "{core:?} {name}: {charged}, not {most}");
            }
            timing.exceptions()
        };
        let m3 = [
            ("mul", [0xfb01, 0xf002], 0, false, 1),
            ("mla", [0xfb01, 0x3002], 0, false, 2),
            ("umull", [0xfba2, 0x0103], 0, false, 5),
            ("smlal", [0xfbc2, 0x0103], 0, false, 7),
            ("sdiv", [0xfb91, 0xf0f2], 0, false, 12),
            ("ldr", LOAD, 1, false, 2),
            ("push of 5", [0xb5f0, 0], 5, false, 6),
            ("b", [0xe7fe, 0], 0, true, 4),
        ];
        let exceptions = rows(Core::CortexM3, 1, &m3);
        assert!(exceptions.entry >= 12);
        let small = |b, bl, bx, pop, mrs, barrier| {
            [
                ("adds", [0x1888, 0], 0, false, 1),
                ("muls", [0x4348, 0], 0, false, 32),
                ("ldr", LOAD, 1, false, 2),
                ("str", STORE, 1, false, 2),
                ("push of 5", [0xb5f0, 0], 5, false, 6),
                ("pop of 4 and pc", [0xbdf0, 0], 5, true, pop),
                ("b", [0xe7fe, 0], 0, true, b),
                ("bl", [0xf000, 0xf800], 0, true, bl),
                ("bx", [0x4770, 0], 0, true, bx),
                ("blx", [0x4788, 0], 0, true, bx),
                ("mov pc", [0x4687, 0], 0, true, bx),
                ("mrs", [0xf3ef, 0x8010], 0, false, mrs),
                ("msr", [0xf380, 0x8810], 0, false, mrs),
                ("cpsid", [0xb672, 0], 0, false, 1),
                ("dsb", [0xf3bf, 0x8f4f], 0, false, barrier),
                ("isb", [0xf3bf, 0x8f6f], 0, false, barrier),
                ("nop", [0xbf00, 0], 0, false, 1),
            ]
        };
        // POP of 4 registers and PC: 4 + N on the M0, 3 + N on the M0+.
        let exceptions = rows(Core::CortexM0, 32, &small(3, 4, 3, 9, 4, 4));
        assert!(exceptions.entry >= 16 && exceptions.restart >= 32);
        let exceptions = rows(Core::CortexM0Plus, 32, &small(2, 3, 2, 8, 3, 3));
        assert!(exceptions.entry >= 15 && exceptions.restart >= 32);
        assert_eq!(cost(&on(Core::CortexM0Plus, 1), [0x4348, 0], at, 0), 1);
    }

    /// A frame with floating-point registers takes 29 cycles in all to save, and 27 to restore.
    #[test]
    fn a_handler_with_floats_saves_and_restores_those_of_the_interrupted_code() {
        let exceptions = NO_WAITS.exceptions();
        assert_eq!(exceptions.entry + exceptions.save_floats, 29);
        assert_eq!(exceptions.exit + exceptions.restore_floats, 27);
        let both = Timings::of(&SLOW_PART);
        let [with, without] = [true, false].map(|uses| both.around_handler(uses));
        assert_eq!(with - without, both.save_floats() + both.save_floats());
        assert_eq!((with - without).to_array(), [0, 2 * 34]);
    }

    #[test]
    fn a_memory_has_its_waits() {
        let load = |address: u32| cost(&SLOW, LOAD, Range::constant(address), 1);
        let store = |address: u32| cost(&SLOW, STORE, Range::constant(address), 1);
        assert_eq!([0x2000_0000, 0x1000_fffc, 0xe000_e100].map(load), [3; 3]);
        // The program, the identity of the part and what the boot loader reads from: their waits depend on
        // the state of the flash.
        assert_eq!([0x0800_0000, 0x1fff_7a10, 0x1fff_f7ac].map(load), [2; 3]);
        assert_eq!(
            [0x4000_5400, 0x4001_3000, 0x4002_3800].map(load),
            [14, 8, 8]
        );
        assert_eq!([0x2000_0000, 0x4001_3000].map(store), [3, 8]);
        // Aliases of bits: a store reads and writes the word, which may be on the slower bus.
        assert_eq!([0x2200_0000, 0x4247_0000].map(load), [3, 14]);
        assert_eq!([0x2200_0000, 0x4247_0000].map(store), [5, 27]);
        // Nothing is known: it may also be unaligned, which takes three transfers.
        assert_eq!(cost(&SLOW, STORE, Range::ALL, 1), 40);
    }
}
