//! What a run of a scenario must show.

use core::fmt;

use network_model::Message;
use serde::Deserialize;
use vehicle_model::Vehicle;

use super::Scenario;
use super::check::{above, between, times, whole, within};
use crate::units::{Length, Time};

/// Something that the run must show. A run that ends earlier does not judge it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "what", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Expectation {
    /// The vehicle is in a mode, as the message tells that carries the mode.
    Mode {
        /// When.
        at: Time,
        /// The mode's name in the network file.
        mode: String,
    },
    /// The vehicle stays close to its line, or to the middle of its row.
    Error {
        /// From when on.
        from: Time,
        /// Until when; the end of the run if left out.
        until: Option<Time>,
        /// The error stays below this on both sides, above 0 to 100 m.
        below: Length,
    },
    /// All motors come to rest.
    Stop {
        /// The time from which they are watched.
        after: Time,
        /// How soon they have no effort, 0 to 3600 s.
        within: Time,
    },
    /// A message is sent.
    Frames {
        /// Its name in the network file.
        message: String,
        /// From when on.
        #[serde(default = "start")]
        from: Time,
        /// Until when; the end of the run if left out.
        until: Option<Time>,
        /// At least so often. Default 0.
        #[serde(default)]
        least: u64,
        /// At most so often; any number if left out.
        most: Option<u64>,
    },
    /// Each frame of a message carries a value.
    Signal {
        /// The name of the message in the network file.
        message: String,
        /// The name of the signal, which has names for its values.
        signal: String,
        /// The name of the value.
        value: String,
        /// From when on.
        #[serde(default = "start")]
        from: Time,
        /// Until when; the end of the run if left out.
        until: Option<Time>,
    },
    /// No window stayed empty whose message was due, and no frame was foreign, outside its window or destroyed.
    CleanBus {},
    /// A figure of the whole run is small.
    Count {
        /// The figure.
        of: Figure,
        /// At most so much. Default 0.
        #[serde(default)]
        most: u64,
    },
}

/// Something that is counted in a run.
#[derive(Copy, Clone, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Figure {
    /// Exclusive windows that stayed empty although their message was due and had been sent before.
    MissedWindows,
    /// Frames of exclusive messages outside their windows.
    MisplacedFrames,
    /// Frames whose identifier no message has.
    ForeignFrames,
    /// Frames that ended in an error frame.
    ErrorFrames,
    /// Contacts with plants, poles or barriers.
    Contacts,
}

impl fmt::Display for Figure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::MissedWindows => "missed windows",
            Self::MisplacedFrames => "frames outside their windows",
            Self::ForeignFrames => "foreign frames",
            Self::ErrorFrames => "error frames",
            Self::Contacts => "contacts",
        })
    }
}

fn start() -> Time {
    Time::new(0.0)
}

/// A span of time in words.
struct During(Time, Option<Time>);

impl fmt::Display for During {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.0.get() == 0.0, &self.1) {
            (true, None) => f.write_str("in the whole run"),
            (false, None) => write!(f, "from {} on", self.0),
            (_, Some(until)) => write!(f, "from {} to {until}", self.0),
        }
    }
}

impl fmt::Display for Expectation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Mode { at, mode } => write!(f, "mode {mode} at {at}"),
            Self::Error { from, until, below } => {
                write!(f, "error below {below} {}", During(*from, *until))
            }
            Self::Stop { after, within } => write!(f, "motors at rest {within} after {after}"),
            Self::Frames {
                message,
                from,
                until,
                least,
                most,
            } => {
                let during = During(*from, *until);
                match most {
                    Some(most) => write!(f, "{least} to {most} frames {message} {during}"),
                    None => write!(f, "{least} frames {message} or more {during}"),
                }
            }
            Self::Signal {
                message,
                signal,
                value,
                from,
                until,
            } => write!(
                f,
                "{message} with {signal} = {value} {}",
                During(*from, *until)
            ),
            Self::CleanBus {} => f.write_str("a clean bus"),
            Self::Count { of, most } => write!(f, "at most {most} {of}"),
        }
    }
}

impl Expectation {
    /// The time, in seconds, that a run must reach to judge it; `None` for its end, whenever that is.
    pub(crate) fn judged_at(&self) -> Option<f64> {
        match self {
            Self::Mode { at, .. } => Some(at.get()),
            Self::Stop { after, within } => Some(after.get() + within.get()),
            Self::Error { from, until, .. }
            | Self::Frames { from, until, .. }
            | Self::Signal { from, until, .. } => {
                // With an open end, a run that ends before the begin shows nothing.
                Some(until.as_ref().unwrap_or(from).get())
            }
            Self::CleanBus {} | Self::Count { .. } => None,
        }
    }

    /// When the period begins that it looks at, seconds; `None` if it looks at no period.
    pub(crate) fn begins_at(&self) -> Option<f64> {
        match self {
            Self::Error { from, .. } | Self::Frames { from, .. } | Self::Signal { from, .. } => {
                Some(from.get())
            }
            Self::Mode { .. } | Self::Stop { .. } | Self::CleanBus {} | Self::Count { .. } => None,
        }
    }
}

/// Checks the expectations of a scenario.
pub(super) fn check(scenario: &Scenario, vehicle: &Vehicle) -> Result<(), String> {
    for (i, expectation) in scenario.expect.iter().enumerate() {
        let field = format!("expect[{i}]");
        one(&field, expectation, scenario, vehicle)?;
        let end = scenario.duration.get();
        if let Some(at) = expectation.judged_at().filter(|at| *at > end) {
            return Err(format!(
                "{field}: it is judged at {} only, and the run ends at {}",
                Time::new(at),
                scenario.duration
            ));
        }
        if expectation.begins_at().is_some_and(|from| from >= end) {
            return Err(format!(
                "{field}: its period begins at {}, when the run ends",
                scenario.duration
            ));
        }
    }
    Ok(())
}

fn one(
    field: &str,
    expectation: &Expectation,
    scenario: &Scenario,
    vehicle: &Vehicle,
) -> Result<(), String> {
    let name = |of: &str| format!("{field}.{of}");
    let span = |from: Time, until: Option<Time>| {
        within(&name("from"), from, times())?;
        until.map_or(Ok(()), |until| {
            within(&name("until"), until, above(from, Time::new(86_400.0)))
        })
    };
    match expectation {
        Expectation::Mode { at, mode } => {
            within(&name("at"), *at, times())?;
            let Some(signal) = &vehicle.manifest().mode else {
                return Err(format!(
                    "{field}: vehicle {:?} tells no mode: vehicle.toml has no [mode]",
                    vehicle.name()
                ));
            };
            value(
                &name("mode"),
                vehicle,
                &signal.message,
                &signal.signal,
                mode,
            )
        }
        Expectation::Error { from, until, below } => {
            span(*from, *until)?;
            let most = Length::new(100.0);
            within(&name("below"), *below, above(Length::new(0.0), most))?;
            if scenario.line.is_none() && scenario.row.is_none() {
                return Err(format!("{field}: there is neither a line nor a row"));
            }
            Ok(())
        }
        Expectation::Stop {
            after,
            within: soon,
        } => {
            within(&name("after"), *after, times())?;
            let range = between(Time::new(0.0), Time::new(3600.0));
            within(&name("within"), *soon, range)
        }
        Expectation::Frames {
            message,
            from,
            until,
            least,
            most,
        } => {
            span(*from, *until)?;
            whole(&name("most"), most.unwrap_or(*least), *least, u64::MAX)?;
            if (*least, *most) == (0, None) {
                return Err(format!(
                    "{field}: any number of frames would do: it takes least or most"
                ));
            }
            find(&name("message"), vehicle, message).map(|_| ())
        }
        Expectation::Signal {
            message,
            signal,
            value: wanted,
            from,
            until,
        } => {
            span(*from, *until)?;
            find(&name("message"), vehicle, message)?;
            value(&name("signal"), vehicle, message, signal, wanted)
        }
        Expectation::CleanBus {} | Expectation::Count { .. } => Ok(()),
    }
}

/// The message of this name.
fn find<'v>(field: &str, vehicle: &'v Vehicle, name: &str) -> Result<&'v Message, String> {
    let messages = &vehicle.network().messages;
    messages
        .iter()
        .find(|message| message.name == name)
        .ok_or_else(|| {
            let names: Vec<&str> = messages.iter().map(|one| one.name.as_str()).collect();
            format!(
                "{field}: there is no message {name:?}: {}",
                names.join(", ")
            )
        })
}

/// Checks that a signal has a value of this name.
fn value(
    field: &str,
    vehicle: &Vehicle,
    message: &str,
    signal: &str,
    value: &str,
) -> Result<(), String> {
    let message = find(field, vehicle, message)?;
    let tables = &vehicle.network().value_tables;
    let named: Vec<(&str, Vec<&str>)> = message
        .signals
        .iter()
        .filter_map(|signal| {
            let table = signal.values.as_ref()?;
            let table = tables.iter().find(|one| one.name == *table)?;
            let names = table.values.iter().map(|value| value.name.as_str());
            Some((signal.name.as_str(), names.collect()))
        })
        .collect();
    let Some((_, values)) = named.iter().find(|(name, _)| *name == signal) else {
        let names: Vec<&str> = named.iter().map(|(name, _)| *name).collect();
        return Err(format!(
            "{field}: {} has no signal {signal:?} with names for its values: {}",
            message.name,
            if names.is_empty() {
                "no signal of it has".to_owned()
            } else {
                names.join(", ")
            }
        ));
    };
    if values.contains(&value) {
        return Ok(());
    }
    Err(format!(
        "{field}: {signal} has no value {value:?}: {}",
        values.join(", ")
    ))
}
