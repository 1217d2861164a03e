//! Compares the vehicle with closed-form solutions, and checks its limits for random inputs.

mod uagv;

use proptest::prelude::*;
use world::time::{at, from_seconds, seconds};
use world::units::{Angle, Length, Ratio, Speed, Time};
use world::vehicle::{
    Attitude, Ground, Motion, Motor, Parameters, State, Vehicle, drive_for, wrap,
};

const REST: State = State {
    north: 0.0,
    east: 0.0,
    heading: 0.0,
    steering: 0.0,
    speed: 0.0,
};

/// Tyres without slip, and a drive without lag.
fn ideal() -> (Parameters, Ground) {
    let parameters = Parameters {
        drive_lag: Time::new(0.0),
        ..uagv::parameters()
    };
    let ground = Ground {
        front_slip: "0 deg/g".parse().unwrap(),
        rear_slip: "0 deg/g".parse().unwrap(),
        ..Ground::default()
    };
    (parameters, ground)
}

/// Effort for `speed`, below 2 m/s.
fn effort(speed: f64) -> f64 {
    (0.05 + 0.95 * speed.abs() / 2.0) * speed.signum()
}

fn near(a: f64, b: f64, tolerance: f64) -> bool {
    (a - b).abs() <= tolerance
}

#[test]
fn straight_ahead_is_a_straight_line() {
    let (parameters, ground) = ideal();
    let heading = 0.3_f64;
    let mut vehicle = Vehicle::new(parameters, ground, State { heading, ..REST });
    drive_for(&mut vehicle, 10.0, 0.0, effort(1.5));
    let state = vehicle.state();
    assert!(near(state.north, 15.0 * heading.cos(), 1e-9), "{state:?}");
    assert!(near(state.east, 15.0 * heading.sin(), 1e-9), "{state:?}");
    assert!(near(state.speed, 1.5, 1e-12), "{state:?}");
    assert_eq!((state.heading, state.steering), (heading, 0.0));
}

#[test]
fn constant_steering_is_a_circle_of_wheelbase_over_tangent() {
    let (parameters, ground) = ideal();
    let steering = 20_f64.to_radians();
    let radius = 1.10 / steering.tan();
    let mut vehicle = Vehicle::new(parameters, ground, State { steering, ..REST });
    // Positive steering turns right, so the centre of the circle is to the east.
    for _ in 0..40 {
        drive_for(&mut vehicle, 0.5, 0.0, effort(1.0));
        let state = vehicle.state();
        let distance = state.north.hypot(state.east - radius);
        assert!(
            near(distance, radius, 1e-9),
            "{distance} instead of {radius}"
        );
        let turned = seconds(vehicle.now()) / radius;
        assert!(near(state.heading, turned, 1e-9));
    }
    // The antenna, 0.255 m ahead of the axle, moves on a circle around the same centre, at a speed
    // in proportion to its radius.
    let antenna = vehicle.antenna();
    let own = radius.hypot(0.255);
    assert!(near(antenna.north.hypot(antenna.east - radius), own, 1e-9));
    assert!(near(
        antenna.north_speed.hypot(antenna.east_speed),
        own / radius,
        1e-9
    ));
}

/// A vehicle on a slope that leans it, with its antenna to the right and 2 m above the ground.
fn leaning(slope: f64, downhill: f64, state: State) -> Vehicle {
    let (parameters, ground) = ideal();
    let parameters = Parameters {
        antenna_right: Length::new(0.4),
        antenna_height: Length::new(2.0),
        ..parameters
    };
    let ground = Ground {
        slope: Angle::degrees(slope),
        downhill: Angle::degrees(downhill),
        leans: true,
        ..ground
    };
    Vehicle::new(parameters, ground, state)
}

#[test]
fn a_slope_that_does_not_lean_leaves_the_antenna_in_its_place() {
    let state = State {
        speed: 1.0,
        steering: 0.2,
        ..REST
    };
    let leans = leaning(10.0, 90.0, state);
    let ground = Ground {
        slope: Angle::degrees(10.0),
        ..ideal().1
    };
    let level = Vehicle::new(leans.parameters().clone(), ground, state);
    let antenna = level.antenna();
    assert_eq!(
        antenna,
        Motion {
            height: 2.0,
            ..level.point(0.255, 0.4)
        }
    );
    assert_eq!(antenna.attitude, Attitude::default());
    // The slope falls to the right: 2 m sin 10 degrees, less what the antenna's place beside the middle loses.
    let aside = leans.antenna().east - antenna.east;
    assert!(near(aside, 0.347_296 - 0.4 * 0.015_192, 1e-6), "{aside}");
    assert!(near(leans.attitude().roll, 10_f64.to_radians(), 1e-12));
    assert_eq!(
        leans.point(0.255, 0.4),
        Motion {
            attitude: leans.attitude(),
            ..level.point(0.255, 0.4)
        }
    );
}

#[test]
fn small_angles_follow_the_linear_model() {
    // Zero-order hold of thesis 7.2.4 over T with a constant steering rate u, from rest in all
    // three states: y = G1 u, psi = G2 u, with G = [V L1 T^2/(2L) + V^2 T^3/(6L), V T^2/(2L), T].
    let (parameters, ground) = ideal();
    let (v, l1, l, t) = (1.0, 0.255, 1.10, 0.1);
    let u = 0.2_f64.to_radians();
    let share = u / 25_f64.to_radians();
    let state = State { speed: v, ..REST };
    let mut vehicle = Vehicle::new(parameters, ground, state);
    drive_for(&mut vehicle, t, 0.10 + 0.90 * share, effort(v));
    let g = [
        v * l1 * t * t / (2.0 * l) + v * v * t * t * t / (6.0 * l),
        v * t * t / (2.0 * l),
        t,
    ];
    assert!(near(vehicle.antenna().east, g[0] * u, 1e-9));
    assert!(near(vehicle.state().heading, g[1] * u, 1e-9));
    assert!(near(vehicle.state().steering, g[2] * u, 1e-12));
}

#[test]
fn each_direction_has_its_dead_band() {
    for (effort, rate) in [
        (0.0999, 0.0),
        (-0.1199, 0.0),
        (1.0, 25.0),
        (-1.0, -25.0),
        (0.55, 12.5),
        (-0.56, -12.5),
    ] {
        let mut vehicle = Vehicle::new(uagv::parameters(), Ground::default(), REST);
        drive_for(&mut vehicle, 0.4, effort, 0.0);
        let turned = vehicle.state().steering.to_degrees();
        assert!(near(turned, 0.4 * rate, 1e-9), "{effort}: {turned}");
    }
}

#[test]
fn the_end_stops_hold() {
    let mut vehicle = Vehicle::new(uagv::parameters(), Ground::default(), REST);
    drive_for(&mut vehicle, 3.0, 1.0, 0.0);
    assert_eq!(vehicle.state().steering, 25_f64.to_radians());
    drive_for(&mut vehicle, 0.2, -1.0, 0.0);
    assert!(
        near(vehicle.state().steering.to_degrees(), 20.0, 1e-9),
        "no wind-up behind a stop"
    );
}

#[test]
fn the_drive_lags() {
    let mut vehicle = Vehicle::new(uagv::parameters(), Ground::default(), REST);
    drive_for(&mut vehicle, 0.3, 0.0, 1.0);
    assert!(near(
        vehicle.state().speed,
        2.0 * (1.0 - (-1.0_f64).exp()),
        1e-12
    ));
    drive_for(&mut vehicle, 30.0, 0.0, 0.05);
    assert!(
        vehicle.state().speed.abs() < 1e-12,
        "the dead band stops it"
    );
}

#[test]
fn an_effort_counts_from_its_instant() {
    let mut vehicle = Vehicle::new(uagv::parameters(), Ground::default(), REST);
    let sent = at(from_seconds(0.123_456_7));
    vehicle.set_effort(sent, Motor::Steering, 1.0);
    let later = vehicle.state_at(at(from_seconds(0.323_456_7)));
    assert!(near(later.steering.to_degrees(), 5.0, 1e-9));
    assert_eq!(vehicle.state(), REST, "looking ahead moves nothing");
    vehicle.advance_to(at(from_seconds(0.323_456_7)));
    assert_eq!(vehicle.state(), later);
}

#[test]
fn a_side_slope_makes_it_drift_downhill_without_turning() {
    // Both axles slip by 14 deg/g x sin(3 deg) = 0.7327 deg.
    let (parameters, _) = ideal();
    let ground = Ground {
        slope: Angle::degrees(3.0),
        ..Ground::default()
    };
    let drift = (14.0 * 3_f64.to_radians().sin()).to_radians().tan();
    for speed in [1.0, -1.0] {
        let mut vehicle = Vehicle::new(parameters.clone(), ground.clone(), REST);
        drive_for(&mut vehicle, 10.0, 0.0, effort(speed));
        let state = vehicle.state();
        assert!(near(state.east, 10.0 * drift, 1e-9), "{state:?}");
        assert!(near(state.north, 10.0 * speed, 1e-9), "{state:?}");
        assert!(near(state.heading, 0.0, 1e-12), "{state:?}");
    }
}

#[test]
fn tyres_widen_a_turn() {
    let (parameters, grip) = ideal();
    let turn = |ground: Ground| {
        let state = State {
            steering: 0.3,
            ..REST
        };
        let mut vehicle = Vehicle::new(parameters.clone(), ground, state);
        drive_for(&mut vehicle, 2.0, 0.0, effort(2.0));
        vehicle.state().heading
    };
    let understeer = Ground {
        front_slip: "20 deg/g".parse().unwrap(),
        rear_slip: "5 deg/g".parse().unwrap(),
        ..grip.clone()
    };
    assert!(turn(understeer) < turn(grip));
}

#[test]
fn wheel_slip_and_steering_bias_do_what_they_say() {
    let (parameters, ground) = ideal();
    let biased = Parameters {
        steering_bias: Angle::degrees(2.0),
        ..parameters
    };
    let slippery = Ground {
        wheel_slip: Ratio::new(0.1),
        ..ground
    };
    let mut vehicle = Vehicle::new(biased, slippery, REST);
    drive_for(&mut vehicle, 10.0, 0.0, effort(1.0));
    let heading = 9.0 / 1.10 * 2_f64.to_radians().tan();
    assert!(near(vehicle.state().heading, heading, 1e-9));
    assert_eq!(
        vehicle.state().steering,
        0.0,
        "the potentiometer does not see the bias"
    );
    assert_eq!(vehicle.pot_at(vehicle.now()), 2048.0);
    drive_for(&mut vehicle, 2.0, 1.0, 0.0);
    assert!(near(vehicle.pot_at(vehicle.now()), 3048.0, 1e-9));
}

#[test]
fn angles_wrap_to_half_a_turn() {
    assert!(near(
        wrap(3.0 * core::f64::consts::PI / 2.0),
        -core::f64::consts::FRAC_PI_2,
        1e-12
    ));
    assert!(near(
        wrap(-20.0),
        -20.0 + 6.0 * core::f64::consts::PI,
        1e-12
    ));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// All four wheels stand on the plane, and the antenna is where the body's turn puts it. Its velocity is the
    /// difference of two places.
    #[test]
    fn a_leaning_vehicle_stands_on_its_slope(
        slope in 0.0..30.0_f64,
        downhill in -180.0..180.0_f64,
        heading in -4.0..4.0_f64,
        steering in -0.4..0.4_f64,
    ) {
        use control::nalgebra::{Rotation3, Vector3};
        let mut vehicle = leaning(slope, downhill, State { heading, steering, speed: 1.0, ..REST });
        let Attitude { roll, pitch, yaw } = vehicle.attitude();
        let turn = Rotation3::from_euler_angles(roll, pitch, yaw);
        let (steep, falls) = (slope.to_radians(), downhill.to_radians());
        // The ground's normal, in north, east and down.
        let normal = Vector3::new(-steep.sin() * falls.cos(), -steep.sin() * falls.sin(), steep.cos());
        prop_assert!((turn * Vector3::z() - normal).norm() < 1e-12);
        let antenna = vehicle.antenna();
        let placed = turn * Vector3::new(0.255, 0.4, -2.0);
        let found = Vector3::new(antenna.north, antenna.east, -antenna.height);
        prop_assert!((placed - found).norm() < 1e-12, "{placed} {found}");
        let span = 1e-3;
        vehicle.set_effort(vehicle.now(), Motor::Drive, effort(1.0));
        vehicle.advance_to(at(from_seconds(span)));
        let later = vehicle.antenna();
        let speed = |first: f64, last: f64| (first + last) / 2.0;
        let north = speed(antenna.north_speed, later.north_speed);
        let east = speed(antenna.east_speed, later.east_speed);
        prop_assert!((north - (later.north - antenna.north) / span).abs() < 1e-5, "{north} m/s");
        prop_assert!((east - (later.east - antenna.east) / span).abs() < 1e-5, "{east} m/s");
    }

    #[test]
    fn no_input_breaks_a_limit(
        inputs in prop::collection::vec((0.0_f64..0.7, -1.5_f64..1.5, -1.5_f64..1.5), 1..30),
        slope in 0.0_f64..15.0,
        gain in 0.1_f64..2.0,
    ) {
        let parameters = Parameters {
            actuator_gain: Ratio::new(gain),
            top_speed: Speed::new(2.0),
            ..uagv::parameters()
        };
        let ground = Ground { slope: Angle::degrees(slope), ..Ground::default() };
        let mut vehicle = Vehicle::new(parameters, ground, REST);
        for (span, steering, drive) in inputs {
            let before = vehicle.state();
            vehicle.set_effort(vehicle.now(), Motor::Steering, steering);
            let foreseen = vehicle.steering_at(at(from_seconds(seconds(vehicle.now()) + span)));
            drive_for(&mut vehicle, span, steering, drive);
            let after = vehicle.state();
            prop_assert!(near(foreseen, after.steering, 1e-9));
            prop_assert!(after.steering.abs() <= 25_f64.to_radians());
            prop_assert!(after.speed.abs() <= 2.0);
            let most = 25_f64.to_radians() * gain * span;
            prop_assert!((after.steering - before.steering).abs() <= most + 1e-9);
            let moved = (after.north - before.north).hypot(after.east - before.east);
            // Distance along and across the heading: slip angles stay below 20 degrees here.
            prop_assert!(moved <= 2.0 * span / 20_f64.to_radians().cos() + 1e-9);
        }
    }
}
