//! A CAN bus bit by bit, with controllers that handle errors as ISO 11898-1 has it: flags of six bits, delimiters in
//! which a dominant bit is an error again, error counters, arbitration. Propagation takes no time.

use std::collections::VecDeque;

use ttcan::Frame;

use super::support::{bits_of, crc};

/// Where a controller is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum State {
    Idle,
    /// In a frame up to the end of its CRC.
    Body,
    CrcDelimiter,
    Acknowledge,
    AcknowledgeDelimiter,
    /// So many bits of the end of frame are still to come.
    End(u8),
    Flag(u8),
    /// Behind an own flag, until the bus is recessive.
    Wait,
    Delimiter(u8),
    Intermission(u8),
    /// A sender that is error passive lets others go first.
    Suspend(u8),
    /// So many times eleven recessive bits, and recessive bits since then.
    BusOff(u8, u8),
}

/// A controller. `true` is recessive.
pub(crate) struct Controller {
    pub(crate) state: State,
    /// What it is to send, and whether it repeats that until it is sent.
    pub(crate) queue: VecDeque<(Frame, bool)>,
    /// Error counters (ISO 11898-1, fault confinement).
    transmit_errors: u32,
    receive_errors: u32,
    /// The bits that it sends, and how many it has sent.
    sending: Option<Vec<bool>>,
    sent_bits: usize,
    /// It was the sender of the frame that an error ended.
    was_sender: bool,
    is_overload: bool,
    /// The bits of the frame without stuff bits, and the run that stuffing counts.
    bits: Vec<bool>,
    run: u8,
    last: bool,
    stuff_is_next: bool,
    length: Option<usize>,
    /// What the last bit has ended.
    pub(crate) received: Option<Vec<bool>>,
    pub(crate) sent: Option<Frame>,
}

impl Controller {
    pub(crate) fn new() -> Self {
        Self {
            state: State::Intermission(3),
            queue: VecDeque::new(),
            transmit_errors: 0,
            receive_errors: 0,
            sending: None,
            sent_bits: 0,
            was_sender: false,
            is_overload: false,
            bits: Vec::new(),
            run: 0,
            last: true,
            stuff_is_next: false,
            length: None,
            received: None,
            sent: None,
        }
    }

    fn is_passive(&self) -> bool {
        self.transmit_errors >= 128 || self.receive_errors >= 128
    }

    /// Whether it is sending a frame.
    pub(crate) const fn is_sending(&self) -> bool {
        self.sending.is_some()
    }

    /// The bit that it drives.
    pub(crate) fn output(&mut self) -> bool {
        match self.state {
            State::Idle => {
                let next = self.queue.front().map(|(frame, _)| bits_of(frame));
                let begins = next.is_some();
                if begins {
                    self.begin(next);
                }
                !begins
            }
            State::Body => {
                let sending = self.sending.as_ref();
                sending.is_none_or(|bits| bits[self.sent_bits])
            }
            State::Acknowledge => self.sending.is_some() || !self.is_whole(),
            State::Flag(_) => self.is_passive() && !self.is_overload,
            _ => true,
        }
    }

    fn begin(&mut self, sending: Option<Vec<bool>>) {
        self.was_sender = sending.is_some();
        self.sending = sending;
        self.sent_bits = 0;
        self.bits.clear();
        self.run = 0;
        self.stuff_is_next = false;
        self.length = None;
        self.state = State::Body;
    }

    /// Takes the level of the bus, at the end of a bit in which it drove `own`.
    pub(crate) fn input(&mut self, own: bool, bus: bool) {
        (self.received, self.sent) = (None, None);
        match self.state {
            State::Idle if bus => {}
            State::Idle => self.follow(bus),
            State::Body => self.body(own, bus),
            State::CrcDelimiter if bus => self.state = State::Acknowledge,
            State::Acknowledge if self.sending.is_some() && bus => self.fail(),
            State::Acknowledge => self.state = State::AcknowledgeDelimiter,
            State::AcknowledgeDelimiter if bus && (self.was_sender || self.is_whole()) => {
                self.state = State::End(7);
            }
            State::CrcDelimiter | State::AcknowledgeDelimiter => self.fail(),
            State::End(left) => self.end(left, bus),
            State::Flag(_) if !own && bus => self.count(8, 8),
            State::Flag(1) => self.state = State::Wait,
            State::Flag(left) => self.state = State::Flag(left - 1),
            State::Wait if bus => self.state = State::Delimiter(7),
            State::Wait => {}
            State::Delimiter(1) if !bus => self.overload(),
            State::Delimiter(_) if !bus => self.count(8, 1),
            State::Delimiter(1) => self.state = State::Intermission(3),
            State::Delimiter(left) => self.state = State::Delimiter(left - 1),
            State::Intermission(left) => self.intermission(left, bus),
            State::Suspend(_) if !bus => self.follow(bus),
            State::Suspend(1) => self.state = State::Idle,
            State::Suspend(left) => self.state = State::Suspend(left - 1),
            State::BusOff(times, run) => self.recover(times, if bus { run + 1 } else { 0 }),
        }
    }

    /// Another one's frame begins.
    fn follow(&mut self, bus: bool) {
        if self.state != State::Body {
            self.begin(None);
        }
        self.unstuff(bus);
    }

    fn intermission(&mut self, left: u8, bus: bool) {
        let waits = self.is_passive() && self.was_sender;
        match (left, bus) {
            (1, false) => {
                // It sees the first bit of a frame, and may begin its own with the second.
                let next = self.queue.front().filter(|_| !waits);
                let next = next.map(|(frame, _)| bits_of(frame));
                let begins = next.is_some();
                self.begin(next);
                self.sent_bits = usize::from(begins);
                self.unstuff(bus);
            }
            (_, false) => self.overload(),
            (1, true) if waits => self.state = State::Suspend(8),
            (1, true) => self.state = State::Idle,
            (_, true) => self.state = State::Intermission(left - 1),
        }
    }

    fn recover(&mut self, times: u8, run: u8) {
        self.state = match (times, run) {
            (127, 11) => {
                (self.transmit_errors, self.receive_errors) = (0, 0);
                self.was_sender = false;
                State::Idle
            }
            (_, 11) => State::BusOff(times + 1, 0),
            _ => State::BusOff(times, run),
        };
    }

    fn body(&mut self, own: bool, bus: bool) {
        if self.sending.is_some() {
            if own != bus {
                let is_extended = self.bits.get(13) == Some(&true);
                let arbitrates = self.bits.len() < if is_extended { 32 } else { 12 };
                if !own || !arbitrates || self.stuff_is_next {
                    self.fail();
                    return;
                }
                self.sending = None;
                self.was_sender = false;
                self.give_up();
            }
            self.sent_bits += 1;
        }
        self.unstuff(bus);
    }

    /// A frame that is not repeated is not tried again.
    fn give_up(&mut self) {
        if self.queue.front().is_some_and(|(_, repeats)| !repeats) {
            self.queue.pop_front();
        }
    }

    fn unstuff(&mut self, bus: bool) {
        if self.stuff_is_next {
            self.stuff_is_next = false;
            if bus == self.last {
                self.fail();
                return;
            }
            self.run = 1;
        } else {
            let goes_on = bus == self.last && !self.bits.is_empty();
            self.run = if goes_on { self.run + 1 } else { 1 };
            self.bits.push(bus);
            self.stuff_is_next = self.run == 5;
        }
        self.last = bus;
        let is_extended = self.bits.get(13) == Some(&true);
        let header = if is_extended { 39 } else { 19 };
        if self.length.is_none() && self.bits.len() == header {
            let code = number(&self.bits[header - 4..]).min(8) as usize;
            self.length = Some(header + code * 8 + 15);
        }
        if self.length == Some(self.bits.len()) && !self.stuff_is_next {
            self.state = State::CrcDelimiter;
        }
    }

    /// Whether the CRC of the received bits is right: then the remainder of all of them is 0.
    fn is_whole(&self) -> bool {
        crc(&self.bits) == 0
    }

    fn end(&mut self, left: u8, bus: bool) {
        match (left, bus) {
            (1, false) if !self.was_sender => self.overload(),
            (_, false) => self.fail(),
            (1, true) => {
                if self.was_sender {
                    self.transmit_errors = self.transmit_errors.saturating_sub(1);
                    self.sent = self.queue.pop_front().map(|(frame, _)| frame);
                }
                self.sending = None;
                self.state = State::Intermission(3);
            }
            (_, true) => {
                if left == 2 && !self.was_sender {
                    self.receive_errors = self.receive_errors.saturating_sub(1);
                    self.received = Some(self.bits.clone());
                }
                self.state = State::End(left - 1);
            }
        }
    }

    /// An error in a frame.
    fn fail(&mut self) {
        self.give_up_sent();
        self.count(8, 1);
    }

    fn give_up_sent(&mut self) {
        if self.sending.take().is_some() {
            self.give_up();
        }
    }

    /// An error, which counts so much for a sender and for a receiver: a flag.
    fn count(&mut self, sender: u32, receiver: u32) {
        if self.was_sender {
            self.transmit_errors += sender;
        } else {
            self.receive_errors += receiver;
        }
        self.is_overload = false;
        self.state = if self.transmit_errors >= 256 {
            State::BusOff(0, 0)
        } else {
            State::Flag(6)
        };
    }

    fn overload(&mut self) {
        self.is_overload = true;
        self.state = State::Flag(6);
    }
}

/// The number that bits make, the most significant one first.
pub(crate) fn number(bits: &[bool]) -> u32 {
    let one = |number: u32, bit: &bool| number << 1 | u32::from(*bit);
    bits.iter().fold(0, one)
}
