//! Serial ports, 8N1, oversampling by 16 (RM0390 25.6).

pub(crate) use crate::pac::usart1::RegisterBlock;

/// Optional functions of a port.
#[derive(Clone, Copy, Default)]
pub(crate) struct Uses {
    /// A DMA stream feeds the transmitter.
    pub(crate) transmit_dma: bool,
    /// A DMA stream empties the receiver. Line errors interrupt.
    pub(crate) receive_dma: bool,
    /// The port interrupts when the line becomes idle.
    pub(crate) idle: bool,
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
        w.dmar().bit(uses.receive_dma);
        w.eie().bit(uses.receive_dma)
    });
    usart.cr1().write(|w| {
        w.ue().set_bit();
        w.te().set_bit();
        w.re().set_bit();
        w.idleie().bit(uses.idle);
        w.rxneie().bit(uses.received)
    });
}

/// Address of the data register, for a DMA stream.
#[inline(always)]
pub(crate) fn data_register(usart: &RegisterBlock) -> u32 {
    usart.dr().as_ptr() as u32
}

/// Clears the flags of an idle line and of line errors on a port that a DMA stream empties; true if
/// a byte was lost.
///
/// A read of the status and then one of the data clear the flags (RM0390 25.6.1). The second one
/// also takes the byte away that waits in the data register. So while a byte waits, it is left to
/// the stream: its read clears the flags, and the interrupt comes again if it did not.
///
/// A byte that ends in the four cycles between the two reads here is still taken. The line was idle
/// when this interrupt was raised, so that happens only if the interrupt is served later than a
/// whole byte after its cause.
#[inline(always)]
pub(crate) fn acknowledge_line(usart: &RegisterBlock) -> bool {
    let status = usart.sr().read();
    if status.rxne().bit_is_clear() {
        let _ = usart.dr().read();
    }
    status.ore().bit_is_set()
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
