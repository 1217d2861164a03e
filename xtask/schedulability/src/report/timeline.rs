//! One basic cycle as a picture.

use maud::{Markup, html};

use crate::results::{MessageReport, Report, TaskReport};
use crate::units::{Picoseconds, time};

/// Width of the labels.
const LEFT: f64 = 170.0;
/// Width of the cycle. Windows of a hundredth of it can be told apart; the page scrolls.
const WIDTH: f64 = 4000.0;
/// Height of a row.
const ROW: f64 = 15.0;
/// Parts into which the axis is divided.
const PARTS: u64 = 50;
/// Most releases of one task that are drawn.
const MOST: u64 = 250;

/// The picture so far.
struct Chart {
    shapes: Vec<Markup>,
    /// Top of the current row.
    y: f64,
    /// Length of the cycle.
    cycle: f64,
}

impl Chart {
    fn x(&self, at: Picoseconds) -> f64 {
        LEFT + WIDTH * at as f64 / self.cycle
    }

    fn label(&mut self, text: &str, bold: bool) {
        self.shapes.push(html! {
            text x="4" y=(format!("{:.0}", self.y + 11.0)) font-size="11"
                font-weight=[bold.then_some("bold")] { (text) }
        });
    }

    fn bar(&mut self, from: Picoseconds, to: Picoseconds, colour: &str, height: f64, what: &str) {
        let (left, right) = (self.x(from), self.x(to).min(LEFT + WIDTH));
        self.shapes.push(html! {
            rect x=(format!("{left:.2}")) y=(format!("{:.1}", self.y + (12.0 - height) / 2.0))
                width=(format!("{:.2}", (right - left).max(0.6)))
                height=(format!("{height:.1}")) fill=(colour) { title { (what) } }
        });
    }

    /// A message of an event-triggered bus has no place in the cycle.
    fn message(&mut self, message: &MessageReport) {
        let Some(start) = message.start else {
            return;
        };
        let what = format!(
            "{} at {}, needs {} of {}",
            message.name,
            time(start),
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
        let end = start + message.room;
        self.bar(start, end, "#8884", 12.0, &what);
        let need = message.need.unwrap_or(message.room).min(message.room);
        self.bar(start, start + need, colour, 8.0, &what);
    }

    fn task(&mut self, task: &TaskReport, cycle: Picoseconds) {
        self.label(&format!("  {}", task.name), false);
        let colour = if task.meets() { "#5a8f00" } else { "#dc322f" };
        let done = task.response.unwrap_or(task.cost);
        let what = format!(
            "{}: takes up to {}, done {} after its release",
            task.name,
            time(task.cost),
            time(done)
        );
        let mut releases = task.releases.clone();
        if releases.is_empty() {
            // It has no fixed instant in the cycle: drawn at its highest rate.
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

    fn axis(&self, cycle: Picoseconds) -> Markup {
        html! {
            @for instant in (0..=PARTS).map(|part| cycle / PARTS * part) {
                @let at = format!("{:.1}", self.x(instant));
                line x1=(at) x2=(at) y1="16" y2=(format!("{:.0}", self.y)) stroke="#8884" {}
                text x=(at) y="12" font-size="10" text-anchor="middle" {
                    (instant / 1_000_000_000) " ms"
                }
            }
        }
    }
}

/// Draws the windows of the bus with their longest frames, and below them every release that
/// each task may have in the cycle. A thin bar runs from the earliest release to the worst
/// end; a thick one shows the longest job after the latest release.
pub(super) fn timeline(report: &Report) -> Markup {
    let cycle = report.basic_cycle.max(1);
    let mut chart = Chart {
        shapes: Vec::new(),
        y: 20.0,
        cycle: cycle as f64,
    };
    chart.label("bus", true);
    for message in &report.messages {
        chart.message(message);
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
    html! {
        h2 { "One basic cycle" }
        div.scroll {
            svg.chart width=(format!("{:.0}", LEFT + WIDTH + 40.0))
                height=(format!("{:.0}", chart.y + 10.0)) role="img" aria-label="timeline" {
                (chart.axis(cycle))
                @for shape in &chart.shapes { (shape) }
            }
        }
    }
}
