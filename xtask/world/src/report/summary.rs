//! The figures of a run, as `summary.json` holds them.

use serde::Serialize;

use super::figures::{AutonomousRun, BusFigures, ModeFigures, StopFigures, TaskFigures, rounded};
use super::{CropFigures, RoverFigures, Run, bus, guidance};
use crate::time::{seconds, span_seconds};

/// The figures of a run. The fields' names and meanings are those of `summary.json`; units are
/// part of the names because JSON has no types for them. A figure that does not exist, such as
/// the settling time of a run that never settles, is `null`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Name of the scenario.
    pub scenario: String,
    /// Seed of the run.
    pub seed: u64,
    /// Simulated time.
    pub simulated_seconds: f64,
    /// One entry for each time that the vehicle drove autonomously.
    pub autonomous_runs: Vec<AutonomousRun>,
    /// Distance driven by the point on the centre line beside the antenna.
    pub distance_m: f64,
    /// Largest speed of the wheels in either direction.
    pub largest_speed_m_s: f64,
    /// Largest steering angle to either side.
    pub largest_steering_angle_deg: f64,
    /// One entry for each node reset and each loss of the fix in the scenario.
    pub stops: Vec<StopFigures>,
    /// How a rover drove along its row; left out for vehicles without one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rover: Option<RoverFigures>,
    /// How a machine drove between the rows of a crop; left out without rows.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub crop: Option<CropFigures>,
    /// The vehicle's modes.
    pub modes: Vec<ModeFigures>,
    /// The bus.
    pub bus: BusFigures,
    /// The nodes' tasks.
    pub tasks: Vec<TaskFigures>,
}

impl Summary {
    /// The figures of `run`.
    #[must_use]
    pub fn of(run: &Run) -> Self {
        let largest = |part: fn(&crate::StateSample) -> f64| {
            run.states
                .iter()
                .map(|state| part(state).abs())
                .fold(0.0, f64::max)
        };
        let steps = run.states.windows(2);
        let distance: f64 = steps
            .map(|pair| libm::hypot(pair[1].north - pair[0].north, pair[1].east - pair[0].east))
            .sum();
        Self {
            scenario: run.scenario.name.clone(),
            seed: run.seed,
            simulated_seconds: rounded(span_seconds(run.duration), 6),
            autonomous_runs: guidance::autonomous_runs(run),
            distance_m: rounded(distance, 3),
            largest_speed_m_s: rounded(largest(|state| state.speed), 4),
            largest_steering_angle_deg: rounded(largest(|state| state.steering).to_degrees(), 3),
            stops: guidance::stops(run),
            rover: run.rover.as_ref().map(RoverFigures::of),
            crop: run.crop.as_ref().map(CropFigures::of),
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
