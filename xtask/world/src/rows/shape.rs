//! The geometry of what stands in a field: discs, strips and walls as one shape.

use libm::{cos, sin, sqrt};

/// A point or direction in the plane: `x`, `y`.
pub(super) type Point = (f64, f64);

/// What a shape is.
#[derive(Copy, Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum What {
    /// A piece of a smooth barrier.
    Barrier,
    /// A pole of PVC.
    Pole,
    /// A stalk.
    Stalk,
    /// A leaf.
    Leaf,
    /// A weed.
    Weed,
}

impl What {
    /// Whether a robot that touches it is stopped or damages it. A leaf gives way.
    #[must_use]
    pub const fn is_solid(self) -> bool {
        !matches!(self, Self::Leaf)
    }

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Barrier => "barrier",
            Self::Pole => "pole",
            Self::Stalk => "stalk",
            Self::Leaf => "leaf",
            Self::Weed => "weed",
        }
    }
}

/// All points within `radius` of the segment between two points. A disc if the two are the same.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Shape {
    /// One end of the segment, metres.
    pub from: (f64, f64),
    /// The other end, metres.
    pub to: (f64, f64),
    /// Half of the thickness, metres.
    pub radius: f64,
    /// What it is.
    pub what: What,
}

pub(super) fn minus(a: Point, b: Point) -> Point {
    (a.0 - b.0, a.1 - b.1)
}

pub(super) fn dot(a: Point, b: Point) -> f64 {
    a.0 * b.0 + a.1 * b.1
}

pub(super) fn cross(a: Point, b: Point) -> f64 {
    a.0 * b.1 - a.1 * b.0
}

/// Square of the distance of `point` from the segment.
fn distance_squared(point: Point, from: Point, to: Point) -> f64 {
    let along = minus(to, from);
    let length = dot(along, along);
    let away = minus(point, from);
    let share = if length > 0.0 {
        (dot(away, along) / length).clamp(0.0, 1.0)
    } else {
        0.0
    };
    let rest = (away.0 - share * along.0, away.1 - share * along.1);
    dot(rest, rest)
}

/// Distance along the unit vector `way` to a disc that does not contain `origin`.
fn disc(origin: Point, way: Point, centre: Point, radius: f64) -> Option<f64> {
    let to = minus(centre, origin);
    let along = dot(to, way);
    if along < 0.0 {
        return None;
    }
    let beside = cross(way, to);
    let inner = radius * radius - beside * beside;
    (inner >= 0.0).then(|| along - sqrt(inner))
}

/// Distance along `way` to a segment.
fn segment(origin: Point, way: Point, from: Point, to: Point) -> Option<f64> {
    let along = minus(to, from);
    let across = cross(way, along);
    if across == 0.0 {
        // Seen end on: a strip without thickness shows nothing.
        return None;
    }
    let start = minus(from, origin);
    let distance = cross(start, along) / across;
    let share = cross(start, way) / across;
    (distance >= 0.0 && (0.0..=1.0).contains(&share)).then_some(distance)
}

impl Shape {
    /// A disc.
    #[must_use]
    pub const fn disc(centre: (f64, f64), radius: f64, what: What) -> Self {
        Self {
            from: centre,
            to: centre,
            radius,
            what,
        }
    }

    /// Distance from `origin` along the unit vector `way` to the shape, zero if `origin` is in
    /// it.
    pub(super) fn hit(&self, origin: Point, way: Point) -> Option<f64> {
        if self.from == self.to {
            let to = minus(self.from, origin);
            if dot(to, to) <= self.radius * self.radius {
                return Some(0.0);
            }
            return disc(origin, way, self.from, self.radius);
        }
        if self.radius == 0.0 {
            return segment(origin, way, self.from, self.to);
        }
        if distance_squared(origin, self.from, self.to) <= self.radius * self.radius {
            return Some(0.0);
        }
        let along = minus(self.to, self.from);
        let scale = self.radius / sqrt(dot(along, along));
        let beside = (-along.1 * scale, along.0 * scale);
        let edge = |sign: f64| {
            let shift = |end: Point| (end.0 + sign * beside.0, end.1 + sign * beside.1);
            segment(origin, way, shift(self.from), shift(self.to))
        };
        let parts = [
            disc(origin, way, self.from, self.radius),
            disc(origin, way, self.to, self.radius),
            edge(1.0),
            edge(-1.0),
        ];
        parts.into_iter().flatten().reduce(f64::min)
    }
}

/// The area that a chassis covers: a rectangle with its middle at (`x`, `y`).
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Footprint {
    /// `x` of the middle, metres.
    pub x: f64,
    /// `y` of the middle, metres.
    pub y: f64,
    /// Direction of its length, radians.
    pub heading: f64,
    /// Half of its length, metres.
    pub half_length: f64,
    /// Half of its width, metres.
    pub half_width: f64,
}

impl Footprint {
    /// The corners: front left, front right, rear right, rear left.
    #[must_use]
    pub fn corners(&self) -> [(f64, f64); 4] {
        let (s, c) = (sin(self.heading), cos(self.heading));
        [(1.0, -1.0), (1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|(ahead, right)| {
            let (ahead, right) = (ahead * self.half_length, right * self.half_width);
            (
                self.x + ahead * c - right * s,
                self.y + ahead * s + right * c,
            )
        })
    }

    /// Whether it and `shape` have a point in common.
    #[must_use]
    pub fn touches(&self, shape: &Shape) -> bool {
        let (s, c) = (sin(self.heading), cos(self.heading));
        let own = |point: Point| {
            let (dx, dy) = minus(point, (self.x, self.y));
            (dx * c + dy * s, dy * c - dx * s)
        };
        let (from, to) = (own(shape.from), own(shape.to));
        let (length, width) = (self.half_length, self.half_width);
        if crosses(from, to, length, width) {
            return true;
        }
        let reach = shape.radius * shape.radius;
        let outside = |point: Point| {
            let beyond = (
                (point.0.abs() - length).max(0.0),
                (point.1.abs() - width).max(0.0),
            );
            dot(beyond, beyond)
        };
        // Two convex figures that do not intersect are nearest to each other at a corner of one.
        let corners = [
            (length, width),
            (length, -width),
            (-length, width),
            (-length, -width),
        ];
        outside(from) <= reach
            || outside(to) <= reach
            || corners
                .into_iter()
                .any(|corner| distance_squared(corner, from, to) <= reach)
    }
}

/// Whether a segment and the rectangle around the origin intersect (Liang and Barsky, ACM Trans.
/// Graphics 3, 1984).
fn crosses(from: Point, to: Point, half_length: f64, half_width: f64) -> bool {
    let along = minus(to, from);
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for (start, step, half) in [
        (from.0, along.0, half_length),
        (from.1, along.1, half_width),
    ] {
        if step == 0.0 {
            if start.abs() > half {
                return false;
            }
        } else {
            let (a, b) = ((-half - start) / step, (half - start) / step);
            enter = enter.max(a.min(b));
            leave = leave.min(a.max(b));
        }
    }
    enter <= leave
}
