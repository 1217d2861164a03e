//! The TX lines of four nodes, and the gates between them and the bus (a guardian's sled).
//!
//! | pin | function | peripheral | connected to |
//! | --- | --- | --- | --- |
//! | PC0..PC3 | input, pull-up, low = dominant | GPIO, EXTI lines 0 to 3 | TX of the node's CAN controller, in front of the gate |
//! | PC6..PC9 | push-pull, high = closed | GPIO | one input of the OR gate of that node; the other one is its TX, the output goes to D of its transceiver |
//!
//! Each gate's input has a pull-down resistor of 10 kohm. So a guardian without supply, in reset or without
//! a program leaves the bus as it would be without a guardian.
//!
//! TIM3 asks for a look every 8.9 us, 2.2 bits at 250 kbit/s. EXTI latches whether a line became dominant
//! between two looks. Its lines 0 to 3 are enabled there, so no task may be bound to EXTI0 to EXTI3: each edge would
//! release it.

use crate::pac;
use crate::registers::timer::{self, Effect};
use stm32f4xx_hal::gpio::{Input, Output, PC0, PC1, PC2, PC3, PC6, PC7, PC8, PC9};

/// Looks per second.
pub const LOOK_HZ: u32 = 112_500;
/// Lines 0 to 3.
const LINES: u32 = 0b1111;
/// The gates are on PC6 and the pins behind it.
const FIRST_GATE: u32 = 6;

/// The pins of four nodes. They are held, so that nobody else has them, and read and set as bits of their
/// port.
#[expect(dead_code, reason = "the port is read and set as a whole")]
pub(crate) struct Pins {
    pub(crate) lines: (PC0<Input>, PC1<Input>, PC2<Input>, PC3<Input>),
    pub(crate) gates: (PC6<Output>, PC7<Output>, PC8<Output>, PC9<Output>),
}

/// The TX lines of four nodes, their gates, and the timer that asks for looks.
pub struct Taps {
    _pins: Pins,
    exti: pac::EXTI,
    timer: pac::TIM3,
}

/// What a look found. Bit `k` is that of node `k`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Levels {
    /// The lines that are dominant.
    pub dominant: u32,
    /// The lines that have become dominant since the look before.
    pub fell: u32,
}

/// Wires EXTI to the lines and starts the timer. The clock gates of SYSCFG and TIM3 are open.
pub(crate) fn start(pins: Pins, exti: pac::EXTI, syscfg: &pac::SYSCFG, timer: pac::TIM3) -> Taps {
    syscfg
        .exticr1()
        .modify(|_, w| w.exti0().pc().exti1().pc().exti2().pc().exti3().pc());
    for line in 0..4 {
        exti.ftsr().modify(|_, w| w.tr(line).set_bit());
        exti.imr().modify(|_, w| w.mr(line).set_bit());
    }
    timer::start::<1, LOOK_HZ>(&timer, Effect::Interrupt);
    Taps {
        _pins: pins,
        exti,
        timer,
    }
}

impl Taps {
    /// Acknowledges the timer, and looks at the lines. The latch is cleared before the levels are read, so
    /// that no dominant bit is missed.
    #[inline]
    pub fn look(&mut self) -> Levels {
        timer::acknowledge(&self.timer);
        let fell = self.exti.pr().read().bits() & LINES;
        // SAFETY: a one clears the bit of a line, and a zero leaves it (RM0390 10.3.6).
        self.exti.pr().write(|w| unsafe { w.bits(fell) });
        // One read of the port, because looks are due each 9 us.
        // SAFETY: a read of the input register changes nothing, and the pins are this type's.
        let levels = unsafe { (*pac::GPIOC::ptr()).idr().read().bits() };
        Levels {
            dominant: !levels & LINES,
            fell,
        }
    }

    /// Opens the gates of these nodes, bit by bit, and closes all others.
    #[inline]
    pub fn open(&mut self, open: u32) {
        let open = open & LINES;
        let set = (open ^ LINES) << FIRST_GATE;
        let reset = open << (FIRST_GATE + 16);
        // SAFETY: the register sets and resets only the bits that are one (RM0390 7.4.7), those of pins that
        // are this type's.
        unsafe { (*pac::GPIOC::ptr()).bsrr().write(|w| w.bits(set | reset)) };
    }
}
