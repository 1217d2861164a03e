//! The satellite receiver's port: USART1, TX PA9, RX PA10, 1 Mbaud 8N1, received by DMA2
//! stream 2 into a ring.
//!
//! The stream interrupts at the half and at the end of the ring, the USART when the line
//! falls idle: bytes wait for 1.28 ms at most, the end of a burst not at all (thesis 6.2.4.3).

use crate::{clocks::APB2_HZ, pac};
use sled_common::dma::{Shared, Window};

/// Bits per second.
pub const BAUD: u32 = 1_000_000;
/// Bytes in the ring: two halves of 1.28 ms.
pub const RING: usize = 256;

/// DMA request channel of USART1_RX on stream 2 (RM0390 table 29).
const CHANNEL: u8 = 4;

static MEMORY: Shared<u8, RING> = Shared::new(0);

/// The receiver's port.
pub struct Receiver {
    usart: pac::USART1,
    memory: Window<u8, RING>,
    next: usize,
    overruns: u32,
}

pub(crate) fn start(usart: pac::USART1) -> Option<Receiver> {
    let memory = MEMORY.take()?;
    // SAFETY: stream 2 is this type's; peripheral to memory, one byte at a time, round and
    // round the ring.
    unsafe {
        let stream = (*pac::DMA2::ptr()).st(2);
        stream.par().write(|w| w.bits(usart.dr().as_ptr() as u32));
        stream.m0ar().write(|w| w.bits(memory.address()));
        stream.ndtr().write(|w| w.ndt().bits(memory.len()));
        stream.cr().write(|w| {
            w.chsel().bits(CHANNEL);
            w.dir().peripheral_to_memory();
            w.pl().very_high();
            w.minc().set_bit();
            w.circ().set_bit();
            w.htie().set_bit();
            w.tcie().set_bit();
            w.en().set_bit()
        });
    }
    const { assert!(APB2_HZ.is_multiple_of(BAUD)) };
    // SAFETY: divider of RM0390 25.4.4 for oversampling by 16.
    usart
        .brr()
        .write(|w| unsafe { w.bits((APB2_HZ / BAUD) as u16) });
    usart.cr3().write(|w| w.dmar().set_bit().eie().set_bit());
    usart.cr1().write(|w| {
        w.ue().set_bit();
        w.te().set_bit();
        w.re().set_bit();
        w.idleie().set_bit()
    });
    Some(Receiver {
        usart,
        memory,
        next: 0,
        overruns: 0,
    })
}

impl Receiver {
    /// Acknowledges the half and the end of the ring.
    pub fn acknowledge_dma(&mut self) {
        // SAFETY: reads and clears the flags of stream 2 only (bits 16..=21 of LISR).
        unsafe {
            let dma = &*pac::DMA2::ptr();
            let flags = dma.lisr().read().bits() & (0b11_1101 << 16);
            dma.lifcr().write(|w| w.bits(flags));
        }
    }

    /// Acknowledges the idle line, and line errors.
    pub fn acknowledge_line(&mut self) {
        // Status, then data clears the flags (RM0390 25.6.1). After an idle line no byte
        // waits that the DMA stream could miss.
        let status = self.usart.sr().read();
        if status.ore().bit_is_set() {
            self.overruns = self.overruns.wrapping_add(1);
        }
        let _ = self.usart.dr().read();
    }

    /// The bytes that have arrived until now; those that are not taken are there again the
    /// next time.
    #[inline(always)]
    pub fn arrived(&mut self) -> impl ExactSizeIterator<Item = u8> {
        // SAFETY: reads the counter of stream 2.
        let left = unsafe { (*pac::DMA2::ptr()).st(2).ndtr().read().bits() } as usize;
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
