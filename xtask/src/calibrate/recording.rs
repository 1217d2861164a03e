//! A calibration drive as the bus carried it.

use can_bus::candump::Line;
use embedded_can::Id;
use network::{DecodeError, Message};
use uagv::messages::{Command, Position, SteeringPot};

/// What a recording holds for a calibration. Times are seconds from its first line.
#[derive(Debug, Default)]
pub(super) struct Recording {
    /// Potentiometer readings, counts.
    pub pots: Vec<(f64, u16)>,
    /// Commands to the actuators.
    pub commands: Vec<(f64, Command)>,
    /// Positions of the antenna with an RTK-fixed solution, m north and east.
    pub positions: Vec<(f64, f64, f64)>,
}

impl Recording {
    /// Reads a candump log; frames that are not of the network are passed over.
    ///
    /// # Errors
    ///
    /// A sentence that names the line that cannot be read, or the message that is missing.
    pub(super) fn read(text: &str) -> Result<Self, String> {
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
            let line: Line = line.parse().map_err(|error| wrong(&format!("{error}")))?;
            let Id::Standard(id) = line.frame.id() else {
                continue;
            };
            let time = line.at.as_ticks() as f64 * 1e-12;
            let data = line.frame.data();
            let wrong = |error: DecodeError| wrong(&format!("message {}: {error}", id.as_raw()));
            match id.as_raw() {
                SteeringPot::ID => {
                    let SteeringPot { count } = SteeringPot::decode(data).map_err(wrong)?;
                    recording.pots.push((time, count.0));
                }
                Command::ID => {
                    let command = Command::decode(data).map_err(wrong)?;
                    recording.commands.push((time, command));
                }
                Position::ID => {
                    let Position { north, east } = Position::decode(data).map_err(wrong)?;
                    let metres = |millimetres: i32| f64::from(millimetres) * 1e-3;
                    let (north, east) = (metres(north.0), metres(east.0));
                    recording.positions.push((time, north, east));
                }
                _ => {}
            }
        }
        for (empty, what) in [
            (recording.pots.is_empty(), "206 (steering potentiometer)"),
            (recording.commands.is_empty(), "300 (command)"),
            (recording.positions.is_empty(), "200 (position, RTK-fixed)"),
        ] {
            if empty {
                return Err(format!(
                    "there is no message {what}, which a calibration needs beside \
                     the others of 200, 206 and 300"
                ));
            }
        }
        Ok(recording)
    }
}

/// The line with its whole seconds counted from those of the first line: loggers write the
/// time of day, decades in seconds. False when they are fewer.
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

    /// One period of the thesis's vehicle, with the time of day.
    const PERIOD: &str = "\
        (1436509052.249713) can0 0C8#EAFFFFFF36000000\n\
        (1436509052.252470) can0 0CE#3C03\n\
        (1436509053.253470) can0 12C#0000060000000000\n";

    #[test]
    fn times_count_from_the_first_line() {
        let recording = Recording::read(PERIOD).unwrap();
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
            let error = Recording::read(&PERIOD.replace(from, to)).unwrap_err();
            assert!(error.contains(named), "{error}");
            assert!(!error.contains('\n'), "{error}");
        }
    }
}
