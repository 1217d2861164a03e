//! Where the execution time of a task goes.

use std::fmt::Write as _;

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
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{}.{} ({}): bound {} cycles at zero wait states, {} as flashed ({})",
        node.name,
        task.name,
        task.interrupt,
        task.cycles.zero_wait,
        task.cycles.flashed,
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
    if let Some(program) = task.program {
        let _ = writeln!(
            text,
            "  longest path of the integer program: {} and {} cycles",
            program.zero_wait, program.flashed
        );
    }
    if !task.path.is_empty() {
        text.push_str(&path(task));
    }
    for (place, bound) in &task.annotated {
        let _ = writeln!(text, "  loop bound {bound} from {place}");
    }
    for panic in &task.panics {
        let _ = writeln!(text, "  may panic: {panic}");
    }
    text
}

/// The source lines of the path; those beyond [`LINES`] in one row.
fn path(task: &TaskReport) -> String {
    let shown = task.path.iter().take(LINES);
    let shown = shown.map(|line| {
        [
            line.cycles.to_string(),
            line.times.to_string(),
            line.place.clone(),
        ]
    });
    let rest = task.path.get(LINES..).filter(|rest| !rest.is_empty());
    let rest = rest.map(|rest| {
        let cycles: u64 = rest.iter().map(|line| line.cycles).sum();
        let places = format!("in {} more places", rest.len());
        [cycles.to_string(), String::new(), places]
    });
    columns(
        [
            ("cycles", Right),
            ("times", Right),
            ("where (cycles as flashed, executions)", Left),
        ],
        shown.chain(rest).map(|cells| (true, cells)),
    )
}
