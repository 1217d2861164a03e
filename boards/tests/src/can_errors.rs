//! The error states of the CAN cell: what happens to a node that nobody acknowledges.
//!
//! Needs the transceiver, or a wire from CAN transmit to CAN receive, and no other node on the bus.

use crate::bench::{Bench, near};
use crate::board::can::{ErrorState, Outcome};
use crate::registers::can;
use crate::stamps::loop_back;
use ttcan::{Frame, Id};

const MSR: u32 = 0x04;
const TSR: u32 = 0x08;
const ESR: u32 = 0x18;
const INAK: u32 = 1;
const TME0: u32 = 1 << 26;

/// Last error codes: nobody acknowledged; the cell sent a dominant bit and did not hear it.
const ACKNOWLEDGE: u32 = 3;
const BIT_DOMINANT: u32 = 5;

/// Failed attempts that make a node error passive: each adds 8 to its transmit error counter, which
/// then is 128 (ISO 11898-1, fault confinement).
const TO_PASSIVE: u32 = 16;
const PASSIVE: u8 = 128;

/// A board alone on its bus, with a transmitter.
fn alone() -> Bench {
    let mut bench = Bench::start();
    // A node on its internal oscillator only listens at first.
    bench.sled.can.leave_bus();
    assert!(
        bench.wait(10_000, || can().read(MSR) & INAK != 0),
        "the CAN cell does not leave the bus"
    );
    bench.sled.can.join_bus(false);
    assert!(
        bench.wait(10_000, || can().read(MSR) & INAK == 0),
        "the bus is not recessive: no transceiver, and no wire from CAN transmit to CAN receive?"
    );
    bench
}

/// One attempt to send a frame.
fn attempt(bench: &mut Bench) -> Outcome {
    let frame = Frame::from_parts(Id::constant::<0x123>(), 1, [0xA5; 8]);
    assert!(bench.sled.can.load(&frame).is_ok(), "the mailbox is full");
    let mut outcome = None;
    let can = &mut bench.sled.can;
    let clock = bench.sled.clock;
    let since = clock.now();
    let patience = 5_000 * bench.sled.clocks.ticks_per_us;
    while outcome.is_none() && clock.now().wrapping_sub(since) < patience {
        outcome = can.outcome();
    }
    outcome.expect("an attempt has an outcome within 5 ms")
}

/// One attempt that nobody acknowledges.
fn unacknowledged(bench: &mut Bench) -> ErrorState {
    let outcome = attempt(bench);
    assert!(
        outcome != Outcome::Complete,
        "another node acknowledges: take it off the bus"
    );
    let code = can().read(ESR) >> 4 & 0b111;
    assert!(
        code != BIT_DOMINANT,
        "the cell does not hear itself: no transceiver, and no wire from CAN transmit to CAN receive?"
    );
    assert!(outcome == Outcome::Error, "the attempt was {outcome:?}");
    near("last error code", code, ACKNOWLEDGE, 0);
    bench.sled.can.error_state()
}

#[embedded_test::tests(default_timeout = 5)]
mod tests {
    use super::*;

    #[test]
    fn a_node_that_nobody_acknowledges_becomes_error_passive_and_not_more() {
        let mut bench = alone();
        for count in 1..=TO_PASSIVE {
            let state = unacknowledged(&mut bench);
            near("error counter", state.transmit.into(), 8 * count, 0);
            assert!(state.warning == (8 * count >= 96), "warning at {count}");
            assert!(state.passive == (count == TO_PASSIVE), "passive at {count}");
        }
        // From here on a missing acknowledgement counts no more (ISO 11898-1, exception A).
        for _ in 0..20 {
            let state = unacknowledged(&mut bench);
            near("error counter", state.transmit.into(), PASSIVE.into(), 0);
            assert!(state.passive && !state.bus_off, "{state:?}");
        }
        assert!(bench.sled.can.take_error(), "the error was not noted");
    }

    #[test]
    fn a_failed_attempt_is_not_repeated() {
        let mut bench = alone();
        let state = unacknowledged(&mut bench);
        bench.pause(3_000);
        assert!(can().read(TSR) & TME0 != 0, "the mailbox is not empty");
        assert!(bench.sled.can.outcome().is_none(), "a second outcome");
        let counter = bench.sled.can.error_state().transmit;
        near("error counter", counter.into(), state.transmit.into(), 0);
    }

    #[test]
    fn an_error_passive_node_recovers_by_frames_that_succeed() {
        let mut bench = alone();
        for _ in 0..TO_PASSIVE {
            unacknowledged(&mut bench);
        }
        loop_back(&mut bench);
        for count in 1..=2 {
            let outcome = attempt(&mut bench);
            assert!(outcome == Outcome::Complete, "attempt {count}: {outcome:?}");
        }
        let state = bench.sled.can.error_state();
        assert!(!state.passive && state.transmit < PASSIVE, "{state:?}");
    }
}
