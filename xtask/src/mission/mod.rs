//! `mission`: makes missions from the files of farm tools, checks whether a vehicle can drive them, and draws them.

mod bus;
mod drivable;
mod driven;
mod request;

use std::{fs, path::Path, sync::Arc};

use control::{dubins::Pose, mission::MissionSettings};
use firmware::mission::upload::Request;

use mission::{
    curve::Chain,
    field::{self, Direction, Ends, Field, Headland, Order, Work},
    picture,
    place::{Frame, Geodetic, Origin},
    plan::{End, Join, Leg, Outputs, Plan, Shape},
    read,
};
use serde_json::json;
use twin::{Images, Outcome};
use vehicle_model::{Device, Vehicle};
use world::{
    Scenario, SimDuration,
    report::{MissionFigures, Run},
    units::{Angle, Length},
};

pub(crate) use drivable::{Drivable, settings};
pub(crate) use driven::{Course, Driven, Switches, played};
pub use request::{Answer, Client, Error, Refusal, State, Told};

use crate::{
    Failure, Workspace,
    cli::{CheckMission, Mission, NewMission},
    file,
    network::matrix::Matrix,
    sim::bus::Log,
    vehicle,
};

/// Runs the command.
///
/// # Errors
///
/// [`Failure::Usage`]: a file is wrong, or the vehicle cannot drive the mission. [`Failure::Mission`]: the vehicle
/// refuses a request, or cannot be reached.
pub fn run(workspace: &Workspace, command: &Mission) -> Result<(), Failure> {
    match command {
        Mission::New(options) => new(workspace, options),
        Mission::Check(options) => self::check(workspace, options),
        Mission::Upload(options) => bus::upload(workspace, options),
        Mission::Start(on) => bus::ask(workspace, on, Request::Start),
        Mission::Pause(on) => bus::ask(workspace, on, Request::Pause),
        Mission::Resume(on) => bus::ask(workspace, on, Request::Resume),
        Mission::Drop(on) => bus::ask(workspace, on, Request::Drop),
        Mission::State(on) => bus::ask(workspace, on, Request::State),
        Mission::Flash(options) => bus::flash(workspace, options),
    }
}

/// Reads a mission file.
///
/// # Errors
/// It cannot be read, or says something wrong.
pub(crate) fn read_plan(path: &Path) -> Result<Plan, Failure> {
    let text = fs::read_to_string(path).map_err(|error| {
        Failure::Usage(format!("{}: it cannot be read: {error}", path.display()))
    })?;
    let name = path.display().to_string();
    Plan::read(&text, &name).map_err(|error| Failure::Usage(error.to_string()))
}

/// A mission for a vehicle, which can drive it.
#[derive(Clone, Debug)]
pub struct Loaded {
    /// What lies in the flash.
    pub record: Vec<u8>,
    /// A place before its first leg, and the direction of that.
    pub begin: Pose<f64>,
    /// Time that the vehicle needs for it at full speed, s.
    pub time: f64,
    /// Its path.
    pub(crate) course: Arc<Course>,
    pub(crate) drivable: Arc<Drivable>,
}

/// How far before the first leg a run begins, m: the vehicle finds its heading on the way.
const RUN_UP: f64 = 3.0;

/// Reads a mission file for a vehicle.
///
/// # Errors
/// It cannot be read, or the vehicle cannot drive it.
pub fn load(vehicle: &Vehicle, path: &Path) -> Result<Loaded, Failure> {
    let usage = |why: String| Failure::Usage(format!("{}: {why}", path.display()));
    let settings = settings(vehicle).map_err(Failure::Usage)?;
    prepare(vehicle, read_plan(path)?, &settings).map_err(usage)
}

/// A plan for a vehicle.
///
/// # Errors
/// Why the vehicle cannot drive it.
pub(crate) fn prepare(
    vehicle: &Vehicle,
    plan: Plan,
    settings: &MissionSettings<f32>,
) -> Result<Loaded, String> {
    let drivable = Drivable::of(&plan)?;
    let summary = drivable.check(settings)?;
    Ok(Loaded {
        record: drivable.record()?,
        begin: drivable.begin(RUN_UP).unwrap_or_default(),
        time: summary.time.into(),
        course: Arc::new(Course::of(plan, &drivable, settings, vehicle)?),
        drivable: Arc::new(drivable),
    })
}

impl Loaded {
    /// Lets a scenario begin where the vehicle finds its first leg.
    pub fn begin(&self, scenario: &mut Scenario) {
        scenario.start.north = Length::new(self.begin.north);
        scenario.start.east = Length::new(self.begin.east);
        scenario.start.heading = Angle::new(self.begin.heading);
    }

    /// The images with it in the flash of the board that the operator commands.
    #[must_use]
    pub fn with_images(&self, images: Images, vehicle: &Vehicle) -> Images {
        let node = vehicle.node_of(Device::OperatorSwitches);
        let place =
            node.and_then(|node| Some((node, vehicle::board(vehicle, node).mission.as_ref()?)));
        match place {
            Some((node, place)) => images.with_data(node, place.base, self.record.clone()),
            None => images,
        }
    }

    /// How a finished run of the images drove it, and the picture of that.
    #[must_use]
    pub fn judge(
        &self,
        vehicle: &Vehicle,
        scenario: &Scenario,
        seed: u64,
        outcome: &Outcome,
    ) -> (MissionFigures, String) {
        let matrix = Matrix::new(vehicle);
        let log = Log::new(&outcome.records, matrix.bit_time());
        let modes = matrix.modes(&log.frames);
        let states = outcome.world.states();
        let driven = self.course.driven(vehicle, states, &modes, &log.frames);
        let mission = driven.run();
        let run = Run {
            scenario,
            nodes: &vehicle::node_names(vehicle),
            seed,
            duration: SimDuration::from_ticks(outcome.duration.as_ticks()),
            states,
            efforts: outcome.world.efforts(),
            frames: &log.frames,
            windows: &matrix.windows,
            cycle_count_byte: matrix.cycle_count_byte(),
            basic_cycle: matrix.basic_cycle(),
            bit_time: matrix.bit_time(),
            modes: &modes,
            tasks: &[],
            rover: None,
            crop: None,
            mission: Some(mission),
        };
        let figures = MissionFigures::of(&run, &mission);
        let picture = driven.svg(states, &figures.line());
        (figures, picture)
    }
}

fn check(workspace: &Workspace, options: &CheckMission) -> Result<(), Failure> {
    let vehicle = vehicle::find(workspace, &options.vehicle)?;
    let usage = |why: String| Failure::Usage(format!("{}: {why}", options.file.display()));
    let settings = settings(&vehicle).map_err(Failure::Usage)?;
    let plan = read_plan(&options.file)?;
    let drivable = Drivable::of(&plan).map_err(usage)?;
    // The picture shows what is wrong, too.
    if let Some(path) = &options.picture {
        draw(
            path,
            &plan,
            &drivable.chains,
            settings.curvature.into(),
            None,
        )?;
    }
    let summary = drivable.check(&settings).map_err(usage)?;
    let record = drivable.record().map_err(usage)?;
    let tightest = drivable.chains.iter().map(|chain| chain.tightest.curvature);
    let tightest = tightest.fold(0.0, |most: f64, one| most.max(one.abs()));
    if options.json {
        let told = json!({
            "name": plan.name,
            "legs": plan.legs.len(),
            "pieces": drivable.pieces(),
            "turns": summary.turns,
            "length_m": f64::from(summary.length),
            "time_s": f64::from(summary.time),
            "largest_curvature_per_m": tightest,
            "curvature_limit_per_m": f64::from(settings.curvature),
            "record_bytes": record.len(),
        });
        println!("{told:#}");
    } else {
        println!("{}: {} can drive it", plan.name, vehicle.name());
        println!(
            "  legs                {} ({} lines, arcs and clothoids)",
            plan.legs.len(),
            drivable.pieces()
        );
        println!("  headland turns      {}", summary.turns);
        println!("  way                 {:.1} m", summary.length);
        println!("  time at full speed  {:.0} s", summary.time);
        println!(
            "  largest curvature   {tightest:.3} 1/m (the vehicle: {:.3} 1/m)",
            settings.curvature
        );
        println!("  record              {} bytes", record.len());
    }
    Ok(())
}

/// Writes the picture of a plan.
fn draw(
    path: &Path,
    plan: &Plan,
    chains: &[Chain],
    limit: f64,
    field: Option<&Field>,
) -> Result<(), Failure> {
    let options = picture::Options {
        chains,
        limit: Some(limit),
        width: field.map(|field| field.options.width),
        field,
        ..picture::Options::default()
    };
    Ok(file::put(path, &picture::svg(plan, &options))?)
}

/// The origin of the local frame: what the command line says, or what the drawing measures from, or where its first
/// shape begins.
fn origin(options: &NewMission, drawing: &read::Drawing) -> Option<Origin> {
    let first = || {
        let shape = &drawing.shapes.first()?.shape;
        match shape {
            read::Shape::Line { from, .. } => Some(*from),
            read::Shape::Curve(points) => points.first().copied(),
            read::Shape::Polygon { outer, .. } => outer.first().copied(),
        }
    };
    options.origin.or_else(|| {
        let place = drawing.origin.or_else(first)?;
        Some(Origin { place, height: 0.0 })
    })
}

/// Reads an origin: latitude and longitude, degrees, and perhaps a height, m.
pub(crate) fn origin_of(text: &str) -> Result<Origin, String> {
    const ACCEPTED: &str =
        "LATITUDE,LONGITUDE in degrees is accepted, and behind another comma the height in metres";
    let numbers: Option<Vec<f64>> = text
        .split(',')
        .map(|part| part.trim().parse().ok())
        .collect();
    let (latitude, longitude, height) = match numbers.as_deref() {
        Some(&[latitude, longitude]) => (latitude, longitude, 0.0),
        Some(&[latitude, longitude, height]) if (-500.0..=9000.0).contains(&height) => {
            (latitude, longitude, height)
        }
        _ => return Err(ACCEPTED.into()),
    };
    let place = Geodetic::checked(latitude, longitude).ok_or(ACCEPTED)?;
    Ok(Origin { place, height })
}

fn new(workspace: &Workspace, options: &NewMission) -> Result<(), Failure> {
    let vehicle = vehicle::find(workspace, &options.vehicle)?;
    let settings = settings(&vehicle).map_err(Failure::Usage)?;
    if options.out.exists() && !options.force {
        return Err(Failure::Usage(format!(
            "{} is there already: --force replaces it",
            options.out.display()
        )));
    }
    let name = options.name.clone();
    let (plan, field) = match &options.from {
        None => {
            let origin = options.origin.unwrap_or_default();
            let name = name.unwrap_or_else(|| "line".into());
            let plan = Plan::of_manifest(&name, origin, vehicle.manifest());
            (plan.ok_or_else(|| usage_of(&vehicle))?, None)
        }
        Some(path) => from_drawing(path, options, &vehicle, settings.curvature.into())?,
    };
    let usage = |why: String| Failure::Usage(format!("the mission would be wrong: {why}"));
    let drivable = Drivable::of(&plan).map_err(usage)?;
    if let Some(path) = &options.picture {
        let limit = settings.curvature.into();
        draw(path, &plan, &drivable.chains, limit, field.as_ref())?;
    }
    let summary = drivable.check(&settings).map_err(usage)?;
    file::put(&options.out, &plan.write())?;
    println!(
        "{}: {} legs, {} headland turns, {:.0} m of way, {:.0} s at full speed",
        options.out.display(),
        plan.legs.len(),
        summary.turns,
        summary.length,
        summary.time
    );
    if let Some(field) = &field {
        println!(
            "{:.0} m2 of field, {:.0} m2 inside the headland, of which the swaths cover {:.1} %; swaths at {:.0} deg",
            field.coverage.field,
            field.coverage.inner,
            field.coverage.share() * 100.0,
            field.bearing.to_degrees()
        );
        warn_of_obstacles(field.area.holes.len());
    }
    Ok(())
}

/// The fence is the edge of the field, so neither the check nor the planning of turns knows what lies inside of it.
fn warn_of_obstacles(count: usize) {
    if count > 0 {
        eprintln!(
            "warning: {count} obstacles lie in the field; swaths end before them, but turns may lead through them: look \
             at --picture, and do not drive this mission where one does"
        );
    }
}

fn usage_of(vehicle: &Vehicle) -> Failure {
    Failure::Usage(format!(
        "vehicle {:?} has no line of two waypoints: --from FILE names what the mission is made from",
        vehicle.name()
    ))
}

/// The plan from a drawing: swaths in its first field, or with `--lines` its lines.
fn from_drawing(
    path: &Path,
    options: &NewMission,
    vehicle: &Vehicle,
    curvature: f64,
) -> Result<(Plan, Option<Field>), Failure> {
    let usage = |why: String| Failure::Usage(format!("{}: {why}", path.display()));
    let given = options.origin.map(Frame::new);
    let drawing =
        read::path(path, given.as_ref()).map_err(|error| Failure::Usage(error.to_string()))?;
    for skipped in &drawing.skipped {
        eprintln!("skipped: {skipped}");
    }
    let origin = origin(options, &drawing).ok_or_else(|| usage("it has no shape".into()))?;
    let frame = Frame::new(origin);
    let cruise = vehicle.manifest().machine.as_ref();
    let cruise = cruise.map_or(1.0, |machine| machine.cruise.get());
    let speed = options.speed.unwrap_or(cruise);
    let outputs = Outputs::of(&options.section)
        .ok_or_else(|| Failure::Usage("--section: 1 to 8 are accepted".into()))?;
    if options.lines {
        let name = options.name.clone().unwrap_or_else(|| "lines".into());
        let plan = of_lines(&drawing, &frame, (speed, outputs), name, origin);
        if plan.legs.is_empty() {
            return Err(usage("it has no line".into()));
        }
        return Ok((plan, None));
    }
    let mut areas = field::areas(&drawing, &frame);
    if areas.is_empty() {
        return Err(usage(
            "it has no boundary of a field: --lines takes its lines".into(),
        ));
    }
    let (first, area) = areas.swap_remove(0);
    if !areas.is_empty() {
        eprintln!(
            "note: of {} fields the first one is taken, {first:?}",
            areas.len() + 1
        );
    }
    let divided = field::Options {
        headland: options.headland.unwrap_or(2.0 * options.width),
        direction: match options.direction {
            None => Direction::Auto,
            Some(degrees) => Direction::Bearing(degrees.to_radians()),
        },
        ends: Ends::Whole,
        order: if options.skip {
            Order::Skip
        } else {
            Order::Neighbouring
        },
        radius: 1.0 / curvature,
        ..field::Options::new(options.width)
    };
    let field = field::divide(&area, &divided).map_err(|why| usage(why.to_string()))?;
    let work = Work {
        speed,
        outputs,
        headland: Headland::Left,
        end: End::Stop,
    };
    let name = options.name.clone().unwrap_or(first);
    Ok((field.plan(&name, origin, &work), Some(field)))
}

/// A leg for each line of a drawing, with turns between them.
fn of_lines(
    drawing: &read::Drawing,
    frame: &Frame,
    (speed, outputs): (f64, Outputs),
    name: String,
    origin: Origin,
) -> Plan {
    let shapes = drawing
        .shapes
        .iter()
        .filter_map(|named| match &named.shape {
            read::Shape::Line { from, to } => Some(Shape::Line {
                from: frame.local(*from),
                to: frame.local(*to),
            }),
            read::Shape::Curve(points) => Some(Shape::Curve {
                points: points.iter().map(|point| frame.local(*point)).collect(),
            }),
            read::Shape::Polygon { .. } => None,
        });
    Plan {
        name,
        origin,
        width: None,
        fence: Vec::new(),
        legs: shapes
            .map(|shape| Leg {
                shape,
                speed,
                reverse: false,
                outputs,
                join: Join::Turn,
            })
            .collect(),
        end: End::Stop,
    }
}
