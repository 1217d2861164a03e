//! What every CAN sled has alike, whichever microcontroller is mounted on it.
//!
//! - [`can`]: the bxCAN cell, single shot and with the outcome of each attempt;
//! - [`lines`]: text lines in static memory, sent one after the other by DMA;
//! - [`dma`]: memory that a DMA controller and the processor share;
//! - [`fault`]: the record of the last fault, which outlives a reset;
//! - [`clock`]: what a board found out about its clocks;
//! - `tick`, on a target only: the priority of SysTick.
//!
//! The board crates put their peripherals behind the small traits of this crate;
//! the nodes see one interface for both boards.

#![no_std]

pub mod can;
pub mod clock;
pub mod dma;
pub mod fault;
pub mod lines;
#[cfg(target_os = "none")]
pub mod tick;
