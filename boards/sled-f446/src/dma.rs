//! DMA streams (RM0390 chapter 9), through the HAL's stream types.
//!
//! The HAL's `Transfer` owns its buffer and returns it at the end of a transfer. That does not
//! suit a ring that the processor reads while it is being filled, nor a queue that sends its
//! lines one after the other from one memory. So the streams are used directly.

pub(crate) use stm32f4xx_hal::dma::config::Priority;
pub(crate) use stm32f4xx_hal::dma::traits::Stream;
pub(crate) use stm32f4xx_hal::dma::{DmaChannel, DmaDataSize, Stream0, Stream2, Stream3};
pub(crate) use stm32f4xx_hal::dma::{Stream6, StreamsTuple};

use stm32f4xx_hal::dma::{DmaDirection, DmaEvent, DmaFlag};

/// Connects a stream to the transmitter whose data register is `register`: bytes from
/// memory, an interrupt at the end of each transfer.
#[inline(always)]
pub(crate) fn feed(stream: &mut impl Stream, channel: DmaChannel, register: u32) {
    stream.set_peripheral_address(register);
    stream.set_channel(channel);
    stream.set_direction(DmaDirection::MemoryToPeripheral);
    stream.set_memory_increment(true);
    stream.listen(DmaEvent::TransferComplete | DmaEvent::TransferError);
}

/// Starts the transfer of `length` bytes from `address`.
///
/// # Safety
/// The bytes must stay untouched until [`finished`] has returned true.
#[inline(always)]
pub(crate) unsafe fn send(stream: &mut impl Stream, address: u32, length: u16) {
    stream.set_memory_address(address);
    stream.set_number_of_transfers(length);
    // SAFETY: the caller's promise; the stream has ended its last transfer.
    unsafe { stream.enable() };
}

/// Acknowledges the interrupt of a stream; false if it did not end a transfer.
#[inline(always)]
pub(crate) fn finished(stream: &mut impl Stream) -> bool {
    let flags = stream.flags();
    stream.clear_flags(flags);
    flags.intersects(DmaFlag::TransferComplete | DmaFlag::TransferError)
}

/// Acknowledges the interrupt of a stream.
#[inline(always)]
pub(crate) fn acknowledge(stream: &mut impl Stream) {
    let flags = stream.flags();
    stream.clear_flags(flags);
}

/// How a stream fills a ring.
pub(crate) struct Ring {
    /// The request that it serves.
    pub(crate) channel: DmaChannel,
    /// Data register that it reads.
    pub(crate) register: u32,
    /// First address of the ring.
    pub(crate) address: u32,
    /// Elements of the ring.
    pub(crate) length: u16,
    /// Size of one element.
    pub(crate) size: DmaDataSize,
    /// Priority among the streams.
    pub(crate) priority: Priority,
    /// True if the stream also interrupts when half of the ring is full.
    pub(crate) halves: bool,
}

/// Fills a ring without end.
///
/// # Safety
/// The memory of the ring is read by volatile accesses only, and belongs to the stream for
/// ever.
#[inline(always)]
pub(crate) unsafe fn circulate(stream: &mut impl Stream, ring: &Ring) {
    stream.set_peripheral_address(ring.register);
    stream.set_memory_address(ring.address);
    stream.set_number_of_transfers(ring.length);
    stream.set_channel(ring.channel);
    stream.set_direction(DmaDirection::PeripheralToMemory);
    stream.set_priority(ring.priority);
    stream.set_memory_increment(true);
    stream.set_circular_mode(true);
    stream.listen(DmaEvent::TransferComplete);
    if ring.halves {
        stream.listen(DmaEvent::HalfTransfer);
    }
    // SAFETY: the caller's promise; the stream did not run before.
    unsafe {
        stream.set_memory_size(ring.size);
        stream.set_peripheral_size(ring.size);
        stream.enable();
    }
}
