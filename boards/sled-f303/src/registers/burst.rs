//! ADC1 converts channels 2 and 4 in turn, without a pause, until it is stopped (RM0316 15.3.14 and
//! 15.3.26). Each result is a DMA request until the DMA channel's memory is full.

use crate::pac;

/// How often the converter is polled while it stops, which takes it some cycles of its clock. A poll
/// takes the core ten cycles or more, and the converter's clock has half its rate.
const POLLS: u32 = 20;

/// Sample time of both channels: code 5 = 61.5 cycles (RM0316 15.5.5), 1.7 us at 36 MHz. That is
/// enough for a source of 8.2 kohm at twice this clock (DS9866, table of the largest source
/// impedance); the divider and the filter have 3.2 kohm, and a capacitor beside the pin.
const SAMPLE_TIME: u32 = 5 << (3 * 2) | 5 << (3 * 4);

/// A sequence of two conversions, channels 2 and 4 (RM0316 15.5.12).
const SEQUENCE: u32 = 1 | 2 << 6 | 4 << 12;

/// Continuous conversion; DMA requests end when the memory of the DMA channel is full (RM0316
/// 15.5.4); a result that nobody has fetched is kept.
const CONTINUOUS: u32 = 1 << 13;
/// Results are DMA requests.
const REQUESTS: u32 = 1;
/// Begin at the rising edge of trigger 4, TIM3_TRGO (RM0316 table 89).
const BY_TIMER: u32 = 0b01 << 10 | 4 << 6;

/// The flag of an overrun, and all flags of a conversion (RM0316 15.5.1).
const OVERRUN: u32 = 1 << 4;
const FLAGS: u32 = 0b1_1110;

/// Selects channels and sample time. The converter is on and stopped.
pub(crate) fn select(adc: &pac::ADC1) {
    // SAFETY: values of the two registers, as above.
    unsafe {
        adc.smpr1.write(|w| w.bits(SAMPLE_TIME));
        adc.sqr1.write(|w| w.bits(SEQUENCE));
    }
}

/// Makes the stopped converter ready for a burst, which a timer or [`begin`] begins. The DMA
/// channel is ready. Its requests begin anew only when they were switched off before.
#[inline(always)]
pub(crate) fn prepare(adc: &pac::ADC1, by_timer: bool) {
    let trigger = if by_timer { BY_TIMER } else { 0 };
    // SAFETY: clears flags by writing ones; then settings as above.
    unsafe {
        adc.isr.write(|w| w.bits(FLAGS));
        adc.cfgr.write(|w| w.bits(CONTINUOUS | trigger));
        adc.cfgr.write(|w| w.bits(CONTINUOUS | trigger | REQUESTS));
    }
}

/// Begins a burst, or lets the converter wait for its timer.
#[inline(always)]
pub(crate) fn begin(adc: &pac::ADC1) {
    // The other bits of the register act when they are written as one.
    adc.cr.write(|w| w.advregen().enabled().adstart().set_bit());
}

/// Stops the converter, also in the middle of a conversion. False if it does not stop.
#[inline(always)]
pub(crate) fn stop(adc: &pac::ADC1) -> bool {
    if adc.cr.read().adstart().bit_is_clear() {
        return true;
    }
    adc.cr.write(|w| w.advregen().enabled().adstp().set_bit());
    (0..POLLS).any(|_| adc.cr.read().adstart().bit_is_clear())
}

/// Whether a result was lost since the converter was prepared.
pub(crate) fn has_overrun(adc: &pac::ADC1) -> bool {
    adc.isr.read().bits() & OVERRUN != 0
}
