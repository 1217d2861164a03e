//! What the messages of every network have in common.
//!
//! The messages themselves, and the system matrix, are generated from a vehicle's
//! `network.dbc` into that vehicle's own crate. So code that all vehicles share can be
//! written for any [`Message`].
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

mod message;

/// Periods that a reference or a command may be missing before an actuator stops
/// (thesis 6.2.4.4).
pub const MISSED_PERIODS: u32 = 2;

pub use message::{DecodeError, Message, Signal};
