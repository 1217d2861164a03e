//! Statistics over all runs of one case.

use serde::Serialize;

use super::measure::Figures;

/// Figures of all runs of a case under one law.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Aggregate {
    /// Number of runs.
    pub runs: usize,
    /// How many of them settled.
    pub settled: usize,
    /// How many of them drove up to the end.
    pub complete: usize,
    /// Median of the settling times; `None` when the median run never settled.
    pub settling_median_seconds: Option<f64>,
    /// Median of the times until the error stays about its own mean; `None` when the median run never
    /// did.
    pub arrival_median_seconds: Option<f64>,
    /// Longest settling time; `None` when a run never settled.
    pub settling_worst_seconds: Option<f64>,
    /// Mean of the cross-track error over all samples of all runs in steady state.
    pub mean_cm: f64,
    /// The mean of the run whose mean is farthest from zero.
    pub mean_worst_cm: f64,
    /// Standard deviation over all samples of all runs in steady state.
    pub deviation_cm: f64,
    /// Largest standard deviation of a run.
    pub deviation_worst_cm: f64,
    /// Largest overshoot.
    pub overshoot_worst_cm: f64,
    /// Most swings across the settling band in a run.
    pub swings_worst: usize,
    /// Changes of sign of the steering command per second in steady state.
    pub sign_changes_per_second: f64,
}

impl Aggregate {
    /// Combines runs.
    pub fn of(runs: &[Figures]) -> Self {
        let times = sorted(runs.iter().map(|run| run.settling));
        let arrivals = sorted(runs.iter().map(|run| run.arrival));
        let each: Vec<(f64, f64)> = runs
            .iter()
            .map(|run| moments(run.steady.iter().copied()))
            .collect();
        let all = || runs.iter().flat_map(|run| run.steady.iter().copied());
        let (mean_cm, deviation_cm) = moments(all());
        let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, f64::max);
        let changes: usize = runs.iter().map(|run| run.sign_changes).sum();
        let span: f64 = runs.iter().map(|run| run.steady_seconds).sum();
        Self {
            runs: runs.len(),
            settled: times.iter().flatten().count(),
            complete: runs.iter().filter(|run| run.complete).count(),
            settling_median_seconds: median(&times),
            arrival_median_seconds: median(&arrivals),
            settling_worst_seconds: times.last().copied().flatten(),
            mean_cm,
            mean_worst_cm: each.iter().map(|(mean, _)| *mean).fold(0.0, |worst, mean| {
                if mean.abs() > f64::abs(worst) {
                    mean
                } else {
                    worst
                }
            }),
            deviation_cm,
            deviation_worst_cm: largest(&mut each.iter().map(|(_, deviation)| *deviation)),
            overshoot_worst_cm: largest(&mut runs.iter().map(|run| run.overshoot)),
            swings_worst: runs.iter().map(|run| run.swings).max().unwrap_or(0),
            sign_changes_per_second: if span > 0.0 {
                changes as f64 / span
            } else {
                0.0
            },
        }
    }
}

/// Times in order, the missing ones last.
fn sorted(times: impl Iterator<Item = Option<f64>>) -> Vec<Option<f64>> {
    let mut times: Vec<Option<f64>> = times.collect();
    times.sort_by(|a, b| {
        let late = f64::INFINITY;
        a.unwrap_or(late).total_cmp(&b.unwrap_or(late))
    });
    times
}

/// Mean and standard deviation; both are zero for an empty list.
fn moments(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count().max(1) as f64;
    let mean = values.clone().sum::<f64>() / count;
    let square = values
        .map(|value| (value - mean) * (value - mean))
        .sum::<f64>()
        / count;
    (mean, square.sqrt())
}

/// Median of sorted times; the missing ones are last.
fn median(times: &[Option<f64>]) -> Option<f64> {
    let upper = times.get(times.len() / 2).copied().flatten()?;
    let lower = times
        .get(times.len().saturating_sub(1) / 2)
        .copied()
        .flatten()?;
    Some((lower + upper) / 2.0)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A run with two steady samples.
    pub(crate) fn run(settling: Option<f64>, steady: [f64; 2], sign_changes: usize) -> Figures {
        Figures {
            seed: 1,
            settling,
            arrival: settling,
            steady: steady.to_vec(),
            steady_seconds: 20.0,
            sign_changes,
            overshoot: 3.0,
            swings: 0,
            complete: true,
        }
    }

    /// Runs around -1, 0 and 2 cm, computed by hand: samples -2 0 | -1 1 | 1 3, mean 2/6,
    /// squares 16, variance 16/6 - 1/9 = 23/9; each run deviates by 1.
    #[test]
    fn three_runs_are_pooled() {
        let mut runs = vec![
            run(Some(5.0), [-2.0, 0.0], 3),
            run(Some(4.0), [-1.0, 1.0], 0),
            run(Some(7.0), [1.0, 3.0], 3),
        ];
        runs[1].overshoot = 8.5;
        runs[2].swings = 2;
        let all = Aggregate::of(&runs);
        assert_eq!((all.runs, all.settled, all.complete), (3, 3, 3));
        assert_eq!(all.settling_median_seconds, Some(5.0));
        assert_eq!(all.settling_worst_seconds, Some(7.0));
        assert!((all.mean_cm - 1.0 / 3.0).abs() < 1e-12);
        assert!((all.deviation_cm - 23_f64.sqrt() / 3.0).abs() < 1e-12);
        assert_eq!(all.mean_worst_cm, 2.0);
        assert_eq!(all.deviation_worst_cm, 1.0);
        assert_eq!(all.overshoot_worst_cm, 8.5);
        assert_eq!(all.swings_worst, 2);
        assert!((all.sign_changes_per_second - 0.1).abs() < 1e-12);
    }

    #[test]
    fn the_worst_mean_keeps_its_sign() {
        let runs = [
            run(Some(1.0), [1.0, 1.0], 0),
            run(Some(1.0), [-4.0, -2.0], 0),
        ];
        assert_eq!(Aggregate::of(&runs).mean_worst_cm, -3.0);
    }

    #[test]
    fn a_run_that_never_settles_is_the_worst() {
        let times = [Some(6.0), None, Some(4.0), Some(5.0)];
        let runs = times.map(|time| run(time, [0.0, 0.0], 0));
        let all = Aggregate::of(&runs);
        assert_eq!(all.settled, 3);
        assert_eq!(all.settling_median_seconds, Some(5.5));
        assert_eq!(all.settling_worst_seconds, None);
        let half = [Some(6.0), None].map(|time| run(time, [0.0, 0.0], 0));
        assert_eq!(Aggregate::of(&half).settling_median_seconds, None);
    }
}
