//! Frames of the data link layer.

use embedded_can::{ExtendedId, Id, StandardId};

/// A classical CAN data or remote frame (ISO 11898-1, clause 10.4).
///
/// The data length code is stored as it is on the wire, 0 to 15. Codes above 8 mean eight data
/// bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Frame {
    id: Id,
    remote: bool,
    dlc: u8,
    data: [u8; 8],
}

impl Frame {
    /// A data frame; `None` if `data` has more than eight bytes.
    #[must_use]
    pub fn new_data(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        Self::from_parts(id.into(), false, u8::try_from(data.len()).ok()?, data)
    }

    /// A remote frame that asks for `dlc` bytes; `None` if `dlc` is above 15.
    #[must_use]
    pub fn new_remote(id: impl Into<Id>, dlc: u8) -> Option<Self> {
        Self::from_parts(id.into(), true, dlc, &[])
    }

    /// A frame with any data length code of 0 to 15; missing data bytes are zero. `None` if
    /// `dlc` is above 15 or more bytes are given than the code announces (eight at most, none for
    /// a remote frame).
    #[must_use]
    pub fn from_parts(id: Id, remote: bool, dlc: u8, data: &[u8]) -> Option<Self> {
        let room = if remote { 0 } else { usize::from(dlc.min(8)) };
        if dlc > 15 || data.len() > room {
            return None;
        }
        let mut bytes = [0; 8];
        bytes[..data.len()].copy_from_slice(data);
        Some(Self {
            id,
            remote,
            dlc,
            data: bytes,
        })
    }

    /// Shorthand for a data frame with an 11-bit identifier; `None` if the identifier is above
    /// 0x7FF or the data longer than eight bytes.
    #[must_use]
    pub fn standard(id: u16, data: &[u8]) -> Option<Self> {
        Self::new_data(StandardId::new(id)?, data)
    }

    /// Shorthand for a data frame with a 29-bit identifier; `None` if the identifier is above
    /// 0x1FFF_FFFF or the data longer than eight bytes.
    #[must_use]
    pub fn extended(id: u32, data: &[u8]) -> Option<Self> {
        Self::new_data(ExtendedId::new(id)?, data)
    }

    /// The identifier.
    #[must_use]
    pub const fn id(&self) -> Id {
        self.id
    }

    /// Whether this is a remote frame, which carries no data.
    #[must_use]
    pub const fn is_remote(&self) -> bool {
        self.remote
    }

    /// The data length code as sent, 0 to 15.
    #[must_use]
    pub const fn dlc(&self) -> u8 {
        self.dlc
    }

    /// The data bytes: none for a remote frame, else the smaller of the code and eight.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        let len = if self.remote {
            0
        } else {
            usize::from(self.dlc.min(8))
        };
        &self.data[..len]
    }
}

impl embedded_can::Frame for Frame {
    fn new(id: impl Into<Id>, data: &[u8]) -> Option<Self> {
        Self::new_data(id, data)
    }

    fn new_remote(id: impl Into<Id>, dlc: usize) -> Option<Self> {
        Self::new_remote(id, u8::try_from(dlc).ok()?)
    }

    fn is_extended(&self) -> bool {
        matches!(self.id, Id::Extended(_))
    }

    fn is_remote_frame(&self) -> bool {
        self.remote
    }

    fn is_data_frame(&self) -> bool {
        !self.remote
    }

    fn id(&self) -> Id {
        self.id
    }

    fn dlc(&self) -> usize {
        usize::from(self.dlc)
    }

    fn data(&self) -> &[u8] {
        Frame::data(self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_a_frame_is_refused() {
        assert_eq!(Frame::standard(0x800, &[]), None);
        assert_eq!(Frame::extended(0x2000_0000, &[]), None);
        assert_eq!(Frame::standard(0, &[0; 9]), None);
        assert_eq!(Frame::new_remote(StandardId::ZERO, 16), None);
        let id = Id::Standard(StandardId::ZERO);
        assert_eq!(Frame::from_parts(id, false, 1, &[0; 2]), None);
        assert_eq!(Frame::from_parts(id, true, 1, &[0]), None);
    }

    #[test]
    fn codes_above_eight_stand_for_eight_bytes() {
        let id = Id::Standard(StandardId::ZERO);
        let frame = Frame::from_parts(id, false, 15, &[1]);
        assert_eq!(
            frame.map(|frame| (frame.dlc(), frame.data().to_vec())),
            Some((15, vec![1, 0, 0, 0, 0, 0, 0, 0]))
        );
    }
}
