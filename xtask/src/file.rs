//! Files of a vehicle, read whole and replaced whole.

use std::{
    fs,
    io::{self, Write},
    path::{Path, PathBuf},
    process,
};

/// A file of a vehicle cannot be read or written.
#[derive(Debug, thiserror::Error)]
#[error("{} {why}", path.display())]
pub struct Error {
    path: PathBuf,
    #[source]
    why: Why,
}

#[derive(Debug, thiserror::Error)]
enum Why {
    #[error("cannot be read: {0}")]
    Read(io::Error),
    #[error("is not UTF-8 text")]
    NotText,
    #[error("cannot be written: {0}")]
    Write(io::Error),
}

impl Error {
    fn of(path: &Path, why: Why) -> Self {
        let path = path.into();
        Self { path, why }
    }
}

/// Reads a text file.
///
/// # Errors
///
/// It cannot be read, or is no text.
pub(crate) fn read(path: &Path) -> Result<String, Error> {
    let bytes = fs::read(path).map_err(|error| Error::of(path, Why::Read(error)))?;
    String::from_utf8(bytes).map_err(|_| Error::of(path, Why::NotText))
}

/// Replaces a file by a rename, so that no reader sees a half-written one.
///
/// # Errors
///
/// It cannot be written; what was there stays.
pub(crate) fn replace(path: &Path, text: &str) -> Result<(), Error> {
    try_replace(path, text).map_err(|error| Error::of(path, Why::Write(error)))
}

/// Whether [`put`] can write a file, found out before a long computation.
///
/// # Errors
///
/// It cannot.
pub(crate) fn check(path: &Path) -> Result<(), Error> {
    let check = || match fs::metadata(path) {
        Ok(there) if !there.is_file() => Err(in_the_way()),
        _ => {
            let temporary = temporary(path);
            private(&temporary)?;
            fs::remove_file(&temporary)
        }
    };
    check().map_err(|error| Error::of(path, Why::Write(error)))
}

fn in_the_way() -> io::Error {
    io::Error::other("something that is no regular file is in the way")
}

/// A hidden name beside a file.
fn temporary(path: &Path) -> PathBuf {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    path.with_file_name(format!(".{name}.{}", process::id()))
}

/// Writes a file whole, or replaces one by a rename. What is no regular file stays as it is.
///
/// # Errors
///
/// It cannot be written; what was there stays.
pub(crate) fn put(path: &Path, text: &str) -> Result<(), Error> {
    let put = || {
        if fs::metadata(path).is_ok() {
            return try_replace(path, text);
        }
        let temporary = temporary(path);
        let written = fs::write(&temporary, text).and_then(|()| fs::rename(&temporary, path));
        if written.is_err() {
            // An incomplete temporary file is of no use.
            let _ = fs::remove_file(&temporary);
        }
        written
    };
    put().map_err(|error| Error::of(path, Why::Write(error)))
}

fn try_replace(path: &Path, text: &str) -> io::Result<()> {
    // A link is followed, so that the file is replaced and not the link.
    let path = fs::canonicalize(path)?;
    let metadata = fs::metadata(&path)?;
    if !metadata.is_file() {
        return Err(in_the_way());
    }
    let permissions = metadata.permissions();
    if permissions.readonly() {
        return Err(io::Error::new(
            io::ErrorKind::PermissionDenied,
            "it is read-only",
        ));
    }
    let temporary = temporary(&path);
    let written = (|| {
        let mut file = private(&temporary)?;
        file.write_all(text.as_bytes())?;
        file.set_permissions(permissions)?;
        file.sync_all()?;
        fs::rename(&temporary, &path)
    })();
    if written.is_err() {
        // An incomplete temporary file is of no use.
        let _ = fs::remove_file(&temporary);
    }
    written
}

/// A file that did not exist before, which only its owner can read.
pub(crate) fn private(path: &Path) -> io::Result<fs::File> {
    let mut options = fs::OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    options.open(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_is_left_over() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dbc");
        fs::write(&path, "before").unwrap();
        replace(&path, "after").unwrap();
        assert_eq!(read(&path).unwrap(), "after");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_cannot_be_read_or_written_is_said_with_its_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("absent.dbc");
        for failure in [read(&path).unwrap_err(), replace(&path, "").unwrap_err()] {
            assert!(failure.to_string().contains("absent.dbc"), "{failure}");
            assert_eq!(crate::Failure::from(failure).exit_code(), 2);
        }
        let latin = folder.path().join("latin.dbc");
        fs::write(&latin, [b'"', 0xB0, b'"']).unwrap();
        assert!(read(&latin).unwrap_err().to_string().contains("UTF-8"));
    }

    #[test]
    fn a_read_only_file_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.dbc");
        fs::write(&path, "before").unwrap();
        let mut permissions = fs::metadata(&path).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&path, permissions).unwrap();
        assert!(
            replace(&path, "after")
                .unwrap_err()
                .to_string()
                .contains("read-only")
        );
        assert_eq!(read(&path).unwrap(), "before");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link() {
        let folder = tempfile::tempdir().unwrap();
        let (path, link) = (folder.path().join("a.dbc"), folder.path().join("b.dbc"));
        fs::write(&path, "before").unwrap();
        std::os::unix::fs::symlink(&path, &link).unwrap();
        replace(&link, "after").unwrap();
        assert_eq!(read(&path).unwrap(), "after");
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    }
}
