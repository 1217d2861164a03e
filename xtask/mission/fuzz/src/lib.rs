//! The fuzz targets as functions of the fuzzer's bytes. The tests of the crate call them with random bytes, because a
//! fuzzer needs a nightly toolchain.

use mission::curve::{self, Chain, Resampling};
use mission::field::{self, Area, Direction, Ends, Field, Order};
use mission::picture;
use mission::place::{Frame, Geodetic, Local, Origin};
use mission::plan::Plan;
use mission::read::{Drawing, ReadError, Shape, agopengps, csv, geojson, isoxml, text};

/// A plan in a file's text. One that is accepted must be written and read without a change, and be drawn.
pub fn plan(bytes: &[u8]) -> Option<Plan> {
    let plan = Plan::read(&text(bytes), "fuzz").map_err(|error| sentence(&error.to_string()));
    let plan = plan.ok()?;
    assert_eq!(Plan::read(&plan.write(), "again").as_ref(), Ok(&plan));
    let chains = curve::legs(&plan, &curve::Options::default());
    let chains = chains
        .map_err(|(_, error)| sentence(&error.to_string()))
        .unwrap_or_default();
    let picture = picture::svg(
        &plan,
        &picture::Options {
            chains: &chains,
            limit: Some(0.3),
            ..picture::Options::default()
        },
    );
    assert!(picture.ends_with("</svg>\n") && !picture.contains("NaN"));
    Some(plan)
}

/// A file of GeoJSON.
pub fn geojson(bytes: &[u8]) -> Option<Drawing> {
    drawing(geojson::read(&text(bytes)))
}

/// A table of points, in metres or degrees.
pub fn csv(bytes: &[u8]) -> Option<Drawing> {
    let place = Geodetic {
        latitude: 52.0,
        longitude: 179.99,
    };
    let frame = Frame::new(Origin { place, height: 0.0 });
    drawing(csv::read(&text(bytes), Some(&frame)))
}

/// The files of an AgOpenGPS field, between bytes 0.
pub fn agopengps(bytes: &[u8]) -> Option<Drawing> {
    let parts: Vec<String> = bytes.split(|byte| *byte == 0).map(text).collect();
    let part = |index: usize| parts.get(index).map(String::as_str);
    drawing(agopengps::read(&agopengps::Files {
        field: part(0).unwrap_or_default(),
        boundary: part(1),
        ab_lines: part(2),
        curve_lines: part(3),
        track_lines: part(4),
    }))
}

/// A file of ISO 11783-10.
pub fn isoxml(bytes: &[u8]) -> Option<Drawing> {
    drawing(isoxml::read(&text(bytes)))
}

/// Errors are one sentence.
fn sentence(error: &str) {
    assert!(!error.is_empty() && !error.contains('\n'), "{error:?}");
}

/// A drawing must have shapes that are what they say.
fn drawing(result: Result<Drawing, ReadError>) -> Option<Drawing> {
    let drawing = result.map_err(|error| sentence(&error.to_string())).ok()?;
    assert!(!drawing.shapes.is_empty());
    assert!(drawing.skipped.iter().all(|skipped| skipped.count > 0));
    let on_earth = |place: &Geodetic| Geodetic::checked(place.latitude, place.longitude).is_some();
    for named in &drawing.shapes {
        assert!(!named.name.trim().is_empty());
        match &named.shape {
            Shape::Line { from, to } => assert!(from != to && on_earth(from) && on_earth(to)),
            Shape::Curve(places) => assert!(places.len() > 2 && places.iter().all(on_earth)),
            Shape::Polygon { outer, holes } => {
                for ring in std::iter::once(outer).chain(holes) {
                    assert!(ring.len() > 2 && ring.first() != ring.last());
                    assert!(ring.iter().all(on_earth));
                }
            }
        }
    }
    let place = match &drawing.shapes[0].shape {
        Shape::Line { from, .. } => *from,
        Shape::Curve(places) => places[0],
        Shape::Polygon { outer, .. } => outer[0],
    };
    let frame = Frame::new(Origin { place, height: 0.0 });
    for (_, area) in field::areas(&drawing, &frame) {
        assert!(area.size().is_finite());
    }
    Some(drawing)
}

/// A curve through points of 16 bits for each coordinate, in centimetres; the first byte has the options. A curve that is found
/// must come near its points and have no jumps.
pub fn curve(bytes: &[u8]) -> Option<Chain> {
    let (head, points) = bytes.split_first()?;
    let coordinate = |bytes: &[u8]| match bytes {
        [high, low] => f64::from(i16::from_be_bytes([*high, *low])) / 100.0,
        _ => 0.0,
    };
    let points = points.chunks_exact(4);
    let mut points: Vec<Local> = points
        .map(|four| Local::new(coordinate(&four[..2]), coordinate(&four[2..])))
        .collect();
    if head & 1 != 0 {
        points.extend(points.first().copied());
    }
    let resampling = (head & 4 != 0).then_some(Resampling {
        spacing: 20.0,
        noise: 0.1 * f64::from(head >> 3 & 7),
    });
    let options = curve::Options {
        straight_begin: head & 2 != 0,
        straight_end: head & 64 != 0,
        resampling,
        ..curve::Options::default()
    };
    let chain = curve::fit(&points, &options).map_err(|error| sentence(&error.to_string()));
    let chain = chain.ok()?;
    assert!(chain.deviation <= options.tolerance, "{}", chain.deviation);
    for pair in chain.segments.windows(2) {
        let end = pair[0].end();
        assert!(end.place.distance(pair[1].start.place) < 1e-6);
        assert!((end.heading - pair[1].start.heading).sin().abs() < 1e-6);
    }
    Some(chain)
}

/// A field of corners of 8 bits for each coordinate, in metres. The first bytes are width, headland, direction, radius, and the number of
/// corners of the edge; the rest are those of a hole.
pub fn field(bytes: &[u8]) -> Option<Field> {
    let [width, headland, direction, radius, edge, corners @ ..] = bytes else {
        return None;
    };
    let corners = corners.chunks_exact(2);
    let corners: Vec<Local> = corners
        .map(|pair| Local::new(f64::from(pair[0]), f64::from(pair[1])))
        .collect();
    let (outer, hole) = corners.split_at(usize::from(*edge).min(corners.len()));
    let area = Area {
        outer: outer.to_vec(),
        holes: vec![hole.to_vec()],
    };
    let options = field::Options {
        headland: f64::from(*headland) / 8.0,
        direction: match direction {
            0 => Direction::Auto,
            degrees => Direction::Bearing(f64::from(*degrees).to_radians()),
        },
        order: if radius & 1 == 0 {
            Order::Neighbouring
        } else {
            Order::Skip
        },
        ends: if radius & 2 == 0 {
            Ends::Middle
        } else {
            Ends::Whole
        },
        radius: f64::from(*radius) / 16.0,
        ..field::Options::new(0.5 + f64::from(*width) / 16.0)
    };
    let field = field::divide(&area, &options).map_err(|error| sentence(&error.to_string()));
    let field = field.ok()?;
    let covered = field.coverage;
    assert!(covered.covered <= covered.inner + 1.0, "{covered:?}");
    assert!(covered.inner <= covered.field + 1.0, "{covered:?}");
    assert!(!field.swaths.is_empty());
    for swath in &field.swaths {
        assert!(swath.length() >= options.shortest - 1e-6);
    }
    Some(field)
}
