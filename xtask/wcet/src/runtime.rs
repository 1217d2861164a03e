//! Loops of the compiler's run-time library that end for a reason the
//! abstract machine cannot see, with that reason.

use rsemu::cpu::arm::v7m::isa::{DpOp, Insn, Operand, ShiftType};

use super::graph::Graph;
use super::image::Image;

/// Functions whose loops take at most so many turns in the source.
const KNOWN: [(&str, u64, &str); 1] = [(
    // `delegate.rs` of compiler-builtins: the divisor is aligned to the
    // dividend by a shift below 32 and moves back one place each turn; with
    // the shift undone the remainder is smaller than the divisor.
    "compiler_builtins::int::specialized_div_rem::u64_div_rem",
    32,
    "64-bit division, one turn for each place",
)];

/// Bytes that a copy moves at most when one of these calls it: `defmt`'s
/// encoder hands the logger one byte at a time (`rzcobs.rs`), which the logger
/// copies in at most two parts.
const LOGGER: [&str; 4] = [
    "_defmt_write",
    "_defmt_acquire",
    "_defmt_release",
    "defmt_rtt::",
];

/// Bytes that the function `caller` copies at most at once, if that is known.
#[must_use]
pub fn most_copied(caller: &str) -> Option<u64> {
    LOGGER.iter().any(|name| caller.contains(name)).then_some(1)
}

/// Whether loop `number` repeats a store that fails only when the task was
/// interrupted since the load that belongs to it.
fn is_retry(graph: &Graph, number: usize) -> bool {
    let l = &graph.loops[number];
    let innermost = graph.loops.iter().all(|other| other.parent != Some(number));
    let mut instructions = l
        .blocks
        .iter()
        .flat_map(|block| &graph.blocks[*block].instructions);
    innermost
        && l.blocks.len() <= 4
        && instructions.any(|instruction| {
            matches!(
                instruction.insn,
                Insn::LoadStoreExclusive { load: false, .. }
            )
        })
}

/// The bound of loop `number` of `graph` if the function is known, with what
/// it is.
#[must_use]
pub fn bound(image: &Image, graph: &Graph, number: usize) -> Option<(&'static str, u64)> {
    if is_retry(graph, number) {
        return Some(("store-exclusive, again when interrupted", 1));
    }
    let name = image.name(graph.entry);
    let (_, turns, what) = KNOWN.iter().find(|(known, ..)| name == *known)?;
    Some((what, turns.div_ceil(unrolled(graph, number))))
}

/// The register that holds the number of bytes on entry of a function that
/// copies, fills or encodes memory (run-time ABI for the Arm architecture, 4.3.4).
#[must_use]
pub fn length_register(name: &str) -> Option<usize> {
    let name = name.rsplit("::").next().unwrap_or(name);
    let plain = name.trim_end_matches(['4', '8']);
    match plain {
        "memcpy" | "memmove" | "memset" | "__aeabi_memcpy" | "__aeabi_memmove" => Some(2),
        "__aeabi_memset" | "__aeabi_memclr" => Some(1),
        // Encodes that many bytes; each moves its buffers by one.
        "_defmt_write" => Some(1),
        _ => None,
    }
}

/// The register that holds how many bytes a function writes, all of them from
/// the address in `r0` on.
#[must_use]
pub fn writes_from_first(name: &str) -> Option<usize> {
    length_register(name).filter(|_| name != "_defmt_write")
}

/// Most turns of loop `number` in a function that writes `bytes` bytes, each
/// of them once: what its first block stores in one turn divides them.
#[must_use]
pub fn copying(graph: &Graph, number: usize, bytes: u64) -> u64 {
    let header = &graph.blocks[graph.loops[number].header];
    let stored: u64 = header
        .instructions
        .iter()
        .filter(|instruction| instruction.condition.is_none())
        .map(|instruction| match instruction.insn {
            Insn::LoadStore {
                load: false, size, ..
            } => u64::from(size.bytes()),
            Insn::LoadStoreDual { load: false, .. } => 8,
            Insn::LoadStoreMultiple {
                load: false, list, ..
            } => 4 * u64::from(list.count_ones()),
            _ => 0,
        })
        .sum();
    bytes.div_ceil(stored.max(1))
}

/// How many turns of the source one turn of the machine code makes: by how
/// many places it moves the registers that the loop changes in no other way.
fn unrolled(graph: &Graph, number: usize) -> u64 {
    let instructions = graph.loops[number]
        .blocks
        .iter()
        .flat_map(|block| &graph.blocks[*block].instructions);
    let mut places = [0u64; 15];
    let mut otherwise = 0u16;
    for instruction in instructions {
        match instruction.insn {
            Insn::DataProc {
                op: DpOp::Mov,
                rd,
                operand: Operand::Reg { rm, shift },
                ..
            } if rd == rm && rd < 13 && shift.ty == ShiftType::Lsr => {
                places[usize::from(rd)] += u64::from(shift.amount);
            }
            _ => otherwise |= instruction.written(),
        }
    }
    places
        .into_iter()
        .enumerate()
        .filter(|(register, places)| *places > 0 && otherwise & (1 << register) == 0)
        .map(|(_, places)| places)
        .min()
        .unwrap_or(1)
}
