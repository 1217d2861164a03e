//! Paths of several segments: passes across the field, joined by headland
//! turns or by arcs at their corners. Coordinates are in the estimator's frame.

use crate::clothoid::{nearby, travel};
use crate::dubins::{DubinsError, Pose, advance, shortest};
use crate::line::{Line, LineError};
use crate::position::Position;
use crate::scalar::{Scalar, clamp_symmetric, wrap_angle};

/// Largest number of segments of a path. Four passes with three headland turns
/// of three pieces each need thirteen.
pub const CAPACITY: usize = 16;

/// A straight piece, an arc or a clothoid.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Segment<T> {
    /// Pose at its beginning, relative to the path's origin.
    pub start: Pose<T>,
    /// Curvature at its beginning, 1/m, positive to the right; zero for a straight
    /// piece.
    pub curvature: T,
    /// Change of the curvature with each metre, 1/m^2; zero for a straight piece
    /// and for an arc.
    pub sharpness: T,
    /// Length, m.
    pub length: T,
}

/// Position of a point relative to a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place<T> {
    /// Distance along the segment, m; negative before its beginning.
    pub along: T,
    /// Distance to the right of the path, m.
    pub cross_track: T,
    /// Direction of the path at the point nearest to it, rad clockwise from
    /// north.
    pub bearing: T,
}

/// Why a path could not be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathError {
    /// There is no pass.
    Empty,
    /// More segments than [`CAPACITY`].
    Full,
    /// Both ends of a pass coincide.
    Pass {
        /// The pass, counted from zero.
        number: usize,
        /// Why it defines no line.
        error: LineError,
    },
    /// A turn between two passes could not be computed.
    Turn(DubinsError),
}

impl core::fmt::Display for PathError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Empty => f.write_str("a path needs at least one pass"),
            Self::Full => write!(f, "a path has at most {CAPACITY} segments"),
            Self::Pass { number, error } => write!(f, "pass {number}: {error}"),
            Self::Turn(error) => error.fmt(f),
        }
    }
}

impl core::error::Error for PathError {}

impl<T: Scalar> Segment<T> {
    /// Position of the point `north`, `east` (m) relative to this segment.
    /// `near` is the point's last known distance along the segment: on an arc of
    /// more than a full circle it selects the right round, and on a clothoid the
    /// search begins there.
    ///
    /// On a clothoid the result is exact for a point closer to it than half its
    /// smallest radius, if `near` is within half a radian of turn. From elsewhere
    /// the search may end early; the next call continues it.
    #[must_use]
    pub fn locate(&self, north: T, east: T, near: T) -> Place<T> {
        if self.sharpness != T::zero() {
            return self.search(self.pose(near), near, north, east);
        }
        let (sine, cosine) = self.start.heading.sine_cosine();
        let (dn, de) = (north - self.start.north, east - self.start.east);
        let along = cosine * dn + sine * de;
        let right = cosine * de - sine * dn;
        if self.curvature == T::zero() {
            return Place {
                along,
                cross_track: right,
                bearing: self.start.heading,
            };
        }
        let (along, turned, cross_track) = beside_arc(self.curvature, along, right, near);
        Place {
            along,
            cross_track,
            bearing: wrap_angle(self.start.heading + turned),
        }
    }

    /// The same for a point near the segment's beginning, at less cost on a clothoid.
    #[must_use]
    pub(crate) fn enter(&self, north: T, east: T) -> Place<T> {
        if self.sharpness == T::zero() {
            self.locate(north, east, T::zero())
        } else {
            self.search(self.start, T::zero(), north, east)
        }
    }

    /// Newton's method for the place where the vector to the point is square to the
    /// clothoid, from the pose `on` at `near`.
    fn search(&self, on: Pose<T>, near: T, north: T, east: T) -> Place<T> {
        let exact = T::default_epsilon().root();
        let end = self.curvature_at(self.length);
        let largest = if self.curvature.abs() > end.abs() {
            self.curvature.abs()
        } else {
            end.abs()
        };
        let (mut on, mut along) = (on, near);
        let mut place = Place {
            along,
            cross_track: T::zero(),
            bearing: self.start.heading,
        };
        // loop-bound: 5. The error is squared in each turn: three are usual.
        for _ in 0..5 {
            let curvature = self.curvature_at(along);
            let (sine, cosine) = on.heading.sine_cosine();
            let (dn, de) = (north - on.north, east - on.east);
            let ahead = cosine * dn + sine * de;
            let right = cosine * de - sine * dn;
            // Near the centre of curvature all places are about equally close, and a
            // step would be too long.
            let closing = T::one() - curvature * right;
            let least = T::lit(0.25);
            let step = ahead / if closing > least { closing } else { least };
            let step = if step.abs() * largest > T::one() {
                clamp_symmetric(step, T::one() / largest)
            } else {
                step
            };
            let from = along;
            along += step;
            place = Place {
                along,
                cross_track: right,
                bearing: wrap_angle(on.heading + curvature * step),
            };
            if !(step.abs() > exact) {
                break;
            }
            on = self.moved(on, from, along);
        }
        place
    }

    /// The pose at `to` from that at `from`, both in metres, when the way between them turns by at most one
    /// radian.
    fn moved(&self, on: Pose<T>, from: T, to: T) -> Pose<T> {
        // Beyond the ends the curvature is that of the end.
        let inside = |along: T| {
            if !(along > T::zero()) {
                T::zero()
            } else if along > self.length {
                self.length
            } else {
                along
            }
        };
        let (leave, arrive) = (inside(from), inside(to));
        let on = advance(on, self.curvature_at(from), leave - from);
        let on = nearby(on, self.curvature_at(leave), self.sharpness, arrive - leave);
        advance(on, self.curvature_at(arrive), to - arrive)
    }

    /// The pose at `along` metres. Before its beginning and beyond its end a clothoid
    /// continues with the curvature that it has there.
    #[must_use]
    pub fn pose(&self, along: T) -> Pose<T> {
        if self.sharpness == T::zero() || along < T::zero() {
            return advance(self.start, self.curvature, along);
        }
        if along > self.length {
            let end = self.curvature_at(self.length);
            return advance(self.end(), end, along - self.length);
        }
        travel(self.start, self.curvature, self.sharpness, along)
    }

    /// The curvature (1/m) at `along` metres; that of the nearer end before the
    /// beginning and beyond the end.
    #[must_use]
    pub fn curvature_at(&self, along: T) -> T {
        let inside = if !(along > T::zero()) {
            T::zero()
        } else if along > self.length {
            self.length
        } else {
            along
        };
        self.curvature + self.sharpness * inside
    }

    /// The pose at the segment's end.
    #[must_use]
    pub fn end(&self) -> Pose<T> {
        travel(self.start, self.curvature, self.sharpness, self.length)
    }
}

/// Way along an arc of `curvature` (1/m, not zero) to the place nearest to the point `ahead` of
/// its beginning and to the `right` of it (m), heading there relative to that at the beginning
/// (rad), and distance of the point to the right of the arc (m). Of all ways that differ by whole
/// rounds, that nearest to `near` (m) is meant.
fn beside_arc<T: Scalar>(curvature: T, ahead: T, right: T, near: T) -> (T, T, T) {
    let (way, turned, cross_track) = if curvature.abs() * (ahead.abs() + right.abs()) <= T::one() {
        within_radius(curvature, ahead, right)
    } else {
        beyond_radius(curvature, ahead, right)
    };
    let missing = turned - curvature * near;
    if missing.abs() <= T::pi() {
        return (way, turned, cross_track);
    }
    // With so many rounds that rounding errors hide them, any place of the last one is as good.
    let missing = if missing.abs() * T::default_epsilon() < T::one() {
        wrap_angle(missing)
    } else {
        T::zero()
    };
    (near + missing / curvature, turned, cross_track)
}

/// [`beside_arc`] for a point that is closer to the beginning than the radius. The difference
/// between the radius and the distance from the centre would lose all digits on a wide arc: with
/// curvature k, x ahead and y to the right it is expanded to
/// (2 y - k (x^2 + y^2)) / (1 + root((k x)^2 + (1 - k y)^2)).
fn within_radius<T: Scalar>(curvature: T, ahead: T, right: T) -> (T, T, T) {
    // From the centre, in radii.
    let (across, inward) = (curvature * ahead, T::one() - curvature * right);
    let distance = (across * across + inward * inward).root();
    let cross_track = (right * (T::one() + inward) - ahead * across) / (T::one() + distance);
    // The quotient of the angle and a subnormal curvature has few digits. The series for the
    // arctangent of a small ratio needs no division by the curvature.
    if across.abs() <= inward * T::lit(1e-3) {
        let ratio = across / inward;
        let square = ratio * ratio;
        let share = T::one() - square * (T::lit(1.0 / 3.0) - square * T::lit(0.2));
        let way = ahead / inward * share;
        (way, curvature * way, cross_track)
    } else {
        let turned = across.angle_of(inward);
        (turned / curvature, turned, cross_track)
    }
}

/// [`beside_arc`] for a point that is farther from the beginning than the radius, where curvature
/// times distance can be too large a number.
fn beyond_radius<T: Scalar>(curvature: T, ahead: T, right: T) -> (T, T, T) {
    let radius = T::one() / curvature;
    let side = if radius > T::zero() {
        T::one()
    } else {
        -T::one()
    };
    let inward = radius - right;
    let distance = (ahead * ahead + inward * inward).root();
    let turned = (side * ahead).angle_of(side * inward);
    (turned * radius, turned, radius - side * distance)
}

/// Segments in driving order. The first one continues backwards beyond its
/// beginning and the last one forwards beyond its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Path<T> {
    origin: Position,
    segments: [Segment<T>; CAPACITY],
    count: usize,
}

impl<T: Scalar> Path<T> {
    /// The path along one line.
    #[must_use]
    pub fn line(line: &Line<T>) -> Self {
        let mut path = Self::empty(line.origin());
        // A new path has room for one segment.
        let _ = path.push(line.bearing(), T::zero(), line.length());
        path
    }

    /// A path over `passes` in driving order, each from its first to its second
    /// waypoint, joined by the shortest headland turns of `radius` metres.
    /// Choose the radius a few tenths of a metre wider than the tightest turn,
    /// so that the law has some steering angle left for corrections.
    ///
    /// A pass that begins exactly where the one before it ends, at a kink of up to
    /// 120 degrees, is joined to that by an arc of `radius` to which both are
    /// tangents, if they are long enough. The path then misses the corner by r (1 /
    /// cos(kink / 2) - 1): 3.5 % of the radius at 30 degrees, one radius at 120.
    ///
    /// # Errors
    /// [`PathError`] names the pass at fault.
    pub fn passes(passes: &[(Position, Position)], radius: T) -> Result<Self, PathError> {
        let Some(&(origin, _)) = passes.first() else {
            return Err(PathError::Empty);
        };
        let mut path = Self::empty(origin);
        for (number, &(from, to)) in passes.iter().enumerate() {
            let line =
                Line::<T>::new(from, to).map_err(|error| PathError::Pass { number, error })?;
            let (north, east) = from.metres_from::<T>(origin);
            let mut start = Pose {
                north,
                east,
                heading: line.bearing(),
            };
            let mut length = line.length();
            let meets = number > 0 && passes.get(number - 1).is_some_and(|pass| pass.1 == from);
            let cut = if meets {
                path.round_corner(&line, radius)?
            } else {
                None
            };
            if let Some(cut) = cut {
                start = advance(start, T::zero(), cut);
                length -= cut;
            } else if number > 0 {
                let turn = shortest(path.end(), start, radius).map_err(PathError::Turn)?;
                for (way, length) in turn.pieces {
                    path.push_arc(T::lit(f64::from(way.sign())) / radius, length)?;
                }
            }
            path.push(line.bearing(), T::zero(), length)?;
            // Start the pass exactly, so that rounding errors of the turns do
            // not accumulate.
            if let Some(last) = path.segments.get_mut(path.count.saturating_sub(1)) {
                last.start = start;
            }
        }
        Ok(path)
    }

    /// Joins the last pass to `next`, which begins where that ends, by the arc that
    /// both are tangents of. Returns the length that it takes from each of them, m;
    /// `None`, and an unchanged path, where there is no such arc.
    fn round_corner(&mut self, next: &Line<T>, radius: T) -> Result<Option<T>, PathError> {
        let Some(last) = self.segments.get_mut(self.count.saturating_sub(1)) else {
            return Ok(None);
        };
        let kink = wrap_angle(next.bearing() - last.start.heading);
        // Twice this angle is 120 degrees, where the arc passes the corner at a
        // distance of one radius.
        let half = kink.abs() * T::lit(0.5);
        if !(half <= T::frac_pi_3() && radius > T::zero() && radius.is_finite()) {
            return Ok(None);
        }
        let cut = radius * half.tangent();
        if !(cut <= last.length && cut <= next.length()) {
            return Ok(None);
        }
        last.length -= cut;
        let side = if kink > T::zero() {
            T::one()
        } else {
            -T::one()
        };
        self.push_arc(side / radius, kink.abs() * radius)?;
        Ok(Some(cut))
    }

    /// Goes on from the end, unless the `length` (m) is nothing.
    fn push_arc(&mut self, curvature: T, length: T) -> Result<(), PathError> {
        if length > T::lit(1e-4) {
            self.push(self.end().heading, curvature, length)
        } else {
            Ok(())
        }
    }

    fn empty(origin: Position) -> Self {
        Self {
            origin,
            segments: [Segment {
                start: Pose {
                    north: T::zero(),
                    east: T::zero(),
                    heading: T::zero(),
                },
                curvature: T::zero(),
                sharpness: T::zero(),
                length: T::zero(),
            }; CAPACITY],
            count: 0,
        }
    }

    fn push(&mut self, heading: T, curvature: T, length: T) -> Result<(), PathError> {
        let end = self.end();
        let slot = self.segments.get_mut(self.count).ok_or(PathError::Full)?;
        *slot = Segment {
            start: Pose { heading, ..end },
            curvature,
            sharpness: T::zero(),
            length,
        };
        self.count += 1;
        Ok(())
    }

    /// The pose at the end of the path; the origin for an empty one.
    #[must_use]
    pub fn end(&self) -> Pose<T> {
        match self.segments().last() {
            Some(last) => last.end(),
            None => Pose {
                north: T::zero(),
                east: T::zero(),
                heading: T::zero(),
            },
        }
    }

    /// The origin of the path's frame: its first waypoint.
    #[must_use]
    pub fn origin(&self) -> Position {
        self.origin
    }

    /// The segments in driving order.
    #[must_use]
    pub fn segments(&self) -> &[Segment<T>] {
        self.segments.get(..self.count).unwrap_or(&self.segments)
    }

    /// Curvature (1/m) of the path at `along` metres along the segment `number`.
    /// A distance beyond the segment's ends lies on its neighbours.
    #[must_use]
    pub fn curvature(&self, number: usize, along: T) -> T {
        let touch = T::lit(0.01);
        self.smoothed(number, along, touch).curvature
    }

    /// Curvature and heading of the path at `along` metres along the segment
    /// `number`, averaged over `half` metres (positive) to either side. A
    /// steering of limited rate can follow the averaged curvature; it cannot
    /// follow the jumps between straight pieces and arcs.
    #[must_use]
    pub fn smoothed(&self, number: usize, along: T, half: T) -> Smoothed<T> {
        let mut mean = Averaged::over(half);
        let mut begin = T::zero();
        // loop-bound: 16. A path has up to CAPACITY segments.
        for segment in self.segments().iter().skip(number) {
            mean.add(begin, along, segment);
            begin += segment.length;
        }
        let mut begin = T::zero();
        // loop-bound: 16. A path has up to CAPACITY segments.
        for segment in self.segments().iter().take(number).rev() {
            begin -= segment.length;
            mean.add(begin, along, segment);
        }
        mean.result()
    }
}

/// Sums for the averages of curvature and heading about a place.
#[derive(Clone, Copy, Debug)]
struct Averaged<T> {
    half: T,
    curvature: T,
    turn: T,
}

impl<T: Scalar> Averaged<T> {
    /// Averages over `half` metres to either side.
    fn over(half: T) -> Self {
        Self {
            half,
            curvature: T::zero(),
            turn: T::zero(),
        }
    }

    /// Adds what the `segment` contributes. It begins `begin` metres from where the
    /// place is at `along` metres.
    fn add(&mut self, begin: T, along: T, segment: &Segment<T>) {
        let half = self.half;
        // The mean heading relative to the heading at the place is the curvature
        // weighted by distance. This is the integral of that weight.
        let weight = |at: T| half * at.abs() - at * at * T::lit(0.5);
        let from = if begin - along > -half {
            begin - along
        } else {
            -half
        };
        let end = begin + segment.length;
        let to = if end - along < half {
            end - along
        } else {
            half
        };
        if !(to > from) {
            return;
        }
        // Curvature of the segment, continued to the place.
        let here = if segment.sharpness == T::zero() {
            segment.curvature
        } else {
            segment.curvature + segment.sharpness * (along - begin)
        };
        self.curvature += here * (to - from);
        self.turn += here * (weight(to) - weight(from));
        if segment.sharpness != T::zero() {
            // The integral of the weight times the distance.
            let moment = |at: T| at * at.abs() * half * T::lit(0.5) - at * at * at / T::lit(3.0);
            let square = (to - from) * (to + from) * T::lit(0.5);
            self.curvature += segment.sharpness * square;
            self.turn += segment.sharpness * (moment(to) - moment(from));
        }
    }

    fn result(&self) -> Smoothed<T> {
        let width = self.half + self.half;
        if width > T::zero() {
            Smoothed {
                curvature: self.curvature / width,
                turn: self.turn / width,
            }
        } else {
            Smoothed {
                curvature: T::zero(),
                turn: T::zero(),
            }
        }
    }
}

/// Averaged curvature and heading at one place of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothed<T> {
    /// Mean curvature, 1/m.
    pub curvature: T,
    /// Mean heading minus the heading at the place, rad.
    pub turn: T,
}

/// Progress along a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress<T> {
    /// The segment being followed, counted from zero.
    pub segment: usize,
    /// Distance along it, m.
    pub along: T,
    /// True once the end of the path has been passed.
    pub finished: bool,
}

impl<T: Scalar> Progress<T> {
    /// Progress at the beginning of a path.
    #[must_use]
    pub fn start() -> Self {
        Self {
            segment: 0,
            along: T::zero(),
            finished: false,
        }
    }

    /// Advances to the point `north`, `east` (m) and returns its position
    /// relative to the segment reached. It never goes back to an earlier
    /// segment.
    pub fn advance(&mut self, path: &Path<T>, north: T, east: T) -> Place<T> {
        let nowhere = Place {
            along: T::zero(),
            cross_track: T::zero(),
            bearing: T::zero(),
        };
        let segments = path.segments();
        let Some(segment) = segments.get(self.segment) else {
            return nowhere;
        };
        let mut place = segment.locate(north, east, self.along);
        let mut length = segment.length;
        // loop-bound: 16. A path has up to CAPACITY segments.
        for next in segments.iter().skip(self.segment.saturating_add(1)) {
            if !(place.along > length) {
                break;
            }
            self.segment += 1;
            place = next.locate(north, east, T::zero());
            length = next.length;
        }
        self.finished = place.along > length;
        self.along = place.along;
        place
    }
}
