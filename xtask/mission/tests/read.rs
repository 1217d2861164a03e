//! The readers of other tools' files. The files are made up here after the formats' sources, which the modules name. The
//! fuzz targets with random bytes are here too.

#[path = "../fuzz/src/lib.rs"]
#[expect(unreachable_pub, dead_code, reason = "a library of its own in `fuzz/`")]
mod fuzz;

#[path = "read/agopengps.rs"]
mod agopengps;
#[path = "read/csv.rs"]
mod csv;
#[path = "read/geojson.rs"]
mod geojson;
#[path = "read/isoxml.rs"]
mod isoxml;

use mission::place::Geodetic;
use mission::read::{Drawing, Role, Shape};
use proptest::prelude::*;

/// A place from degrees.
fn at(latitude: f64, longitude: f64) -> Geodetic {
    Geodetic {
        latitude,
        longitude,
    }
}

/// Names, roles and numbers of points or corners with those of the holes.
fn outline(drawing: &Drawing) -> Vec<(&str, Role, Vec<usize>)> {
    let counts = |shape: &Shape| match shape {
        Shape::Line { .. } => vec![2],
        Shape::Curve(places) => vec![places.len()],
        Shape::Polygon { outer, holes } => {
            std::iter::once(outer).chain(holes).map(Vec::len).collect()
        }
    };
    let shapes = drawing.shapes.iter();
    shapes
        .map(|named| (named.name.as_str(), named.role, counts(&named.shape)))
        .collect()
}

/// What was left out, as people read it.
fn skipped(drawing: &Drawing) -> Vec<String> {
    drawing.skipped.iter().map(ToString::to_string).collect()
}

/// A text with some of its bytes changed.
fn damaged(text: &str) -> impl Strategy<Value = Vec<u8>> + use<> {
    let bytes = text.as_bytes().to_vec();
    let change = (
        any::<prop::sample::Index>(),
        prop_oneof![
            any::<u8>(),
            proptest::sample::select(b"0123456789,.-<>\"[]{}\n\t;\0".to_vec())
        ],
    );
    (
        prop::collection::vec(change, 0..12),
        any::<prop::sample::Index>(),
        any::<bool>(),
    )
        .prop_map(move |(changes, cut, cuts)| {
            let mut bytes = bytes.clone();
            for (place, byte) in changes {
                let place = place.index(bytes.len());
                bytes[place] = byte;
            }
            if cuts {
                bytes.truncate(cut.index(bytes.len()));
            }
            bytes
        })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn no_bytes_break_a_reader(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
        fuzz::plan(&bytes);
        fuzz::geojson(&bytes);
        fuzz::csv(&bytes);
        fuzz::agopengps(&bytes);
        fuzz::isoxml(&bytes);
    }

    #[test]
    fn no_damage_breaks_a_reader(
        geojson in damaged(geojson::FIELD), csv in damaged(csv::DEGREES), isoxml in damaged(isoxml::FIELD),
        agopengps in damaged(&agopengps::all()),
    ) {
        fuzz::geojson(&geojson);
        fuzz::csv(&csv);
        fuzz::isoxml(&isoxml);
        fuzz::agopengps(&agopengps);
    }
}

#[test]
fn undamaged_files_are_read() {
    assert!(fuzz::geojson(geojson::FIELD.as_bytes()).is_some());
    assert!(fuzz::csv(csv::DEGREES.as_bytes()).is_some());
    assert!(fuzz::isoxml(isoxml::FIELD.as_bytes()).is_some());
    assert!(fuzz::agopengps(agopengps::all().as_bytes()).is_some());
}

#[test]
fn a_path_tells_its_format() {
    use mission::read::path;
    let folder = tempfile::tempdir().unwrap();
    let save = |name: &str, text: &str| {
        let file = folder.path().join(name);
        std::fs::write(&file, text).unwrap();
        file
    };
    let format = |file: &std::path::Path| path(file, None).map(|drawing| drawing.format);
    assert_eq!(format(&save("a.GeoJSON", geojson::FIELD)), Ok("GeoJSON"));
    assert_eq!(format(&save("a.csv", csv::DEGREES)), Ok("CSV"));
    assert_eq!(format(&save("a.xml", isoxml::FIELD)), Ok("ISOXML"));
    let refused = |file: &std::path::Path| path(file, None).unwrap_err().to_string();
    assert!(
        refused(folder.path())
            .ends_with("it has no Field.txt, which the folder of an AgOpenGPS field has")
    );
    assert!(
        refused(&save("a.kml", "")).contains("the ending of its name tells no format: .geojson")
    );
    assert!(refused(&folder.path().join("b.csv")).contains("b.csv cannot be read: "));
    save("Field.txt", agopengps::FIELD);
    save("Boundary.txt", agopengps::BOUNDARY);
    assert_eq!(format(folder.path()), Ok("AgOpenGPS"));
    save("TaskData.xml", isoxml::FIELD);
    let skipped = path(folder.path(), None).unwrap().skipped;
    assert_eq!(
        skipped[0].to_string(),
        "the part file PFD00001.XML, which is not beside it (line 3)"
    );
    // A part file is found from the folder and from the file beside it.
    let part = r#"<XFC><PFD A="PFD2" C="Part">
        <PLN A="1"><LSG A="1"><PNT C="51" D="7"/><PNT C="51" D="7.1"/><PNT C="51.1" D="7"/></LSG></PLN></PFD></XFC>"#;
    save("PFD00001.XML", part);
    for from in [folder.path().to_owned(), folder.path().join("TaskData.xml")] {
        let drawing = path(&from, None).unwrap();
        assert_eq!(drawing.shapes[0].name, "Part", "{from:?}");
    }
    save("PFD00001.XML", "<XFC/>");
    let skipped = path(folder.path(), None).unwrap().skipped;
    assert_eq!(
        skipped[0].to_string(),
        "a point that is no obstacle (line 14)"
    );
}
