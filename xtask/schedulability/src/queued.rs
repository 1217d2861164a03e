//! Response times of frames of nodes with few mailboxes and a queue behind them, and of messages
//! that follow each other.
//!
//! [`crate::can`] has the analysis of Davis, Burns, Bril and Lukkien (2007). It takes for granted
//! that each node always competes with its most urgent frame. A node with more messages than
//! mailboxes does not: when an attempt ends, or a frame is withdrawn for a more urgent one, its
//! transmit interrupt must load the next frame, and until then a less urgent frame of another node
//! may begin. So for such a node this analysis adds:
//!
//! - to each frame that the node itself sends before the one in question: twice the time to load,
//!   and each time one less urgent frame of another node;
//! - the same once at the begin, if the node has less urgent messages;
//! - to the jitter of its messages, where they delay others: the time by which one may begin later
//!   than it was put.
//!
//! After a lost arbitration or a disturbed frame the mailbox must be loaded again. If that takes longer
//! than the winner or the error frame, a less urgent frame may begin first, so each of them costs that
//! much more. A frame that lost arbitration to one that is then disturbed is not loaded later than one
//! that was itself disturbed in its first bit.
//!
//! An error in the last bit of a frame is one for its sender only: the receivers have taken the frame, and
//! take it once more when it is repeated (CAN 2.0, message validation). If they answer with messages of
//! their own, each error also costs one more frame of every message that follows ([`Stream::follows`]).
//! And a node may rest after several attempts that failed ([`Stream::rest`]).
//!
//! Messages that follow from one sample meet in known ways ([`Meeting`]), as long as each is out
//! before the next sample; that is their deadline. If all nodes load at once and all messages meet
//! in any way, the answers are those of Davis et al.

use crate::can::{ERROR_FRAME_BITS, ErrorRate, Overloaded, fixed_point};

/// One message stream. Times in nanoseconds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Stream {
    /// The node that sends it, by number.
    pub node: usize,
    /// Longest time on the wire, interframe space included.
    pub length: u64,
    /// Least time between the nominal instants of two requests. Must not be zero.
    pub period: u64,
    /// How long after its nominal instant a frame may be put.
    pub jitter: u64,
    /// Time from the end of an attempt of its node until the next frame is in the mailbox; zero if no
    /// frame of the node waits for one.
    pub load: u64,
    /// The same after a lost arbitration; zero if it is over before the bus is free again.
    pub reload: u64,
    /// The same after a disturbed frame.
    pub repeat: u64,
    /// The streams, by number, whose frames bring about one of this stream.
    pub follows: Vec<usize>,
    /// Number of attempts that fail by an error after which its node rests, and for how long.
    pub rest: Option<(u64, u64)>,
}

/// In which ways a frame of another stream may delay one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Meeting {
    /// In any.
    Any,
    /// One frame at most: both follow from the same sample, and each is out before the next one.
    Once,
    /// In none: the same, and one of the two has ended before the other one is put; or a less
    /// urgent one is put after it.
    Never,
}

/// Bounds for one stream. Times in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Bounds {
    /// From the nominal instant of the request to the end of the frame.
    pub response: u64,
    /// From the request to the end of the frame.
    pub delay: u64,
}

/// Bounds for all streams, which are in order of priority, the lowest identifier first. `None`
/// for a stream whose busy period does not end, and for those of lower priority. `bit_time` is in
/// nanoseconds. `meeting` says of two indices how a frame of the second may delay one of the first.
#[must_use]
pub fn bounds(
    streams: &[Stream],
    bit_time: u64,
    errors: ErrorRate,
    meeting: impl Fn(usize, usize) -> Meeting,
) -> Vec<Option<Bounds>> {
    let mut known: Vec<Option<Bounds>> = Vec::new();
    for index in 0..streams.len() {
        let higher: Option<Vec<Bounds>> = known.iter().copied().collect();
        let bounds = higher.and_then(|higher| {
            let level = Level::new(streams, index, &higher, bit_time, errors, &meeting);
            level.bounds().ok()
        });
        known.push(bounds);
    }
    known
}

/// A message that goes before the one in question.
struct Urgent {
    /// Longest time that one frame of it takes.
    length: u64,
    period: u64,
    /// How long after its nominal instant a frame may begin.
    jitter: u64,
    meeting: Meeting,
}

/// The bus as one message sees it.
struct Level {
    urgent: Vec<Urgent>,
    own: Stream,
    /// What goes before the first frame, and before each further one of the same message.
    before_first: u64,
    before_next: u64,
    /// Longest frame that an error may destroy, with those that follow it once more.
    resent: u64,
    /// How long after an error those may be put.
    late: u64,
    /// What a disturbed frame costs in addition.
    repeat: u64,
    bit_time: u64,
    errors: ErrorRate,
}

impl Level {
    fn new(
        streams: &[Stream],
        index: usize,
        higher: &[Bounds],
        bit_time: u64,
        errors: ErrorRate,
        meeting: impl Fn(usize, usize) -> Meeting,
    ) -> Self {
        let own = streams[index].clone();
        let longest = |of_own: bool| {
            let lower = streams.iter().enumerate().skip(index + 1);
            let lower = lower.filter(|(at, stream)| {
                meeting(index, *at) != Meeting::Never && (stream.node == own.node) == of_own
            });
            lower.map(|(_, stream)| stream.length).max().unwrap_or(0)
        };
        let (of_own, of_others) = (longest(true), longest(false));
        let gap = match own.load {
            0 => 0,
            load => load + of_others,
        };
        let before_first = match of_own {
            0 => of_others,
            of_own => (of_own + gap).max(of_others),
        };
        let in_vain = |load: u64| match load {
            0 => 0,
            load => load + of_own.max(of_others),
        };
        let lost = in_vain(own.reload);
        let repeated = |stream: &Stream| match (errors.is_none(), stream.rest) {
            (true, _) => 0,
            (false, Some((_, rest))) => stream.repeat.max(rest),
            (false, None) => stream.repeat,
        };
        let urgent = streams.iter().zip(higher).enumerate();
        let urgent = urgent.map(|(at, (stream, bounds))| {
            let begins = bounds.response.saturating_sub(stream.length);
            let more = if stream.node == own.node {
                2 * gap
            } else {
                lost
            };
            Urgent {
                length: stream.length + more,
                period: stream.period,
                jitter: match stream.load.max(stream.reload).max(repeated(stream)) {
                    0 => stream.jitter,
                    _ => stream.jitter.max(begins),
                },
                meeting: meeting(index, at),
            }
        });
        let (resent, late) = resent(streams, index);
        Self {
            urgent: urgent.collect(),
            before_first,
            before_next: own.length + gap,
            resent,
            late,
            repeat: in_vain(own.repeat),
            bit_time,
            errors,
            own,
        }
    }

    /// Time that more urgent frames and errors take in a window in which so many frames of the
    /// message itself are put. A frame that is put up to one bit time after the window's begin
    /// still takes part in arbitration.
    fn demand(&self, window: u64, own: u64) -> u64 {
        let frames = self.urgent.iter().map(|urgent| {
            let jobs = (window + urgent.jitter + self.bit_time).div_ceil(urgent.period);
            let jobs = match urgent.meeting {
                Meeting::Any => jobs,
                Meeting::Once => jobs.min(own),
                Meeting::Never => 0,
            };
            jobs * urgent.length
        });
        let errors = self.errors.errors(window + self.own.length + self.late);
        let of_errors = errors * (ERROR_FRAME_BITS * self.bit_time + self.resent + self.repeat);
        let rests = match self.own.rest {
            Some((attempts, rest)) => errors / attempts.max(1) * rest,
            None => 0,
        };
        frames.sum::<u64>() + of_errors + rests
    }

    fn bounds(&self) -> Result<Bounds, Overloaded> {
        let Stream {
            length,
            period,
            jitter,
            ..
        } = self.own;
        let busy = fixed_point(self.before_first + length, |window| {
            let own = (window + jitter).div_ceil(period);
            self.before_first + own * self.before_next + self.demand(window, own)
        })?;
        let instances = (busy + jitter).div_ceil(period);
        let mut bounds = Bounds {
            response: 0,
            delay: 0,
        };
        let mut start = 0;
        for instance in 0..instances {
            let before = self.before_first + instance * self.before_next;
            start = fixed_point(start.max(before), |window| {
                before + self.demand(window, instance + 1)
            })?;
            // The first frame of the busy period is put at its begin, up to `jitter` late. A
            // further one may have been put in time.
            let end = start + length;
            let nominal = instance * period;
            let response = (jitter + end).saturating_sub(nominal);
            let delay = if instance == 0 { end } else { response };
            bounds.response = bounds.response.max(response);
            bounds.delay = bounds.delay.max(delay);
        }
        Ok(bounds)
    }
}

/// Longest time on the bus that one error costs the message `index` by frames that are sent again: the
/// destroyed one, and one of each message that follows from it. And how long after the error these are put
/// at the latest.
fn resent(streams: &[Stream], index: usize) -> (u64, u64) {
    let urgent = || streams[..=index].iter();
    let cost = |hit: usize| -> u64 {
        let again = if hit <= index { streams[hit].length } else { 0 };
        let following = urgent().filter(|stream| stream.follows.contains(&hit));
        again + following.map(|stream| stream.length).sum::<u64>()
    };
    let following = urgent().filter(|stream| !stream.follows.is_empty());
    (
        (0..streams.len()).map(cost).max().unwrap_or(0),
        following.map(|stream| stream.jitter).max().unwrap_or(0),
    )
}
