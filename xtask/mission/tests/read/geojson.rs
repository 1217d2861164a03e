use mission::read::geojson::read;
use mission::read::{Role, Shape};

use super::{at, outline, skipped};

/// A field as QGIS writes it, with what else is in such files.
pub(super) const FIELD: &str = r#"{
  "type": "FeatureCollection",
  "name": "export",
  "crs": { "type": "name", "properties": { "name": "urn:ogc:def:crs:OGC:1.3:CRS84" } },
  "features": [
    { "type": "Feature", "properties": { "fid": 1, "Name": "Home field" }, "geometry": { "type": "Polygon", "coordinates": [
      [[7.0, 51.0], [7.002, 51.0], [7.002, 51.001], [7.0, 51.001], [7.0, 51.0]],
      [[7.001, 51.0003], [7.0011, 51.0003], [7.0011, 51.0004], [7.001, 51.0003]]
    ] } },
    { "type": "Feature", "properties": { "name": "A-B" }, "geometry": { "type": "LineString", "coordinates": [[7.0, 51.0, 88.5], [7.0, 51.001, 88.0]] } },
    { "type": "Feature", "id": 7, "properties": null, "geometry": { "type": "MultiLineString", "coordinates": [
      [[7.0, 51.0], [7.0001, 51.0005], [7.0001, 51.0005], [7.0, 51.001]], [[7.0, 51.0]]
    ] } },
    { "type": "Feature", "properties": {}, "geometry": { "type": "MultiPolygon", "coordinates": [
      [[[7.0, 51.0], [7.1, 51.0], [7.1, 51.1], [7.0, 51.0]]], [[[8.0, 51.0], [8.1, 51.0], [8.0, 51.0]]]
    ] } },
    { "type": "Feature", "properties": {}, "geometry": null },
    { "type": "Feature", "properties": {}, "geometry": { "type": "Point", "coordinates": [7.0, 51.0] } },
    { "type": "Feature", "properties": {}, "geometry": { "type": "LineString", "coordinates": [[412000.0, 5650000.0], [412100.0, 5650000.0]] } },
    { "type": "Feature", "properties": {}, "geometry": { "type": "Circle", "coordinates": [7.0, 51.0] } }
  ]
}"#;

#[test]
fn a_collection_of_features() {
    let drawing = read(FIELD).unwrap();
    assert_eq!(
        outline(&drawing),
        [
            ("Home field", Role::Boundary, vec![4, 3]),
            ("A-B", Role::Guidance, vec![2]),
            ("7", Role::Guidance, vec![3]),
            ("boundary 4", Role::Boundary, vec![3]),
        ]
    );
    assert_eq!(
        drawing.shapes[1].shape,
        Shape::Line {
            from: at(51.0, 7.0),
            to: at(51.001, 7.0)
        }
    );
    assert_eq!(
        skipped(&drawing),
        [
            "a line of fewer than two places",
            "an area of fewer than three corners",
            "a feature without a geometry",
            "a point that is no obstacle",
            "a shape whose coordinates are not longitude and latitude in degrees: latitude 5650000, longitude 412000 is no \
             place of the earth, -90 to 90 and -180 to 180 degrees are accepted",
            "a geometry that is not one of RFC 7946",
        ]
    );
}

#[test]
fn geometries_alone_and_in_a_collection() {
    let line = r#"{"type":"LineString","coordinates":[[7,51],[7,52]]}"#;
    assert_eq!(
        outline(&read(line).unwrap()),
        [("line 1", Role::Guidance, vec![2])]
    );
    let two = format!(r#"{{"type":"GeometryCollection","geometries":[{line},{line}]}}"#);
    assert_eq!(read(&two).unwrap().shapes.len(), 2);
    let feature =
        format!(r#"{{"type":"Feature","properties":{{"label":" x "}},"geometry":{line}}}"#);
    assert_eq!(read(&feature).unwrap().shapes[0].name, "x");
}

const POLYGON: &str =
    r#"{"type":"Polygon","coordinates":[[[7,51],[7.001,51],[7.001,51.001],[7,51]]]}"#;
const LINE: &str = r#"{"type":"LineString","coordinates":[[7,51],[7,51.001]]}"#;
const POINTS: &str = r#"{"type":"MultiPoint","coordinates":[[7,51],[7,51.001]]}"#;

fn feature(properties: &str, geometry: &str) -> String {
    format!(r#"{{"type":"Feature","properties":{{{properties}}},"geometry":{geometry}}}"#)
}

fn all(features: &[String]) -> Result<mission::read::Drawing, mission::read::ReadError> {
    let features = features.join(",");
    read(&format!(
        r#"{{"type":"FeatureCollection","features":[{features}]}}"#
    ))
}

#[test]
fn features_can_be_obstacles() {
    let drawing = all(&[
        feature(r#""name":"field","obstacle":false"#, POLYGON),
        feature(r#""name":"pond","Obstacle":true"#, POLYGON),
        feature(r#""name":"wall","kind":"obstacle","width":0.4"#, LINE),
        feature(r#""name":"trees","type":"Obstacle""#, POINTS),
        feature(r#""name":"way","kind":"track""#, LINE),
    ])
    .unwrap();
    assert_eq!(
        outline(&drawing),
        [
            ("field", Role::Boundary, vec![3]),
            ("pond", Role::Obstacle, vec![3]),
            ("wall", Role::Obstacle, vec![4]),
            ("trees", Role::Obstacle, vec![4]),
            ("trees", Role::Obstacle, vec![4]),
            ("way", Role::Guidance, vec![2]),
        ]
    );
    // The points have no width.
    let note = r#"the obstacle "trees" is a point or a line without a width: it is made 1 m wide"#;
    assert_eq!(drawing.notes, [note, note]);
}

#[test]
fn what_is_not_said_to_be_no_obstacle_is_one() {
    for (properties, is) in [
        (r#""obstacle":"yes""#, true),
        (r#""obstacle":"tree""#, true),
        (r#""obstacle":2"#, true),
        (r#""Obstacle":false,"obstacle":true"#, true),
        (r#""kind":" Obstacles ""#, true),
        (r#""obstacle":" no ""#, false),
        (r#""obstacle":0"#, false),
        (r#""obstacle":null"#, false),
    ] {
        let role = all(&[feature(properties, LINE)]).unwrap().shapes[0].role;
        assert_eq!(role == Role::Obstacle, is, "{properties}");
    }
    let beside = format!(r#"{{"type":"Feature","obstacle":true,"geometry":{LINE}}}"#);
    assert_eq!(all(&[beside]).unwrap().shapes[0].role, Role::Obstacle);
}

#[test]
fn an_obstacle_that_cannot_be_placed_is_refused() {
    let nothing = r#"{"type":"GeometryCollection","geometries":[]}"#;
    let round = r#"{"type":"LineString","coordinates":[[7,51],[-173,-51]]}"#;
    for (properties, geometry, why) in [
        ("", "null", "an obstacle has no geometry"),
        ("", nothing, "an obstacle has no place"),
        (
            "",
            r#"{"type":"LineString","coordinates":[]}"#,
            "an obstacle has no place",
        ),
        (
            "",
            r#"{"type":"Circle"}"#,
            "an obstacle has a geometry that is not one of RFC 7946",
        ),
        (
            "",
            r#"{"type":"Point","coordinates":[412000,5650000]}"#,
            "it has an obstacle whose coordinates",
        ),
        (
            r#","width":"wide""#,
            LINE,
            "an obstacle has a width that is no number of metres",
        ),
        (r#","width":-3"#, LINE, "an obstacle is -3 m wide"),
        ("", round, "an obstacle reaches farther than 10 km"),
    ] {
        let features = [
            feature("", POLYGON),
            feature(&format!(r#""obstacle":1{properties}"#), geometry),
        ];
        let refused = all(&features).unwrap_err().to_string();
        assert!(refused.starts_with(why), "{refused}");
    }
    // One across the date line is not far.
    let across = r#"{"type":"LineString","coordinates":[[179.9995,10],[-179.9995,10]]}"#;
    assert!(all(&[feature(r#""obstacle":true"#, across)]).is_ok());
    // The line is 5 m longer, as it leads north: 0.001 degrees and half the width at either end.
    let wide = all(&[feature(r#""obstacle":true,"width":"5 m""#, LINE)]).unwrap();
    let Shape::Polygon { outer, .. } = &wide.shapes[0].shape else {
        panic!()
    };
    let latitudes = outer.iter().map(|corner| corner.latitude);
    let north = latitudes.fold(0.0, f64::max);
    assert!(((north - 51.001) * 111_240.0 - 2.5).abs() < 0.01, "{north}");
}

#[test]
fn other_coordinate_systems_are_refused_wherever_they_are_named() {
    let line = r#"{"type":"LineString","coordinates":[[7,51],[7,52]]}"#;
    for (crs, why) in [
        (r#"{"type":"EPSG","properties":{"code":4267}}"#, "EPSG:4267"),
        (
            r#"{"type":"link","properties":{"href":"x"}}"#,
            "a coordinate system that it does not name",
        ),
        (r#""EPSG:25832""#, "EPSG:25832"),
    ] {
        let inside = line.replace("\"type\"", &format!("\"crs\":{crs},\"type\""));
        for text in [
            inside.clone(),
            format!(
                r#"{{"type":"FeatureCollection","crs":{crs},"features":[{{"type":"Feature","geometry":{line}}}]}}"#
            ),
            format!(r#"{{"type":"Feature","geometry":{inside}}}"#),
        ] {
            let refused = read(&text).unwrap_err().to_string();
            assert!(
                refused.starts_with(&format!("its coordinates are in {why}: ")),
                "{refused}"
            );
        }
    }
    for crs in [
        r#""EPSG:4326 ""#,
        r#"{"properties":{"name":"WGS84"}}"#,
        r#"{"properties":{"code":4326}}"#,
        "null",
    ] {
        let text = line.replace("\"type\"", &format!("\"crs\":{crs},\"type\""));
        assert!(read(&text).is_ok(), "{crs}");
    }
}

#[test]
fn thousands_of_equal_names_are_told_apart_at_once() {
    let one = r#"{"type":"Feature","properties":{"name":"Acker"},"geometry":{"type":"Polygon","coordinates":[[[7,51],[7.001,51],[7.001,51.001],[7,51]]]}}"#;
    let text = format!(
        r#"{{"type":"FeatureCollection","features":[{}]}}"#,
        vec![one; 20_000].join(",")
    );
    let drawing = read(&text).unwrap();
    let names: std::collections::HashSet<&str> = drawing
        .shapes
        .iter()
        .map(|named| named.name.as_str())
        .collect();
    assert_eq!(names.len(), 20_000);
    assert_eq!(drawing.shapes[19_999].name, "Acker (20000)");
}

#[test]
fn interchanged_coordinates_are_told() {
    let file = r#"{"type":"Feature","properties":{"name":"A"},"geometry":{"type":"LineString","coordinates":[[40.83,-96.66],[40.84,-96.66]]}}"#;
    assert_eq!(
        read(file).unwrap_err().to_string(),
        "there is no line, curve or boundary in this GeoJSON file; left out: a shape \"A\" whose coordinates are not longitude \
         and latitude in degrees: latitude -96.66, longitude 40.83 is no place of the earth, -90 to 90 and -180 to 180 degrees \
         are accepted; they may be interchanged"
    );
}

/// `--field` takes one of them by its name.
#[test]
fn the_parts_of_a_multipolygon_have_names_of_their_own() {
    let ring = |west: u8| format!("[[[{west},51],[{west}.1,51],[{west}.1,51.1],[{west},51]]]");
    let read_of = |rings: &[String]| {
        let rings = rings.join(",");
        read(&format!(
            r#"{{"type":"Feature","properties":{{"name":"M"}},"geometry":{{"type":"MultiPolygon","coordinates":[{rings}]}}}}"#
        ))
        .unwrap()
    };
    let names = |rings: &[String]| -> Vec<String> {
        let shapes = read_of(rings).shapes;
        shapes.into_iter().map(|named| named.name).collect()
    };
    assert_eq!(names(&[ring(7), ring(8)]), ["M 1", "M 2"]);
    assert_eq!(names(&[ring(7)]), ["M"]);
}

#[test]
fn hopeless_files_are_refused_in_a_sentence() {
    for (text, sentence) in [
        ("{\n\"type\":", "line 2: it is not JSON: "),
        (
            "[]",
            "it is JSON, but no GeoJSON: its outermost object has no \"type\"",
        ),
        (
            r#"{"type":"FeatureCollection"}"#,
            "its FeatureCollection has no list \"features\"",
        ),
        (
            r#"{"type":"FeatureCollection","features":[],"crs":{"type":"name","properties":{"name":"urn:ogc:def:crs:EPSG::25832"}}}"#,
            "its coordinates are in urn:ogc:def:crs:EPSG::25832: export it as WGS 84 (EPSG:4326)",
        ),
        (
            r#"{"type":"FeatureCollection","features":[{"type":"Feature","geometry":null,"properties":null}]}"#,
            "there is no line, curve or boundary in this GeoJSON file; left out: a feature without a geometry",
        ),
    ] {
        let error = read(text).unwrap_err().to_string();
        assert!(error.starts_with(sentence), "{text}: {error}");
    }
}
