//! Charts of the page: inline SVG whose colours are those of the page, light or dark.

use std::fmt::Write as _;

use maud::{Markup, html};
use world::report::Span;

use super::STYLE;

/// Width of every chart, in its own units.
pub(crate) const WIDTH: f64 = 960.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 14.0;
const BELOW: f64 = 44.0;

/// Most points of a curve: two for each unit of the width.
const POINTS: usize = 2 * WIDTH as usize;

/// A chart under construction.
pub(crate) struct Chart {
    /// Name of the chart, unlike that of all others on the page.
    id: &'static str,
    x: Span,
    y: Span,
    height: f64,
    left: f64,
    /// True if values increase downwards.
    down: bool,
    shapes: Vec<Markup>,
}

/// A span that has a length.
fn wide(span: Span) -> Span {
    match span.length() > 0.0 {
        true => span,
        false => span.padded(0.0, 0.5),
    }
}

impl Chart {
    /// A chart whose inner part has this height.
    pub(crate) fn new(id: &'static str, x: Span, y: Span, height: f64) -> Self {
        Self {
            id,
            x: wide(x),
            y: wide(y),
            height,
            left: LEFT,
            down: false,
            shapes: Vec::new(),
        }
    }

    /// The same with values that increase downwards.
    pub(crate) fn down(mut self) -> Self {
        self.down = true;
        self
    }

    /// The same with more room for labels on the left.
    pub(crate) fn labels(mut self, left: f64) -> Self {
        self.left = left;
        self
    }

    /// Width of the inner part.
    pub(crate) const fn inner() -> f64 {
        WIDTH - LEFT - RIGHT
    }

    fn x(&self, value: f64) -> f64 {
        let share = (value - self.x.from) / self.x.length();
        self.left + share.clamp(-10.0, 10.0) * (WIDTH - self.left - RIGHT)
    }

    fn y(&self, value: f64) -> f64 {
        let share = (value - self.y.from) / self.y.length();
        let share = if self.down { share } else { 1.0 - share };
        TOP + share.clamp(-10.0, 10.0) * self.height
    }

    fn bottom(&self) -> f64 {
        TOP + self.height
    }

    /// Numbers and grid of the horizontal axis, and its name.
    pub(crate) fn x_axis(&mut self, name: &str) {
        let (ticks, digits) = self.x.ticks(((WIDTH - self.left) / 80.0) as usize);
        let bottom = self.bottom();
        for tick in ticks {
            let x = px(self.x(tick));
            self.shapes.push(html! {
                line.grid x1=(x) x2=(x) y1=(px(TOP)) y2=(px(bottom)) {}
                text x=(x) y=(px(bottom + 16.0)) text-anchor="middle" { (number(tick, digits)) }
            });
        }
        let middle = px((self.left + WIDTH - RIGHT) / 2.0);
        self.shapes.push(html! {
            text x=(middle) y=(px(bottom + 36.0)) text-anchor="middle" { (name) }
        });
    }

    /// Numbers and grid of the vertical axis, and its name.
    pub(crate) fn y_axis(&mut self, name: &str) {
        let (ticks, digits) = self.y.ticks((self.height / 28.0) as usize);
        for tick in ticks {
            let y = self.y(tick);
            self.shapes.push(html! {
                line.grid x1=(px(self.left)) x2=(px(WIDTH - RIGHT)) y1=(px(y)) y2=(px(y)) {}
                text x=(px(self.left - 6.0)) y=(px(y + 4.0)) text-anchor="end" { (number(tick, digits)) }
            });
        }
        let middle = TOP + self.height / 2.0;
        self.shapes.push(html! {
            text transform=(format!("translate(14 {middle:.1}) rotate(-90)")) text-anchor="middle" { (name) }
        });
    }

    /// A rectangle between two values of each axis, cut off at the chart's edges.
    pub(crate) fn area(&mut self, x: Span, y: Span, class: &str, what: &str) {
        let edge = |value: f64| value.clamp(self.left, WIDTH - RIGHT);
        let (left, right) = (edge(self.x(x.from)), edge(self.x(x.to)));
        let edge = |value: f64| value.clamp(TOP, TOP + self.height);
        let (one, other) = (edge(self.y(y.from)), edge(self.y(y.to)));
        self.shapes.push(html! {
            rect class=(class) x=(px(left)) y=(px(one.min(other))) width=(px((right - left).max(0.5)))
                height=(px((one - other).abs().max(0.5))) {
                @if !what.is_empty() { title { (what) } }
            }
        });
    }

    /// A range of the horizontal axis over the whole height.
    pub(crate) fn shade(&mut self, x: Span, class: &str, what: &str) {
        self.area(x, self.y, class, what);
    }

    /// A range of the vertical axis over the whole width.
    pub(crate) fn band(&mut self, y: Span, class: &str) {
        self.area(self.x, y, class, "");
    }

    /// A line between two points.
    pub(crate) fn line(&mut self, from: (f64, f64), to: (f64, f64), class: &str) {
        self.shapes.push(html! {
            line class=(class) x1=(px(self.x(from.0))) y1=(px(self.y(from.1)))
                x2=(px(self.x(to.0))) y2=(px(self.y(to.1))) {}
        });
    }

    /// A line over the whole width.
    pub(crate) fn level(&mut self, y: f64, class: &str) {
        self.line((self.x.from, y), (self.x.to, y), class);
    }

    /// A dot with a word beside it.
    pub(crate) fn dot(&mut self, at: (f64, f64), class: &str, word: &str) {
        let (x, y) = (self.x(at.0), self.y(at.1));
        let above = if y < TOP + 20.0 { 18.0 } else { -9.0 };
        let anchor = if x > WIDTH - 80.0 { "end" } else { "start" };
        self.shapes.push(html! {
            circle class=(class) cx=(px(x)) cy=(px(y)) r="4" {}
            text x=(px(x)) y=(px(y + above)) text-anchor=(anchor) { (word) }
        });
    }

    /// A word in the middle of a range of the horizontal axis.
    pub(crate) fn word(&mut self, x: Span, y: f64, word: &str) {
        let middle = (self.x(x.from) + self.x(x.to)) / 2.0;
        self.shapes.push(html! {
            text x=(px(middle)) y=(px(self.y(y) + 4.0)) text-anchor="middle" { (word) }
        });
    }

    /// A label left of the chart.
    pub(crate) fn label(&mut self, y: f64, text: &str) {
        self.shapes.push(html! {
            text x=(px(self.left - 6.0)) y=(px(self.y(y) + 4.0)) text-anchor="end" { (text) }
        });
    }

    /// A curve in pieces, cut off at the chart's edges.
    pub(crate) fn curve(&mut self, pieces: &[Vec<(f64, f64)>], class: &str) {
        let mut path = String::new();
        for piece in pieces {
            for (index, point) in piece.iter().enumerate() {
                let verb = if index == 0 { 'M' } else { 'L' };
                // Writing to a string cannot fail.
                let _ = write!(path, "{verb}{:.1} {:.1}", self.x(point.0), self.y(point.1));
            }
        }
        let clip = format!("url(#{}-clip)", self.id);
        self.shapes
            .push(html! { path class=(class) d=(path) clip-path=(clip) {} });
    }

    /// The chart; `title` and `description` are for screen readers, too.
    pub(crate) fn finish(self, title: &str, description: &str) -> Markup {
        let id = self.id;
        let (left, width) = (self.left, WIDTH - self.left - RIGHT);
        let (title_id, text_id) = (format!("{id}{TITLE}"), format!("{id}-text"));
        let all = self.bottom() + BELOW;
        html! {
            figure {
                figcaption { strong { (title) } " " (description) }
                div.scroll {
                    svg role="img" aria-labelledby=(format!("{title_id} {text_id}"))
                        viewBox=(format!("0 0 {WIDTH} {all:.0}")) {
                        title id=(title_id) { (title) }
                        desc id=(text_id) { (description) }
                        clipPath id=(format!("{id}-clip")) {
                            rect x=(px(left)) y=(px(TOP)) width=(px(width)) height=(px(self.height)) {}
                        }
                        @for shape in &self.shapes { (shape) }
                        rect.frame x=(px(left)) y=(px(TOP)) width=(px(width)) height=(px(self.height)) {}
                    }
                }
            }
        }
    }
}

/// What the title of a chart has behind the chart's name.
const TITLE: &str = "-title";

/// The charts of a page, each as a picture of its own with the chart's name.
pub(crate) fn pictures(page: &str) -> Vec<(String, String)> {
    let charts = page.split("<svg ").skip(1);
    let picture = |chart: &str| {
        let (chart, _) = chart.split_once("</svg>")?;
        let (_, named) = chart.split_once("aria-labelledby=\"")?;
        let (name, _) = named.split_once(TITLE)?;
        let (attributes, shapes) = chart.split_once('>')?;
        let picture = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" {attributes}><style>{STYLE}</style>{shapes}</svg>"
        );
        Some((name.to_owned(), picture))
    };
    charts.filter_map(picture).collect()
}

/// A length of the picture.
fn px(value: f64) -> String {
    format!("{value:.1}")
}

/// A tick's number with a proper minus sign.
fn number(value: f64, digits: usize) -> String {
    let text = format!("{:.digits$}", value.abs());
    let zero = text.chars().all(|c| c == '0' || c == '.');
    match value < 0.0 && !zero {
        true => format!("\u{2212}{text}"),
        false => text,
    }
}

/// Points in order, in pieces: between two of them the curve breaks if `breaks` says so.
pub(crate) fn pieces(
    points: &[(f64, f64)],
    breaks: impl Fn((f64, f64), (f64, f64)) -> bool,
) -> Vec<Vec<(f64, f64)>> {
    let pieces = points.chunk_by(|one, other| !breaks(*one, *other));
    pieces.map(<[_]>::to_vec).collect()
}

/// Few points that look the same: of each of many equal parts of the horizontal axis the first, the
/// least, the greatest and the last one of each piece, in their order.
pub(crate) fn thinned(pieces: Vec<Vec<(f64, f64)>>) -> Vec<Vec<(f64, f64)>> {
    let count: usize = pieces.iter().map(Vec::len).sum();
    let ends = pieces
        .iter()
        .flat_map(|piece| [piece.first(), piece.last()]);
    let ends = Span::of(ends.flatten().map(|point| point.0));
    let Some(span) = ends.filter(|_| count > POINTS) else {
        return pieces;
    };
    let width = (span.length() / (POINTS / 4) as f64).max(f64::MIN_POSITIVE);
    pieces.iter().map(|piece| thin(piece, width)).collect()
}

/// A piece with few points in each part of this width.
fn thin(piece: &[(f64, f64)], width: f64) -> Vec<(f64, f64)> {
    let part = |point: &(f64, f64)| (point.0 / width).floor() as i64;
    let mut kept = Vec::new();
    for chunk in piece.chunk_by(|one, other| part(one) == part(other)) {
        let by_value = |one: &usize, other: &usize| chunk[*one].1.total_cmp(&chunk[*other].1);
        let all = 0..chunk.len();
        let mut chosen = [
            0,
            all.clone().min_by(by_value).unwrap_or(0),
            all.clone().max_by(by_value).unwrap_or(0),
            chunk.len() - 1,
        ];
        chosen.sort_unstable();
        let mut before = None;
        for index in chosen {
            if before != Some(index) {
                kept.push(chunk[index]);
            }
            before = Some(index);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_is_not_thinned_out() {
        let mut points: Vec<(f64, f64)> = (0..100_000).map(|i| (f64::from(i), 0.0)).collect();
        points[34_567].1 = 5.0;
        points[71_234].1 = -5.0;
        // Nobody was there for a while.
        points.drain(40_000..60_000);
        let whole = pieces(&points, |one, other| other.0 - one.0 > 100.0);
        assert_eq!(whole.len(), 2);
        let thin = thinned(whole.clone());
        let [before, after] = &thin[..] else {
            panic!("{} pieces", thin.len());
        };
        assert_eq!(before.last(), Some(&(39_999.0, 0.0)));
        assert_eq!(after.first(), Some(&(60_000.0, 0.0)));
        assert!(before.contains(&(34_567.0, 5.0)) && after.contains(&(71_234.0, -5.0)));
        assert!(before.len() + after.len() <= POINTS + 8);
        for piece in &thin {
            assert!(piece.is_sorted_by(|one, other| one.0 < other.0));
        }
        let few = pieces(&points[..10], |_, _| false);
        assert_eq!(thinned(few.clone()), few);
        assert!(thinned(Vec::new()).is_empty());
    }
}
