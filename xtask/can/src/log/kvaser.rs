//! Kvaser's formats: the text log of CanKing, and the log of a Memorator converted to plain text or
//! CSV (`KvaLogWriter_PlainAsc` and `KvaLogWriter_CsvFrame` of its canlib).

use super::channels::Channels;
use super::fields::{Base, byte, bytes, extended, number, seconds, standard, words};
use super::{Direction, Entry, Item, Skip};
use crate::Frame;
use embedded_can::Id;

/// Reads a line of CanKing: `channel identifier flags length bytes time direction`; `None` if it is
/// none.
///
/// Identifiers of eight digits are hexadecimal, with bytes of two digits; others are decimal, with
/// decimal bytes.
pub(super) fn canking(line: &[u8], channels: &mut Channels) -> Option<Item> {
    if line.starts_with(b"Chn Identifier") || line.starts_with(b"Logging ") {
        return Some(Item::Nothing);
    }
    let mut words = words(line).peekable();
    let (channel, id) = (words.next()?, words.next()?);
    number(channel, Base::Decimal)?;
    let base = if id.len() == 8 {
        Base::Hex
    } else {
        Base::Decimal
    };
    let raw = number(id, base)?;
    if *words.peek()? == b"ErrorFrame" {
        return Some(Item::Skipped(Skip::ErrorFrame));
    }
    let mut flags: &[u8] = b"";
    if words.peek()?.iter().all(u8::is_ascii_alphabetic) {
        flags = words.next()?;
    }
    let has = |letter| flags.contains(&letter);
    let code = u8::try_from(number(words.next()?, Base::Decimal)?).ok()?;
    if has(b'F') {
        return Some(Item::Skipped(Skip::FdFrame));
    }
    let id = if has(b'X') {
        extended(raw)?
    } else {
        standard(raw)?
    };
    let (frame, time) = if has(b'R') {
        (Frame::new_remote(id, code)?, words.next()?)
    } else {
        let count = usize::from(code.min(8));
        let data = bytes(&mut words, count, base)?;
        let frame = Frame::from_parts(id, false, code, &data[..count])?;
        (frame, words.next()?)
    };
    // Every time has a point.
    time.contains(&b'.').then_some(())?;
    let direction = match words.next()? {
        b"R" => Direction::Received,
        b"T" => Direction::Sent,
        _ => return None,
    };
    Some(Item::Frame(Entry {
        at: seconds(time)?,
        channel: channels.index(channel)?,
        direction: Some(direction),
        frame,
    }))
}

/// Bases of the numbers of a converted log, from its heading.
#[derive(Clone, Copy, Debug)]
struct Numbers {
    id: Base,
    data: Base,
}

impl Default for Numbers {
    /// The bases if the heading does not state them.
    fn default() -> Self {
        Self {
            id: Base::Decimal,
            data: Base::Hex,
        }
    }
}

impl Numbers {
    /// `Format of id field` or `Format of data field`, and the base behind it.
    fn heading(&mut self, line: &[u8]) {
        let base = match line {
            line if line.ends_with(b"HEX") => Base::Hex,
            line if line.ends_with(b"DEC") => Base::Decimal,
            _ => return,
        };
        if line.starts_with(b"Format of data field") {
            self.data = base;
        } else if line.starts_with(b"Format of id field") {
            self.id = base;
        }
    }
}

/// The plain text of a Memorator's log.
#[derive(Clone, Debug, Default)]
pub(super) struct Memorator {
    /// Whether the heading has come. Without it, nobody knows how the numbers are meant.
    begun: bool,
    /// Whether the heading is over: a line with a time has come.
    over: bool,
    numbers: Numbers,
}

impl Memorator {
    /// Reads a line: `time channel identifier direction flags length bytes counter`; `None` if it is
    /// none of this format.
    pub(super) fn line(&mut self, line: &[u8], channels: &mut Channels) -> Option<Item> {
        if line.starts_with(b"Kvaser Memorator Log") {
            self.begun = true;
        }
        if !self.begun {
            return None;
        }
        // The heading begins with letters, its line below the columns with equals signs.
        if !line.first().is_some_and(u8::is_ascii_digit) {
            self.numbers.heading(line);
            let letter = line.first().is_some_and(u8::is_ascii_alphabetic);
            let heading = !self.over && (letter || line.starts_with(b"="));
            return (heading || line.starts_with(b"DateTime:")).then_some(Item::Nothing);
        }
        self.over = true;
        let mut words = words(line).peekable();
        let (time, channel, id) = (words.next()?, words.next()?, words.next()?);
        let at = seconds(time)?;
        match id {
            b"ErrorFrame" => return Some(Item::Skipped(Skip::ErrorFrame)),
            _ if channel == b"Trigger" => return Some(Item::Skipped(Skip::Event)),
            _ => {}
        }
        let id = match id.strip_suffix(b"x") {
            Some(digits) => extended(number(digits, self.numbers.id)?)?,
            None => standard(number(id, self.numbers.id)?)?,
        };
        let direction = match words.next()? {
            b"Rx" => Direction::Received,
            b"Tx" => Direction::Sent,
            b"TxRq" => return Some(Item::Skipped(Skip::Event)),
            _ => return None,
        };
        let mut remote = false;
        while words.peek()?.iter().all(|byte| b"EFBPRW#".contains(byte)) {
            let flags = words.next()?;
            if flags.contains(&b'F') {
                return Some(Item::Skipped(Skip::FdFrame));
            }
            remote |= flags.contains(&b'R');
        }
        let code = u8::try_from(number(words.next()?, Base::Decimal)?).ok()?;
        let frame = if remote {
            Frame::new_remote(id, code)?
        } else {
            let count = usize::from(code.min(8));
            let data = bytes(&mut words, count, self.numbers.data)?;
            Frame::from_parts(id, false, code, &data[..count])?
        };
        Some(Item::Frame(Entry {
            at,
            channel: channels.index(channel)?,
            direction: Some(direction),
            frame,
        }))
    }
}

/// The CSV of a Memorator's log.
#[derive(Clone, Debug, Default)]
pub(super) struct Csv {
    /// The separator, once the row with the names of the columns has come.
    separator: Option<u8>,
    numbers: Numbers,
}

/// Flags of canlib (`canstat.h`).
mod flag {
    pub(super) const REMOTE: u64 = 0x01;
    pub(super) const EXTENDED: u64 = 0x04;
    pub(super) const ERROR: u64 = 0x20;
    pub(super) const SENT: u64 = 0x40;
    pub(super) const REQUEST: u64 = 0x80;
    pub(super) const FD: u64 = 0x01_0000;
}

impl Csv {
    /// Reads a row: time, channel, identifier, flags, length, bytes, counter; `None` if it is none of
    /// this format.
    pub(super) fn line(&mut self, line: &[u8], channels: &mut Channels) -> Option<Item> {
        let Some(separator) = self.separator else {
            return self.heading(line);
        };
        let mut fields = line.split(|byte| *byte == separator);
        let at = time(fields.next()?)?;
        let (channel, id) = (fields.next()?, fields.next()?);
        let flags = number(fields.next()?, Base::Decimal)?;
        let has = |flag| flags & flag != 0;
        if has(flag::ERROR) {
            return Some(Item::Skipped(Skip::ErrorFrame));
        }
        if has(flag::FD) {
            return Some(Item::Skipped(Skip::FdFrame));
        }
        if has(flag::REQUEST) && !has(flag::SENT) {
            return Some(Item::Skipped(Skip::Event));
        }
        let frame = self.frame(id, has(flag::EXTENDED), has(flag::REMOTE), &mut fields)?;
        Some(Item::Frame(Entry {
            at,
            channel: channels.index(channel)?,
            direction: Some(match has(flag::SENT) {
                true => Direction::Sent,
                false => Direction::Received,
            }),
            frame,
        }))
    }

    fn frame<'f>(
        &self,
        id: &[u8],
        is_extended: bool,
        is_remote: bool,
        fields: &mut impl Iterator<Item = &'f [u8]>,
    ) -> Option<Frame> {
        let raw = number(id, self.numbers.id)?;
        let id: Id = if is_extended {
            extended(raw)?
        } else {
            standard(raw)?
        };
        let code = u8::try_from(number(fields.next()?, Base::Decimal)?).ok()?;
        if is_remote {
            return Frame::new_remote(id, code);
        }
        let count = usize::from(code.min(8));
        let mut data = [0; 8];
        for place in data.get_mut(..count)? {
            *place = byte(fields.next()?, self.numbers.data)?;
        }
        Frame::from_parts(id, false, code, &data[..count])
    }

    /// The lines up to the names of the columns.
    fn heading(&mut self, line: &[u8]) -> Option<Item> {
        const BEGINNINGS: [&[u8]; 5] = [
            b"CSV CAN data",
            b"Converted from Kvaser",
            b"Format of ",
            b"Timestamp Offset",
            b"Logging started",
        ];
        if BEGINNINGS.iter().any(|one| line.starts_with(one)) {
            self.numbers.heading(line);
            return Some(Item::Nothing);
        }
        if let Some(rest) = line.strip_prefix(b"Time") {
            let separator = *rest.first()?;
            let mut names = rest.get(1..)?.split(|byte| *byte == separator);
            // Instead of an identifier, a converted log may have its PGN, which is a part of it.
            let known = names.next() == Some(b"Channel")
                && names
                    .next()
                    .is_some_and(|name| name.eq_ignore_ascii_case(b"id"));
            if !known || !matches!(separator, b',' | b';' | b'\t') {
                return None;
            }
            self.separator = Some(separator);
            return Some(Item::Nothing);
        }
        None
    }
}

/// A time in seconds, with a point or a decimal comma.
fn time(text: &[u8]) -> Option<super::LogTime> {
    match text.iter().position(|byte| *byte == b',') {
        None => seconds(text),
        Some(comma) => {
            let mut text = text.to_vec();
            *text.get_mut(comma)? = b'.';
            seconds(&text)
        }
    }
}
