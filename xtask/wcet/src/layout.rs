//! Where memory and peripherals lie in the address space of the targets.

use super::part::Part;
use super::range::Range;

/// Top of the stack as the analysis places it.
///
/// No part of the targets maps this address, so a stack address is never equal to that of a
/// static variable or of a register: the external memory controllers of the STM32 are below and above. The real stack is elsewhere; the two have only the low three bits in
/// common, as the stack is 8-byte aligned on entry.
pub(crate) const STACK_TOP: u32 = 0xb010_0000;
/// Lowest address of the stack as the analysis places it.
const STACK_LIMIT: u32 = 0xb000_0000;
/// Every address taken for the stack, the callers' frames above [`STACK_TOP`] included.
pub(crate) const STACK: Range = Range::arc(STACK_LIMIT, 0x0020_0000, 1);

/// Address space of RAM.
pub(crate) const RAM: Range = Range::between(0x1000_0000, 0x21ff_ffff);
/// Bit-band alias of RAM: each word stands for one bit.
pub(crate) const BIT_BAND: Range = Range::between(0x2200_0000, 0x23ff_ffff);
/// Peripherals.
pub(crate) const PERIPHERALS: Range = Range::between(0x4000_0000, 0x5fff_ffff);

/// The first address of a memory that no small number looks like.
pub(crate) const NO_NUMBER: u32 = 0x0800_0000;

/// Whether `word` may be an address of flash or RAM of this part. One of a flash that begins at zero is
/// none, because a number may look like it.
#[must_use]
pub(crate) fn leads_to_memory(part: &Part, word: u32) -> bool {
    part.ram.contains(word) || word >= NO_NUMBER && part.flash.contains(word)
}
