//! Simulates a whole vehicle: the release images run on emulated microcontrollers, connected by a
//! bit-timed CAN bus, in a simulated world.
//!
//! | module | contents |
//! | --- | --- |
//! | [`part`] | the two microcontrollers: memory maps, gates, interrupts, DMA requests, pins |
//! | [`image`] | ELF files: flash contents and names of the handlers |
//! | [`mcu`] | one microcontroller: core, memories and peripherals |
//! | [`debugger`] | what a program under test sees of a debugger: semihosting |
//! | [`statistics`] | cycles of each task: activations, longest execution time, longest response |
//! | [`replay`] | a run in which a debugger goes forwards and backwards |
//! | [`stops`] | where a debugger stops a node |
//! | [`network`] | several microcontrollers on one bus |
//! | [`Twin`] | all nodes of a vehicle and the world around them; [`run`] |
//!
//! # What is emulated
//! The core is `rsemu`'s ARMv7E-M with NVIC, SysTick and FPU; GPIO ports and timers are `rsemu`'s
//! too. This crate models clock control, USARTs, DMA, ADC, watchdog, power and flash control after
//! the reference manuals RM0390 and RM0316, and tests each at its registers. The bus and bxCAN come
//! from `can-bus`. The images run unchanged.
//!
//! Pins matter: a USART or CAN controller is disconnected until the program assigns its pins to it.
//! A peripheral whose clock gate is closed reads as zero and ignores writes. A register without a
//! model reads as zero, and an address without a peripheral is a bus fault; both end the run.
//!
//! A program that does what the part's documents do not allow ends the run with a [`Violation`]:
//! it uses a peripheral too soon after its clock was enabled, lets a clock exceed its limit, or
//! accesses a register in a way that this does not have.
//!
//! # Time
//! A node counts cycles of its own core clock, which follows its clock tree and the error of its
//! oscillator. Simulation time is in picoseconds. Instructions take the cycles of the Cortex-M4
//! processor manual, an exception entry 12, a return 10, a tail-chain 6. Flash wait states are
//! added on request ([`mcu::FlashTiming`]). The core takes an interrupt at the first instruction
//! boundary after the cycle that raises it. While a core sleeps, the simulation jumps to its next
//! event; `DWT_CYCCNT` stops meanwhile, SysTick continues.
//!
//! Time advances in slices. In a slice each node runs alone, at most until another node could first
//! affect it over the bus. The order of execution therefore does not matter: one scenario, one seed
//! and one set of images give one outcome, byte for byte.
//!
//! # What is not emulated
//! - contention between core and DMA controllers on the bus matrix: a DMA transfer takes time, but
//!   delays no access of the core; pairing of loads and stores in the
//!   core's pipeline;
//! - low-power modes other than sleep, brown-out reset by option bytes, backup domain, EXTI but
//!   for the F446's lines of the pins and of its voltage detector (the interrupts of lines 5 to 15 only by
//!   software), SYSCFG remaps;
//! - the features that each peripheral's documentation in the source names as not modelled.

mod chain;
mod clock;
pub mod debugger;
mod flash;
pub mod image;
pub mod mcu;
pub mod network;
pub mod part;
mod peripheral;
pub mod replay;
mod silicon;
pub mod statistics;
pub mod stops;
mod stores;
mod twin;
mod window;
mod wiring;

pub use chain::{Chain, Latency, OnWire};
pub use peripheral::{Burst, PinChange, ResetCause, SharedBus, UartByte};
pub use silicon::Violation;
pub use statistics::TaskSwitch;
pub use twin::{GateChange, Images, NodeOutcome, Options, Outcome, Progress, Twin, TwinError, run};
pub use wiring::WiringError;
