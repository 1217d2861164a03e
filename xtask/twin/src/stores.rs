//! Which instructions load and store, and where: for words and registers whose stores are reported, and for
//! a debugger.

use rsemu::cpu::arm::v7m::ArmV7m;
use rsemu::cpu::arm::v7m::fpisa::FpInsn;
use rsemu::cpu::arm::v7m::isa::{self, Cond, Insn, MemOffset};
use rsemu::cpu::arm::v7m::sys::{Exception, Sys};
use std::collections::BTreeSet;
use std::ops::RangeInclusive;

/// Registers of the system control space by which a program changes who may interrupt whom, and whose
/// handler runs (DDI 0403 B3.2 and B3.4): enabling and disabling of interrupts, their priorities, the
/// vector table with the grouping of priorities, and the priorities of exceptions.
const REGISTERS: [RangeInclusive<u32>; 4] = [
    0xE000_E100..=0xE000_E1BF,
    0xE000_E400..=0xE000_E5EF,
    0xE000_ED08..=0xE000_ED0F,
    0xE000_ED18..=0xE000_ED23,
];

/// Aliases of the bits of RAM, and their first word (DDI 0403 B2.1).
const BIT_ALIASES: RangeInclusive<u32> = 0x2200_0000..=0x23FF_FFFF;
const RAM: u32 = 0x2000_0000;

/// Bytes from the first address to the last one.
pub(crate) type Bytes = (u32, u32);

/// What an address in flash holds: not known yet, nothing of interest, or from `FOUND` on the number of an
/// instruction.
const UNSEEN: u32 = 0;
const NOTHING: u32 = 1;
const FOUND: u32 = 2;

/// The bytes that an instruction accesses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Access {
    pub(crate) bytes: Bytes,
    pub(crate) writes: bool,
}

/// What is known of the accesses of the code in flash.
#[derive(Debug)]
pub(crate) struct Decoder {
    /// Bytes of flash.
    flash: usize,
    /// Whether loads count, too.
    loads: bool,
    /// What each halfword of the flash holds, decoded when it is first executed.
    code: Box<[u32]>,
    /// The instructions of interest among them.
    found: Vec<Insn>,
}

impl Clone for Decoder {
    /// One that decodes anew: the table is larger than the memory of most parts.
    fn clone(&self) -> Self {
        Self::new(self.flash, self.loads)
    }
}

impl Decoder {
    fn new(flash: usize, loads: bool) -> Self {
        Self {
            flash,
            loads,
            code: Box::default(),
            found: Vec::new(),
        }
    }

    /// Of loads and stores, with a flash of this size in bytes.
    pub(crate) fn accesses(flash: usize) -> Self {
        Self::new(flash, true)
    }

    /// The access of the instruction at `offset` of `flash` if it is executed now, or `None`. Of an
    /// instruction outside flash an `offset` beyond it is given, and `code` has its halfwords.
    #[inline]
    pub(crate) fn access(
        &mut self,
        core: &ArmV7m,
        offset: usize,
        code: impl Fn() -> Option<[u16; 2]>,
    ) -> Option<Access> {
        if self.code.is_empty() {
            self.code = vec![UNSEEN; self.flash.div_ceil(2)].into();
        }
        let known = self.code.get(offset / 2).copied();
        if known == Some(NOTHING) || core.reset_pending() {
            return None;
        }
        let number = known.and_then(|known| known.checked_sub(FOUND));
        let insn = match number.and_then(|number| self.found.get(number as usize)) {
            Some(insn) => *insn,
            None => self.decode(offset, code()?)?,
        };
        if !executes(core.xpsr()) {
            return None;
        }
        let bytes = bytes(insn, |register| core.reg(register))?;
        let writes = stores(insn);
        Some(Access { bytes, writes })
    }

    /// The instruction of interest that these halfwords at `offset` of flash are, if they are one.
    fn decode(&mut self, offset: usize, [first, second]: [u16; 2]) -> Option<Insn> {
        let insn = isa::decode(first, second);
        let counts = stores(insn) || self.loads && loads(insn);
        if let Some(known) = self.code.get_mut(offset / 2) {
            *known = NOTHING;
            if counts {
                *known = FOUND + self.found.len() as u32;
                self.found.push(insn);
            }
        }
        counts.then_some(insn)
    }
}

/// The words that are watched.
#[derive(Debug)]
pub(crate) struct Watched {
    /// Addresses of words, sorted.
    words: Box<[u32]>,
    decoder: Decoder,
}

impl Watched {
    /// For these words, with a flash of this size in bytes.
    pub(crate) fn new(words: &BTreeSet<u32>, flash: usize) -> Self {
        Self {
            words: words.iter().copied().collect(),
            decoder: Decoder::new(flash, false),
        }
    }

    /// The bytes that an instruction stores if it is executed now, as [`Decoder::access`] has them.
    #[inline]
    pub(crate) fn store(
        &mut self,
        core: &ArmV7m,
        offset: usize,
        code: impl Fn() -> Option<[u16; 2]>,
    ) -> Option<Bytes> {
        let access = self.decoder.access(core, offset, code)?;
        Some(access.bytes)
    }

    /// The watched words among these bytes.
    pub(crate) fn words(&self, bytes: Bytes) -> impl Iterator<Item = u32> {
        among(&self.words, aliased(bytes))
    }
}

/// Those of the words, whose addresses are sorted, that have one of these bytes.
pub(crate) fn among(words: &[u32], (first, last): Bytes) -> impl Iterator<Item = u32> {
    let from = words.partition_point(|word| word.saturating_add(3) < first);
    let rest = words[from..].iter().copied();
    rest.take_while(move |word| *word <= last)
}

/// Whether these bytes reach a register on which priorities or handlers depend.
pub(crate) fn reaches_registers((first, last): Bytes) -> bool {
    let mut all = REGISTERS.iter();
    all.any(|registers| *registers.start() <= last && first <= *registers.end())
}

/// What those registers hold.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Settings {
    enabled: Vec<u32>,
    priorities: [u8; Exception::COUNT],
    vectors: u32,
    group: u8,
}

impl Settings {
    pub(crate) fn of(sys: &Sys) -> Self {
        Self {
            enabled: sys.enable.to_vec(),
            priorities: sys.priority,
            vectors: sys.vtor,
            group: sys.prigroup,
        }
    }
}

/// The bytes themselves, or for aliases of bits the word with these bits.
fn aliased((first, last): Bytes) -> Bytes {
    if BIT_ALIASES.contains(&first) {
        let word = RAM + (((first - BIT_ALIASES.start()) / 32) & !3);
        (word, word + 3)
    } else {
        (first, last)
    }
}

fn stores(insn: Insn) -> bool {
    matches!(
        insn,
        Insn::LoadStore { load: false, .. }
            | Insn::LoadStoreDual { load: false, .. }
            | Insn::LoadStoreExclusive { load: false, .. }
            | Insn::LoadStoreMultiple { load: false, .. }
            | Insn::Fp(FpInsn::Mem { load: false, .. } | FpInsn::Multi { load: false, .. })
    )
}

fn loads(insn: Insn) -> bool {
    matches!(
        insn,
        Insn::LoadStore { load: true, .. }
            | Insn::LoadStoreDual { load: true, .. }
            | Insn::LoadStoreExclusive { load: true, .. }
            | Insn::LoadStoreMultiple { load: true, .. }
            | Insn::LoadLiteral { .. }
            | Insn::TableBranch { .. }
            | Insn::Fp(FpInsn::Mem { load: true, .. } | FpInsn::Multi { load: true, .. })
    )
}

/// Whether the next instruction is executed, by its condition in an `IT` block (DDI 0403 A7.3.2).
fn executes(xpsr: u32) -> bool {
    let it = (xpsr >> 25 & 3) | (xpsr >> 8 & 0xFC);
    it & 0xF == 0 || Cond((it >> 4) as u8).passes(xpsr)
}

fn bytes(insn: Insn, register: impl Fn(u8) -> u32) -> Option<Bytes> {
    // As a base, the program counter is two halfwords ahead and rounded down (DDI 0403 A5.1.2).
    let ahead = |rn: u8| register(rn).wrapping_add(if rn == 15 { 4 } else { 0 });
    let base_of = |rn: u8| ahead(rn) & if rn == 15 { !3 } else { !0 };
    let displaced = |rn: u8, by: u32, add: bool| {
        let base = base_of(rn);
        if add {
            base.wrapping_add(by)
        } else {
            base.wrapping_sub(by)
        }
    };
    let (first, size) = match insn {
        Insn::LoadStore {
            size,
            rn,
            offset,
            index,
            add,
            ..
        } => {
            let by = match offset {
                MemOffset::Imm(by) => by,
                MemOffset::Reg { rm, lsl } => register(rm) << lsl,
            };
            (displaced(rn, if index { by } else { 0 }, add), size.bytes())
        }
        Insn::LoadLiteral { size, imm, add, .. } => (displaced(15, imm, add), size.bytes()),
        Insn::TableBranch { rn, rm, half } => {
            let size = 1 + u32::from(half);
            let offset = register(rm).wrapping_mul(size);
            // The base is not rounded here.
            (ahead(rn).wrapping_add(offset), size)
        }
        Insn::LoadStoreDual {
            rn,
            imm,
            index,
            add,
            ..
        } => (displaced(rn, if index { imm } else { 0 }, add), 8),
        Insn::LoadStoreExclusive { size, rn, imm, .. } => (displaced(rn, imm, true), size.bytes()),
        Insn::LoadStoreMultiple {
            rn, list, before, ..
        } => {
            let size = 4 * list.count_ones();
            (displaced(rn, if before { size } else { 0 }, false), size)
        }
        Insn::Fp(FpInsn::Mem {
            rn,
            imm,
            add,
            double,
            ..
        }) => (displaced(rn, imm, add), if double { 8 } else { 4 }),
        Insn::Fp(FpInsn::Multi { rn, count, add, .. }) => {
            let size = 4 * u32::from(count);
            (displaced(rn, if add { 0 } else { size }, add), size)
        }
        _ => return None,
    };
    Some((first, first.wrapping_add(size.max(1) - 1).max(first)))
}

#[cfg(test)]
mod tests {
    use super::{Watched, bytes, executes, loads, reaches_registers, stores};
    use rsemu::cpu::arm::v7m::isa;
    use std::collections::BTreeSet;

    /// Registers hold 0x2000_0000 and a word for each number.
    fn stored(first: u16, second: u16) -> Option<(u32, u32)> {
        let insn = isa::decode(first, second);
        if !stores(insn) {
            return None;
        }
        let (first, last) = bytes(insn, |number| 0x2000_0000 + 0x100 * u32::from(number))?;
        Some((first - 0x2000_0000, last - 0x2000_0000))
    }

    #[test]
    fn each_store_has_its_bytes() {
        for (name, code, wanted) in [
            ("str r0, [r1, #4]", [0x6048, 0], Some((0x104, 0x107))),
            ("strb r0, [r1, #1]", [0x7048, 0], Some((0x101, 0x101))),
            ("strh r0, [r1, #2]", [0x8048, 0], Some((0x102, 0x103))),
            ("str r0, [r1, #-8]", [0xF841, 0x0C08], Some((0xF8, 0xFB))),
            ("str r0, [r1], #4", [0xF841, 0x0B04], Some((0x100, 0x103))),
            ("str r0, [r1, #4]!", [0xF841, 0x0F04], Some((0x104, 0x107))),
            (
                "strd r2, r3, [r1, #8]",
                [0xE9C1, 0x2302],
                Some((0x108, 0x10F)),
            ),
            (
                "strex r0, r2, [r1, #4]",
                [0xE841, 0x2001],
                Some((0x104, 0x107)),
            ),
            ("stm r1!, {r2, r3}", [0xC10C, 0], Some((0x100, 0x107))),
            ("push {r4, lr}", [0xB510, 0], Some((0xCF8, 0xCFF))),
            ("stmdb r1!, {r2-r4}", [0xE921, 0x001C], Some((0xF4, 0xFF))),
            ("vstr s0, [r1, #4]", [0xED81, 0x0A01], Some((0x104, 0x107))),
            ("vpush {s0-s3}", [0xED2D, 0x0A04], Some((0xCF0, 0xCFF))),
            ("vstm r1, {s0-s3}", [0xEC81, 0x0A04], Some((0x100, 0x10F))),
            ("ldr r0, [r1, #4]", [0x6848, 0], None),
            ("pop {r4, pc}", [0xBD10, 0], None),
            ("adds r0, #1", [0x3001, 0], None),
        ] {
            assert_eq!(stored(code[0], code[1]), wanted, "{name}");
        }
    }

    #[test]
    fn each_load_has_its_bytes() {
        for (name, code, wanted) in [
            ("ldr r0, [r1, #4]", [0x6848, 0], (0x104, 0x107)),
            ("ldrb r0, [r1, r2]", [0x5C88, 0], (0x2000_0300, 0x2000_0300)),
            ("pop {r4, pc}", [0xBD10, 0], (0xD00, 0xD07)),
            ("ldr r0, [pc, #8]", [0x4802, 0], (0xF0C, 0xF0F)),
            (
                "tbh [r1, r2, lsl #1]",
                [0xE8D1, 0xF012],
                (0x4000_0500, 0x4000_0501),
            ),
            ("vldr s0, [r1, #4]", [0xED91, 0x0A01], (0x104, 0x107)),
        ] {
            let insn = isa::decode(code[0], code[1]);
            assert!(loads(insn) && !stores(insn), "{name}");
            let held = |number| 0x2000_0000 + 0x100 * u32::from(number);
            let (first, last) = bytes(insn, held).unwrap();
            let found = (first - 0x2000_0000, last - 0x2000_0000);
            assert_eq!(found, wanted, "{name}");
        }
    }

    #[test]
    fn a_store_in_an_it_block_counts_by_its_condition() {
        let z = 1 << 30;
        // IT EQ before its only instruction: ITSTATE is 0b0000_1000.
        let it = 0b00_0010 << 10;
        assert!(executes(0));
        assert!(executes(z | it));
        assert!(!executes(it));
    }

    #[test]
    fn words_are_found_by_any_of_their_bytes_and_bits() {
        let watched = Watched::new(&BTreeSet::from([0x2000_0010, 0x2000_0000, 0x2000_0014]), 0);
        let found = |bytes| watched.words(bytes).collect::<Vec<_>>();
        assert_eq!(found((0x2000_0013, 0x2000_0013)), [0x2000_0010]);
        assert_eq!(
            found((0x2000_0002, 0x2000_0017)),
            [0x2000_0000, 0x2000_0010, 0x2000_0014]
        );
        assert_eq!(found((0x2000_0004, 0x2000_000F)), [0; 0]);
        // The alias of bit 9 of the word at 0x2000_0010.
        let alias = 0x2200_0000 + 0x10 * 32 + 9 * 4;
        assert_eq!(found((alias, alias + 3)), [0x2000_0010]);
    }

    #[test]
    fn registers_that_make_an_interrupt_pending_are_not_among_them() {
        assert!(reaches_registers((0xE000_E406, 0xE000_E406)));
        assert!(reaches_registers((0xE000_ED08, 0xE000_ED0B)));
        assert!(reaches_registers((0xE000_E180, 0xE000_E183)));
        assert!(!reaches_registers((0xE000_E200, 0xE000_E203)));
        assert!(!reaches_registers((0xE000_ED04, 0xE000_ED07)));
    }
}
