//! Support for RTIC's software tasks. The executor calls the functions of a waker through
//! pointers, and the timer queue of `rtic-time` is a linked list; this module knows the targets
//! of the calls and the bounds of the list's loops.

use std::collections::{BTreeMap, BTreeSet};

use rsemu::cpu::arm::v7m::isa::{Insn, MemOffset, Size};

use super::graph::{Graph, conditional};
use super::image::Image;
use super::instruction::{Flow, Instruction, advance_it, decode};
use super::register::{Register, RegisterSet};

/// Prefix of the functions in the executor's only table of waker functions.
const WAKER: &str = "rtic::export::executor::waker_";
/// The function in that table which calls the `fn()` that was given to the waker.
const WAKE: &str = "rtic::export::executor::waker_wake";

/// Functions that `cortex-m-rt` calls in assembly.
const START: [&str; 2] = ["__pre_init", "main"];

/// A source whose loops are known. A new version has to be examined anew.
struct Known {
    /// Where it is in the released package.
    released: &'static str,
    /// Its name in any copy.
    name: &'static str,
    /// The SHA-256 digest of its text, by which a copy elsewhere is recognised.
    digest: [u8; 32],
}

impl Known {
    /// Whether this is the file, as the image names it.
    fn is(&self, image: &Image, file: &str) -> bool {
        let is_copy = || file.ends_with(self.name) && image.digest(file) == Some(self.digest);
        file.ends_with(self.released) || is_copy()
    }
}

/// The list of the timer queue.
const LIST: Known = Known {
    released: "rtic-time-2.0.1/src/linked_list.rs",
    name: "/linked_list.rs",
    digest: [
        0x91, 0x58, 0x6b, 0xf4, 0x0c, 0xb2, 0x7e, 0x94, 0xda, 0x99, 0x0e, 0x81, 0x9e, 0xac, 0xb9,
        0x10, 0xd4, 0x94, 0xce, 0x1e, 0xa6, 0xab, 0x50, 0x1c, 0x54, 0x2f, 0xa0, 0x89, 0x6e, 0x2f,
        0x3e, 0x29,
    ],
};
/// The timer queue.
const QUEUE: Known = Known {
    released: "rtic-time-2.0.1/src/timer_queue.rs",
    name: "/timer_queue.rs",
    digest: [
        0xdd, 0xf0, 0x56, 0x0f, 0x6d, 0x3d, 0x59, 0xe9, 0x10, 0x28, 0x98, 0xc5, 0xb8, 0x61, 0xe6,
        0x9d, 0x73, 0x85, 0x04, 0x0b, 0xf0, 0x9e, 0x3a, 0xdc, 0x96, 0x4b, 0xe3, 0xb2, 0xb9, 0x76,
        0xae, 0x0a,
    ],
};

/// The lines of [`LIST`] that load the next link of one, and the one by which a link that enters the list
/// loads the first.
const LOADS_OF_OTHERS: [u32; 7] = [37, 68, 75, 83, 90, 109, 137];
/// The source of such a load.
const ATOMIC_SOURCE: &str = "core/src/sync/atomic.rs";

/// What the loop of the timer's interrupt is called, of which each turn removes a task from the queue or waits for
/// one. No task may enter it meanwhile: the interrupt's priority is above those of the tasks that wait.
pub const TIMER_QUEUE: &str = "timer queue, two turns for each task";

/// Source of the calls of a waker's functions, whatever the name of the function that holds the call.
const WAKE_SOURCE: &str = "core/src/task/wake.rs";
/// Prefix of the names of the functions there.
const WAKE_MODULE: &str = "core::task::wake::";
/// Function pointers in the table of a waker: to clone, wake, wake by reference and drop it.
const WAKER_FUNCTIONS: usize = 4;

/// The functions that the call at `call` through an unknown pointer in the function at `function` may
/// reach; `None` in an image without software tasks, which contains no such call.
///
/// A program obtains a function pointer only from a constant, so the target is a function whose address
/// stands in the image. Two kinds of calls reach fewer:
///
/// - A call in `core::task::wake` is that of a waker's function. Wakers have their functions in a constant
///   table of four pointers, and each takes one parameter.
/// - RTIC's waker calls the `fn()` that the generated code gave to it. That has no parameter, and is
///   neither one of the waker's own functions nor code that was built with the compiler.
#[must_use]
pub fn targets(image: &Image, function: u32, call: u32) -> Option<BTreeSet<u32>> {
    image.functions().find(|(_, known)| known.name == WAKE)?;
    let innermost = image.places(call).into_iter().next();
    if image.name(function) == WAKE {
        let mut taken = taken(image);
        taken
            .retain(|target| !image.name(*target).starts_with(WAKER) && runs_alone(image, *target));
        return Some(taken);
    }
    if innermost.is_some_and(|place| place.file.ends_with(WAKE_SOURCE)) {
        let tabled: BTreeSet<u32> = taken(image).intersection(&wakers(image)).copied().collect();
        if !tabled.is_empty() {
            return Some(tabled);
        }
    }
    Some(taken(image))
}

/// Whether the function at `target` may be the `fn()` of a program.
fn runs_alone(image: &Image, target: u32) -> bool {
    let signature = image.signature(target);
    signature.is_none_or(|signature| signature.carried == 0 && !signature.toolchain)
}

/// The functions in constant tables that may be those of a waker.
fn wakers(image: &Image) -> BTreeSet<u32> {
    let mut wakers = BTreeSet::new();
    for (start, bytes) in image.constants() {
        let aligned = start.next_multiple_of(4);
        let words = bytes.get((aligned - start) as usize..).unwrap_or_default();
        let mut row = Vec::new();
        let words = words.chunks_exact(4).map(Some).chain([None]);
        for (at, word) in (aligned..).step_by(4).zip(words) {
            let word = word.and_then(|word| word.try_into().ok());
            let word = word.map(u32::from_le_bytes).filter(|_| !image.is_code(at));
            if let Some(target) = word.and_then(|word| pointee(image, word)) {
                row.push(target);
                continue;
            }
            if row.len() >= WAKER_FUNCTIONS {
                wakers.extend(row.iter().filter(|target| takes_one(image, **target)));
            }
            row.clear();
        }
    }
    wakers
}

/// Whether the function at `target` may take one parameter.
fn takes_one(image: &Image, target: u32) -> bool {
    let signature = image.signature(target);
    signature.is_none_or(|signature| {
        let known = !signature.toolchain || image.name(target).starts_with(WAKE_MODULE);
        known && signature.carried <= 1
    })
}

/// The function that a word points to, if it points to one.
#[must_use]
pub fn pointee(image: &Image, word: u32) -> Option<u32> {
    let address = word & !1;
    (word & 1 == 1 && image.function(address).is_some()).then_some(address)
}

/// Functions whose address stands in data, in literals among code, or in the halves of a pair of
/// moves.
///
/// No source takes the address of a handler of the vector table, or of a function of the start. So
/// two halves that seem to make one belong to other numbers: the functions of the start lie at the begin
/// of the flash, where the lower half is as small as an identifier.
#[must_use]
pub fn taken(image: &Image) -> BTreeSet<u32> {
    let (mut taken, mut handlers) = (BTreeSet::new(), BTreeSet::new());
    let first = image.functions().next().map_or(0, |(first, _)| first);
    for (start, bytes) in image.contents() {
        let aligned = start.next_multiple_of(4);
        let words = bytes.get((aligned - start) as usize..).unwrap_or_default();
        for (at, word) in (aligned..).step_by(4).zip(words.chunks_exact(4)) {
            let word = word.try_into().map_or(0, u32::from_le_bytes);
            if at < first {
                handlers.extend(pointee(image, word));
            } else if !image.is_code(at) {
                taken.extend(pointee(image, word));
            }
        }
    }
    for (function, known) in image.functions() {
        taken.extend(moved(image, function, known.size));
    }
    let starts = |function: &u32| START.contains(&image.name(*function).as_str());
    taken.retain(|function| !handlers.contains(function) && !starts(function));
    taken
}

/// Functions whose address the function at `function` builds from two halves.
///
/// The move of the upper half usually follows that of the lower half. If several paths share
/// the upper one, a branch is in between. So each lower half that is still in its register at
/// a branch counts with every upper half for that register, and so does one that a conditional
/// instruction may leave there.
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
        // A conditional instruction may be skipped and leave the half in the register to which it
        // writes.
        let branches = instruction.flow() != Flow::Next;
        let skipped = if conditional(&instruction) {
            instruction.written()
        } else {
            RegisterSet::NONE
        };
        carried.extend(low.iter().filter_map(|(&register, &low)| {
            let may_stay = branches || skipped.contains(Register::new(register));
            may_stay.then_some((register, low))
        }));
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
                low.retain(|register, _| !written.contains(Register::new(*register)));
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

/// The number of tasks that may wait in the timer queue. Each has one executor and waits for one
/// instant at a time.
fn waiting(image: &Image) -> u64 {
    let executors = image
        .symbols()
        .filter(|name| name.contains("__rtic_internal_") && name.contains("_EXEC"));
    executors.count() as u64
}

/// The loads that find no link in the timer queue, as only one task may wait in it: of the link behind
/// another one, and of the first link when one enters the queue.
///
/// A load from the stack is none of these, whatever its line: it gives back a word that a register had to
/// make room for.
#[must_use]
pub fn finding_no_link(image: &Image) -> BTreeSet<u32> {
    let mut found = BTreeSet::new();
    if waiting(image) != 1 {
        return found;
    }
    for (function, known) in image.functions() {
        let mut address = function;
        while address < function + known.size {
            let is_code = image.is_code(address);
            let Some(instruction) = is_code.then(|| decode(image, address, 0).ok()).flatten()
            else {
                address += 2;
                continue;
            };
            if finds_no_link(image, &instruction) {
                found.insert(address);
            }
            address += instruction.size;
        }
    }
    found
}

fn finds_no_link(image: &Image, instruction: &Instruction) -> bool {
    let Insn::LoadStore {
        load: true,
        size: Size::Word,
        rn,
        offset: MemOffset::Imm(_),
        wback: false,
        ..
    } = instruction.insn
    else {
        return false;
    };
    if matches!(Register::new(rn), Register::SP | Register::PC) {
        return false;
    }
    let places = image.places(instruction.address);
    let is_atomic = places
        .first()
        .is_some_and(|place| place.file.ends_with(ATOMIC_SOURCE));
    is_atomic
        && places
            .iter()
            .any(|place| LOADS_OF_OTHERS.contains(&place.line) && LIST.is(image, &place.file))
}

/// Whether a file is one of the compiler's libraries, with the compiler's path or without.
fn is_toolchain(file: &str) -> bool {
    file.starts_with("/rustc/") || file.starts_with("core/src/")
}

/// The bound of loop `number` of `graph` and the reason for it, if it is a loop of the timer
/// queue.
#[must_use]
pub fn bound(image: &Image, graph: &Graph, number: usize) -> Option<(&'static str, u64)> {
    let instructions = graph.loops[number]
        .blocks
        .iter()
        .flat_map(|block| &graph.blocks[*block].instructions);
    let (mut in_list, mut in_queue) = (true, true);
    let mut own = false;
    for instruction in instructions {
        let places = image.places(instruction.address);
        // What the compiler generated has no line of its own; another one may be that of the caller.
        if places.first().is_none_or(|place| place.line == 0) {
            continue;
        }
        // What the compiler's library does for the source is the source's.
        let innermost = places.iter().find(|place| !is_toolchain(&place.file));
        own |= innermost
            .is_some_and(|place| LIST.is(image, &place.file) || QUEUE.is(image, &place.file));
        let within = |known: &Known| places.iter().any(|place| known.is(image, &place.file));
        in_list &= within(&LIST);
        in_queue &= within(&QUEUE);
    }
    let waiting = waiting(image);
    // A loop in what the source calls, as in another timer's `set_compare`, is none of its own.
    if !own || waiting == 0 {
        None
    } else if in_list {
        // The queue has a link for each waiting task, this one included. The search starts at
        // the second.
        Some(("search in the timer queue", waiting - 1))
    } else if in_queue {
        // The timer's interrupt has a higher priority than the tasks that wait, so no task
        // enters the queue meanwhile. Each turn removes a task from the queue, or finds that
        // the time of the first task has just come, and then the next turn removes it. The
        // last turn, on an empty queue, leaves the loop.
        Some((TIMER_QUEUE, 2 * waiting))
    } else {
        None
    }
}
