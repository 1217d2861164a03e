//! Dubins paths: they end at the given pose, and brute force finds none that is
//! shorter.

use control::dubins::{DubinsError, Pose, advance, shortest, shortest_to_line};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

fn poses() -> impl Strategy<Value = Pose<f64>> {
    (-8.0_f64..8.0, -8.0_f64..8.0, -PI..PI).prop_map(|(north, east, heading)| Pose {
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
        prop_assert!((reached.north - end.north).abs() < 1e-6);
        prop_assert!((reached.east - end.east).abs() < 1e-6);
        prop_assert!((reached.heading - end.heading).sin().abs() < 1e-6);
        prop_assert!((reached.heading - end.heading).cos() > 0.9);
        let direct = (end.north - start.north).hypot(end.east - start.east);
        prop_assert!(path.length() >= direct - 1e-9);
    }

    /// Triangle inequality: a path through another pose is never shorter.
    #[test]
    fn detours_are_not_shorter(
        start in poses(), end in poses(), curvature in -1.0_f64..1.0, length in 0.0_f64..6.0,
    ) {
        let by = advance(start, curvature, length);
        let direct = shortest(start, end, 1.0).unwrap().length();
        let detour = length + shortest(by, end, 1.0).unwrap().length();
        prop_assert!(direct <= detour + 1e-6);
    }

    #[test]
    fn no_end_on_the_line_is_nearer(start in poses(), north in -20.0_f64..20.0) {
        let to_line = shortest_to_line(start, 2.0).unwrap().length();
        let end = Pose { north, ..Pose::default() };
        prop_assert!(to_line <= shortest(start, end, 2.0).unwrap().length() + 1e-3);
    }
}

/// Headings all round, at several places.
fn starts() -> impl Iterator<Item = Pose<f64>> {
    (0..3600).map(|step| Pose {
        north: f64::from(step % 7) * 13.7,
        east: f64::from(step % 11) * -3.3,
        heading: f64::from(step) * PI / 1800.0 - PI,
    })
}

/// Poses that are not connected by a path of about `length`, of all headings.
fn detours(length: f64, end: impl Fn(Pose<f64>) -> Pose<f64>) -> usize {
    let wrong = |start: &Pose<f64>| {
        let path = shortest(*start, end(*start), 2.0).unwrap();
        let (known, reached) = (end(*start), path.end(*start));
        let off = (known.north - reached.north).hypot(known.east - reached.east);
        path.length() > length + 1e-6 || off > 1e-6
    };
    starts().filter(wrong).count()
}

#[test]
fn no_way_to_the_same_pose() {
    assert_eq!(detours(0.0, |start| start), 0, "of 3600");
    let single = |start: &Pose<f64>| {
        let pose = Pose {
            north: start.north as f32,
            east: start.east as f32,
            heading: start.heading as f32,
        };
        shortest(pose, pose, 2.0).unwrap().length() > 0.0
    };
    assert_eq!(starts().filter(single).count(), 0, "of 3600");
}

/// Ends on the first arc, straight ahead, or behind two arcs: rounding errors must
/// not add a circle.
#[test]
fn paths_of_fewer_pieces_have_no_circle() {
    let mut wrong = [0; 4];
    for length in [0.001, 0.7, 2.0 * FRAC_PI_2, 5.0, 11.0] {
        wrong[0] += detours(length, |start| advance(start, 0.5, length));
        wrong[1] += detours(length, |start| advance(start, -0.5, length));
        wrong[2] += detours(length, |start| advance(start, 0.0, length));
        wrong[3] += detours(length + 1.0, |start| {
            advance(advance(start, 0.5, length), -0.5, 1.0)
        });
    }
    assert_eq!(wrong, [0; 4], "of 18 000 each");
}

/// Five metres off, computed by hand: turn until square to the line, drive
/// straight, turn onto it.
#[test]
fn approaches_from_five_metres() {
    let radius = 2.36;
    let length = |degrees: f64| {
        let start = Pose {
            north: 0.0,
            east: 5.0,
            heading: degrees.to_radians(),
        };
        shortest_to_line(start, radius).unwrap().length()
    };
    let by_hand = |turn: f64| {
        // Lateral distance of the turn that ends square to the line.
        let gained = radius * turn.sin();
        radius * turn + (5.0 - gained - radius) + radius * FRAC_PI_2
    };
    // Facing 45 degrees away: a turn of 135 degrees.
    assert!((length(45.0) - by_hand(135.0_f64.to_radians())).abs() < 1e-3);
    assert!((length(90.0) - by_hand(180.0_f64.to_radians())).abs() < 1e-3);
    // Facing 135 degrees away, the shorter turn goes through the direction
    // opposite to the line's.
    assert!((length(135.0) - length(45.0)).abs() < 1e-3);
}

#[test]
fn bad_input_is_named() {
    let pose = Pose::<f64>::default();
    assert_eq!(shortest(pose, pose, 0.0), Err(DubinsError::Radius));
    let lost = Pose {
        north: f64::NAN,
        ..pose
    };
    assert_eq!(shortest(pose, lost, 1.0), Err(DubinsError::Pose));
}

/// A heading of which rounding errors hide the direction, and a place whose square in radii is no number, are refused.
/// Either gave a path of which no length is known.
#[test]
fn poses_without_a_direction_or_a_distance_are_refused() {
    let at = |north: f32, heading: f32| Pose {
        north,
        east: 2.0,
        heading,
    };
    let near = at(0.0, 0.3);
    for lost in [f32::MAX, f32::MIN, 1e7, -1001.0].map(|heading| at(1.0, heading)) {
        for found in [shortest(lost, near, 2.0), shortest(near, lost, 2.0)] {
            assert_eq!(found, Err(DubinsError::Pose), "{lost:?}");
        }
    }
    for (far, radius) in [(f32::MAX, 2.0), (1e20, 1.0), (1.0, 1e-40)] {
        let found = shortest(near, at(far, 0.3), radius);
        assert_eq!(found, Err(DubinsError::Pose), "{far} {radius}");
    }
    // As far as the squares are numbers, there is a path.
    let path = shortest(near, at(1e15, 999.0), 1.0).unwrap();
    assert!((path.length() / 1e15 - 1.0).abs() < 1e-3, "{path:?}");
}
