//! The work of the task that plans a mission: first it checks it, then it makes its path ahead of the vehicle.

use control::line::Line;
use control::mission::{
    Check, Join, Leg, Legs, Mission, MissionSettings, Piece, Planner, Step, Violation,
};
use control::position::Position;
use control::turn::TurnError;

use super::record::{Kept, Stored};

/// What is known of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum State {
    /// It is being checked.
    Checking,
    /// It can be driven.
    Ready,
    /// It cannot be driven.
    Refused,
    /// There is no way on from a leg.
    Stuck,
    /// What lies in its place is no mission of this format.
    Damaged,
}

/// Where the vehicle is, as the task sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct At {
    /// Whether the path about the vehicle has room for one more piece.
    pub room: bool,
    /// Whether the mission has been driven to its end and the run is over.
    pub over: bool,
}

#[derive(Clone, Copy, Debug)]
enum Stage {
    Checking(Check<f32>),
    Planning(Planner<f32>),
    Refused(Violation),
    Damaged,
}

/// The mission, and what has been done for it.
#[derive(Clone, Debug)]
pub struct Work {
    /// `None`: the one leg along the line.
    recorded: Option<Kept>,
    line: [Leg<f32>; 1],
    origin: Position,
    settings: MissionSettings<f32>,
    stage: Stage,
}

/// The leg along a line at a speed (m/s).
fn along(line: &Line<f32>, speed: f32) -> Leg<f32> {
    Leg {
        start: control::dubins::Pose {
            north: 0.0,
            east: 0.0,
            heading: line.bearing(),
        },
        curvature: 0.0,
        sharpness: 0.0,
        length: line.length(),
        speed,
        reverse: false,
        outputs: 0,
        join: Join::Continue,
    }
}

impl Work {
    /// Nothing done yet for the mission that is stored; if there is none, for the one along `line` at `cruise` m/s.
    pub fn new(
        stored: Stored,
        line: &Line<f32>,
        cruise: f32,
        settings: MissionSettings<f32>,
    ) -> Self {
        let (recorded, damaged) = match stored {
            Stored::None => (None, false),
            Stored::Damaged => (None, true),
            Stored::Mission(recorded) => (Some(recorded), false),
        };
        Self {
            recorded,
            line: [along(line, cruise)],
            origin: line.origin(),
            settings,
            stage: match damaged {
                true => Stage::Damaged,
                false => Stage::Checking(Check::new(settings)),
            },
        }
    }

    /// The origin of the mission's frame.
    pub fn origin(&self) -> Position {
        self.recorded
            .as_ref()
            .map_or(self.origin, |kept| kept.mission().origin())
    }

    /// Number of its legs.
    pub fn count(&self) -> usize {
        self.recorded
            .as_ref()
            .map_or(1, |kept| kept.mission().count())
    }

    /// What is known of it.
    pub fn state(&self) -> State {
        match &self.stage {
            Stage::Checking(_) => State::Checking,
            Stage::Planning(planner) if planner.stuck().is_some() => State::Stuck,
            Stage::Planning(_) => State::Ready,
            Stage::Refused(_) => State::Refused,
            Stage::Damaged => State::Damaged,
        }
    }

    /// Why it is refused, if it is.
    pub fn violation(&self) -> Option<Violation> {
        match self.stage {
            Stage::Refused(violation) => Some(violation),
            _ => None,
        }
    }

    /// The leg from which there is no way on, and why.
    pub fn stuck(&self) -> Option<(usize, TurnError)> {
        match &self.stage {
            Stage::Planning(planner) => planner.stuck(),
            _ => None,
        }
    }

    /// Begins again with the first leg. The path so far must be forgotten, too.
    pub fn restart(&mut self) {
        if let Stage::Planning(planner) = &mut self.stage {
            *planner = Planner::new(self.settings);
        }
    }

    /// A short step of the work. Returns the next piece of the path, once.
    pub fn step(&mut self, at: At) -> Option<Piece<f32>> {
        match &self.recorded {
            Some(kept) => step(&mut self.stage, &kept.mission(), &self.settings, at),
            None => {
                let mission = Legs {
                    origin: self.origin,
                    legs: &self.line,
                    fence: &[],
                    end: control::mission::End::Stop,
                };
                step(&mut self.stage, &mission, &self.settings, at)
            }
        }
    }
}

fn step<M: Mission<f32>>(
    stage: &mut Stage,
    mission: &M,
    settings: &MissionSettings<f32>,
    at: At,
) -> Option<Piece<f32>> {
    match stage {
        Stage::Checking(check) => {
            if let Some(result) = check.step(mission) {
                *stage = match result {
                    Ok(_) => Stage::Planning(Planner::new(*settings)),
                    Err(violation) => Stage::Refused(violation),
                };
            }
            None
        }
        Stage::Planning(planner) if at.over => {
            // For the next run.
            *planner = Planner::new(*settings);
            None
        }
        Stage::Planning(planner) if at.room => match planner.step(mission) {
            Step::Piece(piece) => Some(piece),
            Step::Working | Step::Done | Step::NoTurn { .. } => None,
        },
        Stage::Planning(_) | Stage::Refused(_) | Stage::Damaged => None,
    }
}
