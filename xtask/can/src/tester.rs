//! Foreign nodes: scripted senders, receivers and loggers with an ideal controller.

use std::collections::VecDeque;

use crate::Frame;
use crate::time::{BitSegments, ClockRate, Ps, SimTime, instant};
use crate::wire::Level;

/// How often a tester tries to send a frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Retry {
    /// One attempt.
    Once,
    /// Attempts until the frame has been sent.
    UntilSent,
}

/// A frame that a tester has received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reception {
    /// When it became valid: at the sample point of the last but one bit of end of frame.
    pub valid_at: SimTime,
    /// The frame.
    pub frame: Frame,
}

#[derive(Clone, Debug)]
struct Send {
    at: Ps,
    frame: Frame,
    retry: Retry,
}

#[derive(Clone, Debug)]
struct Babble {
    from: Ps,
    until: Ps,
    frame: Frame,
}

#[derive(Clone, Debug)]
struct Raw {
    at: Ps,
    levels: VecDeque<Level>,
}

/// The slot numbers that identify a tester's frames.
const SCRIPT_SLOT: u8 = 0;
const BABBLE_SLOT: u8 = 1;

/// A node without registers: it sends what a test tells it to and records what it receives.
#[derive(Clone, Debug)]
pub struct Tester {
    pub(crate) clock: ClockRate,
    pub(crate) segments: BitSegments,
    pub(crate) silent: bool,
    script: VecDeque<Send>,
    babble: Vec<Babble>,
    raw: VecDeque<Raw>,
    received: Vec<Reception>,
}

impl Tester {
    const fn with_silence(silent: bool) -> Self {
        Self {
            clock: ClockRate::new(45_000_000),
            segments: BitSegments::fifteen_quanta(12),
            silent,
            script: VecDeque::new(),
            babble: Vec::new(),
            raw: VecDeque::new(),
            received: Vec::new(),
        }
    }

    /// A node that participates fully: it acknowledges, signals errors and can send. 250 kbit/s,
    /// sample point at 73.3 %.
    #[must_use]
    pub const fn new() -> Self {
        Self::with_silence(false)
    }

    /// A node that only listens and never drives the bus.
    #[must_use]
    pub const fn listener() -> Self {
        Self::with_silence(true)
    }

    /// The same tester at another bit rate, bit/s: one of those that divide 3 Mbit/s, such as 125 000,
    /// 250 000 and 500 000, and 1 kbit/s or more. The sample point stays.
    ///
    /// # Panics
    /// At any other bit rate.
    #[must_use]
    pub fn at_bit_rate(mut self, bit_rate: u32) -> Self {
        const FASTEST: u32 = 3_000_000;
        let prescaler = FASTEST.checked_div(bit_rate).map(u16::try_from);
        let Some(Ok(prescaler)) = prescaler.filter(|_| FASTEST.is_multiple_of(bit_rate)) else {
            panic!("{bit_rate} bit/s do not divide 3 Mbit/s");
        };
        self.segments = BitSegments::fifteen_quanta(prescaler);
        self
    }

    /// The same tester with another clock and bit timing.
    #[must_use]
    pub fn with_timing(mut self, clock: ClockRate, segments: BitSegments) -> Self {
        self.clock = clock;
        self.segments = segments;
        self
    }

    /// Frames received so far, the oldest first.
    #[must_use]
    pub fn received(&self) -> &[Reception] {
        &self.received
    }

    pub(crate) fn store(&mut self, at: Ps, frame: Frame) {
        self.received.push(Reception {
            valid_at: instant(at),
            frame,
        });
    }

    pub(crate) fn schedule(&mut self, at: Ps, frame: Frame, retry: Retry) {
        let place = self.script.partition_point(|send| send.at <= at);
        self.script.insert(place, Send { at, frame, retry });
    }

    pub(crate) fn babble(&mut self, from: Ps, until: Ps, frame: Frame) {
        self.babble.push(Babble { from, until, frame });
    }

    pub(crate) fn play(&mut self, at: Ps, levels: Vec<Level>) {
        let place = self.raw.partition_point(|raw| raw.at <= at);
        let levels = levels.into();
        self.raw.insert(place, Raw { at, levels });
    }

    pub(crate) fn pending(&self, now: Ps) -> Option<(u8, Frame)> {
        if self.silent {
            return None;
        }
        if let Some(babble) = self
            .babble
            .iter()
            .find(|babble| babble.from <= now && now < babble.until)
        {
            return Some((BABBLE_SLOT, babble.frame));
        }
        self.script
            .front()
            .filter(|send| send.at <= now)
            .map(|send| (SCRIPT_SLOT, send.frame))
    }

    /// The earliest time from which a frame waits to be sent. It may be before `now`.
    pub(crate) fn earliest_request(&self, now: Ps) -> Option<Ps> {
        if self.silent {
            return None;
        }
        let babble = self
            .babble
            .iter()
            .filter(|babble| babble.until > now.max(babble.from))
            .map(|babble| babble.from)
            .min();
        let script = self.script.front().map(|send| send.at);
        babble.into_iter().chain(script).min()
    }

    pub(crate) fn earliest_raw(&self) -> Option<Ps> {
        self.raw.front().map(|raw| raw.at)
    }

    /// The level of a raw sequence in the bit that begins at `now`.
    pub(crate) fn raw_level(&mut self, now: Ps) -> Option<Level> {
        let raw = self.raw.front_mut().filter(|raw| raw.at <= now)?;
        let level = raw.levels.pop_front();
        if raw.levels.is_empty() {
            self.raw.pop_front();
        }
        level
    }

    /// An attempt has ended, successful or not.
    pub(crate) fn attempted(&mut self, slot: u8, success: bool) {
        if slot == SCRIPT_SLOT
            && self
                .script
                .front()
                .is_some_and(|send| success || send.retry == Retry::Once)
        {
            self.script.pop_front();
        }
    }
}

impl Default for Tester {
    fn default() -> Self {
        Self::new()
    }
}
