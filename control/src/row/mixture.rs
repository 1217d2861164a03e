//! A weighted set of Gaussian hypotheses about the error of the estimate.
//!
//! Each run of readings may come from a stalk of the near row, from one of the next
//! row, which shows between those of the near one, or from something else. A
//! hypothesis therefore becomes three: in two of them the run corrects it, in the third
//! it does not. Hypotheses that agree are then merged, and the least likely are
//! dropped, so that their number stays bounded (B.-N. Vo and W.-K. Ma, "The
//! Gaussian mixture probability hypothesis density filter", IEEE Transactions on
//! Signal Processing 54, 2006, table II).
//!
//! All loops have constant counts: an unused hypothesis has the weight 0.

use super::beams::{Prediction, View};
use super::motion::{Covariance, Drift, State};
use super::settings::Odds;
use crate::scalar::Scalar;

/// Most hypotheses between two runs.
pub(super) const HYPOTHESES: usize = 5;
/// Distance within which two hypotheses are merged: of their offsets where the
/// beams meet the rows (m) and of their headings (rad).
const MERGE: (f64, f64) = (0.02, 0.05);
/// Weight below which a hypothesis is dropped.
const LEAST_WEIGHT: f64 = 1e-4;
/// Largest product of weight and probability density that is followed. The
/// density of a stalk is at most 0.4 over the least deviation.
const LARGEST_WEIGHT: f64 = 1e6;

/// Most hypotheses while they meet a run.
const CANDIDATES: usize = 3 * HYPOTHESES + 2;
// What limits the joins in `Mixture::reduce`.
const _: () = assert!(CANDIDATES == 17);

/// A Gaussian with a weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Hypothesis<T> {
    pub(super) weight: T,
    /// Difference from the estimate.
    pub(super) state: State<T>,
    pub(super) covariance: Covariance<T>,
}

/// A run of readings that may come from a stalk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Finding<T> {
    /// The row at its side, from the estimate.
    pub(super) view: View<T>,
    /// Measured distance, m.
    pub(super) distance: T,
    /// Deviation of a stalk from its row, m.
    pub(super) scatter: T,
    /// The same of a stalk of the next row, m.
    pub(super) far_scatter: T,
    /// Distance to the next row, m; 0 without one.
    pub(super) spacing: T,
    /// What else it may come from.
    pub(super) odds: Odds<T>,
}

/// Limits of what is followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds<T> {
    /// Largest variances.
    pub(super) most: State<T>,
    /// Least variances. They keep rounding from making a variance negative.
    pub(super) least: State<T>,
}

impl<T: Scalar> Hypothesis<T> {
    pub(super) fn unused() -> Self {
        Self {
            weight: T::zero(),
            state: State::zero(),
            covariance: Covariance::zero(),
        }
    }

    /// The hypothesis in which the run came from a stalk whose row was predicted
    /// at `seen`, and which stands beside it by `scatter` (m).
    fn hit(&self, finding: &Finding<T>, seen: &Prediction<T>, scatter: T) -> Self {
        let (o, h, w) = (seen.by_offset, seen.by_heading, seen.by_half_width);
        let cross = self.covariance.times(o, h, w);
        let scatter = scatter * w;
        let spread =
            cross.offset * o + cross.heading * h + cross.half_width * w + scatter * scatter;
        if !(spread > T::zero()) {
            return Self::unused();
        }
        let excess = finding.distance - seen.distance;
        let certainty = T::one() / spread;
        // A bell with heavier tails than a Gaussian: (1 + x / 8)^-4 is near
        // exp(-x / 2) for small x. The factor is 1 / sqrt(2 pi).
        let tail = T::one() + excess * excess * certainty * T::lit(0.125);
        let tail = tail * tail;
        let bell = T::lit(0.399) * spread.reciprocal_root() / (tail * tail);
        let mut covariance = self.covariance;
        covariance.add_square(&cross, -certainty);
        Self {
            weight: self.weight * finding.odds.stalk * bell,
            state: self.state.plus(&cross.times(certainty * excess)),
            covariance,
        }
    }

    /// Makes this hypothesis that of a run which did not come from a stalk, and
    /// returns those in which it came from one of the near row, and from one of the
    /// next row. All weights are multiplied by the probability density of the run. A
    /// hypothesis from which the beam does not meet the rows is dropped.
    fn split(&mut self, finding: &Finding<T>) -> [Self; 2] {
        let State {
            offset,
            heading,
            half_width,
            ..
        } = self.state;
        let row = |behind| finding.view.predict(offset, heading, half_width + behind);
        let Some(near) = row(T::zero()) else {
            self.weight = T::zero();
            return [Self::unused(); 2];
        };
        let hit = self.hit(finding, &near, finding.scatter);
        let far = match row(finding.spacing) {
            Some(far) if finding.spacing > T::zero() => {
                self.hit(finding, &far, finding.far_scatter)
            }
            _ => Self::unused(),
        };
        self.weight *= if finding.distance < near.distance {
            finding.odds.near
        } else {
            finding.odds.far
        };
        [hit, far]
    }

    /// Keeps variances within bounds. False if the hypothesis is no number.
    fn limit(&mut self, bounds: &Bounds<T>) -> bool {
        let p = &mut self.covariance;
        let Bounds { most, least } = bounds;
        if !(p.oo <= most.offset && p.hh <= most.heading) {
            // So uncertain a hypothesis knows nothing of how its errors depend on
            // each other.
            *p = Covariance::diagonal(&State {
                offset: smaller(p.oo, most.offset),
                heading: smaller(p.hh, most.heading),
                half_width: smaller(p.ww, most.half_width),
                curvature: smaller(p.cc, most.curvature),
            });
        }
        raise(&mut p.oo, least.offset);
        raise(&mut p.hh, least.heading);
        raise(&mut p.ww, least.half_width);
        raise(&mut p.cc, least.curvature);
        let cross = p.oh + p.ow + p.oc + p.hw + p.hc + p.wc;
        self.state.is_finite() && self.weight.is_finite() && (p.ww + p.cc + cross).is_finite()
    }
}

/// The smaller value; `b` if `a` is NaN.
fn smaller<T: Scalar>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

fn raise<T: Scalar>(value: &mut T, least: T) {
    if !(*value > least) {
        *value = least;
    }
}

/// The hypotheses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Mixture<T> {
    /// The first [`HYPOTHESES`] of these, and room for those that arise while
    /// they meet a run.
    slots: [Hypothesis<T>; CANDIDATES],
    /// Weight below which one is dropped.
    least: T,
    /// Covariance of all.
    covariance: Covariance<T>,
}

impl<T: Scalar> Mixture<T> {
    /// One hypothesis.
    pub(super) fn of(covariance: Covariance<T>) -> Self {
        let mut slots = [Hypothesis::unused(); CANDIDATES];
        slots[0] = Hypothesis {
            weight: T::one(),
            state: State::zero(),
            covariance,
        };
        Self {
            slots,
            least: T::zero(),
            covariance,
        }
    }

    /// Covariance of all hypotheses about the estimate.
    pub(super) fn covariance(&self) -> &Covariance<T> {
        &self.covariance
    }

    /// Moves all hypotheses.
    pub(super) fn advance(&mut self, drift: &Drift<T>) {
        self.covariance = drift.spread(&self.covariance);
        for hypothesis in self.slots.iter_mut().take(HYPOTHESES) {
            hypothesis.state = drift.carry(&hypothesis.state);
            hypothesis.covariance = drift.spread(&hypothesis.covariance);
        }
    }

    /// Splits each hypothesis by a run. A run also speaks for `fresh`, in which it
    /// corrects one that knows nothing. Returns the probability that the run came
    /// from a stalk by the old hypotheses, or `None` if none of them can explain it.
    /// [`Mixture::reduce`] must follow.
    pub(super) fn meet(&mut self, finding: &Finding<T>, mut fresh: Hypothesis<T>) -> Option<T> {
        let (misses, hits) = self.slots.split_at_mut(HYPOTHESES);
        let (nears, fars) = hits.split_at_mut(HYPOTHESES + 1);
        let (mut total, mut stalk) = (T::zero(), T::zero());
        for ((miss, near), far) in misses.iter_mut().zip(nears.iter_mut()).zip(fars.iter_mut()) {
            [*near, *far] = if miss.weight > T::zero() {
                miss.split(finding)
            } else {
                [Hypothesis::unused(); 2]
            };
            stalk += near.weight + far.weight;
            total += near.weight + far.weight + miss.weight;
        }
        if let (Some(near), Some(far)) = (nears.last_mut(), fars.last_mut()) {
            [*near, *far] = fresh.split(finding);
        }
        self.least = total * T::lit(LEAST_WEIGHT);
        (total > T::zero() && total < T::lit(LARGEST_WEIGHT)).then(|| stalk / total)
    }

    /// Gathers hypotheses that agree, the likeliest first, and drops what is left.
    /// `reach` is the distance ahead at which the beams meet the rows, m.
    pub(super) fn reduce(&mut self, reach: T) {
        let mut groups = [Hypothesis::unused(); HYPOTHESES];
        // loop-bound: 5 all groups
        for group in &mut groups {
            let Some(centre) = self.likeliest() else {
                break;
            };
            let mut sum = Hypothesis::unused();
            for hypothesis in &mut self.slots {
                if hypothesis.weight > T::zero() && agree(&hypothesis.state, &centre, reach) {
                    // at-most: 17 a hypothesis joins one group
                    join(&mut sum, &centre, hypothesis);
                }
            }
            *group = merged(&sum, &centre);
        }
        for (slot, group) in self.slots.iter_mut().zip(&groups) {
            *slot = *group;
        }
    }

    /// State of the likeliest hypothesis, if it is likely enough.
    fn likeliest(&self) -> Option<State<T>> {
        let mut best = None;
        let mut weight = self.least;
        // loop-bound: 17 all hypotheses
        for hypothesis in &self.slots {
            if hypothesis.weight > weight {
                weight = hypothesis.weight;
                best = Some(hypothesis.state);
            }
        }
        best
    }

    /// Normalises the weights and computes mean and covariance. Returns the mean,
    /// which is zero afterwards, or `None` if the hypotheses are no numbers.
    pub(super) fn settle(&mut self, bounds: &Bounds<T>) -> Option<State<T>> {
        let all = self.slots.iter().take(HYPOTHESES);
        let total = all.fold(T::zero(), |sum, hypothesis| sum + hypothesis.weight);
        if !(total > T::zero()) {
            return None;
        }
        let share = T::one() / total;
        let mut mean = State::zero();
        for hypothesis in self.slots.iter_mut().take(HYPOTHESES) {
            hypothesis.weight *= share;
            if !hypothesis.limit(bounds) {
                return None;
            }
            mean = mean.plus(&hypothesis.state.times(hypothesis.weight));
        }
        self.covariance = Covariance::zero();
        for hypothesis in self.slots.iter_mut().take(HYPOTHESES) {
            hypothesis.state = hypothesis.state.minus(&mean);
            self.covariance
                .add(&hypothesis.covariance, hypothesis.weight);
            self.covariance
                .add_square(&hypothesis.state, hypothesis.weight);
        }
        Some(mean)
    }
}

/// Whether two states are near enough to be merged.
fn agree<T: Scalar>(a: &State<T>, b: &State<T>, reach: T) -> bool {
    let heading = a.heading - b.heading;
    let ahead = a.offset - b.offset + reach * heading;
    let (ahead, askew) = (
        ahead * T::lit(1.0 / MERGE.0),
        heading * T::lit(1.0 / MERGE.1),
    );
    ahead * ahead + askew * askew <= T::one()
}

/// Adds a hypothesis to the sums of a group, with states from its centre, and leaves
/// it unused. A function of its own in the image, so that its calls can be counted.
#[inline(never)]
fn join<T: Scalar>(sum: &mut Hypothesis<T>, centre: &State<T>, hypothesis: &mut Hypothesis<T>) {
    let weight = core::mem::replace(&mut hypothesis.weight, T::zero());
    let apart = hypothesis.state.minus(centre);
    sum.weight += weight;
    sum.state = sum.state.plus(&apart.times(weight));
    sum.covariance.add(&hypothesis.covariance, weight);
    sum.covariance.add_square(&apart, weight);
}

/// The group with these sums as one hypothesis.
fn merged<T: Scalar>(sum: &Hypothesis<T>, centre: &State<T>) -> Hypothesis<T> {
    let share = T::one() / sum.weight;
    let middle = sum.state.times(share);
    let mut covariance = sum.covariance.times_scalar(share);
    covariance.add_square(&middle, -T::one());
    Hypothesis {
        weight: sum.weight,
        state: centre.plus(&middle),
        covariance,
    }
}
