//! Bursts of samples of two analogue inputs, and their means.
//!
//! A converter samples the two inputs in turn, [`SAMPLES`] times each in quick succession. Only the
//! means leave the board (thesis 2.2.5.1).

/// Samples of each input in a burst.
pub const SAMPLES: usize = 50;

/// Samples in a burst: first, second, first, and so on.
pub const LENGTH: usize = 2 * SAMPLES;

/// Fractions of a count that a [`Mean`] resolves.
const FRACTIONS: u32 = 16;

/// The mean of the samples of one input, in sixteenths of a count of the 12-bit converter: 0 to
/// 65 520.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Mean(u16);

impl Mean {
    /// The largest mean: every sample 4095.
    pub const FULL_SCALE: Self = Self(16 * 4095);

    /// The mean of [`SAMPLES`] samples with this sum, rounded to the nearest.
    #[inline]
    const fn of(sum: u32) -> Self {
        const N: u32 = SAMPLES as u32;
        let mean = (FRACTIONS * sum + N / 2) / N;
        Self(if mean > u16::MAX as u32 {
            u16::MAX
        } else {
            mean as u16
        })
    }

    /// In sixteenths of a count, 0 to 65 520.
    pub const fn sixteenths(self) -> u16 {
        self.0
    }

    /// In whole counts, 0 to 4095, rounded to the nearest.
    pub const fn counts(self) -> u16 {
        self.0 / 16 + (self.0 % 16) / 8
    }
}

/// The means of a burst.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Means {
    /// Of the left sensor's input.
    pub left: Mean,
    /// Of the right sensor's input.
    pub right: Mean,
}

impl Means {
    /// The means of a burst of 12-bit samples, left first. `sample` is asked for each index from 0
    /// to [`LENGTH`] - 1 once, in order.
    #[inline]
    pub fn of(mut sample: impl FnMut(usize) -> u16) -> Self {
        let (mut left, mut right) = (0, 0);
        for pair in 0..SAMPLES {
            left += u32::from(sample(2 * pair));
            right += u32::from(sample(2 * pair + 1));
        }
        Self {
            left: Mean::of(left),
            right: Mean::of(right),
        }
    }
}

/// Why a burst has given no means.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BurstError {
    /// It has not ended in its time, or no burst has begun.
    Unfinished,
    /// A sample was overwritten before the DMA channel took it.
    Overrun,
    /// The DMA channel could not store a sample.
    Transfer,
    /// The converter still runs although its stop was set.
    Stuck,
}

#[cfg(test)]
mod tests {
    use super::{LENGTH, Mean, Means};

    #[test]
    fn the_means_are_those_of_the_two_inputs_in_turn() {
        let means = Means::of(|index| if index % 2 == 0 { 1000 } else { 3001 });
        assert_eq!((means.left.counts(), means.right.counts()), (1000, 3001));
        assert_eq!(means.left.sixteenths(), 16_000);
        let full = Means::of(|_| 4095);
        assert_eq!(full.left, Mean::FULL_SCALE);
        assert_eq!(full.left.counts(), 4095);
        assert_eq!(Means::of(|_| 0), Means::default());
    }

    /// Half of the samples of an input are a count higher: the mean is half a count higher.
    #[test]
    fn a_mean_has_more_bits_than_its_samples() {
        let means = Means::of(|index| 2000 + (index / 2 % 2) as u16);
        assert_eq!(means.left.sixteenths(), 32_008);
        assert_eq!(means.left.counts(), 2001, "a half is rounded up");
        assert_eq!(means.left, means.right);
    }

    /// Against the mean in floating point, for pseudo-random samples.
    #[test]
    fn a_mean_is_within_half_a_fraction_of_the_exact_one() {
        let mut state = 2017_u32;
        for _ in 0..200 {
            let mut samples = [0; LENGTH];
            for sample in &mut samples {
                state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                *sample = (state >> 20) as u16;
            }
            let mut asked = 0;
            let means = Means::of(|index| {
                assert_eq!(index, asked);
                asked += 1;
                samples[index]
            });
            assert_eq!(asked, LENGTH);
            for (side, mean) in [means.left, means.right].into_iter().enumerate() {
                let own = samples.iter().skip(side).step_by(2);
                let exact = own.map(|&sample| f64::from(sample)).sum::<f64>() / 50.0;
                let error = f64::from(mean.sixteenths()) / 16.0 - exact;
                assert!(error.abs() <= 0.5 / 16.0 + 1e-9, "{error}");
            }
        }
    }
}
