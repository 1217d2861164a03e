//! Chapter 7: the steering model, and the track tests.

use super::{
    drawn::{Curves, Drawn, FURROW, Number, OTHER, PLAIN, histogram},
    takes::{Points, Take, Takes},
};

const LAWS: &str = "Blue: the law of the thesis; green: Furrow's.";
const TIME: &str = super::drawn::TIME;

/// The settling time of the thesis's track tests, s.
const SETTLED: f64 = 15.0;

/// Numbers of a track test under both laws: mean, deviation and settling.
fn numbers(takes: &Takes<'_>, plain: Take, furrow: Take, mean: f64, settled: bool) -> Vec<Number> {
    let aggregate = |take| {
        let figures = takes.track(take).0?;
        let arrival = figures.arrival;
        let aggregate = crate::experiment::aggregate::Aggregate::of(&[figures]);
        Some((aggregate, arrival))
    };
    let (plain, furrow) = (aggregate(plain), aggregate(furrow));
    let mut settling = Number::new("time until the error stays about its mean", "s", 1)
        .plain(plain.as_ref().and_then(|one| one.1))
        .furrow(furrow.as_ref().and_then(|one| one.1));
    if settled {
        settling = settling.thesis(SETTLED);
    }
    vec![
        Number::new("mean cross-track error in steady state", "cm", 2)
            .thesis(mean)
            .plain(plain.as_ref().map(|one| one.0.mean_cm))
            .furrow(furrow.as_ref().map(|one| one.0.mean_cm)),
        Number::new("its standard deviation", "cm", 2)
            .plain(plain.as_ref().map(|one| one.0.deviation_cm))
            .furrow(furrow.as_ref().map(|one| one.0.deviation_cm)),
        settling,
    ]
}

/// A chart of one state under both laws.
fn state(
    id: &'static str,
    title: &'static str,
    unit: &'static str,
    plain: &Points,
    furrow: &Points,
) -> maud::Markup {
    Curves {
        id,
        title,
        what: LAWS,
        axes: [TIME, unit],
        curves: &[(PLAIN, plain), (FURROW, furrow)],
        level: Some(0.0),
        mark: None,
        down: false,
    }
    .draw()
}

/// All three states under both laws.
fn states(takes: &Takes<'_>, ids: [&'static str; 3], plain: Take, furrow: Take) -> Drawn {
    let chart = |id, title, unit, of: fn(&Takes<'_>, Take) -> Points| {
        state(id, title, unit, &of(takes, plain), &of(takes, furrow))
    };
    let [error, heading, angle] = ids;
    Drawn {
        charts: vec![
            chart(error, "Cross-track error", "m", |takes, take| {
                takes.errors(take)
            }),
            chart(heading, "Heading error", "deg", |takes, take| {
                takes.headings(take)
            }),
            chart(angle, "Steering angle", "deg", |takes, take| {
                takes.angles(take)
            }),
        ],
        numbers: Vec::new(),
    }
}

/// The way over ground under both laws.
fn way(takes: &Takes<'_>, id: &'static str, plain: Take, furrow: Take) -> maud::Markup {
    Curves {
        id,
        title: "Way of the antenna",
        what: "The line leads to the north, which is on the right; blue: the law of the thesis; green: Furrow's.",
        axes: ["north, m", "east, m"],
        curves: &[(PLAIN, &takes.way(plain)), (FURROW, &takes.way(furrow))],
        level: Some(0.0),
        mark: None,
        down: true,
    }
    .draw()
}

fn error(takes: &Takes<'_>, id: &'static str, plain: Take, furrow: Take) -> maud::Markup {
    state(
        id,
        "Cross-track error",
        "m",
        &takes.errors(plain),
        &takes.errors(furrow),
    )
}

fn errors_over_time(takes: &Takes<'_>, id: &'static str, plain: Take, furrow: Take) -> Drawn {
    Drawn {
        charts: vec![error(takes, id, plain, furrow)],
        numbers: Vec::new(),
    }
}

fn distribution(takes: &Takes<'_>, id: &'static str, plain: Take, furrow: Take) -> maud::Markup {
    let steady = |take| takes.track(take).0.map_or(Vec::new(), |one| one.steady);
    histogram(
        id,
        "Cross-track error in steady state",
        LAWS,
        &[(PLAIN, &steady(plain)), (FURROW, &steady(furrow))],
    )
}

/// The thesis's simulation: Euler steps of its model (7.2.4), and its control input.
fn euler(gains: [f64; 3], speed: f64, limit: f64) -> [Points; 3] {
    const STEP: f64 = 0.1;
    const LENGTHS: [f64; 2] = [0.255, 0.845];
    let wheelbase = LENGTHS[0] + LENGTHS[1];
    let mut state = [1.0_f64, 0.0, 0.0];
    let mut points = [const { Vec::new() }; 3];
    for step in 0..=600 {
        let time = f64::from(step) * STEP;
        let shown = [state[0], state[1].to_degrees(), state[2].to_degrees()];
        for (points, value) in points.iter_mut().zip(shown) {
            points.push((time, value));
        }
        let input: f64 = -gains.iter().zip(&state).map(|(k, x)| k * x).sum::<f64>();
        let [error, heading, angle] = state;
        state = [
            error + STEP * speed * (heading + angle * LENGTHS[0] / wheelbase),
            heading + STEP * speed * angle / wheelbase,
            (angle + STEP * input).clamp(-limit, limit),
        ];
    }
    points
}

/// Figure 7.9.
pub(super) fn model(takes: &Takes<'_>) -> Drawn {
    let [error, heading, angle] = euler([5.0, 4.0, 3.0], 0.25, f64::INFINITY);
    let largest = |points: &Points| points.iter().map(|point| point.1.abs()).fold(0.0, f64::max);
    let steepest = largest(&angle);
    let of = Take::Model;
    let chart = |id, title, unit, model: &Points, machine: &Points| {
        Curves {
            id,
            title,
            what: "Blue: the model of the thesis, which has no limits, at 0.25 m/s; orange: the images under the same gains at \
                   0.3 m/s, with a steering angle of 25 deg at most.",
            axes: [TIME, unit],
            curves: &[(PLAIN, model), (OTHER, machine)],
            level: Some(0.0),
            mark: None,
            down: false,
        }
        .draw()
    };
    let angles = takes.angles(of);
    Drawn {
        charts: vec![
            chart(
                "f7-9-y",
                "Cross-track error",
                "m",
                &error,
                &takes.errors(of),
            ),
            chart(
                "f7-9-p",
                "Heading error",
                "deg",
                &heading,
                &takes.headings(of),
            ),
            chart("f7-9-d", "Steering angle", "deg", &angle, &angles),
        ],
        numbers: vec![
            Number::new(
                "largest steering angle in the model of the thesis",
                "deg",
                1,
            )
            .plain(Some(steepest)),
            Number::new(
                "largest steering angle of the images under the same gains",
                "deg",
                1,
            )
            .plain(Some(largest(&angles))),
        ],
    }
}

/// Millimetres as metres.
fn metres(points: Points) -> Points {
    let points = points.into_iter();
    points.map(|(time, value)| (time, value / 1000.0)).collect()
}

/// Headings from -180 to 180 degrees.
fn half_turns(points: Points) -> Points {
    let points = points.into_iter();
    let turn = |value: f64| (value + 180.0).rem_euclid(360.0) - 180.0;
    points.map(|(time, value)| (time, turn(value))).collect()
}

/// The cross-track errors of the measured positions, m.
fn measured_errors(takes: &Takes<'_>, of: Take) -> Points {
    let scenario = takes.of(of).run().scenario;
    let Some(line) = &scenario.line else {
        return Vec::new();
    };
    let norths = metres(takes.signal(of, "Position.North")).into_iter();
    let easts = metres(takes.signal(of, "Position.East")).into_iter();
    let both = norths.zip(easts);
    both.map(|((time, north), (_, east))| (time, line.locate(north, east).1))
        .collect()
}

/// From then on the estimator knows the vehicle's heading for sure, s.
const KNOWN: f64 = 5.0;

/// Figure 7.13.
pub(super) fn estimation(takes: &Takes<'_>) -> Drawn {
    let of = Take::Estimation;
    let what = "Orange: measured; blue: estimated; green: the truth.";
    let chart = |id, title, unit, measured: &Points, estimated: &Points, truth: &Points| {
        Curves {
            id,
            title,
            what,
            axes: [TIME, unit],
            curves: &[(OTHER, measured), (PLAIN, estimated), (FURROW, truth)],
            level: Some(0.0),
            mark: None,
            down: false,
        }
        .draw()
    };
    let truth = takes.errors(of);
    let measured = measured_errors(takes, of);
    let estimated: Points = metres(takes.signal(of, "LogGuidance.CrossTrackError"));
    let deviation = |points: &Points| {
        let at = |time: f64| {
            let next = truth.partition_point(|point| point.0 < time);
            truth.get(next.min(truth.len().saturating_sub(1)))
        };
        let squares = points
            .iter()
            .filter(|(time, _)| *time >= KNOWN)
            .filter_map(|(time, value)| Some((value - at(*time)?.1).powi(2)));
        let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), one| (sum + one, count + 1.0));
        (count > 0.0).then(|| 100.0 * f64::sqrt(sum / count))
    };
    let numbers = vec![
        Number::new(
            "measured cross-track error beside the truth after 5 s, root mean square",
            "cm",
            2,
        )
        .furrow(deviation(&measured)),
        Number::new(
            "estimated cross-track error beside the truth after 5 s, root mean square",
            "cm",
            2,
        )
        .furrow(deviation(&estimated)),
    ];
    Drawn {
        charts: vec![
            chart(
                "f7-13-y",
                "Cross-track error",
                "m",
                &measured,
                &estimated,
                &truth,
            ),
            chart(
                "f7-13-p",
                "Heading error",
                "deg",
                &half_turns(takes.signal(of, "Heading.Heading")),
                &takes.signal(of, "LogMotion.Psi"),
                &takes.headings(of),
            ),
        ],
        numbers,
    }
}

/// Figure 7.14.
pub(super) fn route(takes: &Takes<'_>) -> Drawn {
    let run = takes.of(Take::One).run();
    let line = run.scenario.line.as_ref();
    let ends: Points = line.map_or(Vec::new(), |line| {
        let ends = [&line.from, &line.to];
        ends.map(|end| (end.north.get(), end.east.get())).to_vec()
    });
    let length = line.map(|line| {
        let (north, east) = (
            line.to.north.get() - line.from.north.get(),
            line.to.east.get() - line.from.east.get(),
        );
        north.hypot(east)
    });
    let way = takes.way(Take::One);
    Drawn {
        charts: vec![
            Curves {
                id: "f7-14",
                title: "Route",
                what: "Orange: the line between the two waypoints; blue: the first 45 s of the first test.",
                axes: ["north, m", "east, m"],
                curves: &[(OTHER, &ends), (PLAIN, &way)],
                level: None,
                mark: None,
                down: true,
            }
            .draw(),
        ],
        numbers: vec![Number::new("length of the line", "m", 0).thesis(243.0).furrow(length)],
    }
}

/// Figure 7.15.
pub(super) fn first_states(takes: &Takes<'_>) -> Drawn {
    let ids = ["f7-15-y", "f7-15-p", "f7-15-d"];
    let mut drawn = states(takes, ids, Take::One, Take::OneFurrow);
    drawn.numbers = numbers(takes, Take::One, Take::OneFurrow, -2.7, true);
    drawn
}

/// Figure 7.16.
pub(super) fn first_way(takes: &Takes<'_>) -> Drawn {
    Drawn {
        charts: vec![way(takes, "f7-16", Take::One, Take::OneFurrow)],
        numbers: Vec::new(),
    }
}

/// Figure 7.17.
pub(super) fn first_distribution(takes: &Takes<'_>) -> Drawn {
    Drawn {
        charts: vec![distribution(takes, "f7-17", Take::One, Take::OneFurrow)],
        numbers: numbers(takes, Take::One, Take::OneFurrow, -2.7, true),
    }
}

/// Figure 7.18.
pub(super) fn first_error(takes: &Takes<'_>) -> Drawn {
    errors_over_time(takes, "f7-18", Take::One, Take::OneFurrow)
}

/// Figure 7.19.
pub(super) fn half_gains(takes: &Takes<'_>) -> Drawn {
    let (half, whole) = (takes.errors(Take::Half), takes.errors(Take::One));
    // As far as the response is not steady yet.
    let steepest = |points: &Points| {
        let pairs = points.iter().zip(points.iter().skip(50));
        let rates = pairs.map(|(one, other)| (one.1 - other.1) / (other.0 - one.0));
        rates.fold(0.0, f64::max)
    };
    Drawn {
        charts: vec![
            Curves {
                id: "f7-19",
                title: "Cross-track error",
                what: "Blue: gains of about half the size; orange: those of the first test, both under the law of the thesis.",
                axes: [TIME, "m"],
                curves: &[(OTHER, &whole), (PLAIN, &half)],
                level: Some(0.0),
                mark: None,
                down: false,
            }
            .draw(),
        ],
        numbers: vec![
            Number::new("fastest approach with half the gains", "m/s", 2).plain(Some(steepest(&half))),
            Number::new("fastest approach with the whole gains", "m/s", 2)
                .plain(Some(steepest(&whole))),
        ],
    }
}

/// Figure 7.20.
pub(super) fn second_way(takes: &Takes<'_>) -> Drawn {
    Drawn {
        charts: vec![way(takes, "f7-20", Take::Five, Take::FiveFurrow)],
        numbers: Vec::new(),
    }
}

/// Figure 7.21.
pub(super) fn second_states(takes: &Takes<'_>) -> Drawn {
    let ids = ["f7-21-y", "f7-21-p", "f7-21-d"];
    states(takes, ids, Take::Five, Take::FiveFurrow)
}

/// Figure 7.22.
pub(super) fn second_error(takes: &Takes<'_>) -> Drawn {
    Drawn {
        charts: vec![
            error(takes, "f7-22-t", Take::Five, Take::FiveFurrow),
            distribution(takes, "f7-22-h", Take::Five, Take::FiveFurrow),
        ],
        numbers: numbers(takes, Take::Five, Take::FiveFurrow, -4.4, true),
    }
}

/// Figure 7.25.
pub(super) fn loaded_way(takes: &Takes<'_>) -> Drawn {
    Drawn {
        charts: vec![way(takes, "f7-25", Take::Loaded, Take::LoadedFurrow)],
        numbers: Vec::new(),
    }
}

/// Figure 7.26.
pub(super) fn loaded_commands(takes: &Takes<'_>) -> Drawn {
    let (plain, furrow) = (takes.track(Take::Loaded), takes.track(Take::LoadedFurrow));
    let changes = |figures: &Option<crate::experiment::measure::Figures>| {
        let figures = figures.as_ref()?;
        Some(figures.sign_changes as f64 / figures.steady_seconds)
    };
    Drawn {
        charts: vec![state(
            "f7-26",
            "Commanded steering rate",
            "deg/s",
            &plain.1,
            &furrow.1,
        )],
        numbers: vec![
            Number::new("changes of the command's sign in steady state", "1/s", 2)
                .plain(changes(&plain.0))
                .furrow(changes(&furrow.0)),
        ],
    }
}

/// Figure 7.27.
pub(super) fn loaded_error(takes: &Takes<'_>) -> Drawn {
    errors_over_time(takes, "f7-27", Take::Loaded, Take::LoadedFurrow)
}

/// Figure 7.28.
pub(super) fn loaded_distribution(takes: &Takes<'_>) -> Drawn {
    Drawn {
        charts: vec![distribution(
            takes,
            "f7-28",
            Take::Loaded,
            Take::LoadedFurrow,
        )],
        numbers: numbers(takes, Take::Loaded, Take::LoadedFurrow, 1.0, false),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The thesis's gains ask for more than 80 deg from 1 m beside the line, and bring the model there.
    #[test]
    fn the_model_of_the_thesis_comes_to_its_line() {
        let [error, heading, angle] = euler([5.0, 4.0, 3.0], 0.25, f64::INFINITY);
        let steepest = angle.iter().map(|point| point.1.abs()).fold(0.0, f64::max);
        assert!((80.0..83.0).contains(&steepest), "{steepest}");
        for points in [error, heading, angle] {
            assert!(points.last().unwrap().1.abs() < 0.01);
        }
    }
}
