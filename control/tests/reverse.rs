//! The law drives backwards: it comes onto lines and arcs, and stays on them.

mod common;

use common::{Conditions, Plant};
use control::controller::{Controller, Settings};
use control::dubins::Pose;
use control::mission::{Pace, Piece, Stretch};
use control::position::Position;
use control::response::{Response, ResponseSettings, ResponseWatch};
use control::safety::Command;
use control::turn::Part;
use control::vehicle::{Description, degrees};

/// A piece from `start` on, of the vehicle's own poses.
fn piece(start: Pose<f64>, part: Part<f64>, speed: f64) -> Piece<f32> {
    let segment = part.segment(start);
    Piece {
        segment: control::path::Segment {
            start: Pose {
                north: segment.start.north as f32,
                east: segment.start.east as f32,
                heading: segment.start.heading as f32,
            },
            curvature: segment.curvature as f32,
            sharpness: segment.sharpness as f32,
            length: segment.length as f32,
        },
        speed: speed as f32,
        reverse: part.reverse,
        ..Piece::default()
    }
}

/// Cross-track errors (m) of the rear axle, as a single antenna can know it, in each period on the way back, seen in the direction of
/// travel.
///
/// The vehicle drives eight metres ahead, and back along a line or an arc that begins `offset` metres
/// beside it.
fn back(
    vehicle: &Description,
    conditions: Conditions,
    (curvature, speed): (f64, f64),
    offset: f64,
    seed: u64,
) -> Vec<f64> {
    let settings = Settings::<f32>::for_vehicle(vehicle).unwrap();
    let ahead = Part {
        length: 8.0,
        ..Part::default()
    };
    let turning = Pose {
        north: 8.0,
        east: offset,
        heading: 0.0,
    };
    let return_way = Part {
        curvature,
        length: 60.0,
        reverse: true,
        ..Part::default()
    };
    let mut stretch = Stretch::new(
        Position::new(0, 0),
        Pace::of_drive(vehicle.drive_lag as f32),
    );
    assert!(stretch.push(piece(Pose::default(), ahead, speed)));
    assert!(stretch.push(Piece {
        last: true,
        ..piece(turning, return_way, speed)
    }));
    let mut controller = Controller::following(settings, stretch).unwrap();
    let mut watch = ResponseWatch::new(ResponseSettings::of(&settings));
    let mut plant = Plant::of(*vehicle, conditions, seed);
    plant.north = 0.0;
    let mut applied = Command {
        steering_rate: 0.0,
        speed: 0.0,
    };
    let segment = return_way.segment(turning);
    let mut along = 0.0;
    let mut errors = Vec::new();
    for _ in 0..3000 {
        let heard = plant.hear();
        let command = Command {
            steering_rate: applied.steering_rate as f32,
            speed: applied.speed as f32,
        };
        let sample = heard.sample(command, vehicle.period as f32);
        let outcome = controller.step(&sample);
        let departure = watch.step(&Response {
            cross_track: None,
            ..Response::of(&sample, &outcome)
        });
        assert_eq!(departure, None);
        if controller.progress().segment == 1 {
            // On a slope the body points uphill of its course. The antenna cannot tell that: what is
            // held on the path is the point behind it on the course.
            let (sine, cosine) = (plant.heading + plant.crab).sin_cos();
            let (north, east) = plant.antenna();
            let l1 = vehicle.geometry.l1;
            let place = segment.locate(north - l1 * cosine, east - l1 * sine, along);
            along = place.along;
            errors.push(place.cross_track);
        }
        if outcome.finished {
            assert_eq!(outcome.command, Command::still());
            return errors;
        }
        applied = Command {
            steering_rate: f64::from(outcome.command.steering_rate),
            speed: f64::from(outcome.command.speed),
        };
        plant.drive(applied, vehicle.period);
    }
    panic!("the end is not reached");
}

/// A small vehicle with its antenna far ahead, and a tractor.
const VEHICLES: [(&str, Description); 2] = [
    ("example", common::example::VEHICLE),
    (
        "tractor",
        Description {
            geometry: control::model::Geometry { l1: 2.0, l2: 0.5 },
            limits: control::feedback::Limits {
                steering_angle: degrees(40.0),
                steering_rate: degrees(25.0),
                speed: 3.0,
            },
            weights: None,
            ..common::example::VEHICLE
        },
    ),
];

#[test]
fn it_comes_onto_lines_and_arcs_backwards() {
    for (name, vehicle) in VEHICLES {
        for (kind, conditions) in [
            ("level", Conditions::default()),
            ("loaded", Conditions::loaded()),
        ] {
            let conditions = Conditions {
                offset: 0.0,
                ..conditions
            };
            for course in [(0.0, 0.5), (0.0, 1.0), (0.1, 1.0), (-0.1, 1.0), (0.15, 0.5)] {
                let (mut slowest, mut largest, mut mean) = (0.0_f64, 0.0_f64, 0.0_f64);
                for (seed, offset) in [(1, 0.4), (2, -0.4), (3, 1.0), (4, -1.0)] {
                    let errors = back(&vehicle, conditions, course, offset, seed);
                    let settled = errors.iter().rposition(|error| error.abs() > 0.05);
                    let settled = settled.map_or(0, |last| last + 1);
                    slowest = slowest.max(settled as f64 * 0.1 * course.1);
                    // The last 20 of 60 m.
                    let steady = &errors[errors.len() * 2 / 3..];
                    let average = steady.iter().sum::<f64>() / steady.len() as f64;
                    mean = mean.max(average.abs());
                    let spread = steady.iter().map(|error| error.abs()).fold(0.0, f64::max);
                    largest = largest.max(spread);
                }
                println!(
                    "{name}, {kind}, {} 1/m at {} m/s: settled after {slowest:.1} m, then mean \
                     {:.2} cm, worst {:.1} cm",
                    course.0,
                    course.1,
                    mean * 100.0,
                    largest * 100.0
                );
                // On a slope the course changes by twice the crab angle where the direction does.
                let most = if kind == "level" { 12.0 } else { 20.0 };
                assert!(slowest < most, "{slowest} m");
                assert!(mean < 0.02 && largest < 0.05, "{mean} m, {largest} m");
            }
        }
    }
}
