//! The report for a terminal.

use std::fmt::Write as _;

use crate::results::{NodeReport, Report, unbounded};
use crate::units::time;

use super::cells::{HEADINGS, LEGEND, or_dash, row};
use super::columns::Align::{Left, Right};
use super::columns::columns;
use super::summary::{followed, left_out, tightness, verdict};

/// The whole report as text.
#[must_use]
pub fn table(report: &Report) -> String {
    let mut text = unbounded_of(&report.nodes);
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

/// Why code has no bound, by function; empty if all of it has one.
pub(super) fn unbounded_of(nodes: &[NodeReport]) -> String {
    let mut text = String::new();
    for (function, problems) in unbounded(nodes) {
        if text.is_empty() {
            text.push_str("without a bound\n");
        }
        let _ = writeln!(text, "  {function}");
        for (problem, whose) in problems {
            let _ = writeln!(text, "    ! {}: {problem}", whose.join(", "));
        }
    }
    text
}

/// The line above the table of a node's tasks.
pub(super) fn heading(text: &mut String, node: &NodeReport) {
    let _ = writeln!(
        text,
        "{}: processor {:.1} %, stack {} of {} bytes",
        node.name,
        node.utilisation_permille as f64 / 10.0,
        node.stack,
        node.stack_size
    );
}

fn of_node(text: &mut String, node: &NodeReport) {
    heading(text, node);
    let rows = node.tasks.iter();
    text.push_str(&columns(
        HEADINGS,
        rows.map(|task| (task.meets(), row(node, task))),
    ));
    after_table(text, node);
}

/// What follows the table of a node's tasks.
pub(super) fn after_table(text: &mut String, node: &NodeReport) {
    for task in &node.tasks {
        if let Some(miss) = task.miss(&node.name) {
            let _ = writeln!(text, "  ! {miss}");
        }
    }
    for problem in &node.idle_problems {
        let _ = writeln!(text, "  ! start-up and idle: {problem}");
    }
    for outside in &node.outside {
        let _ = writeln!(text, "  no task: {}", outside.sentence());
    }
    if node.outside.len() > 1 {
        let _ = writeln!(
            text,
            "  of these, the stack figure includes one: whichever comes first ends the program"
        );
    }
    for unknown in &node.stack_unknown {
        let _ = writeln!(text, "  stack figure without: {unknown}");
    }
}

fn bus(text: &mut String, report: &Report) {
    let _ = writeln!(text, "bus");
    let rows = report.messages.iter().map(|message| {
        let left = message.need.and_then(|need| message.room.checked_sub(need));
        let cells = [
            message.name.clone(),
            message.id.to_string(),
            or_dash(message.start),
            or_dash(message.need),
            time(message.room),
            or_dash(left),
            if message.arbitrating { "shared" } else { "" }.to_owned(),
            message.tolerance.to_string(),
        ];
        (message.meets(), cells)
    });
    text.push_str(&columns(
        [
            ("message", Left),
            ("id", Right),
            ("window at", Right),
            ("needs", Right),
            ("has", Right),
            ("left", Right),
            ("", Left),
            ("tolerates", Left),
        ],
        rows,
    ));
    if let Some(sentence) = left_out(report) {
        let _ = writeln!(text, "  {sentence}");
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
        if let Some(lost) = &chain.lost {
            let _ = writeln!(
                text,
                "    {}: {} of {}",
                lost.clause(),
                or_dash(lost.latency),
                time(lost.deadline)
            );
        }
        let rows = chain.steps.iter().map(|step| {
            let cells = [step.name.clone(), or_dash(step.done), or_dash(step.phase)];
            (step.done.is_some(), cells)
        });
        text.push_str(&columns(
            [
                ("step", Left),
                ("done after", Right),
                ("in the cycle at", Right),
            ],
            rows,
        ));
    }
}
