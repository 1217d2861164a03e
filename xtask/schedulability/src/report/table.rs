//! The table for a terminal.

use std::fmt::Write as _;

use crate::execution::picoseconds;
use crate::results::{NodeReport, Report, time};

use super::{HEADINGS, LEGEND, followed, or_dash, row, tightness, verdict};

/// Everything, as text.
#[must_use]
pub fn table(report: &Report) -> String {
    let mut text = String::new();
    for node in &report.nodes {
        of_node(&mut text, node);
    }
    bus(&mut text, report);
    chains(&mut text, report);
    let _ = writeln!(text, "assumptions");
    for assumption in &report.assumptions {
        let _ = writeln!(text, "  - {assumption}");
    }
    let _ = writeln!(text, "{LEGEND}");
    if let Some(tightness) = tightness(report) {
        let _ = writeln!(text, "{tightness}");
    }
    if let Some(followed) = followed(report) {
        let _ = writeln!(text, "{followed}");
    }
    let _ = writeln!(text, "{}", verdict(report));
    text
}

fn of_node(text: &mut String, node: &NodeReport) {
    let _ = writeln!(
        text,
        "{}: processor {:.1} %, stack {} of {} bytes",
        node.name,
        node.utilisation_permille as f64 / 10.0,
        node.stack,
        node.stack_size
    );
    let rows: Vec<(bool, [String; 13])> = node
        .tasks
        .iter()
        .map(|task| (task.meets(), row(task, |cycles| node.time(cycles))))
        .collect();
    let width = |column: usize| {
        let cells = rows.iter().map(|(_, row)| row[column].len());
        cells
            .chain([HEADINGS[column].len()])
            .max()
            .unwrap_or_default()
    };
    let widths: Vec<usize> = (0..HEADINGS.len()).map(width).collect();
    let mut line = |mark: &str, cells: &[&str]| {
        let _ = write!(text, "{mark}");
        for (column, (cell, width)) in cells.iter().zip(&widths).enumerate() {
            let _ = match column {
                0 | 2 => write!(text, " {cell:width$}"),
                _ => write!(text, " {cell:>width$}"),
            };
        }
        let end = text.trim_end().len();
        text.truncate(end);
        text.push('\n');
    };
    line(" ", &HEADINGS);
    for (meets, row) in &rows {
        let cells: Vec<&str> = row.iter().map(String::as_str).collect();
        line(if *meets { " " } else { "!" }, &cells);
    }
    for task in &node.tasks {
        if let Some(miss) = task.miss(&node.name) {
            let _ = writeln!(text, "  ! {miss}");
        }
    }
    for problem in &node.idle_problems {
        let _ = writeln!(text, "  ! start-up and idle: {problem}");
    }
    for unknown in &node.stack_unknown {
        let _ = writeln!(text, "  stack figure without: {unknown}");
    }
}

fn bus(text: &mut String, report: &Report) {
    let _ = writeln!(text, "bus");
    let _ = writeln!(
        text,
        "  {:20} {:>5} {:>11} {:>11} {:>11} {:>11}",
        "message", "id", "window at", "needs", "has", "left"
    );
    for message in &report.messages {
        let _ = writeln!(
            text,
            "{} {:20} {:>5} {:>11} {:>11} {:>11} {:>11}{}",
            if message.meets() { " " } else { "!" },
            message.name,
            message.id,
            time(message.start),
            or_dash(message.need),
            time(message.room),
            or_dash(message.need.and_then(|need| message.room.checked_sub(need))),
            if message.arbitrating { "  shared" } else { "" }
        );
    }
}

fn chains(text: &mut String, report: &Report) {
    for chain in &report.chains {
        let _ = writeln!(
            text,
            "{} chain {}: {} of {}",
            if chain.meets() { " " } else { "!" },
            chain.name,
            or_dash(chain.latency),
            time(chain.deadline)
        );
        for step in &chain.steps {
            let phase = step.phase.map_or_else(String::new, |phase| {
                format!("  at {} of the cycle", time(phase))
            });
            let _ = writeln!(
                text,
                "    {:36} done after {:>11}{phase}",
                step.name,
                or_dash(step.done)
            );
        }
    }
}

impl NodeReport {
    /// `cycles` of its core.
    #[must_use]
    pub fn time(&self, cycles: u64) -> u64 {
        picoseconds(cycles, self.core_hz)
    }
}
