//! Response times of event messages in an arbitrating window, with disturbed frames.
//!
//! All frames that wait when the window opens compete in it, and no message has more of them than its least
//! interval allows. So the answer is a sum, not a fixed point over periods. It begins with the analysis of
//! R. I. Davis et al. 2007: the more urgent frames, one less urgent frame that cannot be stopped, and for
//! each error 31 bits and the longest frame that is sent again.
//!
//! A node has one frame in its controller at a time, and requests the next one when its interrupts have run
//! ([`Reaction`]). Until then it does not compete, and a less urgent frame of another node may begin. So
//! each of these costs a frame more time than Davis et al. say:
//!
//! - The window opens: the first reaction.
//! - The node sends a more urgent frame of its own: a reaction behind it.
//! - It loses arbitration: the reaction, as far as it is longer than the rest of the winner.
//! - An error ends its attempt, or that to which it lost: a reaction behind the error frame. The frame that is
//!   then sent again costs what it cost before.
//!
//! A less urgent frame that begins in such a time ends behind it by less than its length. Each of them is sent
//! once, and once more for each error, so there are no more of them than that.

use crate::can::{ARBITRATION_BITS, ERROR_FRAME_BITS, ErrorRate};

/// How fast a node requests its frames in an arbitrating window. Times in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Reaction {
    /// From the begin of the window by the node's clock to the request of its first frame.
    pub first: u64,
    /// From the end of an attempt to the request of the next frame.
    pub next: u64,
}

/// A message that may have frames in the window. Times in nanoseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Frame {
    /// The node that sends it, by number.
    pub node: usize,
    /// Longest time on the wire, interframe space included.
    pub length: u64,
    /// Shortest time on the wire, interframe space included.
    pub shortest: u64,
    /// Most frames of it in one window.
    pub count: u64,
}

/// An arbitrating window with all that compete in it.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Competition {
    /// In order of priority, the lowest identifier first.
    pub frames: Vec<Frame>,
    /// The reaction of each node, by its number.
    pub reactions: Vec<Reaction>,
    /// Time of a bit, in nanoseconds.
    pub bit_time: u64,
}

impl Competition {
    /// Longest time from the begin of the window to the end of the last frame of message `index` that waited
    /// then, interframe space included, in nanoseconds; `None` if errors come faster than they pass.
    ///
    /// # Panics
    /// If `index` is not one of the messages, or the node of one of them has no reaction.
    #[must_use]
    pub fn response(&self, index: usize, errors: ErrorRate) -> Option<u64> {
        let mut disturbed = errors.burst;
        loop {
            let response = self.with(index, disturbed);
            // An error frame may reach into the window.
            let more = errors.errors(response + ERROR_FRAME_BITS * self.bit_time);
            if more <= disturbed {
                return Some(response);
            }
            if more > MOST_DISTURBED {
                return None;
            }
            disturbed = more;
        }
    }

    /// The same with this number of disturbed frames.
    fn with(&self, index: usize, disturbed: u64) -> u64 {
        let own = self.frames[index];
        let Reaction { first, next } = self.reactions[own.node];
        let of_others = |frame: &&Frame| frame.node != own.node;
        let (urgent, less) = self.frames.split_at(index);
        // How long the node does not compete behind an attempt that it lost, or a frame of its own.
        let absence = |frame: &Frame| {
            let rest = frame
                .shortest
                .saturating_sub(ARBITRATION_BITS * self.bit_time);
            if frame.node == own.node {
                next
            } else {
                next.saturating_sub(rest)
            }
        };
        // The frames before the last one of the message itself count as more urgent ones.
        let before = Frame {
            count: own.count.saturating_sub(1),
            ..own
        };
        let all = || {
            let all = urgent.iter().chain([&before]);
            all.filter(|frame| frame.count > 0)
        };
        let time: u64 = all()
            .map(|frame| frame.count * (frame.length + absence(frame)))
            .sum();
        let absences: u64 = all()
            .filter(|frame| absence(frame) > 0)
            .map(|frame| frame.count)
            .sum();
        // Behind the last frame of the message itself nothing matters any more.
        let again = all().map(|frame| frame.length + absence(frame));
        let again = again.chain([own.length]).max().unwrap_or(0);
        let each = ERROR_FRAME_BITS * self.bit_time + next + again;
        // One begins before the first request, and one in each absence: also behind an error, and behind the
        // frame that is sent again.
        let by_error = u64::from(next > 0) + u64::from(absences > 0);
        let begun = 1 + absences + by_error * disturbed;
        let mut less: Vec<u64> = less[1..]
            .iter()
            .filter(of_others)
            .flat_map(|frame| repeated(frame.length, frame.count))
            .collect();
        let longest = less.iter().max().copied();
        less.extend(
            longest
                .into_iter()
                .flat_map(|longest| repeated(longest, disturbed)),
        );
        less.sort_unstable_by(|one, other| other.cmp(one));
        let begun = usize::try_from(begun).unwrap_or(usize::MAX);
        let less: u64 = less.iter().take(begun).sum();
        first + time + less + disturbed * each + own.length
    }
}

/// Most disturbed frames of one window; with more, there is no bound.
const MOST_DISTURBED: u64 = 1000;

fn repeated(length: u64, times: u64) -> impl Iterator<Item = u64> {
    std::iter::repeat_n(length, usize::try_from(times).unwrap_or(usize::MAX))
}
