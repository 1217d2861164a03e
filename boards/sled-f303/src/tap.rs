//! The TX line of one node, and the gate between it and the bus (a guardian's sled).
//!
//! | pin | function | peripheral | connected to |
//! | --- | --- | --- | --- |
//! | PB4 | AF2, low = dominant | TIM3_CH1 | TX of the node's CAN controller, in front of the gate: the sled's input `stop` |
//! | PA7 | push-pull, high = closed | GPIO | one input of the OR gate of that node: the sled's output `left` of the servos |
//!
//! The gate's input has a pull-down resistor. So a guardian without supply, in reset or without a program leaves the bus as
//! it would be without a guardian. A wire that is broken at PB4 reads as dominant, because the sled holds it low: the gate
//! closes.
//!
//! TIM7 asks for a look every 18 us, 4.5 bits at 250 kbit/s. Between looks TIM3 follows the line: the first dominant bit after a
//! rest starts its counter, and its channels capture the last edge of each kind.

use crate::pac;
use sled_common::tap::Seen;
use stm32f3xx_hal::gpio::{AF2, Output, PA7, PB4, PushPull};
use stm32f3xx_hal::prelude::*;

/// Microseconds from one look to the next.
pub const LOOK_US: u16 = 18;

/// TIM3 counts at the rate of the time base. TIM7 counts microseconds with both oscillators. Their clock is twice that of APB1
/// (RM0316 9.2.9).
const PRESCALER: u16 = (parts::SLED_F303.external.time_base_prescaler() - 1) as u16;
const MICROSECONDS: u32 = 1_000_000;

/// The TX line of one node and its gate.
pub struct Tap {
    _line: PB4<AF2<PushPull>>,
    gate: PA7<Output<PushPull>>,
    edges: pac::TIM3,
    looks: pac::TIM7,
}

/// Starts the timers, which run at `clock` hertz. Their clock gates are open. The line is at rest, and the gate is open.
pub(crate) fn start(
    line: PB4<AF2<PushPull>>,
    gate: PA7<Output<PushPull>>,
    edges: pac::TIM3,
    looks: pac::TIM7,
    clock: u32,
) -> Tap {
    edges.psc.write(|w| w.psc().bits(PRESCALER));
    edges.arr.write(|w| w.arr().bits(u16::MAX));
    // Both channels capture the pin: the first one (01) falling edges, the second one (10) rising ones. A falling edge (TI1FP1)
    // starts the counter (trigger mode), RM0316 21.4.
    // SAFETY: no filter and no prescaler, as after a reset.
    edges
        .ccmr1_input()
        .write(|w| unsafe { w.bits(0b10 << 8 | 0b01) });
    edges
        .ccer
        .write(|w| w.cc1e().set_bit().cc1p().set_bit().cc2e().set_bit());
    edges.smcr.write(|w| w.ts().ti1fp1().sms().trigger_mode());
    // The update event loads the prescaler.
    edges.egr.write(|w| w.ug().set_bit());
    let prescaler = clock / MICROSECONDS;
    looks
        .psc
        .write(|w| w.psc().bits(prescaler.wrapping_sub(1) as u16));
    looks.arr.write(|w| w.arr().bits(LOOK_US - 1));
    looks.egr.write(|w| w.ug().set_bit());
    let mut tap = Tap {
        _line: line,
        gate,
        edges,
        looks,
    };
    tap.open(true);
    tap.rest();
    tap.acknowledge();
    tap.looks.dier.write(|w| w.uie().set_bit());
    tap.looks.cr1.write(|w| w.cen().set_bit());
    tap
}

impl Tap {
    #[inline]
    fn acknowledge(&mut self) {
        // SAFETY: a zero clears the flag (RM0316 22.4.4).
        self.looks.sr.write(|w| unsafe { w.bits(0) });
    }

    /// Whether the line is dominant now.
    #[inline]
    fn is_dominant(&self) -> bool {
        // SAFETY: a read of the port's input register changes nothing, and the pin is this type's.
        unsafe { (*pac::GPIOB::ptr()).idr.read().bits() & 1 << 4 == 0 }
    }

    /// Acknowledges the timer, and looks at the line. `None` while it is at rest.
    #[inline]
    pub fn look(&mut self) -> Option<Seen> {
        self.acknowledge();
        if self.edges.cr1.read().cen().bit_is_clear() {
            return None;
        }
        let flags = self.edges.sr.read();
        // The read of a capture clears its flag, so no edge is lost.
        let fell = flags.cc1if().bit_is_set();
        if fell {
            let _ = self.edges.ccr1().read();
        }
        let released = flags.cc2if().bit_is_set();
        let released = released.then(|| self.edges.ccr2().read().bits() as u16);
        let dominant = self.is_dominant();
        let now = self.edges.cnt.read().bits() as u16;
        Some(Seen {
            age: u32::from(now),
            dominant,
            fell,
            released: released.map(|at| u32::from(now.wrapping_sub(at))),
        })
    }

    /// The line is at rest: its next dominant bit starts the counter anew.
    #[inline]
    pub fn rest(&mut self) {
        self.edges.cr1.write(|w| w.cen().clear_bit());
        // SAFETY: the counter and the flags, which zeros clear (RM0316 21.4.5).
        unsafe {
            self.edges.cnt.write(|w| w.bits(0));
            self.edges.sr.write(|w| w.bits(0));
        }
        if self.is_dominant() {
            // Its edge may have come before the counter was ready.
            self.edges.cr1.write(|w| w.cen().set_bit());
        }
    }

    /// Opens the gate, or closes it.
    #[inline]
    pub fn open(&mut self, open: bool) {
        // A write of the port's set and reset register: the error type is empty.
        let _ = if open {
            self.gate.set_low()
        } else {
            self.gate.set_high()
        };
    }
}
