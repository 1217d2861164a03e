//! The log format of can-utils' `candump -l`: `(seconds.microseconds) interface id#data`, and
//! ` R` or ` T` behind it when the logger notes whether it received or sent the frame.

use std::fmt;
use std::str::FromStr;

use embedded_can::{ExtendedId, Id, StandardId};

use crate::Frame;
use crate::confinement::ErrorKind;
use crate::time::SimTime;

/// One line of a log.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// Time stamp; written rounded down to whole microseconds.
    pub at: SimTime,
    /// Name of the interface, such as `can0`.
    pub interface: String,
    /// The frame. Data length codes above 8 are written as 8.
    pub frame: Frame,
}

/// A line for an error frame, as an interface of Linux with `berr-reporting` reports it
/// (`linux/can/error.h`).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ErrorLine {
    /// When the error was found; written rounded down to whole microseconds.
    pub at: SimTime,
    /// Name of the interface, such as `can0`.
    pub interface: String,
    /// What was found.
    pub kind: ErrorKind,
    /// Whether the sender of the frame found it.
    pub transmitter: bool,
}

/// The identifier's bits of an error frame: it is one, a protocol was violated, the bus has an error.
const ERROR: u32 = 0x2000_0000 | 0x08 | 0x80;
/// Nobody acknowledged.
const NO_ACKNOWLEDGE: u32 = 0x20;

impl ErrorLine {
    /// Further bits of the identifier, and the bytes 2 and 3 of the data: what was violated, and where.
    const fn code(&self) -> (u32, u8, u8) {
        let (id, what, place) = match self.kind {
            ErrorKind::BitDominant => (0, 0x08, 0),
            ErrorKind::BitRecessive => (0, 0x10, 0),
            ErrorKind::Form => (0, 0x02, 0),
            ErrorKind::Stuff => (0, 0x04, 0),
            ErrorKind::Crc => (0, 0, 0x08),
            ErrorKind::Acknowledge => (NO_ACKNOWLEDGE, 0, 0x19),
        };
        (id, if self.transmitter { what | 0x80 } else { what }, place)
    }
}

impl fmt::Display for ErrorLine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        stamp(f, self.at, &self.interface)?;
        let (id, what, place) = self.code();
        write!(f, "{:08X}#0000{what:02X}{place:02X}00000000", ERROR | id)
    }
}

fn stamp(f: &mut fmt::Formatter<'_>, at: SimTime, interface: &str) -> fmt::Result {
    let us = at.as_ticks() / PS_IN_US;
    write!(f, "({:010}.{:06}) {interface} ", us / US_IN_S, us % US_IN_S)
}

/// Why a line is not a classical CAN frame of a candump log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ParseError {
    /// The line has not exactly three fields separated by spaces, or a fourth one that is neither
    /// `R` nor `T`.
    #[error("expected `(seconds.microseconds) interface id#data`")]
    Fields,
    /// The time stamp is not `(seconds.microseconds)` with six digits behind the point, or it is
    /// beyond 213 days.
    #[error("expected a time stamp `(seconds.microseconds)` with six digits behind the point")]
    Stamp,
    /// The identifier is neither three hexadecimal digits up to 7FF nor eight up to 1FFFFFFF.
    #[error("expected an identifier of three or eight hexadecimal digits")]
    Identifier,
    /// It is a report of the interface about an error: bit 29 of the identifier is set.
    #[error("an error frame of the interface is no frame of the bus")]
    ErrorFrame,
    /// It is a CAN FD frame: `id##flags` and data.
    #[error("a CAN FD frame is not accepted")]
    Fd,
    /// The data are not up to eight bytes of two hexadecimal digits, nor `R` with a length.
    #[error("expected up to eight data bytes in hexadecimal, or R and a length")]
    Data,
}

const PS_IN_US: u64 = 1_000_000;
const US_IN_S: u64 = 1_000_000;

impl fmt::Display for Line {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        stamp(f, self.at, &self.interface)?;
        match self.frame.id() {
            Id::Standard(id) => write!(f, "{:03X}#", id.as_raw())?,
            Id::Extended(id) => write!(f, "{:08X}#", id.as_raw())?,
        }
        if self.frame.is_remote() {
            f.write_str("R")?;
            return match self.frame.dlc().min(8) {
                0 => Ok(()),
                dlc => write!(f, "{dlc}"),
            };
        }
        self.frame
            .data()
            .iter()
            .try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

impl FromStr for Line {
    type Err = ParseError;

    fn from_str(line: &str) -> Result<Self, ParseError> {
        let mut fields = line.split_ascii_whitespace();
        let (Some(stamp), Some(interface), Some(frame), None | Some("R" | "T"), None) = (
            fields.next(),
            fields.next(),
            fields.next(),
            fields.next(),
            fields.next(),
        ) else {
            return Err(ParseError::Fields);
        };
        Ok(Self {
            at: parse_stamp(stamp).ok_or(ParseError::Stamp)?,
            interface: interface.to_owned(),
            frame: parse_frame(frame)?,
        })
    }
}

fn digits<T: FromStr>(text: &str) -> Option<T> {
    text.bytes()
        .all(|byte| byte.is_ascii_digit())
        .then(|| text.parse().ok())?
}

fn parse_stamp(field: &str) -> Option<SimTime> {
    let (seconds, micros) = field
        .strip_prefix('(')?
        .strip_suffix(')')?
        .split_once('.')?;
    if micros.len() != 6 {
        return None;
    }
    digits::<u64>(seconds)?
        .checked_mul(US_IN_S)?
        .checked_add(digits(micros)?)?
        .checked_mul(PS_IN_US)
        .map(SimTime::from_ticks)
}

fn hex(text: &str) -> Option<u32> {
    text.bytes()
        .all(|byte| byte.is_ascii_hexdigit())
        .then(|| u32::from_str_radix(text, 16).ok())?
}

fn parse_frame(field: &str) -> Result<Frame, ParseError> {
    let (id, data) = field.split_once('#').ok_or(ParseError::Fields)?;
    let raw = hex(id).ok_or(ParseError::Identifier)?;
    if id.len() == 8 && raw >> 29 == 1 {
        return Err(ParseError::ErrorFrame);
    }
    let id = match id.len() {
        3 => StandardId::new(raw as u16).map(Id::Standard),
        8 => ExtendedId::new(raw).map(Id::Extended),
        _ => None,
    }
    .ok_or(ParseError::Identifier)?;
    if data.starts_with('#') {
        return Err(ParseError::Fd);
    }
    if let Some(length) = data.strip_prefix('R') {
        let dlc = if length.is_empty() {
            Some(0)
        } else {
            digits::<u8>(length).filter(|dlc| *dlc <= 8)
        };
        return dlc
            .and_then(|dlc| Frame::new_remote(id, dlc))
            .ok_or(ParseError::Data);
    }
    if data.len() % 2 != 0 || !data.is_ascii() {
        return Err(ParseError::Data);
    }
    let bytes = (0..data.len() / 2)
        .map(|index| hex(&data[2 * index..2 * index + 2]).map(|byte| byte as u8))
        .collect::<Option<Vec<u8>>>()
        .ok_or(ParseError::Data)?;
    Frame::new_data(id, &bytes).ok_or(ParseError::Data)
}
