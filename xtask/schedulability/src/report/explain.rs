//! Where the execution time of a task goes.

use std::fmt::Write as _;

use wcet::ipet::Line;

use crate::results::{NodeReport, TaskReport};
use crate::units::time;

use super::columns::Align::{Left, Right};
use super::columns::columns;

/// Lines of the path that are shown.
const LINES: usize = 40;

/// The worst-case path of a task, the costliest source lines first, and the composition of
/// its response time.
#[must_use]
pub fn explain(node: &NodeReport, task: &TaskReport) -> String {
    let cycles = format!(
        "{} cycles by the emulator's model, {} as flashed",
        task.cycles.zero_wait, task.cycles.flashed
    );
    let program = task.program.map(|program| {
        let (zero, flashed) = (program.zero_wait, program.flashed);
        format!("{zero} and {flashed} cycles")
    });
    explained(node, task, &cycles, program)
}

/// The same, with the cycles as flashed only.
#[must_use]
pub fn explain_as_flashed(node: &NodeReport, task: &TaskReport) -> String {
    let cycles = |cycles: u64| format!("{cycles} cycles");
    let program = task.program.map(|program| cycles(program.flashed));
    explained(node, task, &cycles(task.cycles.flashed), program)
}

fn explained(
    node: &NodeReport,
    task: &TaskReport,
    cycles: &str,
    program: Option<String>,
) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{}.{} ({}): bound {cycles} ({})",
        node.name,
        task.name,
        task.interrupt,
        time(task.cost)
    );
    for problem in &task.problems {
        let _ = writeln!(text, "  ! no bound: {problem}");
    }
    if let Some(response) = task.response {
        let _ = writeln!(
            text,
            "  response {} of {}{}: {}",
            time(response),
            time(task.deadline),
            task.job
                .as_ref()
                .map_or_else(String::new, |job| format!(" ({job})")),
            task.composition()
        );
    }
    if let Some(program) = program {
        let _ = writeln!(text, "  longest path of the integer program: {program}");
    }
    if !task.path.is_empty() {
        text.push_str(&path(task));
    }
    for (place, bound) in &task.annotated {
        let _ = writeln!(text, "  loop bound {bound} from the annotation at {place}");
    }
    for (what, bound) in &task.summarised {
        let _ = writeln!(text, "  loop bound {bound} known of: {what}");
    }
    for panic in &task.panics {
        let _ = writeln!(text, "  may panic: {panic}");
    }
    text
}

/// The source lines of the path; those beyond [`LINES`] in one row. What is charged beside them follows,
/// so that the rows add up to the bound.
fn path(task: &TaskReport) -> String {
    let lines = task.path.iter().map(|line| {
        [
            line.cycles.to_string(),
            line.times.to_string(),
            line.place.clone(),
        ]
    });
    let in_all = |lines: &[Line]| lines.iter().map(|line| line.cycles).sum::<u64>();
    let row = |cycles: String, what: &str| [cycles, String::new(), what.to_owned()];
    let mut rows: Vec<_> = lines.take(LINES).collect();
    if let Some(rest) = task.path.get(LINES..).filter(|rest| !rest.is_empty()) {
        let places = format!("in {} more places", rest.len());
        rows.push(row(in_all(rest).to_string(), &places));
    }
    let overhead = task.overhead.flashed;
    rows.push(row(overhead.to_string(), "exception entry and return"));
    let bound = task.cycles.flashed.cast_signed();
    let left = bound - (in_all(&task.path) + overhead).cast_signed();
    if left != 0 {
        let what = if left < 0 {
            "less, because no single path takes all of these"
        } else {
            "rounding of the integer program"
        };
        rows.push(row(left.to_string(), what));
    }
    rows.push(row(bound.to_string(), "the bound"));
    columns(
        [
            ("cycles", Right),
            ("times", Right),
            ("where (cycles as flashed, executions)", Left),
        ],
        rows.into_iter().map(|cells| (true, cells)),
    )
}
