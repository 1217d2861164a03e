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

/// A position and a course from which an estimate begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Beginning<T> {
    /// Variance of the position, per axis, m^2.
    pub(crate) position: T,
    /// Variance of the course, rad^2.
    pub(crate) course: T,
    /// Derivative of the course with respect to the steering angle.
    pub(crate) lead: T,
    /// Derivatives of the measured northing and easting with respect to heading and steering angle.
    pub(crate) north: [T; 2],
    pub(crate) east: [T; 2],
    /// Square of the distance from the rear axle to the measured point, m^2.
    pub(crate) lever: T,
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

    /// Forgets what was known of position and heading, which are computed anew from a position and a course. So the
    /// heading carries the errors of the heading bias and of the steering angle, and the position that of the heading.
    #[inline(never)]
    pub(crate) fn restart(&mut self, seen: &Beginning<T>) {
        let k = seen.lead;
        let (ss, sb, sc) = (self.ss, self.sb, self.sc);
        let (hs, hb, hc) = (-sb - k * ss, -self.bb - k * sb, -self.bc - k * sc);
        let hh = seen.course - hb - k * hs;
        let [[nh, ns, nb, nc], [eh, es, eb, ec]] = [seen.north, seen.east].map(|[of_h, of_s]| {
            [
                -of_h * hh - of_s * hs,
                -of_h * hs - of_s * ss,
                -of_h * hb - of_s * sb,
                -of_h * hc - of_s * sc,
            ]
        });
        // An error of the heading moves the position along an arc, but its covariances hold for the tangent alone.
        let position = seen.position + seen.lever * hh * hh * T::lit(0.5);
        *self = Self {
            nn: position - seen.north[0] * nh - seen.north[1] * ns,
            ne: -seen.north[0] * eh - seen.north[1] * es,
            nh,
            ns,
            nb,
            nc,
            ee: position - seen.east[0] * eh - seen.east[1] * es,
            eh,
            es,
            eb,
            ec,
            hh,
            hs,
            hb,
            hc,
            ..*self
        };
    }

    /// The variance of a point that is `north` and `east` (m) of the position and turns with the heading, north plus
    /// east, m^2.
    pub(crate) fn place(&self, north: T, east: T) -> T {
        let turned = north * self.eh - east * self.nh;
        self.nn + self.ee + T::lit(2.0) * turned + (north * north + east * east) * self.hh
    }

    /// P <- F P F' + Q, with the variances `drift` on the diagonal of Q and the covariance `along` of north and east.
    ///
    /// With the heading m in the middle of the step, F maps n to n + `north` m, e to e + `east` m
    /// and h to h + `turn` s, where m = h + s `turn` / 2.
    #[inline(always)]
    pub(crate) fn advance(&mut self, by: &Transition<T>, drift: &[T; STATES], along: T) {
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
        self.ne += east * mn + north * east_middle + along;
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::SVector;
    use proptest::prelude::*;

    type Matrix = SMatrix<f64, STATES, STATES>;

    fn of(matrix: &Matrix) -> Covariance<f64> {
        let at = |row, column| matrix[(row, column)];
        Covariance {
            nn: at(0, 0),
            ne: at(0, 1),
            nh: at(0, 2),
            ns: at(0, 3),
            nb: at(0, 4),
            nc: at(0, 5),
            ee: at(1, 1),
            eh: at(1, 2),
            es: at(1, 3),
            eb: at(1, 4),
            ec: at(1, 5),
            hh: at(2, 2),
            hs: at(2, 3),
            hb: at(2, 4),
            hc: at(2, 5),
            ss: at(3, 3),
            sb: at(3, 4),
            sc: at(3, 5),
            bb: at(4, 4),
            bc: at(4, 5),
            cc: at(5, 5),
        }
    }

    proptest! {
        /// No covariance has a negative eigenvalue. Before, the heading of a new estimate had nothing of the errors of
        /// steering angle and steering bias, which left some with one.
        #[test]
        fn a_covariance_stays_one_when_the_estimate_starts_anew(
            factors in prop::array::uniform32(-1.0..1.0_f64),
            course in 1e-4..0.1_f64,
            lead in -2.0..2.0_f64,
            rows in prop::array::uniform4(-2.0..2.0_f64),
        ) {
            let factor = Matrix::from_fn(|row, column| factors[(6 * row + column) % 32]);
            let mut covariance = of(&(factor * factor.transpose()));
            let [of_heading, of_steering, east_of_heading, east_of_steering] = rows;
            covariance.restart(&Beginning {
                position: 1e-4,
                course,
                lead,
                north: [of_heading, of_steering],
                east: [east_of_heading, east_of_steering],
                lever: 1.0,
            });
            let eigenvalues = covariance.matrix().symmetric_eigenvalues();
            prop_assert!(eigenvalues.min() > -1e-9, "{eigenvalues}");
        }

        /// The variance of a point that turns with the heading is that of its two coordinates.
        #[test]
        fn a_place_has_the_variance_of_its_coordinates(
            factors in prop::array::uniform32(-1.0..1.0_f64),
            north in -3.0..3.0_f64,
            east in -3.0..3.0_f64,
        ) {
            let factor = Matrix::from_fn(|row, column| factors[(6 * row + column) % 32]);
            let matrix = factor * factor.transpose();
            let rows = [
                SVector::from([1.0, 0.0, -east, 0.0, 0.0, 0.0]),
                SVector::from([0.0, 1.0, north, 0.0, 0.0, 0.0]),
            ];
            let known: f64 = rows.iter().map(|row| row.dot(&(matrix * row))).sum();
            let found = of(&matrix).place(north, east);
            prop_assert!((found - known).abs() < 1e-9, "{found} {known}");
        }
    }
}
