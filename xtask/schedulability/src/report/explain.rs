//! Where a task's longest time goes.

use std::fmt::Write as _;

use crate::results::{NodeReport, TaskReport, time};

/// Lines of the path that are shown.
const LINES: usize = 40;

/// The worst path of a task, the costliest source lines first, and what its
/// response consists of.
#[must_use]
pub fn explain(node: &NodeReport, task: &TaskReport) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{}.{} ({}): bound {} cycles at zero wait states, {} as flashed ({})",
        node.name,
        task.name,
        task.interrupt,
        task.cycles[0],
        task.cycles[1],
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
    if let Some([zero, flash]) = task.program {
        let _ = writeln!(
            text,
            "  longest path of the integer program: {zero} and {flash} cycles"
        );
    }
    if !task.path.is_empty() {
        let _ = writeln!(
            text,
            "  {:>9} {:>7}  where (cycles as flashed, executions)",
            "cycles", "times"
        );
    }
    for (cycles, times, place) in task.path.iter().take(LINES) {
        let _ = writeln!(text, "  {cycles:>9} {times:>7}  {place}");
    }
    if let Some(rest) = task.path.get(LINES..).filter(|rest| !rest.is_empty()) {
        let cycles: u64 = rest.iter().map(|(cycles, ..)| cycles).sum();
        let _ = writeln!(text, "  {cycles:>9}          in {} more places", rest.len());
    }
    for (place, bound) in &task.annotated {
        let _ = writeln!(text, "  loop bound {bound} from {place}");
    }
    for panic in &task.panics {
        let _ = writeln!(text, "  may panic: {panic}");
    }
    text
}
