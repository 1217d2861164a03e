//! The steering potentiometer: PA0, ADC1 channel 1, 200 Hz by TIM3's trigger output,
//! stored by DMA1 channel 1 (thesis 6.2.4.2).

use crate::pac;
use sled_common::dma::{Shared, Window};

/// Samples per second.
pub const SCAN_HZ: u32 = 200;

static MEMORY: Shared<u16, 1> = Shared::new(0);

/// The potentiometer.
pub struct Pot {
    memory: Window<u16, 1>,
}

/// Polls that the converter is given to calibrate and to get ready; it needs less than
/// 10 us for each.
const POLLS: u32 = 10_000;

/// Starts the scan. The clocks of ADC1, TIM3 and DMA1 are on; `core` and `timer_clock` are
/// in hertz. `None` when the converter does not get ready.
pub(crate) fn start(
    adc: pac::ADC1,
    common: &pac::ADC1_2,
    timer: pac::TIM3,
    core: u32,
    timer_clock: u32,
) -> Option<Pot> {
    let memory = MEMORY.take()?;
    // The converter runs on the AHB clock / 2: 36 MHz, below the 72 MHz allowed.
    common.ccr.modify(|_, w| w.ckmode().sync_div2());

    // The regulator wants to pass through its intermediate state, then 10 us
    // (RM0316 15.3.6).
    adc.cr.modify(|_, w| w.advregen().intermediate());
    adc.cr.modify(|_, w| w.advregen().enabled());
    cortex_m::asm::delay(core / 100_000);
    adc.cr.modify(|_, w| w.adcaldif().single_ended());
    adc.cr.modify(|_, w| w.adcal().calibration());
    (0..POLLS)
        .any(|_| adc.cr.read().adcal().is_complete())
        .then_some(())?;
    // ADEN may not be set within four converter cycles of the end of the calibration.
    cortex_m::asm::delay(16);
    adc.cr.modify(|_, w| w.aden().set_bit());
    (0..POLLS)
        .any(|_| adc.isr.read().adrdy().bit_is_set())
        .then_some(())?;

    // SAFETY: channel 1 of DMA1 belongs to ADC1; peripheral to memory, half-words, round
    // and round the one element.
    unsafe {
        let channel = &(*pac::DMA1::ptr()).ch1;
        channel.par.write(|w| w.bits(adc.dr.as_ptr() as u32));
        channel.mar.write(|w| w.bits(memory.address()));
        channel.ndtr.write(|w| w.ndt().bits(memory.len()));
        channel.cr.write(|w| {
            w.circ().set_bit();
            w.psize().bits16();
            w.msize().bits16();
            w.tcie().set_bit();
            w.en().set_bit()
        });
    }
    // SAFETY: sample time of channel 1: code 5 = 61.5 cycles (RM0316 15.5.5); a sequence
    // of one conversion, channel 1; trigger 4 = TIM3_TRGO (table 89), rising edge; DMA in
    // circular mode.
    unsafe {
        adc.smpr1.write(|w| w.bits(5 << 3));
        adc.sqr1.write(|w| w.bits(1 << 6));
        adc.cfgr.write(|w| w.bits(0b01 << 10 | 4 << 6 | 1 << 1 | 1));
    }
    adc.cr.modify(|_, w| w.adstart().set_bit());

    // 72 or 64 MHz to 1 MHz, / 5000 = 200 Hz.
    const PERIOD: u32 = 1_000_000 / SCAN_HZ;
    let prescaler = timer_clock / 1_000_000;
    timer
        .psc
        .write(|w| w.psc().bits(prescaler.wrapping_sub(1) as u16));
    timer.arr.write(|w| w.arr().bits((PERIOD - 1) as u16));
    timer.egr.write(|w| w.ug().set_bit());
    timer.cr2.write(|w| w.mms().update());
    timer.cr1.write(|w| w.cen().set_bit());
    Some(Pot { memory })
}

impl Pot {
    /// Acknowledges the end of a conversion.
    pub fn acknowledge(&mut self) {
        // SAFETY: reads and clears the flags of channel 1 only (bits 0..=3).
        unsafe {
            let dma = &*pac::DMA1::ptr();
            let flags = dma.isr.read().bits() & 0b1111;
            dma.ifcr.write(|w| w.bits(flags));
        }
    }

    /// The latest sample, a 12-bit count.
    pub fn count(&self) -> u16 {
        self.memory.read(0).unwrap_or(0)
    }
}
