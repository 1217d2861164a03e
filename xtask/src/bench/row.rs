//! Cycles of a step between two rows on an emulated core, and its bounds.

use std::{fmt::Write, sync::Arc};

use schedulability::board;
use twin::{
    image::Image,
    mcu::{Board, Mcu},
    part::Part,
};
use wcet::{
    analysis::Analysis,
    annotation::Annotations,
    bound::{Bound, Entry},
    cycles::Cycles,
    register::Register,
};

use super::{
    Builder, CONTROL, Error, Parts, Profile,
    cycles::{BUDGET, IDLE, PLACE, call, function},
};
use crate::Failure;

/// The cost of a part of the step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cost {
    /// The part.
    pub part: &'static str,
    /// Cycles of the longest of many emulated steps, without wait states.
    pub seen: u64,
    /// Bounds, without wait states and with those of the F303.
    pub bound: Cycles,
    /// Most bytes of stack.
    pub stack: u32,
}

/// The program that is measured.
const PROGRAM: &str = "the row step's program";
/// Parts, and what their functions' names end with, in the order of a step.
const PARTS: [(&str, &str); 3] = [
    ("row: until the command", "command"),
    ("row: after the command", "correct"),
    ("the thesis's law", "thesis"),
];
/// Steps that are measured: 10 s.
const STEPS: u32 = 2000;

/// Measures and bounds the parts.
///
/// # Errors
///
/// The program does not build, a part did not do its work, has no bound, or took longer than it.
pub fn measure(builder: &Builder) -> Result<Vec<Cost>, Failure> {
    let parts = Parts {
        name: "row step",
        features: "",
    };
    let path = builder.file(CONTROL, "row", parts, Profile::Release)?;
    let elf = std::fs::read(&path).map_err(crate::ReadError::of(&path))?;
    let seen = longest(&elf)?;
    let image = wcet::image::Image::read(&path).map_err(super::kernels::Error::from);
    let image = image.map_err(Error::from)?;
    let annotations = Annotations::new(builder.workspace.root());
    let mut analysis = Analysis::new(&image, &annotations, &board::part(parts::Sled::F303));
    let mut costs = Vec::new();
    for ((part, name), seen) in PARTS.into_iter().zip(seen) {
        let entry = function(&elf, &format!("run_{name}"))? & !1;
        let bound: Bound = analysis.run_with(entry, Entry::Function, &[(Register::R0, PLACE)]);
        if let Some(problem) = bound.problems.first() {
            return Err(Error::NoBound {
                part: part.into(),
                problem: problem.to_string(),
            }
            .into());
        }
        costs.push(Cost {
            part,
            seen,
            bound: bound.cycles,
            stack: bound.stack,
        });
    }
    match costs.iter().find(|cost| cost.seen > cost.bound.zero_wait) {
        Some(cost) => Err(Error::Unsound {
            part: cost.part.into(),
        }
        .into()),
        None => Ok(costs),
    }
}

/// Cycles of the longest call of each part.
fn longest(elf: &[u8]) -> Result<[u64; PARTS.len()], Error> {
    let image = Image::from_elf(Part::F446, elf).map_err(|error| Error::Image {
        program: PROGRAM,
        error,
    })?;
    let mut core = Mcu::new(Arc::new(image), &Board::default(), None);
    if !core.run_to(IDLE, BUDGET) {
        return Err(Error::NoStart { program: PROGRAM });
    }
    call(&mut core, function(elf, "prepare_start")?)?;
    let next = function(elf, "prepare_next")?;
    let mut longest = [0; PARTS.len()];
    for _ in 0..STEPS {
        call(&mut core, next)?;
        for ((part, name), longest) in PARTS.into_iter().zip(&mut longest) {
            let cycles = call(&mut core, function(elf, &format!("run_{name}"))?)?;
            if core.register(0) != 1 {
                return Err(Error::Idle { part: part.into() });
            }
            *longest = cycles.max(*longest);
        }
    }
    Ok(longest)
}

/// The costs as a table.
pub fn report(costs: &[Cost]) -> String {
    let mut text = format!(
        "Cycles of a step between two rows, opt-level 2: the longest of {STEPS} emulated ones without wait\nstates, its bound, and its bound with the wait states of the F303\n  {:<28}{:>8}{:>8}{:>8}{:>14}\n",
        "", "longest", "bound", "F303", "stack, bytes"
    );
    for cost in costs {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  {:<28}{:>8}{:>8}{:>8}{:>14}",
            cost.part, cost.seen, cost.bound.zero_wait, cost.bound.flashed, cost.stack
        );
    }
    text
}
