//! Swift Binary Protocol: framing and the messages that a Piksi sends with every solution.
//!
//! Layouts: Swift Navigation, "Swift Binary Protocol specification", message types as numbered
//! there; little-endian throughout. The `sbp` crate decodes everything written here in the tests.

/// First byte of every frame.
pub const PREAMBLE: u8 = 0x55;

/// Bytes of a frame besides its payload.
pub const OVERHEAD: usize = 8;

/// CRC-16/XMODEM: polynomial 0x1021, initial value 0, not reflected.
#[must_use]
pub fn crc(bytes: &[u8]) -> u16 {
    bytes.iter().fold(0, |crc, byte| {
        (0..8).fold(crc ^ (u16::from(*byte) << 8), |crc, _| {
            if crc & 0x8000 == 0 {
                crc << 1
            } else {
                crc << 1 ^ 0x1021
            }
        })
    })
}

/// A frame: preamble, type, sender, length, payload, CRC over type to payload.
///
/// # Panics
/// When the payload is longer than the 255 bytes that the length field can say.
#[must_use]
pub fn frame(message_type: u16, sender: u16, payload: &[u8]) -> Vec<u8> {
    let length = u8::try_from(payload.len()).expect("an SBP payload has at most 255 bytes");
    let mut bytes = Vec::with_capacity(payload.len() + OVERHEAD);
    bytes.push(PREAMBLE);
    bytes.extend(message_type.to_le_bytes());
    bytes.extend(sender.to_le_bytes());
    bytes.push(length);
    bytes.extend(payload);
    let crc = crc(&bytes[1..]);
    bytes.extend(crc.to_le_bytes());
    bytes
}

/// Three coordinates, with the fields that every position and velocity message shares.
#[derive(Copy, Clone, Debug, PartialEq)]
pub struct Vector<T> {
    /// Time of week of the solution, milliseconds.
    pub tow: u32,
    /// Components, in the order of the message.
    pub components: [T; 3],
    /// Estimated standard deviations: one number, or horizontal and vertical. Millimetres or
    /// millimetres per second.
    pub accuracy: Accuracy,
    /// Satellites used.
    pub satellites: u8,
    /// Fix mode and further bits.
    pub flags: u8,
}

/// Accuracy fields of a message.
#[derive(Copy, Clone, Debug, PartialEq, Eq)]
pub enum Accuracy {
    /// One number for all components.
    Overall(u16),
    /// Horizontal, vertical.
    Split(u16, u16),
}

/// A message of the receiver.
#[derive(Copy, Clone, Debug, PartialEq)]
pub enum Message {
    /// 0x0102: week, time of week in milliseconds, remainder in nanoseconds, flags.
    GpsTime {
        /// GPS week.
        week: u16,
        /// Time of week, milliseconds.
        tow: u32,
        /// What the rounding to milliseconds left, nanoseconds.
        residual: i32,
        /// Time source: 0 none, 1 solution.
        flags: u8,
    },
    /// 0x0103: the same instant as a calendar date.
    UtcTime {
        /// Time source as in [`Message::GpsTime`].
        flags: u8,
        /// Time of week, milliseconds.
        tow: u32,
        /// Year.
        year: u16,
        /// Month, day, hours, minutes, seconds.
        fields: [u8; 5],
        /// Nanoseconds.
        nanoseconds: u32,
    },
    /// 0x0208: dilutions of precision (geometric, position, time, horizontal, vertical), 0.01.
    Dops {
        /// Time of week, milliseconds.
        tow: u32,
        /// The five dilutions.
        values: [u16; 5],
        /// 0 invalid, else the fix mode.
        flags: u8,
    },
    /// 0x0209: earth-centred position, metres.
    PositionEcef(Vector<f64>),
    /// 0x020A: latitude, longitude (degrees), height (metres).
    PositionLlh(Vector<f64>),
    /// 0x020B: earth-centred baseline, millimetres.
    BaselineEcef(Vector<i32>),
    /// 0x020C: baseline north, east, down, millimetres.
    BaselineNed(Vector<i32>),
    /// 0x020D: earth-centred velocity, millimetres per second.
    VelocityEcef(Vector<i32>),
    /// 0x020E: velocity north, east, down, millimetres per second.
    VelocityNed(Vector<i32>),
    /// 0x020F: direction from base to rover, milli-degrees.
    BaselineHeading {
        /// Time of week, milliseconds.
        tow: u32,
        /// Clockwise from north.
        heading: u32,
        /// Satellites used.
        satellites: u8,
        /// Fix mode.
        flags: u8,
    },
    /// 0x0210: age of the base station's corrections, tenths of a second.
    AgeOfCorrections {
        /// Time of week, milliseconds.
        tow: u32,
        /// Age; 0xFFFF without corrections.
        age: u16,
    },
    /// 0xFFFF: system flags.
    Heartbeat(u32),
}

fn vector(head: &Vector<impl Copy>, components: impl IntoIterator<Item = u8>) -> Vec<u8> {
    let mut bytes = head.tow.to_le_bytes().to_vec();
    bytes.extend(components);
    match head.accuracy {
        Accuracy::Overall(all) => bytes.extend(all.to_le_bytes()),
        Accuracy::Split(horizontal, vertical) => {
            bytes.extend(horizontal.to_le_bytes());
            bytes.extend(vertical.to_le_bytes());
        }
    }
    bytes.extend([head.satellites, head.flags]);
    bytes
}

impl Message {
    /// Number of the message type.
    #[must_use]
    pub const fn message_type(&self) -> u16 {
        match self {
            Self::GpsTime { .. } => 0x0102,
            Self::UtcTime { .. } => 0x0103,
            Self::Dops { .. } => 0x0208,
            Self::PositionEcef(_) => 0x0209,
            Self::PositionLlh(_) => 0x020A,
            Self::BaselineEcef(_) => 0x020B,
            Self::BaselineNed(_) => 0x020C,
            Self::VelocityEcef(_) => 0x020D,
            Self::VelocityNed(_) => 0x020E,
            Self::BaselineHeading { .. } => 0x020F,
            Self::AgeOfCorrections { .. } => 0x0210,
            Self::Heartbeat(_) => 0xFFFF,
        }
    }

    /// The payload.
    #[must_use]
    pub fn payload(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        match *self {
            Self::GpsTime {
                week,
                tow,
                residual,
                flags,
            } => {
                bytes.extend(week.to_le_bytes());
                bytes.extend(tow.to_le_bytes());
                bytes.extend(residual.to_le_bytes());
                bytes.push(flags);
            }
            Self::UtcTime {
                flags,
                tow,
                year,
                fields,
                nanoseconds,
            } => {
                bytes.push(flags);
                bytes.extend(tow.to_le_bytes());
                bytes.extend(year.to_le_bytes());
                bytes.extend(fields);
                bytes.extend(nanoseconds.to_le_bytes());
            }
            Self::Dops { tow, values, flags } => {
                bytes.extend(tow.to_le_bytes());
                bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
                bytes.push(flags);
            }
            Self::PositionEcef(v) | Self::PositionLlh(v) => {
                bytes = vector(&v, v.components.iter().flat_map(|c| c.to_le_bytes()));
            }
            Self::BaselineEcef(v)
            | Self::BaselineNed(v)
            | Self::VelocityEcef(v)
            | Self::VelocityNed(v) => {
                bytes = vector(&v, v.components.iter().flat_map(|c| c.to_le_bytes()));
            }
            Self::BaselineHeading {
                tow,
                heading,
                satellites,
                flags,
            } => {
                bytes.extend(tow.to_le_bytes());
                bytes.extend(heading.to_le_bytes());
                bytes.extend([satellites, flags]);
            }
            Self::AgeOfCorrections { tow, age } => {
                bytes.extend(tow.to_le_bytes());
                bytes.extend(age.to_le_bytes());
            }
            Self::Heartbeat(flags) => bytes.extend(flags.to_le_bytes()),
        }
        bytes
    }

    /// The message as a frame from `sender`.
    #[must_use]
    pub fn frame(&self, sender: u16) -> Vec<u8> {
        frame(self.message_type(), sender, &self.payload())
    }
}
