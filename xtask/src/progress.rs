//! Progress on the terminal.

use std::{
    io::{IsTerminal, Write},
    time::{Duration, Instant},
};

/// One line that is overwritten or, when the output is no terminal, a line now and then.
pub(crate) struct Display {
    start: Instant,
    last: Option<Instant>,
    terminal: bool,
}

impl Display {
    /// A display of work that begins now.
    pub(crate) fn new() -> Self {
        Self {
            start: Instant::now(),
            last: None,
            terminal: std::io::stderr().is_terminal(),
        }
    }

    /// Shows the line that `line` makes of the time since the work began. Does nothing soon
    /// after the last line or the beginning.
    pub(crate) fn show(&mut self, line: impl FnOnce(Duration) -> String) {
        let pause = Duration::from_millis(if self.terminal { 200 } else { 5000 });
        let now = Instant::now();
        if now - self.last.unwrap_or(self.start) < pause {
            return;
        }
        self.last = Some(now);
        let line = line(now - self.start);
        let mut stderr = std::io::stderr();
        // Progress that cannot be shown is no reason to stop.
        let _ = if self.terminal {
            write!(stderr, "\r{line}\x1b[K").and_then(|()| stderr.flush())
        } else {
            writeln!(stderr, "{line}")
        };
    }

    /// Removes the line from the terminal.
    pub(crate) fn end(&mut self) {
        if self.terminal && self.last.is_some() {
            eprint!("\r\x1b[K");
        }
        self.last = None;
    }
}
