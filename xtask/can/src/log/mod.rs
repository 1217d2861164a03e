//! Reads the logs of CAN tools: `candump`, Vector ASC, Kvaser.
//!
//! [`Reader`] recognises the format from the lines, not from the file's name, and hands out one
//! [`Item`] for each line. A line without a classical CAN frame is not refused: the reader names its
//! kind ([`Skip`]), so that a caller can count it. Real logs have a second interface, CAN FD frames,
//! error frames, statistics and a cut last line. Strings are not kept: a frame names its interface
//! by an index into [`Reader::channels`].
//!
//! # Example
//! ```
//! use can_bus::log::{Format, Item, Reader, Skip};
//!
//! let log = b"(1.000000) can0 064#00004ABB82\n(1.000100) can0 20000004#0004000000000000\n";
//! let mut reader = Reader::new();
//! let mut items = Vec::new();
//! reader.read(&mut &log[..], &mut |item| items.push(item)).unwrap();
//! assert_eq!(reader.format(), Some(Format::Candump));
//! assert!(matches!(items[0], Item::Frame(entry) if entry.frame.data()[2] == 0x4A));
//! assert_eq!(items[1], Item::Skipped(Skip::ErrorFrame));
//! ```

mod asc;
mod candump;
mod channels;
mod fields;
mod kvaser;
#[cfg(feature = "mcap")]
pub mod mcap;

use std::io::{self, BufRead};

use crate::Frame;
use asc::Asc;
use channels::Channels;
use kvaser::{Csv, Memorator};

/// Time stamp of a log line, in nanoseconds; its zero depends on the logger: the Unix epoch, the
/// start of the log, or the start of the computer.
pub type LogTime = fugit_host::MonotonicTimerInstantU64<1_000_000_000>;

/// Longest line that is read, in bytes; a CAN FD frame in any of the formats needs less.
pub const LONGEST_LINE: usize = 4096;

/// The format of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// The lines of can-utils' `candump`: `-l` and `-L`, or its screen with time stamps.
    Candump,
    /// Vector's ASC, which CANalyzer, CANoe and python-can write.
    Asc,
    /// The text log of Kvaser's CanKing.
    CanKing,
    /// The log of a Kvaser Memorator as plain text.
    Memorator,
    /// The log of a Kvaser Memorator as CSV.
    KvaserCsv,
}

impl Format {
    /// All formats, in the order in which they are tried. A Memorator's log is only recognised by its
    /// heading, so it comes before ASC, whose lines look like its own.
    pub const ALL: [Self; 5] = [
        Self::Candump,
        Self::KvaserCsv,
        Self::Memorator,
        Self::CanKing,
        Self::Asc,
    ];

    /// The name that users know it by.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Candump => "candump",
            Self::Asc => "Vector ASC",
            Self::CanKing => "Kvaser CanKing text",
            Self::Memorator => "Kvaser Memorator text",
            Self::KvaserCsv => "Kvaser CSV",
        }
    }
}

/// Whether the logger received a frame or sent it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Direction {
    /// Another node sent it.
    Received,
    /// The computer of the logger sent it.
    Sent,
}

/// A frame of a log.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Time stamp of its line. Loggers stamp the end of a frame.
    pub at: LogTime,
    /// Its interface: an index into [`Reader::channels`].
    pub channel: u8,
    /// Its direction, if the line tells it.
    pub direction: Option<Direction>,
    /// The frame.
    pub frame: Frame,
}

/// Why a line gives no frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Skip {
    /// A CAN FD frame.
    FdFrame,
    /// The interface reports an error on the bus.
    ErrorFrame,
    /// Another event of the logger: statistics, a transmit request, a trigger.
    Event,
    /// The line is not UTF-8 text and cannot be read.
    NotText,
    /// The last line has no end: the log was cut off, and so may its last value be.
    Cut,
    /// A frame of one more interface than are told apart.
    Interface,
    /// The line cannot be read.
    Unreadable,
}

impl Skip {
    /// All kinds.
    pub const ALL: [Self; 7] = [
        Self::FdFrame,
        Self::ErrorFrame,
        Self::Event,
        Self::NotText,
        Self::Cut,
        Self::Interface,
        Self::Unreadable,
    ];

    /// Name of the kind, in the plural.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::FdFrame => "CAN FD frames",
            Self::ErrorFrame => "error frames",
            Self::Event => "other events",
            Self::NotText => "lines that are not UTF-8",
            Self::Cut => "cut last lines",
            Self::Interface => "frames of interfaces beyond the 64th",
            Self::Unreadable => "unreadable lines",
        }
    }
}

/// The content of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Item {
    /// A frame of classical CAN.
    Frame(Entry),
    /// Something else that counts.
    Skipped(Skip),
    /// Nothing that counts: a heading, a comment, an empty line.
    Nothing,
}

/// Reads one log.
#[derive(Clone, Debug)]
pub struct Reader {
    format: Option<Format>,
    channels: Channels,
    asc: Asc,
    memorator: Memorator,
    csv: Csv,
    /// Whether the next line is the first one, which may begin with a byte order mark.
    first: bool,
}

impl Default for Reader {
    fn default() -> Self {
        Self::new()
    }
}

/// The byte order mark of UTF-8, which some editors put in front of a text.
const BYTE_ORDER_MARK: &[u8] = b"\xEF\xBB\xBF";

impl Reader {
    /// A reader of a log of any format.
    #[must_use]
    pub fn new() -> Self {
        Self {
            format: None,
            channels: Channels::default(),
            asc: Asc::default(),
            memorator: Memorator::default(),
            csv: Csv::default(),
            first: true,
        }
    }

    /// The format of the log; `None` before its first frame.
    #[must_use]
    pub fn format(&self) -> Option<Format> {
        self.format
    }

    /// Names of the interfaces so far, in the order of their first lines.
    #[must_use]
    pub fn channels(&self) -> &[String] {
        self.channels.names()
    }

    /// Reads a log to its end and hands over one item for each line.
    ///
    /// # Errors
    /// The input cannot be read.
    pub fn read(&mut self, input: &mut dyn BufRead, each: &mut dyn FnMut(Item)) -> io::Result<()> {
        let mut line = Vec::with_capacity(256);
        loop {
            line.clear();
            let ended = read_line(input, &mut line)?;
            if !ended && line.is_empty() {
                return Ok(());
            }
            each(if ended {
                self.line(&line)
            } else {
                self.last_line(&line)
            });
            if !ended {
                return Ok(());
            }
        }
    }

    /// Reads a line; a carriage return and a line feed at its end do not count.
    pub fn line(&mut self, line: &[u8]) -> Item {
        let first = std::mem::replace(&mut self.first, false);
        let line = match line.strip_prefix(BYTE_ORDER_MARK) {
            Some(rest) if first => rest,
            _ => line,
        };
        let line = line.trim_ascii();
        if line.is_empty() {
            return Item::Nothing;
        }
        match self.of_format(line) {
            Item::Skipped(Skip::Unreadable) if std::str::from_utf8(line).is_err() => {
                Item::Skipped(Skip::NotText)
            }
            item => item,
        }
    }

    /// Reads the last line of a log, which has no line feed. A frame in it is not trusted: `A0` may be what is
    /// left of `A01`.
    pub fn last_line(&mut self, line: &[u8]) -> Item {
        match self.line(line) {
            Item::Nothing => Item::Nothing,
            Item::Frame(_) | Item::Skipped(_) => Item::Skipped(Skip::Cut),
        }
    }

    /// The line's item by the log's format. Before its first frame all formats are tried, so that
    /// a heading can say how the lines behind it are to be read.
    fn of_format(&mut self, line: &[u8]) -> Item {
        const UNREADABLE: Item = Item::Skipped(Skip::Unreadable);
        if let Some(format) = self.format {
            return self.read_as(format, line).unwrap_or(UNREADABLE);
        }
        let mut best = UNREADABLE;
        for format in Format::ALL {
            match self.read_as(format, line) {
                Some(item @ (Item::Frame(_) | Item::Skipped(Skip::FdFrame | Skip::ErrorFrame))) => {
                    self.format = Some(format);
                    return item;
                }
                Some(item) if best == UNREADABLE => best = item,
                _ => {}
            }
        }
        best
    }

    /// The line's item in a format; `None` if it has none.
    fn read_as(&mut self, format: Format, line: &[u8]) -> Option<Item> {
        match format {
            Format::Candump => candump::line(line, &mut self.channels),
            Format::Asc => self.asc.line(line, &mut self.channels),
            Format::CanKing => kvaser::canking(line, &mut self.channels),
            Format::Memorator => self.memorator.line(line, &mut self.channels),
            Format::KvaserCsv => self.csv.line(line, &mut self.channels),
        }
    }
}

/// Reads up to the next line feed, which is not kept; false at the end of the input. Of a longer
/// line than [`LONGEST_LINE`] only its beginning is kept.
fn read_line(input: &mut dyn BufRead, line: &mut Vec<u8>) -> io::Result<bool> {
    loop {
        let bytes = match input.fill_buf() {
            Ok(bytes) => bytes,
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error),
        };
        if bytes.is_empty() {
            return Ok(false);
        }
        let end = bytes.iter().position(|byte| *byte == b'\n');
        let part = &bytes[..end.unwrap_or(bytes.len())];
        let room = LONGEST_LINE.saturating_sub(line.len());
        line.extend_from_slice(&part[..part.len().min(room)]);
        let used = part.len() + usize::from(end.is_some());
        input.consume(used);
        if end.is_some() {
            return Ok(true);
        }
    }
}
