//! A CAN bus resolved bit by bit, with register-level models of ST's bxCAN on it.
//!
//! - [`Bus`] owns the nodes and the time between them: arbitration, stuffing, acknowledge, error
//!   frames, error counters, bus-off and recovery follow from what each node drives and reads in
//!   each bit (ISO 11898-1), not from rules about whole frames.
//! - bxCAN controllers ([`Bus::add_bxcan`]) are reached through their registers and interrupt
//!   lines, so that unmodified firmware can run against them.
//! - [`Tester`]s are foreign nodes: loggers, spoofers, babbling idiots.
//! - [`Disturbance`]s flip bits, raise the bit error rate, or hold the bus at one level.
//! - [`candump`] reads and writes the log format of can-utils.
//!
//! # Time
//! Each node divides its own clock ([`ClockRate`]) into quanta. On an idle bus it keeps its own
//! grid of bits, and starts to send at its next bit boundary. In a frame the transmitter's clock
//! sets the pace; every other node samples by its own quanta, synchronised hard at start of frame
//! and resynchronised on edges. Propagation along the cable and through transceivers is not
//! modelled.
//!
//! # Together with emulated microcontrollers
//! Register writes carry time stamps and may lie ahead of the bus; see [`Bus::horizon_of`] for
//! how far a node may run ahead without missing anything.

#![forbid(unsafe_code)]

mod bus;
mod bxcan;
pub mod candump;
mod confinement;
mod disturbance;
mod frame;
mod mac;
mod record;
mod tester;
mod time;
pub mod wire;

pub use bus::{Bus, NodeId, Part};
pub use bxcan::IrqLines;
pub use confinement::{ErrorCounters, ErrorKind, ErrorState};
pub use disturbance::{Disturbance, FrameSelect, SeenBy};
pub use frame::Frame;
pub use record::{Record, RecordKind};
pub use tester::{Reception, Retry, Tester};
pub use time::{BitSegments, ClockRate, SimDuration, SimTime};
pub use wire::Level;
