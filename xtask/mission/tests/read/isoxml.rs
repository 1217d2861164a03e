use mission::place::{Frame, Origin};
use mission::read::isoxml::{read, read_parts};
use mission::read::{Role, Shape};

use super::{at, outline, skipped};

/// A partfield with everything that is read and everything that is not.
pub(super) const FIELD: &str = r#"<?xml version="1.0" encoding="UTF-8"?>
<ISO11783_TaskData VersionMajor="4" VersionMinor="3" DataTransferOrigin="1">
  <XFR A="PFD00001" B="1"/>
  <PFD A="PFD1" C="Home" D="20000">
    <PLN A="1">
      <LSG A="1"><PNT A="2" C="51.0" D="7.0"/><PNT A="2" C="51.0" D="7.002"/><PNT A="2" C="51.001" D="7.002"/><PNT A="2" C="51.001" D="7.0"/></LSG>
      <LSG A="2"><PNT A="2" C="51.0003" D="7.001"/><PNT A="2" C="51.0003" D="7.0011"/><PNT A="2" C="51.0004" D="7.0011"/><PNT A="2" C="51.0003" D="7.001"/></LSG>
    </PLN>
    <PLN A="6" B="pond">
      <LSG A="1"><PNT A="2" C="51.0" D="7.0"/><PNT A="2" C="51.0" D="7.0001"/><PNT A="2" C="51.0001" D="7.0"/></LSG>
    </PLN>
    <LSG A="3" B="tram"><PNT A="2" C="51.0" D="7.0"/><PNT A="2" C="51.001" D="7.0"/></LSG>
    <LSG A="5" B="free"><PNT A="6" C="51.0" D="7.0"/><PNT A="7" C="51.001" D="7.0"/></LSG>
    <PNT A="3" C="51.0" D="7.0"/>
    <GGP A="GGP1" B="group">
      <GPN A="GPN1" B="A-B" C="1"><LSG A="5" C="3000"><PNT A="6" C="51.0" D="7.0"/><PNT A="9" C="51.0005" D="7.1"/><PNT A="7" C="51.001" D="7.0"/></LSG></GPN>
      <GPN A="GPN2" C="2" G="90.0"><LSG A="5"><PNT A="6" C="51.0" D="7.0"/></LSG></GPN>
      <GPN A="GPN3" B="bend" C="3"><LSG A="5"><PNT A="2" C="51.0" D="7.0"/><PNT A="2" C="51.0005" D="7.0001"/><PNT A="2" C="51.001" D="7.0"/></LSG></GPN>
      <GPN A="GPN4" B="pivot" C="4" H="50000"><LSG A="5"><PNT A="8" C="51.0" D="7.0"/></LSG></GPN>
      <GPN A="GPN5" B="spiral" C="5"><LSG A="5"><PNT A="2" C="51.0" D="7.0"/></LSG></GPN>
      <GPN A="GPN6" B="broken" C="1"><LSG A="5"><PNT A="2" C="" D="7.0"/></LSG></GPN>
      <GPN A="GPN7" B="empty" C="1"/>
      <GPN A="GPN8" C="2"><LSG A="5"><PNT A="6" C="51.0" D="7.0"/></LSG></GPN>
    </GGP>
  </PFD>
</ISO11783_TaskData>
"#;

#[test]
fn a_partfield() {
    let drawing = read(FIELD).unwrap();
    assert_eq!(
        outline(&drawing),
        [
            ("Home", Role::Boundary, vec![4, 3]),
            ("pond", Role::Obstacle, vec![3]),
            ("tram", Role::Guidance, vec![2]),
            ("free", Role::Guidance, vec![2]),
            ("A-B", Role::Guidance, vec![2]),
            ("group", Role::Guidance, vec![2]),
            ("bend", Role::Guidance, vec![3]),
        ]
    );
    assert_eq!(
        skipped(&drawing),
        [
            "the part file PFD00001.XML, which is not beside it (line 3)",
            "a point that is no obstacle (line 14)",
            "a pivot, which is no line (line 19)",
            "a spiral (line 20)",
            "a line string with a point that has no latitude C and longitude D (line 21)",
            "a guidance pattern without a line string (line 22)",
            "an A+ line without a heading G (line 23)",
        ]
    );
    // A and B, not the point between them.
    let line = Shape::Line {
        from: at(51.0, 7.0),
        to: at(51.001, 7.0),
    };
    assert_eq!(drawing.shapes[4].shape, line);
    // A+ leads 100 m east.
    let Shape::Line { from, to } = drawing.shapes[5].shape else {
        panic!()
    };
    let end = Frame::new(Origin {
        place: from,
        height: 0.0,
    })
    .local(to);
    assert!(
        (end.east - 100.0).abs() < 1e-6 && end.north.abs() < 1e-6,
        "{end:?}"
    );
}

#[test]
fn obstacles_are_holes_of_the_field_that_has_them() {
    let place = at(51.0, 7.0);
    let frame = Frame::new(Origin { place, height: 0.0 });
    let areas = mission::field::areas(&read(FIELD).unwrap(), &frame);
    assert_eq!(areas.len(), 1);
    let (name, area) = &areas[0];
    assert_eq!((name.as_str(), area.outer.len()), ("Home", 4));
    // The hole of its polygon and the pond.
    assert_eq!(area.holes.len(), 2);
    // 0.002 degrees of longitude by 0.001 of latitude: 140.4 m by 111.3 m, less the holes.
    assert!(
        (area.size() - 140.4 * 111.3).abs() < 100.0,
        "{}",
        area.size()
    );
    let far = FIELD.replace(
        "B=\"pond\">\n      <LSG A=\"1\"><PNT A=\"2\" C=\"51.0\" D=\"7.0\"/>",
        "B=\"pond\">\n      <LSG A=\"1\"><PNT A=\"2\" C=\"52.0\" D=\"7.0\"/>",
    );
    let far = far.replace(
        "<PNT A=\"2\" C=\"51.0\" D=\"7.0001\"/><PNT A=\"2\" C=\"51.0001\" D=\"7.0\"/>",
        "<PNT A=\"2\" C=\"52.0\" D=\"7.0001\"/><PNT A=\"2\" C=\"52.0001\" D=\"7.0\"/>",
    );
    let areas = mission::field::areas(&read(&far).unwrap(), &frame);
    assert_eq!(areas[0].1.holes.len(), 1);
}

#[test]
fn version_3_has_several_outer_rings_in_a_polygon() {
    let ring = |kind: u8, south: f64, size: f64| {
        format!(
            "<LSG A=\"{kind}\"><PNT C=\"{south}\" D=\"7\"/><PNT C=\"{south}\" D=\"{}\"/><PNT C=\"{}\" D=\"7\"/></LSG>",
            7.0 + size,
            south + size
        )
    };
    let text = format!(
        "<ISO11783_TaskData><PFD A=\"PFD1\"><PLN A=\"1\">{}{}{}{}</PLN></PFD></ISO11783_TaskData>",
        ring(1, 51.0, 0.1),
        ring(1, 52.0, 0.1),
        ring(2, 52.0, 0.02),
        ring(2, 53.0, 0.01)
    );
    let drawing = read(&text).unwrap();
    assert_eq!(
        outline(&drawing),
        [
            ("partfield 1 1", Role::Boundary, vec![3]),
            ("partfield 1 2", Role::Boundary, vec![3, 3]),
            // A hole in neither of them.
            ("partfield 1", Role::Obstacle, vec![3]),
        ]
    );
    assert!(drawing.skipped.is_empty(), "{:?}", drawing.skipped);
}

/// A line string, polygon or point with places in units of 10^-5 degrees from a corner of the field.
fn string(attributes: &str, places: &[(u32, u32)]) -> String {
    let point = |(north, east): &(u32, u32)| {
        let angle = |from: f64, steps: u32| from + 1e-5 * f64::from(steps);
        format!(
            "<PNT A=\"2\" C=\"{:.5}\" D=\"{:.5}\"/>",
            angle(51.0, *north),
            angle(7.0, *east)
        )
    };
    let points: String = places.iter().map(point).collect();
    format!("<LSG {attributes}>{points}</LSG>")
}

const EDGE: [(u32, u32); 4] = [(0, 0), (0, 200), (200, 200), (200, 0)];

fn partfield(name: &str, parts: &str) -> String {
    let edge = string("A=\"1\"", &EDGE);
    format!("<PFD A=\"PFD1\" C=\"{name}\"><PLN A=\"1\">{edge}</PLN>{parts}</PFD>")
}

fn task_data(parts: &str) -> String {
    format!("<ISO11783_TaskData>{parts}</ISO11783_TaskData>")
}

/// Terminals of CNH write each hole as a boundary of its own, and the ring of an obstacle with another type than that of an outer ring.
#[test]
fn holes_and_obstacles_stand_where_terminals_write_them() {
    let hole = string("A=\"2\"", &[(50, 50), (50, 60), (60, 60)]);
    let pond = string("A=\"9\"", &[(90, 90), (90, 99), (99, 99)]);
    let trees = string("A=\"1\"", &[(120, 120), (120, 130), (130, 130)]);
    let text = task_data(&partfield(
        "Home",
        &format!(
            "<PLN A=\"1\">{hole}</PLN><PLN A=\"6\" B=\"pond\">{pond}</PLN><PLN A=\"12\" B=\"trees\">{trees}</PLN>"
        ),
    ));
    let drawing = read(&text).unwrap();
    assert_eq!(
        outline(&drawing),
        [
            ("Home", Role::Boundary, vec![4, 3]),
            ("pond", Role::Obstacle, vec![3]),
            ("trees", Role::Obstacle, vec![3]),
        ]
    );
    assert!(drawing.skipped.is_empty(), "{:?}", drawing.skipped);
}

/// The obstacles of the drawing's only field in metres from its first corner.
fn obstacles(parts: &str) -> Vec<Vec<mission::place::Local>> {
    let drawing = read(&task_data(&partfield("Home", parts))).unwrap();
    let place = at(51.0, 7.0);
    let frame = Frame::new(Origin { place, height: 0.0 });
    assert!(
        drawing
            .shapes
            .iter()
            .all(|named| named.role != Role::Guidance)
    );
    mission::field::areas(&drawing, &frame)[0].1.holes.clone()
}

#[test]
fn lines_and_points_can_be_obstacles() {
    use mission::place::Local;
    let holds = |ring: &[Local], north: f64, east: f64| {
        mission::polygon::holds(ring, Local::new(north, east), 0.0)
    };
    // 1e-5 degrees are 1.1124 m north, and 0.7019 m east.
    let (step_north, step_east) = (1.1124, 0.7019);
    let point = "<PNT A=\"5\" B=\"pole\" C=\"51.001\" D=\"7.001\"/>";
    let [pole] = &obstacles(point)[..] else {
        panic!()
    };
    let (north, east) = (100.0 * step_north, 100.0 * step_east);
    for aside in [-0.45, 0.45] {
        assert!(holds(pole, north + aside, east) && holds(pole, north, east + aside));
    }
    assert!(!holds(pole, north + 0.55, east) && !holds(pole, north, east - 0.55));

    // A fence of no width is 1 m wide, and a hedge as wide as the file says.
    for (attributes, half) in [
        ("A=\"7\"", 0.5),
        ("A=\"7\" C=\"0\"", 0.5),
        ("A=\"9\" C=\"4000\"", 2.0),
    ] {
        let line = string(attributes, &[(50, 20), (50, 100), (90, 100)]);
        let [band] = &obstacles(&line)[..] else {
            panic!()
        };
        for east in [21.0, 60.0, 99.0] {
            let (north, east) = (50.0 * step_north, east * step_east);
            for aside in [-half + 0.05, half - 0.05] {
                assert!(holds(band, north + aside, east), "{north} {east} {aside}");
            }
            assert!(!holds(band, north - half - 0.05, east));
        }
    }

    // A fence round a yard leaves the yard free. It may stand in the boundary, and reach beyond the field.
    let round = [(20, 20), (20, 60), (60, 60), (60, 20), (20, 20)];
    let yard = obstacles(&string("A=\"7\"", &round));
    assert!(
        !yard
            .iter()
            .any(|band| holds(band, 40.0 * step_north, 40.0 * step_east))
    );
    for (north, east) in round {
        let at = (f64::from(north) * step_north, f64::from(east) * step_east);
        assert!(yard.iter().any(|band| holds(band, at.0, at.1)), "{at:?}");
    }
    let across = obstacles(&string("A=\"9\"", &[(100, 0), (100, 300)]));
    assert_eq!(across.len(), 1);
    // A line that is nearly straight has no corners that are the same one for a vehicle.
    let points = (0..30).map(|step| (100 + step % 2, 10 + 3 * step));
    let [nearly] = &obstacles(&string("A=\"9\"", &points.collect::<Vec<_>>()))[..] else {
        panic!()
    };
    let next = nearly.iter().cycle().skip(1);
    assert!(
        nearly
            .iter()
            .zip(next)
            .all(|(one, other)| one.distance(*other) > 0.01)
    );

    // A ditch may stand in the polygon of the boundary.
    let ditch = string("A=\"9\"", &[(100, 50), (100, 90)]);
    assert_eq!(obstacles(&format!("<PLN A=\"1\">{ditch}</PLN>")).len(), 1);

    // Rings of too few corners are points and lines.
    let thin = format!(
        "<PLN A=\"6\">{}</PLN><PLN A=\"1\">{}</PLN>",
        string("A=\"1\"", &[(50, 50), (50, 60), (50, 50)]),
        string("A=\"2\"", &[(90, 90)])
    );
    assert_eq!(obstacles(&thin).len(), 2);
}

#[test]
fn an_obstacle_without_a_place_is_refused() {
    let bad = "<PNT A=\"2\" C=\"51\"/>";
    for (obstacle, why) in [
        (
            format!("<LSG A=\"9\">{bad}</LSG>"),
            "an obstacle has a point that has no latitude",
        ),
        (
            "<PNT A=\"5\" C=\"51\"/>".into(),
            "an obstacle has a point that has no latitude",
        ),
        (
            format!("<PLN A=\"6\"><LSG A=\"9\">{bad}</LSG></PLN>"),
            "a polygon has a ring with a point",
        ),
        ("<PLN A=\"6\"/>".into(), "an obstacle has no ring"),
        (
            string("A=\"9\" C=\"wide\"", &[(10, 10), (20, 20)]),
            "an obstacle has a width that is no number of metres: more than 0 m",
        ),
        (string("A=\"9\"", &[]), "an obstacle has no place"),
        (
            string("A=\"9\"", &[(10, 10), (20_000, 20)]),
            "an obstacle reaches farther than 10 km: several shorter ones are accepted",
        ),
        (
            string("A=\"9\" C=\"4e9\"", &[(10, 10), (20, 20)]),
            "an obstacle is 4000000 m wide: more than 0 m and up to 100 m are accepted",
        ),
    ] {
        let refused = read(&task_data(&partfield("Home", &obstacle))).unwrap_err();
        assert!(refused.to_string().contains(why), "{refused}");
    }
}

/// An island in a hole, a pond on the edge between two parts, and a hole of the main field.
#[test]
fn a_hole_is_one_of_each_boundary_that_it_reaches_into() {
    let square = |kind: u32, from: u32, to: u32| {
        string(
            &format!("A=\"{kind}\""),
            &[(from, from), (from, to), (to, to), (to, from)],
        )
    };
    let polygon =
        |kind: u32, rings: &[String]| format!("<PLN A=\"{kind}\">{}</PLN>", rings.concat());
    let holes = |polygons: &[String]| {
        let text = format!("<PFD A=\"PFD1\" C=\"Home\">{}</PFD>", polygons.concat());
        let drawing = read(&task_data(&text)).unwrap();
        let place = at(51.0, 7.0);
        let frame = Frame::new(Origin { place, height: 0.0 });
        let areas = mission::field::areas(&drawing, &frame);
        let counts = areas
            .iter()
            .map(|(name, area)| (name.clone(), area.holes.len()));
        counts.collect::<Vec<_>>()
    };
    let island = [
        polygon(1, &[square(1, 0, 300), square(2, 80, 220)]),
        polygon(1, &[square(1, 90, 210), square(2, 140, 160)]),
    ];
    assert_eq!(holes(&island)[1], ("Home 2".into(), 2));
    let pond = string("A=\"2\"", &[(50, 180), (50, 220), (60, 220), (60, 180)]);
    let east = string("A=\"1\"", &[(0, 200), (0, 400), (200, 400), (200, 200)]);
    let parts = [polygon(1, &[square(1, 0, 200), east, pond])];
    assert_eq!(holes(&parts), [("Home 1".into(), 1), ("Home 2".into(), 1)]);
    let main = [
        polygon(1, &[square(1, 0, 200)]),
        polygon(9, &[square(1, 10, 190), square(2, 50, 70)]),
    ];
    assert_eq!(holes(&main), [("Home".into(), 1)]);
    assert_eq!(holes(&main[1..]), [("Home".into(), 1)]);
}

#[test]
fn fields_have_names_and_lines_of_their_own() {
    let line = string("A=\"5\" B=\"A-B\"", &[(10, 10), (100, 10)]);
    let two = [partfield("Home", &line), partfield("Home", "")].concat();
    let drawing = read(&task_data(&two)).unwrap();
    let fields = drawing.shapes.iter();
    let fields: Vec<_> = fields
        .map(|named| (named.name.as_str(), named.field.as_deref().unwrap()))
        .collect();
    assert_eq!(
        fields,
        [("Home", "Home"), ("A-B", "Home"), ("Home (2)", "Home (2)")]
    );
    // A part of a field is not called as another field is.
    let second = string("A=\"1\"", &[(300, 0), (300, 200), (500, 200)]);
    let parts = partfield("Home", &format!("<PLN A=\"1\">{second}</PLN>"));
    let drawing = read(&task_data(&(parts + &partfield("Home 1", "")))).unwrap();
    let names: Vec<&str> = drawing
        .shapes
        .iter()
        .map(|named| named.name.as_str())
        .collect();
    assert_eq!(names, ["Home 1 (2)", "Home 2", "Home 1"]);
}

/// The frame's plane has a place at the other end of the earth where its origin is.
#[test]
fn obstacles_far_away_are_none_of_the_field() {
    let field = |name: &str, south: f64, west: f64| {
        let corner = |north: f64, east: f64| {
            format!(
                "<PNT A=\"2\" C=\"{:.5}\" D=\"{:.5}\"/>",
                south + north,
                west + east
            )
        };
        let ring = |size: f64| {
            [
                corner(0.0, 0.0),
                corner(0.0, size),
                corner(size, size),
                corner(size, 0.0),
            ]
            .concat()
        };
        format!(
            "<PFD A=\"PFD1\" C=\"{name}\"><PLN A=\"1\"><LSG A=\"1\">{}</LSG></PLN><PLN A=\"6\"><LSG A=\"1\">{}</LSG></PLN></PFD>",
            ring(0.002),
            ring(0.001)
        )
    };
    // The third ends at the date line, and the obstacle of the fourth begins at it.
    let fields = [
        field("here", 51.0, 7.0),
        field("there", -51.002, -173.001),
        field("west", 10.0, 179.998),
        field("east", 10.0, -180.0),
    ];
    let drawing = read(&task_data(&fields.concat())).unwrap();
    let holes = |latitude: f64, longitude: f64, index: usize| {
        let place = at(latitude, longitude);
        let frame = Frame::new(Origin { place, height: 0.0 });
        mission::field::areas(&drawing, &frame)[index].1.holes.len()
    };
    assert_eq!(holes(51.0, 7.0, 0), 1);
    assert_eq!(holes(10.0, 179.998, 2), 2);
}

/// A terminal may keep what stands in a field apart from it.
#[test]
fn obstacles_of_one_partfield_stand_in_others() {
    let pond = string("A=\"1\"", &[(90, 90), (90, 99), (99, 99)]);
    let apart = format!("<PFD A=\"PFD2\" C=\"ponds\"><PLN A=\"3\">{pond}</PLN></PFD>");
    let drawing = read(&task_data(&(partfield("Home", "") + &apart))).unwrap();
    let place = at(51.0, 7.0);
    let frame = Frame::new(Origin { place, height: 0.0 });
    assert_eq!(mission::field::areas(&drawing, &frame)[0].1.holes.len(), 1);
}

/// Programs compute the size in different planes and count holes in or out; a corner that is missing makes more.
#[test]
fn a_field_of_another_size_than_the_file_says_is_told() {
    let hole = string("A=\"2\"", &[(20, 20), (20, 120), (120, 120), (120, 20)]);
    let text = partfield("Home", &format!("<PLN A=\"1\">{hole}</PLN>"));
    let notes = |size: u32| {
        let text = text.replace("C=\"Home\"", &format!("C=\"Home\" D=\"{size}\""));
        read(&task_data(&text)).unwrap().notes
    };
    // 222.48 m by 140.38 m, and a quarter of that.
    for fitting in [31_232, 31_700, 23_424, 0] {
        assert_eq!(notes(fitting), [""; 0], "{fitting}");
    }
    let [note] = &notes(27_000)[..] else { panic!() };
    let (_, encloses) = note
        .split_once("\"Home\" has 27000 m2, and its boundary encloses ")
        .unwrap();
    let size: f64 = encloses.trim_end_matches(" m2").parse().unwrap();
    assert!((size - 31_232.0).abs() < 10.0, "{note}");
}

#[test]
fn a_part_file_has_its_own_root() {
    let (_, field) = FIELD.split_once("<PFD").unwrap();
    let part = format!(
        "<XFC><PFD{}",
        field.replace("</ISO11783_TaskData>", "</XFC>")
    );
    assert_eq!(read(&part).unwrap().shapes.len(), 7);
    let whole = "<ISO11783_TaskData><XFR A=\"CTR00000\"/><XFR A=\"PFD00001\"/></ISO11783_TaskData>";
    let load = |name: &str| (name == "PFD00001").then(|| part.clone());
    let drawing = read_parts(whole, &load).unwrap();
    assert_eq!(drawing.shapes, read(&part).unwrap().shapes);
    let broken = read_parts(whole, &|_| Some("<kml/>".to_owned()))
        .unwrap_err()
        .to_string();
    assert!(
        broken.contains("the part file PFD00001.XML: its outermost element is kml"),
        "{broken}"
    );
}

#[test]
fn hopeless_files_are_refused_in_a_sentence() {
    let refused = |text: &str| read(text).unwrap_err().to_string();
    assert!(refused("<a>\n<b></a>").starts_with("line 2: it is not XML: "));
    assert_eq!(
        refused("<kml/>"),
        "its outermost element is kml: ISO11783_TaskData (or XFC of a part file) is accepted"
    );
    assert_eq!(
        refused("<ISO11783_TaskData><XFR A=\"PFD00001\" B=\"1\"/></ISO11783_TaskData>"),
        "there is no line, curve or boundary in this ISOXML file; left out: the part file PFD00001.XML, which is not beside \
         it (line 1)"
    );
}

/// Without one of its rings a field would be another one, or lose an obstacle. A ring that is none of the two is left out.
#[test]
fn a_polygon_is_read_whole_or_not_at_all() {
    let field = |kind: u32, string: u32, ring: u32| {
        let ring_of = |side: f64, bad: bool| {
            let corners = [(0.0, 0.0), (side, 0.0), (side, side)];
            let points = corners.map(|(north, east)| {
                format!("<PNT A=\"2\" C=\"{}\" D=\"{}\"/>", 51.0 + north, 7.0 + east)
            });
            let bad = if bad { "<PNT A=\"2\" C=\"51\"/>" } else { "" };
            points.concat() + bad
        };
        format!(
            "<ISO11783_TaskData><PFD A=\"PFD1\"><PLN A=\"1\"><LSG A=\"1\">{}</LSG></PLN><PLN A=\"{kind}\"><LSG A=\"1\">{}</LSG><LSG \
             A=\"{string}\">{}</LSG></PLN></PFD></ISO11783_TaskData>",
            ring_of(0.002, false),
            ring_of(0.001, ring == 0),
            ring_of(0.0005, ring == 1),
        )
    };
    for (kind, string, ring) in [(1, 2, 0), (1, 2, 1), (6, 2, 0)] {
        let refused = read(&field(kind, string, ring)).unwrap_err().to_string();
        assert_eq!(
            refused,
            "a polygon has a ring with a point that has no latitude C and longitude D (line 1)"
        );
    }
    assert!(read(&field(2, 2, 1)).is_ok());
    assert!(read(&field(1, 2, 2)).is_ok());
}
