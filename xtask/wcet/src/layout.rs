//! Where memory and peripherals lie in the address space of the targets.

use super::range::Range;

/// Top of the stack as the analysis places it.
///
/// No part of the targets maps this address, so a stack address is never equal to that of a
/// static variable. The real stack is elsewhere; the two have only the low three bits in
/// common, as the stack is 8-byte aligned on entry.
pub(crate) const STACK_TOP: u32 = 0xa010_0000;
/// Lowest address of the stack as the analysis places it.
const STACK_LIMIT: u32 = 0xa000_0000;
/// Every address taken for the stack, the callers' frames above [`STACK_TOP`] included.
pub(crate) const STACK: Range = Range::arc(STACK_LIMIT, 0x0020_0000, 1);

/// Flash of the parts.
pub(crate) const FLASH: Range = Range::between(0x0800_0000, 0x0fff_ffff);
/// Address space of RAM.
pub(crate) const RAM: Range = Range::between(0x1000_0000, 0x21ff_ffff);
/// The most RAM that a part has: core-coupled, and on the bus matrix.
pub(crate) const FITTED_RAM: [Range; 2] = [
    Range::between(0x1000_0000, 0x1000_ffff),
    Range::between(0x2000_0000, 0x2002_ffff),
];
/// Bit-band alias of RAM: each word stands for one bit.
pub(crate) const BIT_BAND: Range = Range::between(0x2200_0000, 0x23ff_ffff);
/// Peripherals.
pub(crate) const PERIPHERALS: Range = Range::between(0x4000_0000, 0x5fff_ffff);

/// The CRC unit of both parts (RM0390 2.2.2, RM0316 3.2.2). It has no access to memory, and takes
/// any word as data, also one that looks like an address.
pub(crate) const CRC: Range = Range::between(0x4002_3000, 0x4002_33ff);

/// Whether `word` may be an address of flash or RAM.
#[must_use]
pub(crate) fn leads_to_memory(word: u32) -> bool {
    FLASH.contains(word) || RAM.contains(word)
}
