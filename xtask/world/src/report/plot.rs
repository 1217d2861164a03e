//! A small plotting kit for SVG: axes with round ticks, lines, bands and labels.

use core::fmt::Write;

/// Colours that colour-blind readers can distinguish (after Okabe and Ito), also in print.
pub(super) mod colour {
    pub(crate) const INK: &str = "#22303a";
    pub(crate) const MUTED: &str = "#66747e";
    pub(crate) const GRID: &str = "#e3e8eb";
    pub(crate) const FRAME: &str = "#aab5bc";
    pub(crate) const BLUE: &str = "#0072b2";
    pub(crate) const ORANGE: &str = "#d55e00";
    pub(crate) const GREEN: &str = "#009e73";
    pub(crate) const BAND: &str = "#009e73";
    pub(crate) const SHADE: &str = "#eef4f8";
    pub(crate) const WARNING: &str = "#f8e6db";
    pub(crate) const LEAF: &str = "#5fbf9f";
    pub(crate) const BEAM: &str = "#cc79a7";
}

/// `text` with the special characters of XML escaped.
pub(super) fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

/// Where a text is anchored.
#[derive(Copy, Clone)]
pub(super) enum Anchor {
    Start,
    Middle,
    End,
}

/// An SVG document under construction.
pub(super) struct Canvas {
    body: String,
    clips: usize,
    width: f64,
    height: f64,
}

impl Canvas {
    pub(super) fn new(width: f64, height: f64) -> Self {
        Self {
            body: String::new(),
            clips: 0,
            width,
            height,
        }
    }

    fn add(&mut self, element: core::fmt::Arguments) {
        // Writing to a string cannot fail.
        let _ = writeln!(self.body, "{element}");
    }

    pub(super) fn rectangle(&mut self, x: f64, y: f64, w: f64, h: f64, fill: &str, opacity: f64) {
        self.add(format_args!(
            r#"<rect x="{x:.1}" y="{y:.1}" width="{w:.1}" height="{h:.1}" fill="{fill}" fill-opacity="{opacity}"/>"#
        ));
    }

    pub(super) fn text(
        &mut self,
        x: f64,
        y: f64,
        size: f64,
        anchor: Anchor,
        fill: &str,
        text: &str,
    ) {
        let anchor = match anchor {
            Anchor::Start => "start",
            Anchor::Middle => "middle",
            Anchor::End => "end",
        };
        let text = escape(text);
        self.add(format_args!(
            r#"<text x="{x:.1}" y="{y:.1}" font-size="{size}" text-anchor="{anchor}" fill="{fill}">{text}</text>"#
        ));
    }

    pub(super) fn title(&mut self, x: f64, y: f64, text: &str) {
        let text = escape(text);
        self.add(format_args!(
            r#"<text x="{x:.1}" y="{y:.1}" font-size="20" font-weight="bold" fill="{}">{text}</text>"#,
            colour::INK
        ));
    }

    pub(super) fn rotated(&mut self, x: f64, y: f64, text: &str) {
        let text = escape(text);
        self.add(format_args!(
            r#"<text transform="translate({x:.1} {y:.1}) rotate(-90)" font-size="12" text-anchor="middle" fill="{}">{text}</text>"#,
            colour::INK
        ));
    }

    pub(super) fn line(
        &mut self,
        from: (f64, f64),
        to: (f64, f64),
        stroke: &str,
        width: f64,
        dash: &str,
    ) {
        let dash = if dash.is_empty() {
            String::new()
        } else {
            format!(r#" stroke-dasharray="{dash}""#)
        };
        self.add(format_args!(
            r#"<line x1="{:.1}" y1="{:.1}" x2="{:.1}" y2="{:.1}" stroke="{stroke}" stroke-width="{width}"{dash}/>"#,
            from.0, from.1, to.0, to.1
        ));
    }

    /// A dashed line at a y value of `panel` between two x values.
    pub(super) fn dashed(&mut self, panel: &Panel, from: f64, to: f64, y: f64, stroke: &str) {
        self.line(
            (panel.x(from), panel.y(y)),
            (panel.x(to), panel.y(y)),
            stroke,
            2.0,
            "7 4",
        );
    }

    pub(super) fn circle(&mut self, x: f64, y: f64, radius: f64, fill: &str, stroke: &str) {
        self.add(format_args!(
            r#"<circle cx="{x:.1}" cy="{y:.1}" r="{radius}" fill="{fill}" stroke="{stroke}" stroke-width="1.5"/>"#
        ));
    }

    /// A disc without an outline.
    pub(super) fn disc(&mut self, x: f64, y: f64, radius: f64, fill: &str) {
        self.add(format_args!(
            r#"<circle cx="{x:.1}" cy="{y:.1}" r="{radius:.1}" fill="{fill}"/>"#
        ));
    }

    /// The outline of a polygon.
    pub(super) fn outline(&mut self, corners: &[(f64, f64)], stroke: &str, width: f64) {
        let mut points = String::new();
        for (x, y) in corners {
            let _ = write!(points, "{x:.1},{y:.1} ");
        }
        self.add(format_args!(
            r#"<polygon points="{}" fill="none" stroke="{stroke}" stroke-width="{width}"/>"#,
            points.trim_end()
        ));
    }

    /// The whole document; `title` and `description` are for screen readers.
    pub(super) fn finish(self, title: &str, description: &str) -> String {
        format!(
            r#"<svg xmlns="http://www.w3.org/2000/svg" width="{w}" height="{h}" viewBox="0 0 {w} {h}" role="img" font-family="Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif">
<title>{title}</title>
<desc>{description}</desc>
<rect width="{w}" height="{h}" fill="white"/>
{body}</svg>
"#,
            w = self.width,
            h = self.height,
            title = escape(title),
            description = escape(description),
            body = self.body
        )
    }
}

/// Fewest numbers that make an axis a scale.
const SCALE: usize = 3;

/// A range of values along an axis.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Span {
    /// Its least value.
    pub from: f64,
    /// Its greatest value.
    pub to: f64,
}

impl Span {
    /// The smallest span that holds all values; `None` without values.
    #[must_use]
    pub fn of(values: impl IntoIterator<Item = f64>) -> Option<Self> {
        values.into_iter().fold(None, |span: Option<Self>, value| {
            Some(span.map_or(
                Self {
                    from: value,
                    to: value,
                },
                |span| span.with(value),
            ))
        })
    }

    /// The span widened to hold `value`.
    #[must_use]
    pub fn with(self, value: f64) -> Self {
        Self {
            from: self.from.min(value),
            to: self.to.max(value),
        }
    }

    /// The span with `share` of its length, or at least `least`, added at both ends.
    #[must_use]
    pub fn padded(self, share: f64, least: f64) -> Self {
        let more = (share * self.length()).max(least);
        Self {
            from: self.from - more,
            to: self.to + more,
        }
    }

    /// From the least value to the greatest.
    #[must_use]
    pub fn length(self) -> f64 {
        self.to - self.from
    }

    /// Round values within the span, 1, 2 or 5 times a power of ten apart, and the number of decimals
    /// that they need. They are at most `count`, unless that leaves fewer than three, which are no
    /// scale: then they are the next closer ones.
    #[must_use]
    pub fn ticks(self, count: usize) -> (Vec<f64>, usize) {
        let raw = self.length().max(1e-12) / count.max(1) as f64;
        let power = 10_f64.powf(raw.log10().floor());
        let steps = [0.2, 0.5, 1.0, 2.0, 5.0, 10.0].map(|factor| factor * power);
        let wide = steps
            .iter()
            .position(|step| *step >= raw * (1.0 - 1e-9))
            .unwrap_or(steps.len() - 1);
        let mut closer = steps.iter().take(wide + 1).rev().copied();
        let step = closer
            .find(|step| self.multiples(*step).count() >= SCALE)
            .unwrap_or(power);
        let digits = (-step.log10().floor()).max(0.0) as usize;
        (self.multiples(step).collect(), digits)
    }

    /// The multiples of `step` within the span.
    fn multiples(self, step: f64) -> impl Iterator<Item = f64> {
        let first = (self.from / step - 1e-9).ceil() as i64;
        let last = (self.to / step + 1e-9).floor() as i64;
        (first..=last).map(move |i| i as f64 * step)
    }
}

/// An area with axes.
pub(super) struct Panel {
    pub left: f64,
    pub top: f64,
    pub width: f64,
    pub height: f64,
    pub x: Span,
    pub y: Span,
    /// True if values increase downwards.
    pub down: bool,
}

impl Panel {
    pub(super) fn x(&self, value: f64) -> f64 {
        self.left + (value - self.x.from) / self.x.length() * self.width
    }

    pub(super) fn y(&self, value: f64) -> f64 {
        let share = (value - self.y.from) / self.y.length();
        let share = if self.down { share } else { 1.0 - share };
        self.top + share * self.height
    }

    /// Grid, frame, numbers and labels.
    pub(super) fn axes(&self, canvas: &mut Canvas, x_label: &str, y_label: &str) {
        let bottom = self.top + self.height;
        let (ticks, digits) = self.x.ticks((self.width / 80.0) as usize);
        for tick in ticks {
            let x = self.x(tick);
            canvas.line((x, self.top), (x, bottom), colour::GRID, 1.0, "");
            let number = number(tick, digits);
            canvas.text(
                x,
                bottom + 16.0,
                12.0,
                Anchor::Middle,
                colour::MUTED,
                &number,
            );
        }
        let (ticks, digits) = self.y.ticks((self.height / 28.0) as usize);
        for tick in ticks {
            let y = self.y(tick);
            canvas.line(
                (self.left, y),
                (self.left + self.width, y),
                colour::GRID,
                1.0,
                "",
            );
            let number = number(tick, digits);
            canvas.text(
                self.left - 7.0,
                y + 4.0,
                12.0,
                Anchor::End,
                colour::MUTED,
                &number,
            );
        }
        canvas.rotated(self.left - 50.0, self.top + self.height / 2.0, y_label);
        if !x_label.is_empty() {
            let middle = self.left + self.width / 2.0;
            canvas.text(
                middle,
                bottom + 34.0,
                12.0,
                Anchor::Middle,
                colour::INK,
                x_label,
            );
        }
    }

    /// The frame, drawn last so that it covers the ends of lines.
    pub(super) fn frame(&self, canvas: &mut Canvas) {
        canvas.add(format_args!(
            r#"<rect x="{:.1}" y="{:.1}" width="{:.1}" height="{:.1}" fill="none" stroke="{}"/>"#,
            self.left,
            self.top,
            self.width,
            self.height,
            colour::FRAME
        ));
    }

    /// A heading above the panel's top left corner.
    pub(super) fn heading(&self, canvas: &mut Canvas, text: &str) {
        canvas.text(
            self.left,
            self.top - 8.0,
            13.0,
            Anchor::Start,
            colour::INK,
            text,
        );
    }

    /// A legend entry above the panel. Its text begins `right` pixels before the right edge.
    pub(super) fn legend(
        &self,
        canvas: &mut Canvas,
        right: f64,
        stroke: &str,
        dash: &str,
        text: &str,
    ) {
        let x = self.left + self.width - right;
        let y = self.top - 12.0;
        canvas.line((x - 26.0, y), (x, y), stroke, 2.0, dash);
        canvas.text(x + 6.0, y + 4.0, 12.0, Anchor::Start, colour::INK, text);
    }

    /// A shaded range of x over the whole height.
    pub(super) fn shade(&self, canvas: &mut Canvas, from: f64, to: f64, fill: &str) {
        let (from, to) = (self.x(from.max(self.x.from)), self.x(to.min(self.x.to)));
        if to > from {
            canvas.rectangle(from, self.top, to - from, self.height, fill, 1.0);
        }
    }

    /// A shaded range of y over the whole width.
    pub(super) fn band(&self, canvas: &mut Canvas, from: f64, to: f64, fill: &str) {
        let clamp = |value: f64| self.y(value.clamp(self.y.from, self.y.to));
        let (a, b) = (clamp(from), clamp(to));
        canvas.rectangle(self.left, a.min(b), self.width, (a - b).abs(), fill, 0.14);
    }

    /// A straight line across the panel at a y value.
    pub(super) fn level(&self, canvas: &mut Canvas, value: f64, stroke: &str, dash: &str) {
        let y = self.y(value);
        canvas.line(
            (self.left, y),
            (self.left + self.width, y),
            stroke,
            1.2,
            dash,
        );
    }

    /// A straight line over the panel's height at an x value, with a label at its top.
    pub(super) fn mark(&self, canvas: &mut Canvas, value: f64, stroke: &str, label: &str) {
        if value < self.x.from || value > self.x.to {
            return;
        }
        let x = self.x(value);
        canvas.line(
            (x, self.top),
            (x, self.top + self.height),
            stroke,
            1.2,
            "4 3",
        );
        let (x, anchor) = if x > self.left + 0.8 * self.width {
            (x - 5.0, Anchor::End)
        } else {
            (x + 5.0, Anchor::Start)
        };
        canvas.text(x, self.top + 14.0, 11.0, anchor, stroke, label);
    }

    /// A curve, clipped at the panel's edges. Points less than a third of a pixel from the last one
    /// drawn are left out; the difference is not visible.
    pub(super) fn curve(
        &self,
        canvas: &mut Canvas,
        points: impl IntoIterator<Item = (f64, f64)>,
        stroke: &str,
        width: f64,
    ) {
        let mut path = String::new();
        let mut last: Option<(f64, f64)> = None;
        for (x, y) in points {
            // Far outside the panel the exact position does not matter.
            let far = 10.0 * self.height;
            let point = (self.x(x), self.y(y).clamp(self.top - far, self.top + far));
            if !point.0.is_finite() || !point.1.is_finite() {
                last = None;
                continue;
            }
            let near = last.is_some_and(|last| {
                (last.0 - point.0).abs() < 0.35 && (last.1 - point.1).abs() < 0.35
            });
            if near {
                continue;
            }
            let verb = if last.is_none() { 'M' } else { 'L' };
            let _ = write!(path, "{verb}{:.1} {:.1}", point.0, point.1);
            last = Some(point);
        }
        if path.is_empty() {
            return;
        }
        canvas.clips += 1;
        let clip = canvas.clips;
        canvas.add(format_args!(
            r#"<clipPath id="c{clip}"><rect x="{:.1}" y="{:.1}" width="{:.1}" height="{:.1}"/></clipPath>"#,
            self.left, self.top, self.width, self.height
        ));
        canvas.add(format_args!(
            r#"<path d="{path}" clip-path="url(#c{clip})" fill="none" stroke="{stroke}" stroke-width="{width}" stroke-linejoin="round"/>"#
        ));
    }
}

/// A tick's number, with a proper minus sign and no negative zero.
fn number(value: f64, digits: usize) -> String {
    let text = format!("{:.digits$}", value.abs());
    let zero = text.chars().all(|c| c == '0' || c == '.');
    if value < 0.0 && !zero {
        format!("\u{2212}{text}")
    } else {
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_few() {
        let span = Span {
            from: -0.3,
            to: 61.0,
        };
        assert_eq!(
            span.ticks(7),
            (vec![0.0, 10.0, 20.0, 30.0, 40.0, 50.0, 60.0], 0)
        );
        let (ticks, digits) = Span {
            from: -0.06,
            to: 0.11,
        }
        .ticks(4);
        assert_eq!(digits, 2);
        assert_eq!(
            ticks.iter().map(|t| number(*t, 2)).collect::<Vec<_>>(),
            ["\u{2212}0.05", "0.00", "0.05", "0.10"]
        );
    }

    #[test]
    fn an_axis_has_a_scale() {
        // Every 5 would leave the zero alone.
        let span = Span {
            from: -4.5,
            to: 4.6,
        };
        assert_eq!(span.ticks(4), (vec![-4.0, -2.0, 0.0, 2.0, 4.0], 0));
        for tenths in 1..400 {
            let to = f64::from(tenths) / 10.0;
            for count in 3..12 {
                let (ticks, digits) = Span { from: -to, to }.ticks(count);
                let most = (count + 2).max(5);
                assert!((SCALE..=most).contains(&ticks.len()), "{to} {count}");
                let written: Vec<String> = ticks.iter().map(|t| number(*t, digits)).collect();
                let read = written.iter().map(|t| t.replace('\u{2212}', "-"));
                let read: Vec<f64> = read.map(|t| t.parse().unwrap()).collect();
                let near = ticks.iter().zip(&read).all(|(a, b)| (a - b).abs() < 1e-9);
                assert!(near, "{written:?}");
            }
        }
    }

    #[test]
    fn text_is_escaped() {
        assert_eq!(escape("a<b & \"c\""), "a&lt;b &amp; &quot;c&quot;");
    }
}
