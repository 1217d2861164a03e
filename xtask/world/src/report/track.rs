//! The picture of a run: the path from above, the cross-track error, the steering.

use super::guidance::{BAND, autonomous_spans, errors};
use super::plot::{Anchor, Canvas, Panel, Span, colour};
use super::{Run, Summary};
use crate::receiver::Fix;
use crate::time::{seconds, span_seconds};
use crate::vehicle::Parameters;

const WIDTH: f64 = 1000.0;
const LEFT: f64 = 76.0;
const INNER: f64 = WIDTH - LEFT - 28.0;

/// Smallest height of the view from above, pixels. A narrow path is stretched across the line to
/// fill it.
const LEAST_PLAN: f64 = 150.0;
const MOST_PLAN: f64 = 420.0;

/// `track.svg`: the path seen from above with the line leading right, which stands for the path of a mission, and over time the
/// cross-track error, its steady state, steering angle and speed; `None` without a machine.
#[must_use]
pub fn track_svg(run: &Run, summary: &Summary) -> Option<String> {
    let line = run.scenario.line.as_ref()?;
    let machine = run.scenario.vehicle.as_ref()?;
    let place = |(index, state): (usize, &crate::record::StateSample)| match run.located(index) {
        Some(located) => (located.along, located.right),
        None => line.locate(state.north, state.east),
    };
    let path: Vec<(f64, f64)> = run.states.iter().enumerate().map(place).collect();
    let panels = Panels::new(run, machine, &path);
    let height = panels.speed.top + panels.speed.height + 52.0;
    let mut canvas = Canvas::new(WIDTH, height.ceil());
    heading(&mut canvas, run, summary);
    let length = match &run.mission {
        Some(mission) => mission.length(),
        None => line.length(),
    };
    from_above(&mut canvas, length, &panels, &path);
    for panel in [
        &panels.whole,
        &panels.steady,
        &panels.steering,
        &panels.speed,
    ] {
        background(&mut canvas, run, panel);
    }
    cross_track(&mut canvas, run, summary, &panels);
    motion(&mut canvas, run, machine, &panels);
    Some(canvas.finish(
        &format!(
            "Path and cross-track error of scenario {}",
            run.scenario.name
        ),
        &figures(summary),
    ))
}

/// The parts of the picture, from top to bottom.
struct Panels {
    /// The path from above.
    plan: Panel,
    /// Factor by which the plan is stretched across the line.
    stretch: f64,
    /// Cross-track error.
    whole: Panel,
    /// Cross-track error within the band.
    steady: Panel,
    /// Steering angle.
    steering: Panel,
    /// Speed of the wheels.
    speed: Panel,
}

impl Panels {
    fn new(run: &Run, machine: &Parameters, path: &[(f64, f64)]) -> Self {
        let span = |values: &mut dyn Iterator<Item = f64>, to: f64| {
            Span::of(values).unwrap_or(Span { from: 0.0, to })
        };
        let along = span(&mut path.iter().map(|point| point.0), 1.0).padded(0.03, 1.0);
        let across = span(&mut path.iter().map(|point| point.1), 0.0);
        let across = across.with(0.0).padded(0.12, 0.1);
        let scale = INNER / along.length();
        let natural = across.length() * scale;
        let plan_height = natural.clamp(LEAST_PLAN, MOST_PLAN);
        let plan = Panel {
            left: LEFT,
            top: 112.0,
            width: INNER,
            height: plan_height,
            x: along,
            y: across,
            down: true,
        };
        let time = Span {
            from: 0.0,
            to: span_seconds(run.duration).max(1e-3),
        };
        let below = |panel: &Panel, gap: f64, height: f64, y: Span| Panel {
            left: LEFT,
            top: panel.top + panel.height + gap,
            width: INNER,
            height,
            x: time,
            y,
            down: false,
        };
        let both_sides = |limit: f64| Span {
            from: -limit,
            to: limit,
        };
        let limit = machine.steering_limit.get().to_degrees();
        let speeds = run.states.iter().map(|state| state.speed);
        let speeds = Span {
            from: speeds.fold(0.0, f64::min),
            to: machine.top_speed.get(),
        };
        let whole = below(&plan, 82.0, 170.0, across);
        let steady = below(&whole, 48.0, 150.0, both_sides(12.0));
        let steering = below(&steady, 48.0, 130.0, both_sides(limit).padded(0.12, 0.0));
        let speed = below(&steering, 48.0, 90.0, speeds.padded(0.06, 0.0));
        Self {
            stretch: plan_height / natural,
            plan,
            whole,
            steady,
            steering,
            speed,
        }
    }
}

/// The cross-track error: the full range, and near the line.
fn cross_track(canvas: &mut Canvas, run: &Run, summary: &Summary, panels: &Panels) {
    let Panels { whole, steady, .. } = panels;
    let errors: Vec<(f64, f64)> = errors(run).collect();
    whole.axes(canvas, "", "right of line (m)");
    whole.heading(
        canvas,
        "Cross-track error of the centre line beside the antenna",
    );
    whole.band(canvas, -BAND, BAND, colour::BAND);
    whole.level(canvas, 0.0, colour::INK, "");
    whole.curve(canvas, errors.iter().copied(), colour::BLUE, 1.8);
    marks(canvas, run, summary, whole);
    whole.frame(canvas);

    steady.axes(canvas, "", "right of line (cm)");
    steady.heading(canvas, "The same in centimetres, with the 5 cm band");
    steady.band(canvas, -BAND * 100.0, BAND * 100.0, colour::BAND);
    steady.level(canvas, 0.0, colour::INK, "");
    let centimetres = errors.iter().map(|(time, error)| (*time, error * 100.0));
    steady.curve(canvas, centimetres, colour::BLUE, 1.4);
    steady.frame(canvas);
}

/// Steering angle and speed.
fn motion(canvas: &mut Canvas, run: &Run, machine: &Parameters, panels: &Panels) {
    let Panels {
        steering, speed, ..
    } = panels;
    let limit = machine.steering_limit.get().to_degrees();
    steering.axes(canvas, "", "steering (deg)");
    steering.heading(
        canvas,
        "Steering angle, positive to the right, and its limits",
    );
    steering.level(canvas, limit, colour::ORANGE, "5 4");
    steering.level(canvas, -limit, colour::ORANGE, "5 4");
    let states = run.states.iter();
    let angles = states
        .clone()
        .map(|s| (seconds(s.at), s.steering.to_degrees()));
    steering.curve(canvas, angles, colour::BLUE, 1.4);
    steering.frame(canvas);

    speed.axes(canvas, "time (s)", "speed (m/s)");
    speed.heading(canvas, "Speed of the wheels");
    let speeds = states.map(|s| (seconds(s.at), s.speed));
    speed.curve(canvas, speeds, colour::BLUE, 1.4);
    speed.frame(canvas);
}

/// The run's figures in a line.
fn figures(summary: &Summary) -> String {
    let driven = format!("{:.1} m driven", summary.distance_m.unwrap_or_default());
    let Some(run) = summary.autonomous_runs.first() else {
        return format!("{driven}, no autonomous run");
    };
    match (
        run.settling_seconds,
        run.mean_cross_track_error_cm,
        run.standard_deviation_cm,
        run.largest_cross_track_error_cm,
    ) {
        (Some(settling), Some(mean), Some(deviation), Some(largest)) => format!(
            "settled to 5 cm in {settling:.1} s; then mean {mean:.2} cm, standard deviation \
             {deviation:.2} cm, largest {largest:.1} cm"
        )
        .replace("mean -", "mean \u{2212}"),
        _ => format!("{driven}, not settled to 5 cm"),
    }
}

fn heading(canvas: &mut Canvas, run: &Run, summary: &Summary) {
    canvas.title(LEFT, 32.0, &run.scenario.name);
    let about = if run.scenario.summary.is_empty() {
        format!("seed {}", run.seed)
    } else {
        format!("{}; seed {}", run.scenario.summary, run.seed)
    };
    canvas.text(LEFT, 53.0, 13.0, Anchor::Start, colour::MUTED, &about);
    canvas.text(
        LEFT,
        73.0,
        13.0,
        Anchor::Start,
        colour::INK,
        &figures(summary),
    );
}

fn from_above(canvas: &mut Canvas, length: f64, panels: &Panels, path: &[(f64, f64)]) {
    let &Panels {
        ref plan, stretch, ..
    } = panels;
    plan.axes(canvas, "way along the line (m)", "right of line (m)");
    let text = if stretch > 1.05 {
        format!("Seen from above, stretched {stretch:.1} times across the line")
    } else {
        "Seen from above, true to scale".to_owned()
    };
    plan.heading(canvas, &text);
    plan.legend(canvas, 168.0, colour::ORANGE, "7 4", "line");
    plan.legend(canvas, 98.0, colour::BLUE, "", "path");

    let ends = [(0.0, 0.0), (length, 0.0)];
    plan.level(canvas, 0.0, colour::GRID, "");
    let (from, to) = (plan.x.from.max(0.0), plan.x.to.min(ends[1].0));
    if to > from {
        canvas.dashed(plan, from, to, 0.0, colour::ORANGE);
    }
    plan.curve(canvas, path.iter().copied(), colour::BLUE, 2.2);
    for end in ends {
        if end.0 >= plan.x.from && end.0 <= plan.x.to {
            canvas.circle(plan.x(end.0), plan.y(end.1), 4.0, "white", colour::ORANGE);
        }
    }
    for (point, fill, label) in [
        (path.first(), "white", "start"),
        (path.last(), colour::BLUE, "end"),
    ] {
        if let Some(&(x, y)) = point {
            canvas.circle(plan.x(x), plan.y(y), 5.0, fill, colour::BLUE);
            let above = if plan.y(y) < plan.top + 24.0 {
                20.0
            } else {
                -10.0
            };
            let anchor = if plan.x(x) > plan.left + 0.95 * plan.width {
                Anchor::End
            } else {
                Anchor::Middle
            };
            canvas.text(
                plan.x(x),
                plan.y(y) + above,
                12.0,
                anchor,
                colour::BLUE,
                label,
            );
        }
    }
    plan.frame(canvas);
}

/// Shades the times of autonomous driving and those without a fixed solution.
fn background(canvas: &mut Canvas, run: &Run, panel: &Panel) {
    for (from, until) in autonomous_spans(run) {
        panel.shade(canvas, seconds(from), seconds(until), colour::SHADE);
    }
    let mut lost: Option<f64> = None;
    for state in run.states {
        match (state.fix == Fix::Fixed, lost) {
            (false, None) => lost = Some(seconds(state.at)),
            (true, Some(from)) => {
                panel.shade(canvas, from, seconds(state.at), colour::WARNING);
                lost = None;
            }
            _ => {}
        }
    }
    if let Some(from) = lost {
        panel.shade(canvas, from, panel.x.to, colour::WARNING);
    }
}

/// Marks the beginnings of autonomous runs, settling, and the scenario's events.
fn marks(canvas: &mut Canvas, run: &Run, summary: &Summary, panel: &Panel) {
    for autonomous in &summary.autonomous_runs {
        let from = autonomous.from_seconds;
        panel.mark(canvas, from, colour::MUTED, "autonomous");
        if let Some(settling) = autonomous.settling_seconds {
            panel.mark(
                canvas,
                from + settling,
                colour::GREEN,
                &format!("settled, {settling:.1} s"),
            );
        }
    }
    for stop in &summary.stops {
        panel.mark(canvas, stop.at_seconds, colour::ORANGE, &stop.event);
    }
    for change in &run.scenario.fix {
        if change.state == Fix::Fixed {
            panel.mark(canvas, change.at.get(), colour::ORANGE, "fix back");
        }
    }
}
