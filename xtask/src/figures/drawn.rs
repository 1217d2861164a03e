//! What a figure consists of, and how curves become charts.

use maud::Markup;
use serde::Serialize;
use world::report::{Span, rounded};

use super::takes::Points;
use crate::page::chart::{Chart, pieces, thinned};

/// A figure's number beside that of the thesis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Number {
    /// What it is.
    pub what: &'static str,
    /// Its unit.
    pub unit: &'static str,
    /// As the thesis has it.
    pub thesis: Option<f64>,
    /// Under the law of the thesis.
    pub plain: Option<f64>,
    /// As Furrow has it.
    pub furrow: Option<f64>,
    /// Decimals that are shown.
    #[serde(skip)]
    pub digits: usize,
}

impl Number {
    /// A number that nobody has yet.
    pub(super) const fn new(what: &'static str, unit: &'static str, digits: usize) -> Self {
        Self {
            what,
            unit,
            thesis: None,
            plain: None,
            furrow: None,
            digits,
        }
    }

    /// The same with that of the thesis.
    pub(super) const fn thesis(mut self, value: f64) -> Self {
        self.thesis = Some(value);
        self
    }

    /// The same with that under the law of the thesis.
    pub(super) fn plain(mut self, value: Option<f64>) -> Self {
        self.plain = value.filter(|value| value.is_finite());
        self
    }

    /// The same with Furrow's.
    pub(super) fn furrow(mut self, value: Option<f64>) -> Self {
        self.furrow = value.filter(|value| value.is_finite());
        self
    }

    /// The same as it is printed.
    pub(super) fn rounded(mut self) -> Self {
        for value in [&mut self.thesis, &mut self.plain, &mut self.furrow] {
            *value = value.map(|value| rounded(value, self.digits as i32));
        }
        self
    }
}

/// A drawn figure.
#[derive(Default)]
pub(super) struct Drawn {
    /// Its charts, one below the other.
    pub charts: Vec<Markup>,
    /// Its numbers.
    pub numbers: Vec<Number>,
}

/// The colours of curves.
pub(super) const PLAIN: &str = "blue";
/// That of Furrow's.
pub(super) const FURROW: &str = "green";
/// That of what is measured or commanded.
pub(super) const OTHER: &str = "orange";

/// A chart of curves.
pub(super) struct Curves<'c> {
    /// Name of the chart on the page.
    pub id: &'static str,
    /// Its title.
    pub title: &'static str,
    /// What its colours mean.
    pub what: &'static str,
    /// Names of both axes.
    pub axes: [&'static str; 2],
    /// The curves, each with its colour.
    pub curves: &'c [(&'static str, &'c Points)],
    /// A value of the vertical axis that is marked.
    pub level: Option<f64>,
    /// A value of the horizontal axis that is marked, and what is there.
    pub mark: Option<(f64, &'static str)>,
    /// Whether the vertical axis increases downwards: what is right of a line that leads to the right.
    pub down: bool,
}

/// The axis of what happened over time.
pub(super) const TIME: &str = "time since the run began, s";

/// A curve that begins so early, as a share of the time that it lasts, is drawn from the begin of the run on.
const EARLY: f64 = 0.1;

/// Longest time between two points of a curve over time, s.
const TOGETHER: f64 = 1.0;

impl Curves<'_> {
    /// The chart.
    pub(super) fn draw(&self) -> Markup {
        let all = || self.curves.iter().flat_map(|(_, points)| points.iter());
        let none = Span { from: 0.0, to: 1.0 };
        let over_time = self.axes[0].starts_with("time");
        let x = Span::of(all().map(|point| point.0)).unwrap_or(none);
        let x = match over_time && x.from > 0.0 && x.from < EARLY * x.length() {
            true => x.with(0.0),
            false => x,
        };
        let y = Span::of(all().map(|point| point.1)).unwrap_or(none);
        let y = self
            .level
            .map_or(y, |level| y.with(level))
            .padded(0.06, 1e-6);
        let mut chart = Chart::new(self.id, x, y, 220.0);
        if self.down {
            chart = chart.down();
        }
        chart.x_axis(self.axes[0]);
        chart.y_axis(self.axes[1]);
        if let Some(level) = self.level {
            chart.level(level, "zero");
        }
        if let Some((at, what)) = self.mark.filter(|(at, _)| (x.from..=x.to).contains(at)) {
            chart.line((at, y.from), (at, y.to), "mean");
            chart.word(Span { from: at, to: at }, y.to - y.length() * 0.04, what);
        }
        for (class, points) in self.curves {
            let whole = pieces(points, |one, other| over_time && other.0 - one.0 > TOGETHER);
            chart.curve(&thinned(whole), class);
        }
        chart.finish(self.title, self.what)
    }
}

/// Width of a bar of a histogram, cm.
const BAR: f64 = 0.5;

/// How often each value was there, in percent; both laws beside each other.
pub(super) fn histogram(
    id: &'static str,
    title: &'static str,
    what: &'static str,
    values: &[(&'static str, &[f64])],
) -> Markup {
    let all = values.iter().flat_map(|(_, values)| values.iter().copied());
    let span = Span::of(all).unwrap_or(Span { from: 0.0, to: 1.0 });
    let first = (span.from / BAR).floor() as i64;
    let last = (span.to / BAR).floor() as i64 + 1;
    let shares = |values: &[f64]| -> Points {
        let mut points = Vec::new();
        for bar in first..last {
            let (from, to) = (bar as f64 * BAR, (bar + 1) as f64 * BAR);
            let count = values.iter().filter(|value| (from..to).contains(*value));
            let share = 100.0 * count.count() as f64 / values.len().max(1) as f64;
            points.extend([(from, share), (to, share)]);
        }
        points
    };
    let curves: Vec<(&'static str, Points)> = values
        .iter()
        .map(|(class, values)| (*class, shares(values)))
        .collect();
    let curves: Vec<(&'static str, &Points)> = curves
        .iter()
        .map(|(class, points)| (*class, points))
        .collect();
    Curves {
        id,
        title,
        what,
        axes: ["cross-track error, cm", "share of the time, %"],
        curves: &curves,
        level: Some(0.0),
        mark: None,
        down: false,
    }
    .draw()
}

/// What happened when, in rows: each row with its label and spans of time.
pub(super) struct Timeline<'t> {
    /// Name of the chart on the page.
    pub id: &'static str,
    /// Its title.
    pub title: &'static str,
    /// What it shows.
    pub what: &'static str,
    /// Name of the horizontal axis.
    pub axis: &'static str,
    /// Its range.
    pub x: Span,
    /// Whether the names of bars are written below them.
    pub named: bool,
    /// The rows from above: label, colour, and begin and end of each bar with its name.
    pub rows: &'t [Row],
}

/// A row of a timeline.
pub(super) struct Row {
    /// Its label.
    pub label: String,
    /// The colour of its bars.
    pub class: &'static str,
    /// Begin, end and name of each bar.
    pub bars: Vec<(f64, f64, String)>,
}

/// Height of a row, and of one whose bars have names.
const ROW: f64 = 20.0;
const NAMED_ROW: f64 = 40.0;

impl Timeline<'_> {
    /// The chart.
    pub(super) fn draw(&self) -> Markup {
        let count = self.rows.len().max(1) as f64;
        let y = Span {
            from: 0.0,
            to: count,
        };
        let height = if self.named { NAMED_ROW } else { ROW };
        let mut chart = Chart::new(self.id, self.x, y, count * height)
            .down()
            .labels(130.0);
        chart.x_axis(self.axis);
        for (place, row) in self.rows.iter().enumerate() {
            let middle = place as f64 + 0.5;
            chart.label(middle, &row.label);
            let within = |bar: &&(f64, f64, String)| bar.1 >= self.x.from && bar.0 <= self.x.to;
            for (from, to, name) in row.bars.iter().filter(within) {
                let (from, to) = (*from, *to);
                let half = if self.named { 0.4 } else { 0.32 };
                let y = Span {
                    from: middle - half,
                    to: middle + if self.named { 0.0 } else { half },
                };
                chart.area(Span { from, to }, y, row.class, name);
                if self.named {
                    chart.word(Span { from, to }, middle + 0.25, name);
                }
            }
        }
        chart.finish(self.title, self.what)
    }
}
