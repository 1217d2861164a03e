//! ISOXML: the task data of ISO 11783-10 (`TASKDATA.XML`), versions 3 and 4.
//!
//! Names of elements and attributes and their numbers are those of the standard, as the open implementations have them
//! (ADAPT/ISOv4Plugin `ISOEnumerations`, dev4Agriculture/isoxml-js `baseEntities`):
//!
//! | element | read |
//! | --- | --- |
//! | `PFD` partfield | its name `C` names its boundary; its size `D` is compared with what is read |
//! | `PLN` polygon | type `A`: 1 boundary, or without one 9 main field, as boundary; 3 water, 4 building, 6 obstacle and 12 windbreak as obstacle; others are left out. In a boundary each `LSG` of type 1 is an outer ring, of type 2 a hole. A hole may be in another polygon of the partfield than the ring round it (terminals of CNH). In an obstacle every `LSG` is a ring. Rings need not be closed |
//! | `GGP`, `GPN` guidance | type `C`: 1 A-B from the first to the last point; 2 A+ from its point in the direction `G` (degrees) for [`DIRECTED`] metres; 3 curve. 4 pivot and 5 spiral are left out |
//! | `LSG` line string | in a partfield type 3 tram line, 4 sampling route and 5 guidance as lines; 7 fence and 9 obstacle as obstacle of the width `C` (mm) or of [`BARRIER`]; 6 drainage and 8 flag are left out |
//! | `PNT` point | `C` latitude, `D` longitude, degrees; in a partfield type 5 as obstacle, others are left out |
//! | `XFR` reference | the partfields of the part file (`XFC` at its top), if it is there |

use roxmltree::{Document, Node};

#[cfg(doc)]
use super::BARRIER;
use super::{DIRECTED, Drawing, ReadError, Role, Shape};
use crate::field::Area;
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
        drawing.skip(
            format!("the part file {file}.XML, which is not beside it"),
            line,
        );
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

/// Share of its size by which a partfield may differ from what the file says of it: programs compute it in different planes.
const DIFFERENCE: f64 = 0.02;

/// Type of a polygon that is the edge of a partfield.
const BOUNDARY: u32 = 1;
/// Type of a polygon that is the edge without the headland.
const MAIN_FIELD: u32 = 9;

fn partfield(drawing: &mut Drawing, field: Node) {
    let name = drawing.begin_field(attribute(field, "C"));
    let name = Some(name.as_str());
    let before = drawing.shapes.len();
    let polygons = || field.children().filter(|child| child.has_tag_name("PLN"));
    let edge = match polygons().any(|polygon| kind(polygon, "A") == BOUNDARY) {
        true => BOUNDARY,
        false => MAIN_FIELD,
    };
    let mut rings = Rings::default();
    for polygon in polygons() {
        match kind(polygon, "A") {
            kind if kind == edge => rings.read(drawing, polygon),
            MAIN_FIELD => rings.read_holes(drawing, polygon),
            _ => {}
        }
    }
    rings.boundaries(drawing, name);
    compare(drawing, field, before);
    for polygon in polygons() {
        match kind(polygon, "A") {
            BOUNDARY | MAIN_FIELD => {}
            3 | 4 | 6 | 12 => obstacle(drawing, name, polygon),
            kind => drawing.skip(
                format!("an area of type {kind}, which is neither boundary nor obstacle"),
                line(polygon),
            ),
        }
    }
    for child in field.children() {
        match child.tag_name().name() {
            "GGP" => {
                for pattern in child.children().filter(|child| child.has_tag_name("GPN")) {
                    let group = attribute(child, "B").or(name);
                    guidance(drawing, group, pattern);
                }
            }
            "LSG" => string(drawing, name, child),
            "PNT" => point(drawing, name, child),
            _ => {}
        }
    }
    drawing.end_field();
}

/// Notes that a partfield has another size than the file says.
fn compare(drawing: &mut Drawing, field: Node, before: usize) {
    let told = attribute(field, "D").and_then(|text| text.parse::<f64>().ok());
    let Some(told) = told.filter(|told| *told > 0.0) else {
        return;
    };
    let boundaries = drawing.shapes[before..].iter();
    let boundaries = boundaries.filter(|named| named.role == Role::Boundary);
    let sizes: Vec<[f64; 2]> = boundaries.map(|named| sizes(&named.shape)).collect();
    // Programs count holes in or out.
    let [with, without] =
        [0, 1].map(|index: usize| sizes.iter().map(|sizes| sizes[index]).sum::<f64>());
    let differs = |size: f64| (size - told).abs() > DIFFERENCE * told;
    if with > 0.0 && differs(with) && differs(without) {
        let name = attribute(field, "C").unwrap_or_default();
        drawing.notes.push(format!(
            "the file says that {name:?} has {told:.0} m2, and its boundary encloses {with:.0} m2"
        ));
    }
}

/// Size of a polygon with its holes and without them, m2.
fn sizes(shape: &Shape) -> [f64; 2] {
    let Shape::Polygon { outer, .. } = shape else {
        return [0.0; 2];
    };
    let Some(place) = outer.first().copied() else {
        return [0.0; 2];
    };
    let frame = Frame::new(Origin { place, height: 0.0 });
    Area::of(shape, &frame).map_or([0.0; 2], |area| {
        [crate::polygon::area(&area.outer).abs(), area.size()]
    })
}

/// A line string of a partfield.
fn string(drawing: &mut Drawing, field: Option<&str>, string: Node) {
    let name = attribute(string, "B").or(field);
    let kind = kind(string, "A");
    match kind {
        3..=5 => {
            if let Some(places) = places(drawing, string) {
                drawing.add_line(name, Role::Guidance, places);
            }
        }
        7 | 9 => {
            let Some(places) = places(drawing, string) else {
                lost_obstacle(drawing, string);
                return;
            };
            let width = attribute(string, "C").map(|text| text.parse::<f64>().unwrap_or(f64::NAN));
            drawing.add_barrier(name, &places, width.map(|width| width / 1000.0));
        }
        6 => drawing.skip("a drain, which is no line to drive along", line(string)),
        8 => drawing.skip("a flag, which is no line to drive along", line(string)),
        _ => drawing.skip("a line string of an unknown purpose", line(string)),
    }
}

/// A point of a partfield.
fn point(drawing: &mut Drawing, field: Option<&str>, point: Node) {
    if kind(point, "A") != 5 {
        drawing.skip("a point that is no obstacle", line(point));
        return;
    }
    match place(point) {
        Some(place) => {
            let name = attribute(point, "B").or(field);
            drawing.add_barrier(name, &[place], None);
        }
        None => lost_obstacle(drawing, point),
    }
}

/// Refuses the file for an obstacle without a place: without it a vehicle would be driven there.
fn lost_obstacle(drawing: &mut Drawing, node: Node) {
    drawing.damage(format!(
        "an obstacle has a point that has no latitude C and longitude D{}",
        at_line(node)
    ));
}

fn at_line(node: Node) -> String {
    line(node).map_or_else(String::new, |line| format!(" (line {line})"))
}

fn place(point: Node) -> Option<Geodetic> {
    let angle = |name| attribute(point, name)?.parse::<f64>().ok();
    Geodetic::checked(angle("C")?, angle("D")?)
}

/// The places of a line string; `None`, and counted, if one of them is none.
fn places(drawing: &mut Drawing, string: Node) -> Option<Vec<Geodetic>> {
    let points = string.children().filter(|child| child.has_tag_name("PNT"));
    let places: Option<Vec<_>> = points.map(place).collect();
    if places.is_none() {
        drawing.skip(
            "a line string with a point that has no latitude C and longitude D",
            line(string),
        );
    }
    places
}

/// The places of a ring. Without one of its rings a field would be another, or lose an obstacle.
fn ring(drawing: &mut Drawing, string: Node) -> Option<Vec<Geodetic>> {
    let places = places(drawing, string);
    if places.is_none() {
        drawing.damage(format!(
            "a polygon has a ring with a point that has no latitude C and longitude D{}",
            at_line(string)
        ));
    }
    places
}

fn strings<'a, 'input>(polygon: Node<'a, 'input>) -> impl Iterator<Item = Node<'a, 'input>> {
    polygon.children().filter(|child| child.has_tag_name("LSG"))
}

/// The rings of a partfield's boundary, which may stand in several polygons.
#[derive(Default)]
struct Rings {
    outers: Vec<Vec<Geodetic>>,
    holes: Vec<Vec<Geodetic>>,
}

impl Rings {
    /// The holes of a polygon whose outer ring is not the edge.
    fn read_holes(&mut self, drawing: &mut Drawing, polygon: Node) {
        for string in strings(polygon).filter(|string| kind(*string, "A") == 2) {
            self.holes.extend(ring(drawing, string));
        }
    }

    fn read(&mut self, drawing: &mut Drawing, polygon: Node) {
        let before = self.outers.len() + self.holes.len();
        for string in strings(polygon) {
            let rings = match kind(string, "A") {
                1 => &mut self.outers,
                2 => &mut self.holes,
                7 | 9 => {
                    self::string(drawing, None, string);
                    continue;
                }
                _ => {
                    drawing.skip(
                        "a line string of a boundary that is no ring of it",
                        line(string),
                    );
                    continue;
                }
            };
            rings.extend(ring(drawing, string));
        }
        if self.outers.len() + self.holes.len() == before {
            drawing.skip("a boundary without a ring", line(polygon));
        }
    }

    /// Adds a boundary for each outer ring, with all holes that reach into it. Others are obstacles.
    fn boundaries(self, drawing: &mut Drawing, name: Option<&str>) {
        let Self { outers, holes } = self;
        let several = outers.len() > 1;
        let mut used = vec![false; holes.len()];
        for (number, outer) in (1..).zip(outers) {
            let mut inside = Vec::new();
            for (hole, used) in holes.iter().zip(&mut used) {
                if touch(&outer, hole) {
                    *used = true;
                    inside.push(hole.clone());
                }
            }
            let part = name
                .filter(|_| several)
                .map(|name| format!("{name} {number}"));
            drawing.add_polygon(part.as_deref().or(name), Role::Boundary, outer, inside);
        }
        let beside = holes.into_iter().zip(used).filter(|(_, used)| !used);
        for (hole, _) in beside {
            drawing.add_polygon(name, Role::Obstacle, hole, Vec::new());
        }
    }
}

/// The rings of an obstacle, whatever types they have.
fn obstacle(drawing: &mut Drawing, field: Option<&str>, polygon: Node) {
    let name = attribute(polygon, "B").or(field);
    let mut strings = strings(polygon).peekable();
    if strings.peek().is_none() {
        drawing.damage(format!("an obstacle has no ring{}", at_line(polygon)));
    }
    for string in strings {
        if let Some(corners) = ring(drawing, string) {
            drawing.add_polygon(name, Role::Obstacle, corners, Vec::new());
        }
    }
}

/// True if two rings have a place in common.
fn touch(one: &[Geodetic], other: &[Geodetic]) -> bool {
    let Some(place) = one.first().copied() else {
        return false;
    };
    let frame = Frame::new(Origin { place, height: 0.0 });
    let local = |ring: &[Geodetic]| -> Vec<_> { ring.iter().map(|at| frame.local(*at)).collect() };
    crate::field::touch(&local(one), &local(other))
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
