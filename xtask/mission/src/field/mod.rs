//! A field from its boundary: headland, swaths, their order, and what they cover.
//!
//! The headland is a band along the boundary and round every hole, with arcs round the corners of holes and notches. What it
//! leaves is the inner area, of which there may be several parts. Swaths lie side by side in one direction. There are as few as cover the
//! inner area from side to side; they stand symmetrically, so the outer ones reach equally far into the headland. Where a swath
//! crosses a notch or a hole it is cut into pieces.
//!
//! Swaths are driven in blocks: neighbours that lie beside each other as a whole (the cells of a boustrophedon decomposition,
//! Choset and Pignon 1997). Within a block the order is that of [`Order`], the direction alternates, and the next block is the one
//! that begins nearest. The way between blocks is left to the vehicle's turns; it can lead through a hole.

mod headland;
mod order;
mod swaths;

use std::fmt;

use geo::bool_ops::FillRule;
use geo::buffer::{BufferStyle, LineJoin};
use geo::{Area as _, BooleanOps as _, Intersects as _, MultiPolygon, Orient as _, Polygon};

use crate::place::{Frame, Local, Origin};
use crate::plan::{End, Join, Leg, Outputs, Plan, Shape};
use crate::polygon;
use crate::read;

/// Most swaths of a field.
pub const MOST_SWATHS: usize = crate::plan::MOST_LEGS;
/// Angle of a piece of an arc round a corner, rad: at 10 m it is 1 cm inside the arc.
const ARC: f64 = 0.1;
/// Corners nearer to each other than this are one, m.
const SAME: f64 = 1e-3;
/// Least area that counts as a part of the inner area, m2.
const LEAST_PART: f64 = 1.0;

/// An area with holes. No ring has its first corner again at the end.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Area {
    /// Its edge.
    pub outer: Vec<Local>,
    /// Rings that are cut out of it.
    pub holes: Vec<Vec<Local>>,
}

impl Area {
    /// A polygon of a drawing in the local frame; `None` for a line or a curve.
    #[must_use]
    pub fn of(shape: &read::Shape, frame: &Frame) -> Option<Self> {
        let ring = |ring: &Vec<_>| ring.iter().map(|place| frame.local(*place)).collect();
        match shape {
            read::Shape::Polygon { outer, holes } => Some(Self {
                outer: ring(outer),
                holes: holes.iter().map(ring).collect(),
            }),
            read::Shape::Line { .. } | read::Shape::Curve(_) => None,
        }
    }

    fn polygon(&self) -> Polygon {
        let holes = self.holes.iter().map(|hole| polygon::ring(hole)).collect();
        Polygon::new(polygon::ring(&self.outer), holes)
    }

    /// What is inside the edge and in no hole, though the holes may overlap, cross the edge, and have either direction. What the edge goes
    /// round the other way, or twice, counts as inside.
    fn free(&self) -> MultiPolygon {
        let holes: Vec<Polygon> = self
            .holes
            .iter()
            .flat_map(|hole| simple(hole))
            .map(|hole| polygon_of(&hole).orient(geo::orient::Direction::Default))
            .collect();
        whole(&self.outer).difference(&geo::unary_union(&holes))
    }

    fn from_polygon(shape: &Polygon) -> Self {
        let holes = shape.interiors().iter().map(polygon::corners).collect();
        Self {
            outer: polygon::corners(shape.exterior()),
            holes,
        }
    }

    /// Its size without its holes, m2.
    #[must_use]
    pub fn size(&self) -> f64 {
        self.free().unsigned_area()
    }

    /// All rings, the edge first.
    pub fn rings(&self) -> impl Iterator<Item = &Vec<Local>> {
        std::iter::once(&self.outer).chain(&self.holes)
    }
}

/// The fields of a drawing with their names: its boundaries, with their holes and the obstacles that reach into each. Each hole is a simple ring.
#[must_use]
pub fn areas(drawing: &read::Drawing, frame: &Frame) -> Vec<(String, Area)> {
    let obstacles = obstacles(drawing, frame);
    let boundaries = drawing.shapes.iter();
    let boundaries = boundaries.filter(|named| named.role == read::Role::Boundary);
    let mut areas = Vec::new();
    for named in boundaries {
        let Some(mut area) = Area::of(&named.shape, frame) else {
            continue;
        };
        let holes: Vec<_> = area.holes.iter().flat_map(|hole| simple(hole)).collect();
        let within = obstacles.iter().filter(|ring| touch(&area.outer, ring));
        area.holes = holes.into_iter().chain(within.cloned()).collect();
        areas.push((named.name.clone(), area));
    }
    areas
}

/// The obstacles of a drawing near the frame's origin, as simple rings.
#[must_use]
pub fn obstacles(drawing: &read::Drawing, frame: &Frame) -> Vec<Vec<Local>> {
    let shapes = drawing.shapes.iter();
    let obstacles = shapes.filter(|named| named.role == read::Role::Obstacle);
    obstacles
        .filter_map(|named| match &named.shape {
            read::Shape::Polygon { outer, .. } => Some(outer),
            _ => None,
        })
        .filter(|outer| outer.first().is_some_and(|place| frame.is_near(*place)))
        .flat_map(|outer| {
            let corners: Vec<Local> = outer.iter().map(|place| frame.local(*place)).collect();
            simple(&corners)
        })
        .collect()
}

/// Rings that together enclose what a ring does, each without a crossing, and each all of one direction: where rings of both
/// directions are joined, those of the other one vanish. What a ring encloses twice counts as enclosed.
fn simple(ring: &[Local]) -> Vec<Vec<Local>> {
    let parts: Vec<Vec<Local>> = whole(ring)
        .iter()
        .map(|part| apart(polygon::corners(part.exterior())))
        .filter(|corners| corners.len() >= 3)
        .collect();
    match parts.is_empty() {
        // Without an area: a pole, or a wall without a width.
        true => vec![ring.to_vec()],
        false => parts,
    }
}

/// A ring without corners that are the same one in single precision, with which vehicles compute.
fn apart(mut corners: Vec<Local>) -> Vec<Local> {
    let same = |one: &Local, other: &Local| one.distance(*other) < SAME;
    corners.dedup_by(|next, last| same(next, last));
    while corners.len() > 1 && same(&corners[0], &corners[corners.len() - 1]) {
        corners.pop();
    }
    corners
}

/// True if two rings have a place in common.
#[must_use]
pub fn touch(one: &[Local], other: &[Local]) -> bool {
    polygon_of(one).intersects(&polygon_of(other))
}

/// True if a line has a place inside a ring.
#[must_use]
pub fn reaches(ring: &[Local], line: &[Local]) -> bool {
    let line: geo::LineString = line.iter().copied().map(polygon::coord).collect();
    polygon_of(ring).intersects(&line)
}

/// The area that two rings have in common, m2.
#[must_use]
pub fn shared(one: &[Local], other: &[Local]) -> f64 {
    whole(one).intersection(&whole(other)).unsigned_area()
}

/// The area of holes that is neither in an obstacle nor outside the fence, m2: a vehicle could be driven there. No fence encloses
/// everything.
#[must_use]
pub fn left_open(holes: &[Vec<Local>], fence: &[Local], obstacles: &[Vec<Local>]) -> f64 {
    let holes = holes.iter().flat_map(|hole| simple(hole));
    let open = holes.map(|hole| {
        let mut rest = MultiPolygon::new(vec![polygon_of(&hole)]);
        if !fence.is_empty() {
            rest = rest.intersection(&polygon_of(fence));
        }
        for obstacle in obstacles {
            rest = rest.difference(&polygon_of(obstacle));
        }
        rest.unsigned_area()
    });
    open.sum()
}

fn polygon_of(ring: &[Local]) -> Polygon {
    Polygon::new(polygon::ring(ring), Vec::new())
}

/// All that a ring goes round, in whatever direction.
fn whole(ring: &[Local]) -> MultiPolygon {
    let empty = MultiPolygon::new(Vec::new());
    polygon_of(ring).union_with_fill_rule(&empty, FillRule::NonZero)
}

/// The piece of a line that lies inside a field, `margin` metres or more from its edge and its holes, and is nearest to where the line
/// begins. The line goes on in both directions. `None` if it passes the field by.
#[must_use]
pub fn inside(area: &Area, margin: f64, from: Local, to: Local) -> Option<(Local, Local)> {
    let bearing = from.bearing(to);
    let far = 3.0 * crate::place::FARTHEST;
    let line: geo::LineString = [from.towards(bearing, -far), from.towards(bearing, far)]
        .into_iter()
        .map(polygon::coord)
        .collect();
    let room = match margin > 0.0 {
        true => inset(&area.free(), margin),
        false => area.free(),
    };
    let cut = room.clip(&geo::MultiLineString::new(vec![line]), false);
    let ends = cut.iter().filter_map(|piece| {
        let place = |at: &geo::Coord| Local::new(at.y, at.x);
        let (one, other) = (place(piece.0.first()?), place(piece.0.last()?));
        // In the direction of the line.
        let turned = (one.bearing(other) - bearing).cos() < 0.0;
        Some(if turned { (other, one) } else { (one, other) })
    });
    let away = |(one, other): &(Local, Local)| polygon::distance_to_piece(from, *one, *other);
    ends.min_by(|one, other| away(one).total_cmp(&away(other)))
}

/// How a field is divided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Working width, m: the distance between swaths.
    pub width: f64,
    /// Width of the headland, m; 0 without one.
    pub headland: f64,
    /// Direction of the swaths.
    pub direction: Direction,
    /// Where they end.
    pub ends: Ends,
    /// Their order.
    pub order: Order,
    /// Radius of the tightest turn, m; 0 if the vehicle turns on the spot.
    pub radius: f64,
    /// Pieces of swaths shorter than this are left out, m.
    pub shortest: f64,
    /// Where the vehicle stands. The block that begins nearest is the first one.
    pub start: Option<Local>,
}

impl Options {
    /// Swaths of this width, with a headland of twice the width, in the best direction, one beside the other.
    #[must_use]
    pub const fn new(width: f64) -> Self {
        Self {
            width,
            headland: 2.0 * width,
            direction: Direction::Auto,
            ends: Ends::Middle,
            order: Order::Neighbouring,
            radius: 0.0,
            shortest: 1.0,
            start: None,
        }
    }
}

/// Direction of swaths.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Direction {
    /// The one with the fewest pieces; of several, the one whose pieces are longest together, because they cover most. Whole degrees and
    /// the directions of the longest edges are tried.
    Auto,
    /// Radians clockwise from north.
    Bearing(f64),
}

/// Where a swath ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ends {
    /// Where its middle leaves the inner area. Where the edge is slanted, a triangle of the inner area stays uncovered.
    Middle,
    /// Where all of its width has left the inner area: it covers the triangle, and as much of the headland beside it. Its middle stays
    /// as far from the edge of the field as the headland is wide, less half a width; without a headland it stays inside the field.
    Whole,
}

/// Order of the swaths of a block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Order {
    /// Each beside the one before.
    Neighbouring,
    /// Swaths are left out and driven later, so that each is at least two turning radii from the one before: then every turn is
    /// a U, and none an omega. In groups of 2 s + 1 swaths, with s the least number of swaths that are two radii apart: 0, s + 1, 1, s +
    /// 2, ..., s.
    Skip,
}

/// A piece of a swath.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Swath {
    /// Where it begins.
    pub from: Local,
    /// Where it ends.
    pub to: Local,
    /// Which swath it is of, counted from the left as seen in the direction of the swaths.
    pub track: usize,
    /// Which block it is in.
    pub block: usize,
}

impl Swath {
    /// Length, m.
    #[must_use]
    pub fn length(&self) -> f64 {
        self.from.distance(self.to)
    }

    /// Corners of the strip that it covers.
    #[must_use]
    pub fn strip(&self, width: f64) -> [Local; 4] {
        let right = self.from.bearing(self.to) + std::f64::consts::FRAC_PI_2;
        let half = 0.5 * width;
        [
            self.from.towards(right, -half),
            self.to.towards(right, -half),
            self.to.towards(right, half),
            self.from.towards(right, half),
        ]
    }
}

/// A field with its swaths.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// The field, without crossings of its edge.
    pub area: Area,
    /// The inner area: the field less its headland, in parts.
    pub inner: Vec<Area>,
    /// Direction of the swaths, rad clockwise from north in [0, pi).
    pub bearing: f64,
    /// Their pieces in driving order.
    pub swaths: Vec<Swath>,
    /// Areas.
    pub coverage: Coverage,
    /// Pieces that are shorter than the least length, and were left out.
    pub too_short: usize,
    /// Turns from one swath to another of its block that are less than two turning radii wide.
    pub tight_turns: usize,
    /// The options it was made with.
    pub options: Options,
}

/// Areas of a field, m2.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coverage {
    /// The field.
    pub field: f64,
    /// The inner area.
    pub inner: f64,
    /// The part of the inner area that swaths cover.
    pub covered: f64,
    /// Swath area outside the inner area.
    pub outside: f64,
    /// Overlap of swaths: the sum of their areas less the area of their union.
    pub twice: f64,
    /// Area cut off because the edge of the field crosses itself.
    pub lost: f64,
}

impl Coverage {
    /// Share of the inner area that the swaths cover, 0 to 1.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.covered / self.inner
    }

    /// Share of the whole field that the swaths cover, 0 to 1.
    #[must_use]
    pub fn share_of_field(&self) -> f64 {
        (self.covered + self.outside).min(self.field) / self.field
    }
}

/// Why a field cannot be divided. Displays as one sentence.
#[derive(Clone, Debug, PartialEq)]
pub enum FieldError {
    /// An option is out of its range.
    Option {
        /// Its name.
        name: &'static str,
        /// Its value, with a unit.
        value: String,
        /// The range that is accepted.
        takes: &'static str,
    },
    /// A coordinate is no number or too far away.
    Coordinate,
    /// The boundary encloses less than 1 m2.
    Empty,
    /// The headland leaves nothing.
    Headland {
        /// Its width, m.
        width: f64,
    },
    /// No piece of a swath is long enough.
    Short,
    /// More swaths than a plan has legs.
    Many {
        /// How many.
        count: usize,
    },
}

impl fmt::Display for FieldError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Option { name, value, takes } => {
                write!(f, "{name}: {value} is out of range, it takes {takes}")
            }
            Self::Coordinate => {
                f.write_str("a corner of the boundary is no place within 10 km of the origin")
            }
            Self::Empty => f.write_str("the boundary encloses less than 1 m2"),
            Self::Headland { width } => {
                write!(f, "a headland of {width} m leaves nothing of the field")
            }
            Self::Short => {
                f.write_str("no piece of a swath is as long as the shortest one accepted")
            }
            Self::Many { count } => write!(
                f,
                "there are {count} swaths, up to {MOST_SWATHS} are accepted"
            ),
        }
    }
}

impl std::error::Error for FieldError {}

/// Divides a field into headland and swaths.
///
/// # Errors
/// [`FieldError`] if an option is out of range, the boundary is none, or nothing is left.
pub fn divide(area: &Area, options: &Options) -> Result<Field, FieldError> {
    check(area, options)?;
    let (area, lost) = repaired(area)?;
    let whole = area.polygon();
    let inner = match options.headland > 0.0 {
        true => inset(&whole, options.headland),
        false => MultiPolygon::new(vec![whole.clone()]),
    };
    let inner: Vec<Polygon> = inner
        .into_iter()
        .filter(|part| part.unsigned_area() >= LEAST_PART)
        .collect();
    if inner.is_empty() {
        return Err(FieldError::Headland {
            width: options.headland,
        });
    }
    let parts: Vec<Area> = inner.iter().map(Area::from_polygon).collect();
    let bearing = match options.direction {
        Direction::Auto => swaths::fewest(&parts, options),
        Direction::Bearing(bearing) => bearing.rem_euclid(std::f64::consts::PI),
    };
    let mut cut = swaths::cut(&parts, bearing, options);
    if cut.pieces.len() > MOST_SWATHS {
        return Err(FieldError::Many {
            count: cut.pieces.len(),
        });
    }
    if cut.pieces.is_empty() {
        return Err(FieldError::Short);
    }
    if options.ends == Ends::Whole {
        let reach = inset(&whole, (options.headland - 0.5 * options.width).max(0.0));
        let reach: Vec<Area> = reach.iter().map(Area::from_polygon).collect();
        swaths::lengthen(&mut cut, &parts, &reach, bearing, options);
    }
    let swaths = order::ordered(&cut.pieces, bearing, options);
    let least = 2.0 * options.radius * (1.0 - 1e-9);
    let tight = swaths.windows(2).filter(|pair| {
        let apart = pair[0].track.abs_diff(pair[1].track) as f64 * options.width;
        pair[0].block == pair[1].block && apart < least
    });
    Ok(Field {
        tight_turns: tight.count(),
        coverage: Coverage {
            lost,
            ..coverage(&whole, MultiPolygon::new(inner), &swaths, options.width)
        },
        area,
        inner: parts,
        bearing,
        swaths,
        too_short: cut.too_short,
        options: *options,
    })
}

fn check(area: &Area, options: &Options) -> Result<(), FieldError> {
    let within = |name, value: f64, least: f64, most: f64, takes| {
        if (least..=most).contains(&value) {
            return Ok(());
        }
        let value = format!("{value} m");
        Err(FieldError::Option { name, value, takes })
    };
    within("width", options.width, 0.1, 100.0, "0.1 m to 100 m")?;
    within("headland", options.headland, 0.0, 500.0, "0 m to 500 m")?;
    within("radius", options.radius, 0.0, 100.0, "0 m to 100 m")?;
    within("shortest", options.shortest, 0.1, 1000.0, "0.1 m to 1000 m")?;
    if let Direction::Bearing(bearing) = options.direction
        && !bearing.is_finite()
    {
        return Err(FieldError::Option {
            name: "direction",
            value: format!("{bearing} rad"),
            takes: "any finite angle",
        });
    }
    let far = crate::place::FARTHEST;
    // An obstacle may reach farther than the field.
    let mut corners = area.outer.iter();
    if !corners.all(|corner| corner.north.abs() <= far && corner.east.abs() <= far) {
        return Err(FieldError::Coordinate);
    }
    // Before a direction is looked for: no direction has more.
    let spread = |of: fn(&Local) -> f64| {
        let values = area.outer.iter().map(of);
        let (least, most) = values.fold((far, -far), |(least, most), value| {
            (least.min(value), most.max(value))
        });
        most - least
    };
    let widest = spread(|corner| corner.north).hypot(spread(|corner| corner.east));
    let count = (widest / options.width).ceil() as usize;
    match count <= MOST_SWATHS {
        true => Ok(()),
        false => Err(FieldError::Many { count }),
    }
}

/// The field without crossings, and the area that was lost by that or is doubtful, m2. Of several parts it is the largest one.
fn repaired(area: &Area) -> Result<(Area, f64), FieldError> {
    // What the edge goes round twice may be a hole whose ring was joined to it: nobody can tell.
    let once = polygon_of(&area.outer).union(&MultiPolygon::new(Vec::new()));
    let doubtful = whole(&area.outer).unsigned_area() - once.unsigned_area();
    let all = area.free();
    let size = |part: &Polygon| part.unsigned_area();
    let total = all.unsigned_area();
    let largest = all
        .into_iter()
        .max_by(|one, other| size(one).total_cmp(&size(other)));
    let largest = largest
        .filter(|part| size(part) >= LEAST_PART)
        .ok_or(FieldError::Empty)?;
    let lost = (total - size(&largest)).max(0.0) + doubtful.max(0.0);
    Ok((Area::from_polygon(&largest), lost))
}

/// The area less a margin along its edges, m.
fn inset(area: &impl geo::Buffer<Scalar = f64>, distance: f64) -> MultiPolygon {
    let style = BufferStyle::new(-distance).line_join(LineJoin::Round(ARC));
    area.buffer_with_style(style)
}

fn coverage(field: &Polygon, inner: MultiPolygon, swaths: &[Swath], width: f64) -> Coverage {
    let strips: Vec<Polygon> = swaths
        .iter()
        .map(|swath| Polygon::new(polygon::ring(&swath.strip(width)), Vec::new()))
        .collect();
    let driven: f64 = swaths.iter().map(|swath| swath.length() * width).sum();
    let union = geo::unary_union(&strips);
    let covered = union.intersection(&inner).unsigned_area();
    Coverage {
        field: field.unsigned_area(),
        inner: inner.unsigned_area(),
        covered,
        outside: union.unsigned_area() - covered,
        twice: (driven - union.unsigned_area()).max(0.0),
        lost: 0.0,
    }
}

/// Speed, sections and headland of a field's plan.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Work {
    /// Speed, m/s.
    pub speed: f64,
    /// Sections of the implement that work.
    pub outputs: Outputs,
    /// When the headland is driven.
    pub headland: Headland,
    /// Stop or repeat after the last leg.
    pub end: End,
}

/// When the headland is driven: round by round, along the edge and round every hole, the outermost round first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Headland {
    /// It is not.
    Left,
    /// Before the swaths.
    First,
    /// After the swaths.
    Last,
}

impl Field {
    /// The plan that drives all swaths, with a turn between two, and the headland if wanted, inside the edge of the field. Rounds
    /// of the headland are closed curves.
    #[must_use]
    pub fn plan(&self, name: &str, origin: Origin, work: &Work) -> Plan {
        let leg = |shape| Leg {
            shape,
            speed: work.speed,
            reverse: false,
            outputs: work.outputs,
            join: Join::Turn,
        };
        let swaths = self.swaths.iter().map(|swath| {
            leg(Shape::Line {
                from: swath.from,
                to: swath.to,
            })
        });
        let rounds = |from: Option<Local>| {
            let rounds = headland::from_nearest(self.rounds(), from);
            rounds
                .into_iter()
                .map(|points| leg(Shape::Curve { points }))
        };
        let legs = match work.headland {
            Headland::Left => swaths.collect(),
            Headland::First => rounds(self.options.start).chain(swaths).collect(),
            Headland::Last => {
                let end = self.swaths.last().map(|swath| swath.to);
                swaths.chain(rounds(end)).collect()
            }
        };
        Plan {
            name: name.to_owned(),
            origin,
            width: Some(self.options.width),
            fence: self.area.outer.clone(),
            obstacles: self.area.holes.clone(),
            legs,
            end: work.end,
        }
    }

    /// Middle lines of the rounds in the headland, the outermost first, each with its first point again at the end. Their corners have
    /// the radius of the options and a quarter more, so that a curve of clothoids through them stays within the radius; where the
    /// edge turns more sharply, something in the corner is not reached. Round a notch or a hole that turns more sharply than the
    /// vehicle can, the line does as well: [`crate::curve::fit`] tells.
    #[must_use]
    pub fn rounds(&self) -> Vec<Vec<Local>> {
        headland::rounds(&self.area.polygon(), &self.options)
    }
}
