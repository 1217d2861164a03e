//! The call graph of an image, built from its instructions.

use std::collections::{BTreeMap, BTreeSet};

use wcet::{
    image::Image,
    instruction::{Flow, Instruction, decode},
    software,
};

/// Start of the flash, where the vector table stands.
const FLASH: u32 = parts::F446.flash.base;

/// Why the calls of an image cannot be followed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CallsError {
    /// The flash does not begin with a vector table.
    #[error("no vector table at the start of the flash")]
    NoVectorTable,
    /// A function contains bytes that are no instruction.
    #[error("no instruction at {place}")]
    NoInstruction {
        /// The address, and what is there.
        place: String,
    },
}

/// A call, or a jump out of a function.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Call {
    /// Address of the instruction.
    pub at: u32,
    /// First address of the callee; `None` for a call through a pointer with unknown target.
    pub callee: Option<u32>,
}

/// Calls and traps of one function.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Body {
    /// Its calls.
    pub calls: Vec<Call>,
    /// Addresses of trap instructions, except those right after a call: the compiler puts one
    /// there when the callee never returns.
    pub traps: Vec<u32>,
}

/// The functions that are reachable from the vector table.
#[derive(Debug, Clone)]
pub(super) struct Calls {
    bodies: BTreeMap<u32, Body>,
}

impl Calls {
    /// Follows the calls from the vector table. A call through a pointer with unknown target
    /// makes every function reachable whose address is taken anywhere.
    ///
    /// # Errors
    ///
    /// The image has no vector table or no symbols, or a reachable function contains bytes
    /// that are no instruction.
    pub(super) fn of(image: &Image) -> Result<Self, CallsError> {
        let roots = vectors(image);
        if roots.is_empty() {
            return Err(CallsError::NoVectorTable);
        }
        let mut bodies = BTreeMap::new();
        let mut work: Vec<u32> = roots.into_iter().collect();
        let mut pointers = None;
        while let Some(function) = work.pop() {
            if bodies.contains_key(&function) {
                continue;
            }
            let body = body(image, function)?;
            for call in &body.calls {
                match call.callee {
                    Some(callee) => work.push(callee),
                    None if pointers.is_none() => {
                        let taken = software::taken(image);
                        work.extend(&taken);
                        pointers = Some(taken);
                    }
                    None => {}
                }
            }
            bodies.insert(function, body);
        }
        Ok(Self { bodies })
    }

    /// The functions, by their first address.
    pub(super) fn bodies(&self) -> impl Iterator<Item = (u32, &Body)> {
        self.bodies.iter().map(|(address, body)| (*address, body))
    }
}

/// The functions in the vector table.
fn vectors(image: &Image) -> BTreeSet<u32> {
    let end = image.functions().next().map_or(FLASH, |(first, _)| first);
    // The first word is the stack pointer.
    (FLASH + 4..end)
        .step_by(4)
        .filter_map(|address| software::pointee(image, image.constant(address, 4)?))
        .collect()
}

/// The instructions of a function in the order of their addresses. Data between them is
/// skipped.
fn instructions(image: &Image, function: u32) -> Result<Vec<Instruction>, CallsError> {
    let size = image.function(function).map_or(0, |known| known.size);
    let next = image
        .functions()
        .map(|(address, _)| address)
        .find(|&address| address > function);
    let end = match size {
        0 => next.unwrap_or(function),
        size => function + size,
    };
    let mut instructions = Vec::new();
    let mut address = function;
    while address < end {
        if !image.is_code(address) {
            address += 2;
            continue;
        }
        let instruction = decode(image, address, 0).map_err(|_| CallsError::NoInstruction {
            place: image.describe(address),
        })?;
        address += instruction.size;
        instructions.push(instruction);
    }
    Ok(instructions)
}

fn body(image: &Image, function: u32) -> Result<Body, CallsError> {
    let mut body = Body::default();
    let mut after_call = false;
    for instruction in instructions(image, function)? {
        let at = instruction.address;
        let leaves = |target: u32| target != function && image.function(target).is_some();
        let flow = instruction.flow();
        match flow {
            Flow::Call { target } => body.calls.push(Call {
                at,
                callee: Some(target),
            }),
            Flow::Jump { target } | Flow::Branch { target, .. } if leaves(target) => {
                body.calls.push(Call {
                    at,
                    callee: Some(target),
                });
            }
            _ if instruction.calls_through_pointer() => {
                let targets = software::targets(image, function, at);
                body.calls.extend(
                    match targets {
                        Some(targets) => targets.into_iter().map(Some).collect(),
                        None => vec![None],
                    }
                    .into_iter()
                    .map(|callee| Call { at, callee }),
                );
            }
            Flow::Stop if !after_call => body.traps.push(at),
            _ => {}
        }
        after_call = matches!(flow, Flow::Call { .. });
    }
    Ok(body)
}
