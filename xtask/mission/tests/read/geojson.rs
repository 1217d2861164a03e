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

#[test]
fn features_can_be_obstacles() {
    let feature = |properties: &str, geometry: &str| {
        format!(r#"{{"type":"Feature","properties":{{{properties}}},"geometry":{geometry}}}"#)
    };
    let polygon = r#"{"type":"Polygon","coordinates":[[[7,51],[7.001,51],[7.001,51.001],[7,51]]]}"#;
    let line = r#"{"type":"LineString","coordinates":[[7,51],[7,51.001]]}"#;
    let point = r#"{"type":"MultiPoint","coordinates":[[7,51],[7,51.001]]}"#;
    let all = |features: &[String]| {
        let features = features.join(",");
        read(&format!(
            r#"{{"type":"FeatureCollection","features":[{features}]}}"#
        ))
    };
    let drawing = all(&[
        feature(r#""name":"field","obstacle":false"#, polygon),
        feature(r#""name":"pond","Obstacle":true"#, polygon),
        feature(r#""name":"wall","kind":"obstacle","width":0.4"#, line),
        feature(r#""name":"trees","type":"Obstacle""#, point),
        feature(r#""name":"way","kind":"track""#, line),
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
    for (geometry, why) in [
        ("null", "an obstacle has no geometry"),
        (
            r#"{"type":"Circle"}"#,
            "an obstacle has a geometry that is not one of RFC 7946",
        ),
        (
            r#"{"type":"Point","coordinates":[412000,5650000]}"#,
            "it has an obstacle whose coordinates",
        ),
    ] {
        let features = [feature("", polygon), feature(r#""obstacle":1"#, geometry)];
        let refused = all(&features).unwrap_err().to_string();
        assert!(refused.starts_with(why), "{refused}");
    }
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
