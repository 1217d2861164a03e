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
        _ => Error::Open {
            name: name.into(),
            error,
        },
    }
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

/// An adapter with its channel open. The channel is closed when this is dropped.
pub struct Slcan<L: Line> {
    line: L,
    name: String,
    decoder: Decoder,
    frames: VecDeque<Received>,
    /// Whether the adapter has not answered yet to the last frame to send.
    unanswered: bool,
    /// Whether an answer or a frame has come since the channel was closed.
    speaks: bool,
}

impl<L: Line> Slcan<L> {
    /// Sets the bit rate of an adapter and opens its channel. Errors name the port by `name`.
    ///
    /// # Errors
    /// The adapter refuses, something else than slcan comes from the port, or the port fails.
    pub fn open(line: L, name: &str, bit_rate: u32) -> Result<Self, Error> {
        let rate = slcan::bit_rate(bit_rate).ok_or_else(|| Error::BitRate {
            name: name.into(),
            bit_rate,
        })?;
        let mut adapter = Self {
            line,
            name: name.into(),
            decoder: Decoder::new(),
            frames: VecDeque::new(),
            unanswered: false,
            // Until the channel is closed anything may come.
            speaks: true,
        };
        // The end of any line that a former program has begun. A closed channel refuses to be
        // closed; whatever the adapter says to these does not matter.
        adapter.write("\r")?;
        adapter.write(slcan::CLOSE)?;
        let end = adapter.line.now() + ANSWER;
        while adapter.listen(end)?.is_some() {}
        adapter.frames.clear();
        adapter.speaks = false;
        adapter.command(&rate, "the bit rate")?;
        adapter.command(slcan::OPEN, "to open the channel")?;
        Ok(adapter)
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
        Error::Lost {
            name: self.name.clone(),
            error,
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
        let at = self.line.now();
        let mut answers = Vec::new();
        for byte in &bytes {
            match self.decoder.push(*byte) {
                Some(Answer::Frame { frame, .. }) => {
                    self.speaks = true;
                    self.frames.push_back(Received { at, frame });
                }
                Some(answer) => {
                    self.speaks |= !matches!(answer, Answer::Other(_));
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
