//! The picture of a plan.

mod common;

use common::plans;
use mission::curve::{self, legs};
use mission::field::{Area, Field, Headland, Options, Order, Work, divide};
use mission::picture::{self, svg};
use mission::place::{Local, Origin};
use mission::plan::{End, Join, Leg, Outputs, Plan, Shape};
use proptest::prelude::*;

/// A field with a pond, skipped swaths, and a bend that is driven backwards at its end.
fn field() -> (Field, Plan) {
    let ring = |corners: &[(f64, f64)]| corners.iter().map(|(n, e)| Local::new(*n, *e)).collect();
    let area = Area {
        outer: ring(&[
            (0.0, 0.0),
            (90.0, -10.0),
            (110.0, 60.0),
            (100.0, 120.0),
            (10.0, 110.0),
        ]),
        holes: vec![ring(&[
            (50.0, 50.0),
            (50.0, 58.0),
            (58.0, 58.0),
            (58.0, 50.0),
        ])],
    };
    let options = Options {
        radius: 3.0,
        order: Order::Skip,
        headland: 6.0,
        ..Options::new(4.0)
    };
    let field = divide(&area, &options).unwrap();
    let work = Work {
        speed: 1.5,
        outputs: Outputs(1),
        headland: Headland::Left,
        end: End::Stop,
    };
    let mut plan = field.plan("Field <1> & pond", Origin::default(), &work);
    let bend = [
        (5.0, 10.0),
        (5.0, 40.0),
        (5.0, 60.0),
        (8.0, 63.0),
        (11.0, 60.0),
        (11.0, 40.0),
    ];
    plan.legs.push(Leg {
        shape: Shape::Curve {
            points: ring(&bend),
        },
        speed: 0.5,
        reverse: true,
        outputs: Outputs(0),
        join: Join::Turn,
    });
    (field, plan)
}

#[test]
fn everything_is_in_the_picture() {
    let (field, plan) = field();
    let chains = legs(&plan, &curve::Options::default()).unwrap();
    let picture = svg(
        &plan,
        &picture::Options {
            chains: &chains,
            limit: Some(0.3),
            width: Some(4.0),
            field: Some(&field),
            ..picture::Options::default()
        },
    );
    let document = roxmltree::Document::parse(&picture).unwrap();
    let count = |class: &str| {
        let nodes = document.descendants();
        nodes
            .filter(|node| {
                node.attribute("class")
                    .is_some_and(|all| all.split(' ').any(|one| one == class))
            })
            .count()
    };
    // One sample of each in the legend.
    assert_eq!(count("turn"), plan.legs.len() - 1 + 1);
    assert_eq!(count("strip"), plan.legs.len() - 1 + 1);
    assert_eq!(count("hole"), 2);
    assert_eq!(count("fence"), 1);
    assert_eq!(count("inner"), field.inner.len() + 1);
    assert_eq!(count("number"), plan.legs.len());
    assert_eq!((count("start"), count("end")), (2, 1));
    // The bend is tighter than the limit, and only there.
    assert!(chains.last().unwrap().tightest.curvature.abs() > 0.3);
    assert!(
        count("over") >= 2 && count("over") <= 4,
        "{}",
        count("over")
    );
    assert!(count("back") >= 3);
    let texts: Vec<&str> = document
        .descendants()
        .filter_map(|node| node.text())
        .collect();
    for text in [
        "Field <1> & pond",
        "N",
        "20 m",
        "fence",
        "above the limit",
        "driven backwards",
    ] {
        assert!(texts.contains(&text), "{text}: {texts:?}");
    }
}

/// What was driven takes the place of what was planned: its strips, its turns and its figures.
#[test]
fn a_drive_is_drawn_over_its_plan() {
    let from = Local::new(0.0, 0.0);
    let leg = |to: Local| Leg {
        shape: Shape::Line { from, to },
        speed: 1.0,
        reverse: false,
        outputs: Outputs(1),
        join: Join::Turn,
    };
    let plan = Plan {
        name: "drive".to_owned(),
        origin: Origin::default(),
        width: Some(3.0),
        fence: Vec::new(),
        legs: vec![leg(Local::new(30.0, 0.0)), leg(Local::new(30.0, 20.0))],
        obstacles: Vec::new(),
        end: End::Stop,
    };
    let turn = vec![vec![Local::new(30.0, 0.0), Local::new(34.0, 2.0)]; 3];
    let way = [from, Local::new(29.0, 0.1)];
    let worked = [way.to_vec()];
    let options = picture::Options {
        width: Some(3.0),
        turns: &turn,
        driven: Some(picture::Driven {
            way: &way,
            worked: &worked,
            figures: "mean < 1 cm",
        }),
        ..picture::Options::default()
    };
    let picture = svg(&plan, &options);
    let document = roxmltree::Document::parse(&picture).unwrap();
    let count = |class: &str| {
        let of = |node: &roxmltree::Node| {
            node.has_tag_name("path") && node.attribute("class") == Some(class)
        };
        document.descendants().filter(of).count()
    };
    // Turn and drive are in the legend, too.
    assert_eq!((count("driven"), count("turn"), count("strip")), (2, 4, 1));
    assert!(picture.contains("mean &lt; 1 cm"));
}

#[test]
fn north_is_up_and_lengths_are_true() {
    let leg = |from: (f64, f64), to: (f64, f64)| Leg {
        shape: Shape::Line {
            from: Local::new(from.0, from.1),
            to: Local::new(to.0, to.1),
        },
        speed: 1.0,
        reverse: false,
        outputs: Outputs(0),
        join: Join::Continue,
    };
    let plan = Plan {
        name: "corner".to_owned(),
        origin: Origin::default(),
        width: None,
        fence: Vec::new(),
        obstacles: Vec::new(),
        legs: vec![
            leg((0.0, 0.0), (100.0, 0.0)),
            leg((100.0, 0.0), (100.0, 50.0)),
        ],
        end: End::Repeat,
    };
    let picture = svg(&plan, &picture::Options::default());
    let document = roxmltree::Document::parse(&picture).unwrap();
    let path = |index: usize| {
        let mut legs = document
            .descendants()
            .filter(|node| node.attribute("class") == Some("leg plain"));
        let path = legs.nth(index).unwrap().attribute("d").unwrap().to_owned();
        let numbers = path
            .split(['M', 'L', ' '])
            .filter_map(|word| word.parse::<f64>().ok());
        numbers.collect::<Vec<_>>()
    };
    let (up, right) = (path(0), path(1));
    let [x, y, up_x, up_y] = up[..] else {
        panic!("{up:?}")
    };
    assert!((up_x - x).abs() < 0.11 && up_y < y);
    assert!((right[2] - x - 0.5 * (y - up_y)).abs() < 0.3, "{right:?}");
    // The scale has the same units.
    let bar = document
        .descendants()
        .find(|node| node.attribute("d").is_some_and(|d| d.contains("v6h")))
        .unwrap();
    let bar = bar
        .attribute("d")
        .unwrap()
        .split(['h', 'v'])
        .nth(2)
        .unwrap()
        .parse::<f64>()
        .unwrap();
    let text = document
        .descendants()
        .filter_map(|node| node.text())
        .find(|text| text.ends_with(" m") && !text.contains(','));
    let length: f64 = text.unwrap().strip_suffix(" m").unwrap().parse().unwrap();
    assert!(
        (bar / length - (y - up_y) / 100.0).abs() < 0.01,
        "{bar} {length}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_picture_is_xml(plan in plans(), coloured: bool) {
        let chains = legs(&plan, &curve::Options::default()).unwrap_or_default();
        let picture = svg(&plan, &picture::Options {
            chains: &chains, limit: coloured.then_some(0.2), width: Some(3.0), ..picture::Options::default()
        });
        let document = roxmltree::Document::parse(&picture);
        prop_assert!(document.is_ok(), "{:?}", document);
        prop_assert!(!picture.contains("NaN") && !picture.contains("inf"));
        let title = document.unwrap().descendants().find(|node| node.has_tag_name("title")).and_then(|node| node.text().map(str::to_owned));
        prop_assert!(title.is_some_and(|title| !title.is_empty()));
    }
}
