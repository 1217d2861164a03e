//! What is watched: a bus, or the log of one.

use std::{fmt, path::PathBuf, str::FromStr};

use crate::selftest::Bus;

/// A bus, or a log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// A bus, as it happens.
    Bus(Bus),
    /// The frames in a file, in their own time.
    Log(PathBuf),
}

/// A text that names neither.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("twin, socketcan:INTERFACE, slcan:PORT[@BAUD] or the file of a log is accepted")]
pub struct NoSource;

impl FromStr for Source {
    type Err = NoSource;

    /// A bus counts before a file of the same name, which `./` in front of it names.
    fn from_str(text: &str) -> Result<Self, NoSource> {
        if let Ok(bus) = text.parse() {
            return Ok(Self::Bus(bus));
        }
        let path = PathBuf::from(text);
        if path.exists() {
            Ok(Self::Log(path))
        } else {
            Err(NoSource)
        }
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Bus(bus) => bus.fmt(f),
            Self::Log(path) => path.display().fmt(f),
        }
    }
}
