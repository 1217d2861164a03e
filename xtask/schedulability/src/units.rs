//! Times in picoseconds, and how they are written for people.

/// A time or an instant in picoseconds.
pub type Picoseconds = u64;
/// Picoseconds in a microsecond.
pub const MICROSECOND: Picoseconds = 1_000_000;

/// A time as text: in milliseconds from 10 ms on, else in microseconds.
#[must_use]
pub fn time(ps: Picoseconds) -> String {
    if ps >= 10_000 * MICROSECOND {
        format!("{:.2} ms", ps as f64 / 1e9)
    } else {
        format!("{:.2} us", ps as f64 / 1e6)
    }
}

/// How long `cycles` of a core at `hz` take, rounded up.
#[must_use]
pub fn picoseconds(cycles: u64, hz: u64) -> Picoseconds {
    (u128::from(cycles) * 1_000_000_000_000).div_ceil(u128::from(hz.max(1))) as u64
}
