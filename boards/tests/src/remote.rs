//! The lines of the remote control. Nothing is connected to them; the test drives them by their pull
//! resistors.

use crate::bench::Bench;
use crate::registers::port_b;

const PUPDR: u32 = 0x0C;
const RUN: u32 = 5;
const STOP: u32 = 4;

/// Gives a pin its pull-up or its pull-down.
fn pull(pin: u32, up: bool) {
    let others = port_b().read(PUPDR) & !(0b11 << (2 * pin));
    let own = if up { 0b01 } else { 0b10 };
    port_b().write(PUPDR, others | own << (2 * pin));
    // The line follows within some microseconds.
    cortex_m::asm::delay(10_000);
}

#[embedded_test::tests(default_timeout = 5)]
mod tests {
    use super::*;

    #[test]
    fn open_lines_of_the_remote_control_are_low_and_each_is_read_by_itself() {
        let mut bench = Bench::start();
        let remote = bench.sled.rest.remote().expect("the first call");
        assert!(bench.sled.rest.remote().is_none(), "a second call");
        cortex_m::asm::delay(10_000);
        assert!(!remote.run() && !remote.stop(), "an open line is high");
        for (pin, levels) in [(RUN, (true, false)), (STOP, (false, true))] {
            pull(pin, true);
            let read = (remote.run(), remote.stop());
            defmt::info!("run {=bool}, stop {=bool}", read.0, read.1);
            assert!(read == levels, "run and stop are {read:?}");
            pull(pin, false);
        }
    }
}
