//! `mission`: makes missions from the files of farm tools, checks whether a vehicle can drive them, and draws them.

mod bus;
mod drawing;
mod drivable;
mod driven;
mod request;

use std::{fs, path::Path, sync::Arc};

use control::{
    dubins::Pose,
    mission::{MissionSettings, Summary},
};
use firmware::mission::upload::Request;

use mission::{
    curve::{Chain, Tightest},
    field::Field,
    picture,
    place::{Frame, Geodetic, Local, Origin},
    plan::Plan,
};
use serde_json::json;
use twin::{Images, Outcome};
use vehicle_model::{Device, Vehicle};
use world::{
    Scenario,
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
        Mission::Upload(options) => bus::upload_file(workspace, options),
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
    /// The origin of its frame: the base station.
    pub origin: Origin,
}

/// How far before the first leg a run begins, m: the vehicle finds its heading and its speed on the way.
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
        origin: plan.origin,
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
        let nodes = vehicle::node_names(vehicle);
        let run = Run {
            mission: Some(mission),
            ..matrix.run(scenario, &nodes, seed, outcome, (&log, &modes))
        };
        let figures = MissionFigures::of(&run, &mission);
        let picture = driven.svg(states, &figures.line());
        (figures, picture)
    }
}

/// How far the base station of a run may be from the origin of its mission, m.
const BASE: f64 = 1.0;

/// Lets the base station of a run stand at the origin of its mission. A scenario that says itself where it stands must
/// say the same place.
///
/// # Errors
/// The scenario has another place.
pub fn settle(scenario: &mut Scenario, origin: Origin) -> Result<(), Failure> {
    // Without a receiver, nothing measures.
    let Some(receiver) = &mut scenario.receiver else {
        return Ok(());
    };
    let base = &mut receiver.base;
    let place = Geodetic {
        latitude: base.latitude.get().to_degrees(),
        longitude: base.longitude.get().to_degrees(),
    };
    let at = Frame::new(origin).local(place);
    let far = at.distance(Local::default());
    if far <= BASE {
        return Ok(());
    }
    let Geodetic {
        latitude,
        longitude,
    } = origin.place;
    if *base != world::receiver::Base::default() {
        return Err(Failure::Usage(format!(
            "the mission's origin is {latitude:.7} deg, {longitude:.7} deg, and the scenario's base station \
             (receiver.base) {far:.0} m away at {:.7} deg, {:.7} deg: a vehicle measures from its base station, so both \
             must be the same place",
            place.latitude, place.longitude
        )));
    }
    eprintln!(
        "note: the base station of this run stands at the mission's origin, {latitude:.7} deg, {longitude:.7} deg; on a \
         field it must stand there, too"
    );
    base.latitude = Angle::degrees(latitude);
    base.longitude = Angle::degrees(longitude);
    base.height = Length::new(origin.height);
    Ok(())
}

fn check(workspace: &Workspace, options: &CheckMission) -> Result<(), Failure> {
    let vehicle = vehicle::with(workspace, &options.vehicle, &options.changes.overrides())?;
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
    let figures = Figures {
        plan: &plan,
        drivable: &drivable,
        summary: &summary,
        settings: &settings,
        record: record.len(),
    };
    if options.json {
        println!("{:#}", figures.json());
    } else {
        println!("{}: {} can drive it", plan.name, vehicle.name());
        figures.print();
    }
    Ok(())
}

/// The figures of a mission that a vehicle can drive.
struct Figures<'a> {
    plan: &'a Plan,
    drivable: &'a Drivable,
    summary: &'a Summary<f32>,
    settings: &'a MissionSettings<f32>,
    /// Bytes of its record.
    record: usize,
}

impl Figures<'_> {
    /// The leg with the largest curvature, counted from 1, if one is bent.
    fn tightest(&self) -> Option<(usize, &Tightest)> {
        let legs = (1..).zip(self.drivable.chains.iter().map(|chain| &chain.tightest));
        let bent = legs.filter(|(_, tightest)| tightest.curvature != 0.0);
        bent.max_by(|(_, one), (_, other)| one.curvature.abs().total_cmp(&other.curvature.abs()))
    }

    /// How far the curve of a leg swings out from the straight lines between its points, m, at most.
    fn swing(&self) -> f64 {
        let chains = self.drivable.chains.iter();
        chains.map(|chain| chain.bulge).fold(0.0, f64::max)
    }

    fn json(&self) -> serde_json::Value {
        let Geodetic {
            latitude,
            longitude,
        } = self.plan.origin.place;
        let tightest = self.tightest().map(|(leg, tightest)| {
            json!({
                "leg": leg,
                "curvature_per_m": tightest.curvature,
                "along_m": tightest.along,
                "north_m": tightest.place.north,
                "east_m": tightest.place.east,
            })
        });
        json!({
            "name": self.plan.name,
            "origin": { "latitude_deg": latitude, "longitude_deg": longitude, "height_m": self.plan.origin.height },
            "legs": self.plan.legs.len(),
            "pieces": self.drivable.pieces(),
            "turns": self.summary.turns,
            "fence_corners": self.plan.fence.len(),
            "obstacles": self.plan.obstacles.len(),
            "length_m": f64::from(self.summary.length),
            "time_s": f64::from(self.summary.time),
            "largest_curvature_per_m": f64::from(self.drivable.largest_curvature(self.settings)),
            "curvature_limit_per_m": f64::from(self.settings.curvature),
            "tightest_leg": tightest,
            "swing_out_m": self.swing(),
            "record_bytes": self.record,
            "record_room_bytes": drivable::ROOM * 4,
            "upload_room_bytes": bus::UPLOAD,
        })
    }

    fn print(&self) {
        let Origin { place, height } = self.plan.origin;
        println!(
            "  origin              {:.7} deg, {:.7} deg, {height:.1} m: the antenna of the base station",
            place.latitude, place.longitude
        );
        println!(
            "  legs                {} ({})",
            self.plan.legs.len(),
            count(
                self.drivable.pieces(),
                "line, arc or clothoid",
                "lines, arcs and clothoids"
            )
        );
        println!("  headland turns      {}", self.summary.turns);
        println!(
            "  fence               {}",
            match self.plan.fence.len() {
                0 => "none".to_owned(),
                corners => format!("{corners} corners"),
            }
        );
        println!("  obstacles           {}", self.plan.obstacles.len());
        println!("  way                 {:.1} m", self.summary.length);
        println!(
            "  time                {:.0} s, stops and accelerations come on top",
            self.summary.time
        );
        println!(
            "  largest curvature   {:.3} 1/m with the turns (the vehicle: {:.3} 1/m)",
            self.drivable.largest_curvature(self.settings),
            self.settings.curvature
        );
        if let Some((leg, tightest)) = self.tightest() {
            println!(
                "  tightest leg        leg {leg}: {:.3} 1/m, {:.1} m along it, at {}",
                tightest.curvature.abs(),
                tightest.along,
                tightest.place
            );
            println!(
                "  swing-out           {:.2} m at most from the straight lines between the points of a curve",
                self.swing()
            );
        }
        println!(
            "  record              {} of {} bytes in the flash of the controller's board",
            self.record,
            drivable::ROOM * 4
        );
        if self.record > bus::UPLOAD {
            println!(
                "  upload              too long for one, which takes {} bytes: only a debug probe can write it (mission flash)",
                bus::UPLOAD
            );
        }
    }
}

/// A number and what it counts.
fn count(number: usize, one: &str, several: &str) -> String {
    format!("{number} {}", if number == 1 { one } else { several })
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

/// Whether two names are those of one file. A file that is not there yet is known by its folder.
fn is_same(one: &Path, other: &Path) -> bool {
    let whole = |path: &Path| {
        let folder = match path.parent() {
            Some(folder) if folder != Path::new("") => folder,
            _ => Path::new("."),
        };
        let known = folder.canonicalize().ok().zip(path.file_name());
        path.canonicalize()
            .or_else(|_| known.map(|(folder, name)| folder.join(name)).ok_or(()))
    };
    match (whole(one), whole(other)) {
        (Ok(one), Ok(other)) => one == other,
        _ => one == other,
    }
}

/// Refuses to write two files of one name, or over what is read.
fn own_files(options: &NewMission) -> Result<(), Failure> {
    let files = [
        ("--from", options.from.as_deref()),
        ("--out", Some(options.out.as_path())),
        ("--picture", options.picture.as_deref()),
    ];
    for (index, (name, file)) in files.iter().enumerate() {
        for (other, with) in &files[index + 1..] {
            if let (Some(file), Some(with)) = (file, with)
                && is_same(file, with)
            {
                return Err(Failure::Usage(format!(
                    "{name} and {other} name the same file, {}: each needs a name of its own",
                    with.display()
                )));
            }
        }
    }
    Ok(())
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
    own_files(options)?;
    let name = options.name.clone();
    let (plan, field) = match &options.from {
        None => {
            let origin = options.origin.unwrap_or_default();
            let name = name.unwrap_or_else(|| "line".into());
            let plan = Plan::of_manifest(&name, origin, vehicle.manifest());
            (plan.ok_or_else(|| usage_of(&vehicle))?, None)
        }
        Some(path) => drawing::plan(path, options, &vehicle, &settings)?,
    };
    let usage = |why: String| Failure::Usage(format!("the mission would be wrong: {why}"));
    let drivable = Drivable::of(&plan).map_err(usage)?;
    if let Some(path) = &options.picture {
        let limit = settings.curvature.into();
        draw(path, &plan, &drivable.chains, limit, field.as_ref())?;
    }
    let refused = |why: String| {
        usage(match &options.picture {
            Some(path) => format!("{why}; {} shows it", path.display()),
            None => why,
        })
    };
    let summary = drivable.check_new(&settings).map_err(refused)?;
    file::put(&options.out, &plan.write())?;
    println!(
        "{}: {}, {}, {:.0} m of way, {:.0} s without stops and accelerations",
        options.out.display(),
        count(plan.legs.len(), "leg", "legs"),
        count(summary.turns, "headland turn", "headland turns"),
        summary.length,
        summary.time
    );
    if let Some(field) = &field {
        tell(field, options);
    }
    Ok(())
}

/// The figures of a field.
fn tell(field: &Field, options: &NewMission) {
    let coverage = &field.coverage;
    println!(
        "{:.0} m2 of field: the swaths work {:.1} % of it, and {:.1} % of the {:.0} m2 inside the headland; swaths at \
         {:.0} deg",
        coverage.field,
        coverage.share_of_field() * 100.0,
        coverage.share() * 100.0,
        coverage.inner,
        field.bearing.to_degrees()
    );
    println!(
        "worked twice: {:.0} m2; outside the inner area: {:.0} m2; pieces shorter than {} m left out: {}; turns tighter \
         than a half circle: {}",
        coverage.twice,
        coverage.outside,
        field.options.shortest,
        field.too_short,
        field.tight_turns
    );
    let rounds = match options.rounds {
        None => "the headland is not worked; --rounds works it, too".to_owned(),
        Some(_) => format!("rounds in the headland: {}", field.rounds().len()),
    };
    println!("{rounds}");
}

fn usage_of(vehicle: &Vehicle) -> Failure {
    Failure::Usage(format!(
        "vehicle {:?} has no line of two waypoints: --from FILE names what the mission is made from",
        vehicle.name()
    ))
}

#[cfg(test)]
mod tests {
    use std::ffi::OsString;

    use control::fence::CORNERS;
    use mission::plan::{Leg, Shape};

    use super::*;
    use crate::cli;

    /// What a command line says, and the file that it writes.
    fn made(folder: &Path, words: &str) -> Result<Plan, String> {
        let out = folder.join("made.toml");
        let words = ["xtask", "mission", "new", "--force", "--out"]
            .into_iter()
            .map(OsString::from)
            .chain([out.clone().into_os_string()])
            .chain(words.split(' ').map(OsString::from));
        let Ok(cli::Request::Run(cli::Command::Mission(command))) = cli::parse(words) else {
            panic!("the command line is not read");
        };
        run(&Workspace::find().unwrap(), &command).map_err(|why| why.to_string())?;
        read_plan(&out).map_err(|why| why.to_string())
    }

    /// A boundary of a square with a hole in its middle, or of a ring of as many corners.
    fn drawn(folder: &Path, outer: &[Local], hole: &[Local]) -> String {
        let frame = Frame::new(Origin {
            place: Geodetic {
                latitude: 40.83,
                longitude: -96.66,
            },
            height: 0.0,
        });
        let ring = |corners: &[Local]| {
            let closed = corners.iter().chain(corners.first());
            let places = closed.map(|at| frame.geodetic(*at));
            places
                .map(|at| json!([at.longitude, at.latitude]))
                .collect::<Vec<_>>()
        };
        let rings: Vec<_> = [outer, hole]
            .into_iter()
            .filter(|ring| !ring.is_empty())
            .map(ring)
            .collect();
        let polygon = json!({ "type": "Polygon", "coordinates": rings });
        let path = folder.join("drawn.geojson");
        fs::write(&path, polygon.to_string()).unwrap();
        path.display().to_string()
    }

    fn square(middle: f64, half: f64) -> Vec<Local> {
        let corner = |north, east| Local::new(middle + north * half, middle + east * half);
        vec![
            corner(-1.0, -1.0),
            corner(1.0, -1.0),
            corner(1.0, 1.0),
            corner(-1.0, 1.0),
        ]
    }

    /// What a refused command line says.
    fn refused(folder: &Path, words: &str) -> String {
        made(folder, words).unwrap_err()
    }

    #[test]
    fn no_file_is_written_over_another() {
        let folder = tempfile::tempdir().unwrap();
        let file = drawn(folder.path(), &square(0.0, 40.0), &[]);
        let out = folder.path().join("made.toml");
        let size = "--width 3 --headland 9 --origin 40.83,-96.66";
        let same = refused(
            folder.path(),
            &format!("--from {file} {size} --picture {}", out.display()),
        );
        assert!(
            same.starts_with("--out and --picture name the same file"),
            "{same}"
        );
        // By another way to it.
        let way = folder.path().join("./drawn.geojson");
        let same = refused(
            folder.path(),
            &format!("--from {file} {size} --picture {}", way.display()),
        );
        assert!(
            same.starts_with("--from and --picture name the same file"),
            "{same}"
        );
        assert!(!out.exists());
    }

    #[test]
    fn a_boundary_with_a_gap_is_refused_and_nothing_is_written() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("gap.csv");
        fs::write(
            &file,
            "north,east\n0,0\n60,0\n60,20\n25,\n25,50\n0,50\n0,0\n",
        )
        .unwrap();
        let options = "--width 3 --headland 6 --origin 40.83,-96.66";
        let why = refused(
            folder.path(),
            &format!("--from {} {options}", file.display()),
        );
        assert!(why.contains("gap.csv: line 5: east is \"\""), "{why}");
        assert!(!folder.path().join("made.toml").exists());
    }

    /// What the UAGV can drive, and a plan for a square field.
    fn square_field() -> (MissionSettings<f32>, Plan) {
        let folder = tempfile::tempdir().unwrap();
        let vehicle = vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap();
        let settings = settings(&vehicle).unwrap();
        let file = drawn(folder.path(), &square(0.0, 40.0), &[]);
        let options = "--width 3 --headland 9 --origin 40.83,-96.66";
        let plan = made(folder.path(), &format!("--from {file} {options}")).unwrap();
        (settings, plan)
    }

    /// A mission of one leg, which is otherwise as the first one of a plan.
    fn drivable(plan: &Plan, shape: Shape) -> Drivable {
        let leg = Leg {
            shape,
            ..plan.legs[0].clone()
        };
        let plan = Plan {
            legs: vec![leg],
            fence: Vec::new(),
            ..plan.clone()
        };
        Drivable::of(&plan).unwrap()
    }

    #[test]
    fn a_curvature_that_changes_too_fast_is_refused_with_the_limit() {
        let (settings, plan) = square_field();
        // From a line to an arc of three metres, with a steering that is slow.
        let bends = (0..100_i32).map(|step| {
            let along = 0.02 * f64::from(step - 50);
            let heading = along.max(0.0) / 3.0;
            let north = if along < 0.0 {
                along
            } else {
                3.0 * heading.sin()
            };
            Local::new(north, 3.0 - 3.0 * heading.cos())
        });
        let slow = MissionSettings {
            steering_rate: settings.steering_rate / 10.0,
            ..settings
        };
        let points = bends.collect();
        let bends = drivable(&plan, Shape::Curve { points });
        assert!(bends.check(&settings).is_ok());
        let refused = bends.check(&slow).unwrap_err();
        let number_behind = |words: &str| -> f64 {
            let (_, rest) = refused.split_once(words).expect(words);
            rest.split(' ').next().unwrap().parse().unwrap()
        };
        let (by, limit) = (
            number_behind("can follow, by "),
            number_behind("takes up to "),
        );
        assert!(by > limit && limit > 0.1, "{refused}");
    }

    #[test]
    fn a_refusal_names_place_value_and_limit() {
        let (settings, plan) = square_field();
        let why = |shape: Shape| drivable(&plan, shape).check(&settings).unwrap_err();
        assert_eq!(
            why(Shape::Line {
                from: Local::new(5000.0, 1.0),
                to: Local::new(5040.0, 1.0)
            }),
            "leg 1: 5000.00 m north, 1.00 m east is too far: a vehicle takes up to 4096 m north, south, east and west of the \
             origin"
        );
        let points = (0..20_i32).map(|step| {
            let angle = f64::from(step) * 0.1;
            Local::new(angle.sin(), 1.0 - angle.cos())
        });
        let sharp = why(Shape::Curve {
            points: points.collect(),
        });
        for part in [
            "leg 1: its curvature is ",
            " 1/m at ",
            "the vehicle takes up to ",
        ] {
            assert!(sharp.contains(part), "{sharp}");
        }
        // Only `mission new` has a headland.
        let outside = Plan {
            fence: square(0.0, 40.0),
            legs: vec![Leg {
                shape: Shape::Line {
                    from: Local::new(-30.0, 39.8),
                    to: Local::new(30.0, 39.8),
                },
                ..plan.legs[0].clone()
            }],
            ..plan.clone()
        };
        let outside = Drivable::of(&outside).unwrap();
        let (checked, made) = (
            outside.check(&settings).unwrap_err(),
            outside.check_new(&settings).unwrap_err(),
        );
        assert!(
            checked.contains("the vehicle would leave the fence")
                && !checked.contains("--headland"),
            "{checked}"
        );
        assert!(made.contains("--headland"), "{made}");
    }

    /// A pole of a centimetre, or what a drawing program left behind: nobody knows.
    #[test]
    fn a_hole_of_a_centimetre_is_an_obstacle_of_a_decimetre() {
        let folder = tempfile::tempdir().unwrap();
        for half in [0.004, 0.000_5] {
            let file = drawn(folder.path(), &square(0.0, 40.0), &square(0.0, half));
            let options = "--width 3 --headland 9 --origin 40.83,-96.66";
            let plan = made(folder.path(), &format!("--from {file} {options}")).unwrap();
            let [obstacle] = &plan.obstacles[..] else {
                panic!("{:?}", plan.obstacles);
            };
            let size = mission::polygon::area(obstacle).abs();
            assert!((0.009..0.013).contains(&size), "{size} m2");
        }
    }

    #[test]
    fn a_hole_is_an_obstacle_of_the_mission() {
        let folder = tempfile::tempdir().unwrap();
        let file = drawn(folder.path(), &square(0.0, 40.0), &square(0.0, 2.0));
        let plan = made(
            folder.path(),
            &format!("--from {file} --width 3 --headland 9 --origin 40.83,-96.66"),
        )
        .unwrap();
        assert_eq!((plan.fence.len(), plan.obstacles.len()), (4, 1));
        // A mission that drives through it is refused.
        let through = Plan {
            legs: vec![Leg {
                shape: Shape::Line {
                    from: Local::new(-20.0, 2.2),
                    to: Local::new(20.0, 2.2),
                },
                ..plan.legs[0].clone()
            }],
            ..plan
        };
        let vehicle = vehicle::find(&Workspace::find().unwrap(), "uagv").unwrap();
        let settings = settings(&vehicle).unwrap();
        let refused = Drivable::of(&through)
            .unwrap()
            .check(&settings)
            .unwrap_err();
        assert!(refused.contains("obstacle"), "{refused}");
        let clear = Plan {
            obstacles: Vec::new(),
            ..through
        };
        assert!(Drivable::of(&clear).unwrap().check(&settings).is_ok());
    }

    /// A mission is not planned faster than the drive can follow.
    #[test]
    fn a_mission_accelerates_as_its_drive_does() {
        let workspace = Workspace::find().unwrap();
        let acceleration = |limit: &str| {
            let values = format!("machine.limits.acceleration={limit}");
            let values = vehicle_model::Overrides::parse(&values).unwrap();
            let vehicle = vehicle::with(&workspace, "uagv", &values).unwrap();
            settings(&vehicle).unwrap().pace.acceleration
        };
        let found = ["0.2 m/s2", "0.5 m/s2", "2 m/s2"].map(acceleration);
        assert_eq!(found, [0.2, 0.5, 0.5]);
    }

    /// A line that leaves the boundary leaves it without a fence, but not without its obstacles.
    #[test]
    fn obstacles_beside_lines_stay() {
        let folder = tempfile::tempdir().unwrap();
        let file = drawn(folder.path(), &square(0.0, 40.0), &square(0.0, 2.0));
        let text = fs::read_to_string(&file).unwrap();
        let polygon: serde_json::Value = serde_json::from_str(&text).unwrap();
        let frame = Frame::new(Origin {
            place: Geodetic {
                latitude: 40.83,
                longitude: -96.66,
            },
            height: 0.0,
        });
        let with_line = |east: f64| {
            let places = [-50.0, 0.0, 50.0].map(|north| frame.geodetic(Local::new(north, east)));
            let line = places.map(|at| json!([at.longitude, at.latitude]));
            let line = json!({ "type": "LineString", "coordinates": line });
            let all = json!({ "type": "GeometryCollection", "geometries": [polygon, line] });
            fs::write(&file, all.to_string()).unwrap();
            let words = format!("--from {file} --lines --width 3 --origin 40.83,-96.66");
            made(folder.path(), &words)
        };
        let beside = with_line(10.0).unwrap();
        assert_eq!((beside.fence.len(), beside.obstacles.len()), (0, 1));
        let through = with_line(1.0).unwrap_err();
        assert!(through.contains("obstacle"), "{through}");
    }

    /// A file of ISO 11783-10 with two fields that are a kilometre apart, each with a line and an obstacle; the second has no boundary.
    fn two_fields(folder: &Path) -> String {
        let place = |north: f64, east: f64| {
            let (latitude, longitude) = (51.0 + north / 111_240.0, 7.0 + east / 70_190.0);
            format!("<PNT A=\"2\" C=\"{latitude:.8}\" D=\"{longitude:.8}\"/>")
        };
        let string = |kind: u32, places: &[(f64, f64)]| {
            let points: String = places.iter().map(|(n, e)| place(*n, *e)).collect();
            format!("<LSG A=\"{kind}\">{points}</LSG>")
        };
        let field = |name: &str, from: f64, boundary: bool| {
            let line = string(5, &[(from + 20.0, 50.0), (from + 80.0, 50.0)]);
            let wall = string(9, &[(from + 20.0, 60.0), (from + 80.0, 60.0)]);
            let edge = [(0.0, 0.0), (0.0, 100.0), (100.0, 100.0), (100.0, 0.0)];
            let edge = edge.map(|(north, east)| (from + north, east));
            let edge = match boundary {
                true => format!("<PLN A=\"1\">{}</PLN>", string(1, &edge)),
                false => String::new(),
            };
            format!("<PFD A=\"PFD1\" C=\"{name}\">{edge}{line}{wall}</PFD>")
        };
        let file = folder.join("TASKDATA.XML");
        let fields = field("near", 0.0, true) + &field("far", 1000.0, false);
        fs::write(
            &file,
            format!("<ISO11783_TaskData>{fields}</ISO11783_TaskData>"),
        )
        .unwrap();
        file.to_str().unwrap().to_owned()
    }

    #[test]
    fn lines_of_one_field_are_driven_and_its_obstacles_are_not() {
        let folder = tempfile::tempdir().unwrap();
        let file = two_fields(folder.path());
        let lines = |words: &str| made(folder.path(), &format!("--from {file} --lines {words}"));
        let counts = |plan: &Plan| (plan.legs.len(), plan.fence.len(), plan.obstacles.len());
        for words in ["--width 3", "--field near"] {
            let near = lines(words).unwrap();
            assert_eq!(counts(&near), (1, 4, 1), "{words:?}");
            let Shape::Line { from, to } = near.legs[0].shape else {
                panic!()
            };
            assert!((from.distance(to) - 60.0).abs() < 0.1);
        }
        assert_eq!(counts(&lines("--no-fence").unwrap()), (1, 0, 1));
        // A field without a boundary has its obstacles all the same.
        assert_eq!(counts(&lines("--field far").unwrap()), (1, 0, 1));
        let refused = lines("--field nowhere").unwrap_err();
        assert!(
            refused.ends_with("\"nowhere\" has no line; fields with lines are \"near\", \"far\""),
            "{refused}"
        );
    }

    /// Two fields side by side, with a pond in the second and a line in each.
    #[test]
    fn a_field_of_several_is_driven_with_its_own_lines() {
        let folder = tempfile::tempdir().unwrap();
        let frame = Frame::new(Origin {
            place: Geodetic {
                latitude: 40.83,
                longitude: -96.66,
            },
            height: 0.0,
        });
        let places = |corners: &[Local]| {
            let places = corners.iter().map(|at| frame.geodetic(*at));
            places
                .map(|at| json!([at.longitude, at.latitude]))
                .collect::<Vec<_>>()
        };
        let closed = |ring: Vec<Local>| places(&[&ring[..], &ring[..1]].concat());
        let aside = |ring: Vec<Local>, east: f64| -> Vec<Local> {
            ring.into_iter()
                .map(|at| Local::new(at.north, at.east + east))
                .collect()
        };
        let feature = |name: &str, kind: &str, coordinates: serde_json::Value| {
            json!({ "type": "Feature", "properties": { "name": name },
                    "geometry": { "type": kind, "coordinates": coordinates } })
        };
        let line = |east: f64| json!(places(&[-50.0, 50.0].map(|north| Local::new(north, east))));
        let rings = json!([
            closed(aside(square(0.0, 60.0), 200.0)),
            closed(aside(square(0.0, 10.0), 200.0))
        ]);
        let features = [
            feature("a", "Polygon", json!([closed(square(0.0, 60.0))])),
            feature("b", "Polygon", rings),
            feature("line of a", "LineString", line(0.0)),
            feature("line of b", "LineString", line(230.0)),
        ];
        let drawn = json!({ "type": "FeatureCollection", "features": features });
        let file = folder.path().join("fields.geojson");
        fs::write(&file, drawn.to_string()).unwrap();
        let lines = |words: &str| {
            let file = file.display();
            made(
                folder.path(),
                &format!("--from {file} --lines --origin 40.83,-96.66 {words}"),
            )
        };
        let counts = |plan: &Plan| (plan.legs.len(), plan.fence.len(), plan.obstacles.len());
        let b = lines("--field b").unwrap();
        assert_eq!(counts(&b), (1, 4, 1));
        assert!((b.legs[0].shape.points()[0].east - 230.0).abs() < 0.01);
        assert_eq!(counts(&lines("--field a").unwrap()), (1, 4, 0));
        // Both lines, and no fence round both: the pond stays.
        assert_eq!(counts(&lines("--width 3").unwrap()), (2, 0, 1));
    }

    #[test]
    fn a_boundary_of_many_corners_becomes_a_fence_of_few() {
        let folder = tempfile::tempdir().unwrap();
        let walked: Vec<Local> = (0..400_i32)
            .map(|index| {
                let aside = f64::from(index * 37 % 11) * 0.01;
                Local::default().towards(
                    f64::from(index) * 0.005 * std::f64::consts::PI,
                    40.0 + aside,
                )
            })
            .collect();
        let file = drawn(folder.path(), &walked, &[]);
        let plan = made(
            folder.path(),
            &format!("--from {file} --width 4 --headland 10 --origin 40.83,-96.66"),
        )
        .unwrap();
        assert!((3..=CORNERS).contains(&plan.fence.len()));
        let inside = |corner: &Local| mission::polygon::holds(&walked, *corner, 1e-3);
        assert!(plan.fence.iter().all(inside));
    }
}
