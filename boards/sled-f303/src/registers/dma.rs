//! Addresses and lengths of the DMA channels (RM0316 chapter 13).

use crate::pac::dma1::CH;

/// Connects a channel to a register of a peripheral.
#[inline(always)]
pub(crate) fn set_register(channel: &CH, register: u32) {
    // SAFETY: any address is valid while the channel is disabled.
    channel.par.write(|w| unsafe { w.bits(register) });
}

/// Sets the memory of the next transfer.
#[inline(always)]
pub(crate) fn set_memory(channel: &CH, address: u32, length: u16) {
    // SAFETY: any address is valid while the channel is disabled; the caller that enables the
    // channel is responsible for the memory.
    channel.mar.write(|w| unsafe { w.bits(address) });
    channel.ndtr.write(|w| w.ndt().bits(length));
}

/// Acknowledges the interrupt of channel 7; false if it did not end a transfer.
///
/// The HAL reads the status register once for each flag.
#[inline(always)]
pub(crate) fn finished_7() -> bool {
    // SAFETY: reads and clears the flags of channel 7 only (bits 24 to 27).
    unsafe {
        let dma = &*crate::pac::DMA1::ptr();
        let flags = dma.isr.read().bits() & (0b1111 << 24);
        dma.ifcr.write(|w| w.bits(flags));
        flags & (1 << 25 | 1 << 27) != 0
    }
}

/// Lets a channel read half-words from its register without end, into a ring.
#[inline(always)]
pub(crate) fn set_ring_of_half_words(channel: &CH) {
    channel.cr.modify(|_, w| {
        w.circ().set_bit();
        w.psize().bits16();
        w.msize().bits16()
    });
}

/// Lets a channel read half-words from its register, one after the other into its memory, until that
/// is full.
#[inline(always)]
pub(crate) fn set_row_of_half_words(channel: &CH) {
    channel.cr.modify(|_, w| {
        w.minc().set_bit();
        w.psize().bits16();
        w.msize().bits16()
    });
}

/// How a transfer of channel 1 has ended.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum End {
    /// Its memory is full.
    Complete,
    /// A bus refused an access.
    Failed,
    /// It has not ended.
    Running,
}

/// Acknowledges the interrupt of channel 1.
#[inline(always)]
pub(crate) fn end_1() -> End {
    // SAFETY: reads and clears the flags of channel 1 only (bits 0 to 3).
    let flags = unsafe {
        let dma = &*crate::pac::DMA1::ptr();
        let flags = dma.isr.read().bits() & 0b1111;
        dma.ifcr.write(|w| w.bits(flags));
        flags
    };
    if flags & 1 << 3 != 0 {
        End::Failed
    } else if flags & 1 << 1 != 0 {
        End::Complete
    } else {
        End::Running
    }
}

/// Lets a channel send the bytes of its memory one after the other.
#[inline(always)]
pub(crate) fn set_memory_increment(channel: &CH) {
    channel.cr.modify(|_, w| w.minc().set_bit());
}
