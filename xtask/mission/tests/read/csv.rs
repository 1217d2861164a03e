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
    assert_eq!(skipped(&drawing), [""; 0]);
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

/// A boundary without one of its corners can be another field, and its fence would leave the field.
#[test]
fn a_row_that_is_no_place_is_refused() {
    let refused = |row: &str| {
        let text = format!("north,east\n0,0\n60,0\n60,20\n{row}\n25,50\n0,50\n0,0\n");
        read(&text, Some(&frame())).unwrap_err().to_string()
    };
    let commas =
        "a number is accepted in each row (decimal commas need another separator or quotes)";
    for (row, said) in [
        ("25,", format!("line 5: east is \"\", {commas}")),
        ("25", format!("line 5: east is \"\", {commas}")),
        ("NaN,20", format!("line 5: north is \"NaN\", {commas}")),
        ("25,inf", format!("line 5: east is \"inf\", {commas}")),
        ("1e400,0", format!("line 5: north is \"1e400\", {commas}")),
        ("25,abc", format!("line 5: east is \"abc\", {commas}")),
        (
            "99999,0",
            "line 5: 99999 m north, 0 m east, at most 10000 m from the origin are accepted"
                .to_owned(),
        ),
    ] {
        assert_eq!(refused(row), said);
    }
    // A row that repeats the headings is none.
    let twice = metres("north,east\n0,0\n9,0\nnorth,east\n5,5\n6,6\n");
    assert_eq!(twice.shapes.len(), 2);
}

/// Four numbers in three columns are decimal commas: the first two are another place.
#[test]
fn a_row_with_more_fields_than_headings_is_refused() {
    let text = "name,latitude,longitude\nA,40,83,-96,66\nA,40,84,-96,66\n";
    assert_eq!(
        read(text, None).unwrap_err().to_string(),
        "line 2: it has 5 fields, as many as there are headings are accepted, 3 (decimal commas need another separator or \
         quotes)"
    );
    assert!(read("lat,lon\n51,7,\n52,7,\n", None).is_ok());
}

#[test]
fn interchanged_coordinates_are_told() {
    let refused = |text| read(text, None).unwrap_err().to_string();
    assert_eq!(
        refused("latitude,longitude\n-96.66,40.83\n-96.65,40.83\n"),
        "line 2: latitude -96.66, longitude 40.83 is no place of the earth, -90 to 90 and -180 to 180 degrees are accepted; \
         they may be interchanged"
    );
    assert!(refused("lat,lon\n51,7\n51,181\n").ends_with("accepted"));
    assert!(refused("lat,lon\n51,7\n91,181\n").ends_with("accepted"));
}

/// What stands in a field is not driven through.
#[test]
fn a_shape_inside_another_is_an_obstacle() {
    let square = |name: &str, north: f64, half: f64| {
        let corners = [
            (-1.0, -1.0),
            (1.0, -1.0),
            (1.0, 1.0),
            (-1.0, 1.0),
            (-1.0, -1.0),
        ];
        corners
            .map(|(n, e)| format!("{name},{},{}\n", north + n * half, e * half))
            .concat()
    };
    // The pole before its field, an island in a pond, and a field beside.
    let text = [
        square("pole", 15.0, 0.1),
        square("home", 0.0, 20.0),
        square("pond", 0.0, 5.0),
        square("island", 0.0, 2.0),
        square("other", 60.0, 20.0),
    ];
    let drawing = metres(&format!("name,north,east\n{}", text.concat()));
    assert_eq!(
        outline(&drawing),
        [
            ("home", Role::Boundary, vec![4, 4, 4]),
            ("island", Role::Boundary, vec![4]),
            ("other", Role::Boundary, vec![4]),
        ]
    );
    assert_eq!(
        drawing.notes,
        [
            "the shape \"pole\" lies inside \"home\" and is an obstacle of it",
            "the shape \"pond\" lies inside \"home\" and is an obstacle of it",
        ]
    );
    // The same shape twice is no obstacle.
    let twice = metres(&format!(
        "name,north,east\n{}{}",
        square("a", 0.0, 9.0),
        square("b", 0.0, 9.0)
    ));
    assert_eq!(twice.shapes.len(), 2);
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
    let drawing = read("sep=;\nlat;lon\n51,5;7,25\n51,6;7,25\n", None).unwrap();
    let Shape::Line { from, .. } = &drawing.shapes[0].shape else {
        panic!("{:?}", drawing.shapes);
    };
    assert_eq!((from.latitude, from.longitude), (51.5, 7.25));
    let refused = read("sep=;\nlat;lon\n51,5;7,25\n51,6;7,25\nx;y\n", None).unwrap_err();
    assert_eq!(
        refused.to_string(),
        "line 5: latitude is \"x\", a number is accepted in each row"
    );
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
