//! The release images of the UAGV drive a mission from their flash: two swaths with a headland turn between them.

use std::sync::OnceLock;

use twin::{Images, Options, Outcome};
use vehicle_model::Vehicle;
use world::Scenario;
use world::time::{from_seconds, seconds};
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

/// A run with these words in the place of a mission.
fn run(record: Option<Vec<u8>>, length: f64) -> (Scenario, Outcome) {
    let (vehicle, images) = uagv();
    let text = "[[press]]\nat = \"4 s\"\nbutton = \"C\"\n[[press]]\nat = \"5 s\"\nbutton = \"C\"\n";
    let mut scenario = Scenario::parse(vehicle, "test", "the test's scenario", text).unwrap();
    let images = match record {
        Some(record) => {
            mission().begin(&mut scenario);
            let mut loaded = mission().clone();
            loaded.record = record;
            loaded.with_images(images.clone(), vehicle)
        }
        None => images.clone(),
    };
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
#[ignore = "hours: a hectare at two speeds with five seeds"]
fn a_hectare_is_driven_within_the_limits() {
    let workspace = xtask::Workspace::find().unwrap();
    let words = ["xtask", "sim", "--experiment", "field", "--seeds", "5"];
    let Ok(cli::Request::Run(cli::Command::Sim(options))) =
        cli::parse(words.map(std::ffi::OsString::from))
    else {
        panic!("not read");
    };
    xtask::experiment::run(&workspace, "field", &options).unwrap();
}
