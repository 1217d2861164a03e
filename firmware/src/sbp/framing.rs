//! From bytes to frames.

use super::crc16;

const PREAMBLE: u8 = 0x55;
const HEADER: usize = 6;
const CHECKSUM: usize = 2;
const BUFFER: usize = HEADER + MAX_PAYLOAD + CHECKSUM;

/// Longest payload that the length byte can say.
pub const MAX_PAYLOAD: usize = 255;

/// A complete frame whose checksum is right.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame<'a> {
    /// Message type.
    pub kind: u16,
    /// Sender's identity.
    pub sender: u16,
    /// Payload.
    pub payload: &'a [u8],
}

/// What happened to the bytes; every counter wraps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    /// Frames with the right checksum.
    pub frames: u32,
    /// Candidates with a wrong checksum.
    pub checksum_errors: u32,
    /// Bytes that belong to no frame.
    pub skipped: u32,
}

/// Streaming parser.
///
/// The bytes of the candidate stay until its checksum is known. When it is wrong only the
/// preamble is dropped and the rest is looked at again, so that a frame which begins inside
/// a damaged one is not lost with it.
#[derive(Clone, Debug)]
pub struct Parser {
    buffer: [u8; BUFFER],
    length: usize,
    counters: Counters,
}

impl Default for Parser {
    fn default() -> Self {
        Self::new()
    }
}

impl Parser {
    /// A parser that waits for a preamble.
    pub const fn new() -> Self {
        Self {
            buffer: [0; BUFFER],
            length: 0,
            counters: Counters {
                frames: 0,
                checksum_errors: 0,
                skipped: 0,
            },
        }
    }

    /// What happened so far.
    pub const fn counters(&self) -> Counters {
        self.counters
    }

    /// Takes one byte and hands every frame that it completes to `sink`; more than one only
    /// after a damaged frame.
    ///
    /// Cost: constant but for the byte that ends a candidate, which costs one pass over it,
    /// and for a wrong checksum, after which the kept bytes are gone through again.
    #[inline]
    pub fn push(&mut self, byte: u8, sink: impl FnMut(Frame<'_>)) {
        if let Some(slot) = self.buffer.get_mut(self.length) {
            *slot = byte;
            self.length += 1;
        }
        if self.length == 1 {
            if byte != PREAMBLE {
                self.length = 0;
                self.counters.skipped = self.counters.skipped.wrapping_add(1);
            }
        } else if self.candidate().is_some() {
            // at-most: 20 the shortest frames in half the ring
            self.settle(sink);
        }
    }

    /// Length of the candidate at the front, once all of it is there.
    #[inline]
    fn candidate(&self) -> Option<usize> {
        let whole = HEADER + usize::from(self.buffer[HEADER - 1]) + CHECKSUM;
        (self.length >= HEADER && self.length >= whole).then_some(whole)
    }

    fn settle(&mut self, mut sink: impl FnMut(Frame<'_>)) {
        // loop-bound: 32 the shortest frames in the longest buffer
        // at-most: 40 every frame and what is looked at again after a damaged one
        while let Some(whole) = self.candidate() {
            let used = match check(self.buffer.get(..whole)) {
                Some(frame) => {
                    self.counters.frames = self.counters.frames.wrapping_add(1);
                    // at-most: 8 messages of interest in half the ring
                    sink(frame);
                    whole
                }
                None => {
                    self.counters.checksum_errors = self.counters.checksum_errors.wrapping_add(1);
                    self.counters.skipped = self.counters.skipped.wrapping_add(1);
                    1
                }
            };
            self.discard(used);
        }
    }

    /// Drops `used` bytes and everything from there to the next preamble.
    fn discard(&mut self, used: usize) {
        let rest = self.buffer.get(used..self.length).unwrap_or(&[]);
        // loop-bound: 263 the whole buffer
        // at-most: 430 half the ring and the buffer, none twice but after a damaged frame
        let junk = rest
            .iter()
            .position(|&byte| byte == PREAMBLE)
            .unwrap_or(rest.len());
        self.counters.skipped = self.counters.skipped.wrapping_add(junk as u32);
        let from = used + junk;
        let left = self.length.saturating_sub(from);
        // loop-bound: 263 the whole buffer
        // at-most: 430 half the ring and the buffer, none twice but after a damaged frame
        for to in 0..left {
            let byte = self.buffer.get(from + to).copied().unwrap_or(0);
            if let Some(slot) = self.buffer.get_mut(to) {
                *slot = byte;
            }
        }
        self.length = left;
    }
}

/// Takes a complete candidate apart; `None` when its checksum is wrong.
fn check(candidate: Option<&[u8]>) -> Option<Frame<'_>> {
    let candidate = candidate?;
    let (covered, received) = candidate.split_last_chunk::<CHECKSUM>()?;
    let (_, covered) = covered.split_first()?;
    if crc16(0, covered) != u16::from_le_bytes(*received) {
        return None;
    }
    let (&[t0, t1, s0, s1, _], payload) = covered.split_first_chunk::<{ HEADER - 1 }>()?;
    Some(Frame {
        kind: u16::from_le_bytes([t0, t1]),
        sender: u16::from_le_bytes([s0, s1]),
        payload,
    })
}
