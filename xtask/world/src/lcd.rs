//! The operator's display at the controller node.
//!
//! The thesis does not name the display's model (6.2.4.5). It only shows that the module answers
//! every accepted command with `0x55`. Therefore the display is a trait, and [`RowDisplay`] is a
//! module with that behaviour and with the commands that the controller's firmware sends: two
//! digits for the row, a letter for the colour (`W`, `G` or `R`), the text, a carriage return.

use crate::syren::fits;
use crate::time::{SimDuration, SimTime, after, since};

/// The acknowledge byte (thesis 6.2.4.5, Figure 6.28).
pub const ACKNOWLEDGE: u8 = 0x55;

/// Baud rate of the display.
pub const BAUD: u32 = 115_200;

/// Rows of the screen.
const ROWS: usize = 20;

/// Longest command that the display buffers, in bytes: row, colour and 40 characters.
const LONGEST: usize = 43;

/// A serial display.
pub trait Display {
    /// Processes a byte whose stop bit ended at `at`. If the byte completes a command, returns the
    /// time at which the display has executed it and begins to acknowledge it.
    fn receive(&mut self, byte: u8, at: SimTime) -> Option<SimTime>;

    /// The text on the display, row by row.
    fn text(&self) -> String;

    /// Commands executed.
    fn executed(&self) -> u64;

    /// Commands that the display did not understand and did not answer.
    fn refused(&self) -> u64;
}

/// A display of coloured rows of text.
#[derive(Clone, Debug)]
pub struct RowDisplay {
    acknowledges: bool,
    delay: SimDuration,
    command: Vec<u8>,
    rows: [Option<(char, String)>; ROWS],
    executed: u64,
    refused: u64,
}

impl RowDisplay {
    /// A blank display that executes a command in `delay`. With `acknowledges` false it never
    /// answers.
    #[must_use]
    pub fn new(acknowledges: bool, delay: SimDuration) -> Self {
        Self {
            acknowledges,
            delay,
            command: Vec::new(),
            rows: [const { None }; ROWS],
            executed: 0,
            refused: 0,
        }
    }

    /// Row, colour and text of a command.
    fn parse(command: &[u8]) -> Option<(usize, char, String)> {
        let text = core::str::from_utf8(command).ok()?;
        if command.len() > LONGEST || !text.bytes().all(|byte| (b' '..=b'~').contains(&byte)) {
            return None;
        }
        let (row, rest) = text.split_at_checked(2)?;
        let colour = rest
            .chars()
            .next()
            .filter(|colour| "WGR".contains(*colour))?;
        let digits = row.bytes().all(|byte| byte.is_ascii_digit());
        let row: usize = row.parse().ok().filter(|row| digits && *row < ROWS)?;
        Some((row, colour, rest[1..].to_owned()))
    }
}

impl Display for RowDisplay {
    fn receive(&mut self, byte: u8, at: SimTime) -> Option<SimTime> {
        if byte != b'\r' {
            // One byte more than the limit is kept, to detect that a command is too long.
            if self.command.len() <= LONGEST {
                self.command.push(byte);
            }
            return None;
        }
        let command = core::mem::take(&mut self.command);
        let Some((row, colour, text)) = Self::parse(&command) else {
            self.refused += 1;
            return None;
        };
        self.rows[row] = Some((colour, text));
        self.executed += 1;
        self.acknowledges.then(|| after(at, self.delay))
    }

    fn text(&self) -> String {
        let rows = self.rows.iter().flatten();
        rows.map(|(colour, text)| format!("{colour} {text}\n"))
            .collect()
    }

    fn executed(&self) -> u64 {
        self.executed
    }

    fn refused(&self) -> u64 {
        self.refused
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

    fn display(acknowledges: bool) -> RowDisplay {
        RowDisplay::new(acknowledges, SimDuration::from_ticks(7))
    }

    /// The answers to the bytes of `text`, all sent at time 5.
    fn send(display: &mut RowDisplay, text: &[u8]) -> Vec<Option<u64>> {
        let answer = |byte: &u8| display.receive(*byte, SimTime::from_ticks(5));
        text.iter()
            .map(answer)
            .map(|at| at.map(|at| at.as_ticks()))
            .collect()
    }

    #[test]
    fn each_command_is_acknowledged_once() {
        let mut display = display(true);
        let answers = send(&mut display, b"01Gok\r00W\r");
        let when: Vec<usize> = (0..answers.len())
            .filter(|i| answers[*i] == Some(12))
            .collect();
        assert_eq!(when, [5, 9]);
        assert_eq!(display.text(), "W \nG ok\n");
    }

    #[test]
    fn a_mute_display_still_shows() {
        let mut display = display(false);
        assert!(send(&mut display, b"19RX\r").iter().all(Option::is_none));
        assert_eq!((display.text().as_str(), display.executed()), ("R X\n", 1));
    }

    #[test]
    fn what_is_no_command_gets_no_answer() {
        let mut display = display(true);
        for text in [
            "\r",
            "1\r",
            "00\r",
            "20Wx\r",
            "xxWx\r",
            "+1Wx\r",
            "00Bx\r",
            "00W\x07\r",
        ] {
            assert!(
                send(&mut display, text.as_bytes())
                    .iter()
                    .all(Option::is_none),
                "{text:?}"
            );
        }
        let endless = ["00W", &"x".repeat(41), "\r"].concat();
        assert!(
            send(&mut display, endless.as_bytes())
                .iter()
                .all(Option::is_none)
        );
        assert_eq!((display.executed(), display.refused()), (0, 9));
        let longest = ["00W", &"x".repeat(40), "\r"].concat();
        assert_eq!(
            send(&mut display, longest.as_bytes()).last(),
            Some(&Some(12))
        );
    }
}
