//! A CAN adapter on a serial port that speaks slcan.

use std::{
    collections::VecDeque,
    io,
    time::{Duration, Instant},
};

use can_bus::{
    Frame,
    slcan::{self, Answer, Decoder},
};
use serial2::SerialPort;

use super::transport::{Error, Received, Transport};

/// How long an adapter has for its answer to a command. Some never answer.
const ANSWER: Duration = Duration::from_millis(200);

/// How often an adapter is asked to open its channel. No answer says what it answers: one that comes too late is
/// taken for that of a later command, and the first ones may be refusals.
const TRIES: u32 = 3;

/// Turns time stamps on and off. Not every adapter knows it, and it has to come before the channel is open.
const STAMPS_ON: &str = "Z1\r";
const STAMPS_OFF: &str = "Z0\r";

/// Time stamps count milliseconds up to this, and begin again.
const TURN: u64 = 60_000;

/// Says that a command is refused.
const BEL: u8 = 7;

/// How many bytes of a text are looked at, and how many characters of it are shown.
const TEXT: usize = 256;
const SHOWN: usize = 40;

/// A serial line and a clock. A test lets another clock run.
pub trait Line {
    /// Time since the beginning.
    fn now(&self) -> Duration;

    /// Writes all bytes.
    ///
    /// # Errors
    /// The port fails.
    fn write(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Reads what has come. If that is nothing, it waits for something, at most until `until`; 0
    /// says that nothing came.
    ///
    /// # Errors
    /// The port fails.
    fn read(&mut self, bytes: &mut [u8], until: Duration) -> io::Result<usize>;
}

/// A serial port and the clock of the system.
pub struct Port {
    port: SerialPort,
    begin: Instant,
}

impl Port {
    /// Takes a port.
    #[must_use]
    pub fn new(port: SerialPort) -> Self {
        Self {
            port,
            begin: Instant::now(),
        }
    }

    /// Opens the port of that name.
    pub(super) fn open(name: &str, baud: u32) -> Result<Self, Error> {
        let port = SerialPort::open(name, baud).map_err(|error| unopened(name, error))?;
        Ok(Self::new(port))
    }
}

/// Why a port cannot be opened.
fn unopened(name: &str, error: io::Error) -> Error {
    match error.kind() {
        io::ErrorKind::NotFound => Error::NoPort(name.into()),
        io::ErrorKind::PermissionDenied => Error::NoRight(name.into()),
        io::ErrorKind::WouldBlock | io::ErrorKind::ResourceBusy => Error::Busy(name.into()),
        _ => Error::Open {
            name: name.into(),
            error,
        },
    }
}

#[cfg(unix)]
fn is_unplugged(error: &io::Error) -> bool {
    matches!(
        error.raw_os_error(),
        Some(libc::EIO | libc::ENXIO | libc::ENODEV)
    )
}

#[cfg(not(unix))]
fn is_unplugged(_: &io::Error) -> bool {
    false
}

/// Whether a byte is in no line of slcan: these have letters and digits, and nothing between them.
fn is_foreign(byte: u8) -> bool {
    !byte.is_ascii_alphanumeric() && !matches!(byte, b'\r' | b'\n' | BEL)
}

impl Line for Port {
    fn now(&self) -> Duration {
        self.begin.elapsed()
    }

    fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.port.write_all(bytes)
    }

    fn read(&mut self, bytes: &mut [u8], until: Duration) -> io::Result<usize> {
        use io::ErrorKind::{Interrupted, TimedOut};
        loop {
            // Waits whole milliseconds, then looks again and again.
            let left = until.saturating_sub(self.now());
            self.port.set_read_timeout(left)?;
            match self.port.read(bytes) {
                Ok(0) => return Err(io::ErrorKind::UnexpectedEof.into()),
                Err(error) if error.kind() == Interrupted => {}
                Err(error) if error.kind() == TimedOut => {
                    if self.now() >= until {
                        return Ok(0);
                    }
                }
                result => return result,
            }
        }
    }
}

/// Reads the time stamps of an adapter: the first one counts as the time at which it was read, and from there
/// the adapter's clock goes on. The two clocks may drift apart; the bus of a simulation that is slower than
/// time does. What matters are the times between frames.
#[derive(Debug, Default)]
struct Stamps {
    /// The last stamp, and when it was read.
    last: Option<(u16, Duration)>,
    /// When that frame ended.
    at: Duration,
}

impl Stamps {
    /// When a frame ended that was read at `read`.
    fn ended(&mut self, stamp: u16, read: Duration) -> Duration {
        self.at = match self.last {
            Some((last, then)) => {
                let since = (TURN + u64::from(stamp) - u64::from(last) % TURN) % TURN;
                // Whole turns in which no frame came.
                let passed = u64::try_from((read - then).as_millis()).unwrap_or(u64::MAX);
                let turns = (passed.saturating_sub(since) + TURN / 2) / TURN;
                self.at + Duration::from_millis(since + turns * TURN)
            }
            None => read,
        };
        self.last = Some((stamp, read));
        self.at
    }
}

/// An adapter with its channel open. The channel is closed when this is dropped.
pub struct Slcan<L: Line> {
    line: L,
    name: String,
    decoder: Decoder,
    frames: VecDeque<Received>,
    /// Time stamps of the adapter, if they are wanted.
    stamps: Option<Stamps>,
    /// Whether the adapter has not answered yet to the last frame to send.
    unanswered: bool,
    /// Whether an answer or a frame has come since the channel was closed.
    speaks: bool,
    /// Lines since the channel was opened that say nothing in the protocol.
    unreadable: u64,
}

impl<L: Line> Slcan<L> {
    /// Sets the bit rate of an adapter and opens its channel. Errors name the port by `name`.
    ///
    /// # Errors
    /// The adapter refuses, something else than slcan comes from the port, or the port fails.
    pub fn open(line: L, name: &str, bit_rate: u32) -> Result<Self, Error> {
        Self::begin(line, name, bit_rate, None)
    }

    /// As [`Slcan::open`], with the time stamps of the adapter if it gives any: how late the computer reads a
    /// frame does not count then.
    ///
    /// # Errors
    /// As [`Slcan::open`].
    pub fn open_stamped(line: L, name: &str, bit_rate: u32) -> Result<Self, Error> {
        Self::begin(line, name, bit_rate, Some(Stamps::default()))
    }

    fn begin(line: L, name: &str, bit_rate: u32, stamps: Option<Stamps>) -> Result<Self, Error> {
        let rate = slcan::bit_rate(bit_rate).ok_or_else(|| Error::BitRate {
            name: name.into(),
            bit_rate,
        })?;
        let mut adapter = Self {
            line,
            name: name.into(),
            decoder: Decoder::new(),
            frames: VecDeque::new(),
            stamps,
            unanswered: false,
            // Until the channel is closed anything may come.
            speaks: true,
            unreadable: 0,
        };
        let mut quiet = ANSWER;
        for left in (0..TRIES).rev() {
            match adapter.ask(&rate, quiet) {
                Err(Error::Refused { .. }) if left > 0 => quiet *= 2,
                result => {
                    result?;
                    break;
                }
            }
        }
        if adapter.stamps.is_some() {
            // A frame that has waited since another program had the port is stamped with another time.
            adapter.frames.clear();
            adapter.stamps = Some(Stamps::default());
        }
        adapter.unreadable = 0;
        Ok(adapter)
    }

    /// Closes the channel, waits that long for what the adapter has still to say, and opens it.
    fn ask(&mut self, rate: &str, quiet: Duration) -> Result<(), Error> {
        // The end of any line that a former program has begun. A closed channel refuses to be
        // closed; whatever the adapter says to these does not matter.
        self.write("\r")?;
        self.write(slcan::CLOSE)?;
        let end = self.line.now() + quiet;
        while self.listen(end)?.is_some() {}
        self.frames.clear();
        self.speaks = false;
        self.command(rate, "the bit rate")?;
        if self.stamps.is_some() {
            match self.command(STAMPS_ON, "time stamps") {
                // Then the time counts at which a frame is read.
                Ok(()) | Err(Error::Refused { .. }) => {}
                Err(error) => return Err(error),
            }
        }
        self.command(slcan::OPEN, "to open the channel")
    }

    /// Whether an answer or a frame has come since the channel was closed. Some adapters acknowledge
    /// nothing.
    #[must_use]
    pub fn speaks(&self) -> bool {
        self.speaks
    }

    /// The serial line.
    pub fn line(&self) -> &L {
        &self.line
    }

    fn lost(&self, error: io::Error) -> Error {
        let name = self.name.clone();
        match error.kind() {
            io::ErrorKind::UnexpectedEof | io::ErrorKind::BrokenPipe => Error::Ended(name),
            // What a terminal says whose other end is closed, and a port whose adapter is unplugged.
            _ if is_unplugged(&error) => Error::Ended(name),
            _ => Error::Lost { name, error },
        }
    }

    fn refused(&self, what: &'static str) -> Error {
        Error::Refused {
            name: self.name.clone(),
            what,
        }
    }

    fn write(&mut self, text: &str) -> Result<(), Error> {
        let written = self.line.write(text.as_bytes());
        written.map_err(|error| self.lost(error))
    }

    /// Sends a command and waits for the answer.
    fn command(&mut self, text: &str, what: &'static str) -> Result<(), Error> {
        self.write(text)?;
        let end = self.line.now() + ANSWER;
        while let Some(answers) = self.listen(end)? {
            for answer in answers {
                match answer {
                    Answer::Done => return Ok(()),
                    Answer::Refused => return Err(self.refused(what)),
                    _ => {}
                }
            }
        }
        Ok(())
    }

    /// Reads bytes; none if nothing comes until `until`.
    fn read(&mut self, until: Duration) -> Result<Vec<u8>, Error> {
        let mut bytes = [0; TEXT];
        let read = self.line.read(&mut bytes, until);
        let count = read.map_err(|error| self.lost(error))?;
        Ok(bytes[..count].to_vec())
    }

    /// The error that shows a text. Reads the rest of the text first.
    fn not_slcan(&mut self, mut text: Vec<u8>) -> Error {
        let end = self.line.now() + ANSWER;
        while text.len() < TEXT {
            match self.read(end) {
                Ok(more) if !more.is_empty() => text.extend(more),
                _ => break,
            }
        }
        let lines = text.split(|byte| matches!(byte, b'\r' | b'\n'));
        let longest = lines.max_by_key(|line| line.len()).unwrap_or_default();
        let shown = &longest[..longest.len().min(SHOWN)];
        Error::NotSlcan {
            name: self.name.clone(),
            text: shown.escape_ascii().to_string(),
        }
    }

    /// Reads what the adapter says and stores the frames; `None` if it says nothing until `until`.
    /// The answers are returned without the frames.
    fn listen(&mut self, until: Duration) -> Result<Option<Vec<Answer>>, Error> {
        let bytes = self.read(until)?;
        if bytes.is_empty() {
            return Ok(None);
        }
        // An adapter that has spoken is one, even if a byte is disturbed.
        if !self.speaks && bytes.iter().copied().any(is_foreign) {
            return Err(self.not_slcan(bytes));
        }
        let read = self.line.now();
        let mut answers = Vec::new();
        for byte in &bytes {
            match self.decoder.push(*byte) {
                Some(Answer::Frame { frame, stamp }) => {
                    self.speaks = true;
                    let at = match (&mut self.stamps, stamp) {
                        (Some(stamps), Some(stamp)) => stamps.ended(stamp, read),
                        _ => read,
                    };
                    self.frames.push_back(Received { at, frame });
                }
                Some(answer) => {
                    let is_unreadable = matches!(answer, Answer::Other(_) | Answer::TooLong);
                    self.speaks |= !is_unreadable;
                    self.unreadable += u64::from(is_unreadable);
                    answers.push(answer);
                }
                None => {}
            }
        }
        Ok(Some(answers))
    }
}

impl<L: Line> Transport for Slcan<L> {
    fn now(&self) -> Duration {
        self.line.now()
    }

    fn unreadable(&self) -> u64 {
        self.unreadable
    }

    fn send(&mut self, frame: &Frame) -> Result<(), Error> {
        self.write(&slcan::encode(frame))?;
        self.unanswered = true;
        Ok(())
    }

    fn receive(&mut self, until: Duration) -> Result<Option<Received>, Error> {
        loop {
            if let Some(received) = self.frames.pop_front() {
                return Ok(Some(received));
            }
            // What is in the port by then waits for the next call.
            if self.line.now() >= until {
                return Ok(None);
            }
            let Some(answers) = self.listen(until)? else {
                return Ok(None);
            };
            for answer in answers {
                match answer {
                    Answer::Refused if self.unanswered => {
                        return Err(self.refused("to send a frame"));
                    }
                    Answer::Done | Answer::Taken => self.unanswered = false,
                    _ => {}
                }
            }
        }
    }
}

impl<L: Line> Drop for Slcan<L> {
    fn drop(&mut self) {
        // Nothing can be done about an adapter that is gone.
        let _ = self.line.write(slcan::CLOSE.as_bytes());
        if self.stamps.is_some() {
            // As other programs expect it.
            let _ = self.line.write(STAMPS_OFF.as_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What comes from a port when, and what was written to it.
    struct Script {
        now: Duration,
        comes: VecDeque<(Duration, String)>,
        written: String,
        refuses: bool,
    }

    impl Line for Script {
        fn now(&self) -> Duration {
            self.now
        }

        fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
            let text = String::from_utf8_lossy(bytes);
            self.written += &text;
            let refused = self.refuses && text == STAMPS_ON;
            let answer = if refused { "\x07" } else { "\r" };
            self.comes.push_front((self.now, answer.to_owned()));
            Ok(())
        }

        fn read(&mut self, bytes: &mut [u8], until: Duration) -> io::Result<usize> {
            match self.comes.pop_front_if(|(at, _)| *at <= until) {
                Some((at, text)) => {
                    self.now = self.now.max(at);
                    bytes[..text.len()].copy_from_slice(text.as_bytes());
                    Ok(text.len())
                }
                None => {
                    self.now = self.now.max(until);
                    Ok(0)
                }
            }
        }
    }

    /// Times of frames that end each 100 ms and are read `late` milliseconds later, from 1 s on.
    fn heard(late: &[u64], refuses: bool) -> (Vec<u64>, String) {
        let frames = late.iter().enumerate().map(|(number, late)| {
            let end = 100 * number as u64;
            let stamp = (59_950 + end) % TURN;
            (
                Duration::from_millis(1000 + end + late),
                format!("t12C0{stamp:04X}\r"),
            )
        });
        let script = Script {
            now: Duration::ZERO,
            comes: frames.collect(),
            written: String::new(),
            refuses,
        };
        let mut adapter = Slcan::open_stamped(script, "port", 250_000).unwrap();
        let mut times = Vec::new();
        while let Some(received) = adapter.receive(Duration::from_secs(100)).unwrap() {
            times.push(u64::try_from(received.at.as_millis()).unwrap());
        }
        let written = adapter.line().written.clone();
        (times, written)
    }

    #[test]
    fn a_late_computer_does_not_move_stamped_frames() {
        let (times, written) = heard(&[2, 2, 2, 95, 2, 60, 3], false);
        assert_eq!(times, [1002, 1102, 1202, 1302, 1402, 1502, 1602]);
        assert!(written.ends_with("\rC\rS5\rZ1\rO\r"), "{written:?}");
        // The first frame may be late as well: the times between frames are right.
        let (times, _) = heard(&[50, 2, 2, 80], false);
        assert_eq!(times, [1050, 1150, 1250, 1350]);
    }

    #[test]
    fn frames_that_waited_together_keep_their_distances() {
        let mut stamps = Stamps::default();
        let read = Duration::from_secs(2);
        let times = [100, 105, 205].map(|stamp| stamps.ended(stamp, read));
        let behind = times.map(|at| (at - read).as_millis());
        assert_eq!(behind, [0, 5, 105]);
        // A bus that runs at 0.6 of time, for two turns of the stamps.
        let mut stamps = Stamps::default();
        for number in 0_u64..1200 {
            let stamp = u16::try_from(number * 100 % TURN).unwrap();
            let at = stamps.ended(stamp, read + Duration::from_millis(number * 1000 / 6));
            assert_eq!(at, read + Duration::from_millis(number * 100));
        }
        // After two and a half minutes of silence.
        let mut stamps = Stamps::default();
        let first = stamps.ended(7, read);
        let at = stamps.ended(30_007, read + Duration::from_secs(150));
        assert_eq!(at - first, Duration::from_secs(150));
    }

    #[test]
    fn an_adapter_without_stamps_is_read_as_before() {
        let (times, written) = heard(&[2, 2], true);
        assert_eq!(times, [1002, 1102]);
        assert!(written.contains("Z1"), "{written:?}");
    }

    /// An adapter that is busy at first, and then answers all that it was told.
    struct Late {
        now: Duration,
        until: Duration,
        adapter: slcan::Adapter,
        told: VecDeque<u8>,
    }

    impl Line for Late {
        fn now(&self) -> Duration {
            self.now
        }

        fn write(&mut self, bytes: &[u8]) -> io::Result<()> {
            self.told.extend(bytes);
            Ok(())
        }

        fn read(&mut self, bytes: &mut [u8], until: Duration) -> io::Result<usize> {
            if until >= self.until {
                self.now = self.now.max(self.until);
                while let Some(byte) = self.told.pop_front() {
                    let answer = self.adapter.take(byte).answer;
                    if !answer.is_empty() {
                        bytes[..answer.len()].copy_from_slice(answer.as_bytes());
                        return Ok(answer.len());
                    }
                }
            }
            self.now = self.now.max(until);
            Ok(0)
        }
    }

    #[test]
    fn late_answers_are_no_refusals() {
        for millis in (0..2000).step_by(10) {
            for with_stamps in [false, true] {
                let line = Late {
                    now: Duration::ZERO,
                    until: Duration::from_millis(millis),
                    adapter: slcan::Adapter::new(),
                    told: VecDeque::new(),
                };
                let opened = if with_stamps {
                    Slcan::open_stamped(line, "port", 250_000)
                } else {
                    Slcan::open(line, "port", 250_000)
                };
                let mut opened = opened.unwrap_or_else(|error| panic!("{millis} ms: {error}"));
                opened.line.until = Duration::ZERO;
                let end = opened.now() + ANSWER;
                while opened.listen(end).unwrap().is_some() {}
                let frame = Frame::standard(0x12C, &[1]).unwrap();
                let line = opened.line.adapter.received(&frame, 0);
                assert!(line.is_some(), "{millis} ms: closed");
            }
        }
    }

    #[test]
    fn a_port_without_the_right_to_it_names_the_group() {
        let error = unopened("/dev/ttyACM0", io::ErrorKind::PermissionDenied.into());
        assert!(error.is_usage());
        assert_eq!(
            error.to_string(),
            "/dev/ttyACM0 may not be opened by this user: make the user a member of the port's \
             group, on Debian dialout, and log in again"
        );
    }
}
