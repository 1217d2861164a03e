//! Why a command ends without success.

use std::fmt;

/// Why a command ends without success; displays as one sentence.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Failure {
    /// The command line or an input file is wrong: exit code 2.
    Usage(String),
    /// Something did not work: exit code 1.
    Failed(String),
    /// As `Failed`, but what was wrong is on the screen already.
    Shown,
}

impl Failure {
    /// The exit code of the program.
    pub fn exit_code(&self) -> u8 {
        match self {
            Failure::Usage(_) => 2,
            Failure::Failed(_) | Failure::Shown => 1,
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Failure::Usage(what) | Failure::Failed(what) => f.write_str(what),
            Failure::Shown => f.write_str("failed as shown above"),
        }
    }
}

impl std::error::Error for Failure {}
