//! Clothoids: known ends by Fresnel integrals, and points located beside them.

use control::clothoid::travel;
use control::dubins::{Pose, advance};
use control::path::Segment;
use proptest::prelude::*;
use std::f64::consts::PI;

/// Ends computed by SciPy (`fixtures/generate_clothoids.py`).
fn known() -> Vec<[f64; 6]> {
    serde_json::from_str(include_str!("fixtures/clothoids.json")).unwrap()
}

#[test]
fn ends_are_those_of_fresnel_integrals() {
    let cases = known();
    assert_eq!(cases.len(), 200);
    let (mut double, mut single) = (0.0_f64, 0.0_f64);
    for [heading, curvature, sharpness, length, north, east] in cases {
        let start = Pose {
            heading,
            ..Pose::default()
        };
        let end = travel(start, curvature, sharpness, length);
        let off = (end.north - north).hypot(end.east - east);
        double = double.max(off / length.abs());
        let start = Pose {
            heading: heading as f32,
            ..Pose::default()
        };
        let end = travel(start, curvature as f32, sharpness as f32, length as f32);
        let off = (f64::from(end.north) - north).hypot(f64::from(end.east) - east);
        single = single.max(off / length.abs());
    }
    println!("largest error for a metre: {double:.1e}, in single precision {single:.1e}");
    assert!(double < 2e-8, "{double:e}");
    assert!(single < 1e-6, "{single:e}");
}

/// The stated error holds up to a length of 8 radii.
#[test]
fn long_spirals_are_integrated() {
    let start = Pose::<f64>::default();
    let end = travel(start, 0.0, 0.08, 10.0);
    let steps = 1_000_000;
    let (mut north, mut east) = (0.0, 0.0);
    for step in 0..steps {
        let at = (f64::from(step) + 0.5) * 10.0 / f64::from(steps);
        let heading = 0.04 * at * at;
        north += heading.cos() * 10.0 / f64::from(steps);
        east += heading.sin() * 10.0 / f64::from(steps);
    }
    let off = (end.north - north).hypot(end.east - east);
    assert!(off < 2e-7, "{off:e}");
}

#[test]
fn without_sharpness_it_is_an_arc_to_the_bit() {
    for step in -100..100 {
        let length = f64::from(step) * 0.137;
        let start = Pose {
            north: 1.0,
            east: -2.0,
            heading: 0.3,
        };
        for curvature in [0.0, 0.21, -0.4] {
            let known = advance(start, curvature, length);
            assert_eq!(travel(start, curvature, 0.0, length), known);
        }
    }
}

fn clothoids() -> impl Strategy<Value = Segment<f64>> {
    let start = (-5.0_f64..5.0, -5.0_f64..5.0, -PI..PI);
    let sharpness = prop_oneof![0.01_f64..0.15, -0.15_f64..-0.01];
    (start, -0.4_f64..0.4, sharpness, 0.5_f64..5.0).prop_map(
        |((north, east, heading), curvature, sharpness, length)| Segment {
            start: Pose {
                north,
                east,
                heading,
            },
            curvature,
            sharpness,
            length,
        },
    )
}

proptest! {
    /// Driven in two parts, and there and back.
    #[test]
    fn parts_make_the_whole(segment in clothoids(), share in 0.0_f64..1.0) {
        let middle = segment.pose(share * segment.length);
        let curvature = segment.curvature_at(share * segment.length);
        let rest = (1.0 - share) * segment.length;
        let end = travel(middle, curvature, segment.sharpness, rest);
        let known = segment.end();
        prop_assert!((end.north - known.north).hypot(end.east - known.east) < 2e-7);
        prop_assert!((end.heading - known.heading).sin().abs() < 1e-12);
        let back = travel(
            end,
            segment.curvature_at(segment.length),
            segment.sharpness,
            -segment.length,
        );
        let start = segment.start;
        prop_assert!((back.north - start.north).hypot(back.east - start.east) < 2e-7);
    }

    /// A point placed beside a clothoid, or beside its continuation, is located there.
    #[test]
    fn points_beside_a_clothoid_are_found(
        segment in clothoids(), share in -0.2_f64..1.2, cross in -0.4_f64..0.4,
        nudge in -0.4_f64..0.4,
    ) {
        let along = share * segment.length;
        let on = segment.pose(along);
        let largest = segment.curvature.abs().max(segment.curvature_at(segment.length).abs());
        let cross = cross / largest.max(0.2);
        let place = segment.locate(
            on.north - cross * on.heading.sin(),
            on.east + cross * on.heading.cos(),
            along + nudge / largest.max(0.2),
        );
        prop_assert!((place.along - along).abs() < 1e-7, "{place:?}, {along}");
        // The stated error of the integration: the search integrates from where it begins.
        prop_assert!((place.cross_track - cross).abs() < 2e-8 * segment.length.max(1.0));
        prop_assert!((place.bearing - on.heading).sin().abs() < 1e-8);
    }

    /// The same in single precision, 100 m away from the origin.
    #[test]
    fn single_precision_is_good_to_a_tenth_of_a_millimetre(
        segment in clothoids(), share in 0.0_f64..1.0, cross in -0.5_f64..0.5,
    ) {
        let start = Pose { north: segment.start.north + 100.0, ..segment.start };
        let segment = Segment { start, ..segment };
        let along = share * segment.length;
        let on = segment.pose(along);
        let single = Segment {
            start: Pose {
                north: start.north as f32,
                east: start.east as f32,
                heading: start.heading as f32,
            },
            curvature: segment.curvature as f32,
            sharpness: segment.sharpness as f32,
            length: segment.length as f32,
        };
        let place = single.locate(
            (on.north - cross * on.heading.sin()) as f32,
            (on.east + cross * on.heading.cos()) as f32,
            along as f32 - 0.2,
        );
        prop_assert!((f64::from(place.along) - along).abs() < 1e-4, "{place:?}, {along}");
        prop_assert!((f64::from(place.cross_track) - cross).abs() < 1e-4);
    }

    /// From anywhere the search ends with a number.
    #[test]
    fn any_point_gives_a_place(
        segment in clothoids(), north in -50.0_f64..50.0, east in -50.0_f64..50.0,
        near in -10.0_f64..20.0,
    ) {
        let place = segment.locate(north, east, near);
        prop_assert!(place.along.is_finite() && place.cross_track.is_finite());
        prop_assert!(place.bearing.abs() <= PI);
    }
}
