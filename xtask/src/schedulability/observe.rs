//! Observes the tasks on the emulated vehicle: the longest time of each, and whether the
//! assumptions of the analysis hold.

use std::{
    collections::BTreeMap,
    fs,
    ops::Range,
    panic::{AssertUnwindSafe, catch_unwind},
    path::PathBuf,
    sync::{Arc, Mutex},
};
use world::time::{Span as _, at};

use observer::{
    follow,
    follower::{Findings, lock},
    slow_down,
};
use schedulability::{
    activations::{START_UP, excess},
    arrivals::Arrivals,
    can::ErrorRate,
    node::{Entered, Observed},
    side_by_side::side_by_side,
    system::Programs,
    transfers::{Rate, Transfers},
    units::time,
};
use twin::{GateChange, Outcome, Twin, mcu::FlashTiming};
use vehicle_model::{NodeIndex, Vehicle};
use wcet::cycles::Model;
use world::{Scenario, scenario::BusEvent, time::seconds, units::Time};

use super::Error;
use crate::{
    Failure,
    build::{self, Image},
};

/// Scenario of the first observed run, in the vehicle's folder, or in that of which it is a variant.
const SCENARIO: &str = "busy.toml";
/// Folder of the scenarios of further runs, if the vehicle has it: with wait states only, under which
/// jobs take longest and come closest to each other.
const STRESS: &str = "stress";
/// Seed of all random numbers of a run.
const SEED: u64 = 1;
/// Flash without wait states, and with those of the part where a handler finds nothing in its caches. The
/// second are the runs of the slowest core that the manual allows: bounds as flashed are for that one.
const TIMINGS: [FlashTiming; 2] = [FlashTiming::Immediate, FlashTiming::EmptyCaches];

/// The outcome of a run, and the findings about each node in the order of the manifest.
type Followed = (Outcome, Vec<Arc<Mutex<Findings>>>);

/// One run to observe.
#[derive(Debug, Clone, Copy)]
struct Job<'a> {
    scenario: &'a Scenario,
    flash: FlashTiming,
    model: Model,
}

/// Runs each observed scenario of the vehicle under both timings and observes each node's handlers.
pub(super) fn observe(
    vehicle: &Vehicle,
    images: &[Image],
    programs: &Programs,
    progress: &mut (dyn FnMut(&str) + Send),
) -> Result<BTreeMap<String, Observed>, Failure> {
    let bytes = build::read(images)?;
    let scenarios = scenarios(vehicle)?;
    let progress = Mutex::new(progress);
    let second = can_bus::SimDuration::from_ticks(1_000_000_000_000);
    let run = |job: &Job<'_>| -> Result<Followed, Error> {
        let Job {
            scenario, flash, ..
        } = job;
        let mut twin =
            Twin::with_flash(vehicle, scenario, SEED, &bytes, *flash).map_err(Error::from)?;
        let findings = vehicle.nodes().map(|node| {
            let name = &vehicle.node(node).name;
            let watches = programs.watches(name).map(|(_, watch)| watch);
            let mcu = twin.node_mut(node);
            if let Some(timing) = programs
                .flashed(name)
                .filter(|_| job.model == Model::Flashed)
            {
                slow_down(mcu, timing);
            }
            follow(mcu, watches, programs.known(name), START_UP)
        });
        let findings: Vec<_> = findings.collect();
        twin.run_telling(scenario.duration.span(), second, &mut |now| {
            if let Ok(mut progress) = progress.lock() {
                let (now, end) = (seconds(now.now), seconds(now.end));
                let name = &scenario.name;
                progress(&format!("{name}: {now:.0} of {end:.0} s simulated"));
            }
        })
        .map_err(Error::from)?;
        for (node, findings) in vehicle.nodes().zip(&findings) {
            let name = &vehicle.node(node).name;
            hold(name, images, &lock(findings))?;
            if let Some(allowed) = programs.transfers(name) {
                hold_transfers(name, &allowed, &scenario.name, &lock(findings))?;
            }
        }
        Ok((twin.finish(), findings))
    };
    let timings = TIMINGS.into_iter().zip(Model::ALL);
    let jobs: Vec<Job> = scenarios
        .iter()
        .enumerate()
        .flat_map(|(number, scenario)| {
            let timings = timings.clone();
            let wanted =
                timings.filter(move |(flash, _)| number == 0 || *flash == FlashTiming::EmptyCaches);
            wanted.map(move |(flash, model)| Job {
                scenario,
                flash,
                model,
            })
        })
        .collect();
    let outcomes = catch_unwind(AssertUnwindSafe(|| side_by_side(&jobs, run)))
        .map_err(|_| Error::BrokenDown)?;
    let mut all = BTreeMap::new();
    for (job, outcome) in jobs.iter().zip(outcomes) {
        let outcome = outcome?;
        let strange = strange(
            job.scenario,
            vehicle.is_event_triggered(),
            programs.errors(),
        );
        note(&mut all, *job, &outcome, images, &strange)?;
    }
    Ok(all)
}

/// Checks that no run of a node had a store that the analysis takes for impossible.
///
/// # Errors
/// There was one; the error says which.
fn hold(node: &str, images: &[Image], findings: &Findings) -> Result<(), Error> {
    let Some(stray) = findings.stray.first() else {
        return Ok(());
    };
    let sentence = images
        .iter()
        .find(|image| image.name == node)
        .map(|image| Ok::<_, Error>(stray.sentence(&wcet::image::Image::read(&image.path)?)));
    Err(Error::Stray {
        node: node.into(),
        sentence: sentence.transpose()?.unwrap_or_default(),
    })
}

/// Checks that no DMA unit of a node moved more than the task table has.
///
/// # Errors
/// One did; the error says which.
fn hold_transfers(
    node: &str,
    table: &Transfers,
    scenario: &str,
    findings: &Findings,
) -> Result<(), Error> {
    for (unit, runs) in &findings.transfers {
        let releases = table.get(unit).map(Rate::releases);
        let allowed = releases.map(Arrivals::from).unwrap_or_default();
        if let Some(excess) = runs.iter().find_map(|run| excess(&allowed, 0, run)) {
            return Err(Error::Stray {
                node: node.into(),
                sentence: format!(
                    "{unit}, begins {} transfers within {}, {} after power-on in {}, and `dma` in the task table \
                     allows {}",
                    excess.seen,
                    time(excess.span),
                    time(excess.begin),
                    scenario,
                    excess.most
                ),
            });
        }
    }
    Ok(())
}

/// The scenarios of the observed runs, in the order of their names behind the first one.
fn scenarios(vehicle: &Vehicle) -> Result<Vec<Scenario>, Error> {
    let of = |name: &str| {
        let own = vehicle.folder().join(name);
        match own.exists() {
            true => own,
            false => vehicle.crate_folder().join(name),
        }
    };
    let stress = of(STRESS);
    let mut paths = vec![of(SCENARIO)];
    if stress.is_dir() {
        let reading = |error| Error::Stress {
            path: stress.clone(),
            error,
        };
        let mut more = Vec::new();
        for entry in fs::read_dir(&stress).map_err(reading)? {
            more.push(entry.map_err(reading)?.path());
        }
        more.retain(|path| path.extension().is_some_and(|end| end == "toml"));
        more.sort();
        paths.extend(more);
    }
    let read = |path: &PathBuf| Ok(Scenario::find(vehicle, &path.to_string_lossy())?);
    paths.iter().map(read).collect()
}

/// How long after a foreign frame is queued, or the bus is free again, what waited has been sent at the
/// latest, picoseconds.
const ON_THE_BUS: u64 = 100_000_000_000;

/// The times of a run, in picoseconds, in which more jobs are released than the analysis counts, as it
/// has no foreign frames. Without a schedule, frames that waited for a dominant bus come all at once. And
/// a scenario may disturb more frames than the rate for which the analysis is made.
fn strange(scenario: &Scenario, event_triggered: bool, errors: ErrorRate) -> Vec<Range<u64>> {
    let ticks = |time: Time| at(time.span()).as_ticks();
    let interval = (errors.interval * 1000).max(ON_THE_BUS);
    // Disturbed frames in the interval that begins with this one.
    let disturbed = |begin: u64| -> u64 {
        let all = scenario.bus.iter().filter_map(|event| match event {
            BusEvent::Corrupt { at, count, .. } => Some((ticks(*at), u64::from(*count))),
            _ => None,
        });
        let soon = all.filter(|(at, _)| (begin..begin + interval).contains(at));
        soon.map(|(_, count)| count).sum()
    };
    let times = scenario.bus.iter().filter_map(|event| match event {
        BusEvent::Frame {
            at, every, until, ..
        } => {
            let last = match (every, until) {
                (None, _) => ticks(*at),
                (_, Some(until)) => ticks(*until),
                (Some(_), None) => return Some(ticks(*at)..u64::MAX),
            };
            Some(ticks(*at)..last + ON_THE_BUS)
        }
        BusEvent::Corrupt { at, .. } if disturbed(ticks(*at)) > errors.burst => {
            Some(ticks(*at)..ticks(*at) + interval + ON_THE_BUS)
        }
        BusEvent::Dominant { at, hold, .. } if event_triggered || errors.is_none() => {
            Some(ticks(*at)..ticks(*at) + hold.span().as_ticks() + ON_THE_BUS)
        }
        _ => None,
    });
    times.collect()
}

/// The times in which a guardian keeps a node off the bus: each of its attempts to send fails at its first
/// bit, and is followed by the next one, which no rate of disturbed frames has.
fn kept_off(gates: &[GateChange], node: NodeIndex) -> Vec<Range<u64>> {
    let own = gates.iter().filter(|change| change.node == node);
    let mut times: Vec<Range<u64>> = Vec::new();
    let mut closed: Option<u64> = None;
    for change in own {
        match (closed, change.closed) {
            (None, true) => closed = Some(change.at.as_ticks()),
            (Some(from), false) => {
                times.push(from..change.at.as_ticks() + ON_THE_BUS);
                closed = None;
            }
            _ => {}
        }
    }
    times.extend(closed.map(|from| from..u64::MAX));
    times
}

/// The parts of a run outside these times.
fn without(run: &[u64], times: &[Range<u64>]) -> Vec<Vec<u64>> {
    let mut parts = vec![Vec::new()];
    for now in run {
        if times.iter().any(|times| times.contains(now)) {
            parts.push(Vec::new());
        } else if let Some(part) = parts.last_mut() {
            part.push(*now);
        }
    }
    parts.retain(|part| !part.is_empty());
    parts
}

/// Adds the outcome of a run under one timing model to the observations.
fn note(
    all: &mut BTreeMap<String, Observed>,
    Job {
        scenario, model, ..
    }: Job<'_>,
    (outcome, findings): &Followed,
    images: &[Image],
    strange: &[Range<u64>],
) -> Result<(), Error> {
    for (node, findings) in outcome.nodes.iter().zip(findings) {
        let name = node.name.as_str();
        let of_node = all.entry(name.to_owned()).or_default();
        let findings = lock(findings);
        let image = if findings
            .handlers
            .values()
            .any(|found| !found.refuted.is_empty())
        {
            let of_node = images.iter().find(|image| image.name == name);
            of_node.map(|image| wcet::image::Image::read(&image.path))
        } else {
            None
        };
        let image = image.transpose()?;
        let strange = [strange, &kept_off(&outcome.gates, node.node)].concat();
        let outside = |runs: &[Vec<u64>]| -> Vec<Entered> {
            let runs = runs.iter().flat_map(|run| without(run, &strange));
            runs.map(|at| Entered {
                scenario: scenario.name.clone(),
                at,
            })
            .collect()
        };
        for task in &node.load.tasks {
            let found = findings.handlers.get(&task.exception);
            observer::note(of_node, task, found, model, image.as_ref(), &outside);
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::{Findings, ON_THE_BUS, hold_transfers, kept_off, without};
    use can_bus::SimTime;
    use schedulability::transfers::{Transfers, Unit};
    use std::collections::BTreeMap;
    use twin::GateChange;
    use vehicle_model::NodeIndex;

    #[test]
    fn releases_of_a_node_that_is_kept_off_the_bus_are_not_held_against_the_table() {
        let change = |at: u64, node: usize, closed: bool| GateChange {
            at: SimTime::from_ticks(at),
            node: NodeIndex(node),
            closed,
        };
        let gates = [
            change(1000, 0, true),
            change(1500, 1, true),
            change(3000, 0, false),
            change(4000, 2, true),
        ];
        let released = [900, 1000, 2999, 3000 + ON_THE_BUS, 3001 + ON_THE_BUS];
        let held = without(&released, &kept_off(&gates, NodeIndex(0)));
        assert_eq!(
            held,
            [vec![900], vec![3000 + ON_THE_BUS, 3001 + ON_THE_BUS]]
        );
        // To the end, as the gate stays closed.
        let held = without(&released, &kept_off(&gates, NodeIndex(1)));
        assert_eq!(held, [vec![900, 1000]]);
        assert_eq!(kept_off(&gates, NodeIndex(3)), []);
    }

    #[test]
    fn a_transfer_that_the_task_table_omits_fails_the_run() {
        let unit = |name: &str| Unit::try_from(name.to_owned()).unwrap();
        let micros = |all: &[u64]| all.iter().map(|at| at * 1_000_000).collect::<Vec<u64>>();
        let findings = Findings {
            transfers: BTreeMap::from([(
                unit("DMA1 stream 6"),
                vec![vec![], micros(&[0, 1, 87, 174, 261])],
            )]),
            ..Findings::default()
        };
        let said = |text: &str| {
            let table: Transfers = toml::from_str(text).unwrap();
            hold_transfers("gps", &table, "busy", &findings)
                .err()
                .map(|error| error.to_string())
        };
        let console = |rest: &str| format!("\"DMA1 stream 6\" = {{ every_us = 86{rest} }}");
        assert_eq!(said(&console(", jitter_us = 86")), None);
        assert_eq!(
            said(&console("")).unwrap(),
            "gps is not as analysed: DMA1, stream or channel 6, begins 2 transfers within 1.00 us, 0.00 us after \
             power-on in busy, and `dma` in the task table allows 1"
        );
        assert_eq!(
            said("\"DMA1 stream 5\" = { every_us = 1 }").unwrap(),
            "gps is not as analysed: DMA1, stream or channel 6, begins 1 transfers within 0.00 us, 0.00 us after \
             power-on in busy, and `dma` in the task table allows 0"
        );
    }

    #[test]
    fn times_with_foreign_frames_are_left_out() {
        let run = [1, 4, 5, 6, 9];
        assert_eq!(super::without(&run, &[]), [run.to_vec()]);
        assert_eq!(super::without(&run, &[4..6, 30..40]), [vec![1], vec![6, 9]]);
        assert_eq!(super::without(&run, &[0..5, 9..20]), [vec![5, 6]]);
    }

    #[test]
    fn the_scenario_is_one() {
        let workspace = crate::Workspace::find().unwrap();
        let vehicle = crate::vehicle::find(&workspace, "uagv").unwrap();
        super::scenarios(&vehicle).unwrap();
    }
}
