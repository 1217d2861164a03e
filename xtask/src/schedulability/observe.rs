//! Observes the tasks on the emulated vehicle: the longest time of each, and whether the
//! assumptions of the analysis hold.

use std::{
    collections::BTreeMap,
    ops::Range,
    sync::{Arc, Mutex},
    thread,
};
use world::time::{Span as _, at};

use schedulability::{
    node::{Observed, Seen},
    system::Programs,
};
use twin::{Outcome, Twin, mcu::FlashTiming, mcu::Mcu};
use vehicle_model::Vehicle;
use wcet::{cycles::Model, watch::Watch};
use world::{Scenario, scenario::BusEvent, time::seconds, units::Time};

use super::{
    Error,
    follow::{Findings, Follower, lock},
};
use crate::{
    Failure,
    build::{self, Image},
};

/// Scenario of the observed run, in the vehicle's folder.
const SCENARIO: &str = "busy.toml";
/// Seed of all random numbers of the run.
const SEED: u64 = 1;
/// Flash without wait states, and with those of the part.
const TIMINGS: [FlashTiming; 2] = [FlashTiming::Immediate, FlashTiming::WaitStates];

/// The outcome of a run, and the findings about each node in the order of the manifest.
type Followed = (Outcome, Vec<Arc<Mutex<Findings>>>);

/// Runs the vehicle under both timings and observes each node's handlers.
pub(super) fn observe(
    vehicle: &Vehicle,
    images: &[Image],
    programs: &Programs,
    progress: &mut (dyn FnMut(&str) + Send),
) -> Result<BTreeMap<String, Observed>, Failure> {
    let bytes = build::read(images)?;
    let scenario = scenario(vehicle)?;
    let progress = Mutex::new(progress);
    let run = |flash: FlashTiming| -> Result<Followed, Error> {
        let mut twin =
            Twin::with_flash(vehicle, &scenario, SEED, &bytes, flash).map_err(Error::from)?;
        let findings = vehicle.nodes().map(|node| {
            let name = &vehicle.node(node).name;
            let watches = programs.watches(name).map(|(_, watch)| watch);
            follow(twin.node_mut(node), watches)
        });
        let findings = findings.collect();
        let second = can_bus::SimDuration::from_ticks(1_000_000_000_000);
        twin.run_telling(scenario.duration.span(), second, &mut |now| {
            if let Ok(mut progress) = progress.lock() {
                let (now, end) = (seconds(now.now), seconds(now.end));
                progress(&format!("{now:.0} of {end:.0} s simulated"));
            }
        })
        .map_err(Error::from)?;
        for node in vehicle.nodes() {
            let name = &vehicle.node(node).name;
            let mcu = twin.node(node);
            hold(name, programs.lasting(name), |at| word(mcu, at))?;
        }
        Ok((twin.finish(), findings))
    };
    let outcomes = thread::scope(|scope| {
        let handles = TIMINGS.map(|flash| scope.spawn(move || run(flash)));
        handles.map(thread::ScopedJoinHandle::join)
    });
    let strange = strange(&scenario);
    let mut all = BTreeMap::new();
    for (model, outcome) in Model::ALL.into_iter().zip(outcomes) {
        let outcome = outcome.map_err(|_| Error::BrokenDown)??;
        note(&mut all, model, &outcome, images, &strange)?;
    }
    Ok(all)
}

/// Checks that words of a node's memory that the analysis takes for constant after start-up
/// still have their values at the end of the run.
///
/// # Errors
/// A word changed; the error says which one.
fn hold(
    node: &str,
    mut lasting: impl Iterator<Item = (u32, u32)>,
    read: impl Fn(u32) -> Option<u32>,
) -> Result<(), Error> {
    match lasting.find(|&(address, word)| read(address) != Some(word)) {
        None => Ok(()),
        Some((address, left)) => Err(Error::Changed {
            node: node.into(),
            address,
            left,
            found: read(address).unwrap_or_default(),
        }),
    }
}

fn word(mcu: &Mcu, address: u32) -> Option<u32> {
    let bytes = mcu.memory(address, 4)?;
    Some(u32::from_le_bytes(bytes.try_into().ok()?))
}

/// Follows a core from now on. Each handler is compared with the watch that was made for its
/// address.
pub fn follow<'w>(
    mcu: &mut Mcu,
    watches: impl Iterator<Item = &'w Arc<Watch>>,
) -> Arc<Mutex<Findings>> {
    let by_address: BTreeMap<u32, &Arc<Watch>> =
        watches.map(|watch| (watch.entry(), watch)).collect();
    let by_exception = (1..=u16::from(u8::MAX)).filter_map(|number| {
        let (address, _) = mcu.image().handler(number)?;
        Some((number, Arc::clone(by_address.get(&address)?)))
    });
    let follower = Follower::new(by_exception.collect());
    let findings = follower.findings();
    mcu.set_trace(Some(follower.trace()));
    findings
}

fn scenario(vehicle: &Vehicle) -> Result<Scenario, Error> {
    let path = vehicle.folder().join(SCENARIO);
    Ok(Scenario::find(vehicle, &path.to_string_lossy())?)
}

/// How long after a foreign frame is queued it is on the bus at the latest, picoseconds.
const ON_THE_BUS: u64 = 100_000_000_000;

/// The times of a run, in picoseconds, in which foreign frames are on the bus. The analysis has
/// none, so in these times more jobs are released than it counts.
fn strange(scenario: &Scenario) -> Vec<Range<u64>> {
    let ticks = |time: Time| at(time.span()).as_ticks();
    let frames = scenario.bus.iter().filter_map(|event| match event {
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
        _ => None,
    });
    frames.collect()
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
    model: Model,
    (outcome, findings): &Followed,
    images: &[Image],
    strange: &[Range<u64>],
) -> Result<(), Error> {
    for (node, findings) in outcome.nodes.iter().zip(findings) {
        let name = node.name.as_str();
        let of_node = all.entry(name.to_owned()).or_default();
        let findings = lock(findings);
        let image = if findings.values().any(|found| !found.refuted.is_empty()) {
            let of_node = images.iter().find(|image| image.name == name);
            of_node.map(|image| wcet::image::Image::read(&image.path))
        } else {
            None
        };
        let image = image.transpose()?;
        for task in &node.load.tasks {
            let seen: &mut Seen = of_node.entry(task.name.clone()).or_default();
            seen.longest[model] = seen.longest[model].max(task.longest);
            let Some(found) = findings.get(&task.exception) else {
                continue;
            };
            seen.followed += found.activations;
            let runs = found.entered.iter();
            seen.entered
                .extend(runs.flat_map(|run| without(run, strange)));
            if let Some(image) = &image {
                let sentences = found.refuted.iter().map(|refuted| refuted.sentence(image));
                seen.refuted.extend(sentences);
            }
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_word_that_changed_is_told() {
        let lasting = [(0x2000_0000, 7), (0x2000_0004, 0x2000_0100)];
        let read = |last: u32| {
            move |at: u32| {
                [Some(7), Some(last)]
                    .get((at as usize & 0xff) / 4)
                    .copied()?
            }
        };
        assert!(super::hold("gps", lasting.into_iter(), read(0x2000_0100)).is_ok());
        let changed = super::hold("gps", lasting.into_iter(), read(9)).unwrap_err();
        assert_eq!(
            changed.to_string(),
            "gps is not as analysed: the word at 0x20000004, which start-up leaves at 0x20000100 for good, holds 0x00000009 at the end of the run"
        );
        // Outside all memory.
        assert!(super::hold("gps", [(0x40, 1)].into_iter(), |_| None).is_err());
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
        super::scenario(&vehicle).unwrap();
    }
}
