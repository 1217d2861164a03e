//! What an experiment has done so far, in a file of its output folder, so that one that was interrupted can go on.

use std::{
    collections::BTreeMap,
    env,
    fmt::Debug,
    fs,
    path::{Path, PathBuf},
    time::UNIX_EPOCH,
};

use campaign::{JournalError, Lines, digests};
use crc::{CRC_64_XZ, Crc};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use twin::Images;
use vehicle_model::Vehicle;
use world::report::OutputFolder;

use super::Error;
use crate::{cli::Sim, interrupt};

/// The report of every experiment.
const REPORT: &str = "experiment.json";
/// The file with the runs that are done, until there is a report.
const JOURNAL: &str = "experiment.journal";
/// The same beside the report, from which it can be made again.
const DONE: &str = "experiment.runs";

/// What runs. A journal of anything else is refused.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Heading {
    experiment: String,
    vehicle: String,
    first_seed: u64,
    seeds: u64,
    /// Check value of all that is simulated beside the images: scenarios with the machine's numbers.
    scenarios: String,
    /// Of each set of images, the digest of each node's.
    images: Vec<BTreeMap<String, String>>,
    /// Size and time of this program, if its own code is what drives.
    program: Option<String>,
}

/// A run that is done.
#[derive(Serialize, Deserialize)]
struct Entry<T> {
    run: usize,
    result: T,
}

/// Where the files of an experiment are put.
pub(super) struct Place {
    folder: OutputFolder,
    journal: PathBuf,
    /// The runs of an experiment that is complete, as long as they are not known to be those of this one.
    done: Option<PathBuf>,
    /// Whether runs are kept: those without images take seconds.
    keeps: bool,
}

/// The file of an experiment that runs, and what it had when it was opened.
pub(super) struct Kept<T> {
    lines: Lines,
    journal: PathBuf,
    /// How many runs are in it.
    count: usize,
    /// The results of runs, by their numbers.
    pub(super) earlier: BTreeMap<usize, T>,
}

impl Place {
    /// The folder of `--out`, if it is given. It is prepared before anything takes time.
    ///
    /// # Errors
    /// It cannot be written, or has what an unfinished experiment has done.
    pub(super) fn of(options: &Sim) -> Result<Option<Self>, Error> {
        let Some(path) = options.out.as_deref() else {
            return Ok(None);
        };
        let journal = path.join(JOURNAL);
        if !options.resume && journal.exists() {
            return Err(Error::Unfinished { journal });
        }
        let done = path.join(DONE);
        let report = path.join(REPORT);
        let mut complete = None;
        if options.resume && !journal.exists() {
            if done.exists() {
                complete = Some(done);
            } else if report.exists() {
                return Err(Error::NoRuns { report });
            }
        }
        let keeps = !options.quick;
        if keeps {
            // The journal is to stay there when the experiment is interrupted. What keeps the folder from being
            // made is said below.
            let _ = fs::create_dir_all(path);
        }
        Ok(Some(Self {
            folder: OutputFolder::create(path)?,
            journal,
            done: complete,
            keeps,
        }))
    }

    /// Opens the file of the runs that are done; `None` if none is kept. `scenarios` is all that is simulated
    /// beside the images.
    ///
    /// # Errors
    /// It is that of something else, or cannot be read or written.
    pub(super) fn kept<T: DeserializeOwned>(
        &self,
        experiment: &str,
        options: &Sim,
        scenarios: &dyn Debug,
        images: &[(&Vehicle, &Images)],
    ) -> Result<Option<Kept<T>>, Error> {
        if !self.keeps {
            return Ok(None);
        }
        let check = Crc::<u64>::new(&CRC_64_XZ).checksum(format!("{scenarios:?}").as_bytes());
        let images = images
            .iter()
            .map(|(vehicle, images)| digests(vehicle, images));
        let images: Vec<_> = images.collect();
        let heading = Heading {
            experiment: experiment.to_owned(),
            vehicle: options.vehicle.clone(),
            first_seed: options.seed,
            seeds: options.seeds,
            scenarios: format!("{check:016x}"),
            program: images.is_empty().then(program).flatten(),
            images,
        };
        let (lines, earlier) = self.open(&heading).map_err(|why| match &self.done {
            Some(done) => {
                // The copy of a complete experiment's runs is no unfinished one's.
                let _ = fs::remove_file(&self.journal);
                broken(done, why)
            }
            None => broken(&self.journal, why),
        })?;
        if !earlier.is_empty() {
            eprintln!("{} runs were done before.", earlier.len());
        }
        let kept = Kept {
            lines,
            journal: self.journal.clone(),
            count: earlier.len(),
            earlier,
        };
        kept.say();
        Ok(Some(kept))
    }

    /// Opens the journal, or a copy of the runs of a complete experiment as the journal, and returns the results
    /// in it by the numbers of their runs.
    fn open<T: DeserializeOwned>(
        &self,
        heading: &Heading,
    ) -> Result<(Lines, BTreeMap<usize, T>), JournalError> {
        if let Some(done) = &self.done {
            fs::copy(done, &self.journal)?;
        }
        let (lines, entries) = Lines::open::<_, Entry<T>>(&self.journal, heading)?;
        let mut earlier = BTreeMap::new();
        for (line, entry) in (2..).zip(entries) {
            if earlier.insert(entry.run, entry.result).is_some() {
                return Err(JournalError::Stray { line });
            }
        }
        Ok((lines, earlier))
    }

    /// Writes the files in place of the journal.
    ///
    /// # Errors
    /// One cannot be written.
    pub(super) fn finish(mut self, files: &[(&str, &str)]) -> Result<(), Error> {
        for (name, text) in files {
            self.folder.write(name, text.as_bytes())?;
        }
        let path = self.folder.finish()?;
        interrupt::say_when_interrupted(None);
        if self.keeps {
            // A journal that stays is refused the next time, in a sentence.
            let _ = fs::rename(&self.journal, self.journal.with_file_name(DONE));
        }
        let names: Vec<&str> = files.iter().map(|(name, _)| *name).collect();
        let names = match names.split_last() {
            Some((last, [])) => (*last).to_owned(),
            Some((last, first)) => format!("{} and {last}", first.join(", ")),
            None => String::new(),
        };
        eprintln!("Wrote {names} to {}.", path.display());
        Ok(())
    }
}

/// Size and time of this program.
fn program() -> Option<String> {
    let about = fs::metadata(env::current_exe().ok()?).ok()?;
    let time = about.modified().ok()?.duration_since(UNIX_EPOCH).ok()?;
    Some(format!("{}-{}", about.len(), time.as_nanos()))
}

fn broken(journal: &Path, why: JournalError) -> Error {
    Error::Journal {
        journal: journal.into(),
        why,
    }
}

impl<T> Kept<T> {
    /// Says when the experiment is interrupted what of it is kept.
    fn say(&self) {
        let journal = self.journal.display();
        interrupt::say_when_interrupted(Some(match self.count {
            0 => "no run was done yet, and --resume begins with the first".to_owned(),
            1 => format!("1 run is kept in {journal}: --resume goes on with it"),
            count => format!("{count} runs are kept in {journal}: --resume goes on with them"),
        }));
    }
}

impl<T: Serialize + DeserializeOwned + PartialEq> Kept<T> {
    /// Adds the result of a run.
    ///
    /// # Errors
    /// It cannot be written.
    pub(super) fn add(&mut self, run: usize, result: &T) -> Result<(), Error> {
        let failed = |error| broken(&self.journal, JournalError::File(error));
        let text = serde_json::to_vec(result).map_err(|error| failed(error.into()))?;
        // JSON has no infinity: such a run is done again, rather than told otherwise.
        match serde_json::from_slice::<T>(&text) {
            Ok(read) if read == *result => {
                let entry = Entry { run, result };
                self.lines.add(&entry).map_err(failed)?;
                self.count += 1;
                self.say();
                Ok(())
            }
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers come back as they were; a result that would not is left out.
    #[test]
    fn results_are_kept_to_the_last_bit() {
        let folder = tempfile::tempdir().unwrap();
        let journal = folder.path().join(JOURNAL);
        let mut bits = 1_u64;
        let mut numbers: Vec<f64> = Vec::new();
        while numbers.len() < 2000 {
            bits = bits.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            numbers.extend(Some(f64::from_bits(bits)).filter(|number| number.is_finite()));
        }
        let (lines, _) = Lines::open::<_, Entry<Vec<f64>>>(&journal, &1).unwrap();
        let mut kept = Kept {
            lines,
            journal: journal.clone(),
            count: 0,
            earlier: BTreeMap::new(),
        };
        kept.add(3, &numbers).unwrap();
        kept.add(4, &vec![f64::INFINITY]).unwrap();
        drop(kept);
        let (_, entries) = Lines::open::<_, Entry<Vec<f64>>>(&journal, &1).unwrap();
        assert_eq!(entries.len(), 1);
        assert_eq!((entries[0].run, &entries[0].result), (3, &numbers));
    }
}
