//! Tables as [Parquet](https://parquet.apache.org), for pandas, Polars, DuckDB and their like.

use std::{fs::File, io, sync::Arc};

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

/// A table that is written row by row.
pub(super) struct Table {
    writer: SerializedFileWriter<File>,
    columns: Vec<Values>,
    rows: usize,
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
        let values = columns.iter().map(|(_, kind)| match kind {
            Kind::Number => Values::Numbers(Vec::new()),
            Kind::Word => Values::Words(Vec::new()),
        });
        Ok(Self {
            writer: writer.map_err(unwritten)?,
            columns: values.collect(),
            rows: 0,
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
        let columns = &mut self.columns;
        let write = || -> Result<(), ParquetError> {
            let mut group = self.writer.next_row_group()?;
            for values in columns {
                let Some(mut column) = group.next_column()? else {
                    break;
                };
                match values {
                    Values::Numbers(numbers) => {
                        let to = column.typed::<DoubleType>();
                        to.write_batch(numbers, None, None)?;
                        numbers.clear();
                    }
                    Values::Words(words) => {
                        let to = column.typed::<ByteArrayType>();
                        to.write_batch(words, None, None)?;
                        words.clear();
                    }
                }
                column.close()?;
            }
            group.close()?;
            Ok(())
        };
        self.rows = 0;
        write().map_err(unwritten)
    }

    /// Writes what is held back, and the end of the file.
    ///
    /// # Errors
    /// A part of the table cannot be written.
    pub(super) fn finish(mut self) -> io::Result<()> {
        if self.rows > 0 {
            self.flush()?;
        }
        let file = self.writer.into_inner().map_err(unwritten)?;
        file.sync_all()
    }
}
