//! The satellite receiver's port: USART1, TX PA9, RX PA10, 1 Mbaud 8N1, received by DMA2
//! stream 2 into a ring.
//!
//! The stream interrupts at the half and at the end of the ring, so bytes wait for 1.28 ms at
//! most (thesis 6.2.4.3). TIM4 looks at the stream 5000 times a second: the line is idle when no
//! byte came for [`QUIET`] or longer. So the end of a burst is noticed by the second look after it.
//!
//! The USART's interrupt of an idle line is not used. Only a read of the data register clears it
//! (RM0390 25.6.1), and a read by the processor takes a byte away from the stream if one ends at
//! that moment. So the processor reads no register of the USART.

use crate::dma::{self, DmaChannel, DmaDataSize, Priority, Ring, Stream, Stream2};
use crate::pac;
use crate::registers::timer::{self, Effect};
use crate::registers::{clocks::APB2_HZ, usart, usart::Uses};
use parts::SLED_F446;
use sled_common::dma::{Shared, Window};

/// Bits per second.
pub const BAUD: u32 = 1_000_000;
/// Bytes in the ring: two halves of 1.28 ms.
pub const RING: usize = 256;
/// Looks at the line per second.
pub const LOOK_HZ: u32 = 5000;
/// Ticks of the time base without a byte after which the line is idle: 100 us, the time of ten
/// bytes. It is less than the time between two looks, but a late look may be close to the next one.
pub const QUIET: u32 = 100 * SLED_F446.external.ticks_per_us;

/// DMA request channel of USART1_RX on stream 2 (RM0390 table 29).
const CHANNEL: DmaChannel = DmaChannel::Channel4;

static MEMORY: Shared<u8, RING> = Shared::new(0);

/// The receiver's port.
pub struct Receiver {
    stream: Stream2<pac::DMA2>,
    memory: Window<u8, RING>,
    next: usize,
    timer: pac::TIM4,
    /// Items that the stream had left in the ring at the last look.
    left: u16,
    /// The last look that found new bytes, until the line becomes idle.
    busy_at: Option<u32>,
}

/// The clock gates of USART1, DMA2 and TIM4 are open.
pub(crate) fn start(
    port: &pac::USART1,
    mut stream: Stream2<pac::DMA2>,
    clock: pac::TIM4,
) -> Option<Receiver> {
    let memory = MEMORY.take()?;
    let ring = Ring {
        channel: CHANNEL,
        register: usart::data_register(port),
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
        ..Uses::default()
    };
    usart::start(port, APB2_HZ, BAUD, uses);
    // 90 MHz / 18 000 = 5 kHz.
    timer::start::<1, LOOK_HZ>(&clock, Effect::Interrupt);
    Some(Receiver {
        stream,
        memory,
        next: 0,
        timer: clock,
        left: RING as u16,
        busy_at: None,
    })
}

impl Receiver {
    /// Acknowledges the half and the end of the ring.
    pub fn acknowledge_dma(&mut self) {
        dma::acknowledge(&mut self.stream);
    }

    /// Looks at the line; call this from the task that is bound to TIM4. `now` is the time base.
    ///
    /// Once the line is idle, the result is the time of the last look that found new bytes: the
    /// last byte arrived within the 0.2 ms before it.
    #[inline(always)]
    pub fn look(&mut self, now: u32) -> Option<u32> {
        timer::acknowledge(&self.timer);
        let left = self.stream.number_of_transfers();
        if left != self.left {
            self.left = left;
            self.busy_at = Some(now);
        }
        self.busy_at
            .take_if(|busy_at| now.wrapping_sub(*busy_at) >= QUIET)
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
}
