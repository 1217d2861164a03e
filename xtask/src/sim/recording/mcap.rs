//! `run.mcap`: the run as a recording of channels for Foxglove and other readers of
//! [MCAP](https://mcap.dev/spec). Messages are JSON; the schema of each channel says what its fields
//! are and their units.

use std::{collections::BTreeMap, io::Cursor};

use mcap::{WriteOptions, records::MessageHeader};
use serde_json::{Map, Value, json};
use world::report::{Cell, Summary, Table, rounded};
use world::{SimTime, time::seconds};

use super::super::Finished;
use super::{files::console_lines, happened::of_run};
use crate::network::decode::{Decoder, Field};

/// A field of a message: its name, its kind in a JSON schema, its unit, what it is.
type Property = (String, &'static str, String, String);

/// A channel: its topic, the name of its schema and its fields.
struct Channel {
    topic: String,
    schema: String,
    properties: Vec<Property>,
}

impl Channel {
    fn new(topic: &str, schema: &str, properties: &[(&str, &'static str, &str, &str)]) -> Self {
        let owned = |&(name, kind, unit, what): &(&str, &'static str, &str, &str)| {
            (name.to_owned(), kind, unit.to_owned(), what.to_owned())
        };
        Self {
            topic: topic.to_owned(),
            schema: schema.to_owned(),
            properties: properties.iter().map(owned).collect(),
        }
    }

    /// The schema in the form of <https://json-schema.org>.
    fn json_schema(&self) -> Value {
        let properties = self.properties.iter().map(|(name, kind, unit, what)| {
            let mut property = json!({ "type": kind });
            if !what.is_empty() {
                property["description"] = json!(what);
            }
            if !unit.is_empty() {
                property["unit"] = json!(unit);
            }
            // The one field that is no simple value is the time stamp of a line of a log.
            if *kind == "object" {
                property["properties"] = json!({
                    "sec": { "type": "integer" }, "nsec": { "type": "integer" }
                });
            }
            (name.clone(), property)
        });
        let properties: Map<String, Value> = properties.collect();
        json!({ "title": self.schema, "type": "object", "properties": properties })
    }
}

/// All channels, and the messages with the numbers of their channels.
#[derive(Default)]
struct Tracks {
    channels: Vec<Channel>,
    messages: Vec<(SimTime, usize, Value)>,
}

impl Tracks {
    fn channel(&mut self, channel: Channel) -> usize {
        self.channels.push(channel);
        self.channels.len() - 1
    }

    fn message(&mut self, at: SimTime, channel: usize, value: Value) {
        self.messages.push((at, channel, value));
    }
}

/// The file.
///
/// # Errors
/// What the library says; writing to memory does not fail.
pub(crate) fn mcap(
    finished: &Finished<'_>,
    summary: &Summary,
    states: Option<&Table>,
) -> mcap::McapResult<Vec<u8>> {
    let mut tracks = Tracks::default();
    if let Some(states) = states {
        truth(&mut tracks, states);
    }
    bus(&mut tracks, finished);
    signals(&mut tracks, finished);
    nodes(&mut tracks, finished);
    load(&mut tracks, finished);
    world(&mut tracks, finished);
    happened(&mut tracks, finished, summary);
    write(tracks)
}

fn write(mut tracks: Tracks) -> mcap::McapResult<Vec<u8>> {
    tracks.messages.sort_by_key(|(at, ..)| *at);
    let options = WriteOptions::new().compression(None).library("furrow");
    let mut writer = options.create(Cursor::new(Vec::new()))?;
    let mut ids = Vec::new();
    for channel in &tracks.channels {
        let schema = channel.json_schema().to_string();
        let schema = writer.add_schema(&channel.schema, "jsonschema", schema.as_bytes())?;
        ids.push(writer.add_channel(schema, &channel.topic, "json", &BTreeMap::new())?);
    }
    let mut sequences = vec![0_u32; ids.len()];
    for (at, channel, value) in &tracks.messages {
        let time = at.as_ticks() / 1000;
        let (Some(&channel_id), Some(sequence)) = (ids.get(*channel), sequences.get_mut(*channel))
        else {
            continue;
        };
        let header = MessageHeader {
            channel_id,
            sequence: *sequence,
            log_time: time,
            publish_time: time,
        };
        *sequence += 1;
        writer.write_to_known_channel(&header, value.to_string().as_bytes())?;
    }
    writer.finish()?;
    Ok(writer.into_inner().into_inner())
}

/// The states of the vehicle.
fn truth(tracks: &mut Tracks, states: &Table) {
    let columns = states.columns.iter().skip(1);
    let properties = columns.map(|column| {
        let word = column.unit.is_empty() && column.digits == 0;
        let kind = if word { "string" } else { "number" };
        let (name, unit) = (column.name.clone(), column.unit.to_owned());
        (name, kind, unit, column.what.to_owned())
    });
    let channel = tracks.channel(Channel {
        topic: "/states".into(),
        schema: "furrow.States".into(),
        properties: properties.collect(),
    });
    for row in &states.rows {
        let at = world::time::at(world::time::from_seconds(Table::seconds(row)));
        let cells = row.iter().zip(&states.columns).skip(1);
        let value: Map<String, Value> = cells
            .filter_map(|(cell, column)| {
                let value = match cell {
                    Cell::Number(value) => json!(value),
                    Cell::Word(word) => json!(word),
                    Cell::Empty => return None,
                };
                Some((column.name.clone(), value))
            })
            .collect();
        tracks.message(at, channel, Value::Object(value));
    }
}

/// The frames on the bus, and the error frames.
fn bus(tracks: &mut Tracks, finished: &Finished<'_>) {
    let frames = tracks.channel(Channel::new(
        "/bus/frames",
        "furrow.Frame",
        &[
            ("id", "integer", "", "identifier"),
            ("message", "string", "", "name in the network file"),
            ("sender", "string", "", "node that sent it"),
            ("data", "string", "", "data bytes, hexadecimal"),
            (
                "remote",
                "boolean",
                "",
                "whether it asks for the message and has no data",
            ),
            (
                "dlc",
                "integer",
                "",
                "data bytes, or those that it asks for",
            ),
            ("start", "number", "s", "first edge of start of frame"),
            ("duration", "number", "us", "to the end of the frame"),
            (
                "complete",
                "boolean",
                "",
                "false if an error frame destroyed it",
            ),
        ],
    ));
    for (index, frame) in finished.log.frames.iter().enumerate() {
        let bytes = if frame.remote { 0 } else { frame.dlc };
        let data = frame.data.iter().take(usize::from(bytes));
        let data: String = data.map(|byte| format!("{byte:02X}")).collect();
        let micros = (frame.end - frame.start).as_ticks() as f64 / 1e6;
        let value = json!({
            "id": frame.id,
            "message": finished.matrix.message(frame.id).unwrap_or_default(),
            "sender": finished.sender(index),
            "data": data,
            "remote": frame.remote,
            "dlc": frame.dlc,
            "start": seconds(frame.start),
            "duration": micros,
            "complete": frame.complete,
        });
        tracks.message(frame.end, frames, value);
    }
    let errors = tracks.channel(Channel::new(
        "/bus/errors",
        "furrow.ErrorFrame",
        &[
            ("kind", "string", "", "what the first node found"),
            ("transmitter", "boolean", "", "whether the sender found it"),
        ],
    ));
    for error in &finished.log.errors {
        let value =
            json!({ "kind": format!("{:?}", error.kind), "transmitter": error.transmitter });
        tracks.message(error.at, errors, value);
    }
}

/// The signals of each message.
fn signals(tracks: &mut Tracks, finished: &Finished<'_>) {
    let decoder = Decoder::new(finished.vehicle.network());
    let mut channels = BTreeMap::new();
    for message in decoder.messages() {
        let field = |field: &Field| {
            let kind = if field.has_names() {
                "string"
            } else {
                "number"
            };
            (field.name.clone(), kind, field.unit.clone(), String::new())
        };
        let channel = tracks.channel(Channel {
            topic: format!("/signals/{}", message.name),
            schema: format!("furrow.{}", message.name),
            properties: message.fields.iter().map(field).collect(),
        });
        channels.insert(message.id, channel);
    }
    for frame in &finished.log.frames {
        if !frame.is_message() {
            continue;
        }
        let known = decoder.message(frame.id);
        let known = known.filter(|message| message.accepts(usize::from(frame.dlc)));
        let (Some(message), Some(&channel)) = (known, channels.get(&frame.id)) else {
            continue;
        };
        let value = message.fields.iter().map(|field| {
            let value = match field.named(&frame.data) {
                Some(name) => json!(name),
                None if field.has_names() => json!(field.raw(&frame.data).to_string()),
                None => json!(field.value(&frame.data)),
            };
            (field.name.clone(), value)
        });
        let value: Map<String, Value> = value.collect();
        tracks.message(frame.end, channel, Value::Object(value));
    }
}

/// Fields of a line of a log, by the names that Foxglove's panel for logs reads.
const LOG: [(&str, &str, &str, &str); 4] = [
    ("timestamp", "object", "", "time from power-on"),
    (
        "level",
        "integer",
        "",
        "1 debug, 2 info, 3 warning, 4 error",
    ),
    ("message", "string", "", ""),
    ("name", "string", "", "the node"),
];

/// Consoles and logs.
fn nodes(tracks: &mut Tracks, finished: &Finished<'_>) {
    for (node, recording) in finished.outcome.nodes.iter().zip(&finished.recordings) {
        let line = |at: SimTime, level: u8, text: &str| {
            let nanos = at.as_ticks() / 1000;
            json!({
                "timestamp": { "sec": nanos / 1_000_000_000, "nsec": nanos % 1_000_000_000 },
                "level": level,
                "message": text,
                "name": node.name,
            })
        };
        let topic = format!("/log/{}", node.name);
        let channel = tracks.channel(Channel::new(&topic, "foxglove.Log", &LOG));
        for one in &recording.log {
            let (level, text) = one.parts();
            let level = match level {
                "TRACE" | "DEBUG" => 1,
                "WARN" => 3,
                "ERROR" => 4,
                _ => 2,
            };
            tracks.message(one.at, channel, line(one.at, level, text));
        }
        let topic = format!("/console/{}", node.name);
        let channel = tracks.channel(Channel::new(&topic, "foxglove.Log", &LOG));
        for one in console_lines(node) {
            tracks.message(one.at, channel, line(one.at, 2, &one.text));
        }
    }
}

/// What each task of each node took of each basic cycle. The single activations are too many for messages
/// of JSON: `run.html` has them.
fn load(tracks: &mut Tracks, finished: &Finished<'_>) {
    let cycle = finished.matrix.basic_cycle().as_ticks().max(1);
    for node in &finished.nodes {
        let executed = finished.executed(node);
        let mut tasks: Vec<&str> = executed.iter().map(|one| one.2).collect();
        tasks.sort_unstable();
        tasks.dedup();
        if tasks.is_empty() {
            continue;
        }
        let what = "processor time in the basic cycle that ends";
        let mut properties = vec![("load", "number", "%", "share of the basic cycle that ends")];
        properties.extend(tasks.iter().map(|&task| (task, "number", "us", what)));
        let topic = format!("/load/{node}");
        let channel = tracks.channel(Channel::new(&topic, "furrow.Load", &properties));
        let mut cycles: Vec<BTreeMap<&str, u64>> = Vec::new();
        for (from, until, task) in executed {
            let (mut from, until) = (from.as_ticks(), until.as_ticks());
            while from < until {
                let number = from / cycle;
                let end = until.min((number + 1) * cycle);
                let place = usize::try_from(number).unwrap_or(usize::MAX);
                if cycles.len() <= place {
                    cycles.resize_with(place + 1, BTreeMap::new);
                }
                *cycles[place].entry(task).or_default() += end - from;
                from = end;
            }
        }
        for (number, taken) in (1_u64..).zip(&cycles) {
            let of = |task: &&str| taken.get(task).copied().unwrap_or(0);
            let micros = |ticks: u64| rounded(ticks as f64 / 1e6, 3);
            let mut value: Map<String, Value> = tasks
                .iter()
                .map(|task| ((*task).to_owned(), json!(micros(of(task)))))
                .collect();
            let all: u64 = taken.values().sum();
            let share = rounded(all as f64 / cycle as f64 * 100.0, 3);
            value.insert("load".to_owned(), json!(share));
            let at = SimTime::from_ticks(number * cycle);
            tracks.message(at, channel, Value::Object(value));
        }
    }
}

/// What happened: events of the scenario, the nodes, the bus guardian and the report.
fn happened(tracks: &mut Tracks, finished: &Finished<'_>, summary: &Summary) {
    let properties = [
        ("text", "string", "", "what happened"),
        ("bad", "boolean", "", "whether it is bad"),
    ];
    let channel = tracks.channel(Channel::new("/events", "furrow.Event", &properties));
    for event in of_run(finished, summary) {
        let at = world::time::at(world::time::from_seconds(event.at));
        tracks.message(at, channel, json!({ "text": event.text, "bad": event.bad }));
    }
}

/// Modes, display, motors and relays.
fn world(tracks: &mut Tracks, finished: &Finished<'_>) {
    let mode = [
        ("mode", "string", "", "mode of the vehicle"),
        (
            "autonomous",
            "boolean",
            "",
            "whether it follows its way by itself",
        ),
    ];
    let channel = tracks.channel(Channel::new("/mode", "furrow.Mode", &mode));
    for change in &finished.modes {
        let value = json!({ "mode": change.mode, "autonomous": change.autonomous });
        tracks.message(change.at, channel, value);
    }
    let text = [("text", "string", "", "four rows, and the lamps")];
    let channel = tracks.channel(Channel::new("/display", "furrow.Display", &text));
    for change in finished.outcome.world.screens() {
        tracks.message(change.at, channel, json!({ "text": change.text }));
    }
    let effort = [
        ("node", "string", "", "the node at the motor driver"),
        ("byte", "integer", "", "the driver's last byte"),
        ("effort", "number", "", "-1 to 1; 0 while the relay is open"),
    ];
    let channel = tracks.channel(Channel::new("/motors", "furrow.Motor", &effort));
    let name = |node| finished.node_name(node);
    for change in finished.outcome.world.efforts() {
        let value =
            json!({ "node": name(change.node), "byte": change.byte, "effort": change.effort });
        tracks.message(change.at, channel, value);
    }
    let closed = [
        ("node", "string", "", "the node at the relay"),
        ("closed", "boolean", "", "whether the node lets it conduct"),
    ];
    let channel = tracks.channel(Channel::new("/relays", "furrow.Relay", &closed));
    for change in finished.outcome.world.relays() {
        let value = json!({ "node": name(change.node), "closed": change.closed });
        tracks.message(change.at, channel, value);
    }
}
