//! The motor driver and the relay in its motor lead. The driver's port is USART1, TX PA9,
//! 38 400 baud 8N1, single bytes (SyRen 50, simplified serial: 0 and 255 are the two full
//! speeds, 127 is stop). The relay is at PA8, high = closed.
//!
//! In simplified serial the driver keeps its last speed for ever, and its S2 input selects a
//! driver but does not stop it (SyRen 50 user's guide, mode 3). So the node closes the motor's
//! circuit itself, and only while its commands ask for that. Whatever stops the node (a reset,
//! the watchdog, a lost supply) releases the pin, and a resistor pulls it to ground.

use crate::pac;
use crate::registers::{pulse, usart};
use stm32f3xx_hal::gpio::{Input, Output, PA8, PB0, PushPull};
use stm32f3xx_hal::prelude::*;

/// Bits per second, the fastest of the driver's switch settings.
pub const BAUD: u32 = 38_400;

/// The byte that stops the motor.
pub const STOP: u8 = 127;

/// The motor driver's port.
pub struct Motor {
    usart: pac::USART1,
}

/// Starts the port, idle. USART1 runs on the system clock, `clock` Hz, which the caller has
/// selected, because the default differs between variants of the part. The clock gate of USART1
/// is open.
pub(crate) fn start(port: pac::USART1, clock: u32) -> Motor {
    usart::start(&port, clock, BAUD, false);
    Motor { usart: port }
}

impl Motor {
    /// Sends one command byte. Returns false, and drops the byte, while the one before is still
    /// waiting to be sent, which takes at most 260 us.
    pub fn send(&mut self, command: u8) -> bool {
        usart::send(&self.usart, command)
    }
}

/// The relay in the motor lead; open until it is closed.
pub struct Relay {
    pin: PA8<Output<PushPull>>,
    sense: PB0<Input>,
}

impl Relay {
    pub(crate) fn new(pin: PA8<Output<PushPull>>, sense: PB0<Input>) -> Self {
        let mut relay = Self { pin, sense };
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

impl Relay {
    /// Whether at least one of the two relays conducts. It tells this while the driver is stopped:
    /// M1 and the motor's lead are near ground then, and the relay joins one of them to the lead
    /// between the relays.
    fn conducts(&self) -> bool {
        self.sense.is_low().unwrap_or(true)
    }
}

/// Steps for which an open relay must have conducted before it counts as stuck, and for which the
/// driver must have been stopped: longer than the slowest of the two takes.
const STUCK: u8 = 10;

/// The motor driver with its relay and the byte that was sent last.
pub struct MotorOutput {
    motor: Motor,
    relay: Relay,
    closed: bool,
    last: u8,
    /// Steps of [`MotorOutput::watch`] since the relay was opened, and of these in a row at the
    /// end the steps in which it conducted.
    opened: u8,
    conducted: u8,
    /// Steps in a row at the end in which it did not.
    isolated: u8,
    /// The relay was seen to open since the start.
    opens: bool,
    barred: bool,
}

impl MotorOutput {
    /// The driver after start-up has sent the stop command; its relay is open.
    pub fn new(motor: Motor, relay: Relay) -> Self {
        Self {
            motor,
            relay,
            closed: false,
            last: STOP,
            opened: 0,
            conducted: 0,
            isolated: 0,
            opens: false,
            barred: false,
        }
    }

    fn switch(&mut self, closed: bool) {
        self.closed = closed;
        self.relay.set(closed);
    }

    /// Sends a command byte, even if it is the same as the last one: the driver may have lost its
    /// power in between, or read noise. `None` means that the motor is not to turn: opens
    /// its circuit and sends a stop. So does every command until the relay was seen to open after the
    /// start.
    pub fn set(&mut self, command: Option<u8>) {
        let command = command.filter(|_| self.opens && !self.barred);
        self.switch(command.is_some());
        let byte = command.unwrap_or(STOP);
        if self.motor.send(byte) {
            self.last = byte;
        }
    }

    /// No command turns the motor any more: the board is not sound.
    pub fn bar(&mut self) {
        self.barred = true;
        self.set(None);
    }

    /// Whether no command turns the motor any more.
    pub fn is_barred(&self) -> bool {
        self.barred
    }

    /// Reads the relay back. Call it every 10 ms. A relay that conducts although it has been open
    /// for a while is stuck: `Some(false)`. `None` while it is closed, or has just been opened.
    pub fn watch(&mut self) -> Option<bool> {
        if self.closed {
            self.opened = 0;
            self.conducted = 0;
            self.isolated = 0;
            return None;
        }
        self.opened = self.opened.saturating_add(1);
        if self.relay.conducts() {
            self.conducted = self.conducted.saturating_add(1);
            self.isolated = 0;
        } else {
            self.conducted = 0;
            self.isolated = self.isolated.saturating_add(1);
        }
        self.opens |= self.isolated > STUCK;
        (self.opened > STUCK).then_some(self.conducted < STUCK)
    }

    /// Whether the relay is open: the motor has no circuit.
    pub fn is_open(&self) -> bool {
        !self.closed
    }

    /// The byte sent last.
    pub fn last(&self) -> u8 {
        self.last
    }
}

/// Opens the relay, sends the stop command and waits until it has left the pin. Uses no state.
///
/// For the end of the program. Bytes that are still being sent are waited for, each for a
/// bounded time. So are servo pulses.
pub fn stop() {
    usart::end(STOP, BAUD);
    pulse::end();
}
