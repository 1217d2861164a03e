//! A node's global time, read from its memory.
//!
//! The protocol stack lives in a static of the program; its clock is found there by its
//! constants, and its fields by the debug information of the image, wherever the compiler put
//! them.

use std::collections::HashMap;

use addr2line::gimli::{self, AttributeValue, DwAt, EndianSlice, LittleEndian};
use object::{Object, ObjectSection, ObjectSymbol};
use twin::mcu::Mcu;
use world::SimTime;

/// Counter of TIM2, the time base of both parts.
const COUNTER: u32 = 0x4000_0024;

/// The clock of a program's protocol stack.
#[derive(Clone, Debug)]
pub struct NodeClock {
    /// The static that holds the protocol stack.
    stack: u32,
    size: usize,
    /// Offsets of the clock's fields.
    fields: HashMap<String, usize>,
}

impl NodeClock {
    /// Finds the clock of an image.
    ///
    /// # Panics
    /// When the image has no protocol stack or no debug information.
    #[must_use]
    pub fn find(elf: &[u8]) -> Self {
        let file = object::File::parse(elf).expect("an ELF file");
        let stack = file
            .symbols()
            .find(|symbol| {
                let name = symbol.name().unwrap_or_default();
                name.contains("__rtic_internal_local_init_stack")
            })
            .expect("the program has a protocol stack");
        Self {
            stack: stack.address() as u32,
            size: stack.size() as usize,
            fields: fields(&file).expect("the image has debug information of ttcan's clock"),
        }
    }

    /// Global time in microseconds and the instant it was read at; `None` before the node
    /// knows the time.
    pub fn read(&self, node: &mut Mcu) -> Option<(f64, SimTime)> {
        let memory = node.memory(self.stack, self.size)?;
        let count = node.read_register(COUNTER)?;
        let word = |at: usize| {
            let bytes = memory.get(at..at + 4)?;
            Some(u32::from_le_bytes(bytes.try_into().ok()?))
        };
        let field = |base: usize, name: &str| word(base + self.fields.get(name)?);
        // Ticks in a microsecond of either board, and its reciprocal as the stack computes it.
        let base = (0..self.size).step_by(4).find(|&base| {
            let ticks = field(base, "ticks_per_us");
            let nominal = field(base, "nominal");
            ticks
                .filter(|ticks| matches!(ticks, 16 | 18))
                .is_some_and(|ticks| nominal.is_some_and(|n| is_reciprocal(n, ticks)))
        })?;
        let nominal = f64::from(field(base, "nominal")?);
        let ticks_per_us = f64::from(field(base, "ticks_per_us")?);
        let gain = f64::from(field(base, "gain")?) / nominal / ticks_per_us;
        let anchor = field(base, "anchor")?;
        let low = u64::from(field(base, "global")?);
        let high = u64::from(word(base + self.fields.get("global")? + 4)?);
        let global = (high << 32 | low) as f64 / 65_536.0;
        let elapsed = f64::from(count.wrapping_sub(anchor).cast_signed());
        (global > 0.0).then_some((global + elapsed * gain, node.now()))
    }
}

/// Whether `nominal` is 1 / `ticks` with any number of binary places.
fn is_reciprocal(nominal: u32, ticks: u32) -> bool {
    let product = u64::from(nominal) * u64::from(ticks);
    let power = product.next_power_of_two();
    nominal > 1 << 20 && power - product < u64::from(ticks)
}

/// Offsets of the fields of `ttcan::clock::Clock`.
fn fields(file: &object::File) -> Option<HashMap<String, usize>> {
    let load = |id: gimli::SectionId| -> Result<Vec<u8>, gimli::Error> {
        let section = file.section_by_name(id.name());
        let data = section.and_then(|section| section.uncompressed_data().ok());
        Ok(data.map_or_else(Vec::new, |data| data.into_owned()))
    };
    let sections = gimli::DwarfSections::load(load).ok()?;
    let dwarf = sections.borrow(|section| EndianSlice::new(section, LittleEndian));
    let mut units = dwarf.units();
    while let Ok(Some(header)) = units.next() {
        let unit = dwarf.unit(header).ok()?;
        let name = |entry: &gimli::DebuggingInformationEntry<EndianSlice<LittleEndian>>| {
            let value = entry.attr_value(gimli::DW_AT_name)?;
            let name = dwarf.attr_string(&unit, value).ok()?;
            Some(name.to_string_lossy().into_owned())
        };
        let mut tree = unit.entries();
        // The fields of the structure under way, and its depth.
        let mut found: Option<HashMap<String, usize>> = None;
        while let Ok(Some(entry)) = tree.next_dfs() {
            if entry.tag() == gimli::DW_TAG_member {
                if let (Some(found), Some(name)) = (&mut found, name(entry)) {
                    let offset = number(entry, gimli::DW_AT_data_member_location);
                    found.insert(name, offset.unwrap_or(0));
                }
                continue;
            }
            if let Some(fields) = found.take()
                && ["ticks_per_us", "nominal", "gain", "anchor", "global"]
                    .iter()
                    .all(|name| fields.contains_key(*name))
            {
                return Some(fields);
            }
            if entry.tag() == gimli::DW_TAG_structure_type
                && name(entry).as_deref() == Some("Clock")
            {
                found = Some(HashMap::new());
            }
        }
    }
    None
}

fn number(
    entry: &gimli::DebuggingInformationEntry<EndianSlice<LittleEndian>>,
    attribute: DwAt,
) -> Option<usize> {
    match entry.attr_value(attribute)? {
        AttributeValue::Udata(value) => Some(value as usize),
        value => value.udata_value().map(|value| value as usize),
    }
}
