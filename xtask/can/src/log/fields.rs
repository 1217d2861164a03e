//! The fields of a line: words, numbers, identifiers, data.

use embedded_can::{ExtendedId, Id, StandardId};

use super::LogTime;

/// The words of a line, separated by blanks.
pub(super) fn words(line: &[u8]) -> impl Iterator<Item = &[u8]> + Clone {
    line.split(u8::is_ascii_whitespace)
        .filter(|word| !word.is_empty())
}

/// A number in one of the bases of a log; `None` if it has other characters, or exceeds 64 bits.
pub(super) fn number(digits: &[u8], base: Base) -> Option<u64> {
    if digits.is_empty() {
        return None;
    }
    digits.iter().try_fold(0_u64, |number, digit| {
        let value = match digit {
            b'0'..=b'9' => digit - b'0',
            b'a'..=b'f' if base == Base::Hex => digit - b'a' + 10,
            b'A'..=b'F' if base == Base::Hex => digit - b'A' + 10,
            _ => return None,
        };
        let base = match base {
            Base::Hex => 16,
            Base::Decimal => 10,
        };
        number.checked_mul(base)?.checked_add(u64::from(value))
    })
}

/// The base of numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Base {
    /// 16.
    Hex,
    /// 10.
    Decimal,
}

const NS_IN_S: u64 = 1_000_000_000;
/// Digits behind the point that are read.
const FRACTION: usize = 9;

/// A time in seconds, with or without a point; digits beyond the nanosecond are cut off.
pub(super) fn seconds(text: &[u8]) -> Option<LogTime> {
    let point = text.iter().position(|byte| *byte == b'.');
    let (whole, fraction) = match point {
        Some(point) => (&text[..point], &text[point + 1..]),
        None => (text, &b"0"[..]),
    };
    let whole = number(whole, Base::Decimal)?;
    if fraction.is_empty() || !fraction.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let digits = &fraction[..fraction.len().min(FRACTION)];
    let scale = 10_u64.pow((FRACTION - digits.len()) as u32);
    let fraction = number(digits, Base::Decimal)? * scale;
    let ns = whole.checked_mul(NS_IN_S)?.checked_add(fraction)?;
    Some(LogTime::from_ticks(ns))
}

/// Seconds of a day.
const DAY: u64 = 86_400;

/// A date as `2015-07-10` and a time of day as `06:17:32.249713`, counted from 1970 as if without a
/// time zone; `None` before 1970.
pub(super) fn date(date: &[u8], time: &[u8]) -> Option<LogTime> {
    let mut parts = date.split(|byte| *byte == b'-');
    let mut next = || number(parts.next()?, Base::Decimal);
    let (year, month, day) = (next()?, next()?, next()?);
    let valid =
        (1970..=9999).contains(&year) && (1..=12).contains(&month) && (1..=31).contains(&day);
    valid.then_some(())?;
    // Years that begin in March have the leap day at their end; the months' days then follow a line.
    let (year, month) = if month > 2 {
        (year, month - 3)
    } else {
        (year - 1, month + 9)
    };
    let days = 365 * year + year / 4 - year / 100 + year / 400 + (153 * month + 2) / 5 + day;
    // The same for 1 January 1970.
    let days = days.checked_sub(719_469)?;

    let mut parts = time.splitn(3, |byte| *byte == b':');
    let mut next = || number(parts.next()?, Base::Decimal);
    let (hour, minute) = (next()?, next()?);
    let (hour, minute) = (hour < 24 && minute < 60).then_some((hour, minute))?;
    let second = seconds(parts.next()?)?;
    let whole = days * DAY + hour * 3600 + minute * 60;
    let ns = whole.checked_mul(NS_IN_S)?.checked_add(second.as_ticks())?;
    Some(LogTime::from_ticks(ns))
}

/// An 11-bit identifier.
pub(super) fn standard(raw: u64) -> Option<Id> {
    StandardId::new(u16::try_from(raw).ok()?).map(Id::Standard)
}

/// A 29-bit identifier.
pub(super) fn extended(raw: u64) -> Option<Id> {
    ExtendedId::new(u32::try_from(raw).ok()?).map(Id::Extended)
}

/// A data byte.
pub(super) fn byte(digits: &[u8], base: Base) -> Option<u8> {
    u8::try_from(number(digits, base)?).ok()
}

/// The first `count` words as data bytes.
pub(super) fn bytes<'w>(
    words: &mut impl Iterator<Item = &'w [u8]>,
    count: usize,
    base: Base,
) -> Option<[u8; 8]> {
    let mut data = [0; 8];
    for place in data.get_mut(..count)? {
        *place = byte(words.next()?, base)?;
    }
    Some(data)
}
