//! The output folder: either all files of a run are written, or the folder stays unchanged.

use core::fmt;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// A folder that receives all its files together.
///
/// Files are written to a hidden folder on the same file system. [`OutputFolder::finish`] moves
/// them to their places, each in one step that replaces an older file. A value dropped before that
/// changes nothing, and [`remove_unfinished`] is for programs that are interrupted. Other files in an
/// existing folder stay. Of two runs into one folder the second is refused.
#[derive(Debug)]
pub struct OutputFolder {
    target: PathBuf,
    staging: PathBuf,
    /// Locked as long as the folder is not finished.
    lock: fs::File,
    existed: bool,
    names: Vec<String>,
    /// Which files of an older run go away.
    obsolete: Option<fn(&str) -> bool>,
    finished: bool,
}

/// The hidden folders that this program writes to.
static UNFINISHED: Mutex<Vec<PathBuf>> = Mutex::new(Vec::new());

/// Its file that is locked.
const LOCK: &str = ".lock";

fn unfinished() -> MutexGuard<'static, Vec<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Removes the hidden folders of all values that are not finished, for a program that ends at once.
pub fn remove_unfinished() {
    for staging in unfinished().drain(..) {
        // If this fails, the hidden folder stays; the next run into the same place removes it.
        let _ = fs::remove_dir_all(staging);
    }
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
            io::ErrorKind::ResourceBusy => "another run writes to it".to_owned(),
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
        let name = target.file_name().filter(|_| !existed);
        let beside = match (existed, target.parent()) {
            (true, _) => target.clone(),
            (false, Some(parent)) if !parent.as_os_str().is_empty() => parent.to_path_buf(),
            (false, _) => PathBuf::from("."),
        };
        fs::create_dir_all(&beside).map_err(fail)?;
        let name = name.map(|name| format!("-{}", name.to_string_lossy()));
        let staging = beside.join(format!(".unfinished{}", name.unwrap_or_default()));
        let lock = reserve(&staging).map_err(fail)?;
        unfinished().push(staging.clone());
        Ok(Self {
            existed: target.is_dir(),
            target,
            staging,
            lock,
            names: Vec::new(),
            obsolete: None,
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

    /// When the files are put into an existing folder, removes those that an older run has left there and
    /// this one does not write: `is_of_run` knows their names.
    pub fn replace_older(&mut self, is_of_run: fn(&str) -> bool) {
        self.obsolete = Some(is_of_run);
    }

    /// The files of an older run that nothing takes the place of.
    fn left_over(&self) -> Vec<PathBuf> {
        let Some(is_of_run) = self.obsolete else {
            return Vec::new();
        };
        let entries = fs::read_dir(&self.target).into_iter().flatten().flatten();
        let old = entries.filter(|entry| {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            let is_file = entry.file_type().is_ok_and(|kind| kind.is_file());
            is_file && is_of_run(&name) && !self.names.iter().any(|own| *own == name)
        });
        old.map(|entry| entry.path()).collect()
    }

    /// Puts the files into the folder and returns its path.
    ///
    /// # Errors
    /// When a file cannot be moved.
    pub fn finish(mut self) -> Result<PathBuf, FolderError> {
        fs::remove_file(self.staging.join(LOCK)).map_err(|cause| self.fail(cause))?;
        if self.existed {
            self.names.iter().try_for_each(|name| self.vacant(name))?;
            for name in &self.names {
                fs::rename(self.staging.join(name), self.target.join(name))
                    .map_err(|cause| self.fail(cause))?;
            }
            for old in self.left_over() {
                fs::remove_file(old).map_err(|cause| self.fail(cause))?;
            }
            fs::remove_dir_all(&self.staging).map_err(|cause| self.fail(cause))?;
        } else {
            fs::rename(&self.staging, &self.target).map_err(|cause| self.fail(cause))?;
        }
        self.finished = true;
        self.forget();
        Ok(self.target.clone())
    }

    /// Whether a file can be put to its place: what is no regular file is not replaced.
    fn vacant(&self, name: &str) -> Result<(), FolderError> {
        match fs::symlink_metadata(self.target.join(name)) {
            Ok(there) if !there.is_file() => {
                let why = format!("its {name} is no regular file");
                Err(self.fail(io::Error::other(why)))
            }
            _ => Ok(()),
        }
    }

    fn forget(&self) {
        unfinished().retain(|staging| *staging != self.staging);
        // Closing the file would do it, too.
        let _ = self.lock.unlock();
    }
}

/// Makes the hidden folder and locks it. One that a killed run has left is emptied.
fn reserve(staging: &Path) -> io::Result<fs::File> {
    let in_use = |error| match error {
        fs::TryLockError::WouldBlock => io::ErrorKind::ResourceBusy.into(),
        fs::TryLockError::Error(error) => error,
    };
    if staging.is_dir() {
        if let Ok(lock) = fs::File::open(staging.join(LOCK)) {
            lock.try_lock().map_err(in_use)?;
        }
        fs::remove_dir_all(staging)?;
    }
    fs::create_dir(staging)?;
    let lock = fs::File::create_new(staging.join(LOCK))?;
    lock.try_lock().map_err(in_use)?;
    Ok(lock)
}

impl Drop for OutputFolder {
    fn drop(&mut self) {
        if !self.finished {
            // If this fails, the hidden folder stays; no better reaction is possible here.
            let _ = fs::remove_dir_all(&self.staging);
            self.forget();
        }
    }
}
