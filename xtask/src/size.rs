//! How much of its board's memories an image uses.

use std::{
    fmt::Write,
    fs,
    path::{Path, PathBuf},
};

use object::{
    LittleEndian, Object, ObjectSection, ObjectSymbol,
    elf::{FileHeader32, PT_LOAD, SHF_ALLOC},
    read::elf::{ElfFile, ProgramHeader, SectionHeader},
};
use serde::Serialize;

use parts::{Memory, Sled};

use crate::{Failure, ReadError};

/// A file that cannot be measured.
#[derive(Debug, thiserror::Error)]
#[error("{}: {why}", path.display())]
pub struct Error {
    path: PathBuf,
    #[source]
    why: Unfit,
}

/// Why an ELF file is no image for a board.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Unfit {
    /// It is no ELF file of 32 bits.
    #[error("not an image: {0}")]
    NotAnImage(object::Error),
    /// A segment is loaded to where there is no flash.
    #[error("{size} bytes at {address:#010x} are outside the flash of {board}")]
    OutsideFlash {
        /// Its length.
        size: u64,
        /// Where it is loaded.
        address: u64,
        /// The board.
        board: &'static str,
    },
    /// A section lies in none of the board's memories.
    #[error("section {name} at {address:#010x} is in no memory of {board}")]
    Section {
        /// Its name.
        name: String,
        /// Its first address.
        address: u64,
        /// The board.
        board: &'static str,
    },
    /// A symbol of the linker script is missing.
    #[error("the image has no symbol {0}")]
    NoSymbol(&'static str),
    /// The stack's upper end is below its lower end.
    #[error("the stack's top is below its end")]
    UpsideDown,
    /// The stack lies in no RAM.
    #[error("the stack at {bottom:#010x} is in no RAM of {board}")]
    Stack {
        /// Its lowest address.
        bottom: u64,
        /// The board.
        board: &'static str,
    },
}

/// Memory that an image uses, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Usage {
    /// Code, constants and initial values, in flash.
    pub flash: u64,
    /// Static variables, in all RAM together.
    pub statics: u64,
    /// Room for the stack.
    pub stack: u64,
    /// Worst-case stack depth; 0 until the audit has found it.
    pub deepest: u64,
}

/// The size of a node's image on its board.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Size {
    /// The node.
    pub node: String,
    /// Its board.
    pub board: &'static Sled,
    /// Memory that its image uses.
    pub usage: Usage,
}

/// Measures the ELF file of an image.
///
/// # Errors
///
/// The file cannot be read, is no ELF file of 32 bits, or holds something that
/// lies in none of the board's memories.
pub fn measure(path: &Path, board: &Sled) -> Result<Usage, Failure> {
    let data = fs::read(path).map_err(ReadError::of(path))?;
    let usage = usage(&data, board).map_err(|why| Error {
        path: path.into(),
        why,
    });
    Ok(usage?)
}

fn usage(data: &[u8], board: &Sled) -> Result<Usage, Unfit> {
    let file = ElfFile::<FileHeader32<LittleEndian>>::parse(data).map_err(Unfit::NotAnImage)?;
    let endian = file.endian();

    let mut flash = 0;
    for segment in file.elf_program_headers() {
        let size = u64::from(segment.p_filesz(endian));
        if segment.p_type(endian) != PT_LOAD || size == 0 {
            continue;
        }
        let address = u64::from(segment.p_paddr(endian));
        if !fits(&board.part.flash, address, size) {
            return Err(Unfit::OutsideFlash {
                size,
                address,
                board: board.name,
            });
        }
        flash += size;
    }

    let mut statics = 0;
    for section in file.sections() {
        let header = section.elf_section_header();
        let (address, size) = (section.address(), section.size());
        if !header.sh_flags(endian).contains(SHF_ALLOC) || size == 0 {
            continue;
        }
        if board.part.ram.iter().any(|ram| fits(ram, address, size)) {
            statics += size;
        } else if !fits(&board.part.flash, address, size) {
            return Err(Unfit::Section {
                name: section.name().unwrap_or("without a name").into(),
                address,
                board: board.name,
            });
        }
    }

    let symbol = |name: &'static str| {
        file.symbols()
            .find(|symbol| symbol.name() == Ok(name))
            .map(|symbol| symbol.address())
            .ok_or(Unfit::NoSymbol(name))
    };
    // The linker script leaves the stack between these two; it grows downwards.
    let (top, bottom) = (symbol("_stack_start")?, symbol("_stack_end")?);
    let stack = top.checked_sub(bottom);
    let stack = stack.ok_or(Unfit::UpsideDown)?;
    if !board.part.ram.iter().any(|ram| fits(ram, bottom, stack)) {
        return Err(Unfit::Stack {
            bottom,
            board: board.name,
        });
    }
    Ok(Usage {
        flash,
        statics,
        stack,
        deepest: 0,
    })
}

fn fits(memory: &Memory, address: u64, size: u64) -> bool {
    let (Ok(address), Ok(size)) = (u32::try_from(address), u32::try_from(size)) else {
        return false;
    };
    memory.holds(address, size)
}

/// The sizes as a table for people: used, of how much, budget.
pub fn table(sizes: &[Size]) -> String {
    let mut out = String::new();
    let heading = [
        "node",
        "board",
        "flash",
        "budget",
        "static RAM",
        "budget",
        "deepest stack",
        "RAM free",
    ];
    let mut rows = vec![heading.map(String::from)];
    for Size { node, board, usage } in sizes {
        let budget = board.budget;
        let free = u64::from(board.part.ram_bytes()).saturating_sub(usage.statics + usage.stack);
        rows.push([
            node.clone(),
            board.name.into(),
            share(usage.flash, board.part.flash.size.into()),
            kib(budget.flash.into()),
            share(usage.statics, board.part.ram_bytes().into()),
            kib(budget.statics.into()),
            share(usage.deepest, usage.stack),
            kib(free),
        ]);
    }
    for row in &rows {
        let mut line = String::new();
        for (column, cell) in row.iter().enumerate() {
            let width = rows.iter().map(|row| row[column].len()).max().unwrap_or(0);
            // Words to the left, numbers to the right.
            let _ = if column < 2 {
                write!(line, "{cell:<width$}  ")
            } else {
                write!(line, "{cell:>width$}  ")
            };
        }
        let _ = writeln!(out, "{}", line.trim_end());
    }
    out
}

fn kib(bytes: u64) -> String {
    format!("{:.1} KiB", bytes as f64 / 1024.0)
}

fn share(bytes: u64, of: u64) -> String {
    let percent = 100.0 * bytes as f64 / of as f64;
    format!("{} of {} ({percent:.0} %)", kib(bytes), kib(of))
}

#[derive(Serialize)]
struct Row<'a> {
    node: &'a str,
    board: &'static str,
    #[serde(flatten)]
    usage: Usage,
    flash_size: u32,
    flash_budget: u32,
    ram_size: u32,
    statics_budget: u32,
    stack_budget: u32,
}

/// The sizes for programs: a JSON array, all numbers in bytes.
pub fn json(sizes: &[Size]) -> String {
    let rows: Vec<Row<'_>> = sizes
        .iter()
        .map(|Size { node, board, usage }| {
            let budget = board.budget;
            Row {
                node,
                board: board.name,
                usage: *usage,
                flash_size: board.part.flash.size,
                flash_budget: budget.flash,
                ram_size: board.part.ram_bytes(),
                statics_budget: budget.statics,
                stack_budget: budget.stack,
            }
        })
        .collect();
    // Serialising plain numbers and texts cannot fail.
    serde_json::to_string_pretty(&rows).unwrap_or_default()
}

/// Exceeded budgets, one sentence each.
pub fn excess(sizes: &[Size]) -> Vec<String> {
    let mut excess = Vec::new();
    for Size {
        node: name,
        board,
        usage,
    } in sizes
    {
        let budget = board.budget;
        for (what, used, allowed) in [
            ("flash", usage.flash, u64::from(budget.flash)),
            ("static RAM", usage.statics, u64::from(budget.statics)),
        ] {
            if used > allowed {
                excess.push(format!(
                    "{name} uses {used} bytes of {what}, {} more than its budget of {allowed}",
                    used - allowed
                ));
            }
        }
        if usage.deepest > usage.stack {
            excess.push(format!(
                "{name} may need {} bytes of stack and has {}",
                usage.deepest, usage.stack
            ));
        }
        if usage.stack < u64::from(budget.stack) {
            excess.push(format!(
                "{name} leaves {} bytes for the stack, its budget is {}",
                usage.stack, budget.stack
            ));
        }
    }
    excess
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A little ELF file: the sections (address, size, whether in the file) and
    /// the load segments (physical address, size) that a linker would write.
    struct Elf {
        sections: Vec<(u32, u32, bool)>,
        segments: Vec<(u32, u32)>,
        stack: (u32, u32),
    }

    const NAMES: &[u8] = b"\0_stack_start\0_stack_end\0";

    impl Elf {
        fn f303() -> Self {
            Self {
                sections: vec![
                    (0x0800_0000, 0x188, true),
                    (0x0800_0188, 0x4000, true),
                    (0x2000_0000, 0x10, true),
                    (0x2000_0010, 0x300, false),
                ],
                segments: vec![
                    (0x0800_0000, 0x4188),
                    // Initial values of .data, loaded behind the code.
                    (0x0800_4188, 0x10),
                    (0x2000_0010, 0),
                ],
                stack: (0x1000_1000, 0x1000_0000),
            }
        }

        fn bytes(&self) -> Vec<u8> {
            let halves = |values: &[u16]| -> Vec<u8> {
                values
                    .iter()
                    .flat_map(|value| value.to_le_bytes())
                    .collect()
            };
            let words = |values: &[u32]| -> Vec<u8> {
                values
                    .iter()
                    .flat_map(|value| value.to_le_bytes())
                    .collect()
            };
            let segments = self.segments.len() as u32;
            let symbols_at = 52 + 32 * segments;
            let names_at = symbols_at + 3 * 16;
            let sections_at = names_at + NAMES.len() as u32;
            let sections = 3 + self.sections.len() as u16;

            let mut elf = b"\x7fELF\x01\x01\x01".to_vec();
            elf.resize(16, 0);
            // Executable for ARM, version 1.
            elf.extend(halves(&[2, 40]));
            elf.extend(words(&[1, 0x0800_0189, 52, sections_at, 0x0500_0400]));
            elf.extend(halves(&[52, 32, segments as u16, 40, sections, 2]));
            for &(address, size) in &self.segments {
                elf.extend(words(&[1, 0, address, address, size, size, 5, 4]));
            }
            elf.extend(words(&[0; 4]));
            for (name, value) in [(1, self.stack.0), (14, self.stack.1)] {
                elf.extend(words(&[name, value, 0]));
                elf.extend(halves(&[0x10, 0xFFF1]));
            }
            elf.extend(NAMES);
            let mut section = |kind, flags, address, offset, size, link, entry| {
                let info = u32::from(kind == 2);
                elf.extend(words(&[
                    0, kind, flags, address, offset, size, link, info, 4, entry,
                ]));
            };
            section(0, 0, 0, 0, 0, 0, 0);
            section(2, 0, 0, symbols_at, 48, 2, 16);
            section(3, 0, 0, names_at, NAMES.len() as u32, 0, 0);
            for &(address, size, in_file) in &self.sections {
                section(if in_file { 1 } else { 8 }, 2, address, 0, size, 0, 0);
            }
            elf
        }
    }

    #[test]
    fn an_image_is_measured_by_segment_and_section() {
        let expected = Usage {
            flash: 0x4188 + 0x10,
            statics: 0x310,
            stack: 0x1000,
            deepest: 0,
        };
        assert_eq!(usage(&Elf::f303().bytes(), Sled::F303), Ok(expected));
    }

    #[test]
    fn what_lies_outside_the_memories_is_refused() {
        let mut elf = Elf::f303();
        elf.segments[1] = (0x0800_FFF8, 0x10);
        let refusal = usage(&elf.bytes(), Sled::F303).unwrap_err().to_string();
        assert!(refusal.contains("outside the flash of f303"), "{refusal}");

        let mut elf = Elf::f303();
        elf.sections[3] = (0x2000_2FF0, 0x20, false);
        let refusal = usage(&elf.bytes(), Sled::F303).unwrap_err().to_string();
        assert!(refusal.contains("0x20002ff0 is in no memory"), "{refusal}");

        let mut elf = Elf::f303();
        elf.stack = (0x2002_1000, 0x2002_0000);
        let refusal = usage(&elf.bytes(), Sled::F446).unwrap_err().to_string();
        assert!(refusal.contains("stack at 0x20020000"), "{refusal}");
    }

    #[test]
    fn a_file_that_is_no_image_is_refused() {
        assert!(usage(b"not an image", Sled::F446).is_err());
        let failure = measure(Path::new("no/such/image"), Sled::F446)
            .unwrap_err()
            .to_string();
        assert!(
            failure
                .to_string()
                .starts_with("no/such/image cannot be read")
        );
    }

    fn size(node: &str, board: &'static Sled, usage: Usage) -> Size {
        Size {
            node: node.into(),
            board,
            usage,
        }
    }

    #[test]
    fn more_than_the_budget_is_named() {
        let excess = |usage: Usage| super::excess(&[size("drive", Sled::F303, usage)]);
        let budget = Sled::F303.budget;
        let usage = Usage {
            flash: budget.flash.into(),
            statics: budget.statics.into(),
            stack: budget.stack.into(),
            deepest: budget.stack.into(),
        };
        assert_eq!(excess(usage), Vec::<String>::new());
        let over = Usage {
            flash: usage.flash + 3,
            stack: usage.stack - 1,
            deepest: 100,
            ..usage
        };
        let over = excess(over);
        assert_eq!(over.len(), 2);
        assert!(
            over[0].contains(&format!(
                "drive uses {} bytes of flash, 3 more",
                budget.flash + 3
            )),
            "{over:?}"
        );
        let deep = Usage {
            deepest: usage.stack + 1,
            ..usage
        };
        assert_eq!(
            excess(deep).join("; "),
            format!(
                "drive may need {} bytes of stack and has {}",
                budget.stack + 1,
                budget.stack
            )
        );
    }

    #[test]
    fn the_columns_of_the_table_are_aligned() {
        let usage = Usage {
            flash: 44_208,
            statics: 4_324,
            stack: 4_096,
            deepest: 1_024,
        };
        let table = table(&[
            size("gps", Sled::F446, usage),
            size("drive", Sled::F303, usage),
        ]);
        let widths: Vec<usize> = table.lines().map(str::len).collect();
        assert_eq!(widths, [widths[0]; 3], "{table}");
        assert!(table.contains("43.2 KiB of 64.0 KiB (67 %)"), "{table}");
    }
}
