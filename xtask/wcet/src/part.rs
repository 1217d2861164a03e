//! What the analysis needs to know of a microcontroller.

use super::extent::Extent;

/// A core, whose manual says what each instruction costs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Core {
    /// Cortex-M0 (Armv6-M; Arm DDI 0432C, 3.3).
    CortexM0,
    /// Cortex-M0+ (Armv6-M; Arm DDI 0484C, 3.3).
    CortexM0Plus,
    /// Cortex-M3 (Armv7-M; Arm DDI 0337I, 3.3).
    CortexM3,
    /// Cortex-M4 with or without its floating-point unit (Armv7E-M; Arm 100166, 3.3 and 7.3).
    CortexM4,
}

impl Core {
    /// All of them.
    pub const ALL: [Self; 4] = [
        Self::CortexM0,
        Self::CortexM0Plus,
        Self::CortexM3,
        Self::CortexM4,
    ];

    /// Its name, as in files and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::CortexM0 => "cortex-m0",
            Self::CortexM0Plus => "cortex-m0plus",
            Self::CortexM3 => "cortex-m3",
            Self::CortexM4 => "cortex-m4",
        }
    }

    /// The core of this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|core| core.name() == name)
    }

    /// Whether it has the register `BASEPRI`. A core without it masks single interrupts in the
    /// interrupt controller instead.
    #[must_use]
    pub const fn has_basepri(self) -> bool {
        match self {
            Self::CortexM0 | Self::CortexM0Plus => false,
            Self::CortexM3 | Self::CortexM4 => true,
        }
    }
}

/// A few stretches of the address space.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Areas {
    all: [Option<Extent>; Areas::MOST],
}

impl Areas {
    /// The most stretches that it holds.
    pub const MOST: usize = 8;
    /// None.
    pub const NONE: Self = Self {
        all: [None; Self::MOST],
    };

    /// These stretches: address of the first byte and of the last one. Those beyond [`Areas::MOST`] are
    /// left out.
    #[must_use]
    pub const fn new(stretches: &[(u32, u32)]) -> Self {
        let mut all = [None; Self::MOST];
        let mut at = 0;
        while at < stretches.len() && at < Self::MOST {
            let (first, last) = stretches[at];
            all[at] = Some(Extent::new(first, last));
            at += 1;
        }
        Self { all }
    }

    /// Whether one of them holds `address`.
    #[must_use]
    pub fn contains(&self, address: u32) -> bool {
        self.within(address, address)
    }

    /// Whether one of them holds all bytes from `first` to `last`.
    #[must_use]
    pub fn within(&self, first: u32, last: u32) -> bool {
        let mut all = self.all.iter().flatten();
        all.any(|area| area.contains(first) && area.contains(last) && first <= last)
    }

    /// Whether one of them holds a byte from `first` to `last`.
    #[must_use]
    pub fn meets(&self, first: u32, last: u32) -> bool {
        let mut all = self.all.iter().flatten();
        all.any(|area| area.meet(Extent::new(first, last)).is_some())
    }
}

/// A microcontroller on its clocks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Part {
    /// Its core.
    pub core: Core,
    /// Clock of the core, in Hz.
    pub core_hz: u32,
    /// Bits of a priority that its interrupt controller has.
    pub priority_bits: u8,
    /// The value of `BASEPRI` with which a program keeps every task from running until start-up has
    /// ended, if it does so; a program that does so has no task of the highest priority, which
    /// `BASEPRI` cannot mask.
    pub start_mask: Option<u8>,
    /// Cycles of a multiplication, if the core is a Cortex-M0 or Cortex-M0+: 1 or 32, as its maker
    /// chose.
    pub multiply_cycles: u8,
    /// Memories of code and constants, with every address at which they appear.
    pub flash: Areas,
    /// Cycles beyond the first to read a line of them.
    pub flash_waits: u32,
    /// Bytes that one such read gives.
    pub line_bytes: u32,
    /// Whether the next line is read while one is executed.
    pub reads_ahead: bool,
    /// Lines of a cache of instructions that replaces the line unused for longest; zero without such a
    /// cache. One needs [`Part::reads_ahead`].
    pub instruction_lines: usize,
    /// The same of a cache of constants.
    pub constant_lines: usize,
    /// Memories that can be written.
    pub ram: Areas,
    /// Cycles beyond the first of an access to them.
    pub ram_waits: u32,
    /// Cycles beyond the first of an access to a peripheral.
    pub peripheral_waits: u32,
    /// Peripherals on a faster bus.
    pub fast_peripherals: Areas,
    /// Cycles beyond the first of an access to those.
    pub fast_waits: u32,
    /// A peripheral that has no access to memory and takes any word as data, also one that looks like
    /// an address.
    pub inert: Option<(u32, u32)>,
}

impl Part {
    /// The bits of `BASEPRI` that it has.
    #[must_use]
    pub const fn priority_mask(&self) -> u8 {
        !(0xff >> self.priority_bits)
    }

    /// The number of its priorities.
    #[must_use]
    pub const fn priorities(&self) -> u32 {
        1 << self.priority_bits
    }

    /// The priority as programs count them, 1 for the lowest, of a value in a priority register or in
    /// `BASEPRI`.
    #[must_use]
    pub const fn priority(&self, value: u8) -> u32 {
        self.priorities() - (value >> (8 - self.priority_bits)) as u32
    }

    /// The same part with its core on another clock; its waits stay.
    #[must_use]
    pub const fn at(self, core_hz: u32) -> Self {
        Self { core_hz, ..self }
    }
}

/// Clocks of the peripheral buses of an STM32, and where their peripherals lie: APB1 from
/// `0x4000_0000`, APB2 and AHB from `0x4001_0000` on. The alias of bits is of both.
pub const STM32_FAST: Areas = Areas::new(&[(0x4001_0000, 0x41ff_ffff), (0x4400_0000, 0x5fff_ffff)]);

/// Cycles beyond the first of an access by the core to a peripheral on a bus: at most three periods of
/// the bus, two of the transfer and one of synchronisation.
#[must_use]
pub const fn bus_waits(core_hz: u32, bus_hz: u32) -> u32 {
    3 * core_hz.div_ceil(bus_hz)
}

#[cfg(test)]
mod tests {
    use super::{Areas, Core};

    #[test]
    fn a_core_is_found_by_its_name() {
        for core in Core::ALL {
            assert_eq!(Core::named(core.name()), Some(core));
        }
        assert_eq!(Core::named("cortex-m7"), None);
    }

    #[test]
    fn an_area_holds_a_stretch_or_a_part_of_it() {
        let areas = Areas::new(&[(0, 0xff), (0x200, 0x2ff)]);
        assert!(areas.contains(0xff) && !areas.contains(0x100));
        assert!(areas.within(0x200, 0x2ff) && !areas.within(0xff, 0x200));
        assert!(areas.meets(0xff, 0x200) && !areas.meets(0x100, 0x1ff));
        assert!(!Areas::NONE.meets(0, u32::MAX));
    }
}
