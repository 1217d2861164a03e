//! A page that needs nothing else.

use std::fmt::Write as _;

use crate::results::{NodeReport, Report, time};

use super::timeline::timeline;
use super::{HEADINGS, LEGEND, explain, followed, or_dash, row, verdict};

pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

const HEAD: &str = "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\">\n\
    <meta name=\"viewport\" content=\"width=device-width\">\n<title>Schedulability</title>\n<style>\n\
    body{font:14px/1.45 system-ui,sans-serif;margin:2em auto;padding:0 1em;max-width:90em;color:#222}\n\
    h1{font-size:1.5em}h2{font-size:1.15em;margin:1.6em 0 .3em}\n\
    table{border-collapse:collapse;margin:.4em 0 1em;font-variant-numeric:tabular-nums}\n\
    td,th{padding:.2em .7em;text-align:right;border-bottom:1px solid #ddd;white-space:nowrap}\n\
    td:first-child,th:first-child{text-align:left}\n\
    .good{background:#e3f4e1;padding:.5em}.miss{background:#fbdcdc}p.miss{padding:.5em}\n\
    .chart{background:#fafafa;border:1px solid #ddd}.scroll{overflow-x:auto}pre{overflow:auto}\n\
    @media(prefers-color-scheme:dark){body{background:#111;color:#ddd}.miss{background:#522}\
    .good{background:#243}.chart{background:#1a1a1a}td,th{border-color:#444}svg text{fill:#ddd}}\n\
    </style>\n<h1>Schedulability</h1>\n";

/// Tables, one basic cycle drawn for each node and the bus, and the worst path
/// of each task.
#[must_use]
pub fn html(report: &Report) -> String {
    let mut page = HEAD.to_owned();
    let class = if report.schedulable() { "good" } else { "miss" };
    let _ = writeln!(
        page,
        "<p class=\"{class}\">{}</p>",
        escape(&verdict(report))
    );
    page.push_str(&timeline(report));
    for node in &report.nodes {
        of_node(&mut page, node);
    }
    let _ = writeln!(page, "<p>{}</p>", escape(LEGEND));
    if let Some(followed) = followed(report) {
        let _ = writeln!(page, "<p>{}</p>", escape(&followed));
    }
    bus(&mut page, report);
    chains(&mut page, report);
    page.push_str("<h2>Assumptions</h2>\n<ul>\n");
    for assumption in &report.assumptions {
        let _ = writeln!(page, "<li>{}", escape(assumption));
    }
    page.push_str("</ul>\n</html>\n");
    page
}

fn rows<const N: usize>(
    page: &mut String,
    head: [&str; N],
    body: impl IntoIterator<Item = (bool, [String; N])>,
) {
    page.push_str("<table><tr>");
    for heading in head {
        let _ = write!(page, "<th>{}", escape(heading));
    }
    page.push_str("</tr>\n");
    for (meets, cells) in body {
        page.push_str(if meets { "<tr>" } else { "<tr class=\"miss\">" });
        for cell in cells {
            let _ = write!(page, "<td>{}", escape(&cell));
        }
        page.push_str("</tr>\n");
    }
    page.push_str("</table>\n");
}

fn of_node(page: &mut String, node: &NodeReport) {
    let _ = writeln!(
        page,
        "<h2>{}</h2>\n<p>Processor {:.1} %, stack {} of {} bytes.</p>",
        escape(&node.name),
        node.utilisation_permille as f64 / 10.0,
        node.stack,
        node.stack_size
    );
    let tasks = node.tasks.iter();
    rows(
        page,
        HEADINGS,
        tasks.map(|task| (task.meets(), row(task, |cycles| node.time(cycles)))),
    );
    for miss in node.tasks.iter().filter_map(|task| task.miss(&node.name)) {
        let _ = writeln!(page, "<p class=\"miss\">{}</p>", escape(&miss));
    }
    for problem in &node.idle_problems {
        let _ = writeln!(
            page,
            "<p class=\"miss\">Start-up and idle: {}</p>",
            escape(&problem.to_string())
        );
    }
    if !node.stack_unknown.is_empty() {
        page.push_str("<p>The stack figure is without:</p>\n<ul>\n");
        for unknown in &node.stack_unknown {
            let _ = writeln!(page, "<li>{}", escape(unknown));
        }
        page.push_str("</ul>\n");
    }
    page.push_str("<details><summary>Worst paths</summary>\n<pre>");
    for task in &node.tasks {
        page.push_str(&escape(&explain(node, task)));
    }
    page.push_str("</pre></details>\n");
}

fn bus(page: &mut String, report: &Report) {
    page.push_str("<h2>Bus</h2>\n");
    let messages = report.messages.iter().map(|message| {
        let cells = [
            message.name.clone(),
            message.id.to_string(),
            time(message.start),
            or_dash(message.need),
            time(message.room),
            if message.arbitrating { "shared" } else { "own" }.to_owned(),
        ];
        (message.meets(), cells)
    });
    rows(
        page,
        [
            "message",
            "identifier",
            "window at",
            "needs",
            "has",
            "window",
        ],
        messages,
    );
}

fn chains(page: &mut String, report: &Report) {
    for chain in &report.chains {
        let _ = writeln!(
            page,
            "<h2>From end to end: {}</h2>\n<p{}>{} of {}</p>",
            escape(&chain.name),
            if chain.meets() { "" } else { " class=\"miss\"" },
            or_dash(chain.latency),
            time(chain.deadline)
        );
        let steps = chain.steps.iter().map(|step| {
            let cells = [step.name.clone(), or_dash(step.done), or_dash(step.phase)];
            (step.done.is_some(), cells)
        });
        rows(page, ["step", "done after", "in the cycle at"], steps);
    }
}
