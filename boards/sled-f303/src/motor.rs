//! The motor driver: its port, USART1, TX PA9, 38 400 baud 8N1, single bytes (SyRen 50,
//! simplified serial: 0 and 255 are the two full speeds, 127 is stop); and the relay in its
//! motor lead, PA8, high = closed.
//!
//! In simplified serial the driver keeps its last speed for ever, and its S2 input selects,
//! but does not stop (SyRen 50 user's guide, mode 3). So the node holds the motor's circuit
//! closed itself, and only while a command is in force: what stops the node, a reset, a
//! watchdog, a lost supply, lets go of the pin, which a resistor then pulls to ground.

use crate::pac;
use crate::registers::usart;
use stm32f3xx_hal::gpio::{Output, PA8, PushPull};
use stm32f3xx_hal::prelude::*;

/// Bits per second, the fastest of the driver's switch settings.
pub const BAUD: u32 = 38_400;

/// The byte that stops the motor.
pub const STOP: u8 = 127;

/// The motor driver's port.
pub struct Motor {
    usart: pac::USART1,
}

/// Starts the port, idle. USART1 runs on the system clock, `clock` Hz, which the caller
/// has selected: its default differs between variants of the part. Its bus clock is on.
pub(crate) fn start(port: pac::USART1, clock: u32) -> Motor {
    usart::start(&port, clock, BAUD, false);
    Motor { usart: port }
}

impl Motor {
    /// Sends one command byte. While the one before waits for its turn, which takes at
    /// most 260 us, the newer is dropped and false returned.
    pub fn send(&mut self, command: u8) -> bool {
        usart::send(&self.usart, command)
    }
}

/// The relay in the motor lead; open until it is closed.
pub struct Relay {
    pin: PA8<Output<PushPull>>,
}

impl Relay {
    pub(crate) fn new(pin: PA8<Output<PushPull>>) -> Self {
        let mut relay = Self { pin };
        relay.set(false);
        relay
    }

    /// Closes or opens it.
    pub fn set(&mut self, closed: bool) {
        // A write to the port's set and reset register: the error type is empty.
        let _ = if closed {
            self.pin.set_high()
        } else {
            self.pin.set_low()
        };
    }
}

/// The driver with the byte that it was sent last.
pub struct MotorOutput {
    motor: Motor,
    relay: Relay,
    last: u8,
}

impl MotorOutput {
    /// The driver after the stop command of the start, its relay open.
    pub fn new(motor: Motor, relay: Relay) -> Self {
        Self {
            motor,
            relay,
            last: STOP,
        }
    }

    /// Sends a command byte when it differs from the last one. `None`: no command is in
    /// force; the motor's circuit is opened, and the byte is a stop.
    pub fn set(&mut self, command: Option<u8>) {
        if command.unwrap_or(STOP) != self.last {
            self.repeat(command);
        } else {
            self.relay.set(command.is_some());
        }
    }

    /// Sends a command byte even when it is the last one: the driver may have lost its power
    /// in between.
    pub fn repeat(&mut self, command: Option<u8>) {
        self.relay.set(command.is_some());
        let byte = command.unwrap_or(STOP);
        if self.motor.send(byte) {
            self.last = byte;
        }
    }

    /// The byte sent last.
    pub fn last(&self) -> u8 {
        self.last
    }
}

/// Opens the relay and sends the stop command, without any state, and waits until that has
/// left the pin.
///
/// For the end of the program: the bytes before it are waited for, each within a bound.
pub fn stop() {
    usart::end(STOP);
}
