//! A pseudo-terminal behind which the virtual bus is, as if it were a serial port with an adapter.

use std::{
    collections::VecDeque,
    fs::{self, File, OpenOptions},
    io::{self, Read, Write},
    os::{fd::AsRawFd, unix::fs::symlink},
    path::{Path, PathBuf},
    process,
};

use can_bus::{Frame, slcan::Adapter};
use rustix::{
    fs::{OFlags, fcntl_getfl, fcntl_setfl},
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{OptionalActions, tcgetattr, tcsetattr},
};

use super::{Bridge, Error};
use crate::interrupt;

pub(super) struct Terminal {
    adapter: Adapter,
    /// The adapter's end.
    end: File,
    /// The program's end, kept open so that programs may come and go.
    _other: File,
    /// What the link leads to.
    target: PathBuf,
    name: String,
    link: Option<PathBuf>,
    frames: VecDeque<Frame>,
    /// What the terminal had no room for.
    waiting: VecDeque<u8>,
}

/// Most bytes that wait for a program to read. What comes then is lost, as behind an adapter.
const WAITING: usize = 1 << 16;

impl Terminal {
    /// Makes a pseudo-terminal. Of the link to it, if one is wanted, this only finds out whether it can be made.
    pub(super) fn open(link: Option<&Path>) -> Result<Self, Error> {
        // Before there is a new terminal, which may get the name of the old one.
        if let Some(link) = link {
            remove_dead(link);
        }
        let (end, other, path) = pair().map_err(Error::Terminal)?;
        let target = way(&other, &path);
        if let Some(link) = link {
            make_link(&target, link)?;
            interrupt::remove_link(link);
        }
        let name = link.map_or_else(|| path.clone(), |link| link.display().to_string());
        Ok(Self {
            adapter: Adapter::new(),
            end,
            _other: other,
            target,
            name,
            link: link.map(Path::to_owned),
            frames: VecDeque::new(),
            waiting: VecDeque::new(),
        })
    }

    pub(super) fn name(&self) -> &str {
        &self.name
    }

    /// Writes what fits, and the rest later: whole lines or nothing.
    fn write(&mut self, line: &str) -> Result<(), Error> {
        if self.waiting.len() + line.len() <= WAITING {
            self.waiting.extend(line.bytes());
        }
        let bytes = self.waiting.make_contiguous();
        match self.end.write(bytes) {
            Ok(count) => {
                self.waiting.drain(..count);
                Ok(())
            }
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
            Err(error) => Err(Error::Terminal(error)),
        }
    }
}

/// Makes a link that an end of the run removes.
fn make_link(target: &Path, link: &Path) -> Result<(), Error> {
    let linked = symlink(target, link);
    linked.map_err(|error| Error::Link {
        link: link.into(),
        error,
    })?;
    interrupt::remove_when_interrupted(link, target);
    Ok(())
}

/// What a link leads to: on Linux the terminal by way of this process, so that the link of a killed run
/// leads nowhere, and not to the next terminal of that name.
fn way(other: &File, path: &str) -> PathBuf {
    let own = PathBuf::from(format!("/proc/{}/fd/{}", process::id(), other.as_raw_fd()));
    if own.exists() { own } else { path.into() }
}

/// Removes the link of a run that was killed: one to a terminal that is gone.
fn remove_dead(link: &Path) {
    let target = fs::read_link(link).unwrap_or_default();
    let is_own = target.starts_with("/proc") || target.starts_with("/dev/pts");
    if is_own && !link.exists() {
        // If this fails, the new link cannot be made, in a sentence.
        let _ = fs::remove_file(link);
    }
}

/// Both ends of a raw pseudo-terminal, the first one without waiting, and the path of the second.
fn pair() -> io::Result<(File, File, String)> {
    let end = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY)?;
    grantpt(&end)?;
    unlockpt(&end)?;
    let path = ptsname(&end, Vec::new())?;
    let path = path.into_string().map_err(io::Error::other)?;
    let other = OpenOptions::new().read(true).write(true).open(&path)?;
    let mut settings = tcgetattr(&other)?;
    settings.make_raw();
    tcsetattr(&other, OptionalActions::Now, &settings)?;
    fcntl_setfl(&end, fcntl_getfl(&end)? | OFlags::NONBLOCK)?;
    Ok((File::from(end), other, path))
}

impl Bridge for Terminal {
    fn begin(&mut self) -> Result<(), Error> {
        match &self.link {
            Some(link) => make_link(&self.target, link),
            None => Ok(()),
        }
    }

    fn give(&mut self, frame: &Frame, millis: u64) -> Result<(), Error> {
        match self.adapter.received(frame, millis) {
            Some(line) => self.write(&line),
            None => Ok(()),
        }
    }

    fn take(&mut self) -> Result<Option<Frame>, Error> {
        let mut bytes = [0; 256];
        let count = match self.end.read(&mut bytes) {
            Ok(count) => count,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => 0,
            Err(error) => return Err(Error::Terminal(error)),
        };
        for byte in bytes.iter().take(count) {
            let reaction = self.adapter.take(*byte);
            self.frames.extend(reaction.frame);
            self.write(reaction.answer)?;
        }
        Ok(self.frames.pop_front())
    }
}

impl Drop for Terminal {
    fn drop(&mut self) {
        if let Some(link) = &self.link {
            interrupt::remove_link(link);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Until the images are built nobody would be answered.
    #[test]
    fn the_link_is_there_while_the_bus_answers() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("bus");
        let mut terminal = Terminal::open(Some(&link)).unwrap();
        assert!(!link.is_symlink());
        assert!(matches!(terminal.take(), Ok(None)));
        terminal.begin().unwrap();
        assert!(link.exists());
        // Another run is told at once that the place is taken.
        assert!(matches!(
            Terminal::open(Some(&link)),
            Err(Error::Link { .. })
        ));
        drop(terminal);
        assert!(!link.is_symlink());
    }

    #[test]
    fn a_place_that_was_taken_meanwhile_is_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let link = folder.path().join("bus");
        let mut terminal = Terminal::open(Some(&link)).unwrap();
        fs::write(&link, "mine").unwrap();
        assert!(matches!(terminal.begin(), Err(Error::Link { .. })));
        drop(terminal);
        assert_eq!(fs::read_to_string(&link).unwrap(), "mine");
    }
}
