//! The messages of the self-test, by the network file.

use std::time::Duration;

use can_bus::Frame;
use network_model::{Message, Network, Signal};
use vehicle_model::{NodeIndex, Vehicle};

use super::schedule::{self, Begin, Place};

/// The signal that a report repeats from its request.
const ROUND: &str = "Round";

/// The signal by which a request asks for a start.
const START_AGAIN: &str = "StartAgain";

/// The signal that tells a request from a frame by chance.
const KEY: &str = "Key";

/// Names of a check's results in the value table of its signal.
const PASSED: &str = "Passed";
const NOT_DONE: &str = "NotDone";

/// The messages of a vehicle's self-test.
pub struct Messages<'v> {
    vehicle: &'v str,
    network: &'v Network,
    request: &'v Message,
    /// The report of each node, in the order of the manifest.
    reports: Vec<&'v Message>,
}

/// The report of a node.
#[derive(Debug, Clone, PartialEq)]
pub struct Report {
    /// Round of the request that it answers; 0 after a reset.
    pub round: u8,
    /// The results of the checks.
    pub checks: Vec<Check>,
    /// The measured values.
    pub values: Vec<Value>,
}

/// The result of a check.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Check {
    /// Its name, that of the signal.
    pub name: String,
    /// The result.
    pub result: Outcome,
    /// What is so when it passes.
    pub meaning: String,
}

/// Whether a check has passed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Outcome {
    /// It was not done.
    NotDone,
    /// It has passed.
    Passed,
    /// It has failed, or the report has a value that the network file does not name.
    Failed,
}

impl Outcome {
    /// The word for it.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::NotDone => "not done",
            Self::Passed => "passed",
            Self::Failed => "failed",
        }
    }
}

/// A measured value.
#[derive(Debug, Clone, PartialEq)]
pub struct Value {
    /// Its name, that of the signal.
    pub name: String,
    /// The physical value.
    pub value: f64,
    /// Digits behind the point that its resolution has.
    pub digits: usize,
    /// The unit.
    pub unit: String,
}

impl Report {
    /// The checks that have failed.
    pub fn failed(&self) -> impl Iterator<Item = &Check> {
        self.with(Outcome::Failed)
    }

    /// The checks that were not done.
    pub fn not_done(&self) -> impl Iterator<Item = &Check> {
        self.with(Outcome::NotDone)
    }

    fn with(&self, result: Outcome) -> impl Iterator<Item = &Check> {
        let checks = self.checks.iter();
        checks.filter(move |check| check.result == result)
    }
}

impl<'v> Messages<'v> {
    /// The messages that the vehicle's manifest names; `None` if it names none.
    #[must_use]
    pub fn of(vehicle: &'v Vehicle) -> Option<Self> {
        let network = vehicle.network();
        let names = vehicle.manifest().self_test.as_ref()?;
        let find = |name: &str| {
            let mut messages = network.messages.iter();
            messages.find(|message| message.name == name)
        };
        let report = |node: NodeIndex| find(names.report.get(&vehicle.node(node).name)?);
        Some(Self {
            vehicle: vehicle.name(),
            network,
            request: find(&names.request)?,
            reports: vehicle.participants().map(report).collect::<Option<_>>()?,
        })
    }

    /// The bit rate of the bus.
    #[must_use]
    pub fn bit_rate(&self) -> u32 {
        self.network.bit_rate
    }

    /// Name of the vehicle.
    pub(super) fn vehicle(&self) -> &'v str {
        self.vehicle
    }

    /// Length of the basic cycle.
    pub(super) fn basic_cycle(&self) -> Duration {
        micros(self.network.basic_cycle_us)
    }

    /// The frame that asks for the self-test.
    ///
    /// # Panics
    /// Never for a network file that was read: its identifiers have 11 bits.
    #[must_use]
    pub fn request(&self, round: u8, start_again: bool) -> Frame {
        let mut data = [0; 8];
        for signal in &self.request.signals {
            match signal.name.as_str() {
                ROUND => signal.insert(&mut data, i128::from(round)),
                START_AGAIN => signal.insert(&mut data, i128::from(start_again)),
                KEY => signal.insert(&mut data, i128::from(firmware::selftest::KEY)),
                _ => {}
            }
        }
        let length = usize::from(self.request.length).min(8);
        Frame::standard(self.request.id, &data[..length]).expect("an identifier of 11 bits")
    }

    /// When the request may begin.
    pub(super) fn place(&self) -> Place {
        schedule::place(self.network, self.request, 1)
    }

    /// Whether the basic cycle of that number has the request's window.
    pub(super) fn has_window(&self, cycle: u8) -> bool {
        schedule::has_window(self.request, cycle)
    }

    /// The begin of a basic cycle, if the frame that ended at `end` is a reference message.
    pub(super) fn begin(&self, frame: &Frame, end: Duration) -> Option<Begin> {
        schedule::begin(self.network, frame, end)
    }

    /// The message of a frame.
    pub(super) fn message(&self, frame: &Frame) -> Option<&'v Message> {
        schedule::message(self.network, frame)
    }

    /// Index of the node and its report, if the frame is one.
    #[must_use]
    pub fn report(&self, frame: &Frame) -> Option<(usize, Report)> {
        let message = self.message(frame)?;
        let mut reports = self.reports.iter();
        let node = reports.position(|report| report.id == message.id)?;
        if frame.dlc() < message.shortest {
            return None;
        }
        let data = frame.data();
        let mut report = Report {
            round: 0,
            checks: Vec::new(),
            values: Vec::new(),
        };
        for signal in &message.signals {
            let raw = signal.extract(data);
            if signal.name == ROUND {
                report.round = u8::try_from(raw).unwrap_or(u8::MAX);
            } else if let Some(result) = self.outcome(signal, raw) {
                report.checks.push(Check {
                    name: signal.name.clone(),
                    result,
                    meaning: signal.comment.clone(),
                });
            } else {
                report.values.push(Value {
                    name: signal.name.clone(),
                    value: signal.physical(raw),
                    digits: digits(signal.factor),
                    unit: signal.unit.clone(),
                });
            }
        }
        Some((node, report))
    }

    /// The result of a check; `None` if the signal is none: its value table names no result.
    fn outcome(&self, signal: &Signal, raw: i128) -> Option<Outcome> {
        let name = signal.values.as_ref()?;
        let mut tables = self.network.value_tables.iter();
        let values = &tables.find(|table| table.name == *name)?.values;
        let raw_of = |name: &str| {
            let value = values.iter().find(|value| value.name == name)?;
            Some(i128::from(value.raw))
        };
        let passed = raw_of(PASSED)?;
        Some(match raw {
            _ if raw == passed => Outcome::Passed,
            _ if Some(raw) == raw_of(NOT_DONE) => Outcome::NotDone,
            _ => Outcome::Failed,
        })
    }
}

/// Digits behind the point of a resolution.
fn digits(factor: f64) -> usize {
    (0..6)
        .find(|digits| {
            let scaled = factor * 10_f64.powi(*digits);
            (scaled - scaled.round()).abs() < 1e-9
        })
        .map_or(6, |digits| digits as usize)
}

fn micros(us: u32) -> Duration {
    Duration::from_micros(u64::from(us))
}
