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

/// Swaths over the areas in a direction.
pub(super) fn cut(areas: &[Area], bearing: f64, options: &Options) -> Cut {
    let rings: Vec<Vec<(f64, f64)>> = areas
        .iter()
        .flat_map(Area::rings)
        .map(|ring| ring.iter().map(|corner| turned(*corner, bearing)).collect())
        .collect();
    let sides = rings.iter().flatten().map(|(_, right)| *right);
    let (least, most) = sides.fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), side| {
        (least.min(side), most.max(side))
    });
    // A remainder of a millimetre needs no swath.
    let count = ((most - least - 1e-3) / options.width).ceil().max(1.0);
    let first = 0.5 * (least + most) - 0.5 * (count - 1.0) * options.width;
    let right = |track: usize| first + track as f64 * options.width;
    // Where each swath crosses an edge, along it.
    let mut crossings = vec![Vec::new(); count as usize];
    for ring in &rings {
        for ((along, side), (next_along, next_side)) in ring.iter().zip(ring.iter().cycle().skip(1))
        {
            let (low, high) = (side.min(*next_side), side.max(*next_side));
            let from = ((low - first) / options.width - 1.0).max(0.0) as usize;
            // An edge has its lower end and not its upper one, so that corners count once.
            let crossed = (from..crossings.len()).skip_while(|track| right(*track) < low);
            for track in crossed.take_while(|track| right(*track) < high) {
                let share = (right(track) - side) / (next_side - side);
                crossings[track].push(along + share * (next_along - along));
            }
        }
    }
    let mut cut = Cut {
        pieces: Vec::new(),
        too_short: 0,
    };
    for (track, crossings) in crossings.iter_mut().enumerate() {
        crossings.sort_by(f64::total_cmp);
        for pair in crossings.chunks_exact(2) {
            let piece = Piece {
                track,
                right: right(track),
                from: pair[0],
                to: pair[1],
            };
            match piece.to - piece.from >= options.shortest {
                true => cut.pieces.push(piece),
                false => cut.too_short += 1,
            }
        }
    }
    cut
}

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
    let all = edges.chain(degrees).map(|bearing| (cost(bearing), bearing));
    let best = all.min_by(|((count, length), _), ((other_count, other_length), _)| {
        // Lengths that differ in their last bits are the same: the edge, which comes first, is taken.
        let lengths = match (length - other_length).abs() < 1e-6 * length {
            true => std::cmp::Ordering::Equal,
            false => other_length.total_cmp(length),
        };
        count.cmp(other_count).then(lengths)
    });
    best.map_or(0.0, |(_, bearing)| bearing)
}
