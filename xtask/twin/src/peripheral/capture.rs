//! The timer that measures an oscillator of its own part: TIM11 of the F446, TIM16 of the F303.
//! Its channel 1 captures every edge, or every second, fourth or eighth one, of a clock inside the
//! part (RM0390 20.5 and 20.6.11, RM0316 23.5 and 23.6).
//!
//! TIM16 also captures the edges of a pin and interrupts at a capture (RM0316 23.5 and 23.6). A
//! capture is in the cycle of the edge: the two or three cycles in which the part synchronises its
//! input are left out. A pin that is connected to the channel or taken from it makes no edge.
//!
//! The counter runs freely over 16 bits. Not modelled are the reload register, all that an overflow
//! brings about but a new prescaler, captures while the counter stands, by software (CC1G) or of
//! another input (CC1S), the input filter, requests to the DMA controller, outputs, and an interrupt by
//! the capture of an oscillator, whose flags rise only when the program looks at the timer.

use crate::clock::{Cycles, LocalClock, Ps};

const CR1: u32 = 0x00;
const DIER: u32 = 0x0C;
const SR: u32 = 0x10;
const EGR: u32 = 0x14;
const CCMR1: u32 = 0x18;
const CCER: u32 = 0x20;
const CNT: u32 = 0x24;
const PSC: u32 = 0x28;
const CCR1: u32 = 0x34;
const OR: u32 = 0x50;

const CEN: u32 = 1;
const UG: u32 = 1;
/// The flag of a capture, and its interrupt in DIER.
const CC1IF: u32 = 1 << 1;
const CC1OF: u32 = 1 << 9;
/// CCER: falling edges; with [`CC1NP`] both.
const CC1P: u32 = 1 << 1;
const CC1NP: u32 = 1 << 3;
/// Counts until the counter is at the same value again.
const RANGE: u64 = 0x1_0000;

#[derive(Clone, Debug)]
pub(crate) struct Capture {
    registers: [u32; 0x54 / 4],
    counter: Counter,
    /// When the captures of an oscillator were switched on, and how many of them there were.
    since: Ps,
    captures: u64,
    /// Level of the pin while it is connected to the channel.
    pin: Option<bool>,
    /// Its edges since the captures were switched on.
    edges: u32,
}

/// The counter and its prescaler.
#[derive(Clone, Copy, Debug)]
struct Counter {
    /// The count at cycle `at`, and the core cycles since it began.
    count: u64,
    phase: u64,
    at: Cycles,
    /// The prescaler in force, which may lag behind its register.
    prescaler: u32,
    /// Core cycles per cycle of the timer's clock.
    divider: u64,
    clocked: bool,
}

impl Counter {
    /// Runs up to `now`. The new prescaler counts from the next overflow on.
    fn advance(&mut self, now: Cycles, prescaler: u32) {
        let mut cycles = self.phase + now.saturating_sub(self.at);
        self.at = self.at.max(now);
        let overflow = (RANGE - self.count) * self.tick();
        if cycles >= overflow && self.prescaler != prescaler {
            cycles -= overflow;
            self.count = 0;
            self.prescaler = prescaler;
        }
        self.count = (self.count + cycles / self.tick()) % RANGE;
        self.phase = cycles % self.tick();
    }

    /// Core cycles per count.
    fn tick(&self) -> u64 {
        (u64::from(self.prescaler) + 1) * self.divider
    }
}

impl Default for Capture {
    fn default() -> Self {
        Self {
            registers: [0; 0x54 / 4],
            counter: Counter {
                count: 0,
                phase: 0,
                at: 0,
                prescaler: 0,
                divider: 1,
                clocked: true,
            },
            since: 0,
            captures: 0,
            pin: None,
            edges: 0,
        }
    }
}

impl Capture {
    pub(crate) fn reset(&mut self) {
        let fresh = Self::default();
        *self = Self {
            counter: Counter {
                at: self.counter.at,
                divider: self.counter.divider,
                clocked: self.counter.clocked,
                ..fresh.counter
            },
            pin: self.pin,
            ..fresh
        };
    }

    fn get(&self, offset: u32) -> u32 {
        self.registers[(offset / 4) as usize]
    }

    /// Selection of the input: the option register.
    pub(crate) fn input(&self) -> u32 {
        self.get(OR) & 3
    }

    fn captures_input(&self) -> bool {
        self.get(CCER) & 1 != 0 && self.get(CCMR1) & 3 == 1 && self.get(CR1) & CEN != 0
    }

    /// Edges from one capture to the next, as a power of two.
    fn spacing(&self) -> u32 {
        self.get(CCMR1) >> 2 & 3
    }

    /// Brings the counter to `now`.
    fn count(&mut self, now: Cycles) {
        if self.get(CR1) & CEN != 0 && self.counter.clocked {
            self.counter.advance(now, self.get(PSC));
        } else {
            self.counter.at = self.counter.at.max(now);
        }
    }

    /// Opens or closes the clock gate, or changes the core cycles per cycle of the timer.
    pub(crate) fn set_clock(&mut self, now: Cycles, clocked: bool, divider: u64) {
        if clocked == self.counter.clocked && divider == self.counter.divider {
            return;
        }
        self.count(now);
        if divider != self.counter.divider {
            self.counter.phase = 0;
        }
        self.counter.clocked = clocked;
        self.counter.divider = divider;
    }

    /// Captures the counter at `now`. `missed`: the program has not seen the capture before.
    fn capture(&mut self, now: Cycles, missed: bool) {
        self.count(now);
        self.registers[(CCR1 / 4) as usize] = self.counter.count as u32;
        self.registers[(SR / 4) as usize] |= CC1IF | if missed { CC1OF } else { 0 };
    }

    /// The pin has this level from now on; `None` while it is not connected to the channel.
    pub(crate) fn drive(&mut self, level: Option<bool>, now: Cycles) {
        let before = std::mem::replace(&mut self.pin, level);
        let (Some(before), Some(high)) = (before, level) else {
            return;
        };
        let wanted = match self.get(CCER) & (CC1P | CC1NP) {
            0 => high,
            CC1P => !high,
            CC1NP => false,
            _ => true,
        };
        let takes = self.input() == 0 && self.counter.clocked && self.captures_input();
        if before == high || !wanted || !takes {
            return;
        }
        self.edges = self.edges.wrapping_add(1);
        if self.edges.is_multiple_of(1 << self.spacing()) {
            self.capture(now, self.get(SR) & CC1IF != 0);
        }
    }

    /// Whether it interrupts.
    pub(crate) fn interrupt(&self) -> bool {
        self.input() == 0 && self.get(SR) & self.get(DIER) & CC1IF != 0
    }

    /// Takes the captures until `now` of an input of `hertz`, given in millionths of a hertz.
    fn advance(&mut self, now: Cycles, clock: &LocalClock, microhertz: u64) {
        if !self.captures_input() || microhertz == 0 {
            return;
        }
        let edges = 1_u128 << self.spacing();
        let span = u128::from(clock.time(now).saturating_sub(self.since));
        // A picosecond and a millionth of a hertz make 10^-18.
        let until = span * u128::from(microhertz) / (edges * 1_000_000_000_000_000_000);
        let until = u64::try_from(until).unwrap_or(u64::MAX);
        if until == self.captures {
            return;
        }
        let missed = until - self.captures > 1 || self.get(SR) & CC1IF != 0;
        self.captures = until;
        let at = u128::from(until) * edges * 1_000_000_000_000_000_000 / u128::from(microhertz);
        let at = self
            .since
            .saturating_add(u64::try_from(at).unwrap_or(u64::MAX));
        self.capture(clock.cycle_from(at).min(now), missed);
    }

    pub(crate) fn read(
        &mut self,
        offset: u32,
        now: Cycles,
        clock: &LocalClock,
        microhertz: u64,
    ) -> Option<u32> {
        self.advance(now, clock, microhertz);
        self.count(now);
        match offset {
            CNT => Some(self.counter.count as u32),
            CCR1 => {
                // Reading the capture clears its flag.
                self.registers[(SR / 4) as usize] &= !CC1IF;
                Some(self.get(CCR1))
            }
            0x00..=0x50 => Some(self.get(offset)),
            _ => None,
        }
    }

    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: Cycles,
        clock: &LocalClock,
        microhertz: u64,
    ) {
        self.advance(now, clock, microhertz);
        self.count(now);
        let before = self.captures_input();
        match offset {
            SR => self.registers[(SR / 4) as usize] &= value,
            EGR if value & UG != 0 => {
                self.counter.count = 0;
                self.counter.phase = 0;
                self.counter.prescaler = self.get(PSC);
            }
            EGR => {}
            CNT => self.counter.count = u64::from(value) % RANGE,
            0x00..=0x50 => self.registers[(offset / 4) as usize] = value,
            _ => {}
        }
        if !before && self.captures_input() {
            self.since = clock.time(now);
            self.captures = 0;
            self.edges = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{
        CC1IF, CC1NP, CC1OF, CC1P, CCER, CCMR1, CCR1, CNT, CR1, Capture, DIER, EGR, OR, PSC, SR,
    };
    use crate::clock::{Cycles, LocalClock};

    /// A timer without an oscillator at its input.
    struct Bench(Capture);

    impl Bench {
        /// 8 core cycles a count, started at cycle 1000; the pin is low. `edges`: polarity.
        fn new(edges: u32) -> Self {
            let mut bench = Self(Capture::default());
            bench.0.drive(Some(false), 0);
            bench.write(PSC, 7, 900);
            bench.write(EGR, 1, 900);
            bench.write(CCMR1, 1, 900);
            bench.write(CCER, 1 | edges, 900);
            bench.write(CR1, 1, 1000);
            bench
        }

        fn write(&mut self, offset: u32, value: u32, now: Cycles) {
            let clock = LocalClock::new(8_000_000, 0, 0);
            self.0.write(offset, value, now, &clock, 0);
        }

        fn read(&mut self, offset: u32, now: Cycles) -> u32 {
            let clock = LocalClock::new(8_000_000, 0, 0);
            self.0.read(offset, now, &clock, 0).unwrap()
        }

        /// A pulse from cycle 1084 to cycle 1168, counts 10 and 21, of which the captures are read.
        fn pulse(&mut self) -> Vec<u32> {
            let mut counts = Vec::new();
            for (at, high) in [(1084, true), (1168, false)] {
                self.0.drive(Some(high), at);
                if self.read(SR, at + 5) & CC1IF != 0 {
                    counts.push(self.read(CCR1, at + 6));
                }
                assert_eq!(
                    self.read(SR, at + 7),
                    0,
                    "reading the capture clears its flag"
                );
            }
            counts
        }
    }

    #[test]
    fn the_edges_of_a_pin_are_captured_by_their_direction() {
        assert_eq!(Bench::new(0).pulse(), [10]);
        assert_eq!(Bench::new(CC1P).pulse(), [21]);
        assert_eq!(Bench::new(CC1P | CC1NP).pulse(), [10, 21]);
        assert!(Bench::new(CC1NP).pulse().is_empty(), "reserved");
        // Every second edge.
        let mut bench = Bench::new(CC1P | CC1NP);
        bench.write(CCMR1, 1 | 1 << 2, 1000);
        assert_eq!(bench.pulse(), [21]);
        // The same level again is no edge.
        bench.0.drive(Some(false), 2000);
        assert_eq!(bench.read(SR, 2000), 0);
    }

    #[test]
    fn a_pin_that_is_not_at_the_input_is_not_captured() {
        let both = CC1P | CC1NP;
        let setups: [fn(&mut Bench); 5] = [
            |bench| bench.write(OR, 2, 1000),
            |bench| bench.write(CCER, 0, 1000),
            |bench| bench.write(CCMR1, 0, 1000),
            |bench| bench.write(CR1, 0, 1000),
            |bench| bench.0.set_clock(1000, false, 1),
        ];
        for setup in setups {
            let mut bench = Bench::new(both);
            setup(&mut bench);
            assert!(bench.pulse().is_empty());
        }
        // It is connected while it is high, and taken away.
        let mut bench = Bench::new(both);
        for level in [None, Some(true), None, Some(false)] {
            bench.0.drive(level, 1100);
            assert_eq!(bench.read(SR, 1100), 0);
        }
    }

    #[test]
    fn a_capture_that_nobody_read_is_told_and_interrupts_only_while_that_is_enabled() {
        let mut bench = Bench::new(0);
        let rise = |bench: &mut Bench, at| {
            bench.0.drive(Some(false), at);
            bench.0.drive(Some(true), at);
        };
        rise(&mut bench, 1100);
        assert!(!bench.0.interrupt());
        assert_eq!(bench.read(SR, 1100), CC1IF);
        bench.write(DIER, CC1IF, 1100);
        assert!(bench.0.interrupt());
        rise(&mut bench, 1200);
        assert_eq!(bench.read(SR, 1200), CC1IF | CC1OF);
        // A one leaves a flag, a zero clears it.
        bench.write(SR, !CC1OF, 1200);
        assert_eq!(bench.read(SR, 1200), CC1IF);
        assert_eq!(bench.read(CCR1, 1200), 25, "the last capture");
        assert!(!bench.0.interrupt());
        rise(&mut bench, 1300);
        assert!(bench.0.interrupt());
        bench.write(SR, 0, 1300);
        assert!(!bench.0.interrupt());
        rise(&mut bench, 1400);
        bench.write(DIER, 0, 1400);
        assert!(!bench.0.interrupt());
        // The part is reset; the pin keeps its level.
        bench.0.reset();
        assert_eq!(bench.read(SR, 1500), 0);
        assert_eq!(bench.0.pin, Some(true));
    }

    #[test]
    fn the_counter_wraps_and_takes_its_prescaler_at_an_update() {
        let mut bench = Bench::new(0);
        assert_eq!(bench.read(CNT, 1000 + 8 * 0x1_0003 + 7), 3);
        // A new prescaler counts from the next overflow on, or from an update by software.
        bench.write(PSC, 0, 1000 + 8 * 0x1_0003 + 7);
        let overflow = 1000 + 8 * 0x2_0000;
        assert_eq!(bench.read(CNT, overflow - 1), 0xFFFF);
        assert_eq!(bench.read(CNT, overflow + 5), 5);
        bench.write(PSC, 3, overflow + 5);
        bench.write(EGR, 1, overflow + 6);
        assert_eq!(bench.read(CNT, overflow + 9), 0);
        assert_eq!(bench.read(CNT, overflow + 10), 1);
        // It stands while it is not enabled, or has no clock, and goes on from there.
        bench.write(CR1, 0, overflow + 12);
        bench.write(CR1, 1, overflow + 1000);
        assert_eq!(bench.read(CNT, overflow + 1001), 1);
        assert_eq!(bench.read(CNT, overflow + 1002), 2);
        bench.0.set_clock(overflow + 1002, false, 1);
        bench.0.set_clock(overflow + 2000, true, 2);
        assert_eq!(bench.read(CNT, overflow + 2007), 2);
        assert_eq!(bench.read(CNT, overflow + 2008), 3);
    }

    #[test]
    fn captures_are_as_far_apart_as_the_edges_of_the_input() {
        // The RC oscillator of 8 MHz is 1 % fast; the input is 250 kHz, of which every eighth edge
        // is captured: 256 counts, and 1 % more.
        let clock = LocalClock::new(8_000_000, 10_000_000, 0);
        let input = 250_000_000_000;
        let mut timer = Capture::default();
        timer.write(CCMR1, 1 | 3 << 2, 0, &clock, input);
        timer.write(CCER, 1, 0, &clock, input);
        timer.write(CR1, 1, 100, &clock, input);
        let mut counts = Vec::new();
        for now in (100..10_000).step_by(10) {
            if timer.read(SR, now, &clock, input).unwrap() & 2 != 0 {
                counts.push(timer.read(CCR1, now, &clock, input).unwrap());
            }
        }
        assert!(counts.len() > 30);
        let gaps: Vec<u32> = counts.windows(2).map(|pair| pair[1] - pair[0]).collect();
        assert!(gaps.iter().all(|gap| matches!(gap, 258 | 259)), "{gaps:?}");
        // Nobody reads: the flag of a missed capture is set.
        assert_ne!(timer.read(SR, 20_000, &clock, input).unwrap() & 1 << 9, 0);
        // Without an input there is nothing to capture.
        let mut idle = Capture::default();
        idle.write(CCMR1, 1, 0, &clock, 0);
        idle.write(CCER, 1, 0, &clock, 0);
        idle.write(CR1, 1, 0, &clock, 0);
        assert_eq!(idle.read(SR, 90_000, &clock, 0), Some(0));
    }
}
