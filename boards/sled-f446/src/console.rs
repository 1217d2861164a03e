//! The console: USART2, TX PA2, RX PA3, 115 200 baud 8N1, sent by DMA1 stream 6.

use crate::{clocks::APB1_HZ, pac};
use sled_common::dma::Shared;
use sled_common::lines::{LineQueue, Transmitter};

/// Bits per second.
pub const BAUD: u32 = 115_200;
/// Lines that wait at most.
pub const LINES: usize = 8;
/// Longest line, line ending included.
pub const WIDTH: usize = 128;
const TOTAL: usize = LINES * WIDTH;

/// DMA request channel of USART2_TX on stream 6 (RM0390 table 28).
const CHANNEL: u8 = 4;

static MEMORY: Shared<u8, TOTAL> = Shared::new(0);

/// The queue of lines in front of the port.
pub type Console = LineQueue<Port, LINES, WIDTH, TOTAL>;

/// USART2's transmitter with its DMA stream. The stream is this type's alone; the other
/// streams of DMA1 belong to others, so its registers are reached through the pointer.
pub struct Port(());

pub(crate) fn start(usart: pac::USART2, rcc: &pac::RCC) -> Option<Console> {
    let memory = MEMORY.take()?;
    rcc.apb1enr().modify(|_, w| w.usart2en().set_bit());
    rcc.ahb1enr().modify(|_, w| w.dma1en().set_bit());
    // SAFETY: divider of RM0390 25.4.4 for oversampling by 16, rounded to the nearest.
    usart
        .brr()
        .write(|w| unsafe { w.bits(((APB1_HZ + BAUD / 2) / BAUD) as u16) });
    usart.cr3().write(|w| w.dmat().set_bit());
    usart
        .cr1()
        .write(|w| w.ue().set_bit().te().set_bit().re().set_bit());
    Some(LineQueue::new(Port(()), memory))
}

impl Transmitter for Port {
    fn start(&mut self, address: u32, length: u16) {
        // SAFETY: stream 6 is this type's; memory to peripheral, one byte at a time, from
        // memory that the queue leaves alone until the transfer has ended.
        unsafe {
            let stream = (*pac::DMA1::ptr()).st(6);
            stream
                .par()
                .write(|w| w.bits((*pac::USART2::ptr()).dr().as_ptr() as u32));
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

    fn finished(&mut self) -> bool {
        // SAFETY: reads and clears the flags of stream 6 only (bits 16..=21 of HISR).
        unsafe {
            let dma = &*pac::DMA1::ptr();
            let flags = dma.hisr().read().bits() & (0b11_1101 << 16);
            dma.hifcr().write(|w| w.bits(flags));
            flags & (1 << 21 | 1 << 19) != 0
        }
    }
}
