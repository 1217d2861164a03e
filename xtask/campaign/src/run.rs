//! Many sequences on all cores.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc;

use twin::{Images, Twin, TwinError};
use vehicle_model::{NodeIndex, Vehicle};
use world::{SimDuration, SimTime};

use crate::attack::{Attacker, Tally};
use crate::options::{Options, Shard, Trouble};
use crate::report::{Campaign, Report, Verdict};
use crate::rules::{self, Violation, judge};
use crate::sequence::{END, Sequence};

/// How far it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Progress {
    /// Sequences done.
    pub done: u64,
    /// Sequences to be done here.
    pub all: u64,
    /// Sequences that broke a rule so far.
    pub failed: u64,
}

/// Runs the sequence of one seed.
///
/// # Errors
/// When an image is no program for its node's microcontroller.
pub fn replay(
    vehicle: &Vehicle,
    seed: u64,
    images: &Images,
    trouble: Trouble,
) -> Result<Verdict, TwinError> {
    let sequence = match trouble {
        Trouble::Faults => Sequence::draw(vehicle, seed),
        Trouble::Attacks { key } => Sequence::attacked(vehicle, seed, key),
    };
    play(vehicle, sequence, images)
}

/// Runs a sequence, drawn or made otherwise.
///
/// # Errors
/// As [`replay`].
pub fn play(vehicle: &Vehicle, sequence: Sequence, images: &Images) -> Result<Verdict, TwinError> {
    // Judges the images only: a fault of the simulation is a failure with a seed too.
    let judged = catch_unwind(AssertUnwindSafe(|| drive(vehicle, &sequence, images)));
    let alone = |violation| (vec![violation], Tally::default());
    let (violations, tally) = match judged {
        Ok(Ok(judged)) => judged,
        Ok(Err(TwinError::Violation { node, violation })) => alone(Violation {
            rule: "silicon".into(),
            at: violation.at.as_ticks() as f64 * 1e-12,
            what: format!("{node}: {violation}"),
        }),
        Ok(Err(error)) => return Err(error),
        Err(panic) => {
            let text = panic.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
            alone(Violation {
                rule: rules::SIMULATION.into(),
                at: 0.0,
                what: text.unwrap_or("the simulation ended").to_owned(),
            })
        }
    };
    Ok(Verdict {
        seed: sequence.seed,
        story: sequence.story,
        violations,
        tally,
    })
}

/// Time at which an attacker joins the bus, s: it records what the nodes send from then on.
const JOIN: f64 = 1.0;

fn drive(
    vehicle: &Vehicle,
    sequence: &Sequence,
    images: &Images,
) -> Result<(Vec<Violation>, Tally), TwinError> {
    let mut twin = Twin::new(vehicle, &sequence.scenario, sequence.seed, images)?;
    let upsets = sequence.upsets.iter();
    let mut events: Vec<(f64, Event)> = upsets
        .map(|upset| (upset.at, Event::Strike(upset.node, stall)))
        .collect();
    let losses = sequence.clock_losses.iter();
    events.extend(losses.map(|loss| (loss.at, Event::Strike(loss.node, stop_clock))));
    if !sequence.attacks.is_empty() {
        events.push((JOIN, Event::Join));
        let steps = Attacker::steps(&sequence.attacks).into_iter();
        events.extend(steps.map(|at| (at, Event::Decide)));
    }
    events.sort_by(|one, other| one.0.total_cmp(&other.0));
    let mut attacker = None;
    for (at, event) in events {
        twin.run_until(instant(at).max(twin.now()))?;
        match (event, &mut attacker) {
            (Event::Strike(node, strike), _) => strike(&mut twin, node)?,
            (Event::Decide, Some(attacker)) => Attacker::decide(attacker, &mut twin),
            (Event::Join | Event::Decide, _) => {
                let (attacks, seed) = (&sequence.attacks, sequence.seed);
                attacker = Some(Attacker::join(vehicle, attacks, seed, &mut twin));
            }
        }
    }
    twin.run_until(instant(END))?;
    let outcome = twin.finish();
    Ok(match attacker {
        None => (judge(vehicle, sequence, &outcome), Tally::default()),
        Some(attacker) => rules::attacked(vehicle, sequence, &outcome, &attacker.finish()),
    })
}

/// What happens between two steps of the simulation.
enum Event {
    Strike(NodeIndex, Strike),
    /// The attacker joins the bus.
    Join,
    /// The attacker decides what it sends next.
    Decide,
}

/// A fault that is applied to a node between two steps of the simulation.
type Strike = fn(&mut Twin, NodeIndex) -> Result<(), TwinError>;

/// Stops the external clock of a node, if it runs on it at this moment.
fn stop_clock(twin: &mut Twin, node: NodeIndex) -> Result<(), TwinError> {
    twin.node_mut(node).lose_external_clock();
    Ok(())
}

/// Stalls a core in its next interrupt. A node without an interrupt in 30 ms is stalled already.
///
/// # Errors
/// As [`Twin::run_until`].
///
/// # Panics
/// Never: every board has RAM at the lower end of its call stack.
pub fn stall(twin: &mut Twin, node: NodeIndex) -> Result<(), TwinError> {
    // A branch to itself where the call stack would end: no program comes that far.
    let trap = twin.sled(node).stack.base;
    // An interrupt in a conditional block of up to four instructions may skip the first ones.
    let written = twin
        .node_mut(node)
        .set_memory(trap, &[0xFE, 0xE7].repeat(5));
    assert!(written, "{trap:#x} is RAM");
    let end = twin.now() + SimDuration::from_ticks(30_000_000_000);
    while twin.now() < end {
        let next = twin.now() + SimDuration::from_ticks(3_000_000);
        twin.run_until(next)?;
        // Exceptions from 16 on are interrupts of the device (ARMv7-M).
        if twin.node(node).exception() >= 16 {
            twin.node_mut(node).set_register(15, trap);
            return Ok(());
        }
    }
    Ok(())
}

fn instant(seconds: f64) -> SimTime {
    SimTime::from_ticks((seconds * 1e12).round() as u64)
}

/// Runs the sequences of a shard that are not among the `earlier` ones; `each` is called after each of
/// them, and says whether further ones are of use. The report has those that were run.
///
/// # Errors
/// When an image is no program for its node's microcontroller.
pub fn run(
    vehicle: &Vehicle,
    images: &Images,
    options: &Options,
    earlier: Vec<Verdict>,
    mut each: impl FnMut(&Verdict, Progress) -> ControlFlow<()>,
) -> Result<Report, TwinError> {
    let Shard { index, of } = options.shard;
    let all = options.shard.sequences(options.sequences);
    let done: BTreeSet<u64> = earlier.iter().map(|verdict| verdict.seed).collect();
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = options.threads.unwrap_or(cores).max(1);
    let next = AtomicU64::new(0);
    let (sender, verdicts) = mpsc::channel();
    let campaign = Campaign::new(vehicle, images, options);
    let mut report = Report::new(campaign, options.shard);
    earlier.into_iter().for_each(|verdict| report.take(verdict));
    std::thread::scope(|scope| {
        for _ in 0..threads {
            let (sender, next, done) = (sender.clone(), &next, &done);
            scope.spawn(move || {
                loop {
                    let turn = next.fetch_add(1, Ordering::Relaxed);
                    if turn >= all {
                        return;
                    }
                    let number = turn * of + index - 1;
                    let seed = options.seed.wrapping_add(number);
                    if done.contains(&seed) {
                        continue;
                    }
                    let verdict = replay(vehicle, seed, images, options.trouble);
                    let broken = verdict.is_err();
                    if sender.send(verdict).is_err() || broken {
                        return;
                    }
                }
            });
        }
        drop(sender);
        for verdict in verdicts {
            let verdict = verdict?;
            let failed = report.failures.len() as u64 + u64::from(!verdict.violations.is_empty());
            let progress = Progress {
                done: report.sequences + 1,
                all,
                failed,
            };
            let go_on = each(&verdict, progress);
            report.take(verdict);
            if go_on.is_break() {
                next.store(all, Ordering::Relaxed);
                break;
            }
        }
        Ok(())
    })?;
    report.finish();
    Ok(report)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_are_read_and_others_refused() {
        assert_eq!("2/8".parse(), Ok(Shard { index: 2, of: 8 }));
        for text in ["0/8", "9/8", "2", "a/b", "1/0", "-1/2", "1/2/3"] {
            let error = text.parse::<Shard>().unwrap_err();
            assert!(error.to_string().contains(text), "{error}");
        }
    }
}
