//! Two arcs from one pose to another, which meet with one direction (K. M. Bolton, Biarc curves, Computer-Aided Design 7,
//! 1975).

use super::hermite::wrapped;
use super::segment::{Pose, Segment};
use crate::place::Local;

/// The two arcs. Both tangents from the ends to the corner of the biarc's control polygon have the same length.
pub(super) fn between(from: Pose, to: Local, heading: f64) -> Vec<Segment> {
    let chord = from.place.distance(to);
    let bearing = from.place.bearing(to);
    let (first, second) = (wrapped(from.heading - bearing), wrapped(heading - bearing));
    // Tangents of length d at both ends: |chord - d (t1 + t2)| = 2 d.
    let along = chord * (first.cos() + second.cos());
    let cosine = (first - second).cos();
    // d^2 (2 - 2 cos) + 2 d along - chord^2 = 0, with the sign of the one solution that is positive.
    let square = 2.0 * (1.0 - cosine);
    let root = (along * along + square * chord * chord).sqrt();
    let tangent = chord * chord / (along + root).max(1e-12 * chord);
    let joint = {
        let one = from.place.towards(from.heading, tangent);
        let other = to.towards(heading, -tangent);
        one.between(other, 0.5)
    };
    let one = arc(from, joint);
    let middle = Pose {
        place: joint,
        heading: one.end().heading,
    };
    vec![one, arc(middle, to)]
}

/// The arc from a pose to a place.
pub(super) fn arc(from: Pose, to: Local) -> Segment {
    let chord = from.place.distance(to);
    // The arc turns by twice the angle between its beginning and its chord.
    let half = wrapped(from.place.bearing(to) - from.heading);
    let length = match half.abs() < 1e-8 {
        true => chord,
        false => chord * half / half.sin(),
    };
    Segment {
        start: from,
        curvature: if length > 0.0 {
            2.0 * half / length
        } else {
            0.0
        },
        sharpness: 0.0,
        length,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn it_arrives(first in -2.5_f64..2.5, second in -2.5_f64..2.5, chord in 0.1_f64..50.0, bearing in -3.0_f64..3.0) {
            let from = Pose { place: Local::new(-4.0, 1.0), heading: bearing + first };
            let to = from.place.towards(bearing, chord);
            let arcs = between(from, to, bearing + second);
            let end = arcs[1].end();
            prop_assert!(end.place.distance(to) < 1e-9 * chord.max(1.0));
            prop_assert!(wrapped(end.heading - bearing - second).abs() < 1e-6, "{} {}", end.heading, bearing + second);
            prop_assert!((arcs[0].end().place.distance(arcs[1].start.place)) < 1e-9);
        }
    }
}
