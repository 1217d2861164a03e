//! Judges a mission before it is driven.

use super::planner::{Yard, turn_between};
use super::{Join, Leg, Mission, MissionSettings};
use crate::dubins::Pose;
use crate::fence::{Corners, Fence, FenceError, ObstacleError, Obstacles, Room, Sides};
use crate::position::Position;
use crate::scalar::{Scalar, wrap_angle};
use crate::turn::{TurnError, TurnPlan};

/// Largest number of legs.
pub const LEGS: usize = 4096;
/// Shortest leg, m.
pub const SHORTEST: f64 = 0.05;
/// Longest leg, m.
pub const LONGEST: f64 = 2000.0;
/// Largest coordinate, m: up to there single precision keeps half a millimetre.
pub const REACH: f64 = 4096.0;
/// Largest distance of the origin to the north, south, east or west of the base station, mm. Positions count in the plane
/// tangent to the earth there. So far away, its north is 0.1 deg off the local north at a latitude of 45 deg, and a
/// baseline of a receiver with an error of 1 ppm is 1 cm wrong.
pub const FARTHEST_ORIGIN: i32 = 10_000_000;
/// Largest distance between the end of a leg and the beginning of the next one that continues
/// it, m.
pub const JOIN_POSITION: f64 = 0.01;
/// The same for the heading, rad.
pub const JOIN_HEADING: f64 = 0.01;
/// The same for the curvature, 1/m. At a turn it is the largest curvature before and behind it.
pub const JOIN_CURVATURE: f64 = 0.01;

/// Most that a leg of changing curvature may wind, rad: its length times its larger curvature. Up to here
/// [`travel`](crate::clothoid::travel) knows where it ends.
pub const WINDING: f64 = 8.0;

/// Poses that a step compares with the fence.
const POSES: usize = 4;

/// What is wrong with a leg.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// A number is not finite, or [`Mission::leg`] has no such leg.
    NotFinite,
    /// A coordinate is beyond [`REACH`], or a heading beyond 100 rad, where single precision loses
    /// digits.
    TooFar,
    /// The length is not between [`SHORTEST`] and [`LONGEST`], or the leg winds by more than [`WINDING`].
    Length,
    /// The speed is below [`MissionSettings::slowest`], or above the vehicle's.
    Speed,
    /// The curvature is above the vehicle's, with the reserve that its settings state.
    Curvature,
    /// The curvature changes so fast that the steering could only follow at less than
    /// [`MissionSettings::slowest`].
    Sharpness,
    /// The vehicle would leave the fence.
    Outside,
    /// The vehicle would touch an obstacle.
    Obstacle,
    /// The next leg begins elsewhere.
    JoinPosition,
    /// The next leg begins with another heading.
    JoinHeading,
    /// The next leg begins with another curvature, or a turn joins a leg that is not straight there.
    JoinCurvature,
    /// There is no turn to the next leg.
    Turn(TurnError),
}

impl core::fmt::Display for Fault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NotFinite => f.write_str("a number is not finite"),
            Self::TooFar => {
                write!(
                    f,
                    "a coordinate is beyond {REACH} m or a heading beyond 100 rad"
                )
            }
            Self::Length => write!(
                f,
                "its length is not between {SHORTEST} and {LONGEST} m, or it winds by more than {WINDING} rad"
            ),
            Self::Speed => f.write_str("its speed is too low or too high for the vehicle"),
            Self::Curvature => f.write_str("its curvature is more than the vehicle can steer"),
            Self::Sharpness => f.write_str("its curvature changes faster than the steering"),
            Self::Outside => f.write_str("the vehicle would leave the fence"),
            Self::Obstacle => f.write_str("the vehicle would touch an obstacle"),
            Self::JoinPosition => f.write_str("the next leg does not begin where it ends"),
            Self::JoinHeading => f.write_str("the next leg does not begin with its last heading"),
            Self::JoinCurvature => {
                f.write_str("the next leg or turn does not begin with its last curvature")
            }
            Self::Turn(error) => write!(f, "no turn to the next leg: {error}"),
        }
    }
}

/// The first thing that is wrong with a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Violation {
    /// The vehicle's settings are not usable.
    Settings,
    /// There are no legs, or more than [`LEGS`].
    Count(usize),
    /// The origin is more than [`FARTHEST_ORIGIN`] north, south, east or west of the base station.
    Origin,
    /// The fence is not usable.
    Fence(FenceError),
    /// The obstacles are not usable.
    Obstacles(ObstacleError),
    /// A leg.
    Leg {
        /// The leg, counted from zero.
        number: usize,
        /// What is wrong.
        fault: Fault,
    },
}

impl core::fmt::Display for Violation {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Settings => f.write_str("the vehicle's settings are not usable"),
            Self::Count(count) => write!(f, "the mission has {count} legs, not 1 to {LEGS}"),
            Self::Origin => write!(
                f,
                "the origin is not within {} km of the base station",
                FARTHEST_ORIGIN / 1_000_000
            ),
            Self::Fence(error) => error.fmt(f),
            Self::Obstacles(error) => error.fmt(f),
            Self::Leg { number, fault } => write!(f, "leg {number}: {fault}"),
        }
    }
}

impl core::error::Error for Violation {}

/// What a sound mission consists of.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Summary<T> {
    /// Number of legs.
    pub legs: usize,
    /// Number of headland turns.
    pub turns: usize,
    /// Distance driven, m, once through.
    pub length: T,
    /// Time that it takes at the largest speed of each part, s; stops and accelerations come on
    /// top.
    pub time: T,
}

/// What the check looks at next.
#[derive(Clone, Copy, Debug)]
enum Stage<T> {
    /// The numbers of the mission itself.
    Begin,
    /// The sides of the fence.
    Fence(Sides),
    /// The sides of the obstacles.
    Obstacles(Sides),
    /// The numbers of a leg.
    Numbers,
    /// Poses of a leg from a distance on.
    Poses(T),
    /// The joint behind a leg.
    Joint,
    /// The turn behind a leg.
    Turn(TurnPlan<T>),
}

/// A check in steps. Poses of legs and turns are compared with fence and obstacles at every
/// [`crate::turn::TurnSettings::spacing`], so the vehicle may come a little nearer to them between two.
#[derive(Clone, Copy, Debug)]
pub struct Check<T> {
    settings: MissionSettings<T>,
    stage: Stage<T>,
    number: usize,
    sum: Summary<T>,
}

/// The whole check at once, for hosts and tests.
///
/// # Errors
/// [`Violation`]: the first thing that is wrong.
pub fn check<T: Scalar, M: Mission<T>>(
    mission: &M,
    settings: &MissionSettings<T>,
) -> Result<Summary<T>, Violation> {
    let mut check = Check::new(*settings);
    loop {
        if let Some(result) = check.step(mission) {
            return result;
        }
    }
}

/// Whether the vehicle may stand at a pose.
// Not inlined: its loops are bounded by themselves then, and not once for each place that asks.
#[inline(never)]
fn allowed<C: Corners<T>, T: Scalar>(yard: &Yard<C, T>, at: &Pose<T>) -> Result<(), Fault> {
    if yard.allows(at) {
        Ok(())
    } else if yard.holds(at) {
        Err(Fault::Obstacle)
    } else {
        Err(Fault::Outside)
    }
}

impl<T: Scalar> Check<T> {
    /// A check for a vehicle with these `settings`.
    #[must_use]
    pub fn new(settings: MissionSettings<T>) -> Self {
        Self {
            settings,
            stage: Stage::Begin,
            number: 0,
            sum: Summary {
                legs: 0,
                turns: 0,
                length: T::zero(),
                time: T::zero(),
            },
        }
    }

    /// The leg that is being judged, counted from zero.
    #[must_use]
    pub const fn number(&self) -> usize {
        self.number
    }

    /// One step: the numbers of the mission, four sides of its fence or of an obstacle, the numbers or four poses of a
    /// leg, a joint, or a step of a turn's plan. Returns the result with the last one.
    pub fn step<M: Mission<T>>(&mut self, mission: &M) -> Option<Result<Summary<T>, Violation>> {
        if let Some(around) = self.around(mission) {
            return around.err().map(Err);
        }
        let number = self.number;
        let wrong = |fault| Some(Err(Violation::Leg { number, fault }));
        let Some(leg) = mission.leg(number) else {
            return wrong(Fault::NotFinite);
        };
        match self.leg(mission, &leg) {
            Err(fault) => wrong(fault),
            Ok(false) => None,
            Ok(true) => {
                self.number += 1;
                self.stage = Stage::Numbers;
                (self.number >= self.sum.legs).then_some(Ok(self.sum))
            }
        }
    }

    /// A step before the legs; `None` when they are next.
    fn around<M: Mission<T>>(&mut self, mission: &M) -> Option<Result<(), Violation>> {
        let (corners, sides, next, wrong): (_, _, _, fn(usize) -> Violation) = match &mut self.stage
        {
            Stage::Begin => {
                let sides = Sides::of_fence(mission.fence().count());
                self.stage = Stage::Fence(sides);
                return Some(self.begin(mission));
            }
            Stage::Fence(sides) => (
                mission.fence(),
                sides,
                Stage::Obstacles(Sides::of_obstacles()),
                |side| Violation::Fence(FenceError::Crossing(side)),
            ),
            Stage::Obstacles(sides) => (mission.obstacles(), sides, Stage::Numbers, |side| {
                Violation::Obstacles(ObstacleError::Crossing(side))
            }),
            _ => return None,
        };
        match sides.step(corners) {
            None => {}
            Some(Ok(())) => self.stage = next,
            Some(Err(side)) => return Some(Err(wrong(side))),
        }
        Some(Ok(()))
    }

    fn begin<M: Mission<T>>(&mut self, mission: &M) -> Result<(), Violation> {
        if !self.settings.is_usable() {
            return Err(Violation::Settings);
        }
        self.sum.legs = mission.count();
        if !(1..=LEGS).contains(&self.sum.legs) {
            return Err(Violation::Count(self.sum.legs));
        }
        let Position { north, east } = mission.origin();
        let near = -FARTHEST_ORIGIN..=FARTHEST_ORIGIN;
        if !(near.contains(&north) && near.contains(&east)) {
            return Err(Violation::Origin);
        }
        if !mission.fence().is_empty() {
            Fence::new(mission.fence(), self.settings.kept_free()).map_err(Violation::Fence)?;
        }
        Obstacles::new(mission.obstacles(), self.settings.kept_free())
            .map_err(Violation::Obstacles)?;
        Ok(())
    }

    /// A step within a leg. True if it was the last one.
    fn leg<M: Mission<T>>(&mut self, mission: &M, leg: &Leg<T>) -> Result<bool, Fault> {
        match &mut self.stage {
            Stage::Begin | Stage::Fence(_) | Stage::Obstacles(_) | Stage::Numbers => {
                self.numbers(leg)?;
                self.stage = Stage::Poses(T::zero());
            }
            Stage::Poses(_) if leg.curvature == T::zero() && leg.sharpness == T::zero() => {
                let ground = self.settings.kept_free().swept(leg.length, leg.reverse);
                allowed(&Yard::around(mission, ground), &leg.start)?;
                self.stage = Stage::Joint;
            }
            Stage::Poses(along) => {
                let yard = Yard::of(mission, &self.settings);
                // loop-bound: 4
                for _ in 0..POSES {
                    let end = !(*along < leg.length);
                    let at = if end { leg.length } else { *along };
                    let pose = leg.part().pose(leg.start, at);
                    allowed(&yard, &pose)?;
                    if end {
                        self.stage = Stage::Joint;
                        break;
                    }
                    *along += self.settings.turn.spacing;
                }
            }
            Stage::Joint => {
                let next = mission
                    .after(self.number)
                    .and_then(|next| mission.leg(next));
                let Some(next) = next else {
                    return Ok(true);
                };
                if leg.join == Join::Continue {
                    joins(leg, &next)?;
                    return Ok(true);
                }
                let straight = |curvature: T| curvature.abs() <= T::lit(JOIN_CURVATURE);
                if !(straight(leg.part().last_curvature()) && straight(next.curvature)) {
                    return Err(Fault::JoinCurvature);
                }
                let plan = turn_between(leg, &next, &self.settings).map_err(Fault::Turn)?;
                self.stage = Stage::Turn(plan);
            }
            Stage::Turn(plan) => {
                if let Some(result) = plan.step(&Yard::of(mission, &self.settings)) {
                    let turn = result.map_err(Fault::Turn)?;
                    self.sum.turns += 1;
                    // loop-bound: 11
                    for part in turn.parts() {
                        let speed = self.settings.speed_on(part, self.settings.turn_speed);
                        self.sum.length += part.length;
                        self.sum.time += part.length / speed;
                    }
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    fn numbers(&mut self, leg: &Leg<T>) -> Result<(), Fault> {
        let part = leg.part();
        let end = leg.end();
        let numbers = [
            leg.start.north,
            leg.start.east,
            leg.start.heading,
            leg.curvature,
            leg.sharpness,
            leg.length,
            leg.speed,
            end.north,
            end.east,
        ];
        if !numbers.into_iter().all(|number| number.is_finite()) {
            return Err(Fault::NotFinite);
        }
        let far =
            |pose: &Pose<T>| pose.north.abs() > T::lit(REACH) || pose.east.abs() > T::lit(REACH);
        if far(&leg.start) || far(&end) || leg.start.heading.abs() > T::lit(100.0) {
            return Err(Fault::TooFar);
        }
        if !(leg.length >= T::lit(SHORTEST) && leg.length <= T::lit(LONGEST)) {
            return Err(Fault::Length);
        }
        if !self.settings.may_drive(leg.speed) {
            return Err(Fault::Speed);
        }
        let most = self.settings.curvature * T::lit(1.001);
        if !(leg.curvature.abs() <= most && part.last_curvature().abs() <= most) {
            return Err(Fault::Curvature);
        }
        let (first, last) = (leg.curvature.abs(), part.last_curvature().abs());
        let most = if first > last { first } else { last };
        if leg.sharpness != T::zero() && !(most * leg.length <= T::lit(WINDING)) {
            return Err(Fault::Length);
        }
        let speed = self.settings.speed_on(&part, leg.speed);
        if speed < leg.speed && speed < self.settings.slowest {
            return Err(Fault::Sharpness);
        }
        self.sum.length += leg.length;
        self.sum.time += leg.length / speed;
        Ok(())
    }
}

/// Whether `next` continues a leg.
fn joins<T: Scalar>(leg: &Leg<T>, next: &Leg<T>) -> Result<(), Fault> {
    let end = leg.end();
    let (dn, de) = (next.start.north - end.north, next.start.east - end.east);
    if !((dn * dn + de * de).root() <= T::lit(JOIN_POSITION)) {
        return Err(Fault::JoinPosition);
    }
    if !(wrap_angle(next.start.heading - end.heading).abs() <= T::lit(JOIN_HEADING)) {
        return Err(Fault::JoinHeading);
    }
    if !((next.curvature - leg.part().last_curvature()).abs() <= T::lit(JOIN_CURVATURE)) {
        return Err(Fault::JoinCurvature);
    }
    Ok(())
}
