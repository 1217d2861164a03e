//! The figures of a run, as `summary.json` holds them.

use serde::Serialize;

use super::figures::{AutonomousRun, BusFigures, ModeFigures, StopFigures, TaskFigures, rounded};
use super::{CropFigures, ExpectationFigures, MissionFigures, RoverFigures, Run, bus, guidance};
use crate::time::{seconds, span_seconds};

/// The figures of a run. The fields' names and meanings are those of `summary.json`; units are
/// part of the names because JSON has no types for them. A figure that does not exist, such as
/// the settling time of a run that never settles, is `null`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the scenario.
    pub scenario: String,
    /// Values in place of those of the vehicle's manifest, as `KEY=VALUE` with a semicolon between two.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub set: String,
    /// Seed of the run.
    pub seed: u64,
    /// Simulated time.
    pub simulated_seconds: f64,
    /// One entry for each time that the vehicle drove autonomously.
    pub autonomous_runs: Vec<AutonomousRun>,
    /// Distance driven by the point on the centre line beside the antenna, or by a rover's middle; `null`
    /// without either.
    pub distance_m: Option<f64>,
    /// Largest speed of the wheels in either direction, or of a rover's middle; `null` without either.
    pub largest_speed_m_s: Option<f64>,
    /// Largest steering angle to either side; `null` for what has no steering.
    pub largest_steering_angle_deg: Option<f64>,
    /// One entry for each node reset and each loss of the fix in the scenario.
    pub stops: Vec<StopFigures>,
    /// How a rover drove along its row; left out for vehicles without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rover: Option<RoverFigures>,
    /// How a machine drove between the rows of a crop; left out without rows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crop: Option<CropFigures>,
    /// How a mission was driven; left out without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mission: Option<MissionFigures>,
    /// The vehicle's modes.
    pub modes: Vec<ModeFigures>,
    /// The bus.
    pub bus: BusFigures,
    /// The nodes' tasks.
    pub tasks: Vec<TaskFigures>,
    /// What the scenario expects, and whether the run shows it; left out if it expects nothing.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub expectations: Vec<ExpectationFigures>,
    /// What makes the run questionable, in sentences; left out without any.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// How a vehicle moved, be it a machine or a rover.
struct Motion {
    /// Way, metres.
    distance: f64,
    /// Largest speed in either direction, metres per second.
    largest_speed: f64,
}

impl Motion {
    /// That of a run; `None` if nothing was there to move.
    fn of(run: &Run) -> Option<Self> {
        match &run.rover {
            Some(rover) => {
                let states = rover.drive.samples().iter().map(|sample| sample.state);
                Self::along(states.map(|state| ((state.x, state.y), state.speed)))
            }
            None => {
                let states = run.states.iter();
                Self::along(states.map(|state| ((state.north, state.east), state.speed)))
            }
        }
    }

    /// That of a way through places, with the speed at each.
    fn along(states: impl Iterator<Item = ((f64, f64), f64)>) -> Option<Self> {
        let mut before = None;
        let mut motion = None;
        for (place, speed) in states {
            let (x, y) = before.replace(place).unwrap_or(place);
            let motion = motion.get_or_insert(Self {
                distance: 0.0,
                largest_speed: 0.0,
            });
            motion.distance += libm::hypot(place.0 - x, place.1 - y);
            motion.largest_speed = motion.largest_speed.max(speed.abs());
        }
        motion
    }
}

impl Summary {
    /// The figures of `run`, without those that the recordings alone do not tell: the nodes' agreement about the
    /// time, the expectations, and the notes.
    #[must_use]
    pub fn of(run: &Run) -> Self {
        let motion = Motion::of(run);
        let figure = |value: fn(&Motion) -> f64, digits| {
            motion.as_ref().map(|motion| rounded(value(motion), digits))
        };
        let states = run.states.iter();
        let steering = states.map(|state| state.steering.abs()).reduce(f64::max);
        Self {
            scenario: run.scenario.name.clone(),
            set: String::new(),
            seed: run.seed,
            simulated_seconds: rounded(span_seconds(run.duration), 6),
            autonomous_runs: guidance::autonomous_runs(run),
            distance_m: figure(|motion| motion.distance, 3),
            largest_speed_m_s: figure(|motion| motion.largest_speed, 4),
            largest_steering_angle_deg: steering.map(|angle| rounded(angle.to_degrees(), 3)),
            stops: guidance::stops(run),
            rover: run.rover.as_ref().map(RoverFigures::of),
            crop: run.crop.as_ref().map(CropFigures::of),
            mission: run
                .mission
                .as_ref()
                .map(|mission| MissionFigures::of(run, mission)),
            modes: run
                .modes
                .iter()
                .map(|change| ModeFigures {
                    at_seconds: rounded(seconds(change.at), 6),
                    mode: change.mode.clone(),
                })
                .collect(),
            bus: bus::figures(run),
            tasks: run
                .tasks
                .iter()
                .map(|task| TaskFigures {
                    node: task.node.clone(),
                    task: task.task.clone(),
                    runs: task.runs,
                    longest_cycles: task.longest_cycles,
                    longest_us: rounded(
                        task.longest_cycles as f64 / task.core_hz.max(1) as f64 * 1e6,
                        3,
                    ),
                })
                .collect(),
            expectations: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// The figures as indented JSON with a final line end.
    #[must_use]
    pub fn json(&self) -> String {
        let mut text = serde_json::to_string_pretty(self).unwrap_or_default();
        text.push('\n');
        text
    }
}
