//! The console: USART2, TX PA2, RX PA3, 115 200 baud 8N1, sent by DMA1 stream 6.

use crate::{clocks::APB1_HZ, pac, stream::Stream};
use sled_common::dma::Shared;
use sled_common::lines::{LineQueue, Transmitter};

/// Bits per second.
pub const BAUD: u32 = 115_200;
/// Lines that wait at most.
pub const LINES: usize = 8;
/// Longest line, line ending included.
pub const WIDTH: usize = 128;
const TOTAL: usize = LINES * WIDTH;

static MEMORY: Shared<u8, TOTAL> = Shared::new(0);

/// The queue of lines in front of the port.
pub type Console = LineQueue<Port, LINES, WIDTH, TOTAL>;

/// USART2's transmitter with its DMA stream.
pub struct Port(Stream<6>);

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
    Some(LineQueue::new(Port(Stream::new()), memory))
}

impl Transmitter for Port {
    fn start(&mut self, address: u32, length: u16) {
        // SAFETY: the queue leaves its memory alone until the transfer has ended; USART2's
        // requests come to stream 6.
        unsafe {
            let register = (*pac::USART2::ptr()).dr().as_ptr() as u32;
            self.0.start(address, length, register);
        }
    }

    fn finished(&mut self) -> bool {
        self.0.finished()
    }
}
