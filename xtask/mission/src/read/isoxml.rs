//! ISOXML: the task data of ISO 11783-10 (`TASKDATA.XML`), versions 3 and 4.
//!
//! Names of elements and attributes and their numbers are those of the standard, as the open implementations have them
//! (ADAPT/ISOv4Plugin `ISOEnumerations`, dev4Agriculture/isoxml-js `baseEntities`):
//!
//! | element | read |
//! | --- | --- |
//! | `PFD` partfield | its name `C` names its shapes |
//! | `PLN` polygon | type `A`: 1 boundary and 9 main field as boundary; 3 water, 4 building and 6 obstacle as obstacle; others as area. Each `LSG` of type 1 is an outer ring, of type 2 a hole. Rings need not be closed |
//! | `GGP`, `GPN` guidance | type `C`: 1 A-B from the first to the last point; 2 A+ from its point in the direction `G` (degrees) for [`DIRECTED`] metres; 3 curve. 4 pivot and 5 spiral are left out |
//! | `LSG` line string | in a partfield type 5 guidance; 3, 4, 6 to 9 as other lines |
//! | `PNT` point | `C` latitude, `D` longitude, degrees |
//! | `XFR` reference | the partfields of the part file (`XFC` at its top), if it is there |

use roxmltree::{Document, Node};

use super::{DIRECTED, Drawing, ReadError, Role};
use crate::place::{Frame, Geodetic, Local, Origin};

/// Reads the text of a file. Part files are left out.
///
/// # Errors
/// [`ReadError`] if it is not XML, not of ISO 11783-10, or has nothing that can be used.
pub fn read(text: &str) -> Result<Drawing, ReadError> {
    read_parts(text, &|_| None)
}

/// Reads the text of a file. `part` gives the text of a part file by its name without `.XML`. Only those of partfields are asked for,
/// whose names begin with PFD.
///
/// # Errors
/// As [`read`].
pub fn read_parts(text: &str, part: &dyn Fn(&str) -> Option<String>) -> Result<Drawing, ReadError> {
    let document = parse(text)?;
    let mut drawing = Drawing::new("ISOXML");
    for child in document.root_element().children() {
        match child.tag_name().name() {
            "XFR" => {
                let file = child.attribute("A").unwrap_or_default();
                if file.starts_with("PFD") {
                    part_file(&mut drawing, file, part(file), line(child));
                }
            }
            "PFD" => partfield(&mut drawing, child),
            _ => {}
        }
    }
    drawing.finish()
}

fn parse(text: &str) -> Result<Document<'_>, ReadError> {
    let document = Document::parse(text).map_err(|error| {
        ReadError::new(format!("line {}: it is not XML: {error}", error.pos().row))
    })?;
    let root = document.root_element().tag_name().name();
    if matches!(root, "ISO11783_TaskData" | "XFC") {
        return Ok(document);
    }
    Err(ReadError::new(format!(
        "its outermost element is {root}: ISO11783_TaskData (or XFC of a part file) is accepted"
    )))
}

/// The partfields of a part file. A part file has no part files.
fn part_file(drawing: &mut Drawing, file: &str, text: Option<String>, line: Option<usize>) {
    let Some(text) = text else {
        drawing.skip(format!("the part file {file}.XML: read it by itself"), line);
        return;
    };
    match parse(&text) {
        Ok(document) => {
            let fields = document.root_element().children();
            for field in fields.filter(|child| child.has_tag_name("PFD")) {
                partfield(drawing, field);
            }
        }
        Err(error) => drawing.skip(format!("the part file {file}.XML: {error}"), line),
    }
}

fn line(node: Node) -> Option<usize> {
    let position = node.document().text_pos_at(node.range().start);
    usize::try_from(position.row).ok()
}

/// An attribute that is not empty.
fn attribute<'a>(node: Node<'a, '_>, name: &str) -> Option<&'a str> {
    node.attribute(name)
        .map(str::trim)
        .filter(|text| !text.is_empty())
}

fn kind(node: Node, name: &str) -> u32 {
    let kind = attribute(node, name).and_then(|text| text.parse().ok());
    kind.unwrap_or(0)
}

fn partfield(drawing: &mut Drawing, field: Node) {
    let name = attribute(field, "C");
    for child in field.children() {
        match child.tag_name().name() {
            "PLN" => polygon(drawing, name, child),
            "GGP" => {
                for pattern in child.children().filter(|child| child.has_tag_name("GPN")) {
                    let group = attribute(child, "B").or(name);
                    guidance(drawing, group, pattern);
                }
            }
            "LSG" => {
                let name = attribute(child, "B").or(name);
                let role = match kind(child, "A") {
                    5 => Role::Guidance,
                    _ => Role::Other,
                };
                if let Some(places) = places(drawing, child) {
                    drawing.add_line(name, role, places);
                }
            }
            "PNT" => drawing.skip("a point: lines and polygons are read", line(child)),
            _ => {}
        }
    }
}

/// The places of a line string; `None`, and counted, if one of them is none.
fn places(drawing: &mut Drawing, string: Node) -> Option<Vec<Geodetic>> {
    let points = string.children().filter(|child| child.has_tag_name("PNT"));
    let place = |point: Node| {
        let angle = |name| attribute(point, name)?.parse::<f64>().ok();
        Geodetic::checked(angle("C")?, angle("D")?)
    };
    let places: Option<Vec<_>> = points.map(place).collect();
    if places.is_none() {
        drawing.skip(
            "a line string with a point that has no latitude C and longitude D",
            line(string),
        );
    }
    places
}

fn polygon(drawing: &mut Drawing, field: Option<&str>, polygon: Node) {
    let role = match kind(polygon, "A") {
        1 | 9 => Role::Boundary,
        3 | 4 | 6 => Role::Obstacle,
        _ => Role::Other,
    };
    let name = attribute(polygon, "B").or(field);
    let (mut outers, mut holes) = (Vec::new(), Vec::new());
    for string in polygon.children().filter(|child| child.has_tag_name("LSG")) {
        let Some(places) = places(drawing, string) else {
            // Without one of its rings a field would be another, or lose an obstacle.
            if matches!(role, Role::Boundary | Role::Obstacle) {
                drawing.damage(format!(
                    "a polygon has a ring with a point that has no latitude C and longitude D{}",
                    line(string).map_or_else(String::new, |line| format!(" (line {line})"))
                ));
            }
            continue;
        };
        match kind(string, "A") {
            1 => outers.push(places),
            2 => holes.push(places),
            _ => drawing.skip(
                "a line string of a polygon that is no ring of it",
                line(string),
            ),
        }
    }
    // Version 3 has several outer rings in one polygon.
    let count = outers.len();
    for outer in outers {
        let (inside, others) = match count {
            1 => (holes, Vec::new()),
            _ => holes.into_iter().partition(|hole| encloses(&outer, hole)),
        };
        drawing.add_polygon(name, role, outer, inside);
        holes = others;
    }
    for _ in holes {
        drawing.skip("a hole that is in no outer ring", line(polygon));
    }
    if count == 0 {
        drawing.skip("a polygon without an outer ring", line(polygon));
    }
}

/// True if the first corner of a hole is inside a ring.
fn encloses(outer: &[Geodetic], hole: &[Geodetic]) -> bool {
    let outer = super::flat(outer);
    let hole = super::flat(hole);
    hole.first()
        .is_some_and(|corner| crate::polygon::holds(&outer, *corner, 0.0))
}

fn guidance(drawing: &mut Drawing, group: Option<&str>, pattern: Node) {
    let name = attribute(pattern, "B").or(group);
    let Some(string) = pattern.children().find(|child| child.has_tag_name("LSG")) else {
        drawing.skip("a guidance pattern without a line string", line(pattern));
        return;
    };
    let Some(places) = places(drawing, string) else {
        return;
    };
    match (kind(pattern, "C"), &places[..]) {
        (1, [from, .., to]) => drawing.add_line(name, Role::Guidance, vec![*from, *to]),
        (2, [from, ..]) => {
            let heading = attribute(pattern, "G").and_then(|text| text.parse::<f64>().ok());
            let heading =
                heading.filter(|heading| heading.is_finite() && from.latitude.abs() < 89.0);
            let Some(heading) = heading else {
                drawing.skip("an A+ line without a heading G", line(pattern));
                return;
            };
            let frame = Frame::new(Origin {
                place: *from,
                height: 0.0,
            });
            let to = frame.geodetic(Local::default().towards(heading.to_radians(), DIRECTED));
            drawing.add_directed(name, *from, to);
        }
        (3, _) => drawing.add_line(name, Role::Guidance, places),
        (4, _) => drawing.skip("a pivot, which is no line", line(pattern)),
        (5, _) => drawing.skip("a spiral", line(pattern)),
        _ => drawing.skip(
            "a guidance pattern of fewer points than its type needs",
            line(pattern),
        ),
    }
}
