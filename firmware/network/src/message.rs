//! What all messages have in common.

use core::fmt;

use ttcan::Frame;

/// A message of the network: a typed value on one side, data bytes on the other.
///
/// Encoding and decoding are shifts and masks over fixed arrays: no loop, no
/// allocation, no panic, a few dozen cycles.
pub trait Message: Sized + Copy {
    /// Identifier, 11 bits.
    const ID: u16;
    /// Name in the network file.
    const NAME: &'static str;
    /// Data bytes that [`encode`](Self::encode) makes, 0..=8.
    const LENGTH: u8;
    /// Fewest data bytes that [`decode`](Self::decode) accepts. Missing bytes, up to
    /// [`LENGTH`](Self::LENGTH), read as zero.
    const SHORTEST: u8;
    /// The bits of the data that belong to no signal, D0 least significant.
    const FREE: u64;
    /// The type that names the nodes of the network.
    type Node: Copy + fmt::Debug;
    /// The one node that sends it.
    const SENDER: Self::Node;
    /// Signals in the order of the network file.
    const SIGNALS: &'static [Signal];
    /// An array of [`LENGTH`](Self::LENGTH) bytes.
    type Bytes: AsRef<[u8]> + Copy;

    /// The data bytes. A value outside its signal's range is sent as the nearest
    /// limit; bits that belong to no signal are zero.
    fn encode(&self) -> Self::Bytes;

    /// The whole frame: [`encode`](Self::encode) under [`ID`](Self::ID).
    fn frame(&self) -> Frame;

    /// Reads the data bytes. Bits that belong to no signal are ignored.
    ///
    /// # Errors
    ///
    /// The number of bytes is not the message's, or a signal is outside its range.
    fn decode(data: &[u8]) -> Result<Self, DecodeError>;

    /// Shows each signal with its count, in the order of the network file.
    ///
    /// For displays and logs; a flag counts 0 or 1, an enumeration its number.
    fn visit(&self, visitor: &mut dyn FnMut(&'static Signal, i64));
}

/// What the network file says about a signal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Signal {
    /// Name in the network file.
    pub name: &'static str,
    /// Physical unit, or empty.
    pub unit: &'static str,
    /// Physical size of one count, in `unit`.
    pub factor: f64,
    /// Least count.
    pub least: i64,
    /// Greatest count.
    pub greatest: i64,
}

/// Why data bytes cannot be decoded.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DecodeError {
    /// No message of the network has this identifier.
    Identifier,
    /// The number of data bytes is not the message's.
    Length,
    /// This signal is outside its range or has none of its named values.
    Range(&'static Signal),
}

impl fmt::Display for DecodeError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Identifier => f.write_str("the identifier is none of the network's"),
            Self::Length => f.write_str("the number of data bytes is not the message's"),
            Self::Range(signal) => {
                f.write_str("the signal ")?;
                f.write_str(signal.name)?;
                f.write_str(" is outside its range")
            }
        }
    }
}

impl core::error::Error for DecodeError {}
