//! The clocks of a running board, and why it started.

/// The oscillator that the system clock is made from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Oscillator {
    /// The 8 MHz clock that the on-board debugger feeds into the HSE input.
    External,
    /// The RC oscillator of the microcontroller, because the external clock has not come yet. It
    /// is accurate to 1 % at 25 degrees Celsius, and to 5 % over all temperatures (data sheets),
    /// so it is trimmed by the bus before the node sends.
    Internal,
}

/// Frequencies after start-up, in hertz.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Clocks {
    /// Where the clock comes from.
    pub oscillator: Oscillator,
    /// Core and AHB clock, Hz.
    pub core: u32,
    /// Peripheral bus 1 (CAN, USART2 and 3), Hz.
    pub apb1: u32,
    /// Peripheral bus 2 (USART1), Hz.
    pub apb2: u32,
    /// Rate of the node's time base (TIM2), ticks per microsecond.
    pub ticks_per_us: u32,
}

impl Clocks {
    /// The clocks of a board that made them from `oscillator`.
    pub const fn of(sled: &parts::Sled, oscillator: Oscillator) -> Self {
        let clocks = match oscillator {
            Oscillator::External => &sled.external,
            Oscillator::Internal => &sled.internal,
        };
        Self {
            oscillator,
            core: clocks.core,
            apb1: clocks.apb1,
            apb2: clocks.apb2,
            ticks_per_us: clocks.ticks_per_us,
        }
    }
}

/// Why the microcontroller started (RM0390 6.3.21, RM0316 9.4.10).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ResetCause {
    /// Power came up, or dipped below the power-down reset.
    #[default]
    Power,
    /// The reset pin.
    Pin,
    /// The program asked for it; [`crate::fault`] may know why.
    Software,
    /// The independent watchdog was not fed.
    Watchdog,
    /// Window watchdog, low-power or option-byte reset; the firmware uses none of them.
    Other,
}

impl ResetCause {
    /// Decodes the flags in the upper half of RCC_CSR.
    ///
    /// Both parts use the same positions: PINRSTF 26, PORRSTF 27, SFTRSTF 28,
    /// IWDGRSTF 29, WWDGRSTF 30, LPWRRSTF 31. Every internal reset also pulls the
    /// reset pin, so the pin counts only when nothing else is flagged. Power counts first: a part
    /// that waits for its supply may start several times before it clears the flags.
    pub const fn from_csr(csr: u32) -> Self {
        if csr & (1 << 27) != 0 {
            Self::Power
        } else if csr & (1 << 29) != 0 {
            Self::Watchdog
        } else if csr & (1 << 28) != 0 {
            Self::Software
        } else if csr & (1 << 30 | 1 << 31) != 0 {
            Self::Other
        } else if csr & (1 << 26) != 0 {
            Self::Pin
        } else {
            Self::Power
        }
    }

    /// The number that stands for this cause in event messages.
    pub const fn code(self) -> u8 {
        match self {
            Self::Power => 0,
            Self::Pin => 1,
            Self::Software => 2,
            Self::Watchdog => 3,
            Self::Other => 4,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::ResetCause;

    #[test]
    fn the_pin_flag_that_comes_with_every_reset_hides_no_cause() {
        assert_eq!(ResetCause::from_csr(0x0C00_0000), ResetCause::Power);
        assert_eq!(ResetCause::from_csr(0x1C00_0000), ResetCause::Power);
        assert_eq!(ResetCause::from_csr(0x0400_0000), ResetCause::Pin);
        assert_eq!(ResetCause::from_csr(0x1400_0000), ResetCause::Software);
        assert_eq!(ResetCause::from_csr(0x2400_0000), ResetCause::Watchdog);
        assert_eq!(ResetCause::from_csr(0x4400_0000), ResetCause::Other);
        assert_eq!(ResetCause::from_csr(0x8400_0000), ResetCause::Other);
    }
}
