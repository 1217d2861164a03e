//! The release images of the UAGV on a side slope, without and with an inertial sensor.

use campaign::traffic::Traffic;
use twin::{Images, Options};
use vehicle_model::Vehicle;
use world::Scenario;
use world::receiver::{Inertial, InertialChange};
use world::time::seconds;
use world::units::Time;

/// Number of the message with roll and pitch.
const TILT: u16 = 203;

/// Number of the message that tells whether they count.
const TILT_STATE: u16 = 457;

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

/// What message 457 said last before an instant: whether roll and pitch count, and how often they lapsed.
fn told(traffic: &Traffic, before: f64) -> Option<(bool, u8)> {
    let sent = traffic.genuine(TILT_STATE);
    let last = sent.filter(|sent| seconds(sent.end) <= before).last()?;
    let bytes = last.bytes();
    Some((bytes[0] & 1 == 1, bytes[1]))
}

/// Cross-track errors of the scenario `senses/side-slope` with tilt if the sensor is in a state from 20 to 32 s.
fn lapsed(state: Inertial) -> (Traffic, impl Fn(f64, f64) -> Vec<f64>) {
    let (vehicle, images) = furrow_tests::with("tilt.enabled=true");
    let mut scenario = Scenario::find(&vehicle, "senses/side-slope").unwrap();
    let changes = [(20.0, state), (32.0, Inertial::Valid)];
    scenario.inertial = Vec::from(changes.map(|(at, state)| InertialChange {
        at: Time::new(at),
        state,
    }));
    let outcome = twin::run(&vehicle, &scenario, &images, &Options::default(), |_| {}).unwrap();
    let traffic = Traffic::of(&outcome);
    let line = scenario.line.unwrap();
    let errors = move |from, until| {
        let samples = outcome.world.states().iter();
        let within = samples.filter(|it| (from..until).contains(&seconds(it.at)));
        within
            .map(|it| line.locate(it.north, it.east).1)
            .collect::<Vec<f64>>()
    };
    (traffic, errors)
}

#[test]
fn without_roll_and_pitch_for_a_second_the_ground_counts_as_level_until_they_are_back() {
    for state in [Inertial::Silent, Inertial::Invalid] {
        let (traffic, errors) = lapsed(state);
        let said = [20.9, 21.4, 31.9, 32.4].map(|at| told(&traffic, at));
        let expected = [(true, 0), (false, 1), (false, 1), (true, 1)];
        assert_eq!(said, expected.map(Some), "{state:?}");
        // Nothing is sent for 12 s of 45.
        let tilts = traffic.genuine(TILT).count();
        assert!((320..=330).contains(&tilts), "{state:?}: {tilts} frames");
        // The run goes on all the time.
        let modes: Vec<u8> = traffic.genuine(300).map(|it| it.bytes()[4] & 7).collect();
        assert!(modes.iter().rev().take(400).all(|&mode| mode == 3));
        // It goes to the place of a vehicle without the sensor, without overshoot, and comes back.
        assert!(errors(15.0, 21.0).iter().all(|it| it.abs() < 0.03));
        let (aside, after) = (errors(24.0, 32.0), errors(36.0, 45.0));
        assert!(aside.iter().all(|it| (it + ASIDE).abs() < 0.03));
        assert!(after.iter().all(|it| it.abs() < 0.03), "{state:?}");
        let least = errors(0.0, 45.0).into_iter().fold(0.0, f64::min);
        assert!(least > -ASIDE - 0.03, "{state:?}: {least}");
    }
}
