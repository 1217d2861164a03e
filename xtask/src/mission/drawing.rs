//! A plan from the drawing of a farm tool.

use std::path::Path;

use control::{
    fence::{CORNERS, OBSTACLE_CORNERS},
    mission::MissionSettings,
};
use mission::{
    curve, fence,
    field::{self, Area, Direction, Ends, Field, Headland, Order, Work},
    place::{Frame, Local, Origin},
    plan::{End, Join, Leg, Outputs, Plan, Shape},
    polygon, read,
};
use vehicle_model::Vehicle;

use super::Drivable;
use crate::{
    Failure,
    cli::{NewMission, Rounds, SwathEnds},
};

/// Distance between the points of a curve whose noise is taken out, m.
const SPACING: f64 = 1.0;

/// Least area of another boundary in a field that is told, m2: neighbours overlap a little.
const LEAST_TOLD: f64 = 1.0;

/// How far from the lines obstacles are kept where there is no fence, m: turns lead no farther.
const BESIDE: f64 = 100.0;

/// Largest part of a hole that may be in no obstacle because of rounding, m2.
const ROUNDING: f64 = 1e-3;

/// Share of a field that may be lost because its edge crosses itself: boundaries that were walked have small loops.
const LOST: f64 = 0.01;

/// The plan from a drawing: swaths in a field, or with `--lines` its lines.
pub(super) fn plan(
    path: &Path,
    options: &NewMission,
    vehicle: &Vehicle,
    settings: &MissionSettings<f32>,
) -> Result<(Plan, Option<Field>), Failure> {
    let usage = |why: String| Failure::Usage(format!("{}: {why}", path.display()));
    let given = options.origin.map(Frame::new);
    let drawing =
        read::path(path, given.as_ref()).map_err(|error| Failure::Usage(error.to_string()))?;
    for skipped in &drawing.skipped {
        eprintln!("left out: {skipped}");
    }
    for note in &drawing.notes {
        eprintln!("note: {note}");
    }
    let origin = origin(options, &drawing).ok_or_else(|| usage("it has no shape".into()))?;
    let cruise = vehicle.manifest().machine.as_ref();
    let cruise = cruise.map_or(1.0, |machine| machine.cruise.get());
    let outputs = Outputs::of(&options.section)
        .ok_or_else(|| Failure::Usage("--section: 1 to 8 are accepted".into()))?;
    let wanted = Wanted {
        options,
        drawing: &drawing,
        frame: Frame::new(origin),
        speed: options.speed.unwrap_or(cruise),
        outputs,
        settings,
    };
    if options.lines {
        return wanted.lines().map(|plan| (plan, None)).map_err(usage);
    }
    let (plan, field) = wanted.swaths().map_err(usage)?;
    Ok((plan, Some(field)))
}

/// The origin of the local frame: what the command line says, or what the drawing measures from, or where its first
/// shape begins. The last two are told, because a vehicle measures from its base station.
fn origin(options: &NewMission, drawing: &read::Drawing) -> Option<Origin> {
    if options.origin.is_some() {
        return options.origin;
    }
    let shapes = || drawing.shapes.iter();
    let wanted = |named: &&read::Named| match &options.field {
        Some(field) => named.name == *field || named.field.as_ref() == Some(field),
        None if options.lines => is_line(named),
        None => named.role == read::Role::Boundary,
    };
    let first = || match &shapes().find(wanted).or_else(|| shapes().next())?.shape {
        read::Shape::Line { from, .. } => Some(*from),
        read::Shape::Curve(points) => points.first().copied(),
        read::Shape::Polygon { outer, .. } => outer.first().copied(),
    };
    let (place, what) = match drawing.origin {
        Some(place) => (place, "the place that the file measures from"),
        None => (first()?, "where its first shape begins"),
    };
    eprintln!(
        "note: the origin is {what}, {:.7} deg, {:.7} deg; a vehicle measures from the antenna of its base station, so \
         on a real field --origin must name the place of that",
        place.latitude, place.longitude
    );
    Some(Origin { place, height: 0.0 })
}

/// A field's name and its area.
type NamedArea = (String, Area);

/// True for what a vehicle may be driven along.
fn is_line(named: &read::Named) -> bool {
    let is_polygon = matches!(named.shape, read::Shape::Polygon { .. });
    named.role == read::Role::Guidance && !is_polygon
}

/// What a mission is made from.
struct Wanted<'a> {
    options: &'a NewMission,
    drawing: &'a read::Drawing,
    frame: Frame,
    speed: f64,
    outputs: Outputs,
    settings: &'a MissionSettings<f32>,
}

impl Wanted<'_> {
    /// Width of the headland, m.
    fn headland(&self) -> f64 {
        self.options.headland.unwrap_or(2.0 * self.options.width)
    }

    /// The field that the command line names, or the first one, if there is one.
    fn area(&self) -> Result<Option<NamedArea>, String> {
        let mut areas = field::areas(self.drawing, &self.frame);
        let names: Vec<String> = areas.iter().map(|(name, _)| format!("{name:?}")).collect();
        let index = match &self.options.field {
            None => 0,
            Some(wanted) => areas
                .iter()
                .position(|(name, _)| name == wanted)
                .ok_or_else(|| {
                    format!(
                        "--field: it has no field {wanted:?}; {}",
                        match &names[..] {
                            [] => "it has no boundary of a field".to_owned(),
                            names => format!("its fields are {}", names.join(", ")),
                        }
                    )
                })?,
        };
        if areas.is_empty() {
            return Ok(None);
        }
        if areas.len() > 1 && self.options.field.is_none() {
            eprintln!(
                "note: it has the fields {}; the first one is taken, and --field takes another",
                names.join(", ")
            );
        }
        Ok(Some(areas.swap_remove(index)))
    }

    /// Swaths in a field.
    fn swaths(&self) -> Result<(Plan, Field), String> {
        let options = self.options;
        let (found, area) = self
            .area()?
            .ok_or("it has no boundary of a field: --lines takes its lines")?;
        self.tell_inside(&found, &area);
        let lines = self.drawing.shapes.iter().filter(|named| is_line(named));
        match lines.count() {
            0 => {}
            1 => eprintln!("note: its line is not used: --lines drives along it"),
            count => eprintln!("note: its {count} lines are not used: --lines drives along them"),
        }
        let divided = field::Options {
            headland: self.headland(),
            direction: match options.direction {
                None => Direction::Auto,
                Some(degrees) => Direction::Bearing(degrees.to_radians()),
            },
            ends: match options.ends {
                SwathEnds::Middle => Ends::Middle,
                SwathEnds::Whole => Ends::Whole,
            },
            order: if options.skip {
                Order::Skip
            } else {
                Order::Neighbouring
            },
            radius: 1.0 / f64::from(self.settings.curvature),
            ..field::Options::new(options.width)
        };
        let name = options.name.clone().unwrap_or(found);
        // Swaths keep clear of the obstacles as they are in the mission, which may be larger.
        let holes = area.holes;
        let obstacles = told(obstacles(&holes)?);
        let area = Area {
            holes: obstacles.clone(),
            ..area
        };
        let field = divided_once(&area, &divided);
        let field = self.without_crossings(&area, field)?;
        let edge = Edge {
            fence: told(fence_of(&field.area.outer)?),
            obstacles,
        };
        edge.covers(&holes)?;
        let usual = self.planned(&name, &field, &edge);
        let Err(why) = self.drivable(&usual) else {
            return Ok((usual, field));
        };
        // Another order of the swaths may have turns where this one has none.
        for other in others(&area, &divided, field.bearing) {
            let Ok(field) = field::divide(&area, &other) else {
                continue;
            };
            let plan = self.planned(&name, &field, &edge);
            if self.drivable(&plan).is_ok() {
                eprintln!(
                    "note: in the usual order the vehicle cannot drive it ({why}); it begins at another corner, with swaths \
                     at {:.0} deg",
                    field.bearing.to_degrees()
                );
                return Ok((plan, field));
            }
        }
        Ok((usual, field))
    }

    /// Notes boundaries that reach into the field: they may be parts of it, or ponds.
    fn tell_inside(&self, field: &str, area: &Area) {
        for (name, other) in field::areas(self.drawing, &self.frame) {
            if name == field || !field::touch(&area.outer, &other.outer) {
                continue;
            }
            let in_holes: f64 = area
                .holes
                .iter()
                .map(|hole| field::shared(hole, &other.outer))
                .sum();
            if field::shared(&area.outer, &other.outer) - in_holes > LEAST_TOLD {
                eprintln!(
                    "note: {name:?} reaches into {field:?} and is driven over; a hole of the boundary, or a shape that its file calls \
                     an obstacle, is not"
                );
            }
        }
    }

    fn drivable(&self, plan: &Plan) -> Result<(), String> {
        Drivable::of(plan)?.check_new(self.settings).map(|_| ())
    }

    fn planned(&self, name: &str, field: &Field, edge: &Edge) -> Plan {
        let work = Work {
            speed: self.speed,
            outputs: self.outputs,
            headland: match self.options.rounds {
                None => Headland::Left,
                Some(Rounds::First) => Headland::First,
                Some(Rounds::Last) => Headland::Last,
            },
            end: End::Stop,
        };
        let plan = field.plan(name, self.frame.origin(), &work);
        Plan {
            fence: edge.fence.clone(),
            obstacles: edge.obstacles.clone(),
            ..plan
        }
    }

    /// A field whose boundary crosses itself is refused if much of it would be lost.
    fn without_crossings(
        &self,
        area: &Area,
        field: Result<Field, String>,
    ) -> Result<Field, String> {
        let Some(sides) = polygon::crossing(&area.outer) else {
            if let Ok(field) = &field
                && field.coverage.lost > 1.0
            {
                eprintln!(
                    "note: obstacles divide the field; {:.1} m2 of {:.0} m2 are not in its largest part and are left out",
                    field.coverage.lost,
                    field.coverage.field + field.coverage.lost
                );
            }
            return field;
        };
        let at = polygon::meeting(&area.outer, sides).unwrap_or_default();
        let earth = self.frame.geodetic(at);
        let what = format!(
            "the sides of the boundary from its corners {} and {} cross at {:.7} deg, {:.7} deg ({at})",
            sides.0 + 1,
            sides.1 + 1,
            earth.latitude,
            earth.longitude
        );
        match field {
            Ok(field) if field.coverage.lost <= LOST * field.coverage.field => {
                let lost = field.coverage.lost;
                eprintln!("note: {what}; {lost:.1} m2 beyond are left out");
                Ok(field)
            }
            _ => Err(format!(
                "{what}: a boundary whose sides do not cross is accepted"
            )),
        }
    }

    /// The partfield whose lines are taken, and its area. A file without partfields has all its lines in none.
    fn field_of_lines(&self) -> Result<(Option<String>, Option<NamedArea>), String> {
        let mut fields: Vec<Option<&str>> = Vec::new();
        for named in self.drawing.shapes.iter().filter(|named| is_line(named)) {
            if !fields.contains(&named.field.as_deref()) {
                fields.push(named.field.as_deref());
            }
        }
        if fields.iter().all(Option::is_none) {
            return Ok((None, self.area()?));
        }
        let names = || {
            let names = fields.iter().flatten().map(|name| format!("{name:?}"));
            names.collect::<Vec<_>>().join(", ")
        };
        let boundaries = || {
            let shapes = self.drawing.shapes.iter();
            shapes.filter(|named| named.role == read::Role::Boundary)
        };
        let field = match self.options.field.as_deref() {
            None => fields.first().copied().flatten(),
            Some(wanted) => {
                let shapes = self.drawing.shapes.iter();
                let of_field = shapes.map(|named| named.field.as_deref());
                let boundary = boundaries().find(|named| named.name == wanted);
                let of_boundary = boundary.and_then(|named| named.field.as_deref());
                match of_field.clone().any(|field| field == Some(wanted)) {
                    true => Some(wanted),
                    false => Some(of_boundary.unwrap_or(wanted)),
                }
            }
        };
        if !fields.contains(&field) {
            return Err(format!(
                "--field: {:?} has no line; fields with lines are {}",
                field.unwrap_or_default(),
                names()
            ));
        }
        if fields.len() > 1 && self.options.field.is_none() {
            eprintln!(
                "note: it has lines in the fields {}; those of the first one are taken, and --field takes another",
                names()
            );
        }
        let mut of_field = boundaries().filter(|named| named.field.as_deref() == field);
        let named = of_field
            .clone()
            .find(|named| self.options.field.as_ref() == Some(&named.name))
            .or_else(|| of_field.next());
        let mut areas = field::areas(self.drawing, &self.frame).into_iter();
        let area = named.and_then(|named| areas.find(|(name, _)| *name == named.name));
        Ok((field.map(str::to_owned), area))
    }

    /// A leg for each line of the drawing, with turns between them.
    fn lines(&self) -> Result<Plan, String> {
        let (field, area) = self.field_of_lines()?;
        let lines = self.drawing.shapes.iter().filter(|named| is_line(named));
        let mut shapes = Vec::new();
        for named in lines.filter(|named| named.field == field) {
            let Some(shape) = self.shape(named, area.as_ref().map(|(_, area)| area))? else {
                continue;
            };
            // Of a field that the command line names, without the lines of its neighbours.
            let reaches = |(_, area): &NamedArea| field::reaches(&area.outer, &shape.points());
            if self.options.field.is_none() || area.as_ref().is_none_or(reaches) {
                shapes.push(shape);
            }
        }
        if shapes.is_empty() {
            return Err("it has no line".into());
        }
        if !self.options.keep_directions {
            let turned = alternate(&mut shapes);
            if turned > 0 {
                eprintln!(
                    "note: {turned} of {} lines are driven against the direction of the file, because the way to them is \
                     shorter; --keep-directions keeps it",
                    shapes.len()
                );
            }
        }
        let edge = self.round_lines(area, &shapes)?;
        let leg = |shape| Leg {
            shape,
            speed: self.speed,
            reverse: false,
            outputs: self.outputs,
            join: Join::Turn,
        };
        Ok(Plan {
            name: self.options.name.clone().unwrap_or_else(|| "lines".into()),
            width: None,
            origin: self.frame.origin(),
            fence: edge.fence,
            obstacles: edge.obstacles,
            legs: shapes.into_iter().map(leg).collect(),
            end: End::Stop,
        })
    }

    /// The boundary as the fence of lines, if they lie in it. Its obstacles stay in any case, and without a fence all those near the lines: a
    /// line through one is refused.
    fn round_lines(&self, area: Option<NamedArea>, shapes: &[Shape]) -> Result<Edge, String> {
        let Some((name, area)) = area else {
            return self.unfenced(shapes);
        };
        self.tell_inside(&name, &area);
        if self.options.no_fence {
            return self.unfenced(shapes);
        }
        let fence = told(fence_of(&area.outer)?);
        let outside = |shape: &Shape| {
            let points = shape.points();
            let mut points = points.iter();
            points.any(|point| !polygon::holds(&fence, *point, 0.0))
        };
        if let Some(line) = shapes.iter().position(outside) {
            eprintln!(
                "note: the boundary {name:?} does not become the fence, because line {} leaves it: the mission has no \
                 fence",
                line + 1
            );
            return self.unfenced(shapes);
        }
        eprintln!("note: the boundary {name:?} is the fence; --no-fence leaves it out");
        let edge = Edge {
            fence,
            obstacles: told(obstacles(&area.holes)?),
        };
        edge.covers(&area.holes)?;
        Ok(edge)
    }

    /// The obstacles near lines, and the holes of all boundaries there.
    fn unfenced(&self, shapes: &[Shape]) -> Result<Edge, String> {
        let areas = field::areas(self.drawing, &self.frame);
        let holes = areas.into_iter().flat_map(|(_, area)| area.holes);
        let mut rings = field::obstacles(self.drawing, &self.frame);
        for hole in holes {
            if !rings.contains(&hole) {
                rings.push(hole);
            }
        }
        let lines: Vec<Vec<Local>> = shapes.iter().map(Shape::points).collect();
        let all = rings.len();
        rings.retain(|ring| lines.iter().any(|line| is_beside(line, ring)));
        if rings.len() < all {
            eprintln!(
                "note: {} of {all} obstacles are more than {BESIDE} m away from the lines and are left out",
                all - rings.len()
            );
        }
        let edge = Edge {
            fence: Vec::new(),
            obstacles: told(obstacles(&rings)?),
        };
        edge.covers(&rings)?;
        Ok(edge)
    }

    /// The leg along a line or curve of the drawing.
    fn shape(&self, named: &read::Named, area: Option<&Area>) -> Result<Option<Shape>, String> {
        Ok(match &named.shape {
            read::Shape::Line { from, to } => {
                let (mut from, mut to) = (self.frame.local(*from), self.frame.local(*to));
                if let (true, Some(area)) = (named.directed, area) {
                    (from, to) =
                        field::inside(area, self.headland(), from, to).ok_or_else(|| {
                            format!(
                                "the line {:?} leads past the area inside the headland of {} m",
                                named.name,
                                self.headland()
                            )
                        })?;
                }
                Some(Shape::Line { from, to })
            }
            read::Shape::Curve(points) => {
                let points: Vec<Local> = points
                    .iter()
                    .map(|point| self.frame.local(*point))
                    .collect();
                let points = match self.options.noise {
                    None => points,
                    Some(noise) => {
                        let spacing = SPACING;
                        let resampling = curve::Resampling { spacing, noise };
                        curve::resample(&points, &resampling)
                            .map_err(|why| format!("the curve {:?}: {why}", named.name))?
                    }
                };
                Some(Shape::Curve { points })
            }
            read::Shape::Polygon { .. } => None,
        })
    }
}

fn divided_once(area: &Area, options: &field::Options) -> Result<Field, String> {
    field::divide(area, options).map_err(|why| match why {
        field::FieldError::Headland { .. } => format!(
            "{why}, which has {:.0} m2: --headland takes a smaller one, without it it is twice --width",
            area.size()
        ),
        _ => why.to_string(),
    })
}

/// Other orders of the swaths: from each corner of the field, and across if no direction is given.
fn others(area: &Area, usual: &field::Options, bearing: f64) -> Vec<field::Options> {
    let directions = match usual.direction {
        Direction::Auto => vec![bearing, bearing + std::f64::consts::FRAC_PI_2],
        Direction::Bearing(bearing) => vec![bearing],
    };
    let mut others = Vec::new();
    let far = mission::place::FARTHEST;
    for bearing in directions {
        for (north, east) in [(-far, -far), (-far, far), (far, far), (far, -far)] {
            let away = |corner: &&Local| corner.distance(Local::new(north, east));
            let corners = area.outer.iter();
            let start = corners.min_by(|one, other| away(one).total_cmp(&away(other)));
            others.push(field::Options {
                direction: Direction::Bearing(bearing),
                start: start.copied(),
                ..*usual
            });
        }
    }
    others
}

/// Turns lines round where the way from the line before is shorter then. Returns how many.
fn alternate(shapes: &mut [Shape]) -> usize {
    let mut here: Option<Local> = None;
    let mut turned = 0;
    for shape in shapes {
        let (begin, end) = shape.ends();
        if here.is_some_and(|here| here.distance(end) < here.distance(begin)) {
            match shape {
                Shape::Line { from, to } => std::mem::swap(from, to),
                Shape::Curve { points } => points.reverse(),
            }
            turned += 1;
        }
        here = Some(shape.ends().1);
    }
    turned
}

/// What was made, with the notes about it on the screen.
fn told<T>((made, notes): (T, Vec<String>)) -> T {
    for note in notes {
        eprintln!("note: {note}");
    }
    made
}

/// How far edges may be moved for fewer corners.
const MOST_MOVED: &str = "moved by up to 10 m";

/// Fence and obstacles with as many corners as a vehicle takes.
#[derive(Clone, Debug, Default)]
struct Edge {
    fence: Vec<Local>,
    obstacles: Vec<Vec<Local>>,
}

impl Edge {
    /// Refuses a mission whose fence leaves a part of a hole open that no obstacle covers.
    fn covers(&self, holes: &[Vec<Local>]) -> Result<(), String> {
        let open = field::left_open(holes, &self.fence, &self.obstacles);
        match open <= ROUNDING {
            true => Ok(()),
            false => Err(format!(
                "{open:.2} m2 of its obstacles would be lost: draw them as simple shapes that do not touch each other"
            )),
        }
    }
}

/// True for a ring that comes within [`BESIDE`] of a line.
fn is_beside(line: &[Local], ring: &[Local]) -> bool {
    let near = |at: &Local| polygon::holds(ring, *at, BESIDE);
    let mut pieces = line.windows(2);
    line.iter().any(near)
        || pieces.any(|piece| {
            let mut corners = ring.iter();
            corners.any(|at| polygon::distance_to_piece(*at, piece[0], piece[1]) <= BESIDE)
        })
}

/// The fence in a boundary, and a note if it was changed.
fn fence_of(boundary: &[Local]) -> Result<(Vec<Local>, Vec<String>), String> {
    let fence = fence::thinned(boundary, CORNERS, fence::Side::Inside).ok_or_else(|| {
        format!(
            "the boundary has {} corners, a vehicle takes {CORNERS}, and with its edges {MOST_MOVED} to the inside it has \
             still more, or has lost more than {:.0} % of its area",
            boundary.len(),
            100.0 * fence::LARGEST_LOSS
        )
    })?;
    let note = (fence.moved > 0.0).then(|| {
        format!(
            "the boundary has {} corners; the fence has {}, lies inside it within {:.2} m, and encloses {:.1} m2 less",
            boundary.len(),
            fence.corners.len(),
            fence.moved,
            fence.area
        )
    });
    Ok((fence.corners, note.into_iter().collect()))
}

/// The obstacles about holes, and notes about what was changed.
fn obstacles(holes: &[Vec<Local>]) -> Result<(Vec<Vec<Local>>, Vec<String>), String> {
    let mut notes = Vec::new();
    let mut obstacles = holes.to_vec();
    for (number, hole) in (1..).zip(&mut obstacles) {
        let Some(grown) = fence::grown(hole) else {
            continue;
        };
        notes.push(format!(
            "obstacle {number}, at {}, encloses {:.2} cm2 only; it is kept, {:.0} cm larger on all sides: leave it out of \
             the file if nothing stands there",
            hole.first().copied().unwrap_or_default(),
            polygon::area(hole).abs() * 1e4,
            fence::ABOUT * 100.0
        ));
        *hole = grown;
    }
    let around = fence::obstacles(&obstacles, OBSTACLE_CORNERS).ok_or_else(|| {
        format!(
            "there are {} obstacles; a vehicle takes {OBSTACLE_CORNERS} corners of all obstacles together, where each \
             obstacle counts one more, and with their edges {MOST_MOVED} to the outside there are still more",
            holes.len()
        )
    })?;
    for (number, (given, thin)) in (1..).zip(obstacles.iter().zip(&around)) {
        if thin.moved > 0.0 {
            notes.push(format!(
                "obstacle {number} has {} corners; in the mission it has {}, covers it with up to {:.2} m more, and is \
                 {:.1} m2 larger",
                given.len(),
                thin.corners.len(),
                thin.moved,
                thin.area
            ));
        }
    }
    let corners = around.into_iter().map(|thin| thin.corners).collect();
    Ok((corners, notes))
}
