//! What the image's debug information says of functions that a pointer may lead to.

use std::collections::BTreeMap;

use addr2line::gimli::{
    self, AttributeValue, DebuggingInformationEntry, Dwarf, Unit, UnitOffset, UnitSectionOffset,
};

use super::debug::{Slice, each_unit};

/// Where the compiler's own libraries were built.
const TOOLCHAIN: &[u8] = b"/rustc/";

/// A function, by its debug information.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Signature {
    /// The recorded parameters of types that take space. One that the source gives no name may not be
    /// recorded, so the function may have more, but never fewer.
    pub(crate) carried: usize,
    /// Whether it belongs to the part of the compiler's libraries that was built with the compiler.
    /// Such code knows no function of a program.
    pub(crate) toolchain: bool,
}

/// The functions that have debug information, by their first address.
#[must_use]
pub(crate) fn of(file: &object::File<'_>) -> BTreeMap<u32, Signature> {
    let mut found = BTreeMap::new();
    each_unit(file, |dwarf, unit| {
        let toolchain = unit.name.is_some_and(|name| name.starts_with(TOOLCHAIN));
        let mut entries = unit.entries();
        while let Ok(Some(entry)) = entries.next_dfs() {
            if entry.tag() != gimli::DW_TAG_subprogram {
                continue;
            }
            let Some(address) = address(dwarf, unit, entry) else {
                continue;
            };
            let carried = parameters(dwarf, unit, entry.offset());
            let signature = Signature { carried, toolchain };
            // The linker may fold functions with the same code into one; then the pointer may mean
            // any of them.
            found
                .entry(address)
                .and_modify(|known: &mut Signature| {
                    known.carried = known.carried.min(signature.carried);
                    known.toolchain &= signature.toolchain;
                })
                .or_insert(signature);
        }
    });
    found
}

/// The first address of a function that has code.
fn address(
    dwarf: &Dwarf<Slice<'_>>,
    unit: &Unit<Slice<'_>>,
    entry: &DebuggingInformationEntry<Slice<'_>>,
) -> Option<u32> {
    let value = entry.attr_value(gimli::DW_AT_low_pc)?;
    let address = dwarf.attr_address(unit, value).ok()??;
    // The linker gives a function that it left out an address at the end, or zero.
    u32::try_from(address & !1)
        .ok()
        .filter(|address| *address != 0)
}

/// The parameters of the function at `at`: those of its code, or of what it was made from,
/// where the code has lost some.
fn parameters(dwarf: &Dwarf<Slice<'_>>, unit: &Unit<Slice<'_>>, at: UnitOffset) -> usize {
    let Ok(mut tree) = unit.entries_tree(Some(at)) else {
        return 0;
    };
    let Ok(root) = tree.root() else { return 0 };
    let from = root.entry().attr_value(gimli::DW_AT_abstract_origin);
    let mut own = 0;
    let mut children = root.children();
    while let Ok(Some(child)) = children.next() {
        let entry = child.entry();
        let is_parameter = entry.tag() == gimli::DW_TAG_formal_parameter;
        own += usize::from(is_parameter && !is_empty(unit, entry));
    }
    let origin = match from {
        Some(AttributeValue::UnitRef(offset)) => parameters(dwarf, unit, offset),
        Some(AttributeValue::DebugInfoRef(offset)) => {
            // Link-time optimisation refers to other units.
            let mut count = 0;
            if let Some((other, offset)) = elsewhere(dwarf, offset.0) {
                count = parameters(dwarf, &other, offset);
            }
            count
        }
        _ => 0,
    };
    own.max(origin)
}

/// Whether a parameter is of a type that is known to take no space. The functions that the compiler
/// makes of closures have such parameters.
fn is_empty(unit: &Unit<Slice<'_>>, entry: &DebuggingInformationEntry<Slice<'_>>) -> bool {
    let Some(AttributeValue::UnitRef(of)) = entry.attr_value(gimli::DW_AT_type) else {
        return false;
    };
    let of = unit.entry(of).ok();
    let size = of.and_then(|of| of.attr_value(gimli::DW_AT_byte_size));
    size.and_then(|size| size.udata_value()) == Some(0)
}

/// The unit that holds the entry at `offset` of its section, and where in the unit it is.
fn elsewhere<'a>(dwarf: &Dwarf<Slice<'a>>, offset: usize) -> Option<(Unit<Slice<'a>>, UnitOffset)> {
    let mut units = dwarf.units();
    while let Ok(Some(header)) = units.next() {
        let section = UnitSectionOffset(offset);
        if let Some(inside) = section.to_unit_offset(&header) {
            return Some((dwarf.unit(header).ok()?, inside));
        }
    }
    None
}
