//! What can go wrong, one sentence each.

/// Why the command has no good answer.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The command line, the task table, a source, the part or the image is wrong.
    #[error("{0}")]
    Input(String),
    /// The project does not build.
    #[error("{0}")]
    Build(String),
    /// A deadline is missed or not proven, a task lost more slack than allowed, or an observation exceeds a
    /// bound.
    #[error("{0}")]
    Missed(String),
}

impl Error {
    /// Wrong input.
    pub(crate) fn input(what: impl std::fmt::Display) -> Self {
        Self::Input(what.to_string())
    }

    /// The exit code: 2 for wrong input, else 1.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::Input(_) => 2,
            Self::Build(_) | Self::Missed(_) => 1,
        }
    }
}

/// Reads a file of text.
pub(crate) fn read(path: &std::path::Path) -> Result<String, Error> {
    std::fs::read_to_string(path)
        .map_err(|error| Error::input(format!("cannot read {}: {error}", path.display())))
}

/// Writes a file.
pub(crate) fn write(path: &std::path::Path, text: &str) -> Result<(), Error> {
    std::fs::write(path, text)
        .map_err(|error| Error::input(format!("cannot write {}: {error}", path.display())))
}
