//! Crop rows: where plants stand, what beams meet, what a chassis touches, and which settings are
//! rejected.

use core::f64::consts::{FRAC_PI_4, SQRT_2};

use proptest::prelude::*;
use world::rows::{Footprint, Rows, Shape, What};
use world::scenario::{Limits, Row};

const LIMITS: Limits = Limits {
    length: 0.4572,
    width: 0.305,
    sensor_beside: 0.152,
    beam: FRAC_PI_4,
    range: 10.0,
};

fn row(text: &str) -> Row {
    let row: Row = toml::from_str(text).unwrap();
    row.check(&LIMITS).unwrap();
    row
}

const STALKS: &str = "[[section]]\nkind = \"stalks\"\nlength = \"20 m\"\n";

/// Shapes of a kind on one side of a straight row: 1 right, -1 left.
fn on(rows: &Rows, what: What, side: f64) -> Vec<Shape> {
    let shapes = rows.shapes().iter();
    let all = shapes.filter(|shape| shape.what == what && shape.from.1 * side > 0.0);
    all.copied().collect()
}

/// Distance of a point from a shape, written another way than the crate's: the nearest of many
/// points of the segment, by a search for the minimum of a convex function.
fn away(shape: &Shape, x: f64, y: f64) -> f64 {
    let at = |share: f64| {
        let px = shape.from.0 + share * (shape.to.0 - shape.from.0);
        let py = shape.from.1 + share * (shape.to.1 - shape.from.1);
        (px - x).hypot(py - y)
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..60 {
        let third = (high - low) / 3.0;
        if at(low + third) < at(high - third) {
            high -= third;
        } else {
            low += third;
        }
    }
    at((low + high) / 2.0) - shape.radius
}

/// Where a beam first comes within a micrometre of a shape, by steps as long as the distance that is
/// free all around (J. C. Hart, The Visual Computer 12, 1996).
fn march(shapes: &[Shape], x: f64, y: f64, heading: f64, range: f64) -> Option<f64> {
    let mut distance = 0.0;
    while distance <= range {
        let (px, py) = (x + distance * heading.cos(), y + distance * heading.sin());
        let free = shapes
            .iter()
            .map(|shape| away(shape, px, py))
            .fold(f64::INFINITY, f64::min);
        if free < 1e-6 {
            return Some(distance);
        }
        distance += free;
    }
    None
}

#[test]
fn beams_of_the_thesis_meet_barriers_at_the_distances_of_its_figure() {
    let rows = Rows::new(
        &row(
            "[[section]]\nkind = \"barriers\"\nlength = \"4 m\"\nwidth = \"100 cm\"\n\
              [[section]]\nkind = \"barriers\"\nlength = \"4 m\"\nwidth = \"130 cm\"\n",
        ),
        1,
    );
    // The right sensor looks to the left row, 45 degrees ahead.
    let distance = |x: f64| rows.cast(x, 0.152, -FRAC_PI_4, 10.0).unwrap().distance;
    assert!((distance(1.0) - (0.5 + 0.152) * SQRT_2).abs() < 1e-12);
    assert!((distance(4.0) - (0.65 + 0.152) * SQRT_2).abs() < 1e-12);
    // Behind the end of the row stands nothing.
    assert_eq!(rows.cast(7.5, 0.152, -FRAC_PI_4, 10.0), None);
    assert_eq!((rows.width_at(3.9), rows.width_at(4.1)), (1.0, 1.3));
    // Driving back, a beam that is outside of the narrow part meets the wall across.
    let back = rows.cast(5.0, 0.6, core::f64::consts::PI, 10.0).unwrap();
    assert!((back.distance - 1.0).abs() < 1e-12, "{back:?}");
}

#[test]
fn a_gap_in_a_barrier_is_exactly_as_long_as_it_says() {
    let rows = Rows::new(
        &row("[[section]]\nkind = \"barriers\"\nlength = \"4 m\"\n\
              [[gap]]\nside = \"right\"\nfrom = \"1.1 m\"\nto = \"1.6 m\"\n"),
        1,
    );
    let seen = |x: f64, side: f64| {
        let heading = side * core::f64::consts::FRAC_PI_2;
        rows.cast(x, 0.0, heading, 5.0).is_some()
    };
    for (x, right) in [(1.099, true), (1.101, false), (1.599, false), (1.601, true)] {
        assert_eq!((seen(x, 1.0), seen(x, -1.0)), (right, true), "{x}");
    }
}

#[test]
fn poles_stand_semi_regularly_and_a_beam_passes_between_them() {
    let text = "[[section]]\nkind = \"poles\"\nlength = \"4.572 m\"\n";
    let rows = Rows::new(&row(text), 3);
    for side in [-1.0, 1.0] {
        let poles = on(&rows, What::Pole, side);
        assert!((22..=23).contains(&poles.len()), "{}", poles.len());
        for pair in poles.windows(2) {
            let gap = pair[1].from.0 - pair[0].from.0;
            assert!((gap - 0.2032).abs() < 0.08, "{gap}");
            assert_eq!(pair[0].radius, 0.021);
        }
    }
    let free = (0..400)
        .filter(|i| {
            rows.cast(f64::from(*i) * 0.01, 0.152, -FRAC_PI_4, 10.0)
                .is_none()
        })
        .count();
    // Poles of 4.2 cm, 20.3 cm apart, seen at 45 degrees, hide 4.2 sqrt(2) / 20.3 = 29 % of the way.
    assert!((250..=310).contains(&free), "{free}");
}

#[test]
fn missing_plants_and_gaps_leave_the_others_where_they_are() {
    let all = on(&Rows::new(&row(STALKS), 9), What::Stalk, -1.0);
    let thin = row(&STALKS.replace("\"20 m\"", "\"20 m\"\nmissing = \"30 %\""));
    let thin = on(&Rows::new(&thin, 9), What::Stalk, -1.0);
    assert!(thin.iter().all(|plant| all.contains(plant)));
    let share = thin.len() as f64 / all.len() as f64;
    // Three lines of 98 plants: four standard errors.
    assert!((share - 0.7).abs() < 0.11, "{share}");

    let gap = format!("{STALKS}[[gap]]\nside = \"left\"\nfrom = \"5 m\"\nto = \"7 m\"\n");
    let rows = Rows::new(&row(&gap), 9);
    let first = |plants: Vec<Shape>| -> Vec<f64> {
        let first = plants.iter().filter(|plant| plant.from.1.abs() < 0.7);
        first.map(|plant| plant.from.0).collect()
    };
    let inside = |stations: &[f64]| stations.iter().filter(|x| (5.0..7.0).contains(*x)).count();
    assert_eq!(inside(&first(on(&rows, What::Stalk, -1.0))), 0);
    assert!(inside(&first(on(&rows, What::Stalk, 1.0))) >= 8);
    let behind = on(&rows, What::Stalk, -1.0);
    assert!(
        behind
            .iter()
            .any(|plant| (5.0..7.0).contains(&plant.from.0))
    );
    assert!(behind.iter().all(|plant| all.contains(plant)));
    // Through the gap a beam meets the next row, one width behind.
    let hits =
        (0..60).filter_map(|i| rows.cast(5.0 + f64::from(i) * 0.01, 0.152, -FRAC_PI_4, 10.0));
    let far = hits.filter(|hit| hit.distance > 1.5).count();
    assert!(far >= 20, "{far}");
}

#[test]
fn leaves_hang_on_their_side_only_and_move_no_plant() {
    let bare = Rows::new(&row(STALKS), 5);
    let text = format!(
        "{STALKS}[[leaves]]\nside = \"right\"\nfrom = \"2 m\"\nto = \"18 m\"\ndensity = \"12 /m\"\n"
    );
    let rows = Rows::new(&row(&text), 5);
    assert_eq!(on(&rows, What::Stalk, 1.0), on(&bare, What::Stalk, 1.0));
    assert_eq!(on(&rows, What::Leaf, -1.0), []);
    let leaves = on(&rows, What::Leaf, 1.0);
    // 192 are expected; four standard deviations.
    assert!((137..=247).contains(&leaves.len()), "{}", leaves.len());
    for leaf in leaves {
        let middle = (leaf.from.1 + leaf.to.1) / 2.0;
        let length = (leaf.to.0 - leaf.from.0).hypot(leaf.to.1 - leaf.from.1);
        assert!((0.131..=0.381).contains(&middle), "{middle}");
        assert!((0.06..=0.12).contains(&length), "{length}");
    }
}

#[test]
fn a_chassis_touches_plants_and_weeds_but_no_leaf() {
    let weed = "[[weed]]\nat = \"3 m\"\nright = \"10 cm\"\ndiameter = \"5 cm\"\n";
    let leaves = "[[leaves]]\nfrom = \"0 m\"\nto = \"20 m\"\ndensity = \"60 /m\"\n";
    let rows = Rows::new(&row(&format!("{STALKS}{weed}{leaves}")), 2);
    let chassis = |x: f64, y: f64, heading: f64| Footprint {
        x,
        y,
        heading,
        half_length: 0.2286,
        half_width: 0.1524,
    };
    let touch = |x: f64, y: f64| rows.contact(&chassis(x, y, 0.0)).map(|found| found.what);
    assert_eq!(touch(10.0, 0.0), None);
    assert_eq!(touch(10.0, 0.24), Some(What::Stalk));
    assert_eq!(touch(3.0 - 0.2286 - 0.0251, 0.0), None);
    assert_eq!(touch(3.0 - 0.2286 - 0.0249, 0.0), Some(What::Weed));
    // Turned by a quarter, it is 45.7 cm wide.
    assert!(rows.contact(&chassis(10.0, 0.0, 1.57)).is_none());
    assert!(rows.contact(&chassis(10.0, 0.16, 1.57)).is_some());
}

#[test]
fn a_seed_repeats_and_another_differs() {
    let text = format!(
        "{STALKS}[[leaves]]\nfrom = \"0 m\"\nto = \"20 m\"\ndensity = \"5 /m\"\n\
         [[weeds]]\nfrom = \"0 m\"\nto = \"20 m\"\ndensity = \"1 /m\"\ndiameter = \"5 cm\"\n"
    );
    let shapes = |seed| Rows::new(&row(&text), seed).shapes().to_vec();
    assert_eq!(shapes(4), shapes(4));
    for what in [What::Stalk, What::Leaf, What::Weed] {
        let of = |seed| {
            let all = shapes(seed).into_iter();
            all.filter(|shape| shape.what == what).collect::<Vec<_>>()
        };
        assert_ne!(of(4), of(5));
    }
}

#[test]
fn ten_kilometres_of_a_curved_row_are_one_value() {
    let bends: String = (0..100)
        .map(|i| {
            let turn = if i % 2 == 0 { "right" } else { "left" };
            format!(
                "[[bend]]\nfrom = \"{} m\"\nto = \"{} m\"\nradius = \"30 m\"\nturn = \"{turn}\"\n",
                100 * i,
                100 * i + 40
            )
        })
        .collect();
    let text = STALKS.replace("20 m", "10 km").replace("10 km", "10000 m") + &bends;
    let rows = Rows::new(&row(&text), 1);
    assert_eq!(rows.length(), 10_000.0);
    let mut near = 0;
    for i in 0..50_000 {
        let place = rows.line().at(0.2 * f64::from(i) + 0.05);
        let (x, y) = place.beside(0.152);
        let hit = rows.cast(x, y, place.heading - FRAC_PI_4, 1.5);
        near += usize::from(hit.is_some_and(|hit| hit.distance < 1.0));
    }
    // Stalks of 2.2 cm hide 2.2 sqrt(2) / 20.3 = 15 % of the way.
    assert!((6_500..=8_800).contains(&near), "{near}");
}

#[test]
#[expect(clippy::too_many_lines, reason = "a table of mistakes")]
fn every_mistake_has_its_sentence() {
    let poles = "[[section]]\nkind = \"poles\"\nlength = \"5 m\"\n";
    let with = |rest: &str| format!("{poles}{rest}");
    let cases = [
        (
            String::new(),
            "row.section: a row needs at least one section",
        ),
        (
            with("width = \"30 cm\""),
            "row.section[0].width: 0.3 m is out of range, it takes 0.387 m to 5 m: the robot's width, 0.305 m, \
             a plant's diameter, 0.042 m, and 0.02 m of room on either side",
        ),
        (
            with("width = \"50 cm\"\ndiameter = \"20 cm\""),
            "row.section[0].width: 0.5 m is out of range, it takes 0.545 m to 5 m: the robot's width, 0.305 m, \
             a plant's diameter, 0.2 m, and 0.02 m of room on either side",
        ),
        (
            with("width = \"6 m\""),
            "row.section[0].width: 6 m is out of range, it takes 0.387 m to 5 m",
        ),
        (
            with("spacing = \"4 cm\""),
            "row.section[0].diameter: 0.042 m leaves no room between plants that are 0.04 m apart",
        ),
        (
            with("missing = \"101 %\""),
            "row.section[0].missing: 101 % is out of range, it takes 0 % to 100 %",
        ),
        (
            with("behind = 6"),
            "row.section[0].behind: 6 is out of range, it takes 0 to 5",
        ),
        (
            poles.replace("\"5 m\"", "\"0 m\""),
            "row.section[0].length: 0 m is out of range, it takes above 0 m to 20000 m",
        ),
        (
            poles.replace("\"5 m\"", "\"15000 m\"").repeat(2),
            "row.section: all sections together are 30000 m long, a row has at most 20000 m",
        ),
        (
            "[[section]]\nkind = \"barriers\"\nlength = \"5 m\"\nspacing = \"8 cm\"".into(),
            "row.section[0].spacing: smooth barriers have no plants, leave it out",
        ),
        (
            with("[[gap]]\nfrom = \"3 m\"\nto = \"2 m\""),
            "row.gap[0].to: 2 m is not behind the beginning at 3 m",
        ),
        (
            with("[[gap]]\nfrom = \"3 m\"\nto = \"6 m\""),
            "row.gap[0].to: 6 m is out of range, it takes 0 m to 5 m",
        ),
        (
            "[[section]]\nkind = \"barriers\"\nlength = \"5 m\"\n[[gap]]\nfrom = \"3 m\"\nto = \
             \"3.1 m\""
                .into(),
            "row.gap[0]: a gap of a barrier is at least 0.25 m long",
        ),
        (
            with("[[leaves]]\nfrom = \"0 m\"\nto = \"2 m\"\ndensity = \"200 /m\""),
            "row.leaves[0].density: 200 /m is out of range, it takes 0 /m to 100 /m",
        ),
        (
            with("[[leaves]]\nfrom = \"0 m\"\nto = \"2 m\"\ndensity = \"2 /m\"\nreach = \"1 m\""),
            "row.leaves[0].reach: 1 m is out of range, it takes 0 m to 0.762 m",
        ),
        (
            with("[[weed]]\nat = \"2 m\"\nright = \"50 cm\"\ndiameter = \"5 cm\""),
            "row.weed[0].right: 0.5 m is out of range, it takes -0.381 m to 0.381 m",
        ),
        (
            with(
                "[[weeds]]\nfrom = \"2 m\"\nto = \"2 m\"\ndensity = \"1 /m\"\ndiameter = \"5 cm\"",
            ),
            "row.weeds[0].to: 2 m is not behind the beginning at 2 m",
        ),
        (
            with(
                "behind = 5\n[[bend]]\nfrom = \"0 m\"\nto = \"2 m\"\nradius = \"4 m\"\nturn = \
                 \"left\"",
            ),
            "row.bend[0].radius: 4 m has no room for the rows inside, which reach 4.191 m far",
        ),
        (
            with(
                "[[bend]]\nfrom = \"0 m\"\nto = \"2 m\"\nradius = \"4 m\"\nturn = \"left\"\n\
                 [[bend]]\nfrom = \"1 m\"\nto = \"3 m\"\nradius = \"4 m\"\nturn = \"left\"",
            ),
            "row.bend[1].from: 1 m is before the end of the bend before, at 2 m",
        ),
        (
            with("[[bend]]\nfrom = \"0 m\"\nto = \"5 m\"\nradius = \"3 m\"\nturn = \"left\""),
            "row.bend[0]: the row has turned by 95 deg at its end, beyond 90 deg it could cross itself",
        ),
        (
            with("[start]\nright = \"25 cm\""),
            "row.start: the robot stands in the plants 0.25 m to the right of the middle, with a heading of \
             0 deg: there is room for 0.2075 m to either side of the middle",
        ),
        (
            // Its front is in the row already.
            with("[start]\nstation = \"-20 cm\"\nright = \"-21 cm\""),
            "row.start: the robot stands in the plants -0.21 m to the right of the middle, with a heading of \
             0 deg: there is room for 0.2075 m to either side of the middle",
        ),
        (
            with("width = \"40 cm\"\n[start]\nheading = \"-15 deg\""),
            "row.start: the robot stands in the plants 0 m to the right of the middle, with a heading of \
             -15 deg: there is room for no offset",
        ),
        (
            with("[start]\nheading = \"90 deg\""),
            "row.start.heading: 90 deg is out of range, it takes -15 deg to 15 deg",
        ),
        (
            poles.replace("\"5 m\"", "\"20000 m\"")
                + &"[[leaves]]\nfrom = \"0 m\"\nto = \"20000 m\"\ndensity = \"100 /m\"\n"
                    .repeat(20),
            "row.leaves[0]: with it there are about 4196852 plants, leaves, weeds and pieces of barriers, a \
             row takes 1000000",
        ),
        (
            poles.replace("\"5 m\"", "\"20000 m\"") + "spacing = \"2.5 cm\"\ndiameter = \"1 cm\"",
            "row.section[0]: with it there are about 1600002 plants, leaves, weeds and pieces of barriers, a \
             row takes 1000000",
        ),
        (
            with(&"[[gap]]\nfrom = \"1 m\"\nto = \"2 m\"\n".repeat(1001)),
            "row.gap: there are 1001 of these tables, a row takes 1000",
        ),
    ];
    for (text, sentence) in cases {
        let row: Row = toml::from_str(&text).unwrap_or_else(|error| panic!("{text}: {error}"));
        assert_eq!(row.check(&LIMITS), Err(sentence.to_owned()), "{text}");
    }
    // A sensor with less range than the row is wide.
    let short = Limits {
        range: 0.7,
        ..LIMITS
    };
    let row: Row = toml::from_str(poles).unwrap();
    assert_eq!(
        row.check(&short),
        Err(
            "row.section[0].width: 0.762 m is 0.754 m along the beam of a sensor in the middle, \
             which measures up to 0.7 m"
                .to_owned()
        )
    );
    let unknown = toml::from_str::<Row>("[[section]]\nkind = \"hedge\"\nlength = \"5 m\"");
    assert!(
        unknown
            .unwrap_err()
            .message()
            .contains("`barriers`, `poles`, `stalks`")
    );
    let unknown = toml::from_str::<Row>("[[gap]]\nfrom = \"1 m\"\nuntil = \"2 m\"");
    assert!(
        unknown
            .unwrap_err()
            .message()
            .contains("unknown field `until`")
    );
}

/// A row with everything in it.
fn any_row() -> impl Strategy<Value = String> {
    let kinds = prop::sample::select(vec!["poles", "stalks"]);
    (
        kinds,
        1.0..12.0_f64,
        0.4..1.5_f64,
        0.0..0.5_f64,
        0..4_u32,
        0.0..20.0_f64,
        2.0..60.0_f64,
        any::<bool>(),
    )
        .prop_map(
            |(kind, length, width, missing, behind, density, radius, left)| {
                let turn = if left { "left" } else { "right" };
                let radius = radius.max(width * 5.0).max((length + 0.5) / 1.5);
                format!(
                    "[[section]]\nkind = \"barriers\"\nlength = \"2 m\"\nwidth = \"{width} m\"\n\
                 [[section]]\nkind = \"{kind}\"\nlength = \"{length} m\"\nwidth = \"{width} m\"\n\
                 missing = \"{missing} %\"\nbehind = {behind}\n\
                 [[leaves]]\nside = \"{turn}\"\nfrom = \"0 m\"\nto = \"{length} m\"\n\
                 density = \"{density} /m\"\n\
                 [[weeds]]\nfrom = \"0 m\"\nto = \"{length} m\"\ndensity = \"{} /m\"\n\
                 diameter = \"4 cm\"\n\
                 [[bend]]\nfrom = \"0.5 m\"\nto = \"{} m\"\nradius = \"{radius} m\"\n\
                 turn = \"{turn}\"\n",
                    density / 10.0,
                    length + 1.0,
                )
            },
        )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn beams_meet_what_a_march_in_small_steps_meets(
        text in any_row(),
        seed: u64,
        station in 0.0..10.0_f64,
        right in -0.15..0.15_f64,
        heading in -3.2..3.2_f64,
    ) {
        let rows = Rows::new(&row(&text), seed);
        let place = rows.line().at(station);
        let (x, y) = place.beside(right);
        let hit = rows.cast(x, y, heading, 3.0);
        match (hit, march(rows.shapes(), x, y, heading, 3.0)) {
            (Some(hit), Some(marched)) => {
                prop_assert!((hit.distance - marched).abs() < 1e-3, "{hit:?} {marched}");
            }
            (None, None) => {}
            (hit, marched) => {
                let distance = hit.map_or(marched.unwrap_or(0.0), |hit| hit.distance);
                prop_assert!(distance > 2.999, "{hit:?} {marched:?}");
            }
        }
    }

    #[test]
    fn contacts_are_those_of_the_chassis_as_a_cloud_of_points(
        text in any_row(),
        seed: u64,
        station in 0.0..8.0_f64,
        right in -0.6..0.6_f64,
        heading in -3.2..3.2_f64,
    ) {
        let rows = Rows::new(&row(&text), seed);
        let (x, y) = rows.line().at(station).beside(right);
        let (half_length, half_width) = (0.2286, 0.1524);
        let chassis = Footprint { x, y, heading, half_length, half_width };
        let touched = rows.contact(&chassis).is_some();
        let near = rows.shapes().iter().filter(|shape| {
            shape.what.is_solid() && (shape.from.0 - x).hypot(shape.from.1 - y) < 1.0
        });
        let mut least = f64::INFINITY;
        let near: Vec<&Shape> = near.collect();
        for i in 0..=24 {
            for k in 0..=16 {
                let ahead = half_length * (f64::from(i) / 12.0 - 1.0);
                let beside = half_width * (f64::from(k) / 8.0 - 1.0);
                let px = x + ahead * heading.cos() - beside * heading.sin();
                let py = y + ahead * heading.sin() + beside * heading.cos();
                for shape in &near {
                    least = least.min(away(shape, px, py));
                }
            }
        }
        // The points are 2 cm apart.
        if least <= 0.0 {
            prop_assert!(touched, "{least}");
        } else if least > 0.0142 {
            prop_assert!(!touched, "{least}");
        }
    }

    #[test]
    fn the_middle_is_found_again(
        text in any_row(),
        station in -1.0..14.0_f64,
        right in -0.5..0.5_f64,
        guess in -2.0..2.0_f64,
    ) {
        let rows = Rows::new(&row(&text), 1);
        let (x, y) = rows.line().at(station).beside(right);
        let (found, offset) = rows.line().locate(x, y, station + guess);
        prop_assert!((found - station).abs() < 1e-6, "{found} {station}");
        prop_assert!((offset - right).abs() < 1e-6, "{offset} {right}");
    }

    #[test]
    fn plants_stand_near_their_line(text in any_row(), seed: u64) {
        let settings = row(&text);
        let rows = Rows::new(&settings, seed);
        let width = settings.section[1].width().get();
        for shape in rows.shapes() {
            if !matches!(shape.what, What::Pole | What::Stalk) {
                continue;
            }
            let (x, y) = shape.from;
            let found = (0..14).map(|guess| rows.line().locate(x, y, f64::from(guess)));
            let (station, right) = found
                .min_by(|a, b| {
                    let away = |station: f64| {
                        let place = rows.line().at(station);
                        (x - place.x).hypot(y - place.y)
                    };
                    away(a.0).total_cmp(&away(b.0))
                })
                .unwrap();
            prop_assert!((2.0 - 1e-6..=rows.length() + 1e-6).contains(&station), "{station}");
            let lines = right.abs() / width - 0.5;
            prop_assert!((lines - lines.round()).abs() * width < 0.095, "{right} {width}");
        }
    }

    #[test]
    fn no_text_makes_the_reader_panic(text in "(?s).{0,60}") {
        if let Ok(row) = toml::from_str::<Row>(&text) {
            let _ = row.check(&LIMITS);
        }
    }
}
