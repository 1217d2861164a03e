//! Scenarios: the events around the nodes in a run, as a TOML file.
//!
//! Quantities are strings with a unit (`"1 m/s"`). A missing table or field takes its default; an
//! unknown field is an error. [`Scenario::find`] takes the name of a scenario in the vehicle's
//! folder or the path of a file. Times count from the start of the run, when the power comes on.
//! `SCENARIOS.md` beside this crate's manifest describes the format.

pub(crate) mod check;
mod error;
mod events;
mod expect;
mod file;
mod happening;
mod rover;
mod row;

use std::collections::BTreeSet;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use vehicle_model::{Overrides, Remote, Vehicle};

pub use error::ScenarioError;
pub use events::{
    Babble, BrownOut, BusEvent, Button, ButtonPress, ClockChange, JoystickMove, KnobTurn,
    RelayFault, ResetEvent, StopLoopChange, SupplyChange, WireNoise,
};
pub use expect::{Expectation, Figure};
use file::File;
pub use rover::{CropSetting, DistanceFault, RowSetting};
pub use row::{
    Bend, Gap, Kind, Leaves, Limits, Row, RowPlace, RowStart, Section, Side, Turn, Weed, Weeds,
};

use crate::changes::changes;
use crate::receiver::{self, FixChange, InertialChange, StreamFault};
use crate::units::{Angle, Drift, Length, Ppm, Speed, Time};
use crate::vehicle;

/// Simulated times that a run may take, s: from a millisecond, in which a frame fits, to a day.
pub const DURATIONS: RangeInclusive<f64> = 0.001..=86_400.0;

/// The surroundings of a run. A scenario belongs to one vehicle: fields that its file leaves out
/// come from that vehicle's manifest, and its nodes are indices into that manifest.
#[derive(Clone, Debug, PartialEq)]
pub struct Scenario {
    /// Name in reports: the file's stem.
    pub name: String,
    /// One line on what the scenario shows.
    pub summary: String,
    /// Values in place of those of the vehicle's manifest, for the images and the vehicle of this
    /// scenario. Default: none.
    pub set: Overrides,
    /// Length of the run unless the caller asks for another, within [`DURATIONS`].
    /// Default 60 s.
    pub duration: Time,
    /// Pose at the start.
    pub start: Start,
    /// The line from which the report computes cross-track errors. By default it runs from the
    /// first to the last of the manifest's waypoints. `None` without a machine.
    pub line: Option<Line>,
    /// The machine; `None` when the vehicle has none.
    pub vehicle: Option<vehicle::Parameters>,
    /// The ground.
    pub ground: vehicle::Ground,
    /// The receiver; `None` when none is wired.
    pub receiver: Option<receiver::Parameters>,
    /// Whether all nodes have a key, the same one, which is made from the seed. Default false.
    pub key: bool,
    /// The display.
    pub lcd: Lcd,
    /// The remote control's receiver.
    pub remote: Receiver,
    /// The nodes' clocks, in the order of the manifest's nodes.
    pub nodes: Vec<Clock>,
    /// Changes of the receiver's fix.
    pub fix: Vec<FixChange>,
    /// Changes of what the receiver's inertial sensor tells.
    pub inertial: Vec<InertialChange>,
    /// Damage to the receiver's byte stream.
    pub stream: Vec<StreamFault>,
    /// Presses of buttons.
    pub press: Vec<ButtonPress>,
    /// The supply of the remote control's receiver fails or returns.
    pub supply: Vec<SupplyChange>,
    /// Movements of the joystick.
    pub joystick: Vec<JoystickMove>,
    /// Turns of knobs.
    pub knob: Vec<KnobTurn>,
    /// The emergency-stop loop opens and closes.
    pub stop_loop: Vec<StopLoopChange>,
    /// Nodes held in reset.
    pub reset: Vec<ResetEvent>,
    /// The 8 MHz clocks of nodes stop and come.
    pub clock: Vec<ClockChange>,
    /// Dips of the nodes' supplies.
    pub brownout: Vec<BrownOut>,
    /// Noise on the lines to motor drivers.
    pub wire: Vec<WireNoise>,
    /// Relays of motors that stick.
    pub relay: Vec<RelayFault>,
    /// Nodes that babble.
    pub babble: Vec<Babble>,
    /// Foreign frames and disturbances on the bus.
    pub bus: Vec<BusEvent>,
    /// The rover and its row; `None` when the vehicle has no rover.
    pub row: Option<RowSetting>,
    /// The rows beside the line of a machine; `None` without any.
    pub crop: Option<CropSetting>,
    /// Faults of the distance sensors.
    pub distance_fault: Vec<DistanceFault>,
    /// What the run must show.
    pub expect: Vec<Expectation>,
}

/// Pose of the vehicle at the start of the run. By default the vehicle is at rest at the start of
/// its line and points along it.
#[derive(Clone, Debug, PartialEq)]
pub struct Start {
    /// Northing of the point of the centre line beside the antenna, -10 to 10 km.
    pub north: Length,
    /// Easting of the same point, -10 to 10 km.
    pub east: Length,
    /// Heading of the body, clockwise from north, -360 to 360 deg.
    pub heading: Angle,
    /// Steering angle, within the vehicle's steering limit.
    pub steering: Angle,
    /// Forward speed, 0 to the vehicle's top speed.
    pub speed: Speed,
}

changes! {
    /// Start values that the scenario sets.
    struct StartChanges of Start {
        north: Length,
        east: Length,
        heading: Angle,
        steering: Angle,
        speed: Speed,
    } optional {
    }
}

impl Start {
    /// At rest at the start of a line; without a line at the base station, heading north.
    fn of(line: Option<&Line>) -> Self {
        let from = line.map(|line| line.from);
        let zero = Length::new(0.0);
        Self {
            north: from.map_or(zero, |from| from.north),
            east: from.map_or(zero, |from| from.east),
            heading: Angle::new(line.map_or(0.0, Line::direction)),
            steering: Angle::new(0.0),
            speed: Speed::new(0.0),
        }
    }
}

/// A point in the base station's frame.
#[derive(Copy, Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Point {
    /// Northing, -10 to 10 km.
    pub north: Length,
    /// Easting, -10 to 10 km.
    pub east: Length,
}

/// The line from one waypoint to the next. It must be the line that the images contain.
#[derive(Copy, Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// First waypoint.
    pub from: Point,
    /// Second waypoint, at least 1 m from the first.
    pub to: Point,
}

impl Line {
    /// Length, metres.
    #[must_use]
    pub fn length(&self) -> f64 {
        libm::hypot(
            self.to.north.get() - self.from.north.get(),
            self.to.east.get() - self.from.east.get(),
        )
    }

    /// Direction, radians clockwise from north.
    #[must_use]
    pub fn direction(&self) -> f64 {
        libm::atan2(
            self.to.east.get() - self.from.east.get(),
            self.to.north.get() - self.from.north.get(),
        )
    }

    /// Distance along the line and cross-track error of a point, both in metres; the error is
    /// positive to the right of the line.
    #[must_use]
    pub fn locate(&self, north: f64, east: f64) -> (f64, f64) {
        let (dn, de) = (north - self.from.north.get(), east - self.from.east.get());
        let (un, ue) = (libm::cos(self.direction()), libm::sin(self.direction()));
        (dn * un + de * ue, de * un - dn * ue)
    }
}

/// The display.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Lcd {
    /// Whether it answers. Default true.
    pub acknowledges: bool,
    /// Time to execute a byte, 0 to 100 ms. Default 100 us.
    pub delay: Time,
}

impl Default for Lcd {
    fn default() -> Self {
        Self {
            acknowledges: true,
            delay: Time::new(100e-6),
        }
    }
}

/// The remote control's receiver.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Receiver {
    /// How it shows a press; the manifest's kind if left out.
    #[serde(rename = "type")]
    pub kind: Option<Remote>,
    /// How long an output of a toggle or latched receiver bounces when it changes, 0 to 50 ms.
    /// Default 0 ms.
    pub bounce: Time,
}

impl Default for Receiver {
    fn default() -> Self {
        Self {
            kind: None,
            bounce: Time::new(0.0),
        }
    }
}

/// Largest error of an internal oscillator, ppm.
pub(crate) const LARGEST_ERROR: f64 = 50_000.0;

/// Clock of a node.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Clock {
    /// Error of the 8 MHz clock, -100 to 100 ppm; random within 50 ppm if left out.
    pub crystal: Option<Ppm>,
    /// Error of the part's internal oscillator as it leaves the factory, -50000 to 50000 ppm;
    /// random within 10000 ppm if left out (data sheets of both parts: 1 % at 25 degrees Celsius,
    /// up to 5 % over all temperatures).
    pub internal: Option<Ppm>,
    /// How that error changes during the run, -5000 to 5000 ppm/s, up to 5 %. Default 0 ppm/s.
    pub drift: Drift,
    /// Whether the 8 MHz clock is there at the start. Default true.
    pub external: bool,
}

impl Default for Clock {
    fn default() -> Self {
        Self {
            crystal: None,
            internal: None,
            drift: Drift::new(0.0),
            external: true,
        }
    }
}

/// A scenario of a vehicle's folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Listed {
    /// Its name.
    pub name: String,
    /// What it shows, in one line; or what is wrong with its file.
    pub summary: Result<String, ScenarioError>,
}

/// The folder of scenarios in a vehicle's folder.
const SCENARIOS: &str = "scenarios";

/// The folders of a vehicle's scenarios. A variant has its own before those of the other vehicle.
fn folders(vehicle: &Vehicle) -> Vec<PathBuf> {
    let mut all = vec![vehicle.folder(), vehicle.crate_folder()];
    all.dedup();
    all.into_iter()
        .map(|folder| folder.join(SCENARIOS))
        .collect()
}

/// Names of the scenario files in a folder, and of the folders in it.
fn contents(folder: &Path) -> (Vec<String>, Vec<String>) {
    // A vehicle without the folder has no scenarios.
    let entries = std::fs::read_dir(folder).into_iter().flatten();
    let paths = entries.flatten().map(|entry| entry.path());
    let (folders, files): (Vec<PathBuf>, Vec<PathBuf>) = paths.partition(|path| path.is_dir());
    let toml = files
        .iter()
        .filter(|file| file.extension().is_some_and(|kind| kind == "toml"));
    let name = |name: Option<&std::ffi::OsStr>| Some(name?.to_str()?.to_owned());
    let mut files: Vec<String> = toml.filter_map(|file| name(file.file_stem())).collect();
    let mut folders: Vec<String> = folders
        .iter()
        .filter_map(|folder| name(folder.file_name()))
        .collect();
    files.sort();
    folders.sort();
    (files, folders)
}

/// Names to choose from instead of a name that the vehicle does not have: its scenarios that are in no folder, and
/// those of that name in folders.
fn beside(vehicle: &Vehicle, name: &str) -> Vec<String> {
    let in_folder = format!("/{name}");
    let mut all = names(vehicle);
    all.retain(|one| !one.contains('/') || one.ends_with(&in_folder));
    // What was probably meant comes first.
    all.sort_by_key(|one| !one.contains('/'));
    all
}

/// Names of the vehicle's scenarios, in alphabetical order, those in folders behind the others.
fn names(vehicle: &Vehicle) -> Vec<String> {
    let (mut names, mut inside) = (BTreeSet::new(), BTreeSet::new());
    for all in folders(vehicle) {
        let (files, folders) = contents(&all);
        names.extend(files);
        for folder in folders {
            let (files, _) = contents(&all.join(&folder));
            inside.extend(files.into_iter().map(|file| (folder.clone(), file)));
        }
    }
    let inside = inside.into_iter();
    let inside = inside.map(|(folder, file)| format!("{folder}/{file}"));
    names.into_iter().chain(inside).collect()
}

/// The scenarios in folders that [`beside`] does not name.
fn inside(vehicle: &Vehicle, name: &str) -> Vec<String> {
    let told = beside(vehicle, name);
    let mut inside = names(vehicle);
    inside.retain(|one| one.contains('/') && !told.contains(one));
    inside
}

/// Names of the other vehicles beside this one that have a scenario of this name.
fn others(vehicle: &Vehicle, name: &str) -> Vec<String> {
    let Some(vehicles) = vehicle.crate_folder().parent() else {
        return Vec::new();
    };
    // A folder that cannot be read has none.
    let mut others = Vehicle::folders(vehicles).unwrap_or_default();
    let file = format!("{name}.toml");
    others.retain(|_, folder| folder.join(SCENARIOS).join(&file).is_file());
    others.into_keys().collect()
}

impl Scenario {
    /// The scenarios in the vehicle's folder, in alphabetical order, and behind them those in folders in
    /// it. A file that is wrong does not hide the others. A variant has those of the other vehicle that
    /// fit it.
    #[must_use]
    pub fn list(vehicle: &Vehicle) -> Vec<Listed> {
        let read = |name: String| {
            let summary = Self::find(vehicle, &name).map(|scenario| scenario.summary);
            Listed { name, summary }
        };
        let own = vehicle.folder().join(SCENARIOS);
        let is_own = |name: &str| own.join(format!("{name}.toml")).is_file();
        let mut all: Vec<Listed> = names(vehicle).into_iter().map(read).collect();
        all.retain(|listed| listed.summary.is_ok() || is_own(&listed.name));
        all
    }

    /// The vehicle's scenario of that name, or else the file with that path. A name such as
    /// `thesis-7/loaded` stands for a scenario in a folder of the vehicle's scenarios.
    ///
    /// # Errors
    /// When there is neither, or the file does not describe a scenario.
    pub fn find(vehicle: &Vehicle, name: &str) -> Result<Self, ScenarioError> {
        let own = folders(vehicle).into_iter();
        let own = own.map(|folder| folder.join(format!("{name}.toml")));
        let own = own.into_iter().find(|own| own.is_file());
        let path = own.clone().unwrap_or_else(|| name.into());
        let looks_like_a_path =
            path.extension().is_some() || path.components().count() > 1 || path.exists();
        if !looks_like_a_path {
            return Err(ScenarioError::unknown(
                name,
                vehicle.name(),
                &beside(vehicle, name),
                &inside(vehicle, name),
                &others(vehicle, name),
            ));
        }
        let text = std::fs::read_to_string(&path)
            .map_err(|error| ScenarioError::unreadable(name, &error))?;
        let stem = path
            .file_stem()
            .map_or(name.into(), |stem| stem.to_string_lossy());
        Self::parse(vehicle, &stem, name, &text)
    }

    /// A scenario in which nothing happens, with the default duration: the vehicle of the manifest at
    /// rest at the beginning of its line. A rover stands at the beginning of a straight row of bare
    /// poles that is 100 m long.
    ///
    /// # Panics
    /// Never: such a scenario is one of every vehicle.
    #[must_use]
    pub fn uneventful(vehicle: &Vehicle, name: &str) -> Self {
        let text = match vehicle.manifest().rover {
            Some(_) => "[[row.section]]\nkind = \"poles\"\nlength = \"100 m\"\n",
            None => "",
        };
        Self::parse(vehicle, name, name, text).expect("a scenario without events")
    }

    /// When the things that happen begin, each with its table, such as `press[0]`.
    #[must_use]
    pub fn beginnings(&self) -> Vec<(String, Time)> {
        let happenings = self.happenings(&|_| String::new());
        happenings.into_iter().map(|it| (it.table, it.at)).collect()
    }

    /// Parses a scenario of a vehicle from TOML. Reports use `name` for the scenario, error
    /// messages use `place`.
    ///
    /// # Errors
    /// A sentence that names the field and what it accepts.
    pub fn parse(
        vehicle: &Vehicle,
        name: &str,
        place: &str,
        text: &str,
    ) -> Result<Self, ScenarioError> {
        let syntax = toml::Deserializer::parse(text)
            .map_err(|error| ScenarioError::syntax(place, text, &error))?;
        let file: File = serde_path_to_error::deserialize(syntax)
            .map_err(|error| ScenarioError::field(place, text, &error))?;
        let wrong = |problem: String| ScenarioError::value(place, &problem);
        let scenario = file.complete(vehicle, name).map_err(wrong)?;
        check::check(&scenario, vehicle).map_err(wrong)?;
        Ok(scenario)
    }
}
