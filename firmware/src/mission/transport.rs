//! Messages of more than eight bytes, in segments: ISO 15765-2 ("ISO-TP") on classic CAN, with normal addressing.
//!
//! [`Receiver`] runs on the vehicle and has no memory of its own: it writes into the words that its caller has for a
//! mission. [`Sender`] is the other side, for programs on the bus. Neither knows a clock or a bus: their callers hand
//! frames and the passing of time to them.
//!
//! The kept crates were looked at and do not fit. `can-iso-tp` 0.2.0 is alive and needs no memory, but it has no
//! lengths above 4095 bytes, of which a mission of 84 legs has more; its reception goes on behind a wrong sequence
//! number and never times out; and it indexes slices, so that a panic is left in an image. `iso-tp` is an
//! unfinished release for asynchronous drivers. `can-isotp` of PyPI is the peer of the tests.
//!
//! What the standard leaves open: the receiver grants [`BLOCK`] frames at a time without a least distance, never asks
//! to wait, and ends a reception [`Receiver::wait`] by its count of calls. Unused bytes are [`PADDING`].

/// Consecutive frames between two flow controls. The queue in front of the receiver has room for so many.
pub const BLOCK: u8 = 6;

/// Fills frames up to eight bytes (ISO 15765-2:2016, 10.4.2.1).
pub const PADDING: u8 = 0xCC;

/// Bytes of a message that one frame holds.
pub const SINGLE: usize = 7;

/// Longest message whose length a first frame holds in twelve bits.
const SHORT: usize = 0xFFF;

/// Calls of [`Receiver::wait`] until a reception without frames ends.
const PATIENCE: u8 = 10;

/// Flow states of a flow control.
const CLEAR: u8 = 0x30;
const WAIT: u8 = 0x31;
const OVERFLOW: u8 = 0x32;

/// Why a message has not come whole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Failure {
    /// A frame is missing, or came twice or too early (`N_WRONG_SN`).
    Sequence,
    /// No frame has come for too long (`N_TIMEOUT_CR`).
    Silence,
    /// Another message has begun before the end (`N_UNEXP_PDU`).
    Interrupted,
    /// There is no room for it (`N_BUFFER_OVFLW`).
    TooLong,
}

/// What a frame means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// Nothing that has to be done.
    Nothing,
    /// A message of one frame: its bytes, and how many of them count.
    Single([u8; SINGLE], u8),
    /// A message of several frames has begun. The flow control is to be sent.
    Begun {
        /// Bytes that it will have.
        length: usize,
    },
    /// A block has come. The flow control is to be sent.
    Block,
    /// All bytes of the message have come.
    Whole {
        /// How many.
        length: usize,
    },
    /// The message has ended too early.
    Failed(Failure),
}

/// A message that is being received.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Coming {
    length: usize,
    so_far: usize,
    /// Sequence number of the next frame.
    next: u8,
    /// Frames of this block that are still to come.
    left: u8,
    /// Calls of [`Receiver::wait`] since the last frame.
    waited: u8,
}

/// Receives one message at a time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Receiver {
    coming: Option<Coming>,
}

/// The flow control that grants the next block.
pub const fn clear_to_send() -> [u8; 8] {
    [CLEAR, BLOCK, 0, PADDING, PADDING, PADDING, PADDING, PADDING]
}

/// The flow control that refuses a message that is too long.
pub const fn overflow() -> [u8; 8] {
    [OVERFLOW, 0, 0, PADDING, PADDING, PADDING, PADDING, PADDING]
}

/// The frame of a message with up to seven bytes; what is more is cut.
pub fn single(bytes: &[u8]) -> [u8; 8] {
    let mut frame = [PADDING; 8];
    let [head, rest @ ..] = &mut frame;
    *head = bytes.len().min(SINGLE) as u8;
    // loop-bound: 7
    for (to, from) in rest.iter_mut().zip(bytes) {
        *to = *from;
    }
    frame
}

/// Writes bytes from the byte `at` on into words, least significant byte first. Bytes beyond the words are lost.
// Not inlined, so that the analysis bounds its loop once.
#[inline(never)]
fn put(words: &mut [u32], at: usize, bytes: &[u8]) {
    // loop-bound: 7
    for (at, byte) in (at..).zip(bytes) {
        let shift = at % 4 * 8;
        if let Some(word) = words.get_mut(at / 4) {
            *word = *word & !(0xFF << shift) | u32::from(*byte) << shift;
        }
    }
}

impl Receiver {
    /// A receiver that has heard nothing.
    pub const fn new() -> Self {
        Self { coming: None }
    }

    /// Bytes so far of the message that is coming, and how many it will have.
    pub const fn progress(&self) -> Option<(usize, usize)> {
        match &self.coming {
            Some(coming) => Some((coming.so_far, coming.length)),
            None => None,
        }
    }

    /// Takes the data of a frame. The bytes of a longer message are written into `words`, of which a message
    /// with a length of up to `room` bytes may begin; with 0, none may.
    ///
    /// A frame that begins a message ends the one before it (ISO 15765-2:2016, table 23). That is told by
    /// [`Receiver::progress`] before the call, and by what the frame means after it.
    #[inline(never)]
    pub fn take(&mut self, data: &[u8], words: &mut [u32], room: usize) -> Heard {
        let Some((&head, rest)) = data.split_first() else {
            return Heard::Nothing;
        };
        match head >> 4 {
            0 => self.single(head, rest),
            1 => self.first(data, words, room),
            2 => self.next(head, rest, words),
            // Flow controls are for senders, and others are reserved.
            _ => Heard::Nothing,
        }
    }

    fn single(&mut self, length: u8, rest: &[u8]) -> Heard {
        let count = usize::from(length);
        if length == 0 || count > SINGLE {
            return Heard::Nothing;
        }
        let Some(bytes) = rest.get(..count) else {
            return Heard::Nothing;
        };
        self.coming = None;
        let mut message = [0; SINGLE];
        // loop-bound: 7
        for (to, from) in message.iter_mut().zip(bytes) {
            *to = *from;
        }
        Heard::Single(message, length)
    }

    fn first(&mut self, data: &[u8], words: &mut [u32], room: usize) -> Heard {
        let Ok(&[high, low, a, b, c, d, e, f]) = <&[u8; 8]>::try_from(data) else {
            return Heard::Nothing;
        };
        let short = usize::from(high & 0xF) << 8 | usize::from(low);
        let (length, bytes) = if short == 0 {
            (
                u32::from_be_bytes([a, b, c, d]) as usize,
                [e, f, 0, 0, 0, 0],
            )
        } else {
            (short, [a, b, c, d, e, f])
        };
        let bytes: &[u8] = match short {
            // A length in four bytes that needs only twelve bits is none.
            0 if length <= SHORT => return Heard::Nothing,
            0 => bytes.get(..2).unwrap_or_default(),
            // A message that fits into one frame has no first one.
            _ if length <= SINGLE => return Heard::Nothing,
            _ => &bytes,
        };
        self.coming = None;
        if length > room.min(words.len().saturating_mul(4)) {
            return Heard::Failed(Failure::TooLong);
        }
        put(words, 0, bytes);
        self.coming = Some(Coming {
            length,
            so_far: bytes.len(),
            next: 1,
            left: BLOCK,
            waited: 0,
        });
        Heard::Begun { length }
    }

    fn next(&mut self, head: u8, rest: &[u8], words: &mut [u32]) -> Heard {
        let Some(coming) = &mut self.coming else {
            return Heard::Nothing;
        };
        let missing = coming.length.saturating_sub(coming.so_far);
        // A shorter frame than it must be is ignored; the number of the next one is wrong then.
        let Some(bytes) = rest.get(..missing.min(SINGLE)) else {
            return Heard::Nothing;
        };
        if head & 0xF != coming.next {
            self.coming = None;
            return Heard::Failed(Failure::Sequence);
        }
        put(words, coming.so_far, bytes);
        coming.so_far += bytes.len();
        coming.next = (coming.next + 1) & 0xF;
        coming.waited = 0;
        if coming.so_far >= coming.length {
            let length = coming.length;
            self.coming = None;
            return Heard::Whole { length };
        }
        coming.left = coming.left.saturating_sub(1);
        if coming.left == 0 {
            coming.left = BLOCK;
            return Heard::Block;
        }
        Heard::Nothing
    }

    /// Time passes: the tenth call without a frame in between ends a reception. With a call in each 100 ms this is
    /// the standard's time (`N_Cr`, 1000 ms).
    pub fn wait(&mut self) -> Heard {
        let Some(coming) = &mut self.coming else {
            return Heard::Nothing;
        };
        coming.waited += 1;
        if coming.waited < PATIENCE {
            return Heard::Nothing;
        }
        self.coming = None;
        Heard::Failed(Failure::Silence)
    }
}

/// Why a message cannot be sent on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Unsent {
    /// The receiver has no room for it.
    Overflow,
    /// The flow state is reserved.
    FlowState,
}

/// What a sender waits for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Turn {
    First,
    /// A flow control.
    Flow,
    /// Frames that may be sent; `None`: all that are left.
    Frames(Option<u8>),
}

/// Sends one message.
#[derive(Clone, Copy, Debug)]
pub struct Sender<'a> {
    left: &'a [u8],
    length: usize,
    next: u8,
    turn: Turn,
}

impl<'a> Sender<'a> {
    /// A sender of these bytes, 1 to 4 294 967 295.
    pub const fn new(message: &'a [u8]) -> Self {
        Self {
            left: message,
            length: message.len(),
            next: 1,
            turn: Turn::First,
        }
    }

    /// Bytes that have been handed out, and how many there are.
    pub const fn progress(&self) -> (usize, usize) {
        (self.length - self.left.len(), self.length)
    }

    /// True if every frame has been handed out.
    pub const fn is_done(&self) -> bool {
        self.left.is_empty()
    }

    /// True while a flow control is needed to go on.
    pub const fn waits(&self) -> bool {
        matches!(self.turn, Turn::Flow) && !self.left.is_empty()
    }

    /// The next frame, if one may be sent now.
    pub fn frame(&mut self) -> Option<[u8; 8]> {
        if self.left.is_empty() {
            return None;
        }
        let mut frame = [PADDING; 8];
        let head: &[u8] = match &mut self.turn {
            Turn::First if self.length <= SINGLE => {
                self.turn = Turn::Frames(None);
                &[self.length as u8]
            }
            Turn::First => {
                self.turn = Turn::Flow;
                let [a, b, c, d] = (self.length as u32).to_be_bytes();
                if self.length <= SHORT {
                    &[0x10 | c, d]
                } else {
                    &[0x10, 0, a, b, c, d]
                }
            }
            Turn::Flow => return None,
            Turn::Frames(granted) => {
                if let Some(granted) = granted {
                    *granted -= 1;
                }
                if *granted == Some(0) {
                    self.turn = Turn::Flow;
                }
                let number = self.next;
                self.next = (number + 1) & 0xF;
                &[0x20 | number]
            }
        };
        let (first, rest) = frame.split_at_mut(head.len());
        first.copy_from_slice(head);
        let (now, later) = self.left.split_at(rest.len().min(self.left.len()));
        rest[..now.len()].copy_from_slice(now);
        self.left = later;
        Some(frame)
    }

    /// Takes a frame of the receiver. Anything but a flow control is ignored, and so is one that nobody waits for.
    ///
    /// # Errors
    /// The receiver refuses the message.
    pub fn flow(&mut self, data: &[u8]) -> Result<(), Unsent> {
        let [head, block, _, ..] = data else {
            return Ok(());
        };
        if head >> 4 != 3 || !self.waits() {
            return Ok(());
        }
        match *head {
            CLEAR => self.turn = Turn::Frames((*block != 0).then_some(*block)),
            WAIT => {}
            OVERFLOW => return Err(Unsent::Overflow),
            _ => return Err(Unsent::FlowState),
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    /// Room of the receiver in the tests, bytes.
    const ROOM: usize = 6000;

    fn words() -> Vec<u32> {
        std::vec![0xA5A5_A5A5; ROOM / 4]
    }

    fn bytes(words: &[u32], length: usize) -> Vec<u8> {
        let all = words.iter().flat_map(|word| word.to_le_bytes());
        all.take(length).collect()
    }

    /// All frames of a message to a receiver that grants blocks.
    fn frames(message: &[u8]) -> Vec<[u8; 8]> {
        let mut sender = Sender::new(message);
        let mut frames = Vec::new();
        while !sender.is_done() {
            match sender.frame() {
                Some(frame) => frames.push(frame),
                None => sender.flow(&clear_to_send()).unwrap(),
            }
        }
        frames
    }

    /// What a receiver hears of frames, without those that say nothing.
    fn heard(receiver: &mut Receiver, words: &mut [u32], frames: &[[u8; 8]]) -> Vec<Heard> {
        let all = frames.iter();
        let all = all.map(|frame| receiver.take(frame, words, ROOM));
        all.filter(|heard| *heard != Heard::Nothing).collect()
    }

    fn message(length: usize) -> Vec<u8> {
        (0..length).map(|at| (at * 7 + at / 256) as u8).collect()
    }

    /// ISO 15765-2:2016, 9.6, and the frames of `can-isotp` 2.0.7 (PyPI) with `tx_padding=0xCC`, in
    /// `transport.txt`: length of the message, then its frames, of long ones the first four and the last.
    #[test]
    fn frames_are_those_of_another_program() {
        let text = include_str!("transport.txt");
        let lines = text.lines().filter(|line| !line.starts_with('#'));
        let mut count = 0;
        for line in lines {
            let (length, written) = line.split_once(": ").unwrap();
            let length: usize = length.parse().unwrap();
            let own = frames(&message(length));
            let hex = |frame: &[u8; 8]| -> std::string::String {
                frame
                    .iter()
                    .map(|byte| std::format!("{byte:02X}"))
                    .collect()
            };
            let all: Vec<_> = own.iter().map(hex).collect();
            let shown: Vec<_> = if all.len() > 6 {
                all[..4].iter().chain(all.last()).cloned().collect()
            } else {
                all
            };
            assert_eq!(shown.join(" "), written, "{length} bytes");
            count += 1;
        }
        assert_eq!(count, 8);
    }

    #[test]
    fn a_message_that_is_too_long_is_refused() {
        let mut words = words();
        let mut receiver = Receiver::new();
        let long = message(ROOM + 1);
        let said = heard(&mut receiver, &mut words, &frames(&long)[..20]);
        assert_eq!(said, [Heard::Failed(Failure::TooLong)]);
        assert!(words.iter().all(|word| *word == 0xA5A5_A5A5));
        // The whole range of lengths, and a caller that has no room now.
        let huge = [0x10, 0, 0xFF, 0xFF, 0xFF, 0xFF, 1, 2];
        let said = receiver.take(&huge, &mut words, usize::MAX);
        assert_eq!(said, Heard::Failed(Failure::TooLong));
        let said = receiver.take(&frames(&message(8))[0], &mut words, 0);
        assert_eq!(said, Heard::Failed(Failure::TooLong));
        assert_eq!(receiver.progress(), None);
        let mut sender = Sender::new(&long);
        assert!(sender.frame().is_some() && sender.frame().is_none());
        assert_eq!(sender.flow(&overflow()), Err(Unsent::Overflow));
    }

    #[test]
    fn lengths_that_lie_begin_nothing() {
        let mut words = words();
        let mut receiver = Receiver::new();
        for frame in [
            // Too short for a first frame, and none as it fits into a single one.
            &[0x10, 8, 1, 2, 3, 4, 5][..],
            &[0x10, 7, 1, 2, 3, 4, 5, 6],
            // An escape that needs none.
            &[0x10, 0, 0, 0, 0x0F, 0xFF, 1, 2],
            // No length, too long for its frame, and too long for any.
            &[0, 1, 2, 3, 4, 5, 6, 7],
            &[3, 1, 2],
            &[8, 1, 2, 3, 4, 5, 6, 7],
            &[],
            // Nothing has begun; flow controls and reserved frames.
            &[0x21, 1, 2, 3, 4, 5, 6, 7],
            &[0x30, 0, 0],
            &[0x40, 1, 2, 3, 4, 5, 6, 7],
        ] {
            assert_eq!(receiver.take(frame, &mut words, ROOM), Heard::Nothing);
            assert_eq!(receiver.progress(), None);
        }
    }

    #[test]
    fn a_silent_sender_is_given_up() {
        let mut words = words();
        let mut receiver = Receiver::new();
        let all = frames(&message(40));
        heard(&mut receiver, &mut words, &all[..1]);
        for _ in 1..PATIENCE {
            assert_eq!(receiver.wait(), Heard::Nothing);
        }
        // A frame in time begins the count again.
        heard(&mut receiver, &mut words, &all[1..2]);
        for _ in 1..PATIENCE {
            assert_eq!(receiver.wait(), Heard::Nothing);
        }
        assert_eq!(receiver.wait(), Heard::Failed(Failure::Silence));
        assert_eq!(receiver.wait(), Heard::Nothing);
        assert_eq!(heard(&mut receiver, &mut words, &all[2..]), []);
    }

    proptest! {
        /// Whatever its length, a message arrives whole, with a flow control for each block.
        #[test]
        fn a_message_arrives(message in prop::collection::vec(any::<u8>(), 1..ROOM)) {
            let (mut words, mut receiver) = (words(), Receiver::new());
            let all = frames(&message);
            let said = heard(&mut receiver, &mut words, &all);
            if let [Heard::Single(data, length)] = said[..] {
                prop_assert_eq!(&data[..usize::from(length)], &message);
            } else {
                let last = Heard::Whole { length: message.len() };
                prop_assert_eq!(said.first(), Some(&Heard::Begun { length: message.len() }));
                prop_assert_eq!(said.last(), Some(&last));
                prop_assert_eq!(said.len(), 2 + (all.len() - 2) / usize::from(BLOCK));
                prop_assert_eq!(bytes(&words, message.len()), message);
            }
        }

        /// A frame that is lost, doubled or out of order ends the message, or it is the last one that was lost.
        #[test]
        fn a_disturbed_message_is_none(
            length in 20..2000_usize, at: prop::sample::Index, kind in 0..3
        ) {
            let (mut words, mut receiver) = (words(), Receiver::new());
            let mut all = frames(&message(length));
            let at = 1 + at.index(all.len() - 2);
            match kind {
                0 => { all.remove(at); }
                1 => all.insert(at, all[at]),
                _ => all.swap(at, at + 1),
            }
            let said = heard(&mut receiver, &mut words, &all);
            let whole = said.iter().any(|said| matches!(said, Heard::Whole { .. }));
            prop_assert!(!whole);
            prop_assert_eq!(said.last(), Some(&Heard::Failed(Failure::Sequence)));
        }

        /// One that begins anew is received whole, however much of another came before.
        #[test]
        fn a_new_message_ends_the_one_before(cut in 1..60_usize, length in 8..500_usize) {
            let (mut words, mut receiver) = (words(), Receiver::new());
            let before = frames(&message(500));
            heard(&mut receiver, &mut words, &before[..cut.min(before.len())]);
            let all = frames(&message(length));
            let said = heard(&mut receiver, &mut words, &all);
            prop_assert_eq!(said.last(), Some(&Heard::Whole { length }));
            prop_assert_eq!(bytes(&words, length), message(length));
        }

        /// No frames write beyond the length that was announced, and none break the receiver.
        #[test]
        fn any_frames_are_taken(
            frames in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..9), 0..200), room in 0..600_usize
        ) {
            let mut words = words();
            let mut receiver = Receiver::new();
            for frame in &frames {
                let said = receiver.take(frame, &mut words, room);
                if let Heard::Whole { length } | Heard::Begun { length } = said {
                    prop_assert!(length <= room);
                }
                prop_assert!(receiver.progress().is_none_or(|(so_far, length)| so_far < length && length <= room));
            }
            let beyond = words.iter().skip(room.div_ceil(4));
            prop_assert!(beyond.into_iter().all(|word| *word == 0xA5A5_A5A5));
        }
    }
}
