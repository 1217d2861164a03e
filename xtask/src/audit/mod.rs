//! Audit of a release image: it must not panic except after a hardware fault, must not contain
//! texts of panics, and must not need more stack than there is.
//!
//! The instructions are decoded as the emulator decodes them; the call graph is
//! rebuilt from them and walked from the vector table.

mod calls;
mod panics;
mod stack;

use std::{
    fs,
    path::{Path, PathBuf},
};

use schedulability::tasks::{App, SourceError};
use wcet::image::{Image, ImageError};

use crate::{Failure, ReadError};

pub use calls::CallsError;

pub use panics::{ALLOWED, Allowed, Place};

/// Why an image cannot be audited.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The source holds no RTIC application.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The file is no image.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// The image's calls cannot be followed.
    #[error("{}: {error}", path.display())]
    Calls {
        /// The image.
        path: PathBuf,
        /// What is wrong with it.
        #[source]
        error: CallsError,
    },
}

/// What the audit of an image found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Audit {
    /// Worst-case stack depth with one preemption by each higher priority, bytes.
    pub deepest: u64,
    /// Findings, one sentence each, without the image's name.
    pub complaints: Vec<String>,
}

/// The RTIC application in a source file.
///
/// # Errors
///
/// It cannot be read, or holds none.
pub fn application(source: &Path) -> Result<App, Failure> {
    let name = source.display().to_string();
    let text = fs::read_to_string(source).map_err(ReadError::of(source))?;
    Ok(App::parse(&name, &text).map_err(Error::from)?)
}

/// Audits the image at `path`. The priorities of `app` say which task can preempt which.
///
/// # Errors
///
/// The file cannot be read or is no image.
pub fn audit(path: &Path, app: &App) -> Result<Audit, Failure> {
    let image = Image::read(path).map_err(Error::from)?;
    let calls = calls::Calls::of(&image).map_err(|error| Error::Calls {
        path: path.into(),
        error,
    })?;
    let mut complaints = panics::complaints(&image, &calls);
    let mut app = app.clone();
    app.drop_absent(&image);
    let deepest = stack::deepest(&image, &calls, &app).unwrap_or_else(|unknown| {
        complaints.extend(unknown);
        0
    });
    Ok(Audit {
        deepest,
        complaints,
    })
}
