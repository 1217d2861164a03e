//! The CAN port: RX PA11, TX PA12. The bit rate is the same on the RC oscillator.

use crate::{clocks, pac};
use parts::SLED_F303;
use sled_common::can::{Register, Registers};
use sled_common::clock::Oscillator;
use ttcan::BitTiming;

/// The bit timings of a bit rate, bit/s; the build fails when no setting fits.
pub struct Timings<const BIT_RATE: u32>;

impl<const BIT_RATE: u32> Timings<BIT_RATE> {
    /// With the external clock.
    pub const EXTERNAL: BitTiming = BitTiming::constant::<{ clocks::EXTERNAL.apb1 }, BIT_RATE>();
    /// With the RC oscillator.
    pub const INTERNAL: BitTiming = BitTiming::constant::<{ clocks::INTERNAL.apb1 }, BIT_RATE>();
    /// Largest error of the RC oscillator, ppm, with which the node may take part in the traffic.
    pub const TOLERANCE_PPM: u32 = Self::INTERNAL.tolerance_ppm();

    const FITS: () = assert!(
        SLED_F303.has_bit_rate(BIT_RATE)
            && fits(Self::EXTERNAL, clocks::EXTERNAL.apb1, BIT_RATE)
            && fits(Self::INTERNAL, clocks::INTERNAL.apb1, BIT_RATE),
        "the bit rate with a sample point of 70 to 80 % (thesis 6.2.3.1)"
    );
}

const fn fits(timing: BitTiming, clock: u32, bit_rate: u32) -> bool {
    timing.bit_rate(clock) == bit_rate
        && timing.sample_point_per_mille() >= 700
        && timing.sample_point_per_mille() <= 800
}

/// The CAN cell, with its pins in their function.
pub struct Cell {
    _cell: pac::CAN,
}

// SAFETY: `Cell` owns the peripheral, and the pointer is its register block.
unsafe impl bxcan::Instance for Cell {
    const REGISTERS: *mut bxcan::RegisterBlock = pac::CAN::ptr() as *mut _;
}

// SAFETY: the only CAN cell of the part, with 14 filter banks (RM0316 31.3).
unsafe impl bxcan::FilterOwner for Cell {
    const NUM_FILTER_BANKS: u8 = 14;
}

/// The CAN port of this sled.
pub type CanPort = sled_common::can::Port<Cell, Cell>;

/// The pins are in their function and the cell's clock is on. On its RC oscillator the cell only
/// listens, until the oscillator is trimmed.
pub(crate) fn start<const BIT_RATE: u32>(cell: pac::CAN, oscillator: Oscillator) -> CanPort {
    const { Timings::<BIT_RATE>::FITS };
    let timing = match oscillator {
        Oscillator::External => Timings::<BIT_RATE>::EXTERNAL,
        Oscillator::Internal => Timings::<BIT_RATE>::INTERNAL,
    };
    let silent = oscillator == Oscillator::Internal;
    CanPort::new(Cell { _cell: cell }, timing, silent)
}

// SAFETY: every address comes from the register block of the cell.
unsafe impl Registers for Cell {
    #[inline(always)]
    fn address(register: Register) -> *mut u32 {
        // SAFETY: the block exists for ever; nothing is read or written here.
        let can = unsafe { &*pac::CAN::ptr() };
        match register {
            Register::Mcr => can.mcr.as_ptr(),
            Register::Msr => can.msr.as_ptr(),
            Register::Tsr => can.tsr.as_ptr(),
            Register::Ier => can.ier.as_ptr(),
            Register::Btr => can.btr.as_ptr(),
            Register::Esr => can.esr.as_ptr(),
            Register::Fmr => can.fmr.as_ptr(),
            Register::Fm1r => can.fm1r.as_ptr(),
            Register::Fs1r => can.fs1r.as_ptr(),
            Register::Ffa1r => can.ffa1r.as_ptr(),
            Register::Fa1r => can.fa1r.as_ptr(),
            Register::Rf0r => can.rfr[0].as_ptr(),
            Register::Ti0r => can.tx[0].tir.as_ptr(),
            Register::Tdt0r => can.tx[0].tdtr.as_ptr(),
            Register::Tdl0r => can.tx[0].tdlr.as_ptr(),
            Register::Tdh0r => can.tx[0].tdhr.as_ptr(),
            Register::Ri0r => can.rx[0].rir.as_ptr(),
            Register::Rdt0r => can.rx[0].rdtr.as_ptr(),
            Register::Rdl0r => can.rx[0].rdlr.as_ptr(),
            Register::Rdh0r => can.rx[0].rdhr.as_ptr(),
            Register::F0r1 => can.fb[0].fr1.as_ptr(),
            Register::F0r2 => can.fb[0].fr2.as_ptr(),
        }
    }
}
