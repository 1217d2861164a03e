//! Simulated time: picoseconds since the start of the run.
//!
//! Picoseconds are fine enough for every clock of the system (one core cycle of the 180 MHz part is
//! 5555.6 ps), and 64 bits last for 213 days.

/// An instant of the simulated run.
pub type SimTime = fugit_host::MonotonicTimerInstantU64<1_000_000_000_000>;

/// A span of simulated time.
pub type SimDuration = fugit_host::TimerDurationU64<1_000_000_000_000>;

/// Picoseconds in one second.
pub const PER_SECOND: u64 = 1_000_000_000_000;

/// The start of every run.
pub const START: SimTime = SimTime::from_ticks(0);

/// `time` in seconds since the start of the run.
#[must_use]
pub fn seconds(time: SimTime) -> f64 {
    time.as_ticks() as f64 / PER_SECOND as f64
}

/// A span in microseconds.
#[must_use]
pub fn span_micros(span: SimDuration) -> f64 {
    span.as_ticks() as f64 / 1e6
}

/// `span` in seconds.
#[must_use]
pub fn span_seconds(span: SimDuration) -> f64 {
    span.as_ticks() as f64 / PER_SECOND as f64
}

/// The span of `seconds`, rounded to a picosecond; negative or non-finite values give zero.
#[must_use]
pub fn from_seconds(seconds: f64) -> SimDuration {
    SimDuration::from_ticks((seconds * PER_SECOND as f64).round() as u64)
}

/// The span between two times, zero if `earlier` is the later one.
#[must_use]
pub fn since(later: SimTime, earlier: SimTime) -> SimDuration {
    SimDuration::from_ticks(later.as_ticks().saturating_sub(earlier.as_ticks()))
}

/// The instant `span` after the start of the run.
#[must_use]
pub fn at(span: SimDuration) -> SimTime {
    SimTime::from_ticks(span.as_ticks())
}

/// The time `span` after `time`.
#[must_use]
pub fn after(time: SimTime, span: SimDuration) -> SimTime {
    SimTime::from_ticks(time.as_ticks() + span.as_ticks())
}

/// A quantity of time as a span of simulated time.
pub trait Span {
    /// The span; negative times give zero.
    #[must_use]
    fn span(self) -> SimDuration;
}

impl Span for crate::units::Time {
    fn span(self) -> SimDuration {
        from_seconds(self.get())
    }
}
