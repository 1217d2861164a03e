//! The internal reference voltage by ADC1, channel 17 (RM0390 13.10), once at the start.

use crate::pac;
use parts::SLED_F446;
use sled_common::selftest::Reference;

/// How often the end of the conversion is polled; it takes 22 us.
const POLLS: u32 = 1_000;

/// Converts the reference, and switches the converter off again. `None` if the conversion does not
/// end. The converter's clock gate is open; `core` is in hertz.
pub(crate) fn read(adc: &pac::ADC1, common: &pac::ADC_COMMON, core: u32) -> Option<Reference> {
    // 90 MHz / 4 = 22.5 MHz, below the 36 MHz that the data sheet allows.
    common.ccr().modify(|_, w| {
        w.adcpre().div4();
        w.tsvrefe().set_bit()
    });
    // SAFETY: sample time of channel 17: code 7 = 480 cycles, 21 us; the reference needs 10 us
    // (data sheet, table of the embedded reference). A sequence of one conversion.
    unsafe {
        adc.smpr1().write(|w| w.bits(7 << 21));
        adc.sqr1().write(|w| w.bits(0));
        adc.sqr3().write(|w| w.bits(17));
    }
    adc.cr2().write(|w| w.adon().set_bit());
    // The converter is stable after 3 us, the reference after 10 us (data sheet).
    cortex_m::asm::delay(core / 50_000);
    adc.cr2().modify(|_, w| w.swstart().set_bit());
    let count = (0..POLLS)
        .any(|_| adc.sr().read().eoc().bit_is_set())
        .then(|| adc.dr().read().bits() as u16);
    adc.cr2().reset();
    adc.sr().reset();
    common.ccr().modify(|_, w| w.tsvrefe().clear_bit());
    // SAFETY: the part's system page, which is read only.
    let factory = unsafe { (SLED_F446.part.system_page.reference as *const u16).read_volatile() };
    Some(Reference {
        count: count?,
        factory,
    })
}
