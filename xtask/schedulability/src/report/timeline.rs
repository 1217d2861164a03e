//! One basic cycle as a picture.

use std::fmt::Write as _;

use crate::results::{Picoseconds, Report, TaskReport, time};

use super::html::escape;

const LEFT: f64 = 170.0;
/// Wide enough to tell windows of a hundredth of the cycle apart; the page scrolls.
const WIDTH: f64 = 4000.0;
const ROW: f64 = 15.0;
/// Marks on the axis.
const PARTS: u64 = 50;
/// Releases of one task that are drawn.
const MOST: u64 = 250;

struct Chart {
    rows: String,
    y: f64,
    cycle: f64,
}

impl Chart {
    fn x(&self, at: Picoseconds) -> f64 {
        LEFT + WIDTH * at as f64 / self.cycle
    }

    fn label(&mut self, text: &str, bold: bool) {
        let _ = writeln!(
            self.rows,
            "<text x=\"4\" y=\"{:.0}\" font-size=\"11\"{}>{}</text>",
            self.y + 11.0,
            if bold { " font-weight=\"bold\"" } else { "" },
            escape(text)
        );
    }

    fn bar(&mut self, from: Picoseconds, to: Picoseconds, colour: &str, height: f64, what: &str) {
        let (left, right) = (self.x(from), self.x(to).min(LEFT + WIDTH));
        let _ = writeln!(
            self.rows,
            "<rect x=\"{left:.2}\" y=\"{:.1}\" width=\"{:.2}\" height=\"{height:.1}\" fill=\"{colour}\"><title>{}</title></rect>",
            self.y + (12.0 - height) / 2.0,
            (right - left).max(0.6),
            escape(what)
        );
    }

    fn task(&mut self, task: &TaskReport, cycle: Picoseconds) {
        self.label(&format!("  {}", task.name), false);
        let colour = if task.meets() { "#5a8f00" } else { "#dc322f" };
        let done = task.response.unwrap_or(task.cost);
        let what = format!(
            "{}: up to {}, done {} after its release",
            task.name,
            time(task.cost),
            time(done)
        );
        let mut releases = task.releases.clone();
        if releases.is_empty() {
            // No place in the cycle: shown as often as it may come.
            let every = task.period.max(1);
            releases.extend((0..MOST).map(|n| (n * every, n * every)));
            releases.retain(|(at, _)| *at < cycle);
        }
        for (earliest, latest) in releases {
            let first = earliest % cycle.max(1);
            let last = first + (latest - earliest);
            self.bar(first, last + done, "#8886", 4.0, &what);
            self.bar(last, last + task.cost, colour, 11.0, &what);
        }
        self.y += ROW;
    }
}

/// Windows and longest frames on the bus; for every task each release that it
/// may have in the cycle: from its earliest instant to its worst end (thin) and
/// its longest job at the latest release (thick).
pub(super) fn timeline(report: &Report) -> String {
    let cycle = report.basic_cycle.max(1);
    let mut chart = Chart {
        rows: String::new(),
        y: 20.0,
        cycle: cycle as f64,
    };
    chart.label("bus", true);
    for message in &report.messages {
        let what = format!(
            "{} at {}, needs {} of {}",
            message.name,
            time(message.start),
            message
                .need
                .map_or_else(|| "more than there is".to_owned(), time),
            time(message.room)
        );
        let colour = if message.arbitrating {
            "#b58900"
        } else {
            "#268bd2"
        };
        let end = message.start + message.room;
        chart.bar(message.start, end, "#8884", 12.0, &what);
        let need = message.need.unwrap_or(message.room).min(message.room);
        chart.bar(message.start, message.start + need, colour, 8.0, &what);
    }
    chart.y += ROW * 1.5;
    for node in &report.nodes {
        chart.label(&node.name, true);
        chart.y += ROW;
        for task in &node.tasks {
            chart.task(task, cycle);
        }
        chart.y += ROW / 2.0;
    }
    let bottom = chart.y;
    let mut axis = String::new();
    for part in 0..=PARTS {
        let instant = cycle / PARTS * part;
        let at = chart.x(instant);
        let _ = writeln!(
            axis,
            "<line x1=\"{at:.1}\" x2=\"{at:.1}\" y1=\"16\" y2=\"{bottom:.0}\" stroke=\"#8884\"/><text x=\"{at:.1}\" y=\"12\" font-size=\"10\" text-anchor=\"middle\">{} ms</text>",
            instant / 1_000_000_000
        );
    }
    format!(
        "<h2>One basic cycle</h2>\n<div class=\"scroll\"><svg class=\"chart\" width=\"{:.0}\" height=\"{:.0}\" role=\"img\" aria-label=\"timeline\">\n{axis}{}</svg></div>\n",
        LEFT + WIDTH + 40.0,
        bottom + 10.0,
        chart.rows
    )
}
