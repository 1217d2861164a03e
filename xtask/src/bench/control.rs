//! Cycles of the control step and its parts on an emulated core.

use std::{fmt::Write, sync::Arc};

use twin::{
    image::Image,
    mcu::{Board, Mcu},
    part::Part,
};

use super::{
    Builder, CONTROL, Error, Parts, Profile,
    cycles::{BUDGET, IDLE, call, function},
};
use crate::Failure;

/// The cost of a part of the step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cost {
    /// The part.
    pub part: &'static str,
    /// Cycles while the vehicle approaches the line.
    pub coming: u64,
    /// Cycles while it follows the line.
    pub there: Option<u64>,
}

/// The program that is measured.
const PROGRAM: &str = "the control step's program";

/// Parts, what their functions' names end with, and whether they are measured on the line too.
const PARTS: [(&str, &str, bool); 6] = [
    ("control step", "step", true),
    ("  estimator", "estimator", true),
    ("  guidance, with schedule", "guidance", true),
    ("  safety filter", "safety", true),
    ("the thesis's law", "plain", true),
    ("predictive, 30 iterations", "mpc", false),
];

/// Measures the parts.
///
/// # Errors
///
/// The program does not build, or a part did not do its work.
pub fn measure(builder: &Builder) -> Result<Vec<Cost>, Failure> {
    let parts = Parts {
        name: "control step",
        features: "",
    };
    let elf = builder.build(CONTROL, "step", parts, Profile::Release)?;
    let image = Image::from_elf(Part::F446, &elf).map_err(|error| Error::Image {
        program: PROGRAM,
        error,
    })?;
    let image = Arc::new(image);
    let cost = |prepare: &str, part: &str| -> Result<u64, Error> {
        let mut core = Mcu::new(Arc::clone(&image), &Board::default(), None);
        if !core.run_to(IDLE, BUDGET) {
            return Err(Error::NoStart { program: PROGRAM });
        }
        call(&mut core, function(&elf, &format!("prepare_{prepare}"))?)?;
        let cycles = call(&mut core, function(&elf, &format!("run_{part}"))?)?;
        if core.register(0) == 1 {
            Ok(cycles)
        } else {
            Err(Error::Idle { part: part.into() })
        }
    };
    PARTS
        .into_iter()
        .map(|(part, name, both)| {
            Ok(Cost {
                part,
                coming: cost(if both { "coming" } else { "mpc" }, name)?,
                there: if both {
                    Some(cost("there", name)?)
                } else {
                    None
                },
            })
        })
        .collect()
}

/// The costs as a table.
pub fn report(costs: &[Cost]) -> String {
    let mut text = format!(
        "Cycles of a control step on a Cortex-M4 without wait states, opt-level 2\n  {:<28}{:>12}{:>14}\n",
        "", "coming", "on the line"
    );
    for cost in costs {
        let there = cost
            .there
            .map_or_else(|| "-".into(), |cycles| cycles.to_string());
        // Writing to a string cannot fail.
        let _ = writeln!(text, "  {:<28}{:>12}{:>14}", cost.part, cost.coming, there);
    }
    text
}
