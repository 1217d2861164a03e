//! The thesis's first track test (7.3).

use furrow_tests::Journey;
use furrow_tests::time::seconds;
use world::Scenario;

use crate::mode;

#[test]
fn the_vehicle_settles_to_five_centimetres_in_fifteen_seconds_and_stays_within_ten() {
    let scenario = Scenario::find(furrow_tests::vehicle(), "straight-line")
        .unwrap_or_else(|error| panic!("{error}"));
    let mut journey = Journey::new(&scenario, 1);
    journey.to(45.0);
    let traffic = journey.traffic();
    let run = traffic
        .genuine(300)
        .find(|frame| frame.data[4] == mode::RUN)
        .map(|frame| frame.end)
        .expect("the second press of the button starts the run");
    let states = journey.vehicle.world().states();
    let (mut inside, mut outside) = (None, 0.0);
    for state in states.iter().filter(|state| state.at >= run) {
        let (_, error) = scenario.line.unwrap().locate(state.north, state.east);
        let after = seconds(state.at) - seconds(run);
        assert!(error.abs() <= if after < 15.0 { 1.05 } else { 0.10 });
        if error.abs() > 0.05 {
            outside = after;
        } else {
            inside = inside.or(Some(after));
        }
        assert!(state.speed <= 2.0 && state.steering.to_degrees().abs() <= 25.0);
    }
    assert!(inside.is_some(), "it never came within 5 cm");
    assert!(
        outside <= 15.0,
        "still more than 5 cm off after {outside} s"
    );
    let last = states.last().expect("states are recorded");
    assert!(last.north > 35.0, "{} m only", last.north);
    journey.assert_in_place();
}
