//! Simulation time and the bit timing of a controller's clock.

/// An instant of the simulation, in picoseconds since its start; 64 bits last for 213 days.
pub type SimTime = fugit_host::MonotonicTimerInstantU64<1_000_000_000_000>;

/// A span of simulation time, in picoseconds.
pub type SimDuration = fugit_host::TimerDurationU64<1_000_000_000_000>;

/// Picoseconds, the internal unit of the bus.
pub(crate) type Ps = u64;

pub(crate) fn instant(ps: Ps) -> SimTime {
    SimTime::from_ticks(ps)
}

/// The clock that a controller divides into time quanta: a nominal frequency and the error of its
/// crystal.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockRate {
    hertz: u32,
    offset_ppb: i32,
}

impl ClockRate {
    /// A clock of exactly `hertz`; zero is taken as 1 Hz.
    #[must_use]
    pub const fn new(hertz: u32) -> Self {
        Self {
            hertz: if hertz == 0 { 1 } else { hertz },
            offset_ppb: 0,
        }
    }

    /// The same clock, running fast by `offset_ppb` parts in 10^9 (slow if negative). The offset is
    /// limited to half the frequency.
    #[must_use]
    pub const fn with_offset_ppb(self, offset_ppb: i32) -> Self {
        const LIMIT: i32 = 500_000_000;
        let offset_ppb = if offset_ppb > LIMIT {
            LIMIT
        } else if offset_ppb < -LIMIT {
            -LIMIT
        } else {
            offset_ppb
        };
        Self { offset_ppb, ..self }
    }

    /// Time that `cycles` cycles of this clock take, rounded to the nearest picosecond.
    fn cycles(self, cycles: u32) -> Ps {
        let numerator = u128::from(cycles) * 1_000_000_000_000 * 1_000_000_000;
        let denominator =
            u128::from(self.hertz) * (1_000_000_000 + i128::from(self.offset_ppb)) as u128;
        u64::try_from((numerator + denominator / 2) / denominator).unwrap_or(u64::MAX)
    }
}

/// The segments of a bit in time quanta, and the divider that makes a quantum (ISO 11898-1, clause
/// 11.3). The values are the fields of bxCAN's BTR plus one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitSegments {
    /// Clock cycles in a time quantum, 1 to 1024.
    pub prescaler: u16,
    /// Quanta between the synchronisation segment and the sample point (propagation segment and
    /// phase segment 1), 1 to 16.
    pub before_sample: u8,
    /// Quanta after the sample point (phase segment 2), 1 to 8.
    pub after_sample: u8,
    /// Largest correction of a resynchronisation, in quanta, 1 to 4.
    pub jump_width: u8,
}

impl BitSegments {
    /// 15 quanta with the sample point at 73.3 %, which divides 36 and 45 MHz down to
    /// 250 kbit/s with the prescaler given.
    #[must_use]
    pub const fn fifteen_quanta(prescaler: u16) -> Self {
        Self {
            prescaler,
            before_sample: 10,
            after_sample: 4,
            jump_width: 1,
        }
    }

    /// Quanta in a bit.
    #[must_use]
    pub const fn quanta(self) -> u32 {
        1 + self.before_sample as u32 + self.after_sample as u32
    }
}

/// The durations within a bit, by one node's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct BitTime {
    pub bit: Ps,
    pub quantum: Ps,
    pub sample: Ps,
    pub jump: Ps,
}

impl BitTime {
    pub(crate) fn new(clock: ClockRate, segments: BitSegments) -> Self {
        let cycles = |quanta: u32| clock.cycles(quanta * u32::from(segments.prescaler.max(1)));
        let quantum = cycles(1).max(1);
        Self {
            bit: cycles(segments.quanta()).max(1),
            quantum,
            sample: cycles(1 + u32::from(segments.before_sample)),
            jump: quantum * u64::from(segments.jump_width),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_boards_divide_their_bus_clock_to_four_microseconds() {
        for (hertz, prescaler) in [(45_000_000, 12), (36_000_000, 9_u16)] {
            let segments = if hertz == 36_000_000 {
                BitSegments {
                    before_sample: 11,
                    ..BitSegments::fifteen_quanta(prescaler)
                }
            } else {
                BitSegments::fifteen_quanta(prescaler)
            };
            assert_eq!(
                BitTime::new(ClockRate::new(hertz), segments).bit,
                4_000_000,
                "{hertz} Hz"
            );
        }
    }

    #[test]
    fn a_fast_crystal_makes_short_bits() {
        let clock = ClockRate::new(45_000_000).with_offset_ppb(20_000);
        let time = BitTime::new(clock, BitSegments::fifteen_quanta(12));
        assert_eq!(time.bit, 3_999_920);
    }
}
