//! Loops of the compiler's run-time library whose bounds the abstract machine cannot find, with
//! the reason why they end.

use std::collections::BTreeSet;

use rsemu::cpu::arm::v7m::isa::{Cond, DpOp, Insn, Operand, ShiftType};

use super::graph::{Block, Graph};
use super::image::Image;
use super::instruction::{Flow, Instruction};
use super::register::{Register, RegisterSet};

/// A function of the library, one of whose loops is known.
struct Known {
    name: &'static str,
    /// Most turns that the loop takes in the source.
    turns: u64,
    what: &'static str,
    /// How many turns of the source one turn of the machine code makes.
    unrolled: fn(&Graph, usize) -> u64,
}

const KNOWN: [Known; 2] = [
    // `delegate.rs` of compiler-builtins shifts the divisor left by less than 32 places, up to
    // the dividend, and back by one place in each turn. After the last turn the remainder is
    // smaller than the divisor.
    Known {
        name: "compiler_builtins::int::specialized_div_rem::u64_div_rem",
        turns: 32,
        what: "64-bit division, one turn for each place",
        unrolled: by_shifts,
    },
    // `binary_long.rs`, for a core that does not divide, shifts the divisor left by less than 32 places
    // and counts them down to zero, by one in each turn.
    Known {
        name: "compiler_builtins::int::specialized_div_rem::u32_div_rem",
        turns: 31,
        what: "32-bit division, one turn for each place",
        unrolled: by_count,
    },
];

/// Callers whose copies move at most one byte. The encoder of `defmt` gives the logger one byte
/// at a time (`rzcobs.rs`), and the logger copies it in at most two parts.
const LOGGER: [&str; 4] = [
    "_defmt_write",
    "_defmt_acquire",
    "_defmt_release",
    "defmt_rtt::",
];

/// A part of the path of the logger's source: another logger may have functions of the same names.
const LOGGER_SOURCE: &str = "defmt-rtt";

/// Whether the function at `entry` is the logger's.
fn is_logger(image: &Image, entry: u32) -> bool {
    let mut places = image.places(entry).into_iter();
    places.any(|place| place.file.contains(LOGGER_SOURCE))
}

/// The most bytes that the function at `caller` copies at once, if that is known.
#[must_use]
pub(crate) fn most_copied(image: &Image, caller: u32) -> Option<u64> {
    let name = image.name(caller);
    let known = LOGGER.iter().any(|part| name.contains(part)) && is_logger(image, caller);
    known.then_some(1)
}

/// The condition that `Z` is clear.
const NOT_EQUAL: Cond = Cond(1);

/// What a loop is called that only repeats a store-exclusive.
pub(crate) const RETRY: &str = "store-exclusive, repeated when interrupted";

/// Whether loop `number` only repeats a store-exclusive that failed. A store-exclusive fails if the task
/// was interrupted after its load-exclusive, or if nothing is reserved. So three things are proven.
/// Each way once around the loop leaves a block because a store in it failed. It passes a
/// load-exclusive. And before each store, what the last load-exclusive reserved is still so: no other
/// store-exclusive, no `CLREX` and no call lies between them. A loop that waits for a value, as of a
/// lock, has a way around without a failed store.
fn is_retry(graph: &Graph, number: usize) -> bool {
    let blocks = &graph.loops[number].blocks;
    let without_failure = |from: usize, to: usize| failed(graph, from) != Some(to);
    let loads = |block: usize| {
        let mut all = graph.blocks[block].instructions.iter();
        all.any(|one| matches!(one.insn, Insn::LoadStoreExclusive { load: true, .. }))
    };
    !is_cyclic(graph, blocks, without_failure)
        && !is_cyclic(graph, blocks, |from, _| !loads(from))
        && stores_what_it_reserved(graph, blocks)
}

/// Whether no way within `blocks` leads from where a reservation is lost (a store-exclusive, `CLREX` or
/// a call) to a store-exclusive without a load-exclusive between them.
fn stores_what_it_reserved(graph: &Graph, blocks: &BTreeSet<usize>) -> bool {
    let is_call = |block: usize| {
        let (last, _) = graph.blocks[block].split_last();
        matches!(last.flow(), Flow::Call { .. } | Flow::CallRegister { .. })
    };
    // Whether something is reserved behind a block; `None` if it stores what is not reserved.
    let pass = |block: usize, reserved: bool| {
        let mut reserved = reserved;
        for one in &graph.blocks[block].instructions {
            match one.insn {
                Insn::LoadStoreExclusive { load: true, .. } => {
                    reserved = one.condition.is_none() || reserved;
                }
                Insn::LoadStoreExclusive { .. } if !reserved => return None,
                Insn::LoadStoreExclusive { .. } | Insn::ClearExclusive => reserved = false,
                _ => {}
            }
        }
        Some(reserved && !is_call(block))
    };
    // Before the loop, or any block of it, a reservation may be there.
    let mut lost: Vec<usize> = Vec::new();
    for &block in blocks {
        match pass(block, true) {
            None => return false,
            Some(true) => {}
            Some(false) => lost.push(block),
        }
    }
    let mut known: BTreeSet<usize> = BTreeSet::new();
    while let Some(block) = lost.pop() {
        for &next in &graph.blocks[block].successors {
            if !blocks.contains(&next) || !known.insert(next) {
                continue;
            }
            match pass(next, false) {
                None => return false,
                Some(true) => {}
                Some(false) => lost.push(next),
            }
        }
    }
    true
}

/// Whether some of these blocks follow each other in a circle, by edges that `follows` accepts.
fn is_cyclic(
    graph: &Graph,
    blocks: &BTreeSet<usize>,
    follows: impl Fn(usize, usize) -> bool,
) -> bool {
    let mut left = blocks.clone();
    loop {
        let ends = |block: &usize| {
            let mut next = graph.blocks[*block].successors.iter();
            !next.any(|to| left.contains(to) && follows(*block, *to))
        };
        let Some(end) = left.iter().copied().find(ends) else {
            return !left.is_empty();
        };
        left.remove(&end);
    }
}

/// The successor of a block that is taken if, and only if, a store-exclusive in the block failed.
fn failed(graph: &Graph, block: usize) -> Option<usize> {
    let Block {
        instructions,
        successors,
    } = &graph.blocks[block];
    let (last, body) = graph.blocks[block].split_last();
    let stores = instructions
        .iter()
        .position(|one| matches!(one.insn, Insn::LoadStoreExclusive { load: false, .. }));
    let store = stores.filter(|at| instructions[*at].condition.is_none())?;
    let Insn::LoadStoreExclusive { rd: status, .. } = instructions[store].insn else {
        return None;
    };
    let changed = instructions[store + 1..]
        .iter()
        .any(|one| one.written().contains(Register::new(status)));
    if changed {
        return None;
    }
    let Flow::Branch { condition, target } = last.flow() else {
        return None;
    };
    let by_branch = match (condition, last.insn) {
        (None, Insn::Cbz { nonzero, rn, .. }) if rn == status => nonzero,
        (Some(condition @ (NOT_EQUAL | Cond::EQ)), _) if tests(body.last()?, status) => {
            condition == NOT_EQUAL
        }
        _ => return None,
    };
    let to = if by_branch { target } else { last.next() };
    let is_there = |next: &&usize| graph.blocks[**next].start() == to;
    let one = successors.iter().find(is_there).copied();
    one.filter(|_| target != last.next())
}

/// Whether an instruction compares this register with zero.
fn tests(instruction: &Instruction, register: u8) -> bool {
    let zero = |operand| matches!(operand, Operand::Imm { value: 0, .. });
    instruction.condition.is_none()
        && matches!(
            instruction.insn,
            Insn::DataProc { op: DpOp::Cmp, rn, operand, .. } if rn == register && zero(operand)
        )
}

/// The bound of loop `number` of `graph` and the reason for it, if the loop is known.
#[must_use]
pub(crate) fn bound(image: &Image, graph: &Graph, number: usize) -> Option<(&'static str, u64)> {
    if is_retry(graph, number) {
        return Some((RETRY, 1));
    }
    let name = image.name(graph.entry);
    // What is exported for the optimisation across crates has an appendix.
    let name = name.split(" (.llvm.").next().unwrap_or(&name);
    let known = KNOWN.iter().find(|known| known.name == name)?;
    let unrolled = (known.unrolled)(graph, number);
    Some((known.what, known.turns.div_ceil(unrolled)))
}

/// The register that holds the number of bytes on entry of a function that copies, fills, compares or
/// encodes memory (ISO C 7.24; run-time ABI for the Arm architecture, 4.3.4).
#[must_use]
pub(crate) fn length_register(image: &Image, entry: u32) -> Option<Register> {
    let name = image.name(entry);
    if encodes(&name) {
        // Its loop encodes one byte in each turn.
        return is_logger(image, entry).then_some(Register::new(1));
    }
    let name = library(&name)?;
    let plain = name.trim_end_matches(['4', '8']);
    match plain {
        "memcpy" | "memmove" | "memset" | "__aeabi_memcpy" | "__aeabi_memmove" => {
            Some(Register::new(2))
        }
        _ if compares(name) => Some(Register::new(2)),
        "__aeabi_memset" | "__aeabi_memclr" => Some(Register::new(1)),
        _ => None,
    }
}

/// The register that holds the number of bytes which a function writes from the address in `r0`
/// on; `None` for a function that also writes elsewhere.
#[must_use]
pub(crate) fn destination_length(image: &Image, entry: u32) -> Option<Register> {
    let name = image.name(entry);
    length_register(image, entry).filter(|_| !encodes(&name) && !compares(&name))
}

/// The name of a function of the C library, or of its implementation in `compiler_builtins`. A function of a program
/// has a path in front of its name, and may do anything.
fn library(name: &str) -> Option<&str> {
    match name.rsplit_once("::") {
        None => Some(name),
        Some((path, name)) => path.starts_with("compiler_builtins").then_some(name),
    }
}

/// Whether a function of this name compares two stretches of memory. Each turn of its loops compares bytes
/// that no other turn does, and there are as many of them as its length.
fn compares(name: &str) -> bool {
    matches!(library(name), Some("memcmp" | "bcmp"))
}

/// Whether a function of this name encodes the bytes of a log record: `_defmt_write`, or the logger's method that
/// it calls.
fn encodes(name: &str) -> bool {
    name == "_defmt_write" || name.contains("defmt_rtt::Logger as ") && name.ends_with("::write")
}

/// The most turns of loop `number` in a function that writes `bytes` bytes, each of them once:
/// `bytes` divided by the number that the loop's first block stores in one turn.
#[must_use]
pub(crate) fn copying(graph: &Graph, number: usize, bytes: u64) -> u64 {
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

/// How many turns of the source loop one turn of the machine loop makes. The source shifts by
/// one place in each turn, so it is the number of places by which the machine code shifts
/// those registers that the loop does not change otherwise.
fn by_shifts(graph: &Graph, number: usize) -> u64 {
    let instructions = graph.loops[number]
        .blocks
        .iter()
        .flat_map(|block| &graph.blocks[*block].instructions);
    let mut places = [0u64; 15];
    let mut otherwise = RegisterSet::NONE;
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
    (0..)
        .map(Register::new)
        .zip(places)
        .filter(|(register, places)| *places > 0 && !otherwise.contains(*register))
        .map(|(_, places)| places)
        .min()
        .unwrap_or(1)
}

/// How many turns of the source loop one turn of the machine loop makes, where the source counts down by one in
/// each turn: the constant that the machine code subtracts. Each way around the loop must pass that
/// instruction, and no other one may write its register.
fn by_count(graph: &Graph, number: usize) -> u64 {
    let blocks = &graph.loops[number].blocks;
    let of = |block: &usize| graph.blocks[*block].instructions.iter();
    let steps = blocks.iter().filter_map(|block| {
        let mut steps = of(block).filter_map(|one| match one.insn {
            Insn::DataProc {
                op: DpOp::Sub,
                rd,
                rn,
                operand: Operand::Imm { value, .. },
                ..
            } if rd == rn && rd < 13 && value > 0 && one.condition.is_none() => {
                Some((Register::new(rd), value))
            }
            _ => None,
        });
        Some((*block, steps.next()?))
    });
    let is_counter = |(block, (register, _)): &(usize, (Register, u32))| {
        let all = blocks.iter().flat_map(of);
        let writes = all.filter(|one| one.written().contains(*register)).count();
        writes == 1 && !is_cyclic(graph, blocks, |from, _| from != *block)
    };
    let counted = steps.filter(is_counter).map(|(_, (_, step))| step);
    counted.min().map_or(1, u64::from)
}

#[cfg(test)]
mod tests {
    use super::{compares, library};

    #[test]
    fn a_function_of_a_program_is_none_of_the_library() {
        for name in ["memcpy", "compiler_builtins::mem::memcpy"] {
            assert_eq!(library(name), Some("memcpy"), "{name}");
        }
        assert!(compares("bcmp"));
        for name in ["app::flash::memcpy", "app::memcmp"] {
            assert_eq!(library(name), None, "{name}");
            assert!(!compares(name));
        }
    }
}
