//! The answers for people, for programs and for a browser.

use std::fmt::Write as _;

use serde_json::{Value, json};

use crate::system::{NodeReport, Report, TaskReport, time};

fn or_dash(value: Option<u64>) -> String {
    value.map_or_else(|| "-".to_owned(), time)
}

fn ratio(task: &TaskReport) -> String {
    match task.observed {
        Some(seen) if seen > 0 => format!("{:.2}", task.cycles[0] as f64 / seen as f64),
        _ => "-".to_owned(),
    }
}

/// The table for a terminal.
#[must_use]
pub fn table(report: &Report) -> String {
    let mut text = String::new();
    for node in &report.nodes {
        let _ = writeln!(
            text,
            "{}: processor {:.1} %, stack {} of {} bytes",
            node.name,
            node.utilisation_permille as f64 / 10.0,
            node.stack,
            node.stack_size
        );
        let _ = writeln!(
            text,
            "  {:14} {:>2} {:>9} {:>9} {:>5} {:>11} {:>11} {:>11} {:>11} {:>11} {:>11}",
            "task",
            "p",
            "bound cyc",
            "seen cyc",
            "ratio",
            "as flashed",
            "every",
            "blocked",
            "response",
            "deadline",
            "may grow by"
        );
        for task in &node.tasks {
            let _ = writeln!(
                text,
                "{} {:14} {:>2} {:>9} {:>9} {:>5} {:>11} {:>11} {:>11} {:>11} {:>11} {:>11}",
                if task.meets() { " " } else { "!" },
                task.name,
                task.priority,
                task.cycles[0],
                task.observed
                    .map_or_else(|| "-".to_owned(), |seen| seen.to_string()),
                ratio(task),
                time(task.cost),
                time(task.period),
                time(task.blocking),
                or_dash(task.response),
                time(task.deadline),
                or_dash(task.slack),
            );
        }
        let mut problems: Vec<String> = node
            .tasks
            .iter()
            .flat_map(|task| &task.problems)
            .map(ToString::to_string)
            .collect();
        problems.sort();
        problems.dedup();
        for problem in problems {
            let _ = writeln!(text, "  ! {problem}");
        }
        for unknown in &node.stack_unknown {
            let _ = writeln!(text, "  stack figure without: {unknown}");
        }
        let mut panics: Vec<&String> = node.tasks.iter().flat_map(|task| &task.panics).collect();
        panics.sort();
        panics.dedup();
        if !panics.is_empty() {
            let _ = writeln!(
                text,
                "  {} panics are not proven impossible; their paths count up to the panic",
                panics.len()
            );
        }
    }
    let _ = writeln!(text, "bus");
    let _ = writeln!(
        text,
        "  {:20} {:>5} {:>11} {:>11} {:>11}",
        "message", "id", "window at", "needs", "has"
    );
    for message in &report.messages {
        let _ = writeln!(
            text,
            "{} {:20} {:>5} {:>11} {:>11} {:>11}",
            if message.meets() { " " } else { "!" },
            message.name,
            message.id,
            time(message.start),
            time(message.need),
            time(message.room)
        );
    }
    for chain in &report.chains {
        let _ = writeln!(
            text,
            "{} chain {}: {} of {}",
            if chain.meets() { " " } else { "!" },
            chain.name,
            or_dash(chain.latency),
            time(chain.deadline)
        );
        for (step, at) in &chain.steps {
            let _ = writeln!(text, "    {step:28} {:>11}", time(*at));
        }
    }
    let _ = match report.first_miss() {
        None => writeln!(text, "schedulable: every deadline holds"),
        Some(miss) => writeln!(text, "not schedulable: {miss}"),
    };
    text
}

/// The worst path of a task, the costliest source lines first.
#[must_use]
pub fn explain(node: &NodeReport, task: &TaskReport) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{}.{} ({}): {} cycles at zero wait states, {} as flashed",
        node.name, task.name, task.interrupt, task.cycles[0], task.cycles[1]
    );
    for problem in &task.problems {
        let _ = writeln!(text, "  ! {problem}");
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
    for (cycles, times, place) in &task.path {
        let _ = writeln!(text, "  {cycles:>9} {times:>7}  {place}");
    }
    for (place, bound) in &task.annotated {
        let _ = writeln!(text, "  loop bound {bound} from {place}");
    }
    for panic in &task.panics {
        let _ = writeln!(text, "  may panic: {panic}");
    }
    text
}

/// Everything for programs; times in picoseconds.
#[must_use]
pub fn json(report: &Report) -> Value {
    json!({
        "schedulable": report.schedulable(),
        "first_miss": report.first_miss(),
        "basic_cycle_ps": report.basic_cycle,
        "nodes": report.nodes.iter().map(|node| json!({
            "name": node.name,
            "stack_bytes": node.stack,
            "stack_size_bytes": node.stack_size,
            "stack_unknown": node.stack_unknown,
            "utilisation_permille": node.utilisation_permille,
            "tasks": node.tasks.iter().map(|task| json!({
                "name": task.name,
                "interrupt": task.interrupt,
                "priority": task.priority,
                "bound_cycles": task.cycles[0],
                "bound_cycles_flash": task.cycles[1],
                "program_cycles": task.program,
                "observed_cycles": task.observed,
                "cost_ps": task.cost,
                "period_ps": task.period,
                "deadline_ps": task.deadline,
                "blocking_ps": task.blocking,
                "response_ps": task.response,
                "slack_ps": task.slack,
                "meets": task.meets(),
                "problems": task.problems.iter().map(ToString::to_string).collect::<Vec<_>>(),
                "panics": task.panics,
                "annotated": task.annotated,
            })).collect::<Vec<_>>(),
        })).collect::<Vec<_>>(),
        "messages": report.messages.iter().map(|message| json!({
            "name": message.name,
            "id": message.id,
            "start_ps": message.start,
            "need_ps": message.need,
            "room_ps": message.room,
            "arbitrating": message.arbitrating,
            "meets": message.meets(),
        })).collect::<Vec<_>>(),
        "chains": report.chains.iter().map(|chain| json!({
            "name": chain.name,
            "latency_ps": chain.latency,
            "deadline_ps": chain.deadline,
            "steps": chain.steps.iter().map(|(step, at)| json!({"step": step, "at_ps": at})).collect::<Vec<_>>(),
            "meets": chain.meets(),
        })).collect::<Vec<_>>(),
    })
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
}

/// A page that needs nothing else: tables, and one basic cycle drawn for each
/// node and the bus.
#[must_use]
pub fn html(report: &Report) -> String {
    let mut page = String::from(
        "<!doctype html>\n<html lang=\"en\"><meta charset=\"utf-8\">\n<title>Schedulability</title>\n<style>\n\
         body{font:14px/1.4 system-ui,sans-serif;margin:2em;max-width:80em}\n\
         table{border-collapse:collapse;margin:.5em 0 1.5em}\n\
         td,th{padding:.2em .7em;text-align:right;border-bottom:1px solid #ddd}\n\
         td:first-child,th:first-child{text-align:left}\n\
         .miss{background:#fdd}\n.chart{background:#fafafa;border:1px solid #ddd}\n\
         @media(prefers-color-scheme:dark){body{background:#111;color:#ddd}.miss{background:#522}.chart{background:#1a1a1a}td,th{border-color:#444}text{fill:#ddd}}\n\
         </style>\n<h1>Schedulability</h1>\n",
    );
    let _ = match report.first_miss() {
        None => writeln!(page, "<p>Schedulable: every deadline holds.</p>"),
        Some(miss) => writeln!(
            page,
            "<p class=\"miss\">Not schedulable: {}</p>",
            escape(&miss)
        ),
    };
    page.push_str(&timeline(report));
    for node in &report.nodes {
        let _ = writeln!(
            page,
            "<h2>{}</h2>\n<p>Processor {:.1} %, stack {} of {} bytes.</p>\n<table><tr><th>task<th>priority<th>bound, cycles<th>seen, cycles<th>ratio<th>as flashed<th>every<th>blocked<th>response<th>deadline<th>may grow by</tr>",
            escape(&node.name),
            node.utilisation_permille as f64 / 10.0,
            node.stack,
            node.stack_size
        );
        for task in &node.tasks {
            let _ = writeln!(
                page,
                "<tr{}><td>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}<td>{}</tr>",
                if task.meets() { "" } else { " class=\"miss\"" },
                escape(&task.name),
                task.priority,
                task.cycles[0],
                task.observed
                    .map_or_else(|| "-".to_owned(), |seen| seen.to_string()),
                ratio(task),
                time(task.cost),
                time(task.period),
                time(task.blocking),
                or_dash(task.response),
                time(task.deadline),
                or_dash(task.slack),
            );
        }
        page.push_str("</table>\n");
        for problem in node.tasks.iter().flat_map(|task| &task.problems) {
            let _ = writeln!(
                page,
                "<p class=\"miss\">{}</p>",
                escape(&problem.to_string())
            );
        }
    }
    page.push_str(
        "<h2>Bus</h2>\n<table><tr><th>message<th>identifier<th>window at<th>needs<th>has</tr>\n",
    );
    for message in &report.messages {
        let _ = writeln!(
            page,
            "<tr{}><td>{}<td>{}<td>{}<td>{}<td>{}</tr>",
            if message.meets() {
                ""
            } else {
                " class=\"miss\""
            },
            escape(&message.name),
            message.id,
            time(message.start),
            time(message.need),
            time(message.room)
        );
    }
    page.push_str("</table>\n");
    for chain in &report.chains {
        let _ = writeln!(
            page,
            "<h2>{}</h2>\n<p{}>{} of {}</p>\n<table><tr><th>step<th>done by</tr>",
            escape(&chain.name),
            if chain.meets() { "" } else { " class=\"miss\"" },
            or_dash(chain.latency),
            time(chain.deadline)
        );
        for (step, at) in &chain.steps {
            let _ = writeln!(page, "<tr><td>{}<td>{}</tr>", escape(step), time(*at));
        }
        page.push_str("</table>\n");
    }
    page.push_str("</html>\n");
    page
}

/// One basic cycle: windows on the bus, and for every task its longest job at
/// each release it may have in the cycle, the first at the cycle's start.
fn timeline(report: &Report) -> String {
    const LEFT: f64 = 170.0;
    const WIDTH: f64 = 1000.0;
    const ROW: f64 = 16.0;
    const MOST: u64 = 400;
    let cycle = report.basic_cycle.max(1) as f64;
    let x = |ps: u64| LEFT + WIDTH * ps as f64 / cycle;
    let mut rows = String::new();
    let mut y = 20.0;
    let label = |rows: &mut String, y: f64, text: &str, bold: bool| {
        let _ = writeln!(
            rows,
            "<text x=\"4\" y=\"{:.0}\" font-size=\"11\"{}>{}</text>",
            y + 11.0,
            if bold { " font-weight=\"bold\"" } else { "" },
            escape(text)
        );
    };
    label(&mut rows, y, "bus", true);
    for message in &report.messages {
        let _ = writeln!(
            rows,
            "<rect x=\"{:.2}\" y=\"{y:.0}\" width=\"{:.2}\" height=\"12\" fill=\"{}\"><title>{} at {}, needs {} of {}</title></rect>",
            x(message.start),
            (x(message.start + message.need.min(message.room)) - x(message.start)).max(1.0),
            if message.arbitrating {
                "#b58900"
            } else {
                "#268bd2"
            },
            escape(&message.name),
            time(message.start),
            time(message.need),
            time(message.room)
        );
    }
    y += ROW * 1.5;
    for node in &report.nodes {
        label(&mut rows, y, &node.name, true);
        y += ROW;
        for task in &node.tasks {
            label(&mut rows, y, &format!("  {}", task.name), false);
            let mut release = 0;
            let mut drawn = 0;
            while release < report.basic_cycle && drawn < MOST {
                let _ = writeln!(
                    rows,
                    "<rect x=\"{:.2}\" y=\"{y:.0}\" width=\"{:.2}\" height=\"12\" fill=\"{}\"><title>{}: up to {} every {}</title></rect>",
                    x(release),
                    (x(release + task.cost) - x(release)).max(0.5),
                    if task.meets() { "#859900" } else { "#dc322f" },
                    escape(&task.name),
                    time(task.cost),
                    time(task.period)
                );
                release += task.period.max(1);
                drawn += 1;
            }
            y += ROW;
        }
        y += ROW / 2.0;
    }
    let mut axis = String::new();
    for tenth in 0..=10 {
        let at = LEFT + WIDTH * f64::from(tenth) / 10.0;
        let _ = writeln!(
            axis,
            "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"16\" y2=\"{y:.0}\" stroke=\"#8884\"/><text x=\"{at:.1}\" y=\"12\" font-size=\"10\" text-anchor=\"middle\">{}</text>",
            time((cycle * f64::from(tenth) / 10.0) as u64)
        );
    }
    format!(
        "<h2>One basic cycle</h2>\n<svg class=\"chart\" viewBox=\"0 0 {:.0} {:.0}\" width=\"100%\" role=\"img\" aria-label=\"timeline\">\n{axis}{rows}</svg>\n",
        LEFT + WIDTH + 40.0,
        y + 10.0
    )
}
