//! `run.html`: the run as a page that plays it. It is one file and loads nothing.
//!
//! The script gets its data as one block: the length of a JSON text (32 bits, little-endian), the
//! text, and behind it columns of numbers, all of it deflated and written in base64. A column of
//! increasing numbers holds differences; each number is a varint of seven bits a byte, the lowest
//! first.

mod data;
mod markup;

use std::io::{self, Write};

use base64::{Engine, engine::general_purpose::STANDARD};
use flate2::{Compression, write::DeflateEncoder};
use world::report::{Summary, Table};

use super::super::Finished;

/// Columns of numbers behind the JSON text.
#[derive(Default)]
struct Columns {
    bytes: Vec<u8>,
    places: Vec<(String, usize, usize)>,
}

impl Columns {
    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.bytes.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.bytes.push(value as u8);
    }

    /// A column of numbers.
    fn numbers(&mut self, name: &str, values: impl Iterator<Item = u64>) {
        let begin = self.bytes.len();
        values.for_each(|value| self.varint(value));
        self.places.push((name.to_owned(), begin, self.bytes.len()));
    }

    /// A column of numbers that never decrease.
    fn rising(&mut self, name: &str, values: impl Iterator<Item = u64>) {
        let mut last = 0;
        let differences =
            values.map(|value| value.saturating_sub(core::mem::replace(&mut last, value)));
        self.numbers(name, differences);
    }

    /// A column of bytes.
    fn raw(&mut self, name: &str, bytes: impl Iterator<Item = u8>) {
        let begin = self.bytes.len();
        self.bytes.extend(bytes);
        self.places.push((name.to_owned(), begin, self.bytes.len()));
    }
}

/// The page.
///
/// # Errors
/// Compression of bytes in memory does not fail; if it does, this says how.
pub(crate) fn page(
    finished: &Finished<'_>,
    summary: &Summary,
    states: Option<&Table>,
) -> io::Result<String> {
    let mut columns = Columns::default();
    let header = data::header(finished, summary, states, &mut columns);
    let text = header.to_string();
    let mut block = DeflateEncoder::new(Vec::new(), Compression::best());
    let length = u32::try_from(text.len()).map_err(io::Error::other)?;
    block.write_all(&length.to_le_bytes())?;
    block.write_all(text.as_bytes())?;
    block.write_all(&columns.bytes)?;
    let data = STANDARD.encode(block.finish()?);
    let title = format!("{}: {}", finished.vehicle.name(), finished.scenario.name);
    Ok(markup::markup(&title, finished, summary, &data))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_hold_what_they_were_given() {
        let mut columns = Columns::default();
        columns.rising("a", [5, 5, 200, 70_000].into_iter());
        columns.raw("b", [7, 255].into_iter());
        assert_eq!(columns.bytes, [5, 0, 195, 1, 0xA8, 0xA1, 4, 7, 255]);
        let places = [("a".to_owned(), 0, 7), ("b".to_owned(), 7, 9)];
        assert_eq!(columns.places, places);
    }
}
