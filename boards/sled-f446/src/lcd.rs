//! The display's port: USART3, TX PC10, RX PC11, 115 200 baud 8N1, sent by DMA1 stream 3,
//! and the 5 Hz tick (TIM4) that it is refreshed with.
//!
//! The display answers 0x55 to every command that it accepted (thesis 6.2.4.5); the bytes
//! arrive by interrupt, one at a time.

use crate::{
    clocks::{APB1_HZ, APB1_TIMER_HZ},
    pac,
    stream::Stream,
};
use sled_common::dma::{Shared, Window};

/// Bits per second.
pub const BAUD: u32 = 115_200;
/// Longest string of commands: 78 ms at 115 200 baud are 898 bytes (thesis 6.2.4.5).
pub const CAPACITY: usize = 898;
/// Refreshes per second.
pub const REFRESH_HZ: u32 = 5;

static MEMORY: Shared<u8, CAPACITY> = Shared::new(0);

/// The way to the display.
pub struct Lcd {
    /// Address of the port's data register.
    register: u32,
    stream: Stream<3>,
    memory: Window<u8, CAPACITY>,
    busy: bool,
}

/// The way back from the display.
pub struct Replies {
    usart: pac::USART3,
}

/// The 5 Hz tick.
pub struct Tick {
    timer: pac::TIM4,
}

pub(crate) fn start(usart: pac::USART3, timer: pac::TIM4) -> Option<(Lcd, Replies, Tick)> {
    let memory = MEMORY.take()?;
    // SAFETY: divider of RM0390 25.4.4 for oversampling by 16, rounded to the nearest.
    usart
        .brr()
        .write(|w| unsafe { w.bits(((APB1_HZ + BAUD / 2) / BAUD) as u16) });
    usart.cr3().write(|w| w.dmat().set_bit());
    usart.cr1().write(|w| {
        w.ue().set_bit();
        w.te().set_bit();
        w.re().set_bit();
        w.rxneie().set_bit()
    });

    // 90 MHz / 9000 = 10 kHz, / 2000 = 5 Hz.
    const PRESCALER: u32 = 9000;
    const PERIOD: u32 = APB1_TIMER_HZ / PRESCALER / REFRESH_HZ;
    const { assert!(PRESCALER * PERIOD * REFRESH_HZ == APB1_TIMER_HZ && PERIOD <= 0x1_0000) };
    timer.psc().write(|w| w.psc().set((PRESCALER - 1) as u16));
    timer.arr().write(|w| w.arr().set((PERIOD - 1) as u16));
    timer.egr().write(|w| w.ug().set_bit());
    timer.sr().modify(|_, w| w.uif().clear_bit());
    timer.dier().write(|w| w.uie().set_bit());
    timer.cr1().write(|w| w.cen().set_bit());
    Some((
        Lcd {
            register: usart.dr().as_ptr() as u32,
            stream: Stream::new(),
            memory,
            busy: false,
        },
        Replies { usart },
        Tick { timer },
    ))
}

impl Lcd {
    /// Whether a string is still being sent.
    pub fn is_busy(&self) -> bool {
        self.busy
    }

    /// Sends one string of commands, cut at [`CAPACITY`]; false when the last one is still
    /// under way.
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
        // SAFETY: the memory is left alone while `busy`; USART3's requests come to stream 3.
        unsafe { self.stream.start(address, length as u16, self.register) };
        true
    }

    /// To be called by the task that is bound to the end of the DMA transfer.
    pub fn on_transfer_complete(&mut self) {
        if self.stream.finished() {
            self.busy = false;
        }
    }
}

impl Replies {
    /// The byte that the display sent, to be called by the task that is bound to USART3.
    pub fn received(&mut self) -> Option<u8> {
        let status = self.usart.sr().read();
        if status.rxne().bit_is_set() || status.ore().bit_is_set() {
            Some(self.usart.dr().read().bits() as u8)
        } else {
            None
        }
    }
}

impl Tick {
    /// Acknowledges the tick.
    pub fn acknowledge(&mut self) {
        self.timer.sr().modify(|_, w| w.uif().clear_bit());
    }
}
