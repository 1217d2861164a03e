//! What a scenario says about rows: those of a rover, with the ground, or of a machine that is guided by
//! them, and about distance sensors and their faults.

use serde::Deserialize;
use vehicle_model::Vehicle;

use super::Line;
use super::check::{later, within};
use super::file::without;
use super::row::{Limits, Row, RowPlace, Side};
use crate::distance::{self, Fault};
use crate::rover::{self, Mount, Terrain};
use crate::units::Time;

/// The rover of the manifest and what is around it.
#[derive(Clone, Debug, PartialEq)]
pub struct RowSetting {
    /// The robot.
    pub rover: rover::Parameters,
    /// Where its sensor on the right is mounted; the one on the left is its mirror image.
    pub mount: Mount,
    /// The rows.
    pub row: Row,
    /// The ground.
    pub terrain: Terrain,
    /// Both distance sensors.
    pub distance: distance::Parameters,
}

/// The rows beside the line of a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct CropSetting {
    /// The rows.
    pub row: Row,
    /// Where the row begins, metres north and east, and its direction there, radians clockwise from
    /// north.
    pub origin: (f64, f64, f64),
    /// Width of the machine, metres.
    pub width: f64,
    /// Where its sensor on the right is mounted, against the rear axle; the one on the left is its
    /// mirror image.
    pub mount: Mount,
    /// Both distance sensors.
    pub distance: distance::Parameters,
}

/// The rows of a machine from the tables of a file; `None` without any. They stand there whether or not
/// the machine is guided by them.
pub(super) fn crop(
    vehicle: &Vehicle,
    line: Option<&Line>,
    row: &mut Option<Row>,
    distance: &mut Option<distance::Parameters>,
) -> Option<CropSetting> {
    let guidance = vehicle.manifest().row_guidance.as_ref()?;
    let (mut row, line) = row.take().zip(line)?;
    row.complete(&guidance.rows);
    let (direction, place) = (line.direction(), &row.place);
    let (along, right) = (place.along.get(), place.right.get());
    let (sine, cosine) = (libm::sin(direction), libm::cos(direction));
    Some(CropSetting {
        origin: (
            line.from.north.get() + along * cosine - right * sine,
            line.from.east.get() + along * sine + right * cosine,
            direction + place.heading.get(),
        ),
        row,
        width: guidance.vehicle_width.get(),
        mount: crate::crop::mount(&guidance.sensors),
        distance: distance.take().unwrap_or_default(),
    })
}

impl CropSetting {
    /// Returns the first value out of its range.
    pub(super) fn check(&self) -> Result<(), String> {
        self.row.check_place()?;
        self.row.check(&Limits {
            // It does not start in the row.
            length: 0.0,
            width: self.width,
            sensor_beside: self.mount.right.abs(),
            beam: self.mount.yaw.abs(),
            range: distance::FARTHEST,
        })?;
        self.distance.check()
    }
}

/// The setting of a vehicle's rover from the tables of a file; `None` for a vehicle without one.
pub(super) fn setting(
    vehicle: &Vehicle,
    row: Option<Row>,
    terrain: Option<Terrain>,
    distance: Option<distance::Parameters>,
) -> Result<Option<RowSetting>, String> {
    let Some(rover) = &vehicle.manifest().rover else {
        let tables = [
            ("row", row.is_some()),
            ("terrain", terrain.is_some()),
            ("distance", distance.is_some()),
        ];
        return match tables.iter().find(|(_, given)| *given) {
            Some((table, _)) => Err(without(vehicle, table, "a rover")),
            None => Ok(None),
        };
    };
    let mut row = row.ok_or_else(|| {
        format!(
            "row: vehicle {:?} drives along a row, which needs at least one [[row.section]] with \
             its kind (barriers, poles or stalks) and its length",
            vehicle.name()
        )
    })?;
    row.complete(&rover.rows);
    Ok(Some(RowSetting {
        rover: rover::Parameters::of(rover),
        mount: Mount::of(rover),
        row,
        terrain: terrain.unwrap_or_default(),
        distance: distance.unwrap_or_default(),
    }))
}

impl RowSetting {
    /// Returns the first value out of its range.
    pub(super) fn check(&self) -> Result<(), String> {
        if self.row.place != RowPlace::default() {
            return Err("row.place: a rover stands in its row: [row.start] says where".into());
        }
        self.row.check(&Limits::of(&self.rover, &self.mount))?;
        self.terrain.check()?;
        self.distance.check()
    }
}

/// A distance sensor or its line is faulty for a time.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DistanceFault {
    /// On which side of the robot the sensor is mounted; it looks at the other one. Default both.
    #[serde(default)]
    pub side: Side,
    /// What is wrong.
    pub fault: Fault,
    /// When it begins.
    pub at: Time,
    /// When it ends; it lasts to the end of the run if left out.
    pub until: Option<Time>,
}

impl DistanceFault {
    /// The sensors that it concerns.
    pub(crate) fn sides(&self) -> impl Iterator<Item = rover::Side> + use<> {
        let side = self.side;
        let sides = [
            (Side::Left, rover::Side::Left),
            (Side::Right, rover::Side::Right),
        ];
        sides
            .into_iter()
            .filter(move |(one, _)| side.includes(*one))
            .map(|(_, side)| side)
    }

    /// Whether a sensor has this fault and the other one at the same time.
    fn overlaps(&self, other: &Self) -> bool {
        let end = |fault: &Self| fault.until.map_or(f64::INFINITY, Time::get);
        let both = self
            .sides()
            .any(|side| other.sides().any(|one| one == side));
        both && self.at.get() < end(other) && other.at.get() < end(self)
    }
}

/// Returns the first mistake in the faults of distance sensors.
pub(super) fn faults(faults: &[DistanceFault]) -> Result<(), String> {
    for (i, fault) in faults.iter().enumerate() {
        let field = format!("distance_fault[{i}]");
        within(&format!("{field}.at"), fault.at, super::check::times())?;
        later(&field, fault.at, fault.until)?;
        if let Some(k) = faults[..i].iter().position(|other| other.overlaps(fault)) {
            return Err(format!(
                "{field} and distance_fault[{k}] of one sensor overlap: a fault begins when the \
                 one before has ended, or later"
            ));
        }
    }
    Ok(())
}
