//! The console: USART2, TX PA2, RX PA15, 115 200 baud 8N1, sent by DMA1 channel 7.

use crate::pac;
use sled_common::dma::Shared;
use sled_common::lines::{LineQueue, Transmitter};

/// Bits per second.
pub const BAUD: u32 = 115_200;
/// Lines that wait at most.
pub const LINES: usize = 4;
/// Longest line, line ending included.
pub const WIDTH: usize = 128;
const TOTAL: usize = LINES * WIDTH;

static MEMORY: Shared<u8, TOTAL> = Shared::new(0);

/// The queue of lines in front of the port.
pub type Console = LineQueue<Port, LINES, WIDTH, TOTAL>;

/// USART2's transmitter with its DMA channel. The channel is this type's alone; the other
/// channels of DMA1 belong to others, so its registers are reached through the pointer.
pub struct Port(());

/// The clocks of USART2 and DMA1 are on.
pub(crate) fn start(usart: pac::USART2, clock: u32) -> Option<Console> {
    let memory = MEMORY.take()?;
    // Divider of RM0316 29.5.4 for oversampling by 16, rounded to the nearest.
    let divider = (clock + BAUD / 2) / BAUD;
    // SAFETY: 278 or 313, which the register holds.
    usart.brr.write(|w| unsafe { w.bits(divider) });
    usart.cr3.write(|w| w.dmat().set_bit());
    usart
        .cr1
        .write(|w| w.ue().set_bit().te().set_bit().re().set_bit());
    Some(LineQueue::new(Port(()), memory))
}

impl Transmitter for Port {
    fn start(&mut self, address: u32, length: u16) {
        // SAFETY: channel 7 is this type's; memory to peripheral, one byte at a time, from
        // memory that the queue leaves alone until the transfer has ended.
        unsafe {
            let channel = &(*pac::DMA1::ptr()).ch7;
            channel.cr.write(|w| w.en().clear_bit());
            channel
                .par
                .write(|w| w.bits((*pac::USART2::ptr()).tdr.as_ptr() as u32));
            channel.mar.write(|w| w.bits(address));
            channel.ndtr.write(|w| w.ndt().bits(length));
            channel.cr.write(|w| {
                w.dir().set_bit();
                w.minc().set_bit();
                w.tcie().set_bit();
                w.teie().set_bit();
                w.en().set_bit()
            });
        }
    }

    fn finished(&mut self) -> bool {
        // SAFETY: reads and clears the flags of channel 7 only (bits 24..=27).
        unsafe {
            let dma = &*pac::DMA1::ptr();
            let flags = dma.isr.read().bits() & (0b1111 << 24);
            dma.ifcr.write(|w| w.bits(flags));
            flags & (1 << 25 | 1 << 27) != 0
        }
    }
}
