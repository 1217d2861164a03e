//! SyRen 50 motor driver in simplified serial mode: each byte sets the motor's effort.
//!
//! Frames are 8N1 at the baud rate set by the driver's switches. Byte 127 stops the motor; 255 is
//! full effort in one direction and 0 in the other (Dimension Engineering, SyRen 50 user's guide;
//! thesis 6.2.4.4). The driver keeps its effort until the next byte. A relay in the motor's lead,
//! controlled by the node, disconnects the motor while it is open.

use crate::time::{SimDuration, SimTime, since};

/// Baud rate set by the driver's switches.
pub const BAUD: u32 = 38_400;

/// The byte that stops the motor.
pub const STOP: u8 = 127;

/// Largest relative difference between the sender's and the driver's bit times. A receiver that
/// samples in the middle of a bit loses a ten-bit character at 5 %; half of that is allowed for
/// each side.
const TOLERANCE: f64 = 0.025;

/// The effect of a byte.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub enum Reception {
    /// The byte was read.
    Accepted,
    /// The byte is lost because the sender's bit time differs from the driver's.
    WrongBaud,
}

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
    byte: Option<u8>,
    closed: bool,
    /// Bytes accepted.
    pub accepted: u64,
    /// Bytes lost to a wrong baud rate.
    pub wrong_baud: u64,
}

impl Syren {
    /// A driver that has received nothing and whose relay is open: the motor is at rest.
    #[must_use]
    pub fn new(reversed: bool) -> Self {
        Self {
            reversed,
            byte: None,
            closed: false,
            accepted: 0,
            wrong_baud: 0,
        }
    }

    /// Processes a byte that lasted from the edge of its start bit to the end of its stop bit.
    pub fn receive(&mut self, byte: u8, start: SimTime, end: SimTime) -> Reception {
        if fits(since(end, start), BAUD) {
            self.byte = Some(byte);
            self.accepted += 1;
            Reception::Accepted
        } else {
            self.wrong_baud += 1;
            Reception::WrongBaud
        }
    }

    /// Closes or opens the relay.
    pub fn set_relay(&mut self, closed: bool) {
        self.closed = closed;
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
        if !self.closed {
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

    const BYTE: u64 = 10_000_000_000_000 / BAUD as u64;

    fn send(driver: &mut Syren, byte: u8, length: u64) -> Reception {
        driver.receive(byte, SimTime::from_ticks(0), SimTime::from_ticks(length))
    }

    #[test]
    fn ends_and_middle_of_the_range() {
        assert_eq!(
            [effort_of(0), effort_of(127), effort_of(255)],
            [-1.0, 0.0, 1.0]
        );
        let mut driver = Syren::new(true);
        driver.set_relay(true);
        assert_eq!(driver.effort(), 0.0);
        send(&mut driver, 255, BYTE);
        assert_eq!(driver.effort(), -1.0);
    }

    #[test]
    fn an_open_relay_keeps_the_effort_from_the_motor() {
        let mut driver = Syren::new(false);
        send(&mut driver, 255, BYTE);
        assert_eq!(driver.effort(), 0.0);
        driver.set_relay(true);
        assert_eq!(driver.effort(), 1.0);
        driver.set_relay(false);
        assert_eq!((driver.effort(), driver.byte()), (0.0, Some(255)));
    }

    #[test]
    fn a_byte_at_another_baud_rate_is_lost() {
        let mut driver = Syren::new(false);
        assert_eq!(
            send(&mut driver, 200, BYTE * 102 / 100),
            Reception::Accepted
        );
        assert_eq!(
            send(&mut driver, 127, BYTE * 104 / 100),
            Reception::WrongBaud
        );
        assert_eq!(send(&mut driver, 127, BYTE / 4), Reception::WrongBaud);
        assert_eq!(driver.byte(), Some(200));
        assert_eq!((driver.accepted, driver.wrong_baud), (1, 2));
    }
}
