//! TIM1 of the F303 as a maker of pulses: an up-counter with four channels in PWM mode 1, their
//! preload registers, complementary outputs and the break input (RM0316 chapter 20).
//!
//! The break input is that of the clock security system only; a break drives the outputs to their
//! idle level at once, without dead time. Not modelled are interrupts, triggers, captures, other
//! output modes, other directions of counting, the repetition counter, channels 5 and 6, dead time,
//! and a channel that uses both of its outputs: whoever asks for one is told ([`Pulses::write`]).

use crate::clock::{Cycles, NEVER};
use parts::TimerOutput;

const CR1: u32 = 0x00;
const CR2: u32 = 0x04;
const SMCR: u32 = 0x08;
const DIER: u32 = 0x0C;
const SR: u32 = 0x10;
const EGR: u32 = 0x14;
const CCMR1: u32 = 0x18;
const CCMR2: u32 = 0x1C;
const CCER: u32 = 0x20;
const CNT: u32 = 0x24;
const PSC: u32 = 0x28;
const ARR: u32 = 0x2C;
const RCR: u32 = 0x30;
const CCR1: u32 = 0x34;
const CCR4: u32 = 0x40;
const BDTR: u32 = 0x44;
const LAST: u32 = 0x60;

/// CR1: counts, no update events, update flag by overflow only, preload of ARR.
const CEN: u32 = 1;
const UDIS: u32 = 1 << 1;
const URS: u32 = 1 << 2;
const ARPE: u32 = 1 << 7;
/// SR: update, break. EGR: update.
const UIF: u32 = 1;
const BIF: u32 = 1 << 7;
const UG: u32 = 1;
/// BDTR: idle level instead of release, break enabled, active high, main output.
const OSSI: u32 = 1 << 10;
const BKE: u32 = 1 << 12;
const BKP: u32 = 1 << 13;
const MOE: u32 = 1 << 15;
/// CCMR1 and CCMR2: mode and preload of their first channel; the second one is 8 bits further.
const MODE: u32 = 0b111 << 4;
const PWM_1: u32 = 0b110 << 4;
const PRELOAD: u32 = 1 << 3;

/// Channels that are modelled.
const CHANNELS: usize = 4;

/// What the counter and the outputs work with; the registers that the program reads and writes may
/// be ahead of it.
#[derive(Clone, Copy, Debug)]
struct Active {
    prescaler: u32,
    reload: u32,
    compare: [u32; CHANNELS],
}

#[derive(Clone, Debug)]
pub(crate) struct Pulses {
    registers: [u32; LAST as usize / 4 + 1],
    active: Active,
    /// Counter at cycle `since`, with whole ticks only.
    count: u32,
    since: Cycles,
    /// Core cycles per cycle of the timer's clock.
    divider: u64,
    clocked: bool,
}

impl Pulses {
    pub(crate) fn new() -> Self {
        let mut registers = [0; LAST as usize / 4 + 1];
        registers[ARR as usize / 4] = 0xFFFF;
        Self {
            registers,
            active: Active {
                prescaler: 0,
                reload: 0xFFFF,
                compare: [0; CHANNELS],
            },
            count: 0,
            since: 0,
            divider: 1,
            clocked: false,
        }
    }

    pub(crate) fn reset(&mut self) {
        let (divider, clocked, since) = (self.divider, self.clocked, self.since);
        *self = Self {
            divider,
            clocked,
            since,
            ..Self::new()
        };
    }

    fn get(&self, offset: u32) -> u32 {
        self.registers[(offset / 4) as usize]
    }

    fn set(&mut self, offset: u32, value: u32) {
        self.registers[(offset / 4) as usize] = value;
    }

    fn counts(&self) -> bool {
        self.clocked && self.get(CR1) & CEN != 0
    }

    /// Core cycles per count.
    fn tick(&self) -> u64 {
        (u64::from(self.active.prescaler) + 1) * self.divider
    }

    /// Updates the counter to `now`.
    pub(crate) fn advance(&mut self, now: Cycles) {
        if !self.counts() {
            self.since = now.max(self.since);
            return;
        }
        loop {
            let wrap = self.ticks_to(self.active.reload + 1);
            let at = self.since + wrap * self.tick();
            if at > now {
                break;
            }
            self.since = at;
            self.count = 0;
            self.update(true);
        }
        let ticks = now.saturating_sub(self.since) / self.tick();
        self.since += ticks * self.tick();
        self.count = (u64::from(self.count) + ticks) as u32 & 0xFFFF;
    }

    /// Ticks until the counter is at `count`, which it reaches before it wraps at 16 bits.
    fn ticks_to(&self, count: u32) -> u64 {
        let range = 0x1_0000;
        let ahead = (count + range - self.count) % range;
        u64::from(if ahead == 0 { range } else { ahead })
    }

    /// An update event: the preload registers are taken over.
    fn update(&mut self, by_overflow: bool) {
        let control = self.get(CR1);
        if control & UDIS != 0 {
            return;
        }
        if by_overflow || control & URS == 0 {
            self.set(SR, self.get(SR) | UIF);
        }
        self.active = Active {
            prescaler: self.get(PSC),
            reload: self.get(ARR),
            compare: core::array::from_fn(|k| self.get(CCR1 + 4 * k as u32)),
        };
    }

    /// Opens or closes the clock gate, or changes the core cycles per cycle of the timer.
    pub(crate) fn set_clock(&mut self, now: Cycles, clocked: bool, divider: u64) {
        if clocked == self.clocked && divider == self.divider {
            return;
        }
        self.advance(now);
        self.since = now;
        self.clocked = clocked;
        self.divider = divider;
    }

    /// The next cycle at which an output may change.
    pub(crate) fn next_event(&self) -> Cycles {
        if !self.counts() {
            return NEVER;
        }
        let wrap = self.ticks_to(self.active.reload + 1);
        let compares = (0..CHANNELS).filter(|&k| self.is_pwm(k)).map(|k| {
            let ticks = self.ticks_to(self.active.compare[k]);
            if ticks < wrap { ticks } else { wrap }
        });
        let ticks = compares.min().unwrap_or(wrap).min(wrap);
        self.since + ticks * self.tick()
    }

    /// Mode and preload of a channel, counted from 0, in the bits of the first channel.
    fn mode(&self, channel: usize) -> u32 {
        let register = if channel < 2 { CCMR1 } else { CCMR2 };
        self.get(register) >> (8 * (channel % 2))
    }

    fn is_pwm(&self, channel: usize) -> bool {
        self.mode(channel) & MODE == PWM_1
    }

    /// The level that the timer gives to an output; `None` while it drives none.
    pub(crate) fn level(&self, output: TimerOutput) -> Option<bool> {
        let channel = usize::from(output.channel).checked_sub(1)?;
        let enabled = self.get(CCER) >> (4 * channel) & 0b101;
        let own = if output.complementary { 0b100 } else { 0b001 };
        let break_register = self.get(BDTR);
        if break_register & MOE == 0 {
            return (break_register & OSSI != 0 && enabled != 0).then_some(false);
        }
        let compare = *self.active.compare.get(channel)?;
        (enabled == own).then(|| self.is_pwm(channel) && self.count < compare)
    }

    /// The clock security system has found the external clock missing.
    pub(crate) fn clock_failed(&mut self) {
        let break_register = self.get(BDTR);
        if self.clocked && break_register & BKE != 0 {
            self.set(BDTR, break_register & !MOE);
            self.set(SR, self.get(SR) | BIF);
        }
    }

    pub(crate) fn read(&mut self, offset: u32, now: Cycles) -> Option<u32> {
        self.advance(now);
        match offset {
            CNT => Some(self.count),
            0x00..=LAST if offset != 0x50 => Some(self.get(offset)),
            _ => None,
        }
    }

    /// Writes a register. The result says which bits ask for something that is not modelled.
    #[must_use]
    pub(crate) fn write(&mut self, offset: u32, value: u32, now: Cycles) -> Option<u32> {
        self.advance(now);
        match offset {
            SR => self.set(SR, self.get(SR) & value),
            EGR if value & UG != 0 => {
                self.count = 0;
                self.since = now;
                self.update(false);
            }
            EGR => {}
            CNT => {
                self.count = value & 0xFFFF;
                self.since = now;
            }
            CCR1..=CCR4 => {
                self.set(offset, value);
                let channel = ((offset - CCR1) / 4) as usize;
                if self.mode(channel) & PRELOAD == 0 {
                    self.active.compare[channel] = value;
                }
            }
            ARR => {
                self.set(offset, value);
                if self.get(CR1) & ARPE == 0 {
                    self.active.reload = value;
                }
            }
            0x00..=LAST => self.set(offset, value),
            _ => {}
        }
        let other = value & !modelled(offset);
        // The polarity of the break input has to suit the clock security system's pin-less input.
        let wrong_break = offset == BDTR && value & (BKE | BKP) == BKE;
        let both = |k: u32| offset == CCER && value >> (4 * k) & 0b101 == 0b101;
        let modes = |k: u32| {
            matches!(offset, CCMR1 | CCMR2) && !matches!(value >> (8 * k) & MODE, 0 | PWM_1)
        };
        let refused = other
            | if wrong_break { BKP } else { 0 }
            | (0..4)
                .filter(|&k| both(k))
                .fold(0, |bits, k| bits | 0b101 << (4 * k))
            | (0..2)
                .filter(|&k| modes(k))
                .fold(0, |bits, k| bits | MODE << (8 * k));
        (refused != 0).then_some(refused)
    }
}

/// The bits of a register that may be set.
fn modelled(offset: u32) -> u32 {
    match offset {
        CR1 => CEN | UDIS | URS | ARPE,
        SR => u32::MAX,
        EGR => UG,
        CCMR1 | CCMR2 => (MODE | PRELOAD) * 0x0101,
        CCER => 0x5555,
        CNT | PSC | ARR | CCR1..=CCR4 => 0xFFFF,
        BDTR => OSSI | BKE | BKP | MOE,
        CR2 | SMCR | DIER | RCR => 0,
        _ => 0,
    }
}

#[cfg(test)]
mod tests {
    use super::{
        ARR, BDTR, BIF, BKE, BKP, CCER, CCMR1, CCMR2, CCR1, CEN, CNT, CR1, DIER, EGR, MOE, OSSI,
        PRELOAD, PSC, PWM_1, Pulses, SR, UDIS, UG,
    };
    use parts::TimerOutput;

    const LEFT: TimerOutput = TimerOutput {
        timer: 1,
        channel: 1,
        complementary: true,
    };
    const RIGHT: TimerOutput = TimerOutput {
        timer: 1,
        channel: 3,
        complementary: false,
    };
    const CCR3: u32 = CCR1 + 8;

    /// Ticks of 72 core cycles, period 5000 of them, pulses of 1500 and 1600, started at cycle 0.
    fn running() -> Pulses {
        let mut timer = Pulses::new();
        timer.set_clock(0, true, 1);
        for (offset, value) in [
            (PSC, 71),
            (ARR, 4999),
            (CCR1, 1500),
            (CCR3, 1600),
            (CCMR1, PWM_1 | PRELOAD),
            (CCMR2, PWM_1 | PRELOAD),
            (EGR, UG),
            (BDTR, MOE | OSSI | BKE | BKP),
            (CCER, 1 << 2 | 1 << 8),
            (CR1, CEN),
        ] {
            assert_eq!(timer.write(offset, value, 0), None, "{offset:#x}");
        }
        timer
    }

    fn levels(timer: &Pulses) -> (Option<bool>, Option<bool>) {
        (timer.level(LEFT), timer.level(RIGHT))
    }

    const HIGH: Option<bool> = Some(true);
    const LOW: Option<bool> = Some(false);

    /// Instants at which the levels of the outputs change, until cycle `until`.
    fn edges(timer: &mut Pulses, until: u64) -> Vec<(u64, bool, bool)> {
        let mut before = levels(timer);
        let mut found = Vec::new();
        while timer.next_event() <= until {
            let at = timer.next_event();
            timer.advance(at);
            let after = levels(timer);
            if after != before {
                found.push((at / 72, after.0.unwrap(), after.1.unwrap()));
            }
            before = after;
        }
        found
    }

    #[test]
    fn pulses_are_as_wide_as_their_compare_values_and_follow_in_the_period() {
        let mut timer = running();
        assert_eq!(levels(&timer), (HIGH, HIGH));
        let expected = [
            (1500, false, true),
            (1600, false, false),
            (5000, true, true),
            (6500, false, true),
            (6600, false, false),
            (10_000, true, true),
        ];
        assert_eq!(edges(&mut timer, 10_000 * 72), expected);
    }

    #[test]
    fn a_preloaded_width_counts_from_the_next_update() {
        let mut timer = running();
        assert_eq!(timer.write(CCR1, 1000, 500 * 72), None);
        assert_eq!(
            edges(&mut timer, 6100 * 72),
            [
                (1500, false, true),
                (1600, false, false),
                (5000, true, true),
                (6000, false, true)
            ]
        );
        // While update events are off, the old width stays.
        assert_eq!(timer.write(CR1, CEN | UDIS, 7000 * 72), None);
        assert_eq!(timer.write(CCR1, 2000, 7000 * 72), None);
        let first = edges(&mut timer, 11_200 * 72);
        assert_eq!(first[1], (11_000, false, true), "{first:?}");
    }

    #[test]
    fn an_update_by_software_restarts_the_pulses_at_once() {
        let mut timer = running();
        edges(&mut timer, 3000 * 72);
        let at = 3000 * 72 + 17;
        assert_eq!(timer.write(CCR3, 1100, at), None);
        assert_eq!(levels(&timer), (LOW, LOW));
        assert_eq!(timer.write(EGR, UG, at), None);
        assert_eq!(levels(&timer), (HIGH, HIGH));
        assert_eq!(timer.next_event(), at + 1100 * 72);
        assert_eq!(timer.read(CNT, at + 71), Some(0));
        assert_eq!(timer.read(CNT, at + 72), Some(1));
    }

    #[test]
    fn a_lost_clock_ends_the_pulses_and_a_closed_gate_or_no_main_output_releases_them() {
        let mut timer = running();
        timer.advance(100);
        timer.clock_failed();
        assert_eq!(levels(&timer), (LOW, LOW));
        assert_ne!(timer.read(SR, 100).unwrap() & BIF, 0);
        assert_eq!(timer.read(BDTR, 100).unwrap() & MOE, 0);
        // Without the break input nothing happens.
        let mut timer = running();
        assert_eq!(timer.write(BDTR, MOE, 10), None);
        timer.clock_failed();
        assert_eq!(levels(&timer), (HIGH, HIGH));
        assert_eq!(timer.write(BDTR, 0, 10), None);
        assert_eq!(levels(&timer), (None, None));
        let mut timer = running();
        timer.set_clock(72 * 100, false, 1);
        assert_eq!(timer.next_event(), u64::MAX);
        timer.advance(72 * 9000);
        assert_eq!(levels(&timer), (HIGH, HIGH), "it stands still");
    }

    #[test]
    fn what_is_not_modelled_is_told() {
        let mut timer = running();
        for (offset, value, bits) in [
            (CR1, CEN | 1 << 3, 1 << 3),
            (DIER, 1, 1),
            (CCMR1, 0b111 << 4, 0b111 << 4),
            (CCER, 0b101, 0b101),
            (CCER, 1 << 1, 1 << 1),
            (BDTR, MOE | BKE, BKP),
            (BDTR, 4, 4),
            (EGR, 1 << 7, 1 << 7),
        ] {
            assert_eq!(timer.write(offset, value, 0), Some(bits), "{offset:#x}");
        }
    }
}
