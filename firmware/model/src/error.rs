//! What can be wrong with a vehicle's folder.

use std::io;
use std::path::PathBuf;

/// Why a folder is no vehicle. Each is one sentence that says what is wrong and where.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// A name that no folder has.
    #[error("there is no vehicle {name:?}: there are {}", known.join(", "))]
    Unknown {
        /// The name.
        name: String,
        /// The vehicles that there are.
        known: Vec<String>,
    },
    /// A file that cannot be read.
    #[error("{} cannot be read: {error}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// Not TOML, or a field that is missing, unknown or not of its kind.
    #[error("{}: {what}", file.display())]
    Manifest {
        /// The manifest.
        file: PathBuf,
        /// The field and what it accepts.
        what: String,
    },
    /// The network file has errors.
    #[error("{}: {what}", file.display())]
    Network {
        /// The network file.
        file: PathBuf,
        /// Its errors, on one line.
        what: String,
    },
}
