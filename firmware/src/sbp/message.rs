//! The messages that the vehicle uses, current and deprecated.
//!
//! The receiver's firmware of 2016-17 sent the deprecated types. They have the same layouts,
//! but their flags mean something else, so the flags are decoded by message type.

use super::Frame;

/// Quality of a position.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
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
    /// Remainder below the millisecond, ns; may be negative.
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

/// Roll and pitch of the vehicle, from the receiver's inertial sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Orientation {
    /// Time of week, ms.
    pub tow: u32,
    /// Roll, microdegrees, positive if the right side is lower.
    pub roll: i32,
    /// Pitch, microdegrees, positive if the front is higher.
    pub pitch: i32,
    /// Whether the sensor knows them: its navigation mode is 1, "valid".
    pub valid: bool,
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
#[inline(always)]
pub fn decode(frame: &Frame<'_>) -> Option<Message> {
    let kind = frame.kind();
    let u32_at = |from| u32::from_le_bytes(frame.field(from));
    let i32_at = |from| u32_at(from).cast_signed();
    let u8_at = |from| u8::from_le_bytes(frame.field(from));
    let message = match (kind, frame.length()) {
        (0x0102 | 0x0100, 11) => Message::Time(Time {
            week: u16::from_le_bytes(frame.field(0)),
            tow: u32_at(2),
            nanoseconds: i32_at(6),
            valid: kind == 0x0100 || u8_at(10) & 0b111 != 0,
        }),
        // Heights and accuracies are skipped, here and below.
        (0x020A | 0x0201, 34) => Message::PositionLlh(PositionLlh {
            tow: u32_at(0),
            latitude: f64::from_le_bytes(frame.field(4)),
            longitude: f64::from_le_bytes(frame.field(12)),
            satellites: u8_at(32),
            fix: if kind == 0x020A {
                Fix::current(u8_at(33))
            } else {
                Fix::deprecated_llh(u8_at(33))
            },
        }),
        (0x020C | 0x0203, 22) => Message::PositionNed(PositionNed {
            tow: u32_at(0),
            north: i32_at(4),
            east: i32_at(8),
            down: i32_at(12),
            satellites: u8_at(20),
            fix: if kind == 0x020C {
                Fix::current(u8_at(21))
            } else {
                Fix::deprecated_baseline(u8_at(21))
            },
        }),
        (0x020E | 0x0205, 22) => Message::VelocityNed(VelocityNed {
            tow: u32_at(0),
            north: i32_at(4),
            east: i32_at(8),
            down: i32_at(12),
            satellites: u8_at(20),
            valid: kind == 0x0205 || u8_at(21) & 0b111 != 0,
        }),
        (0x020F | 0x0207, 10) => Message::Heading(Heading {
            tow: u32_at(0),
            millidegrees: u32_at(4),
            satellites: u8_at(8),
            fix: if kind == 0x020F {
                Fix::current(u8_at(9))
            } else {
                Fix::deprecated_baseline(u8_at(9))
            },
        }),
        (0xFFFF, 4) => Message::Heartbeat(u32_at(0)),
        _ => return None,
    };
    Some(message)
}

/// Roll and pitch, if the frame is a message 0x0221; `None` for other types and for payloads of the wrong length.
///
/// Not a part of [`decode`]: only the images of vehicles with an inertial sensor have it.
#[inline(always)]
pub fn orientation(frame: &Frame<'_>) -> Option<Orientation> {
    if (frame.kind(), frame.length()) != (0x0221, 29) {
        return None;
    }
    let i32_at = |from| i32::from_le_bytes(frame.field(from));
    Some(Orientation {
        tow: u32::from_le_bytes(frame.field(0)),
        roll: i32_at(4),
        pitch: i32_at(8),
        // Yaw and accuracies are skipped.
        valid: u8::from_le_bytes(frame.field(28)) & 0b111 == 1,
    })
}
