//! Where a run is to halt: a time, or something that happens.

use can_bus::{Record, RecordKind};
use embedded_can::Id;
use twin::Twin;
use vehicle_model::{NodeIndex, Vehicle, units::Time};
use world::{SimTime, time, time::Span as _};

use super::super::bus::Log;
use crate::network::matrix::Matrix;

/// The forms that are accepted.
pub(crate) const FORMS: &str = "\"12.5 s\", frame:0x12C, frame:MESSAGE, mode:NAME or reset:NODE";

/// Where a run is to halt.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Until {
    /// At this time.
    Time(SimTime),
    /// When a frame with this identifier begins.
    Frame(u16),
    /// When a frame tells a change to this mode.
    Mode(String),
    /// When this node is reset.
    Reset(NodeIndex),
}

impl Until {
    /// Reads it as a user writes it.
    ///
    /// # Errors
    ///
    /// A sentence that says what is accepted.
    pub(super) fn parse(text: &str, vehicle: &Vehicle) -> Result<Self, String> {
        // The forms are written with quotation marks, as a shell wants them.
        let text = text.trim().trim_matches('"').trim();
        match text.split_once(':') {
            Some(("frame", what)) => frame(what, vehicle).map(Self::Frame),
            Some(("mode", name)) => {
                let known = Matrix::new(vehicle).mode_names();
                if known.iter().any(|mode| mode == name) {
                    Ok(Self::Mode(name.to_owned()))
                } else if known.is_empty() {
                    Err(format!(
                        "vehicle {} has no modes: \"12.5 s\", frame:0x12C, frame:MESSAGE or reset:NODE is accepted",
                        vehicle.name()
                    ))
                } else {
                    Err(format!(
                        "vehicle {} has no mode {name}, but {}",
                        vehicle.name(),
                        known.join(", ")
                    ))
                }
            }
            Some(("reset", node)) => crate::vehicle::nodes(vehicle, &[node.to_owned()])
                .map(|nodes| Self::Reset(nodes[0]))
                .map_err(|error| error.to_string()),
            _ => text
                .parse::<Time>()
                .map(|time| Self::Time(time::at(time.span())))
                .map_err(|_| {
                    format!("{text:?} is neither a time nor an event: {FORMS} is accepted")
                }),
        }
    }
}

/// The identifier of a frame, given by its number or the name of its message.
fn frame(what: &str, vehicle: &Vehicle) -> Result<u16, String> {
    let number = match what.strip_prefix("0x").or(what.strip_prefix("0X")) {
        Some(hex) => u16::from_str_radix(hex, 16).ok(),
        None => what.parse().ok(),
    };
    let mut messages = vehicle.network().messages.iter();
    let named = messages.find(|message| message.name == what);
    let id = named.map(|message| message.id).or(number);
    id.filter(|id| *id < 1 << 11).ok_or_else(|| {
        format!(
            "{what:?} is no frame of vehicle {}: an identifier from 0 to 0x7FF or the name of a message is accepted",
            vehicle.name()
        )
    })
}

/// Looks for an event in a run, from now on.
#[derive(Debug)]
pub(super) struct Watcher<'v> {
    until: Until,
    vehicle: &'v Vehicle,
    /// Records of the bus that have been looked at.
    records: usize,
    /// Resets of the node until now.
    resets: usize,
    /// The mode before.
    mode: Option<String>,
}

impl<'v> Watcher<'v> {
    /// From this state of the run on.
    pub(super) fn new(until: Until, vehicle: &'v Vehicle, twin: &Twin, records: &[Record]) -> Self {
        let resets = match until {
            Until::Reset(node) => twin.node(node).resets().len(),
            _ => 0,
        };
        let mode = match until {
            Until::Mode(_) => modes(vehicle, records).pop().map(|(_, mode)| mode),
            _ => None,
        };
        Self {
            until,
            vehicle,
            records: records.len(),
            resets,
            mode,
        }
    }

    /// When it happened first, if it did since the last call.
    pub(super) fn happened(&mut self, twin: &Twin, records: &[Record]) -> Option<SimTime> {
        let fresh = records.get(self.records..).unwrap_or_default();
        self.records = records.len();
        match &self.until {
            Until::Time(_) => None,
            Until::Frame(wanted) => fresh.iter().find_map(|record| match &record.kind {
                RecordKind::FrameStart { frame } => match frame.id() {
                    Id::Standard(id) if id.as_raw() == *wanted => Some(record.at),
                    _ => None,
                },
                _ => None,
            }),
            Until::Mode(wanted) => {
                let mut before = self.mode.take();
                let mut at = None;
                for (time, mode) in modes(self.vehicle, fresh) {
                    if mode == *wanted && before.as_ref() != Some(wanted) {
                        at = at.or(Some(time));
                    }
                    before = Some(mode);
                }
                self.mode = before;
                at
            }
            Until::Reset(node) => {
                let resets = twin.node(*node).resets();
                let first = resets.get(self.resets);
                self.resets = resets.len();
                first.map(|(at, _)| *at)
            }
        }
    }
}

/// The changes of the vehicle's mode that these records tell.
fn modes(vehicle: &Vehicle, records: &[Record]) -> Vec<(SimTime, String)> {
    let matrix = Matrix::new(vehicle);
    let log = Log::new(records, matrix.bit_time());
    let changes = matrix.modes(&log.frames).into_iter();
    changes.map(|change| (change.at, change.mode)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Workspace;

    #[test]
    fn times_and_events_are_read_and_others_are_refused_in_a_sentence() {
        let workspace = Workspace::find().unwrap();
        let vehicle = crate::vehicle::find(&workspace, "uagv").unwrap();
        let read = |text: &str| Until::parse(text, &vehicle);
        assert_eq!(
            read("12.5 s"),
            Ok(Until::Time(SimTime::from_ticks(12_500_000_000_000)))
        );
        assert_eq!(
            read("300 ms"),
            Ok(Until::Time(SimTime::from_ticks(300_000_000_000)))
        );
        assert_eq!(read("frame:0x12C"), Ok(Until::Frame(300)));
        assert_eq!(read("frame:300"), Ok(Until::Frame(300)));
        let name = &vehicle.network().message(300).unwrap().name;
        assert_eq!(read(&format!("frame:{name}")), Ok(Until::Frame(300)));
        assert_eq!(read("mode:Idle"), Ok(Until::Mode("Idle".into())));
        let gps = vehicle.find_node("gps").unwrap();
        assert_eq!(read("reset:gps"), Ok(Until::Reset(gps)));
        for (text, part) in [
            (
                "soon",
                "frame:0x12C, frame:MESSAGE, mode:NAME or reset:NODE is accepted",
            ),
            ("frame:0x800", "from 0 to 0x7FF"),
            ("mode:Sleepy", "has no mode Sleepy, but Idle, "),
            ("reset:nobody", "has no node nobody, but gps, "),
        ] {
            let error = read(text).unwrap_err();
            assert!(error.contains(part), "{error}");
        }
        let bench = crate::vehicle::find(&workspace, "two-boards").unwrap();
        let error = Until::parse("mode:Idle", &bench).unwrap_err();
        assert!(
            error.starts_with("vehicle two-boards has no modes: "),
            "{error}"
        );
    }
}
