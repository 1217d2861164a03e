//! The display's port: USART3, TX PC10, RX PC11, 19 200 baud 8N1, sent by DMA1 stream 3,
//! and the 5 Hz tick (TIM4) that it is refreshed with.
//!
//! The display answers a command that asks for it; the bytes arrive by interrupt, one at a
//! time. Its lines have TTL level, which `boards/sleds/README.md` tells how to set; RS-232 levels
//! destroy the pins.

use crate::dma::{self, DmaChannel, Stream3};
use crate::pac;
use crate::registers::timer::{self, Effect};
use crate::registers::{clocks::APB1_HZ, usart, usart::Uses};
use sled_common::dma::{Shared, Window};

/// Bits per second.
pub const BAUD: u32 = 19_200;
/// Longest string of commands: 160 bytes take 83 ms, of the 200 ms between two refreshes.
pub const CAPACITY: usize = 160;
/// Refreshes per second.
pub const REFRESH_HZ: u32 = 5;

static MEMORY: Shared<u8, CAPACITY> = Shared::new(0);

/// The sending side of the display's port.
pub struct Lcd {
    stream: Stream3<pac::DMA1>,
    memory: Window<u8, CAPACITY>,
    busy: bool,
}

/// The receiving side of the display's port.
pub struct Replies {
    usart: pac::USART3,
}

/// The 5 Hz tick.
pub struct Tick {
    timer: pac::TIM4,
}

/// DMA request channel of USART3_TX on stream 3 (RM0390 table 28).
const CHANNEL: DmaChannel = DmaChannel::Channel4;

/// The clock gates of USART3 and TIM4 are open.
pub(crate) fn start(
    port: pac::USART3,
    clock: pac::TIM4,
    mut stream: Stream3<pac::DMA1>,
) -> Option<(Lcd, Replies, Tick)> {
    let memory = MEMORY.take()?;
    let uses = Uses {
        transmit_dma: true,
        received: true,
        ..Uses::default()
    };
    usart::start(&port, APB1_HZ, BAUD, uses);
    dma::feed(&mut stream, CHANNEL, usart::data_register(&port));
    // 90 MHz / 9000 = 10 kHz, / 2000 = 5 Hz.
    timer::start::<9000, REFRESH_HZ>(&clock, Effect::Interrupt);
    let lcd = Lcd {
        stream,
        memory,
        busy: false,
    };
    Some((lcd, Replies { usart: port }, Tick { timer: clock }))
}

impl Lcd {
    /// Whether a string is still being sent.
    pub fn is_busy(&self) -> bool {
        self.busy
    }

    /// Sends one string of commands, cut at [`CAPACITY`]. Returns false while the last string
    /// is still being sent.
    pub fn send(&mut self, text: &[u8]) -> bool {
        if self.busy || text.is_empty() {
            return false;
        }
        let mut length = 0;
        for &byte in text.iter().take(CAPACITY) {
            self.memory.write(length, byte);
            length += 1;
        }
        self.busy = true;
        let address = self.memory.address();
        // SAFETY: the memory is left alone while `busy`.
        unsafe { dma::send(&mut self.stream, address, length as u16) };
        true
    }

    /// To be called by the task that is bound to the end of the DMA transfer.
    pub fn on_transfer_complete(&mut self) {
        if dma::finished(&mut self.stream) {
            self.busy = false;
        }
    }
}

impl Replies {
    /// Takes the byte that the display sent. Call this from the task that is bound to USART3.
    pub fn received(&mut self) -> Option<u8> {
        usart::received(&self.usart)
    }
}

impl Tick {
    /// Acknowledges the tick.
    pub fn acknowledge(&mut self) {
        timer::acknowledge(&self.timer);
    }
}
