//! Size of the protocol stack in an image.

use object::{Object, ObjectSection, ObjectSymbol, SymbolKind};

use super::{Builder, Error, Parts, Profile};
use crate::Failure;

/// Sizes in bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Code and constants of the stack.
    pub code: u64,
    /// The compiler's own functions, which any program has.
    pub runtime: u64,
    /// The compiled schedule.
    pub schedule: u64,
    /// RAM of a node.
    pub ram: u64,
}

/// Builds a program that calls every function of the stack, and measures it.
///
/// # Errors
///
/// It does not build, or lacks an expected symbol.
pub fn measure(builder: &Builder, parts: Parts, profile: Profile) -> Result<Size, Failure> {
    let elf = builder.program("node", parts, profile)?;
    let unexpected = Error::Unexpected { parts: parts.name };
    Ok(sizes(&elf).ok_or(unexpected)?)
}

fn sizes(elf: &[u8]) -> Option<Size> {
    let file = object::File::parse(elf).ok()?;
    let (mut code, mut runtime, mut schedule, mut own_data, mut ram) = (0, 0, 0, 0, None);
    for symbol in file.symbols() {
        let name = symbol.name().unwrap_or_default();
        match symbol.kind() {
            SymbolKind::Text if name.starts_with("__") || name.contains("compiler_builtins") => {
                runtime += symbol.size();
            }
            SymbolKind::Text => code += symbol.size(),
            SymbolKind::Data if name.contains("4node") => {
                // These belong to the program, not to the protocol stack.
                own_data += symbol.size();
                if name.contains("8SCHEDULE") {
                    schedule = symbol.size();
                }
                if name.contains("13RAM_OF_A_NODE") {
                    ram = word(&file, symbol.address());
                }
            }
            _ => {}
        }
    }
    let constants = file.section_by_name(".rodata")?.size();
    Some(Size {
        code: code + constants.checked_sub(own_data)?,
        runtime,
        schedule,
        ram: ram?,
    })
}

/// A word of the image.
fn word(file: &object::File, address: u64) -> Option<u64> {
    file.sections().find_map(|section| {
        let bytes = section.data_range(address, 4).ok()??;
        Some(u64::from(u32::from_le_bytes(bytes.try_into().ok()?)))
    })
}
