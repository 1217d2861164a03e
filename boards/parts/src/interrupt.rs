//! Interrupt numbers (RM0390 10.2 table 38, RM0316 14.1.3 table 82).
//!
//! Both parts number these interrupts alike. The board crates compare them with the
//! interrupt enumerations of their peripheral access crates.

use crate::Family;

/// The voltage detector, by line 16 of EXTI.
pub const PVD: u16 = 1;
/// Line 0 of EXTI; lines 1 to 4 follow.
pub const EXTI0: u16 = 6;
/// DMA1, stream 0 of the F4 or channel 1 of the F3. The next ones follow.
pub const DMA1_FIRST: u16 = 11;
/// ADC1.
pub const ADC: u16 = 18;
/// First of the four interrupts of the CAN controller: transmit, receive FIFO 0, receive
/// FIFO 1, status change.
pub const CAN: u16 = 19;
/// TIM2; TIM3 and TIM4 follow.
pub const TIM2: u16 = 28;
/// USART1; USART2 and USART3 follow.
pub const USART1: u16 = 37;
/// TIM7, on the F3 with the second converter to analogue.
pub const TIM7: u16 = 55;

/// Interrupt of a stream (F4) or channel (F3) of a DMA controller; both count from 0.
#[must_use]
pub const fn dma(family: Family, controller: usize, unit: usize) -> u16 {
    match (family, controller, unit) {
        (Family::F4, 0, 7) => 47,
        (Family::F4, 1, 0..=4) => 56 + unit as u16,
        (Family::F4, 1, _) => 63 + unit as u16,
        _ => DMA1_FIRST + unit as u16,
    }
}
