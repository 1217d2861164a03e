//! The console: USART2, TX PA2, RX PA15, 115 200 baud 8N1, sent by DMA1 channel 7.

use crate::pac;
use crate::registers::{dma, usart};
use sled_common::dma::Shared;
use sled_common::lines::{LineQueue, Transmitter};
use stm32f3xx_hal::dma::Direction;
use stm32f3xx_hal::dma::{Channel, Event, dma1::C7};

/// Bits per second.
pub const BAUD: u32 = 115_200;
/// Capacity of the queue, in lines.
pub const LINES: usize = 4;
/// Longest line, line ending included.
pub const WIDTH: usize = 128;
const TOTAL: usize = LINES * WIDTH;

static MEMORY: Shared<u8, TOTAL> = Shared::new(0);

/// The queue of lines in front of the port.
pub type Console = LineQueue<Port, LINES, WIDTH, TOTAL>;

/// USART2's transmitter with its DMA channel.
pub struct Port {
    channel: C7,
}

impl Port {
    fn registers() -> &'static pac::dma1::CH {
        // SAFETY: the channel is the port's.
        unsafe { &(*pac::DMA1::ptr()).ch7 }
    }
}

/// `clock` is the rate of USART2 in hertz. Its clock gate is open.
pub(crate) fn start(port: &pac::USART2, clock: u32, mut channel: C7) -> Option<Console> {
    let memory = MEMORY.take()?;
    usart::start(port, clock, BAUD, true);
    channel.set_direction(Direction::FromMemory);
    channel.enable_interrupt(Event::TransferComplete);
    channel.enable_interrupt(Event::TransferError);
    dma::set_memory_increment(Port::registers());
    dma::set_register(Port::registers(), usart::transmit_register(port));
    Some(LineQueue::new(Port { channel }, memory))
}

impl Transmitter for Port {
    fn start(&mut self, address: u32, length: u16) {
        self.channel.disable();
        dma::set_memory(Self::registers(), address, length);
        self.channel.enable();
    }

    fn finished(&mut self) -> bool {
        dma::finished_7()
    }
}
