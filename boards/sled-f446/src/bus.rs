//! The CAN port: CAN1, RX PB8, TX PB9, 250 kbit/s from 45 MHz.

use crate::{clocks::APB1_HZ, pac};
use stm32f4xx_hal::can::Can;
use ttcan::BitTiming;

/// Bits per second.
pub const BIT_RATE: u32 = 250_000;

/// The CAN port of this sled.
pub type CanPort = sled_common::can::Port<Can<pac::CAN1>>;

/// 250 kbit/s from 45 MHz; the build fails when no setting fits.
pub const BIT_TIMING: BitTiming = BitTiming::constant::<APB1_HZ, BIT_RATE>();

const _: () = assert!(
    BIT_TIMING.bit_rate(APB1_HZ) == BIT_RATE
        && BIT_TIMING.sample_point_per_mille() >= 700
        && BIT_TIMING.sample_point_per_mille() <= 800,
    "250 kbit/s with a sample point of 70 to 80 % (thesis 6.2.3.1)"
);

pub(crate) fn start(instance: Can<pac::CAN1>) -> CanPort {
    CanPort::new(instance, BIT_TIMING)
}
