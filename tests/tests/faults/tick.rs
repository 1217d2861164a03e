//! The tick of the software tasks: its priority, and that it neither loses nor adds a period.

use furrow_tests::Journey;
use furrow_tests::nodes;

use crate::{RUNNING, assert_never_reset};

const SYSTICK: u16 = 15;
/// The interrupt that runs the housekeeping task, EXTI2 on both parts.
const DISPATCHER: u16 = 16 + 8;

/// One priority level in the parts' registers; a lower value is more urgent.
const STEP: i32 = 1 << 4;

#[test]
fn the_tick_wakes_the_housekeeping_a_hundred_times_a_second() {
    let mut journey = Journey::of(RUNNING);
    journey.to(2.5);
    assert_never_reset(&journey);
    for node in nodes::ALL {
        let mcu = journey.vehicle.node(node);
        // One level above the task that it starts.
        let tick = mcu.priority(SYSTICK);
        assert_eq!(tick, mcu.priority(DISPATCHER) - STEP, "{node:?}");
        let tasks = mcu.load().tasks;
        let runs = |exception: u16| {
            let task = tasks.iter().find(|task| task.exception == exception);
            task.map_or(0, |task| task.activations)
        };
        // Start-up takes some milliseconds, and the clocks differ by less than a period.
        assert!((247..=251).contains(&runs(DISPATCHER)), "{node:?}");
        // SysTick runs once per period, and once more when the next due time is enqueued.
        let ticks = runs(SYSTICK);
        assert!(
            ticks.abs_diff(2 * runs(DISPATCHER)) <= 1,
            "{node:?}: {ticks}"
        );
    }
}
