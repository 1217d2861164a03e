//! The runs from which the figures are drawn.

use std::{collections::BTreeMap, fmt::Write as _};

use vehicle_model::{Overrides, Vehicle};
use world::{
    Scenario,
    report::DistancePair,
    time::{from_seconds, seconds},
};

use crate::{
    Failure, Workspace,
    experiment::{BuiltImages, measure, run_each},
    sim::{self, Finished, Wish},
    vehicle,
};

/// A run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) enum Take {
    /// First track test of the thesis, under its law.
    One,
    /// The same with half its gains.
    Half,
    /// Second track test.
    Five,
    /// Third track test.
    Loaded,
    /// The first under Furrow's law.
    OneFurrow,
    /// The second under Furrow's law.
    FiveFurrow,
    /// The third under Furrow's law.
    LoadedFurrow,
    /// The printed gains at low speed.
    Model,
    /// Noisy measurements at low speed.
    Estimation,
    /// A drive by hand for the calibration.
    Calibration,
    /// A few seconds with what every core executes and every device hears.
    Bus,
    /// The receiver loses its fix.
    Lost,
    /// Barriers that step apart, proportional law.
    StepP,
    /// The same with an integral.
    StepPi,
    /// The same under Furrow's law.
    StepFurrow,
    /// Between poles, three seeds.
    Poles(u64),
    /// Between poles under Furrow's law, the same seeds.
    PolesFurrow(u64),
    /// In a field, three seeds.
    Field(u64),
    /// In a field under Furrow's law, the same seeds.
    FieldFurrow(u64),
}

/// How a run is made.
struct Recipe {
    vehicle: &'static str,
    scenario: &'static str,
    set: &'static str,
    seed: u64,
    /// How long, s; `None` for the scenario's time.
    length: Option<f64>,
}

const fn uagv(scenario: &'static str, set: &'static str, length: Option<f64>) -> Recipe {
    Recipe {
        vehicle: vehicle::DEFAULT,
        scenario,
        set,
        seed: 1,
        length,
    }
}

const fn rows(scenario: &'static str, set: &'static str, seed: u64, length: Option<f64>) -> Recipe {
    Recipe {
        vehicle: "row-follower",
        scenario,
        set,
        seed,
        length,
    }
}

impl Take {
    const fn recipe(self) -> Recipe {
        const FURROW: &str = "machine.law=furrow";
        // As long as a robot takes for the row.
        const POLES: Option<f64> = Some(15.0);
        const FIELD: Option<f64> = Some(60.0);
        // Half a minute of it is steady.
        const TRACK: Option<f64> = Some(45.0);
        match self {
            Self::One => uagv("thesis-machine/one-metre-off", "", TRACK),
            Self::Half => uagv("thesis-machine/half-gains", "", TRACK),
            Self::Five => uagv("thesis-machine/five-metres-off", "", TRACK),
            Self::Loaded => uagv("thesis-machine/loaded", "", TRACK),
            Self::OneFurrow => uagv("thesis-machine/one-metre-off", FURROW, TRACK),
            Self::FiveFurrow => uagv("thesis-machine/five-metres-off", FURROW, TRACK),
            Self::LoadedFurrow => uagv("thesis-machine/loaded", FURROW, TRACK),
            Self::Model => uagv("thesis-machine/simulated-model", "", TRACK),
            Self::Estimation => uagv("thesis-machine/simulated-estimation", "", TRACK),
            Self::Calibration => uagv("calibration", "", None),
            Self::Bus => uagv("straight-line", "", Some(8.0)),
            Self::Lost => uagv("gps-lost", "", Some(22.0)),
            Self::StepP => rows(
                "thesis-2/step",
                "rover.law=thesis;rover.cruise=0.4 m/s;rover.thesis.most=140 cm",
                1,
                None,
            ),
            Self::StepPi => rows(
                "thesis-2/step",
                "rover.law=thesis;rover.cruise=0.4 m/s;rover.thesis.most=140 cm;rover.thesis.integral=0.0004",
                1,
                None,
            ),
            Self::StepFurrow => rows(
                "thesis-2/step",
                "rover.cruise=0.4 m/s;rover.rows.width=115 cm;rover.rows.tolerance=10 cm",
                1,
                None,
            ),
            Self::Poles(seed) => rows(
                "thesis-2/poles",
                "rover.law=thesis;rover.cruise=0.8 m/s",
                seed,
                POLES,
            ),
            Self::PolesFurrow(seed) => rows("thesis-2/poles", "rover.cruise=0.8 m/s", seed, POLES),
            Self::Field(seed) => rows(
                "thesis-2/field",
                "rover.law=thesis;rover.cruise=0.4 m/s",
                seed,
                FIELD,
            ),
            Self::FieldFurrow(seed) => rows("thesis-2/field", "rover.cruise=0.4 m/s", seed, FIELD),
        }
    }

    /// The command that makes the same run.
    pub(super) fn command(self) -> String {
        let recipe = self.recipe();
        let mut text = format!("cargo xtask sim {}", recipe.scenario);
        if recipe.vehicle != vehicle::DEFAULT {
            // Writing to a string cannot fail.
            let _ = write!(text, " --vehicle {}", recipe.vehicle);
        }
        for set in recipe.set.split(';').filter(|set| !set.is_empty()) {
            let quoted = if set.contains(' ') {
                format!("'{set}'")
            } else {
                set.into()
            };
            let _ = write!(text, " --set {quoted}");
        }
        if recipe.seed != 1 {
            let _ = write!(text, " --seed {}", recipe.seed);
        }
        if let Some(length) = recipe.length {
            let _ = write!(text, " --seconds {length}");
        }
        text + " --out run"
    }
}

/// A run that is ready to be made.
pub(super) struct Ready {
    take: Take,
    vehicle: Vehicle,
    scenario: Scenario,
    images: std::sync::Arc<twin::Images>,
}

/// Reads the scenarios and builds the images of these runs.
///
/// # Errors
///
/// A scenario is wrong, or an image does not build.
pub(super) fn ready(workspace: &Workspace, takes: &[Take]) -> Result<Vec<Ready>, Failure> {
    let mut chosen = Vec::new();
    for &take in takes {
        let recipe = take.recipe();
        let own = Overrides::parse(recipe.set).map_err(Failure::Usage)?;
        let both = sim::choice::with(workspace, recipe.vehicle, recipe.scenario, &own)?;
        chosen.push((take, both));
    }
    let mut built = BuiltImages::for_all(chosen.iter().map(|(_, (vehicle, _))| vehicle));
    let ready = chosen.into_iter().map(|(take, (vehicle, scenario))| {
        let images = built.of(workspace, &vehicle)?;
        Ok(Ready {
            take,
            vehicle,
            scenario,
            images,
        })
    });
    ready.collect()
}

/// Makes the runs.
///
/// # Errors
///
/// A program did what its microcontroller does not allow, or ended in a fault.
pub(super) fn make(ready: &[Ready]) -> Result<Takes<'_>, Failure> {
    let runs = run_each(
        ready,
        &|one| one.scenario.name.clone(),
        BTreeMap::new(),
        &mut |_, _| Ok(()),
        &|one: &Ready| -> Result<Finished<'_>, Failure> {
            let recipe = one.take.recipe();
            let wish = Wish {
                seed: recipe.seed,
                length: recipe.length.map(from_seconds),
                tasks: one.take == Take::Bus,
                characters: one.take == Take::Bus,
                quiet: true,
                ..Wish::default()
            };
            let finished = sim::simulate_with(&one.images, &one.vehicle, &one.scenario, wish)?;
            match finished.locked_up().as_slice() {
                [] => Ok(finished),
                nodes => Err(sim::Error::Fault {
                    nodes: nodes.iter().map(|&node| node.to_owned()).collect(),
                }
                .into()),
            }
        },
    )?;
    let all = ready.iter().map(|one| one.take).zip(runs);
    Ok(Takes(all.collect()))
}

/// The finished runs.
pub(super) struct Takes<'r>(BTreeMap<Take, Finished<'r>>);

/// Points of a curve: time, s, and value.
pub(super) type Points = Vec<(f64, f64)>;

impl<'r> Takes<'r> {
    /// A run.
    ///
    /// # Panics
    /// It is none of those that were made: a figure names all that it is drawn from.
    pub(super) fn of(&self, take: Take) -> &Finished<'r> {
        &self.0[&take]
    }

    /// When the vehicle of a run began to drive by itself, s; 0 if it never did.
    pub(super) fn begin(&self, take: Take) -> f64 {
        let summary = self.of(take).summary();
        let first = summary.autonomous_runs.first();
        first.map_or(0.0, |run| run.from_seconds)
    }

    /// A value of the vehicle's states, by the time since the vehicle began to drive by itself.
    pub(super) fn states(
        &self,
        take: Take,
        value: impl Fn(&world::StateSample, &world::scenario::Line) -> f64,
    ) -> Points {
        let begin = self.begin(take);
        let run = self.of(take).run();
        let Some(line) = &run.scenario.line else {
            return Vec::new();
        };
        let states = run.states.iter();
        let points = states.map(|state| (seconds(state.at) - begin, value(state, line)));
        points.filter(|(time, _)| *time >= 0.0).collect()
    }

    /// Cross-track error, m, positive to the right.
    pub(super) fn errors(&self, take: Take) -> Points {
        self.states(take, |state, line| line.locate(state.north, state.east).1)
    }

    /// Heading error, degrees, positive to the right.
    pub(super) fn headings(&self, take: Take) -> Points {
        use std::f64::consts::{PI, TAU};
        self.states(take, |state, line| {
            let error = state.heading - line.direction();
            ((error + PI).rem_euclid(TAU) - PI).to_degrees()
        })
    }

    /// Steering angle, degrees, positive to the right.
    pub(super) fn angles(&self, take: Take) -> Points {
        self.states(take, |state, _| state.steering.to_degrees())
    }

    /// Way of the antenna: northing and easting, m.
    pub(super) fn way(&self, take: Take) -> Points {
        let run = self.of(take).run();
        let states = run.states.iter();
        states.map(|state| (state.north, state.east)).collect()
    }

    /// The figures of a track test, and the commanded steering rates, degrees a second, by time.
    pub(super) fn track(&self, take: Take) -> (Option<measure::Figures>, Points) {
        let finished = self.of(take);
        let run = finished.run();
        let Ok(rate) = measure::SteeringRate::of(finished.vehicle()) else {
            return (None, Vec::new());
        };
        let rates = rate.of_frames(run.frames);
        let begin = self.begin(take);
        let points = rates.iter().map(|(at, rate)| (seconds(*at) - begin, *rate));
        let points = points.filter(|(time, _)| *time >= 0.0).collect();
        (measure::Figures::of(&run, rates), points)
    }

    /// A signal on the bus by the time since the vehicle began to drive by itself, in its unit. `path` is the
    /// message and the signal, as in `Command.SteeringRate`.
    pub(super) fn signal(&self, take: Take, path: &str) -> Points {
        let begin = self.begin(take);
        let points = self.signal_from_start(take, path).into_iter();
        let points = points.map(|(time, value)| (time - begin, value));
        points.filter(|(time, _)| *time >= 0.0).collect()
    }

    /// The same by the time since the power came on.
    pub(super) fn signal_from_start(&self, take: Take, path: &str) -> Points {
        let finished = self.of(take);
        let (message, signal) = path.split_once('.').unwrap_or((path, ""));
        let mut messages = finished.vehicle().network().messages.iter();
        let message = messages.find(|one| one.name == message);
        let both = message.and_then(|message| {
            let mut signals = message.signals.iter();
            Some((message, signals.find(|one| one.name == signal)?))
        });
        let Some((message, signal)) = both else {
            return Vec::new();
        };
        let frames = finished.run().frames.iter();
        let own = frames.filter(|frame| {
            frame.is_message() && frame.id == message.id && frame.dlc == message.length
        });
        let value = |data: &[u8]| signal.physical(signal.extract(data));
        own.map(|frame| (seconds(frame.end), value(&frame.data)))
            .collect()
    }

    /// The filtered distances of a robot between rows.
    pub(super) fn distances(&self, take: Take) -> Vec<DistancePair> {
        let run = self.of(take).run();
        run.rover
            .map_or(Vec::new(), |rover| rover.distances.to_vec())
    }
}
