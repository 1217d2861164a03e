//! End-to-end protection of the actuator commands.
//!
//! A protected message has two bytes for it, D6 and D7. What they carry depends on whether the
//! node has a key ([`Secret`]); all nodes of a network must have the same one, or none.
//!
//! # Without a key
//!
//! D6 is a sequence counter and D7 a check value ([`check_value`]), which covers
//! the identifier, the system time of the basic cycle and D0..D6. The scheme follows the
//! AUTOSAR E2E profiles (AUTOSAR_PRS_E2EProtocol, profile 2: CRC-8 with polynomial 0x2F,
//! sequence counter, data identity in the CRC), with three differences: the counter has eight
//! bits instead of four; the CAN identifier replaces the list of data identities; and the
//! system time enters the check value without being sent. Every node knows the time from the
//! reference of the same cycle, so the thesis's frame keeps its eight bytes.
//!
//! A receiver acts on a frame only if the check value matches and the counter has advanced by
//! one or two. So these frames are refused: altered ones, those of another identifier, repeated
//! ones and those out of order. After a start or a longer gap there is no last counter to compare
//! with, so the first frame is refused, and the next one is accepted if it continues the sequence.
//!
//! A recorded frame that is sent again later is refused on a time-triggered bus, because the time
//! of its basic cycle is another one; one in 256 has the right check value by chance, and then its
//! counter must fit, too. On an event-triggered bus there is no system time: frames are sealed and
//! judged with time 0. There a recorded frame passes, however old it is, if its counter continues
//! the sequence. This scheme finds faults; it stops nobody who forges frames, since the check value
//! needs no secret.
//!
//! # With a key
//!
//! D6, D7 and every bit that belongs to no signal ([`Message::FREE`]) carry a message
//! authentication code over identifier, system time and the other bits ([`tag`]). It has 26 bits
//! in message 300. The system time takes the place of the counter: it grows from cycle to cycle,
//! and both sides know it.
//!
//! Whoever does not know the key can only guess. A wrong guess counts as suspicion, and a receiver
//! under suspicion refuses true commands too, so that the actuator stops and the operator sees
//! why. Suspicion falls with every true command. So of all guesses one in six periods can
//! move anything, and a right one does so for two periods: with 26 bits and a period of 100 ms, an hour
//! of guessing succeeds once in 11 000 times.
//!
//! The time itself needs a proof, too: see [`TimeProof`]. While it has none, nothing is sealed: a command for the
//! time of a forged reference would be true later, when that time comes. A receiver never goes back to a time before
//! that of the last true command. So who plays back references and commands of an hour ago moves
//! nothing.
//!
//! The time begins anew with each run, so recorded commands of another run would pass in a basic cycle of the same
//! time. A [`Session`] stops that: its key follows from the network's and from the starts of those who obey.
//!
//! The measurements by which the controller steers are not authenticated. An event-triggered bus has no system time: there a node with a key obeys no
//! command.

mod check;
mod secret;
mod session;
mod tag;
mod time;

pub use check::check_value;
pub use secret::{Key, RECORD, Secret};
pub use session::Session;
pub use tag::{mask, tag};
pub use time::{Answer, Open, Proof, TimeProof, time_of};

use network::Message;

/// Offset of the counter in the data.
pub const COUNTER: usize = 6;
/// Offset of the check value in the data.
pub const CHECK: usize = 7;

/// Largest step of the counter that is accepted: one frame may be lost.
const LARGEST_STEP: u8 = 2;

/// What a frame with a wrong tag adds to the suspicion, and how much suspicion refuses true commands.
/// A true command takes 1 away. So one wrong frame changes nothing, and two with at most one true one
/// between them stop the actuator, for at most [`SUSPICION_LIMIT`] periods after the last one.
const SUSPICION: u8 = 5;
const SUSPICION_LIMIT: u8 = 8;

/// Sender's side: seals frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sender {
    counter: u8,
    secret: Secret,
    /// There is no session yet.
    waits: bool,
}

impl Sender {
    /// A sender that has sent nothing.
    pub const fn new(secret: Secret) -> Self {
        Self {
            counter: 0,
            secret,
            waits: false,
        }
    }

    /// From now on frames are sealed by this secret, that of another session; without one they cannot be sealed.
    pub fn set_secret(&mut self, secret: Option<Secret>) {
        self.waits = secret.is_none();
        self.secret = secret.unwrap_or(self.secret);
    }

    /// Whether a frame can be sealed. If not it must not be sent: it would raise the suspicion of those who know
    /// their session.
    pub const fn can_seal(&self) -> bool {
        !self.waits
    }

    /// Seals the data of one frame, for the basic cycle that began at system time `time`, ms, or 0 on
    /// an event-triggered bus. Without a key the frames are numbered, and the counter wraps. With a
    /// damaged key no receiver obeys them.
    pub fn seal<M: Message>(&mut self, time: u32, data: &mut [u8; 8]) {
        let Secret::Key(key) = &self.secret else {
            data[COUNTER] = self.counter;
            data[CHECK] = check_value(M::ID, time, data);
            self.counter = self.counter.wrapping_add(1);
            return;
        };
        let mask = mask::<M>();
        let word = u64::from_le_bytes(*data) & !mask;
        *data = (word | tag(key, M::ID, time, word, mask)).to_le_bytes();
    }
}

/// Why a frame is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "target", derive(defmt::Format))]
pub enum Refusal {
    /// The check value does not match: the frame was altered, or sealed for another identifier
    /// or another basic cycle.
    Altered,
    /// The counter did not advance: the frame is a repetition, or the counter is stuck.
    Repeated,
    /// The counter or the time went back or the counter too far ahead: a replay, a frame out of
    /// order, or a longer gap.
    OutOfSequence,
    /// The first frame after a start or a gap: there is no counter to compare with.
    First,
    /// The tag does not match: the sender does not know the key, or sealed the frame for another
    /// identifier or another basic cycle.
    Forged,
    /// The frame is true, but too many before it were forged.
    Suspicion,
    /// There is no system time, so a recorded frame would pass: the bus is event-triggered.
    NoTime,
    /// The receiver's own key is damaged.
    KeyDamaged,
    /// Not all nodes of the session have told their starts, so nobody can judge the frame.
    NoSession,
}

/// Receiver's side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Receiver {
    secret: Secret,
    /// There is no session yet.
    waits: bool,
    /// The last counter.
    last: Option<u8>,
    /// System time of the last true frame.
    last_time: Option<u32>,
    suspicion: u8,
}

impl Receiver {
    /// A receiver that has seen nothing.
    pub const fn new(secret: Secret) -> Self {
        Self {
            secret,
            waits: false,
            last: None,
            last_time: None,
            suspicion: 0,
        }
    }

    /// Judges a frame that arrived in the basic cycle that began at system time `time`, ms, or on an
    /// event-triggered bus with 0.
    ///
    /// # Errors
    /// [`Refusal`] says why. A refused frame whose check value matches still sets the counter
    /// that the next frame must continue. So a replayed frame disturbs the true sequence only
    /// until the next true frame.
    pub fn judge<M: Message>(&mut self, time: u32, data: &[u8; 8]) -> Result<(), Refusal> {
        if self.waits {
            return Err(Refusal::NoSession);
        }
        match &self.secret {
            Secret::None => self.check(M::ID, time, data),
            Secret::Key(key) => {
                let mask = mask::<M>();
                let word = u64::from_le_bytes(*data);
                let forged = tag(key, M::ID, time, word, mask) != word & mask;
                self.believe(forged, time)
            }
            Secret::Damaged => Err(Refusal::KeyDamaged),
        }
    }

    /// From now on frames are judged by this secret, that of another session, or none is obeyed until there is one.
    /// The time of the last true frame and the suspicion stay.
    pub fn set_secret(&mut self, secret: Option<Secret>) {
        self.waits = secret.is_none();
        self.secret = secret.unwrap_or(self.secret);
    }

    /// Judges a frame by its check value and its counter.
    fn check(&mut self, id: u16, time: u32, data: &[u8; 8]) -> Result<(), Refusal> {
        if check_value(id, time, data) != data[CHECK] {
            return Err(Refusal::Altered);
        }
        let counter = data[COUNTER];
        let last = self.last.replace(counter);
        match last.map(|last| counter.wrapping_sub(last)) {
            Some(1..=LARGEST_STEP) => Ok(()),
            Some(0) => Err(Refusal::Repeated),
            Some(_) => Err(Refusal::OutOfSequence),
            None => Err(Refusal::First),
        }
    }

    /// Judges a frame by its tag, of which `forged` tells that it is wrong, and its time.
    fn believe(&mut self, forged: bool, time: u32) -> Result<(), Refusal> {
        if forged {
            self.suspicion = (self.suspicion + SUSPICION).min(2 * SUSPICION_LIMIT);
            return Err(Refusal::Forged);
        }
        if time == 0 {
            return Err(Refusal::NoTime);
        }
        match self
            .last_time
            .map(|last| time.wrapping_sub(last).cast_signed())
        {
            Some(0) => return Err(Refusal::Repeated),
            Some(..0) => return Err(Refusal::OutOfSequence),
            Some(_) | None => self.last_time = Some(time),
        }
        let suspicion = self.suspicion;
        self.suspicion = suspicion.saturating_sub(1);
        if suspicion > SUSPICION_LIMIT {
            return Err(Refusal::Suspicion);
        }
        Ok(())
    }

    /// Forgets the counter of the last frame. Call this after a gap in which the sender may have
    /// restarted. The time of the last true frame stays: what was sent before it must not pass again.
    pub fn forget(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::{Key, Receiver, Refusal, SUSPICION_LIMIT, Secret, Sender, check_value, mask};
    use network::{DecodeError, Message, Signal};
    use proptest::prelude::*;
    use ttcan::{Frame, Id};

    /// A protected message of this identifier, in which only some bits belong to no signal.
    #[derive(Clone, Copy, Debug)]
    struct Guarded<const ID: u16>;

    impl<const IDENTIFIER: u16> Message for Guarded<IDENTIFIER> {
        const ID: u16 = IDENTIFIER;
        const NAME: &'static str = "Guarded";
        const LENGTH: u8 = 8;
        const SHORTEST: u8 = 8;
        const FREE: u64 = 0x0000_F8F8_0000_0000;
        type Node = ();
        const SENDER: () = ();
        const SIGNALS: &'static [Signal] = &[];
        type Bytes = [u8; 8];

        fn encode(&self) -> [u8; 8] {
            [0; 8]
        }

        fn frame(&self) -> Frame {
            Frame::from_parts(Id::constant::<IDENTIFIER>(), 8, self.encode())
        }

        fn decode(_: &[u8]) -> Result<Self, DecodeError> {
            Ok(Self)
        }

        fn visit(&self, _: &mut dyn FnMut(&'static Signal, i64)) {}
    }

    type Command = Guarded<300>;

    const SECRET: Secret = Secret::Key(Key::new(*b"a secret of 16 b"));

    /// System time of the basic cycle in which the frame of this number is sent.
    fn time(index: usize) -> u32 {
        123_456_789 + 100 * index as u32
    }

    fn sequence(count: usize) -> Vec<[u8; 8]> {
        let mut sender = Sender::default();
        (0..count)
            .map(|index| {
                let mut data = [0x64, 0, 0x10, 0, 3, 3, 0, 0];
                sender.seal::<Command>(time(index), &mut data);
                data
            })
            .collect()
    }
    extern crate std;
    use std::vec::Vec;

    #[test]
    fn an_unbroken_sequence_passes_after_its_first_frame() {
        let frames = sequence(600);
        let mut receiver = Receiver::default();
        assert_eq!(
            receiver.judge::<Command>(time(0), &frames[0]),
            Err(Refusal::First)
        );
        for (index, frame) in frames.iter().enumerate().skip(1) {
            assert_eq!(receiver.judge::<Command>(time(index), frame), Ok(()));
        }
    }

    #[test]
    fn one_lost_frame_is_bridged_and_two_are_not() {
        let frames = sequence(8);
        let mut receiver = Receiver::default();
        let _ = receiver.judge::<Command>(time(0), &frames[0]);
        assert_eq!(receiver.judge::<Command>(time(2), &frames[2]), Ok(()));
        assert_eq!(
            receiver.judge::<Command>(time(5), &frames[5]),
            Err(Refusal::OutOfSequence)
        );
        assert_eq!(receiver.judge::<Command>(time(6), &frames[6]), Ok(()));
    }

    proptest! {
        /// Up to three flipped bits are always detected, and so is a burst of up to eight bits.
        #[test]
        fn flipped_bits_are_seen(data: [u8; 7], one in 0usize..64, two in 0usize..64, three in 0usize..64) {
            let [a, b, c, d, e, f, g] = data;
            let mut frame = [a, b, c, d, e, f, g, 0];
            frame[7] = check_value(300, 5, &frame);
            let sealed = frame;
            for bit in [one, two, three] {
                frame[bit / 8] ^= 1 << (bit % 8);
            }
            if frame != sealed {
                prop_assert_ne!(check_value(300, 5, &frame), frame[7]);
            }
        }

        /// A frame sealed for any other identifier of the network is refused, whatever it
        /// carries. (Of all 2048 identifiers one in 256 has the same check value.)
        #[test]
        fn a_foreign_identifier_is_seen(mut data: [u8; 8], time: u32) {
            for other in [100, 101, 200, 201, 202, 206, 401, 402, 450, 451, 452, 453, 501, 502, 511, 512, 513, 514] {
                data[7] = check_value(other, time, &data);
                prop_assert_ne!(check_value(300, time, &data), data[7]);
            }
        }

        /// Replaying any earlier frame of a run never passes, even in its own basic cycle.
        #[test]
        fn replays_are_refused(length in 4usize..250, which: prop::sample::Index) {
            let frames = sequence(length);
            let mut receiver = Receiver::default();
            for (index, frame) in frames.iter().enumerate() {
                let _ = receiver.judge::<Command>(time(index), frame);
            }
            let replayed = which.index(length);
            prop_assert!(receiver.judge::<Command>(time(replayed), &frames[replayed]).is_err());
        }

        /// A frame sealed for one basic cycle does not fit another within 255 ms before or
        /// after it: the CRC detects every change within eight consecutive bits.
        #[test]
        fn a_neighbouring_cycle_is_seen(data: [u8; 8], start: u32, apart in 1u32..256) {
            let other = start ^ apart;
            prop_assert_ne!(check_value(300, start, &data), check_value(300, other, &data));
        }
    }

    /// On an event-triggered bus, a recorded frame passes where its counter continues the sequence.
    #[test]
    fn without_a_system_time_a_recorded_frame_passes_if_its_counter_fits() {
        let mut sender = Sender::default();
        let mut seal = || {
            let mut data = [0x64, 0, 0x10, 0, 3, 3, 0, 0];
            sender.seal::<Command>(0, &mut data);
            data
        };
        let recorded: Vec<_> = (0..20).map(|_| seal()).collect();
        let mut receiver = Receiver::default();
        for frame in &recorded {
            let _ = receiver.judge::<Command>(0, frame);
        }
        assert_eq!(
            receiver.judge::<Command>(0, &recorded[9]),
            Err(Refusal::OutOfSequence)
        );
        // The counter comes round after 256 frames.
        for _ in 20..256 + 9 {
            let _ = receiver.judge::<Command>(0, &seal());
        }
        assert_eq!(receiver.judge::<Command>(0, &recorded[9]), Ok(()));
    }

    /// Of a recorded run that is played back later, one frame in 256 passes the check value,
    /// and none passes the counter.
    #[test]
    fn a_recorded_sequence_does_not_pass_later() {
        let frames = sequence(5000);
        let mut receiver = Receiver::default();
        let passed = frames
            .iter()
            .enumerate()
            .filter(|(index, frame)| {
                receiver
                    .judge::<Command>(time(index + 70_001), frame)
                    .is_ok()
            })
            .count();
        assert_eq!(passed, 0);
    }

    /// Frames of a run with a key, one in each basic cycle.
    fn keyed(count: usize) -> Vec<[u8; 8]> {
        let mut sender = Sender::new(SECRET);
        let frame = |index| {
            let mut data = [0x64, 0, 0x10, 0, 3, 3, 0, 0];
            sender.seal::<Command>(time(index), &mut data);
            data
        };
        (0..count).map(frame).collect()
    }

    #[test]
    fn a_tag_has_all_bits_that_are_free() {
        assert_eq!(mask::<Command>().count_ones(), 26);
    }

    #[test]
    fn true_frames_pass_from_the_first_on() {
        let mut receiver = Receiver::new(SECRET);
        for (index, frame) in keyed(300).iter().enumerate() {
            assert_eq!(
                receiver.judge::<Command>(time(index), frame),
                Ok(()),
                "{index}"
            );
            // The signals are as they were.
            assert_eq!(frame[..4], [0x64, 0, 0x10, 0]);
            assert_eq!((frame[4] & 7, frame[5] & 7), (3, 3));
        }
    }

    /// What passed for a true frame without a key: the check value needs no secret.
    #[test]
    fn a_frame_that_is_sealed_without_the_key_never_passes() {
        let mut forger = Sender::default();
        let mut receiver = Receiver::new(SECRET);
        let mut unkeyed = Receiver::default();
        let mut passed = 0;
        for index in 0..20 {
            let mut data = [0xFF, 0x09, 0xC8, 0, 3, 3, 0, 0];
            forger.seal::<Command>(time(index), &mut data);
            passed += u32::from(unkeyed.judge::<Command>(time(index), &data).is_ok());
            let judged = receiver.judge::<Command>(time(index), &data);
            assert_eq!(judged, Err(Refusal::Forged));
        }
        assert_eq!(passed, 19, "without a key");
    }

    #[test]
    fn two_forged_frames_with_one_true_one_between_them_are_suspicious() {
        let frames = keyed(4);
        for between in [0, 1, 2] {
            let mut receiver = Receiver::new(SECRET);
            let mut forged = frames[0];
            forged[7] ^= 1;
            let _ = receiver.judge::<Command>(time(0), &forged);
            for (index, frame) in frames.iter().enumerate().take(between) {
                let judged = receiver.judge::<Command>(time(index), frame);
                assert_eq!(judged, Ok(()));
            }
            let _ = receiver.judge::<Command>(time(0), &forged);
            let judged = receiver.judge::<Command>(time(3), &frames[3]);
            assert_eq!(judged.is_err(), between < 2, "{between}");
        }
    }

    #[test]
    fn a_burst_of_forged_frames_refuses_true_ones_for_a_while() {
        let frames = keyed(100);
        let mut receiver = Receiver::new(SECRET);
        let mut judge = |index: usize, forged: bool| {
            let mut frame = frames[index];
            if forged {
                frame[7] ^= 1;
                let judged = receiver.judge::<Command>(time(index), &frame);
                assert_eq!(judged, Err(Refusal::Forged));
            }
            receiver.judge::<Command>(time(index), &frames[index])
        };
        // A single one changes nothing.
        assert_eq!(judge(0, true), Ok(()));
        for index in 1..10 {
            assert_eq!(judge(index, false), Ok(()));
        }
        for index in 10..30 {
            let expected = if index == 10 {
                Ok(())
            } else {
                Err(Refusal::Suspicion)
            };
            assert_eq!(judge(index, true), expected, "{index}");
        }
        let limit = usize::from(SUSPICION_LIMIT);
        for index in 30..30 + 2 * limit {
            let judged = judge(index, false);
            assert!(judged.is_ok() || index < 30 + limit, "{index}: {judged:?}");
        }
    }

    /// Somebody silences the bus until the receiver forgets the sequence, and plays back what was sent
    /// before, with the time of then.
    #[test]
    fn no_gap_brings_a_time_back_that_was_before() {
        let frames = keyed(100);
        let mut receiver = Receiver::new(SECRET);
        for (index, frame) in frames.iter().enumerate() {
            let _ = receiver.judge::<Command>(time(index), frame);
        }
        receiver.forget();
        let again = frames.iter().enumerate();
        let passed = again
            .filter(|(index, frame)| receiver.judge::<Command>(time(*index), frame).is_ok())
            .count();
        assert_eq!(passed, 0);
    }

    /// There a recorded frame would pass after every gap.
    #[test]
    fn without_a_system_time_nothing_passes_with_a_key() {
        let mut sender = Sender::new(SECRET);
        let mut receiver = Receiver::new(SECRET);
        for _ in 0..5 {
            let mut data = [0; 8];
            sender.seal::<Command>(0, &mut data);
            receiver.forget();
            let judged = receiver.judge::<Command>(0, &data);
            assert_eq!(judged, Err(Refusal::NoTime));
        }
    }

    #[test]
    fn nobody_commands_a_node_whose_key_is_damaged() {
        let mut receiver = Receiver::new(Secret::Damaged);
        for (index, frame) in sequence(5).iter().chain(&keyed(5)).enumerate() {
            let judged = receiver.judge::<Command>(time(index), frame);
            assert_eq!(judged, Err(Refusal::KeyDamaged));
        }
        // What such a node sends does not pass for a frame with a key.
        let mut sender = Sender::new(Secret::Damaged);
        let mut receiver = Receiver::new(SECRET);
        for index in 0..10 {
            let mut data = [0; 8];
            sender.seal::<Command>(time(index), &mut data);
            assert!(receiver.judge::<Command>(time(index), &data).is_err());
        }
    }

    proptest! {
        /// Every changed bit is seen, and so are another time, identifier and key.
        #[test]
        fn a_tag_is_that_of_one_frame_only(
            data: [u8; 8], time: u32, change in 1..=u64::MAX, later in 1..=u32::MAX, key: [u8; 16],
        ) {
            let sealed = |secret: Secret, time| {
                let mut data = data;
                Sender::new(secret).seal::<Command>(time, &mut data);
                data
            };
            let frame = sealed(SECRET, time);
            let judge = |time, frame: &[u8; 8]| {
                Receiver::new(SECRET).judge::<Command>(time, frame)
            };
            prop_assert_eq!(judge(time, &frame), Ok(()));
            let changed = (u64::from_le_bytes(frame) ^ change).to_le_bytes();
            prop_assert_eq!(judge(time, &changed), Err(Refusal::Forged));
            prop_assert_eq!(judge(time.wrapping_add(later), &frame), Err(Refusal::Forged));
            let other = Receiver::new(SECRET).judge::<Guarded<301>>(time, &frame);
            prop_assert_eq!(other, Err(Refusal::Forged));
            let foreign = sealed(Secret::Key(Key::new(key)), time);
            prop_assert_eq!(judge(time, &foreign), Err(Refusal::Forged));
        }

        /// Neither a frame of an earlier cycle nor the same one again.
        #[test]
        fn replays_are_refused_with_a_key(length in 4usize..250, which: prop::sample::Index) {
            let frames = keyed(length);
            let mut receiver = Receiver::new(SECRET);
            for (index, frame) in frames.iter().enumerate() {
                let _ = receiver.judge::<Command>(time(index), frame);
            }
            let replayed = which.index(length);
            let again = receiver.judge::<Command>(time(replayed), &frames[replayed]);
            let expected = if replayed + 1 == length {
                Refusal::Repeated
            } else {
                Refusal::OutOfSequence
            };
            prop_assert_eq!(again, Err(expected));
        }

        /// Whatever arrives, suspicion stays a number that true frames take away.
        #[test]
        fn true_frames_end_any_attack(frames in proptest::collection::vec(any::<[u8; 8]>(), 0..100)) {
            let mut receiver = Receiver::new(SECRET);
            for frame in &frames {
                let _ = receiver.judge::<Command>(time(0), frame);
            }
            let limit = usize::from(SUSPICION_LIMIT);
            for (index, frame) in keyed(limit + 2).iter().enumerate().skip(1) {
                let judged = receiver.judge::<Command>(time(index), frame);
                prop_assert!(judged.is_ok() || index <= limit);
            }
        }
    }
}
