//! What the serial transmitters put on their pins, sampled through the input register of the port:
//! it shows the level of a pin whatever drives it (RM0390 7.3.10, RM0316 11.3.10).

use crate::bench::{Bench, cycle, near};
use crate::board::console;
use crate::registers::port_a;

const IDR: u32 = 0x10;

/// Pin of the console's transmitter, and of that of USART1.
const CONSOLE: u32 = 2;
const USART1: u32 = 9;

/// Records the edges of an idle line in core cycles after `start` has begun to send: as many as
/// there are, or as come in `patience` cycles. Returns their number.
fn record(pin: u32, patience: u32, edges: &mut [u32], start: impl FnOnce()) -> usize {
    let level = || port_a().read(IDR) >> pin & 1;
    assert!(level() == 1, "the line is not idle");
    let (mut count, mut last) = (0, 1);
    start();
    let since = cycle();
    while count < edges.len() {
        let (now, at) = (level(), cycle());
        if now != last {
            last = now;
            edges[count] = at;
            count += 1;
        }
        if at.wrapping_sub(since) > patience {
            break;
        }
    }
    count
}

/// Checks that the edges come at these bits of a byte that is sent at `baud` bit/s by a core of
/// `core` Hz, to 1 % and `slack` cycles, which are the time between two samples.
#[track_caller]
fn compare(edges: &[u32], bits: &[u32], core: u32, baud: u32, slack: u32) {
    near("edges", edges.len() as u32, bits.len() as u32, 0);
    for (&edge, &bit) in edges.iter().zip(bits) {
        let expected = (u64::from(core) * u64::from(bit) / u64::from(baud)) as u32;
        let tolerance = expected / 100 + slack;
        near(
            "edge, cycles",
            edge.wrapping_sub(edges[0]),
            expected,
            tolerance,
        );
    }
}

/// Edges of the letter U, whose bits alternate: one at each bit, the last before the stop bit.
const ALTERNATING: [u32; 10] = [0, 1, 2, 3, 4, 5, 6, 7, 8, 9];

/// The line of a motor driver from the moment at which its pin is connected, sampled by SysTick
/// while the board starts.
#[cfg(feature = "f303")]
mod motor_line {
    use super::{IDR, USART1};
    use crate::bench::cycle;
    use crate::registers::port_a;
    use core::sync::atomic::{AtomicU32, AtomicUsize, Ordering::Relaxed};
    use cortex_m::peripheral::syst::SystClkSource;

    /// Core cycles between two samples: 2 us at 72 MHz.
    pub(super) const PERIOD: u32 = 144;
    /// Level before the pin is connected.
    const UNCONNECTED: u32 = 2;
    const MODER: u32 = 0x00;
    const ALTERNATE: u32 = 0b10;

    static LAST: AtomicU32 = AtomicU32::new(UNCONNECTED);
    static COUNT: AtomicUsize = AtomicUsize::new(0);
    static EDGES: [AtomicU32; 8] = [const { AtomicU32::new(0) }; 8];

    // SAFETY: the name is the one that the vector table of cortex-m-rt asks for.
    #[unsafe(export_name = "SysTick")]
    extern "C" fn sample() {
        if port_a().read(MODER) >> (2 * USART1) & 0b11 != ALTERNATE {
            return;
        }
        let level = port_a().read(IDR) >> USART1 & 1;
        if LAST.load(Relaxed) != level {
            LAST.store(level, Relaxed);
            let count = COUNT.load(Relaxed);
            if let Some(edge) = EDGES.get(count) {
                edge.store(cycle(), Relaxed);
            }
            COUNT.store(count + 1, Relaxed);
        }
    }

    /// Begins to sample.
    pub(super) fn watch() {
        // SAFETY: no test uses this timer for anything else.
        let mut timer = unsafe { cortex_m::Peripherals::steal() }.SYST;
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(PERIOD - 1);
        timer.clear_current();
        timer.enable_interrupt();
        timer.enable_counter();
    }

    /// What was seen: the first sample and every change of the level.
    pub(super) fn seen() -> ([u32; 8], usize) {
        (
            core::array::from_fn(|at| EDGES[at].load(Relaxed)),
            COUNT.load(Relaxed),
        )
    }
}

#[embedded_test::tests(default_timeout = 5)]
mod tests {
    use super::*;

    #[test]
    fn the_console_sends_at_its_rate() {
        let mut bench = Bench::start();
        // The port sends an idle character when it is enabled.
        bench.pause(1000);
        let core = bench.sled.clocks.core;
        let patience = bench.cycles(1000);
        let mut edges = [0; ALTERNATING.len()];
        let count = record(CONSOLE, patience, &mut edges, || {
            bench.sled.console.push(b"U");
        });
        compare(&edges[..count], &ALTERNATING, core, console::BAUD, 40);
    }

    /// USART1 of the F446 is on the other peripheral bus.
    #[cfg(feature = "f446")]
    #[test]
    fn the_receivers_port_sends_at_its_rate() {
        use crate::board::receiver::BAUD;
        use crate::registers::usart1;
        const DR: u32 = 0x04;
        let bench = Bench::start();
        let (core, patience) = (bench.sled.clocks.core, bench.cycles(1000));
        let wait = bench.cycles(100);
        let port = bench.sled.rest.receiver();
        assert!(port.is_some(), "the receiver's port does not start");
        cortex_m::asm::delay(wait);
        let mut edges = [0; ALTERNATING.len()];
        let count = record(USART1, patience, &mut edges, || {
            usart1().write(DR, u32::from(b'U'));
        });
        compare(&edges[..count], &ALTERNATING, core, BAUD, 40);
    }

    /// A stop is 127: seven bits set and one clear, least significant first.
    #[cfg(feature = "f303")]
    #[test]
    fn a_stop_reaches_the_motor_driver_as_one_byte() {
        use crate::board::motor::{BAUD, STOP};
        let mut bench = Bench::start();
        near("stop", STOP.into(), 127, 0);
        bench.pause(2000);
        let core = bench.sled.clocks.core;
        let patience = bench.cycles(2000);
        let mut edges = [0; 6];
        let count = record(USART1, patience, &mut edges, || bench.sled.motor.set(None));
        compare(&edges[..count], &[0, 1, 8, 9], core, BAUD, 40);
    }

    /// From the moment at which the pin is connected the driver sees an idle line and one stop: no
    /// other edge, and no bit that is too short or too long.
    #[cfg(feature = "f303")]
    #[test]
    fn the_motor_driver_sees_a_stop_and_nothing_else_while_the_board_starts() {
        use crate::board::motor::BAUD;
        motor_line::watch();
        let bench = Bench::start();
        bench.pause(2000);
        let (edges, count) = motor_line::seen();
        near("levels", count as u32, 5, 0);
        let core = bench.sled.clocks.core;
        let slack = 2 * motor_line::PERIOD;
        compare(&edges[1..count], &[0, 1, 8, 9], core, BAUD, slack);
        let idle = edges[1].wrapping_sub(edges[0]);
        defmt::info!("idle before the first bit: {=u32} cycles", idle);
    }
}
