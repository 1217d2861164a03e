//! Small system registers: flash interface, power control, debug identification.

use crate::clock::{Cycles, LocalClock, NEVER, Ps};
use crate::part::{Family, Part};

/// The flash interface (RM0390 3.8, RM0316 4.5): access control. The other registers are those of
/// [`super::programming`].
#[derive(Clone, Debug)]
pub(crate) struct Flash {
    family: Family,
    acr: u32,
}

impl Flash {
    pub(crate) fn new(family: Family) -> Self {
        Self {
            family,
            acr: match family {
                Family::F4 => 0,
                Family::F3 => 0x30,
            },
        }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        (offset == 0).then_some(self.acr)
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) {
        if offset != 0 {
            return;
        }
        self.acr = match self.family {
            Family::F4 => value & 0x1F0F,
            // PRFTBS follows PRFTBE.
            Family::F3 => value & 0x1F & !(1 << 5) | (value & 1 << 4) << 1,
        };
    }
}

/// Over-drive and its switch take effect within this time (data sheet F446: 50 us).
const OVERDRIVE: Ps = 45_000_000;

/// The detector reports a good supply for this long after it was switched on, whatever the supply.
/// The data sheets give no bound; this is longer than several reads take.
const SETTLING: Ps = 50_000_000;

/// PVDE of PWR_CR, PVDO of PWR_CSR, and the position of PLS.
const DETECTOR_ON: u32 = 1 << 4;
const DETECTED: u32 = 1 << 2;
const LEVEL: u32 = 5;

/// Power control (RM0390 5.4, RM0316 7.4): voltage detector, and regulator scale and over-drive on
/// the F446.
#[derive(Clone, Debug)]
pub(crate) struct Pwr {
    part: &'static Part,
    cr: u32,
    csr: u32,
    overdrive_ready: Cycles,
    switch_ready: Cycles,
    /// Supply, mV.
    supply: u16,
    /// The supply is low by the detector's thresholds.
    low: bool,
    /// When the detector has settled.
    settled: Cycles,
}

impl Pwr {
    pub(crate) fn new(part: &'static Part) -> Self {
        Self {
            part,
            cr: match part.family {
                Family::F4 => 0xC000,
                Family::F3 => 0,
            },
            csr: 0,
            overdrive_ready: NEVER,
            switch_ready: NEVER,
            supply: 3_300,
            low: false,
            settled: 0,
        }
    }

    /// Resets the registers; the supply stays.
    pub(crate) fn reset(&mut self) {
        let supply = self.supply;
        *self = Self::new(self.part);
        self.supply = supply;
    }

    /// Supply, mV.
    pub(crate) fn supply(&self) -> u16 {
        self.supply
    }

    pub(crate) fn set_supply(&mut self, millivolts: u16) {
        self.supply = millivolts;
        self.detect();
    }

    /// The detector compares. It takes the lowest threshold of the data sheet when the supply
    /// falls, and the highest one when it rises or the detector was off.
    fn detect(&mut self) {
        let (falls, rises) = self.part.supply.detector_mv[(self.cr >> LEVEL & 7) as usize];
        self.low = self.cr & DETECTOR_ON != 0 && self.supply < if self.low { rises } else { falls };
    }

    /// The level of the detector's line to EXTI: high when the supply is low.
    pub(crate) fn is_low(&self, now: Cycles) -> bool {
        self.low && now >= self.settled
    }

    /// The cycle after `now` at which the detector has settled.
    pub(crate) fn next_event(&self, now: Cycles) -> Cycles {
        if self.settled > now {
            self.settled
        } else {
            NEVER
        }
    }

    pub(crate) fn read(&self, offset: u32, now: Cycles) -> Option<u32> {
        let low = if self.is_low(now) { DETECTED } else { 0 };
        match (self.part.family, offset) {
            (_, 0x00) => Some(self.cr),
            (Family::F4, 0x04) => Some(
                self.csr
                    | low
                    | 1 << 14
                    | u32::from(now >= self.overdrive_ready) << 16
                    | u32::from(now >= self.switch_ready) << 17,
            ),
            (Family::F3, 0x04) => Some(self.csr | low),
            _ => None,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: Cycles, clock: &LocalClock) {
        match offset {
            0x00 => {
                let off = self.cr & DETECTOR_ON == 0;
                self.cr = value;
                if off && value & DETECTOR_ON != 0 {
                    self.low = true;
                    self.settled = now + clock.cycles_of(SETTLING);
                }
                self.detect();
                if self.part.family == Family::F4 {
                    let at = now + clock.cycles_of(OVERDRIVE);
                    let follow = |ready: &mut Cycles, on: bool| {
                        *ready = match (on, *ready) {
                            (false, _) => NEVER,
                            (true, NEVER) => at,
                            (true, set) => set,
                        };
                    };
                    follow(&mut self.overdrive_ready, value & 1 << 16 != 0);
                    follow(&mut self.switch_ready, value & 1 << 17 != 0);
                }
            }
            0x04 => self.csr = value & 0x300,
            _ => {}
        }
    }

    /// As [`super::rcc::Rcc::rescale`].
    pub(crate) fn rescale(&mut self, now: Cycles, scale: impl Fn(Cycles) -> Cycles) {
        for at in [
            &mut self.overdrive_ready,
            &mut self.switch_ready,
            &mut self.settled,
        ] {
            if *at != NEVER && *at > now {
                *at = scale(*at);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Flash, Pwr};
    use crate::clock::LocalClock;
    use crate::part::{Family, Part};

    #[test]
    fn overdrive_reports_ready_after_its_time_and_never_without_being_asked() {
        let clock = LocalClock::new(16_000_000, 0, 0);
        let mut pwr = Pwr::new(Part::F446);
        assert_eq!(pwr.read(4, 1_000_000).unwrap() & 3 << 16, 0);
        pwr.write(0, 0xC000 | 1 << 16, 1_000_000, &clock);
        assert_eq!(pwr.read(4, 1_000_000).unwrap() & 3 << 16, 0);
        assert_eq!(pwr.read(4, 1_000_720).unwrap() & 3 << 16, 1 << 16);
        pwr.write(0, 0xC000 | 3 << 16, 1_001_000, &clock);
        assert_eq!(pwr.read(4, 1_001_720).unwrap() & 3 << 16, 3 << 16);
    }

    #[test]
    fn the_detector_has_a_hysteresis() {
        let clock = LocalClock::new(16_000_000, 0, 0);
        let mut pwr = Pwr::new(Part::F446);
        pwr.set_supply(2_000);
        assert!(!pwr.is_low(0), "it is off");
        pwr.set_supply(3_050);
        pwr.write(0, 0xC000 | 6 << 5 | 1 << 4, 0, &clock);
        assert_eq!(pwr.next_event(0), 800);
        assert!(!pwr.is_low(799), "it has not settled");
        assert!(pwr.is_low(800), "not yet above the threshold");
        pwr.set_supply(3_100);
        assert!(!pwr.is_low(800));
        pwr.set_supply(2_850);
        assert!(!pwr.is_low(800));
        pwr.set_supply(2_840);
        assert_eq!(pwr.read(4, 800).unwrap() & 1 << 2, 1 << 2);
        pwr.reset();
        assert!(!pwr.is_low(800));
        assert_eq!(pwr.supply(), 2_840);
    }

    #[test]
    fn the_f303_shows_its_prefetch_buffer_as_enabled() {
        let mut flash = Flash::new(Family::F3);
        assert_eq!(flash.read(0), Some(0x30));
        flash.write(0, 0x12);
        assert_eq!(flash.read(0), Some(0x32));
    }
}
