//! Headland turns: they end at the next pass, never ask for more than the steering can do, and
//! stay inside their room.

use control::dubins::Pose;
use control::fence::{
    Fence, FenceError, Footprint, Headland, ObstacleError, Obstacles, Point, Room, Sides,
};
use control::reeds_shepp;
use control::scalar::Scalar;
use control::turn::{Kind, Part, Turn, TurnError, TurnPlan, TurnSettings};
use proptest::prelude::*;
use std::f64::consts::PI;

/// The example vehicle at 1 m/s, with a reserve of a fifth.
fn settings<T: Scalar>() -> TurnSettings<T> {
    let angle = T::lit(25.0_f64.to_radians());
    TurnSettings::for_steering(T::lit(1.1), angle, angle, T::one(), T::lit(0.2))
}

fn free<T>(_: &Pose<T>) -> bool {
    true
}

/// The next pass begins `aside` metres to the right of where the last one ends and `ahead`
/// beyond it, in the opposite direction but for `skew`.
fn next<T: Scalar>(aside: f64, ahead: f64, skew: f64) -> (Pose<T>, Pose<T>) {
    let start = Pose {
        north: T::lit(100.0),
        east: T::lit(20.0),
        heading: T::lit(0.4),
    };
    let (sine, cosine) = 0.4_f64.sin_cos();
    let end = Pose {
        north: T::lit(100.0 + ahead * cosine - aside * sine),
        east: T::lit(20.0 + ahead * sine + aside * cosine),
        heading: T::lit(0.4 - PI + skew),
    };
    (start, end)
}

/// Checks everything that a steering must be able to follow.
fn assert_drivable<T: Scalar>(turn: &Turn<T>, settings: &TurnSettings<T>) {
    let mut curvature = 0.0;
    let mut reverse = false;
    for part in turn.parts() {
        let begin = part.curvature.as_f64();
        assert!(
            (begin - curvature).abs() < 1e-5,
            "a jump of curvature: {turn:?}"
        );
        if part.reverse != reverse {
            assert!(begin.abs() < 1e-5, "wheels are not straight: {turn:?}");
            reverse = part.reverse;
        }
        curvature = part.last_curvature().as_f64();
        let (most, sharpest) = (settings.curvature.as_f64(), settings.sharpness.as_f64());
        assert!(curvature.abs() <= most * 1.002, "{turn:?}");
        assert!(
            part.sharpness.as_f64().abs() <= sharpest * 1.002,
            "{turn:?}"
        );
        assert!(part.length > T::zero());
    }
    assert!(curvature.abs() < 1e-5, "not straight at the end: {turn:?}");
    assert!(!reverse, "backwards at the end");
}

fn assert_ends<T: Scalar>(turn: &Turn<T>, start: Pose<T>, end: Pose<T>) {
    let reached = turn.end(start);
    let off = (reached.north - end.north)
        .as_f64()
        .hypot((reached.east - end.east).as_f64());
    assert!(off < 1.1e-3, "{off} m off");
    let askew = (reached.heading - end.heading).as_f64();
    assert!(
        askew.sin().abs() < 1.1e-3 && askew.cos() > 0.9,
        "{askew} rad off"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn turns_can_be_followed(
        aside in 0.3_f64..15.0, left in any::<bool>(), ahead in -8.0_f64..8.0,
        skew in -0.7_f64..0.7, reverse in any::<bool>(),
    ) {
        let aside = if left { -aside } else { aside };
        let settings = TurnSettings { reverse, ..settings::<f64>() };
        let (start, end) = next(aside, ahead, skew);
        let turn = TurnPlan::new(start, end, &settings).unwrap().run(&free).unwrap();
        assert_drivable(&turn, &settings);
        assert_ends(&turn, start, end);
        prop_assert!(reverse || turn.reversals() == 0);
        let least = reeds_shepp::shortest(start, end, 1.0 / settings.curvature).unwrap();
        prop_assert!(turn.length() >= least.length() - 1e-3);
        // Single precision finds a turn that is as long.
        let single = TurnSettings { reverse, ..self::settings::<f32>() };
        let (start, end) = next(aside, ahead, skew);
        let found = TurnPlan::new(start, end, &single).unwrap().run(&free).unwrap();
        assert_drivable(&found, &single);
        assert_ends(&found, start, end);
        prop_assert!((f64::from(found.length()) - turn.length()).abs() < 0.02);
    }

    /// More freedom makes no turn longer: with reverse, and with more depth.
    #[test]
    fn the_shortest_turn_is_found(
        aside in 1.0_f64..10.0, ahead in -4.0_f64..4.0, depth in 4.0_f64..15.0,
    ) {
        let settings = settings::<f64>();
        let (start, end) = next(aside, ahead, 0.0);
        let length = |reverse: bool, depth: f64| {
            let room = Headland { from: start, depth, back: 6.0, footprint: Footprint::default() };
            let plan = TurnPlan::new(start, end, &TurnSettings { reverse, ..settings }).unwrap();
            plan.run(&room).map_or(f64::INFINITY, |turn| turn.length())
        };
        prop_assert!(length(true, depth) <= length(false, depth));
        prop_assert!(length(true, depth + 2.0) <= length(true, depth));
        prop_assert!(length(false, depth + 2.0) <= length(false, depth));
    }

    /// Fast vehicles with slow steering: their turns are clothoids without arcs.
    #[test]
    fn slow_steering_gets_longer_clothoids(
        aside in 1.0_f64..12.0, speed in 0.3_f64..3.0, wheelbase in 0.5_f64..3.0,
    ) {
        let angle = 40.0_f64.to_radians();
        let settings =
            TurnSettings::for_steering(wheelbase, angle, 20.0_f64.to_radians(), speed, 0.25);
        let (start, end) = next(aside, 0.0, 0.0);
        let turn = TurnPlan::new(start, end, &settings).unwrap().run(&free);
        // A clothoid that turns by more than a full circle is not tried.
        prop_assume!(settings.curvature.powi(2) / settings.sharpness < 2.5);
        let turn = turn.unwrap();
        assert_drivable(&turn, &settings);
        assert_ends(&turn, start, end);
    }

    /// Every pose on the turn is inside the headland.
    #[test]
    fn the_depth_is_kept(aside in 1.0_f64..8.0, depth in 3.0_f64..10.0, ahead in -3.0_f64..0.0) {
        let settings = settings::<f64>();
        let (start, end) = next(aside, ahead, 0.0);
        let footprint = Footprint { half_width: 0.5, ahead: 1.2, behind: 0.2 };
        let room = Headland { from: start, depth, back: 30.0, footprint };
        let Ok(turn) = TurnPlan::new(start, end, &settings).unwrap().run(&room) else {
            return Ok(());
        };
        let mut at = start;
        for part in turn.parts() {
            for step in 0..=50 {
                let pose = part.pose(at, part.length * f64::from(step) / 50.0);
                let front = 0.4_f64.cos() * (pose.north + 1.2 * pose.heading.cos() - start.north)
                    + 0.4_f64.sin() * (pose.east + 1.2 * pose.heading.sin() - start.east);
                // Between two poses that are compared the vehicle can get a little deeper.
                prop_assert!(front + 0.5 <= depth + 0.02, "{front}");
            }
            at = part.end(at);
        }
    }
}

/// A bicycle whose steering moves at the rates that the turn asks for arrives at the next
/// pass, and the rates are within the limit and its reserve.
#[test]
fn the_steering_rate_is_enough() {
    let settings = settings::<f64>();
    let (wheelbase, limit) = (1.1, 25.0_f64.to_radians());
    for aside in [1.5, 3.0, 5.0, 9.0] {
        let (start, end) = next(aside, 0.0, 0.0);
        let turn = TurnPlan::new(start, end, &settings)
            .unwrap()
            .run(&free)
            .unwrap();
        let mut pose = start;
        let mut fastest = 0.0_f64;
        let mut last = 0.0_f64;
        let step = 1e-4;
        for part in turn.parts() {
            let count = (part.length / step).round() as usize;
            let way = part.length / count as f64;
            for number in 0..count {
                let at = (number as f64 + 0.5) * way;
                let wheels = (wheelbase * (part.curvature + part.sharpness * at)).atan();
                // At 1 m/s a way of one metre takes one second.
                fastest = fastest.max((wheels - last).abs() / way);
                last = wheels;
                let drive = if part.reverse { -way } else { way };
                let turned = drive * wheels.tan() / wheelbase;
                let middle = pose.heading + turned / 2.0;
                pose.north += drive * middle.cos();
                pose.east += drive * middle.sin();
                pose.heading += turned;
            }
        }
        let off = (pose.north - end.north).hypot(pose.east - end.east);
        assert!(off < 2e-3, "{aside} m aside: {off} m off");
        assert!(fastest <= 0.8 * limit * 1.001, "{fastest} rad/s");
    }
}

fn kind(aside: f64, reverse: bool, depth: f64) -> Result<(Kind, usize, f64), TurnError> {
    let settings = TurnSettings {
        reverse,
        ..settings::<f64>()
    };
    let (start, end) = next(aside, 0.0, 0.0);
    let room = Headland {
        from: start,
        depth,
        back: 1.0,
        footprint: Footprint::default(),
    };
    let turn = TurnPlan::new(start, end, &settings)?.run(&room)?;
    Ok((turn.kind(), turn.reversals(), turn.length()))
}

/// The room decides which turn is driven.
#[test]
fn wide_omega_and_three_point() {
    assert_eq!(kind(9.0, true, 50.0).unwrap().0, Kind::Wide);
    assert_eq!(kind(3.0, false, 50.0).unwrap().0, Kind::Omega);
    let (three_point, reversals, length) = kind(3.0, true, 50.0).unwrap();
    assert_eq!((three_point, reversals), (Kind::ThreePoint, 2));
    let (_, _, omega) = kind(3.0, false, 50.0).unwrap();
    assert!(length < omega, "{length} and {omega}");
    // Without reverse an omega needs more depth than there is.
    assert_eq!(kind(3.0, false, 5.0), Err(TurnError::NoRoom));
    assert_eq!(kind(3.0, true, 5.0).unwrap().0, Kind::ThreePoint);
    assert_eq!(kind(3.0, true, 2.0), Err(TurnError::NoRoom));
}

/// A stop can be so dear that an omega is driven.
#[test]
fn stops_have_a_price() {
    let (start, end) = next(3.0, 0.0, 0.0);
    let dear = TurnSettings {
        stop_cost: 20.0,
        ..settings::<f64>()
    };
    let turn = TurnPlan::new(start, end, &dear)
        .unwrap()
        .run(&free)
        .unwrap();
    assert_eq!(turn.kind(), Kind::Omega);
}

#[test]
fn a_turn_begins_and_ends_straight() {
    let (start, end) = next(4.0, 0.0, 0.0);
    let settings = TurnSettings {
        lead_in: 1.5,
        lead_out: 2.5,
        ..settings::<f64>()
    };
    let turn = TurnPlan::new(start, end, &settings)
        .unwrap()
        .run(&free)
        .unwrap();
    let straight = |length: f64| Part {
        length,
        ..Part::default()
    };
    assert_eq!(turn.parts().first(), Some(&straight(1.5)));
    assert_eq!(turn.parts().last(), Some(&straight(2.5)));
    assert_ends(&turn, start, end);
}

/// A step is short, and their number is bounded.
#[test]
fn steps_are_bounded() {
    let settings = settings::<f64>();
    let mut most = 0;
    for aside in [0.5, 3.0, 7.0, 12.0] {
        let (start, end) = next(aside, 0.0, 0.0);
        let mut plan = TurnPlan::new(start, end, &settings).unwrap();
        let looks = std::cell::Cell::new(0);
        let room = |_: &Pose<f64>| {
            looks.set(looks.get() + 1);
            true
        };
        let mut steps = 0;
        loop {
            looks.set(0);
            let done = plan.step(&room);
            steps += 1;
            assert!(looks.get() <= 8, "{} poses in a step", looks.get());
            if done.is_some() {
                break;
            }
        }
        most = most.max(steps);
    }
    println!("at most {most} steps");
    assert!(most < 200, "{most}");
}

#[test]
fn bad_input_is_named() {
    let settings = settings::<f64>();
    let pose = Pose::<f64>::default();
    let lost = Pose {
        heading: f64::NAN,
        ..pose
    };
    assert_eq!(
        TurnPlan::new(pose, lost, &settings).unwrap_err(),
        TurnError::Pose
    );
    for wrong in [
        TurnSettings {
            curvature: 0.0,
            ..settings
        },
        TurnSettings {
            sharpness: f64::INFINITY,
            ..settings
        },
        TurnSettings {
            lead_out: -1.0,
            ..settings
        },
        TurnSettings {
            spacing: 0.0,
            ..settings
        },
    ] {
        assert_eq!(
            TurnPlan::new(pose, pose, &wrong).unwrap_err(),
            TurnError::Settings
        );
    }
}

const SQUARE: [Point<f64>; 4] = [
    Point {
        north: 0.0,
        east: 0.0,
    },
    Point {
        north: 10.0,
        east: 0.0,
    },
    Point {
        north: 10.0,
        east: 10.0,
    },
    Point {
        north: 0.0,
        east: 10.0,
    },
];

#[test]
fn fences_keep_the_whole_vehicle_in() {
    let footprint = Footprint {
        half_width: 1.0,
        ahead: 2.0,
        behind: 0.5,
    };
    let fence = Fence::new(&SQUARE, footprint).unwrap();
    let at = |north: f64, east: f64, degrees: f64| {
        fence.allows(&Pose {
            north,
            east,
            heading: degrees.to_radians(),
        })
    };
    assert!(at(5.0, 5.0, 0.0));
    assert!(at(6.9, 5.0, 0.0) && !at(7.1, 5.0, 0.0), "the front");
    assert!(at(8.9, 5.0, 90.0) && !at(9.1, 5.0, 90.0), "the side");
    assert!(at(1.6, 5.0, 0.0) && !at(1.4, 5.0, 0.0), "the rear");
    assert!(!at(20.0, 5.0, 0.0) && !at(-5.0, -5.0, 0.0), "outside");
    // The front of a long vehicle is outside on the far side of a narrow gap.
    let notched = [
        SQUARE[0],
        SQUARE[1],
        Point {
            north: 10.0,
            east: 4.99,
        },
        Point {
            north: 3.0,
            east: 5.0,
        },
        Point {
            north: 10.0,
            east: 5.01,
        },
        SQUARE[2],
        SQUARE[3],
    ];
    let narrow = Footprint {
        half_width: 0.0,
        ahead: 2.0,
        behind: 0.0,
    };
    let fence = Fence::new(&notched, narrow).unwrap();
    let across = |north: f64| {
        fence.allows(&Pose {
            north,
            east: 4.0,
            heading: PI / 2.0,
        })
    };
    assert!(across(2.0) && !across(5.0));
    assert_eq!(
        Fence::new(&SQUARE[..2], footprint),
        Err(FenceError::Corners(2))
    );
    let lost = [
        SQUARE[0],
        SQUARE[1],
        Point {
            north: f64::NAN,
            east: 0.0,
        },
    ];
    assert_eq!(Fence::new(&lost, footprint), Err(FenceError::Corner(2)));
    // The squares of such coordinates are infinite in single precision, and no edge would be near.
    let far = [(-1e19, 0.5), (1e19, 0.5), (0.0, 9.0)].map(|(north, east)| Point { north, east });
    let ground = Footprint::<f32>::default();
    assert_eq!(Fence::new(&far, ground), Err(FenceError::Corner(0)));
    let closed = [far[2], far[1], far[0], far[2]];
    assert_eq!(
        Obstacles::new(&closed, ground),
        Err(ObstacleError::Corner(1))
    );
}

/// Each ring with its first corner again at its end.
fn rings<const N: usize>(rings: [&[Point<f64>]; N]) -> Vec<Point<f64>> {
    let closed = rings
        .into_iter()
        .flat_map(|ring| ring.iter().chain(ring.first()));
    closed.copied().collect()
}

#[test]
fn obstacles_keep_the_whole_vehicle_out() {
    let footprint = Footprint {
        half_width: 1.0,
        ahead: 2.0,
        behind: 0.5,
    };
    let moved = SQUARE.map(|corner| Point {
        east: corner.east + 13.0,
        ..corner
    });
    let corners = rings([&SQUARE, &moved]);
    let obstacles = Obstacles::new(corners.as_slice(), footprint).unwrap();
    let at = |north: f64, east: f64, degrees: f64| {
        obstacles.allows(&Pose {
            north,
            east,
            heading: degrees.to_radians(),
        })
    };
    assert!(!at(5.0, 5.0, 0.0) && !at(5.0, 18.0, 0.0), "inside");
    assert!(at(-3.1, 5.0, 0.0) && !at(-2.9, 5.0, 0.0), "the front");
    assert!(at(5.0, -1.1, 0.0) && !at(5.0, -0.9, 0.0), "the side");
    assert!(at(11.6, 5.0, 0.0) && !at(11.4, 5.0, 0.0), "the rear");
    assert!(at(5.0, 11.5, 0.0), "between two of them");
    assert!(!at(5.0, 11.5, 90.0), "across the gap between them");
    assert!(
        Obstacles::new(&[], footprint)
            .unwrap()
            .allows(&Pose::default())
    );
    // A pole below the vehicle.
    let pole = SQUARE.map(|corner| Point {
        north: 0.5 + 1e-3 * corner.north,
        east: 1e-3 * corner.east,
    });
    let pole = rings([&pole]);
    let obstacles = Obstacles::new(pole.as_slice(), footprint).unwrap();
    assert!(!obstacles.allows(&Pose::default()));
}

#[test]
fn ground_reaches_about_a_point_of_the_vehicle() {
    let footprint = Footprint {
        half_width: 1.0,
        ahead: 2.0,
        behind: 0.5,
    };
    let cases = [
        ((0.3, 0.0), 1.0),
        ((2.0, -0.4), 0.6),
        ((-1.1, 0.0), 0.4),
        ((2.3, 0.4), 0.5),
        ((3.1, 0.0), 0.0),
        ((0.0, 1.5), 0.0),
    ];
    for ((ahead, right), reach) in cases {
        let found: f64 = footprint.reach_about(ahead, right);
        assert!((found - reach).abs() < 1e-12, "{ahead} {right}: {found}");
    }
}

#[test]
fn obstacles_are_polygons() {
    let found = |corners: &[Point<f64>]| Obstacles::new(corners, Footprint::default()).err();
    assert_eq!(found(&rings([&SQUARE, &SQUARE[1..]])), None);
    assert_eq!(found(&SQUARE), Some(ObstacleError::Open));
    assert_eq!(
        found(&rings([&SQUARE, &SQUARE[2..]])),
        Some(ObstacleError::Open)
    );
    assert_eq!(found(&[SQUARE[0]; 65]), Some(ObstacleError::Corners(65)));
    let mut lost = rings([&SQUARE]);
    lost[2].east = f64::INFINITY;
    assert_eq!(found(&lost), Some(ObstacleError::Corner(2)));
}

proptest! {
    /// Where a fence lets a vehicle be, an obstacle of the same corners does not.
    #[test]
    fn an_obstacle_is_the_outside_of_a_fence(
        north in -5.0_f64..15.0, east in -5.0_f64..15.0, heading in -3.2_f64..3.2
    ) {
        let footprint = Footprint { half_width: 0.4, ahead: 1.0, behind: 0.3 };
        let pose = Pose { north, east, heading };
        let fence = Fence::new(&SQUARE, footprint).unwrap().allows(&pose);
        let corners = rings([&SQUARE]);
        let obstacle = Obstacles::new(corners.as_slice(), footprint).unwrap().allows(&pose);
        prop_assert!(!(fence && obstacle));
        let far = |value: f64| !(-2.0..12.0).contains(&value);
        prop_assert!(obstacle || !(far(north) || far(east)));
    }

    /// Against the place at which two lines meet, in whole numbers.
    #[test]
    fn sides_that_meet_are_found(places in prop::collection::vec((-3_i32..4, -3_i32..4), 3..8)) {
        let count = places.len();
        let side = |number: usize| [places[number], places[(number + 1) % count]];
        let met = |one: usize, other: usize| {
            let ([(an, ae), (bn, be)], [(cn, ce), (dn, de)]) = (side(one), side(other));
            let ((n, e), (on, oe)) = ((bn - an, be - ae), (dn - cn, de - ce));
            let whole = n * oe - e * on;
            let neighbours = other == one + 1 || one == 0 && other + 1 == count;
            if whole != 0 {
                let along = [(cn - an) * oe - (ce - ae) * on, (cn - an) * e - (ce - ae) * n];
                let within = along.iter().all(|part| (0..=whole.abs()).contains(&(part * whole.signum())));
                return within && !neighbours;
            }
            if neighbours {
                return n * on + e * oe < 0;
            }
            // Parallel, or points.
            let on_line = |(n, e): (i32, i32)| (n - an) * (be - ae) == (e - ae) * (bn - an)
                && (n - cn) * (de - ce) == (e - ce) * (dn - cn);
            let between = |(n, e): (i32, i32), [(an, ae), (bn, be)]: [(i32, i32); 2]| {
                (an.min(bn)..=an.max(bn)).contains(&n) && (ae.min(be)..=ae.max(be)).contains(&e)
            };
            [(an, ae), (bn, be), (cn, ce), (dn, de)]
                .into_iter()
                .any(|at| on_line(at) && between(at, side(one)) && between(at, side(other)))
        };
        let first = (0..count).find(|&one| (one + 1..count).any(|other| met(one, other)));
        let corners: Vec<Point<f32>> = places
            .iter()
            .map(|&(north, east)| Point { north: north as f32, east: east as f32 })
            .collect();
        let mut sides = Sides::of_fence(count);
        let found = std::iter::repeat_with(|| sides.step(corners.as_slice())).find_map(|told| told);
        prop_assert_eq!(found, Some(first.map_or(Ok(()), Err)));
    }

    /// Inside a convex fence by the distances from its edges.
    #[test]
    fn a_square_is_judged_by_its_edges(north in -2.0_f64..12.0, east in -2.0_f64..12.0) {
        let footprint = Footprint { half_width: 1.0, ..Footprint::default() };
        let fence = Fence::new(&SQUARE, footprint).unwrap();
        let pose = Pose { north, east, heading: 0.0 };
        let room = north.min(east).min(10.0 - north).min(10.0 - east);
        prop_assume!((room - 1.0).abs() > 1e-9);
        prop_assert_eq!(fence.allows(&pose), room > 1.0);
    }
}

/// Steps of a plan until it ends, at most `most`.
fn steps(mut plan: TurnPlan<f32>, most: u32) -> (u32, Option<Result<Turn<f32>, TurnError>>) {
    for step in 1..=most {
        if let Some(result) = plan.step(&free::<f32>) {
            return (step, Some(result));
        }
    }
    (most, None)
}

/// Where the spacing is less than the rounding error of the distance, that would not grow: the plan has its documented
/// number of steps all the same, up to the longest turn and with the finest spacing.
#[test]
fn a_plan_ends_after_its_number_of_steps() {
    let start = Pose::default();
    let to = |north: f32| Pose {
        north,
        east: 30.0,
        heading: 0.0,
    };
    for (north, spacing) in [(30.0_f32, 0.01_f32), (3_000.0, 0.25), (40_000.0, 0.01)] {
        let settings = TurnSettings {
            spacing,
            ..settings()
        };
        let plan = TurnPlan::new(start, to(north), &settings).unwrap();
        // Each word could be compared from its beginning to its end.
        let poses = 16.0 * (1.5 * north + 100.0) / spacing;
        let (_, result) = steps(plan, 17 + 16 * 11 + (poses / 8.0) as u32);
        let result = result.expect("it ends");
        // In single precision, far away the end is not met within a millimetre.
        if north < 1_000.0 {
            assert_ends(&result.unwrap(), start, to(north));
        }
    }
    for far in [60_000.0, 1e7, 1e30] {
        let plan = TurnPlan::new(start, to(far), &settings()).unwrap();
        assert_eq!(steps(plan, 17), (17, Some(Err(TurnError::NoRoom))), "{far}");
    }
    for spacing in [0.0, 1e-42, 1e-9, 0.0099] {
        let settings = TurnSettings {
            spacing,
            ..settings()
        };
        let refused = TurnPlan::new(start, to(30.0), &settings).err();
        assert_eq!(refused, Some(TurnError::Settings), "{spacing}");
    }
    let spun = Pose {
        heading: f32::MAX,
        ..start
    };
    let refused = TurnPlan::new(start, spun, &settings()).err();
    assert_eq!(refused, Some(TurnError::Pose));
}
