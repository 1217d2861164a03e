//! Missions: plans of any length, driven leg by leg.
//!
//! A [`Mission`] hands out [`Leg`]s by number; on a target they lie in flash memory. Legs are
//! joined directly or by headland turns, which are planned while the vehicle drives. [`check`]
//! judges a mission before it is driven. The [`Planner`] puts its pieces into a [`Stretch`], a
//! short path that a [`crate::controller::Controller`] follows, so that a mission needs the same
//! memory whatever its length. [`Outputs`] switches the sections of an implement.
//!
//! ```text
//! Mission -> Planner::step -> Stretch -> Controller::step -> Command
//!                               |
//!                               +----> Outputs::step -> sections of the implement
//! ```
//!
//! Everything is in the frame of the mission's origin. Poses are those of the rear axle; a heading
//! is that of the vehicle, also where it drives backwards.

mod check;
mod outputs;
mod pace;
mod planner;
mod stretch;

pub use check::{Check, Fault, JOIN_CURVATURE, JOIN_HEADING, JOIN_POSITION, Summary, Violation};
pub use check::{FARTHEST_ORIGIN, LEGS, LONGEST, REACH, SHORTEST, WINDING, check};
pub use outputs::{Outputs, Section, Switching};
pub use pace::Pace;
pub use planner::{Planner, Step, Yard};
pub use stretch::{PIECES, Piece, Purpose, Stretch, Whereabouts};

use crate::controller;
use crate::dubins::Pose;
use crate::fence::{Corners, Footprint, Point};
use crate::position::Position;
use crate::scalar::Scalar;
use crate::turn::{Part, TurnSettings};

/// How the leg after this one is reached.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Join {
    /// It begins where this one ends.
    #[default]
    Continue,
    /// By a headland turn, which the planner finds.
    Turn,
}

/// A line, an arc or a clothoid of a mission.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Leg<T> {
    /// The vehicle's pose at its beginning.
    pub start: Pose<T>,
    /// Curvature at its beginning, 1/m: positive with the wheels to the right, in reverse too.
    pub curvature: T,
    /// Change of this curvature with each metre driven, 1/m^2.
    pub sharpness: T,
    /// Length, m, positive.
    pub length: T,
    /// Speed, m/s, positive, in reverse too.
    pub speed: T,
    /// True if it is driven backwards.
    pub reverse: bool,
    /// Sections of the implement that are on, one in each bit.
    pub outputs: u8,
    /// How the leg after it is reached.
    pub join: Join,
}

impl<T: Scalar> Leg<T> {
    /// The leg as a part of a path.
    #[must_use]
    pub fn part(&self) -> Part<T> {
        Part {
            curvature: self.curvature,
            sharpness: self.sharpness,
            length: self.length,
            reverse: self.reverse,
        }
    }

    /// The vehicle's pose at its end.
    #[must_use]
    pub fn end(&self) -> Pose<T> {
        self.part().end(self.start)
    }
}

/// What follows the last leg.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum End {
    /// The vehicle stops at its end.
    #[default]
    Stop,
    /// The first leg, reached as the last one's `join` says.
    Repeat,
}

/// Something that hands out the legs of a plan.
pub trait Mission<T> {
    /// The form in which it has corners.
    type Corners<'a>: Corners<T>
    where
        Self: 'a;

    /// The origin of the frame of all poses and of the fence.
    fn origin(&self) -> Position;

    /// Number of legs.
    fn count(&self) -> usize;

    /// A leg, counted from zero; `None` from [`Self::count`] on.
    fn leg(&self, number: usize) -> Option<Leg<T>>;

    /// Corners of the fence that the vehicle must not leave; none if there is no fence.
    fn fence(&self) -> Self::Corners<'_>;

    /// Corners of the areas that the vehicle must stay out of, as [`crate::fence::Obstacles`] takes them.
    fn obstacles(&self) -> Self::Corners<'_>;

    /// What follows the last leg.
    fn end(&self) -> End;

    /// The leg after `number`, if there is one.
    fn after(&self, number: usize) -> Option<usize> {
        let next = number.checked_add(1)?;
        if next < self.count() {
            Some(next)
        } else {
            match self.end() {
                End::Stop => None,
                End::Repeat => Some(0),
            }
        }
    }
}

/// A mission whose legs lie in a slice.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Legs<'a, T> {
    /// The origin of the frame.
    pub origin: Position,
    /// The legs in driving order.
    pub legs: &'a [Leg<T>],
    /// Corners of the fence; none if there is no fence.
    pub fence: &'a [Point<T>],
    /// Corners of the obstacles, as [`crate::fence::Obstacles`] takes them.
    pub obstacles: &'a [Point<T>],
    /// What follows the last leg.
    pub end: End,
}

impl<T: Scalar> Mission<T> for Legs<'_, T> {
    type Corners<'a>
        = &'a [Point<T>]
    where
        Self: 'a;

    fn origin(&self) -> Position {
        self.origin
    }

    fn count(&self) -> usize {
        self.legs.len()
    }

    fn leg(&self, number: usize) -> Option<Leg<T>> {
        self.legs.get(number).copied()
    }

    fn fence(&self) -> &[Point<T>] {
        self.fence
    }

    fn obstacles(&self) -> &[Point<T>] {
        self.obstacles
    }

    fn end(&self) -> End {
        self.end
    }
}

/// The smallest speed of a leg or a turn, m/s, if velocities up to `standstill` (m/s, positive) tell no heading: with
/// the 30 % of slip that a sound vehicle may have, it is as fast as that over ground. The run of a slower vehicle ends
/// after 3 s without a heading ([`crate::response`]).
#[must_use]
pub fn slowest<T: Scalar>(standstill: T) -> T {
    standstill / T::lit(0.7)
}

/// What a mission may ask of a vehicle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MissionSettings<T> {
    /// Wheelbase, m, positive.
    pub wheelbase: T,
    /// Largest curvature of a leg, 1/m, positive.
    pub curvature: T,
    /// Steering rate that a path may ask for, rad/s, positive.
    pub steering_rate: T,
    /// Smallest speed of legs and turns, m/s, positive: a slower vehicle does not know its heading, and its run would
    /// end.
    pub slowest: T,
    /// Largest speed, m/s, positive.
    pub top_speed: T,
    /// Headland turns.
    pub turn: TurnSettings<T>,
    /// Speed in turns, m/s, positive.
    pub turn_speed: T,
    /// The ground that the vehicle covers.
    pub footprint: Footprint<T>,
    /// How far paths stay away from fence and obstacles, m, not negative: the vehicle may be as far off its path.
    pub clearance: T,
    /// Accelerations.
    pub pace: Pace<T>,
}

impl<T: Scalar> MissionSettings<T> {
    /// Settings for the vehicle of a controller. `reserve` is the share of the steering's angle and
    /// rate that no path uses, so that it is left for corrections; `turn_speed` (m/s) is the
    /// speed in headland turns. Paths may touch the fence; [`Self::clearance`] keeps them off it.
    #[must_use]
    pub fn for_controller(
        settings: &controller::Settings<T>,
        footprint: Footprint<T>,
        turn_speed: T,
        reserve: T,
    ) -> Self {
        let guidance = &settings.guidance;
        let (angle, rate) = (
            guidance.limits.steering_angle,
            guidance.limits.steering_rate,
        );
        let turn = TurnSettings::for_steering(guidance.wheelbase, angle, rate, turn_speed, reserve);
        Self {
            wheelbase: guidance.wheelbase,
            curvature: turn.curvature,
            steering_rate: rate * (T::one() - reserve),
            slowest: slowest(settings.estimator.standstill),
            top_speed: settings.limits.speed,
            turn,
            turn_speed,
            footprint,
            clearance: T::zero(),
            pace: Pace::of_drive(settings.estimator.drive_lag),
        }
    }

    /// Checks that every setting is usable.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        let positive = |value: T| value.is_finite() && value > T::zero();
        positive(self.wheelbase)
            && positive(self.curvature)
            && positive(self.steering_rate)
            && positive(self.slowest)
            && positive(self.top_speed)
            && positive(self.turn_speed)
            && self.may_drive(self.turn_speed)
            && self.turn.is_usable()
            && self.footprint.is_usable()
            && self.kept_free().is_usable()
            && self.clearance >= T::zero()
            && self.pace.is_usable()
    }

    /// Whether a leg or a turn may be driven at `speed`, m/s. Numbers in single precision come with rounding errors.
    pub(crate) fn may_drive(&self, speed: T) -> bool {
        let rounding = T::lit(1e-5);
        speed >= self.slowest * (T::one() - rounding)
            && speed <= self.top_speed * (T::one() + rounding)
    }

    /// The ground that a path keeps free: the vehicle's own, with the clearance about it.
    #[must_use]
    pub fn kept_free(&self) -> Footprint<T> {
        Footprint {
            half_width: self.footprint.half_width + self.clearance,
            ..self.footprint
        }
    }

    /// The largest speed (m/s) on a part that should be driven at `wanted`: less where the
    /// lateral acceleration or the steering rate would be too large.
    ///
    /// The steering rate is speed times sharpness times wheelbase with straight wheels, and less
    /// with others.
    #[must_use]
    pub fn speed_on(&self, part: &Part<T>, wanted: T) -> T {
        let (first, last) = (part.curvature.abs(), part.last_curvature().abs());
        let curvature = if first > last { first } else { last };
        let mut speed = wanted;
        let mut limit = |to: T| {
            if to < speed {
                speed = to;
            }
        };
        limit(self.top_speed);
        if curvature > T::zero() {
            limit((self.pace.lateral / curvature).root());
        }
        if part.sharpness != T::zero() {
            limit(self.steering_rate / (part.sharpness.abs() * self.wheelbase));
        }
        speed
    }
}
