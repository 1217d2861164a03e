//! Vector's ASC: `time channel id direction d length bytes`, with events of all kinds between.

use super::channels::Channels;
use super::fields::{Base, bytes, extended, number, seconds, standard, words};
use super::{Direction, Entry, Item, LogTime, Skip};
use crate::Frame;
use embedded_can::Id;

/// Base and kind of time stamps from the heading, and the time of the last line.
#[derive(Clone, Debug)]
pub(super) struct Asc {
    base: Base,
    /// Whether each time counts from the line before.
    relative: bool,
    now: u64,
}

impl Default for Asc {
    /// Without a heading, as most tools write it.
    fn default() -> Self {
        Self {
            base: Base::Hex,
            relative: false,
            now: 0,
        }
    }
}

/// Beginnings of the lines of the heading and of blocks, in small letters.
const HEADINGS: [&[u8]; 6] = [b"date", b"base", b"internal", b"no", b"begin", b"end"];

/// Bit of a CAN FD line's flags that tells a CAN FD frame from a classical one (EDL).
const EDL: u64 = 1 << 12;

impl Asc {
    /// Reads a line; `None` if it is none of this format.
    pub(super) fn line(&mut self, line: &[u8], channels: &mut Channels) -> Option<Item> {
        let mut words = words(line);
        let first = words.next()?;
        if first.starts_with(b"//") || HEADINGS.iter().any(|one| first.eq_ignore_ascii_case(one)) {
            self.heading(line);
            return Some(Item::Nothing);
        }
        // Every time has a point, unlike the numbers at the beginning of other formats' lines.
        first.contains(&b'.').then_some(())?;
        let at = seconds(first)?;
        self.now = match self.relative {
            true => self.now.checked_add(at.as_ticks())?,
            false => at.as_ticks(),
        };
        let second = words.next()?;
        if second == b"CANFD" {
            return Some(self.fd(&mut words, channels).unwrap_or(UNREADABLE));
        }
        if number(second, Base::Decimal).is_none() {
            return Some(Item::Skipped(Skip::Event));
        }
        let third = words.next()?;
        if third.eq_ignore_ascii_case(b"ErrorFrame") {
            return Some(Item::Skipped(Skip::ErrorFrame));
        }
        if third.ends_with(b":") {
            return Some(Item::Skipped(Skip::Event));
        }
        let (direction, kind) = (words.next()?, words.next()?);
        let direction = match direction {
            b"Rx" => Direction::Received,
            b"Tx" => Direction::Sent,
            // A transmit request is logged before the frame is on the bus.
            b"TxRq" => return Some(Item::Skipped(Skip::Event)),
            _ => return Some(UNREADABLE),
        };
        let frame = match kind {
            b"d" => self.data(third, &mut words),
            b"r" => self.remote(third, words.next()),
            _ => None,
        };
        Some(self.item(second, direction, frame, channels))
    }

    /// `base hex timestamps absolute`, or with `dec` and `relative`.
    fn heading(&mut self, line: &[u8]) {
        let mut words = words(line);
        if !words
            .next()
            .is_some_and(|word| word.eq_ignore_ascii_case(b"base"))
        {
            return;
        }
        for word in words {
            match word.to_ascii_lowercase().as_slice() {
                b"hex" => self.base = Base::Hex,
                b"dec" => self.base = Base::Decimal,
                b"absolute" => self.relative = false,
                b"relative" => self.relative = true,
                _ => {}
            }
        }
    }

    fn item(
        &self,
        channel: &[u8],
        direction: Direction,
        frame: Option<Frame>,
        channels: &mut Channels,
    ) -> Item {
        // A line that cannot be read names no interface.
        let entry = frame.and_then(|frame| Some((frame, channels.index(channel)?)));
        entry.map_or(UNREADABLE, |(frame, channel)| {
            Item::Frame(Entry {
                at: LogTime::from_ticks(self.now),
                channel,
                direction: Some(direction),
                frame,
            })
        })
    }

    /// An identifier; one of 29 bits ends with `x`.
    fn identifier(&self, digits: &[u8]) -> Option<Id> {
        match digits.strip_suffix(b"x").or(digits.strip_suffix(b"X")) {
            Some(digits) => extended(number(digits, self.base)?),
            None => standard(number(digits, self.base)?),
        }
    }

    /// Length and bytes of a data frame. Behind them may stand its duration and other things.
    fn data<'w>(&self, id: &[u8], words: &mut impl Iterator<Item = &'w [u8]>) -> Option<Frame> {
        let code = u8::try_from(number(words.next()?, self.base)?).ok()?;
        let count = usize::from(code.min(8));
        let data = bytes(words, count, self.base)?;
        Frame::from_parts(self.identifier(id)?, false, code, &data[..count])
    }

    /// A remote frame, in older versions without a length.
    fn remote(&self, id: &[u8], length: Option<&[u8]>) -> Option<Frame> {
        let code = length.and_then(|length| number(length, self.base));
        Frame::new_remote(self.identifier(id)?, u8::try_from(code.unwrap_or(0)).ok()?)
    }

    /// Behind `CANFD`: channel, direction, identifier, perhaps a name, the flags BRS and ESI,
    /// code, length, bytes, duration, number of bits, flags. Controllers for CAN FD log
    /// classical frames so, too.
    fn fd<'w>(
        &self,
        words: &mut impl Iterator<Item = &'w [u8]>,
        channels: &mut Channels,
    ) -> Option<Item> {
        let (channel, direction) = (words.next()?, words.next()?);
        let direction = match direction {
            b"Rx" => Direction::Received,
            b"Tx" => Direction::Sent,
            b"TxRq" => return Some(Item::Skipped(Skip::Event)),
            _ => return None,
        };
        let id = words.next()?;
        if id.eq_ignore_ascii_case(b"ErrorFrame") {
            return Some(Item::Skipped(Skip::ErrorFrame));
        }
        let is_flag = |word: &[u8]| matches!(word, b"0" | b"1");
        if !is_flag(words.next()?) && !is_flag(words.next()?) {
            return None;
        }
        let _error_passive = words.next()?;
        let code = u8::try_from(number(words.next()?, Base::Hex)?).ok()?;
        let count = number(words.next()?, Base::Decimal)? as usize;
        if count > 8 {
            return Some(Item::Skipped(Skip::FdFrame));
        }
        let data = bytes(words, count, self.base)?;
        // Behind the bytes: duration and number of bits.
        let flags = number(words.nth(2)?, Base::Hex)?;
        if flags & EDL != 0 {
            return Some(Item::Skipped(Skip::FdFrame));
        }
        let id = self.identifier(id)?;
        let frame = match count {
            0 => Frame::new_remote(id, code).filter(|_| code > 0),
            _ => None,
        };
        let frame = frame.or_else(|| Frame::from_parts(id, false, code, &data[..count]));
        Some(self.item(channel, direction, frame, channels))
    }
}

const UNREADABLE: Item = Item::Skipped(Skip::Unreadable);
