//! The lines of can-utils' `candump`: of its logs (`-l`, `-L`) and of its screen with time stamps
//! (`-t a`, `-t z`, `-t A`), as its source `lib.c` writes them.

use super::channels::Channels;
use super::fields::{Base, byte, bytes, date, extended, number, seconds, standard, words};
use super::{Direction, Entry, Item, LogTime, Skip};
use crate::Frame;
use embedded_can::Id;

/// Reads a line; `None` if it is none of this format.
pub(super) fn line(line: &[u8], channels: &mut Channels) -> Option<Item> {
    let mut words = words(line);
    let stamp = words.next()?.strip_prefix(b"(")?;
    let at = match stamp.strip_suffix(b")") {
        Some(stamp) => seconds(stamp)?,
        None => date(stamp, words.next()?.strip_suffix(b")")?)?,
    };
    let channel = words.next()?;
    let third = words.next()?;
    let log = third.iter().position(|byte| *byte == b'#');
    let (content, direction) = match log {
        Some(hash) => {
            let direction = match words.next() {
                None => None,
                Some(b"R") => Some(Direction::Received),
                Some(b"T") => Some(Direction::Sent),
                Some(_) => return None,
            };
            (of_log(&third[..hash], &third[hash + 1..])?, direction)
        }
        None => of_screen(third, &mut words)?,
    };
    item(at, channel, direction, content, channels)
}

/// Content of a line.
enum Content {
    Frame(Frame),
    Skipped(Skip),
}

fn item(
    at: LogTime,
    channel: &[u8],
    direction: Option<Direction>,
    content: Content,
    channels: &mut Channels,
) -> Option<Item> {
    match content {
        Content::Skipped(skip) => Some(Item::Skipped(skip)),
        Content::Frame(frame) => Some(Item::Frame(Entry {
            at,
            channel: channels.index(channel)?,
            direction,
            frame,
        })),
    }
}

/// Bit of the identifier that marks an error frame of the interface (`CAN_ERR_FLAG` of Linux).
const ERROR_FLAG: u64 = 1 << 29;

/// An identifier of three or eight digits; `Err` for an error frame.
fn identifier(digits: &[u8]) -> Option<Result<Id, Skip>> {
    let raw = number(digits, Base::Hex)?;
    match digits.len() {
        3 => standard(raw).map(Ok),
        8 if raw & ERROR_FLAG != 0 => Some(Err(Skip::ErrorFrame)),
        8 => extended(raw).map(Ok),
        _ => None,
    }
}

/// `id#data`, `id#R` with a length, or `id##flags` and data.
fn of_log(id: &[u8], data: &[u8]) -> Option<Content> {
    let id = match identifier(id)? {
        Ok(id) => id,
        Err(skip) => return Some(Content::Skipped(skip)),
    };
    if let Some(rest) = data.strip_prefix(b"#") {
        let whole = !rest.is_empty() && rest.len() % 2 == 1;
        let hex = rest.iter().all(u8::is_ascii_hexdigit);
        return (whole && hex).then_some(Content::Skipped(Skip::FdFrame));
    }
    // Behind eight bytes and `_` stands a data length code above 8.
    let (data, code) = match data.iter().position(|byte| *byte == b'_') {
        Some(at) => (
            &data[..at],
            Some(number(&data[at + 1..], Base::Hex).filter(|code| (9..=15).contains(code))?),
        ),
        None => (data, None),
    };
    if let Some(length) = data.strip_prefix(b"R") {
        let length = match length {
            [] => 0,
            digits => number(digits, Base::Decimal).filter(|length| *length <= 8)?,
        };
        let code = above_eight(code, length)?;
        return Frame::new_remote(id, code).map(Content::Frame);
    }
    if data.len() % 2 != 0 || data.len() > 16 {
        return None;
    }
    let mut read = [0; 8];
    for (place, digits) in read.iter_mut().zip(data.chunks(2)) {
        *place = byte(digits, Base::Hex)?;
    }
    let count = data.len() / 2;
    let code = above_eight(code, count as u64)?;
    Frame::from_parts(id, false, code, &read[..count]).map(Content::Frame)
}

/// The data length code: the length, or behind a length of eight the code above 8.
fn above_eight(code: Option<u64>, length: u64) -> Option<u8> {
    match code {
        Some(_) if length != 8 => None,
        code => u8::try_from(code.unwrap_or(length)).ok(),
    }
}

/// `id [length] bytes`, with the direction and two flags in front of it after `candump -x`.
fn of_screen<'w>(
    third: &'w [u8],
    words: &mut impl Iterator<Item = &'w [u8]>,
) -> Option<(Content, Option<Direction>)> {
    let direction = match third {
        b"RX" => Some(Direction::Received),
        b"TX" => Some(Direction::Sent),
        _ => None,
    };
    let id = if direction.is_some() {
        words.nth(2)?
    } else {
        third
    };
    let id = match identifier(id)? {
        Ok(id) => id,
        Err(skip) => return Some((Content::Skipped(skip), direction)),
    };
    let length = words.next()?.strip_prefix(b"[")?.strip_suffix(b"]")?;
    let count = number(length, Base::Decimal)? as usize;
    // The length of a CAN FD frame has two digits.
    if length.len() == 2 {
        return (count <= 64).then_some((Content::Skipped(Skip::FdFrame), direction));
    }
    if count > 8 {
        return None;
    }
    let mut words = words.peekable();
    if words.peek() == Some(&&b"remote"[..]) {
        let frame = Frame::new_remote(id, count as u8)?;
        return Some((Content::Frame(frame), direction));
    }
    let data = bytes(&mut words, count, Base::Hex)?;
    let frame = Frame::new_data(id, &data[..count])?;
    Some((Content::Frame(frame), direction))
}
