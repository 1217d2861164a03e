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
            ("tram", Role::Other, vec![2]),
            ("free", Role::Guidance, vec![2]),
            ("A-B", Role::Guidance, vec![2]),
            ("group", Role::Guidance, vec![2]),
            ("bend", Role::Guidance, vec![3]),
        ]
    );
    assert_eq!(
        skipped(&drawing),
        [
            "the part file PFD00001.XML: read it by itself (line 3)",
            "a point: lines and polygons are read (line 14)",
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
            ("boundary 1", Role::Boundary, vec![3]),
            ("boundary 2", Role::Boundary, vec![3, 3])
        ]
    );
    assert_eq!(
        skipped(&drawing),
        ["a hole that is in no outer ring (line 1)"]
    );
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
        "there is no line, curve or boundary in this ISOXML file; left out: the part file PFD00001.XML: read it by itself \
         (line 1)"
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
