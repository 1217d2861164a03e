//! A general-purpose timer, or the basic timer TIM7 of the F303 (RM0316 chapter 22): rsemu's model, which
//! counts ticks of its own clock, driven by the node's core cycles.
//!
//! Of TIM7, the requests to a DMA controller and the trigger for the converter to analogue are not modelled.

use crate::clock::{Cycles, NEVER};
use parts::interrupt;
use rsemu::core::device::{Device, ResetKind, SinkPin};
use rsemu::core::props::Props;
use rsemu::core::space::MemOps;
use rsemu::core::wire::{Level, Wire, WireId, WireIdAllocator, WireSink, WireSource};
use rsemu::dev::stm32::tim::{IRQ_PIN, TRGO_PIN, Tim};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};

/// The level of an output, and the number of its rising edges.
#[derive(Debug, Default)]
struct Probe {
    high: AtomicBool,
    rises: AtomicU32,
}

impl WireSink for Probe {
    fn set_level(&self, _source: WireId, _line: u32, level: Level) {
        let high = level == Level::High;
        if high && !self.high.swap(high, Ordering::Relaxed) {
            self.rises.fetch_add(1, Ordering::Relaxed);
        }
        self.high.store(high, Ordering::Relaxed);
    }
}

impl Probe {
    /// Takes over what another one has seen.
    fn follow(&self, other: &Self) {
        self.high
            .store(other.high.load(Ordering::Relaxed), Ordering::Relaxed);
        self.rises
            .store(other.rises.load(Ordering::Relaxed), Ordering::Relaxed);
    }
}

#[derive(Debug)]
pub(crate) struct Timer {
    number: u8,
    model: Tim,
    registers: Arc<dyn MemOps>,
    interrupt: Arc<Probe>,
    trigger: Arc<Probe>,
    /// The input of channel 1.
    input: Option<Input>,
    /// Core cycles per tick, and the tick that corresponds to a given cycle.
    divider: u64,
    origin_cycle: Cycles,
    origin_tick: u64,
    /// True while the timer's clock gate is open.
    clocked: bool,
}

/// A line to an input of the model, and its level.
#[derive(Debug)]
struct Input {
    pin: SinkPin,
    id: WireId,
    high: bool,
}

impl Input {
    fn drive(&mut self, high: bool) {
        self.high = high;
        let level = if high { Level::High } else { Level::Low };
        self.pin.sink.set_level(self.id, self.pin.line, level);
    }
}

impl Clone for Timer {
    fn clone(&self) -> Self {
        let mut copy = Self::new(self.number).expect("a timer of this number has been made before");
        if let (Some(input), Some(own)) = (&mut copy.input, &self.input) {
            input.drive(own.high);
        }
        super::transfer(&self.model, &copy.model);
        // The model drives its outputs as it takes its state over.
        copy.interrupt.follow(&self.interrupt);
        copy.trigger.follow(&self.trigger);
        Self {
            divider: self.divider,
            origin_cycle: self.origin_cycle,
            origin_tick: self.origin_tick,
            clocked: self.clocked,
            ..copy
        }
    }
}

impl Timer {
    /// TIM2 counts over 32 bits, the others over 16. TIM7 has no channels.
    pub(crate) fn new(number: u8) -> Result<Self, rsemu::Error> {
        let width = if number == 2 { 32_u64 } else { 16 };
        let reset = if width == 32 { 0xFFFF_FFFF_u64 } else { 0xFFFF };
        let (variant, channels) = if number == 7 {
            ("basic", 0_u64)
        } else {
            ("general", 4)
        };
        let model = Tim::new(
            &Props::new()
                .with("variant", variant)
                .with("width", width)
                .with("channels", channels)
                .with("arr-reset", reset),
        )?;
        let interrupt = Arc::new(Probe::default());
        let trigger = Arc::new(Probe::default());
        let ids = WireIdAllocator::new();
        for (port, probe) in [(IRQ_PIN, &interrupt), (TRGO_PIN, &trigger)] {
            let id = ids.alloc();
            let wire = Wire::builder()
                .source(id)
                .sink(Arc::clone(probe) as Arc<dyn WireSink>, 0)
                .build_shared();
            model.connect(port, WireSource::new(wire, id))?;
        }
        let id = ids.alloc();
        let input = model.sink("ti1", &[id]);
        let input = input.map(|pin| Input {
            pin,
            id,
            high: false,
        });
        let registers = super::registers_of(&model);
        Ok(Self {
            number,
            model,
            registers,
            interrupt,
            trigger,
            input,
            divider: 1,
            origin_cycle: 0,
            origin_tick: 0,
            clocked: false,
        })
    }

    pub(crate) fn reset(&mut self) {
        self.model.reset(ResetKind::Cold);
        // The pin keeps its level.
        if let Some(input) = &mut self.input {
            let high = input.high;
            input.drive(!high);
            input.drive(high);
        }
    }

    fn tick(&self, now: Cycles) -> u64 {
        self.origin_tick + now.saturating_sub(self.origin_cycle) / self.divider
    }

    /// Updates the counter to `now`. It stops while the timer has no clock.
    pub(crate) fn advance(&mut self, now: Cycles) {
        if self.clocked {
            self.model.advance_to(self.tick(now));
        }
    }

    /// Opens or closes the clock gate, or changes the core cycles per tick.
    pub(crate) fn set_clock(&mut self, now: Cycles, clocked: bool, divider: u64) {
        if clocked == self.clocked && divider == self.divider {
            return;
        }
        self.advance(now);
        self.origin_tick = if self.clocked {
            self.tick(now)
        } else {
            self.origin_tick
        };
        self.origin_cycle = now;
        self.clocked = clocked;
        self.divider = divider;
    }

    pub(crate) fn next_event(&self) -> Cycles {
        if !self.clocked {
            return NEVER;
        }
        self.model.next_event().map_or(NEVER, |tick| {
            tick.saturating_sub(self.origin_tick)
                .saturating_mul(self.divider)
                .saturating_add(self.origin_cycle)
        })
    }

    pub(crate) fn read(&mut self, offset: u32, now: Cycles) -> Option<u32> {
        if offset > 0x50 {
            return None;
        }
        self.advance(now);
        super::read_word(&*self.registers, offset)
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: Cycles) {
        self.advance(now);
        super::write_word(&*self.registers, offset, value);
    }

    /// The pin of channel 1 takes a level.
    pub(crate) fn drive(&mut self, high: bool, now: Cycles) {
        self.advance(now);
        if let Some(input) = self.input.as_mut().filter(|input| input.high != high) {
            input.drive(high);
        }
    }

    /// Number of its interrupt.
    pub(crate) fn irq(&self) -> u16 {
        match self.number {
            7 => interrupt::TIM7,
            number => interrupt::TIM2 + u16::from(number) - 2,
        }
    }

    pub(crate) fn interrupt(&self) -> bool {
        self.interrupt.high.load(Ordering::Relaxed)
    }

    /// Rising edges of TRGO since the last call.
    pub(crate) fn take_triggers(&self) -> u32 {
        self.trigger.rises.swap(0, Ordering::Relaxed)
    }
}

#[cfg(test)]
mod tests {
    use super::Timer;

    const CR1: u32 = 0x00;
    const CR2: u32 = 0x04;
    const DIER: u32 = 0x0C;
    const SR: u32 = 0x10;
    const EGR: u32 = 0x14;
    const CNT: u32 = 0x24;
    const PSC: u32 = 0x28;
    const ARR: u32 = 0x2C;
    const CCR1: u32 = 0x34;

    /// Ticks of two core cycles, prescaled by five: 18 MHz from 180 MHz.
    fn time_base() -> Timer {
        let mut timer = Timer::new(2).unwrap();
        timer.set_clock(1000, true, 2);
        timer.write(PSC, 4, 1000);
        timer.write(ARR, u32::MAX, 1000);
        timer.write(EGR, 1, 1000);
        timer.write(SR, 0, 1000);
        timer.write(CR1, 1, 1000);
        timer
    }

    #[test]
    fn the_counter_follows_the_core_clock_through_both_dividers() {
        let mut timer = time_base();
        assert_eq!(timer.read(CNT, 1009), Some(0));
        assert_eq!(timer.read(CNT, 1010), Some(1));
        assert_eq!(timer.read(CNT, 1000 + 180_000_000), Some(18_000_000));
    }

    #[test]
    fn a_compare_match_interrupts_in_its_own_cycle() {
        let mut timer = time_base();
        timer.write(CCR1, 100, 1100);
        timer.write(DIER, 1 << 1, 1100);
        assert_eq!(timer.next_event(), 2000);
        timer.advance(1999);
        assert!(!timer.interrupt());
        timer.advance(2000);
        assert!(timer.interrupt());
        assert_eq!(timer.read(SR, 2000).unwrap() & 1 << 1, 1 << 1);
        timer.write(SR, !(1 << 1), 2100);
        assert!(!timer.interrupt());
    }

    #[test]
    fn the_update_event_goes_out_as_a_trigger() {
        let mut timer = Timer::new(3).unwrap();
        timer.set_clock(0, true, 1);
        timer.write(PSC, 71, 0);
        timer.write(ARR, 4999, 0);
        timer.write(EGR, 1, 0);
        timer.write(CR2, 0b010 << 4, 0);
        timer.take_triggers();
        timer.write(CR1, 1, 0);
        timer.advance(359_999);
        assert_eq!(timer.take_triggers(), 0);
        timer.advance(360_000);
        assert_eq!(timer.take_triggers(), 1);
        timer.advance(720_000);
        assert_eq!(timer.take_triggers(), 1);
    }

    const CEN: u32 = 1;
    const URS: u32 = 1 << 2;
    const OPM: u32 = 1 << 3;

    /// TIM7 at 8 core cycles a count, which stops after 100 counts; started at cycle 1000.
    fn alarm(enabled: u32) -> Timer {
        let mut timer = Timer::new(7).unwrap();
        timer.set_clock(1000, true, 1);
        timer.write(CR1, URS, 1000);
        timer.write(PSC, 7, 1000);
        timer.write(ARR, 99, 1000);
        timer.write(EGR, 1, 1000);
        timer.write(DIER, enabled, 1000);
        timer.write(CR1, URS | OPM | CEN, 1000);
        timer
    }

    #[test]
    fn one_pulse_of_tim7_ends_in_the_cycle_of_the_overflow() {
        let mut timer = alarm(1);
        assert_eq!(timer.irq(), 55);
        assert_eq!(timer.read(SR, 1000), Some(0), "URS: no flag by UG");
        assert_eq!(timer.next_event(), 1800);
        timer.advance(1799);
        assert_eq!(timer.read(CNT, 1799), Some(99));
        assert!(!timer.interrupt());
        timer.advance(1800);
        assert!(timer.interrupt());
        assert_eq!(timer.read(CR1, 1800), Some(URS | OPM));
        assert_eq!(timer.read(CNT, 9000), Some(0), "it stands");
        timer.write(SR, 1, 9000);
        assert!(timer.interrupt(), "a one leaves the flag");
        timer.write(SR, 0, 9000);
        assert!(!timer.interrupt());
        assert_eq!(timer.next_event(), u64::MAX);
    }

    #[test]
    fn a_flag_of_tim7_that_is_not_enabled_raises_nothing() {
        let mut timer = alarm(0);
        timer.advance(1800);
        assert_eq!(timer.read(SR, 1800), Some(1));
        assert!(!timer.interrupt());
        timer.write(DIER, 1, 1900);
        assert!(timer.interrupt());
        // Without URS, UG sets the flag as an overflow does.
        let mut timer = alarm(1);
        timer.write(CR1, OPM | CEN, 1100);
        timer.write(EGR, 1, 1100);
        assert!(timer.interrupt());
    }

    #[test]
    fn an_update_by_software_restarts_tim7_with_its_prescaler() {
        let mut timer = alarm(1);
        // In the middle of a count.
        timer.write(EGR, 1, 1403);
        assert_eq!(timer.read(CNT, 1410), Some(0));
        assert_eq!(timer.read(CNT, 1411), Some(1));
        assert_eq!(timer.next_event(), 1403 + 800);
        // Without preload a new end counts at once, a new prescaler from the next update on.
        timer.write(ARR, 199, 1411);
        timer.write(PSC, 0, 1411);
        assert_eq!(timer.next_event(), 1403 + 1600);
        timer.write(EGR, 1, 1500);
        assert_eq!(timer.next_event(), 1500 + 200);
    }

    #[test]
    fn a_stopped_clock_holds_the_counter_and_a_slower_one_counts_slower() {
        let mut timer = time_base();
        timer.set_clock(2000, false, 2);
        timer.advance(50_000);
        timer.set_clock(50_000, true, 4);
        assert_eq!(timer.read(CNT, 50_000), Some(100));
        assert_eq!(timer.read(CNT, 50_020), Some(101));
    }
}
