//! The vehicle without the vehicle: the release images run on emulated microcontrollers,
//! joined by a bit-timed CAN bus, inside a simulated world.
//!
//! | room | what it holds |
//! | --- | --- |
//! | [`part`] | the two microcontrollers: memory maps, gates, interrupts, DMA requests, pins |
//! | [`image`] | ELF files: what goes into flash, what the handlers are called |
//! | [`mcu`] | one microcontroller: core, memories and peripherals in step |
//! | [`statistics`] | cycles of each task: activations, longest own time, longest response |
//! | [`network`] | several microcontrollers on one bus |
//! | [`Twin`] | all nodes of a vehicle with the world around them; [`run`] |
//!
//! # What is emulated
//! The core is `rsemu`'s ARMv7E-M with NVIC, SysTick and FPU; its GPIO ports and timers are
//! `rsemu`'s too. Clock control, USARTs, DMA, ADC, watchdog, power and flash control are
//! modelled here from the reference manuals RM0390 and RM0316, each with tests at its
//! registers; bxCAN and the bus are `can-bus`. The images are not changed in any way.
//!
//! Pins count: a USART or the CAN controller whose pins are not handed to it is cut off. A
//! block whose clock is gated reads zero and takes no writes. A register that no model
//! knows reads zero and is listed by [`mcu::Mcu::unmodelled`]; an address at which there
//! is nothing is a bus fault.
//!
//! # Time
//! A node counts cycles of its own core clock, which follows its clock tree and the error
//! of its oscillator; simulation time is picoseconds. Instructions take the cycles of the
//! Cortex-M4 processor manual, an exception entry 12, a return 10, a tail-chain 6; wait
//! states of the flash come on top when wanted ([`mcu::FlashTiming`]). Interrupts are taken at the first instruction boundary behind the cycle in
//! which their cause arises. While a core sleeps nothing is executed: time jumps to the
//! next event. `DWT_CYCCNT` stands still meanwhile, SysTick goes on.
//!
//! Within a slice each node runs alone, no further than the instant at which another node
//! could first reach it over the bus; so one scenario, one seed and one set of images give
//! one outcome, byte for byte.
//!
//! # What is not
//! - the sharing of the bus matrix with the DMA controllers; the pairing of loads and
//!   stores in the core's pipeline;
//! - low-power modes but sleep, clock and voltage supervision, backup domain, EXTI lines
//!   (their interrupts can be pended by software), SYSCFG remaps;
//! - what the documentation of each peripheral in the source leaves out.

mod clock;
mod flash;
pub mod image;
pub mod mcu;
pub mod network;
pub mod part;
mod peripheral;
pub mod statistics;
mod twin;
mod window;
mod wiring;

pub use peripheral::{PinChange, ResetCause, SharedBus, UartByte};
pub use twin::{Images, NodeOutcome, Options, Outcome, Progress, Twin, TwinError, run};
pub use wiring::WiringError;
