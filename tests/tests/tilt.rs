//! The release images of the UAGV on a side slope, without and with an inertial sensor.

use campaign::traffic::Traffic;
use twin::{Images, Options};
use vehicle_model::Vehicle;
use world::Scenario;
use world::time::seconds;

/// Number of the message with roll and pitch.
const TILT: u16 = 203;

/// What the scenario `senses/side-slope` came to.
#[derive(Debug)]
struct Driven {
    /// Mean and largest size of the cross-track error from 20 s on, m; right positive.
    mean: f64,
    largest: f64,
    /// Frames with roll and pitch.
    tilts: usize,
    /// Roll of the last one, rad.
    roll: Option<f64>,
}

fn drive(vehicle: &Vehicle, images: &Images) -> Driven {
    let scenario = Scenario::find(vehicle, "senses/side-slope").unwrap();
    let outcome = twin::run(vehicle, &scenario, images, &Options::default(), |_| {}).unwrap();
    let line = scenario.line.unwrap();
    let samples = outcome.world.states().iter();
    let errors: Vec<f64> = samples
        .filter(|sample| seconds(sample.at) >= 20.0)
        .map(|sample| line.locate(sample.north, sample.east).1)
        .collect();
    let traffic = Traffic::of(&outcome);
    let tilts: Vec<_> = traffic.genuine(TILT).collect();
    Driven {
        mean: errors.iter().sum::<f64>() / errors.len() as f64,
        largest: errors.iter().fold(0.0, |most, error| error.abs().max(most)),
        tilts: tilts.len(),
        roll: tilts.last().map(|sent| {
            let bytes = sent.bytes();
            f64::from(i16::from_le_bytes([bytes[0], bytes[1]])) * 1e-4
        }),
    }
}

/// The antenna, 1 m above the ground, is 1 m sin 8 degrees = 13.9 cm to the right of the vehicle's middle.
const ASIDE: f64 = 0.139;

#[test]
fn on_a_side_slope_roll_and_pitch_put_the_vehicle_on_its_line() {
    let without = drive(furrow_tests::vehicle(), furrow_tests::images());
    let (vehicle, images) = furrow_tests::with("tilt.enabled=true");
    let with = drive(&vehicle, &images);
    println!("without {without:?}\nwith {with:?}");
    // The antenna is on the line, and the vehicle beside it.
    assert_eq!((without.tilts, without.roll), (0, None));
    assert!((without.mean + ASIDE).abs() < 0.02, "{without:?}");
    // One frame in each basic cycle of 45 s, but for the start.
    assert!((430..=450).contains(&with.tilts), "{with:?}");
    // 8 degrees, the constant error of 0.3, and noise of 0.2.
    let roll = with.roll.unwrap().to_degrees();
    assert!((roll - 8.3).abs() < 1.0, "{roll} degrees");
    assert!(with.mean.abs() < 0.015 && with.largest < 0.03, "{with:?}");
}
