//! Every access against a table of the part's registers: which exist, how they can be accessed,
//! and which of their bits are reserved.
//!
//! The tables are checked in as `facts/f446.txt` and `facts/f303.txt`; their headers say what they
//! were made from. A test compares them with a second witness.

use crate::part::{Family, Part};
use std::sync::OnceLock;

/// The document that lists the registers.
fn document(family: Family) -> &'static str {
    match family {
        Family::F4 => "RM0390, register map of the peripheral",
        Family::F3 => "RM0316, register map of the peripheral",
    }
}

/// A register.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Register {
    /// Name of the peripheral and of the register.
    pub name: String,
    pub readable: bool,
    pub writable: bool,
    /// Value after a reset.
    pub reset: u32,
    /// Bits that have a field; the others are reserved.
    pub fields: u32,
}

/// Sizes of an access that a peripheral takes, in bytes: smallest read, smallest write.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sizes {
    read: usize,
    write: usize,
}

/// Words in a page of registers.
const WORDS: usize = 0x400 / 4;

/// The registers in 1 KiB of addresses.
#[derive(Debug)]
struct Page {
    base: u32,
    sizes: Sizes,
    /// Index of each word's register, from 1; 0 means that there is none.
    words: [u16; WORDS],
}

/// The registers of a part.
#[derive(Debug)]
pub(crate) struct Table {
    family: Family,
    pages: Vec<Page>,
    registers: Vec<Register>,
}

/// An access of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Access {
    Read,
    /// The bytes of the word that are written, in their places, and a mask of their bits.
    Write {
        value: u32,
        mask: u32,
    },
}

/// The sizes that the manuals allow, at the beginning of each chapter's register descriptions.
fn sizes(family: Family, peripheral: &str) -> Sizes {
    let of = |read, write| Sizes { read, write };
    match (family, peripheral.trim_end_matches(char::is_numeric)) {
        (_, "GPIOA" | "GPIOB" | "GPIOC" | "GPIOD" | "GPIOE" | "GPIOF" | "GPIOG" | "GPIOH") => {
            of(1, 1)
        }
        (_, "RCC" | "FLASH") => of(1, 1),
        (_, "TIM") => of(1, 2),
        (_, "IWDG" | "PWR") | (Family::F4, "USART") => of(2, 2),
        (Family::F4, "ADC" | "ADC_COMMON") => of(1, 4),
        _ => of(4, 4),
    }
}

/// Corrections of a table: registers that the part does not have.
fn missing(family: Family, name: &str) -> bool {
    // One controller has 14 filter banks (RM0316 31.3); the description lists 28.
    let bank = name
        .strip_prefix("CAN_FB")
        .and_then(|rest| rest.split('_').next())
        .and_then(|number| number.parse::<u32>().ok());
    family == Family::F3 && bank.is_some_and(|bank| bank >= 14)
}

/// One line of a facts file after the peripheral's: offset and register.
fn register(peripheral: &str, line: &str) -> Option<(u32, Register)> {
    let mut words = line.split_whitespace();
    let hex = |word: Option<&str>| u32::from_str_radix(word?, 16).ok();
    let offset = hex(words.next())?;
    let (name, access) = (words.next()?, words.next()?);
    let register = Register {
        name: format!("{peripheral}_{name}"),
        readable: access != "w",
        writable: access != "r",
        reset: hex(words.next())?,
        fields: hex(words.next())?,
    };
    Some((offset, register))
}

/// A peripheral of a facts file: name, address, registers with their offsets.
type Peripheral = (String, u32, Vec<(u32, Register)>);

fn parse(text: &str) -> Vec<Peripheral> {
    let mut all: Vec<Peripheral> = Vec::new();
    let lines = text.lines().filter(|line| !line.starts_with('#'));
    for line in lines {
        let words: Vec<_> = line.split_whitespace().collect();
        if let ["peripheral", name, base, rest @ ..] = &words[..] {
            let base = u32::from_str_radix(base, 16).unwrap_or(0);
            let alike = match rest {
                ["like", other] => all.iter().find(|(known, ..)| known == other),
                _ => None,
            };
            let registers = alike.map(|(known, _, registers)| {
                let rename = |(offset, register): &(u32, Register)| {
                    let own = register.name.replacen(known.as_str(), name, 1);
                    (
                        *offset,
                        Register {
                            name: own,
                            ..register.clone()
                        },
                    )
                };
                registers.iter().map(rename).collect()
            });
            all.push(((*name).to_owned(), base, registers.unwrap_or_default()));
        } else if let Some((name, _, registers)) = all.last_mut() {
            registers.extend(register(name, line));
        }
    }
    all
}

impl Table {
    /// The registers of a part.
    pub(crate) fn of(part: &Part) -> &'static Self {
        static F446: OnceLock<Table> = OnceLock::new();
        static F303: OnceLock<Table> = OnceLock::new();
        let (table, text) = match part.family {
            Family::F4 => (&F446, include_str!("../../facts/f446.txt")),
            Family::F3 => (&F303, include_str!("../../facts/f303.txt")),
        };
        table.get_or_init(|| Self::new(part.family, text))
    }

    fn new(family: Family, text: &str) -> Self {
        let mut table = Self {
            family,
            pages: Vec::new(),
            registers: Vec::new(),
        };
        for (peripheral, base, registers) in parse(text) {
            let page = base & !0x3FF;
            let index = table.pages.iter().position(|known| known.base == page);
            let index = index.unwrap_or_else(|| {
                table.pages.push(Page {
                    base: page,
                    sizes: sizes(family, &peripheral),
                    words: [0; WORDS],
                });
                table.pages.len() - 1
            });
            for (offset, register) in registers {
                if missing(family, &register.name) {
                    continue;
                }
                table.registers.push(register);
                let word = ((base - page + offset) / 4) as usize;
                table.pages[index].words[word] = table.registers.len() as u16;
            }
        }
        table
    }

    /// Index of the page that holds an address, for [`Table::check`].
    pub(crate) fn page(&self, address: u32) -> Option<usize> {
        let base = address & !0x3FF;
        self.pages.iter().position(|page| page.base == base)
    }

    fn at(&self, page: usize, address: u32) -> Option<&Register> {
        let page = &self.pages[page];
        let index = page.words[((address & 0x3FF) / 4) as usize];
        self.registers.get(usize::from(index).checked_sub(1)?)
    }

    /// Name of the register at an address.
    pub(crate) fn name(&self, address: u32) -> Option<&str> {
        let register = self.at(self.page(address)?, address)?;
        Some(&register.name)
    }

    /// What an access of `size` bytes does that the register does not allow, with the document.
    #[inline]
    pub(crate) fn check(
        &self,
        page: usize,
        address: u32,
        size: usize,
        access: Access,
    ) -> Result<(), (String, &'static str)> {
        let sizes = self.pages[page].sizes;
        let Some(register) = self.at(page, address) else {
            return Err(("there is no register".into(), document(self.family)));
        };
        let (allowed, smallest) = match access {
            Access::Read => (register.readable, sizes.read),
            Access::Write { .. } => (register.writable, sizes.write),
        };
        if !allowed || size < smallest {
            return Err((
                refusal(register, size, smallest, access),
                document(self.family),
            ));
        }
        if let Access::Write { value, mask } = access {
            let reserved = mask & !register.fields & (value ^ register.reset);
            if reserved != 0 {
                let what = format!(
                    "written {value:#010x}, which changes the reserved bits {reserved:#010x}"
                );
                return Err((what, document(self.family)));
            }
        }
        Ok(())
    }
}

fn refusal(register: &Register, size: usize, least: usize, access: Access) -> String {
    let (what, direction) = match access {
        Access::Read => ("read", register.readable),
        Access::Write { .. } => ("written", register.writable),
    };
    if direction {
        format!("{what} by {size} bytes, at least {least} are needed")
    } else {
        format!("{what}, which it cannot be")
    }
}

#[cfg(test)]
mod tests {
    use super::{Access, Register, Table, parse};
    use crate::part::{Layout, Part};
    use std::collections::BTreeSet;

    fn check(part: &Part, address: u32, size: usize, access: Access) -> Result<(), String> {
        let table = Table::of(part);
        let page = table.page(address).expect("a page");
        table
            .check(page, address, size, access)
            .map_err(|(what, _)| what)
    }

    fn word(value: u32) -> Access {
        Access::Write {
            value,
            mask: u32::MAX,
        }
    }

    #[test]
    fn an_access_is_judged_by_existence_direction_size_and_reserved_bits() {
        let gpio = 0x4002_0000;
        assert_eq!(check(Part::F446, gpio, 1, Access::Read), Ok(()));
        let refused = |part, address, size, access| check(part, address, size, access).unwrap_err();
        assert!(refused(Part::F446, gpio + 0x28, 4, Access::Read).contains("no register"));
        assert!(refused(Part::F446, gpio + 0x18, 4, Access::Read).contains("read, which"));
        assert!(refused(Part::F446, gpio + 0x10, 4, word(0)).contains("written, which"));
        assert!(refused(Part::F446, 0x4000_6400, 2, Access::Read).contains("by 2 bytes"));
        assert!(refused(Part::F446, 0x4001_1008, 4, word(1 << 16)).contains("0x00010000"));
        // Bit 15 of GPIOA_MODER is part of a field; the register's reset value is not zero.
        assert_eq!(check(Part::F446, gpio, 4, word(0xA800_0000)), Ok(()));
        // The upper half stays as it is when only the lower one is written.
        let half = Access::Write {
            value: 0x8B,
            mask: 0xFFFF,
        };
        assert_eq!(check(Part::F446, 0x4001_1008, 2, half), Ok(()));
        assert!(refused(Part::F303, 0x4000_6400 + 0x2B0, 4, word(0)).contains("no register"));
        assert_eq!(Table::of(Part::F303).name(0x5000_0308), Some("ADC1_2_CCR"));
    }

    /// Where the two witnesses differ, and why the first one is right. The registers stand without
    /// the numbers of their peripherals.
    type Known = &'static [(&'static str, &'static str)];

    const F446: Known = &[
        (
            "TIM_CNT TIM_ARR TIM_CCR1 TIM_CCR2 TIM_CCR3 TIM_CCR4",
            "the witness gives TIM3 and TIM4 the 32 bits of TIM2 (RM0390 17.4)",
        ),
        (
            "USART_SR",
            "the witness shifts the value after reset; TXE and TC are bits 7 and 6 (RM0390 25.6.1)",
        ),
        (
            "ADC_SMPR1 ADC_SMPR2",
            "the witness has one field over reserved bits (RM0390 13.13.4 and 13.13.5)",
        ),
        (
            "RCC_CR",
            "the witness lacks the bits of the PLLSAI (RM0390 6.3.1)",
        ),
        ("RCC_PLLCFGR", "the witness lacks PLLR (RM0390 6.3.2)"),
        ("FLASH_ACR", "LATENCY has four bits (RM0390 3.8.1)"),
        ("DMA_LIFCR DMA_HIFCR", "they are write-only (RM0390 9.5.3)"),
        (
            "DMA_ST1_CR DMA_ST2_CR DMA_ST3_CR DMA_ST4_CR DMA_ST5_CR DMA_ST6_CR DMA_ST7_CR",
            "bit 20 is reserved (RM0390 9.5.5)",
        ),
    ];

    /// The witness describes a sibling with other timers, bits of RCC and pins.
    const F303: Known = &[
        (
            "TIM_CR1 TIM_SMCR TIM_CCMR1 TIM_CCMR2",
            "the F303 has UIFREMAP and more modes (RM0316 21.4, 22.4)",
        ),
        (
            "TIM_OR",
            "only the sibling's TIM2 has it, only the F303's TIM16 (RM0316 23.6.16)",
        ),
        (
            "TIM_CNT TIM_DIER TIM_BDTR",
            "the F303's TIM7 and TIM16 have UIFCPY, TIM16 COMDE and BKF (RM0316 22.4, 23.6)",
        ),
        ("PWR_CR PWR_CSR", "the sibling has three SDADC (RM0316 7.4)"),
        (
            "RCC_CFGR RCC_CFGR2 RCC_CFGR3 RCC_CSR RCC_APB2RSTR RCC_APB1RSTR RCC_AHBRSTR",
            "other peripherals and their clocks (RM0316 9.4)",
        ),
        (
            "RCC_AHBENR RCC_APB2ENR RCC_APB1ENR",
            "other peripherals (RM0316 9.4.6 to 9.4.8)",
        ),
        ("FLASH_ACR", "the F303 has HLFCYA (RM0316 4.5.1)"),
        ("FLASH_OBR", "other option bytes (RM0316 4.5.7)"),
        (
            "GPIOA_MODER GPIOA_OSPEEDR GPIOA_PUPDR GPIOB_MODER GPIOB_OSPEEDR GPIOB_PUPDR",
            "the pins of the debugger after reset (RM0316 11.4)",
        ),
        (
            "GPIOC_PUPDR GPIOD_PUPDR GPIOF_PUPDR",
            "values after reset differ; all bits have fields, so they are not used",
        ),
        ("GPIOC_LCKR GPIOF_LCKR", "each port has it (RM0316 11.4.8)"),
    ];

    /// `USART2_SR` without the number: `USART_SR`.
    fn kind(name: &str) -> String {
        let (peripheral, register) = name.split_once('_').unwrap_or((name, ""));
        let peripheral = peripheral.trim_end_matches(char::is_numeric);
        format!("{peripheral}_{register}")
    }

    /// The registers that the two files describe differently, without the numbers of their
    /// peripherals. A peripheral that only one of them has does not count.
    fn differences(facts: &str, witness: &str) -> BTreeSet<String> {
        let witness = parse(witness);
        let mut found = BTreeSet::new();
        for (name, base, registers) in parse(facts) {
            let Some((_, other, seen)) = witness.iter().find(|(other, ..)| *other == name) else {
                continue;
            };
            assert_eq!(base, *other, "{name}");
            for (offset, register) in registers.iter().chain(seen) {
                let of = |list: &[(u32, Register)]| {
                    let mut all = list.iter();
                    let found = all.find(|(at, _)| at == offset);
                    found.map(|(_, of)| (of.reset, of.fields, of.readable, of.writable))
                };
                if of(&registers) != of(seen) {
                    let named = registers.iter().find(|(at, _)| at == offset);
                    found.insert(kind(named.map_or(&register.name, |(_, of)| &of.name)));
                }
            }
        }
        found
    }

    #[test]
    fn two_witnesses_agree_on_the_registers() {
        let files = [
            (
                include_str!("../../facts/f446.txt"),
                include_str!("../../facts/f446-witness.txt"),
                F446,
            ),
            (
                include_str!("../../facts/f303.txt"),
                include_str!("../../facts/f303-witness.txt"),
                F303,
            ),
        ];
        for (facts, witness, known) in files {
            let known: BTreeSet<String> = known
                .iter()
                .flat_map(|(registers, _)| registers.split(' '))
                .map(str::to_owned)
                .collect();
            assert_eq!(differences(facts, witness), known);
        }
    }

    #[test]
    fn every_peripheral_that_is_modelled_is_in_the_table() {
        for part in Part::ALL {
            for slot in part.slots() {
                assert!(Table::of(part).page(slot.base).is_some(), "{slot:?}");
            }
        }
    }
}
