//! Lines side by side over areas, cut at their edges.

use std::f64::consts::PI;

use super::{Area, Options};
use crate::place::Local;

/// Longest edges whose directions are tried.
const EDGES: usize = 48;

/// A piece of a swath: from and to along the direction of the swaths, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Piece {
    pub(super) track: usize,
    /// Distance of the swath to the right of the origin, m.
    pub(super) right: f64,
    pub(super) from: f64,
    pub(super) to: f64,
}

/// All pieces, by track and then along it.
pub(super) struct Cut {
    pub(super) pieces: Vec<Piece>,
    pub(super) too_short: usize,
}

/// Coordinates along a direction and to its right.
pub(super) fn turned(place: Local, bearing: f64) -> (f64, f64) {
    let (sine, cosine) = bearing.sin_cos();
    (
        place.north * cosine + place.east * sine,
        place.east * cosine - place.north * sine,
    )
}

/// The place with these coordinates along a direction and to its right.
pub(super) fn place(along: f64, right: f64, bearing: f64) -> Local {
    Local::default()
        .towards(bearing, along)
        .towards(bearing + PI / 2.0, right)
}

/// A ring along a direction and to its right.
type Turned = Vec<(f64, f64)>;

fn rings(areas: &[Area], bearing: f64) -> Vec<Turned> {
    let turn = |ring: &Vec<Local>| ring.iter().map(|corner| turned(*corner, bearing)).collect();
    areas.iter().flat_map(Area::rings).map(turn).collect()
}

/// Parallel lines, evenly spaced.
#[derive(Clone, Copy)]
struct Lines {
    /// Distance of the first one to the right of the origin, m.
    first: f64,
    width: f64,
    count: usize,
}

impl Lines {
    /// As few lines as make swaths over rings.
    fn over(rings: &[Turned], width: f64) -> Self {
        let sides = rings.iter().flatten().map(|(_, right)| *right);
        let (least, most) = sides
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), side| {
                (least.min(side), most.max(side))
            });
        // A remainder of a millimetre needs no swath.
        let count = ((most - least - 1e-3) / width).ceil().max(1.0);
        Self {
            first: 0.5 * (least + most) - 0.5 * (count - 1.0) * width,
            width,
            count: count as usize,
        }
    }

    fn right(&self, line: usize) -> f64 {
        self.first + line as f64 * self.width
    }

    /// The parts of each line that are inside the rings, ascending.
    fn inside(&self, rings: &[Turned]) -> Vec<Vec<(f64, f64)>> {
        let mut crossings = vec![Vec::new(); self.count];
        for ring in rings {
            let next = ring.iter().cycle().skip(1);
            for ((along, side), (next_along, next_side)) in ring.iter().zip(next) {
                let (low, high) = (side.min(*next_side), side.max(*next_side));
                let from = ((low - self.first) / self.width - 1.0).max(0.0) as usize;
                // An edge has its lower end and not its upper one, so that corners count once.
                let crossed = (from..self.count).skip_while(|line| self.right(*line) < low);
                for line in crossed.take_while(|line| self.right(*line) < high) {
                    let share = (self.right(line) - side) / (next_side - side);
                    crossings[line].push(along + share * (next_along - along));
                }
            }
        }
        let pairs = crossings.into_iter().map(|mut crossings| {
            crossings.sort_by(f64::total_cmp);
            crossings
                .chunks_exact(2)
                .map(|pair| (pair[0], pair[1]))
                .collect()
        });
        pairs.collect()
    }
}

/// Swaths over the areas in a direction.
pub(super) fn cut(areas: &[Area], bearing: f64, options: &Options) -> Cut {
    let rings = rings(areas, bearing);
    let lines = Lines::over(&rings, options.width);
    let mut cut = Cut {
        pieces: Vec::new(),
        too_short: 0,
    };
    for (track, parts) in lines.inside(&rings).into_iter().enumerate() {
        for (from, to) in parts {
            let piece = Piece {
                track,
                right: lines.right(track),
                from,
                to,
            };
            match to - from >= options.shortest {
                true => cut.pieces.push(piece),
                false => cut.too_short += 1,
            }
        }
    }
    cut
}

/// Lines over the width of a swath by which its ends are found.
const ACROSS: usize = 8;

/// Lengthens pieces until their whole width has left the areas, as far as their middle stays inside `reach`.
pub(super) fn lengthen(
    cut: &mut Cut,
    areas: &[Area],
    reach: &[Area],
    bearing: f64,
    options: &Options,
) {
    let (inner, reach) = (rings(areas, bearing), rings(reach, bearing));
    let lines = Lines::over(&inner, options.width);
    let far = lines.inside(&reach);
    // The outermost ones are just inside the swath, so that an edge along it belongs to one side only.
    let across: Vec<_> = (0..ACROSS)
        .map(|index| {
            let share = index as f64 / (ACROSS - 1) as f64 - 0.5;
            let first = lines.first + share * 0.999 * options.width;
            Lines { first, ..lines }.inside(&inner)
        })
        .collect();
    let old: Vec<Piece> = cut.pieces.clone();
    for (index, piece) in cut.pieces.iter_mut().enumerate() {
        let beside = across.iter().flat_map(|lines| &lines[piece.track]);
        let (mut from, mut to) = (piece.from, piece.to);
        for (begin, end) in beside.filter(|(begin, end)| *begin < piece.to && *end > piece.from) {
            from = from.min(*begin);
            to = to.max(*end);
        }
        // The middle of the piece is in one part of the reach.
        let middle = 0.5 * (piece.from + piece.to);
        let part = far[piece.track]
            .iter()
            .find(|(begin, end)| *begin <= middle && middle <= *end);
        let (mut least, mut most) = part.copied().unwrap_or((piece.from, piece.to));
        // Two pieces of a swath do not overlap.
        let before = index.checked_sub(1).and_then(|before| old.get(before));
        if let Some(before) = before.filter(|before| before.track == piece.track) {
            least = least.max(0.5 * (before.to + piece.from));
        }
        if let Some(next) = old.get(index + 1).filter(|next| next.track == piece.track) {
            most = most.min(0.5 * (piece.to + next.from));
        }
        piece.from = from.max(least).min(piece.from);
        piece.to = to.min(most).max(piece.to);
    }
}

/// With as many pieces as along an edge, another direction is taken only if they are longer by this factor.
const MORE: f64 = 1.02;

/// The direction with the fewest pieces, rad clockwise from north in [0, pi).
pub(super) fn fewest(areas: &[Area], options: &Options) -> f64 {
    let mut edges: Vec<(f64, f64)> = areas
        .iter()
        .flat_map(Area::rings)
        .flat_map(|ring| ring.iter().zip(ring.iter().cycle().skip(1)))
        .map(|(from, to)| (from.distance(*to), from.bearing(*to).rem_euclid(PI)))
        .collect();
    edges.sort_by(|one, other| other.0.total_cmp(&one.0));
    let edges = edges.into_iter().take(EDGES).map(|(_, bearing)| bearing);
    let degrees = (0..180).map(|degree| f64::from(degree).to_radians());
    // Pieces that are left out are land that is not covered, so they count as well.
    let cost = |bearing: f64| {
        let cut = cut(areas, bearing, options);
        let length: f64 = cut.pieces.iter().map(|piece| piece.to - piece.from).sum();
        (cut.pieces.len() + cut.too_short, length)
    };
    let best = |bearings: &mut dyn Iterator<Item = f64>| {
        let all = bearings.map(|bearing| (cost(bearing), bearing));
        all.min_by(|((count, length), _), ((other_count, other_length), _)| {
            // Lengths that differ in their last bits are the same: the first one is taken.
            let lengths = match (length - other_length).abs() < 1e-6 * length {
                true => std::cmp::Ordering::Equal,
                false => other_length.total_cmp(length),
            };
            count.cmp(other_count).then(lengths)
        })
    };
    let Some(((fewest, length), edge)) = best(&mut { edges }) else {
        return 0.0;
    };
    // Swaths a degree askew are a little longer than those along an edge, and work no more of the field.
    match best(&mut { degrees }) {
        Some(((count, longer), degree))
            if count < fewest || count == fewest && longer > MORE * length =>
        {
            degree
        }
        _ => edge,
    }
}
