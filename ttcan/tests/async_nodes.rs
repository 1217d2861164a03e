//! The example of asynchronous tasks runs, and every message is in its window.

#[path = "../examples/async_nodes.rs"]
#[allow(dead_code)] // The example's `main` prints what this test judges.
#[expect(unreachable_pub, reason = "the example is a program of its own")]
mod async_nodes;

use async_nodes::{COUNT, ECHO, network};
use ttcan::Frame;

const REFERENCE: ttcan::Id = ttcan::Id::constant::<0x100>();

#[test]
fn every_message_is_in_its_window_for_a_hundred_basic_cycles() {
    let traffic = network(1050);
    let references: Vec<u32> = traffic
        .iter()
        .filter(|(_, frame)| frame.id() == REFERENCE)
        .map(|(start, _)| *start)
        .collect();
    // A node follows the schedule from the second reference on, and both rest before their first one
    // counts as consecutive.
    let cycles = references.windows(2).skip(2).take(100);
    assert_eq!(cycles.len(), 100);
    let mut count = None;
    for pair in cycles {
        let [begin, end] = [pair[0], pair[1]];
        // The timer of 1 MHz sees the deadline at the next step.
        assert!((10_000..=10_002).contains(&(end - begin)), "{begin} {end}");
        let inside: Vec<&(u32, Frame)> = traffic
            .iter()
            .filter(|(start, _)| (begin + 1..end).contains(start))
            .collect();
        let [(first, counted), (second, echo)] = inside[..] else {
            panic!("two messages: {inside:?}");
        };
        assert_eq!([counted.id(), echo.id()], [COUNT, ECHO]);
        // At the time mark or up to the transmit enable window of 64 us later.
        assert!((1000..=1064).contains(&(first - begin)), "{first}");
        assert!((3000..=3064).contains(&(second - begin)), "{second}");
        assert_eq!(counted.data(), echo.data());
        let number = u16::from_be_bytes([counted.data()[0], counted.data()[1]]);
        assert_eq!(count.map_or(number, |count| count + 1), number);
        count = Some(number);
    }
}
