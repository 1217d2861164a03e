//! How soon a peripheral can be used after the program has enabled its clock.
//!
//! The delay is that of the F4's errata (ES0298 2.2, "Delay after an RCC peripheral clock
//! enabling"): 2 AHB cycles for a peripheral on AHB, 1 + (AHB/APB prescaler) cycles for one on
//! APB. The F303's documents give no number, so the same one applies to it.
//!
//! The errata sheet also offers a barrier or a dummy read in place of the delay. Neither shortens
//! it here: users have shown on the F407 and F429 that a write right after a dummy read is lost.

use crate::clock::Cycles;
use crate::part::Family;
use crate::silicon::STORE;

/// The document that asks for the delay.
pub(crate) const DOCUMENT: &str =
    "errata sheet ES0298, delay after an RCC peripheral clock enabling";

/// Core cycles from the beginning of the store that enables a clock to the first access that
/// works. `enable` is the offset of the enable register in RCC, `apb1` and `apb2` are the AHB
/// cycles in a cycle of the buses.
pub(crate) fn delay(family: Family, enable: u32, apb1: u64, apb2: u64) -> Cycles {
    STORE + 1 + divider(family, enable, apb1, apb2)
}

/// AHB cycles in a cycle of the bus whose enable register in RCC has this offset.
pub(crate) fn divider(family: Family, enable: u32, apb1: u64, apb2: u64) -> u64 {
    match (family, enable) {
        (Family::F4, 0x40) | (Family::F3, 0x1C) => apb1,
        (Family::F4, 0x44) | (Family::F3, 0x18) => apb2,
        _ => 1,
    }
}
