//! A spline of clothoids through places: curvature has no jumps (after E. Bertolazzi and M. Frego, Interpolating
//! clothoid splines with curvature continuity, Mathematical Methods in the Applied Sciences 41, 2018).
//!
//! The unknowns are the directions at the places. Between two places lies the clothoid that has their directions; the
//! curvature with which it arrives must be that with which the next one leaves. Newton's method solves this, with three
//! unknowns in each equation.

use super::hermite::{self, WIDEST, wrapped};
use super::segment::{Pose, Segment};
use crate::place::Local;

/// Newton steps after which there is no solution.
const STEPS: usize = 40;

/// How a spline begins or ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum End {
    /// The piece there is an arc.
    Arc,
    /// The curvature there is zero.
    Straight,
}

/// How a spline begins and ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ends {
    /// Its beginning and its end.
    Open(End, End),
    /// The last place is the first one, and the spline goes on there.
    Closed,
}

/// Directions at places, rad: that of the circle through a place and its neighbours.
pub(super) fn directions(places: &[Local], closed: bool) -> Vec<f64> {
    let count = places.len();
    let tangent = |before: Local, here: Local, after: Local| {
        let (one, other) = (before.bearing(here), here.bearing(after));
        let (near, far) = (before.distance(here), here.distance(after));
        // The nearer neighbour has more weight.
        one + wrapped(other - one) * near / (near + far)
    };
    let mut directions: Vec<f64> = places
        .windows(3)
        .map(|three| tangent(three[0], three[1], three[2]))
        .collect();
    let (first, last) = match closed && count > 3 {
        true => {
            let tangent = tangent(places[count - 2], places[0], places[1]);
            (tangent, tangent)
        }
        false => {
            // An arc leaves its chord by as much as it arrives off it.
            let mirror = |chord: f64, other: Option<&f64>| {
                other.map_or(chord, |other| chord - wrapped(other - chord))
            };
            (
                mirror(places[0].bearing(places[1]), directions.first()),
                mirror(
                    places[count - 2].bearing(places[count - 1]),
                    directions.last(),
                ),
            )
        }
    };
    directions.insert(0, first);
    directions.push(last);
    directions
}

/// One equation: its coefficients for the direction before, here and after, and its value.
#[derive(Clone, Copy, Default)]
struct Row {
    before: f64,
    here: f64,
    after: f64,
    value: f64,
}

/// The equations at directions. `None` if a clothoid does not exist.
fn equations(chords: &[(f64, f64)], directions: &[f64], ends: Ends) -> Option<Vec<Row>> {
    let pieces: Option<Vec<_>> = chords
        .iter()
        .zip(directions.windows(2))
        .map(|((_, bearing), pair)| {
            hermite::unit(wrapped(pair[0] - bearing), wrapped(pair[1] - bearing))
        })
        .collect();
    let pieces = pieces?;
    // The value of each is made independent of the size of its chords.
    let mut rows = Vec::with_capacity(directions.len());
    let meet = |one: usize, other: usize| {
        let (before, after) = (&pieces[one], &pieces[other]);
        let (near, far) = (chords[one].0, chords[other].0);
        let scale = near.min(far);
        Row {
            before: scale * before.by_first.1 / near,
            here: scale * (before.by_second.1 / near - after.by_first.0 / far),
            after: -scale * after.by_second.0 / far,
            value: scale * (before.curvature.1 / near - after.curvature.0 / far),
        }
    };
    let (first, last) = (pieces.first()?, pieces.last()?);
    // At the ends: curvature does not change, or is zero.
    rows.push(match ends {
        Ends::Open(End::Arc, _) => Row {
            here: first.by_first.1 - first.by_first.0,
            after: first.by_second.1 - first.by_second.0,
            value: first.curvature.1 - first.curvature.0,
            ..Row::default()
        },
        Ends::Open(End::Straight, _) => Row {
            here: first.by_first.0,
            after: first.by_second.0,
            value: first.curvature.0,
            ..Row::default()
        },
        Ends::Closed => meet(pieces.len() - 1, 0),
    });
    rows.extend((1..pieces.len()).map(|index| meet(index - 1, index)));
    match ends {
        Ends::Open(_, End::Arc) => rows.push(Row {
            before: last.by_first.1 - last.by_first.0,
            here: last.by_second.1 - last.by_second.0,
            value: last.curvature.1 - last.curvature.0,
            ..Row::default()
        }),
        Ends::Open(_, End::Straight) => rows.push(Row {
            before: last.by_first.1,
            here: last.by_second.1,
            value: last.curvature.1,
            ..Row::default()
        }),
        // The last direction is the first one.
        Ends::Closed => {}
    }
    Some(rows)
}

/// Solves equations with three unknowns in each by elimination; each right side in turn.
fn eliminate(rows: &[Row], right: &mut [Vec<f64>]) -> Option<()> {
    let mut factors = Vec::with_capacity(rows.len());
    let mut pivot = rows.first()?.here;
    for (index, row) in rows.iter().enumerate() {
        if index > 0 {
            let ratio = row.before / pivot;
            pivot = row.here - ratio * rows[index - 1].after;
            for side in right.iter_mut() {
                side[index] -= ratio * side[index - 1];
            }
        }
        if pivot.abs() < 1e-12 || !pivot.is_finite() {
            return None;
        }
        factors.push(pivot);
    }
    for index in (0..rows.len()).rev() {
        for side in right.iter_mut() {
            let after = side.get(index + 1).copied().unwrap_or(0.0);
            side[index] = (side[index] - rows[index].after * after) / factors[index];
        }
    }
    Some(())
}

/// The Newton step. In a closed spline the first equation has the last unknown and the last one the first: the formula of
/// Sherman and Morrison takes them out.
fn step(rows: &[Row], closed: bool) -> Option<Vec<f64>> {
    let value: Vec<f64> = rows.iter().map(|row| row.value).collect();
    if !closed {
        let mut right = [value];
        eliminate(rows, &mut right)?;
        let [step] = right;
        return Some(step);
    }
    let last = rows.len() - 1;
    let (corner, other) = (rows[0].before, rows[last].after);
    let gamma = -rows[0].here;
    let mut rows = rows.to_vec();
    rows[0].here -= gamma;
    rows[last].here -= other * corner / gamma;
    rows[0].before = 0.0;
    rows[last].after = 0.0;
    let mut unit = vec![0.0; rows.len()];
    unit[0] = gamma;
    unit[last] = other;
    let mut right = [value, unit];
    eliminate(&rows, &mut right)?;
    let [value, unit] = right;
    let share = |side: &[f64]| side[0] + side[last] * corner / gamma;
    let factor = share(&value) / (1.0 + share(&unit));
    let step = value
        .iter()
        .zip(&unit)
        .map(|(value, unit)| value - factor * unit);
    Some(step.collect())
}

/// Largest value of equations.
fn size(rows: &[Row]) -> f64 {
    rows.iter().map(|row| row.value.abs()).fold(0.0, f64::max)
}

/// The spline through at least two places (closed: at least four, the last one the first again). `None` if there is none
/// near the directions that the places suggest.
pub(super) fn through(places: &[Local], ends: Ends) -> Option<Vec<Segment>> {
    let closed = ends == Ends::Closed;
    let chords: Vec<(f64, f64)> = places
        .windows(2)
        .map(|pair| (pair[0].distance(pair[1]), pair[0].bearing(pair[1])))
        .collect();
    let mut now = directions(places, closed);
    if let [(_, bearing)] = chords[..] {
        now = vec![bearing; 2];
    }
    let within = |directions: &[f64]| {
        chords
            .iter()
            .zip(directions.windows(2))
            .all(|((_, bearing), pair)| {
                pair.iter()
                    .all(|direction| wrapped(direction - bearing).abs() <= WIDEST)
            })
    };
    let mut rows = equations(&chords, &now, ends)?;
    let mut converged = size(&rows) < 1e-11;
    for _ in 0..STEPS {
        if converged {
            break;
        }
        let mut step = step(&rows, closed)?;
        if closed {
            step.push(step[0]);
        }
        // A step that makes it worse is halved.
        let mut share = 1.0;
        loop {
            let trial: Vec<f64> = now
                .iter()
                .zip(&step)
                .map(|(now, step)| now - share * step)
                .collect();
            let better = within(&trial)
                .then(|| equations(&chords, &trial, ends))
                .flatten();
            let better = better.filter(|better| size(better) < (1.0 - 0.1 * share) * size(&rows));
            if let Some(better) = better {
                (now, rows) = (trial, better);
                break;
            }
            share *= 0.5;
            if share < 1e-3 {
                return (size(&rows) < 1e-8).then(|| build(places, &now)).flatten();
            }
        }
        converged = size(&rows) < 1e-11;
    }
    if converged { build(places, &now) } else { None }
}

/// The clothoids between places with these directions.
fn build(places: &[Local], directions: &[f64]) -> Option<Vec<Segment>> {
    let pairs = places.windows(2).zip(directions.windows(2));
    pairs
        .map(|(places, directions)| {
            let from = Pose {
                place: places[0],
                heading: directions[0],
            };
            hermite::between(from, places[1], directions[1])
        })
        .collect()
}
