//! A weighted set of Gaussian hypotheses about the robot's place.
//!
//! Each run of readings may come from a stalk or from something else. A
//! hypothesis therefore becomes two: in one the run corrects it, in the other it
//! does not. Hypotheses that agree are then merged, and the least likely are
//! dropped, so that their number stays bounded (B.-N. Vo and W.-K. Ma, "The
//! Gaussian mixture probability hypothesis density filter", IEEE Transactions on
//! Signal Processing 54, 2006, table II).
//!
//! All loops have constant counts: an unused hypothesis has the weight 0.

use crate::scalar::Scalar;

/// Number of states: offset, heading, half width, curvature.
pub(super) const STATES: usize = 4;
/// Most hypotheses between two steps.
pub(super) const HYPOTHESES: usize = 12;
/// Distance within which two hypotheses are merged: of their offsets where the
/// beams meet the rows (m) and of their headings (rad).
const MERGE: (f64, f64) = (0.02, 0.05);
/// Weight below which a hypothesis is dropped.
const LEAST_WEIGHT: f64 = 1e-4;

/// Most hypotheses while they meet a run.
const CANDIDATES: usize = 2 * HYPOTHESES + 1;

pub(super) type Vector<T> = [T; STATES];
pub(super) type Matrix<T> = [[T; STATES]; STATES];

/// A Gaussian with a weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypothesis<T> {
    pub(super) weight: T,
    pub(super) state: Vector<T>,
    pub(super) covariance: Matrix<T>,
}

/// A run of readings as one hypothesis sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Seen<T> {
    /// Change of the distance with each state.
    pub(super) row: Vector<T>,
    /// Measured distance less the predicted one, m.
    pub(super) excess: T,
    /// Variance of the distance to a stalk, m^2.
    pub(super) variance: T,
    /// Probability that a run comes from a stalk.
    pub(super) stalk: T,
    /// Probability density of a run at this distance that comes from anything
    /// else, 1/m.
    pub(super) clutter: T,
}

impl<T: Scalar> Hypothesis<T> {
    pub(super) fn unused() -> Self {
        Self {
            weight: T::zero(),
            state: [T::zero(); STATES],
            covariance: [[T::zero(); STATES]; STATES],
        }
    }

    /// This hypothesis if the run came from a stalk, and if it did not. The
    /// weights are those of this one times the probability density of the run.
    pub(super) fn split(&self, seen: &Seen<T>) -> (Self, Self) {
        let mut missed = *self;
        missed.weight *= seen.clutter;
        let cross = times(&self.covariance, &seen.row);
        let spread = dot(&seen.row, &cross) + seen.variance;
        if !(spread > T::zero()) {
            return (Self::unused(), missed);
        }
        let mut hit = *self;
        // A bell with heavier tails than a Gaussian: (1 + x / 8)^-4 is near
        // exp(-x / 2) for small x. The factor is 1 / sqrt(2 pi).
        let square = seen.excess * seen.excess / spread;
        let tail = T::one() + square * T::lit(0.125);
        let tail = tail * tail;
        hit.weight *= seen.stalk * T::lit(0.399) / (spread.root() * tail * tail);
        let lines = hit.state.iter_mut().zip(&mut hit.covariance);
        for ((state, line), entry) in lines.zip(cross) {
            let gain = entry / spread;
            *state += gain * seen.excess;
            for (entry, cross) in line.iter_mut().zip(cross) {
                *entry -= gain * cross;
            }
        }
        (hit, missed)
    }
}

/// The hypotheses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mixture<T> {
    pub(super) hypotheses: [Hypothesis<T>; HYPOTHESES],
}

impl<T: Scalar> Mixture<T> {
    /// One hypothesis.
    pub(super) fn of(state: Vector<T>, covariance: Matrix<T>) -> Self {
        let mut hypotheses = [Hypothesis::unused(); HYPOTHESES];
        hypotheses[0] = Hypothesis {
            weight: T::one(),
            state,
            covariance,
        };
        Self { hypotheses }
    }

    /// Mean of all hypotheses.
    pub(super) fn mean(&self) -> Vector<T> {
        let mut mean = [T::zero(); STATES];
        for hypothesis in &self.hypotheses {
            for (mean, state) in mean.iter_mut().zip(hypothesis.state) {
                *mean += hypothesis.weight * state;
            }
        }
        mean
    }

    /// Variance of `row` times the states.
    pub(super) fn variance(&self, row: &Vector<T>) -> T {
        let middle = dot(row, &self.mean());
        self.hypotheses.iter().fold(T::zero(), |sum, hypothesis| {
            let apart = dot(row, &hypothesis.state) - middle;
            let own = dot(row, &times(&hypothesis.covariance, row));
            sum + hypothesis.weight * (own + apart * apart)
        })
    }

    /// Splits each hypothesis, and `fresh`, by a run, of which `see` says how a
    /// hypothesis with this state sees it, and reduces their number again. `reach` is
    /// the distance ahead at which the beams meet the rows, m. Returns the
    /// probability that the run came from a stalk by the old hypotheses.
    pub(super) fn meet(
        &mut self,
        reach: T,
        fresh: &Hypothesis<T>,
        see: impl Fn(&Vector<T>) -> Option<Seen<T>>,
    ) -> T {
        let mut all = [Hypothesis::unused(); CANDIDATES];
        // A new hypothesis counts only where the run corrects it.
        if let Some(seen) = see(&fresh.state) {
            all[CANDIDATES - 1] = fresh.split(&seen).0;
        }
        let (hits, misses) = all.split_at_mut(HYPOTHESES);
        let (mut total, mut stalk) = (T::zero(), T::zero());
        for ((hypothesis, hit), miss) in self.hypotheses.iter().zip(hits).zip(misses) {
            if hypothesis.weight > T::zero()
                && let Some(seen) = see(&hypothesis.state)
            {
                (*hit, *miss) = hypothesis.split(&seen);
                stalk += hit.weight;
                total += hit.weight + miss.weight;
            }
        }
        if !(total > T::zero() && total.is_finite()) {
            return T::zero();
        }
        self.reduce(&mut all, total, reach);
        stalk / total
    }

    fn reduce(&mut self, all: &mut [Hypothesis<T>; CANDIDATES], total: T, reach: T) {
        let least = total * T::lit(LEAST_WEIGHT);
        let mut kept = T::zero();
        for slot in &mut self.hypotheses {
            *slot = take_group(all, least, reach);
            kept += slot.weight;
        }
        for slot in &mut self.hypotheses {
            slot.weight /= kept;
        }
    }
}

/// Takes the likeliest hypothesis out of `all` together with those that agree
/// with it, and merges them.
fn take_group<T: Scalar>(
    all: &mut [Hypothesis<T>; CANDIDATES],
    least: T,
    reach: T,
) -> Hypothesis<T> {
    let mut best = Hypothesis::unused();
    for hypothesis in all.iter() {
        if hypothesis.weight > best.weight {
            best = *hypothesis;
        }
    }
    if !(best.weight >= least) {
        return Hypothesis::unused();
    }
    let mut group = Hypothesis::unused();
    for hypothesis in all.iter_mut() {
        let mut apart = [T::zero(); STATES];
        for ((apart, state), best) in apart.iter_mut().zip(hypothesis.state).zip(best.state) {
            *apart = state - best;
        }
        let ahead = (apart[0] + reach * apart[1]) / T::lit(MERGE.0);
        let askew = apart[1] / T::lit(MERGE.1);
        if hypothesis.weight > T::zero() && ahead * ahead + askew * askew <= T::one() {
            let weight = core::mem::replace(&mut hypothesis.weight, T::zero());
            group.weight += weight;
            let lines = group.covariance.iter_mut().zip(hypothesis.covariance);
            for ((sum, apart_row), (line, own)) in group.state.iter_mut().zip(apart).zip(lines) {
                *sum += weight * apart_row;
                for ((entry, own), apart) in line.iter_mut().zip(own).zip(apart) {
                    *entry += weight * (own + apart_row * apart);
                }
            }
        }
    }
    let share = T::one() / group.weight;
    let middle = group.state.map(|sum| sum * share);
    for (((state, best), line), middle_row) in (group.state.iter_mut().zip(best.state))
        .zip(&mut group.covariance)
        .zip(middle)
    {
        *state = best + middle_row;
        for (entry, middle) in line.iter_mut().zip(middle) {
            *entry = *entry * share - middle_row * middle;
        }
    }
    group
}

pub(super) fn dot<T: Scalar>(a: &Vector<T>, b: &Vector<T>) -> T {
    a.iter().zip(b).fold(T::zero(), |sum, (&a, &b)| sum + a * b)
}

fn times<T: Scalar>(matrix: &Matrix<T>, vector: &Vector<T>) -> Vector<T> {
    matrix.map(|row| dot(&row, vector))
}

pub(super) fn diagonal<T: Scalar>(matrix: &Matrix<T>) -> Vector<T> {
    let [a, b, c, d] = matrix;
    [a[0], b[1], c[2], d[3]]
}

pub(super) fn transposed<T: Scalar>(matrix: &Matrix<T>) -> Matrix<T> {
    let [a, b, c, d] = matrix;
    [
        [a[0], b[0], c[0], d[0]],
        [a[1], b[1], c[1], d[1]],
        [a[2], b[2], c[2], d[2]],
        [a[3], b[3], c[3], d[3]],
    ]
}
