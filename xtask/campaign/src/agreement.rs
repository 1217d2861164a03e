//! How well the nodes agree on the global time, read from their memories.
//!
//! The protocol stack lives in a static of the program; its clock is found there by its
//! constants, and its fields by the debug information of the image, wherever the compiler put
//! them.

use std::collections::HashMap;

use addr2line::gimli::{self, AttributeValue, DwAt, EndianSlice, LittleEndian};
use object::{Object, ObjectSection, ObjectSymbol};
use twin::mcu::Mcu;
use twin::{Images, Twin};
use vehicle_model::NodeIndex;
use world::{SimDuration, SimTime};

/// Counter of TIM2, the time base of both parts.
const COUNTER: u32 = 0x4000_0024;

/// Time from when a node knows the time until it is compared with others: the filter of its rate
/// settles.
const SETTLING: SimDuration = SimDuration::from_ticks(1_000_000_000_000);
/// Span between two comparisons. No multiple of the basic cycle, so that references of every age
/// come up.
pub const SPAN: SimDuration = SimDuration::from_ticks(37_000_000_000);

/// Differences between the global times of the nodes of a vehicle.
#[derive(Clone, Debug)]
pub struct Agreement {
    clocks: Vec<(NodeIndex, NodeClock)>,
    /// Since when each node knows the time.
    known: Vec<Option<SimTime>>,
    /// Largest difference between any two nodes at each instant, microseconds.
    errors: Vec<f64>,
}

/// How well the nodes agreed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Figures {
    /// Number of instants at which they were compared.
    pub instants: usize,
    /// Largest difference between any two nodes, microseconds.
    pub largest_us: f64,
    /// Difference that 99 % of the instants stay within, microseconds.
    pub p99_us: f64,
}

impl Agreement {
    /// Nothing compared yet; `None` when an image has no protocol stack or no debug information.
    #[must_use]
    pub fn new(images: &Images) -> Option<Self> {
        let found = images.iter();
        let clocks: Option<Vec<_>> = found
            .map(|(node, elf)| Some((node, NodeClock::find(elf)?)))
            .collect();
        let clocks = clocks?;
        Some(Self {
            known: vec![None; clocks.len()],
            clocks,
            errors: Vec::new(),
        })
    }

    /// Compares the nodes that have known the time for a second and are not busy with a task.
    pub fn compare(&mut self, twin: &mut Twin) {
        let mut times = Vec::new();
        for ((node, clock), known) in self.clocks.iter().zip(&mut self.known) {
            let mcu = twin.node_mut(*node);
            let time = if mcu.is_held() { None } else { clock.read(mcu) };
            let Some((global, now)) = time else {
                *known = None;
                continue;
            };
            // A task may be halfway through a change of the clock: it has moved the anchor to the last
            // reference, but not the time yet.
            let settled = now >= *known.get_or_insert(now) + SETTLING;
            if settled && mcu.exception() == 0 {
                times.push(global - now.as_ticks() as f64 * 1e-6);
            }
        }
        if times.len() > 1 {
            let most = times.iter().copied().fold(f64::MIN, f64::max);
            let least = times.iter().copied().fold(f64::MAX, f64::min);
            self.errors.push(most - least);
        }
    }

    /// Figures of the comparisons; `None` before the first one.
    #[must_use]
    pub fn figures(&self) -> Option<Figures> {
        let mut errors = self.errors.clone();
        errors.sort_by(f64::total_cmp);
        Some(Figures {
            instants: errors.len(),
            largest_us: *errors.last()?,
            p99_us: *errors.get(errors.len() * 99 / 100)?,
        })
    }
}

/// The clock of a program's protocol stack.
#[derive(Clone, Debug)]
struct NodeClock {
    /// The static that holds the protocol stack.
    stack: u32,
    size: usize,
    /// Offsets of the clock's fields.
    fields: HashMap<String, usize>,
}

impl NodeClock {
    /// Finds the clock of an image.
    fn find(elf: &[u8]) -> Option<Self> {
        let file = object::File::parse(elf).ok()?;
        let stack = file.symbols().find(|symbol| {
            let name = symbol.name().unwrap_or_default();
            name.contains("__rtic_internal_local_init_stack")
        })?;
        Some(Self {
            stack: stack.address() as u32,
            size: stack.size() as usize,
            fields: fields(&file)?,
        })
    }

    /// Global time in microseconds and the instant it was read at; `None` before the node
    /// knows the time.
    fn read(&self, node: &mut Mcu) -> Option<(f64, SimTime)> {
        let memory = node.memory(self.stack, self.size)?;
        let count = node.read_register(COUNTER)?;
        let word = |at: usize| {
            let bytes = memory.get(at..at + 4)?;
            Some(u32::from_le_bytes(bytes.try_into().ok()?))
        };
        let field = |base: usize, name: &str| word(base + self.fields.get(name)?);
        // Ticks in a microsecond of a board, and its reciprocal as the stack computes it.
        let is_rate = |ticks: u32| {
            let mut sleds = parts::Sled::ALL.into_iter();
            sleds.any(|sled| {
                [sled.external, sled.internal]
                    .iter()
                    .any(|clocks| clocks.ticks_per_us == ticks)
            })
        };
        let base = (0..self.size).step_by(4).find(|&base| {
            let ticks = field(base, "ticks_per_us");
            let nominal = field(base, "nominal");
            ticks
                .filter(|&ticks| is_rate(ticks))
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
        // The fields of the current structure, and its depth.
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
