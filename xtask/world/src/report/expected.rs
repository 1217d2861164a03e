//! Whether a run shows what its scenario expects.

use core::fmt;

use serde::Serialize;

use super::figures::rounded;
use super::{FrameRecord, Run, Summary, guidance};
use crate::scenario::{Expectation, Figure};
use crate::time::{SimDuration, SimTime, Span as _, at, from_seconds, seconds, span_seconds};
use crate::units::Time;

/// The name of the value that a frame carries in a signal; `None` if it has no such signal.
pub type Decode<'a> = &'a dyn Fn(&FrameRecord, &str) -> Option<String>;

/// What is none on a clean bus.
const BUS: [Figure; 4] = [
    Figure::MissedWindows,
    Figure::MisplacedFrames,
    Figure::ForeignFrames,
    Figure::ErrorFrames,
];

/// Whether a run shows something.
#[derive(Copy, Clone, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Judgement {
    /// It does.
    Met,
    /// It does not.
    Failed,
    /// The run ended before.
    Open,
}

impl fmt::Display for Judgement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Met => "met",
            Self::Failed => "failed",
            Self::Open => "open",
        })
    }
}

/// An expectation of the scenario and what the run shows.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExpectationFigures {
    /// What is expected, in words.
    pub expected: String,
    /// Whether the run shows it.
    pub judgement: Judgement,
    /// What it shows, in words.
    pub seen: String,
}

impl fmt::Display for ExpectationFigures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "expected {}; seen: {}", self.expected, self.seen)
    }
}

/// Judges all expectations of the scenario, in their order.
#[must_use]
pub fn expectations(run: &Run, summary: &Summary, decode: Decode<'_>) -> Vec<ExpectationFigures> {
    let each = run.scenario.expect.iter();
    each.map(|expectation| {
        let end = span_seconds(run.duration);
        // A period that begins with the end of the run has nothing in it.
        let early = expectation.judged_at().is_some_and(|at| at > end)
            || expectation.begins_at().is_some_and(|from| from >= end);
        let (judgement, seen) = if early || is_open(expectation, run, summary) {
            let seen = format!("the run ended at {}", Time::new(end));
            (Judgement::Open, seen)
        } else {
            match judge(expectation, run, summary, decode) {
                Ok(seen) => (Judgement::Met, seen),
                Err(seen) => (Judgement::Failed, seen),
            }
        };
        ExpectationFigures {
            expected: expectation.to_string(),
            judgement,
            seen,
        }
    })
    .collect()
}

/// Whether the rest of a run that was cut could still decide.
fn is_open(expectation: &Expectation, run: &Run, summary: &Summary) -> bool {
    let whole = run.scenario.duration.span();
    if run.duration >= whole {
        return false;
    }
    match expectation {
        Expectation::Frames {
            message,
            from,
            until: None,
            most,
            ..
        } => {
            let count = frames(run, message, *from, None).count() as u64;
            count <= most.unwrap_or(u64::MAX)
        }
        Expectation::CleanBus {} => summary.bus.frames == 0,
        _ => false,
    }
}

/// The longest time without a reference on a bus that has had one, if a basic cycle is missing there.
fn without_reference(run: &Run) -> Option<String> {
    let begins: Vec<SimTime> = run.references().map(|frame| frame.start).collect();
    let ends = begins.iter().skip(1).copied().chain([at(run.duration)]);
    let gaps = begins.iter().zip(ends);
    let (from, gap) = gaps
        .map(|(from, until)| (*from, crate::time::since(until, *from)))
        .max_by_key(|(_, gap)| *gap)?;
    let cycle = run.basic_cycle;
    (gap > cycle + cycle / 2).then(|| {
        format!(
            "no reference for {} from {} on",
            Time::new(rounded(span_seconds(gap), 3)),
            when(from)
        )
    })
}

/// A time of the run in words.
fn when(at: SimTime) -> Time {
    Time::new(rounded(seconds(at), 6))
}

/// The frames of a message that began in a span of time and were sent to their end.
fn frames<'r>(
    run: &'r Run,
    message: &str,
    from: Time,
    until: Option<Time>,
) -> impl Iterator<Item = &'r FrameRecord> {
    let id = run
        .windows
        .iter()
        .find(|window| window.message == message)
        .map(|window| window.id);
    let begin = instant(from);
    let end = until.map_or_else(|| at(run.duration), instant);
    run.frames
        .iter()
        .filter(move |frame| frame.is_message() && Some(frame.id) == id)
        .filter(move |frame| (begin..=end).contains(&frame.start))
}

fn instant(time: Time) -> SimTime {
    at(from_seconds(time.get()))
}

/// What is seen, as `Err` if it is not what is expected.
fn judge(
    expectation: &Expectation,
    run: &Run,
    summary: &Summary,
    decode: Decode<'_>,
) -> Result<String, String> {
    match expectation {
        Expectation::Mode { at, mode } => {
            let before = run.modes.iter().rev();
            let mut before = before.skip_while(|change| change.at > instant(*at));
            let Some(change) = before.next() else {
                return Err("no mode was told until then".into());
            };
            let seen = format!("{} since {}", change.mode, when(change.at));
            verdict(change.mode == *mode, seen)
        }
        Expectation::Error { from, until, below } => {
            let end = until.map_or_else(|| span_seconds(run.duration), Time::get);
            let all = errors(run).into_iter();
            let inside = all.filter(|(time, _)| (from.get()..=end).contains(time));
            let largest = inside.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
            let Some((time, error)) = largest else {
                return Err("the vehicle has no line or row there".into());
            };
            let seen = format!("{:.2} cm at {time:.2} s", error * 100.0);
            verdict(error.abs() < below.get(), seen)
        }
        Expectation::Stop { after, within } => {
            let (after, within) = (instant(*after), from_seconds(within.get()));
            match guidance::rest(run, after) {
                None => Err("the motors were not at rest until the end of the run".into()),
                Some(at) => {
                    let took = crate::time::since(at, after);
                    verdict(took <= within, stopped(took))
                }
            }
        }
        Expectation::Frames {
            message,
            from,
            until,
            least,
            most,
        } => {
            let count = frames(run, message, *from, *until).count() as u64;
            let accepted = *least..=most.unwrap_or(u64::MAX);
            verdict(accepted.contains(&count), format!("{count} of them"))
        }
        Expectation::Signal {
            message,
            signal,
            value,
            from,
            until,
        } => {
            let mut count = 0_u64;
            for frame in frames(run, message, *from, *until) {
                count += 1;
                let seen = decode(frame, signal).unwrap_or_else(|| "another length".into());
                if seen != *value {
                    return Err(format!("{seen} at {}", when(frame.start)));
                }
            }
            verdict(count > 0, format!("{count} frames of it"))
        }
        Expectation::CleanBus {} => {
            let counts = BUS.map(|figure| (figure, counted(figure, summary)));
            let mut wrong: Vec<String> = counts
                .iter()
                .filter(|(_, count)| *count > 0)
                .map(|(figure, count)| format!("{count} {figure}"))
                .collect();
            if summary.bus.frames == 0 {
                wrong.push("no frame at all".into());
            }
            wrong.extend(without_reference(run));
            match wrong.is_empty() {
                true => Ok(format!("{} frames, all as planned", summary.bus.frames)),
                false => Err(wrong.join(", ")),
            }
        }
        Expectation::Count { of, most } => {
            let count = counted(*of, summary);
            verdict(count <= *most, format!("{count} of them"))
        }
    }
}

fn verdict(met: bool, seen: String) -> Result<String, String> {
    if met { Ok(seen) } else { Err(seen) }
}

fn stopped(took: SimDuration) -> String {
    match took.as_ticks() {
        0 => "they were at rest already".into(),
        _ => format!("at rest after {:.3} ms", span_seconds(took) * 1e3),
    }
}

/// Time and error of each state: of a machine against its line, of a rover in its row against the middle.
fn errors(run: &Run) -> Vec<(f64, f64)> {
    match &run.rover {
        None => guidance::errors(run).collect(),
        Some(rover) => {
            let length = rover.drive.rows().length();
            let samples = rover.drive.samples().iter();
            let inside = samples.filter(|sample| (0.0..=length).contains(&sample.station));
            let error = |sample: &crate::row_drive::RowSample| (seconds(sample.at), sample.right);
            inside.map(error).collect()
        }
    }
}

fn counted(figure: Figure, summary: &Summary) -> u64 {
    let bus = &summary.bus;
    match figure {
        Figure::MissedWindows => bus.missed_windows,
        Figure::MisplacedFrames => bus.frames_outside_their_window,
        Figure::ForeignFrames => bus.foreign_frames,
        Figure::ErrorFrames => bus.error_frames,
        Figure::Contacts => {
            let rover = summary.rover.iter().map(|rover| rover.contacts.len());
            let crop = summary.crop.iter().map(|crop| crop.contacts.len());
            rover.chain(crop).sum::<usize>() as u64
        }
    }
}
