//! The operator's side of the controller: joystick, remote control, emergency stop.
//!
//! The joystick's two axes are scanned by ADC1 at 200 Hz, started by TIM3's trigger output
//! and stored by DMA2 stream 0 (thesis 6.2.4.2).

use crate::dma::{self, DmaChannel, DmaDataSize, Priority, Ring, Stream0};
use crate::pac;
use crate::registers::scan;
use crate::registers::timer::{self, Effect};
use sled_common::dma::{Shared, Window};
use stm32f4xx_hal::gpio::{Input, PC0, PC1, PC2, PC3, PC4, PC5};

/// Scans per second.
pub const SCAN_HZ: u32 = 200;

static MEMORY: Shared<u16, 2> = Shared::new(2048);

/// The joystick.
pub struct Joystick {
    stream: Stream0<pac::DMA2>,
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

/// DMA request channel of ADC1 on stream 0 (RM0390 table 29).
const CHANNEL: DmaChannel = DmaChannel::Channel0;

/// Starts the scan. The clock gates of ADC1 and TIM3 are open.
pub(crate) fn start(
    adc: &pac::ADC1,
    common: &pac::ADC_COMMON,
    clock: &pac::TIM3,
    mut stream: Stream0<pac::DMA2>,
) -> Option<Joystick> {
    let memory = MEMORY.take()?;
    let ring = Ring {
        channel: CHANNEL,
        register: adc.dr().as_ptr() as u32,
        address: memory.address(),
        length: memory.len(),
        size: DmaDataSize::HalfWord,
        priority: Priority::Low,
        halves: false,
    };
    // SAFETY: the memory is a window, which is read volatile.
    unsafe { dma::circulate(&mut stream, &ring) };
    scan::start(adc, common);
    // 90 MHz / 90 = 1 MHz, / 5000 = 200 Hz.
    timer::start::<90, SCAN_HZ>(clock, Effect::Trigger);
    Some(Joystick { stream, memory })
}

impl Joystick {
    /// Acknowledges the end of a scan.
    pub fn acknowledge(&mut self) {
        dma::acknowledge(&mut self.stream);
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
