//! The vehicle's own language on the bus: message types and the system matrix.
//!
//! Everything here is written by the build script from one file, `uagv.dbc`,
//! which is also what outside tools read. A file that makes no sense (a frame
//! too long for its window, overlapping windows or signals) fails the build
//! with the reason.
//!
//! ```
//! use network::{Message, messages::{MillimetresPerSecond, Velocity}};
//!
//! let data = [0xEA, 0xFF, 0xFF, 0xFF, 0x36, 0, 0, 0];
//! let velocity = Velocity::decode(&data)?;
//! assert_eq!(velocity.north, MillimetresPerSecond(-22));
//! assert_eq!(velocity.east, MillimetresPerSecond(54));
//! assert_eq!(velocity.encode(), data);
//! # Ok::<(), network::DecodeError>(())
//! ```
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

mod geodetic;
mod message;

pub use message::{DecodeError, Message, Signal};

/// Nodes, quantities, enumerations and messages of `uagv.dbc`.
///
/// A quantity is a whole number of its unit or of a fraction of it, as its name
/// says; the offsets by which the frames shift some of them are taken off.
#[allow(unused_parens, reason = "written by a program")]
pub mod messages {
    use ttcan::{Frame, Id};

    use crate::message::{DecodeError, Message, Signal};

    include!(concat!(env!("OUT_DIR"), "/messages.rs"));
}

/// The nodes and the system matrix of `uagv.dbc`, for `ttcan`.
pub mod matrix {
    use ttcan::{Event, Id, MatrixConfig, Micros, NodeId, ReferenceFormat, SystemMatrix, Window};

    include!(concat!(env!("OUT_DIR"), "/matrix.rs"));
}
