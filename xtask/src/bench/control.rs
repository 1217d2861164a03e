//! Cycles of the control step and its parts on an emulated core, and their bounds.

use std::{fmt::Write, sync::Arc};

use schedulability::board;
use twin::{
    image::Image,
    mcu::{Board, FlashTiming, Mcu},
    part::Part,
};
use wcet::{
    analysis::Analysis,
    annotation::Annotations,
    bound::Entry,
    cycles::{Cycles, Model},
    register::Register,
};

use super::{
    Builder, CONTROL, Error, Parts, Profile,
    cycles::{BUDGET, IDLE, PLACE, call, function},
};
use crate::Failure;

/// The cost of a part of the step, without wait states and as flashed on the F446.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Cost {
    /// The part.
    pub part: &'static str,
    /// Cycles while the vehicle approaches the line.
    pub coming: Cycles,
    /// Cycles while it follows the line.
    pub there: Option<Cycles>,
    /// Most cycles, but for parts that iterate.
    pub bound: Option<Cycles>,
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

/// Measures and bounds the parts.
///
/// # Errors
///
/// The program does not build, or a part did not do its work, has no bound, or took longer than
/// its bound says.
pub fn measure(builder: &Builder) -> Result<Vec<Cost>, Failure> {
    let parts = Parts {
        name: "control step",
        features: "",
    };
    let path = builder.file(CONTROL, "step", parts, Profile::Release)?;
    let elf = std::fs::read(&path).map_err(crate::ReadError::of(&path))?;
    let image = Image::from_elf(Part::F446, &elf).map_err(|error| Error::Image {
        program: PROGRAM,
        error,
    })?;
    let image = Arc::new(image);
    let analysed = wcet::image::Image::read(&path).map_err(super::kernels::Error::from);
    let analysed = analysed.map_err(Error::from)?;
    let annotations = Annotations::new(builder.workspace.root());
    let board = board::part(::parts::Sled::F446);
    let mut analysis = Analysis::new(&analysed, &annotations, &board);
    let mut costs = Vec::new();
    for (part, name, both) in PARTS {
        let run = |prepare: &str| -> Result<Cycles, Error> {
            let seen = |timing| cost(&image, &elf, [prepare, name], part, timing);
            Ok(Cycles {
                zero_wait: seen(FlashTiming::Immediate)?,
                flashed: seen(FlashTiming::WaitStates)?,
            })
        };
        let entry = function(&elf, &format!("run_{name}"))? & !1;
        let bound = if both {
            let bound = analysis.run_with(entry, Entry::Function, &[(Register::R0, PLACE)]);
            if let Some(problem) = bound.problems.first() {
                let problem = problem.to_string();
                return Err(Error::NoBound {
                    part: part.into(),
                    problem,
                }
                .into());
            }
            Some(bound.cycles)
        } else {
            None
        };
        let cost = Cost {
            part,
            coming: run(if both { "coming" } else { "mpc" })?,
            there: if both { Some(run("there")?) } else { None },
            bound,
        };
        if cost.exceeds_its_bound() {
            return Err(Error::Unsound { part: part.into() }.into());
        }
        costs.push(cost);
    }
    Ok(costs)
}

impl Cost {
    fn exceeds_its_bound(&self) -> bool {
        let seen = [Some(self.coming), self.there];
        self.bound.is_some_and(|bound| {
            let above = |seen: Cycles| Model::ALL.iter().any(|it| seen[*it] > bound[*it]);
            seen.into_iter().flatten().any(above)
        })
    }
}

/// Cycles of a call of `run_` and the second name after one of `prepare_` and the first.
fn cost(
    image: &Arc<Image>,
    elf: &[u8],
    [prepare, name]: [&str; 2],
    part: &str,
    flash: FlashTiming,
) -> Result<u64, Error> {
    let board = Board {
        flash,
        ..Board::default()
    };
    let mut core = Mcu::new(Arc::clone(image), &board, None);
    if !core.run_to(IDLE, BUDGET) {
        return Err(Error::NoStart { program: PROGRAM });
    }
    call(&mut core, function(elf, &format!("prepare_{prepare}"))?)?;
    let cycles = call(&mut core, function(elf, &format!("run_{name}"))?)?;
    if core.register(0) == 1 {
        Ok(cycles)
    } else {
        Err(Error::Idle { part: part.into() })
    }
}

/// The costs as a table.
pub fn report(costs: &[Cost]) -> String {
    let mut text = format!(
        "Cycles of a control step on a Cortex-M4, opt-level 2: without wait states, and as flashed on the\nF446\n  {:<28}{:>14}{:>14}{:>14}\n",
        "", "coming", "on the line", "bound"
    );
    let both = |cycles: Option<Cycles>| {
        cycles.map_or_else(
            || "-".into(),
            |it| format!("{} {:>6}", it.zero_wait, it.flashed),
        )
    };
    for cost in costs {
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "  {:<28}{:>14}{:>14}{:>14}",
            cost.part,
            both(Some(cost.coming)),
            both(cost.there),
            both(cost.bound)
        );
    }
    text
}
