//! The file of a plan: TOML, as `MISSIONS.md` explains it.

use std::fmt::{self, Write as _};

use serde::de::{self, Deserialize, Deserializer, MapAccess, SeqAccess, Visitor};
use toml::Spanned;
use vehicle_model::text::{line, phrase};
use vehicle_model::units::{Length, Speed};

use super::{End, Join, Leg, Outputs, Plan, PlanError, Problem, Shape};
use crate::place::{Frame, Geodetic, Local, Origin};

/// The fields and tables of a file.
#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: String,
    #[serde(default)]
    end: EndWord,
    width: Option<Length>,
    #[serde(default)]
    fence: Vec<Place>,
    origin: OriginTable,
    #[serde(default)]
    obstacle: Vec<ObstacleTable>,
    #[serde(default)]
    leg: Vec<Spanned<LegTable>>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct OriginTable {
    latitude: Degrees,
    longitude: Degrees,
    #[serde(default)]
    height: Length,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct ObstacleTable {
    corners: Vec<Place>,
}

#[derive(serde::Deserialize)]
#[serde(deny_unknown_fields)]
struct LegTable {
    from: Option<Place>,
    to: Option<Place>,
    points: Option<Vec<Place>>,
    speed: Speed,
    #[serde(default)]
    reverse: bool,
    #[serde(default)]
    outputs: Vec<i64>,
    #[serde(default)]
    join: JoinWord,
}

#[derive(Clone, Copy, Default, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
enum EndWord {
    #[default]
    Stop,
    Repeat,
}

#[derive(Clone, Copy, Default, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
enum JoinWord {
    Continue,
    #[default]
    Turn,
}

/// An angle such as `"40.83 deg"`. It stays in degrees, so that it is written as it was read.
#[derive(Clone, Copy)]
struct Degrees(f64);

impl<'de> Deserialize<'de> for Degrees {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Reader;
        impl Visitor<'_> for Reader {
            type Value = Degrees;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("an angle such as \"40.83 deg\"")
            }

            fn visit_str<E: de::Error>(self, text: &str) -> Result<Degrees, E> {
                let number = text.trim().strip_suffix("deg").map(str::trim_end);
                let value = number.and_then(|number| number.parse::<f64>().ok());
                let value = value.filter(|value| value.is_finite());
                value.map(Degrees).ok_or_else(|| {
                    E::custom(format!(
                        "{text:?} is not an angle: write a number, a blank and the unit deg, such as \"40.83 deg\""
                    ))
                })
            }
        }
        deserializer.deserialize_str(Reader)
    }
}

/// A place of the file: `[north, east]` in metres, or a table with units.
#[derive(Clone, Copy)]
enum Place {
    Local(Local),
    Geodetic(Geodetic),
}

const PLACES: &str = "a place: [north, east] in metres, { north = \"1 m\", east = \"2 m\" } or { latitude = \"40.83 deg\", \
                      longitude = \"-96.66 deg\" }";

/// Keys of a place.
#[derive(serde::Deserialize)]
#[serde(rename_all = "lowercase")]
enum Key {
    North,
    East,
    Latitude,
    Longitude,
}

/// A coordinate in metres: a whole number is one, too.
struct Number(f64);

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        f64::deserialize(deserializer).map(Self)
    }
}

struct PlaceReader;

impl<'de> Visitor<'de> for PlaceReader {
    type Value = Place;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(PLACES)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Place, A::Error> {
        let mut number = |index| {
            let number = list.next_element::<Number>()?;
            number.ok_or_else(|| de::Error::invalid_length(index, &self))
        };
        let place = Local::new(number(0)?.0, number(1)?.0);
        match list.next_element::<de::IgnoredAny>()? {
            None => Ok(Place::Local(place)),
            Some(_) => Err(de::Error::invalid_length(3, &self)),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut table: A) -> Result<Place, A::Error> {
        let (mut north, mut east, mut latitude, mut longitude) = (None, None, None, None);
        while let Some(key) = table.next_key::<Key>()? {
            match key {
                Key::North => north = Some(table.next_value::<Length>()?),
                Key::East => east = Some(table.next_value::<Length>()?),
                Key::Latitude => latitude = Some(table.next_value::<Degrees>()?),
                Key::Longitude => longitude = Some(table.next_value::<Degrees>()?),
            }
        }
        match (north, east, latitude, longitude) {
            (Some(north), Some(east), None, None) => {
                Ok(Place::Local(Local::new(north.get(), east.get())))
            }
            (None, None, Some(latitude), Some(longitude)) => {
                let place = Geodetic::checked(latitude.0, longitude.0);
                place.map(Place::Geodetic).ok_or_else(|| {
                    de::Error::custom(format!(
                        "{} deg, {} deg is no place of the earth: latitudes from -90 to 90 deg and longitudes from -180 \
                         to 180 deg are accepted",
                        latitude.0, longitude.0
                    ))
                })
            }
            _ => Err(de::Error::custom(format!("write {PLACES}"))),
        }
    }
}

impl<'de> Deserialize<'de> for Place {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(PlaceReader)
    }
}

impl Place {
    fn local(self, frame: &Frame) -> Local {
        match self {
            Self::Local(place) => place,
            Self::Geodetic(place) => frame.local(place),
        }
    }
}

impl LegTable {
    fn leg(&self, frame: &Frame) -> Result<Leg, String> {
        let shape = match (self.from, self.to, &self.points) {
            (Some(from), Some(to), None) => Shape::Line {
                from: from.local(frame),
                to: to.local(frame),
            },
            (None, None, Some(points)) => Shape::Curve {
                points: points.iter().map(|point| point.local(frame)).collect(),
            },
            _ => {
                return Err(
                    "from: a leg has from and to, or points; one of the two is accepted".to_owned(),
                );
            }
        };
        let mut outputs = Outputs(0);
        for section in &self.outputs {
            let known = u8::try_from(*section).ok();
            let known = known.and_then(|section| Outputs::of(&[section]));
            let Some(Outputs(bit)) = known else {
                return Err(format!(
                    "outputs: there is no section {section}, 1 to 8 are accepted"
                ));
            };
            outputs.0 |= bit;
        }
        Ok(Leg {
            shape,
            speed: self.speed.get(),
            reverse: self.reverse,
            outputs,
            join: match self.join {
                JoinWord::Continue => Join::Continue,
                JoinWord::Turn => Join::Turn,
            },
        })
    }
}

/// A path such as `leg[0].from` with its leg or obstacle counted from 1, as people count.
fn counted(path: &str) -> String {
    let parts = path.split_once('[').and_then(|(table, rest)| {
        let (number, field) = rest.split_once(']')?;
        let known = ["leg", "obstacle"].contains(&table);
        let number: usize = number.parse().ok().filter(|_| known)?;
        Some((table, number + 1, field.trim_start_matches('.')))
    });
    match parts {
        Some((table, number, "")) => format!("{table} {number}"),
        Some((table, number, field)) => format!("{table} {number}, {field}"),
        None => path.to_owned(),
    }
}

fn error(place: &str, text: &str, span: Option<std::ops::Range<usize>>, what: &str) -> PlanError {
    let line = line(text, span.map_or(0, |span| span.start));
    PlanError {
        sentence: format!("mission {place}, line {line}, {what}"),
    }
}

pub(super) fn read(text: &str, place: &str) -> Result<Plan, PlanError> {
    let document = toml::Deserializer::parse(text).map_err(|fault| {
        let what = format!("is not TOML: {}", phrase(fault.message()));
        error(place, text, fault.span(), &what)
    })?;
    let file: File = serde_path_to_error::deserialize(document).map_err(|fault| {
        // The segment that stands for the place of a table in the text.
        let path = fault
            .path()
            .to_string()
            .replace(".$__serde_spanned_private_value", "");
        let path = match path {
            path if path == "." || path == "?" => String::new(),
            path => format!("{}: ", counted(&path)),
        };
        let inner = fault.inner();
        let what = format!("{path}{}", phrase(inner.message()));
        error(place, text, inner.span(), &what)
    })?;
    let origin = Origin {
        place: Geodetic {
            latitude: file.origin.latitude.0,
            longitude: file.origin.longitude.0,
        },
        height: file.origin.height.get(),
    };
    let frame = Frame::new(origin);
    let mut legs = Vec::with_capacity(file.leg.len());
    for (index, table) in file.leg.iter().enumerate() {
        legs.push(table.get_ref().leg(&frame).map_err(|what| {
            let what = Problem {
                leg: Some(index),
                what,
            };
            error(place, text, Some(table.span()), &what.to_string())
        })?);
    }
    let plan = Plan {
        name: file.name,
        origin,
        width: file.width.map(Length::get),
        fence: file
            .fence
            .iter()
            .map(|corner| corner.local(&frame))
            .collect(),
        obstacles: file
            .obstacle
            .iter()
            .map(|table| table.corners.iter().map(|at| at.local(&frame)).collect())
            .collect(),
        legs,
        end: match file.end {
            EndWord::Stop => End::Stop,
            EndWord::Repeat => End::Repeat,
        },
    };
    plan.check().map_err(|problem| {
        let span = match problem.leg {
            Some(leg) => file.leg.get(leg).map(Spanned::span),
            None => field_span(text, &problem.what),
        };
        error(place, text, span, &problem.to_string())
    })?;
    Ok(plan)
}

/// Where the field of a problem of the whole plan stands.
fn field_span(text: &str, what: &str) -> Option<std::ops::Range<usize>> {
    let path = what.split(':').next()?;
    let name = path.rsplit('.').next()?.split('[').next()?;
    let key = ["origin.", "fence", "name", "width"]
        .iter()
        .any(|known| path.starts_with(known));
    let obstacle = path
        .strip_prefix("obstacle ")
        .and_then(|number| number.split('[').next()?.parse::<usize>().ok());
    if let Some(number) = obstacle {
        let (at, table) = text.match_indices("[[obstacle]]").nth(number - 1)?;
        return Some(at..at + table.len());
    }
    let mut at = 0;
    for row in text.split_inclusive('\n') {
        let begins = row.trim_start().starts_with(if path.starts_with("fence") {
            "fence"
        } else {
            name
        });
        if key && begins {
            return Some(at..at + row.len());
        }
        at += row.len();
    }
    None
}

/// A quantity as a string of TOML, with all digits.
fn quantity(value: f64, unit: &str) -> String {
    format!("\"{value} {unit}\"")
}

/// `[north, east]`; a number of TOML with a point has all digits of the value.
fn pair(place: Local) -> String {
    format!("[{:?}, {:?}]", place.north, place.east)
}

fn list(out: &mut String, name: &str, places: &[Local]) {
    let _ = writeln!(out, "{name} = [");
    for place in places {
        let _ = writeln!(out, "    {},", pair(*place));
    }
    out.push_str("]\n");
}

pub(super) fn write(plan: &Plan) -> String {
    let mut out = String::from(
        "# A mission of Furrow. Places are [north, east] in metres from the origin, which is the base station.\n",
    );
    // Writing to a string cannot fail.
    let name = toml::Value::String(plan.name.clone());
    let _ = writeln!(out, "name = {name}");
    let end = match plan.end {
        End::Stop => "stop",
        End::Repeat => "repeat",
    };
    let _ = writeln!(out, "end = \"{end}\"");
    if let Some(width) = plan.width {
        let _ = writeln!(out, "width = {}", quantity(width, "m"));
    }
    if !plan.fence.is_empty() {
        list(&mut out, "fence", &plan.fence);
    }
    let Origin { place, height } = plan.origin;
    let _ = writeln!(
        out,
        "\n[origin]\nlatitude = {}\nlongitude = {}\nheight = {}",
        quantity(place.latitude, "deg"),
        quantity(place.longitude, "deg"),
        quantity(height, "m")
    );
    for obstacle in &plan.obstacles {
        out.push_str("\n[[obstacle]]\n");
        list(&mut out, "corners", obstacle);
    }
    for leg in &plan.legs {
        out.push_str("\n[[leg]]\n");
        match &leg.shape {
            Shape::Line { from, to } => {
                let _ = writeln!(out, "from = {}\nto = {}", pair(*from), pair(*to));
            }
            Shape::Curve { points } => list(&mut out, "points", points),
        }
        let _ = writeln!(out, "speed = {}", quantity(leg.speed, "m/s"));
        if leg.reverse {
            out.push_str("reverse = true\n");
        }
        if leg.outputs != Outputs(0) {
            let sections: Vec<String> = leg.outputs.sections().map(|n| n.to_string()).collect();
            let _ = writeln!(out, "outputs = [{}]", sections.join(", "));
        }
        let join = match leg.join {
            Join::Continue => "continue",
            Join::Turn => "turn",
        };
        let _ = writeln!(out, "join = \"{join}\"");
    }
    out
}
