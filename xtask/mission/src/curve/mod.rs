//! Drivable curves through points.
//!
//! [`fit`] lays a spline of clothoids through points: curvature changes linearly along each piece and has no jumps, so a
//! steering of limited rate can follow exactly. Not every point is a knot of the spline: it takes as few as keep all points
//! within the tolerance, which leaves tens of pieces of hundreds of points. Where there is no such spline, arcs in
//! pairs take its place; their curvature jumps ([`Continuity::Heading`]).
//!
//! A spline goes through its points, and so it follows their noise. [`Resampling`] makes points of steady curvature from noisy ones
//! first; then the tolerance is that to these points.

mod biarc;
mod hermite;
mod joint;
mod segment;
mod smooth;
mod spline;

use std::fmt;

use crate::place::Local;
use crate::plan::{Leg, Plan, Shape};
use crate::polygon::distance_to_piece;

pub(crate) use hermite::wrapped;
pub(crate) use joint::straight_points;
pub use segment::{Pose, Segment};
use spline::{End, Ends};

/// How a curve is fitted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Largest distance of a point from the curve, m.
    pub tolerance: f64,
    /// True if the curvature is zero at the beginning, as a turn before it needs. Otherwise the first piece is an arc. A closed curve
    /// has no beginning.
    pub straight_begin: bool,
    /// The same at the end.
    pub straight_end: bool,
    /// Takes noise out of the points before.
    pub resampling: Option<Resampling>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            tolerance: 0.02,
            straight_begin: false,
            straight_end: false,
            resampling: None,
        }
    }
}

/// How noisy points are made even.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Resampling {
    /// Distance between the new points, m.
    pub spacing: f64,
    /// Standard deviation of the noise of a point in each direction, m.
    pub noise: f64,
}

/// How the pieces of a curve meet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Continuity {
    /// In place, heading and curvature.
    Curvature,
    /// In place and heading; the curvature jumps.
    Heading,
}

/// The largest curvature of a curve.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tightest {
    /// Curvature, 1/m, positive to the right.
    pub curvature: f64,
    /// How far along the curve, m.
    pub along: f64,
    /// Where.
    pub place: Local,
}

/// A drivable curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Chain {
    /// Its pieces in driving order.
    pub segments: Vec<Segment>,
    /// How they meet.
    pub continuity: Continuity,
    /// Largest distance of a point from the curve, m: within the tolerance. With resampling, of the new points.
    pub deviation: f64,
    /// Largest distance of one of the given points from the curve, m. Without resampling it is the deviation.
    pub moved: f64,
    /// Largest distance of the curve from the straight lines between the points, m.
    pub bulge: f64,
    /// The largest curvature.
    pub tightest: Tightest,
    /// The largest change of curvature in size, 1/m2.
    pub sharpness: f64,
}

impl Chain {
    /// Length, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.segments.iter().map(|segment| segment.length).sum()
    }

    /// Poses along it, each at most `step` metres (0.1 mm or more) from the next one, with both ends.
    #[must_use]
    pub fn poses(&self, step: f64) -> Vec<Pose> {
        let mut poses = Vec::new();
        for segment in &self.segments {
            let count = (segment.length / step.max(1e-4)).ceil().max(1.0);
            let shares = (0..count as usize).map(|index| index as f64 / count);
            poses.extend(shares.map(|share| segment.at(share * segment.length)));
        }
        poses.extend(self.segments.last().map(Segment::end));
        poses
    }

    fn of(segments: Vec<Segment>, continuity: Continuity) -> Self {
        let mut tightest = Tightest::default();
        let mut along = 0.0;
        for segment in &segments {
            let (curvature, at) = segment.tightest();
            if curvature.abs() > tightest.curvature.abs() {
                tightest = Tightest {
                    curvature,
                    along: along + at,
                    place: segment.at(at).place,
                };
            }
            along += segment.length;
        }
        let sharpness = segments.iter().map(|segment| segment.sharpness.abs());
        Self {
            sharpness: sharpness.fold(0.0, f64::max),
            segments,
            continuity,
            deviation: 0.0,
            moved: 0.0,
            bulge: 0.0,
            tightest,
        }
    }
}

/// Why points have no curve. Displays as one sentence.
#[derive(Clone, Debug, PartialEq)]
pub enum CurveError {
    /// Fewer than two points.
    Few,
    /// A coordinate or an option is no finite number, or an option is not positive.
    Number,
    /// Resampling would make more than [`MOST_SAMPLES`] points.
    Many {
        /// Length along the points, m.
        length: f64,
    },
    /// A point is the one before again.
    Repeated {
        /// The point, counted from zero.
        point: usize,
    },
    /// The points double back.
    Reversal {
        /// The point at which they do, counted from zero.
        point: usize,
        /// Where it is.
        place: Local,
    },
}

impl fmt::Display for CurveError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Few => f.write_str("a curve has two points or more"),
            Self::Number => {
                f.write_str("a coordinate, a tolerance or a spacing is no number above zero")
            }
            Self::Many { length } => write!(
                f,
                "the curve is {length:.0} m long; resampled, a curve has up to {MOST_SAMPLES} points"
            ),
            Self::Repeated { point } => {
                write!(f, "point {}: it is the point before again", point + 1)
            }
            Self::Reversal { point, place } => write!(
                f,
                "point {}: the curve doubles back there ({place}); split it in two legs, or resample it if its points are noisy",
                point + 1
            ),
        }
    }
}

impl std::error::Error for CurveError {}

/// Most points of a resampled curve.
pub const MOST_SAMPLES: usize = 100_000;

/// Points of steady curvature in place of noisy ones.
///
/// # Errors
/// [`CurveError`] if a number is not usable, or there would be too many points.
pub fn resample(points: &[Local], resampling: &Resampling) -> Result<Vec<Local>, CurveError> {
    let options = Options {
        resampling: Some(*resampling),
        ..Options::default()
    };
    check(points, &options)?;
    let even = smooth::resampled(points, resampling.spacing, resampling.noise);
    Ok(even)
}

/// A kink at which points double back, rad.
const REVERSAL: f64 = 150.0 * std::f64::consts::PI / 180.0;
/// Points nearer than this are the same, m.
const SAME: f64 = 1e-6;

/// A drivable curve through points, within the tolerance of the options. If the last point is the first one, the curve is
/// closed, and goes on there without a jump.
///
/// # Errors
/// [`CurveError`] if the points repeat or double back.
pub fn fit(points: &[Local], options: &Options) -> Result<Chain, CurveError> {
    check(points, options)?;
    let resampled = options
        .resampling
        .map(|resampling| smooth::resampled(points, resampling.spacing, resampling.noise));
    let targets = resampled.as_deref().unwrap_or(points);
    turns(targets)?;
    let last = targets.len() - 1;
    let closed = last >= 3 && targets[0].distance(targets[last]) < SAME;
    let (pieces, continuity) = spline_near(targets, options.tolerance, ends(options, closed), &[]);
    let segments = pieces.into_iter().map(|(_, segment)| segment).collect();
    let mut chain = Chain::of(segments, continuity);
    measure(&mut chain, targets);
    chain.moved = match &resampled {
        None => chain.deviation,
        Some(_) => points
            .iter()
            .map(|point| distance(&chain, *point))
            .fold(0.0, f64::max),
    };
    Ok(chain)
}

/// The drivable curve of a leg by itself: the line, or a curve that [`fit`] finds.
///
/// # Errors
/// As [`fit`].
pub fn leg(leg: &Leg, options: &Options) -> Result<Chain, CurveError> {
    match &leg.shape {
        Shape::Curve { points } => fit(points, options),
        Shape::Line { from, to } => {
            check(&[*from, *to], options)?;
            let line = Segment {
                start: Pose {
                    place: *from,
                    heading: from.bearing(*to),
                },
                length: from.distance(*to),
                ..Segment::default()
            };
            Ok(Chain::of(vec![line], Continuity::Curvature))
        }
    }
}

/// The drivable curves of all legs. Where a leg is reached or left by a turn, its curvature is zero there. Legs that continue each other
/// are fitted together, so that heading and curvature have no jump between them either; lines among them are then straight to
/// the tolerance. Lines that continue each other without a kink stay lines. Where the direction of travel changes, legs meet in a
/// place only.
///
/// # Errors
/// The first leg that has none, counted from zero, and why.
pub fn legs(plan: &Plan, options: &Options) -> Result<Vec<Chain>, (usize, CurveError)> {
    joint::legs(plan, options)
}

/// How a curve begins and ends.
fn ends(options: &Options, closed: bool) -> Ends {
    let end = |straight| if straight { End::Straight } else { End::Arc };
    match closed {
        true => Ends::Closed,
        false => Ends::Open(end(options.straight_begin), end(options.straight_end)),
    }
}

fn check(points: &[Local], options: &Options) -> Result<(), CurveError> {
    if points.len() < 2 {
        return Err(CurveError::Few);
    }
    let positive = |value: f64| value.is_finite() && value > 0.0;
    let sound = points
        .iter()
        .all(|point| point.north.is_finite() && point.east.is_finite())
        && positive(options.tolerance)
        && options.resampling.is_none_or(|resampling| {
            positive(resampling.spacing) && resampling.noise.is_finite() && resampling.noise >= 0.0
        });
    if !sound {
        return Err(CurveError::Number);
    }
    let length = points
        .windows(2)
        .map(|pair| pair[0].distance(pair[1]))
        .sum::<f64>();
    if let Some(resampling) = options.resampling
        && length / resampling.spacing > MOST_SAMPLES as f64
    {
        return Err(CurveError::Many { length });
    }
    match points
        .windows(2)
        .position(|pair| pair[0].distance(pair[1]) < SAME)
    {
        Some(point) => Err(CurveError::Repeated { point: point + 1 }),
        None => Ok(()),
    }
}

/// Angle between the lines before and behind the middle one of three points, rad.
fn kink(three: &[Local]) -> f64 {
    let (one, other) = (three[0].bearing(three[1]), three[1].bearing(three[2]));
    hermite::wrapped(other - one)
}

fn turns(points: &[Local]) -> Result<(), CurveError> {
    match points
        .windows(3)
        .position(|three| kink(three).abs() > REVERSAL)
    {
        Some(before) => Err(CurveError::Reversal {
            point: before + 1,
            place: points[before + 1],
        }),
        None => Ok(()),
    }
}

/// Pieces, each with the number of the point at which its part of the curve begins.
type Pieces = Vec<(usize, Segment)>;

/// The spline with as few knots as the tolerance needs, or pairs of arcs. The points of `joints` are knots in any case.
fn spline_near(
    points: &[Local],
    tolerance: f64,
    ends: Ends,
    joints: &[usize],
) -> (Pieces, Continuity) {
    let closed = ends == Ends::Closed;
    let mut knots = first_knots(points, closed);
    knots.extend(joints);
    loop {
        knots.sort_unstable();
        knots.dedup();
        let places: Vec<Local> = knots.iter().map(|knot| points[*knot]).collect();
        let mut more = Vec::new();
        match spline::through(&places, ends) {
            Some(segments) => {
                for (segment, pair) in segments.iter().zip(knots.windows(2)) {
                    let between = pair[0] + 1..pair[1];
                    let far = between.map(|index| (index, distance_to(segment, points[index])));
                    let worst = far.max_by(|one, other| one.1.total_cmp(&other.1));
                    let worst = worst.filter(|(_, far)| *far > tolerance);
                    more.extend(worst.map(|(index, _)| index));
                }
                if more.is_empty() {
                    let pieces = knots.iter().copied().zip(segments).collect();
                    return (pieces, Continuity::Curvature);
                }
            }
            None if knots.len() == points.len() => {
                return (arcs(points, closed), Continuity::Heading);
            }
            None => {
                let wide = knots.windows(2).filter(|pair| pair[1] - pair[0] > 1);
                more.extend(wide.map(|pair| usize::midpoint(pair[0], pair[1])));
            }
        }
        knots.extend(more);
    }
}

/// The ends, and a knot for each sixth of a turn.
fn first_knots(points: &[Local], closed: bool) -> Vec<usize> {
    let last = points.len() - 1;
    let mut knots = vec![0];
    let mut turned = 0.0;
    for (before, three) in points.windows(3).enumerate() {
        turned += kink(three).abs();
        if turned > std::f64::consts::FRAC_PI_3 {
            knots.push(before + 1);
            turned = 0.0;
        }
    }
    knots.push(last);
    if closed && knots.len() < 4 {
        knots = vec![0, last / 3, 2 * last / 3, last];
    }
    knots
}

/// Pairs of arcs through all points.
fn arcs(points: &[Local], closed: bool) -> Pieces {
    let directions = spline::directions(points, closed);
    let pairs = points.windows(2).zip(directions.windows(2)).enumerate();
    let arcs = pairs.flat_map(|(index, (places, directions))| {
        let from = Pose {
            place: places[0],
            heading: directions[0],
        };
        let arcs = biarc::between(from, places[1], directions[1]);
        arcs.into_iter().map(move |arc| (index, arc))
    });
    // An arc of no length is the joint of two that are one.
    arcs.filter(|(_, arc)| arc.length > 1e-9).collect()
}

/// Distance of a point from a piece, m.
fn distance_to(segment: &Segment, point: Local) -> f64 {
    // From the best of some places, Newton's method finds where the piece passes the point.
    let samples = (0..=4).map(|index| f64::from(index) / 4.0 * segment.length);
    let from = |along: f64| segment.at(along).place.distance(point);
    let best = samples.map(|along| (along, from(along)));
    let Some((mut along, mut best)) = best.min_by(|one, other| one.1.total_cmp(&other.1)) else {
        return f64::INFINITY;
    };
    for _ in 0..6 {
        let pose = segment.at(along);
        let (sine, cosine) = pose.heading.sin_cos();
        let (north, east) = (point.north - pose.place.north, point.east - pose.place.east);
        let ahead = north * cosine + east * sine;
        let right = east * cosine - north * sine;
        let slope = (1.0 - segment.curvature_at(along) * right).max(0.2);
        let next = (along + ahead / slope).clamp(0.0, segment.length);
        let step = (next - along).abs();
        along = next;
        best = best.min(from(along));
        if step < 1e-9 {
            break;
        }
    }
    best
}

/// Distance of a point from the nearest piece, m.
fn distance(chain: &Chain, point: Local) -> f64 {
    let from = |segment: &Segment| segment.start.place.distance(point);
    // Most pieces are farther away than the one that begins nearest: they are not looked at closely.
    let nearest = chain
        .segments
        .iter()
        .min_by(|one, other| from(one).total_cmp(&from(other)));
    let mut best = nearest.map_or(f64::INFINITY, |segment| distance_to(segment, point));
    for segment in &chain.segments {
        if from(segment) - segment.length < best {
            best = best.min(distance_to(segment, point));
        }
    }
    best
}

/// Fills in deviation and bulge.
fn measure(chain: &mut Chain, points: &[Local]) {
    let far = points.iter().map(|point| distance(chain, *point));
    chain.deviation = far.fold(0.0, f64::max);
    let length = chain.length();
    // Eight places for each point.
    let step = (length / (8 * points.len()) as f64).max(1e-3);
    let mut near = 0;
    for pose in chain.poses(step) {
        let away = |index: usize| distance_to_piece(pose.place, points[index], points[index + 1]);
        // The curve comes by the lines in their order: from the last nearest one on, some are looked at.
        let window = near..(near + 12).min(points.len() - 1);
        let nearest = window.map(|index| (index, away(index)));
        let nearest = nearest.min_by(|one, other| one.1.total_cmp(&other.1));
        if let Some((index, far)) = nearest {
            near = index;
            chain.bulge = chain.bulge.max(far);
        }
    }
}
