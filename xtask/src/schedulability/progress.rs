//! What is under way, on the terminal.

use std::{
    io::{IsTerminal, Write},
    time::{Duration, Instant},
};

/// One line that is written over or, into a file, a line now and then.
pub(super) struct Display {
    start: Instant,
    last: Option<Instant>,
    terminal: bool,
}

impl Display {
    pub(super) fn new() -> Self {
        Self {
            start: Instant::now(),
            last: None,
            terminal: std::io::stderr().is_terminal(),
        }
    }

    pub(super) fn show(&mut self, what: &str) {
        let now = Instant::now();
        let pause = Duration::from_millis(if self.terminal { 100 } else { 2000 });
        // Work of less than two seconds needs no word.
        if now - self.last.unwrap_or(self.start) < pause {
            return;
        }
        self.last = Some(now);
        let seconds = (now - self.start).as_secs();
        let mut stderr = std::io::stderr();
        // Progress that cannot be shown is no reason to stop.
        let _ = if self.terminal {
            write!(stderr, "\r{seconds:4} s  {what}\x1b[K").and_then(|()| stderr.flush())
        } else {
            writeln!(stderr, "{seconds:4} s  {what}")
        };
    }

    pub(super) fn end(&mut self) {
        if self.terminal && self.last.is_some() {
            eprint!("\r\x1b[K");
        }
        self.last = None;
    }
}
