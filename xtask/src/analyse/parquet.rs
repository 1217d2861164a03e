//! Tables as [Parquet](https://parquet.apache.org), for pandas, Polars, DuckDB and their like.

use std::{
    fs::File,
    io, mem,
    sync::{
        Arc,
        mpsc::{SyncSender, sync_channel},
    },
    thread::{self, JoinHandle},
};

use parquet::{
    basic::Compression,
    data_type::{ByteArray, ByteArrayType, DoubleType},
    errors::ParquetError,
    file::{properties::WriterProperties, writer::SerializedFileWriter},
    schema::parser::parse_message_type,
};

/// Rows that are held back before they are written: some megabytes.
const GROUP: usize = 1 << 17;

/// The values of a column that are held back.
enum Values {
    Numbers(Vec<f64>),
    Words(Vec<ByteArray>),
}

impl Values {
    /// No values of a kind.
    fn none(kind: Kind) -> Self {
        match kind {
            Kind::Number => Self::Numbers(Vec::new()),
            Kind::Word => Self::Words(Vec::new()),
        }
    }

    /// No values of the same kind.
    fn empty(&self) -> Self {
        match self {
            Self::Numbers(_) => Self::Numbers(Vec::with_capacity(GROUP)),
            Self::Words(_) => Self::Words(Vec::with_capacity(GROUP)),
        }
    }
}

/// A value of a row. Words that come again and again share their bytes.
pub(super) enum Value<'v> {
    Number(f64),
    Word(&'v ByteArray),
}

/// The kind of a column.
#[derive(Clone, Copy)]
pub(super) enum Kind {
    Number,
    Word,
}

/// A table that is written row by row. Groups of rows are compressed and written beside what the caller
/// does.
pub(super) struct Table {
    columns: Vec<Values>,
    rows: usize,
    /// Groups that are full; `None` once the table cannot be written.
    groups: Option<SyncSender<Vec<Values>>>,
    writer: Option<JoinHandle<io::Result<()>>>,
}

fn unwritten(error: ParquetError) -> io::Error {
    match error {
        // The cause is a sentence of the system, such as that of a full disk.
        ParquetError::External(cause) => io::Error::other(cause),
        error => io::Error::other(error),
    }
}

impl Table {
    /// Begins a table with these columns in an empty file.
    ///
    /// # Errors
    /// It cannot be written.
    pub(super) fn create(file: File, columns: &[(&str, Kind)]) -> io::Result<Self> {
        let lines = columns.iter().map(|(name, kind)| match kind {
            Kind::Number => format!("REQUIRED DOUBLE {name};"),
            Kind::Word => format!("REQUIRED BYTE_ARRAY {name} (STRING);"),
        });
        let schema = format!("message table {{ {} }}", lines.collect::<String>());
        let schema = parse_message_type(&schema).map_err(unwritten)?;
        let properties = WriterProperties::builder()
            .set_compression(Compression::GZIP(parquet::basic::GzipLevel::default()))
            .set_created_by("furrow".to_owned())
            .build();
        let writer = SerializedFileWriter::new(file, Arc::new(schema), Arc::new(properties));
        let mut writer = writer.map_err(unwritten)?;
        let (groups, full) = sync_channel::<Vec<Values>>(1);
        let write = move || -> io::Result<()> {
            for group in full {
                write_group(&mut writer, &group).map_err(unwritten)?;
            }
            let file = writer.into_inner().map_err(unwritten)?;
            file.sync_all()
        };
        Ok(Self {
            columns: columns
                .iter()
                .map(|(_, kind)| Values::none(*kind))
                .collect(),
            rows: 0,
            groups: Some(groups),
            writer: Some(thread::spawn(write)),
        })
    }

    /// Adds a row; its values are of the kinds of the columns.
    ///
    /// # Errors
    /// The table cannot be written.
    pub(super) fn add(&mut self, row: &[Value<'_>]) -> io::Result<()> {
        for (column, value) in self.columns.iter_mut().zip(row) {
            match (column, value) {
                (Values::Numbers(numbers), Value::Number(number)) => numbers.push(*number),
                (Values::Words(words), Value::Word(word)) => words.push((*word).clone()),
                _ => return Err(io::Error::other("a value is not of its column's kind")),
            }
        }
        self.rows += 1;
        if self.rows >= GROUP {
            self.flush()
        } else {
            Ok(())
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        self.rows = 0;
        let empty = self.columns.iter().map(Values::empty).collect();
        let group = mem::replace(&mut self.columns, empty);
        match &self.groups {
            Some(groups) if groups.send(group).is_ok() => Ok(()),
            // The writer has ended, and says why.
            _ => self.end(),
        }
    }

    /// Waits for the writer.
    fn end(&mut self) -> io::Result<()> {
        self.groups = None;
        let broken = || io::Error::other("its writer has ended");
        let writer = self.writer.take().ok_or_else(broken)?;
        writer.join().map_err(|_| broken())?
    }

    /// Writes what is held back, and the end of the file.
    ///
    /// # Errors
    /// A part of the table cannot be written.
    pub(super) fn finish(mut self) -> io::Result<()> {
        if self.rows > 0 {
            self.flush()?;
        }
        self.end()
    }
}

/// Writes a group of rows.
fn write_group(
    writer: &mut SerializedFileWriter<File>,
    columns: &[Values],
) -> Result<(), ParquetError> {
    let mut group = writer.next_row_group()?;
    for values in columns {
        let Some(mut column) = group.next_column()? else {
            break;
        };
        match values {
            Values::Numbers(numbers) => {
                let to = column.typed::<DoubleType>();
                to.write_batch(numbers, None, None)?;
            }
            Values::Words(words) => {
                let to = column.typed::<ByteArrayType>();
                to.write_batch(words, None, None)?;
            }
        }
        column.close()?;
    }
    group.close()?;
    Ok(())
}
