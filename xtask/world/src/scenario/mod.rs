//! Scenarios: what happens around the nodes in a run, as a TOML file.
//!
//! Quantities are strings with a unit (`"1 m/s"`); a missing table or field takes its default; an
//! unknown field is refused. [`Scenario::find`] takes the name of a built-in scenario or the path
//! of a file. Times are counted from the start of the run, when power comes on. `SCENARIOS.md`
//! beside this crate's manifest describes the format.

mod builtin;
mod check;
mod error;
mod events;

use std::path::Path;

use serde::Deserialize;

pub use builtin::Builtin;
pub use error::ScenarioError;
pub use events::{BusEvent, Button, ButtonPress, JoystickMove, ResetEvent, StopLoopChange};

use crate::node::Node;
use crate::receiver::{self, FixChange, StreamFault};
use crate::units::{Angle, Length, Ppm, Speed, Time};
use crate::vehicle;

/// A run's surroundings.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Scenario {
    /// Name in reports: the built-in's name or the file's stem.
    #[serde(skip)]
    pub name: String,
    /// One line on what the scenario shows.
    #[serde(default)]
    pub summary: String,
    /// Length of the run unless the caller asks for another, above 0 to 86400 s.
    /// Default 60 s.
    #[serde(default = "default_duration")]
    pub duration: Time,
    /// Pose at the start.
    #[serde(default)]
    pub start: Start,
    /// The line that the run is judged by.
    #[serde(default)]
    pub line: Line,
    /// The machine.
    #[serde(default)]
    pub vehicle: vehicle::Parameters,
    /// The ground.
    #[serde(default)]
    pub ground: vehicle::Ground,
    /// The receiver.
    #[serde(default)]
    pub receiver: receiver::Parameters,
    /// The display.
    #[serde(default)]
    pub lcd: Lcd,
    /// The nodes' clocks.
    #[serde(default)]
    pub nodes: Nodes,
    /// Changes of the receiver's fix.
    #[serde(default)]
    pub fix: Vec<FixChange>,
    /// Damage to the receiver's byte stream.
    #[serde(default)]
    pub stream: Vec<StreamFault>,
    /// Presses of buttons.
    #[serde(default)]
    pub press: Vec<ButtonPress>,
    /// Movements of the joystick.
    #[serde(default)]
    pub joystick: Vec<JoystickMove>,
    /// The emergency-stop loop opens and closes.
    #[serde(default)]
    pub stop_loop: Vec<StopLoopChange>,
    /// Nodes held in reset.
    #[serde(default)]
    pub reset: Vec<ResetEvent>,
    /// Foreign frames and disturbances on the bus.
    #[serde(default)]
    pub bus: Vec<BusEvent>,
}

fn default_duration() -> Time {
    Time::new(60.0)
}

/// Pose of the vehicle at the start of the run.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Start {
    /// Northing of the antenna, -10 to 10 km.
    pub north: Length,
    /// Easting of the antenna, -10 to 10 km.
    pub east: Length,
    /// Heading of the body, clockwise from north, -360 to 360 deg.
    pub heading: Angle,
    /// Steering angle, within the vehicle's steering limit.
    pub steering: Angle,
    /// Forward speed, 0 to the vehicle's top speed.
    pub speed: Speed,
}

impl Default for Start {
    fn default() -> Self {
        Self {
            north: Length::new(0.0),
            east: Length::new(0.0),
            heading: Angle::new(0.0),
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

/// The line from one waypoint to the next. It must be the one that the controller's image holds.
#[derive(Copy, Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Line {
    /// First waypoint.
    pub from: Point,
    /// Second waypoint, at least 1 m from the first.
    pub to: Point,
}

impl Default for Line {
    /// 243 m towards north, the length of the thesis's line (7.3).
    fn default() -> Self {
        let zero = Length::new(0.0);
        Self {
            from: Point {
                north: zero,
                east: zero,
            },
            to: Point {
                north: Length::new(243.0),
                east: zero,
            },
        }
    }
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

    /// Way along the line and cross-track error of a point, both metres; the error is positive
    /// right of the line.
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
    /// Whether it answers commands. Default true.
    pub acknowledges: bool,
    /// Time to execute a command, 0 to 100 ms. Default 100 us.
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

/// The nodes' clocks.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Nodes {
    /// Clock of the gps node.
    pub gps: Clock,
    /// Clock of the controller node.
    pub controller: Clock,
    /// Clock of the steering node.
    pub steering: Clock,
    /// Clock of the drive node.
    pub drive: Clock,
}

impl Nodes {
    /// The clock of `node`.
    #[must_use]
    pub const fn get(&self, node: Node) -> &Clock {
        match node {
            Node::Gps => &self.gps,
            Node::Controller => &self.controller,
            Node::Steering => &self.steering,
            Node::Drive => &self.drive,
        }
    }
}

/// Clock of a node.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Clock {
    /// Error of the 8 MHz clock, -100 to 100 ppm; drawn within 50 ppm when left out.
    pub crystal: Option<Ppm>,
    /// Error of the part's internal oscillator, -10000 to 10000 ppm (data sheets of both parts:
    /// 1 % at 25 degrees Celsius); drawn from the whole range when left out.
    pub internal: Option<Ppm>,
    /// Whether the 8 MHz clock is there at all. Default true.
    pub external: bool,
}

impl Default for Clock {
    fn default() -> Self {
        Self {
            crystal: None,
            internal: None,
            external: true,
        }
    }
}

impl Scenario {
    /// The scenarios that come with the program.
    #[must_use]
    pub const fn builtins() -> &'static [Builtin] {
        builtin::ALL
    }

    /// The built-in scenario of that name, or else the file of that path.
    ///
    /// # Errors
    /// When there is neither, or the file does not describe a scenario.
    pub fn find(name: &str) -> Result<Self, ScenarioError> {
        if let Some(builtin) = builtin::ALL.iter().find(|builtin| builtin.name == name) {
            return Self::parse(builtin.name, builtin.name, builtin.text);
        }
        let path = Path::new(name);
        let looks_like_a_path =
            path.extension().is_some() || path.components().count() > 1 || path.exists();
        if !looks_like_a_path {
            return Err(ScenarioError::unknown(name));
        }
        let text = std::fs::read_to_string(path)
            .map_err(|error| ScenarioError::unreadable(name, &error))?;
        let stem = path
            .file_stem()
            .map_or(name.into(), |stem| stem.to_string_lossy());
        Self::parse(&stem, name, &text)
    }

    /// Reads a scenario from TOML. `name` is what reports call it, `place` what errors call it.
    ///
    /// # Errors
    /// A sentence that names the field and what it accepts.
    pub fn parse(name: &str, place: &str, text: &str) -> Result<Self, ScenarioError> {
        let syntax = toml::Deserializer::parse(text)
            .map_err(|error| ScenarioError::syntax(place, text, &error))?;
        let mut scenario: Self = serde_path_to_error::deserialize(syntax)
            .map_err(|error| ScenarioError::field(place, text, &error))?;
        name.clone_into(&mut scenario.name);
        check::check(&scenario).map_err(|problem| ScenarioError::value(place, &problem))?;
        Ok(scenario)
    }
}
