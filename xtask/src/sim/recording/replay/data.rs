//! What the script knows of the run.

use serde_json::{Value, json};
use world::SimTime;
use world::report::{Cell, FrameRecord, Summary, Table, WindowKind, rounded};
use world::time::{seconds, span_micros};

use super::super::super::{FOREIGN, Finished};
use super::super::happened::{Event, of_run};
use super::super::{Segment, files::console_lines};
use super::Columns;
use crate::network::decode::{Decoder, Field, Known};

/// Most rows of the states on the page: a row each 100 ms of ten minutes.
const MOST_ROWS: usize = 6000;

/// Ticks of a frame's times: tenths of a microsecond.
const TENTH: u64 = 100_000;
/// Ticks of a task's begin: microseconds.
const MICRO: u64 = 1_000_000;

/// What the script knows by name; the numbers of frames and tasks go to `columns`.
pub(super) fn header(
    finished: &Finished<'_>,
    summary: &Summary,
    states: Option<&Table>,
    columns: &mut Columns,
) -> Value {
    let decoder = Decoder::new(finished.vehicle.network());
    let cycles = cycles(finished);
    columns.rising("cycles", cycles.iter().map(|at| at.as_ticks() / TENTH));
    frames(finished, columns);
    let tasks = tasks(finished, columns);
    let name = |node| finished.node_name(node);
    let world = &finished.outcome.world;
    let efforts = world.efforts().iter().map(|change| {
        json!([
            rounded(seconds(change.at), 4),
            name(change.node),
            rounded(change.effort, 3)
        ])
    });
    let relays = world.relays().iter().map(|change| {
        json!([
            rounded(seconds(change.at), 4),
            name(change.node),
            change.closed
        ])
    });
    let screens = world.screens().iter();
    let modes = finished.modes.iter();
    json!({
        "end": seconds(finished.outcome.duration),
        "nodes": finished.nodes,
        "senders": senders(finished),
        "cycle": span_micros(finished.matrix.basic_cycle()),
        "bit": span_micros(finished.matrix.bit_time()),
        "windows": windows(finished),
        "messages": decoder.messages().iter().map(message).collect::<Vec<_>>(),
        "line": finished.scenario.line.as_ref().filter(|_| finished.mission.is_none()).map(|line| {
            [line.from.north, line.from.east, line.to.north, line.to.east].map(|metres| metres.get())
        }),
        "mission": finished.mission.as_ref().map(|driven| driven.json(world.states())),
        "states": states.map(states_json),
        "efforts": efforts.collect::<Vec<_>>(),
        "relays": relays.collect::<Vec<_>>(),
        "screens": screens.map(|one| json!([seconds(one.at), one.text])).collect::<Vec<_>>(),
        "modes": modes
            .map(|one| json!([seconds(one.at), one.mode, one.autonomous]))
            .collect::<Vec<_>>(),
        "events": events(finished, summary),
        "texts": texts(finished),
        "tasks": tasks,
        "columns": columns.places,
    })
}

/// When each basic cycle begins: with its reference message, and a cycle later where one is missing.
fn cycles(finished: &Finished<'_>) -> Vec<SimTime> {
    let length = finished.matrix.basic_cycle();
    let mut all = vec![SimTime::from_ticks(0)];
    let mut fill = |until: SimTime| {
        while let Some(&last) = all.last()
            && last + length + length / 2 < until
        {
            all.push(last + length);
        }
        all.push(until);
    };
    for frame in finished.run().references() {
        fill(frame.start);
    }
    fill(SimTime::from_ticks(finished.outcome.duration.as_ticks()));
    all
}

/// Who can send: the nodes, and all that is foreign.
fn senders(finished: &Finished<'_>) -> Vec<String> {
    let mut senders = finished.nodes.clone();
    senders.push(FOREIGN.to_owned());
    senders
}

fn frames(finished: &Finished<'_>, columns: &mut Columns) {
    let frames = &finished.log.frames;
    let senders = senders(finished);
    let sender = |index| {
        let name = finished.sender(index);
        senders
            .iter()
            .position(|sender| sender == name)
            .unwrap_or(0) as u8
    };
    columns.rising(
        "start",
        frames.iter().map(|frame| frame.start.as_ticks() / TENTH),
    );
    let spans = frames
        .iter()
        .map(|frame| (frame.end - frame.start).as_ticks() / TENTH);
    columns.numbers("span", spans);
    columns.numbers("id", frames.iter().map(|frame| u64::from(frame.id)));
    let length = |frame: &FrameRecord| if frame.remote { 0 } else { frame.dlc.min(8) };
    let flags = frames
        .iter()
        .map(|frame| length(frame) | u8::from(frame.remote) << 6 | u8::from(frame.complete) << 7);
    columns.raw("flags", flags);
    columns.raw("sender", (0..frames.len()).map(sender));
    let data = frames.iter().flat_map(|frame| {
        let length = usize::from(length(frame));
        frame.data.into_iter().take(length)
    });
    columns.raw("data", data);
}

/// What the cores executed; returns the names of the tasks by node and exception.
fn tasks(finished: &Finished<'_>, columns: &mut Columns) -> Vec<Value> {
    let mut all = Vec::new();
    for (node, recording) in finished.outcome.nodes.iter().zip(&finished.recordings) {
        let segments = &recording.segments;
        let begin = |one: &Segment| one.from.as_ticks() / MICRO;
        columns.rising(&format!("from {}", node.name), segments.iter().map(begin));
        let length = |one: &Segment| (one.until - one.from).as_ticks() / TENTH;
        columns.numbers(&format!("for {}", node.name), segments.iter().map(length));
        let exceptions = segments.iter().map(|one| one.exception.min(255) as u8);
        columns.raw(&format!("task {}", node.name), exceptions);
        let names = node.load.tasks.iter().map(|task| {
            let name = finished.task_name(node.node, &task.name);
            (task.exception.to_string(), json!(name))
        });
        all.push(Value::Object(names.collect()));
    }
    all
}

fn windows(finished: &Finished<'_>) -> Vec<Value> {
    let windows = finished.matrix.windows.iter();
    let window = |one: &world::report::Window| {
        json!({
            "id": one.id,
            "message": one.message,
            "sender": one.sender,
            "start": span_micros(one.start),
            "length": span_micros(one.length),
            "repeat": one.repeat,
            "offset": one.offset,
            "kind": match one.kind {
                WindowKind::Reference => "reference",
                WindowKind::Exclusive => "exclusive",
                WindowKind::Arbitrating => "arbitrating",
            },
        })
    };
    windows.map(window).collect()
}

fn message(known: &Known) -> Value {
    let fields = known.fields.iter().map(Field::layout);
    let lengths: Vec<usize> = (0..=8).filter(|&bytes| known.accepts(bytes)).collect();
    json!({
        "id": known.id,
        "name": known.name,
        "lengths": lengths,
        "fields": fields.collect::<Vec<_>>(),
    })
}

/// The states, thinned out so that at most [`MOST_ROWS`] are left.
fn states_json(states: &Table) -> Value {
    let every = states.rows.len().div_ceil(MOST_ROWS).max(1);
    let cell = |row: &[Cell], place: usize, digits: usize| match row.get(place) {
        Some(Cell::Number(value)) => json!(rounded(*value, digits as i32)),
        Some(Cell::Word(word)) => json!(word),
        _ => Value::Null,
    };
    let columns = states.columns.iter().enumerate().map(|(place, column)| {
        let rows = states.rows.iter().step_by(every);
        json!({
            "name": column.name,
            "unit": column.unit,
            "what": column.what,
            "values": rows.map(|row| cell(row, place, column.digits)).collect::<Vec<_>>(),
        })
    });
    Value::Array(columns.collect())
}

/// What happened: time, text and whether it is bad.
fn events(finished: &Finished<'_>, summary: &Summary) -> Vec<Value> {
    let event = |one: Event| json!([rounded(one.at, 4), one.text, one.bad]);
    of_run(finished, summary).into_iter().map(event).collect()
}

/// Logs and consoles: name, and lines with their times.
fn texts(finished: &Finished<'_>) -> Vec<Value> {
    let mut all = Vec::new();
    for (node, recording) in finished.outcome.nodes.iter().zip(&finished.recordings) {
        let log = recording.log.iter();
        let log = log.map(|line| json!([rounded(seconds(line.at), 3), line.text]));
        all.push(
            json!({ "name": format!("log of {}", node.name), "lines": log.collect::<Vec<_>>() }),
        );
        let console = console_lines(node).into_iter();
        let console = console.map(|line| json!([rounded(seconds(line.at), 3), line.text]));
        let name = format!("console of {}", node.name);
        all.push(json!({ "name": name, "lines": console.collect::<Vec<_>>() }));
    }
    all.retain(|one| {
        one["lines"]
            .as_array()
            .is_some_and(|lines| !lines.is_empty())
    });
    all
}
