//! Frames as bits on the wire: field order, CRC and bit stuffing, for both encoding and decoding.

use embedded_can::{ExtendedId, Id, StandardId};

use crate::Frame;

/// The level of the bus or of one node's output; dominant wins.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Level {
    /// Logical 0.
    Dominant,
    /// Logical 1, the level of an undriven bus.
    Recessive,
}

impl Level {
    /// The level of a logical bit.
    #[must_use]
    pub const fn from_bit(one: bool) -> Self {
        if one { Self::Recessive } else { Self::Dominant }
    }

    /// Whether the level is recessive, a logical 1.
    #[must_use]
    pub const fn is_recessive(self) -> bool {
        matches!(self, Self::Recessive)
    }

    /// The resulting level of a bus that is driven with both.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self::from_bit(self.is_recessive() && other.is_recessive())
    }

    /// The other level.
    #[must_use]
    pub const fn inverted(self) -> Self {
        Self::from_bit(!self.is_recessive())
    }
}

/// Bits after the CRC sequence: CRC delimiter, acknowledge slot and delimiter, end of frame.
pub(crate) const TAIL_BITS: usize = 10;

/// Bits between two frames (ISO 11898-1, clause 10.4.6).
pub const INTERMISSION_BITS: u32 = 3;

/// Number of equal bits after which a stuff bit of the other level is inserted.
const STUFF_RUN: u8 = 5;

/// One step of the CRC-15 of ISO 11898-1 (polynomial 0x4599). The crate `crc` only processes whole
/// bytes, but this CRC covers a number of bits that need not be a multiple of eight.
const fn crc15_step(crc: u16, bit: bool) -> u16 {
    let feedback = ((crc >> 14) & 1 == 1) != bit;
    let shifted = (crc << 1) & 0x7FFF;
    if feedback { shifted ^ 0x4599 } else { shifted }
}

/// CRC sequence over unstuffed bits, from start of frame to the last data bit.
#[must_use]
pub fn crc15(bits: &[Level]) -> u16 {
    bits.iter()
        .fold(0, |crc, bit| crc15_step(crc, bit.is_recessive()))
}

/// A frame as its transmitter drives it, from start of frame to end of frame.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WireFrame {
    levels: Vec<Level>,
    stuff_bits: usize,
}

impl WireFrame {
    /// Encodes a frame: fields, CRC and stuff bits. The acknowledge slot is recessive, as the
    /// transmitter sends it.
    #[must_use]
    pub fn encode(frame: &Frame) -> Self {
        let mut plain = Vec::with_capacity(128);
        let mut push = |value: u32, width: u32| {
            for shift in (0..width).rev() {
                plain.push(Level::from_bit((value >> shift) & 1 == 1));
            }
        };
        push(0, 1);
        let remote = u32::from(frame.is_remote());
        match frame.id() {
            Id::Standard(id) => {
                push(u32::from(id.as_raw()), 11);
                push(remote, 1);
                push(0, 2);
            }
            Id::Extended(id) => {
                push(id.as_raw() >> 18, 11);
                push(0b11, 2);
                push(id.as_raw() & 0x3_FFFF, 18);
                push(remote, 1);
                push(0, 2);
            }
        }
        push(u32::from(frame.dlc()), 4);
        for byte in frame.data() {
            push(u32::from(*byte), 8);
        }
        let crc = crc15(&plain);
        for shift in (0..15).rev() {
            plain.push(Level::from_bit((crc >> shift) & 1 == 1));
        }

        let mut levels = Vec::with_capacity(plain.len() + plain.len() / 4 + TAIL_BITS);
        let mut run = 0;
        let mut last = None;
        for level in &plain {
            run = if last == Some(*level) { run + 1 } else { 1 };
            last = Some(*level);
            levels.push(*level);
            if run == STUFF_RUN {
                levels.push(level.inverted());
                last = Some(level.inverted());
                run = 1;
            }
        }
        let stuff_bits = levels.len() - plain.len();
        levels.resize(levels.len() + TAIL_BITS, Level::Recessive);
        Self { levels, stuff_bits }
    }

    /// The levels, start of frame first.
    #[must_use]
    pub fn levels(&self) -> &[Level] {
        &self.levels
    }

    /// Length in bits from start of frame to the last bit of end of frame, stuff bits included,
    /// intermission not.
    #[must_use]
    pub fn bits(&self) -> usize {
        self.levels.len()
    }

    /// Number of stuff bits.
    #[must_use]
    pub fn stuff_bits(&self) -> usize {
        self.stuff_bits
    }

    /// Index of the acknowledge slot, counted from start of frame as 0.
    #[must_use]
    pub fn acknowledge_slot(&self) -> usize {
        self.levels.len() - TAIL_BITS + 1
    }
}

/// The field that a bit belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Field {
    /// Start of frame.
    Start,
    /// Identifier, substitute remote request, identifier extension, remote request.
    Arbitration,
    /// Reserved bits and data length code.
    Control,
    /// Data bytes.
    Data,
    /// CRC sequence.
    Crc,
    /// A stuff bit.
    Stuff {
        /// True if the bit before it belongs to the arbitration field.
        in_arbitration: bool,
    },
    /// CRC delimiter.
    CrcDelimiter,
    /// Acknowledge slot.
    AcknowledgeSlot,
    /// Acknowledge delimiter.
    AcknowledgeDelimiter,
    /// Bit 1 to 7 of end of frame.
    EndOfFrame(u8),
    /// After the last bit of end of frame.
    Done,
}

/// The bit after five equal bits had the same level, but must be a stuff bit of the other level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("six equal bits in a row")]
pub struct StuffError;

/// Decodes a frame bit by bit.
///
/// The decoder does not check the levels of the fixed-form tail. The receiver must do so;
/// [`Decoder::next_field`] tells it which field comes next.
#[derive(Clone, Debug)]
pub struct Decoder {
    /// The unstuffed bits so far, the newest in bit 0; at most 118.
    plain: u128,
    count: u16,
    run: u8,
    last: Level,
    crc: u16,
    extended: bool,
    remote: bool,
    dlc: u8,
    /// Number of unstuffed bits up to the end of the CRC sequence, once known.
    body: Option<u16>,
    tail: u8,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// A decoder that expects a start of frame.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            plain: 0,
            count: 0,
            run: 0,
            last: Level::Recessive,
            crc: 0,
            extended: false,
            remote: false,
            dlc: 0,
            body: None,
            tail: 0,
        }
    }

    fn body_complete(&self) -> bool {
        self.body == Some(self.count) && self.run < STUFF_RUN
    }

    fn field_of(&self, index: u16) -> Field {
        let control = if self.extended { 33 } else { 14 };
        match index {
            0 => Field::Start,
            1..=13 => Field::Arbitration,
            _ if index < control => Field::Arbitration,
            _ if index < control + self.control_bits() => Field::Control,
            _ => match self.body {
                Some(body) if index >= body - 15 => Field::Crc,
                _ => Field::Data,
            },
        }
    }

    const fn control_bits(&self) -> u16 {
        if self.extended { 6 } else { 5 }
    }

    /// The field that the next bit will belong to.
    #[must_use]
    pub fn next_field(&self) -> Field {
        if self.body_complete() {
            return match self.tail {
                0 => Field::CrcDelimiter,
                1 => Field::AcknowledgeSlot,
                2 => Field::AcknowledgeDelimiter,
                3..=9 => Field::EndOfFrame(self.tail - 2),
                _ => Field::Done,
            };
        }
        if self.run == STUFF_RUN {
            return Field::Stuff {
                in_arbitration: matches!(
                    self.field_of(self.count - 1),
                    Field::Start | Field::Arbitration
                ),
            };
        }
        self.field_of(self.count)
    }

    /// Processes the next bit.
    ///
    /// # Errors
    /// [`StuffError`] if a stuff bit is missing. The frame cannot be decoded any further then.
    pub fn push(&mut self, level: Level) -> Result<(), StuffError> {
        if self.body_complete() {
            self.tail = self.tail.saturating_add(1);
            return Ok(());
        }
        if self.run == STUFF_RUN {
            if level == self.last {
                return Err(StuffError);
            }
            self.last = level;
            self.run = 1;
            return Ok(());
        }
        self.run = if self.count > 0 && level == self.last {
            self.run + 1
        } else {
            1
        };
        self.last = level;
        self.plain = (self.plain << 1) | u128::from(level.is_recessive());
        self.crc = crc15_step(self.crc, level.is_recessive());
        self.count += 1;
        let remote_bit = if self.extended { 33 } else { 13 };
        if self.count == remote_bit {
            self.remote = level.is_recessive();
        }
        if self.count == 14 {
            self.extended = level.is_recessive();
        }
        let header = if self.extended { 39 } else { 19 };
        if self.count == header && self.body.is_none() {
            self.dlc = (self.plain & 0xF) as u8;
            let bytes = if self.remote { 0 } else { self.dlc.min(8) };
            self.body = Some(header + 8 * u16::from(bytes) + 15);
        }
        Ok(())
    }

    /// True if the received CRC sequence equals the computed one; valid from the CRC delimiter on.
    #[must_use]
    pub const fn crc_matches(&self) -> bool {
        // The remainder of a message followed by its own CRC is zero.
        self.crc == 0
    }

    /// The frame, once the CRC sequence is complete.
    #[must_use]
    pub fn frame(&self) -> Option<Frame> {
        let body = self.body?;
        if !self.body_complete() {
            return None;
        }
        let bits = |index: u16, width: u16| -> u32 {
            let value = self.plain >> (body - index - width);
            (value & ((1 << width) - 1)) as u32
        };
        let id = if self.extended {
            Id::Extended(ExtendedId::new((bits(1, 11) << 18) | bits(14, 18))?)
        } else {
            Id::Standard(StandardId::new(bits(1, 11) as u16)?)
        };
        let header = if self.extended { 39 } else { 19 };
        let bytes = usize::from((body - 15 - header) / 8);
        let mut data = [0; 8];
        for (index, byte) in data.iter_mut().enumerate().take(bytes) {
            *byte = bits(header + 8 * index as u16, 8) as u8;
        }
        Frame::from_parts(id, self.remote, self.dlc, &data[..bytes])
    }
}
