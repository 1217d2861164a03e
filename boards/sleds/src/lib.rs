//! The CAN sleds as data: netlists, bills of materials, and the headers of the Nucleo boards.
//!
//! [`netlist`] reads a netlist, [`bill`] a bill of materials and [`header`] the pins of the
//! headers. [`rules`] checks a sled against the pin tables that the firmware is built from
//! ([`parts::Sled`]). [`picture`] draws it. The files are in the folder of this crate; its
//! `README.md` says what they are.

pub mod bill;
pub mod header;
pub mod netlist;
pub mod picture;
pub mod rules;

use std::{fs, io, path::PathBuf};

/// Why a file of a sled cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// It cannot be read.
    #[error("{file}: {error}")]
    Read {
        /// The file's name.
        file: String,
        /// Why not.
        #[source]
        error: io::Error,
    },
    /// It is no s-expression.
    #[error("{file}: {error}")]
    Syntax {
        /// The file's name.
        file: String,
        /// Where and why.
        #[source]
        error: lexpr::parse::Error,
    },
    /// A netlist lacks something.
    #[error("{file}: {what} is missing in {place}")]
    Missing {
        /// The file's name.
        file: String,
        /// What is missing.
        what: &'static str,
        /// Where it should be.
        place: String,
    },
    /// A table is no CSV, or has other columns.
    #[error("{file}: {error}")]
    Table {
        /// The file's name.
        file: String,
        /// Where and why.
        #[source]
        error: csv::Error,
    },
}

/// The drawings that there are: each has a netlist, a bill of materials and a picture.
pub const DRAWINGS: [&str; 3] = ["f446", "f303", "bench"];

/// A file of this crate's folder.
#[must_use]
pub fn path(file: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join(file)
}

/// The text of a file of this crate's folder.
///
/// # Errors
/// It cannot be read.
pub fn read(file: &str) -> Result<String, Error> {
    fs::read_to_string(path(file)).map_err(|error| Error::Read {
        file: file.into(),
        error,
    })
}

/// The columns of each line of a table, by their names in its first line.
fn table<const COLUMNS: usize>(
    file: &str,
    text: &str,
    names: [&str; COLUMNS],
) -> Result<Vec<[String; COLUMNS]>, Error> {
    let wrong = |error| Error::Table {
        file: file.into(),
        error,
    };
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let header = reader.headers().map_err(wrong)?;
    if header != names.as_slice() {
        return Err(Error::Missing {
            file: file.into(),
            what: "a column",
            place: format!("the first line, which is {}", names.join(",")),
        });
    }
    let mut lines = Vec::new();
    for record in reader.records() {
        let record = record.map_err(wrong)?;
        lines.push(std::array::from_fn(|column| record[column].to_owned()));
    }
    Ok(lines)
}
