//! Functions whose cycles `cargo xtask bench` counts: a step between two rows, in its two parts,
//! and the thesis's law. The readings are as adverse as can be: leaves at any distance, so that no
//! hypothesis is ever sure.

#![no_std]
#![no_main]
#![forbid(unsafe_code)]

use core::panic::PanicInfo;

use control::calibration::{Actuator, Direction};
use control::row::{
    ConditionalHold, Mounting, ProportionalIntegral, RowController, RowDistances, RowFollower,
    RowRobot, RowSettings, ScalarKalman, Sides,
};

/// Time between two steps, s.
const PERIOD: f32 = 0.005;

/// The thesis's robot.
fn robot() -> RowRobot {
    let direction = Direction {
        dead_band: 0.05,
        full_rate: 2.0,
    };
    let motor = Actuator {
        positive: direction,
        negative: direction,
    };
    RowRobot {
        mounting: Mounting {
            ahead: 0.2546,
            beside: 0.152,
            angle: core::f64::consts::FRAC_PI_4,
        },
        least: 0.22,
        open: 2.25,
        track: 0.6,
        lag: 0.12,
        motors: Sides {
            left: motor,
            right: motor,
        },
        cruise: 0.8,
        width: 0.762,
        tolerance: 0.04,
        stalk: 0.022,
        gap: 1.0,
    }
}

/// Readings of one sensor: a surface at a random distance for some steps, then the next.
struct Leaves {
    random: u32,
    left: u32,
    distance: f32,
}

impl Leaves {
    fn new(random: u32) -> Self {
        Self {
            random,
            left: 0,
            distance: 0.0,
        }
    }

    /// The next reading, in whole centimetres.
    fn read(&mut self) -> f32 {
        if self.left == 0 {
            // Multiplier and increment of D. E. Knuth's MMIX, for 32 bits.
            self.random = self
                .random
                .wrapping_mul(1_664_525)
                .wrapping_add(1_013_904_223);
            self.left = 4 + (self.random >> 29);
            self.distance = 0.55 + ((self.random >> 24) & 31) as f32 * 0.01;
        }
        self.left -= 1;
        self.distance
    }
}

/// State on which the measured functions work.
pub struct Kernel {
    controller: RowController<f32>,
    follower: RowFollower<f32>,
    left: Leaves,
    right: Leaves,
    distances: RowDistances<f32>,
}

impl Kernel {
    fn new() -> Option<Self> {
        Some(Self {
            controller: RowController::new(RowSettings::for_robot(&robot()).ok()?).ok()?,
            follower: RowFollower::new(
                ConditionalHold::new(50.0, 120.0).ok()?,
                ScalarKalman::new(0.005, 1.0).ok()?,
                ProportionalIntegral {
                    proportional: 0.0012,
                    integral: 0.0004,
                    input_limit: 40.0,
                    output_limit: 0.1,
                },
            ),
            left: Leaves::new(1),
            right: Leaves::new(2),
            distances: RowDistances {
                left: 0.0,
                right: 0.0,
            },
        })
    }
}

/// Changes the state between two measured calls.
pub type Prepare = fn(&mut Option<Kernel>);
/// A measured function. It returns 1 if its result is as expected.
pub type Run = fn(&mut Option<Kernel>) -> u32;

/// A robot that has seen nothing.
#[inline(never)]
fn prepare_start(place: &mut Option<Kernel>) {
    *place = Kernel::new();
}

/// The readings of the next step.
#[inline(never)]
fn prepare_next(place: &mut Option<Kernel>) {
    if let Some(kernel) = place {
        kernel.distances = RowDistances {
            left: kernel.left.read(),
            right: kernel.right.read(),
        };
    }
}

#[inline(never)]
fn run_command(place: &mut Option<Kernel>) -> u32 {
    place.as_mut().is_some_and(|kernel| {
        let outcome = kernel.controller.command(&kernel.distances, true, PERIOD);
        outcome.efforts.left.abs() + outcome.efforts.right.abs() > 0.0
    }) as u32
}

#[inline(never)]
fn run_correct(place: &mut Option<Kernel>) -> u32 {
    place.as_mut().is_some_and(|kernel| {
        kernel.controller.correct();
        true
    }) as u32
}

#[inline(never)]
fn run_thesis(place: &mut Option<Kernel>) -> u32 {
    place.as_mut().is_some_and(|kernel| {
        let RowDistances { left, right } = kernel.distances;
        let efforts = kernel
            .follower
            .step(left * 100.0, right * 100.0, 0.2, PERIOD);
        efforts.left > 0.0
    }) as u32
}

/// The preparations, in a static so that the linker keeps them.
#[used]
pub static PREPARATIONS: [Prepare; 2] = [prepare_start, prepare_next];
/// The measured functions.
#[used]
pub static RUNS: [Run; 3] = [run_command, run_correct, run_thesis];

#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {}
}
