//! Reset and clock control of both parts: oscillators with their start-up times, PLL,
//! system clock switch, bus prescalers, gates, reset flags.
//!
//! RM0390 chapter 6 and RM0316 chapter 9. Start-up and lock times are those of the data
//! sheets (maximum of the PLL, typical of the others); the LSE is ready at once. Clock interrupts, the clock
//! security system and the clock outputs are not modelled: their registers read back
//! what was written.

use crate::clock::{Cycles, LocalClock, NEVER, Ps};
use crate::part::{Family, Part};
use crate::silicon::clocks::Prescalers;

const CR: u32 = 0x00;

/// HSI start-up (data sheets: 2.2 us on the F446, 1 to 2 us on the F303).
const HSI_START: Ps = 2_000_000;
/// HSE in bypass mode: the clock runs already, and the ready flag follows after about 8 of its
/// cycles.
const HSE_START: Ps = 2_000_000;
/// A step of HSITRIM: about 40 kHz of 8 MHz (RM0316 9.4.1). The F446's documents give no step
/// but a maximum of 1 %; the same share is taken.
const TRIM_STEP_PPB: i64 = 5_000_000;
/// PLL lock: 200 us is the maximum of both parts.
const PLL_LOCK: Ps = 200_000_000;
/// LSI start-up: 40 us (F446), 85 us (F303).
const LSI_START: Ps = 40_000_000;

/// Why the part was reset, as the flags of RCC_CSR report it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power came up.
    PowerOn,
    /// The reset pin was pulled.
    Pin,
    /// The program asked for it through AIRCR.
    Software,
    /// The independent watchdog ran out.
    Watchdog,
}

impl ResetCause {
    /// Every internal reset also shows as a pin reset (RM0390 6.1.1, RM0316 9.1.1).
    const fn flags(self) -> u32 {
        const PIN: u32 = 1 << 26;
        match self {
            Self::PowerOn => PIN | 1 << 27 | 1 << 25,
            Self::Pin => PIN,
            Self::Software => PIN | 1 << 28,
            Self::Watchdog => PIN | 1 << 29,
        }
    }
}

/// The clock frequencies that follow from the registers, Hz.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Tree {
    /// The system clock, and its cycles per AHB cycle.
    pub system: u64,
    pub ahb: u64,
    pub hclk: u64,
    /// AHB cycles per cycle of APB1, of APB2 and of their timers.
    pub apb1: u64,
    pub apb2: u64,
    pub timer1: u64,
    pub timer2: u64,
    /// True if the system clock derives, directly or through the PLL, from the external clock.
    pub external: bool,
}

impl Tree {
    pub(crate) fn prescalers(&self) -> Prescalers {
        Prescalers {
            ahb: self.ahb,
            apb1: self.apb1,
            apb2: self.apb2,
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Source {
    Hsi,
    Hse,
    Pll,
}

#[derive(Clone, Debug)]
pub(crate) struct Rcc {
    part: &'static Part,
    registers: [u32; 0x98 / 4],
    /// External clock at OSC_IN, if there is one, Hz.
    hse_hz: Option<u64>,
    /// False for a part whose PLL never locks.
    pll_locks: bool,
    hsi_ready: Cycles,
    hse_ready: Cycles,
    pll_ready: Cycles,
    lsi_ready: Cycles,
    /// SWS: the source of the system clock.
    switched: u32,
    cause_flags: u32,
}

impl Rcc {
    pub(crate) fn new(part: &'static Part, hse_hz: Option<u64>) -> Self {
        let mut rcc = Self {
            part,
            registers: [0; 0x98 / 4],
            hse_hz,
            pll_locks: true,
            hsi_ready: 0,
            hse_ready: NEVER,
            pll_ready: NEVER,
            lsi_ready: NEVER,
            switched: 0,
            cause_flags: 0,
        };
        rcc.reset(ResetCause::PowerOn);
        rcc
    }

    /// A system reset: all registers take their reset values. `cause` is added to the reset flags,
    /// which only power-on and RMVF clear.
    pub(crate) fn reset(&mut self, cause: ResetCause) {
        self.registers = [0; 0x98 / 4];
        // HSION, HSITRIM 16.
        self.registers[0] = 1 | 16 << 3;
        match self.part.family {
            Family::F4 => {
                *self.register(0x04) = 0x2400_3010;
                *self.register(0x30) = 0x0010_0000;
            }
            Family::F3 => *self.register(0x14) = 0x14,
        }
        if cause == ResetCause::PowerOn {
            self.cause_flags = 0;
        }
        self.cause_flags |= cause.flags();
        if self.part.family == Family::F3 {
            self.cause_flags &= !(1 << 25);
        }
        self.hsi_ready = 0;
        self.hse_ready = NEVER;
        self.pll_ready = NEVER;
        self.lsi_ready = NEVER;
        self.switched = 0;
    }

    fn register(&mut self, offset: u32) -> &mut u32 {
        &mut self.registers[(offset / 4) as usize]
    }

    fn get(&self, offset: u32) -> u32 {
        self.registers[(offset / 4) as usize]
    }

    fn cfgr_offset(&self) -> u32 {
        match self.part.family {
            Family::F4 => 0x08,
            Family::F3 => 0x04,
        }
    }

    fn bdcr_offset(&self) -> u32 {
        match self.part.family {
            Family::F4 => 0x70,
            Family::F3 => 0x20,
        }
    }

    fn csr_offset(&self) -> u32 {
        match self.part.family {
            Family::F4 => 0x74,
            Family::F3 => 0x24,
        }
    }

    /// Whether the bit of an enable register is set.
    pub(crate) fn enabled(&self, register: u32, bit: u32) -> bool {
        self.get(register) & 1 << bit != 0
    }

    /// RCC_CFGR3 (F303).
    pub(crate) fn cfgr3(&self) -> u32 {
        self.get(0x30)
    }

    /// RCC_CFGR2 (F303).
    pub(crate) fn cfgr2(&self) -> u32 {
        self.get(0x2C)
    }

    /// What was written to a register.
    pub(crate) fn written(&self, offset: u32) -> u32 {
        self.get(offset)
    }

    /// The external clock, Hz; zero without one.
    pub(crate) fn external_hz(&self) -> u64 {
        self.hse_hz.unwrap_or(0)
    }

    /// The external clock while it is switched on, Hz; zero otherwise.
    pub(crate) fn running_external_hz(&self) -> u64 {
        if self.get(CR) & 1 << 16 != 0 {
            self.external_hz()
        } else {
            0
        }
    }

    /// `None` beyond the last register.
    pub(crate) fn read(&self, offset: u32, now: Cycles) -> Option<u32> {
        let last = match self.part.family {
            Family::F4 => 0x94,
            Family::F3 => 0x30,
        };
        if offset > last {
            return None;
        }
        let mut value = self.get(offset);
        if offset == CR {
            let ready = |at: Cycles, bit: u32| u32::from(now >= at) << bit;
            value |=
                ready(self.hsi_ready, 1) | ready(self.hse_ready, 17) | ready(self.pll_ready, 25);
        } else if offset == self.cfgr_offset() {
            value = value & !0b1100 | self.switched << 2;
        } else if offset == self.bdcr_offset() {
            // The slow crystal oscillates as soon as it is switched on.
            value = value & !0b10 | (value & 1) << 1;
        } else if offset == self.csr_offset() {
            value = value & 1 | u32::from(now >= self.lsi_ready) << 1 | self.cause_flags;
        }
        Some(value)
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: Cycles, clock: &LocalClock) {
        if self.read(offset, now).is_none() {
            return;
        }
        if offset == self.csr_offset() {
            if value & 1 << 24 != 0 {
                self.cause_flags = 0;
            }
            *self.register(offset) = value & 1;
            start(
                &mut self.lsi_ready,
                value & 1 != 0,
                now + clock.cycles_of(LSI_START),
            );
            return;
        }
        let before = self.get(offset);
        let mut value = value;
        if offset == CR {
            // The ready flags are read-only, and an oscillator that drives the system
            // cannot be stopped (RM0390 6.3.1).
            value &= !(1 << 1 | 1 << 17 | 1 << 25);
            let keep = match self.source() {
                Source::Hsi => 1,
                Source::Hse => 1 << 16,
                Source::Pll => 1 << 24 | before & (1 | 1 << 16) & self.pll_feed(),
            };
            value |= before & keep;
        } else if offset == self.cfgr_offset() && self.part.family == Family::F3 {
            // PLLSRC and PLLMUL are locked while the PLL is on (RM0316 9.4.2).
            let locked = 0b1_1111 << 16 | 1 << 21;
            if self.registers[0] & 1 << 24 != 0 {
                value = value & !locked | before & locked;
            }
        } else if offset == 0x04
            && self.part.family == Family::F4
            && self.registers[0] & 1 << 24 != 0
        {
            // PLLCFGR as well (RM0390 6.3.2).
            value = before;
        }
        *self.register(offset) = value;
        if offset == CR {
            start(
                &mut self.hsi_ready,
                value & 1 != 0,
                now + clock.cycles_of(HSI_START),
            );
            if self.hse_hz.is_some() {
                start(
                    &mut self.hse_ready,
                    value & 1 << 16 != 0,
                    now + clock.cycles_of(HSE_START),
                );
            }
        }
        self.settle(now, clock);
    }

    /// The external clock stops. If the clock security system (RM0390 6.2.7, RM0316 9.2.7) is on,
    /// it switches the system clock to the HSI, stops what the external clock fed and requests an
    /// NMI; the result is then true. If it is off, nothing changes here, because the manuals do not
    /// say what the part does.
    pub(crate) fn lose_external(&mut self) -> bool {
        const CSSON: u32 = 1 << 19;
        let watched = self.registers[0] & CSSON != 0 && self.hse_ready != NEVER;
        self.hse_hz = None;
        if !watched {
            let in_use = self.source() == Source::Hse
                || self.pll_external() && self.registers[0] & 1 << 24 != 0;
            if !in_use {
                self.hse_ready = NEVER;
            }
            return false;
        }
        let fed = self.pll_external();
        self.registers[0] &= !(CSSON | 1 << 16);
        self.registers[0] |= 1;
        self.hsi_ready = 0;
        self.hse_ready = NEVER;
        if fed {
            self.registers[0] &= !(1 << 24);
            self.pll_ready = NEVER;
        }
        if self.switched == 1 || fed {
            let cfgr = self.cfgr_offset();
            *self.register(cfgr) &= !0b11;
            self.switched = 0;
        }
        true
    }

    /// A clock comes to OSC_IN. It is ready some time after the program has asked for it.
    pub(crate) fn find_external(&mut self, hertz: u64, now: Cycles, clock: &LocalClock) {
        self.hse_hz = Some(hertz);
        start(
            &mut self.hse_ready,
            self.registers[0] & 1 << 16 != 0,
            now + clock.cycles_of(HSE_START),
        );
        self.settle(now, clock);
    }

    /// Whether the PLL locks from now on.
    pub(crate) fn set_pll_locks(&mut self, locks: bool) {
        self.pll_locks = locks;
    }

    /// How far the program has trimmed the HSI off its factory setting, parts in 10^9.
    pub(crate) fn trim_ppb(&self) -> i64 {
        (i64::from(self.registers[0] >> 3 & 0x1F) - 16) * TRIM_STEP_PPB
    }

    /// The CR bit of the oscillator that feeds the PLL.
    fn pll_feed(&self) -> u32 {
        if self.pll_external() { 1 << 16 } else { 1 }
    }

    fn pll_external(&self) -> bool {
        match self.part.family {
            Family::F4 => self.get(0x04) & 1 << 22 != 0,
            Family::F3 => self.get(0x04) & 1 << 16 != 0,
        }
    }

    /// Updates the flags and the clock switch to `now`. Called on writes and at
    /// [`Rcc::next_event`].
    pub(crate) fn settle(&mut self, now: Cycles, clock: &LocalClock) {
        let feed_ready = if self.pll_external() {
            now >= self.hse_ready
        } else {
            now >= self.hsi_ready
        };
        let on = self.registers[0] & 1 << 24 != 0 && feed_ready && self.pll_locks;
        start(&mut self.pll_ready, on, now + clock.cycles_of(PLL_LOCK));
        let wanted = self.get(self.cfgr_offset()) & 0b11;
        let ready = match wanted {
            0 => now >= self.hsi_ready,
            1 => now >= self.hse_ready,
            _ => now >= self.pll_ready,
        };
        if ready {
            self.switched = wanted;
        }
    }

    /// The next time at which a flag changes that affects other state.
    pub(crate) fn next_event(&self, now: Cycles) -> Cycles {
        let wanted = self.get(self.cfgr_offset()) & 0b11;
        let pll_waits = self.registers[0] & 1 << 24 != 0 && self.pll_ready == NEVER;
        if wanted == self.switched && !pll_waits {
            return NEVER;
        }
        [self.hsi_ready, self.hse_ready, self.pll_ready]
            .into_iter()
            .filter(|&at| at > now)
            .min()
            .unwrap_or(NEVER)
    }

    /// Converts pending start-up times when the core's frequency changes, because they are real
    /// times.
    pub(crate) fn rescale(&mut self, now: Cycles, scale: impl Fn(Cycles) -> Cycles) {
        for at in [
            &mut self.hsi_ready,
            &mut self.hse_ready,
            &mut self.pll_ready,
            &mut self.lsi_ready,
        ] {
            if *at != NEVER && *at > now {
                *at = scale(*at);
            }
        }
    }

    fn source(&self) -> Source {
        match self.switched {
            0 => Source::Hsi,
            1 => Source::Hse,
            _ => Source::Pll,
        }
    }

    fn pll_hz(&self) -> u64 {
        let input = if self.pll_external() {
            self.hse_hz.unwrap_or(0)
        } else {
            u64::from(self.part.hsi.hz)
        };
        match self.part.family {
            Family::F4 => {
                let pll = self.get(0x04);
                let m = u64::from(pll & 0x3F).max(1);
                let n = u64::from(pll >> 6 & 0x1FF);
                let output = if self.switched == 3 {
                    u64::from(pll >> 28 & 7).max(1)
                } else {
                    2 * (u64::from(pll >> 16 & 3) + 1)
                };
                input * n / m / output
            }
            Family::F3 => {
                let factor = (u64::from(self.get(0x04) >> 18 & 0xF) + 2).min(16);
                if self.pll_external() {
                    input * factor / (u64::from(self.cfgr2() & 0xF) + 1)
                } else {
                    input * factor / 2
                }
            }
        }
    }

    /// The clock tree that the registers select.
    pub(crate) fn tree(&self) -> Tree {
        let (system, external) = match self.source() {
            Source::Hsi => (u64::from(self.part.hsi.hz), false),
            Source::Hse => (self.hse_hz.unwrap_or(0), true),
            Source::Pll => (self.pll_hz(), self.pll_external()),
        };
        let cfgr = self.get(self.cfgr_offset());
        let (ppre1, ppre2) = match self.part.family {
            Family::F4 => (cfgr >> 10 & 7, cfgr >> 13 & 7),
            Family::F3 => (cfgr >> 8 & 7, cfgr >> 11 & 7),
        };
        let apb = |code: u32| if code < 4 { 1 } else { 2 << (code - 4) };
        let timer = |bus: u64| if bus == 1 { 1 } else { bus / 2 };
        let (apb1, apb2) = (apb(ppre1), apb(ppre2));
        Tree {
            system,
            ahb: ahb_divider(cfgr >> 4 & 0xF),
            hclk: (system / ahb_divider(cfgr >> 4 & 0xF)).max(1),
            apb1,
            apb2,
            timer1: timer(apb1),
            timer2: timer(apb2),
            external,
        }
    }
}

fn ahb_divider(code: u32) -> u64 {
    match code {
        0..=7 => 1,
        8..=11 => 2 << (code - 8),
        _ => 64 << (code - 12),
    }
}

/// Starts a flag's delay, or cancels it.
fn start(ready: &mut Cycles, on: bool, at: Cycles) {
    if !on {
        *ready = NEVER;
    } else if *ready == NEVER {
        *ready = at;
    }
}

#[cfg(test)]
mod tests {
    use super::{Rcc, ResetCause};
    use crate::clock::LocalClock;
    use crate::part::Part;

    fn wait(rcc: &mut Rcc, now: &mut u64, clock: &LocalClock, register: u32, mask: u32, want: u32) {
        for _ in 0..1_000_000 {
            if rcc.read(register, *now).unwrap() & mask == want {
                return;
            }
            *now += 10;
            rcc.settle(*now, clock);
        }
        panic!("register {register:#x} never showed {want:#x} under {mask:#x}");
    }

    #[test]
    fn f446_reaches_180_mhz_from_the_8_mhz_clock() {
        let clock = LocalClock::new(16_000_000, 0, 0);
        let mut now = 100;
        let mut rcc = Rcc::new(Part::F446, Some(8_000_000));
        rcc.write(0x00, 0x0005_0083, now, &clock);
        wait(&mut rcc, &mut now, &clock, 0x00, 1 << 17, 1 << 17);
        // M 4, N 180, P 2, source HSE.
        rcc.write(0x04, 4 | 180 << 6 | 1 << 22, now, &clock);
        rcc.write(0x00, 0x0105_0083, now, &clock);
        let locked_from = now;
        wait(&mut rcc, &mut now, &clock, 0x00, 1 << 25, 1 << 25);
        assert!(now - locked_from >= 3_200, "200 us at 16 MHz");
        rcc.write(0x08, 0b101 << 10 | 0b100 << 13 | 2, now, &clock);
        wait(&mut rcc, &mut now, &clock, 0x08, 0b1100, 0b1000);
        let tree = rcc.tree();
        assert_eq!(tree.hclk, 180_000_000);
        assert_eq!((tree.apb1, tree.apb2, tree.timer1), (4, 2, 2));
        assert!(tree.external);
    }

    #[test]
    fn f303_falls_back_to_64_mhz_when_no_clock_comes() {
        let clock = LocalClock::new(8_000_000, 0, 0);
        let mut now = 100;
        let mut rcc = Rcc::new(Part::F303, None);
        rcc.write(0x00, 0x0005_0083, now, &clock);
        now += 1_000_000;
        assert_eq!(rcc.read(0x00, now).unwrap() & 1 << 17, 0);
        rcc.write(0x00, 0x83, now, &clock);
        rcc.write(0x04, 14 << 18 | 0b100 << 8, now, &clock);
        rcc.write(0x00, 0x0100_0083, now, &clock);
        wait(&mut rcc, &mut now, &clock, 0x00, 1 << 25, 1 << 25);
        rcc.write(0x04, 14 << 18 | 0b100 << 8 | 2, now, &clock);
        wait(&mut rcc, &mut now, &clock, 0x04, 0b1100, 0b1000);
        let tree = rcc.tree();
        assert_eq!((tree.hclk, tree.apb1, tree.apb2), (64_000_000, 2, 1));
        assert!(!tree.external);
    }

    #[test]
    fn reset_flags_stay_until_they_are_removed() {
        let clock = LocalClock::new(16_000_000, 0, 0);
        let mut rcc = Rcc::new(Part::F446, None);
        assert_eq!(rcc.read(0x74, 0).unwrap(), 0x0E00_0000);
        rcc.write(0x74, 1 << 24, 0, &clock);
        assert_eq!(rcc.read(0x74, 0).unwrap(), 0);
        rcc.reset(ResetCause::Watchdog);
        assert_eq!(rcc.read(0x74, 0).unwrap(), 0x2400_0000);
    }

    #[test]
    fn the_running_pll_cannot_be_switched_off_or_retuned() {
        let clock = LocalClock::new(16_000_000, 0, 0);
        let mut now = 0;
        let mut rcc = Rcc::new(Part::F446, None);
        rcc.write(0x04, 8 | 180 << 6, now, &clock);
        rcc.write(0x00, 0x0100_0083, now, &clock);
        wait(&mut rcc, &mut now, &clock, 0x00, 1 << 25, 1 << 25);
        rcc.write(0x08, 2, now, &clock);
        rcc.write(0x04, 8 | 90 << 6, now, &clock);
        rcc.write(0x00, 0, now, &clock);
        assert_eq!(rcc.tree().hclk, 180_000_000);
        assert_eq!(rcc.read(0x00, now).unwrap() & 0x0300_0003, 0x0300_0003);
    }
}
