//! Commands of a higher layer: who leads a run, what is done with demands beyond the limits, and a vehicle that
//! drives the arcs that it is asked for.

mod common;

use common::{Conditions, LIMIT, Plant};
use control::controller::{Controller, Sample, Settings};
use control::demand::{Demand, DemandError, DemandLaw, DemandSettings, Lead, READY};
use control::line::Line;
use control::position::Position;
use control::safety::Command;
use proptest::prelude::*;

const DT: f64 = 0.1;
const SETTINGS: DemandSettings<f64> = DemandSettings {
    longest_age: 0.3,
    lateral: 1.0,
};

fn law() -> DemandLaw<f64> {
    DemandLaw::new(SETTINGS, common::example::settings()).unwrap()
}

fn demand(curvature: f64, speed: f64) -> Demand<f64> {
    Demand { curvature, speed }
}

/// Several equal steps; who leads behind the last one.
fn steps(law: &mut DemandLaw<f64>, count: usize, running: bool, heard: bool) -> Lead {
    let demand = heard.then(|| demand(0.0, 1.0));
    (0..count).fold(law.lead(), |_, _| law.step(running, demand, DT))
}

#[test]
fn demands_lead_a_run_only_if_they_came_before_it() {
    let mut law = law();
    assert_eq!(steps(&mut law, 10, false, false), Lead::Path);
    assert_eq!(steps(&mut law, 1, true, false), Lead::Path);
    // The path leads the run to its end, whatever comes.
    assert_eq!(steps(&mut law, 20, true, true), Lead::Path);
    assert_eq!(steps(&mut law, 1, false, true), Lead::Demands);
    assert_eq!(steps(&mut law, 20, true, true), Lead::Demands);
}

#[test]
fn a_few_demands_are_needed() {
    let mut law = law();
    let before = usize::from(READY) - 1;
    assert_eq!(steps(&mut law, before, false, true), Lead::Path);
    assert_eq!(steps(&mut law, 1, false, true), Lead::Demands);
    // A pause forgets them.
    assert_eq!(steps(&mut law, 4, false, false), Lead::Path);
    assert_eq!(steps(&mut law, before, false, true), Lead::Path);
}

#[test]
fn a_run_whose_demands_end_has_no_leader_until_it_ends() {
    let mut law = law();
    steps(&mut law, 5, false, true);
    // Two missing ones are bridged.
    steps(&mut law, 5, true, true);
    assert_eq!(steps(&mut law, 2, true, false), Lead::Demands);
    assert_eq!(steps(&mut law, 5, true, true), Lead::Demands);
    assert_eq!(steps(&mut law, 4, true, false), Lead::Nobody);
    assert_eq!(steps(&mut law, 20, true, true), Lead::Nobody);
    assert_eq!(steps(&mut law, 1, false, true), Lead::Demands);
}

#[test]
fn what_is_no_number_is_no_demand() {
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for demand in [demand(bad, 1.0), demand(0.1, bad)] {
            let mut law = law();
            for _ in 0..10 {
                assert_eq!(law.step(false, Some(demand), DT), Lead::Path);
            }
        }
    }
}

#[test]
fn unusable_settings_are_named() {
    for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let age = DemandSettings {
            longest_age: bad,
            ..SETTINGS
        };
        let lateral = DemandSettings {
            lateral: bad,
            ..SETTINGS
        };
        assert_eq!(age.check(), Err(DemandError::Age));
        assert_eq!(lateral.check(), Err(DemandError::Lateral));
    }
}

/// A vehicle that drives under demands for some seconds, with the estimate of the controller.
fn driven(asked: Demand<f64>, conditions: Conditions, seconds: f64) -> Plant {
    let settings = common::example::settings::<f64>();
    let line = Line::new(Position::new(0, 0), Position::new(500_000, 0)).unwrap();
    let mut controller = Controller::following(settings, line).unwrap();
    let mut plant = Plant::new(conditions, 1);
    let mut law = law();
    let mut applied = Command::still();
    for step in 0..(seconds / DT) as usize {
        let heard = plant.hear();
        let outcome = controller.step(&Sample {
            position: Some(heard.position),
            velocity: Some(heard.velocity),
            steering_angle: Some(heard.steering_angle),
            applied,
            engaged: false,
            dt: DT,
        });
        law.step(step > 5, Some(asked), DT);
        applied = if law.lead() == Lead::Demands && step > 5 {
            law.drive(
                applied,
                outcome.tracking.steering_angle,
                Some(heard.steering_angle),
                outcome.tracking.speed,
                controller.effectiveness(),
                DT,
            )
        } else {
            Command::still()
        };
        plant.drive(applied, DT);
    }
    plant
}

#[test]
fn the_vehicle_drives_the_arc_that_it_is_asked_for() {
    for (curvature, speed) in [(0.1, 1.0), (-0.2, 0.8), (0.0, 2.0), (0.3, 0.5)] {
        for conditions in [Conditions::default(), Conditions::loaded()] {
            let conditions = Conditions {
                offset: 0.0,
                ..conditions
            };
            let plant = driven(demand(curvature, speed), conditions, 30.0);
            let wheelbase = plant.vehicle.geometry.wheelbase();
            let driven = plant.steering.tan() / wheelbase;
            // The hold lets the steering rest within a third of a degree; the rest is what the estimator
            // does not know of the potentiometer's error.
            assert!(
                (driven - curvature).abs() < 0.015,
                "{curvature} 1/m: {driven} 1/m"
            );
            assert!((plant.speed - speed).abs() < 0.02, "{} m/s", plant.speed);
        }
    }
}

#[test]
fn turns_are_driven_as_slowly_as_they_must() {
    let tight = driven(demand(10.0, 2.0), Conditions::default(), 20.0);
    let wheelbase = tight.vehicle.geometry.wheelbase();
    let curvature = tight.steering.tan() / wheelbase;
    assert!((tight.steering - LIMIT).abs() < 0.01, "{}", tight.steering);
    let lateral = tight.speed * tight.speed * curvature;
    assert!((lateral - SETTINGS.lateral).abs() < 0.1, "{lateral}");
}

proptest! {
    #[test]
    fn no_command_exceeds_the_limits(
        asked in prop::collection::vec(
            prop::option::of((-1e6..1e6_f64, -1e6..1e6_f64)), 1..60),
        angle in -0.6..0.6_f64,
        speed in -3.0..3.0_f64,
    ) {
        let Settings { limits, .. } = common::example::settings::<f64>();
        let mut law = law();
        let mut applied = Command::still();
        for (number, asked) in asked.into_iter().enumerate() {
            let asked = asked.map(|(curvature, speed)| demand(curvature, speed));
            law.step(number > 5, asked, DT);
            let command = law.drive(applied, angle, Some(angle), speed, 1.0, DT);
            prop_assert!(command.steering_rate.abs() <= limits.steering_rate * (1.0 + 1e-12));
            prop_assert!((0.0..=limits.speed).contains(&command.speed));
            // Speed rises no faster than the machine may.
            let most = common::example::settings::<f64>().slew.speed * DT;
            prop_assert!(command.speed <= applied.speed + most + 1e-12);
            if law.demand().1 > SETTINGS.longest_age {
                prop_assert_eq!(command, Command::still());
            }
            applied = command;
        }
    }
}
