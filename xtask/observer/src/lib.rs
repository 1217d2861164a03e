//! Holds runs on emulated microcontrollers against what the analysis says of their images: the longest time
//! of each handler, its releases, and whether the run leaves the analysed paths.
//!
//! [`follow`] attaches a [`follower`] to a microcontroller; [`note`] adds what it found to the observations
//! that the analysis takes. [`slow_down`] makes its core the slowest that the manual allows, which is the one
//! that bounds as flashed are for.

pub mod follower;

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};

use schedulability::node::{Entered, Observed, Seen};
use twin::mcu::{Executed, Mcu};
use twin::statistics::TaskTimes;
use wcet::cycles::Model;
use wcet::image::Image;
use wcet::lasting::Known;
use wcet::slowest::Slowest;
use wcet::timing::Timing;
use wcet::watch::Watch;

use follower::{Findings, Follower, Found};

/// Follows a core from now on. Each handler is compared with the watch that was made for its
/// address. `known` is what its memory is taken to keep. The releases of a handler are not noted until
/// `start_up` picoseconds after the first handler behind each start.
pub fn follow<'w>(
    mcu: &mut Mcu,
    watches: impl Iterator<Item = &'w Arc<Watch>>,
    known: Known,
    start_up: u64,
) -> Arc<Mutex<Findings>> {
    let by_address: BTreeMap<u32, &Arc<Watch>> =
        watches.map(|watch| (watch.entry(), watch)).collect();
    let by_exception = (1..=u16::from(u8::MAX)).filter_map(|number| {
        let (address, _) = mcu.image().handler(number)?;
        Some((number, Arc::clone(by_address.get(&address)?)))
    });
    let by_exception = by_exception.collect();
    let words = known.lasting.keys().chain(known.choices.keys());
    mcu.watch_stores(&words.copied().collect());
    mcu.watch_transfers();
    let follower = Follower::new(by_exception, known, start_up);
    let findings = follower.findings();
    mcu.set_trace(Some(follower.trace()));
    findings
}

/// Lets a core take from now on, for each instruction, the most cycles that its manual allows. `timing` is that of
/// its part as flashed.
pub fn slow_down(mcu: &mut Mcu, timing: Timing) {
    let program = mcu.image();
    let mut slowest = Slowest::new(timing, mcu.part().flash.base, program.flash());
    mcu.set_slower(Some(Box::new(move |executed| match executed {
        Some(Executed { at, next }) => slowest.later(at, next),
        None => {
            slowest.forget();
            0
        }
    })));
}

/// Adds what a run under timing `model` showed of one handler. `runs` makes of the times at which it was
/// entered, for each start of the node, the runs that the arrival model is held against. `image` is needed where
/// the run left the analysed paths.
pub fn note(
    all: &mut Observed,
    task: &TaskTimes,
    found: Option<&Found>,
    model: Model,
    image: Option<&Image>,
    runs: &dyn Fn(&[Vec<u64>]) -> Vec<Entered>,
) {
    let seen: &mut Seen = all.entry(task.name.clone()).or_default();
    let alone = match model {
        Model::ZeroWait => task.longest,
        Model::Flashed => {
            for (&times, &cycles) in task.by_preemptions.range(1..) {
                let longest = seen.preempted.entry(times).or_default();
                *longest = (*longest).max(cycles);
            }
            task.by_preemptions.get(&0).copied().unwrap_or(0)
        }
    };
    seen.longest[model] = seen.longest[model].max(alone);
    let Some(found) = found else {
        return;
    };
    seen.followed += found.activations;
    seen.entered.extend(runs(&found.entered));
    if let Some(image) = image {
        let sentences = found.refuted.iter().map(|refuted| refuted.sentence(image));
        seen.refuted.extend(sentences);
    }
}
