//! What the messages of every network have in common.
//!
//! The messages themselves, and the system matrix, are generated from a vehicle's
//! `network.dbc` into that vehicle's own crate. So code that all vehicles share can be
//! written for any [`Message`].
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

mod message;

pub use message::{DecodeError, Message, Signal};
