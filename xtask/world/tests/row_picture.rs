//! The picture of a drive along a row.

use roxmltree::Document;
use world::distance::{Beam, DistanceSensor, Parameters};
use world::report::{RowPicture, row_svg};
use world::rover::{Mount, State};
use world::rows::{Footprint, Rows, What};
use world::scenario::Row;
use world::time::{at, from_seconds, seconds};

fn rows(text: &str) -> Rows {
    let row: Row = toml::from_str(text).unwrap();
    Rows::new(&row, 3)
}

/// A robot that drives 14 cm to the right of the middle.
fn drive(rows: &Rows, to: f64) -> (Vec<State>, Vec<Beam>) {
    let state = |station: f64| {
        let place = rows.line().at(station);
        let (x, y) = place.beside(0.14);
        State {
            x,
            y,
            heading: place.heading,
            speed: 0.4,
            sideways: 0.0,
            turn: 0.0,
            way: station,
        }
    };
    let mut sensor = DistanceSensor::new(Parameters::default(), Mount::right(), 1, 1);
    let mut beams = Vec::new();
    let steps = (to / 0.05) as usize;
    let states = (0..=steps).map(|i| {
        let now = at(from_seconds(0.05 * i as f64 / 0.4));
        sensor.advance_to(now, rows, |when| state(0.4 * seconds(when)));
        beams.extend(sensor.beam());
        state(0.05 * i as f64)
    });
    (states.collect(), beams)
}

fn picture(text: &str, to: f64, touch: bool) -> String {
    let rows = rows(text);
    let (path, beams) = drive(&rows, to);
    let last = path.last().unwrap();
    let chassis = Footprint {
        x: last.x,
        y: last.y,
        heading: last.heading,
        half_length: 0.2286,
        half_width: 0.1524,
    };
    let found = rows.contact(&chassis);
    assert_eq!(found.is_some(), touch);
    row_svg(&RowPicture {
        name: "a <row>",
        about: "for a test",
        figures: "a weed & more",
        rows: &rows,
        start: 0.0,
        path: &path,
        beams: &beams,
        contact: found.map(|contact| (contact, chassis)),
    })
}

const TEXT: &str = "[[section]]\nkind = \"stalks\"\nlength = \"9 m\"\n\
     [[leaves]]\nside = \"left\"\nfrom = \"1 m\"\nto = \"8 m\"\ndensity = \"4 /m\"\n\
     [[weed]]\nat = \"8.4 m\"\nright = \"25 cm\"\ndiameter = \"12 cm\"\n";

/// Numbers of an attribute.
fn numbers(document: &Document, tag: &str, name: &str) -> Vec<f64> {
    let nodes = document.descendants().filter(|node| node.has_tag_name(tag));
    let values = nodes.filter_map(|node| node.attribute(name)?.parse().ok());
    values.collect()
}

#[test]
fn it_shows_plants_leaves_beams_and_the_contact() {
    let svg = picture(TEXT, 8.3, true);
    let document = Document::parse(&svg).unwrap();
    let rows = rows(TEXT);
    let count = |what: What| {
        let all = rows.shapes().iter();
        all.filter(|shape| shape.what == what && shape.from.1.abs() < 0.6)
            .count()
    };
    let with = |tag: &str, name: &str, value: &str| {
        let nodes = document.descendants();
        nodes
            .filter(|node| node.has_tag_name(tag) && node.attribute(name) == Some(value))
            .count()
    };
    assert_eq!(with("circle", "fill", "#66747e"), count(What::Stalk));
    assert_eq!(with("circle", "fill", "#009e73"), 1);
    // Leaves, and one line of the legend; those across a border between two strips are in neither.
    let leaves = with("line", "stroke", "#5fbf9f") - 1;
    assert!(
        leaves <= count(What::Leaf) && leaves + 3 >= count(What::Leaf),
        "{leaves}"
    );
    // A beam each 15 cm of 8.3 m.
    assert!((40..=58).contains(&with("line", "stroke", "#cc79a7")));
    assert_eq!(with("polygon", "stroke", "#d55e00"), 1);
    let text: String = document
        .descendants()
        .filter_map(|node| node.text())
        .collect();
    assert!(text.contains("a weed & more"), "{text}");
    assert!(text.contains("a <row>"));
}

#[test]
fn everything_is_within_the_picture_and_a_run_repeats() {
    let bend = "[[bend]]\nfrom = \"2 m\"\nto = \"8 m\"\nradius = \"6 m\"\nturn = \"left\"\n";
    let svg = picture(&format!("{TEXT}{bend}"), 7.0, false);
    assert_eq!(svg, picture(&format!("{TEXT}{bend}"), 7.0, false));
    let document = Document::parse(&svg).unwrap();
    let height: f64 = document
        .root_element()
        .attribute("height")
        .unwrap()
        .parse()
        .unwrap();
    for (tag, name, most) in [
        ("circle", "cx", 1000.0),
        ("circle", "cy", height),
        ("line", "x1", 1000.0),
        ("line", "x2", 1000.0),
        ("line", "y1", height),
        ("line", "y2", height),
    ] {
        let numbers = numbers(&document, tag, name);
        assert!(!numbers.is_empty() || tag == "circle");
        assert!(
            numbers.iter().all(|value| (0.0..=most).contains(value)),
            "{tag} {name}"
        );
    }
    // The path is drawn where the robot was: always as far to the right, though the row bends.
    let lines = document
        .descendants()
        .filter(|node| node.has_tag_name("path") && node.attribute("stroke-width") == Some("1.6"));
    let offsets: Vec<&str> = lines.filter_map(|node| node.attribute("d")).collect();
    let [line] = offsets[..] else {
        panic!("{offsets:?}");
    };
    let points = line.split(['M', 'L']).skip(1);
    let mut heights = points.map(|point| point.split_once(' ').unwrap().1);
    let first = heights.next().unwrap();
    assert!(
        heights.clone().count() > 20 && heights.all(|height| height == first),
        "{line}"
    );
}

#[test]
fn of_a_long_drive_it_shows_the_end() {
    let text = TEXT.replace("length = \"9 m\"", "length = \"500 m\"");
    let svg = picture(&text, 100.0, false);
    assert!(svg.len() < 300_000, "{}", svg.len());
    assert!(svg.contains(">100<") && !svg.contains(">30<"));
}

#[test]
fn an_empty_drive_is_a_picture_of_the_row() {
    let rows = rows(TEXT);
    let svg = row_svg(&RowPicture {
        name: "row",
        about: "",
        figures: "",
        rows: &rows,
        start: 0.0,
        path: &[],
        beams: &[],
        contact: None,
    });
    assert!(Document::parse(&svg).is_ok() && !svg.contains("NaN") && !svg.contains("inf"));
}
