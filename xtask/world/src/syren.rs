//! SyRen 50 motor driver in simplified serial mode: each byte sets the motor's effort.
//!
//! Frames are 8N1 at the baud rate set by the driver's switches. Byte 127 stops the motor; 255 is
//! full effort in one direction and 0 in the other (Dimension Engineering, SyRen 50 user's guide;
//! thesis 6.2.4.4). The driver keeps its effort until the next byte, and ignores a character with a
//! framing error. It samples the line with a clock of its own. A relay in the motor's lead,
//! controlled by the node, disconnects the motor while it is open.

use crate::line::{Heard, Listener, Wave};
use crate::time::{SimDuration, SimTime};

/// Baud rate set by the driver's switches.
pub const BAUD: u32 = 38_400;

/// The byte that stops the motor.
pub const STOP: u8 = 127;

/// Largest relative difference between a sender's and a receiver's bit times. A receiver that
/// samples in the middle of a bit loses a ten-bit character at 5 %; half of that is allowed for
/// each side.
const TOLERANCE: f64 = 0.025;

/// True if ten bits that lasted `length` match `baud`.
#[must_use]
pub fn fits(length: SimDuration, baud: u32) -> bool {
    let expected = 10.0 / f64::from(baud);
    (crate::time::span_seconds(length) / expected - 1.0).abs() <= TOLERANCE
}

/// One motor driver.
#[derive(Clone, Debug)]
pub struct Syren {
    reversed: bool,
    line: Listener,
    byte: Option<u8>,
    closed: bool,
    stuck: bool,
}

impl Syren {
    /// A driver that has received nothing and whose relay is open: the motor is at rest.
    /// `clock_error` is that of its own clock, a share of one.
    #[must_use]
    pub fn new(reversed: bool, clock_error: f64) -> Self {
        Self {
            reversed,
            line: Listener::new(BAUD, clock_error),
            byte: None,
            closed: false,
            stuck: false,
        }
    }

    /// A character was sent to it; returns what it has read of its line by now.
    pub fn receive(&mut self, wave: &Wave) -> Vec<Heard> {
        let mut all = Vec::new();
        self.line.receive(wave, |heard| all.push(heard));
        all
    }

    /// Nothing was sent to it until `now`; returns what it has read of its line by now.
    pub fn settle(&mut self, now: SimTime) -> Vec<Heard> {
        let mut all = Vec::new();
        self.line.settle(now, |heard| all.push(heard));
        all
    }

    /// Takes a byte that it has read.
    pub fn obey(&mut self, byte: u8) {
        self.byte = Some(byte);
    }

    /// Closes or opens the relay.
    pub fn set_relay(&mut self, closed: bool) {
        self.closed = closed;
    }

    /// The relay conducts from now on, whatever the node says.
    pub fn stick_relay(&mut self) {
        self.stuck = true;
    }

    /// Whether the relay is closed.
    #[must_use]
    pub fn is_closed(&self) -> bool {
        self.closed || self.stuck
    }

    /// The last byte, if there was one.
    #[must_use]
    pub fn byte(&self) -> Option<u8> {
        self.byte
    }

    /// Effort that reaches the motor, from -1 to 1; 0 before the first byte and while the relay
    /// is open.
    #[must_use]
    pub fn effort(&self) -> f64 {
        if !self.is_closed() {
            return 0.0;
        }
        let effort = self.byte.map_or(0.0, effort_of);
        if self.reversed { -effort } else { effort }
    }
}

/// Effort for a byte: -1 at 0, 0 at 127, 1 at 255.
#[must_use]
pub fn effort_of(byte: u8) -> f64 {
    let steps = f64::from(byte) - 127.0;
    if steps >= 0.0 {
        steps / 128.0
    } else {
        steps / 127.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ends_and_middle_of_the_range() {
        assert_eq!(
            [effort_of(0), effort_of(127), effort_of(255)],
            [-1.0, 0.0, 1.0]
        );
        let mut driver = Syren::new(true, 0.0);
        driver.set_relay(true);
        assert_eq!(driver.effort(), 0.0);
        driver.obey(255);
        assert_eq!(driver.effort(), -1.0);
    }

    #[test]
    fn an_open_relay_keeps_the_effort_from_the_motor() {
        let mut driver = Syren::new(false, 0.0);
        driver.obey(255);
        assert_eq!(driver.effort(), 0.0);
        driver.set_relay(true);
        assert_eq!(driver.effort(), 1.0);
        driver.set_relay(false);
        assert_eq!((driver.effort(), driver.byte()), (0.0, Some(255)));
    }
}
