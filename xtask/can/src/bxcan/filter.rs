//! Acceptance filter banks (RM0390, bxCAN, "Identifier filtering").

use super::registers as reg;

/// Banks of a part with two controllers.
const BANKS: usize = 28;

/// The receive FIFO that a frame goes to, and the filter match index stored with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Match {
    pub fifo: usize,
    pub index: u8,
}

/// The filter banks. Two controllers share them on parts that have two.
#[derive(Clone, Debug)]
pub(crate) struct FilterBanks {
    count: usize,
    /// True if CAN2SB divides the banks between two controllers.
    dual: bool,
    fmr: u32,
    mode: u32,
    scale: u32,
    assignment: u32,
    active: u32,
    banks: [[u32; 2]; BANKS],
}

impl FilterBanks {
    /// The banks of one controller (14) or of a pair (28) after reset.
    pub(crate) fn new(dual: bool) -> Self {
        Self {
            count: if dual { BANKS } else { BANKS / 2 },
            dual,
            fmr: 0x2A1C_0E01,
            mode: 0,
            scale: 0,
            assignment: 0,
            active: 0,
            banks: [[0; 2]; BANKS],
        }
    }

    /// The same number of banks after a reset.
    pub(crate) fn after_reset(&self) -> Self {
        Self::new(self.dual)
    }

    const fn bits(&self) -> u32 {
        (1 << self.count) - 1
    }

    const fn initialising(&self) -> bool {
        self.fmr & 1 == 1
    }

    pub(crate) fn read(&self, offset: u32) -> u32 {
        match offset {
            reg::FMR => self.fmr,
            reg::FM1R => self.mode,
            reg::FS1R => self.scale,
            reg::FFA1R => self.assignment,
            reg::FA1R => self.active,
            _ => self
                .bank(offset)
                .map_or(0, |(bank, word)| self.banks[bank][word]),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) {
        let bits = self.bits();
        match offset {
            reg::FMR => {
                let writable = if self.dual { 0x3F01 } else { 0x0001 };
                self.fmr = (self.fmr & !writable) | (value & writable);
            }
            reg::FM1R if self.initialising() => self.mode = value & bits,
            reg::FS1R if self.initialising() => self.scale = value & bits,
            reg::FFA1R if self.initialising() => self.assignment = value & bits,
            reg::FA1R => self.active = value & bits,
            _ => {
                if let Some((bank, word)) = self.bank(offset)
                    && (self.initialising() || self.active >> bank & 1 == 0)
                {
                    self.banks[bank][word] = value;
                }
            }
        }
    }

    fn bank(&self, offset: u32) -> Option<(usize, usize)> {
        let word = usize::try_from(offset.checked_sub(reg::F0R1)? / 4).ok()?;
        (word / 2 < self.count).then_some((word / 2, word % 2))
    }

    /// The best filter for a received identifier in the format of RIxR. With `second`, the banks
    /// are those of the second controller.
    ///
    /// A 32-bit filter takes precedence over a 16-bit one, then a list over a mask, then the lower
    /// number. Filter numbers count separately for each FIFO over all banks of a controller, active
    /// or not.
    pub(crate) fn matching(&self, rir: u32, second: bool) -> Option<Match> {
        if self.initialising() {
            return None;
        }
        let start_of_second = if self.dual {
            ((self.fmr >> 8 & 0x3F) as usize).min(self.count)
        } else {
            self.count
        };
        let range = if second {
            start_of_second..self.count
        } else {
            0..start_of_second
        };
        let mut numbers = [0_u8; 2];
        let mut best: Option<((bool, bool), Match)> = None;
        for bank in range {
            let wide = self.scale >> bank & 1 == 1;
            let list = self.mode >> bank & 1 == 1;
            let fifo = (self.assignment >> bank & 1) as usize;
            let filters = if wide { 1 } else { 2 } * if list { 2 } else { 1 };
            let first = numbers[fifo];
            numbers[fifo] += filters;
            if self.active >> bank & 1 == 0 {
                continue;
            }
            let Some(which) = hit(self.banks[bank], wide, list, rir) else {
                continue;
            };
            let rank = (wide, list);
            if best.is_none_or(|(so_far, _)| rank > so_far) {
                let index = first + which;
                best = Some((rank, Match { fifo, index }));
            }
        }
        best.map(|(_, found)| found)
    }
}

/// The number, within its bank, of the first filter that accepts the identifier.
fn hit(bank: [u32; 2], wide: bool, list: bool, rir: u32) -> Option<u8> {
    if wide {
        let id = rir & !1;
        let [first, second] = bank.map(|word| word & !1);
        return if list {
            [first, second].iter().position(|entry| *entry == id)
        } else {
            ((id ^ first) & second == 0).then_some(0)
        }
        .map(|index| index as u8);
    }
    // STID[10:0], RTR, IDE, EXID[17:15].
    let id = (rir >> 16 & 0xFFE0)
        | (rir & reg::ir::RTR) << 3
        | (rir & reg::ir::IDE) << 1
        | (rir >> 18 & 0b111);
    let halves = bank.map(|word| [word & 0xFFFF, word >> 16]);
    if list {
        halves
            .as_flattened()
            .iter()
            .position(|entry| *entry == id)
            .map(|index| index as u8)
    } else {
        halves
            .iter()
            .position(|[identifier, mask]| (id ^ identifier) & mask == 0)
            .map(|index| index as u8)
    }
}
