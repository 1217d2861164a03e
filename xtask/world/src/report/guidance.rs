//! How closely the vehicle followed the line, and how it stopped.

use std::collections::BTreeMap;

use super::Run;
use super::figures::{AutonomousRun, StopFigures, rounded};
use crate::receiver::Fix;
use crate::record::StateSample;
use crate::time::Span as _;
use crate::time::{SimTime, at, seconds};

/// The cross-track error that counts as settled, metres.
pub const BAND: f64 = 0.05;

/// Time for which the error must stay within the band, seconds, so that merely crossing the line
/// does not count.
const HOLD: f64 = 3.0;

/// Start and end of each time span in an autonomous mode.
pub(super) fn autonomous_spans(run: &Run) -> Vec<(SimTime, SimTime)> {
    let mut spans = Vec::new();
    let mut begun = None;
    for change in run.modes {
        match (begun, change.autonomous) {
            (None, true) => begun = Some(change.at),
            (Some(from), false) => {
                spans.push((from, change.at));
                begun = None;
            }
            _ => {}
        }
    }
    if let Some(from) = begun {
        spans.push((from, at(run.duration)));
    }
    spans
}

/// Time and cross-track error of each state: of the path, or of the line without one.
pub(super) fn errors<'a>(run: &'a Run) -> impl Iterator<Item = (f64, f64)> + 'a {
    let line = run.scenario.line.iter();
    line.flat_map(|line| {
        run.states.iter().enumerate().map(|(index, state)| {
            let located = run.located(index);
            let error = located.map_or_else(
                || line.locate(state.north, state.east).1,
                |located| located.right,
            );
            (seconds(state.at), error)
        })
    })
}

/// Where the approach of settled errors, with their times, is over: where they first pass their mean.
#[must_use]
pub fn approached(errors: &[(f64, f64)]) -> usize {
    let mean = errors.iter().map(|(_, error)| error).sum::<f64>() / errors.len().max(1) as f64;
    let side = |error: f64| error > mean;
    let mut errors = errors.iter().map(|(_, error)| side(*error));
    let first = errors.next();
    errors
        .position(|side| Some(side) != first)
        .map_or(0, |later| later + 1)
}

/// The index from which the errors (time in seconds, cross-track error in metres, in order of time)
/// stay within [`BAND`] for at least 3 s; `None` if they never do.
#[must_use]
pub fn settled(errors: &[(f64, f64)]) -> Option<usize> {
    let mut candidate: Option<usize> = None;
    for (i, (time, error)) in errors.iter().enumerate() {
        if error.abs() > BAND {
            candidate = None;
            continue;
        }
        let first = *candidate.get_or_insert(i);
        if time - errors[first].0 >= HOLD - 1e-9 {
            return Some(first);
        }
    }
    None
}

/// Changes of sign between consecutive nonzero efforts.
fn reversals(states: &[StateSample]) -> usize {
    let signs: Vec<bool> = states
        .iter()
        .filter(|state| state.steering_effort != 0.0)
        .map(|state| state.steering_effort > 0.0)
        .collect();
    signs.windows(2).filter(|pair| pair[0] != pair[1]).count()
}

pub(super) fn autonomous_runs(run: &Run) -> Vec<AutonomousRun> {
    let all: Vec<(f64, f64)> = errors(run).collect();
    autonomous_spans(run)
        .into_iter()
        .filter_map(|(from, until)| {
            let begin = run.states.partition_point(|state| state.at < from);
            let end = run.states.partition_point(|state| state.at <= until);
            let errors = all.get(begin..end)?;
            let initial = errors.first()?.1;
            let side = if initial < 0.0 { 1.0 } else { -1.0 };
            let overshoot = errors
                .iter()
                .map(|(_, error)| side * error)
                .fold(0.0, f64::max);
            let first = settled(errors);
            let steady = first
                .and_then(|first| errors.get(first..))
                .unwrap_or_default();
            let states = first.and_then(|first| run.states.get(begin + first..end));
            let count = steady.len() as f64;
            let mean = steady.iter().map(|(_, error)| error).sum::<f64>() / count;
            let variance = steady
                .iter()
                .map(|(_, error)| (error - mean) * (error - mean))
                .sum::<f64>()
                / count;
            // The first of them lie near the edge of the band, because the vehicle still approaches.
            let largest = steady[approached(steady)..]
                .iter()
                .map(|(_, error)| error.abs())
                .fold(0.0, f64::max);
            let if_settled = |value: f64| first.map(|_| value);
            let span = steady.last().map_or(0.0, |last| last.0 - steady[0].0);
            Some(AutonomousRun {
                from_seconds: rounded(seconds(from), 6),
                until_seconds: rounded(seconds(until), 6),
                initial_cross_track_error_cm: rounded(initial * 100.0, 3),
                settling_seconds: first
                    .map(|first| rounded((errors[first].0 - seconds(from)).max(0.0), 3)),
                mean_cross_track_error_cm: if_settled(rounded(mean * 100.0, 3)),
                standard_deviation_cm: if_settled(rounded(libm::sqrt(variance) * 100.0, 3)),
                largest_cross_track_error_cm: if_settled(rounded(largest * 100.0, 3)),
                overshoot_cm: rounded(overshoot * 100.0, 3),
                steering_reversals_per_second: states
                    .map(|states| rounded(reversals(states) as f64 / span, 3)),
            })
        })
        .collect()
}

/// True if the effort of every motor is zero at `when`.
fn standing(run: &Run, when: SimTime) -> bool {
    let rests = run.rover.map_or(&[][..], |rover| rover.drive.rests());
    let last = rests.partition_point(|(at, _)| *at <= when).checked_sub(1);
    if last.is_some_and(|last| !rests[last].1) {
        return false;
    }
    let mut efforts = BTreeMap::new();
    for change in run.efforts.iter().take_while(|change| change.at <= when) {
        efforts.insert(change.node, change.effort);
    }
    efforts.values().all(|effort| *effort == 0.0)
}

/// The instants at which a motor's effort changes, in order.
fn moments(run: &Run) -> Vec<SimTime> {
    let rests = run.rover.map_or(&[][..], |rover| rover.drive.rests());
    let mut moments: Vec<SimTime> = run.efforts.iter().map(|change| change.at).collect();
    moments.extend(rests.iter().map(|(at, _)| *at));
    moments.sort();
    moments
}

/// The first instant from `after` on at which no motor has an effort; `None` if there is none.
pub(super) fn rest(run: &Run, after: SimTime) -> Option<SimTime> {
    let later = moments(run).into_iter().filter(|moment| *moment > after);
    let mut candidates = [after].into_iter().chain(later);
    candidates.find(|moment| standing(run, *moment))
}

pub(super) fn stops(run: &Run) -> Vec<StopFigures> {
    let mut events: Vec<(SimTime, String)> = run
        .scenario
        .reset
        .iter()
        .map(|reset| {
            let node = &run.nodes[reset.node.0];
            (at(reset.at.span()), format!("{node} held in reset"))
        })
        .collect();
    let receiver = run.scenario.receiver.as_ref();
    let mut fix = receiver.map_or(Fix::None, |receiver| receiver.fix);
    let mut changes = run.scenario.fix.clone();
    changes.sort_by(|a, b| a.at.get().total_cmp(&b.at.get()));
    for change in changes {
        if fix == Fix::Fixed && change.state != Fix::Fixed {
            events.push((
                at(change.at.span()),
                format!("fix lost ({})", change.state.name()),
            ));
        }
        fix = change.state;
    }
    events.sort();
    events.retain(|(when, _)| *when < at(run.duration));

    let ends = events
        .iter()
        .skip(1)
        .map(|(when, _)| *when)
        .chain([at(run.duration)]);
    let moments = moments(run);
    events
        .iter()
        .zip(ends)
        .map(|((when, event), end)| {
            let moments = moments.iter().copied();
            let stopped = [*when]
                .into_iter()
                .chain(moments.filter(|moment| moment > when && *moment < end))
                .find(|moment| standing(run, *moment));
            let guides = run.crop.map_or(&[][..], |crop| crop.guides);
            let mut next = guides
                .iter()
                .filter(|guide| (*when..end).contains(&guide.at));
            let next = next.next().filter(|_| stopped.is_none());
            StopFigures {
                event: event.clone(),
                at_seconds: rounded(seconds(*when), 6),
                motors_stopped_after_ms: stopped
                    .map(|moment| rounded((seconds(moment) - seconds(*when)) * 1e3, 3)),
                guided_on_by: next.map(|guide| guide.mode.clone()),
            }
        })
        .collect()
}
