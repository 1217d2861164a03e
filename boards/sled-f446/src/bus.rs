//! The CAN port: CAN1, RX PB8, TX PB9.

use crate::{clocks::APB1_HZ, pac};
use parts::SLED_F446;
use sled_common::can::{Register, Registers};
use sled_common::clock::Oscillator;
use stm32f4xx_hal::can::Can;
use ttcan::BitTiming;

/// The registers of CAN1.
pub struct Cell;

/// The CAN port of this sled.
pub type CanPort = sled_common::can::Port<Can<pac::CAN1>, Cell>;

/// The bit timing of a bit rate, bit/s; the build fails when no setting fits. APB1 has the same
/// clock on both oscillators.
pub struct Timings<const BIT_RATE: u32>;

impl<const BIT_RATE: u32> Timings<BIT_RATE> {
    /// From the clock of APB1.
    pub const TIMING: BitTiming = BitTiming::constant::<APB1_HZ, BIT_RATE>();
    /// Largest error of this node's oscillator, ppm, with which it may take part in the traffic.
    pub const TOLERANCE_PPM: u32 = Self::TIMING.tolerance_ppm();

    const FITS: () = assert!(
        SLED_F446.has_bit_rate(BIT_RATE)
            && Self::TIMING.bit_rate(APB1_HZ) == BIT_RATE
            && Self::TIMING.sample_point_per_mille() >= 700
            && Self::TIMING.sample_point_per_mille() <= 800,
        "the bit rate with a sample point of 70 to 80 % (thesis 6.2.3.1)"
    );
}

/// On its RC oscillator the cell only listens, until the oscillator is trimmed.
pub(crate) fn start<const BIT_RATE: u32>(
    instance: Can<pac::CAN1>,
    oscillator: Oscillator,
) -> CanPort {
    const { Timings::<BIT_RATE>::FITS };
    let silent = oscillator == Oscillator::Internal;
    CanPort::new(instance, Timings::<BIT_RATE>::TIMING, silent)
}

// SAFETY: every address comes from the register block of the cell.
unsafe impl Registers for Cell {
    #[inline(always)]
    fn address(register: Register) -> *mut u32 {
        // SAFETY: the block exists for ever; nothing is read or written here.
        let can = unsafe { &*pac::CAN1::ptr() };
        match register {
            Register::Mcr => can.mcr().as_ptr(),
            Register::Msr => can.msr().as_ptr(),
            Register::Tsr => can.tsr().as_ptr(),
            Register::Ier => can.ier().as_ptr(),
            Register::Btr => can.btr().as_ptr(),
            Register::Esr => can.esr().as_ptr(),
            Register::Fmr => can.fmr().as_ptr(),
            Register::Fm1r => can.fm1r().as_ptr(),
            Register::Fs1r => can.fs1r().as_ptr(),
            Register::Ffa1r => can.ffa1r().as_ptr(),
            Register::Fa1r => can.fa1r().as_ptr(),
            Register::Rf0r => can.rfr(0).as_ptr(),
            Register::Ti0r => can.tx(0).tir().as_ptr(),
            Register::Tdt0r => can.tx(0).tdtr().as_ptr(),
            Register::Tdl0r => can.tx(0).tdlr().as_ptr(),
            Register::Tdh0r => can.tx(0).tdhr().as_ptr(),
            Register::Ri0r => can.rx(0).rir().as_ptr(),
            Register::Rdt0r => can.rx(0).rdtr().as_ptr(),
            Register::Rdl0r => can.rx(0).rdlr().as_ptr(),
            Register::Rdh0r => can.rx(0).rdhr().as_ptr(),
            Register::F0r1 => can.fb(0).fr1().as_ptr(),
            Register::F0r2 => can.fb(0).fr2().as_ptr(),
        }
    }
}
