//! The hardware facts of this workspace, each of them once.
//!
//! - [`Part`]: a microcontroller as its maker describes it: memories, clock limits, flash,
//!   oscillators, identification.
//! - [`Sled`]: a board: which part it carries, the clocks it starts, where the stack lies,
//!   what its connectors are wired to.
//! - [`interrupt`]: the interrupt numbers that both parts share.
//!
//! The board crates start their hardware with these numbers and generate their linker
//! scripts from them. The virtual vehicle builds its model of the hardware from them. The
//! schedulability analysis computes with them. A fact that a hardware crate states in a form
//! of its own, such as the pin types of a HAL, is compared with this crate at build time.
//!
//! Sources: STM32F446xC/E reference manual RM0390 rev 6 and data sheet DS10693;
//! STM32F303x6/8 reference manual RM0316 rev 8 and data sheet DS9866.

#![no_std]
#![forbid(unsafe_code)]

pub mod interrupt;
mod part;
mod sled;

pub use part::{
    ClockLimits, F303, F446, Family, Flash, InternalClock, Memory, Part, Supply, SystemPage,
    WatchdogClock,
};
pub use sled::{
    Budget, Clocks, Connector, LinkerScript, Pin, Role, SLED_F303, SLED_F446, Signal, Sled, Tap,
    TimerOutput, UsartPins,
};
