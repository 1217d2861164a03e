//! GeoJSON (RFC 7946): lines and polygons, alone, in features, collections and collections of features.
//!
//! Coordinates are longitude, latitude in WGS 84 (section 4). Older files can name another system by `crs`; such a file is
//! refused, because its numbers would be read wrong. A feature's name is its property `name`, `title`, `label` or `designator` in any case,
//! else its `id`. Polygons are boundaries, lines guidance. Points and heights are left out.

use ::geojson::{Geometry, GeometryValue, Position};
use serde_json::Value;

use super::{Drawing, ReadError, Role, no_place};
use crate::place::Geodetic;

/// Reads the text of a file.
///
/// # Errors
/// [`ReadError`] if it is not GeoJSON, is in another coordinate system, or has nothing that can be used.
pub fn read(text: &str) -> Result<Drawing, ReadError> {
    let value: Value = serde_json::from_str(text).map_err(|error| {
        ReadError::new(format!("line {}: it is not JSON: {error}", error.line()))
    })?;
    if let Some(system) = foreign_system(&value) {
        return Err(ReadError::new(format!(
            "its coordinates are in {system}: export it as WGS 84 (EPSG:4326)"
        )));
    }
    let mut drawing = Drawing::new("GeoJSON");
    match value.get("type").and_then(Value::as_str) {
        Some("FeatureCollection") => {
            let Some(features) = value.get("features").and_then(Value::as_array) else {
                return Err(ReadError::new(
                    "its FeatureCollection has no list \"features\"",
                ));
            };
            for feature in features {
                read_feature(&mut drawing, feature);
            }
        }
        Some("Feature") => read_feature(&mut drawing, &value),
        Some(_) => read_geometry(&mut drawing, None, &value),
        None => {
            return Err(ReadError::new(
                "it is JSON, but no GeoJSON: its outermost object has no \"type\"",
            ));
        }
    }
    drawing.finish()
}

/// The coordinate system that a file of before RFC 7946 names, if it is not WGS 84.
fn foreign_system(value: &Value) -> Option<&str> {
    let crs = value.get("crs")?;
    let name = crs.pointer("/properties/name")?.as_str()?;
    let known = name.ends_with("CRS84") || name.ends_with(":4326");
    (!known).then_some(name)
}

fn read_feature(drawing: &mut Drawing, feature: &Value) {
    let name = feature_name(feature);
    match feature.get("geometry") {
        None | Some(Value::Null) => drawing.skip("a feature without a geometry", None),
        Some(geometry) => read_geometry(drawing, name.as_deref(), geometry),
    }
}

fn feature_name(feature: &Value) -> Option<String> {
    let words = |value: &Value| match value {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    };
    let properties = feature.get("properties").and_then(Value::as_object);
    let named = ["name", "title", "label", "designator"]
        .iter()
        .find_map(|known| {
            let mut properties = properties?.iter();
            let (_, value) = properties.find(|(key, _)| key.eq_ignore_ascii_case(known))?;
            words(value).filter(|name| !name.trim().is_empty())
        });
    named.or_else(|| feature.get("id").and_then(words))
}

fn read_geometry(drawing: &mut Drawing, name: Option<&str>, geometry: &Value) {
    match serde_json::from_value::<Geometry>(geometry.clone()) {
        Ok(geometry) => add(drawing, name, geometry.value),
        Err(_) => drawing.skip("a geometry that is not one of RFC 7946", None),
    }
}

fn add(drawing: &mut Drawing, name: Option<&str>, geometry: GeometryValue) {
    match geometry {
        GeometryValue::LineString { coordinates } => line(drawing, name, &coordinates),
        GeometryValue::MultiLineString { coordinates } => {
            for coordinates in coordinates {
                line(drawing, name, &coordinates);
            }
        }
        GeometryValue::Polygon { coordinates } => polygon(drawing, name, &coordinates),
        GeometryValue::MultiPolygon { coordinates } => {
            // Whoever asks for one by its name must be able to tell them apart.
            let several = coordinates.len() > 1;
            for (number, coordinates) in (1..).zip(coordinates) {
                let part = name
                    .filter(|_| several)
                    .map(|name| format!("{name} {number}"));
                polygon(drawing, part.as_deref().or(name), &coordinates);
            }
        }
        GeometryValue::GeometryCollection { geometries } => {
            for geometry in geometries {
                add(drawing, name, geometry.value);
            }
        }
        GeometryValue::Point { .. } | GeometryValue::MultiPoint { .. } => {
            drawing.skip("a point: lines and polygons are read", None);
        }
    }
}

/// Places of positions.
///
/// # Errors
/// One of them is not on the earth.
fn places(positions: &[Position]) -> Result<Vec<Geodetic>, String> {
    let place = |position: &Position| match position.as_slice() {
        [longitude, latitude, ..] => {
            Geodetic::checked(*latitude, *longitude).ok_or_else(|| no_place(*latitude, *longitude))
        }
        _ => Err("a position of fewer than two numbers".into()),
    };
    positions.iter().map(place).collect()
}

/// A shape of which a position is not on the earth.
fn unplaced(drawing: &mut Drawing, name: Option<&str>, why: &str) {
    let named = name.map_or_else(String::new, |name| format!(" {name:?}"));
    drawing.skip(
        format!(
            "a shape{named} whose coordinates are not longitude and latitude in degrees: {why}"
        ),
        None,
    );
}

fn line(drawing: &mut Drawing, name: Option<&str>, positions: &[Position]) {
    match places(positions) {
        Ok(places) => drawing.add_line(name, Role::Guidance, places),
        Err(why) => unplaced(drawing, name, &why),
    }
}

fn polygon(drawing: &mut Drawing, name: Option<&str>, rings: &[Vec<Position>]) {
    let rings: Result<Vec<_>, String> = rings.iter().map(|ring| places(ring)).collect();
    match rings {
        Err(why) => unplaced(drawing, name, &why),
        Ok(mut rings) if !rings.is_empty() => {
            let outer = rings.remove(0);
            drawing.add_polygon(name, Role::Boundary, outer, rings);
        }
        Ok(_) => drawing.skip("a polygon without a ring", None),
    }
}
