//! The length of a frame on the wire.

/// Longest length of a data frame with an 11-bit identifier, in bit times.
///
/// Counts worst-case stuffing and the three bits of interframe space: 55 + 10 n
/// for n data bytes (Davis, Burns, Bril and Lukkien, "Controller Area Network
/// (CAN) schedulability analysis: refuted, revisited and revised", 2007, eq. 3).
/// `data_bytes` is 0..=8.
pub const fn worst_case_bits(data_bytes: u8) -> u32 {
    55 + 10 * data_bytes as u32
}

/// Shortest length of such a frame: without stuffing, with the interframe space.
pub(crate) const fn shortest_bits(data_bytes: u8) -> u32 {
    47 + 8 * data_bytes as u32
}
