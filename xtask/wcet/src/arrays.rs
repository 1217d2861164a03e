//! Arrays in static variables, by the image's debug information.

use addr2line::gimli::{
    self, AttributeValue, DebuggingInformationEntry, Operation, Unit, UnitOffset,
};

use super::debug::{Slice, each_unit};
use super::extent::Extent;

/// Depth to which nested types are followed.
const DEPTH: u32 = 24;

/// Every outermost array in a static variable. Types that cannot be read count as without
/// arrays.
#[must_use]
pub(crate) fn of(file: &object::File<'_>) -> Vec<Extent> {
    let mut found = Vec::new();
    each_unit(file, |_, unit| {
        let mut entries = unit.entries();
        while let Ok(Some(entry)) = entries.next_dfs() {
            if entry.tag() == gimli::DW_TAG_variable
                && let (Some(address), Some(of)) = (place(unit, entry), kind(entry))
            {
                inside(unit, of, address, DEPTH, &mut found);
            }
        }
    });
    found
}

/// The address of a variable, if it is in one piece.
fn place(unit: &Unit<Slice<'_>>, entry: &DebuggingInformationEntry<Slice<'_>>) -> Option<u32> {
    let AttributeValue::Exprloc(place) = entry.attr_value(gimli::DW_AT_location)? else {
        return None;
    };
    let mut operations = place.operations(unit.encoding());
    match (operations.next(), operations.next()) {
        (Ok(Some(Operation::Address { address })), Ok(None)) => u32::try_from(address).ok(),
        _ => None,
    }
}

/// The type of an entry.
fn kind(entry: &DebuggingInformationEntry<Slice<'_>>) -> Option<UnitOffset> {
    match entry.attr_value(gimli::DW_AT_type)? {
        AttributeValue::UnitRef(offset) => Some(offset),
        _ => None,
    }
}

/// A number among the attributes of an entry.
fn number(entry: &DebuggingInformationEntry<Slice<'_>>, name: gimli::DwAt) -> Option<u32> {
    u32::try_from(entry.attr_value(name)?.udata_value()?).ok()
}

/// Adds the arrays in a value of type `of` at `address`.
fn inside(
    unit: &Unit<Slice<'_>>,
    of: UnitOffset,
    address: u32,
    depth: u32,
    found: &mut Vec<Extent>,
) {
    let Ok(mut tree) = unit.entries_tree(Some(of)) else {
        return;
    };
    let Ok(root) = tree.root() else { return };
    match root.entry().tag() {
        gimli::DW_TAG_array_type => {
            if let Some(bytes @ 1..) = size(unit, of, depth) {
                found.push(Extent::new(address, address + (bytes - 1)));
            }
        }
        gimli::DW_TAG_structure_type | gimli::DW_TAG_union_type => {
            members(unit, root, address, depth, found);
        }
        _ => {}
    }
}

/// Adds the arrays in the members of a structure, union or variant at `address`.
fn members(
    unit: &Unit<Slice<'_>>,
    node: gimli::EntriesTreeNode<'_, '_, Slice<'_>>,
    address: u32,
    depth: u32,
    found: &mut Vec<Extent>,
) {
    let Some(depth) = depth.checked_sub(1) else {
        return;
    };
    let mut children = node.children();
    while let Ok(Some(child)) = children.next() {
        match child.entry().tag() {
            gimli::DW_TAG_member => {
                let at = number(child.entry(), gimli::DW_AT_data_member_location);
                if let Some(of) = kind(child.entry()) {
                    inside(unit, of, address + at.unwrap_or(0), depth, found);
                }
            }
            gimli::DW_TAG_variant_part | gimli::DW_TAG_variant => {
                members(unit, child, address, depth, found);
            }
            _ => {}
        }
    }
}

/// Size in bytes of a value of type `of`.
fn size(unit: &Unit<Slice<'_>>, of: UnitOffset, depth: u32) -> Option<u32> {
    let depth = depth.checked_sub(1)?;
    let mut tree = unit.entries_tree(Some(of)).ok()?;
    let root = tree.root().ok()?;
    if root.entry().tag() != gimli::DW_TAG_array_type {
        return number(root.entry(), gimli::DW_AT_byte_size);
    }
    let mut bytes = size(unit, kind(root.entry())?, depth)?;
    let mut children = root.children();
    while let Ok(Some(child)) = children.next() {
        if child.entry().tag() == gimli::DW_TAG_subrange_type {
            bytes = bytes.checked_mul(number(child.entry(), gimli::DW_AT_count)?)?;
        }
    }
    Some(bytes)
}
