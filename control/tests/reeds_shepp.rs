//! Reeds-Shepp paths: known lengths, and properties of shortest paths.

use control::dubins::{self, DubinsError, Pose, advance};
use control::reeds_shepp::shortest;
use proptest::prelude::*;
use std::f64::consts::PI;

/// North, east, heading, radius and length of the shortest path from the origin, computed by OMPL
/// (`fixtures/generate_reeds_shepp.py`).
fn known() -> Vec<[f64; 5]> {
    serde_json::from_str(include_str!("fixtures/reeds_shepp.json")).unwrap()
}

#[test]
fn lengths_are_those_of_ompl() {
    let cases = known();
    assert_eq!(cases.len(), 600);
    let mut kinds = std::collections::BTreeSet::new();
    for [north, east, heading, radius, length] in cases {
        let end = Pose {
            north,
            east,
            heading,
        };
        let path = shortest(Pose::default(), end, radius).unwrap();
        let found = path.length();
        assert!(
            (found - length).abs() < 1e-6,
            "{end:?}: {found}, not {length}"
        );
        let driven = path.pieces.iter().filter(|piece| piece.1 != 0.0).count();
        kinds.insert((driven, path.reversals()));
        let cast = |pose: Pose<f64>| Pose {
            north: pose.north as f32,
            east: pose.east as f32,
            heading: pose.heading as f32,
        };
        let single = shortest(Pose::default(), cast(end), radius as f32).unwrap();
        let off = (f64::from(single.length()) - length).abs();
        assert!(off < 1e-2, "{end:?}: {off} in single precision");
    }
    println!("pieces and reversals: {kinds:?}");
    // Words of every family are among them.
    for kind in [(3, 0), (3, 1), (3, 2), (4, 1), (4, 2), (5, 2)] {
        assert!(kinds.contains(&kind), "{kind:?}");
    }
}

fn poses() -> impl Strategy<Value = Pose<f64>> {
    (-6.0_f64..6.0, -6.0_f64..6.0, -PI..PI).prop_map(|(north, east, heading)| Pose {
        north,
        east,
        heading,
    })
}

proptest! {
    #[test]
    fn paths_end_where_they_should(start in poses(), end in poses(), radius in 0.5_f64..4.0) {
        let path = shortest(start, end, radius).unwrap();
        let reached = path.end(start);
        prop_assert!((reached.north - end.north).hypot(reached.east - end.east) < 1e-6);
        prop_assert!((reached.heading - end.heading).sin().abs() < 1e-6);
        prop_assert!((reached.heading - end.heading).cos() > 0.9);
        let direct = (end.north - start.north).hypot(end.east - start.east);
        prop_assert!(path.length() >= direct - 1e-6);
    }

    #[test]
    fn reverse_never_makes_it_longer(start in poses(), end in poses(), radius in 0.5_f64..4.0) {
        let forward = dubins::shortest(start, end, radius).unwrap().length();
        prop_assert!(shortest(start, end, radius).unwrap().length() <= forward + 1e-9);
    }

    /// The way back is as long, and so is the way from the end's image.
    #[test]
    fn directions_are_equal(start in poses(), end in poses()) {
        let there = shortest(start, end, 1.5).unwrap().length();
        let back = shortest(end, start, 1.5).unwrap().length();
        prop_assert!((there - back).abs() < 1e-5, "{there} and {back}");
        let turned = |pose: Pose<f64>| Pose { heading: pose.heading + PI, ..pose };
        let reversed = shortest(turned(start), turned(end), 1.5).unwrap().length();
        prop_assert!((there - reversed).abs() < 1e-5, "{there} and {reversed}");
    }

    /// Triangle inequality: a path through another pose is never shorter.
    #[test]
    fn detours_are_not_shorter(
        start in poses(), end in poses(), curvature in -1.0_f64..1.0, length in -6.0_f64..6.0,
    ) {
        let by = advance(start, curvature, length);
        let direct = shortest(start, end, 1.0).unwrap().length();
        let detour = length.abs() + shortest(by, end, 1.0).unwrap().length();
        prop_assert!(direct <= detour + 1e-5, "{direct} and {detour}");
    }
}

#[test]
fn no_way_to_the_same_pose() {
    for step in 0..360 {
        let pose = Pose {
            north: f64::from(step % 7),
            east: -3.0,
            heading: f64::from(step).to_radians() - PI,
        };
        assert!(shortest(pose, pose, 2.0).unwrap().length() < 1e-9);
        let behind = advance(pose, 0.0, -3.0);
        let length = shortest(pose, behind, 2.0).unwrap().length();
        assert!((length - 3.0).abs() < 1e-9, "straight back: {length}");
    }
}

#[test]
fn bad_input_is_named() {
    let pose = Pose::<f64>::default();
    assert_eq!(shortest(pose, pose, -1.0), Err(DubinsError::Radius));
    let lost = Pose {
        east: f64::INFINITY,
        ..pose
    };
    assert_eq!(shortest(lost, pose, 1.0), Err(DubinsError::Pose));
    let spun = Pose {
        heading: f64::MAX,
        ..pose
    };
    assert_eq!(shortest(pose, spun, 1.0), Err(DubinsError::Pose));
}
