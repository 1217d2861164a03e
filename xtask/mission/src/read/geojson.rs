//! GeoJSON (RFC 7946): lines and polygons, alone, in features, collections and collections of features.
//!
//! Coordinates are longitude, latitude in WGS 84 (section 4). Older files can name another system by `crs`; such a file is
//! refused, because its numbers would be read wrong. A feature's name is its property `name`, `title`, `label` or `designator` in any case,
//! else its `id`. Polygons are boundaries, lines guidance. A feature with `"obstacle": true`, or whose `type`, `kind`, `role` or `class` is `obstacle`, is
//! an obstacle: a polygon as it is, a line or a point with its `width` in metres, or [`BARRIER`]. Other points are left out, and all heights.

use ::geojson::{Geometry, GeometryValue, Position};
use serde_json::Value;

#[cfg(doc)]
use super::BARRIER;
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
        Some(_) => read_geometry(&mut drawing, &About::default(), &value),
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

/// What a feature says of its geometry.
#[derive(Default)]
struct About {
    name: Option<String>,
    obstacle: bool,
    /// Width of an obstacle that is a line or a point, m.
    width: Option<f64>,
}

impl About {
    fn of(feature: &Value) -> Self {
        Self {
            name: feature_name(feature),
            obstacle: is_obstacle(feature),
            width: property(feature, "width").and_then(Value::as_f64),
        }
    }

    fn named(&self, name: String) -> Self {
        Self {
            name: Some(name),
            ..*self
        }
    }
}

/// A property by its name in any case.
fn property<'a>(feature: &'a Value, known: &str) -> Option<&'a Value> {
    let mut properties = feature.get("properties")?.as_object()?.iter();
    let (_, value) = properties.find(|(key, _)| key.eq_ignore_ascii_case(known))?;
    Some(value)
}

fn is_obstacle(feature: &Value) -> bool {
    let yes = match property(feature, "obstacle") {
        Some(Value::Bool(yes)) => *yes,
        Some(Value::Number(number)) => number.as_f64() == Some(1.0),
        Some(Value::String(text)) => ["yes", "true", "1"]
            .iter()
            .any(|yes| text.eq_ignore_ascii_case(yes)),
        _ => false,
    };
    let kinds = ["type", "kind", "role", "class"];
    let mut kinds = kinds
        .iter()
        .filter_map(|known| property(feature, known)?.as_str());
    yes || kinds.any(|kind| kind.eq_ignore_ascii_case("obstacle"))
}

fn read_feature(drawing: &mut Drawing, feature: &Value) {
    let about = About::of(feature);
    match feature.get("geometry") {
        None | Some(Value::Null) if about.obstacle => {
            drawing.damage("an obstacle has no geometry".into());
        }
        None | Some(Value::Null) => drawing.skip("a feature without a geometry", None),
        Some(geometry) => read_geometry(drawing, &about, geometry),
    }
}

fn feature_name(feature: &Value) -> Option<String> {
    let words = |value: &Value| match value {
        Value::String(text) => Some(text.clone()),
        Value::Number(number) => Some(number.to_string()),
        _ => None,
    };
    let named = ["name", "title", "label", "designator"]
        .iter()
        .find_map(|known| words(property(feature, known)?).filter(|name| !name.trim().is_empty()));
    named.or_else(|| feature.get("id").and_then(words))
}

fn read_geometry(drawing: &mut Drawing, about: &About, geometry: &Value) {
    match serde_json::from_value::<Geometry>(geometry.clone()) {
        Ok(geometry) => add(drawing, about, geometry.value),
        Err(_) if about.obstacle => {
            drawing.damage("an obstacle has a geometry that is not one of RFC 7946".into());
        }
        Err(_) => drawing.skip("a geometry that is not one of RFC 7946", None),
    }
}

fn add(drawing: &mut Drawing, about: &About, geometry: GeometryValue) {
    match geometry {
        GeometryValue::LineString { coordinates } => line(drawing, about, &coordinates),
        GeometryValue::MultiLineString { coordinates } => {
            for coordinates in coordinates {
                line(drawing, about, &coordinates);
            }
        }
        GeometryValue::Polygon { coordinates } => polygon(drawing, about, &coordinates),
        GeometryValue::MultiPolygon { coordinates } => {
            // Whoever asks for one by its name must be able to tell them apart.
            let several = coordinates.len() > 1;
            for (number, coordinates) in (1..).zip(coordinates) {
                let part = about.name.as_ref().filter(|_| several);
                let part = part.map(|name| about.named(format!("{name} {number}")));
                polygon(drawing, part.as_ref().unwrap_or(about), &coordinates);
            }
        }
        GeometryValue::GeometryCollection { geometries } => {
            for geometry in geometries {
                add(drawing, about, geometry.value);
            }
        }
        GeometryValue::Point { coordinates } => point(drawing, about, &coordinates),
        GeometryValue::MultiPoint { coordinates } => {
            for coordinates in coordinates {
                point(drawing, about, &coordinates);
            }
        }
    }
}

fn point(drawing: &mut Drawing, about: &About, position: &Position) {
    match about.obstacle {
        true => line(drawing, about, std::slice::from_ref(position)),
        false => drawing.skip("a point that is no obstacle", None),
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
fn unplaced(drawing: &mut Drawing, about: &About, why: &str) {
    let named = about
        .name
        .as_ref()
        .map_or_else(String::new, |name| format!(" {name:?}"));
    let why = format!("whose coordinates are not longitude and latitude in degrees: {why}");
    match about.obstacle {
        true => drawing.damage(format!("it has an obstacle{named} {why}")),
        false => drawing.skip(format!("a shape{named} {why}"), None),
    }
}

fn line(drawing: &mut Drawing, about: &About, positions: &[Position]) {
    let name = about.name.as_deref();
    match places(positions) {
        Ok(places) if about.obstacle => drawing.add_barrier(name, &places, about.width),
        Ok(places) => drawing.add_line(name, Role::Guidance, places),
        Err(why) => unplaced(drawing, about, &why),
    }
}

fn polygon(drawing: &mut Drawing, about: &About, rings: &[Vec<Position>]) {
    let role = match about.obstacle {
        true => Role::Obstacle,
        false => Role::Boundary,
    };
    let rings: Result<Vec<_>, String> = rings.iter().map(|ring| places(ring)).collect();
    match rings {
        Err(why) => unplaced(drawing, about, &why),
        Ok(mut rings) if !rings.is_empty() => {
            let outer = rings.remove(0);
            drawing.add_polygon(about.name.as_deref(), role, outer, rings);
        }
        Ok(_) => drawing.skip("a polygon without a ring", None),
    }
}
