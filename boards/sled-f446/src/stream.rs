//! A stream of DMA1 that feeds a serial port's transmitter (RM0390 chapter 9).

use crate::pac;

/// DMA request channel of USART2_TX on stream 6 and of USART3_TX on stream 3 (RM0390 table
/// 28): the same.
const CHANNEL: u8 = 4;

/// Stream `STREAM` of DMA1, which is this type's alone; the others belong to others, so its
/// registers are reached through the pointer.
pub(crate) struct Stream<const STREAM: usize>(());

impl<const STREAM: usize> Stream<STREAM> {
    /// Position of the stream's flags in its half of the status registers.
    const SHIFT: u32 = [0, 6, 16, 22][STREAM % 4];
    const TRANSFER_COMPLETE: u32 = 1 << (Self::SHIFT + 5);
    const TRANSFER_ERROR: u32 = 1 << (Self::SHIFT + 3);

    pub(crate) const fn new() -> Self {
        Self(())
    }

    /// Sends `length` bytes from `address` to the data register `to`, one at a time.
    ///
    /// # Safety
    /// The bytes stay untouched until [`Stream::finished`] was true, and `to` is the data
    /// register whose requests come to this stream.
    pub(crate) unsafe fn start(&mut self, address: u32, length: u16, to: u32) {
        // SAFETY: the stream is this type's; the rest is the caller's promise.
        unsafe {
            let stream = (*pac::DMA1::ptr()).st(STREAM);
            stream.par().write(|w| w.bits(to));
            stream.m0ar().write(|w| w.bits(address));
            stream.ndtr().write(|w| w.ndt().bits(length));
            stream.cr().write(|w| {
                w.chsel().bits(CHANNEL);
                w.dir().memory_to_peripheral();
                w.minc().set_bit();
                w.tcie().set_bit();
                w.teie().set_bit();
                w.en().set_bit()
            });
        }
    }

    /// Acknowledges the end of a transfer; false when the interrupt had another cause.
    pub(crate) fn finished(&mut self) -> bool {
        // SAFETY: reads and clears the flags of this stream only.
        unsafe {
            let dma = &*pac::DMA1::ptr();
            let mask = 0b11_1101 << Self::SHIFT;
            let flags = if STREAM < 4 {
                let flags = dma.lisr().read().bits() & mask;
                dma.lifcr().write(|w| w.bits(flags));
                flags
            } else {
                let flags = dma.hisr().read().bits() & mask;
                dma.hifcr().write(|w| w.bits(flags));
                flags
            };
            flags & (Self::TRANSFER_COMPLETE | Self::TRANSFER_ERROR) != 0
        }
    }
}
