//! The clothoid from one place and direction to another (E. Bertolazzi and M. Frego, G1 fitting with clothoids,
//! Mathematical Methods in the Applied Sciences 38, 2015), with the derivatives that a spline of them needs.

use super::segment::{Pose, Segment, integral, panels};
use crate::place::Local;

/// Largest angle between a direction and the chord for which a clothoid is looked for, rad. Beyond it, it winds.
pub(super) const WIDEST: f64 = 2.4;

/// A clothoid over a chord of length 1: it leaves the chord's direction by one angle and arrives with another.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hermite {
    /// Curvature at its beginning and its end.
    pub(super) curvature: (f64, f64),
    /// Derivatives of both by the first angle.
    pub(super) by_first: (f64, f64),
    /// Derivatives of both by the second angle.
    pub(super) by_second: (f64, f64),
    /// Length.
    pub(super) length: f64,
}

/// The clothoid for two angles against the chord, rad; `None` if none is found.
pub(super) fn unit(first: f64, second: f64) -> Option<Hermite> {
    if !(first.abs() <= WIDEST && second.abs() <= WIDEST) {
        return None;
    }
    // The direction along it is first + (difference - bend) t + bend t^2, so that its curvature changes by 2 bend / length.
    let difference = second - first;
    let mut bend = 3.0 * (first + second);
    let phase = |bend: f64, t: f64| first + difference * t + bend * (t * t - t);
    let count = |bend: f64| panels(difference.abs() + bend.abs());
    let mut converged = false;
    for _ in 0..30 {
        // Across the chord it must come back to it.
        let [across, slope] = integral(count(bend), |t| {
            let (sine, cosine) = phase(bend, t).sin_cos();
            [sine, (t * t - t) * cosine]
        });
        let step = across / slope;
        if !step.is_finite() {
            return None;
        }
        bend -= step.clamp(-2.0, 2.0);
        if step.abs() < 1e-13 * (1.0 + bend.abs()) {
            converged = true;
            break;
        }
    }
    if !converged {
        return None;
    }
    // Moments of cosine and sine: of 1, t and t^2.
    let [c0, c1, c2, s0, s1, s2] = integral(count(bend), |t| {
        let (sine, cosine) = phase(bend, t).sin_cos();
        [
            cosine,
            t * cosine,
            t * t * cosine,
            sine,
            t * sine,
            t * t * sine,
        ]
    });
    let slope = c2 - c1;
    if c0 <= 1e-3 || slope.abs() < 1e-9 {
        return None;
    }
    let (bend_first, bend_second) = (-(c0 - c1) / slope, -c1 / slope);
    let length = 1.0 / c0;
    let length_first = length * length * ((s2 - s1) * bend_first + s0 - s1);
    let length_second = length * length * ((s2 - s1) * bend_second + s1);
    let (start, end) = ((difference - bend) / length, (difference + bend) / length);
    Some(Hermite {
        curvature: (start, end),
        by_first: (
            (-1.0 - bend_first - start * length_first) / length,
            (-1.0 + bend_first - end * length_first) / length,
        ),
        by_second: (
            (1.0 - bend_second - start * length_second) / length,
            (1.0 + bend_second - end * length_second) / length,
        ),
        length,
    })
}

/// An angle as -pi to pi.
pub(crate) fn wrapped(angle: f64) -> f64 {
    angle - std::f64::consts::TAU * (angle / std::f64::consts::TAU).round()
}

/// The clothoid from one pose to a place with a heading; `None` if none is found.
pub(super) fn between(from: Pose, to: Local, heading: f64) -> Option<Segment> {
    let (chord, bearing) = (from.place.distance(to), from.place.bearing(to));
    let hermite = unit(wrapped(from.heading - bearing), wrapped(heading - bearing))?;
    let (start, end) = hermite.curvature;
    let length = hermite.length * chord;
    Some(Segment {
        start: from,
        curvature: start / chord,
        sharpness: (end - start) / chord / length,
        length,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn it_is_the_one_of_bertolazzi_s_library() {
        // Written by `tests/data/oracle.py`.
        let table = include_str!("../../tests/data/clothoids.csv");
        let mut count = 0;
        for row in table.lines().skip(1) {
            let values: Vec<f64> = row.split(',').map(|field| field.parse().unwrap()).collect();
            let [heading, north, east, end, curvature, sharpness, length] = values[..] else {
                panic!("{row}")
            };
            let start = Pose {
                place: Local::default(),
                heading,
            };
            let found = between(start, Local::new(north, east), end).unwrap();
            let size = north.hypot(east);
            assert!(
                (found.curvature - curvature).abs() * size < 1e-8,
                "{row}: {found:?}"
            );
            assert!(
                (found.sharpness - sharpness).abs() * size * size < 1e-7,
                "{row}: {found:?}"
            );
            assert!(
                (found.length - length).abs() / size < 1e-9,
                "{row}: {found:?}"
            );
            count += 1;
        }
        assert_eq!(count, 60);
    }

    proptest! {
        #[test]
        fn it_arrives(first in -1.5_f64..1.5, second in -1.5_f64..1.5, chord in 0.1_f64..100.0, bearing in -3.0_f64..3.0) {
            let start = Pose { place: Local::new(1.0, 2.0), heading: bearing + first };
            let to = start.place.towards(bearing, chord);
            let segment = between(start, to, bearing + second).unwrap();
            let end = segment.end();
            prop_assert!(end.place.distance(to) < 1e-10 * chord.max(1.0), "{:?} {:?}", end, to);
            prop_assert!(wrapped(end.heading - bearing - second).abs() < 1e-10);
            prop_assert!(segment.length < 4.0 * chord);
        }

        #[test]
        fn derivatives_are_those_of_small_differences(first in -1.4_f64..1.4, second in -1.4_f64..1.4) {
            let step = 1e-5;
            let curvature = |first, second| unit(first, second).unwrap().curvature;
            let at = unit(first, second).unwrap();
            let (up, down) = (curvature(first + step, second), curvature(first - step, second));
            prop_assert!(((up.0 - down.0) / (2.0 * step) - at.by_first.0).abs() < 1e-6);
            prop_assert!(((up.1 - down.1) / (2.0 * step) - at.by_first.1).abs() < 1e-6);
            let (up, down) = (curvature(first, second + step), curvature(first, second - step));
            prop_assert!(((up.0 - down.0) / (2.0 * step) - at.by_second.0).abs() < 1e-6);
            prop_assert!(((up.1 - down.1) / (2.0 * step) - at.by_second.1).abs() < 1e-6);
        }
    }
}
