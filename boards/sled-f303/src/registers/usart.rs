//! Serial ports, 8N1, oversampling by 16 (RM0316 29.8).

use crate::pac;

pub(crate) use crate::pac::usart1::RegisterBlock;

/// Divider of RM0316 29.5.4, rounded to the nearest.
const fn divider(clock: u32, baud: u32) -> u32 {
    (clock + baud / 2) / baud
}

/// Starts a port that only sends; a DMA channel feeds it if `dma` is true. `clock` is the rate
/// of the port in hertz. Its clock gate is open.
#[inline(always)]
pub(crate) fn start(usart: &RegisterBlock, clock: u32, baud: u32, dma: bool) {
    // SAFETY: at most 16 bits for the rates used here.
    usart.brr.write(|w| unsafe { w.bits(divider(clock, baud)) });
    if dma {
        usart.cr3.write(|w| w.dmat().set_bit());
    }
    usart
        .cr1
        .write(|w| w.ue().set_bit().te().set_bit().re().bit(dma));
}

/// Address of the register that a DMA channel writes.
#[inline(always)]
pub(crate) fn transmit_register(usart: &RegisterBlock) -> u32 {
    usart.tdr.as_ptr() as u32
}

/// Sends a byte. Returns false, and drops the byte, while the last one is still waiting.
#[inline(always)]
pub(crate) fn send(usart: &RegisterBlock, byte: u8) -> bool {
    let free = usart.isr.read().txe().bit_is_set();
    if free {
        usart.tdr.write(|w| w.tdr().bits(u16::from(byte)));
    }
    free
}

/// How often the end of a byte is polled, about 6 cycles each: longer than the 260 us of a
/// byte.
const POLLS: u32 = 10_000;

/// Opens the relay on PA8, sends `byte` over USART1 at `baud` bit/s and waits until it has left the
/// pin. Uses no state.
///
/// For the end of the program. Bytes that are still being sent are waited for, each for a
/// bounded time. If the clock security system has put the core on its RC oscillator, the divider
/// is that of another clock: the byte on the line is lost and ends at once, and the port is set to
/// the clock that it has now.
pub(crate) fn end(byte: u8, baud: u32) {
    // SAFETY: nothing else runs any more; resets the output of PA8 (RM0316 11.4.7), which
    // changes nothing when the port has no clock.
    unsafe { (*pac::GPIOA::ptr()).bsrr.write(|w| w.bits(1 << (16 + 8))) };
    // SAFETY: nothing else runs any more; a port that was never started takes no byte.
    let usart = unsafe { &*pac::USART1::ptr() };
    if usart.cr1.read().ue().bit_is_clear() {
        return;
    }
    // SAFETY: reads which clock drives the core.
    let on_its_own = unsafe { (*pac::RCC::ptr()).cfgr.read().sws().is_hsi() };
    if on_its_own {
        usart.cr1.modify(|_, w| w.ue().clear_bit());
        // Enabling the transmitter sends an idle character first, so the driver is in step again
        // before the byte begins (RM0316 29.5.2).
        start(usart, parts::SLED_F303.part.hsi.hz, baud, false);
    }
    let _ = (0..POLLS).any(|_| usart.isr.read().txe().bit_is_set());
    usart.tdr.write(|w| w.tdr().bits(u16::from(byte)));
    let _ = (0..2 * POLLS).any(|_| usart.isr.read().tc().bit_is_set());
}
