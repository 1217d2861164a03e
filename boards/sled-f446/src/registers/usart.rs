//! Serial ports, 8N1, oversampling by 16 (RM0390 25.6).

pub(crate) use crate::pac::usart1::RegisterBlock;

/// Optional functions of a port.
#[derive(Clone, Copy, Default)]
pub(crate) struct Uses {
    /// A DMA stream feeds the transmitter.
    pub(crate) transmit_dma: bool,
    /// A DMA stream empties the receiver.
    pub(crate) receive_dma: bool,
    /// The port interrupts at each received byte.
    pub(crate) received: bool,
}

/// Starts a port whose bus runs at `clock` hertz. Its clock gate is open.
#[inline(always)]
pub(crate) fn start(usart: &RegisterBlock, clock: u32, baud: u32, uses: Uses) {
    let divider = (clock + baud / 2) / baud;
    // SAFETY: divider of RM0390 25.4.4, rounded to the nearest; the register holds it.
    usart.brr().write(|w| unsafe { w.bits(divider as u16) });
    usart.cr3().write(|w| {
        w.dmat().bit(uses.transmit_dma);
        w.dmar().bit(uses.receive_dma)
    });
    usart.cr1().write(|w| {
        w.ue().set_bit();
        w.te().set_bit();
        w.re().set_bit();
        w.rxneie().bit(uses.received)
    });
}

/// Address of the data register, for a DMA stream.
#[inline(always)]
pub(crate) fn data_register(usart: &RegisterBlock) -> u32 {
    usart.dr().as_ptr() as u32
}

/// The byte that has arrived, if one has.
#[inline(always)]
pub(crate) fn received(usart: &RegisterBlock) -> Option<u8> {
    let status = usart.sr().read();
    if status.rxne().bit_is_set() || status.ore().bit_is_set() {
        Some(usart.dr().read().bits() as u8)
    } else {
        None
    }
}
