//! The DMA controllers: streams of the F446 (RM0390 chapter 9), channels of the F303
//! (RM0316 chapter 13), behind one engine that moves one item for each request.
//!
//! A controller serves one request at a time, that of the highest priority first, and each takes the
//! cycles of [`transfer`]. Until then the peripheral's data register is not accessed, so a program
//! that reads it meanwhile takes the byte away. The core does not wait for the buses. Copies from
//! memory to memory take no time. The stream FIFO, bursts and the peripheral flow controller are
//! not modelled: a stream works in direct mode whatever its FIFO register says.

use crate::clock::Cycles;
use crate::part::Family;

/// Cycles from a request to the access to the peripheral: request and arbitration, the bus matrix,
/// and two cycles of the peripheral's bus, which has `divider` AHB cycles each (AN4031, section on
/// transfer times of the DMA ports; RM0390 9.3.6 for the order). The F303's documents give no
/// number.
pub(crate) const fn transfer(divider: u64) -> Cycles {
    4 + 2 * divider
}

/// The next item that a unit moves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Move {
    pub from: u32,
    pub to: u32,
    /// Bytes read and bytes written.
    pub from_size: u32,
    pub to_size: u32,
}

/// A stream or channel.
#[derive(Clone, Copy, Debug, Default)]
struct Unit {
    /// SxCR or CCRx.
    control: u32,
    /// NDTR as written, and the number of items left.
    count: u32,
    left: u32,
    peripheral: u32,
    memory: [u32; 2],
    fifo: u32,
    /// Offsets of the next item.
    peripheral_offset: u32,
    memory_offset: u32,
    half: bool,
    complete: bool,
    error: bool,
}

/// Half transfer, transfer complete, error: bits in the unified order of
/// [`Dma::interrupt`].
#[derive(Clone, Debug)]
pub(crate) struct Dma {
    family: Family,
    units: Vec<Unit>,
}

const F4_FLAG_SHIFT: [u32; 4] = [0, 6, 16, 22];

impl Dma {
    pub(crate) fn new(family: Family) -> Self {
        let units = match family {
            Family::F4 => 8,
            Family::F3 => 7,
        };
        Self {
            family,
            units: vec![Unit::default(); units],
        }
    }

    pub(crate) fn units(&self) -> usize {
        self.units.len()
    }

    /// Whether the unit is enabled and listens to `selector` (CHSEL; ignored on channels).
    pub(crate) fn listens(&self, unit: usize, selector: u32) -> bool {
        let control = self.units[unit].control;
        control & 1 != 0 && (self.family == Family::F3 || control >> 25 & 7 == selector)
    }

    /// Priority of a unit among those of its controller, the most urgent first: its level, then its
    /// number (RM0390 9.3.6, RM0316 13.4.2).
    pub(crate) fn rank(&self, unit: usize) -> (u32, usize) {
        let control = self.units[unit].control;
        let level = match self.family {
            Family::F4 => control >> 16 & 3,
            Family::F3 => control >> 12 & 3,
        };
        (3 - level, unit)
    }

    /// Whether the unit is enabled and copies memory to memory, without requests.
    pub(crate) fn copies(&self, unit: usize) -> bool {
        let control = self.units[unit].control;
        control & 1 != 0
            && match self.family {
                Family::F4 => control >> 6 & 3 == 2,
                Family::F3 => control & 1 << 14 != 0,
            }
    }

    fn circular(&self, control: u32) -> bool {
        match self.family {
            // Double buffer implies circular.
            Family::F4 => control & (1 << 8 | 1 << 18) != 0,
            Family::F3 => control & 1 << 5 != 0,
        }
    }

    /// The next item of an enabled unit.
    pub(crate) fn item(&self, unit: usize) -> Option<Move> {
        let u = &self.units[unit];
        if u.control & 1 == 0 || u.left == 0 {
            return None;
        }
        let (to_peripheral, p_size, m_size, memory) = match self.family {
            Family::F4 => (
                u.control >> 6 & 3 == 1,
                1 << (u.control >> 11 & 3),
                // Direct mode uses the peripheral's size for both (RM0390 9.3.13).
                1 << (u.control >> 11 & 3),
                u.memory[(u.control >> 19 & u.control >> 18 & 1) as usize],
            ),
            Family::F3 => (
                u.control & 1 << 4 != 0,
                1 << (u.control >> 8 & 3),
                1 << (u.control >> 10 & 3),
                u.memory[0],
            ),
        };
        let peripheral = u.peripheral.wrapping_add(u.peripheral_offset);
        let memory = memory.wrapping_add(u.memory_offset);
        Some(if to_peripheral {
            Move {
                from: memory,
                to: peripheral,
                from_size: m_size,
                to_size: p_size,
            }
        } else {
            Move {
                from: peripheral,
                to: memory,
                from_size: p_size,
                to_size: m_size,
            }
        })
    }

    /// Counts a moved item. True if it was the last one of the buffer.
    pub(crate) fn moved(&mut self, unit: usize) -> bool {
        let circular = self.circular(self.units[unit].control);
        let family = self.family;
        let u = &mut self.units[unit];
        let (p_inc, m_inc, p_size, m_size) = match family {
            Family::F4 => (
                u.control & 1 << 9 != 0,
                u.control & 1 << 10 != 0,
                1 << (u.control >> 11 & 3),
                1 << (u.control >> 11 & 3),
            ),
            Family::F3 => (
                u.control & 1 << 6 != 0,
                u.control & 1 << 7 != 0,
                1 << (u.control >> 8 & 3),
                1 << (u.control >> 10 & 3),
            ),
        };
        if p_inc {
            u.peripheral_offset = u.peripheral_offset.wrapping_add(p_size);
        }
        if m_inc {
            u.memory_offset = u.memory_offset.wrapping_add(m_size);
        }
        u.left = u.left.saturating_sub(1);
        if u.left == u.count / 2 {
            u.half = true;
        }
        if u.left > 0 {
            return false;
        }
        u.complete = true;
        if circular {
            u.left = u.count;
            u.peripheral_offset = 0;
            u.memory_offset = 0;
            if family == Family::F4 && u.control & 1 << 18 != 0 {
                u.control ^= 1 << 19;
            }
        } else if family == Family::F4 {
            // The hardware clears EN (RM0390 9.3.9). A channel keeps it set but waits for a new
            // CNDTR.
            u.control &= !1;
        }
        true
    }

    /// A bus error stops the unit.
    pub(crate) fn fail(&mut self, unit: usize) {
        let u = &mut self.units[unit];
        u.error = true;
        u.control &= !1;
    }

    /// Level of the unit's interrupt line.
    pub(crate) fn interrupt(&self, unit: usize) -> bool {
        let u = &self.units[unit];
        let enabled = |bit: u32| u.control & 1 << bit != 0;
        match self.family {
            Family::F4 => u.half && enabled(3) || u.complete && enabled(4) || u.error && enabled(2),
            Family::F3 => u.half && enabled(2) || u.complete && enabled(1) || u.error && enabled(3),
        }
    }

    pub(crate) fn read(&self, offset: u32) -> Option<u32> {
        match self.family {
            Family::F4 => self.read_stream(offset),
            Family::F3 => self.read_channel(offset),
        }
    }

    pub(crate) fn write(&mut self, offset: u32, value: u32) {
        match self.family {
            Family::F4 => self.write_stream(offset, value),
            Family::F3 => self.write_channel(offset, value),
        }
    }

    fn read_stream(&self, offset: u32) -> Option<u32> {
        match offset {
            0x00 | 0x04 => {
                let first = offset as usize;
                Some((0..4).fold(0, |word, k| {
                    let u = &self.units[first + k];
                    let flags = u32::from(u.error) << 3
                        | u32::from(u.half) << 4
                        | u32::from(u.complete) << 5;
                    word | flags << F4_FLAG_SHIFT[k]
                }))
            }
            0x08 | 0x0C => Some(0),
            0x10..=0xCC => {
                let u = &self.units[((offset - 0x10) / 0x18) as usize];
                Some(match (offset - 0x10) % 0x18 {
                    0x00 => u.control,
                    0x04 => u.left,
                    0x08 => u.peripheral,
                    0x0C => u.memory[0],
                    0x10 => u.memory[1],
                    _ => u.fifo,
                })
            }
            _ => None,
        }
    }

    fn write_stream(&mut self, offset: u32, value: u32) {
        match offset {
            0x08 | 0x0C => {
                let first = (offset - 0x08) as usize;
                for (k, shift) in F4_FLAG_SHIFT.into_iter().enumerate() {
                    self.clear(
                        first + k,
                        value >> shift & 1 << 4 != 0,
                        value >> shift & 1 << 5 != 0,
                        value >> shift & 1 << 3 != 0,
                    );
                }
            }
            0x10..=0xCC => {
                let unit = ((offset - 0x10) / 0x18) as usize;
                let u = &mut self.units[unit];
                let enabled = u.control & 1 != 0;
                match (offset - 0x10) % 0x18 {
                    0x00 => self.control(unit, value),
                    0x04 if !enabled => {
                        u.count = value & 0xFFFF;
                        u.left = u.count;
                    }
                    0x08 if !enabled => u.peripheral = value,
                    // With double buffering the idle half may be changed (RM0390 9.3.10).
                    0x0C if !enabled || u.control & 3 << 18 == 3 << 18 => u.memory[0] = value,
                    0x10 if !enabled || u.control & 3 << 18 == 1 << 18 => u.memory[1] = value,
                    0x14 => u.fifo = value & 0xBF,
                    _ => {}
                }
            }
            _ => {}
        }
    }

    fn read_channel(&self, offset: u32) -> Option<u32> {
        match offset {
            0x00 => Some(self.units.iter().enumerate().fold(0, |word, (k, u)| {
                let any = u.half || u.complete || u.error;
                let flags = u32::from(any)
                    | u32::from(u.complete) << 1
                    | u32::from(u.half) << 2
                    | u32::from(u.error) << 3;
                word | flags << (4 * k)
            })),
            0x04 => Some(0),
            0x08..=0x93 => {
                let u = &self.units[((offset - 0x08) / 20) as usize];
                Some(match (offset - 0x08) % 20 {
                    0x00 => u.control,
                    0x04 => u.left,
                    0x08 => u.peripheral,
                    0x0C => u.memory[0],
                    _ => 0,
                })
            }
            _ => None,
        }
    }

    fn write_channel(&mut self, offset: u32, value: u32) {
        match offset {
            0x04 => {
                for k in 0..self.units.len() {
                    let flags = value >> (4 * k);
                    let all = flags & 1 != 0;
                    self.clear(
                        k,
                        all || flags & 4 != 0,
                        all || flags & 2 != 0,
                        all || flags & 8 != 0,
                    );
                }
            }
            0x08..=0x93 => {
                let unit = ((offset - 0x08) / 20) as usize;
                let u = &mut self.units[unit];
                let enabled = u.control & 1 != 0;
                match (offset - 0x08) % 20 {
                    0x00 => self.control(unit, value & 0x7FFF),
                    0x04 if !enabled => {
                        u.count = value & 0xFFFF;
                        u.left = u.count;
                    }
                    0x08 if !enabled => u.peripheral = value,
                    0x0C if !enabled => u.memory[0] = value,
                    _ => {}
                }
            }
            _ => {}
        }
    }

    fn control(&mut self, unit: usize, value: u32) {
        let family = self.family;
        let u = &mut self.units[unit];
        let was = u.control & 1 != 0;
        // A stream cannot be enabled while one of its flags is set (RM0390 9.3.18).
        let refused = family == Family::F4 && !was && (u.half || u.complete || u.error);
        u.control = if refused { value & !1 } else { value };
        if !was && u.control & 1 != 0 {
            u.peripheral_offset = 0;
            u.memory_offset = 0;
            if family == Family::F4 {
                u.count = u.left;
            }
        }
        // Disabling a stream sets its complete flag (RM0390 9.3.18).
        if family == Family::F4 && was && u.control & 1 == 0 {
            u.complete = true;
        }
    }

    fn clear(&mut self, unit: usize, half: bool, complete: bool, error: bool) {
        let u = &mut self.units[unit];
        u.half &= !half;
        u.complete &= !complete;
        u.error &= !error;
    }
}

#[cfg(test)]
mod tests {
    use super::{Dma, Move};
    use crate::part::Family;

    #[test]
    fn a_circular_stream_flags_half_and_end_and_starts_over() {
        let mut dma = Dma::new(Family::F4);
        // DMA2 stream 2: 0x10 + 2 * 0x18.
        let base = 0x40;
        dma.write(base + 0x04, 4);
        dma.write(base + 0x08, 0x4001_1004);
        dma.write(base + 0x0C, 0x2000_0100);
        dma.write(base, 4 << 25 | 1 << 10 | 1 << 8 | 1 << 4 | 1 << 3 | 1);
        assert!(dma.listens(2, 4));
        assert!(!dma.listens(2, 5));
        for k in 0..4 {
            assert_eq!(
                dma.item(2),
                Some(Move {
                    from: 0x4001_1004,
                    to: 0x2000_0100 + k,
                    from_size: 1,
                    to_size: 1
                })
            );
            let last = dma.moved(2);
            assert_eq!(last, k == 3);
            let flags = dma.read(0x00).unwrap() >> 16;
            assert_eq!(flags & 1 << 4 != 0, k >= 1, "half after two of four");
            assert_eq!(flags & 1 << 5 != 0, k == 3);
        }
        assert_eq!(dma.read(base + 4), Some(4));
        assert_eq!(dma.item(2).unwrap().to, 0x2000_0100);
        assert!(dma.interrupt(2));
        dma.write(0x08, 0x30 << 16);
        assert!(!dma.interrupt(2));
    }

    #[test]
    fn a_stream_that_ends_disables_itself_and_wants_its_flags_cleared() {
        let mut dma = Dma::new(Family::F4);
        let base = 0x10 + 6 * 0x18;
        dma.write(base + 0x04, 1);
        dma.write(base, 1 << 6 | 1 << 10 | 4 << 25 | 1);
        dma.moved(6);
        assert_eq!(dma.read(base).unwrap() & 1, 0);
        dma.write(base + 0x04, 1);
        dma.write(base, 1 << 6 | 1 << 10 | 4 << 25 | 1);
        assert!(!dma.listens(6, 4), "the complete flag still stands");
        dma.write(0x0C, 0x3F << 16);
        dma.write(base, 1 << 6 | 1 << 10 | 4 << 25 | 1);
        assert!(dma.listens(6, 4));
    }

    #[test]
    fn a_channel_keeps_its_enable_bit_and_its_sizes_apart() {
        let mut dma = Dma::new(Family::F3);
        dma.write(0x08 + 4, 2);
        dma.write(0x08 + 8, 0x5000_0040);
        dma.write(0x08 + 12, 0x2000_0000);
        // Peripheral 16 bits, memory 16 bits, memory increments, complete interrupt.
        dma.write(0x08, 1 << 10 | 1 << 8 | 1 << 7 | 1 << 1 | 1);
        dma.moved(0);
        assert_eq!(dma.item(0).unwrap().to, 0x2000_0002);
        assert!(dma.moved(0));
        assert_eq!(dma.read(0x08).unwrap() & 1, 1);
        assert_eq!(dma.item(0), None);
        assert_eq!(dma.read(0), Some(0b0111));
        assert!(dma.interrupt(0));
        dma.write(0x04, 1);
        assert_eq!(dma.read(0), Some(0));
    }
}
