//! The satellite receiver's port: USART1, TX PA9, RX PA10, 1 Mbaud 8N1, received by DMA2
//! stream 2 into a ring.
//!
//! The stream interrupts at the half and at the end of the ring, and the USART when the line
//! becomes idle. So bytes wait for 1.28 ms at most, and the end of a burst does not wait
//! (thesis 6.2.4.3).

use crate::dma::{self, DmaChannel, DmaDataSize, Priority, Ring, Stream, Stream2};
use crate::pac;
use crate::registers::{clocks::APB2_HZ, usart, usart::Uses};
use sled_common::dma::{Shared, Window};

/// Bits per second.
pub const BAUD: u32 = 1_000_000;
/// Bytes in the ring: two halves of 1.28 ms.
pub const RING: usize = 256;

/// DMA request channel of USART1_RX on stream 2 (RM0390 table 29).
const CHANNEL: DmaChannel = DmaChannel::Channel4;

static MEMORY: Shared<u8, RING> = Shared::new(0);

/// The receiver's port.
pub struct Receiver {
    usart: pac::USART1,
    stream: Stream2<pac::DMA2>,
    memory: Window<u8, RING>,
    next: usize,
    overruns: u32,
}

/// The clock gate of USART1 is open.
pub(crate) fn start(port: pac::USART1, mut stream: Stream2<pac::DMA2>) -> Option<Receiver> {
    let memory = MEMORY.take()?;
    let ring = Ring {
        channel: CHANNEL,
        register: usart::data_register(&port),
        address: memory.address(),
        length: memory.len(),
        size: DmaDataSize::Byte,
        priority: Priority::VeryHigh,
        halves: true,
    };
    // SAFETY: the memory is a window, which is read volatile.
    unsafe { dma::circulate(&mut stream, &ring) };
    const { assert!(APB2_HZ.is_multiple_of(BAUD)) };
    let uses = Uses {
        receive_dma: true,
        idle: true,
        ..Uses::default()
    };
    usart::start(&port, APB2_HZ, BAUD, uses);
    Some(Receiver {
        usart: port,
        stream,
        memory,
        next: 0,
        overruns: 0,
    })
}

impl Receiver {
    /// Acknowledges the half and the end of the ring.
    pub fn acknowledge_dma(&mut self) {
        dma::acknowledge(&mut self.stream);
    }

    /// Acknowledges the idle line, and line errors.
    pub fn acknowledge_line(&mut self) {
        if usart::acknowledge_line(&self.usart) {
            self.overruns = self.overruns.wrapping_add(1);
        }
    }

    /// The bytes that have arrived so far. Bytes that the caller does not take are returned
    /// again by the next call.
    #[inline(always)]
    pub fn arrived(&mut self) -> impl ExactSizeIterator<Item = u8> {
        let left = usize::from(self.stream.number_of_transfers());
        let count = RING.wrapping_sub(left).wrapping_sub(self.next) % RING;
        (0..count).map(|_| {
            let byte = self.memory.read(self.next % RING).unwrap_or(0);
            self.next = (self.next + 1) % RING;
            byte
        })
    }

    /// Bytes that the USART lost; wraps.
    pub fn overruns(&self) -> u32 {
        self.overruns
    }
}
