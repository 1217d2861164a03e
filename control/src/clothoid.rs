//! Clothoids: curves whose curvature changes linearly with the distance.
//!
//! A vehicle that drives along one at a constant speed turns its wheels at a
//! nearly constant rate. So clothoids join lines and arcs into paths that a
//! steering of limited rate can follow without error.

use crate::dubins::{Pose, advance};
use crate::scalar::{Scalar, wrap_angle};

/// Nodes on [-1, 1] and weights of the Gauss-Legendre rule with five nodes
/// (Abramowitz and Stegun, table 25.4). It is exact for polynomials up to the
/// ninth degree.
const RULE: [(f64, f64); 5] = [
    (-0.906_179_845_938_664, 0.236_926_885_056_189_08),
    (-0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.0, 0.568_888_888_888_888_9),
    (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.906_179_845_938_664, 0.236_926_885_056_189_08),
];

/// Largest number of intervals to which the rule is applied.
const INTERVALS: usize = 8;

/// The pose after driving `length` metres from `start` with a `curvature` (1/m,
/// positive to the right) that changes by `sharpness` (1/m^2) with each metre. A
/// negative length goes backwards. Without sharpness this is [`advance`].
///
/// The position is integrated in up to 8 intervals, in each of which the larger
/// curvature at the ends turns by at most one radian. As long as these suffice
/// (length times larger curvature up to 8), the error of the position is below 2e-8
/// of the length, and in single precision below 1e-6 of it.
#[must_use]
pub fn travel<T: Scalar>(start: Pose<T>, curvature: T, sharpness: T, length: T) -> Pose<T> {
    if sharpness == T::zero() {
        return advance(start, curvature, length);
    }
    // The curvature is largest at one of the ends.
    let (first, last) = (curvature.abs(), (curvature + sharpness * length).abs());
    let most = if first > last { first } else { last };
    let intervals = (most * length.abs()).whole().min(INTERVALS - 1) + 1;
    let step = length / T::integer(intervals as i32);
    let (mut north, mut east) = (T::zero(), T::zero());
    let mut from = T::zero();
    // loop-bound: 8
    for _ in 0..intervals {
        let (dn, de) = piece(start.heading, curvature, sharpness, (from, step));
        north += dn;
        east += de;
        from += step;
    }
    Pose {
        north: start.north + north,
        east: start.east + east,
        heading: wrap_angle(start.heading + turned(curvature, sharpness, length)),
    }
}

/// The same for a short way, on which the larger curvature at the ends turns by at most one radian.
#[must_use]
pub(crate) fn nearby<T: Scalar>(start: Pose<T>, curvature: T, sharpness: T, length: T) -> Pose<T> {
    let (north, east) = piece(start.heading, curvature, sharpness, (T::zero(), length));
    Pose {
        north: start.north + north,
        east: start.east + east,
        heading: wrap_angle(start.heading + turned(curvature, sharpness, length)),
    }
}

/// Turn of the heading over a way, rad.
fn turned<T: Scalar>(curvature: T, sharpness: T, way: T) -> T {
    (curvature + sharpness * way * T::lit(0.5)) * way
}

/// North and east of the way `from` some distance on, over one `step`, by one application of the rule.
fn piece<T: Scalar>(heading: T, curvature: T, sharpness: T, (from, step): (T, T)) -> (T, T) {
    let half = step * T::lit(0.5);
    let (mut north, mut east) = (T::zero(), T::zero());
    // As literals, so that the compiler converts them.
    let rule = RULE.map(|(node, weight)| (T::lit(node), T::lit(weight)));
    // loop-bound: 5
    for (node, weight) in rule {
        let way = from + half + half * node;
        let (sine, cosine) = (heading + turned(curvature, sharpness, way)).sine_cosine();
        north += cosine * weight;
        east += sine * weight;
    }
    (north * half, east * half)
}
