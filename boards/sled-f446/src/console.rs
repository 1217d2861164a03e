//! The console: USART2, TX PA2, RX PA3, 115 200 baud 8N1, sent by DMA1 stream 6.

use crate::dma::{self, DmaChannel, Stream6};
use crate::pac;
use crate::registers::{clocks::APB1_HZ, usart, usart::Uses};
use sled_common::dma::Shared;
use sled_common::lines::{LineQueue, Transmitter};

/// Bits per second.
pub const BAUD: u32 = 115_200;
/// Capacity of the queue, in lines.
pub const LINES: usize = 8;
/// Longest line, line ending included.
pub const WIDTH: usize = 128;
const TOTAL: usize = LINES * WIDTH;

static MEMORY: Shared<u8, TOTAL> = Shared::new(0);

/// The queue of lines in front of the port.
pub type Console = LineQueue<Port, LINES, WIDTH, TOTAL>;

/// USART2's transmitter with its DMA stream.
pub struct Port {
    stream: Stream6<pac::DMA1>,
}

/// DMA request channel of USART2_TX on stream 6 (RM0390 table 28).
const CHANNEL: DmaChannel = DmaChannel::Channel4;

/// The clock gate of USART2 is open.
pub(crate) fn start(port: &pac::USART2, mut stream: Stream6<pac::DMA1>) -> Option<Console> {
    let memory = MEMORY.take()?;
    let uses = Uses {
        transmit_dma: true,
        ..Uses::default()
    };
    usart::start(port, APB1_HZ, BAUD, uses);
    dma::feed(&mut stream, CHANNEL, usart::data_register(port));
    Some(LineQueue::new(Port { stream }, memory))
}

impl Transmitter for Port {
    fn start(&mut self, address: u32, length: u16) {
        // SAFETY: the queue leaves its memory alone until the transfer has ended.
        unsafe { dma::send(&mut self.stream, address, length) };
    }

    fn finished(&mut self) -> bool {
        dma::finished(&mut self.stream)
    }
}
