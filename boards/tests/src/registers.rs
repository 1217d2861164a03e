//! Registers that the tests read, or that they set in ways in which no driver does.
//!
//! The crates of the two parts name them differently. So a test uses addresses: the base of the
//! block is that of the part's crate, the offset that of the reference manual.

use crate::board::pac;

/// A block of registers.
#[derive(Clone, Copy)]
pub(crate) struct Block(u32);

impl Block {
    /// Reads the register at this offset.
    pub(crate) fn read(self, offset: u32) -> u32 {
        // SAFETY: an aligned register of a peripheral of the part. Only one test runs, and it
        // knows what it does to the driver of this peripheral.
        unsafe { self.register(offset).read_volatile() }
    }

    /// Writes the register at this offset.
    pub(crate) fn write(self, offset: u32, value: u32) {
        // SAFETY: as above. No register used here makes the hardware write to memory.
        unsafe { self.register(offset).write_volatile(value) }
    }

    /// Sets bits of the register at this offset.
    pub(crate) fn set(self, offset: u32, bits: u32) {
        self.write(offset, self.read(offset) | bits);
    }

    /// Clears bits of the register at this offset.
    #[cfg(feature = "f446")]
    pub(crate) fn clear(self, offset: u32, bits: u32) {
        self.write(offset, self.read(offset) & !bits);
    }

    fn register(self, offset: u32) -> *mut u32 {
        (self.0 + offset) as *mut u32
    }
}

/// Reset and clock control (RM0390 6.3, RM0316 9.4).
pub(crate) fn rcc() -> Block {
    Block(pac::RCC::ptr() as u32)
}

/// Flash control (RM0390 3.8, RM0316 4.5).
pub(crate) fn flash() -> Block {
    Block(pac::FLASH::ptr() as u32)
}

/// The independent watchdog (RM0390 chapter 22, RM0316 chapter 25).
pub(crate) fn iwdg() -> Block {
    Block(pac::IWDG::ptr() as u32)
}

/// The timer of the time base (RM0390 17.4, RM0316 21.4).
pub(crate) fn tim2() -> Block {
    Block(pac::TIM2::ptr() as u32)
}

/// Port A (RM0390 7.4, RM0316 11.4).
pub(crate) fn port_a() -> Block {
    Block(pac::GPIOA::ptr() as u32)
}

/// Port B.
#[cfg(feature = "f303")]
pub(crate) fn port_b() -> Block {
    Block(pac::GPIOB::ptr() as u32)
}

/// The first serial port (RM0390 25.6).
#[cfg(feature = "f446")]
pub(crate) fn usart1() -> Block {
    Block(pac::USART1::ptr() as u32)
}

/// The DMA controller of the converter (RM0390 9.5, RM0316 13.5).
pub(crate) fn converter_dma() -> Block {
    #[cfg(feature = "f446")]
    let controller = pac::DMA2::ptr() as u32;
    #[cfg(feature = "f303")]
    let controller = pac::DMA1::ptr() as u32;
    Block(controller)
}

/// The CAN cell (RM0390 30.9, RM0316 31.9).
pub(crate) fn can() -> Block {
    #[cfg(feature = "f446")]
    let cell = pac::CAN1::ptr() as u32;
    #[cfg(feature = "f303")]
    let cell = pac::CAN::ptr() as u32;
    Block(cell)
}
