//! Response times of frames that arbitrate for a CAN bus.
//!
//! The analysis is that of R. I. Davis, A. Burns, R. J. Bril and J. J. Lukkien, "Controller Area
//! Network (CAN) schedulability analysis: Refuted, revisited and revised", Real-Time Systems 35
//! (2007). It examines every instance in the busy period, because the first one is not always
//! the worst.

use std::fmt;
use std::str::FromStr;

use crate::results::Tolerance;

/// Bits of a data frame with an 11-bit identifier, without data and stuffing, and the interframe space (ISO
/// 11898-1).
pub(crate) const SHORTEST_BITS: u64 = 47;
/// Bits of a frame in which arbitration can be lost: start of frame, identifier and RTR (ISO 11898-1).
pub(crate) const ARBITRATION_BITS: u64 = 13;
/// Bits between two frames.
pub(crate) const INTERFRAME_BITS: u64 = 3;

/// One message stream. Times in nanoseconds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Message {
    /// Name used in reports.
    pub name: String,
    /// Longest time on the wire, interframe space included ([`frame_time`]).
    pub length: u64,
    /// Least time between two requests, before jitter. Must not be zero.
    pub period: u64,
    /// Deadline relative to the request.
    pub deadline: u64,
    /// Queuing jitter: how long after its nominal instant a frame may be enqueued.
    pub jitter: u64,
}

/// Disturbed frames on the bus: up to `burst` of them in any stretch of length `interval`, also back to
/// back. This is the error model of Tindell and Burns 1994 and of Davis et al. 2007, section 6, with a
/// burst in each interval.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ErrorRate {
    /// Disturbed frames in any interval; zero for a bus without errors.
    pub burst: u64,
    /// Length of the interval, in nanoseconds; zero if no further burst follows the first.
    pub interval: u64,
}

/// Most disturbed frames of one burst that are accepted: after 32 disturbed frames in a row a sender
/// is bus-off (ISO 11898-1: each adds 8 to its error counter, and it leaves the bus above 255).
pub const MOST_ERRORS: u64 = 32;

/// Longest interval between bursts that is accepted, in milliseconds: one hour.
pub const LONGEST_INTERVAL_MS: u64 = 3_600_000;

impl ErrorRate {
    /// A bus without errors.
    pub const NONE: Self = Self {
        burst: 0,
        interval: 0,
    };

    /// The rate where nothing else is said: one disturbed frame in any 100 ms.
    pub const USUAL: Self = Self::every(1, 100);

    /// `burst` disturbed frames in any `interval_ms` milliseconds.
    #[must_use]
    pub const fn every(burst: u64, interval_ms: u64) -> Self {
        Self {
            burst,
            interval: interval_ms * 1_000_000,
        }
    }

    /// The same with bursts of another size; at a rate of none, one burst.
    #[must_use]
    pub const fn with_burst(self, burst: u64) -> Self {
        Self { burst, ..self }
    }

    /// Whether no frame is disturbed.
    #[must_use]
    pub const fn is_none(self) -> bool {
        self.burst == 0
    }

    /// The most disturbed frames in any half-open window of this length, nanoseconds.
    #[must_use]
    pub fn errors(self, window: u64) -> u64 {
        match self.interval {
            0 => self.burst,
            interval => self.burst.saturating_mul(window.div_ceil(interval)),
        }
    }
}

impl FromStr for ErrorRate {
    type Err = String;

    /// Reads `N/Mms`, N disturbed frames in any M milliseconds, or `none`.
    fn from_str(text: &str) -> Result<Self, String> {
        if text == "none" {
            return Ok(Self::NONE);
        }
        let numbers = text.strip_suffix("ms").and_then(|text| {
            let (burst, interval) = text.split_once('/')?;
            Some((burst.parse().ok()?, interval.parse().ok()?))
        });
        match numbers {
            Some((burst @ 1..=MOST_ERRORS, interval @ 1..=LONGEST_INTERVAL_MS)) => {
                Ok(Self::every(burst, interval))
            }
            _ => Err(format!(
                "N/Mms or none is accepted, as 2/100ms: 1 to {MOST_ERRORS} disturbed frames in any 1 to \
                 {LONGEST_INTERVAL_MS} milliseconds"
            )),
        }
    }
}

impl fmt::Display for ErrorRate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.burst, self.interval) {
            (0, _) => f.write_str("no disturbed frame"),
            (1, _) => f.write_str("1 disturbed frame"),
            (burst, _) => write!(f, "{burst} disturbed frames"),
        }?;
        match (self.burst, self.interval) {
            (0, _) | (_, 0) => Ok(()),
            (_, interval) => write!(f, " in any {} ms", interval as f64 / 1e6),
        }
    }
}

/// For each of `count` messages the largest burst of disturbed frames with which it meets its deadline.
/// `meets` says it of all messages for a burst. More frames in a burst never make a bound smaller.
pub(crate) fn tolerances(count: usize, meets: impl Fn(u64) -> Vec<bool>) -> Vec<Tolerance> {
    let mut found = vec![None; count];
    for burst in 0..=MOST_ERRORS {
        let meets = meets(burst);
        let mut any = false;
        for (most, meets) in found.iter_mut().zip(meets) {
            // Only a message that met with all smaller bursts can grow.
            if meets && *most == burst.checked_sub(1) {
                *most = Some(burst);
                any = true;
            }
        }
        if !any {
            break;
        }
    }
    found.into_iter().map(Tolerance::Repeated).collect()
}

/// Bit times that one error costs in addition to the repeated frame: both error flags, the
/// delimiter and the interframe space (Davis et al. 2007, section 6).
pub const ERROR_FRAME_BITS: u64 = 31;

/// Longest frame with an 11-bit identifier and `bytes` of data (0..=8), with stuffing and the
/// interframe space, in nanoseconds: `(55 + 10 n)` bits.
#[must_use]
pub fn frame_time(bytes: u64, bit_time: u64) -> u64 {
    (55 + 10 * bytes) * bit_time
}

/// There is no bound: the messages demand more than the bus has.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the bus is overloaded at this identifier: the busy period does not end")]
pub struct Overloaded;

/// Worst-case response time of `messages[index]`, from its nominal request to its last bit.
/// `messages` are in order of priority, the lowest identifier first; `bit_time` is in
/// nanoseconds.
///
/// # Errors
/// [`Overloaded`] when the busy period does not end.
pub fn response(
    messages: &[Message],
    index: usize,
    bit_time: u64,
    errors: ErrorRate,
) -> Result<u64, Overloaded> {
    let message = &messages[index];
    let higher = &messages[..index];
    // A frame of lower priority that has just started cannot be stopped.
    let blocking = messages[index + 1..]
        .iter()
        .map(|lower| lower.length)
        .max()
        .unwrap_or(0);
    let resent = messages[..=index]
        .iter()
        .map(|m| m.length)
        .max()
        .unwrap_or(0);
    let disturbed = |window: u64| errors.errors(window) * (ERROR_FRAME_BITS * bit_time + resent);

    let busy = fixed_point(blocking + message.length, |window| {
        messages[..=index]
            .iter()
            .map(|m| (window + m.jitter).div_ceil(m.period) * m.length)
            .sum::<u64>()
            + blocking
            + disturbed(window)
    })?;
    let instances = (busy + message.jitter).div_ceil(message.period);
    let mut worst = 0;
    let mut start = blocking;
    for instance in 0..instances {
        start = fixed_point(start.max(blocking + instance * message.length), |window| {
            // A frame that is enqueued up to one bit time after the start still takes part in
            // arbitration.
            higher
                .iter()
                .map(|m| (window + m.jitter + bit_time).div_ceil(m.period) * m.length)
                .sum::<u64>()
                + blocking
                + instance * message.length
                + disturbed(window + message.length)
        })?;
        let response = message.jitter + start + message.length - instance * message.period;
        worst = worst.max(response);
    }
    Ok(worst)
}

/// Steps of one fixed-point search after which the bus counts as overloaded.
const MAX_STEPS: usize = 1_000_000;

pub(crate) fn fixed_point(first: u64, next: impl Fn(u64) -> u64) -> Result<u64, Overloaded> {
    let mut window = first;
    for _ in 0..MAX_STEPS {
        let wider = next(window);
        if wider <= window {
            return Ok(window);
        }
        if wider > HORIZON {
            break;
        }
        window = wider;
    }
    Err(Overloaded)
}

/// Longest busy period, one hour; a longer one counts as an overloaded bus.
const HORIZON: u64 = 3_600_000_000_000;
