//! Points evenly spaced and without noise (E. T. Whittaker, On a new method of graduation, Proceedings of the Edinburgh
//! Mathematical Society 41, 1923).

use crate::place::Local;

/// How often points are smoothed with another weight until they have moved as far as their noise.
const TRIALS: usize = 50;

/// Weight of the ends: other legs begin and end there, so they hardly move.
const HOLD: f64 = 1e4;

/// Points at even distances along a line through points: each is the mean of those near it. The ends stay where they are.
fn even(points: &[Local], spacing: f64) -> Vec<(Local, usize)> {
    let mut along = vec![0.0];
    for pair in points.windows(2) {
        along.push(along[along.len() - 1] + pair[0].distance(pair[1]));
    }
    let length = along[along.len() - 1];
    let cells = (length / spacing).round().max(1.0) as usize;
    let width = length / cells as f64;
    let mut sums = vec![(Local::default(), 0_usize); cells + 1];
    let last = points.len() - 1;
    for (index, (point, along)) in points.iter().zip(&along).enumerate() {
        let cell = ((along / width).round() as usize).min(cells);
        if (cell == 0 && index != 0) || (cell == cells && index != last) {
            continue;
        }
        // A point stands for the middle of its cell: it is moved there along its line.
        let (from, to) = match index {
            0 => (0, 1),
            index if index == last => (last - 1, last),
            index => (index - 1, index + 1),
        };
        let forward = points[from].bearing(points[to]);
        let moved = point.towards(forward, cell as f64 * width - along);
        let (sum, count) = &mut sums[cell];
        *sum = Local::new(sum.north + moved.north, sum.east + moved.east);
        *count += 1;
    }
    let mut piece = 0;
    let mut means = Vec::with_capacity(sums.len());
    for (cell, (sum, count)) in sums.into_iter().enumerate() {
        let mean = match count {
            0 => {
                let at = cell as f64 * width;
                while piece + 2 < points.len() && along[piece + 1] < at {
                    piece += 1;
                }
                let share = (at - along[piece]) / (along[piece + 1] - along[piece]).max(1e-12);
                points[piece].between(points[piece + 1], share.clamp(0.0, 1.0))
            }
            count => {
                let count = count as f64;
                Local::new(sum.north / count, sum.east / count)
            }
        };
        means.push((mean, count));
    }
    means
}

/// A symmetric matrix with three diagonals beside the main one, by its lower ones.
struct Band {
    rows: Vec<[f64; 4]>,
}

impl Band {
    /// One, at the ends [`HOLD`], plus `weight` times the square of the third difference.
    fn of(count: usize, weight: f64) -> Self {
        const THIRD: [f64; 4] = [-1.0, 3.0, -3.0, 1.0];
        let mut rows = vec![[1.0, 0.0, 0.0, 0.0]; count];
        for end in [0, count - 1] {
            rows[end][0] = HOLD;
        }
        for first in 0..count.saturating_sub(3) {
            for (one, factor) in THIRD.iter().enumerate() {
                for (other, second) in THIRD.iter().enumerate().take(one + 1) {
                    rows[first + one][one - other] += weight * factor * second;
                }
            }
        }
        Self { rows }
    }

    /// Replaces the matrix by its factor of Cholesky.
    fn factor(&mut self) {
        for row in 0..self.rows.len() {
            for back in (0..=3.min(row)).rev() {
                let column = row - back;
                let mut sum = self.rows[row][back];
                for further in back + 1..=3.min(row) {
                    if further - back <= 3 {
                        sum -= self.rows[row][further] * self.rows[column][further - back];
                    }
                }
                self.rows[row][back] = match back {
                    0 => sum.max(1e-300).sqrt(),
                    _ => sum / self.rows[column][0],
                };
            }
        }
    }

    /// Solves for a right side, after [`Self::factor`].
    fn solve(&self, side: &mut [f64]) {
        let count = side.len();
        for row in 0..count {
            let known = (1..=3.min(row)).map(|back| self.rows[row][back] * side[row - back]);
            side[row] = (side[row] - known.sum::<f64>()) / self.rows[row][0];
        }
        for row in (0..count).rev() {
            let after = 3.min(count - 1 - row);
            let known = (1..=after).map(|ahead| self.rows[row + ahead][ahead] * side[row + ahead]);
            side[row] = (side[row] - known.sum::<f64>()) / self.rows[row][0];
        }
    }
}

fn smoothed(points: &[(Local, usize)], weight: f64) -> Vec<Local> {
    let mut band = Band::of(points.len(), weight);
    band.factor();
    let mut north: Vec<f64> = points.iter().map(|(point, _)| point.north).collect();
    let mut east: Vec<f64> = points.iter().map(|(point, _)| point.east).collect();
    for end in [0, points.len() - 1] {
        north[end] *= HOLD;
        east[end] *= HOLD;
    }
    band.solve(&mut north);
    band.solve(&mut east);
    let places = north.into_iter().zip(east);
    places
        .map(|(north, east)| Local::new(north, east))
        .collect()
}

/// The points at even distances of about `spacing` metres, smoothed so far that they have moved by the noise, whose
/// standard deviation is `noise` metres for each point in each direction. The steadiest curvature changes are preferred.
pub(super) fn resampled(points: &[Local], spacing: f64, noise: f64) -> Vec<Local> {
    let means = even(points, spacing);
    if noise <= 0.0 || means.len() < 4 {
        return means.into_iter().map(|(mean, _)| mean).collect();
    }
    // The mean of several points has less noise. Smoothing removes nearly all of it, in both directions.
    let variance = |count: usize| 2.0 * noise * noise / count.max(1) as f64;
    let expected: f64 = means.iter().map(|(_, count)| variance(*count)).sum();
    let moved = |smooth: &[Local]| {
        let moves = smooth.iter().zip(&means);
        let squares = moves.map(|(one, (mean, _))| one.distance(*mean).powi(2));
        squares.sum::<f64>()
    };
    let (mut low, mut high) = (-6.0, 12.0);
    for _ in 0..TRIALS {
        let middle = 0.5 * (low + high);
        match moved(&smoothed(&means, f64::powf(10.0, middle))) < expected {
            true => low = middle,
            false => high = middle,
        }
    }
    smoothed(&means, f64::powf(10.0, low))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_stays_what_it_is() {
        // Its third difference is zero.
        let points: Vec<Local> = (0..30)
            .map(f64::from)
            .map(|t| Local::new(t, 0.01 * t * t))
            .collect();
        let input: Vec<_> = points.iter().map(|point| (*point, 1)).collect();
        let smooth = smoothed(&input, 1e6);
        let moved = smooth
            .iter()
            .zip(&points)
            .map(|(one, other)| one.distance(*other));
        let moved = moved.fold(0.0, f64::max);
        assert!(moved < 1e-6, "{moved}");
    }

    #[test]
    fn the_factor_solves() {
        let count = 12;
        let mut band = Band::of(count, 2.5);
        let original: Vec<[f64; 4]> = band.rows.clone();
        band.factor();
        let side: Vec<f64> = (0..count).map(|i| (i as f64).sin()).collect();
        let mut solution = side.clone();
        band.solve(&mut solution);
        for (row, expected) in side.iter().enumerate() {
            let entry = |column: usize| {
                let (high, low) = (row.max(column), row.min(column));
                if high - low <= 3 {
                    original[high][high - low]
                } else {
                    0.0
                }
            };
            let product: f64 = (0..count)
                .map(|column| entry(column) * solution[column])
                .sum();
            assert!((product - expected).abs() < 1e-10, "{row}");
        }
    }

    #[test]
    fn even_points_are_even() {
        let points = [
            Local::new(0.0, 0.0),
            Local::new(1.0, 0.0),
            Local::new(10.0, 0.0),
        ];
        let even = even(&points, 1.0);
        assert_eq!(even.len(), 11);
        for pair in even.windows(2) {
            assert!((pair[0].0.distance(pair[1].0) - 1.0).abs() < 1e-12);
        }
    }
}
