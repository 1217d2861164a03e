//! Makes the pieces of a mission's path, a little ahead of the vehicle.

use super::stretch::{Piece, Purpose, Stretch};
use super::{Join, Leg, Mission, MissionSettings};
use crate::dubins::Pose;
use crate::fence::{Fence, Room};
use crate::scalar::Scalar;
use crate::turn::{Part, Turn, TurnError, TurnPlan};

/// The room for turns: inside the fence, if the mission has one.
pub(super) struct Yard<'a, T>(Option<Fence<'a, T>>);

impl<'a, T: Scalar> Yard<'a, T> {
    /// The fence of a mission. One that is not usable is none: [`super::check`] refuses it.
    pub(super) fn of<M: Mission<T>>(mission: &'a M, settings: &MissionSettings<T>) -> Self {
        Self(Fence::new(mission.fence(), settings.footprint).ok())
    }
}

impl<T: Scalar> Room<T> for Yard<'_, T> {
    fn allows(&self, at: &Pose<T>) -> bool {
        self.0.as_ref().is_none_or(|fence| fence.allows(at))
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
    /// There is no turn behind this leg. The path ends there.
    NoTurn {
        /// The leg, counted from zero.
        leg: usize,
        /// Why.
        error: TurnError,
    },
}

/// What the planner does next.
#[derive(Clone, Copy, Debug)]
enum Stage<T> {
    /// Hands out a leg from a distance along it on.
    Leg(usize, T),
    /// Looks for the turn behind a leg.
    Search(usize, TurnPlan<T>),
    /// Hands out a turn: the leg before it, the turn, its next part, the pose there and the
    /// distance driven.
    Turn(usize, Turn<T>, usize, Pose<T>, T),
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

    /// One step: at most one piece, or one step of a [`TurnPlan`]. A piece is handed out once:
    /// call this only while [`Stretch::retire`] tells of room.
    pub fn step<M: Mission<T>>(&mut self, mission: &M) -> Step<T> {
        match &mut self.stage {
            &mut Stage::Leg(number, along) => self.leg(mission, number, along),
            Stage::Search(number, plan) => {
                let number = *number;
                let Some(result) = plan.step(&Yard::of(mission, &self.settings)) else {
                    return Step::Working;
                };
                self.stage = match (result, mission.leg(number)) {
                    (Ok(turn), Some(leg)) => Stage::Turn(number, turn, 0, leg.end(), T::zero()),
                    (Ok(_), None) => Stage::Done,
                    (Err(error), _) => Stage::Stuck(number, error),
                };
                Step::Working
            }
            &mut Stage::Turn(number, turn, next, start, from) => {
                let Some(part) = turn.parts().get(next) else {
                    self.stage = match mission.after(number) {
                        Some(after) => Stage::Leg(after, T::zero()),
                        None => Stage::Done,
                    };
                    return Step::Working;
                };
                let end = part.end(start);
                self.stage = Stage::Turn(number, turn, next + 1, end, from + part.length);
                Step::Piece(Piece {
                    segment: part.segment(start),
                    leg: number,
                    purpose: Purpose::Turn,
                    from,
                    speed: self.settings.speed_on(part, self.settings.turn_speed),
                    reverse: part.reverse,
                    outputs: 0,
                    last: false,
                })
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

    /// Why the path ends before the mission does, if it does: the leg behind which there is no turn.
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
            Some((_, next)) => turn_between(&leg, &next, &self.settings).map_or_else(
                |error| Stage::Stuck(number, error),
                |plan| Stage::Search(number, plan),
            ),
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
