//! Microcontrollers.

/// A range of addresses that holds memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Memory {
    /// Name in tables and linker scripts.
    pub name: &'static str,
    /// First address.
    pub base: u32,
    /// Size in bytes.
    pub size: u32,
    /// True if the DMA controllers reach it.
    pub dma: bool,
}

impl Memory {
    /// True if `address` lies in the memory.
    #[must_use]
    pub const fn contains(&self, address: u32) -> bool {
        address >= self.base && address - self.base < self.size
    }

    /// True if all of `size` bytes at `address` lie in the memory.
    #[must_use]
    pub const fn holds(&self, address: u32, size: u32) -> bool {
        address >= self.base
            && address - self.base <= self.size
            && size <= self.size - (address - self.base)
    }

    /// First address behind the memory.
    #[must_use]
    pub const fn end(&self) -> u32 {
        self.base + self.size
    }
}

/// Parts whose peripherals have the same registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Family {
    /// STM32F4 (RM0390).
    F4,
    /// STM32F3 (RM0316).
    F3,
}

/// How the core reads the flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Flash {
    /// Highest core clock in Hz for 0, 1, 2, ... wait states, ascending, from a supply of
    /// `rated_mv` on.
    pub limits_hz: &'static [u32],
    /// Lowest supply for these limits, mV.
    pub rated_mv: u16,
    /// How much each wait state and none at all give at the lowest supply of the part, Hz.
    pub weak_step_hz: u32,
    /// Bytes that one read of the flash returns.
    pub line_bytes: u32,
    /// Lines of the instruction cache; 0 if the part has none.
    pub instruction_lines: usize,
    /// Lines of the data cache; 0 if the part has none.
    pub data_lines: usize,
}

impl Flash {
    /// Wait states that a core clock needs; `None` above the highest clock of the part.
    #[must_use]
    pub const fn wait_states(&self, core_hz: u32) -> Option<u8> {
        let mut states = 0;
        while states < self.limits_hz.len() {
            if core_hz <= self.limits_hz[states] {
                return Some(states as u8);
            }
            states += 1;
        }
        None
    }
}

/// How a part watches its supply. Thresholds in mV.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Supply {
    /// The part resets itself below this voltage (power-down reset, typical).
    pub reset_mv: u16,
    /// It starts above this one (power-on reset, typical).
    pub start_mv: u16,
    /// Threshold of the voltage detector for each level of PLS: the lowest one when the supply
    /// falls, the highest one when it rises.
    pub detector_mv: [(u16, u16); 8],
}

/// The high-speed internal RC oscillator (HSI). The core runs on it after every reset.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct InternalClock {
    /// Nominal frequency, Hz.
    pub hz: u32,
    /// Largest error at 25 degrees Celsius, ppm.
    pub tolerance_ppm: u32,
}

/// The low-speed internal RC oscillator (LSI), which clocks the independent watchdog.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct WatchdogClock {
    /// Nominal frequency, Hz.
    pub hz: u32,
    /// Lowest frequency that the data sheet allows, Hz.
    pub min_hz: u32,
    /// Highest frequency that the data sheet allows, Hz.
    pub max_hz: u32,
}

/// Highest frequencies of the buses, Hz.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct ClockLimits {
    /// Core and AHB.
    pub core: u32,
    /// Peripheral bus 1.
    pub apb1: u32,
    /// Peripheral bus 2.
    pub apb2: u32,
}

/// The read-only page that identifies a part.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct SystemPage {
    /// First address of the page.
    pub base: u32,
    /// Address of the 96-bit unique identifier.
    pub unique_id: u32,
    /// Address of the flash size in KiB, 16 bits.
    pub flash_kib: u32,
    /// Address of the factory's reading of the internal reference at 3.3 V, 16 bits.
    pub reference: u32,
}

/// A microcontroller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Part {
    /// Short name.
    pub name: &'static str,
    /// Name in text for people.
    pub title: &'static str,
    /// Name that probe-rs knows the part by.
    pub chip: &'static str,
    /// The family, which fixes the register layouts.
    pub family: Family,
    /// Flash memory.
    pub flash: Memory,
    /// Memories that can be written; the first one holds variables.
    pub ram: &'static [Memory],
    /// How the core reads the flash.
    pub flash_access: Flash,
    /// Highest clocks.
    pub limits: ClockLimits,
    /// How it watches its supply.
    pub supply: Supply,
    /// The high-speed internal oscillator.
    pub hsi: InternalClock,
    /// The low-speed internal oscillator.
    pub lsi: WatchdogClock,
    /// bxCAN controllers; two share 28 filter banks, one has 14 (RM0390 30.3, RM0316 31.3).
    pub can_controllers: u8,
    /// The read-only page that identifies the part.
    pub system_page: SystemPage,
    /// DBGMCU_IDCODE: device identifier in bits 0 to 11, a revision in bits 16 to 31.
    pub idcode: u32,
    /// Priority bits that the interrupt controller implements.
    pub priority_bits: u8,
}

const KIB: u32 = 1024;
const MHZ: u32 = 1_000_000;

/// STM32F446RE.
///
/// Memories RM0390 2.2; flash RM0390 3.4.1 table 5 (wait states), 3.4.2 (caches); clocks
/// RM0390 6.2; supply DS10693 6.3.5; oscillators DS10693 6.3.10; identification RM0390 33.6.1
/// and 34; reference DS10693 6.3.24.
pub static F446: Part = Part {
    name: "f446",
    title: "STM32F446RE",
    chip: "STM32F446RETx",
    family: Family::F4,
    flash: Memory {
        name: "FLASH",
        base: 0x0800_0000,
        size: 512 * KIB,
        dma: true,
    },
    ram: &[Memory {
        name: "RAM",
        base: 0x2000_0000,
        size: 128 * KIB,
        dma: true,
    }],
    flash_access: Flash {
        limits_hz: &[
            30 * MHZ,
            60 * MHZ,
            90 * MHZ,
            120 * MHZ,
            150 * MHZ,
            180 * MHZ,
        ],
        rated_mv: 2_700,
        weak_step_hz: 20 * MHZ,
        line_bytes: 16,
        instruction_lines: 64,
        data_lines: 8,
    },
    limits: ClockLimits {
        core: 180 * MHZ,
        apb1: 45 * MHZ,
        apb2: 90 * MHZ,
    },
    supply: Supply {
        reset_mv: 1_680,
        start_mv: 1_720,
        detector_mv: [
            (1_980, 2_190),
            (2_130, 2_370),
            (2_290, 2_510),
            (2_440, 2_650),
            (2_590, 2_820),
            (2_650, 2_990),
            (2_850, 3_100),
            (2_950, 3_210),
        ],
    },
    hsi: InternalClock {
        hz: 16 * MHZ,
        tolerance_ppm: 10_000,
    },
    lsi: WatchdogClock {
        hz: 32_000,
        min_hz: 17_000,
        max_hz: 47_000,
    },
    can_controllers: 2,
    system_page: SystemPage {
        base: 0x1FFF_7800,
        unique_id: 0x1FFF_7A10,
        flash_kib: 0x1FFF_7A22,
        reference: 0x1FFF_7A2A,
    },
    idcode: 0x1000_0421,
    priority_bits: 4,
};

/// STM32F303K8.
///
/// Memories RM0316 3.2 and DS9866 figure 5: the core reaches the core-coupled memory without
/// wait states, the DMA controllers do not reach it. Flash RM0316 4.2.2 and 4.5.1, the same down
/// to the power-down reset (1.8 V); clocks RM0316 9.2; supply DS9866 6.3.3; oscillators DS9866
/// 6.3.8; identification RM0316 33.6.1 and 34; reference DS9866 6.3.4.
pub static F303: Part = Part {
    name: "f303",
    title: "STM32F303K8",
    chip: "STM32F303K8Tx",
    family: Family::F3,
    flash: Memory {
        name: "FLASH",
        base: 0x0800_0000,
        size: 64 * KIB,
        dma: true,
    },
    ram: &[
        Memory {
            name: "RAM",
            base: 0x2000_0000,
            size: 12 * KIB,
            dma: true,
        },
        Memory {
            name: "CCM",
            base: 0x1000_0000,
            size: 4 * KIB,
            dma: false,
        },
    ],
    flash_access: Flash {
        limits_hz: &[24 * MHZ, 48 * MHZ, 72 * MHZ],
        rated_mv: 1_800,
        weak_step_hz: 24 * MHZ,
        line_bytes: 8,
        instruction_lines: 0,
        data_lines: 0,
    },
    limits: ClockLimits {
        core: 72 * MHZ,
        apb1: 36 * MHZ,
        apb2: 72 * MHZ,
    },
    supply: Supply {
        reset_mv: 1_880,
        start_mv: 1_920,
        detector_mv: [
            (2_000, 2_260),
            (2_090, 2_370),
            (2_180, 2_480),
            (2_280, 2_580),
            (2_370, 2_690),
            (2_470, 2_790),
            (2_560, 2_900),
            (2_660, 3_000),
        ],
    },
    hsi: InternalClock {
        hz: 8 * MHZ,
        tolerance_ppm: 10_000,
    },
    lsi: WatchdogClock {
        hz: 40_000,
        min_hz: 30_000,
        max_hz: 50_000,
    },
    can_controllers: 1,
    system_page: SystemPage {
        base: 0x1FFF_F400,
        unique_id: 0x1FFF_F7AC,
        flash_kib: 0x1FFF_F7CC,
        reference: 0x1FFF_F7BA,
    },
    idcode: 0x1000_0438,
    priority_bits: 4,
};

impl Part {
    /// STM32F446RE, the same as [`F446`].
    pub const F446: &'static Self = &F446;
    /// STM32F303K8, the same as [`F303`].
    pub const F303: &'static Self = &F303;
    /// All parts.
    pub const ALL: [&'static Self; 2] = [Self::F446, Self::F303];

    /// The part with this short name.
    #[must_use]
    pub fn named(name: &str) -> Option<&'static Self> {
        Self::ALL.into_iter().find(|part| part.name == name)
    }

    /// Bytes of all memories that can be written.
    #[must_use]
    pub fn ram_bytes(&self) -> u32 {
        self.ram.iter().map(|memory| memory.size).sum()
    }
}
