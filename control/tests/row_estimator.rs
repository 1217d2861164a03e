//! Parts of row following: beams, estimator, law, settings.

mod common;
#[path = "common/rows.rs"]
mod rows;

use crate::common::Noise;
use control::row::{
    Beams, Mounting, MountingError, RowController, RowDistances, RowEstimate, RowEstimator,
    RowEstimatorError, RowLawError, RowPose, RowRobot, RowSettings, RowSettingsError, RowState,
    Side, SideHealth, WheelSpeeds,
};
use control::scalar::Scalar;
use proptest::prelude::*;
use rows::{Crop, FULL_SPEED, Field, Ground, STEP, robot, run};
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, SQRT_2};

fn settings<T: Scalar>() -> RowSettings<T> {
    RowSettings::for_robot(&robot(0.4)).unwrap()
}

fn beams() -> Beams<f64> {
    Beams::new(Mounting {
        ahead: 0.2545,
        beside: 0.152,
        angle: FRAC_PI_4,
    })
    .unwrap()
}

fn pose(offset: f64, heading: f64) -> RowPose<f64> {
    RowPose {
        offset,
        heading,
        half_width: 0.381,
    }
}

/// Thesis Figure 2.3: in the middle each beam crosses 0.152 + 0.381 m sideways at
/// 45 degrees, and meets its row 0.7875 m ahead of the robot's middle.
#[test]
fn the_beams_of_the_thesis() {
    let both = [Side::Left, Side::Right];
    for side in both {
        let distance = beams().predict(side, &pose(0.0, 0.0)).unwrap().distance;
        assert!((distance - 0.533 * SQRT_2).abs() < 1e-12, "{distance}");
    }
    assert!((beams().reach(0.381) - 0.7875).abs() < 1e-12);
    // Equation 2.1: right less left grows when the robot is left of the middle
    // and when it points to the left.
    for (offset, heading) in [(-0.03, 0.0), (0.0, -0.05)] {
        let [left, right] = both.map(|side| {
            beams()
                .predict(side, &pose(offset, heading))
                .unwrap()
                .distance
        });
        assert!(right > left + 0.05, "{left} {right}");
    }
    // Beams across the robot: straight to the side.
    let square = Beams::new(Mounting {
        ahead: 0.1,
        beside: 0.2,
        angle: FRAC_PI_2,
    });
    let seen = square.unwrap().predict(Side::Right, &pose(0.1, 0.0));
    assert!((seen.unwrap().distance - (0.381 - 0.1 + 0.2)).abs() < 1e-12);
}

#[test]
fn a_beam_that_misses_the_row_predicts_nothing() {
    assert!(beams().predict(Side::Left, &pose(0.0, 0.7)).is_none());
    assert!(beams().predict(Side::Right, &pose(0.0, 0.7)).is_some());
    assert!(beams().predict(Side::Left, &pose(-0.7, 0.0)).is_none());
    assert!(beams().predict(Side::Left, &pose(f64::NAN, 0.0)).is_none());
}

#[test]
fn mountings_that_cannot_be_are_named() {
    let sound = beams().mounting();
    let refusal = |mounting| Beams::<f64>::new(mounting).err();
    assert_eq!(
        refusal(Mounting {
            ahead: f64::NAN,
            ..sound
        }),
        Some(MountingError::Ahead)
    );
    assert_eq!(
        refusal(Mounting {
            beside: 0.0,
            ..sound
        }),
        Some(MountingError::Beside)
    );
    for angle in [0.1, 1.6, f64::NAN] {
        assert_eq!(
            refusal(Mounting { angle, ..sound }),
            Some(MountingError::Angle)
        );
    }
}

proptest! {
    /// The end of a predicted beam lies on the row's line, and the derivatives are
    /// those of the prediction. All these beams meet the line.
    #[test]
    fn predictions_end_on_the_row(
        offset in -0.15_f64..0.15, heading in -0.3_f64..0.3, half_width in 0.3_f64..0.5,
        ahead in -0.2_f64..0.3, beside in 0.05_f64..0.2, angle in 0.7_f64..1.5,
        is_left in any::<bool>(),
    ) {
        let beams = Beams::new(Mounting { ahead, beside, angle }).unwrap();
        let side = if is_left { Side::Left } else { Side::Right };
        let pose = RowPose { offset, heading, half_width };
        let seen = beams.predict(side, &pose).unwrap();
        // The aperture is on the other side of the robot.
        let sign = if is_left { 1.0 } else { -1.0 };
        let across = offset + ahead * heading.sin() + sign * beside * heading.cos();
        let end = across + seen.distance * (heading - sign * angle).sin();
        prop_assert!((end + sign * half_width).abs() < 1e-9, "{end}");

        let step = 1e-6;
        let at = |pose| beams.predict(side, &pose).unwrap().distance;
        let slope = |more: RowPose<f64>, less: RowPose<f64>| (at(more) - at(less)) / (2.0 * step);
        let by_offset = slope(
            RowPose { offset: offset + step, ..pose },
            RowPose { offset: offset - step, ..pose },
        );
        let by_heading = slope(
            RowPose { heading: heading + step, ..pose },
            RowPose { heading: heading - step, ..pose },
        );
        let by_half_width = slope(
            RowPose { half_width: half_width + step, ..pose },
            RowPose { half_width: half_width - step, ..pose },
        );
        prop_assert!((seen.by_offset - by_offset).abs() < 1e-4);
        prop_assert!((seen.by_heading - by_heading).abs() < 1e-3 * (1.0 + by_heading.abs()));
        prop_assert!((seen.by_half_width - by_half_width).abs() < 1e-4);
    }
}

proptest! {
    /// A point that stays at its distance on the beam moves across it by what the
    /// sweep says, to the first order.
    #[test]
    fn a_beam_sweeps_what_its_point_moves_across(
        distance in 0.2_f64..2.0, ahead in -1.0_f64..1.0, turned in -1.0_f64..1.0,
        arm in -0.2_f64..0.3, beside in 0.05_f64..0.2, angle in 0.2_f64..1.5,
        is_left in any::<bool>(),
    ) {
        let beams = Beams::new(Mounting { ahead: arm, beside, angle }).unwrap();
        let (side, sign) = if is_left { (Side::Left, 1.0) } else { (Side::Right, -1.0) };
        let beam = -sign * angle;
        // The point, seen from where the robot was.
        let point = |way: f64, heading: f64| {
            let (sine, cosine) = heading.sin_cos();
            (
                way + arm * cosine - sign * beside * sine + distance * (heading + beam).cos(),
                arm * sine + sign * beside * cosine + distance * (heading + beam).sin(),
            )
        };
        let small = 1e-6;
        let (from, to) = (point(0.0, 0.0), point(small * ahead, small * turned));
        // Forwards is positive on either side.
        let across = sign * (-beam.sin() * (to.0 - from.0) + beam.cos() * (to.1 - from.1));
        let swept = beams.swept(side, distance, small * ahead, small * turned);
        prop_assert!((across - swept).abs() < 1e-10, "{across} {swept}");
    }
}

fn any_number() -> impl Strategy<Value = f32> {
    prop_oneof![
        4 => 0.2_f32..1.6,
        2 => 0.7_f32..0.8,
        1 => Just(1.5_f32),
        1 => any::<f32>(),
        1 => Just(f32::NAN),
        1 => Just(f32::INFINITY),
        1 => Just(f32::MAX),
    ]
}

fn is_sound(estimate: &RowEstimate<f32>) -> bool {
    let pose = &estimate.pose;
    [
        pose.offset,
        pose.heading,
        pose.half_width,
        estimate.curvature,
        estimate.deviation,
    ]
    .into_iter()
    .all(f32::is_finite)
        && pose.offset.abs() <= 0.381
        && pose.heading.abs() <= 0.61
        // Three tolerances beside what walls may say.
        && (0.381 * 0.5 - 0.061..=0.381 * 1.5 + 0.061).contains(&pose.half_width)
        && estimate.deviation >= 0.0
}

proptest! {
    /// Whatever the sensors say and whatever the time step: all outputs are
    /// numbers within their limits.
    #[test]
    fn outputs_stay_within_limits(
        history in proptest::collection::vec(
            (any_number(), any_number(), 1_usize..30, any::<bool>()), 1..40),
        odd_step in any::<f32>(),
    ) {
        let mut controller = RowController::<f32>::new(settings()).unwrap();
        for (left, right, times, odd) in history {
            for _ in 0..times {
                let dt = if odd { odd_step } else { STEP as f32 };
                let outcome = controller.step(&RowDistances { left, right }, true, dt);
                let sides = outcome.efforts;
                prop_assert!(sides.left.abs() <= 1.0 && sides.right.abs() <= 1.0);
                let wheels = outcome.wheels;
                let fastest = FULL_SPEED as f32 * 1.0001;
                prop_assert!(wheels.left.abs() <= fastest && wheels.right.abs() <= fastest);
                prop_assert!(is_sound(&outcome.estimate), "{:?}", outcome.estimate);
            }
        }
    }

    /// The estimator alone, with any wheel speeds.
    #[test]
    fn the_estimate_stays_sound(
        history in proptest::collection::vec(
            (any_number(), any_number(), any::<f32>(), -2.0_f32..2.0, 1_usize..50), 1..40),
    ) {
        let mut estimator = RowEstimator::<f32>::new(settings().estimator).unwrap();
        for (left, right, odd, wheel, times) in history {
            for _ in 0..times {
                let wheels = WheelSpeeds { left: wheel, right: odd };
                let distances = RowDistances { left, right };
                let estimate = estimator.step(&distances, &wheels, STEP as f32);
                prop_assert!(is_sound(&estimate), "{estimate:?}");
            }
        }
    }
}

/// Through a gap a robot that has turned to the right sees the next row on the
/// right. Taken for a stalk of the near row, it would say that the robot has turned
/// to the left.
#[test]
fn a_stalk_of_the_next_row_tells_the_heading() {
    let heading = |spacing: f64| {
        let mut settings = settings::<f64>().estimator;
        settings.rows.spacing = spacing;
        let mut estimator = RowEstimator::new(settings).unwrap();
        let next_row = RowPose {
            half_width: 0.381 + 0.762,
            ..pose(0.0, 0.3)
        };
        let right = beams().predict(Side::Right, &next_row).unwrap().distance;
        assert!(right > 1.3 && right < 1.45, "{right}");
        let wheels = WheelSpeeds {
            left: 0.4,
            right: 0.4,
        };
        // A stalk, and then nothing.
        for step in 0..80 {
            let distances = RowDistances {
                left: 1.5,
                right: if step < 30 { right } else { 1.5 },
            };
            estimator.step(&distances, &wheels, STEP);
        }
        estimator.estimate().pose.heading
    };
    let (with, without) = (heading(0.762), heading(0.0));
    assert!(with > 0.02, "{with}");
    assert!(without < 0.0, "{without}");
}

/// What a robot in the middle believes of its offset after it has passed something
/// 5 cm nearer than the left row on a straight way. The right sensor sees it for
/// `seen` metres of the way, and then what is at `behind`.
fn offset_beside(seen: f64, behind: f64) -> f64 {
    let mut estimator = RowEstimator::<f64>::new(settings().estimator).unwrap();
    let wheels = WheelSpeeds {
        left: 0.4,
        right: 0.4,
    };
    let near = beams()
        .predict(Side::Left, &pose(0.0, 0.0))
        .unwrap()
        .distance
        - 0.05 * SQRT_2;
    let mut way = -0.5;
    while way < 0.6 {
        way += 0.4 * STEP;
        let left = if way < 0.0 || way > seen + 0.1 {
            1.5
        } else if way <= seen {
            near
        } else {
            behind
        };
        estimator.step(&RowDistances { left, right: 1.5 }, &wheels, STEP);
    }
    estimator.estimate().pose.offset
}

/// A stalk of 2.5 cm is seen for 4.4 cm of the way. What is wider than two of them
/// is believed less, and what touches something else near by too.
#[test]
fn a_stalk_is_narrow_and_stands_alone() {
    let stalk = offset_beside(0.044, 1.5);
    assert!(stalk < -0.01, "{stalk}");
    let wide = offset_beside(0.2, 1.5);
    assert!(wide.abs() < stalk.abs() / 3.0, "{wide} {stalk}");
    // It hangs before a leaf that hides the rest.
    let touching = offset_beside(0.044, 0.45);
    assert!(touching.abs() < stalk.abs() / 1.5, "{touching} {stalk}");
}

/// Between walls the robot knows its heading before it has driven a fifth of a metre,
/// though motor drivers whose clocks differ turn it from the start on. A surface at one
/// side alone may be a leaf as long as that.
#[test]
fn walls_at_both_sides_are_known_after_a_short_way() {
    let heading = |right_is_open: bool| {
        let mut estimator = RowEstimator::<f64>::new(settings().estimator).unwrap();
        let wheels = WheelSpeeds {
            left: 0.4,
            right: 0.4,
        };
        let (mut offset, mut heading) = (0.0, 0.0);
        for _ in 0..100 {
            heading += 0.8 * 0.4 * STEP;
            offset += f64::sin(heading) * 0.4 * STEP;
            let distance = |side| {
                let seen = beams().predict(side, &pose(offset, heading));
                seen.unwrap().distance
            };
            let distances = RowDistances {
                left: distance(Side::Left),
                right: if right_is_open {
                    1.5
                } else {
                    distance(Side::Right)
                },
            };
            estimator.step(&distances, &wheels, STEP);
        }
        (estimator.estimate().pose.heading, heading)
    };
    let (found, is) = heading(false);
    assert!((found - is).abs() < 0.07, "{found} {is}");
    let (found, is) = heading(true);
    assert!((found - is).abs() > 0.1, "{found} {is}");
}

/// Offset and half width, as they are and as the estimate has them, of a robot that stays on its course
/// between barriers whose half width is the given one on each stretch of 3 m. From the second stretch on it
/// stands `aside` (m) of the middle.
fn between_barriers(half_widths: &[f64], aside: f64) -> ((f64, f64), (f64, f64)) {
    let mut estimator = RowEstimator::<f64>::new(settings().estimator).unwrap();
    let wheels = WheelSpeeds {
        left: 0.4,
        right: 0.4,
    };
    let stretch = |way: f64| ((way / 3.0) as usize).min(half_widths.len() - 1);
    let mut noise = Noise::new(1);
    let mut way = 0.0;
    while way < 3.0 * half_widths.len() as f64 - 1.0 {
        way += 0.4 * STEP;
        let distance = |side| {
            // The beam meets the stretch that is there where it ends.
            let seen = half_widths
                .iter()
                .enumerate()
                .filter_map(|(number, width)| {
                    let offset = if number == 0 { 0.0 } else { aside };
                    let there = RowPose {
                        half_width: *width,
                        ..pose(offset, 0.0)
                    };
                    let distance = beams().predict(side, &there)?.distance;
                    (stretch(way + distance / SQRT_2) == number).then_some(distance)
                });
            seen.fold(f64::INFINITY, f64::min)
        };
        let distances = RowDistances {
            left: distance(Side::Left) + 0.006 * noise.normal(),
            right: distance(Side::Right) + 0.006 * noise.normal(),
        };
        estimator.step(&distances, &wheels, STEP);
    }
    let found = estimator.estimate().pose;
    let last = half_widths.last().copied().unwrap();
    ((aside, last), (found.offset, found.half_width))
}

/// Barriers that step aside by 15 cm, as in the thesis (2.2.7), are the row, though the robot was
/// told of another width; and so are those that step back.
#[test]
fn walls_at_both_sides_of_another_width_are_the_row() {
    for (half_widths, aside) in [
        (&[0.381, 0.531][..], 0.0),
        (&[0.381, 0.531], 0.06),
        (&[0.381, 0.531], -0.06),
        (&[0.381, 0.531, 0.381], 0.04),
    ] {
        let (is, found) = between_barriers(half_widths, aside);
        assert!(
            (found.0 - is.0).abs() < 0.01 && (found.1 - is.1).abs() < 0.015,
            "{half_widths:?}: {found:?} instead of {is:?}"
        );
    }
}

/// The estimate after a `way` (m) in the middle between walls, and the largest half width that it had.
/// `beside` gives the distance of the wall at a side and a station, m; the readings are whole
/// centimetres with noise, as the sensors'.
fn along_walls(way: f64, beside: impl Fn(Side, f64) -> f64) -> (RowEstimate<f64>, f64) {
    let mut estimator = RowEstimator::<f64>::new(settings().estimator).unwrap();
    let wheels = WheelSpeeds {
        left: 0.4,
        right: 0.4,
    };
    let mut noise = Noise::new(1);
    let mut widest = 0.0_f64;
    let mut driven = 0.0;
    while driven < way {
        driven += 0.4 * STEP;
        let mut distance = |side| {
            // The beam meets its wall about 0.8 m ahead.
            let there = RowPose {
                half_width: beside(side, driven + 0.8),
                ..pose(0.0, 0.0)
            };
            let distance = beams().predict(side, &there).unwrap().distance;
            (100.0 * (distance + 0.005 * noise.normal())).round() / 100.0
        };
        let distances = RowDistances {
            left: distance(Side::Left),
            right: distance(Side::Right),
        };
        let estimate = estimator.step(&distances, &wheels, STEP);
        widest = widest.max(estimate.pose.half_width);
    }
    (estimator.estimate(), widest)
}

/// An opening in one of two walls, with another wall behind it, is no wider row.
#[test]
fn an_opening_in_one_wall_leaves_the_width() {
    for (far, length) in [(0.881, 0.6), (0.981, 2.0), (1.081, 0.6), (1.081, 2.0)] {
        let (last, widest) = along_walls(8.0, |side, station| match side {
            Side::Right if (3.0..3.0 + length).contains(&station) => far,
            _ => 0.381,
        });
        // Three standard deviations of the rows' width.
        assert!(widest < 0.381 + 0.061, "{far} {length}: {widest}");
        assert!(last.pose.offset.abs() < 0.02, "{far} {length}: {last:?}");
    }
}

/// Walls that are farther apart than rows are no row, so the robot is blind from the step on.
#[test]
fn walls_too_far_apart_are_no_row() {
    for half_width in [0.6, 0.62, 0.65, 0.7] {
        let wall = |station| if station < 3.0 { 0.381 } else { half_width };
        let (last, widest) = along_walls(3.0, |_, station| wall(station));
        assert!(widest < 0.381 + 0.061, "{half_width}: {widest}");
        assert!(last.blind_way > 0.75, "{half_width}: {last:?}");
    }
}

/// Readings of both sides that hardly change are walls of the rows' width or frozen sensors, so they
/// do not pass for walls of another width. So does a robot that does not move while its wheels turn.
#[test]
fn still_readings_of_another_width_are_a_fault() {
    for (left, right) in [(0.6, 0.62), (0.95, 0.97), (1.0, 1.0), (1.1, 1.1)] {
        let mut estimator = RowEstimator::<f64>::new(settings().estimator).unwrap();
        let wheels = WheelSpeeds {
            left: 0.4,
            right: 0.4,
        };
        let mut way = 0.0;
        let mut estimate = estimator.estimate();
        for step in 0..500 {
            let more = if step / 7 % 2 == 0 { 0.0 } else { 0.01 };
            let distances = RowDistances {
                left: left + more,
                right: right + more,
            };
            estimate = estimator.step(&distances, &wheels, STEP);
            way += 0.4 * STEP;
        }
        assert!(way < 1.01);
        let both = [estimate.left, estimate.right];
        assert_eq!(both, [SideHealth::Frozen; 2], "{left} {right}");
    }
}

/// Distance from an aperture at `x`, `y` along a beam to the nearest of the stalks
/// of both rows and of the next ones, on bends of the `radius` (m) about a centre to
/// the right. Up to 2.5 m, where the bus ends.
fn to_a_stalk(radius: f64, (x, y): (f64, f64), angle: f64) -> f64 {
    let (sine, cosine) = angle.sin_cos();
    let mut nearest: f64 = 2.5;
    for line in [-1.143, -0.381, 0.381, 1.143] {
        // From where the robot is on, 3 m at most.
        let first = (x / 0.2).floor() as i32;
        for number in first..first + 15 {
            let along = f64::from(number) * 0.2 / radius;
            let to_x = (radius - line) * along.sin() - x;
            let to_y = radius - (radius - line) * along.cos() - y;
            let across = to_y * cosine - to_x * sine;
            let half = 0.0125_f64.mul_add(0.0125, -across * across);
            let ahead = to_x * cosine + to_y * sine;
            if half > 0.0 && ahead > 0.0 {
                nearest = nearest.min(ahead - half.sqrt());
            }
        }
    }
    nearest
}

/// Offset that the estimate has at the end of 8 m along the middle of rows that
/// bend to the right.
fn offset_on_a_bend(radius: f64, gain: f64) -> f64 {
    let robot = RowRobot {
        open: 2.25,
        ..robot(0.4)
    };
    let mut settings = RowSettings::<f64>::for_robot(&robot).unwrap().estimator;
    settings.rows.bend_gain = gain;
    let mut estimator = RowEstimator::new(settings).unwrap();
    let turn = 0.4 / radius;
    let wheels = WheelSpeeds {
        left: 0.4 + turn * 0.225,
        right: 0.4 - turn * 0.225,
    };
    let (mut sum, mut heading) = (0.0, 0.0_f64);
    while heading * radius < 8.0 {
        heading += turn * STEP;
        let (sine, cosine) = heading.sin_cos();
        let (x, y) = (radius * sine, radius - radius * cosine);
        let aperture = |beside: f64| {
            (
                x + 0.2545 * cosine - beside * sine,
                y + 0.2545 * sine + beside * cosine,
            )
        };
        let distances = RowDistances {
            left: to_a_stalk(radius, aperture(0.152), heading - FRAC_PI_4),
            right: to_a_stalk(radius, aperture(-0.152), heading + FRAC_PI_4),
        };
        let estimate = estimator.step(&distances, &wheels, STEP);
        if heading * radius > 6.0 {
            sum += estimate.pose.offset * turn * STEP;
        }
    }
    sum * radius / 2.0
}

/// On a bend of 30 m the beams meet the rows 1 cm beside where straight ones would
/// be. The stalks of the next rows tell.
#[test]
fn the_next_rows_show_a_bend() {
    let (with, without) = (offset_on_a_bend(30.0, 0.05), offset_on_a_bend(30.0, 0.0));
    assert!(with.abs() < 0.003, "{with}");
    assert!(without.abs() > 0.007, "{without}");
}

/// A step is its two parts, and the second one changes no command before the next
/// step.
#[test]
fn a_step_is_a_command_and_a_correction() {
    let field = Field::new(&Crop::hard(), 2);
    let mut whole = RowController::<f32>::new(settings()).unwrap();
    let mut parts = whole;
    let mut never = whole;
    let mut differs = false;
    run(&field, Ground::rough(2), 2, 30.0, |left, right, _| {
        let distances = RowDistances {
            left: left as f32,
            right: right as f32,
        };
        let outcome = whole.step(&distances, true, STEP as f32);
        assert_eq!(outcome, parts.command(&distances, true, STEP as f32));
        parts.correct();
        let uncorrected = never.command(&distances, true, STEP as f32);
        differs |= uncorrected.estimate.pose != outcome.estimate.pose;
        (
            f64::from(outcome.efforts.left),
            f64::from(outcome.efforts.right),
        )
    });
    assert!(differs, "nothing was corrected");
}

proptest! {
    #[test]
    fn a_reciprocal_root_is_within_a_millionth(exponent in -30.0_f32..30.0) {
        let value = 10.0_f32.powf(exponent);
        let exact = 1.0 / f64::from(value).sqrt();
        let error = f64::from(value.reciprocal_root()) / exact - 1.0;
        prop_assert!(error.abs() < 1e-6, "{error}");
    }
}

/// In a mirror the robot does the mirrored. When runs of both sides end in the same
/// step, the left one comes first, and another hypothesis may be dropped: a
/// difference that the next stalks take back.
#[test]
fn a_mirrored_row_gives_mirrored_commands() {
    for seed in 1..=3 {
        let field = Field::new(&Crop::hard(), seed);
        let mut seen = Vec::new();
        run(
            &field,
            Ground::rough(seed),
            seed,
            55.0,
            |left, right, robot| {
                seen.push((left, right));
                // Any steady drive shows the same row to both controllers.
                let (_, beside) = robot.at();
                (0.28 - 0.2 * beside, 0.28 + 0.2 * beside)
            },
        );
        let mut straight = RowController::<f64>::new(settings()).unwrap();
        let mut mirrored = straight;
        let (mut sum, mut most) = (0.0, 0.0);
        for (step, &(left, right)) in seen.iter().enumerate() {
            let distances = RowDistances { left, right };
            let other = RowDistances {
                left: right,
                right: left,
            };
            let a = straight.step(&distances, true, STEP);
            let b = mirrored.step(&other, true, STEP);
            let apart = (a.wheels.left - b.wheels.right).abs();
            assert!(apart < 0.2, "seed {seed}, step {step}: {a:?} {b:?}");
            sum += apart;
            most += (a.wheels.left - a.wheels.right).abs();
        }
        assert!(sum < 0.05 * most, "seed {seed}: {sum} of {most}");
    }
}

/// The estimate finds offset, heading, width and the difference of the motors of a
/// robot between smooth walls.
#[test]
fn the_estimate_finds_the_true_state() {
    let mut estimator = RowEstimator::<f64>::new(settings().estimator).unwrap();
    // The left wheels are 2 % faster than commanded, and the rows 1 cm wider on
    // each side than expected.
    let (mut offset, mut heading) = (0.05, -0.04);
    let mut estimate = estimator.estimate();
    for _ in 0..3000 {
        let truth = RowPose {
            half_width: 0.391,
            ..pose(offset, heading)
        };
        let distance = |side| beams().predict(side, &truth).unwrap().distance;
        let distances = RowDistances {
            left: distance(Side::Left),
            right: distance(Side::Right),
        };
        let turn = -1.5 * (estimate.pose.offset + estimate.pose.heading);
        let wheels = WheelSpeeds {
            left: 0.4 + turn * 0.225,
            right: 0.4 - turn * 0.225,
        };
        estimate = estimator.step(&distances, &wheels, STEP);
        heading += (turn + 0.02 * 0.4 / 0.45) * STEP;
        offset += 0.4 * heading.sin() * STEP;
    }
    let found = estimate.pose;
    assert!((found.offset - offset).abs() < 0.005, "{found:?} {offset}");
    assert!(
        (found.heading - heading).abs() < 0.01,
        "{found:?} {heading}"
    );
    assert!((found.half_width - 0.391).abs() < 0.003, "{found:?}");
    assert!(
        (estimate.curvature - 0.02 / 0.45).abs() < 0.02,
        "{estimate:?}"
    );
    assert!(estimate.deviation < 0.04, "{estimate:?}");
}

fn estimate_of(offset: f64, heading: f64, curvature: f64, deviation: f64) -> RowEstimate<f64> {
    RowEstimate {
        pose: pose(offset, heading),
        curvature,
        turn: 0.0,
        deviation,
        left: SideHealth::Fresh,
        right: SideHealth::Fresh,
        blind_way: 0.0,
        open_way: 0.0,
    }
}

#[test]
fn the_law_steers_to_the_middle_and_slows_down_in_doubt() {
    let law = settings::<f64>().law;
    let turn = |estimate: &RowEstimate<f64>| {
        let wheels = law.wheels(estimate);
        (wheels.left - wheels.right) / law.track
    };
    let speed = |estimate: &RowEstimate<f64>| {
        let wheels = law.wheels(estimate);
        (wheels.left + wheels.right) / 2.0
    };
    assert!(
        turn(&estimate_of(0.05, 0.0, 0.0, 0.01)) < 0.0,
        "right: turn left"
    );
    assert!(turn(&estimate_of(0.0, -0.05, 0.0, 0.01)) > 0.0);
    // What turns the robot to the right is taken back.
    let curved = turn(&estimate_of(0.0, 0.0, 0.1, 0.01));
    assert!((curved + 0.4 * 0.1).abs() < 1e-12, "{curved}");
    let sure = estimate_of(0.05, 0.0, 0.0, 0.01);
    let unsure = estimate_of(0.05, 0.0, 0.0, 0.2);
    assert!((speed(&sure) - 0.4).abs() < 1e-12);
    assert!((speed(&unsure) - 0.2).abs() < 1e-12);
    assert!(turn(&unsure).abs() < turn(&sure).abs() / 4.0);
    // Full turn rate, and never more.
    let far = turn(&estimate_of(3.0, -1.5, -9.0, 0.01));
    assert!((far - law.turn_rate).abs() < 1e-12, "{far}");
    let lost = law.wheels(&estimate_of(f64::NAN, 0.0, 0.0, 0.01));
    assert_eq!((lost.left, lost.right), (0.0, 0.0));
}

#[test]
fn it_stands_until_it_is_engaged() {
    let mut controller = RowController::<f32>::new(settings()).unwrap();
    let distances = RowDistances {
        left: 0.75,
        right: 0.75,
    };
    let outcome = controller.step(&distances, false, STEP as f32);
    assert_eq!(outcome.state, RowState::Idle);
    assert_eq!((outcome.efforts.left, outcome.efforts.right), (0.0, 0.0));
    let outcome = controller.step(&distances, true, STEP as f32);
    assert_eq!(outcome.state, RowState::Following);
    assert!(outcome.efforts.left > 0.0);
}

/// The refusal of changed settings; its text is one sentence.
fn refusal(change: impl Fn(&mut RowSettings<f64>)) -> Option<RowSettingsError> {
    let mut settings = settings();
    change(&mut settings);
    let error = RowController::new(settings).err();
    if let Some(error) = &error {
        let sentence = error.to_string();
        assert!(!sentence.is_empty() && !sentence.contains('\n'));
    }
    error
}

#[test]
fn unusable_settings_of_the_estimator_are_named() {
    use RowEstimatorError as E;
    let refused = |change: fn(&mut control::row::RowEstimatorSettings<f64>)| match refusal(|s| {
        change(&mut s.estimator);
    }) {
        Some(RowSettingsError::Estimator(error)) => Some(error),
        None => None,
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(|_| ()), None);
    assert_eq!(refused(|s| s.rows.half_width = 0.0), Some(E::HalfWidth));
    assert_eq!(refused(|s| s.rows.tolerance = 0.4), Some(E::Tolerance));
    assert_eq!(refused(|s| s.rows.spacing = -0.1), Some(E::Spacing));
    assert_eq!(refused(|s| s.rows.scatter = f64::NAN), Some(E::Scatter));
    assert_eq!(refused(|s| s.rows.far_scatter = 0.0), Some(E::Scatter));
    assert_eq!(refused(|s| s.rows.bend_gain = -0.1), Some(E::BendGain));
    assert_eq!(refused(|s| s.readings.wide = 0.0), Some(E::Way));
    assert_eq!(refused(|s| s.readings.least = 2.0), Some(E::Range));
    assert_eq!(refused(|s| s.readings.open = 0.7), Some(E::OutOfRange));
    assert_eq!(refused(|s| s.readings.agreement = 0.0), Some(E::Agreement));
    assert_eq!(refused(|s| s.readings.clear.stalk = 1.1), Some(E::Odds));
    assert_eq!(refused(|s| s.readings.leafy.far = 0.0), Some(E::Odds));
    assert_eq!(refused(|s| s.readings.doubt = 0.0), Some(E::Doubt));
    assert_eq!(refused(|s| s.readings.run = -1.0), Some(E::Way));
    assert_eq!(refused(|s| s.motion.track = 0.0), Some(E::Track));
    assert_eq!(
        refused(|s| s.motion.wheel_speed = -1.0),
        Some(E::WheelSpeed)
    );
    assert_eq!(refused(|s| s.motion.lag = -0.1), Some(E::Lag));
    assert_eq!(refused(|s| s.motion.heading_walk = 0.0), Some(E::Walk));
}

#[test]
fn unusable_settings_of_the_law_are_named() {
    use RowLawError as E;
    let refused = |change: fn(&mut control::row::RowLawSettings<f64>)| match refusal(|s| {
        change(&mut s.law);
    }) {
        Some(RowSettingsError::Law(error)) => Some(error),
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(|s| s.cruise = 0.0), Some(E::Cruise));
    assert_eq!(refused(|s| s.slow = 1.5), Some(E::Slow));
    assert_eq!(refused(|s| s.poor = s.good), Some(E::Deviations));
    assert_eq!(refused(|s| s.settling = f64::NAN), Some(E::Settling));
    assert_eq!(refused(|s| s.damping = 0.1), Some(E::Damping));
    assert_eq!(refused(|s| s.approach = 1.0), Some(E::Approach));
    assert_eq!(refused(|s| s.turn_rate = 0.0), Some(E::TurnRate));
    assert_eq!(refused(|s| s.wheel_speed = 0.3), Some(E::WheelSpeed));
    assert_eq!(refused(|s| s.track = 0.0), Some(E::Track));
    assert_eq!(refused(|s| s.lead = -0.1), Some(E::Lead));
}

#[test]
fn unusable_settings_of_the_controller_are_named() {
    use RowSettingsError as E;
    assert_eq!(refusal(|s| s.end_way = 0.0), Some(E::EndWay));
    assert_eq!(refusal(|s| s.lost_way = 1.0), Some(E::LostWay));
    assert_eq!(
        refusal(|s| s.motors.left.negative.dead_band = 1.0),
        Some(E::Motor)
    );
    let mut askew = robot(0.4);
    askew.mounting.angle = 0.0;
    assert_eq!(
        RowSettings::<f32>::for_robot(&askew).err(),
        Some(E::Mounting(MountingError::Angle))
    );
}
