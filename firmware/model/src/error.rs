//! Errors in a vehicle's folder.

use std::io;
use std::path::PathBuf;

/// Why a folder does not describe a vehicle. Each message is one sentence that says what is
/// wrong and where.
#[derive(Debug, thiserror::Error)]
pub enum VehicleError {
    /// No folder has this name.
    #[error("there is no vehicle {name:?}: there are {}", known.join(", "))]
    Unknown {
        /// The name.
        name: String,
        /// The vehicles that exist.
        known: Vec<String>,
    },
    /// Two folders have one name.
    #[error("two vehicles have the name {name:?}: {} and {}", one.display(), other.display())]
    Twice {
        /// The name.
        name: String,
        /// The first folder.
        one: PathBuf,
        /// The second one.
        other: PathBuf,
    },
    /// A file that cannot be read.
    #[error("{} cannot be read: {error}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why.
        error: io::Error,
    },
    /// The file is not TOML, or a field is missing, unknown or of the wrong type.
    #[error("{}: {what}", file.display())]
    Manifest {
        /// The manifest.
        file: PathBuf,
        /// The field and what it accepts.
        what: String,
    },
    /// A node has no source.
    #[error("{}: node {node:?} has no source: nodes/{node}.rs is missing", file.display())]
    NoSource {
        /// The manifest.
        file: PathBuf,
        /// The node.
        node: String,
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
