//! The board of a node: its part on its clocks, and what the program has of it.

use parts::Sled;

use wcet::part::{Areas, Core, Part, STM32_FAST, bus_waits};

use crate::units::Picoseconds;

/// A board.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Board {
    /// Its part, on the clocks that it runs on.
    pub part: Part,
    /// Clock of the core after a reset, in Hz.
    pub reset_hz: u32,
    /// Bytes of the stack.
    pub stack_bytes: u32,
    /// Time by which a transmission begins before its time mark; zero without a bus.
    pub transmit_lead: Picoseconds,
}

impl From<&Sled> for Board {
    fn from(sled: &Sled) -> Self {
        Self {
            part: part(sled),
            reset_hz: sled.part.hsi.hz,
            stack_bytes: sled.stack.size,
            transmit_lead: sled.transmit_lead_ps(),
        }
    }
}

/// A sled's part on its external clock: flash wait states and line length at the core's clock. RAM waits
/// one cycle for a DMA transfer.
///
/// # Panics
/// If the clock is above the highest of the part; the crate `parts` has no such sled.
#[must_use]
pub fn part(sled: &Sled) -> Part {
    let (part, clocks) = (sled.part, &sled.external);
    let waits = part.flash_access.wait_states(clocks.core);
    let mut ram = part.ram.iter().map(|ram| (ram.base, ram.end() - 1));
    let stretches = [ram.next(), ram.next()].map(Option::unwrap_or_default);
    let stretches = &stretches[..part.ram.len().min(2)];
    Part {
        core: Core::CortexM4,
        core_hz: clocks.core,
        priority_bits: part.priority_bits,
        start_mask: Some(HIGHEST_TASK),
        multiply_cycles: 1,
        flash: Areas::new(&FLASH),
        flash_waits: u32::from(waits.expect("a sled runs within the limits of its part")),
        line_bytes: part.flash_access.line_bytes,
        reads_ahead: true,
        instruction_lines: part.flash_access.instruction_lines,
        constant_lines: part.flash_access.data_lines,
        ram: Areas::new(stretches),
        ram_waits: 0,
        peripheral_waits: bus_waits(clocks.core, clocks.apb1),
        fast_peripherals: STM32_FAST,
        fast_waits: bus_waits(clocks.core, clocks.apb2),
        inert: Some(CRC),
    }
}

/// Value of `BASEPRI` that masks all tasks. It cannot mask the priority value 0, so the nodes give that to no
/// task; the F446 gives it to an interrupt that does not return.
const HIGHEST_TASK: u8 = 0x10;

/// Flash and its alias, and the flash beside the program: boot loader, one-time words, identity of the part
/// (RM0390 3.3, RM0316 4.2).
const FLASH: [(u32, u32); 2] = [(0x0000_0000, 0x0fff_ffff), (0x1fff_0000, 0x1fff_ffff)];

/// The CRC unit of both parts (RM0390 2.2.2, RM0316 3.2.2).
const CRC: (u32, u32) = (0x4002_3000, 0x4002_33ff);
