//! The Swift Binary Protocol of the satellite receiver: framing and the messages that the
//! vehicle uses.
//!
//! Frame: `55 | type u16 | sender u16 | length u8 | payload | CRC u16`, little-endian. The
//! parser takes bytes as they arrive and looks for frames in short steps. A damaged frame does
//! not cost another one, because the bytes after its preamble are parsed again.

mod crc;
mod framing;
mod message;

pub use crc::crc16;
pub use framing::{CAPACITY, Counters, Frame, LOT, MAX_PAYLOAD, Parser, Progress};
pub use message::{
    Fix, Heading, Message, Orientation, PositionLlh, PositionNed, Time, VelocityNed, decode,
    orientation,
};
