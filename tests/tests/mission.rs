//! The release images of the UAGV drive a mission from their flash: two swaths with a headland turn between them. So do
//! those of a larger vehicle.

use std::sync::OnceLock;

use can_bus::RecordKind;
use embedded_can::{Id, StandardId};

use twin::{Images, Options, Outcome};
use vehicle_model::Vehicle;
use world::Scenario;
use world::time::{from_seconds, seconds};
use world::units::{Angle, Length};
use xtask::cli;
use xtask::experiment::field;
use xtask::mission::Loaded;

/// The vehicle with its images.
fn uagv() -> &'static (Vehicle, Images) {
    static VEHICLE: OnceLock<(Vehicle, Images)> = OnceLock::new();
    VEHICLE.get_or_init(|| furrow_tests::with("mission.enabled=true"))
}

/// Two swaths of 20 m at 2 m/s, with the turn between them.
fn mission() -> &'static Loaded {
    static MISSION: OnceLock<Loaded> = OnceLock::new();
    MISSION.get_or_init(|| field::loaded(&uagv().0, 2, 20.0, 6.0, 2.0).unwrap())
}

/// The mission of a file that says this.
fn written(text: &str) -> Loaded {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("mission.toml");
    std::fs::write(&path, text).unwrap();
    xtask::mission::load(&uagv().0, &path).unwrap()
}

/// A run with these words in the place of a mission.
fn run(record: Option<Vec<u8>>, length: f64) -> (Scenario, Outcome) {
    let loaded = record.map(|record| {
        let mut loaded = mission().clone();
        loaded.record = record;
        loaded
    });
    run_from(loaded.as_ref(), length, |_| ())
}

/// A run of a mission, or of the line, that begins where `place` says.
fn run_from(
    mission: Option<&Loaded>,
    length: f64,
    place: impl Fn(&mut Scenario),
) -> (Scenario, Outcome) {
    let (vehicle, images) = uagv();
    let text = "[[press]]\nat = \"4 s\"\nbutton = \"C\"\n[[press]]\nat = \"5 s\"\nbutton = \"C\"\n";
    let mut scenario = Scenario::parse(vehicle, "test", "the test's scenario", text).unwrap();
    let images = match mission {
        Some(mission) => {
            mission.begin(&mut scenario);
            mission.with_images(images.clone(), vehicle)
        }
        None => images.clone(),
    };
    place(&mut scenario);
    let options = Options {
        duration: Some(from_seconds(length)),
        ..Options::default()
    };
    let outcome = twin::run(vehicle, &scenario, &images, &options, |_| {}).unwrap();
    (scenario, outcome)
}

/// Rear axle, m north and east, heading, rad, and speed, m/s, at each sample.
fn rear(outcome: &Outcome) -> Vec<(f64, [f64; 4])> {
    let states = outcome.world.states().iter();
    let of = states.map(|at| {
        let (north, east) = (at.heading.cos() * 0.255, at.heading.sin() * 0.255);
        let place = [at.north - north, at.east - east, at.heading, at.speed];
        (seconds(at.at), place)
    });
    of.collect()
}

/// Mode and reason of the last change.
fn last_change(outcome: &Outcome) -> (u8, u8) {
    let mode_change = StandardId::new(501).map(Id::from).unwrap();
    let mut changes = outcome
        .records
        .iter()
        .filter_map(|record| match &record.kind {
            RecordKind::FrameEnd { frame, .. } if frame.id() == mode_change => Some(frame.data()),
            _ => None,
        });
    let data = changes.next_back().expect("the mode has changed");
    (data[1], data[2])
}

/// Numbers of the network file.
const RUN: u8 = 3;
const FAULT: u8 = 5;
const BUTTON_C: u8 = 3;
const FENCE: u8 = 18;

/// How far from a point the ground of the vehicle comes, m: half its width about the line from 0.3 m behind the rear axle to
/// 1.4 m ahead.
fn clear_of(outcome: &Outcome, north: f64, east: f64) -> f64 {
    let distances = rear(outcome).into_iter().map(|(_, [n, e, heading, _])| {
        let (n, e) = (north - n, east - e);
        let ahead = n * heading.cos() + e * heading.sin();
        let aside = e * heading.cos() - n * heading.sin();
        (ahead - ahead.clamp(-0.3, 1.4)).hypot(aside) - 0.35
    });
    distances.fold(f64::INFINITY, f64::min)
}

/// Where the turn would lead without it, an obstacle makes the vehicle turn in another way.
#[test]
fn a_turn_keeps_clear_of_an_obstacle() {
    const SWATHS: &str = "name = \"obstacle\"\nfence = [[-12, -12], [30, -12], [30, 15], [-12, 15]]\n\
        [origin]\nlatitude = \"40.83 deg\"\nlongitude = \"-96.66 deg\"\n\
        [[leg]]\nfrom = [0, 0]\nto = [15, 0]\nspeed = \"1 m/s\"\n\
        [[leg]]\nfrom = [15, 3]\nto = [5, 3]\nspeed = \"1 m/s\"\n";
    let free = run_from(Some(&written(SWATHS)), 60.0, |_| ()).1;
    let apex = rear(&free).into_iter().map(|(_, at)| at);
    let [north, east, ..] = apex.max_by(|a, b| a[0].total_cmp(&b[0])).unwrap();
    let obstacle = format!(
        "[[obstacle]]\ncorners = [[{0}, {1}], [{2}, {1}], [{2}, {3}], [{0}, {3}]]\n",
        north - 0.1,
        east - 0.1,
        north + 0.1,
        east + 0.1
    );
    let beside = written(&format!("{SWATHS}{obstacle}"));
    let (scenario, outcome) = run_from(Some(&beside), 90.0, |_| ());
    let (figures, _) = beside.judge(&uagv().0, &scenario, 1, &outcome);
    assert!(figures.finished && figures.turns.len() == 1, "{figures:?}");
    for (n, e) in [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1)] {
        let clear = clear_of(&outcome, north + n, east + e);
        assert!(clear > 0.05, "{clear:.3} m from {n} {e}");
    }
}

/// The path keeps the vehicle inside its fence, but a run can begin outside, or with the fence right ahead.
#[test]
fn no_run_goes_on_outside_the_fence() {
    let fenced = written(
        "name = \"fence\"\nfence = [[-10, -4], [40, -4], [40, 4], [-10, 4]]\n\
         [origin]\nlatitude = \"40.83 deg\"\nlongitude = \"-96.66 deg\"\n\
         [[leg]]\nfrom = [0, 0]\nto = [30, 0]\nspeed = \"1 m/s\"\n",
    );
    let from = |north: f64, east: f64, heading: f64| {
        let place = |scenario: &mut Scenario| {
            scenario.start.north = Length::new(north);
            scenario.start.east = Length::new(east);
            scenario.start.heading = Angle::new(heading);
        };
        run_from(Some(&fenced), 12.0, place).1
    };
    let outside = from(-3.0, 9.0, 0.0);
    assert_eq!(last_change(&outside), (FAULT, FENCE));
    let states = rear(&outside);
    assert!(
        states
            .iter()
            .all(|(_, [north, ..])| (north - states[0].1[0]).abs() < 0.02)
    );
    // It finds its heading on the way, and has no room for the turn then. At 1 m/s it stops within a metre.
    let towards = from(0.0, 2.0, std::f64::consts::FRAC_PI_2);
    assert_eq!(last_change(&towards), (FAULT, FENCE));
    let front = rear(&towards)
        .into_iter()
        .map(|(_, [_, east, heading, _])| east + 1.4 * heading.sin());
    let beyond = front.fold(f64::NEG_INFINITY, f64::max);
    assert!((3.6..4.6).contains(&beyond), "{beyond}");
    let &(_, [.., speed]) = rear(&towards).last().unwrap();
    assert!(speed.abs() < 0.01);
}

/// Before the vehicle has moved, its heading is not known: no run begins where no heading keeps its ground inside. Otherwise
/// it ends when the heading is known, two decimetres on, and the report says what ended it.
#[test]
fn a_run_that_begins_at_the_fence_is_short() {
    let fenced = written(
        "name = \"fence\"\nfence = [[-10, -4], [40, -4], [40, 4], [-10, 4]]\n\
         [origin]\nlatitude = \"40.83 deg\"\nlongitude = \"-96.66 deg\"\n\
         [[leg]]\nfrom = [0, 0]\nto = [30, 0]\nspeed = \"1 m/s\"\n",
    );
    // Straight ahead to the fence, the antenna so far inside.
    let begun = |inside: f64| {
        let place = |scenario: &mut Scenario| {
            scenario.start.north = Length::new(40.0 - inside);
            scenario.start.east = Length::new(0.0);
            scenario.start.heading = Angle::new(0.0);
        };
        let (scenario, outcome) = run_from(Some(&fenced), 10.0, place);
        assert_eq!(last_change(&outcome), (FAULT, FENCE));
        let states = outcome.world.states();
        let (first, last) = (states.first().unwrap(), states.last().unwrap());
        let (figures, _) = fenced.judge(&uagv().0, &scenario, 1, &outcome);
        (last.north - first.north, figures)
    };
    let (moved, figures) = begun(0.3);
    assert!(moved.abs() < 1e-3 && !figures.finished, "{moved} m");
    let (moved, figures) = begun(0.5);
    assert!((0.1..0.25).contains(&moved), "{moved} m");
    // It is beyond the end of its mission, where no path has led it.
    assert!(!figures.finished, "{figures:?}");
    let end = figures.ended.unwrap();
    assert_eq!(
        (&*end.mode, end.reason.as_deref()),
        ("Fault", Some("Fence"))
    );
}

/// As in the experiment with a hectare: true errors, sections within 5 cm of the ends of the swaths, and the ground.
#[test]
fn two_swaths_and_their_turn_are_driven() {
    let (scenario, outcome) = run(Some(mission().record.clone()), 70.0);
    let (figures, picture) = mission().judge(&uagv().0, &scenario, 1, &outcome);
    assert_eq!(field::LIMITS.missed(&figures), [""; 0], "{figures:?}");
    assert_eq!((figures.legs.len(), figures.turns.len()), (2, 1));
    assert!(figures.legs.iter().all(|leg| leg.sections.len() == 1));
    assert!(picture.contains("class=\"driven\""));
    // At rest at its end.
    let &(_, [north, east, _, speed]) = rear(&outcome).last().unwrap();
    assert!((north - 0.0).abs() < 0.1 && (east - 4.5).abs() < 0.1 && speed.abs() < 0.01);
}

/// A variant of the UAGV: a longer vehicle that steers farther, at 3 m/s.
#[test]
#[ignore = "two minutes: images of their own"]
fn a_larger_vehicle_drives_two_swaths_and_their_turn() {
    let (vehicle, images) = furrow_tests::of("tractor", "mission.enabled=true");
    assert_eq!(vehicle.variant_of(), Some("uagv"));
    let loaded = field::loaded(&vehicle, 2, 40.0, 6.0, 3.0).unwrap();
    let text = "[[press]]\nat = \"4 s\"\nbutton = \"C\"\n[[press]]\nat = \"5 s\"\nbutton = \"C\"\n";
    let mut scenario = Scenario::parse(&vehicle, "test", "the test's scenario", text).unwrap();
    loaded.begin(&mut scenario);
    let images = loaded.with_images(images, &vehicle);
    let options = Options {
        duration: Some(from_seconds(90.0)),
        ..Options::default()
    };
    let outcome = twin::run(&vehicle, &scenario, &images, &options, |_| {}).unwrap();
    let (figures, _) = loaded.judge(&vehicle, &scenario, 1, &outcome);
    assert_eq!(field::LIMITS.missed(&figures), [""; 0], "{figures:?}");
    assert_eq!((figures.legs.len(), figures.turns.len()), (2, 1));
    let states = outcome.world.states().iter();
    let fastest = states.map(|at| at.speed).fold(0.0, f64::max);
    assert!(fastest > 2.9, "{fastest} m/s");
}

/// What is no whole record is not driven, and neither is a line in its place.
#[test]
fn a_damaged_record_is_not_driven() {
    let mut record = mission().record.clone();
    record[40] ^= 1;
    let (_, outcome) = run(Some(record), 12.0);
    assert!(
        rear(&outcome)
            .iter()
            .all(|(_, [.., speed])| speed.abs() < 0.01)
    );
}

#[test]
fn without_a_record_the_line_is_driven() {
    let (_, outcome) = run(None, 20.0);
    let &(_, [north, east, _, speed]) = rear(&outcome).last().unwrap();
    assert!(north > 8.0 && east.abs() < 0.03 && (speed - 1.0).abs() < 0.05);
}

/// The experiment with its aims, on the images.
#[test]
#[ignore = "hours: a hectare at each speed with five seeds"]
fn a_hectare_is_driven_within_the_limits() {
    let workspace = xtask::Workspace::find().unwrap();
    for vehicle in ["uagv", "tractor"] {
        let line = format!("xtask sim --experiment field --seeds 5 --vehicle {vehicle}");
        let words = line.split(' ').map(std::ffi::OsString::from);
        let Ok(cli::Request::Run(cli::Command::Sim(options))) = cli::parse(words) else {
            panic!("not read");
        };
        xtask::experiment::run(&workspace, "field", &options).unwrap();
    }
}

/// Nothing ends a run by mistake on slopes, with slip and with positions that wander: four half hours.
#[test]
#[ignore = "an hour or two: half an hour's drive on four grounds"]
fn two_hours_without_a_false_stop() {
    const ROUND: &str = "name = \"round\"\nend = \"repeat\"\n\
        [origin]\nlatitude = \"40.83 deg\"\nlongitude = \"-96.66 deg\"\n\
        [[leg]]\nfrom = [0, 0]\nto = [80, 0]\nspeed = \"1.5 m/s\"\n\
        [[leg]]\nfrom = [80, 6]\nto = [0, 6]\nspeed = \"1 m/s\"\n";
    const GROUNDS: [&str; 4] = [
        "slope = \"5 deg\"\ndownhill = \"90 deg\"\nwheel_slip = \"10 %\"",
        "slope = \"6 deg\"\ndownhill = \"0 deg\"\nwheel_slip = \"20 %\"",
        "wheel_slip = \"30 %\"",
        "slope = \"8 deg\"\ndownhill = \"45 deg\"\nwheel_slip = \"5 %\"",
    ];
    let round = written(ROUND);
    let (vehicle, images) = uagv();
    for (seed, ground) in (1..).zip(GROUNDS) {
        let text = format!(
            "[ground]\n{ground}\n[receiver]\nnoise = \"3 cm\"\ncorrelation = \"30 s\"\n\
             [[press]]\nat = \"4 s\"\nbutton = \"C\"\n[[press]]\nat = \"5 s\"\nbutton = \"C\"\n"
        );
        let mut scenario = Scenario::parse(vehicle, "test", "the test's scenario", &text).unwrap();
        round.begin(&mut scenario);
        let options = Options {
            duration: Some(from_seconds(1800.0)),
            seed,
            ..Options::default()
        };
        let images = round.with_images(images.clone(), vehicle);
        let outcome = twin::run(vehicle, &scenario, &images, &options, |_| {}).unwrap();
        assert_eq!(last_change(&outcome), (RUN, BUTTON_C), "{ground}");
        let moving = rear(&outcome)
            .iter()
            .filter(|(at, [.., speed])| *at > 20.0 && speed.abs() > 0.1)
            .count();
        let all = outcome.world.states().len();
        assert!(moving * 100 > all * 95, "{ground}: {moving} of {all}");
    }
}
