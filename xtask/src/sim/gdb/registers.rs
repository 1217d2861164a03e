//! The registers of a Cortex-M4F as gdb knows them.

use std::num::NonZeroUsize;

use gdbstub::arch::{Arch, RegId, Registers as GdbRegisters};
use twin::mcu::Registers;

/// The architecture.
#[derive(Debug)]
pub(super) enum CortexM {}

impl Arch for CortexM {
    type Usize = u32;
    type Registers = File;
    type BreakpointKind = usize;
    type RegId = Number;

    /// The features are gdb's own, with these names and this order (gdb manual, "ARM Features").
    fn target_description_xml() -> Option<&'static str> {
        Some(include_str!("target.xml"))
    }
}

/// The number of a register, in the order of the description.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Number(usize);

/// r0 to r15 and xpsr; then d0 to d15; then fpscr, msp, psp, primask, basepri, faultmask and control.
const WORDS: usize = 17;
const DOUBLES: usize = 16;
const OTHERS: usize = 7;

impl Number {
    /// Where the register is in [`File::bytes`].
    pub(super) fn place(self) -> std::ops::Range<usize> {
        let start = 4 * self.0 + 4 * self.0.clamp(WORDS, WORDS + DOUBLES) - 4 * WORDS;
        let double = (WORDS..WORDS + DOUBLES).contains(&self.0);
        start..start + if double { 8 } else { 4 }
    }
}

impl RegId for Number {
    fn from_raw_id(id: usize) -> Option<(Self, Option<NonZeroUsize>)> {
        let number = (id < WORDS + DOUBLES + OTHERS).then_some(Self(id))?;
        Some((number, NonZeroUsize::new(number.place().len())))
    }
}

/// All registers.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct File(pub(super) Registers);

impl File {
    /// Their bytes as gdb sends them.
    pub(super) fn bytes(&self) -> Vec<u8> {
        let of = &self.0;
        let mut words = of.r.to_vec();
        words.push(of.xpsr);
        words.extend(of.s);
        words.extend([of.fpscr, of.msp, of.psp]);
        words.extend([u32::from(of.primask), of.basepri.into()]);
        words.extend([of.faultmask.into(), of.control]);
        words.into_iter().flat_map(u32::to_le_bytes).collect()
    }

    /// The registers of these bytes, if they are all.
    pub(super) fn of(bytes: &[u8]) -> Option<Self> {
        let mut words = bytes
            .as_chunks::<4>()
            .0
            .iter()
            .map(|word| u32::from_le_bytes(*word));
        let mut next = || words.next();
        let mut registers = Registers::default();
        for value in &mut registers.r {
            *value = next()?;
        }
        registers.xpsr = next()?;
        for value in &mut registers.s {
            *value = next()?;
        }
        registers.fpscr = next()?;
        registers.msp = next()?;
        registers.psp = next()?;
        registers.primask = next()? & 1 != 0;
        registers.basepri = next()? as u8;
        registers.faultmask = next()? & 1 != 0;
        registers.control = next()?;
        Some(Self(registers))
    }
}

impl GdbRegisters for File {
    type ProgramCounter = u32;

    fn pc(&self) -> u32 {
        self.0.r[15]
    }

    fn gdb_serialize(&self, mut write_byte: impl FnMut(Option<u8>)) {
        for byte in self.bytes() {
            write_byte(Some(byte));
        }
    }

    fn gdb_deserialize(&mut self, bytes: &[u8]) -> Result<(), ()> {
        *self = Self::of(bytes).ok_or(())?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file() -> File {
        let mut registers = Registers {
            xpsr: 0x6100_0026,
            msp: 0x2000_0100,
            psp: 0x2000_0200,
            primask: true,
            basepri: 0x40,
            faultmask: false,
            control: 4,
            fpscr: 1 << 28,
            ..Registers::default()
        };
        for (value, number) in registers.r.iter_mut().chain(&mut registers.s).zip(1..) {
            *value = number;
        }
        File(registers)
    }

    #[test]
    fn registers_survive_the_way_to_gdb_and_back() {
        let bytes = file().bytes();
        assert_eq!(File::of(&bytes), Some(file()));
        assert_eq!(File::of(&bytes[1..]), None);
        let mut again = File::default();
        again.gdb_deserialize(&bytes).unwrap();
        assert_eq!(again, file());
    }

    #[test]
    fn each_number_has_its_place_and_its_name() {
        let bytes = file().bytes();
        let held = |id| {
            let (number, size) = Number::from_raw_id(id).unwrap();
            let bytes = &bytes[number.place()];
            assert_eq!(Some(bytes.len()), size.map(NonZeroUsize::get));
            u32::from_le_bytes(bytes[..4].try_into().unwrap())
        };
        let names = target_names();
        assert_eq!(names.len(), 40);
        assert!(Number::from_raw_id(names.len()).is_none());
        for (name, value) in [
            ("r0", 1),
            ("pc", 16),
            ("xpsr", 0x6100_0026),
            ("d0", 17),
            ("d15", 17 + 30),
            ("fpscr", 1 << 28),
            ("msp", 0x2000_0100),
            ("psp", 0x2000_0200),
            ("primask", 1),
            ("basepri", 0x40),
            ("control", 4),
        ] {
            let id = names.iter().position(|one| one == name).unwrap();
            assert_eq!(held(id), value, "{name}");
        }
    }

    /// The names of the registers in the order of the description.
    fn target_names() -> Vec<String> {
        let text = CortexM::target_description_xml().unwrap();
        let registers = text.split("<reg name=\"").skip(1);
        let name = |rest: &str| rest.split('"').next().unwrap().to_owned();
        registers.map(name).collect()
    }
}
