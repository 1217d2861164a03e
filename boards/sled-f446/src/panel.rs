//! The operator's side of the controller: joystick, remote control, emergency stop.
//!
//! The joystick's two axes are scanned by ADC1 at 200 Hz, started by TIM3's trigger output
//! and stored by DMA2 stream 0 (thesis 6.2.4.2).

use crate::{clocks::APB1_TIMER_HZ, pac};
use sled_common::dma::{Shared, Window};
use stm32f4xx_hal::gpio::{Input, PC0, PC1, PC2, PC3, PC4, PC5};

/// Scans per second.
pub const SCAN_HZ: u32 = 200;

static MEMORY: Shared<u16, 2> = Shared::new(2048);

/// The joystick.
pub struct Joystick {
    memory: Window<u16, 2>,
}

/// The inputs of the remote control's receiver, the joystick's switch and the emergency
/// stop loop.
pub struct Buttons {
    pub(crate) a: PC0<Input>,
    pub(crate) b: PC1<Input>,
    pub(crate) c: PC2<Input>,
    pub(crate) d: PC3<Input>,
    pub(crate) joystick: PC4<Input>,
    pub(crate) stop_loop: PC5<Input>,
}

/// Levels of the inputs at one instant, true = pressed or, for the loop, open.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Levels {
    /// Remote control A.
    pub a: bool,
    /// Remote control B.
    pub b: bool,
    /// Remote control C.
    pub c: bool,
    /// Remote control D.
    pub d: bool,
    /// The joystick's switch.
    pub joystick: bool,
    /// The emergency stop loop is open.
    pub stop_loop: bool,
}

impl Levels {
    /// In the order of the fields.
    pub const fn as_array(self) -> [bool; 6] {
        [
            self.a,
            self.b,
            self.c,
            self.d,
            self.joystick,
            self.stop_loop,
        ]
    }
}

/// Starts the scan. The clocks of ADC1, TIM3 and DMA2 are on.
pub(crate) fn start(
    adc: pac::ADC1,
    common: &pac::ADC_COMMON,
    timer: pac::TIM3,
) -> Option<Joystick> {
    let memory = MEMORY.take()?;
    // SAFETY: stream 0, channel 0 belongs to ADC1; peripheral to memory, half-words, round
    // and round the two elements.
    unsafe {
        let stream = (*pac::DMA2::ptr()).st(0);
        stream.par().write(|w| w.bits(adc.dr().as_ptr() as u32));
        stream.m0ar().write(|w| w.bits(memory.address()));
        stream.ndtr().write(|w| w.ndt().bits(memory.len()));
        stream.cr().write(|w| {
            w.chsel().bits(0);
            w.dir().peripheral_to_memory();
            w.psize().bits16();
            w.msize().bits16();
            w.minc().set_bit();
            w.circ().set_bit();
            w.tcie().set_bit();
            w.en().set_bit()
        });
    }

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

    // 90 MHz / 90 = 1 MHz, / 5000 = 200 Hz.
    const PRESCALER: u32 = 90;
    const PERIOD: u32 = APB1_TIMER_HZ / PRESCALER / SCAN_HZ;
    const { assert!(PRESCALER * PERIOD * SCAN_HZ == APB1_TIMER_HZ && PERIOD <= 0x1_0000) };
    timer.psc().write(|w| w.psc().set((PRESCALER - 1) as u16));
    timer.arr().write(|w| w.arr().set((PERIOD - 1) as u16));
    timer.egr().write(|w| w.ug().set_bit());
    timer.cr2().write(|w| w.mms().update());
    timer.cr1().write(|w| w.cen().set_bit());
    Some(Joystick { memory })
}

impl Joystick {
    /// Acknowledges the end of a scan.
    pub fn acknowledge(&mut self) {
        // SAFETY: reads and clears the flags of stream 0 only (bits 0..=5 of LISR).
        unsafe {
            let dma = &*pac::DMA2::ptr();
            let flags = dma.lisr().read().bits() & 0b11_1101;
            dma.lifcr().write(|w| w.bits(flags));
        }
    }

    /// The latest samples of x and y, 12-bit counts.
    pub fn counts(&self) -> (u16, u16) {
        (
            self.memory.read(0).unwrap_or(2048),
            self.memory.read(1).unwrap_or(2048),
        )
    }
}

impl Buttons {
    /// Samples all inputs.
    pub fn levels(&self) -> Levels {
        Levels {
            a: self.a.is_high(),
            b: self.b.is_high(),
            c: self.c.is_high(),
            d: self.d.is_high(),
            joystick: self.joystick.is_low(),
            stop_loop: self.stop_loop.is_high(),
        }
    }
}
