//! Bit timing of bxCAN, computed and checked at compile time.

/// Settings of bxCAN's bit timing register (RM0390, CAN_BTR). The register holds
/// each value less one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BitTiming {
    /// Clock cycles in a time quantum, 1..=1024.
    pub prescaler: u16,
    /// Time quanta of bit segment 1 (propagation and phase segment 1), 1..=16.
    pub segment_1: u8,
    /// Time quanta of bit segment 2, 1..=8.
    pub segment_2: u8,
    /// Resynchronisation jump width in time quanta, 1..=4.
    pub jump_width: u8,
}

/// No setting of bxCAN gives exactly this bit rate with a sample point of 70 to
/// 80 %.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoBitTiming;

impl core::fmt::Display for NoBitTiming {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("no bxCAN setting gives this bit rate with a sample point of 70 to 80 %")
    }
}

impl core::error::Error for NoBitTiming {}

impl BitTiming {
    /// The timing for `bit_rate` bit/s from a peripheral clock of `clock` Hz. The
    /// bit rate is exact. The sample point is within 70 to 80 % and as near to 75 %
    /// as possible. Among equal sample points, the setting with the most time
    /// quanta is taken. The jump width is the largest that segment 2 allows.
    ///
    /// # Errors
    /// No setting gives this bit rate and sample point.
    pub const fn bxcan(clock: u32, bit_rate: u32) -> Result<Self, NoBitTiming> {
        if bit_rate == 0 || !clock.is_multiple_of(bit_rate) {
            return Err(NoBitTiming);
        }
        let cycles = clock / bit_rate;
        let mut best = None;
        let mut best_error = u32::MAX;
        // Most quanta first, so that an equally good setting with fewer loses.
        let mut quanta = 25;
        while quanta >= 4 {
            let prescaler = cycles / quanta;
            if cycles.is_multiple_of(quanta) && prescaler >= 1 && prescaler <= 1024 {
                let mut segment_2 = 1;
                while segment_2 <= 8 && segment_2 + 2 <= quanta {
                    let segment_1 = quanta - 1 - segment_2;
                    let per_mille = (1 + segment_1) * 1000 / quanta;
                    let error = per_mille.abs_diff(750);
                    if segment_1 <= 16 && error <= 50 && error < best_error {
                        best_error = error;
                        best = Some(Self {
                            prescaler: prescaler as u16,
                            segment_1: segment_1 as u8,
                            segment_2: segment_2 as u8,
                            jump_width: if segment_2 < 4 { segment_2 as u8 } else { 4 },
                        });
                    }
                    segment_2 += 1;
                }
            }
            quanta -= 1;
        }
        match best {
            Some(timing) => Ok(timing),
            None => Err(NoBitTiming),
        }
    }

    /// [`BitTiming::bxcan`] for constants: the build fails if there is none.
    ///
    /// ```
    /// const TIMING: ttcan::BitTiming = ttcan::BitTiming::constant::<45_000_000, 250_000>();
    /// assert_eq!(TIMING.bit_rate(45_000_000), 250_000);
    /// ```
    pub const fn constant<const CLOCK: u32, const BIT_RATE: u32>() -> Self {
        const {
            match Self::bxcan(CLOCK, BIT_RATE) {
                Ok(timing) => timing,
                Err(_) => {
                    panic!("no bxCAN setting gives this bit rate with a sample point of 70 to 80 %")
                }
            }
        }
    }

    /// Time quanta in a bit.
    pub const fn quanta(&self) -> u32 {
        1 + self.segment_1 as u32 + self.segment_2 as u32
    }

    /// The sample point in thousandths of a bit, rounded down.
    pub const fn sample_point_per_mille(&self) -> u32 {
        (1 + self.segment_1 as u32) * 1000 / self.quanta()
    }

    /// The bit rate in bit/s from a peripheral clock of `clock` Hz, rounded
    /// down; 0 for a prescaler of 0, which the register cannot hold.
    pub const fn bit_rate(&self, clock: u32) -> u32 {
        match clock.checked_div(self.prescaler as u32 * self.quanta()) {
            Some(rate) => rate,
            None => 0,
        }
    }

    /// Largest error of a node's oscillator, in parts per million, if the others may err as much
    /// in the other direction (ISO 11898-1, 11.3.2.6; Robert Bosch GmbH, CAN specification 2.0,
    /// chapter 9). Two conditions: a node resynchronises often enough between the edges of a
    /// frame, and it reads the bit after an error flag in the right place.
    pub const fn tolerance_ppm(&self) -> u32 {
        let bit = self.quanta();
        let least = if self.segment_1 < self.segment_2 {
            self.segment_1
        } else {
            self.segment_2
        } as u32;
        let edges = self.jump_width as u32 * 1_000_000 / (2 * 10 * bit);
        let flag = least * 1_000_000 / (2 * (13 * bit - self.segment_2 as u32));
        if edges < flag { edges } else { flag }
    }

    /// The value of CAN_BTR (RM0390) in normal mode, without silent and loop back
    /// mode. A value of 0, which the register cannot hold, counts as 1.
    pub const fn register(&self) -> u32 {
        (self.jump_width as u32).saturating_sub(1) << 24
            | (self.segment_2 as u32).saturating_sub(1) << 20
            | (self.segment_1 as u32).saturating_sub(1) << 16
            | (self.prescaler as u32).saturating_sub(1)
    }
}
