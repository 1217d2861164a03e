//! Tables of points: CSV and its relatives.
//!
//! The first line with text has the headings; before it, `sep=;` may name the separator, as spreadsheets write it. Columns are found by them, in any order and case, with or without a unit in brackets:
//! latitude (`latitude`, `lat`) and longitude (`longitude`, `lon`, `lng`, `long`) in degrees, or north (`north`, `northing`) and east (`east`,
//! `easting`) in metres; a column `name`, `line`, `track` or `id` tells shapes apart, and so does an empty line. Fields are separated by comma,
//! semicolon or tab, whichever the headings have most of; unless that is the comma, numbers may have a decimal comma, and with
//! quotes always. A shape of three points or more whose first point stands again at its end is a boundary, any other one a line. A boundary
//! that lies inside a larger one is an obstacle of that. Other columns are not looked at.
//!
//! A row that is no place is an error: a boundary without one of its corners can be another field.

use super::{Drawing, ReadError, Role, no_place};
use crate::place::{FARTHEST, Frame, Geodetic, Local};

/// Columns of a table.
struct Columns {
    /// Latitude and longitude, or north and east.
    coordinates: (usize, usize),
    metres: bool,
    group: Option<usize>,
    /// How many there are.
    count: usize,
}

impl Columns {
    /// What the two coordinates are, for sentences.
    const fn what(&self) -> (&'static str, &'static str) {
        if self.metres {
            ("north", "east")
        } else {
            ("latitude", "longitude")
        }
    }
}

/// Reads the text of a table. `frame` says where metres are measured from; without one, a table in metres is refused.
///
/// # Errors
/// [`ReadError`] if columns or frame are missing, a row is no place, or there is no row.
pub fn read(text: &str, frame: Option<&Frame>) -> Result<Drawing, ReadError> {
    let empty = |text: &str| {
        let lines = text.lines();
        lines.take_while(|line| line.trim().is_empty()).count()
    };
    let mut before = empty(text);
    let mut head = text.lines().nth(before).unwrap_or_default();
    let named = named_separator(head);
    // What stands before the headings, so that lines are counted from the file's first one.
    let mut blank = String::new();
    if named.is_some() {
        let rest = text.split_inclusive('\n').skip(before + 1);
        blank.extend(std::iter::repeat_n('\n', before + 1));
        blank.extend(rest);
        before = empty(&blank);
        head = blank.lines().nth(before).unwrap_or_default();
    }
    let text = if named.is_some() { &blank } else { text };
    let separator = named.unwrap_or_else(|| separator(head));
    let mut reader = ::csv::ReaderBuilder::new()
        .delimiter(separator)
        .has_headers(false)
        .flexible(true)
        .trim(::csv::Trim::All)
        .from_reader(text.as_bytes());
    let mut records = reader.records();
    let Some(Ok(headings)) = records.next() else {
        return Err(ReadError::new("it has no headings"));
    };
    let columns = columns(&headings)?;
    let Some(frame) = frame.or(if columns.metres { None } else { Some(&EARTH) }) else {
        return Err(ReadError::new(
            "its columns are metres north and east, so the latitude and longitude of their origin are needed: --origin LATITUDE,LONGITUDE",
        ));
    };
    let mut table = Table {
        drawing: Drawing::new("CSV"),
        group: None,
        points: Vec::new(),
        last: before + 1,
    };
    for record in records {
        // Text is UTF-8 and rows may have any length, so no row is an error.
        let Ok(record) = record else { continue };
        // Files that were put together repeat their headings.
        if record == headings {
            table.end();
            continue;
        }
        let line = line(&record, text);
        let row = table.row(&record, line, &columns, separator, frame);
        row.map_err(|why| ReadError::new(format!("line {line}: {why}")))?;
    }
    table.end();
    table.drawing.nest();
    table.drawing.finish()
}

/// The line of a row, counted from 1. The reader's own position is before the empty lines that it passes over.
fn line(row: &::csv::StringRecord, text: &str) -> usize {
    let Some(position) = row.position() else {
        return 0;
    };
    let before = text.bytes().skip(position.byte() as usize);
    let breaks = before.take_while(|byte| matches!(byte, b'\n' | b'\r'));
    position.line() as usize + breaks.filter(|byte| *byte == b'\n').count()
}

/// For tables in degrees, which need no frame.
static EARTH: std::sync::LazyLock<Frame> =
    std::sync::LazyLock::new(|| Frame::new(crate::place::Origin::default()));

/// The separator that a first line such as `sep=;` names.
fn named_separator(line: &str) -> Option<u8> {
    let line = line.trim_matches(['"', ' ', '\r']).to_lowercase();
    match line.strip_prefix("sep=")?.as_bytes() {
        [one @ (b',' | b';' | b'\t')] => Some(*one),
        _ => None,
    }
}

/// The separator of which the headings have most.
fn separator(head: &str) -> u8 {
    let count = |byte: u8| head.bytes().filter(|other| *other == byte).count();
    let mut separators = [b',', b';', b'\t'];
    separators.sort_by_key(|byte| std::cmp::Reverse(count(*byte)));
    separators[0]
}

/// A heading without its unit, in lower case.
fn heading(text: &str) -> String {
    let text = text.split(['(', '[']).next().unwrap_or_default();
    let text = text.trim().trim_matches('"').trim().to_lowercase();
    for unit in ["_m", "_deg", " m", " deg"] {
        if let Some(text) = text.strip_suffix(unit) {
            return text.trim().to_owned();
        }
    }
    text
}

/// The unit in brackets of a heading, if it has one.
fn unit(text: &str) -> Option<&str> {
    let (_, rest) = text.split_once(['(', '['])?;
    Some(rest.trim_end_matches([')', ']', ' ', '"']).trim())
}

/// Coordinates in another unit would be taken for metres or degrees.
fn check_units(
    headings: &::csv::StringRecord,
    coordinates: (usize, usize),
    metres: bool,
) -> Result<(), ReadError> {
    let (what, units): (_, &[&str]) = if metres {
        ("metres", &["m", "metre", "metres", "meter", "meters"])
    } else {
        ("degrees", &["deg", "degree", "degrees", "\u{b0}"])
    };
    for text in
        [coordinates.0, coordinates.1].map(|column| headings.get(column).unwrap_or_default())
    {
        if let Some(unit) = unit(text)
            && !units.contains(&unit.to_lowercase().as_str())
        {
            return Err(ReadError::new(format!(
                "the heading {:?}: {what} are accepted, with ({}) or without a unit",
                text.trim(),
                units[0]
            )));
        }
    }
    Ok(())
}

fn columns(headings: &::csv::StringRecord) -> Result<Columns, ReadError> {
    let texts = headings;
    let headings: Vec<String> = headings.iter().map(heading).collect();
    let find = |names: &[&str]| {
        let mut names = names.iter();
        names.find_map(|name| headings.iter().position(|heading| heading == name))
    };
    let degrees = (
        find(&["latitude", "lat"]),
        find(&["longitude", "lon", "lng", "long"]),
    );
    let metres = (find(&["north", "northing"]), find(&["east", "easting"]));
    let (coordinates, metres) = match (degrees, metres) {
        ((Some(latitude), Some(longitude)), _) => ((latitude, longitude), false),
        (_, (Some(north), Some(east))) => ((north, east), true),
        _ => {
            return Err(ReadError::new(format!(
                "its headings are {}: columns latitude and longitude, or north and east, are needed",
                headings.join(", ")
            )));
        }
    };
    check_units(texts, coordinates, metres)?;
    Ok(Columns {
        coordinates,
        metres,
        group: find(&["name", "line", "track", "id"]),
        count: headings.len(),
    })
}

/// A table while it is read.
struct Table {
    drawing: Drawing,
    /// Name of the current shape.
    group: Option<String>,
    points: Vec<Geodetic>,
    /// Line of the last row.
    last: usize,
}

/// A number with a decimal point, or with a decimal comma.
fn number(field: &str) -> Option<f64> {
    let field = field.trim().trim_end_matches('°').trim();
    let value = match field.split_once(',') {
        Some((whole, rest)) if !rest.contains([',', '.']) && !whole.contains('.') => {
            format!("{whole}.{rest}").parse().ok()
        }
        _ => field.parse().ok(),
    };
    value.filter(|value: &f64| value.is_finite())
}

/// Why a row is no place, if decimal commas may be the cause.
fn commas(separator: u8) -> &'static str {
    match separator {
        b',' => " (decimal commas need another separator or quotes)",
        _ => "",
    }
}

impl Table {
    /// A row.
    ///
    /// # Errors
    /// It is no place.
    fn row(
        &mut self,
        row: &::csv::StringRecord,
        line: usize,
        columns: &Columns,
        separator: u8,
        frame: &Frame,
    ) -> Result<(), String> {
        let empty = row.iter().all(str::is_empty);
        // The reader passes over lines without a character.
        if line > self.last + 1 || empty {
            self.end();
        }
        self.last = line;
        if empty {
            return Ok(());
        }
        let name = columns.group.and_then(|group| row.get(group));
        if name.map(str::to_owned) != self.group && columns.group.is_some() {
            self.end();
            self.group = name.map(str::to_owned);
        }
        if row
            .iter()
            .skip(columns.count)
            .any(|field| !field.is_empty())
        {
            return Err(format!(
                "it has {} fields, as many as there are headings are accepted, {}{}",
                row.len(),
                columns.count,
                commas(separator)
            ));
        }
        let (first, second) = columns.coordinates;
        let what = columns.what();
        let field = |index: usize, what: &str| {
            let text = row.get(index).unwrap_or_default();
            number(text).ok_or_else(|| {
                format!(
                    "{what} is {text:?}, a number is accepted in each row{}",
                    commas(separator)
                )
            })
        };
        let (first, second) = (field(first, what.0)?, field(second, what.1)?);
        let place = match columns.metres {
            false => Geodetic::checked(first, second),
            true if first.abs() <= FARTHEST && second.abs() <= FARTHEST => {
                Some(frame.geodetic(Local::new(first, second)))
            }
            true => None,
        };
        match place {
            Some(place) => self.points.push(place),
            None if columns.metres => {
                return Err(format!(
                    "{first} m north, {second} m east, at most {FARTHEST} m from the origin are accepted"
                ));
            }
            None => return Err(no_place(first, second)),
        }
        Ok(())
    }

    /// The current shape is complete.
    fn end(&mut self) {
        let points = std::mem::take(&mut self.points);
        let name = self.group.clone();
        let name = name.as_deref();
        match points[..] {
            [] => {}
            [first, .., last] if first == last && points.len() > 3 => {
                self.drawing
                    .add_polygon(name, Role::Boundary, points, Vec::new());
            }
            _ => self.drawing.add_line(name, Role::Guidance, points),
        }
    }
}
