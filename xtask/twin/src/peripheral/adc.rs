//! The first ADC of both parts: sequences started by software or by a timer's trigger, conversion
//! times, DMA requests (RM0390 chapter 13, RM0316 chapter 15).
//!
//! The twin holds a 12-bit reading for each channel. A conversion takes the reading at the end of
//! its sampling time. Not modelled are resolutions below 12 bits, left alignment, offsets,
//! oversampling, injected conversions, analogue watchdogs, differential inputs and the dual modes:
//! their registers only read back what was written. The F303's configuration is checked: a bit that
//! asks for one of these, or a setting that changes while the converter is started, is a violation.

use crate::clock::{Cycles, NEVER};
use crate::part::Family;

/// Start-up of the F303's voltage regulator: 10 us (data sheet, T_ADCVREG_STUP). Enabling or
/// calibrating earlier violates the data sheet; the model ignores it.
const REGULATOR_PS: u64 = 10_000_000;

/// The internal reference voltage, mV (data sheets, table of the embedded reference: 1.20 to 1.24
/// V on the F446, 1.20 to 1.25 V on the F303).
const REFERENCE: u32 = 1210;

/// The factory's reading of the internal reference at a supply of 3.3 V.
pub(crate) const REFERENCE_COUNT: u16 = (REFERENCE * 4095 / 3300) as u16;

/// Number of channels of an ADC.
pub(crate) const CHANNELS: usize = 19;

#[derive(Clone, Debug)]
struct Sequence {
    /// Next rank to convert.
    rank: usize,
    /// When the channel is sampled, and when its conversion ends.
    sample: Cycles,
    end: Cycles,
    value: Option<u16>,
}

#[derive(Clone, Debug)]
pub(crate) struct Adc {
    family: Family,
    registers: [u32; 0xC0 / 4],
    common: u32,
    /// Core cycles per cycle of the converter's clock.
    clock: u64,
    inputs: [u16; CHANNELS],
    /// Supply of the part, mV.
    supply: u32,
    sequence: Option<Sequence>,
    /// When conversions were begun that nobody has asked for yet, and their first channel.
    begun: Option<(Cycles, usize)>,
    data: u32,
    /// A value is ready for the DMA controller.
    request: bool,
    /// The DMA controller has filled its buffer in one-shot mode (DDS or DMACFG clear): there are
    /// no further requests.
    dma_done: bool,
    // F303 only.
    regulator_ready: Cycles,
    calibration_end: Cycles,
    armed: bool,
    // Flags.
    end_of_conversion: bool,
    end_of_sequence: bool,
    started: bool,
    overrun: bool,
    ready: bool,
    enabled: bool,
}

impl Adc {
    pub(crate) fn new(family: Family) -> Self {
        let mut registers = [0; 0xC0 / 4];
        if family == Family::F3 {
            // ADVREGEN "10": off.
            registers[0x08 / 4] = 0b10 << 28;
        }
        Self {
            family,
            registers,
            common: 0,
            clock: 1,
            inputs: [0; CHANNELS],
            supply: 3300,
            sequence: None,
            begun: None,
            data: 0,
            request: false,
            dma_done: false,
            regulator_ready: NEVER,
            calibration_end: NEVER,
            armed: false,
            end_of_conversion: false,
            end_of_sequence: false,
            started: false,
            overrun: false,
            ready: false,
            enabled: false,
        }
    }

    /// Resets the converter. The readings at its inputs stay.
    pub(crate) fn reset(&mut self) {
        let inputs = self.inputs;
        let supply = self.supply;
        let clock = self.clock;
        *self = Self::new(self.family);
        self.inputs = inputs;
        self.supply = supply;
        self.clock = clock;
    }

    pub(crate) fn set_input(&mut self, channel: usize, count: u16) {
        if let Some(input) = self.inputs.get_mut(channel) {
            *input = count.min(0xFFF);
        }
    }

    pub(crate) fn set_supply(&mut self, millivolts: u16) {
        self.supply = u32::from(millivolts);
    }

    /// The reading of a channel. That of the internal reference is zero until it is switched on
    /// (TSVREFE, VREFEN).
    fn reading(&self, channel: usize) -> u16 {
        let (reference, switch) = match self.family {
            Family::F4 => (17, 23),
            Family::F3 => (18, 22),
        };
        if channel != reference {
            return self.inputs[channel];
        }
        let on = self.common >> switch & 1;
        let count = on * REFERENCE * 4095 / self.supply.max(1);
        u16::try_from(count).unwrap_or(u16::MAX).min(0xFFF)
    }

    /// Sets the core cycles per cycle of APB2 and of the F303's own ADC clock.
    pub(crate) fn set_clock(&mut self, apb2: u64, asynchronous: u64) {
        self.clock = match self.family {
            Family::F4 => apb2 * 2 * (u64::from(self.common >> 16 & 3) + 1),
            Family::F3 => match self.common >> 16 & 3 {
                0 => asynchronous,
                1 => 1,
                2 => 2,
                _ => 4,
            },
        }
        .max(1);
    }

    pub(crate) fn rescale(&mut self, now: Cycles, scale: impl Fn(Cycles) -> Cycles) {
        let fix = |at: &mut Cycles| {
            if *at != NEVER && *at > now {
                *at = scale(*at);
            }
        };
        if let Some(sequence) = &mut self.sequence {
            fix(&mut sequence.sample);
            fix(&mut sequence.end);
        }
        fix(&mut self.regulator_ready);
        fix(&mut self.calibration_end);
    }

    fn get(&self, offset: u32) -> u32 {
        self.registers[(offset / 4) as usize]
    }

    /// The control register that holds the trigger selection, and its value.
    fn trigger_control(&self) -> (u32, u32) {
        match self.family {
            Family::F4 => {
                let cr2 = self.get(0x08);
                (cr2 >> 28 & 3, cr2 >> 24 & 0xF)
            }
            Family::F3 => {
                let cfgr = self.get(0x0C);
                (cfgr >> 10 & 3, cfgr >> 6 & 0xF)
            }
        }
    }

    /// Selection code of TIM3's TRGO (RM0390 table 69, RM0316 table 86).
    const fn tim3_code(&self) -> u32 {
        match self.family {
            Family::F4 => 0b1000,
            Family::F3 => 0b0100,
        }
    }

    /// AHB cycles in a cycle of the converter's clock, while the converter is on.
    pub(crate) fn running_clock(&self) -> Option<u64> {
        self.on().then_some(self.clock)
    }

    fn on(&self) -> bool {
        match self.family {
            Family::F4 => self.get(0x08) & 1 != 0,
            Family::F3 => self.enabled,
        }
    }

    /// A rising edge of TIM3's TRGO.
    pub(crate) fn tim3_trigger(&mut self, now: Cycles) {
        let (edge, code) = self.trigger_control();
        let listens = match self.family {
            Family::F4 => true,
            Family::F3 => self.armed,
        };
        if edge & 1 != 0 && code == self.tim3_code() && listens {
            self.start(now);
        }
    }

    fn start(&mut self, now: Cycles) {
        if self.on() && self.sequence.is_none() {
            self.started = true;
            self.begun = Some((now, self.channel(0)));
            self.convert(0, now);
        }
    }

    /// When conversions were begun by a trigger or by software since the last call, and their first
    /// channel. Those that follow by themselves in continuous mode do not count.
    pub(crate) fn take_begun(&mut self) -> Option<(Cycles, usize)> {
        self.begun.take()
    }

    fn length(&self) -> usize {
        match self.family {
            Family::F4 if self.get(0x04) & 1 << 8 == 0 => 1,
            Family::F4 => (self.get(0x2C) >> 20 & 0xF) as usize + 1,
            Family::F3 => (self.get(0x30) & 0xF) as usize + 1,
        }
    }

    fn channel(&self, rank: usize) -> usize {
        let channel = match self.family {
            Family::F4 => {
                let register = [0x34, 0x30, 0x2C][rank / 6];
                self.get(register) >> (5 * (rank % 6))
            }
            Family::F3 => {
                // Rank 1 sits at bit 6 of SQR1; five to a register from there on.
                let position = rank + 1;
                self.get(0x30 + 4 * (position / 5) as u32) >> (6 * (position % 5))
            }
        };
        (channel & 0x1F) as usize % CHANNELS
    }

    /// Sampling time in half cycles of the converter's clock.
    fn sampling_halves(&self, channel: usize) -> u64 {
        match self.family {
            Family::F4 => {
                let (register, index) = if channel < 10 {
                    (0x10, channel)
                } else {
                    (0x0C, channel - 10)
                };
                [6, 30, 56, 112, 168, 224, 288, 960]
                    [(self.get(register) >> (3 * index) & 7) as usize]
            }
            Family::F3 => {
                let (register, index) = if channel < 10 {
                    (0x14, channel)
                } else {
                    (0x18, channel - 10)
                };
                [3, 5, 9, 15, 39, 123, 363, 1203][(self.get(register) >> (3 * index) & 7) as usize]
            }
        }
    }

    fn convert(&mut self, rank: usize, now: Cycles) {
        // Twelve cycles for twelve bits, twelve and a half on the F303.
        let conversion = match self.family {
            Family::F4 => 24,
            Family::F3 => 25,
        };
        let halves = self.sampling_halves(self.channel(rank));
        let sample = now + (halves * self.clock).div_ceil(2);
        let end = now + ((halves + conversion) * self.clock).div_ceil(2);
        self.sequence = Some(Sequence {
            rank,
            sample,
            end,
            value: None,
        });
    }

    pub(crate) fn next_event(&self) -> Cycles {
        self.sequence
            .as_ref()
            .map_or(NEVER, |s| if s.value.is_none() { s.sample } else { s.end })
    }

    pub(crate) fn advance(&mut self, now: Cycles) {
        let Some(sequence) = &self.sequence else {
            return;
        };
        let (rank, end) = (sequence.rank, sequence.end);
        if sequence.value.is_none() && sequence.sample <= now {
            let value = self.reading(self.channel(rank));
            if let Some(sequence) = &mut self.sequence {
                sequence.value = Some(value);
            }
        } else if let Some(value) = sequence.value
            && end <= now
        {
            self.sequence = None;
            self.finish(rank, value, end);
        }
    }

    fn dma_enabled(&self) -> bool {
        match self.family {
            Family::F4 => self.get(0x08) & 1 << 8 != 0,
            Family::F3 => self.get(0x0C) & 1 != 0,
        }
    }

    /// True if requests continue after the DMA controller's buffer is full: DDS, DMACFG.
    fn dma_continues(&self) -> bool {
        match self.family {
            Family::F4 => self.get(0x08) & 1 << 9 != 0,
            Family::F3 => self.get(0x0C) & 1 << 1 != 0,
        }
    }

    fn finish(&mut self, rank: usize, value: u16, now: Cycles) {
        let last = rank + 1 >= self.length();
        let unread = match self.family {
            Family::F4 => self.request,
            Family::F3 => self.end_of_conversion,
        };
        let keep = match self.family {
            Family::F4 => true,
            // OVRMOD: overwrite.
            Family::F3 => self.get(0x0C) & 1 << 12 == 0,
        };
        if unread {
            self.overrun = true;
        }
        if !(unread && keep) {
            self.data = u32::from(value);
        }
        // EOC at the end of each conversion, or of the sequence (RM0390 13.8.2).
        let each = self.family == Family::F3 || self.get(0x08) & 1 << 10 != 0;
        if each || last {
            self.end_of_conversion = true;
        }
        if self.dma_enabled() && !self.dma_done && !self.overrun {
            self.request = true;
        }
        if last {
            self.end_of_sequence = true;
            let continuous = match self.family {
                Family::F4 => self.get(0x08) & 1 << 1 != 0,
                Family::F3 => self.get(0x0C) & 1 << 13 != 0,
            };
            let stopped = self.family == Family::F4 && self.overrun && self.dma_enabled();
            if continuous && !stopped {
                self.convert(0, now);
            } else if self.trigger_control().0 == 0 {
                self.armed = false;
            }
        } else {
            self.convert(rank + 1, now);
        }
    }

    pub(crate) fn dma_request(&self) -> bool {
        self.request
    }

    /// The DMA controller moved the last item of its buffer. In one-shot mode the F303 then gives up
    /// the conversion and begins no other one, although ADSTART stays set (RM0316 15.3.26).
    pub(crate) fn dma_complete(&mut self) {
        if !self.dma_continues() {
            self.dma_done = true;
            if self.family == Family::F3 {
                self.sequence = None;
            }
        }
    }

    /// What a write to a register of the F303 does that its manual does not allow, or that this
    /// model lacks, with the section of the manual.
    pub(crate) fn refuse(&self, offset: u32, value: u32) -> Option<(String, &'static str)> {
        if self.family != Family::F3 {
            return None;
        }
        let bits = |mask: u32, what: &str, document| {
            let wrong = value & mask;
            (wrong != 0).then(|| (format!("{what}: {wrong:#010x}"), document))
        };
        let unmodelled = "sets bits that are not modelled";
        let locked = || {
            self.armed.then(|| {
                let what = "written while the converter is started".to_owned();
                (what, "RM0316 15.5, ADSTART")
            })
        };
        match offset {
            // Everything except end of conversion and of sequence, overrun, ready.
            0x04 => bits(!0b1_1101, unmodelled, "RM0316 15.5.2"),
            0x08 => {
                // Injected conversions, differential calibration.
                let other = bits(1 << 3 | 1 << 5 | 1 << 30, unmodelled, "RM0316 15.5.3");
                let absent = |bit: u32, holds: bool, what: &str| {
                    let wrong = value & 1 << bit != 0 && !holds;
                    wrong.then(|| (what.to_owned(), "RM0316 15.5.3"))
                };
                other
                    .or_else(|| absent(2, self.enabled, "started while it is disabled"))
                    .or_else(|| absent(4, self.armed, "stopped while it is not started"))
                    .or_else(|| absent(1, self.enabled && !self.armed, "disabled while started"))
            }
            // Of the configuration: DMA, trigger, overrun mode, continuous mode.
            0x0C => locked().or_else(|| bits(!0x3FC3, unmodelled, "RM0316 15.5.4")),
            0x14 | 0x18 | 0x30..=0x3C => locked(),
            _ => None,
        }
    }

    pub(crate) fn interrupt(&self) -> bool {
        match self.family {
            Family::F4 => {
                let cr1 = self.get(0x04);
                cr1 & 1 << 5 != 0 && self.end_of_conversion || cr1 & 1 << 26 != 0 && self.overrun
            }
            Family::F3 => {
                let enable = self.get(0x04);
                enable & 1 != 0 && self.ready
                    || enable & 1 << 2 != 0 && self.end_of_conversion
                    || enable & 1 << 3 != 0 && self.end_of_sequence
                    || enable & 1 << 4 != 0 && self.overrun
            }
        }
    }

    fn fetch(&mut self) -> u32 {
        self.end_of_conversion = false;
        self.request = false;
        self.data
    }

    pub(crate) fn read(&mut self, offset: u32, now: Cycles) -> Option<u32> {
        match self.family {
            Family::F4 => match offset {
                0x00 => Some(
                    u32::from(self.end_of_conversion) << 1
                        | u32::from(self.started) << 4
                        | u32::from(self.overrun) << 5,
                ),
                0x04..=0x48 => Some(self.get(offset)),
                0x4C => Some(self.fetch()),
                0x300 => self.read(0x00, now),
                0x304 => Some(self.common),
                0x308 => Some(self.data),
                _ => None,
            },
            Family::F3 => match offset {
                0x00 => Some(
                    u32::from(self.ready)
                        | u32::from(self.end_of_conversion) << 2
                        | u32::from(self.end_of_sequence) << 3
                        | u32::from(self.overrun) << 4,
                ),
                0x08 => {
                    let calibrating = self.calibration_end != NEVER && now < self.calibration_end;
                    Some(
                        self.get(0x08) & 0x7000_0000
                            | u32::from(self.enabled)
                            | u32::from(self.armed) << 2
                            | u32::from(calibrating) << 31,
                    )
                }
                0x40 => Some(self.fetch()),
                0x04 | 0x0C..=0x3C | 0x44..=0xB4 => Some(self.get(offset)),
                0x300 => self.read(0x00, now),
                0x308 => Some(self.common),
                0x30C => Some(self.data),
                _ => None,
            },
        }
    }

    /// `cycles_of` turns picoseconds into core cycles.
    pub(crate) fn write(
        &mut self,
        offset: u32,
        value: u32,
        now: Cycles,
        cycles_of: impl Fn(u64) -> Cycles,
    ) {
        match (self.family, offset) {
            (Family::F4, 0x00) => {
                self.end_of_conversion &= value & 1 << 1 != 0;
                self.started &= value & 1 << 4 != 0;
                self.overrun &= value & 1 << 5 != 0;
            }
            (Family::F4, 0x04 | 0x0C..=0x48) => self.registers[(offset / 4) as usize] = value,
            (Family::F4, 0x08) => {
                self.registers[2] = value & !(1 << 30 | 1 << 22);
                if value & 1 == 0 {
                    self.sequence = None;
                }
                if !self.dma_enabled() {
                    self.dma_done = false;
                    self.request = false;
                }
                if value & 1 << 30 != 0 {
                    self.start(now);
                }
            }
            (Family::F4, 0x304) | (Family::F3, 0x308) => self.common = value,
            (Family::F3, 0x00) => {
                self.ready &= value & 1 == 0;
                self.end_of_conversion &= value & 1 << 2 == 0;
                self.end_of_sequence &= value & 1 << 3 == 0;
                self.overrun &= value & 1 << 4 == 0;
            }
            (Family::F3, 0x08) => self.write_control(value, now, cycles_of),
            (Family::F3, 0x04 | 0x0C..=0x3C | 0x44..=0xB4) => {
                self.registers[(offset / 4) as usize] = value;
                if !self.dma_enabled() {
                    self.dma_done = false;
                    self.request = false;
                }
            }
            _ => {}
        }
    }

    /// ADC_CR of the F303: regulator, calibration, enable, start, stop.
    fn write_control(&mut self, value: u32, now: Cycles, cycles_of: impl Fn(u64) -> Cycles) {
        // Writing a start bit as zero changes nothing; ADVREGEN is an ordinary field.
        self.registers[2] = value & 0x7000_0000;
        if value >> 28 & 3 == 1 {
            if self.regulator_ready == NEVER {
                self.regulator_ready = now + cycles_of(REGULATOR_PS);
            }
        } else {
            self.regulator_ready = NEVER;
            self.enabled = false;
            self.ready = false;
            self.sequence = None;
            self.armed = false;
        }
        let powered = now >= self.regulator_ready;
        let calibrating = self.calibration_end != NEVER && now < self.calibration_end;
        if value & 1 << 31 != 0 && powered && !self.enabled {
            // 112 cycles of the converter's clock (RM0316 15.3.8).
            self.calibration_end = now + 112 * self.clock;
        }
        if value & 1 != 0 && powered && !calibrating && !self.enabled {
            self.enabled = true;
            self.ready = true;
        }
        if value & 1 << 1 != 0 && self.enabled && self.sequence.is_none() {
            self.enabled = false;
            self.armed = false;
        }
        if value & 1 << 2 != 0 && self.enabled {
            self.armed = true;
            if self.trigger_control().0 == 0 {
                self.start(now);
            }
        }
        if value & 1 << 4 != 0 {
            self.sequence = None;
            self.armed = false;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Adc;
    use crate::part::Family;

    fn run(adc: &mut Adc, until: u64) {
        while adc.next_event() <= until {
            let at = adc.next_event();
            adc.advance(at);
        }
    }

    fn no_delay(_: u64) -> u64 {
        0
    }

    /// Two channels by scan on TIM3's TRGO, 22.5 MHz (90 MHz / 4), core at 180 MHz.
    fn scanning() -> Adc {
        let mut adc = Adc::new(Family::F4);
        adc.write(0x304, 1 << 16, 0, no_delay);
        adc.set_clock(2, 1);
        adc.set_input(0, 1111);
        adc.set_input(1, 2222);
        adc.write(0x04, 1 << 8, 0, no_delay);
        adc.write(0x2C, 1 << 20, 0, no_delay);
        adc.write(0x34, 1 << 5, 0, no_delay);
        adc.write(0x10, 2 | 2 << 3, 0, no_delay);
        adc.write(0x08, 1 | 1 << 8 | 1 << 9 | 8 << 24 | 1 << 28, 0, no_delay);
        adc
    }

    #[test]
    fn a_scan_takes_its_sampling_and_conversion_times_and_asks_for_each_value() {
        let mut adc = scanning();
        adc.tim3_trigger(1000);
        // 28 + 12 cycles of 8 core cycles each.
        run(&mut adc, 1319);
        assert!(!adc.dma_request());
        run(&mut adc, 1320);
        assert!(adc.dma_request());
        assert_eq!(adc.read(0x4C, 1320), Some(1111));
        assert!(!adc.dma_request());
        run(&mut adc, 1640);
        assert_eq!(adc.read(0x4C, 1640), Some(2222));
        assert_eq!(adc.next_event(), u64::MAX);
        adc.tim3_trigger(2000);
        run(&mut adc, 2320);
        assert!(adc.dma_request());
    }

    #[test]
    fn another_timer_or_a_powered_down_converter_does_not_start() {
        let mut adc = scanning();
        adc.write(0x08, 1 | 6 << 24 | 1 << 28, 0, no_delay);
        adc.tim3_trigger(1000);
        assert_eq!(adc.next_event(), u64::MAX);
        adc.write(0x08, 8 << 24 | 1 << 28, 0, no_delay);
        adc.tim3_trigger(1000);
        assert_eq!(adc.next_event(), u64::MAX);
    }

    #[test]
    fn values_that_nobody_fetches_overrun() {
        let mut adc = scanning();
        adc.tim3_trigger(1000);
        run(&mut adc, 10_000);
        assert_ne!(adc.read(0, 10_000).unwrap() & 1 << 5, 0);
        assert_eq!(
            adc.read(0x4C, 10_000),
            Some(1111),
            "the first value is kept"
        );
    }

    /// The F303's converter, ready, with a core of 72 MHz and half of it for the converter. It scans
    /// channels 2 and 4 without a pause, with DMA requests until the buffer is full.
    fn bursting(trigger: u32) -> Adc {
        let mut adc = Adc::new(Family::F3);
        adc.write(0x308, 2 << 16, 0, no_delay);
        adc.set_clock(1, 1);
        adc.set_input(2, 1111);
        adc.set_input(4, 2222);
        adc.write(0x08, 0, 0, no_delay);
        adc.write(0x08, 1 << 28, 0, no_delay);
        adc.write(0x08, 1 << 28 | 1, 1, no_delay);
        adc.write(0x14, 5 << 6 | 5 << 12, 1, no_delay);
        adc.write(0x30, 1 | 2 << 6 | 4 << 12, 1, no_delay);
        adc.write(0x0C, 1 << 13 | trigger | 1, 1, no_delay);
        adc
    }

    const START: u32 = 1 << 28 | 1 << 2;
    const STOP: u32 = 1 << 28 | 1 << 4;

    #[test]
    fn a_burst_takes_both_channels_in_turn_until_the_buffer_is_full() {
        let mut adc = bursting(0);
        adc.write(0x08, START, 1000, no_delay);
        // 61.5 and 12.5 cycles of two core cycles each.
        let mut now = 1000;
        for k in 0..100 {
            run(&mut adc, now + 147);
            assert!(!adc.dma_request(), "{k}");
            now += 148;
            run(&mut adc, now);
            assert!(adc.dma_request(), "{k}");
            let value = adc.read(0x40, now).unwrap();
            assert_eq!(value, if k % 2 == 0 { 1111 } else { 2222 });
        }
        adc.dma_complete();
        assert_eq!(adc.next_event(), u64::MAX, "it stands still");
        assert_eq!(adc.read(0x00, now).unwrap() & 1 << 4, 0, "no overrun");
        assert_ne!(adc.read(0x08, now).unwrap() & 1 << 2, 0, "still started");
        // Until the requests were switched off and on, a burst has none.
        adc.write(0x08, STOP, now, no_delay);
        assert_eq!(adc.read(0x08, now).unwrap() & 1 << 2, 0);
        adc.write(0x08, START, now, no_delay);
        run(&mut adc, now + 148);
        assert!(!adc.dma_request());
        adc.write(0x08, STOP, now + 200, no_delay);
        adc.write(0x00, 0x1E, now + 200, no_delay);
        adc.write(0x0C, 1 << 13, now + 200, no_delay);
        adc.write(0x0C, 1 << 13 | 1, now + 200, no_delay);
        adc.write(0x08, START, now + 200, no_delay);
        run(&mut adc, now + 348);
        assert!(adc.dma_request());
        assert_eq!(
            adc.read(0x40, now + 348),
            Some(1111),
            "begins with the first"
        );
    }

    #[test]
    fn a_burst_begins_at_a_trigger_and_results_that_nobody_fetches_overrun() {
        let mut adc = bursting(4 << 6 | 1 << 10);
        adc.write(0x08, START, 100, no_delay);
        assert_eq!(adc.next_event(), u64::MAX);
        adc.tim3_trigger(1000);
        run(&mut adc, 1148);
        assert!(adc.dma_request());
        adc.tim3_trigger(1200);
        run(&mut adc, 1296);
        assert_ne!(adc.read(0x00, 1296).unwrap() & 1 << 4, 0);
        assert_eq!(adc.read(0x40, 1296), Some(1111), "the first one is kept");
        run(&mut adc, 2000);
        assert!(!adc.dma_request(), "no requests after an overrun");
    }

    #[test]
    fn the_f303_refuses_what_its_manual_does_not_allow() {
        let mut adc = bursting(0);
        let refused = |adc: &Adc, offset, value| adc.refuse(offset, value).map(|(what, _)| what);
        assert_eq!(refused(&adc, 0x0C, 1 << 13 | 1), None);
        // Discontinuous mode, 8 bits, an analogue watchdog, injected conversions.
        for (offset, value) in [
            (0x0C, 1 << 16),
            (0x0C, 2 << 3),
            (0x0C, 1 << 23),
            (0x08, 1 << 3),
        ] {
            let what = refused(&adc, offset, value).unwrap();
            assert!(what.contains("not modelled"), "{what}");
        }
        assert!(refused(&adc, 0x08, STOP).unwrap().contains("not started"));
        adc.write(0x08, START, 100, no_delay);
        for (offset, value) in [(0x0C, 1 << 13), (0x14, 0), (0x30, 0)] {
            let what = refused(&adc, offset, value).unwrap();
            assert!(what.contains("while the converter is started"), "{what}");
        }
        assert_eq!(refused(&adc, 0x08, STOP), None);
        assert!(
            refused(&adc, 0x08, 1 << 28 | 2)
                .unwrap()
                .contains("disabled")
        );
        let off = Adc::new(Family::F3);
        assert!(refused(&off, 0x08, START).unwrap().contains("disabled"));
        assert_eq!(refused(&Adc::new(Family::F4), 0x0C, u32::MAX), None);
    }

    #[test]
    fn the_f303_wants_its_regulator_calibration_and_start() {
        let mut adc = Adc::new(Family::F3);
        let ps = |ps: u64| ps * 72 / 1_000_000;
        adc.write(0x308, 1 << 16, 0, ps);
        adc.set_clock(1, 1);
        adc.set_input(1, 3048);
        adc.write(0x08, 0, 0, ps);
        adc.write(0x08, 1 << 28, 10, ps);
        adc.write(0x08, 1 << 28 | 1 << 31, 300, ps);
        assert_eq!(
            adc.read(0x08, 300).unwrap() >> 31,
            0,
            "regulator not up yet"
        );
        adc.write(0x08, 1 << 28 | 1 << 31, 1000, ps);
        assert_eq!(adc.read(0x08, 1111).unwrap() >> 31, 1);
        assert_eq!(adc.read(0x08, 1112).unwrap() >> 31, 0);
        adc.write(0x08, 1 << 28 | 1, 1200, ps);
        assert_eq!(adc.read(0x00, 1200).unwrap() & 1, 1);
        // One conversion of channel 1, TIM3's TRGO rising, DMA circular.
        adc.write(0x30, 1 << 6, 1200, ps);
        adc.write(0x14, 4 << 3, 1200, ps);
        adc.write(0x0C, 1 | 2 | 4 << 6 | 1 << 10, 1200, ps);
        adc.tim3_trigger(1300);
        assert_eq!(adc.next_event(), u64::MAX, "not started by ADSTART");
        adc.write(0x08, 1 << 28 | 1 | 1 << 2, 1400, ps);
        adc.tim3_trigger(2000);
        run(&mut adc, 2031);
        assert!(!adc.dma_request());
        run(&mut adc, 2032);
        assert!(adc.dma_request());
        assert_eq!(adc.read(0x40, 2032), Some(3048));
        assert_eq!(adc.read(0x08, 2032).unwrap() & 1 << 2, 1 << 2);
    }
}
