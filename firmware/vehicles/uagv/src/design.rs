//! The vehicle's numbers: those of its manifest, and what follows from them and from the
//! system matrix.

use ttcan::Micros;

use crate::matrix::{BASIC_CYCLE, BIT_RATE};

include!(concat!(env!("OUT_DIR"), "/design.rs"));

/// How long after the end of a command frame the second one after it is overdue.
pub const COMMAND_TIMEOUT: Micros = firmware::design::command_timeout(BASIC_CYCLE, BIT_RATE);

/// Cycle time at which the control step is released: all sensors' messages have arrived.
pub const CONTROL_RELEASE: Micros = crate::matrix::release::COMMAND;
