//! Places where a vehicle may be: inside a fence, beside obstacles, or not deeper than a headland.

use crate::dubins::Pose;
use crate::scalar::Scalar;

/// Largest number of corners of a fence.
pub const CORNERS: usize = 64;

/// Largest number of corners of all obstacles together, with the first one of each again at its end.
pub const OBSTACLE_CORNERS: usize = 64;

/// Largest coordinate of a corner, m: the squares of larger ones are too much for single precision.
pub const FARTHEST: f64 = 1e5;

/// A point of the plane, m.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point<T> {
    /// North, m.
    pub north: T,
    /// East, m.
    pub east: T,
}

/// Corners that lie somewhere, for example in flash memory in the form of a file.
pub trait Corners<T>: Copy {
    /// Number of corners.
    fn count(self) -> usize;

    /// A corner, counted from zero; `None` from [`Self::count`] on.
    fn corner(self, number: usize) -> Option<Point<T>>;

    /// True if there are none.
    fn is_empty(self) -> bool {
        self.count() == 0
    }

    /// Number of the first corner that is not finite, or beyond [`FARTHEST`].
    #[allow(clippy::manual_find, reason = "a loop has a bound")]
    fn lost(self) -> Option<usize>
    where
        T: Scalar,
    {
        let near = |value: T| value.abs() <= T::lit(FARTHEST);
        let finite = |at: Point<T>| near(at.north) && near(at.east);
        // loop-bound: 64. CORNERS and OBSTACLE_CORNERS: they were counted.
        for number in 0..self.count() {
            if !self.corner(number).is_some_and(finite) {
                return Some(number);
            }
        }
        None
    }
}

impl<T: Copy> Corners<T> for &[Point<T>] {
    fn count(self) -> usize {
        self.len()
    }

    fn corner(self, number: usize) -> Option<Point<T>> {
        self.get(number).copied()
    }
}

impl<T: Copy, const N: usize> Corners<T> for &[Point<T>; N] {
    fn count(self) -> usize {
        N
    }

    fn corner(self, number: usize) -> Option<Point<T>> {
        self.get(number).copied()
    }
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

    /// How far the ground reaches on all sides of a point of the vehicle, `ahead` of the rear axle and to the `right` of the
    /// centre line (m), whatever its heading; 0 if the point is not above it.
    #[must_use]
    pub fn reach_about(&self, ahead: T, right: T) -> T {
        let beyond = if ahead > self.ahead {
            ahead - self.ahead
        } else if ahead < -self.behind {
            -self.behind - ahead
        } else {
            T::zero()
        };
        let reach = self.half_width - (beyond * beyond + right * right).root();
        if reach > T::zero() { reach } else { T::zero() }
    }

    /// The ground that is covered on a straight way (m) from a pose on, seen from there.
    #[must_use]
    pub fn swept(&self, way: T, reverse: bool) -> Self {
        let (ahead, behind) = if reverse {
            (T::zero(), way)
        } else {
            (way, T::zero())
        };
        Self {
            half_width: self.half_width,
            ahead: self.ahead + ahead,
            behind: self.behind + behind,
        }
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
/// need not be convex, but its edges must not cross, which [`Sides`] finds out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fence<C, T> {
    corners: C,
    footprint: Footprint<T>,
}

/// Why a fence is unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FenceError {
    /// Fewer than three corners, or more than [`CORNERS`].
    Corners(usize),
    /// A corner, counted from zero, is not finite or beyond [`FARTHEST`].
    Corner(usize),
    /// The side behind a corner, counted from zero, meets another one, as [`Sides`] finds.
    Crossing(usize),
    /// A number of the footprint is not finite or negative.
    Footprint,
}

impl core::fmt::Display for FenceError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Corners(count) => {
                write!(f, "the fence has {count} corners, not 3 to {CORNERS}")
            }
            Self::Corner(number) => {
                write!(f, "corner {number} of the fence is not within {FARTHEST} m")
            }
            Self::Crossing(number) => write!(
                f,
                "the side of the fence behind corner {number} meets another side"
            ),
            Self::Footprint => f.write_str("the vehicle's length or width is not usable"),
        }
    }
}

impl core::error::Error for FenceError {}

impl<C: Corners<T>, T: Scalar> Fence<C, T> {
    /// The fence with these `corners` around a vehicle.
    ///
    /// # Errors
    /// [`FenceError`] if there are too few corners or too many, or a number is not usable.
    pub fn new(corners: C, footprint: Footprint<T>) -> Result<Self, FenceError> {
        if !(3..=CORNERS).contains(&corners.count()) {
            return Err(FenceError::Corners(corners.count()));
        }
        if let Some(number) = corners.lost() {
            return Err(FenceError::Corner(number));
        }
        if !footprint.is_usable() {
            return Err(FenceError::Footprint);
        }
        Ok(Self { corners, footprint })
    }
}

impl<C: Corners<T>, T: Scalar> Room<T> for Fence<C, T> {
    fn allows(&self, at: &Pose<T>) -> bool {
        let axis = Axis::at(&self.footprint, at);
        let mut inside = false;
        let count = self.corners.count();
        let Some(mut from) = self.corners.corner(count.saturating_sub(1)) else {
            return false;
        };
        let Some(mut side) = axis.corner(from) else {
            return false;
        };
        // loop-bound: 64. A fence has up to CORNERS corners.
        for number in 0..count {
            let Some(to) = self.corners.corner(number) else {
                break;
            };
            let Some(to_side) = axis.corner(to) else {
                return false;
            };
            inside ^= passes(axis.rear, [from, to]);
            if !axis.edge([from, to], [side, to_side]) {
                return false;
            }
            (from, side) = (to, to_side);
        }
        inside
    }
}

/// Areas that the vehicle must stay out of: polygons one behind the other, each of which ends with its first
/// corner again. The edges of each must not cross, which [`Sides`] finds out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Obstacles<C, T> {
    corners: C,
    footprint: Footprint<T>,
}

/// Why obstacles are unusable.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ObstacleError {
    /// More corners than [`OBSTACLE_CORNERS`].
    Corners(usize),
    /// A corner, counted from zero, is not finite or beyond [`FARTHEST`].
    Corner(usize),
    /// An obstacle has fewer than three corners, or the last one does not end with its first corner.
    Open,
    /// The side behind a corner, counted from zero, meets another one of the same obstacle, as [`Sides`] finds.
    Crossing(usize),
    /// A number of the footprint is not finite or negative.
    Footprint,
}

impl core::fmt::Display for ObstacleError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Corners(count) => write!(
                f,
                "the obstacles have {count} corners, with the first one of each counted twice: up to \
                 {OBSTACLE_CORNERS} are accepted"
            ),
            Self::Corner(number) => write!(
                f,
                "corner {number} of the obstacles is not within {FARTHEST} m"
            ),
            Self::Open => f.write_str("an obstacle has fewer than three corners or no end"),
            Self::Crossing(number) => write!(
                f,
                "the side of an obstacle behind corner {number} of all obstacles meets another side"
            ),
            Self::Footprint => f.write_str("the vehicle's length or width is not usable"),
        }
    }
}

impl core::error::Error for ObstacleError {}

impl<C: Corners<T>, T: Scalar> Obstacles<C, T> {
    /// The obstacles with these `corners` for a vehicle; none if there are no corners.
    ///
    /// # Errors
    /// [`ObstacleError`] if there are too many corners, a number is not usable, or an obstacle is no polygon.
    pub fn new(corners: C, footprint: Footprint<T>) -> Result<Self, ObstacleError> {
        if corners.count() > OBSTACLE_CORNERS {
            return Err(ObstacleError::Corners(corners.count()));
        }
        if let Some(number) = corners.lost() {
            return Err(ObstacleError::Corner(number));
        }
        if !footprint.is_usable() {
            return Err(ObstacleError::Footprint);
        }
        let mut begin = None;
        // loop-bound: 64. OBSTACLE_CORNERS.
        for index in 0..corners.count() {
            let Some(corner) = corners.corner(index) else {
                break;
            };
            match begin {
                None => begin = Some((index, corner)),
                Some((first, at)) if at == corner => {
                    if index < first + 3 {
                        return Err(ObstacleError::Open);
                    }
                    begin = None;
                }
                Some(_) => {}
            }
        }
        match begin {
            None => Ok(Self { corners, footprint }),
            Some(_) => Err(ObstacleError::Open),
        }
    }
}

impl<C: Corners<T>, T: Scalar> Room<T> for Obstacles<C, T> {
    fn allows(&self, at: &Pose<T>) -> bool {
        let axis = Axis::at(&self.footprint, at);
        let mut inside = false;
        // The first corner of an obstacle, the last one so far, and the side of that.
        let mut ring: Option<(Point<T>, Point<T>, T)> = None;
        // loop-bound: 64. Obstacles have up to OBSTACLE_CORNERS corners.
        for number in 0..self.corners.count() {
            let Some(to) = self.corners.corner(number) else {
                break;
            };
            let Some(to_side) = axis.corner(to) else {
                return false;
            };
            let begins = ring.is_none();
            let (first, from, side) = ring.unwrap_or((to, to, to_side));
            if !axis.edge([from, to], [side, to_side]) {
                return false;
            }
            inside ^= passes(axis.rear, [from, to]);
            ring = (begins || to != first).then_some((first, to, to_side));
            if ring.is_none() && inside {
                return false;
            }
        }
        true
    }
}

/// Sides that a step of [`Sides`] compares with all later ones of their polygon.
const COMPARED: usize = 4;

/// Looks for sides of a polygon that meet, in short steps. Such a polygon has no clear inside. Neighbours may continue
/// each other, but not lead back.
///
/// Rounding can let sides meet that keep less than a millionth of their length apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sides {
    /// The first corner of the polygon, and the number behind its last one.
    begin: usize,
    end: usize,
    /// The next side, by the corner before it.
    next: usize,
    /// Polygons one behind the other, each of which ends with its first corner again.
    closed: bool,
}

impl Sides {
    /// Those of a fence with so many corners.
    #[must_use]
    pub const fn of_fence(corners: usize) -> Self {
        Self {
            begin: 0,
            end: corners,
            next: 0,
            closed: false,
        }
    }

    /// Those of obstacles that [`Obstacles::new`] accepts.
    #[must_use]
    pub const fn of_obstacles() -> Self {
        Self {
            begin: 0,
            end: 0,
            next: 0,
            closed: true,
        }
    }

    /// A step. With the last one, whether no side meets another one.
    ///
    /// # Errors
    /// The corner before the first side that does.
    pub fn step<C: Corners<T>, T: Scalar>(&mut self, corners: C) -> Option<Result<(), usize>> {
        if self.next >= self.end {
            let begin = if self.end == 0 { 0 } else { self.end + 1 };
            if !self.closed || begin >= corners.count() {
                return Some(Ok(()));
            }
            (self.begin, self.next) = (begin, begin);
            self.end = again(corners, begin);
            return None;
        }
        let mut met = None;
        // loop-bound: 4
        for number in self.next..self.end.min(self.next + COMPARED) {
            if met.is_none() && self.meets(corners, number) {
                met = Some(number);
            }
        }
        self.next += COMPARED;
        met.map(Err)
    }

    /// Whether a side meets a later one of its polygon.
    // Not inlined: its loop is bounded by itself then.
    #[inline(never)]
    fn meets<C: Corners<T>, T: Scalar>(&self, corners: C, number: usize) -> bool {
        let corner = |number: usize| {
            corners.corner(if number == self.end {
                self.begin
            } else {
                number
            })
        };
        let (Some(from), Some(to)) = (corner(number), corner(number + 1)) else {
            return false;
        };
        let side = [from, to];
        let mut met = false;
        let mut first = to;
        // loop-bound: 63. A fence has up to CORNERS sides.
        for other in number + 1..self.end {
            let last = corner(other + 1).unwrap_or(first);
            let next = [first, last];
            met |= if other == number + 1 {
                leads_back(side, next)
            } else if number == self.begin && other + 1 == self.end {
                leads_back(next, side)
            } else {
                meet(side, next)
            };
            first = last;
        }
        met
    }
}

/// The number of the corner behind `begin` that is the same again.
#[inline(never)]
fn again<C: Corners<T>, T: Scalar>(corners: C, begin: usize) -> usize {
    let first = corners.corner(begin);
    let mut found = None;
    // loop-bound: 63. Obstacles have up to OBSTACLE_CORNERS corners.
    for number in begin + 1..corners.count() {
        if found.is_none() && corners.corner(number) == first {
            found = Some(number);
        }
    }
    found.unwrap_or(corners.count())
}

/// Whether a side leads back along the one before it.
fn leads_back<T: Scalar>([from, at]: [Point<T>; 2], [_, to]: [Point<T>; 2]) -> bool {
    let (one, other) = (way(from, at), way(at, to));
    area(one, other) == T::zero() && along(one, other) < T::zero()
}

/// Whether two sides have a point in common.
fn meet<T: Scalar>(one: [Point<T>; 2], other: [Point<T>; 2]) -> bool {
    // Sides in line, which rounding puts on each other's sides, lie beside each other to the north or to the east.
    let beside = |of: fn(&Point<T>) -> T| {
        let ([a, b], [c, d]) = (one.each_ref().map(of), other.each_ref().map(of));
        let (least, most) = if a < b { (a, b) } else { (b, a) };
        c < least && d < least || c > most && d > most
    };
    !(beside(|at| at.north)
        || beside(|at| at.east)
        || is_on_one_side(one, other)
        || is_on_one_side(other, one))
}

/// Whether both ends of another side lie to the same hand of a side, and not in line with it.
fn is_on_one_side<T: Scalar>([from, to]: [Point<T>; 2], ends: [Point<T>; 2]) -> bool {
    let edge = way(from, to);
    let [one, other] = ends.map(|end| area(edge, way(from, end)));
    one > T::zero() && other > T::zero() || one < T::zero() && other < T::zero()
}

/// Whether a ray to the north from a point meets an edge. From inside a polygon it meets an odd number.
fn passes<T: Scalar>(point: Point<T>, [from, to]: [Point<T>; 2]) -> bool {
    if (from.east > point.east) == (to.east > point.east) {
        return false;
    }
    let share = (point.east - from.east) / (to.east - from.east);
    from.north + share * (to.north - from.north) > point.north
}

/// The centre line of a vehicle at a pose, with its half width about it.
struct Axis<T> {
    rear: Point<T>,
    front: Point<T>,
    /// From rear to front, m.
    way: Point<T>,
    /// Square of the distance from rear to front, m^2.
    length: T,
    /// Square of the half width.
    room: T,
}

/// North and east from one point to another.
fn way<T: Scalar>(from: Point<T>, to: Point<T>) -> Point<T> {
    Point {
        north: to.north - from.north,
        east: to.east - from.east,
    }
}

/// How far one way leads along another one, times the length of that.
fn along<T: Scalar>(one: Point<T>, other: Point<T>) -> T {
    one.north * other.north + one.east * other.east
}

/// Twice the area between two ways from one point, positive if the second leads to the right of the first.
fn area<T: Scalar>(first: Point<T>, second: Point<T>) -> T {
    first.north * second.east - first.east * second.north
}

impl<T: Scalar> Axis<T> {
    fn at(footprint: &Footprint<T>, pose: &Pose<T>) -> Self {
        let [rear, front] = footprint.ends(pose);
        let way = way(rear, front);
        Self {
            rear,
            front,
            way,
            length: along(way, way),
            room: footprint.half_width * footprint.half_width,
        }
    }

    /// On which side of the centre line a corner lies, as an area; `None` if it is nearer than the half width.
    fn corner(&self, corner: Point<T>) -> Option<T> {
        let from_rear = way(self.rear, corner);
        let (passed, side) = (along(self.way, from_rear), area(self.way, from_rear));
        let clear = if passed <= T::zero() {
            along(from_rear, from_rear) >= self.room
        } else if passed >= self.length {
            let from_front = way(self.front, corner);
            along(from_front, from_front) >= self.room
        } else {
            // Beside it, where the distance is the area over the length.
            side * side >= self.room * self.length
        };
        clear.then_some(side)
    }

    /// Whether an edge keeps away, of which both corners do and lie on these sides.
    fn edge(&self, [from, to]: [Point<T>; 2], sides: [T; 2]) -> bool {
        let edge = way(from, to);
        let length = along(edge, edge);
        let (rear, front) = (way(from, self.rear), way(from, self.front));
        let (left, right) = (area(edge, rear), area(edge, front));
        if left * right < T::zero() && sides[0] * sides[1] < T::zero() {
            return false;
        }
        // Before and behind the edge its corners are nearer.
        let clear = |end: Point<T>, area: T| {
            let passed = along(edge, end);
            !(passed > T::zero() && passed < length) || area * area >= self.room * length
        };
        clear(rear, left) && clear(front, right)
    }
}
