//! Pieces of clothoids: curvature changes linearly along them.

use crate::place::Local;

/// A position and a direction.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Where.
    pub place: Local,
    /// Radians clockwise from north. Not reduced to one turn.
    pub heading: f64,
}

/// A piece of a clothoid; with sharpness 0 an arc, with curvature 0 as well a straight line.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Segment {
    /// Pose at its beginning.
    pub start: Pose,
    /// Curvature at its beginning, 1/m, positive to the right.
    pub curvature: f64,
    /// Change of curvature along it, 1/m2.
    pub sharpness: f64,
    /// Length, m.
    pub length: f64,
}

/// Abscissae above zero and weights of the Gauss-Legendre rule with eight points (Abramowitz and Stegun, table 25.4).
const RULE: [(f64, f64); 4] = [
    (0.183_434_642_495_649_8, 0.362_683_783_378_362),
    (0.525_532_409_916_329, 0.313_706_645_877_887_3),
    (0.796_666_477_413_626_7, 0.222_381_034_453_374_48),
    (0.960_289_856_497_536_3, 0.101_228_536_290_376_26),
];

/// Integral of a function with several values over 0 to 1. With `panels` so many that phases change by up to a radian in each,
/// sines and cosines are integrated to the last bits.
pub(super) fn integral<const N: usize>(
    panels: usize,
    function: impl Fn(f64) -> [f64; N],
) -> [f64; N] {
    let half = 0.5 / panels as f64;
    let mut sum = [0.0; N];
    for panel in 0..panels {
        let middle = (2 * panel + 1) as f64 * half;
        for (place, weight) in RULE {
            for at in [middle - half * place, middle + half * place] {
                for (sum, value) in sum.iter_mut().zip(function(at)) {
                    *sum += weight * half * value;
                }
            }
        }
    }
    sum
}

/// Panels for a phase that changes by this much, rad.
pub(super) fn panels(change: f64) -> usize {
    (change.abs().ceil() as usize).clamp(1, 1000)
}

impl Segment {
    /// Curvature at a distance along it, 1/m.
    #[must_use]
    pub fn curvature_at(&self, along: f64) -> f64 {
        self.curvature + self.sharpness * along
    }

    /// Pose at a distance along it, m. It goes on beyond its ends. The place is exact to the last bits up to a thousand radians of
    /// turning.
    #[must_use]
    pub fn at(&self, along: f64) -> Pose {
        let turn = |at: f64| along * at * (self.curvature + 0.5 * self.sharpness * along * at);
        let change = along.abs() * self.curvature.abs().max(self.curvature_at(along).abs());
        let [north, east] = integral(panels(change), |at| {
            let (sine, cosine) = (self.start.heading + turn(at)).sin_cos();
            [cosine, sine]
        });
        let Local {
            north: from_north,
            east: from_east,
        } = self.start.place;
        Pose {
            place: Local::new(from_north + along * north, from_east + along * east),
            heading: self.start.heading + turn(1.0),
        }
    }

    /// Pose at its end.
    #[must_use]
    pub fn end(&self) -> Pose {
        self.at(self.length)
    }

    /// The largest curvature in size on it, 1/m, and how far along it is.
    #[must_use]
    pub fn tightest(&self) -> (f64, f64) {
        let end = self.curvature_at(self.length);
        match self.curvature.abs() >= end.abs() {
            true => (self.curvature, 0.0),
            false => (end, self.length),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::f64::consts::PI;

    #[test]
    fn a_clothoid_has_fresnel_s_values() {
        // C(1) and S(1), Abramowitz and Stegun, table 7.7: curvature pi s.
        let unit = Segment {
            sharpness: PI,
            length: 1.0,
            ..Segment::default()
        };
        let end = unit.end();
        assert!(
            (end.place.north - 0.779_893_400_376_822_8).abs() < 1e-15,
            "{end:?}"
        );
        assert!(
            (end.place.east - 0.438_259_147_390_354_76).abs() < 1e-15,
            "{end:?}"
        );
        assert_eq!(unit.tightest(), (PI, 1.0));
    }

    proptest! {
        #[test]
        fn arcs_are_circles(curvature in -2.0_f64..2.0, length in 0.0_f64..50.0, heading in -PI..PI) {
            let start = Pose { place: Local::new(5.0, -3.0), heading };
            let arc = Segment { start, curvature, sharpness: 0.0, length };
            let right = heading + PI / 2.0;
            prop_assume!(curvature.abs() > 1e-3);
            let centre = start.place.towards(right, 1.0 / curvature);
            let end = arc.end();
            prop_assert!((end.place.distance(centre) - 1.0 / curvature.abs()).abs() < 1e-10);
            prop_assert!((end.heading - heading - curvature * length).abs() < 1e-12);
        }

        #[test]
        fn two_halves_are_the_whole(
            curvature in -1.0_f64..1.0, sharpness in -0.3_f64..0.3, length in 0.0_f64..20.0, share in 0.0_f64..1.0,
        ) {
            let whole = Segment { start: Pose::default(), curvature, sharpness, length };
            let cut = share * length;
            let rest = Segment {
                start: whole.at(cut), curvature: whole.curvature_at(cut), sharpness, length: length - cut,
            };
            prop_assert!(rest.end().place.distance(whole.end().place) < 1e-11);
            prop_assert!((rest.end().heading - whole.end().heading).abs() < 1e-11);
        }
    }
}
