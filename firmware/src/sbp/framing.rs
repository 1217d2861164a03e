//! From bytes to frames.

use super::crc::{between, update};

const PREAMBLE: u8 = 0x55;
// Where the fields of a frame are.
const KIND: usize = 1;
const SENDER: usize = 3;
const LENGTH: usize = 5;
const HEADER: usize = 6;
const CHECKSUM: usize = 2;

/// Longest payload that the length byte can encode.
pub const MAX_PAYLOAD: usize = 255;
/// Bytes that the parser keeps: the longest frame, which may have to wait for its last byte,
/// and the bytes that arrive in the next 7.6 ms, until it is checked.
pub const CAPACITY: usize = 1024;
const _: () = assert!(CAPACITY.is_power_of_two());

/// Bytes that one call of [`Parser::take`] takes at most.
pub const LOT: usize = 32;
/// A complete frame whose checksum is right.
#[derive(Clone, Copy)]
pub struct Frame<'a> {
    cells: &'a [Cell; CAPACITY],
    at: usize,
}

impl Frame<'_> {
    /// Message type.
    pub fn kind(&self) -> u16 {
        pair(self.cells, self.at.wrapping_add(KIND))
    }

    /// Sender's identity.
    pub fn sender(&self) -> u16 {
        pair(self.cells, self.at.wrapping_add(SENDER))
    }

    /// Length of the payload.
    pub fn length(&self) -> u8 {
        byte(self.cells, self.at.wrapping_add(LENGTH))
    }

    /// `N` bytes from offset `from` of the payload on; they may reach beyond its end.
    #[inline(always)]
    pub(super) fn field<const N: usize>(&self, from: usize) -> [u8; N] {
        let begin = self.at.wrapping_add(HEADER + from);
        core::array::from_fn(|index| byte(self.cells, begin.wrapping_add(index)))
    }
}

/// Why [`Parser::next`] returned.
#[derive(Clone, Copy)]
pub enum Progress<'a> {
    /// It reached the end of a frame.
    Frame(Frame<'a>),
    /// It went as far as one call may go.
    More,
    /// It needs bytes that have not arrived.
    Drained,
}

/// Counters of bytes and frames; every counter wraps.
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
/// The bytes of a candidate are kept until its checksum is known. If the checksum is wrong,
/// only the preamble is dropped and the rest is parsed again: so a frame that begins inside a
/// damaged one is not lost. With each byte the parser stores the checksum of all bytes before
/// it. The checksum of any candidate follows from two of these in constant time, so the cost of
/// a byte is bounded however damaged the stream is.
#[derive(Clone, Debug)]
pub struct Parser {
    cells: [Cell; CAPACITY],
    /// Where the candidate begins, and where the next byte goes. Both only grow; modulo the
    /// capacity they are indices of the buffer.
    begin: usize,
    end: usize,
    checksum: u16,
    /// Candidates with a wrong checksum, frames, and the bytes of all frames.
    errors: u32,
    frames: u32,
    framed: usize,
}

impl Default for Parser {
    fn default() -> Self {
        Self::new()
    }
}

/// A byte of the stream in the low bits, the checksum of all bytes before it in the high half.
type Cell = u32;

#[inline(always)]
const fn byte(cells: &[Cell; CAPACITY], at: usize) -> u8 {
    cells[at % CAPACITY] as u8
}

#[inline(always)]
const fn checksum(cells: &[Cell; CAPACITY], at: usize) -> u16 {
    (cells[at % CAPACITY] >> 16) as u16
}

#[inline(always)]
const fn pair(cells: &[Cell; CAPACITY], at: usize) -> u16 {
    u16::from_le_bytes([byte(cells, at), byte(cells, at.wrapping_add(1))])
}

impl Parser {
    /// A parser that waits for a preamble.
    pub const fn new() -> Self {
        Self {
            cells: [0; CAPACITY],
            begin: 0,
            end: 0,
            checksum: 0,
            errors: 0,
            frames: 0,
            framed: 0,
        }
    }

    /// Counters so far.
    pub const fn counters(&self) -> Counters {
        Counters {
            frames: self.frames,
            checksum_errors: self.errors,
            skipped: self.begin.wrapping_sub(self.framed) as u32,
        }
    }

    /// Takes bytes that have arrived: at most [`LOT`], and only as many as there is room for.
    /// True if it took a full lot, so that there may be more.
    #[inline(always)]
    pub fn take(&mut self, bytes: impl ExactSizeIterator<Item = u8>) -> bool {
        let room = CAPACITY - self.end.wrapping_sub(self.begin);
        let count = bytes.len().min(room).min(LOT);
        let (mut end, mut checksum) = (self.end, self.checksum);
        for byte in bytes.take(count) {
            self.cells[end % CAPACITY] = u32::from(checksum) << 16 | u32::from(byte);
            checksum = update(checksum, byte);
            end = end.wrapping_add(1);
        }
        (self.end, self.checksum) = (end, checksum);
        count == LOT
    }

    /// Examines up to `places` positions of the stream. Stops early at the end of a frame that
    /// is at least `places` bytes long, and returns it; shorter frames are passed over. Call
    /// this again until it reports missing bytes; each call before that consumes at least
    /// `places` bytes.
    #[inline(always)]
    pub fn next(&mut self, places: usize) -> Progress<'_> {
        let mut begin = self.begin;
        let (mut frames, mut framed, mut errors) = (0, 0, 0);
        let mut found = None;
        let mut drained = false;
        for _ in 0..places {
            let kept = self.end.wrapping_sub(begin);
            if kept == 0 {
                drained = true;
                break;
            }
            let mut passed = 1;
            if byte(&self.cells, begin) == PREAMBLE {
                let length = byte(&self.cells, begin.wrapping_add(LENGTH));
                let covered = HEADER + usize::from(length);
                if kept < covered + CHECKSUM {
                    drained = true;
                    break;
                }
                let end = begin.wrapping_add(covered);
                let first = checksum(&self.cells, begin.wrapping_add(KIND));
                let second = checksum(&self.cells, end);
                if between(first, second, length) == pair(&self.cells, end) {
                    passed = covered + CHECKSUM;
                    frames += 1;
                    framed += passed;
                    if passed >= places {
                        found = Some(begin);
                        begin = begin.wrapping_add(passed);
                        break;
                    }
                } else {
                    errors += 1;
                }
            }
            begin = begin.wrapping_add(passed);
        }
        self.begin = begin;
        self.frames = self.frames.wrapping_add(frames);
        self.framed = self.framed.wrapping_add(framed);
        self.errors = self.errors.wrapping_add(errors);
        match found {
            Some(at) => Progress::Frame(Frame {
                cells: &self.cells,
                at,
            }),
            None if drained => Progress::Drained,
            None => Progress::More,
        }
    }
}
