use mission::place::{Frame, Local, Origin};
use mission::read::csv::read;
use mission::read::{Drawing, Role, Shape};

use super::{at, outline, skipped};

pub(super) const DEGREES: &str = "\
id,Latitude,Longitude,speed
a,51.0,7.0,1
a,51.001,7.0,1
b,51.0,7.001,1
b,51.001,7.001,1
b,51.001,7.002,1
b,,7.002,1
b,51.0,7.001,1
";

fn metres(text: &str) -> Drawing {
    read(text, Some(&frame())).unwrap()
}

fn frame() -> Frame {
    Frame::new(Origin {
        place: at(51.0, 7.0),
        height: 0.0,
    })
}

/// The points of the first shape in the frame, to the millimetre.
fn local(drawing: &Drawing) -> Vec<(f64, f64)> {
    let places = match &drawing.shapes[0].shape {
        Shape::Line { from, to } => vec![*from, *to],
        Shape::Curve(places) | Shape::Polygon { outer: places, .. } => places.clone(),
    };
    let round = |value: f64| (value * 1e3).round() / 1e3;
    let places = places.iter().map(|place| frame().local(*place));
    places
        .map(|Local { north, east }| (round(north), round(east)))
        .collect()
}

#[test]
fn shapes_are_told_apart_by_a_column() {
    let drawing = read(DEGREES, None).unwrap();
    assert_eq!(
        outline(&drawing),
        [
            ("a", Role::Guidance, vec![2]),
            ("b", Role::Boundary, vec![3])
        ]
    );
    assert_eq!(skipped(&drawing), ["a row without two numbers (line 7)"]);
}

#[test]
fn separators_and_decimal_commas() {
    let expected = [(0.5, 1.25), (10.0, 2.0), (20.5, -3.0)];
    for text in [
        "North (m);East (m)\n0,5;1,25\n10;2\n20,5;-3\n",
        "east\tnorth\n1,25\t0,5\n2\t10,0\n-3\t20,5\n",
        "north,east,note\n0.5,1.25,x\n10,2,\n20.5,-3\n",
        "\n\n\"northing_m\",\"easting_m\"\r\n\"0,5\",\"1,25\"\r\n10,2\r\n\"20,5\",-3.0\r\n",
    ] {
        let drawing = metres(text);
        assert_eq!(local(&drawing), expected, "{text}");
        assert_eq!(outline(&drawing), [("curve 1", Role::Guidance, vec![3])]);
        assert_eq!(skipped(&drawing), [""; 0]);
    }
}

#[test]
fn an_empty_line_ends_a_shape() {
    let drawing = metres("north;east\n0;0\n9;0\n\n5;5\n6;6\n;\n7;7\n8;8\n");
    assert_eq!(drawing.shapes.len(), 3);
}

#[test]
fn rows_that_are_no_places_are_counted() {
    let drawing = metres("north;east\n0;0\n9;0\nx;1\n99999;0\n;2\n1e400;0\n");
    assert_eq!(
        skipped(&drawing),
        [
            "a row without two numbers (3 times, first in line 4)",
            "a row more than 10000 m from the origin (line 5)"
        ]
    );
    let drawing = read("lat,lon\n51,7\n51.1,7\n91,7\n", None).unwrap();
    assert_eq!(
        skipped(&drawing),
        ["a row that is no place of the earth (line 4)"]
    );
}

#[test]
fn hopeless_tables_are_refused_in_a_sentence() {
    let refused = |text| read(text, None).unwrap_err().to_string();
    assert_eq!(refused(""), "it has no headings");
    assert_eq!(
        refused("x,y\n1,2\n"),
        "its headings are x, y: columns latitude and longitude, or north and east, are needed"
    );
    // A heading over two lines.
    assert!(refused("\"a\nb\",c\n1,2\n").starts_with("its headings are a b, c: "));
    assert_eq!(
        refused("north,east\n1,2\n3,4\n"),
        "its columns are metres north and east, so the latitude and longitude of their origin are needed: --origin LATITUDE,LONGITUDE"
    );
    assert_eq!(
        refused("lat,lon\n51,7\n"),
        "there is no line, curve or boundary in this CSV file; left out: a line of fewer than two places"
    );
}

/// 300 ft are not 300 m.
#[test]
fn coordinates_in_other_units_are_refused() {
    let text = |unit: &str| format!("name,north{unit},east{unit}\na,0,0\na,300,0\na,300,200\n");
    for unit in ["", " (m)", " [metres]", " (M)"] {
        assert!(read(&text(unit), Some(&frame())).is_ok(), "{unit}");
    }
    assert_eq!(
        read(&text(" (ft)"), Some(&frame()))
            .unwrap_err()
            .to_string(),
        "the heading \"north (ft)\": metres are accepted, with (m) or without a unit"
    );
    assert!(read("lat (rad),lon (rad)\n0.8,0.1\n0.9,0.1\n", None).is_err());
}

#[test]
fn a_spreadsheet_may_name_its_separator() {
    let drawing = read("sep=;\nlat;lon\n51,5;7,25\n51,6;7,25\nx;y\n", None).unwrap();
    let Shape::Line { from, .. } = &drawing.shapes[0].shape else {
        panic!("{:?}", drawing.shapes);
    };
    assert_eq!((from.latitude, from.longitude), (51.5, 7.25));
    assert_eq!(drawing.skipped[0].line, Some(5));
}

#[test]
fn text_may_be_utf_16() {
    let table = "lat,lon\n51.5,7.25\n";
    for (mark, bytes) in [
        ([0xFF, 0xFE], u16::to_le_bytes as fn(u16) -> [u8; 2]),
        ([0xFE, 0xFF], u16::to_be_bytes),
    ] {
        let units = table.encode_utf16().flat_map(bytes);
        let file: Vec<u8> = mark.into_iter().chain(units).collect();
        assert_eq!(mission::read::text(&file), table);
    }
}
