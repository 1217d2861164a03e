//! The field folder of AgOpenGPS.
//!
//! The formats are those of its sources (AgOpenGPS-Official/AgOpenGPS; `SourceCode/GPS/IO` at d3cfa14 of 2026, and
//! `Forms/SaveOpen.Designer.cs` of 2021 to 2025 for the older files). All are lines of text, numbers with decimal points, coordinates
//! easting, northing in metres from the `StartFix` of `Field.txt`:
//!
//! | file | lines |
//! | --- | --- |
//! | `Field.txt` | somewhere `StartFix`, then `latitude,longitude` |
//! | `Boundary.txt` | `$Boundary`; for each ring up to two flags `True`/`False`, the number of points, then `easting,northing,heading`. The first ring is the field; the first flag of a further one says that it may be driven through |
//! | `ABLines.txt` | `name,heading in degrees,easting,northing` of a point on the line |
//! | `CurveLines.txt` | `$CurveLines`; for each curve its name, mean heading in radians, number of points, `easting,northing,heading` |
//! | `TrackLines.txt` | `$TrackLines`; for each track its name, heading in radians, `easting,northing` of A and of B, nudge (m, to the right), mode, `True`/`False` for visible (the others are left out), number of points, the points. Mode 2 is a line, 4 a curve, 8, 16 and 32 curves along a boundary, 64 a pivot. `$TwolTracks` has two more lines for each track |
//!
//! Its plane is not the tangent plane: degrees are multiplied by the lengths of a degree (`LocalPlane.cs`), that of longitude at the
//! latitude of the point. The readers undo just that, so a place is where AgOpenGPS had it on the earth.

use std::path::Path;

use super::{DIRECTED, Drawing, ReadError, Role, text};
use crate::place::{FARTHEST, Geodetic, Local};

/// Texts of the files of a field; those that it has not are `None`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Files<'a> {
    /// `Field.txt`.
    pub field: &'a str,
    /// `Boundary.txt`.
    pub boundary: Option<&'a str>,
    /// `ABLines.txt`.
    pub ab_lines: Option<&'a str>,
    /// `CurveLines.txt`.
    pub curve_lines: Option<&'a str>,
    /// `TrackLines.txt`. It is newer than the two before, which are not read if it has a track.
    pub track_lines: Option<&'a str>,
}

/// Most points or tracks that a count of a file may announce.
const MOST: usize = 1_000_000;

/// Reads the files of a folder.
///
/// # Errors
/// [`ReadError`] without `Field.txt` or a boundary or line.
pub fn folder(folder: &Path) -> Result<Drawing, ReadError> {
    let load = |name: &str| {
        std::fs::read(folder.join(name))
            .ok()
            .map(|bytes| text(&bytes))
    };
    let Some(field) = load("Field.txt") else {
        return Err(ReadError::new(
            "it has no Field.txt, which the folder of an AgOpenGPS field has",
        ));
    };
    let names = [
        "Boundary.txt",
        "ABLines.txt",
        "CurveLines.txt",
        "TrackLines.txt",
    ];
    let [boundary, ab_lines, curve_lines, track_lines] = names.map(load);
    read(&Files {
        field: &field,
        boundary: boundary.as_deref(),
        ab_lines: ab_lines.as_deref(),
        curve_lines: curve_lines.as_deref(),
        track_lines: track_lines.as_deref(),
    })
}

/// Reads the texts of a field's files.
///
/// # Errors
/// [`ReadError`] if there is no `StartFix`, a line of the boundary is none, or there is no boundary and no line.
pub fn read(files: &Files) -> Result<Drawing, ReadError> {
    let plane = Plane::new(start_fix(files.field)?);
    let mut drawing = Drawing::new("AgOpenGPS");
    drawing.origin = Some(plane.origin);
    let mut field = Field { plane, drawing };
    if let Some(text) = files.boundary {
        field.boundary(&mut Lines::new(text, "Boundary.txt"))?;
    }
    let parts = |drawing: &Drawing| drawing.shapes.len() + drawing.skipped.len();
    let before = parts(&field.drawing);
    if let Some(text) = files.track_lines {
        field.tracks(&mut Lines::new(text, "TrackLines.txt"));
    }
    if parts(&field.drawing) == before {
        if let Some(text) = files.ab_lines {
            field.ab_lines(text);
        }
        if let Some(text) = files.curve_lines {
            field.curves(&mut Lines::new(text, "CurveLines.txt"));
        }
    }
    field.drawing.finish()
}

/// The place after the line `StartFix`.
fn start_fix(text: &str) -> Result<Geodetic, ReadError> {
    let is_start = |line: &&str| {
        let word = line.trim().get(..8);
        word.is_some_and(|word| word.eq_ignore_ascii_case("StartFix"))
    };
    let mut lines = text.lines().skip_while(|line| !is_start(line));
    if lines.next().is_none() {
        return Err(ReadError::new("its Field.txt has no line StartFix"));
    }
    let fix = lines.next().unwrap_or_default();
    // Decimal commas would make four numbers, of which the first two are another place.
    let numbers: Option<Vec<f64>> = fix
        .split(',')
        .map(|part| part.trim().parse().ok())
        .collect();
    let place = match numbers.as_deref() {
        Some([latitude, longitude]) => Geodetic::checked(*latitude, *longitude),
        _ => None,
    };
    let place = place.filter(|place| place.latitude.abs() < 89.0);
    place.ok_or_else(|| {
        ReadError::new(format!(
            "its Field.txt has {fix:?} below StartFix, two numbers with decimal points and a comma between them are accepted: a \
             latitude within 89 degrees of the equator and a longitude"
        ))
    })
}

/// The numbers of a line with commas, up to the first field that is none.
fn numbers(line: &str) -> Vec<f64> {
    let fields = line
        .split(',')
        .map(|field| field.trim().parse::<f64>().ok());
    fields
        .map_while(|number| number.filter(|number| number.is_finite()))
        .collect()
}

/// AgOpenGPS's plane.
struct Plane {
    origin: Geodetic,
    /// Metres in a degree of latitude.
    latitude: f64,
}

impl Plane {
    fn new(origin: Geodetic) -> Self {
        let angle = origin.latitude.to_radians();
        Self {
            origin,
            latitude: 111_132.92 - 559.82 * (2.0 * angle).cos() + 1.175 * (4.0 * angle).cos()
                - 0.0023 * (6.0 * angle).cos(),
        }
    }

    /// Metres in a degree of longitude at a latitude in degrees.
    fn longitude(latitude: f64) -> f64 {
        let angle = latitude.to_radians();
        111_412.84 * angle.cos() - 93.5 * (3.0 * angle).cos() + 0.118 * (5.0 * angle).cos()
    }

    /// A place of the plane; `None` if it is too far away to be one of the field.
    fn place(&self, place: Local) -> Option<Geodetic> {
        if !(place.north.abs() <= FARTHEST && place.east.abs() <= FARTHEST) {
            return None;
        }
        let latitude = self.origin.latitude + place.north / self.latitude;
        let longitude = self.origin.longitude + place.east / Self::longitude(latitude);
        Geodetic::checked(latitude, longitude - 360.0 * (longitude / 360.0).round())
    }
}

/// The lines of a file.
struct Lines<'a> {
    lines: std::iter::Peekable<std::iter::Enumerate<std::str::Lines<'a>>>,
    /// Number of the last line, counted from 1.
    number: usize,
    file: &'static str,
}

impl<'a> Lines<'a> {
    fn new(text: &'a str, file: &'static str) -> Self {
        Self {
            lines: text.lines().enumerate().peekable(),
            number: 0,
            file,
        }
    }

    fn next(&mut self) -> Option<&'a str> {
        let (index, line) = self.lines.next()?;
        self.number = index + 1;
        Some(line.trim())
    }

    /// The next line that is not empty.
    fn filled(&mut self) -> Option<&'a str> {
        while let Some(line) = self.next() {
            if !line.is_empty() {
                return Some(line);
            }
        }
        None
    }

    /// A heading `$...`, if it is the next line.
    fn heading(&mut self) -> Option<&'a str> {
        let (_, line) = self.lines.peek()?;
        let line = line.trim().trim_start_matches('\u{feff}');
        line.starts_with('$').then(|| {
            self.next();
            line
        })
    }

    /// The next line as a number of points.
    fn count(&mut self) -> Option<usize> {
        let count = self.next()?.parse().ok()?;
        (count <= MOST).then_some(count)
    }
}

struct Field {
    plane: Plane,
    drawing: Drawing,
}

/// The file is cut or damaged here.
struct Cut;

impl Field {
    /// Leaves out the rest of a file.
    fn cut(&mut self, lines: &Lines) {
        let why = format!(
            "the rest of {}, which is not as AgOpenGPS writes it",
            lines.file
        );
        self.drawing.skip(why, Some(lines.number.max(1)));
    }

    /// The next `count` lines as places. Lines that are none are counted and left out, as AgOpenGPS does.
    fn points(&mut self, lines: &mut Lines, count: usize) -> Result<Vec<Local>, Cut> {
        let mut points = Vec::new();
        for _ in 0..count {
            let line = lines.next().ok_or(Cut)?;
            match numbers(line)[..] {
                [east, north, ..] => points.push(Local::new(north, east)),
                _ => {
                    let why = format!("a line of {} that is no point", lines.file);
                    self.drawing.skip(why, Some(lines.number));
                }
            }
        }
        Ok(points)
    }

    /// Places on the earth. Those too far away are counted and left out.
    fn places(&mut self, points: &[Local], lines: &Lines) -> Vec<Geodetic> {
        let mut places = Vec::with_capacity(points.len());
        for point in points {
            match self.plane.place(*point) {
                Some(place) => places.push(place),
                None => {
                    let why = format!(
                        "a point of {} more than {FARTHEST} m from the StartFix",
                        lines.file
                    );
                    self.drawing.skip(why, Some(lines.number));
                }
            }
        }
        places
    }

    /// The next `count` lines as the corners of a boundary.
    ///
    /// # Errors
    /// One is none: without it this would be another field.
    fn corners(&self, lines: &mut Lines, count: usize) -> Result<Vec<Geodetic>, ReadError> {
        let corner = |_| {
            let line = lines.next().unwrap_or_default();
            let place = match numbers(line)[..] {
                [east, north, ..] => self.plane.place(Local::new(north, east)),
                _ => None,
            };
            place.ok_or_else(|| {
                ReadError::new(format!(
                    "line {} of {} is {line:?}: easting, northing and heading of a corner are accepted, at most {FARTHEST} m \
                     from the StartFix",
                    lines.number, lines.file
                ))
            })
        };
        (0..count).map(corner).collect()
    }

    fn boundary(&mut self, lines: &mut Lines) -> Result<(), ReadError> {
        lines.heading();
        let mut rings: Vec<Vec<Geodetic>> = Vec::new();
        let mut number = 0;
        while let Some(mut line) = lines.filled() {
            let mut through = false;
            for first in [true, false] {
                if line.eq_ignore_ascii_case("true") || line.eq_ignore_ascii_case("false") {
                    through |= first && line.eq_ignore_ascii_case("true");
                    line = lines.next().unwrap_or_default();
                }
            }
            let Some(count) = line.parse().ok().filter(|count| *count <= MOST) else {
                return Err(ReadError::new(format!(
                    "line {} of {} is {line:?}, and the number of a boundary's corners is accepted",
                    lines.number, lines.file
                )));
            };
            let ring = self.corners(lines, count)?;
            match number {
                0 => rings.push(ring),
                _ if through => self.drawing.skip(
                    "an inner boundary that may be driven through",
                    Some(lines.number),
                ),
                _ => rings.push(ring),
            }
            number += 1;
        }
        if !rings.is_empty() {
            let outer = rings.remove(0);
            self.drawing.add_polygon(None, Role::Boundary, outer, rings);
        }
        Ok(())
    }

    fn ab_lines(&mut self, text: &str) {
        for (index, line) in text.lines().enumerate() {
            let line = line.trim();
            if line.is_empty() || line.starts_with('$') {
                continue;
            }
            let (name, rest) = line.split_once(',').unwrap_or((line, ""));
            let places = match numbers(rest)[..] {
                [heading, east, north] => {
                    let from = Local::new(north, east);
                    let to = from.towards(heading.to_radians(), DIRECTED);
                    self.plane.place(from).zip(self.plane.place(to))
                }
                _ => None,
            };
            match places {
                Some((from, to)) => self.drawing.add_directed(Some(name), from, to),
                None => self
                    .drawing
                    .skip("a line of ABLines.txt that is none", Some(index + 1)),
            }
        }
    }

    fn curves(&mut self, lines: &mut Lines) {
        lines.heading();
        while let Some(name) = lines.filled() {
            let heading = lines.next();
            let count = heading.and_then(|_| lines.count());
            let Some(Ok(points)) = count.map(|count| self.points(lines, count)) else {
                self.cut(lines);
                return;
            };
            let places = self.places(&points, lines);
            self.drawing.add_line(Some(name), Role::Guidance, places);
        }
    }

    fn tracks(&mut self, lines: &mut Lines) {
        let heading = lines.heading();
        let more = if heading == Some("$TwolTracks") { 2 } else { 0 };
        while let Some(name) = lines.filled() {
            if self.track(lines, name).is_err() {
                self.cut(lines);
                return;
            }
            for _ in 0..more {
                lines.next();
            }
        }
    }

    fn track(&mut self, lines: &mut Lines, name: &str) -> Result<(), Cut> {
        let mut values = || lines.next().map(numbers).ok_or(Cut);
        let (_heading, a, b, nudge) = (values()?, values()?, values()?, values()?);
        let ([a_east, a_north], [b_east, b_north], [nudge]) = (&a[..], &b[..], &nudge[..]) else {
            return Err(Cut);
        };
        let mode: u32 = lines.next().and_then(|line| line.parse().ok()).ok_or(Cut)?;
        let visible = lines.next().ok_or(Cut)?;
        let count = lines.count().ok_or(Cut)?;
        let points = self.points(lines, count)?;
        if visible.eq_ignore_ascii_case("false") {
            self.drawing
                .skip("a track that is switched off", Some(lines.number));
            return Ok(());
        }
        let (a, b) = (Local::new(*a_north, *a_east), Local::new(*b_north, *b_east));
        let points = match mode {
            2 => {
                let right = a.bearing(b) + std::f64::consts::FRAC_PI_2;
                vec![a.towards(right, *nudge), b.towards(right, *nudge)]
            }
            4 | 8 | 16 | 32 => {
                if *nudge != 0.0 {
                    self.drawing.skip(
                        "the nudge of a curve: its points are read as they stand",
                        Some(lines.number),
                    );
                }
                points
            }
            64 => {
                self.drawing
                    .skip("a pivot, which is no line", Some(lines.number));
                return Ok(());
            }
            _ => {
                self.drawing
                    .skip("a track of an unknown mode", Some(lines.number));
                return Ok(());
            }
        };
        let places = self.places(&points, lines);
        self.drawing.add_line(Some(name), Role::Guidance, places);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_plane_is_agopengps_s() {
        // A second of arc at 40 degrees: series of the length of a degree (Snyder, Map Projections, table 10-1: 111 035 m of
        // latitude, 85 394 m of longitude at 40 degrees).
        let plane = Plane::new(Geodetic {
            latitude: 40.0,
            longitude: -97.0,
        });
        assert!(
            (plane.latitude - 111_035.0).abs() < 1.0,
            "{}",
            plane.latitude
        );
        assert!((Plane::longitude(40.0) - 85_394.0).abs() < 1.0);
        let place = plane
            .place(Local::new(plane.latitude / 100.0, 0.0))
            .unwrap();
        assert!((place.latitude - 40.01).abs() < 1e-12);
        assert_eq!(plane.place(Local::new(0.0, 10_001.0)), None);
    }
}
