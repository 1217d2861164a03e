//! Readers of other tools' files: lines, curves and boundaries, in latitude and longitude.
//!
//! Real files are messy. What a reader cannot use it leaves out and counts ([`Skipped`]). It refuses a file, with one sentence
//! ([`ReadError`]), if nothing in it can be used, or if a row of a table is no place: without a corner a boundary can be another field.
//!
//! | format | reader | source of the format |
//! | --- | --- | --- |
//! | GeoJSON | [`geojson`] | RFC 7946 |
//! | CSV | [`csv`] | none; columns are found by their headings |
//! | AgOpenGPS | [`agopengps`] | its sources, see there |
//! | ISOXML | [`isoxml`] | ISO 11783-10, see there |

pub mod agopengps;
pub mod csv;
pub mod geojson;
pub mod isoxml;

use std::collections::HashMap;
use std::fmt;
use std::path::Path;

use geo::buffer::{BufferStyle, LineCap, LineJoin};
use geo::{Buffer as _, LineString, Simplify as _};

use crate::place::{FARTHEST, Frame, Geodetic, Local, Origin};
use crate::polygon;

/// Length of a line of which a file has the beginning and the direction only, m.
pub const DIRECTED: f64 = 100.0;

/// Width of an obstacle of which a file has a point or a line only, m.
pub const BARRIER: f64 = 1.0;

/// Widths of obstacles that are lines or points, m: less is taken for this, more refused.
const WIDTHS: [f64; 2] = [0.1, 100.0];

/// By how much a line may bend and count as straight, m.
const STRAIGHT: f64 = 0.01;

/// Most characters of an error before it is cut.
const LONGEST_SENTENCE: usize = 600;

/// The shapes of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Drawing {
    /// The format, for people.
    pub format: &'static str,
    /// The place that the file measures from, if it has one.
    pub origin: Option<Geodetic>,
    /// Its shapes, in their order.
    pub shapes: Vec<Named>,
    /// Parts of the file that were left out.
    pub skipped: Vec<Skipped>,
    /// What the reader has made of the file beyond its words, a sentence each.
    pub notes: Vec<String>,
    /// Why it cannot be used at all.
    damage: Option<String>,
    /// The names of its partfields so far.
    names: Names,
    /// The partfield that is being read.
    field: Option<String>,
}

/// A shape and its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Named {
    /// The name in the file, or one made of its kind and number.
    pub name: String,
    /// Its purpose according to the file.
    pub role: Role,
    /// The shape.
    pub shape: Shape,
    /// True if the file has only the beginning and the direction of a line: it is [`DIRECTED`] metres long then.
    pub directed: bool,
    /// The partfield that it is of, in formats whose partfields have lines and obstacles of their own.
    pub field: Option<String>,
}

/// Purpose of a shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Role {
    /// The edge of a field.
    Boundary,
    /// Something inside a field that is not driven through.
    Obstacle,
    /// A line to drive along, or to lay others beside.
    Guidance,
}

/// A shape on the earth.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A straight line through two places, in driving direction.
    Line {
        /// Where it begins.
        from: Geodetic,
        /// Where it ends.
        to: Geodetic,
    },
    /// A line through three places or more.
    Curve(Vec<Geodetic>),
    /// An area. No ring has its first corner again at the end.
    Polygon {
        /// Its edge, three corners or more.
        outer: Vec<Geodetic>,
        /// Rings that are cut out of it.
        holes: Vec<Vec<Geodetic>>,
    },
}

/// Parts of a file that were left out for the same reason.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Skipped {
    /// The kind of part, with the reason.
    pub why: String,
    /// How often.
    pub count: usize,
    /// The line of the first one in the text, counted from 1, if known.
    pub line: Option<usize>,
}

impl fmt::Display for Skipped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.why)?;
        match (self.count, self.line) {
            (1, None) => Ok(()),
            (1, Some(line)) => write!(f, " (line {line})"),
            (count, None) => write!(f, " ({count} times)"),
            (count, Some(line)) => write!(f, " ({count} times, first in line {line})"),
        }
    }
}

/// Why nothing of a file can be used. Displays as one sentence.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct ReadError(String);

impl ReadError {
    /// One sentence in one line: files can have line breaks in what it quotes.
    fn new(text: impl AsRef<str>) -> Self {
        let words = text
            .as_ref()
            .split(|c: char| c.is_control() || c.is_whitespace());
        let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
        let mut text = words.join(" ");
        if text.chars().count() > LONGEST_SENTENCE {
            text = text.chars().take(LONGEST_SENTENCE).collect::<String>() + " ...";
        }
        Self(text)
    }
}

impl Drawing {
    fn new(format: &'static str) -> Self {
        Self {
            format,
            ..Self::default()
        }
    }

    /// Notes why the whole file cannot be used; the first cause counts.
    fn damage(&mut self, why: String) {
        self.damage.get_or_insert(why);
    }

    /// Counts something that is left out.
    fn skip(&mut self, why: impl Into<String>, line: Option<usize>) {
        let why = why.into();
        match self.skipped.iter_mut().find(|skipped| skipped.why == why) {
            Some(skipped) => skipped.count += 1,
            None => self.skipped.push(Skipped {
                why,
                count: 1,
                line,
            }),
        }
    }

    /// A shape of this role with its name, or with one that is made up.
    fn add(&mut self, name: Option<&str>, role: Role, shape: Shape) {
        let name = name.map(str::trim).filter(|name| !name.is_empty());
        let name = name.map_or_else(
            || {
                let word = match (role, &shape) {
                    (Role::Boundary, _) => "boundary",
                    (Role::Obstacle, _) => "obstacle",
                    (_, Shape::Line { .. }) => "line",
                    (_, Shape::Curve(_)) => "curve",
                    (_, Shape::Polygon { .. }) => "area",
                };
                format!("{word} {}", self.shapes.len() + 1)
            },
            str::to_owned,
        );
        self.shapes.push(Named {
            name,
            role,
            shape,
            directed: false,
            field: self.field.clone(),
        });
    }

    /// Begins a partfield, to which all shapes belong until it ends. Returns its name, which no other partfield has.
    fn begin_field(&mut self, name: Option<&str>) -> String {
        let name = name.map_or_else(
            || format!("partfield {}", self.names.0.len() + 1),
            str::to_owned,
        );
        let name = self.names.unique(name);
        self.field = Some(name.clone());
        name
    }

    fn end_field(&mut self) {
        self.field = None;
    }

    /// An obstacle along a line or at a point, `width` metres wide, or [`BARRIER`] if that is not known.
    fn add_barrier(&mut self, name: Option<&str>, places: &[Geodetic], width: Option<f64>) {
        let Some(first) = places.first().copied() else {
            self.damage("an obstacle has no place".into());
            return;
        };
        let known = width.filter(|width| *width != 0.0);
        let [least, most] = WIDTHS;
        if let Some(width) = known.filter(|width| !(0.0..=most).contains(width)) {
            let width = match width.is_nan() {
                true => "has a width that is no number of metres".to_owned(),
                false => format!("is {width} m wide"),
            };
            self.damage(format!(
                "an obstacle {width}: more than 0 m and up to {most} m are accepted"
            ));
            return;
        }
        if known.is_none() {
            let name = name.unwrap_or_default();
            self.notes.push(format!(
                "the obstacle {name:?} is a point or a line without a width: it is made {BARRIER} m wide"
            ));
        }
        let frame = Frame::new(Origin {
            place: first,
            height: 0.0,
        });
        let line: Vec<Local> = places.iter().map(|place| frame.local(*place)).collect();
        let far = |at: &Local| at.distance(Local::default()) > FARTHEST;
        if line.iter().any(far) || !places.iter().all(|place| frame.is_near(*place)) {
            self.damage(format!(
                "an obstacle reaches farther than {} km: several shorter ones are accepted",
                FARTHEST / 1000.0
            ));
            return;
        }
        let half = 0.5 * known.map_or(BARRIER, |width| width.max(least));
        for band in bands(&line, half) {
            let outer = band.iter().map(|corner| frame.geodetic(*corner)).collect();
            let holes = Vec::new();
            self.add(name, Role::Obstacle, Shape::Polygon { outer, holes });
        }
    }

    /// A line of which the file has the beginning and the direction only.
    fn add_directed(&mut self, name: Option<&str>, from: Geodetic, to: Geodetic) {
        let count = self.shapes.len();
        self.add_line(name, Role::Guidance, vec![from, to]);
        for named in self.shapes.iter_mut().skip(count) {
            named.directed = true;
        }
    }

    /// A line or a curve through places; with fewer than two different ones it is skipped.
    fn add_line(&mut self, name: Option<&str>, role: Role, mut places: Vec<Geodetic>) {
        places.dedup();
        match places[..] {
            [] | [_] => self.skip("a line of fewer than two places", None),
            [from, to] => self.add(name, role, Shape::Line { from, to }),
            _ => self.add(name, role, Shape::Curve(places)),
        }
    }

    /// An area; without three different corners it is skipped, and its holes are obstacles. An obstacle or a hole of fewer corners is
    /// kept as a point or a line.
    fn add_polygon(
        &mut self,
        name: Option<&str>,
        role: Role,
        outer: Vec<Geodetic>,
        holes: Vec<Vec<Geodetic>>,
    ) {
        let outer = match ring(outer) {
            Ok(outer) => outer,
            Err(corners) if role == Role::Obstacle => {
                self.add_barrier(name, &corners, None);
                return;
            }
            Err(_) => {
                self.skip("an area of fewer than three corners", None);
                for hole in holes {
                    self.add_polygon(name, Role::Obstacle, hole, Vec::new());
                }
                return;
            }
        };
        let (mut rings, mut thin) = (Vec::new(), Vec::new());
        for hole in holes {
            match ring(hole) {
                Ok(hole) => rings.push(hole),
                Err(corners) => thin.push(corners),
            }
        }
        let holes = rings;
        self.add(name, role, Shape::Polygon { outer, holes });
        for corners in thin {
            self.add_barrier(name, &corners, None);
        }
    }

    /// Makes boundaries that lie inside a larger one obstacles of the smallest such one: for formats in which an area has no holes.
    /// What lies inside such an obstacle stays a boundary.
    fn nest(&mut self) {
        // All in one plane, and none beside another one because the earth is round.
        let first = self.shapes.iter().find_map(|named| match &named.shape {
            Shape::Polygon { outer, .. } => outer.first(),
            _ => None,
        });
        let from = first.map_or(0.0, |place| place.longitude);
        let rings: Vec<Option<Vec<Local>>> = self
            .shapes
            .iter()
            .map(|named| match &named.shape {
                Shape::Polygon { outer, .. } => Some(flat(outer, from)),
                _ => None,
            })
            .collect();
        let area = |index: usize| {
            let ring = rings.get(index).and_then(Option::as_ref);
            ring.map_or(0.0, |ring| polygon::area(ring).abs())
        };
        let inside = |inner: &[Local], outer: &[Local]| {
            let mut corners = inner.iter();
            corners.all(|corner| polygon::holds(outer, *corner, 0.0))
        };
        // For each shape those around it, the smallest first.
        let around: Vec<Vec<usize>> = rings
            .iter()
            .enumerate()
            .map(|(index, ring)| {
                let Some(ring) = ring else { return Vec::new() };
                let mut around: Vec<usize> = (0..rings.len())
                    .filter(|other| area(*other) > area(index))
                    .filter(|other| {
                        rings[*other]
                            .as_ref()
                            .is_some_and(|outer| inside(ring, outer))
                    })
                    .collect();
                around.sort_by(|one, other| area(*one).total_cmp(&area(*other)));
                around
            })
            .collect();
        let shapes = std::mem::take(&mut self.shapes);
        let mut kept: Vec<Option<Named>> = shapes.into_iter().map(Some).collect();
        for (index, around) in around.iter().enumerate() {
            let (Some(outside), 1) = (around.first(), around.len() % 2) else {
                continue;
            };
            let Some(Named {
                name,
                shape: Shape::Polygon { outer: ring, .. },
                ..
            }) = kept[index].take()
            else {
                continue;
            };
            if let Some(Named {
                name: field,
                shape: Shape::Polygon { holes, .. },
                ..
            }) = &mut kept[*outside]
            {
                holes.push(ring);
                self.notes.push(format!(
                    "the shape {name:?} lies inside {field:?} and is an obstacle of it"
                ));
            }
        }
        self.shapes = kept.into_iter().flatten().collect();
    }

    /// The drawing, if there is something in it. Each boundary has a name of its own then.
    fn finish(mut self) -> Result<Self, ReadError> {
        if let Some(why) = self.damage {
            return Err(ReadError::new(why));
        }
        // A boundary has the name of its own partfield, and of no other one.
        let mut names = std::mem::take(&mut self.names);
        let boundaries = self.shapes.iter_mut();
        for named in boundaries.filter(|named| named.role == Role::Boundary) {
            if named.field.as_ref() != Some(&named.name) {
                named.name = names.unique(std::mem::take(&mut named.name));
            }
        }
        if !self.shapes.is_empty() {
            return Ok(self);
        }
        let why: Vec<String> = self.skipped.iter().map(ToString::to_string).collect();
        let skipped = match why.is_empty() {
            true => String::new(),
            false => format!("; left out: {}", why.join("; ")),
        };
        Err(ReadError::new(format!(
            "there is no line, curve or boundary in this {} file{skipped}",
            self.format
        )))
    }
}

/// Corners as a plane figure in degrees, longitudes from that of a place near by: that stretches it, which changes no inside.
fn flat(corners: &[Geodetic], from: f64) -> Vec<Local> {
    let east = |longitude: f64| {
        let turns = ((longitude - from) / 360.0).round();
        longitude - from - 360.0 * turns
    };
    let corners = corners.iter();
    corners
        .map(|place| Local::new(place.latitude, east(place.longitude)))
        .collect()
}

/// Says that two numbers are no place of the earth, and whether they would be one if they were interchanged.
fn no_place(latitude: f64, longitude: f64) -> String {
    let interchanged = match Geodetic::checked(longitude, latitude) {
        Some(_) => "; they may be interchanged",
        None => "",
    };
    format!(
        "latitude {latitude}, longitude {longitude} is no place of the earth, -90 to 90 and -180 to 180 degrees are \
         accepted{interchanged}"
    )
}

/// Corners of a ring without repetitions and without the first one at the end.
///
/// # Errors
/// There are fewer than three, which these are.
fn ring(mut places: Vec<Geodetic>) -> Result<Vec<Geodetic>, Vec<Geodetic>> {
    places.dedup();
    while places.len() > 1 && places.first() == places.last() {
        places.pop();
    }
    if places.len() < 3 {
        return Err(places);
    }
    Ok(places)
}

/// Names that were given, and how often each was wanted.
#[derive(Clone, Debug, Default, PartialEq)]
struct Names(HashMap<String, usize>);

impl Names {
    /// A name that was not given before: the wanted one, or with a number behind it.
    fn unique(&mut self, name: String) -> String {
        let mut number = self.0.get(&name).copied().unwrap_or(0);
        let mut different = match number {
            0 => name.clone(),
            _ => format!("{name} ({})", number + 1),
        };
        while self.0.contains_key(&different) {
            number += 1;
            different = format!("{name} ({})", number + 1);
        }
        self.0.insert(name, number + 1);
        self.0.entry(different.clone()).or_insert(1);
        different
    }
}

/// Rings round a line or a point, `half` metres from it. A line that leads round a place has several: none of them encloses
/// more than the line.
fn bands(line: &[Local], half: f64) -> Vec<Vec<Local>> {
    let square = |at: Local| {
        let corner = |(north, east): (f64, f64)| Local::new(at.north + north, at.east + east);
        [(-half, -half), (-half, half), (half, half), (half, -half)]
            .map(corner)
            .to_vec()
    };
    match *line {
        [] => return Vec::new(),
        [at] => return vec![square(at)],
        [from, ..] if line.iter().all(|place| *place == from) => return vec![square(from)],
        _ => {}
    }
    // Where the line is nearly straight, corners lie on each other. Without them the band is not narrower.
    let style = BufferStyle::new(half + STRAIGHT)
        .line_join(LineJoin::Miter(2.0))
        .line_cap(LineCap::Square);
    let string: LineString = line.iter().copied().map(polygon::coord).collect();
    let parts = string.buffer_with_style(style);
    let closed = parts.iter().any(|band| !band.interiors().is_empty());
    if closed && line.len() > 2 {
        let (one, other) = (&line[..=line.len() / 2], &line[line.len() / 2..]);
        return [bands(one, half), bands(other, half)].concat();
    }
    parts
        .iter()
        .map(|band| polygon::corners(&band.exterior().simplify(STRAIGHT)))
        .collect()
}

/// The text of a file: UTF-8, or UTF-16 with a byte-order mark; without that mark, and with replacement characters
/// where it is neither (names in old files).
#[must_use]
pub fn text(bytes: &[u8]) -> String {
    type Unit = fn([u8; 2]) -> u16;
    let wide: Option<Unit> = match bytes {
        [0xFF, 0xFE, ..] => Some(u16::from_le_bytes),
        [0xFE, 0xFF, ..] => Some(u16::from_be_bytes),
        _ => None,
    };
    if let Some(unit) = wide {
        let (pairs, _) = bytes.as_chunks::<2>();
        let units: Vec<u16> = pairs.iter().skip(1).map(|pair| unit(*pair)).collect();
        return String::from_utf16_lossy(&units);
    }
    let text = String::from_utf8_lossy(bytes);
    text.strip_prefix('\u{feff}').unwrap_or(&text).to_owned()
}

/// Reads a file by its name's ending (`.geojson`, `.json`, `.csv`, `.tsv`, `.xml`), or the folder of an AgOpenGPS field or of an ISOXML
/// data set. `frame` says where coordinates in metres are; only CSV files need it.
///
/// # Errors
/// [`ReadError`] names the file.
pub fn path(path: &Path, frame: Option<&Frame>) -> Result<Drawing, ReadError> {
    let name = |error: &dyn fmt::Display| ReadError::new(format!("{}: {error}", path.display()));
    let read = |path: &Path| match std::fs::read(path) {
        Ok(bytes) => Ok(text(&bytes)),
        Err(error) => Err(ReadError::new(format!(
            "{} cannot be read: {error}",
            path.display()
        ))),
    };
    if path.is_dir() {
        let entries = std::fs::read_dir(path).map_err(|error| name(&error))?;
        let mut task_data = entries.flatten().map(|entry| entry.path());
        let is_task_data = |path: &Path| {
            path.file_name()
                .is_some_and(|name| name.eq_ignore_ascii_case("TASKDATA.XML"))
        };
        if let Some(file) = task_data.find(|path| is_task_data(path)) {
            let part = |name: &str| part_file(path, name);
            return isoxml::read_parts(&read(&file)?, &part).map_err(|error| name(&error));
        }
        return agopengps::folder(path).map_err(|error| name(&error));
    }
    let ending = path
        .extension()
        .and_then(|ending| ending.to_str())
        .unwrap_or_default();
    match ending.to_ascii_lowercase().as_str() {
        "geojson" | "json" => geojson::read(&read(path)?),
        "csv" | "tsv" => csv::read(&read(path)?, frame),
        "xml" => {
            let folder = path.parent().unwrap_or(Path::new("."));
            isoxml::read_parts(&read(path)?, &|name| part_file(folder, name))
        }
        _ => Err(ReadError::new(
            "the ending of its name tells no format: .geojson, .json, .csv, .tsv, .xml, the folder of an AgOpenGPS field and \
             that of a TASKDATA.XML are accepted",
        )),
    }
    .map_err(|error| name(&error))
}

/// The text of an ISOXML part file by its name without the ending, if it is there.
fn part_file(folder: &Path, name: &str) -> Option<String> {
    // A name of the file, not a way to another folder.
    if !name.chars().all(|c| c.is_ascii_alphanumeric()) {
        return None;
    }
    let endings = ["XML", "xml"];
    let mut files = endings
        .map(|ending| folder.join(format!("{name}.{ending}")))
        .into_iter();
    files
        .find_map(|file| std::fs::read(file).ok())
        .map(|bytes| text(&bytes))
}
