//! Chapter 5: the calibration of the steering.

use world::{report::Span, time::seconds};

use super::{
    drawn::{Curves, Drawn, FURROW, Number, OTHER, PLAIN},
    takes::{Points, Take, Takes},
};
use crate::{
    calibrate::{self, Calibration},
    page::chart::Chart,
};

/// The calibration of the drive, from its bus log.
fn calibration(takes: &Takes<'_>) -> Option<Calibration> {
    let finished = takes.of(Take::Calibration);
    calibrate::calibrate(finished.vehicle(), &finished.candump()).ok()
}

/// Dots and a line.
fn fit(
    id: &'static str,
    title: &'static str,
    what: &'static str,
    axes: [&'static str; 2],
    dots: &Points,
    lines: &[Points],
) -> maud::Markup {
    let all = || dots.iter().chain(lines.iter().flatten());
    let none = Span { from: 0.0, to: 1.0 };
    let span = |values: Option<Span>| values.unwrap_or(none).padded(0.06, 1e-6);
    let x = span(Span::of(all().map(|point| point.0)));
    let y = span(Span::of(all().map(|point| point.1)));
    let mut chart = Chart::new(id, x, y, 260.0);
    chart.x_axis(axes[0]);
    chart.y_axis(axes[1]);
    chart.curve(lines, PLAIN);
    for &dot in dots {
        chart.dot(dot, "dot", "");
    }
    chart.finish(title, what)
}

/// Figure 5.18.
pub(super) fn potentiometer(takes: &Takes<'_>) -> Drawn {
    let Some(found) = calibration(takes) else {
        return Drawn::default();
    };
    let dots: Points = found
        .circles
        .iter()
        .map(|circle| (circle.angle, circle.counts))
        .collect();
    let counts = |angle: f64| found.centre + found.counts_per_degree * angle;
    let line = vec![[-25.0, 25.0].map(|angle| (angle, counts(angle))).to_vec()];
    let machine = takes
        .of(Take::Calibration)
        .vehicle()
        .manifest()
        .machine
        .as_ref();
    let slope = machine.map(|machine| machine.potentiometer.slope.get().to_radians());
    Drawn {
        charts: vec![fit(
            "f5-18",
            "Reading of the steering's potentiometer",
            "Dots: circles that were driven by hand, their angle from the radius of the antenna's path; line: the fit of \
             `cargo xtask calibrate`.",
            [
                "steering angle, deg, positive to the right",
                "reading, counts",
            ],
            &dots,
            &line,
        )],
        numbers: vec![
            Number::new("slope of the fit", "counts/deg", 2).furrow(Some(found.counts_per_degree)),
            Number::new("slope of the machine", "counts/deg", 2).furrow(slope),
            Number::new("residual of the circles, root mean square", "deg", 3)
                .furrow(Some(found.angle_residual)),
        ],
    }
}

/// The part of the drive that is shown, s since the power came on: movements at all rates.
const MOVEMENTS: Span = Span {
    from: 2.0,
    to: 26.0,
};

/// Figure 5.19.
pub(super) fn movements(takes: &Takes<'_>) -> Drawn {
    let take = Take::Calibration;
    let finished = takes.of(take);
    let run = finished.run();
    let shown = |points: Points| -> Points {
        let inside = |time: f64| (MOVEMENTS.from..MOVEMENTS.to).contains(&time);
        points
            .into_iter()
            .filter(|(time, _)| inside(*time))
            .collect()
    };
    let angles = run.states.iter();
    let angles = angles.map(|state| (seconds(state.at), state.steering.to_degrees()));
    let commands = shown(takes.signal_from_start(take, "Command.SteeringRate"));
    Drawn {
        charts: vec![
            Curves {
                id: "f5-19",
                title: "Steering angle and command",
                what: "Green: the angle of the wheels, deg; orange: the commanded rate, deg/s. The angle is the integral of the \
                       command.",
                axes: [super::drawn::TIME, "deg, deg/s"],
                curves: &[(OTHER, &commands), (FURROW, &shown(angles.collect()))],
                level: Some(0.0),
                mark: None,
                down: false,
            }
            .draw(),
        ],
        numbers: Vec::new(),
    }
}

/// Figure 5.20.
pub(super) fn rates(takes: &Takes<'_>) -> Drawn {
    let Some(found) = calibration(takes) else {
        return Drawn::default();
    };
    let dots: Points = found
        .movements
        .iter()
        .map(|movement| (movement.rate, movement.effort * 100.0))
        .collect();
    let side = |side: &calibrate::Side, sign: f64| {
        let effort = |rate: f64| {
            sign * 100.0 * (side.dead_band + (1.0 - side.dead_band) * rate / side.full_rate)
        };
        [0.0, 25.0].map(|rate| (sign * rate, effort(rate))).to_vec()
    };
    Drawn {
        charts: vec![fit(
            "f5-20",
            "Effort of the steering's motor for a rate",
            "Dots: movements of the drive; lines: the fit of `cargo xtask calibrate`, one for each direction, with the dead \
             band between them.",
            ["steering rate, deg/s, positive to the right", "effort, %"],
            &dots,
            &[side(&found.left, -1.0), side(&found.right, 1.0)],
        )],
        numbers: vec![
            Number::new("dead band to the right", "%", 1)
                .furrow(Some(found.right.dead_band * 100.0)),
            Number::new("dead band to the left", "%", 1).furrow(Some(found.left.dead_band * 100.0)),
            Number::new("rate at full effort to the right", "deg/s", 2)
                .furrow(Some(found.right.full_rate)),
            Number::new("rate at full effort to the left", "deg/s", 2)
                .furrow(Some(found.left.full_rate)),
        ],
    }
}
