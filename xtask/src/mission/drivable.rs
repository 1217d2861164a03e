//! A plan as the vehicle drives it.

use control::{
    controller::Settings,
    dubins::Pose,
    fence::Point,
    mission::{End, Join, Leg, Legs, MissionSettings, Summary, check},
    position::Position,
};
use mission::{
    curve::{self, Chain},
    drive,
    plan::{self, Plan},
};
use vehicle_model::{Vehicle, description, manifest};

/// Words of the flash that a mission may have.
const ROOM: usize = 32 * 1024;

/// The legs of a plan in the terms of the vehicle's firmware.
#[derive(Clone, Debug)]
pub(crate) struct Drivable {
    /// The curve of each leg of the plan.
    pub chains: Vec<Chain>,
    /// The leg of the plan that each leg of the firmware belongs to.
    of: Vec<usize>,
    legs: Vec<Leg<f32>>,
    fence: Vec<Point<f32>>,
    end: End,
}

/// What a mission may ask of a vehicle.
///
/// # Errors
/// Why the vehicle has no missions.
pub(crate) fn settings(vehicle: &Vehicle) -> Result<MissionSettings<f32>, String> {
    let without = || {
        format!(
            "vehicle {:?} has no missions: [mission] in its vehicle.toml is needed",
            vehicle.name()
        )
    };
    let own = vehicle.manifest().mission.as_ref().ok_or_else(without)?;
    let description = description(vehicle).ok_or_else(without)?;
    let controller = Settings::<f32>::for_vehicle(&description).map_err(|why| why.to_string())?;
    Ok(design_of(own).settings(&controller))
}

/// What the vehicle brings to its missions.
fn design_of(mission: &manifest::Mission) -> firmware::mission::Design {
    firmware::mission::Design {
        turn_speed: mission.turn_speed.get() as f32,
        reserve: mission.reserve.get() as f32,
        half_width: mission.width.get() as f32 * 0.5,
        ahead: mission.ahead.get() as f32,
        behind: mission.behind.get() as f32,
    }
}

fn point(at: mission::place::Local) -> Point<f32> {
    Point {
        north: at.north as f32,
        east: at.east as f32,
    }
}

impl Drivable {
    /// The legs of a plan.
    ///
    /// # Errors
    /// The leg that no curve can be fitted to, or that the plan is wrong.
    pub(crate) fn of(plan: &Plan) -> Result<Self, String> {
        plan.check().map_err(|problem| problem.to_string())?;
        let chains = curve::legs(plan, &curve::Options::default())
            .map_err(|(leg, why)| format!("leg {}: {why}", leg + 1))?;
        let pieces = drive::pieces(plan, &chains);
        let leg = |piece: &drive::Piece| Leg {
            start: Pose {
                north: piece.start.place.north as f32,
                east: piece.start.place.east as f32,
                heading: piece.start.heading as f32,
            },
            curvature: piece.curvature as f32,
            sharpness: piece.sharpness as f32,
            length: piece.length as f32,
            speed: piece.speed as f32,
            reverse: piece.reverse,
            outputs: piece.outputs,
            join: match piece.next {
                plan::Join::Continue => Join::Continue,
                plan::Join::Turn => Join::Turn,
            },
        };
        Ok(Self {
            of: pieces.iter().map(|piece| piece.leg).collect(),
            legs: pieces.iter().map(leg).collect(),
            fence: plan.fence.iter().copied().map(point).collect(),
            end: match plan.end {
                plan::End::Stop => End::Stop,
                plan::End::Repeat => End::Repeat,
            },
            chains,
        })
    }

    /// The leg of the plan that a leg of the firmware belongs to.
    pub(crate) fn leg_of(&self, number: usize) -> usize {
        self.of.get(number).map_or(number, |leg| *leg)
    }

    /// What the firmware drives.
    pub(crate) fn mission(&self) -> Legs<'_, f32> {
        Legs {
            origin: Position::new(0, 0),
            legs: &self.legs,
            fence: &self.fence,
            end: self.end,
        }
    }

    /// The pose `before` metres before the first leg, straight on to it; m and rad.
    pub(crate) fn begin(&self, before: f64) -> Option<Pose<f64>> {
        let first = self.legs.first()?.start;
        let (north, east, heading) = (
            f64::from(first.north),
            f64::from(first.east),
            f64::from(first.heading),
        );
        Some(Pose {
            north: north - before * heading.cos(),
            east: east - before * heading.sin(),
            heading,
        })
    }

    /// Number of lines, arcs and clothoids.
    pub(crate) fn pieces(&self) -> usize {
        self.legs.len()
    }

    /// Checks that a vehicle can drive it, as the vehicle itself does.
    ///
    /// # Errors
    /// A clause that names the first leg at fault, and why.
    pub(crate) fn check(&self, settings: &MissionSettings<f32>) -> Result<Summary<f32>, String> {
        use control::mission::Violation;
        check(&self.mission(), settings).map_err(|violation| match violation {
            Violation::Leg { number, fault } => {
                format!("leg {}: {fault}", self.leg_of(number) + 1)
            }
            other => other.to_string(),
        })
    }

    /// The record for the flash.
    ///
    /// # Errors
    /// It is too long.
    pub(crate) fn record(&self) -> Result<Vec<u8>, String> {
        let mission = self.mission();
        let words = firmware::mission::words(&mission);
        let words: Vec<u32> = words.into_iter().flatten().collect();
        if words.is_empty() || words.len() > ROOM {
            return Err(format!(
                "it has {} lines, arcs and clothoids and {} corners of a fence: a record has room for {} and {}",
                self.legs.len(),
                self.fence.len(),
                control::mission::LEGS,
                control::fence::CORNERS
            ));
        }
        Ok(words.into_iter().flat_map(u32::to_le_bytes).collect())
    }
}
