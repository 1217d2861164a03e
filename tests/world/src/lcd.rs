//! The operator's display at the controller node.
//!
//! The thesis does not name the model (6.2.4.5): it only shows that the module answers every
//! command that it accepts with `0x55`. So the display is a trait, and [`LineDisplay`] the
//! simplest module that behaves as shown: a command is the text up to a carriage return.

use crate::syren::fits;
use crate::time::{SimDuration, SimTime, after, since};

/// The acknowledge byte (thesis 6.2.4.5, Figure 6.28).
pub const ACKNOWLEDGE: u8 = 0x55;

/// Baud rate of the display.
pub const BAUD: u32 = 115_200;

/// Longest command that the display buffers, in bytes.
const LONGEST: usize = 255;

/// A serial display.
pub trait Display {
    /// Takes a byte whose stop bit ended at `at`; returns when the display has executed the
    /// command that the byte completes and begins to acknowledge it.
    fn receive(&mut self, byte: u8, at: SimTime) -> Option<SimTime>;

    /// What the display shows: the commands executed last, newest last, one a line.
    fn text(&self) -> String;

    /// Commands executed.
    fn commands(&self) -> u64;
}

/// A display whose commands end with a carriage return.
#[derive(Clone, Debug)]
pub struct LineDisplay {
    acknowledges: bool,
    delay: SimDuration,
    line: Vec<u8>,
    overrun: bool,
    screen: Vec<String>,
    commands: u64,
}

/// Commands that the screen text keeps.
const KEPT: usize = 64;

impl LineDisplay {
    /// A blank display that executes a command in `delay`; with `acknowledges` false it never
    /// answers.
    #[must_use]
    pub fn new(acknowledges: bool, delay: SimDuration) -> Self {
        Self {
            acknowledges,
            delay,
            line: Vec::new(),
            overrun: false,
            screen: Vec::new(),
            commands: 0,
        }
    }
}

impl Display for LineDisplay {
    fn receive(&mut self, byte: u8, at: SimTime) -> Option<SimTime> {
        if byte != b'\r' {
            if self.line.len() < LONGEST {
                self.line.push(byte);
            } else {
                self.overrun = true;
            }
            return None;
        }
        let line = core::mem::take(&mut self.line);
        if core::mem::take(&mut self.overrun) {
            return None;
        }
        let text: String = line
            .iter()
            .filter(|byte| byte.is_ascii_graphic() || **byte == b' ')
            .map(|byte| char::from(*byte))
            .collect();
        if self.screen.len() == KEPT {
            self.screen.remove(0);
        }
        self.screen.push(text);
        self.commands += 1;
        self.acknowledges.then(|| after(at, self.delay))
    }

    fn text(&self) -> String {
        self.screen.join("\n")
    }

    fn commands(&self) -> u64 {
        self.commands
    }
}

/// Whether a byte between `start` and `end` has the display's baud rate.
#[must_use]
pub fn readable(start: SimTime, end: SimTime) -> bool {
    fits(since(end, start), BAUD)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn send(display: &mut LineDisplay, text: &[u8]) -> Vec<Option<SimTime>> {
        text.iter()
            .map(|byte| display.receive(*byte, SimTime::from_ticks(5)))
            .collect()
    }

    #[test]
    fn each_command_is_acknowledged_once() {
        let mut display = LineDisplay::new(true, SimDuration::from_ticks(7));
        let answers = send(&mut display, b"AB\rC\r");
        let answer = Some(SimTime::from_ticks(12));
        assert_eq!(answers, [None, None, answer, None, answer]);
        assert_eq!(display.text(), "AB\nC");
    }

    #[test]
    fn a_mute_display_still_shows() {
        let mut display = LineDisplay::new(false, SimDuration::from_ticks(0));
        assert!(send(&mut display, b"X\r").iter().all(Option::is_none));
        assert_eq!((display.text().as_str(), display.commands()), ("X", 1));
    }

    #[test]
    fn an_endless_command_is_dropped() {
        let mut display = LineDisplay::new(true, SimDuration::from_ticks(0));
        let mut text = vec![b'x'; LONGEST + 1];
        text.push(b'\r');
        assert!(send(&mut display, &text).iter().all(Option::is_none));
        assert_eq!(display.commands(), 0);
        assert!(send(&mut display, b"ok\r")[2].is_some());
    }
}
