//! The report as one page that loads nothing else.

use maud::{DOCTYPE, Markup, PreEscaped, html as markup};

use crate::results::{ChainReport, MessageReport, NodeReport, Report};
use crate::units::time;

use super::cells::{HEADINGS, LEGEND, or_dash, row};
use super::explain::explain;
use super::summary::{followed, left_out, verdict};
use super::timeline::timeline;

const STYLE: &str = "\
    body{font:14px/1.45 system-ui,sans-serif;margin:2em auto;padding:0 1em;max-width:90em;color:#222}\n\
    h1{font-size:1.5em}h2{font-size:1.15em;margin:1.6em 0 .3em}\n\
    table{border-collapse:collapse;margin:.4em 0 1em;font-variant-numeric:tabular-nums}\n\
    td,th{padding:.2em .7em;text-align:right;border-bottom:1px solid #ddd;white-space:nowrap}\n\
    td:first-child,th:first-child{text-align:left;position:sticky;left:0;background:inherit}\n\
    tr{background:#fff}tr.miss{background:#fbdcdc}\n\
    .good{background:#e3f4e1;padding:.5em}.miss{background:#fbdcdc}p.miss{padding:.5em}\n\
    .chart{background:#fafafa;border:1px solid #ddd}.scroll{overflow-x:auto}pre{overflow:auto}\n\
    @media(prefers-color-scheme:dark){body,tr{background:#111;color:#ddd}.miss,tr.miss{background:#522}\
    .good{background:#243}.chart{background:#1a1a1a}td,th{border-color:#444}svg text{fill:#ddd}}\n";

/// Tables, one basic cycle drawn for each node and the bus, and the worst-case path of each
/// task.
#[must_use]
pub fn html(report: &Report) -> String {
    let body = markup! {
        @let unbounded = report.unbounded();
        @if !unbounded.is_empty() {
            h2 { "Without a bound" }
            dl {
                @for (function, problems) in &unbounded {
                    dt { (function) }
                    @for (problem, whose) in problems {
                        dd.miss { (whose.join(", ")) ": " (problem.to_string()) }
                    }
                }
            }
        }
        (timeline(report))
        @for node in &report.nodes { (of_node(node)) }
        p { (LEGEND) }
        @if let Some(followed) = followed(report) { p { (followed) } }
        h2 { "Bus" }
        (bus(&report.messages))
        @if let Some(sentence) = left_out(report) { p { (sentence) } }
        @for chain in &report.chains { (of_chain(chain)) }
        h2 { "Assumptions" }
        ul { @for assumption in &report.assumptions { li { (assumption) } } }
    };
    page(
        "Schedulability",
        report.schedulable(),
        &verdict(report),
        &body,
    )
}

/// A page with its verdict on top.
pub(super) fn page(title: &str, is_good: bool, verdict: &str, body: &Markup) -> String {
    let class = if is_good { "good" } else { "miss" };
    let page = markup! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width";
                title { (title) }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (title) }
                p class=(class) { (verdict) }
                (body)
            }
        }
    };
    page.into_string()
}

/// A table; rows whose first part is false are marked.
pub(super) fn rows<const N: usize>(
    head: [&str; N],
    body: impl IntoIterator<Item = (bool, [String; N])>,
) -> Markup {
    markup! {
        div.scroll tabindex="0" { table {
            tr { @for heading in head { th { (heading) } } }
            @for (meets, cells) in body {
                tr class=[(!meets).then_some("miss")] { @for cell in cells { td { (cell) } } }
            }
        } }
    }
}

fn of_node(node: &NodeReport) -> Markup {
    let tasks = node
        .tasks
        .iter()
        .map(|task| (task.meets(), row(node, task)));
    markup! {
        h2 { (node.name) }
        p {
            "Processor " (format!("{:.1}", node.utilisation_permille as f64 / 10.0))
            " %, stack " (node.stack) " of " (node.stack_size) " bytes."
        }
        (rows(HEADINGS.map(|(heading, _)| heading), tasks))
        @for miss in node.tasks.iter().filter_map(|task| task.miss(&node.name)) {
            p.miss { (miss) }
        }
        @for problem in &node.idle_problems {
            p.miss { "Start-up and idle: " (problem.to_string()) }
        }
        @if !node.outside.is_empty() {
            p { "Handlers that are no task:" }
            ul { @for outside in &node.outside { li { (outside.sentence()) } } }
        }
        @if !node.stack_unknown.is_empty() {
            p { "The stack figure does not include:" }
            ul { @for unknown in &node.stack_unknown { li { (unknown) } } }
        }
        details {
            summary { "Worst-case paths" }
            pre { @for task in &node.tasks { (explain(node, task)) } }
        }
    }
}

fn bus(messages: &[MessageReport]) -> Markup {
    let messages = messages.iter().map(|message| {
        let cells = [
            message.name.clone(),
            message.id.to_string(),
            or_dash(message.start),
            or_dash(message.need),
            time(message.room),
            if message.arbitrating { "shared" } else { "own" }.to_owned(),
            message.tolerance.to_string(),
        ];
        (message.meets(), cells)
    });
    rows(
        [
            "message",
            "identifier",
            "window at",
            "needs",
            "has",
            "window",
            "tolerates",
        ],
        messages,
    )
}

fn of_chain(chain: &ChainReport) -> Markup {
    let steps = chain.steps.iter().map(|step| {
        let cells = [step.name.clone(), or_dash(step.done), or_dash(step.phase)];
        (step.done.is_some(), cells)
    });
    markup! {
        h2 { "End to end: " (chain.name) }
        p class=[(!chain.meets()).then_some("miss")] {
            (or_dash(chain.latency)) " of " (time(chain.deadline))
            @if let Some(lost) = &chain.lost {
                "; " (lost.clause()) ": " (or_dash(lost.latency)) " of " (time(lost.deadline))
            }
        }
        (rows(["step", "done after", "in the cycle at"], steps))
    }
}
