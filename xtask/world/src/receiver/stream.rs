//! Damage to the receiver's byte stream.

use crc::{CRC_16_XMODEM, Crc};

use super::parameters::{StreamFault, StreamFaultKind};
use crate::random::{Purpose, Stream};
use crate::time::{SimTime, seconds};

/// Bytes of a frame without its payload: preamble, type, sender, length, checksum.
const OVERHEAD: usize = sbp::HEADER_LEN + sbp::CRC_LEN;

/// The first byte of a frame.
const PREAMBLE: u8 = 0x55;

/// The checksum of the Swift Binary Protocol, over type to payload.
const CHECKSUM: Crc<u16> = Crc::<u16>::new(&CRC_16_XMODEM);

/// Applies the scenario's faults of the byte stream.
#[derive(Clone, Debug)]
pub(super) struct Damage {
    faults: Vec<StreamFault>,
    random: Stream,
}

impl Damage {
    pub(super) fn new(faults: Vec<StreamFault>, seed: u64) -> Self {
        Self {
            faults,
            random: Stream::new(seed, Purpose::StreamFaults),
        }
    }

    fn active(&self, now: SimTime) -> Vec<(StreamFaultKind, f64)> {
        let now = seconds(now);
        self.faults
            .iter()
            .filter(|f| f.from.get() <= now && f.until.is_none_or(|until| now < until.get()))
            .map(|f| (f.fault, f.rate.get()))
            .collect()
    }

    /// The frames of one burst after the faults.
    pub(super) fn apply(&mut self, now: SimTime, mut frames: Vec<Vec<u8>>) -> Vec<Vec<u8>> {
        for (kind, rate) in self.active(now) {
            match kind {
                StreamFaultKind::Silence => frames.clear(),
                StreamFaultKind::Flood | StreamFaultKind::Preambles => {}
                StreamFaultKind::Flip => {
                    for byte in frames.iter_mut().flatten() {
                        if self.random.uniform() < rate {
                            *byte ^= 1 << self.random.below(8);
                        }
                    }
                }
                StreamFaultKind::Truncate => {
                    for frame in &mut frames {
                        if self.random.uniform() < rate {
                            frame.truncate(self.random.below(frame.len()));
                        }
                    }
                }
                StreamFaultKind::Length => {
                    for frame in &mut frames {
                        if self.random.uniform() < rate && frame.len() > OVERHEAD {
                            let length = self.random.byte();
                            let end = frame.len() - 2;
                            frame[5] = length;
                            let crc = CHECKSUM.checksum(&frame[1..end]).to_le_bytes();
                            frame[end..].copy_from_slice(&crc);
                        }
                    }
                }
            }
        }
        frames
    }

    /// Up to `room` bytes that fill the pause after a burst.
    pub(super) fn flood(&mut self, now: SimTime, room: usize) -> Vec<u8> {
        let active = self.active(now);
        let is = |wanted| active.iter().any(|(kind, _)| *kind == wanted);
        if is(StreamFaultKind::Preambles) {
            vec![PREAMBLE; room]
        } else if is(StreamFaultKind::Flood) {
            (0..room).map(|_| self.random.byte()).collect()
        } else {
            Vec::new()
        }
    }
}
