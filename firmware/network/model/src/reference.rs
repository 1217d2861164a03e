//! The fields of a reference message that belong to the protocol.

use crate::{
    network::Message,
    signal::{ByteOrder, Signal},
};

/// Where the protocol's fields stand in a reference message, in bytes.
///
/// They are found by the names of their signals: `CycleCount` with
/// `Discontinuity` and `NextIsGap` in the control byte, and, for global time,
/// `SystemTime` and `PreviousStart`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reference {
    /// Number of bytes in front that belong to the application.
    pub application: u8,
    /// First of four bytes, big-endian: global time in milliseconds.
    pub coarse: Option<u8>,
    /// Control byte: next-is-gap, discontinuity, cycle count.
    pub control: u8,
    /// First of two bytes, big-endian: start of the previous reference.
    pub mark: Option<u8>,
}

impl Reference {
    /// The layout of a reference message; `None` when it is not one that the
    /// protocol can write.
    pub fn of(message: &Message) -> Option<Reference> {
        let control = place(find(message, "CycleCount")?, 6, 0)?;
        for (name, bit) in [("Discontinuity", 6), ("NextIsGap", 7)] {
            if place(find(message, name)?, 1, bit)? != control {
                return None;
            }
        }
        let coarse = match find(message, "SystemTime") {
            Some(signal) => Some(big_endian(signal, 32)?),
            None => None,
        };
        let mark = match find(message, "PreviousStart") {
            Some(signal) => Some(big_endian(signal, 16)?),
            None => None,
        };
        Some(Reference {
            application: coarse.unwrap_or(control),
            coarse,
            control,
            mark,
        })
    }
}

fn find<'m>(message: &'m Message, name: &str) -> Option<&'m Signal> {
    message.signals.iter().find(|signal| signal.name == name)
}

/// The byte of a signal of this size that begins at this bit of it.
fn place(signal: &Signal, size: u8, bit: u16) -> Option<u8> {
    let right = signal.size == size
        && signal.byte_order == ByteOrder::Little
        && signal.start_bit % 8 == bit;
    right.then_some((signal.start_bit / 8) as u8)
}

/// The first byte of a big-endian signal of this size that fills its bytes.
fn big_endian(signal: &Signal, size: u8) -> Option<u8> {
    let right = signal.size == size
        && signal.byte_order == ByteOrder::Big
        && signal.start_bit % 8 == 7
        && !signal.signed;
    right.then_some((signal.start_bit / 8) as u8)
}
