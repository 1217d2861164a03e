//! What the DMA controllers move: lines of the console out of memory, bytes of the receiver and
//! samples of the converter into their rings.

use crate::bench::{Bench, near};
use crate::board::console::{BAUD, LINES};
use crate::registers::converter_dma;

/// Ticks of the time base in a byte of the console: ten bits.
fn byte(bench: &Bench) -> u32 {
    (u64::from(bench.ticks(1_000_000)) * 10 / u64::from(BAUD)) as u32
}

#[embedded_test::tests(default_timeout = 5)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_the_console_take_the_time_of_their_bytes() {
        let mut bench = Bench::start();
        // The port sends an idle character when it is enabled.
        bench.pause(1000);
        const WIDTHS: [usize; 3] = [1, 40, 97];
        let line = [b'x'; 97];
        let since = bench.now();
        for width in WIDTHS {
            assert!(bench.sled.console.push(&line[..width]), "no room");
        }
        let clock = bench.sled.clock;
        let patience = bench.ticks(50_000);
        while bench.sled.console.is_busy() {
            bench.sled.console.on_transfer_complete();
            let waited = clock.now().wrapping_sub(since);
            assert!(waited < patience, "the transfer does not end");
        }
        let took = clock.now().wrapping_sub(since);
        let bytes: usize = WIDTHS.iter().sum();
        // A transfer ends when the last byte is in the data register, while the one before it is
        // being sent.
        let expected = (bytes as u32 - 2) * byte(&bench);
        near("ticks of three lines", took, expected, byte(&bench));
        near("lines dropped", bench.sled.console.dropped(), 0, 0);
    }

    #[test]
    fn a_full_queue_drops_the_next_line_and_sends_the_others() {
        let mut bench = Bench::start();
        bench.pause(1000);
        let since = bench.now();
        for line in 0..LINES {
            assert!(bench.sled.console.push(b"0123456789"), "line {line}");
        }
        assert!(!bench.sled.console.push(b"lost"), "there was room");
        near("lines dropped", bench.sled.console.dropped(), 1, 0);
        while bench.sled.console.is_busy() {
            bench.sled.console.on_transfer_complete();
        }
        let took = bench.now().wrapping_sub(since);
        let expected = (10 * LINES as u32 - 2) * byte(&bench);
        near("ticks of the lines", took, expected, byte(&bench));
    }

    /// The ring is as long as a scan, so it wraps at each one.
    #[test]
    fn the_converter_fills_its_ring_at_the_rate_of_its_timer() {
        let bench = Bench::start();
        let (clock, ticks_per_us) = (bench.sled.clock, bench.sled.clocks.ticks_per_us);
        // The flag of a complete transfer.
        #[cfg(feature = "f446")]
        let (complete, rate) = (1 << 5, crate::board::panel::SCAN_HZ);
        #[cfg(feature = "f303")]
        let (complete, rate) = (1 << 1, crate::board::pot::SCAN_HZ);
        #[cfg(feature = "f446")]
        let mut ring = bench.sled.rest.operator().expect("the converter").joystick;
        #[cfg(feature = "f303")]
        let mut ring = bench.sled.rest.pot().expect("the converter");
        let period = 1_000_000 / rate * ticks_per_us;
        let mut last = None;
        for _ in 0..5 {
            let since = clock.now();
            while converter_dma().read(0) & complete == 0 {
                let waited = clock.now().wrapping_sub(since);
                assert!(waited < 2 * period, "the ring does not fill");
            }
            let full = clock.now();
            ring.acknowledge();
            assert!(converter_dma().read(0) & complete == 0, "not acknowledged");
            if let Some(last) = last.replace(full) {
                near(
                    "ticks of a ring",
                    full.wrapping_sub(last),
                    period,
                    period / 500,
                );
            }
        }
        #[cfg(feature = "f446")]
        let counts = ring.counts();
        #[cfg(feature = "f303")]
        let counts = (ring.count(), 0);
        assert!(counts.0 < 4096 && counts.1 < 4096, "{counts:?}");
    }

    /// The port is in half-duplex mode for this, so that it hears itself. In that mode it lets go
    /// of its pin between two bytes; the pull-up keeps the line idle (RM0390 25.4.10).
    #[cfg(feature = "f446")]
    #[test]
    fn the_receivers_ring_keeps_every_byte() {
        use crate::board::receiver::{QUIET, RING};
        use crate::registers::{port_a, usart1};
        const SR: u32 = 0x00;
        const DR: u32 = 0x04;
        const CR1: u32 = 0x0C;
        const CR3: u32 = 0x14;
        const UE: u32 = 1 << 13;
        const HDSEL: u32 = 1 << 3;
        const TXE: u32 = 1 << 7;
        const PUPDR: u32 = 0x0C;
        /// More than two rings.
        const BYTES: usize = 2 * RING + 37;
        let bench = Bench::start();
        let clock = bench.sled.clock;
        let ticks_per_us = bench.sled.clocks.ticks_per_us;
        port_a().set(PUPDR, 0b01 << (2 * 9));
        let mut receiver = bench.sled.rest.receiver().expect("the receiver");
        usart1().clear(CR1, UE);
        usart1().set(CR3, HDSEL);
        usart1().set(CR1, UE);
        let pattern = |at: usize| (at * 7 + at / 251) as u8;
        let (mut sent, mut arrived) = (0, 0);
        let since = clock.now();
        while arrived < BYTES {
            if sent < BYTES && usart1().read(SR) & TXE != 0 {
                usart1().write(DR, pattern(sent).into());
                sent += 1;
            }
            // In pieces, so that the ring wraps while bytes wait in it.
            if sent == BYTES || sent - arrived > 50 {
                for byte in receiver.arrived() {
                    assert!(byte == pattern(arrived), "byte {arrived} is {byte}");
                    arrived += 1;
                }
            }
            let waited = clock.now().wrapping_sub(since);
            assert!(
                waited < 20_000 * ticks_per_us,
                "{sent} bytes sent, {arrived} arrived"
            );
        }
        receiver.acknowledge_dma();
        let now = clock.now();
        assert!(receiver.look(now).is_none(), "bytes are still arriving");
        let idle = receiver.look(now.wrapping_add(QUIET));
        assert!(idle == Some(now), "the line is idle");
    }
}
