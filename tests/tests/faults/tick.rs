//! The tick of the software tasks: its priority, and that it loses and invents nothing.

use furrow_tests::Journey;
use furrow_tests::nodes;

use crate::{RUNNING, assert_never_reset};

const SYSTICK: u16 = 15;
/// The dispatcher of the housekeeping, EXTI2 on both parts.
const DISPATCHER: u16 = 16 + 8;

/// One priority, as the parts' registers hold it: lower wins.
const STEP: i32 = 1 << 4;

#[test]
fn the_tick_wakes_the_housekeeping_a_hundred_times_a_second() {
    let mut journey = Journey::of(RUNNING);
    journey.to(2.5);
    assert_never_reset(&journey);
    for node in nodes::ALL {
        let mcu = journey.vehicle.node(node);
        // Just above the task that it wakes.
        let tick = mcu.priority(SYSTICK);
        assert_eq!(tick, mcu.priority(DISPATCHER) - STEP, "{node:?}");
        let tasks = mcu.load().tasks;
        let runs = |exception: u16| {
            let task = tasks.iter().find(|task| task.exception == exception);
            task.map_or(0, |task| task.activations)
        };
        // The start takes some milliseconds, clocks differ by less than a step.
        assert!((247..=251).contains(&runs(DISPATCHER)), "{node:?}");
        // Each tick, and each time when the next instant is put in line.
        let ticks = runs(SYSTICK);
        assert!(
            ticks.abs_diff(2 * runs(DISPATCHER)) <= 1,
            "{node:?}: {ticks}"
        );
    }
}
