//! Small system registers: flash interface, power control, debug identification.

use crate::clock::{Cycles, LocalClock, NEVER, Ps};
use crate::part::Family;

/// The flash interface (RM0390 3.8, RM0316 4.5): access control only. Programming and erasing are
/// not modelled, and the control registers stay locked.
#[derive(Debug)]
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
        match (self.family, offset) {
            (_, 0x00) => Some(self.acr),
            // KEYR, OPTKEYR, SR.
            (_, 0x04..=0x0C) => Some(0),
            (Family::F4, 0x10) => Some(0x8000_0000),
            (Family::F4, 0x14) => Some(0x0FFF_AAED),
            (Family::F3, 0x10) => Some(0x80),
            (Family::F3, 0x14..=0x20) => Some(0),
            _ => None,
        }
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

/// Power control (RM0390 5.4, RM0316 7.4): regulator scale and over-drive on the F446; on
/// the F303 the registers only hold what was written.
#[derive(Debug)]
pub(crate) struct Pwr {
    family: Family,
    cr: u32,
    csr: u32,
    overdrive_ready: Cycles,
    switch_ready: Cycles,
}

impl Pwr {
    pub(crate) fn new(family: Family) -> Self {
        Self {
            family,
            cr: match family {
                Family::F4 => 0xC000,
                Family::F3 => 0,
            },
            csr: 0,
            overdrive_ready: NEVER,
            switch_ready: NEVER,
        }
    }

    pub(crate) fn read(&self, offset: u32, now: Cycles) -> Option<u32> {
        match (self.family, offset) {
            (_, 0x00) => Some(self.cr),
            (Family::F4, 0x04) => Some(
                self.csr
                    | 1 << 14
                    | u32::from(now >= self.overdrive_ready) << 16
                    | u32::from(now >= self.switch_ready) << 17,
            ),
            (Family::F3, 0x04) => Some(self.csr),
            _ => None,
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32, now: Cycles, clock: &LocalClock) {
        match offset {
            0x00 => {
                self.cr = value;
                if self.family == Family::F4 {
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
        for at in [&mut self.overdrive_ready, &mut self.switch_ready] {
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
    use crate::part::Family;

    #[test]
    fn overdrive_reports_ready_after_its_time_and_never_without_being_asked() {
        let clock = LocalClock::new(16_000_000, 0, 0);
        let mut pwr = Pwr::new(Family::F4);
        assert_eq!(pwr.read(4, 1_000_000).unwrap() & 3 << 16, 0);
        pwr.write(0, 0xC000 | 1 << 16, 1_000_000, &clock);
        assert_eq!(pwr.read(4, 1_000_000).unwrap() & 3 << 16, 0);
        assert_eq!(pwr.read(4, 1_000_720).unwrap() & 3 << 16, 1 << 16);
        pwr.write(0, 0xC000 | 3 << 16, 1_001_000, &clock);
        assert_eq!(pwr.read(4, 1_001_720).unwrap() & 3 << 16, 3 << 16);
    }

    #[test]
    fn the_f303_shows_its_prefetch_buffer_as_enabled() {
        let mut flash = Flash::new(Family::F3);
        assert_eq!(flash.read(0), Some(0x30));
        flash.write(0, 0x12);
        assert_eq!(flash.read(0), Some(0x32));
    }
}
