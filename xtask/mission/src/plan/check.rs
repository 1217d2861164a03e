//! Checks the values of a plan.

use super::{End, Join, Leg, Plan, Problem, Shape};
use crate::place::{FARTHEST, Local};
use crate::polygon;

/// Most characters of a name.
pub const LONGEST_NAME: usize = 64;
/// Most legs of a plan.
pub const MOST_LEGS: usize = 10_000;
/// Most points of a curve or corners of a fence.
pub const MOST_POINTS: usize = 20_000;
/// Fastest leg, m/s.
pub const FASTEST: f64 = 10.0;
/// Widest implement, m.
pub const WIDEST: f64 = 50.0;
/// Shortest leg, m.
pub const SHORTEST: f64 = 0.1;
/// Least area of a fence, m2.
pub const LEAST_FENCE: f64 = 1.0;
/// Least area of an obstacle, m2: it may be a pole.
pub const LEAST_OBSTACLE: f64 = 1e-4;
/// Least distance between two points of a curve that follow each other, m.
const CLOSEST: f64 = 0.001;
/// Largest distance between the end of a leg and the beginning of one that continues it, m.
pub const GAP: f64 = 0.01;
/// A point this far outside the fence still counts as on it, m: coordinates of files are rounded.
const ON_FENCE: f64 = 1e-3;

type Outcome = Result<(), String>;

pub(super) fn check(plan: &Plan) -> Result<(), Problem> {
    let whole = |what| Problem { leg: None, what };
    header(plan).map_err(whole)?;
    fence(&plan.fence).map_err(whole)?;
    for (index, obstacle) in plan.obstacles.iter().enumerate() {
        let field = format!("obstacle {}", index + 1);
        ring(&field, obstacle).map_err(whole)?;
    }
    for (index, leg) in plan.legs.iter().enumerate() {
        let last = plan.legs.len() - 1;
        let before = match (index, plan.end) {
            (0, End::Stop) => None,
            (0, End::Repeat) => plan.legs.get(last),
            _ => plan.legs.get(index - 1),
        };
        self::leg(leg, before, plan).map_err(|what| Problem {
            leg: Some(index),
            what,
        })?;
    }
    Ok(())
}

/// A number that must lie in a range, in a sentence with its unit.
fn within(field: &str, value: f64, least: f64, most: f64, unit: &str) -> Outcome {
    if (least..=most).contains(&value) {
        return Ok(());
    }
    Err(format!(
        "{field}: {value} {unit} is out of range, it takes {least} to {most} {unit}"
    ))
}

fn header(plan: &Plan) -> Outcome {
    let length = plan.name.chars().count();
    if length == 0 || length > LONGEST_NAME || plan.name.chars().any(char::is_control) {
        return Err(format!(
            "name: {length} characters, 1 to {LONGEST_NAME} without line breaks are accepted"
        ));
    }
    let origin = plan.origin;
    within("origin.latitude", origin.place.latitude, -89.0, 89.0, "deg")?;
    within(
        "origin.longitude",
        origin.place.longitude,
        -180.0,
        180.0,
        "deg",
    )?;
    within("origin.height", origin.height, -500.0, 9000.0, "m")?;
    if let Some(width) = plan.width
        && !(width > 0.0 && width <= WIDEST)
    {
        return Err(format!(
            "width: {width} m is out of range, it takes above 0 to {WIDEST} m"
        ));
    }
    match plan.legs.len() {
        1..=MOST_LEGS => Ok(()),
        count => Err(format!(
            "leg: there are {count}, 1 to {MOST_LEGS} are accepted"
        )),
    }
}

fn coordinates(field: &str, place: Local) -> Outcome {
    within(
        &format!("{field}, north"),
        place.north,
        -FARTHEST,
        FARTHEST,
        "m",
    )?;
    within(
        &format!("{field}, east"),
        place.east,
        -FARTHEST,
        FARTHEST,
        "m",
    )
}

fn fence(corners: &[Local]) -> Outcome {
    if corners.is_empty() {
        return Ok(());
    }
    ring("fence", corners)
}

/// A polygon without crossings that encloses something.
fn ring(field: &str, corners: &[Local]) -> Outcome {
    if !(3..=MOST_POINTS).contains(&corners.len()) {
        return Err(format!(
            "{field}: {} corners, 3 to {MOST_POINTS} are accepted",
            corners.len()
        ));
    }
    for (index, corner) in corners.iter().enumerate() {
        coordinates(&format!("corner {} of {field}", index + 1), *corner)?;
    }
    if let Some((one, other)) = polygon::crossing(corners) {
        return Err(format!(
            "{field}: the side from corner {} meets the side from corner {}, a polygon without crossings is accepted",
            one + 1,
            other + 1
        ));
    }
    let least = if field == "fence" {
        LEAST_FENCE
    } else {
        LEAST_OBSTACLE
    };
    match polygon::area(corners).abs() {
        area if area < least => Err(format!(
            "{field}: it encloses {area:.4} m2, {least} m2 or more is accepted"
        )),
        _ => Ok(()),
    }
}

fn leg(leg: &Leg, before: Option<&Leg>, plan: &Plan) -> Outcome {
    let fence = &plan.fence;
    if !(leg.speed > 0.0 && leg.speed <= FASTEST) {
        return Err(format!(
            "speed: {} m/s is out of range, it takes above 0 m/s to {FASTEST} m/s",
            leg.speed
        ));
    }
    let points = leg.shape.points();
    let field = |index: usize| match (&leg.shape, index) {
        (Shape::Line { .. }, 0) => "from".to_owned(),
        (Shape::Line { .. }, _) => "to".to_owned(),
        _ => format!("point {}", index + 1),
    };
    if !(2..=MOST_POINTS).contains(&points.len()) {
        return Err(format!(
            "points: there are {}, 2 to {MOST_POINTS} are accepted",
            points.len()
        ));
    }
    for (index, point) in points.iter().enumerate() {
        coordinates(&field(index), *point)?;
        if !fence.is_empty() && !polygon::holds(fence, *point, ON_FENCE) {
            return Err(format!(
                "{}: {point} is outside the fence, every point inside is accepted",
                field(index)
            ));
        }
        let inside = |obstacle: &Vec<Local>| polygon::holds(obstacle, *point, 0.0);
        if let Some(obstacle) = plan.obstacles.iter().position(inside) {
            return Err(format!(
                "{}: {point} is inside obstacle {}, a point outside the obstacles is accepted",
                field(index),
                obstacle + 1
            ));
        }
    }
    let length = leg.shape.length();
    if length < SHORTEST {
        let field = field(points.len() - 1);
        return Err(format!(
            "{field}: the leg is {length:.3} m long, {SHORTEST} m or more is accepted"
        ));
    }
    let mut pairs = points.iter().zip(points.iter().skip(1));
    if let Some(index) = pairs.position(|(one, next)| one.distance(*next) < CLOSEST) {
        return Err(format!(
            "point {}: it is the point before again, points at least {CLOSEST} m apart are accepted",
            index + 2
        ));
    }
    let (begin, _) = leg.shape.ends();
    let Some((_, end)) = before.map(|before| before.shape.ends()) else {
        return Ok(());
    };
    let gap = begin.distance(end);
    match leg.join {
        Join::Continue if gap > GAP => Err(format!(
            "join: the leg begins {gap:.3} m from the end of the leg before, \"continue\" accepts up to {GAP} m, \
             \"turn\" any distance"
        )),
        _ => Ok(()),
    }
}
