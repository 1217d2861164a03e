//! Line geometry.

use control::line::{Line, LineError};
use control::position::Position;
use control::scalar::wrap_angle;
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

#[test]
fn right_of_a_line_to_the_north_is_east() {
    let line = Line::<f64>::new(Position::new(0, 0), Position::new(243_000, 0)).unwrap();
    let place = line.locate(Position::new(10_000, 1_000));
    assert!((place.along - 10.0).abs() < 1e-12);
    assert!((place.cross_track - 1.0).abs() < 1e-12);
    assert!((line.heading_error(0.1) - 0.1).abs() < 1e-15);
}

#[test]
fn right_of_a_line_to_the_east_is_south() {
    let line = Line::<f64>::new(Position::new(0, 0), Position::new(0, 5_000)).unwrap();
    assert!((line.bearing() - FRAC_PI_2).abs() < 1e-15);
    assert!((line.locate(Position::new(-300, 100)).cross_track - 0.3).abs() < 1e-12);
}

#[test]
fn coincident_waypoints_are_refused() {
    let at = Position::new(7, -9);
    assert_eq!(
        Line::<f32>::new(at, at),
        Err(LineError::CoincidentWaypoints(at))
    );
}

proptest! {
    #[test]
    fn wrapped_angles_are_the_same_direction(angle in -200.0_f64..200.0) {
        let wrapped = wrap_angle(angle);
        prop_assert!(wrapped > -PI && wrapped <= PI);
        prop_assert!((wrapped.sin() - angle.sin()).abs() < 1e-12);
        prop_assert!((wrapped.cos() - angle.cos()).abs() < 1e-12);
    }

    /// A point with known coordinates relative to the line is located there, in
    /// double precision and, within its resolution, in single precision.
    #[test]
    fn points_are_found_where_they_were_put(
        north in -1_000_000_i32..1_000_000,
        east in -1_000_000_i32..1_000_000,
        bearing in -PI..PI,
        along in -200.0_f64..200.0,
        cross in -20.0_f64..20.0,
    ) {
        let point = |along: f64, cross: f64| Position::new(
            north + ((along * bearing.cos() - cross * bearing.sin()) * 1e3).round() as i32,
            east + ((along * bearing.sin() + cross * bearing.cos()) * 1e3).round() as i32,
        );
        let (from, to) = (Position::new(north, east), point(243.0, 0.0));
        let double = Line::<f64>::new(from, to).unwrap();
        let place = double.locate(point(along, cross));
        // The waypoints and the point are rounded to whole millimetres.
        prop_assert!((place.along - along).abs() < 2e-3);
        prop_assert!((place.cross_track - cross).abs() < 2e-3);
        let single = Line::<f32>::new(from, to).unwrap().locate(point(along, cross));
        prop_assert!((f64::from(single.along) - place.along).abs() < 1e-4);
        prop_assert!((f64::from(single.cross_track) - place.cross_track).abs() < 1e-4);
    }
}
