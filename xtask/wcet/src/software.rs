//! What RTIC's software tasks bring into an image: the executor calls the functions of a
//! waker through pointers, and the timer queue of `rtic-time` is a linked list.

use std::collections::{BTreeMap, BTreeSet};

use rsemu::cpu::arm::v7m::isa::Insn;

use super::graph::{Graph, conditional};
use super::image::Image;
use super::instruction::{Flow, advance_it, decode};

/// The functions of the executor's one table of waker functions begin with this.
const WAKER: &str = "rtic::export::executor::waker_";
/// The one of them that calls the function that was given to the waker.
const WAKE: &str = "rtic::export::executor::waker_wake";

/// Sources whose loops are known; another version of them is not.
const LIST: &str = "rtic-time-2.0.1/src/linked_list.rs";
/// See [`LIST`].
const QUEUE: &str = "rtic-time-2.0.1/src/timer_queue.rs";

/// Where a call through a pointer in the function at `function` may go when nothing is known
/// of the pointer; `None` in an image without software tasks, which has no reason for one.
///
/// A pointer to a function is a constant before it is anything else, so it is one of those
/// that stand in the image. A waker wakes through the pointer to a `fn()` that RTIC hands to
/// it, which no function of the table of wakers is.
#[must_use]
pub fn targets(image: &Image, function: u32) -> Option<BTreeSet<u32>> {
    image.functions().find(|(_, known)| known.name == WAKE)?;
    let mut taken = taken(image);
    if image.name(function) == WAKE {
        taken.retain(|target| !image.name(*target).starts_with(WAKER));
    }
    Some(taken)
}

/// The function that a word points to, if it does.
#[must_use]
pub fn pointee(image: &Image, word: u32) -> Option<u32> {
    let address = word & !1;
    (word & 1 == 1 && image.function(address).is_some()).then_some(address)
}

/// Functions whose address stands in data, among code or in two halves in moves, the vector
/// table left out.
#[must_use]
pub fn taken(image: &Image) -> BTreeSet<u32> {
    let mut taken = BTreeSet::new();
    let first = image.functions().next().map_or(0, |(first, _)| first);
    for (start, bytes) in image.contents() {
        let aligned = start.next_multiple_of(4);
        let words = bytes.get((aligned - start) as usize..).unwrap_or_default();
        for (at, word) in (aligned..).step_by(4).zip(words.chunks_exact(4)) {
            if at >= first && !image.is_code(at) {
                let word = word.try_into().map_or(0, u32::from_le_bytes);
                taken.extend(pointee(image, word));
            }
        }
    }
    for (function, known) in image.functions() {
        taken.extend(moved(image, function, known.size));
    }
    taken
}

/// Functions whose address the function at `function` makes of two halves.
///
/// The upper half follows the lower one, but where several paths share it a branch lies
/// between: such a lower half counts with every upper one for its register.
fn moved(image: &Image, function: u32, size: u32) -> BTreeSet<u32> {
    let mut words = BTreeSet::new();
    let mut low: BTreeMap<u8, u32> = BTreeMap::new();
    let mut carried: BTreeSet<(u8, u32)> = BTreeSet::new();
    let mut high: BTreeSet<(u8, u32)> = BTreeSet::new();
    let (mut address, mut it) = (function, 0);
    while address < function + size {
        let is_code = image.is_code(address);
        let Some(instruction) = is_code.then(|| decode(image, address, it).ok()).flatten() else {
            (address, it) = (address + 2, 0);
            continue;
        };
        address += instruction.size;
        it = match instruction.insn {
            Insn::It { cond, mask } => (cond.0 << 4) | mask,
            _ => advance_it(it),
        };
        // What may be skipped may leave a half behind it.
        if instruction.flow() != Flow::Next || conditional(&instruction) {
            carried.extend(low.iter().map(|(register, low)| (*register, *low)));
        }
        match instruction.insn {
            Insn::MovImm16 {
                rd,
                imm,
                top: false,
            } => {
                low.insert(rd, imm.into());
            }
            Insn::MovImm16 { rd, imm, top: true } => {
                let imm = u32::from(imm) << 16;
                words.extend(low.remove(&rd).map(|low| imm | low));
                high.insert((rd, imm));
            }
            _ => {
                let written = instruction.written();
                low.retain(|register, _| written & (1 << register) == 0);
            }
        }
    }
    for (register, low) in carried {
        let of_register = high.iter().filter(|(other, _)| *other == register);
        words.extend(of_register.map(|(_, high)| high | low));
    }
    let words = words.into_iter();
    words.filter_map(|word| pointee(image, word)).collect()
}

/// The tasks that may wait in the timer queue: each has one executor, and waits for one
/// instant at a time.
fn waiting(image: &Image) -> u64 {
    let executors = image
        .symbols()
        .filter(|name| name.contains("__rtic_internal_") && name.contains("_EXEC"));
    executors.count() as u64
}

/// The bound of loop `number` of `graph` if it is one of the timer queue's, with what it is.
#[must_use]
pub fn bound(image: &Image, graph: &Graph, number: usize) -> Option<(&'static str, u64)> {
    let instructions = graph.loops[number]
        .blocks
        .iter()
        .flat_map(|block| &graph.blocks[*block].instructions);
    let (mut in_list, mut in_queue) = (true, true);
    let mut located = 0;
    for instruction in instructions {
        let places = image.places(instruction.address);
        if places.iter().all(|place| place.line == 0) {
            continue;
        }
        located += 1;
        let within = |file: &str| places.iter().any(|place| place.file.ends_with(file));
        in_list &= within(LIST);
        in_queue &= within(QUEUE);
    }
    let waiting = waiting(image);
    if located == 0 || waiting == 0 {
        None
    } else if in_list {
        // From the second link on, over those of the other tasks and its own.
        Some(("search in the timer queue", waiting - 1))
    } else if in_queue {
        // The timer's interrupt is above the tasks that wait, so none comes in meanwhile: a
        // turn takes one out, or finds that its time has just come, which the next one takes
        // out. The last turn, on an empty queue, does not go back.
        Some(("timer queue, two turns for each task", 2 * waiting))
    } else {
        None
    }
}
