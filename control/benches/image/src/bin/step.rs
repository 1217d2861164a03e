//! Functions whose cycles `cargo xtask bench` counts: the control step and its parts. Each is
//! called after a function that prepares its state.

#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use core::panic::PanicInfo;

use control::controller::{Controller, Sample, Settings};
use control::estimator::{Estimator, Observation};
use control::guidance::{Deviation, Guidance};
use control::line::Line;
use control::model::Geometry;
use control::mpc::Mpc;
use control::plain::{GAINS, PlainController};
use control::position::{Position, Velocity};
use control::safety::{Command, SafetyFilter};
use control::scalar::Scalar;
use nalgebra::SVector;

// SETTINGS, a vehicle's.
include!(concat!(env!("OUT_DIR"), "/settings.rs"));

/// Time between two steps, s.
const PERIOD: f32 = 0.1;

/// State on which the measured functions work: a vehicle that approaches a line, with all
/// parts of its controller.
pub struct Kernel {
    controller: Controller<f32, Line<f32>>,
    plain: PlainController<f32>,
    estimator: Estimator<f32>,
    guidance: Guidance<f32>,
    safety: SafetyFilter<f32>,
    mpc: Option<Mpc<f32, 10>>,
    settings: Settings<f32>,
    deviation: Deviation<f32>,
    sample: Sample<f32>,
    observation: Observation<f32>,
    pose: [f32; 5],
}

impl Kernel {
    /// The state after `steps` steps from a start 1 m beside the line.
    fn after(steps: u32) -> Option<Self> {
        let settings = SETTINGS;
        let line = Line::new(Position::new(0, 0), Position::new(243_000, 0)).ok()?;
        let mut sample = Sample {
            position: None,
            velocity: None,
            steering_angle: Some(0.0),
            applied: Command::still(),
            engaged: true,
            dt: PERIOD,
        };
        let mut kernel = Self {
            controller: Controller::following(settings, line).ok()?,
            plain: PlainController::new(GAINS.map(|gain| gain as f32), settings, line).ok()?,
            estimator: Estimator::new(settings.estimator, Position::new(0, 0)).ok()?,
            guidance: Guidance::new(settings.guidance).ok()?,
            safety: SafetyFilter::new(settings.limits, settings.slew, settings.stale_after),
            mpc: None,
            settings,
            deviation: Deviation {
                cross_track: 1.0,
                heading: 0.0,
                steering_angle: 0.0,
                speed: 0.0,
                curvature: 0.0,
                curvature_ahead: 0.0,
                effectiveness: 1.0,
            },
            sample,
            observation: Observation {
                position: None,
                velocity: None,
                steering_angle: None,
                steering_rate: 0.0,
                speed: 0.0,
                dt: PERIOD,
            },
            pose: [0.0, 1.0, 0.0, 0.0, 0.0],
        };
        for _ in 0..steps {
            kernel.measure();
            sample = kernel.sample;
            kernel.estimator.step(&kernel.observation);
            let outcome = kernel.controller.step(&sample);
            kernel.sample.applied = outcome.command;
            kernel.drive();
        }
        kernel.measure();
        let [_, east, heading, steering_angle, speed] = kernel.pose;
        kernel.deviation = Deviation {
            cross_track: east,
            heading,
            steering_angle,
            speed,
            ..kernel.deviation
        };
        Some(kernel)
    }

    /// Measures the pose with the sensors.
    fn measure(&mut self) {
        let [north, east, heading, steering_angle, speed] = self.pose;
        let (sine, cosine) = heading.sine_cosine();
        let whole = |metres: f32| (metres * 1000.0) as i32;
        self.sample.position = Some(Position::new(whole(north), whole(east)));
        self.sample.velocity = Some(Velocity::new(whole(speed * cosine), whole(speed * sine)));
        self.sample.steering_angle = Some(steering_angle);
        self.observation = Observation {
            position: self.sample.position,
            velocity: self.sample.velocity,
            steering_angle: self.sample.steering_angle,
            steering_rate: self.sample.applied.steering_rate,
            speed: self.sample.applied.speed,
            dt: PERIOD,
        };
    }

    /// Moves the vehicle, a kinematic model, by one step under the last command.
    fn drive(&mut self) {
        let [north, east, heading, steering_angle, speed] = &mut self.pose;
        let (sine, cosine) = heading.sine_cosine();
        *speed += (self.sample.applied.speed - *speed) * 0.28;
        *north += *speed * cosine * PERIOD;
        *east += *speed * sine * PERIOD;
        *steering_angle += self.sample.applied.steering_rate * PERIOD;
        *heading += *speed * steering_angle.tangent() / 1.1 * PERIOD;
    }
}

/// Prepares the state.
pub type Prepare = fn(&mut Option<Kernel>);
/// A measured function. It returns 1 if its result is as expected.
pub type Run = fn(&mut Option<Kernel>) -> u32;

/// Approaching the line, 1.5 s after the start.
#[inline(never)]
fn prepare_coming(place: &mut Option<Kernel>) {
    *place = Kernel::after(15);
}

/// On the line, 8 s after the start.
#[inline(never)]
fn prepare_there(place: &mut Option<Kernel>) {
    *place = Kernel::after(80);
}

/// Approaching the line, with a predictive controller.
#[inline(never)]
fn prepare_mpc(place: &mut Option<Kernel>) {
    *place = Kernel::after(15);
    if let Some(kernel) = place {
        let rear = Geometry { l1: 0.0, l2: 1.1 };
        let weights = [84.0, 25.0, 0.13, 1.0];
        kernel.mpc = Mpc::design(&rear, kernel.settings.limits, &weights, 1.0, 0.3).ok();
    }
}

#[inline(never)]
fn run_step(place: &mut Option<Kernel>) -> u32 {
    place.as_mut().is_some_and(|kernel| {
        let outcome = kernel.controller.step(&kernel.sample);
        outcome.command.speed > 0.0
    }) as u32
}

#[inline(never)]
fn run_estimator(place: &mut Option<Kernel>) -> u32 {
    place.as_mut().is_some_and(|kernel| {
        let update = kernel.estimator.step(&kernel.observation);
        update == control::estimator::Update::Corrected
    }) as u32
}

#[inline(never)]
fn run_guidance(place: &mut Option<Kernel>) -> u32 {
    place.as_mut().is_some_and(|kernel| {
        let settings = &kernel.settings;
        let at = &kernel.deviation;
        let firm = settings.firm.at(at.speed);
        let gentle = settings.gentle.at(at.speed);
        let target = kernel.guidance.target(at, &firm, &gentle, PERIOD);
        target.follow > 0.0
    }) as u32
}

#[inline(never)]
fn run_safety(place: &mut Option<Kernel>) -> u32 {
    place.as_mut().is_some_and(|kernel| {
        let proposed = Some(Command {
            steering_rate: 0.2,
            speed: 1.0,
        });
        let (command, _) = kernel.safety.step(proposed, 0.0, Some(0.1), PERIOD);
        command.speed > 0.0
    }) as u32
}

#[inline(never)]
fn run_plain(place: &mut Option<Kernel>) -> u32 {
    place.as_mut().is_some_and(|kernel| {
        let outcome = kernel.plain.step(&kernel.sample);
        outcome.command.speed > 0.0
    }) as u32
}

#[inline(never)]
fn run_mpc(place: &mut Option<Kernel>) -> u32 {
    place.as_mut().is_some_and(|kernel| {
        let [_, east, heading, steering_angle, _] = kernel.pose;
        let state = SVector::<f32, 3>::new(east, heading, steering_angle);
        kernel
            .mpc
            .as_mut()
            .is_some_and(|mpc| mpc.solve(&state, 30).is_finite())
    }) as u32
}

/// The preparations, in a static so that the linker keeps them.
#[used]
pub static PREPARATIONS: [Prepare; 3] = [prepare_coming, prepare_there, prepare_mpc];
/// The measured functions.
#[used]
pub static RUNS: [Run; 6] = [
    run_step,
    run_estimator,
    run_guidance,
    run_safety,
    run_plain,
    run_mpc,
];

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
