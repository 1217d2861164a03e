//! Guidance by the rows while there is no fix: what may guide, handovers without a jump,
//! and a vehicle that drives below a canopy.

mod common;
#[path = "common/rows.rs"]
mod rows;

use common::{Conditions, Noise, Plant};
use control::controller::{Controller, Sample, Settings, Tracking};
use control::line::Line;
use control::position::Position;
use control::row::{Mounting, RowDistances, RowPose, RowRobot, RowSettings};
use control::safety::Command;
use control::takeover::{
    Guide, Place, Presence, RowSighting, RowWatch, Situation, Takeover, TakeoverError,
    TakeoverSettings,
};
use proptest::prelude::*;
use rows::{Crop, Field, robot};

const DT: f64 = 0.1;
const HALF_WIDTH: f64 = 0.55;

fn limits() -> TakeoverSettings<f64> {
    TakeoverSettings {
        speed: 0.5,
        longest_age: 0.3,
        longest_way: 30.0,
        settle: 1.0,
        take_back: 0.05,
        half_width: HALF_WIDTH,
        tolerance: 0.02,
    }
}

fn takeover() -> Takeover<f64> {
    Takeover::new(limits(), common::example::settings()).unwrap()
}

fn tracking(right: f64, heading: f64) -> Tracking<f64> {
    Tracking {
        cross_track: right,
        heading_error: heading,
        speed: 0.5,
        ..Tracking::default()
    }
}

fn sighting(right: f64, heading: f64) -> RowSighting<f64> {
    RowSighting {
        presence: Presence::Following,
        pose: RowPose {
            offset: right,
            heading,
            half_width: HALF_WIDTH,
        },
        deviation: 0.02,
    }
}

/// A step of a vehicle on its line, between rows whose middle is on it.
fn situation(fixed: bool) -> Situation<f64> {
    Situation {
        running: true,
        fixed,
        tracking: tracking(0.0, 0.0),
        sighting: Some(sighting(0.0, 0.0)),
        dt: DT,
    }
}

/// A takeover that the rows guide.
fn in_rows() -> Takeover<f64> {
    let mut takeover = takeover();
    for _ in 0..10 {
        assert_eq!(takeover.step(&situation(true)), Guide::Satellites);
    }
    assert_eq!(takeover.step(&situation(false)), Guide::Rows);
    takeover
}

#[test]
fn without_rows_the_run_ends_with_the_fix() {
    let mut takeover = takeover();
    let bare = |fixed| Situation {
        sighting: None,
        ..situation(fixed)
    };
    assert_eq!(takeover.step(&bare(true)), Guide::Satellites);
    assert_eq!(takeover.step(&bare(false)), Guide::Nothing);
    // It does not come back by itself.
    assert_eq!(takeover.step(&situation(true)), Guide::Nothing);
    let ended = Situation {
        running: false,
        ..situation(true)
    };
    assert_eq!(takeover.step(&ended), Guide::Satellites);
}

#[test]
fn four_sightings_are_too_few() {
    let mut takeover = takeover();
    for _ in 0..3 {
        takeover.step(&situation(true));
    }
    assert_eq!(takeover.step(&situation(false)), Guide::Nothing);
}

#[test]
fn rows_across_the_line_do_not_take_over() {
    for (angle, guide) in [(0.1, Guide::Rows), (0.2, Guide::Nothing)] {
        let mut takeover = takeover();
        let across = |fixed| Situation {
            // The vehicle is driven along its rows.
            tracking: tracking(0.0, angle),
            ..situation(fixed)
        };
        for _ in 0..10 {
            takeover.step(&across(true));
        }
        assert_eq!(takeover.step(&across(false)), guide);
    }
}

#[test]
fn a_run_without_sound_sightings_ends_after_the_longest_age() {
    let sound = sighting(0.0, 0.0);
    let wide = RowPose {
        half_width: HALF_WIDTH + 0.1,
        ..sound.pose
    };
    let unsound = [
        None,
        Some(RowSighting {
            pose: wide,
            ..sound
        }),
        Some(RowSighting {
            deviation: 0.2,
            ..sound
        }),
        Some(RowSighting {
            deviation: f64::NAN,
            ..sound
        }),
        Some(sighting(0.2, 0.0)),
        Some(sighting(0.0, 0.2)),
        Some(sighting(0.5, 0.0)),
        Some(sighting(f64::NAN, 0.0)),
        Some(sighting(0.0, f64::NAN)),
    ];
    for sighting in unsound {
        let mut takeover = in_rows();
        let now = Situation {
            sighting,
            ..situation(false)
        };
        let steps = (0..10).take_while(|_| takeover.step(&now) == Guide::Rows);
        assert!((2..=3).contains(&steps.count()), "{sighting:?}");
        assert_eq!(takeover.guide(), Guide::Nothing);
    }
}

#[test]
fn the_end_of_the_row_ends_the_run_at_once() {
    for presence in [Presence::End, Presence::Faulty, Presence::Searching] {
        let ended = |fixed| Situation {
            sighting: Some(RowSighting {
                presence,
                ..sighting(0.0, 0.0)
            }),
            ..situation(fixed)
        };
        assert_eq!(in_rows().step(&ended(false)), Guide::Nothing);
        // With a fix the run goes on by it, be it the first one.
        assert_eq!(in_rows().step(&ended(true)), Guide::Returning);
    }
}

#[test]
fn the_way_without_a_fix_is_limited() {
    let mut takeover = in_rows();
    let mut steps = 0;
    while takeover.step(&situation(false)) == Guide::Rows {
        steps += 1;
        assert!(takeover.way() <= 30.0 + 0.051);
    }
    // 0.5 m/s for 0.1 s each.
    assert!((598..=601).contains(&steps), "{steps}");
    assert_eq!(takeover.guide(), Guide::Nothing);
}

#[test]
fn a_fix_that_flickers_does_not_end_the_guidance_by_rows() {
    let mut takeover = in_rows();
    for _ in 0..20 {
        for _ in 0..8 {
            assert_eq!(takeover.step(&situation(true)), Guide::Rows);
        }
        assert_eq!(takeover.step(&situation(false)), Guide::Rows);
    }
    let until = |takeover: &mut Takeover<f64>, guide| {
        (0..100)
            .take_while(|_| takeover.step(&situation(true)) != guide)
            .count()
    };
    assert_eq!(until(&mut takeover, Guide::Returning), 10);
    assert!((15..25).contains(&until(&mut takeover, Guide::Satellites)));
}

#[test]
fn a_bad_setting_is_refused() {
    type Spoil = fn(&mut TakeoverSettings<f64>);
    let cases: [(Spoil, _); 7] = [
        (|s| s.speed = 0.0, TakeoverError::Speed),
        (|s| s.longest_age = f64::NAN, TakeoverError::Age),
        (|s| s.longest_way = -1.0, TakeoverError::Way),
        (|s| s.settle = -0.1, TakeoverError::Settle),
        (|s| s.take_back = 0.0, TakeoverError::TakeBack),
        (|s| s.half_width = f64::INFINITY, TakeoverError::Width),
        (|s| s.tolerance = 0.0, TakeoverError::Width),
    ];
    for (spoil, error) in cases {
        let mut settings = limits();
        spoil(&mut settings);
        assert_eq!(settings.check(), Err(error));
        assert_eq!(
            Takeover::new(settings, common::example::settings()).err(),
            Some(error)
        );
    }
}

/// What may happen in a step.
fn events() -> impl Strategy<Value = Situation<f64>> {
    let presence = prop_oneof![
        9 => Just(Presence::Following),
        1 => Just(Presence::Searching),
        1 => Just(Presence::End),
    ];
    let pose = (-0.3..0.3, -0.1..0.1, 0.5..0.65, 0.0..0.2);
    let sighting =
        (presence, pose).prop_map(|(presence, (offset, heading, half_width, deviation))| {
            RowSighting {
                presence,
                pose: RowPose {
                    offset,
                    heading,
                    half_width,
                },
                deviation,
            }
        });
    let running = prop::bool::weighted(0.95);
    let fixed = prop::bool::weighted(0.5);
    let sighting = prop::option::weighted(0.8, sighting);
    let at = (-0.3..0.3, -0.1..0.1, 0.0..1.2, -0.3..0.3);
    (running, fixed, sighting, at).prop_map(|(running, fixed, sighting, at)| Situation {
        running,
        fixed,
        tracking: Tracking {
            speed: at.2,
            steering_angle: at.3,
            ..tracking(at.0, at.1)
        },
        sighting,
        dt: DT,
    })
}

/// Steps of a vehicle between its rows, with short and long losses of the fix and of
/// messages.
fn drives() -> impl Strategy<Value = Vec<Situation<f64>>> {
    let stretch = (1_usize..25, any::<bool>(), prop::bool::weighted(0.9));
    prop::collection::vec((stretch, -0.1..0.1, -0.02..0.02), 1..30).prop_map(|stretches| {
        let mut steps = Vec::new();
        for ((length, fixed, seen), right, heading) in stretches {
            for _ in 0..length {
                steps.push(Situation {
                    tracking: tracking(right, heading),
                    sighting: seen.then_some(sighting(right / 2.0, heading)),
                    ..situation(fixed)
                });
            }
        }
        steps
    })
}

fn check_steps(steps: &[Situation<f64>]) -> Result<[usize; 4], TestCaseError> {
    let mut takeover = takeover();
    let mut counts = [0; 4];
    let mut before = (Guide::Satellites, takeover.place().0);
    let mut silence = 1.0;
    for now in steps {
        silence += DT;
        if now.sighting.is_some() {
            silence = 0.0;
        }
        let guide = takeover.step(now);
        let (place, _) = takeover.place();
        counts[guide as usize] += 1;
        prop_assert!(now.running || guide == Guide::Satellites);
        prop_assert!(now.fixed || !now.running || matches!(guide, Guide::Rows | Guide::Nothing));
        prop_assert!(!now.running || before.0 != Guide::Nothing || guide == Guide::Nothing);
        prop_assert!(guide != Guide::Rows || silence <= limits().longest_age + 1e-9);
        prop_assert!(takeover.way() <= limits().longest_way + 1.2 * DT);
        if guide != before.0 && matches!(guide, Guide::Rows | Guide::Returning) {
            // The place goes on where it was, but for what the vehicle moves in a step.
            let from = match before.0 {
                Guide::Satellites => Place {
                    right: now.tracking.cross_track
                        - common::example::settings::<f64>().controlled_point
                            * now.tracking.heading_error.sin(),
                    heading: now.tracking.heading_error,
                },
                _ => before.1,
            };
            let way = now.tracking.speed * DT;
            prop_assert!((place.right - from.right).abs() <= way * 0.8 + 1e-9);
            prop_assert!((place.heading - from.heading).abs() <= way * 0.3 + 1e-9);
        }
        let (command, _) = takeover.drive(
            &now.tracking,
            Command::still(),
            Some(now.tracking.steering_angle),
            1.0,
            DT,
        );
        prop_assert!(command.speed >= 0.0 && command.steering_rate.is_finite());
        match guide {
            Guide::Rows => prop_assert!(command.speed <= limits().speed),
            Guide::Returning => {}
            Guide::Satellites | Guide::Nothing => prop_assert_eq!(command, Command::still()),
        }
        before = (guide, place);
    }
    Ok(counts)
}

proptest! {
    /// Whatever happens: no guidance by rows without a run or with old sightings, no
    /// return from a stop, and no jump when the guide changes.
    #[test]
    fn the_rules_hold_for_any_events(steps in prop::collection::vec(events(), 1..200)) {
        check_steps(&steps)?;
    }

    #[test]
    fn the_rules_hold_for_drives(steps in drives()) {
        check_steps(&steps)?;
    }
}

/// The drives above are no empty claim: they come into every state.
#[test]
fn drives_come_into_every_state() {
    use proptest::strategy::ValueTree as _;
    let mut runner = proptest::test_runner::TestRunner::deterministic();
    let mut counts = [0; 4];
    for _ in 0..50 {
        let steps = drives().new_tree(&mut runner).unwrap().current();
        for (sum, count) in counts.iter_mut().zip(check_steps(&steps).unwrap()) {
            *sum += count;
        }
    }
    assert!(counts.iter().all(|count| *count > 50), "{counts:?}");
}

/// A drive below a canopy.
struct Drive {
    /// Offset of the rear axle from the row's middle while the rows guide, m.
    offsets: Vec<f64>,
    guides: Vec<Guide>,
    /// Commands to the actuators.
    commands: Vec<Command<f64>>,
    /// Cross-track error of the antenna at the end, m.
    last: f64,
}

/// Sensors at the front, and rows 1.1 m apart.
fn row_settings() -> RowSettings<f64> {
    let robot = RowRobot {
        mounting: Mounting {
            ahead: 1.2,
            beside: 0.2,
            angle: std::f64::consts::FRAC_PI_4,
        },
        least: 0.22,
        open: 1.45,
        track: 1.0,
        lag: 0.0,
        width: 2.0 * HALF_WIDTH,
        tolerance: 0.04,
        gap: 1.0,
        cruise: 0.5,
        ..robot(0.5)
    };
    RowSettings::for_robot(&robot).unwrap()
}

/// Where the rows begin, m from the line's beginning.
const BEGIN: f64 = 10.0;

/// What the sensors at the front measure, in whole centimetres up to 1.5 m; the middle of the
/// rows is `right` of the line.
fn distances(field: &Field, plant: &Plant, right: f64, noise: &mut Noise) -> RowDistances<f64> {
    let (sine, cosine) = plant.heading.sin_cos();
    let mut reading = |beside: f64| {
        let x = plant.north - BEGIN + 1.2 * cosine - beside * sine;
        let y = plant.east - right + 1.2 * sine + beside * cosine;
        let angle = plant.heading - std::f64::consts::FRAC_PI_4 * beside.signum();
        let distance = field.ray(x, y, angle) + 0.004 * noise.normal();
        (distance.min(1.5) * 100.0).round() / 100.0
    };
    RowDistances {
        left: reading(0.2),
        right: reading(-0.2),
    }
}

/// The example vehicle on a line of 100 m. Rows stand beside it from 10 m on, their middle
/// `right` of the line, and the fix is lost from 20 m to `fix` m.
fn drive(crop: &Crop, right: f64, fix: f64, conditions: Conditions, seed: u64) -> Drive {
    let field = Field::new(crop, seed);
    let settings: Settings<f64> = common::example::settings();
    let line = Line::new(Position::new(0, 0), Position::new(100_000, 0)).unwrap();
    let mut controller = Controller::new(settings, line).unwrap();
    let mut takeover = Takeover::new(limits(), settings).unwrap();
    let mut watch = RowWatch::new(row_settings()).unwrap();
    let mut plant = Plant::new(conditions, seed);
    let mut noise = Noise::new(seed ^ 0x7A4E);
    let mut command = Command::still();
    let mut result = Drive {
        offsets: Vec::new(),
        guides: Vec::new(),
        commands: Vec::new(),
        last: 0.0,
    };
    let mut sighting = None;
    for _ in 0..3000 {
        let heard = plant.hear();
        let (north, _) = plant.antenna();
        if north > 60.0 {
            break;
        }
        let fixed = !(20.0..fix).contains(&north);
        let outcome = controller.step(&Sample {
            position: fixed.then_some(heard.position),
            velocity: fixed.then_some(heard.velocity),
            steering_angle: Some(heard.steering_angle),
            applied: command,
            engaged: matches!(takeover.guide(), Guide::Satellites | Guide::Returning),
            dt: DT,
        });
        let before = takeover.guide();
        let guide = takeover.step(&Situation {
            running: true,
            fixed,
            tracking: outcome.tracking,
            sighting,
            dt: DT,
        });
        if guide == Guide::Satellites && before == Guide::Returning {
            controller.resume(command);
        }
        command = match guide {
            Guide::Satellites => outcome.command,
            Guide::Rows | Guide::Returning => {
                let effectiveness = controller.estimator().effectiveness();
                let measured = Some(heard.steering_angle);
                let tracking = &outcome.tracking;
                takeover
                    .drive(tracking, command, measured, effectiveness, DT)
                    .0
            }
            Guide::Nothing => Command::still(),
        };
        result.guides.push(guide);
        result.commands.push(command);
        if guide == Guide::Rows {
            result.offsets.push(plant.east - right);
        }
        for _ in 0..20 {
            plant.drive(command, 0.005);
            let turn = plant.speed * plant.steering.tan() / 1.1;
            let distances = distances(&field, &plant, right, &mut noise);
            sighting = Some(watch.observe(&distances, plant.speed, turn, 0.005));
            watch.correct();
        }
    }
    result.last = plant.controlled().1;
    result
}

fn crop() -> Crop {
    Crop {
        length: 60.0,
        half_width: HALF_WIDTH,
        leaves: 0.5,
        ..Crop::corn()
    }
}

#[test]
fn the_rows_lead_below_a_canopy_and_back() {
    for seed in 0..4 {
        for right in [-0.12, 0.0, 0.1] {
            let conditions = Conditions {
                offset: 0.0,
                steering_bias: 0.02,
                slope: 0.03,
                ..Conditions::default()
            };
            let drive = drive(&crop(), right, 45.0, conditions, seed);
            let count = |guide| drive.guides.iter().filter(|it| **it == guide).count();
            assert_eq!(count(Guide::Nothing), 0, "seed {seed}, rows at {right} m");
            // 25 m at 0.5 m/s, and a second of a fix.
            assert!(
                (480..560).contains(&count(Guide::Rows)),
                "{}",
                count(Guide::Rows)
            );
            assert_eq!(drive.guides.last(), Some(&Guide::Satellites));
            let settled = &drive.offsets[100..];
            let mean = settled.iter().map(|it| it.abs()).sum::<f64>() / settled.len() as f64;
            let largest = drive
                .offsets
                .iter()
                .fold(0.0_f64, |most, it| most.max(it.abs()));
            assert!(mean < 0.05, "seed {seed}, rows at {right} m: mean {mean}");
            assert!(
                largest < 0.2,
                "seed {seed}, rows at {right} m: largest {largest}"
            );
            assert!(drive.last.abs() < 0.03, "{}", drive.last);
            // Neither the steering nor the speed jumps.
            let slew = common::example::settings::<f64>().slew;
            for pair in drive.commands.windows(2) {
                let step = pair[1].steering_rate - pair[0].steering_rate;
                assert!(step.abs() <= slew.steering * DT + 1e-9);
                assert!(pair[1].speed - pair[0].speed <= slew.speed * DT + 1e-9);
            }
        }
    }
}

#[test]
fn the_vehicle_stops_at_the_end_of_its_rows() {
    let short = Crop {
        length: 20.0,
        ..crop()
    };
    let conditions = Conditions {
        offset: 0.0,
        ..Conditions::default()
    };
    let drive = drive(&short, 0.0, 90.0, conditions, 3);
    assert_eq!(drive.guides.last(), Some(&Guide::Nothing));
    assert_eq!(drive.commands.last(), Some(&Command::still()));
    // The rows end 30 m from the start, 10 m behind the loss of the fix. The beams meet them
    // about 2 m ahead, and an end needs 1.6 m without plants.
    let steps = drive.offsets.len();
    assert!((160..220).contains(&steps), "{steps}");
}
