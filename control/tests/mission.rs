//! Missions: what is refused, and what the planner makes of them.

mod common;

use common::field::{Field, mission_settings};
use control::dubins::Pose;
use control::fence::{FenceError, ObstacleError, Point, Room as _};
use control::mission::{
    End, Fault, Join, Leg, Legs, Mission, MissionSettings, Outputs, PIECES, Pace, Piece, Planner,
    Purpose, Section, Step, Stretch, Violation, Yard, check,
};
use control::path::{Progress, Segment};
use control::position::Position;
use control::route::Route;
use control::turn::TurnError;
use proptest::prelude::*;

const FIELD: Field = Field {
    length: 40.0,
    spacing: 3.0,
    passes: 6,
    headland: 9.0,
    speed: 1.0,
};

fn settings() -> MissionSettings<f64> {
    mission_settings(&common::example::settings::<f64>(), 1.0)
}

fn mission<'a>(legs: &'a [Leg<f64>], fence: &'a [Point<f64>]) -> Legs<'a, f64> {
    Legs {
        origin: Position::new(0, 0),
        legs,
        fence,
        obstacles: &[],
        end: End::Stop,
    }
}

#[test]
fn a_field_is_sound() {
    let (legs, fence) = (FIELD.legs(), FIELD.fence());
    let summary = check(&mission(&legs, &fence), &settings()).unwrap();
    assert_eq!((summary.legs, summary.turns), (6, 5));
    assert!(summary.length > 6.0 * 40.0 + 5.0 * 3.0, "{summary:?}");
    assert!(summary.time >= summary.length, "{summary:?}");
    let single = mission_settings(&common::example::settings::<f32>(), 1.0);
    let (legs, fence) = (FIELD.legs::<f32>(), FIELD.fence::<f32>());
    let plan = Legs {
        origin: Position::new(0, 0),
        legs: &legs,
        fence: &fence,
        obstacles: &[],
        end: End::Repeat,
    };
    let repeated = check(&plan, &single).unwrap();
    assert_eq!(repeated.turns, 6);
}

/// A record has the vehicle's top speed in single precision: a last digit too much.
#[test]
fn the_top_speed_may_be_rounded() {
    let fence = FIELD.fence();
    let checked = |factor: f64| {
        let mut legs = FIELD.legs();
        for leg in &mut legs {
            leg.speed = settings().top_speed * factor;
        }
        check(&mission(&legs, &fence), &settings())
    };
    assert!(checked(1.0 + 1e-7).is_ok());
    let faulty = Violation::Leg {
        number: 0,
        fault: Fault::Speed,
    };
    assert_eq!(checked(1.001), Err(faulty));
}

/// The planner turns round an obstacle if it can, and the check refuses a leg or a turn that would touch one.
#[test]
fn obstacles_are_kept_clear_of() {
    let (legs, fence) = (FIELD.legs(), FIELD.fence());
    let around = |north: f64, east: f64| {
        let corner = |n: f64, e: f64| Point {
            north: north + n,
            east: east + e,
        };
        [
            corner(0.0, 0.0),
            corner(0.5, 0.0),
            corner(0.5, 0.5),
            corner(0.0, 0.0),
        ]
    };
    let found = |obstacle: &[Point<f64>]| {
        let plan = Legs {
            obstacles: obstacle,
            ..mission(&legs, &fence)
        };
        check(&plan, &settings())
    };
    let on = |number: usize| {
        let leg = &legs[number];
        let middle = leg.part().pose(leg.start, 0.5 * leg.length);
        around(middle.north, middle.east)
    };
    let fault = Fault::Obstacle;
    for number in [0, 3] {
        let expected = Err(Violation::Leg { number, fault });
        assert_eq!(found(&on(number)), expected);
    }
    // Right ahead of the end of the second leg.
    let end = legs[1].end();
    let ahead = 1.7 * end.heading.cos();
    let blocked = found(&around(end.north + ahead, end.east));
    assert!(blocked.is_err(), "{blocked:?}");
    let beside = found(&around(-100.0, 0.0)).unwrap();
    assert_eq!(beside.turns, 5);
    let open = found(&on(0)[..3]);
    assert!(matches!(open, Err(Violation::Obstacles(_))), "{open:?}");
}

/// Paths keep a distance from the fence, so that a vehicle beside its path does not touch it.
#[test]
fn a_path_keeps_the_clearance() {
    let (legs, fence) = (FIELD.legs(), FIELD.fence());
    let judged = |clearance: f64| {
        let settings = MissionSettings {
            clearance,
            ..settings()
        };
        check(&mission(&legs, &fence), &settings)
    };
    let (free, beside) = (judged(0.0).unwrap(), judged(0.1).unwrap());
    assert_eq!((free.turns, beside.turns), (5, 5));
    // The outer legs lie 9 m inside the fence.
    let half_width = settings().footprint.half_width;
    let outside = Violation::Leg {
        number: 0,
        fault: Fault::Outside,
    };
    assert_eq!(judged(9.01 - half_width), Err(outside));
    assert_eq!(judged(-0.1), Err(Violation::Settings));
}

proptest! {
    /// A straight leg is judged as a whole. It is the same as at every centimetre of it.
    #[test]
    fn a_straight_leg_is_free_if_all_of_it_is(
        start in (-20.0_f64..20.0, -20.0_f64..20.0, -3.2_f64..3.2), length in 0.2_f64..40.0, reverse: bool,
        corners in prop::collection::vec(5.0_f64..60.0, 4..9),
        obstacle in (-30.0_f64..30.0, -30.0_f64..30.0, 0.05_f64..4.0)
    ) {
        let step = std::f64::consts::TAU / corners.len() as f64;
        let fence: Vec<Point<f64>> = (0..)
            .zip(&corners)
            .map(|(index, far)| {
                let (east, north) = (step * f64::from(index)).sin_cos();
                Point { north: far * north, east: far * east }
            })
            .collect();
        let (north, east, size) = obstacle;
        let corner = |n: f64, e: f64| Point { north: north + n * size, east: east + e * size };
        let obstacle = [corner(0.0, 0.0), corner(1.0, 0.3), corner(0.2, 1.0), corner(0.0, 0.0)];
        let leg = Leg {
            start: Pose { north: start.0, east: start.1, heading: start.2 },
            length,
            speed: 1.0,
            reverse,
            ..Leg::default()
        };
        let legs = [leg];
        let plan = Legs { obstacles: &obstacle, ..mission(&legs, &fence) };
        let judged = check(&plan, &settings()).is_ok();
        let everywhere = |clearance: f64| {
            let wider = MissionSettings { clearance, ..settings() };
            let yard = Yard::of(&plan, &wider);
            let steps = (length / 0.01) as usize;
            (0..=steps).all(|at| yard.allows(&leg.part().pose(leg.start, 0.01 * at as f64)))
                && yard.allows(&leg.end())
        };
        prop_assert!(!judged || everywhere(-1e-6));
        prop_assert!(judged || !everywhere(0.01));
    }
}

/// One fault in a leg is found, with its number.
#[test]
fn faults_are_named() {
    type Change = fn(&mut Leg<f64>);
    let faults: [(Change, usize, Fault); 17] = [
        (|leg| leg.start.north = f64::NAN, 3, Fault::NotFinite),
        (|leg| leg.speed = f64::INFINITY, 3, Fault::NotFinite),
        (|leg| leg.start.east = 5000.0, 3, Fault::TooFar),
        (|leg| leg.start.heading = 1000.0, 3, Fault::TooFar),
        (|leg| leg.length = 0.0, 3, Fault::Length),
        (|leg| leg.length = 2500.0, 3, Fault::Length),
        (|leg| leg.speed = 0.0, 3, Fault::Speed),
        (|leg| leg.speed = 2.5, 3, Fault::Speed),
        // The vehicle would stand.
        (|leg| leg.speed = 0.000_6, 3, Fault::Speed),
        // The receiver tells no heading of a vehicle that slips.
        (|leg| leg.speed = 0.28, 3, Fault::Speed),
        // Too sharp for 0.28 m/s.
        (
            |leg| (leg.curvature, leg.sharpness, leg.length) = (-0.16, 1.14, 0.28),
            3,
            Fault::Sharpness,
        ),
        // Where such a spiral ends is not known.
        (
            |leg| (leg.curvature, leg.sharpness, leg.length) = (0.3, -0.000_497, 564.0),
            3,
            Fault::Length,
        ),
        (|leg| leg.curvature = 0.4, 3, Fault::Curvature),
        (|leg| leg.sharpness = -0.01, 3, Fault::Curvature),
        (|leg| leg.length = 49.0, 3, Fault::Outside),
        (|leg| leg.join = Join::Continue, 3, Fault::JoinPosition),
        (|leg| leg.start.north += 60.0, 3, Fault::Outside),
    ];
    let fence = FIELD.fence();
    for (change, number, fault) in faults {
        let mut legs = FIELD.legs();
        change(&mut legs[number]);
        let found = check(&mission(&legs, &fence), &settings());
        // The joint with the leg before it may be impossible, too, and comes first.
        let Err(Violation::Leg {
            number: at,
            fault: first,
        }) = found
        else {
            panic!("{fault}: {found:?}");
        };
        let joint = matches!(first, Fault::Turn(_) | Fault::JoinCurvature);
        assert!(
            (at, first) == (number, fault) || (at + 1 == number && joint),
            "{found:?}"
        );
        // Alone it is named.
        let alone = [legs[number]];
        let found = check(&mission(&alone, &fence), &settings());
        if !matches!(fault, Fault::JoinPosition) {
            assert_eq!(found, Err(Violation::Leg { number: 0, fault }));
        }
    }
    let steep = Leg {
        curvature: 0.0,
        sharpness: 5.0,
        length: 0.06,
        ..FIELD.legs()[0]
    };
    assert_eq!(
        check(&mission(&[steep], &[]), &settings()),
        Err(Violation::Leg {
            number: 0,
            fault: Fault::Sharpness
        })
    );
}

#[test]
fn joints_are_judged() {
    let straight = Leg {
        length: 10.0,
        speed: 1.0,
        ..Leg::default()
    };
    let next = Leg {
        start: straight.end(),
        ..straight
    };
    let joint = |next: Leg<f64>, join: Join| {
        let legs = [Leg { join, ..straight }, next];
        match check(&mission(&legs, &[]), &settings()) {
            Ok(_) => None,
            Err(Violation::Leg { number: 0, fault }) => Some(fault),
            Err(other) => panic!("{other}"),
        }
    };
    assert_eq!(joint(next, Join::Continue), None);
    let moved = |north: f64, heading: f64| Leg {
        start: Pose {
            north: next.start.north + north,
            heading,
            ..next.start
        },
        ..next
    };
    assert_eq!(joint(moved(0.009, 0.0), Join::Continue), None);
    assert_eq!(
        joint(moved(0.011, 0.0), Join::Continue),
        Some(Fault::JoinPosition)
    );
    assert_eq!(
        joint(moved(0.0, 0.011), Join::Continue),
        Some(Fault::JoinHeading)
    );
    let bent = Leg {
        curvature: 0.02,
        ..next
    };
    assert_eq!(joint(bent, Join::Continue), Some(Fault::JoinCurvature));
    assert_eq!(joint(bent, Join::Turn), Some(Fault::JoinCurvature));
    // Backwards on the same ground.
    let back = Leg {
        reverse: true,
        ..next
    };
    assert_eq!(joint(back, Join::Continue), None);
}

#[test]
fn missions_without_sense_are_refused() {
    let sound = settings();
    assert_eq!(check(&mission(&[], &[]), &sound), Err(Violation::Count(0)));
    let legs = FIELD.legs();
    let many: Vec<_> = legs.iter().copied().cycle().take(4097).collect();
    assert_eq!(
        check(&mission(&many, &[]), &sound),
        Err(Violation::Count(4097))
    );
    let fence = [Point::default(); 2];
    assert_eq!(
        check(&mission(&legs, &fence), &sound),
        Err(Violation::Fence(FenceError::Corners(2)))
    );
    let fast = MissionSettings {
        turn_speed: 9.0,
        ..sound
    };
    assert_eq!(check(&mission(&legs, &[]), &fast), Err(Violation::Settings));
    let narrow = Field {
        headland: 2.5,
        ..FIELD
    };
    let fence = narrow.fence();
    let found = check(&mission(&legs, &fence), &sound).unwrap_err();
    assert_eq!(
        found.to_string(),
        "leg 0: no turn to the next leg: there is no room for a turn"
    );
}

/// A polygon by north and east of its corners, m.
type Shape = &'static [(f64, f64)];

/// Polygons whose first side meets another one.
const CROSSED: [Shape; 6] = [
    // A bow tie and a star.
    &[(-20., -20.), (20., 20.), (20., -20.), (-20., 20.)],
    &[(30., 0.), (-24., 18.), (9., -28.), (9., 28.), (-24., -18.)],
    // Twice the same corner, where the edge crosses itself.
    &[
        (-20., -20.),
        (0., 9.),
        (20., 20.),
        (20., -20.),
        (0., 9.),
        (-20., 20.),
    ],
    // A corner on a side, and an end of a side on another one.
    &[
        (-20., -20.),
        (20., -20.),
        (20., 20.),
        (0., -20.),
        (-20., 20.),
    ],
    &[
        (-20., -20.),
        (20., -20.),
        (20., 20.),
        (20., -30.),
        (-30., -30.),
    ],
    // There and back again on the last side.
    &[
        (-20., -20.),
        (20., -20.),
        (20., 20.),
        (-20., 20.),
        (-20., -40.),
    ],
];

const SIMPLE: [Shape; 3] = [
    &[(-20., -20.), (20., -20.), (20., 20.), (-20., 20.)],
    // A notch, and sides that continue each other.
    &[
        (-20., -20.),
        (-10., -20.),
        (20., -20.),
        (20., 20.),
        (9., 20.),
        (9., 3.),
        (8., 3.),
        (8., 20.),
        (-20., 20.),
        (-20., 10.),
        (-20., 0.),
    ],
    // Corners nearly in line on a slanted side.
    &[
        (-30., -30.1),
        (-9.7, -10.3),
        (10.1, 9.013),
        (31., 29.4),
        (60., -30.),
    ],
];

/// Sides of a polygon that meet leave no clear inside.
#[test]
fn fences_and_obstacles_that_cross_themselves_are_refused() {
    let legs = [Leg {
        start: Pose {
            north: 13.0,
            ..Pose::default()
        },
        length: 2.0,
        speed: 1.0,
        ..Leg::default()
    }];
    let corners = |places: &[(f64, f64)]| -> Vec<Point<f64>> {
        let point = |&(north, east)| Point { north, east };
        places.iter().map(point).collect()
    };
    let crossed = CROSSED.map(|shape| (shape, Some(0)));
    let simple = SIMPLE.map(|shape| (shape, None));
    for (shape, side) in crossed.into_iter().chain(simple) {
        let fence = corners(shape);
        let expected = side.map(|side| Violation::Fence(FenceError::Crossing(side)));
        let found = check(&mission(&legs, &fence), &settings()).err();
        assert_eq!(found, expected, "{fence:?}");
        // The same as an obstacle, far from the leg, behind another one.
        let mut obstacles = corners(&[(70.0, 0.0), (71.0, 0.0), (71.0, 1.0), (70.0, 0.0)]);
        let moved = fence.iter().chain(fence.first());
        obstacles.extend(moved.map(|corner| Point {
            north: corner.north + 200.0,
            ..*corner
        }));
        let plan = Legs {
            obstacles: &obstacles,
            ..mission(&legs, &[])
        };
        let expected = side.map(|side| Violation::Obstacles(ObstacleError::Crossing(4 + side)));
        assert_eq!(check(&plan, &settings()).err(), expected, "{fence:?}");
    }
}

/// The frame is the plane tangent to the earth at the base station.
#[test]
fn an_origin_far_from_the_base_station_is_refused() {
    let legs = FIELD.legs();
    let found = |north: i32, east: i32| {
        let plan = Legs {
            origin: Position::new(north, east),
            ..mission(&legs, &[])
        };
        check(&plan, &settings()).err()
    };
    for far in [10_000_001, 2_000_000_000, i32::MAX, i32::MIN] {
        assert_eq!(found(far, 0), Some(Violation::Origin));
        assert_eq!(found(0, far), Some(Violation::Origin));
        assert_eq!(found(-9, -far.saturating_abs()), Some(Violation::Origin));
    }
    assert_eq!(found(10_000_000, -10_000_000), None);
}

/// Follows the path of a mission exactly, for `metres`. Returns the numbers of the legs and how
/// often a turn was begun.
fn follow(plan: &Legs<f64>, metres: f64) -> (Vec<usize>, usize, bool) {
    let settings = settings();
    let mut planner = Planner::new(settings);
    let mut stretch = Stretch::new(plan.origin(), settings.pace);
    let mut progress = Progress::<f64>::start();
    let (mut legs, mut turns) = (Vec::new(), 0);
    let mut before = (Purpose::Leg, usize::MAX);
    let mut last: Option<(f64, f64)> = None;
    let step = 0.05;
    let mut driven = 0.0;
    while driven < metres {
        // As many steps as a task of low priority has between two control steps.
        for _ in 0..20 {
            planner.feed(plan, &mut stretch, progress.segment);
        }
        assert!(stretch.numbers().len() <= PIECES);
        let (number, along) = (progress.segment, progress.along + step);
        let piece = *stretch.piece(number).expect("the path goes on");
        // Where the direction changes, the vehicle stops at the end.
        let beyond = stretch
            .piece(number + 1)
            .filter(|next| along > piece.segment.length && next.reverse == piece.reverse);
        let on = match beyond {
            Some(next) => next.segment.pose(along - piece.segment.length),
            None => piece.segment.pose(along.min(piece.segment.length)),
        };
        if let Some((north, east)) = last {
            let jump = (on.north - north).hypot(on.east - east);
            assert!(jump < step * 1.5, "a jump of {jump} m in piece {number}");
        }
        last = Some((on.north, on.east));
        let place = stretch.advance(&mut progress, on.north, on.east);
        assert!(place.cross_track.abs() < 2e-3, "{place:?}");
        let there = stretch.whereabouts(&progress).unwrap();
        if (there.purpose, there.leg) != before {
            match there.purpose {
                Purpose::Leg => legs.push(there.leg),
                Purpose::Turn | Purpose::Approach => turns += 1,
            }
            before = (there.purpose, there.leg);
        }
        if progress.finished {
            return (legs, turns, true);
        }
        driven += step;
    }
    (legs, turns, false)
}

#[test]
fn a_mission_is_driven_to_its_end() {
    let legs = FIELD.legs();
    let (driven, turns, finished) = follow(&mission(&legs, &FIELD.fence()), 1000.0);
    assert_eq!(driven, [0, 1, 2, 3, 4, 5]);
    assert_eq!(turns, 5);
    assert!(finished);
}

#[test]
fn a_mission_is_repeated() {
    let field = Field { passes: 2, ..FIELD };
    let (legs, fence) = (field.legs(), field.fence());
    let plan = Legs {
        end: End::Repeat,
        ..mission(&legs, &fence)
    };
    let (driven, turns, finished) = follow(&plan, 400.0);
    assert!(driven.len() >= 6 && !finished, "{driven:?}");
    for (number, leg) in driven.iter().enumerate() {
        assert_eq!(*leg, number % 2);
    }
    assert!(turns >= driven.len() - 1);
}

/// Legs that continue each other: an arc in clothoids.
#[test]
fn continued_legs_need_no_turn() {
    let mut legs: Vec<Leg<f64>> = Vec::new();
    let mut at = Pose::default();
    for (curvature, sharpness, length) in [
        (0.0, 0.0, 8.0),
        (0.0, 0.1, 2.0),
        (0.2, 0.0, 5.0),
        (0.2, -0.1, 2.0),
        (0.0, 0.0, 8.0),
    ] {
        let leg = Leg {
            start: at,
            curvature,
            sharpness,
            length,
            speed: 1.0,
            ..Leg::default()
        };
        at = leg.end();
        legs.push(leg);
    }
    assert_eq!(check(&mission(&legs, &[]), &settings()).unwrap().turns, 0);
    let (driven, turns, finished) = follow(&mission(&legs, &[]), 100.0);
    assert_eq!((driven.len(), turns, finished), (5, 0, true));
}

/// An interrupted mission goes on where it was.
#[test]
fn a_planner_begins_anywhere() {
    let legs = FIELD.legs();
    let plan = mission(&legs, &[]);
    let mut planner = Planner::from(settings(), 3, 12.5);
    let Step::Piece(piece) = planner.step(&plan) else {
        panic!("no piece");
    };
    assert_eq!(
        (piece.leg, piece.from, piece.segment.length),
        (3, 12.5, 27.5)
    );
    assert!((piece.segment.start.north - 27.5).abs() < 1e-9);
    let mut stretch = Stretch::new(plan.origin(), settings().pace);
    stretch.push(piece);
    let mut progress = Progress::start();
    stretch.advance(&mut progress, 20.0, 9.0);
    let there = stretch.whereabouts(&progress).unwrap();
    assert_eq!((there.leg, there.purpose), (3, Purpose::Leg));
    assert!((there.along - 20.0).abs() < 1e-9);
}

/// Without a turn the path ends behind the leg, and says so.
#[test]
fn a_missing_turn_is_told() {
    let narrow = Field {
        headland: 2.5,
        ..FIELD
    };
    let (legs, fence) = (narrow.legs(), narrow.fence());
    let plan = mission(&legs, &fence);
    let mut planner = Planner::new(settings());
    let mut stretch = Stretch::new(plan.origin(), settings().pace);
    while planner.feed(&plan, &mut stretch, 0) {}
    assert_eq!(planner.stuck(), Some((0, TurnError::NoRoom)));
    assert_eq!(
        planner.step(&plan),
        Step::NoTurn {
            leg: 0,
            error: TurnError::NoRoom
        }
    );
    // The vehicle stops at the end of what there is.
    let progress = Progress {
        segment: 0,
        along: 40.0,
        finished: false,
    };
    assert_eq!(stretch.speed(&progress, 0.1), Some(0.0));
}

fn piece(speed: f64, length: f64, reverse: bool, outputs: u8) -> Piece<f64> {
    Piece {
        segment: Segment {
            length,
            ..Segment::default()
        },
        speed,
        reverse,
        outputs,
        ..Piece::default()
    }
}

fn stretch(pieces: &[Piece<f64>]) -> Stretch<f64> {
    let mut stretch = Stretch::new(Position::new(0, 0), Pace::of_drive(0.3));
    for piece in pieces {
        assert!(stretch.push(*piece));
    }
    stretch
}

fn at(segment: usize, along: f64) -> Progress<f64> {
    Progress {
        segment,
        along,
        finished: false,
    }
}

proptest! {
    /// At every place the vehicle can still slow down for what lies ahead.
    #[test]
    fn the_speed_suits_what_lies_ahead(
        speeds in proptest::collection::vec((0.2_f64..3.0, 0.1_f64..8.0, any::<bool>()), 1..16),
        along in 0.0_f64..1.0, speed in 0.0_f64..3.0,
    ) {
        let pieces: Vec<_> = speeds
            .iter()
            .map(|&(speed, length, reverse)| piece(speed, length, reverse, 0))
            .collect();
        let stretch = stretch(&pieces);
        let along = along * pieces[0].segment.length;
        let found = stretch.speed(&at(0, along), speed).unwrap();
        prop_assert!(found <= (speed + 0.15).max(0.1) + 1e-9);
        let pace = Pace::of_drive(0.3);
        let mut distance = pieces[0].segment.length - along;
        prop_assert!(found <= pieces[0].speed && found >= 0.0);
        for (number, piece) in pieces.iter().enumerate() {
            let next = pieces.get(number + 1).filter(|next| next.reverse == piece.reverse);
            let limit = next.map_or(pace.creep, |next| next.speed);
            let left = (distance - speed * pace.reaction).max(0.0);
            let square = limit.powi(2) + 2.0 * pace.deceleration * left;
            prop_assert!(found * found <= square + 1e-9, "{found} m/s, {distance} m before {number}");
            let Some(next) = next else {
                break;
            };
            distance += next.segment.length;
        }
    }
}

#[test]
fn stops_are_reached() {
    let stretch = stretch(&[piece(1.0, 10.0, false, 0), piece(0.5, 3.0, true, 0)]);
    assert_eq!(stretch.speed(&at(0, 2.0), 0.95), Some(1.0));
    let near = stretch.speed(&at(0, 9.9), 0.1).unwrap();
    assert!((0.1..0.3).contains(&near), "{near}");
    assert_eq!(stretch.speed(&at(0, 10.01), 0.1), Some(0.0));
    assert!(!stretch.reverse(&at(0, 5.0)) && stretch.reverse(&at(1, 0.0)));
    // No piece, no motion.
    assert_eq!(stretch.speed(&at(2, 0.0), 0.1), Some(0.0));
    assert!(!stretch.is_ready(&at(2, 0.0)) && stretch.is_ready(&at(1, 0.0)));
}

#[test]
fn a_pause_stops_gently() {
    let mut stretch = stretch(&[piece(1.0, 100.0, false, 3)]);
    let mut outputs = Outputs::new([Section::default(); 8]);
    assert_eq!(outputs.step(&stretch, &at(0, 5.0), 1.0, 0.1).now, 3);
    stretch.pause();
    assert!(stretch.is_paused());
    let mut speed = 1.0;
    let mut steps = 0;
    while speed > 0.0 {
        let next = stretch.speed(&at(0, 5.0), speed).unwrap();
        assert!(next < speed && (next >= speed - 0.151 || next == 0.0));
        speed = next;
        steps += 1;
    }
    assert!((4..20).contains(&steps), "{steps}");
    assert_eq!(outputs.step(&stretch, &at(0, 5.0), 1.0, 0.1).now, 0);
    stretch.resume();
    // And it drives on gently.
    let mut steps = 0;
    while speed < 1.0 {
        let next = stretch.speed(&at(0, 5.0), speed).unwrap();
        assert!(next > speed && next <= speed + 0.151);
        speed = next;
        steps += 1;
    }
    assert!((4..20).contains(&steps), "{steps}");
}

/// The way that a section moves in its delay is predicted with the speeds that lie ahead.
#[test]
fn the_way_in_a_delay_is_predicted() {
    let stretch = stretch(&[piece(1.0, 10.0, false, 0), piece(1.0, 3.0, true, 0)]);
    let constant = stretch.predict(&at(0, 2.0), 1.0, 0.6);
    assert!((constant - 0.6).abs() < 1e-9, "{constant}");
    // From standstill at 0.5 m/s^2, and down to the stop.
    let begins = stretch.predict(&at(0, 2.0), 0.0, 1.0);
    assert!((0.15..0.25).contains(&begins), "{begins}");
    let stops = stretch.predict(&at(0, 9.2), 1.0, 1.0);
    assert!((0.5..0.8).contains(&stops), "{stops}");
}

/// A vehicle at constant speed: each section changes at its border, in front of it by its delay,
/// and where the section is.
#[test]
fn sections_change_at_borders() {
    let pieces = [
        piece(1.7, 5.0, false, 0),
        piece(1.7, 7.3, false, 1),
        piece(1.7, 4.1, false, 0b11),
        piece(1.7, 6.0, false, 0),
        piece(1.7, 3.0, false, 0b10),
        piece(1.7, 30.0, false, 0),
    ];
    let stretch = stretch(&pieces);
    let section = Section {
        on_delay: 0.4,
        off_delay: 0.25,
        ahead: -0.8,
    };
    let mut outputs = Outputs::new([section; 8]);
    let (speed, period) = (1.7, 0.1);
    let mut changes = Vec::new();
    let mut state = 0;
    let mut along = -4.0;
    while along < 30.0 {
        let mut segment = 0;
        let mut rest = along;
        while segment < 5 && rest > pieces[segment].segment.length {
            rest -= pieces[segment].segment.length;
            segment += 1;
        }
        let switching = outputs.step(&stretch, &at(segment, rest), speed, period);
        for bit in 0..8 {
            let mask = 1 << bit;
            if (switching.now ^ state) & mask != 0 {
                changes.push((bit, switching.now & mask != 0, along));
            }
            if let Some(time) = switching.later[bit] {
                assert!((0.0..=period).contains(&time));
                let on = switching.now & mask == 0;
                changes.push((bit, on, along + speed * time));
            }
        }
        state = outputs.state();
        along += speed * period;
    }
    // From the rear axle to the section, and the way in its delay.
    let on = |border: f64| border + 0.8 - 1.7 * 0.4;
    let off = |border: f64| border + 0.8 - 1.7 * 0.25;
    let known = [
        (0, true, on(5.0)),
        (1, true, on(12.3)),
        (0, false, off(16.4)),
        (1, false, off(16.4)),
        (1, true, on(22.4)),
        (1, false, off(25.4)),
    ];
    assert_eq!(changes.len(), known.len(), "{changes:?}");
    for (found, known) in changes.iter().zip(known) {
        assert_eq!((found.0, found.1), (known.0, known.1));
        assert!((found.2 - known.2).abs() < 1e-9, "{found:?}, {known:?}");
    }
    // Nothing stays on at the end of a mission.
    let mut outputs = Outputs::new([section; 8]);
    outputs.step(&stretch, &at(1, 3.0), speed, period);
    assert_ne!(outputs.state(), 0);
    let end = Progress {
        finished: true,
        ..at(1, 3.1)
    };
    assert_eq!(outputs.step(&stretch, &end, 0.0, period).now, 0);
}

/// In reverse a section behind the axle comes first.
#[test]
fn sections_know_the_direction() {
    let stretch = stretch(&[piece(1.0, 5.0, true, 0), piece(1.0, 5.0, true, 1)]);
    let on = |outputs: u8| outputs == 1;
    let (number, distance) = stretch.change(&at(0, 2.0), -0.5, 0, on).unwrap();
    assert_eq!(number, 1);
    assert!((distance - 2.5).abs() < 1e-9, "{distance}");
}
