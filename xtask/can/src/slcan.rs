//! The protocol of CAN adapters on a serial port, by the name `slcan`: lines of ASCII that end
//! with a carriage return (Lawicel, CAN232 manual, version 3, "Available CAN232 ASCII commands").
//!
//! | line | meaning |
//! | --- | --- |
//! | `Sn` | bit rate, number `n` of a table: [`bit_rate`] |
//! | `O`, `C` | open and close the channel: [`OPEN`], [`CLOSE`] |
//! | `tiiildd..` | data frame: identifier of three hexadecimal digits, length, data |
//! | `Tiiiiiiiildd..` | the same with a 29-bit identifier of eight digits |
//! | `riiil`, `Riiiiiiiil` | remote frames |
//!
//! The adapter answers a command with a carriage return, with `z` or `Z` before it when a frame
//! has been taken, or refuses it with the byte BEL. A frame that it has received may have a time
//! stamp of four hexadecimal digits behind its data, in milliseconds modulo 60 000.

use std::fmt::Write;

use embedded_can::{ExtendedId, Id, StandardId};

use crate::Frame;

/// Opens the channel.
pub const OPEN: &str = "O\r";

/// Closes the channel.
pub const CLOSE: &str = "C\r";

/// Ends a line; alone it says that a command is done.
const END: u8 = b'\r';

/// Says that a command is refused.
const BEL: u8 = 7;

/// Characters of the longest frame: letter, eight digits of identifier, length, eight bytes, time
/// stamp. A longer line is none of the protocol.
const LONGEST: usize = 1 + 8 + 1 + 16 + 4;

/// The bit rates of the command `S`, bit/s. Their order gives their numbers.
pub const BIT_RATES: [u32; 9] = [
    10_000, 20_000, 50_000, 100_000, 125_000, 250_000, 500_000, 800_000, 1_000_000,
];

/// The command that sets a bit rate; `None` if there is none for it.
#[must_use]
pub fn bit_rate(bits_per_second: u32) -> Option<String> {
    let number = BIT_RATES.iter().position(|rate| *rate == bits_per_second)?;
    Some(format!("S{number}\r"))
}

/// The command that sends a frame. Data length codes above 8 are written as 8.
#[must_use]
pub fn encode(frame: &Frame) -> String {
    let mut line = String::with_capacity(LONGEST + 1);
    let letter = |extended, remote| match (extended, remote) {
        (false, false) => 't',
        (false, true) => 'r',
        (true, false) => 'T',
        (true, true) => 'R',
    };
    // Writing to a string cannot fail.
    let _ = match frame.id() {
        Id::Standard(id) => write!(
            line,
            "{}{:03X}",
            letter(false, frame.is_remote()),
            id.as_raw()
        ),
        Id::Extended(id) => write!(
            line,
            "{}{:08X}",
            letter(true, frame.is_remote()),
            id.as_raw()
        ),
    };
    let _ = write!(line, "{}", frame.dlc().min(8));
    for byte in frame.data() {
        let _ = write!(line, "{byte:02X}");
    }
    line.push('\r');
    line
}

/// What an adapter says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    /// It has received a frame.
    Frame {
        /// The frame.
        frame: Frame,
        /// Its time stamp in milliseconds, if time stamps are on.
        stamp: Option<u16>,
    },
    /// A command is done.
    Done,
    /// A frame to send has been taken.
    Taken,
    /// A command is refused.
    Refused,
    /// Another line, such as the adapter's version.
    Other(Vec<u8>),
    /// A line that is longer than any of the protocol.
    TooLong,
}

/// Reads what an adapter says, byte by byte. Any bytes are accepted.
#[derive(Clone, Debug, Default)]
pub struct Decoder {
    line: Vec<u8>,
    /// Whether the line is longer than any of the protocol; it is then skipped to its end.
    overlong: bool,
}

impl Decoder {
    /// A decoder at the beginning of a line.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes one byte. It returns an answer when the byte ends one.
    pub fn push(&mut self, byte: u8) -> Option<Answer> {
        match byte {
            BEL => {
                self.line.clear();
                self.overlong = false;
                Some(Answer::Refused)
            }
            END => {
                let line = std::mem::take(&mut self.line);
                if std::mem::take(&mut self.overlong) {
                    return Some(Answer::TooLong);
                }
                Some(answer(line))
            }
            // Some adapters end a line with a line feed too.
            b'\n' => None,
            _ if self.line.len() == LONGEST => {
                self.overlong = true;
                None
            }
            byte => {
                self.line.push(byte);
                None
            }
        }
    }
}

/// The adapter's side: what answers a program that takes it for an adapter.
#[derive(Clone, Debug, Default)]
pub struct Adapter {
    decoder: Decoder,
    open: bool,
    /// Whether frames have time stamps.
    stamps: bool,
}

/// What an adapter does about a byte.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Reaction {
    /// Answers the program.
    pub answer: &'static str,
    /// Sends a frame to the bus.
    pub frame: Option<Frame>,
}

impl Adapter {
    /// An adapter whose channel is closed.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a byte of the program. The bit rate that it sets is acknowledged and means nothing.
    pub fn take(&mut self, byte: u8) -> Reaction {
        let answer = |answer| Reaction {
            answer,
            frame: None,
        };
        match self.decoder.push(byte) {
            None | Some(Answer::TooLong) => answer(""),
            Some(Answer::Frame { frame, stamp: None }) if self.open => Reaction {
                answer: match frame.id() {
                    Id::Standard(_) => "z\r",
                    Id::Extended(_) => "Z\r",
                },
                frame: Some(frame),
            },
            Some(Answer::Done) => answer("\r"),
            Some(Answer::Other(line)) => answer(self.command(&line)),
            Some(Answer::Frame { .. } | Answer::Taken | Answer::Refused) => answer("\x07"),
        }
    }

    fn command(&mut self, line: &[u8]) -> &'static str {
        match line {
            [b'S', b'0'..=b'8'] | [b's', ..] if !self.open => "\r",
            b"O" | b"L" if !self.open => {
                self.open = true;
                "\r"
            }
            b"C" if self.open => {
                self.open = false;
                "\r"
            }
            b"Z0" | b"Z1" => {
                self.stamps = line == b"Z1";
                "\r"
            }
            [b'M' | b'm', ..] => "\r",
            b"F" => "F00\r",
            b"V" => "V1013\r",
            b"N" => "NF001\r",
            _ => "\x07",
        }
    }

    /// What the program gets of a frame on the bus that ended at this millisecond; `None` while the
    /// channel is closed.
    #[must_use]
    pub fn received(&self, frame: &Frame, millis: u64) -> Option<String> {
        let mut line = self.open.then(|| encode(frame))?;
        if self.stamps {
            line.pop();
            // Writing to a string cannot fail.
            let _ = write!(line, "{:04X}\r", millis % 60_000);
        }
        Some(line)
    }
}

/// The meaning of a line without its end.
fn answer(line: Vec<u8>) -> Answer {
    match line.as_slice() {
        [] => Answer::Done,
        b"z" | b"Z" => Answer::Taken,
        text => match frame(text) {
            Some((frame, stamp)) => Answer::Frame { frame, stamp },
            None => Answer::Other(line),
        },
    }
}

/// The frame of a line, and its time stamp.
fn frame(line: &[u8]) -> Option<(Frame, Option<u16>)> {
    let (letter, rest) = line.split_first()?;
    let (extended, remote) = match letter {
        b't' => (false, false),
        b'r' => (false, true),
        b'T' => (true, false),
        b'R' => (true, true),
        _ => return None,
    };
    let (id, rest) = rest.split_at_checked(if extended { 8 } else { 3 })?;
    let raw = hex(id)?;
    let id = if extended {
        ExtendedId::new(raw).map(Id::Extended)
    } else {
        StandardId::new(u16::try_from(raw).ok()?).map(Id::Standard)
    }?;
    let (length, rest) = rest.split_first()?;
    let length = length.is_ascii_digit().then(|| length - b'0')?;
    if length > 8 {
        return None;
    }
    let digits = if remote { 0 } else { 2 * usize::from(length) };
    let (data, stamp) = rest.split_at_checked(digits)?;
    let stamp = match stamp.len() {
        0 => None,
        4 => Some(u16::try_from(hex(stamp)?).ok()?),
        _ => return None,
    };
    let mut bytes = Vec::with_capacity(8);
    for pair in data.chunks_exact(2) {
        bytes.push(u8::try_from(hex(pair)?).ok()?);
    }
    Some((Frame::from_parts(id, remote, length, &bytes)?, stamp))
}

/// A number of up to eight hexadecimal digits.
fn hex(digits: &[u8]) -> Option<u32> {
    digits.iter().try_fold(0, |number: u32, digit| {
        let digit = char::from(*digit).to_digit(16)?;
        number.checked_mul(16)?.checked_add(digit)
    })
}
