//! The vehicle's numbers: those of its manifest, and what follows from them and from the
//! system matrix.

use ttcan::Micros;

include!(concat!(env!("OUT_DIR"), "/design.rs"));

/// How long after the end of a command frame the second one after it is overdue.
pub const COMMAND_TIMEOUT: Micros = crate::matrix::overdue::COMMAND;

/// Cycle time at which the control step is released: all sensors' messages have arrived.
pub const CONTROL_RELEASE: Micros = crate::matrix::release::COMMAND;
