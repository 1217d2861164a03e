//! Rounds in the headland.

use geo::buffer::{BufferStyle, LineJoin};
use geo::{Buffer as _, Polygon};

use super::{ARC, Area, Options};
use crate::curve::straight_points;
use crate::place::Local;

/// Radius of corners, in turning radii: a curve of clothoids has more curvature in the middle of a corner than the corner.
const WIDER: f64 = 1.25;
/// Largest distance between two points of a round, m.
const STEP: f64 = 1.0;

/// Middle lines of the rounds, the outermost first, with their first point again at the end.
pub(super) fn rounds(field: &Polygon, options: &Options) -> Vec<Vec<Local>> {
    let count = (options.headland / options.width + 1e-9).floor() as usize;
    let mut rounds = Vec::new();
    for round in 0..count {
        let distance = (round as f64 + 0.5) * options.width;
        let corner = WIDER * options.radius;
        let offset = |by: f64| BufferStyle::new(by).line_join(LineJoin::Round(ARC));
        // Further in and back again: that rounds the corners.
        let parts = field.buffer_with_style(offset(-distance - corner));
        let parts = match corner > 0.0 {
            true => parts.buffer_with_style(offset(corner)),
            false => parts,
        };
        for part in &parts {
            let area = Area::from_polygon(part);
            rounds.extend(area.rings().map(|ring| dense(ring)));
        }
    }
    rounds
}

/// A closed ring with points at most [`STEP`] apart.
fn dense(ring: &[Local]) -> Vec<Local> {
    let mut points: Vec<Local> = Vec::new();
    for (from, to) in ring.iter().zip(ring.iter().cycle().skip(1)) {
        let count = (from.distance(*to) / STEP).ceil().max(1.0);
        let shares = (0..count as usize).map(|index| index as f64 / count);
        for point in shares.map(|share| from.between(*to, share)) {
            // Corners of arcs can lie on each other.
            if points.last().is_none_or(|last| last.distance(point) > 0.05) {
                points.push(point);
            }
        }
    }
    while points.len() > 1 && points[0].distance(points[points.len() - 1]) < 0.05 {
        points.pop();
    }
    points.extend(points.first().copied());
    points
}

/// Rounds that each begin nearest to where the one before ended.
pub(super) fn from_nearest(rounds: Vec<Vec<Local>>, from: Option<Local>) -> Vec<Vec<Local>> {
    let mut here = from;
    let mut turned = Vec::with_capacity(rounds.len());
    for mut round in rounds {
        round.pop();
        let far = |index: usize| here.map_or(0.0, |here: Local| here.distance(round[index]));
        // A turn leads to a place without curvature, if there is one.
        let straight: Vec<usize> = straight_points(&round).collect();
        let places = match straight.is_empty() {
            true => (0..round.len()).collect(),
            false => straight,
        };
        let nearest = places
            .into_iter()
            .min_by(|one, other| far(*one).total_cmp(&far(*other)));
        round.rotate_left(nearest.unwrap_or(0));
        round.extend(round.first().copied());
        here = round.last().copied();
        turned.push(round);
    }
    turned
}
