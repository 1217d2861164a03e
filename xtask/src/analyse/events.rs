//! Events: event messages, missing references, gaps, and time stamps that go back.

use super::{
    figures::{Event, EventKind, ModeFigures, identifier, rounded},
    guidance::UNKNOWN,
    timing::Irregularity,
};
use crate::network::{
    SAME_CHANGE,
    decode::{Decoder, Field, Known},
};

/// Most events that are kept; a bus in trouble may have millions.
const MOST: usize = 100_000;
/// Signals that only number or time-stamp an event; they are left out of its description.
const BESIDE: [&str; 2] = ["Counter", "SystemTime"];

/// The events so far.
#[derive(Default)]
pub(super) struct Events {
    all: Vec<Event>,
    left_out: u64,
    /// Name of the value table of the modes.
    modes: Option<String>,
}

impl Events {
    /// `modes` is the value table of the vehicle's modes.
    pub(super) fn new(modes: Option<String>) -> Self {
        Self {
            modes,
            ..Self::default()
        }
    }

    /// Adds an event at `at`, s.
    pub(super) fn add(&mut self, at: f64, kind: EventKind, what: impl FnOnce() -> String) {
        if self.all.len() >= MOST {
            self.left_out += 1;
            return;
        }
        self.all.push(Event {
            // The first frame began before its stamp, from which times count.
            at_seconds: rounded(at.max(0.0), 6),
            kind,
            what: what(),
        });
    }

    /// Takes an event message.
    pub(super) fn take(&mut self, at: f64, message: &Known, data: &[u8; 8]) {
        let kind = self.kind(message, data);
        self.add(at, kind, || match kind {
            EventKind::Mode => change(message, data),
            EventKind::Button => button(message, data),
            _ => format!("{}: {}", message.name, values(message, data)),
        });
    }

    fn kind(&self, message: &Known, data: &[u8; 8]) -> EventKind {
        let tabled = |name: &str| {
            let mut fields = message.fields.iter();
            fields.find(|field| field.table.as_deref() == Some(name))
        };
        let modes = self.modes.as_deref();
        if modes.and_then(tabled).is_some() && message.field("Previous").is_some() {
            return EventKind::Mode;
        }
        if message.field("Button").is_some() {
            return EventKind::Button;
        }
        match message.field("Fault").filter(|field| field.has_names()) {
            Some(fault) if fault.raw(data) != 0 => EventKind::Fault,
            Some(_) => EventKind::Status,
            None => EventKind::Message,
        }
    }

    /// Adds missing references and changes of the time master.
    pub(super) fn irregular(&mut self, decoder: &Decoder, all: &[Irregularity]) {
        for one in all {
            match *one {
                Irregularity::Empty(at, id, windows) => {
                    self.add(at as f64 * 1e-9, EventKind::EmptyWindow, || {
                        let message = decoder.message(id);
                        let (name, sender) =
                            message.map_or(("?", "?"), |known| (&known.name, &known.sender));
                        let s = if windows == 1 { "" } else { "s" };
                        format!("{name} of {sender}: {windows} window{s} in a row stayed empty from here on")
                    });
                }
                Irregularity::Misplaced(at, id, extended, ref window) => {
                    self.add(at as f64 * 1e-9, EventKind::Misplaced, || {
                        let place = window.as_ref().map_or_else(
                            || "outside all windows".to_owned(),
                            |window| format!("in the window of {window}"),
                        );
                        format!("first frame of {} {place}", identifier(id, extended))
                    });
                }
                Irregularity::MissingReferences(at, missing) => {
                    let last = at as f64 * 1e-9;
                    self.add(last, EventKind::MissingReference, || {
                        let s = if missing == 1 { "" } else { "s" };
                        format!("{missing} reference message{s} missing after this one")
                    });
                }
                Irregularity::Master(at, id) => {
                    self.add(at as f64 * 1e-9, EventKind::Master, || {
                        let sender = decoder.message(id).map_or("unknown", |one| &one.sender);
                        format!("{sender} leads the bus with reference {id}")
                    });
                }
            }
        }
    }

    /// All events in order of time. Changes of the mode without a message of their own are added.
    pub(super) fn finish(mut self, modes: &[ModeFigures]) -> (Vec<Event>, u64) {
        let told: Vec<(f64, String)> = self
            .all
            .iter()
            .filter(|event| event.kind == EventKind::Mode)
            .map(|event| (event.at_seconds, event.what.clone()))
            .collect();
        for pair in modes.windows(2) {
            let [before, after] = pair else {
                continue;
            };
            if before.mode == UNKNOWN || after.mode == UNKNOWN {
                continue;
            }
            let at = after.from_seconds;
            let first = told.partition_point(|(told, _)| *told < at - SAME_CHANGE);
            let near = told.get(first..).unwrap_or_default().iter();
            let mut near = near.take_while(|(told, _)| *told < at + SAME_CHANGE);
            if !near.any(|(_, what)| what.contains(&after.mode)) {
                self.add(at, EventKind::Mode, || {
                    format!(
                        "{} to {}, without a message that tells the reason",
                        before.mode, after.mode
                    )
                });
            }
        }
        self.all
            .sort_by(|one, other| one.at_seconds.total_cmp(&other.at_seconds));
        (self.all, self.left_out)
    }
}

/// The name of a value, or else its number with the unit.
fn shown(field: &Field, data: &[u8; 8]) -> String {
    match field.named(data) {
        Some(name) => name.to_owned(),
        None => {
            let number = format!("{:.*} {}", field.decimals, field.value(data), field.unit);
            number.trim_end().to_owned()
        }
    }
}

fn of(message: &Known, signal: &str, data: &[u8; 8]) -> Option<String> {
    message.field(signal).map(|field| shown(field, data))
}

/// A change of the mode with its reason.
fn change(message: &Known, data: &[u8; 8]) -> String {
    let get = |signal| of(message, signal, data).unwrap_or_default();
    let reason =
        of(message, "Reason", data).map_or_else(String::new, |reason| format!(", reason {reason}"));
    format!("{} to {}{reason}", get("Previous"), get("Mode"))
}

/// A button that was pressed or released.
fn button(message: &Known, data: &[u8; 8]) -> String {
    let pressed = message.field("Pressed").map(|field| field.raw(data) != 0);
    let pressed = match pressed {
        Some(true) => " pressed",
        Some(false) => " released",
        None => "",
    };
    let button = of(message, "Button", data).unwrap_or_default();
    format!("{button}{pressed}")
}

/// So many signals with the same named value are told by their number: the checks that passed.
const MANY: usize = 4;

/// The signals with their values, without counters and zeros.
fn values(message: &Known, data: &[u8; 8]) -> String {
    let fields = message.fields.iter();
    let told: Vec<(&Field, String)> = fields
        .filter(|field| !BESIDE.contains(&field.name.as_str()))
        .filter(|field| field.has_names() || field.raw(data) != 0)
        .map(|field| (field, shown(field, data)))
        .collect();
    let alike = |one: &Field, value: &str| {
        let same = told
            .iter()
            .filter(|(other, shown)| other.table == one.table && shown == value);
        same.count()
    };
    let mut parts: Vec<String> = Vec::new();
    for (field, value) in &told {
        let part = match alike(field, value) {
            count if field.has_names() && count >= MANY => format!("{count} times {value}"),
            _ => format!("{} {value}", field.name),
        };
        if !parts.contains(&part) {
            parts.push(part);
        }
    }
    parts.join(", ")
}
