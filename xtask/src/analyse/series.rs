//! Figures of many numbers that are not all kept.

/// Count, mean, standard deviation, least and greatest of numbers.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Spread {
    count: u64,
    mean: f64,
    /// Sum of the squared differences from the mean.
    squares: f64,
    least: f64,
    greatest: f64,
}

impl Spread {
    /// Adds a number (Welford's method, which loses no digits with a large mean).
    pub(super) fn add(&mut self, value: f64) {
        if self.count == 0 {
            (self.least, self.greatest) = (value, value);
        }
        self.count += 1;
        let before = value - self.mean;
        self.mean += before / self.count as f64;
        self.squares += before * (value - self.mean);
        self.least = self.least.min(value);
        self.greatest = self.greatest.max(value);
    }

    pub(super) fn count(&self) -> u64 {
        self.count
    }

    pub(super) fn mean(&self) -> Option<f64> {
        (self.count > 0).then_some(self.mean)
    }

    pub(super) fn least(&self) -> Option<f64> {
        (self.count > 0).then_some(self.least)
    }

    pub(super) fn greatest(&self) -> Option<f64> {
        (self.count > 0).then_some(self.greatest)
    }

    /// Standard deviation of these numbers.
    pub(super) fn deviation(&self) -> Option<f64> {
        (self.count > 0).then(|| (self.squares / self.count as f64).sqrt())
    }
}

impl FromIterator<f64> for Spread {
    fn from_iter<I: IntoIterator<Item = f64>>(values: I) -> Self {
        let mut spread = Self::default();
        values.into_iter().for_each(|value| spread.add(value));
        spread
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_figures_are_those_of_the_textbook() {
        // Mean 5 and standard deviation 2.
        let spread: Spread = [2.0, 4.0, 4.0, 4.0, 5.0, 5.0, 7.0, 9.0]
            .into_iter()
            .collect();
        assert_eq!(spread.count(), 8);
        assert!((spread.mean().unwrap() - 5.0).abs() < 1e-12);
        assert!((spread.deviation().unwrap() - 2.0).abs() < 1e-12);
        assert_eq!((spread.least(), spread.greatest()), (Some(2.0), Some(9.0)));
        assert_eq!(Spread::default().mean(), None);
    }
}
