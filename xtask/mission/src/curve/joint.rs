//! Legs that continue each other as one curve.

use std::ops::Range;

use super::{
    Chain, CurveError, Options, check, ends, kink, leg, measure, smooth, spline_near, turns,
};
use crate::place::Local;
use crate::plan::{End, Join, Leg, Plan, Shape};

/// Distance between the points that keep a line straight beside a curve, m.
const STEP: f64 = 2.0;
/// Distance from its ends from which on a line has such points only every so many metres: a spline is straight there by itself.
const NEAR: f64 = 50.0;
/// Kink up to which two lines are one, rad.
const STRAIGHT: f64 = 1e-6;

/// Legs that continue each other.
struct Group {
    legs: Range<usize>,
    /// The last one is continued by the first one.
    closed: bool,
}

/// True if a leg goes on where the one before ends, without a turn or a change of the direction of travel.
fn continues(before: &Leg, leg: &Leg) -> bool {
    leg.join == Join::Continue && before.reverse == leg.reverse
}

fn groups(plan: &Plan) -> Vec<Group> {
    let mut groups: Vec<Group> = Vec::new();
    for (index, leg) in plan.legs.iter().enumerate() {
        match groups.last_mut() {
            Some(group) if continues(&plan.legs[index - 1], leg) => group.legs.end = index + 1,
            _ => groups.push(Group {
                legs: index..index + 1,
                closed: false,
            }),
        }
    }
    if let ([group], [first, ..], End::Repeat) = (&mut groups[..], &plan.legs[..], plan.end) {
        let last = &plan.legs[plan.legs.len() - 1];
        group.closed = continues(last, first);
    }
    groups
}

/// Points on a line that keep a spline straight: close ones near its ends.
fn along(from: Local, to: Local) -> Vec<Local> {
    let length = from.distance(to);
    let near = NEAR.min(0.5 * length);
    let close = (near / STEP).ceil().max(1.0);
    let beginning = (0..=close as usize).map(|index| index as f64 / close * near);
    let rest = length - 2.0 * near;
    let wide = (rest / NEAR).ceil();
    let middle = (1..wide as usize).map(|index| near + index as f64 / wide * rest);
    let end = (0..close as usize)
        .rev()
        .map(|index| length - index as f64 / close * near);
    // The two halves of a short line meet in a point.
    let meeting = (rest > 1e-6).then_some(length - near);
    let all = beginning.chain(middle).chain(meeting).chain(end);
    all.map(|distance| from.between(to, distance / length))
        .collect()
}

/// Points of a leg for the curve; a line among others has some between its ends.
fn points(leg: &Leg, options: &Options, alone: bool) -> Vec<Local> {
    match &leg.shape {
        Shape::Line { from, to } if !alone => along(*from, *to),
        shape => match options.resampling {
            Some(resampling) if matches!(shape, Shape::Curve { .. }) => {
                smooth::resampled(&shape.points(), resampling.spacing, resampling.noise)
            }
            _ => shape.points(),
        },
    }
}

/// True if all legs are lines in one direction.
fn is_straight(legs: &[Leg]) -> bool {
    let lines = legs
        .iter()
        .all(|leg| matches!(leg.shape, Shape::Line { .. }));
    let ends: Vec<Local> = legs.iter().flat_map(|leg| leg.shape.points()).collect();
    let directions = ends.chunks_exact(2).map(|pair| pair[0].bearing(pair[1]));
    let first = directions.clone().next().unwrap_or_default();
    lines
        && directions
            .clone()
            .all(|direction| super::hermite::wrapped(direction - first).abs() < STRAIGHT)
}

pub(super) fn legs(plan: &Plan, options: &Options) -> Result<Vec<Chain>, (usize, CurveError)> {
    let mut chains = Vec::with_capacity(plan.legs.len());
    for group in groups(plan) {
        let first = group.legs.start;
        let after = match (plan.legs.get(group.legs.end), plan.end) {
            (None, End::Repeat) => plan.legs.first(),
            (after, _) => after,
        };
        let turns = |leg: Option<&Leg>| leg.is_some_and(|leg| leg.join == Join::Turn);
        let is_reached = first > 0 || plan.end == End::Repeat;
        let options = Options {
            straight_begin: is_reached && turns(plan.legs.get(first)),
            straight_end: turns(after),
            ..*options
        };
        let legs = &plan.legs[group.legs.clone()];
        match is_straight(legs) {
            true => {
                for (index, line) in legs.iter().enumerate() {
                    chains.push(leg(line, &options).map_err(|error| (first + index, error))?);
                }
            }
            false => {
                let together = together(legs, &options, group.closed);
                chains.extend(together.map_err(|(index, error)| (first + index, error))?);
            }
        }
    }
    Ok(chains)
}

/// Chains of legs that are one curve.
fn together(
    legs: &[Leg],
    options: &Options,
    closed: bool,
) -> Result<Vec<Chain>, (usize, CurveError)> {
    let mut all: Vec<Local> = Vec::new();
    // Where the points of each leg begin.
    let mut starts = Vec::with_capacity(legs.len());
    for (index, leg) in legs.iter().enumerate() {
        let given = leg.shape.points();
        check(&given, options).map_err(|error| (index, error))?;
        let mut points = points(leg, options, legs.len() == 1);
        // The gap between two legs that continue is closed: the end of the one before is the beginning of the next.
        if let Some(end) = all.pop() {
            points[0] = end;
        }
        starts.push(all.len());
        all.extend(points);
    }
    let last = all.len() - 1;
    let closed = closed && last >= 3;
    if closed {
        all[last] = all[0];
    }
    let of = |point: usize| starts.partition_point(|start| *start <= point) - 1;
    let place = |error| match error {
        CurveError::Repeated { point } => (
            of(point),
            CurveError::Repeated {
                point: point - starts[of(point)],
            },
        ),
        CurveError::Reversal { point, place } => {
            let leg = of(point);
            let point = point - starts[leg];
            (leg, CurveError::Reversal { point, place })
        }
        error => (0, error),
    };
    check(&all, options).map_err(place)?;
    turns(&all).map_err(place)?;
    let (pieces, continuity) = spline_near(&all, options.tolerance, ends(options, closed), &starts);
    let chains = starts.iter().enumerate().map(|(index, start)| {
        let end = starts.get(index + 1).copied().unwrap_or(last);
        let own = pieces
            .iter()
            .filter(|(point, _)| (*start..end).contains(point));
        let mut chain = Chain::of(own.map(|(_, segment)| *segment).collect(), continuity);
        measure(&mut chain, &all[*start..=end]);
        let given = legs[index].shape.points();
        let far = given.iter().map(|point| super::distance(&chain, *point));
        chain.moved = far.fold(0.0, f64::max);
        chain
    });
    Ok(chains.collect())
}

/// Points of a closed curve that lie on a straight part of it, by their numbers.
pub(crate) fn straight_points(points: &[Local]) -> impl Iterator<Item = usize> {
    let straight = |three: &[Local]| kink(three).abs() < STRAIGHT;
    points
        .windows(3)
        .enumerate()
        .filter(move |(_, three)| straight(three))
        .map(|(before, _)| before + 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_keep_a_line_straight_at_its_ends() {
        for length in [0.1, 1.0, 3.0, 99.0, 100.0, 100.5, 151.0, 5000.0] {
            let points = along(Local::new(1.0, 1.0), Local::new(1.0, 1.0 + length));
            assert!(points[0].distance(Local::new(1.0, 1.0)) < 1e-9);
            assert!(points[points.len() - 1].distance(Local::new(1.0, 1.0 + length)) < 1e-9);
            for (index, pair) in points.windows(2).enumerate() {
                let step = pair[1].east - pair[0].east;
                assert!(
                    step > 1e-3 * length.min(1.0) && step < NEAR + 1e-9,
                    "{length} {index} {step}"
                );
                let from_end = (pair[0].east - 1.0).min(1.0 + length - pair[1].east);
                assert!(
                    step <= STEP + 1e-9 || from_end >= NEAR - 1e-9,
                    "{length} {index} {step}"
                );
            }
        }
    }
}
