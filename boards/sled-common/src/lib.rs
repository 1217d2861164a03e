//! What all CAN sleds have in common, whichever microcontroller they carry.
//!
//! - [`can`]: the bxCAN cell, single shot and with the outcome of each attempt;
//! - [`lines`]: text lines in static memory, sent one after the other by DMA;
//! - [`burst`]: means of bursts of samples;
//! - [`pulse`]: widths and periods of servo pulses;
//! - [`dma`]: memory that a DMA controller and the processor share;
//! - [`fault`]: the record of the last fault, which outlives a reset;
//! - [`clock`]: the clocks of a running board, and why it started;
//! - [`starts`]: the number of a start, counted in the flash;
//! - [`tap`]: what a guardian sees of a TX line;
//! - [`selftest`]: what a board finds out about itself, by means of [`memory`], [`image`] and
//!   [`stack`];
//! - `tick`, on a target only: the priority of SysTick.
//!
//! The board crates put their peripherals behind the small traits of this crate, so the nodes
//! see one interface for both boards.

#![no_std]

pub mod burst;
pub mod can;
pub mod clock;
pub mod dma;
pub mod fault;
pub mod image;
pub mod kept;
pub mod lines;
pub mod memory;
pub mod mission;
pub mod pulse;
pub mod secret;
pub mod selftest;
pub mod stack;
pub mod starts;
pub mod tap;
#[cfg(target_os = "none")]
pub mod tick;
