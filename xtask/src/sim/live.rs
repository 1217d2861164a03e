//! A run that other programs take part in, as fast as time passes.

#[cfg(unix)]
mod terminal;

use std::{
    fmt,
    io::IsTerminal,
    path::PathBuf,
    str::FromStr,
    thread,
    time::{Duration, Instant},
};

use can_bus::{Frame, NodeId, Record, RecordKind, Retry, Tester};
use twin::Twin;
use world::{SimTime, time::seconds};

use super::{
    recording::NodeRecording,
    view::{Subject, View},
};
use crate::selftest::{Transport, TransportError, socketcan};

/// Where other programs reach the virtual bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Can {
    /// A pseudo-terminal that behaves as an adapter that speaks slcan, and a link to it.
    Slcan(Option<PathBuf>),
    /// A SocketCAN interface of Linux.
    SocketCan(String),
}

/// A text that names no way to the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("slcan, slcan:LINK or socketcan:INTERFACE is accepted")]
pub struct NoCan;

impl FromStr for Can {
    type Err = NoCan;

    fn from_str(text: &str) -> Result<Self, NoCan> {
        match text.split_once(':') {
            None if text == "slcan" => Ok(Self::Slcan(None)),
            Some(("slcan", link)) if !link.is_empty() => Ok(Self::Slcan(Some(link.into()))),
            Some(("socketcan", name)) if !name.is_empty() => Ok(Self::SocketCan(name.into())),
            _ => Err(NoCan),
        }
    }
}

impl fmt::Display for Can {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Slcan(None) => f.write_str("slcan"),
            Self::Slcan(Some(link)) => write!(f, "slcan:{}", link.display()),
            Self::SocketCan(name) => write!(f, "socketcan:{name}"),
        }
    }
}

/// Why nobody can take part.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The interface cannot be used.
    #[error(transparent)]
    Transport(#[from] TransportError),
    /// There is no pseudo-terminal.
    #[error("--can: no pseudo-terminal can be made: {0}")]
    Terminal(#[source] std::io::Error),
    /// The link to it cannot be made.
    #[error("--can: {} cannot be made: {error}; name a link that is not there yet", link.display())]
    Link {
        /// The link.
        link: PathBuf,
        /// Why.
        #[source]
        error: std::io::Error,
    },
    /// The view has nothing to draw on.
    #[error(
        "--watch draws on a terminal, and the standard output is none: leave it out, or let it be one"
    )]
    NoScreen,
    /// The terminal shows one line after another.
    #[error(
        "--watch draws all over the terminal, and TERM says that it is a dumb one: leave it out, or name the terminal that it is, such as TERM=xterm"
    )]
    Dumb,
    /// The terminal of the view fails.
    #[error("--watch: the terminal cannot be used: {0}")]
    Screen(#[source] std::io::Error),
    /// Nobody could keep to the windows of a bus without a pace.
    #[error(
        "--watch=max has no pace that programs at --can could keep up with: a speed from 0.001 to 100 is accepted"
    )]
    NoPace,
    /// The system has no pseudo-terminals.
    #[error("--can slcan needs a system with pseudo-terminals; socketcan:INTERFACE needs Linux")]
    NoTerminal,
}

/// A way to other programs.
trait Bridge {
    /// Shows other programs the way: from now on the bus answers.
    fn begin(&mut self) -> Result<(), Error> {
        Ok(())
    }

    /// Gives them a frame that was on the bus, which ended at this millisecond.
    fn give(&mut self, frame: &Frame, millis: u64) -> Result<(), Error>;

    /// The next frame that one of them sends.
    fn take(&mut self) -> Result<Option<Frame>, Error>;
}

/// An interface of the system: the frames of the virtual bus are sent there.
struct Interface(Box<dyn Transport>);

impl Bridge for Interface {
    fn give(&mut self, frame: &Frame, _: u64) -> Result<(), Error> {
        Ok(self.0.send(frame)?)
    }

    fn take(&mut self) -> Result<Option<Frame>, Error> {
        let received = self.0.receive(Duration::ZERO)?;
        Ok(received.map(|received| received.frame))
    }
}

/// Makes the bridge, and says how it is reached.
fn bridge(can: &Can, bit_rate: u32) -> Result<(Box<dyn Bridge>, String), Error> {
    match can {
        Can::SocketCan(name) => {
            let interface = Interface(socketcan(name, bit_rate)?);
            Ok((Box::new(interface), name.clone()))
        }
        #[cfg(unix)]
        Can::Slcan(link) => {
            let terminal = terminal::Terminal::open(link.as_deref())?;
            let name = terminal.name().to_owned();
            Ok((Box::new(terminal), name))
        }
        #[cfg(not(unix))]
        Can::Slcan(_) => Err(Error::NoTerminal),
    }
}

/// How fast simulated time passes.
#[derive(Clone, Debug)]
pub(super) struct Pace {
    /// Simulated seconds in a second; `None` runs as fast as it can.
    speed: Option<f64>,
    paused: bool,
    /// An instant, and the simulated time that belongs to it.
    anchor: Option<(Instant, SimTime)>,
    /// How far the simulation was behind at most.
    behind: Duration,
}

impl Pace {
    pub(super) fn new(speed: Option<f64>) -> Self {
        Self {
            speed,
            paused: false,
            anchor: None,
            behind: Duration::ZERO,
        }
    }

    pub(super) fn speed(&self) -> Option<f64> {
        self.speed
    }

    pub(super) fn is_paused(&self) -> bool {
        self.paused
    }

    /// Goes on at that speed, or pauses, from the simulated time `now` on. Time that has passed before does
    /// not count.
    pub(super) fn change(&mut self, now: SimTime, speed: Option<f64>, paused: bool) {
        self.speed = speed;
        self.paused = paused;
        self.anchor = Some((Instant::now(), now));
    }

    /// How long it is until the simulated time comes; zero if it has come.
    pub(super) fn early(&mut self, now: SimTime) -> Duration {
        let Some(speed) = self.speed else {
            return Duration::ZERO;
        };
        let (begin, from) = *self
            .anchor
            .get_or_insert_with(|| (Instant::now(), SimTime::from_ticks(0)));
        let due = Duration::from_secs_f64((seconds(now) - seconds(from)).max(0.0) / speed);
        let passed = begin.elapsed();
        self.behind = self.behind.max(passed.saturating_sub(due));
        due.saturating_sub(passed)
    }
}

/// A run at a pace, what joins it, and who looks at it.
pub(crate) struct Live {
    pace: Pace,
    bridge: Option<Box<dyn Bridge>>,
    /// How the bus is reached.
    name: String,
    /// Whether it was said that the simulation is behind.
    told: bool,
    /// The sender of what other programs send.
    tester: Option<NodeId>,
    bit_rate: u32,
    /// Records that were passed on.
    passed: usize,
    /// Frames of others that are not on the bus yet.
    waiting: usize,
    /// Whether somebody looks at the run.
    watched: bool,
    view: Option<View>,
}

impl Live {
    /// Opens the way to the bus, if one is wanted. It answers when the run begins.
    ///
    /// # Errors
    /// It cannot be opened.
    pub(crate) fn open(
        can: Option<&Can>,
        speed: Option<f64>,
        watched: bool,
        bit_rate: u32,
    ) -> Result<Self, Error> {
        if watched && !std::io::stdout().is_terminal() {
            return Err(Error::NoScreen);
        }
        if watched && std::env::var("TERM").is_ok_and(|term| term == "dumb") {
            return Err(Error::Dumb);
        }
        if can.is_some() && speed.is_none() {
            return Err(Error::NoPace);
        }
        let (bridge, name) = match can {
            None => (None, String::new()),
            Some(can) => {
                let (bridge, name) = bridge(can, bit_rate)?;
                (Some(bridge), name)
            }
        };
        Ok(Self {
            pace: Pace::new(speed),
            bridge,
            name,
            told: false,
            tester: None,
            bit_rate,
            passed: 0,
            waiting: 0,
            watched,
            view: None,
        })
    }

    /// Lets other programs find the bus, and says on the standard error where it is, from now on.
    ///
    /// # Errors
    /// Somebody has put something in the place of the link.
    pub(crate) fn announce(&mut self) -> Result<(), Error> {
        if let Some(bridge) = &mut self.bridge {
            bridge.begin()?;
            eprintln!("The virtual bus is at {}.", self.name);
        }
        Ok(())
    }

    /// How far the simulation has fallen behind, the first time that it has. Where the run is shown the pace is,
    /// too.
    pub(crate) fn falls_behind(&mut self) -> Option<Duration> {
        if self.told || self.is_shown() {
            return None;
        }
        let late = self.late();
        self.told = late.is_some();
        late
    }

    /// Begins to show the run, if somebody looks at it.
    ///
    /// # Errors
    /// The terminal cannot be used.
    pub(crate) fn show(&mut self, subject: Subject) -> Result<(), Error> {
        if self.watched {
            let view = View::open(subject, self.bridge.is_some());
            self.view = Some(view.map_err(Error::Screen)?);
        }
        Ok(())
    }

    /// Whether the terminal shows the run.
    pub(crate) fn is_shown(&self) -> bool {
        self.view.is_some()
    }

    /// Whether the user has ended the run.
    pub(crate) fn is_stopped(&self) -> bool {
        self.view.as_ref().is_some_and(View::is_stopped)
    }

    /// Gives the terminal back.
    pub(crate) fn hide(&mut self) {
        self.view = None;
    }

    /// Passes on what was on the bus since the last call and what others send, shows the run, and waits
    /// until the simulated time has come.
    ///
    /// # Errors
    /// The bus or the terminal cannot be reached any more.
    pub(crate) fn keep_up(
        &mut self,
        twin: &mut Twin,
        nodes: &[NodeRecording],
    ) -> Result<(), Error> {
        self.exchange(twin)?;
        match &mut self.view {
            Some(view) => view
                .attend(twin, nodes, &mut self.pace)
                .map_err(Error::Screen),
            None => {
                thread::sleep(self.pace.early(twin.now()));
                Ok(())
            }
        }
    }

    fn exchange(&mut self, twin: &mut Twin) -> Result<(), Error> {
        let Some(bridge) = &mut self.bridge else {
            return Ok(());
        };
        let tester = *self.tester.get_or_insert_with(|| {
            let tester = Tester::new().at_bit_rate(self.bit_rate);
            twin.network().bus().add_tester(tester)
        });
        let records = twin.records();
        for record in records.get(self.passed..).unwrap_or_default() {
            match on_bus(record) {
                Some(frame) if record.node != tester => bridge.give(&frame, millis(record.at))?,
                Some(_) => self.waiting = self.waiting.saturating_sub(1),
                None => {}
            }
        }
        self.passed = records.len();
        let now = twin.now();
        // What has no room waits in the terminal or the socket, as in front of a real adapter.
        while self.waiting < MAILBOXES
            && let Some(frame) = bridge.take()?
        {
            self.waiting += 1;
            let mut bus = twin.network().bus();
            bus.send_at(tester, now, frame, Retry::UntilSent);
        }
        Ok(())
    }

    /// How far the simulation fell behind, if frames of others may have come too late for their windows.
    pub(crate) fn late(&self) -> Option<Duration> {
        self.bridge.as_ref()?;
        (self.pace.behind > Duration::from_millis(5)).then_some(self.pace.behind)
    }
}

/// Frames of others that may wait for the bus.
const MAILBOXES: usize = 16;

/// The frame that a record says has been sent.
fn on_bus(record: &Record) -> Option<Frame> {
    match record.kind {
        RecordKind::FrameEnd { frame, .. } => Some(frame),
        _ => None,
    }
}

fn millis(at: SimTime) -> u64 {
    at.as_ticks() / 1_000_000_000
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pause_is_no_delay() {
        let mut pace = Pace::new(Some(10.0));
        let second = SimTime::from_ticks(1_000_000_000_000);
        let early = pace.early(second);
        assert!(early > Duration::from_millis(90) && early <= Duration::from_millis(100));
        pace.change(second, Some(2.0), false);
        let early = pace.early(SimTime::from_ticks(2_000_000_000_000));
        assert!(early > Duration::from_millis(490) && early <= Duration::from_millis(500));
        pace.change(second, None, true);
        assert!(pace.is_paused());
        assert_eq!(pace.early(second), Duration::ZERO);
        assert_eq!(pace.speed(), None);
        assert!(pace.behind < Duration::from_millis(50));
    }

    #[test]
    fn ways_to_the_bus_are_named() {
        for text in ["slcan", "slcan:target/bus", "socketcan:vcan0"] {
            assert_eq!(text.parse::<Can>().unwrap().to_string(), text);
        }
        for text in ["", "can0", "slcan:", "socketcan", "socketcan:", "udp:1"] {
            assert_eq!(text.parse::<Can>(), Err(NoCan), "{text}");
        }
    }
}
