//! Places where a vehicle may be: inside a fence, or not deeper than a headland.

use crate::dubins::Pose;
use crate::scalar::Scalar;

/// Largest number of corners of a fence.
pub const CORNERS: usize = 64;

/// A point of the plane, m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point<T> {
    /// North, m.
    pub north: T,
    /// East, m.
    pub east: T,
}

/// The ground that a vehicle covers: everything within `half_width` of the piece of its
/// centre line from `behind` to `ahead` of the rear axle. That contains the rectangle of
/// this length and width.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Footprint<T> {
    /// Half of the width over everything, m, not negative.
    pub half_width: T,
    /// Distance from the rear axle to the front, m, not negative.
    pub ahead: T,
    /// Distance from the rear axle to the rear, m, not negative.
    pub behind: T,
}

impl<T: Scalar> Footprint<T> {
    /// True if every number is finite and none is negative.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        [self.half_width, self.ahead, self.behind]
            .into_iter()
            .all(|value| value.is_finite() && value >= T::zero())
    }

    /// Rear and front end of the centre line at a pose.
    fn ends(&self, at: &Pose<T>) -> [Point<T>; 2] {
        let (sine, cosine) = at.heading.sine_cosine();
        [-self.behind, self.ahead].map(|ahead| Point {
            north: at.north + ahead * cosine,
            east: at.east + ahead * sine,
        })
    }
}

/// Says where a vehicle may be. A closure is one, too.
pub trait Room<T> {
    /// True if the vehicle may stand at this pose of its rear axle.
    fn allows(&self, at: &Pose<T>) -> bool;
}

impl<T, F: Fn(&Pose<T>) -> bool> Room<T> for F {
    fn allows(&self, at: &Pose<T>) -> bool {
        self(at)
    }
}

/// A headland: the strip beyond the end of the passes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Headland<T> {
    /// End of a pass. The headland lies ahead of it.
    pub from: Pose<T>,
    /// How far the vehicle may go beyond it, m.
    pub depth: T,
    /// How far its rear axle may come back into the field before it, m, not negative.
    pub back: T,
    /// The vehicle.
    pub footprint: Footprint<T>,
}

impl<T: Scalar> Room<T> for Headland<T> {
    fn allows(&self, at: &Pose<T>) -> bool {
        let (sine, cosine) = self.from.heading.sine_cosine();
        let beyond =
            |north: T, east: T| (north - self.from.north) * cosine + (east - self.from.east) * sine;
        let deepest = self.depth - self.footprint.half_width;
        let ends = self.footprint.ends(at);
        ends.iter().all(|end| beyond(end.north, end.east) <= deepest)
            // A pass ends exactly where the headland begins, but for rounding errors.
            && beyond(at.north, at.east) >= -self.back - T::lit(1e-3)
    }
}

/// A polygon that the vehicle must not leave. Its last corner is joined to the first; it
/// need not be convex, but its edges must not cross.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fence<'a, T> {
    corners: &'a [Point<T>],
    footprint: Footprint<T>,
}

/// Why a fence is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FenceError {
    /// Fewer than three corners, or more than [`CORNERS`].
    Corners(usize),
    /// A corner, counted from zero, is not finite.
    Corner(usize),
    /// A number of the footprint is not finite or negative.
    Footprint,
}

impl core::fmt::Display for FenceError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Corners(count) => {
                write!(f, "the fence has {count} corners, not 3 to {CORNERS}")
            }
            Self::Corner(number) => write!(f, "corner {number} of the fence is not finite"),
            Self::Footprint => f.write_str("the vehicle's length or width is not usable"),
        }
    }
}

impl core::error::Error for FenceError {}

impl<'a, T: Scalar> Fence<'a, T> {
    /// The fence with these `corners` around a vehicle.
    ///
    /// # Errors
    /// [`FenceError`] if there are too few corners or too many, or a number is not usable.
    pub fn new(corners: &'a [Point<T>], footprint: Footprint<T>) -> Result<Self, FenceError> {
        if !(3..=CORNERS).contains(&corners.len()) {
            return Err(FenceError::Corners(corners.len()));
        }
        let lost = |corner: &Point<T>| !(corner.north.is_finite() && corner.east.is_finite());
        if let Some(number) = corners.iter().position(lost) {
            return Err(FenceError::Corner(number));
        }
        if !footprint.is_usable() {
            return Err(FenceError::Footprint);
        }
        Ok(Self { corners, footprint })
    }
}

impl<T: Scalar> Room<T> for Fence<'_, T> {
    fn allows(&self, at: &Pose<T>) -> bool {
        let [rear, front] = self.footprint.ends(at);
        let room = self.footprint.half_width * self.footprint.half_width;
        let mut inside = false;
        let Some(&(mut from)) = self.corners.last() else {
            return false;
        };
        // loop-bound: 64. A fence has up to CORNERS corners.
        for &to in self.corners {
            // A ray to the north from a point inside meets an odd number of edges.
            if (from.east > rear.east) != (to.east > rear.east) {
                let share = (rear.east - from.east) / (to.east - from.east);
                if from.north + share * (to.north - from.north) > rear.north {
                    inside = !inside;
                }
            }
            let axis = [rear, front];
            if cross(axis, [from, to]) || !(separation(axis, [from, to]) >= room) {
                return false;
            }
            from = to;
        }
        inside
    }
}

/// Whether two straight pieces cross.
fn cross<T: Scalar>([a, b]: [Point<T>; 2], [c, d]: [Point<T>; 2]) -> bool {
    // Twice the area of the triangle, positive if its corners run clockwise.
    let side = |p: Point<T>, q: Point<T>, r: Point<T>| {
        (q.north - p.north) * (r.east - p.east) - (q.east - p.east) * (r.north - p.north)
    };
    let apart = |one: T, other: T| one * other < T::zero();
    apart(side(a, b, c), side(a, b, d)) && apart(side(c, d, a), side(c, d, b))
}

/// Square of the smallest distance between two straight pieces that do not cross.
fn separation<T: Scalar>(first: [Point<T>; 2], second: [Point<T>; 2]) -> T {
    let ([a, b], [c, d]) = (first, second);
    [
        to_point(first, c),
        to_point(first, d),
        to_point(second, a),
        to_point(second, b),
    ]
    .into_iter()
    .fold(
        T::lit(1e30),
        |least, square| {
            if square < least { square } else { least }
        },
    )
}

/// Square of the distance from a straight piece to a point.
fn to_point<T: Scalar>([from, to]: [Point<T>; 2], point: Point<T>) -> T {
    let (dn, de) = (to.north - from.north, to.east - from.east);
    let (pn, pe) = (point.north - from.north, point.east - from.east);
    let square = dn * dn + de * de;
    let along = pn * dn + pe * de;
    let share = if along > T::zero() && square > T::zero() {
        if along < square {
            along / square
        } else {
            T::one()
        }
    } else {
        T::zero()
    };
    let (n, e) = (pn - share * dn, pe - share * de);
    n * n + e * e
}
