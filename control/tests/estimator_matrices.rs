//! The estimator leaves out products with zero. It must compute what the matrices of the textbook
//! give.

#[path = "common/example.rs"]
mod example;
#[path = "common/matrices.rs"]
mod matrices;

use control::estimator::{Estimator, Observation};
use control::habits::Expected;
use control::model::{Antenna, Geometry};
use control::position::{Position, Velocity};
use control::scalar::{Scalar, wrap_angle};
use matrices::Matrices;
use proptest::prelude::*;
use proptest::strategy::ValueTree as _;
use proptest::test_runner::TestRunner;

/// What happens in one step of a drive.
#[derive(Clone, Debug)]
struct Event {
    steering_rate: f64,
    speed: f64,
    /// Whether position, velocity and steering angle arrive.
    arrives: (bool, bool, bool),
    /// Noise of north, east, course and steering angle, in standard deviations.
    noise: [f64; 4],
}

fn event() -> impl Strategy<Value = Event> {
    let speed = prop_oneof![4 => 0.5..2.0_f64, 1 => Just(0.0), 1 => -1.0..-0.5_f64];
    let arrival = || prop::bool::weighted(0.8);
    let noise = prop::array::uniform4(-3.0..3.0_f64);
    (
        -0.5..0.5_f64,
        speed,
        (arrival(), arrival(), arrival()),
        noise,
    )
        .prop_map(|(steering_rate, speed, arrives, noise)| Event {
            steering_rate,
            speed,
            arrives,
            noise,
        })
}

/// A vehicle whose antenna need be neither on the centre line nor ahead of the axle.
#[derive(Clone, Debug)]
struct Drive {
    l1: f64,
    right: f64,
    delay: f64,
    heading: f64,
    /// Each is held for some steps.
    events: Vec<(Event, usize)>,
    /// At this step the receiver jumps, m east.
    jump: (usize, f64),
}

fn drive() -> impl Strategy<Value = Drive> {
    (
        (-0.5..1.0_f64, -0.4..0.4_f64, 0.0..0.25_f64),
        -3.1..3.1_f64,
        prop::collection::vec((event(), 1..15_usize), 5..25),
        (20..80_usize, -4.0..4.0_f64),
    )
        .prop_map(|((l1, right, delay), heading, events, jump)| Drive {
            l1,
            right,
            delay,
            heading,
            events,
            jump,
        })
}

/// Drives a kinematic vehicle and calls `each` with what it measures in every step.
fn run(drive: &Drive, mut each: impl FnMut(usize, &Observation<f64>)) {
    let (mut north, mut east, mut heading) = (0.0_f64, 0.0_f64, drive.heading);
    let (mut steering, mut speed) = (0.0_f64, 0.0_f64);
    let mut step = 0;
    for (event, times) in &drive.events {
        for turn in 0..*times {
            speed += (event.speed - speed) * 0.25;
            let before = steering;
            steering = (steering + event.steering_rate * 0.1).clamp(-0.45, 0.45);
            north += speed * heading.cos() * 0.1;
            east += speed * heading.sin() * 0.1;
            heading = wrap_angle(heading + speed * steering.tan() / 1.1 * 0.1);
            let [n, e, course, angle] = event
                .noise
                .map(|noise| if turn % 2 == 0 { noise } else { -noise });
            let jump = if step >= drive.jump.0 {
                drive.jump.1
            } else {
                0.0
            };
            let whole = |metres: f64| (metres * 1000.0).round() as i32;
            let (sine, cosine) = (heading + course * 0.02).sin_cos();
            let (position, velocity, potentiometer) = event.arrives;
            each(
                step,
                &Observation {
                    position: position.then(|| {
                        Position::new(whole(north + n * 0.01), whole(east + e * 0.01 + jump))
                    }),
                    velocity: velocity
                        .then(|| Velocity::new(whole(speed * cosine), whole(speed * sine))),
                    steering_angle: (potentiometer || step < 10)
                        .then_some(steering + angle * 0.002 + 0.02),
                    steering_rate: (steering - before) / 0.1,
                    speed: event.speed,
                    dt: 0.1,
                },
            );
            step += 1;
        }
    }
}

fn single(seen: &Observation<f64>) -> Observation<f32> {
    Observation {
        position: seen.position,
        velocity: seen.velocity,
        steering_angle: seen.steering_angle.map(|angle| angle as f32),
        steering_rate: seen.steering_rate as f32,
        speed: seen.speed as f32,
        dt: seen.dt as f32,
    }
}

/// The example's estimator with the antenna of `drive`.
fn settings<T: Scalar>(drive: &Drive) -> control::estimator::EstimatorSettings<T> {
    let mut settings = example::settings::<T>().estimator;
    settings.geometry = Geometry {
        l1: T::lit(drive.l1),
        l2: T::lit(1.1 - drive.l1),
    };
    settings.antenna = Antenna {
        right: T::lit(drive.right),
        height: T::zero(),
    };
    settings.gps_delay = T::lit(drive.delay);
    // What is estimated beside the filter is not in the matrices.
    settings.expected = Expected {
        curvature: T::zero(),
        age: T::zero(),
    };
    settings
}

proptest! {
    /// In double precision both give the same estimate and the same covariance, but for the series
    /// of angles that lie close together.
    #[test]
    fn agrees_with_the_matrices(drive in drive()) {
        let mut matrices = Matrices::new(settings(&drive));
        let mut estimator = Estimator::<f64>::new(settings(&drive), Position::new(0, 0)).unwrap();
        let mut worst = (0.0_f64, 0.0_f64);
        let mut same = true;
        run(&drive, |_, seen| {
            estimator.step(seen);
            matrices.step(seen);
            same &= estimator.is_ready() == matrices.ready;
            let found = estimator.estimate();
            let state = &matrices.state;
            let differences = [
                found.north - state[0],
                found.east - state[1],
                wrap_angle(found.heading - state[2]),
                found.steering_angle - state[3],
                found.heading_bias - state[4],
                found.steering_bias - state[5],
                found.speed - matrices.speed,
                estimator.effectiveness() - matrices.effectiveness,
                estimator.drive() - matrices.drive(),
            ];
            worst.0 = differences.iter().fold(worst.0, |worst, it| worst.max(it.abs()));
            let covariance = (estimator.covariance() - matrices.covariance).amax();
            worst.1 = worst.1.max(covariance);
        });
        prop_assert!(same, "only one has an estimate");
        prop_assert!(worst.0 < 1e-6 && worst.1 < 1e-6, "{worst:?}");
    }
}

/// In single precision the estimate stays closer to that of the matrices than a hundredth of what
/// the receiver resolves. Where a measurement lies at a limit, one of the two may leave it out:
/// that happens in some drives of ten thousand.
#[test]
fn single_precision_agrees_with_the_matrices() {
    let mut runner = TestRunner::deterministic();
    let mut close = 0;
    for _ in 0..1000 {
        let mut drive = drive().new_tree(&mut runner).unwrap().current();
        // A lasting jump is accepted after some outliers, and what an outlier is, may differ.
        drive.jump.1 = 0.0;
        let mut matrices = Matrices::new(settings(&drive));
        let mut estimator = Estimator::<f32>::new(settings(&drive), Position::new(0, 0)).unwrap();
        let mut worst = 0.0_f64;
        run(&drive, |_, seen| {
            estimator.step(&single(seen));
            matrices.step(seen);
            if !(estimator.is_ready() && matrices.ready) {
                return;
            }
            let found = estimator.estimate();
            let state = &matrices.state;
            let differences = [
                f64::from(found.north) - state[0],
                f64::from(found.east) - state[1],
                wrap_angle(f64::from(found.heading) - state[2]),
                f64::from(found.steering_angle) - state[3],
            ];
            worst = differences
                .iter()
                .fold(worst, |worst, it| worst.max(it.abs()));
        });
        close += usize::from(worst < 3e-5);
    }
    assert!(close >= 995, "{close} of 1000");
}
