//! Headland turns that a steering of limited angle and rate can follow exactly.
//!
//! A turn leads from the end of one pass to the beginning of the next, straight at both.
//! It consists of lines, arcs and clothoids, so that its curvature and the change of the
//! curvature are bounded (Th. Fraichard and A. Scheuer, "From Reeds and Shepp's to
//! continuous-curvature paths", IEEE Transactions on Robotics 20(6), 2004). There are three
//! kinds:
//!
//! * wide: two turns to one side or to both, joined by a straight piece;
//! * omega: three turns forward, for passes that are closer than two radii;
//! * three-point: the piece in the middle is driven backwards.
//!
//! A turn from straight to straight is a clothoid, an arc and a clothoid. All that begin at
//! one pose end on a circle about the same centre, and cut it at the same angle. So the
//! shortest paths of Dubins and of Reeds and Shepp carry over to such turns: each word below
//! is a condition on the distance of two such circles. Wheels are straight where the
//! direction of driving changes.
//!
//! [`TurnPlan`] tries 16 words in short steps, so that it can run in a task of low priority.

use crate::clothoid::travel;
use crate::dubins::{Pose, turn_forward};
use crate::fence::Room;
use crate::path::Segment;
use crate::scalar::{Scalar, wrap_angle};

/// Largest number of parts of a turn: three turns of three parts each, and a straight piece at
/// either end.
pub const PARTS: usize = 11;

/// Smallest distance of the poses that are compared with the room, m.
pub const FINEST: f64 = 0.01;

/// Longest turn, m. With [`FINEST`] it bounds the number of steps of a plan. A mission spans 8 km in north and east.
pub const LONGEST: f64 = 50_000.0;

/// Poses that a step compares with the room.
const POSES: usize = 8;

/// A part of a turn as the vehicle drives it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Part<T> {
    /// Curvature at its beginning, 1/m: the tangent of the steering angle over the wheelbase,
    /// positive with the wheels to the right, in reverse too.
    pub curvature: T,
    /// Change of this curvature with each metre driven, 1/m^2.
    pub sharpness: T,
    /// Length, m, positive.
    pub length: T,
    /// True if the vehicle drives backwards.
    pub reverse: bool,
}

impl<T: Scalar> Part<T> {
    /// The part as a segment of a path, if the vehicle begins it at `start`. The heading of a
    /// segment is the direction of travel, and its right is that of the travel.
    #[must_use]
    pub fn segment(&self, start: Pose<T>) -> Segment<T> {
        if self.reverse {
            Segment {
                start: turned_round(start),
                curvature: -self.curvature,
                sharpness: -self.sharpness,
                length: self.length,
            }
        } else {
            Segment {
                start,
                curvature: self.curvature,
                sharpness: self.sharpness,
                length: self.length,
            }
        }
    }

    /// The vehicle's pose `along` metres after `start`.
    #[must_use]
    pub fn pose(&self, start: Pose<T>, along: T) -> Pose<T> {
        let on = self.segment(start).pose(along);
        if self.reverse { turned_round(on) } else { on }
    }

    /// The vehicle's pose at the end.
    #[must_use]
    pub fn end(&self, start: Pose<T>) -> Pose<T> {
        self.pose(start, self.length)
    }

    /// The curvature at the end, 1/m.
    #[must_use]
    pub fn last_curvature(&self) -> T {
        self.curvature + self.sharpness * self.length
    }
}

fn turned_round<T: Scalar>(pose: Pose<T>) -> Pose<T> {
    Pose {
        heading: wrap_angle(pose.heading + T::pi()),
        ..pose
    }
}

/// The kind of a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Two turns joined by a straight piece.
    Wide,
    /// Three turns forward.
    Omega,
    /// With a piece driven backwards in the middle.
    ThreePoint,
}

/// A turn: parts in driving order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turn<T> {
    parts: [Part<T>; PARTS],
    count: usize,
    kind: Kind,
}

impl<T: Scalar> Turn<T> {
    fn empty(kind: Kind) -> Self {
        Self {
            parts: [Part {
                curvature: T::zero(),
                sharpness: T::zero(),
                length: T::zero(),
                reverse: false,
            }; PARTS],
            count: 0,
            kind,
        }
    }

    /// Adds a part unless it is shorter than a tenth of a millimetre.
    fn push(&mut self, part: Part<T>) {
        if part.length > T::lit(1e-4)
            && let Some(slot) = self.parts.get_mut(self.count)
        {
            *slot = part;
            self.count += 1;
        }
    }

    /// The parts in driving order.
    #[must_use]
    pub fn parts(&self) -> &[Part<T>] {
        self.parts.get(..self.count).unwrap_or(&self.parts)
    }

    /// The kind.
    #[must_use]
    pub fn kind(&self) -> Kind {
        self.kind
    }

    /// Distance driven, m.
    #[must_use]
    pub fn length(&self) -> T {
        let mut sum = T::zero();
        // loop-bound: 11. PARTS.
        for part in self.parts() {
            sum += part.length;
        }
        sum
    }

    /// How often the direction of driving changes.
    #[must_use]
    pub fn reversals(&self) -> usize {
        let mut reversals = 0;
        let mut before = self.parts().first().is_some_and(|part| part.reverse);
        // loop-bound: 11. PARTS.
        for part in self.parts() {
            reversals += usize::from(part.reverse != before);
            before = part.reverse;
        }
        reversals
    }

    /// The vehicle's pose at the end, if it begins at `start`.
    #[must_use]
    pub fn end(&self, start: Pose<T>) -> Pose<T> {
        let mut pose = start;
        // loop-bound: 11. PARTS.
        for part in self.parts() {
            pose = part.end(pose);
        }
        pose
    }
}

/// What a turn may ask of the vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TurnSettings<T> {
    /// Largest curvature, 1/m, positive.
    pub curvature: T,
    /// Largest change of curvature with each metre, 1/m^2, positive.
    pub sharpness: T,
    /// Straight piece before the turn, m, not negative: an implement is lifted there.
    pub lead_in: T,
    /// Straight piece behind the turn, m, not negative: the vehicle settles on it.
    pub lead_out: T,
    /// Whether the vehicle may drive backwards.
    pub reverse: bool,
    /// Way that a change of direction counts as, m, not negative. The shortest turn is chosen by
    /// its length and this.
    pub stop_cost: T,
    /// Distance of the poses that are compared with the room that there is, m, [`FINEST`] or more.
    pub spacing: T,
}

impl<T: Scalar> TurnSettings<T> {
    /// Limits of a vehicle with this `wheelbase` (m), largest steering angle (rad) and
    /// steering rate (rad/s) that turns at `speed` (m/s). The `reserve` in (0, 1) is the share
    /// of angle and rate that is left for corrections.
    ///
    /// The steering rate on a clothoid is sharpness times speed times wheelbase, times the
    /// squared cosine of the steering angle. It is largest with straight wheels.
    #[must_use]
    pub fn for_steering(wheelbase: T, angle: T, rate: T, speed: T, reserve: T) -> Self {
        let share = T::one() - reserve;
        Self {
            curvature: (angle * share).tangent() / wheelbase,
            sharpness: rate * share / (speed * wheelbase),
            lead_in: T::zero(),
            lead_out: T::zero(),
            reverse: true,
            stop_cost: T::zero(),
            spacing: T::lit(0.25),
        }
    }

    pub(crate) fn is_usable(&self) -> bool {
        let positive = |value: T| value.is_finite() && value > T::zero();
        let way = |value: T| value.is_finite() && value >= T::zero();
        positive(self.curvature)
            && positive(self.sharpness)
            && positive(self.spacing)
            && self.spacing >= T::lit(FINEST)
            && way(self.lead_in)
            && way(self.lead_out)
            && way(self.stop_cost)
    }
}

/// Why there is no turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TurnError {
    /// A setting is not finite, or negative, or zero or too small where it must not be.
    Settings,
    /// A coordinate of a pose is not a finite number, or the heading is beyond
    /// [`LARGEST_HEADING`](crate::dubins::LARGEST_HEADING).
    Pose,
    /// There is no room for a turn, or none of up to [`LONGEST`] metres.
    NoRoom,
}

impl core::fmt::Display for TurnError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Settings => "a setting of the turn is out of range",
            Self::Pose => {
                "a coordinate of a pose is not a finite number, or its heading is beyond 1000 rad"
            }
            Self::NoRoom => "there is no room for a turn",
        })
    }
}

impl core::error::Error for TurnError {}

/// The circle on which the turns from one pose end.
#[derive(Clone, Copy, Debug)]
struct Circle<T> {
    curvature: T,
    sharpness: T,
    /// Length of a clothoid from straight to the largest curvature, m.
    ramp: T,
    /// Its centre lies so far ahead of the pose, m,
    ahead: T,
    /// and so far to the side of the turn, m.
    aside: T,
    /// Smallest deflection of a turn with both clothoids whole, rad.
    least: T,
}

impl<T: Scalar> Circle<T> {
    fn of(settings: &TurnSettings<T>) -> Self {
        let &TurnSettings {
            curvature,
            sharpness,
            ..
        } = settings;
        let ramp = curvature / sharpness;
        let origin = Pose {
            north: T::zero(),
            east: T::zero(),
            heading: T::zero(),
        };
        let on = travel(origin, T::zero(), sharpness, ramp);
        let (sine, cosine) = on.heading.sine_cosine();
        Self {
            curvature,
            sharpness,
            ramp,
            ahead: on.north - sine / curvature,
            aside: on.east + cosine / curvature,
            least: curvature * ramp,
        }
    }

    /// Adds a turn by `deflection` (rad, not negative) with the wheels to `side` (1 for right,
    /// -1 for left). False if it would be sharper than the limits.
    fn push(&self, turn: &mut Turn<T>, side: T, deflection: T, reverse: bool) -> bool {
        let ramp = |curvature: T, sharpness: T, length: T| Part {
            curvature: curvature * side,
            sharpness: sharpness * side,
            length,
            reverse,
        };
        if deflection >= self.least {
            turn.push(ramp(T::zero(), self.sharpness, self.ramp));
            let arc = (deflection - self.least) / self.curvature;
            turn.push(ramp(self.curvature, T::zero(), arc));
            turn.push(ramp(self.curvature, -self.sharpness, self.ramp));
            return true;
        }
        // Two clothoids of less sharpness end on the same circle. Those of unit length give the
        // scale.
        let half = deflection * T::lit(0.5);
        let origin = Pose {
            north: T::zero(),
            east: T::zero(),
            heading: -half,
        };
        let (sine, cosine) = half.sine_cosine();
        let chord = self.ahead * cosine + self.aside * sine;
        let length = chord / travel(origin, T::zero(), deflection, T::one()).north;
        let sharpness = deflection / (length * length);
        let most = T::one() + T::lit(1e-3);
        if !(length > T::zero()
            && sharpness <= self.sharpness * most
            && sharpness * length <= self.curvature * most)
        {
            return false;
        }
        turn.push(ramp(T::zero(), sharpness, length));
        turn.push(ramp(sharpness * length, -sharpness, length));
        true
    }
}

/// A vector, m.
#[derive(Clone, Copy, Debug)]
struct Vector<T> {
    north: T,
    east: T,
}

impl<T: Scalar> Vector<T> {
    fn square(self) -> T {
        self.north * self.north + self.east * self.east
    }

    fn direction(self) -> T {
        self.east.angle_of(self.north)
    }

    fn minus(self, other: Self) -> Self {
        Self {
            north: self.north - other.north,
            east: self.east - other.east,
        }
    }
}

/// The point `ahead` and `right` of a pose, m.
fn beside<T: Scalar>(pose: &Pose<T>, ahead: T, right: T) -> Vector<T> {
    let (sine, cosine) = pose.heading.sine_cosine();
    Vector {
        north: pose.north + ahead * cosine - right * sine,
        east: pose.east + ahead * sine + right * cosine,
    }
}

/// Number of words.
const WORDS: u8 = 16;

/// A search for the shortest turn that has room, in steps.
#[derive(Clone, Copy, Debug)]
pub struct TurnPlan<T> {
    settings: TurnSettings<T>,
    circle: Circle<T>,
    start: Pose<T>,
    /// The turn is computed relative to its start, which keeps millimetres in single precision.
    end: Pose<T>,
    word: u8,
    candidate: Option<Candidate<T>>,
    best: Option<(T, Turn<T>)>,
}

/// A turn that is being compared with the room that there is.
#[derive(Clone, Copy, Debug)]
struct Candidate<T> {
    cost: T,
    turn: Turn<T>,
    part: usize,
    /// The pose of that part, counted from zero. A distance that grows by the spacing would stall where that is less
    /// than its rounding error.
    pose: i32,
    start: Pose<T>,
}

impl<T: Scalar> TurnPlan<T> {
    /// A plan for a turn from `start`, the end of one pass, to `end`, the beginning of the next.
    ///
    /// # Errors
    /// [`TurnError`] if a setting or a pose is not usable.
    pub fn new(
        start: Pose<T>,
        end: Pose<T>,
        settings: &TurnSettings<T>,
    ) -> Result<Self, TurnError> {
        if !settings.is_usable() {
            return Err(TurnError::Settings);
        }
        let circle = Circle::of(settings);
        if !(start.is_usable() && end.is_usable()) {
            return Err(TurnError::Pose);
        }
        Ok(Self {
            settings: *settings,
            circle,
            start,
            end: Pose {
                north: end.north - start.north,
                east: end.east - start.east,
                heading: end.heading,
            },
            word: 0,
            candidate: None,
            best: None,
        })
    }

    /// One step: computes one word, or compares up to eight poses of a turn with the room.
    /// Returns the result with the last step. A plan takes 17 steps, and one for each
    /// eight poses of its turns, begun ones too. A part of a turn has a pose at its beginning, and at
    /// each [`TurnSettings::spacing`].
    pub fn step<B: Room<T>>(&mut self, room: &B) -> Option<Result<Turn<T>, TurnError>> {
        if let Some(mut candidate) = self.candidate.take() {
            match candidate.compare(room, self.settings.spacing) {
                Compared::Further => self.candidate = Some(candidate),
                Compared::Inside => self.best = Some((candidate.cost, candidate.turn)),
                Compared::Outside => {}
            }
            return None;
        }
        if self.word >= WORDS {
            return Some(self.best.map(|(_, turn)| turn).ok_or(TurnError::NoRoom));
        }
        let turn = self.turn(self.word);
        self.word += 1;
        if let Some(turn) = turn {
            let stops = T::integer(turn.reversals() as i32);
            let cost = turn.length() + stops * self.settings.stop_cost;
            if self.best.is_none_or(|(best, _)| cost < best) {
                self.candidate = Some(Candidate {
                    cost,
                    turn,
                    part: 0,
                    pose: 0,
                    start: self.start,
                });
            }
        }
        None
    }

    /// All steps at once, for hosts and tests.
    ///
    /// # Errors
    /// [`TurnError::NoRoom`] if there is no room for a turn.
    pub fn run<B: Room<T>>(mut self, room: &B) -> Result<Turn<T>, TurnError> {
        loop {
            if let Some(result) = self.step(room) {
                return result;
            }
        }
    }

    /// The turn of a word, if there is one.
    fn turn(&self, word: u8) -> Option<Turn<T>> {
        let side = |right: bool| if right { T::one() } else { -T::one() };
        let first = side(word & 1 == 0);
        let other = word & 2 == 0;
        let settings = &self.settings;
        let straight = |length: T| Part {
            curvature: T::zero(),
            sharpness: T::zero(),
            length,
            reverse: false,
        };
        let origin = Pose {
            north: T::zero(),
            east: T::zero(),
            heading: self.start.heading,
        };
        let start = straight(settings.lead_in).end(origin);
        let back = beside(&self.end, -settings.lead_out, T::zero());
        let end = Pose {
            north: back.north,
            east: back.east,
            heading: self.end.heading,
        };
        let between = Between {
            circle: &self.circle,
            start,
            end,
            lead: straight(settings.lead_in),
        };
        let mut turn = match word >> 2 {
            0 => between.two_turns(first, side(other) * first, T::one()),
            1 => between.two_turns(first, side(other) * first, -T::one()),
            2 => between.three_turns(first, side(other), false),
            _ => between.three_turns(first, side(other), true),
        }?;
        turn.push(straight(settings.lead_out));
        if turn.reversals() > 0 && !settings.reverse {
            return None;
        }
        if !(turn.length() <= T::lit(LONGEST)) {
            return None;
        }
        // A word that does not end where it should was computed from a root of a rounding
        // error.
        let reached = turn.end(origin);
        let off = beside(&reached, T::zero(), T::zero()).minus(Vector {
            north: self.end.north,
            east: self.end.east,
        });
        let close = T::lit(1e-3);
        (off.square() <= close * close
            && wrap_angle(reached.heading - self.end.heading).abs() <= close)
            .then_some(turn)
    }
}

/// What the comparison of some poses gave.
enum Compared {
    Further,
    Inside,
    Outside,
}

impl<T: Scalar> Candidate<T> {
    fn compare<B: Room<T>>(&mut self, room: &B, spacing: T) -> Compared {
        // loop-bound: 8
        for _ in 0..POSES {
            let Some(part) = self.turn.parts().get(self.part) else {
                return Compared::Inside;
            };
            if !room.allows(&part.pose(self.start, T::integer(self.pose) * spacing)) {
                return Compared::Outside;
            }
            self.pose = self.pose.saturating_add(1);
            if !(T::integer(self.pose) * spacing < part.length) {
                self.start = part.end(self.start);
                self.part += 1;
                self.pose = 0;
            }
        }
        Compared::Further
    }
}

/// The words between two poses with straight wheels.
struct Between<'a, T> {
    circle: &'a Circle<T>,
    start: Pose<T>,
    end: Pose<T>,
    lead: Part<T>,
}

impl<T: Scalar> Between<'_, T> {
    /// Centres of the circles of the first and of the last turn.
    fn centres(&self, first: T, last: T) -> (Vector<T>, Vector<T>) {
        let &Circle { ahead, aside, .. } = self.circle;
        (
            beside(&self.start, ahead, first * aside),
            beside(&self.end, -ahead, last * aside),
        )
    }

    fn begin(&self, kind: Kind) -> Turn<T> {
        let mut turn = Turn::empty(kind);
        turn.push(self.lead);
        turn
    }

    /// A turn to `first`, a straight piece, and a turn to `last`; sides are 1 for right and -1
    /// for left. The straight piece points from the first circle to the last (`way` 1) or
    /// back (-1). If it points the wrong way for the turns, it is driven backwards.
    ///
    /// The centres are apart by the straight piece and both `ahead`, along the piece, and by
    /// `last` - `first` times `aside` across it.
    fn two_turns(&self, first: T, last: T, way: T) -> Option<Turn<T>> {
        let (from, to) = self.centres(first, last);
        let between = to.minus(from);
        let across = (last - first) * self.circle.aside;
        let square = between.square() - across * across;
        if !(square >= T::zero()) {
            return None;
        }
        let along = way * square.root();
        let heading = between.direction() - across.angle_of(along);
        let length = along - self.circle.ahead * T::lit(2.0);
        let reverse = length < T::zero();
        let mut turn = self.begin(if reverse {
            Kind::ThreePoint
        } else {
            Kind::Wide
        });
        let before = turn_forward(first * (heading - self.start.heading));
        let after = turn_forward(last * (self.end.heading - heading));
        let drivable = self.circle.push(&mut turn, first, before, false);
        turn.push(Part {
            curvature: T::zero(),
            sharpness: T::zero(),
            length: length.abs(),
            reverse,
        });
        (drivable && self.circle.push(&mut turn, last, after, false)).then_some(turn)
    }

    /// Three turns to alternating sides, the first to `first`. The circle in the middle lies on
    /// one `bank` or the other of the line through the others; its turn may be driven in
    /// `reverse`.
    ///
    /// Two circles that are left and entered forwards are apart by 2 `ahead` along the
    /// heading at their joint and 2 `aside` across it; where the direction changes, by
    /// 2 `aside` across it alone.
    fn three_turns(&self, first: T, bank: T, reverse: bool) -> Option<Turn<T>> {
        let (from, to) = self.centres(first, first);
        let between = to.minus(from);
        let &Circle { ahead, aside, .. } = self.circle;
        let lead = if reverse { T::zero() } else { ahead };
        let half = T::lit(0.5);
        // From the middle between both to the third centre.
        let apart = between.square();
        let square = T::lit(4.0) * (lead * lead + aside * aside) - apart * T::lit(0.25);
        if !(square >= T::zero() && apart > T::zero()) {
            return None;
        }
        let away = bank * (square / apart).root();
        let out = Vector {
            north: between.north * half - between.east * away,
            east: between.east * half + between.north * away,
        };
        let lean = (-first * aside).angle_of(lead);
        let leave = out.direction() - lean;
        let join = between.minus(out).direction() + lean;
        let mut turn = self.begin(if reverse {
            Kind::ThreePoint
        } else {
            Kind::Omega
        });
        let before = turn_forward(first * (leave - self.start.heading));
        let turned = if reverse { first } else { -first };
        let middle = turn_forward(turned * (join - leave));
        let after = turn_forward(first * (self.end.heading - join));
        (self.circle.push(&mut turn, first, before, false)
            && self.circle.push(&mut turn, -first, middle, reverse)
            && self.circle.push(&mut turn, first, after, false))
        .then_some(turn)
    }
}
