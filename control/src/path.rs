//! Paths of several segments: passes over the field and the headland turns
//! between them, in the frame of the estimator.

use crate::dubins::{DubinsError, Pose, advance, shortest};
use crate::line::{Line, LineError};
use crate::position::Position;
use crate::scalar::{Scalar, wrap_angle};

/// Most segments of a path: four passes with three headland turns between
/// them need thirteen.
pub const CAPACITY: usize = 16;

/// A straight piece or an arc.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Segment<T> {
    /// Where it begins, m from the path's origin.
    pub start: Pose<T>,
    /// Curvature, 1/m, positive to the right; zero for a straight piece.
    pub curvature: T,
    /// Length, m.
    pub length: T,
}

/// Where a point stands relative to a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place<T> {
    /// Distance along the segment, m; negative before its beginning.
    pub along: T,
    /// Distance to the right of the path, m.
    pub cross_track: T,
    /// Direction of the path beside the point, rad clockwise from north.
    pub bearing: T,
}

/// Why a path could not be built.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PathError {
    /// There is no pass at all.
    Empty,
    /// More segments than [`CAPACITY`].
    Full,
    /// The two ends of this pass (counted from zero) coincide.
    Pass {
        /// Which pass.
        number: usize,
        /// What is wrong with it.
        error: LineError,
    },
    /// The turns between passes.
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
    /// Where the point `north`, `east` (m) stands relative to this segment;
    /// `near` is the distance along it where the point was last, which tells
    /// the turns of an arc apart.
    #[must_use]
    pub fn locate(&self, north: T, east: T, near: T) -> Place<T> {
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
        // From the centre, in the frame of the segment's beginning.
        let radius = T::one() / self.curvature;
        let sign = if radius > T::zero() {
            T::one()
        } else {
            -T::one()
        };
        let inward = right - radius;
        let distance = (along * along + inward * inward).root();
        let turned = sign * along.angle_of(-sign * inward);
        let before = self.curvature * near;
        let turned = before + wrap_angle(turned - before);
        Place {
            along: turned * radius,
            cross_track: radius - sign * distance,
            bearing: wrap_angle(self.start.heading + turned),
        }
    }

    /// The pose at the segment's end.
    #[must_use]
    pub fn end(&self) -> Pose<T> {
        advance(self.start, self.curvature, self.length)
    }
}

/// Segments in driving order. The first continues straight before its
/// beginning, the last beyond its end.
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

    /// Passes in driving order, each from its first to its second waypoint,
    /// joined by the shortest headland turns of `radius` metres. Choose the
    /// radius some tenths wider than the tightest turn: the rest corrects.
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
            let start = Pose {
                north,
                east,
                heading: line.bearing(),
            };
            if number > 0 {
                let turn = shortest(path.end(), start, radius).map_err(PathError::Turn)?;
                for (way, length) in turn.pieces {
                    if length > T::lit(1e-4) {
                        let curvature = T::lit(f64::from(way.sign())) / radius;
                        let heading = path.end().heading;
                        path.push(heading, curvature, length)?;
                    }
                }
            }
            path.push(line.bearing(), T::zero(), line.length())?;
            // Roundings of the turns do not add up.
            if let Some(last) = path.segments.get_mut(path.count.saturating_sub(1)) {
                last.start = start;
            }
        }
        Ok(path)
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

    /// Curvature of the path at `along` metres along the segment `number` (or
    /// beyond its ends), 1/m.
    #[must_use]
    pub fn curvature(&self, number: usize, along: T) -> T {
        let touch = T::lit(0.01);
        self.smoothed(number, along, touch).curvature
    }

    /// The path at `along` metres along the segment `number`, smoothed by a
    /// mean over `half` metres (positive) to either side: what a steering that
    /// takes its time can follow.
    #[must_use]
    pub fn smoothed(&self, number: usize, along: T, half: T) -> Smoothed<T> {
        let mut curvature = T::zero();
        let mut turn = T::zero();
        // Weight of the curvature at a distance in the mean heading, less the
        // heading here, as its integral.
        let weight = |at: T| half * at.abs() - at * at * T::lit(0.5);
        let mut add = |begin: T, segment: &Segment<T>| {
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
            if to > from {
                curvature += segment.curvature * (to - from);
                turn += segment.curvature * (weight(to) - weight(from));
            }
        };
        let mut begin = T::zero();
        // loop-bound: 1 the vehicle's path is one line
        for segment in self.segments().iter().skip(number) {
            add(begin, segment);
            begin += segment.length;
        }
        let mut begin = T::zero();
        // loop-bound: 1 the vehicle's path is one line
        for segment in self.segments().iter().take(number).rev() {
            begin -= segment.length;
            add(begin, segment);
        }
        let width = half + half;
        if width > T::zero() {
            Smoothed {
                curvature: curvature / width,
                turn: turn / width,
            }
        } else {
            Smoothed {
                curvature: T::zero(),
                turn: T::zero(),
            }
        }
    }
}

/// A smoothed path at one place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Smoothed<T> {
    /// Mean curvature, 1/m.
    pub curvature: T,
    /// Mean heading less the path's own, rad.
    pub turn: T,
}

/// Progress along a path.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress<T> {
    /// The segment being followed, counted from zero.
    pub segment: usize,
    /// Distance along it, m.
    pub along: T,
    /// The path's end lies behind.
    pub finished: bool,
}

impl<T: Scalar> Progress<T> {
    /// At the beginning of a path.
    #[must_use]
    pub fn start() -> Self {
        Self {
            segment: 0,
            along: T::zero(),
            finished: false,
        }
    }

    /// Moves on to where the point `north`, `east` (m) is and says where that
    /// is.
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
        // loop-bound: 1 the vehicle's path is one line
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
