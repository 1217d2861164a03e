//! The stack usage of the small parts.

use crate::{RUNNING, assert_never_reset, mode};
use furrow_tests::Journey;
use furrow_tests::{nodes, vehicle};

/// The pattern with which the stack is filled before the program begins (cortex-m-rt).
const PAINT: [u8; 4] = [0xCC; 4];

#[test]
fn the_call_stacks_keep_a_quarter_of_their_memory_free() {
    // All situations of these nodes: start, run, stop, events, an error frame, loss of the schedule
    // and a rejoin.
    let text = format!(
        r#"
        [[press]]
        at = "3 s"
        button = "D"
        [[bus]]
        what = "corrupt"
        at = "2.5 s"
        count = 2
        [[bus]]
        what = "dominant"
        at = "3.506 s"
        hold = "20 ms"
        {RUNNING}
        "#
    );
    let mut journey = Journey::of(&text);
    journey.to(2.4);
    assert_eq!(journey.mode(), Some(mode::RUN));
    journey.to(5.0);
    assert_never_reset(&journey);
    for node in [nodes::STEERING, nodes::DRIVE] {
        let stack = vehicle().board(node).stack;
        let size = stack.size as usize;
        let memory = journey.vehicle.node(node).memory(stack.base, size);
        let memory = memory.expect("the part has this memory");
        let free = memory.chunks(4).take_while(|word| *word == PAINT).count() * 4;
        assert!(free < size, "{node:?} never used its stack");
        assert!(free >= size / 4, "{node:?} has {free} of {size} bytes left");
    }
}
