//! Conversions between simulated time and seconds.

use world::{SimDuration, SimTime};

/// A duration of `seconds`.
#[must_use]
pub fn span(seconds: f64) -> SimDuration {
    SimDuration::from_ticks((seconds * 1e12).round() as u64)
}

/// The time `seconds` after power-on.
#[must_use]
pub fn at(seconds: f64) -> SimTime {
    SimTime::from_ticks(0) + span(seconds)
}

/// Seconds since power-on.
#[must_use]
pub fn seconds(time: SimTime) -> f64 {
    time.as_ticks() as f64 * 1e-12
}

/// The system time that a reference with these data tells, ms.
#[must_use]
pub fn system_time(reference: &[u8; 8]) -> u32 {
    let [_, a, b, c, d, ..] = *reference;
    u32::from_be_bytes([a, b, c, d])
}
