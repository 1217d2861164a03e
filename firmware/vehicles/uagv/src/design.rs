//! The vehicle's numbers: those of its manifest, and what follows from them and from the
//! system matrix.

use ttcan::Micros;

include!(concat!(env!("OUT_DIR"), "/design.rs"));

/// Time from the end of a command frame until the second frame after it is overdue.
pub const COMMAND_TIMEOUT: Micros = crate::matrix::overdue::COMMAND;

/// Cycle time at which the control step is released: by then all sensors' messages have
/// arrived.
pub const CONTROL_RELEASE: Micros = crate::matrix::release::COMMAND;

/// Cycle time at which the rows node makes its message: late, so that the control step of the next
/// cycle gets a fresh one.
#[cfg(row_guidance)]
pub const ROW_RELEASE: Micros = Micros::micros(88_000);

/// Distance between the axles, m.
#[cfg(row_guidance)]
pub const WHEELBASE: f32 = (GEOMETRY.l1 + GEOMETRY.l2) as f32;
