//! The bus log of a calibration drive.

use can_bus::candump::{Line, ParseError};
use embedded_can::Id;
use network_model::{Message, Network, Signal};
use vehicle_model::manifest::SignalPath;
use vehicle_model::units::{CountKind, LengthKind, RateKind, factor};
use vehicle_model::{Device, Vehicle};

/// A signal and the message that carries it.
#[derive(Debug, Clone)]
struct Field {
    message: Message,
    signal: Signal,
    /// Factor from the signal's unit to the base unit.
    factor: f64,
}

impl Field {
    fn new(network: &Network, message: &str, signal: &str) -> Option<Self> {
        let mut messages = network.messages.iter();
        let message = messages.find(|other| other.name == message)?;
        let mut signals = message.signals.iter();
        let signal = signals.find(|other| other.name == signal)?;
        Some(Self {
            message: message.clone(),
            signal: signal.clone(),
            factor: 1.0,
        })
    }

    /// The signal's value in base units, or the reason why there is none.
    fn value(&self, data: &[u8]) -> Result<f64, String> {
        let Message {
            shortest, length, ..
        } = self.message;
        if !(usize::from(shortest)..=usize::from(length)).contains(&data.len()) {
            return Err(format!(
                "it has {} data bytes, {length} are accepted",
                data.len()
            ));
        }
        let Signal { name, min, max, .. } = &self.signal;
        let value = self.signal.physical(self.signal.extract(data));
        if !(*min..=*max).contains(&value) {
            return Err(format!("{name} is {value}: {min} to {max} is accepted"));
        }
        Ok(value * self.factor)
    }
}

/// The signals that a calibration reads from a vehicle's bus.
#[derive(Debug, Clone)]
pub(super) struct Signals {
    pot: Field,
    rate: Field,
    enabled: Field,
    north: Field,
    east: Field,
}

impl Signals {
    /// The signals that the vehicle's manifest names; `None` if it names none.
    pub(super) fn of(vehicle: &Vehicle) -> Option<Self> {
        let (network, manifest) = (vehicle.network(), vehicle.manifest());
        let named = manifest.calibration.as_ref()?;
        let enabled = manifest.command.as_ref()?;
        let field = |path: &SignalPath, factor: fn(&str) -> Option<f64>| {
            let field = Field::new(network, &path.message, &path.signal)?;
            let factor = factor(&field.signal.unit)?;
            Some(Field { factor, ..field })
        };
        let motor = enabled.enable.get(&Device::SteeringMotor)?;
        Some(Self {
            pot: field(&named.potentiometer, factor::<CountKind>)?,
            rate: field(&named.steering_rate, factor::<RateKind>)?,
            enabled: Field::new(network, &enabled.message, motor)?,
            north: field(&named.north, factor::<LengthKind>)?,
            east: field(&named.east, factor::<LengthKind>)?,
        })
    }
}

/// A command to the steering.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Command {
    /// Steering rate, rad/s, positive to the right.
    pub(super) rate: f64,
    /// Whether the steering may move.
    pub(super) enabled: bool,
}

/// The data of a log that a calibration needs. Times are seconds from its first line.
#[derive(Debug, Default)]
pub(super) struct Recording {
    /// Potentiometer readings, counts.
    pub(super) pots: Vec<(f64, u16)>,
    /// Commands to the actuators.
    pub(super) commands: Vec<(f64, Command)>,
    /// Positions of the antenna with an RTK-fixed solution, m north and east, in order of time.
    pub(super) positions: Vec<(f64, f64, f64)>,
    /// Lines that are no frames of classical CAN.
    pub(super) skipped: usize,
}

impl Recording {
    /// Reads a candump log; frames without any of the signals are skipped. Error frames and CAN
    /// FD frames are skipped and counted.
    ///
    /// # Errors
    ///
    /// A sentence that names the line that cannot be read, or the message that is missing.
    pub(super) fn read(signals: &Signals, text: &str) -> Result<Self, String> {
        let mut recording = Self::default();
        let mut first = None;
        for (number, line) in text.lines().enumerate() {
            if line.trim().is_empty() {
                continue;
            }
            let wrong = |what: &str| format!("line {}: {what}: {line:?}", number + 1);
            let (whole, line) = from_zero(line, &mut first);
            if !whole {
                return Err(wrong("the time is before that of the first line"));
            }
            let line: Line = match line.parse() {
                Ok(line) => line,
                Err(ParseError::ErrorFrame | ParseError::Fd) => {
                    recording.skipped += 1;
                    continue;
                }
                Err(error) => return Err(wrong(&format!("{error}"))),
            };
            let id = match line.frame.id() {
                Id::Standard(id) if !line.frame.is_remote() => id,
                _ => continue,
            };
            let time = line.at.as_ticks() as f64 * 1e-12;
            recording
                .add(signals, time, id.as_raw(), line.frame.data())
                .map_err(|what| wrong(&format!("message {}: {what}", id.as_raw())))?;
        }
        recording.check(signals)
    }

    fn add(&mut self, signals: &Signals, time: f64, id: u16, data: &[u8]) -> Result<(), String> {
        let Signals {
            pot,
            rate,
            enabled,
            north,
            east,
        } = signals;
        if id == pot.message.id {
            self.pots.push((time, pot.value(data)?.round() as u16));
        }
        if id == rate.message.id {
            let command = Command {
                rate: rate.value(data)?,
                enabled: enabled.value(data)? != 0.0,
            };
            self.commands.push((time, command));
        }
        if id == north.message.id {
            let position = (time, north.value(data)?, east.value(data)?);
            self.positions.push(position);
        }
        Ok(())
    }

    /// Returns the recording if it has all the data that a calibration needs.
    fn check(mut self, signals: &Signals) -> Result<Self, String> {
        let needed = [
            (self.pots.is_empty(), &signals.pot),
            (self.commands.is_empty(), &signals.rate),
            (self.positions.is_empty(), &signals.north),
        ];
        let all = needed.map(|(_, field)| field.message.id.to_string());
        match needed.iter().find(|(empty, _)| *empty) {
            Some((_, Field { message, .. })) => Err(format!(
                "there is no message {} ({}): a calibration needs all of {}",
                message.id,
                message.name,
                all.join(", ")
            )),
            None => {
                self.positions
                    .sort_by(|one, other| one.0.total_cmp(&other.0));
                Ok(self)
            }
        }
    }
}
/// The line with the seconds of the first line subtracted, because loggers write the time of day as
/// seconds since 1970. False if this line is earlier than the first one.
fn from_zero(line: &str, first: &mut Option<u64>) -> (bool, String) {
    let stamp = line.trim_start().strip_prefix('(');
    let Some((seconds, rest)) = stamp.and_then(|stamp| stamp.split_once('.')) else {
        return (true, line.to_owned());
    };
    let Ok(seconds) = seconds.parse::<u64>() else {
        return (true, line.to_owned());
    };
    let first = *first.get_or_insert(seconds);
    match seconds.checked_sub(first) {
        Some(seconds) => (true, format!("({seconds}.{rest}")),
        None => (false, String::new()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn signals() -> Signals {
        let workspace = crate::Workspace::find().unwrap();
        Signals::of(&crate::vehicle::find(&workspace, "uagv").unwrap()).unwrap()
    }

    /// One period of the bus of the thesis's vehicle, with the time of day.
    const PERIOD: &str = "\
        (1436509052.249713) can0 0C8#EAFFFFFF36000000\n\
        (1436509052.252470) can0 0CE#3C03\n\
        (1436509053.253470) can0 12C#0000060000000000\n";

    #[test]
    fn times_count_from_the_first_line() {
        let recording = Recording::read(&signals(), PERIOD).unwrap();
        let [(pot_at, 828)] = recording.pots[..] else {
            panic!("{:?}", recording.pots);
        };
        assert!((pot_at - 0.252_470).abs() < 1e-9);
        assert!((recording.commands[0].0 - 1.253_470).abs() < 1e-9);
        let [(position_at, north, east)] = recording.positions[..] else {
            panic!("{:?}", recording.positions);
        };
        assert!((position_at - 0.249_713).abs() < 1e-9);
        assert_eq!((north, east), (-0.022, 0.054));
    }

    #[test]
    fn what_is_no_frame_of_classical_can_is_skipped_and_counted() {
        let log = format!(
            "{PERIOD}\
             (1436509053.300000) can0 20000004#0004000000000000\n\
             (1436509053.400000) can0 0CE##13C03\n\
             (1436509053.500000) can0 0CE#R2\n\
             (1436509053.600000) can0 0CE#3D03 R\n\
             (1436509053.700000) can0 0CE#3E03 T\n"
        );
        let recording = Recording::read(&signals(), &log).unwrap();
        assert_eq!(recording.skipped, 2);
        let counts: Vec<u16> = recording.pots.iter().map(|(_, count)| *count).collect();
        assert_eq!(counts, [828, 829, 830]);
    }

    #[test]
    fn what_cannot_be_read_is_named_with_its_line() {
        for (from, to, named) in [
            (
                "0CE#3C03",
                "0CE#3C0",
                "line 2: expected up to eight data bytes",
            ),
            ("0CE#3C03", "0CE#3C0304", "line 2: message 206"),
            ("(1436509053", "(1436509051", "line 3: the time is before"),
            ("can0 12C", "12C", "line 3: expected `(seconds"),
            ("0CE#3C03", "0CF#3C03", "there is no message 206"),
            ("12C#", "12D#", "there is no message 300"),
            ("0C8#", "0C9#", "there is no message 200"),
        ] {
            let error = Recording::read(&signals(), &PERIOD.replace(from, to)).unwrap_err();
            assert!(error.contains(named), "{error}");
            assert!(!error.contains('\n'), "{error}");
        }
    }
}
