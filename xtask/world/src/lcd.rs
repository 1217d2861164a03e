//! The operator's display at the controller node: Matrix Orbital's LK204-7T-1U.
//!
//! It is a display of 20 characters in 4 rows with three lamps. [`Lk204`] knows the commands that
//! the controller's firmware uses and takes every other byte for an error, also text beyond the end
//! of a row, which ends up elsewhere or nowhere. It has a buffer of 80 bytes, the size that the
//! maker's manuals of sister models tell, and loses what comes while that is full.
//!
//! `firmware::display` tells which facts its maker's manual confirms.

use std::collections::VecDeque;

use crate::syren::fits;
use crate::time::{SimDuration, SimTime, after, since};

/// Baud rate of the display as it is delivered.
pub const BAUD: u32 = 19_200;

/// Rows of the screen.
const ROWS: usize = 4;
/// Characters in a row.
const COLUMNS: usize = 20;
/// General purpose outputs, two for each lamp.
const OUTPUTS: usize = 6;
/// Bytes that wait for their execution.
const BUFFER: usize = 80;

/// Begins every command.
const PREFIX: u8 = 254;
/// The display's answer to "read module type".
pub const MODULE_TYPE: u8 = 0x2B;

/// A byte that the display sends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Answer {
    /// When the display has executed the command and begins to send.
    pub at: SimTime,
    /// The byte.
    pub byte: u8,
}

/// A serial display.
pub trait Display {
    /// Processes a byte whose stop bit ended at `at`, and returns what the display answers.
    fn receive(&mut self, byte: u8, at: SimTime) -> Option<Answer>;

    /// The text on the display, row by row.
    fn text(&self) -> String;

    /// Commands executed.
    fn executed(&self) -> u64;

    /// Bytes and commands that the display did not understand, or had no room for.
    fn refused(&self) -> u64;

    /// Another display in the same state.
    fn copy(&self) -> Box<dyn Display + Send>;
}

/// Matrix Orbital's LK204-7T-1U.
#[derive(Clone, Debug)]
pub struct Lk204 {
    answers: bool,
    /// Time to execute a byte.
    delay: SimDuration,
    /// When each byte in the buffer will be executed.
    waiting: VecDeque<SimTime>,
    command: Vec<u8>,
    rows: [[u8; COLUMNS]; ROWS],
    /// Column and row, from 0.
    cursor: (usize, usize),
    wraps: bool,
    scrolls: bool,
    outputs: [bool; OUTPUTS],
    executed: u64,
    refused: u64,
}

impl Lk204 {
    /// A display that has just got its supply and executes a byte in `delay`. With `answers` false
    /// it never sends anything.
    #[must_use]
    pub fn new(answers: bool, delay: SimDuration) -> Self {
        Self {
            answers,
            delay,
            waiting: VecDeque::new(),
            command: Vec::new(),
            rows: [[b' '; COLUMNS]; ROWS],
            cursor: (0, 0),
            wraps: true,
            scrolls: true,
            outputs: [false; OUTPUTS],
            executed: 0,
            refused: 0,
        }
    }

    /// When a byte that arrives at `at` is executed; `None` if the buffer is full.
    fn execution(&mut self, at: SimTime) -> Option<SimTime> {
        while self.waiting.front().is_some_and(|done| *done <= at) {
            self.waiting.pop_front();
        }
        if self.waiting.len() >= BUFFER {
            return None;
        }
        let begin = self.waiting.back().map_or(at, |last| *last);
        let done = after(begin, self.delay);
        self.waiting.push_back(done);
        Some(done)
    }

    /// A character of text.
    fn print(&mut self, byte: u8) {
        let (column, row) = self.cursor;
        // With line wrap or scrolling, text ends up where the firmware does not expect it.
        let fits = column < COLUMNS && !self.wraps && !self.scrolls;
        if fits && (b' '..=b'~').contains(&byte) {
            self.rows[row][column] = byte;
            self.cursor.0 += 1;
        } else {
            self.refused += 1;
        }
    }

    /// Executes the command if it is complete. The result is what it answers, if it does.
    fn command(&mut self) -> Option<u8> {
        let index = |value: u8, most: usize| {
            usize::from(value)
                .checked_sub(1)
                .filter(|index| *index < most)
        };
        let mut answer = None;
        let known = match self.command[..] {
            [PREFIX] | [PREFIX, 71 | 86 | 87] | [PREFIX, 71, _] => return None,
            [PREFIX, 68] => {
                self.wraps = false;
                true
            }
            [PREFIX, 82] => {
                self.scrolls = false;
                true
            }
            // Auto transmit of key presses off: nobody presses any.
            [PREFIX, 79] => true,
            [PREFIX, 71, column, row] => {
                let place = index(column, COLUMNS).zip(index(row, ROWS));
                self.cursor = place.unwrap_or(self.cursor);
                place.is_some()
            }
            [PREFIX, what @ (86 | 87), output] => {
                let output = index(output, OUTPUTS);
                if let Some(output) = output {
                    self.outputs[output] = what == 87;
                }
                output.is_some()
            }
            [PREFIX, 55] => {
                answer = Some(MODULE_TYPE);
                true
            }
            _ => false,
        };
        self.command.clear();
        if known {
            self.executed += 1;
        } else {
            self.refused += 1;
        }
        answer
    }

    /// The colour of a lamp.
    fn lamp(&self, lamp: usize) -> &'static str {
        match (self.outputs[2 * lamp], self.outputs[2 * lamp + 1]) {
            (false, false) => "yellow",
            (false, true) => "green",
            (true, false) => "red",
            (true, true) => "off",
        }
    }
}

impl Display for Lk204 {
    fn receive(&mut self, byte: u8, at: SimTime) -> Option<Answer> {
        let Some(done) = self.execution(at) else {
            self.refused += 1;
            return None;
        };
        if self.command.is_empty() && byte != PREFIX {
            self.print(byte);
            return None;
        }
        self.command.push(byte);
        let byte = self.command()?;
        self.answers.then_some(Answer { at: done, byte })
    }

    /// Four rows of text, and one with the colours of the lamps.
    fn text(&self) -> String {
        let mut text = String::new();
        for row in &self.rows {
            text.push_str(String::from_utf8_lossy(row).trim_end());
            text.push('\n');
        }
        text + &[0, 1, 2].map(|lamp| self.lamp(lamp)).join(" ") + "\n"
    }

    fn executed(&self) -> u64 {
        self.executed
    }

    fn refused(&self) -> u64 {
        self.refused
    }

    fn copy(&self) -> Box<dyn Display + Send> {
        Box::new(self.clone())
    }
}

/// True if a byte from `start` to `end` has the display's baud rate.
#[must_use]
pub fn readable(start: SimTime, end: SimTime) -> bool {
    fits(since(end, start), BAUD)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sends bytes, one each 500 us, to a display that takes 100 us for each, and returns its
    /// answers.
    fn send(display: &mut Lk204, bytes: &[u8]) -> Vec<Answer> {
        let at = |index: usize| SimTime::from_ticks(500_000_000 * (index as u64 + 1));
        let bytes = bytes.iter().enumerate();
        bytes
            .filter_map(|(index, byte)| display.receive(*byte, at(index)))
            .collect()
    }

    fn display(answers: bool) -> Lk204 {
        let mut display = Lk204::new(answers, SimDuration::from_ticks(100_000_000));
        assert!(send(&mut display, &[254, 82, 254, 68, 254, 79]).is_empty());
        assert_eq!((display.executed(), display.refused()), (3, 0));
        display.waiting.clear();
        display
    }

    #[test]
    fn text_goes_to_its_row_and_lamps_have_colours() {
        let mut display = display(true);
        let answers = send(&mut display, b"\xFEG\x01\x02abc\xFEG\x14\x04z");
        assert!(answers.is_empty());
        send(
            &mut display,
            &[254, 86, 1, 254, 87, 2, 254, 87, 3, 254, 86, 4],
        );
        assert_eq!(
            display.text(),
            format!("\nabc\n\n{}z\ngreen red yellow\n", " ".repeat(19))
        );
        assert_eq!(display.refused(), 0);
    }

    #[test]
    fn the_module_type_is_the_only_answer() {
        let answers = send(&mut display(true), &[254, 55]);
        let at = SimTime::from_ticks(1_100_000_000);
        assert_eq!(answers, [Answer { at, byte: 0x2B }]);
        assert!(send(&mut display(false), &[254, 55]).is_empty());
    }

    #[test]
    fn what_the_display_does_not_know_is_an_error() {
        for wrong in [
            &[254, 1][..],
            &[254, 71, 0, 1],
            &[254, 71, 21, 1],
            &[254, 71, 1, 5],
            &[254, 87, 0],
            &[254, 86, 7],
            b"\r",
            &[0xFF],
        ] {
            let mut display = display(true);
            assert!(send(&mut display, wrong).is_empty());
            assert_eq!(display.refused(), 1, "{wrong:?}");
        }
        let mut full = display(true);
        send(&mut full, &[b'x'; 21]);
        assert_eq!(full.refused(), 1);
        // Without the settings text would wrap.
        let mut fresh = Lk204::new(true, SimDuration::from_ticks(0));
        send(&mut fresh, b"x");
        assert_eq!(fresh.refused(), 1);
    }

    #[test]
    fn what_comes_faster_than_it_is_executed_is_lost() {
        let mut display = Lk204::new(true, SimDuration::from_ticks(1_000_000_000));
        let now = SimTime::from_ticks(0);
        for _ in 0..90 {
            display.receive(254, now);
        }
        // 80 bytes are 40 commands that the display does not know; ten bytes are lost.
        assert_eq!(display.refused(), 40 + 10);
    }
}
