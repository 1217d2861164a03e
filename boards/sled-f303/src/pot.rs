//! The steering potentiometer: PA0, ADC1 channel 1, 200 Hz by TIM3's trigger output,
//! stored by DMA1 channel 1 (thesis 6.2.4.2).

use crate::pac;
use crate::registers::{dma, scan, timer};
use sled_common::dma::{Shared, Window};
use stm32f3xx_hal::dma::{Channel, Event, dma1::C1};

/// Samples per second.
pub const SCAN_HZ: u32 = 200;

static MEMORY: Shared<u16, 1> = Shared::new(0);

/// The potentiometer.
pub struct Pot {
    channel: C1,
    memory: Window<u16, 1>,
}

/// Starts the scan. The clock gates of ADC1 and TIM3 are open; `core` and `timer_clock` are
/// in hertz. `None` when the converter does not get ready.
pub(crate) fn start(
    adc: &pac::ADC1,
    common: &pac::ADC1_2,
    clock: &pac::TIM3,
    mut channel: C1,
    core: u32,
    timer_clock: u32,
) -> Option<Pot> {
    let memory = MEMORY.take()?;
    scan::enable(adc, common, core)?;
    // SAFETY: the channel is this module's.
    let registers = unsafe { &(*pac::DMA1::ptr()).ch1 };
    dma::set_register(registers, scan::data_register(adc));
    dma::set_memory(registers, memory.address(), memory.len());
    dma::set_ring_of_half_words(registers);
    channel.enable_interrupt(Event::TransferComplete);
    channel.enable();
    scan::start(adc);
    timer::start::<SCAN_HZ>(clock, timer_clock);
    Some(Pot { channel, memory })
}

impl Pot {
    /// Acknowledges the end of a conversion.
    pub fn acknowledge(&mut self) {
        self.channel.clear_event(Event::Any);
    }

    /// The latest sample, a 12-bit count.
    pub fn count(&self) -> u16 {
        self.memory.read(0).unwrap_or(0)
    }
}
