//! How the errors of an estimate grow while the robot drives.

use super::settings::RowEstimatorSettings;
use crate::scalar::Scalar;

/// Offset (m), heading (rad), half width (m) and curvature (1/m), or errors of
/// these.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct State<T> {
    pub(super) offset: T,
    pub(super) heading: T,
    pub(super) half_width: T,
    pub(super) curvature: T,
}

impl<T: Scalar> State<T> {
    pub(super) fn zero() -> Self {
        Self {
            offset: T::zero(),
            heading: T::zero(),
            half_width: T::zero(),
            curvature: T::zero(),
        }
    }

    pub(super) fn plus(&self, other: &Self) -> Self {
        Self {
            offset: self.offset + other.offset,
            heading: self.heading + other.heading,
            half_width: self.half_width + other.half_width,
            curvature: self.curvature + other.curvature,
        }
    }

    pub(super) fn minus(&self, other: &Self) -> Self {
        Self {
            offset: self.offset - other.offset,
            heading: self.heading - other.heading,
            half_width: self.half_width - other.half_width,
            curvature: self.curvature - other.curvature,
        }
    }

    pub(super) fn times(&self, factor: T) -> Self {
        Self {
            offset: self.offset * factor,
            heading: self.heading * factor,
            half_width: self.half_width * factor,
            curvature: self.curvature * factor,
        }
    }

    pub(super) fn is_finite(&self) -> bool {
        // A sum of finite numbers within bounds is finite, any other number stays.
        (self.offset + self.heading + self.half_width + self.curvature).is_finite()
    }
}

/// The upper half of a symmetric matrix over offset, heading, half width and
/// curvature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Covariance<T> {
    pub(super) oo: T,
    pub(super) oh: T,
    pub(super) ow: T,
    pub(super) oc: T,
    pub(super) hh: T,
    pub(super) hw: T,
    pub(super) hc: T,
    pub(super) ww: T,
    pub(super) wc: T,
    pub(super) cc: T,
}

impl<T: Scalar> Covariance<T> {
    pub(super) fn diagonal(variances: &State<T>) -> Self {
        let zero = T::zero();
        Self {
            oo: variances.offset,
            oh: zero,
            ow: zero,
            oc: zero,
            hh: variances.heading,
            hw: zero,
            hc: zero,
            ww: variances.half_width,
            wc: zero,
            cc: variances.curvature,
        }
    }

    pub(super) fn zero() -> Self {
        Self::diagonal(&State::zero())
    }

    /// This matrix plus `weight` times `other`.
    pub(super) fn add(&mut self, other: &Self, weight: T) {
        self.oo += other.oo * weight;
        self.oh += other.oh * weight;
        self.ow += other.ow * weight;
        self.oc += other.oc * weight;
        self.hh += other.hh * weight;
        self.hw += other.hw * weight;
        self.hc += other.hc * weight;
        self.ww += other.ww * weight;
        self.wc += other.wc * weight;
        self.cc += other.cc * weight;
    }

    /// This matrix plus `weight` times the product of a vector with itself.
    pub(super) fn add_square(&mut self, vector: &State<T>, weight: T) {
        let State {
            offset: o,
            heading: h,
            half_width: w,
            curvature: c,
        } = *vector;
        let weighted = vector.times(weight);
        self.oo += weighted.offset * o;
        self.oh += weighted.offset * h;
        self.ow += weighted.offset * w;
        self.oc += weighted.offset * c;
        self.hh += weighted.heading * h;
        self.hw += weighted.heading * w;
        self.hc += weighted.heading * c;
        self.ww += weighted.half_width * w;
        self.wc += weighted.half_width * c;
        self.cc += weighted.curvature * c;
    }

    pub(super) fn times_scalar(&self, factor: T) -> Self {
        let mut all = Self::zero();
        all.add(self, factor);
        all
    }

    /// The product with a vector whose curvature is zero.
    pub(super) fn times(&self, o: T, h: T, w: T) -> State<T> {
        State {
            offset: self.oo * o + self.oh * h + self.ow * w,
            heading: self.oh * o + self.hh * h + self.hw * w,
            half_width: self.ow * o + self.hw * h + self.ww * w,
            curvature: self.oc * o + self.hc * h + self.wc * w,
        }
    }
}

/// What a way makes of errors: `F` with the pattern
///
/// ```text
/// 1  lever  0           sweep
/// 0  1      0           bend
/// 0  0      keep_width  0
/// 0  0      0           keep_curvature
/// ```
///
/// and the covariance that the way adds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Drift<T> {
    lever: T,
    sweep: T,
    bend: T,
    keep_width: T,
    keep_curvature: T,
    noise: Covariance<T>,
    /// Way (m) and commanded turns (rad), each as a magnitude.
    way: T,
    turned: T,
}

impl<T: Scalar> Drift<T> {
    /// That of no way.
    pub(super) fn none() -> Self {
        Self {
            lever: T::zero(),
            sweep: T::zero(),
            bend: T::zero(),
            keep_width: T::one(),
            keep_curvature: T::one(),
            noise: Covariance::zero(),
            way: T::zero(),
            turned: T::zero(),
        }
    }

    /// That of one step: `ahead` (m), `turned` by command (rad), with the cosine of
    /// the heading against the rows.
    pub(super) fn step(settings: &RowEstimatorSettings<T>, ahead: T, turned: T, cosine: T) -> Self {
        let RowEstimatorSettings { rows, motion, .. } = settings;
        let way = ahead.abs();
        let turned = turned.abs();
        // Width and curvature return to what is known of them, along their ways.
        let keep = |length: T| {
            let left = T::one() - way / length;
            if left > T::zero() { left } else { T::zero() }
        };
        let (keep_width, keep_curvature) = (keep(rows.width_way), keep(motion.curvature_way));
        let square = |value: T| value * value;
        let renewed = |keep: T| T::one() - keep * keep;
        Self {
            lever: ahead * cosine,
            sweep: T::zero(),
            bend: ahead,
            keep_width,
            keep_curvature,
            noise: Covariance::diagonal(&State {
                offset: square(motion.offset_walk) * way,
                heading: square(motion.heading_walk) * way + square(motion.turn_error) * turned,
                half_width: square(rows.tolerance) * renewed(keep_width),
                curvature: square(motion.curvature) * renewed(keep_curvature),
            }),
            way,
            turned,
        }
    }

    /// Adds `next` behind this one.
    pub(super) fn extend(&mut self, next: &Self) {
        self.noise = next.spread(&self.noise);
        self.sweep += next.lever * self.bend;
        self.lever += next.lever;
        self.bend += next.bend * self.keep_curvature;
        self.keep_width *= next.keep_width;
        self.keep_curvature *= next.keep_curvature;
        self.way += next.way;
        self.turned += next.turned;
    }

    pub(super) fn way(&self) -> T {
        self.way
    }

    pub(super) fn turned(&self) -> T {
        self.turned
    }

    /// Error at the end of the way.
    pub(super) fn carry(&self, error: &State<T>) -> State<T> {
        State {
            offset: error.offset + self.lever * error.heading + self.sweep * error.curvature,
            heading: error.heading + self.bend * error.curvature,
            half_width: error.half_width * self.keep_width,
            curvature: error.curvature * self.keep_curvature,
        }
    }

    /// Covariance at the end of the way: `F P F' + noise`.
    pub(super) fn spread(&self, before: &Covariance<T>) -> Covariance<T> {
        let p = before;
        let (d, e, s) = (self.lever, self.sweep, self.bend);
        let (w, c) = (self.keep_width, self.keep_curvature);
        // Rows of F P, then columns.
        let oo = p.oo + d * p.oh + e * p.oc;
        let oh = p.oh + d * p.hh + e * p.hc;
        let ow = p.ow + d * p.hw + e * p.wc;
        let oc = p.oc + d * p.hc + e * p.cc;
        let hh = p.hh + s * p.hc;
        let hw = p.hw + s * p.wc;
        let hc = p.hc + s * p.cc;
        let q = &self.noise;
        Covariance {
            oo: oo + d * oh + e * oc + q.oo,
            oh: oh + s * oc + q.oh,
            ow: ow * w + q.ow,
            oc: oc * c + q.oc,
            hh: hh + s * hc + q.hh,
            hw: hw * w + q.hw,
            hc: hc * c + q.hc,
            ww: p.ww * w * w + q.ww,
            wc: p.wc * w * c + q.wc,
            cc: p.cc * c * c + q.cc,
        }
    }

    /// Variance of the offset `reach` ahead at the end of the way.
    pub(super) fn variance_ahead(&self, before: &Covariance<T>, reach: T) -> T {
        let (h, c) = (self.lever + reach, self.sweep + reach * self.bend);
        let p = before;
        let q = &self.noise;
        let two = T::lit(2.0);
        p.oo + h * (two * p.oh + h * p.hh)
            + c * (two * (p.oc + h * p.hc) + c * p.cc)
            + q.oo
            + reach * (two * q.oh + reach * q.hh)
    }
}
