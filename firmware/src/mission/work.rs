//! The work of the task that plans a mission: first it checks it, then it makes its path ahead of the vehicle.

use control::dubins::Pose;
use control::fence::{Corners as _, Footprint, Point, Room as _};
use control::line::Line;
use control::mission::{
    Check, Join, Leg, Legs, Mission, MissionSettings, Piece, Planner, REACH, Step, Violation, Yard,
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

/// Why a vehicle must not drive by itself where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stray {
    /// It may be out of the fence or touch an obstacle.
    Fence,
    /// It is more than [`FAR`] from the origin of its mission.
    Far,
}

/// Largest distance to the north, south, east or west from the origin of a mission in which a run may begin, m. Up to
/// there single precision keeps half a millimetre of a place, and all legs lie within half of it.
pub const FAR: f32 = 2.0 * REACH as f32;

/// What is known of the vehicle's place, in the frame of the mission.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Standing {
    /// The pose of its rear axle, and how far its place may be off, m.
    Pose(Pose<f32>, f32),
    /// The place of its antenna, as the heading is not known before the vehicle has moved, and how far the ground under it
    /// reaches about that in any heading, m.
    Antenna(Point<f32>, f32),
    /// Nothing.
    Unknown,
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
        start: Pose {
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

/// Whether numbers tell a place.
fn is_known(pose: &Pose<f32>, off: f32) -> bool {
    [pose.north, pose.east, pose.heading, off]
        .iter()
        .all(|number| number.is_finite())
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

    /// Why the vehicle must not drive by itself where it is, if so: it may be out of the fence or touch an obstacle, as far as
    /// its place is known, or is too far from the origin. The line has neither, and begins at its origin.
    #[inline(never)]
    pub fn strays(&self, at: &Standing) -> Option<Stray> {
        let kept = self.recorded.as_ref()?;
        let mission = kept.mission();
        let (pose, ground) = match *at {
            Standing::Pose(pose, off) if is_known(&pose, off) => {
                let footprint = self.settings.footprint;
                let half_width = footprint.half_width + off;
                (
                    pose,
                    Footprint {
                        half_width,
                        ..footprint
                    },
                )
            }
            Standing::Antenna(Point { north, east }, half_width) => {
                let pose = Pose {
                    north,
                    east,
                    heading: 0.0,
                };
                let ground = Footprint {
                    half_width,
                    ..Footprint::default()
                };
                (pose, ground)
            }
            Standing::Pose(..) | Standing::Unknown => {
                let free = mission.fence().is_empty() && mission.obstacles().is_empty();
                return (!free).then_some(Stray::Fence);
            }
        };
        if pose.north.abs() > FAR || pose.east.abs() > FAR {
            Some(Stray::Far)
        } else {
            (!Yard::around(&mission, ground).allows(&pose)).then_some(Stray::Fence)
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
                    obstacles: &[],
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

#[cfg(test)]
mod tests {
    extern crate std;

    use std::boxed::Box;
    use std::vec::Vec;

    use super::*;
    use crate::mission::{example, words};

    fn corners(places: &[(f32, f32)]) -> Vec<Point<f32>> {
        let point = |&(north, east)| Point { north, east };
        places.iter().map(point).collect()
    }

    /// With its heading, all of the vehicle counts, and without it what it covers in any heading.
    #[test]
    fn a_vehicle_strays_from_its_fence_and_into_obstacles() {
        let line = Line::new(Position::new(0, 0), Position::new(10_000, 0)).unwrap();
        let mission = Legs {
            origin: Position::new(0, 0),
            legs: &[along(&line, 1.0)],
            fence: &corners(&[(-5.0, -5.0), (15.0, -5.0), (15.0, 5.0), (-5.0, 5.0)]),
            obstacles: &corners(&[(6.0, 2.0), (8.0, 2.0), (8.0, 3.0), (6.0, 2.0)]),
            end: control::mission::End::Stop,
        };
        let record: Vec<u32> = words(&mission).unwrap().collect();
        let work = |stored| Work::new(stored, &line, 1.0, example::settings());
        let fenced = work(Stored::read(Box::leak(record.into_boxed_slice())));
        let pose = |north, east, heading| {
            let pose = Pose {
                north,
                east,
                heading,
            };
            Standing::Pose(pose, 0.0)
        };
        let antenna = |north, east| Standing::Antenna(Point { north, east }, 0.3);
        let cases = [
            (pose(0.0, 0.0, 0.0), false),
            // Its front is 1.75 m ahead, without the clearance.
            (pose(13.2, 0.0, 0.0), false),
            (pose(13.3, 0.0, 0.0), true),
            (pose(13.3, 0.0, 3.1), false),
            (pose(4.3, 2.0, 0.0), true),
            (pose(7.0, 1.6, 0.0), false),
            (pose(7.0, 1.7, 0.0), true),
            (antenna(14.6, 4.6), false),
            (antenna(14.8, 0.0), true),
            (antenna(15.1, 0.0), true),
            (antenna(7.5, 2.2), true),
            (antenna(7.5, 1.8), true),
            (antenna(7.5, 1.6), false),
        ];
        for (at, strays) in cases {
            assert_eq!(fenced.strays(&at), strays.then_some(Stray::Fence), "{at:?}");
        }
        // A place that may be off by a metre is not well inside, and neither is one that nobody knows.
        let off = |metres| {
            let pose = Pose {
                north: 0.0,
                east: 3.8,
                heading: 0.0,
            };
            fenced.strays(&Standing::Pose(pose, metres)).is_some()
        };
        let found = [0.0, 0.8, 0.9, f32::INFINITY, f32::NAN].map(off);
        assert_eq!(found, [false, false, true, true, true]);
        assert_eq!(fenced.strays(&Standing::Unknown), Some(Stray::Fence));
        let free = work(Stored::None);
        assert_eq!(free.strays(&Standing::Unknown), None);
        assert_eq!(free.strays(&antenna(100.0, 100.0)), None);
    }

    /// A mission of another farm: nothing is known of a place so far away, whether it has a fence or not.
    #[test]
    fn no_run_begins_far_from_the_origin() {
        let line = Line::new(Position::new(0, 0), Position::new(10_000, 0)).unwrap();
        let mission = Legs {
            origin: Position::new(0, 0),
            legs: &[along(&line, 1.0)],
            fence: &[],
            obstacles: &[],
            end: control::mission::End::Stop,
        };
        let record: Vec<u32> = words(&mission).unwrap().collect();
        let stored = Stored::read(Box::leak(record.into_boxed_slice()));
        let work = Work::new(stored, &line, 1.0, example::settings());
        let at = |north, east| work.strays(&Standing::Antenna(Point { north, east }, 0.0));
        assert_eq!(at(8192.0, -8192.0), None);
        for far in [8193.0, -8193.0, 2e6] {
            assert_eq!(at(far, 0.0), Some(Stray::Far));
            assert_eq!(at(0.0, far), Some(Stray::Far));
        }
        let pose = Pose {
            east: 20_000.0,
            ..Pose::default()
        };
        assert_eq!(work.strays(&Standing::Pose(pose, 0.0)), Some(Stray::Far));
        assert_eq!(work.strays(&Standing::Unknown), None);
    }
}
