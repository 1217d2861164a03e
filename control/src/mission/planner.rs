//! Makes the pieces of a mission's path, a little ahead of the vehicle.

use super::stretch::{Piece, Purpose, Stretch};
use super::{Join, Leg, Mission, MissionSettings};
use crate::dubins::Pose;
use crate::fence::{Corners, Fence, Footprint, Obstacles, Room};
use crate::scalar::Scalar;
use crate::turn::{Part, Turn, TurnError, TurnPlan};

/// Where a vehicle may be in a mission: inside the fence and beside the obstacles, if there are any.
#[derive(Clone, Copy, Debug)]
pub struct Yard<C, T> {
    fence: Option<Fence<C, T>>,
    obstacles: Option<Obstacles<C, T>>,
}

impl<C: Corners<T>, T: Scalar> Yard<C, T> {
    /// Fence and obstacles of a mission around this ground. Those that are not usable are none:
    /// [`check`](super::check()) refuses them.
    #[must_use]
    pub fn around<'a, M>(mission: &'a M, ground: Footprint<T>) -> Self
    where
        M: Mission<T, Corners<'a> = C>,
    {
        Self {
            fence: Fence::new(mission.fence(), ground).ok(),
            obstacles: Obstacles::new(mission.obstacles(), ground).ok(),
        }
    }

    /// The room for the paths of a mission.
    #[must_use]
    pub fn of<'a, M>(mission: &'a M, settings: &MissionSettings<T>) -> Self
    where
        M: Mission<T, Corners<'a> = C>,
    {
        Self::around(mission, settings.kept_free())
    }

    /// Whether the vehicle stays inside the fence, if there is one.
    #[must_use]
    pub fn holds(&self, at: &Pose<T>) -> bool {
        self.fence.as_ref().is_none_or(|fence| fence.allows(at))
    }
}

impl<C: Corners<T>, T: Scalar> Room<T> for Yard<C, T> {
    fn allows(&self, at: &Pose<T>) -> bool {
        let free = |obstacles: &Obstacles<C, T>| obstacles.allows(at);
        self.holds(at) && self.obstacles.as_ref().is_none_or(free)
    }
}

/// What a step of the planner did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Step<T> {
    /// A part of a computation.
    Working,
    /// The next piece of the path.
    Piece(Piece<T>),
    /// Nothing, because the whole mission is planned.
    Done,
    /// There is no turn behind this leg, or no way to it. The path ends there.
    NoTurn {
        /// The leg, counted from zero.
        leg: usize,
        /// Why.
        error: TurnError,
    },
}

/// A turn on the way to a leg.
#[derive(Clone, Copy, Debug)]
struct Way<T> {
    purpose: Purpose,
    /// The leg before it, or for an approach the leg to which it leads.
    leg: usize,
    /// The vehicle's pose at its next part.
    start: Pose<T>,
    /// Distance driven on it up to there, m.
    from: T,
    /// The leg that it leads to, and the place on that, m.
    to: (usize, T),
}

/// What the planner does next.
#[derive(Clone, Copy, Debug)]
enum Stage<T> {
    /// Hands out a leg from a distance along it on.
    Leg(usize, T),
    /// Looks for a turn.
    Search(Way<T>, TurnPlan<T>),
    /// Hands out a turn from this part on.
    Turn(Way<T>, Turn<T>, usize),
    /// The mission has no more legs.
    Done,
    /// There is no turn.
    Stuck(usize, TurnError),
}

/// Makes the path of a mission, in short steps.
#[derive(Clone, Copy, Debug)]
pub struct Planner<T> {
    settings: MissionSettings<T>,
    stage: Stage<T>,
}

impl<T: Scalar> Planner<T> {
    /// A planner at the beginning of a mission.
    #[must_use]
    pub fn new(settings: MissionSettings<T>) -> Self {
        Self::from(settings, 0, T::zero())
    }

    /// A planner that begins `along` metres along a `leg`, to go on with a mission that was
    /// interrupted.
    #[must_use]
    pub fn from(settings: MissionSettings<T>, leg: usize, along: T) -> Self {
        Self {
            settings,
            stage: Stage::Leg(leg, along),
        }
    }

    /// A planner that first leads the vehicle from the pose `from` to the place `along` metres along
    /// a `leg`, by the shortest way inside the fence that ends there straight. The leg should be
    /// straight at that place, and the wheels at the beginning.
    ///
    /// # Errors
    /// [`TurnError`] if there is no such leg or a number is not usable.
    pub fn approaching<M: Mission<T>>(
        settings: MissionSettings<T>,
        mission: &M,
        (leg, along): (usize, T),
        from: Pose<T>,
    ) -> Result<Self, TurnError> {
        let to = mission.leg(leg).ok_or(TurnError::Pose)?;
        let end = to.part().pose(to.start, along);
        let plan = TurnPlan::new(from, end, &settings.turn)?;
        let way = Way {
            purpose: Purpose::Approach,
            leg,
            start: from,
            from: T::zero(),
            to: (leg, along),
        };
        Ok(Self {
            settings,
            stage: Stage::Search(way, plan),
        })
    }

    /// One step: at most one piece, or one step of a [`TurnPlan`]. A piece is handed out once:
    /// call this only while [`Stretch::retire`] tells of room.
    pub fn step<M: Mission<T>>(&mut self, mission: &M) -> Step<T> {
        match &mut self.stage {
            &mut Stage::Leg(number, along) => self.leg(mission, number, along),
            Stage::Search(way, plan) => {
                if let Some(result) = plan.step(&Yard::of(mission, &self.settings)) {
                    self.stage = match result {
                        Ok(turn) => Stage::Turn(*way, turn, 0),
                        Err(error) => Stage::Stuck(way.leg, error),
                    };
                }
                Step::Working
            }
            Stage::Turn(way, turn, next) => {
                let Some(part) = turn.parts().get(*next) else {
                    let (leg, along) = way.to;
                    self.stage = Stage::Leg(leg, along);
                    return Step::Working;
                };
                let piece = Piece {
                    segment: part.segment(way.start),
                    leg: way.leg,
                    purpose: way.purpose,
                    from: way.from,
                    speed: self.settings.speed_on(part, self.settings.turn_speed),
                    reverse: part.reverse,
                    outputs: 0,
                    last: false,
                };
                way.start = part.end(way.start);
                way.from += part.length;
                *next += 1;
                Step::Piece(piece)
            }
            Stage::Done => Step::Done,
            &mut Stage::Stuck(leg, error) => Step::NoTurn { leg, error },
        }
    }

    /// Fills the stretch by at most one piece, when the vehicle is on piece `current`; false if there
    /// was nothing to do. Where another task follows the stretch, call [`Self::step`] without
    /// holding it, and [`Stretch::push`] with it.
    pub fn feed<M: Mission<T>>(
        &mut self,
        mission: &M,
        stretch: &mut Stretch<T>,
        current: usize,
    ) -> bool {
        if stretch.retire(current) == 0 {
            return false;
        }
        match self.step(mission) {
            Step::Working => true,
            Step::Piece(piece) => stretch.push(piece),
            Step::Done | Step::NoTurn { .. } => false,
        }
    }

    /// Why the path ends before the mission does, if it does: the leg behind which there is no turn, or
    /// to which there is no way.
    #[must_use]
    pub fn stuck(&self) -> Option<(usize, TurnError)> {
        match self.stage {
            Stage::Stuck(leg, error) => Some((leg, error)),
            _ => None,
        }
    }

    fn leg<M: Mission<T>>(&mut self, mission: &M, number: usize, along: T) -> Step<T> {
        let Some(leg) = mission.leg(number) else {
            self.stage = Stage::Done;
            return Step::Done;
        };
        let next = mission
            .after(number)
            .and_then(|after| mission.leg(after).map(|next| (after, next)));
        self.stage = match next {
            None => Stage::Done,
            Some((after, _)) if leg.join == Join::Continue => Stage::Leg(after, T::zero()),
            Some((after, next)) => {
                let way = Way {
                    purpose: Purpose::Turn,
                    leg: number,
                    start: leg.end(),
                    from: T::zero(),
                    to: (after, T::zero()),
                };
                turn_between(&leg, &next, &self.settings).map_or_else(
                    |error| Stage::Stuck(number, error),
                    |plan| Stage::Search(way, plan),
                )
            }
        };
        let begun = along > T::zero() && along < leg.length;
        let from = if begun { along } else { T::zero() };
        let whole = leg.part();
        let rest = Part {
            curvature: leg.curvature + leg.sharpness * from,
            length: leg.length - from,
            ..whole
        };
        let start = if begun {
            whole.pose(leg.start, from)
        } else {
            leg.start
        };
        Step::Piece(Piece {
            segment: rest.segment(start),
            leg: number,
            purpose: Purpose::Leg,
            from,
            speed: self.settings.speed_on(&whole, leg.speed),
            reverse: leg.reverse,
            outputs: leg.outputs,
            last: next.is_none(),
        })
    }
}

/// The plan of the turn from one leg to the next.
pub(super) fn turn_between<T: Scalar>(
    leg: &Leg<T>,
    next: &Leg<T>,
    settings: &MissionSettings<T>,
) -> Result<TurnPlan<T>, TurnError> {
    TurnPlan::new(leg.end(), next.start, &settings.turn)
}
