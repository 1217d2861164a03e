//! What a release image must not do: panic where no fault of the hardware is behind it,
//! carry the text of a panic, need more stack than there is.
//!
//! The instructions are decoded as the emulator decodes them; the call graph is
//! rebuilt from them and walked from the vector table.

mod calls;
mod panics;
mod stack;

use std::{fs, path::Path};

use schedulability::tasks::App;
use wcet::image::Image;

use crate::Failure;

pub use panics::{ALLOWED, Allowed, Place};

/// What the audit of an image found.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Audit {
    /// Worst case of the call stack with every priority's preemption, bytes.
    pub deepest: u64,
    /// What stands against the image, one sentence each, without the image's name.
    pub complaints: Vec<String>,
}

/// The RTIC application in a source file.
///
/// # Errors
///
/// It cannot be read, or holds none.
pub fn application(source: &Path) -> Result<App, Failure> {
    let name = source.display().to_string();
    let text = fs::read_to_string(source)
        .map_err(|error| Failure::Failed(format!("{name} cannot be read: {error}")))?;
    App::parse(&name, &text).map_err(|error| Failure::Failed(error.to_string()))
}

/// Audits the image at `path` of an application, whose priorities say who interrupts whom.
///
/// # Errors
///
/// The file cannot be read or is no image.
pub fn audit(path: &Path, app: &App) -> Result<Audit, Failure> {
    let failed = |error: String| Failure::Failed(error);
    let image = Image::read(path).map_err(|error| failed(error.to_string()))?;
    let calls =
        calls::Calls::of(&image).map_err(|what| failed(format!("{}: {what}", path.display())))?;
    let mut complaints = panics::complaints(&image, &calls);
    let deepest = stack::deepest(&image, &calls, app).unwrap_or_else(|unknown| {
        complaints.extend(unknown);
        0
    });
    Ok(Audit {
        deepest,
        complaints,
    })
}
