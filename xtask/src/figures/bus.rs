//! Chapter 6: tasks, lines of devices, and the bus.

use can_bus::candump::Line;
use embedded_can::Id;
use vehicle_model::Device;
use world::{
    report::{FrameRecord, Span, WindowKind},
    time::seconds,
};

use super::{
    drawn::{Drawn, Number, Row, Timeline},
    takes::{Take, Takes},
};
use crate::{network::length::frame_bits, sim::Finished};

/// Colour of bars.
const BAR: &str = "bar";
/// Colour of bars that are Furrow's answer to others.
const ANSWER: &str = "run";

/// Starts of the basic cycles of a run, s.
fn cycles(takes: &Takes<'_>, take: Take) -> Vec<f64> {
    let run = takes.of(take).run();
    run.references().map(|frame| seconds(frame.start)).collect()
}

/// A basic cycle in which the vehicle has driven by itself for a while: its start, s.
fn driving(takes: &Takes<'_>, take: Take, after: f64) -> f64 {
    let from = takes.begin(take) + after;
    let cycles = cycles(takes, take);
    let next = cycles.partition_point(|at| *at < from);
    cycles.get(next).copied().unwrap_or(from)
}

/// What a node executed from `from` on for `length`, both s: a row for each task, in milliseconds.
fn tasks(takes: &Takes<'_>, node: &str, from: f64, length: f64) -> Vec<Row> {
    let mut rows: Vec<Row> = Vec::new();
    for (begin, end, task) in takes.of(Take::Bus).executed(node) {
        let (begin, end) = (seconds(begin), seconds(end));
        if end < from || begin > from + length {
            continue;
        }
        let place = rows.iter().position(|row| row.label == task);
        let place = place.unwrap_or_else(|| {
            rows.push(Row {
                label: task.to_owned(),
                class: BAR,
                bars: Vec::new(),
            });
            rows.len() - 1
        });
        let name = format!("{task}: {:.1} us", (end - begin) * 1e6);
        let bar = ((begin - from) * 1e3, (end - from) * 1e3, name);
        if let Some(row) = rows.get_mut(place) {
            row.bars.push(bar);
        }
    }
    rows.sort_by(|one, other| one.label.cmp(&other.label));
    rows
}

/// Frames from `from` on for `length`, both s: a row for each sender, in milliseconds.
fn frames(takes: &Takes<'_>, take: Take, from: f64, length: f64) -> Vec<Row> {
    let finished = takes.of(take);
    let run = finished.run();
    let mut rows: Vec<Row> = run
        .nodes
        .iter()
        .map(|node| Row {
            label: node.clone(),
            class: BAR,
            bars: Vec::new(),
        })
        .collect();
    let within =
        |frame: &FrameRecord| seconds(frame.end) >= from && seconds(frame.start) <= from + length;
    for (index, frame) in run.frames.iter().enumerate().filter(|(_, one)| within(one)) {
        let sender = finished.sender(index);
        let name = finished.matrix().message(frame.id).unwrap_or("foreign");
        let name = format!("{} {name}", frame.id);
        let bar = (
            (seconds(frame.start) - from) * 1e3,
            (seconds(frame.end) - from) * 1e3,
            name,
        );
        if let Some(row) = rows.iter_mut().find(|row| row.label == sender) {
            row.bars.push(bar);
        }
    }
    rows
}

const MILLISECONDS: &str = "time, ms";

fn timeline(
    id: &'static str,
    title: &'static str,
    what: &'static str,
    length: f64,
    rows: &[Row],
) -> maud::Markup {
    Timeline {
        id,
        title,
        what,
        axis: MILLISECONDS,
        named: false,
        x: Span {
            from: 0.0,
            to: length * 1e3,
        },
        rows,
    }
    .draw()
}

/// The longest times of a task, us: all its parts between its begin and its end.
fn longest(takes: &Takes<'_>, node: &str, task: &str) -> Option<f64> {
    let run = takes.of(Take::Bus).run();
    let mut tasks = run.tasks.iter();
    let found = tasks.find(|one| one.node == node && one.task == task)?;
    Some(found.longest_cycles as f64 / found.core_hz as f64 * 1e6)
}

/// Figure 6.21.
pub(super) fn tasks_of_cycles(takes: &Takes<'_>) -> Drawn {
    let from = driving(takes, Take::Bus, 2.0);
    Drawn {
        charts: vec![timeline(
            "f6-21",
            "What the controller executes",
            "Three basic cycles. The control step comes once in each, the display's tick each 200 ms.",
            0.3,
            &tasks(takes, "controller", from, 0.3),
        )],
        numbers: Vec::new(),
    }
}

/// Figure 6.22.
pub(super) fn longest_task(takes: &Takes<'_>) -> Drawn {
    let executed = takes.of(Take::Bus).executed("controller");
    let begin = takes.begin(Take::Bus) + 2.0;
    let mut ticks = executed.iter().filter(|one| one.2 == "display_tick");
    let tick = ticks.find(|one| seconds(one.0) > begin);
    let from = tick.map_or(begin, |one| seconds(one.0) - 0.2e-3);
    Drawn {
        charts: vec![timeline(
            "f6-22",
            "What the controller executes around the display's tick",
            "0.2 ms before the tick, and behind it.",
            0.8e-3,
            &tasks(takes, "controller", from, 0.8e-3),
        )],
        numbers: vec![
            Number::new(
                "longest time of the task that makes the display's text",
                "us",
                1,
            )
            .thesis(400.0)
            .furrow(longest(takes, "controller", "display_tick")),
            Number::new(
                "longest time of the control step (the thesis's update without a text)",
                "us",
                1,
            )
            .thesis(8.0)
            .furrow(longest(takes, "controller", "control")),
        ],
    }
}

/// A character of the receiver's line at 1 Mbaud, s.
const CHARACTER: f64 = 10e-6;

/// Length of the receiver's bursts, ms: the median, as one in ten has a heartbeat, too.
fn burst(finished: &Finished<'_>) -> Option<f64> {
    let characters = finished.characters().iter();
    let own = characters.filter(|one| one.device == Device::SatelliteReceiver && !one.from_node);
    let ends: Vec<f64> = own.map(|one| seconds(one.at)).collect();
    let bursts = ends.chunk_by(|one, other| other - one < 0.01);
    let length = |burst: &[f64]| Some((burst.last()? - burst.first()? + CHARACTER) * 1e3);
    let mut lengths: Vec<f64> = bursts.filter_map(length).collect();
    lengths.sort_by(f64::total_cmp);
    lengths.get(lengths.len() / 2).copied()
}

/// Figure 6.23.
pub(super) fn receiver(takes: &Takes<'_>) -> Drawn {
    let from = driving(takes, Take::Bus, 2.0) - 0.02;
    let length = 0.04;
    let finished = takes.of(Take::Bus);
    let characters = finished.characters().iter();
    let bytes: Vec<f64> = characters
        .filter(|one| one.device == Device::SatelliteReceiver && !one.from_node)
        .map(|one| seconds(one.at))
        .filter(|at| (from..from + length).contains(at))
        .collect();
    let manifest = finished.vehicle().manifest().receiver.as_ref();
    let line = Row {
        label: "receiver's bytes".into(),
        class: ANSWER,
        bars: bytes
            .iter()
            .map(|at| {
                (
                    (at - CHARACTER - from) * 1e3,
                    (at - from) * 1e3,
                    String::new(),
                )
            })
            .collect(),
    };
    let mut rows = vec![line];
    let own = frames(takes, Take::Bus, from, length);
    rows.extend(own.into_iter().filter(|row| row.label == "gps"));
    rows.extend(tasks(takes, "gps", from, length).into_iter().filter(|row| {
        ["receiver", "parse", "window_timer", "navigation"]
            .iter()
            .any(|name| row.label.contains(name))
    }));
    Drawn {
        charts: vec![timeline(
            "f6-23",
            "From the receiver's line to the bus",
            "The burst of the receiver, the frames of the gps node, and tasks of this node.",
            length,
            &rows,
        )],
        numbers: vec![
            Number::new("length of a burst, median", "ms", 2)
                .thesis(3.15)
                .furrow(burst(finished)),
            Number::new("length of a burst in the manifest", "ms", 2)
                .furrow(manifest.map(|receiver| receiver.burst.get() * 1e3)),
        ],
    }
}

/// Figure 6.27.
pub(super) fn display(takes: &Takes<'_>) -> Drawn {
    let finished = takes.of(Take::Bus);
    let begin = takes.begin(Take::Bus) + 2.0;
    let bytes = |from_node: bool| -> Vec<f64> {
        let characters = finished.characters().iter();
        let own =
            characters.filter(|one| one.device == Device::Display && one.from_node == from_node);
        own.map(|one| seconds(one.at)).collect()
    };
    let (sent, answers) = (bytes(true), bytes(false));
    // A text begins behind a pause.
    let pause = 0.02;
    let mut pairs = sent.windows(2);
    let first = pairs.find_map(|pair| match *pair {
        [one, other] if other > begin && other - one > pause => Some(other),
        _ => None,
    });
    let from = first.unwrap_or(begin);
    let behind = sent.iter().copied().filter(|at| *at >= from);
    let mut last = from;
    for at in behind {
        if at - last > pause {
            break;
        }
        last = at;
    }
    // Times are those of the ends of characters.
    let text = || sent.iter().filter(|at| (from..=last).contains(*at));
    let apart = text().zip(text().skip(1)).map(|(one, other)| other - one);
    let character = apart.reduce(f64::min).unwrap_or(0.0);
    let length = 0.2;
    let row = |label: &str, class, bytes: &[f64]| Row {
        label: label.into(),
        class,
        bars: bytes
            .iter()
            .map(|at| ((at - from) * 1e3 - 0.2, (at - from) * 1e3, String::new()))
            .collect(),
    };
    let rows = [
        row("bytes to the display", BAR, &sent),
        row("its answers", ANSWER, &answers),
    ];
    let before = Span {
        from: -5.0,
        to: length * 1e3,
    };
    Drawn {
        charts: vec![
            Timeline {
                id: "f6-27",
                title: "The line of the display",
                what: "One text, sent by DMA, until the next one.",
                axis: MILLISECONDS,
                named: false,
                x: before,
                rows: &rows,
            }
            .draw(),
        ],
        numbers: vec![
            Number::new("time to send a text", "ms", 2)
                .thesis(78.0)
                .furrow(first.map(|first| (last - first + character) * 1e3)),
        ],
    }
}

/// Figure 6.29.
pub(super) fn handling(takes: &Takes<'_>) -> Drawn {
    let from = driving(takes, Take::Bus, 2.0);
    // The thesis's twelve windows; Furrow's own messages come later in the cycle.
    let length = 0.016;
    let executed = takes.of(Take::Bus).executed("controller");
    let of_bus = |task: &str| ["can_rx", "can_tx", "control"].contains(&task);
    let handling = || {
        let within = |at| (from..from + length).contains(&seconds(at));
        let all = executed.iter();
        all.filter(move |(begin, end, task)| within(*begin) && within(*end) && of_bus(task))
    };
    let busy: f64 = handling()
        .map(|(begin, end, _)| seconds(*end) - seconds(*begin))
        .sum();
    let handled = handling()
        .map(|(_, end, _)| (seconds(*end) - from) * 1e3)
        .reduce(f64::max);
    let mut rows = frames(takes, Take::Bus, from, length);
    rows.retain(|row| !row.bars.is_empty());
    rows.extend(
        tasks(takes, "controller", from, length)
            .into_iter()
            .filter(|row| of_bus(&row.label)),
    );
    Drawn {
        charts: vec![timeline(
            "f6-29",
            "Frames of a basic cycle, and how the controller handles them",
            "Frames by sender; below, the tasks of the controller node that handle them.",
            length,
            &rows,
        )],
        numbers: vec![
            // The thesis says "under 7 ms", from an oscilloscope: time that passes, not time of the processor.
            Number::new(
                "from the reference until the last frame of the thesis's twelve windows is handled (thesis: under)",
                "ms",
                1,
            )
            .thesis(7.0)
            .furrow(handled),
            Number::new(
                "processor time of that handling, without the task that opens the windows",
                "ms",
                3,
            )
            .furrow(Some(busy * 1e3)),
        ],
    }
}

/// Figure 6.30.
pub(super) fn basic_period(takes: &Takes<'_>) -> Drawn {
    let from = driving(takes, Take::Bus, 2.0) - 0.01;
    let cycles = cycles(takes, Take::Bus);
    let driven: Vec<f64> = cycles.into_iter().filter(|at| *at > from).collect();
    let lengths: Vec<f64> = driven
        .windows(2)
        .map(|pair| (pair[1] - pair[0]) * 1e3)
        .collect();
    let mean = lengths.iter().sum::<f64>() / lengths.len().max(1) as f64;
    let span = Span::of(lengths.iter().copied()).map(|span| span.length() * 1e3);
    Drawn {
        charts: vec![timeline(
            "f6-30",
            "Three basic cycles",
            "Frames by sender.",
            0.32,
            &frames(takes, Take::Bus, from, 0.32),
        )],
        numbers: vec![
            Number::new("length of a basic cycle", "ms", 4)
                .thesis(100.0)
                .furrow(Some(mean)),
            Number::new("difference of the longest and the shortest one", "us", 2).furrow(span),
        ],
    }
}

/// Figure 6.31.
pub(super) fn without_fix(takes: &Takes<'_>) -> Drawn {
    let lost = 20.0;
    let cycles = cycles(takes, Take::Lost);
    let next = cycles.partition_point(|at| *at < lost + 1.0);
    let from = cycles.get(next).copied().unwrap_or(lost) - 0.005;
    Drawn {
        charts: vec![timeline(
            "f6-31",
            "A basic cycle without a fix",
            "A second behind the loss of the fix: windows of position and heading stay empty; the velocity, and the receiver's latitude and longitude, are sent without a fix.",
            0.12,
            &frames(takes, Take::Lost, from, 0.12),
        )],
        numbers: vec![
            Number::new("frames in a basic cycle without a fix", "", 0).furrow(Some(
                frames_between(takes, Take::Lost, from, from + 0.1) as f64,
            )),
        ],
    }
}

fn frames_between(takes: &Takes<'_>, take: Take, from: f64, until: f64) -> usize {
    let run = takes.of(take).run();
    let frames = run.frames.iter();
    frames
        .filter(|frame| (from..until).contains(&seconds(frame.start)))
        .count()
}

/// Figure 6.32.
pub(super) fn windows(takes: &Takes<'_>) -> Drawn {
    let from = driving(takes, Take::Bus, 2.0);
    let finished = takes.of(Take::Bus);
    let run = finished.run();
    let schedule = Row {
        label: "windows".into(),
        class: "mode",
        bars: run
            .windows
            .iter()
            .map(|window| {
                let start = window.start.as_ticks() as f64 / 1e9;
                let end = start + window.length.as_ticks() as f64 / 1e9;
                (start, end, format!("{} {}", window.id, window.message))
            })
            .collect(),
    };
    let mut rows = vec![schedule];
    rows.extend(frames(takes, Take::Bus, from, 0.014));
    let exclusive = run
        .windows
        .iter()
        .filter(|window| window.kind == WindowKind::Exclusive);
    let shortest = exclusive
        .map(|window| window.length.as_ticks() as f64 / 1e9)
        .fold(f64::INFINITY, f64::min);
    Drawn {
        charts: vec![timeline(
            "f6-32",
            "Windows of a basic cycle, and the frames in them",
            "The begin of a cycle: the windows of the schedule, and frames by sender.",
            0.014,
            &rows,
        )],
        numbers: vec![
            Number::new("shortest exclusive window", "ms", 3)
                .thesis(1.0)
                .furrow(Some(shortest)),
        ],
    }
}

/// The bus log of the thesis (Figure 6.33).
const THESIS_LOG: &str =
    include_str!("../../../firmware/vehicles/uagv/tests/data/thesis_fig6_33.candump.log");

/// A frame of a basic cycle.
struct Begun {
    /// Its begin since that of the reference, s.
    at: f64,
    /// How long it lasts, s.
    length: f64,
    id: u16,
}

/// The windows of the thesis last a millisecond each, s in all. Later ones have no counterpart there.
const THESIS_WINDOWS: f64 = 0.0125;

/// The frames in the log of the thesis. The log stamps the end of a frame.
fn thesis_frames() -> Vec<Begun> {
    let begin = |line: &str| -> Option<Begun> {
        let line: Line = line.parse().ok()?;
        let Id::Standard(id) = line.frame.id() else {
            return None;
        };
        let length = f64::from(frame_bits(&line.frame)) * THESIS_BIT;
        Some(Begun {
            at: line.at.as_ticks() as f64 * 1e-12 - length,
            length,
            id: id.as_raw(),
        })
    };
    let mut frames: Vec<Begun> = THESIS_LOG.lines().filter_map(begin).collect();
    let reference = frames.iter().find(|frame| frame.id == 100);
    let first = reference.map_or(0.0, |one| one.at);
    for frame in &mut frames {
        frame.at -= first;
    }
    frames
}

/// A bit on the bus of the thesis, s.
const THESIS_BIT: f64 = 4e-6;

/// How far from their windows frames begin at most, us.
fn latest(windows: &[world::report::Window], frames: &[Begun]) -> Option<f64> {
    let late = frames.iter().filter_map(|one| {
        let own = windows.iter().filter(|window| window.id == one.id);
        let starts = own.map(|window| window.start.as_ticks() as f64 / 1e12);
        let distance = starts.map(|start| (one.at - start).abs());
        distance.reduce(f64::min).map(|seconds| seconds * 1e6)
    });
    late.reduce(f64::max)
}

/// Figure 6.33.
pub(super) fn activity(takes: &Takes<'_>) -> Drawn {
    let from = driving(takes, Take::Bus, 2.0);
    let finished = takes.of(Take::Bus);
    let run = finished.run();
    let own: Vec<Begun> = run
        .frames
        .iter()
        .filter(|frame| (from..from + THESIS_WINDOWS).contains(&seconds(frame.start)))
        .map(|frame| Begun {
            at: seconds(frame.start) - from,
            length: seconds(frame.end) - seconds(frame.start),
            id: frame.id,
        })
        .collect();
    let thesis = thesis_frames();
    let bars = |frames: &[Begun]| -> Vec<(f64, f64, String)> {
        let bar = |one: &Begun| {
            (
                one.at * 1e3,
                (one.at + one.length) * 1e3,
                one.id.to_string(),
            )
        };
        frames.iter().map(bar).collect()
    };
    let rows = [
        Row {
            label: "the thesis's log".into(),
            class: BAR,
            bars: bars(&thesis),
        },
        Row {
            label: "Furrow".into(),
            class: ANSWER,
            bars: bars(&own),
        },
    ];
    Drawn {
        charts: vec![
            Timeline {
                id: "f6-33",
                title: "Frames of a basic cycle",
                what: "Above, the log that the thesis prints, without a fix; below, Furrow's bus with one. The numbers are \
                       identifiers.",
                axis: MILLISECONDS,
                named: true,
                x: Span {
                    from: 0.0,
                    to: 13.5,
                },
                rows: &rows,
            }
            .draw(),
        ],
        numbers: vec![
            Number::new("begin of a frame beside its window, largest in the twelve windows of the thesis", "us", 1)
                .thesis(late_in_thesis(&thesis).unwrap_or(f64::NAN))
                .furrow(latest(run.windows, &own)),
        ],
    }
}

/// How late the thesis's frames begin in its windows of 1 ms, us. Its reference begins a window of
/// its own.
fn late_in_thesis(frames: &[Begun]) -> Option<f64> {
    const ORDER: [u16; 12] = [100, 401, 402, 200, 201, 202, 206, 300, 450, 451, 452, 453];
    let late = frames.iter().filter_map(|one| {
        let window = ORDER.iter().position(|id| *id == one.id)?;
        Some((one.at * 1e6 - window as f64 * 1e3).abs())
    });
    late.reduce(f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The steering node's frame begins 378 us late in the window of the thesis, the table says.
    #[test]
    fn the_log_of_the_thesis_is_read() {
        let frames = thesis_frames();
        assert_eq!(frames.len(), 10);
        let pot = frames.iter().find(|frame| frame.id == 206).unwrap();
        assert!((pot.at - 6.378e-3).abs() < 2e-6, "{}", pot.at);
        let late = late_in_thesis(&frames).unwrap();
        assert!((late - 378.0).abs() < 2.0, "{late}");
    }
}
