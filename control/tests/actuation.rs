//! Calibrations and their fits, hold, limits, safety filter, row following and
//! number type.

#[path = "common/example.rs"]
mod example;

use control::calibration::{
    Actuator, ActuatorFit, CircleFit, Direction, FitError, LineFit, Potentiometer, angle_on_circle,
};
use control::hold::{Hold, HoldSettings};
use control::model::Antenna;
use control::row::{
    ConditionalHold, EmptyRange, IntegralState, ProportionalIntegral, RowFollower, ScalarKalman,
    VarianceError, differential,
};
use control::safety::{Command, SafetyFilter, Slew, Verdict};
use control::scalar::Scalar;
use control::schedule::GainSchedule;
use proptest::prelude::*;

fn filter() -> SafetyFilter<f32> {
    let slew = Slew {
        steering: 5.0,
        speed: 1.0,
    };
    SafetyFilter::new(example::settings().limits, slew, 0.25)
}

fn any_number() -> impl Strategy<Value = f32> {
    prop_oneof![
        8 => -10.0_f32..10.0,
        1 => Just(f32::NAN),
        1 => Just(f32::INFINITY),
        1 => Just(f32::MAX),
    ]
}

/// A number of any size, with an exponent of two from -30 to 30.
fn any_size() -> impl Strategy<Value = f32> {
    (-1.0_f32..1.0, -30_i32..31).prop_map(|(share, exponent)| share * (exponent as f32).exp2())
}

proptest! {
    /// For any proposal the filtered command is finite and within limits and slew
    /// rates. Without a recent, finite command and a steering angle it is
    /// standstill.
    #[test]
    fn only_safe_commands_leave(history in proptest::collection::vec(
        (proptest::option::of((any_number(), any_number())), 0.0_f32..0.5,
         proptest::option::of(any_number()), any_number()), 1..60)
    ) {
        let mut filter = filter();
        let limits = example::settings::<f32>().limits;
        for (proposed, age, angle, dt) in history {
            let last = filter.last();
            let proposed = proposed.map(|(steering_rate, speed)| Command { steering_rate, speed });
            let (command, verdict) = filter.step(proposed, age, angle, dt);
            prop_assert!(command.steering_rate.is_finite() && command.speed.is_finite());
            prop_assert!(command.steering_rate.abs() <= limits.steering_rate);
            prop_assert!(command.speed.abs() <= limits.speed);
            let usable = proposed.is_some_and(|c| c.steering_rate.is_finite() && c.speed.is_finite())
                && age <= 0.25 && angle.is_some_and(f32::is_finite) && dt.is_finite() && dt > 0.0;
            if usable {
                let slower = command.speed.abs() <= last.speed.abs();
                let growth = (command.speed.abs() - last.speed.abs()) / dt;
                prop_assert!(slower || growth <= 1.001);
                if let Some(angle) = angle && dt > 1e-3 && angle.abs() < limits.steering_angle {
                    let next = angle + command.steering_rate * dt;
                    prop_assert!(next.abs() <= limits.steering_angle + 1e-5);
                }
            } else {
                prop_assert_eq!(command, Command::still());
                prop_assert!(!matches!(verdict, Verdict::Passed | Verdict::Limited));
            }
        }
    }

    /// Outside the dead band effort and rate are inverse functions.
    #[test]
    fn calibration_is_invertible(
        dead in 0.0_f64..0.4, other in 0.0_f64..0.4, full in 0.1_f64..2.0, share in -1.0_f64..1.0,
    ) {
        let actuator = Actuator {
            positive: Direction { dead_band: dead, full_rate: full },
            negative: Direction { dead_band: other, full_rate: full * 0.8 },
        };
        let rate = share * full * 0.8;
        let effort = actuator.effort(rate);
        prop_assert!(effort.abs() <= 1.0);
        prop_assert!((actuator.rate(effort) - rate).abs() < 1e-12);
        prop_assert_eq!(actuator.effort(0.0), 0.0);
    }

    /// A fit finds the actuator from which the samples come.
    #[test]
    fn actuator_fit_finds_both_lines(
        dead in 0.02_f64..0.3, other in 0.02_f64..0.3, full in 0.2_f64..1.0,
    ) {
        let truth = Actuator {
            positive: Direction { dead_band: dead, full_rate: full },
            negative: Direction { dead_band: other, full_rate: full * 1.2 },
        };
        let mut fit = ActuatorFit::new(1e-3);
        for step in -40..=40 {
            let effort = f64::from(step) / 40.0;
            fit.add(effort, truth.rate(effort));
        }
        let found = fit.solve().unwrap();
        for (found, truth) in [(found.positive, truth.positive), (found.negative, truth.negative)] {
            prop_assert!((found.dead_band - truth.dead_band).abs() < 1e-9);
            prop_assert!((found.full_rate - truth.full_rate).abs() < 1e-9);
        }
    }

    /// A fit finds the circle from points on part of it.
    #[test]
    fn circle_fit_finds_the_circle(
        north in -500.0_f64..500.0, east in -500.0_f64..500.0, radius in 2.0_f64..30.0,
        from in -3.0_f64..3.0, arc in 2.0_f64..6.0,
    ) {
        let mut fit = CircleFit::new();
        for step in 0..50 {
            let angle = from + arc * f64::from(step) / 49.0;
            fit.add(north + radius * angle.cos(), east + radius * angle.sin());
        }
        let found = fit.solve().unwrap();
        prop_assert!((found.radius - radius).abs() < 1e-6);
        prop_assert!((found.north - north).hypot(found.east - east) < 1e-6);
    }

    /// Differential steering keeps both sides within full effort, and keeps the
    /// turn.
    #[test]
    fn differential_keeps_the_turn(forward in -3.0_f32..3.0, turn in -3.0_f32..3.0) {
        let sides = differential(forward, turn);
        prop_assert!(sides.left.abs() <= 1.0 && sides.right.abs() <= 1.0);
        prop_assert!(((sides.left - sides.right) * 0.5 - turn.clamp(-1.0, 1.0)).abs() < 1e-6);
    }

    #[test]
    fn single_precision_sine_and_cosine(angle in -1000.0_f32..1000.0) {
        let (sine, cosine) = angle.sine_cosine();
        let exact = f64::from(angle);
        prop_assert!((f64::from(sine) - exact.sin()).abs() < 2.5e-7);
        prop_assert!((f64::from(cosine) - exact.cos()).abs() < 2.5e-7);
    }

    #[test]
    fn single_precision_tangent(angle in -1.0_f32..1.0, turns in -3_i8..4) {
        let error = f64::from(angle.tangent()) / f64::from(angle).tan() - 1.0;
        prop_assert!(angle == 0.0 || error.abs() < 4e-7, "{error:e}");
        let far = angle + f32::from(turns) * core::f32::consts::PI;
        let exact = f64::from(far).tan();
        prop_assert!((f64::from(far.tangent()) - exact).abs() < 1e-6 * (1.0 + exact * exact));
    }

    #[test]
    fn single_precision_angles_of_vectors(x in any_size(), y in any_size()) {
        let exact = f64::from(y).atan2(f64::from(x));
        let error = (f64::from(y.angle_of(x)) - exact).abs();
        prop_assert!(error < 4e-7, "{error:e}");
        let small = exact.abs() < core::f64::consts::FRAC_PI_8;
        prop_assert!(!small || error <= 3e-7 * exact.abs() + 1e-44, "{error:e} of {exact}");
    }

    #[test]
    fn single_precision_root(bits in 0_u32..0x7f80_0000) {
        let square = f32::from_bits(bits);
        let (found, exact) = (square.root(), square.sqrt());
        prop_assert!(found.to_bits().abs_diff(exact.to_bits()) <= 1, "{found} {exact}");
    }

    /// Interpolated gains lie between their neighbours. At the speed of a row they
    /// equal the row.
    #[test]
    fn schedules_interpolate(speed in 0.0_f64..3.0) {
        let schedule = GainSchedule { spacing: 0.5, gains: [[1.0], [3.0], [2.0], [7.0]] };
        let [gain] = schedule.at(speed);
        let low = ((speed / 0.5) as usize).min(3);
        let (a, b) = (schedule.gains[low][0], schedule.gains[(low + 1).min(3)][0]);
        prop_assert!(gain >= a.min(b) - 1e-12 && gain <= a.max(b) + 1e-12);
        prop_assert_eq!(schedule.at(-speed), schedule.at(speed));
    }
}

#[test]
fn special_vectors_and_squares() {
    use core::f32::consts::{FRAC_PI_2, FRAC_PI_4, PI};
    let angle = |y: f32, x: f32| y.angle_of(x);
    assert_eq!(angle(0.0, 0.0), 0.0);
    assert_eq!(angle(0.0, -1.0), PI);
    assert_eq!(angle(-1.0, 0.0), -FRAC_PI_2);
    assert_eq!(angle(1.0, 1.0), FRAC_PI_4);
    assert!(angle(f32::NAN, 1.0).is_nan() && angle(1.0, f32::NAN).is_nan());
    assert_eq!(
        [0.0_f32, f32::INFINITY].map(Scalar::root),
        [0.0, f32::INFINITY]
    );
    assert!((-1.0_f32).root().is_nan() && f32::NAN.root().is_nan());
    assert!((-1e-40_f32).root().is_nan());
}

#[test]
fn schedule_rows_are_met() {
    let schedule = GainSchedule {
        spacing: 0.5,
        gains: [[1.0_f32], [3.0], [2.0]],
    };
    assert_eq!(
        [0.0, 0.5, 1.0, 9.0, f32::NAN].map(|speed| schedule.at(speed)[0]),
        [1.0, 3.0, 2.0, 2.0, 1.0]
    );
}

#[test]
fn potentiometer_and_its_fit() {
    let pot = Potentiometer {
        centre: 2048.0_f64,
        counts_per_radian: 40.0 * 57.295_779_5,
        lowest: 500,
        highest: 3600,
    };
    assert!((pot.angle(3048).unwrap().to_degrees() - 25.0_f64).abs() < 1e-6);
    assert_eq!(pot.angle(100).unwrap_err().counts, 100);
    let mut samples = LineFit::new();
    for step in -10..=10 {
        let angle = f64::from(step) * 0.04;
        samples.add(angle, pot.counts(angle));
    }
    let found = Potentiometer::fit(&samples, 500, 3600).unwrap();
    assert!((found.centre - pot.centre).abs() < 1e-6);
    assert!((found.counts_per_radian - pot.counts_per_radian).abs() < 1e-6);
    // On a circle of radius R the rear axle turns by atan(L / sqrt(R^2 - L1^2)).
    let vehicle = &example::VEHICLE;
    let circle = |right, radius| {
        let antenna = Antenna { right, height: 0.0 };
        angle_on_circle(&vehicle.geometry, &antenna, radius)
    };
    let rear = (25.0_f64 - 0.255 * 0.255).sqrt();
    assert!((circle(0.0, 5.0).unwrap() - (1.1 / rear).atan()).abs() < 1e-12);
    // An antenna 0.3 m to the right is inside a turn to the right.
    assert!((circle(0.3, 5.0).unwrap() - (1.1 / (rear + 0.3)).atan()).abs() < 1e-12);
    assert!((circle(0.3, -5.0).unwrap() + (1.1 / (rear - 0.3)).atan()).abs() < 1e-12);
    assert_eq!(circle(0.0, 0.2), None);
}

#[test]
fn fits_that_cannot_be_are_named() {
    let mut line = LineFit::<f64>::new();
    assert_eq!(line.solve(), Err(FitError::TooFew(0)));
    for _ in 0..5 {
        line.add(3.0, 4.0);
    }
    line.add(f64::NAN, 1.0);
    assert_eq!(line.solve(), Err(FitError::NoSpread));
    let mut circle = CircleFit::<f64>::new();
    for step in 0..9 {
        circle.add(f64::from(step), 2.0 * f64::from(step));
    }
    assert_eq!(circle.solve(), Err(FitError::NoSpread));
    let mut falling = ActuatorFit::new(0.0);
    for step in 1..9 {
        falling.add(f64::from(step) / 10.0, 1.0 - f64::from(step) / 10.0);
    }
    assert_eq!(falling.solve(), Err(FitError::Implausible));
}

/// A movement continues to its target once begun. Noise below the threshold
/// causes none.
#[test]
fn the_hold_rests_and_moves() {
    let settings = HoldSettings {
        begin: 0.02,
        end: 0.005,
        slowest: 0.01,
    };
    let mut hold = Hold::new();
    assert_eq!(hold.rate(&settings, 0.019, 2.0, 0.1), 0.0);
    assert_eq!(hold.rate(&settings, f64::NAN, 2.0, 0.1), 0.0);
    assert!((hold.rate(&settings, 0.021, 2.0, 0.1) - 0.042).abs() < 1e-12);
    assert!(
        hold.rate(&settings, 0.006, 2.0, 0.1) > 0.0,
        "still on its way"
    );
    assert_eq!(hold.rate(&settings, 0.004, 2.0, 0.1), 0.0);
    assert!(hold.rests());
    assert!(hold.rate(&settings, -0.03, 2.0, 0.1) < 0.0);
    // The rate does not move beyond the target within a period.
    assert!((hold.rate(&settings, -0.03, 100.0, 0.1) + 0.3).abs() < 1e-12);
}

/// Thesis chapter 2: the hold bridges gaps and leaves, the robot steers towards
/// the wider side, and the integral stops at saturation.
#[test]
fn row_following() {
    assert_eq!(ConditionalHold::new(5.0, 5.0), Err(EmptyRange));
    assert_eq!(
        ScalarKalman::new(1.0, f64::NAN),
        Err(VarianceError::Measurement)
    );
    let mut hold = ConditionalHold::new(20.0_f64, 80.0).unwrap();
    assert_eq!(hold.pass(40.0), 40.0);
    for gap in [150.0, 3.0, f64::NAN, f64::INFINITY] {
        assert_eq!(hold.pass(gap), 40.0);
    }

    let mut smooth = ScalarKalman::new(0.01_f64, 4.0).unwrap();
    assert!(
        (smooth.step(30.0) - 30.0).abs() < 1e-6,
        "the first sample counts whole"
    );
    for _ in 0..500 {
        smooth.step(50.0);
    }
    assert!((smooth.step(50.0) - 50.0).abs() < 0.1);
    // The steady-state variance for a random walk is (-q + sqrt(q^2 + 4 q r)) / 2.
    let steady = (-0.01 + (0.0001_f64 + 0.16).sqrt()) / 2.0;
    assert!((smooth.variance() - steady).abs() < 1e-9);

    let law = ProportionalIntegral {
        proportional: 0.01_f64,
        integral: 0.1,
        input_limit: 30.0,
        output_limit: 0.5,
    };
    let mut state = IntegralState::new();
    for _ in 0..10_000 {
        assert!(law.step(&mut state, 1000.0, 0.005) <= 0.5);
    }
    assert!(state.sum() <= 0.5, "wound up to {}", state.sum());
    let mut steps = 0;
    while law.step(&mut state, -10.0, 0.005) > 0.0 {
        steps += 1;
        assert!(steps < 200, "the integral does not let go");
    }

    let mut follower = RowFollower::new(
        ConditionalHold::new(20.0_f64, 80.0).unwrap(),
        ScalarKalman::new(1.0, 4.0).unwrap(),
        ProportionalIntegral {
            integral: 0.0,
            ..law
        },
    );
    let mut sides = follower.step(40.0, 40.0, 0.5, 0.005);
    assert!((sides.left - sides.right).abs() < 1e-12);
    for _ in 0..50 {
        sides = follower.step(30.0, 50.0, 0.5, 0.005);
    }
    assert!(
        sides.left > sides.right,
        "more room on the right: turn right"
    );
}
