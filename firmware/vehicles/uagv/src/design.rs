//! The vehicle's numbers: those of its manifest, and what follows from them and from the
//! system matrix.

use ttcan::Micros;

include!(concat!(env!("OUT_DIR"), "/design.rs"));

/// Time from the end of a command frame until the second frame after it is overdue.
pub const COMMAND_TIMEOUT: Micros = crate::matrix::overdue::COMMAND;

/// Cycle time at which the control step is released: by then all sensors' messages have
/// arrived.
pub const CONTROL_RELEASE: Micros = crate::matrix::release::COMMAND;
