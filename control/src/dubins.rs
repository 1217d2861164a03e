//! Shortest paths of a car that drives only forward and turns no tighter than
//! a given radius (L. E. Dubins, American Journal of Mathematics 79, 1957).
//!
//! Headland turns consist of such paths. Tests measure an approach to a line
//! against the time that the shortest path takes. [`shortest_to_line`] takes
//! some hundred thousand operations: use it on the host or between passes, not
//! in the control step.

use crate::scalar::{Scalar, wrap_angle};

/// A position and a heading in the plane.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose<T> {
    /// North, m.
    pub north: T,
    /// East, m.
    pub east: T,
    /// Radians clockwise from north.
    pub heading: T,
}

/// Largest heading that a planner takes, rad, in size: of a larger one, rounding errors hide the direction in single
/// precision.
pub const LARGEST_HEADING: f64 = 1000.0;

impl<T: Scalar> Pose<T> {
    /// Whether a path can lead from or to this pose.
    pub(crate) fn is_usable(&self) -> bool {
        self.north.is_finite()
            && self.east.is_finite()
            && self.heading.abs() <= T::lit(LARGEST_HEADING)
    }
}

/// The kind of one piece of a path.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Turn {
    /// An arc to the left (anticlockwise).
    Left,
    /// A straight piece.
    Straight,
    /// An arc to the right (clockwise).
    Right,
}

impl Turn {
    /// Curvature of the piece at unit radius: -1, 0 or 1.
    #[must_use]
    pub const fn sign(self) -> i8 {
        match self {
            Self::Left => -1,
            Self::Straight => 0,
            Self::Right => 1,
        }
    }
}

/// A shortest path: three pieces, each with its length in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DubinsPath<T> {
    /// The pieces in driving order; any may have zero length.
    pub pieces: [(Turn, T); 3],
    /// Radius of the arcs, m.
    pub radius: T,
}

/// Why no path could be computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DubinsError {
    /// The radius is not a positive number.
    Radius,
    /// A coordinate of a pose is not a finite number, or so large that its square is none in radii, or the heading is
    /// beyond [`LARGEST_HEADING`].
    Pose,
}

impl core::fmt::Display for DubinsError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Radius => "the turning radius is not a positive number",
            Self::Pose => {
                "a coordinate of a pose is not a finite number or too large, or its heading is beyond 1000 rad"
            }
        })
    }
}

impl core::error::Error for DubinsError {}

impl<T: Scalar> DubinsPath<T> {
    /// Length of the whole path, m.
    #[must_use]
    pub fn length(&self) -> T {
        let [(_, first), (_, second), (_, third)] = self.pieces;
        first + second + third
    }

    /// Pose at the end of the path if it starts at `start`.
    #[must_use]
    pub fn end(&self, start: Pose<T>) -> Pose<T> {
        self.pieces.iter().fold(start, |pose, &(turn, length)| {
            advance(pose, T::lit(f64::from(turn.sign())) / self.radius, length)
        })
    }
}

/// The pose after driving `length` metres from `start` with constant
/// `curvature` (1/m, positive to the right).
#[must_use]
pub fn advance<T: Scalar>(start: Pose<T>, curvature: T, length: T) -> Pose<T> {
    let turn = curvature * length;
    let half = turn * T::lit(0.5);
    let (sine, cosine) = (start.heading + half).sine_cosine();
    // Ratio of chord to arc, sin(x)/x. For small x the series is more exact
    // than the quotient.
    let shrink = if half.abs() < T::lit(1e-2) {
        let square = half * half;
        T::one() - square / T::lit(6.0) + square * square / T::lit(120.0)
    } else {
        half.sine_cosine().0 / half
    };
    Pose {
        north: start.north + length * shrink * cosine,
        east: start.east + length * shrink * sine,
        heading: wrap_angle(start.heading + turn),
    }
}

/// The shortest path from `start` to `end` with turns of at least `radius`
/// metres.
///
/// # Errors
/// [`DubinsError`] if the radius is not positive or a pose is not usable.
pub fn shortest<T: Scalar>(
    start: Pose<T>,
    end: Pose<T>,
    radius: T,
) -> Result<DubinsPath<T>, DubinsError> {
    if !(radius.is_finite() && radius > T::zero()) {
        return Err(DubinsError::Radius);
    }
    if !(start.is_usable() && end.is_usable()) {
        return Err(DubinsError::Pose);
    }
    // Lengths are in units of the radius, and the end lies on the first axis
    // (Shkel and Lumelsky, Robotics and Autonomous Systems 34, 2001). Our
    // angles are clockwise positive, so the article's "left" is our right.
    let north = (end.north - start.north) / radius;
    let east = (end.east - start.east) / radius;
    let distance = (north * north + east * east).root();
    if !distance.is_finite() {
        return Err(DubinsError::Pose);
    }
    let bearing = east.angle_of(north);
    let alpha = turn_forward(start.heading - bearing);
    let beta = turn_forward(end.heading - bearing);
    let words = [
        csc(distance, alpha, beta, true, true),
        csc(distance, alpha, beta, true, false),
        csc(distance, alpha, beta, false, true),
        csc(distance, alpha, beta, false, false),
        ccc(distance, alpha, beta, true),
        ccc(distance, alpha, beta, false),
    ];
    // Coordinates have this many rounding errors, in units of the radius.
    let coordinates =
        (start.north.abs() + start.east.abs() + end.north.abs() + end.east.abs()) / radius;
    let rounding = T::default_epsilon() * T::lit(16.0) * (T::one() + coordinates);
    let length = |pieces: &[(Turn, T); 3]| pieces.iter().fold(T::zero(), |sum, p| sum + p.1);
    let mut best: Option<[(Turn, T); 3]> = None;
    let shorter = fewer_pieces(distance, alpha, beta, rounding);
    for pieces in words.into_iter().chain(shorter).flatten() {
        // Far away a length may be NaN, than which none is shorter.
        if length(&pieces).is_finite()
            && best
                .as_ref()
                .is_none_or(|best| length(&pieces) < length(best))
        {
            best = Some(pieces);
        }
    }
    // Two arcs to the same side, joined by a straight piece, exist for every pose that is not so far away.
    let pieces = best.ok_or(DubinsError::Pose)?;
    let path = DubinsPath {
        pieces: pieces.map(|(turn, length)| (turn, length * radius)),
        radius,
    };
    if path.length().is_finite() {
        Ok(path)
    } else {
        Err(DubinsError::Pose)
    }
}

/// The shortest path from `start` to any point of the northward line through
/// the origin, arriving with heading north. `start.east` is the cross-track
/// error, `start.heading` the heading error.
///
/// # Errors
/// [`DubinsError`] if the radius is not positive or the pose is not usable.
pub fn shortest_to_line<T: Scalar>(
    start: Pose<T>,
    radius: T,
) -> Result<DubinsPath<T>, DubinsError> {
    let ending = |north: T| {
        let end = Pose {
            north,
            east: T::zero(),
            heading: T::zero(),
        };
        shortest(start, end, radius)
    };
    let mut best = ending(start.north)?;
    let mut best_north = start.north;
    // An end point farther away than this gives a longer path than turning
    // onto the line directly.
    let mut reach = start.east.abs() + T::lit(7.0) * radius;
    for _ in 0..12 {
        let centre = best_north;
        const STEPS: i32 = 40;
        for k in -STEPS..=STEPS {
            let north = centre + reach * T::lit(f64::from(k) / f64::from(STEPS));
            let path = ending(north)?;
            if path.length() < best.length() {
                best = path;
                best_north = north;
            }
        }
        reach *= T::lit(if reach > radius { 0.25 } else { 0.1 });
    }
    Ok(best)
}

/// `angle` brought into [0, 2 pi).
pub(crate) fn turn_forward<T: Scalar>(angle: T) -> T {
    let wrapped = wrap_angle(angle);
    // A small negative angle is zero with a rounding error, not a full turn.
    if wrapped < -T::default_epsilon() * T::lit(16.0) {
        wrapped + T::two_pi()
    } else if wrapped < T::zero() {
        T::zero()
    } else {
        wrapped
    }
}

/// The paths of one or two pieces, if they end within `rounding` radians and radii
/// of the end: an arc behind a straight piece or before it, and two arcs.
///
/// [`csc`] has them too, as paths with a piece of length zero. But a rounding error
/// can make a zero arc slightly negative, which is nearly a full circle there, and
/// the direction of a straight piece of length zero is not defined.
fn fewer_pieces<T: Scalar>(
    distance: T,
    alpha: T,
    beta: T,
    rounding: T,
) -> [Option<[(Turn, T); 3]>; 6] {
    let at = |north: T, heading: T| Pose {
        north,
        east: T::zero(),
        heading,
    };
    let (start, end) = (at(T::zero(), alpha), at(distance, beta));
    let none = (Turn::Straight, T::zero());
    let reaching = |pieces: [(Turn, T); 3]| {
        let radius = T::one();
        let reached = DubinsPath { pieces, radius }.end(start);
        let near = |off: T| off.abs() <= rounding;
        let arrives = near(reached.north - end.north)
            && near(reached.east - end.east)
            && near(wrap_angle(reached.heading - end.heading));
        let forward = pieces.iter().all(|piece| piece.1 >= T::zero());
        (arrives && forward).then_some(pieces)
    };
    let mut paths = [None; 6];
    for (slot, (turn, side)) in paths
        .chunks_exact_mut(3)
        .zip([(Turn::Right, T::one()), (Turn::Left, -T::one())])
    {
        let arc = (turn, turn_forward(side * (beta - alpha)));
        // The straight piece leads from where the arc ends to the end, or from the
        // start to where the arc must begin. A small negative length is zero with
        // a rounding error.
        let turned = advance(start, side, arc.1);
        let (dn, de) = (end.north - turned.north, end.east - turned.east);
        let along = |heading: T| {
            let (sine, cosine) = heading.sine_cosine();
            let length = cosine * dn + sine * de;
            let length = if length.abs() <= rounding {
                T::zero()
            } else {
                length
            };
            (Turn::Straight, length)
        };
        let other = if side > T::zero() {
            Turn::Left
        } else {
            Turn::Right
        };
        // Both circles touch: the direction there is square to the line between
        // their centres.
        let (sine_a, cosine_a) = alpha.sine_cosine();
        let (sine_b, cosine_b) = beta.sine_cosine();
        let x = distance + side * (sine_b + sine_a);
        let y = -side * (cosine_b + cosine_a);
        let direction = y.angle_of(x) + side * T::frac_pi_2();
        let first = (turn, turn_forward(side * (direction - alpha)));
        let last = (other, turn_forward(side * (direction - beta)));
        let found = [
            reaching([along(alpha), arc, none]),
            reaching([arc, along(beta), none]),
            reaching([first, none, last]),
        ];
        for (path, found) in slot.iter_mut().zip(found) {
            *path = found;
        }
    }
    paths
}

/// The path of an arc, a straight piece and an arc, if it exists; a right arc
/// turns clockwise.
fn csc<T: Scalar>(
    distance: T,
    alpha: T,
    beta: T,
    first_right: bool,
    last_right: bool,
) -> Option<[(Turn, T); 3]> {
    // From the centre of the first turning circle to that of the last.
    let side = |right: bool| if right { T::one() } else { -T::one() };
    let (sine_a, cosine_a) = alpha.sine_cosine();
    let (sine_b, cosine_b) = beta.sine_cosine();
    let (first, last) = (side(first_right), side(last_right));
    let x = distance - last * sine_b + first * sine_a;
    let y = last * cosine_b - first * cosine_a;
    let square = x * x + y * y;
    let span = y.angle_of(x);
    let (length, direction) = if first_right == last_right {
        (square.root(), span)
    } else {
        let rest = square - T::lit(4.0);
        if rest < T::zero() {
            return None;
        }
        let length = rest.root();
        (length, span + first * T::lit(2.0).angle_of(length))
    };
    let turn = |right: bool| if right { Turn::Right } else { Turn::Left };
    Some([
        (turn(first_right), turn_forward(first * (direction - alpha))),
        (Turn::Straight, length),
        (turn(last_right), turn_forward(last * (beta - direction))),
    ])
}

/// The path of three arcs, if it exists. The middle one turns the other way and
/// is longer than a half circle.
fn ccc<T: Scalar>(distance: T, alpha: T, beta: T, right: bool) -> Option<[(Turn, T); 3]> {
    let side = if right { T::one() } else { -T::one() };
    let (sine_a, cosine_a) = alpha.sine_cosine();
    let (sine_b, cosine_b) = beta.sine_cosine();
    let x = distance - side * sine_b + side * sine_a;
    let y = side * cosine_b - side * cosine_a;
    let between = (x * x + y * y).root();
    if !(between <= T::lit(4.0)) {
        return None;
    }
    let span = y.angle_of(x);
    // Angle at the centre of an outer circle, between the directions to the
    // other outer centre and to the centre of the middle circle.
    let corner = (between * T::lit(0.25)).arccosine();
    // The middle circle can lie on either side. `leave` and `join` are the
    // directions of travel where the circles touch.
    let mut best: Option<[(Turn, T); 3]> = None;
    for sign in [T::one(), -T::one()] {
        let quarter = T::frac_pi_2();
        let leave = span + sign * corner + side * quarter;
        let join = span + T::pi() - sign * corner + side * quarter;
        let first = turn_forward(side * (leave - alpha));
        let middle = turn_forward(-side * (join - leave));
        let last = turn_forward(side * (beta - join));
        let total = first + middle + last;
        if best.is_none_or(|[a, b, c]| total < a.1 + b.1 + c.1) {
            let (outer, inner) = if right {
                (Turn::Right, Turn::Left)
            } else {
                (Turn::Left, Turn::Right)
            };
            best = Some([(outer, first), (inner, middle), (outer, last)]);
        }
    }
    best
}
