//! From bytes to frames.

use super::crc::{between, update};

const PREAMBLE: u8 = 0x55;
// Where the fields of a frame are.
const KIND: usize = 1;
const SENDER: usize = 3;
const LENGTH: usize = 5;
const HEADER: usize = 6;
const CHECKSUM: usize = 2;

/// Longest payload that the length byte can say.
pub const MAX_PAYLOAD: usize = 255;
/// Bytes that the parser keeps: the longest frame, of which all but the last byte may have
/// to wait for it, and 7.6 ms of what comes behind it until it is looked at.
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

    /// `N` bytes of the payload and what follows it, from this one on.
    #[inline(always)]
    pub(super) fn field<const N: usize>(&self, from: usize) -> [u8; N] {
        let begin = self.at.wrapping_add(HEADER + from);
        core::array::from_fn(|index| byte(self.cells, begin.wrapping_add(index)))
    }
}

/// How far [`Parser::next`] came.
#[derive(Clone, Copy)]
pub enum Progress<'a> {
    /// To the end of a frame.
    Frame(Frame<'a>),
    /// As far as one call goes.
    More,
    /// To where bytes are missing.
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
/// The bytes of the candidate stay until its checksum is known. When it is wrong only the
/// preamble is dropped and the rest is looked at again, so that a frame which begins inside
/// a damaged one is not lost with it. With every byte the checksum of all before it is kept,
/// from which that of any candidate follows in constant time: however damaged a stream is,
/// each of its bytes is taken once and decided once.
#[derive(Clone, Debug)]
pub struct Parser {
    cells: [Cell; CAPACITY],
    /// Where the candidate begins, and where the next byte goes. Both count on; their
    /// remainders are places in the buffer.
    begin: usize,
    end: usize,
    checksum: u16,
    /// Candidates with a wrong checksum, those with the right one, and the bytes of these.
    errors: u32,
    frames: u32,
    framed: usize,
}

impl Default for Parser {
    fn default() -> Self {
        Self::new()
    }
}

/// A byte of the stream in the low bits, the checksum of all before it in the high half.
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

    /// Takes bytes as they come, a [`LOT`] or as many as there is room for. True when it was a
    /// whole lot: there may be more.
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

    /// Goes over `places` places, or to the end of a frame of this length or longer, which is
    /// handed out. To be called again as long as bytes are not missing: either way it has gone
    /// over as many bytes.
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
