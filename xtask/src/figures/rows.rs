//! Chapter 2: a robot between the rows of a crop.

use world::time::seconds;

use super::{
    drawn::{Curves, Drawn, FURROW, Number, OTHER, PLAIN},
    takes::{Points, Take, Takes},
};

const TIME: &str = super::drawn::TIME;

/// The thesis's error: filtered distance on the right less that on the left, cm.
fn differences(takes: &Takes<'_>, take: Take) -> Points {
    let until = over(takes, take);
    let pairs = takes.distances(take).into_iter();
    let points = pairs.map(|pair| (seconds(pair.at), (pair.right - pair.left) * 100.0));
    points.filter(|(time, _)| *time <= until).collect()
}

/// When the drive of a robot was over, s: it touched something, was outside its row or at its end, or had
/// come to rest.
fn over(takes: &Takes<'_>, take: Take) -> f64 {
    let run = takes.of(take).run();
    let end = seconds(world::SimTime::from_ticks(run.duration.as_ticks()));
    let Some(rover) = run.rover else {
        return end;
    };
    let contact = rover.drive.contact().map(|touch| seconds(touch.at));
    let samples = || rover.drive.samples().iter();
    let outside = samples()
        .find(|one| one.right.abs() > OUTSIDE)
        .map(|one| seconds(one.at));
    let moving = samples().rfind(|one| one.efforts != [0.0; 2]);
    let rest = moving.map(|one| seconds(one.at));
    let last = rover.drive.rows().length() - MARGIN;
    let ended = samples().find(|one| one.station > last);
    let ended = ended.map(|one| seconds(one.at));
    let ends = [contact, outside, rest, ended];
    ends.into_iter().flatten().fold(end, f64::min)
}

/// The sensors look so far ahead, m: the last metre of a row does not count.
const MARGIN: f64 = 1.0;

/// Half the distance of the rows: beyond it the robot's middle is in another one, m.
const OUTSIDE: f64 = 0.381;

/// Mean of the points whose time lies in a range.
fn mean(points: &Points, from: f64, until: f64) -> Option<f64> {
    let inside = points
        .iter()
        .filter(|(time, _)| (from..until).contains(time));
    let (sum, count) = inside.fold((0.0, 0.0), |(sum, count), (_, value)| {
        (sum + value, count + 1.0)
    });
    (count > 0.0).then(|| sum / count)
}

/// When the robot was between these places of its row, s.
fn between(takes: &Takes<'_>, take: Take, from: f64, until: f64) -> (f64, f64) {
    let run = takes.of(take).run();
    let Some(rover) = run.rover else {
        return (0.0, 0.0);
    };
    let at = |station: f64| {
        let mut samples = rover.drive.samples().iter();
        let found = samples.find(|one| one.station >= station);
        found.map(|one| seconds(one.at))
    };
    let end = over(takes, take);
    (
        at(from).unwrap_or(0.0),
        at(until).map_or(end, |at| at.min(end)),
    )
}

/// Figure 2.17.
pub(super) fn filtered(takes: &Takes<'_>) -> Drawn {
    let take = Take::Poles(1);
    let pairs = takes.distances(take);
    let until = over(takes, take);
    let shown = |mut points: Points| -> Points {
        points.retain(|(time, _)| *time <= until);
        points
    };
    let side = |left: bool| -> Points {
        let value = |pair: &world::report::DistancePair| if left { pair.left } else { pair.right };
        let points = pairs.iter();
        shown(
            points
                .map(|pair| (seconds(pair.at), value(pair) * 100.0))
                .collect(),
        )
    };
    let chart = |id, title, raw: &Points, filtered: &Points| {
        Curves {
            id,
            title,
            what: "Orange: as the sensor gives it; blue: as the law of the thesis filters it.",
            axes: [TIME, "cm"],
            curves: &[(OTHER, raw), (PLAIN, filtered)],
            level: None,
            mark: None,
            down: false,
        }
        .draw()
    };
    let (left, right) = (side(true), side(false));
    let raw = |path| shown(takes.signal_from_start(take, path));
    let (raw_left, raw_right) = (raw("DistanceLeft.Distance"), raw("DistanceRight.Distance"));
    let deviation = |points: &Points| {
        let (from, until) = between(takes, take, 2.5, 6.0);
        let inside = || {
            let points = points.iter();
            points.filter(|(time, _)| (from..until).contains(time))
        };
        let middle = mean(points, from, until)?;
        let squares: f64 = inside().map(|(_, value)| (value - middle).powi(2)).sum();
        Some((squares / inside().count().max(1) as f64).sqrt())
    };
    let spread = |what, left: &Points, right: &Points| {
        let both = deviation(left).zip(deviation(right));
        Number::new(what, "cm", 1).plain(both.map(|(left, right)| f64::midpoint(left, right)))
    };
    Drawn {
        charts: vec![
            chart("f2-17-l", "Distance to the left row", &raw_left, &left),
            chart("f2-17-r", "Distance to the right row", &raw_right, &right),
        ],
        numbers: vec![
            spread(
                "deviation of the samples between the poles",
                &raw_left,
                &raw_right,
            ),
            spread("deviation of the filtered ones", &left, &right),
        ],
    }
}

/// A chart of the difference under both laws.
fn chart(
    id: &'static str,
    what: &'static str,
    plain: &Points,
    furrow: &Points,
    mark: Option<(f64, &'static str)>,
) -> maud::Markup {
    Curves {
        id,
        title: "Difference of the filtered distances, right less left",
        what,
        axes: [TIME, "cm"],
        curves: &[(PLAIN, plain), (FURROW, furrow)],
        level: Some(0.0),
        mark,
        down: false,
    }
    .draw()
}

/// Where the barriers step apart, m along the row.
const STEP: f64 = 4.0;

/// A response to the step of the barriers. The robot passes the step at 4 m.
fn step(takes: &Takes<'_>, id: &'static str, plain: Take, what: &'static str) -> Drawn {
    let furrow = Take::StepFurrow;
    let (one, other) = (differences(takes, plain), differences(takes, furrow));
    let (passed, _) = between(takes, plain, STEP, 12.0);
    let end = |take, points: &Points| {
        let (from, until) = between(takes, take, 10.0, 12.0);
        mean(points, from, until)
    };
    Drawn {
        charts: vec![chart(
            id,
            what,
            &one,
            &other,
            Some((passed, "step of the barriers")),
        )],
        numbers: vec![
            Number::new("mean difference from 10 to 12 m of the row", "cm", 2)
                .plain(end(plain, &one))
                .furrow(end(furrow, &other)),
        ],
    }
}

/// Figure 2.19.
pub(super) fn proportional(takes: &Takes<'_>) -> Drawn {
    let what = "Blue: the proportional law of the thesis; green: Furrow's law.";
    step(takes, "f2-19", Take::StepP, what)
}

/// Figure 2.20.
pub(super) fn integral(takes: &Takes<'_>) -> Drawn {
    let what = "Blue: the law of the thesis with an integral; green: Furrow's law.";
    step(takes, "f2-20", Take::StepPi, what)
}

/// A drive along a row: the difference, and its mean between two places of the row.
fn drive(
    takes: &Takes<'_>,
    id: &'static str,
    [plain, furrow]: [Take; 2],
    [from, until]: [f64; 2],
    thesis: f64,
) -> Drawn {
    let (one, other) = (differences(takes, plain), differences(takes, furrow));
    let error = |take, points: &Points| {
        let (from, until) = between(takes, take, from, until);
        mean(points, from, until).map(f64::abs)
    };
    let offset = |take| {
        let run = takes.of(take).run();
        let end = over(takes, take);
        let samples = run.rover?.drive.samples().iter();
        let inside =
            samples.filter(|one| (from..until).contains(&one.station) && seconds(one.at) <= end);
        let (sum, count) = inside.fold((0.0, 0.0), |(sum, count), one| {
            (sum + one.right.abs(), count + 1.0)
        });
        (count > 0.0).then(|| 100.0 * sum / count)
    };
    let way = |take| {
        let end = over(takes, take);
        let samples = takes.of(take).run().rover?.drive.samples();
        let driven = samples.iter().filter(|one| seconds(one.at) <= end);
        driven.map(|one| one.station).reduce(f64::max)
    };
    Drawn {
        charts: vec![chart(
            id,
            "Blue: the law of the thesis; green: Furrow's law.",
            &one,
            &other,
            None,
        )],
        numbers: vec![
            Number::new("mean error: the mean difference, its size", "cm", 1)
                .thesis(thesis)
                .plain(error(plain, &one))
                .furrow(error(furrow, &other)),
            Number::new("mean distance from the middle of the row", "cm", 1)
                .plain(offset(plain))
                .furrow(offset(furrow)),
            Number::new(
                "way along the row until it ended, or the robot touched or left it",
                "m",
                1,
            )
            .plain(way(plain))
            .furrow(way(furrow)),
        ],
    }
}

/// The poles of the simulated row, m along it.
const POLES: [f64; 2] = [2.0, 6.5];
/// The field row.
const FIELD: [f64; 2] = [0.3, 21.8];

/// Figure 2.22.
pub(super) fn poles_1(takes: &Takes<'_>) -> Drawn {
    drive(
        takes,
        "f2-22",
        [Take::Poles(1), Take::PolesFurrow(1)],
        POLES,
        9.1,
    )
}

/// Figure 2.23.
pub(super) fn poles_2(takes: &Takes<'_>) -> Drawn {
    drive(
        takes,
        "f2-23",
        [Take::Poles(2), Take::PolesFurrow(2)],
        POLES,
        4.0,
    )
}

/// Figure 2.24.
pub(super) fn poles_3(takes: &Takes<'_>) -> Drawn {
    drive(
        takes,
        "f2-24",
        [Take::Poles(3), Take::PolesFurrow(3)],
        POLES,
        7.9,
    )
}

/// Figure 2.25.
pub(super) fn field_1(takes: &Takes<'_>) -> Drawn {
    drive(
        takes,
        "f2-25",
        [Take::Field(1), Take::FieldFurrow(1)],
        FIELD,
        5.8,
    )
}

/// Figure 2.26.
pub(super) fn field_2(takes: &Takes<'_>) -> Drawn {
    drive(
        takes,
        "f2-26",
        [Take::Field(2), Take::FieldFurrow(2)],
        FIELD,
        8.4,
    )
}

/// Figure 2.27.
pub(super) fn field_3(takes: &Takes<'_>) -> Drawn {
    drive(
        takes,
        "f2-27",
        [Take::Field(3), Take::FieldFurrow(3)],
        FIELD,
        5.0,
    )
}
