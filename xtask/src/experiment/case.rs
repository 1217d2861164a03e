//! The experiments, their cases and their aims.

use control::dubins::{Pose, shortest_to_line};
use vehicle_model::Vehicle;
use world::Scenario;

use super::Error;

/// Several scenarios, each run over many seeds and judged by aims.
pub struct Experiment {
    /// Its name on the command line.
    pub name: &'static str,
    /// Its cases.
    pub cases: &'static [Case],
}

/// A scenario of an experiment.
pub struct Case {
    /// Its name: the scenario file's stem.
    pub name: &'static str,
    /// Mean cross-track error in steady state that the thesis reports, cm.
    pub thesis_mean_cm: Option<f64>,
    /// Time until steady state that the thesis reports, s.
    pub thesis_settling_seconds: Option<f64>,
    /// How soon the vehicle shall be on the line.
    pub settling: Settling,
    /// Whether the scenario is fitted to the thesis's machine: its law shall have the thesis's figures
    /// there, within [`FIT_CM`] and [`FIT_SECONDS`].
    pub fitted: bool,
}

/// How soon the vehicle shall be on the line.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Settling {
    /// Within this number of seconds.
    Within(f64),
    /// Within this multiple of the time that the shortest path takes.
    Shortest(f64),
}

/// Largest mean of the cross-track error, either side, cm.
pub const LARGEST_MEAN_CM: f64 = 0.5;
/// Largest standard deviation of the cross-track error, cm.
pub const LARGEST_DEVIATION_CM: f64 = 1.8;
/// Most crossings of the whole settling band. One is an overshoot, which is accepted; a
/// second one is an oscillation.
pub const MOST_SWINGS: usize = 1;
/// The plain law must change the sign of its command at least this many times as often.
pub const FEWER_SIGN_CHANGES: f64 = 10.0;

/// Largest difference of the plain law's mean error from that of the thesis, cm.
pub const FIT_CM: f64 = 1.0;
/// Largest difference of the time until the plain law's error stays about its mean from the settling
/// time of the thesis, s.
pub const FIT_SECONDS: f64 = 2.0;

macro_rules! case {
    ($name:literal, $mean:expr, $settling:expr, $aim:expr) => {
        case!($name, $mean, $settling, $aim, false)
    };
    ($name:literal, $mean:expr, $settling:expr, $aim:expr, $fitted:expr) => {
        Case {
            name: $name,
            thesis_mean_cm: $mean,
            thesis_settling_seconds: $settling,
            settling: $aim,
            fitted: $fitted,
        }
    };
}

/// All experiments.
pub const ALL: &[Experiment] = &[THESIS_7, THESIS_MACHINE];

/// The track tests on the machine that the thesis's text describes: its law alone makes the difference.
const THESIS_7: Experiment = Experiment {
    name: "thesis-7",
    cases: &[
        case!(
            "one-metre-off",
            Some(-2.7),
            Some(15.0),
            Settling::Within(6.0)
        ),
        case!("five-metres-off-45", None, None, Settling::Shortest(1.15)),
        case!("five-metres-off-90", None, None, Settling::Shortest(1.15)),
        case!(
            "five-metres-off-135",
            Some(-4.4),
            Some(15.0),
            Settling::Shortest(1.15)
        ),
        case!("loaded", Some(1.0), None, Settling::Within(6.0)),
    ],
};

/// The same on a machine with errors such that the thesis's law has the thesis's figures.
const THESIS_MACHINE: Experiment = Experiment {
    name: "thesis-machine",
    cases: &[
        case!(
            "one-metre-off",
            Some(-2.7),
            Some(15.0),
            Settling::Within(6.0),
            true
        ),
        case!(
            "five-metres-off",
            Some(-4.4),
            Some(15.0),
            Settling::Shortest(1.15),
            true
        ),
        case!("loaded", Some(1.0), None, Settling::Within(6.0), true),
    ],
};

impl Experiment {
    /// The experiment of that name.
    ///
    /// # Errors
    ///
    /// There is none; the sentence names those that there are.
    pub fn find(name: &str) -> Result<&'static Self, Error> {
        ALL.iter()
            .find(|experiment| experiment.name == name)
            .ok_or_else(|| Error::Unknown { name: name.into() })
    }
}

impl Case {
    /// The name of the case's scenario: its file stands in a folder with the experiment's name.
    #[must_use]
    pub fn path(&self, experiment: &str) -> String {
        format!("{experiment}/{}", self.name)
    }
}

/// Time that the shortest path from the start of a scenario onto its line takes at cruise speed,
/// s. The path is that of the rear axle, whose smallest turning radius follows from the steering
/// limit.
///
/// # Errors
///
/// The vehicle has no machine, or one that cannot turn.
pub fn shortest_seconds(of: &Vehicle, scenario: &Scenario) -> Result<f64, Error> {
    let name = &scenario.name;
    let machine = of.manifest().machine.as_ref();
    let (Some(vehicle), Some(line), Some(machine)) = (&scenario.vehicle, &scenario.line, machine)
    else {
        return Err(Error::NoMachine {
            scenario: name.clone(),
        });
    };
    let heading = scenario.start.heading.get() - line.direction();
    let (along, cross_track) = line.locate(scenario.start.north.get(), scenario.start.east.get());
    let ahead = vehicle.rear_to_antenna.get();
    let start = Pose {
        north: along - ahead * heading.cos(),
        east: cross_track - ahead * heading.sin(),
        heading,
    };
    let radius = vehicle.wheelbase() / vehicle.steering_limit.get().tan();
    let path = shortest_to_line(start, radius).map_err(|error| Error::NoPath {
        scenario: name.clone(),
        error,
    })?;
    Ok(path.length() / machine.cruise.get())
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_PI_2, PI};

    use super::*;
    use crate::Failure;

    fn uagv() -> Vehicle {
        let workspace = crate::Workspace::find().unwrap();
        crate::vehicle::find(&workspace, "uagv").unwrap()
    }

    #[test]
    fn every_case_is_a_scenario() {
        for experiment in ALL {
            for case in experiment.cases {
                let scenario = Scenario::find(&uagv(), &case.path(experiment.name)).unwrap();
                assert_eq!(scenario.name, case.name);
                assert!(!scenario.summary.is_empty());
            }
        }
    }

    #[test]
    fn the_help_names_every_experiment() {
        let line = ["xtask", "sim", "--help"].map(std::ffi::OsString::from);
        let Ok(crate::cli::Request::Show(help)) = crate::cli::parse(line) else {
            panic!("no help");
        };
        let all = ALL.iter().map(|experiment| experiment.name);
        for name in all.chain(super::super::OTHERS.map(|(name, _)| name)) {
            assert!(help.contains(name), "{name}");
        }
        assert!(help.contains(super::super::row_limits::NAME));
    }

    #[test]
    fn an_unknown_experiment_is_refused_in_one_sentence() {
        let failure = Experiment::find("thesis-8").err().unwrap();
        let text = failure.to_string();
        assert_eq!(Failure::from(failure).exit_code(), 2);
        assert!(
            text.contains("thesis-8") && text.contains("thesis-7"),
            "{text}"
        );
    }

    /// The rear axle is 5 m - 0.255 m to the right and faces away from the line: half a
    /// circle to the left takes it 2 R nearer, then straight, then a quarter to the right
    /// from R before the line.
    #[test]
    fn the_shortest_path_from_facing_away_is_two_arcs_and_a_straight() {
        let text = "[start]\neast = \"5 m\"\nheading = \"90 deg\"\n";
        let scenario = Scenario::parse(&uagv(), "t", "t", text).unwrap();
        let radius = 1.1 / 25_f64.to_radians().tan();
        // Facing east the arc to the left ends facing west, as far east as it began.
        let straight = 5.0 - 0.255 - radius;
        let length = PI * radius + straight + FRAC_PI_2 * radius;
        let seconds = shortest_seconds(&uagv(), &scenario).unwrap();
        assert!((seconds - length).abs() < 1e-3, "{seconds} {length}");
    }
}
