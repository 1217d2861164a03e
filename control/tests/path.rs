//! Paths: passes, headland turns, progress along them.

use control::dubins::{Pose, advance};
use control::line::{Line, LineError};
use control::path::{Path, PathError, Progress, Segment};
use control::position::Position;
use control::scalar::Scalar;
use proptest::prelude::*;
use std::f64::consts::PI;

fn two_passes(apart: i32) -> Path<f64> {
    let out = (Position::new(0, 0), Position::new(30_000, 0));
    let back = (Position::new(30_000, apart), Position::new(0, apart));
    Path::passes(&[out, back], 3.0).unwrap()
}

proptest! {
    /// A point placed beside a segment is located there.
    #[test]
    fn points_beside_a_segment_are_found(
        north in -5.0_f64..5.0, east in -5.0_f64..5.0, heading in -PI..PI,
        curvature in prop_oneof![Just(0.0_f64), 0.1_f64..0.5, -0.5_f64..-0.1],
        along in 0.0_f64..9.0, cross in -1.5_f64..1.5, nudge in -1.0_f64..1.0,
    ) {
        let start = Pose { north, east, heading };
        let segment = Segment { start, curvature, sharpness: 0.0, length: 10.0 };
        let on = advance(start, curvature, along);
        let place = segment.locate(
            on.north - cross * on.heading.sin(),
            on.east + cross * on.heading.cos(),
            along + nudge,
        );
        prop_assert!((place.along - along).abs() < 1e-9);
        prop_assert!((place.cross_track - cross).abs() < 1e-9);
        prop_assert!((place.bearing - on.heading).sin().abs() < 1e-9);
    }

    /// A point that moves exactly along a path passes its whole length without
    /// error, on narrow and wide headlands.
    #[test]
    fn the_path_itself_has_no_error(apart in -15_000_i32..15_000) {
        prop_assume!(apart.abs() > 200);
        let path = two_passes(apart);
        let mut progress = Progress::start();
        for (number, segment) in path.segments().iter().enumerate() {
            let steps = (segment.length / 0.05).ceil();
            for step in 1..(steps as usize) {
                let at = advance(
                    segment.start,
                    segment.curvature,
                    segment.length * step as f64 / steps,
                );
                let place = progress.advance(&path, at.north, at.east);
                prop_assert!(place.cross_track.abs() < 2e-3, "{place:?} in {number}");
                prop_assert!((place.bearing - at.heading).sin().abs() < 1e-3);
                prop_assert_eq!(progress.segment, number);
            }
        }
    }
}

/// Errors of both distances (m) that `locate` returns for a point `along` metres on an arc and up to
/// 3 m beside it: `aside` in (-1, 1) is its share of that, and towards the centre of a smaller arc
/// its share of the radius. The place last known is `nudge` metres farther on, or on a smaller
/// arc radii.
fn located<T: Scalar>(
    curvature: T,
    heading: f64,
    along: f64,
    aside: f64,
    nudge: f64,
) -> (f64, f64) {
    let exact = curvature.as_f64();
    let radius = 1.0 / exact.abs();
    // Beyond the centre another place would be nearer.
    let room = if aside * exact > 0.0 {
        radius.min(3.0)
    } else {
        3.0
    };
    let cross = aside * room;
    // The start has coordinates and a heading that both number types represent.
    let heading = T::lit(heading);
    let start = Pose {
        north: 0.0,
        east: 0.0,
        heading: heading.as_f64(),
    };
    // A circle so small that the turn has no number is a point.
    let on = if (exact * along).is_finite() {
        advance(start, exact, along)
    } else {
        start
    };
    let segment = Segment {
        start: Pose {
            north: T::zero(),
            east: T::zero(),
            heading,
        },
        curvature,
        sharpness: T::zero(),
        length: T::lit(1000.0),
    };
    let place = segment.locate(
        T::lit(on.north - cross * on.heading.sin()),
        T::lit(on.east + cross * on.heading.cos()),
        T::lit(along + nudge * radius.min(1.0)),
    );
    (
        place.along.as_f64() - along,
        place.cross_track.as_f64() - cross,
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    /// Both distances come back within a millimetre on arcs of every curvature. The difference of
    /// radius and distance from the centre would be off by centimetres at 1e-6 1/m, and infinite at
    /// 1e-40 1/m.
    #[test]
    fn points_beside_an_arc_of_any_curvature_are_found(
        tenfold in prop_oneof![-46.0_f64..39.0, -8.0..1.0], right in any::<bool>(),
        heading in -PI..PI, along in -1000.0_f64..1000.0, aside in -0.9_f64..0.9,
        nudge in -1.0_f64..1.0,
    ) {
        // From the smallest subnormal number to the largest number.
        let size = (10.0_f64.powf(tenfold) as f32).clamp(f32::from_bits(1), f32::MAX);
        let single = if right { size } else { -size };
        let (along_off, cross_off) = located(single, heading, along, aside, nudge);
        prop_assert!(along_off.abs() < 1e-3 && cross_off.abs() < 1e-3,
            "{single}: {along_off} {cross_off}");
    }

    #[test]
    fn points_beside_an_arc_of_any_curvature_are_found_in_double_precision(
        tenfold in prop_oneof![-323.0_f64..308.25, -16.0..2.0], right in any::<bool>(),
        heading in -PI..PI, along in -1000.0_f64..1000.0, aside in -0.9_f64..0.9,
        nudge in -1.0_f64..1.0,
    ) {
        let size = 10.0_f64.powf(tenfold);
        let double = if right { size } else { -size };
        let (along_off, cross_off) = located(double, heading, along, aside, nudge);
        prop_assert!(along_off.abs() < 1e-9 && cross_off.abs() < 1e-9,
            "{double}: {along_off} {cross_off}");
    }
}

/// Two lines of 20 m that meet at a kink of `degrees`.
fn kink(degrees: f64) -> Path<f64> {
    let corner = Position::new(20_000, 0);
    let (sine, cosine) = degrees.to_radians().sin_cos();
    let far = Position::new(
        20_000 + (20_000.0 * cosine).round() as i32,
        (20_000.0 * sine).round() as i32,
    );
    Path::passes(&[(Position::new(0, 0), corner), (corner, far)], 3.0).unwrap()
}

/// The path turns by the kink and no more, and passes the corner at the distance of
/// the tangent arc, r (1 / cos(kink / 2) - 1).
#[test]
fn lines_that_meet_are_joined_by_an_arc() {
    for degrees in [0.0_f64, 0.01, 1.0, -1.0, 30.0, -30.0, 90.0, -119.0] {
        let path = kink(degrees);
        let turned: f64 = path
            .segments()
            .iter()
            .map(|segment| (segment.curvature * segment.length).abs())
            .sum();
        let known = degrees.to_radians().abs();
        assert!((turned - known).abs() < 1e-4, "{degrees}: {turned}");
        for pair in path.segments().windows(2) {
            let (end, start) = (pair[0].end(), pair[1].start);
            let gap = (end.north - start.north).hypot(end.east - start.east);
            assert!(gap < 1e-3, "{degrees}: {gap}");
            assert!((end.heading - start.heading).sin().abs() < 1e-4);
        }
        let nearest = path
            .segments()
            .iter()
            .flat_map(|segment| {
                (0..=1000).map(|step| {
                    let along = segment.length * f64::from(step) / 1000.0;
                    let at = advance(segment.start, segment.curvature, along);
                    (at.north - 20.0).hypot(at.east)
                })
            })
            .fold(f64::INFINITY, f64::min);
        let cut = 3.0 * (1.0 / (known / 2.0).cos() - 1.0);
        assert!((nearest - cut).abs() < 0.011, "{degrees}: {nearest}");
        let end = path.end();
        let far = (20.0 + 20.0 * known.cos()).hypot(20.0 * known.sin());
        assert!((end.north.hypot(end.east) - far).abs() < 2e-3, "{degrees}");
    }
}

/// A corner that is sharper, or between lines too short for the arc, is driven with a
/// turn: both lines are then driven whole.
#[test]
fn other_corners_are_driven_whole() {
    let short = [
        (Position::new(0, 0), Position::new(20_000, 0)),
        (Position::new(20_000, 0), Position::new(20_500, 500)),
    ];
    for path in [kink(125.0), Path::<f64>::passes(&short, 3.0).unwrap()] {
        let first = path.segments()[0];
        assert!((first.length - 20.0).abs() < 1e-9);
        let last = path.segments()[path.segments().len() - 1].start;
        assert!((last.north - 20.0).hypot(last.east) < 1e-9);
    }
}

/// A line between two kinks gives length to both arcs; a third kink has no room.
#[test]
fn arcs_share_a_line() {
    let corners = [(0, 0), (20_000, 0), (21_000, 0), (22_000, 0)];
    let at = |number: usize, east: i32| Position::new(corners[number].0, corners[number].1 + east);
    let turned = |path: &Path<f64>| -> f64 {
        let arcs = path.segments().iter();
        arcs.map(|arc| (arc.curvature * arc.length).abs()).sum()
    };
    let passes = [
        (at(0, 0), at(1, 0)),
        (at(1, 0), at(2, 200)),
        (at(2, 200), at(3, 0)),
    ];
    let path = Path::<f64>::passes(&passes, 2.0).unwrap();
    let kink = 0.2_f64.atan();
    assert!((turned(&path) - 3.0 * kink).abs() < 1e-4);
    // The arc of the second kink takes 0.80 m at this radius, that of the first 0.40 m.
    let path = Path::<f64>::passes(&passes, 4.0).unwrap();
    assert!(turned(&path) > 6.0);
}

#[test]
fn segments_join() {
    for apart in [-9000, 700, 2000, 8000] {
        let path = two_passes(apart);
        for pair in path.segments().windows(2) {
            let (end, start) = (pair[0].end(), pair[1].start);
            assert!((end.north - start.north).hypot(end.east - start.east) < 1e-3);
            assert!((end.heading - start.heading).sin().abs() < 1e-3);
        }
    }
}

#[test]
fn curvature_is_averaged_over_joints() {
    let path = two_passes(6000);
    // Between the passes lies a half circle of radius 3 to the right.
    let inside = path.smoothed(1, 3.0, 1.0);
    assert!((inside.curvature - 1.0 / 3.0).abs() < 1e-9 && inside.turn.abs() < 1e-9);
    let joint = path.smoothed(0, 30.0, 1.0);
    assert!((joint.curvature - 1.0 / 6.0).abs() < 1e-9);
    let back = path.smoothed(1, 0.0, 1.0);
    assert!((back.curvature - 1.0 / 6.0).abs() < 1e-9);
    // Halfway through a ramp of two metres the heading leads by k w / 8.
    assert!((back.turn - 2.0 / 3.0 / 8.0).abs() < 1e-9);
    assert!((path.curvature(0, 29.0)).abs() < 1e-9);
    assert!((path.curvature(0, 31.0) - 1.0 / 3.0).abs() < 1e-9);
}

#[test]
fn bad_paths_are_named() {
    let at = Position::new(5, 5);
    assert_eq!(Path::<f64>::passes(&[], 3.0), Err(PathError::Empty));
    assert_eq!(
        Path::<f64>::passes(&[(at, at)], 3.0),
        Err(PathError::Pass {
            number: 0,
            error: LineError::CoincidentWaypoints(at)
        })
    );
    let long: Vec<_> = (0..9)
        .map(|k| (Position::new(0, k * 9000), Position::new(50_000, k * 9000)))
        .collect();
    assert_eq!(Path::<f64>::passes(&long, 3.0), Err(PathError::Full));
    let line = Line::<f64>::new(Position::new(0, 0), Position::new(9, 0)).unwrap();
    assert_eq!(Path::line(&line).segments().len(), 1);
}
