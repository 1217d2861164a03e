//! The bytes of a flash that can be changed, and what changes them.

use crate::clock::Cycles;
use parts::Memory;

/// The keys that unlock the control register, in their order.
pub(super) const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];

/// The lock of the control register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Gate {
    Locked,
    /// The first key was written.
    Half,
    Open,
    /// A wrong key was written: nothing but a reset helps.
    Barred,
}

impl Gate {
    /// A key is written.
    pub(super) const fn turn(self, key: u32) -> Self {
        match self {
            Self::Locked if key == KEYS[0] => Self::Half,
            Self::Half if key == KEYS[1] => Self::Open,
            Self::Open => Self::Open,
            _ => Self::Barred,
        }
    }
}

/// What the bytes from `at` on become at the end.
#[derive(Clone, Debug)]
struct Running {
    until: Cycles,
    at: usize,
    bytes: Vec<u8>,
}

/// Contents, and the operation that runs. One that a reset or a loss of power ends leaves chance behind.
#[derive(Clone, Debug)]
pub(super) struct Changing {
    /// Offset of the first byte in the flash.
    begin: u32,
    contents: Vec<u8>,
    running: Option<Running>,
    chance: u32,
}

impl Changing {
    /// The part `place` of this whole flash, which begins at `base`; nothing without a place.
    pub(super) fn new(place: Option<&Memory>, base: u32, flash: &[u8]) -> Self {
        let (begin, contents) = match place {
            Some(place) => {
                let begin = place.base - base;
                let range = begin as usize..(begin + place.size) as usize;
                (begin, flash.get(range).unwrap_or_default().to_vec())
            }
            None => (0, Vec::new()),
        };
        Self {
            begin,
            contents,
            running: None,
            chance: 0x2545_F491,
        }
    }

    pub(super) fn range(&self) -> (u32, usize) {
        (self.begin, self.contents.len())
    }

    pub(super) fn bytes(&self, offset: u32, size: usize) -> Option<&[u8]> {
        let at = offset.checked_sub(self.begin)? as usize;
        self.contents.get(at..at.checked_add(size)?)
    }

    /// When the operation ends that runs.
    pub(super) fn end(&self) -> Option<Cycles> {
        self.running.as_ref().map(|running| running.until)
    }

    /// What runs ends where it is.
    pub(super) fn stop(&mut self) {
        self.running = None;
    }

    /// Ends what is over. Whether something was.
    pub(super) fn advance(&mut self, now: Cycles) -> bool {
        let Some(running) = self.running.take_if(|running| running.until <= now) else {
            return false;
        };
        let end = running.at + running.bytes.len();
        if let Some(target) = self.contents.get_mut(running.at..end) {
            target.copy_from_slice(&running.bytes);
        }
        true
    }

    fn random(&mut self) -> u32 {
        self.chance ^= self.chance << 13;
        self.chance ^= self.chance >> 17;
        self.chance ^= self.chance << 5;
        self.chance
    }

    /// Begins an operation, which makes these bytes of what is at this offset of the flash. Until it ends, some of
    /// their bits have changed.
    pub(super) fn begin(&mut self, offset: u32, bytes: Vec<u8>, until: Cycles) {
        let at = (offset - self.begin) as usize;
        for (place, byte) in bytes.iter().enumerate() {
            let chance = self.random() as u8;
            if let Some(old) = self.contents.get_mut(at + place) {
                *old ^= (*old ^ byte) & chance;
            }
        }
        self.running = Some(Running { until, at, bytes });
    }
}
