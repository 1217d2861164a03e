//! Gain schedules over speed: designed on the host, looked up on the target.

use crate::scalar::Scalar;

/// A table of N gains at P equally spaced speeds, starting with standstill.
/// Between two rows the gains are interpolated linearly; above the last row they
/// are constant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GainSchedule<T, const N: usize, const P: usize> {
    /// Difference of speed between two rows, m/s, positive.
    pub spacing: T,
    /// Row k holds the gains at the speed k `spacing`.
    pub gains: [[T; N]; P],
}

impl<T: Scalar, const N: usize, const P: usize> GainSchedule<T, N, P> {
    /// The gains at `speed` (m/s). The sign of the speed is ignored. NaN gives the
    /// gains at standstill.
    #[must_use]
    pub fn at(&self, speed: T) -> [T; N] {
        let rows = speed.abs() / self.spacing;
        let last = P.saturating_sub(1);
        let number = rows.whole().min(last);
        let Some(&row) = self.gains.get(number) else {
            return [T::zero(); N];
        };
        let Some(next) = self.gains.get(number + 1) else {
            return row;
        };
        let share = rows - T::integer(number as i32);
        // Not so with NaN.
        if share > T::zero() {
            core::array::from_fn(|gain| row[gain] + (next[gain] - row[gain]) * share)
        } else {
            row
        }
    }

    /// The same schedule in another precision.
    #[must_use]
    pub fn cast<U: Scalar>(&self) -> GainSchedule<U, N, P> {
        GainSchedule {
            spacing: U::lit(self.spacing.as_f64()),
            gains: self.gains.map(|row| row.map(|gain| U::lit(gain.as_f64()))),
        }
    }

    /// True if every gain is finite and the spacing is a positive number.
    #[must_use]
    pub fn is_usable(&self) -> bool {
        self.spacing.is_finite()
            && self.spacing > T::zero()
            && self.gains.iter().flatten().all(|gain| gain.is_finite())
    }
}

/// Displays the schedule as a Rust expression, for the output of a build script.
/// Nine significant digits restore single precision exactly.
impl<T: Scalar, const N: usize, const P: usize> core::fmt::Display for GainSchedule<T, N, P> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        writeln!(f, "GainSchedule {{")?;
        writeln!(f, "    spacing: {:?},", self.spacing.as_f64())?;
        writeln!(f, "    gains: [")?;
        for row in &self.gains {
            write!(f, "        [")?;
            for (number, gain) in row.iter().enumerate() {
                let comma = if number == 0 { "" } else { ", " };
                write!(f, "{comma}{:.8e}", gain.as_f64())?;
            }
            writeln!(f, "],")?;
        }
        writeln!(f, "    ],")?;
        write!(f, "}}")
    }
}
