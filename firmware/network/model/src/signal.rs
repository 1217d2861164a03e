//! A signal: its bits in the data field and its meaning.

/// A signal of a message.
///
/// Its value on the wire is the *raw* number, its physical value is
/// raw * `factor` + `offset`. Programs work with *counts*: whole numbers of
/// `factor`, offset included, so that physical = count * `factor`.
#[derive(Debug, Clone, PartialEq)]
pub struct Signal {
    /// Name as in the file.
    pub name: String,
    /// Comment, or empty.
    pub comment: String,
    /// Start bit as in the file: of the least significant bit for little-endian,
    /// of the most significant bit for big-endian signals; bit 0 is the lowest
    /// of byte 0, bit 8 the lowest of byte 1.
    pub start_bit: u16,
    /// Size in bits, 1..=64.
    pub size: u8,
    /// Byte order.
    pub byte_order: ByteOrder,
    /// Whether the raw number is two's complement.
    pub signed: bool,
    /// Physical size of one count.
    pub factor: f64,
    /// Physical value of raw zero.
    pub offset: f64,
    /// Least physical value.
    pub min: f64,
    /// Greatest physical value.
    pub max: f64,
    /// Physical unit, or empty.
    pub unit: String,
    /// Nodes that use it.
    pub receivers: Vec<String>,
    /// Name of the value table that lists its values, if one does.
    pub values: Option<String>,
    /// Line of the file, from 1.
    pub line: Option<usize>,
}

/// Byte order of a signal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ByteOrder {
    /// Least significant byte first (Intel).
    Little,
    /// Most significant byte first (Motorola).
    Big,
}

/// A run of a signal's bits inside one byte.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Piece {
    /// Byte of the data field.
    pub byte: u8,
    /// Lowest bit of the run in the byte.
    pub bit: u8,
    /// Bits in the run, 1..=8.
    pub bits: u8,
    /// Lowest bit of the run in the raw number.
    pub raw_bit: u8,
}

impl Signal {
    /// Position in the data field of bit `index` of the raw number, as byte and bit.
    ///
    /// Byte numbers of 8 and more mean that the signal leaves the data field;
    /// `None` means that it begins before it.
    pub fn position(&self, index: u8) -> Option<(u16, u8)> {
        let flat = match self.byte_order {
            ByteOrder::Little => self.start_bit.checked_add(u16::from(index))?,
            ByteOrder::Big => {
                // Counted in reading order, byte by byte from the highest bit,
                // big-endian signals are contiguous.
                let reading = (self.start_bit / 8) * 8 + (7 - self.start_bit % 8);
                let reading = reading + u16::from(self.size.checked_sub(1)?) - u16::from(index);
                (reading / 8) * 8 + (7 - reading % 8)
            }
        };
        Some((flat / 8, (flat % 8) as u8))
    }

    /// The runs of bits that make up the signal, from the lowest bit of the raw number.
    pub fn pieces(&self) -> Vec<Piece> {
        let mut pieces: Vec<Piece> = Vec::new();
        for index in 0..self.size {
            let Some((byte, bit)) = self.position(index) else {
                continue;
            };
            let byte = byte as u8;
            match pieces.last_mut() {
                Some(last) if last.byte == byte && last.bit + last.bits == bit => last.bits += 1,
                _ => pieces.push(Piece {
                    byte,
                    bit,
                    bits: 1,
                    raw_bit: index,
                }),
            }
        }
        pieces
    }

    /// Reads the raw number, bit by bit; bytes that are missing read as zero.
    ///
    /// Written to be obviously right, not fast: tests compare the generated code with it.
    pub fn extract(&self, data: &[u8]) -> i128 {
        let mut raw: i128 = 0;
        for index in 0..self.size {
            if let Some((byte, bit)) = self.position(index) {
                let byte = data.get(usize::from(byte)).copied().unwrap_or(0);
                raw |= i128::from(byte >> bit & 1) << index;
            }
        }
        if self.signed && raw >> (self.size - 1) & 1 == 1 {
            raw -= 1 << self.size;
        }
        raw
    }

    /// Writes the raw number, bit by bit; bits beyond the data are dropped.
    pub fn insert(&self, data: &mut [u8], raw: i128) {
        for index in 0..self.size {
            if let Some((byte, bit)) = self.position(index)
                && let Some(byte) = data.get_mut(usize::from(byte))
            {
                *byte = *byte & !(1 << bit) | ((raw >> index & 1) as u8) << bit;
            }
        }
    }

    /// Offset in counts: what to add to the raw number.
    ///
    /// `None` when the offset is no whole number of factors.
    pub fn offset_counts(&self) -> Option<i128> {
        whole(self.offset / self.factor)
    }

    /// Least and greatest count, from the physical limits of the file.
    ///
    /// `None` when a limit is no whole number of factors.
    pub fn count_range(&self) -> Option<(i128, i128)> {
        Some((
            whole(self.min / self.factor)?,
            whole(self.max / self.factor)?,
        ))
    }

    /// Least and greatest raw number that the size and the sign allow.
    pub fn raw_range(&self) -> (i128, i128) {
        if self.signed {
            (-(1 << (self.size - 1)), (1 << (self.size - 1)) - 1)
        } else {
            (0, (1 << self.size) - 1)
        }
    }

    /// Physical value of a raw number.
    pub fn physical(&self, raw: i128) -> f64 {
        raw as f64 * self.factor + self.offset
    }
}

/// The integer that `value` is, apart from the rounding error of dividing decimals; `None` if
/// it is not one.
fn whole(value: f64) -> Option<i128> {
    let rounded = value.round();
    let tolerance = 1e-9 * rounded.abs().max(1.0);
    (value.is_finite() && (value - rounded).abs() <= tolerance).then_some(rounded as i128)
}
