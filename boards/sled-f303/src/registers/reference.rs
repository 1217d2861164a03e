//! The internal reference voltage by ADC1, channel 18 (RM0316 15.3.32), once at the start.

use super::scan;
use crate::pac;
use parts::SLED_F303;
use sled_common::selftest::Reference;

/// How often the end of the conversion is polled; it takes 17 us.
const POLLS: u32 = 1_000;

/// Converts the reference, and switches the converter off again. `None` if it does not get ready.
/// The converter's clock gate is open; `core` is in hertz.
pub(crate) fn read(adc: &pac::ADC1, common: &pac::ADC1_2, core: u32) -> Option<Reference> {
    common.ccr.modify(|_, w| w.vrefen().set_bit());
    let count = convert(adc, common, core);
    common.ccr.modify(|_, w| w.vrefen().clear_bit());
    // SAFETY: the part's system page, which is read only.
    let factory = unsafe { (SLED_F303.part.system_page.reference as *const u16).read_volatile() };
    Some(Reference {
        count: count?,
        factory,
    })
}

fn convert(adc: &pac::ADC1, common: &pac::ADC1_2, core: u32) -> Option<u16> {
    scan::enable(adc, common, core)?;
    // SAFETY: sample time of channel 18: code 7 = 601.5 cycles of 36 MHz, 16.7 us; the reference
    // needs 2.2 us (data sheet, table of the embedded reference). A sequence of one conversion.
    unsafe {
        adc.smpr2.write(|w| w.bits(7 << 24));
        adc.sqr1.write(|w| w.bits(18 << 6));
    }
    adc.cr.modify(|_, w| w.adstart().set_bit());
    let count = (0..POLLS)
        .any(|_| adc.isr.read().eoc().bit_is_set())
        .then(|| adc.dr.read().bits() as u16);
    // Calibration, with which the scan begins, needs the converter off.
    adc.cr.modify(|_, w| w.addis().set_bit());
    let off = (0..POLLS).any(|_| adc.cr.read().aden().bit_is_clear());
    count.filter(|_| off)
}
