//! What the messages of every network have in common.
//!
//! The messages themselves, and the system matrix, are generated from a vehicle's `network.dbc`
//! into that vehicle's own crate. Code that all vehicles share is generic over [`Message`].
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

mod message;

/// Consecutive periods without a reference or a command after which an actuator stops (thesis
/// 6.2.4.4).
pub const MISSED_PERIODS: u32 = 2;

pub use message::{DecodeError, Message, Signal};
