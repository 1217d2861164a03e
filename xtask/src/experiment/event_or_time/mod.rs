//! `event-or-time`: from the first sample of the distances to the motors' pulses, on an event-triggered and
//! on a time-triggered bus, alone and beside foreign nodes (thesis 2.2.5.1 against chapters 3 to 6).
//!
//! The same hardware and sources are built for both protocols. Foreign nodes put the same frames in all
//! cases ([`load`]). On the event-triggered bus they send them at once. On the time-triggered bus a node has
//! to keep the schedule, and sends in free windows what finds room there; beside that stands what a node costs that does not keep it. The analysis bounds each case in which the foreign
//! nodes do what it is told of them.

mod load;
mod report;

use std::sync::Arc;

use can_bus::{RecordKind, SimTime};
use schedulability::{foreign::Foreign, system::Programs};
use serde::{Deserialize, Serialize};
use twin::{Images, Twin};
use vehicle_model::{Overrides, Protocol, Vehicle};
use world::time::{at, from_seconds, span_seconds};
use world::{Scenario, ScenarioError};

use super::{Error, RunError, kept::Place, needed, run_all};
use crate::{
    Failure, Workspace, build,
    cli::Sim,
    schedulability::{Error as AnalysisError, inputs},
    vehicle,
};
use load::{Load, Manner};

/// Its name on the command line.
pub(super) const NAME: &str = "event-or-time";

/// Foreign loads, percent of the bus.
const LOADS: [u32; 5] = [0, 20, 40, 60, 80];
/// When the foreign nodes begin, and when the figures do, s: the robot has been driving then.
const BEGIN: f64 = 1.0;
const FROM: f64 = 1.2;
/// How long the figures are taken, s.
const SPAN: f64 = 2.0;

/// A way to use the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
enum Way {
    /// All nodes send at once.
    EventTriggered,
    /// All nodes keep the schedule.
    TimeTriggered,
    /// The vehicle's nodes keep the schedule, the foreign ones do not.
    ScheduleIgnored,
}

impl Way {
    const fn name(self) -> &'static str {
        match self {
            Self::EventTriggered => "event-triggered",
            Self::TimeTriggered => "time-triggered",
            Self::ScheduleIgnored => "time-triggered, foreign nodes ignore it",
        }
    }

    const fn protocol(self) -> Protocol {
        match self {
            Self::EventTriggered => Protocol::EventTriggered,
            Self::TimeTriggered | Self::ScheduleIgnored => Protocol::TimeTriggered,
        }
    }

    const fn manner(self) -> Manner {
        match self {
            Self::TimeTriggered => Manner::BySchedule,
            Self::EventTriggered | Self::ScheduleIgnored => Manner::AtOnce,
        }
    }
}

/// A way and a load.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Case {
    way: Way,
    load: u32,
}

fn cases() -> Vec<Case> {
    let ways = [
        Way::EventTriggered,
        Way::TimeTriggered,
        Way::ScheduleIgnored,
    ];
    let all = ways
        .into_iter()
        .flat_map(|way| LOADS.map(|load| Case { way, load }));
    // Without foreign frames nobody ignores anything.
    all.filter(|case| case.way != Way::ScheduleIgnored || case.load > 0)
        .collect()
}

/// A vehicle on one protocol, with its images and their analysis.
struct OnProtocol {
    vehicle: Vehicle,
    scenario: Scenario,
    built: Vec<build::Image>,
    images: Arc<Images>,
}

/// A run that is to be done.
struct Job<'a> {
    of: &'a OnProtocol,
    case: Case,
    seed: u64,
}

/// What a run showed, from [`FROM`] on.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Seen {
    /// From first sample to pulse, us.
    latencies: Vec<f64>,
    /// Times between two commands, us.
    between_commands: Vec<f64>,
    /// Commands that came, and cycles in which one was due.
    commands: usize,
    cycles: usize,
    /// Length of a cycle, us.
    cycle_us: f64,
    /// Foreign frames that were put, and their bits on the bus that came.
    offered: usize,
    foreign_frames: usize,
    /// Shares of the bus that foreign frames and all frames took.
    foreign_share: f64,
    share: f64,
}

/// The figures of a case.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Figures {
    way: Way,
    foreign_load_percent: u32,
    /// What the foreign frames that were sent took of the bus.
    carried_percent: f64,
    /// Share of the foreign frames that were sent.
    carried_of_offered_percent: f64,
    /// What all frames took of the bus.
    bus_percent: f64,
    /// From first sample to pulse.
    least_latency_us: Option<f64>,
    mean_latency_us: Option<f64>,
    largest_latency_us: Option<f64>,
    /// Largest less least.
    latency_jitter_us: Option<f64>,
    /// What the analysis says; `None` if it has no bound.
    latency_bound_us: Option<f64>,
    /// Largest difference of the time between two commands from a cycle.
    command_jitter_us: Option<f64>,
    /// Commands that did not come in a cycle.
    missed_commands: usize,
    cycles: usize,
}

/// Runs it.
///
/// # Errors
///
/// The vehicle has no rover, an option or the output folder is wrong (exit code 2); an image does not
/// build or run; a latency is above its bound.
pub(super) fn run(workspace: &Workspace, options: &Sim) -> Result<(), Failure> {
    let own = options.changes.overrides();
    if options.quick {
        let text = format!("{NAME} measures images: --quick leaves them out; --seeds 1 is short");
        return Err(Failure::Usage(text));
    }
    if own.name_protocol() {
        let text =
            format!("{NAME} runs both protocols: neither --bus nor bus.protocol is accepted");
        return Err(Failure::Usage(text));
    }
    // A vehicle without a rover may refuse the event-triggered bus, which would not be the reason.
    let vehicle = vehicle::with(workspace, &options.vehicle, &own)?;
    needed(&vehicle, "[rover]", vehicle.manifest().rover.as_ref())?;
    let on = |protocol| on_protocol(workspace, options, own.clone().on(protocol));
    let [event, time] = [on(Protocol::EventTriggered)?, on(Protocol::TimeTriggered)?];
    let place = Place::of(options)?;
    let cases = cases();
    let of = |case: Case| match case.way.protocol() {
        Protocol::EventTriggered => &event,
        Protocol::TimeTriggered => &time,
    };
    let seeds = (0..options.seeds).map(|k| options.seed.wrapping_add(k));
    let jobs: Vec<Job> = seeds
        .flat_map(|seed| {
            let cases = cases.iter();
            cases.map(move |&case| (seed, case))
        })
        .map(|(seed, case)| Job {
            of: of(case),
            case,
            seed,
        })
        .collect();
    let kept = match &place {
        Some(place) => {
            let both = [&event, &time];
            let scenarios = both.map(|on| &on.scenario);
            let images = both.map(|on| (&on.vehicle, &*on.images));
            place.kept(NAME, options, &scenarios, &images)?
        }
        None => None,
    };
    let seen = run_all(&jobs, &Job::name, kept, &Job::run)?;
    let mut bounds = Vec::new();
    for on in [&event, &time] {
        let own = cases.iter().filter(|case| std::ptr::eq(of(**case), on));
        bounds.extend(self::bounds(workspace, on, own.copied())?);
    }
    let figures: Vec<Figures> = cases
        .iter()
        .map(|case| {
            let own = jobs.iter().zip(&seen).filter(|(job, _)| job.case == *case);
            let own: Vec<&Seen> = own.map(|(_, seen)| seen).collect();
            let bound = bounds.iter().find(|(of, _)| of == case);
            Figures::of(*case, &own, bound.and_then(|(_, bound)| *bound))
        })
        .collect();
    if let Some(place) = place {
        let (report, picture) = (report::json(options, &figures), report::picture(&figures));
        place.finish(&[("experiment.json", &report), ("latency.svg", &picture)])?;
    }
    if options.json {
        print!("{}", report::json(options, &figures));
    } else {
        print!("{}", report::text(options, &figures));
    }
    match report::above_bounds(&figures).as_slice() {
        [] => Ok(()),
        above => Err(Error::Missed(above.to_vec()).into()),
    }
}

/// Reads the vehicle with these values and builds its images.
fn on_protocol(
    workspace: &Workspace,
    options: &Sim,
    overrides: Overrides,
) -> Result<OnProtocol, Failure> {
    let vehicle = vehicle::with(workspace, &options.vehicle, &overrides)?;
    let scenario: Result<Scenario, ScenarioError> =
        Scenario::find(&vehicle, &format!("{NAME}/row"));
    let scenario = scenario.map_err(Error::from)?;
    let nodes: Vec<_> = vehicle.nodes().collect();
    let built = build::images(workspace, &vehicle, &nodes)?;
    Ok(OnProtocol {
        scenario,
        images: Arc::new(build::read(&built)?),
        built,
        vehicle,
    })
}

/// The foreign messages of a case.
fn foreign(on: &OnProtocol, case: Case) -> Vec<Foreign> {
    load::messages(case.load, on.vehicle.network().bit_rate)
}

/// What the analysis says about the time from sample to pulse in each of these cases, us. There is none
/// where foreign nodes ignore the schedule.
fn bounds(
    workspace: &Workspace,
    on: &OnProtocol,
    cases: impl Iterator<Item = Case>,
) -> Result<Vec<(Case, Option<f64>)>, Failure> {
    let plain = inputs(workspace, &on.vehicle, &on.built, (&[], None));
    let programs = Programs::read(&plain, &|_| {}).map_err(AnalysisError::from)?;
    let mut bounds = Vec::new();
    for case in cases {
        if case.way == Way::ScheduleIgnored {
            bounds.push((case, None));
            continue;
        }
        let foreign = foreign(on, case);
        let inputs = inputs(workspace, &on.vehicle, &on.built, (&foreign, None));
        let report = programs
            .beside(&inputs)
            .and_then(|programs| programs.report(&std::collections::BTreeMap::new(), &|_| {}))
            .map_err(AnalysisError::from)?;
        let latencies = report.chains.iter().map(|chain| chain.latency);
        let longest = latencies.reduce(|one, other| Some(one?.max(other?)));
        let us = longest.flatten().map(|ps| ps as f64 / 1e6);
        bounds.push((case, us));
    }
    Ok(bounds)
}

impl Job<'_> {
    fn name(&self) -> String {
        format!(
            "{} beside {} % with seed {}",
            self.case.way.name(),
            self.case.load,
            self.seed
        )
    }

    fn failed(&self, why: RunError) -> Error {
        Error::Run {
            scenario: format!("{} beside {} %", self.case.way.name(), self.case.load),
            seed: self.seed,
            law: "foreign load",
            why,
        }
    }

    fn run(&self) -> Result<Seen, Error> {
        let failed = |error: twin::TwinError| self.failed(error.into());
        let OnProtocol {
            vehicle,
            scenario,
            images,
            ..
        } = self.of;
        let network = vehicle.network();
        let mut twin = Twin::new(vehicle, scenario, self.seed, images).map_err(failed)?;
        let (from, end) = (at(from_seconds(FROM)), at(from_seconds(FROM + SPAN)));
        let mut load = Load::new(
            &mut twin,
            network,
            self.case.way.manner(),
            &foreign(self.of, self.case),
            (at(from_seconds(BEGIN)), end),
            self.seed,
        );
        load.run(&mut twin, end).map_err(failed)?;
        let foreign = load.nodes();
        let mut seen = Seen {
            cycle_us: f64::from(network.basic_cycle_us),
            offered: load.offered,
            ..Seen::default()
        };
        let us = |later: SimTime, earlier: SimTime| {
            (later.as_ticks() as f64 - earlier.as_ticks() as f64) / 1e6
        };
        let chain = twin.chain();
        let latencies = chain.latencies().filter(|one| one.pulse >= from);
        seen.latencies = latencies
            .map(|one| span_seconds(one.since_sample) * 1e6)
            .collect();
        let commands: Vec<SimTime> = chain.commands.iter().map(|frame| frame.end).collect();
        let commands = &commands[commands.partition_point(|end| *end < from)..];
        seen.commands = commands.len();
        let times: Vec<f64> = commands.iter().map(|time| us(*time, from)).collect();
        seen.cycles = seen.commands + missed(&times, SPAN * 1e6, seen.cycle_us);
        let pairs = commands.windows(2);
        seen.between_commands = pairs.map(|pair| us(pair[1], pair[0])).collect();
        let bit = f64::from(network.bit_time_ns()) * 1e-9;
        for record in twin.records() {
            if let RecordKind::FrameEnd { bits, .. } = record.kind {
                let own = foreign.contains(&record.node);
                seen.foreign_frames += usize::from(own);
                if record.at >= from {
                    // The interframe space belongs to the frame.
                    let share = f64::from(bits + 3) * bit / SPAN;
                    seen.share += share;
                    seen.foreign_share += if own { share } else { 0.0 };
                }
            }
        }
        Ok(seen)
    }
}

/// Commands that did not come in a span of `span` us, by the times (us) of those that did. A span of whole cycles
/// has one more or one less of them, as it begins before or behind one.
fn missed(commands: &[f64], span: f64, cycle: f64) -> usize {
    // How late a command may be without another one missing, as a share of the cycle.
    const LATE: f64 = 0.25;
    let (Some(first), Some(last)) = (commands.first(), commands.last()) else {
        return (span / cycle).round() as usize;
    };
    let pairs = commands.windows(2);
    let between = pairs.map(|pair| ((pair[1] - pair[0]) / cycle - LATE).floor());
    let edges = [*first, span - last].map(|time| (time / cycle - LATE).floor());
    between
        .chain(edges)
        .map(|count| count.max(0.0) as usize)
        .sum()
}

impl Figures {
    /// Puts the runs of a case together.
    fn of(case: Case, runs: &[&Seen], bound: Option<f64>) -> Self {
        let count = runs.len().max(1) as f64;
        let mean = |part: fn(&Seen) -> f64| runs.iter().map(|run| part(run)).sum::<f64>() / count;
        let sum = |part: fn(&Seen) -> usize| runs.iter().map(|run| part(run)).sum::<usize>();
        let latencies = || runs.iter().flat_map(|run| run.latencies.iter().copied());
        let (least, largest) = (latencies().reduce(f64::min), latencies().reduce(f64::max));
        let number = latencies().count();
        let cycle = runs.first().map_or(0.0, |run| run.cycle_us);
        let between = runs.iter().flat_map(|run| &run.between_commands);
        let late = between.map(|time| (time - cycle).abs());
        Self {
            way: case.way,
            foreign_load_percent: case.load,
            carried_percent: 100.0 * mean(|run| run.foreign_share),
            carried_of_offered_percent: match sum(|run| run.offered) {
                0 => 100.0,
                offered => 100.0 * sum(|run| run.foreign_frames) as f64 / offered as f64,
            },
            bus_percent: 100.0 * mean(|run| run.share),
            least_latency_us: least,
            mean_latency_us: (number > 0).then(|| latencies().sum::<f64>() / number as f64),
            largest_latency_us: largest,
            latency_jitter_us: least.zip(largest).map(|(least, largest)| largest - least),
            latency_bound_us: bound,
            command_jitter_us: late.reduce(f64::max),
            missed_commands: sum(|run| run.cycles.saturating_sub(run.commands)),
            cycles: sum(|run| run.cycles),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::{Command, Request, parse};

    fn options(more: &str) -> Sim {
        let line = format!("xtask sim --vehicle row-follower --experiment {NAME}{more}");
        let words = line.split(' ').map(std::ffi::OsString::from);
        match parse(words) {
            Ok(Request::Run(Command::Sim(options))) => options,
            other => panic!("not read: {other:?}"),
        }
    }

    fn seen(latencies: &[f64], between_commands: &[f64], commands: usize) -> Seen {
        Seen {
            latencies: latencies.to_vec(),
            between_commands: between_commands.to_vec(),
            commands,
            cycles: 400,
            cycle_us: 5000.0,
            offered: 100,
            foreign_frames: 50,
            foreign_share: 0.1,
            share: 0.3,
        }
    }

    /// By where the span begins in a cycle, it has one command more or less; that is none that was missed.
    #[test]
    fn a_command_is_missed_where_a_cycle_has_none() {
        let every = |from: f64, cycle: f64| -> Vec<f64> {
            let times = (0..).map(|k| from + cycle * f64::from(k));
            times.take_while(|time| *time <= 1000.0).collect()
        };
        for begin in [0.0, 1.0, 50.0, 99.9] {
            for cycle in [99.99, 100.0, 100.01] {
                assert_eq!(
                    missed(&every(begin, cycle), 1000.0, 100.0),
                    0,
                    "{begin} {cycle}"
                );
            }
        }
        let mut some = every(30.0, 100.0);
        some.retain(|time| ![30.0, 430.0, 530.0, 930.0].contains(time));
        assert_eq!(missed(&some, 1000.0, 100.0), 4);
        assert_eq!(missed(&[], 1000.0, 100.0), 10);
    }

    #[test]
    fn the_runs_of_a_case_are_put_together() {
        let case = Case {
            way: Way::EventTriggered,
            load: 40,
        };
        let one = seen(&[700.0, 900.0], &[5000.0, 4990.0], 400);
        let other = seen(&[800.0, 1600.0], &[5070.0], 397);
        let figures = Figures::of(case, &[&one, &other], Some(1500.0));
        assert_eq!(figures.least_latency_us, Some(700.0));
        assert_eq!(figures.mean_latency_us, Some(1000.0));
        assert_eq!(figures.latency_jitter_us, Some(900.0));
        assert_eq!(figures.command_jitter_us, Some(70.0));
        assert_eq!((figures.missed_commands, figures.cycles), (3, 800));
        assert_eq!(figures.carried_of_offered_percent, 50.0);
        assert!((figures.carried_percent - 10.0).abs() < 1e-9);
        assert_eq!(
            report::above_bounds(std::slice::from_ref(&figures)),
            ["1600 us from sample to pulse are above the bound of 1500 us (event-triggered, 40 %)"]
        );
        let bounded = Figures {
            latency_bound_us: Some(1600.0),
            ..figures.clone()
        };
        let unbounded = Figures {
            latency_bound_us: None,
            ..figures
        };
        assert_eq!(
            report::above_bounds(&[bounded.clone(), unbounded.clone()]),
            [""; 0]
        );
        let text = report::text(&options(" --seeds 2"), &[bounded, unbounded]);
        assert!(text.contains("seeds 1 to 2"), "{text}");
        let row = |bound: &str| format!("700    1000    1600     900{bound:>8}         70     3.8");
        assert!(
            text.contains(&row("1600")) && text.contains(&row("none")),
            "{text}"
        );
    }

    /// One run on the images, without the analysis.
    #[test]
    fn foreign_nodes_that_keep_the_schedule_change_nothing() {
        let workspace = Workspace::find().unwrap();
        let overrides = Overrides::default().on(Protocol::TimeTriggered);
        let time = on_protocol(&workspace, &options(""), overrides).unwrap();
        let case = Case {
            way: Way::TimeTriggered,
            load: 60,
        };
        let job = Job {
            of: &time,
            case,
            seed: 1,
        };
        let figures = Figures::of(case, &[&job.run().unwrap()], None);
        assert_eq!(figures.missed_commands, 0, "{figures:?}");
        assert!(figures.carried_percent > 4.0, "{figures:?}");
        assert!(figures.carried_of_offered_percent < 50.0, "{figures:?}");
        let largest = figures.largest_latency_us.unwrap();
        assert!(
            largest < 1750.0 && figures.latency_jitter_us.unwrap() < 30.0,
            "{figures:?}"
        );
        assert!(figures.command_jitter_us.unwrap() < 30.0, "{figures:?}");
    }

    /// Both protocols beside every load, and each latency within its bound.
    #[test]
    #[ignore = "for --long: it analyses six images and runs them for a minute"]
    fn every_latency_is_within_its_bound() {
        run(&Workspace::find().unwrap(), &options(" --seeds 1")).unwrap();
    }

    #[test]
    fn options_that_mean_nothing_here_are_refused() {
        let workspace = Workspace::find().unwrap();
        for (more, reason) in [
            (" --quick", "--quick leaves them out"),
            (" --bus event-triggered", "runs both protocols"),
        ] {
            let failure = run(&workspace, &options(more)).unwrap_err();
            assert_eq!(failure.exit_code(), 2);
            assert!(failure.to_string().contains(reason), "{failure}");
        }
    }
}
