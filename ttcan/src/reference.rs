//! What a reference message carries.
//!
//! In ISO 11898-4 the level 1 reference has one byte (Next_is_Gap and the cycle
//! count). The level 2 reference also has the master's reference mark
//! (Master_Ref_Mark), which hardware inserts while the frame is on the bus.
//! Without such hardware the mark can only follow in the next reference. Here it
//! is the global time of the *previous* reference's start of frame:
//!
//! | field | width | contents |
//! | --- | --- | --- |
//! | application | up to the first field | bytes of the application |
//! | coarse | 4 bytes, big-endian | planned start of this reference in global time, in ms |
//! | control | 1 byte | bit 7 Next_is_Gap, bit 6 discontinuity, bits 5..0 cycle count |
//! | mark | 2 bytes, big-endian | global time of the previous reference's start of frame in 1/32 us, modulo 2048 us |
//!
//! The mark stands last. A sender that knows none leaves it out, so a frame may be
//! shorter than the format says.

use crate::frame::Frame;
use crate::id::Id;
use crate::time::GlobalTime;

/// Where the fields of a reference message stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReferenceFormat {
    application: u8,
    coarse: Option<u8>,
    control: u8,
    mark: Option<u8>,
    /// Number of data bytes with all fields.
    longest: u8,
}

impl ReferenceFormat {
    /// ISO 11898-4 level 1: the control byte alone.
    pub const LEVEL_1: Self = Self::new(0, None, 0, None);
    /// Level 2 without bytes of the application: coarse, control, mark.
    pub const LEVEL_2: Self = Self::new(0, Some(0), 4, Some(5));

    /// A format with `application` bytes of the application in front, and the
    /// fields at these byte positions. Level 2 (global time) needs both `coarse`
    /// and `mark`.
    ///
    /// [`SystemMatrix::new`](crate::SystemMatrix::new) refuses fields that overlap
    /// or exceed byte 7.
    pub const fn new(application: u8, coarse: Option<u8>, control: u8, mark: Option<u8>) -> Self {
        Self {
            application,
            coarse,
            control,
            mark,
            longest: match mark {
                Some(mark) => mark.saturating_add(2),
                None => control.saturating_add(1),
            },
        }
    }

    /// Whether the fields stand in the order of the module's table, without
    /// overlap and within 8 bytes.
    pub(crate) const fn is_valid(&self) -> bool {
        let control = match self.coarse {
            Some(coarse) if coarse < self.application || coarse > 4 => return false,
            Some(coarse) => coarse + 4,
            None => self.application,
        };
        if self.control < control || self.control > 7 {
            return false;
        }
        match self.mark {
            Some(mark) => mark > self.control && mark <= 6,
            None => true,
        }
    }

    /// Number of data bytes of a reference with all fields.
    pub const fn longest(&self) -> u8 {
        self.longest
    }

    /// Whether references carry the fields of level 2.
    pub(crate) const fn tells_time(&self) -> bool {
        self.coarse.is_some() && self.mark.is_some()
    }

    /// Number of bytes in front for the application.
    pub const fn application(&self) -> u8 {
        self.application
    }
}

/// The fields of one reference message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default)]
pub(crate) struct Fields {
    pub next_is_gap: bool,
    pub discontinuity: bool,
    pub cycle: u8,
    pub coarse: Option<u32>,
    pub mark: Option<u16>,
}

const GAP: u8 = 0x80;
const DISCONTINUITY: u8 = 0x40;
const CYCLE: u8 = 0x3F;

/// Bits of global time (in 2^-16 us) below the mark's resolution of 1/32 us.
const MARK_SHIFT: u32 = GlobalTime::FRACTION_BITS - 5;

/// The mark of a global time.
pub(crate) const fn mark_of(time: GlobalTime) -> u16 {
    (time.raw() >> MARK_SHIFT) as u16
}

/// The global time nearest to `estimate` that has this mark. It is the right one if
/// the error of the estimate is less than 1024 us.
pub(crate) const fn nearest(estimate: GlobalTime, mark: u16) -> GlobalTime {
    let ahead = mark.wrapping_sub(mark_of(estimate)).cast_signed();
    let below = estimate.raw() & ((1 << MARK_SHIFT) - 1);
    estimate.offset(((ahead as i64) << MARK_SHIFT) - below as i64)
}

/// Global time from a coarse time, which wraps every 2^32 ms (49 days). Of the
/// possible times the one nearest to `known` is taken, up to 4 years after the
/// epoch, and some time of this coarse time beyond that; without `known`, the first.
pub(crate) fn from_coarse(coarse: u32, known: Option<GlobalTime>) -> GlobalTime {
    let time = GlobalTime::from_micros(u64::from(coarse) * 1000);
    let Some(known) = known else {
        return time;
    };
    // 2^32 ms are 1000 times 2^48 of the time's units; 500 of them are half.
    let ahead = (known.since(time) >> 48) as i32;
    let wraps = (ahead + 500).max(0).cast_unsigned() / 1000;
    time.offset(i64::from(wraps).wrapping_mul(1000 << 48))
}

impl Fields {
    /// The frame with identifier `id` and the application's bytes.
    pub(crate) fn encode(&self, format: &ReferenceFormat, id: Id, application: &[u8; 8]) -> Frame {
        let mut data = *application;
        if let (Some(at), Some(coarse)) = (format.coarse, self.coarse) {
            put(&mut data, at, coarse.to_be_bytes());
        }
        let control = self.cycle & CYCLE
            | if self.next_is_gap { GAP } else { 0 }
            | if self.discontinuity { DISCONTINUITY } else { 0 };
        put(&mut data, format.control, [control]);
        let mut len = format.control.wrapping_add(1);
        if let (Some(at), Some(mark)) = (format.mark, self.mark) {
            put(&mut data, at, mark.to_be_bytes());
            len = format.longest;
        }
        Frame::from_parts(id, len, data)
    }

    /// The fields of `frame`, `None` if it does not have them. In a matrix of one
    /// basic cycle, the control byte and all fields behind it may be missing.
    pub(crate) fn decode(format: &ReferenceFormat, frame: &Frame, cycles: u8) -> Option<Self> {
        let data = frame.data();
        let mut fields = Self::default();
        match data.get(usize::from(format.control)) {
            Some(control) => {
                fields.next_is_gap = control & GAP != 0;
                fields.discontinuity = control & DISCONTINUITY != 0;
                fields.cycle = control & CYCLE;
            }
            None if cycles == 1 && data.len() == usize::from(format.control) => {}
            None => return None,
        }
        if fields.cycle >= cycles || data.len() > usize::from(format.longest()) {
            return None;
        }
        fields.coarse = format
            .coarse
            .and_then(|at| get(data, at))
            .map(u32::from_be_bytes);
        fields.mark = format
            .mark
            .and_then(|at| get(data, at))
            .map(u16::from_be_bytes);
        Some(fields)
    }
}

fn put<const N: usize>(data: &mut [u8; 8], at: u8, bytes: [u8; N]) {
    let behind = data.get_mut(usize::from(at)..);
    if let Some(field) = behind.and_then(<[u8]>::first_chunk_mut) {
        *field = bytes;
    }
}

fn get<const N: usize>(data: &[u8], at: u8) -> Option<[u8; N]> {
    data.get(usize::from(at)..)?.first_chunk().copied()
}

#[cfg(test)]
mod tests {
    use super::{from_coarse, mark_of, nearest};
    use crate::GlobalTime;

    const DAY: u64 = 86_400_000_000;

    #[test]
    fn the_coarse_time_wraps_every_49_days() {
        for days in [0, 1, 24, 25, 49, 50, 75, 100, 1000, 1600] {
            let time = GlobalTime::from_micros(days * DAY);
            let known = time.offset(-(1 << 40));
            assert_eq!(from_coarse(time.as_millis(), Some(known)), time, "{days}");
            let known = time.offset(1 << 40);
            assert_eq!(from_coarse(time.as_millis(), Some(known)), time, "{days}");
        }
        let week = GlobalTime::from_micros(7 * DAY);
        assert_eq!(from_coarse(week.as_millis(), None), week);
    }

    /// The application of a master may set any time.
    #[test]
    fn the_coarse_time_is_found_beside_any_time() {
        for coarse in [0, 1, 0x7FFF_FFFF, 0x8000_0000, u32::MAX] {
            for known in (0..=u64::MAX).step_by(1 << 44).chain([u64::MAX]) {
                let known = GlobalTime::from_raw(known);
                let time = from_coarse(coarse, Some(known));
                assert_eq!(time.since(GlobalTime::default()) & 0xFFFF, 0);
            }
        }
    }

    #[test]
    fn a_mark_is_found_from_an_estimate_a_millisecond_off() {
        for micros in [0u64, 1, 1023, 1024, 2047, 2048, 123_456_789] {
            let time = GlobalTime::from_micros(micros + 10_000);
            for off in [-1023i64, -500, -1, 0, 1, 500, 1023] {
                assert_eq!(nearest(time.offset(off << 16), mark_of(time)), time);
            }
        }
    }
}
