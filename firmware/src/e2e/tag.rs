//! Message authentication code of nodes with a key.
//!
//! SipHash-2-4 (Aumasson and Bernstein, SipHash: a fast short-input PRF, 2012) over 14 bytes:
//! D0..D7 with all bits of the tag zero, the system time of the basic cycle in ms, and the
//! identifier, least significant byte first. The tag in a frame is the part of the 64 bits of the
//! code that has room there: the bits of [`mask`], each in its own place.

use network::Message;

use super::{CHECK, COUNTER, Key};

/// The bits of a message that carry its tag, D0 least significant: the two bytes of the protection,
/// and the bits of no signal.
pub const fn mask<M: Message>() -> u64 {
    M::FREE | 0xFF << (8 * COUNTER) | 0xFF << (8 * CHECK)
}

/// The tag of the message with this identifier and these data in the basic cycle that began at
/// system time `time`, ms, within `mask`.
#[inline]
pub fn tag(key: &Key, id: u16, time: u32, data: u64, mask: u64) -> u64 {
    key.code(data & !mask, time, id) & mask
}
