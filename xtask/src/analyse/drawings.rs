//! The pictures of the page.

use maud::Markup;
use world::report::{BAND, Span};

use super::{
    Found,
    figures::{HistogramFigures, ScheduleFigures},
    guidance::Position,
    page::MOST,
};
use crate::page::chart::{Chart, pieces, thinned};

/// Longest time between two points of a curve, s.
const TOGETHER: f64 = 1.0;

fn span(from: f64, to: f64) -> Span {
    Span { from, to }
}

fn apart(one: (f64, f64), other: (f64, f64)) -> bool {
    !(0.0..TOGETHER).contains(&(other.0 - one.0))
}

/// The whole time of the log.
fn time(found: &Found) -> Span {
    span(0.0, found.summary.log.span_seconds.max(1e-3))
}

/// Shades the autonomous runs.
fn runs(chart: &mut Chart, found: &Found) {
    let runs = found.summary.modes.iter().filter(|mode| mode.autonomous);
    for mode in runs.take(MOST) {
        let x = span(mode.from_seconds, mode.until_seconds);
        chart.shade(x, "auto", &mode.mode);
    }
}

/// The vehicle's track, seen from above.
pub(super) fn track(found: &Found) -> Markup {
    let positions = &found.guidance.positions;
    let line = found.guidance.line;
    // With a line, the picture is turned so that the line leads right.
    let place = |one: &Position| match line {
        Some(_) => (one.along, one.error),
        None => (one.east, one.north),
    };
    let all: Vec<(f64, f64)> = positions.iter().map(place).collect();
    let nothing = span(0.0, 1.0);
    let x = Span::of(all.iter().map(|point| point.0)).unwrap_or(nothing);
    let y = Span::of(all.iter().map(|point| point.1)).unwrap_or(nothing);
    let (x, y) = match line {
        Some(_) => (x.padded(0.03, 1.0), y.with(0.0).padded(0.12, 0.1)),
        None => (x.padded(0.05, 1.0), y.padded(0.05, 1.0)),
    };
    let natural = y.length() * Chart::inner() / x.length();
    let height = natural.clamp(150.0, 420.0);
    let mut chart = Chart::new("track", x, y, height);
    if line.is_some() {
        chart = chart.down();
    }
    chart.x_axis(if line.is_some() {
        "along the line (m)"
    } else {
        "east (m)"
    });
    chart.y_axis(if line.is_some() {
        "right of the line (m)"
    } else {
        "north (m)"
    });
    if let Some(line) = line {
        let until = line.length().min(x.to);
        if until > x.from {
            chart.line((x.from.max(0.0), 0.0), (until, 0.0), "orange");
        }
    }
    chart.curve(&pieces(&nearby(&all), far), "blue");
    if let (Some(first), Some(last)) = (all.first(), all.last()) {
        chart.dot(*first, "dot", "start");
        chart.dot(*last, "dot", "end");
    }
    let stretch = height / natural;
    let shape = match stretch {
        0.0..1.05 => "true to scale".to_owned(),
        _ => format!("stretched {stretch:.1} times across"),
    };
    let what = match line {
        Some(_) => {
            "The dashed line is the one of the vehicle file, the solid one the measured positions"
        }
        None => "The measured positions",
    };
    chart.finish("Seen from above.", &format!("{what}; {shape}."))
}

/// Distance in metres between two positions that do not belong together.
const JUMP: f64 = 5.0;

fn far(one: (f64, f64), other: (f64, f64)) -> bool {
    (one.0 - other.0).hypot(one.1 - other.1) > JUMP
}

/// The positions without those within 2 cm of the last one kept, so that a vehicle that stands still
/// adds nothing.
fn nearby(all: &[(f64, f64)]) -> Vec<(f64, f64)> {
    const LEAST: f64 = 0.02;
    let mut kept: Vec<(f64, f64)> = Vec::new();
    for point in all {
        let near = |last: &(f64, f64)| (last.0 - point.0).hypot(last.1 - point.1) < LEAST;
        if !kept.last().is_some_and(near) {
            kept.push(*point);
        }
    }
    kept
}

/// The cross-track error over time; if a run settled, also its part near the line.
pub(super) fn cross_track(found: &Found) -> Markup {
    if found.guidance.line.is_none() {
        return Markup::default();
    }
    let positions = found.guidance.positions.iter();
    let errors: Vec<(f64, f64)> = positions.map(|one| (one.at, one.error * 100.0)).collect();
    let y = Span::of(errors.iter().map(|point| point.1)).unwrap_or(span(0.0, 0.0));
    let errors = thinned(pieces(&errors, apart));
    let estimates = found.guidance.estimates.iter();
    let estimates: Vec<(f64, f64)> = estimates.map(|(at, error)| (*at, error * 100.0)).collect();
    let estimates = thinned(pieces(&estimates, apart));
    let band = BAND * 100.0;
    let draw = |id, y: Span, height| {
        let mut chart = Chart::new(id, time(found), y, height);
        runs(&mut chart, found);
        chart.band(span(-band, band), "band");
        chart.x_axis("time (s)");
        chart.y_axis("right of the line (cm)");
        chart.level(0.0, "zero");
        chart.curve(&errors, "blue");
        chart.curve(&estimates, "green");
        chart
    };
    let y = y.with(-band).with(band).padded(0.08, 0.5);
    let whole = draw("cross-track", y, 190.0).finish(
        "Cross-track error over time.",
        "Of the measured positions (blue) and by the vehicle's own estimate (green), positive right of the line; \
         autonomous runs are shaded, and so is the band of 5 cm to either side.",
    );
    let runs = found
        .summary
        .guidance
        .iter()
        .flat_map(|figures| &figures.runs);
    let settled = runs.filter(|run| run.settling_seconds.is_some()).count() > 0;
    let near = span(-NEAR, NEAR);
    maud::html! {
        (whole)
        @if settled && (y.from < near.from || y.to > near.to) {
            (draw("near", near, 150.0).finish("The same near the line.", "What is farther off is cut off."))
        }
    }
}

/// Cross-track error that the chart near the line shows, cm.
const NEAR: f64 = 12.0;

/// How often the error was how large.
pub(super) fn histogram(bars: &HistogramFigures) -> Markup {
    let upto = bars.from_cm + bars.width_cm * bars.positions.len() as f64;
    let most = bars.positions.iter().copied().max().unwrap_or(1) as f64;
    let x = span(bars.from_cm, upto).with(0.0).padded(0.02, 0.1);
    let mut chart = Chart::new("histogram", x, span(0.0, most * 1.05), 150.0);
    chart.x_axis("cross-track error (cm), positive right of the line");
    chart.y_axis("positions");
    for (index, count) in bars.positions.iter().enumerate() {
        let from = bars.from_cm + index as f64 * bars.width_cm;
        let until = from + bars.width_cm;
        let what = format!("{from:.1} cm to {until:.1} cm: {count}");
        if *count > 0 {
            // Bars leave a little room between them.
            let x = span(from + 0.04 * bars.width_cm, until - 0.04 * bars.width_cm);
            chart.area(x, span(0.0, *count as f64), "bar", &what);
        }
    }
    let total: u64 = bars.positions.iter().sum();
    chart.finish(
        "Histogram of the cross-track error.",
        &format!("{total} positions of the autonomous runs, from settling on if one settled."),
    )
}

/// The modes over time.
pub(super) fn modes(found: &Found) -> Markup {
    let modes = &found.summary.modes;
    let modes = &modes[..modes.len().min(MOST)];
    let mut names: Vec<&str> = Vec::new();
    for mode in modes {
        if !names.contains(&mode.mode.as_str()) {
            names.push(&mode.mode);
        }
    }
    let rows = names.len() as f64;
    let mut chart = Chart::new("mode", time(found), span(0.0, rows), 26.0 * rows)
        .down()
        .labels(150.0);
    chart.x_axis("time (s)");
    for (index, name) in names.iter().enumerate() {
        let row = index as f64;
        chart.label(row + 0.5, name);
        for mode in modes.iter().filter(|mode| mode.mode == *name) {
            let x = span(mode.from_seconds, mode.until_seconds);
            let class = if mode.autonomous { "run" } else { "mode" };
            let what = format!("{name}: {:.3} s to {:.3} s", x.from, x.to);
            chart.area(x, span(row + 0.15, row + 0.85), class, &what);
        }
    }
    chart.finish("Modes over time.", &format!("{}.", names.join(", ")))
}

/// Command and angle of the steering.
pub(super) fn steering(found: &Found) -> Markup {
    let (Some(steering), Some(figures)) = (&found.steering, &found.summary.steering) else {
        return Markup::default();
    };
    let commands = steering.commands.iter();
    let rates: Vec<(f64, f64)> = commands.map(|one| (one.at, one.rate)).collect();
    let y = Span::of(rates.iter().map(|point| point.1)).unwrap_or(span(0.0, 0.0));
    let mut rate = Chart::new("rate", time(found), y.with(0.0).padded(0.1, 0.5), 150.0);
    runs(&mut rate, found);
    let (left, right) = (
        figures.moves_left_from_deg_s,
        figures.moves_right_from_deg_s,
    );
    rate.band(span(-left.unwrap_or(0.0), right.unwrap_or(0.0)), "dead");
    rate.x_axis("time (s)");
    rate.y_axis("rate (deg/s)");
    rate.level(0.0, "zero");
    rate.curve(&thinned(pieces(&rates, apart)), "blue");
    let rate = rate.finish("Commanded steering rate.",
        "Positive to the right, 0 while the steering may not move; autonomous runs are shaded, and so is the dead \
         band of the actuator.",
    );
    let y = Span::of(steering.angles.iter().map(|point| point.1)).unwrap_or(span(0.0, 0.0));
    let mut angle = Chart::new("angle", time(found), y.with(0.0).padded(0.1, 0.5), 150.0);
    runs(&mut angle, found);
    angle.x_axis("time (s)");
    angle.y_axis("angle (deg)");
    angle.level(0.0, "zero");
    angle.curve(&thinned(pieces(&steering.angles, apart)), "blue");
    let angle = angle.finish(
        "Measured steering angle.",
        "By the potentiometer and its calibration in the vehicle file, positive to the right.",
    );
    maud::html! { (rate) (angle) }
}

/// The starts of frame in their windows.
pub(super) fn windows(schedule: &ScheduleFigures) -> Markup {
    let own = schedule
        .windows
        .iter()
        .filter(|one| !one.arbitrating && one.frames > 0);
    let own: Vec<_> = own
        .filter_map(|one| {
            let (least, most) = one.earliest_start_us.zip(one.latest_start_us)?;
            Some((one, least, most, one.mean_start_us?))
        })
        .collect();
    if own.is_empty() {
        return Markup::default();
    }
    let x = Span::of(own.iter().flat_map(|one| [one.1, one.2])).unwrap_or(span(0.0, 0.0));
    let rows = own.len() as f64;
    let mut chart = Chart::new(
        "windows",
        x.with(0.0).padded(0.05, 0.5),
        span(0.0, rows),
        20.0 * rows,
    )
    .down()
    .labels(150.0);
    chart.x_axis("start of frame after the begin of the window (us)");
    chart.line((0.0, 0.0), (0.0, rows), "zero");
    for (index, (window, least, most, mean)) in own.iter().enumerate() {
        let row = index as f64;
        chart.label(row + 0.5, &format!("{} {}", window.id, window.message));
        let what = format!(
            "{}: {least:.1} us to {most:.1} us, mean {mean:.2} us",
            window.message
        );
        chart.area(
            span(*least, *most),
            span(row + 0.3, row + 0.7),
            "range",
            &what,
        );
        chart.line((*mean, row + 0.15), (*mean, row + 0.85), "mean");
    }
    chart.finish(
        "Starts of frame in the exclusive windows.",
        "Each bar goes from the earliest to the latest start, the upright stroke is the mean.",
    )
}
