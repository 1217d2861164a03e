//! The Nucleo-F303K8 on a CAN sled: clocks, pins and peripherals.
//!
//! # Pins
//!
//! | pin | function | peripheral | connected to |
//! | --- | --- | --- | --- |
//! | PF0 | HSE in, bypass | RCC | 8 MHz of the on-board debugger, if SB4 and SB6 say so |
//! | PA11 | CAN RX, AF9, pull-up | CAN | R of the sled's SN65HVD230 transceiver |
//! | PA12 | CAN TX, AF9 | CAN | D of the transceiver |
//! | PB3 | LED, push-pull, high = on | GPIO | LD3 of the Nucleo |
//! | PA2 | console TX, AF7 | USART2, DMA1 channel 7 | debugger's virtual port |
//! | PA15 | console RX, AF7 | USART2 | debugger's virtual port |
//! | PA8 | motor relay, push-pull, high = closed | GPIO | transistor that switches the relay in lead M1 of the motor, 10 kohm to ground |
//! | PB0 | read-back of the relays, pull-up, low = one conducts | GPIO | joint of the two relays, through 1 kohm and a diode; 10 kohm to 3.3 V |
//! | PA9 | motor command, AF7 | USART1 | S1 of the SyRen 50 motor driver |
//! | PA0 | analogue | ADC1_IN1, DMA1 channel 1 | wiper of the steering potentiometer (steering) |
//! | PA1, PA3 | analogue | ADC1_IN2, ADC1_IN4, DMA1 channel 1 | left and right distance sensor, divided by three |
//! | PA7, PA10 | servo pulses, AF6 | TIM1_CH1N, TIM1_CH3 | left and right motor driver (Victor SP), 10 kohm to ground |
//! | PB5, PB4 | run, stop, pull-down | GPIO | remote control, 10 kohm to ground and 1 kohm in series |
//! | PB4, PA7 | capture, AF2; push-pull, high = closed | TIM3_CH1, GPIO | of a guardian's sled: TX line of the guarded node, and its gate ([`tap`]) |
//!
//! # Wiring
//!
//! `boards/sleds/f303.svg` draws the sled from its netlist.
//!
//! The sled feeds 5 V from its 6.5-32 V switching supply into the Nucleo's 5V pin behind a
//! 1 A fuse (thesis 5.2.4.2). The transceiver runs on 3.3 V; its RS pin is at ground (high
//! speed). The potentiometer lies between 3.3 V and ground. The motor driver's switches are
//! set to simplified serial at 38 400 baud; its 0V is the sled's ground, its S1 takes 3.3 V
//! levels. All grounds are the chassis.
//!
//! A Nucleo-32 that runs on its 5V pin does not power its ST-LINK, whose 8 MHz are then missing
//! (UM1956). So the sled has an oscillator of 8 MHz at PF0.
//!
//! The relay is normally open and sits in the lead between the driver's M1 and the motor. It is
//! needed because the driver keeps its last speed when its node falls silent, and in this mode
//! has no input that stops it. It consists of two solid-state relays for direct current (60 A) in
//! series, back to back, because the open relay conducts backwards through its body diode, and
//! the motor's current has both directions. A suppressor diode across the motor takes its current
//! when the relay opens. With the relay open nothing but the current of a resistor of 1 kohm flows
//! through the motor. During reset PA8 floats, and its resistor opens the relay.
//!
//! The two are joined at their + sides, so their body diodes conduct into the joint. While both are
//! open and the driver is stopped, the joint floats, and the pull-up at PB0 lifts it through a
//! diode, which blocks the battery's voltage. A relay that conducts joins it to M1 or to the motor's
//! lead. The stopped driver holds both near ground, and so does a resistor of 1 kohm on each if the
//! driver's output floats. So PB0 tells that one of the two no longer opens while the other one
//! still does. It cannot tell if the driver holds its output at the battery's voltage while it is
//! stopped, or if the wire to PB0 is broken: then PB0 is high. `boards/sleds/README.md` has the
//! levels.
//!
//! # What the HAL does
//!
//! | hardware | through the HAL | by registers, in `registers` |
//! | --- | --- | --- |
//! | pins | all of them | |
//! | clock gates | `rcc::Enable` | delay until the peripheral can be used |
//! | DMA | channels: direction, interrupts, enable | addresses, lengths, sizes: the setters assert; the end of a transfer in one read |
//! | CAN | configuration by `bxcan`; the HAL has no driver | mailbox, FIFO, outcome of an attempt: `sled_common::can` |
//! | watchdog | `watchdog::IndependentWatchDog` | |
//! | clock tree | | bounded wait, HSI without HSE, clock security system |
//! | time base | | free-running counter with two compare interrupts |
//! | periodic timer, serial ports | | rates need `rcc::Clocks`, which only the HAL's clock tree makes |
//! | converter | | the HAL has neither trigger nor DMA for it |
//!
//! # Timers
//!
//! TIM2 is the time base and window timer ([`time`]), TIM3 starts the conversions of the
//! potentiometer or of the distance sensors, TIM1 makes the servo pulses. On a guardian's sled TIM3 captures the edges of
//! the TX line, and TIM7 asks for looks at it. The watchdog has its own oscillator.

#![no_std]

mod agreement;
mod bus;
pub mod console;
pub mod distances;
pub mod led;
pub mod motor;
pub mod pot;
mod registers;
pub mod remote;
pub mod servos;
pub mod tap;
pub mod watchdog;

pub use bus::{CanPort, Timings};
pub use motor::stop as stop_actuator;
pub use parts::SLED_F303 as FACTS;
pub use registers::{clocks, flash, time};
#[cfg(target_os = "none")]
pub use sled_common::tick;
pub use sled_common::{burst, can, clock, dma, fault, kept, lines, pulse, selftest, stack};
// Described by its own crate: here it would be ten thousand pages.
#[doc(no_inline)]
pub use stm32f3xx_hal::pac;

use clock::{Clocks, ResetCause};
use fault::Fault;
use registers::{crc, gate, reference};
use selftest::Findings;
use stm32f3xx_hal::dma::{DmaExt, dma1::C1};
use stm32f3xx_hal::gpio::{self, Input, PushPull, gpioa, gpiob};
use stm32f3xx_hal::prelude::*;
use stm32f3xx_hal::rcc;

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
    /// The motor driver, its relay open.
    pub motor: motor::MotorOutput,
    /// The words in the place of the network's key.
    pub secret: [u32; sled_common::secret::WORDS],
    /// The pages in which the node may count its starts.
    pub starts: flash::Pages,
    /// What the board found out about itself.
    pub findings: Findings,
    /// The LED.
    pub led: led::Led,
    /// The watchdog, which runs already.
    pub watchdog: watchdog::Watchdog,
    /// What only one of the nodes uses.
    pub rest: Rest,
}

/// Peripherals that only one of the nodes uses.
pub struct Rest {
    adc: pac::ADC1,
    adc_common: pac::ADC1_2,
    adc_timer: pac::TIM3,
    adc_channel: C1,
    pulses: Option<Pulses>,
    remote: Option<RemotePins>,
    look_timer: pac::TIM7,
    bus: rcc::APB2,
    slow_bus: rcc::APB1,
    clocks: Clocks,
    pins: Pins,
}

/// The timer and the pins of the servo outputs, left and right.
type Pulses = (pac::TIM1, gpioa::PA7<Input>, gpioa::PA10<Input>);

/// The pins of the remote control: run and stop.
type RemotePins = (gpiob::PB5<Input>, gpiob::PB4<gpio::AF0<PushPull>>);

/// Their pins, and the registers that assign them.
struct Pins {
    distances: (gpioa::PA1<Input>, gpioa::PA3<Input>),
    modes_a: gpioa::MODER,
    pulls_a: gpioa::PUPDR,
    types_a: gpioa::OTYPER,
    functions_a: (gpioa::AFRL, gpioa::AFRH),
    modes_b: gpiob::MODER,
    pulls_b: gpiob::PUPDR,
    functions_b: (gpiob::OTYPER, gpiob::AFRL),
}

/// Lets the clock through to what needs nothing but that.
fn open_gates(apb1: &mut rcc::APB1, ahb: &mut rcc::AHB) {
    gate::open::<pac::CAN>(apb1);
    gate::open::<pac::TIM3>(apb1);
    gate::open::<pac::ADC1_2>(ahb);
    gate::open::<pac::GPIOA>(ahb);
    gate::open::<pac::GPIOB>(ahb);
}

impl Sled {
    /// Starts the board for a bus of this bit rate, bit/s: the watchdog first, which bounds everything after it to `watchdog`
    /// milliseconds, then the clocks, then the motor's port, which sends the stop command, then
    /// everything else.
    ///
    /// # Errors
    /// [`Fault::ClockStart`] if a clock does not get ready; [`Fault::Start`] if it was called
    /// before, because the memory of the DMA channels can be handed out only once.
    pub fn start<const BIT_RATE: u32>(
        device: pac::Peripherals,
        watchdog: u16,
    ) -> Result<Self, Fault> {
        let watchdog = watchdog::start(device.IWDG, &device.DBGMCU, watchdog);
        let reset_cause = clocks::reset_cause(&device.RCC);
        fault::expect(Fault::ClockStart);
        let (clocks, clock_error) =
            clocks::start(&device.RCC, &device.FLASH, &device.TIM16).ok_or(Fault::ClockStart)?;
        fault::expect(Fault::Start);
        let mut rcc = device.RCC.constrain();
        gate::open::<pac::USART1>(&mut rcc.apb2);
        // The port starts before its pin is connected: so the line goes from floating to idle.
        let mut motor = motor::start(device.USART1, clocks.core);
        gate::open::<pac::TIM2>(&mut rcc.apb1);
        let (clock, alarms) = time::start(device.TIM2);
        gate::open::<pac::USART2>(&mut rcc.apb1);
        // The HAL enables the clocks of DMA and ports once more.
        gate::open::<pac::DMA1>(&mut rcc.ahb);
        let channels = device.DMA1.split(&mut rcc.ahb);
        let console =
            console::start(&device.USART2, clocks.apb1, channels.ch7).ok_or(Fault::Start)?;
        open_gates(&mut rcc.apb1, &mut rcc.ahb);

        let mut a = device.GPIOA.split(&mut rcc.ahb);
        let mut b = device.GPIOB.split(&mut rcc.ahb);
        let relay = a.pa8.into_push_pull_output(&mut a.moder, &mut a.otyper);
        a.pa9
            .into_af_push_pull::<7>(&mut a.moder, &mut a.otyper, &mut a.afrh);
        motor.send(motor::STOP);
        a.pa2
            .into_af_push_pull::<7>(&mut a.moder, &mut a.otyper, &mut a.afrl);
        a.pa15
            .into_af_push_pull::<7>(&mut a.moder, &mut a.otyper, &mut a.afrh);
        // Without a transceiver the pin reads recessive.
        let mut receive = a
            .pa11
            .into_af_push_pull::<9>(&mut a.moder, &mut a.otyper, &mut a.afrh);
        receive.internal_pull_up(&mut a.pupdr, true);
        a.pa12
            .into_af_push_pull::<9>(&mut a.moder, &mut a.otyper, &mut a.afrh);
        a.pa0.into_analog(&mut a.moder, &mut a.pupdr);
        let sense = b.pb0.into_pull_up_input(&mut b.moder, &mut b.pupdr);
        let led = b.pb3.into_push_pull_output(&mut b.moder, &mut b.otyper);
        gate::open::<pac::CRC>(&mut rcc.ahb);
        let can = bus::start::<BIT_RATE>(device.CAN, clocks.oscillator);
        let findings = Findings {
            clock_error,
            loop_back: can.has_looped_back(),
            reference: reference::read(&device.ADC1, &device.ADC1_2, clocks.core),
            ..memories(&device.CRC)
        };
        Ok(Self {
            clocks,
            reset_cause,
            clock,
            alarms,
            can,
            secret: sled_common::secret::record(&FACTS.secret),
            starts: flash::Pages::new(device.FLASH),
            findings,
            console,
            motor: motor::MotorOutput::new(motor, motor::Relay::new(relay, sense)),
            led: led::Led::new(led),
            watchdog,
            rest: Rest {
                adc: device.ADC1,
                adc_common: device.ADC1_2,
                adc_timer: device.TIM3,
                adc_channel: channels.ch1,
                pulses: Some((device.TIM1, a.pa7, a.pa10)),
                remote: Some((b.pb5, b.pb4)),
                look_timer: device.TIM7,
                bus: rcc.apb2,
                slow_bus: rcc.apb1,
                clocks,
                pins: Pins {
                    distances: (a.pa1, a.pa3),
                    modes_a: a.moder,
                    pulls_a: a.pupdr,
                    types_a: a.otyper,
                    functions_a: (a.afrl, a.afrh),
                    modes_b: b.moder,
                    pulls_b: b.pupdr,
                    functions_b: (b.otyper, b.afrl),
                },
            },
        })
    }
}

/// What the board finds out about its memories.
fn memories(unit: &pac::CRC) -> Findings {
    Findings {
        memory_defect: sled_common::memory::defect(),
        program: sled_common::image::is_intact(&FACTS.part.flash, &mut crc::Unit(unit)),
        clock_error: None,
        loop_back: None,
        reference: None,
    }
}

impl Rest {
    /// Starts the potentiometer's conversions (node steering). `None` when the converter
    /// does not get ready.
    pub fn pot(self) -> Option<pot::Pot> {
        pot::start(
            &self.adc,
            &self.adc_common,
            &self.adc_timer,
            self.adc_channel,
            self.clocks.core,
            2 * self.clocks.apb1,
        )
    }

    /// The outputs for servo pulses, one each `period` (node motors of the row follower). The lines are
    /// low, and the motor drivers stand still, until [`servos::Servos::begin`]. `None` the second time.
    pub fn servos(&mut self, period: pulse::PulsePeriod) -> Option<servos::Servos> {
        let (timer, left, right) = self.pulses.take()?;
        gate::open::<pac::TIM1>(&mut self.bus);
        // The core's clock: APB2 is not divided.
        let servos = servos::start(timer, self.clocks.core, period);
        let Pins {
            modes_a,
            types_a,
            functions_a: (low, high),
            ..
        } = &mut self.pins;
        left.into_af_push_pull::<6>(modes_a, types_a, low);
        right.into_af_push_pull::<6>(modes_a, types_a, high);
        Some(servos)
    }

    /// The lines of the remote control (node feedback of the row follower). `None` the second time.
    pub fn remote(&mut self) -> Option<remote::Remote> {
        let (run, stop) = self.remote.take()?;
        let (modes, pulls) = (&mut self.pins.modes_b, &mut self.pins.pulls_b);
        Some(remote::Remote::new(
            run.into_pull_down_input(modes, pulls),
            stop.into_pull_down_input(modes, pulls),
        ))
    }

    /// Starts the TX line of one node and its gate, which is open (a guardian). `None` if servo outputs or the remote control
    /// were taken, whose pins these are.
    pub fn tap(mut self) -> Option<tap::Tap> {
        let (_, gate, _) = self.pulses.take()?;
        let (_, line) = self.remote.take()?;
        gate::open::<pac::TIM7>(&mut self.slow_bus);
        let pins = &mut self.pins;
        let gate = gate.into_push_pull_output(&mut pins.modes_a, &mut pins.types_a);
        let (types_b, low_b) = &mut pins.functions_b;
        let line = line.into_af_push_pull::<2>(&mut pins.modes_b, types_b, low_b);
        let clock = 2 * self.clocks.apb1;
        Some(tap::start(
            line,
            gate,
            self.adc_timer,
            self.look_timer,
            clock,
        ))
    }

    /// Starts the distance sensors' conversions (node sensors of the row follower). `None` when the
    /// converter does not get ready.
    pub fn distances(mut self, trigger: distances::Trigger) -> Option<distances::Distances> {
        let (left, right) = self.pins.distances;
        left.into_analog(&mut self.pins.modes_a, &mut self.pins.pulls_a);
        right.into_analog(&mut self.pins.modes_a, &mut self.pins.pulls_a);
        distances::start(
            self.adc,
            &self.adc_common,
            &self.adc_timer,
            self.adc_channel,
            self.clocks.core,
            2 * self.clocks.apb1,
            trigger,
        )
    }
}

sled_common::fault_handlers!(crate::stop_actuator);
