//! `monitor`: a bus against its schedule, as it happens or as a log tells it.

mod clock;
mod log;
mod source;
mod watch;

use std::{
    fs::{self, File},
    io::{IsTerminal, Write},
    path::{Path, PathBuf},
    time::Duration,
};

use can_bus::{SimTime, candump};
use world::report::rounded;

use crate::{
    Failure, Workspace,
    cli::Monitor,
    interrupt,
    selftest::{self, Bus, Received, Slcan, Transport, TransportError},
};
use clock::Clock;
pub use source::{NoSource, Source};
pub use watch::{Change, Class, NodeState, Picture, Watch, WindowState};

/// How often the picture is renewed.
const RENEWED: Duration = Duration::from_secs(1);

/// How soon an end by Ctrl-C is noticed.
const HEARD: Duration = Duration::from_millis(100);

/// Why the command fails.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The bus cannot be reached.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// The record cannot be written.
    #[error(
        "--record: {file} cannot be written: {error}; name a file that is not there yet, in a folder that can be written to"
    )]
    Record {
        /// The file.
        file: String,
        /// Why.
        #[source]
        error: std::io::Error,
    },
    /// No frame came.
    #[error(
        "{bus} was silent for {seconds:.1} s: is the network's bit rate right, and is a node powered?"
    )]
    Silent {
        /// The bus.
        bus: String,
        /// How long it was listened to, s.
        seconds: f64,
    },
}

impl Error {
    /// Whether the command line is wrong.
    pub(crate) fn is_usage(&self) -> bool {
        match self {
            Self::Transport(error) => error.is_usage(),
            Self::Record { .. } => true,
            Self::Silent { .. } => false,
        }
    }
}

/// Runs the command.
///
/// # Errors
///
/// There is no such vehicle, bus or log (exit code 2), or the bus is silent.
pub fn run(workspace: &Workspace, options: &Monitor) -> Result<(), Failure> {
    match &options.source {
        Source::Bus(bus) => run_on_bus(workspace, options, bus),
        Source::Log(file) => log::run(workspace, options, file),
    }
}

fn run_on_bus(workspace: &Workspace, options: &Monitor, bus: &Bus) -> Result<(), Failure> {
    let name = options.vehicle.as_deref();
    let vehicle = selftest::of_bus(workspace, name, bus, &options.set)?;
    let mut record = match &options.record {
        Some(file) => Some(Record::at(file)?),
        None => None,
    };
    let bit_rate = vehicle.network().bit_rate;
    // How late a busy computer reads a frame says nothing of the node.
    let adapter = Slcan::open_stamped;
    let mut transport = selftest::open(workspace, &vehicle, bus, bit_rate, adapter)?;
    let begin = transport.now();
    let end = options.seconds.map(|seconds| begin + seconds);
    let mut watch = Watch::new(&vehicle);
    let mut clock = Clock::default();
    let mut screen = Screen::new(options.json);
    let mut next = begin + RENEWED;
    let mut lost = None;
    interrupt::end_by_itself();
    while end.is_none_or(|end| transport.now() < end) && !interrupt::asked() {
        let soon = next.min(transport.now() + HEARD);
        let until = end.map_or(soon, |end| end.min(soon));
        // What was seen is printed even if the bus cannot be reached any more.
        match transport.receive(until) {
            Ok(Some(received)) => {
                let at = received.at - begin.min(received.at);
                clock.heard(at, transport.now().saturating_sub(begin));
                watch.take(at, &received.frame);
                lost = record
                    .as_mut()
                    .and_then(|record| record.add(&received).err());
            }
            Ok(None) => {}
            Err(error) => lost = Some(error.into()),
        }
        if lost.is_some() {
            break;
        }
        if transport.now() >= next {
            next += RENEWED;
            watch.judge(clock.now(transport.now().saturating_sub(begin)));
            screen.show(&picture(&watch, &clock, &*transport, begin));
        }
    }
    watch.judge(clock.now(transport.now().saturating_sub(begin)));
    let picture = picture(&watch, &clock, &*transport, begin);
    let watched = transport.now().saturating_sub(begin);
    if picture.frames == 0
        && let Some(error) = lost
    {
        return Err(error.into());
    }
    if options.json {
        println!("{}", picture.json());
    } else {
        screen.clear();
        print!("{}", picture.text());
    }
    if picture.frames == 0 {
        let bus = bus.to_string();
        let seconds = watched.as_secs_f64();
        return Err(Error::Silent { bus, seconds }.into());
    }
    lost.map_or(Ok(()), |error| Err(error.into()))
}

/// What is known now. Nodes and windows are judged by the clock of the time stamps.
fn picture(watch: &Watch, clock: &Clock, transport: &dyn Transport, begin: Duration) -> Picture {
    let watched = transport.now().saturating_sub(begin);
    let mut picture = watch.picture(clock.now(watched));
    picture.watched_seconds = rounded(watched.as_secs_f64(), 3);
    picture.pace = clock.pace().map(|pace| rounded(pace, 2));
    picture.unreadable_lines = transport.unreadable();
    picture
}

/// The picture on the standard error, renewed in place on a terminal, and a line in each second
/// elsewhere.
struct Screen {
    terminal: bool,
    lines: usize,
    quiet: bool,
}

impl Screen {
    fn new(quiet: bool) -> Self {
        Self {
            terminal: std::io::stderr().is_terminal(),
            lines: 0,
            quiet,
        }
    }

    fn show(&mut self, picture: &Picture) {
        if self.quiet && self.terminal {
            return;
        }
        if !self.terminal {
            eprintln!("{}", picture.line());
            return;
        }
        self.clear();
        let text = picture.text();
        self.lines = text.lines().count();
        eprint!("{text}");
    }

    /// Takes the last picture away.
    fn clear(&mut self) {
        if self.lines > 0 {
            // Up to the first line of it, and everything below is erased.
            eprint!("\x1b[{}A\x1b[J", self.lines);
            self.lines = 0;
        }
    }
}

/// The frames in a file, in the format of `candump -l`.
struct Record {
    /// `None` until a frame comes.
    file: Option<File>,
    path: PathBuf,
    /// Bytes of whole lines.
    whole: u64,
}

impl Record {
    fn at(path: &Path) -> Result<Self, Error> {
        let record = Self {
            file: None,
            path: path.to_owned(),
            whole: 0,
        };
        // What cannot be written is found out before the bus is opened.
        let made = File::create_new(path).and_then(|_| fs::remove_file(path));
        made.map_err(|error| record.failed(error))?;
        Ok(record)
    }

    fn failed(&self, error: std::io::Error) -> Error {
        Error::Record {
            file: self.path.display().to_string(),
            error,
        }
    }

    /// A line is written at once, so that nothing is lost when the command is interrupted.
    fn add(&mut self, received: &Received) -> Result<(), Error> {
        let nanos = u64::try_from(received.at.as_nanos()).unwrap_or(u64::MAX);
        let line = candump::Line {
            at: SimTime::from_ticks(nanos.saturating_mul(1000)),
            interface: "can0".into(),
            frame: received.frame,
        };
        let write = || {
            if self.file.is_none() {
                self.file = Some(File::create_new(&self.path)?);
            }
            let line = format!("{line}\n");
            let Some(file) = &mut self.file else {
                return Ok(());
            };
            let written = file.write_all(line.as_bytes());
            match written {
                Ok(()) => self.whole += line.len() as u64,
                // A file system that is full may have room for a part of it. If it cannot be taken away, the
                // error is told all the same.
                Err(_) => drop(file.set_len(self.whole)),
            }
            written
        };
        let written: std::io::Result<()> = { write }();
        written.map_err(|error| self.failed(error))
    }
}
