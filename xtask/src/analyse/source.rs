//! The logs themselves: a first reading that surveys them, a second one that hands over the frames
//! of the vehicle's bus.

use std::{
    collections::BTreeMap,
    fs::{self, File},
    io::{BufRead, BufReader, Read},
    path::{Path, PathBuf},
};

use can_bus::{
    Frame,
    log::{Item, LogTime, Reader, Skip, mcap},
};

use crate::{Failure, progress::Display};

/// The formats, for those whose log has none of them.
pub(super) const ACCEPTED: &str = "candump (-l, -L, or its screen with time stamps), Vector ASC, Kvaser's CanKing text and Memorator text or CSV, and MCAP are accepted";

/// Size of the pieces in which a log is read, bytes.
const PIECE: usize = 1 << 16;

/// A log as the survey found it.
#[derive(Debug)]
pub(super) struct Log {
    pub(super) path: PathBuf,
    /// The name of its format.
    pub(super) format: &'static str,
    /// Bytes at the time of the survey. A log that still grows is read no further.
    bytes: u64,
    /// Time stamps of its first and last frame.
    span: Option<(LogTime, LogTime)>,
    pub(super) frames: u64,
    /// Names of its interfaces, in the order of their first lines.
    channels: Vec<String>,
}

/// An interface and its frames.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Interface {
    pub(super) frames: u64,
    /// Frames with an identifier of the vehicle's network.
    known: u64,
}

/// Result of the first reading.
#[derive(Debug)]
pub(super) struct Survey {
    pub(super) logs: Vec<Log>,
    pub(super) interfaces: BTreeMap<String, Interface>,
    /// The interface of the vehicle's bus.
    pub(super) interface: String,
    pub(super) skipped: BTreeMap<Skip, u64>,
    /// Time stamp of the first frame.
    pub(super) start: LogTime,
    /// How far a time stamp may be beside the truth because the logger counts milliseconds, ns: 0 if it does
    /// not.
    pub(super) tolerance: i64,
}

/// Counters of the first reading.
#[derive(Default)]
struct Counts {
    interfaces: BTreeMap<String, Interface>,
    skipped: BTreeMap<Skip, u64>,
    /// The last stamp; how many were whole milliseconds behind the one before; and how many had one before.
    last: Option<LogTime>,
    whole: u64,
    pairs: u64,
}

/// A millisecond, ns.
const MILLISECOND: u64 = 1_000_000;
/// Fewest stamps that tell of a logger that counts milliseconds, of which most others are whole ones behind
/// the one before: now and then such a logger corrects its clock.
const NO_CHANCE: u64 = 20;

impl Counts {
    fn stamp(&mut self, at: LogTime) {
        if let Some(last) = self.last.replace(at) {
            self.pairs += 1;
            let distance = at.as_ticks().abs_diff(last.as_ticks());
            self.whole += u64::from(distance.is_multiple_of(MILLISECOND));
        }
    }

    fn are_coarse(&self) -> bool {
        self.pairs >= NO_CHANCE && self.whole >= self.pairs / 10 * 9
    }
}

/// Reads the logs for the first time. `known` tells the frames of the vehicle's network; without a
/// wanted interface, the one with most of them is the vehicle's bus.
///
/// # Errors
/// [`Failure::Usage`]: a log cannot be read or has no known format, there is no frame, the wanted
/// interface does not exist, or the logs are not in order of time.
pub(super) fn survey(
    paths: &[PathBuf],
    known: &dyn Fn(&Frame) -> bool,
    wanted: Option<&str>,
    display: &mut Display,
) -> Result<Survey, Failure> {
    let mut counts = Counts::default();
    let mut logs = Vec::new();
    for path in paths {
        logs.push(one(path, known, &mut counts, display)?);
    }
    let start = in_order(&logs)?;
    let is_coarse = counts.are_coarse();
    let Counts {
        interfaces,
        skipped,
        ..
    } = counts;
    let best = interfaces
        .iter()
        .rev()
        .max_by_key(|(_, one)| (one.known, one.frames));
    let interface = match (wanted, best) {
        (Some(name), _) if interfaces.contains_key(name) => name.to_owned(),
        (Some(name), _) => {
            let names: Vec<&str> = interfaces.keys().map(String::as_str).collect();
            return Err(Failure::Usage(format!(
                "no frame is of interface {name:?}: {} is accepted",
                names.join(" or ")
            )));
        }
        (None, Some((name, _))) => name.clone(),
        (None, None) => String::new(),
    };
    Ok(Survey {
        logs,
        interfaces,
        interface,
        skipped,
        start,
        tolerance: if is_coarse { MILLISECOND as i64 } else { 0 },
    })
}

/// Longest time between two frames, ns: 73 years. Differences of such times do not overflow.
const LONGEST: i128 = 1 << 61;

/// From one time stamp to another one, ns.
fn since(start: LogTime, at: LogTime) -> i64 {
    let difference = i128::from(at.as_ticks()) - i128::from(start.as_ticks());
    difference.clamp(-LONGEST, LONGEST) as i64
}

/// The time stamp of the first frame, if the logs are in order of time.
fn in_order(logs: &[Log]) -> Result<LogTime, Failure> {
    let mut with_frames = logs.iter().filter_map(|log| Some((log, log.span?)));
    let Some((mut before, (start, mut end))) = with_frames.next() else {
        let path = logs.first().map(|log| log.path.display().to_string());
        return Err(Failure::Usage(format!(
            "{}: there is no frame of classical CAN, so there is nothing to analyse",
            path.unwrap_or_default()
        )));
    };
    for (log, span) in with_frames {
        if span.0 < end {
            return Err(Failure::Usage(format!(
                "{} begins before {} ends: name the logs of one drive in order of time",
                log.path.display(),
                before.path.display()
            )));
        }
        (before, end) = (log, span.1);
    }
    Ok(start)
}

fn one(
    path: &Path,
    known: &dyn Fn(&Frame) -> bool,
    counts: &mut Counts,
    display: &mut Display,
) -> Result<Log, Failure> {
    let usage = |what: String| Failure::Usage(format!("{}: {what}", path.display()));
    let unreadable = |error| usage(format!("it cannot be read: {error}"));
    // Before it is opened: that of a pipe waits for its writer.
    let about = fs::metadata(path).map_err(unreadable)?;
    if about.is_dir() {
        return Err(usage(
            "it is a folder: the file of a log is accepted".into(),
        ));
    }
    if about.is_file() && about.len() == 0 {
        return Err(usage("it is empty: a log has frames".into()));
    }
    if !about.is_file() {
        return Err(usage(
            "it is not a regular file: a log is read twice, so a pipe is not accepted".into(),
        ));
    }
    let bytes = about.len();
    let mut channels: Vec<Interface> = Vec::new();
    let mut span: Option<(LogTime, LogTime)> = None;
    let mut frames = 0;
    let mut take = |item| match item {
        Item::Frame(entry) => {
            frames += 1;
            counts.stamp(entry.at);
            let index = usize::from(entry.channel);
            if channels.len() <= index {
                channels.resize(index + 1, Interface::default());
            }
            channels[index].frames += 1;
            channels[index].known += u64::from(known(&entry.frame));
            let first = span.map_or(entry.at, |(first, _)| first);
            span = Some((first, entry.at));
        }
        Item::Skipped(skip) => *counts.skipped.entry(skip).or_default() += 1,
        Item::Nothing => {}
    };
    let (format, names) = read(path, bytes, "surveyed", display, &mut take)?;
    for (name, found) in names.iter().zip(channels) {
        let all = counts.interfaces.entry(name.clone()).or_default();
        all.frames += found.frames;
        all.known += found.known;
    }
    Ok(Log {
        path: path.into(),
        format,
        bytes,
        span,
        frames,
        channels: names,
    })
}

/// Reads a log up to a size. Returns the name of its format and those of its interfaces.
fn read(
    path: &Path,
    bytes: u64,
    what: &str,
    display: &mut Display,
    each: &mut dyn FnMut(Item),
) -> Result<(&'static str, Vec<String>), Failure> {
    let usage = |why: String| Failure::Usage(format!("{}: {why}", path.display()));
    let unreadable = |error| usage(format!("it cannot be read: {error}"));
    let file = File::open(path).map_err(unreadable)?;
    let mut input = BufReader::with_capacity(PIECE, file.take(bytes));
    let is_mcap = input
        .fill_buf()
        .map_err(unreadable)?
        .starts_with(mcap::MAGIC);
    let mut count = 0_u64;
    let unit = if is_mcap { "frames" } else { "lines" };
    let mut counted = |item| {
        count += 1;
        if count.is_multiple_of(1 << 16) {
            display.show(|_| format!("{count} {unit} {what}"));
        }
        each(item);
    };
    if is_mcap {
        let mut reader = mcap::Reader::default();
        reader
            .read(&mut input, &mut counted)
            .map_err(|error| usage(error.to_string()))?;
        return Ok((mcap::NAME, reader.topics().to_vec()));
    }
    let mut reader = Reader::new();
    reader.read(&mut input, &mut counted).map_err(unreadable)?;
    let format = reader.format();
    let format = format.ok_or_else(|| usage(format!("no line is one of a log: {ACCEPTED}")))?;
    Ok((format.name(), reader.channels().to_vec()))
}

impl Survey {
    /// Reads the logs again and hands over the frames of the vehicle's bus, with their times in
    /// nanoseconds from the first frame.
    ///
    /// # Errors
    /// A log cannot be read any more.
    pub(super) fn replay(
        &self,
        display: &mut Display,
        each: &mut dyn FnMut(i64, &Frame),
    ) -> Result<(), Failure> {
        for log in &self.logs {
            // A second reading numbers the interfaces as the first one did.
            let own = log.channels.iter().position(|name| *name == self.interface);
            let mut take = |item| {
                if let Item::Frame(entry) = item
                    && Some(usize::from(entry.channel)) == own
                {
                    each(since(self.start, entry.at), &entry.frame);
                }
            };
            read(&log.path, log.bytes, "analysed", display, &mut take)?;
        }
        Ok(())
    }
}
