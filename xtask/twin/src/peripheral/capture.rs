//! The timer that measures an oscillator of its own part: TIM11 of the F446, TIM16 of the F303.
//! Its channel 1 captures every edge, or every second, fourth or eighth one, of a clock inside the
//! part (RM0390 20.5 and 20.6.11, RM0316 23.5 and 23.6).
//!
//! The counter runs on the core's clock as long as APB2 is not divided. Nothing else is modelled:
//! no interrupts, no outputs, no capture from a pin.

use crate::clock::{Cycles, LocalClock, Ps};

const CR1: u32 = 0x00;
const SR: u32 = 0x10;
const EGR: u32 = 0x14;
const CCMR1: u32 = 0x18;
const CCER: u32 = 0x20;
const CNT: u32 = 0x24;
const PSC: u32 = 0x28;
const CCR1: u32 = 0x34;
const OR: u32 = 0x50;

const CC1IF: u32 = 1 << 1;
const CC1OF: u32 = 1 << 9;

#[derive(Clone, Debug, Default)]
pub(crate) struct Capture {
    registers: [u32; 0x54 / 4],
    /// When the counter was started.
    origin: Cycles,
    /// When the captures were switched on, and how many of them there were.
    since: Ps,
    captures: u64,
}

impl Capture {
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    fn get(&self, offset: u32) -> u32 {
        self.registers[(offset / 4) as usize]
    }

    /// Selection of the input: the option register.
    pub(crate) fn input(&self) -> u32 {
        self.get(OR) & 3
    }

    fn captures_input(&self) -> bool {
        self.get(CCER) & 1 != 0 && self.get(CCMR1) & 3 == 1 && self.get(CR1) & 1 != 0
    }

    fn count(&self, now: Cycles) -> u32 {
        if self.get(CR1) & 1 == 0 {
            return self.get(CNT);
        }
        let prescaler = u64::from(self.get(PSC)) + 1;
        (now.saturating_sub(self.origin) / prescaler) as u32 & 0xFFFF
    }

    /// Takes the captures until `now` of an input of `hertz`, given in millionths of a hertz.
    fn advance(&mut self, now: Cycles, clock: &LocalClock, microhertz: u64) {
        if !self.captures_input() || microhertz == 0 {
            return;
        }
        let edges = 1_u128 << (self.get(CCMR1) >> 2 & 3);
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
        let count = self.count(clock.cycle_from(at).min(now));
        self.registers[(CCR1 / 4) as usize] = count;
        self.registers[(SR / 4) as usize] |= CC1IF | if missed { CC1OF } else { 0 };
    }

    pub(crate) fn read(
        &mut self,
        offset: u32,
        now: Cycles,
        clock: &LocalClock,
        microhertz: u64,
    ) -> Option<u32> {
        self.advance(now, clock, microhertz);
        match offset {
            CNT => Some(self.count(now)),
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
        let before = (self.captures_input(), self.get(CR1) & 1);
        match offset {
            SR => self.registers[(SR / 4) as usize] &= value,
            EGR => self.origin = now,
            CNT => self.origin = now,
            0x00..=0x50 => self.registers[(offset / 4) as usize] = value,
            _ => {}
        }
        if before.1 == 0 && self.get(CR1) & 1 != 0 {
            self.origin = now;
        }
        if !before.0 && self.captures_input() {
            self.since = clock.time(now);
            self.captures = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{CCER, CCMR1, CCR1, CR1, Capture, SR};
    use crate::clock::LocalClock;

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
