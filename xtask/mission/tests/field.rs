//! Headland and swaths of fields. Areas are compared with those of GEOS (`data/oracle.py` wrote them).

#[path = "../fuzz/src/lib.rs"]
#[expect(unreachable_pub, dead_code, reason = "a library of its own in `fuzz/`")]
mod fuzz;

use std::f64::consts::{FRAC_PI_2, PI};

use mission::field::{
    self, Area, Direction, Ends, Field, FieldError, Headland, Options, Order, Work, divide,
};
use mission::place::{Frame, Geodetic, Local, Origin};
use mission::plan::{End, Outputs};
use mission::polygon;
use proptest::prelude::*;

fn ring(corners: &[(f64, f64)]) -> Vec<Local> {
    corners
        .iter()
        .map(|(north, east)| Local::new(*north, *east))
        .collect()
}

fn area(outer: &[(f64, f64)], holes: &[&[(f64, f64)]]) -> Area {
    Area {
        outer: ring(outer),
        holes: holes.iter().map(|hole| ring(hole)).collect(),
    }
}

fn hectare() -> Area {
    area(
        &[(0.0, 0.0), (100.0, 0.0), (100.0, 100.0), (0.0, 100.0)],
        &[],
    )
}

/// Distance of the nearest parts of swaths that follow each other, as a number of tracks.
fn apart(field: &Field) -> Vec<usize> {
    let pairs = field.swaths.windows(2);
    pairs
        .map(|pair| pair[0].track.abs_diff(pair[1].track))
        .collect()
}

/// A drawing of a boundary and obstacles, in a frame whose origin is their middle.
fn with_obstacles(outer: &[Local], obstacles: &[Vec<Local>]) -> (Vec<(String, Area)>, Frame) {
    let place = Geodetic {
        latitude: 51.0,
        longitude: 7.0,
    };
    let frame = Frame::new(Origin { place, height: 0.0 });
    let position = |at: &Local| {
        let place = frame.geodetic(*at);
        format!("[{},{}]", place.longitude, place.latitude)
    };
    let feature = |ring: &[Local], obstacle: bool| {
        let corners: Vec<String> = ring.iter().chain(ring.first()).map(position).collect();
        format!(
            r#"{{"type":"Feature","properties":{{"obstacle":{obstacle}}},"geometry":{{"type":"Polygon","coordinates":[[{}]]}}}}"#,
            corners.join(",")
        )
    };
    let features: Vec<String> = std::iter::once(feature(outer, false))
        .chain(obstacles.iter().map(|ring| feature(ring, true)))
        .collect();
    let text = format!(
        r#"{{"type":"FeatureCollection","features":[{}]}}"#,
        features.join(",")
    );
    let drawing = mission::read::geojson::read(&text).unwrap();
    (field::areas(&drawing, &frame), frame)
}

/// The length of swaths inside rings, m.
fn inside(swaths: &[field::Swath], rings: &[Vec<Local>]) -> f64 {
    let steps = swaths.iter().flat_map(|swath| {
        let count = swath.length().ceil();
        (0..=count as usize).map(move |step| swath.from.between(swath.to, step as f64 / count))
    });
    steps
        .filter(|at| rings.iter().any(|ring| polygon::holds(ring, *at, 0.0)))
        .count() as f64
}

/// Programs draw rings in either direction, and people draw them twice, through each other, and one in the other.
#[test]
fn no_obstacle_is_lost_to_another_one() {
    let square = |middle: (f64, f64), half: f64, turned: bool| {
        let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, 1.0), (1.0, -1.0)];
        let corner = |(north, east)| Local::new(middle.0 + north * half, middle.1 + east * half);
        let mut ring = corners.map(corner).to_vec();
        if turned {
            ring.reverse();
        }
        ring
    };
    let bow = ring(&[(-20.0, -20.0), (20.0, 20.0), (20.0, -20.0), (-20.0, 20.0)]);
    let lobes = [
        ring(&[(-20.0, -20.0), (0.0, 0.0), (-20.0, 20.0)]),
        ring(&[(20.0, 20.0), (0.0, 0.0), (20.0, -20.0)]),
    ];
    let (left, right) = ((-30.0, -30.0), (30.0, 30.0));
    let cases = [
        (
            vec![square(left, 10.0, false), square(right, 10.0, true)],
            None,
        ),
        (
            vec![square(left, 10.0, true), square(left, 10.0, false)],
            None,
        ),
        (
            vec![square(left, 20.0, true), square(left, 10.0, false)],
            None,
        ),
        (
            vec![
                square(left, 20.0, false),
                square((-20.0, -20.0), 20.0, true),
            ],
            None,
        ),
        (vec![bow], Some(lobes.to_vec())),
    ];
    for turned in [false, true] {
        for (obstacles, covered) in &cases {
            let (areas, _) = with_obstacles(&square((0.0, 0.0), 100.0, turned), obstacles);
            let area = &areas[0].1;
            let field = divide(area, &Options::new(3.0)).unwrap();
            let covered = covered.as_ref().unwrap_or(obstacles);
            let open = field::left_open(covered, &field.area.outer, &field.area.holes);
            assert!(open < 1e-3, "{open} m2 of {covered:?}");
            assert_eq!(inside(&field.swaths, covered), 0.0, "{covered:?}");
        }
    }
}

/// Whoever has joined a hole to the edge by a way there and back means either.
#[test]
fn a_hole_that_is_joined_to_the_edge_is_doubtful() {
    let edge = [(0.0, 0.0), (0.0, 100.0), (100.0, 100.0), (100.0, 0.0)];
    let hole = [
        (40.0, 40.0),
        (40.0, 60.0),
        (60.0, 60.0),
        (60.0, 40.0),
        (40.0, 40.0),
    ];
    let with = |turned: bool| {
        let mut hole = hole.to_vec();
        if turned {
            hole.reverse();
        }
        let joined = [&edge[..], &edge[..1], &hole].concat();
        divide(&area(&joined, &[]), &Options::new(3.0)).unwrap()
    };
    let coverage = with(true).coverage;
    assert!(
        (coverage.field - 9600.0).abs() < 1.0 && coverage.lost < 1.0,
        "{coverage:?}"
    );
    assert!((with(false).coverage.lost - 400.0).abs() < 1.0);
}

/// Both halves of a bow tie have the same area, and only one of them becomes the field.
#[test]
fn what_a_crossing_boundary_loses_is_told() {
    let bow = area(&[(0.0, 0.0), (100.0, 80.0), (0.0, 80.0), (100.0, 0.0)], &[]);
    let field = divide(&bow, &Options::new(3.0)).unwrap();
    let half = 0.25 * 100.0 * 80.0;
    assert!(
        (field.coverage.field - half).abs() < 1.0,
        "{:?}",
        field.coverage
    );
    assert!(
        (field.coverage.lost - half).abs() < 1.0,
        "{:?}",
        field.coverage
    );
}

#[test]
fn areas_are_those_of_geos() {
    let fields = include_str!("data/areas.json");
    let fields: serde_json::Value = serde_json::from_str(fields).unwrap();
    let ring = |value: &serde_json::Value| {
        let corners = value.as_array().unwrap().iter();
        corners
            .map(|pair| Local::new(pair[0].as_f64().unwrap(), pair[1].as_f64().unwrap()))
            .collect()
    };
    let fields = fields.as_array().unwrap();
    assert_eq!(fields.len(), 30);
    for field in fields {
        let area = Area {
            outer: ring(&field["outer"]),
            holes: field["holes"]
                .as_array()
                .unwrap()
                .iter()
                .map(ring)
                .collect(),
        };
        let number = |name: &str| field[name].as_f64().unwrap();
        let options = Options {
            headland: number("headland"),
            ..Options::new(3.0)
        };
        let found = divide(&area, &options).unwrap().coverage;
        assert!((found.field - number("area")).abs() < 1e-3, "{found:?}");
        // Arcs of some pieces cut off less than 0.1 % of the headland's corners; parts below 1 m2 are left out.
        assert!(
            (found.inner - number("inner")).abs() < 1.0 + 1e-4 * number("inner"),
            "{found:?} {}",
            number("inner")
        );
    }
}

#[test]
fn a_hectare() {
    let options = Options {
        headland: 0.0,
        ..Options::new(3.0)
    };
    let field = divide(&hectare(), &options).unwrap();
    assert_eq!(field.swaths.len(), 34);
    assert_eq!(apart(&field), [1; 33]);
    assert!(
        field.bearing.abs() < 1e-9 || (field.bearing - FRAC_PI_2).abs() < 1e-9,
        "{}",
        field.bearing
    );
    let covered = field.coverage;
    assert!((covered.field - 1e4).abs() < 1e-3 && (covered.inner - 1e4).abs() < 1e-3);
    assert!(covered.share() > 0.999_999, "{covered:?}");
    // 34 swaths of 3 m are 2 m wider than the field, a metre on each side.
    assert!((covered.outside - 200.0).abs() < 0.1, "{covered:?}");
    assert!(covered.twice < 0.1);
    for swath in &field.swaths {
        assert!((swath.length() - 100.0).abs() < 1e-6);
    }
    // They go to and fro.
    let to_and_fro = field.swaths.windows(2).all(|pair| {
        let turn = pair[0].from.bearing(pair[0].to) - pair[1].from.bearing(pair[1].to);
        (turn.abs() - PI).abs() < 1e-6
    });
    assert!(to_and_fro);
}

/// Swaths that are a little askew are a little longer, and no better.
#[test]
fn a_tie_of_directions_is_taken_by_an_edge() {
    for (north, east) in [
        (60.0, 50.0),
        (30.0, 20.0),
        (24.0, 16.0),
        (55.0, 47.0),
        (81.0, 73.0),
    ] {
        let area = Area {
            outer: vec![
                Local::new(0.0, 0.0),
                Local::new(north, 0.0),
                Local::new(north, east),
                Local::new(0.0, east),
            ],
            holes: Vec::new(),
        };
        for headland in [0.0, 6.0] {
            let options = Options {
                headland,
                ..Options::new(3.0)
            };
            let field = divide(&area, &options).unwrap();
            let along = (field.bearing / FRAC_PI_2).fract();
            assert!(
                along.min(1.0 - along) < 1e-6,
                "{north} m x {east} m: {}",
                field.bearing.to_degrees()
            );
        }
    }
}

#[test]
fn a_headland_is_left_out() {
    let field = divide(
        &hectare(),
        &Options {
            headland: 6.0,
            ..Options::new(3.0)
        },
    )
    .unwrap();
    assert!((field.coverage.inner - 88.0 * 88.0).abs() < 1e-3);
    assert_eq!(field.swaths.len(), 30);
    for swath in &field.swaths {
        for end in [swath.from, swath.to] {
            assert!(
                polygon::holds(&field.inner[0].outer, end, 1e-3),
                "{swath:?}"
            );
        }
    }
}

#[test]
fn the_best_direction_is_along_the_field() {
    // 200 m by 30 m, turned by 25 degrees.
    let turn = 25_f64.to_radians();
    let corners = [(0.0, 0.0), (200.0, 0.0), (200.0, 30.0), (0.0, 30.0)];
    let place = |(along, right): (f64, f64)| {
        Local::default()
            .towards(turn, along)
            .towards(turn + FRAC_PI_2, right)
    };
    let long = Area {
        outer: corners.map(place).to_vec(),
        holes: Vec::new(),
    };
    let field = divide(
        &long,
        &Options {
            headland: 0.0,
            ..Options::new(3.0)
        },
    )
    .unwrap();
    assert_eq!(field.swaths.len(), 10);
    assert!(
        (field.bearing - turn).abs() < 1e-9,
        "{}",
        field.bearing.to_degrees()
    );
    let across = Options {
        direction: Direction::Bearing(turn + FRAC_PI_2),
        headland: 0.0,
        ..Options::new(3.0)
    };
    assert_eq!(divide(&long, &across).unwrap().swaths.len(), 67);
}

#[test]
fn longer_swaths_cover_slanted_ends() {
    // A parallelogram: its swaths run along the longer sides and end at 45 degrees.
    let slanted = area(
        &[(0.0, 0.0), (60.0, 60.0), (60.0, 200.0), (0.0, 140.0)],
        &[],
    );
    let options = Options {
        headland: 6.0,
        direction: Direction::Bearing(FRAC_PI_2),
        ..Options::new(3.0)
    };
    let middle = divide(&slanted, &options).unwrap();
    let whole = divide(
        &slanted,
        &Options {
            ends: Ends::Whole,
            ..options
        },
    )
    .unwrap();
    assert_eq!(whole.swaths.len(), middle.swaths.len());
    // A triangle of half the width at each end of 16 swaths.
    let missing = middle.coverage.inner - middle.coverage.covered;
    assert!((missing - 32.0 * 1.5 * 1.5 / 2.0).abs() < 3.0, "{missing}");
    let share = whole.coverage.share();
    assert!(share > 0.9995, "{share}");
    for (long, short) in whole.swaths.iter().zip(&middle.swaths) {
        assert!(
            (long.length() - short.length() - 3.0).abs() < 0.02,
            "{} {}",
            long.length(),
            short.length()
        );
    }
    // Nothing leaves the field.
    let edge = slanted.outer;
    assert!(whole.swaths.iter().all(|swath| {
        swath
            .strip(3.0)
            .iter()
            .all(|corner| polygon::holds(&edge, *corner, 1e-6))
    }));
}

#[test]
fn skipped_swaths_need_no_omega() {
    let options = Options {
        radius: 4.0,
        headland: 9.0,
        ..Options::new(3.0)
    };
    let near = divide(&hectare(), &options).unwrap();
    assert_eq!(near.tight_turns, near.swaths.len() - 1);
    let skip = divide(
        &hectare(),
        &Options {
            order: Order::Skip,
            ..options
        },
    )
    .unwrap();
    assert_eq!(
        (skip.tight_turns, skip.swaths.len()),
        (0, near.swaths.len())
    );
    // Two radii are 8 m: three swaths.
    assert!(
        apart(&skip)
            .into_iter()
            .all(|apart| (3..=4).contains(&apart)),
        "{:?}",
        apart(&skip)
    );
    assert!((skip.coverage.covered - near.coverage.covered).abs() < 1e-3);
}

#[test]
fn notches_and_holes_cut_swaths() {
    // A U with its opening to the north, and a pond in its base.
    let shape = area(
        &[
            (0.0, 0.0),
            (100.0, 0.0),
            (100.0, 30.0),
            (40.0, 30.0),
            (40.0, 70.0),
            (100.0, 70.0),
            (100.0, 100.0),
            (0.0, 100.0),
        ],
        &[&[(10.0, 48.0), (10.0, 52.0), (16.0, 52.0), (16.0, 48.0)]],
    );
    let options = Options {
        direction: Direction::Bearing(FRAC_PI_2),
        headland: 3.0,
        ..Options::new(3.0)
    };
    let field = divide(&shape, &options).unwrap();
    let crosses = |swath: &mission::field::Swath, ring: &[Local]| {
        (1..200).any(|i| {
            polygon::holds(
                ring,
                swath.from.between(swath.to, f64::from(i) / 200.0),
                -1.0,
            )
        })
    };
    let pond = ring(&[(10.0, 48.0), (10.0, 52.0), (16.0, 52.0), (16.0, 48.0)]);
    let notch = ring(&[(40.0, 30.0), (40.0, 70.0), (101.0, 70.0), (101.0, 30.0)]);
    assert!(
        !field
            .swaths
            .iter()
            .any(|swath| crosses(swath, &pond) || crosses(swath, &notch))
    );
    // Both arms, the base, and its two halves beside the pond.
    let blocks = field.swaths.iter().map(|swath| swath.block).max().unwrap() + 1;
    assert!((5..=7).contains(&blocks), "{blocks}");
    // A block is driven as a whole.
    let mut seen = field
        .swaths
        .iter()
        .map(|swath| swath.block)
        .collect::<Vec<_>>();
    seen.dedup();
    assert_eq!(seen.len(), blocks);
    assert!(field.coverage.share() > 0.97, "{:?}", field.coverage);
}

#[test]
fn a_recorded_edge_may_cross_itself() {
    let mut shape = hectare();
    // The end of the recording runs over its beginning.
    shape
        .outer
        .extend(ring(&[(-0.5, 50.0), (-0.5, 0.5), (1.0, -0.5), (4.0, 0.5)]));
    let field = divide(&shape, &Options::new(3.0)).unwrap();
    assert_eq!(polygon::crossing(&field.area.outer), None);
    assert!(
        (field.coverage.field - 1e4).abs() < 60.0,
        "{:?}",
        field.coverage
    );
}

#[test]
fn what_cannot_be_divided_is_refused_in_a_sentence() {
    let refused = |area: &Area, options: Options| divide(area, &options).unwrap_err().to_string();
    assert_eq!(
        refused(
            &hectare(),
            Options {
                width: 0.0,
                ..Options::new(3.0)
            }
        ),
        "width: 0 m is out of range, it takes 0.1 m to 100 m"
    );
    assert_eq!(
        refused(
            &hectare(),
            Options {
                headland: 50.0,
                ..Options::new(3.0)
            }
        ),
        "a headland of 50 m leaves nothing of the field"
    );
    assert_eq!(
        refused(
            &area(&[(0.0, 0.0), (0.0, 9.0), (0.0, 4.0)], &[]),
            Options::new(3.0)
        ),
        "the boundary encloses less than 1 m2"
    );
    assert_eq!(
        refused(
            &area(&[(0.0, 0.0), (0.0, 99999.0), (9.0, 4.0)], &[]),
            Options::new(3.0)
        ),
        FieldError::Coordinate.to_string()
    );
    let large = area(&[(0.0, 0.0), (0.0, 9000.0), (9000.0, 0.0)], &[]);
    assert_eq!(
        refused(&large, Options::new(0.5)),
        "there are 25456 swaths, up to 10000 are accepted"
    );
    assert_eq!(
        refused(
            &hectare(),
            Options {
                shortest: 101.0,
                ..Options::new(3.0)
            }
        ),
        "no piece of a swath is as long as the shortest one accepted"
    );
    let bearing = Direction::Bearing(f64::NAN);
    assert_eq!(
        refused(
            &hectare(),
            Options {
                direction: bearing,
                ..Options::new(3.0)
            }
        ),
        "direction: NaN rad is out of range, it takes any finite angle"
    );
}

#[test]
fn a_field_becomes_a_plan() {
    let field = divide(
        &hectare(),
        &Options {
            start: Some(Local::new(100.0, 100.0)),
            ..Options::new(3.0)
        },
    )
    .unwrap();
    let work = Work {
        speed: 1.0,
        outputs: Outputs(1),
        headland: Headland::Left,
        end: End::Stop,
    };
    let plan = field.plan("field", Origin::default(), &work);
    plan.check().unwrap();
    assert_eq!(plan.legs.len(), field.swaths.len());
    // It begins at the corner where the vehicle stands.
    let (begin, _) = plan.legs[0].shape.ends();
    assert!(begin.distance(Local::new(94.0, 94.0)) < 3.0, "{begin}");
}

#[test]
fn the_headland_is_driven_in_rounds() {
    let shape = Area {
        holes: vec![ring(&[
            (48.0, 48.0),
            (48.0, 52.0),
            (52.0, 52.0),
            (52.0, 48.0),
        ])],
        ..hectare()
    };
    let options = Options {
        headland: 6.0,
        radius: 2.5,
        ..Options::new(3.0)
    };
    let field = divide(&shape, &options).unwrap();
    let rounds = field.rounds();
    // Two along the edge and two round the pond.
    assert_eq!(rounds.len(), 4);
    let outer = &rounds[0];
    assert_eq!(outer.first(), outer.last());
    let edge: Vec<Local> = field.area.outer.clone();
    for point in outer {
        let away = (0..4).map(|i| polygon::distance_to_piece(*point, edge[i], edge[(i + 1) % 4]));
        let away = away.fold(f64::INFINITY, f64::min);
        // Half a width, except in the corners.
        assert!(away > 1.5 - 1e-6, "{point}: {away}");
    }
    let work = Work {
        speed: 1.0,
        outputs: Outputs(1),
        headland: Headland::First,
        end: End::Stop,
    };
    let plan = field.plan("rounds", Origin::default(), &work);
    plan.check().unwrap();
    let chains = mission::curve::legs(&plan, &mission::curve::Options::default()).unwrap();
    for chain in &chains[..4] {
        assert_eq!(chain.continuity, mission::curve::Continuity::Curvature);
        assert!(
            chain.deviation <= 0.02 && chain.bulge < 0.06,
            "{} {}",
            chain.deviation,
            chain.bulge
        );
    }
    // The rounds along the edge can be driven.
    let radius = |index: usize| 1.0 / chains[index].tightest.curvature.abs();
    for round in [0, 2] {
        assert!(radius(round) > 2.5, "{round}: {}", radius(round));
    }
    let last = Work {
        headland: Headland::Last,
        ..work
    };
    let turned = field.plan("rounds", Origin::default(), &last);
    assert_eq!(turned.legs.len(), plan.legs.len());
    assert_eq!(turned.legs[0], plan.legs[4]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    /// Rings of both directions, anywhere, over each other and over the edge.
    #[test]
    fn obstacles_are_kept(
        rings in prop::collection::vec(
            ((-90.0..90.0, -90.0..90.0), (2.0..40.0, 2.0..40.0), any::<bool>()),
            1..6,
        ),
    ) {
        let edge = ring(&[(-80.0, -80.0), (-80.0, 80.0), (80.0, 80.0), (80.0, -80.0)]);
        let rings: Vec<Vec<Local>> = rings
            .into_iter()
            .map(|((north, east), (high, wide), turned)| {
                let mut corners = vec![
                    (north, east), (north, east + wide), (north + high, east + wide), (north + high, east),
                ];
                if turned {
                    corners.reverse();
                }
                ring(&corners)
            })
            .collect();
        let (areas, _) = with_obstacles(&edge, &rings);
        if let Ok(field) = divide(&areas[0].1, &Options::new(4.0)) {
            let open = field::left_open(&rings, &field.area.outer, &field.area.holes);
            prop_assert!(open < 1e-3, "{}", open);
            // A centimetre at their edges is rounding.
            let within: Vec<Vec<Local>> = rings
                .iter()
                .map(|ring| {
                    let middle = ring[0].between(ring[2], 0.5);
                    ring.iter().map(|at| middle.between(*at, 0.99)).collect()
                })
                .collect();
            prop_assert_eq!(inside(&field.swaths, &within), 0.0);
        }
    }

    #[test]
    fn stars_are_covered(
        radii in prop::collection::vec(20.0_f64..80.0, 4..16), width in 1.0_f64..6.0, headland in 0.0_f64..6.0, skip: bool, longer: bool,
    ) {
        let step = std::f64::consts::TAU / radii.len() as f64;
        let outer = radii.iter().enumerate().map(|(i, radius)| Local::default().towards(i as f64 * step, *radius));
        let shape = Area { outer: outer.collect(), holes: Vec::new() };
        let order = if skip { Order::Skip } else { Order::Neighbouring };
        let ends = if longer { Ends::Whole } else { Ends::Middle };
        let options = Options { headland, order, ends, radius: 2.0, ..Options::new(width) };
        let Ok(field) = divide(&shape, &options) else { return Ok(()) };
        let covered = field.coverage;
        prop_assert!(covered.covered <= covered.inner + 1e-6 && covered.inner <= covered.field + 1e-6);
        // What is missing are triangles at the ends of swaths and pieces that are too short.
        let missing = covered.inner - covered.covered;
        let ends = field.swaths.len() + field.too_short;
        prop_assert!(missing < 8.0 * width * width * ends as f64, "{:?}", covered);
        for swath in &field.swaths {
            prop_assert!(swath.length() >= options.shortest - 1e-9);
            let middle = swath.from.between(swath.to, 0.5);
            // Longer ones reach into the headland, but not out of the field.
            let inside = |area: &Area| polygon::holds(&area.outer, middle, 1e-3);
            let is_inside = if longer { inside(&field.area) } else { field.inner.iter().any(inside) };
            prop_assert!(is_inside, "{:?}", swath);
        }
        let edge = &field.area.outer;
        for point in field.rounds().iter().flatten() {
            let next = edge.iter().cycle().skip(1);
            let away = edge.iter().zip(next).map(|(from, to)| polygon::distance_to_piece(*point, *from, *to));
            // Arcs of corners have pieces that are a little inside them.
            prop_assert!(away.fold(f64::INFINITY, f64::min) > 0.495 * width, "{}", point);
        }
        let plan = field.plan("star", Origin::default(), &Work { speed: 1.0, outputs: Outputs(1), headland: Headland::Left, end: End::Stop });
        prop_assert!(plan.check().is_ok(), "{:?}", plan.check());
    }

    #[test]
    fn no_corners_break_the_division(bytes in prop::collection::vec(any::<u8>(), 0..120)) {
        fuzz::field(&bytes);
    }
}

/// An edge of hundreds of corners that cross at will, on which the library that joins polygons finds an assertion of its own
/// broken. What it returns is checked by its areas.
#[test]
fn what_a_fuzzer_has_found_is_divided_or_refused() {
    let corpus = concat!(env!("CARGO_MANIFEST_DIR"), "/fuzz/corpus/field");
    let inputs = std::fs::read_dir(corpus).unwrap();
    let inputs: Vec<_> = inputs.map(|input| input.unwrap().path()).collect();
    assert!(!inputs.is_empty());
    for input in inputs {
        fuzz::field(&std::fs::read(input).unwrap());
    }
}

#[test]
fn a_line_ends_where_the_field_does() {
    let hole = [(40.0, 0.0), (40.0, 60.0), (60.0, 60.0), (60.0, 0.0)];
    let shape = Area {
        holes: vec![ring(&hole)],
        ..hectare()
    };
    // From the south, in the direction north: before the hole.
    let (from, to) = (Local::new(10.0, 30.0), Local::new(11.0, 30.0));
    let (begin, end) = field::inside(&shape, 5.0, from, to).unwrap();
    assert!(begin.distance(Local::new(5.0, 30.0)) < 1e-6, "{begin}");
    assert!(end.distance(Local::new(35.0, 30.0)) < 1e-6, "{end}");
    // The other way round, from behind the hole.
    let (from, to) = (Local::new(80.0, 30.0), Local::new(79.0, 30.0));
    let (begin, end) = field::inside(&shape, 0.0, from, to).unwrap();
    assert!(begin.distance(Local::new(100.0, 30.0)) < 1e-6, "{begin}");
    assert!(end.distance(Local::new(60.0, 30.0)) < 1e-6, "{end}");
    let beside = (Local::new(0.0, 200.0), Local::new(1.0, 200.0));
    assert_eq!(field::inside(&shape, 0.0, beside.0, beside.1), None);
}

#[test]
fn the_headland_counts_in_the_share_of_the_field() {
    let field = divide(&hectare(), &Options::new(10.0)).unwrap();
    assert!((field.coverage.share() - 1.0).abs() < 1e-6);
    assert!((field.coverage.share_of_field() - 0.36).abs() < 1e-6);
}
