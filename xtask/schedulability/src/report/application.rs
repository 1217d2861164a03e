//! The report of one application without a bus: as text for a terminal and as a page for a browser.

use std::fmt::Write as _;

use maud::{Markup, html as markup};

use crate::results::{NodeReport, TaskReport};

use super::cells::{HEADINGS, row};
use super::columns::{Align, columns};
use super::explain::explain_as_flashed;
use super::html::{page, rows};
use super::table::{after_table, heading, unbounded_of};

/// What the columns mean.
const LEGEND: &str = "every: least time between two releases, or how many may come at once; bound: WCET as flashed; \
    blocked: longest critical section of a lower priority; response: worst-case response time; \
    may grow: by how much the WCET may grow before a task misses its deadline.";

/// Columns of the usual table that an application has: of its observations only one, and none without any.
const COLUMNS: [usize; 10] = [0, 1, 2, 3, 4, 8, 9, 10, 11, 12];
/// The column of observations.
const SEEN: usize = 5;

/// The answer in one line.
#[must_use]
pub fn verdict(node: &NodeReport) -> String {
    match node.first_miss() {
        None => "schedulable: every deadline holds".to_owned(),
        Some(miss) => format!("not schedulable: {miss}"),
    }
}

/// The whole report as text.
#[must_use]
pub fn text(node: &NodeReport, assumptions: &[String]) -> String {
    let mut text = unbounded_of(std::slice::from_ref(node));
    heading(&mut text, node);
    text.push_str(&if is_observed(node) {
        columns(
            with_seen(HEADINGS),
            lines(node).map(|(meets, all)| (meets, with_seen(all))),
        )
    } else {
        columns(
            without_seen(HEADINGS),
            lines(node).map(|(meets, all)| (meets, without_seen(all))),
        )
    });
    after_table(&mut text, node);
    let _ = writeln!(text, "assumptions");
    for assumption in assumptions {
        let _ = writeln!(text, "  - {assumption}");
    }
    let _ = writeln!(text, "{LEGEND}");
    let _ = writeln!(text, "{}", verdict(node));
    text
}

/// The whole report as a page that loads nothing else.
#[must_use]
pub fn html(node: &NodeReport, assumptions: &[String]) -> String {
    let headings = |headings: [(&'static str, Align); 11]| headings.map(|(heading, _)| heading);
    let table = rows(
        headings(with_seen(HEADINGS)),
        lines(node).map(|(meets, all)| (meets, with_seen(all))),
    );
    let body = markup! {
        h2 { (node.name) }
        p {
            "Processor " (format!("{:.1}", node.utilisation_permille as f64 / 10.0))
            " %, stack " (node.stack) " of " (node.stack_size) " bytes."
        }
        (table)
        @for miss in node.tasks.iter().filter_map(|task| task.miss(&node.name)) {
            p.miss { (miss) }
        }
        @for problem in &node.idle_problems {
            p.miss { "Start-up and idle: " (problem.to_string()) }
        }
        p { (LEGEND) }
        details {
            summary { "Worst-case paths" }
            pre { @for task in &node.tasks { (explain_as_flashed(node, task)) } }
        }
        (list("Handlers that are no task", node.outside.iter().map(|one| one.sentence())))
        (list("Assumptions", assumptions.iter().cloned()))
    };
    page(
        "Deadlines",
        node.first_miss().is_none(),
        &verdict(node),
        &body,
    )
}

fn list(heading: &str, all: impl Iterator<Item = String>) -> Markup {
    markup! { h2 { (heading) } ul { @for one in all { li { (one) } } } }
}

fn is_observed(node: &NodeReport) -> bool {
    node.tasks
        .iter()
        .any(|task: &TaskReport| task.observed.is_some())
}

fn lines(node: &NodeReport) -> impl Iterator<Item = (bool, [String; 13])> {
    let tasks = node.tasks.iter();
    tasks.map(move |task| (task.meets(), row(node, task)))
}

fn without_seen<T: Clone>(all: [T; 13]) -> [T; 10] {
    COLUMNS.map(|at| all[at].clone())
}

fn with_seen<T: Clone>(all: [T; 13]) -> [T; 11] {
    std::array::from_fn(|at| {
        let at = match at {
            0..SEEN => COLUMNS[at],
            SEEN => SEEN,
            _ => COLUMNS[at - 1],
        };
        all[at].clone()
    })
}
