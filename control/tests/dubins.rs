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
