//! The messages that the vehicle uses, current and deprecated.
//!
//! The receiver's firmware of 2016-17 sent the deprecated types: same layouts, other meaning
//! of the flags. What a flag says therefore depends on the message type.

use super::Frame;

/// Quality of a position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Fix {
    /// No valid position.
    #[default]
    None,
    /// Single point position.
    Single,
    /// Differential code solution.
    Differential,
    /// Carrier phase with float ambiguities.
    Float,
    /// Carrier phase with fixed ambiguities: centimetres.
    Fixed,
    /// Dead reckoning.
    DeadReckoning,
    /// Satellite-based augmentation.
    Augmented,
}

impl Fix {
    /// Flags of the current messages: 0 invalid, 1 single, 2 DGNSS, 3 float, 4 fixed, 5 dead
    /// reckoning, 6 SBAS, in the three low bits.
    const fn current(flags: u8) -> Self {
        match flags & 0b111 {
            1 => Self::Single,
            2 => Self::Differential,
            3 => Self::Float,
            4 => Self::Fixed,
            5 => Self::DeadReckoning,
            6 => Self::Augmented,
            _ => Self::None,
        }
    }

    /// Flags of the deprecated geodetic position: 0 single, 1 fixed, 2 float.
    const fn deprecated_llh(flags: u8) -> Self {
        match flags & 0b111 {
            0 => Self::Single,
            1 => Self::Fixed,
            2 => Self::Float,
            _ => Self::None,
        }
    }

    /// Flags of the deprecated baseline: 0 float, 1 fixed.
    const fn deprecated_baseline(flags: u8) -> Self {
        match flags & 0b111 {
            0 => Self::Float,
            1 => Self::Fixed,
            _ => Self::None,
        }
    }

    /// Whether positions may be used for control.
    pub const fn is_fixed(self) -> bool {
        matches!(self, Self::Fixed)
    }
}

/// GPS time of the measurement that follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Time {
    /// GPS week.
    pub week: u16,
    /// Time of week, ms.
    pub tow: u32,
    /// Rest below the millisecond, ns, may be negative.
    pub nanoseconds: i32,
    /// Whether the time is known. The deprecated type does not say; it counts as known.
    pub valid: bool,
}

/// Geodetic position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PositionLlh {
    /// Time of week, ms.
    pub tow: u32,
    /// Latitude, degrees.
    pub latitude: f64,
    /// Longitude, degrees.
    pub longitude: f64,
    /// Satellites used.
    pub satellites: u8,
    /// Quality.
    pub fix: Fix,
}

/// Position relative to the base station, north-east-down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PositionNed {
    /// Time of week, ms.
    pub tow: u32,
    /// North, mm.
    pub north: i32,
    /// East, mm.
    pub east: i32,
    /// Down, mm.
    pub down: i32,
    /// Satellites used.
    pub satellites: u8,
    /// Quality.
    pub fix: Fix,
}

/// Velocity over ground, north-east-down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VelocityNed {
    /// Time of week, ms.
    pub tow: u32,
    /// North, mm/s.
    pub north: i32,
    /// East, mm/s.
    pub east: i32,
    /// Down, mm/s.
    pub down: i32,
    /// Satellites used.
    pub satellites: u8,
    /// Whether the velocity is measured. The deprecated type does not say; it counts as
    /// measured.
    pub valid: bool,
}

/// Heading from base to rover. Not the vehicle's heading.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heading {
    /// Time of week, ms.
    pub tow: u32,
    /// Clockwise from north, thousandths of a degree.
    pub millidegrees: u32,
    /// Satellites used.
    pub satellites: u8,
    /// Quality.
    pub fix: Fix,
}

/// A message of one of the types in use.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Message {
    /// 0x0102, 0x0100.
    Time(Time),
    /// 0x020A, 0x0201.
    PositionLlh(PositionLlh),
    /// 0x020C, 0x0203.
    PositionNed(PositionNed),
    /// 0x020E, 0x0205.
    VelocityNed(VelocityNed),
    /// 0x020F, 0x0207.
    Heading(Heading),
    /// 0xFFFF: flags of the receiver's state.
    Heartbeat(u32),
}

/// Decodes a frame; `None` for types that are not in use and for payloads of the wrong
/// length.
pub fn decode(frame: &Frame<'_>) -> Option<Message> {
    let mut payload = Payload(frame.payload);
    let message = match (frame.kind, frame.payload.len()) {
        (0x0102 | 0x0100, 11) => {
            let week = payload.u16()?;
            let tow = payload.u32()?;
            let nanoseconds = payload.u32()?.cast_signed();
            let flags = payload.u8()?;
            Message::Time(Time {
                week,
                tow,
                nanoseconds,
                valid: frame.kind == 0x0100 || flags & 0b111 != 0,
            })
        }
        (0x020A | 0x0201, 34) => {
            let tow = payload.u32()?;
            let latitude = payload.f64()?;
            let longitude = payload.f64()?;
            let _height = payload.f64()?;
            let _accuracies = payload.u32()?;
            let satellites = payload.u8()?;
            let flags = payload.u8()?;
            Message::PositionLlh(PositionLlh {
                tow,
                latitude,
                longitude,
                satellites,
                fix: if frame.kind == 0x020A {
                    Fix::current(flags)
                } else {
                    Fix::deprecated_llh(flags)
                },
            })
        }
        (0x020C | 0x0203, 22) => {
            let ned = payload.ned()?;
            Message::PositionNed(PositionNed {
                tow: ned.tow,
                north: ned.north,
                east: ned.east,
                down: ned.down,
                satellites: ned.satellites,
                fix: if frame.kind == 0x020C {
                    Fix::current(ned.flags)
                } else {
                    Fix::deprecated_baseline(ned.flags)
                },
            })
        }
        (0x020E | 0x0205, 22) => {
            let ned = payload.ned()?;
            Message::VelocityNed(VelocityNed {
                tow: ned.tow,
                north: ned.north,
                east: ned.east,
                down: ned.down,
                satellites: ned.satellites,
                valid: frame.kind == 0x0205 || ned.flags & 0b111 != 0,
            })
        }
        (0x020F | 0x0207, 10) => {
            let tow = payload.u32()?;
            let millidegrees = payload.u32()?;
            let satellites = payload.u8()?;
            let flags = payload.u8()?;
            Message::Heading(Heading {
                tow,
                millidegrees,
                satellites,
                fix: if frame.kind == 0x020F {
                    Fix::current(flags)
                } else {
                    Fix::deprecated_baseline(flags)
                },
            })
        }
        (0xFFFF, 4) => Message::Heartbeat(payload.u32()?),
        _ => return None,
    };
    Some(message)
}

/// The layout that baseline and velocity share.
struct Ned {
    tow: u32,
    north: i32,
    east: i32,
    down: i32,
    satellites: u8,
    flags: u8,
}

/// Reads little-endian fields from the front.
struct Payload<'a>(&'a [u8]);

impl Payload<'_> {
    fn take<const N: usize>(&mut self) -> Option<[u8; N]> {
        let (field, rest) = self.0.split_first_chunk::<N>()?;
        self.0 = rest;
        Some(*field)
    }

    fn u8(&mut self) -> Option<u8> {
        self.take().map(u8::from_le_bytes)
    }

    fn u16(&mut self) -> Option<u16> {
        self.take().map(u16::from_le_bytes)
    }

    fn u32(&mut self) -> Option<u32> {
        self.take().map(u32::from_le_bytes)
    }

    fn f64(&mut self) -> Option<f64> {
        self.take().map(f64::from_le_bytes)
    }

    fn ned(&mut self) -> Option<Ned> {
        let tow = self.u32()?;
        let north = self.u32()?.cast_signed();
        let east = self.u32()?.cast_signed();
        let down = self.u32()?.cast_signed();
        let _accuracies = self.u32()?;
        Some(Ned {
            tow,
            north,
            east,
            down,
            satellites: self.u8()?,
            flags: self.u8()?,
        })
    }
}
