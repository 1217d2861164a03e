//! ADC1 scans channels 0 and 1 at each trigger of TIM3 (RM0390 chapter 13).

use crate::pac;

/// Starts the scan; each result is a DMA request. The clock gate is open.
pub(crate) fn start(adc: &pac::ADC1, common: &pac::ADC_COMMON) {
    // 90 MHz / 4 = 22.5 MHz, below the 36 MHz that the data sheet allows.
    common.ccr().modify(|_, w| w.adcpre().div4());
    adc.cr1().write(|w| w.scan().set_bit());
    // SAFETY: sample times of channels 0 and 1: code 4 = 84 cycles (RM0390 13.13.5); a
    // sequence of two conversions, channel 0 then 1; trigger 8 = TIM3_TRGO (table 69).
    unsafe {
        adc.smpr2().write(|w| w.bits(4 << 3 | 4));
        adc.sqr1().write(|w| w.bits(1 << 20));
        adc.sqr3().write(|w| w.bits(1 << 5));
        adc.cr2().write(|w| {
            w.extsel().bits(8);
            w.exten().rising_edge();
            w.dma().set_bit();
            w.dds().set_bit();
            w.adon().set_bit()
        });
    }
}
