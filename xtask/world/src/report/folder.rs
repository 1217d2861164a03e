//! The output folder: either all files of a run are written, or the folder stays unchanged.

use core::fmt;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// A folder that receives all its files together.
///
/// Files are written to a hidden folder on the same file system. [`OutputFolder::finish`] moves
/// them to their places, each in one step that replaces an older file. A value dropped before that
/// changes nothing. Other files in an existing folder stay.
#[derive(Debug)]
pub struct OutputFolder {
    target: PathBuf,
    staging: PathBuf,
    existed: bool,
    names: Vec<String>,
    finished: bool,
}

/// Why the output folder cannot be written. Displays as one sentence.
#[derive(Debug)]
pub struct FolderError {
    target: PathBuf,
    cause: io::Error,
}

impl fmt::Display for FolderError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let why = match self.cause.kind() {
            io::ErrorKind::PermissionDenied => "permission denied".to_owned(),
            io::ErrorKind::NotADirectory | io::ErrorKind::AlreadyExists => {
                "a file is in the way".to_owned()
            }
            io::ErrorKind::ReadOnlyFilesystem => "its file system is read-only".to_owned(),
            io::ErrorKind::StorageFull => "no space is left".to_owned(),
            _ => self.cause.to_string(),
        };
        write!(
            f,
            "output folder {} cannot be written: {why}; name a folder that can be created or \
             written to",
            self.target.display()
        )
    }
}

impl core::error::Error for FolderError {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        Some(&self.cause)
    }
}

impl OutputFolder {
    /// Prepares `target`, which may exist or not, and creates its parents as needed. Call it before
    /// a long run, to detect early that the folder cannot be written.
    ///
    /// # Errors
    /// When the hidden folder cannot be created.
    pub fn create(target: impl AsRef<Path>) -> Result<Self, FolderError> {
        let target = target.as_ref().to_path_buf();
        let fail = |cause| FolderError {
            target: target.clone(),
            cause,
        };
        if target.exists() && !target.is_dir() {
            return Err(fail(io::ErrorKind::NotADirectory.into()));
        }
        let existed = target.is_dir();
        let beside = if existed {
            target.clone()
        } else {
            match target.parent() {
                Some(parent) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
                _ => PathBuf::from("."),
            }
        };
        fs::create_dir_all(&beside).map_err(fail)?;
        let staging = beside.join(format!(".unfinished-{}", std::process::id()));
        if staging.is_dir() {
            fs::remove_dir_all(&staging).map_err(fail)?;
        }
        fs::create_dir(&staging).map_err(fail)?;
        Ok(Self {
            target,
            staging,
            existed,
            names: Vec::new(),
            finished: false,
        })
    }

    fn fail(&self, cause: io::Error) -> FolderError {
        FolderError {
            target: self.target.clone(),
            cause,
        }
    }

    /// Writes a file that [`OutputFolder::finish`] will put into the folder.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&mut self, name: &str, contents: &[u8]) -> Result<(), FolderError> {
        let mut file = self.file(name)?;
        file.write_all(contents)
            .and_then(|()| file.sync_all())
            .map_err(|cause| self.fail(cause))
    }

    /// Creates a file that the caller writes piece by piece.
    ///
    /// # Errors
    /// When it cannot be created.
    pub fn file(&mut self, name: &str) -> Result<fs::File, FolderError> {
        let file = fs::File::create(self.staging.join(name)).map_err(|cause| self.fail(cause))?;
        self.names.push(name.to_owned());
        Ok(file)
    }

    /// Puts the files into the folder and returns its path.
    ///
    /// # Errors
    /// When a file cannot be moved.
    pub fn finish(mut self) -> Result<PathBuf, FolderError> {
        if self.existed {
            for name in &self.names {
                fs::rename(self.staging.join(name), self.target.join(name))
                    .map_err(|cause| self.fail(cause))?;
            }
            fs::remove_dir_all(&self.staging).map_err(|cause| self.fail(cause))?;
        } else {
            fs::rename(&self.staging, &self.target).map_err(|cause| self.fail(cause))?;
        }
        self.finished = true;
        Ok(self.target.clone())
    }
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        if !self.finished {
            // If this fails, the hidden folder stays; no better reaction is possible here.
            let _ = fs::remove_dir_all(&self.staging);
        }
    }
}
