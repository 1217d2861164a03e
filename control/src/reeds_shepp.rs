//! Shortest paths of a car that also drives backwards and turns no tighter than
//! a given radius (J. A. Reeds and L. A. Shepp, Pacific Journal of Mathematics
//! 145, 1990).
//!
//! The curvature of such a path jumps, so a steering of limited rate cannot
//! follow it without a stop at each joint. It is a lower bound for every
//! manoeuvre: [`crate::turn`] plans those that can be followed.
//!
//! A call tries 64 words and takes some ten thousand operations.

use crate::dubins::{self, DubinsError, Pose, Turn, advance};
use crate::scalar::{Scalar, wrap_angle};

/// Pieces of a path with their lengths in metres; a negative length is driven
/// backwards. A steering to the right in reverse is still [`Turn::Right`].
pub type Pieces<T> = [(Turn, T); 5];

/// A shortest path of up to five pieces.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ReedsSheppPath<T> {
    /// The pieces in driving order; any may have zero length.
    pub pieces: Pieces<T>,
    /// Radius of the arcs, m.
    pub radius: T,
}

impl<T: Scalar> ReedsSheppPath<T> {
    /// Length of the whole path, m.
    #[must_use]
    pub fn length(&self) -> T {
        length(&self.pieces)
    }

    /// Pose of the vehicle at the end of the path if it starts at `start`.
    #[must_use]
    pub fn end(&self, start: Pose<T>) -> Pose<T> {
        reached(start, &self.pieces, self.radius)
    }

    /// How often the vehicle changes its direction.
    #[must_use]
    pub fn reversals(&self) -> usize {
        let driven = |(_, length): &&(Turn, T)| *length != T::zero();
        let mut backwards = None;
        let mut count = 0;
        for (_, length) in self.pieces.iter().filter(driven) {
            let now = *length < T::zero();
            count += usize::from(backwards.is_some_and(|before| before != now));
            backwards = Some(now);
        }
        count
    }
}

fn length<T: Scalar>(pieces: &Pieces<T>) -> T {
    pieces
        .iter()
        .fold(T::zero(), |sum, (_, length)| sum + length.abs())
}

fn reached<T: Scalar>(start: Pose<T>, pieces: &Pieces<T>, radius: T) -> Pose<T> {
    pieces.iter().fold(start, |pose, &(turn, length)| {
        advance(pose, T::lit(f64::from(turn.sign())) / radius, length)
    })
}

/// The shortest path from `start` to `end`, forwards or backwards, with turns of at
/// least `radius` metres. It ends within 1e-7 radii and radians of the end, and in
/// single precision within 2e-3.
///
/// # Errors
/// [`DubinsError`] if the radius is not positive or a pose is not usable.
pub fn shortest<T: Scalar>(
    start: Pose<T>,
    end: Pose<T>,
    radius: T,
) -> Result<ReedsSheppPath<T>, DubinsError> {
    // The path without reverse always exists. It also judges the arguments.
    let forward = dubins::shortest(start, end, radius)?;
    let [first, second, third] = forward.pieces;
    let none = (Turn::Straight, T::zero());
    let mut best = [first, second, third, none, none];
    let (sine, cosine) = start.heading.sine_cosine();
    let north = (end.north - start.north) / radius;
    let east = (end.east - start.east) / radius;
    let goal = Goal {
        x: cosine * north + sine * east,
        y: cosine * east - sine * north,
        phi: wrap_angle(end.heading - start.heading),
    };
    let close = T::default_epsilon().root() * T::lit(4.0);
    // loop-bound: 8
    for symmetry in 0..8_u8 {
        let symmetry = Symmetry {
            reverse: symmetry & 1 != 0,
            mirror: symmetry & 2 != 0,
            backwards: symmetry & 4 != 0,
        };
        let seen = symmetry.goal(goal);
        // loop-bound: 8
        for word in words() {
            let Some(pieces) = word(&seen) else {
                continue;
            };
            let pieces = symmetry
                .pieces(pieces)
                .map(|(turn, length)| (turn, length * radius));
            if !(length(&pieces) < length(&best)) {
                continue;
            }
            let at = reached(start, &pieces, radius);
            let off = |distance: T| distance.abs() <= close * radius;
            if off(at.north - end.north)
                && off(at.east - end.east)
                && wrap_angle(at.heading - end.heading).abs() <= close
            {
                best = pieces;
            }
        }
    }
    Ok(ReedsSheppPath {
        pieces: best,
        radius,
    })
}

/// The end as seen from the start: ahead and to the right in radii, and its heading.
#[derive(Clone, Copy, Debug)]
struct Goal<T> {
    x: T,
    y: T,
    phi: T,
}

/// What turns one path into another of the same length.
#[derive(Clone, Copy, Debug)]
struct Symmetry {
    /// The other direction of driving on every piece.
    reverse: bool,
    /// Left for right.
    mirror: bool,
    /// The pieces in the opposite order.
    backwards: bool,
}

impl Symmetry {
    /// The end for which a word gives the path to `goal`.
    fn goal<T: Scalar>(self, goal: Goal<T>) -> Goal<T> {
        let Goal {
            mut x,
            mut y,
            mut phi,
        } = goal;
        if self.backwards {
            let (sine, cosine) = phi.sine_cosine();
            (x, y) = (x * cosine + y * sine, x * sine - y * cosine);
        }
        if self.reverse {
            (x, phi) = (-x, -phi);
        }
        if self.mirror {
            (y, phi) = (-y, -phi);
        }
        Goal { x, y, phi }
    }

    fn pieces<T: Scalar>(self, word: [Piece<T>; 5]) -> Pieces<T> {
        let mut pieces = word.map(|Piece { kind, length }| {
            let turn = match (kind, self.mirror) {
                (Kind::Straight, _) => Turn::Straight,
                (Kind::Same, false) | (Kind::Other, true) => Turn::Right,
                (Kind::Same, true) | (Kind::Other, false) => Turn::Left,
            };
            (turn, if self.reverse { -length } else { length })
        });
        if self.backwards {
            pieces.reverse();
        }
        pieces
    }
}

/// An arc to the side of the first one or to the other, or a straight piece.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Same,
    Other,
    Straight,
}

#[derive(Clone, Copy, Debug)]
struct Piece<T> {
    kind: Kind,
    length: T,
}

/// Gives the path of one word to a goal, if there is one. Lengths are in radii.
type Word<T> = fn(&Goal<T>) -> Option<[Piece<T>; 5]>;

/// The words that are not images of each other.
fn words<T: Scalar>() -> [Word<T>; 8] {
    [
        csc_same,
        csc_other,
        ccc,
        cccc_one_cusp,
        cccc_two_cusps,
        ccsc_same,
        ccsc_other,
        ccscc,
    ]
}

/// Collects up to five pieces (kind, length, direction), if each is driven in its
/// direction: 1 for forward, -1 for reverse, 0 where both are allowed.
fn word<T: Scalar>(pieces: &[(Kind, T, i8)]) -> Option<[Piece<T>; 5]> {
    let rounding = T::default_epsilon() * T::lit(32.0);
    let mut found = [Piece {
        kind: Kind::Straight,
        length: T::zero(),
    }; 5];
    for (slot, &(kind, length, sign)) in found.iter_mut().zip(pieces) {
        let forward = length * T::lit(f64::from(sign));
        if !(forward >= -rounding) {
            return None;
        }
        let length = if length.abs() <= rounding {
            T::zero()
        } else {
            length
        };
        *slot = Piece { kind, length };
    }
    Some(found)
}

/// Vector from the first turning circle's centre to that of the last one, if both are on
/// the same side.
fn same_side<T: Scalar>(goal: &Goal<T>) -> (T, T) {
    let (sine, cosine) = goal.phi.sine_cosine();
    (goal.x - sine, goal.y - T::one() + cosine)
}

/// The same if the last turn is to the other side.
fn other_side<T: Scalar>(goal: &Goal<T>) -> (T, T) {
    let (sine, cosine) = goal.phi.sine_cosine();
    (goal.x + sine, goal.y - T::one() - cosine)
}

/// Length and direction of a vector.
fn polar<T: Scalar>((x, y): (T, T)) -> (T, T) {
    ((x * x + y * y).root(), y.angle_of(x))
}

// The solutions are those of the article. In the names of the words + is forward and - is
// reverse, and R is the side of the first arc.

/// R+ S+ R+ (8.1).
fn csc_same<T: Scalar>(goal: &Goal<T>) -> Option<[Piece<T>; 5]> {
    let (u, t) = polar(same_side(goal));
    let v = wrap_angle(goal.phi - t);
    word(&[
        (Kind::Same, t, 1),
        (Kind::Straight, u, 1),
        (Kind::Same, v, 1),
    ])
}

/// R+ S+ L+ (8.2).
fn csc_other<T: Scalar>(goal: &Goal<T>) -> Option<[Piece<T>; 5]> {
    let (apart, direction) = polar(other_side(goal));
    let two = T::lit(2.0);
    let square = (apart - two) * (apart + two);
    if !(square >= T::zero()) {
        return None;
    }
    let u = square.root();
    let t = wrap_angle(direction + two.angle_of(u));
    let v = wrap_angle(t - goal.phi);
    word(&[
        (Kind::Same, t, 1),
        (Kind::Straight, u, 1),
        (Kind::Other, v, 1),
    ])
}

/// R+ L- R+ and R+ L- R- (8.3, 8.4).
fn ccc<T: Scalar>(goal: &Goal<T>) -> Option<[Piece<T>; 5]> {
    let (apart, direction) = polar(same_side(goal));
    if !(apart <= T::lit(4.0)) {
        return None;
    }
    let u = T::lit(2.0) * (apart * T::lit(0.25)).arccosine() - T::pi();
    let t = wrap_angle(direction + u * T::lit(0.5) + T::pi());
    let v = wrap_angle(goal.phi - t + u);
    word(&[(Kind::Same, t, 1), (Kind::Other, u, -1), (Kind::Same, v, 0)])
}

/// First and last arc of a word of four arcs whose middle ones turn by `u` and `v`.
fn outer_arcs<T: Scalar>(goal: &Goal<T>, u: T, v: T) -> (T, T) {
    let (x, y) = other_side(goal);
    let delta = wrap_angle(u - v);
    let (sine_u, cosine_u) = u.sine_cosine();
    let (sine_delta, cosine_delta) = delta.sine_cosine();
    let a = sine_u - sine_delta;
    let b = cosine_u - cosine_delta - T::one();
    let direction = (y * a - x * b).angle_of(x * a + y * b);
    let (_, cosine_v) = v.sine_cosine();
    let side = T::lit(2.0) * (cosine_delta - cosine_v - cosine_u) + T::lit(3.0);
    let first = if side < T::zero() {
        wrap_angle(direction + T::pi())
    } else {
        direction
    };
    (first, wrap_angle(first - u + v - goal.phi))
}

/// R+ L+ R- L- with equal middle arcs (8.7).
fn cccc_one_cusp<T: Scalar>(goal: &Goal<T>) -> Option<[Piece<T>; 5]> {
    let (apart, _) = polar(other_side(goal));
    let cosine = (T::lit(2.0) + apart) * T::lit(0.25);
    if !(cosine <= T::one()) {
        return None;
    }
    let u = cosine.arccosine();
    let (t, v) = outer_arcs(goal, u, -u);
    word(&[
        (Kind::Same, t, 1),
        (Kind::Other, u, 1),
        (Kind::Same, -u, -1),
        (Kind::Other, v, -1),
    ])
}

/// R+ L- R- L+ with equal middle arcs (8.8).
fn cccc_two_cusps<T: Scalar>(goal: &Goal<T>) -> Option<[Piece<T>; 5]> {
    let (apart, _) = polar(other_side(goal));
    let cosine = (T::lit(20.0) - apart * apart) * T::lit(1.0 / 16.0);
    if !(cosine >= T::zero() && cosine <= T::one()) {
        return None;
    }
    let u = -cosine.arccosine();
    let (t, v) = outer_arcs(goal, u, u);
    word(&[
        (Kind::Same, t, 1),
        (Kind::Other, u, -1),
        (Kind::Same, u, -1),
        (Kind::Other, v, 1),
    ])
}

/// R+ L- S- R- (8.9), the quarter circle before the straight piece.
fn ccsc_same<T: Scalar>(goal: &Goal<T>) -> Option<[Piece<T>; 5]> {
    let (apart, direction) = polar(same_side(goal));
    let two = T::lit(2.0);
    if !(apart >= two) {
        return None;
    }
    let way = ((apart - two) * (apart + two)).root();
    let t = wrap_angle(direction + way.angle_of(-two));
    let v = wrap_angle(goal.phi - T::frac_pi_2() - t);
    word(&[
        (Kind::Same, t, 1),
        (Kind::Other, -T::frac_pi_2(), -1),
        (Kind::Straight, two - way, -1),
        (Kind::Same, v, -1),
    ])
}

/// R+ L- S- L- (8.10).
fn ccsc_other<T: Scalar>(goal: &Goal<T>) -> Option<[Piece<T>; 5]> {
    let (x, y) = other_side(goal);
    let (apart, t) = polar((-y, x));
    let u = T::lit(2.0) - apart;
    let v = wrap_angle(t + T::frac_pi_2() - goal.phi);
    word(&[
        (Kind::Same, t, 1),
        (Kind::Other, -T::frac_pi_2(), -1),
        (Kind::Straight, u, -1),
        (Kind::Other, v, -1),
    ])
}

/// R+ L- S- R- L+ with two quarter circles (8.11).
fn ccscc<T: Scalar>(goal: &Goal<T>) -> Option<[Piece<T>; 5]> {
    let (x, y) = other_side(goal);
    let (apart, _) = polar((x, y));
    let two = T::lit(2.0);
    if !(apart >= two) {
        return None;
    }
    let u = T::lit(4.0) - ((apart - two) * (apart + two)).root();
    let rest = T::lit(4.0) - u;
    let t = (rest * x - two * y).angle_of(-two * x - rest * y);
    let v = wrap_angle(t - goal.phi);
    word(&[
        (Kind::Same, t, 1),
        (Kind::Other, -T::frac_pi_2(), -1),
        (Kind::Straight, u, -1),
        (Kind::Same, -T::frac_pi_2(), -1),
        (Kind::Other, v, 1),
    ])
}
