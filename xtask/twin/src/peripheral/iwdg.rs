//! The independent watchdog (RM0390 chapter 22, RM0316 chapter 25). Its own RC oscillator drives a
//! prescaler and a 12-bit down-counter, which resets the part at zero.

use crate::clock::{NEVER, Ps};
use crate::part::Family;

const UNLOCK: u32 = 0x5555;
const RELOAD: u32 = 0xAAAA;
const START: u32 = 0xCCCC;

/// A new prescaler or reload value takes effect after up to five cycles of the oscillator.
const UPDATE_CYCLES: u64 = 5;

#[derive(Clone, Debug)]
pub(crate) struct Iwdg {
    family: Family,
    hertz: u64,
    unlocked: bool,
    running: bool,
    prescaler: u32,
    reload: u32,
    window: u32,
    /// A written value that has not taken effect yet, and when it will.
    next_prescaler: Option<(u32, Ps)>,
    next_reload: Option<(u32, Ps)>,
    /// Counter value at a reference time, from which it counts down.
    count: u32,
    since: Ps,
}

impl Iwdg {
    pub(crate) fn new(family: Family, hertz: u64) -> Self {
        Self {
            family,
            hertz,
            unlocked: false,
            running: false,
            prescaler: 0,
            reload: 0xFFF,
            window: 0xFFF,
            next_prescaler: None,
            next_reload: None,
            count: 0xFFF,
            since: 0,
        }
    }

    /// Whether it has been started.
    pub(crate) const fn runs(&self) -> bool {
        self.running
    }

    /// Its oscillator has another frequency from `now` on.
    pub(crate) fn set_rate(&mut self, hertz: u64, now: Ps) {
        self.settle(now);
        self.count = self.counter(now);
        self.since = now;
        self.hertz = hertz;
    }

    /// Time per count at prescaler code `pr`: 4 << pr cycles, at most 256.
    fn step(&self) -> Ps {
        let divider = 4_u64 << self.prescaler.min(6);
        1_000_000_000_000 * divider / self.hertz
    }

    fn settle(&mut self, now: Ps) {
        if let Some((value, at)) = self.next_prescaler
            && at <= now
        {
            self.count = self.counter(at);
            self.since = at;
            self.prescaler = value;
            self.next_prescaler = None;
        }
        if let Some((value, at)) = self.next_reload
            && at <= now
        {
            self.reload = value;
            self.next_reload = None;
        }
    }

    fn counter(&self, now: Ps) -> u32 {
        if !self.running {
            return self.count;
        }
        let gone = (now.saturating_sub(self.since)) / self.step();
        self.count
            .saturating_sub(u32::try_from(gone).unwrap_or(u32::MAX))
    }

    /// When it resets the part if the program writes nothing more.
    pub(crate) fn expires(&self) -> Ps {
        if !self.running {
            return NEVER;
        }
        let Some((_, at)) = self.next_prescaler else {
            return self.since + u64::from(self.count + 1) * self.step();
        };
        // A new prescaler has not taken effect yet: check again when it has.
        at
    }

    /// True if the counter has reached zero.
    pub(crate) fn expired(&mut self, now: Ps) -> bool {
        self.settle(now);
        self.running && now >= self.expires()
    }

    pub(crate) fn read(&mut self, offset: u32, now: Ps) -> Option<u32> {
        self.settle(now);
        match offset {
            0x00 => Some(0),
            0x04 => Some(self.next_prescaler.map_or(self.prescaler, |(v, _)| v)),
            0x08 => Some(self.next_reload.map_or(self.reload, |(v, _)| v)),
            0x0C => Some(
                u32::from(self.next_prescaler.is_some())
                    | u32::from(self.next_reload.is_some()) << 1,
            ),
            0x10 if self.family == Family::F3 => Some(self.window),
            _ => None,
        }
    }

    /// True if the write resets the part: a reload while the counter is above the window.
    pub(crate) fn write(&mut self, offset: u32, value: u32, now: Ps) -> bool {
        self.settle(now);
        let arrival = now + UPDATE_CYCLES * 1_000_000_000_000 / self.hertz;
        match offset {
            0x00 => {
                self.unlocked = value == UNLOCK;
                match value {
                    START if !self.running => {
                        self.running = true;
                        self.count = self.reload;
                        self.since = now;
                    }
                    RELOAD => {
                        let early = self.running && self.counter(now) > self.window;
                        self.count = self.reload;
                        self.since = now;
                        return early;
                    }
                    _ => {}
                }
            }
            0x04 if self.unlocked => self.next_prescaler = Some((value & 7, arrival)),
            0x08 if self.unlocked => self.next_reload = Some((value & 0xFFF, arrival)),
            0x10 if self.unlocked && self.family == Family::F3 => {
                self.window = value & 0xFFF;
                self.count = self.reload;
                self.since = now;
            }
            _ => {}
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::Iwdg;
    use crate::part::Family;

    const MS: u64 = 1_000_000_000;

    fn started(reload: u32) -> Iwdg {
        let mut dog = Iwdg::new(Family::F4, 32_000);
        dog.write(0x00, 0xCCCC, 0);
        dog.write(0x00, 0x5555, 0);
        dog.write(0x04, 3, 0);
        dog.write(0x08, reload, 0);
        assert_eq!(dog.read(0x0C, 0), Some(3), "both values on their way");
        assert!(!dog.expired(MS));
        assert_eq!(dog.read(0x0C, MS), Some(0));
        dog.write(0x00, 0xAAAA, MS);
        dog
    }

    #[test]
    fn it_bites_a_count_after_zero() {
        let mut dog = started(99);
        assert_eq!(dog.expires(), MS + 100 * MS);
        assert!(!dog.expired(101 * MS - 1));
        assert!(dog.expired(101 * MS));
    }

    #[test]
    fn it_follows_its_oscillator() {
        let mut dog = started(99);
        // Half of the time has passed; the rest takes twice as long.
        dog.set_rate(16_000, 51 * MS);
        assert_eq!(dog.expires(), 51 * MS + 100 * MS);
    }

    #[test]
    fn feeding_gives_the_full_time_again() {
        let mut dog = started(99);
        dog.write(0x00, 0xAAAA, 90 * MS);
        assert_eq!(dog.expires(), 190 * MS);
    }

    #[test]
    fn registers_are_locked_without_the_key() {
        let mut dog = Iwdg::new(Family::F4, 32_000);
        dog.write(0x08, 5, 0);
        assert_eq!(dog.read(0x08, MS), Some(0xFFF));
        dog.write(0x00, 0x5555, MS);
        dog.write(0x00, 0x1234, MS);
        dog.write(0x08, 5, MS);
        assert_eq!(dog.read(0x08, 2 * MS), Some(0xFFF));
    }

    #[test]
    fn the_f303_resets_on_a_reload_above_the_window() {
        let mut dog = Iwdg::new(Family::F3, 40_000);
        dog.write(0x00, 0xCCCC, 0);
        dog.write(0x00, 0x5555, 0);
        dog.write(0x10, 0x800, 0);
        assert!(dog.write(0x00, 0xAAAA, MS), "too early");
        let after = 0x900 * 4 * MS / 40;
        assert!(!dog.write(0x00, 0xAAAA, MS + after));
    }
}
