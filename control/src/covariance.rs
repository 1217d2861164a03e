//! The covariance of the estimator's states.
//!
//! It is symmetric, so only its upper triangle is stored. The transition of a step differs from
//! the identity in five entries, and a measurement shows at most three states. The updates leave
//! out the products with zero.

use crate::scalar::Scalar;
use nalgebra::SMatrix;

/// Number of states: north, east, heading, steering angle, heading bias,
/// steering bias.
pub(crate) const STATES: usize = 6;
pub(crate) const NORTH: usize = 0;
pub(crate) const EAST: usize = 1;
pub(crate) const HEADING: usize = 2;
pub(crate) const STEERING: usize = 3;
pub(crate) const HEADING_BIAS: usize = 4;
pub(crate) const STEERING_BIAS: usize = 5;

/// The upper triangle. The names of its entries are made of the first letters of north, east,
/// heading and steering angle, of b for the heading bias and of c for the steering bias.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Covariance<T> {
    nn: T,
    ne: T,
    nh: T,
    ns: T,
    nb: T,
    nc: T,
    ee: T,
    eh: T,
    es: T,
    eb: T,
    ec: T,
    hh: T,
    hs: T,
    hb: T,
    hc: T,
    ss: T,
    sb: T,
    sc: T,
    bb: T,
    bc: T,
    cc: T,
}

/// The derivatives of a step's motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Transition<T> {
    /// Of the northing with respect to the heading in the middle of the step, m.
    pub(crate) north: T,
    /// Of the easting with respect to the heading in the middle of the step, m.
    pub(crate) east: T,
    /// Of the turn with respect to the steering angle.
    pub(crate) turn: T,
}

impl<T: Scalar> Covariance<T> {
    /// States that are known exactly.
    pub(crate) fn zero() -> Self {
        let zero = T::zero();
        Self {
            nn: zero,
            ne: zero,
            nh: zero,
            ns: zero,
            nb: zero,
            nc: zero,
            ee: zero,
            eh: zero,
            es: zero,
            eb: zero,
            ec: zero,
            hh: zero,
            hs: zero,
            hb: zero,
            hc: zero,
            ss: zero,
            sb: zero,
            sc: zero,
            bb: zero,
            bc: zero,
            cc: zero,
        }
    }

    /// As a matrix.
    pub(crate) fn matrix(&self) -> SMatrix<T, STATES, STATES> {
        let columns = self.columns();
        SMatrix::from_fn(|row, column| columns[column][row])
    }

    /// Its columns. Where only some are used, only those are read.
    #[inline(always)]
    pub(crate) fn columns(&self) -> [[T; STATES]; STATES] {
        [
            [self.nn, self.ne, self.nh, self.ns, self.nb, self.nc],
            [self.ne, self.ee, self.eh, self.es, self.eb, self.ec],
            [self.nh, self.eh, self.hh, self.hs, self.hb, self.hc],
            [self.ns, self.es, self.hs, self.ss, self.sb, self.sc],
            [self.nb, self.eb, self.hb, self.sb, self.bb, self.bc],
            [self.nc, self.ec, self.hc, self.sc, self.bc, self.cc],
        ]
    }

    /// The variance of each state.
    pub(crate) fn variances(&self) -> [T; STATES] {
        let [n, e, h, s, b, c] = self.columns();
        [n[0], e[1], h[2], s[3], b[4], c[5]]
    }

    /// Replaces the variances of the steering angle and of the biases.
    pub(crate) fn set_angles(&mut self, steering: T, heading_bias: T, steering_bias: T) {
        self.ss = steering;
        self.bb = heading_bias;
        self.cc = steering_bias;
    }

    /// Forgets what was known of position and heading. The new heading carries the error of the
    /// estimated heading bias, which was subtracted from it. `position` (m^2) and `course` (rad^2)
    /// are the variances of what is known now.
    pub(crate) fn restart(&mut self, position: T, course: T) {
        *self = Self {
            nn: position,
            ee: position,
            hh: course + self.bb,
            hb: -self.bb,
            ss: self.ss,
            sb: self.sb,
            sc: self.sc,
            bb: self.bb,
            bc: self.bc,
            cc: self.cc,
            ..Self::zero()
        };
    }

    /// P <- F P F' + Q, with the variances `drift` on the diagonal of Q.
    ///
    /// With the heading m in the middle of the step, F maps n to n + `north` m, e to e + `east` m
    /// and h to h + `turn` s, where m = h + s `turn` / 2.
    #[inline(always)]
    pub(crate) fn advance(&mut self, by: &Transition<T>, drift: &[T; STATES]) {
        let &Transition { north, east, turn } = by;
        let half = turn * T::lit(0.5);
        let mn = self.nh + half * self.ns;
        let me = self.eh + half * self.es;
        let ms = self.hs + half * self.ss;
        let mb = self.hb + half * self.sb;
        let mc = self.hc + half * self.sc;
        let mm = self.hh + half * (self.hs + ms);
        // Of m and the new heading.
        let mh = mm + half * ms;
        let north_middle = mn + north * mm;
        let east_middle = me + east * mm;
        self.nh += turn * self.ns + north * mh;
        self.eh += turn * self.es + east * mh;
        self.nn += north * (mn + north_middle) + drift[NORTH];
        self.ne += east * mn + north * east_middle;
        self.ee += east * (me + east_middle) + drift[EAST];
        self.ns += north * ms;
        self.nb += north * mb;
        self.nc += north * mc;
        self.es += east * ms;
        self.eb += east * mb;
        self.ec += east * mc;
        let before = self.hs;
        self.hs += turn * self.ss;
        self.hh += turn * (before + self.hs) + drift[HEADING];
        self.hb += turn * self.sb;
        self.hc += turn * self.sc;
        self.ss += drift[STEERING];
        self.bb += drift[HEADING_BIAS];
        self.cc += drift[STEERING_BIAS];
    }

    /// P <- P - c c' / s for a measurement with the covariances `cross` (c) of its error with the
    /// states and the inverse variance `inverse` (1 / s) of its innovation. Without `biases` the
    /// entries of the biases alone stay: the update of Schmidt and Kalman, in which their gain is
    /// zero.
    #[inline(always)]
    pub(crate) fn correct(&mut self, cross: &[T; STATES], inverse: T, biases: bool) {
        let &[n, e, h, s, b, c] = cross;
        let gain = n * inverse;
        self.nn -= gain * n;
        self.ne -= gain * e;
        self.nh -= gain * h;
        self.ns -= gain * s;
        self.nb -= gain * b;
        self.nc -= gain * c;
        let gain = e * inverse;
        self.ee -= gain * e;
        self.eh -= gain * h;
        self.es -= gain * s;
        self.eb -= gain * b;
        self.ec -= gain * c;
        let gain = h * inverse;
        self.hh -= gain * h;
        self.hs -= gain * s;
        self.hb -= gain * b;
        self.hc -= gain * c;
        let gain = s * inverse;
        self.ss -= gain * s;
        self.sb -= gain * b;
        self.sc -= gain * c;
        if biases {
            let gain = b * inverse;
            self.bb -= gain * b;
            self.bc -= gain * c;
            self.cc -= c * inverse * c;
        }
    }
}
