//! `field`: a hectare in swaths with headland turns, driven from the flash of the release images.
//!
//! The field is a square of 100 m. Its 34 swaths of 3 m lie side by side and overlap by 6 cm. The vehicle turns beyond both
//! ends, in the narrowest headland of whole metres that its turns fit into. Everything is judged by the true place of the rear
//! axle, and by the instants at which a node at the implement would switch it.

use std::fmt::Write as _;

use control::controller::{Controller, Outcome, Sample};
use control::mission::{Legs, MissionSettings, Outputs, Planner, Section, Stretch};
use firmware::mission::{NEVER, Told, lead, told};
use mission::{
    place::{Local, Origin},
    plan::{End, Join, Leg, Outputs as Sections, Plan, Shape},
};
use serde::{Deserialize, Serialize};
use serde_json::json;
use twin::{Images, Twin};
use vehicle_model::{Overrides, Vehicle};
use world::{
    Scenario,
    report::{MissionFigures, SectionSwitch},
    time::{Span as _, at, from_seconds, seconds},
    units::Time,
};

use super::{BuiltImages, Error, RunError, kept::Place, needed, quick, run_all};
use crate::{
    Failure, Workspace,
    cli::Sim,
    mission::{self as missions, Loaded},
    sim::choice,
    vehicle,
};
use quick::{Law, Numbers};

/// Its name on the command line.
pub(super) const NAME: &str = "field";

/// The scenario of a mission.
const SCENARIO: &str = "mission";

/// Values in place of the manifest's.
const SET: &str = "mission.enabled=true";

/// Side of the field, m.
const SIDE: f64 = 100.0;

/// Width of the implement, m.
const WIDTH: f64 = 3.0;

/// Speeds on the swaths, m/s; a faster vehicle also drives at its largest one.
const SPEEDS: [f64; 2] = [1.0, 2.0];

/// Widest headland that is tried, m.
const WIDEST: f64 = 40.0;

/// Steps of the planning in a basic cycle, as in the images.
const STEPS: usize = 4;

/// From the start of the nodes to the run: the operator needs 9 s, the check of a hectare minutes.
const BEFORE: f64 = 240.0;

/// A vehicle that slows down for turns and changes of direction needs up to so many times the time at full speed.
const SLOWER: f64 = 1.8;

/// A vehicle that stands for so long on its way will not go on, s.
const STUCK: f64 = 30.0;

/// Limits of a mission's figures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Mean size of the cross-track error on swaths, cm.
    pub mean_cm: f64,
    /// Standard deviation of it, cm.
    pub deviation_cm: f64,
    /// Largest in turns, cm.
    pub turns_cm: f64,
    /// Distance of a section's switch from the end of its swath, cm.
    pub switched_cm: f64,
    /// Least share of the swaths that is worked, percent.
    pub worked_percent: f64,
    /// Stops on the way.
    pub stops: usize,
}

/// The limits of the experiment.
pub const LIMITS: Limits = Limits {
    mean_cm: 1.0,
    deviation_cm: 2.0,
    turns_cm: 10.0,
    switched_cm: 5.0,
    worked_percent: 99.5,
    stops: 0,
};

impl Limits {
    /// What of a drive is not within the limits, a clause each.
    #[must_use]
    pub fn missed(&self, figures: &MissionFigures) -> Vec<String> {
        let mut missed = Vec::new();
        if !figures.finished {
            missed.push("it did not come to its end".to_owned());
        }
        let mut most = |name: &str, value: Option<f64>, limit: f64| match value {
            None => missed.push(format!("no {name}")),
            Some(value) if value > limit => {
                missed.push(format!("{name} {value:.2} cm, above {limit} cm"));
            }
            Some(_) => {}
        };
        most("mean cross-track error", figures.mean_cm, self.mean_cm);
        most(
            "standard deviation",
            figures.deviation_cm,
            self.deviation_cm,
        );
        most("error in turns", figures.turns_largest_cm, self.turns_cm);
        most(
            "distance of a switch",
            figures.switched_within_cm,
            self.switched_cm,
        );
        if figures.wrong_switches > 0 {
            missed.push(format!("{} wrong switches", figures.wrong_switches));
        }
        let worked = figures
            .coverage
            .as_ref()
            .map_or(0.0, |all| all.worked_percent);
        if worked < self.worked_percent {
            missed.push(format!(
                "{worked:.2} % worked, below {} %",
                self.worked_percent
            ));
        }
        if figures.stops > self.stops {
            missed.push(format!("{} stops", figures.stops));
        }
        missed
    }
}

/// The mission of a field: `swaths` swaths of this length (m) side by side, due north and south, each overlapped so that they
/// are `across` metres wide together, with a headland of this width (m) about them.
#[must_use]
pub fn plan(swaths: usize, length: f64, across: f64, headland: f64, speed: f64) -> Plan {
    let apart = (across - WIDTH) / (swaths.max(2) - 1) as f64;
    let leg = |number: usize| {
        let east = 0.5 * WIDTH + apart * number as f64;
        let (south, north) = (Local::new(0.0, east), Local::new(length, east));
        let (from, to) = match number % 2 {
            0 => (south, north),
            _ => (north, south),
        };
        Leg {
            shape: Shape::Line { from, to },
            speed,
            reverse: false,
            outputs: Sections(1),
            join: Join::Turn,
        }
    };
    let (south, north) = (-headland, length + headland);
    let (west, east) = (-headland, across + headland);
    Plan {
        name: format!("{swaths} swaths at {speed} m/s"),
        origin: Origin::default(),
        width: Some(WIDTH),
        fence: vec![
            Local::new(south, west),
            Local::new(south, east),
            Local::new(north, east),
            Local::new(north, west),
        ],
        obstacles: Vec::new(),
        legs: (0..swaths).map(leg).collect(),
        end: End::Stop,
    }
}

/// That mission in the narrowest headland of whole metres into which the turns of the vehicle fit.
///
/// # Errors
/// Why the vehicle cannot drive it in the widest one.
pub fn loaded(
    vehicle: &Vehicle,
    swaths: usize,
    length: f64,
    across: f64,
    speed: f64,
) -> Result<Loaded, String> {
    let settings = missions::settings(vehicle)?;
    // No turn is narrower than its radius and the vehicle.
    let mut headland = (1.0 / f64::from(settings.curvature)).ceil();
    loop {
        let plan = plan(swaths, length, across, headland, speed);
        match missions::prepare(vehicle, plan, &settings) {
            Ok(loaded) => return Ok(loaded),
            Err(why) if headland >= WIDEST => return Err(why),
            Err(_) => headland += 1.0,
        }
    }
}

/// A speed, ready to be driven.
struct Ready {
    name: String,
    speed: f64,
    scenario: Scenario,
    loaded: Loaded,
    images: Option<Images>,
}

/// A run that is to be done.
struct Job<'a> {
    vehicle: &'a Vehicle,
    of: &'a Ready,
    number: usize,
    seed: u64,
    /// Whether a picture of it is wanted.
    picture: bool,
    settings: MissionSettings<f32>,
    numbers: &'a Numbers,
}

/// What a run gave.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Run {
    speed_m_s: f64,
    seed: u64,
    figures: MissionFigures,
    picture: Option<String>,
}

/// Runs it.
///
/// # Errors
///
/// The vehicle has no missions, or the output folder is wrong (exit code 2); an image does not build or run; a limit is
/// missed.
pub(super) fn run(workspace: &Workspace, options: &Sim) -> Result<(), Failure> {
    let set = Overrides::parse(SET).map_err(Failure::Usage)?;
    let own = options.changes.overrides();
    let overrides = match own.shared_key(&set) {
        Some(_) => own,
        None => own.and(set),
    };
    let vehicle = vehicle::with(workspace, &options.vehicle, &overrides)?;
    needed(&vehicle, "[mission]", vehicle.manifest().missions())?;
    let place = Place::of(options)?;
    let cases = ready(workspace, &vehicle, options)?;
    let settings = missions::settings(&vehicle).map_err(Failure::Usage)?;
    let numbers = Numbers::of(&vehicle)?;
    let seeds = (0..options.seeds).map(|k| options.seed.wrapping_add(k));
    let jobs: Vec<Job> = seeds
        .flat_map(|seed| {
            let (cases, vehicle, numbers) = (cases.iter().enumerate(), &vehicle, &numbers);
            cases.map(move |(number, of)| Job {
                vehicle,
                of,
                number,
                seed,
                picture: seed == options.seed,
                settings,
                numbers,
            })
        })
        .collect();
    let kept = match &place {
        Some(place) => {
            let cases = || cases.iter();
            let scenarios: Vec<_> = cases().map(|of| (&of.scenario, &of.loaded)).collect();
            let images = cases().filter_map(|of| Some((&vehicle, of.images.as_ref()?)));
            place.kept(NAME, options, &scenarios, &images.collect::<Vec<_>>())?
        }
        None => None,
    };
    let runs = run_all(&jobs, &Job::name, kept, &Job::run)?;
    let of = |case: usize| -> Vec<&Run> {
        let both = jobs.iter().zip(&runs).filter(|(job, _)| job.number == case);
        both.map(|(_, run)| run).collect()
    };
    let cases: Vec<(&Ready, Vec<&Run>)> = cases.iter().zip((0..).map(of)).collect();
    if let Some(place) = place {
        write(place, options, &cases, &runs)?;
    }
    if options.json {
        print!("{}", json(options, &cases));
    } else {
        print!("{}", text(options, &cases));
    }
    match missed(&cases).as_slice() {
        [] => Ok(()),
        missed => Err(Error::Missed(missed.to_vec()).into()),
    }
}

/// The cases of a vehicle, with their images.
fn ready(workspace: &Workspace, vehicle: &Vehicle, options: &Sim) -> Result<Vec<Ready>, Failure> {
    let top = missions::settings(vehicle)
        .map_err(Failure::Usage)?
        .top_speed;
    let top = f64::from(top);
    let mut speeds: Vec<f64> = SPEEDS
        .into_iter()
        .filter(|speed| *speed <= top + 1e-6)
        .collect();
    if speeds.iter().all(|speed| *speed < top - 1e-6) {
        speeds.push((top * 100.0).round() / 100.0);
    }
    let images = match options.quick {
        true => None,
        false => {
            let mut built = BuiltImages::for_all([vehicle].into_iter());
            Some(built.of(workspace, vehicle)?)
        }
    };
    let swaths = (SIDE / WIDTH).ceil() as usize;
    let mut all = Vec::new();
    for speed in speeds {
        let (_, mut scenario) =
            choice::with(workspace, vehicle.name(), SCENARIO, vehicle.overrides())?;
        let loaded = loaded(vehicle, swaths, SIDE, SIDE, speed)
            .map_err(|why| Failure::Usage(format!("{NAME} at {speed} m/s: {why}")))?;
        loaded.begin(&mut scenario);
        let before = if options.quick { STUCK } else { BEFORE };
        scenario.duration = Time::new(before + loaded.time * SLOWER);
        let images = images.as_deref().cloned();
        all.push(Ready {
            name: format!("{speed} m/s"),
            speed,
            scenario,
            images: images.map(|images| loaded.with_images(images, vehicle)),
            loaded,
        });
    }
    Ok(all)
}

impl Job<'_> {
    fn name(&self) -> String {
        format!("{} with seed {}", self.of.name, self.seed)
    }

    fn failed(&self, why: RunError) -> Error {
        Error::Run {
            scenario: format!("{NAME} at {}", self.of.name),
            seed: self.seed,
            law: "furrow",
            why,
        }
    }

    fn run(&self) -> Result<Run, Error> {
        let (figures, picture) = match &self.of.images {
            Some(images) => self.drive(images)?,
            None => self.drive_quickly()?,
        };
        Ok(Run {
            speed_m_s: self.of.speed,
            seed: self.seed,
            figures,
            picture: self.picture.then_some(picture),
        })
    }

    /// The run on the virtual vehicle, to the end of the mission or until it is clear that it does not come.
    fn drive(&self, images: &Images) -> Result<(MissionFigures, String), Error> {
        let Ready {
            scenario, loaded, ..
        } = self.of;
        let failed = |error: twin::TwinError| self.failed(error.into());
        let mut twin = Twin::new(self.vehicle, scenario, self.seed, images).map_err(failed)?;
        let end = at(scenario.duration.span());
        let mut stood = 0.0;
        while twin.now() < end {
            let next = twin.now() + from_seconds(1.0);
            twin.run_until(next.min(end)).map_err(failed)?;
            let states = twin.world().states();
            let moved = states
                .first()
                .zip(states.last())
                .is_some_and(|(first, last)| {
                    (first.north - last.north).hypot(first.east - last.east) > 1.0
                });
            let Some(last) = states.last() else { continue };
            stood = if moved && last.speed.abs() < 0.01 {
                stood + 1.0
            } else {
                0.0
            };
            if stood >= STUCK || (stood >= 3.0 && loaded.course.is_at_end(last)) {
                break;
            }
        }
        let outcome = twin.finish();
        if let Some(node) = outcome.nodes.iter().find(|node| node.locked_up) {
            return Err(self.failed(RunError::Fault {
                node: node.name.clone(),
            }));
        }
        Ok(loaded.judge(self.vehicle, scenario, self.seed, &outcome))
    }

    /// The run with planner and law on this computer.
    fn drive_quickly(&self) -> Result<(MissionFigures, String), Error> {
        let Ready {
            scenario, loaded, ..
        } = self.of;
        let mission = loaded.drivable.mission();
        let (settings, numbers) = (self.numbers.settings(), self.numbers);
        let stretch = Stretch::new(mission.origin, self.settings.pace);
        let period = numbers.period();
        let section = lead(&Section::default(), period, numbers.release());
        let mut law = Planned {
            controller: Controller::following(*settings, stretch)?,
            planner: Planner::new(self.settings),
            mission,
            outputs: Outputs::new([section; 8]),
            period,
            told: Vec::new(),
        };
        let mut began = Vec::new();
        let next = f64::from(period - numbers.release());
        let record = quick::drive(
            self.vehicle,
            numbers,
            scenario,
            self.seed,
            &mut law,
            |world, _, _| began.push(seconds(world.now()) + next),
        );
        let cycles = began
            .into_iter()
            .zip(law.told.iter().map(|told| Some(heard(told))));
        let switches: Vec<SectionSwitch> = missions::played(cycles);
        let mut run = record.run();
        let driven = loaded.course.driven_with(run.states, run.modes, switches);
        let mission = driven.run();
        run.mission = Some(mission);
        let figures = MissionFigures::of(&run, &mission);
        let picture = driven.svg(run.states, &figures.line());
        Ok((figures, picture))
    }
}

/// What the message about the sections says, as it is heard.
fn heard(told: &[Told; 8]) -> missions::Switches {
    told.map(|one| {
        let after = Some(f64::from(one.after) * 1e-3);
        (one.on, after.filter(|_| one.after != NEVER))
    })
}

/// Planner, law and sections, as the tasks of the controller call them.
struct Planned<'a> {
    controller: Controller<f32, Stretch<f32>>,
    planner: Planner<f32>,
    mission: Legs<'a, f32>,
    outputs: Outputs<f32>,
    period: f32,
    /// What was told of the sections after each step.
    told: Vec<[Told; 8]>,
}

impl Law for Planned<'_> {
    fn step(&mut self, sample: &Sample<f32>) -> Outcome<f32> {
        for _ in 0..STEPS {
            let current = self.controller.progress().segment;
            self.planner
                .feed(&self.mission, self.controller.route_mut(), current);
        }
        let outcome = self.controller.step(sample);
        let switching = if sample.engaged && self.controller.is_located() {
            let (route, progress) = (self.controller.route(), self.controller.progress());
            let speed = outcome.tracking.speed;
            self.outputs.step(route, progress, speed, self.period)
        } else {
            control::mission::Switching::default()
        };
        self.told.push(told(&switching));
        outcome
    }
}

/// The limits that were missed, each with where.
fn missed(cases: &[(&Ready, Vec<&Run>)]) -> Vec<String> {
    let runs = cases.iter().flat_map(|(of, runs)| {
        let runs = runs.iter();
        runs.map(|run| (&of.name, run.seed, LIMITS.missed(&run.figures)))
    });
    let clauses = runs.flat_map(|(name, seed, missed)| {
        let missed = missed.into_iter();
        missed.map(move |what| format!("{name}, seed {seed}: {what}"))
    });
    clauses.collect()
}

/// The worst of some figures; `None` if one is missing.
fn worst(runs: &[&Run], of: fn(&MissionFigures) -> Option<f64>) -> Option<f64> {
    let values: Option<Vec<f64>> = runs.iter().map(|run| of(&run.figures)).collect();
    values?.into_iter().reduce(f64::max)
}

fn json(options: &Sim, cases: &[(&Ready, Vec<&Run>)]) -> String {
    let case = |(of, runs): &(&Ready, Vec<&Run>)| {
        let run = |run: &&Run| json!({ "seed": run.seed, "figures": run.figures });
        json!({
            "speed_m_s": of.speed,
            "full_speed_seconds": of.loaded.time,
            "runs": runs.iter().map(run).collect::<Vec<_>>(),
        })
    };
    let report = json!({
        "experiment": NAME,
        "vehicle": options.vehicle,
        "quick": options.quick,
        "first_seed": options.seed,
        "seeds": options.seeds,
        "limits": LIMITS,
        "cases": cases.iter().map(case).collect::<Vec<_>>(),
        "missed": missed(cases),
    });
    format!("{report:#}\n")
}

fn text(options: &Sim, cases: &[(&Ready, Vec<&Run>)]) -> String {
    let how = if options.quick {
        "law and planner alone"
    } else {
        "release images"
    };
    let mut out = format!(
        "{NAME}: one hectare with {}, {how}; the worst of {} seeds\n{:<8} {:>8} {:>9} {:>9} {:>9} {:>9} {:>9} {:>8} {:>6}\n",
        options.vehicle,
        options.seeds,
        "speed",
        "mean",
        "deviation",
        "largest",
        "turns",
        "switched",
        "worked",
        "time",
        "stops"
    );
    for (of, runs) in cases {
        let cm = |value: Option<f64>| value.map_or("-".into(), |value| format!("{value:.2} cm"));
        // The least share that was worked is the largest that was not.
        let left = worst(runs, |all| {
            Some(100.0 - all.coverage.as_ref()?.worked_percent)
        });
        let worked = left.map_or("-".into(), |left| format!("{:.2} %", 100.0 - left));
        let time = worst(runs, |all| Some(all.time_seconds));
        let stops = runs.iter().map(|run| run.figures.stops).max();
        // Writing to a string cannot fail.
        let _ = writeln!(
            out,
            "{:<8} {:>8} {:>9} {:>9} {:>9} {:>9} {worked:>9} {:>8} {:>6}",
            of.name,
            cm(worst(runs, |all| all.mean_cm)),
            cm(worst(runs, |all| all.deviation_cm)),
            cm(worst(runs, |all| all.largest_cm)),
            cm(worst(runs, |all| all.turns_largest_cm)),
            cm(worst(runs, |all| all.switched_within_cm)),
            time.map_or("-".into(), |time| format!("{time:.0} s")),
            stops.unwrap_or_default()
        );
    }
    let _ = writeln!(
        out,
        "{:<8} {:>8} {:>9} {:>9} {:>9} {:>9} {:>9} {:>8} {:>6}",
        "limit",
        format!("{} cm", LIMITS.mean_cm),
        format!("{} cm", LIMITS.deviation_cm),
        "",
        format!("{} cm", LIMITS.turns_cm),
        format!("{} cm", LIMITS.switched_cm),
        format!("{} %", LIMITS.worked_percent),
        "",
        LIMITS.stops
    );
    let missed = missed(cases);
    for what in &missed {
        let _ = writeln!(out, "  missed: {what}");
    }
    if missed.is_empty() {
        out.push_str("every limit is kept\n");
    }
    out
}

/// Writes the files.
fn write(
    place: Place,
    options: &Sim,
    cases: &[(&Ready, Vec<&Run>)],
    runs: &[Run],
) -> Result<(), Error> {
    let mut csv = String::from(
        "speed_m_s,seed,finished,time_s,way_m,stops,mean_cm,deviation_cm,largest_cm,turns_cm,switched_cm,worked_percent\n",
    );
    for run in runs {
        let all = &run.figures;
        let figure = |value: Option<f64>| value.map_or(String::new(), |value| value.to_string());
        let _ = writeln!(
            csv,
            "{},{},{},{},{},{},{},{},{},{},{},{}",
            run.speed_m_s,
            run.seed,
            all.finished,
            all.time_seconds,
            all.way_m,
            all.stops,
            figure(all.mean_cm),
            figure(all.deviation_cm),
            figure(all.largest_cm),
            figure(all.turns_largest_cm),
            figure(all.switched_within_cm),
            figure(all.coverage.as_ref().map(|all| all.worked_percent))
        );
    }
    let report = json(options, cases);
    let pictures: Vec<(String, &str)> = runs
        .iter()
        .filter_map(|run| {
            Some((
                format!("field-{}.svg", run.speed_m_s),
                run.picture.as_deref()?,
            ))
        })
        .collect();
    let mut files = vec![
        ("experiment.json", report.as_str()),
        ("runs.csv", csv.as_str()),
    ];
    files.extend(
        pictures
            .iter()
            .map(|(name, picture)| (name.as_str(), *picture)),
    );
    place.finish(&files)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The run of four swaths of 30 m, without bus and images.
    fn garden(name: &str, speed: f64) -> Run {
        let workspace = Workspace::find().unwrap();
        let set = Overrides::parse(SET).unwrap();
        let vehicle = vehicle::with(&workspace, name, &set).unwrap();
        let loaded = loaded(&vehicle, 4, 30.0, 11.8, speed).unwrap();
        let (_, mut scenario) =
            choice::with(&workspace, name, SCENARIO, vehicle.overrides()).unwrap();
        loaded.begin(&mut scenario);
        scenario.duration = Time::new(STUCK + loaded.time * SLOWER);
        let of = Ready {
            name: "garden".into(),
            speed,
            scenario,
            loaded,
            images: None,
        };
        let job = Job {
            vehicle: &vehicle,
            of: &of,
            number: 0,
            seed: 1,
            picture: true,
            settings: missions::settings(&vehicle).unwrap(),
            numbers: &Numbers::of(&vehicle).unwrap(),
        };
        job.run().unwrap()
    }

    /// Both vehicles are within the limits at each speed, and every limit can be missed.
    #[test]
    fn a_garden_is_driven_within_the_limits() {
        for (name, speed) in [("uagv", 1.0), ("uagv", 2.0), ("tractor", 3.0)] {
            let run = garden(name, speed);
            let figures = run.figures;
            assert_eq!(LIMITS.missed(&figures), [""; 0], "{figures:?}");
            assert_eq!((figures.legs.len(), figures.turns.len()), (4, 3));
            let coverage = figures.coverage.as_ref().unwrap();
            assert!(
                (coverage.swaths_m2 - 30.0 * 11.8).abs() < 2.0,
                "{coverage:?}"
            );
            let picture = run.picture.unwrap();
            assert!(picture.contains("class=\"driven\""));
            let tight = Limits {
                mean_cm: 0.0,
                deviation_cm: 0.0,
                turns_cm: 0.0,
                switched_cm: 0.0,
                worked_percent: 100.1,
                stops: 0,
            };
            assert_eq!(tight.missed(&figures).len(), 5);
            let mut poor = figures;
            (poor.finished, poor.stops, poor.wrong_switches) = (false, 1, 2);
            assert_eq!(LIMITS.missed(&poor).len(), 3);
        }
    }
}
