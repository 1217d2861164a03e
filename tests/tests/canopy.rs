//! The release images of the UAGV with guidance by rows: crop rows take over where the fix is lost.

use std::sync::OnceLock;

use twin::{Images, Options, Outcome};
use vehicle_model::{Overrides, Vehicle};
use world::Scenario;
use world::crop::CropSample;
use world::time::{from_seconds, seconds};

/// The vehicle with its images.
fn vehicle() -> &'static (Vehicle, Images) {
    static VEHICLE: OnceLock<(Vehicle, Images)> = OnceLock::new();
    VEHICLE.get_or_init(|| {
        let build = || {
            let workspace = xtask::Workspace::find()?;
            let overrides = "row_guidance.enabled=true;row_guidance.settle=1 s";
            let overrides = Overrides::parse(overrides).expect("values of the manifest");
            let vehicle = xtask::vehicle::with(&workspace, "uagv", &overrides)?;
            let nodes: Vec<_> = vehicle.nodes().collect();
            let images = xtask::build::images(&workspace, &vehicle, &nodes)?;
            Ok((vehicle, xtask::build::read(&images)?))
        };
        build().unwrap_or_else(|failure: xtask::Failure| panic!("{failure}"))
    })
}

/// When the fix is lost, s.
const LOST: f64 = 6.5;

/// A run from 1 s on, along rows that begin after a metre and end after `length` metres more. Their
/// middle is 5 cm to the right of the line.
fn drive(length: f64, more: &str, until: f64) -> Outcome {
    let (vehicle, images) = vehicle();
    let text = format!(
        "row.place = {{ along = \"1 m\", right = \"5 cm\" }}\n\
         [[row.section]]\nkind = \"stalks\"\nlength = \"{length} m\"\nwidth = \"1.1 m\"\n\
         [[press]]\nat = \"500 ms\"\nbutton = \"C\"\n[[press]]\nat = \"1 s\"\nbutton = \"C\"\n\
         [[fix]]\nat = \"{LOST} s\"\nstate = \"float\"\n{more}"
    );
    let scenario = Scenario::parse(vehicle, "test", "the test's scenario", &text).unwrap();
    let options = Options {
        duration: Some(from_seconds(until)),
        ..Options::default()
    };
    twin::run(vehicle, &scenario, images, &options, |_| {}).unwrap()
}

/// The samples from one time to another, in seconds.
fn between(outcome: &Outcome, from: f64, to: f64) -> impl Iterator<Item = &CropSample> {
    let all = outcome.world.crop().unwrap().samples().iter();
    all.filter(move |sample| (from..to).contains(&seconds(sample.at)))
}

/// When the drive's motor driver was commanded to stop for good, s.
fn stopped(outcome: &Outcome) -> Option<f64> {
    let node = vehicle().0.find_node("drive").unwrap();
    let mut changes = outcome.world.efforts().iter();
    let last = changes.rfind(|change| change.node == node)?;
    (last.effort == 0.0).then(|| seconds(last.at))
}

#[test]
fn rows_take_over_below_the_canopy_and_give_back() {
    let fixed = "[[fix]]\nat = \"13 s\"\nstate = \"fixed\"\n";
    let outcome = drive(25.0, fixed, 19.0);
    assert_eq!(stopped(&outcome), None);
    let speed = |from, to| {
        let speeds: Vec<f64> = between(&outcome, from, to)
            .map(|it| it.state.speed)
            .collect();
        speeds.iter().sum::<f64>() / speeds.len() as f64
    };
    assert!((speed(5.0, 6.0) - 1.0).abs() < 0.05);
    assert!(
        (speed(9.0, 13.0) - 0.5).abs() < 0.05,
        "{}",
        speed(9.0, 13.0)
    );
    assert!((speed(18.0, 19.0) - 1.0).abs() < 0.05);
    let off = |from, to, middle: f64| {
        let offs = between(&outcome, from, to).map(|it| (it.right - middle).abs());
        offs.fold(0.0, f64::max)
    };
    // First on the line, then in the middle of the row, then on the line again.
    assert!(off(5.0, 6.5, -0.05) < 0.03, "{}", off(5.0, 6.5, -0.05));
    assert!(off(10.0, 13.0, 0.0) < 0.05, "{}", off(10.0, 13.0, 0.0));
    assert!(off(18.5, 19.0, -0.05) < 0.05, "{}", off(18.5, 19.0, -0.05));
    assert_eq!(outcome.world.crop().unwrap().touches(), []);
}

/// Asserts that the vehicle drives by its rows until `fault`, and stops within `least` to `most`
/// seconds after it.
fn assert_stops(outcome: &Outcome, fault: f64, least: f64, most: f64) {
    let stopped = stopped(outcome).expect("the vehicle drives on");
    assert!((least..=most).contains(&(stopped - fault)), "{stopped} s");
    let still = |sample: &CropSample| sample.state.speed.abs() < 0.01;
    assert!(
        outcome
            .world
            .crop()
            .unwrap()
            .samples()
            .last()
            .is_some_and(still)
    );
}

/// The message is 310 ms old at the third control step without a new one, and it was 10 ms old at the
/// last one.
#[test]
fn without_messages_of_the_rows_the_vehicle_stops() {
    let reset = "[[reset]]\nnode = \"rows\"\nat = \"8 s\"\n";
    assert_stops(&drive(25.0, reset, 10.0), 8.0, 0.2, 0.5);
}

#[test]
fn the_vehicle_stops_at_the_end_of_its_row() {
    let outcome = drive(7.0, "", 13.0);
    let last = outcome.world.crop().unwrap().samples().last().unwrap();
    assert!(last.state.speed.abs() < 0.01);
    // The sensors look 2 m ahead, and an end needs 1.6 m without plants.
    assert!((5.5..7.5).contains(&last.station), "{}", last.station);
}

/// Both sensors' leads are open or shorted: nothing is a row.
#[test]
#[ignore = "long: two drives"]
fn faulty_sensors_stop_the_vehicle() {
    for fault in ["open", "frozen"] {
        let more = format!("[[distance_fault]]\nfault = \"{fault}\"\nat = \"8 s\"\n");
        let outcome = drive(25.0, &more, 14.0);
        assert_stops(&outcome, 8.0, 0.2, 5.0);
        assert_eq!(outcome.world.crop().unwrap().touches(), []);
    }
}
