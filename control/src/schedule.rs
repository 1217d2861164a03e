//! Gains that follow the speed: designed on the host or at build time, looked
//! up on the target.

use crate::scalar::Scalar;

/// A table of N gains at P equally spaced speeds from standstill upwards,
/// interpolated linearly between them and held constant outside.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GainSchedule<T, const N: usize, const P: usize> {
    /// Speed between two rows, m/s, positive.
    pub spacing: T,
    /// Row k holds the gains at k times `spacing`.
    pub gains: [[T; N]; P],
}

impl<T: Scalar, const N: usize, const P: usize> GainSchedule<T, N, P> {
    /// The gains at `speed` (m/s). The sign of the speed is ignored; NaN gives
    /// the gains of standstill.
    #[must_use]
    pub fn at(&self, speed: T) -> [T; N] {
        let mut result = [T::zero(); N];
        let place = speed.abs() / self.spacing;
        let mut position = T::zero();
        let mut rows = self.gains.iter();
        let Some(mut row) = rows.next() else {
            return result;
        };
        for next in rows {
            if !(place > position) {
                break;
            }
            let share = place - position;
            if share < T::one() {
                for ((result, &low), &high) in result.iter_mut().zip(row).zip(next) {
                    *result = low + (high - low) * share;
                }
                return result;
            }
            position += T::one();
            row = next;
        }
        *row
    }
}
