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

/// The coordinate system that a file of before RFC 7946 names for itself, a feature or a geometry, if it is not WGS 84.
fn foreign_system(value: &Value) -> Option<String> {
    match value {
        Value::Object(members) => members.iter().find_map(|(key, member)| match key.as_str() {
            "crs" => named_system(member),
            // A user's own, and numbers.
            "properties" | "coordinates" => None,
            _ => foreign_system(member),
        }),
        Value::Array(members) => members.iter().find_map(foreign_system),
        _ => None,
    }
}

fn named_system(crs: &Value) -> Option<String> {
    let properties = crs.get("properties");
    let property = |name| properties.and_then(|properties| properties.get(name));
    let name = match crs {
        Value::Null => return None,
        Value::String(name) => name.clone(),
        _ => match (property("name"), property("code")) {
            (Some(Value::String(name)), _) => name.clone(),
            (_, Some(code)) => format!("EPSG:{}", code.to_string().trim_matches('"')),
            _ => return Some("a coordinate system that it does not name".into()),
        },
    };
    let name = name.trim();
    let known = ["CRS84", ":4326", "WGS84", "WGS 84"];
    (!known.iter().any(|known| name.ends_with(known))).then(|| name.to_owned())
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
            width: width(feature),
        }
    }

    fn named(&self, name: String) -> Self {
        Self {
            name: Some(name),
            ..*self
        }
    }
}

/// The properties with a name in any case.
fn properties<'a>(feature: &'a Value, known: &str) -> impl Iterator<Item = &'a Value> {
    let properties = feature.get("properties").and_then(Value::as_object);
    let properties = properties.into_iter().flatten();
    properties
        .filter_map(move |(key, value)| key.trim().eq_ignore_ascii_case(known).then_some(value))
}

/// True for what says that a feature is an obstacle, and for what says something else than that it is none.
fn is_obstacle(feature: &Value) -> bool {
    let is = |value: &Value| match value {
        Value::Null => false,
        Value::Bool(yes) => *yes,
        Value::Number(number) => number.as_f64() != Some(0.0),
        Value::String(text) => {
            let no = ["", "no", "none", "false", "0", "n"];
            !no.iter().any(|no| text.trim().eq_ignore_ascii_case(no))
        }
        Value::Array(_) | Value::Object(_) => true,
    };
    let named = |value: &Value| {
        let words = value.as_str().unwrap_or_default().trim();
        ["obstacle", "obstacles"]
            .iter()
            .any(|known| words.eq_ignore_ascii_case(known))
    };
    let kinds = ["type", "kind", "role", "class"];
    properties(feature, "obstacle")
        .chain(feature.get("obstacle"))
        .any(is)
        || kinds
            .iter()
            .any(|known| properties(feature, known).any(named))
}

/// The width of an obstacle, m; NaN for what is no width.
fn width(feature: &Value) -> Option<f64> {
    let width = properties(feature, "width").next()?;
    match width {
        Value::Null => None,
        Value::String(text) => {
            let number = text.trim().trim_end_matches('m').trim_end();
            Some(number.parse().unwrap_or(f64::NAN))
        }
        _ => Some(width.as_f64().unwrap_or(f64::NAN)),
    }
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
    let known = ["name", "title", "label", "designator"].iter();
    let mut values = known.flat_map(|known| properties(feature, known));
    let named = values.find_map(|value| words(value).filter(|name| !name.trim().is_empty()));
    named.or_else(|| feature.get("id").and_then(words))
}

fn read_geometry(drawing: &mut Drawing, about: &About, geometry: &Value) {
    match serde_json::from_value::<Geometry>(geometry.clone()) {
        Ok(geometry) => {
            let before = drawing.shapes.len();
            add(drawing, about, geometry.value);
            if about.obstacle && drawing.shapes.len() == before {
                drawing.damage("an obstacle has no place".into());
            }
        }
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
