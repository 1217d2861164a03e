//! The Nucleo-F446RE on a CAN sled: clocks, pins and peripherals.
//!
//! # Pins
//!
//! | pin | function | peripheral | connected to |
//! | --- | --- | --- | --- |
//! | PH0 | HSE in, bypass | RCC | 8 MHz of the on-board debugger |
//! | PB8 | CAN RX, AF9, pull-up | CAN1 | R of the sled's SN65HVD230 transceiver |
//! | PB9 | CAN TX, AF9 | CAN1 | D of the transceiver |
//! | PA5 | LED, push-pull, high = on | GPIO | LD2 of the Nucleo |
//! | PA2 | console TX, AF7 | USART2, DMA1 stream 6 | debugger's virtual port |
//! | PA3 | console RX, AF7 | USART2 | debugger's virtual port |
//! | PA9 | receiver TX, AF7 | USART1 | RX of the satellite receiver (node gps) |
//! | PA10 | receiver RX, AF7 | USART1, DMA2 stream 2 | TX of the satellite receiver (gps) |
//! | PA0 | analogue | ADC1_IN0, DMA2 stream 0 | joystick x (controller) |
//! | PA1 | analogue | ADC1_IN1, DMA2 stream 0 | joystick y (controller) |
//! | PC0..PC3 | input, pull-down, high = pressed | GPIO | remote control A, B, C, D (controller) |
//! | PC4 | input, pull-up, low = pressed | GPIO | joystick switch (controller) |
//! | PC5 | input, pull-up, high = open | GPIO | emergency stop loop, normally closed to ground (controller) |
//! | PC10 | display TX, AF7 | USART3, DMA1 stream 3 | RX of the display (controller) |
//! | PC11 | display RX, AF7 | USART3 | TX of the display (controller) |
//!
//! # Wiring
//!
//! `boards/sleds/f446.svg` draws the sled from its netlist.
//!
//! The sled feeds 5 V from its 6.5-32 V switching supply into the Nucleo's E5V (jumper JP5
//! on E5V) behind a 1 A fuse, and the 5 V rail out to the receiver and the display (thesis
//! 5.2.4.2). The transceiver runs on 3.3 V; its RS pin is at ground (high speed). The bus
//! is terminated with 120 ohm at the two outermost sleds. All grounds are the chassis.
//!
//! The thesis calls the transceiver an SN65HVD250 that runs on 3.3 V. TI's part for 3.3 V is the
//! SN65HVD230 (data sheet SLOS346); its SN65HVD251 needs 5 V (SLLS545).
//!
//! # What the HAL does
//!
//! | hardware | through the HAL | by registers, in `registers` |
//! | --- | --- | --- |
//! | pins | all of them | |
//! | clock gates, resets | `rcc::Enable`, `rcc::Reset` | delay until the peripheral can be used |
//! | DMA | streams | |
//! | CAN | `can::Can`, configuration by `bxcan` | mailbox, FIFO, outcome of an attempt: `sled_common::can` |
//! | watchdog | `watchdog::IndependentWatchdog` | |
//! | supply | | voltage detector: the HAL has no driver |
//! | clock tree | | bounded wait, HSI without HSE, clock security system |
//! | time base | | free-running counter with two compare interrupts |
//! | periodic timers, serial ports | | rates need `rcc::Clocks`, which only the HAL's clock tree makes |
//! | converter | | no constructor without an unbounded wait |
//!
//! # Timers
//!
//! TIM2 is the time base and window timer ([`time`]), TIM3 starts the joystick's scan,
//! TIM4 is the display's tick (controller) or looks at the receiver's line (gps). The watchdog
//! has its own oscillator.

#![no_std]

mod agreement;
mod bus;
pub mod console;
mod dma;
pub mod lcd;
pub mod led;
pub mod panel;
pub mod receiver;
mod registers;
pub mod taps;
pub mod watchdog;

pub use bus::{CanPort, Timings};
pub use parts::SLED_F446 as FACTS;
pub use registers::{clocks, flash, time};
#[cfg(target_os = "none")]
pub use sled_common::tick;
pub use sled_common::{can, clock, fault, kept, lines, selftest, stack};
// Described by its own crate: here it would be ten thousand pages.
#[doc(no_inline)]
pub use stm32f4xx_hal::pac;

use clock::{Clocks, ResetCause};
use fault::Fault;
use registers::{crc, gate, reference, supply};
use selftest::Findings;
use stm32f4xx_hal::can::CanExt;
use stm32f4xx_hal::gpio::{self, GpioExt, alt::usart1, alt::usart2, alt::usart3};
use stm32f4xx_hal::rcc::{Rcc, RccExt};

/// What every node on this sled has.
pub struct Sled {
    /// The clocks that were started.
    pub clocks: Clocks,
    /// Why the microcontroller started.
    pub reset_cause: ResetCause,
    /// The time base.
    pub clock: time::Clock,
    /// Its compare channels.
    pub alarms: time::Alarms,
    /// The CAN port.
    pub can: CanPort,
    /// The console.
    pub console: console::Console,
    /// The words in the place of the network's key.
    pub secret: [u32; sled_common::secret::WORDS],
    /// The words in the two places of a mission.
    pub mission: &'static [u32],
    /// What writes them.
    pub flash: flash::Writer,
    /// What the board found out about itself.
    pub findings: Findings,
    /// The LED.
    pub led: led::Led,
    /// The watchdog, which runs already.
    pub watchdog: watchdog::Watchdog,
    /// What only one of the nodes uses.
    pub rest: Rest,
}

/// Peripherals and pins that only one of the nodes uses.
pub struct Rest {
    receiver: pac::USART1,
    display: pac::USART3,
    tick: pac::TIM4,
    adc: pac::ADC1,
    adc_common: pac::ADC_COMMON,
    adc_timer: pac::TIM3,
    display_stream: dma::Stream3<pac::DMA1>,
    dma2: pac::DMA2,
    rcc: Rcc,
    receiver_pins: (gpio::PA9, gpio::PA10),
    axes: (gpio::PA0, gpio::PA1),
    port_c: gpio::gpioc::Parts,
    exti: pac::EXTI,
    syscfg: pac::SYSCFG,
}

impl Sled {
    /// Starts the board for a bus of this bit rate, bit/s: the watchdog first, which bounds everything after it to `watchdog`
    /// milliseconds, then the supply and the clocks, then everything else.
    ///
    /// # Errors
    /// [`Fault::Supply`] if the supply stays too low; [`Fault::ClockStart`] if a clock does not get ready; [`Fault::Start`] if it was called
    /// before, because the memory of the DMA streams can be handed out only once.
    pub fn start<const BIT_RATE: u32>(
        device: pac::Peripherals,
        watchdog: u16,
    ) -> Result<Self, Fault> {
        let watchdog = watchdog::start(device.IWDG, &device.DBGMCU, watchdog);
        fault::expect(Fault::Supply);
        gate::open_power(&device.RCC);
        supply::watch(&device.PWR, &device.EXTI).ok_or(Fault::Supply)?;
        let _watched = supply::Watch::begin();
        // Only now: a start that ended for want of supply leaves the cause to the next one.
        let reset_cause = clocks::reset_cause(&device.RCC);
        fault::expect(Fault::ClockStart);
        let (clocks, clock_error) =
            clocks::start(&device.RCC, &device.PWR, &device.FLASH, &device.TIM11)
                .ok_or(Fault::ClockStart)?;
        fault::expect(Fault::Start);
        let mut rcc = device.RCC.constrain();
        gate::open::<pac::TIM2>(&mut rcc);
        let (clock, alarms) = time::start(device.TIM2);
        gate::open::<pac::USART2>(&mut rcc);
        gate::open::<pac::DMA1>(&mut rcc);
        let streams = dma::StreamsTuple::new(device.DMA1, &mut rcc);
        let console = console::start(&device.USART2, streams.6).ok_or(Fault::Start)?;
        // The HAL enables these clocks once more, and resets the peripherals.
        gate::open::<pac::GPIOA>(&mut rcc);
        gate::open::<pac::GPIOB>(&mut rcc);
        gate::open::<pac::GPIOC>(&mut rcc);
        gate::open::<pac::CAN1>(&mut rcc);
        let port_a = device.GPIOA.split(&mut rcc);
        let port_b = device.GPIOB.split(&mut rcc);
        let port_c = device.GPIOC.split(&mut rcc);
        let _: (usart2::Tx, usart2::Rx) = (port_a.pa2.into(), port_a.pa3.into());
        // Without a transceiver the pin reads recessive.
        let receive = port_b.pb8.internal_pull_up(true);
        let can = device.CAN1.can((port_b.pb9, receive), &mut rcc);
        let can = bus::start::<BIT_RATE>(can, clocks.oscillator);
        gate::open::<pac::CRC>(&mut rcc);
        gate::open::<pac::ADC1>(&mut rcc);
        let findings = Findings {
            memory_defect: sled_common::memory::defect(),
            program: sled_common::image::is_intact(&FACTS.part.flash, &mut crc::Unit(&device.CRC)),
            clock_error,
            loop_back: can.has_looped_back(),
            reference: reference::read(&device.ADC1, &device.ADC_COMMON, clocks.core),
        };
        Ok(Self {
            clocks,
            reset_cause,
            clock,
            alarms,
            can,
            secret: sled_common::secret::record(&FACTS.secret),
            mission: FACTS
                .mission
                .as_ref()
                .map_or(&[], sled_common::mission::words),
            flash: flash::Writer::new(device.FLASH),
            findings,
            console,
            led: led::Led::new(port_a.pa5),
            watchdog,
            rest: Rest {
                receiver: device.USART1,
                display: device.USART3,
                tick: device.TIM4,
                adc: device.ADC1,
                adc_common: device.ADC_COMMON,
                adc_timer: device.TIM3,
                display_stream: streams.3,
                dma2: device.DMA2,
                rcc,
                receiver_pins: (port_a.pa9, port_a.pa10),
                axes: (port_a.pa0, port_a.pa1),
                port_c,
                exti: device.EXTI,
                syscfg: device.SYSCFG,
            },
        })
    }
}

/// Peripherals that only the controller node uses.
pub struct Operator {
    /// The joystick's axes.
    pub joystick: panel::Joystick,
    /// The remote control and the switches.
    pub buttons: panel::Buttons,
    /// The display.
    pub lcd: lcd::Lcd,
    /// The display's replies.
    pub replies: lcd::Replies,
    /// The display's tick.
    pub tick: lcd::Tick,
}

impl Rest {
    /// Starts the satellite receiver's port (node gps).
    pub fn receiver(self) -> Option<receiver::Receiver> {
        let mut rcc = self.rcc;
        gate::open::<pac::USART1>(&mut rcc);
        gate::open::<pac::TIM4>(&mut rcc);
        gate::open::<pac::DMA2>(&mut rcc);
        let streams = dma::StreamsTuple::new(self.dma2, &mut rcc);
        let (tx, rx) = self.receiver_pins;
        let _: (usart1::Tx, usart1::Rx) = (tx.into(), rx.into());
        receiver::start(&self.receiver, streams.2, self.tick)
    }

    /// Starts the TX lines of four nodes and their gates, which are open (a guardian).
    pub fn taps(self) -> taps::Taps {
        let mut rcc = self.rcc;
        gate::open::<pac::TIM3>(&mut rcc);
        gate::open::<pac::SYSCFG>(&mut rcc);
        let pins = self.port_c;
        let pins = taps::Pins {
            lines: (
                pins.pc0.into_pull_up_input(),
                pins.pc1.into_pull_up_input(),
                pins.pc2.into_pull_up_input(),
                pins.pc3.into_pull_up_input(),
            ),
            gates: (
                pins.pc6.into_push_pull_output(),
                pins.pc7.into_push_pull_output(),
                pins.pc8.into_push_pull_output(),
                pins.pc9.into_push_pull_output(),
            ),
        };
        taps::start(pins, self.exti, &self.syscfg, self.adc_timer)
    }

    /// Starts joystick, buttons and display (node controller).
    pub fn operator(self) -> Option<Operator> {
        let mut rcc = self.rcc;
        gate::open::<pac::USART3>(&mut rcc);
        gate::open::<pac::TIM3>(&mut rcc);
        gate::open::<pac::TIM4>(&mut rcc);
        gate::open::<pac::ADC1>(&mut rcc);
        gate::open::<pac::DMA2>(&mut rcc);
        let streams = dma::StreamsTuple::new(self.dma2, &mut rcc);
        let _ = (self.axes.0.into_analog(), self.axes.1.into_analog());
        let _: (usart3::Tx, usart3::Rx) = (self.port_c.pc10.into(), self.port_c.pc11.into());
        let (lcd, replies, tick) = lcd::start(self.display, self.tick, self.display_stream)?;
        let joystick = panel::start(&self.adc, &self.adc_common, &self.adc_timer, streams.0)?;
        Some(Operator {
            joystick,
            buttons: panel::Buttons {
                a: self.port_c.pc0.into_pull_down_input(),
                b: self.port_c.pc1.into_pull_down_input(),
                c: self.port_c.pc2.into_pull_down_input(),
                d: self.port_c.pc3.into_pull_down_input(),
                joystick: self.port_c.pc4.into_pull_up_input(),
                stop_loop: self.port_c.pc5.into_pull_up_input(),
            },
            lcd,
            replies,
            tick,
        })
    }
}

/// Stops the actuator of this sled. It does nothing, because no actuator is connected to this
/// sled.
pub fn stop_actuator() {}

sled_common::fault_handlers!(crate::stop_actuator);
