//! Text lines in static memory, sent one after the other by DMA (thesis 6.2.4.6).
//!
//! A task writes whole lines, the DMA controller sends them, and the interrupt at the end of
//! one transfer starts the next. No task waits: a line that finds the queue full is dropped and
//! counted.

use crate::dma::Window;

/// The transmitting side of a serial port that is fed by DMA.
pub trait Transmitter {
    /// Starts a transfer of `length` bytes from `address`.
    ///
    /// The memory must stay untouched until [`Transmitter::finished`] has returned true.
    fn start(&mut self, address: u32, length: u16);

    /// Acknowledges the end of a transfer; false when the interrupt had another cause.
    fn finished(&mut self) -> bool;
}

/// A queue of `LINES` lines of at most `WIDTH` bytes, in `TOTAL = LINES * WIDTH` bytes
/// of static memory.
pub struct LineQueue<T, const LINES: usize, const WIDTH: usize, const TOTAL: usize> {
    port: T,
    memory: Window<u8, TOTAL>,
    lengths: [u16; LINES],
    first: usize,
    waiting: usize,
    busy: bool,
    dropped: u32,
}

impl<T: Transmitter, const LINES: usize, const WIDTH: usize, const TOTAL: usize>
    LineQueue<T, LINES, WIDTH, TOTAL>
{
    /// An empty queue in front of `port`.
    pub fn new(port: T, memory: Window<u8, TOTAL>) -> Self {
        const { assert!(LINES * WIDTH == TOTAL && LINES > 0 && WIDTH <= u16::MAX as usize) };
        Self {
            port,
            memory,
            lengths: [0; LINES],
            first: 0,
            waiting: 0,
            busy: false,
            dropped: 0,
        }
    }

    /// Appends one line, cut at `WIDTH` bytes, and starts sending if no transfer is running. An empty
    /// one is nothing to send. Returns false, and counts the line, if the queue is full.
    // Once in an image, wherever lines are written from.
    #[inline(never)]
    pub fn push(&mut self, line: &[u8]) -> bool {
        if line.is_empty() {
            return true;
        }
        if self.waiting >= LINES {
            self.dropped = self.dropped.wrapping_add(1);
            return false;
        }
        let slot = wrap(self.first + self.waiting, LINES);
        let mut length = 0;
        for &byte in line.iter().take(WIDTH) {
            self.memory.write(slot * WIDTH + length, byte);
            length += 1;
        }
        if let Some(stored) = self.lengths.get_mut(slot) {
            *stored = length as u16;
        }
        self.waiting += 1;
        self.start_next();
        true
    }

    /// To be called by the task that is bound to the end of the DMA transfer.
    pub fn on_transfer_complete(&mut self) {
        if self.port.finished() && self.busy {
            self.busy = false;
            self.first = wrap(self.first + 1, LINES);
            self.waiting = self.waiting.saturating_sub(1);
            self.start_next();
        }
    }

    /// Lines dropped so far because the queue was full; wraps.
    pub fn dropped(&self) -> u32 {
        self.dropped
    }

    /// Whether a transfer is running.
    pub fn is_busy(&self) -> bool {
        self.busy
    }

    /// The port behind the queue.
    pub fn port(&mut self) -> &mut T {
        &mut self.port
    }

    fn start_next(&mut self) {
        if self.busy || self.waiting == 0 {
            return;
        }
        let length = self.lengths.get(self.first).copied().unwrap_or(0);
        let address = self.memory.address() + (self.first * WIDTH) as u32;
        self.busy = true;
        self.port.start(address, length);
    }
}

const fn wrap(index: usize, lines: usize) -> usize {
    if index >= lines { index - lines } else { index }
}

#[cfg(test)]
mod tests {
    extern crate std;
    use super::{LineQueue, Transmitter};
    use crate::dma::Shared;
    use std::vec::Vec;

    #[derive(Default)]
    struct Port {
        sent: Vec<(u32, u16)>,
    }

    impl Transmitter for Port {
        fn start(&mut self, address: u32, length: u16) {
            self.sent.push((address, length));
        }
        fn finished(&mut self) -> bool {
            true
        }
    }

    #[test]
    fn lines_leave_in_order_and_a_full_queue_drops() {
        static MEMORY: Shared<u8, 24> = Shared::new(0);
        let window = MEMORY.take().unwrap();
        let base = window.address();
        let mut queue = LineQueue::<_, 3, 8, 24>::new(Port::default(), window);
        assert!(queue.push(b"one"));
        assert!(queue.push(b""));
        assert!(queue.push(b"three, and too long"));
        assert!(queue.push(b"four"));
        assert!(!queue.push(b"five"));
        assert!(queue.push(b""), "there is nothing to send");
        assert_eq!(queue.dropped(), 1);
        queue.on_transfer_complete();
        queue.on_transfer_complete();
        queue.on_transfer_complete();
        assert!(!queue.is_busy());
        assert!(queue.push(b"six"));
        let sent = [(base, 3), (base + 8, 8), (base + 16, 4), (base, 3)];
        assert_eq!(queue.port().sent, sent);
    }
}
