//! Makes a system matrix from a list of messages.
//!
//! [`power_of_two`] is the thesis's method (4.3.6.3): the shortest period becomes the
//! basic cycle, and every other period a power of two times it. [`least_jitter`]
//! keeps every period, and searches the number of basic cycles and the phases with
//! the least jitter.
//!
//! Both are for hosts and need the feature `std`.

mod place;

use std::string::String;
use std::vec::Vec;

use crate::matrix::needed_micros;
use crate::{
    INTERFRAME_BITS, Id, MatrixConfig, Micros, NodeId, Window, WindowKind, worst_case_bits,
};

/// A periodic message that needs exclusive windows.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Message {
    /// Name in errors and window names.
    pub name: String,
    /// Identifier.
    pub id: Id,
    /// Number of data bytes, 0 to 8.
    pub len: u8,
    /// The node that sends it.
    pub sender: NodeId,
    /// Longest time from one transmission to the next, without jitter.
    pub period: Micros,
    /// Longest time from the release of the message to the end of its window.
    pub deadline: Micros,
    /// Messages, by their places in the list, whose windows must be over before this one's
    /// begins wherever both come in the same basic cycle.
    pub after: Vec<usize>,
    /// Least time from the end of those windows to the beginning of this one's: what the
    /// sender takes to make the message of theirs.
    pub gap: Micros,
}

/// Requirements for the matrix.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wishes {
    /// Starts and lengths of windows are multiples of this time.
    pub grain: Micros,
    /// Required share of time for arbitrating windows, in thousandths.
    pub arbitrating_per_mille: u16,
    /// Required share of free time, in thousandths.
    pub free_per_mille: u16,
    /// Longest basic cycle.
    pub longest_cycle: Micros,
}

impl Wishes {
    /// Windows in whole microseconds, no required shares, basic cycles of at most a
    /// second.
    pub const NONE: Self = Self {
        grain: Micros::micros(1),
        arbitrating_per_mille: 0,
        free_per_mille: 0,
        longest_cycle: Micros::secs(1),
    };
}

/// A window of a plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlannedWindow {
    /// Index of the message, `None` for an arbitrating window.
    pub message: Option<usize>,
    /// Cycle time at which it begins.
    pub start: Micros,
    /// Length.
    pub length: Micros,
    /// Repeat factor.
    pub repeat: u8,
    /// Cycle offset.
    pub offset: u8,
}

/// A matrix with windows for all messages.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Plan {
    /// Length of a basic cycle.
    pub basic_cycle: Micros,
    /// Number of basic cycles.
    pub cycles: u8,
    /// The windows, sorted by start.
    pub windows: Vec<PlannedWindow>,
    /// Jitter of each message: largest deviation of its windows from a regular
    /// period.
    pub jitter: Vec<Micros>,
    /// The period of each message in the plan, at most the required one.
    pub periods: Vec<Micros>,
}

impl Plan {
    /// The windows for [`MatrixConfig::windows`].
    pub fn windows<'a>(&self, messages: &'a [Message]) -> Vec<Window<'a>> {
        let window = |planned: &PlannedWindow| {
            let message = planned.message.and_then(|index| messages.get(index));
            let (name, kind) = match message {
                Some(message) => {
                    let kind = WindowKind::Exclusive {
                        id: message.id,
                        len: message.len,
                        sender: message.sender,
                        retry_late: false,
                    };
                    (message.name.as_str(), kind)
                }
                None => {
                    let kind = WindowKind::Arbitrating {
                        merged_with_next: false,
                    };
                    ("arbitrating", kind)
                }
            };
            Window::new(name, planned.start, planned.length, kind)
                .every(planned.repeat, planned.offset)
        };
        self.windows.iter().map(window).collect()
    }

    /// Share of time that arbitrating (or else exclusive) windows take, in
    /// thousandths.
    pub fn share_per_mille(&self, arbitrating: bool) -> u32 {
        let taken: u64 = self
            .windows
            .iter()
            .filter(|window| window.message.is_none() == arbitrating)
            .map(|window| {
                u64::from(window.length.ticks()) * u64::from(self.cycles / window.repeat.max(1))
            })
            .sum();
        let all = u64::from(self.basic_cycle.ticks()) * u64::from(self.cycles);
        (taken * 1000 / all.max(1)) as u32
    }
}

/// Why there is no plan.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Infeasible {
    /// There is no room for the message among those that were placed before.
    NoRoom {
        /// Name of the message.
        message: String,
    },
    /// The window of the message is longer than its deadline or period.
    TooShort {
        /// Name of the message.
        message: String,
        /// Length of its window.
        needed: Micros,
    },
    /// The message is longer than 8 bytes, or its period is 0.
    Nonsense {
        /// Name of the message.
        message: String,
    },
    /// Messages wait for one another in a circle, or for one that is not in the list.
    Sequence {
        /// One of them.
        message: String,
    },
    /// No matrix of up to 64 basic cycles holds every period a whole number of
    /// times.
    NoCommonCycle {
        /// Name of the message whose period does not fit the others.
        message: String,
    },
    /// Too little time is left for arbitrating windows.
    Arbitrating {
        /// The share that is left, in thousandths.
        left_per_mille: u32,
    },
    /// Too little time is left free.
    Free {
        /// The share that is left, in thousandths.
        left_per_mille: u32,
    },
    /// There is no message.
    Empty,
}

impl core::fmt::Display for Infeasible {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::NoRoom { message } => {
                write!(f, "message `{message}` finds no room among the others")
            }
            Self::TooShort { message, needed } => write!(
                f,
                "message `{message}` needs a window of {} us, longer than its period or deadline",
                needed.ticks()
            ),
            Self::Nonsense { message } => write!(
                f,
                "message `{message}` must have 0 to 8 bytes and a period above 0"
            ),
            Self::Sequence { message } => write!(
                f,
                "message `{message}` must follow messages that wait for it in turn"
            ),
            Self::NoCommonCycle { message } => write!(
                f,
                "the period of message `{message}` does not go with the others' into 64 basic cycles"
            ),
            Self::Arbitrating { left_per_mille } => write!(
                f,
                "only {left_per_mille} per mille of the time is left for arbitrating windows"
            ),
            Self::Free { left_per_mille } => {
                write!(
                    f,
                    "only {left_per_mille} per mille of the time is left free"
                )
            }
            Self::Empty => f.write_str("there is no message to schedule"),
        }
    }
}

impl core::error::Error for Infeasible {}

/// The thesis's method (4.3.6.3): the shortest period is the basic cycle, and every
/// other period is shortened to a power of two times it. The messages then have no
/// jitter. Windows are placed as early in the basic cycle as possible.
///
/// `network` gives bit rate, reference, masters, transmit enable window and
/// uncertainty. Its basic cycle, number of cycles and windows are not used.
///
/// # Errors
/// The message, or the share, that does not fit.
pub fn power_of_two(
    network: &MatrixConfig,
    messages: &[Message],
    wishes: &Wishes,
) -> Result<Plan, Infeasible> {
    let lengths = check(network, messages, wishes)?;
    let shortest = messages.iter().map(|message| message.period.ticks()).min();
    let grain = wishes.grain.ticks().max(1);
    let longest = wishes.longest_cycle.ticks();
    let basic_cycle = shortest.ok_or(Infeasible::Empty)?.min(longest) / grain * grain;
    let most = basic_cycle.saturating_mul(64);
    let periods: Vec<u32> = messages
        .iter()
        .map(|message| {
            let times = (message.period.ticks().min(most) / basic_cycle.max(1)).max(1);
            basic_cycle << times.ilog2()
        })
        .collect();
    let matrix = periods.iter().max().copied().unwrap_or(basic_cycle);
    let cycles = matrix / basic_cycle.max(1);
    let order = place::in_sequence(&place::by_period(&periods, &lengths), messages)?;
    let frame = place::Frame::new(network, wishes, basic_cycle, cycles);
    let placed = place::place(&frame, messages, &periods, &lengths, &order, false)?;
    finish(&frame, placed, &periods, wishes, network)
}

/// Searches the number of basic cycles, and the phases of all messages, with the
/// least jitter. Every message keeps its period.
///
/// The least common multiple of the periods must be at most 64 times
/// [`Wishes::longest_cycle`].
///
/// # Errors
/// The message, or the share, that does not fit.
pub fn least_jitter(
    network: &MatrixConfig,
    messages: &[Message],
    wishes: &Wishes,
) -> Result<Plan, Infeasible> {
    let lengths = check(network, messages, wishes)?;
    let periods: Vec<u32> = messages
        .iter()
        .map(|message| message.period.ticks())
        .collect();
    let longest = u64::from(wishes.longest_cycle.ticks());
    let grain = u64::from(wishes.grain.ticks().max(1));
    let mut matrix = grain;
    for message in messages {
        let period = u64::from(message.period.ticks());
        matrix = matrix / gcd(matrix, period) * period;
        if matrix > 64 * longest {
            let message = message.name.clone();
            return Err(Infeasible::NoCommonCycle { message });
        }
    }
    let mut best: Option<Plan> = None;
    let mut failure = None;
    for cycles in [1u64, 2, 4, 8, 16, 32, 64] {
        let basic_cycle = matrix / cycles;
        if matrix % (cycles * grain) != 0 || basic_cycle > longest {
            continue;
        }
        let frame = place::Frame::new(network, wishes, basic_cycle as u32, cycles as u32);
        let mut order = place::by_period(&periods, &lengths);
        // The message with the most jitter is placed first the next time.
        for _ in 0..=messages.len().min(16) {
            let tried = place::in_sequence(&order, messages)
                .and_then(|order| place::place(&frame, messages, &periods, &lengths, &order, true))
                .and_then(|placed| finish(&frame, placed, &periods, wishes, network));
            match tried {
                Ok(plan) => {
                    let worst = (0..messages.len()).max_by_key(|index| plan.jitter[*index]);
                    let settled = cost(&plan).0 == 0;
                    if best.as_ref().is_none_or(|best| cost(&plan) < cost(best)) {
                        best = Some(plan);
                    }
                    if settled {
                        break;
                    }
                    let Some(worst) = worst else { break };
                    order.retain(|index| *index != worst);
                    order.insert(0, worst);
                }
                Err(error) => {
                    failure.get_or_insert(error);
                    break;
                }
            }
        }
    }
    best.ok_or_else(|| {
        failure.unwrap_or_else(|| Infeasible::NoCommonCycle {
            message: messages
                .iter()
                .max_by_key(|message| message.period)
                .map(|message| message.name.clone())
                .unwrap_or_default(),
        })
    })
}

/// Plans are compared by jitter, then by the number of references, then by the size
/// of the table.
fn cost(plan: &Plan) -> (u64, u8, usize) {
    let jitter = plan
        .jitter
        .iter()
        .map(|jitter| u64::from(jitter.ticks()))
        .sum();
    (jitter, plan.cycles, plan.windows.len())
}

/// The window length of each message, in microseconds.
fn check(
    network: &MatrixConfig,
    messages: &[Message],
    wishes: &Wishes,
) -> Result<Vec<u32>, Infeasible> {
    if messages.is_empty() {
        return Err(Infeasible::Empty);
    }
    let grain = wishes.grain.ticks().max(1);
    messages
        .iter()
        .map(|message| {
            let name = || message.name.clone();
            if message.len > 8 || message.period.ticks() == 0 {
                return Err(Infeasible::Nonsense { message: name() });
            }
            let bits = worst_case_bits(message.id, message.len)
                + INTERFRAME_BITS
                + u32::from(network.transmit_enable_bits);
            let needed = needed_micros(bits, network.bit_rate, network.sync_uncertainty)
                .div_ceil(grain)
                .saturating_mul(grain);
            if needed > message.deadline.ticks() || needed > message.period.ticks() {
                return Err(Infeasible::TooShort {
                    message: name(),
                    needed: Micros::from_ticks(needed),
                });
            }
            Ok(needed)
        })
        .collect()
}

/// Adds arbitrating windows and checks the share of free time.
fn finish(
    frame: &place::Frame,
    placed: place::Placed,
    periods: &[u32],
    wishes: &Wishes,
    network: &MatrixConfig,
) -> Result<Plan, Infeasible> {
    let mut windows = placed.windows(frame);
    windows.extend(frame.arbitrating(&placed, wishes, network)?);
    windows.sort_by_key(|window| (window.start, window.offset, window.repeat));
    let plan = Plan {
        basic_cycle: Micros::from_ticks(frame.basic_cycle),
        cycles: frame.cycles as u8,
        windows,
        jitter: placed
            .jitter
            .iter()
            .copied()
            .map(Micros::from_ticks)
            .collect(),
        periods: periods.iter().copied().map(Micros::from_ticks).collect(),
    };
    let taken =
        plan.share_per_mille(false) + plan.share_per_mille(true) + frame.reserved_per_mille();
    let left_per_mille = 1000u32.saturating_sub(taken);
    if left_per_mille < u32::from(wishes.free_per_mille) {
        return Err(Infeasible::Free { left_per_mille });
    }
    Ok(plan)
}

fn gcd(mut a: u64, mut b: u64) -> u64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a.max(1)
}
