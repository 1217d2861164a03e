//! A serial line as its receiver sees it: levels over time, sampled in the middle of each bit at
//! the receiver's own rate.
//!
//! So a byte that was sent at another rate, or of which only the beginning was sent, is read as
//! what it looks like: as another byte, as two bytes, or as a framing error.

use crate::time::{PER_SECOND, SimTime};
use std::collections::VecDeque;

/// Bits of a character: start bit, eight data bits, stop bit.
pub const BITS: usize = 10;

/// The wave form of one character (8N1) on a line that is high at rest.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub struct Wave {
    /// The byte that the sender meant.
    pub byte: u8,
    /// Beginning of each bit, and the end of the last one.
    pub edges: [SimTime; BITS + 1],
    /// When the sender let go of the line before the end; the line is high from then on.
    pub cut: Option<SimTime>,
}

impl Wave {
    /// A character whose bits all have the same length.
    #[must_use]
    pub fn steady(byte: u8, start: SimTime, end: SimTime) -> Self {
        let (start, end) = (start.as_ticks(), end.as_ticks());
        let length = u128::from(end.saturating_sub(start));
        let edge = |bit: usize| start + (length * bit as u128 / BITS as u128) as u64;
        Self {
            byte,
            edges: core::array::from_fn(|bit| SimTime::from_ticks(edge(bit))),
            cut: None,
        }
    }

    /// Beginning of the start bit.
    #[must_use]
    pub fn start(&self) -> SimTime {
        self.edges[0]
    }

    /// When the line rests again.
    #[must_use]
    pub fn end(&self) -> SimTime {
        self.cut.unwrap_or(self.edges[BITS])
    }

    /// Level of bit `bit`.
    fn level(&self, bit: usize) -> bool {
        match bit {
            0 => false,
            1..=8 => self.byte >> (bit - 1) & 1 != 0,
            _ => true,
        }
    }
}

/// What a receiver makes of the line.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub struct Heard {
    /// The byte; `None` after a framing error: its stop bit was low.
    pub byte: Option<u8>,
    /// End of its stop bit, at the receiver's rate.
    pub end: SimTime,
    /// Whether it is the byte that was sent, from its start bit on.
    pub genuine: bool,
}

/// The receiver of a line.
#[derive(Clone, Debug)]
pub struct Listener {
    /// Ten bits at the receiver's rate, ps.
    character: u64,
    /// Changes of the level that are not read yet, ps.
    edges: VecDeque<(u64, bool)>,
    /// Level before the first of them.
    level: bool,
    /// Level after the last of them.
    last: bool,
    /// The instant before which everything has been read.
    read: u64,
    /// Start and byte of the characters that were sent and are not read yet. One that was cut off
    /// may still be read right, if its last bits were high.
    sent: VecDeque<(u64, u8)>,
}

impl Listener {
    /// A receiver at `baud` bit/s whose clock is off by `error`, a share of one.
    #[must_use]
    pub fn new(baud: u32, error: f64) -> Self {
        let rate = f64::from(baud) * (1.0 + error);
        Self {
            character: (BITS as f64 / rate * PER_SECOND as f64).round() as u64,
            edges: VecDeque::new(),
            level: true,
            last: true,
            read: 0,
            sent: VecDeque::new(),
        }
    }

    /// A character was sent. What can be read of the line so far goes to `heard`. Calls must be in
    /// order of time.
    pub fn receive(&mut self, wave: &Wave, heard: impl FnMut(Heard)) {
        let end = wave.end().as_ticks();
        for bit in 0..BITS {
            let at = wave.edges[bit].as_ticks();
            if at < end {
                self.change(at, wave.level(bit));
            }
        }
        self.change(end, true);
        self.sent.push_back((wave.start().as_ticks(), wave.byte));
        self.read_until(end, heard);
    }

    /// The line is known until `now`: reads what is left.
    pub fn settle(&mut self, now: SimTime, heard: impl FnMut(Heard)) {
        self.read_until(now.as_ticks(), heard);
    }

    fn change(&mut self, at: u64, level: bool) {
        if level != self.last {
            self.edges.push_back((at, level));
            self.last = level;
        }
    }

    fn level_at(&self, at: u64) -> bool {
        let before = self.edges.iter().take_while(|(edge, _)| *edge <= at);
        before.last().map_or(self.level, |(_, level)| *level)
    }

    /// Forgets the edges up to `at`.
    fn pass(&mut self, at: u64) {
        while let Some(&(edge, level)) = self.edges.front()
            && edge <= at
        {
            self.level = level;
            self.edges.pop_front();
        }
        self.read = self.read.max(at);
    }

    fn read_until(&mut self, now: u64, mut heard: impl FnMut(Heard)) {
        loop {
            // A start bit begins with a falling edge.
            let mut level = self.level;
            let fall = self.edges.iter().find(|(_, to)| {
                let falls = level && !to;
                level = *to;
                falls
            });
            let Some(&(start, _)) = fall else { break };
            let middle = |bit: u64| start + self.character * (2 * bit + 1) / 20;
            let stop = middle(9);
            if stop > now {
                break;
            }
            if self.level_at(middle(0)) {
                // Too short for a start bit.
                self.pass(start);
                continue;
            }
            let byte = (0..8).fold(0, |byte, bit| {
                byte | u8::from(self.level_at(middle(1 + bit))) << bit
            });
            let framed = self.level_at(stop);
            while self.sent.front().is_some_and(|(at, _)| *at < start) {
                self.sent.pop_front();
            }
            let genuine = framed && self.sent.front() == Some(&(start, byte));
            self.pass(stop);
            heard(Heard {
                byte: framed.then_some(byte),
                end: SimTime::from_ticks(start + self.character),
                genuine,
            });
        }
        if self.edges.is_empty() {
            self.sent.retain(|(at, _)| *at > now);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Bit time at 38 400 baud, ps.
    const BIT: u64 = PER_SECOND / 38_400;

    fn time(ps: u64) -> SimTime {
        SimTime::from_ticks(ps)
    }

    fn sent(byte: u8, start: u64, bit: u64) -> Wave {
        Wave::steady(byte, time(start), time(start + 10 * bit))
    }

    /// Bytes read from these waves, and whether each was sent so.
    fn read(error: f64, waves: &[Wave]) -> Vec<(Option<u8>, bool)> {
        let mut listener = Listener::new(38_400, error);
        let mut all = Vec::new();
        for wave in waves {
            listener.receive(wave, |heard| all.push((heard.byte, heard.genuine)));
        }
        let end = time(10 * PER_SECOND);
        listener.settle(end, |heard| all.push((heard.byte, heard.genuine)));
        all
    }

    #[test]
    fn a_stop_byte_at_a_ninth_of_the_rate_reads_as_two_full_reverse_bytes() {
        let slow = sent(127, 1_000, 9 * BIT);
        assert_eq!(read(0.0, &[slow]), [(Some(0), false), (Some(0), false)]);
    }

    #[test]
    fn a_byte_that_is_cut_off_reads_as_its_beginning_and_ones() {
        let mut wave = sent(0x40, 0, BIT);
        wave.cut = Some(time(4 * BIT));
        assert_eq!(read(0.0, &[wave]), [(Some(0xF8), false)]);
        // Cut off within its start bit, it is a glitch.
        wave.cut = Some(time(BIT / 3));
        assert_eq!(read(0.0, &[wave]), []);
    }

    #[test]
    fn a_byte_that_slows_down_on_its_way_is_another_byte_or_none() {
        let mut wave = sent(127, 0, BIT);
        for bit in 3..=BITS {
            wave.edges[bit] = time(2 * BIT + (bit as u64 - 2) * 9 * BIT);
        }
        let heard = read(0.0, &[wave]);
        assert!(heard.iter().all(|(_, genuine)| !genuine), "{heard:?}");
    }

    #[test]
    fn a_line_held_low_is_one_framing_error() {
        let wave = sent(0, 0, 12 * BIT);
        assert_eq!(read(0.0, &[wave]), [(None, false)]);
    }

    proptest! {
        /// The far end samples the stop bit nine and a half bits after the edge, so 5 % is too
        /// much, and 4 % is not.
        #[test]
        fn a_byte_is_read_within_four_percent(
            bytes in prop::collection::vec(any::<u8>(), 1..20), error in -0.04..0.04_f64,
            gap in 0..BIT,
        ) {
            let waves: Vec<_> = (0_u64..)
                .zip(&bytes)
                .map(|(k, byte)| sent(*byte, 5_000 + k * (10 * BIT + BIT / 2 + gap), BIT))
                .collect();
            let all: Vec<_> = bytes.iter().map(|byte| (Some(*byte), true)).collect();
            prop_assert_eq!(read(error, &waves), all);
        }

        #[test]
        fn no_wave_form_stops_the_listener(
            waves in prop::collection::vec((any::<u8>(), 1_u64..400, 0_u64..300, prop::option::of(0_u64..4000)), 0..20),
        ) {
            let mut at = 0;
            let mut all = Vec::new();
            for (byte, bit, gap, cut) in waves {
                let bit = bit * 1_000_000;
                let mut wave = sent(byte, at, bit);
                wave.cut = cut.map(|cut| time(at + cut * 1_000_000)).filter(|cut| *cut < wave.edges[BITS]);
                at = wave.end().as_ticks() + gap * 1_000_000;
                all.push(wave);
            }
            let heard = read(0.01, &all);
            prop_assert!(heard.len() <= 20 * all.len());
        }
    }
}
