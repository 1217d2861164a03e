//! The plan of a mission, and the file that it is kept in.
//!
//! A plan is a list of legs. The vehicle drives them in their order; how it gets from one to the next is up to the leg
//! ([`Join`]). The file is TOML; `MISSIONS.md` in the folder of this crate explains it. [`Plan::read`] accepts what
//! [`Plan::write`] writes, and gives the same plan to the last bit.

mod check;
mod file;

use std::fmt;

use crate::place::{Frame, Local, Origin};

pub use check::{
    FASTEST, GAP, LEAST_FENCE, LEAST_OBSTACLE, LONGEST_NAME, MOST_LEGS, MOST_POINTS, SHORTEST,
    WIDEST,
};

/// A mission: legs in driving order, inside a fence.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Name for people, 1 to [`LONGEST_NAME`] characters.
    pub name: String,
    /// Where the local frame is: the base station.
    pub origin: Origin,
    /// Working width of the implement, m, above 0 to 50, if it is known. The firmware needs none; a drive is judged with it.
    pub width: Option<f64>,
    /// Corners of the polygon that the vehicle must not leave, without the first one again at the end. Empty without a
    /// fence.
    pub fence: Vec<Local>,
    /// Polygons that the vehicle must stay out of, each without its first corner again at the end.
    pub obstacles: Vec<Vec<Local>>,
    /// The legs in driving order, at least one.
    pub legs: Vec<Leg>,
    /// Stop or repeat after the last leg.
    pub end: End,
}

/// A piece of a mission.
#[derive(Clone, Debug, PartialEq)]
pub struct Leg {
    /// Where it leads.
    pub shape: Shape,
    /// Speed, m/s, above 0 also when it is driven in reverse.
    pub speed: f64,
    /// True if the vehicle drives it backwards.
    pub reverse: bool,
    /// Sections of the implement that work on it.
    pub outputs: Outputs,
    /// How the vehicle comes here from the leg before.
    pub join: Join,
}

/// Where a leg leads.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A straight line.
    Line {
        /// Its beginning.
        from: Local,
        /// Its end.
        to: Local,
    },
    /// A curve through points, at least two. [`crate::curve::fit`] makes it drivable.
    Curve {
        /// The points in driving order.
        points: Vec<Local>,
    },
}

impl Shape {
    /// The points of the leg in driving order; a line has two.
    #[must_use]
    pub fn points(&self) -> Vec<Local> {
        match self {
            Self::Line { from, to } => vec![*from, *to],
            Self::Curve { points } => points.clone(),
        }
    }

    /// Where it begins and where it ends.
    #[must_use]
    pub fn ends(&self) -> (Local, Local) {
        match self {
            Self::Line { from, to } => (*from, *to),
            Self::Curve { points } => (
                points.first().copied().unwrap_or_default(),
                points.last().copied().unwrap_or_default(),
            ),
        }
    }

    /// Length along the points, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        let points = self.points();
        let pairs = points.iter().zip(points.iter().skip(1));
        pairs.map(|(from, to)| from.distance(*to)).sum()
    }
}

/// How a leg is reached from the leg before. For the first leg it says how it is reached from the last one, if the mission
/// repeats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Join {
    /// It begins where the leg before ends, in the same direction.
    Continue,
    /// By a turn that the vehicle plans.
    #[default]
    Turn,
}

/// What the vehicle does after the last leg.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum End {
    /// The vehicle stops.
    #[default]
    Stop,
    /// The first leg follows.
    Repeat,
}

/// Sections of the implement that are on, as bits: section 1 is the lowest of 8.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Outputs(pub u8);

impl Outputs {
    /// The sections with these numbers, 1 to 8; `None` if one is not.
    #[must_use]
    pub fn of(sections: &[u8]) -> Option<Self> {
        sections.iter().try_fold(Self(0), |outputs, section| {
            let bit = (1..=8).contains(section).then(|| 1 << (section - 1))?;
            Some(Self(outputs.0 | bit))
        })
    }

    /// The numbers of the sections that are on, 1 to 8, ascending.
    pub fn sections(self) -> impl Iterator<Item = u8> {
        (1..=8).filter(move |section| self.0 & 1 << (section - 1) != 0)
    }
}

impl Plan {
    /// The default mission of a vehicle: from waypoint to waypoint of its manifest at its cruise speed. `None` for one without a
    /// machine or waypoints.
    #[must_use]
    pub fn of_manifest(
        name: &str,
        origin: Origin,
        manifest: &vehicle_model::Manifest,
    ) -> Option<Self> {
        let speed = manifest.machine.as_ref()?.cruise.get();
        let waypoints = manifest.waypoints.iter();
        let places = waypoints.map(|point| Local::new(point.north.get(), point.east.get()));
        let places: Vec<Local> = places.collect();
        let legs = places.windows(2).map(|pair| Leg {
            shape: Shape::Line {
                from: pair[0],
                to: pair[1],
            },
            speed,
            reverse: false,
            outputs: Outputs(0),
            join: Join::Turn,
        });
        let legs: Vec<Leg> = legs.collect();
        (!legs.is_empty()).then(|| Self {
            name: name.to_owned(),
            origin,
            width: None,
            fence: Vec::new(),
            obstacles: Vec::new(),
            legs,
            end: End::Stop,
        })
    }

    /// The local frame of the plan.
    #[must_use]
    pub fn frame(&self) -> Frame {
        Frame::new(self.origin)
    }

    /// Length of all legs along their points, m, without the turns between them.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.legs.iter().map(|leg| leg.shape.length()).sum()
    }

    /// The plan in a file's text. `place` names the file in messages.
    ///
    /// # Errors
    /// One sentence that names the file, the line, the field and what is accepted.
    pub fn read(text: &str, place: &str) -> Result<Self, PlanError> {
        file::read(text, place)
    }

    /// The text of the plan's file.
    #[must_use]
    pub fn write(&self) -> String {
        file::write(self)
    }

    /// Checks the ranges of all values: names, coordinates, speeds, lengths and the numbers of legs and points; that legs
    /// which continue meet to [`GAP`]; that the fence is a simple polygon with all points of the legs in it, and the obstacles are simple polygons without any. It does not know the
    /// vehicle, so curvatures are not checked.
    ///
    /// # Errors
    /// The first problem.
    pub fn check(&self) -> Result<(), Problem> {
        check::check(self)
    }
}

/// A value of a plan that is not accepted.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    /// The leg, counted from zero, if it is one.
    pub leg: Option<usize>,
    /// The field and what it accepts, as `speed: -1 m/s is out of range, ...`.
    pub what: String,
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.leg {
            // People count from 1.
            Some(leg) => write!(f, "leg {}, {}", leg + 1, self.what),
            None => f.write_str(&self.what),
        }
    }
}

impl std::error::Error for Problem {}

/// Why a file is no plan. Displays as one sentence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{sentence}")]
pub struct PlanError {
    sentence: String,
}
