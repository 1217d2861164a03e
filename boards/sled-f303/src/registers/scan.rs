//! ADC1 converts channel 1 at each trigger of TIM3 (RM0316 chapter 15).

use crate::pac;

/// How often the converter is polled while it calibrates or gets ready; it needs less than 10
/// us for each.
const POLLS: u32 = 10_000;

/// Calibrates and enables the converter; `core` is the core clock in hertz. Its clock gate is
/// open. `None` if the converter does not get ready.
pub(crate) fn enable(adc: &pac::ADC1, common: &pac::ADC1_2, core: u32) -> Option<()> {
    // The converter runs on the AHB clock / 2: 36 MHz, below the 72 MHz allowed.
    common.ccr.modify(|_, w| w.ckmode().sync_div2());
    // The regulator must pass through its intermediate state, and then needs 10 us to settle
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
    // The flag of an earlier start stays until it is written.
    adc.isr.write(|w| w.adrdy().set_bit());
    adc.cr.modify(|_, w| w.aden().set_bit());
    (0..POLLS)
        .any(|_| adc.isr.read().adrdy().bit_is_set())
        .then_some(())
}

/// Lets the converter wait for the triggers; each result is a DMA request.
pub(crate) fn start(adc: &pac::ADC1) {
    // SAFETY: sample time of channel 1: code 5 = 61.5 cycles (RM0316 15.5.5); a sequence
    // of one conversion, channel 1; trigger 4 = TIM3_TRGO (table 89), rising edge; DMA in
    // circular mode.
    unsafe {
        adc.smpr1.write(|w| w.bits(5 << 3));
        adc.sqr1.write(|w| w.bits(1 << 6));
        adc.cfgr.write(|w| w.bits(0b01 << 10 | 4 << 6 | 1 << 1 | 1));
    }
    adc.cr.modify(|_, w| w.adstart().set_bit());
}

/// Address of the data register, for a DMA channel.
pub(crate) fn data_register(adc: &pac::ADC1) -> u32 {
    adc.dr.as_ptr() as u32
}
