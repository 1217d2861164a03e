//! The tables of an analysis, as CSV and as Parquet: all signals of all frames, and the events.

use std::{
    fs::File,
    io::{self, BufWriter, Write},
};

use parquet::data_type::ByteArray;

use super::{
    figures::{Event, rounded},
    parquet::{Kind, Table, Value},
};
use crate::Failure;
use crate::network::decode::{Decoder, Field};

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
    /// Message, signal and unit as they are.
    words: [ByteArray; 3],
}

/// `messages.csv` and `messages.parquet` in the long form: time, message, signal, value, unit.
pub(super) struct Messages {
    file: BufWriter<File>,
    table: Table,
    /// The signals of each identifier.
    rows: Vec<Vec<Row>>,
    /// The first error; nothing is written after it.
    result: Result<(), Failure>,
}

/// The failure of writing a table.
fn unwritten(name: &str) -> impl Fn(io::Error) -> Failure {
    move |error| Failure::Usage(format!("{name} cannot be written: {error}"))
}

const CSV: &str = "messages.csv";
const PARQUET: &str = "messages.parquet";

/// The columns of [`Messages`].
const COLUMNS: [(&str, Kind); 5] = [
    ("time_s", Kind::Number),
    ("message", Kind::Word),
    ("signal", Kind::Word),
    ("value", Kind::Number),
    ("unit", Kind::Word),
];

impl Row {
    /// Writes it as a line of CSV.
    fn write(&self, file: &mut BufWriter<File>, time: &str, value: f64) -> io::Result<()> {
        file.write_all(time.as_bytes())?;
        file.write_all(self.before.as_bytes())?;
        write!(file, "{value:.*}", self.field.decimals)?;
        file.write_all(self.after.as_bytes())
    }
}

impl Messages {
    /// Begins the table in two empty files.
    ///
    /// # Errors
    /// One cannot be written.
    pub(super) fn create(csv: File, parquet: File, decoder: &Decoder) -> Result<Self, Failure> {
        let mut file = BufWriter::with_capacity(PIECE, csv);
        let names = COLUMNS.map(|(name, _)| name).join(",");
        file.write_all(format!("{names}\n").as_bytes())
            .map_err(unwritten(CSV))?;
        let mut rows = Vec::new();
        rows.resize_with(1 << 11, Vec::new);
        for message in decoder.messages() {
            let fields = message.fields.iter().map(|field| Row {
                before: format!(",{},{},", quoted(&message.name), quoted(&field.name)),
                field: field.clone(),
                after: format!(",{}\n", quoted(&field.unit)),
                words: [&message.name, &field.name, &field.unit]
                    .map(|word| ByteArray::from(word.as_str())),
            });
            if let Some(place) = rows.get_mut(usize::from(message.id)) {
                *place = fields.collect();
            }
        }
        Ok(Self {
            file,
            table: Table::create(parquet, &COLUMNS).map_err(unwritten(PARQUET))?,
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

    fn try_add(&mut self, at: i64, id: u16, data: &[u8; 8]) -> Result<(), Failure> {
        let Some(rows) = self.rows.get(usize::from(id)) else {
            return Ok(());
        };
        let us = at.unsigned_abs() / 1000;
        let sign = if at < 0 { "-" } else { "" };
        let time = format!("{sign}{}.{:06}", us / 1_000_000, us % 1_000_000);
        let seconds = rounded(at as f64 * 1e-9, 9);
        for row in rows {
            let value = row.field.value(data);
            row.write(&mut self.file, &time, value)
                .map_err(unwritten(CSV))?;
            let [message, signal, unit] = &row.words;
            let row = [
                Value::Number(seconds),
                Value::Word(message),
                Value::Word(signal),
                Value::Number(value),
                Value::Word(unit),
            ];
            self.table.add(&row).map_err(unwritten(PARQUET))?;
        }
        Ok(())
    }

    /// Writes the buffered rest.
    ///
    /// # Errors
    /// A part of the table could not be written.
    pub(super) fn finish(mut self) -> Result<(), Failure> {
        self.result?;
        self.file.flush().map_err(unwritten(CSV))?;
        self.file.get_ref().sync_all().map_err(unwritten(CSV))?;
        self.table.finish().map_err(unwritten(PARQUET))
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

/// `events.parquet`.
///
/// # Errors
/// It cannot be written.
pub(super) fn write_events(file: File, events: &[Event]) -> Result<(), Failure> {
    let columns = [
        ("time_s", Kind::Number),
        ("kind", Kind::Word),
        ("event", Kind::Word),
    ];
    let write = || {
        let mut table = Table::create(file, &columns)?;
        for event in events {
            let kind = ByteArray::from(event.kind.name());
            let what = ByteArray::from(event.what.as_str());
            table.add(&[
                Value::Number(event.at_seconds),
                Value::Word(&kind),
                Value::Word(&what),
            ])?;
        }
        table.finish()
    };
    write().map_err(unwritten("events.parquet"))
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
