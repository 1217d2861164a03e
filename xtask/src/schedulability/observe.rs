//! The longest time that each task takes on the emulated vehicle.

use std::{collections::BTreeMap, fs, sync::Mutex, thread};

use schedulability::node::Observed;
use twin::{Images, Options, Outcome, mcu::FlashTiming};
use world::{Scenario, time::seconds};

use crate::{Failure, Node, build::Image};

/// What is driven.
const SCENARIO: &str = include_str!("busy.toml");

/// Flash without wait states, and as the parts have it.
const TIMINGS: [FlashTiming; 2] = [FlashTiming::Immediate, FlashTiming::WaitStates];

/// Longest times by node and interrupt, in cycles, without exception entry and
/// return.
pub(super) fn longest(
    images: &[Image],
    progress: &mut (dyn FnMut(&str) + Send),
) -> Result<BTreeMap<String, Observed>, Failure> {
    let images = read(images)?;
    let scenario = scenario()?;
    let progress = Mutex::new(progress);
    let run = |flash: FlashTiming| {
        let options = Options {
            flash,
            ..Options::default()
        };
        twin::run(&scenario, &images, &options, |now| {
            if let Ok(mut progress) = progress.lock() {
                let (now, end) = (seconds(now.now), seconds(now.end));
                progress(&format!("{now:.0} of {end:.0} s simulated"));
            }
        })
    };
    let outcomes = thread::scope(|scope| {
        let handles = TIMINGS.map(|flash| scope.spawn(move || run(flash)));
        handles.map(thread::ScopedJoinHandle::join)
    });
    let mut all = BTreeMap::new();
    for (model, outcome) in outcomes.into_iter().enumerate() {
        let outcome = outcome
            .map_err(|_| Failure::Failed("the simulation broke down".into()))?
            .map_err(|error| Failure::Failed(error.to_string()))?;
        note(&mut all, model, &outcome);
    }
    Ok(all)
}

fn scenario() -> Result<Scenario, Failure> {
    Scenario::parse("busy", "busy.toml", SCENARIO)
        .map_err(|error| Failure::Failed(error.to_string()))
}

fn note(all: &mut BTreeMap<String, Observed>, model: usize, outcome: &Outcome) {
    for node in &outcome.nodes {
        let of_node = all.entry(node.node.name().to_owned()).or_default();
        for task in &node.load.tasks {
            let seen = of_node.entry(task.name.clone()).or_default();
            seen[model] = seen[model].max(task.longest);
        }
    }
}

fn read(images: &[Image]) -> Result<Images, Failure> {
    let bytes = |node: Node| -> Result<Vec<u8>, Failure> {
        let found = images.iter().find(|image| image.node == node);
        let image = found
            .ok_or_else(|| Failure::Failed(format!("there is no image of {}", node.name())))?;
        fs::read(&image.path).map_err(|error| {
            Failure::Failed(format!("{} cannot be read: {error}", image.path.display()))
        })
    };
    Ok(Images {
        gps: bytes(Node::Gps)?,
        controller: bytes(Node::Controller)?,
        steering: bytes(Node::Steering)?,
        drive: bytes(Node::Drive)?,
    })
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_scenario_is_one() {
        super::scenario().unwrap();
    }
}
