//! Drivable curves through points: how near they come, how they meet, and what of them is reported.

#[path = "../fuzz/src/lib.rs"]
#[expect(unreachable_pub, dead_code, reason = "a library of its own in `fuzz/`")]
mod fuzz;

use std::f64::consts::{PI, TAU};

use mission::curve::{Chain, Continuity, CurveError, Options, Resampling, Segment, fit, leg};
use mission::place::{Local, Origin};
use mission::plan::{End, Join, Leg, Outputs, Plan, Shape};
use proptest::prelude::*;

/// Largest jumps where pieces meet: place (m), heading (rad) and curvature times the length of the shorter piece.
fn jumps(chain: &Chain) -> (f64, f64, f64) {
    let mut largest = (0.0_f64, 0.0_f64, 0.0_f64);
    for pair in chain.segments.windows(2) {
        let (end, next) = (pair[0].end(), &pair[1]);
        let heading = (end.heading - next.start.heading).sin().abs();
        let curvature = pair[0].curvature_at(pair[0].length) - next.curvature;
        largest.0 = largest.0.max(end.place.distance(next.start.place));
        largest.1 = largest.1.max(heading);
        largest.2 = largest
            .2
            .max(curvature.abs() * pair[0].length.min(next.length));
    }
    largest
}

fn assert_smooth(chain: &Chain) {
    let (place, heading, curvature) = jumps(chain);
    assert!(place < 1e-8 && heading < 1e-8, "{place} {heading}");
    assert_eq!(chain.continuity, Continuity::Curvature);
    assert!(curvature < 1e-6, "{curvature}");
}

fn circle(radius: f64, count: u32, turn: f64) -> Vec<Local> {
    let at = |index| f64::from(index) / f64::from(count) * turn;
    (0..=count)
        .map(|index| Local::default().towards(at(index), radius))
        .collect()
}

/// A lane change between two lines.
fn wave(count: u32) -> Vec<Local> {
    let at = |index| f64::from(index) / f64::from(count) * 100.0;
    (0..=count)
        .map(at)
        .map(|north| Local::new(north, 3.0 * (north / 100.0 * TAU).sin()))
        .collect()
}

/// Noise without a generator: digits of multiples of the golden ratio, as a normal distribution by twelve of them.
fn noise(index: usize, size: f64) -> f64 {
    let uniform = |i: usize| {
        (((index * 12 + i) as f64 * 0.618_033_988_749_894_9 * 1000.0).sin() * 43_758.545_3)
            .rem_euclid(1.0)
    };
    ((0..12).map(uniform).sum::<f64>() - 6.0) * size
}

#[test]
fn an_arc_is_an_arc() {
    // Clockwise round the origin from north: to the right.
    let chain = fit(&circle(20.0, 30, PI), &Options::default()).unwrap();
    assert_smooth(&chain);
    assert!(chain.segments.len() <= 4, "{} pieces", chain.segments.len());
    assert!(
        (chain.tightest.curvature - 0.05).abs() < 1e-4,
        "{:?}",
        chain.tightest
    );
    assert!((chain.length() - 20.0 * PI).abs() < 1e-3);
    assert!(chain.deviation < 1e-4, "{}", chain.deviation);
    // Between the points, an arc is away from the chords by r (1 - cos(half the angle)).
    let bulge = 20.0 * (1.0 - (PI / 60.0).cos());
    assert!(
        (chain.bulge - bulge).abs() < 1e-3,
        "{} {bulge}",
        chain.bulge
    );
}

#[test]
fn a_closed_curve_goes_on_without_a_jump() {
    let mut points = circle(15.0, 40, TAU);
    *points.last_mut().unwrap() = points[0];
    for point in &mut points {
        point.east *= 1.5;
    }
    let chain = fit(&points, &Options::default()).unwrap();
    assert_smooth(&chain);
    let (first, last) = (
        &chain.segments[0],
        &chain.segments[chain.segments.len() - 1],
    );
    let (begin, end) = (first.start, last.end());
    assert!(end.place.distance(begin.place) < 1e-8);
    assert!((end.heading - begin.heading).sin().abs() < 1e-8);
    assert!((last.curvature_at(last.length) - first.curvature).abs() < 1e-8);
    assert!(chain.deviation <= 0.02);
}

#[test]
fn few_pieces_follow_many_points() {
    let points = wave(500);
    let chain = fit(&points, &Options::default()).unwrap();
    assert_smooth(&chain);
    assert!(chain.deviation <= 0.02, "{}", chain.deviation);
    assert!(
        chain.segments.len() <= 12,
        "{} pieces",
        chain.segments.len()
    );
    // The curvature of the wave at its crests: amplitude times the square of its wave number.
    let crest = 3.0 * (TAU / 100.0).powi(2);
    assert!(
        (chain.tightest.curvature.abs() - crest).abs() < 0.2 * crest,
        "{:?}",
        chain.tightest
    );
    let tight = fit(
        &points,
        &Options {
            tolerance: 1e-4,
            ..Options::default()
        },
    )
    .unwrap();
    assert!(tight.deviation <= 1e-4 && tight.segments.len() > chain.segments.len());
}

#[test]
fn the_tightest_place_is_where_it_is_tightest() {
    let mut points = wave(60);
    points[30].east += 0.3;
    let chain = fit(&points, &Options::default()).unwrap();
    assert!(
        chain.tightest.place.distance(points[30]) < 3.0,
        "{:?}",
        chain.tightest
    );
    let mut rest = chain.tightest.along;
    let piece = chain.segments.iter().find(|piece| {
        let found = rest <= piece.length + 1e-9;
        rest -= if found { 0.0 } else { piece.length };
        found
    });
    let piece = piece.unwrap();
    assert!(piece.at(rest).place.distance(chain.tightest.place) < 1e-6);
    assert!((piece.curvature_at(rest) - chain.tightest.curvature).abs() < 1e-9);
}

#[test]
fn ends_can_be_straight() {
    let options = Options {
        straight_begin: true,
        straight_end: true,
        ..Options::default()
    };
    let chain = fit(&circle(20.0, 30, PI), &options).unwrap();
    assert_smooth(&chain);
    let last = &chain.segments[chain.segments.len() - 1];
    assert!(chain.segments[0].curvature.abs() < 1e-9);
    assert!(last.curvature_at(last.length).abs() < 1e-9);
    assert!(chain.deviation <= 0.02);
}

#[test]
fn noise_is_taken_out_by_resampling() {
    let points: Vec<Local> = wave(400)
        .into_iter()
        .enumerate()
        .map(|(i, p)| {
            Local::new(
                p.north + noise(2 * i, 0.02),
                p.east + noise(2 * i + 1, 0.02),
            )
        })
        .collect();
    let resampling = Some(Resampling {
        spacing: 1.0,
        noise: 0.02,
    });
    let chain = fit(
        &points,
        &Options {
            resampling,
            ..Options::default()
        },
    )
    .unwrap();
    assert_smooth(&chain);
    // True curvature is at most 0.0118 1/m; without resampling, noise makes it a hundred times as much.
    assert!(
        chain.tightest.curvature.abs() < 0.03,
        "{:?}",
        chain.tightest
    );
    assert!(chain.moved < 0.12, "{}", chain.moved);
    // The curve is nearer to the wave than the points were.
    let away = chain.poses(0.5).into_iter().map(|pose| {
        let true_east = 3.0 * (pose.place.north / 100.0 * TAU).sin();
        (pose.place.east - true_east).abs()
    });
    let away = away.fold(0.0, f64::max);
    assert!(away < 0.04, "{away}");
    let noisy = fit(&points, &Options::default());
    if let Ok(noisy) = noisy {
        assert!(noisy.tightest.curvature.abs() > 0.3, "{:?}", noisy.tightest);
    }
}

#[test]
fn corners_are_rounded_through_their_points() {
    let points = [(0.0, 0.0), (30.0, 0.0), (30.0, 30.0), (60.0, 30.0)];
    let points = points.map(|(north, east)| Local::new(north, east));
    let chain = fit(&points, &Options::default()).unwrap();
    assert_smooth(&chain);
    assert!(chain.deviation < 1e-6, "{}", chain.deviation);
    assert!(chain.bulge > 1.0 && chain.bulge < 12.0, "{}", chain.bulge);
}

#[test]
fn where_there_is_no_spline_arcs_take_its_place() {
    // Long legs with kinks of 145 degrees between short ones.
    let points = [
        (0.0, 0.0),
        (100.0, 0.0),
        (99.2, 0.56),
        (0.0, 30.0),
        (0.2, 30.9),
        (80.0, 40.0),
        (80.0, 41.0),
        (-5.0, 43.0),
    ];
    let points = points.map(|(north, east)| Local::new(north, east));
    let chain = fit(&points, &Options::default()).unwrap();
    assert_eq!(chain.continuity, Continuity::Heading);
    let (place, heading, _) = jumps(&chain);
    assert!(place < 1e-8 && heading < 1e-8, "{place} {heading}");
    assert!(chain.segments.iter().all(|arc| arc.sharpness == 0.0));
    assert!(chain.deviation < 1e-6, "{}", chain.deviation);
}

#[test]
fn what_has_no_curve_is_refused_in_a_sentence() {
    let at = |pairs: &[(f64, f64)]| {
        pairs
            .iter()
            .map(|(n, e)| Local::new(*n, *e))
            .collect::<Vec<_>>()
    };
    let refused = |points: &[Local]| fit(points, &Options::default()).unwrap_err();
    assert_eq!(refused(&at(&[(0.0, 0.0)])), CurveError::Few);
    assert_eq!(
        refused(&at(&[(0.0, 0.0), (f64::NAN, 0.0)])),
        CurveError::Number
    );
    assert_eq!(
        refused(&at(&[(0.0, 0.0), (1.0, 0.0), (1.0, 0.0)])),
        CurveError::Repeated { point: 2 }
    );
    let back = refused(&at(&[(0.0, 0.0), (10.0, 0.0), (1.0, 0.5)]));
    assert_eq!(
        back.to_string(),
        "point 2: the curve doubles back there (10.00 m north, 0.00 m east); split it in two legs, or resample it if its \
         points are noisy"
    );
    let resampling = Some(Resampling {
        spacing: 1e-6,
        noise: 0.0,
    });
    let many = fit(
        &wave(5),
        &Options {
            resampling,
            ..Options::default()
        },
    )
    .unwrap_err()
    .to_string();
    assert!(
        many.ends_with("m long; resampled, a curve has up to 100000 points"),
        "{many}"
    );
    let options = Options {
        tolerance: 0.0,
        ..Options::default()
    };
    assert_eq!(fit(&wave(5), &options), Err(CurveError::Number));
}

#[test]
fn a_line_is_one_piece() {
    let (from, to) = (Local::new(1.0, 1.0), Local::new(1.0, 244.0));
    let line = Leg {
        shape: Shape::Line { from, to },
        speed: 1.0,
        reverse: false,
        outputs: Outputs(0),
        join: Join::Turn,
    };
    let chain = leg(&line, &Options::default()).unwrap();
    assert_eq!(chain.segments.len(), 1);
    assert!((chain.length() - 243.0).abs() < 1e-12);
    assert!(chain.segments[0].end().place.distance(to) < 1e-9);
    assert_eq!(chain.tightest.curvature, 0.0);
}

fn plan(legs: Vec<Leg>, end: End) -> Plan {
    Plan {
        name: "legs".to_owned(),
        origin: Origin::default(),
        width: None,
        fence: Vec::new(),
        obstacles: Vec::new(),
        legs,
        end,
    }
}

fn of(shape: Shape, join: Join) -> Leg {
    Leg {
        shape,
        speed: 1.0,
        reverse: false,
        outputs: Outputs(0),
        join,
    }
}

fn line(from: (f64, f64), to: (f64, f64), join: Join) -> Leg {
    let place = |(north, east)| Local::new(north, east);
    of(
        Shape::Line {
            from: place(from),
            to: place(to),
        },
        join,
    )
}

#[test]
fn legs_that_continue_have_no_jumps_between_them() {
    // A line, a bend of a quarter of a circle, a line.
    let bend = (0..=20)
        .map(|i| Local::new(50.0, 20.0).towards(-PI / 2.0 + f64::from(i) * PI / 40.0, 20.0));
    let legs = vec![
        line((0.0, 0.0), (50.0, 0.0), Join::Turn),
        of(
            Shape::Curve {
                points: bend.collect(),
            },
            Join::Continue,
        ),
        line((70.0, 20.0), (70.0, 60.0), Join::Continue),
        line((70.0, 60.0), (70.0, 80.0), Join::Turn),
        line((70.0, 80.0), (70.0, 90.0), Join::Continue),
    ];
    let plan = plan(legs, End::Stop);
    plan.check().unwrap();
    let chains = mission::curve::legs(&plan, &Options::default()).unwrap();
    let segments = |range: std::ops::Range<usize>| {
        chains[range]
            .iter()
            .flat_map(|chain| chain.segments.clone())
            .collect()
    };
    let joined: Vec<Segment> = segments(0..3);
    let whole = Chain {
        segments: joined,
        ..chains[0].clone()
    };
    assert_smooth(&whole);
    for chain in &chains[..3] {
        assert!(
            chain.moved <= 0.02 && chain.deviation <= 0.02,
            "{} {}",
            chain.moved,
            chain.deviation
        );
    }
    assert!(chains[0].bulge <= 0.02 && chains[2].bulge <= 0.02);
    assert!(chains[0].segments[0].start.place.distance(Local::default()) < 1e-9);
    // Where a turn follows, nothing bends.
    let last = &whole.segments[whole.segments.len() - 1];
    assert!(last.curvature_at(last.length).abs() < 1e-9);
    // Lines without a kink stay lines.
    assert_eq!(
        (chains[3].segments.len(), chains[3].tightest.curvature),
        (1, 0.0)
    );
}

#[test]
fn a_repeated_round_goes_on_without_a_jump() {
    let mut points = circle(12.0, 36, TAU);
    *points.last_mut().unwrap() = points[0];
    let round = of(Shape::Curve { points }, Join::Continue);
    let jump = |end: End| {
        let chains =
            mission::curve::legs(&plan(vec![round.clone()], end), &Options::default()).unwrap();
        let (first, last) = (
            &chains[0].segments[0],
            &chains[0].segments[chains[0].segments.len() - 1],
        );
        (last.end().heading - first.start.heading).sin().abs()
    };
    assert!(jump(End::Repeat) < 1e-9);
    assert!(jump(End::Stop) < 1e-2);
}

#[test]
fn a_leg_without_a_curve_is_named() {
    let back = of(
        Shape::Curve {
            points: vec![
                Local::new(10.0, 0.0),
                Local::new(20.0, 0.0),
                Local::new(12.0, 0.5),
            ],
        },
        Join::Continue,
    );
    let both = plan(
        vec![line((0.0, 0.0), (10.0, 0.0), Join::Turn), back],
        End::Stop,
    );
    let (leg, error) = mission::curve::legs(&both, &Options::default()).unwrap_err();
    assert_eq!(leg, 1);
    assert!(
        error
            .to_string()
            .starts_with("point 2: the curve doubles back there (20.00 m north"),
        "{error}"
    );
    // A change of the direction of travel is a new curve.
    let mut reverse = line((10.0, 0.0), (0.0, 0.0), Join::Continue);
    reverse.reverse = true;
    let cusp = plan(
        vec![line((0.0, 0.0), (10.0, 0.0), Join::Turn), reverse],
        End::Stop,
    );
    assert_eq!(
        mission::curve::legs(&cusp, &Options::default())
            .unwrap()
            .len(),
        2
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Walks with kinks of up to 40 degrees and steps of one to ten metres.
    #[test]
    fn walks_are_followed(steps in prop::collection::vec((1.0_f64..10.0, -0.7_f64..0.7), 1..60), straight_begin: bool, straight_end: bool) {
        let mut points = vec![Local::default()];
        let mut heading = 0.3;
        for (length, kink) in steps {
            heading += kink;
            points.push(points[points.len() - 1].towards(heading, length));
        }
        let chain = fit(&points, &Options { straight_begin, straight_end, ..Options::default() }).unwrap();
        let (place, heading, curvature) = jumps(&chain);
        prop_assert!(place < 1e-7 && heading < 1e-7, "{} {}", place, heading);
        prop_assert!(chain.continuity == Continuity::Curvature && curvature < 1e-5, "{}", curvature);
        prop_assert!(chain.deviation <= 0.02 + 1e-9, "{}", chain.deviation);
    }

    #[test]
    fn no_points_break_the_fit(bytes in prop::collection::vec(any::<u8>(), 0..160)) {
        fuzz::curve(&bytes);
    }
}
