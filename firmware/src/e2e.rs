//! End-to-end protection of the actuator commands.
//!
//! Message 300 carries a sequence counter (D6) and a check value (D7). The check value covers
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
//! the sequence. The scheme finds faults; it stops nobody who forges frames, since the check value
//! needs no secret.

/// Offset of the counter in the data.
const COUNTER: usize = 6;
/// Offset of the check value in the data.
const CHECK: usize = 7;

/// Largest step of the counter that is accepted: one frame may be lost.
const LARGEST_STEP: u8 = 2;

/// CRC-8H2F: polynomial 0x2F, initial value and final exclusive-or 0xFF, not reflected.
const TABLE: [u8; 16] = {
    let mut table = [0; 16];
    let mut nibble = 0;
    while nibble < 16 {
        let mut value = (nibble as u8) << 4;
        let mut bit = 0;
        while bit < 4 {
            value = if value & 0x80 != 0 {
                value << 1 ^ 0x2F
            } else {
                value << 1
            };
            bit += 1;
        }
        table[nibble] = value;
        nibble += 1;
    }
    table
};

/// The check value so far is in the low eight bits. What is shifted out of them stays above, which
/// is cheaper than to remove it each time.
#[inline]
fn update(crc: u32, byte: u8) -> u32 {
    let nibble = |crc: u32| crc << 4 ^ u32::from(TABLE[(crc >> 4 & 0xF) as usize]);
    nibble(nibble(crc ^ u32::from(byte)))
}

/// The check value of a frame: over the identifier and the system time of its basic cycle
/// (ms, as the reference carries it), low bytes first, and D0..D6.
pub fn check_value(id: u16, time: u32, data: &[u8; 8]) -> u8 {
    let crc = id.to_le_bytes().into_iter().fold(0xFF, update);
    let crc = time.to_le_bytes().into_iter().fold(crc, update);
    let [covered @ .., _] = data;
    covered.iter().fold(crc, |crc, &byte| update(crc, byte)) as u8 ^ 0xFF
}

/// Sender's side: numbers and seals frames.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Sender {
    counter: u8,
}

impl Sender {
    /// Numbers the data of one frame and writes its check value, for the basic cycle that
    /// began at system time `time`, or 0 on an event-triggered bus. The counter wraps.
    pub fn seal(&mut self, id: u16, time: u32, data: &mut [u8; 8]) {
        data[COUNTER] = self.counter;
        data[CHECK] = check_value(id, time, data);
        self.counter = self.counter.wrapping_add(1);
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
    /// The counter went back or too far ahead: a replay, a frame out of order, or a longer gap.
    OutOfSequence,
    /// The first frame after a start or a gap: there is no counter to compare with.
    First,
}

/// Receiver's side.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Receiver {
    last: Option<u8>,
}

impl Receiver {
    /// A receiver that has seen nothing.
    pub const fn new() -> Self {
        Self { last: None }
    }

    /// Judges a frame that arrived in the basic cycle that began at system time `time`, or on an
    /// event-triggered bus with 0.
    ///
    /// # Errors
    /// [`Refusal`] says why. A refused frame whose check value matches still sets the counter
    /// that the next frame must continue. So a replayed frame disturbs the true sequence only
    /// until the next true frame.
    pub fn judge(&mut self, id: u16, time: u32, data: &[u8; 8]) -> Result<(), Refusal> {
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

    /// Forgets the sequence. Call this after a gap in which the sender may have restarted.
    pub fn forget(&mut self) {
        self.last = None;
    }
}

#[cfg(test)]
mod tests {
    use super::{Receiver, Refusal, Sender, check_value, update};
    use proptest::prelude::*;

    /// AUTOSAR_SWS_CRCLibrary, 8-bit 0x2F: check values of the published test patterns.
    #[test]
    fn the_crc_gives_autosar_s_check_values() {
        let crc =
            |bytes: &[u8]| bytes.iter().fold(0xFF, |crc, &byte| update(crc, byte)) as u8 ^ 0xFF;
        assert_eq!(crc(b"123456789"), 0xDF);
        assert_eq!(crc(&[0, 0, 0, 0]), 0x12);
        assert_eq!(crc(&[0xF2, 0x01, 0x83]), 0xC2);
        assert_eq!(crc(&[0x0F, 0xAA, 0x00, 0x55]), 0xC6);
        assert_eq!(crc(&[0x00, 0xFF, 0x55, 0x11]), 0x77);
        assert_eq!(
            crc(&[0x33, 0x22, 0x55, 0xAA, 0xBB, 0xCC, 0xDD, 0xEE, 0xFF]),
            0x11
        );
        assert_eq!(crc(&[0x92, 0x6B, 0x55]), 0x33);
        assert_eq!(crc(&[0xFF, 0xFF, 0xFF, 0xFF]), 0x6C);
    }

    /// System time of the basic cycle in which the frame of this number is sent.
    fn time(index: usize) -> u32 {
        123_456_789 + 100 * index as u32
    }

    fn sequence(count: usize) -> Vec<[u8; 8]> {
        let mut sender = Sender::default();
        (0..count)
            .map(|index| {
                let mut data = [0x64, 0, 0x10, 0, 3, 3, 0, 0];
                sender.seal(300, time(index), &mut data);
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
            receiver.judge(300, time(0), &frames[0]),
            Err(Refusal::First)
        );
        for (index, frame) in frames.iter().enumerate().skip(1) {
            assert_eq!(receiver.judge(300, time(index), frame), Ok(()));
        }
    }

    #[test]
    fn one_lost_frame_is_bridged_and_two_are_not() {
        let frames = sequence(8);
        let mut receiver = Receiver::default();
        let _ = receiver.judge(300, time(0), &frames[0]);
        assert_eq!(receiver.judge(300, time(2), &frames[2]), Ok(()));
        assert_eq!(
            receiver.judge(300, time(5), &frames[5]),
            Err(Refusal::OutOfSequence)
        );
        assert_eq!(receiver.judge(300, time(6), &frames[6]), Ok(()));
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
                Sender::default().seal(other, time, &mut data);
                prop_assert_ne!(check_value(300, time, &data), data[7]);
            }
        }

        /// Replaying any earlier frame of a run never passes, even in its own basic cycle.
        #[test]
        fn replays_are_refused(length in 4usize..250, which: prop::sample::Index) {
            let frames = sequence(length);
            let mut receiver = Receiver::default();
            for (index, frame) in frames.iter().enumerate() {
                let _ = receiver.judge(300, time(index), frame);
            }
            let replayed = which.index(length);
            prop_assert!(receiver.judge(300, time(replayed), &frames[replayed]).is_err());
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
            sender.seal(300, 0, &mut data);
            data
        };
        let recorded: Vec<_> = (0..20).map(|_| seal()).collect();
        let mut receiver = Receiver::default();
        for frame in &recorded {
            let _ = receiver.judge(300, 0, frame);
        }
        assert_eq!(
            receiver.judge(300, 0, &recorded[9]),
            Err(Refusal::OutOfSequence)
        );
        // The counter comes round after 256 frames.
        for _ in 20..256 + 9 {
            let _ = receiver.judge(300, 0, &seal());
        }
        assert_eq!(receiver.judge(300, 0, &recorded[9]), Ok(()));
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
            .filter(|(index, frame)| receiver.judge(300, time(index + 70_001), frame).is_ok())
            .count();
        assert_eq!(passed, 0);
    }
}
