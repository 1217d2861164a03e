//! Response times of frames that arbitrate for a CAN bus.
//!
//! The analysis is that of R. I. Davis, A. Burns, R. J. Bril and J. J. Lukkien, "Controller Area
//! Network (CAN) schedulability analysis: Refuted, revisited and revised", Real-Time Systems 35
//! (2007). It examines every instance in the busy period, because the first one is not always
//! the worst.

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

/// Errors on the bus: `burst` back to back, and one more in each `interval`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ErrorRate {
    /// Errors that may occur back to back.
    pub burst: u64,
    /// Least time between further errors, in nanoseconds; zero for none.
    pub interval: u64,
}

impl ErrorRate {
    /// A bus without errors.
    pub const NONE: Self = Self {
        burst: 0,
        interval: 0,
    };

    pub(crate) fn errors(self, window: u64) -> u64 {
        self.burst
            + if self.interval == 0 {
                0
            } else {
                window.div_ceil(self.interval)
            }
    }
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
