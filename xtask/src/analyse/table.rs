//! The tables of an analysis as CSV: all signals of all frames, and the events.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
};

use super::{
    decode::{Decoder, Field},
    figures::Event,
};
use crate::Failure;

/// Size of the pieces in which a table is written, bytes.
const PIECE: usize = 1 << 16;

/// A field of a table; in quotation marks if it needs them (RFC 4180).
fn quoted(text: &str) -> String {
    if text.contains([',', '"', '\n', '\r']) {
        format!("\"{}\"", text.replace('"', "\"\""))
    } else {
        text.to_owned()
    }
}

/// A signal's part of a row.
struct Row {
    /// Message and signal, with the commas around them.
    before: String,
    field: Field,
    /// The unit, with the comma before it.
    after: String,
}

/// `messages.csv` in the long form: time, message, signal, value, unit.
pub(super) struct Messages {
    file: BufWriter<File>,
    /// The signals of each identifier.
    rows: Vec<Vec<Row>>,
    /// The first error; nothing is written after it.
    result: io::Result<()>,
}

/// The failure of writing a table.
fn unwritten(error: io::Error) -> Failure {
    Failure::Usage(format!("messages.csv cannot be written: {error}"))
}

impl Messages {
    /// Begins the table in an empty file.
    ///
    /// # Errors
    /// It cannot be written.
    pub(super) fn create(file: File, decoder: &Decoder) -> Result<Self, Failure> {
        let mut file = BufWriter::with_capacity(PIECE, file);
        file.write_all(b"time_s,message,signal,value,unit\n")
            .map_err(unwritten)?;
        let mut rows = Vec::new();
        rows.resize_with(1 << 11, Vec::new);
        for message in decoder.messages() {
            let fields = message.fields.iter().map(|field| Row {
                before: format!(",{},{},", quoted(&message.name), quoted(&field.name)),
                field: field.clone(),
                after: format!(",{}\n", quoted(&field.unit)),
            });
            if let Some(place) = rows.get_mut(usize::from(message.id)) {
                *place = fields.collect();
            }
        }
        Ok(Self {
            file,
            rows,
            result: Ok(()),
        })
    }

    /// Adds the signals of a frame; `at` in nanoseconds.
    pub(super) fn add(&mut self, at: i64, id: u16, data: &[u8; 8]) {
        if self.result.is_ok() {
            self.result = self.try_add(at, id, data);
        }
    }

    fn try_add(&mut self, at: i64, id: u16, data: &[u8; 8]) -> io::Result<()> {
        let Some(rows) = self.rows.get(usize::from(id)) else {
            return Ok(());
        };
        let us = at.unsigned_abs() / 1000;
        let sign = if at < 0 { "-" } else { "" };
        let time = format!("{sign}{}.{:06}", us / 1_000_000, us % 1_000_000);
        for row in rows {
            self.file.write_all(time.as_bytes())?;
            self.file.write_all(row.before.as_bytes())?;
            write!(
                self.file,
                "{:.*}",
                row.field.decimals,
                row.field.value(data)
            )?;
            self.file.write_all(row.after.as_bytes())?;
        }
        Ok(())
    }

    /// Writes the buffered rest.
    ///
    /// # Errors
    /// A part of the table could not be written.
    pub(super) fn finish(mut self) -> Result<(), Failure> {
        self.result.map_err(unwritten)?;
        self.file.flush().map_err(unwritten)?;
        self.file.get_ref().sync_all().map_err(unwritten)
    }
}

/// `events.csv`.
pub(super) fn events(events: &[Event]) -> String {
    let mut text = String::from("time_s,kind,event\n");
    for event in events {
        let (at, kind) = (event.at_seconds, event.kind.name());
        text += &format!("{at:.6},{kind},{}\n", quoted(&event.what));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_with_commas_and_quotation_marks_are_quoted() {
        assert_eq!(quoted("plain words"), "plain words");
        assert_eq!(quoted("one, \"two\""), "\"one, \"\"two\"\"\"");
    }
}
