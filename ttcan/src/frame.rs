//! Classical CAN data frames.

use crate::id::Id;

/// A classical CAN data frame of 0 to 8 bytes.
///
/// A time-triggered schedule has no windows for remote frames: do not pass them
/// to a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Frame {
    id: Id,
    len: u8,
    data: [u8; 8],
}

/// The data given for a frame is longer than 8 bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLong;

impl core::fmt::Display for TooLong {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("a CAN frame carries at most 8 bytes")
    }
}

impl core::error::Error for TooLong {}

impl Frame {
    /// A frame with `data`, at most 8 bytes.
    pub fn new(id: Id, data: &[u8]) -> Result<Self, TooLong> {
        let mut bytes = [0; 8];
        bytes
            .get_mut(..data.len())
            .ok_or(TooLong)?
            .copy_from_slice(data);
        Ok(Self {
            id,
            len: data.len() as u8,
            data: bytes,
        })
    }

    /// A frame from the buffer of a CAN controller: the first `len` bytes of `data`.
    /// A data length code above 8 means 8 bytes (ISO 11898-1).
    pub const fn from_parts(id: Id, len: u8, data: [u8; 8]) -> Self {
        Self {
            id,
            len: if len > 8 { 8 } else { len },
            data,
        }
    }

    /// The identifier.
    pub const fn id(&self) -> Id {
        self.id
    }

    /// Number of data bytes, 0 to 8.
    pub const fn len(&self) -> u8 {
        self.len
    }

    /// Whether the frame carries no data.
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// The data bytes.
    pub fn data(&self) -> &[u8] {
        self.data.get(..usize::from(self.len)).unwrap_or(&self.data)
    }

    /// The whole buffer; bytes from [`Frame::len`] on have no meaning.
    pub const fn buffer(&self) -> [u8; 8] {
        self.data
    }
}
