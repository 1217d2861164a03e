//! What a campaign has done so far, in a file, so that one that was interrupted can go on.
//!
//! The first line names the campaign and the part; each further one is the verdict of a sequence. A last
//! line that was cut off is dropped. At the end of each line is a check value of the heading and the line, so
//! that a file that was edited, or put together from others, is not taken for what was simulated.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::{self, BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::Path;

use crc::{CRC_64_XZ, Crc};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::attack::Tally;
use crate::options::Shard;
use crate::report::{Campaign, Verdict};

/// The first line.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Heading {
    campaign: Campaign,
    shard: Shard,
}

impl Heading {
    /// Whether the part has the sequence of this seed.
    fn has(&self, seed: u64) -> bool {
        let campaign = &self.campaign;
        self.shard.has(campaign.seed, campaign.sequences, seed)
    }
}

/// A further line.
#[derive(Debug, Serialize, Deserialize)]
struct Entry {
    verdict: Verdict,
    tally: Tally,
}

/// The file of a campaign that runs.
#[derive(Debug)]
pub struct Journal {
    lines: Lines,
}

/// A file of JSON lines that is written while something runs: a heading that says what runs, and an entry for
/// each part of it that is done.
#[derive(Debug)]
pub struct Lines {
    file: File,
    /// The heading, which the check values count in.
    heading: Vec<u8>,
}

/// What is between a line and its check value.
const BEFORE_CHECK: u8 = b'\t';

/// The check value of a line under a heading.
fn check(heading: &[u8], line: &[u8]) -> String {
    let crc = Crc::<u64>::new(&CRC_64_XZ);
    let mut digest = crc.digest();
    digest.update(heading);
    digest.update(line);
    format!("{:016x}", digest.finalize())
}

/// Why a journal cannot be used. Displays as a clause.
#[derive(Debug, thiserror::Error)]
pub enum JournalError {
    /// It cannot be read or written.
    #[error(transparent)]
    File(#[from] io::Error),
    /// It is that of something else.
    #[error("it is the journal of another campaign or experiment, or of other images")]
    Other,
    /// It is a device, a pipe or a folder.
    #[error("it is no regular file")]
    NoFile,
    /// A sequence is there twice, or is none of this part.
    #[error("line {line} has a sequence that is there already, or is none of this part")]
    Stray {
        /// Its number.
        line: usize,
    },
    /// Another process writes it.
    #[error("another run writes it")]
    InUse,
    /// A line is not as it was written.
    #[error("line {line} is not as it was written: its check value does not fit")]
    Changed {
        /// Its number.
        line: usize,
    },
    /// A line in its middle is none of a journal.
    #[error("line {line} is none of a journal")]
    Line {
        /// Its number.
        line: usize,
    },
}

impl Journal {
    /// Opens the journal at `path`, which may exist or not, and returns the verdicts in it.
    ///
    /// # Errors
    /// It belongs to another campaign or to a process that runs, or cannot be read or written.
    pub fn open(
        path: &Path,
        campaign: &Campaign,
        shard: Shard,
    ) -> Result<(Self, Vec<Verdict>), JournalError> {
        let heading = Heading {
            campaign: campaign.clone(),
            shard,
        };
        let (lines, entries) = Lines::open::<_, Entry>(path, &heading)?;
        let mut done = Vec::new();
        let mut seeds = BTreeSet::new();
        // The heading is the first line.
        for (line, entry) in (2..).zip(entries) {
            let seed = entry.verdict.seed;
            if !heading.has(seed) || !seeds.insert(seed) {
                return Err(JournalError::Stray { line });
            }
            done.push(Verdict {
                tally: entry.tally,
                ..entry.verdict
            });
        }
        Ok((Self { lines }, done))
    }

    /// Adds the verdict of a sequence. It is on the disk when this returns, as far as the system
    /// tells.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&mut self, verdict: &Verdict) -> io::Result<()> {
        self.lines.add(&Entry {
            verdict: verdict.clone(),
            tally: verdict.tally.clone(),
        })
    }
}

impl Lines {
    /// Opens the file at `path`, which may exist or not, and returns the entries in it.
    ///
    /// # Errors
    /// It has another heading, belongs to a process that runs, or cannot be read or written.
    pub fn open<H, E>(path: &Path, heading: &H) -> Result<(Self, Vec<E>), JournalError>
    where
        H: Serialize + DeserializeOwned + PartialEq,
        E: DeserializeOwned,
    {
        if std::fs::metadata(path).is_ok_and(|there| !there.is_file()) {
            return Err(JournalError::NoFile);
        }
        let mut options = OpenOptions::new();
        let mut file = options
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)?;
        file.try_lock().map_err(|error| match error {
            std::fs::TryLockError::WouldBlock => JournalError::InUse,
            std::fs::TryLockError::Error(error) => JournalError::File(error),
        })?;
        let own = serde_json::to_vec(heading).map_err(io::Error::from)?;
        let (entries, length) = read(&mut file, heading, &own)?;
        // What is behind the last whole line was cut off.
        file.set_len(length)?;
        file.seek(SeekFrom::End(0))?;
        let mut lines = Self { file, heading: own };
        if length == 0 {
            lines.add(heading)?;
        }
        Ok((lines, entries))
    }

    /// Adds an entry. It is on the disk when this returns, as far as the system tells.
    ///
    /// # Errors
    /// It cannot be written.
    pub fn add(&mut self, entry: &impl Serialize) -> io::Result<()> {
        let mut text = serde_json::to_vec(entry)?;
        let check = check(&self.heading, &text);
        text.push(BEFORE_CHECK);
        text.extend(check.bytes());
        text.push(b'\n');
        self.file.write_all(&text)
    }
}

/// The entries in a file, and the length of its whole lines. `own` is the heading as it is written.
fn read<H, E>(file: &mut File, heading: &H, own: &[u8]) -> Result<(Vec<E>, u64), JournalError>
where
    H: Serialize + DeserializeOwned + PartialEq,
    E: DeserializeOwned,
{
    let begin = own.split_inclusive(|byte| *byte == b':').next();
    let mut lines = BufReader::new(file);
    let mut entries = Vec::new();
    let mut length = 0;
    for line in 1.. {
        let mut text = Vec::new();
        lines.read_until(b'\n', &mut text)?;
        if text.last() != Some(&b'\n') {
            // A heading that was cut off begins as all do; anything else is somebody's file.
            let mut pairs = text.iter().zip(begin.unwrap_or_default());
            if line == 1 && !pairs.all(|(one, other)| one == other) {
                return Err(JournalError::Line { line });
            }
            break;
        }
        length += text.len() as u64;
        text.pop();
        let none = || JournalError::Line { line };
        let end = text.iter().rposition(|byte| *byte == BEFORE_CHECK);
        let (text, found) = text.split_at(end.ok_or_else(none)?);
        if line == 1 {
            let other: H = serde_json::from_slice(text).map_err(|_| none())?;
            if other != *heading {
                return Err(JournalError::Other);
            }
        }
        if found.get(1..) != Some(check(own, text).as_bytes()) {
            return Err(JournalError::Changed { line });
        }
        if line > 1 {
            entries.push(serde_json::from_slice(text).map_err(|_| none())?);
        }
    }
    Ok((entries, length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::Trouble;

    fn campaign(seed: u64) -> Campaign {
        Campaign {
            vehicle: "uagv".into(),
            set: Vec::new(),
            trouble: Trouble::Faults,
            sequences: 4,
            seed,
            images: std::collections::BTreeMap::new(),
        }
    }

    fn verdict(seed: u64) -> Verdict {
        Verdict {
            seed,
            story: vec!["a node is reset".into()],
            violations: Vec::new(),
            tally: Tally {
                flood_frames: seed,
                ..Tally::default()
            },
        }
    }

    #[test]
    fn a_journal_goes_on_behind_its_last_whole_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("faults.journal");
        let shard = Shard::default();
        let (mut journal, done) = Journal::open(&path, &campaign(1), shard).unwrap();
        assert_eq!(done, []);
        journal.add(&verdict(1)).unwrap();
        journal.add(&verdict(2)).unwrap();
        let error = Journal::open(&path, &campaign(1), shard).unwrap_err();
        assert!(matches!(error, JournalError::InUse), "{error}");
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        for cut in 1..60 {
            std::fs::write(&path, &whole[..whole.len() - cut]).unwrap();
            let (mut journal, done) = Journal::open(&path, &campaign(1), shard).unwrap();
            assert_eq!(done, [verdict(1)], "{cut}");
            journal.add(&verdict(2)).unwrap();
            assert_eq!(std::fs::read(&path).unwrap(), whole);
        }
        let (_, done) = Journal::open(&path, &campaign(1), shard).unwrap();
        assert_eq!(done, [verdict(1), verdict(2)]);
    }

    #[test]
    fn a_sequence_counts_once_and_only_in_its_part() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("faults.journal");
        let half = Shard { index: 1, of: 2 };
        for (shard, seeds, line) in [
            (Shard::default(), [2, 2], 3),
            (Shard::default(), [2, 5], 3),
            (half, [1, 2], 3),
        ] {
            let _ = std::fs::remove_file(&path);
            let (mut journal, _) = Journal::open(&path, &campaign(1), shard).unwrap();
            for seed in seeds {
                journal.add(&verdict(seed)).unwrap();
            }
            drop(journal);
            let error = Journal::open(&path, &campaign(1), shard).unwrap_err();
            assert!(
                matches!(error, JournalError::Stray { line: at } if at == line),
                "{error}"
            );
        }
    }

    #[test]
    fn a_line_that_was_changed_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("faults.journal");
        let shard = Shard::default();
        let written = |campaign: &Campaign| {
            let _ = std::fs::remove_file(&path);
            let (mut journal, _) = Journal::open(&path, campaign, shard).unwrap();
            journal.add(&verdict(2)).unwrap();
            journal.add(&verdict(3)).unwrap();
            std::fs::read_to_string(&path).unwrap()
        };
        let (whole, foreign) = (written(&campaign(1)), written(&campaign(2)));
        let mut lines: Vec<&str> = whole.lines().collect();
        lines[2] = foreign.lines().nth(2).unwrap();
        let mixed = lines.join("\n") + "\n";
        let edited = whole.replacen("\"flood_frames\":2", "\"flood_frames\":3", 1);
        for (text, at) in [(edited, 2), (mixed, 3)] {
            assert_ne!(text, whole);
            std::fs::write(&path, &text).unwrap();
            let error = Journal::open(&path, &campaign(1), shard).unwrap_err();
            assert!(
                matches!(error, JournalError::Changed { line } if line == at),
                "{error}"
            );
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
    }

    #[test]
    fn a_foreign_file_is_refused_and_left_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("faults.journal");
        let shard = Shard::default();
        drop(Journal::open(&path, &campaign(1), shard).unwrap());
        let kept = std::fs::read(&path).unwrap();
        let error = Journal::open(&path, &campaign(2), shard).unwrap_err();
        assert!(matches!(error, JournalError::Other), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), kept);
        for foreign in ["hello", "something\nelse\n"] {
            std::fs::write(&path, foreign).unwrap();
            let error = Journal::open(&path, &campaign(1), shard).unwrap_err();
            assert_eq!(error.to_string(), "line 1 is none of a journal");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), foreign);
        }
        let error = Journal::open(folder.path(), &campaign(1), shard).unwrap_err();
        assert!(matches!(error, JournalError::NoFile), "{error}");
        std::fs::write(&path, "something\nelse\n").unwrap();
        let error = Journal::open(&path, &campaign(1), shard).unwrap_err();
        assert_eq!(error.to_string(), "line 1 is none of a journal");
        assert_eq!(std::fs::read(&path).unwrap(), b"something\nelse\n");
    }
}
